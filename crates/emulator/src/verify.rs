//! Every test of the project in one go: nothing stops at the first failure, the last line counts.
//!
//! A test that cannot run where it is, for want of data say, prints a line that starts with
//! `skipped:`; such tests are counted apart, so that nobody takes them for passed.

use std::{
    io::{BufRead as _, BufReader},
    process::{Command, Stdio},
    time::Instant,
};

use anyhow::{Context as _, Result, bail};

use crate::{
    firmware::{self, Board},
    linuxcnc, process,
    setup::{self, TOOLCHAIN_VARIABLE},
    size,
};

/// What came of the tests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Count {
    passed: u32,
    failed: u32,
    skipped: u32,
    /// Skipped tests of which the result line has not come yet.
    announced: u32,
}

impl Count {
    fn add(&mut self, other: Self) {
        self.passed += other.passed;
        self.failed += other.failed;
        self.skipped += other.skipped;
    }

    /// Takes a line that a test run printed.
    fn hear(&mut self, line: &str) {
        if line.starts_with("skipped:") {
            self.skipped += 1;
            // The test itself is in the passed ones of the result that follows.
            self.announced += 1;
        }
        let Some(result) = line.strip_prefix("test result: ") else { return };
        let number = |word: &str| -> u32 {
            let before = result.split(word).next().unwrap_or_default();
            before.split_whitespace().last().and_then(|n| n.parse().ok()).unwrap_or(0)
        };
        self.passed += number(" passed").saturating_sub(std::mem::take(&mut self.announced));
        self.failed += number(" failed");
        self.skipped += number(" ignored");
    }
}

/// Runs everything.
///
/// # Errors
/// Something failed; what it was stands in the output above.
pub fn run() -> Result<()> {
    let started = Instant::now();
    let mut total = Count::default();
    let mut failed = Vec::new();
    let mut step = |name: &str, work: &mut dyn FnMut() -> Result<Count>| {
        eprintln!("\n=== {name}");
        let count = work().unwrap_or_else(|error| {
            eprintln!("error: {error:#}");
            Count { failed: 1, ..Count::default() }
        });
        if count.failed > 0 {
            failed.push(name.to_owned());
        }
        total.add(count);
    };

    step("set-up", &mut || setup::everything().map(|()| Count::default()));
    step("format", &mut || check(cargo("fmt").args(["--all", "--check"])));
    step("clippy, host", &mut || {
        check(cargo("clippy").args(["--all-targets", "--all-features", "--", "-D", "warnings"]))
    });
    for board in Board::ALL {
        step(&format!("clippy, {}", board.feature()), &mut || {
            let (mut clippy, _) = firmware::cargo("clippy", board)?;
            check(clippy.args(["--", "-D", "warnings"]))
        });
    }
    step("clippy, benchmark", &mut || {
        let (mut clippy, _) = firmware::cargo_measure("clippy")?;
        check(clippy.args(["--", "-D", "warnings"]))
    });
    step("documentation", &mut || {
        check(cargo("doc").args(["--no-deps", "--all-features"]).env("RUSTDOCFLAGS", "-D warnings"))
    });
    step("images", &mut || {
        print!("{}", size::report()?);
        Ok(Count { passed: 2, ..Count::default() })
    });
    step("tests: host, emulated board, real clients", &mut || {
        let all = ["--all-features", "--no-fail-fast", "--", "--show-output", "--test-threads=2"];
        tests(cargo("test").args(all))
    });
    step("the board again, by the distribution's compiler", &mut || {
        if process::find("apt-get").is_none() {
            println!("skipped: this distribution has no such compiler");
            return Ok(Count { skipped: 1, ..Count::default() });
        }
        let emulated = ["--package", "trueup-host-tests", "--features", "emulator"];
        let one = ["--test", "virtual_board", "to_the_bit", "--", "--show-output"];
        tests(cargo("test").args(emulated).args(one).env(TOOLCHAIN_VARIABLE, "distribution"))
    });

    step("LinuxCNC in the loop", &mut || {
        // Without a real-time kernel LinuxCNC starves on a busy computer, and the run is worth nothing.
        let first = linuxcnc::run_and_publish();
        if let Err(error) = &first {
            eprintln!("error: {error:#}; once more");
        }
        Ok(match first.or_else(|_| linuxcnc::run_and_publish())? {
            Some(passed) => Count { passed, ..Count::default() },
            None => Count { skipped: 1, ..Count::default() },
        })
    });

    eprintln!("\nafter {:.0} s", started.elapsed().as_secs_f64());
    for name in &failed {
        eprintln!("failed: {name}");
    }
    println!("{} passed, {} failed, {} skipped", total.passed, total.failed, total.skipped);
    if total.failed > 0 {
        bail!("not everything passed");
    }
    Ok(())
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
    process::run(cargo("run").args(example).args(draws).arg(docs.join("scorecard.md")))?;
    Ok(())
}

fn cargo(verb: &str) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()));
    command.arg(verb).current_dir(setup::root());
    command
}

/// A command that passes or fails as a whole.
fn check(command: &mut Command) -> Result<Count> {
    process::run(command)?;
    Ok(Count { passed: 1, ..Count::default() })
}

/// A test run, counted by what it prints.
fn tests(command: &mut Command) -> Result<Count> {
    let line = process::line(command);
    let mut child = command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .with_context(|| format!("cannot start `{line}`"))?;
    let mut count = Count::default();
    let output = child.stdout.take().context("the output was asked for")?;
    for line in BufReader::new(output).lines() {
        let line = line?;
        println!("{line}");
        count.hear(&line);
    }
    let status = child.wait()?;
    // A run that does not even compile fails no test.
    if !status.success() && count.failed == 0 {
        count.failed = 1;
    }
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_skipped_test_is_not_a_passed_one() {
        let mut count = Count::default();
        let lines = [
            "running 4 tests",
            "skipped: no shared data",
            "test result: ok. 4 passed; 0 failed; 0 ignored; 0 measured; 0 filtered out",
            "test result: FAILED. 10 passed; 2 failed; 1 ignored; 0 measured; 0 filtered out",
        ];
        lines.iter().for_each(|line| count.hear(line));
        assert_eq!(count, Count { passed: 13, failed: 2, skipped: 2, announced: 0 });
    }
}
