//! Is the promise kept on simulated machines? Effects of the twin, each a machine with a record and another day, and what
//! `held_out` promises against what came there.
//!
//! ```text
//! cargo run --release -p trueup-campaigns --example promise -- [RATIO [SEEDS [FIRST]]]
//! ```
//!
//! A line for each promise that was not kept and for each cause, then the counts: how often the floor was kept, how far it lay below what came at the median, and
//! how often more than 0.10 less came than was expected.
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use std::{env, path::Path};

use trueup_campaigns::hidden_effects::{HiddenCause, draw_test_case};
use trueup_diagnose::{diagnose, report::DiagnosisReport};
use trueup_machine::{MachineFile, RunFile};
use trueup_numerics::robust::median;

/// More than this less than expected is too good a promise.
const MAX_REDUCTION_SHORTFALL: f64 = 0.10;

/// Of one draw.
struct PromiseOutcome {
    floor: f64,
    expected: f64,
    came: f64,
    falls_short: bool,
}

fn main() {
    let asked: Vec<f64> = env::args().skip(1).filter_map(|word| word.parse().ok()).collect();
    let of = |n: usize, usual: f64| asked.get(n).copied().unwrap_or(usual);
    let (ratio, seeds, first) = (of(0, 3.0), of(1, 10.0) as u64, of(2, 0.0) as u64);
    let mut all = Vec::new();
    for &cause in HiddenCause::ALL {
        let own: Vec<PromiseOutcome> = (first..first + seeds)
            .filter_map(|seed| evaluate_promise(cause, ratio, seed))
            .collect();
        println!("{:32} {}", cause.name(), format_summary(&own));
        all.extend(own);
    }
    println!("{:32} {}", "all", format_summary(&all));
}

fn evaluate_promise(cause: HiddenCause, ratio: f64, seed: u64) -> Option<PromiseOutcome> {
    let challenge = draw_test_case(cause, ratio, seed);
    let read = |text: &String| {
        RunFile::from_reader(text.as_bytes(), Path::new("run.csv")).expect("the twin's own file")
    };
    let runs: Vec<RunFile> = challenge.runs.iter().map(read).collect();
    let machine = MachineFile::parse(&challenge.machine, Path::new("m.toml")).expect("its own");
    let holdout = [read(&challenge.holdout)];
    let report = diagnose(&machine, &runs, &holdout, None, &mut |_, _| {}).ok()?.report;
    let figures = report.held_out.as_ref()?.figures;
    if holdout_reduction(&report) < figures.reduction_floor95 {
        println!(
            "{} {ratio} {seed}: floor {:.3}, promised {:.3} → {:.3} µm, came {:.3} → {:.3} µm",
            cause.name(),
            figures.reduction_floor95,
            figures.before_um,
            figures.after_um,
            report.before.holdout_rms_um,
            report.after.compensated_holdout_rms_um
        );
    }
    Some(PromiseOutcome {
        floor: figures.reduction_floor95,
        expected: figures.reduction,
        came: holdout_reduction(&report),
        falls_short: report.verdict.name() == "falls-short",
    })
}

/// Returns the reduction on the hold-out.
fn holdout_reduction(report: &DiagnosisReport) -> f64 {
    1.0 - report.after.compensated_holdout_rms_um / report.before.holdout_rms_um
}

fn format_summary(of: &[PromiseOutcome]) -> String {
    let count =
        |is: &dyn Fn(&PromiseOutcome) -> bool| of.iter().filter(|outcome| is(outcome)).count();
    let mut below: Vec<f64> =
        of.iter().map(|outcome| outcome.came - outcome.floor.max(0.0)).collect();
    let below = if below.is_empty() { 0.0 } else { median(&mut below) };
    format!(
        "{:4} promises, {:4} kept, {below:+.3} below at the median, {:3} too good, {:3} falls-short",
        of.len(),
        count(&|outcome| outcome.came >= outcome.floor),
        count(&|outcome| outcome.expected > outcome.came + MAX_REDUCTION_SHORTFALL),
        count(&|outcome| outcome.falls_short)
    )
}
