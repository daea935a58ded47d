//! Act one: a measured run. The errors of the machine file, the file extended by them, and the gain of that,
//! in offsets that a CNC reads from the board, on readings that the extension has not seen.
//!
//! A part of the readings is taken out, the rest is diagnosed, the extended file compiled and played, and
//! the board's offsets are held against what was taken out; so for each part in turn.

use std::{borrow::Cow, path::Path};

use anyhow::{Context as _, Result};
use serde::Serialize;
use trueup_campaigns::run_file::without_readings;
use trueup_diagnose::{Diagnosis, DiagnosisOptions, diagnose_with_options};
use trueup_machine::{
    Machine, MachineFile, RunFile,
    applied_offsets::{UncompensatedRun, require_unit_factor},
    compile,
    machine_file::Quantity,
    predict::RunPredictor,
};
use trueup_numerics::line::{ErrorStatistics, fit_line};

use crate::{
    ProgressCallback, bench_machine,
    playback::{PlaybackParameters, PlaybackRecord, check_offsets, play},
    stepped_board::BoardSource,
};

/// Up to this many readings without a clock each is held out in turn; of more, whole parts.
const MAX_LEAVE_ONE_OUT_READINGS: usize = 30;
/// Parts that are held out in turn: the rule of a diagnosis for what may be claimed (`docs/reference.md`).
const CROSS_VALIDATION_FOLDS: usize = 6;
/// A longer run is played faster, its time constants shortened: in s of the board.
const MAX_PLAYBACK_S: f64 = 60.0;

/// Input of act one.
#[derive(Clone, Debug)]
pub struct MeasuredRunInput<'a> {
    /// The machine file, and where it came from.
    pub source: &'a str,
    /// For errors.
    pub path: &'a Path,
    /// The measured run.
    pub run: &'a RunFile,
    /// Which quantity, where the run has several.
    pub quantity: Option<Quantity>,
}

/// One reading.
#[derive(Clone, Debug, Serialize)]
pub struct ReadingResult {
    /// Prediction of the machine file, in µm.
    pub sensor_um: f64,
    /// Value that the board sent with it, in µm.
    pub bridge_um: f64,
    /// Measured value, in µm.
    pub dial_um: f64,
    /// Value sent by a board whose machine file was extended from the other readings, in µm.
    pub calibrated_um: f64,
}

impl ReadingResult {
    /// Returns the error that the bridge leaves: measured minus sent, in µm.
    pub(crate) fn residual_um(&self) -> f64 {
        self.dial_um - self.bridge_um
    }

    /// Returns the same of the extended machine file.
    pub(crate) fn extended_residual_um(&self) -> f64 {
        self.dial_um - self.calibrated_um
    }
}

/// Size of what is left.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ResidualStatistics {
    /// Root mean square, in µm.
    pub rms_um: f64,
    /// Largest absolute one, in µm.
    pub max_um: f64,
}

/// Result of act one.
pub struct MeasuredRunResult {
    /// Diagnosis of all readings.
    pub diagnosis: Diagnosis,
    /// The machine file with what was found.
    pub extended: String,
    /// The machine's name.
    pub machine: String,
    /// Each reading.
    pub rows: Vec<ReadingResult>,
    /// For the horizontal axis of pictures: its name, and the value of each row.
    pub over: (String, Vec<f64>),
    /// With the current machine file.
    pub before: ResidualStatistics,
    /// With what was found from the other readings.
    pub after: ResidualStatistics,
    /// A line of measured over sent, where there is one: gain, and what is measured at 0 in µm.
    pub line: Option<[f64; 2]>,
    /// The counts that the machine file takes for full scale over those of an S7.
    pub s7_full_scale_ratio: Option<f64>,
    /// Notes on how it was played, a sentence each.
    pub notes: Vec<String>,
    /// Frames with offsets that were received, and those that were damaged or lost.
    pub frames: [u32; 2],
    /// Board time, in s.
    pub board_s: f64,
}

