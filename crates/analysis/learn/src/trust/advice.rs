//! The measurement to take after an alarm, by what was compared and by what the difference depends on.

use trueup_machine::{
    Machine, RunFile,
    file::{ElongationSource, LinearAxis},
};
use trueup_numerics::robust::median;

use super::Apart;

/// Half of the squares depend on it.
const DEPENDS: f64 = 0.7;
/// Standard deviations to which a reading is held about the middle.
const HELD: f64 = 4.0;

/// The two sides of a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Compared {
    /// A measured growth and the model of this source.
    Growth(Option<ElongationSource>),
    /// A measured error of an axis and its model.
    Axis(LinearAxis),
    /// The displacement sensor and the model of this source.
    Sensor(ElongationSource),
}

/// The variable that a difference depends on.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Cause {
    Nothing,
    Growth,
    Speed,
    Position,
    Direction,
}

/// Returns the measurement to take for a difference that began in the row `since`; `sigma_um`: the usual scatter.
pub(super) fn next(
    apart: &Apart,
    machine: &Machine,
    run: &RunFile,
    since: usize,
    sigma_um: f64,
) -> String {
    let there = apart.apart_um[since..].iter().copied().filter(|um| um.is_finite());
    let middle = median(&mut there.collect::<Vec<_>>());
    let held = HELD * sigma_um.max((middle / HELD).abs());
    let um: Vec<f64> =
        apart.apart_um[since..].iter().map(|um| um.clamp(middle - held, middle + held)).collect();
    let column = |name: &str| run.column(name).map(|values| values[since..].to_vec());
    let squared = |values: Vec<f64>| values.into_iter().map(|it| it * it).collect();
    let mut all = vec![
        (Cause::Growth, Some(apart.predicted_um[since..].to_vec())),
        (Cause::Speed, column("spindle_rpm").map(squared)),
    ];
    if let Compared::Axis(axis) = apart.compared {
        all.push((Cause::Position, column(&format!("{}_mm", axis.name()))));
        all.push((Cause::Direction, column(&format!("dir_{}", axis.name()))));
    }
    let with = all.into_iter().filter_map(|(cause, values)| {
        let with = correlation(&um, &values?).abs();
        (with >= DEPENDS).then_some((cause, with))
    });
    let cause = with.max_by(|a, b| a.1.total_cmp(&b.1)).map_or(Cause::Nothing, |it| it.0);
    let on = match cause {
        Cause::Nothing => "It is the same whatever the machine does",
        Cause::Growth => "It goes with the growth",
        Cause::Speed => "It goes with the speed",
        Cause::Position => "It goes with the position",
        Cause::Direction => "It goes with the direction of approach",
    };
    format!("{on}: {}", measurement(apart.compared, cause, machine))
}

/// Returns the measurement, by the source that the prediction comes from.
fn measurement(compared: Compared, cause: Cause, machine: &Machine) -> String {
    let thermometer = machine.spindle.temperature.as_ref().map_or("", |law| &law.sensor);
    let sits = |name: &str| format!("see that the thermometer {name} sits where it sat");
    let touch_off = "touch off the tool after a night at standstill";
    let warm_up = "record a warm-up from cold (trueup program warmup)";
    let speeds = "run several speeds and read the growth at each (trueup program warmup), then trueup diagnose.";
    match (compared, cause) {
        (Compared::Axis(axis), _) => axis_measurement(axis, cause, machine),
        (_, Cause::Speed) => speeds.into(),
        (Compared::Growth(Some(ElongationSource::Sensor) | None), Cause::Nothing) => {
            format!("read the sensor and {touch_off}, then trueup fit elongation.")
        }
        (Compared::Growth(Some(ElongationSource::Sensor) | None), _) => {
            format!("{warm_up}, then trueup fit or trueup diagnose.")
        }
        (Compared::Growth(Some(ElongationSource::Temperature)), Cause::Nothing) => {
            format!("{}, and {touch_off}.", sits(thermometer))
        }
        (Compared::Growth(Some(ElongationSource::Temperature)), _) => {
            format!("{}; then {warm_up}, then trueup diagnose.", sits(thermometer))
        }
        (Compared::Growth(Some(ElongationSource::Warmup)), Cause::Nothing) => {
            format!("{touch_off}: the warm-up model has no zero of its own.")
        }
        (Compared::Growth(Some(ElongationSource::Warmup)), _) => {
            format!("{warm_up}, then trueup fit warmup.")
        }
        (Compared::Sensor(model), _) => {
            let other = match model {
                ElongationSource::Temperature => sits(thermometer),
                _ => "record a warm-up from cold (trueup program warmup)".into(),
            };
            format!(
                "the sensor and the model differ, and only a measurement says which is off: read the sensor, {touch_off}, and {other}."
            )
        }
    }
}

/// Returns the measurement of an axis.
fn axis_measurement(axis: LinearAxis, cause: Cause, machine: &Machine) -> String {
    let thermal = machine.axes[axis.index()].thermal.as_ref();
    let sits = thermal
        .map(|it| format!(" See that the thermometer {} sits where it sat.", it.sensor))
        .unwrap_or_default();
    match cause {
        Cause::Nothing | Cause::Speed => {
            format!("measure the reference again and touch off after a night at standstill.{sits}")
        }
        Cause::Growth => {
            format!("measure the axis at two temperatures, then trueup fit thermal.{sits}")
        }
        Cause::Position => {
            format!(
                "measure the axis over its travel (trueup program pitch), then trueup fit pitch.{sits}"
            )
        }
        Cause::Direction => {
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
    let (mean_a, mean_b) = (mean(|it| it.0), mean(|it| it.1));
    let sum = |of: &dyn Fn(f64, f64) -> f64| {
        pairs.iter().map(|(a, b)| of(a - mean_a, b - mean_b)).sum::<f64>()
    };
    let size = (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt();
    if size > 0.0 { sum(&|a, b| a * b) / size } else { 0.0 }
}
