//! Which causes the machine and the data allow, and where the search for each begins: what their pages
//! propose when they are shown the data.

use trueup_machine::{
    effect::{DataView, Effect, OnBoard, Quantity, Reading, StartValues, spread},
    file::{AxisModel, ElongationSource, Spindle},
};
use trueup_numerics::parallel::on_all_cores;

use crate::{
    columns::{SAID, named},
    data::{Data, Stated, filled},
    fit::Problem,
    kind::{Curve, Kind, Part, own_thermal},
    model::Model,
    waves,
};

/// Most speeds at which a curve over them may bend.
const SPEEDS: usize = 10;

/// A cause to try.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub kind: Kind,
    /// Nonlinear values to begin from; one empty list where there are none.
    pub settings: Vec<Vec<f64>>,
    /// ln of the number of settings that were looked at to find these.
    pub searched: f64,
}

/// Returns what may be added to `model` but for what takes two recorded inputs together and what goes with the clock
/// alone, and the terms of the machine file that may have become wrong.
pub(crate) fn possible(problem: &Problem, model: &Model, residual: &[f64]) -> Vec<Candidate> {
    let mut all = with_clock(problem, model, residual);
    all.retain(|candidate| !candidate.kind.is_by_the_clock());
    all
}

/// Returns the same, with what comes and goes with the clock.
pub(crate) fn with_clock(problem: &Problem, model: &Model, residual: &[f64]) -> Vec<Candidate> {
    let mut all = with_composed(problem, model, residual);
    all.retain(|candidate| !candidate.kind.is_composed());
    all
}

/// Returns all of these, with what takes two recorded inputs together: many candidates.
pub(crate) fn with_composed(problem: &Problem, model: &Model, residual: &[f64]) -> Vec<Candidate> {
    (*problem.known("causes", model, || proposed(problem, model, residual))).clone()
}

fn proposed(problem: &Problem, model: &Model, residual: &[f64]) -> Vec<Candidate> {
    let stated = problem.data.stated.iter();
    // A time that is searched, not fitted, is what happened once: that does not change.
    let held = stated.map(Part::stated).filter(|Part { kind, .. }| {
        !model.has(kind)
            && !kind.has_instant()
            && kind.cause().is_some_and(|it| can_change(problem, it))
    });
    let mut all: Vec<Candidate> = held
        .map(|Part { kind, values }| Candidate { kind, settings: vec![values], searched: 0.0 })
        .collect();
    Effect::propose(
        &Seen { problem, model, residual },
        &mut |effect, StartValues { starts, searched }| {
            let is_stated = is_stated(problem, &effect, &starts);
            let kind = Kind::Cause(effect);
            // A wave may come a second time, with another period.
            let is_new = kind.is_wave() || kind.is_of_instrument() || !model.has(&kind);
            if !starts.is_empty() && is_new && !is_stated {
                all.push(Candidate { kind, settings: starts, searched });
            }
        },
    );
    all
}

/// Returns whether the machine file has a cause already, so that it can only be one that has changed: of the
/// same name on the same column; of waves one whose period the travel does not show apart.
fn is_stated(problem: &Problem, effect: &Effect, starts: &[Vec<f64>]) -> bool {
    let same = |stated: &&Stated| {
        stated.effect.name() == effect.name() && stated.effect.column() == effect.column()
    };
    let mut same = problem.data.stated.iter().filter(same);
    if effect.is_of_instrument() || effect.has_instant() {
        return false;
    }
    if !effect.is_wave() {
        return same.next().is_some();
    }
    let travel_mm = problem.bounds.travel_mm;
    same.any(|stated| {
        let waves = stated.effect.on_board();
        let lengths_mm = waves.iter().filter_map(|form| match form {
            OnBoard::Wave { period_mm, harmonic, .. } => Some(period_mm / f64::from(*harmonic)),
            _ => None,
        });
        let is_near = |mm: f64| {
            starts.iter().any(|start| (1.0 / start[0] - 1.0 / mm).abs() < 0.5 / travel_mm)
        };
        lengths_mm.into_iter().any(is_near)
    })
}

/// Returns whether the data have the column that a cause hangs on, if it hangs on one.
fn can_change(problem: &Problem, effect: &Effect) -> bool {
    effect.column().is_none_or(|column| varying(&problem.data, &column))
}

/// Returns the temperatures that the model goes by already.
pub(crate) fn columns_in_use(data: &Data, model: &Model) -> Vec<String> {
    let spindle = &data.machine.spindle;
    let mut used = Vec::new();
    if data.has_elongation && spindle.source == Some(ElongationSource::Temperature) {
        used.extend(spindle.temperature.as_ref().map(|model| model.sensor.clone()));
    }
    used.extend(own_thermal(data).map(|thermal| thermal.sensor.clone()));
    let model = model.with_stated(data);
    let paths = model.parts.iter().filter_map(|part| part.kind.heat_path());
    used.extend(paths.filter(|path| !path.is_second).map(|path| path.column.to_string()));
    used
}

