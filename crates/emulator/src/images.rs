//! The images that are handed out: those that an installed tool carries, and those of two firmware slots.

use std::{fs, path::PathBuf};

use anyhow::{Context as _, Result};

use crate::{
    firmware::{Board, Linked, build_as},
    setup,
    slots::{self, Flashable},
};

/// Returns the images that an installed tool carries, without a machine of anybody's: their folder.
///
/// # Errors
/// As [`firmware::build`](crate::firmware::build) and [`build_slots`].
pub fn carried() -> Result<PathBuf> {
    let folder = setup::root().join("target/carried");
    fs::create_dir_all(&folder)?;
    let mut images = Vec::new();
    for board in Board::ALL {
        let name = format!("carried-{}", board.feature());
        images.push((build_as(board, board.feature(), &name, Linked::Example)?, board.feature()));
    }
    let slots = slots::build_flashable(Linked::Example, "carried-slots", slots::version()?)?;
    images.push((slots.image, SLOTS));
    // Those of the chip have their plain bytes next to them, and that of two slots its update.
    for (image, name) in images {
        for kind in ["elf", "bin", "update"] {
            let built = image.with_extension(kind);
            if built.is_file() {
                let copy = folder.join(format!("trueup-{name}.{kind}"));
                fs::rename(&built, &copy).with_context(|| copy.display().to_string())?;
            }
        }
    }
    Ok(folder)
}

/// Name of the image with two firmware slots.
const SLOTS: &str = "stm32f405-slots";

/// Builds the image with two firmware slots, and the update of boards that have them.
///
/// # Errors
/// As [`slots::build_flashable_for`].
pub fn build_slots() -> Result<Flashable> {
    slots::build_flashable(Linked::Named, SLOTS, slots::version()?)
}
