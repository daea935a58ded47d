//! The measurement that would settle what is not known: usual ones are added to the places that were measured, and what they would
//! leave open is computed before anything moves.

use std::f64::consts::TAU;

use trueup_machine::{Machine, machine_file::RotaryAxis};

use super::{
    design_matrix::{DesignMatrix, normal_equations},
    error_parameters::ErrorParameters,
    identifiability::{
        ErrorAssessment, MAX_REMAINING_STD_RATIO, TOOL_LENGTH_DIFFERENCE_MM, assess_observability,
        remaining_std_ratio,
    },
    kinematics::ForwardKinematics,
    nuisance_parameters::ArtefactUncertainty,
    reading::{CirclePosition, Pose, ReadingKind, VolumeReading, dot},
};

/// The largest part of an open standard deviation that a measurement may leave, where it is proposed without settling it.
const MAX_HELPFUL_STD_RATIO: f64 = 0.7;

/// A measurement that could be made.
struct CandidateTest {
    text: String,
    readings: Vec<VolumeReading>,
}

/// Fills in the next test of each error that acts and is not known.
pub(crate) fn propose_next_tests(
    machine: &Machine,
    constants: &ErrorParameters,
    readings: &[VolumeReading],
    uncertainty: &ArtefactUncertainty,
    noise_um: [f64; 4],
    known: &mut [ErrorAssessment],
) {
    if known.iter().all(|assessment| assessment.is_known) {
        return;
    }
    let mut best: Vec<(f64, String)> =
        known.iter().map(|assessment| (assessment.open, String::new())).collect();
    for candidate in candidate_tests(machine, constants, readings) {
        if known
            .iter()
            .zip(&best)
            .all(|(assessment, best)| assessment.is_known || best.0 <= MAX_REMAINING_STD_RATIO)
        {
            break;
        }
        let mut all = readings.to_vec();
        let first = readings
            .iter()
            .map(|reading| reading.setup.max(reading.aligned) + 1)
            .max()
            .unwrap_or(0);
        all.extend(candidate.readings.iter().map(|reading| VolumeReading {
            setup: reading.setup + first,
            aligned: reading.aligned + first,
            ..*reading
        }));
        let design = DesignMatrix::new(machine, constants.clone(), &all);
        let normal_equations = normal_equations(&design, &all, |_| true);
        let observability = assess_observability(&design, &normal_equations, uncertainty, noise_um);
        for (it, best) in known.iter().zip(&mut best) {
            let left = remaining_std_ratio(&design, it.error, &observability);
            // The first that settles it stays: candidates begin with the easiest.
            if best.0 > MAX_REMAINING_STD_RATIO && left < best.0 {
                *best = (left, candidate.text.clone());
            }
        }
    }
    for (it, (left, text)) in known.iter_mut().zip(best) {
        it.next_test = match (it.is_known, left) {
            (true, _) => continue,
            (false, left) if left <= MAX_REMAINING_STD_RATIO => text,
            (false, left) if left <= MAX_HELPFUL_STD_RATIO * it.open => format!("{text}; it helps and does not settle it"),
            (false, _) if !it.acts => {
                "it does not move the tip: with this tool no measurement of the tip sees it, and no part does".into()
            }
            (false, _) => "none of the usual measurements settles it".into(),
        };
    }
}

