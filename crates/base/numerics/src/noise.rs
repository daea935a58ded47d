//! Noise with a memory, and what it does to a fit.
//!
//! The noise of a series is the sum of a white part (share w of the variance) and a first-order
//! Gauss–Markov part whose correlation dies out as e^(−Δt/t_c):
//!
//! ```text
//! s ← φ·s + √(1 − φ²)·√(1 − w)·ε      φ = e^(−Δt/t_c)
//! e = s + √w·ε'
//! ```
//!
//! Rows at any spacing and gaps are exact. The inverse root of its covariance is applied by the
//! Kalman filter of this model (Harvey 1989, section 3.4), O(n) a vector. With w = 0 and equal steps
//! it is the usual prewhitening by an AR(1).
//!
//! t_c is at most [`max_autocorrelation_time`]: a longer one cannot be distinguished from structure in a record of that
//! length, and would let the noise explain everything.

use crate::random::RandomGenerator;

/// t_c in steps and the white share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseModel {
    /// Correlation time in median steps; 0: white.
    pub memory: f64,
    /// Share of the variance that is white, 0…1.
    pub white: f64,
}

impl NoiseModel {
    /// Noise without a memory: rows are independent.
    pub const WHITE: Self = Self { memory: 0.0, white: 1.0 };

    fn decay_factor(&self, steps: f64) -> f64 {
        if self.memory <= 0.0 { 0.0 } else { (-steps / self.memory).exp() }
    }

    /// Correlation between rows `steps` apart, above 0.
    #[cfg(test)]
    fn correlation(&self, steps: f64) -> f64 {
        (1.0 - self.white) * self.decay_factor(steps)
    }
}

/// The longest memory in roots of the rows.
const MAX_MEMORY_PER_SQRT_ROWS: f64 = 2.0;
/// Memories in a record, at least.
const MIN_CORRELATION_TIMES_PER_RECORD: f64 = 6.0;

/// Returns the longest correlation time in steps that `rows` rows can show: 2·√n, as the bandwidth of
/// consistent covariance estimates grows, and never more than a sixth of the record.
pub fn max_autocorrelation_time(rows: usize) -> f64 {
    let rows = rows as f64;
    (MAX_MEMORY_PER_SQRT_ROWS * rows.sqrt()).min(rows / MIN_CORRELATION_TIMES_PER_RECORD).max(1.0)
}

/// The steps between rows: each row's distance from the one before in median steps, at least 0;
/// infinite where a new series begins.
#[derive(Clone, Debug)]
pub struct RowSpacings(pub Vec<f64>);

/// Variances whose product is far from the ends of what a number holds: their logarithms are taken at
/// once.
const LOG_BATCH_ROWS: usize = 8;

/// The inverse root of a noise's covariance, for given rows.
pub struct Whitener {
    decay: Vec<f64>,
    gain: Vec<f64>,
    scale: Vec<f64>,
    /// Nothing is changed.
    is_white: bool,
    /// ln det of the covariance at variance 1.
    pub log_det: f64,
}

impl Whitener {
    /// For `noise` in rows that are `steps` apart.
    #[must_use]
    pub fn new(noise: NoiseModel, steps: &RowSpacings) -> Self {
        let rows = steps.0.len();
        let mut it = Self {
            decay: Vec::with_capacity(rows),
            gain: Vec::with_capacity(rows),
            scale: Vec::with_capacity(rows),
            is_white: noise == NoiseModel::WHITE,
            log_det: 0.0,
        };
        let stationary = 1.0 - noise.white;
        let mut variance = stationary;
        let (mut last_steps, mut last_decay) = (f64::NAN, 0.0);
        let mut product = 1.0;
        for (row, &steps) in steps.0.iter().enumerate() {
            let decay = if steps.is_infinite() {
                0.0
            } else {
                if steps != last_steps {
                    (last_steps, last_decay) = (steps, noise.decay_factor(steps));
                }
                last_decay
            };
            variance = decay * decay * variance + (1.0 - decay * decay) * stationary;
            let innovation = variance + noise.white;
            let gain = variance / innovation;
            variance *= 1.0 - gain;
            it.decay.push(decay);
            it.gain.push(gain);
            it.scale.push(innovation.sqrt().recip());
            product *= innovation;
            if row % LOG_BATCH_ROWS == LOG_BATCH_ROWS - 1 {
                it.log_det += std::mem::replace(&mut product, 1.0_f64).ln();
            }
        }
        it.log_det += product.ln();
        it
    }

