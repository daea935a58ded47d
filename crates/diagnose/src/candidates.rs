//! Which causes the machine and the data allow, and where the search for each begins.
//!
//! A cause is only tried where its columns are there and vary. Nonlinear values are tried on a grid
//! (time constants in equal ratios, limits at quantiles of the prediction); the best point is then
//! refined with everything else by [`fit`](crate::fit).

use trueup_machine::machine_file::{Feedback, LinearAxis, Quantity, Source};

use crate::{
    columns::{SAID, named},
    data::Data,
    fit::Problem,
    model::{Kind, Model, own_thermal},
    waves,
};

/// A cause to try.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub kind: Kind,
    /// Nonlinear values to begin from; one empty list where there are none.
    pub settings: Vec<Vec<f64>>,
    /// ln of the number of settings that were looked at to find these.
    pub searched: f64,
}

/// Trials of a time constant.
const TIME_CONSTANTS: usize = 12;

/// All that may be added to `model`.
pub(crate) fn possible(problem: &Problem, model: &Model, residual: &[f64]) -> Vec<Candidate> {
    let mut all = Vec::new();
    let mut add = |kind: Kind, settings: Vec<Vec<f64>>| {
        if !settings.is_empty() && !model.has(&kind) {
            all.push(Candidate { kind, settings, searched: 0.0 });
        }
    };
    growth(problem, model, &mut add);
    axis(problem, model, &mut add);
    series(problem, model, &mut add);
    all.extend(waves::candidates(problem, model, residual));
    all
}

type Add<'a> = dyn FnMut(Kind, Vec<Vec<f64>>) + 'a;

fn growth(problem: &Problem, model: &Model, add: &mut Add<'_>) {
    let data = &problem.data;
    let none = || vec![Vec::new()];
    let spindle = &data.machine.spindle;
    let elongates = data.has_elongation && data.along.iter().any(|along| along.abs() > 0.1);
    let source = if elongates { spindle.source } else { None };
    let is_elongation = data.quantity == Quantity::Elongation;
    let taus = || time_constants(problem, TIME_CONSTANTS);
    let lag_taus = || if data.time_s.is_some() { taus() } else { Vec::new() };
    // Where a constant is corrected by a factor, the next point of a coarse grid may be worse than
    // none.
    let fine_taus = || match data.time_s {
        Some(_) => time_constants(problem, 3 * TIME_CONSTANTS),
        None => Vec::new(),
    };
    if is_elongation && model.constant_um.is_none() {
        add(Kind::SensorOffset, none());
    }
    let varies = |p: &[f64]| spread_of(p) > 0.0;
    if source == Some(Source::Sensor) && varies(&data.elongation) {
        add(Kind::SensorGain, none());
        add(Kind::SensorCurvature, none());
        add(Kind::SensorSaturation, quantiles(&data.elongation));
        let own = spindle.sensor.as_ref().and_then(|sensor| sensor.temperature.clone());
        if let Some(column) = own.filter(|column| varying(data, column)) {
            add(Kind::SensorTemperatureDrift { column }, none());
        }
    }
    let thermal = own_thermal(data).filter(|thermal| varying(data, &thermal.sensor));
    let lag_now = model.parts.iter().any(|part| part.kind == Kind::ThermalLag);
    if (source == Some(Source::Temperature) && thermal.is_none()) || thermal.is_some() {
        let believed_s = match thermal {
            Some(thermal) => thermal.lag_s,
            None => spindle.temperature.as_ref().map_or(0.0, |model| model.lag_s),
        };
        add(Kind::ThermalLag, if believed_s > 0.0 { fine_taus() } else { lag_taus() });
        if believed_s > 0.0 || lag_now {
            add(Kind::CoolingAsymmetry, fine_taus());
        }
    }
    if matches!(source, Some(Source::Temperature | Source::Warmup)) && varies(&data.elongation) {
        add(Kind::GrowthAmplitude, none());
    }
    if source == Some(Source::Warmup) {
        add(Kind::GrowthRate, fine_taus());
        if data.spindle_rpm.as_ref().is_some_and(|rpm| rpm.contains(&0.0)) {
            add(Kind::CoolingAsymmetry, fine_taus());
        }
    }
    // Heat is looked for where something grows: in a spindle, or in an axis that is believed to.
    let used = columns_in_use(data, model);
    if is_elongation || !data.temperatures.is_empty() {
        for (column, _) in &data.temperatures {
            if !varying(data, column) {
                continue;
            }
            let sensor = spindle.sensor.as_ref().and_then(|sensor| sensor.temperature.as_ref());
            if source == Some(Source::Sensor) && sensor == Some(column) {
                continue;
            }
            let column = column.clone();
            if used.contains(&column) {
                add(Kind::SlowModeOf { column }, lag_taus());
            } else {
                add(Kind::ExtraHeatPath { column: column.clone(), has_lag: false }, none());
                add(Kind::ExtraHeatPath { column, has_lag: true }, lag_taus());
            }
        }
    }
    if is_elongation && data.time_s.is_some() {
        add(Kind::SlowMode, taus());
    }
    if elongates || is_elongation {
        if varying(data, "spindle_rpm") {
            add(Kind::CentrifugalGrowth, none());
        }
        if varying(data, "load_n") {
            add(Kind::CuttingLoad, none());
        }
    }
}

