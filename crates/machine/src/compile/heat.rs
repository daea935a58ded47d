//! Laws over temperature and running time for the board.

use trueup_core::{
    curve::Curve,
    dimensions::STEP_MS,
    gradient::Gradient,
    lag::SmoothingFactor,
    thermal::{Law, PIECE_SIZE, Piece, SLOPE_FRACTION_BITS, SLOPE_UNIT_BITS},
    units::{Fine, Position, Temperature},
    warmup,
};

use super::curve::{self, OwnedCurve, Reason};
use crate::{
    file::{Thermal, ThermalRow, Warmup},
    model,
};

const FINE_PER_UM: f64 = Fine::PER_NANOMETRE as f64 * 1_000.0;
/// Gradient units in 1 µm/m: nanometres for 10 nm of travel, Q36.
pub(super) const GRADIENT_PER_UM_PER_M: f64 = 1e-5 * (1_u64 << Gradient::FRACTION_BITS) as f64;
/// What a slope of 1 a kelvin is in the board's integers.
const SLOPE_PER_KELVIN: f64 =
    (1_u64 << (SLOPE_UNIT_BITS + SLOPE_FRACTION_BITS)) as f64 / Temperature::PER_KELVIN as f64;
/// Within these temperatures a law is held against the model.
const CHECKED_C: (i32, i32) = (-20, 100);
/// So far from its origin.
const CHECKED_MM: f64 = 15_000.0;

/// The pieces of a law.
pub(super) type Pieces = Vec<[u8; PIECE_SIZE]>;

/// A temperature in the board's unit.
pub(super) fn temperature(celsius: f64) -> Option<Temperature> {
    super::rounded(celsius * f64::from(Temperature::PER_KELVIN)).map(Temperature)
}

/// The law of an axis, and its largest difference from the model in nm.
pub(super) fn axis_law(thermal: &Thermal) -> Result<(Pieces, f64), Reason> {
    let rows;
    let table: &[ThermalRow] = match &thermal.table {
        Some(table) => table,
        None => {
            rows = [
                ThermalRow {
                    temperature_c: thermal.reference_c,
                    constant_um: 0.0,
                    slope_um_per_m: 0.0,
                },
                ThermalRow {
                    temperature_c: thermal.reference_c + 1.0,
                    constant_um: thermal.constant_um_per_c,
                    slope_um_per_m: thermal.slope_um_per_m_per_c,
                },
            ];
            &rows
        }
    };
    let (has_constant, has_position) = (thermal.mode.has_constant(), thermal.mode.has_position());
    let masked = table.iter().map(|row| ThermalRow {
        temperature_c: row.temperature_c,
        constant_um: if has_constant { row.constant_um } else { 0.0 },
        slope_um_per_m: if has_position { row.slope_um_per_m } else { 0.0 },
    });
    let masked: Vec<ThermalRow> = masked.collect();
    let pieces = match thermal.table {
        Some(_) => table_pieces(&masked)?,
        // One straight line for all temperatures.
        None => vec![piece(&masked[0], Some(&masked[1]))?],
    };
    let difference_nm = axis_difference_nm(thermal, &pieces);
    Ok((pieces, difference_nm))
}

/// The law of a spindle's temperature: k·(T − T₀).
pub(super) fn spindle_law(k_um_per_c: f64, reference_c: f64) -> Result<Pieces, Reason> {
    let at =
        |temperature_c, constant_um| ThermalRow { temperature_c, constant_um, slope_um_per_m: 0.0 };
    let line = piece(&at(reference_c, 0.0), Some(&at(reference_c + 1.0, k_um_per_c)))?;
    Ok(vec![line])
}

/// A line from row to row; before the first and after the last their values are held.
fn table_pieces(rows: &[ThermalRow]) -> Result<Pieces, Reason> {
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else { return Ok(Vec::new()) };
    let mut pieces = vec![piece(first, None)?];
    for pair in rows.windows(2) {
        pieces.push(piece(&pair[0], Some(&pair[1]))?);
    }
    if rows.len() > 1 {
        pieces.push(piece(last, None)?);
    }
    Ok(pieces)
}

