//! `extended.toml`: the user's machine file unchanged, comments included, with the new terms after it, and
//! new values in the terms that are not right any more.

use std::path::Path;

use trueup_machine::{
    InputFileError, Machine,
    machine_file::{Term, writer::MachineFileEdit},
};

use super::Diagnosis;
use crate::{data::DataTable, extension_terms::ExtensionTerms, model::Model};

/// Returns the extended machine.
pub(crate) fn build_extended_machine(diagnosis: &Diagnosis) -> Machine {
    let mut machine = diagnosis.data.setting.machine.clone();
    for (number, term) in &diagnosis.corrected {
        machine.terms[*number] = term.clone();
    }
    machine.terms.extend(diagnosis.terms.iter().cloned());
    machine
}

/// Returns the machine file of `data`, extended by the terms of `model`.
pub(super) fn extend_machine(data: &DataTable, model: &Model) -> Machine {
    let ExtensionTerms { replaced, new } = ExtensionTerms::from_model(data, model);
    let mut machine = data.setting.machine.clone();
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
pub(crate) fn render_extended_toml(
    source: &str,
    path: &Path,
    corrected: &[(usize, Term)],
    terms: &[Term],
) -> Result<String, InputFileError> {
    let replaced = corrected.iter().map(|(index, term)| (*index, term.to_section())).collect();
    let appended = terms.iter().map(Term::to_section).collect();
    MachineFileEdit { replaced, appended, ..MachineFileEdit::default() }.apply(source, path)
}
