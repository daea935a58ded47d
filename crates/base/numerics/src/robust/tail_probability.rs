//! How likely noise alone is to have readings as far away as some are.
//!
//! The noise's own tail says so: of the readings that are not in question the k farthest, whose mean excess
//! b over the next one u is the scale of an exponential tail. That is heavier than a normal one, whose
//! excess shrinks with distance. A scale known from k values only makes the chance of a reading at x
//!
//! ```text
//! P(> x | beyond u) = (1 + (x − u)/(k·b))^−k
//! ```
//!
//! (the predictive distribution of an exponential one, an F distribution of 2 and 2k degrees). Beyond x the
//! whole record is to have λ = k·P readings; that there are j of them has the chance Poisson's law gives.
//! The least of these, times how many are asked, is the answer (Bonferroni).
//!
//! Where several are far, others may be wrong by less and pass for the tail. Then the c farthest of the rest
//! count for no more than the farthest below them (a sample censored at it), c + those in question being the
//! share of a record that gross errors may have, and the tail begins at a quarter of the readings:
//! λ = (c + k)·P.

use super::residual_outliers::MAX_OUTLIER_FRACTION;

/// The farthest readings, which form the tail: as many as make its scale known to 1/√20, a fifth.
const MAX_TAIL_READINGS: usize = 20;
/// Of few readings one in this many: what is nearer is no tail.
const MIN_READINGS_PER_TAIL_READING: usize = 4;

/// Returns the chance that noise like `rest` has readings as far away as `far`: magnitudes, `step` apart at least
/// where they are written. 1 where there is no rest to compare with.
#[must_use]
pub fn noise_tail_probability(rest: &[f64], far: &[f64], step: f64) -> f64 {
    let mut rest = rest.to_vec();
    rest.sort_unstable_by(|a, b| b.total_cmp(a));
    let most = rest.len() / MIN_READINGS_PER_TAIL_READING;
    let gross = (MAX_OUTLIER_FRACTION * (rest.len() + far.len()) as f64) as usize;
    // One that is alone may be the end of any tail.
    let censored = if far.len() > 1 { gross.saturating_sub(far.len()) } else { 0 };
    let tail =
        if censored > 0 { most.saturating_sub(censored) } else { MAX_TAIL_READINGS.min(most) };
    if tail == 0 {
        return 1.0;
    }
    let begin = rest[censored + tail];
    let excess: f64 = rest[censored..censored + tail].iter().map(|away| away - begin).sum();
    let of_censored = censored as f64 * (rest[censored] - begin);
    let scale = ((excess + of_censored) / tail as f64).max(step);
    let mut far = far.to_vec();
    far.sort_unstable_by(|a, b| b.total_cmp(a));
    let count = tail as f64;
    let expected = |away: f64| {
        let excess = (away - begin).max(0.0);
        let share = if excess == 0.0 { 1.0 } else { (1.0 + excess / (count * scale)).powf(-count) };
        (censored + tail) as f64 * share
    };
    let chances =
        far.iter().enumerate().map(|(n, &away)| poisson_tail_probability(n + 1, expected(away)));
    (far.len() as f64 * chances.fold(1.0, f64::min)).min(1.0)
}

/// Returns the chance of at least `count` where `mean` are expected (Poisson).
#[must_use]
pub fn poisson_tail_probability(count: usize, mean: f64) -> f64 {
    // From the first term that counts on: one less the others would be rounding.
    let mut term = (1..=count).fold((-mean).exp(), |term, n| term * mean / n as f64);
    let (mut sum, mut n) = (0.0, count);
    while term > 1e-17 * sum && n < count + 1000 {
        sum += term;
        n += 1;
        term *= mean / n as f64;
    }
    sum.min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::RandomGenerator;

    #[test]
    fn the_chance_of_as_many_is_that_of_poisson() {
        assert!((poisson_tail_probability(1, 0.5) - 0.393_469).abs() < 1e-6);
        assert!((poisson_tail_probability(3, 1.0) - 0.080_301).abs() < 1e-6);
        assert!((poisson_tail_probability(2, 1e-6) - 5e-13).abs() < 1e-17);
        assert!((poisson_tail_probability(0, 2.0) - 1.0).abs() < 1e-12);
    }

    /// The `far` farthest of noise are treated as if they had been excluded.
    fn share_below(
        chance: f64,
        [rows, far]: [usize; 2],
        noise: impl Fn(&mut RandomGenerator) -> f64,
    ) -> f64 {
        let mut random = RandomGenerator::new(rows as u64);
        let runs = 2000;
        let found = (0..runs).filter(|_| {
            let mut all: Vec<f64> = (0..rows).map(|_| noise(&mut random).abs()).collect();
            all.sort_unstable_by(f64::total_cmp);
            noise_tail_probability(&all[..rows - far], &all[rows - far..], 0.0) < chance
        });
        found.count() as f64 / f64::from(runs)
    }

    #[test]
    fn errors_of_the_reading_that_pass_for_noise_do_not_hide_the_others() {
        let mut random = RandomGenerator::new(7);
        let mut rest: Vec<f64> = (0..400).map(|_| random.normal().abs()).collect();
        rest.extend([4.0, 4.3, 4.4, 4.8, 5.0, 5.1, 5.3, 5.6]);
        let four = noise_tail_probability(&rest, &[6.8, 7.0, 7.2, 7.4], 0.0);
        assert!(four < 1e-4, "{four}");
        assert!(noise_tail_probability(&rest, &[6.8], 0.0) > 1e-2);
    }

    #[test]
    fn noise_with_exponential_tails_keeps_the_chance_and_normal_noise_stays_far_below() {
        let exponential = |random: &mut RandomGenerator| -(1.0 - random.uniform()).ln();
        for of in [[60, 1], [400, 1], [2000, 1], [400, 2], [2000, 2], [2000, 5]] {
            let laplace = share_below(0.05, of, exponential);
            let normal = share_below(0.05, of, RandomGenerator::normal);
            println!("{of:?}: {laplace} of exponential, {normal} of normal noise");
            assert!(laplace < 0.08 && normal < 0.02, "{of:?}: {laplace} {normal}");
        }
    }

    #[test]
    fn what_is_far_from_noise_is_certain_and_what_is_its_tail_is_not() {
        let mut random = RandomGenerator::new(5);
        let rest: Vec<f64> = (0..2000).map(|_| random.normal().abs()).collect();
        assert!(noise_tail_probability(&rest, &[5.07], 0.0) > 1e-2);
        assert!(noise_tail_probability(&rest, &[9.0], 0.0) < 1e-3);
        // One of them may be chance, four of them are not.
        assert!(noise_tail_probability(&rest, &[6.0; 4], 0.0) < 1e-6);
        assert_eq!(noise_tail_probability(&[], &[9.0], 0.0), 1.0);
    }
}
