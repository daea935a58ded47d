//! How far the corrections of a machine may go: its model at the corners of its inputs, from a start on.
//!
//! A file may be right in every state that was measured, and far off in one that was not. After a start all
//! lags and slow modes begin anew, so that two terms which take each other back once they have settled stand
//! there one without the other. So the model is stepped through what a day may bring:
//!
//! ```text
//! start settled at one corner of the temperatures ─► ramp to another one, or stay ─► until all has settled
//! at each of these times: the axes at both ends, approached from both sides; the spindle at rest, and turning
//! ```
//!
//! [`compile`](crate::compile()) refuses a machine whose terms leave what is possible there ([`reject_limit_violations`]);
//! `check` and `bridge load` call the same function, and a diagnosis calls it before it writes a term.

use std::{borrow::Cow, collections::BTreeMap};

use crate::{
    effect::{BoardTerm, Effect, LawInput, SlowMode},
    location::InputFileError,
    machine_file::Machine,
    model::{ReferenceModel, RowInputs, tool_growth_term},
    sections::LinearAxis,
};

/// The temperature that a machine is right at, and how far it may be from it in a workshop, in °C: ISO 1, and
/// half of what lies between its 20 °C and the 40 °C at which EN 60204-1 lets a machine work.
const NORMAL_TEMPERATURE_RANGE_C: [f64; 2] = [10.0, 30.0];
/// How long a temperature takes over its range, in s: 20 K at 2 K a minute, as a spindle's front bearing does
/// in the first minutes at its rated speed.
pub const TEMPERATURE_RAMP_DURATION_S: f64 = 600.0;
/// After this many of its longest time constants a state has settled to a ten-thousandth.
const SETTLING_TIME_CONSTANTS: f64 = 10.0;
/// Times after the ramp, at equal ratios.
const EVALUATION_INTERVAL_COUNT: i32 = 10;
/// A growth or shift that no machine has, in µm: twice the range of the displacement sensor of the paper, 500 µm.
const MAX_PLAUSIBLE_OFFSET_UM: f64 = 1000.0;
/// Two terms take each other back where less than this share of the smaller is left of both.
const MAX_UNCANCELLED_FRACTION: f64 = 0.2;
/// Terms that do less are not looked at for that, in µm: the error that the paper on displacement sensors calls
/// the limit of what is sufficient.
const MIN_CANCELLING_UM: f64 = 50.0;
/// Thermometers whose ends are combined one by one; of more all go together.
const MAX_INDEPENDENT_THERMOMETERS: usize = 5;

/// The ranges of a machine's inputs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InputRanges {
    /// In °C by column; a column that is not there: 10 to 30 °C.
    pub temperatures_c: BTreeMap<String, [f64; 2]>,
    /// Whether each thermometer may be at either end whatever the others are.
    pub is_each_alone: bool,
    /// How long a temperature takes from one end to the other, in s.
    pub change_s: f64,
    /// In r/min.
    pub speed_rpm: [f64; 2],
    /// In N.
    pub load_n: [f64; 2],
    /// In counts of the run file.
    pub sensor_counts: [f64; 2],
    /// X, Y and Z, in mm.
    pub position_mm: [[f64; 2]; 3],
}

impl InputRanges {
    /// Returns a workshop by the file alone: 10 to 30 °C, all thermometers together; the travels; the rated speed, and
    /// the displacement sensor at its zero.
    #[must_use]
    pub fn normal(machine: &Machine) -> Self {
        let sensor = machine.spindle.sensor.as_ref();
        Self {
            temperatures_c: BTreeMap::new(),
            is_each_alone: false,
            change_s: TEMPERATURE_RAMP_DURATION_S,
            speed_rpm: [0.0, rated_rpm(machine)],
            load_n: [0.0; 2],
            sensor_counts: [sensor.map_or(0.0, |sensor| sensor.zero_counts); 2],
            position_mm: LinearAxis::ALL
                .map(|axis| machine.axis_range_mm(axis).unwrap_or([0.0; 2])),
        }
    }
}

/// Returns the speed for which the file says how the spindle warms; 0 where it does not.
fn rated_rpm(machine: &Machine) -> f64 {
    machine.spindle.warmup.as_ref().and_then(|warmup| warmup.rated_rpm).unwrap_or(0.0)
}

/// The prediction of the model in one state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictedState {
    /// `elongation`, `dx`, `dy` and `dz`, in µm.
    pub um: [f64; 4],
    /// How long after a start, in s.
    pub since_start_s: f64,
    /// The number of this time among all, from 0: the start.
    pub moment: usize,
    /// Whether all has settled.
    pub is_settled: bool,
}

