//! The Debian package of the host tool: `cargo xtask deb`.
//!
//! It has the tool, which carries firmware, examples and the controls' files in itself, its manual's
//! pages and what shells complete it with. What goes where stands in the tool's own manifest.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::{firmware, process, setup};

use crate::cargo;

/// The version that the manifest is written for.
const CARGO_DEB: &str = "3.8.0";

/// Builds the package into `target/debian` and gives its path.
///
/// # Errors
/// The firmware or the tool does not build, or cargo-deb cannot be had or fails.
pub fn package() -> Result<PathBuf> {
    // Before the tool, which takes what is there.
    firmware::carried()?;
    process::run(cargo::locked("build").args(["--release", "--package", "trueup-cli"]))?;
    let root = setup::root();
    describe(&root.join("target/release/trueup"), &root.join("target/deb"))?;
    let cargo_deb = cargo::tool("cargo-deb", CARGO_DEB)?;
    let mut make = Command::new(cargo_deb);
    make.args(["--no-build", "--package", "trueup-cli", "--output"])
        .arg(root.join("target/debian"));
    process::run(make.current_dir(&root))?;
    let packages = fs::read_dir(root.join("target/debian"))?.flatten().map(|entry| entry.path());
    let packages = packages.filter(|path| path.extension().is_some_and(|kind| kind == "deb"));
    let newest = packages.max_by_key(|path| fs::metadata(path).and_then(|it| it.modified()).ok());
    newest.context("cargo-deb has left no package")
}

/// Lets a tool write its manual's pages and completions, and checks that it carries the firmware.
fn describe(tool: &Path, folder: &Path) -> Result<()> {
    if folder.is_dir() {
        fs::remove_dir_all(folder)?;
    }
    fs::create_dir_all(folder)?;
    process::output(Command::new(tool).arg("man").arg(folder))?;
    for (shell, file) in [("bash", "trueup.bash"), ("zsh", "_trueup"), ("fish", "trueup.fish")] {
        let script = process::output(Command::new(tool).args(["completions", shell]))?;
        fs::write(folder.join(file), script)?;
    }
    let images = process::output(Command::new(tool).arg("firmware").arg(folder.join("firmware")))?;
    ensure!(images.lines().count() == 3, "{} carries: {images}", tool.display());
    Ok(())
}
