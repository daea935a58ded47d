//! A reference that was shifted, as by touching off anew: a step of the zero, which is no constant of the machine.
//!
//! ```text
//! S    before a reading B, from it on   error = g·applied + z     a step of the zero, abrupt
//! X    before it B, from it on          error = g·applied + g·δ   a change of the constants there
//! X₀   throughout                       error = g·applied + g·δ   constants that are off, or that age
//! B    a level, or g·δ                                           what there was before it in either case
//! ```
//!
//! All are fitted to the same readings of late, and each pays ln n for each of its parameters (BIC). A reading that is
//! far off counts as nine: one in twenty is bad. A step of a size that no tool setter has by itself, and that explains
//! them as well as a change of the constants, forbids to apply one. Readings at one level of growth cannot tell the two
//! apart; readings at others can, and where the constants explain them better, what was learned is applied.

use serde::{Deserialize, Serialize};
use trueup_numerics::robust::median;

use crate::{bank::ENOUGH, filter::FINEST_UM, limits::times};

/// The readings that are looked at: three days at one each half hour.
const RECENT: usize = 60;
/// A smaller step is within what is believed of a zero before the first reading, twice its standard deviation, in µm.
const STEP_UM: f64 = 10.0;
/// So many readings have a level: of six, four on one side are a change.
const LEVEL: usize = 4;
/// Beyond three standard deviations a reading says no more.
const MOST: f64 = 9.0;
/// Nor does a step count that is within five standard deviations of a level: of four readings, half of that of one.
const ABRUPT: f64 = 2.5;
/// Huber's bound, in standard deviations, and how often the weights are taken anew.
const COUNTS: f64 = 2.0;
const FITS: usize = 8;

/// A reading of late.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Recent {
    /// The sensitivities: of the zero, of each constant.
    g: Vec<f64>,
    /// What the file as it is misses it by, in µm.
    um: f64,
}

/// Adds a reading to those of late.
pub(crate) fn remember(recent: &mut Vec<Recent>, g: &[f64], um: f64) {
    recent.push(Recent { g: g.to_vec(), um });
    if recent.len() > RECENT {
        recent.remove(0);
    }
}

/// Returns the size of the step in µm, where a step of the zero explains the readings as well as other constants in the
/// place of `applied`, which are believed to be right within `prior` (standard deviations).
pub(crate) fn step_um(
    recent: &[Recent],
    applied: &[f64],
    prior: &[f64],
    noise_um: f64,
) -> Option<f64> {
    let left: Vec<(&[f64], f64)> =
        recent.iter().map(|it| (&it.g[..], it.um - times(&it.g, applied))).collect();
    // Fewer readings than a level has can all be behind the step.
    let starts = 0..=left.len().saturating_sub(LEVEL);
    let by_levels = |start: usize| {
        let (before, after) = left.split_at(start);
        [before, after].map(|part| cost(&by_level(part).1, noise_um)).iter().sum::<f64>()
    };
    let (start, _) = starts.map(|it| (it, by_levels(it))).min_by(|a, b| a.1.total_cmp(&b.1))?;
    let (before, after) = left.split_at(start);
    let [(held_um, held_left), (_, before_left), (after_um, after_left)] =
        [&left[..], before, after].map(by_level);
    // Where what is applied is right by now there is no step that it could be taken for.
    if after_um.abs() < STEP_UM {
        return None;
    }
    let [throughout, constants_before, constants_after] =
        [&left[..], before, after].map(|part| by_constants(part, prior, noise_um));
    let count = prior.len();
    let fitted = if start > 0 { 2 * count } else { count };
    // What even constants that are free at the step leave: a learner that is confused by a step thinks it noise.
    let free = left.len().saturating_sub(fitted);
    let noise_um = if free >= LEVEL {
        let both = constants_before.iter().chain(&constants_after).copied();
        scatter(both) * (left.len() as f64 / free as f64).sqrt()
    } else {
        noise_um
    };
    if after_um.abs() < ABRUPT * noise_um {
        return None;
    }
    let price = (left.len() as f64).ln();
    let judged = |left_um: &[f64], parameters: usize| {
        if left_um.is_empty() { 0.0 } else { cost(left_um, noise_um) + price * parameters as f64 }
    };
    let earlier = judged(&before_left, 1).min(judged(&constants_before, count));
    // The reading from which on is a parameter too.
    let place = if start > 0 { price } else { 0.0 };
    let by_step = earlier + place + judged(&after_left, 1);
    // Before the first reading the reference was right: a level that is held is a step too.
    let by_held = judged(&held_left, 1);
    let (by_step, um) = if by_held <= by_step { (by_held, held_um) } else { (by_step, after_um) };
    let by_change = earlier + place + judged(&constants_after, count);
    let by_constants = by_change.min(judged(&throughout, count));
    // However often one looks: constants are believed against a step as they are against the file.
    (by_step <= by_constants + 2.0 * ENOUGH.ln() && um.abs() >= STEP_UM).then_some(um)
}

