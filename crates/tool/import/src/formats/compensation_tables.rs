//! Compensation tables as they stand in a control, read as the errors that they take away.
//!
//! | form | source | sign |
//! |---|---|---|
//! | SINUMERIK 840D sl, `$AA_ENC_COMP[e,N,AXi]=…` with `_STEP`, `_MIN`, `_MAX` (`%_N_AX_EEC_INI`) | Siemens, function manual "extended functions", compensations (K3) | a positive value moves the axis negative, so the value is the error |
//! | HEIDENHAIN `.COM`: `BEGIN … MM`, `NR AXISPOS BACKLASH X …` | HEIDENHAIN, technical manual, nonlinear axis error compensation | the value is the error in mm; `BACKLASH` is the own axis's in the negative direction |
//!
//! Both are what `trueup export` writes. Not tried: a file that a control itself has written.

use std::{collections::BTreeMap, path::Path};

use trueup_machine::{InputFileError, Location};

use super::{build_source_column, known_meaning, number_cell};
use crate::{cell_grid::CellRow, column_meaning::ColumnMeaning, layout::SourceTable};

/// The variable of an encoder table.
const EEC_VARIABLE_PREFIX: &str = "$AA_ENC_COMP";

pub(super) fn is_siemens_table(text: &str) -> bool {
    text.lines().any(|line| line.trim_start().starts_with(EEC_VARIABLE_PREFIX))
}

pub(super) fn is_heidenhain_table(text: &str) -> bool {
    let mut lines = text.lines().filter(|line| !line.trim().is_empty());
    let is_head = lines.next().is_some_and(|line| line.trim().to_uppercase().starts_with("BEGIN "));
    is_head && lines.next().is_some_and(|line| line.to_uppercase().contains("AXISPOS"))
}

/// Returns what stands between the brackets, the suffix before them, and the value.
fn parse_assignment(line: &str) -> Option<(&str, Vec<&str>, f64)> {
    let rest = line.trim().strip_prefix(EEC_VARIABLE_PREFIX)?;
    let (suffix, rest) = rest.split_once('[')?;
    let (inside, value) = rest.split_once(']')?;
    let value = value.trim().strip_prefix('=')?.trim().parse().ok()?;
    Some((suffix, inside.split(',').map(str::trim).collect(), value))
}

/// Reads the encoder table of one axis.
pub(super) fn parse_siemens_table(text: &str, path: &Path) -> Result<SourceTable, InputFileError> {
    let place = |line: usize| Location { file: path.into(), line, column: 1 };
    let mut points: BTreeMap<u32, (usize, f64)> = BTreeMap::new();
    let mut of = BTreeMap::new();
    let mut table: Option<(String, String)> = None;
    for (at, line) in text.lines().enumerate() {
        let line = line.split(';').next().unwrap_or_default();
        if !line.trim_start().starts_with(EEC_VARIABLE_PREFIX) {
            continue;
        }
        let at = at + 1;
        let bad = |rule: &str| InputFileError::new(place(at), rule);
        let (suffix, inside, value) =
            parse_assignment(line).ok_or_else(|| bad("is not $AA_ENC_COMP…[…]=number"))?;
        let (encoder, axis, index) = match (suffix, &inside[..]) {
            ("", [encoder, index, axis]) => (encoder, axis, Some(index)),
            (_, [encoder, axis]) => (encoder, axis, None),
            _ => return Err(bad("has the wrong number of indices")),
        };
        let this = ((*encoder).to_owned(), (*axis).to_owned());
        if table.get_or_insert_with(|| this.clone()) != &this {
            let rule = format!(
                "is a table of {axis}, encoder {encoder}, behind one of another: keep the lines of one"
            );
            return Err(bad(&rule));
        }
        match index {
            Some(index) => {
                let index = index.parse().map_err(|_| bad("has no number of a point"))?;
                points.insert(index, (at, value));
            }
            None => {
                of.insert(suffix.to_owned(), value);
            }
        }
    }
    let get = |what: &str| {
        of.get(what).copied().ok_or_else(|| {
            InputFileError::new(
                Location::start_of_file(path),
                format!("{EEC_VARIABLE_PREFIX}{what} is missing"),
            )
            .with_help("the table needs _STEP and _MIN: without them its points have no positions")
        })
    };
    let (step, min) = (get("_STEP")?, get("_MIN")?);
    if points.len() < 2 || step <= 0.0 {
        let rule = "has fewer than two points, or a step that is not above 0";
        return Err(InputFileError::new(Location::start_of_file(path), rule));
    }
    // Positions as they are written: a product has noise far below their decimals.
    let position = |index: u32| ((min + f64::from(index) * step) * 1e9).round() / 1e9;
    let rows = points.iter().map(|(index, (line, value))| CellRow {
        line: *line,
        cells: [position(*index), 1.0, *value].map(number_cell).to_vec(),
    });
    let rows: Vec<CellRow> = rows.collect();
    let place = place(rows[0].line);
    let (encoder, axis) = table.unwrap_or_default();
    Ok(SourceTable {
        columns: vec![
            build_source_column("position", ColumnMeaning::Position, "", &place),
            build_source_column("way", ColumnMeaning::Direction, "", &place),
            build_source_column("value", ColumnMeaning::Measured, "", &place),
        ],
        rows,
        notes: vec![format!(
            "table of {axis}, encoder {encoder}: one for both directions; the value is the error"
        )],
    })
}

