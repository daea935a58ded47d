//! Files of instruments and controls that are no plain table.

mod comp;
mod control_tables;
mod height_map;
mod probe_log;
mod refused;
mod rtl;

use std::path::Path;

use crate::{
    answers::{Answers, Refused},
    grid::{Cell, Content},
    layout::{Layout, Source},
    meaning::{Meaning, Target},
};
use trueup_machine::Location;

pub(crate) use refused::{refused, refused_without_table};

/// Returns the name of the form and its table, where `text` has one of these forms.
///
/// # Errors
/// It has one, and breaks its rules or leaves a question open.
pub(crate) fn recognise(
    text: &str,
    answers: &Answers,
    path: &Path,
) -> Result<Option<(&'static str, Layout)>, Refused> {
    if height_map::is_reprap(text) {
        return Ok(Some(("RepRapFirmware height map", height_map::reprap(text, path)?)));
    }
    if height_map::is_klipper(text) {
        return Ok(Some(("Klipper bed mesh", height_map::klipper(text, path)?)));
    }
    if probe_log::is_klipper(text) {
        return Ok(Some(("log of Klipper's probe", probe_log::klipper(text, path)?)));
    }
    if probe_log::is_grbl(text) {
        return Ok(Some(("log of GRBL's probe", probe_log::grbl(text, answers, path)?)));
    }
    if probe_log::is_linuxcnc(text) {
        return Ok(Some(("probe file of LinuxCNC", probe_log::linuxcnc(text, answers, path)?)));
    }
    if rtl::is_it(text) {
        return Ok(Some(("Renishaw target data", rtl::read(text, answers, path)?)));
    }
    if control_tables::is_siemens(text) {
        return Ok(Some(("SINUMERIK encoder compensation", control_tables::siemens(text, path)?)));
    }
    if control_tables::is_heidenhain(text) {
        return Ok(Some((
            "HEIDENHAIN compensation table",
            control_tables::heidenhain(text, path)?,
        )));
    }
    if comp::is_it(path) {
        return Ok(Some(("LinuxCNC compensation file", comp::read(text, path)?)));
    }
    Ok(None)
}

fn source(header: &str, meaning: Meaning, unit: &str, place: &Location) -> Source {
    Source {
        header: header.into(),
        unit: unit.into(),
        meaning: Some(meaning),
        place: place.clone(),
    }
}

fn known(name: &str) -> Meaning {
    Meaning::Known(Target::of(name))
}

fn number(value: f64) -> Cell {
    Cell { content: Content::Number(value), column: 1 }
}