/// Returns the model of what the board runs of `machine`, in every state of `ranges`.
#[must_use]
pub fn predict_states(machine: &Machine, ranges: &InputRanges) -> Vec<PredictedState> {
    states_of(machine, machine, ranges)
}

/// Returns the model of `machine` in the states of `whole`: one with fewer terms has fewer thermometers, and settles sooner.
fn states_of(machine: &Machine, whole: &Machine, ranges: &InputRanges) -> Vec<PredictedState> {
    let [machine, whole] = [machine, whole].map(machine_at_power_on);
    let columns = model_thermometer_columns(&whole);
    let corners = enumerate_corners(columns.len(), ranges.is_each_alone);
    let times_s = evaluation_times_s(&whole, ranges.change_s);
    let places = corner_positions(ranges);
    let categories = [0, 1].map(|end| category_values(&whole, end));
    let mut states = Vec::new();
    let ends: Vec<[f64; 2]> = columns
        .iter()
        .map(|column| {
            ranges.temperatures_c.get(column).copied().unwrap_or(NORMAL_TEMPERATURE_RANGE_C)
        })
        .collect();
    for from in &corners {
        // From any corner all go to one end together, or nothing changes.
        let ends_of_all = [vec![0; columns.len()], vec![1; columns.len()]];
        for to in ends_of_all.iter().filter(|to| *to != from).chain([from]) {
            for (end, categories) in categories.iter().enumerate() {
                let mut model = ReferenceModel::new(&machine);
                for (moment, &time_s) in times_s.iter().enumerate() {
                    let way = if time_s == 0.0 { 0.0 } else { time_s / ranges.change_s };
                    let way = way.clamp(0.0, 1.0);
                    let temperatures: Vec<(&str, f64)> = columns
                        .iter()
                        .enumerate()
                        .map(|(n, column)| {
                            let [a, b] = [from, to].map(|corner| ends[n][corner[n]]);
                            (column.as_str(), a + way * (b - a))
                        })
                        .collect();
                    for (position_mm, direction) in &places {
                        let um = model.step(&RowInputs {
                            time_s: Some(time_s),
                            run: Some(1.0),
                            sensor_counts: ranges.sensor_counts[end],
                            spindle_rpm: Some(ranges.speed_rpm[end]),
                            load_n: Some(ranges.load_n[end]),
                            feed_mm_per_min: 1000.0,
                            temperatures_c: &temperatures,
                            others: categories,
                            position_mm: *position_mm,
                            angle_deg: [0.0; 3],
                            direction: [*direction; 3],
                            tool_length_mm: None,
                        });
                        states.push(PredictedState {
                            um: um.to_error_values().to_array(),
                            since_start_s: time_s,
                            moment,
                            is_settled: moment + 1 == times_s.len(),
                        });
                    }
                }
            }
        }
    }
    states
}

/// Returns what the board runs of a machine, whose slow modes begin when it is switched on.
fn machine_at_power_on(machine: &Machine) -> Machine {
    let mut started = machine.with_only_compensated_terms().into_owned();
    let by_tool = started.spindle.tools.take();
    started.terms.extend(by_tool.as_ref().map(tool_growth_term));
    for term in &mut started.terms {
        if let Effect::SlowMode(SlowMode::TimeDriven { start_s, .. }) = &mut term.effect {
            *start_s = 0.0;
        }
    }
    started
}

/// Returns the tool and the conditions at one end: none and off, or where each does most.
fn category_values(machine: &Machine, end: usize) -> Vec<(&str, f64)> {
    let mut values: Vec<(&str, f64)> = Vec::new();
    for term in &machine.terms {
        let column = match term.effect.required_inputs().first() {
            Some(&(LawInput::Column(column) | LawInput::Lagged { column, .. })) => column,
            _ => continue,
        };
        let largest = term.effect.board_terms().first().and_then(BoardTerm::dominant_category);
        if values.iter().all(|(name, _)| *name != column) {
            values.extend(largest.map(|largest| (column, if end == 0 { 0.0 } else { largest })));
        }
    }
    values
}

/// Returns the thermometers that the model reads.
fn model_thermometer_columns(machine: &Machine) -> Vec<String> {
    let axes = machine.axes.iter().filter_map(|axis| axis.thermal.as_ref());
    let spindle = machine.spindle.temperature.iter().map(|model| &model.sensor);
    let terms = machine.terms.iter().filter_map(|term| term.effect.temperature_column());
    let all = axes.map(|thermal| &thermal.sensor).chain(spindle).cloned().chain(terms);
    let mut columns: Vec<String> = all.collect();
    columns.sort_unstable();
    columns.dedup();
    columns
}

