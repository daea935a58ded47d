//! `[instrument]`: what the machine is measured with.

use super::{read::Section, write::section::NewSection};
use crate::location::BadInput;

/// Returns the expanded uncertainty of one reading in µm (95 %), above 0.
pub(super) fn read(section: &Section<'_>) -> Result<f64, BadInput> {
    section.required("uncertainty_um", section.positive("uncertainty_um")?)
}

pub(super) fn write(uncertainty_um: f64) -> NewSection {
    NewSection::new("instrument").number("uncertainty_um", uncertainty_um)
}
