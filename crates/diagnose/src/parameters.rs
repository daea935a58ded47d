//! The values of a term with their 95 % intervals, by the names of the table of causes.
//!
//! An interval is value ± t·σ, t of Student's distribution for the independent rows less the fitted
//! values, σ from [`spread`](crate::fit::spread); of a time constant or a period it is the logarithm
//! that has it.

use serde_json::{Map, Value, json};

use trueup_machine::effect::Effect;
use trueup_numerics::{noise::Noise, t_quantile};

use crate::{
    fit::{Fitted, Problem, spread},
    model::{Kind, Part, Scale},
    terms,
};

/// The values of a part with their 95 % intervals, by the names of the table of causes; whether they
/// are determined at all.
pub(crate) fn parameters(
    problem: &Problem,
    fitted: &Fitted,
    part: &Part,
    noise: Noise,
) -> (Map<String, Value>, bool) {
    let data = &problem.data;
    let spread = spread(problem, fitted, noise);
    let index = fitted.model.parts.iter().position(|there| there == part).unwrap_or(0);
    let quantile = t_quantile(0.975, spread.freedom);
    let place = |value: usize| spread.row_of(index, value);
    let sd = |value: usize| {
        place(value).map_or(f64::NAN, |at| spread.covariance(at, at).max(0.0).sqrt())
    };
    let nonlinear = part.kind.nonlinear();
    // Of one value, as it is fitted.
    let interval = |value: usize| -> [f64; 2] {
        let (center, sd) = (part.values[value], quantile * sd(value));
        if nonlinear.get(value) == Some(&Scale::Logarithmic) {
            [center * (-sd).exp(), center * sd.exp()]
        } else {
            [center - sd, center + sd]
        }
    };
    let mut map = Map::new();
    let mut put = |name: &str, value: f64, ci95: [f64; 2]| {
        let mut ci95 = ci95;
        ci95.sort_by(f64::total_cmp);
        map.insert(name.into(), json!({"value": value, "ci95": ci95}));
    };
    let mut plain = |name: &str, value: usize, offset: f64| {
        let [low, high] = interval(value);
        put(name, part.values[value] + offset, [low + offset, high + offset]);
    };
    let mut is_determined = true;
    match &part.kind {
        Kind::SensorOffset => plain("offset_um", 0, 0.0),
        Kind::SensorGain => plain("gain", 0, 1.0),
        Kind::SensorCurvature => plain("per_um", 0, 0.0),
        Kind::SensorSaturation => plain("limit_um", 0, 0.0),
        Kind::SensorTemperatureDrift { .. } => plain("um_per_c", 0, 0.0),
        Kind::TimeShift => plain("shift_s", 0, 0.0),
        Kind::ThermalLag | Kind::GrowthRate | Kind::CoolingAsymmetry => {
            plain("time_constant_s", 0, 0.0);
        }
        Kind::SlowMode => {
            plain("amplitude_um", 1, 0.0);
            plain("time_constant_s", 0, 0.0);
        }
        Kind::SlowModeOf { .. } | Kind::ExtraHeatPath { has_lag: true, .. } => {
            plain("um_per_c", 1, 0.0);
            plain("time_constant_s", 0, 0.0);
        }
        Kind::ExtraHeatPath { has_lag: false, .. } => {
            plain("um_per_c", 0, 0.0);
            put("time_constant_s", 0.0, [0.0, 0.0]);
        }
        Kind::GrowthAmplitude => plain("scale", 0, 1.0),
        Kind::ExpansionSlope => {
            let believed =
                crate::model::own_thermal(data).map_or(0.0, |it| it.slope_um_per_m_per_c);
            plain("um_per_m_per_c", 0, believed);
        }
        Kind::ReferenceTemperature => plain("shift_c", 0, 0.0),
        Kind::CentrifugalGrowth => plain("um_per_krpm2", 0, 0.0),
        Kind::CuttingLoad => plain("um_per_n", 0, 0.0),
        Kind::PitchScale | Kind::PositionDependentBacklash | Kind::CrossAxis { .. } => {
            plain("um_per_m", 0, 0.0);
        }
        Kind::Backlash => plain("width_um", 0, 0.0),
        Kind::Drift => plain("um_per_h", 0, 0.0),
        Kind::Step => {
            plain("size_um", 1, 0.0);
            // A jump is as sharp as its neighbours in time.
            let at_s = part.values[0];
            let step_s = step_s(problem) * problem.groups.size as f64;
            put("at_s", at_s, [at_s - 2.0 * step_s, at_s + step_s]);
        }
        Kind::PitchPeriodic { .. } | Kind::ReferenceInstrument { .. } => {
            // Of several waves the largest is the one that is named.
            let waves = part.values[nonlinear.len()..].chunks(2);
            let sizes: Vec<f64> = waves.map(|pair| pair[0].hypot(pair[1])).collect();
            let largest = (0..sizes.len()).max_by(|a, b| sizes[*a].total_cmp(&sizes[*b]));
            let largest = largest.unwrap_or(0);
            let start = nonlinear.len() + 2 * largest;
            let harmonic = match &part.kind {
                Kind::PitchPeriodic { harmonics } => f64::from(harmonics[largest]),
                _ => 1.0,
            };
            let (a, b) = (part.values[start], part.values[start + 1]);
            let amplitude = a.hypot(b);
            let sd = match (place(start), place(start + 1)) {
                (Some(i), Some(j)) if amplitude > 0.0 => {
                    let c = |i, j| spread.covariance(i, j);
                    let square = a * a * c(i, i) + 2.0 * a * b * c(i, j) + b * b * c(j, j);
                    quantile * square.max(0.0).sqrt() / amplitude
                }
                _ => f64::NAN,
            };
            put("amplitude_um", amplitude, [(amplitude - sd).max(0.0), amplitude + sd]);
            let [low, high] = interval(0);
            put("period_mm", part.values[0] / harmonic, [low / harmonic, high / harmonic]);
        }
        Kind::PitchError { .. } | Kind::Straightness { .. } | Kind::Curve { .. } => {}
    }
    // A mean of readings that are rounded has less of an interval than its rounding.
    for (value, scale) in nonlinear.iter().enumerate() {
        let [low, high] = interval(value);
        let bound = problem.bounds.time_constant_s;
        if part.kind.has_time_constant() && *scale == Scale::Logarithmic {
            let at_bound = part.values[value] > 0.95 * bound[1];
            // Known within a factor of two either way, or short beside the record: else it is not
            // known how the next hours will be.
            let is_known = high < 4.0 * low || problem.is_short(high);
            is_determined &= is_known && !at_bound;
        }
    }
    list_parameters(part, &interval, &mut map);
    // The reference and a zero that came with it.
    let terms = terms::terms(data, &fitted.model);
    if let Some(term) = terms.get(index) {
        if let Effect::ReferenceInstrument(instrument) = &term.effect {
            map.insert("description".into(), json!({"value": instrument.description}));
        }
        if let Some(heat) = term.effect.clone().heat_mut() {
            map.insert("reference_c".into(), json!({"value": heat.reference_c}));
        }
        if term.constant_um != 0.0 {
            map.insert("constant_um".into(), json!({"value": term.constant_um}));
        }
    }
    (map, is_determined)
}

