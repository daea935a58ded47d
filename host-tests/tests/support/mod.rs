//! The project's command as a user starts it: a process of its own, with what it says, and with
//! whatever it starts in turn. Nothing of it outlives the test.
#![allow(dead_code, reason = "each test uses its share")]

pub mod bench;
pub mod chip;

use std::{
    fs,
    io::{BufRead as _, BufReader},
    net::TcpStream,
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::{
        Arc, Mutex, OnceLock,
        atomic::{AtomicU32, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail, ensure};
use tempfile::TempDir;
use trueup_emulator::{firmware_images, host_programs};

/// A machine whose offsets need no minutes to arrive.
pub const FAST_MACHINE: &str = "\
[machine]
name = \"fast\"
kind = \"3-axis\"

[inputs]
sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }

[spindle]
source = \"sensor\"

[spindle.sensor]
k0_um = 0.0
zero_counts = 5048.0
um_per_count = 0.0152587890625

[limits]
slew_um_per_s = 1000.0
";
/// A spindle that has grown and stays so: the last row is held.
pub const GROWN_RUN: &str = "sensor_counts,spindle_rpm\n9164,24000\n";
/// By how much it has grown.
pub const GROWN_UM: f64 = (9164.0 - 5048.0) * 0.0152587890625;

/// How long the command may take until it serves; it may have to wait for another's compiler.
const START: Duration = Duration::from_secs(120);
/// How long it may take to end.
const END: Duration = Duration::from_secs(10);
/// How long a board may keep silent on a socket.
pub const TIMEOUT: Duration = Duration::from_secs(10);
/// By this variable the processes of one command are distinguished from everybody else's.
const MARK: &str = "TRUEUP_TEST_MARK";

/// A command that runs.
pub struct Running {
    child: Child,
    lines: Arc<Mutex<Vec<String>>>,
    listener: Option<JoinHandle<()>>,
    mark: String,
    /// Its folder for temporary files.
    pub temporary: TempDir,
}

/// A command that has ended.
#[derive(Debug)]
pub struct Ended {
    /// Its exit code, or the signal that ended it.
    pub status: ExitStatus,
    /// Text on standard error.
    pub stderr: String,
    /// How long it took, from when it was waited for.
    pub took: Duration,
}

/// Returns the command, not yet started. It is built once, and so is the image, so that a test that starts it
/// need not wait for a compiler.
pub fn xtask() -> Result<Command> {
    static PROGRAM: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let program = PROGRAM.get_or_init(|| {
        let build = || {
            firmware_images::build_virtual_board_image()?;
            host_programs::build_program("xtask", "xtask")
        };
        build().map_err(|error| format!("{error:#}"))
    });
    match program {
        Ok(program) => {
            let mut command = Command::new(program);
            // Bridges that were met by an earlier run had other calibrations.
            command.env("XDG_STATE_HOME", state_folder());
            Ok(command)
        }
        Err(error) => bail!("{error}"),
    }
}

/// Where the tool keeps what it knows of its bridges: anew in each run.
fn state_folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let name = format!("state-{}", std::process::id());
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        // Of an earlier process with the same number; mostly there is none.
        std::fs::remove_dir_all(&folder).ok();
        folder
    })
}

/// Returns the host tool, not yet started; built once as well.
pub fn trueup() -> Result<Command> {
    static PROGRAM: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let build = || host_programs::build_trueup().map_err(|error| format!("{error:#}"));
    match PROGRAM.get_or_init(build) {
        Ok(program) => Ok(Command::new(program)),
        Err(error) => bail!("{error}"),
    }
}

impl Running {
    /// Starts a command.
    pub fn start(command: &mut Command) -> Result<Self> {
        Self::start_into(command, Stdio::null())
    }