    /// Values with this noise in them, made independent with variance 1: as many as there are rows.
    #[must_use]
    pub fn whiten(&self, values: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.decay.len()];
        self.whiten_lanes([values], [&mut out]);
        out
    }
}

impl Whitener {
    /// [`apply`](Self::whiten) to each of `columns`.
    pub fn whiten_columns<'c>(
        &self,
        columns: impl IntoIterator<Item = &'c Vec<f64>>,
    ) -> Vec<Vec<f64>> {
        let columns: Vec<&Vec<f64>> = columns.into_iter().collect();
        let rows = self.decay.len();
        let mut all = vec![0.0; rows * columns.len()];
        self.whiten_columns_into(&columns, &mut all);
        all.chunks_exact(rows.max(1)).map(<[f64]>::to_vec).collect()
    }

    /// [`apply`](Self::whiten) to each of `columns`, one after the other into `out`, which has as many numbers
    /// as all of them.
    pub fn whiten_columns_into(&self, columns: &[&Vec<f64>], out: &mut [f64]) {
        /// Columns side by side: one alone waits for each step.
        const SIMD_LANES: usize = 4;
        let rows = self.decay.len();
        if rows == 0 {
            return;
        }
        for (columns, out) in columns.chunks(SIMD_LANES).zip(out.chunks_mut(SIMD_LANES * rows)) {
            let mut written = out.chunks_exact_mut(rows);
            if self.is_white {
                written.zip(columns).for_each(|(out, column)| out.copy_from_slice(&column[..rows]));
                continue;
            }
            let &[a, b, c, d] = columns else {
                for (out, column) in written.zip(columns) {
                    self.whiten_lanes([&column[..rows]], [out]);
                }
                continue;
            };
            let read = [a, b, c, d].map(|column| &column[..rows]);
            let written = [(); SIMD_LANES].map(|()| written.next().unwrap_or_default());
            self.whiten_lanes(read, written);
        }
    }

    /// The filter, on columns and into slices of as many rows as there are.
    fn whiten_lanes<const LANES: usize>(
        &self,
        read: [&[f64]; LANES],
        mut written: [&mut [f64]; LANES],
    ) {
        let rows = self.decay.len();
        let read = read.map(|read| &read[..rows]);
        let written = written.each_mut().map(|out| &mut out[..rows]);
        let mut state = [0.0; LANES];
        let filter = self.decay.iter().zip(&self.gain).zip(&self.scale);
        for (row, ((decay, gain), scale)) in filter.enumerate() {
            for lane in 0..LANES {
                let before = state[lane] * decay;
                let innovation = read[lane][row] - before;
                written[lane][row] = innovation * scale;
                state[lane] = before + gain * innovation;
            }
        }
    }
}

/// Covariance (at variance 1) times a vector: two recursions, O(n).
pub fn multiply_by_covariance(noise: NoiseModel, steps: &RowSpacings, values: &[f64]) -> Vec<f64> {
    let share = 1.0 - noise.white;
    let mut out: Vec<f64> = values.to_vec();
    if share == 0.0 {
        return out;
    }
    let rows = values.len();
    let decay: Vec<f64> = steps
        .0
        .iter()
        .map(|&steps| if steps.is_infinite() { 0.0 } else { noise.decay_factor(steps) })
        .collect();
    let mut sum = 0.0;
    for row in 1..rows {
        sum = decay[row] * (sum + values[row - 1]);
        out[row] += share * sum;
    }
    sum = 0.0;
    for row in (0..rows.saturating_sub(1)).rev() {
        sum = decay[row + 1] * (sum + values[row + 1]);
        out[row] += share * sum;
    }
    out
}

/// Returns how many independent rows are worth as much for a mean as these correlated ones.
pub fn effective_sample_size(noise: NoiseModel, steps: &RowSpacings) -> f64 {
    let rows = steps.0.len();
    let ones = vec![1.0; rows];
    let sum: f64 = multiply_by_covariance(noise, steps, &ones).iter().sum();
    let rows = rows as f64;
    (rows * rows / sum).clamp(1.0, rows)
}

