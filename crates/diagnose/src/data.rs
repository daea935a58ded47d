//! The runs as one table: what was measured, what the model says, and what might explain the rest.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
};

use trueup_machine::{
    BadInput, Machine, RunFile,
    machine_file::{LinearAxis, Quantity, is_temperature_column},
    model::{Reference, Situation, shifted, time_shift_s},
};
use trueup_numerics::noise::Steps;

use crate::columns::{filled, lagged};

/// A run's columns, all files one after the other. A list has one value a row; NaN where missing.
#[derive(Clone, Debug)]
pub(crate) struct Data {
    pub machine: Machine,
    pub quantity: Quantity,
    pub rows: usize,
    /// The number of the file of each row.
    pub file: Vec<usize>,
    pub files: usize,
    /// Rows at which states begin anew: the first of a file, and where time runs back.
    pub restart: Vec<bool>,
    /// The number of the series of each row: files, runs, restarts.
    pub series: Vec<usize>,
    pub time_s: Option<Vec<f64>>,
    pub run: Option<Vec<f64>>,
    pub temperatures: Vec<(String, Vec<f64>)>,
    /// Columns that this project does not know.
    pub others: Vec<(String, Vec<f64>)>,
    pub spindle_rpm: Option<Vec<f64>>,
    pub load_n: Option<Vec<f64>>,
    pub position_mm: [Option<Vec<f64>>; 3],
    pub direction: [Option<Vec<f64>>; 3],
    /// What is left of the last reversal of the quantity's own axis if it is taken up over a way, for
    /// several ways, each under its name.
    pub untaken: Vec<(String, Vec<f64>)>,
    pub measured: Vec<f64>,
    /// The model's elongation.
    pub elongation: Vec<f64>,
    /// How much of the elongation is in the quantity.
    pub along: Vec<f64>,
    pub has_elongation: bool,
    /// The axis's error but for the tool's growth.
    pub axis: Vec<f64>,
    /// The part of it that goes with the axis's temperature.
    pub thermal: Vec<f64>,
    /// Rows that count: measured and predicted.
    pub used: Vec<bool>,
    /// The temperatures that terms are counted from, by column, and the start of time: those of the
    /// first row that was trained on. A hold-out has its own first row and never refers to it.
    pub references_c: Vec<(String, f64)>,
    pub start_s: f64,
    /// Where these are drawn rows: all of them, for what a row has from the rows before it.
    pub whole: Option<Whole>,
}

/// The table that rows were drawn from.
#[derive(Clone, Debug)]
pub(crate) struct Whole {
    pub data: Arc<Data>,
    /// Which of its rows were drawn, rising.
    rows: Vec<usize>,
    /// Columns behind a lag that were asked for, the newest last.
    lagged: Arc<Mutex<VecDeque<Lagged>>>,
}

/// A column, and the time constants of its rise and fall, to the bit; the drawn rows of it.
type Lagged = ((String, [u64; 2]), Vec<f64>);

impl Whole {
    /// Enough for a grid of time constants.
    const MOST_LAGGED: usize = 128;

    /// A column of the whole behind a lag, in the drawn rows.
    pub(crate) fn lagged(&self, column: &str, rise_s: f64, fall_s: f64) -> Vec<f64> {
        let asked = (column.to_owned(), [rise_s, fall_s].map(f64::to_bits));
        let known = || self.lagged.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, values)) = known().iter().find(|(there, _)| *there == asked) {
            return values.clone();
        }
        let values = self.pick(&lagged(&self.data, column, rise_s, fall_s));
        let mut known = known();
        known.push_back((asked, values.clone()));
        if known.len() > Self::MOST_LAGGED {
            known.pop_front();
        }
        values
    }

    /// Of values for all rows, those of the drawn ones.
    pub(crate) fn pick(&self, all: &[f64]) -> Vec<f64> {
        self.rows.iter().map(|&row| all[row]).collect()
    }
}

