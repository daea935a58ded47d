//! Something in a file that can be, and hardly ever is.

use crate::{
    location::{InputFileError, Location},
    machine_file::Machine,
};

/// Something in a file that can be, and hardly ever is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// Where.
    pub place: Location,
    /// The doubted value, and why it is doubted.
    pub what: String,
    /// The remedy.
    pub help: String,
}

impl Warning {
    /// Of the key of a machine file; `what` goes on after the key: "40000 is beyond …".
    pub(super) fn for_key(
        machine: &Machine,
        key: &str,
        what: &str,
        help: impl Into<String>,
    ) -> Self {
        let InputFileError { place, rule, .. } = machine.places.key_error(key, what);
        Self { place, what: rule, help: help.into() }
    }
}