/// From `row` on: towards `next`, or level.
fn piece(row: &ThermalRow, next: Option<&ThermalRow>) -> Result<[u8; PIECE_SIZE], Reason> {
    let stored = |value: f64, what: &str, unit: &str, written: f64| {
        super::rounded(value)
            .ok_or_else(|| format!("{what} {written} {unit} is more than the board can store"))
    };
    let slope = |of: fn(&ThermalRow) -> f64| {
        next.map_or(0.0, |next| (of(next) - of(row)) / (next.temperature_c - row.temperature_c))
    };
    let constant_slope = slope(|row| row.constant_um);
    let gradient_slope = slope(|row| row.slope_um_per_m);
    let start = temperature(row.temperature_c).ok_or_else(|| {
        format!("temperature {} °C is beyond the board's ±524 °C", row.temperature_c)
    })?;
    Ok(Piece {
        start,
        constant: Fine(stored(row.constant_um * FINE_PER_UM, "K0", "µm", row.constant_um)?),
        constant_slope: stored(
            constant_slope * FINE_PER_UM * SLOPE_PER_KELVIN,
            "K0's slope",
            "µm/K",
            constant_slope,
        )?,
        gradient: Gradient(stored(
            row.slope_um_per_m * GRADIENT_PER_UM_PER_M,
            "slope",
            "µm/m",
            row.slope_um_per_m,
        )?),
        gradient_slope: stored(
            gradient_slope * GRADIENT_PER_UM_PER_M * SLOPE_PER_KELVIN,
            "slope",
            "µm/m per K",
            gradient_slope,
        )?,
    }
    .to_bytes())
}

/// At every quarter of a kelvin, and 15 m to either side of the origin where the board's lengths
/// reach so far.
fn axis_difference_nm(thermal: &Thermal, pieces: &Pieces) -> f64 {
    let law = Law { pieces };
    let mut worst: f64 = 0.0;
    for quarter in CHECKED_C.0 * 4..=CHECKED_C.1 * 4 {
        let celsius = f64::from(quarter) / 4.0;
        let Some(t) = temperature(celsius) else { continue };
        let (constant, gradient) = law.at(t);
        let exact = |mm: f64| model::thermal_um(thermal, celsius, thermal.origin_mm + mm) * 1_000.0;
        let board = |mm: f64| {
            let units = mm * f64::from(Position::PER_MILLIMETRE);
            f64::from(constant.0) / f64::from(Fine::PER_NANOMETRE)
                + f64::from(gradient.0) * units / (1_u64 << Gradient::FRACTION_BITS) as f64
        };
        for mm in [0.0, CHECKED_MM, -CHECKED_MM] {
            // A gradient that is held at its largest belongs to errors beyond any limit.
            if exact(mm).abs() < 8_000_000.0 {
                worst = worst.max((board(mm) - exact(mm)).abs());
            }
        }
    }
    worst
}

/// 1 − e^(−Δt/τ) for the board's step; all of it where there is no lag.
pub(super) fn smoothing_factor(time_constant_s: f64) -> Result<SmoothingFactor, Reason> {
    if time_constant_s == 0.0 {
        return Ok(SmoothingFactor::NO_LAG);
    }
    let step_s = f64::from(STEP_MS) / 1_000.0;
    // exp_m1 keeps the digits of a long time constant.
    let factor = (-(-step_s / time_constant_s).exp_m1() * 2_f64.powi(32)).round();
    if factor < 1_000.0 {
        return Err(format!("{time_constant_s} s is longer than the board can follow (5 days)"));
    }
    Ok(SmoothingFactor(factor.min(f64::from(u32::MAX)) as u32))
}