/// The quantity that is asked for, or the only one that the runs measure.
pub(crate) fn quantity_of(runs: &[RunFile], asked: Option<Quantity>) -> Result<Quantity, BadInput> {
    let measured = |quantity: Quantity| format!("measured_{}_um", quantity.name());
    if let Some(quantity) = asked {
        for run in runs {
            run.require(&measured(quantity))?;
        }
        return Ok(quantity);
    }
    let first = &runs[0];
    let there: Vec<Quantity> = Quantity::ALL
        .into_iter()
        .filter(|&quantity| runs.iter().all(|run| run.column(&measured(quantity)).is_some()))
        .collect();
    match there[..] {
        [only] => Ok(only),
        [] => {
            let places = first.place(0, "");
            let header = trueup_machine::Place { line: 1, column: 1, ..places };
            let rule = "a column measured_elongation_um, measured_dx_um, measured_dy_um or \
                        measured_dz_um is missing: there is nothing to compare the model with";
            Err(BadInput::new(header, rule))
        }
        _ => {
            let names: Vec<&str> = there.iter().map(|quantity| quantity.name()).collect();
            let header = trueup_machine::Place { line: 1, column: 1, ..first.place(0, "") };
            let rule = format!(
                "several quantities are measured: choose one by --quantity {}",
                names.join(" or --quantity ")
            );
            Err(BadInput::new(header, rule))
        }
    }
}

impl Data {
    /// The table of `runs`, compared in `quantity` (checked by [`quantity_of`]).
    pub(crate) fn new(
        machine: &Machine,
        runs: &[RunFile],
        quantity: Quantity,
    ) -> Result<Self, BadInput> {
        let rows: usize = runs.iter().map(RunFile::rows).sum();
        let joined = |name: &str| -> Option<Vec<f64>> {
            if !runs.iter().any(|run| run.column(name).is_some()) {
                return None;
            }
            let mut all = Vec::with_capacity(rows);
            for run in runs {
                match run.column(name) {
                    Some(values) => all.extend_from_slice(values),
                    None => all.resize(all.len() + run.rows(), f64::NAN),
                }
            }
            Some(all)
        };
        let measured = joined(&format!("measured_{}_um", quantity.name())).unwrap_or_default();
        let time_s = joined("time_s");
        let run = joined("run");
        let mut file = Vec::with_capacity(rows);
        let mut restart = Vec::with_capacity(rows);
        for (number, run) in runs.iter().enumerate() {
            let times = run.column("time_s");
            let mut last_s = f64::NEG_INFINITY;
            for row in 0..run.rows() {
                let now_s = times.map_or(f64::NAN, |times| times[row]);
                restart.push(row == 0 || now_s < last_s);
                if !now_s.is_nan() {
                    last_s = now_s;
                }
                file.push(number);
            }
        }
        let mut series = Vec::with_capacity(rows);
        let mut number: usize = 0;
        for row in 0..rows {
            // Where there is time, it says how far apart two runs are.
            let new_run = row > 0
                && time_s.is_none()
                && run.as_ref().is_some_and(|run| {
                    run[row] != run[row - 1] && !(run[row].is_nan() && run[row - 1].is_nan())
                });
            if row > 0 && (restart[row] || new_run) {
                number += 1;
            }
            series.push(number);
        }
        let mut temperatures = Vec::new();
        let mut others = Vec::new();
        for column in runs[0].columns() {
            // What is only in some of the files cannot be compared over all of them.
            if !runs.iter().all(|run| run.column(&column.name).is_some()) {
                continue;
            }
            let name = column.name.as_str();
            let target = if is_temperature_column(name) {
                &mut temperatures
            } else if is_known(name) {
                continue;
            } else {
                &mut others
            };
            target.push((column.name.clone(), joined(name).unwrap_or_default()));
        }
        let mut data = Self {
            machine: machine.clone(),
            quantity,
            rows,
            file,
            files: runs.len(),
            restart,
            series,
            time_s,
            run,
            temperatures,
            others,
            spindle_rpm: joined("spindle_rpm"),
            load_n: joined("load_n"),
            position_mm: ["x_mm", "y_mm", "z_mm"].map(joined),
            direction: ["dir_x", "dir_y", "dir_z"].map(joined),
            untaken: Vec::new(),
            measured,
            elongation: Vec::new(),
            along: Vec::new(),
            has_elongation: quantity == Quantity::Elongation || machine.has_elongation(),
            axis: Vec::new(),
            thermal: Vec::new(),
            used: Vec::new(),
            references_c: Vec::new(),
            start_s: 0.0,
            whole: None,
        };
        data.references_c = data
            .temperatures
            .iter()
            .map(|(name, values)| (name.clone(), Self::first_of(values)))
            .collect();
        data.start_s = data.time_s.as_deref().map_or(0.0, Self::first_of);
        data.untaken = data.untaken();
        data.predict(runs);
        if !data.used.iter().any(|&used| used) {
            // Says which column is missing, where one is.
            for name in trueup_machine::model::required_columns(machine) {
                for run in runs {
                    run.require(&name)?;
                }
            }
            let name = format!("measured_{}_um", quantity.name());
            return Err(runs[0].bad(0, &name, "has no row that is both measured and predicted"));
        }
        Ok(data)
    }

