//! Columns that follow from others row by row: gaps filled, values behind a first-order lag.

/// With the value before in place of a missing one; at the start, the next one.
pub(crate) fn forward_fill(values: &[f64]) -> Vec<f64> {
    let mut last = first_finite_or_zero(values);
    values
        .iter()
        .map(|&value| {
            if !value.is_nan() {
                last = value;
            }
            last
        })
        .collect()
}

/// Returns the first value that is there; 0 where none is.
pub(crate) fn first_finite_or_zero(values: &[f64]) -> f64 {
    values.iter().copied().find(|value| !value.is_nan()).unwrap_or(0.0)
}

/// Where a lag begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LagInitialState {
    /// At its first value: a temperature.
    Settled,
    /// At 0: heat of a spindle that was cold.
    Cold,
}

impl LagInitialState {
    /// Returns what the lag is at its first value.
    pub(super) fn initial_value(self, value: f64) -> f64 {
        match self {
            Self::Settled => value,
            Self::Cold => 0.0,
        }
    }
}

/// `values` behind a first-order lag, whose time constants in s are for its rise and for its fall, as
/// `trueup_machine::model::Lag` steps it; anew at each `restart`, from `start` on; missing values hold.
pub(super) fn apply_lag(
    values: &[f64],
    time_s: &[f64],
    restart: &[bool],
    [rise_s, fall_s]: [f64; 2],
    start: LagInitialState,
) -> Vec<f64> {
    let mut out = Vec::with_capacity(values.len());
    let mut settled: Option<f64> = None;
    let mut before_s = f64::NAN;
    // Most rows are as far apart as the rows before them, but for the rounding of their times.
    let (mut last_elapsed, mut last_shares) = (f64::NAN, [1.0; 2]);
    let share = |elapsed: f64, lag_s: f64| {
        if lag_s == 0.0 { 1.0 } else { -(-elapsed / lag_s).exp_m1() }
    };
    // Which way it goes from row to row is noise, and not asked where it does not matter.
    let is_one = rise_s == fall_s;
    let (mut row, mut first) = (0, 0.0);
    let mut even = UniformlySampledLag::new(0.0);
    while row < values.len() {
        if let Some(before) = settled.filter(|_| row > 0 && before_s == time_s[row - 1])
            && let Some(next) = next_uniform_block(values, time_s, restart, row, last_elapsed)
        {
            let next = if is_one {
                even.filter_block(next, first, before)
            } else {
                filter_block_asymmetric(next, before, last_shares)
            };
            out.extend_from_slice(&next);
            row += LAG_BLOCK_ROWS;
            (settled, before_s) = (Some(next[LAG_BLOCK_ROWS - 1]), time_s[row - 1]);
            continue;
        }
        if restart[row] {
            (settled, before_s) = (None, f64::NAN);
        }
        let (value, now_s) = (values[row], time_s[row]);
        if !value.is_nan() && !now_s.is_nan() {
            let before = settled.unwrap_or_else(|| {
                first = value;
                start.initial_value(value)
            });
            let elapsed = if before_s.is_nan() { 0.0 } else { (now_s - before_s).max(0.0) };
            before_s = now_s;
            if last_elapsed.is_nan() || (elapsed - last_elapsed).abs() > 1e-9 * elapsed {
                last_elapsed = elapsed;
                last_shares = [share(elapsed, rise_s); 2];
                if is_one {
                    even = UniformlySampledLag::new(last_shares[0]);
                } else {
                    last_shares[1] = share(elapsed, fall_s);
                }
            }
            let share = if is_one || value >= before { last_shares[0] } else { last_shares[1] };
            settled = Some(before + (value - before) * share);
        }
        out.push(settled.unwrap_or(f64::NAN));
        row += 1;
    }
    if out.iter().any(|value| value.is_nan()) { forward_fill(&out) } else { out }
}

/// Rows that a lag is stepped through at once where they are equally far apart: one after the other each waits for
/// the one before.
const LAG_BLOCK_ROWS: usize = 8;

/// A lag through rows that are equally far apart: with the share s of the way in one step and φ = 1 − s
///
/// ```text
/// y(k) = φ^(k+1)·y + Σ φ^(k−j)·s·x(j)       j = 0…k
/// ```
///
/// of which the sum does not wait for y. Both from the first value on, so that what stays stays to the bit.
struct UniformlySampledLag {
    share: f64,
    /// φ, φ²…
    kept: [f64; LAG_BLOCK_ROWS],
}

impl UniformlySampledLag {
    fn new(share: f64) -> Self {
        let mut power = 1.0;
        let kept = std::array::from_fn(|_| {
            power *= 1.0 - share;
            power
        });
        Self { share, kept }
    }

    /// Returns the `next` values behind the lag, which is at `before`; `first` is near all of them.
    fn filter_block(
        &self,
        next: &[f64; LAG_BLOCK_ROWS],
        first: f64,
        before: f64,
    ) -> [f64; LAG_BLOCK_ROWS] {
        let Self { share, kept } = self;
        let ahead = before - first;
        let mut sum = 0.0;
        std::array::from_fn(|n| {
            sum = kept[0] * sum + share * (next[n] - first);
            sum + kept[n] * ahead + first
        })
    }
}