/// The smoothing factors while it rises and while it falls, which is the same unless it is given.
pub(super) fn smoothing_factors(
    rising_s: f64,
    falling_s: Option<f64>,
) -> Result<[SmoothingFactor; 2], Reason> {
    Ok([smoothing_factor(rising_s)?, smoothing_factor(falling_s.unwrap_or(rising_s))?])
}

/// The warm-up model, with the curve of its speed exponent.
pub(super) fn warmup(warmup: &Warmup) -> Result<(warmup::Warmup, OwnedCurve), Reason> {
    let full =
        1.0 / -(-warmup.exponent).exp_m1() * f64::from(1 << warmup::Warmup::FULL_FRACTION_BITS);
    let full = super::rounded(full)
        .ok_or_else(|| format!("exponent {} is below the board's 0.008", warmup.exponent))?;
    let max = super::rounded(warmup.max_um * FINE_PER_UM)
        .ok_or_else(|| format!("max_um {} is beyond the board's ±8388 µm", warmup.max_um))?;
    let lag_ms = (warmup.lag_s * 1_000.0).round();
    if lag_ms > f64::from(u32::MAX) {
        return Err(format!("lag_s {} is beyond the board's 49 days", warmup.lag_s));
    }
    let law = warmup::Warmup {
        lag_ms: lag_ms as u32,
        max: Fine(max),
        smoothing_heating: smoothing_factor(warmup.time_constant_s())?,
        smoothing_cooling: smoothing_factor(warmup.cooling_time_constant_s())?,
        full,
    };
    Ok((law, power_curve(warmup)?))
}

/// (n/n_rated)^p in Q28 over n in r/min, to 1 nm of Smax; held at 4 times the rated heat.
fn power_curve(warmup: &Warmup) -> Result<OwnedCurve, Reason> {
    const MOST: f64 = 4.0;
    let (Some(rated), p) = (warmup.rated_rpm, warmup.speed_exponent) else {
        return Ok(OwnedCurve::NONE);
    };
    if p == 0.0 {
        return Ok(OwnedCurve::NONE);
    }
    let one = f64::from(warmup::Warmup::RATED);
    let last = (rated * MOST.powf(1.0 / p)).clamp(2.0, f64::from(u16::MAX)).floor();
    let power = |rpm: f64| (rpm.max(0.5) / rated).powf(p) * one;
    let allowed = one / (warmup.max_um.abs() * 1_000.0).max(1.0);
    let last = last as i32;
    let piece = |start, end| curve::Piece { start, end, value: Box::new(power) };
    // Half of what is allowed, because not every speed is looked at.
    let fits = |start: i32, end: i32| -> Result<bool, Reason> {
        const PLACES: i32 = 32;
        let curve = curve::build(&[piece(start, end)])?;
        let fits_at = |rpm: i32| {
            let stored = curve.view().at(Position(rpm)).0.0;
            (f64::from(stored) - power(rpm.into())).abs() <= allowed / 2.0
        };
        Ok((0..=PLACES).all(|n| fits_at(start + (end - start) * n / PLACES)))
    };
    // Each segment as long as it may be. Of three speeds and the one before a cubic is always right.
    let mut pieces = Vec::new();
    let mut start = 1;
    while start < last {
        let (mut end, mut too_far) = ((start + 3).min(last), last + 1);
        while too_far - end > 1 {
            let middle = end.midpoint(too_far);
            if fits(start, middle)? { end = middle } else { too_far = middle }
        }
        pieces.push(piece(start, end));
        start = end;
    }
    let curve = curve::build(&pieces)?;
    if worst_of(&curve.view(), power, last) <= allowed {
        return Ok(curve);
    }
    Err(format!("speed_exponent {p} is too steep for the board's curve"))
}

/// At every whole speed.
fn worst_of(curve: &Curve<'_>, exact: impl Fn(f64) -> f64, last: i32) -> f64 {
    (1..=last).fold(0.0, |worst: f64, rpm| {
        worst.max((f64::from(curve.at(Position(rpm)).0.0) - exact(f64::from(rpm))).abs())
    })
}
