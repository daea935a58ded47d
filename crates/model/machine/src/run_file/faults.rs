//! The faults of a run file, listed up to a limit: a logger that writes decimal commas has a fault in
//! every row.

use crate::location::{BadInput, MAX_LISTED};

/// The faults so far: what is not listed is counted.
#[derive(Default)]
pub(super) struct Faults {
    /// In the order of the file.
    listed: Vec<BadInput>,
    unlisted: usize,
}

impl Faults {
    pub(super) fn note(&mut self, fault: BadInput) {
        if self.listed.len() < MAX_LISTED {
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
        let error = BadInput::gathered(self.listed)?;
        Some(BadInput { unlisted: error.unlisted + self.unlisted, ..error })
    }
}
