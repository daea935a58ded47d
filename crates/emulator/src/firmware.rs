//! Builds the firmware images.

use std::{
    fs::{self, File},
    hash::{DefaultHasher, Hash as _, Hasher as _},
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result};
use rustix::fs::{FlockOperation, flock};

use crate::{
    binary, process, seal,
    setup::{self, TARGET, Toolchain},
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

/// The firmware's program.
pub(crate) const PROGRAM: &str = "trueup-firmware";
/// Names the machine file that is linked into an image.
const MACHINE_VARIABLE: &str = "TRUEUP_MACHINE";

/// Which machine file is linked in.
#[derive(Clone, Copy)]
pub(crate) enum Linked<'a> {
    /// The one that the user has named in the environment, if any.
    Named,
    /// The example, whatever the environment says: it never gives an offset.
    Example,
    File(&'a Path),
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
/// There is no way to the target; see [`setup::toolchain`].
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

pub(crate) fn cargo_for(verb: &str, feature: &str) -> Result<(Command, PathBuf)> {
    let root = setup::root();
    let (mut command, folder) = match setup::toolchain()? {
        Toolchain::Rustup => (process::cargo(), root.join("target")),
        Toolchain::Distribution => {
            let mut command = Command::new("/usr/bin/cargo");
            command.env("RUSTC", "/usr/bin/rustc").env("RUSTC_BOOTSTRAP", "1");
            command.env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", "ld.lld");
            command.env_remove("RUSTUP_TOOLCHAIN").env_remove("CARGO");
            (command, root.join("target/distribution"))
        }
    };
    let distribution = folder.ends_with("distribution");
    command.arg(verb);
    if distribution {
        command.arg("-Zbuild-std=core");
    }
    command
        .args([
            "--locked",
            "--package",
            "trueup-firmware",
            "--profile",
            "firmware",
            "--target",
            TARGET,
        ])
        .args(["--features", feature, "--target-dir"])
        .arg(&folder)
        .current_dir(root);
    Ok((command, folder))
}

/// Builds the image of a board and gives its path; for the one that is flashed, boot program and slot A, its plain bytes
/// stand next to it (`.bin`).
///
/// # Errors
/// It does not compile, or there is no way to the target.
pub fn build(board: Board) -> Result<PathBuf> {
    match board {
        Board::Stm32f405 => slots::build_whole(Linked::Named, board.feature(), slots::version()?),
        Board::Virtual => build_virtual(board.feature(), Linked::Named),
    }
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

/// Part of the name of an image for this machine file: two programs that build for two machines at once do not
/// overwrite each other's, and for one machine there is one image.
pub(crate) fn mark(machine: &Path) -> Result<String> {
    let text = fs::read(machine).with_context(|| machine.display().to_string())?;
    let mut hasher = DefaultHasher::new();
    text.hash(&mut hasher);
    Ok(format!("{:016x}", hasher.finish()))
}

impl Linked<'_> {
    /// Has a build link it in.
    pub(crate) fn tell(self, command: &mut Command) {
        match self {
            Linked::Named => command,
            Linked::Example => command.env_remove(MACHINE_VARIABLE),
            Linked::File(machine) => command.env(MACHINE_VARIABLE, machine),
        };
    }
}

/// Builds the virtual board's image.
pub(crate) fn build_virtual(name: &str, machine: Linked) -> Result<PathBuf> {
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

/// Runs a build, and gives a copy of the program a name of its own: an image is also the key to its log. `finish` receives
/// the copy before anybody else sees it.
pub(crate) fn build_with(
    mut command: Command,
    folder: &Path,
    program: &str,
    name: &str,
    finish: impl FnOnce(&Path) -> Result<()>,
) -> Result<PathBuf> {
    let images = folder.join("images");
    fs::create_dir_all(&images)?;
    // Cargo gives all images of a program the same file name, so nobody else may build until the copy is made; the lock
    // ends with the file.
    let lock = File::create(images.join("lock"))?;
    flock(&lock, FlockOperation::LockExclusive)?;
    process::run(&mut command)?;
    let built = folder.join(TARGET).join("firmware").join(program);
    // It is put in place in one step, because another command may be reading the old one just now.
    let copy = tempfile::NamedTempFile::new_in(&images)?;
    fs::copy(&built, &copy).with_context(|| format!("{} is missing", built.display()))?;
    let image = images.join(format!("trueup-{name}.elf"));
    finish(copy.path())?;
    copy.persist(&image)?;
    Ok(image)
}
