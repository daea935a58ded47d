//! The data of a fit: the table, its groups of rows, and how far each value may go.

use std::{
    any::Any,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use trueup_machine::effect::{MIN_GROUPS_IN_A_PERIOD, Nonlinear};
use trueup_numerics::blocks::{CORRELATION_TIMES, PARTS};

use super::{
    LEVEL,
    cache::{Cache, Columns, Key},
    growth,
    memo::Memo,
};
use crate::{
    columns::basis,
    data::{Data, Groups},
    kind::{Kind, Part},
    laws::Laws,
    model::{Model, shifted_rows},
};

/// Data, and its groups of rows.
pub(crate) struct Problem {
    pub data: Arc<Data>,
    pub groups: Groups,
    /// The measured values, in groups.
    pub measured: Vec<f64>,
    /// Bounds that a value must keep, from the extent of the data.
    pub bounds: Bounds,
    cache: Mutex<Cache>,
    memo: Memo,
}

/// Bounds of the nonlinear values.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    /// Time constants, in s.
    pub time_constant_s: [f64; 2],
    /// The longest series, in s.
    pub longest_s: f64,
    /// Times of the record, in s.
    pub time_s: [f64; 2],
    /// From row to row, in s; above 0.
    pub step_s: f64,
    /// Shifts of the prediction, in s: at most a tenth of the longest series, below 0 only where the
    /// run has a second clock, or the machine file such a shift.
    pub shift_s: [f64; 2],
    /// How late a thermometer may be, in s: from the spacing of the rows, which shows less of it, to a
    /// tenth of the longest series.
    pub late_s: [f64; 2],
    /// How far the quantity's own axis went, in mm; above 0.
    pub travel_mm: f64,
    /// Periods, in mm.
    pub period_mm: [f64; 2],
    /// Periods, in s.
    pub period_s: [f64; 2],
    /// The model's prediction, in µm.
    pub prediction_um: [f64; 2],
}

impl Problem {
    /// Rows that are worth several cores for a fit.
    const MANY_GROUPS: usize = 500;

    /// Returns whether a fit takes long enough for a core of its own.
    pub(crate) fn is_large(&self) -> bool {
        self.groups.len() >= Self::MANY_GROUPS
    }

    pub(crate) fn new(data: impl Into<Arc<Data>>, groups: Groups) -> Self {
        let data = data.into();
        let measured = groups.means(&data.measured);
        let bounds = bounds(&data, &groups);
        Self { data, groups, measured, bounds, cache: Mutex::default(), memo: Memo::default() }
    }

    /// Returns what an added part of these nonlinear values adds at each amplitude of 1, in groups. `keep`:
    /// they will be asked for again and again.
    pub(crate) fn columns(&self, kind: &Kind, nonlinear: &[f64], keep: bool) -> Columns {
        let key = Key::of(kind, nonlinear);
        if let Some(known) = self.cache().get(&key) {
            return known;
        }
        let is_of_elongation = kind.is_of_elongation(&self.data);
        let columns: Vec<Vec<f64>> = basis(kind, nonlinear, &self.data, &[])
            .into_iter()
            .map(|mut column| {
                if is_of_elongation {
                    let along = self.data.along.iter();
                    column.iter_mut().zip(along).for_each(|(c, along)| *c *= along);
                }
                self.groups.means(&column)
            })
            .collect();
        let columns = Arc::new(columns);
        self.cache().put(key, columns.clone(), keep);
        columns
    }

    /// Gives the room of what was worked out before to something larger.
    pub(crate) fn forget(&self) {
        *self.cache() = Cache::default();
        self.memo.clear();
    }

    /// `what` was found for `model` before, else made now; it follows from both and from these data alone, and is no
    /// longer than a column.
    pub(crate) fn known<T: Any + Send + Sync>(
        &self,
        what: &str,
        model: &Model,
        make: impl FnOnce() -> T,
    ) -> Arc<T> {
        /// Numbers that are kept, 8 bytes each: 8 MB.
        const MAX_NUMBERS: usize = 1_000_000;
        let many = MAX_NUMBERS / self.groups.len().max(1);
        if many == 0 { Arc::new(make()) } else { self.memo.known(what, model, many, make) }
    }

