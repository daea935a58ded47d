//! The laws of `docs/physics.md` that a believed machine states, written for this crate alone.

use std::f64::consts::TAU;

/// y of a first-order lag behind each x: y ← x + (y − x)·e^(−Δt/τ), settled at the first row.
/// While it falls (x below y) the time constant is `falling_s`.
pub(super) fn apply_first_order_lag(
    time_s: &[f64],
    x: &[f64],
    rising_s: f64,
    falling_s: f64,
) -> Vec<f64> {
    let mut y = x.first().copied().unwrap_or(0.0);
    let mut before_s = time_s.first().copied().unwrap_or(0.0);
    let mut all = Vec::with_capacity(x.len());
    for (&now_s, &x) in time_s.iter().zip(x) {
        let tau_s = if x < y { falling_s } else { rising_s };
        if tau_s > 0.0 {
            y = x + (y - x) * (-(now_s - before_s) / tau_s).exp();
        } else {
            y = x;
        }
        before_s = now_s;
        all.push(y);
    }
    all
}

/// The warm-up of a spindle, as a machine file states it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WarmupLaw {
    pub lag_s: f64,
    pub warm_s: f64,
    pub max_um: f64,
    pub exponent: f64,
    /// `None`: as it heats.
    pub cool_s: Option<f64>,
}

impl WarmupLaw {
    /// (t₂ − t₁)/k.
    pub(crate) fn heating_time_constant_s(&self) -> f64 {
        (self.warm_s - self.lag_s) / self.exponent
    }

    /// Returns the growth in each row, from cold: h heats towards 1 once the spindle has run for t₁, else
    /// cools towards 0, and s = Smax·min(1, h/(1 − e^(−k))).
    pub fn growth_um(&self, time_s: &[f64], rpm: &[f64]) -> Vec<f64> {
        let full = 1.0 - (-self.exponent).exp();
        let heating_s = self.heating_time_constant_s();
        let h = warmup_heat_fraction(
            time_s,
            rpm,
            self.lag_s,
            heating_s,
            self.cool_s.unwrap_or(heating_s),
        );
        h.into_iter().map(|h| self.max_um * (h / full).min(1.0)).collect()
    }
}

/// h of the warm-up in each row, the row's speed holding since the row before.
pub(super) fn warmup_heat_fraction(
    time_s: &[f64],
    rpm: &[f64],
    lag_s: f64,
    heating_s: f64,
    cool_s: f64,
) -> Vec<f64> {
    let (mut h, mut ran_s) = (0.0_f64, 0.0_f64);
    let mut before_s = time_s.first().copied().unwrap_or(0.0);
    let mut all = Vec::with_capacity(rpm.len());
    for (&now_s, &rpm) in time_s.iter().zip(rpm) {
        let passed_s = now_s - before_s;
        before_s = now_s;
        if rpm == 0.0 {
            ran_s = 0.0;
            h *= (-passed_s / cool_s).exp();
        } else {
            let waiting_s = (lag_s - ran_s).max(0.0).min(passed_s);
            h *= (-waiting_s / cool_s).exp();
            h = 1.0 - (1.0 - h) * (-(passed_s - waiting_s) / heating_s).exp();
            ran_s += passed_s;
        }
        all.push(h);
    }
    all
}

/// Returns a table over equal steps, straight between its points, held outside.
pub(super) fn interpolate_uniform_table(start: f64, step: f64, values: &[f64], at: f64) -> f64 {
    let place = ((at - start) / step).clamp(0.0, (values.len() - 1) as f64);
    let low = (place as usize).min(values.len().saturating_sub(2));
    let high = (low + 1).min(values.len() - 1);
    values[low] + (values[high] - values[low]) * (place - low as f64)
}

/// Returns a table of pairs (at, value), straight between, held outside.
pub(super) fn interpolate_pairs(pairs: &[(f64, f64)], at: f64) -> f64 {
    let above = pairs.iter().position(|&(there, _)| there > at).unwrap_or(pairs.len());
    match (above.checked_sub(1), pairs.get(above)) {
        (None, Some(&(_, value))) => value,
        (Some(below), None) => pairs[below].1,
        (Some(below), Some(&(end, to))) => {
            let (begin, from) = pairs[below];
            from + (to - from) * (at - begin) / (end - begin)
        }
        (None, None) => 0.0,
    }
}

/// Returns the knots of a clamped cubic B-spline with equal spans from `low` to `high`.
pub(super) fn clamped_uniform_knots(low: f64, high: f64, controls: usize) -> Vec<f64> {
    let spans = controls - 3;
    let inner = (1..spans).map(|i| low + (high - low) * i as f64 / spans as f64);
    let mut knots = vec![low; 4];
    knots.extend(inner);
    knots.extend([high; 4]);
    knots
}

