//! Compiles a program of the firmware's package for the board, and gives its image a name of its own.

use std::{
    fs::{self, File},
    hash::{DefaultHasher, Hash as _, Hasher as _},
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result};
use rustix::fs::{FlockOperation, flock};

use crate::{
    process,
    setup::{self, TARGET_TRIPLE, Toolchain},
};

/// The firmware's program.
pub(crate) const FIRMWARE_PROGRAM: &str = "trueup-firmware";
/// Names the machine file that is linked into an image.
const MACHINE_FILE_ENV_VAR: &str = "TRUEUP_MACHINE";

/// Which machine file is linked in.
#[derive(Clone, Copy)]
pub(crate) enum LinkedMachineFile<'a> {
    /// The one that the user has named in the environment, if any.
    Named,
    /// The example, whatever the environment says: it never gives an offset.
    Example,
    File(&'a Path),
}

/// Returns a cargo command that compiles for the board with this feature, and the folder that it builds in.
///
/// # Errors
/// There is no way to the target; see [`setup::ensure_toolchain`].
pub(crate) fn cargo_command(verb: &str, feature: &str) -> Result<(Command, PathBuf)> {
    let root = setup::project_root();
    let (mut command, folder) = match setup::ensure_toolchain()? {
        Toolchain::Rustup => (process::new_cargo_command(), root.join("target")),
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
            TARGET_TRIPLE,
        ])
        .args(["--features", feature, "--target-dir"])
        .arg(&folder)
        .current_dir(root);
    Ok((command, folder))
}

/// Part of the name of an image for this machine file: two programs that build for two machines at once do not
/// overwrite each other's, and for one machine there is one image.
pub(crate) fn hash_machine_file(machine: &Path) -> Result<String> {
    let text = fs::read(machine).with_context(|| machine.display().to_string())?;
    let mut hasher = DefaultHasher::new();
    text.hash(&mut hasher);
    Ok(format!("{:016x}", hasher.finish()))
}

impl LinkedMachineFile<'_> {
    /// Has a build link it in.
    pub(crate) fn apply_to(self, command: &mut Command) {
        match self {
            LinkedMachineFile::Named => command,
            LinkedMachineFile::Example => command.env_remove(MACHINE_FILE_ENV_VAR),
            LinkedMachineFile::File(machine) => command.env(MACHINE_FILE_ENV_VAR, machine),
        };
    }
}

/// Runs a build, and gives a copy of the program a name of its own: an image is also the key to its log. `finish` receives
/// the copy before anybody else sees it.
pub(crate) fn build_and_copy(
    mut command: Command,
    folder: &Path,
    program: &str,
    name: &str,
    finish: impl FnOnce(&Path) -> Result<()>,
) -> Result<PathBuf> {
    let images = folder.join("images");
    fs::create_dir_all(&images)?;
    // Cargo gives all images of a program the same file name, so no other process may build until the copy is made; the lock
    // ends with the file.
    let lock = File::create(images.join("lock"))?;
    flock(&lock, FlockOperation::LockExclusive)?;
    process::run(&mut command)?;
    let built = folder.join(TARGET_TRIPLE).join("firmware").join(program);
    // It is put in place in one step, because another command may be reading the old one just now.
    let copy = tempfile::NamedTempFile::new_in(&images)?;
    fs::copy(&built, &copy).with_context(|| format!("{} is missing", built.display()))?;
    let image = images.join(format!("trueup-{name}.elf"));
    finish(copy.path())?;
    copy.persist(&image)?;
    Ok(image)
}
