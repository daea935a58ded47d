//! Means over pieces of a column behind a first-order lag, for any time constant, without stepping
//! through the rows again.
//!
//! Through a piece a lag is linear in the value s that it begins with and in the column x. With
//! ε = −1/τ both parts are power series in ε, because each step is
//!
//! ```text
//! s ← φ·s + (1 − φ)·x      φ = e^(ε·Δt) = 1 + ε·Δt + (ε·Δt)²/2! + …
//! ```
//!
//! Their coefficients hold for every τ, and are worked out once a column. A piece that is long next to
//! τ is stepped row by row.

use std::sync::Arc;

use super::{lag_filter::LagInitialState, row_blocks::RowBlocks};

/// Coefficients of a series.
const POWER_SERIES_TERM_COUNT: usize = 8;
/// The longest piece whose series is believed, in time constants: the first omitted term is
/// 0.12⁸/8! = 10⁻¹² there.
const MAX_PIECE_TO_TIME_CONSTANT_RATIO: f64 = 0.12;

type PowerSeries = [f64; POWER_SERIES_TERM_COUNT];

/// Returns the value of a series at ε, whose powers are given.
fn evaluate_power_series(series: &PowerSeries, powers: &PowerSeries) -> f64 {
    series.iter().zip(powers).map(|(coefficient, power)| coefficient * power).sum()
}

/// ε⁰, ε¹, …
fn successive_powers(epsilon: f64) -> PowerSeries {
    std::array::from_fn(|n| epsilon.powi(n as i32))
}

/// δⁿ/n!
fn exponential_series(delta: f64) -> PowerSeries {
    let mut series = [1.0; POWER_SERIES_TERM_COUNT];
    for n in 1..POWER_SERIES_TERM_COUNT {
        series[n] = series[n - 1] * delta / n as f64;
    }
    series
}

fn add_series(sum: &mut PowerSeries, other: &PowerSeries) {
    sum.iter_mut().zip(other).for_each(|(sum, other)| *sum += other);
}

/// The pieces of a table and their times, shared by all its columns.
#[derive(Debug)]
pub(super) struct PieceTimes {
    pieces: Vec<TimedPiece>,
    /// From the row before to each row, in s; infinite where the lag begins anew.
    elapsed_s: Vec<f64>,
}

/// A piece, and the rows before it that are in none.
#[derive(Debug)]
struct TimedPiece {
    first: usize,
    last: usize,
    /// From its first row to its last, in s; infinite where a row between begins anew.
    span_s: f64,
    /// How much of the value at its first row is in the one at its last, and in the mean.
    kept: [PowerSeries; 2],
}

impl PieceTimes {
    /// None where a time is missing.
    pub(super) fn new(time_s: &[f64], restart: &[bool], blocks: &RowBlocks) -> Option<Self> {
        if time_s.iter().any(|time| time.is_nan()) {
            return None;
        }
        let since = |row: usize| match row {
            _ if restart[row] => f64::INFINITY,
            _ => (time_s[row] - time_s[row - 1]).max(0.0),
        };
        let elapsed_s: Vec<f64> = (0..time_s.len()).map(since).collect();
        let mut first = 0;
        let mut pieces = Vec::with_capacity(blocks.len());
        for rows in blocks.rows_by_block() {
            let last = rows[rows.len() - 1] as usize;
            let (mut span_s, mut mean) = (0.0, [0.0; POWER_SERIES_TERM_COUNT]);
            let mut used = rows.iter().peekable();
            for (row, elapsed_s) in (first..).zip(&elapsed_s[first..=last]) {
                if row > first {
                    span_s += elapsed_s;
                }
                if used.next_if(|used| **used as usize == row).is_some() {
                    add_series(&mut mean, &exponential_series(span_s));
                }
            }
            mean.iter_mut().for_each(|mean| *mean /= rows.len() as f64);
            let kept = [exponential_series(span_s), mean];
            pieces.push(TimedPiece { first, last, span_s, kept });
            first = last + 1;
        }
        Some(Self { pieces, elapsed_s })
    }
}

/// One column's lags.
#[derive(Debug)]
pub(super) struct LagPowerSeries {
    clock: Arc<PieceTimes>,
    /// The column's contribution to the value at the last row of each piece, and to the mean.
    added: Vec<[PowerSeries; 2]>,
}

impl LagPowerSeries {
    /// Returns the pieces that it is of.
    pub(super) fn piece_times(&self) -> &Arc<PieceTimes> {
        &self.clock
    }

    /// None where a value is missing.
    pub(super) fn new(clock: &Arc<PieceTimes>, values: &[f64], blocks: &RowBlocks) -> Option<Self> {
        if values.iter().any(|value| value.is_nan()) {
            return None;
        }
        let of = |(piece, rows): (&TimedPiece, &[u32])| {
            let (mut here, mut mean) =
                ([0.0; POWER_SERIES_TERM_COUNT], [0.0; POWER_SERIES_TERM_COUNT]);
            let mut used = rows.iter().peekable();
            for (row, &value) in (piece.first..).zip(&values[piece.first..=piece.last]) {
                if row > piece.first {
                    step_lag_series(&mut here, value, &exponential_series(clock.elapsed_s[row]));
                }
                if used.next_if(|used| **used as usize == row).is_some() {
                    add_series(&mut mean, &here);
                }
            }
            mean.iter_mut().for_each(|mean| *mean /= rows.len() as f64);
            [here, mean]
        };
        let added = clock.pieces.iter().zip(blocks.rows_by_block()).map(of).collect();
        Some(Self { clock: clock.clone(), added })
    }

