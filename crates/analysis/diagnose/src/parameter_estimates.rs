//! The values of a term with their 95 % intervals, by the names of the table of causes.
//!
//! An interval is value ± t·σ, t of Student's distribution for the independent rows less the fitted
//! values, σ from [`estimate_parameter_covariance`]; of a time constant or a period it is the logarithm
//! that has it.

use nalgebra::DMatrix;
use serde_json::{Map, Value, json};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use trueup_machine::effect::{self, FindingParameter, NonlinearParameter};
use trueup_numerics::{least_squares::normal_equations, noise::NoiseModel, t_quantile};

use crate::{
    extension_terms,
    fit::{
        CONFIDENCE_LEVEL, EQUIVALENCE_TOLERANCE, FitProblem, FittedModel, ParameterCovariance,
        estimate_parameter_covariance,
    },
    model::MIN_DISTINCT_RATE_RATIO,
    term_kind::ModelPart,
};

/// The estimated values of a part, and how well they are known.
pub(crate) struct ParameterEstimates {
    /// The values with their 95 % intervals, by the names of the table of causes.
    pub named: Map<String, Value>,
    /// Of each value as it is fitted: its 95 % interval.
    pub intervals: Vec<[f64; 2]>,
    /// Whether the time constants are known at all.
    pub is_determined: bool,
    /// Whether an interval holds the value at which the part does nothing.
    pub reaches_nothing: bool,
}

/// Returns what is known of the values of a part of `fitted`, under `noise`.
pub(crate) fn estimate_parameters(
    problem: &FitProblem,
    fitted: &FittedModel,
    part: &ModelPart,
    noise: NoiseModel,
) -> ParameterEstimates {
    let data = &problem.data;
    let spread = estimate_parameter_covariance(problem, fitted, noise);
    let index = fitted.model.parts.iter().position(|there| there == part).unwrap_or(0);
    let quantile = t_quantile(0.5 + 0.5 * CONFIDENCE_LEVEL, spread.freedom);
    let place = |value: usize| spread.value_row(index, value);
    let sd = |value: usize| {
        place(value).map_or(f64::NAN, |at| spread.covariance(at, at).max(0.0).sqrt())
    };
    let nonlinear = part.kind.nonlinear_parameters();
    // Of one value, as it is fitted.
    let interval = |value: usize| -> [f64; 2] {
        let (centre, sd) = (part.values[value], quantile * sd(value));
        if part.kind.is_log_scaled(value) {
            [centre * (-sd).exp(), centre * sd.exp()]
        } else {
            [centre - sd, centre + sd]
        }
    };
    let intervals: Vec<[f64; 2]> = (0..part.values.len()).map(&interval).collect();
    let mut reaches_nothing = is_zero_effect_within_intervals(part, &intervals)
        || is_zero_within_confidence_region(part, index, &spread);
    let mut map = Map::new();
    let listed = part.kind.cause().map(|cause| cause.parameters(&part.values)).unwrap_or_default();
    for parameter in &listed {
        match parameter {
            FindingParameter::Fitted(name, number, offset) => {
                let [low, high] = interval(*number);
                let shifted = [low + offset, high + offset];
                insert_estimate(&mut map, name, part.values[*number] + offset, shifted);
            }
            FindingParameter::Fixed(name, value) => {
                insert_estimate(&mut map, name, *value, [*value; 2])
            }
            FindingParameter::Instant(name, number) => {
                let at_s = part.values[*number];
                let interval_s = jump_time_confidence_interval_s(problem, at_s);
                insert_estimate(&mut map, name, at_s, interval_s);
            }
            FindingParameter::Waves(period, harmonics) => {
                let (start, harmonic) =
                    largest_harmonic(&part.values[nonlinear.len()..], harmonics);
                let start = nonlinear.len() + start;
                let pair = [part.values[start], part.values[start + 1]];
                let amplitude = pair[0].hypot(pair[1]);
                let at = place(start).zip(place(start + 1)).filter(|_| amplitude > 0.0);
                let sd = at
                    .map_or(f64::NAN, |at| quantile * amplitude_standard_error(pair, at, &spread));
                // Without an interval nothing is known of it.
                reaches_nothing |= amplitude <= sd || sd.is_nan();
                let ends = [(amplitude - sd).max(0.0), amplitude + sd];
                insert_estimate(&mut map, "amplitude_um", amplitude, ends);
                let [low, high] = interval(0);
                insert_estimate(
                    &mut map,
                    period,
                    part.values[0] / harmonic,
                    [low / harmonic, high / harmonic],
                );
            }
            FindingParameter::Record(name, record) => {
                let json = |value: &Option<_>| value.as_ref().map_or(Value::Null, value_to_json);
                let entries = record.iter().map(|(key, value)| (key.to_string(), json(value)));
                let record: Map<String, Value> = entries.collect();
                let intervals = &intervals[nonlinear.len()..];
                map.insert((*name).into(), json!({"value": record, "ci95": intervals}));
            }
            FindingParameter::Records(name, records) => {
                let entry =
                    |(key, value): &(_, _)| (ToString::to_string(key), value_to_json(value));
                let record =
                    |values: &Vec<_>| values.iter().map(entry).collect::<Map<String, Value>>();
                let records: Vec<_> = records.iter().map(record).collect();
                map.insert((*name).into(), json!({"value": records}));
            }
            FindingParameter::Stated(name, value) => {
                map.insert((*name).into(), json!({"value": value_to_json(value)}));
            }
        }
    }
    let is_determined = has_known_time_constants(problem, part, &intervals);
    // The reference and a zero that came with it.
    let terms = extension_terms::terms_from_model(data, &fitted.model);
    if let Some(term) = terms.get(index) {
        if let Some(heat) = term.effect.clone().temperature_response_mut() {
            map.insert("reference_c".into(), json!({"value": heat.reference_c}));
        }
        if term.constant_um != 0.0 {
            map.insert("constant_um".into(), json!({"value": term.constant_um}));
        }
    }
    ParameterEstimates { named: map, intervals, is_determined, reaches_nothing }
}

