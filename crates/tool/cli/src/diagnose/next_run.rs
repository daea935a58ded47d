//! `trueup diagnose --next`: the run that comes next, as a program and a run file.

use std::path::Path;

use anyhow::Result;
use trueup_diagnose::{Diagnosis, NextRun, NoNextRunReason, ReadingMethod};
use trueup_machine::{Machine, machine_file::LinearAxis};
use trueup_output::escape::shell_quote;
use trueup_program::{
    MeasurementOptions, MeasurementPlan, ProgramError, SpeedSegment, TargetRun, control,
    plan_speed_run, plan_target_run, template,
};

use super::{DiagnoseArgs, DiagnosisInput};
use crate::{
    next_commands,
    output::{self, FileTransaction},
    program::Controller,
    report,
};

/// Returns the run as a control is to do it.
fn build_measurement_plan(
    next: &NextRun,
    machine: &Machine,
    options: &MeasurementOptions,
) -> Result<MeasurementPlan, ProgramError> {
    let separation = &next.separations[0];
    let why = format!("To separate {} from {}.", separation.causes[0], separation.causes[1]);
    if let Some(it) = &next.axis {
        let run = TargetRun {
            axis: LinearAxis::ALL[it.axis],
            targets_mm: it.targets_mm.clone(),
            over_mm: it.over_mm,
            times: it.times,
            feeds_mm_per_min: it.feeds_mm_per_min.clone(),
            dwell_s: it.dwell_s,
            heat_min: it.heat_min,
            heat_feed_mm_per_min: it.heat_feed_mm_per_min,
            cold: it.cold,
            warm: it.warm,
        };
        return plan_target_run(&run, machine, options, &next.inputs, &why);
    }
    let stretch = |segment: &trueup_diagnose::SpindleSegment| SpeedSegment {
        rpm: segment.rpm,
        minutes: segment.minutes,
        load_n: segment.load_n,
    };
    let stretches: Vec<SpeedSegment> = next.stretches.iter().map(stretch).collect();
    Ok(plan_speed_run(&stretches, next.every_s, &next.inputs, &why))
}

/// Returns how long the run lasts with a gauge that is recorded, where that saves a third of a run by hand.
fn recorded_gauge_run_minutes(
    diagnosis: &Diagnosis,
    next: &NextRun,
    gauge: ReadingMethod,
) -> Option<f64> {
    let recorded =
        diagnosis.next_run(ReadingMethod::Auto).ok().filter(|_| gauge == ReadingMethod::Hand)?;
    (recorded.minutes < next.minutes * 2.0 / 3.0).then_some(recorded.minutes)
}

/// Returns the command that diagnoses the runs before together with this one, as it can be typed.
fn diagnosis_command(args: &DiagnoseArgs) -> String {
    // Every field: an omitted option would change the answer.
    let DiagnosisInput {
        machine,
        runs,
        off,
        applied_once,
        holdout,
        quantity,
        matters_um,
        instrument_um,
    } = &args.input;
    let word = |path: &Path| shell_quote(&path.to_string_lossy()).to_string();
    let mut line = format!("trueup diagnose --machine {}", word(machine));
    let next = args.out.join("next.csv");
    for (flag, paths) in [("run", runs), ("run", &vec![next]), ("off", off), ("holdout", holdout)] {
        line.extend(paths.iter().map(|path| format!(" --{flag} {}", word(path))));
    }
    if *applied_once {
        line += " --applied-once";
    }
    line.extend(quantity.map(|quantity| format!(" --quantity {}", quantity.name())));
    for (flag, um) in [("matters-um", matters_um), ("instrument-um", instrument_um)] {
        line.extend(um.map(|um| format!(" --{flag} {um}")));
    }
    let mut folder = args.out.clone().into_os_string();
    folder.push("-next");
    line + &format!(" --out {}", word(Path::new(&folder)))
}

/// Writes it into the folder of the diagnosis, or says why there is none.
pub fn write_next_run_plan(
    diagnosis: &Diagnosis,
    machine: &Machine,
    control: Controller,
    args: &DiagnoseArgs,
    as_json: bool,
) -> Result<()> {
    let (gauge, out) = (args.gauge, &args.out);
    let options = args.motion.to_options()?;
    let next = match diagnosis.next_run(gauge) {
        Ok(next) => {
            if let Some(minutes) = recorded_gauge_run_minutes(diagnosis, &next, gauge) {
                report::print_warning(format_args!(
                    "with a gauge that a program records the next run lasts {minutes:.0} minutes instead of {:.0}: --gauge auto",
                    next.minutes
                ));
            }
            next
        }
        Err(why @ NoNextRunReason::NothingOpen) => {
            return if as_json { Ok(()) } else { output::print(format_args!("next run: {why}")) };
        }
        Err(why) => {
            let is_by_hand =
                gauge == ReadingMethod::Hand && diagnosis.next_run(ReadingMethod::Auto).is_ok();
            let more =
                if is_by_hand { "; readings that a program records do: --gauge auto" } else { "" };
            report::print_warning(format_args!("no next run: {why}{more}"));
            return Ok(());
        }
    };
    let planned = control
        .to_control()
        .check_machine(machine)
        .and_then(|()| build_measurement_plan(&next, machine, &options));
    let mut plan = match planned {
        Ok(plan) => plan,
        Err(refused) => {
            report::print_warning(format_args!(
                "no program of the next run ({}): {refused}",
                next.sentence()
            ));
            return Ok(());
        }
    };
    plan.then = vec![diagnosis_command(args)];
    let (name, text) = control::generate_program(&plan, control.to_control())?;
    let mut texts = vec![
        (name.clone(), text),
        ("next.json".into(), serde_json::to_string_pretty(&next)? + "\n"),
    ];
    texts.extend(template::run_file_templates(&plan));
    let mut set = FileTransaction::new(&[]);
    for (file, text) in texts {
        output::check_run_overwrite(&out.join(&file), &text)?;
        set.add_text(&out.join(file), &text)?;
    }
    set.commit()?;
    if as_json {
        return Ok(());
    }
    output::print(format_args!(
        "next run, {:.0} minutes: {}\n{}, {}",
        next.minutes,
        next.sentence(),
        out.join(name).display(),
        out.join("next.csv").display()
    ))?;
    next_commands::print_next_commands(&plan.then)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: DiagnoseArgs,
    }

    #[test]
    fn the_line_that_comes_next_has_every_option_of_the_input() {
        let typed = "trueup --machine m.toml --run a.csv --off b.csv --applied-once --holdout c.csv \
                     --quantity dx --matters-um 3 --instrument-um 1.5 --out d";
        let cli = Cli::parse_from(typed.split_whitespace());
        let expected = "trueup diagnose --machine m.toml --run a.csv --run d/next.csv --off b.csv --holdout c.csv \
                        --applied-once --quantity dx --matters-um 3 --instrument-um 1.5 --out d-next";
        assert_eq!(diagnosis_command(&cli.args), expected);
    }
}
