//! Builds the project's own programs for this computer: the host tool, `xtask`.

use std::{path::PathBuf, process::Stdio};

use anyhow::{Context as _, Result, ensure};
use serde_json::Value;

use crate::{process, setup};

/// Builds the host tool and gives its path.
///
/// # Errors
/// As [`build_program`].
pub fn build_trueup() -> Result<PathBuf> {
    build_program("trueup-cli", "trueup")
}

/// Builds the static library of the bridge in LinuxCNC's servo thread, as a release has it, and gives its path.
///
/// # Errors
/// It does not compile.
pub fn build_servo_library() -> Result<PathBuf> {
    build_servo_library_for_target(None)
}

/// Builds the same for another platform, as Rust names it; `None`: for this computer.
///
/// # Errors
/// It does not compile.
pub fn build_servo_library_for_target(target: Option<&str>) -> Result<PathBuf> {
    let output = process::new_cargo_command()
        .args(["rustc", "--locked", "-p", "trueup-servo", "--lib", "--profile", "servo"])
        .args(target.map(|target| ["--target", target]).into_iter().flatten())
        .args(["--crate-type", "staticlib", "--message-format", "json-render-diagnostics"])
        .args(["--", "--cfg", "trueup_library"])
        .current_dir(setup::project_root())
        .stderr(Stdio::inherit())
        .output()?;
    ensure!(output.status.success(), "trueup-servo does not build");
    find_artefact(output.stdout, "trueup_servo", |message| &message["filenames"][0])
}

/// Builds a program of a package and gives its path, which is where cargo says that it is.
///
/// # Errors
/// It does not compile.
pub fn build_program(package: &str, name: &str) -> Result<PathBuf> {
    let output = process::new_cargo_command()
        // The features of the tests: another choice would compile everything a second time.
        .args(["build", "--locked", "--features", "trueup-host-tests/emulator", "--bin", name])
        .args(["--message-format", "json-render-diagnostics"])
        .current_dir(setup::project_root())
        .stderr(Stdio::inherit())
        .output()?;
    ensure!(output.status.success(), "{package} does not build");
    find_artefact(output.stdout, name, |message| &message["executable"])
}

/// Returns the path of a target in cargo's messages.
fn find_artefact(messages: Vec<u8>, target: &str, path: fn(&Value) -> &Value) -> Result<PathBuf> {
    String::from_utf8(messages)?
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter(|message| message["target"]["name"] == target)
        .find_map(|message| path(&message).as_str().map(PathBuf::from))
        .with_context(|| format!("cargo does not say where {target} is"))
}
