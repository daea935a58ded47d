//! The runs of an axis that are thought of, and what they will read: targets there and back, cold, after the axis was
//! run warm, or both.
//!
//! All that is not moved stays as it was in the runs. Moving warms the axis's own thermometer: by how much at the feed
//! at which an axis is run warm the runs say if it has changed in them, else paper 2's twenty minutes and 5 K are
//! taken; at a slower pace by as much less. It is a guess of an input and nothing else depends on it: the run that is
//! made has inputs of its own.

use std::{fmt::Write as _, path::Path};

use serde::Serialize;
use trueup_machine::{
    Machine, RunFile,
    machine_file::{LinearAxis, is_temperature_column},
};
use trueup_numerics::robust::median;

use super::{ReadingMethod, spindle_forecast::is_input_column};
use crate::data::DataTable;

/// How many targets; the ends are among them: from these alone to more than ISO 230-2 requires of a metre.
const CANDIDATE_TARGET_COUNTS: [usize; 5] = [2, 3, 5, 9, 17];
/// How often there and back.
const CANDIDATE_REPEAT_COUNTS: [u32; 5] = [1, 2, 3, 5, 7];
/// For how long the axis is run warm, in minutes.
const WARM_UP_DURATIONS_MIN: [f64; 7] = [1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 40.0];
/// How fast: as `trueup program axis-heat` does.
const WARM_UP_FEED_MM_PER_MIN: f64 = 10_000.0;
/// The feed of a measurement where the runs do not say it: as `trueup program`.
const DEFAULT_FEED_MM_PER_MIN: f64 = 1000.0;
/// This much of the way lies beyond the targets, and at most this many mm: there play is taken up.
const OVERTRAVEL_FRACTION: f64 = 0.05;
const MAX_OVERTRAVEL_MM: f64 = 50.0;
/// The warming of an axis, in K, and its time constant, in s, where the runs do not show it: a screw (paper 2).
const DEFAULT_TEMPERATURE_RISE_K: f64 = 5.0;
const DEFAULT_WARMING_TIME_CONSTANT_S: f64 = 1200.0;
/// A thermometer that has changed by less does not show it, in K.
const MIN_TEMPERATURE_CHANGE_K: f64 = 1.0;
/// The targets are moved on by up to this share of their distance: no two stand on one phase of the screw.
const MAX_TARGET_SHIFT_RATIO: f64 = 0.25;
/// The golden ratio less 1.
const INVERSE_GOLDEN_RATIO: f64 = 0.618_033_988_749_895;

/// A measurement of an axis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AxisRun {
    /// Which one: 0, 1, 2 are X, Y, Z.
    #[serde(skip)]
    pub axis: usize,
    /// Its name.
    pub name: &'static str,
    /// Where it is read, rising, in mm.
    pub targets_mm: Vec<f64>,
    /// How far it goes beyond the first and the last, in mm.
    pub over_mm: f64,
    /// How often there and back, at each feed.
    pub times: u32,
    /// One after the other, in mm/min.
    pub feeds_mm_per_min: Vec<f64>,
    /// How long it stands for a reading, in s.
    pub dwell_s: f64,
    /// For how long it is run to and fro, in minutes; 0: not at all.
    pub heat_min: f64,
    /// How fast, in mm/min.
    pub heat_feed_mm_per_min: f64,
    /// Measured before it is run warm, too.
    pub cold: bool,
    /// Measured when it was run warm.
    pub warm: bool,
}

impl AxisRun {
    /// Returns how long it lasts, in minutes, without the ways of acceleration.
    #[must_use]
    pub(crate) fn duration_min(&self) -> f64 {
        let [low, high] = self.end_positions_mm();
        let ways = 2.0 * f64::from(self.times) * (high - low + 2.0 * self.over_mm);
        let moved: f64 = self.feeds_mm_per_min.iter().map(|feed| ways / feed).sum();
        let readings =
            2 * self.times as usize * self.targets_mm.len() * self.feeds_mm_per_min.len();
        let once = moved + readings as f64 * self.dwell_s / 60.0;
        f64::from(u8::from(self.cold) + u8::from(self.warm)) * once + self.heat_min
    }

