//! A factor by two-stage least squares under noise with a memory.
//!
//! ```text
//! measured = X·b + factor·offset + noise          X: what the error may be made of
//! z        = the offset by the instruments Z, less what X says of it
//! factor   = zᵀ·measured / zᵀ·offset              all made white by the noise that is left
//! ```
//!
//! Without an instrument the noise of a thermometer would decide: X has it and the offset has it not, so that the
//! difference of the two would look like a bridge that is switched on and off.

use trueup_numerics::{
    noise::{self, NoiseModel, RowSpacings, Whitener},
    t_quantile,
};

use super::factor_estimate::FactorEstimate;

/// The least F of the first stage. Below it an instrument is weak (Staiger & Stock 1997).
const MIN_FIRST_STAGE_F: f64 = 10.0;
/// The share that the scale of a gauge and the form of a model add to the interval (95 %): linear gauges keep 1 %, and
/// of a lag that the model lacks 3 % were seen.
const RELATIVE_SYSTEMATIC_UNCERTAINTY_95: f64 = 0.03;
/// A column that lies in the others but for this share of its size is one of them.
const COLLINEARITY_TOLERANCE: f64 = 1e-6;

/// Returns the steps between rows at `at`, in the median of them.
pub(super) fn compute_row_spacings(at: &[f64], starts: &[bool]) -> RowSpacings {
    let apart = |row: usize| at[row] - at[row - 1];
    let mut all: Vec<f64> =
        (1..at.len()).filter(|row| !starts[*row]).map(apart).filter(|step| *step > 0.0).collect();
    all.sort_by(f64::total_cmp);
    let median = all.get(all.len() / 2).copied().unwrap_or(1.0);
    let step = |row: usize| match starts[row] || apart(row) < 0.0 {
        true => f64::INFINITY,
        false => apart(row) / median,
    };
    RowSpacings((0..at.len()).map(step).collect())
}

/// The inputs of the estimate: measured = Σ explained + factor·offset + noise.
pub(super) struct TwoStageLeastSquares<'e> {
    pub measured_um: &'e [f64],
    pub offset_um: &'e [f64],
    pub explained: &'e [Vec<f64>],
    pub instruments: &'e [Vec<f64>],
    pub steps: &'e RowSpacings,
}

impl TwoStageLeastSquares<'_> {
    /// Returns the factor with its interval; none where the instruments are weak.
    pub(crate) fn estimate_factor(&self) -> Option<FactorEstimate> {
        let (_, residual, used) = self.fit_with_noise(NoiseModel::WHITE)?;
        let longest = noise::max_autocorrelation_time(residual.len());
        self.fit_with_noise(noise::estimate(&residual, self.steps, longest, used))
            .map(|(factor, ..)| factor)
    }

    /// Returns the factor under this noise, what is left, and how many constants were fitted.
    fn fit_with_noise(&self, noise: NoiseModel) -> Option<(FactorEstimate, Vec<f64>, usize)> {
        let whitener = Whitener::new(noise, self.steps);
        let mut explained = OrthonormalBasis::default();
        for column in self.explained {
            explained.add_column(whitener.whiten(column));
        }
        let used = explained.0.len() + 1;
        let free = self.measured_um.len().checked_sub(used).filter(|free| *free > 0)? as f64;
        let offset = explained.orthogonal_residual(whitener.whiten(self.offset_um));
        let measured = explained.orthogonal_residual(whitener.whiten(self.measured_um));
        let mut instruments = OrthonormalBasis::default();
        for column in self.instruments {
            let whole = whitener.whiten(column);
            let size = norm(&whole);
            let rest = explained.orthogonal_residual(whole);
            if norm(&rest) > COLLINEARITY_TOLERANCE * size {
                instruments.add_column(rest);
            }
        }
        let apart = instruments.orthogonal_residual(offset.clone());
        let seen: Vec<f64> = offset.iter().zip(&apart).map(|(all, rest)| all - rest).collect();
        let squares = dot(&seen, &seen);
        // What the instruments do not say of the offset would have chance to say as much.
        let count = instruments.0.len() as f64;
        let by_chance = dot(&apart, &apart) / free;
        if count == 0.0 || squares <= MIN_FIRST_STAGE_F * count * by_chance || squares == 0.0 {
            return None;
        }
        let value = dot(&seen, &measured) / squares;
        let left = measured.iter().zip(&offset).map(|(um, offset)| um - value * offset);
        let left: Vec<f64> = left.collect();
        let by_noise = t_quantile(0.975, free) * (dot(&left, &left) / free / squares).sqrt();
        let half = by_noise.hypot(RELATIVE_SYSTEMATIC_UNCERTAINTY_95 * value.abs().max(1.0));
        let factor = FactorEstimate { value, ci95: [value - half, value + half] };
        half.is_finite().then_some((factor, left, used))
    }
}

/// Columns at right angles, each of length 1.
#[derive(Default)]
struct OrthonormalBasis(Vec<Vec<f64>>);

impl OrthonormalBasis {
    fn add_column(&mut self, column: Vec<f64>) {
        let size = norm(&column);
        let mut rest = self.orthogonal_residual(column);
        let left = norm(&rest);
        if left > COLLINEARITY_TOLERANCE * size {
            rest.iter_mut().for_each(|value| *value /= left);
            self.0.push(rest);
        }
    }

    /// Returns what is left of a column without these; twice, which is enough for any (Kahan).
    fn orthogonal_residual(&self, mut column: Vec<f64>) -> Vec<f64> {
        for _ in 0..2 {
            for of in &self.0 {
                let share = dot(of, &column);
                column.iter_mut().zip(of).for_each(|(value, of)| *value -= share * of);
            }
        }
        column
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}
