//! All terms at once to all rows: least squares by Gauss, Newton, Levenberg and Marquardt.
//!
//! Plain least squares on purpose, also where the noise has a memory: weights that follow the noise
//! trust the quick part of a misfit and predict worse where the model is not quite right (measured on
//! `spindle_sjtu`: a path that halves the error of the hold-out looks worthless to them). The memory
//! is in the intervals instead: the sandwich (XᵀX)⁻¹·Xᵀ·V·X·(XᵀX)⁻¹ with the noise's covariance V.

use std::{
    collections::{HashMap, VecDeque},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use trueup_machine::machine_file::Source;
use trueup_numerics::{
    least_squares::normal::{dot, solve},
    noise::{self, Noise},
};

use crate::{
    columns::basis,
    data::{Data, Groups},
    model::{Kind, Model, Part, Scale, own_thermal, shifted_rows},
};

/// A fitted model, and what it leaves.
#[derive(Clone, Debug)]
pub(crate) struct Fitted {
    pub model: Model,
    /// Measured minus predicted, in groups.
    pub residual: Vec<f64>,
    /// Σ residual² over the groups that were fitted to.
    pub sum: f64,
    /// How many values were fitted.
    pub degrees: usize,
}

impl Fitted {
    pub(crate) fn rms(&self) -> f64 {
        (dot(&self.residual, &self.residual) / self.residual.len().max(1) as f64).sqrt()
    }
}

/// Data, and its groups of rows.
pub(crate) struct Problem {
    pub data: Data,
    pub groups: Groups,
    /// What was measured, in groups.
    pub measured: Vec<f64>,
    /// Bounds that a value must keep, from the extent of the data.
    pub bounds: Bounds,
    known: Mutex<Known>,
}

/// Columns side by side, in groups.
pub(crate) type Columns = Arc<Vec<Vec<f64>>>;

/// What was worked out before: what is only added does not depend on the model, and the rest of a
/// model often stays while what is added changes.
#[derive(Debug, Default)]
struct Known {
    /// Of the settings that every scan tries.
    kept: HashMap<String, Columns>,
    /// Numbers in them.
    numbers: usize,
    /// Of values on the way of a fit, the newest last.
    recent: VecDeque<(String, Columns)>,
    recent_numbers: usize,
    /// A model that is late, and what it would predict of each row if it were not.
    unshifted: Option<(Model, Arc<Vec<f64>>)>,
}

impl Known {
    /// More numbers would only be memory: 80 MB and 16 MB.
    const MOST: usize = 10_000_000;
    const MOST_RECENT: usize = 2_000_000;

    fn get(&self, key: &str) -> Option<Columns> {
        let recent = || self.recent.iter().rev().find(|(there, _)| there == key).map(|(_, it)| it);
        self.kept.get(key).or_else(recent).cloned()
    }

    fn put(&mut self, key: String, columns: Columns, keep: bool) {
        let size = columns.iter().map(Vec::len).sum::<usize>();
        if keep && self.numbers + size < Self::MOST {
            self.numbers += size;
            self.kept.insert(key, columns);
            return;
        }
        self.recent_numbers += size;
        self.recent.push_back((key, columns));
        while self.recent_numbers > Self::MOST_RECENT {
            let Some((_, oldest)) = self.recent.pop_front() else { break };
            self.recent_numbers -= oldest.iter().map(Vec::len).sum::<usize>();
        }
    }
}

/// What nonlinear values may be.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    /// Time constants, in s.
    pub time_constant_s: [f64; 2],
    /// Times of the record, in s.
    pub time_s: [f64; 2],
    /// Periods, in mm.
    pub period_mm: [f64; 2],
    /// The model's prediction, in µm.
    pub prediction_um: [f64; 2],
}

impl Problem {
    /// Rows that are worth several cores for a fit.
    const MANY_GROUPS: usize = 500;

    /// Whether a fit takes long enough for a core of its own.
    pub(crate) fn is_large(&self) -> bool {
        self.groups.len() >= Self::MANY_GROUPS
    }

    pub(crate) fn new(data: Data, groups: Groups) -> Self {
        let measured = groups.means(&data.measured);
        let bounds = bounds(&data, &groups);
        Self { data, groups, measured, bounds, known: Mutex::default() }
    }

