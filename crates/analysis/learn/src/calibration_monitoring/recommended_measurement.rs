//! The measurement to take after an alarm, by what was compared and by what the difference depends on.

use trueup_machine::{
    Machine, RunFile,
    machine_file::{ElongationSource, LinearAxis},
};
use trueup_numerics::robust::median;

use super::MonitoringResiduals;

/// Half of the squares depend on it.
const MIN_CAUSE_CORRELATION: f64 = 0.7;
/// Standard deviations to which a reading is held about the middle.
const CLIPPING_LIMIT_SIGMAS: f64 = 4.0;

/// The two sides of a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ComparisonKind {
    /// A measured growth and the model of this source.
    Growth(Option<ElongationSource>),
    /// A measured error of an axis and its model.
    Axis(LinearAxis),
    /// The displacement sensor and the model of this source.
    Sensor(ElongationSource),
}

/// The variable that a difference depends on.
#[derive(Clone, Copy, PartialEq, Eq)]
enum ExplanatoryVariable {
    Nothing,
    Growth,
    Speed,
    Position,
    Direction,
}

/// Returns the measurement to take for a difference that began in the row `since`; `sigma_um`: the usual scatter.
pub(super) fn recommend_next_measurement(
    apart: &MonitoringResiduals,
    machine: &Machine,
    run: &RunFile,
    since: usize,
    sigma_um: f64,
) -> String {
    let there = apart.apart_um[since..].iter().copied().filter(|um| um.is_finite());
    let middle = median(&mut there.collect::<Vec<_>>());
    let held = CLIPPING_LIMIT_SIGMAS * sigma_um.max((middle / CLIPPING_LIMIT_SIGMAS).abs());
    let um: Vec<f64> =
        apart.apart_um[since..].iter().map(|um| um.clamp(middle - held, middle + held)).collect();
    let column = |name: &str| run.column(name).map(|values| values[since..].to_vec());
    let squared = |values: Vec<f64>| values.into_iter().map(|value| value * value).collect();
    let mut all = vec![
        (ExplanatoryVariable::Growth, Some(apart.predicted_um[since..].to_vec())),
        (ExplanatoryVariable::Speed, column("spindle_rpm").map(squared)),
    ];
    if let ComparisonKind::Axis(axis) = apart.compared {
        all.push((ExplanatoryVariable::Position, column(&axis.column_name())));
        all.push((ExplanatoryVariable::Direction, column(&format!("dir_{}", axis.name()))));
    }
    let with = all.into_iter().filter_map(|(cause, values)| {
        let with = correlation(&um, &values?).abs();
        (with >= MIN_CAUSE_CORRELATION).then_some((cause, with))
    });
    let cause = with
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map_or(ExplanatoryVariable::Nothing, |entry| entry.0);
    let on = match cause {
        ExplanatoryVariable::Nothing => "It is the same whatever the machine does",
        ExplanatoryVariable::Growth => "It depends on the growth",
        ExplanatoryVariable::Speed => "It depends on the speed",
        ExplanatoryVariable::Position => "It depends on the position",
        ExplanatoryVariable::Direction => "It depends on the direction of approach",
    };
    format!("{on}: {}", recommend_measurement(apart.compared, cause, machine))
}

/// Returns the measurement, by the source that the prediction comes from.
fn recommend_measurement(
    compared: ComparisonKind,
    cause: ExplanatoryVariable,
    machine: &Machine,
) -> String {
    let thermometer = machine.spindle.temperature.as_ref().map_or("", |law| &law.sensor);
    let sits = |name: &str| format!("see that the thermometer {name} sits where it sat");
    let touch_off = "touch off the tool after a night at standstill";
    let warm_up = "record a warm-up from cold (trueup program warmup)";
    let speeds = "run several speeds and read the growth at each (trueup program warmup), then trueup diagnose.";
    match (compared, cause) {
        (ComparisonKind::Axis(axis), _) => recommend_axis_measurement(axis, cause, machine),
        (_, ExplanatoryVariable::Speed) => speeds.into(),
        (
            ComparisonKind::Growth(Some(ElongationSource::Sensor) | None),
            ExplanatoryVariable::Nothing,
        ) => {
            format!("read the sensor and {touch_off}, then trueup fit elongation.")
        }
        (ComparisonKind::Growth(Some(ElongationSource::Sensor) | None), _) => {
            format!("{warm_up}, then trueup fit or trueup diagnose.")
        }
        (
            ComparisonKind::Growth(Some(ElongationSource::Temperature)),
            ExplanatoryVariable::Nothing,
        ) => {
            format!("{}, and {touch_off}.", sits(thermometer))
        }
        (ComparisonKind::Growth(Some(ElongationSource::Temperature)), _) => {
            format!("{}; then {warm_up}, then trueup diagnose.", sits(thermometer))
        }
        (ComparisonKind::Growth(Some(ElongationSource::Warmup)), ExplanatoryVariable::Nothing) => {
            format!("{touch_off}: the warm-up model has no zero of its own.")
        }
        (ComparisonKind::Growth(Some(ElongationSource::Warmup)), _) => {
            format!("{warm_up}, then trueup fit warmup.")
        }
        (ComparisonKind::Sensor(model), _) => {
            let other = match model {
                ElongationSource::Temperature => sits(thermometer),
                _ => "record a warm-up from cold (trueup program warmup)".into(),
            };
            format!(
                "the sensor and the model differ, and only a measurement shows which is wrong: read the sensor, {touch_off}, and {other}."
            )
        }
    }
}

/// Returns the measurement of an axis.
fn recommend_axis_measurement(
    axis: LinearAxis,
    cause: ExplanatoryVariable,
    machine: &Machine,
) -> String {
    let thermal = machine.axes[axis.index()].thermal.as_ref();
    let sits = thermal
        .map(|thermal| format!(" See that the thermometer {} sits where it sat.", thermal.sensor))
        .unwrap_or_default();
    match cause {
        ExplanatoryVariable::Nothing | ExplanatoryVariable::Speed => {
            format!("measure the reference again and touch off after a night at standstill.{sits}")
        }
        ExplanatoryVariable::Growth => {
            format!("measure the axis at two temperatures, then trueup fit thermal.{sits}")
        }
        ExplanatoryVariable::Position => {
            format!(
                "measure the axis over its travel (trueup program pitch), then trueup fit pitch.{sits}"
            )
        }
        ExplanatoryVariable::Direction => {
            "measure the backlash (trueup program backlash), then trueup fit backlash.".into()
        }
    }
}

/// Returns the correlation of two columns.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let pairs: Vec<(f64, f64)> =
        a.iter().copied().zip(b.iter().copied()).filter(|(a, b)| (a + b).is_finite()).collect();
    let count = pairs.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / count;
    let (mean_a, mean_b) = (mean(|pair| pair.0), mean(|pair| pair.1));
    let sum = |of: &dyn Fn(f64, f64) -> f64| {
        pairs.iter().map(|(a, b)| of(a - mean_a, b - mean_b)).sum::<f64>()
    };
    let size = (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt();
    if size > 0.0 { sum(&|a, b| a * b) / size } else { 0.0 }
}
