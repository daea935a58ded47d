//! Report of what was exported, with which difference from the model, and what could not be.

use std::fmt::{self, Display};

use crate::{ExportFormat, ExportOptions, number_format::format_number};

/// The direction in which a position is approached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ApproachDirection {
    /// Towards larger positions.
    Positive,
    /// Towards smaller positions.
    Negative,
}

impl ApproachDirection {
    /// Both directions, in the order of the tables.
    pub const BOTH: [Self; 2] = [Self::Positive, Self::Negative];

    /// +1 or −1.
    #[must_use]
    pub fn sign(self) -> f64 {
        match self {
            Self::Positive => 1.0,
            Self::Negative => -1.0,
        }
    }
}

/// Where what the control corrects differs most from what the model requires.
#[derive(Clone, Debug, PartialEq)]
pub struct LargestDifference {
    /// The difference in µm, at least 0.
    pub um: f64,
    /// Where: a position with its direction, a temperature, an angle.
    pub at: String,
}

impl LargestDifference {
    pub(crate) const NONE: Self = Self { um: 0.0, at: String::new() };

    /// Keeps the larger one. NaN is the largest of all.
    pub(crate) fn update_max(&mut self, difference_um: f64, at: impl FnOnce() -> String) {
        let um = if difference_um.is_nan() { f64::INFINITY } else { difference_um.abs() };
        if um > self.um || self.at.is_empty() {
            *self = Self { um, at: at() };
        }
    }
}

/// One table of the export.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportedTable {
    /// The file it stands in.
    pub file: String,
    /// Its name there, in the control's own words.
    pub name: String,
    /// The sections of the machine file that it holds.
    pub section: String,
    /// How many points it has.
    pub points: usize,
    /// The first and the last point, in mm (or °C, or µm of growth: the name says so).
    pub range: (f64, f64),
    /// From point to point, if the same everywhere.
    pub spacing: Option<f64>,
    /// The constant that was taken out of the error before it was written, in µm: the control wants 0 at the
    /// reference point, and a constant along an axis is a shift of its zero.
    pub constant_um: f64,
    /// The largest difference between the control's correction, read back from the file, and the
    /// model without `constant_um`.
    pub largest: LargestDifference,
    /// The loss, if points had to be left away, or if the control gives its values out so that more
    /// than its rounding is off; the difference above contains it.
    pub loss: Option<String>,
}

/// A section of the model that the control cannot hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OmittedSection {
    /// Its name in the machine file.
    pub section: String,
    /// Why the control cannot hold it, as a sentence.
    pub reason: String,
}

/// Report of what was exported, and what was not.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportReport {
    /// The control.
    pub format: ExportFormat,
    /// The machine's name.
    pub machine: String,
    /// The export's options.
    pub options: ExportOptions,
    /// One entry a table.
    pub tables: Vec<ExportedTable>,
    /// Sections that the control cannot hold.
    pub omitted: Vec<OmittedSection>,
    /// Settings to be made by hand, and assumptions.
    pub notes: Vec<String>,
}

impl ExportReport {
    pub(crate) fn new(format: ExportFormat, machine: &str, options: &ExportOptions) -> Self {
        Self {
            format,
            machine: machine.to_string(),
            options: options.clone(),
            tables: Vec::new(),
            omitted: Vec::new(),
            notes: Vec::new(),
        }
    }

    pub(crate) fn add_omitted_section(
        &mut self,
        section: impl Into<String>,
        reason: impl Into<String>,
    ) {
        self.omitted.push(OmittedSection { section: section.into(), reason: reason.into() });
    }

    pub(crate) fn add_note(&mut self, note: impl Into<String>) {
        self.notes.push(note.into());
    }

    /// Returns whether the control holds the whole model: nothing was omitted, and nothing lost but its rounding.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.omitted.is_empty() && self.tables.iter().all(|table| table.loss.is_none())
    }

    /// Returns the largest difference of all tables, in µm.
    #[must_use]
    pub fn max_difference_um(&self) -> f64 {
        self.tables.iter().map(|table| table.largest.um).fold(0.0, f64::max)
    }
}

impl Display for ExportReport {
    /// The companion report, plain text; without a line break at its end.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { machine, options, .. } = self;
        writeln!(f, "export of \"{}\" to {}", machine.escape_debug(), self.format.name())?;
        let [x, y, z] = options.reference_mm.map(|mm| format_number(mm, 6));
        writeln!(f, "reference point: x {x}, y {y}, z {z} mm; unit {}", options.units.name())?;
        for table in &self.tables {
            let (first, last) = table.range;
            writeln!(f, "\n{} {}: {}", table.file, table.name, table.section)?;
            write!(
                f,
                "  {} points, {} to {}",
                table.points,
                format_number(first, 6),
                format_number(last, 6)
            )?;
            if let Some(spacing) = table.spacing {
                write!(f, ", {} apart", format_number(spacing, 6))?;
            }
            writeln!(f)?;
            if table.constant_um != 0.0 {
                writeln!(f, "  constant taken out: {:+.3} µm", table.constant_um)?;
            }
            let LargestDifference { um, at } = &table.largest;
            writeln!(f, "  largest difference from the model: {um:.4} µm at {at}")?;
            if let Some(loss) = &table.loss {
                writeln!(f, "  loss: {loss}")?;
            }
        }
        if !self.omitted.is_empty() {
            writeln!(f, "\nnot exported:")?;
            for OmittedSection { section, reason } in &self.omitted {
                writeln!(f, "  {section}: {reason}")?;
            }
        }
        if !self.notes.is_empty() {
            writeln!(f, "\nto know and to do:")?;
            self.notes.iter().try_for_each(|note| writeln!(f, "  {note}"))?;
        }
        write!(f, "\nlargest difference of all: {:.4} µm", self.max_difference_um())
    }
}
