//! The faults of a run file, listed up to a limit: a logger that writes decimal commas has a fault in
//! every row.

use crate::location::{BadInput, MAX_LISTED_FAULTS};

/// The faults so far: what is not listed is counted.
#[derive(Default)]
pub(super) struct FaultList {
    /// In the order of the file.
    listed: Vec<BadInput>,
    unlisted: usize,
}

impl FaultList {
    pub(super) fn push(&mut self, fault: BadInput) {
        if self.listed.len() < MAX_LISTED_FAULTS {
            self.listed.push(fault);
        } else {
            self.unlisted += 1;
        }
    }

    pub(super) fn count(&self) -> usize {
        self.listed.len() + self.unlisted
    }

    /// Returns all of them as one; `None` without any.
    pub(super) fn into_error(self) -> Option<BadInput> {
        let error = BadInput::combine(self.listed)?;
        Some(BadInput { unlisted: error.unlisted + self.unlisted, ..error })
    }
}
