//! The columns of thermometers and sensors in a run that is not made yet: each input column as a lag of the
//! spindle's heat, the square of its speed and the load, fitted to the runs that are there.
//!
//! ```text
//! y = c₀ + c₁·lag_τ(g) + c₂·(n/n_max)² + c₃·F        g = (n/n_max)^p; c₂ and c₃ but for thermometers, which are slow
//! ```
//!
//! τ and p are the best of a grid, and what the runs do not determine is held near nothing. It is a guess of an input
//! and nothing else depends on it: the run that is made has inputs of its own.

use std::{fmt::Write as _, path::Path};

use trueup_machine::{RunFile, machine_file::is_temperature_column};
use trueup_numerics::{least_squares::GivensQr, repeats::DETERMINACY_THRESHOLD, robust::median};

use super::{ReadingMethod, SpindleSegment};
use crate::data::DataTable;

/// Time constants of spindles and columns of machine tools, in s: a minute to three hours, a factor of 1.4 apart.
const CANDIDATE_LAGS_S: [f64; 16] = [
    60.0, 85.0, 120.0, 170.0, 240.0, 340.0, 480.0, 680.0, 960.0, 1350.0, 1900.0, 2700.0, 3800.0,
    5400.0, 7600.0, 10_800.0,
];
/// Heat grows with the speed by such a power: friction of a load (1) to that of a liquid (2).
const CANDIDATE_SPEED_EXPONENTS: [f64; 3] = [1.0, 1.5, 2.0];
/// Rows that are looked at: enough for four constants.
const MAX_FITTED_ROWS: usize = 600;

/// The behaviour of the spindle and of the input columns in the runs.
pub(super) struct SpindleForecaster {
    /// In r/min.
    pub fastest_rpm: f64,
    /// The largest load in N, where the runs have one.
    pub most_load_n: Option<f64>,
    /// From reading to reading in s.
    pub every_s: f64,
    columns: Vec<(String, ColumnResponse)>,
}

/// A column's answer to speed and load.
struct ColumnResponse {
    power: f64,
    lag_s: f64,
    /// c₀ … c₃.
    constants: Vec<f64>,
}

/// The inputs of a row.
#[derive(Clone, Copy)]
struct InputRow {
    /// Since the row before, in s; 0 where a run begins.
    step_s: f64,
    /// n/n_max.
    speed: f64,
    load_n: f64,
}

/// Columns that are measured, counted or written by a bridge: no inputs.
const NON_INPUT_COLUMN_PREFIXES: [&str; 10] = [
    "measured_",
    "predicted_",
    "bridge_",
    "offset_",
    "quality",
    "calibration_crc",
    "time_s",
    "run",
    "gauge_",
    "dir_",
];

/// Returns whether a column is what a model goes by.
pub(super) fn is_input_column(name: &str) -> bool {
    !NON_INPUT_COLUMN_PREFIXES.iter().any(|start| name.starts_with(start))
}