    /// In a machinist's words.
    #[must_use]
    pub fn sentence(&self) -> String {
        let [low, high] = self.end_positions_mm();
        let feeds: Vec<String> =
            self.feeds_mm_per_min.iter().map(|feed| format!("{feed:.0}")).collect();
        let measure = format!(
            "go {} there and back over {} targets from {low:.0} to {high:.0} mm at {} mm/min, and read {} at each \
             from both sides",
            match self.times {
                1 => "once".into(),
                times => format!("{times} times"),
            },
            self.targets_mm.len(),
            feeds.join(" and "),
            self.name.to_uppercase(),
        );
        let heat = format!("run it to and fro for {:.0} minutes", self.heat_min);
        match (self.cold, self.warm) {
            (true, true) => format!("from cold, {measure}. Then {heat}, and measure so again"),
            (false, true) => format!("from cold, {heat}; then {measure}"),
            _ => format!("from cold, {measure}"),
        }
    }

    fn end_positions_mm(&self) -> [f64; 2] {
        [self.targets_mm[0], self.targets_mm[self.targets_mm.len() - 1]]
    }
}

/// The behaviour of an axis and its columns in the runs.
pub(super) struct AxisForecaster {
    axis: LinearAxis,
    /// How long it stands for a reading, in s.
    dwell_s: f64,
    /// The range of the axis in the runs, in mm.
    range_mm: [f64; 2],
    feeds_mm_per_min: Vec<f64>,
    has_feed: bool,
    has_time: bool,
    /// Other columns, and where they stand.
    columns: Vec<(String, f64)>,
    /// The axis's own thermometers: by how much they warm, in K.
    warms: Vec<(String, f64)>,
}

