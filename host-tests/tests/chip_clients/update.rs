//! `trueup bridge update` against the whole image with two slots, on the model of its chip: there, interrupted, and back.

use std::{
    fs,
    path::Path,
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use trueup_boot::image_header::FirmwareVersion;
use trueup_emulator::{
    chip::{self, RunningChipModel},
    slot_images,
};

use crate::{LONG, info_with, support::FAST_MACHINE, trueup};

/// A board takes 10 s for the whole, 2 of them for the erase.
const BEFORE_KILL: Duration = Duration::from_secs(9);

/// The machine's file for the images.
fn machine(folder: &Path) -> Result<std::path::PathBuf> {
    let machine = folder.join("machine.toml");
    fs::write(&machine, FAST_MACHINE)?;
    Ok(machine)
}

/// Starts an update with this file.
fn update(port: u16, file: &Path) -> Result<Command> {
    let mut command = trueup()?;
    command.args(["bridge", "update", "--yes", "--port", &format!("tcp:127.0.0.1:{port}")]);
    command.arg(file).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    Ok(command)
}

/// Returns what it prints; an error, if it ends with one.
fn whole_update(port: u16, file: &Path) -> Result<String> {
    let output = update(port, file)?.output()?;
    let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{stdout}{errors}");
    Ok(stdout + &errors)
}

fn kill(mut child: Child) -> Result<()> {
    child.kill()?;
    child.wait()?;
    Ok(())
}

#[test]
#[ignore = "long: two updates, as slow as the model is"]
fn the_tool_updates_a_board_goes_on_after_a_kill_and_the_old_file_is_refused() -> Result<()> {
    let Some(model) = chip::build_model()? else { return Ok(()) };
    let folder = tempfile::tempdir()?;
    let machine = machine(folder.path())?;
    let [old, new] = [1, 2].map(|patch| {
        slot_images::build_flashable_files_for_machine(
            &machine,
            FirmwareVersion::new(0, 9, patch, 0),
        )
    });
    let (old, new) = (old?, new?);
    trueup()?;
    let options = [&LONG[..], &["--no-cnc"]].concat();
    let line = RunningChipModel::start(&model, &old.image, &options)?;
    println!("{}", info_with(line.port, &["0.9.1"])?);

    // The tool is killed in the middle of the image.
    let mut child = update(line.port, &new.update)?.spawn()?;
    thread::sleep(BEFORE_KILL);
    if child.try_wait()?.is_some() {
        println!("this computer is faster than a board: it was not killed");
    } else {
        kill(child)?;
        let began = Instant::now();
        let output_text = whole_update(line.port, &new.update).context("after the kill")?;
        println!("{output_text}\nafter {:.0} s", began.elapsed().as_secs_f64());
    }
    println!("{}", info_with(line.port, &["0.9.2", "on trial"])?);

    // What is older than the one that runs is refused before anything is erased.
    let refused = whole_update(line.port, &old.update).expect_err("it is older").to_string();
    println!("{refused}");
    ensure!(refused.contains("newer"), "{refused}");
    Ok(())
}
