//! The flashable image on the model of its chip (`crates/bench/chip`), a program of its own: its processor wants
//! a newer compiler than the project does, so it is built apart and called.

use std::{
    ffi::OsStr,
    fs::File,
    io::Read,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

use anyhow::{Context as _, Result};
use rustix::fs::{CWD, FileType, FlockOperation, Mode, flock, mknodat};

use crate::{log::LogDecoder, process, setup};

/// The oldest compiler that takes the model's processor, as its manifest says.
pub const MIN_COMPILER_VERSION: (u32, u32) = (1, 91);

/// Returns a cargo command for the model: `cargo <verb>` in its own workspace, built into `target/chip`.
#[must_use]
pub fn model_cargo_command(verb: &str) -> Command {
    let folder = setup::project_root().join("crates/bench/chip");
    let mut command = process::new_cargo_command();
    command.arg(verb).current_dir(&folder);
    command.env("CARGO_TARGET_DIR", target_folder());
    command
}

fn target_folder() -> PathBuf {
    setup::project_root().join("target/chip")
}

/// Returns whether this compiler builds the model.
///
/// # Errors
/// It does not say which it is.
pub fn is_compiler_supported() -> Result<bool> {
    let rustc = std::env::var_os("RUSTC").unwrap_or("rustc".into());
    let stdout = process::capture_stdout(Command::new(rustc).arg("--version"))?;
    let version = stdout.split_whitespace().nth(1).unwrap_or_default();
    let mut numbers = version.split('.').map_while(|number| number.parse().ok());
    Ok(numbers.next().zip(numbers.next()) >= Some(MIN_COMPILER_VERSION))
}

/// Builds the model, and gives the program; `None`: this compiler is too old for it.
///
/// # Errors
/// It does not compile.
pub fn build_model() -> Result<Option<PathBuf>> {
    if !is_compiler_supported()? {
        return Ok(None);
    }
    std::fs::create_dir_all(target_folder())?;
    let lock = File::create(target_folder().join("lock"))?;
    flock(&lock, FlockOperation::LockExclusive)?;
    process::run(model_cargo_command("build").args(["--locked", "--quiet"]))?;
    Ok(Some(target_folder().join("debug/trueup-chip")))
}

/// The result of a run of the model.
#[derive(Clone, Debug)]
pub struct ModelRunReport {
    /// Whether nothing was done that silicon would not do.
    pub clean: bool,
    /// The model's standard output: the traffic on the wires, and its report.
    pub stdout: String,
    /// The image's log, decoded.
    pub log: Vec<String>,
    /// The board's traffic on its wires and its resets, a line an event: the time in ms, then
    /// `can ID HEX`, `serial LINE` or `reset WHY`.
    pub events: Vec<String>,
}

/// Runs an image on the model to the end of the time that the options say.
///
/// # Errors
/// The model cannot be started, or refuses an option.
pub fn run<S: AsRef<OsStr>>(model: &Path, image: &Path, options: &[S]) -> Result<ModelRunReport> {
    let folder = tempfile::Builder::new().prefix("trueup-").tempdir()?;
    let raw = folder.path().join("log");
    let mut report = run_with_optional_log(model, image, options, Some(&raw))?;
    LogDecoder::from_image(image)?.decode_stream(File::open(raw)?, |line| report.log.push(line))?;
    Ok(report)
}

/// The same for an image that logs nothing.
///
/// # Errors
/// As [`run`].
pub fn run_without_log<S: AsRef<OsStr>>(
    model: &Path,
    image: &Path,
    options: &[S],
) -> Result<ModelRunReport> {
    run_with_optional_log(model, image, options, None)
}

/// Runs it; its raw log goes to that file.
fn run_with_optional_log<S: AsRef<OsStr>>(
    model: &Path,
    image: &Path,
    options: &[S],
    log: Option<&Path>,
) -> Result<ModelRunReport> {
    let folder = tempfile::Builder::new().prefix("trueup-").tempdir()?;
    let mut command = Command::new(model);
    let events = folder.path().join("events");
    command.arg(image).args(options).arg("--log").arg(&events);
    if let Some(log) = log {
        command.arg("--rtt").arg(log);
    }
    command.stdin(Stdio::null());
    let output = command.output().context("cannot start the model of the chip")?;
    let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
    let complaint = String::from_utf8_lossy(&output.stderr);
    anyhow::ensure!(
        output.status.code().is_some_and(|code| code < 2),
        "`{}` failed: {}",
        process::format_command_line(&command),
        complaint.trim()
    );
    let events = std::fs::read_to_string(events)?.lines().map(Into::into).collect();
    Ok(ModelRunReport { clean: output.status.success(), stdout, log: Vec::new(), events })
}

/// Makes the pipe of the model's log in a folder. It is open both ways until the file is dropped, so that no process
/// waits for ever for the other one to open its end.
pub(crate) fn create_log_pipe(folder: &Path) -> Result<(PathBuf, File)> {
    let pipe = folder.join("log");
    mknodat(CWD, &pipe, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)
        .context("cannot make a pipe")?;
    let held = File::options().read(true).write(true).open(&pipe)?;
    Ok((pipe, held))
}

/// Returns the port in the model's first line.
pub(crate) fn parse_port(line: &str) -> Result<u16> {
    let port = line.rsplit(':').next().and_then(|port| port.trim().parse().ok());
    port.with_context(|| format!("the model says no port, but {line:?}"))
}

/// Runs an image for a user: its log on this program's standard output as it comes, everything else as
/// the model prints it.
///
/// # Errors
/// The model cannot be started.
pub fn run_interactive<S: AsRef<OsStr>>(model: &Path, image: &Path, options: &[S]) -> Result<bool> {
    let folder = tempfile::Builder::new().prefix("trueup-").tempdir()?;
    let (pipe, held) = create_log_pipe(folder.path())?;
    let mut command = Command::new(model);
    let mut child: Child = command
        .arg(image)
        .args(options)
        .arg("--rtt")
        .arg(&pipe)
        .stdin(Stdio::null())
        .spawn()
        .context("cannot start the model of the chip")?;
    let source = File::open(&pipe)?;
    let decoder = LogDecoder::from_image(image)?;
    let follower = std::thread::spawn(move || {
        decoder.decode_stream(source, trueup_output::write_line_best_effort).err().inspect(
            |error| {
                trueup_output::write_diagnostic(format_args!("the log ends: {error:#}"));
            },
        )
    });
    let status = child.wait()?;
    drop(held);
    follower.join().expect("it does not panic");
    Ok(status.success())
}

/// A running model, ended with its owner, and the port of one of its lines.
pub struct RunningChipModel {
    child: Child,
    /// Where the line listens on this machine.
    pub port: u16,
}

impl RunningChipModel {
    /// Starts an image whose serial line is a TCP port.
    ///
    /// # Errors
    /// The model cannot be started, or ends at once.
    pub fn start<S: AsRef<OsStr>>(model: &Path, image: &Path, options: &[S]) -> Result<Self> {
        Self::start_with_interface("--serial", model, image, options)
    }

    /// Starts the same, with the RS-485 line for a PLC.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn start_with_modbus<S: AsRef<OsStr>>(
        model: &Path,
        image: &Path,
        options: &[S],
    ) -> Result<Self> {
        Self::start_with_interface("--modbus", model, image, options)
    }

    fn start_with_interface<S: AsRef<OsStr>>(
        line: &str,
        model: &Path,
        image: &Path,
        options: &[S],
    ) -> Result<Self> {
        let mut command = Command::new(model);
        command.arg(image).args([line, "0"]).args(options);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::inherit());
        let mut child = command.spawn().context("cannot start the model of the chip")?;
        let mut source = child.stdout.take().context("its output was asked for")?;
        let mut first = Vec::new();
        let mut byte = [0];
        while source.read(&mut byte)? == 1 && byte[0] != b'\n' {
            first.push(byte[0]);
        }
        // What it prints at its end must find a reader.
        std::thread::spawn(move || std::io::copy(&mut source, &mut std::io::sink()));
        Ok(Self { child, port: parse_port(&String::from_utf8_lossy(&first))? })
    }
}

impl Drop for RunningChipModel {
    fn drop(&mut self) {
        // It may have ended already; there is nothing else to do about a failure here.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