/// Returns a cubic B-spline as the sum of its basis functions, each by the recurrence of Cox and de Boor.
pub(super) fn evaluate_spline(knots: &[f64], controls: &[f64], at: f64) -> f64 {
    let last = knots[knots.len() - 1];
    // The basis is 0 at the very end, where the last control point alone counts.
    if at >= last {
        return controls[controls.len() - 1];
    }
    let at = at.max(knots[0]);
    controls
        .iter()
        .enumerate()
        .map(|(i, control)| control * evaluate_basis_function(knots, i, 3, at))
        .sum()
}

fn evaluate_basis_function(knots: &[f64], i: usize, degree: usize, at: f64) -> f64 {
    if degree == 0 {
        return if knots[i] <= at && at < knots[i + 1] { 1.0 } else { 0.0 };
    }
    let rise = knots[i + degree] - knots[i];
    let fall = knots[i + degree + 1] - knots[i + 1];
    let mut sum = 0.0;
    if rise > 0.0 {
        sum += (at - knots[i]) / rise * evaluate_basis_function(knots, i, degree - 1, at);
    }
    if fall > 0.0 {
        sum += (knots[i + degree + 1] - at) / fall
            * evaluate_basis_function(knots, i + 1, degree - 1, at);
    }
    sum
}

/// a·sin(2π·turns + φ).
pub(super) fn sinusoid(turns: f64, phase_rad: f64) -> f64 {
    (TAU * turns + phase_rad).sin()
}

/// Level at 0 and slope of the best straight line of `y` over `x`.
pub(super) fn fit_line(x: &[f64], y: &[f64]) -> (f64, f64) {
    let count = x.len() as f64;
    let (mean_x, mean_y) = (x.iter().sum::<f64>() / count, y.iter().sum::<f64>() / count);
    let both: f64 = x.iter().zip(y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    let square: f64 = x.iter().map(|x| (x - mean_x) * (x - mean_x)).sum();
    let slope = if square > 0.0 { both / square } else { 0.0 };
    (mean_y - slope * mean_x, slope)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lag_has_risen_by_all_but_one_eth_after_its_time_constant_and_falls_with_its_own() {
        let y = apply_first_order_lag(&[0.0, 100.0, 150.0], &[20.0, 30.0, 20.0], 100.0, 50.0);
        let e = std::f64::consts::E;
        assert!((y[1] - (30.0 - 10.0 / e)).abs() < 1e-12);
        assert!((y[2] - (20.0 + (10.0 - 10.0 / e) / e)).abs() < 1e-12);
    }

    /// u = 1/2 and k = 2·ln 2: (1 − 1/2)/(1 − 1/4) of 90 µm.
    #[test]
    fn the_warm_up_is_its_closed_form() {
        let exponent = 2.0 * 2_f64.ln();
        let law =
            WarmupLaw { lag_s: 60.0, warm_s: 5460.0, max_um: 90.0, exponent, cool_s: Some(700.0) };
        let grown = law.growth_um(&[0.0, 60.0, 2760.0, 6000.0, 6700.0], &[9e3, 9e3, 9e3, 9e3, 0.0]);
        for (grown, expected) in grown.iter().zip([0.0, 0.0, 60.0, 90.0]) {
            assert!((grown - expected).abs() < 1e-9, "{grown} is not {expected}");
        }
        // h itself went on rising above what counts as warm, and cools from there.
        let h = 1.0 - 2_f64.powf(-2.0 * 5940.0 / 5400.0);
        assert!((grown[4] - 90.0 * h / 0.75 * (-1_f64).exp()).abs() < 1e-9);
    }

    #[test]
    fn a_cubic_is_its_own_spline() {
        // One span: Bernstein's polynomials, at the middle (1·0 + 3·8 + 3·8 + 1·0)/8.
        assert!(
            (evaluate_spline(&clamped_uniform_knots(0.0, 10.0, 4), &[0.0, 8.0, 8.0, 0.0], 5.0)
                - 6.0)
                .abs()
                < 1e-12
        );
        // A straight line has its control points on itself, at the means of three knots.
        let knots = clamped_uniform_knots(-4.0, 8.0, 7);
        let line: Vec<f64> =
            (0..7).map(|i| knots[i + 1..i + 4].iter().sum::<f64>() / 3.0).collect();
        for at in [-4.0, -3.3, 0.1, 4.0, 7.9, 8.0] {
            assert!((evaluate_spline(&knots, &line, at) - at).abs() < 1e-12);
        }
    }

    #[test]
    fn tables_are_straight_between_and_held_outside() {
        for (at, value) in [(-5.0, 1.0), (0.0, 1.0), (15.0, 4.0), (20.0, 5.0), (99.0, 5.0)] {
            assert_eq!(interpolate_uniform_table(0.0, 10.0, &[1.0, 3.0, 5.0], at), value);
            assert_eq!(interpolate_pairs(&[(0.0, 1.0), (20.0, 5.0)], at), value);
        }
    }
}
