//! The tables of an axis that is driven at both ends of a beam: a run with the beam's axis at each drive.
//!
//! At w = (y − `first_mm`)/(`second_mm` − `first_mm`) the error is (1 − w)·first + w·second, so each table is what is
//! measured where the other one does not count. Backlash belongs to the whole axis: it is found at the first drive and taken
//! off at the second one.

use trueup_machine::{
    InputFileError,
    applied_offsets::UncompensatedRun,
    machine_file::{Feedback, LinearAxis, SecondDrive},
};

use super::{PitchFit, PitchFitOptions, TableMode, fit};
use crate::report::{FitDetail, FitReport, FitVerdict};

/// How far from a drive a reading may be, as a share of the beam: the other drive then counts for as much.
const MAX_DRIVE_DISTANCE_RATIO: f64 = 0.05;

/// Which drive a run is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum GantryDrive {
    /// The first: `[axis.x.pitch]`.
    First,
    /// The second: `[axis.x.dual] pitch`.
    Second,
}

/// Returns the drive at which the beam's axis stood in a run; `None` if the run does not say where it stood.
///
/// # Errors
/// It stood elsewhere, or moved.
pub(crate) fn identify_drive(
    run: &UncompensatedRun<'_>,
    dual: &SecondDrive,
) -> Result<Option<GantryDrive>, InputFileError> {
    let column = format!("{}_mm", dual.across.name());
    let Some(places) = run.column(&column) else { return Ok(None) };
    let mut found = None;
    for (row, place) in places.iter().enumerate().filter(|(_, place)| !place.is_nan()) {
        let share = (place - dual.first_mm) / (dual.second_mm - dual.first_mm);
        let drive = if share.abs() <= MAX_DRIVE_DISTANCE_RATIO {
            GantryDrive::First
        } else if (share - 1.0).abs() <= MAX_DRIVE_DISTANCE_RATIO {
            GantryDrive::Second
        } else {
            let rule = format!(
                "is {place}: the two drives are at {} and {} mm, and the table of each is measured there",
                dual.first_mm, dual.second_mm
            );
            return Err(run.value_error(row, &column, rule));
        };
        if found.is_some_and(|found| found != drive) {
            let rule = "has readings at both drives: give a run file for each, --run twice";
            return Err(run.value_error(row, &column, rule));
        }
        found = Some(drive);
    }
    Ok(found)
}

