//! Columns of few values that a CNC could send to the board: what to declare so that it does.

use std::collections::BTreeSet;

use crate::{
    compile::first_free_condition_bit,
    inputs::ConditionInput,
    keys::reader::is_temperature_column,
    known_columns::is_known_column,
    machine_file::Machine,
    run_file::{RunColumn, RunFile},
};

/// More values than that are a quantity, fewer rows of one are chance: as a diagnosis has it (docs/reference.md,
/// Run files).
const MAX_COLUMN_LEVELS: usize = 12;
const MIN_LEVEL_ROWS: usize = 8;
/// Columns that a recorder writes next to the known ones.
const RECORDER_COLUMNS: [&str; 3] = ["flags", "age_ms", "elongation_um"];

/// Returns a sentence for each column of `run` that has few values and is no condition in `machine` yet.
#[must_use]
pub fn suggest_condition_columns(run: &RunFile, machine: Option<&Machine>) -> Vec<String> {
    let mut inputs = machine.and_then(|machine| machine.inputs.clone()).unwrap_or_default();
    let mut sentences = Vec::new();
    for column in run.columns().iter().filter(|column| is_user_column(&column.name)) {
        let Some(levels) = find_discrete_levels(column) else { continue };
        let name = &column.name;
        if inputs.conditions.contains_key(name) {
            continue;
        }
        if levels.iter().any(|level| ![0.0, 1.0].contains(level)) {
            let count = levels.len();
            sentences.push(format!(
                "{name} has {count} values: a board knows a category by the column tool, or by a column of 0 and 1 \
                 for each value"
            ));
        } else if let Some(bit) = first_free_condition_bit(&inputs) {
            sentences.push(format!(
                "{name} is 0 or 1: `{name} = {{ kind = \"condition\", bit = {bit} }}` in [inputs] lets the CNC send \
                 it to the board"
            ));
            inputs.conditions.insert(name.clone(), ConditionInput { bit, default: false });
        }
    }
    sentences
}

fn is_user_column(name: &str) -> bool {
    !is_known_column(name)
        && !is_temperature_column(name)
        && !RECORDER_COLUMNS.contains(&name)
        && !["measured_", "predicted_", "bridge_"].iter().any(|start| name.starts_with(start))
}

/// Returns the values of a column that has few; none of one that stands still.
fn find_discrete_levels(column: &RunColumn) -> Option<Vec<f64>> {
    let there = || column.values.iter().copied().filter(|value| value.is_finite());
    let mut bits: BTreeSet<u64> = BTreeSet::new();
    for value in there() {
        // Zero has two signs.
        bits.insert((value + 0.0).to_bits());
        if bits.len() > MAX_COLUMN_LEVELS {
            return None;
        }
    }
    let levels: Vec<f64> = bits.into_iter().map(f64::from_bits).collect();
    let is_switch = levels.iter().all(|level| [0.0, 1.0].contains(level));
    let rows = |level: f64| there().filter(|value| *value == level).count();
    let is_often = is_switch || levels.iter().all(|level| rows(*level) >= MIN_LEVEL_ROWS);
    (levels.len() > 1 && is_often).then_some(levels)
}
