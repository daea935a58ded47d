//! Long campaigns that no tier runs: the soak, the fuzzing, the mutants. A command each, to be niced if you like;
//! `docs/robustness.md` has what they have printed.

use std::{fmt::Write as _, fs, path::Path, process::Command};

use anyhow::{Context as _, Result, ensure};
use serde_json::Value;
use trueup_emulator::{process, setup};

use crate::cargo;

/// The version that is requested.
const CARGO_MUTANTS_VERSION: &str = "27.1.0";
/// The crates whose tests are tried.
const MUTATED_PACKAGES: [&str; 4] = ["trueup-core", "trueup-link", "trueup-store", "trueup-node"];
/// Functions whose mutants are tried on the simulator alone: a file of `crates/board`, and the end of the function's name.
/// They are those of the faults that `crates/board/node/tests/planted.rs` plants.
const SIMULATOR_TESTED_FUNCTIONS: [(&str, &str); 16] = [
    ("core/src/limits.rs", "AppliedOffset::step"),
    ("core/src/bridge/source_selection.rs", "::offset_quality"),
    ("core/src/bridge/source_selection.rs", "::switch_source"),
    ("core/src/bridge.rs", "::tick"),
    ("core/src/bridge.rs", "::compute_target_offset"),
    ("core/src/bridge.rs", "::process_samples"),
    ("core/src/bridge/state.rs", "State::set_inhibited"),
    ("core/src/bridge/state.rs", "State::mark_samples_lost"),
    ("core/src/bridge/state.rs", "::fresh_value"),
    ("core/src/bridge/state.rs", "State::is_held"),
    ("link/src/frames.rs", "encode_offset_z"),
    ("store/src/retained_state.rs", "encode"),
    ("node/src/node.rs", "::tick"),
    ("node/src/node/restart.rs", "::advance_clock"),
    ("node/src/node/master.rs", "Master::accept_control"),
    ("node/src/node/master.rs", "EdgeDetector::receive"),
];
/// Hostile blobs in a soak of a thousand million ticks.
const TICKS_PER_HOSTILE_BLOB: u64 = 100;
/// Hours of a sound sensor in it, at each noise.
const SENSOR_HOURS_PER_TICK: f64 = 300.0 / 1e9;
/// Seconds of a PLC at a gateway in it.
const PLC_S_PER_TICK: f64 = 600.0 / 1e9;