/// Returns whether the time constants of a part are known at all, by the `intervals` of its values.
fn has_known_time_constants(
    problem: &FitProblem,
    part: &ModelPart,
    intervals: &[[f64; 2]],
) -> bool {
    // A mean of readings that are rounded has less of an interval than its rounding.
    (0..part.kind.nonlinear_parameters().len()).all(|value| {
        if !part.kind.has_time_constant() || !part.kind.is_log_scaled(value) {
            return true;
        }
        let [low, high] = intervals[value];
        let at_bound =
            part.values[value] > (1.0 - EQUIVALENCE_TOLERANCE) * problem.bounds.time_constant_s[1];
        // Else it is not known which law it is, nor how the next hours will be.
        let is_known =
            high < MIN_DISTINCT_RATE_RATIO.powi(2) * low || problem.is_time_constant_short(high);
        is_known && !at_bound
    })
}

/// Returns the interval in s of a jump at an instant: it is as sharp as its neighbours in time, of which the one before
/// may be long ago.
fn jump_time_confidence_interval_s(problem: &FitProblem, at_s: f64) -> [f64; 2] {
    let data = &problem.data;
    let step_s = mean_row_interval_s(problem) * problem.groups.size as f64;
    let rows = (0..data.rows).filter(|&row| data.used[row]);
    let times = rows.filter_map(|row| data.time_s().map(|times| times[row]));
    let before_s = times.filter(|time_s| *time_s < at_s).fold(f64::NAN, f64::max);
    [(at_s - 2.0 * step_s).min(before_s), at_s + step_s]
}

/// Returns where the largest of several waves begins in their values, the one that is named, and its harmonic.
fn largest_harmonic(values: &[f64], harmonics: &[u32]) -> (usize, f64) {
    let sizes: Vec<f64> = values.chunks(2).map(|pair| pair[0].hypot(pair[1])).collect();
    let largest = (0..sizes.len()).max_by(|a, b| sizes[*a].total_cmp(&sizes[*b])).unwrap_or(0);
    (2 * largest, f64::from(harmonics[largest]))
}

/// Returns the standard error of the amplitude of a wave, of the values of its pair and their places in the spread.
fn amplitude_standard_error(
    [a, b]: [f64; 2],
    (i, j): (usize, usize),
    spread: &ParameterCovariance,
) -> f64 {
    let c = |i, j| spread.covariance(i, j);
    let square = a * a * c(i, i) + 2.0 * a * b * c(i, j) + b * b * c(j, j);
    square.max(0.0).sqrt() / a.hypot(b)
}

