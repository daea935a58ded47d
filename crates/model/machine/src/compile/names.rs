//! Which machine and board a calibration is for, and what it takes for a cold one.

use trueup_core::{calibration::Names, units::Temperature};
use trueup_store::calibration::MAX_COLD_WITHIN;

use crate::{file::Machine, location::BadInput, stored::rounded};

const PER_KELVIN: f64 = Temperature::PER_KELVIN as f64;

/// Returns the names on the board.
pub(super) fn names(machine: &Machine) -> Names<'_> {
    Names {
        machine: machine.name.as_bytes(),
        serial: machine.serial.as_deref().unwrap_or_default().as_bytes(),
        board: machine.board.unwrap_or_default(),
    }
}

/// Returns a name as a user writes it; `None`: there is none.
pub(super) fn text(stored: &[u8]) -> Option<String> {
    Some(String::from_utf8_lossy(stored).into_owned()).filter(|text| !text.trim().is_empty())
}

/// Within how much the thermometers of a cold machine agree, on the board.
pub(super) fn cold_within(machine: &Machine) -> Result<Temperature, BadInput> {
    let within = machine.cold_within_c;
    let stored = rounded(within * PER_KELVIN).map(Temperature);
    stored.filter(|it| (Temperature(0)..=MAX_COLD_WITHIN).contains(it)).ok_or_else(|| {
        let most = cold_within_c(MAX_COLD_WITHIN);
        let rule = format!("{within} is not within 0 to {most} °C, the most that the board allows");
        machine.places.bad("thermal_state.cold_within_c", rule)
    })
}

/// Returns the same as a user writes it.
pub(super) fn cold_within_c(stored: Temperature) -> f64 {
    f64::from(stored.0) / PER_KELVIN
}
