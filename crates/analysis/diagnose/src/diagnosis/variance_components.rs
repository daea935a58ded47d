//! How much more a new day may leave than the parts of a record do on the average.
//!
//! The residual of a part, by a fit to the others, is its zero and a rest. With the mean square Z of the zeros of k parts (less
//! that of a mean of noise) and R of the rest, which has ν degrees of freedom, a new day leaves at most
//!
//! ```text
//! F₉₅(1, k − 1)·w·Z + F₉₅(ν/k, ν − ν/k)·R
//! ```
//!
//! The rest of a day is one of k parts, and both are estimates: their ratio has an F distribution. Neighbouring readings
//! are alike: a mean square of n of them with the autocorrelations r has ν = n/(1 + 2·Σr²) degrees of freedom (Bartlett,
//! 1946). The zero of a day is one value, known from k: a day has one of any sign, thus F and not a one-sided t. And it
//! goes on from that of the last part as it went from part to part: of a random walk the step to the next day is w times
//! as large, in squares, as what the others leave of a part.

use trueup_numerics::f_quantile;

/// Residuals of parts that a fit did not see, as mean squares in µm².
#[derive(Clone, Copy, Debug)]
pub(super) struct FoldVarianceComponents {
    /// Of the zeros of the parts.
    zero: f64,
    /// Of what is left about them.
    rest: f64,
    /// Degrees of freedom of the rest.
    freedom: f64,
    /// Number of parts.
    parts: f64,
}

impl FoldVarianceComponents {
    /// Returns the mean squares of `um`, in groups, of which `parts` has the part; `within` is what groups average away.
    pub(super) fn new(um: &[f64], parts: &[usize], within: f64) -> Self {
        let count = parts.iter().max().map_or(0, |last| last + 1);
        let mut sums = vec![[0.0; 2]; count];
        for (um, &part) in um.iter().zip(parts) {
            sums[part][0] += um;
            sums[part][1] += 1.0;
        }
        let groups = um.len().max(1) as f64;
        let of_means = sums.iter().map(|[sum, count]| sum * sum / count.max(1.0)).sum::<f64>();
        let all = um.iter().map(|um| um * um).sum::<f64>() / groups + within;
        let [freedom, parts] = [effective_degrees_of_freedom(um), count as f64];
        let of_means = of_means / groups;
        let rest = all - of_means;
        let zero = (of_means - rest * parts / freedom).max(0.0);
        Self { zero, rest: all - zero, freedom, parts }
    }

    /// Returns how many times as much as these parts a new day may leave, 95 % of days; `noise` is no part of it, a mean
    /// square in µm².
    pub(super) fn new_day_factor(&self, kept: f64, noise: f64) -> f64 {
        let Self { freedom, parts, .. } = *self;
        let of_zero = f_quantile(kept, 1.0, parts - 1.0) * step_variance_ratio(parts);
        let of_rest = f_quantile(kept, freedom / parts, freedom - freedom / parts);
        self.combine(of_zero, of_rest, noise)
    }

    /// Returns the same as it is expected: the zero goes on, the rest is that of a part; of one part nothing is known.
    pub(super) fn expected_new_day_factor(&self, noise: f64) -> f64 {
        self.combine(step_variance_ratio(self.parts).max(1.0), 1.0, noise)
    }

    /// Returns `of_zero` times the zero and `of_rest` times the rest without `noise`, over both.
    fn combine(&self, of_zero: f64, of_rest: f64, noise: f64) -> f64 {
        let rest = (self.rest - noise).max(0.0);
        if self.zero + rest <= 0.0 {
            return 1.0;
        }
        let zero = if self.zero > 0.0 { of_zero * self.zero } else { 0.0 };
        (zero + of_rest * rest) / (self.zero + rest)
    }
}

/// Returns w of `parts` parts: the variance of the step of a random walk from the mean of its k values to the next one,
/// over that of one of them from the mean of the others.
fn step_variance_ratio(parts: f64) -> f64 {
    let next = 1.0 + (parts - 1.0) * (2.0 * parts - 1.0) / (6.0 * parts);
    let left_out = parts * (parts + 1.0) / (6.0 * (parts - 1.0));
    next / left_out
}