impl AxisForecaster {
    /// # Errors
    /// The runs lack what a run of an axis is described by.
    pub(super) fn from_runs(
        runs: &[RunFile],
        machine: &Machine,
        axis: LinearAxis,
        gauge: ReadingMethod,
    ) -> Result<Self, &'static str> {
        let position = axis.column_name();
        let direction = format!("dir_{}", axis.name());
        let whole = |name: &str| -> Vec<f64> {
            let all = runs.iter().filter_map(|run| run.column(name)).flatten();
            all.copied().filter(|value| value.is_finite()).collect()
        };
        let is_there = |name: &str| runs.iter().all(|run| run.column(name).is_some());
        if !is_there(&position) || !is_there(&direction) {
            return Err(
                "the runs lack the position of the axis that is measured, or from where it came",
            );
        }
        let places = whole(&position);
        let low = places.iter().copied().fold(f64::INFINITY, f64::min);
        let high = places.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if high <= low {
            return Err("the axis stands in all runs");
        }
        let mut feeds = whole("feed_mm_per_min");
        feeds.sort_unstable_by(f64::total_cmp);
        let has_feed = is_there("feed_mm_per_min");
        let feeds_mm_per_min = match (feeds.first(), feeds.last()) {
            (Some(slow), Some(fast)) if slow < fast => vec![*slow, *fast],
            (Some(only), _) => vec![*only],
            _ => vec![DEFAULT_FEED_MM_PER_MIN],
        };
        let mut names: Vec<String> = Vec::new();
        for column in runs.iter().flat_map(|run| run.columns()) {
            let is_known = [&position, "feed_mm_per_min"].contains(&column.name.as_str());
            if !is_known && is_input_column(&column.name) && !names.contains(&column.name) {
                names.push(column.name.clone());
            }
        }
        let columns: Vec<(String, f64)> = names
            .into_iter()
            .filter_map(|name| {
                let mut values = whole(&name);
                (!values.is_empty()).then(|| (name, median(&mut values)))
            })
            .collect();
        let temperatures =
            columns.iter().map(|(name, _)| name).filter(|name| is_temperature_column(name));
        let temperatures: Vec<&String> = temperatures.collect();
        let thermal = machine.axes[axis.index()].thermal.as_ref();
        let is_own = |name: &str| match thermal {
            Some(thermal) => thermal.sensor == name,
            None => name.contains("screw") || name.contains("scale") || temperatures.len() == 1,
        };
        let warms = temperatures.iter().filter(|name| is_own(name)).map(|name| {
            let values = whole(name);
            let low = values.iter().copied().fold(f64::INFINITY, f64::min);
            let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let by = if high - low >= MIN_TEMPERATURE_CHANGE_K {
                high - low
            } else {
                DEFAULT_TEMPERATURE_RISE_K
            };
            ((*name).clone(), by)
        });
        let warms = warms.collect();
        Ok(Self {
            axis,
            dwell_s: gauge.dwell_s(),
            range_mm: [low, high],
            feeds_mm_per_min,
            has_feed,
            has_time: is_there("time_s"),
            columns,
            warms,
        })
    }

    /// Returns the columns that a run is to have next to the axis's position and what is measured.
    pub(super) fn input_columns(&self) -> Vec<String> {
        self.columns.iter().map(|(name, _)| name.clone()).collect()
    }

    /// Returns all runs that are thought of.
    pub(super) fn candidate_runs(&self) -> Vec<AxisRun> {
        let [low, high] = self.range_mm;
        let over_mm = (OVERTRAVEL_FRACTION * (high - low)).min(MAX_OVERTRAVEL_MM);
        let mut feeds = vec![self.feeds_mm_per_min.clone()];
        feeds.extend((self.feeds_mm_per_min.len() > 1).then(|| vec![self.feeds_mm_per_min[1]]));
        let cold = [(0.0, true, false)];
        let heated = WARM_UP_DURATIONS_MIN
            .into_iter()
            .flat_map(|min| [(min, false, true), (min, true, true)]);
        let heats: Vec<(f64, bool, bool)> = if self.warms.is_empty() {
            cold.into()
        } else {
            cold.into_iter().chain(heated).collect()
        };
        let mut all = Vec::new();
        for targets in CANDIDATE_TARGET_COUNTS {
            let targets_mm = uneven_targets_mm(low + over_mm, high - over_mm, targets);
            for times in CANDIDATE_REPEAT_COUNTS {
                for feeds in &feeds {
                    for (heat_min, cold, warm) in &heats {
                        all.push(AxisRun {
                            axis: self.axis.index(),
                            name: self.axis.name(),
                            targets_mm: targets_mm.clone(),
                            over_mm,
                            times,
                            feeds_mm_per_min: feeds.clone(),
                            dwell_s: self.dwell_s,
                            heat_min: *heat_min,
                            heat_feed_mm_per_min: WARM_UP_FEED_MM_PER_MIN,
                            cold: *cold,
                            warm: *warm,
                        });
                    }
                }
            }
        }
        all
    }

    /// Returns a run as it will be recorded, counted from where `training` is; none where the machine file needs a
    /// column that cannot be predicted.
    pub(super) fn forecast_table(&self, run: &AxisRun, training: &DataTable) -> Option<DataTable> {
        let name = self.axis.name();
        let mut text = format!("{name}_mm,dir_{name}");
        if self.has_time {
            text += ",time_s";
        }
        if self.has_feed {
            text += ",feed_mm_per_min";
        }
        for (name, _) in &self.columns {
            let _ = write!(text, ",{name}");
        }
        let _ = writeln!(text, ",measured_d{name}_um");
        let mut time_s = 0.0;
        let mut row = |mm: f64, way: i8, feed: f64, warmed: f64, time_s: f64| {
            let _ = write!(text, "{mm},{way}");
            if self.has_time {
                let _ = write!(text, ",{time_s:.1}");
            }
            if self.has_feed {
                let _ = write!(text, ",{feed}");
            }
            for (name, value) in &self.columns {
                let own = self.warms.iter().find(|(own, _)| own == name);
                let _ = write!(text, ",{:.4}", value + warmed * own.map_or(0.0, |(_, by)| *by));
            }
            text += ",0\n";
        };
        // The share of what it warms by; it comes near the share of the feed at which it moves on average.
        let mut warmed = 0.0;
        let mut pass = |seconds: f64, way_mm: f64, time_s: &mut f64| {
            let pace = 60.0 * way_mm / seconds / run.heat_feed_mm_per_min;
            warmed += (pace - warmed) * (1.0 - (-seconds / DEFAULT_WARMING_TIME_CONSTANT_S).exp());
            *time_s += seconds;
            warmed
        };
        for (is_done, is_warm) in [(run.cold, false), (run.warm, true)] {
            if is_warm && run.heat_min > 0.0 {
                let seconds = 60.0 * run.heat_min;
                pass(seconds, run.heat_min * run.heat_feed_mm_per_min, &mut time_s);
            }
            for feed in run.feeds_mm_per_min.iter().filter(|_| is_done) {
                for _ in 0..run.times {
                    let up = run.targets_mm.iter().map(|mm| (*mm, 1));
                    let down = run.targets_mm.iter().rev().map(|mm| (*mm, -1));
                    let way_mm =
                        (self.range_mm[1] - self.range_mm[0]) / run.targets_mm.len() as f64;
                    for (mm, way) in up.chain(down) {
                        let seconds = run.dwell_s + 60.0 * way_mm / feed;
                        let warmed = pass(seconds, way_mm, &mut time_s);
                        row(mm, way, *feed, warmed, time_s);
                    }
                }
            }
        }
        let run = RunFile::from_reader(text.as_bytes(), Path::new("next.csv")).ok()?;
        let mut table =
            DataTable::new(&training.setting.machine, &[run], training.setting.quantity).ok()?;
        table.copy_origin_from(training);
        Some(table)
    }
}