    /// For ways in equal ratios between the shortest and the longest steps: u ← (u + Δd)·e^(−|ΔP|/way),
    /// Δd the change of the direction. Nothing where the axis never turns.
    fn untaken(&self) -> Vec<(String, Vec<f64>)> {
        const WAYS: i32 = 6;
        let (Some(own), Some(direction)) = (self.own_position(), self.own_direction()) else {
            return Vec::new();
        };
        let is_next = |row: usize| row > 0 && self.series[row] == self.series[row - 1];
        let step = |row: usize| (own[row] - own[row - 1]).abs();
        let mut steps: Vec<f64> =
            (0..self.rows).filter(|&row| is_next(row)).map(step).filter(|mm| *mm > 0.0).collect();
        steps.sort_by(f64::total_cmp);
        let turns = |row: usize| is_next(row) && direction[row] * direction[row - 1] < 0.0;
        let (Some(&short), true) = (steps.get(steps.len() / 20), (0..self.rows).any(turns)) else {
            return Vec::new();
        };
        // Beyond twenty of the shortest steps nothing would be left of it at once.
        (0..WAYS)
            .map(|n| {
                let way_mm = short * 20.0_f64.powf(f64::from(n + 1) / f64::from(WAYS));
                let mut left = 0.0;
                let values = (0..self.rows)
                    .map(|row| {
                        if !is_next(row) {
                            left = 0.0;
                        } else if !step(row).is_nan() {
                            if turns(row) {
                                left += direction[row] - direction[row - 1];
                            }
                            left *= (-step(row) / way_mm).exp();
                        }
                        left
                    })
                    .collect();
                (format!("the last reversal, taken up over {way_mm:.3} mm"), values)
            })
            .collect()
    }

    /// Steps the reference model through the runs.
    fn predict(&mut self, runs: &[RunFile]) {
        let at = |column: &Option<Vec<f64>>, row: usize| {
            column.as_ref().map_or(f64::NAN, |values| values[row])
        };
        let angles: Vec<[Option<&[f64]>; 3]> = runs
            .iter()
            .map(|run| ["a_deg", "b_deg", "c_deg"].map(|name| run.column(name)))
            .collect();
        let counts: Vec<Option<&[f64]>> =
            runs.iter().map(|run| run.column("sensor_counts")).collect();
        let axis = self.quantity.axis().map(LinearAxis::index);
        let machine = self.machine.clone();
        let mut row = 0;
        for (number, run) in runs.iter().enumerate() {
            let mut reference = Reference::new(&machine);
            for own in 0..run.rows() {
                let temperatures: Vec<(&str, f64)> = self
                    .temperatures
                    .iter()
                    .map(|(name, values)| (name.as_str(), values[row]))
                    .collect();
                let of = |column: Option<&[f64]>| column.map_or(f64::NAN, |values| values[own]);
                let parts = reference.step(&Situation {
                    time_s: run.column("time_s").map(|_| at(&self.time_s, row)),
                    sensor_counts: of(counts[number]),
                    spindle_rpm: run.column("spindle_rpm").map(|_| at(&self.spindle_rpm, row)),
                    load_n: run.column("load_n").map(|_| at(&self.load_n, row)),
                    temperatures_c: &temperatures,
                    position_mm: [0, 1, 2].map(|n| at(&self.position_mm[n], row)),
                    angle_deg: angles[number].map(of),
                    direction: [0, 1, 2].map(|n| at(&self.direction[n], row)),
                });
                let (along, rest, thermal) = match axis {
                    None => (1.0, 0.0, 0.0),
                    Some(axis) => (
                        parts.tool_direction[axis],
                        parts.error_um()[axis] - parts.tool_um[axis],
                        parts.thermal_um[axis],
                    ),
                };
                let is_blind = along == 0.0 || !self.has_elongation;
                self.elongation.push(if is_blind { 0.0 } else { parts.elongation_um });
                self.along.push(if is_blind && axis.is_some() { 0.0 } else { along });
                self.axis.push(rest);
                self.thermal.push(thermal);
                row += 1;
            }
        }
        // A machine that has been diagnosed before may have a time shift among its terms.
        let shift_s = time_shift_s(&self.machine.terms, self.quantity);
        if let (Some(time_s), true) = (&self.time_s, shift_s != 0.0) {
            let part = if axis.is_none() { &mut self.elongation } else { &mut self.axis };
            *part = shifted(time_s, part, shift_s);
        }
        self.used = (0..self.rows)
            .map(|row| {
                let p = self.along[row] * self.elongation[row] + self.axis[row];
                self.measured[row].is_finite() && p.is_finite()
            })
            .collect();
    }