    /// Returns the mean in each piece of `values`, those of [`new`](Self::new), behind a lag of `tau_s`, above 0.
    pub(super) fn lagged_means(
        &self,
        values: &[f64],
        blocks: &RowBlocks,
        tau_s: f64,
        start: LagInitialState,
    ) -> Vec<f64> {
        let powers = successive_powers(-1.0 / tau_s);
        let PieceTimes { pieces, elapsed_s } = &*self.clock;
        let (mut known_s, mut share) = (f64::NAN, 0.0);
        // Most rows are as far apart as the rows before them, but for the rounding of their times.
        let mut settle = |before: f64, row: usize| {
            if elapsed_s[row].is_infinite() {
                return start.initial_value(values[row]);
            }
            if known_s.is_nan() || (elapsed_s[row] - known_s).abs() > 1e-9 * known_s {
                known_s = elapsed_s[row];
                share = -(-known_s / tau_s).exp_m1();
            }
            before + (values[row] - before) * share
        };
        let mut here = f64::NAN;
        let each = pieces.iter().zip(&self.added).zip(blocks.rows_by_block());
        each.map(|((piece, [added_last, added_mean]), rows)| {
            here = settle(here, piece.first);
            if piece.span_s <= MAX_PIECE_TO_TIME_CONSTANT_RATIO * tau_s {
                let [kept_last, kept_mean] = &piece.kept;
                let mean = here * evaluate_power_series(kept_mean, &powers)
                    + evaluate_power_series(added_mean, &powers);
                here = here * evaluate_power_series(kept_last, &powers)
                    + evaluate_power_series(added_last, &powers);
                return mean;
            }
            let mut sum = 0.0;
            for (number, row) in (piece.first..=piece.last).enumerate() {
                if number > 0 {
                    here = settle(here, row);
                }
                if rows.binary_search(&(row as u32)).is_ok() {
                    sum += here;
                }
            }
            sum / rows.len() as f64
        })
        .collect()
    }
}

/// One step of a lag, as a series.
fn step_lag_series(here: &mut PowerSeries, value: f64, decay: &PowerSeries) {
    for n in (1..POWER_SERIES_TERM_COUNT).rev() {
        let kept: f64 = (0..=n).map(|m| here[m] * decay[n - m]).sum();
        here[n] = kept - value * decay[n];
    }
}

#[cfg(test)]
mod tests {
    use super::{super::lag_filter::apply_lag, *};

    #[test]
    fn means_by_series_are_those_of_the_rows_stepped_through() {
        // Uneven times, rows that do not count, a pause, and a second series.
        let count = 3000;
        let mut now_s = 0.0;
        let mut restart = vec![false; count];
        let time_s: Vec<f64> = (0..count)
            .map(|row| {
                now_s += 1.0 + 0.5 * ((row * row) as f64).sin();
                if row == 1200 {
                    now_s += 5000.0;
                }
                if row == 2111 {
                    now_s = 3.0;
                }
                now_s
            })
            .collect();
        (restart[0], restart[2111]) = (true, true);
        let column = |row: usize| 20.0 + (row as f64 / 300.0).sin() + 0.3 * (row as f64).cos();
        let values: Vec<f64> = (0..count).map(column).collect();
        let counts = |row: &usize| row % 17 != 3 && !(400..470).contains(row);
        let blocks = RowBlocks::new((0..count).filter(counts), |row| row % 60 == 0 || row == 2111);
        let clock = Arc::new(PieceTimes::new(&time_s, &restart, &blocks).expect("all times"));
        let series = LagPowerSeries::new(&clock, &values, &blocks).expect("all values");
        let starts = [LagInitialState::Settled, LagInitialState::Cold];
        for (tau_s, start) in
            [0.3, 20.0, 600.0, 900.0, 1e5].into_iter().flat_map(|s| starts.map(|start| (s, start)))
        {
            let stepped = blocks.means(&apply_lag(&values, &time_s, &restart, [tau_s; 2], start));
            let worst = series
                .lagged_means(&values, &blocks, tau_s, start)
                .iter()
                .zip(&stepped)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max);
            println!("{tau_s} s: {worst:.1e}");
            assert!(worst < 1e-10, "{tau_s} s: {worst}");
        }
    }

    #[test]
    fn a_gap_in_the_column_has_no_series() {
        let blocks = RowBlocks::new(0..4, |row| row % 2 == 0);
        let restart = [true, false, false, false];
        let clock = PieceTimes::new(&[0.0, 1.0, 2.0, 3.0], &restart, &blocks).expect("all times");
        assert!(
            LagPowerSeries::new(&Arc::new(clock), &[1.0, f64::NAN, 1.0, 1.0], &blocks).is_none()
        );
        assert!(PieceTimes::new(&[0.0, f64::NAN, 2.0, 3.0], &restart, &blocks).is_none());
    }
}
