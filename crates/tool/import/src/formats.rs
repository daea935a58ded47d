//! Files of instruments and controls that are no plain table.

mod comp;
mod control_tables;
mod height_map;
mod probe_log;
mod rtl;
mod unsupported;

use std::path::Path;

use crate::{
    answers::{Answers, ImportError},
    column_meaning::{ColumnMeaning, TargetColumn},
    grid::{Cell, CellContent},
    layout::{SourceColumn, SourceTable},
};
use trueup_machine::Location;

pub(crate) use unsupported::{detect_cycle_log, unsupported_format_error};

/// Returns the name of the form and its table, where `text` has one of these forms.
///
/// # Errors
/// It has one, and breaks its rules or leaves a question open.
pub(crate) fn parse_known_format(
    text: &str,
    answers: &Answers,
    path: &Path,
) -> Result<Option<(&'static str, SourceTable)>, ImportError> {
    if height_map::is_reprap(text) {
        return Ok(Some(("RepRapFirmware height map", height_map::parse_reprap(text, path)?)));
    }
    if height_map::is_klipper(text) {
        return Ok(Some(("Klipper bed mesh", height_map::parse_klipper(text, path)?)));
    }
    if probe_log::is_klipper(text) {
        return Ok(Some(("log of Klipper's probe", probe_log::parse_klipper(text, path)?)));
    }
    if probe_log::is_grbl(text) {
        return Ok(Some(("log of GRBL's probe", probe_log::parse_grbl(text, answers, path)?)));
    }
    if probe_log::is_linuxcnc(text) {
        return Ok(Some((
            "probe file of LinuxCNC",
            probe_log::parse_linuxcnc(text, answers, path)?,
        )));
    }
    if rtl::matches_format(text) {
        return Ok(Some(("Renishaw target data", rtl::parse(text, answers, path)?)));
    }
    if control_tables::is_siemens(text) {
        return Ok(Some((
            "SINUMERIK encoder compensation",
            control_tables::parse_siemens(text, path)?,
        )));
    }
    if control_tables::is_heidenhain(text) {
        return Ok(Some((
            "HEIDENHAIN compensation table",
            control_tables::parse_heidenhain(text, path)?,
        )));
    }
    if comp::matches_format(path) {
        return Ok(Some(("LinuxCNC compensation file", comp::parse(text, path)?)));
    }
    Ok(None)
}

fn build_source_column(
    header: &str,
    meaning: ColumnMeaning,
    unit: &str,
    place: &Location,
) -> SourceColumn {
    SourceColumn {
        header: header.into(),
        unit: unit.into(),
        meaning: Some(meaning),
        place: place.clone(),
    }
}

fn known_meaning(name: &str) -> ColumnMeaning {
    ColumnMeaning::Known(TargetColumn::from_name(name))
}

fn number_cell(value: f64) -> Cell {
    Cell { content: CellContent::Number(value), column: 1 }
}
