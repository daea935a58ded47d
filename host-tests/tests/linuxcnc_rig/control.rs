//! LinuxCNC itself: Debian's package with the sample configuration of `integrations/linuxcnc`, without
//! a screen, as a user that owns nothing, every servo cycle recorded.

use std::{
    fs::{self, File},
    io::{BufRead as _, BufReader, Write as _},
    net::{TcpListener, TcpStream},
    os::unix::{
        fs::{PermissionsExt as _, chown},
        process::CommandExt as _,
    },
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail, ensure};
use serde_json::{Value, json};
use tempfile::TempDir;
use trueup_emulator::setup::{self, LinuxCnc};

/// The user and group that own nothing.
const NOBODY: u32 = 65_534;
/// How long LinuxCNC may take to start, on a computer that is shared.
const START: Duration = Duration::from_secs(90);
/// How long it may take to go.
const END: Duration = Duration::from_secs(30);

/// What is read in every servo cycle; see [`samples`].
const RECORDER: &str = "\
loadrt sampler depth=16000 cfg=sffffffffffffbb
addf sampler.0 servo-thread
net scenario  => sampler.0.pin.0
net x-pos     => sampler.0.pin.1
net y-pos     => sampler.0.pin.2
net z-pos     => sampler.0.pin.3
net trueup-x-cmd  => sampler.0.pin.4
net trueup-y-cmd  => sampler.0.pin.5
net trueup-z-cmd  => sampler.0.pin.6
net trueup-x-eoff => sampler.0.pin.7
net trueup-y-eoff => sampler.0.pin.8
net trueup-z-eoff => sampler.0.pin.9
net trueup-x-req  => sampler.0.pin.10
net trueup-y-req  => sampler.0.pin.11
net trueup-z-req  => sampler.0.pin.12
net trueup-on     => sampler.0.pin.13
net trueup-homed  => sampler.0.pin.14
loadusr halsampler -t FOLDER/samples.txt
";
/// What both sample configurations include.
const INCLUDED: &str = "trueup_machine.inc";
/// After the screen has come.
const LATE: &str = "net scenario screen.scenario\nnet trueup-zero screen.zero\n";

/// A LinuxCNC that runs.
pub struct Control {
    child: Child,
    line: BufReader<TcpStream>,
    folder: TempDir,
    alone: Option<LinuxCnc>,
}

impl Control {
    /// Starts it with the bridge at this address, and with these files beside the samples.
    pub fn start(linuxcnc: LinuxCnc, bridge: &str, files: &[(&str, &str)]) -> Result<Self> {
        let folder = TempDir::new()?;
        let path = |name: &str| folder.path().join(name);
        let here = folder.path().to_str().context("a temporary folder has a plain name")?;
        let samples = setup::root().join("integrations/linuxcnc");
        for entry in fs::read_dir(&samples)? {
            let entry = entry?;
            if entry.file_type()?.is_file() {
                fs::copy(entry.path(), path(&entry.file_name().to_string_lossy()))?;
            }
        }
        fs::copy(
            setup::root().join("host-tests/python/linuxcnc_screen.py"),
            path("linuxcnc_screen.py"),
        )?;
        fs::create_dir(path("bin"))?;
        fs::copy(trueup()?, path("bin/trueup"))?;
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let port = listener.local_addr()?.port();
        let display = format!(
            "#!/bin/sh\nexec /usr/bin/python3 {here}/linuxcnc_screen.py 127.0.0.1 {port}\n"
        );
        // LinuxCNC puts the two together itself.
        for (sample, name) in [("trueup_sim.ini", "test.ini"), (INCLUDED, INCLUDED)] {
            let text = fs::read_to_string(samples.join(sample))?;
            fs::write(path(name), configuration(&text, here, bridge))?;
        }
        for (name, text) in files {
            fs::write(path(name), text)?;
        }
        fs::write(path("recorder.hal"), RECORDER.replace("FOLDER", here))?;
        fs::write(path("display.sh"), display)?;
        fs::set_permissions(path("display.sh"), fs::Permissions::from_mode(0o755))?;
        let mut command = as_nobody(linuxcnc.program(), folder.path())?;
        let log = File::create(path("log.txt"))?;
        let child = command
            .arg(path("test.ini"))
            .env_clear()
            .env("PATH", format!("{here}/bin:/usr/bin:/bin:/usr/sbin:/sbin"))
            .env("HOME", folder.path())
            .env("LANG", "C")
            .current_dir(&folder)
            .stdin(Stdio::null())
            .stdout(log.try_clone()?)
            .stderr(log)
            // A group of its own, so that it can be ended with all that it started.
            .process_group(0)
            .spawn()
            .context("LinuxCNC cannot be started")?;
        let mut started = Started { child, folder, alone: Some(linuxcnc) };
        let stream = started.wait_for_screen(&listener)?;
        let (child, folder, alone) = started.parts();
        let line = BufReader::new(stream);
        let mut control = Self { child, line, folder, alone };
        for words in LATE.lines() {
            let words: Vec<&str> = words.split_whitespace().collect();
            control.ask(json!({"do": "halcmd", "words": words}))?;
        }
        Ok(control)
    }

