//! The firmware images that this tool carries, and where else they may be.

use std::{fs, io, path::Path};

use anyhow::{Context as _, Result};

use crate::{UserError, output::FileTransaction};

/// The image for QEMU, which `trueup virtual` starts.
#[cfg(unix)]
pub const VIRTUAL_IMAGE_FILE: &str = "trueup-virtual.elf";

/// Name and bytes of each; none in a build for tests, or where they could not be built.
const EMBEDDED_IMAGES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/carried.rs"));
/// Where `cargo xtask images` puts them, in the tree that this tool was built from. A release build knows no folder
/// of the computer that built it, or it would be another file on each.
const IMAGE_BUILD_DIR: &str = if cfg!(debug_assertions) {
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../../target/carried")
} else {
    ""
};

/// Puts the images into a folder that there is, all of them or the one that is named, and gives their
/// names.
///
/// # Errors
/// This tool has none, or they cannot be written.
pub fn write_images(folder: &Path, requested: Option<&str>) -> Result<Vec<String>> {
    let mut written = Vec::new();
    let mut set = FileTransaction::new(&[]);
    let is_requested = |name: &str| requested.is_none_or(|requested| requested == name);
    for (name, bytes) in EMBEDDED_IMAGES.iter().filter(|(name, _)| is_requested(name)) {
        set.add(&folder.join(name), |out| out.write_all(bytes))?;
        written.push((*name).to_string());
    }
    if EMBEDDED_IMAGES.is_empty() {
        for entry in fs::read_dir(IMAGE_BUILD_DIR).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            if is_requested(&name) {
                let mut from = fs::File::open(entry.path())
                    .with_context(|| entry.path().display().to_string())?;
                set.add(&folder.join(&name), |mut out| io::copy(&mut from, &mut out))?;
                written.push(name);
            }
        }
    }
    if written.is_empty() {
        let reason = "this trueup carries no firmware: it is a build for tests, or the images could \
                      not be built with it. In the source tree `cargo xtask images` builds them and prints what is missing; then install again: cargo install --path crates/tool/cli";
        return Err(UserError(reason.into()).into());
    }
    set.commit()?;
    written.sort();
    Ok(written)
}
