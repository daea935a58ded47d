//! The files of a release: `cargo xtask release` writes them to `target/release-files`.
//!
//! | for | files |
//! |---|---|
//! | Linux, x86-64 and arm64 | `.tar.gz` with the tool, manual pages, completions, licences; a Debian package for the platform of this computer |
//! | Windows, x86-64 | `.zip` with the tool and licences |
//! | the board | images with their `.elf`, which alone can read a board's log |
//! | all | `SHA256SUMS` |
//!
//! A platform whose tool chain is not on this computer is left out and named, with the lines that install it: a release is whole
//! only if nothing was left out.

use std::{
    env::consts,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result};
use trueup_emulator::{firmware, process, setup};

use crate::{cargo, debian};

/// A platform that the tool is built for.
struct Platform {
    /// As Rust names it.
    target: &'static str,
    /// The linker that its tool chain has, and the package of Debian with it.
    linker: (&'static str, &'static str),
    is_windows: bool,
}

const PLATFORMS: [Platform; 3] = [
    Platform { target: "x86_64-unknown-linux-gnu", linker: ("cc", "gcc"), is_windows: false },
    Platform {
        target: "aarch64-unknown-linux-gnu",
        linker: ("aarch64-linux-gnu-gcc", "gcc-aarch64-linux-gnu"),
        is_windows: false,
    },
    Platform {
        target: "x86_64-pc-windows-gnu",
        linker: ("x86_64-w64-mingw32-gcc", "gcc-mingw-w64-x86-64"),
        is_windows: true,
    },
];

/// Files that were written, and those that were left out, with the reason.
#[derive(Debug, Default)]
pub struct Release {
    /// The folder of all files.
    pub folder: PathBuf,
    /// The files, by name.
    pub files: Vec<String>,
    /// A sentence for each platform that was left out.
    pub left_out: Vec<String>,
}

/// Makes all files of a release.
///
/// # Errors
/// Something does not build, or `tar`, `zip` or `sha256sum` is missing or fails.
pub fn release() -> Result<Release> {
    let root = setup::root();
    let folder = root.join("target/release-files");
    if folder.is_dir() {
        fs::remove_dir_all(&folder)?;
    }
    fs::create_dir_all(&folder)?;
    let mut left_out = Vec::new();
    // Before the tool, which carries them.
    let images = firmware::carried()?;
    copy_all(&images, &folder)?;
    for platform in &PLATFORMS {
        match missing(platform, has_library, |program| process::find(program).is_some()) {
            Some(why) => left_out.push(why),
            None => pack(platform, &root, &folder)?,
        }
    }
    // The package is of this computer's own platform.
    let package = debian::package()?;
    let name = package.file_name().context("a package has a name")?;
    fs::copy(&package, folder.join(name))?;
    let mut files: Vec<String> = fs::read_dir(&folder)?
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    files.sort();
    let sums = process::output(Command::new("sha256sum").args(&files).current_dir(&folder))?;
    fs::write(folder.join("SHA256SUMS"), sums)?;
    files.push("SHA256SUMS".into());
    Ok(Release { folder, files, left_out })
}

/// Returns whether the standard library of a target is installed.
fn has_library(target: &str) -> bool {
    let mut ask = Command::new("rustc");
    ask.args(["--print", "target-libdir", "--target", target]);
    process::output(&mut ask).is_ok_and(|folder| Path::new(folder.trim()).is_dir())
}

/// Why a platform cannot be built here, with the lines that change it; `None`: it can.
fn missing(
    platform: &Platform,
    has_library: impl Fn(&str) -> bool,
    has_program: impl Fn(&str) -> bool,
) -> Option<String> {
    let Platform { target, linker: (linker, package), .. } = platform;
    let mut lines = Vec::new();
    if !has_library(target) {
        lines.push(format!("rustup target add {target}"));
    }
    if !has_program(linker) {
        lines.push(format!("sudo apt-get install {package}"));
    }
    (!lines.is_empty()).then(|| format!("{target} is left out; first: {}", lines.join("; ")))
}