/// Returns whether the intervals of all values that say how much a part does hold the value at which it does
/// nothing: of amplitudes and a shift 0, of a term of the machine file what the file says. Lists are
/// judged as wholes ([`is_zero_within_confidence_region`]); a time constant may be 0.
fn is_zero_effect_within_intervals(part: &ModelPart, intervals: &[[f64; 2]]) -> bool {
    let holds = |[low, high]: [f64; 2], value: f64| !(value < low || value > high);
    if let Some(stated) = part.kind.as_stated_term() {
        let stated_values = stated.effect.values();
        return intervals
            .iter()
            .zip(&stated_values)
            .all(|(interval, value)| holds(*interval, *value));
    }
    // Waves have a phase as well, and a size by both of their values.
    if part.kind.list_length().is_some()
        || part.kind.is_periodic()
        || part.kind.is_instrument_error()
    {
        return false;
    }
    let nonlinear = part.kind.nonlinear_parameters();
    let sizes = &intervals[nonlinear.len()..];
    if sizes.is_empty() {
        let shifts = nonlinear.iter().zip(intervals);
        return shifts
            .filter(|(what, _)| **what == NonlinearParameter::Shift)
            .any(|(_, value)| holds(*value, 0.0));
    }
    sizes.iter().all(|size| holds(*size, 0.0))
}

/// Returns whether a list (a table, a spline) may be nothing: whether 0 for all of its values is in their common
/// region of 95 %, everything else of the model fitted with them.
///
/// ```text
/// vᵀ·C⁻¹·v ≤ k·F(95 %; k, independent rows less the fitted values)          k values, covariance C
/// ```
///
/// A list may predict held-out blocks by what is not its own: of a tilt whose lever ends 55 m away what is seen
/// is a curve, and the angle is anything.
fn is_zero_within_confidence_region(
    part: &ModelPart,
    index: usize,
    spread: &ParameterCovariance,
) -> bool {
    if part.kind.list_length().is_none() || part.kind.as_stated_term().is_some() {
        return false;
    }
    let sd = |at: usize| spread.covariance(at, at).max(0.0).sqrt();
    let values: Vec<(usize, f64)> = (part.kind.nonlinear_parameters().len()..part.values.len())
        .filter_map(|value| Some((spread.value_row(index, value)?, part.values[value])))
        .filter(|(at, _)| sd(*at) > 0.0)
        .collect();
    let count = values.len();
    // By correlations, whose rounding does not depend on units.
    let correlation = DMatrix::from_fn(count, count, |i, j| {
        let (a, b) = (values[i].0, values[j].0);
        spread.covariance(a, b) / (sd(a) * sd(b))
    });
    let lower = normal_equations::cholesky(correlation, &vec![1.0; count]);
    let mut scaled: Vec<f64> = values.iter().map(|(at, value)| value / sd(*at)).collect();
    normal_equations::forward_substitute(&lower, &mut scaled);
    let count = count as f64;
    FisherSnedecor::new(count, spread.freedom).is_ok_and(|f| {
        normal_equations::dot(&scaled, &scaled) <= count * f.inverse_cdf(CONFIDENCE_LEVEL)
    })
}

fn insert_estimate(map: &mut Map<String, Value>, name: &str, value: f64, mut ci95: [f64; 2]) {
    ci95.sort_unstable_by(f64::total_cmp);
    map.insert(name.into(), json!({"value": value, "ci95": ci95}));
}

fn value_to_json(value: &effect::Value) -> Value {
    match value {
        effect::Value::Number(number) => json!(number),
        effect::Value::Whole(number) => json!(number),
        effect::Value::Boolean(value) => json!(value),
        effect::Value::Text(text) => json!(text),
        effect::Value::Numbers(numbers) => json!(numbers),
        effect::Value::Wholes(numbers) => json!(numbers),
        effect::Value::Texts(texts) => json!(texts),
        effect::Value::Rows(rows) => json!(rows),
        effect::Value::Inline(entries) => {
            let entries = entries.iter().map(|(key, value)| (key.clone(), value_to_json(value)));
            Value::Object(entries.collect())
        }
    }
}

/// Seconds from row to row, or 1 where there is no time.
pub(crate) fn mean_row_interval_s(problem: &FitProblem) -> f64 {
    let data = &problem.data;
    if data.time_s().is_none() {
        return 1.0;
    }
    let [start, end] = problem.bounds.time_s;
    (end - start) / (data.recorded_row_count() as f64 / data.setting.files.len() as f64).max(1.0)
}

#[cfg(test)]
mod tests;
