//! The report of a pitch fit.

use trueup_machine::{
    machine_file::writer::MachineFileEdit,
    machine_file::{Backlash, LinearAxis},
};

use trueup_numerics::repeats::{
    TableRejection, TableSelection, check_interpolation, required_cycles,
};

use super::{
    cross_validation::{
        CorrectionModel, CrossValidationScore, DirectionSums, FittedCorrection, fold_count,
        is_significant_gain, mean_and_half_width,
    },
    pitch_aliasing::find_aliased_pitches,
    pitch_table::TableGrid,
    readings::PitchReadings,
    scatter::RepeatScatter,
};
use crate::{
    iso230_2::Iso230Results,
    report::{FitDetail, FitParameter, FitReport, ResidualStatistics},
};

/// The standard requires this many arrivals at each target in each direction.
const MIN_ISO_230_2_RUNS: usize = 5;

/// Adds the figures of the measurement to the report, whatever becomes of the correction.
pub(super) fn add_measurement_statistics(
    report: &mut FitReport,
    readings: &PitchReadings,
    iso230: &Option<Iso230Results>,
) {
    let um: Vec<f64> = readings.list.iter().map(|reading| reading.um).collect();
    report.before = ResidualStatistics::from_residuals(&um);
    report.rows_used = um.len();
    report.rows_incomplete = readings.rows_incomplete;
    report.held_out_by = describe_folds(readings.runs);
    report.facts.push(FitDetail::number("runs", readings.runs as f64));
    report.facts.push(FitDetail::number("targets", readings.targets_mm.len() as f64));
    if let Some(iso230) = iso230 {
        report.facts.extend(iso230_facts(iso230));
    }
}

pub(super) fn describe_folds(runs: usize) -> String {
    match fold_count(runs) {
        0 | 1 => String::new(),
        blocks if blocks < runs => format!("each of {blocks} blocks of {runs} runs in turn"),
        _ => format!("each of {runs} runs in turn"),
    }
}

/// Returns the figures of the axis by the symbols of the standard.
fn iso230_facts(iso230: &Iso230Results) -> Vec<FitDetail> {
    let mut facts = Vec::new();
    let mut fact =
        |name: &str, um: f64| facts.push(FitDetail::number(format!("iso230_{name}_um"), um));
    for (way, axis) in [("forward", iso230.forward), ("reverse", iso230.reverse)] {
        if let Some(axis) = axis {
            fact(&format!("r_{way}"), axis.repeatability_um);
            fact(&format!("e_{way}"), axis.systematic_um);
            fact(&format!("a_{way}"), axis.accuracy_um);
        }
    }
    if let Some(both) = iso230.both {
        fact("b", both.reversal_um);
        fact("b_mean", both.mean_reversal_um);
        fact("r", both.repeatability_um);
        fact("e", both.systematic_um);
        fact("m", both.mean_error_um);
        fact("a", both.accuracy_um);
    }
    facts
}

/// Adds the warnings for a user who relies on the table.
pub(super) fn add_warnings(
    report: &mut FitReport,
    readings: &PitchReadings,
    iso230: &Option<Iso230Results>,
) {
    let warnings = &mut report.warnings;
    if readings.runs < 2 {
        report.facts.push(FitDetail::text("repeatability", "unknown"));
        warnings.push(
            "there is only one run: the repeatability and the gain of the table are unknown; measure at least two runs, better five, in both directions"
                .to_string(),
        );
    } else if let Some(iso230) = iso230
        && iso230.fewest_runs < MIN_ISO_230_2_RUNS
    {
        warnings.push(format!(
            "ISO 230-2 requires {MIN_ISO_230_2_RUNS} runs in each direction, there are {}: its figures are uncertain",
            iso230.fewest_runs
        ));
    }
    match readings.measured_directions() {
        [true, true] => {}
        [true, false] => warnings.push(
            "only the positive direction was measured: backlash is not known, and the table is \
             used for the negative direction as well"
                .to_string(),
        ),
        _ => warnings.push(
            "only the negative direction was measured: the table contains the backlash, and is \
             used for the positive direction as well"
                .to_string(),
        ),
    }
    if !readings.is_record {
        let hidden = find_aliased_pitches(&readings.targets_mm);
        if !hidden.is_empty() {
            let hidden: Vec<String> = hidden.iter().map(f64::to_string).collect();
            warnings.push(format!(
                "the test points lie on multiples of {} mm. If one of these is the pitch of the \
                 screw, its periodic error was not seen and stays. Measure at uneven distances, \
                 as ISO 230-2 requires",
                hidden.join(", ")
            ));
        }
    }
}

