//! Judges which errors are known, by what the measurement can see, whatever it has read; and the correction, by held-out readings.
//!
//! An error is known if the readings' places leave at most two fifths of twice its usual size open (the standard deviation after,
//! against the one before). One that is not known is confused with another if that one, once known, would take half of the variance away.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{DMatrix, DVector};
use trueup_numerics::random::RandomGenerator;

use super::{
    design_matrix::{DesignMatrix, NormalEquationsByKind, normal_equations},
    empirical_bayes::{Posterior, Variances, compute_posterior},
    error_parameters::{ErrorPart, GeometricError},
    nuisance_parameters::ArtefactUncertainty,
    reading::{CirclePosition, Pose, VolumeReading},
};

/// Share of the standard deviation before the measurement that may be left of a known error.
pub(crate) const MAX_REMAINING_STD_RATIO: f64 = 0.4;
/// How much longer a second tool is.
pub(crate) const TOOL_LENGTH_DIFFERENCE_MM: f64 = 100.0;
/// How much larger than usual an error may be in what a measurement can see.
const PRIOR_WIDENING_FACTOR: f64 = 2.0;
/// Places along the travel at which a function is looked at.
const TRAVEL_GRID_POINTS: usize = 21;
/// Share of the variance that another error must take away to be confused with.
const MIN_CONFOUNDING_FRACTION: f64 = 0.5;
/// Names in that list.
const MAX_CONFOUNDERS: usize = 3;
/// Blocks of readings, each held out once.
const CROSS_VALIDATION_BLOCKS: usize = 5;
const CROSS_VALIDATION_SEED: u64 = 230;
/// Readings of a set-up that must be left to give its zero and alignment.
const MIN_REMAINING_READINGS: usize = 9;
/// A block of a circle, in rad: 30°.
const BLOCK_ARC_RAD: f64 = std::f64::consts::TAU / 12.0;
/// Normal quantile of a 95 % interval.
pub const NORMAL_QUANTILE_975: f64 = 1.96;
/// Normal quantile of 95 % on one side.
const NORMAL_QUANTILE_95: f64 = 1.645;

/// How well an error is known.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorAssessment {
    /// The error.
    pub error: GeometricError,
    /// Whether it moves the tool tip anywhere in the measured volume.
    pub acts: bool,
    /// Whether it is known.
    pub is_known: bool,
    /// The standard deviation after the measurement as a share of the one before.
    pub open: f64,
    /// The value of a number; of a function largest minus smallest value over the travel.
    pub size: f64,
    /// Half of the 95 % interval of the value; of a function its root mean square over the travel.
    pub half_width: f64,
    /// Whether it is not zero: of a function, whether all its constants together are not, at 95 %.
    pub is_there: bool,
    /// Of a function the position in mm, the value there, and half of its 95 % interval.
    pub curve: Vec<[f64; 3]>,
    /// The names of errors and unknowns that look the same.
    pub confused_with: Vec<String>,
    /// The measurement that would settle it.
    pub next_test: String,
}

/// Returns rows of the constants that give an error at places along its travel; one row of a number.
#[must_use]
pub(crate) fn evaluation_rows(design: &DesignMatrix, error: GeometricError) -> Vec<Vec<f64>> {
    let constants = &design.constants;
    let own = constants.indices_of_error(error);
    let mut row = vec![0.0; constants.all.len()];
    let modes = error.motion_axis().and_then(|along| constants.modes[along.index()].as_ref());
    let Some(modes) = modes else {
        own.iter().for_each(|at| row[*at] = 1.0);
        return vec![row];
    };
    let each = (0..TRAVEL_GRID_POINTS).map(|n| {
        let mm = grid_position_mm(modes.ends_mm, n);
        let forms = modes.evaluate(mm);
        let mut row = row.clone();
        for at in &own {
            row[*at] = match constants.all[*at].part {
                ErrorPart::Form(form) => forms[form],
                _ => (mm - modes.middle_mm()) / 1000.0,
            };
        }
        row
    });
    each.collect()
}

fn grid_position_mm([first, last]: [f64; 2], number: usize) -> f64 {
    first + (last - first) * number as f64 / (TRAVEL_GRID_POINTS - 1) as f64
}

/// Returns what the places of the readings can see: expected variances that are wide, and those after.
#[must_use]
pub(crate) fn assess_observability(
    design: &DesignMatrix,
    normal_equations: &NormalEquationsByKind,
    uncertainty: &ArtefactUncertainty,
    noise_um: [f64; 4],
) -> (Variances, Posterior) {
    let wide = Variances::typical(design, uncertainty, noise_um, PRIOR_WIDENING_FACTOR);
    let seen = compute_posterior(normal_equations, &wide);
    (wide, seen)
}

/// Returns the share of an error's standard deviation that is left open.
#[must_use]
pub(crate) fn remaining_std_ratio(
    design: &DesignMatrix,
    error: GeometricError,
    (wide, seen): &(Variances, Posterior),
) -> f64 {
    let rows = evaluation_rows(design, error);
    let before: f64 = rows
        .iter()
        .flat_map(|row| row.iter().enumerate().map(|(n, by)| by * by * wide.of_column[n]))
        .sum();
    let after: f64 = rows.iter().map(|row| seen.predict(row)[1].powi(2)).sum();
    (after / before).sqrt()
}

