//! Chance that repeats: streams of random numbers by seed and purpose, and noise with a memory.
//!
//! Every purpose ("front thermometer", "speeds") has a stream of its own, so that switching one
//! effect on or off leaves the chance of all others as it was, and two runs with one seed are equal
//! to the byte. The generator is ChaCha with 8 rounds: its numbers are the same on every machine.
//!
//! Correlated noise is the first-order autoregression
//!
//! ```text
//! z ← ρ·z + √(1 − ρ²)·w        w normal, standard deviation σ
//! ```
//!
//! whose standard deviation is σ at every ρ from 0 (white) to below 1.

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// A stream of random numbers for one purpose.
#[derive(Clone, Debug)]
pub struct RandomStream(ChaCha8Rng);

impl RandomStream {
    /// Returns the stream of `purpose` under `seed`.
    #[must_use]
    pub fn new(seed: u64, purpose: &str) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        generator.set_stream(fnv_1a(purpose));
        Self(generator)
    }

    /// From `low` to below `high`; `low` where the two are equal.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// Between two sizes above 0, every factor as likely as any other.
    pub fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        self.uniform(low.ln(), high.ln()).exp()
    }

    /// Normal, mean 0, standard deviation 1.
    pub fn standard_normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }

    /// Returns true with `probability`.
    pub fn bernoulli(&mut self, probability: f64) -> bool {
        self.0.random::<f64>() < probability
    }

    /// +1 or −1.
    pub fn random_sign(&mut self) -> f64 {
        if self.bernoulli(0.5) { 1.0 } else { -1.0 }
    }

    /// Returns a whole number from `low` to `high`, both possible.
    pub fn uniform_integer(&mut self, low: usize, high: usize) -> usize {
        self.0.random_range(low..=high.max(low))
    }

    /// Returns one of `choices`, which must not be empty.
    pub fn choose<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.uniform_integer(0, choices.len() - 1)]
    }
}

/// 64 bits of a name (FNV-1a): a stream's number must not depend on the compiler, as the standard
/// library's hash may.
fn fnv_1a(name: &str) -> u64 {
    name.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

/// Noise with a memory.
#[derive(Clone, Debug)]
pub struct CorrelatedNoise {
    stream: RandomStream,
    sigma: f64,
    rho: f64,
    value: Option<f64>,
}

impl CorrelatedNoise {
    /// Of standard deviation `sigma` and correlation `rho` from one value to the next, in 0…1.
    #[must_use]
    pub fn new(stream: RandomStream, sigma: f64, rho: f64) -> Self {
        Self { stream, sigma, rho: rho.clamp(0.0, 0.999_999), value: None }
    }

    /// Returns the next value.
    pub fn draw(&mut self) -> f64 {
        self.draw_correlated(self.rho)
    }

    /// Returns the next value, where it is correlated by `rho` with the one before: over a step Δt of noise
    /// with the time constant τ that is e^(−Δt/τ).
    pub fn draw_correlated(&mut self, rho: f64) -> f64 {
        let fresh = self.sigma * self.stream.standard_normal();
        let value = match self.value {
            // It starts as if it had always run.
            None => fresh,
            Some(before) => rho * before + (1.0 - rho * rho).sqrt() * fresh,
        };
        self.value = Some(value);
        value
    }
}

/// Returns the root mean square; 0 of nothing.
#[must_use]
pub fn rms(values: &[f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_and_a_purpose_repeat_and_another_of_either_differs() {
        let first = |seed, purpose| RandomStream::new(seed, purpose).standard_normal();
        assert_eq!(first(1, "a"), first(1, "a"));
        assert_ne!(first(1, "a"), first(2, "a"));
        assert_ne!(first(1, "a"), first(1, "b"));
    }

    #[test]
    fn correlated_noise_has_its_size_and_its_memory() {
        for (seed, rho) in [(1, 0.0), (2, 0.5), (3, 0.97)] {
            let mut noise = CorrelatedNoise::new(RandomStream::new(seed, "noise"), 0.4, rho);
            let values: Vec<f64> = (0..200_000).map(|_| noise.draw()).collect();
            let size = rms(&values);
            let product: f64 = values.windows(2).map(|pair| pair[0] * pair[1]).sum();
            let memory = product / (values.len() as f64 * size * size);
            println!("rho {rho}: size {size:.4} of 0.4, correlation {memory:.4}");
            // The sample of a strongly correlated series has few independent values.
            assert!((size / 0.4 - 1.0).abs() < 0.06 && (memory - rho).abs() < 0.01);
        }
    }

    #[test]
    fn draws_stay_in_their_range() {
        let mut stream = RandomStream::new(7, "range");
        for _ in 0..10_000 {
            assert!((2.0..3.0).contains(&stream.uniform(2.0, 3.0)));
            assert!((1e-3..1e3).contains(&stream.log_uniform(1e-3, 1e3)));
            assert!((4..=6).contains(&stream.uniform_integer(4, 6)));
        }
    }
}