    /// Asks the screen for something.
    pub fn ask(&mut self, request: Value) -> Result<Value> {
        let line = format!("{request}\n");
        self.line.get_mut().write_all(line.as_bytes()).context("the screen has gone")?;
        let mut answer = String::new();
        self.line.read_line(&mut answer).context("the screen does not answer")?;
        let mut answer: Value = serde_json::from_str(&answer)
            .with_context(|| format!("{request}: the screen has gone; {}", self.said()))?;
        if let Some(error) = answer.get("error") {
            bail!("{request}: {error}\n{}", self.said());
        }
        Ok(answer["ok"].take())
    }

    /// Asks for something that has one argument.
    pub fn act(&mut self, verb: &str, name: &str, value: impl Into<Value>) -> Result<Value> {
        self.ask(json!({"do": verb, name: value.into()}))
    }

    /// `halcmd` with these words; what it says.
    pub fn halcmd(&mut self, words: &str) -> Result<String> {
        let words: Vec<&str> = words.split_whitespace().collect();
        let said = self.act("halcmd", "words", words)?;
        Ok(said.as_str().unwrap_or_default().to_owned())
    }

    /// What these pins say, as numbers.
    pub fn pins(&mut self, names: &[&str]) -> Result<Vec<f64>> {
        let values = self.act("pins", "names", names)?;
        let number =
            |value: &Value| value.as_f64().or(value.as_bool().map(|bit| f64::from(u8::from(bit))));
        let values = values.as_array().context("a list")?;
        // A pin that is not a number is nan.
        Ok(values.iter().map(|value| number(value).unwrap_or(f64::NAN)).collect())
    }

    /// What this pin says.
    pub fn pin(&mut self, name: &str) -> Result<f64> {
        Ok(self.pins(&[name])?[0])
    }

    /// Waits until this holds of these pins.
    pub fn wait(
        &mut self,
        what: &str,
        seconds: u64,
        names: &[&str],
        holds: impl Fn(&[f64]) -> bool,
    ) -> Result<()> {
        let end = Instant::now() + Duration::from_secs(seconds);
        loop {
            let values = self.pins(names)?;
            if holds(&values) {
                return Ok(());
            }
            ensure!(
                Instant::now() < end,
                "{what}: not within {seconds} s; {names:?} are {values:?}\n{}",
                self.said()
            );
            thread::sleep(Duration::from_millis(10));
        }
    }

    /// The file that gets a line every servo cycle.
    pub fn recording(&self) -> PathBuf {
        self.folder.path().join("samples.txt")
    }

    /// What LinuxCNC and the component have said.
    pub fn said(&self) -> String {
        said(self.folder.path())
    }

    /// Its folder.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Ends it as a user does, by closing the screen.
    pub fn end(&mut self) -> Result<()> {
        self.line.get_mut().shutdown(std::net::Shutdown::Both).ok();
        let end = Instant::now() + END;
        while self.child.try_wait()?.is_none() {
            if Instant::now() > end {
                end_group(&mut self.child);
                bail!("LinuxCNC does not end: {}", self.said());
            }
            thread::sleep(Duration::from_millis(20));
        }
        Ok(())
    }

