//! A hold-out: the columns that it must have, and whether it is new.

use std::collections::HashSet;

use trueup_machine::{BadInput, Machine, RunFile, file::Term, model::required_columns};

use crate::{data::Data, model::Model, terms::Extended};

/// Measured rows that nothing is fitted to.
pub(crate) struct HoldOut<'h> {
    pub files: &'h [RunFile],
    pub data: Data,
}

impl HoldOut<'_> {
    /// Every column that a term of `model`, found in the runs `training`, cannot do without is there.
    ///
    /// # Errors
    /// One is missing: with the file, the column and the term.
    pub(super) fn check(&self, training: &Data, model: &Model) -> Result<(), BadInput> {
        let machine = &training.machine;
        let Extended { replaced, new } = Extended::by(training, model);
        for term in replaced.into_iter().map(|(_, term)| term).chain(new) {
            for column in columns_of(machine, &term) {
                for file in self.files {
                    file.require(&column).map_err(|missing| {
                        let cause = term.effect.name();
                        let rule = format!("{}; the term {cause} needs it", missing.rule);
                        BadInput::new(missing.place, rule)
                    })?;
                }
            }
        }
        Ok(())
    }
}

/// Returns the columns that `term` needs beyond those of `machine`.
fn columns_of(machine: &Machine, term: &Term) -> Vec<String> {
    let own = required_columns(machine);
    let with = Machine { terms: vec![term.clone()], ..machine.clone() };
    required_columns(&with).into_iter().filter(|column| !own.contains(column)).collect()
}

/// Returns the hold-outs whose every row is a row of the runs, whatever their files are called: a sentence each.
pub(crate) fn seen_before(runs: &[RunFile], files: &[RunFile]) -> Vec<String> {
    let is_seen = |file: &&RunFile| runs.iter().any(|run| has_all_rows(run, file));
    let told = |file: &RunFile| {
        format!(
            "{}: every row of this hold-out is a row of the runs, so that it measures nothing new",
            file.path().display()
        )
    };
    files.iter().filter(is_seen).map(told).collect()
}

/// Returns whether each row of `file` is in `run`: the same values in the columns that both have.
fn has_all_rows(run: &RunFile, file: &RunFile) -> bool {
    let columns = file.columns().iter();
    let both: Vec<(&[f64], &[f64])> = columns
        .filter_map(|column| Some((run.column(&column.name)?, &column.values[..])))
        .collect();
    if file.rows() == 0 || both.len() < 2 {
        return false;
    }
    // A missing value is as good as another.
    let bits = |value: f64| if value.is_nan() { 0 } else { value.to_bits() };
    let known: HashSet<Vec<u64>> = (0..run.rows())
        .map(|row| both.iter().map(|(there, _)| bits(there[row])).collect())
        .collect();
    (0..file.rows()).all(|row| {
        known.contains(&both.iter().map(|(_, here)| bits(here[row])).collect::<Vec<u64>>())
    })
}
