//! Builds all test programs once, and runs them three at a time: those that only compute give way to those that wait for a
//! clock, for LinuxCNC or for a board.
//!
//! Every tier takes the same programs, of one profile and with the same features, so that nothing is
//! compiled for a second tier. A program runs its tests one after the other: so the time between two
//! results is that of the second test.
//!
//! The output of a program, figures of tests that pass included, goes into a file of its own in
//! `target/verify`. Here stands a line for each program, and whole the output of the tests that failed.
//!
//! `cargo-nextest` does the same, and more, but is a program of its own: on a machine that has nothing it would first have
//! to be compiled, and `cargo verify` would grow by that.

use std::{
    fs,
    io::{BufRead as _, BufReader},
    path::PathBuf,
    process::{Command, Stdio},
    sync::Mutex,
    time::Instant,
};

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::Value;
use trueup_emulator::{process, setup};

use crate::{cargo, test_results::TestResults};

/// Cargo's arguments that choose the programs: everything of the default members, emulated board included.
const CARGO_FEATURE_ARGUMENTS: [&str; 2] = ["--features", "trueup-host-tests/emulator"];
/// One LinuxCNC runs at a time, and it mostly waits for its axes: one worker takes the programs that start it, with this in
/// their names, so that the others do not stand behind it.
const LINUXCNC_NAME_SUBSTRING: &str = "linuxcnc";
/// The folders of crates whose tests wait for no clock and for no other program.
const COMPUTING_FOLDERS: [&str; 3] = ["crates/analysis", "crates/board", "crates/bench/campaigns"];
/// How many of the last lines are printed of a program that ended before its tests had.
const MAX_TAIL_LINES: usize = 50;

/// A test program.
#[derive(Clone, Debug)]
pub struct TestProgram {
    /// The package and the name of the test, for people.
    pub name: String,
    /// The compiled program.
    executable: PathBuf,
    /// The folder of its package, where cargo runs it too.
    folder: PathBuf,
}

/// The resource that a program mainly needs. One program of each kind runs at a time, until a kind has no more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ProgramKind {
    LinuxCnc,
    Computing,
    Other,
}

impl ProgramKind {
    const ALL: [Self; 3] = [Self::LinuxCnc, Self::Computing, Self::Other];
}

impl TestProgram {
    fn kind(&self) -> ProgramKind {
        let is_in = |folder: &&str| self.folder.starts_with(setup::project_root().join(folder));
        if self.name.contains(LINUXCNC_NAME_SUBSTRING) {
            ProgramKind::LinuxCnc
        } else if COMPUTING_FOLDERS.iter().any(is_in) {
            ProgramKind::Computing
        } else {
            ProgramKind::Other
        }
    }

    /// Returns the command that starts it; it gets what the others leave of the processors if it only computes.
    fn command(&self) -> Command {
        if self.kind() != ProgramKind::Computing || process::find_on_path("nice").is_none() {
            return Command::new(&self.executable);
        }
        let mut command = Command::new("nice");
        command.args(["-n", "19"]).arg(&self.executable);
        command
    }
}

/// Builds all of them.
pub(crate) fn build_test_programs() -> Result<Vec<TestProgram>> {
    let mut command = cargo::locked_cargo_command("test");
    command.args(["--no-run", "--lib", "--bins", "--tests"]).args(CARGO_FEATURE_ARGUMENTS);
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
        is_test.then_some(TestProgram { name, executable, folder })
    });
    let programs = programs.collect();
    build_host_tool()?;
    Ok(programs)
}

/// Builds the tool as tests do that start it: all of it is there already, or a crate of others has other features
/// there.
fn build_host_tool() -> Result<()> {
    let mut command = cargo::locked_cargo_command("build");
    command.args(["--bin", "trueup", "--message-format", "json"]).args(CARGO_FEATURE_ARGUMENTS);
    let messages = process::capture_stdout(&mut command)?;
    let again = parse_compiled_crates(&messages);
    ensure!(
        again.is_empty(),
        "compiled twice, for the tests and for the tool: {}; a dev-dependency chooses other features than `cargo build`. \
         Name it in host-tests/Cargo.toml too (cargo tree -e features)",
        again.join(", ")
    );
    Ok(())
}

