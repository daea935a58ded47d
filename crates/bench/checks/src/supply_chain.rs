//! Checks of what the project is built from: the compiler, and other people's crates.

use std::{path::PathBuf, process::Command};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::{process, setup};

use crate::{cargo, test_results::TestResults};

/// Says which compiler this is, and that it is not older than `rust-version` in `Cargo.toml`.
///
/// # Errors
/// It is older, or does not say what it is.
pub(crate) fn check_compiler_version() -> Result<TestResults> {
    let rustc = std::env::var_os("RUSTC").unwrap_or("rustc".into());
    let stdout = process::capture_stdout(Command::new(rustc).arg("--version"))?;
    let manifest = std::fs::read_to_string(setup::project_root().join("Cargo.toml"))?;
    let oldest = manifest
        .lines()
        .find_map(|line| line.strip_prefix("rust-version = "))
        .context("Cargo.toml states no rust-version")?
        .trim_matches('"');
    trueup_output::write_line_best_effort(format_args!(
        "{} ({oldest} or newer is needed)",
        stdout.trim()
    ));
    let version = stdout.split_whitespace().nth(1).unwrap_or_default();
    ensure!(
        parse_major_minor(version) >= parse_major_minor(oldest),
        "this compiler is older than {oldest}"
    );
    Ok(TestResults::with_passed(1))
}

/// Returns the two numbers that count: `1.95.0-beta.1` gives 1 and 95.
fn parse_major_minor(version: &str) -> Option<(u32, u32)> {
    let mut numbers = version.split('.').map(|number| number.parse().ok());
    Some((numbers.next()??, numbers.next()??))
}

/// The version that `deny.toml` is written for.
const CARGO_DENY_VERSION: &str = "0.20.2";

/// Licences, sources and duplicates of the crates in the lock file, by `deny.toml`; known
/// vulnerabilities where their database can be had.
///
/// # Errors
/// A crate breaks a rule, or cargo-deny cannot be built.
pub(crate) fn check_dependencies() -> Result<TestResults> {
    let deny = install_cargo_deny()?;
    let check = |what: &[&str]| {
        let mut command = Command::new(&deny);
        command.args(["--locked", "check"]).args(what).current_dir(setup::project_root());
        process::run(&mut command)
    };
    check(&["licenses", "bans", "sources"])?;
    let mut model = Command::new(&deny);
    model.args([
        "--config",
        "deny.toml",
        "--manifest-path",
        "crates/bench/chip/Cargo.toml",
        "--locked",
    ]);
    model.args(["check", "licenses", "bans", "sources"]).current_dir(setup::project_root());
    process::run(&mut model)?;
    let mut tally = TestResults::with_passed(1);
    tally.merge(match check_advisories()? {
        AdvisoryStatus::None(_) => TestResults::with_passed(1),
        // The world finds a hole on any day; that must not stop who has changed nothing.
        AdvisoryStatus::Known(advisories) => TestResults::report_unavailable(&format!(
            "cargo-deny advisories, to be looked at: {advisories}"
        )),
        AdvisoryStatus::DatabaseUnavailable => TestResults::report_unavailable(&format!(
            "cargo-deny advisories: {ADVISORY_DATABASE_UNAVAILABLE}"
        )),
    });
    Ok(tally)
}

const ADVISORY_DATABASE_UNAVAILABLE: &str = "their database cannot be had here";

/// Known vulnerabilities of the crates in the lock file, by the advisories of the Rust project (RustSec).
enum AdvisoryStatus {
    /// Nothing is known; the message.
    None(String),
    /// There are some; the message.
    Known(String),
    /// Their database cannot be had here.
    DatabaseUnavailable,
}

fn check_advisories() -> Result<AdvisoryStatus> {
    let deny = install_cargo_deny()?;
    let mut fetch = Command::new(&deny);
    fetch.args(["fetch", "db"]).current_dir(setup::project_root());
    if process::run(&mut fetch).is_err() {
        return Ok(AdvisoryStatus::DatabaseUnavailable);
    }
    let mut check = Command::new(&deny);
    check
        .args(["--locked", "check", "--disable-fetch", "advisories"])
        .current_dir(setup::project_root());
    Ok(match process::capture_stdout(&mut check) {
        Ok(advisories) => AdvisoryStatus::None(advisories),
        Err(error) => AdvisoryStatus::Known(format!("{error:#}")),
    })
}

/// Returns the known vulnerabilities as a paper of a release, and a sentence where they are not known.
///
/// # Errors
/// cargo-deny cannot be built.
pub(crate) fn build_vulnerability_report() -> Result<(String, Option<String>)> {
    let head = "Known vulnerabilities of the crates in Cargo.lock, by the advisories of the Rust project (RustSec)";
    // The place of the files on this computer is not handed out.
    let plain =
        |message: String| message.replace(&setup::project_root().display().to_string(), "/trueup");
    Ok(match check_advisories()? {
        AdvisoryStatus::None(message) => (format!("{head}: none.\n{}", plain(message)), None),
        AdvisoryStatus::Known(message) => {
            let missing =
                "vulnerabilities.txt lists advisories: decide on each before it is handed out";
            (format!("{head}:\n{}\n", plain(message)), Some(missing.into()))
        }
        AdvisoryStatus::DatabaseUnavailable => {
            let lines = "cargo deny fetch db && cargo deny check advisories";
            let text = format!(
                "{head}: not looked up, {ADVISORY_DATABASE_UNAVAILABLE}. Where there is a network: {lines}\n"
            );
            (
                text,
                Some(format!(
                    "the known vulnerabilities are not looked up: {ADVISORY_DATABASE_UNAVAILABLE}"
                )),
            )
        }
    })
}

/// cargo-deny, for the licences and sources of crates.
fn install_cargo_deny() -> Result<PathBuf> {
    cargo::install_tool("cargo-deny", CARGO_DENY_VERSION)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_compared_by_number() {
        assert!(parse_major_minor("1.100.0-nightly") > parse_major_minor("1.88"));
        assert!(parse_major_minor("1.9.0") < parse_major_minor("1.88"));
        assert_eq!(parse_major_minor("none"), None);
    }
}
