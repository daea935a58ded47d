//! Of spindles.

use std::path::Path;

use trueup_campaigns::spindle_trial::{RATED_SPEED_RPM, SpindleFileDefect, SpindleTrial};
use trueup_diagnose::{Diagnosis, NextRun, SpindleSegment, diagnose};
use trueup_machine::{MachineFile, RunFile};

use crate::needed::{Tried, needed};

/// Returns what is recorded of a machine while it does this from cold, on the morning `day`.
fn recorded(trial: &SpindleTrial, stretches: &[SpindleSegment], day: u64) -> RunFile {
    let pieces: Vec<(f64, f64)> =
        stretches.iter().map(|stretch| (stretch.rpm, stretch.minutes)).collect();
    let csv = trial.simulate_day(&pieces, day);
    RunFile::from_reader(csv.as_bytes(), Path::new("run.csv")).expect("a run file")
}

fn at(rpm: f64, minutes: f64) -> SpindleSegment {
    SpindleSegment { rpm, minutes, load_n: 0.0 }
}

impl Tried for SpindleTrial {
    fn wrong(&self) -> String {
        format!("{:?}", self.wrong)
    }

    fn truth(&self) -> &'static [&'static str] {
        match self.wrong {
            SpindleFileDefect::Centrifugal => &["centrifugal-growth"],
            SpindleFileDefect::Column => &["extra-heat-path of temp_column_c"],
            SpindleFileDefect::Lag => &["thermal-lag"],
            SpindleFileDefect::Growth => &["growth-amplitude"],
        }
    }

    /// Returns a quarter of an hour at full speed, from cold: what a user has who begins.
    fn begun(&self) -> Diagnosis {
        let first = recorded(self, &[at(RATED_SPEED_RPM, 15.0)], 1);
        let machine =
            MachineFile::parse(&self.machine, Path::new("m.toml")).expect("a machine file");
        diagnose(&machine, &[first], &[], None, &mut |_, _| {}).expect("comparable")
    }

    fn planned(&self, next: &NextRun) -> RunFile {
        recorded(self, &next.stretches, 2)
    }

    /// Returns the cycles of ISO 230-3 for a spindle: one speed for four hours or a spectrum of speeds, then an hour of
    /// rest.
    fn fixed(&self) -> [RunFile; 2] {
        let spectrum = [0.25, 0.5, 0.75, 1.0].map(|share| at(share * RATED_SPEED_RPM, 60.0));
        let rest = at(0.0, 60.0);
        let cycles = [vec![at(RATED_SPEED_RPM, 240.0), rest], [&spectrum[..], &[rest]].concat()];
        cycles.map(|cycle| recorded(self, &cycle, 2))
    }
}

#[test]
fn a_planned_run_tells_what_a_short_one_left_open() {
    let it = needed(1000..1012, SpindleTrial::from_seed);
    assert!(it.planned > 0 && it.decided > 0 && it.minutes[0] < it.minutes[2], "{it:?}");
}

/// Seeds that nothing was chosen by.
#[test]
#[ignore = "long: twenty seconds of diagnoses, each with three runs that are looked at minute by minute"]
fn half_the_minutes_of_the_cycles_of_iso_230_3_tell_causes_apart() {
    let it = needed(1000..1100, SpindleTrial::from_seed);
    let [own, one_speed, spectrum] = it.minutes;
    assert!(it.open >= 20 && it.planned == it.open, "{it:?}");
    assert!(own <= 0.5 * spectrum && own <= 0.5 * one_speed, "{it:?}");
    assert!(it.decided * 10 >= it.planned * 9 && it.right * 10 >= it.has_truth * 9, "{it:?}");
}
