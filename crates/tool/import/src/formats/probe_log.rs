//! Logs of a probe that touches a surface point by point: the console of Klipper, of GRBL, and the file of LinuxCNC.
//!
//! | log | a line | source |
//! |---|---|---|
//! | Klipper | `probe at 10.000,20.000 is z=0.021250`, in newer versions `probe: at … bed will contact at z=…`, in mm | `klippy/extras/probe.py` |
//! | GRBL, grblHAL, FluidNC | `[PRB:10.000,20.000,-1.492:1]`, 0 at the end: nothing was touched; mm, or inches where `$13=1`: asked | the interface page of GRBL 1.1 |
//! | LinuxCNC | nine numbers X Y Z A B C U V W for each touch, between `(PROBEOPEN …)` and `(PROBECLOSE)`; no unit: asked | the G-code page of LinuxCNC 2.9, G38 |
//!
//! A surface that is touched counts as flat, as in a height map; its height counts from the first point, because the
//! position of a probe along its own axis has no zero of its own.

use std::path::Path;

use trueup_machine::{InputFileError, Location};

use super::{build_source_column, known_meaning, number_cell};
use crate::{
    answers::{ImportAnswers, ImportError, Question, QuestionTopic},
    cell_grid::CellRow,
    layout::SourceTable,
    unit::round_to_significant_digits,
};

const FLAT_SURFACE_NOTE: &str = "the surface counts as flat, heights from the first point: a point that is high by h is an error of −h in z";
/// The column whose unit is that of all.
const UNIT_COLUMN: &str = "z";
/// A file of LinuxCNC has that many numbers in a line.
const LINUXCNC_FIELD_COUNT: usize = 9;

/// A touch: line and position; `None`: the probe has touched nothing.
type ProbeTouch = (usize, Option<[f64; 3]>);

pub(super) fn is_klipper_log(text: &str) -> bool {
    text.lines().filter_map(parse_klipper_line).nth(1).is_some()
}

pub(super) fn is_grbl_log(text: &str) -> bool {
    text.lines().filter(|line| line.contains("[PRB:")).nth(1).is_some()
}

/// True where every line has nine numbers, and the axes that a surface leaves alone stand still.
pub(super) fn is_linuxcnc_log(text: &str) -> bool {
    let mut rows = non_empty_lines(text).map(|(_, line)| parse_linuxcnc_line(line));
    let Some(Some(first)) = rows.next() else { return false };
    let mut count = 1;
    let are_all = rows.all(|row| {
        count += 1;
        row.is_some_and(|row| row[3..] == first[3..])
    });
    are_all && count > 1
}

fn non_empty_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines()
        .enumerate()
        .map(|(at, line)| (at + 1, line))
        .filter(|(_, line)| !line.trim().is_empty())
}

fn parse_linuxcnc_line(line: &str) -> Option<[f64; LINUXCNC_FIELD_COUNT]> {
    let words: Option<Vec<f64>> = line
        .split_whitespace()
        .map(|word| word.parse().ok().filter(|value: &f64| value.is_finite()))
        .collect();
    // Whole numbers alone may be any table.
    words.filter(|_| line.contains('.')).and_then(|words| words.try_into().ok())
}

/// Returns the position of a line of Klipper's console.
fn parse_klipper_line(line: &str) -> Option<[f64; 3]> {
    let (_, rest) = line.split_once("probe")?;
    let (_, rest) = rest.split_once("at ")?;
    let (place, height) = rest.split_once("z=")?;
    let place = place.split_whitespace().next()?;
    let (x, y) = place.split_once(',')?;
    let height = height.split_whitespace().next()?;
    Some([x.parse().ok()?, y.parse().ok()?, height.parse().ok()?])
}

/// Returns the position of a line of GRBL's; the inner `None`: nothing was touched.
fn parse_grbl_line(line: &str) -> Option<Option<[f64; 3]>> {
    let (_, rest) = line.split_once("[PRB:")?;
    let (inside, _) = rest.split_once(']')?;
    let (place, result) = inside.split_once(':').unwrap_or((inside, "1"));
    let axes: Option<Vec<f64>> = place.split(',').map(|part| part.trim().parse().ok()).collect();
    let position = axes?.first_chunk().copied()?;
    Some((result.trim() == "1").then_some(position))
}

