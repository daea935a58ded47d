//! A hold-out: the columns that it must have, and whether it is new.

use std::collections::HashSet;

use trueup_machine::{
    InputFileError, Machine, RunFile, machine_file::Term, model::required_columns,
};

use crate::{data::DataTable, extension_terms::ExtensionTerms, model::Model};

/// Measured rows not used for the fit.
pub(crate) struct HoldOut<'h> {
    pub files: &'h [RunFile],
    pub data: DataTable,
}

impl HoldOut<'_> {
    /// Every column that a term of `model`, found in the runs `training`, cannot do without is there.
    ///
    /// # Errors
    /// One is missing: with the file, the column and the term.
    pub(super) fn check_required_columns(
        &self,
        training: &DataTable,
        model: &Model,
    ) -> Result<(), InputFileError> {
        let machine = &training.setting.machine;
        let ExtensionTerms { replaced, new } = ExtensionTerms::from_model(training, model);
        for term in replaced.into_iter().map(|(_, term)| term).chain(new) {
            for column in additional_required_columns(machine, &term) {
                for file in self.files {
                    file.require_column(&column).map_err(|missing| {
                        let cause = term.effect.name();
                        let rule = format!("{}; the term {cause} needs it", missing.rule);
                        InputFileError::new(missing.place, rule)
                    })?;
                }
            }
        }
        Ok(())
    }
}

/// Returns the columns that `term` needs beyond those of `machine`.
fn additional_required_columns(machine: &Machine, term: &Term) -> Vec<String> {
    let own = required_columns(machine);
    let with = Machine { terms: vec![term.clone()], ..machine.clone() };
    required_columns(&with).into_iter().filter(|column| !own.contains(column)).collect()
}

/// Returns the hold-outs whose every row is a row of the runs, whatever their files are called: a sentence each.
pub(crate) fn describe_duplicate_hold_outs(runs: &[RunFile], files: &[RunFile]) -> Vec<String> {
    let is_seen = |file: &&RunFile| runs.iter().any(|run| has_all_rows(run, file));
    let describe = |file: &RunFile| {
        format!(
            "{}: every row of this hold-out is a row of the runs, so that it measures nothing new",
            file.path().display()
        )
    };
    files.iter().filter(is_seen).map(describe).collect()
}

/// Returns whether each row of `file` is in `run`: the same values in the columns that both have.
fn has_all_rows(run: &RunFile, file: &RunFile) -> bool {
    let columns = file.columns().iter();
    let both: Vec<(&[f64], &[f64])> = columns
        .filter_map(|column| Some((run.column(&column.name)?, &column.values[..])))
        .collect();
    if file.row_count() == 0 || both.len() < 2 {
        return false;
    }
    // A missing value is as good as another.
    let bits = |value: f64| if value.is_nan() { 0 } else { value.to_bits() };
    let known: HashSet<Vec<u64>> = (0..run.row_count())
        .map(|row| both.iter().map(|(there, _)| bits(there[row])).collect())
        .collect();
    (0..file.row_count()).all(|row| {
        known.contains(&both.iter().map(|(_, here)| bits(here[row])).collect::<Vec<u64>>())
    })
}
