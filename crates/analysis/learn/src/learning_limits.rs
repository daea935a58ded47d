//! How far learning may go: for each constant, for all together, and by one reading.

use serde::{Deserialize, Serialize};

/// Bounds of what is learned.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LearningLimits {
    /// A constant is never changed by more than this share of what the user's file says; above 0.
    pub share: f64,
    /// In no row does all that is learned change the correction by more, in µm; above 0.
    pub total_um: f64,
    /// One reading never changes the correction by more, where it was taken, in µm; above 0. An event that rests on three readings
    /// changes it by at most three times as much.
    pub step_um: f64,
}

impl Default for LearningLimits {
    /// A constant at most doubles and keeps its sign: what is farther off is another machine, and is to be
    /// measured. 100 µm together: half of what the clamp of X and Y lets through by default. 5 µm by a reading:
    /// a twentieth of that.
    fn default() -> Self {
        Self { share: 1.0, total_um: 100.0, step_um: 5.0 }
    }
}

impl LearningLimits {
    /// Returns `target` within the bounds, where rows have the sensitivities `rows`; and whether it was held.
    pub(crate) fn clamp_to_limits<'a>(
        &self,
        target: &[f64],
        rows: impl IntoIterator<Item = &'a Vec<f64>>,
    ) -> (Vec<f64>, bool) {
        let mut held = target.to_vec();
        let mut is_held = false;
        for share in &mut held[1..] {
            let within = share.clamp(-self.share, self.share);
            is_held |= within != *share;
            *share = within;
        }
        let most_um =
            rows.into_iter().map(|g| prediction_change_um(g, &held).abs()).fold(0.0, f64::max);
        if most_um > self.total_um {
            held.iter_mut().for_each(|x| *x *= self.total_um / most_um);
            is_held = true;
        }
        (held, is_held)
    }

    /// Returns the way from `applied` towards `target` that rests on this many readings, of which the last was taken
    /// at `g`.
    pub(crate) fn step_toward_target(
        &self,
        applied: &[f64],
        target: &[f64],
        g: &[f64],
        readings: u64,
    ) -> Vec<f64> {
        let way: Vec<f64> = target.iter().zip(applied).map(|(to, from)| to - from).collect();
        let um = prediction_change_um(g, &way).abs();
        let step_um = self.step_um * readings as f64;
        let share = if um > step_um { step_um / um } else { 1.0 };
        applied.iter().zip(way).map(|(from, way)| from + share * way).collect()
    }
}

/// Returns what values change where the sensitivities are `g`, in µm; 0 where these are not known.
pub(crate) fn prediction_change_um(g: &[f64], x: &[f64]) -> f64 {
    let um: f64 = g.iter().zip(x).map(|(g, x)| g * x).sum();
    if um.is_finite() { um } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_all_together_and_one_reading_are_held() {
        let limits = LearningLimits { share: 0.3, total_um: 20.0, step_um: 2.0 };
        let rows = vec![vec![1.0, 50.0]];
        assert_eq!(limits.clamp_to_limits(&[0.0, 0.2], &rows), (vec![0.0, 0.2], false));
        assert_eq!(
            limits.clamp_to_limits(&[0.0, -0.9], &[vec![1.0, 10.0]]),
            (vec![0.0, -0.3], true)
        );
        let (held, is_held) = limits.clamp_to_limits(&[10.0, 0.3], &rows);
        assert!(is_held && (prediction_change_um(&rows[0], &held) - 20.0).abs() < 1e-9, "{held:?}");
        for readings in [1, 3] {
            let stepped = limits.step_toward_target(&[0.0, 0.0], &[0.0, 0.2], &rows[0], readings);
            let um = 2.0 * readings as f64;
            assert!((prediction_change_um(&rows[0], &stepped) - um).abs() < 1e-9, "{stepped:?}");
        }
        // A row in which nothing is known changes nothing.
        assert_eq!(prediction_change_um(&[1.0, f64::NAN], &[1.0, 1.0]), 0.0);
    }
}