    /// The rows of `mask` alone; what has a memory is still stepped through all of them.
    pub(crate) fn subset(self: &Arc<Self>, mask: &[bool]) -> Self {
        let rows: Vec<usize> = (0..self.rows).filter(|&row| mask[row]).collect();
        let pick =
            |values: &Vec<f64>| -> Vec<f64> { rows.iter().map(|&row| values[row]).collect() };
        let maybe = |values: &Option<Vec<f64>>| values.as_ref().map(pick);
        // A missing value holds the one before it, also if that one is not drawn.
        let held = |values: &Option<Vec<f64>>| values.as_ref().map(|it| pick(&filled(it)));
        let series: Vec<usize> = rows.iter().map(|&row| self.series[row]).collect();
        Self {
            rows: rows.len(),
            file: rows.iter().map(|&row| self.file[row]).collect(),
            restart: (0..rows.len()).map(|n| n == 0 || series[n] != series[n - 1]).collect(),
            series,
            time_s: maybe(&self.time_s),
            run: maybe(&self.run),
            temperatures: self
                .temperatures
                .iter()
                .map(|(name, values)| (name.clone(), pick(&filled(values))))
                .collect(),
            others: self.others.iter().map(|(name, values)| (name.clone(), pick(values))).collect(),
            spindle_rpm: held(&self.spindle_rpm),
            load_n: held(&self.load_n),
            position_mm: self.position_mm.each_ref().map(maybe),
            direction: self.direction.each_ref().map(maybe),
            untaken: self
                .untaken
                .iter()
                .map(|(name, values)| (name.clone(), pick(values)))
                .collect(),
            measured: pick(&self.measured),
            elongation: pick(&self.elongation),
            along: pick(&self.along),
            axis: pick(&self.axis),
            thermal: pick(&self.thermal),
            used: rows.iter().map(|&row| self.used[row]).collect(),
            machine: self.machine.clone(),
            quantity: self.quantity,
            files: self.files,
            has_elongation: self.has_elongation,
            references_c: self.references_c.clone(),
            start_s: self.start_s,
            whole: Some(Whole { data: self.clone(), rows, lagged: Arc::default() }),
        }
    }

    /// The table that these rows were drawn from, or this one.
    pub(crate) fn whole(&self) -> &Self {
        self.whole.as_ref().map_or(self, |whole| &whole.data)
    }

    /// The position of the quantity's own axis.
    pub(crate) fn own_position(&self) -> Option<&[f64]> {
        self.quantity.axis().and_then(|axis| self.position_mm[axis.index()].as_deref())
    }

    /// The direction of the quantity's own axis.
    pub(crate) fn own_direction(&self) -> Option<&[f64]> {
        self.quantity.axis().and_then(|axis| self.direction[axis.index()].as_deref())
    }

    pub(crate) fn temperature(&self, name: &str) -> Option<&[f64]> {
        let found = self.temperatures.iter().find(|(there, _)| there == name);
        found.map(|(_, values)| values.as_slice())
    }

    /// The first value of a column that is there.
    pub(crate) fn first_of(values: &[f64]) -> f64 {
        values.iter().copied().find(|value| !value.is_nan()).unwrap_or(0.0)
    }

    /// The temperature that a term on `column` is counted from.
    pub(crate) fn reference_c(&self, column: &str) -> f64 {
        let found = self.references_c.iter().find(|(name, _)| name == column);
        found.map_or(0.0, |&(_, reference_c)| reference_c)
    }

