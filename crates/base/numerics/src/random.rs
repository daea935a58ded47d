//! Random numbers that repeat: the same for a seed, on every machine (ChaCha with 8 rounds).

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// A sequence of random numbers.
///
/// ```
/// use trueup_numerics::random::RandomGenerator;
/// let mut dice = RandomGenerator::new(1);
/// let mut again = RandomGenerator::new(1);
/// assert!((0..100).all(|_| { let n = dice.uniform_index(6); n < 6 && n == again.uniform_index(6) }));
/// ```
#[derive(Clone, Debug)]
pub struct RandomGenerator(ChaCha8Rng);

impl RandomGenerator {
    /// Returns the sequence of this seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Returns a whole number from 0 to below `end`, each as likely as any other.
    ///
    /// # Panics
    /// `end` is 0.
    pub fn uniform_index(&mut self, end: usize) -> usize {
        self.0.random_range(0..end)
    }

    /// From 0 to below 1.
    pub fn uniform(&mut self) -> f64 {
        self.0.random()
    }

    /// Normal, mean 0, standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }
}
