//! A straight line y = gain·x + offset by least squares, judged on rows it has not seen.
//!
//! With x̄, ȳ the means and S = Σ(x − x̄)²:
//!
//! ```text
//! gain = Σ(x − x̄)(y − ȳ) / S,   offset = ȳ − gain·x̄,   e = y − gain·x − offset
//! h = 1/n + (x − x̄)²/S          a row's own weight in its fitted value (the hat matrix)
//! e / (1 − h)                   the row's residual from the line fitted to all other rows
//! ```
//!
//! The last line is exact for least squares: leaving out each row in turn costs no second fit.

/// A fitted line. Its units are those of the data: `gain` is y for one x.
#[derive(Clone, Debug, PartialEq)]
pub struct LineFit {
    /// The slope: y for one x.
    pub gain: f64,
    /// y at x = 0.
    pub offset: f64,
    /// y minus the line, by row; NaN where x or y is missing.
    pub residuals: Vec<f64>,
    /// y minus the line fitted to all other rows, by row; NaN where x or y is missing.
    pub leave_one_out_residuals: Vec<f64>,
}

impl LineFit {
    /// Returns the line's value at `x`.
    #[must_use]
    pub fn evaluate(&self, x: f64) -> f64 {
        self.gain * x + self.offset
    }
}

/// Why no line can be fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LineFitError {
    /// x and y have different numbers of rows.
    #[error("{x_rows} rows of x but {y_rows} of y")]
    LengthsDiffer {
        /// Rows of x.
        x_rows: usize,
        /// Rows of y.
        y_rows: usize,
    },
    /// Fewer than 3 rows have both values: nothing is left to judge the line by.
    #[error("a line needs 3 rows that have both values, there are {rows}")]
    TooFewRows {
        /// Rows that have both.
        rows: usize,
    },
    /// A value is infinite.
    #[error("row {} holds an infinite value", .row + 1)]
    Infinite {
        /// Its row, from 0.
        row: usize,
    },
    /// x is the same in every row.
    #[error("a line needs two different x, all are equal")]
    NoSpread,
    /// Without this row x would be the same in every row: it alone decides the slope.
    #[error("row {} alone decides the slope: all other x are equal", .row + 1)]
    OneRowDecides {
        /// The row, from 0.
        row: usize,
    },
}

/// Returns the line of least squares through (`x`, `y`); rows in which either is missing (NaN) take no
/// part.
///
/// # Errors
/// See [`LineFitError`].
pub fn fit_line(x: &[f64], y: &[f64]) -> Result<LineFit, LineFitError> {
    if x.len() != y.len() {
        return Err(LineFitError::LengthsDiffer { x_rows: x.len(), y_rows: y.len() });
    }
    if let Some(row) = x.iter().zip(y).position(|(x, y)| x.is_infinite() || y.is_infinite()) {
        return Err(LineFitError::Infinite { row });
    }
    let pairs = || x.iter().zip(y).filter(|(x, y)| !x.is_nan() && !y.is_nan());
    let rows = pairs().count();
    if rows < 3 {
        return Err(LineFitError::TooFewRows { rows });
    }
    reject_undetermined_slope(x, y)?;

    let n = rows as f64;
    let mean_x = pairs().map(|(x, _)| x).sum::<f64>() / n;
    let mean_y = pairs().map(|(_, y)| y).sum::<f64>() / n;
    let spread: f64 = pairs().map(|(x, _)| (x - mean_x).powi(2)).sum();
    let gain = pairs().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum::<f64>() / spread;
    let offset = mean_y - gain * mean_x;

    // From the means, not from the offset: it is far away where x lies far from 0.
    let residual = |(x, y): (&f64, &f64)| (y - mean_y) - gain * (x - mean_x);
    let residuals: Vec<f64> = x.iter().zip(y).map(residual).collect();
    let held_out = |(x, residual): (&f64, &f64)| {
        let own_weight = 1.0 / n + (x - mean_x).powi(2) / spread;
        residual / (1.0 - own_weight)
    };
    let leave_one_out_residuals = x.iter().zip(&residuals).map(held_out).collect();
    Ok(LineFit { gain, offset, residuals, leave_one_out_residuals })
}

/// Refuses x without spread, and x whose only spread is one row: its own weight is 1, and the line
/// without it is not defined. By comparison, as in floating point the weight only comes near 1.
fn reject_undetermined_slope(x: &[f64], y: &[f64]) -> Result<(), LineFitError> {
    let present = || x.iter().zip(y).enumerate().filter(|(_, (x, y))| !x.is_nan() && !y.is_nan());
    let least = present().fold(f64::INFINITY, |least, (_, (x, _))| least.min(*x));
    let most = present().fold(f64::NEG_INFINITY, |most, (_, (x, _))| most.max(*x));
    if least == most {
        return Err(LineFitError::NoSpread);
    }
    if present().any(|(_, (x, _))| *x != least && *x != most) {
        return Ok(());
    }
    for end in [least, most] {
        let mut at_end = present().filter(|(_, (x, _))| **x == end);
        if let (Some((row, _)), None) = (at_end.next(), at_end.next()) {
            return Err(LineFitError::OneRowDecides { row });
        }
    }
    Ok(())
}

