//! Machines with physical faults, each fault drawn so large that the record shows it.
//!
//! | machine | faults | drawn for |
//! |---|---|---|
//! | [`MultiFaultMachine`] | one to five; some may imitate others | the score card ([`crate::score::physical_faults`]) |
//! | [`SeparableFaultMachine`] | one to three, distinguishable from every other law by the record | the demonstration |
//!
//! Nothing here knows the diagnosis. The model of a machine file says only what its user believes: a fault is measured as
//! the record with it less that without it, compared with what the file predicts. Which causes name a fault
//! is physics, and stands in `docs/physical-faults.md`.

mod alternatives;
mod multi_fault;
mod separable_faults;

pub use multi_fault::MultiFaultMachine;
pub use separable_faults::SeparableFaultMachine;

use crate::physical_faults::PhysicalFault;

/// The smallest fault that is hidden, as a multiple of the RMS of the noise: one that a record of this length shows.
pub const MIN_FAULT_TO_NOISE_RATIO: f64 = 3.0;
/// Faults are drawn from a little above that to this multiple of the noise.
const FAULT_TO_NOISE_RATIO_RANGE: [f64; 2] = [1.1 * MIN_FAULT_TO_NOISE_RATIO, 10.0];
/// A fault that must be larger than this to be seen is none of this machine: as in
/// `docs/physical-faults.md`, a room that swings by more, in K, is no room.
const MAX_FAULT_SIZE: f64 = 8.0;

/// A fault that is drawn.
#[derive(Clone, Debug)]
pub struct SampledFault {
    /// The fault.
    pub fault: PhysicalFault,
    /// How much of it ([`PhysicalFault`]).
    pub size: f64,
    /// RMS of its effect on the record, over that of the noise.
    pub ratio: f64,
    /// Its effect on each row of the first day, in µm, read or not.
    pub um: Vec<f64>,
}

/// Finds the size at which a fault does `target` times the noise, where `at_size` returns it at a size; `None` where the
/// machine does not show it so large.
///
/// # Errors
/// Those of `at_size`.
fn find_fault_at_noise_ratio<E>(
    target: f64,
    at_size: impl Fn(f64) -> Result<SampledFault, E>,
) -> Result<Option<SampledFault>, E> {
    let mut drawn = at_size(1.0)?;
    for _ in 0..8 {
        if (drawn.ratio / target - 1.0).abs() < 0.05 {
            break;
        }
        // The effect of a fault is nearly in proportion to its size.
        drawn = at_size((drawn.size * target / drawn.ratio).min(2.0 * MAX_FAULT_SIZE))?;
    }
    Ok((drawn.size <= MAX_FAULT_SIZE && drawn.ratio >= MIN_FAULT_TO_NOISE_RATIO).then_some(drawn))
}

/// Returns the causes that may be named for `fault`: one or two, by physics. They were written down before the
/// first diagnosis of such a machine, and are not changed to fit a result.
#[must_use]
pub fn expected_causes(fault: PhysicalFault) -> &'static [&'static str] {
    match fault {
        PhysicalFault::SensorGain => &["sensor-gain"],
        PhysicalFault::CoilTemperature => &["sensor-temperature-drift"],
        PhysicalFault::UnseenHolder => &["extra-heat-path", "slow-mode"],
        PhysicalFault::AxialStiffness => &["cutting-load"],
        PhysicalFault::SpeedGrowth => &["centrifugal-growth"],
        PhysicalFault::ToolGrowth => &["dependence", "centrifugal-growth"],
        PhysicalFault::ColdTool => &["extra-heat-path", "slow-mode"],
        PhysicalFault::LostCooling => &["growth-amplitude", "growth-rate"],
        PhysicalFault::Room => &["extra-heat-path", "axis-expansion"],
        PhysicalFault::ScrewHeating => &["axis-expansion"],
        PhysicalFault::Mounting => &["cross-axis"],
        PhysicalFault::Wear => &["backlash", "position-dependent-backlash"],
        PhysicalFault::MisplacedThermometer => &["thermal-lag"],
        PhysicalFault::GaugeDrift => &["drift"],
    }
}
