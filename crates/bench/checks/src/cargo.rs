//! The cargo that runs this, at the root of the project and with the versions of its lock file.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::Result;
use trueup_emulator::{process, setup};

/// `cargo <verb> --locked`, to be gone on with.
pub(crate) fn locked_cargo_command(verb: &str) -> Command {
    let mut command = cargo_command(verb);
    command.arg("--locked");
    command
}

/// `cargo <verb>`, for what knows no lock file.
pub(crate) fn cargo_command(verb: &str) -> Command {
    let mut command = process::new_cargo_command();
    command.arg(verb).current_dir(setup::project_root());
    command
}

/// Returns a program of others in this version, built once into the project's own folder. It runs for a second: what
/// counts is how long it takes to build.
///
/// # Errors
/// It cannot be had or built.
pub(crate) fn install_tool(name: &str, version: &str) -> Result<PathBuf> {
    install_tool_with_options(name, version, &["--debug"])
}

/// The same for a program that works for minutes where it is not optimised.
///
/// # Errors
/// As [`install_tool`].
pub(crate) fn install_release_tool(
    name: &str,
    version: &str,
    features: &[&str],
) -> Result<PathBuf> {
    install_tool_with_options(name, version, features)
}

fn install_tool_with_options(name: &str, version: &str, options: &[&str]) -> Result<PathBuf> {
    let folder = setup::project_root().join("target/tools");
    let program = folder.join("bin").join(name);
    if !has_expected_version(&program, name, version) {
        trueup_output::write_diagnostic(format_args!(
            "building {name} {version} into target/tools"
        ));
        let mut install = locked_cargo_command("install");
        install.args(["--force", name, "--version", version]).args(options);
        install.arg("--root").arg(&folder);
        install.arg("--target-dir").arg(folder.join("build"));
        // Nothing of it is debugged here.
        install.env("CARGO_PROFILE_DEV_DEBUG", "0");
        process::run(&mut install)?;
        std::fs::remove_dir_all(folder.join("build"))?;
    }
    Ok(program)
}

fn has_expected_version(program: &Path, name: &str, version: &str) -> bool {
    // As cargo calls it: cargo-mutants knows no option without its verb.
    let verb = name.strip_prefix("cargo-");
    // Behind the name: `cargo-deny 0.20.2`, `mdbook v0.5.4`.
    process::capture_stdout(Command::new(program).args(verb).arg("--version")).is_ok_and(|stdout| {
        let stdout = stdout.split_whitespace().nth(1).unwrap_or_default();
        stdout.trim_start_matches('v') == version
    })
}