    /// What an added part of these nonlinear values adds at each amplitude of 1, in groups. `keep`:
    /// they will be asked for again and again.
    pub(crate) fn columns(&self, kind: &Kind, nonlinear: &[f64], keep: bool) -> Columns {
        let bits: Vec<u64> = nonlinear.iter().map(|value| value.to_bits()).collect();
        let key = format!("{kind:?}{bits:?}");
        if let Some(known) = self.known().get(&key) {
            return known;
        }
        let is_of_elongation = kind.is_of_elongation(&self.data);
        let columns: Vec<Vec<f64>> = basis(kind, nonlinear, &self.data, &[])
            .into_iter()
            .map(|mut column| {
                if is_of_elongation {
                    column.iter_mut().zip(&self.data.along).for_each(|(c, along)| *c *= along);
                }
                self.groups.means(&column)
            })
            .collect();
        let columns = Arc::new(columns);
        self.known().put(key, columns.clone(), keep);
        columns
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What `model` predicts, in groups.
    pub(crate) fn predicted(&self, model: &Model) -> Vec<f64> {
        if let Some(shift_s) = model.shift_s() {
            let unshifted = self.unshifted(model);
            return self.groups.means(&shifted_rows(&self.data, &unshifted, shift_s));
        }
        let (added, law): (Vec<&Part>, Vec<&Part>) =
            model.parts.iter().partition(|part| part.kind.is_added());
        let mut sum = self.of_law(&law)[0].clone();
        for part in added {
            let (nonlinear, amplitudes) = part.values.split_at(part.kind.nonlinear().len());
            let columns = self.columns(&part.kind, nonlinear, nonlinear.is_empty());
            for (column, amplitude) in columns.iter().zip(amplitudes) {
                sum.iter_mut().zip(column).for_each(|(sum, c)| *sum += amplitude * c);
            }
        }
        let constant = model.constant_um.unwrap_or(0.0);
        sum.iter_mut().for_each(|sum| *sum += constant);
        sum
    }

    /// What the model predicts with these parts alone, which are not only added: one column.
    fn of_law(&self, law: &[&Part]) -> Columns {
        let bits: Vec<Vec<u64>> = law
            .iter()
            .map(|part| part.values.iter().map(|value| value.to_bits()).collect())
            .collect();
        let kinds: Vec<&Kind> = law.iter().map(|part| &part.kind).collect();
        let key = format!("{kinds:?}{bits:?}");
        if let Some(known) = self.known().get(&key) {
            return known;
        }
        let model = Model { parts: law.iter().copied().cloned().collect(), constant_um: None };
        let predicted = Arc::new(vec![self.groups.means(&model.predict(&self.data))]);
        self.known().put(key, predicted.clone(), false);
        predicted
    }

    /// What the model would predict if nothing were late, in the rows of the whole.
    fn unshifted(&self, model: &Model) -> Arc<Vec<f64>> {
        let mut plain = model.clone();
        plain.parts.retain(|part| part.kind != Kind::TimeShift);
        if let Some((there, predicted)) = &self.known().unshifted
            && *there == plain
        {
            return predicted.clone();
        }
        let predicted = Arc::new(plain.unshifted(self.data.whole()));
        self.known().unshifted = Some((plain, predicted.clone()));
        predicted
    }

    /// The same, as if `measured` (in groups) had been measured.
    pub(crate) fn measuring(&self, measured: Vec<f64>) -> Self {
        Self {
            data: self.data.clone(),
            groups: self.groups.clone(),
            measured,
            bounds: self.bounds,
            known: Mutex::default(),
        }
    }

    /// Whether a time constant is so short that the record shows all of it: three of them pass at
    /// least five times over.
    pub(crate) fn is_short(&self, time_constant_s: f64) -> bool {
        15.0 * time_constant_s < self.bounds.time_constant_s[1] / 3.0
    }

    /// Measured minus predicted, in groups.
    pub(crate) fn residual(&self, model: &Model) -> Vec<f64> {
        let predicted = self.predicted(model);
        self.measured.iter().zip(predicted).map(|(m, p)| m - p).collect()
    }

    /// The time constant with which the model's own heat rises.
    fn rise_s(&self, model: &Model) -> Option<f64> {
        let replaced = model.parts.iter().find_map(|part| {
            matches!(part.kind, Kind::ThermalLag | Kind::GrowthRate).then_some(part.values[0])
        });
        let spindle = &self.data.machine.spindle;
        let believed = match (own_thermal(&self.data), spindle.source) {
            (Some(thermal), _) => Some(thermal.lag_s),
            (None, Some(Source::Temperature)) => spindle.temperature.as_ref().map(|it| it.lag_s),
            (None, Some(Source::Warmup)) => {
                spindle.warmup.as_ref().map(trueup_machine::machine_file::Warmup::time_constant_s)
            }
            _ => None,
        };
        replaced.or(believed).filter(|rise_s| *rise_s > 0.0)
    }

    /// Whether all values of the model are physically possible and inside what the data can show.
    fn keep(&self, model: &mut Model) {
        let rise_s = self.rise_s(model);
        for part in &mut model.parts {
            // What cools more than five times faster or slower than it warms is not the same heat.
            if let (Kind::CoolingAsymmetry, Some(rise_s)) = (&part.kind, rise_s) {
                part.values[0] = part.values[0].clamp(0.2 * rise_s, 5.0 * rise_s);
            }
            let held = |value: &mut f64, [low, high]: [f64; 2]| *value = value.clamp(low, high);
            match part.kind {
                _ if part.kind.has_time_constant() => {
                    held(&mut part.values[0], self.bounds.time_constant_s);
                }
                Kind::TimeShift => {
                    // Clocks that differ by more are not a matter of two clocks.
                    let [low, high] = self.bounds.time_s;
                    let rows = self.data.rows as f64 / self.data.files as f64;
                    let most = (high - low) * (40.0 / rows).min(0.1);
                    held(&mut part.values[0], [-most, most]);
                }
                Kind::SensorSaturation => {
                    held(&mut part.values[0], self.bounds.prediction_um);
                }
                Kind::PitchPeriodic { .. } => held(&mut part.values[0], self.bounds.period_mm),
                // A gain that turns the sign, or is off by more than a factor of five, is another
                // machine's.
                Kind::SensorGain => held(&mut part.values[0], [-0.8, 4.0]),
                // A growth that is not within a factor of two of what is believed is not the same
                // growth: another path carries it.
                Kind::GrowthAmplitude => held(&mut part.values[0], [-0.5, 1.0]),
                _ => {}
            }
        }
    }
}

fn bounds(data: &Data, groups: &Groups) -> Bounds {
    let extent = |values: &mut dyn Iterator<Item = f64>| {
        values
            .filter(|value| value.is_finite())
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
                [low.min(value), high.max(value)]
            })
    };
    let finite =
        |[low, high]: [f64; 2], none: [f64; 2]| if low < high { [low, high] } else { none };
    let time_s = data
        .time_s
        .as_ref()
        .map_or([0.0, 1.0], |times| finite(extent(&mut times.iter().copied()), [0.0, 1.0]));
    // The longest of the series: what is slower than that is not seen.
    let longest_s = data.time_s.as_ref().map_or(1.0, |times| {
        let mut longest: f64 = 0.0;
        let mut start = 0;
        for row in 1..=data.rows {
            if row == data.rows || data.restart[row] {
                let range = extent(&mut times[start..row].iter().copied());
                longest = longest.max(range[1] - range[0]);
                start = row;
            }
        }
        if longest > 0.0 { longest } else { 1.0 }
    });
    let step_s = longest_s * data.files as f64 / (data.rows as f64).max(2.0);
    let own = data.own_position();
    let range = own.map_or([0.0, 1.0], |mm| finite(extent(&mut mm.iter().copied()), [0.0, 1.0]));
    let prediction = Model::default().predict(data);
    let prediction_um = finite(extent(&mut prediction.iter().copied()), [0.0, 1.0]);
    Bounds {
        time_constant_s: [0.2 * step_s, 3.0 * longest_s],
        time_s,
        period_mm: [
            (range[1] - range[0]) / groups.len().max(2) as f64,
            0.7 * (range[1] - range[0]),
        ],
        prediction_um,
    }
}