/// Returns which end, 0 or 1, each of `count` thermometers is at.
fn enumerate_corners(count: usize, is_each_alone: bool) -> Vec<Vec<usize>> {
    match count {
        0 => vec![Vec::new()],
        _ if is_each_alone && count <= MAX_INDEPENDENT_THERMOMETERS => {
            (0..1_usize << count).map(|set| (0..count).map(|n| set >> n & 1).collect()).collect()
        }
        _ => vec![vec![0; count], vec![1; count]],
    }
}

/// Returns the times after a start at which it is looked, in s: on the ramp, and until all has settled.
fn evaluation_times_s(machine: &Machine, change_s: f64) -> Vec<f64> {
    let of_axes =
        machine.axes.iter().filter_map(|axis| axis.thermal.as_ref()).map(|thermal| thermal.lag_s);
    let spindle = &machine.spindle;
    let of_spindle = spindle.temperature.iter().map(|temperature| temperature.lag_s);
    let of_warmup = spindle.warmup.iter().map(|warmup| warmup.warm_s);
    let of_terms = machine.terms.iter().flat_map(|term| term.effect.board_terms()).filter_map(
        |form| match form {
            BoardTerm::Heat(heat) | BoardTerm::HeatSlope(heat) => Some(heat.time_constant_s),
            BoardTerm::SpeedHeat(heat) => Some(heat.time_constant_s),
            BoardTerm::Time { time_constant_s, .. } => Some(time_constant_s),
            BoardTerm::Thermal(thermal) => Some(thermal.lag_s),
            _ => None,
        },
    );
    let longest_s =
        of_axes.chain(of_spindle).chain(of_warmup).chain(of_terms).fold(1.0, f64::max).min(1e9);
    let quarters = [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| share * change_s);
    let last_s = SETTLING_TIME_CONSTANTS * longest_s;
    let first_s: f64 = last_s.min(10.0);
    let after = (0..=EVALUATION_INTERVAL_COUNT).map(|n| {
        change_s
            + first_s * (last_s / first_s).powf(f64::from(n) / f64::from(EVALUATION_INTERVAL_COUNT))
    });
    quarters.into_iter().chain(after).collect()
}

/// Returns the corners of the axes' ranges, approached from both sides.
fn corner_positions(ranges: &InputRanges) -> Vec<([f64; 3], f64)> {
    let mut places: Vec<([f64; 3], f64)> = Vec::new();
    for corner in 0..8_usize {
        let at = [0, 1, 2].map(|axis| ranges.position_mm[axis][corner >> axis & 1]);
        if places.iter().all(|(there, _)| *there != at) {
            places.extend([(at, 1.0), (at, -1.0)]);
        }
    }
    places
}

/// The axis and the term by which a machine leaves what is possible.
#[derive(Clone, Debug, PartialEq)]
pub struct LimitViolation {
    /// The axis that is moved too far.
    pub axis: LinearAxis,
    /// The number of the term that does most, from 0.
    pub term: usize,
    /// The error that the model says, in µm: the offset is its opposite.
    pub um: f64,
    /// The rule that is broken, after the key of that term.
    pub rule: String,
}

/// Where the terms of `machine` move an axis beyond its limit in a workshop's normal states, after a start or
/// once settled; `None`: nowhere.
///
/// ```text
/// always   at one moment every state is beyond the limit: the offset would stand there
/// passing  settled it stays within the limit, and on the way there it is beyond
/// pair     two terms are beyond it, each in every settled state, and take each other back
/// ```
///
/// A law without terms is not judged: `check` warns of it.
#[must_use]
pub fn find_limit_violation(machine: &Machine) -> Option<LimitViolation> {
    let of_machine = MachineStates::new(machine)?;
    LinearAxis::ALL.into_iter().find_map(|axis| {
        let limit_um = machine.limits.max_um[axis.index()];
        AxisLimitCheck { of_machine: &of_machine, axis, limit_um }.find_limit_violation()
    })
}

/// The states of a machine with terms in a normal workshop.
struct MachineStates {
    /// With the terms that the board runs alone.
    machine: Machine,
    /// The number of each of them in the file.
    numbers: Vec<usize>,
    all: Vec<PredictedState>,
    /// Without any term.
    plain: Vec<PredictedState>,
    /// The effect of each term in each state, in µm.
    alone: Vec<Vec<[f64; 4]>>,
}

