//! The warm-up of a spindle, with the curve of its speed exponent.

use trueup_core::{
    calibration::SpindleWarmupModel,
    curve::{Curve, CurveSegment},
    units::{FineNanometres, Position},
    warmup,
};

use super::{
    curve::{self, ErrorMessage, OwnedCurve},
    lag::{compiles_to, smoothing_factor, time_constant_s},
};
use crate::{
    sections::Warmup,
    unit_conversion::{
        FINE_UNITS_PER_UM, round_to_i32, round_to_u32, shortest_decimal, to_user_value,
    },
};

const FULL_FRACTION_SCALE: f64 = (1_u64 << warmup::WarmupModel::FULL_FRACTION_BITS) as f64;
const RATED_HEAT_INPUT: f64 = warmup::WarmupModel::RATED_HEAT_INPUT as f64;

/// Returns the warm-up model, with the curve of its speed exponent.
pub(super) fn compile(warmup: &Warmup) -> Result<(warmup::WarmupModel, OwnedCurve), ErrorMessage> {
    let full = 1.0 / -(-warmup.exponent).exp_m1() * FULL_FRACTION_SCALE;
    let full = round_to_i32(full)
        .ok_or_else(|| format!("exponent {} is below the board's 0.008", warmup.exponent))?;
    let max = round_to_i32(warmup.max_um * FINE_UNITS_PER_UM)
        .ok_or_else(|| format!("max_um {} is beyond the board's ±8388 µm", warmup.max_um))?;
    let lag_ms = round_to_u32(warmup.lag_s * 1_000.0)
        .ok_or_else(|| format!("lag_s {} is beyond the board's 49 days", warmup.lag_s))?;
    let law = warmup::WarmupModel {
        lag_ms,
        max: FineNanometres(max),
        smoothing_heating: smoothing_factor(warmup.time_constant_s())?,
        smoothing_cooling: smoothing_factor(warmup.cooling_time_constant_s())?,
        full,
    };
    Ok((law, compile_relative_heat_curve(warmup)?))
}

