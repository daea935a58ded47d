//! The machine file: what the user believes about the machine, in TOML.
//!
//! Each section has one page: its type, how it is read and how it is written. Reading
//! is strict: a misspelt key must not become a silent default, because the machine would then cut
//! with it. What the format knows but this version does not run is refused by name, never skipped.

pub(crate) mod axis;
pub(crate) mod inputs;
mod instrument;
mod limits;
mod machine;
pub(crate) mod read;
pub(crate) mod spindle;
pub(crate) mod straightness;
mod term;
mod thermal_state;
pub mod write;

use std::path::Path;

pub use axis::{
    AxisModel, Backlash, Dual, Feedback, LinearAxis, Pitch, RotaryAxis, Thermal, ThermalMode,
    ThermalRow,
};
pub use inputs::is_temperature_column;
pub use limits::Limits;
pub use machine::{Kind, Machine, board_text};
pub use spindle::{ElongationSource, SensorModel, Spindle, TemperatureModel, Warmup};
pub use straightness::{BSpline, SplineFault, Squareness, Straightness};
pub use term::{Term, in_order};

pub use crate::effect::{Cause, Effect, Quantity, Wave};

use crate::{
    bounded,
    location::{BadInput, Locations, without_byte_order_mark},
};
use read::Document;
use write::{Edit, NewSection};

/// Sections of the format that this version reads.
const SECTIONS: [&str; 10] = [
    "machine",
    "inputs",
    "spindle",
    "axis",
    "straightness",
    "squareness",
    "limits",
    "thermal_state",
    "instrument",
    "term",
];

/// The longest machine file that is read, in bytes: forty times what the board could store of it.
pub const MOST_BYTES: u64 = 4 << 20;

/// The machine file's reader.
#[derive(Clone, Copy, Debug)]
pub struct MachineFile;

impl MachineFile {
    /// Reads the machine file at `path`.
    ///
    /// # Errors
    /// As [`Self::read_text`] and [`Self::parse`].
    pub fn read(path: &Path) -> Result<Machine, BadInput> {
        Self::parse(&Self::read_text(path)?, path)
    }

    /// Reads the text of the machine file at `path`, as it is.
    ///
    /// # Errors
    /// The file cannot be read, is longer than [`MOST_BYTES`], or is not UTF-8.
    pub fn read_text(path: &Path) -> Result<String, BadInput> {
        bounded::read_text(path, MOST_BYTES)
    }

    /// Reads `source`, the content of the file at `path` (which names it in errors and is not
    /// opened).
    ///
    /// # Errors
    /// Invalid TOML, an unknown, missing or repeated key, a value of the wrong type or outside its
    /// range, or something that this version does not run; with its place and the rule.
    pub fn parse(source: &str, path: &Path) -> Result<Machine, BadInput> {
        let document = Document::parse(without_byte_order_mark(source), path)?;
        let root = document.root();
        root.allow_only(&SECTIONS)?;

        let machine = root.required("machine", root.section("machine")?)?;
        let identity = machine::read(&machine)?;
        let inputs = root.section("inputs")?.map(|inputs| inputs::read(&inputs)).transpose()?;
        let spindle = match root.section("spindle")? {
            Some(spindle) => spindle::read(&spindle)?,
            None => Spindle::default(),
        };
        let axes = match root.section("axis")? {
            Some(axes) => axis::read(&axes)?,
            None => Default::default(),
        };
        let straightness = match root.section("straightness")? {
            Some(curves) => straightness::read_straightness(&curves)?,
            None => Vec::new(),
        };
        let squareness = match root.section("squareness")? {
            Some(angles) => straightness::read_squareness(&angles)?,
            None => Vec::new(),
        };
        let limits = match root.section("limits")? {
            Some(limits) => limits::read(&limits)?,
            None => Limits::default(),
        };
        let cold_within_c = match root.section("thermal_state")? {
            Some(state) => thermal_state::read(&state)?,
            None => thermal_state::COLD_WITHIN_C,
        };
        let instrument_um = match root.section("instrument")? {
            Some(instrument) => Some(instrument::read(&instrument)?),
            None => None,
        };
        let mut machine = Machine {
            name: identity.name,
            serial: identity.serial,
            board: identity.board,
            kind: identity.kind,
            head_axes: identity.head_axes,
            tool_direction: identity.tool_direction,
            inputs,
            spindle,
            axes,
            straightness,
            squareness,
            limits,
            cold_within_c,
            instrument_um,
            terms: Vec::new(),
            places: Locations::default(),
        };
        for section in root.sections("term")? {
            let term = term::read(&section)?;
            term::check(&section, &term, &machine.spindle, &machine.axes)?;
            machine.terms.push(term);
        }
        machine.places = document.into_places();
        Ok(machine)
    }
}

impl Machine {
    /// The sections of its machine file, in their order, but for the terms.
    #[must_use]
    pub fn sections(&self) -> Vec<NewSection> {
        let mut sections = vec![machine::write(self)];
        sections.extend(self.inputs.as_ref().map(inputs::write));
        sections.extend(spindle::write(&self.spindle));
        for (axis, of) in self.axes.iter().zip(LinearAxis::ALL) {
            sections.extend(axis::write(axis, of));
        }
        sections.extend(self.straightness.iter().map(straightness::write_straightness));
        sections.extend(straightness::write_squareness(&self.squareness));
        sections.push(limits::write(&self.limits));
        if self.cold_within_c != thermal_state::COLD_WITHIN_C {
            sections.push(thermal_state::write(self.cold_within_c));
        }
        sections.extend(self.instrument_um.map(instrument::write));
        sections
    }

    /// Its machine file: what is read from it is this machine again, with the tool direction at
    /// length 1.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let appended = self.terms.iter().map(Term::section).collect();
        Edit { sections: self.sections(), appended, ..Edit::default() }.to_toml()
    }
}

#[cfg(test)]
mod tests;
