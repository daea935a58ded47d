//! Builds all test programs once, and runs them two at a time.
//!
//! Every tier takes the same programs, of one profile and with the same features, so that nothing is
//! compiled for a second tier. A program runs its tests one after the other: so the time between two
//! results is that of the second test.

use std::{
    io::{BufRead as _, BufReader},
    path::PathBuf,
    process::{Command, Stdio},
    sync::Mutex,
    time::Instant,
};

use anyhow::{Context as _, Result, bail};
use serde_json::Value;

use crate::{cargo, tally::Tally};

/// What chooses the programs: everything of the default members, emulated board included.
const SELECTION: [&str; 2] = ["--features", "trueup-host-tests/emulator"];
/// How many run at a time.
const AT_A_TIME: usize = 2;

/// A test program.
#[derive(Clone, Debug)]
pub struct Program {
    /// The package and the name of the test, for people.
    pub name: String,
    /// The compiled program.
    executable: PathBuf,
    /// The folder of its package, where cargo runs it too.
    folder: PathBuf,
}

/// Builds all of them.
pub fn build() -> Result<Vec<Program>> {
    let mut command = cargo::locked("test");
    command.args(["--no-run", "--lib", "--bins", "--tests"]).args(SELECTION);
    command.args(["--message-format", "json-render-diagnostics"]);
    let output = command.stdin(Stdio::null()).stderr(Stdio::inherit()).output()?;
    if !output.status.success() {
        bail!("the tests do not compile");
    }
    let messages = String::from_utf8(output.stdout)?;
    let programs = messages.lines().filter_map(|line| {
        let message: Value = serde_json::from_str(line).ok()?;
        let executable = message["executable"].as_str().map(PathBuf::from)?;
        let is_test = message["profile"]["test"].as_bool()?;
        let manifest = PathBuf::from(message["manifest_path"].as_str()?);
        let folder = manifest.parent()?.to_owned();
        let target = message["target"]["name"].as_str()?;
        let package = folder.file_name()?.to_string_lossy().into_owned();
        let name = format!("{package}/{target}");
        is_test.then_some(Program { name, executable, folder })
    });
    Ok(programs.collect())
}

/// The examples in the documentation.
pub fn documentation() -> Result<Tally> {
    let mut command = cargo::locked("test");
    command.arg("--doc").args(SELECTION);
    hear("documentation", &mut command, &mut |line| println!("{line}"))
}

/// Runs programs, each with the given arguments and environment. What one prints comes in one piece.
pub fn run(programs: &[Program], arguments: &[&str], variables: &[(&str, &str)]) -> Result<Tally> {
    let open = Mutex::new(programs.iter());
    let total = Mutex::new(Tally::default());
    std::thread::scope(|scope| {
        let work = || -> Result<()> {
            loop {
                let next = open.lock().expect("no worker panics").next();
                let Some(program) = next else { return Ok(()) };
                let (tally, said) = run_one(program, arguments, variables)?;
                let mut total = total.lock().expect("no worker panics");
                println!("\n--- {}\n{said}", program.name);
                total.add(tally);
            }
        };
        let workers: Vec<_> = (0..AT_A_TIME).map(|_| scope.spawn(work)).collect();
        workers.into_iter().try_for_each(|worker| worker.join().expect("no worker panics"))
    })?;
    Ok(total.into_inner().expect("no worker panics"))
}

fn run_one(
    program: &Program,
    arguments: &[&str],
    variables: &[(&str, &str)],
) -> Result<(Tally, String)> {
    let mut command = Command::new(&program.executable);
    command.current_dir(&program.folder).env("CARGO_MANIFEST_DIR", &program.folder);
    command.args(["--test-threads=1", "--show-output"]).args(arguments);
    command.envs(variables.iter().copied());
    let mut said = String::new();
    let tally = hear(&program.name, &mut command, &mut |line| {
        said.push_str(line);
        said.push('\n');
    })?;
    Ok((tally, said))
}

/// Runs a command and counts by what it prints, which also goes to `say`.
///
/// # Errors
/// It cannot be started.
pub fn hear(name: &str, command: &mut Command, say: &mut dyn FnMut(&str)) -> Result<Tally> {
    command.stdin(Stdio::null()).stdout(Stdio::piped());
    let mut child = command.spawn().with_context(|| format!("cannot start {name}"))?;
    let output = child.stdout.take().context("the output was asked for")?;
    let mut tally = Tally::default();
    let mut last = Instant::now();
    for line in BufReader::new(output).split(b'\n') {
        let line = line?;
        let line = String::from_utf8_lossy(&line);
        say(&line);
        if tally.hear(name, &line, last.elapsed()) {
            last = Instant::now();
        }
    }
    // A program that dies, or does not even compile, prints no failure.
    if !child.wait()?.success() && tally.failed == 0 {
        say(&format!("{name} ended before its tests had"));
        tally.failed = 1;
    }
    Ok(tally)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_dies_has_failed_whatever_it_said() -> Result<()> {
        let mut said = String::new();
        let mut say = |line: &str| said.push_str(line);
        let mut command = Command::new("sh");
        command.args(["-c", "echo 'test a ... ok'; exit 101"]);
        let tally = hear("x", &mut command, &mut say)?;
        assert_eq!((tally.failed, tally.times.len()), (1, 1));
        assert!(said.contains("ended before"), "{said}");
        Ok(())
    }
}
