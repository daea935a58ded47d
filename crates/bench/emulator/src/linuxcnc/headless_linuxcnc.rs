//! LinuxCNC itself: Debian's, without a screen, as a user that owns nothing, with all that belongs
//! to it in a folder of its own.
//!
//! Its screen is a script that executes the commands from a socket of the loopback (`screen.py` has
//! the verbs). Everything that is started here is ended here, and no wait is without an end.

use std::{
    fs::{self, File},
    io::{BufRead as _, BufReader, ErrorKind, Write as _},
    net::{Shutdown, TcpListener, TcpStream},
    os::unix::{
        fs::{PermissionsExt as _, chown},
        process::CommandExt as _,
    },
    path::Path,
    process::{Child, ChildStdout, Command, Stdio},
    sync::mpsc::{self, Sender},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{process, setup::LockedLinuxCnc, stale_shared_memory};

/// The user and group that own nothing.
const NOBODY_ID: u32 = 65_534;
/// LinuxCNC is up after a few seconds on an idle computer.
const STARTUP_TIMEOUT: Duration = Duration::from_secs(90);
/// An answer of the screen; homing, moves and loading a program are in it.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(150);
/// How long it may take to go, and to obey a signal.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(30);
const TERMINATION_TIMEOUT: Duration = Duration::from_secs(5);
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// How often it is started when it loses its own race for shared memory; see [`stale_shared_memory`].
const MAX_START_ATTEMPTS: u32 = 3;
const SCREEN_SCRIPT: &str = include_str!("screen.py");
/// The `DISPLAY` of a configuration, in the folder.
pub const DISPLAY_PROGRAM: &str = "screen.sh";

/// A running LinuxCNC.
#[derive(Debug)]
pub struct HeadlessLinuxCnc {
    folder: TempDir,
    child: Child,
    screen: BufReader<TcpStream>,
    /// While this is held no other process runs one.
    alone: Option<LockedLinuxCnc>,
    _keeper: Sender<()>,
}

impl HeadlessLinuxCnc {
    /// Returns an empty folder for the configuration; it is also the first on the search path.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn create_config_folder() -> Result<TempDir> {
        Ok(tempfile::Builder::new().prefix("trueup-cnc-").tempdir()?)
    }

    /// Starts it with this configuration of the folder, whose `DISPLAY` is [`DISPLAY_PROGRAM`], and waits
    /// until that is there.
    ///
    /// # Errors
    /// It does not start; with its output.
    pub fn start(folder: TempDir, ini: &str, control: LockedLinuxCnc) -> Result<Self> {
        let path = |name: &str| folder.path().join(name);
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let port = listener.local_addr()?.port();
        let here = folder.path().display();
        fs::write(path("screen.py"), SCREEN_SCRIPT)?;
        fs::write(
            path(DISPLAY_PROGRAM),
            format!("#!/bin/sh\nexec /usr/bin/python3 {here}/screen.py {port}\n"),
        )?;
        fs::set_permissions(path(DISPLAY_PROGRAM), fs::Permissions::from_mode(0o755))?;
        if is_root()? {
            for entry in fs::read_dir(&folder)? {
                chown(entry?.path(), Some(NOBODY_ID), Some(NOBODY_ID))?;
            }
            chown(&folder, Some(NOBODY_ID), Some(NOBODY_ID))?;
        }
        for attempt in 1.. {
            let log = File::create(path("log.txt"))?;
            let mut command = unprivileged_command(control.program(), folder.path())?;
            command.arg(path(ini)).stdin(Stdio::null()).stdout(log.try_clone()?).stderr(log);
            // A group of its own, so that it can be ended with all that it started.
            command.process_group(0);
            let (mut child, keeper) =
                spawn_on_dedicated_thread(command).context("LinuxCNC cannot be started")?;
            match wait_for_screen(&listener, &mut child) {
                Ok(stream) => {
                    let screen = BufReader::new(stream);
                    return Ok(Self {
                        folder,
                        child,
                        screen,
                        alone: Some(control),
                        _keeper: keeper,
                    });
                }
                Err(error) => {
                    terminate_process_group(&mut child);
                    let log_lines = read_recent_log(folder.path());
                    let denied = stale_shared_memory::parse_denied_keys(&log_lines);
                    if attempt == MAX_START_ATTEMPTS || denied.is_empty() {
                        bail!("LinuxCNC does not come up: {error:#}\n{log_lines}");
                    }
                    stale_shared_memory::remove_unattached_segments(&denied)?;
                }
            }
        }
        unreachable!("the last attempt returns")
    }

    /// Lets the screen do something, and gives its result.
    ///
    /// # Errors
    /// It cannot, or LinuxCNC has ended; with its output.
    pub fn send_request(&mut self, request: &Value) -> Result<Value> {
        let line = format!("{request}\n");
        let mut answer = String::new();
        let requested = self.screen.get_mut().write_all(line.as_bytes());
        let length = requested.and_then(|()| self.screen.read_line(&mut answer));
        if !matches!(length, Ok(1..)) {
            bail!("{request}: LinuxCNC's screen no longer answers\n{}", self.recent_log());
        }
        let mut answer: Value = serde_json::from_str(&answer)?;
        if let Some(error) = answer["error"].as_str() {
            bail!("{request}: {error}\n{}", self.recent_log());
        }
        Ok(answer["ok"].take())
    }

    /// [`HeadlessLinuxCnc::send_request`] for something that has one argument.
    ///
    /// # Errors
    /// As [`HeadlessLinuxCnc::send_request`].
    pub fn send_request_with_argument(
        &mut self,
        verb: &str,
        name: &str,
        value: impl Into<Value>,
    ) -> Result<Value> {
        self.send_request(&json!({ "do": verb, name: value.into() }))
    }

    /// Takes it out of the emergency stop, switches it on, homes it if it is not homed, and gives
    /// it to its axes: joint by joint, as after homing, no external offset moves.
    ///
    /// # Errors
    /// As [`HeadlessLinuxCnc::send_request`].
    pub fn power_on_and_home(&mut self) -> Result<()> {
        self.send_request_with_argument("state", "name", "reset")?;
        self.send_request_with_argument("state", "name", "on")?;
        if self.read_pin("motion.is-all-homed")? == 0.0 {
            self.send_request(&json!({ "do": "home" }))?;
        }
        self.send_request_with_argument("teleop", "on", true).map(drop)
    }

    /// Starts a program of the folder.
    ///
    /// # Errors
    /// As [`HeadlessLinuxCnc::send_request`].
    pub fn start_program(&mut self, program: &str) -> Result<()> {
        let path = self.folder.path().join(program);
        self.send_request_with_argument("begin", "program", path.to_string_lossy()).map(drop)
    }

    /// Returns whether the program still runs.
    ///
    /// # Errors
    /// LinuxCNC has stopped it.
    pub fn is_program_running(&mut self) -> Result<bool> {
        Ok(self.send_request(&json!({ "do": "busy" }))? == Value::Bool(true))
    }

    /// Returns true if the program waits for the operator at a stop (`M0`).
    ///
    /// # Errors
    /// As [`HeadlessLinuxCnc::send_request`].
    pub fn is_program_paused(&mut self) -> Result<bool> {
        Ok(self.send_request(&json!({ "do": "stopped" }))? == Value::Bool(true))
    }

    /// Goes on after a stop, as the operator does.
    ///
    /// # Errors
    /// As [`HeadlessLinuxCnc::send_request`].
    pub fn resume_program(&mut self) -> Result<()> {
        self.send_request(&json!({ "do": "resume" })).map(drop)
    }

    /// Sets a pin that nothing drives.
    ///
    /// # Errors
    /// There is no such pin.
    pub fn set_pin(&mut self, pin: &str, value: impl Into<Value>) -> Result<()> {
        let value: Value = value.into();
        self.send_request(&json!({ "do": "setp", "name": pin, "value": value })).map(drop)
    }

    /// Reads pins as numbers; a bit is 0 or 1.
    ///
    /// # Errors
    /// There is no such pin.
    pub fn read_pins(&mut self, names: &[&str]) -> Result<Vec<f64>> {
        let values = self.send_request_with_argument("pins", "names", names)?;
        let values = values.as_array().context("the screen gives no list")?;
        let number = |value: &Value| match value {
            Value::Bool(bit) => f64::from(u8::from(*bit)),
            other => other.as_f64().unwrap_or(f64::NAN),
        };
        Ok(values.iter().map(number).collect())
    }

    /// Reads one pin.
    ///
    /// # Errors
    /// There is no such pin.
    pub fn read_pin(&mut self, name: &str) -> Result<f64> {
        Ok(self.read_pins(&[name])?[0])
    }

    /// Waits until this holds of these pins.
    ///
    /// # Errors
    /// It does not within this many seconds; with what they are.
    pub fn wait_for_pins(
        &mut self,
        what: &str,
        seconds: u64,
        names: &[&str],
        holds: impl Fn(&[f64]) -> bool,
    ) -> Result<()> {
        let end = Instant::now() + Duration::from_secs(seconds);
        loop {
            let values = self.read_pins(names)?;
            if holds(&values) {
                return Ok(());
            }
            ensure!(
                Instant::now() < end,
                "{what}: not within {seconds} s; {names:?} are {values:?}\n{}",
                self.recent_log()
            );
            thread::sleep(POLL_INTERVAL / 2);
        }
    }

    /// `halcmd` with these words; what it says.
    ///
    /// # Errors
    /// It refuses; with what it says.
    pub fn run_halcmd(&mut self, words: &str) -> Result<String> {
        let words: Vec<&str> = words.split_whitespace().collect();
        let text = self.send_request_with_argument("halcmd", "words", words)?;
        Ok(text.as_str().unwrap_or_default().to_owned())
    }

    /// Returns what the real-time `sampler` writes down, a line for each servo cycle, while the guard lives.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn start_sampler(&self) -> Result<(SamplerGuard, ChildStdout)> {
        let program =
            process::find_on_path("halsampler").context("halsampler belongs to LinuxCNC")?;
        let mut child = unprivileged_command(&program, self.folder())?
            .arg("-t")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let lines = child.stdout.take().context("its output was asked for")?;
        Ok((SamplerGuard(child), lines))
    }

    /// Returns the end of what the output of it and its parts so far.
    #[must_use]
    pub fn recent_log(&self) -> String {
        read_recent_log(self.folder())
    }

    /// Returns the folder of its session: the .ini, programs and logs.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Ends it as an operator would, by closing the screen.
    ///
    /// # Errors
    /// It does not end by itself; it is then made to.
    pub fn close(&mut self) -> Result<()> {
        self.screen.get_mut().shutdown(Shutdown::Both).ok();
        if has_exited_within(&mut self.child, SHUTDOWN_TIMEOUT) {
            return Ok(());
        }
        terminate_process_group(&mut self.child);
        bail!("LinuxCNC does not end: {}", self.recent_log())
    }

    /// Ends it; gives what is needed to start it again before anybody else does.
    ///
    /// # Errors
    /// As [`HeadlessLinuxCnc::close`].
    pub fn shut_down(&mut self) -> Result<LockedLinuxCnc> {
        self.close()?;
        self.alone.take().context("it was given back before")
    }
}

