//! The Debian package of the host tool: `cargo xtask deb`; with `--try` it is installed into an empty Debian
//! and used there, because a tool that runs where it was built proves nothing.
//!
//! It has the tool, which carries firmware, examples and the controls' files in itself, the library of the bridge
//! without a board, its manual's pages and what shells complete it with. The tool's own manifest says which file goes
//! where.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::{host_programs, process, release_images, setup};

use crate::cargo;

/// The version that the manifest is written for.
const CARGO_DEB_VERSION: &str = "3.8.0";

/// Builds the package of this computer's platform into `target/debian` and gives its path.
///
/// # Errors
/// The firmware or the tool does not build, or cargo-deb cannot be had or fails.
pub fn build_host_package() -> Result<PathBuf> {
    // Before the tool, which takes what is there.
    release_images::build_bundled_images()?;
    process::run(cargo::locked_cargo_command("build").args([
        "--release",
        "--package",
        "trueup-cli",
    ]))?;
    build_bridge_library(None)?;
    let root = setup::project_root();
    write_manual_and_completions(&root.join("target/release/trueup"), &root.join("target/deb"))?;
    build_package(&[])
}

/// Packs the tool that was built for another Linux, as Rust names it, with the pages that [`build_host_package`] has left.
///
/// # Errors
/// cargo-deb cannot be had or fails.
pub(crate) fn build_package_for_target(target: &str) -> Result<PathBuf> {
    build_bridge_library(Some(target))?;
    build_package(&["--target", target])
}

/// Builds the library of the bridge without a board, for another Linux or this computer, and puts it next to the tool,
/// where `trueup linuxcnc component` looks for it.
///
/// # Errors
/// It does not compile, or the tool was not built before.
pub(crate) fn build_bridge_library(target: Option<&str>) -> Result<PathBuf> {
    let built = host_programs::build_servo_library_for_target(target)?;
    let folder =
        setup::project_root().join("target").join(target.unwrap_or_default()).join("release");
    let library = folder.join(built.file_name().context("a library has a name")?);
    fs::copy(&built, &library).with_context(|| library.display().to_string())?;
    Ok(library)
}

fn build_package(target: &[&str]) -> Result<PathBuf> {
    let root = setup::project_root();
    let cargo_deb = cargo::install_tool("cargo-deb", CARGO_DEB_VERSION)?;
    let mut make = Command::new(cargo_deb);
    make.args(["--no-build", "--package", "trueup-cli"]).args(target);
    make.arg("--output").arg(root.join("target/debian"));
    process::run(make.current_dir(&root))?;
    let packages = fs::read_dir(root.join("target/debian"))?.flatten().map(|entry| entry.path());
    let packages = packages.filter(|path| path.extension().is_some_and(|kind| kind == "deb"));
    let newest = packages
        .max_by_key(|path| fs::metadata(path).and_then(|metadata| metadata.modified()).ok());
    newest.context("cargo-deb has left no package")
}

/// The commands that are run in the empty root, by a shell that stops at the first failure.
const INSTALL_TEST_SCRIPT: &str = "\
set -e
apt-get install -y --no-install-recommends /trueup.deb
cd /tmp
trueup --version
trueup examples try
trueup check try/paper_spindle.toml
trueup predict -m try/paper_spindle.toml -r try/spindle_paper_table1.csv -o out.csv
trueup diagnose -m try/paper_spindle.toml -r try/spindle_paper_table1.csv -o found
trueup compile found/extended.toml -o cal.bin
trueup show cal.bin > shown.toml
test $(trueup firmware images | wc -l) = IMAGES
test -f /usr/share/man/man1/trueup.1.gz
test -f /usr/lib/trueup/libtrueup_servo.a
test -f /usr/share/bash-completion/completions/trueup
apt-get remove -y trueup
test ! -e /usr/bin/trueup
";

/// Installs a package into an empty Debian, uses the tool there, and removes it again. About a minute, and
/// the packages of a minimal Debian from its mirror.
///
/// # Errors
/// This user is not root, debootstrap is not there, or a step fails; its output stands above.
pub fn test_install(package: &Path) -> Result<()> {
    let is_root = process::capture_stdout(Command::new("id").arg("-u"))?.trim() == "0";
    ensure!(is_root, "a root file system is made by root alone: sudo cargo xtask deb --try");
    let debootstrap = process::find_on_path("debootstrap")
        .context("debootstrap is not on PATH: sudo apt install debootstrap")?;
    let folder = setup::project_root().join("target/deb-root");
    if folder.is_dir() {
        fs::remove_dir_all(&folder)?;
    }
    process::run(Command::new(debootstrap).args(["--variant=minbase", "stable"]).arg(&folder))?;
    fs::copy(package, folder.join("trueup.deb"))?;
    let mut trial = Command::new("chroot");
    trial.arg(&folder).args(["/usr/bin/env", "-i", "PATH=/usr/sbin:/usr/bin:/sbin:/bin"]);
    let commands = INSTALL_TEST_SCRIPT.replace("IMAGES", &count_packaged_images()?.to_string());
    trial.args(["HOME=/root", "DEBIAN_FRONTEND=noninteractive", "/bin/sh", "-c", &commands]);
    process::run(&mut trial)?;
    Ok(fs::remove_dir_all(&folder)?)
}

/// Lets a tool write its manual's pages and completions, and checks that it carries the firmware.
fn write_manual_and_completions(tool: &Path, folder: &Path) -> Result<()> {
    if folder.is_dir() {
        fs::remove_dir_all(folder)?;
    }
    fs::create_dir_all(folder)?;
    process::capture_stdout(Command::new(tool).arg("man").arg(folder))?;
    for (shell, file) in [("bash", "trueup.bash"), ("zsh", "_trueup"), ("fish", "trueup.fish")] {
        let script = process::capture_stdout(Command::new(tool).args(["completions", shell]))?;
        fs::write(folder.join(file), script)?;
    }
    let images =
        process::capture_stdout(Command::new(tool).arg("firmware").arg(folder.join("firmware")))?;
    ensure!(
        images.lines().count() == count_packaged_images()?,
        "{} carries: {images}",
        tool.display()
    );
    Ok(())
}

/// Returns how many files of images there are to carry.
fn count_packaged_images() -> Result<usize> {
    Ok(fs::read_dir(setup::project_root().join("target/carried"))?.flatten().count())
}
