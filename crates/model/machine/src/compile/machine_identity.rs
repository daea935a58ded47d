//! Which machine and board a calibration is for, and what it takes for a cold one.

use trueup_core::{calibration::MachineIdentity, units::Temperature};
use trueup_store::calibration::MAX_COLD_TOLERANCE;

use crate::{location::InputFileError, machine_file::Machine, unit_conversion::round_to_i32};

const UNITS_PER_KELVIN: f64 = Temperature::PER_KELVIN as f64;

/// Returns the names on the board.
pub(super) fn compile_identity(machine: &Machine) -> MachineIdentity<'_> {
    MachineIdentity {
        machine: machine.name.as_bytes(),
        serial: machine.serial.as_deref().unwrap_or_default().as_bytes(),
        board: machine.board.unwrap_or_default(),
    }
}

/// Returns a name as a user writes it; `None`: there is none.
pub(super) fn decode_name(stored: &[u8]) -> Option<String> {
    Some(String::from_utf8_lossy(stored).into_owned()).filter(|text| !text.trim().is_empty())
}

/// Within how much the thermometers of a cold machine agree, on the board.
pub(super) fn compile_cold_tolerance(machine: &Machine) -> Result<Temperature, InputFileError> {
    let within = machine.cold_within_c;
    let stored = round_to_i32(within * UNITS_PER_KELVIN).map(Temperature);
    stored.filter(|stored| (Temperature(0)..=MAX_COLD_TOLERANCE).contains(stored)).ok_or_else(
        || {
            let most = decompile_cold_tolerance_c(MAX_COLD_TOLERANCE);
            let rule =
                format!("{within} is not within 0 to {most} °C, the most that the board allows");
            machine.places.key_error("thermal_state.cold_within_c", rule)
        },
    )
}

/// Returns the same as a user writes it.
pub(super) fn decompile_cold_tolerance_c(stored: Temperature) -> f64 {
    f64::from(stored.0) / UNITS_PER_KELVIN
}
