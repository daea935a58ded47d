//! The faults of a run file, listed up to a limit: a logger that writes decimal commas has a fault in
//! every row.

use crate::location::{InputFileError, MAX_LISTED_ERRORS};

/// The faults so far: what is not listed is counted.
#[derive(Default)]
pub(super) struct InputErrorList {
    /// In the order of the file.
    listed: Vec<InputFileError>,
    unlisted: usize,
}

impl InputErrorList {
    pub(super) fn push(&mut self, fault: InputFileError) {
        if self.listed.len() < MAX_LISTED_ERRORS {
            self.listed.push(fault);
        } else {
            self.unlisted += 1;
        }
    }

    pub(super) fn count(&self) -> usize {
        self.listed.len() + self.unlisted
    }

    /// Returns all of them as one; `None` without any.
    pub(super) fn into_error(self) -> Option<InputFileError> {
        let error = InputFileError::combine(self.listed)?;
        Some(InputFileError { unlisted: error.unlisted + self.unlisted, ..error })
    }
}