/// Returns the standard deviation by the median of the magnitudes, no finer than any probe.
fn scatter(left_um: impl Iterator<Item = f64>) -> f64 {
    let mut all: Vec<f64> = left_um.map(f64::abs).collect();
    if all.is_empty() { FINEST_UM } else { (1.4826 * median(&mut all)).max(FINEST_UM) }
}

/// Returns the sum of squares in units of the noise, none beyond [`MOST`].
fn cost(left_um: &[f64], noise_um: f64) -> f64 {
    left_um.iter().map(|um| (um / noise_um).powi(2).min(MOST)).sum()
}

/// Returns the level of readings, and what it leaves of each.
fn by_level(part: &[(&[f64], f64)]) -> (f64, Vec<f64>) {
    let mut all: Vec<f64> = part.iter().map(|(_, um)| *um).collect();
    let level_um = if all.is_empty() { 0.0 } else { median(&mut all) };
    (level_um, part.iter().map(|(_, um)| um - level_um).collect())
}

/// Returns what constants leave of each reading that are fitted to them: least squares within `prior`, by Huber's weights.
fn by_constants(part: &[(&[f64], f64)], prior: &[f64], noise_um: f64) -> Vec<f64> {
    let n = prior.len();
    let mut left_um: Vec<f64> = by_level(part).1;
    for _ in 0..FITS {
        let noise_um = noise_um.min(scatter(left_um.iter().copied()));
        let (mut x, mut p) = (vec![0.0; n], vec![0.0; n * n]);
        for (i, deviation) in prior.iter().enumerate() {
            p[i * n + i] = deviation * deviation;
        }
        for ((g, um), left_um) in part.iter().zip(&left_um) {
            let weight = (COUNTS * noise_um / left_um.abs().max(1e-9)).min(1.0);
            let pg: Vec<f64> = p.chunks(n).map(|row| times(row, g)).collect();
            let s = times(g, &pg) + noise_um * noise_um / weight;
            let off_um = um - times(g, &x);
            for i in 0..n {
                x[i] += pg[i] / s * off_um;
                for j in 0..n {
                    p[i * n + j] -= pg[i] * pg[j] / s;
                }
            }
        }
        left_um = part.iter().map(|(g, um)| um - times(g, &x)).collect();
    }
    left_um
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRIOR: [f64; 2] = [5.0, 0.25];

    /// Readings of a growth of 20 to 50 µm, `um` by it and by number.
    fn readings(um: impl Fn(f64, usize) -> f64) -> Vec<Recent> {
        let mut all = Vec::new();
        for n in 0..30 {
            let growth = 35.0 + 15.0 * (n as f64 / 2.3).sin();
            let noise = [0.6, -0.6, 0.2, -0.2, -0.4, 0.4, 0.1][n % 7];
            remember(&mut all, &[1.0, growth], um(growth, n) + noise);
        }
        all
    }

    #[test]
    fn a_step_of_the_zero_is_one_and_a_gain_is_none() {
        let step = readings(|_, n| if n < 12 { 0.0 } else { 30.0 });
        let found = step_um(&step, &[0.0; 2], &PRIOR, 1.0).expect("a step");
        assert!((found - 30.0).abs() < 1.0, "{found}");
        // Also once all readings stand behind it.
        assert!(step_um(&readings(|_, _| -30.0), &[0.0; 2], &PRIOR, 1.0).is_some());
        let gain = readings(|growth, n| if n < 12 { 0.0 } else { 0.5 * growth });
        assert_eq!(step_um(&gain, &[0.0; 2], &PRIOR, 1.0), None);
        // Nor are constants that age, however far they are off by now: a tenth of the growth in thirty readings.
        let ageing = readings(|growth, n| (0.3 + 0.003 * n as f64) * growth);
        assert_eq!(step_um(&ageing, &[0.0; 2], &PRIOR, 1.0), None);
        // At one level of growth the two look alike; readings at others settle it.
        let mut settled = Vec::new();
        for n in 0..30 {
            let growth = if n < 20 { 50.0 } else { 20.0 + 3.0 * f64::from(n - 20) };
            let noise = f64::from(n % 3 - 1) / 2.0;
            remember(&mut settled, &[1.0, growth], if n < 8 { 0.0 } else { 0.4 * growth } + noise);
            let is_step = step_um(&settled, &[0.0; 2], &PRIOR, 1.0).is_some();
            assert_eq!(is_step, (10..23).contains(&n), "{n}");
        }
        // A small one is any tool setter's.
        let small = readings(|_, n| if n < 12 { 0.0 } else { 6.0 });
        assert_eq!(step_um(&small, &[0.0; 2], &PRIOR, 1.0), None);
    }
}