/// Fits both tables. `options` are asked for each run.
///
/// # Errors
/// As [`fit`] and `identify_drive`; two runs of the same drive, or more than two.
pub fn fit_both_drives<E: From<InputFileError>>(
    runs: &[UncompensatedRun<'_>],
    axis: LinearAxis,
    dual: &SecondDrive,
    mut options: impl FnMut(&UncompensatedRun<'_>) -> Result<PitchFitOptions, E>,
) -> Result<FitReport, E> {
    let mut of = [None, None];
    for run in runs {
        let place = &mut of[identify_drive(run, dual)?.unwrap_or(GantryDrive::First) as usize];
        if place.is_some() {
            let rule = format!(
                "is of the same drive as another run: give one with {0} at {1} mm and one at {2} mm",
                dual.across.name().to_uppercase(),
                dual.first_mm,
                dual.second_mm
            );
            return Err(run.value_error(0, &format!("{}_mm", dual.across.name()), rule).into());
        }
        *place = Some(run);
    }
    let first = of[0].map(|run| -> Result<PitchFit, E> { Ok(fit(run, axis, &options(run)?)?) });
    let first = first.transpose()?;
    let second = of[1]
        .map(|run| -> Result<PitchFit, E> {
            let of_first = first.as_ref();
            Ok(fit(run, axis, &second_drive_options(run, axis, of_first, options(run)?))?)
        })
        .transpose()?;
    let name = axis.name();
    let to_measure = |place: f64| {
        format!(
            "measure it too: trueup program pitch writes a program for each drive; {} at {place} mm, and --run twice",
            dual.across.name().to_uppercase()
        )
    };
    Ok(match (first, second) {
        (Some(first), None) => {
            let mut report = first.report;
            report.warnings.push(format!(
                "this run is of one drive of two: the second one's table, [axis.{name}.dual] pitch, stays as it is, {}; {}",
                format_max_abs(&dual.pitch.forward_um),
                to_measure(dual.second_mm)
            ));
            report
        }
        (None, Some(second)) => {
            let mut report = convert_to_second_drive_report(second.report, axis);
            report.warnings.push(format!(
                "this run is of the second drive: the first one's table, [axis.{name}.pitch], and the backlash stay as they \
                 are; {}",
                to_measure(dual.first_mm)
            ));
            report
        }
        (Some(first), Some(second)) => {
            merge_reports(first.report, convert_to_second_drive_report(second.report, axis))
        }
        (None, None) => unreachable!("a run is of one of them"),
    })
}

/// Returns what stands in a table that stays.
fn format_max_abs(um: &[f64]) -> String {
    let largest = um.iter().fold(0.0_f64, |most, um| most.max(um.abs()));
    if largest == 0.0 { "0 everywhere".into() } else { format!("up to {largest:.1} µm") }
}

/// At the second drive the backlash of the axis is known.
fn second_drive_options(
    run: &UncompensatedRun<'_>,
    axis: LinearAxis,
    first: Option<&PitchFit>,
    options: PitchFitOptions,
) -> PitchFitOptions {
    let Some(first) = first else {
        // Without the first there is nothing that says how the axis reverses.
        return PitchFitOptions { ways: TableMode::One, feedback: Feedback::Scale, ..options };
    };
    if first.pitch.as_ref().is_some_and(|pitch| pitch.reverse_um.is_some()) {
        return PitchFitOptions { ways: TableMode::Both, ..options };
    }
    let width_um = first.backlash.map_or(0.0, |backlash| backlash.width_um);
    let mut known_um = options.known_um.unwrap_or_else(|| vec![0.0; run.row_count()]);
    if let Some(ways) = run.column(&format!("dir_{}", axis.name())) {
        for (known, way) in known_um.iter_mut().zip(ways) {
            *known += if *way < 0.0 { width_um } else { 0.0 };
        }
    }
    PitchFitOptions {
        ways: TableMode::One,
        feedback: Feedback::Scale,
        known_um: Some(known_um),
        ..options
    }
}

/// Returns the report of the second drive's own table.
fn convert_to_second_drive_report(mut report: FitReport, axis: LinearAxis) -> FitReport {
    let pitch = format!("axis.{}.pitch", axis.name());
    report.edit.sections.retain(|section| section.name() == pitch);
    for section in &mut report.edit.sections {
        section.rename(format!("axis.{}.dual.pitch", axis.name()));
    }
    report.edit.removed.clear();
    report.edit.defaults.clear();
    report
}

/// Returns one report of both.
fn merge_reports(mut first: FitReport, second: FitReport) -> FitReport {
    let prefixed = |text: &String| format!("second drive: {text}");
    first.warnings.extend(second.warnings.iter().map(prefixed));
    first.excluded.extend(second.excluded);
    for (name, spread) in [
        ("second_drive_before_rms_um", second.before),
        ("second_drive_in_sample_rms_um", second.in_sample),
        ("second_drive_left_out_rms_um", second.held_out),
    ] {
        first.facts.extend(spread.map(|spread| FitDetail::number(name, spread.rms_um)));
    }
    first.rows_used += second.rows_used;
    match second.verdict {
        FitVerdict::Fitted => first.edit.sections.extend(second.edit.sections),
        FitVerdict::DoNotCompensate(why) => {
            let why = why.iter().map(prefixed);
            match &mut first.verdict {
                FitVerdict::Fitted => first.verdict = FitVerdict::DoNotCompensate(why.collect()),
                FitVerdict::DoNotCompensate(of_first) => of_first.extend(why),
            }
        }
    }
    first
}