/// Returns how well each error is known, without the next tests.
#[must_use]
pub(crate) fn assess_errors(
    design: &DesignMatrix,
    found: &Posterior,
    observability: &(Variances, Posterior),
    readings: &[VolumeReading],
) -> Vec<ErrorAssessment> {
    let acting = influential_constant_mask(design, readings);
    let judged = design.constants.distinct_errors().into_iter().map(|error| {
        let open = remaining_std_ratio(design, error, observability);
        let own = design.constants.indices_of_error(error);
        let acts = own.iter().any(|at| acting[*at]);
        let is_known = acts && open <= MAX_REMAINING_STD_RATIO;
        let at: Vec<[f64; 2]> =
            evaluation_rows(design, error).iter().map(|row| found.predict(row)).collect();
        let most = |sign: f64| at.iter().map(|mode| sign * mode[0]).fold(f64::MIN, f64::max);
        let size = if at.len() == 1 { at[0][0] } else { most(1.0) + most(-1.0) };
        let square = at.iter().map(|mode| mode[1] * mode[1]).sum::<f64>() / at.len() as f64;
        let ends =
            error.motion_axis().and_then(|along| design.constants.modes[along.index()].as_ref());
        let curve = ends.map_or_else(Vec::new, |modes| {
            let mm = (0..at.len()).map(|n| grid_position_mm(modes.ends_mm, n));
            mm.zip(&at).map(|(mm, [mean, sd])| [mm, *mean, NORMAL_QUANTILE_975 * sd]).collect()
        });
        let confused_with = match acts && !is_known {
            true => find_confounders(design, error, &observability.1),
            false => Vec::new(),
        };
        ErrorAssessment {
            error,
            acts,
            is_known,
            open,
            size,
            half_width: NORMAL_QUANTILE_975 * square.sqrt(),
            is_there: is_significant(found, &own),
            curve,
            confused_with,
            next_test: String::new(),
        }
    });
    judged.collect()
}

/// Returns whether constants are not all zero, at 95 %: `mᵀ·C⁻¹·m` against χ², so that a function with many places has no more
/// chances than a number.
fn is_significant(found: &Posterior, own: &[usize]) -> bool {
    let count = own.len();
    let mut inner = DMatrix::from_fn(count, count, |i, j| found.covariance[(own[i], own[j])]);
    (0..count).for_each(|n| inner[(n, n)] = inner[(n, n)] * (1.0 + 1e-9) + 1e-12);
    let mean = DVector::from_fn(count, |n, _| found.mean[own[n]]);
    let Some(inner) = inner.cholesky() else { return false };
    // The quantile by Wilson and Hilferty, 1931: within 3 %.
    let share = 2.0 / (9.0 * count as f64);
    let quantile = count as f64 * (1.0 - share + NORMAL_QUANTILE_95 * share.sqrt()).powi(3);
    mean.dot(&inner.solve(&mean)) > quantile
}

/// Returns which constants move the tip where it was read, with those tools or a longer one.
fn influential_constant_mask(design: &DesignMatrix, readings: &[VolumeReading]) -> Vec<bool> {
    let constants = design.constants.clone();
    let mut acting = vec![false; constants.all.len()];
    for reading in readings {
        for longer_mm in [0.0, TOOL_LENGTH_DIFFERENCE_MM] {
            let pose = Pose { tool_mm: reading.pose.tool_mm + longer_mm, ..reading.pose };
            for (acts, um) in acting.iter_mut().zip(constants.tip_sensitivities(&pose)) {
                *acts |= um.iter().any(|um| um.abs() > 1e-9);
            }
        }
    }
    acting
}

