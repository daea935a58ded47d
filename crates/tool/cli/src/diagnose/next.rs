//! `trueup diagnose --next`: the run that comes next, as a program and a run file.

use std::path::Path;

use anyhow::Result;
use clap::ValueEnum as _;
use trueup_diagnose::{Diagnosis, Gauge, Next, NoNext};
use trueup_machine::{Machine, file::LinearAxis};
use trueup_output::escape::shell_word;
use trueup_program::{
    Options, Plan, Refused, Stretch, Targets, control, speeds, targets, template,
};

use super::{Diagnose, Input};
use crate::{
    commands,
    output::{self, FileSet},
    program::Controller,
    report,
};

/// Returns the run as a control is to do it.
fn plan(next: &Next, machine: &Machine, options: &Options) -> Result<Plan, Refused> {
    let told = &next.told[0];
    let why = format!("To tell {} from {}.", told.causes[0], told.causes[1]);
    if let Some(it) = &next.axis {
        let run = Targets {
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
        return targets(&run, machine, options, &next.inputs, &why);
    }
    let stretch = |it: &trueup_diagnose::Stretch| Stretch {
        rpm: it.rpm,
        minutes: it.minutes,
        load_n: it.load_n,
    };
    let stretches: Vec<Stretch> = next.stretches.iter().map(stretch).collect();
    Ok(speeds(&stretches, next.every_s, &next.inputs, &why))
}

/// Returns how long the run lasts with a gauge that is recorded, where that saves a third of a run by hand.
fn shorter(diagnosis: &Diagnosis, next: &Next, gauge: Gauge) -> Option<f64> {
    let recorded = diagnosis.next(Gauge::Auto).ok().filter(|_| gauge == Gauge::Hand)?;
    (recorded.minutes < next.minutes * 2.0 / 3.0).then_some(recorded.minutes)
}

/// Returns the command that diagnoses the runs before together with this one, as it can be typed.
fn line(args: &Diagnose) -> String {
    // Every field: an option that is left out would change the answer.
    let Input { machine, runs, off, applied_once, holdout, quantity, matters_um, instrument_um } =
        &args.input;
    let word = |path: &Path| shell_word(&path.to_string_lossy()).to_string();
    let mut line = format!("trueup diagnose --machine {}", word(machine));
    let next = args.out.join("next.csv");
    for (flag, paths) in [("run", runs), ("run", &vec![next]), ("off", off), ("holdout", holdout)] {
        line.extend(paths.iter().map(|path| format!(" --{flag} {}", word(path))));
    }
    if *applied_once {
        line += " --applied-once";
    }
    if let Some(quantity) = quantity.and_then(|it| it.to_possible_value()) {
        line += &format!(" --quantity {}", quantity.get_name());
    }
    for (flag, um) in [("matters-um", matters_um), ("instrument-um", instrument_um)] {
        line.extend(um.map(|um| format!(" --{flag} {um}")));
    }
    let mut folder = args.out.clone().into_os_string();
    folder.push("-next");
    line + &format!(" --out {}", word(Path::new(&folder)))
}

/// Writes it into the folder of the diagnosis, or says why there is none.
pub fn write(
    diagnosis: &Diagnosis,
    machine: &Machine,
    control: Controller,
    args: &Diagnose,
    as_json: bool,
) -> Result<()> {
    let (gauge, out) = (args.gauge.gauge(), &args.out);
    let options = args.motion.options()?;
    let next = match diagnosis.next(gauge) {
        Ok(next) => {
            if let Some(minutes) = shorter(diagnosis, &next, gauge) {
                report::warn(format_args!(
                    "with a gauge that a program records the next run lasts {minutes:.0} minutes instead of {:.0}: --gauge auto",
                    next.minutes
                ));
            }
            next
        }
        Err(why @ NoNext::NothingOpen) => {
            return if as_json { Ok(()) } else { output::print(format_args!("next run: {why}")) };
        }
        Err(why) => {
            let is_by_hand = gauge == Gauge::Hand && diagnosis.next(Gauge::Auto).is_ok();
            let more =
                if is_by_hand { "; readings that a program records do: --gauge auto" } else { "" };
            report::warn(format_args!("no next run: {why}{more}"));
            return Ok(());
        }
    };
    let planned = control.control().check(machine).and_then(|()| plan(&next, machine, &options));
    let mut plan = match planned {
        Ok(plan) => plan,
        Err(refused) => {
            report::warn(format_args!(
                "no program of the next run ({}): {refused}",
                next.sentence()
            ));
            return Ok(());
        }
    };
    plan.then = vec![line(args)];
    let (name, text) = control::program(&plan, control.control())?;
    let mut texts = vec![
        (name.clone(), text),
        ("next.json".into(), serde_json::to_string_pretty(&next)? + "\n"),
    ];
    texts.extend(template::templates(&plan));
    let mut set = FileSet::new(&[]);
    for (file, text) in texts {
        output::check_measurement(&out.join(&file), &text)?;
        set.text(&out.join(file), &text)?;
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
    commands::print(&plan.then)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: Diagnose,
    }

    #[test]
    fn the_line_that_comes_next_has_every_option_of_the_input() {
        let typed = "trueup --machine m.toml --run a.csv --off b.csv --applied-once --holdout c.csv \
                     --quantity dx --matters-um 3 --instrument-um 1.5 --out d";
        let cli = Cli::parse_from(typed.split_whitespace());
        let expected = "trueup diagnose --machine m.toml --run a.csv --run d/next.csv --off b.csv --holdout c.csv \
                        --applied-once --quantity dx --matters-um 3 --instrument-um 1.5 --out d-next";
        assert_eq!(line(&cli.args), expected);
    }
}
