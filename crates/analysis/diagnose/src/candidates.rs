//! Which causes the machine and the data allow, and where the search for each begins: what their pages
//! propose when they are shown the data.

use trueup_machine::{
    effect::{BoardTerm, DataView, Effect, Quantity, SpectrumVariable, StartValues, peak_to_peak},
    machine_file::{AxisModel, ElongationSource, Spindle},
};
use trueup_numerics::parallel::parallel_map;

use crate::{
    columns::{PREDICTED_ELONGATION_COLUMN, column_by_name},
    data::{ColumnGroup, DataTable, StatedTerm, forward_fill},
    fit::FitProblem,
    model::Model,
    periodogram,
    term_kind::{LackOfFitCurve, ModelPart, TermKind, own_axis_thermal_law},
};

/// Most speeds at which a curve over them may bend.
const MAX_SPEED_KNOTS: usize = 10;

/// A cause to try.
#[derive(Clone, Debug)]
pub(crate) struct CandidateTerm {
    pub kind: TermKind,
    /// Nonlinear values to begin from; one empty list where there are none.
    pub settings: Vec<Vec<f64>>,
    /// ln of the number of settings that were looked at to find these.
    pub searched: f64,
}

/// Returns what may be added to `model` but for what takes two recorded inputs together and what depends on the clock
/// alone, and the terms of the machine file that may have become wrong.
pub(crate) fn single_input_candidates(
    problem: &FitProblem,
    model: &Model,
    residual: &[f64],
) -> Vec<CandidateTerm> {
    let mut all = non_interaction_candidates(problem, model, residual);
    all.retain(|candidate| !candidate.kind.is_periodic_in_time());
    all
}

/// Returns the same, with what is periodic in time.
pub(crate) fn non_interaction_candidates(
    problem: &FitProblem,
    model: &Model,
    residual: &[f64],
) -> Vec<CandidateTerm> {
    let mut all = all_candidates(problem, model, residual);
    all.retain(|candidate| !candidate.kind.is_flexible());
    all
}

/// Returns all of these, with what takes two recorded inputs together: many candidates.
pub(crate) fn all_candidates(
    problem: &FitProblem,
    model: &Model,
    residual: &[f64],
) -> Vec<CandidateTerm> {
    (*problem.memoise("causes", model, || propose_candidates(problem, model, residual))).clone()
}

fn propose_candidates(problem: &FitProblem, model: &Model, residual: &[f64]) -> Vec<CandidateTerm> {
    let stated = problem.data.setting.stated.iter();
    // A time that is searched, not fitted, is what happened once: that does not change.
    let held = stated.map(ModelPart::from_stated_term).filter(|ModelPart { kind, .. }| {
        !model.contains(kind)
            && !kind.has_instant()
            && kind.cause().is_some_and(|cause| has_varying_input(problem, cause))
    });
    let mut all: Vec<CandidateTerm> = held
        .map(|ModelPart { kind, values }| CandidateTerm {
            kind,
            settings: vec![values],
            searched: 0.0,
        })
        .collect();
    Effect::propose(
        &CandidateContext { problem, model, residual },
        &mut |effect, StartValues { starts, searched }| {
            let is_in_machine_file = is_in_machine_file(problem, &effect, &starts);
            let kind = TermKind::Cause(effect);
            // A wave may come a second time, with another period.
            let is_new =
                kind.has_spatial_period() || kind.is_instrument_error() || !model.contains(&kind);
            if !starts.is_empty() && is_new && !is_in_machine_file {
                all.push(CandidateTerm { kind, settings: starts, searched });
            }
        },
    );
    all
}

