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
    noise::{self, Noise, Steps, Whitener},
    t_quantile,
};

use super::interval::Factor;

/// The least F of the first stage. Below it an instrument is weak (Staiger & Stock 1997).
const STRONG: f64 = 10.0;
/// The share that the scale of a gauge and the form of a model add to the interval (95 %): linear gauges keep 1 %, and
/// of a lag that the model lacks 3 % were seen.
const SYSTEMATIC: f64 = 0.03;
/// A column that lies in the others but for this share of its size is one of them.
const DEPENDENT: f64 = 1e-6;

/// Returns the steps between rows at `at`, in the median of them.
pub(super) fn steps(at: &[f64], starts: &[bool]) -> Steps {
    let apart = |row: usize| at[row] - at[row - 1];
    let mut all: Vec<f64> =
        (1..at.len()).filter(|row| !starts[*row]).map(apart).filter(|step| *step > 0.0).collect();
    all.sort_by(f64::total_cmp);
    let median = all.get(all.len() / 2).copied().unwrap_or(1.0);
    let step = |row: usize| match starts[row] || apart(row) < 0.0 {
        true => f64::INFINITY,
        false => apart(row) / median,
    };
    Steps((0..at.len()).map(step).collect())
}

/// The inputs of the estimate: measured = Σ explained + factor·offset + noise.
pub(super) struct Estimate<'e> {
    pub measured_um: &'e [f64],
    pub offset_um: &'e [f64],
    pub explained: &'e [Vec<f64>],
    pub instruments: &'e [Vec<f64>],
    pub steps: &'e Steps,
}

impl Estimate<'_> {
    /// Returns the factor with its interval; none where the instruments are weak.
    pub fn factor(&self) -> Option<Factor> {
        let (_, residual, used) = self.under(Noise::WHITE)?;
        let longest = noise::longest_memory(residual.len());
        self.under(noise::estimate(&residual, self.steps, longest, used)).map(|(factor, ..)| factor)
    }

    /// Returns the factor under this noise, what is left, and how many constants were fitted.
    fn under(&self, noise: Noise) -> Option<(Factor, Vec<f64>, usize)> {
        let whitener = Whitener::new(noise, self.steps);
        let mut explained = Basis::default();
        for column in self.explained {
            explained.add(whitener.apply(column));
        }
        let used = explained.0.len() + 1;
        let free = self.measured_um.len().checked_sub(used).filter(|free| *free > 0)? as f64;
        let offset = explained.rest(whitener.apply(self.offset_um));
        let measured = explained.rest(whitener.apply(self.measured_um));
        let mut instruments = Basis::default();
        for column in self.instruments {
            let whole = whitener.apply(column);
            let size = norm(&whole);
            let rest = explained.rest(whole);
            if norm(&rest) > DEPENDENT * size {
                instruments.add(rest);
            }
        }
        let apart = instruments.rest(offset.clone());
        let seen: Vec<f64> = offset.iter().zip(&apart).map(|(all, rest)| all - rest).collect();
        let squares = dot(&seen, &seen);
        // What the instruments do not say of the offset would have chance to say as much.
        let count = instruments.0.len() as f64;
        let by_chance = dot(&apart, &apart) / free;
        if count == 0.0 || squares <= STRONG * count * by_chance || squares == 0.0 {
            return None;
        }
        let value = dot(&seen, &measured) / squares;
        let left = measured.iter().zip(&offset).map(|(um, offset)| um - value * offset);
        let left: Vec<f64> = left.collect();
        let by_noise = t_quantile(0.975, free) * (dot(&left, &left) / free / squares).sqrt();
        let half = by_noise.hypot(SYSTEMATIC * value.abs().max(1.0));
        let factor = Factor { value, ci95: [value - half, value + half] };
        half.is_finite().then_some((factor, left, used))
    }
}

/// Columns at right angles, each of length 1.
#[derive(Default)]
struct Basis(Vec<Vec<f64>>);

impl Basis {
    fn add(&mut self, column: Vec<f64>) {
        let size = norm(&column);
        let mut rest = self.rest(column);
        let left = norm(&rest);
        if left > DEPENDENT * size {
            rest.iter_mut().for_each(|value| *value /= left);
            self.0.push(rest);
        }
    }

    /// Returns what is left of a column without these; twice, which is enough for any (Kahan).
    fn rest(&self, mut column: Vec<f64>) -> Vec<f64> {
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
