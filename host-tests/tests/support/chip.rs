//! A flashable image for a machine of the test's on the model of its chip.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::Result;
use tempfile::TempDir;
use trueup_emulator::{
    chip::{self, ModelRunReport},
    firmware_images,
};

/// The model, the image of a machine, and a folder for what they need.
pub struct Chip {
    /// The model's program.
    pub model: PathBuf,
    /// The image.
    pub image: PathBuf,
    /// For files of the test.
    pub folder: TempDir,
}

impl Chip {
    /// Returns the image of this machine; `None`: the compiler is too old for the model.
    pub fn of_machine(text: &str) -> Result<Option<Self>> {
        Self::built(text, firmware_images::build_standalone_image)
    }

    /// Returns the same that breaks on command.
    pub fn that_breaks(text: &str) -> Result<Option<Self>> {
        Self::built(text, firmware_images::build_image_with_fault_injection)
    }

    fn built(text: &str, build: fn(&Path) -> Result<PathBuf>) -> Result<Option<Self>> {
        let Some(model) = chip::build_model()? else {
            println!("skipped: the model of the chip needs a newer compiler");
            return Ok(None);
        };
        let folder = tempfile::tempdir()?;
        let machine = folder.path().join("machine.toml");
        fs::write(&machine, text)?;
        let image = build(&machine)?;
        Ok(Some(Self { model, image, folder }))
    }

    /// Lets it live for so long in a world by script.
    pub fn live(&self, ms: u32, script: &str, options: &[&str]) -> Result<ModelRunReport> {
        let file = tempfile::NamedTempFile::new_in(&self.folder)?;
        fs::write(&file, script)?;
        let (ms, path) = (ms.to_string(), file.path().to_string_lossy());
        let own = ["--bor", "--ms", &ms, "--script", &path];
        chip::run(&self.model, &self.image, &[&own[..], options].concat())
    }
}