impl SpindleForecaster {
    /// # Errors
    /// The runs lack what a run of a spindle is described by.
    pub(super) fn from_runs(runs: &[RunFile], gauge: ReadingMethod) -> Result<Self, &'static str> {
        let mut rows: Vec<InputRow> = Vec::new();
        let (mut fastest_rpm, mut most_load_n) = (0.0_f64, 0.0_f64);
        let is_there = |name| runs.iter().all(|run| run.column(name).is_some());
        if !is_there("time_s") || !is_there("spindle_rpm") {
            return Err("the runs have no time_s or no spindle_rpm");
        }
        for run in runs {
            let column = |name: &str| run.column(name).unwrap_or_default();
            let (times, speeds) = (column("time_s"), column("spindle_rpm"));
            let loads = run.column("load_n");
            let mut last_s = None;
            for row in 0..run.row_count() {
                let load_n = loads.map_or(0.0, |loads| loads[row]);
                let step_s = last_s.map_or(0.0, |last_s| f64::max(times[row] - last_s, 0.0));
                let is_whole =
                    [times[row], speeds[row], load_n].iter().all(|value| value.is_finite());
                rows.push(if is_whole {
                    last_s = Some(times[row]);
                    fastest_rpm = fastest_rpm.max(speeds[row]);
                    most_load_n = most_load_n.max(load_n);
                    InputRow { step_s, speed: speeds[row], load_n }
                } else {
                    InputRow { step_s: 0.0, speed: f64::NAN, load_n: 0.0 }
                });
            }
        }
        if fastest_rpm <= 0.0 {
            return Err("the spindle stands in all runs");
        }
        rows.iter_mut().for_each(|row| row.speed /= fastest_rpm);
        let named = runs.iter().flat_map(|run| run.columns()).map(|column| column.name.clone());
        let mut names: Vec<String> = Vec::new();
        for name in named {
            let is_own = name == "spindle_rpm" || name == "load_n";
            if is_input_column(&name) && !is_own && !names.contains(&name) {
                names.push(name);
            }
        }
        let columns = names.into_iter().filter_map(|name| {
            let values: Vec<f64> = runs
                .iter()
                .flat_map(|run| match run.column(&name) {
                    Some(values) => values.to_vec(),
                    None => vec![f64::NAN; run.row_count()],
                })
                .collect();
            let response = ColumnResponse::fit(&rows, &values, is_temperature_column(&name))?;
            Some((name, response))
        });
        let columns = columns.collect();
        let most_load_n = (most_load_n > 0.0).then_some(most_load_n);
        let mut steps: Vec<f64> =
            rows.iter().map(|row| row.step_s).filter(|step_s| *step_s > 0.0).collect();
        let every_s = if steps.is_empty() { 0.0 } else { median(&mut steps) };
        Ok(Self {
            fastest_rpm,
            most_load_n,
            every_s: every_s.max(gauge.min_reading_interval_s()),
            columns,
        })
    }

    /// Returns the columns that a run is to have next to time, speed and growth.
    pub(super) fn input_columns(&self) -> Vec<String> {
        let load = self.most_load_n.map(|_| "load_n".to_string());
        load.into_iter().chain(self.columns.iter().map(|(name, _)| name.clone())).collect()
    }

    /// Returns a run as it will be recorded, counted from where `training` is; none where the machine file needs a
    /// column that cannot be predicted.
    pub(super) fn forecast_table(
        &self,
        stretches: &[SpindleSegment],
        training: &DataTable,
    ) -> Option<DataTable> {
        let mut rows = vec![InputRow { step_s: 0.0, speed: 0.0, load_n: 0.0 }];
        for stretch in stretches {
            let count = (60.0 * stretch.minutes / self.every_s).round() as usize;
            let row = InputRow {
                step_s: self.every_s,
                speed: stretch.rpm / self.fastest_rpm,
                load_n: stretch.load_n,
            };
            rows.extend(vec![row; count]);
        }
        let mut text = String::from("time_s,spindle_rpm,measured_elongation_um");
        if self.most_load_n.is_some() {
            text += ",load_n";
        }
        for (name, _) in &self.columns {
            let _ = write!(text, ",{name}");
        }
        let columns: Vec<Vec<f64>> =
            self.columns.iter().map(|(_, response)| response.predict(&rows)).collect();
        for (number, row) in rows.iter().enumerate() {
            let _ = write!(
                text,
                "\n{},{},0",
                number as f64 * self.every_s,
                row.speed * self.fastest_rpm
            );
            if self.most_load_n.is_some() {
                let _ = write!(text, ",{}", row.load_n);
            }
            for column in &columns {
                let _ = write!(text, ",{:.6}", column[number]);
            }
        }
        text.push('\n');
        let run = RunFile::from_reader(text.as_bytes(), Path::new("next.csv")).ok()?;
        let mut table =
            DataTable::new(&training.setting.machine, &[run], training.setting.quantity).ok()?;
        table.copy_origin_from(training);
        Some(table)
    }
}