/// Which value of which part a column of the Jacobian belongs to; none: the constant.
pub(crate) type Place = Option<(usize, usize)>;

/// The change of the prediction with each value (in groups); logarithmic values by their logarithm.
pub(crate) fn jacobian(problem: &Problem, model: &Model) -> (Vec<Place>, Vec<Vec<f64>>) {
    let mut places: Vec<Place> = Vec::new();
    let mut columns = Vec::new();
    let has_shift = model.has(&Kind::TimeShift);
    let mut here: Option<Vec<f64>> = None;
    for (index, part) in model.parts.iter().enumerate() {
        let (kind, nonlinear) = (&part.kind, part.kind.nonlinear());
        let step = |number: usize| {
            let is_log = nonlinear.get(number) == Some(&Scale::Logarithmic);
            let value = part.values[number];
            let step = derivative_step(problem, kind, value, is_log);
            (step, if is_log { value * step.exp() } else { value + step })
        };
        // What is only added is its own derivative.
        if kind.is_added() && !has_shift {
            let (values, amplitudes) = part.values.split_at(nonlinear.len());
            let unit = problem.columns(kind, values, nonlinear.is_empty());
            for (number, column) in unit.iter().enumerate() {
                places.push(Some((index, nonlinear.len() + number)));
                columns.push(column.clone());
            }
            for number in 0..nonlinear.len() {
                let (step, there) = step(number);
                let mut moved = values.to_vec();
                moved[number] = there;
                let moved = problem.columns(kind, &moved, false);
                let mut column = vec![0.0; problem.groups.len()];
                for ((unit, moved), amplitude) in unit.iter().zip(&*moved).zip(amplitudes) {
                    for ((sum, u), m) in column.iter_mut().zip(unit).zip(moved) {
                        *sum += amplitude * (m - u) / step;
                    }
                }
                places.push(Some((index, number)));
                columns.push(column);
            }
            continue;
        }
        for number in 0..part.values.len() {
            let (step, there) = step(number);
            let mut moved = model.clone();
            moved.parts[index].values[number] = there;
            let base = here.get_or_insert_with(|| problem.predicted(model));
            let there = problem.predicted(&moved);
            let column = there.iter().zip(base.iter()).map(|(t, b)| (t - b) / step).collect();
            places.push(Some((index, number)));
            columns.push(column);
        }
    }
    if model.constant_um.is_some() {
        places.push(None);
        columns.push(vec![1.0; problem.groups.len()]);
    }
    (places, columns)
}

