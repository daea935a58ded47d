//! Every check of the project, in two tiers: nothing stops at the first failure, the last line counts.
//!
//! * Quick, `cargo verify`: every kind of check, each test that takes less than ten seconds.
//! * Long, `cargo verify --long`: what the quick tier leaves out, namely tests that say so
//!   (`#[ignore = "long: …"]`), the real LinuxCNC, the distribution's compiler, the documentation, the
//!   crates that the project is built from.
//!
//! `cargo verify --all` is both. Longer campaigns (`#[ignore = "campaign: …"]`, named `campaign_…`) are
//! in neither; their texts have their commands.

use std::{
    process::Command,
    time::{Duration, Instant},
};

use anyhow::{Result, bail};
use trueup_emulator::{
    chip,
    firmware_images::{self, Board},
    linuxcnc::{self, CompensationRoute},
    memory_usage, process,
    setup::{self, TOOLCHAIN_ENV_VAR},
    slot_images,
};

use crate::{
    api_docs, cargo, structure, supply_chain,
    test_results::TestResults,
    test_run::{self, TestProgram},
};

/// The tier to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TestTier {
    /// All tests that take at most ten seconds each: `cargo verify`.
    Quick,
    /// The tests that the quick tier leaves out: `--long`.
    Long,
    /// Both tiers: `--all`.
    All,
}

/// How long a test of the quick tier may take.
const MAX_QUICK_TEST_DURATION: Duration = Duration::from_secs(10);
/// How often LinuxCNC runs at the most.
const MAX_LINUXCNC_RUNS: u32 = 3;
/// How many of the longest are printed.
const MAX_REPORTED_TIMES: usize = 10;

/// The steps that were run so far, and their results.
#[derive(Default)]
struct Verification {
    total: TestResults,
    failed: Vec<String>,
    steps: Vec<(String, Duration)>,
}

impl Verification {
    fn run_step(&mut self, name: &'static str, work: impl FnOnce() -> Result<TestResults>) {
        trueup_output::write_diagnostic(format_args!("\n=== {name}"));
        let started = Instant::now();
        let tally = work().unwrap_or_else(|error| {
            trueup_output::write_diagnostic(format_args!("error: {error:#}"));
            self.failed.push(format!("{name}: {error:#}"));
            TestResults::with_one_failure()
        });
        self.failed.extend(tally.failures.iter().map(|failure| format!("{name}: {failure}")));
        self.total.merge(tally);
        self.steps.push((name.into(), started.elapsed()));
    }
}

/// Runs a tier.
///
/// # Errors
/// Something failed; what it was stands in the output above.
pub fn run(tier: TestTier) -> Result<()> {
    let started = Instant::now();
    let mut checks = Verification::default();
    let mut programs = Vec::new();
    checks.run_step("compiler", supply_chain::check_compiler_version);
    if tier != TestTier::Long {
        run_quick_checks(&mut checks);
    }
    checks.run_step("build of the tests", || {
        programs = test_run::build_test_programs()?;
        Ok(TestResults::with_passed(1))
    });
    if tier != TestTier::Long {
        checks.run_step("tests", || test_run::run(&programs, &[], &[]));
        checks.run_step("examples in the documentation", test_run::run_doc_tests);
    }
    if tier != TestTier::Quick {
        run_long_checks(&mut checks, &programs);
    }
    if tier == TestTier::All {
        // They have run, in the second place.
        checks.total.long = 0;
    }
    print_report(&checks, tier, started.elapsed());
    if checks.total.failed > 0 {
        bail!("not everything passed");
    }
    Ok(())
}

fn run_quick_checks(checks: &mut Verification) {
    checks.run_step("set-up", || {
        setup::install_quick_test_dependencies().map(|()| TestResults::default())
    });
    checks.run_step("structure", || {
        trueup_output::write_line_best_effort(
            structure::check_structure(&setup::project_root())?.trim_end(),
        );
        Ok(TestResults::with_passed(1))
    });
    checks.run_step("spelling", check_spelling);
    checks.run_step("format", || {
        run_check_command(cargo::cargo_command("fmt").args(["--all", "--check"]))
    });
    checks.run_step("clippy, host", || {
        let every = ["--all-targets", "--all-features", "--", "-D", "warnings"];
        run_check_command(cargo::locked_cargo_command("clippy").args(every))
    });
    checks.run_step("clippy, boards, boot program and benchmark", || {
        let mut tally = TestResults::default();
        for board in Board::ALL {
            let (mut clippy, _) = firmware_images::board_cargo_command("clippy", board)?;
            tally.merge(run_check_command(clippy.args(["--", "-D", "warnings"]))?);
        }
        let (mut clippy, _) = firmware_images::benchmark_cargo_command("clippy")?;
        tally.merge(run_check_command(clippy.args(["--", "-D", "warnings"]))?);
        for mut clippy in slot_images::cargo_commands("clippy")? {
            tally.merge(run_check_command(clippy.args(["--", "-D", "warnings"]))?);
        }
        Ok(tally)
    });
    checks.run_step("model of the chip", || {
        if !chip::is_compiler_supported()? {
            let (major, minor) = chip::MIN_COMPILER_VERSION;
            return Ok(TestResults::report_unavailable(&format!(
                "the model of the chip: it needs Rust {major}.{minor}"
            )));
        }
        run_check_command(chip::model_cargo_command("fmt").arg("--check"))?;
        run_check_command(chip::model_cargo_command("clippy").args([
            "--locked",
            "--all-targets",
            "--",
            "-D",
            "warnings",
        ]))?;
        test_run::run_test_command("chip", chip::model_cargo_command("test").arg("--locked"))
    });
    checks.run_step("images", || {
        trueup_output::write_line_best_effort(memory_usage::build_size_report()?.trim_end());
        Ok(TestResults::with_passed(2))
    });
}