/// The problem, model and residual that the pages are shown.
struct Seen<'a> {
    problem: &'a Problem,
    model: &'a Model,
    residual: &'a [f64],
}

impl Seen<'_> {
    fn data(&self) -> &Data {
        &self.problem.data
    }

    /// Returns what a wave may go with, in groups.
    fn reading(&self, over: Reading<'_>) -> Option<Vec<f64>> {
        let data = self.data();
        let values = match over {
            Reading::Position => data.own_position()?,
            Reading::Time => data.time_s.as_deref()?,
            Reading::Elongation => &data.elongation,
            Reading::Column(column) => named(data, column)?,
        };
        Some(self.problem.groups.means(&filled(values)))
    }
}

impl Seen<'_> {
    /// Times in equal ratios, from the spacing of the groups on, in s; none without a clock.
    fn times_up_to(&self, high_s: f64) -> impl Iterator<Item = f64> {
        /// Less than a factor of two, so that the fit begins near.
        const RATIO: f64 = 1.6;
        let step_s = self.problem.bounds.step_s * self.problem.groups.size as f64;
        let first_s = self.data().time_s.as_ref().map(|_| step_s);
        let times = std::iter::successors(first_s, |time_s| Some(time_s * RATIO));
        times.take_while(move |time_s| *time_s <= high_s)
    }
}

impl DataView for Seen<'_> {
    fn quantity(&self) -> Quantity {
        self.data().quantity
    }

    fn spindle(&self) -> &Spindle {
        &self.data().machine.spindle
    }

    fn own_axis(&self) -> Option<&AxisModel> {
        let data = self.data();
        data.quantity.axis().map(|axis| &data.machine.axes[axis.index()])
    }

    fn elongates(&self) -> bool {
        let data = self.data();
        data.has_elongation && data.along.iter().any(|along| along.abs() > 0.1)
    }

    fn law(&self) -> &[f64] {
        &self.data().law
    }

    fn predicted_spread(&self) -> f64 {
        spread(&Model::default().predict(self.data()))
    }

    fn column(&self, name: &str) -> Option<&[f64]> {
        named(self.data(), name)
    }

    fn temperatures(&self) -> Vec<&str> {
        self.data().temperatures.iter().map(|(name, _)| name.as_str()).collect()
    }

    fn others(&self) -> Vec<&str> {
        self.data().others.iter().map(|(name, _)| name.as_str()).collect()
    }

    fn own_position(&self) -> Option<&[f64]> {
        self.data().own_position()
    }

    fn turns(&self) -> bool {
        self.data().own_direction().is_some_and(|d| d.contains(&1.0) && d.contains(&-1.0))
    }

    fn is_in_use(&self, column: &str) -> bool {
        columns_in_use(self.data(), self.model).iter().any(|used| used == column)
    }

    fn has(&self, cause: &str) -> bool {
        let model = self.model.with_stated(self.data());
        model.parts.iter().any(|part| part.kind.name() == cause)
    }

    fn adds(&self, cause: &str) -> bool {
        self.model.parts.iter().any(|part| part.kind.name() == cause)
    }

    fn has_instrument(&self) -> bool {
        self.model.parts.iter().any(|part| part.kind.is_of_instrument())
    }

    fn has_constant(&self) -> bool {
        self.model.constant_um.is_some()
    }

    fn reference_c(&self, column: &str) -> f64 {
        self.data().reference_c(column)
    }

    fn start_s(&self) -> f64 {
        self.data().start_s
    }

    fn time_s(&self) -> Option<[f64; 2]> {
        self.data().time_s.as_ref().map(|_| self.problem.bounds.time_s)
    }

    fn files(&self) -> usize {
        self.data().files
    }

    fn groups(&self) -> usize {
        self.problem.groups.len()
    }

    fn time_of_group(&self, group: usize) -> f64 {
        let row = self.problem.groups.first_row[group];
        self.data().time_s.as_ref().map_or(f64::NAN, |time_s| time_s[row])
    }

    fn time_constants(&self, count: usize) -> StartValues {
        let [low, high] = self.problem.bounds.time_constant_s;
        // What is within one group is not seen apart.
        let low = low.max(2.0 * low * self.problem.groups.size as f64);
        let high = 0.5 * high;
        let is_range = high.partial_cmp(&low) == Some(std::cmp::Ordering::Greater);
        if self.data().time_s.is_none() || !is_range {
            return StartValues::at([]);
        }
        let ratio = (high / low).powf(1.0 / (count - 1) as f64);
        StartValues::at((0..count).map(|n| low * ratio.powi(n as i32)))
    }

    fn shifts(&self) -> StartValues {
        let [low_s, high_s] = self.problem.bounds.shift_s;
        let sizes = self.times_up_to(high_s);
        StartValues::at(sizes.flat_map(|size| [size, -size]).filter(|shift| *shift >= low_s))
    }

    fn lates(&self) -> StartValues {
        let [_, high_s] = self.problem.bounds.late_s;
        StartValues::at(self.times_up_to(high_s))
    }

    fn longest_period_mm(&self) -> f64 {
        self.problem.bounds.period_mm[1]
    }

    fn peak(&self, over: Reading<'_>, least_turns: f64, frequencies: usize) -> Option<StartValues> {
        let at = self.reading(over)?;
        let (frequency, searched) = waves::peak(&at, self.residual, least_turns, frequencies)?;
        Some(StartValues { starts: vec![vec![1.0 / frequency]], searched })
    }

    fn angled_peak(&self, over: Reading<'_>) -> Option<StartValues> {
        let (values, searched) = waves::angled(&self.reading(over)?, self.residual)?;
        Some(StartValues { starts: vec![values], searched })
    }
}