/// The temperatures that the model goes by already.
pub(crate) fn columns_in_use(data: &Data, model: &Model) -> Vec<String> {
    let spindle = &data.machine.spindle;
    let mut used = Vec::new();
    if data.has_elongation && spindle.source == Some(Source::Temperature) {
        used.extend(spindle.temperature.as_ref().map(|model| model.sensor.clone()));
    }
    used.extend(own_thermal(data).map(|thermal| thermal.sensor.clone()));
    for part in &model.parts {
        if let Kind::ExtraHeatPath { column, .. } = &part.kind {
            used.push(column.clone());
        }
    }
    used
}

fn axis(problem: &Problem, model: &Model, add: &mut Add<'_>) {
    let data = &problem.data;
    let Some(own_axis) = data.quantity.axis() else { return };
    let none = || vec![Vec::new()];
    if let Some(thermal) = own_thermal(data) {
        let moves = data.own_position().is_some_and(|mm| spread_of(mm) > 0.0);
        if thermal.mode.has_position() && moves && varying(data, &thermal.sensor) {
            if thermal.table.is_none() {
                add(Kind::ExpansionSlope, none());
            }
            add(Kind::ReferenceTemperature, none());
        }
    }
    for other in LinearAxis::ALL.into_iter().filter(|&other| other != own_axis) {
        let column = format!("{}_mm", other.name());
        if varying(data, &column) {
            add(Kind::CrossAxis { axis: other }, none());
            let at = named(data, &column).unwrap_or(&[]);
            for controls in [5, 8, 12, 20] {
                if places(at) >= controls + 2 && problem.groups.len() >= 5 * controls {
                    let knots_mm = even_knots(at, controls);
                    add(Kind::Straightness { along: other, knots_mm }, none());
                }
            }
        }
    }
    let Some(own) = data.own_position().filter(|own| spread_of(own) > 0.0) else { return };
    add(Kind::PitchScale, none());
    let turns = data.own_direction().is_some_and(|d| d.contains(&1.0) && d.contains(&-1.0));
    let has_screw = data.machine.axes[own_axis.index()].feedback == Feedback::Screw;
    if turns && has_screw {
        add(Kind::Backlash, none());
        add(Kind::PositionDependentBacklash, none());
    }
    let has_table = model.parts.iter().any(|part| matches!(part.kind, Kind::PitchError { .. }));
    if !has_table {
        for (start_mm, step_mm, points) in tables(own, problem.groups.len()) {
            for both_ways in [false, true] {
                if (!both_ways || turns) && points >= 3 {
                    let kind = Kind::PitchError { start_mm, step_mm, points, both_ways };
                    add(kind, none());
                }
            }
        }
    }
}

fn series(problem: &Problem, model: &Model, add: &mut Add<'_>) {
    let data = &problem.data;
    if data.time_s.is_none() {
        return;
    }
    let [start_s, end_s] = problem.bounds.time_s;
    add(Kind::Drift, vec![Vec::new()]);
    if data.files == 1 && !model.parts.iter().any(|part| part.kind == Kind::Step) {
        let groups = problem.groups.len();
        let every = (groups / 50).max(1);
        let times = data.time_s.as_deref().unwrap_or(&[]);
        let at = (every..groups.saturating_sub(3))
            .step_by(every)
            .map(|group| vec![times[problem.groups.first_row[group]]])
            .filter(|at| at[0] > start_s);
        add(Kind::Step, at.collect());
    }
    let p = Model::default().predict(data);
    if spread_of(&p) > 0.0 {
        let step_s = (end_s - start_s) * data.files as f64 / data.rows.max(2) as f64;
        let mut shifts = Vec::new();
        let mut size = step_s;
        while size <= 30.0 * step_s && size < 0.05 * (end_s - start_s) {
            shifts.extend([vec![size], vec![-size]]);
            size *= 1.6;
        }
        add(Kind::TimeShift, shifts);
    }
}