/// Runs act one.
///
/// # Errors
/// The data are not comparable with the machine file, or a board ends.
pub fn run_measured_run_demo(
    boards: &BoardSource,
    asked: &MeasuredRunInput<'_>,
    progress: &mut ProgressCallback<'_>,
) -> Result<MeasuredRunResult> {
    let (source, mut notes) = bench_machine::add_missing_inputs(asked.source, asked.run)?;
    let machine = MachineFile::parse(&source, asked.path)?;
    let (run, run_notes) =
        UncompensatedRun::from_run(Cow::Borrowed(asked.run), Some(&machine), asked.quantity)?;
    notes.extend(run_notes);
    for quantity in Quantity::ALL {
        require_unit_factor(std::slice::from_ref(&run), Some(&machine), quantity)?;
    }
    let run: &RunFile = &run;
    let options = DiagnosisOptions { quantity: asked.quantity, ..DiagnosisOptions::default() };
    let named = |run: &RunFile, progress: &mut ProgressCallback<'_>| {
        diagnose_with_options(&machine, std::slice::from_ref(run), &[], options, progress)
    };
    let diagnosis = named(run, &mut |what, share| progress(what, 0.2 * share))?;
    let extended = diagnosis.render_extended_toml(&source, asked.path)?;
    let quantity = Quantity::ALL
        .into_iter()
        .find(|quantity| quantity.name() == diagnosis.report.quantity)
        .context("a quantity of the run")?;
    let column = format!("measured_{}_um", quantity.name());
    let measured = run.require_column(&column)?;

    let faster = run.column("time_s").map(playback_speedup);
    if let Some(faster) = faster.filter(|faster| *faster > 1.0) {
        notes.push(format!(
            "The run is played {faster:.0} times as fast as it was measured; the time constants in the \
             calibration are as much shorter."
        ));
    }
    let stage = PlaybackContext { boards, run, quantity, faster };
    progress("with the machine file as it is", 0.2);
    let all = |_: usize| true;
    let before = stage.play_run(&source, &all, &mut |share| progress("", 0.2 + 0.2 * share))?;
    let (mut frames, mut board_s) = ([before.frames, before.errors], before.board_s);
    let sent = stage.estimated_error_um(&source, &before)?;

    let mut calibrated = sent.clone();
    if extended != source {
        let parts = assign_folds(run, measured);
        let count = parts.iter().max().map_or(1, |last| last + 1);
        for part in 0..count {
            let is_hidden = |row: usize| parts[row] == part;
            let at = |share: f64| 0.4 + 0.6 * (part as f64 + share) / count as f64;
            progress("each part from the others", at(0.0));
            let rest = without_readings(run, &column, is_hidden)?;
            let of_rest =
                named(&rest, &mut |_, _| {})?.render_extended_toml(&source, asked.path)?;
            if of_rest == source {
                continue;
            }
            let last = (0..run.row_count()).rfind(|row| is_hidden(*row)).unwrap_or(0);
            // What has a memory needs all that was before.
            let is_selected =
                |row: usize| if faster.is_some() { row <= last } else { is_hidden(row) };
            let played =
                stage.play_run(&of_rest, &is_selected, &mut |share| progress("", at(share)))?;
            let corrected_um = stage.estimated_error_um(&of_rest, &played)?;
            (0..run.row_count())
                .filter(|row| is_hidden(*row))
                .for_each(|row| calibrated[row] = corrected_um[row]);
            frames[0] += played.frames;
            frames[1] += played.errors;
            board_s += played.board_s;
        }
    }
    let predictor = RunPredictor::new(&machine, run)?;
    let of_file: Vec<f64> =
        predictor.predictions().map(|row| row.model.to_array()[quantity as usize]).collect();
    let rows: Vec<ReadingResult> = (0..run.row_count())
        .filter(|row| measured[*row].is_finite() && sent[*row].is_finite())
        .map(|row| ReadingResult {
            sensor_um: of_file[row],
            bridge_um: sent[row],
            dial_um: measured[row],
            calibrated_um: calibrated[row],
        })
        .collect();
    let column_of = |of: fn(&ReadingResult) -> f64| rows.iter().map(of).collect::<Vec<f64>>();
    let line = fit_line(&column_of(|row| row.bridge_um), &column_of(|row| row.dial_um));
    Ok(MeasuredRunResult {
        over: choose_abscissa(run, measured, &before),
        before: residual_statistics(&rows, quantity, ReadingResult::residual_um)?,
        after: residual_statistics(&rows, quantity, ReadingResult::extended_residual_um)?,
        line: line.ok().map(|fit| [fit.gain, fit.offset]),
        s7_full_scale_ratio: s7_full_scale_ratio(&machine),
        machine: machine.name.clone(),
        diagnosis,
        extended,
        rows,
        notes,
        frames,
        board_s,
    })
}

/// Returns the counts that the machine file takes for full scale over those of an S7.
fn s7_full_scale_ratio(machine: &Machine) -> Option<f64> {
    let sensor = machine.inputs.as_ref()?.sensor.as_ref()?;
    Some(sensor.counts_full_scale / 27_648.0)
}

/// Returns how much faster than measured a run is played.
fn playback_speedup(times: &[f64]) -> f64 {
    let whole_s = times.last().unwrap_or(&0.0) - times.first().unwrap_or(&0.0);
    if whole_s > MAX_PLAYBACK_S { (whole_s / MAX_PLAYBACK_S).ceil() } else { 1.0 }
}

