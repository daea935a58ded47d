//! `trueup firmware`: the images for a board, and the keys to their logs.

use std::{fs, path::PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;

use crate::{CommandOutcome, embedded_images, output};

/// Writes the firmware images: .bin to be flashed, and .elf, which alone can read the log of a board
/// that runs it.
///
/// They are for any machine: load a calibration with `trueup bridge load`. How to flash: the book, First
/// power-on. The .update is for a board that has it already: `trueup bridge update`.
#[derive(Args)]
pub struct FirmwareArgs {
    /// The folder; it is made if there is none.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

/// Writes them.
pub fn run(args: &FirmwareArgs, as_json: bool) -> Result<CommandOutcome> {
    fs::create_dir_all(&args.folder).with_context(|| args.folder.display().to_string())?;
    output::print_written_files(
        &args.folder,
        &embedded_images::write_images(&args.folder, None)?,
        as_json,
    )?;
    Ok(CommandOutcome::Done)
}
