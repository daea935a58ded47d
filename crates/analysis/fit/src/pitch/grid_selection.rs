//! At which points a table stands.
//!
//! Targets of equal steps are the points themselves. From uneven targets the widest step is taken
//! that loses at the targets no more than a tenth of the variance of their means or a hundredth of
//! the measured shape. A record of more positions than a table may have points is
//! smoothed: the step is the one that predicts every second cell best from the others.

use trueup_machine::model::pitch_error_um;

use super::{
    PitchFitOptions,
    cross_validation::DirectionSums,
    pitch_table::{TableGrid, TargetMeans},
    readings::PitchReadings,
    scatter::RepeatScatter,
};
use crate::report::{FitDetail, FitReport};

/// A table that loses no more than this share of the variance of the means is as good as they are.
const MAX_VARIANCE_LOSS_FRACTION: f64 = 0.1;

/// A table that loses no more than this share of the root mean square of the measured shape is as
/// good, however well the axis repeats.
const MAX_SHAPE_LOSS_FRACTION: f64 = 0.01;

/// Returns the points of the table.
pub(super) fn choose_table_grid(
    readings: &PitchReadings,
    sums: &DirectionSums,
    options: &PitchFitOptions,
    report: &mut FitReport,
) -> TableGrid {
    let targets = &readings.targets_mm;
    let lines = [0, 1].map(|way| sums.direction_means(targets, way));
    let lines: Vec<&TargetMeans> = lines.iter().filter(|line| !line.points.is_empty()).collect();
    let most = options.most_points.max(2);
    let equal = TableGrid::from_equally_spaced_targets(targets).filter(|grid| grid.points <= most);
    if let (None, Some(grid)) = (options.step_mm, equal) {
        return grid;
    }
    let scatter = RepeatScatter::from_targets(&readings.values_by_target());
    let of_means_um =
        MAX_VARIANCE_LOSS_FRACTION.sqrt() * scatter.standard_error_um().unwrap_or(0.0);
    let enough_um = of_means_um.max(MAX_SHAPE_LOSS_FRACTION * scatter.shape_um);
    let (grid, loss_um) = match options.step_mm {
        Some(step_mm) => {
            let grid = TableGrid::with_step(targets, step_mm);
            (grid, grid.rms_loss_um(&lines))
        }
        None if targets.len() > most => select_grid_by_cross_validation(readings, most, &lines),
        None => {
            let mut best = (TableGrid::with_point_count(targets, 2), f64::INFINITY);
            for points in 2..=most {
                let grid = TableGrid::with_point_count(targets, points);
                let loss_um = grid.rms_loss_um(&lines);
                if loss_um < best.1 {
                    best = (grid, loss_um);
                }
                if loss_um <= enough_um {
                    break;
                }
            }
            best
        }
    };
    report.facts.push(FitDetail::number("resampling_loss_um", loss_um));
    if loss_um > enough_um && targets.len() <= most {
        report.warnings.push(format!(
            "the targets are not at equal distances; a table of {} points every {} mm misses the measured means by {loss_um:.3} µm rms. Their scatter allows {enough_um:.3} µm",
            grid.points, grid.step_mm
        ));
    }
    grid
}

/// For a record of more positions than a table may have points: the number of points with the
/// least error on every second cell, fitted to the others.
fn select_grid_by_cross_validation(
    readings: &PitchReadings,
    most: usize,
    lines: &[&TargetMeans],
) -> (TableGrid, f64) {
    // Each step of the search has a quarter more points than the one before.
    let counts = std::iter::successors(Some(2_usize), |count| Some(count + 1 + count / 4));
    let half = |line: &TargetMeans, odd: usize| {
        let points = line.points.iter().enumerate().filter(|(n, _)| n % 2 == odd);
        TargetMeans { points: points.map(|(_, point)| *point).collect() }
    };
    let mut best = (TableGrid::with_point_count(&readings.targets_mm, 2), f64::INFINITY);
    for points in counts.take_while(|count| *count <= most) {
        let grid = TableGrid::with_point_count(&readings.targets_mm, points);
        let (mut squares, mut weights) = (0.0, 0.0);
        for line in lines {
            for odd in [0, 1] {
                let table = grid.fit_pitch_table(&half(line, odd), None);
                for (x, um, weight) in half(line, 1 - odd).points {
                    squares += weight * (um - pitch_error_um(&table, x, 1.0)).powi(2);
                    weights += weight;
                }
            }
        }
        let error_um = (squares / weights).sqrt();
        if error_um < best.1 {
            best = (grid, error_um);
        }
    }
    (best.0, best.0.rms_loss_um(lines))
}
