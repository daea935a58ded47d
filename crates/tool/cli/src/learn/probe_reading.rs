//! A reading of this moment next to the record of the hours before it.

use std::{
    path::Path,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use anyhow::Result;
use trueup_machine::{RunFile, machine_file::Quantity};

use crate::{UserError, input_files};

/// The record has the last hours: some megabytes.
const MAX_RECORD_BYTES: u64 = 64 << 20;

/// A record that is older belongs to another moment: `trueup linuxcnc --record` writes a row every two seconds.
const MAX_RECORD_AGE_S: f64 = 60.0;

/// Returns the record at `path`, with a reading of the growth (or of another quantity) in its last row.
///
/// # Errors
/// It cannot be read, is no run file, measures something already, or does not end now.
pub fn read_record_with_reading(
    path: &Path,
    quantity: Option<Quantity>,
    um: f64,
    now: SystemTime,
) -> Result<RunFile> {
    let bad = |rule: String| UserError(format!("{}: {rule}", path.display()));
    let text = input_files::read_text(path, MAX_RECORD_BYTES)?;
    let measured = quantity.unwrap_or(Quantity::Elongation).name();
    let mut lines = text.lines();
    let header = lines.next().unwrap_or_default();
    let mut with = format!("{header},measured_{measured}_um");
    let rows: Vec<&str> = lines.collect();
    for (number, row) in rows.iter().enumerate() {
        let is_last = number + 1 == rows.len();
        with += &if is_last { format!("\n{row},{um}") } else { format!("\n{row},") };
    }
    with.push('\n');
    let run = RunFile::from_reader(with.as_bytes(), path)?;
    let now_s = now.duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs_f64();
    let last_s = run.require_column("time_s")?.last().copied().unwrap_or(f64::NAN);
    let age_s = now_s - last_s;
    if !(-1.0..=MAX_RECORD_AGE_S).contains(&age_s) {
        return Err(bad(format!(
            "its last row is {age_s:.0} s old, and a reading belongs to one of the last \
             {MAX_RECORD_AGE_S:.0} s. Does trueup linuxcnc --record write it, by the same clock?"
        ))
        .into());
    }
    Ok(run)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_reading_stands_in_the_last_row_and_an_old_record_takes_none() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("record.csv");
        fs::write(&path, "time_s,temp_a_c\n1000,20.5\n1002,20.6\n").expect("it can be written");
        let at = |s: f64| {
            read_record_with_reading(&path, None, -3.25, UNIX_EPOCH + Duration::from_secs_f64(s))
        };
        let run = at(1050.0).expect("a minute has not passed");
        let read = run.column("measured_elongation_um").expect("there");
        assert!(read[0].is_nan() && read[1] == -3.25, "{read:?}");
        for (now_s, age) in [(1063.0, "61 s old"), (900.0, "-102 s old")] {
            let why = at(now_s).expect_err("of another moment").to_string();
            assert!(why.contains(age), "{why}");
        }
    }
}