/// Returns whether the machine file has a cause already, so that it can only be one that has changed: of the
/// same name on the same column; of waves one whose period the travel does not show apart.
fn is_in_machine_file(problem: &FitProblem, effect: &Effect, starts: &[Vec<f64>]) -> bool {
    let same = |stated: &&StatedTerm| {
        stated.effect.name() == effect.name()
            && stated.effect.input_column() == effect.input_column()
    };
    let mut same = problem.data.setting.stated.iter().filter(same);
    if effect.is_instrument_error() || effect.has_instant() {
        return false;
    }
    if !effect.has_spatial_period() {
        return same.next().is_some();
    }
    let travel_mm = problem.bounds.travel_mm;
    same.any(|stated| {
        let waves = stated.effect.board_terms();
        let lengths_mm = waves.iter().filter_map(|form| match form {
            BoardTerm::Wave { period_mm, harmonic, .. } => Some(period_mm / f64::from(*harmonic)),
            _ => None,
        });
        let is_near = |mm: f64| {
            starts.iter().any(|start| (1.0 / start[0] - 1.0 / mm).abs() < 0.5 / travel_mm)
        };
        lengths_mm.into_iter().any(is_near)
    })
}

/// Returns whether the data have the column that a cause depends on, if it depends on one.
fn has_varying_input(problem: &FitProblem, effect: &Effect) -> bool {
    effect.input_column().is_none_or(|column| is_varying(&problem.data, &column))
}

/// Returns the temperatures that the model goes by already.
pub(crate) fn used_temperature_columns(data: &DataTable, model: &Model) -> Vec<String> {
    let spindle = &data.setting.machine.spindle;
    let mut used = Vec::new();
    if data.setting.has_elongation && spindle.source == Some(ElongationSource::Temperature) {
        used.extend(spindle.temperature.as_ref().map(|model| model.sensor.clone()));
    }
    used.extend(own_axis_thermal_law(data).map(|thermal| thermal.sensor.clone()));
    let model = model.with_machine_terms(data);
    let paths = model.parts.iter().filter_map(|part| part.kind.heat_path());
    used.extend(paths.filter(|path| !path.is_second).map(|path| path.column.to_string()));
    used
}

/// The problem, model and residual that the pages are shown.
struct CandidateContext<'a> {
    problem: &'a FitProblem,
    model: &'a Model,
    residual: &'a [f64],
}

impl CandidateContext<'_> {
    fn data(&self) -> &DataTable {
        &self.problem.data
    }

    /// Returns the coordinate over which a wave is looked for, in groups.
    fn wave_coordinate(&self, over: SpectrumVariable<'_>) -> Option<Vec<f64>> {
        let data = self.data();
        let values = match over {
            SpectrumVariable::Position => data.own_position_mm()?,
            SpectrumVariable::Time => data.time_s()?,
            SpectrumVariable::Elongation => &data.predicted.elongation,
            SpectrumVariable::Column(column) => column_by_name(data, column)?,
        };
        Some(self.problem.groups.means(&forward_fill(values)))
    }
}

impl CandidateContext<'_> {
    /// Times in equal ratios, from the spacing of the groups on, in s; none without a clock.
    fn geometric_time_grid(&self, high_s: f64) -> impl Iterator<Item = f64> {
        /// Less than a factor of two, so that the fit begins near.
        const TIME_GRID_RATIO: f64 = 1.6;
        let step_s = self.problem.bounds.step_s * self.problem.groups.size as f64;
        let first_s = self.data().time_s().map(|_| step_s);
        let times = std::iter::successors(first_s, |time_s| Some(time_s * TIME_GRID_RATIO));
        times.take_while(move |time_s| *time_s <= high_s)
    }
}

