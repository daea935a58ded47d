//! The machine file: what the user believes about the machine, in TOML.
//!
//! Each section has one page: its type, how it is read and how it is written. Reading
//! is strict: a misspelt key must not become a silent default, because the machine would then cut
//! with it. A key that the format knows but this version does not run is refused by name, never skipped.

pub(crate) mod axis;
mod chain;
pub(crate) mod inputs;
mod instrument;
pub(crate) mod key;
pub mod keys;
mod limits;
mod machine;
pub(crate) mod read;
pub(crate) mod spindle;
pub(crate) mod straightness;
mod structure;
pub(crate) mod table;
mod term;
mod thermal_state;
pub(crate) mod tools;
mod volume;
pub mod write;

use std::path::Path;

pub use crate::tool::TOOL_COLUMN;
pub use axis::{
    AxisModel, Backlash, Dual, Feedback, LinearAxis, Pitch, RotaryAxis, Thermal, ThermalMode,
    ThermalRow,
};
pub use chain::Chain;
pub use limits::{LearnedCaps, Limits};
pub use machine::{Kind, Machine};
pub use read::is_temperature_column;
pub use spindle::{ElongationSource, SensorModel, Spindle, TemperatureModel, Warmup};
pub use straightness::{BSpline, SplineFault, Squareness, Straightness};
pub use term::{Term, in_order};
pub use tools::{Tool, Tools};
pub use volume::{Angular, RotaryLocation, ToolTip, Volume};

pub use crate::effect::{Angle, Cause, Effect, Quantity, Wave};

use crate::{
    bounded,
    location::{BadInput, without_byte_order_mark},
};
use instrument::Instrument;
use read::{Document, Section};
use table::Table;
use thermal_state::ThermalState;
use write::{Edit, NewSection};

/// The longest machine file that is read, in bytes: forty times what the board could store of it.
pub const MAX_BYTES: u64 = 4 << 20;

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
    /// The file cannot be read, is longer than [`MAX_BYTES`], or is not UTF-8.
    pub fn read_text(path: &Path) -> Result<String, BadInput> {
        bounded::read_text(path, MAX_BYTES)
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
        // Each of its keys would be a fault otherwise.
        if root.keys().contains(&"measure") {
            let what = "is a key of a scenario, and this is read as a machine file";
            let help =
                "`trueup simulate --scenario` reads scenarios; the machine file is another one";
            return Err(root.bad("measure", what).with_help(help));
        }
        // Each section can be read by itself once its keys are right.
        let mut faults = structure::faults(&root, keys::FILE);
        let terms = || root.sections("term").into_iter().flatten();
        faults.extend(terms().flat_map(|it| structure::faults_of_term(&it)));
        if let Some(error) = BadInput::gathered(faults) {
            return Err(error);
        }
        let section = |name: &str| root.section(name).ok().flatten();
        let mut faults = Faults::default();
        let identity = faults.of(section("machine").map(|it| machine::read(&it)));
        let inputs = faults.of(section("inputs").map(|it| inputs::read(&it)));
        let connected = inputs.as_ref().and_then(|inputs| inputs.sensor);
        let spindle = faults.of(section("spindle").map(|it| spindle::read(&it, connected)));
        let axes = faults.of(section("axis").map(|it| axis::read(&it)));
        let curves =
            faults.of(section("straightness").map(|it| straightness::read_straightness(&it)));
        let angles = faults.of(section("squareness").map(|it| straightness::read_squareness(&it)));
        let angular = faults.of(section("angular").map(|it| volume::read_angular(&it)));
        let rotary = faults.of(section("rotary").map(|it| volume::read_rotary(&it)));
        let tool = faults.of(section("tool").map(|it| ToolTip::read(&it)));
        let limits = faults.of(section("limits").map(|it| Limits::read(&it)));
        let thermal_state = faults.of(section("thermal_state").map(|it| ThermalState::read(&it)));
        let instrument = faults.of(section("instrument").map(|it| Instrument::read(&it)));
        let (spindle, axes) = (spindle.unwrap_or_default(), axes.unwrap_or_default());
        let read = terms().map(|section| Ok((term::read(&section)?, section)));
        let read: Vec<(Term, Section<'_>)> = read.collect::<Result<_, BadInput>>()?;
        // Next to a section that cannot be read nobody knows what a term belongs to.
        if faults.0.is_empty() {
            let misplaced = |(term, section)| term::check(section, term, &spindle, &axes).err();
            faults
                .0
                .extend(read.iter().map(|(term, section)| (term, section)).filter_map(misplaced));
        }
        let mut terms: Vec<Term> = read.into_iter().map(|(term, _)| term).collect();
        for term in &mut terms {
            if let (Effect::Dependence(it), Some(tools)) =
                (term.effect.everywhere_mut(), &spindle.tools)
            {
                it.number_labels(tools);
            }
        }
        if let Some(error) = BadInput::gathered(faults.0) {
            return Err(error);
        }
        let identity = identity.expect("a section that is missing, or cannot be read, is a fault");
        let (angular, point_mm) = angular.unwrap_or_default();
        let volume = Volume {
            chain: identity.chain,
            angular,
            point_mm,
            rotary: rotary.unwrap_or_default(),
            tool: tool.unwrap_or_default(),
        };
        volume::check(&root, &volume)?;
        Ok(Machine {
            name: identity.name,
            serial: identity.serial,
            board: identity.board,
            kind: identity.kind,
            head_axes: identity.head_axes,
            tool_direction: identity.tool_direction,
            inputs,
            spindle,
            axes,
            straightness: curves.unwrap_or_default(),
            squareness: angles.unwrap_or_default(),
            volume,
            limits: limits.unwrap_or_default(),
            cold_within_c: thermal_state.unwrap_or_default().cold_within_c,
            instrument_um: instrument.map(|it| it.uncertainty_um),
            terms,
            places: document.into_places(),
        })
    }
}

/// The faults found so far.
#[derive(Default)]
struct Faults(Vec<BadInput>);

impl Faults {
    /// Returns what was read of a section, if it is there and right.
    fn of<T>(&mut self, read: Option<Result<T, BadInput>>) -> Option<T> {
        read.transpose().unwrap_or_else(|error| {
            self.0.push(error);
            None
        })
    }
}

impl Machine {
    /// Returns the sections of its machine file, in their order, but for the terms.
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
        sections.extend(volume::write(&self.volume));
        sections.push(self.limits.write(NewSection::new("limits")));
        let thermal_state = ThermalState { cold_within_c: self.cold_within_c };
        if thermal_state != ThermalState::default() {
            sections.push(thermal_state.write(NewSection::new("thermal_state")));
        }
        sections.extend(self.instrument_um.map(|uncertainty_um| {
            Instrument { uncertainty_um }.write(NewSection::new("instrument"))
        }));
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
