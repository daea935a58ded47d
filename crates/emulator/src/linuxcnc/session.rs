//! LinuxCNC itself: Debian's, without a screen, as a user that owns nothing, with all that belongs
//! to it in a folder of its own.
//!
//! Its screen is a script that does what it is told over a socket of the loopback; its real-time
//! `sampler` writes down the joints in every servo cycle. Everything that is started here is ended
//! here, and no wait is without an end.

use std::{
    fs::{self, File},
    io::{BufRead as _, BufReader, ErrorKind, Write as _},
    net::{TcpListener, TcpStream},
    os::unix::{fs::PermissionsExt as _, process::CommandExt as _},
    path::{Path, PathBuf},
    process::{Child, ChildStdout, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{process, setup};

/// The user and group that own nothing.
const NOBODY: u32 = 65_534;
/// LinuxCNC is up after a few seconds on an idle computer.
const START: Duration = Duration::from_secs(90);
/// An answer of the screen; homing and loading a program are in it.
const ANSWER: Duration = Duration::from_secs(60);
/// It takes its realtime part down by itself if it is asked to.
const END: Duration = Duration::from_secs(20);
const SCREEN: &str = include_str!("screen.py");
/// The configuration's file.
const INI: &str = "loop.ini";

/// A file of the session: its name and its text.
pub type Text<'a> = (&'a str, &'a str);

/// A running LinuxCNC.
pub struct Session {
    folder: TempDir,
    child: Child,
    screen: BufReader<TcpStream>,
    sampler: Option<Child>,
    /// While this is held nobody else runs one.
    _alone: setup::LinuxCnc,
}

impl Session {
    /// A folder for it, in which `trueup` stands as the program of that name.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn folder(trueup: &Path) -> Result<TempDir> {
        let folder = tempfile::Builder::new().prefix("trueup-cnc-").tempdir()?;
        // Root's own folders may be closed to the user that LinuxCNC runs as.
        fs::copy(trueup, folder.path().join("trueup"))
            .with_context(|| format!("{} is missing", trueup.display()))?;
        Ok(folder)
    }

    /// Starts it in `folder` with these files, of which `loop.ini` is the configuration, and waits
    /// until its screen is there.
    ///
    /// # Errors
    /// It does not start; with what it said.
    pub fn start(folder: TempDir, files: &[Text], control: setup::LinuxCnc) -> Result<Self> {
        let path = |name: &str| folder.path().join(name);
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let port = listener.local_addr()?.port();
        let here = folder.path().display();
        let screen = format!("#!/bin/sh\nexec /usr/bin/python3 {here}/screen.py {port}\n");
        let own = [("screen.py", SCREEN), ("screen.sh", screen.as_str())];
        for (name, text) in files.iter().chain(&own) {
            fs::write(path(name), text)?;
        }
        fs::set_permissions(path("screen.sh"), fs::Permissions::from_mode(0o755))?;
        if is_root()? {
            for entry in fs::read_dir(&folder)? {
                std::os::unix::fs::chown(entry?.path(), Some(NOBODY), Some(NOBODY))?;
            }
            std::os::unix::fs::chown(&folder, Some(NOBODY), Some(NOBODY))?;
        }
        let log = File::create(path("log.txt"))?;
        let mut child = unprivileged(control.program(), folder.path())?
            .arg(path(INI))
            .stdin(Stdio::null())
            .stdout(log.try_clone()?)
            .stderr(log)
            // A group of its own, so that it can be ended with all that it started.
            .process_group(0)
            .spawn()
            .context("LinuxCNC cannot be started")?;
        listener.set_nonblocking(true)?;
        let started = Instant::now();
        let stream = loop {
            match listener.accept() {
                Ok((stream, _)) => break stream,
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Err(error.into()),
            }
            let ended = child.try_wait()?;
            if ended.is_some() || started.elapsed() > START {
                end(&mut child);
                bail!("LinuxCNC does not come up: {}", said(folder.path()));
            }
            thread::sleep(Duration::from_millis(20));
        };
        stream.set_nonblocking(false)?;
        stream.set_read_timeout(Some(ANSWER))?;
        let screen = BufReader::new(stream);
        Ok(Self { folder, child, screen, sampler: None, _alone: control })
    }

    /// Lets the screen do something, and gives its result.
    ///
    /// # Errors
    /// It cannot, or LinuxCNC has ended; with what that said.
    fn ask(&mut self, request: &Value) -> Result<Value> {
        let line = format!("{request}\n");
        let mut answer = String::new();
        let done = self.screen.get_mut().write_all(line.as_bytes());
        let length = done.and_then(|()| self.screen.read_line(&mut answer));
        if !matches!(length, Ok(1..)) {
            bail!("LinuxCNC's screen no longer answers: {}", said(self.folder.path()));
        }
        let mut answer: Value = serde_json::from_str(&answer)?;
        if let Some(error) = answer["error"].as_str() {
            bail!("{error}\n{}", said(self.folder.path()));
        }
        Ok(answer["ok"].take())
    }

    /// Takes it out of the emergency stop, switches it on and homes it.
    ///
    /// # Errors
    /// As all that it is asked.
    pub fn home(&mut self) -> Result<()> {
        self.ask(&json!({ "do": "start" })).map(drop)
    }

    /// Starts a program of the folder.
    ///
    /// # Errors
    /// As all that it is asked.
    pub fn begin(&mut self, program: &str) -> Result<()> {
        let path = self.folder.path().join(program);
        self.ask(&json!({ "do": "begin", "program": path })).map(drop)
    }

    /// Whether the program still runs.
    ///
    /// # Errors
    /// LinuxCNC has stopped it.
    pub fn is_busy(&mut self) -> Result<bool> {
        Ok(self.ask(&json!({ "do": "busy" }))? == Value::Bool(true))
    }

    /// Sets a pin that nothing drives.
    ///
    /// # Errors
    /// There is no such pin.
    pub fn set(&mut self, pin: &str, value: impl Into<Value>) -> Result<()> {
        let value: Value = value.into();
        self.ask(&json!({ "do": "set", "pin": pin, "value": value })).map(drop)
    }

    /// Reads pins as numbers; a bit is 0 or 1.
    ///
    /// # Errors
    /// There is no such pin.
    pub fn get(&mut self, pins: &[&str]) -> Result<Vec<f64>> {
        let values = self.ask(&json!({ "do": "get", "pins": pins }))?;
        let values = values.as_array().context("the screen gives no list")?;
        let number = |value: &Value| match value {
            Value::Bool(bit) => f64::from(u8::from(*bit)),
            other => other.as_f64().unwrap_or(f64::NAN),
        };
        Ok(values.iter().map(number).collect())
    }

    /// What the `sampler` writes down, a line for each servo cycle; it can be taken once.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn samples(&mut self) -> Result<ChildStdout> {
        ensure!(self.sampler.is_none(), "the sampler runs already");
        let program = process::find("halsampler").context("halsampler belongs to LinuxCNC")?;
        let mut child = unprivileged(&program, self.folder.path())?
            .arg("-t")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let lines = child.stdout.take().context("its output was asked for")?;
        self.sampler = Some(child);
        Ok(lines)
    }

    /// Ends it as an operator would, by closing the screen.
    ///
    /// # Errors
    /// It does not end; it is then ended.
    pub fn close(mut self) -> Result<()> {
        self.end_sampler();
        self.screen.get_mut().write_all(b"{\"do\": \"end\"}\n")?;
        let asked = Instant::now();
        while asked.elapsed() < END {
            if self.child.try_wait()?.is_some() {
                return Ok(());
            }
            thread::sleep(Duration::from_millis(20));
        }
        bail!("LinuxCNC does not end: {}", said(self.folder.path()))
    }

    /// What it has said so far.
    #[must_use]
    pub fn said(&self) -> String {
        said(self.folder.path())
    }

    fn end_sampler(&mut self) {
        if let Some(mut sampler) = self.sampler.take() {
            // It ends by itself when the real-time part goes; it must not hold that up.
            sampler.kill().ok();
            sampler.wait().ok();
        }
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        self.end_sampler();
        end(&mut self.child);
    }
}