fn varying(data: &Data, column: &str) -> bool {
    named(data, column).is_some_and(|values| spread(values) > 0.0)
}

/// Curves over each column: no causes, but tests of structure. Next to them what no single column
/// shows: a curve over one position that grows with another (an angle of a guide, times an arm), a
/// growth that is another one at other speeds, what comes and goes after a reversal.
pub(crate) fn structure(problem: &Problem) -> Vec<Candidate> {
    let data = &problem.data;
    let own = data.quantity.axis().map(|axis| format!("{}_mm", axis.name()));
    let turns = data.own_direction().is_some_and(|d| d.contains(&1.0) && d.contains(&-1.0));
    let over = |&(column, by_direction, times): &(&str, bool, Option<&str>)| {
        let values = named(data, column).filter(|_| varying(data, column))?;
        if times.is_some_and(|times| !varying(data, times)) {
            return None;
        }
        // A guide's form has more bends than a characteristic.
        let most = match column {
            _ if by_direction => 9,
            "x_mm" | "y_mm" | "z_mm" => 16,
            "spindle_rpm" => SPEEDS,
            _ if data.reversal_decay.iter().any(|(reversal, _)| reversal == column) => 2,
            _ => 6,
        };
        let knots = curve_knots(values, most);
        // Over one of the file's columns a curve with two knots is a straight line, which is a cause.
        let least = if times.is_some() || most == 2 { 2 } else { 3 };
        (knots.len() >= least).then(|| {
            let (column, times) = (column.to_string(), times.map(String::from));
            let kind = Kind::Curve(Curve { column, knots, by_direction, times });
            Candidate { kind, settings: vec![Vec::new()], searched: 0.0 }
        })
    };
    const POSITIONS: [&str; 3] = ["x_mm", "y_mm", "z_mm"];
    let mut curves = Vec::new();
    let temperatures = data.temperatures.iter().map(|(name, _)| name.as_str());
    let others = data.others.iter().map(|(name, _)| name.as_str());
    for column in temperatures.chain(others).chain(["spindle_rpm", "load_n", SAID]).chain(POSITIONS)
    {
        curves.push((column, false, None));
        if turns && own.as_deref() == Some(column) {
            curves.push((column, true, None));
        }
    }
    curves.push(("spindle_rpm", false, Some(SAID)));
    curves.extend(data.reversal_decay.iter().map(|(reversal, _)| (reversal.as_str(), false, None)));
    for (column, arm) in POSITIONS.iter().flat_map(|a| POSITIONS.map(|b| (*a, b))) {
        if column != arm {
            curves.push((column, false, Some(arm)));
        }
    }
    let mut all: Vec<Candidate> =
        on_all_cores(&curves, problem.is_large(), over).into_iter().flatten().collect();
    all.extend(from_a_speed_on(data));
    all
}

/// Another scale of what the model says from a speed on. A curve of a value for each speed says that too, but costs
/// more than it gains.
fn from_a_speed_on(data: &Data) -> Vec<Candidate> {
    let Some(speed_rpm) = data.spindle_rpm.as_deref().filter(|_| varying(data, SAID)) else {
        return Vec::new();
    };
    let knots = curve_knots(speed_rpm, SPEEDS);
    let searched = (knots.len() as f64).ln();
    let from = |between: &[f64]| {
        let (column, times) = ("spindle_rpm".to_string(), Some(SAID.to_string()));
        let knots = between.to_vec();
        let kind = Kind::Curve(Curve { column, knots, by_direction: false, times });
        Candidate { kind, settings: vec![Vec::new()], searched }
    };
    knots.windows(2).map(from).collect()
}

/// Knots at quantiles, no two alike.
fn curve_knots(values: &[f64], most: usize) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    if sorted.is_empty() {
        return Vec::new();
    }
    let mut knots: Vec<f64> =
        (0..most).map(|n| sorted[n * (sorted.len() - 1) / (most - 1)]).collect();
    let least = 1e-3 * (sorted[sorted.len() - 1] - sorted[0]);
    knots.dedup_by(|a, b| *a - *b <= least);
    knots
}
