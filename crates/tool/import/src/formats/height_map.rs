//! Height maps of printers and routers: RepRapFirmware's `heightmap.csv`, and the bed mesh that Klipper saves.
//!
//! Sources: RepRapFirmware, `src/Movement/BedProbing/HeightGrid.cpp` (a title, the names of the grid's numbers, these
//! numbers, a line for each Y; a point that was not probed is a bare `0`, one that was has three decimals); Klipper,
//! `klippy/extras/bed_mesh.py` (`[bed_mesh NAME]` in the saved block, `points` from the lowest Y on). Both are in mm.
//! Where the probe touches, the commanded height is the map's; a surface that counts as flat is at 0: the error of Z,
//! actual minus commanded, is minus the height.

use std::path::Path;

use trueup_machine::{InputFileError, Location};

use super::{build_source_column, known_meaning, number_cell};
use crate::{cell_grid::CellRow, layout::SourceTable, unit::round_to_significant_digits};

const FLAT_SURFACE_NOTE: &str =
    "the surface counts as flat: a point that is high by h is an error of −h in z";

pub(super) fn is_reprap_map(text: &str) -> bool {
    text.trim_start().starts_with("RepRapFirmware height map file")
}

pub(super) fn is_klipper_map(text: &str) -> bool {
    unprefixed_lines(text)
        .any(|(_, line)| line.trim().starts_with("[bed_mesh ") && line.contains(']'))
        && text.contains("points")
}

/// Returns the lines without the mark of Klipper's saved block.
fn unprefixed_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(at, line)| (at + 1, line.strip_prefix("#*#").unwrap_or(line)))
}

struct HeightGrid {
    min_mm: [f64; 2],
    step_mm: [f64; 2],
    count: [usize; 2],
}

/// Reads a map of RepRapFirmware.
pub(super) fn parse_reprap_map(text: &str, path: &Path) -> Result<SourceTable, InputFileError> {
    let bad = |line: usize, rule: &str| {
        InputFileError::new(Location { file: path.into(), line, column: 1 }, rule.to_string())
    };
    let mut lines = text.lines().enumerate().map(|(at, line)| (at + 1, line)).skip(1);
    let (_, names) =
        lines.next().ok_or_else(|| bad(2, "the names of the grid's numbers are missing"))?;
    let (at, values) = lines.next().ok_or_else(|| bad(3, "the numbers of the grid are missing"))?;
    let names: Vec<String> =
        names.split(',').map(|name| name.trim().to_lowercase().replace('_', "")).collect();
    let values: Vec<&str> = values.split(',').map(str::trim).collect();
    let number_of = |keys: &[&str]| -> Result<f64, InputFileError> {
        let found = names.iter().position(|name| keys.contains(&name.as_str()));
        let value =
            found.and_then(|column| values.get(column)).and_then(|text| text.parse::<f64>().ok());
        value
            .filter(|value| value.is_finite())
            .ok_or_else(|| bad(at, &format!("{} is missing or no number", keys[0])))
    };
    for (column, name) in names.iter().enumerate() {
        let axis = values.get(column).map(|text| text.to_lowercase()).unwrap_or_default();
        if (name == "axis0" && axis != "x") || (name == "axis1" && axis != "y") {
            return Err(bad(at, "the map is not over X and Y"));
        }
    }
    let count = |keys: &[&str]| number_of(keys).map(|number| number.clamp(0.0, 1e4) as usize);
    let grid = HeightGrid {
        min_mm: [number_of(&["xmin", "min0"])?, number_of(&["ymin", "min1"])?],
        step_mm: [number_of(&["xspacing", "spacing0"])?, number_of(&["yspacing", "spacing1"])?],
        count: [count(&["xnum", "num0", "numx"])?, count(&["ynum", "num1", "numy"])?],
    };
    let rows: Vec<(usize, Vec<&str>)> = lines
        .filter(|(_, line)| !line.trim().is_empty())
        .map(|(at, line)| (at, line.split(',').map(str::trim).collect()))
        .collect();
    // A bare 0 is a point that was not probed; where all are written so, they were.
    let has_decimals = rows.iter().flat_map(|(_, cells)| cells).any(|cell| cell.contains('.'));
    build_surface_table(&grid, &rows, |cell| has_decimals && cell == "0", path)
}

