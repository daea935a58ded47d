//! Builds the firmware images.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::Result;

use crate::{
    binary,
    compile::{Linked, PROGRAM, build_with, cargo_for, mark},
    process, seal,
    setup::{self, TARGET},
    slots,
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
    pub fn feature(self) -> &'static str {
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
pub fn cargo(verb: &str, board: Board) -> Result<(Command, PathBuf)> {
    cargo_for(verb, board.feature())
}

/// As [`cargo`], for the benchmark.
///
/// # Errors
/// As [`cargo`].
pub fn cargo_measure(verb: &str) -> Result<(Command, PathBuf)> {
    let (mut command, folder) = cargo_for(verb, "measure")?;
    command.args(["--bin", "trueup-measure"]);
    // What is compared with each other there stands in the firmware's own package, and is built for speed.
    command.args(["--config", "profile.firmware.package.trueup-firmware.opt-level=3"]);
    Ok((command, folder))
}

/// Builds the benchmark's image and gives its path.
///
/// # Errors
/// It does not compile, or there is no way to the target.
pub fn build_measure() -> Result<PathBuf> {
    let (mut command, folder) = cargo_measure("build")?;
    process::run(&mut command)?;
    Ok(folder.join(TARGET).join("firmware/trueup-measure"))
}

/// Builds the image of a board and gives its path; for the one that is flashed, boot program and slot A, its plain bytes
/// stand next to it (`.bin`).
///
/// # Errors
/// It does not compile, or there is no way to the target.
pub fn build(board: Board) -> Result<PathBuf> {
    match board {
        Board::Stm32f405 => slots::build_whole(Linked::Named, board.feature(), slots::version()?),
        Board::Virtual => build_virtual_for(board.feature(), Linked::Named),
    }
}

/// Builds the virtual board's image and gives its path; makes sure of QEMU, which runs it.
///
/// # Errors
/// As [`build`]; QEMU is missing and cannot be installed.
pub fn build_virtual() -> Result<PathBuf> {
    setup::qemu()?;
    build(Board::Virtual)
}

/// Builds the application alone, at the start of the flash and without slots, for a machine: what the tests run that ask
/// nothing of the boot program. Without a machine it has the example's constants, and gives no offset.
///
/// # Errors
/// As [`build`]; the machine file cannot be used.
pub fn build_for(machine: &Path) -> Result<PathBuf> {
    let name = format!("stm32f405-for-{}", mark(machine)?);
    build_application("stm32f405", &name, Linked::File(machine))
}

/// Builds the same with the feature `faults`: it breaks on command, and is never for a machine.
///
/// # Errors
/// As [`build_for`].
pub fn build_that_breaks(machine: &Path) -> Result<PathBuf> {
    let name = format!("stm32f405-faults-for-{}", mark(machine)?);
    build_application("faults", &name, Linked::File(machine))
}

/// Builds the virtual board's image, with the constants of `machine`.
pub(crate) fn build_virtual_for(name: &str, machine: Linked) -> Result<PathBuf> {
    let (mut command, folder) = cargo_for("build", Board::Virtual.feature())?;
    machine.tell(&mut command);
    build_with(command, &folder, PROGRAM, name, |_| Ok(()))
}

fn build_application(feature: &str, name: &str, machine: Linked) -> Result<PathBuf> {
    let (mut command, folder) = cargo_for("build", feature)?;
    machine.tell(&mut command);
    let image = build_with(command, &folder, PROGRAM, name, seal::seal)?;
    fs::write(image.with_extension("bin"), binary::of(&image)?)?;
    Ok(image)
}