impl Drop for HeadlessLinuxCnc {
    fn drop(&mut self) {
        if let Err(error) = self.close() {
            trueup_output::write_diagnostic(format_args!("{error:#}"));
        }
    }
}

/// Ends `halsampler`, which must not hold up the end of the real-time part.
#[derive(Debug)]
pub struct SamplerGuard(Child);

impl Drop for SamplerGuard {
    fn drop(&mut self) {
        // It may have ended by itself.
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// Starts it from a thread that lives as long as what is given with it: the kernel ends the process
/// with the thread that has started it, and one test may leave LinuxCNC to the next.
fn spawn_on_dedicated_thread(mut command: Command) -> Result<(Child, Sender<()>)> {
    let (keeper, retained) = mpsc::channel::<()>();
    let (give, take) = mpsc::channel();
    thread::spawn(move || {
        // There is no receiver only if the other thread has died.
        give.send(command.spawn()).ok();
        // Nothing is ever sent: this ends when the other end goes.
        retained.recv().ok();
    });
    Ok((take.recv()??, keeper))
}

fn wait_for_screen(listener: &TcpListener, child: &mut Child) -> Result<TcpStream> {
    listener.set_nonblocking(true)?;
    let end = Instant::now() + STARTUP_TIMEOUT;
    loop {
        match listener.accept() {
            Ok((stream, _)) => {
                stream.set_nonblocking(false)?;
                stream.set_read_timeout(Some(RESPONSE_TIMEOUT))?;
                return Ok(stream);
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(error) => return Err(error.into()),
        }
        if let Some(status) = child.try_wait()? {
            bail!("it ends, {status}");
        }
        ensure!(Instant::now() < end, "not within {STARTUP_TIMEOUT:?}");
        thread::sleep(POLL_INTERVAL);
    }
}

fn has_exited_within(child: &mut Child, timeout: Duration) -> bool {
    let end = Instant::now() + timeout;
    while matches!(child.try_wait(), Ok(None)) {
        if Instant::now() > end {
            return false;
        }
        thread::sleep(POLL_INTERVAL);
    }
    true
}

/// Makes LinuxCNC and all that it started end. It takes its real-time part down by itself if it is
/// asked to.
fn terminate_process_group(child: &mut Child) {
    let group = format!("-{}", child.id());
    for signal in ["-TERM", "-KILL"] {
        if has_exited_within(child, Duration::ZERO) {
            return;
        }
        // There is nothing else to do about a failure here.
        Command::new("kill").args([signal, "--", &group]).status().ok();
        has_exited_within(child, TERMINATION_TIMEOUT);
    }
}

/// Returns a command in the folder's own surroundings; LinuxCNC refuses to run as root.
fn unprivileged_command(program: &Path, folder: &Path) -> Result<Command> {
    let mut command = if is_root()? {
        let mut command = Command::new("setpriv");
        command.args([&format!("--reuid={NOBODY_ID}"), &format!("--regid={NOBODY_ID}")]);
        // The kernel ends it when this process dies, however it dies; see [`spawn_on_dedicated_thread`].
        command.args(["--clear-groups", "--pdeathsig", "TERM"]).arg(program);
        command
    } else {
        Command::new(program)
    };
    command
        .env_clear()
        // The folder first: a component is started by its name.
        .env("PATH", format!("{}:/usr/bin:/bin:/usr/sbin:/sbin", folder.display()))
        .env("HOME", folder)
        .env("LANG", "C")
        .current_dir(folder);
    Ok(command)
}

fn is_root() -> Result<bool> {
    Ok(process::capture_stdout(Command::new("id").arg("-u"))?.trim() == "0")
}

fn read_recent_log(folder: &Path) -> String {
    const MAX_LOG_LINES: usize = 40;
    let end_of = |name: &str| {
        let text = fs::read_to_string(folder.join(name)).unwrap_or_default();
        let lines: Vec<&str> = text.lines().collect();
        lines[lines.len().saturating_sub(MAX_LOG_LINES)..].join("\n")
    };
    ["trueup.log", "log.txt", "linuxcnc_print.txt", "linuxcnc_debug.txt"].map(end_of).join("\n")
}
