//! A reference that was shifted, as by touching off anew: a step of the zero, which is no constant of the machine.
//!
//! ```text
//! H_x   error = g·x            the constants as they would be applied
//! H_s   error = g·x₀ + z       those that are applied, z one level before a reading and another from it on
//! ```
//!
//! Each is judged by the readings of late, a reading that is far off counting as nine: one in twenty is bad. A step of a
//! size that no tool setter has by itself, and that explains them as well, forbids to apply x.

use serde::{Deserialize, Serialize};
use trueup_numerics::robust::median;

use crate::limits::times;

/// The readings that are looked at: three days at one each half hour.
const RECENT: usize = 60;
/// A smaller step is within what is believed of a zero before the first reading, twice its standard deviation, in µm.
const STEP_UM: f64 = 10.0;
/// So many readings have a level: of six, four on one side are a change.
const LEVEL: usize = 4;
/// Beyond three standard deviations a reading says no more.
const MOST: f64 = 9.0;
/// A difference of so much is strong evidence (Kass and Raftery 1995).
const STRONG_EVIDENCE: f64 = 6.0;

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

/// Returns the size of the step in µm, where a step of the zero explains the readings as well as `wanted` in the place of
/// `applied`.
pub(crate) fn step_um(
    recent: &[Recent],
    applied: &[f64],
    wanted: &[f64],
    noise_um: f64,
) -> Option<f64> {
    let cost = |um: f64| (um / noise_um).powi(2).min(MOST);
    let left: Vec<f64> = recent.iter().map(|it| it.um - times(&it.g, applied)).collect();
    let by_constants: f64 = recent.iter().map(|it| cost(it.um - times(&it.g, wanted))).sum();
    let level = |part: &[f64]| if part.is_empty() { 0.0 } else { median(&mut part.to_vec()) };
    let starts = 0..(left.len() + 1).saturating_sub(LEVEL);
    let steps = starts.map(|start| {
        let (before, after) = left.split_at(start);
        let [before_um, after_um] = [level(before), level(after)];
        let before = before.iter().map(|um| cost(um - before_um));
        let after = after.iter().map(|um| cost(um - after_um));
        // Before the first reading the reference was right: a level that is held is a step too.
        let is_level = after_um.abs() >= STEP_UM;
        let um = if is_level { after_um } else { after_um - before_um };
        (before.chain(after).sum::<f64>(), um)
    });
    let (by_step, um) = steps.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (um.abs() >= STEP_UM && by_step <= by_constants + STRONG_EVIDENCE).then_some(um)
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let found = step_um(&step, &[0.0; 2], &[8.0, 0.5], 1.0).expect("a step");
        assert!((found - 30.0).abs() < 1.0, "{found}");
        // Also once all readings stand behind it.
        assert!(step_um(&readings(|_, _| -30.0), &[0.0; 2], &[-8.0, -0.5], 1.0).is_some());
        let gain = readings(|growth, n| if n < 12 { 0.0 } else { 0.5 * growth });
        assert_eq!(step_um(&gain, &[0.0; 2], &[0.0, 0.5], 1.0), None);
        // A small one is any tool setter's.
        let small = readings(|_, n| if n < 12 { 0.0 } else { 6.0 });
        assert_eq!(step_um(&small, &[0.0; 2], &[5.0, 0.02], 1.0), None);
    }
}