impl DataView for CandidateContext<'_> {
    fn quantity(&self) -> Quantity {
        self.data().setting.quantity
    }

    fn spindle(&self) -> &Spindle {
        &self.data().setting.machine.spindle
    }

    fn own_axis(&self) -> Option<&AxisModel> {
        let data = self.data();
        data.setting.quantity.axis().map(|axis| &data.setting.machine.axes[axis.index()])
    }

    fn has_elongation(&self) -> bool {
        let data = self.data();
        data.setting.has_elongation && data.predicted.along.iter().any(|along| along.abs() > 0.1)
    }

    fn source_elongation_um(&self) -> &[f64] {
        &self.data().predicted.law
    }

    fn predicted_peak_to_peak_um(&self) -> f64 {
        peak_to_peak(&Model::default().predict(self.data()))
    }

    fn column(&self, name: &str) -> Option<&[f64]> {
        column_by_name(self.data(), name)
    }

    fn temperature_columns(&self) -> Vec<&str> {
        self.data().temperatures().iter().map(|(name, _)| name.as_str()).collect()
    }

    fn unknown_columns(&self) -> Vec<&str> {
        self.data().unknown_columns().iter().map(|(name, _)| name.as_str()).collect()
    }

    fn own_position_mm(&self) -> Option<&[f64]> {
        self.data().own_position_mm()
    }

    fn is_bidirectional(&self) -> bool {
        self.data().own_approach_direction().is_some_and(|d| d.contains(&1.0) && d.contains(&-1.0))
    }

    fn is_column_in_use(&self, column: &str) -> bool {
        used_temperature_columns(self.data(), self.model).iter().any(|used| used == column)
    }

    fn has_cause(&self, cause: &str) -> bool {
        let model = self.model.with_machine_terms(self.data());
        model.parts.iter().any(|part| part.kind.name() == cause)
    }

    fn has_added_cause(&self, cause: &str) -> bool {
        self.model.parts.iter().any(|part| part.kind.name() == cause)
    }

    fn has_instrument_error(&self) -> bool {
        self.model.parts.iter().any(|part| part.kind.is_instrument_error())
    }

    fn has_constant(&self) -> bool {
        self.model.constant_um.is_some()
    }

    fn reference_temperature_c(&self, column: &str) -> f64 {
        self.data().reference_temperature_c(column)
    }

    fn time_origin_s(&self) -> f64 {
        self.data().origin.start_s
    }

    fn time_range_s(&self) -> Option<[f64; 2]> {
        self.data().time_s().map(|_| self.problem.bounds.time_s)
    }

    fn file_count(&self) -> usize {
        self.data().setting.files.len()
    }

    fn group_count(&self) -> usize {
        self.problem.groups.len()
    }

    fn group_time_s(&self, group: usize) -> f64 {
        let row = self.problem.groups.first_row[group];
        self.data().time_s().map_or(f64::NAN, |time_s| time_s[row])
    }

    fn time_constant_start_values(&self, count: usize) -> StartValues {
        let [low, high] = self.problem.bounds.time_constant_s;
        // What is within one group is not seen apart.
        let low = low.max(2.0 * low * self.problem.groups.size as f64);
        let high = 0.5 * high;
        let is_range = high.partial_cmp(&low) == Some(std::cmp::Ordering::Greater);
        if self.data().time_s().is_none() || !is_range {
            return StartValues::from_values([]);
        }
        let ratio = (high / low).powf(1.0 / (count - 1) as f64);
        StartValues::from_values((0..count).map(|n| low * ratio.powi(n as i32)))
    }

    fn time_shift_start_values(&self) -> StartValues {
        let [low_s, high_s] = self.problem.bounds.shift_s;
        let sizes = self.geometric_time_grid(high_s);
        StartValues::from_values(
            sizes.flat_map(|size| [size, -size]).filter(|shift| *shift >= low_s),
        )
    }

    fn thermometer_lag_start_values(&self) -> StartValues {
        let [_, high_s] = self.problem.bounds.late_s;
        StartValues::from_values(self.geometric_time_grid(high_s))
    }

    fn longest_period_mm(&self) -> f64 {
        self.problem.bounds.period_mm[1]
    }

    fn spectrum_peak_start_values(
        &self,
        over: SpectrumVariable<'_>,
        least_turns: f64,
        frequencies: usize,
    ) -> Option<StartValues> {
        let at = self.wave_coordinate(over)?;
        let (frequency, searched) =
            periodogram::find_spectrum_peak(&at, self.residual, least_turns, frequencies)?;
        Some(StartValues { starts: vec![vec![1.0 / frequency]], searched })
    }

    fn reciprocal_wave_start_values(&self, over: SpectrumVariable<'_>) -> Option<StartValues> {
        let (values, searched) =
            periodogram::fit_reciprocal_wave(&self.wave_coordinate(over)?, self.residual)?;
        Some(StartValues { starts: vec![values], searched })
    }
}

fn is_varying(data: &DataTable, column: &str) -> bool {
    column_by_name(data, column).is_some_and(|values| peak_to_peak(values) > 0.0)
}

