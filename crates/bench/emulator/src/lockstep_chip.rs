//! The flashable image on the model of its chip, in lock-step with a world that this program plays: lines
//! of a script go to the model's standard input, and its time goes on only as far as it is let.

use std::{
    fs::File,
    io::{BufRead as _, BufReader, Read as _, Write as _},
    path::Path,
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    sync::{Arc, Mutex, PoisonError},
    thread,
};

use anyhow::{Context as _, Result, bail, ensure};

use crate::{
    chip::{create_log_pipe, parse_port},
    log::LogDecoder,
};

/// Lines that silence the model's own CNC: only the client of the serial line speaks for one.
const DISABLE_CNC_SCRIPT: &str = "0 control 0\n0 spindle 0\n0 positions 0\n";

/// A board that lives while it is let.
pub struct LockstepChip {
    child: Child,
    /// Closed to end it.
    world: Option<ChildStdin>,
    stdout: BufReader<ChildStdout>,
    port: u16,
    now_ms: u64,
    log: Arc<Mutex<Vec<String>>>,
    _folder: tempfile::TempDir,
}

impl LockstepChip {
    /// Starts a board with its power just switched on, whose serial line is a TCP port of this machine; 0: any
    /// free one.
    ///
    /// # Errors
    /// The model cannot be started, or the port is in use.
    pub fn start(model: &Path, image: &Path, port: u16) -> Result<Self> {
        let folder = tempfile::Builder::new().prefix("trueup-").tempdir()?;
        let (pipe, held) = create_log_pipe(folder.path())?;
        let mut child = Command::new(model)
            .arg(image)
            .args(["--bor", "--live", "--serial", &port.to_string(), "--rtt"])
            .arg(&pipe)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .context("cannot start the model of the chip")?;
        let log = Arc::new(Mutex::new(Vec::new()));
        let (decoder, source, lines) =
            (LogDecoder::from_image(image)?, File::open(&pipe)?, log.clone());
        thread::spawn(move || {
            let keep = |line| lines.lock().unwrap_or_else(PoisonError::into_inner).push(line);
            if let Err(error) = decoder.decode_stream(source, keep) {
                trueup_output::write_diagnostic(format_args!("the board's log ends: {error:#}"));
            }
        });
        let world = child.stdin.take();
        let stdout = child.stdout.take().context("its output was asked for")?;
        let mut board = Self {
            child,
            world,
            stdout: BufReader::new(stdout),
            port,
            now_ms: 0,
            log,
            _folder: folder,
        };
        let first = board.read_line()?;
        board.port = parse_port(&first)?;
        board.write_script(DISABLE_CNC_SCRIPT)?;
        // By its first answer it has opened its end of the pipe.
        board.advance(1)?;
        drop(held);
        Ok(board)
    }

    /// Where its serial line listens on this machine.
    #[must_use]
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Makes the world so from now on: what a line of a script says behind its time.
    ///
    /// # Errors
    /// The model has ended.
    pub fn apply_script_line(&mut self, what: &str) -> Result<()> {
        self.write_script(&format!("{} {what}\n", self.now_ms))
    }

    /// Lets the board live for this many milliseconds.
    ///
    /// # Errors
    /// The model has ended.
    pub fn advance(&mut self, ms: u64) -> Result<()> {
        self.now_ms += ms;
        self.write_script(&format!("{}\n", self.now_ms))?;
        let answer = self.read_line()?;
        let now = self.now_ms.to_string();
        ensure!(answer.trim() == now, "the model says {answer:?} for {now}");
        Ok(())
    }

    /// Returns what the image has logged since it was last asked.
    #[must_use]
    pub(crate) fn take_log(&self) -> Vec<String> {
        std::mem::take(&mut self.log.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Takes the board's power, and reads the model's report.
    ///
    /// # Errors
    /// The report has a violation: something was done that silicon would not do; with the report.
    pub fn power_off(mut self) -> Result<()> {
        drop(self.world.take());
        let mut report = String::new();
        self.stdout.read_to_string(&mut report)?;
        let status = self.child.wait()?;
        ensure!(status.success(), "the model of the chip objects:\n{report}");
        Ok(())
    }

    fn write_script(&mut self, text: &str) -> Result<()> {
        let world = self.world.as_mut().context("it has not ended")?;
        world.write_all(text.as_bytes()).context("the model of the chip has ended")
    }

    fn read_line(&mut self) -> Result<String> {
        let mut line = String::new();
        if self.stdout.read_line(&mut line)? == 0 {
            bail!("the model of the chip has ended");
        }
        Ok(line)
    }
}

impl Drop for LockstepChip {
    fn drop(&mut self) {
        // It may have ended already; there is nothing else to do about a failure here.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
