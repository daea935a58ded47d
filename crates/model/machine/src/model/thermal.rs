//! How an axis grows with a temperature, in `f64` (`docs/physics.md` section 3).
//!
//! ```text
//! ΔK(T) = K₀(T) + tanβ(T)·(P − P₀)
//! ```
//!
//! P is the axis's position, P₀ its origin; tanβ is in µm/m. K₀ and tanβ are proportional to T − T₀, or are
//! tables over T, linear between the rows and held at the ends. ΔK is the axis's error (actual
//! minus commanded): it is positive where the axis has gone too far in the positive direction, and
//! the offset moves it in the negative one.

use crate::sections::{ThermalLaw, ThermalRow};

/// K₀(T) in µm and tanβ(T) in µm/m, at a temperature that has passed the axis's lag already;
/// whether they count is the mode's business.
///
/// ```
/// use trueup_machine::{machine_file::{ThermalLaw, ThermalMode, ThermalRow}, model::thermal_constant_and_slope};
/// let row = |temperature_c, constant_um, slope_um_per_m| {
///     ThermalRow { temperature_c, constant_um, slope_um_per_m }
/// };
/// let axis = ThermalLaw {
///     mode: ThermalMode::Both, sensor: "temp_screw_c".into(), reference_c: 0.0,
///     constant_um_per_c: 0.0, slope_um_per_m_per_c: 0.0, origin_mm: 0.0, lag_s: 0.0,
///     table: Some(vec![row(20.0, 1.0, 0.0), row(30.0, 3.0, 50.0)]),
/// };
/// assert_eq!(thermal_constant_and_slope(&axis, 22.5), (1.5, 12.5)); // a quarter of the way
/// assert_eq!(thermal_constant_and_slope(&axis, 99.0), (3.0, 50.0)); // held
/// ```
#[must_use]
pub fn thermal_constant_and_slope(axis: &ThermalLaw, temperature_c: f64) -> (f64, f64) {
    match &axis.table {
        Some(table) => interpolate_table(table, temperature_c),
        None => {
            let above_c = temperature_c - axis.reference_c;
            (axis.constant_um_per_c * above_c, axis.slope_um_per_m_per_c * above_c)
        }
    }
}

/// Linear between the rows, the end rows held outside; NaN without rows or without a temperature.
fn interpolate_table(table: &[ThermalRow], temperature_c: f64) -> (f64, f64) {
    let (Some(first), Some(last)) = (table.first(), table.last()) else {
        return (f64::NAN, f64::NAN);
    };
    if temperature_c.is_nan() {
        return (f64::NAN, f64::NAN);
    }
    let above = table.partition_point(|row| row.temperature_c <= temperature_c);
    let (low, high) = match (above.checked_sub(1).and_then(|low| table.get(low)), table.get(above))
    {
        (Some(low), Some(high)) => (low, high),
        (None, _) => (first, first),
        (_, None) => (last, last),
    };
    let width_c = high.temperature_c - low.temperature_c;
    let share = if width_c > 0.0 { (temperature_c - low.temperature_c) / width_c } else { 0.0 };
    let between = |low: f64, high: f64| low + (high - low) * share;
    (between(low.constant_um, high.constant_um), between(low.slope_um_per_m, high.slope_um_per_m))
}