fn list_parameters(
    part: &Part,
    interval: &dyn Fn(usize) -> [f64; 2],
    map: &mut Map<String, Value>,
) {
    let intervals = || (0..part.values.len()).map(interval).collect::<Vec<_>>();
    match &part.kind {
        Kind::PitchError { start_mm, step_mm, points, both_ways } => {
            let value = json!({
                "start_mm": start_mm,
                "step_mm": step_mm,
                "forward_um": part.values[..*points],
                "reverse_um": both_ways.then(|| part.values[*points..].to_vec()),
            });
            map.insert("table".into(), json!({"value": value, "ci95": intervals()}));
        }
        Kind::Straightness { along, knots_mm } => {
            let value = json!({
                "along": along.name(),
                "order": 4,
                "knots_mm": knots_mm,
                "control_um": part.values,
            });
            map.insert("spline".into(), json!({"value": value, "ci95": intervals()}));
        }
        Kind::CrossAxis { axis } => {
            map.insert("axis".into(), json!({"value": axis.name()}));
        }
        Kind::PitchPeriodic { harmonics } if harmonics.len() > 1 => {
            let waves: Vec<Value> = harmonics
                .iter()
                .zip(part.values[1..].chunks(2))
                .map(|(harmonic, pair)| {
                    json!({
                        "harmonic": harmonic,
                        "amplitude_um": pair[0].hypot(pair[1]),
                        "phase_deg": pair[1].atan2(pair[0]).to_degrees(),
                    })
                })
                .collect();
            map.insert("harmonics".into(), json!({"value": waves}));
            map.insert("turn_mm".into(), json!({"value": part.values[0]}));
        }
        _ => {}
    }
}

/// Seconds from row to row, or 1 where there is no time.
pub(crate) fn step_s(problem: &Problem) -> f64 {
    let data = &problem.data;
    if data.time_s.is_none() {
        return 1.0;
    }
    let [start, end] = problem.bounds.time_s;
    (end - start) / (data.rows as f64 / data.files as f64).max(1.0)
}
