//! From a machine file to what other CNCs read, and back.
//!
//! A machine file holds **errors** (actual minus commanded); a control adds a **correction**, the
//! opposite. Each format has its own sign for it, its own grid, rounding and limits. The
//! files are read back by a reader of their own, evaluated as that control would, and compared with
//! the model at thousands of positions in both directions; the largest difference stands in the
//! report.
//!
//! | module | does |
//! |---|---|
//! | [`siemens`] | 840D sl: EEC, CEC, temperature, tool direction |
//! | [`fanuc`] | increments −7 … +7 by point number, straightness |
//! | [`heidenhain`] | `.COM` and `.CMA` |
//! | [`linuxcnc`] | `COMP_FILE` of type 1 |
//! | [`isg`] | TwinCAT and other ISG kernels: component errors of the whole volume |
//! | [`report`] | what was exported, with which difference, and what could not be |
//! | `course` | the parts of a machine as functions of a position |
//! | `grid` | equidistant points, and the best few of many points |
//!
//! The terms that a diagnosis has added are exported with what they add to: along an axis (scale,
//! table, periodic, backlash), across one, and the constants that they correct. Those that change
//! while the machine runs are omitted.
//!
//! A part that a control cannot hold is omitted with the reason, or thinned to its limit with the loss
//! stated: never in silence.
#![forbid(unsafe_code)]

mod axis_errors;
pub mod fanuc;
pub mod heidenhain;
pub mod isg;
pub mod linuxcnc;
mod number_format;
pub mod report;
pub mod siemens;
mod table_points;

use std::{borrow::Cow, collections::BTreeMap};

use thiserror::Error;
use trueup_machine::{Machine, model::apply_constant_terms};

pub use report::{
    ApproachDirection, ExportReport, ExportedTable, LargestDifference, OmittedSection,
};

/// The control that is exported to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
    /// Siemens SINUMERIK 840D sl.
    Siemens840d,
    /// FANUC with stored pitch error compensation.
    Fanuc,
    /// HEIDENHAIN with nonlinear axis error compensation.
    Heidenhain,
    /// LinuxCNC with a file of screw compensation for each joint.
    LinuxCnc,
    /// TwinCAT CNC, or another control with the ISG kernel, with volumetric compensation.
    Isg,
}

impl ExportFormat {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Siemens840d, Self::Fanuc, Self::Heidenhain, Self::LinuxCnc, Self::Isg];

    /// Its name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Siemens840d => "siemens-840d",
            Self::Fanuc => "fanuc",
            Self::Heidenhain => "heidenhain",
            Self::LinuxCnc => "linuxcnc",
            Self::Isg => "isg",
        }
    }
}

/// The unit of length in the files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LengthUnit {
    /// Millimetres.
    #[default]
    Millimetres,
    /// Inches of 25.4 mm.
    Inches,
}

impl LengthUnit {
    /// Returns how many millimetres one of it is.
    #[must_use]
    pub fn mm_per_unit(self) -> f64 {
        match self {
            Self::Millimetres => 1.0,
            Self::Inches => 25.4,
        }
    }

    /// Its name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Millimetres => "mm",
            Self::Inches => "inch",
        }
    }
}

/// Settings that a control needs and the machine file does not state.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportOptions {
    /// The control's unit of length (Siemens, LinuxCNC; FANUC and HEIDENHAIN are written in mm).
    pub units: LengthUnit,
    /// The reference points of X, Y and Z, in mm: where Siemens and FANUC want a value of 0.
    pub reference_mm: [f64; 3],
    /// The travel of X, Y and Z, in mm; `None`: as far as the model's tables and knots reach.
    pub travel_mm: [Option<(f64, f64)>; 3],
    /// A curve gets as many points as keep it so near to the model, in µm; above 0.
    pub tolerance_um: f64,
    /// At most this many points in a table, at least 2; `None`: the format's own limit.
    pub most_points: Option<usize>,
    /// FANUC's detection unit, in µm; above 0.
    pub unit_um: f64,
    /// Which FANUC.
    pub fanuc: fanuc::FanucSeries,
    /// Temperatures in °C, by column, at which the Siemens setting data are written; a column that
    /// is missing is at its reference, where the axis has no thermal error.
    pub temperatures_c: BTreeMap<String, f64>,
    /// The tool's growth in µm at which the Siemens setting data are written.
    pub elongation_um: f64,
}

impl Default for ExportOptions {
    fn default() -> Self {
        Self {
            units: LengthUnit::Millimetres,
            reference_mm: [0.0; 3],
            travel_mm: [None; 3],
            tolerance_um: 0.1,
            most_points: None,
            unit_um: 1.0,
            fanuc: fanuc::FanucSeries::default(),
            temperatures_c: BTreeMap::new(),
            elongation_um: 0.0,
        }
    }
}

/// A file for the control.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExportedFile {
    /// Its name, without a folder.
    pub name: String,
    /// Its whole text, ASCII.
    pub text: String,
}

/// Files of an export, and its report.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportResult {
    /// The files for the control, in the order in which they are loaded.
    pub files: Vec<ExportedFile>,
    /// The report on their content, and how well it fits the model.
    pub report: ExportReport,
}

/// An export without a file.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ExportError {
    /// The model has no errors.
    #[error("the model has no errors, so there is nothing to export to {}", .0.name())]
    NoErrors(ExportFormat),
    /// Nothing of the model can be held by the control.
    #[error("nothing of the model can be held by {}{}", .format.name(), format_omitted_sections(.omitted))]
    NothingFits {
        /// The control that cannot hold it.
        format: ExportFormat,
        /// The sections of the model, each with the reason; at least one.
        omitted: Vec<OmittedSection>,
    },
}

fn format_omitted_sections(omitted: &[OmittedSection]) -> String {
    omitted
        .iter()
        .map(|OmittedSection { section, reason }| format!("; {section}: {reason}"))
        .collect()
}

/// Exports `machine` to `format`, and reads it back.
///
/// # Errors
/// The model has no errors, or nothing of it can be held.
pub fn export(
    machine: &Machine,
    format: ExportFormat,
    options: &ExportOptions,
) -> Result<ExportResult, ExportError> {
    // Some terms of a diagnosis say which constants of the model are right.
    let (machine, _) = apply_constant_terms(Cow::Borrowed(machine));
    let mut machine = machine.into_owned();
    // A table of a control goes by position and direction, not by feed.
    machine.terms.iter_mut().for_each(|term| term.effect = term.effect.without_feed_dependence());
    let machine = &machine;
    let mut export = ExportResult {
        files: Vec::new(),
        report: ExportReport::new(format, &machine.name, options),
    };
    let mut omitted = axis_errors::unsupported_terms(machine, options);
    if format != ExportFormat::Isg {
        omitted.extend(axis_errors::unsupported_volume_terms(machine, format));
    }
    for (section, reason) in omitted {
        export.report.add_omitted_section(section, reason);
    }
    match format {
        ExportFormat::Siemens840d => siemens::export(machine, options, &mut export),
        ExportFormat::Fanuc => fanuc::export(machine, options, &mut export),
        ExportFormat::Heidenhain => heidenhain::export(machine, options, &mut export),
        ExportFormat::LinuxCnc => linuxcnc::export(machine, options, &mut export),
        ExportFormat::Isg => isg::export(machine, options, &mut export),
    }
    if !export.files.is_empty() {
        return Ok(export);
    }
    Err(match export.report.omitted {
        omitted if omitted.is_empty() => ExportError::NoErrors(format),
        omitted => ExportError::NothingFits { format, omitted },
    })
}