impl MachineStates {
    /// None without terms that the board runs.
    fn new(machine: &Machine) -> Option<Self> {
        let run = machine.terms.iter().enumerate().filter(|(_, term)| term.effect.is_compensable());
        let numbers: Vec<usize> = run.map(|(number, _)| number).collect();
        if numbers.is_empty() {
            return None;
        }
        let machine = machine.with_only_compensated_terms().into_owned();
        let ranges = InputRanges::normal(&machine);
        let all = predict_states(&machine, &ranges);
        let of = |fewer: &Machine| states_of(fewer, &machine, &ranges);
        let plain = of(&Machine { terms: Vec::new(), ..machine.clone() });
        let alone = |term: usize| {
            let mut without = machine.clone();
            without.terms.remove(term);
            let rows = all.iter().zip(of(&without));
            rows.map(|(all, without)| [0, 1, 2, 3].map(|n| all.um[n] - without.um[n])).collect()
        };
        let alone = (0..machine.terms.len()).map(alone).collect();
        Some(Self { numbers, all, plain, alone, machine })
    }

    /// Returns the states in which all has settled.
    fn settled_state_indices(&self) -> Vec<usize> {
        (0..self.all.len()).filter(|&state| self.all[state].is_settled).collect()
    }
}

/// Two terms that are both large in every settled state and take each other back there: right after a start, on
/// another day or with one of them off by a little, what is left is anything.
#[derive(Clone, Debug, PartialEq)]
pub struct CancellingTermPair {
    /// Their numbers, from 0.
    pub terms: [usize; 2],
    /// The effect of each once settled, in µm.
    pub um: [f64; 2],
    /// The axis on which they do.
    pub axis: LinearAxis,
}

/// Returns the first pair of terms that take each other back, where there is one.
#[must_use]
pub fn find_cancelling_terms(machine: &Machine) -> Option<CancellingTermPair> {
    let of_machine = MachineStates::new(machine)?;
    let MachineStates { numbers, alone, .. } = &of_machine;
    let settled = of_machine.settled_state_indices();
    let last = *settled.last()?;
    let pairs = (0..alone.len()).flat_map(|b| (0..b).map(move |a| [a, b]));
    let of_axes =
        LinearAxis::ALL.into_iter().flat_map(|axis| pairs.clone().map(move |pair| (axis, pair)));
    of_axes.into_iter().find_map(|(axis, pair)| {
        let at = |state: usize| pair.map(|term| alone[term][state][1 + axis.index()]);
        let is_taken_back = settled.iter().all(|&state| {
            let [a, b] = at(state);
            let smaller = a.abs().min(b.abs());
            smaller > MIN_CANCELLING_UM && (a + b).abs() < MAX_UNCANCELLED_FRACTION * smaller
        });
        is_taken_back.then(|| CancellingTermPair {
            terms: pair.map(|term| numbers[term]),
            um: at(last),
            axis,
        })
    })
}

/// Refuses a machine whose terms leave what is possible ([`find_limit_violation`]).
///
/// # Errors
/// They do: with the term that does most, and what it does.
pub fn reject_limit_violations(machine: &Machine) -> Result<(), InputFileError> {
    match find_limit_violation(machine) {
        None => Ok(()),
        Some(LimitViolation { term, rule, .. }) => {
            let bad = machine.places.key_error(&format!("term[{term}]"), rule);
            Err(InputFileError { help: Some(LIMIT_VIOLATION_HELP.into()), ..bad })
        }
    }
}

/// The remedy for terms that leave what is possible.
const LIMIT_VIOLATION_HELP: &str =
    "take the terms out, or diagnose anew: a diagnosis writes none that leave what was measured";

/// One axis, and the largest offset on it.
struct AxisLimitCheck<'m> {
    of_machine: &'m MachineStates,
    axis: LinearAxis,
    limit_um: f64,
}

