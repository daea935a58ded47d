//! The constants of the volume, and how much a unit of each moves the tool tip at a pose.
//!
//! Names are those of ISO 230-1 and ISO 230-7. Each error over a position has a line and [forms](super::spline_modes); a straightness has
//! no line, since a slope is a squareness or the alignment of the artefact. An angle counts from its mean over the travel: a
//! constant angle is a squareness too. The effect of a unit of an angle or of a line of a rotary axis at the tip comes
//! from the model that predicts, so that both have the same signs and levers.

use std::fmt;

use trueup_machine::{
    Machine,
    machine_file::{
        AngleProfile, AngularErrorMotion, BSpline, LinearAxis, RotaryAxis, RotaryLocationErrors,
        Straightness,
    },
    model::volumetric_error_um,
};

use super::{reading::Pose, spline_modes::SplineModes};

/// An axis that moves less, in mm, has no errors to be found.
const MIN_AXIS_TRAVEL_MM: f64 = 5.0;

/// An error by its name in ISO 230-1 or ISO 230-7.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum GeometricError {
    /// EXX: the position of an axis.
    Position(LinearAxis),
    /// EYX: an axis in error while another moves.
    Straightness(LinearAxis, LinearAxis),
    /// EC0Y and others: the axis in error, the one that moves.
    Squareness(LinearAxis, LinearAxis),
    /// EAX: the turn, the axis that moves.
    Angle(RotaryAxis, LinearAxis),
    /// EXOC: a direction, the rotary axis.
    Shift(LinearAxis, RotaryAxis),
    /// EAOC: a turn, the rotary axis.
    Tilt(RotaryAxis, RotaryAxis),
}

impl GeometricError {
    /// Returns the axis over whose position it is a function.
    #[must_use]
    pub fn motion_axis(self) -> Option<LinearAxis> {
        match self {
            Self::Position(along) | Self::Straightness(_, along) | Self::Angle(_, along) => {
                Some(along)
            }
            Self::Squareness(..) | Self::Shift(..) | Self::Tilt(..) => None,
        }
    }

    /// Returns the unit of its value.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Position(_) | Self::Straightness(..) | Self::Shift(..) => "µm",
            Self::Squareness(..) => "µm/m",
            Self::Angle(..) | Self::Tilt(..) => "µrad",
        }
    }

    /// Returns the key of the machine file that holds it.
    #[must_use]
    pub fn machine_file_key(self) -> String {
        match self {
            Self::Position(axis) => format!("axis.{}.pitch", axis.name()),
            Self::Straightness(error, along) => {
                format!("straightness.{}_of_{}", error.name(), along.name())
            }
            Self::Squareness(error, along) => {
                format!("squareness.{}_of_{}_um_per_m", error.name(), along.name())
            }
            Self::Angle(about, along) => format!("angular.e{}{}", about.name(), along.name()),
            Self::Shift(along, axis) => {
                format!("rotary.{}.e{}o{}_um", axis.name(), along.name(), axis.name())
            }
            Self::Tilt(about, axis) => {
                format!("rotary.{}.e{}o{}_urad", axis.name(), about.name(), axis.name())
            }
        }
    }
}

impl fmt::Display for GeometricError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self {
            Self::Position(axis) => format!("E{0}{0}", axis.name()),
            Self::Straightness(error, along) => format!("E{}{}", error.name(), along.name()),
            Self::Squareness(error, along) => {
                let about = RotaryAxis::ALL[3 - error.index() - along.index()];
                format!("E{}0{}", about.name(), along.name())
            }
            Self::Angle(about, along) => format!("E{}{}", about.name(), along.name()),
            Self::Shift(along, axis) => format!("E{}O{}", along.name(), axis.name()),
            Self::Tilt(about, axis) => format!("E{}O{}", about.name(), axis.name()),
        };
        f.write_str(&name.to_uppercase())
    }
}

