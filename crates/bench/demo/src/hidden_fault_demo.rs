//! Act two: the hidden fault. The bridge runs a shift with the file that its user believes; its own
//! record next to a gauge goes to the diagnosis; the extended file is compiled, loaded, and the machine runs
//! another day. Whatever comes out is reported, right or wrong.
//!
//! A shift of hours is played in minutes of the board: the machine's clock runs this many times as fast as
//! the board's, and the time constants in the calibration are as much shorter. The record is in the
//! machine's time.

use std::path::Path;

use anyhow::{Context as _, Result};
use serde::Serialize;
use trueup_campaigns::{
    faulty_machine::{SeparableFaultMachine, expected_causes},
    run_file::with_columns,
};
use trueup_diagnose::{Diagnosis, DiagnosisOptions, diagnose_with_options, report::Finding};
use trueup_machine::{
    CompiledCalibration, MachineFile, RunFile, compile, machine_file::Quantity,
    predict::RunPredictor,
};
use trueup_twin::noise::rms;

use crate::{
    ProgressCallback, bench_machine,
    playback::{PlaybackParameters, PlaybackRecord, max_playback_speedup, play},
    stepped_board::{BoardSource, StartedBoard},
};

/// A shift takes so long on the board, in s: three of them are below ten minutes.
const SHIFT_DURATION_S: f64 = 180.0;
/// And so long at the most, where a board would doubt its thermometers otherwise.
const MAX_SHIFT_DURATION_S: f64 = 195.0;
/// From this quality on (hold, ramping out, fault) an offset is none.
const MIN_UNUSABLE_QUALITY: u8 = 4;

/// A fault, and the causes that name it.
#[derive(Clone, Debug, Serialize)]
pub struct FaultCauses {
    /// Its name.
    pub fault: &'static str,
    /// One or two.
    pub causes: Vec<&'static str>,
    /// RMS of what it does, over that of the noise.
    pub ratio: f64,
}

/// Result of act two, in the form of `summary.json`.
#[derive(Clone, Debug, Serialize)]
pub struct HiddenFaultOutcome {
    /// The seed that repeats it.
    pub seed: u64,
    /// The kind of machine.
    pub machine: &'static str,
    /// The hidden faults.
    pub faults: Vec<FaultCauses>,
    /// By how much the nearest rival law is worse, as a difference of BIC.
    pub gap: f64,
    /// The findings, as in `diagnosis.json`.
    pub findings: Vec<Finding>,
    /// The verdict of the diagnosis.
    pub verdict: &'static str,
    /// Each fault is named by a finding, claimed or not, and nothing false is claimed.
    pub all_right: bool,
    /// Faults that no finding names.
    pub missed: Vec<&'static str>,
    /// Claimed causes that belong to no fault.
    pub wrong: Vec<String>,
    /// True error at the tool on the second day with the believed file, RMS in µm.
    pub tool_rms_before_um: f64,
    /// The same with the extended file, loaded into the board.
    pub tool_rms_after_um: f64,
    /// 1 − after/before of these.
    pub reduction: f64,
    /// The reduction that the diagnosis has promised for what this day asks: from its temperatures, speeds
    /// and positions alone.
    pub promised_reduction: f64,
    /// How much faster the machine's clock ran than the board's.
    pub faster: f64,
    /// Board time, in s.
    pub board_s: f64,
}

/// Act two, with what its pictures need.
pub struct HiddenFaultResult {
    /// The result, as in `summary.json`.
    pub outcome: HiddenFaultOutcome,
    /// The diagnosis.
    pub diagnosis: Diagnosis,
    /// Notes on how it was played, a sentence each.
    pub notes: Vec<String>,
    /// Of the first day: time in s, what the faults really do, what was found; in µm.
    pub envelope: Vec<[f64; 3]>,
    /// Of the second day: time in s, the true error at the tool with the believed and with the extended
    /// file; in µm.
    pub second_day: Vec<[f64; 3]>,
}