/// Returns which part each row belongs to, from 0: whole stretches where there is a clock or are many, runs where
/// there are several, single readings else. Rows without a reading belong to the part of those before.
fn assign_folds(run: &RunFile, measured: &[f64]) -> Vec<usize> {
    let rows = run.row_count();
    let known = measured.iter().filter(|um| um.is_finite()).count();
    if run.column("time_s").is_none() && known <= MAX_LEAVE_ONE_OUT_READINGS {
        return (0..rows).collect();
    }
    let numbers = run.column("run").map(|numbers| {
        let mut kinds: Vec<f64> =
            numbers.iter().copied().filter(|number| number.is_finite()).collect();
        kinds.sort_by(f64::total_cmp);
        kinds.dedup();
        (numbers, kinds)
    });
    if let Some((numbers, kinds)) = numbers.filter(|(_, kinds)| kinds.len() >= 3) {
        let parts = CROSS_VALIDATION_FOLDS.min(kinds.len());
        let place = |number: &f64| kinds.iter().position(|kind| kind == number).unwrap_or(0);
        return numbers.iter().map(|number| place(number) * parts / kinds.len()).collect();
    }
    (0..rows).map(|row| row * CROSS_VALIDATION_FOLDS / rows).collect()
}

/// Where the run is played.
struct PlaybackContext<'a> {
    boards: &'a BoardSource,
    run: &'a RunFile,
    quantity: Quantity,
    /// Against the run's clock; none where it has none.
    faster: Option<f64>,
}

impl PlaybackContext<'_> {
    fn play_run(
        &self,
        source: &str,
        is_selected: &dyn Fn(usize) -> bool,
        progress: &mut dyn FnMut(f64),
    ) -> Result<PlaybackRecord> {
        let machine = bench_machine::build_bench_machine(source, self.faster.unwrap_or(1.0))?;
        let pace = match self.faster {
            Some(faster) => PlaybackParameters::from_timestamps(self.run, faster)?,
            None => PlaybackParameters::with_static_hold(self.run.row_count()),
        };
        let played = self.boards.run(&compile(&machine)?, |bridge| {
            play(bridge, &machine, self.run, &pace, is_selected, progress)
        })?;
        check_offsets(&played, is_selected)?;
        Ok(played)
    }

    fn estimated_error_um(&self, source: &str, played: &PlaybackRecord) -> Result<Vec<f64>> {
        let machine = bench_machine::build_bench_machine(source, 1.0)?;
        Ok(played.estimated_error_um(self.quantity, &machine))
    }
}

/// Returns what the offsets leave; the zero of an axis's measurement is arbitrary and does not count.
fn residual_statistics(
    rows: &[ReadingResult],
    quantity: Quantity,
    residual_um: impl Fn(&ReadingResult) -> f64,
) -> Result<ResidualStatistics> {
    let mut left: Vec<f64> = rows.iter().map(residual_um).collect();
    if quantity.axis().is_some() {
        let mean = left.iter().sum::<f64>() / left.len().max(1) as f64;
        left.iter_mut().for_each(|um| *um -= mean);
    }
    let summary =
        ErrorStatistics::from_residuals(&left).context("no row is both measured and played")?;
    Ok(ResidualStatistics { rms_um: summary.rms, max_um: summary.max_abs })
}

/// Returns what the rows are drawn over: time, the position that changes most, or what the file says.
fn choose_abscissa(run: &RunFile, measured: &[f64], played: &PlaybackRecord) -> (String, Vec<f64>) {
    let is_drawn = |row: &usize| measured[*row].is_finite() && played.offset_um[*row].is_some();
    let of =
        |values: &[f64]| (0..run.row_count()).filter(is_drawn).map(|row| values[row]).collect();
    let spread = |values: &[f64]| {
        let known = values.iter().copied().filter(|value| value.is_finite());
        let (low, high) = known.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        (high - low).max(0.0)
    };
    if let Some(times) = run.column("time_s") {
        let first = times.first().copied().unwrap_or(0.0);
        let (unit, seconds) = trueup_page::choose_time_unit(spread(times));
        let since: Vec<f64> = times.iter().map(|time| (time - first) / seconds).collect();
        return (format!("time, {unit}"), of(&since));
    }
    let axes = ["x_mm", "y_mm", "z_mm"];
    let axis = axes
        .into_iter()
        .filter_map(|name| run.column(name).map(|values| (name, values)))
        .max_by(|a, b| spread(a.1).total_cmp(&spread(b.1)))
        .filter(|(_, values)| spread(values) > 0.0);
    match axis {
        Some((name, values)) => (format!("{}, mm", name[..1].to_uppercase()), of(values)),
        None => ("measured, µm".into(), of(measured)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_that_is_left_is_measured_minus_sent_in_table_chart_and_figures() -> Result<()> {
        let row =
            ReadingResult { sensor_um: 8.0, bridge_um: 8.0, dial_um: 10.0, calibrated_um: 13.0 };
        assert_eq!((row.residual_um(), row.extended_residual_um()), (2.0, -3.0));
        let after =
            residual_statistics(&[row], Quantity::Elongation, ReadingResult::extended_residual_um)?;
        assert_eq!(after.max_um, 3.0);
        Ok(())
    }
}