    /// Ends it; gives what is needed to start it again before anybody else does.
    pub fn give_back(&mut self) -> Result<LinuxCnc> {
        self.end()?;
        self.alone.take().context("it was given back before")
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        if let Err(error) = self.end() {
            eprintln!("{error:#}");
        }
    }
}

/// One that may still fail to come up.
struct Started {
    child: Child,
    folder: TempDir,
    alone: Option<LinuxCnc>,
}

impl Started {
    fn wait_for_screen(&mut self, listener: &TcpListener) -> Result<TcpStream> {
        listener.set_nonblocking(true)?;
        let end = Instant::now() + START;
        loop {
            if let Ok((stream, _)) = listener.accept() {
                stream.set_nonblocking(false)?;
                stream.set_read_timeout(Some(START))?;
                return Ok(stream);
            }
            if let Some(status) = self.child.try_wait()? {
                bail!("LinuxCNC ends ({status}): {}", said(self.folder.path()));
            }
            if Instant::now() > end {
                end_group(&mut self.child);
                bail!("LinuxCNC is not up after {START:?}: {}", said(self.folder.path()));
            }
            thread::sleep(Duration::from_millis(20));
        }
    }

    fn parts(self) -> (Child, TempDir, Option<LinuxCnc>) {
        (self.child, self.folder, self.alone)
    }
}

fn said(folder: &Path) -> String {
    ["trueup.log", "log.txt", "linuxcnc_print.txt", "linuxcnc_debug.txt"]
        .map(|name| fs::read_to_string(folder.join(name)).unwrap_or_default())
        .join("\n")
}

/// It takes its realtime part down by itself if it is asked to.
fn end_group(child: &mut Child) {
    let group = format!("-{}", child.id());
    for signal in ["-TERM", "-KILL"] {
        Command::new("kill").args([signal, "--", &group]).status().ok();
        thread::sleep(Duration::from_secs(3));
    }
    child.wait().ok();
}

/// The sample configuration with another screen and the recorder.
fn configuration(sample: &str, folder: &str, bridge: &str) -> String {
    let mut text = String::new();
    for line in sample.lines() {
        let key = line.split('=').next().unwrap_or_default().trim();
        match key {
            "DISPLAY" => text += &format!("DISPLAY = {folder}/display.sh\n"),
            // The emulated serial line is slow where the computer is busy.
            "POSITION_PERIOD_MS" => text += "POSITION_PERIOD_MS = 10\n",
            "PORT" => text += &format!("PORT = {bridge}\n"),
            // They belong to the screen that is not there.
            "PYVCP" | "POSTGUI_HALFILE" => {}
            _ => {
                text += line;
                text += "\n";
                if line.trim() == "HALFILE = trueup.hal" {
                    text += "HALFILE = recorder.hal\n";
                }
            }
        }
    }
    text
}

/// LinuxCNC refuses to run as root.
fn as_nobody(program: &Path, folder: &Path) -> Result<Command> {
    let id = Command::new("id").arg("-u").output()?;
    if String::from_utf8_lossy(&id.stdout).trim() != "0" {
        return Ok(Command::new(program));
    }
    for entry in fs::read_dir(folder)? {
        chown(entry?.path(), Some(NOBODY), Some(NOBODY))?;
    }
    chown(folder, Some(NOBODY), Some(NOBODY))?;
    let mut command = Command::new("setpriv");
    command.args([&format!("--reuid={NOBODY}"), &format!("--regid={NOBODY}")]);
    command.arg("--clear-groups").arg(program);
    Ok(command)
}

/// The host tool, built.
fn trueup() -> Result<PathBuf> {
    let cargo = std::env::var_os("CARGO").unwrap_or("cargo".into());
    let output = Command::new(cargo)
        .args(["build", "--package", "trueup-cli", "--message-format", "json-render-diagnostics"])
        .current_dir(setup::root())
        .stderr(Stdio::inherit())
        .output()?;
    ensure!(output.status.success(), "trueup does not build");
    let messages = String::from_utf8(output.stdout)?;
    messages
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter(|message| message["target"]["name"] == "trueup")
        .find_map(|message| message["executable"].as_str().map(PathBuf::from))
        .context("cargo does not say where trueup is")
}
