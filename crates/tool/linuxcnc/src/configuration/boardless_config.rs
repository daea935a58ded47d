//! The bridge without a board: its calibration, its settings and its inputs, from the machine file.

use trueup_core::units::AdcCode;
use trueup_machine::{
    InputFileError, Machine, compile,
    inputs::ADC_REFERENCE_VOLTS,
    machine_file::LinearAxis,
    model::{max_over_compensation_um, required_columns},
};

use super::inputs::NamedInput;

/// The file of the heat, next to the INI file: written while LinuxCNC runs.
pub(crate) const THERMAL_STATE_FILE: &str = "trueup_heat.bin";
/// The file of the calibration, next to the INI file.
pub(crate) const CALIBRATION_FILE: &str = "trueup_calibration.bin";

/// Settings and inputs of the component, from the machine file.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardlessConfig {
    /// The calibration.
    pub blob: Vec<u8>,
    /// Codes of the board's converter for a volt of the sensor.
    pub(super) codes_per_v: Option<f64>,
    /// The most by which an offset goes against a reversal.
    pub(super) against_um: [f64; 3],
    /// It has models by heat, which a start without what was kept does not know.
    pub(super) has_heat: bool,
    /// Sensor and thermometers.
    pub(super) inputs: Vec<NamedInput>,
}

impl BoardlessConfig {
    /// Compiles a machine file.
    ///
    /// # Errors
    /// It makes no calibration.
    pub fn from_machine(machine: &Machine) -> Result<Self, InputFileError> {
        let compiled = compile(machine)?;
        let mut inputs = Vec::new();
        let of_file = machine.inputs.as_ref();
        if of_file.is_some_and(|inputs| inputs.sensor.is_some()) {
            inputs.push(NamedInput {
                signal: "trueup-sensor-v".into(),
                pin: "sensor-v".into(),
                name: "sensor".into(),
                example: "hm2_7i76e.0.7i76.0.0.analogin0, lcec.0.EL3102.ain-0-val".into(),
            });
        }
        for (name, input) in of_file.iter().flat_map(|inputs| &inputs.temperatures) {
            inputs.push(NamedInput {
                signal: format!("trueup-temp-{:02}", input.channel),
                pin: format!("temp-{:02}-in", input.channel),
                name: name.clone(),
                example: "lcec.0.EL3202.temp-0-temperature".into(),
            });
        }
        let codes_per_volt = f64::from(AdcCode::FULL_SCALE) / ADC_REFERENCE_VOLTS;
        Ok(Self {
            blob: compiled.blob().to_vec(),
            codes_per_v: of_file
                .and_then(|inputs| inputs.sensor.as_ref())
                .map(|sensor| sensor.divider * codes_per_volt),
            has_heat: required_columns(machine).iter().any(|column| column == "time_s"),
            against_um: LinearAxis::ALL.map(|axis| max_over_compensation_um(machine, axis)),
            inputs,
        })
    }
}