/// The constants and what changes in the machine file.
pub(super) fn add_pitch_correction(
    report: &mut FitReport,
    axis: LinearAxis,
    readings: &PitchReadings,
    sums: &DirectionSums,
    grid: &TableGrid,
    fitted: &FittedCorrection,
) {
    let Some(pitch) = &fitted.pitch else { return };
    report.parameters.push(FitParameter::fixed("start_mm", pitch.start_mm));
    report.parameters.push(FitParameter::fixed("step_mm", pitch.step_mm));
    report.facts.push(FitDetail::number("table_points", grid.points as f64));
    let name = format!("axis.{}", axis.name());
    let rms = |spread: Option<ResidualStatistics>| {
        spread.map_or("?".into(), |spread| format!("{:.2}", spread.rms_um))
    };
    report.edit =
        MachineFileEdit::from_section(pitch.to_section(axis).with_header_comment(format!(
            "From {} readings of {} runs; rms µm before {}, fitted {}, held out {}.",
            report.rows_used,
            readings.runs,
            rms(report.before),
            rms(report.in_sample),
            rms(report.held_out)
        )));
    let backlash = format!("{name}.backlash");
    match fitted.width_um {
        Some(width_um) => {
            let half = backlash_half_width_um(readings, sums);
            report.parameters.push(match half {
                Some(half) => FitParameter::fitted("width_um", width_um, half),
                None => FitParameter::fixed("width_um", width_um),
            });
            report.edit.sections.push(
                Backlash::width_section(axis, width_um)
                    .with_header_comment("Belongs to the table above: both were fitted together."),
            );
        }
        // It is in the tables, or was found not to gain.
        None => report.edit.removed.push(backlash),
    }
}

/// Returns half the 95 % interval of the mean width: from the runs' own widths, or with one run from those
/// of the targets.
fn backlash_half_width_um(readings: &PitchReadings, sums: &DirectionSums) -> Option<f64> {
    let runs = readings.runs;
    let widths: Vec<f64> = if runs < 2 {
        sums.reversal_errors_um()
    } else {
        let blocks = fold_count(runs);
        (0..blocks)
            .filter_map(|block| {
                let own = |reading: &&super::PitchReading| {
                    super::cross_validation::fold_index(reading.run, runs) == block
                };
                let own = readings.list.iter().filter(own);
                let widths = DirectionSums::from_readings(readings.targets_mm.len(), own)
                    .reversal_errors_um();
                let count = widths.len() as f64;
                (count > 0.0).then(|| widths.iter().sum::<f64>() / count)
            })
            .collect()
    };
    confidence_half_width(&widths)
}

/// Returns half the 95 % interval of the mean of `values`; `None` below two values.
pub(super) fn confidence_half_width(values: &[f64]) -> Option<f64> {
    mean_and_half_width(values, 0.975).map(|(_, half_width)| half_width)
}

