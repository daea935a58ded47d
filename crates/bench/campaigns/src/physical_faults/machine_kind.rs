//! Kinds of machines, which faults each can have, and what all of them share.

use std::collections::BTreeMap;

use super::PhysicalFault;
use trueup_twin::{
    ambient::AmbientConfig,
    instrument::InstrumentConfig,
    scenario::{CoolantConfig, MeasuredQuantity, Scenario},
    sensors::{Spot, ThermometerConfig},
};

/// The temperature that a room is held at, and at which everything is right, in °C.
pub(super) const CONTROLLED_ROOM_TEMPERATURE_C: f64 = 20.0;

/// The kind of machine, with the laws in its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MachineKind {
    /// A motor spindle with a displacement sensor in its nose; the file has the sensor's law.
    SensorSpindle,
    /// A spindle whose housing grows as its bearings heat it; the file has the warm-up.
    WarmupSpindle,
    /// The same with a thermometer on the housing; the file has the growth over its temperature.
    ThermometerSpindle,
    /// An axis measured on its screw, which stays cold; the file has no law of heat.
    ScrewAxis,
    /// An axis with a scale in a room that is held at its temperature; the file has no law of heat.
    ScaleAxis,
    /// An axis with a scale in a room that swings; the file has the scale's expansion.
    CompensatedAxis,
    /// A spindle with a thermometer on the housing that changes its tools; the file has the growth over the
    /// temperature, and nothing of the tools.
    ToolSpindle,
}

impl MachineKind {
    /// Those that are drawn by chance; [`Self::ToolSpindle`] is requested by name.
    pub const SAMPLED_KINDS: [Self; 6] = [
        Self::SensorSpindle,
        Self::WarmupSpindle,
        Self::ThermometerSpindle,
        Self::ScrewAxis,
        Self::ScaleAxis,
        Self::CompensatedAxis,
    ];

    /// Its name in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::SensorSpindle => "sensor-spindle",
            Self::WarmupSpindle => "warmup-spindle",
            Self::ThermometerSpindle => "thermometer-spindle",
            Self::ScrewAxis => "screw-axis",
            Self::ScaleAxis => "scale-axis",
            Self::CompensatedAxis => "compensated-axis",
            Self::ToolSpindle => "tool-spindle",
        }
    }

    /// Returns the faults that such a machine can have and its model does not follow: what a sensor or a
    /// thermometer in use sees is corrected.
    #[must_use]
    pub fn possible_faults(self) -> &'static [PhysicalFault] {
        use PhysicalFault::{
            AxialStiffness, CoilTemperature, ColdTool, GaugeDrift, LostCooling,
            MisplacedThermometer, Mounting, Room, ScrewHeating, SensorGain, SpeedGrowth,
            ToolGrowth, UnseenHolder, Wear,
        };
        match self {
            Self::SensorSpindle => {
                &[SensorGain, CoilTemperature, UnseenHolder, AxialStiffness, GaugeDrift]
            }
            Self::WarmupSpindle => {
                &[LostCooling, Room, UnseenHolder, AxialStiffness, SpeedGrowth, GaugeDrift]
            }
            Self::ThermometerSpindle => &[UnseenHolder, AxialStiffness, SpeedGrowth, GaugeDrift],
            Self::ScrewAxis => &[ScrewHeating, Room, Mounting, Wear, GaugeDrift],
            Self::ScaleAxis => &[Room, Mounting, GaugeDrift],
            Self::CompensatedAxis => &[MisplacedThermometer, Mounting, GaugeDrift],
            Self::ToolSpindle => &[ToolGrowth, ColdTool, AxialStiffness, GaugeDrift],
        }
    }

    pub(super) fn is_axis(self) -> bool {
        matches!(self, Self::ScrewAxis | Self::ScaleAxis | Self::CompensatedAxis)
    }
}

/// The way in which a fault of either direction goes, −1 or +1, the share of the wear that grows
/// along the screw, and what the tools differ by.
#[derive(Clone, Copy, Debug)]
pub(super) struct FaultVariation {
    pub gain: f64,
    pub coil: f64,
    pub drift: f64,
    pub mounting: f64,
    pub wear_along: f64,
    /// How each tool grows with speed, of the size.
    pub tools: [f64; 4],
}

/// Thermometers by name and place, each as good as thermometers on machines are.
pub(super) fn build_thermometer_configs(
    spots: Vec<(&str, Spot)>,
) -> BTreeMap<String, ThermometerConfig> {
    let good = |at: Spot| ThermometerConfig {
        at,
        offset_c: 0.0,
        lag_s: 0.0,
        noise_c: 0.01,
        quantum_c: 0.01,
        dropout: 0.0,
    };
    spots.into_iter().map(|(name, at)| (name.to_string(), good(at))).collect()
}

/// Returns a machine of which only the kind is known, and what is measured on it: nothing of it errs, and it does
/// nothing yet.
pub(super) fn base_scenario(kind: MachineKind, measured: MeasuredQuantity) -> Scenario {
    Scenario {
        name: kind.name().into(),
        measure: vec![measured],
        interval_s: 10.0,
        step_s: 10.0,
        repeat: 1,
        start_c: None,
        start_mm: [0.0; 3],
        tool_direction: [0.0, 0.0, -1.0],
        head: Vec::new(),
        ambient: AmbientConfig::default(),
        coolant: CoolantConfig::default(),
        spindle: None,
        tool: Vec::new(),
        sensor: None,
        thermometer: BTreeMap::new(),
        axis: BTreeMap::new(),
        straightness: Vec::new(),
        abbe: Vec::new(),
        body: Vec::new(),
        tip_mm: [0.0; 3],
        instrument: InstrumentConfig::default(),
        segment: Vec::new(),
    }
}