/// Curves over each column: no causes, but tests of structure. Next to them what no single column
/// shows: a curve over one position that grows with another (an angle of a guide, times an arm), a
/// growth that is another one at other speeds, what comes and goes after a reversal.
pub(crate) fn propose_curve_candidates(problem: &FitProblem) -> Vec<CandidateTerm> {
    let data = &problem.data;
    let own = data.setting.quantity.axis().map(|axis| axis.column_name());
    let turns =
        data.own_approach_direction().is_some_and(|d| d.contains(&1.0) && d.contains(&-1.0));
    let over = |&(column, by_direction, times): &(&str, bool, Option<&str>)| {
        let values = column_by_name(data, column).filter(|_| is_varying(data, column))?;
        if times.is_some_and(|times| !is_varying(data, times)) {
            return None;
        }
        // A guide's form has more bends than a characteristic.
        let most = match column {
            _ if by_direction => 9,
            "x_mm" | "y_mm" | "z_mm" => 16,
            "spindle_rpm" => MAX_SPEED_KNOTS,
            _ if data.columns[ColumnGroup::Reversal]
                .iter()
                .any(|(reversal, _)| reversal == column) =>
            {
                2
            }
            _ => 6,
        };
        let knots = quantile_knots(values, most);
        // Over one of the file's columns a curve with two knots is a straight line, which is a cause.
        let least = if times.is_some() || most == 2 { 2 } else { 3 };
        (knots.len() >= least).then(|| {
            let (column, times) = (column.to_string(), times.map(String::from));
            let kind = TermKind::Curve(LackOfFitCurve { column, knots, by_direction, times });
            CandidateTerm { kind, settings: vec![Vec::new()], searched: 0.0 }
        })
    };
    const POSITION_COLUMNS: [&str; 3] = ["x_mm", "y_mm", "z_mm"];
    let mut curves = Vec::new();
    let temperatures = data.temperatures().iter().map(|(name, _)| name.as_str());
    let others = data.unknown_columns().iter().map(|(name, _)| name.as_str());
    for column in temperatures
        .chain(others)
        .chain(["spindle_rpm", "load_n", PREDICTED_ELONGATION_COLUMN])
        .chain(POSITION_COLUMNS)
    {
        curves.push((column, false, None));
        if turns && own.as_deref() == Some(column) {
            curves.push((column, true, None));
        }
    }
    curves.push(("spindle_rpm", false, Some(PREDICTED_ELONGATION_COLUMN)));
    curves.extend(
        data.columns[ColumnGroup::Reversal]
            .iter()
            .map(|(reversal, _)| (reversal.as_str(), false, None)),
    );
    for (column, arm) in POSITION_COLUMNS.iter().flat_map(|a| POSITION_COLUMNS.map(|b| (*a, b))) {
        if column != arm {
            curves.push((column, false, Some(arm)));
        }
    }
    let mut all: Vec<CandidateTerm> = parallel_map(&curves, problem.is_parallel_worthwhile(), over)
        .into_iter()
        .flatten()
        .collect();
    all.extend(propose_speed_threshold_candidates(data));
    all
}

/// Another scale of what the model says from a speed on. A curve of a value for each speed says that too, but costs
/// more than it gains.
fn propose_speed_threshold_candidates(data: &DataTable) -> Vec<CandidateTerm> {
    let Some(speed_rpm) =
        data.spindle_rpm().filter(|_| is_varying(data, PREDICTED_ELONGATION_COLUMN))
    else {
        return Vec::new();
    };
    let knots = quantile_knots(speed_rpm, MAX_SPEED_KNOTS);
    let searched = (knots.len() as f64).ln();
    let from = |between: &[f64]| {
        let (column, times) =
            ("spindle_rpm".to_string(), Some(PREDICTED_ELONGATION_COLUMN.to_string()));
        let knots = between.to_vec();
        let kind = TermKind::Curve(LackOfFitCurve { column, knots, by_direction: false, times });
        CandidateTerm { kind, settings: vec![Vec::new()], searched }
    };
    knots.windows(2).map(from).collect()
}

/// Knots at quantiles, no two alike.
fn quantile_knots(values: &[f64], most: usize) -> Vec<f64> {
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
