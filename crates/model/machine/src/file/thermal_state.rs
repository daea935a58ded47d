//! `[thermal_state]`: what the board takes for a machine that has no heat of its own.

use super::{read::Section, write::section::NewSection};
use crate::location::BadInput;

/// Without the section: class B of IEC 60751 is ±0.4 K at 20 °C.
pub(super) const COLD_WITHIN_C: f64 = 0.5;

/// Thermometers that agree within this in °C belong to a cold machine; at least 0.
pub(super) fn read(section: &Section<'_>) -> Result<f64, BadInput> {
    section.required("cold_within_c", section.not_negative("cold_within_c")?)
}

pub(super) fn write(cold_within_c: f64) -> NewSection {
    NewSection::new("thermal_state").number("cold_within_c", cold_within_c)
}