/// Runs act two on the machine of `hidden`.
///
/// # Errors
/// A board ends, or the record cannot be compared.
pub fn run_hidden_fault_demo(
    boards: &BoardSource,
    hidden: &SeparableFaultMachine,
    progress: &mut ProgressCallback<'_>,
) -> Result<HiddenFaultResult> {
    let plant = &hidden.plant;
    let quantity = Quantity::ALL
        .into_iter()
        .find(|quantity| quantity.name() == plant.quantity)
        .context("a quantity")?;
    let path = Path::new("machine.toml");
    let (first, second) = (hidden.record_day(0, false)?, hidden.record_day(1, false)?);
    let (source, _) = bench_machine::add_missing_inputs(&plant.machine, &first)?;
    let mut notes = Vec::new();
    let faster = choose_playback_speedup(&first, &second)?;
    let day = BenchDay { boards, quantity, faster };

    let believed_blob = compile_for_bench(&source, faster)?;
    progress("a shift with the file that is believed", 0.0);
    let played = boards.run(&believed_blob, |bridge| {
        day.play(StartedBoard { bridge, counter: 0 }, &source, &first, &mut |share| {
            progress("", 0.2 * share)
        })
    })?;
    let record =
        day.build_record_with_gauge(&source, &first, &played, &hidden.measured_column_name())?;
    progress("looking for what is wrong", 0.2);
    let machine = MachineFile::parse(&source, path)?;
    // This CNC adds what it is given.
    let options = DiagnosisOptions { is_applied_once: true, ..DiagnosisOptions::default() };
    let runs = std::slice::from_ref(&record);
    let diagnosis = diagnose_with_options(&machine, runs, &[], options, &mut |what, share| {
        progress(what, 0.2 + 0.3 * share);
    })?;
    let mut extended = diagnosis.render_extended_toml(&source, path)?;
    let new = match compile_for_bench(&extended, faster) {
        Ok(new) => new,
        Err(why) => {
            notes.push(format!("The board cannot run what was found ({why}); the file stays."));
            extended.clone_from(&source);
            compile_for_bench(&source, faster)?
        }
    };

    let truth = hidden.record_day(1, true)?;
    progress("another day as it was", 0.5);
    let before = boards.run(&believed_blob, |bridge| {
        day.play(StartedBoard { bridge, counter: 0 }, &source, &second, &mut |share| {
            progress("", 0.5 + 0.2 * share);
        })
    })?;
    progress("loading what was found, and the same day with it", 0.7);
    let after = boards.run_with_updated_calibration(&believed_blob, &new, |started| {
        day.play(started, &extended, &second, &mut |share| progress("", 0.7 + 0.3 * share))
    })?;
    let board_s = played.board_s + before.board_s + after.board_s;
    let at_tool = |source: &str, played: &PlaybackRecord| {
        day.residuals_um(source, &truth, played, &hidden.measured_column_name())
    };
    let (before_um, after_um) = (at_tool(&source, &before)?, at_tool(&extended, &after)?);
    let (tool_rms_before_um, tool_rms_after_um) = (finite_rms(&before_um), finite_rms(&after_um));
    let rows = second.require_column("time_s")?.iter().zip(before_um.iter().zip(&after_um));
    let second_day = rows.map(|(time, (before, after))| [*time, *before, *after]).collect();

    let report = &diagnosis.report;
    let faults = hidden_fault_causes(hidden);
    // The day as its bridge sees it: readings are not predicted from readings.
    let unread = hidden.run_with_zeroed_readings(&second)?;
    let promised = diagnosis.predict_error_at_tool(&unread)?;
    // What the bridge is off its own model, as the first day has shown, it will be again, before and after.
    let of_bridge_um = day.model_deviation_rms_um(&source, &first, &played)?;
    let [before, after] = [promised.before_um, promised.after_um].map(|um| um.hypot(of_bridge_um));
    let promised_reduction = 1.0 - after / before.max(f64::MIN_POSITIVE);
    let (missed, wrong) = find_missed_and_false_claims(&faults, &report.findings);
    let envelope = true_and_predicted_effect(hidden, &first, &source, &extended, quantity)?;
    Ok(HiddenFaultResult {
        outcome: HiddenFaultOutcome {
            seed: hidden.seed,
            machine: plant.kind.name(),
            gap: hidden.gap,
            verdict: report.verdict.name(),
            all_right: missed.is_empty() && wrong.is_empty(),
            missed,
            wrong,
            faults,
            findings: report.findings.clone(),
            tool_rms_before_um,
            tool_rms_after_um,
            reduction: 1.0 - tool_rms_after_um / tool_rms_before_um,
            promised_reduction,
            faster,
            board_s,
        },
        notes,
        envelope,
        second_day,
        diagnosis,
    })
}

