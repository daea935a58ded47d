//! `cargo xtask chip` as a user starts it: its log decoded, its serial line on a port, a fault by option.

use std::{
    io::{BufRead as _, BufReader},
    os::unix::process::CommandExt as _,
    process::{Child, Command, ExitStatus, Stdio},
};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::{chip, setup};

use super::{
    info_with,
    support::{trueup, xtask},
};

/// Script of python-can that prints the identifiers in this many frames of a bridge.
const HEAR: &str = "import can, sys\n\
    with can.Bus(interface='slcan', channel=sys.argv[1], bitrate=1_000_000, sleep_after_open=0.0) as bus:\n\
    \x20   print(sorted({bus.recv(timeout=30).arbitration_id for _ in range(300)}))\n";

/// A command and all that it has started, as a terminal has them.
struct Terminal(Child);

impl Terminal {
    fn signal(&self, name: &str) -> Result<ExitStatus> {
        let kill = ["-c", "kill -s \"$0\" -- \"-$1\"", name, &self.0.id().to_string()];
        Ok(Command::new("sh").args(kill).stderr(Stdio::null()).status()?)
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // They have usually ended long ago.
        self.signal("KILL").ok();
        self.0.wait().ok();
    }
}

#[test]
fn xtask_chip_shows_the_log_and_serves_any_slcan_client_with_a_dead_crystal() -> Result<()> {
    if !chip::is_compiler_supported()? {
        println!("skipped: the model of the chip needs a newer compiler");
        return Ok(());
    }
    // There before a board waits for it.
    trueup()?;
    let python = setup::ensure_python()?;
    let mut terminal = Terminal(
        // The parent process may have had Ctrl-C ignored, which is inherited.
        Command::new("env")
            .arg("--default-signal=INT")
            .arg(xtask()?.get_program())
            .args(["chip", "--bor", "--hse-dead", "--serial", "0"])
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()?,
    );
    let mut lines = BufReader::new(terminal.0.stdout.take().context("asked for")?).lines();
    let line = lines.find(|line| line.as_ref().is_ok_and(|line| line.starts_with("serial: ")));
    let line = line.context("it says where its line is")??;
    let port: u16 = line.rsplit(':').next().and_then(|part| part.parse().ok()).context(line)?;
    // A reader that does not read holds it up.
    let log_lines = std::thread::spawn(move || lines.map_while(Result::ok).collect::<Vec<_>>());

    // A message before the board is up is lost, as on a wire.
    let degraded = ["heartbeat", "crystal", "fall-back-clock", "board-degraded", "on STM32F405"];
    println!("{}", info_with(port, &degraded)?);
    let received =
        Command::new(python).args(["-c", HEAR, &format!("socket://127.0.0.1:{port}")]).output()?;
    ensure!(received.status.success(), "{}", String::from_utf8_lossy(&received.stderr));
    // The offsets, and what comes ten times a second. Of its faults an emergency may still come, where the model is slow.
    let received = String::from_utf8(received.stdout)?;
    let regular = received.replacen("[129, ", "[", 1);
    ensure!(regular.trim() == "[385, 641, 897, 1793]", "{received}");

    // Ctrl-C is for all of a terminal; its end of the pipe is closed when nobody is left.
    ensure!(terminal.signal("INT")?.success(), "it takes the signal");
    terminal.0.wait()?;
    let log_lines = log_lines.join().expect("nobody panics").join("\n");
    for text in ["dead: crystal", "trueup bridge 0.2.0 is up"] {
        ensure!(log_lines.contains(text), "no {text:?} in\n{log_lines}");
    }
    Ok(())
}
