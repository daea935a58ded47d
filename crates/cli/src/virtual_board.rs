//! `trueup virtual`: a running bridge without hardware, its firmware in QEMU.

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use anyhow::{Context as _, Result};
use clap::Args;
use trueup_emulator::{
    process,
    replay::DEFAULT_ROW_S,
    setup::QEMU,
    virtual_bridge::{self, Played, Settings},
};
use trueup_machine::{MachineFile, RunFile};

use crate::{Outcome, UserError, carried};

/// Runs a virtual bridge for any client, until Ctrl-C: the real firmware in QEMU, its line on a TCP port.
///
/// A run file plays the machine, from the moment a client opens the channel on; or another program does,
/// a plant. QEMU is needed: apt install qemu-system-arm.
#[derive(Args)]
#[command(after_help = "For instance:\n  \
    trueup examples try\n  \
    trueup virtual --machine try/paper_spindle.toml --run try/spindle_paper_table1.csv\n  \
    then, elsewhere: trueup bridge monitor --port tcp:127.0.0.1:3333")]
pub struct Virtual {
    /// The machine file.
    #[arg(long, value_name = "M.toml")]
    machine: PathBuf,
    /// Where the bridge listens for the CNC (SLCAN).
    #[arg(long, value_name = "tcp:HOST:PORT", default_value = "tcp:127.0.0.1:3333")]
    cnc: String,
    /// The run file to replay; its last row is held.
    #[arg(long, value_name = "R.csv", conflicts_with = "plant", required_unless_present = "plant")]
    run: Option<PathBuf>,
    /// Board time in multiples of real time, or "max".
    #[arg(long, value_name = "N", default_value = "1", value_parser = speed)]
    speed: Speed,
    /// Seconds that a row lasts in a run file without time_s.
    #[arg(long, value_name = "S", default_value_t = DEFAULT_ROW_S)]
    row_s: f64,
    /// Where a plant listens that plays the machine, in JSON lines.
    #[arg(long, value_name = "tcp:HOST:PORT")]
    plant: Option<String>,
    /// Seed of the front end's noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Another firmware image for QEMU than the one that this tool carries.
    #[arg(long, value_name = "FILE.elf")]
    image: Option<PathBuf>,
}

/// Multiples of real time; `None`: as fast as it goes.
#[derive(Clone, Copy)]
struct Speed(Option<f64>);

fn speed(text: &str) -> Result<Speed, String> {
    match (text, text.parse::<f64>()) {
        ("max", _) => Ok(Speed(None)),
        (_, Ok(speed)) if speed > 0.0 && speed.is_finite() => Ok(Speed(Some(speed))),
        _ => Err("a speed is a number above 0, or \"max\"".into()),
    }
}

/// Runs it.
pub fn run(args: &Virtual) -> Result<Outcome> {
    if process::find(QEMU).is_none() {
        let reason =
            format!("{QEMU} is not on PATH; on Debian and Ubuntu: sudo apt install {QEMU}");
        return Err(UserError(reason).into());
    }
    let machine = MachineFile::read(&args.machine)?;
    let played = match (&args.run, &args.plant) {
        (Some(path), _) => {
            let run = RunFile::read(path)?;
            Played::Run { run, row_s: args.row_s, speed: args.speed.0 }
        }
        (None, plant) => Played::Plant { address: plant.clone().unwrap_or_default() },
    };
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).context("signal handler")?;
    // It goes with this command.
    let folder = tempfile::Builder::new().prefix("trueup-image-").tempdir()?;
    let image = || match &args.image {
        Some(image) => Ok(image.clone()),
        None => {
            carried::write(folder.path(), Some(carried::VIRTUAL))?;
            Ok(folder.path().join(carried::VIRTUAL))
        }
    };
    let settings = Settings { cnc: args.cnc.clone(), played, seed: args.seed };
    virtual_bridge::run(&machine, settings, image, stop)?;
    Ok(Outcome::Done)
}