    /// Counts from where `training` does.
    pub(crate) fn refer_to(&mut self, training: &Self) {
        self.references_c.clone_from(&training.references_c);
        self.start_s = training.start_s;
    }
}

fn is_known(name: &str) -> bool {
    const KNOWN: [&str; 13] = [
        "time_s",
        "run",
        "sensor_counts",
        "spindle_rpm",
        "load_n",
        "x_mm",
        "y_mm",
        "z_mm",
        "a_deg",
        "b_deg",
        "c_deg",
        "dir_x",
        "dir_y",
    ];
    KNOWN.contains(&name)
        || name == "dir_z"
        || ["measured_", "predicted_", "bridge_"].iter().any(|start| name.starts_with(start))
}

/// Rows put together for the search: `size` neighbours of one series are one group, so that its cost
/// does not depend on how often a slow thing was written down. What is linear stays exact: means of
/// what was measured are compared with means of what is predicted.
#[derive(Clone, Debug)]
pub(crate) struct Groups {
    /// The group of each row; none for rows that do not count.
    of_row: Vec<Option<u32>>,
    count: Vec<f64>,
    /// Rows in a full group.
    pub size: usize,
    /// Mean row number of each group.
    pub steps: Steps,
    /// The series and the file of each group.
    pub series: Vec<usize>,
    pub file: Vec<usize>,
    /// The first row of each group.
    pub first_row: Vec<usize>,
}

impl Groups {
    /// Groups of `size` rows.
    pub(crate) fn new(data: &Data, used: &[bool], size: usize) -> Self {
        let mut it = Self {
            of_row: vec![None; data.rows],
            count: Vec::new(),
            size,
            steps: Steps(Vec::new()),
            series: Vec::new(),
            file: Vec::new(),
            first_row: Vec::new(),
        };
        let mut clock: Vec<f64> = Vec::new();
        let mut open: Option<(usize, usize)> = None;
        for row in 0..data.rows {
            if !used[row] {
                continue;
            }
            let begins = match open {
                Some((series, in_group)) => series != data.series[row] || in_group >= size,
                None => true,
            };
            if begins {
                it.count.push(0.0);
                it.series.push(data.series[row]);
                it.file.push(data.file[row]);
                it.first_row.push(row);
                clock.push(0.0);
                open = Some((data.series[row], 0));
            }
            let group = it.count.len() - 1;
            it.of_row[row] = Some(group as u32);
            it.count[group] += 1.0;
            let time = data.time_s.as_ref().map_or(row as f64, |times| times[row]);
            clock[group] += if time.is_nan() { row as f64 } else { time };
            if let Some((_, in_group)) = &mut open {
                *in_group += 1;
            }
        }
        for (clock, count) in clock.iter_mut().zip(&it.count) {
            *clock /= count;
        }
        let mut gaps: Vec<f64> = (1..clock.len())
            .filter(|&group| it.series[group] == it.series[group - 1])
            .map(|group| clock[group] - clock[group - 1])
            .filter(|&gap| gap > 0.0)
            .collect();
        gaps.sort_by(f64::total_cmp);
        let step = gaps.get(gaps.len() / 2).copied().unwrap_or(1.0);
        it.steps.0 = (0..clock.len())
            .map(|group| {
                if group == 0 || it.series[group] != it.series[group - 1] {
                    f64::INFINITY
                } else {
                    // Rows at one time are still one after the other; and what a pause does to the
                    // noise is not known: it is not believed to end it.
                    ((clock[group] - clock[group - 1]) / step).clamp(0.1, 2.0)
                }
            })
            .collect();
        it
    }

    pub(crate) fn len(&self) -> usize {
        self.count.len()
    }

    /// Rows in all groups.
    pub(crate) fn rows(&self) -> f64 {
        self.count.iter().sum()
    }

    /// The mean of `values` in each group.
    pub(crate) fn means(&self, values: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; self.count.len()];
        for (value, group) in values.iter().zip(&self.of_row) {
            if let Some(group) = group {
                sums[*group as usize] += value;
            }
        }
        sums.iter_mut().zip(&self.count).for_each(|(sum, count)| *sum /= count);
        sums
    }
}
