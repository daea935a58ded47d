//! The files of a release: `cargo xtask release` writes them to `target/release-files`.
//!
//! | for | files | by |
//! |---|---|---|
//! | Linux, x86-64 and arm64 | `.tar.gz` with the tool, the library of the bridge without a board, manual pages, completions, licences; a Debian package for each | this file |
//! | Windows, x86-64 | `.zip` with the tool and licences | this file |
//! | the board | images with their `.elf`, which alone can read a board's log; the update of boards with two firmware slots | this file |
//! | who must answer for a product | parts lists, licences, known vulnerabilities, declarations | `compliance_documents.rs` |
//! | all | `SHA256SUMS`, signatures | this file |
//!
//! All but the papers is built in two folders and compared: see `reproducible_build.rs`.
//!
//! A platform whose tool chain is not on this computer is omitted and named, with the lines that install it: a release is whole
//! only if nothing was omitted.

mod compliance_documents;
mod reproducible_build;

use std::{
    env::consts,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result};
use trueup_emulator::{process, release_images, setup};
use trueup_signature::PrivateKey;

use crate::{cargo, debian_package};

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

/// Files that were written, and what is missing, with the reason.
#[derive(Debug, Default)]
pub struct Release {
    /// The folder of all files.
    pub folder: PathBuf,
    /// The files, by name.
    pub files: Vec<String>,
    /// A sentence for each platform, paper or signature that was omitted.
    pub skipped: Vec<String>,
}

/// Makes all files of a release, of the commit that the folder is at, and signs them with `key`.
///
/// # Errors
/// The folder has changes that are in no commit; something does not build; a file of the second folder is another one;
/// or a tool is missing or fails.
pub fn create_release(key: Option<&Path>) -> Result<Release> {
    // Before anything is built: an error minutes later would go unnoticed.
    let private = key.map(read_private_key).transpose()?;
    let again = reproducible_build::build_release_twice(key.zip(private.as_ref()))?;
    let folder = release_folder();
    let mut held_out = describe_unavailable_platforms();
    held_out.extend(compliance_documents::write_documents(&again, &folder)?);
    fs::remove_dir_all(&again)?;
    let files = list_file_names(&folder)?;
    let sums =
        process::capture_stdout(Command::new("sha256sum").args(&files).current_dir(&folder))?;
    fs::write(folder.join("SHA256SUMS"), sums)?;
    match private {
        Some(key) => sign_files(&key, &folder)?,
        None => held_out.push(
            "no file is signed, and the images of two slots with the developers' key; first: trueup sign --new KEY.pem, then \
             cargo xtask release --key KEY.pem"
                .into(),
        ),
    }
    Ok(Release { files: list_file_names(&folder)?, folder, skipped: held_out })
}

fn read_private_key(path: &Path) -> Result<PrivateKey> {
    let pem = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    PrivateKey::from_pem(&pem).with_context(|| path.display().to_string())
}

/// Signs every file of a folder, and leaves the public key there.
fn sign_files(key: &PrivateKey, folder: &Path) -> Result<()> {
    for name in list_file_names(folder)? {
        let signature = key.sign(&fs::read(folder.join(&name))?);
        fs::write(folder.join(name + ".sig"), signature)?;
    }
    Ok(fs::write(folder.join("trueup.pub.pem"), key.public_key().to_pem()?)?)
}

/// Returns the folder of all files.
fn release_folder() -> PathBuf {
    setup::project_root().join("target/release-files")
}

fn list_file_names(folder: &Path) -> Result<Vec<String>> {
    let mut files: Vec<String> = fs::read_dir(folder)?
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    files.sort();
    Ok(files)
}

/// Returns a sentence for each platform that cannot be built here.
fn describe_unavailable_platforms() -> Vec<String> {
    let why = |platform| {
        find_missing_requirement(platform, has_standard_library, |program| {
            process::find_on_path(program).is_some()
        })
    };
    PLATFORMS.iter().filter_map(why).collect()
}

/// Builds the files of this folder once: archives, package and images.
///
/// # Errors
/// Something does not build, or `tar` or `zip` is missing or fails.
pub fn build_release_files() -> Result<()> {
    let (root, folder) = (setup::project_root(), release_folder());
    if folder.is_dir() {
        fs::remove_dir_all(&folder)?;
    }
    fs::create_dir_all(&folder)?;
    // Before the tool, which carries them.
    copy_files(&release_images::build_bundled_images()?, &folder)?;
    let built: Vec<&Platform> = PLATFORMS
        .iter()
        .filter(|platform| {
            find_missing_requirement(platform, has_standard_library, |program| {
                process::find_on_path(program).is_some()
            })
            .is_none()
        })
        .collect();
    built.iter().try_for_each(|platform| build_platform_archive(platform, &root, &folder))?;
    let mut packages = vec![debian_package::build_host_package()?];
    for Platform { target, .. } in
        built.iter().filter(|platform| !platform.is_windows && !is_host_target(platform.target))
    {
        packages.push(debian_package::build_package_for_target(target)?);
    }
    for package in packages {
        let name = package.file_name().context("a package has a name")?;
        fs::copy(&package, folder.join(name))?;
    }
    Ok(())
}

/// Returns whether the standard library of a target is installed.
fn has_standard_library(target: &str) -> bool {
    let mut ask = Command::new("rustc");
    ask.args(["--print", "target-libdir", "--target", target]);
    process::capture_stdout(&mut ask).is_ok_and(|folder| Path::new(folder.trim()).is_dir())
}