    fn cache(&self) -> MutexGuard<'_, Cache> {
        self.cache.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns what `model` predicts, in groups.
    pub(crate) fn predicted(&self, model: &Model) -> Vec<f64> {
        let model = &*model.with_stated(&self.data);
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

    /// Returns what the model predicts with these parts alone, which are not only added: one column.
    fn of_law(&self, law: &[&Part]) -> Columns {
        let key = Key::of_all(law);
        if let Some(known) = self.cache().get(&key) {
            return known;
        }
        let model = Model { parts: law.iter().copied().cloned().collect(), constant_um: None };
        let predicted = self.grown(&model);
        let predicted =
            predicted.unwrap_or_else(|| self.groups.means(&model.unshifted(&self.data)));
        let predicted = Arc::new(vec![predicted]);
        self.cache().put(key, predicted.clone(), false);
        predicted
    }

    /// Returns the same where the parts multiply the growth, and at most correct its law where that is a factor times a
    /// temperature.
    fn grown(&self, law: &Model) -> Option<Vec<f64>> {
        let (corrects, multiplies): (Vec<&Part>, Vec<&Part>) =
            law.parts.iter().partition(|part| part.kind.corrects());
        let factor = |part: &&Part| {
            let is_of_growth = part.kind.is_factor() && part.kind.is_of_elongation(&self.data);
            let cause = part.kind.cause().filter(|_| is_of_growth)?;
            Some(1.0 + cause.at_row(&part.values, &[1.0]))
        };
        let factor = multiplies.iter().map(factor).product::<Option<f64>>()?;
        let still = || self.cache().grown.still(&self.data, &self.groups);
        if corrects.is_empty() {
            let still = (!multiplies.is_empty()).then(still)?;
            return Some(still.and(still.law_um.iter().map(|um| factor * um), &self.data));
        }
        let laws = Laws::corrected(&self.data, &law.parts);
        let growth = laws.growth(&self.data)?;
        let known = self.cache().grown.known(&growth);
        let warm = known.unwrap_or_else(|| {
            let warm = Arc::new(growth::warm(&growth, &self.data, &self.groups));
            self.cache().grown.put(&growth, &warm);
            warm
        });
        let (factor, reference_c) = (factor * growth.model.k_um_per_c, growth.model.reference_c);
        let still = still();
        let rows = warm.iter().zip(&still.along);
        Some(still.and(rows.map(|(warm, along)| factor * (warm - reference_c * along)), &self.data))
    }

    /// Returns what the model would predict if nothing were late, in the rows of the whole.
    fn unshifted(&self, model: &Model) -> Arc<Vec<f64>> {
        let mut plain = model.clone();
        plain.parts.retain(|part| !part.kind.is_shift());
        if let Some((there, predicted)) = &self.cache().unshifted
            && *there == plain
        {
            return predicted.clone();
        }
        let predicted = Arc::new(plain.unshifted(self.data.without_holes()));
        self.cache().unshifted = Some((plain, predicted.clone()));
        predicted
    }

    /// Returns the same, as if `measured` (in groups) had been measured.
    pub(crate) fn measuring(&self, measured: Vec<f64>) -> Self {
        Self {
            data: self.data.clone(),
            groups: self.groups.clone(),
            measured,
            bounds: self.bounds,
            cache: Mutex::default(),
            memo: Memo::default(),
        }
    }

    /// Returns whether a time constant is so short that the record shows all of it: in each of its parts 95 % of a change
    /// comes.
    pub(crate) fn is_short(&self, time_constant_s: f64) -> bool {
        let settled_s = -(1.0 - LEVEL).ln() * time_constant_s;
        PARTS as f64 * settled_s < self.bounds.longest_s
    }

    /// Returns whether a value of a part is where its search ends, so that the best may lie beyond: a time
    /// constant at its longest (at its shortest it is none), an amplitude, a limit or a period at either
    /// end.
    pub(crate) fn is_at_the_end(&self, part: &Part) -> bool {
        // To a twentieth of it, or of the range: what stops there has not stopped by itself.
        const NEAR: f64 = 0.05;
        let nonlinear = part.kind.nonlinear();
        let is_near = |value: f64, [low, high]: [f64; 2]| {
            value - low < NEAR * (high - low) || high - value < NEAR * (high - low)
        };
        let is_at_end = |(value, what): (&f64, &Nonlinear)| match what {
            Nonlinear::TimeConstant | Nonlinear::FallingTimeConstant => {
                let own_s = limits_of(part).is_some_and(|[low, _]| *value < (1.0 + NEAR) * low);
                own_s || *value > (1.0 - NEAR) * self.bounds.time_constant_s[1]
            }
            Nonlinear::Period => {
                let [low, high] = self.bounds.period_mm;
                *value < (1.0 + NEAR) * low || *value > (1.0 - NEAR) * high
            }
            Nonlinear::TimePeriod => {
                let [low, high] = self.bounds.period_s;
                *value < (1.0 + NEAR) * low || *value > (1.0 - NEAR) * high
            }
            Nonlinear::Limit => *value <= self.bounds.prediction_um[0],
            Nonlinear::Late => *value > (1.0 - NEAR) * self.bounds.late_s[1],
            Nonlinear::Shift => value.abs() > (1.0 - NEAR) * self.bounds.shift_s[1],
            Nonlinear::ReadingPeriod | Nonlinear::Origin | Nonlinear::Instant => false,
            Nonlinear::Bend => limits_of(part).is_some_and(|limits| is_near(*value, limits)),
        };
        let limits = part.kind.cause().and_then(|cause| cause.amplitude_limits());
        part.values.iter().zip(nonlinear).any(is_at_end)
            || limits.is_some_and(|limits| {
                part.values[nonlinear.len()..].iter().any(|value| is_near(*value, limits))
            })
    }

    /// Measured minus predicted, in groups.
    pub(crate) fn residual(&self, model: &Model) -> Vec<f64> {
        let predicted = self.predicted(model);
        self.measured.iter().zip(predicted).map(|(m, p)| m - p).collect()
    }

    /// Holds the values of the model to what is physically possible and inside what the data can show.
    pub(super) fn keep(&self, model: &mut Model) {
        let falls = |part: &Part| part.kind.nonlinear().contains(&Nonlinear::FallingTimeConstant);
        let is_falling = model.parts.iter().any(falls);
        let rise_s = is_falling
            .then(|| {
                Laws::corrected(&self.data, &model.with_stated(&self.data).parts).rise_s(&self.data)
            })
            .flatten();
        let held = |value: &mut f64, [low, high]: [f64; 2]| *value = value.clamp(low, high);
        for part in &mut model.parts {
            let nonlinear = part.kind.nonlinear();
            let own = limits_of(part);
            for (value, what) in part.values.iter_mut().zip(nonlinear) {
                match what {
                    Nonlinear::TimeConstant => {
                        held(value, self.bounds.time_constant_s);
                        own.into_iter().for_each(|limits| held(value, limits));
                    }
                    Nonlinear::FallingTimeConstant => {
                        if let Some(rise_s) = rise_s {
                            held(value, [rise_s / ALIKE, ALIKE * rise_s]);
                        }
                        held(value, self.bounds.time_constant_s);
                    }
                    Nonlinear::Shift => held(value, self.bounds.shift_s),
                    Nonlinear::Late => held(value, self.bounds.late_s),
                    Nonlinear::Limit => held(value, self.bounds.prediction_um),
                    Nonlinear::Period => held(value, self.bounds.period_mm),
                    Nonlinear::TimePeriod => held(value, self.bounds.period_s),
                    Nonlinear::Bend => own.into_iter().for_each(|limits| held(value, limits)),
                    Nonlinear::ReadingPeriod | Nonlinear::Origin | Nonlinear::Instant => {}
                }
            }
            if let Some(limits) = part.kind.cause().and_then(|cause| cause.amplitude_limits()) {
                part.values[nonlinear.len()..].iter_mut().for_each(|value| held(value, limits));
            }
        }
    }
}

/// Returns the range of a part's only nonlinear value, where its page knows it.
fn limits_of(part: &Part) -> Option<[f64; 2]> {
    part.kind.cause().and_then(|cause| cause.nonlinear_limits())
}

/// The latest that a thermometer on a machine is, in s. A sheathed one in still air has shown nine tenths of a
/// change within ten minutes (IEC 60751: 2.3 time constants of 260 s), and as much again where it sits on
/// another body than it stands for; what is later than a quarter of an hour is another part's temperature.
const LATEST_THERMOMETER_S: f64 = 900.0;

/// The share of the longest series by which the prediction, or a thermometer, may be late. Rows shifted out of a record
/// cannot be compared any more: nine tenths of it still are.
const MAX_SHIFT: f64 = 0.1;
/// The longest, in records: of one that is longer less than a third is in the record.
const LONGEST_RECORDS: f64 = 3.0;
/// The longest period, in travels: a wave that turns less than one and a half times is a curve.
const LONGEST_PERIOD: f64 = 0.7;
/// The same in time, in records: what comes and goes less than two and a half times is a slow law of something.
const LONGEST_TIME_PERIOD: f64 = 0.4;
/// Heat that cools this many times faster or slower than it warms is not the same heat.
const ALIKE: f64 = 5.0;

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
    let step_s = longest_s * data.files as f64 / (data.recorded_rows() as f64).max(2.0);
    // Of a shorter one less than a hundredth is left after a row.
    let fastest_s = (step_s / CORRELATION_TIMES).max(data.fastest_lag_s());
    let own = data.own_position();
    let range = own.map_or([0.0, 1.0], |mm| finite(extent(&mut mm.iter().copied()), [0.0, 1.0]));
    let prediction = Model::default().predict(data);
    let prediction_um = finite(extent(&mut prediction.iter().copied()), [0.0, 1.0]);
    Bounds {
        time_constant_s: [fastest_s, LONGEST_RECORDS * longest_s],
        longest_s,
        time_s,
        step_s,
        late_s: [fastest_s, (MAX_SHIFT * longest_s).min(LATEST_THERMOMETER_S)],
        shift_s: {
            let states_early = data.stated.iter().any(|stated| stated.effect.shift_s() < 0.0);
            let has_early = data.gauge_time_s.is_some() || states_early;
            let most_s = MAX_SHIFT * longest_s;
            [if has_early { -most_s } else { 0.0 }, most_s]
        },
        travel_mm: range[1] - range[0],
        period_mm: [
            (range[1] - range[0]) / groups.len().max(2) as f64,
            LONGEST_PERIOD * (range[1] - range[0]),
        ],
        period_s: [
            MIN_GROUPS_IN_A_PERIOD * longest_s / groups.len().max(2) as f64,
            LONGEST_TIME_PERIOD * longest_s,
        ],
        prediction_um,
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use trueup_machine::{MachineFile, RunFile, file::Quantity};

    use super::*;
    use crate::candidates::possible;

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
        let data = Data::new(&machine, &[run], Quantity::Elongation).expect("comparable");
        assert!(data.others.is_empty(), "the gauge's clock explains nothing");
        let groups = Groups::new(&data, &data.used.clone(), 12);
        Problem::new(data, groups).bounds.shift_s
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
        let data = Data::new(&machine, &[run], Quantity::Elongation).expect("comparable");
        let mut part = Part::stated(&data.stated[0]);
        part.values[0] = 20.0;
        let groups = Groups::new(&data, &data.used.clone(), 1);
        let problem = Problem::new(data, groups);
        let mut model = Model { parts: vec![part], constant_um: None };
        problem.keep(&mut model);
        assert_eq!(model.parts[0].values[0], 300.0);
        assert!(problem.is_at_the_end(&model.parts[0]));
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
                Data::new(&machine, std::slice::from_ref(&run), quantity).expect("comparable");
            let groups = Groups::new(&data, &data.used.clone(), 6);
            let problem = Problem::new(data, groups);
            let possible = possible(&problem, &Model::default(), &problem.measured);
            let part = |name: &str, value: f64| {
                let candidate = possible.iter().find(|it| it.kind.name() == name);
                let kind = candidate.expect("the machine grows").kind.clone();
                Part { kind, values: vec![value] }
            };
            let (factor, lag) = (part("growth-amplitude", 0.3), part("thermal-lag", 90.0));
            for parts in [vec![factor.clone()], vec![lag.clone()], vec![lag, factor]] {
                let model = Model { parts, constant_um: Some(1.5) };
                let of_rows = problem.groups.means(&model.predict(&problem.data));
                let of_groups = problem.predicted(&model);
                assert_ne!(of_groups, problem.predicted(&Model::default()));
                for (groups, rows) in of_groups.iter().zip(&of_rows) {
                    assert!((groups - rows).abs() < 1e-9, "{quantity:?}: {groups} {rows}");
                }
            }
        }
    }
}
