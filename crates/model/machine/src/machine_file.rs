//! The machine file: what the user believes about the machine, in TOML.
//!
//! The whole file: `[machine]`, `[[term]]`, what holds between sections, and edits of the user's file. Every other section
//! has its page in `sections`, a cause its page in [`effect`](crate::effect). Reading is strict: a misspelt key must not become a silent default, because the machine would then cut
//! with it. A key that the format knows but this version does not run is refused by name, never skipped.

mod machine;
pub mod machine_file_keys;
mod term;
mod validation;
pub mod writer;

use std::path::Path;

pub use crate::{
    effect::Quantity,
    keys::reader::is_temperature_column,
    sections::{
        AngleProfile, AngularErrorMotion, AxisChain, AxisModel, Backlash, ElongationSource,
        Feedback, LearnedChangeLimits, Limits, LinearAxis, PitchErrorTable, RotaryAxis,
        RotaryLocationErrors, SecondDrive, SensorModel, Spindle, Squareness, Straightness,
        TemperatureModel, ThermalLaw, ThermalMode, ThermalRow, ToolGeometry, ToolGrowth,
        ToolGrowthList, VolumetricModel, Warmup,
    },
    spline::{BSpline, SplineError},
};
pub use machine::{Machine, MachineKind};
pub use term::Term;
pub(crate) use term::sorted_by_stage;

use crate::{
    bounded_read,
    effect::Effect,
    keys::{
        reader::{Section, TomlDocument},
        section::NewSection,
        table::Table,
    },
    location::{InputFileError, strip_byte_order_mark},
    sections::{
        axis, inputs, instrument::Instrument, spindle, straightness,
        thermal_state::ThermalStateSection, volume,
    },
};
use writer::MachineFileEdit;

/// The longest machine file that is read, in bytes: forty times what the board could store of it.
pub const MAX_MACHINE_FILE_BYTES: u64 = 4 << 20;

/// The machine file's reader.
#[derive(Clone, Copy, Debug)]
pub struct MachineFile;

impl MachineFile {
    /// Reads the machine file at `path`.
    ///
    /// # Errors
    /// As [`Self::read_text`] and [`Self::parse`].
    pub fn read(path: &Path) -> Result<Machine, InputFileError> {
        Self::parse(&Self::read_text(path)?, path)
    }

    /// Reads the text of the machine file at `path`, unchanged.
    ///
    /// # Errors
    /// The file cannot be read, is longer than [`MAX_MACHINE_FILE_BYTES`], or is not UTF-8.
    pub fn read_text(path: &Path) -> Result<String, InputFileError> {
        bounded_read::read_text(path, MAX_MACHINE_FILE_BYTES)
    }

    /// Reads `source`, the content of the file at `path` (which names it in errors and is not
    /// opened).
    ///
    /// # Errors
    /// Invalid TOML, an unknown, missing or repeated key, a value of the wrong type or outside its
    /// range, or something that this version does not run; with its place and the rule.
    pub fn parse(source: &str, path: &Path) -> Result<Machine, InputFileError> {
        let document = TomlDocument::parse(strip_byte_order_mark(source), path)?;
        let root = document.root();
        // Each of its keys would be a fault otherwise.
        if root.keys().contains(&"measure") {
            let what = "is a key of a scenario, and this is read as a machine file";
            let help =
                "`trueup simulate --scenario` reads scenarios; the machine file is another one";
            return Err(root.key_error("measure", what).with_help(help));
        }
        // Each section can be read by itself once its keys are right.
        let mut faults = validation::find_key_errors(&root, machine_file_keys::MACHINE_FILE_KEYS);
        let terms = || root.sections("term").into_iter().flatten();
        faults.extend(terms().flat_map(|term| validation::find_term_errors(&term)));
        if let Some(error) = InputFileError::combine(faults) {
            return Err(error);
        }
        let section = |name: &str| root.section(name).ok().flatten();
        let mut faults = ErrorCollector::default();
        let identity =
            faults.ok_or_collect(section("machine").map(|section| machine::read(&section)));
        let inputs = faults.ok_or_collect(section("inputs").map(|section| inputs::read(&section)));
        let connected = inputs.as_ref().and_then(|inputs| inputs.sensor);
        let spindle = faults
            .ok_or_collect(section("spindle").map(|section| spindle::read(&section, connected)));
        let axes = faults.ok_or_collect(section("axis").map(|section| axis::read(&section)));
        let curves = faults.ok_or_collect(
            section("straightness").map(|section| straightness::read_straightness(&section)),
        );
        let angles = faults.ok_or_collect(
            section("squareness").map(|section| straightness::read_squareness(&section)),
        );
        let angular = faults
            .ok_or_collect(section("angular").map(|section| volume::read_angular_errors(&section)));
        let rotary = faults.ok_or_collect(
            section("rotary").map(|section| volume::read_rotary_locations(&section)),
        );
        let tool =
            faults.ok_or_collect(section("tool").map(|section| ToolGeometry::read(&section)));
        let limits = faults.ok_or_collect(section("limits").map(|section| Limits::read(&section)));
        let thermal_state = faults.ok_or_collect(
            section("thermal_state").map(|section| ThermalStateSection::read(&section)),
        );
        let instrument =
            faults.ok_or_collect(section("instrument").map(|section| Instrument::read(&section)));
        let (spindle, axes) = (spindle.unwrap_or_default(), axes.unwrap_or_default());
        let read = terms().map(|section| Ok((term::read(&section)?, section)));
        let read: Vec<(Term, Section<'_>)> = read.collect::<Result<_, InputFileError>>()?;
        // Next to a section that cannot be read it is unknown what a term belongs to.
        if faults.0.is_empty() {
            let misplaced = |(term, section)| term::check(section, term, &spindle, &axes).err();
            faults
                .0
                .extend(read.iter().map(|(term, section)| (term, section)).filter_map(misplaced));
        }
        let mut terms: Vec<Term> = read.into_iter().map(|(term, _)| term).collect();
        for term in &mut terms {
            if let (Effect::Dependence(it), Some(tools)) =
                (term.effect.unrestricted_mut(), &spindle.tools)
            {
                it.resolve_tool_labels(tools);
            }
        }
        if let Some(error) = InputFileError::combine(faults.0) {
            return Err(error);
        }
        let identity = identity.expect("a section that is missing, or cannot be read, is a fault");
        let (angular, point_mm) = angular.unwrap_or_default();
        let volume = VolumetricModel {
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
            instrument_um: instrument.map(|instrument| instrument.uncertainty_um),
            terms,
            places: document.into_locations(),
        })
    }
}

/// The faults found so far.
#[derive(Default)]
struct ErrorCollector(Vec<InputFileError>);

impl ErrorCollector {
    /// Returns what was read of a section, if it is there and right.
    fn ok_or_collect<T>(&mut self, read: Option<Result<T, InputFileError>>) -> Option<T> {
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
        let thermal_state = ThermalStateSection { cold_within_c: self.cold_within_c };
        if thermal_state != ThermalStateSection::default() {
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
        let appended = self.terms.iter().map(Term::to_section).collect();
        MachineFileEdit { sections: self.sections(), appended, ..MachineFileEdit::default() }
            .to_toml()
    }
}

#[cfg(test)]
mod tests;