/// Returns the names of what cargo compiled, by its messages.
fn parse_compiled_crates(messages: &str) -> Vec<String> {
    let name = |line: &str| {
        let message: Value = serde_json::from_str(line).ok()?;
        (message["fresh"].as_bool() == Some(false))
            .then(|| message["target"]["name"].as_str().unwrap_or_default().to_string())
    };
    messages.lines().filter_map(name).collect()
}

/// Returns the examples in the documentation.
///
/// # Errors
/// cargo cannot be started.
pub(crate) fn run_doc_tests() -> Result<TestResults> {
    let mut command = cargo::locked_cargo_command("test");
    command.arg("--doc").args(CARGO_FEATURE_ARGUMENTS);
    run_test_command("documentation", &mut command)
}

/// Runs programs, each with the given arguments and environment.
///
/// # Errors
/// One cannot be started.
pub fn run(
    programs: &[TestProgram],
    arguments: &[&str],
    variables: &[(&str, &str)],
) -> Result<TestResults> {
    let open = Mutex::new(programs.iter().collect::<Vec<_>>());
    let total = Mutex::new(TestResults::default());
    std::thread::scope(|scope| {
        let (open, total) = (&open, &total);
        let work = move |kind: ProgramKind| -> Result<()> {
            loop {
                let next = take_next_program(&mut open.lock().expect("no worker panics"), kind);
                let Some(program) = next else { return Ok(()) };
                let tally = run_test_program(program, arguments, variables)?;
                total.lock().expect("no worker panics").merge(tally);
            }
        };
        let workers = ProgramKind::ALL.map(|kind| scope.spawn(move || work(kind)));
        workers.into_iter().try_for_each(|worker| worker.join().expect("no worker panics"))
    })?;
    Ok(total.into_inner().expect("no worker panics"))
}

/// Takes the next of the programs for the worker of a kind. A second one that waits for something runs next to the first one
/// when LinuxCNC has done its own, no third one: they would starve each other.
fn take_next_program<'a>(
    open: &mut Vec<&'a TestProgram>,
    worker: ProgramKind,
) -> Option<&'a TestProgram> {
    let order: &[ProgramKind] = match worker {
        ProgramKind::LinuxCnc => &[worker, ProgramKind::Other, ProgramKind::Computing],
        ProgramKind::Other => &[worker, ProgramKind::LinuxCnc, ProgramKind::Computing],
        ProgramKind::Computing => &[worker],
    };
    let first_of = |kind: &ProgramKind| open.iter().position(|program| program.kind() == *kind);
    let place = order.iter().find_map(first_of)?;
    Some(open.remove(place))
}

fn run_test_program(
    program: &TestProgram,
    arguments: &[&str],
    variables: &[(&str, &str)],
) -> Result<TestResults> {
    let mut command = program.command();
    command.current_dir(&program.folder).env("CARGO_MANIFEST_DIR", &program.folder);
    command.args(["--test-threads=1", "--show-output"]).args(arguments);
    command.envs(variables.iter().copied());
    run_test_command(&program.name, &mut command)
}

/// Runs a command that tests, counts by what it prints, and says in a line what came of it.
///
/// # Errors
/// It cannot be started, or what it says cannot be kept.
pub(crate) fn run_test_command(name: &str, command: &mut Command) -> Result<TestResults> {
    let started = Instant::now();
    let (tally, output_text) = run_and_tally_command(name, command)?;
    let folder = setup::project_root().join("target/verify");
    fs::create_dir_all(&folder)?;
    let file = folder.join(format!("{}.txt", name.replace('/', "-")));
    fs::write(&file, &output_text).with_context(|| format!("cannot write {}", file.display()))?;
    if tally.passed + tally.failed + tally.lacking == 0 {
        // None of its tests is of this tier.
        return Ok(tally);
    }
    let took = started.elapsed().as_secs_f64();
    let mut piece = format!("{took:7.1} s  {name}: {} passed", tally.passed);
    if tally.failed > 0 {
        piece += &format!(", {} FAILED\n{}", tally.failed, extract_failure_output(&output_text));
    }
    for line in output_text.lines().filter(|line| line.starts_with("skipped:")) {
        piece += &format!("\n           {line}");
    }
    // In one piece: several programs run at a time.
    trueup_output::write_line_best_effort(piece);
    Ok(tally)
}