/// Returns the calibration of a machine file for a board whose clock the machine outruns by `faster`.
fn compile_for_bench(source: &str, faster: f64) -> Result<CompiledCalibration> {
    Ok(compile(&bench_machine::build_bench_machine(source, faster)?)?)
}

/// Returns the factor by which the days are played faster: a shift is short enough, and no change of a temperature so
/// fast that a board would doubt its thermometers.
fn choose_playback_speedup(first: &RunFile, second: &RunFile) -> Result<f64> {
    let times = first.require_column("time_s")?;
    let span_s = times[times.len() - 1] - times[0];
    let shift = (span_s / SHIFT_DURATION_S).ceil();
    let least = (span_s / MAX_SHIFT_DURATION_S).ceil();
    let faster = shift.min(max_playback_speedup(first)?).min(max_playback_speedup(second)?).floor();
    Ok(faster.max(least).max(1.0))
}

/// Computes the RMS of the rows that are known.
fn finite_rms(um: &[f64]) -> f64 {
    rms(&um.iter().copied().filter(|um| um.is_finite()).collect::<Vec<f64>>())
}

/// Returns the hidden faults with the causes that stand for them.
fn hidden_fault_causes(hidden: &SeparableFaultMachine) -> Vec<FaultCauses> {
    let faults = hidden.faults.iter();
    faults
        .map(|fault| FaultCauses {
            fault: fault.fault.name(),
            causes: expected_causes(fault.fault).to_vec(),
            ratio: fault.ratio,
        })
        .collect()
}

/// Faults that no finding names, and claimed causes that belong to no fault.
fn find_missed_and_false_claims(
    faults: &[FaultCauses],
    findings: &[Finding],
) -> (Vec<&'static str>, Vec<String>) {
    let names = |fault: &FaultCauses, cause: &str| fault.causes.contains(&cause);
    let is_named = |fault: &&FaultCauses| {
        let partners = |finding: &Finding| {
            finding.together_with.iter().any(|partner| names(fault, &partner.cause))
        };
        findings.iter().any(|finding| names(fault, &finding.cause) || partners(finding))
    };
    let missed = faults.iter().filter(|fault| !is_named(fault)).map(|fault| fault.fault).collect();
    let is_false = |finding: &&Finding| {
        finding.claimed && !faults.iter().any(|fault| names(fault, &finding.cause))
    };
    (missed, findings.iter().filter(is_false).map(|finding| finding.cause.clone()).collect())
}

/// Returns what the faults really do to each row of the first day, and what the new terms say of it.
fn true_and_predicted_effect(
    hidden: &SeparableFaultMachine,
    run: &RunFile,
    source: &str,
    extended: &str,
    quantity: Quantity,
) -> Result<Vec<[f64; 3]>> {
    let path = Path::new("machine.toml");
    let predicted = |source: &str| -> Result<Vec<f64>> {
        let machine = MachineFile::parse(source, path)?;
        let rows: Vec<f64> = RunPredictor::new(&machine, run)?
            .predictions()
            .map(|row| row.model.to_array()[quantity as usize])
            .collect();
        Ok(rows)
    };
    let (old, new) = (predicted(source)?, predicted(extended)?);
    let mut found: Vec<f64> = new.iter().zip(old).map(|(new, old)| new - old).collect();
    let mut truth: Vec<f64> = (0..run.row_count())
        .map(|row| hidden.faults.iter().map(|fault| fault.um[row]).sum())
        .collect();
    if quantity.axis().is_some() {
        // The zero of an axis's gauge is arbitrary.
        for um in [&mut found, &mut truth] {
            let mean = um.iter().sum::<f64>() / um.len() as f64;
            um.iter_mut().for_each(|um| *um -= mean);
        }
    }
    let rows = run.require_column("time_s")?.iter().zip(truth.into_iter().zip(found));
    Ok(rows.map(|(time, (truth, found))| [*time, truth, found]).collect())
}

