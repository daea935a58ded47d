//! The line of a backlash over its readings, as sums.

use serde::{Deserialize, Serialize};

/// Standard errors of the slope, looked at after each reading of years: once in 10⁸ by chance for each.
pub(crate) const MIN_SLOPE_SIGMAS: f64 = 6.0;
/// Standard errors from which s₀ is another one: as alternatives are distinguished.
const MIN_INTERCEPT_SIGMAS: f64 = 4.0;
/// Readings in the negative direction that a line needs: a month of two a day.
const MIN_WEAR_READINGS: f64 = 30.0;

/// Sums over the readings of one backlash, as far as they have left the window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct RegressionSums {
    /// Readings.
    n: f64,
    /// Σ g², Σ g²·t, Σ g²·t².
    gg: [f64; 3],
    /// Σ g·r, Σ g·r·t.
    gr: [f64; 2],
}

impl RegressionSums {
    /// Adds a reading: its sensitivity to the width in µm, what it says of it in µm, its time in years.
    pub(crate) fn add_reading(&mut self, g: f64, r: f64, t: f64) {
        self.n += 1.0;
        (0..3).for_each(|power| self.gg[power] += g * g * t.powi(power as i32));
        (0..2).for_each(|power| self.gr[power] += g * r * t.powi(power as i32));
    }

    /// Returns s and its standard error, for a scatter in µm; `None` where there is no line.
    pub(crate) fn slope_with_standard_error(&self, scatter_um: f64) -> Option<[f64; 2]> {
        let ([one, t, tt], [r, rt]) = (self.gg, self.gr);
        let determinant = one * tt - t * t;
        // Readings at one time have no line.
        if self.n < MIN_WEAR_READINGS || determinant <= 1e-9 * one * tt {
            return None;
        }
        let start = (tt * r - t * rt) / determinant;
        if start.abs() < MIN_INTERCEPT_SIGMAS * scatter_um * (tt / determinant).sqrt() {
            return Some([rt / tt, scatter_um / tt.sqrt()]);
        }
        Some([(one * rt - t * r) / determinant, scatter_um * (one / determinant).sqrt()])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_width_that_grows_is_a_line_and_one_that_was_wrong_from_the_start_is_not() {
        let noise = [1.5, -2.0, 0.5, -1.0, 2.0, -0.5, 0.0, -1.5, 1.0];
        let sums = |start: f64, per_year: f64| {
            let mut sums = RegressionSums::default();
            for n in 0..250 {
                let t = f64::from(n) / 250.0;
                let g = 4.0;
                sums.add_reading(g, g * (start + per_year * t) + noise[n as usize % 9], t);
            }
            sums.slope_with_standard_error(1.3).expect("a line")
        };
        let [slope, error] = sums(0.0, 1.25);
        assert!((slope - 1.25).abs() < 2.0 * error && error < 0.05, "{slope} {error}");
        let [slope, error] = sums(1.0, 0.0);
        assert!(slope.abs() < MIN_SLOPE_SIGMAS * error, "{slope} {error}");
    }
}
