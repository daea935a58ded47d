//! The loop with a configuration that `run_trueup linuxcnc setup` has changed, as a user's: offsets at the joint, or without a board.

use std::{fmt::Write as _, fs, path::Path, process::Command};

use anyhow::{Context as _, Result, ensure};
use tempfile::TempDir;

use super::{
    BridgePlatform, CompensationRoute, OffsetEntryPoint, TIME_COMPRESSION, config,
    headless_linuxcnc::HeadlessLinuxCnc, machine_measurement::MeasuredMachine, plant::RunningPlant,
};
use crate::setup;

/// Brings lines from the machine to LinuxCNC's `streamer`.
const STREAMER_INPUT_SCRIPT: &str = "#!/bin/bash\nexec halstreamer < /dev/tcp/$1\n";

/// Starts LinuxCNC with it.
///
/// # Errors
/// Setup or LinuxCNC refuses; with its output.
pub fn start(
    plant: &RunningPlant,
    measured: &MeasuredMachine,
    way: CompensationRoute,
    folder: TempDir,
    control: setup::LockedLinuxCnc,
) -> Result<HeadlessLinuxCnc> {
    ensure!(
        way.on != BridgePlatform::Chip,
        "the model of the chip is slower than LinuxCNC's limits of offsets"
    );
    let path = |name: &str| folder.path().join(name);
    let here = folder.path().to_str().context("a temporary folder has a plain name")?.to_owned();
    let mut hal = config::machine_hal();
    for net in config::ANGLE_AND_LOAD_NETS {
        let _ = writeln!(hal, "net {net}");
    }
    let (machine, to_bridge) = match plant.servo_component() {
        Some((library, channels)) => {
            setup::ensure_linuxcnc_dev()?;
            let out = path("trueup_node");
            let words = ["linuxcnc", "component", "--install", "--out"];
            let library: &Path = library;
            run_trueup(&folder, |command| {
                command.args(words).arg(&out).arg("--library").arg(library)
            })?;
            hal += &inputs_hal(channels, &here, plant.address());
            (measured.time_compressed_machine_file(TIME_COMPRESSION)?, vec!["--no-board"])
        }
        None => (measured.text.clone(), vec!["--port", plant.address()]),
    };
    let texts = [
        ("loop.ini", config::ini_file(None, &here, 1)),
        ("machine.hal", hal),
        ("loop.hal", config::sampler_hal(way.by)),
        ("feed.sh", STREAMER_INPUT_SCRIPT.into()),
        ("machine.toml", machine),
    ];
    for (name, text) in texts.into_iter().chain(super::nc_programs_and_tool_table(1)) {
        fs::write(path(name), text)?;
    }
    let by = match way.by {
        OffsetEntryPoint::Eoffset => "eoffset",
        OffsetEntryPoint::Joint => "joint",
    };
    run_trueup(&folder, |command| {
        command
            .args(["linuxcnc", "setup", "--by", by])
            .arg(path("loop.ini"))
            .arg("--machine")
            .arg(path("machine.toml"))
            .args(&to_bridge)
    })?;
    // The bridge of the warm-up has other limits than the machine file.
    replace_in_file(
        &path("trueup.hal"),
        " --rotary",
        " --any-calibration --rotary",
        plant.servo_component().is_none(),
    )?;
    let ours = "HALFILE = trueup.hal\n";
    replace_in_file(&path("loop.ini"), ours, &format!("{ours}HALFILE = {here}/loop.hal\n"), true)?;
    HeadlessLinuxCnc::start(folder, "loop.ini", control)
}

/// The sensor and the thermometers, by the names that setup looks for.
fn inputs_hal(channels: &[u8], here: &str, address: &str) -> String {
    let mut text = format!(
        "loadrt streamer depth=4000 cfg={}\naddf streamer.0 servo-thread\n\
         loadusr bash {here}/feed.sh {}\nnet trueup-sensor-v streamer.0.pin.0\n",
        "f".repeat(channels.len() + 1),
        address.trim_start_matches("tcp:").replace(':', "/")
    );
    for (number, channel) in channels.iter().enumerate() {
        let _ = writeln!(text, "net trueup-temp-{channel:02} streamer.0.pin.{}", number + 1);
    }
    text
}

/// Runs the tool.
fn run_trueup(folder: &TempDir, of: impl FnOnce(&mut Command) -> &mut Command) -> Result<()> {
    let mut command = Command::new(folder.path().join("trueup"));
    let done = of(&mut command).output()?;
    ensure!(
        done.status.success(),
        "{command:?}: {}{}",
        String::from_utf8_lossy(&done.stdout),
        String::from_utf8_lossy(&done.stderr)
    );
    Ok(())
}

/// Replaces a text of a file, which is there if `is_there`.
fn replace_in_file(path: &Path, from: &str, to: &str, is_there: bool) -> Result<()> {
    let text = fs::read_to_string(path)?;
    ensure!(text.contains(from) == is_there, "{} in {}:\n{text}", from.trim(), path.display());
    Ok(fs::write(path, text.replacen(from, to, 1))?)
}
