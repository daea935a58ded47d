//! The minutes that the planned runs, and two fixed cycles, need over many machines.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use trueup_diagnose::{Diagnosis, NextRun, NoNextRunReason, ReadingMethod};
use trueup_machine::RunFile;

/// The score gap that is strong evidence.
const STRONG: f64 = 6.0;

/// A machine that is tried.
pub trait Tried {
    /// Returns what is wrong with it.
    fn wrong(&self) -> String;
    /// Returns what its cause may be called at the beginning of its name.
    fn truth(&self) -> &'static [&'static str];
    /// Returns what is known after a short run.
    fn begun(&self) -> Diagnosis;
    /// Returns the planned run, as it is recorded, and the two fixed cycles on the same morning, so that chance is the
    /// same.
    fn planned(&self, next: &NextRun) -> RunFile;
    fn fixed(&self) -> [RunFile; 2];
}

/// Over many machines.
#[derive(Debug, Default)]
pub struct Needed {
    /// Machines of which something is open.
    pub open: usize,
    /// Of them: those whose open causes predict the same in every run.
    pub alike: usize,
    /// Of all that are open: those for which a run is planned.
    pub planned: usize,
    /// Of them: those whose planned run distinguished the causes.
    pub decided: usize,
    /// Of them: those of which one cause is what the machine really has, and those whose run favoured it.
    pub has_truth: usize,
    pub right: usize,
    /// Minutes until the causes were distinguished in all: by the plans (and the first cycle after a plan that failed),
    /// by the first cycle, by the second.
    pub minutes: [f64; 3],
}

/// After how many minutes what was recorded is strong evidence, and stays so to its end; none: it never is.
fn minutes_until_decided(diagnosis: &Diagnosis, run: &RunFile) -> Option<f64> {
    let score = |rows: usize| {
        let part = run.with_altered_values(rows, |_, _| {});
        diagnosis.likelihood_ratio_statistic(&part).expect("all columns").expect("open")
    };
    let whole = score(run.row_count());
    let is_decided = |rows: &usize| score(*rows) * whole.signum() >= STRONG;
    let first = (3..=run.row_count()).rev().take_while(is_decided).last()?;
    Some(run.column("time_s").expect("there")[first - 1] / 60.0)
}

fn lasts_min(run: &RunFile) -> f64 {
    run.column("time_s").and_then(|times| times.last()).map_or(0.0, |last_s| last_s / 60.0)
}

pub fn needed<T: Tried>(seeds: impl Iterator<Item = u64>, drawn: impl Fn(u64) -> T) -> Needed {
    let mut all = Needed::default();
    for seed in seeds {
        let tried = drawn(seed);
        let diagnosis = tried.begun();
        let next = match diagnosis.next_run(ReadingMethod::Auto) {
            Ok(next) => next,
            Err(NoNextRunReason::NothingOpen) => continue,
            Err(why) => {
                all.open += 1;
                all.alike += usize::from(why.to_string().contains("predict the same"));
                println!("seed {seed} ({}): {why}", tried.wrong());
                continue;
            }
        };
        all.open += 1;
        all.planned += 1;
        let planned = tried.planned(&next);
        let own = minutes_until_decided(&diagnosis, &planned);
        let cycles = tried.fixed().map(|cycle| {
            minutes_until_decided(&diagnosis, &cycle).unwrap_or_else(|| lasts_min(&cycle))
        });
        let measured =
            diagnosis.likelihood_ratio_statistic(&planned).expect("all columns").expect("open");
        println!(
            "seed {seed} ({}): {}; measured {measured:.0}, decided after {own:.1?} of {:.1} min, by the fixed cycles after \
             {cycles:.1?}",
            tried.wrong(),
            next.sentence(),
            next.minutes
        );
        all.decided += usize::from(own.is_some());
        let begins = |cause: &String| tried.truth().iter().any(|truth| cause.starts_with(truth));
        let is_true = next.separations[0].causes.each_ref().map(begins);
        if own.is_some() && is_true[0] != is_true[1] {
            all.has_truth += 1;
            all.right += usize::from((measured > 0.0) == is_true[0]);
        }
        let own = own.unwrap_or(next.minutes + cycles[0]);
        let each = [own, cycles[0], cycles[1]];
        all.minutes.iter_mut().zip(each).for_each(|(sum, minutes)| *sum += minutes);
    }
    let [own, first, second] = all.minutes;
    println!("{all:.0?}: {:.2} of the first cycle, {:.2} of the second", own / first, own / second);
    all
}
