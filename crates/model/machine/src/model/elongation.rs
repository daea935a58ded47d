//! How far the tool has grown out of the spindle, by each of the three models, in `f64`.
//!
//! By the displacement sensor (Shi, Gao and Mao, section 2.2.2):
//!
//! ```text
//! ΔK = K₀ + (V − V₀)·tanβ
//! ```
//!
//! By the time that the spindle has run, of a machine without a sensor (`docs/physics.md` section 2).
//! From cold and at constant speed:
//!
//! ```text
//! s = 0                                   t < t₁
//! s = Smax·(1 − e^(−k·u))/(1 − e^(−k))    u = (t − t₁)/(t₂ − t₁), t₁ ≤ t ≤ t₂
//! s = Smax                                after t₂
//! ```
//!
//! A spindle also stops and changes its speed, so that what is kept is a state h, from 0 (cold):
//!
//! ```text
//! heated   h ← i + (h − i)·e^(−Δt/τ)      τ = (t₂ − t₁)/k, i = (n/n_rated)^p
//! else     h ← h·e^(−Δt/τ_cool)
//! s = Smax·min(1, h/(1 − e^(−k)))
//! ```
//!
//! It is heated once the spindle has run for t₁ without a break. At constant speed h is
//! 1 − e^(−(t − t₁)/τ), which makes s the closed form above: measured within 2·10⁻¹³ µm, for rows
//! from 0.37 s to 9000 s apart.
//!
//! By a temperature: s = k·(T − T₀).

use super::lag::RowTimer;
use crate::sections::{SensorModel, TemperatureModel, Warmup};

/// Returns the elongation in µm that the sensor's law gives for `sensor_counts`; NaN for a missing count.
///
/// ```
/// use trueup_machine::{machine_file::SensorModel, model::elongation_um};
/// let paper = SensorModel {
///     k0_um: 0.0, zero_counts: 5048.0, um_per_count: 500.0 / 32768.0, temperature: None,
/// };
/// // (9164 − 5048) · 500/32768 = 4116 · 0.0152587890625
/// assert_eq!(elongation_um(&paper, 9164.0), 62.80517578125);
/// ```
#[must_use]
pub fn elongation_um(sensor: &SensorModel, sensor_counts: f64) -> f64 {
    sensor.k0_um + (sensor_counts - sensor.zero_counts) * sensor.um_per_count
}

/// Returns the sensor's law the other way round: the counts at an elongation in µm; NaN for a missing one.
///
/// It is the inverse whatever [`SensorModel::temperature`] names: that is the column which a
/// diagnosis looks at, and no part of the law.
///
/// ```
/// use trueup_machine::{machine_file::SensorModel, model::sensor_counts_from_elongation};
/// let paper = SensorModel {
///     k0_um: 3.0, zero_counts: 5048.0, um_per_count: 500.0 / 32768.0, temperature: None,
/// };
/// // 5048 + (65.80517578125 − 3)/0.0152587890625 = 5048 + 4116
/// assert_eq!(sensor_counts_from_elongation(&paper, 65.80517578125), 9164.0);
/// ```
#[must_use]
pub fn sensor_counts_from_elongation(sensor: &SensorModel, elongation_um: f64) -> f64 {
    sensor.zero_counts + (elongation_um - sensor.k0_um) / sensor.um_per_count
}

/// Returns the elongation in µm at `temperature_c`, which has passed the model's lag already; NaN for a
/// missing temperature.
///
/// ```
/// use trueup_machine::{machine_file::TemperatureModel, model::temperature_elongation_um};
/// let model = TemperatureModel {
///     sensor: "temp_front_c".into(), reference_c: 20.0, k_um_per_c: 2.0, lag_s: 0.0,
/// };
/// assert_eq!(temperature_elongation_um(&model, 25.5), 11.0);
/// ```
#[must_use]
pub fn temperature_elongation_um(model: &TemperatureModel, temperature_c: f64) -> f64 {
    model.k_um_per_c * (temperature_c - model.reference_c)
}

/// Returns the closed form of the warm-up: the elongation in µm, `time_s` after a start from cold at the
/// speed for which `max_um` holds.
///
/// ```
/// use trueup_machine::{machine_file::Warmup, model::warmup_elongation_um};
/// let model = Warmup {
///     lag_s: 60.0, warm_s: 5460.0, max_um: 80.0, exponent: 2.0 * 2_f64.ln(),
///     cool_s: None, rated_rpm: None, speed_exponent: 0.0,
/// };
/// assert_eq!(warmup_elongation_um(&model, 60.0), 0.0);
/// // Half the way in time, e^(−k/2) = 1/2 and e^(−k) = 1/4: 80 · (1/2)/(3/4)
/// assert!((warmup_elongation_um(&model, 2760.0) - 53.333_333).abs() < 1e-6);
/// assert_eq!(warmup_elongation_um(&model, 5460.0), 80.0);
/// ```
#[must_use]
pub fn warmup_elongation_um(model: &Warmup, time_s: f64) -> f64 {
    let share = (time_s - model.lag_s) / (model.warm_s - model.lag_s);
    model.max_um
        * (saturating_exponential(model, share.clamp(0.0, 1.0))
            / saturating_exponential(model, 1.0))
}