fn candidate_tests(
    machine: &Machine,
    constants: &ErrorParameters,
    readings: &[VolumeReading],
) -> Vec<CandidateTest> {
    let ends = [0, 1, 2].map(|n| {
        let at = || readings.iter().map(|reading| reading.pose.position_mm[n]);
        [at().fold(f64::INFINITY, f64::min), at().fold(f64::MIN, f64::max)]
    });
    let tool_mm = readings.iter().map(|reading| reading.pose.tool_mm).fold(f64::INFINITY, f64::min);
    let place = |shares: [f64; 3], angle_deg, tool_mm| Pose {
        position_mm: [0, 1, 2].map(|n| ends[n][0] + shares[n] * (ends[n][1] - ends[n][0])),
        angle_deg,
        tool_mm,
    };
    let longer = readings.iter().map(|reading| {
        let pose =
            Pose { tool_mm: reading.pose.tool_mm + TOOL_LENGTH_DIFFERENCE_MM, ..reading.pose };
        VolumeReading { pose, ..*reading }
    });
    let mut all = vec![CandidateTest {
        text: format!(
            "the same measurement with a tool that is {TOOL_LENGTH_DIFFERENCE_MM:.0} mm longer"
        ),
        readings: longer.collect(),
    }];
    let moves = constants.modes.iter().all(Option::is_some);
    if moves {
        let mut circles = Vec::new();
        for (setup, still) in [2, 0, 1, 2, 0, 1].into_iter().enumerate() {
            let share = if setup < 3 { 0.05 } else { 0.95 };
            push_circle_readings(&mut circles, setup, still, share, ends, tool_mm);
        }
        all.push(CandidateTest {
            text: "circles in XY, YZ and ZX, each at both ends of the third axis (trueup program circle)".into(),
            readings: circles,
        });
        let text =
            "step diagonals along the four body diagonals (trueup program step-diagonal)".into();
        all.push(CandidateTest { text, readings: diagonal_readings(&place, tool_mm) });
        let text = "a ball plate in three heights (trueup program plate), then upright along X and along Y".into();
        all.push(CandidateTest { text, readings: plate_readings(&place, tool_mm) });
    }
    let chain = machine.volume.chain.as_ref();
    let rotary =
        chain.map(trueup_machine::machine_file::AxisChain::rotary_axes).unwrap_or_default();
    if let Some(chain) = chain.filter(|_| !rotary.is_empty()) {
        let frame = ForwardKinematics::new(machine, chain);
        let middle = place([0.5; 3], [0.0; 3], tool_mm);
        let text =
            "a sphere on the table, probed at many angles of the rotary axes and with two tools (trueup program sphere)"
                .into();
        all.push(CandidateTest { text, readings: sphere_readings(&frame, &rotary, &middle) });
    }
    all
}

fn push_ball_readings(into: &mut Vec<VolumeReading>, setup: usize, pose: Pose) {
    for n in 0..3 {
        let mut toward = [0.0; 3];
        toward[n] = 1.0;
        into.push(VolumeReading { toward, ..blank_reading(ReadingKind::Ball, setup, pose) });
    }
}

fn blank_reading(kind: ReadingKind, setup: usize, pose: Pose) -> VolumeReading {
    VolumeReading {
        kind,
        pose,
        toward: [0.0; 3],
        um: 0.0,
        measured_um: 0.0,
        setup,
        aligned: setup,
        on_circle: None,
        on_edge: None,
        point: None,
        source: [0, 0],
        column: "",
    }
}

fn push_circle_readings(
    into: &mut Vec<VolumeReading>,
    setup: usize,
    still: usize,
    share: f64,
    ends: [[f64; 2]; 3],
    tool_mm: f64,
) {
    let [u, v] = [(still + 1) % 3, (still + 2) % 3];
    let half = |n: usize| 0.5 * (ends[n][1] - ends[n][0]);
    let radius = half(u).min(half(v));
    for sense in [1.0, -1.0] {
        for n in 0..72 {
            let angle = TAU * f64::from(n) / 72.0 + 1e-3;
            let (sin, cos) = angle.sin_cos();
            let mut position_mm = ends.map(|[first, last]| first + share * (last - first));
            position_mm[u] = ends[u][0] + half(u) + radius * cos;
            position_mm[v] = ends[v][0] + half(v) + radius * sin;
            let mut toward = [0.0; 3];
            (toward[u], toward[v]) = (cos, sin);
            let pose = Pose { position_mm, angle_deg: [0.0; 3], tool_mm };
            let on_circle = Some(CirclePosition { angle, sense });
            into.push(VolumeReading {
                toward,
                on_circle,
                ..blank_reading(ReadingKind::Circle, setup, pose)
            });
        }
    }
}