/// Reads the console of Klipper.
pub(super) fn parse_klipper_log(text: &str, path: &Path) -> Result<SourceTable, ImportError> {
    let touches = text.lines().enumerate();
    let touches = touches.filter_map(|(at, line)| Some((at + 1, Some(parse_klipper_line(line)?))));
    build_surface_table(&touches.collect::<Vec<_>>(), || Ok("mm".into()), path)
}

/// Reads the console of GRBL.
pub(super) fn parse_grbl_log(
    text: &str,
    answers: &ImportAnswers,
    path: &Path,
) -> Result<SourceTable, ImportError> {
    let mut touches: Vec<ProbeTouch> = Vec::new();
    for (at, line) in text.lines().enumerate().filter(|(_, line)| line.contains("[PRB:")) {
        let place = Location { file: path.into(), line: at + 1, column: 1 };
        let touch = parse_grbl_line(line).ok_or_else(|| {
            InputFileError::new(place, "is not [PRB:x,y,z:1]")
                .with_help("delete the line, or correct it")
        })?;
        touches.push((at + 1, touch));
    }
    let unit = || require_unit(answers, "GRBL reports in mm, or in inches where $13=1", path);
    build_surface_table(&touches, unit, path)
}

/// Reads the file of LinuxCNC.
pub(super) fn parse_linuxcnc_log(
    text: &str,
    answers: &ImportAnswers,
    path: &Path,
) -> Result<SourceTable, ImportError> {
    let touch = |(at, line)| Some((at, Some(*parse_linuxcnc_line(line)?.first_chunk()?)));
    let touches: Vec<ProbeTouch> = non_empty_lines(text).filter_map(touch).collect();
    let unit = || require_unit(answers, "the file of (PROBEOPEN …) states no unit", path);
    build_surface_table(&touches, unit, path)
}

/// Returns the unit that the user has given.
fn require_unit(answers: &ImportAnswers, text: &str, path: &Path) -> Result<String, ImportError> {
    let names = [UNIT_COLUMN, "3", "measured_dz_um"];
    let given = answers.units.iter().find(|(column, _)| names.contains(&column.as_str()));
    given.map(|(_, unit)| unit.clone()).ok_or_else(|| {
        ImportError::Open(vec![Question {
            place: Location::start_of_file(path),
            text: text.into(),
            topic: QuestionTopic::Unit(UNIT_COLUMN.into()),
            choices: vec!["mm".into(), "inch".into()],
            is_open: false,
        }])
    })
}

/// Returns the surface. The unit is requested last: a log that is refused needs no answer.
fn build_surface_table(
    touches: &[ProbeTouch],
    unit: impl FnOnce() -> Result<String, ImportError>,
    path: &Path,
) -> Result<SourceTable, ImportError> {
    let there: Vec<(usize, [f64; 3])> =
        touches.iter().filter_map(|(line, touch)| Some((*line, (*touch)?))).collect();
    let [(first, [.., zero]), _, ..] = there[..] else {
        return Err(InputFileError::new(
            Location::start_of_file(path),
            "has fewer than two points that were touched",
        )
        .into());
    };
    // A touch scatters: heights that are all the same were commanded.
    if there.iter().all(|(_, [.., z])| *z == zero) {
        return Err(InputFileError::new(
            Location { file: path.into(), line: first, column: 1 },
            "has the same z at every point: it was probed in X or Y, and the side that was touched is not stated",
        )
        .with_help("give a csv with `target [mm];actual [mm]`, a line for each touch")
        .into());
    }
    let unit = unit()?;
    let mut notes = vec![FLAT_SURFACE_NOTE.to_string()];
    if there.len() < touches.len() {
        notes.push(format!(
            "{} moves have touched nothing and are skipped",
            touches.len() - there.len()
        ));
    }
    let place = Location { file: path.into(), line: first, column: 1 };
    let row = |(line, [x, y, z]): &(usize, [f64; 3])| CellRow {
        line: *line,
        cells: vec![
            number_cell(*x),
            number_cell(*y),
            number_cell(round_to_significant_digits(zero - z)),
        ],
    };
    Ok(SourceTable {
        columns: vec![
            build_source_column("x", known_meaning("x_mm"), &unit, &place),
            build_source_column("y", known_meaning("y_mm"), &unit, &place),
            build_source_column(UNIT_COLUMN, known_meaning("measured_dz_um"), &unit, &place),
        ],
        rows: there.iter().map(row).collect(),
        notes,
    })
}
