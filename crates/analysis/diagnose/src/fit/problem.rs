//! The data of a fit: the table, its groups of rows, and the bounds of its values.

use std::{
    any::Any,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use trueup_machine::effect::NonlinearParameter;
use trueup_numerics::block_resampling::SEGMENT_COUNT;

use super::{
    CONFIDENCE_LEVEL, EQUIVALENCE_TOLERANCE,
    column_cache::{CacheKey, ColumnCache, GroupColumns},
    growth_cache,
    memo_table::MemoTable,
    parameter_bounds::{ParameterBounds, compute_parameter_bounds},
};
use crate::{
    columns::basis_columns,
    data::{DataTable, RowGroups},
    machine_laws::MachineLaws,
    model::{Model, shift_prediction},
    term_kind::{ModelPart, TermKind},
};

/// Data, and its groups of rows.
pub(crate) struct FitProblem {
    pub data: Arc<DataTable>,
    pub groups: RowGroups,
    /// The measured values, in groups.
    pub measured: Vec<f64>,
    /// Bounds that a value must keep, from the extent of the data.
    pub bounds: ParameterBounds,
    cache: Mutex<ColumnCache>,
    memo: MemoTable,
}

impl FitProblem {
    /// Rows that are worth several cores for a fit.
    const MIN_PARALLEL_GROUPS: usize = 500;

    /// Returns whether a fit takes long enough for a core of its own.
    pub(crate) fn is_parallel_worthwhile(&self) -> bool {
        self.groups.len() >= Self::MIN_PARALLEL_GROUPS
    }

    pub(crate) fn new(data: impl Into<Arc<DataTable>>, groups: RowGroups) -> Self {
        let data = data.into();
        let measured = groups.means(&data.measured);
        let bounds = compute_parameter_bounds(&data, &groups);
        Self { data, groups, measured, bounds, cache: Mutex::default(), memo: MemoTable::default() }
    }

    /// Returns what an added part of these nonlinear values adds at each amplitude of 1, in groups. `constrain_values`:
    /// they will be requested again and again.
    pub(crate) fn basis_columns(
        &self,
        kind: &TermKind,
        nonlinear: &[f64],
        keep: bool,
    ) -> GroupColumns {
        let key = CacheKey::from_part(kind, nonlinear);
        if let Some(known) = self.lock_cache().get(&key) {
            return known;
        }
        let is_of_elongation = kind.affects_elongation(&self.data);
        let columns: Vec<Vec<f64>> = basis_columns(kind, nonlinear, &self.data, &[])
            .into_iter()
            .map(|mut column| {
                if is_of_elongation {
                    let along = self.data.predicted.along.iter();
                    column.iter_mut().zip(along).for_each(|(c, along)| *c *= along);
                }
                self.groups.means(&column)
            })
            .collect();
        let columns = Arc::new(columns);
        self.lock_cache().insert(key, columns.clone(), keep);
        columns
    }

    /// Gives the room of what was worked out before to something larger.
    pub(crate) fn clear_caches(&self) {
        *self.lock_cache() = ColumnCache::default();
        self.memo.clear();
    }

    /// `what` was found for `model` before, else made now; it follows from both and from these data alone, and is no
    /// longer than a column.
    pub(crate) fn memoise<T: Any + Send + Sync>(
        &self,
        what: &str,
        model: &Model,
        make: impl FnOnce() -> T,
    ) -> Arc<T> {
        /// Numbers that are kept, 8 bytes each: 8 MB.
        const MAX_CACHED_VALUES: usize = 1_000_000;
        let many = MAX_CACHED_VALUES / self.groups.len().max(1);
        if many == 0 { Arc::new(make()) } else { self.memo.memoise(what, model, many, make) }
    }

    fn lock_cache(&self) -> MutexGuard<'_, ColumnCache> {
        self.cache.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns what `model` predicts, in groups.
    pub(crate) fn predict(&self, model: &Model) -> Vec<f64> {
        let model = &*model.with_machine_terms(&self.data);
        if let Some(shift_s) = model.time_shift_s() {
            let unshifted = self.predict_unshifted(model);
            return self.groups.means(&shift_prediction(&self.data, &unshifted, shift_s));
        }
        let (added, law): (Vec<&ModelPart>, Vec<&ModelPart>) =
            model.parts.iter().partition(|part| part.kind.is_additive());
        let mut sum = self.predict_nonadditive_parts(&law)[0].clone();
        for part in added {
            let (nonlinear, amplitudes) =
                part.values.split_at(part.kind.nonlinear_parameters().len());
            let columns = self.basis_columns(&part.kind, nonlinear, nonlinear.is_empty());
            for (column, amplitude) in columns.iter().zip(amplitudes) {
                sum.iter_mut().zip(column).for_each(|(sum, c)| *sum += amplitude * c);
            }
        }
        let constant = model.constant_um.unwrap_or(0.0);
        sum.iter_mut().for_each(|sum| *sum += constant);
        sum
    }

    /// Returns what the model predicts with these parts alone, which are not only added: one column.
    fn predict_nonadditive_parts(&self, law: &[&ModelPart]) -> GroupColumns {
        let key = CacheKey::from_parts(law);
        if let Some(known) = self.lock_cache().get(&key) {
            return known;
        }
        let model = Model { parts: law.iter().copied().cloned().collect(), constant_um: None };
        let predicted = self.predict_from_growth(&model);
        let predicted =
            predicted.unwrap_or_else(|| self.groups.means(&model.predict_unshifted(&self.data)));
        let predicted = Arc::new(vec![predicted]);
        self.lock_cache().insert(key, predicted.clone(), false);
        predicted
    }

    /// Returns the same where the parts multiply the growth, and at most correct its law where that is a factor times a
    /// temperature.
    fn predict_from_growth(&self, law: &Model) -> Option<Vec<f64>> {
        let (corrects, multiplies): (Vec<&ModelPart>, Vec<&ModelPart>) =
            law.parts.iter().partition(|part| part.kind.is_constant_correction());
        let factor = |part: &&ModelPart| {
            let is_of_growth =
                part.kind.is_multiplicative() && part.kind.affects_elongation(&self.data);
            let cause = part.kind.cause().filter(|_| is_of_growth)?;
            Some(1.0 + cause.evaluate_at(&part.values, &[1.0]))
        };
        let factor = multiplies.iter().map(factor).product::<Option<f64>>()?;
        let constant_part = || self.lock_cache().grown.invariant_columns(&self.data, &self.groups);
        if corrects.is_empty() {
            let constant_part = (!multiplies.is_empty()).then(constant_part)?;
            return Some(constant_part.prediction_with_growth(
                constant_part.law_um.iter().map(|um| factor * um),
                &self.data,
            ));
        }
        let laws = MachineLaws::with_corrections(&self.data, &law.parts);
        let growth = laws.thermal_growth(&self.data)?;
        let known = self.lock_cache().grown.cached_projected_temperature(&growth);
        let warm = known.unwrap_or_else(|| {
            let warm = Arc::new(growth_cache::projected_temperature_by_group(
                &growth,
                &self.data,
                &self.groups,
            ));
            self.lock_cache().grown.insert(&growth, &warm);
            warm
        });
        let (factor, reference_c) = (factor * growth.model.k_um_per_c, growth.model.reference_c);
        let constant_part = constant_part();
        let rows = warm.iter().zip(&constant_part.along);
        Some(constant_part.prediction_with_growth(
            rows.map(|(warm, along)| factor * (warm - reference_c * along)),
            &self.data,
        ))
    }

    /// Returns what the model would predict if nothing were late, in the rows of the whole.
    fn predict_unshifted(&self, model: &Model) -> Arc<Vec<f64>> {
        let mut plain = model.clone();
        plain.parts.retain(|part| !part.kind.is_time_shift());
        if let Some((there, predicted)) = &self.lock_cache().unshifted
            && *there == plain
        {
            return predicted.clone();
        }
        let predicted = Arc::new(plain.predict_unshifted(self.data.full_table()));
        self.lock_cache().unshifted = Some((plain, predicted.clone()));
        predicted
    }

    /// Returns the same, as if `measured` (in groups) had been measured.
    pub(crate) fn with_measured(&self, measured: Vec<f64>) -> Self {
        Self {
            data: self.data.clone(),
            groups: self.groups.clone(),
            measured,
            bounds: self.bounds,
            cache: Mutex::default(),
            memo: MemoTable::default(),
        }
    }

    /// Returns whether a time constant is so short that the record shows all of it: in each of its parts 95 % of a change
    /// comes.
    pub(crate) fn is_time_constant_short(&self, time_constant_s: f64) -> bool {
        SEGMENT_COUNT as f64 * settling_time_s(time_constant_s) < self.bounds.longest_s
    }

    /// Returns whether a value of a part is where its search ends, so that the best may lie beyond: a time
    /// constant at its longest (at its shortest it is none), an amplitude, a limit or a period at either
    /// end.
    pub(crate) fn is_at_bound(&self, part: &ModelPart) -> bool {
        // Equal to it, or next to the range: what stops there has not stopped by itself.
        let nonlinear = part.kind.nonlinear_parameters();
        let is_near = |value: f64, [low, high]: [f64; 2]| {
            (value - low).min(high - value) < EQUIVALENCE_TOLERANCE * (high - low)
        };
        let is_low = |value: f64, low: f64| value < (1.0 + EQUIVALENCE_TOLERANCE) * low;
        let is_high = |value: f64, high: f64| value > (1.0 - EQUIVALENCE_TOLERANCE) * high;
        let is_outer =
            |value: f64, [low, high]: [f64; 2]| is_low(value, low) || is_high(value, high);
        let is_at_end = |(value, what): (&f64, &NonlinearParameter)| match what {
            NonlinearParameter::TimeConstant | NonlinearParameter::FallingTimeConstant => {
                nonlinear_parameter_bounds(part).is_some_and(|[low, _]| is_low(*value, low))
                    || is_high(*value, self.bounds.time_constant_s[1])
            }
            NonlinearParameter::Period => is_outer(*value, self.bounds.period_mm),
            NonlinearParameter::TimePeriod => is_outer(*value, self.bounds.period_s),
            NonlinearParameter::Limit => *value <= self.bounds.prediction_um[0],
            NonlinearParameter::ThermometerDelay => is_high(*value, self.bounds.late_s[1]),
            NonlinearParameter::Shift => is_high(value.abs(), self.bounds.shift_s[1]),
            NonlinearParameter::ReadingPeriod
            | NonlinearParameter::Origin
            | NonlinearParameter::Instant => false,
            NonlinearParameter::Bend => {
                nonlinear_parameter_bounds(part).is_some_and(|limits| is_near(*value, limits))
            }
        };
        let limits = part.kind.cause().and_then(|cause| cause.amplitude_bounds());
        part.values.iter().zip(nonlinear).any(is_at_end)
            || limits.is_some_and(|limits| {
                part.values[nonlinear.len()..].iter().any(|value| is_near(*value, limits))
            })
    }

    /// Measured minus predicted, in groups.
    pub(crate) fn residual(&self, model: &Model) -> Vec<f64> {
        let predicted = self.predict(model);
        self.measured.iter().zip(predicted).map(|(m, p)| m - p).collect()
    }

    /// Holds the values of the model to what is physically possible and inside what the data can show.
    pub(super) fn constrain_values(&self, model: &mut Model) {
        let held = |value: &mut f64, [low, high]: [f64; 2]| *value = value.clamp(low, high);
        for part in &mut model.parts {
            let nonlinear = part.kind.nonlinear_parameters();
            let own = nonlinear_parameter_bounds(part);
            for (value, what) in part.values.iter_mut().zip(nonlinear) {
                match what {
                    NonlinearParameter::TimeConstant => {
                        held(value, self.bounds.time_constant_s);
                        own.into_iter().for_each(|limits| held(value, limits));
                    }
                    NonlinearParameter::FallingTimeConstant => {
                        held(value, self.bounds.time_constant_s)
                    }
                    NonlinearParameter::Shift => held(value, self.bounds.shift_s),
                    NonlinearParameter::ThermometerDelay => held(value, self.bounds.late_s),
                    NonlinearParameter::Limit => held(value, self.bounds.prediction_um),
                    NonlinearParameter::Period => held(value, self.bounds.period_mm),
                    NonlinearParameter::TimePeriod => held(value, self.bounds.period_s),
                    NonlinearParameter::Bend => {
                        own.into_iter().for_each(|limits| held(value, limits))
                    }
                    NonlinearParameter::ReadingPeriod
                    | NonlinearParameter::Origin
                    | NonlinearParameter::Instant => {}
                }
            }
            if let Some(limits) = part.kind.cause().and_then(|cause| cause.amplitude_bounds()) {
                part.values[nonlinear.len()..].iter_mut().for_each(|value| held(value, limits));
            }
        }
    }
}

/// Returns the time in which 95 % of a change come, in s.
pub(crate) fn settling_time_s(time_constant_s: f64) -> f64 {
    -(1.0 - CONFIDENCE_LEVEL).ln() * time_constant_s
}

/// Returns the range of a part's only nonlinear value, where its page knows it.
fn nonlinear_parameter_bounds(part: &ModelPart) -> Option<[f64; 2]> {
    part.kind.cause().and_then(|cause| cause.nonlinear_parameter_bounds())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use trueup_machine::{MachineFile, RunFile, machine_file::Quantity};

    use super::*;
    use crate::candidates::single_input_candidates;

    /// Returns the shifts that are admitted for ten minutes at 20 Hz.
    fn shifts_s(clock: &str, terms: &str) -> [f64; 2] {
        let mut text = format!("time_s,sensor_counts,measured_elongation_um{clock}\n");
        for row in 0..=12_000 {
            let time_s = f64::from(row) / 20.0;
            let cell = if clock.is_empty() { String::new() } else { format!(",{time_s}") };
            text += &format!("{time_s},{},0.0{cell}\n", row % 7);
        }
        let file = format!(
            "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"sensor\"\n\
             [spindle.sensor]\nk0_um = 0.0\nzero_counts = 0.0\num_per_count = 0.5\n{terms}"
        );
        let machine = MachineFile::parse(&file, Path::new("m.toml")).expect("a machine file");
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
        let data = DataTable::new(&machine, &[run], Quantity::Elongation).expect("comparable");
        assert!(data.unknown_columns().is_empty(), "the gauge's clock explains nothing");
        let groups = RowGroups::new(&data, &data.used.clone(), 12);
        FitProblem::new(data, groups).bounds.shift_s
    }

    #[test]
    fn a_shift_may_be_a_tenth_of_the_record_however_often_it_was_read() {
        assert_eq!(shifts_s("", ""), [0.0, 60.0]);
    }

    #[test]
    fn a_measurement_comes_early_only_by_another_clock() {
        assert_eq!(shifts_s(",gauge_time_s", ""), [-60.0, 60.0]);
        let stated =
            "[[term]]\nquantity = \"elongation\"\ncause = \"time-shift\"\nshift_s = -3.0\n";
        assert_eq!(shifts_s("", stated), [-60.0, 60.0]);
    }

    /// Growth that comes sooner than 300 s is growth by the speed itself.
    #[test]
    fn heat_of_the_speed_has_its_shortest_time_constant_in_the_fit_too() {
        let mut text = String::from("time_s,spindle_rpm,measured_elongation_um\n");
        for row in 0..200 {
            text += &format!("{},{},0.0\n", 60 * row, 6000 * (row / 20 % 3));
        }
        let file = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[[term]]\nquantity = \"elongation\"\ncause = \
                    \"extra-heat-path\"\ncolumn = \"spindle_rpm\"\num_per_krpm2 = 0.5\ntime_constant_s = 900.0\n";
        let machine = MachineFile::parse(file, Path::new("m.toml")).expect("a machine file");
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
        let data = DataTable::new(&machine, &[run], Quantity::Elongation).expect("comparable");
        let mut part = ModelPart::from_stated_term(&data.setting.stated[0]);
        part.values[0] = 20.0;
        let groups = RowGroups::new(&data, &data.used.clone(), 1);
        let problem = FitProblem::new(data, groups);
        let mut model = Model { parts: vec![part], constant_um: None };
        problem.constrain_values(&mut model);
        assert_eq!(model.parts[0].values[0], 300.0);
        assert!(problem.is_at_bound(&model.parts[0]));
    }

    #[test]
    fn what_multiplies_the_growth_is_of_groups_what_it_is_of_their_rows() {
        let mut text = String::from("time_s,temp_a_c,measured_elongation_um,measured_dz_um\n");
        for row in 0..240 {
            let time_s = f64::from(row) * 7.0;
            text += &format!("{time_s},{},0.0,0.0\n", 20.0 + 5.0 * (time_s / 200.0).sin());
        }
        let file = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"temperature\"\n\
                    [spindle.temperature]\nsensor = \"temp_a_c\"\nreference_c = 20.0\nk_um_per_c = \
                    2.0\n[[term]]\nquantity = \"elongation\"\ncause = \"extra-heat-path\"\ncolumn = \
                    \"temp_a_c\"\num_per_c = 0.5\nreference_c = 21.0\n";
        let machine = MachineFile::parse(file, Path::new("m.toml")).expect("a machine file");
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
        for quantity in [Quantity::Elongation, Quantity::Dz] {
            let data =
                DataTable::new(&machine, std::slice::from_ref(&run), quantity).expect("comparable");
            let groups = RowGroups::new(&data, &data.used.clone(), 6);
            let problem = FitProblem::new(data, groups);
            let possible_candidates =
                single_input_candidates(&problem, &Model::default(), &problem.measured);
            let part = |name: &str, value: f64| {
                let candidate =
                    possible_candidates.iter().find(|candidate| candidate.kind.name() == name);
                let kind = candidate.expect("the machine grows").kind.clone();
                ModelPart { kind, values: vec![value] }
            };
            let (factor, lag) = (part("growth-amplitude", 0.3), part("thermal-lag", 90.0));
            for parts in [vec![factor.clone()], vec![lag.clone()], vec![lag, factor]] {
                let model = Model { parts, constant_um: Some(1.5) };
                let of_rows = problem.groups.means(&model.predict(&problem.data));
                let of_groups = problem.predict(&model);
                assert_ne!(of_groups, problem.predict(&Model::default()));
                for (groups, rows) in of_groups.iter().zip(&of_rows) {
                    assert!((groups - rows).abs() < 1e-9, "{quantity:?}: {groups} {rows}");
                }
            }
        }
    }
}
