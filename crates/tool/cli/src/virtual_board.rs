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
use trueup_virtual_bridge::{BridgeOptions, program, qemu::QEMU_PROGRAM as QEMU};

use crate::{CommandOutcome, UserError, embedded_images, input_files};

/// Runs a virtual bridge for any client, until Ctrl-C: the real firmware in QEMU, its line on a TCP port.
///
/// A run file plays the machine, from the moment a client opens the channel on; or another program does,
/// a plant. QEMU is needed: apt install qemu-system-arm.
#[derive(Args)]
#[command(after_help = "For instance:\n  \
    trueup examples try\n  \
    trueup virtual --machine try/paper_spindle.toml --run try/spindle_paper_table1.csv\n  \
    then, elsewhere: trueup bridge monitor --port tcp:127.0.0.1:3333")]
pub struct VirtualArgs {
    /// The machine file.
    #[arg(long, value_name = "M.toml")]
    machine: PathBuf,
    #[command(flatten)]
    options: BridgeOptions,
    /// Another firmware image for QEMU than the one that this tool carries.
    #[arg(long, value_name = "FILE.elf")]
    image: Option<PathBuf>,
}

/// Runs it.
pub fn run(args: &VirtualArgs) -> Result<CommandOutcome> {
    if program::find_on_path(QEMU).is_none() {
        let reason =
            format!("{QEMU} is not on PATH; on Debian and Ubuntu: sudo apt install {QEMU}");
        return Err(UserError(reason).into());
    }
    let machine = input_files::read_machine(&args.machine)?;
    // Clients wait for the board's time, which must not wait for a terminal.
    trueup_output::enable_background_output();
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).context("signal handler")?;
    // It is removed at the end of this command.
    let folder = tempfile::Builder::new().prefix("trueup-image-").tempdir()?;
    let image = || match &args.image {
        Some(image) => Ok(image.clone()),
        None => {
            embedded_images::write_images(
                folder.path(),
                Some(embedded_images::VIRTUAL_IMAGE_FILE),
            )?;
            Ok(folder.path().join(embedded_images::VIRTUAL_IMAGE_FILE))
        }
    };
    trueup_virtual_bridge::run(&machine, &args.options, image, stop)?;
    Ok(CommandOutcome::Done)
}
