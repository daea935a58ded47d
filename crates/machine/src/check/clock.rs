//! The clock of a run: an hour of summer time, and gaps in a record that is otherwise regular.

use super::warning::Warning;
use crate::run_file::RunFile;

/// Steps that make a record regular: so many, of which this share is within a tenth of the median.
const FEWEST_STEPS: usize = 50;
const REGULAR: f64 = 0.95;
const TENTH: f64 = 0.1;
/// A step of so many medians is a gap.
const GAP: f64 = 20.0;
/// A change to summer time, in s.
const HOUR_S: f64 = 3600.0;
/// The longest step, in s, next to which an hour can be told from a pause of the logger.
const LONGEST_STEP_S: f64 = 600.0;

/// Returns a warning for the first step of an hour, and one for the first gap.
pub(super) fn warnings(run: &RunFile) -> Vec<Warning> {
    let Some(time_s) = run.column("time_s") else { return Vec::new() };
    let runs = run.column("run");
    let rows: Vec<usize> = (0..time_s.len()).filter(|row| !time_s[*row].is_nan()).collect();
    let is_one_run = |pair: &[usize]| runs.is_none_or(|runs| runs[pair[0]] == runs[pair[1]]);
    let steps: Vec<(usize, f64)> = rows
        .windows(2)
        .filter(|pair| is_one_run(pair))
        .map(|pair| (pair[1], time_s[pair[1]] - time_s[pair[0]]))
        .collect();
    let mut sorted: Vec<f64> = steps.iter().map(|(_, step_s)| *step_s).collect();
    sorted.sort_by(f64::total_cmp);
    let Some(&median_s) = sorted.get(sorted.len() / 2) else { return Vec::new() };
    let near =
        sorted.iter().filter(|step_s| (**step_s - median_s).abs() <= TENTH * median_s).count();
    let is_regular = median_s > 0.0 && near as f64 >= REGULAR * sorted.len() as f64;
    if sorted.len() < FEWEST_STEPS || !is_regular {
        return Vec::new();
    }
    let is_hour = |step_s: f64| {
        let rest_s = step_s - HOUR_S;
        median_s <= LONGEST_STEP_S && (0.5 * median_s..=1.5 * median_s).contains(&rest_s)
    };
    let at = |row: usize, what: String, help: &str| Warning {
        place: run.place(row, "time_s"),
        what,
        help: help.into(),
    };
    let hour = steps.iter().find(|(_, step_s)| is_hour(*step_s)).map(|(row, step_s)| {
        let what = format!(
            "time_s steps by {step_s} s here, an hour more than between the other rows: the begin of summer time, or a pause"
        );
        at(*row, what, "if the clock was changed, take 3600 s off from here on: lags and drifts are fitted to the time")
    });
    let gap = steps.iter().find(|(_, step_s)| *step_s > GAP * median_s && !is_hour(*step_s));
    let gap = gap.map(|(row, step_s)| {
        let what = format!("time_s has a gap of {step_s} s here, the other rows are {median_s} s apart");
        at(*row, what, "number the parts in a column run: each then starts settled; or look for a clock that was set")
    });
    hour.into_iter().chain(gap).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// A row each 60 s, with these steps in the place of others; `run` changes at the rows of `parts`.
    fn found(steps: &[(usize, f64)], parts: &[usize]) -> Vec<String> {
        let (mut text, mut time_s, mut part) = (String::from("time_s,run,flow\n"), 0.0, 0);
        for row in 0..120 {
            let step = steps.iter().find(|(at, _)| *at == row).map_or(60.0, |(_, step_s)| *step_s);
            time_s += step;
            part += usize::from(parts.contains(&row));
            text += &format!("{time_s},{part},1\n");
        }
        let run =
            RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run");
        let line = |it: Warning| format!("{}: {}", it.place.line, it.what);
        warnings(&run).into_iter().map(line).collect()
    }

    #[test]
    fn an_hour_and_a_gap_are_told_with_their_line_and_a_new_run_is_neither() {
        assert!(found(&[], &[]).is_empty());
        assert!(
            found(&[(40, 3660.0)], &[])
                .iter()
                .all(|it| it.starts_with("42: ") && it.contains("summer"))
        );
        assert_eq!(found(&[(40, 3660.0)], &[]).len(), 1);
        let gap = found(&[(70, 5000.0)], &[]);
        assert!(gap.len() == 1 && gap[0].starts_with("72: time_s has a gap of 5000 s"), "{gap:?}");
        assert!(found(&[(40, 3660.0)], &[40]).is_empty());
        // Pauses of a person who writes are none.
        let by_hand: Vec<(usize, f64)> =
            (0..120).map(|row| (row, 20.0 + (row * 7 % 50) as f64)).collect();
        assert!(found(&[&by_hand[..60], &[(70, 9000.0)]].concat(), &[]).is_empty());
    }
}
