//! Builds the firmware images.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::Result;

use crate::{
    firmware_build::{
        FIRMWARE_PROGRAM, LinkedMachineFile, build_and_copy, cargo_command, hash_machine_file,
    },
    flash_image, image_check, process,
    setup::{self, TARGET_TRIPLE},
    slot_images,
};

/// The two boards, by the names of their features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Board {
    /// The flashable one.
    Stm32f405,
    /// The one for QEMU.
    Virtual,
}

impl Board {
    /// Both boards.
    pub const ALL: [Self; 2] = [Self::Stm32f405, Self::Virtual];

    /// Returns the feature that chooses this board.
    #[must_use]
    pub fn cargo_feature(self) -> &'static str {
        match self {
            Self::Stm32f405 => "stm32f405",
            Self::Virtual => "virtual",
        }
    }
}

/// Returns a cargo command that compiles for the board: `cargo <verb> --target … --features …`.
///
/// # Errors
/// There is no way to the target; see `crate::setup::toolchain`.
pub fn board_cargo_command(verb: &str, board: Board) -> Result<(Command, PathBuf)> {
    cargo_command(verb, board.cargo_feature())
}

/// As [`board_cargo_command`], for the benchmark.
///
/// # Errors
/// As [`board_cargo_command`].
pub fn benchmark_cargo_command(verb: &str) -> Result<(Command, PathBuf)> {
    let (mut command, folder) = cargo_command(verb, "measure")?;
    command.args(["--bin", "trueup-measure"]);
    // What is compared with each other there stands in the firmware's own package, and is built for speed.
    command.args(["--config", "profile.firmware.package.trueup-firmware.opt-level=3"]);
    Ok((command, folder))
}

/// Builds the benchmark's image and gives its path.
///
/// # Errors
/// It does not compile, or there is no way to the target.
pub fn build_benchmark_image() -> Result<PathBuf> {
    let (mut command, folder) = benchmark_cargo_command("build")?;
    process::run(&mut command)?;
    Ok(folder.join(TARGET_TRIPLE).join("firmware/trueup-measure"))
}

/// Builds the image of a board and gives its path; for the one that is flashed, boot program and slot A, its plain bytes
/// stand next to it (`.bin`).
///
/// # Errors
/// It does not compile, or there is no way to the target.
pub fn build_board_image(board: Board) -> Result<PathBuf> {
    match board {
        Board::Stm32f405 => slot_images::build_combined_image(
            LinkedMachineFile::Named,
            board.cargo_feature(),
            slot_images::firmware_version()?,
        ),
        Board::Virtual => {
            build_virtual_board_image_for_machine(board.cargo_feature(), LinkedMachineFile::Named)
        }
    }
}

/// Builds the virtual board's image and gives its path; makes sure of QEMU, which runs it.
///
/// # Errors
/// As [`build_board_image`]; QEMU is missing and cannot be installed.
pub fn build_virtual_board_image() -> Result<PathBuf> {
    setup::ensure_qemu()?;
    build_board_image(Board::Virtual)
}

/// Builds the application alone, at the start of the flash and without slots, for a machine: what the tests run that ask
/// nothing of the boot program. Without a machine it has the example's constants, and gives no offset.
///
/// # Errors
/// As [`build_board_image`]; the machine file cannot be used.
pub fn build_standalone_image(machine: &Path) -> Result<PathBuf> {
    let name = format!("stm32f405-for-{}", hash_machine_file(machine)?);
    build_application_image("stm32f405", &name, LinkedMachineFile::File(machine))
}

/// Builds the same with the feature `faults`: it breaks on command, and is never for a machine.
///
/// # Errors
/// As [`build_standalone_image`].
pub fn build_image_with_fault_injection(machine: &Path) -> Result<PathBuf> {
    let name = format!("stm32f405-faults-for-{}", hash_machine_file(machine)?);
    build_application_image("faults", &name, LinkedMachineFile::File(machine))
}

/// Builds the virtual board's image, with the constants of `machine`.
pub(crate) fn build_virtual_board_image_for_machine(
    name: &str,
    machine: LinkedMachineFile,
) -> Result<PathBuf> {
    let (mut command, folder) = cargo_command("build", Board::Virtual.cargo_feature())?;
    machine.apply_to(&mut command);
    build_and_copy(command, &folder, FIRMWARE_PROGRAM, name, |_| Ok(()))
}

fn build_application_image(
    feature: &str,
    name: &str,
    machine: LinkedMachineFile,
) -> Result<PathBuf> {
    let (mut command, folder) = cargo_command("build", feature)?;
    machine.apply_to(&mut command);
    let image =
        build_and_copy(command, &folder, FIRMWARE_PROGRAM, name, image_check::embed_image_check)?;
    fs::write(image.with_extension("bin"), flash_image::read_flash_image(&image)?)?;
    Ok(image)
}
