//! `extended.toml`: the user's machine file as it is, comments and all, with the terms after it.

use std::path::Path;

use trueup_machine::{
    BadInput,
    file::{Term, write::Edit},
};

/// `source` with `terms` at the end of its terms. It is read back, so that what is handed out can
/// be loaded.
///
/// # Errors
/// `source` is no machine file.
pub(crate) fn extended(source: &str, path: &Path, terms: &[Term]) -> Result<String, BadInput> {
    let appended = terms.iter().map(Term::section).collect();
    Edit { appended, ..Edit::default() }.apply(source, path)
}