/// Reads a `.COM` table: a pass there, and where it has `BACKLASH` a pass back.
pub(super) fn parse_heidenhain_table(
    text: &str,
    path: &Path,
) -> Result<SourceTable, InputFileError> {
    let place = |line: usize| Location { file: path.into(), line, column: 1 };
    let mut lines = text
        .lines()
        .enumerate()
        .map(|(at, line)| (at + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty());
    let (at, head) = lines.next().unwrap_or_default();
    let unit = match head.to_uppercase().rsplit(' ').next() {
        Some("MM") => "mm",
        Some("INCH") => "inch",
        _ => return Err(InputFileError::new(place(at), "does not end with MM or INCH")),
    };
    let (head_line, names) = lines.next().unwrap_or_default();
    let names = names.to_uppercase();
    let names: Vec<&str> = names.split_whitespace().collect();
    let ["NR", "AXISPOS", columns @ ..] = &names[..] else {
        return Err(InputFileError::new(place(head_line), "does not begin with NR AXISPOS"));
    };
    let axes: Vec<(usize, &str)> =
        columns.iter().copied().enumerate().filter(|(_, column)| *column != "BACKLASH").collect();
    if let Some((_, other)) = axes.iter().find(|(_, axis)| !["X", "Y", "Z"].contains(axis)) {
        return Err(InputFileError::new(
            place(head_line),
            format!("has a column {other}: X, Y and Z are read"),
        ));
    }
    let backlash = columns.iter().position(|column| *column == "BACKLASH");
    // The axis that moves: the only one, or the one of the file's name.
    let stem =
        path.file_stem().map(|stem| stem.to_string_lossy().to_uppercase()).unwrap_or_default();
    let own = match &axes[..] {
        [(_, only)] => Some(*only),
        _ => axes.iter().map(|(_, axis)| *axis).find(|axis| stem == **axis),
    };
    let mut entries: Vec<(usize, Vec<f64>)> = Vec::new();
    for (at, line) in lines.take_while(|(_, line)| *line != "[END]") {
        let numbers: Vec<f64> =
            line.split_whitespace().map_while(|word| word.parse().ok()).collect();
        if numbers.len() != columns.len() + 2 {
            let rule = format!("is not an entry of {} numbers", columns.len() + 2);
            return Err(InputFileError::new(place(at), rule));
        }
        entries.push((at, numbers[1..].to_vec()));
    }
    if entries.len() < 2 {
        return Err(InputFileError::new(place(head_line), "has fewer than two entries"));
    }
    let row = |line: usize, entry: &[f64], way: f64| {
        let values = axes.iter().map(|(at, name)| match backlash {
            Some(backlash) if way < 0.0 && Some(*name) == own => entry[backlash + 1],
            _ => entry[at + 1],
        });
        let cells = [1.0, entry[0], way].into_iter().chain(values).map(number_cell).collect();
        CellRow { line, cells }
    };
    let mut rows: Vec<CellRow> = entries.iter().map(|(at, entry)| row(*at, entry, 1.0)).collect();
    if backlash.is_some() && own.is_some() {
        rows.extend(entries.iter().rev().map(|(at, entry)| row(*at, entry, -1.0)));
    }
    let place = place(entries[0].0);
    let named =
        |form: &str| own.map(|axis| known_meaning(&form.replace('#', &axis.to_lowercase())));
    let mut sources = vec![
        build_source_column("pass", known_meaning("run"), "", &place),
        build_source_column(
            "AXISPOS",
            named("#_mm").unwrap_or(ColumnMeaning::Position),
            unit,
            &place,
        ),
        build_source_column("way", named("dir_#").unwrap_or(ColumnMeaning::Direction), "", &place),
    ];
    sources.extend(axes.iter().map(|(_, name)| {
        build_source_column(
            name,
            known_meaning(&format!("measured_d{}_um", name.to_lowercase())),
            unit,
            &place,
        )
    }));
    Ok(SourceTable { columns: sources, rows, notes: vec!["the values are errors".into()] })
}