fn derivative_step(problem: &Problem, kind: &Kind, value: f64, is_log: bool) -> f64 {
    let [start_s, end_s] = problem.bounds.time_s;
    match kind {
        Kind::PitchPeriodic { .. } | Kind::ReferenceInstrument { .. } if is_log => 1e-7,
        _ if is_log => 1e-4,
        Kind::TimeShift => 0.05 * (end_s - start_s) / problem.data.rows as f64,
        Kind::SensorSaturation => {
            1e-4 * (problem.bounds.prediction_um[1] - problem.bounds.prediction_um[0])
        }
        _ => 1e-6 * value.abs().max(1e-3),
    }
}

/// A value of a list that nothing determines, and the one of the same list that stands for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Held {
    part: usize,
    value: usize,
    by: usize,
}

/// The values of tables and splines that the groups in `mask` do not determine: their columns are
/// hardly ever more than 0, because the axis was hardly ever there. Fitted to the hundredth of a
/// reading such a value would be anything, and wrong by as much where it is needed. The nearest
/// value that is determined stands for it.
fn held(model: &Model, places: &[Place], columns: &[Vec<f64>], mask: Option<&[bool]>) -> Vec<Held> {
    // Of the squares of the column that has most: a hundredth of a reading beside one.
    const HARDLY: f64 = 1e-4;
    let squares = |column: &Vec<f64>| match mask {
        None => dot(column, column),
        Some(mask) => column.iter().zip(mask).filter(|(_, used)| **used).map(|(c, _)| c * c).sum(),
    };
    let mut all = Vec::new();
    for (part, it) in model.parts.iter().enumerate() {
        let Some(length) = it.kind.list_length() else { continue };
        for start in (0..it.values.len()).step_by(length) {
            let column = |value: usize| {
                let at = places.iter().position(|place| *place == Some((part, value)));
                at.map_or(0.0, |at| squares(&columns[at]))
            };
            let own: Vec<f64> = (start..start + length).map(column).collect();
            let least = HARDLY * own.iter().copied().fold(0.0, f64::max);
            let is_known = |n: &usize| own[*n] > least;
            for n in (0..own.len()).filter(|n| !is_known(n)) {
                let nearest = (0..own.len()).filter(is_known).min_by_key(|there| there.abs_diff(n));
                if let Some(nearest) = nearest {
                    all.push(Held { part, value: start + n, by: start + nearest });
                }
            }
        }
    }
    all
}

