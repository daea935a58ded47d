//! Renishaw's target data (`.rtl` linear, `.rta` angular), as its laser software saves them.
//!
//! Sources: public readers of the form (github.com, searched 2026-11 by the words "Run Target Data"): sections end in
//! `::`; `TARGET DATA::` has `Target-count: N` and `Targets :`, whose numbers may go over several lines, up to
//! `Flags:`; `RUNS::` has `Run-count: N`; `DEVIATIONS::` has `Run Target Data:`, and below it a line `run target
//! deviation` for each reading, targets counted from 1. No unit stands in the file, and none is taken for granted.
//! Not tried: a file of the instrument itself.

use std::path::Path;

use trueup_machine::{InputFileError, Location};

use super::{build_source_column, known_meaning, number_cell};
use crate::{
    answers::{ImportAnswers, ImportError, Question, QuestionTopic},
    cell_grid::CellRow,
    column_meaning::ColumnMeaning,
    layout::SourceTable,
};

pub(super) fn matches_format(text: &str) -> bool {
    text.contains("Run Target Data") && text.contains("Targets")
}

struct RtlReading {
    line: usize,
    run: u32,
    target: usize,
    deviation: f64,
}

/// Reads the runs of a file, in the order in which they stand there.
pub(super) fn parse(
    text: &str,
    answers: &ImportAnswers,
    path: &Path,
) -> Result<SourceTable, ImportError> {
    let place = |line: usize| Location { file: path.into(), line, column: 1 };
    let bad = |line: usize, rule: String| ImportError::from(InputFileError::new(place(line), rule));
    let (mut targets, mut readings) = (Vec::new(), Vec::new());
    let mut stated = None;
    let (mut first_target, mut first_reading) = (1, 1);
    let mut part = "";
    for (at, line) in text.lines().enumerate() {
        let (at, line) = (at + 1, line.trim());
        if line.ends_with("::") {
            part = "";
            continue;
        }
        if let Some((key, value)) = line.split_once(':') {
            let key = key.trim().to_lowercase();
            part = match key.as_str() {
                "targets" => "targets",
                "run target data" => "deviations",
                _ => "",
            };
            if key == "target-count" {
                stated = value.trim().parse::<usize>().ok();
            }
            if part == "targets" {
                first_target = at;
                targets.extend(
                    parse_numbers(value)
                        .ok_or_else(|| bad(at, format!("{value} are no targets")))?,
                );
            }
            if part == "deviations" {
                first_reading = at;
            }
            continue;
        }
        match part {
            "targets" => targets.extend(
                parse_numbers(line).ok_or_else(|| bad(at, format!("{line} are no targets")))?,
            ),
            "deviations" if !line.is_empty() => {
                let parts = parse_numbers(line).unwrap_or_default();
                let &[run, target, deviation] = &parts[..] else {
                    return Err(bad(at, format!("{line} is not run, target and deviation")));
                };
                let is_there =
                    target >= 1.0 && target <= targets.len() as f64 && target.fract() == 0.0;
                if !is_there || run < 1.0 || run.fract() != 0.0 {
                    return Err(bad(at, format!("there is no target {target} in run {run}")));
                }
                readings.push(RtlReading {
                    line: at,
                    run: run as u32,
                    target: target as usize - 1,
                    deviation,
                });
            }
            _ => {}
        }
    }
    if let Some(stated) = stated
        && stated != targets.len()
    {
        return Err(bad(
            first_target,
            format!("Target-count is {stated}, there are {} targets", targets.len()),
        ));
    }
    if readings.len() < 2 {
        return Err(bad(first_reading, "there are no deviations".into()));
    }
    let run_directions =
        determine_run_directions(&readings, &targets, answers, &place(first_reading))?;
    let places = [place(first_target), place(first_reading)];
    Ok(build_table(&readings, &targets, &run_directions, &places))
}

/// Returns the readings as a table, with a column of directions where there are any. `places` are those of the targets
/// and of the deviations.
fn build_table(
    readings: &[RtlReading],
    targets: &[f64],
    run_directions: &[Option<f64>],
    [at_targets, at_readings]: &[Location; 2],
) -> SourceTable {
    let has_ways = run_directions.iter().any(Option::is_some);
    let rows = readings.iter().zip(run_directions).map(|(reading, way)| {
        let mut values = vec![f64::from(reading.run), targets[reading.target]];
        values.extend(has_ways.then(|| way.unwrap_or(f64::NAN)));
        values.push(reading.deviation);
        CellRow { line: reading.line, cells: values.into_iter().map(number_cell).collect() }
    });
    let mut columns = vec![
        build_source_column("run", known_meaning("run"), "", at_readings),
        build_source_column("target", ColumnMeaning::Position, "", at_targets),
    ];
    if has_ways {
        columns.push(build_source_column("way", ColumnMeaning::Direction, "", at_readings));
    }
    columns.push(build_source_column("deviation", ColumnMeaning::Measured, "", at_readings));
    SourceTable { columns, rows: rows.collect(), notes: Vec::new() }
}

fn parse_numbers(text: &str) -> Option<Vec<f64>> {
    let number = |word: &str| word.parse::<f64>().ok().filter(|value| value.is_finite());
    text.split_whitespace().map(number).collect()
}

/// Returns the direction of each run: by the order of its targets. Where all runs are written in one order, only the
/// user knows whether every second one went back.
fn determine_run_directions(
    readings: &[RtlReading],
    targets: &[f64],
    answers: &ImportAnswers,
    place: &Location,
) -> Result<Vec<Option<f64>>, ImportError> {
    let mut runs: Vec<u32> = readings.iter().map(|reading| reading.run).collect();
    runs.dedup();
    let way_of = |run: u32| {
        let places: Vec<f64> = readings
            .iter()
            .filter(|reading| reading.run == run)
            .map(|reading| targets[reading.target])
            .collect();
        match (places.first(), places.last()) {
            (Some(first), Some(last)) if last > first => Some(1.0),
            (Some(first), Some(last)) if last < first => Some(-1.0),
            _ => None,
        }
    };
    let by_order: Vec<Option<f64>> = runs.iter().map(|run| way_of(*run)).collect();
    let is_one_order = by_order.windows(2).all(|pair| pair[0] == pair[1]);
    let way = |run: u32| -> Option<f64> {
        let at = runs.iter().position(|candidate| *candidate == run)?;
        match answers.there_and_back.filter(|_| is_one_order) {
            Some(true) if at % 2 == 1 => by_order[at].map(|way| -way),
            _ => by_order[at],
        }
    };
    if is_one_order && runs.len() > 1 && answers.there_and_back.is_none() {
        return Err(ImportError::Open(vec![Question {
            place: place.clone(),
            text: "all runs are written in one order: did every second one go back?".into(),
            topic: QuestionTopic::Runs,
            choices: vec!["there-and-back".into(), "one-way".into()],
            is_open: false,
        }]));
    }
    Ok(readings.iter().map(|reading| way(reading.run)).collect())
}
