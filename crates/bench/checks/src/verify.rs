//! Every check of the project, in two tiers: nothing stops at the first failure, the last line counts.
//!
//! * Quick, `cargo verify`: every kind of check, each test that takes less than ten seconds.
//! * Long, `cargo verify --long`: what the quick tier leaves out, namely tests that say so
//!   (`#[ignore = "long: …"]`), the real LinuxCNC, the distribution's compiler, the documentation, the
//!   crates that the project is built from.
//!
//! `cargo verify --all` is both. Longer campaigns (`#[ignore = "campaign: …"]`, named `campaign_…`) are
//! in neither; their texts have their commands.

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use trueup_emulator::{
    chip,
    firmware::{self, Board},
    linuxcnc::{self, Way},
    process,
    setup::{self, TOOLCHAIN_VARIABLE},
    size, slots,
};

use crate::{
    cargo, structure, supply_chain,
    tally::Tally,
    test_run::{self, Program},
};

/// The tier to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tier {
    /// All tests that take at most ten seconds each: `cargo verify`.
    Quick,
    /// The tests that the quick tier leaves out: `--long`.
    Long,
    /// Both tiers: `--all`.
    All,
}

/// How long a test of the quick tier may take.
const QUICK: Duration = Duration::from_secs(10);
/// How often LinuxCNC runs at the most.
const LINUXCNC_RUNS: u32 = 3;
/// How many of the longest are printed.
const LONGEST: usize = 10;

/// The steps that were run so far, and their results.
#[derive(Default)]
struct Verification {
    total: Tally,
    failed: Vec<String>,
    steps: Vec<(String, Duration)>,
}

impl Verification {
    fn step(&mut self, name: &'static str, work: impl FnOnce() -> Result<Tally>) {
        trueup_output::diagnostic(format_args!("\n=== {name}"));
        let started = Instant::now();
        let tally = work().unwrap_or_else(|error| {
            trueup_output::diagnostic(format_args!("error: {error:#}"));
            self.failed.push(format!("{name}: {error:#}"));
            Tally::fail()
        });
        self.failed.extend(tally.failures.iter().map(|failure| format!("{name}: {failure}")));
        self.total.add(tally);
        self.steps.push((name.into(), started.elapsed()));
    }
}

/// Runs a tier.
///
/// # Errors
/// Something failed; what it was stands in the output above.
pub fn run(tier: Tier) -> Result<()> {
    let started = Instant::now();
    let mut checks = Verification::default();
    let mut programs = Vec::new();
    checks.step("compiler", supply_chain::compiler);
    if tier != Tier::Long {
        quick_checks(&mut checks);
    }
    checks.step("build of the tests", || {
        programs = test_run::build()?;
        Ok(Tally::passed(1))
    });
    if tier != Tier::Long {
        checks.step("tests", || test_run::run(&programs, &[], &[]));
        checks.step("examples in the documentation", test_run::documentation);
    }
    if tier != Tier::Quick {
        long_checks(&mut checks, &programs);
    }
    if tier == Tier::All {
        // They have run, in the second place.
        checks.total.long = 0;
    }
    report(&checks, tier, started.elapsed());
    if checks.total.failed > 0 {
        bail!("not everything passed");
    }
    Ok(())
}

fn quick_checks(checks: &mut Verification) {
    checks.step("set-up", || setup::quick().map(|()| Tally::default()));
    checks.step("structure", || {
        trueup_output::line(structure::check(&setup::root())?.trim_end());
        Ok(Tally::passed(1))
    });
    checks.step("format", || check(cargo::plain("fmt").args(["--all", "--check"])));
    checks.step("clippy, host", || {
        let every = ["--all-targets", "--all-features", "--", "-D", "warnings"];
        check(cargo::locked("clippy").args(every))
    });
    checks.step("clippy, boards, boot program and benchmark", || {
        let mut tally = Tally::default();
        for board in Board::ALL {
            let (mut clippy, _) = firmware::cargo("clippy", board)?;
            tally.add(check(clippy.args(["--", "-D", "warnings"]))?);
        }
        let (mut clippy, _) = firmware::cargo_measure("clippy")?;
        tally.add(check(clippy.args(["--", "-D", "warnings"]))?);
        for mut clippy in slots::cargo("clippy")? {
            tally.add(check(clippy.args(["--", "-D", "warnings"]))?);
        }
        Ok(tally)
    });
    checks.step("model of the chip", || {
        if !chip::is_supported()? {
            let (major, minor) = chip::OLDEST;
            return Ok(Tally::lack(&format!(
                "the model of the chip: it needs Rust {major}.{minor}"
            )));
        }
        check(chip::cargo("fmt").arg("--check"))?;
        check(chip::cargo("clippy").args(["--locked", "--all-targets", "--", "-D", "warnings"]))?;
        test_run::receive("chip", chip::cargo("test").arg("--locked"))
    });
    checks.step("images", || {
        trueup_output::line(size::report()?.trim_end());
        Ok(Tally::passed(2))
    });
}

