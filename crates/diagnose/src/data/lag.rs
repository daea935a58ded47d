//! Columns that follow from others row by row: gaps filled, values behind a first-order lag.

/// With the value before in place of a missing one; at the start, the next one.
pub(crate) fn filled(values: &[f64]) -> Vec<f64> {
    let mut last = first_of(values);
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

/// The first value that is there; 0 where none is.
pub(crate) fn first_of(values: &[f64]) -> f64 {
    values.iter().copied().find(|value| !value.is_nan()).unwrap_or(0.0)
}

/// `values` behind a first-order lag, whose time constants in s are for its rise and for its fall, as
/// `trueup_machine::model::Lag` steps it; anew at each `restart`; missing values hold.
pub(super) fn lag(
    values: &[f64],
    time_s: &[f64],
    restart: &[bool],
    [rise_s, fall_s]: [f64; 2],
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
    for row in 0..values.len() {
        if restart[row] {
            (settled, before_s) = (None, f64::NAN);
        }
        let (value, now_s) = (values[row], time_s[row]);
        if !value.is_nan() && !now_s.is_nan() {
            let before = settled.unwrap_or(value);
            let elapsed = if before_s.is_nan() { 0.0 } else { (now_s - before_s).max(0.0) };
            before_s = now_s;
            if last_elapsed.is_nan() || (elapsed - last_elapsed).abs() > 1e-9 * elapsed {
                last_elapsed = elapsed;
                last_shares = [share(elapsed, rise_s); 2];
                if !is_one {
                    last_shares[1] = share(elapsed, fall_s);
                }
            }
            let share = if is_one || value >= before { last_shares[0] } else { last_shares[1] };
            settled = Some(before + (value - before) * share);
        }
        out.push(settled.unwrap_or(f64::NAN));
    }
    if out.iter().any(|value| value.is_nan()) { filled(&out) } else { out }
}

/// `values` smoothed over `width_s` without being late: behind a lag of half of it in time, of that
/// behind one against time.
pub(super) fn smoothed(values: &[f64], time_s: &[f64], restart: &[bool], width_s: f64) -> Vec<f64> {
    let reversed = |list: &[f64]| list.iter().rev().copied().collect::<Vec<f64>>();
    let against_s: Vec<f64> = time_s.iter().rev().map(|time_s| -time_s).collect();
    // Against time a series begins where it ends.
    let ends: Vec<bool> =
        (0..values.len()).rev().map(|row| restart.get(row + 1).copied().unwrap_or(true)).collect();
    let lags_s = [0.5 * width_s; 2];
    let against = lag(&reversed(values), &against_s, &ends, lags_s);
    lag(&reversed(&against), time_s, restart, lags_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoothing_takes_noise_away_and_is_not_late() {
        let rows = 400;
        let time_s: Vec<f64> = (0..rows).map(f64::from).collect();
        let restart: Vec<bool> = (0..rows).map(|row| row % 200 == 0).collect();
        // A slope with a reading up and one down, twice.
        let noise = |row: i32| if row % 2 == 0 { 1.0 } else { -1.0 };
        let slope = |row: i32| 0.1 * f64::from(row % 200);
        let values: Vec<f64> = (0..rows).map(|row| slope(row) + noise(row)).collect();
        let smooth = smoothed(&values, &time_s, &restart, 20.0);
        let late = lag(&values, &time_s, &restart, [20.0; 2]);
        for row in [100, 300] {
            let [smooth, late] = [&smooth, &late].map(|list| list[row as usize] - slope(row));
            assert!(smooth.abs() < 0.05, "{smooth}");
            assert!((late + 2.0).abs() < 0.1, "{late}");
        }
    }
}
