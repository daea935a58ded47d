//! `Diagnosis::next`: on spindles of the twin, of which one short run leaves causes open, the planned run tells them
//! apart in a fraction of the machine minutes of the cycles of ISO 230-3.
//!
//! `cargo test -p trueup-diagnose --test next -- --show-output --include-ignored` prints the figures.

use std::path::Path;

use trueup_diagnose::{Diagnosis, NoNext, Stretch, diagnose};
use trueup_machine::{MachineFile, RunFile};
use trueup_twin::trial::{RATED_RPM, Trial, Wrong};

/// The score gap that is strong evidence.
const STRONG: f64 = 6.0;

/// What is recorded of a machine while it does this from cold, on the morning `day`.
fn recorded(trial: &Trial, stretches: &[Stretch], day: u64) -> RunFile {
    let pieces: Vec<(f64, f64)> = stretches.iter().map(|it| (it.rpm, it.minutes)).collect();
    let csv = trial.run(&pieces, day);
    RunFile::from_reader(csv.as_bytes(), Path::new("run.csv")).expect("a run file")
}

/// A quarter of an hour at full speed, from cold: what a user has who begins.
fn begun(trial: &Trial) -> Diagnosis {
    let first = recorded(trial, &[at(RATED_RPM, 15.0)], 1);
    let machine = MachineFile::parse(&trial.machine, Path::new("m.toml")).expect("a machine file");
    diagnose(&machine, &[first], &[], None, &mut |_, _| {}).expect("comparable")
}

fn at(rpm: f64, minutes: f64) -> Stretch {
    Stretch { rpm, minutes, load_n: 0.0 }
}

/// The cycles of ISO 230-3 for a spindle: one speed for four hours or a spectrum of speeds, then an hour of rest.
fn fixed(fastest_rpm: f64) -> [Vec<Stretch>; 2] {
    let spectrum = [0.25, 0.5, 0.75, 1.0].map(|share| at(share * fastest_rpm, 60.0));
    [vec![at(fastest_rpm, 240.0), at(0.0, 60.0)], [&spectrum[..], &[at(0.0, 60.0)]].concat()]
}

/// After how many minutes what was recorded is strong evidence, and stays so to its end; none: it never is.
fn minutes_until_told(diagnosis: &Diagnosis, run: &RunFile) -> Option<f64> {
    let score = |rows: usize| {
        let part = run.altered(rows, |_, _| {});
        diagnosis.told_apart_by(&part).expect("all columns").expect("open")
    };
    let whole = score(run.rows());
    let is_told = |rows: &usize| score(*rows) * whole.signum() >= STRONG;
    let first = (3..=run.rows()).rev().take_while(is_told).last()?;
    Some(run.column("time_s").expect("there")[first - 1] / 60.0)
}

/// What the planned runs, the cycle at one speed and the spectrum need over many machines.
#[derive(Debug, Default)]
struct Needed {
    /// Machines of which something is open.
    open: usize,
    /// Of them: those for which a run is planned.
    planned: usize,
    /// Of them: those whose planned run told.
    told: usize,
    /// Of them: those of which one cause is what the machine really has, and those that told so.
    has_truth: usize,
    right: usize,
    /// Minutes until told in all: by the plans (and the cycle at one speed after a plan that did not tell), by the cycle
    /// at one speed, by the spectrum.
    minutes: [f64; 3],
}

fn needed(seeds: impl Iterator<Item = u64>) -> Needed {
    let mut all = Needed::default();
    for seed in seeds {
        let trial = Trial::drawn(seed);
        let diagnosis = begun(&trial);
        let next = match diagnosis.next() {
            Ok(next) => next,
            Err(NoNext::NothingOpen) => continue,
            Err(why) => {
                all.open += 1;
                println!("seed {seed}: {why}");
                continue;
            }
        };
        all.open += 1;
        all.planned += 1;
        // The same morning, so that chance is the same.
        let planned = recorded(&trial, &next.stretches, 2);
        let own = minutes_until_told(&diagnosis, &planned);
        let cycles = fixed(RATED_RPM).map(|cycle| {
            let minutes: f64 = cycle.iter().map(|it| it.minutes).sum();
            minutes_until_told(&diagnosis, &recorded(&trial, &cycle, 2)).unwrap_or(minutes)
        });
        let measured = diagnosis.told_apart_by(&planned).expect("all columns").expect("open");
        println!(
            "seed {seed} ({:?}): {}; measured {measured:.0}, told after {own:.0?} of {:.0} min, by the fixed cycles after \
             {cycles:.0?}",
            trial.wrong,
            next.sentence(),
            next.minutes
        );
        all.told += usize::from(own.is_some());
        let truth = match trial.wrong {
            Wrong::Centrifugal => "centrifugal-growth",
            Wrong::Column => "extra-heat-path of temp_column_c",
            Wrong::Lag => "thermal-lag",
            Wrong::Growth => "growth-amplitude",
        };
        let is_true = next.told[0].causes.each_ref().map(|cause| cause.starts_with(truth));
        if own.is_some() && is_true[0] != is_true[1] {
            all.has_truth += 1;
            all.right += usize::from((measured > 0.0) == is_true[0]);
        }
        let own = own.unwrap_or(next.minutes + cycles[0]);
        let each = [own, cycles[0], cycles[1]];
        all.minutes.iter_mut().zip(each).for_each(|(sum, minutes)| *sum += minutes);
    }
    let [own, one_speed, spectrum] = all.minutes;
    println!(
        "{all:.0?}: {:.2} of the cycle at one speed, {:.2} of the spectrum",
        own / one_speed,
        own / spectrum
    );
    all
}

#[test]
fn a_planned_run_tells_what_a_short_one_left_open() {
    let it = needed(1000..1012);
    assert!(it.planned > 0 && it.told > 0 && it.minutes[0] < it.minutes[2], "{it:?}");
}

/// Seeds that nothing was chosen by.
#[test]
#[ignore = "long: half a minute of diagnoses, each with three runs that are looked at minute by minute"]
fn half_the_minutes_of_the_cycles_of_iso_230_3_tell_causes_apart() {
    let it = needed(1000..1100);
    let [own, one_speed, spectrum] = it.minutes;
    assert!(it.open >= 20 && it.planned == it.open, "{it:?}");
    assert!(own <= 0.5 * spectrum && own <= 0.5 * one_speed, "{it:?}");
    assert!(it.told * 10 >= it.planned * 9 && it.right * 10 >= it.has_truth * 9, "{it:?}");
}