/// (n/n_rated)^p in Q28 over n in r/min, to 1 nm of Smax; held at 4 times the rated heat.
fn compile_relative_heat_curve(warmup: &Warmup) -> Result<OwnedCurve, ErrorMessage> {
    const MAX_RELATIVE_HEAT: f64 = 4.0;
    let (Some(rated), p) = (warmup.rated_rpm, warmup.speed_exponent) else {
        return Ok(OwnedCurve::EMPTY);
    };
    if p == 0.0 {
        return Ok(OwnedCurve::EMPTY);
    }
    let one = f64::from(warmup::WarmupModel::RATED_HEAT_INPUT);
    let last = (rated * MAX_RELATIVE_HEAT.powf(1.0 / p)).clamp(2.0, f64::from(u16::MAX)).floor();
    let power = |rpm: f64| (rpm.max(0.5) / rated).powf(p) * one;
    let allowed = one / (warmup.max_um.abs() * 1_000.0).max(1.0);
    let last = round_to_i32(last).expect("held to u16 above");
    let piece = |start, end| curve::CurvePiece { start, end, value: Box::new(power) };
    // Half of what is allowed, because not every speed is looked at.
    let fits = |start: i32, end: i32| -> Result<bool, ErrorMessage> {
        const SAMPLES_PER_PIECE: i32 = 32;
        let curve = curve::build_curve(&[piece(start, end)])?;
        let fits_at = |rpm: i32| {
            let stored = curve.view().evaluate(Position(rpm)).0.0;
            (f64::from(stored) - power(rpm.into())).abs() <= allowed / 2.0
        };
        Ok((0..=SAMPLES_PER_PIECE).all(|n| fits_at(start + (end - start) * n / SAMPLES_PER_PIECE)))
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
    let curve = curve::build_curve(&pieces)?;
    if max_curve_error(&curve.view(), power, last) <= allowed {
        return Ok(curve);
    }
    Err(format!("speed_exponent {p} is too steep for the board's curve"))
}

/// At every whole speed.
fn max_curve_error(curve: &Curve<'_>, exact: impl Fn(f64) -> f64, last: i32) -> f64 {
    (1..=last).fold(0.0, |worst: f64, rpm| {
        worst.max((f64::from(curve.evaluate(Position(rpm)).0.0) - exact(f64::from(rpm))).abs())
    })
}

/// Returns the warm-up as a user writes it.
pub(super) fn decompile(warmup: &SpindleWarmupModel<'_>) -> Warmup {
    /// An exponent that is as good as endless: its growth is full, to the last bit.
    const SATURATED_EXPONENT: f64 = 20.0;
    let law = &warmup.law;
    let full = f64::from(law.full);
    let exponent = if full > FULL_FRACTION_SCALE {
        let same = |k: f64| (FULL_FRACTION_SCALE / -(-k).exp_m1() - full).abs() < 0.49;
        shortest_decimal(-(-FULL_FRACTION_SCALE / full).ln_1p(), same)
    } else {
        SATURATED_EXPONENT
    };
    let lag_s = f64::from(law.lag_ms) / 1_000.0;
    let warm_s =
        shortest_decimal(lag_s + exponent * time_constant_s(law.smoothing_heating), |warm_s| {
            compiles_to((warm_s - lag_s) / exponent, law.smoothing_heating)
        });
    let cools_otherwise = law.smoothing_cooling != law.smoothing_heating;
    let cool_s = cools_otherwise.then(|| {
        shortest_decimal(time_constant_s(law.smoothing_cooling), |time_s| {
            compiles_to(time_s, law.smoothing_cooling)
        })
    });
    let power = fit_power_law(&warmup.power);
    Warmup {
        lag_s,
        warm_s,
        max_um: to_user_value(law.max.0, FINE_UNITS_PER_UM),
        exponent,
        cool_s,
        rated_rpm: power.map(|(rated_rpm, _)| rated_rpm),
        speed_exponent: power.map_or(0.0, |(_, speed_exponent)| speed_exponent),
    }
}

/// n_rated and p of a curve of (n/n_rated)^p, which its segments meet at their ends.
///
/// One segment is enough only where the power is a cubic itself, and is then met everywhere: its
/// thirds are compared too, because the value at its start, 1 r/min, is all rounding.
fn fit_power_law(curve: &Curve<'_>) -> Option<(f64, f64)> {
    /// Rounding of a segment's coefficients, in units of its value.
    const ROUNDING_TOLERANCE: f64 = 8.0;
    /// The curve ends at this many times the rated heat, or at the fastest speed.
    const MAX_RELATIVE_HEAT: f64 = 4.0;
    let first = curve.first_knot().0;
    let mut places: Vec<i32> = vec![first];
    places.extend(curve.segments().iter().map(|bytes| CurveSegment::from_bytes(bytes).end.0));
    if let [_, end] = places[..] {
        let third = (end - first) / 3;
        places = vec![first, first + third, end - third, end];
    }
    let ends: Vec<(f64, f64)> = places
        .into_iter()
        .map(|place| (f64::from(place), f64::from(curve.evaluate(Position(place)).0.0)))
        .filter(|&(_, value)| value > 0.0)
        .collect();
    let (&(last_rpm, last), lower) = ends.split_last()?;
    // Where the rounding of the value moves p least.
    let uncertainty = |&(rpm, value): &(f64, f64)| 1.0 / (value * (last_rpm / rpm).ln());
    let &(rpm, value) = lower.iter().min_by(|a, b| uncertainty(a).total_cmp(&uncertainty(b)))?;
    let exact = (last / value).ln() / (last_rpm / rpm).ln();
    let rated = |p: f64| last_rpm / (last / RATED_HEAT_INPUT).powf(1.0 / p);
    let meets_all = |rated: f64, p: f64| {
        let end = (rated * MAX_RELATIVE_HEAT.powf(1.0 / p)).clamp(2.0, u16::MAX.into()).floor();
        end == last_rpm
            && ends.iter().all(|&(rpm, value)| {
                ((rpm / rated).powf(p) * RATED_HEAT_INPUT - value).abs() <= ROUNDING_TOLERANCE
            })
    };
    let rounded = |number: f64, decimals: i32| {
        let scale = 10_f64.powi(decimals);
        (number * scale).round() / scale
    };
    let candidates = (0..=9)
        .map(|decimals| rounded(exact, decimals))
        .flat_map(|p| (-3..=6).map(move |decimals| (rounded(rated(p), decimals), p)));
    let mut fitting = candidates.filter(|&(rated, p)| meets_all(rated, p));
    Some(fitting.next().unwrap_or((rated(exact), exact)))
}