/// A day on the bench.
struct BenchDay<'a> {
    boards: &'a BoardSource,
    quantity: Quantity,
    faster: f64,
}

impl BenchDay<'_> {
    fn play(
        &self,
        started: StartedBoard<'_>,
        source: &str,
        run: &RunFile,
        progress: &mut dyn FnMut(f64),
    ) -> Result<PlaybackRecord> {
        let machine = bench_machine::build_bench_machine(source, self.faster)?;
        let mut pace = PlaybackParameters::from_timestamps(run, self.faster)?;
        pace.counter = started.counter;
        play(started.bridge, &machine, run, &pace, &|_| true, progress)
            .with_context(|| format!("on the {} board", self.boards.name()))
    }

    /// Returns what the bridge corrects less what the file `source` predicts, RMS in µm: the steps of its clock, of its
    /// codes and of its arithmetic. The zero of an axis's gauge does not count.
    fn model_deviation_rms_um(
        &self,
        source: &str,
        run: &RunFile,
        played: &PlaybackRecord,
    ) -> Result<f64> {
        let machine = MachineFile::parse(source, Path::new("machine.toml"))?;
        let corrected = played
            .estimated_error_um(self.quantity, &bench_machine::build_bench_machine(source, 1.0)?);
        let predicted: Vec<f64> = RunPredictor::new(&machine, run)?
            .predictions()
            .map(|row| row.compensated.to_array()[self.quantity as usize])
            .collect();
        let rows = (0..run.row_count())
            .filter(|&row| (1..MIN_UNUSABLE_QUALITY).contains(&played.quality[row]));
        let apart = rows.map(|row| corrected[row] - predicted[row]).filter(|um| um.is_finite());
        let mut apart: Vec<f64> = apart.collect();
        if self.quantity.axis().is_some() {
            let mean = apart.iter().sum::<f64>() / apart.len().max(1) as f64;
            apart.iter_mut().for_each(|um| *um -= mean);
        }
        Ok(if apart.is_empty() { 0.0 } else { rms(&apart) })
    }

    /// Returns what the offsets leave of what was measured, NaN in rows without an offset; the zero of an axis's
    /// gauge does not count.
    fn residuals_um(
        &self,
        source: &str,
        run: &RunFile,
        played: &PlaybackRecord,
        measured: &str,
    ) -> Result<Vec<f64>> {
        let machine = bench_machine::build_bench_machine(source, 1.0)?;
        let corrected = played.estimated_error_um(self.quantity, &machine);
        let values = run.require_column(measured)?;
        let mut left: Vec<f64> = (0..run.row_count())
            .map(|row| match played.quality[row] {
                MIN_UNUSABLE_QUALITY.. => f64::NAN,
                0 => values[row],
                _ => values[row] - corrected[row],
            })
            .collect();
        if self.quantity.axis().is_some() {
            let known: Vec<f64> = left.iter().copied().filter(|um| um.is_finite()).collect();
            let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
            left.iter_mut().for_each(|um| *um -= mean);
        }
        Ok(left)
    }

    /// Returns the bridge's own record with the gauge next to it, as the monitor writes it: the gauge sees what the
    /// offsets leave.
    fn build_record_with_gauge(
        &self,
        source: &str,
        run: &RunFile,
        played: &PlaybackRecord,
        measured: &str,
    ) -> Result<RunFile> {
        let machine = bench_machine::build_bench_machine(source, 1.0)?;
        let corrected = played.estimated_error_um(self.quantity, &machine);
        let seen = run.require_column(measured)?.iter().zip(&corrected);
        let seen =
            seen.map(|(um, corrected)| if corrected.is_finite() { um - corrected } else { *um });
        let mut more = vec![(measured.to_string(), seen.collect::<Vec<f64>>())];
        for (axis, name) in ["offset_x_um", "offset_y_um", "offset_z_um"].into_iter().enumerate() {
            let of = |offset: &Option<[f64; 3]>| offset.map_or(f64::NAN, |um| um[axis]);
            more.push((name.into(), played.offset_um.iter().map(of).collect()));
        }
        more.push((
            "quality".into(),
            played.quality.iter().map(|quality| f64::from(*quality)).collect(),
        ));
        with_columns(run, &more)
    }
}