fn hold(model: &mut Model, held: &[Held]) {
    for it in held {
        let values = &mut model.parts[it.part].values;
        values[it.value] = values[it.by];
    }
}

/// Fits all values of `model` by least squares over the groups in `mask` (all where there is none).
/// The time of a step is not moved: it is searched, not fitted.
pub(crate) fn fit(problem: &Problem, model: &Model, mask: Option<&[bool]>) -> Fitted {
    // From the fit to all, the fit to most is near.
    let iterations = if mask.is_some() { 6 } else { 25 };
    let masked = |residual: &[f64]| match mask {
        None => dot(residual, residual),
        Some(mask) => {
            residual.iter().zip(mask).filter(|(_, used)| **used).map(|(r, _)| r * r).sum()
        }
    };
    let mut model = model.clone();
    problem.keep(&mut model);
    let mut residual = problem.residual(&model);
    let mut sum = masked(&residual);
    let mut damping: f64 = 0.0;
    let is_linear = model.parts.iter().all(|part| {
        let nonlinear = part.kind.nonlinear().len();
        part.kind.is_added() && (nonlinear == 0 || part.kind == Kind::Step)
    });
    let mut degrees = 0;
    for _ in 0..if is_linear { 1 } else { iterations } {
        let (mut places, mut columns) = jacobian(problem, &model);
        let held = held(&model, &places, &columns, mask);
        if !held.is_empty() {
            hold(&mut model, &held);
            residual = problem.residual(&model);
            sum = masked(&residual);
        }
        let is_fitted = |place: &Place| {
            place.is_none_or(|(part, value)| {
                let is_step = model.parts[part].kind == Kind::Step && value == 0;
                !is_step && !held.iter().any(|it| (it.part, it.value) == (part, value))
            })
        };
        let fitted: Vec<bool> = places.iter().map(is_fitted).collect();
        keep_only(&mut places, &fitted);
        keep_only(&mut columns, &fitted);
        degrees = places.len();
        let mut improved = false;
        for _ in 0..6 {
            let solution = solve(&columns, &residual, mask, damping);
            let mut moved = model.clone();
            for (place, change) in places.iter().zip(&solution.coefficients) {
                match place {
                    None => moved.constant_um = Some(moved.constant_um.unwrap_or(0.0) + change),
                    Some((part, value)) => {
                        let part = &mut moved.parts[*part];
                        let is_log = part.kind.nonlinear().get(*value) == Some(&Scale::Logarithmic);
                        let value = &mut part.values[*value];
                        if is_log {
                            // At most by a factor e² at once.
                            *value *= change.clamp(-2.0, 2.0).exp();
                        } else {
                            *value += change;
                        }
                    }
                }
            }
            hold(&mut moved, &held);
            problem.keep(&mut moved);
            let there = problem.residual(&moved);
            let there_sum = masked(&there);
            if there_sum <= sum {
                improved = sum - there_sum > 1e-6 * sum;
                (model, residual, sum) = (moved, there, there_sum);
                damping *= 0.2;
                if damping < 1e-9 {
                    damping = 0.0;
                }
                break;
            }
            damping = if damping == 0.0 { 1e-3 } else { damping * 8.0 };
        }
        if !improved {
            break;
        }
    }
    Fitted { model, residual, sum, degrees }
}