impl ColumnResponse {
    /// None where nothing was read.
    fn fit(rows: &[InputRow], values: &[f64], is_slow: bool) -> Option<Self> {
        let there: Vec<usize> = (0..rows.len())
            .filter(|&row| values[row].is_finite() && rows[row].speed.is_finite())
            .collect();
        let step = there.len().div_ceil(MAX_FITTED_ROWS).max(1);
        let there: Vec<usize> = there.into_iter().step_by(step).collect();
        // A constant that nothing determines is pulled to 0.
        let pull = (DETERMINACY_THRESHOLD * there.len() as f64).sqrt();
        let mut best: Option<(f64, Self)> = None;
        for power in CANDIDATE_SPEED_EXPONENTS {
            for lag_s in CANDIDATE_LAGS_S {
                let heat = lagged_heat(rows, power, lag_s);
                let mut triangle = GivensQr::new(4);
                for &row in &there {
                    triangle.add_row(&regressors(&rows[row], heat[row], is_slow), values[row]);
                }
                for n in 2..4 {
                    let mut x = [0.0; 4];
                    x[n] = pull;
                    triangle.add_row(&x, 0.0);
                }
                let Ok(solution) = triangle.solve() else { continue };
                let off = |row: &usize| {
                    let x = regressors(&rows[*row], heat[*row], is_slow);
                    (values[*row] - dot(&x, &solution.coefficients)).powi(2)
                };
                let left: f64 = there.iter().map(off).sum();
                if best.as_ref().is_none_or(|(least, _)| left < *least) {
                    let constants = solution.coefficients.clone();
                    best = Some((left, Self { power, lag_s, constants }));
                }
            }
        }
        best.map(|(_, response)| response)
    }

    fn predict(&self, rows: &[InputRow]) -> Vec<f64> {
        let heat = lagged_heat(rows, self.power, self.lag_s);
        let each = rows.iter().zip(heat);
        each.map(|(row, heat)| dot(&regressors(row, heat, false), &self.constants)).collect()
    }
}

/// Loads count in kN, so that all are of one size.
fn regressors(row: &InputRow, heat: f64, is_slow: bool) -> [f64; 4] {
    let quick = if is_slow { 0.0 } else { 1.0 };
    [1.0, heat, quick * row.speed * row.speed, quick * 1e-3 * row.load_n]
}

fn dot(x: &[f64; 4], constants: &[f64]) -> f64 {
    x.iter().zip(constants).map(|(x, c)| x * c).sum()
}

/// Returns the lag of what heats, from cold at the start of each run.
fn lagged_heat(rows: &[InputRow], power: f64, lag_s: f64) -> Vec<f64> {
    let mut state = 0.0;
    rows.iter()
        .map(|row| {
            if row.step_s == 0.0 {
                state = 0.0;
            } else if row.speed.is_finite() {
                state += (row.speed.powf(power) - state) * (1.0 - (-row.step_s / lag_s).exp());
            }
            state
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a thermometer that follows the speed in 20 minutes, read each minute for an hour at `rpm`, then half an
    /// hour still.
    fn run(rpm: f64) -> (RunFile, f64) {
        let mut text = String::from("time_s,spindle_rpm,temp_front_c,measured_elongation_um\n");
        let mut rise_c = 0.0;
        for minute in 0..90 {
            let speed = if (1..60).contains(&minute) { rpm } else { 0.0 };
            if minute > 0 {
                let to: f64 = 20.0 * (speed / 12_000.0);
                rise_c = to + (rise_c - to) * (-60.0_f64 / 1200.0).exp();
            }
            let _ = writeln!(text, "{},{speed},{},0", 60 * minute, 21.0 + rise_c);
        }
        (RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run"), rise_c)
    }

    #[test]
    fn a_thermometer_is_foreseen_at_a_speed_that_was_not_run() {
        let foresight =
            SpindleForecaster::from_runs(&[run(12_000.0).0, run(8000.0).0], ReadingMethod::Hand)
                .expect("it is a run");
        assert_eq!((foresight.fastest_rpm, foresight.every_s), (12_000.0, 60.0));
        let (name, response) = &foresight.columns[0];
        let cold = InputRow { step_s: 0.0, speed: 0.0, load_n: 0.0 };
        let half = InputRow { step_s: 60.0, speed: 0.5, load_n: 0.0 };
        let rows = [vec![cold], vec![half; 20]].concat();
        let last = response.predict(&rows)[20];
        // A time constant at half the speed: 21 + 10·(1 − 1/e), as near as the grid of lags has it.
        assert!(name == "temp_front_c" && (last - 27.32).abs() < 0.6, "{last}");
    }
}