/// Asks LinuxCNC and all that it started to end, and sees to it.
fn end(child: &mut Child) {
    if !matches!(child.try_wait(), Ok(None)) {
        return;
    }
    let group = format!("-{}", child.id());
    for signal in ["-TERM", "-KILL"] {
        // There is nothing else to do about a failure here.
        Command::new("kill").args([signal, "--", &group]).status().ok();
        for _ in 0..250 {
            if !matches!(child.try_wait(), Ok(None)) {
                return;
            }
            thread::sleep(Duration::from_millis(20));
        }
    }
}

/// A command in the folder's own surroundings; LinuxCNC refuses to run as root.
fn unprivileged(program: &Path, folder: &Path) -> Result<Command> {
    let mut command = if is_root()? {
        let mut command = Command::new("setpriv");
        command.args([&format!("--reuid={NOBODY}"), &format!("--regid={NOBODY}")]);
        // The kernel ends it when this process dies, however it dies.
        command.args(["--clear-groups", "--pdeathsig", "TERM"]).arg(program);
        command
    } else {
        Command::new(program)
    };
    command
        .env_clear()
        // The folder first: the component is started by its name.
        .env("PATH", format!("{}:/usr/bin:/bin:/usr/sbin:/sbin", folder.display()))
        .env("HOME", folder)
        .env("LANG", "C")
        .current_dir(folder);
    Ok(command)
}

fn is_root() -> Result<bool> {
    Ok(process::output(Command::new("id").arg("-u"))?.trim() == "0")
}

/// The end of what LinuxCNC and its parts have said.
fn said(folder: &Path) -> String {
    const LINES: usize = 40;
    let logs = ["log.txt", "linuxcnc_print.txt", "linuxcnc_debug.txt"];
    let paths: Vec<PathBuf> = logs.iter().map(|name| folder.join(name)).collect();
    let texts: Vec<String> =
        paths.iter().map(|path| fs::read_to_string(path).unwrap_or_default()).collect();
    let all = texts.join("\n");
    let lines: Vec<&str> = all.lines().collect();
    lines[lines.len().saturating_sub(LINES)..].join("\n")
}