/// Curves over each column: no causes, but tests of structure. Beside them what no single column
/// shows: a curve over one position that grows with another (an angle of a guide, times an arm), a
/// growth that is another one at other speeds, what comes and goes after a reversal.
pub(crate) fn structure(problem: &Problem) -> Vec<Candidate> {
    let data = &problem.data;
    let mut all = Vec::new();
    let own = data.quantity.axis().map(|axis| format!("{}_mm", axis.name()));
    let turns = data.own_direction().is_some_and(|d| d.contains(&1.0) && d.contains(&-1.0));
    let mut add = |column: &str, by_direction: bool, times: Option<&str>| {
        let Some(values) = named(data, column).filter(|_| varying(data, column)) else { return };
        if times.is_some_and(|times| !varying(data, times)) {
            return;
        }
        // A guide's form has more bends than a characteristic.
        let most = match column {
            _ if by_direction => 9,
            "x_mm" | "y_mm" | "z_mm" => 16,
            "spindle_rpm" => 10,
            _ if data.reversal_decay.iter().any(|(reversal, _)| reversal == column) => 2,
            _ => 6,
        };
        let knots = curve_knots(values, most);
        // Over one of the file's columns a curve with two knots is a straight line, which is a cause.
        let least = if times.is_some() || most == 2 { 2 } else { 3 };
        if knots.len() >= least {
            let (column, times) = (column.to_string(), times.map(String::from));
            let kind = Kind::Curve { column, knots, by_direction, times };
            all.push(Candidate { kind, settings: vec![Vec::new()], searched: 0.0 });
        }
    };
    const POSITIONS: [&str; 3] = ["x_mm", "y_mm", "z_mm"];
    let temperatures = data.temperatures.iter().map(|(name, _)| name.as_str());
    let others = data.others.iter().map(|(name, _)| name.as_str());
    for column in temperatures.chain(others).chain(["spindle_rpm", "load_n", SAID]).chain(POSITIONS)
    {
        add(column, false, None);
        if turns && own.as_deref() == Some(column) {
            add(column, true, None);
        }
    }
    add("spindle_rpm", false, Some(SAID));
    for (reversal, _) in &data.reversal_decay {
        add(reversal, false, None);
    }
    for (column, arm) in POSITIONS.iter().flat_map(|a| POSITIONS.map(|b| (*a, b))) {
        if column != arm {
            add(column, false, Some(arm));
        }
    }
    all
}

/// Knots at quantiles, no two alike.
fn curve_knots(values: &[f64], most: usize) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    if sorted.is_empty() {
        return Vec::new();
    }
    let mut knots: Vec<f64> =
        (0..most).map(|n| sorted[n * (sorted.len() - 1) / (most - 1)]).collect();
    let least = 1e-3 * (sorted[sorted.len() - 1] - sorted[0]);
    knots.dedup_by(|a, b| *a - *b <= least);
    knots
}

fn spread_of(values: &[f64]) -> f64 {
    let finite = || values.iter().copied().filter(|value| value.is_finite());
    let (low, high) = finite().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if high > low { high - low } else { 0.0 }
}

fn varying(data: &Data, column: &str) -> bool {
    named(data, column).is_some_and(|values| spread_of(values) > 0.0)
}

/// Time constants in equal ratios, from the row spacing to what the longest series can show.
fn time_constants(problem: &Problem, count: usize) -> Vec<Vec<f64>> {
    let [low, high] = problem.bounds.time_constant_s;
    // What is within one group is not seen apart.
    let low = low.max(2.0 * low * problem.groups.size as f64);
    let high = 0.5 * high;
    if high.partial_cmp(&low) != Some(std::cmp::Ordering::Greater) {
        return Vec::new();
    }
    let ratio = (high / low).powf(1.0 / (count - 1) as f64);
    (0..count).map(|n| vec![low * ratio.powi(n as i32)]).collect()
}

fn quantiles(values: &[f64]) -> Vec<Vec<f64>> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share) as usize];
    if sorted.len() < 8 {
        return Vec::new();
    }
    [0.2, 0.35, 0.5, 0.6, 0.7, 0.78, 0.84, 0.9, 0.94, 0.97].map(|share| vec![at(share)]).to_vec()
}

/// How many places there are, apart by more than a thousandth of the travel.
fn places(values: &[f64]) -> usize {
    targets(values, 1e-3).len()
}

/// The places that the positions stand at, sorted, nearer ones than `share` of the travel as one.
fn targets(values: &[f64], share: f64) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let least = share * spread_of(values);
    let mut targets: Vec<(f64, f64)> = Vec::new();
    for value in sorted {
        match targets.last_mut() {
            Some((sum, count)) if value - *sum / *count <= least => {
                *sum += value;
                *count += 1.0;
            }
            _ => targets.push((value, 1.0)),
        }
    }
    targets.into_iter().map(|(sum, count)| sum / count).collect()
}

/// Tables (start, step, points) that the positions allow: at the targets where these are few and
/// evenly spaced, else even ones of growing fineness.
fn tables(own: &[f64], groups: usize) -> Vec<(f64, f64, usize)> {
    let at = targets(own, 2e-3);
    let (Some(&first), Some(&last)) = (at.first(), at.last()) else { return Vec::new() };
    let even = (last - first) / (at.len() as f64 - 1.0);
    let is_even = at.windows(2).all(|pair| ((pair[1] - pair[0]) - even).abs() < 0.05 * even.abs());
    if is_even && at.len() >= 3 && at.len() <= 80 && groups >= 3 * at.len() {
        return vec![(first, even, at.len())];
    }
    [6, 11, 21, 41]
        .into_iter()
        .filter(|&points| groups >= 8 * points && at.len() >= points)
        .map(|points| (first, (last - first) / (points - 1) as f64, points))
        .collect()
}

fn even_knots(values: &[f64], controls: usize) -> Vec<f64> {
    let at = targets(values, 1e-3);
    let (low, high) = (at[0], at[at.len() - 1]);
    let spans = controls - 3;
    let mut knots = vec![low; 4];
    knots.extend((1..spans).map(|n| low + (high - low) * n as f64 / spans as f64));
    knots.extend([high; 4]);
    knots
}
