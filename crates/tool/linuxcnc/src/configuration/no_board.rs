//! The bridge without a board: its calibration, its settings and its inputs, from the machine file.

use trueup_core::units::Code;
use trueup_machine::{
    BadInput, Machine, compile, file::LinearAxis, inputs::REFERENCE_VOLTS,
    model::over_compensation_um,
};

/// The file of the heat, next to the INI file: written while LinuxCNC runs.
pub const HEAT: &str = "trueup_heat.bin";
/// The file of the calibration, next to the INI file.
pub const CALIBRATION: &str = "trueup_calibration.bin";

/// An input that the machine file names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct NamedInput {
    /// Signal of the user's HAL files.
    pub signal: String,
    /// Pin of the component.
    pub pin: String,
    /// The name of the machine file.
    pub name: String,
    /// A pin that may give it.
    pub example: &'static str,
}

/// Settings and inputs of the component, from the machine file.
#[derive(Clone, Debug, PartialEq)]
pub struct NoBoard {
    /// The calibration.
    pub blob: Vec<u8>,
    /// Codes of the board's converter for a volt of the sensor.
    pub(super) codes_per_v: Option<f64>,
    /// The most by which an offset goes against a reversal.
    pub(super) against_um: [f64; 3],
    /// Angles turn the tool.
    pub(super) has_head: bool,
    pub(super) inputs: Vec<NamedInput>,
}

impl NoBoard {
    /// Compiles a machine file.
    ///
    /// # Errors
    /// It makes no calibration.
    pub fn of(machine: &Machine) -> Result<Self, BadInput> {
        let compiled = compile(machine)?;
        let mut inputs = Vec::new();
        let of_file = machine.inputs.as_ref();
        if of_file.is_some_and(|it| it.sensor.is_some()) {
            inputs.push(NamedInput {
                signal: "trueup-sensor-v".into(),
                pin: "sensor-v".into(),
                name: "sensor".into(),
                example: "hm2_7i76e.0.7i76.0.0.analogin0, lcec.0.EL3102.ain-0-val",
            });
        }
        for (name, input) in of_file.iter().flat_map(|it| &it.temperatures) {
            inputs.push(NamedInput {
                signal: format!("trueup-temp-{:02}", input.channel),
                pin: format!("temp-{:02}-in", input.channel),
                name: name.clone(),
                example: "lcec.0.EL3202.temp-0-temperature",
            });
        }
        for (name, input) in of_file.iter().flat_map(|it| &it.conditions) {
            inputs.push(NamedInput {
                signal: format!("trueup-condition-{:02}", input.bit),
                pin: format!("condition-{:02}", input.bit),
                name: name.clone(),
                example: "iocontrol.0.coolant-flood",
            });
        }
        // Tool and conditions come together: with one of them the node waits for both.
        let has_conditions = of_file.is_some_and(|it| !it.conditions.is_empty());
        if machine.spindle.tools.is_some() || has_conditions {
            inputs.push(NamedInput {
                signal: "trueup-tool".into(),
                pin: "tool".into(),
                name: "tool".into(),
                example: "iocontrol.0.tool-number",
            });
        }
        let codes_per_volt = f64::from(Code::FULL_SCALE) / REFERENCE_VOLTS;
        Ok(Self {
            blob: compiled.blob().to_vec(),
            codes_per_v: of_file
                .and_then(|it| it.sensor.as_ref())
                .map(|it| it.divider * codes_per_volt),
            against_um: LinearAxis::ALL.map(|axis| over_compensation_um(machine, axis)),
            has_head: !machine.head_axes.is_empty(),
            inputs,
        })
    }
}
