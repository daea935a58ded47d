//! What nobody waits for: the soak, the fuzzing, the mutants. A command each, niced by whoever likes;
//! `docs/robustness.md` has what they have printed.

use std::{fmt::Write as _, fs, process::Command};

use anyhow::{Context as _, Result, ensure};
use serde_json::Value;
use trueup_emulator::{process, setup};

use crate::cargo;

/// The version that is asked for.
const MUTANTS: &str = "27.1.0";
/// The crates whose tests are tried.
const PACKAGES: [&str; 4] = ["trueup-core", "trueup-link", "trueup-store", "trueup-node"];
/// Hostile blobs in a soak of a thousand million ticks.
const TICKS_PER_BLOB: u64 = 100;
/// Hours of a sound sensor in it, at each noise.
const HOURS_PER_TICK: f64 = 300.0 / 1e9;
/// Seconds of a PLC at a gateway in it.
const PLC_S_PER_TICK: f64 = 600.0 / 1e9;

/// Lets the simulator run for so many ticks, from this seed on, on all cores, tries a hostile calibration for each
/// hundred of them, changes its source ten thousand times, draws faults for the detectors, lets sound sensors live for 300 hours of each noise in a thousand
/// million ticks, and PLCs of three languages at their gateways for ten minutes; a failure prints the seed that repeats it.
///
/// # Errors
/// It does not build, or something did not hold.
pub fn soak(ticks: u64, seed: u32) -> Result<()> {
    let run = |package: &str, binary: &str, test: &str| {
        let mut command = cargo::locked("test");
        command
            .args(["--profile", "soak", "-p", package, "--test", binary, "--"])
            .args(["--ignored", "--exact", test, "--nocapture"])
            .env("TRUEUP_SOAK_HOURS", (ticks as f64 * HOURS_PER_TICK).to_string())
            .env("TRUEUP_SOAK_TICKS", ticks.to_string())
            .env("TRUEUP_SOAK_BLOBS", (ticks / TICKS_PER_BLOB).max(1_000).to_string())
            .env("TRUEUP_SOAK_SEED", seed.to_string());
        process::run(&mut command)
    };
    run("trueup-node", "simulator", "campaign_soak")?;
    run(
        "trueup-node",
        "faults",
        "changes::campaign_ten_thousand_changes_of_source_go_on_with_the_growth",
    )?;
    run("trueup-node", "simulator", "hostile::campaign_hostile_blobs")?;
    run("trueup-core", "detectors", "campaign_every_detector_finds_3000_faults_in_time")?;
    run("trueup-core", "detectors", "campaign_a_sound_sensor_is_believed_for_hundreds_of_hours")?;
    // What is tried is a program of its own, so the profile of the tests is all the same: that of all other tests.
    let mut plc = cargo::locked("test");
    plc.args([
        "-p",
        "trueup-host-tests",
        "--features",
        "emulator",
        "--test",
        "gateway_latency",
        "--",
    ])
    .args(["--ignored", "--nocapture", "campaign_"])
    .env("TRUEUP_SOAK_PLC_S", ((ticks as f64 * PLC_S_PER_TICK).ceil() as u64).to_string());
    process::run(&mut plc)
}

/// Lets each of the fuzz targets run for so many minutes, one on each core at a time; prints how many inputs
/// each has had.
///
/// # Errors
/// It does not build, or an input does what none may.
pub fn fuzz(minutes: u64) -> Result<()> {
    let mut test = cargo::locked("test");
    test.args([
        "--profile",
        "soak",
        "-p",
        "trueup-host-tests",
        "--test",
        "fuzz",
        "--",
        "--nocapture",
    ])
    .env("TRUEUP_FUZZ_S", (60 * minutes).to_string());
    process::run(&mut test)
}