/// Returns the names of what would settle an error if it were known, the best first.
fn find_confounders(design: &DesignMatrix, error: GeometricError, seen: &Posterior) -> Vec<String> {
    let mut blocks: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for other in design.constants.distinct_errors().into_iter().filter(|other| *other != error) {
        blocks.insert(other.to_string(), design.constants.indices_of_error(other));
    }
    let constants = design.constants.all.len();
    for (n, nuisance) in design.nuisances.iter().enumerate() {
        blocks.entry(nuisance.name().into()).or_default().push(constants + n);
    }
    let rows = evaluation_rows(design, error);
    let own = design.constants.indices_of_error(error);
    let whole: f64 = rows.iter().map(|row| seen.predict(row)[1].powi(2)).sum();
    let mut found: Vec<(f64, String)> = Vec::new();
    for (name, block) in blocks {
        let size = block.len();
        let mut inner = DMatrix::from_fn(size, size, |i, j| seen.covariance[(block[i], block[j])]);
        (0..size).for_each(|n| inner[(n, n)] = inner[(n, n)] * (1.0 + 1e-9) + 1e-12);
        let Some(inner) = inner.cholesky() else { continue };
        let taken: f64 = rows
            .iter()
            .map(|row| {
                let shared = DVector::from_fn(size, |n, _| {
                    own.iter().map(|at| row[*at] * seen.covariance[(*at, block[n])]).sum()
                });
                shared.dot(&inner.solve(&shared))
            })
            .sum();
        if taken > MIN_CONFOUNDING_FRACTION * whole {
            found.push((taken / whole, name));
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().take(MAX_CONFOUNDERS).map(|(_, name)| name).collect()
}

/// Readings that were held out, RMS in µm without zero and alignment of their set-ups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOutResult {
    /// With the current machine file.
    pub before_um: f64,
    /// With the constants that the other readings give.
    pub after_um: f64,
    /// Readings that were held out; 0: no set-up has enough of them.
    pub readings: usize,
    /// Whether the correction gains on them by more than the standard error of the gain, between places.
    pub is_better: bool,
}

/// Returns what is left of readings that were held out, in five blocks of places.
#[must_use]
pub fn cross_validate(
    design: &DesignMatrix,
    readings: &[VolumeReading],
    is_in: impl Fn(usize) -> bool,
    all: &NormalEquationsByKind,
    variances: &Variances,
) -> HeldOutResult {
    let places: Vec<[i64; 5]> = readings.iter().map(location_key).collect();
    let distinct: BTreeSet<[i64; 5]> = places.iter().copied().collect();
    let mut random = RandomGenerator::new(CROSS_VALIDATION_SEED);
    let blocks: BTreeMap<[i64; 5], usize> = distinct
        .into_iter()
        .map(|at| (at, random.uniform_index(CROSS_VALIDATION_BLOCKS)))
        .collect();
    let without = variances.without_machine_errors(design);
    let (mut squares, mut count) = ([0.0; 2], 0);
    let mut gains: BTreeMap<[i64; 5], f64> = BTreeMap::new();
    for block in 0..CROSS_VALIDATION_BLOCKS {
        let is_of_block = |n: usize| blocks[&places[n]] == block && is_in(n);
        // A set-up of which nothing else is left has no zero.
        let mut left: BTreeMap<usize, usize> = BTreeMap::new();
        for n in (0..readings.len()).filter(|n| is_in(*n) && !is_of_block(*n)) {
            *left.entry(readings[n].setup).or_default() += 1;
        }
        let has_zero = |n: usize| {
            left.get(&readings[n].setup)
                .is_some_and(|remaining| *remaining >= MIN_REMAINING_READINGS)
        };
        let is_out = |n: usize| is_of_block(n) && has_zero(n);
        let out = normal_equations(design, readings, is_out);
        let mut rest = all.clone();
        for (rest, out) in rest.iter_mut().zip(&out) {
            rest.squares -= &out.squares;
            rest.products -= &out.products;
            rest.whole -= out.whole;
            rest.count -= out.count;
        }
        let both = [&without, variances].map(|variances| compute_posterior(&rest, variances));
        for n in (0..readings.len()).filter(|n| is_out(*n)) {
            let [before, after] = both.each_ref().map(|found| {
                let each = design.rows[n].iter().zip(found.mean.iter());
                (readings[n].um - each.map(|(a, b)| a * b).sum::<f64>()).powi(2)
            });
            squares = [squares[0] + before, squares[1] + after];
            *gains.entry(places[n]).or_default() += before - after;
        }
        count += out.iter().map(|entry| entry.count).sum::<usize>();
    }
    let [before_um, after_um] = squares.map(|sum: f64| (sum / count.max(1) as f64).sqrt());
    // Without a gain the sum has this standard deviation.
    let error = gains.values().map(|gain| gain * gain).sum::<f64>().sqrt();
    let is_better = gains.values().sum::<f64>() > error;
    HeldOutResult { before_um, after_um, readings: count, is_better }
}

/// Returns the place of a reading, the same for repeats and components.
fn location_key(reading: &VolumeReading) -> [i64; 5] {
    let setup = reading.setup as i64;
    match reading.on_circle {
        Some(CirclePosition { angle, .. }) => {
            [1, setup, (angle / BLOCK_ARC_RAD).floor() as i64, 0, 0]
        }
        None => {
            let [x, y, z] = reading.pose.position_mm.map(|mm| (mm * 10.0).round() as i64);
            let turned: f64 = reading
                .pose
                .angle_deg
                .iter()
                .enumerate()
                .map(|(n, deg)| deg * (n + 1) as f64)
                .sum();
            [0, x, y, z, (turned * 10.0).round() as i64]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_function_of_many_constants_has_no_more_chances_than_a_number() {
        let found = |mean: &[f64]| Posterior {
            mean: DVector::from_row_slice(mean),
            covariance: DMatrix::identity(mean.len(), mean.len()),
        };
        // χ² at 95 %: 3.84 of one, 18.3 of ten.
        assert!(is_significant(&found(&[2.0]), &[0]) && !is_significant(&found(&[1.9]), &[0]));
        let mut one_of_ten = [0.0; 10];
        one_of_ten[4] = 4.2;
        let all: Vec<usize> = (0..10).collect();
        assert!(!is_significant(&found(&one_of_ten), &all));
        one_of_ten[4] = 4.4;
        assert!(is_significant(&found(&one_of_ten), &all));
    }
}
