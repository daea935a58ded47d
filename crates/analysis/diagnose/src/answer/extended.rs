//! `extended.toml`: the user's machine file as it is, comments and all, with the new terms after it, and
//! new values in the terms that are not right any more.

use std::path::Path;

use trueup_machine::{
    BadInput, Machine,
    file::{Term, write::Edit},
};

use super::Diagnosis;
use crate::{data::Data, model::Model, terms::Extended};

/// Returns the extended machine.
pub(crate) fn machine(diagnosis: &Diagnosis) -> Machine {
    let mut machine = diagnosis.data.machine.clone();
    for (number, term) in &diagnosis.corrected {
        machine.terms[*number] = term.clone();
    }
    machine.terms.extend(diagnosis.terms.iter().cloned());
    machine
}

/// Returns the machine file of `data`, extended by the terms of `model`.
pub(super) fn extended_by(data: &Data, model: &Model) -> Machine {
    let Extended { replaced, new } = Extended::by(data, model);
    let mut machine = data.machine.clone();
    for (number, term) in replaced {
        machine.terms[number] = term;
    }
    machine.terms.extend(new);
    machine
}

/// `source` with `terms` at the end of its terms, and `corrected` in the place of those of these
/// numbers. It is read back, so that what is handed out can be loaded.
///
/// # Errors
/// `source` is no machine file.
pub(crate) fn extended(
    source: &str,
    path: &Path,
    corrected: &[(usize, Term)],
    terms: &[Term],
) -> Result<String, BadInput> {
    let replaced = corrected.iter().map(|(index, term)| (*index, term.section())).collect();
    let appended = terms.iter().map(Term::section).collect();
    Edit { replaced, appended, ..Edit::default() }.apply(source, path)
}