/// Draws mutants of the crates that a board runs, and counts how many their own tests catch: the unit tests of
/// the crate first, which take seconds, and what those miss goes through all tests of the four crates. Built and
/// tested in a copy of the source; `target/mutants` has the lists.
///
/// # Errors
/// cargo-mutants cannot be had, or the tests fail without a mutant. A mutant that is missed is no error.
pub fn mutants(draw: usize, seed: u64) -> Result<()> {
    let program = cargo::tool("cargo-mutants", MUTANTS)?;
    let packages: Vec<&str> = PACKAGES.iter().flat_map(|name| ["-p", name]).collect();
    let call = || {
        let mut command = Command::new(&program);
        command.arg("mutants").args(&packages).current_dir(setup::root());
        command
    };
    let listed: Value = serde_json::from_str(&process::output(call().args(["--list", "--json"]))?)?;
    let names = listed.as_array().context("a list of mutants")?.iter();
    let mut names: Vec<&str> = names.filter_map(|it| it["name"].as_str()).collect();
    names.sort_unstable();
    let drawn = drawn(names, draw, seed);
    let by_unit = try_mutants(call(), "unit-tests", &drawn, &["--cargo-test-arg=--lib"])?;
    let missed: Vec<&str> = by_unit.missed.lines().collect();
    let all_tests = PACKAGES.map(|name| format!("--test-package={name}"));
    let by_all = match missed[..] {
        [] => Outcome::default(),
        _ => try_mutants(call(), "all-tests", &missed, &all_tests.each_ref().map(String::as_str))?,
    };
    println!(
        "{} drawn: {} caught, {} by the time limit, {} do not compile, {} missed\n{}",
        drawn.len(),
        by_unit.caught + by_all.caught,
        by_unit.timed_out + by_all.timed_out,
        by_unit.unviable,
        by_all.missed.lines().count(),
        by_all.missed
    );
    Ok(())
}

/// What became of some mutants; `missed` has a line for each that nothing caught.
#[derive(Default)]
struct Outcome {
    caught: usize,
    timed_out: usize,
    unviable: usize,
    missed: String,
}

/// Tries these mutants with these options, and leaves the lists in `target/mutants/<folder>`.
fn try_mutants(
    mut run: Command,
    folder: &str,
    names: &[&str],
    options: &[&str],
) -> Result<Outcome> {
    let mut config = String::from("examine_re = [\n");
    for name in names {
        let escaped: String = name.chars().flat_map(escaped).collect();
        writeln!(config, "  '''^{escaped}$''',")?;
    }
    config.push_str("]\n");
    let folder = setup::root().join("target/mutants").join(folder);
    fs::create_dir_all(&folder)?;
    fs::write(folder.join("drawn.toml"), config)?;
    run.args(["--no-shuffle", "--timeout", "120", "--config"]).arg(folder.join("drawn.toml"));
    let status = run.args(options).arg("-o").arg(&folder).status()?;
    // 2: some were missed, 3: some ran into the time limit, which is as good as caught.
    ensure!(matches!(status.code(), Some(0 | 2 | 3)), "cargo-mutants: {status}");
    let list = |name: &str| fs::read_to_string(folder.join("mutants.out").join(name));
    let count = |name: &str| list(name).map(|text| text.lines().count());
    Ok(Outcome {
        caught: count("caught.txt")?,
        timed_out: count("timeout.txt")?,
        unviable: count("unviable.txt")?,
        missed: list("missed.txt")?,
    })
}

/// As many of these as are asked for, the same for the same seed.
fn drawn<T>(mut from: Vec<T>, count: usize, seed: u64) -> Vec<T> {
    let mut state = seed;
    let mut drawn = Vec::new();
    while drawn.len() < count && !from.is_empty() {
        // Knuth's MMIX.
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let number = (state >> 33) as usize % from.len();
        drawn.push(from.swap_remove(number));
    }
    drawn
}

/// A character as a regular expression has it.
fn escaped(character: char) -> impl Iterator<Item = char> {
    let is_special = r"\.+*?()|[]{}^$".contains(character);
    is_special.then_some('\\').into_iter().chain([character])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_draws_each_once_and_the_same_again() {
        let mut all = drawn((0..50).collect(), 60, 7);
        assert_eq!(all, drawn((0..50).collect(), 60, 7));
        assert_ne!(all[..20], drawn((0..50).collect(), 20, 8));
        all.sort_unstable();
        assert!(all.into_iter().eq(0..50));
    }
}
