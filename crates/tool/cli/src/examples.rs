//! `trueup examples`: machine files, runs and what the controls need, out of the tool itself.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result};
use clap::Args;

use crate::{CommandOutcome, UserError, output};

/// A folder's files: their name below the folder of the examples, and their bytes.
macro_rules! files {
    ($from:literal => $to:literal: $($name:literal)*) => {
        &[$((concat!($to, $name), include_bytes!(concat!("../../../../", $from, $name)))),*]
    };
}

/// The files to write.
const EXAMPLE_FILES: &[&[(&str, &[u8])]] = &[
    files!("data/" => "": "README.md" "gantry.toml" "paper_spindle.toml" "scenario-axis.toml"
        "scenario-lathe.toml" "scenario-mill.toml" "scenario-warmup.toml" "spindle_paper_table1.csv"),
    files!("data/mill/" => "mill/": "README.md" "axis-heat-x.csv" "backlash-x.csv" "balls.csv" "circle-ccw.csv" "circle-cw.csv"
        "diagonal-xy.csv" "mill.toml" "pitch-x.csv" "straightness-x.csv" "straightness-y.csv" "volume.toml" "warmup-off.csv"
        "warmup-on.csv"),
    files!("data/mill/years/" => "mill/years/": "2024-11-04-backlash-x.csv" "2025-05-05-backlash-x.csv"
        "2025-11-03-backlash-x.csv"),
    files!("integrations/linuxcnc/" => "linuxcnc/": "M110" "README.md" "simulated_gantry.hal" "simulated_lathe.hal"
        "trueup.hal" "trueup_lathe.hal" "trueup_lathe.ini" "trueup_lathe.toml"
        "trueup_gantry.toml" "trueup_machine.inc" "trueup_message.hal" "trueup_panel.hal"
        "trueup_panel.xml" "trueup_probe.ngc" "trueup_serial.ini" "trueup_sim.ini" "trueup_sim.tbl"
        "trueup_touch_off.ngc" "trueup_warmup.csv" "trueup_watchdog.hal"),
    files!("integrations/siemens-840d/" => "siemens-840d/": "README.md" "trueup_crc.awl"
        "trueup_db.awl" "trueup_fb.awl" "trueup_ob1.awl" "trueup_ob1_slope.awl" "trueup_step.awl"),
    files!("integrations/fanuc/" => "fanuc/": "README.md" "trueup_pmc.txt"),
    files!("integrations/modbus/" => "modbus/": "README.md" "mb2hal.ini" "mb2hal_rtu.ini" "trueup-gateway.service"),
    files!("crates/board/link/" => "wire/": "trueup.dbc"),
    files!("crates/board/canopen/" => "wire/": "trueup.eds"),
];

/// Writes examples: machine files, runs, scenarios, and the files for LinuxCNC, SINUMERIK, FANUC, Modbus
/// and the wire. The examples in the help of each command run in that folder.
#[derive(Args)]
pub struct ExamplesArgs {
    /// The folder; it is made if there is none. No file in it is overwritten.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

/// Writes them.
pub fn run(args: &ExamplesArgs, as_json: bool) -> Result<CommandOutcome> {
    let files = || EXAMPLE_FILES.iter().copied().flatten();
    // Nothing is written before it is known that all can be.
    let is_other = |path: &Path, bytes: &[u8]| fs::read(path).is_ok_and(|there| there != bytes);
    for (name, bytes) in files() {
        let path = args.folder.join(name);
        if is_other(&path, bytes) {
            let reason = format!("{}: it is there already, and not the example", path.display());
            return Err(UserError(reason).into());
        }
    }
    for (name, bytes) in files() {
        let path = args.folder.join(name);
        let folder = path.parent().unwrap_or(&args.folder);
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        output::write_atomically(&path, &[], |out| out.write_all(bytes))?;
        if bytes.starts_with(b"#!") {
            make_executable(&path).with_context(|| path.display().to_string())?;
        }
    }
    let names: Vec<String> = files().map(|(name, _)| (*name).to_string()).collect();
    output::print_written_files(&args.folder, &names, as_json)?;
    Ok(CommandOutcome::Done)
}

/// LinuxCNC runs an M-code only if everybody may.
#[cfg(unix)]
fn make_executable(path: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    fs::set_permissions(path, fs::Permissions::from_mode(0o755))
}

#[cfg(not(unix))]
fn make_executable(_: &Path) -> std::io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_of_a_folder_is_among_the_examples() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
        let carried: Vec<&str> =
            EXAMPLE_FILES.iter().copied().flatten().map(|(name, _)| *name).collect();
        for (folder, to) in [
            ("data", ""),
            ("data/mill", "mill/"),
            ("data/mill/years", "mill/years/"),
            ("integrations/linuxcnc", "linuxcnc/"),
            ("integrations/siemens-840d", "siemens-840d/"),
            ("integrations/fanuc", "fanuc/"),
            ("integrations/modbus", "modbus/"),
        ] {
            for entry in fs::read_dir(root.join(folder)).expect("a folder of the project") {
                let entry = entry.expect("readable");
                if entry.path().is_dir() {
                    continue;
                }
                let name = entry.file_name().to_string_lossy().into_owned();
                assert!(carried.contains(&format!("{to}{name}").as_str()), "{folder}/{name}");
            }
        }
    }
}