/// Why the axis should not be corrected, a sentence each.
pub(super) fn rejection_reasons(
    readings: &PitchReadings,
    judged: &[CrossValidationScore],
    best: Option<&CrossValidationScore>,
    by_target: &[[Vec<f64>; 2]],
) -> Vec<String> {
    let mut rejection_reasons = Vec::new();
    let (Some(best), [nothing, constant, ..]) = (best, judged) else { return rejection_reasons };
    let law = match best.law {
        CorrectionModel::BothTables => "a table for each direction",
        CorrectionModel::TableAndBacklash => "a table and a backlash",
        _ => "a table",
    };
    let each = |judged: &CrossValidationScore| {
        let each: Vec<String> =
            judged.rms_by_fold_um().iter().map(|um| format!("{um:.1}")).collect();
        each.join(", ")
    };
    let constant_alone =
        best.is_significantly_better_than(nothing) && !best.is_significantly_better_than(constant);
    let verdict = if constant_alone { "" } else { ": no gain that holds" };
    rejection_reasons.push(format!(
        "on held-out runs the error is {:.1} µm rms without a correction. With {law} from the \
         other runs it is {:.1} µm (run by run {} and {}){verdict}",
        nothing.rms_um(),
        best.rms_um(),
        each(nothing),
        each(best)
    ));
    let scatter = RepeatScatter::from_targets(by_target);
    if let Some(repeats_um) = scatter.repeats_um {
        rejection_reasons.push(format!(
            "repeats at one position from one side scatter by {repeats_um:.1} µm (one standard \
             deviation), and the systematic error along the axis is {:.1} µm rms",
            scatter.systematic_rms_um()
        ));
    }
    if constant_alone {
        rejection_reasons.push(format!(
            "what a table would gain is a constant, which already leaves {:.1} µm. The zero of \
             a measurement is arbitrary, and a constant is not a position error",
            constant.rms_um()
        ));
    } else if is_better_after_centring(readings, nothing, best) {
        rejection_reasons.push(
            "with the mean of each run taken out, the shape does repeat: the axis or the \
             instrument shifts from run to run. Find that first, or zero the instrument before \
             each run"
                .to_string(),
        );
    }
    rejection_reasons
}

/// Returns what to measure so that it can be decided, in a sentence.
pub(super) fn suggest_measurement(
    readings: &PitchReadings,
    decision: &TableSelection,
    by_target: &[[Vec<f64>; 2]],
) -> Option<String> {
    let targets = readings.targets_mm.len();
    let refusal = decision.taken.err()?;
    if refusal == TableRejection::TooFew {
        return Some(if targets < 3 {
            "too few targets for a table: measure at three at least, better at ten".to_string()
        } else {
            "each target was measured once, so it is unknown whether the axis repeats: measure two more \
             runs at the same targets, better in both directions"
                .to_string()
        });
    }
    let trial = decision.trials.iter().max_by(|a, b| a.f.total_cmp(&b.f))?;
    let chance = match refusal {
        TableRejection::Chance => format!(
            "the targets differ by no more than their repeats: F = {:.2}, which chance exceeds with \
             {:.0} %",
            trial.f,
            100.0 * trial.chance
        ),
        _ => "the targets differ, but not every run is predicted by the others".to_string(),
    };
    let shape_um = RepeatScatter::from_targets(by_target).shape_um;
    let cycles = required_cycles(shape_um, decision.scatter?, targets);
    Some(match cycles.filter(|cycles| *cycles > decision.blocks) {
        Some(cycles) => format!(
            "{chance}; an error of {shape_um:.1} µm rms that repeats would show with 95 % in {cycles} runs"
        ),
        None => format!("{chance}: find what shifts from run to run, then measure again"),
    })
}

/// Returns what the table is worth between its points, where that is doubted.
pub(super) fn interpolation_caveat(
    readings: &PitchReadings,
    law: CorrectionModel,
) -> Option<String> {
    let none = vec![false; readings.list.len()];
    let found = check_interpolation(
        &readings.targets_mm,
        &readings.to_repeat_readings(),
        &none,
        law.as_table_law()?,
    )?;
    found.is_interpolation_doubtful().then(|| {
        format!(
            "the table holds at its points; between them it is uncertain. The line between its \
             neighbours misses a held-out target by {:.1} µm rms, no table at all by {:.1} µm. \
             Measure between the targets as well (trueup diagnose lists positions)",
            found.line, found.nothing
        )
    })
}

/// Returns whether `best` gains on `nothing` if each run's residuals are counted from their own mean.
fn is_better_after_centring(
    readings: &PitchReadings,
    nothing: &CrossValidationScore,
    best: &CrossValidationScore,
) -> bool {
    let by_run = |judged: &CrossValidationScore| {
        let mut runs = vec![(0.0, 0.0, 0.0); readings.runs];
        for (reading, um) in readings.list.iter().zip(&judged.residuals_um) {
            let (sum, squares, count) = &mut runs[reading.run];
            *sum += um;
            *squares += um * um;
            *count += 1.0;
        }
        runs.into_iter().map(|(sum, squares, n)| squares / n - (sum / n) * (sum / n))
    };
    let gains: Vec<f64> =
        by_run(nothing).zip(by_run(best)).map(|(before, after)| before - after).collect();
    is_significant_gain(&gains)
}