fn run_long_checks(checks: &mut Verification, programs: &[TestProgram]) {
    checks.run_step("set-up for the long tests", || {
        setup::install_all_dependencies().map(|()| TestResults::default())
    });
    checks.run_step("long tests", || {
        test_run::run(programs, &["--ignored", "--skip", "campaign_"], &[])
    });
    checks.run_step("documentation", || {
        api_docs::build_api_docs(true).map(|_| TestResults::with_passed(1))
    });
    checks.run_step("the board by the distribution's compiler", || {
        if process::find_on_path("apt-get").is_none() {
            return Ok(TestResults::report_unavailable("this distribution has no such compiler"));
        }
        let board: Vec<_> = programs
            .iter()
            .filter(|program| program.name.ends_with("/virtual_board"))
            .cloned()
            .collect();
        test_run::run(&board, &["to_the_bit"], &[(TOOLCHAIN_ENV_VAR, "distribution")])
    });
    checks.run_step("LinuxCNC in the loop", || {
        // Without a real-time kernel LinuxCNC starves on a busy computer, and the run is worth nothing.
        let mut looped = linuxcnc::run_loop_and_write_report(CompensationRoute::default());
        for _ in 1..MAX_LINUXCNC_RUNS {
            let Err(error) = &looped else { break };
            trueup_output::write_diagnostic(format_args!("error: {error:#}; trying again"));
            looped = linuxcnc::run_loop_and_write_report(CompensationRoute::default());
        }
        Ok(match looped? {
            Some(passed) => TestResults::with_passed(passed),
            None => TestResults::report_unavailable("this distribution has no package of LinuxCNC"),
        })
    });
    checks.run_step("crates of others", supply_chain::check_dependencies);
}

/// Checks the spelling of all files, and the words that `_typos.toml` replaces.
fn check_spelling() -> Result<TestResults> {
    run_check_command(typos_command()?.arg("."))
}

fn typos_command() -> Result<Command> {
    let mut typos = Command::new(setup::ensure_python()?.with_file_name("typos"));
    typos.args(["--config", "_typos.toml", "--format", "brief"]).current_dir(setup::project_root());
    Ok(typos)
}

/// Runs a command that passes or fails as a whole.
fn run_check_command(command: &mut Command) -> Result<TestResults> {
    process::run(command)?;
    Ok(TestResults::with_passed(1))
}

fn print_report(checks: &Verification, tier: TestTier, took: Duration) {
    let total = &checks.total;
    let mut times = [checks.steps.clone(), total.times.clone()].concat();
    times.sort_by_key(|(_, time)| std::cmp::Reverse(*time));
    trueup_output::write_line_best_effort(format_args!(
        "\nthe {MAX_REPORTED_TIMES} longest, steps and tests:"
    ));
    for (name, time) in times.iter().take(MAX_REPORTED_TIMES) {
        trueup_output::write_line_best_effort(format_args!("{:7.1} s  {name}", time.as_secs_f64()));
    }
    if tier == TestTier::Quick {
        for (name, time) in total.times.iter().filter(|(_, time)| *time > MAX_QUICK_TEST_DURATION) {
            trueup_output::write_line_best_effort(format_args!(
                "{:7.1} s  {name}: on a quiet computer this would be a long test",
                time.as_secs_f64()
            ));
        }
    }
    trueup_output::write_line_best_effort(format_args!("after {:.0} s", took.as_secs_f64()));
    for name in &checks.failed {
        trueup_output::write_line_best_effort(format_args!("failed: {name}"));
    }
    trueup_output::write_line_best_effort(format_args!(
        "skipped: {} long ones (cargo verify --long), {} campaigns (commands of their own), {} that lack \
         something here",
        total.long, total.campaigns, total.lacking
    ));
    trueup_output::write_line_best_effort(format_args!(
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
pub fn run_scorecard(seeds: u32) -> Result<()> {
    let docs = setup::project_root().join("docs");
    std::fs::create_dir_all(&docs)?;
    let example = ["--release", "-p", "trueup-campaigns", "--example", "scorecard", "--"];
    let seeds = seeds.to_string();
    let draws = ["--seeds", &seeds, "--few", &seeds, "--out"];
    process::run(
        cargo::locked_cargo_command("run").args(example).args(draws).arg(docs.join("scorecard.md")),
    )
}

#[cfg(test)]
mod tests {
    use std::{io::Write as _, process::Stdio};

    use super::*;

    fn has_right_spelling(text: &str) -> bool {
        let mut typos = typos_command().expect("it is installed");
        let typos = typos.arg("-").stdin(Stdio::piped()).stdout(Stdio::null());
        let mut typos = typos.spawn().expect("it starts");
        typos.stdin.take().expect("piped").write_all(text.as_bytes()).expect("it reads");
        typos.wait().expect("it ends").success()
    }

    #[test]
    fn an_american_spelling_fails_and_a_british_one_passes() {
        assert!(has_right_spelling("the colour of a metre\n"));
        assert!(!has_right_spelling("the color of a metre\n")); // misspelt
        assert!(!has_right_spelling("let center_um = 0;\n")); // misspelt
    }
}