/// This many targets from `low` to `high`, both among them, those between moved on unevenly; whole micrometres.
fn uneven_targets_mm(low: f64, high: f64, count: usize) -> Vec<f64> {
    let step = (high - low) / (count - 1) as f64;
    let share = |n: usize| {
        let is_end = n == 0 || n + 1 == count;
        if is_end {
            0.0
        } else {
            MAX_TARGET_SHIFT_RATIO * (n as f64 * INVERSE_GOLDEN_RATIO).fract()
        }
    };
    let at = |n: usize| low + step * (n as f64 + share(n));
    (0..count).map(|n| (1e3 * at(n)).round() / 1e3).collect()
}

#[cfg(test)]
mod tests {
    use trueup_machine::{MachineFile, machine_file::Quantity};

    use super::*;

    #[test]
    fn an_axis_is_foreseen_between_its_ends_and_warms_by_being_moved() {
        let file = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
        let machine = MachineFile::parse(file, Path::new("m.toml")).expect("a machine file");
        let mut text = String::from("x_mm,dir_x,temp_screw_c,temp_air_c,measured_dx_um\n");
        for mm in [100.0, 600.0, 1100.0] {
            let _ = writeln!(text, "{mm},1,21.5,20.5,0");
        }
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
        let runs = [run];
        let foresight =
            AxisForecaster::from_runs(&runs, &machine, LinearAxis::X, ReadingMethod::Auto)
                .expect("an axis");
        let training = DataTable::new(&machine, &runs, Quantity::Dx).expect("comparable");
        let all = foresight.candidate_runs();
        let heated =
            |run: &&AxisRun| run.heat_min == 20.0 && !run.cold && run.targets_mm.len() == 2;
        let heated = all.iter().find(heated).expect("it is thought of");
        // Once there and back over 1000 mm at 1 m/min, four readings of 5 s, and twenty minutes.
        assert!((heated.duration_min() - (2.0 + 20.0 / 60.0 + 20.0)).abs() < 1e-9);
        assert_eq!((heated.targets_mm.clone(), heated.over_mm), (vec![150.0, 1050.0], 50.0));
        let table = foresight.forecast_table(heated, &training).expect("all is there");
        let column = |name: &str| table.temperature_c(name).expect("there")[0];
        // 5 K in a time constant of twenty minutes: 21.5 + 5·(1 − 1/e), and it cools a little on the first way.
        let warm_c = column("temp_screw_c");
        assert!((warm_c - 24.66).abs() < 0.1 && column("temp_air_c") == 20.5, "{warm_c}");
        assert!(!all.iter().any(|run| run.targets_mm[0] < 100.0 || run.duration_min() < 1.0));
    }
}
