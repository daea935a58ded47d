//! LinuxCNC's `[JOINT_n] COMP_FILE`: a line is `nominal forward reverse` in machine units.
//!
//! Source: LinuxCNC 2.9, `docs/src/config/ini-config.adoc`, and its own HAL component as `host-tests` runs it. With
//! `COMP_FILE_TYPE = 0` the two values are actual positions, the error is actual minus nominal; with 1 they are trims
//! that are added to the command, the error is minus the trim. Positions are like the nominal one, trims are not: so
//! the values show the type.

use std::path::Path;

use trueup_machine::{InputFileError, Location};

use super::{build_source_column, known_meaning, number_cell};
use crate::{cell_grid::CellRow, column_meaning::ColumnMeaning, layout::SourceTable};

pub(super) fn matches_format(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("comp"))
}

/// Reads a compensation file as a pass there and a pass back.
pub(super) fn parse(text: &str, path: &Path) -> Result<SourceTable, InputFileError> {
    let mut lines: Vec<(usize, [f64; 3])> = Vec::new();
    for (at, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let numbers: Vec<f64> =
            line.split_whitespace().map_while(|word| word.parse().ok()).collect();
        let place = Location { file: path.into(), line: at + 1, column: 1 };
        let [nominal, forward, reverse] = numbers[..] else {
            return Err(InputFileError::new(
                place,
                "is not three numbers: nominal forward reverse",
            )
            .with_help("LinuxCNC stops at such a line in silence: correct or delete it"));
        };
        if lines.last().is_some_and(|(_, before)| nominal <= before[0]) {
            return Err(InputFileError::new(
                place,
                format!("the nominal position {nominal} does not rise"),
            ));
        }
        lines.push((at + 1, [nominal, forward, reverse]));
    }
    if lines.len() < 2 {
        let rule = "has fewer than two lines of nominal, forward and reverse";
        return Err(InputFileError::new(Location::start_of_file(path), rule));
    }
    let sum = |of: fn(&[f64; 3]) -> f64| lines.iter().map(|(_, line)| of(line).abs()).sum::<f64>();
    let is_actual = sum(|line| line[1] - line[0]) < sum(|line| line[1]);
    let error = |nominal: f64, value: f64| // The difference of two large numbers has noise far below their decimals.
        if is_actual { ((value - nominal) * 1e9).round() / 1e9 + 0.0 } else { 0.0 - value };
    let there = lines
        .iter()
        .map(|(at, [nominal, forward, _])| (*at, *nominal, 1.0, error(*nominal, *forward)));
    let back = lines
        .iter()
        .rev()
        .map(|(at, [nominal, _, reverse])| (*at, *nominal, -1.0, error(*nominal, *reverse)));
    let rows = there.chain(back).map(|(line, nominal, way, error)| CellRow {
        line,
        cells: [1.0, nominal, way, error].map(number_cell).to_vec(),
    });
    let place = Location { file: path.into(), line: lines[0].0, column: 1 };
    let kind = if is_actual {
        "actual positions (COMP_FILE_TYPE 0)"
    } else {
        "trims (COMP_FILE_TYPE 1), whose error is minus the trim"
    };
    Ok(SourceTable {
        columns: vec![
            build_source_column("pass", known_meaning("run"), "", &place),
            build_source_column("nominal", ColumnMeaning::Position, "", &place),
            build_source_column("way", ColumnMeaning::Direction, "", &place),
            build_source_column("error", ColumnMeaning::Measured, "", &place),
        ],
        rows: rows.collect(),
        notes: vec![format!("forward and reverse are {kind}")],
    })
}