/// Returns the degrees of freedom of the mean square of `um`, which follow each other; at least 1. The squares of chance
/// correlations, 1/(n − lag) each, are taken off.
fn effective_degrees_of_freedom(um: &[f64]) -> f64 {
    let count = um.len();
    let at = |lag: usize| {
        let products = um.iter().zip(&um[lag..]).map(|(one, other)| one * other);
        products.sum::<f64>() / (count - lag) as f64
    };
    let whole = if count > 0 { at(0) } else { 0.0 };
    if whole <= 0.0 {
        return count.max(1) as f64;
    }
    let squares = (1..count / 2).map(|lag| {
        let [left, all] = [(count - lag) as f64, count as f64];
        left / all * ((at(lag) / whole).powi(2) - 1.0 / left)
    });
    (count as f64 / (1.0 + 2.0 * squares.sum::<f64>()).max(1.0)).max(1.0)
}

#[cfg(test)]
mod tests {
    use trueup_numerics::random::RandomGenerator;

    use super::*;

    /// By hand: of three values 0, σ, 2σ² … the next is 1 + 4/9 + 1/9 off the mean of three, and on the average one is off
    /// the mean of the other two by 5/4, 1/2 and 5/4.
    #[test]
    fn the_next_step_of_a_walk_is_larger_than_those_within() {
        assert!(
            (step_variance_ratio(3.0) - (14.0 / 9.0) / 1.0).abs() < 1e-12,
            "{}",
            step_variance_ratio(3.0)
        );
        assert!((step_variance_ratio(2.0) - 1.25).abs() < 1e-12);
    }

    /// Of a first-order process with the correlation ½ the sum of squares is ¼ + 1/16 + … = ⅓.
    #[test]
    fn readings_that_are_alike_have_fewer_degrees_of_freedom() {
        let mut noise = RandomGenerator::new(3);
        let white: Vec<f64> = (0..3000).map(|_| noise.normal()).collect();
        assert!(
            effective_degrees_of_freedom(&white) > 2400.0,
            "{}",
            effective_degrees_of_freedom(&white)
        );
        let mut state = 0.0;
        let alike: Vec<f64> = white
            .iter()
            .map(|um| {
                state = 0.5 * state + um;
                state
            })
            .collect();
        assert!(
            (effective_degrees_of_freedom(&alike) / 1800.0 - 1.0).abs() < 0.2,
            "{}",
            effective_degrees_of_freedom(&alike)
        );
        assert_eq!(effective_degrees_of_freedom(&[1.0; 4]).floor(), 2.0);
    }

    /// Parts of many independent readings that have one zero leave a new day as much as themselves; with zeros of ±1 µm
    /// next to 0.1 µm of noise two parts leave it 161·1.25 times as much.
    #[test]
    fn a_zero_of_its_own_for_each_part_is_worth_more_than_many_readings() {
        let mut noise = RandomGenerator::new(7);
        let parts: Vec<usize> = (0..2000).map(|row| row / 1000).collect();
        let white: Vec<f64> = (0..2000).map(|_| 0.1 * noise.normal()).collect();
        let times = FoldVarianceComponents::new(&white, &parts, 0.0).new_day_factor(0.95, 0.0);
        assert!((1.0..1.5).contains(&times), "{times}");
        let zeros = [1.0, -1.0];
        let shifted: Vec<f64> =
            white.iter().zip(&parts).map(|(um, &part)| um + zeros[part]).collect();
        let times = FoldVarianceComponents::new(&shifted, &parts, 0.0).new_day_factor(0.95, 0.0);
        assert!((times / (161.4 * 1.25) - 1.0).abs() < 0.05, "{times}");
    }

    /// Noise of the gauge counts on no day: what is left without it is the zero.
    #[test]
    fn noise_is_not_left_at_the_tool() {
        let left = FoldVarianceComponents { zero: 1.0, rest: 9.0, freedom: 300.0, parts: 3.0 };
        let of_zero = 18.5128 * 14.0 / 9.0;
        assert!((left.new_day_factor(0.95, 9.0) - of_zero).abs() < 1e-3);
        assert!(left.new_day_factor(0.95, 0.0) < 0.11 * of_zero + 1.3);
    }

    /// By hand: a zero of 1 µm² from three parts goes on by 14/9, the rest of 9 µm² stays; of one part nothing goes on.
    #[test]
    fn the_zero_is_expected_to_go_on() {
        let left = FoldVarianceComponents { zero: 1.0, rest: 9.0, freedom: 300.0, parts: 3.0 };
        assert!((left.expected_new_day_factor(0.0) - (14.0 / 9.0 + 9.0) / 10.0).abs() < 1e-12);
        assert!((left.expected_new_day_factor(9.0) - 14.0 / 9.0).abs() < 1e-12);
        let one = FoldVarianceComponents { parts: 1.0, ..left };
        assert!((one.expected_new_day_factor(0.0) - 1.0).abs() < 1e-12);
    }
}
