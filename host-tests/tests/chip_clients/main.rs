//! The flashable image on the model of its chip, and those who talk to it: the clients that talk to the virtual
//! board, over the same serial line; and the same codes, for the same offsets.

#[path = "../support/mod.rs"]
mod support;

mod blocks;
mod command;

use std::{
    fs, thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use support::{FAST_MACHINE, chip::Chip, trueup};
use trueup_emulator::{chip::Line, seal};

/// What `bridge info` says first, on a computer that has better to do.
const PATIENCE: Duration = Duration::from_secs(60);
/// An hour: the test ends it before.
const LONG: [&str; 3] = ["--bor", "--ms", "3600000"];

/// What `trueup bridge info` prints.
fn info(port: u16) -> Result<String> {
    let port = format!("tcp:127.0.0.1:{port}");
    let output = trueup()?.args(["bridge", "info", "--port", &port]).output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{said}");
    Ok(String::from_utf8(output.stdout)?)
}

/// The same, once it has this.
fn info_with(port: u16, text: &str) -> Result<String> {
    let end = Instant::now() + PATIENCE;
    loop {
        let said = info(port);
        match said {
            Ok(said) if said.contains(text) => return Ok(said),
            said if Instant::now() > end => anyhow::bail!("no {text:?} in {said:?}"),
            _ => thread::sleep(Duration::from_millis(200)),
        }
    }
}

#[test]
fn bridge_info_names_what_ended_the_last_start_and_where() -> Result<()> {
    let Some(chip) = Chip::that_breaks(FAST_MACHINE)? else { return Ok(()) };
    // Built before a board waits for it.
    trueup()?;
    let key = seal::symbol(&chip.image, "TRUEUP_FAULT_KEY")?.context("it breaks")?;
    // What breaks by that number (`src/faults.rs`), and the words that name it.
    let cases: [(u32, &[&str]); 3] = [
        (6, &["last reset   watchdog, in task listen\n", "watchdog 1"]),
        (32, &["last reset   panic at src/faults.rs:", ", in task supervise\n", "panic 1"]),
        (33, &["last reset   hard-fault at pc 0x080", ", CFSR 0x02000000, in task supervise\n"]),
    ];
    let ends_as = |number: u32, words: &[&str]| {
        let script = chip.folder.path().join(format!("script-{number}"));
        fs::write(&script, format!("0 flags 2\n300 poke {key:x} {number:x}\n320 say V\\r\n"))?;
        let script = script.to_str().context("a plain name")?;
        let options = [&LONG[..], &["--script", script]].concat();
        let line = Line::start(&chip.model, &chip.image, &options)?;
        let said = info_with(line.port, words[0])?;
        println!("{said}");
        for word in words.iter().chain(&["power-on 1"]) {
            ensure!(said.contains(word), "{number}: no {word:?} in\n{said}");
        }
        Ok(())
    };
    thread::scope(|scope| {
        let ends_as = &ends_as;
        let all = cases.map(|(number, words)| scope.spawn(move || ends_as(number, words)));
        all.into_iter().try_for_each(|it| it.join().expect("it does not panic"))
    })
}
