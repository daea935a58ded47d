//! A first-order lag: what is warm follows its sensor, or the sensor follows it, by a time constant.
//!
//! ```text
//! y ← y + (x − y)·(1 − e^(−Δt/τ))
//! ```
//!
//! A row's x holds over the interval that ends with the row, for which the step is exact whatever
//! the spacing. It starts settled, at the first row's x.

/// The time since the row before.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RowTimer {
    before_s: Option<f64>,
}

impl RowTimer {
    /// From the last call to this one, in s; 0 at the first, and where time runs back.
    pub(super) fn elapsed_s(&mut self, time_s: f64) -> f64 {
        let before_s = self.before_s.replace(time_s).unwrap_or(time_s);
        (time_s - before_s).max(0.0)
    }
}

/// The value that lags behind.
#[derive(Clone, Debug, Default)]
pub struct Lag {
    /// y; `None` before the first row.
    settled: Option<f64>,
    clock: RowTimer,
}

impl Lag {
    /// y at `time_s` behind `value`, x, with the time constant `lag_s`; x itself where that is 0.
    ///
    /// NaN for a missing x, and for a missing time where there is a lag: such a row is passed over,
    /// and the next one's x counts since the last row that had both.
    ///
    /// ```
    /// use trueup_machine::model::Lag;
    /// let mut lag = Lag::default();
    /// assert_eq!(lag.step(100.0, 0.0, 20.0), 20.0); // settled
    /// // From 20 towards 30 for one time constant: 30 − 10/e
    /// assert!((lag.step(100.0, 100.0, 30.0) - 26.321_205_588).abs() < 1e-9);
    /// ```
    pub fn step(&mut self, lag_s: f64, time_s: f64, value: f64) -> f64 {
        self.step_asymmetric([lag_s; 2], time_s, value)
    }

    /// Steps a lag that starts at 0 in place of its first value: what was cold before it was heated.
    ///
    /// ```
    /// use trueup_machine::model::Lag;
    /// let mut lag = Lag::default();
    /// assert_eq!(lag.step_from_zero(100.0, 0.0, 9.0), 0.0);
    /// assert!((lag.step_from_zero(100.0, 100.0, 9.0) - 5.689_085_03).abs() < 1e-8);
    /// ```
    pub fn step_from_zero(&mut self, lag_s: f64, time_s: f64, value: f64) -> f64 {
        self.settled.get_or_insert(0.0);
        self.step(lag_s, time_s, value)
    }

    /// Returns the same with two time constants, in s: while y rises, and while it falls.
    pub(crate) fn step_asymmetric(
        &mut self,
        rise_fall_s: [f64; 2],
        time_s: f64,
        value: f64,
    ) -> f64 {
        if rise_fall_s == [0.0; 2] {
            return value;
        }
        if time_s.is_nan() || value.is_nan() {
            return f64::NAN;
        }
        let before = self.settled.unwrap_or(value);
        let elapsed_s = self.clock.elapsed_s(time_s);
        let [rise_s, fall_s] = rise_fall_s;
        let lag_s = if value < before { fall_s } else { rise_s };
        // A constant of 0 is no lag: 0/0 at two rows of one time would be none either.
        let share = if lag_s == 0.0 { 1.0 } else { -(-elapsed_s / lag_s).exp_m1() };
        let after = before + (value - before) * share;
        self.settled = Some(after);
        after
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_followed_exactly_whatever_the_row_spacing() {
        for spacing_s in [0.1, 3.0, 60.0, 700.0] {
            let mut lag = Lag::default();
            lag.step(300.0, 0.0, 20.0);
            for row in 1..(2100.0 / spacing_s) as u32 {
                let time_s = f64::from(row) * spacing_s;
                let y = lag.step(300.0, time_s, 30.0);
                assert!((y - (30.0 - 10.0 * (-time_s / 300.0).exp())).abs() < 1e-9, "{time_s} s");
            }
        }
    }

    #[test]
    fn without_a_time_constant_nothing_lags_and_no_time_is_needed() {
        let mut lag = Lag::default();
        assert_eq!(lag.step(0.0, f64::NAN, 20.0), 20.0);
        assert_eq!(lag.step(0.0, f64::NAN, 30.0), 30.0);
    }

    #[test]
    fn a_missing_row_is_passed_over() {
        let (mut whole, mut broken) = (Lag::default(), Lag::default());
        assert!(broken.step(9.0, -1.0, f64::NAN).is_nan());
        for lag in [&mut whole, &mut broken] {
            assert_eq!(lag.step(9.0, 0.0, 20.0), 20.0);
        }
        assert!(broken.step(9.0, 3.0, f64::NAN).is_nan());
        assert!(broken.step(9.0, f64::NAN, 25.0).is_nan());
        assert_eq!(broken.step(9.0, 5.0, 30.0), whole.step(9.0, 5.0, 30.0));
    }

    #[test]
    fn two_rows_at_one_time_do_not_move_it() {
        let mut lag = Lag::default();
        lag.step(9.0, 5.0, 20.0);
        assert_eq!(lag.step(9.0, 5.0, 80.0), 20.0);
    }
}