/// Returns the `next` values behind a lag that is at `before`, with a share of the way for its rise and one for its
/// fall: of both steps the upper one where the rise is the faster one, else the lower one.
fn filter_block_asymmetric(
    next: &[f64; LAG_BLOCK_ROWS],
    before: f64,
    [rise, fall]: [f64; 2],
) -> [f64; LAG_BLOCK_ROWS] {
    let mut here = before;
    let mut step = |value: f64, one: fn(f64, f64) -> f64| {
        let apart = value - here;
        here += one(apart * rise, apart * fall);
        here
    };
    if rise >= fall {
        next.map(|value| step(value, f64::max))
    } else {
        next.map(|value| step(value, f64::min))
    }
}

/// Returns the next values from `row` on, above 0, if each follows `elapsed` after the one before it and none is
/// missing.
fn next_uniform_block<'v>(
    values: &'v [f64],
    time_s: &[f64],
    restart: &[bool],
    row: usize,
    elapsed: f64,
) -> Option<&'v [f64; LAG_BLOCK_ROWS]> {
    let next = values.get(row..)?.first_chunk::<LAG_BLOCK_ROWS>()?;
    let now_s = time_s.get(row..)?.first_chunk::<LAG_BLOCK_ROWS>()?;
    let before_s = time_s.get(row - 1..)?.first_chunk::<LAG_BLOCK_ROWS>()?;
    let restart = restart.get(row..)?.first_chunk::<LAG_BLOCK_ROWS>()?;
    let near = 1e-9 * elapsed;
    let mut are_even = true;
    for n in 0..LAG_BLOCK_ROWS {
        are_even &= (now_s[n] - before_s[n] - elapsed).abs() <= near;
    }
    let is_none_missing = !next.iter().sum::<f64>().is_nan();
    (are_even && is_none_missing && !restart.contains(&true)).then_some(next)
}

/// `values` smoothed over `width_s` without being late: behind a lag of half of it in time, of that
/// behind one against time.
pub(super) fn smooth_zero_phase(
    values: &[f64],
    time_s: &[f64],
    restart: &[bool],
    width_s: f64,
) -> Vec<f64> {
    let reversed = |list: &[f64]| list.iter().rev().copied().collect::<Vec<f64>>();
    let against_s: Vec<f64> = time_s.iter().rev().map(|time_s| -time_s).collect();
    // Against time a series begins where it ends.
    let ends: Vec<bool> =
        (0..values.len()).rev().map(|row| restart.get(row + 1).copied().unwrap_or(true)).collect();
    let lags_s = [0.5 * width_s; 2];
    let settled = LagInitialState::Settled;
    let against = apply_lag(&reversed(values), &against_s, &ends, lags_s, settled);
    apply_lag(&reversed(&against), time_s, restart, lags_s, settled)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_at_equal_steps_are_behind_by_as_much_as_one_by_one() {
        // A pause, a second series, a missing value and a time that comes late among them.
        let rows = 1000;
        let mut time_s: Vec<f64> = (0..rows).map(|row| 0.1 * row as f64).collect();
        time_s[300..].iter_mut().for_each(|t| *t += 50.0);
        time_s[700] += 0.03;
        let restart: Vec<bool> = (0..rows).map(|row| row == 0 || row == 501).collect();
        let mut values: Vec<f64> = (0..rows).map(|row| 20.0 + (0.3 * row as f64).sin()).collect();
        values[90] = f64::NAN;
        let all = [[0.0; 2], [0.02; 2], [3.0; 2], [1e5; 2], [3.0, 9.0], [9.0, 3.0], [3.0, 0.0]];
        let starts = [LagInitialState::Settled, LagInitialState::Cold];
        for (lags_s, start) in all.into_iter().flat_map(|s| starts.map(|start| (s, start))) {
            let found = apply_lag(&values, &time_s, &restart, lags_s, start);
            let (mut here, mut before) = (f64::NAN, f64::NAN);
            for row in 0..rows {
                if restart[row] {
                    let is_late = lags_s != [0.0; 2];
                    here = if is_late { start.initial_value(values[row]) } else { values[row] };
                    before = time_s[row];
                } else if !values[row].is_nan() {
                    let lag_s = lags_s[usize::from(values[row] < here)];
                    let kept =
                        if lag_s > 0.0 { (-(time_s[row] - before) / lag_s).exp() } else { 0.0 };
                    (here, before) = (values[row] + (here - values[row]) * kept, time_s[row]);
                }
                assert!((found[row] - here).abs() < 1e-11, "{lags_s:?} s, {start:?}, row {row}");
            }
        }
        let still =
            apply_lag(&vec![21.7; rows], &time_s, &restart, [3.0; 2], LagInitialState::Settled);
        assert!(still.iter().all(|&value| value == 21.7));
    }

    #[test]
    fn smoothing_takes_noise_away_and_is_not_late() {
        let rows = 400;
        let time_s: Vec<f64> = (0..rows).map(f64::from).collect();
        let restart: Vec<bool> = (0..rows).map(|row| row % 200 == 0).collect();
        // A slope with a reading up and one down, twice.
        let noise = |row: i32| if row % 2 == 0 { 1.0 } else { -1.0 };
        let slope = |row: i32| 0.1 * f64::from(row % 200);
        let values: Vec<f64> = (0..rows).map(|row| slope(row) + noise(row)).collect();
        let smooth = smooth_zero_phase(&values, &time_s, &restart, 20.0);
        let late = apply_lag(&values, &time_s, &restart, [20.0; 2], LagInitialState::Settled);
        for row in [100, 300] {
            let [smooth, late] = [&smooth, &late].map(|list| list[row as usize] - slope(row));
            assert!(smooth.abs() < 0.05, "{smooth}");
            assert!((late + 2.0).abs() < 0.1, "{late}");
        }
    }
}
