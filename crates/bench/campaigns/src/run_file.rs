//! Runs with columns or readings changed, written and read again as a user's run file.

use std::{fmt::Write as _, path::Path};

use anyhow::Result;
use trueup_machine::RunFile;

/// Returns the columns of `run`, and `more` next to or in the place of them, as a run file.
///
/// # Errors
/// None that is known: what was read can be read again.
pub fn with_columns(run: &RunFile, more: &[(String, Vec<f64>)]) -> Result<RunFile> {
    let is_replaced = |name: &str| more.iter().any(|(other, _)| other == name);
    let own = run.columns().iter().filter(|column| !is_replaced(&column.name));
    let own = own.map(|column| (column.name.as_str(), &column.values[..]));
    let more = more.iter().map(|(name, values)| (name.as_str(), values.as_slice()));
    let columns: Vec<(&str, &[f64])> = own.chain(more).collect();
    let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    let mut text = names.join(",") + "\n";
    for row in 0..run.row_count() {
        for (number, (_, values)) in columns.iter().enumerate() {
            if number > 0 {
                text.push(',');
            }
            if values[row].is_finite() {
                let _ = write!(text, "{}", values[row]);
            }
        }
        text.push('\n');
    }
    Ok(RunFile::from_reader(text.as_bytes(), run.path())?)
}

/// Returns `run` without what was measured in the rows for which `is_hidden` holds: the machine has lived through
/// them, unmeasured.
///
/// # Errors
/// The column is not there.
pub fn without_readings(
    run: &RunFile,
    measured: &str,
    is_hidden: impl Fn(usize) -> bool,
) -> Result<RunFile> {
    let values = run.require_column(measured)?.iter().enumerate();
    let kept = values.map(|(row, um)| if is_hidden(row) { f64::NAN } else { *um }).collect();
    with_columns(run, &[(measured.into(), kept)])
}

/// Returns a run file from text.
///
/// # Errors
/// It is none.
pub fn parse_run(csv: &str, name: &str) -> Result<RunFile> {
    Ok(RunFile::from_reader(csv.as_bytes(), Path::new(name))?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hidden_reading_is_missing_and_all_else_is_as_it_was() {
        let run = parse_run("time_s,measured_dx_um\n0.5,1.25\n1.5,-3\n", "r.csv").expect("a run");
        let hidden = without_readings(&run, "measured_dx_um", |row| row == 1).expect("there");
        assert_eq!(hidden.column("time_s"), run.column("time_s"));
        let left = hidden.column("measured_dx_um").expect("there");
        assert!(left[0] == 1.25 && left[1].is_nan());
        let more = with_columns(&run, &[("quality".into(), vec![1.0, 2.0])]).expect("written");
        assert_eq!(more.column("quality"), Some(&[1.0, 2.0][..]));
    }
}