fn keep_only<T>(list: &mut Vec<T>, kept: &[bool]) {
    let mut kept = kept.iter();
    list.retain(|_| kept.next().is_some_and(|kept| *kept));
}

/// The standard deviations of the fitted values, under noise of this memory: logarithmic ones of the
/// logarithm.
pub(crate) struct Spread {
    /// Without values that nothing determines.
    pub places: Vec<Place>,
    pub covariance: Vec<Vec<f64>>,
    /// Independent rows less the fitted values.
    pub freedom: f64,
}

pub(crate) fn spread(problem: &Problem, fitted: &Fitted, noise: Noise) -> Spread {
    let (mut places, mut columns) = jacobian(problem, &fitted.model);
    let held = held(&fitted.model, &places, &columns, None);
    let known: Vec<bool> = places
        .iter()
        .map(|place| !held.iter().any(|it| *place == Some((it.part, it.value))))
        .collect();
    keep_only(&mut places, &known);
    keep_only(&mut columns, &known);
    let steps = &problem.groups.steps;
    let solution = solve(&columns, &fitted.residual, None, 0.0);
    let rows = fitted.residual.len() as f64;
    let effective = noise::effective_rows(noise, steps);
    // Noise that is used up by the fit is given back, as much of it as was independent.
    let freedom = (rows - columns.len() as f64).max(1.0);
    let slow_share = (1.0 - noise.white) * columns.len() as f64 / effective.max(1.0);
    let variance = fitted.sum / freedom / (1.0 - slow_share.min(0.5));
    let weighted: Vec<Vec<f64>> =
        columns.iter().map(|column| noise::covariance_times(noise, steps, column)).collect();
    let count = columns.len();
    let middle: Vec<Vec<f64>> =
        (0..count).map(|i| (0..count).map(|j| dot(&columns[i], &weighted[j])).collect()).collect();
    let inverse = &solution.inverse;
    let product = |a: &[Vec<f64>], b: &[Vec<f64>]| -> Vec<Vec<f64>> {
        (0..count)
            .map(|i| {
                (0..count).map(|j| (0..count).map(|k| a[i][k] * b[k][j]).sum::<f64>()).collect()
            })
            .collect()
    };
    let mut covariance = product(&product(inverse, &middle), inverse);
    covariance.iter_mut().flatten().for_each(|value| *value *= variance);
    Spread { places, covariance, freedom: (effective - count as f64).max(3.0) }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use trueup_machine::{MachineFile, RunFile, machine_file::Quantity};

    use super::*;

    #[test]
    fn a_point_of_a_table_where_the_axis_never_was_has_the_value_of_its_neighbour() {
        // Backwards the axis turns at 300 mm, a hundredth of a micrometre beyond it in the file.
        let mut text = String::from("x_mm,dir_x,measured_dx_um\n");
        for noise in [0.2, -0.1, -0.1] {
            for (mm, um) in [(0.0, 1.0), (100.0, 3.0), (200.0, 2.0), (300.0, 5.0), (400.0, 4.0)] {
                text += &format!("{mm},1,{}\n", um + noise);
                if mm < 400.0 {
                    text += &format!("{},-1,{}\n", mm + 1e-5, um + 6.0 - noise);
                }
            }
        }
        let file = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
        let machine = MachineFile::parse(file, Path::new("m.toml")).expect("a machine file");
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
        let data = Data::new(&machine, &[run], Quantity::Dx).expect("comparable");
        let groups = Groups::new(&data, &data.used.clone(), 1);
        let problem = Problem::new(data, groups);
        let kind = Kind::PitchError { start_mm: 0.0, step_mm: 100.0, points: 5, both_ways: true };
        let part = Part { values: vec![0.0; 10], kind };
        let model = Model { parts: vec![part], constant_um: None };
        let values = &fit(&problem, &model, None).model.parts[0].values;
        let exact = [1.0, 3.0, 2.0, 5.0, 4.0, 7.0, 9.0, 8.0, 11.0, 11.0];
        for (value, exact) in values.iter().zip(exact) {
            assert!((value - exact).abs() < 1e-5, "{values:?}");
        }
    }
}
