//! How far each part of a calibration is from the model, and what is too far.

use crate::{location::InputFileError, machine_file::Machine};

/// A part of a calibration further than this from the model, in nm anywhere in its range, is
/// refused.
pub(crate) const MAX_MODEL_DIFFERENCE_NM: f64 = 2.0;

/// The compiled parts of a machine, each with its largest difference from the model.
pub(super) struct PartDifferences<'m> {
    pub(super) machine: &'m Machine,
    pub(super) parts: Vec<(String, f64)>,
}

impl PartDifferences<'_> {
    /// Takes up what became of the section `key`, and refuses what is too far from the model.
    pub(super) fn check_and_record_difference<T>(
        &mut self,
        key: &str,
        made: Result<(T, f64), String>,
    ) -> Result<T, InputFileError> {
        let bad = |rule: String| self.machine.places.key_error(key, rule);
        let (table, difference_nm) = made.map_err(bad)?;
        if difference_nm > MAX_MODEL_DIFFERENCE_NM {
            return Err(bad(format!(
                "would be {difference_nm:.1} nm off on the board, more than \
                 {MAX_MODEL_DIFFERENCE_NM} nm"
            )));
        }
        self.parts.push((key.to_string(), difference_nm));
        Ok(table)
    }
}