/// Returns the axis's thermal error in µm, at a temperature that has passed its lag already; NaN where the
/// temperature or a position that counts is missing.
///
/// ```
/// use trueup_machine::{machine_file::{ThermalLaw, ThermalMode}, model::thermal_error_um};
/// let axis = ThermalLaw {
///     mode: ThermalMode::Position, sensor: "temp_screw_c".into(), reference_c: 23.0,
///     constant_um_per_c: 0.0, slope_um_per_m_per_c: 14.21, origin_mm: 0.0, lag_s: 0.0,
///     table: None,
/// };
/// // (42 − 23) K · 14.21 µm/(m·K) · 1 m
/// assert!((thermal_error_um(&axis, 42.0, 1000.0) - 269.99).abs() < 1e-9);
/// ```
#[must_use]
pub fn thermal_error_um(axis: &ThermalLaw, temperature_c: f64, position_mm: f64) -> f64 {
    let (constant_um, slope_um_per_m) = thermal_constant_and_slope(axis, temperature_c);
    let mut error_um = 0.0;
    if axis.mode.has_constant_term() {
        error_um += constant_um;
    }
    if axis.mode.has_position_term() {
        error_um += slope_um_per_m * (position_mm - axis.origin_mm) / 1000.0;
    }
    error_um
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sections::ThermalMode;

    /// Returns the paper's axis: 23 °C to 42 °C is 270 µm/m.
    fn paper() -> ThermalLaw {
        ThermalLaw {
            mode: ThermalMode::Position,
            sensor: "temp_screw_c".into(),
            reference_c: 23.0,
            constant_um_per_c: 0.0,
            slope_um_per_m_per_c: 14.21,
            origin_mm: 0.0,
            lag_s: 0.0,
            table: None,
        }
    }

    #[test]
    fn the_papers_axis_is_270_um_too_long_at_one_metre_when_it_is_hot() {
        assert_eq!(thermal_error_um(&paper(), 23.0, 1000.0), 0.0);
        assert!((thermal_error_um(&paper(), 42.0, 1000.0) - 269.99).abs() < 1e-9);
        assert!((thermal_error_um(&paper(), 42.0, -500.0) + 134.995).abs() < 1e-9);
        assert!((thermal_error_um(&paper(), 4.0, 1000.0) + 269.99).abs() < 1e-9);
    }

    #[test]
    fn five_metres_of_steel_grow_50_um_for_one_kelvin() {
        let steel = ThermalLaw { reference_c: 20.0, slope_um_per_m_per_c: 10.0, ..paper() };
        assert_eq!(thermal_error_um(&steel, 21.0, 5000.0), 50.0);
    }

    #[test]
    fn the_mode_chooses_the_terms() {
        let axis = ThermalLaw { constant_um_per_c: 2.0, slope_um_per_m_per_c: 10.0, ..paper() };
        let at = |mode| thermal_error_um(&ThermalLaw { mode, ..axis.clone() }, 26.0, 500.0);
        assert_eq!(at(ThermalMode::Constant), 6.0);
        assert_eq!(at(ThermalMode::Position), 15.0);
        assert_eq!(at(ThermalMode::Both), 21.0);
    }

    #[test]
    fn nothing_of_the_second_term_is_left_at_its_origin() {
        let axis = ThermalLaw { origin_mm: 250.0, ..paper() };
        assert_eq!(thermal_error_um(&axis, 42.0, 250.0), 0.0);
        assert!((thermal_error_um(&axis, 33.0, 1250.0) - 142.1).abs() < 1e-9);
    }

    #[test]
    fn a_position_that_does_not_count_may_be_missing() {
        let axis = ThermalLaw { mode: ThermalMode::Constant, constant_um_per_c: 2.0, ..paper() };
        assert_eq!(thermal_error_um(&axis, 24.0, f64::NAN), 2.0);
        assert!(thermal_error_um(&paper(), 24.0, f64::NAN).is_nan());
        assert!(thermal_error_um(&axis, f64::NAN, 0.0).is_nan());
    }

    #[test]
    fn a_table_is_linear_between_its_rows_and_held_outside() {
        let row = |temperature_c, constant_um, slope_um_per_m| ThermalRow {
            temperature_c,
            constant_um,
            slope_um_per_m,
        };
        let rows = vec![row(23.0, 0.0, 0.0), row(33.0, 5.0, 100.0), row(42.0, -4.0, 270.0)];
        let axis = ThermalLaw { table: Some(rows), ..paper() };
        for (temperature_c, expected) in [
            (-40.0, (0.0, 0.0)),
            (23.0, (0.0, 0.0)),
            (28.0, (2.5, 50.0)),
            (33.0, (5.0, 100.0)),
            (37.5, (0.5, 185.0)),
            (42.0, (-4.0, 270.0)),
            (300.0, (-4.0, 270.0)),
        ] {
            assert_eq!(
                thermal_constant_and_slope(&axis, temperature_c),
                expected,
                "{temperature_c} °C"
            );
        }
        assert!(thermal_constant_and_slope(&axis, f64::NAN).0.is_nan());
        assert_eq!(thermal_error_um(&axis, 42.0, 1000.0), 270.0);
    }
}
