//! The unknowns of a set-up: where the artefact lies and how it is turned, the tip of the stylus, the scale of the artefact, the
//! direction of a beam, radius and centre of a circle. None of these is an error of the machine.
//!
//! | unknown | reading |
//! |---|---|
//! | zero of a set-up, alignment of a set-up | s + ω × p, of the workpiece and turned with its table; both faces of a square have one ω |
//! | tip of each tool in a file | t, turned with the head |
//! | scale of all artefacts of a kind | κ·p |
//! | direction of a beam | δ·p across the diagonal: lateral steps see it to first order |
//! | circle | radius, centre; backlash, lateral play and servo mismatch, which change their sign with the direction |
//! | form of a straight edge without a certificate | smooth along the edge |
//! | point of an artefact | its deviation from the certificate, the same in all set-ups |

use std::{collections::BTreeMap, sync::LazyLock};

use super::{
    kinematics::ForwardKinematics,
    reading::{EdgePosition, Pose, ReadingKind, VolumeReading, cross, dot},
    spline_modes::SplineModes,
};

/// An unknown of a set-up; `usize` is a number of a set-up, and which of its components.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum NuisanceParameter {
    /// Where the artefact lies, in µm.
    Zero(usize, usize),
    /// How it is turned, in µrad.
    Turn(usize, usize),
    /// The tip of a tool, by the number of the file and the bits of its length.
    Tip(usize, u64, usize),
    /// The scale of the artefacts of a kind, in µm/m.
    Scale(ReadingKind),
    /// How a beam is turned from the diagonal, in µrad.
    Beam(usize, usize),
    /// Radius, centre, and what changes its sign with the direction.
    Circle(usize, usize),
    /// A form of a straight edge by the number of the edge, in µm.
    Edge(usize, usize),
    /// A point of an artefact, in µm.
    Point(i64, usize),
}

/// How large these may be, in µm, µrad or µm/m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArtefactUncertainty {
    /// Of the scale; standard uncertainty in µm/m.
    pub scale_um_per_m: f64,
    /// Of a point of the artefact against its certificate, in µm; 0: it is right.
    pub artefact_um: f64,
}

const PRIOR_POSITION_STD_UM: f64 = 1e4;
const PRIOR_ROTATION_STD_URAD: f64 = 1e4;
const PRIOR_TIP_STD_UM: f64 = 1e3;
const PRIOR_SERVO_MISMATCH_STD_UM: f64 = 20.0;
/// A straight edge that nothing is known of: RMS of its form.
const PRIOR_EDGE_STD_UM: f64 = 10.0;

/// Returns the forms over an edge, from 0 to 1.
fn edge_modes() -> &'static SplineModes {
    static EDGE_MODES: LazyLock<SplineModes> = LazyLock::new(|| SplineModes::new([0.0, 1.0]));
    &EDGE_MODES
}

impl NuisanceParameter {
    /// Returns the standard deviation that is expected before anything is read.
    #[must_use]
    pub(crate) fn prior_std(self, uncertainty: &ArtefactUncertainty) -> f64 {
        match self {
            Self::Zero(..) => PRIOR_POSITION_STD_UM,
            Self::Turn(..) | Self::Beam(..) => PRIOR_ROTATION_STD_URAD,
            Self::Tip(..) => PRIOR_TIP_STD_UM,
            Self::Scale(_) => uncertainty.scale_um_per_m,
            Self::Circle(_, component) if component < 3 => PRIOR_TIP_STD_UM,
            Self::Circle(..) => PRIOR_SERVO_MISMATCH_STD_UM,
            Self::Edge(_, form) => {
                PRIOR_EDGE_STD_UM * edge_modes().shares.get(form).map_or(0.0, |share| share.sqrt())
            }
            Self::Point(..) => uncertainty.artefact_um,
        }
    }

    /// Returns its name in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Zero(..) => "the place of the artefact",
            Self::Turn(..) => "the alignment of the artefact",
            Self::Tip(..) => "the tip of the stylus",
            Self::Scale(_) => "the scale of the artefact",
            Self::Beam(..) => "the direction of the beam",
            Self::Circle(..) => "radius, centre and servo mismatch of the circle",
            Self::Edge(..) | Self::Point(..) => "the form of the artefact",
        }
    }
}

/// The means of each set-up's places, about which it is turned.
#[derive(Clone, Debug, Default)]
pub(crate) struct SetupCentroids(BTreeMap<usize, ([f64; 3], f64)>);

