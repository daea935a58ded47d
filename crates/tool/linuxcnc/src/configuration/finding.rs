//! A check's input and its findings: a place, the setting there, the remedy.

use trueup_machine::{InputFileError, Location, Machine};

use super::{
    OffsetEntryPoint,
    boardless_config::BoardlessConfig,
    inputs::{self, NamedInput},
};

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// Offsets would be wrong, or LinuxCNC would not start: setup writes nothing.
    Error,
    /// They work, with a limit that you should know.
    Warning,
}

/// Something in the configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConfigurationFinding {
    /// How much it matters.
    pub severity: Severity,
    /// Where it is.
    pub place: Location,
    /// The setting and its effect.
    pub what: String,
    /// The remedy.
    pub help: String,
}

impl ConfigurationFinding {
    pub(super) fn error(place: Location, what: impl Into<String>, help: impl Into<String>) -> Self {
        Self { severity: Severity::Error, place, what: what.into(), help: help.into() }
    }

    pub(super) fn warning(
        place: Location,
        what: impl Into<String>,
        help: impl Into<String>,
    ) -> Self {
        Self { severity: Severity::Warning, place, what: what.into(), help: help.into() }
    }
}

/// A file that cannot be read is an error of the configuration too.
impl From<InputFileError> for ConfigurationFinding {
    fn from(InputFileError { place, rule, help, .. }: InputFileError) -> Self {
        Self::error(place, rule, help.unwrap_or_default())
    }
}

/// Requirements on the offsets.
#[derive(Clone, Debug, PartialEq)]
pub struct OffsetRequirements {
    /// Where they enter.
    pub entry: OffsetEntryPoint,
    /// Largest offset of X, Y and Z, in µm.
    pub max_um: [f64; 3],
    /// Fastest change, in µm/s.
    pub slew_um_per_s: f64,
    /// True for each axis whose pitch or backlash the machine file corrects; `None` without a machine file.
    pub corrects_screw: Option<[bool; 3]>,
    /// Inputs of the machine file from LinuxCNC next to positions and speed.
    pub inputs: Vec<NamedInput>,
    /// How many angles of rotary axes the machine file has.
    pub angles: usize,
    /// The bridge runs in the servo thread; `None`: on a board.
    pub no_board: Option<BoardlessConfig>,
}

impl OffsetRequirements {
    /// Returns what a machine file requires; without one, the limits that the component then uses.
    #[must_use]
    pub fn from_machine(entry: OffsetEntryPoint, machine: Option<&Machine>) -> Self {
        let limits = machine.map(|machine| machine.limits).unwrap_or_default();
        let corrects_screw = machine.map(|machine| {
            machine.axes.each_ref().map(|model| {
                model.pitch.is_some() || model.backlash.is_some() || model.dual.is_some()
            })
        });
        let slew_um_per_s = limits.slew_um_per_s;
        Self {
            entry,
            max_um: limits.max_um,
            slew_um_per_s,
            corrects_screw,
            inputs: machine.map(inputs::required_inputs).unwrap_or_default(),
            angles: machine.map_or(0, |machine| machine.angle_axes().len()),
            no_board: None,
        }
    }
}