fn diagonal_readings(
    place: &dyn Fn([f64; 3], [f64; 3], f64) -> Pose,
    tool_mm: f64,
) -> Vec<VolumeReading> {
    const DIAGONAL_STEPS: usize = 6;
    let mut readings = Vec::new();
    for setup in 0..4_usize {
        let share = |n: usize, done: usize| {
            let done = done as f64 / DIAGONAL_STEPS as f64;
            // The first diagonal is that of 0 to 1; each other one has one axis the other way round.
            if n + 1 == setup { 1.0 - done } else { done }
        };
        let at = |step: usize, moved: usize| {
            let shares = [0, 1, 2].map(|n| share(n, step + usize::from(n < moved)));
            place(shares, [0.0; 3], tool_mm)
        };
        let way = |n: usize| at(DIAGONAL_STEPS, 0).position_mm[n] - at(0, 0).position_mm[n];
        let way = [0, 1, 2].map(way);
        let length = dot(way, way).sqrt();
        let toward = way.map(|mm| mm / length);
        for step in 0..DIAGONAL_STEPS {
            for moved in 0..3 {
                readings.push(VolumeReading {
                    toward,
                    ..blank_reading(ReadingKind::Diagonal, setup, at(step, moved))
                });
            }
        }
        readings.push(VolumeReading {
            toward,
            ..blank_reading(ReadingKind::Diagonal, setup, at(DIAGONAL_STEPS, 0))
        });
    }
    readings
}

fn plate_readings(
    place: &dyn Fn([f64; 3], [f64; 3], f64) -> Pose,
    tool_mm: f64,
) -> Vec<VolumeReading> {
    const TRAVEL_FRACTIONS: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
    let mut readings = Vec::new();
    for one in TRAVEL_FRACTIONS {
        for other in TRAVEL_FRACTIONS {
            for height in [0.0, 0.5, 1.0] {
                push_ball_readings(
                    &mut readings,
                    0,
                    place([one, other, height], [0.0; 3], tool_mm),
                );
            }
            push_ball_readings(&mut readings, 1, place([one, 0.5, other], [0.0; 3], tool_mm));
            push_ball_readings(&mut readings, 2, place([0.5, one, other], [0.0; 3], tool_mm));
        }
    }
    readings
}

/// Returns the readings of a sphere in the middle of the volume that stays on the table while the axes turn.
fn sphere_readings(
    frame: &ForwardKinematics<'_>,
    rotary: &[RotaryAxis],
    middle: &Pose,
) -> Vec<VolumeReading> {
    const ROTARY_TEST_ANGLES_DEG: [f64; 6] = [-90.0, -45.0, 0.0, 30.0, 60.0, 90.0];
    let own = frame.tip_on_workpiece_mm(middle);
    let mut readings = Vec::new();
    let others: &[f64] =
        if rotary.len() > 1 { &ROTARY_TEST_ANGLES_DEG } else { &ROTARY_TEST_ANGLES_DEG[..1] };
    for longer in [0.0, TOOL_LENGTH_DIFFERENCE_MM] {
        for first in ROTARY_TEST_ANGLES_DEG {
            for other in others {
                let mut pose = Pose { tool_mm: middle.tool_mm + longer, ..*middle };
                pose.angle_deg[rotary[0].index()] = first;
                if let Some(axis) = rotary.get(1) {
                    pose.angle_deg[axis.index()] = *other;
                }
                // To first order the axes follow the sphere.
                let off = frame.tip_on_workpiece_mm(&pose);
                let way =
                    frame.workpiece_direction_to_machine([0, 1, 2].map(|n| own[n] - off[n]), &pose);
                (0..3).for_each(|n| pose.position_mm[n] += way[n]);
                push_ball_readings(&mut readings, 0, pose);
            }
        }
    }
    readings
}