/// Returns what a program of tests printed of those that failed, or its last lines if it did not come to that.
fn extract_failure_output(text: &str) -> String {
    if let Some(start) = text.find("\nfailures:\n") {
        return text[start..].into();
    }
    let lines: Vec<_> = text.lines().collect();
    lines[lines.len().saturating_sub(MAX_TAIL_LINES)..].join("\n")
}

fn run_and_tally_command(name: &str, command: &mut Command) -> Result<(TestResults, String)> {
    command.stdin(Stdio::null()).stdout(Stdio::piped());
    let mut child = command.spawn().with_context(|| format!("cannot start {name}"))?;
    let output = child.stdout.take().context("the output was asked for")?;
    let mut tally = TestResults::default();
    let mut text = String::new();
    let mut last = Instant::now();
    for line in BufReader::new(output).split(b'\n') {
        let line = line?;
        let line = String::from_utf8_lossy(&line);
        text.push_str(&line);
        text.push('\n');
        if tally.count_result_line(name, &line, last.elapsed()) {
            last = Instant::now();
        }
    }
    // A program that dies, or does not even compile, prints no failure.
    if !child.wait()?.success() && tally.failed == 0 {
        let ended = format!("{name} ended before its tests had");
        text.push_str(&ended);
        tally.failed = 1;
        tally.failures.push(ended);
    }
    Ok((tally, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_dies_has_failed_whatever_it_printed() -> Result<()> {
        let mut command = Command::new("sh");
        command.args(["-c", "echo 'test a ... ok'; exit 101"]);
        let (tally, output_text) = run_and_tally_command("x", &mut command)?;
        assert_eq!((tally.failed, tally.times.len()), (1, 1));
        assert_eq!(tally.failures, ["x ended before its tests had"]);
        assert!(extract_failure_output(&output_text).contains("ended before"), "{output_text}");
        Ok(())
    }

    #[test]
    fn each_worker_takes_its_kind_and_no_third_one_that_waits_runs() {
        let program = |folder: &str, name: &str| TestProgram {
            name: name.into(),
            executable: PathBuf::from("/bin/x"),
            folder: setup::project_root().join(folder),
        };
        let programs = [
            program("crates/analysis/fit", "fit/fit"),
            program("crates/board/node", "node/faults"),
            program("host-tests", "x/linuxcnc_joint"),
            program("host-tests", "x/chip"),
            program("host-tests", "x/programs_linuxcnc"),
        ];
        let mut open: Vec<_> = programs.iter().collect();
        use ProgramKind::{Computing, LinuxCnc, Other};
        let workers = [LinuxCnc, Computing, Other, Computing, Computing, LinuxCnc, LinuxCnc];
        let taken = workers.map(|worker| {
            take_next_program(&mut open, worker).map(|program| program.name.as_str())
        });
        let own = ["x/linuxcnc_joint", "fit/fit", "x/chip", "node/faults"].map(Some);
        assert_eq!(taken[..4], own);
        assert_eq!(taken[4..], [None, Some("x/programs_linuxcnc"), None]);
        assert_eq!(programs[0].command().get_program(), "nice");
        assert_eq!(programs[3].command().get_program(), "/bin/x");
    }

    #[test]
    fn what_is_compiled_again_is_named() {
        let messages = "{\"reason\":\"compiler-artifact\",\"fresh\":true,\"target\":{\"name\":\"a\"}}\n\
                        {\"reason\":\"compiler-artifact\",\"fresh\":false,\"target\":{\"name\":\"b\"}}\n\
                        {\"reason\":\"build-finished\",\"success\":true}\n";
        assert_eq!(parse_compiled_crates(messages), ["b"]);
    }

    #[test]
    fn the_output_of_the_failed_is_printed_without_the_rest() {
        let message = "test a ... ok\ntest b ... FAILED\n\nsuccesses:\n\n---- a stdout ----\nfine\n\n\
                    failures:\n\n---- b stdout ----\nassertion failed\n";
        let printed = extract_failure_output(message);
        assert!(printed.contains("assertion failed") && !printed.contains("fine"), "{printed}");
    }
}