/// −2 ln of the likelihood of these noises at the best variance, but for a constant: the filter of
/// [`Whitener`] for several noises side by side, and of what it gives only the sums.
pub(crate) fn deviances<const NOISES: usize>(
    noises: [NoiseModel; NOISES],
    steps: &RowSpacings,
    residual: &[f64],
) -> [f64; NOISES] {
    let slow = noises.map(|noise| 1.0 - noise.white);
    let [mut state, mut sum, mut log_det] = [[0.0; NOISES]; 3];
    let mut variance = slow;
    let mut decay = [0.0; NOISES];
    let mut last_steps = f64::NAN;
    for (steps, residual) in steps.0.chunks(LOG_BATCH_ROWS).zip(residual.chunks(LOG_BATCH_ROWS)) {
        let mut product = [1.0; NOISES];
        for (&steps, value) in steps.iter().zip(residual) {
            if steps != last_steps {
                last_steps = steps;
                decay = noises
                    .map(|noise| if steps.is_infinite() { 0.0 } else { noise.decay_factor(steps) });
            }
            for n in 0..NOISES {
                let squared = decay[n] * decay[n];
                let before = squared * variance[n] + (1.0 - squared) * slow[n];
                let innovation = before + noises[n].white;
                let inverse = 1.0 / innovation;
                let gain = before * inverse;
                variance[n] = before * (1.0 - gain);
                let at = state[n] * decay[n];
                let apart = value - at;
                sum[n] += apart * apart * inverse;
                state[n] = at + gain * apart;
                product[n] *= innovation;
            }
        }
        log_det.iter_mut().zip(product).for_each(|(sum, product)| *sum += product.ln());
    }
    let rows = residual.len() as f64;
    std::array::from_fn(|n| rows * (sum[n] / rows).max(f64::MIN_POSITIVE).ln() + log_det[n])
}

/// Returns the same of one noise.
pub fn deviance(noise: NoiseModel, steps: &RowSpacings, residual: &[f64]) -> f64 {
    let [deviance] = deviances([noise], steps, residual);
    deviance
}

/// Returns a grid of noises up to `longest` steps of memory; the first is white.
pub fn noise_grid(longest: f64) -> Vec<NoiseModel> {
    let mut noises = vec![NoiseModel::WHITE];
    let mut memory = longest;
    while memory > 0.4 && noises.len() < 13 {
        for white in [0.0, 0.6] {
            noises.push(NoiseModel { memory, white });
        }
        memory /= 3.5;
    }
    noises
}

/// Returns the most likely noise of a residual, its memory at most `longest`.
///
/// `parameters` have been fitted to the residual: each takes a piece of the slow part away, which a
/// plain maximum of the likelihood would read as a shorter memory. The memory is corrected for it
/// by its first-order bias, (1 + 3ρ)/n and ρ/n for each parameter more (Kendall 1954).
pub fn estimate(
    residual: &[f64],
    steps: &RowSpacings,
    longest: f64,
    parameters: usize,
) -> NoiseModel {
    if residual.len() < 8 || residual.iter().all(|&e| e == 0.0) {
        return NoiseModel::WHITE;
    }
    let mut best = (deviance(NoiseModel::WHITE, steps, residual), NoiseModel::WHITE);
    // A memory is only believed if it is worth its parameters.
    let price = (residual.len() as f64).ln();
    let try_all = |best: &mut (f64, NoiseModel), noises: [NoiseModel; 4]| {
        for (there, noise) in deviances(noises, steps, residual).into_iter().zip(noises) {
            if there + price < best.0 {
                *best = (there + price, noise);
            }
        }
    };
    for noises in noise_grid(longest)[1..].chunks(4) {
        // The last ones are fewer: one of them is tried again.
        try_all(&mut best, std::array::from_fn(|n| noises[n.min(noises.len() - 1)]));
    }
    if best.1 == NoiseModel::WHITE {
        return NoiseModel::WHITE;
    }
    for factor in [1.5, 1.25, 1.1, 1.05] {
        for _ in 0..6 {
            let NoiseModel { memory, white } = best.1;
            let around = [
                NoiseModel { memory: (memory * factor).min(longest), white },
                NoiseModel { memory: memory / factor, white },
                NoiseModel { memory, white: (white + 0.2 * (factor - 1.0)).min(0.98) },
                NoiseModel { memory, white: (white - 0.2 * (factor - 1.0)).max(0.0) },
            ];
            let before = best.0;
            try_all(&mut best, around);
            if best.0 >= before {
                break;
            }
        }
    }
    let rho = (-1.0 / best.1.memory).exp();
    let rows = residual.len() as f64;
    let bias = (1.0 + 3.0 * rho + parameters as f64 * rho) / rows;
    let corrected = (rho + bias).min(0.9999);
    let memory = (-1.0 / corrected.ln()).min(longest).max(best.1.memory);
    NoiseModel { memory, ..best.1 }
}