/// 1 − e^(−k·share), without the loss of digits that the subtraction would cost at a small k.
fn saturating_exponential(model: &Warmup, share: f64) -> f64 {
    -(-model.exponent * share).exp_m1()
}

/// Returns the input of the warm-up's state while heat reaches the spindle: (n/n_rated)^p, 1 at p = 0.
///
/// ```
/// use trueup_machine::{machine_file::Warmup, model::heat_input};
/// let model = Warmup {
///     lag_s: 60.0, warm_s: 5400.0, max_um: 80.0, exponent: 4.0,
///     cool_s: None, rated_rpm: Some(24_000.0), speed_exponent: 2.0,
/// };
/// assert_eq!(heat_input(&model, -12_000.0), 0.25);
/// ```
#[must_use]
pub fn heat_input(model: &Warmup, spindle_rpm: f64) -> f64 {
    match model.rated_rpm {
        Some(rated_rpm) if model.speed_exponent != 0.0 => {
            (spindle_rpm.abs() / rated_rpm).powf(model.speed_exponent)
        }
        _ => 1.0,
    }
}

/// The warm-up's state, from cold.
#[derive(Clone, Debug, Default)]
pub struct WarmupState {
    /// h: how warm the spindle is.
    heat: f64,
    /// How long it has run without a break, in s.
    running_s: f64,
    clock: RowTimer,
}

impl WarmupState {
    /// Returns the elongation in µm at `time_s`, the spindle having turned at `spindle_rpm` since the row
    /// before. NaN for a missing time or speed: such a row is passed over, and the next one's speed
    /// counts since the last row that had both.
    pub fn step(&mut self, model: &Warmup, time_s: f64, spindle_rpm: f64) -> f64 {
        if time_s.is_nan() || spindle_rpm.is_nan() {
            return f64::NAN;
        }
        let elapsed_s = self.clock.elapsed_s(time_s);
        if spindle_rpm == 0.0 {
            self.cool(model, elapsed_s);
            self.running_s = 0.0;
        } else {
            // What is left of t₁ at the start of the interval: no heat arrives until then.
            let unheated_s = (model.lag_s - self.running_s).clamp(0.0, elapsed_s);
            self.cool(model, unheated_s);
            let input = heat_input(model, spindle_rpm);
            let heated_s = elapsed_s - unheated_s;
            // h + (i − h)·(1 − e^(−Δt/τ))
            self.heat -= (input - self.heat) * (-heated_s / model.time_constant_s()).exp_m1();
            self.running_s += elapsed_s;
        }
        model.max_um * (self.heat / saturating_exponential(model, 1.0)).min(1.0)
    }

