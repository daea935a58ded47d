//! The figures of ISO 230-4, of the readings as they are: nothing is modelled, and only gross readings are excluded.
//!
//! | figure | is |
//! |---|---|
//! | G of a direction | circular deviation: range of the radii about the centre of least squares |
//! | G(b) | bi-directional: the same of both directions about their common centre |
//! | H | circular hysteresis: largest difference of the radii of both directions at an angle |
//! | F max, F min of a direction | radial deviation: largest and smallest deviation from the nominal radius; about the centre of least squares for a whole circle, else about that of the set-up |
//! | D | mean bi-directional radial deviation: radius of least squares of both directions minus the nominal one |
//!
//! The standard allows the centre of least squares in the place of that of the smallest zone. G and G(b) are of whole
//! circles.

use std::f64::consts::TAU;

use trueup_numerics::least_squares::normal_equations::solve;

use super::{record::CircleRecord, term_selection::setup_columns, terms::CircleTerm};

/// Angles at which both directions are compared.
const ANGLE_BIN_COUNT: usize = 360;

/// The figures of one circle, in µm; counter-clockwise first, `None` where a direction or a part of the circle is missing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CircularDeviations {
    /// Circular deviation of each direction.
    pub g_um: [Option<f64>; 2],
    /// Bi-directional circular deviation.
    pub g_both_um: Option<f64>,
    /// Circular hysteresis.
    pub h_um: Option<f64>,
    /// Largest radial deviation of each direction.
    pub f_max_um: [Option<f64>; 2],
    /// Smallest radial deviation of each direction.
    pub f_min_um: [Option<f64>; 2],
    /// Mean bi-directional radial deviation.
    pub d_um: Option<f64>,
}

impl CircularDeviations {
    /// Returns the figures of a record.
    #[must_use]
    pub(crate) fn from_record(record: &CircleRecord) -> Self {
        let is_whole = record.covered_arc_rad() >= 350.0 / 360.0 * TAU;
        let senses = [1.0, -1.0].map(|sense| record.without_rows(|row| row.sense * sense < 0.0));
        let both = senses.iter().all(|sense| !sense.rows.is_empty());
        let mut it = Self::default();
        for (index, of_sense) in senses.iter().enumerate() {
            if of_sense.rows.is_empty() {
                continue;
            }
            let (about_centre, radius_um) = deviations_about_centre(of_sense);
            let about = if is_whole { about_centre } else { measured_deviations_um(of_sense) };
            let [low, high] = min_max(&about);
            it.g_um[index] = is_whole.then_some(high - low);
            (it.f_max_um[index], it.f_min_um[index]) = (Some(high), Some(low));
            if both {
                it.d_um = Some(it.d_um.unwrap_or_default() + 0.5 * radius_um);
            }
        }
        if both {
            let (about_centre, _) = deviations_about_centre(record);
            let [low, high] = min_max(&about_centre);
            it.g_both_um = is_whole.then_some(high - low);
            it.h_um = circular_hysteresis_um(record, &about_centre);
        }
        it
    }
}

fn measured_deviations_um(record: &CircleRecord) -> Vec<f64> {
    record.rows.iter().map(|row| row.measured_um).collect()
}

/// Returns the deviations about the centre of least squares, and the mean radius minus the nominal one.
fn deviations_about_centre(record: &CircleRecord) -> (Vec<f64>, f64) {
    let terms: Vec<CircleTerm> = setup_columns(record).iter().map(|column| column.term).collect();
    let columns: Vec<Vec<f64>> = terms.iter().map(|term| term.basis_column(record)).collect();
    let mut um = measured_deviations_um(record);
    let solution = solve(&columns, &um, None, 0.0);
    let mut radii = Vec::new();
    for ((term, column), size) in terms.iter().zip(&columns).zip(&solution.coefficients) {
        if matches!(term, CircleTerm::Radius(_)) {
            radii.push(*size);
        } else {
            um.iter_mut().zip(column).for_each(|(um, x)| *um -= size * x);
        }
    }
    (um, radii.iter().sum::<f64>() / radii.len().max(1) as f64)
}

fn min_max(um: &[f64]) -> [f64; 2] {
    let of = um.iter().copied();
    [of.clone().fold(f64::INFINITY, f64::min), of.fold(f64::NEG_INFINITY, f64::max)]
}

/// Returns the largest difference of the mean radii of both directions at an angle.
fn circular_hysteresis_um(record: &CircleRecord, um: &[f64]) -> Option<f64> {
    let mut sums = [vec![[0.0, 0.0]; ANGLE_BIN_COUNT], vec![[0.0, 0.0]; ANGLE_BIN_COUNT]];
    for (row, um) in record.rows.iter().zip(um) {
        let at =
            (row.angle.rem_euclid(TAU) / TAU * ANGLE_BIN_COUNT as f64) as usize % ANGLE_BIN_COUNT;
        let sum = &mut sums[usize::from(row.sense < 0.0)][at];
        *sum = [sum[0] + um, sum[1] + 1.0];
    }
    let [forward, back] = &sums;
    let differences = forward.iter().zip(back).filter(|(a, b)| a[1] > 0.0 && b[1] > 0.0);
    differences.map(|(a, b)| (a[0] / a[1] - b[0] / b[1]).abs()).reduce(f64::max)
}