/// Returns a draw of the noise at variance 1.
pub fn draw_noise(
    noise: NoiseModel,
    steps: &RowSpacings,
    generator: &mut RandomGenerator,
) -> Vec<f64> {
    let slow = (1.0 - noise.white).sqrt();
    let quick = noise.white.sqrt();
    let mut state = 0.0;
    steps
        .0
        .iter()
        .map(|&steps| {
            let decay = if steps.is_infinite() { 0.0 } else { noise.decay_factor(steps) };
            let [a, b] = [generator.normal(), generator.normal()];
            state = decay * state + (1.0 - decay * decay).sqrt() * a;
            slow * state + quick * b
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_likelihood_side_by_side_is_that_of_the_whitened_values() {
        let mut steps = steps(500);
        steps.0[100] = 1.7;
        steps.0[300] = f64::INFINITY;
        let drawn = draw_noise(
            NoiseModel { memory: 9.0, white: 0.3 },
            &steps,
            &mut RandomGenerator::new(3),
        );
        let noises = [(0.0, 1.0), (3.0, 0.0), (9.0, 0.3), (80.0, 0.98)];
        let noises = noises.map(|(memory, white)| NoiseModel { memory, white });
        for (noise, found) in noises.into_iter().zip(deviances(noises, &steps, &drawn)) {
            let whitener = Whitener::new(noise, &steps);
            let sum: f64 = whitener.whiten(&drawn).iter().map(|e| e * e).sum();
            let plain = 500.0 * (sum / 500.0).ln() + whitener.log_det;
            assert!((found - plain).abs() < 1e-9 * plain.abs(), "{found} {plain}");
        }
    }

    fn steps(rows: usize) -> RowSpacings {
        let mut steps = vec![1.0; rows];
        steps[0] = f64::INFINITY;
        RowSpacings(steps)
    }

    #[test]
    fn whitened_noise_has_variance_one_and_no_memory() {
        let noise = NoiseModel { memory: 30.0, white: 0.2 };
        let steps = steps(20_000);
        let drawn = draw_noise(noise, &steps, &mut RandomGenerator::new(1));
        let white = Whitener::new(noise, &steps).whiten(&drawn);
        let mean_square = white.iter().map(|e| e * e).sum::<f64>() / white.len() as f64;
        let next: f64 = white.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>();
        let next = next / white.len() as f64;
        println!("variance {mean_square:.4}, correlation of neighbours {next:.4}");
        assert!((mean_square - 1.0).abs() < 0.04 && next.abs() < 0.03);
    }

    #[test]
    fn the_covariance_is_that_of_the_formula() {
        let noise = NoiseModel { memory: 5.0, white: 0.3 };
        let mut steps = steps(40);
        steps.0[20] = f64::INFINITY;
        steps.0[7] = 3.5;
        let mut unit = vec![0.0; 40];
        unit[5] = 1.0;
        let column = multiply_by_covariance(noise, &steps, &unit);
        assert!((column[5] - 1.0).abs() < 1e-12);
        assert!((column[7] - noise.correlation(4.5)).abs() < 1e-12);
        assert_eq!(column[20], 0.0);
    }

    #[test]
    fn the_memory_is_found_again() {
        for (memory, white) in [(0.0, 1.0), (5.0, 0.0), (33.0, 0.0), (20.0, 0.5)] {
            let noise = NoiseModel { memory, white };
            let steps = steps(3000);
            let drawn = draw_noise(noise, &steps, &mut RandomGenerator::new(7));
            let found = estimate(&drawn, &steps, max_autocorrelation_time(3000), 0);
            println!("{noise:?} found as {found:?}");
            let (there, here) =
                (effective_sample_size(noise, &steps), effective_sample_size(found, &steps));
            assert!((there / here).ln().abs() < 0.5, "{there} {here}");
        }
    }
}