/// Reads the bed mesh of Klipper: the only one, or `default`.
pub(super) fn parse_klipper_map(text: &str, path: &Path) -> Result<SourceTable, InputFileError> {
    let lines: Vec<(usize, &str)> = unprefixed_lines(text).collect();
    let bad = |line: usize, rule: String| {
        InputFileError::new(Location { file: path.into(), line, column: 1 }, rule)
    };
    let starts: Vec<usize> =
        (0..lines.len()).filter(|at| lines[*at].1.trim().starts_with("[bed_mesh ")).collect();
    let named = starts.iter().find(|at| lines[**at].1.contains("default"));
    let start = match (&starts[..], named) {
        ([only], _) | (_, Some(only)) => *only,
        _ => {
            return Err(bad(
                lines[starts[0]].0,
                "more than one bed mesh is saved, and none is default".into(),
            ));
        }
    };
    let section: Vec<(usize, &str)> = lines[start + 1..]
        .iter()
        .copied()
        .take_while(|(_, line)| !line.trim().starts_with('['))
        .collect();
    let number_of = |key: &str| -> Result<f64, InputFileError> {
        let found = section.iter().find_map(|(_, line)| {
            let (name, value) = line.split_once('=').or_else(|| line.split_once(':'))?;
            (name.trim() == key).then(|| value.trim().parse::<f64>().ok()).flatten()
        });
        found
            .filter(|value| value.is_finite())
            .ok_or_else(|| bad(lines[start].0, format!("{key} is missing or no number")))
    };
    let is_start =
        |line: &str| line.split_once(['=', ':']).is_some_and(|(name, _)| name.trim() == "points");
    let from = section.iter().position(|(_, line)| is_start(line));
    let from = from.ok_or_else(|| bad(lines[start].0, "points is missing".into()))?;
    let rows: Vec<(usize, Vec<&str>)> = section[from + 1..]
        .iter()
        .take_while(|(_, line)| line.contains(',') && !line.contains('='))
        .map(|(at, line)| (*at, line.split(',').map(str::trim).collect()))
        .collect();
    let [left, right, front, back] = ["min_x", "max_x", "min_y", "max_y"].map(number_of);
    let (left, right, front, back) = (left?, right?, front?, back?);
    let count = [rows.first().map_or(0, |(_, row)| row.len()), rows.len()];
    let step = |from: f64, to: f64, count: usize| (to - from) / (count.max(2) - 1) as f64;
    let grid = HeightGrid {
        min_mm: [left, front],
        step_mm: [step(left, right, count[0]), step(front, back, count[1])],
        count,
    };
    build_surface_table(&grid, &rows, |_| false, path)
}

fn build_surface_table(
    grid: &HeightGrid,
    rows: &[(usize, Vec<&str>)],
    is_unprobed: impl Fn(&str) -> bool,
    path: &Path,
) -> Result<SourceTable, InputFileError> {
    let bad = |line: usize, rule: String| {
        InputFileError::new(Location { file: path.into(), line, column: 1 }, rule)
    };
    if rows.len() != grid.count[1] || rows.is_empty() {
        let rule =
            format!("the grid has {} lines of points, the file {}", grid.count[1], rows.len());
        return Err(bad(rows.last().map_or(1, |(at, _)| *at), rule));
    }
    let mut unprobed = 0;
    let mut out = Vec::new();
    for (y, (line, cells)) in rows.iter().enumerate() {
        if cells.len() != grid.count[0] {
            return Err(bad(
                *line,
                format!("the grid has {} points a line, this one {}", grid.count[0], cells.len()),
            ));
        }
        for (x, cell) in cells.iter().enumerate() {
            if is_unprobed(cell) || cell.is_empty() || cell.eq_ignore_ascii_case("nan") {
                unprobed += 1;
                continue;
            }
            let height_mm: f64 = cell
                .parse()
                .ok()
                .filter(|value: &f64| value.is_finite())
                .ok_or_else(|| bad(*line, format!("\"{cell}\" is no height in mm")))?;
            let place = |axis: usize, at: usize| {
                round_to_significant_digits(grid.min_mm[axis] + at as f64 * grid.step_mm[axis])
            };
            out.push(CellRow {
                line: *line,
                cells: vec![
                    number_cell(place(0, x)),
                    number_cell(place(1, y)),
                    number_cell(0.0 - height_mm),
                ],
            });
        }
    }
    if out.len() < 2 {
        return Err(bad(rows[0].0, "fewer than two points were probed".into()));
    }
    let mut notes = vec![FLAT_SURFACE_NOTE.to_string()];
    if unprobed > 0 {
        notes.push(format!("{unprobed} points were not probed and are skipped"));
    }
    let place = Location { file: path.into(), line: rows[0].0, column: 1 };
    Ok(SourceTable {
        columns: vec![
            build_source_column("x", known_meaning("x_mm"), "mm", &place),
            build_source_column("y", known_meaning("y_mm"), "mm", &place),
            build_source_column(
                "height, sign turned",
                known_meaning("measured_dz_um"),
                "mm",
                &place,
            ),
        ],
        rows: out,
        notes,
    })
}
