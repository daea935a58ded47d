//! Files of instruments and controls that are no plain table.

mod comp_file;
mod compensation_tables;
mod height_map;
mod probe_log;
mod renishaw_rtl;
mod unsupported_formats;

use std::path::Path;

use crate::{
    answers::{ImportAnswers, ImportError},
    cell_grid::{Cell, CellContent},
    column_meaning::{ColumnMeaning, TargetColumn},
    layout::{SourceColumn, SourceTable},
};
use trueup_machine::Location;

pub(crate) use unsupported_formats::{detect_cycle_log, unsupported_format_error};

/// Returns the name of the form and its table, where `text` has one of these forms.
///
/// # Errors
/// It has one, and breaks its rules or leaves a question open.
pub(crate) fn parse_known_format(
    text: &str,
    answers: &ImportAnswers,
    path: &Path,
) -> Result<Option<(&'static str, SourceTable)>, ImportError> {
    if height_map::is_reprap_map(text) {
        return Ok(Some(("RepRapFirmware height map", height_map::parse_reprap_map(text, path)?)));
    }
    if height_map::is_klipper_map(text) {
        return Ok(Some(("Klipper bed mesh", height_map::parse_klipper_map(text, path)?)));
    }
    if probe_log::is_klipper_log(text) {
        return Ok(Some(("log of Klipper's probe", probe_log::parse_klipper_log(text, path)?)));
    }
    if probe_log::is_grbl_log(text) {
        return Ok(Some(("log of GRBL's probe", probe_log::parse_grbl_log(text, answers, path)?)));
    }
    if probe_log::is_linuxcnc_log(text) {
        return Ok(Some((
            "probe file of LinuxCNC",
            probe_log::parse_linuxcnc_log(text, answers, path)?,
        )));
    }
    if renishaw_rtl::matches_format(text) {
        return Ok(Some(("Renishaw target data", renishaw_rtl::parse(text, answers, path)?)));
    }
    if compensation_tables::is_siemens_table(text) {
        return Ok(Some((
            "SINUMERIK encoder compensation",
            compensation_tables::parse_siemens_table(text, path)?,
        )));
    }
    if compensation_tables::is_heidenhain_table(text) {
        return Ok(Some((
            "HEIDENHAIN compensation table",
            compensation_tables::parse_heidenhain_table(text, path)?,
        )));
    }
    if comp_file::matches_format(path) {
        return Ok(Some(("LinuxCNC compensation file", comp_file::parse(text, path)?)));
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
