//! One ball, touched on top and at four places of its equator: from above, each side for itself.
//!
//! ```text
//!      ▼ 5        the middle of two opposite touches is the centre, whatever radius and pre-travel are
//!   ► ( ) ◄       (1, 2 and 3, 4); along the tool the radius of ball and stylus stays in the result, the
//!                 same for all balls of a stylus, as a part of its tip
//! ```

use trueup_machine::machine_file::LinearAxis;

use super::probing::{ProbeSetup, require_option};
use crate::{
    options::MeasurementOptions,
    plan::{Column, Step},
    probe::{ProbedPoint, TouchMean},
    program_error::ProgramError,
    travel::round_to_micrometres,
};

/// A ball by its diameter and that of the stylus.
pub(super) struct Ball {
    /// From centre to centre where both touch, in mm.
    apart_mm: f64,
}

/// A place where a ball is touched.
#[derive(Clone, Copy)]
pub(super) struct BallTarget {
    pub run: u32,
    /// Where the axes would stand with the tip in the centre of the ball.
    pub at_mm: [f64; 3],
    pub angle_deg: [Option<f64>; 3],
    pub tool_length_mm: Option<f64>,
    pub point: Option<u32>,
}

impl Ball {
    pub fn new(probing: &ProbeSetup, options: &MeasurementOptions) -> Result<Self, ProgramError> {
        let ball_mm = require_option(options.ball_mm, "--ball", "the diameter of the ball")?;
        let apart_mm = (ball_mm + probing.stylus_mm) / 2.0;
        // A touch that looks further would pass the ball on its other side.
        if probing.search_mm > apart_mm / 2.0 {
            return Err(ProgramError(format!(
                "--search {} is too far for a ball of {ball_mm} mm: at most {} mm",
                probing.search_mm,
                apart_mm / 2.0
            )));
        }
        Ok(Self { apart_mm })
    }

    /// Returns how far from the centre of a ball the tip is where it does not touch, in mm.
    pub(crate) fn clearance_radius_mm(&self, probing: &ProbeSetup) -> f64 {
        self.apart_mm + probing.search_mm
    }

    /// Checks that a place can be reached.
    pub fn check(&self, probing: &ProbeSetup, at_mm: [f64; 3]) -> Result<(), ProgramError> {
        let clear = self.clearance_radius_mm(probing);
        for axis in probing.sides {
            probing.check_travel(axis, &[at_mm[axis] - clear, at_mm[axis] + clear])?;
        }
        let above = at_mm[probing.tool] + probing.retract * clear;
        probing.check_travel(probing.tool, &[at_mm[probing.tool], above])
    }

    /// Returns the steps from above any ball, or retracted, to above this one, touched, and its reading.
    pub(crate) fn probing_steps(&self, probing: &ProbeSetup, place: &BallTarget) -> Vec<Step> {
        let (tool, up, clear) = (probing.tool, probing.retract, self.clearance_radius_mm(probing));
        let centre = place.at_mm;
        let above = centre[tool] + up * clear;
        let top = centre[tool] + up * self.apart_mm;
        let mut steps = probing.sides.map(|axis| probing.guarded_move(axis, centre[axis])).to_vec();
        steps.extend([probing.guarded_move(tool, above), probing.touch_step(tool, top, -up, 5)]);
        let mut number = 0;
        for axis in probing.sides {
            for side in [-1.0, 1.0] {
                number += 1;
                steps.extend([
                    probing.guarded_move(axis, centre[axis] + side * clear),
                    probing.guarded_move(tool, centre[tool]),
                    probing.touch_step(axis, centre[axis] + side * self.apart_mm, -side, number),
                    probing.guarded_move(tool, above),
                    probing.guarded_move(axis, centre[axis]),
                ]);
            }
        }
        let mut by = [None; 3];
        for (n, axis) in probing.sides.into_iter().enumerate() {
            let touches = [2 * n + 1, 2 * n + 2];
            by[axis] = Some(TouchMean { touches, expected_mm: centre[axis] });
        }
        by[tool] = Some(TouchMean { touches: [5, 5], expected_mm: round_to_micrometres(top) });
        let BallTarget { run, at_mm, angle_deg, tool_length_mm, point } = *place;
        steps.push(Step::Found(ProbedPoint { run, at_mm, angle_deg, tool_length_mm, point, by }));
        steps
    }
}

/// Returns the columns of balls; `rotary` axes have one each.
pub(super) fn ball_columns(
    probing: &ProbeSetup,
    rotary: &[usize],
    has_points: bool,
) -> Vec<Column> {
    let mut columns = vec![Column::Run, Column::Constant("setup", 1.0)];
    columns.extend(has_points.then_some(Column::Point));
    columns.extend(LinearAxis::ALL.map(|axis| Column::Position(axis.index())));
    columns.extend(rotary.iter().map(|axis| Column::Angle(*axis)));
    columns.extend(probing.tool_lengths_mm[0].map(|_| Column::ToolLength));
    columns.extend(LinearAxis::ALL.map(|axis| Column::Empty(super::measured_column_name(axis))));
    columns
}