impl AxisLimitCheck<'_> {
    fn find_limit_violation(&self) -> Option<LimitViolation> {
        let MachineStates { all, plain, alone, numbers, .. } = self.of_machine;
        let quantity = 1 + self.axis.index();
        // What the laws do without the terms is no fault of these.
        if self.find_moment_beyond_limit(plain, quantity).is_some() {
            return None;
        }
        let beyond =
            self.find_moment_beyond_limit(all, quantity).map(|state| (state, "in every state"));
        let settled_um = max_magnitude_um(all.iter().filter(|state| state.is_settled), quantity);
        let passing = || {
            let worst = all.iter().enumerate().max_by(|a, b| {
                magnitude_um(a.1, quantity).total_cmp(&magnitude_um(b.1, quantity))
            })?;
            let is_passing =
                magnitude_um(worst.1, quantity) > self.limit_um && settled_um <= self.limit_um;
            let is_of_terms = max_magnitude_um(plain.iter(), quantity) <= self.limit_um;
            (is_passing && is_of_terms).then_some((worst.0, "at the worst"))
        };
        if let Some((state, how)) = beyond.or_else(passing) {
            let um = all[state].um[quantity];
            let mut by_size: Vec<usize> = (0..alone.len()).collect();
            let of = |term: &usize| alone[*term][state][quantity].abs();
            by_size.sort_by(|a, b| of(b).total_cmp(&of(a)));
            let term = *by_size.first()?;
            let rule = format!(
                "moves {axis} too far: {when} its error would be {um:+.0} µm {how}, and limits.max_um.{axis} is \
                 {limit} ({parts})",
                axis = self.axis.name(),
                when = format_elapsed_time(all[state].since_start_s),
                limit = self.limit_um,
                parts = self.format_terms(&by_size, |term| alone[term][state][quantity]),
            );
            return Some(LimitViolation { axis: self.axis, term: numbers[term], um, rule });
        }
        self.find_cancelling_violation(quantity)
    }

    /// Returns the first state of a moment in which every state is beyond the limit.
    fn find_moment_beyond_limit(
        &self,
        states: &[PredictedState],
        quantity: usize,
    ) -> Option<usize> {
        let moments = states.iter().map(|state| state.moment).max().map_or(0, |last| last + 1);
        (0..moments).find_map(|moment| {
            let mut here = states.iter().enumerate().filter(|(_, state)| state.moment == moment);
            let first = here.clone().next()?.0;
            here.all(|(_, state)| magnitude_um(state, quantity) > self.limit_um).then_some(first)
        })
    }

    /// Returns two terms that are each beyond the limit in every settled state, and take each other back.
    fn find_cancelling_violation(&self, quantity: usize) -> Option<LimitViolation> {
        let MachineStates { alone, numbers, .. } = self.of_machine;
        let settled = self.of_machine.settled_state_indices();
        let last = *settled.last()?;
        let most_um = self.limit_um.min(MAX_PLAUSIBLE_OFFSET_UM);
        let is_beyond = |term: &usize| {
            settled.iter().all(|&state| alone[*term][state][quantity].abs() > most_um)
        };
        let mut beyond: Vec<usize> = (0..alone.len()).filter(is_beyond).collect();
        let of = |term: usize| alone[term][last][quantity];
        beyond.sort_by(|a, b| of(*b).abs().total_cmp(&of(*a).abs()));
        let first = *beyond.first()?;
        let other = beyond.iter().copied().find(|&term| of(term) * of(first) < 0.0)?;
        let rule = format!(
            "and term[{other}] take each other back on {axis}: {parts}, each beyond {most_um} µm; what is left of \
             two such terms is not known",
            axis = self.axis.name(),
            other = numbers[other],
            parts = self.format_terms(&[first, other], of),
        );
        Some(LimitViolation { axis: self.axis, term: numbers[first], um: of(first), rule })
    }

    /// Returns the first three of `terms`, each with what it does.
    fn format_terms(&self, terms: &[usize], um: impl Fn(usize) -> f64) -> String {
        let MachineStates { machine, numbers, .. } = self.of_machine;
        let of = |&term: &usize| {
            let name = machine.terms[term].effect.name();
            format!("term[{}] {name} {:+.0} µm", numbers[term], um(term))
        };
        let acts = |term: &&usize| um(**term).abs() >= 0.5;
        terms.iter().filter(acts).take(3).map(of).collect::<Vec<String>>().join(", ")
    }
}

fn magnitude_um(state: &PredictedState, quantity: usize) -> f64 {
    // What is not known (NaN) is not judged.
    let um = state.um[quantity].abs();
    if um.is_nan() { 0.0 } else { um }
}

fn max_magnitude_um<'s>(states: impl Iterator<Item = &'s PredictedState>, quantity: usize) -> f64 {
    states.map(|state| magnitude_um(state, quantity)).fold(0.0, f64::max)
}

fn format_elapsed_time(since_start_s: f64) -> Cow<'static, str> {
    if since_start_s == 0.0 {
        return "right after a start".into();
    }
    format!("{:.0} min after a start", since_start_s / 60.0).into()
}
