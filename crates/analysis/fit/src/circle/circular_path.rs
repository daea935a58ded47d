//! The path of a record: the circle through its positions, and the direction of each row.

use std::{f64::consts::TAU, ops::Range};

use trueup_machine::{RunFile, machine_file::LinearAxis};
use trueup_numerics::{least_squares::GivensQr, robust};

/// Returns centre and radius of the circle of least squares through the points.
pub(super) fn fit_circle(points: &[[f64; 2]]) -> Option<([f64; 2], f64)> {
    let count = points.len() as f64;
    let middle = [0, 1].map(|axis| points.iter().map(|at| at[axis]).sum::<f64>() / count);
    let mut triangle = GivensQr::new(3);
    for at in points {
        let [u, v] = [at[0] - middle[0], at[1] - middle[1]];
        triangle.add_row(&[1.0, 2.0 * u, 2.0 * v], u * u + v * v);
    }
    let [c, u, v] = triangle.solve().ok()?.coefficients[..] else { return None };
    let radius = (c + u * u + v * v).sqrt();
    (radius > 0.0).then_some(([middle[0] + u, middle[1] + v], radius))
}

/// Returns the shortest turn from one angle to another, in rad.
pub(super) fn angle_difference_rad(from: f64, to: f64) -> f64 {
    let turn = to - from;
    turn - TAU * (turn / TAU).round()
}

/// Returns the direction of each row: +1, −1, and 0 where nothing moves.
pub(super) fn rotation_directions(
    run: &RunFile,
    axes: [LinearAxis; 2],
    rows: &[usize],
    angles: &[f64],
) -> Vec<f64> {
    if let Some(dir) = run.column("dir") {
        return rows.iter().map(|row| if dir[*row] < 0.0 { -1.0 } else { 1.0 }).collect();
    }
    /// Rows ahead and behind by which the turn is known: positions that were measured tremble.
    const NEIGHBOUR_ROWS_PER_SIDE: usize = 2;
    let parts = split_at_jumps(angles);
    let by_order = |at: usize| {
        let part = &parts[parts.partition_point(|part| part.end <= at)];
        let from = at.saturating_sub(NEIGHBOUR_ROWS_PER_SIDE).max(part.start);
        let to = (at + NEIGHBOUR_ROWS_PER_SIDE).min(part.end - 1);
        // Turn by turn: the sum may be more than half a circle.
        let turn = |pair: &[f64]| angle_difference_rad(pair[0], pair[1]);
        let [behind, ahead] = [&angles[from..=at], &angles[at..=to]]
            .map(|part| part.windows(2).map(turn).sum::<f64>());
        // Where the direction changes a row belongs to the way on which it was reached.
        let turn = match behind * ahead < 0.0 {
            true if angle_difference_rad(angles[at - 1], angles[at]) * behind > 0.0 => behind,
            true => ahead,
            false => behind + ahead,
        };
        if turn.abs() < 1e-9 { 0.0 } else { turn.signum() }
    };
    let [of_u, of_v] = axes.map(|axis| run.column(&format!("dir_{}", axis.name())));
    let sense = |at: usize| {
        let (sin, cos) = angles[at].sin_cos();
        let stated = |of: Option<&[f64]>, velocity: f64| {
            of.map(|all| all[rows[at]] * velocity.signum()).filter(|value| !value.is_nan())
        };
        // The axis that moves faster.
        let fast = if sin.abs() > cos.abs() { stated(of_u, -sin) } else { stated(of_v, cos) };
        fast.unwrap_or_else(|| by_order(at))
    };
    (0..rows.len()).map(sense).collect()
}

/// Returns the parts in which no angle is far from the one before: between them the instrument did not read.
fn split_at_jumps(angles: &[f64]) -> Vec<Range<usize>> {
    /// The longest step in median steps.
    const MAX_STEP_TO_MEDIAN_RATIO: f64 = 6.0;
    let steps: Vec<f64> =
        angles.windows(2).map(|pair| angle_difference_rad(pair[0], pair[1]).abs()).collect();
    let longest = MAX_STEP_TO_MEDIAN_RATIO * robust::median(&mut steps.clone());
    let mut ends: Vec<usize> = (1..angles.len()).filter(|at| steps[at - 1] > longest).collect();
    ends.push(angles.len());
    let mut start = 0;
    ends.into_iter().map(|end| std::mem::replace(&mut start, end)..end).collect()
}