/// Returns whether a build without `--target`, on a computer of this architecture and system, is for `target`.
fn is_of(target: &str, architecture: &str, system: &str) -> bool {
    let rest = match system {
        "linux" => "unknown-linux-gnu",
        "windows" => "pc-windows-gnu",
        _ => return false,
    };
    target.strip_prefix(architecture).and_then(|it| it.strip_prefix('-')) == Some(rest)
}

/// Builds the tool for a platform and packs it.
fn pack(platform: &Platform, root: &Path, folder: &Path) -> Result<()> {
    let Platform { target, linker: (linker, _), is_windows } = platform;
    let mut build = cargo::locked("build");
    build.args(["--release", "--package", "trueup-cli"]);
    // This computer's own is built once, for the archive and for the package.
    let is_own = cfg!(target_env = "gnu") && is_of(target, consts::ARCH, consts::OS);
    let mut built = root.join("target");
    if !is_own {
        build.args(["--target", target]);
        built.push(target);
    }
    let variable = target.to_uppercase().replace('-', "_");
    build.env(format!("CARGO_TARGET_{variable}_LINKER"), linker);
    process::run(&mut build)?;
    let name = format!("trueup-{}-{target}", env!("CARGO_PKG_VERSION"));
    let content = folder.join(&name);
    fs::create_dir_all(&content)?;
    let tool = if *is_windows { "trueup.exe" } else { "trueup" };
    let built = built.join("release").join(tool);
    fs::copy(&built, content.join(tool)).with_context(|| built.display().to_string())?;
    for text in ["README.md", "CHANGELOG.md", "LICENSE-MIT", "LICENSE-APACHE"] {
        fs::copy(root.join(text), content.join(text))?;
    }
    if is_own {
        process::output(Command::new(&built).arg("man").arg(content.join("man")))?;
        let script = process::output(Command::new(&built).args(["completions", "bash"]))?;
        fs::write(content.join("trueup.bash"), script)?;
    }
    let mut archive = if *is_windows {
        let mut zip = Command::new("zip");
        zip.args(["-qr", &format!("{name}.zip"), &name]);
        zip
    } else {
        let mut tar = Command::new("tar");
        tar.args(["-czf", &format!("{name}.tar.gz"), "--owner=0", "--group=0", &name]);
        tar
    };
    process::run(archive.current_dir(folder))?;
    Ok(fs::remove_dir_all(content)?)
}

fn copy_all(from: &Path, to: &Path) -> Result<()> {
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        fs::copy(entry.path(), to.join(entry.file_name()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_platform_of_the_computer_is_built_without_its_name() {
        let [x86, arm, windows] = PLATFORMS.each_ref().map(|it| it.target);
        for (architecture, system, own) in [
            ("x86_64", "linux", Some(x86)),
            ("aarch64", "linux", Some(arm)),
            ("x86_64", "windows", Some(windows)),
            ("aarch64", "macos", None),
        ] {
            for target in [x86, arm, windows] {
                let is_own = own == Some(target);
                assert_eq!(is_of(target, architecture, system), is_own, "{target} on {system}");
            }
        }
    }

    #[test]
    fn a_platform_without_its_tool_chain_is_named_with_the_lines_that_install_it() {
        let [own, arm, windows] = &PLATFORMS;
        let all = |_: &str| true;
        let none = |_: &str| false;
        for platform in &PLATFORMS {
            assert_eq!(missing(platform, all, all), None);
        }
        let said = missing(arm, none, none).expect("nothing is there");
        assert_eq!(
            said,
            "aarch64-unknown-linux-gnu is left out; first: rustup target add aarch64-unknown-linux-gnu; \
             sudo apt-get install gcc-aarch64-linux-gnu"
        );
        let said = missing(windows, all, none).expect("no linker");
        assert!(said.ends_with("sudo apt-get install gcc-mingw-w64-x86-64"), "{said}");
        assert!(!own.is_windows && windows.is_windows);
    }
}
