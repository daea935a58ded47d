//! The images that are handed out: those that an installed tool carries, and those of a machine and a key of one's own.

use std::{fs, path::PathBuf};

use anyhow::{Context as _, Result};

use crate::{
    firmware_build::LinkedMachineFile,
    firmware_images::{self, Board},
    setup,
    slot_images::{self, FlashableFiles},
};

/// Returns the images that an installed tool carries, without a machine of anybody's: their folder.
///
/// # Errors
/// As [`firmware_images::build_board_image`] and [`build_flashable_files`].
pub fn build_bundled_images() -> Result<PathBuf> {
    let folder = setup::project_root().join("target/carried");
    fs::create_dir_all(&folder)?;
    let [chip, simulated] = Board::ALL.map(Board::cargo_feature);
    let flashable = slot_images::build_flashable_files(
        LinkedMachineFile::Example,
        &format!("carried-{chip}"),
        slot_images::firmware_version()?,
    )?;
    let simulator = firmware_images::build_virtual_board_image_for_machine(
        &format!("carried-{simulated}"),
        LinkedMachineFile::Example,
    )?;
    let mut copies = Vec::new();
    // The one of the chip has its plain bytes and its update next to it.
    for (image, name) in [(flashable.image, chip), (simulator, simulated)] {
        for kind in ["elf", "bin", "update"] {
            let built = image.with_extension(kind);
            if built.is_file() {
                let copy = folder.join(format!("trueup-{name}.{kind}"));
                fs::rename(&built, &copy).with_context(|| copy.display().to_string())?;
                copies.push(copy);
            }
        }
    }
    // Images of an older version.
    for other in fs::read_dir(&folder)?.flatten().filter(|entry| !copies.contains(&entry.path())) {
        fs::remove_file(other.path())?;
    }
    Ok(folder)
}

/// Builds the image that is flashed, and the update of boards that have it.
///
/// # Errors
/// As [`slot_images::build_flashable_files_for_machine`].
pub fn build_flashable_files() -> Result<FlashableFiles> {
    slot_images::build_flashable_files(
        LinkedMachineFile::Named,
        Board::Stm32f405.cargo_feature(),
        slot_images::firmware_version()?,
    )
}