    fn cool(&mut self, model: &Warmup, seconds: f64) {
        self.heat *= (-seconds / model.cooling_time_constant_s()).exp();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paper() -> SensorModel {
        SensorModel {
            k0_um: 0.0,
            zero_counts: 5048.0,
            um_per_count: 500.0 / 32768.0,
            temperature: None,
        }
    }

    fn warmup() -> Warmup {
        Warmup {
            lag_s: 60.0,
            warm_s: 5400.0,
            max_um: 80.0,
            exponent: 4.0,
            cool_s: Some(2000.0),
            rated_rpm: Some(24_000.0),
            speed_exponent: 0.0,
        }
    }

    #[test]
    fn the_papers_readings_give_the_papers_micrometres() {
        // Counts are whole, so a value printed to 0.1 µm comes back within half a count.
        for (counts, um) in
            [(5048.0, 0.0), (5376.0, 5.0), (6359.0, 20.0), (8194.0, 48.0), (9164.0, 62.8)]
        {
            assert!((elongation_um(&paper(), counts) - um).abs() < 0.0077, "{counts} counts");
        }
        assert_eq!(elongation_um(&paper(), 9164.0), 62.805_175_781_25);
    }

    #[test]
    fn k0_is_the_elongation_at_the_zero_reading() {
        let shifted = SensorModel { k0_um: 3.25, ..paper() };
        assert_eq!(elongation_um(&shifted, 5048.0), 3.25);
    }

    #[test]
    fn a_reading_below_zero_is_a_spindle_that_has_shrunk() {
        assert_eq!(elongation_um(&paper(), 5048.0 - 64.0), -0.976_562_5);
    }

    /// Also where growth lowers the reading, and whatever temperature the sensor itself has.
    #[test]
    fn counts_come_back_from_the_elongation_that_they_give() {
        let falling = SensorModel {
            k0_um: -7.3,
            zero_counts: 20_011.0,
            um_per_count: -0.037,
            temperature: Some("temp_coil_c".into()),
        };
        let mut worst: f64 = 0.0;
        for sensor in [paper(), falling] {
            for counts in (0..=32_768).map(f64::from) {
                let back = sensor_counts_from_elongation(&sensor, elongation_um(&sensor, counts));
                worst = worst.max((back - counts).abs());
            }
        }
        println!("worst: {worst:e} counts");
        assert!(worst < 1e-9, "{worst:e} counts");
        assert_eq!(sensor_counts_from_elongation(&paper(), -0.976_562_5), 5048.0 - 64.0);
        assert!(sensor_counts_from_elongation(&paper(), f64::NAN).is_nan());
    }

    #[test]
    fn the_closed_form_is_continuous_at_both_ends() {
        let model = warmup();
        for time_s in [-1e9, 0.0, 59.999, 60.0] {
            assert_eq!(warmup_elongation_um(&model, time_s), 0.0, "{time_s} s");
        }
        assert!((0.0..1e-9).contains(&warmup_elongation_um(&model, 60.0 + 1e-9)));
        for time_s in [5400.0, 5401.0, 1e9] {
            assert_eq!(warmup_elongation_um(&model, time_s), 80.0, "{time_s} s");
        }
        assert!((80.0 - 1e-9..80.0).contains(&warmup_elongation_um(&model, 5400.0 - 1e-7)));
    }

    #[test]
    fn a_larger_exponent_rises_faster() {
        let quick = Warmup { exponent: 6.0, ..warmup() };
        assert!(warmup_elongation_um(&quick, 1000.0) > warmup_elongation_um(&warmup(), 1000.0));
        // As k → 0 it is a straight line: half way in time is half the growth.
        let straight = Warmup { exponent: 1e-9, ..warmup() };
        assert!((warmup_elongation_um(&straight, 2730.0) - 40.0).abs() < 1e-6);
    }

    /// Whatever the row spacing, also where t₁ and t₂ pass inside an interval.
    #[test]
    fn at_constant_speed_from_cold_the_state_is_the_closed_form_at_every_row() {
        let model = warmup();
        let mut worst: f64 = 0.0;
        for spacing_s in [0.37, 1.0, 7.0, 60.0, 100.0, 1000.0, 5399.0, 9000.0] {
            let mut state = WarmupState::default();
            for row in 0..(12_000.0 / spacing_s) as u32 {
                let since_start_s = f64::from(row) * spacing_s;
                let stepped = state.step(&model, 300.0 + since_start_s, 18_000.0);
                worst = worst.max((stepped - warmup_elongation_um(&model, since_start_s)).abs());
            }
        }
        println!("state against closed form: {worst:e} µm");
        assert!(worst < 1e-9, "{worst:e} µm");
    }

    #[test]
    fn a_spindle_that_stops_cools_and_its_next_start_waits_for_the_heat_again() {
        let model = warmup();
        let mut state = WarmupState::default();
        state.step(&model, 0.0, 0.0);
        // τ = 5340/4 = 1335 s. One τ after the lag: h = 1 − 1/e.
        let full = -(-4.0_f64).exp_m1();
        let warm = state.step(&model, 60.0 + 1335.0, 24_000.0);
        assert!((warm - 80.0 * (1.0 - (-1.0_f64).exp()) / full).abs() < 1e-9);
        // Stopped for τ_cool: 1/e of it is left.
        let cooled = state.step(&model, 60.0 + 1335.0 + 2000.0, 0.0);
        assert!((cooled - warm * (-1.0_f64).exp()).abs() < 1e-9);
        // Running again, but for less than the lag: it cools on.
        let lagging = state.step(&model, 60.0 + 1335.0 + 2000.0 + 40.0, 24_000.0);
        assert!((lagging - cooled * (-40.0_f64 / 2000.0).exp()).abs() < 1e-9);
        // 20 s until the lag has passed, then τ more.
        let rising = state.step(&model, 60.0 + 1335.0 + 2000.0 + 60.0 + 1335.0, 24_000.0);
        let before = cooled * (-60.0_f64 / 2000.0).exp();
        let expected = 80.0 / full + (before - 80.0 / full) * (-1.0_f64).exp();
        assert!((rising - expected).abs() < 1e-9);
    }

    #[test]
    fn the_heat_goes_with_the_power_of_the_speed_and_never_grows_beyond_the_most() {
        let model = Warmup { speed_exponent: 1.0, ..warmup() };
        for (rpm, most) in [(6_000.0, 20.0 / 0.981_684_361_1), (48_000.0, 80.0)] {
            let mut state = WarmupState::default();
            state.step(&model, 0.0, rpm);
            let settled = state.step(&model, 1e6, rpm);
            assert!((settled - most).abs() < 1e-6, "{rpm} r/min: {settled}");
        }
        assert_eq!(heat_input(&warmup(), 3.0), 1.0);
    }

    #[test]
    fn a_row_without_a_time_or_a_speed_is_passed_over() {
        let model = warmup();
        let (mut whole, mut broken) = (WarmupState::default(), WarmupState::default());
        whole.step(&model, 0.0, 9000.0);
        broken.step(&model, 0.0, 9000.0);
        assert!(broken.step(&model, 500.0, f64::NAN).is_nan());
        assert!(broken.step(&model, f64::NAN, 9000.0).is_nan());
        assert_eq!(broken.step(&model, 900.0, 9000.0), whole.step(&model, 900.0, 9000.0));
    }
}
