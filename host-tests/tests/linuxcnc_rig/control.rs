//! LinuxCNC with the sample configuration of `integrations/linuxcnc`, every servo cycle recorded.

use std::{fs, path::Path};

use anyhow::{Context as _, Result};
use trueup_emulator::{
    host_programs,
    linuxcnc::headless_linuxcnc::{DISPLAY_PROGRAM, HeadlessLinuxCnc},
    setup::{self, LockedLinuxCnc},
};

/// Recorder of every servo cycle; see [`super::samples`].
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
/// The file that gets a line every servo cycle.
pub const RECORDING: &str = "samples.txt";
/// File that both sample configurations include.
const INCLUDED: &str = "trueup_machine.inc";
/// After the screen has come.
const LATE: [&str; 2] = ["net scenario screen.scenario", "net trueup-zero screen.zero"];

/// Starts it with the bridge at this address, and with these files next to the samples.
pub fn start(
    linuxcnc: LockedLinuxCnc,
    bridge: &str,
    files: &[(&str, &str)],
) -> Result<HeadlessLinuxCnc> {
    let recorder = ("recorder.hal", RECORDER);
    let mut cnc = start_with(linuxcnc, "trueup_sim.ini", bridge, &[&[recorder], files].concat())?;
    for words in LATE {
        cnc.run_halcmd(words)?;
    }
    Ok(cnc)
}

/// Starts this sample configuration, with these files next to the samples; `FOLDER` in them is where they are. A
/// `recorder.hal` among them is loaded.
pub fn start_with(
    linuxcnc: LockedLinuxCnc,
    ini: &str,
    bridge: &str,
    files: &[(&str, &str)],
) -> Result<HeadlessLinuxCnc> {
    let folder = HeadlessLinuxCnc::create_config_folder()?;
    let path = |name: &str| folder.path().join(name);
    let here = folder.path().to_str().context("a temporary folder has a plain name")?;
    let samples = setup::project_root().join("integrations/linuxcnc");
    for entry in fs::read_dir(&samples)? {
        let entry = entry?;
        if entry.file_type()?.is_file() {
            fs::copy(entry.path(), path(&entry.file_name().to_string_lossy()))?;
        }
    }
    fs::copy(host_programs::build_trueup()?, path("trueup"))?;
    // LinuxCNC puts the two together itself.
    let records = files.iter().any(|(name, _)| *name == "recorder.hal");
    for (sample, name) in [(ini, "test.ini"), (INCLUDED, INCLUDED)] {
        let text = fs::read_to_string(samples.join(sample))?;
        fs::write(path(name), configuration(&text, folder.path(), bridge, records))?;
    }
    for (name, text) in files {
        fs::write(path(name), text.replace("FOLDER", here))?;
    }
    HeadlessLinuxCnc::start(folder, "test.ini", linuxcnc)
}

/// Returns the sample configuration with another screen and the recorder.
fn configuration(sample: &str, folder: &Path, bridge: &str, records: bool) -> String {
    let mut text = String::new();
    for line in sample.lines() {
        let key = line.split('=').next().unwrap_or_default().trim();
        match key {
            "DISPLAY" => text += &format!("DISPLAY = {}\n", folder.join(DISPLAY_PROGRAM).display()),
            // The emulated serial line is slow where the computer is busy.
            "POSITION_PERIOD_MS" => text += "POSITION_PERIOD_MS = 10\n",
            "PORT" => text += &format!("PORT = {bridge}\n"),
            // They belong to the screen that is not there.
            "PYVCP" | "POSTGUI_HALFILE" => {}
            _ => {
                text += line;
                text += "\n";
                if records && line.trim() == "HALFILE = trueup.hal" {
                    text += "HALFILE = recorder.hal\n";
                }
            }
        }
    }
    text
}