/// A part of an error that one number multiplies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorPart {
    /// A number of its own: a squareness, a shift, a tilt.
    Whole,
    /// The line about the middle of the travel, for a metre.
    Line,
    /// A form by its number.
    Form(usize),
}

/// A constant: which part of which error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorParameter {
    /// The error.
    pub error: GeometricError,
    /// Its part.
    pub part: ErrorPart,
}

/// The errors of a machine over what was measured of its volume.
#[derive(Clone, Debug)]
pub struct ErrorParameters {
    /// The constants in the order of their columns.
    pub all: Vec<ErrorParameter>,
    /// The forms over the travel of X, Y and Z; `None` where it did not move.
    pub modes: [Option<SplineModes>; 3],
    /// For each angle and each location error a machine that has a unit of it and nothing else.
    units: Vec<(GeometricError, Machine)>,
}

impl ErrorParameters {
    /// Returns the constants of `machine` over the positions of `poses`.
    #[must_use]
    pub fn new(machine: &Machine, poses: &[Pose]) -> Self {
        let modes = [0, 1, 2].map(|n| {
            let at = || poses.iter().map(|pose| pose.position_mm[n]);
            let ends = [at().fold(f64::INFINITY, f64::min), at().fold(f64::MIN, f64::max)];
            (ends[1] - ends[0] > MIN_AXIS_TRAVEL_MM).then(|| SplineModes::new(ends))
        });
        let errors = possible_errors(machine, &modes);
        let mut all = Vec::new();
        for &error in &errors {
            let mut add = |part| all.push(ErrorParameter { error, part });
            match error.motion_axis() {
                None => add(ErrorPart::Whole),
                Some(along) => {
                    if !matches!(error, GeometricError::Straightness(..)) {
                        add(ErrorPart::Line);
                    }
                    let count = modes[along.index()].as_ref().map_or(0, SplineModes::count);
                    (0..count).for_each(|n| add(ErrorPart::Form(n)));
                }
            }
        }
        let units = errors
            .iter()
            .filter_map(|error| Some((*error, machine_with_unit_error(machine, *error)?)));
        Self { all, modes, units: units.collect() }
    }

    /// Returns the errors, each once.
    #[must_use]
    pub(crate) fn distinct_errors(&self) -> Vec<GeometricError> {
        let mut errors: Vec<GeometricError> =
            self.all.iter().map(|parameter| parameter.error).collect();
        errors.dedup();
        errors
    }

    /// Returns the numbers of the constants of an error.
    #[must_use]
    pub(crate) fn indices_of_error(&self, error: GeometricError) -> Vec<usize> {
        (0..self.all.len()).filter(|at| self.all[*at].error == error).collect()
    }

    /// Returns what a unit of each constant moves the tip at a pose, along X, Y and Z in µm.
    #[must_use]
    pub(crate) fn tip_sensitivities(&self, pose: &Pose) -> Vec<[f64; 3]> {
        let units: Vec<(GeometricError, [f64; 3])> = self
            .units
            .iter()
            .map(|(error, machine)| {
                let tool = machine.volume.tool.with_length(Some(pose.tool_mm));
                (*error, volumetric_error_um(machine, tool, pose.position_mm, pose.angle_deg))
            })
            .collect();
        let forms = [0, 1, 2].map(|n| {
            let modes = self.modes[n].as_ref();
            modes.map(|modes| modes.evaluate(pose.position_mm[n])).unwrap_or_default()
        });
        let part = |constant: &ErrorParameter| -> f64 {
            let Some(along) = constant.error.motion_axis() else { return 1.0 };
            match (constant.part, &self.modes[along.index()]) {
                (ErrorPart::Form(n), _) => forms[along.index()][n],
                (_, Some(modes)) => {
                    (modes.clamp_to_travel(pose.position_mm[along.index()]) - modes.middle_mm())
                        / 1000.0
                }
                (_, None) => 0.0,
            }
        };
        let unit = |error: GeometricError| -> [f64; 3] {
            let along = |axis: LinearAxis, by: f64| {
                let mut vector = [0.0; 3];
                vector[axis.index()] = by;
                vector
            };
            match error {
                GeometricError::Position(axis) | GeometricError::Straightness(axis, _) => {
                    along(axis, 1.0)
                }
                GeometricError::Squareness(axis, moves) => {
                    along(axis, pose.position_mm[moves.index()] / 1000.0)
                }
                GeometricError::Angle(..)
                | GeometricError::Shift(..)
                | GeometricError::Tilt(..) => units
                    .iter()
                    .find(|(candidate, _)| *candidate == error)
                    .map_or([0.0; 3], |(_, um)| *um),
            }
        };
        let each = self.all.iter().map(|constant| {
            let share = part(constant);
            unit(constant.error).map(|um| um * share)
        });
        each.collect()
    }
}