impl SetupCentroids {
    /// Returns the centres of the set-ups of `readings`.
    #[must_use]
    pub(crate) fn from_readings(readings: &[VolumeReading], frame: &ForwardKinematics<'_>) -> Self {
        let mut sums: BTreeMap<usize, ([f64; 3], f64)> = BTreeMap::new();
        for reading in readings {
            let place = measured_point_mm(reading, frame);
            let (sum, count) = sums.entry(reading.setup).or_default();
            sum.iter_mut().zip(place).for_each(|(sum, mm)| *sum += mm);
            *count += 1.0;
        }
        Self(sums)
    }

    fn lever_arm_mm(&self, reading: &VolumeReading, frame: &ForwardKinematics<'_>) -> [f64; 3] {
        let place = measured_point_mm(reading, frame);
        let (sum, count) = self.0.get(&reading.setup).copied().unwrap_or(([0.0; 3], 1.0));
        [0, 1, 2].map(|n| place[n] - sum[n] / count)
    }
}

fn measured_point_mm(reading: &VolumeReading, frame: &ForwardKinematics<'_>) -> [f64; 3] {
    match reading.kind {
        ReadingKind::Ball | ReadingKind::Edge => frame.tip_on_workpiece_mm(&reading.pose),
        ReadingKind::Diagonal | ReadingKind::Circle => reading.pose.position_mm,
    }
}

/// Returns the unknowns of a reading, each with what a unit of it adds.
#[must_use]
pub(crate) fn nuisance_sensitivities(
    reading: &VolumeReading,
    frame: &ForwardKinematics<'_>,
    centres: &SetupCentroids,
) -> Vec<(NuisanceParameter, f64)> {
    let own = reading.setup;
    let arm_mm = centres.lever_arm_mm(reading, frame);
    match (reading.kind, reading.on_circle) {
        (ReadingKind::Circle, Some(on)) => {
            let (sin, cos) = on.angle.sin_cos();
            let of_direction = [
                sin.signum() * cos,
                cos.signum() * sin,
                sin.signum() * sin,
                cos.signum() * cos,
                sin * cos,
            ];
            let columns = [1.0, cos, sin].into_iter();
            let columns = columns.chain(of_direction.map(|amount| amount * on.sense));
            columns
                .enumerate()
                .map(|(n, column)| (NuisanceParameter::Circle(own, n), column))
                .collect()
        }
        (ReadingKind::Diagonal, _) => {
            let along = dot(arm_mm, reading.toward);
            let mut all = vec![
                (NuisanceParameter::Zero(own, 0), 1.0),
                (NuisanceParameter::Scale(ReadingKind::Diagonal), along / 1000.0),
            ];
            let across = perpendicular_directions(reading.toward);
            all.extend(across.into_iter().enumerate().map(|(n, direction)| {
                (NuisanceParameter::Beam(own, n), dot(arm_mm, direction) / 1000.0)
            }));
            all
        }
        _ => workpiece_nuisance_sensitivities(reading, frame, arm_mm),
    }
}

fn workpiece_nuisance_sensitivities(
    reading: &VolumeReading,
    frame: &ForwardKinematics<'_>,
    arm_mm: [f64; 3],
) -> Vec<(NuisanceParameter, f64)> {
    let (own, aligned, pose): (_, _, &Pose) = (reading.setup, reading.aligned, &reading.pose);
    let seen = |vector| dot(reading.toward, frame.workpiece_direction_to_machine(vector, pose));
    let mut all = vec![(NuisanceParameter::Scale(reading.kind), seen(arm_mm) / 1000.0)];
    if let Some(EdgePosition { edge, share }) = reading.on_edge {
        let forms = edge_modes().evaluate(share).into_iter().enumerate();
        all.extend(forms.map(|(n, um)| (NuisanceParameter::Edge(edge, n), um)));
    }
    for n in 0..3 {
        let mut one = [0.0; 3];
        one[n] = 1.0;
        all.push((NuisanceParameter::Zero(own, n), seen(one)));
        all.push((NuisanceParameter::Turn(aligned, n), seen(cross(one, arm_mm)) / 1000.0));
        let tip = dot(reading.toward, frame.tool_direction_to_machine(one, pose));
        all.push((NuisanceParameter::Tip(reading.source[0], pose.tool_mm.to_bits(), n), tip));
        if let Some(point) = reading.point {
            all.push((NuisanceParameter::Point(point, n), seen(one)));
        }
    }
    all
}

/// Returns two directions across a third.
fn perpendicular_directions(toward: [f64; 3]) -> [[f64; 3]; 2] {
    let least = (0..3).min_by(|a, b| toward[*a].abs().total_cmp(&toward[*b].abs())).unwrap_or(0);
    let mut other = [0.0; 3];
    other[least] = 1.0;
    let first = cross(toward, other);
    let length = dot(first, first).sqrt();
    let first = first.map(|component| component / length);
    [first, cross(toward, first)]
}