    /// Starts a command, with its standard output to somewhere.
    pub fn start_into(command: &mut Command, output: Stdio) -> Result<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let mark = format!("{}-{number}", std::process::id());
        let temporary = tempfile::tempdir()?;
        let mut child = command
            .env(MARK, &mark)
            .env("TMPDIR", temporary.path())
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(Stdio::piped())
            .spawn()?;
        let lines = Arc::new(Mutex::new(Vec::new()));
        let stderr = child.stderr.take().context("it was asked for")?;
        let keep = lines.clone();
        let listener = thread::spawn(move || {
            for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                keep.lock().expect("nobody panics with it").push(line);
            }
        });
        Ok(Self { child, lines, listener: Some(listener), mark, temporary })
    }

    /// Returns its output so far.
    pub fn log(&self) -> String {
        self.lines.lock().expect("nobody panics with it").join("\n")
    }

    /// Waits until it says something between these two; gives that.
    pub fn wait_for(&mut self, before: &str, after: &str) -> Result<String> {
        let end = Instant::now() + START;
        loop {
            let log = self.log();
            let found = log.split_once(before).and_then(|(_, rest)| rest.split_once(after));
            if let Some((found, _)) = found {
                return Ok(found.to_owned());
            }
            if let Some(status) = self.child.try_wait()? {
                bail!("it ended ({status}) and never printed \"{before}\":\n{log}");
            }
            ensure!(Instant::now() < end, "it never printed \"{before}\":\n{log}");
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// Returns the number of its process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends it a signal, by its name.
    pub fn signal(&self, name: &str) -> Result<()> {
        signal(name, self.child.id())
    }

    /// Waits for its end.
    pub fn end(&mut self) -> Result<Ended> {
        self.end_within(END)
    }

    fn end_within(&mut self, limit: Duration) -> Result<Ended> {
        let started = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait()? {
                break status;
            }
            let late = started.elapsed() > limit;
            ensure!(!late, "it does not end within {limit:?}:\n{}", self.log());
            thread::sleep(Duration::from_millis(5));
        };
        let took = started.elapsed();
        // All of its output has come when its end of the pipe is closed.
        if let Some(listener) = self.listener.take() {
            listener.join().ok().context("the listener")?;
        }
        Ok(Ended { status, stderr: self.log(), took })
    }

    /// Returns the emulators that it started and that still run. One that has just been killed may need a
    /// moment.
    pub fn emulators_left(&self) -> Vec<u32> {
        let end = Instant::now() + Duration::from_secs(2);
        loop {
            let left = emulators(&self.mark);
            if left.is_empty() || Instant::now() > end {
                return left;
            }
            thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It has usually ended long ago.
        self.child.kill().ok();
        self.child.wait().ok();
        for id in emulators(&self.mark) {
            signal("KILL", id).ok();
        }
    }
}

/// Runs a command that is expected to end by itself; gives it with its end.
pub fn run(command: &mut Command) -> Result<(Running, Ended)> {
    let mut running = Running::start(command)?;
    let ended = running.end_within(START)?;
    Ok((running, ended))
}

/// Sends a process a signal, by its name.
pub fn signal(name: &str, id: u32) -> Result<()> {
    let id = id.to_string();
    let kill = ["-c", "kill -s \"$1\" \"$2\"", "sh", name, &id];
    let status = Command::new("sh").args(kill).status()?;
    ensure!(status.success(), "process {id} takes no signal");
    Ok(())
}

/// Returns the processes with this mark that are emulators. One that is dead but not waited for has no
/// environment left.
fn emulators(mark: &str) -> Vec<u32> {
    let mark = format!("{MARK}={mark}");
    let has = |folder: &Path| -> std::io::Result<bool> {
        let environment = fs::read(folder.join("environ"))?;
        let program = fs::read(folder.join("cmdline"))?;
        Ok(environment.split(|&byte| byte == 0).any(|variable| variable == mark.as_bytes())
            && String::from_utf8_lossy(&program).contains("qemu-system"))
    };
    let processes = fs::read_dir("/proc").expect("the emulated board needs Linux").flatten();
    processes
        .filter_map(|process| process.file_name().to_str()?.parse().ok())
        // Another user's process, or one that has ended in the meantime, cannot be read.
        .filter(|id: &u32| has(&Path::new("/proc").join(id.to_string())).unwrap_or(false))
        .collect()
}

/// A virtual bridge that serves.
pub struct BridgeProcess {
    /// The process of `cargo virtual`.
    pub command: Running,
    /// The process of its emulator.
    pub qemu: u32,
    address: String,
}

impl BridgeProcess {
    /// Starts `virtual` with these arguments on a free port and waits until it serves.
    pub fn start(arguments: &[&str]) -> Result<Self> {
        Self::start_at("127.0.0.1:0", arguments)
    }

    fn start_at(address: &str, arguments: &[&str]) -> Result<Self> {
        let mut xtask = xtask()?;
        xtask.args(["virtual", "--cnc", &format!("tcp:{address}")]).args(arguments);
        let mut command = Running::start(&mut xtask)?;
        let address = command.wait_for("the CNC's line is at tcp:", " ")?;
        let qemu = command.wait_for("the bridge is up in QEMU (process ", ")")?.parse()?;
        Ok(Self { command, qemu, address })
    }

    /// Starts the same with [`FAST_MACHINE`] and [`GROWN_RUN`], at this speed. The files are read before
    /// it serves.
    pub fn start_grown_at(speed: &str) -> Result<Self> {
        Self::start_grown_there("127.0.0.1:0", speed)
    }

    /// Starts the same in real time, where another one was.
    pub fn start_grown_at_address(address: &str) -> Result<Self> {
        Self::start_grown_there(address, "1")
    }

    fn start_grown_there(address: &str, speed: &str) -> Result<Self> {
        let folder = tempfile::tempdir()?;
        let machine = file(&folder, "machine.toml", FAST_MACHINE)?;
        let run = file(&folder, "run.csv", GROWN_RUN)?;
        Self::start_at(address, &["--machine", &machine, "--run", &run, "--speed", speed])
    }

    /// Starts the same in real time.
    pub fn start_grown() -> Result<Self> {
        Self::start_grown_at("1")
    }

    /// Where it listens: `HOST:PORT`.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Opens a client's connection, on which no wait is for ever.
    pub fn connect(&self) -> Result<TcpStream> {
        let stream = TcpStream::connect(&self.address)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(TIMEOUT))?;
        stream.set_write_timeout(Some(TIMEOUT))?;
        Ok(stream)
    }
}

/// Waits until what this client does not read has filled every buffer on the way, so that the
/// bridge is stuck behind it.
pub fn wait_until_stuck(deaf: &TcpStream) -> Result<()> {
    // Once nothing more comes, the queue before it is full within half of this.
    const REST: Duration = Duration::from_secs(2);
    let end = Instant::now() + START;
    let mut bytes = vec![0; 8 << 20];
    let mut before = 0;
    loop {
        let now = deaf.peek(&mut bytes)?;
        if now == before {
            return Ok(());
        }
        ensure!(Instant::now() < end, "{now} bytes wait, and it goes on");
        before = now;
        thread::sleep(REST);
    }
}

/// Writes a file; gives its path as an argument.
pub fn file(folder: &TempDir, name: &str, text: &str) -> Result<String> {
    let path = folder.path().join(name);
    fs::write(&path, text)?;
    path.into_os_string().into_string().ok().context("a path that is not UTF-8")
}