/// How large a series of residuals is, in their own unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorStatistics {
    /// The root of the mean square.
    pub rms: f64,
    /// The largest magnitude.
    pub max_abs: f64,
}

impl ErrorStatistics {
    /// Of the values that are not missing (NaN); `None` if there are none.
    #[must_use]
    pub fn from_residuals(values: &[f64]) -> Option<Self> {
        let present = || values.iter().filter(|value| !value.is_nan());
        let rows = present().count();
        (rows > 0).then(|| Self {
            rms: (present().map(|value| value * value).sum::<f64>() / rows as f64).sqrt(),
            max_abs: present().fold(0.0, |largest, value| largest.max(value.abs())),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_on_a_line_give_the_line() {
        let fit = fit_line(&[1.0, 2.0, 4.0], &[5.0, 7.0, 11.0]).expect("three rows, spread");
        assert!((fit.gain - 2.0).abs() < 1e-14 && (fit.offset - 3.0).abs() < 1e-14);
        assert!((fit.evaluate(10.0) - 23.0).abs() < 1e-13);
        let left =
            ErrorStatistics::from_residuals(&fit.leave_one_out_residuals).expect("three values");
        assert!(left.max_abs < 1e-13);
    }

    #[test]
    fn the_closed_form_of_leaving_out_is_the_same_as_fitting_again() {
        let x: Vec<f64> = (0..25).map(|i| f64::from(i * i % 17) * 0.7 + 1e4).collect();
        let y: Vec<f64> = (0..25).map(|i| f64::from(i * 31 % 23) - 4.0).collect();
        let fit = fit_line(&x, &y).expect("spread data");
        for row in 0..x.len() {
            let without = |values: &[f64]| -> Vec<f64> {
                let mut rest = values.to_vec();
                rest.remove(row);
                rest
            };
            let refit = fit_line(&without(&x), &without(&y)).expect("spread data");
            let brute_force = y[row] - refit.evaluate(x[row]);
            let difference = (fit.leave_one_out_residuals[row] - brute_force).abs();
            assert!(difference < 1e-9, "row {row}: {difference:e}");
        }
    }

    #[test]
    fn missing_values_take_no_part_and_keep_their_row() {
        let nan = f64::NAN;
        let fit = fit_line(&[1.0, nan, 2.0, 3.0, 4.0], &[2.0, 9.0, 4.5, 6.0, nan])
            .expect("three full rows");
        let full = fit_line(&[1.0, 2.0, 3.0], &[2.0, 4.5, 6.0]).expect("three rows");
        assert_eq!((fit.gain, fit.offset), (full.gain, full.offset));
        let missing: Vec<bool> = fit.residuals.iter().map(|residual| residual.is_nan()).collect();
        assert_eq!(missing, [false, true, false, false, true]);
        assert!(fit.leave_one_out_residuals[1].is_nan() && fit.leave_one_out_residuals[4].is_nan());
    }

    #[test]
    fn what_decides_no_line_is_refused() {
        let lengths = LineFitError::LengthsDiffer { x_rows: 1, y_rows: 2 };
        assert_eq!(fit_line(&[1.0], &[1.0, 2.0]), Err(lengths));
        assert_eq!(fit_line(&[], &[]), Err(LineFitError::TooFewRows { rows: 0 }));
        let two = LineFitError::TooFewRows { rows: 2 };
        assert_eq!(fit_line(&[1.0, 2.0, 3.0], &[1.0, f64::NAN, 2.0]), Err(two));
        assert_eq!(fit_line(&[0.1; 4], &[1.0, 2.0, 3.0, 4.0]), Err(LineFitError::NoSpread));
        let infinite = LineFitError::Infinite { row: 1 };
        assert_eq!(fit_line(&[1.0, f64::INFINITY, 2.0], &[1.0; 3]), Err(infinite));
    }

    #[test]
    fn a_slope_that_rests_on_one_row_is_refused_wherever_the_row_is() {
        for row in 0..4 {
            let mut x = [0.1; 4];
            x[row] = 7.3;
            let decides = LineFitError::OneRowDecides { row };
            assert_eq!(fit_line(&x, &[1.0, 2.0, 3.0, 4.0]), Err(decides));
        }
        assert!(fit_line(&[1.0, 1.0, 2.0, 2.0], &[1.0, 2.0, 3.0, 4.0]).is_ok());
        assert!(fit_line(&[1.0, 2.0, 3.0], &[1.0, 2.0, 3.5]).is_ok());
    }

    #[test]
    fn a_summary_is_the_root_of_the_mean_square_and_the_largest_magnitude() {
        let summary = ErrorStatistics::from_residuals(&[3.0, f64::NAN, -4.0]).expect("two values");
        assert!((summary.rms - 12.5_f64.sqrt()).abs() < 1e-15);
        assert_eq!(summary.max_abs, 4.0);
        assert_eq!(ErrorStatistics::from_residuals(&[f64::NAN]), None);
    }
}