fn long_checks(checks: &mut Verification, programs: &[Program]) {
    checks.step("set-up for the long tests", || setup::everything().map(|()| Tally::default()));
    checks
        .step("long tests", || test_run::run(programs, &["--ignored", "--skip", "campaign_"], &[]));
    checks.step("documentation", || {
        let mut doc = cargo::locked("doc");
        check(doc.args(["--no-deps", "--all-features"]).env("RUSTDOCFLAGS", "-D warnings"))
    });
    checks.step("the board by the distribution's compiler", || {
        if process::find("apt-get").is_none() {
            return Ok(Tally::lack("this distribution has no such compiler"));
        }
        let board: Vec<_> = programs
            .iter()
            .filter(|program| program.name.ends_with("/virtual_board"))
            .cloned()
            .collect();
        test_run::run(&board, &["to_the_bit"], &[(TOOLCHAIN_VARIABLE, "distribution")])
    });
    checks.step("LinuxCNC in the loop", || {
        // Without a real-time kernel LinuxCNC starves on a busy computer, and the run is worth nothing.
        let mut looped = linuxcnc::run_and_publish(Way::default());
        for _ in 1..LINUXCNC_RUNS {
            let Err(error) = &looped else { break };
            trueup_output::diagnostic(format_args!("error: {error:#}; trying again"));
            looped = linuxcnc::run_and_publish(Way::default());
        }
        Ok(match looped? {
            Some(passed) => Tally::passed(passed),
            None => Tally::lack("this distribution has no package of LinuxCNC"),
        })
    });
    checks.step("crates of others", supply_chain::crates);
}

/// Runs a command that passes or fails as a whole.
fn check(command: &mut std::process::Command) -> Result<Tally> {
    process::run(command)?;
    Ok(Tally::passed(1))
}

fn report(checks: &Verification, tier: Tier, took: Duration) {
    let total = &checks.total;
    let mut times = [checks.steps.clone(), total.times.clone()].concat();
    times.sort_by_key(|(_, time)| std::cmp::Reverse(*time));
    trueup_output::line(format_args!("\nthe {LONGEST} longest, steps and tests:"));
    for (name, time) in times.iter().take(LONGEST) {
        trueup_output::line(format_args!("{:7.1} s  {name}", time.as_secs_f64()));
    }
    if tier == Tier::Quick {
        for (name, time) in total.times.iter().filter(|(_, time)| *time > QUICK) {
            trueup_output::line(format_args!(
                "{:7.1} s  {name}: on a quiet computer this would be a long test",
                time.as_secs_f64()
            ));
        }
    }
    trueup_output::line(format_args!("after {:.0} s", took.as_secs_f64()));
    for name in &checks.failed {
        trueup_output::line(format_args!("failed: {name}"));
    }
    trueup_output::line(format_args!(
        "skipped: {} long ones (cargo verify --long), {} campaigns (commands of their own), {} that lack \
         something here",
        total.long, total.campaigns, total.lacking
    ));
    trueup_output::line(format_args!(
        "{} passed, {} failed, {} skipped",
        total.passed,
        total.failed,
        total.skipped()
    ));
}

/// The diagnosis tried on `seeds` draws of each hidden effect, at three ratios of effect to noise.
///
/// # Errors
/// It does not build or does not run through.
pub fn scorecard(seeds: u32) -> Result<()> {
    let docs = setup::root().join("docs");
    std::fs::create_dir_all(&docs)?;
    let example = ["--release", "-p", "trueup-diagnose", "--example", "scorecard", "--"];
    let seeds = seeds.to_string();
    let draws = ["--seeds", &seeds, "--few", &seeds, "--out"];
    process::run(cargo::locked("run").args(example).args(draws).arg(docs.join("scorecard.md")))
}
