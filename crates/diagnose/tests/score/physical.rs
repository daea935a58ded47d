//! Which causes are the right names of a physical fault; `docs/physical-faults.md` says why.

use trueup_twin::physical::Fault;

/// The causes that may be named for `fault`: one or two, by physics. They were written down before the
/// first diagnosis of such a machine, and are not changed to fit a result.
#[must_use]
pub fn causes(fault: Fault) -> &'static [&'static str] {
    match fault {
        Fault::SensorGain => &["sensor-gain"],
        Fault::CoilTemperature => &["sensor-temperature-drift"],
        Fault::UnseenHolder => &["extra-heat-path", "slow-mode"],
        Fault::AxialStiffness => &["cutting-load"],
        Fault::SpeedGrowth => &["centrifugal-growth"],
        Fault::LostCooling => &["growth-amplitude", "growth-rate"],
        Fault::Room => &["extra-heat-path", "axis-expansion"],
        Fault::ScrewHeating => &["axis-expansion"],
        Fault::Mounting => &["cross-axis"],
        Fault::Wear => &["backlash", "position-dependent-backlash"],
        Fault::MisplacedThermometer => &["thermal-lag"],
        Fault::GaugeDrift => &["drift"],
    }
}