/// Returns the errors that a machine can have where its axes have moved so.
fn possible_errors(machine: &Machine, modes: &[Option<SplineModes>; 3]) -> Vec<GeometricError> {
    use LinearAxis::{X, Y, Z};
    let moves = |axis: LinearAxis| modes[axis.index()].is_some();
    let mut errors: Vec<GeometricError> = LinearAxis::ALL.map(GeometricError::Position).to_vec();
    errors.extend(
        Straightness::AXIS_PAIRS.map(|(error, along)| GeometricError::Straightness(error, along)),
    );
    errors.extend(
        [(X, Y), (X, Z), (Y, Z)].map(|(error, along)| GeometricError::Squareness(error, along)),
    );
    errors.extend(
        AngularErrorMotion::all_axis_pairs()
            .map(|(about, along)| GeometricError::Angle(about, along)),
    );
    errors.retain(|error| match error {
        GeometricError::Squareness(error, along) => moves(*error) && moves(*along),
        _ => error.motion_axis().is_none_or(moves),
    });
    for axis in
        machine.volume.chain.iter().flat_map(trueup_machine::machine_file::AxisChain::rotary_axes)
    {
        let shifts = LinearAxis::ALL.into_iter().filter(|other| other.index() != axis.index());
        errors.extend(shifts.map(|along| GeometricError::Shift(along, axis)));
        errors.extend(RotaryAxis::ALL.map(|about| GeometricError::Tilt(about, axis)));
    }
    errors
}

/// Returns a machine with 1 µrad or 1 µm of an error, and no other.
fn machine_with_unit_error(machine: &Machine, error: GeometricError) -> Option<Machine> {
    let mut own = machine.clone();
    let volume = &mut own.volume;
    volume.angular.clear();
    for it in &mut volume.rotary {
        (it.shift_um, it.tilt_urad) = ([0.0; 3], [0.0; 3]);
    }
    let mut location = |axis: RotaryAxis, shift_um, tilt_urad| {
        let point_mm = volume.axis_line_point_mm(axis);
        volume.rotary.retain(|location| location.axis != axis);
        volume.rotary.push(RotaryLocationErrors { axis, point_mm, shift_um, tilt_urad });
    };
    let one = |n: usize| {
        let mut vector = [0.0; 3];
        vector[n] = 1.0;
        vector
    };
    match error {
        GeometricError::Shift(along, axis) => location(axis, one(along.index()), [0.0; 3]),
        GeometricError::Tilt(about, axis) => location(axis, [0.0; 3], one(about.index())),
        GeometricError::Angle(about, along) => {
            let knots_mm = vec![-1e6, -1e6, 1e6, 1e6];
            let angle =
                AngleProfile::Curve(BSpline { order: 2, knots_mm, control_um: vec![1.0; 2] });
            volume.angular.push(AngularErrorMotion { about, along, angle });
        }
        GeometricError::Position(_)
        | GeometricError::Straightness(..)
        | GeometricError::Squareness(..) => return None,
    }
    Some(own)
}