/// Why a platform cannot be built here, with the lines that change it; `None`: it can.
fn find_missing_requirement(
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
    (!lines.is_empty()).then(|| format!("{target} is skipped; first: {}", lines.join("; ")))
}

/// Returns whether a build without `--target`, on a computer of this architecture and system, is for `target`.
fn is_native_target(target: &str, architecture: &str, system: &str) -> bool {
    let rest = match system {
        "linux" => "unknown-linux-gnu",
        "windows" => "pc-windows-gnu",
        _ => return false,
    };
    target.strip_prefix(architecture).and_then(|rest| rest.strip_prefix('-')) == Some(rest)
}

/// Returns whether a build without `--target` on this computer is for `target`.
fn is_host_target(target: &str) -> bool {
    cfg!(target_env = "gnu") && is_native_target(target, consts::ARCH, consts::OS)
}

/// Builds the tool for a platform and packs it.
fn build_platform_archive(platform: &Platform, root: &Path, folder: &Path) -> Result<()> {
    let Platform { target, linker: (linker, _), is_windows } = platform;
    let mut build = cargo::locked_cargo_command("build");
    build.args(["--release", "--package", "trueup-cli"]);
    // This computer's own is built once, for the archive and for the package.
    let is_own = is_host_target(target);
    let mut built = root.join("target");
    // A linker that is named, even the usual one, would make it another build than the package's.
    if !is_own {
        build.args(["--target", target]);
        built.push(target);
        let variable = target.to_uppercase().replace('-', "_");
        build.env(format!("CARGO_TARGET_{variable}_LINKER"), linker);
    }
    process::run(&mut build)?;
    let name = format!("trueup-{}-{target}", env!("CARGO_PKG_VERSION"));
    let content = folder.join(&name);
    fs::create_dir_all(&content)?;
    let tool = if *is_windows { "trueup.exe" } else { "trueup" };
    let built = built.join("release").join(tool);
    fs::copy(&built, content.join(tool)).with_context(|| built.display().to_string())?;
    if !is_windows {
        let library = debian_package::build_bridge_library((!is_own).then_some(target))?;
        fs::copy(&library, content.join(library.file_name().context("a library has a name")?))?;
    }
    for text in ["README.md", "CHANGELOG.md", "LICENSE-MIT", "LICENSE-APACHE"] {
        fs::copy(root.join(text), content.join(text))?;
    }
    if is_own {
        process::capture_stdout(Command::new(&built).arg("man").arg(content.join("man")))?;
        let script = process::capture_stdout(Command::new(&built).args(["completions", "bash"]))?;
        fs::write(content.join("trueup.bash"), script)?;
    }
    create_archive(&name, folder, *is_windows)?;
    Ok(fs::remove_dir_all(content)?)
}

/// Packs a folder so that the same files give the same bytes: no order, time, owner or mode of this computer.
fn create_archive(name: &str, folder: &Path, is_windows: bool) -> Result<()> {
    let at = format!("@{}", reproducible_build::commit_unix_seconds()?);
    if is_windows {
        let mut touch = Command::new("find");
        touch.args([name, "-exec", "touch", "--date", &at, "{}", "+"]).current_dir(folder);
        process::run(&mut touch)?;
        let mut list = Command::new("find");
        list.args([name, "-type", "f"]).current_dir(folder);
        let mut names: Vec<String> =
            process::capture_stdout(&mut list)?.lines().map(str::to_owned).collect();
        names.sort();
        let mut zip = Command::new("zip");
        // Without extra fields, with times as they are in UTC.
        zip.env("TZ", "UTC").args(["-qX", &format!("{name}.zip")]).args(names);
        return process::run(zip.current_dir(folder));
    }
    let mut tar = Command::new("tar");
    tar.args(["--sort=name", "--owner=0", "--group=0", "--numeric-owner", "--format=gnu"]);
    tar.args([
        "--mode=u+rwX,go+rX,go-w",
        &format!("--mtime={at}"),
        "--use-compress-program=gzip -n",
    ]);
    tar.args(["-cf", &format!("{name}.tar.gz"), name]);
    process::run(tar.current_dir(folder))
}

fn copy_files(from: &Path, to: &Path) -> Result<()> {
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
        let [x86, arm, windows] = PLATFORMS.each_ref().map(|platform| platform.target);
        for (architecture, system, own) in [
            ("x86_64", "linux", Some(x86)),
            ("aarch64", "linux", Some(arm)),
            ("x86_64", "windows", Some(windows)),
            ("aarch64", "macos", None),
        ] {
            for target in [x86, arm, windows] {
                let is_own = own == Some(target);
                assert_eq!(
                    is_native_target(target, architecture, system),
                    is_own,
                    "{target} on {system}"
                );
            }
        }
    }

    #[test]
    fn a_platform_without_its_tool_chain_is_named_with_the_lines_that_install_it() {
        let [own, arm, windows] = &PLATFORMS;
        let all = |_: &str| true;
        let none = |_: &str| false;
        for platform in &PLATFORMS {
            assert_eq!(find_missing_requirement(platform, all, all), None);
        }
        let message = find_missing_requirement(arm, none, none).expect("nothing is there");
        assert_eq!(
            message,
            "aarch64-unknown-linux-gnu is skipped; first: rustup target add aarch64-unknown-linux-gnu; \
             sudo apt-get install gcc-aarch64-linux-gnu"
        );
        let message = find_missing_requirement(windows, all, none).expect("no linker");
        assert!(message.ends_with("sudo apt-get install gcc-mingw-w64-x86-64"), "{message}");
        assert!(!own.is_windows && windows.is_windows);
    }
}