/// Lets the simulator run for this many ticks, from this seed on, on all cores, tries a hostile calibration for each
/// hundred of them, changes its source ten thousand times, and draws faults for the detectors. For a thousand
/// million ticks sound sensors live for 300 hours of each noise, and PLCs of three languages are at their gateways
/// for ten minutes; so is the board on the model of its chip. A failure prints the seed that repeats it.
///
/// # Errors
/// It does not build, or something did not hold.
pub fn run_soak_campaign(ticks: u64, seed: u32) -> Result<()> {
    let run = |package: &str, binary: &str, test: &str| {
        let mut command = cargo::locked_cargo_command("test");
        command
            .args(["--profile", "soak", "-p", package, "--test", binary, "--"])
            .args(["--ignored", "--exact", test, "--nocapture"])
            .env("TRUEUP_SOAK_HOURS", (ticks as f64 * SENSOR_HOURS_PER_TICK).to_string())
            .env("TRUEUP_SOAK_TICKS", ticks.to_string())
            .env("TRUEUP_SOAK_BLOBS", (ticks / TICKS_PER_HOSTILE_BLOB).max(1_000).to_string())
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
    let mut programs = cargo::locked_cargo_command("test");
    programs
        .args(["-p", "trueup-host-tests", "--features", "emulator"])
        .args(["--test", "chip", "--test", "gateway_latency"])
        .args(["--", "--ignored", "--nocapture", "campaign_"])
        .env("TRUEUP_SOAK_PLC_S", ((ticks as f64 * PLC_S_PER_TICK).ceil() as u64).to_string());
    process::run(&mut programs)
}

/// Draws this many circles with faults, and a third as many sound ones, and counts how often `fit circle` names all
/// faults and nothing else.
///
/// # Errors
/// It does not build, fewer than 95 of 100 are wholly named, or a sound one has a name.
pub fn run_circle_campaign(count: u32) -> Result<()> {
    let mut test = cargo::locked_cargo_command("test");
    test.args(["--profile", "soak", "-p", "trueup-fit", "--test", "fit", "--"])
        .args(["--ignored", "--exact", "circle::campaign_300_drawn_circles_and_100_sound_ones"])
        .arg("--nocapture")
        .env("TRUEUP_CIRCLES", count.to_string());
    process::run(&mut test)
}

/// Draws this many machines with all errors of a volume, from this seed on, and as many without any, and prints how much of the error
/// is gone at other places, how often intervals hold, and how often an error is claimed that is not there. The errors of an axis are
/// drawn by `law`: `polynomials`, or `waves` or `walk`, of which the first two figures are printed alone.
///
/// # Errors
/// It does not build, too little is gone, or intervals do not hold; by `waves`: a machine has become worse.
pub fn run_volume_campaign(count: u32, first: u32, law: &str) -> Result<()> {
    let name = match law {
        "polynomials" => "campaign::campaign_100_drawn_machines",
        _ => "campaign::campaign_100_machines_by_another_law",
    };
    let mut test = cargo::locked_cargo_command("test");
    test.args(["--profile", "soak", "-p", "trueup-fit", "--test", "volume", "--"])
        .args(["--ignored", "--exact", name, "--nocapture"])
        .env("TRUEUP_VOLUMES_LAW", law)
        .env("TRUEUP_VOLUMES", count.to_string())
        .env("TRUEUP_VOLUMES_FIRST", first.to_string());
    process::run(&mut test)
}

/// Compares the board's arithmetic with homogeneous transforms in Python at this many poses of drawn machines, and prints the worst
/// difference.
///
/// # Errors
/// It does not build, Python is missing, or a difference is above 20 nm.
pub fn run_volume_board_campaign(poses: u32) -> Result<()> {
    let mut test = cargo::locked_cargo_command("test");
    test.args(["--features", "trueup-host-tests/emulator", "--test", "volume_oracle", "--"])
        .args(["--ignored", "--exact"])
        .arg("campaign_the_board_is_within_20_nm_of_homogeneous_transforms")
        .arg("--nocapture")
        .env("TRUEUP_POSES", poses.to_string());
    process::run(&mut test)
}

/// Lets events drawn by this seed happen to the real LinuxCNC with offsets that act, by each of these ways of entering
/// (`joint`, `eoffset`, `no-board`, with commas), until these numbers of servo cycles and events are reached; every cycle is judged.
/// Prints a table.
///
/// # Errors
/// It does not build, or a requirement is not reached.
pub fn run_linuxcnc_stress_test(cycles: u64, events: u64, seed: u64, ways: &str) -> Result<()> {
    let mut test = cargo::locked_cargo_command("test");
    test.args(["--features", "trueup-host-tests/emulator", "--test", "linuxcnc_joint", "--"])
        .args(["--ignored", "--exact", "abuse::campaign_abuse", "--nocapture"])
        .env("TRUEUP_ABUSE_CYCLES", cycles.to_string())
        .env("TRUEUP_ABUSE_EVENTS", events.to_string())
        .env("TRUEUP_ABUSE_SEED", seed.to_string())
        .env("TRUEUP_ABUSE_WAYS", ways);
    process::run(&mut test)
}

/// Lets the real LinuxCNC cut a circle on a virtual machine, fits it, lets it cut the same circle with the bridge in its servo thread,
/// and prints the figures of ISO 230-4 and the backlash of both.
///
/// # Errors
/// It does not build, or the circle is not 80 % rounder, or 95 % of the backlash is not gone.
pub fn run_linuxcnc_circular_test() -> Result<()> {
    let mut test = cargo::locked_cargo_command("test");
    test.args(["--features", "trueup-host-tests/emulator", "--test", "linuxcnc_joint", "--"])
        .args(["--ignored", "--exact"])
        .args(["circle::campaign_the_same_circle_is_rounder_with_the_bridge", "--nocapture"]);
    process::run(&mut test)
}

/// Lets each of the fuzz targets run for this many minutes, one on each core at a time; prints how many inputs
/// each has had.
///
/// # Errors
/// It does not build, or an input does what none may.
pub fn run_fuzz_targets(minutes: u64) -> Result<()> {
    let mut test = cargo::locked_cargo_command("test");
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
/// tested in a copy of the source; `target/mutants` has the lists. Stopped and called again it goes on where it was: a
/// mutant that has been tried, by its place and what it changes, is not tried again, not even after new tests: if you
/// have written some, delete `target/mutants` and begin anew.
///
/// # Errors
/// cargo-mutants cannot be had, or the tests fail without a mutant. A mutant that is missed is no error.
pub fn run_mutation_campaign(draw: usize, seed: u64) -> Result<()> {
    let program = cargo::install_tool("cargo-mutants", CARGO_MUTANTS_VERSION)?;
    let mut names: Vec<String> =
        list_mutants(&program)?.into_iter().map(|mutant| mutant.name).collect();
    names.sort_unstable();
    let drawn = draw_sample(names.iter().map(String::as_str).collect(), draw, seed);
    let by_unit =
        test_mutants(mutants_command(&program), "unit-tests", &drawn, &["--cargo-test-arg=--lib"])?;
    let missed: Vec<&str> = by_unit.missed.iter().map(String::as_str).collect();
    let all_tests = MUTATED_PACKAGES.map(|name| format!("--test-package={name}"));
    let all_tests = all_tests.each_ref().map(String::as_str);
    let by_all = match missed[..] {
        [] => MutantOutcomes::default(),
        _ => test_mutants(mutants_command(&program), "all-tests", &missed, &all_tests)?,
    };
    trueup_output::write_line_best_effort(format_args!(
        "{} drawn: {} caught, {} by the time limit, {} do not compile, {} missed\n{}",
        drawn.len(),
        by_unit.caught.len() + by_all.caught.len(),
        by_unit.timeout.len() + by_all.timeout.len(),
        by_unit.unviable.len(),
        by_all.missed.len(),
        by_all.missed.join("\n")
    ));
    Ok(())
}

/// Tries all mutants of the functions that the simulator tests, on the simulator alone, and counts how many it finds. As for
/// [`run_mutation_campaign`], `target/mutants` has the lists, and a mutant that has been tried is not tried again.
///
/// # Errors
/// cargo-mutants cannot be had, a function has no mutant, or the simulator fails without a mutant.
pub fn run_simulator_mutation_campaign() -> Result<()> {
    let program = cargo::install_tool("cargo-mutants", CARGO_MUTANTS_VERSION)?;
    let listed = list_mutants(&program)?;
    let mut names = Vec::new();
    for (file, function) in SIMULATOR_TESTED_FUNCTIONS {
        let is_of_it = |mutant: &&Mutant| {
            mutant.file == format!("crates/board/{file}") && mutant.function.ends_with(function)
        };
        let own: Vec<&str> =
            listed.iter().filter(is_of_it).map(|mutant| mutant.name.as_str()).collect();
        ensure!(!own.is_empty(), "{file} has no mutant of {function}");
        names.extend(own);
    }
    let options = ["--test-package=trueup-node", "--cargo-test-arg=--test=simulator"];
    let found = test_mutants(mutants_command(&program), "simulator", &names, &options)?;
    trueup_output::write_line_best_effort(format_args!(
        "{} mutants: the simulator finds {}, {} by the time limit, {} do not compile, {} missed\n{}",
        names.len(),
        found.caught.len(),
        found.timeout.len(),
        found.unviable.len(),
        found.missed.len(),
        found.missed.join("\n")
    ));
    Ok(())
}

/// A change that cargo-mutants makes.
struct Mutant {
    /// Its place, and the change.
    name: String,
    file: String,
    /// The function with its type; empty outside functions.
    function: String,
}

/// Returns the command for the crates that a board runs.
fn mutants_command(program: &Path) -> Command {
    let mut command = Command::new(program);
    command.arg("mutants").current_dir(setup::project_root());
    command.args(MUTATED_PACKAGES.iter().flat_map(|name| ["-p", name]));
    command
}

fn list_mutants(program: &Path) -> Result<Vec<Mutant>> {
    let mut command = mutants_command(program);
    let listed: Value =
        serde_json::from_str(&process::capture_stdout(command.args(["--list", "--json"]))?)?;
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let mutants = listed.as_array().context("a list of mutants")?.iter().map(|mutant| Mutant {
        name: text(&mutant["name"]),
        file: text(&mutant["file"]),
        function: text(&mutant["function"]["function_name"]),
    });
    Ok(mutants.collect())
}

/// Outcomes of some mutants, by their names; `missed` has those that nothing caught.
#[derive(Default)]
struct MutantOutcomes {
    caught: Vec<String>,
    timeout: Vec<String>,
    unviable: Vec<String>,
    missed: Vec<String>,
}

impl MutantOutcomes {
    /// Returns the lists that cargo-mutants and [`Self::write`] write into a folder; empty where there is none.
    fn read(folder: &Path) -> Self {
        let list = |name: &str| {
            let text = fs::read_to_string(folder.join(name)).unwrap_or_default();
            text.lines().map(String::from).collect()
        };
        Self {
            caught: list("caught.txt"),
            timeout: list("timeout.txt"),
            unviable: list("unviable.txt"),
            missed: list("missed.txt"),
        }
    }

    /// Its lists, with their names.
    fn outcome_lists_mut(&mut self) -> [(&'static str, &mut Vec<String>); 4] {
        [
            ("caught.txt", &mut self.caught),
            ("timeout.txt", &mut self.timeout),
            ("unviable.txt", &mut self.unviable),
            ("missed.txt", &mut self.missed),
        ]
    }

    /// Takes these, of `names` alone, each once.
    fn merge_selected(&mut self, mut more: Self, names: &[&str]) {
        let mut known: Vec<String> =
            self.outcome_lists_mut().into_iter().flat_map(|(_, list)| list.clone()).collect();
        for ((_, list), (_, more)) in
            self.outcome_lists_mut().into_iter().zip(more.outcome_lists_mut())
        {
            for name in more.drain(..) {
                if names.contains(&name.as_str()) && !known.contains(&name) {
                    known.push(name.clone());
                    list.push(name);
                }
            }
        }
    }

    fn write(&mut self, folder: &Path) -> Result<()> {
        for (name, list) in self.outcome_lists_mut() {
            fs::write(
                folder.join(name),
                list.iter().map(|name| format!("{name}\n")).collect::<String>(),
            )?;
        }
        Ok(())
    }
}

/// Tries these mutants with these options, but for those that were tried before, and leaves the lists in
/// `target/mutants/<folder>`.
fn test_mutants(
    mut run: Command,
    folder: &str,
    names: &[&str],
    options: &[&str],
) -> Result<MutantOutcomes> {
    let folder = setup::project_root().join("target/mutants").join(folder);
    let of_run = folder.join("mutants.out");
    fs::create_dir_all(&folder)?;
    // What is kept, and what a run that was stopped has come to.
    let mut outcome = MutantOutcomes::default();
    outcome.merge_selected(MutantOutcomes::read(&folder), names);
    outcome.merge_selected(MutantOutcomes::read(&of_run), names);
    outcome.write(&folder)?;
    let tried: Vec<String> =
        outcome.outcome_lists_mut().into_iter().flat_map(|(_, list)| list.clone()).collect();
    let mut config = String::from("examine_re = [\n");
    let mut left = 0;
    for name in names.iter().filter(|name| !tried.iter().any(|other| other == *name)) {
        let escaped: String = name.chars().flat_map(escape_regex_char).collect();
        writeln!(config, "  '''^{escaped}$''',")?;
        left += 1;
    }
    config.push_str("]\n");
    trueup_output::write_diagnostic(format_args!(
        "{} of {} tried before, {left} left",
        tried.len(),
        names.len()
    ));
    if left == 0 {
        return Ok(outcome);
    }
    fs::write(folder.join("drawn.toml"), config)?;
    run.args(["--no-shuffle", "--timeout", "120", "--config"]).arg(folder.join("drawn.toml"));
    let status = run.args(options).arg("-o").arg(&folder).status()?;
    // 2: some were missed, 3: some ran into the time limit, which is as good as caught.
    ensure!(matches!(status.code(), Some(0 | 2 | 3)), "cargo-mutants: {status}");
    outcome.merge_selected(MutantOutcomes::read(&of_run), names);
    outcome.write(&folder)?;
    Ok(outcome)
}

/// As many of these as are requested, the same for the same seed.
fn draw_sample<T>(mut from: Vec<T>, count: usize, seed: u64) -> Vec<T> {
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

/// Returns a character as a regular expression has it.
fn escape_regex_char(character: char) -> impl Iterator<Item = char> {
    let is_special = r"\.+*?()|[]{}^$".contains(character);
    is_special.then_some('\\').into_iter().chain([character])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_tried_counts_once_and_only_where_it_is_asked_for() {
        let names = |all: &[&str]| all.iter().map(|name| (*name).to_string()).collect::<Vec<_>>();
        let mut outcome = MutantOutcomes::default();
        let first = MutantOutcomes {
            caught: names(&["a", "of another draw"]),
            ..MutantOutcomes::default()
        };
        outcome.merge_selected(first, &["a", "b", "c"]);
        let again = MutantOutcomes {
            caught: names(&["a"]),
            missed: names(&["a", "b"]),
            ..MutantOutcomes::default()
        };
        outcome.merge_selected(again, &["a", "b", "c"]);
        assert_eq!((outcome.caught, outcome.missed), (names(&["a"]), names(&["b"])));
    }

    #[test]
    fn a_seed_draws_each_once_and_the_same_again() {
        let mut all = draw_sample((0..50).collect(), 60, 7);
        assert_eq!(all, draw_sample((0..50).collect(), 60, 7));
        assert_ne!(all[..20], draw_sample((0..50).collect(), 20, 8));
        all.sort_unstable();
        assert!(all.into_iter().eq(0..50));
    }
}
