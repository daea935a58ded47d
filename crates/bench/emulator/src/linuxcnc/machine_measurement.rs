//! How the machine file of the loop is made: as a user makes one. The machine is measured, with its
//! own instruments and their noise (`trueup simulate`), each section is fitted (`trueup fit`), and
//! what the spindle's sensor does not see is found (`trueup diagnose`). Nothing is copied from the
//! machine's own constants.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result, ensure};
use trueup_machine::{Machine, MachineFile};
use trueup_twin::Scenario;

/// The machine, as the twin takes it.
const TWIN_MACHINE_TOML: &str = include_str!("machine.toml");
/// The user's knowledge without measuring.
const BASE_MACHINE_TOML: &str = include_str!("base.toml");
/// Seeds of the measured runs; the loop itself has another.
const MEASUREMENT_SEEDS: [u64; 6] = [11, 12, 13, 14, 15, 16];
/// Seed of the machine in the loop.
pub(crate) const LOOP_SEED: u64 = 2_024;

/// A position run of an axis.
struct PositionRun {
    axis: &'static str,
    range_mm: [f64; 2],
    targets: u32,
    /// Largest distance of a target from its even place: on multiples of the pitch its error would not show.
    spread_mm: f64,
    cycles: u32,
    /// The curves of the other axes that it shows.
    across: &'static [&'static str],
}

const TARGET_SPREAD_MM: f64 = 7.0;

const POSITION_RUNS: [PositionRun; 3] = [
    PositionRun {
        axis: "x",
        range_mm: [10.0, 14_290.0],
        targets: 144,
        spread_mm: TARGET_SPREAD_MM,
        cycles: 1,
        across: &["dy", "dz"],
    },
    PositionRun {
        axis: "y",
        range_mm: [10.0, 2_990.0],
        targets: 61,
        spread_mm: TARGET_SPREAD_MM,
        cycles: 1,
        across: &["dx", "dz"],
    },
    PositionRun {
        axis: "z",
        range_mm: [10.0, 2_490.0],
        targets: 84,
        spread_mm: TARGET_SPREAD_MM,
        cycles: 5,
        across: &["dx", "dy"],
    },
];
/// Heights at which Z reverses, in mm. They are approached from both sides within seconds, so that what the laser drifts is in
/// both: on the whole way up and down again it drifts by a tenth of a micrometre.
const Z_REVERSAL_POSITIONS_MM: [f64; 12] = [
    100.0, 300.0, 500.0, 700.0, 900.0, 1_100.0, 1_300.0, 1_500.0, 1_700.0, 1_900.0, 2_100.0,
    2_300.0,
];
/// The screw of Z is run warm and measured in between.
const WARM_SCREW_RUN: PositionRun = PositionRun {
    axis: "z",
    range_mm: [10.0, 2_490.0],
    targets: 9,
    spread_mm: TARGET_SPREAD_MM,
    cycles: 1,
    across: &[],
};
const WARM_UP_SEGMENT_TOML: &str = "[[segment]]\nkind = \"move\"\nto_mm = [0.0, 0.0, 2400.0]\ncycles = 40\n\
                        feed_mm_per_min = 20000.0\n";
/// The run of the spindle: seconds, r/min.
const WARM_UP_SPEED_SPECTRUM: [(u32, u32); 7] = [
    (7_200, 24_000),
    (3_600, 0),
    (3_600, 12_000),
    (1_800, 20_000),
    (900, 6_000),
    (3_600, 18_000),
    (3_600, 0),
];

impl PositionRun {
    /// As a piece of a scenario. Slowly, because a screw that moves gets warm.
    fn to_segment_toml(&self) -> String {
        let Self { axis, range_mm: [first, last], targets, spread_mm, cycles, .. } = self;
        format!(
            "[[segment]]\nkind = \"positions\"\naxis = \"{axis}\"\nrange_mm = [{first:?}, {last:?}]\n\
             targets = {targets}\ncycles = {cycles}\nspread_mm = {spread_mm:?}\ndwell_s = 1.0\n\
             feed_mm_per_min = 3000.0\n"
        )
    }
}

/// The machine as the bridge knows it.
pub struct MeasuredMachine {
    /// The machine file's text.
    pub text: String,
    /// The same, read.
    pub machine: Machine,
    /// What the diagnosis has found, as it says it.
    pub findings: String,
}

/// The keys of a machine file that are times of the machine.
const TIME_KEYS: [&str; 4] = ["lag_s", "time_constant_s", "warm_s", "cool_s"];

impl MeasuredMachine {
    /// Returns the machine file of a machine that lives this many times faster.
    ///
    /// # Errors
    /// A time is not a number.
    pub(crate) fn time_compressed_machine_file(&self, factor: u32) -> Result<String> {
        let hurry = |line: &str| -> Result<String> {
            let Some((key, value)) = line.split_once(" = ") else { return Ok(line.into()) };
            if !TIME_KEYS.contains(&key) {
                return Ok(line.into());
            }
            let seconds: f64 = value.parse().with_context(|| format!("{line:?} is no time"))?;
            Ok(format!("{key} = {:?}", seconds / f64::from(factor)))
        };
        let lines: Result<Vec<String>> = self.text.lines().map(hurry).collect();
        Ok(lines?.join("\n") + "\n")
    }
}

/// Returns the machine in the loop, as a scenario that does nothing by itself.
///
/// # Errors
/// The project's own file is broken.
pub(crate) fn load_twin_scenario() -> Result<Scenario> {
    scenario_toml(&["elongation"], 1, "[[segment]]\nkind = \"spindle\"\nduration_s = 1.0\n")
        .and_then(|text| Ok(Scenario::parse(&text, Path::new("machine.toml"))?))
}

/// Returns the machine, with what is measured and what is done.
fn scenario_toml(measure: &[&str], repeat: u32, segments: &str) -> Result<String> {
    Ok(format!(
        "name = \"the machine in the loop\"\nmeasure = {}\ninterval_s = 20.0\nrepeat = {repeat}\nhead = [\"c\", \
         \"a\"]\nstart_mm = [0.0, 0.0, 0.0]\n{TWIN_MACHINE_TOML}\n{segments}",
        serde_json::to_string(measure)?
    ))
}

/// Measures the machine and makes its machine file, with `trueup` in `folder`.
///
/// # Errors
/// One of the steps fails; with its output.
pub(crate) fn measure_machine(trueup: &Path, folder: &Path) -> Result<MeasuredMachine> {
    let run = |arguments: &[&str]| -> Result<String> {
        let output = Command::new(trueup).args(arguments).current_dir(folder).output()?;
        let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
        ensure!(
            output.status.success(),
            "`trueup {}` failed: {}{stdout}",
            arguments.join(" "),
            String::from_utf8_lossy(&output.stderr)
        );
        Ok(stdout)
    };
    let simulate = |name: &str, text: String, seed: u64| -> Result<()> {
        let (toml, csv) = (format!("{name}.toml"), format!("{name}.csv"));
        fs::write(folder.join(&toml), text)?;
        run(&["simulate", "--scenario", &toml, "--seed", &seed.to_string(), "-o", &csv]).map(drop)
    };
    let path = |name: &str| -> PathBuf { folder.join(name) };
    let fit = |arguments: &[&str]| -> Result<()> {
        let files = ["--machine", "m.toml", "-o", "m.toml"];
        run(&[&["fit"], arguments, &files[..]].concat()).map(drop)
    };
    fs::write(path("m.toml"), BASE_MACHINE_TOML)?;
    let segments: String = WARM_UP_SPEED_SPECTRUM
        .iter()
        .map(|(seconds, rpm)| {
            format!(
                "[[segment]]\nkind = \"spindle\"\nduration_s = {seconds}.0\nspindle_rpm = {rpm}.0\n"
            )
        })
        .collect();
    simulate("warm", scenario_toml(&["elongation"], 1, &segments)?, MEASUREMENT_SEEDS[0])?;
    fit(&["elongation", "--run", "warm.csv"])?;
    for (positions, seed) in POSITION_RUNS.iter().zip(&MEASUREMENT_SEEDS[1..]) {
        let PositionRun { axis, across, .. } = positions;
        let csv = format!("{axis}.csv");
        let measured = [*across, &["dz"]].concat();
        let own: &[&str] = if *axis == "z" { &measured } else { across };
        simulate(axis, scenario_toml(own, 1, &positions.to_segment_toml())?, *seed)?;
        for quantity in *across {
            fit(&["straightness", "--run", &csv, "--quantity", quantity])?;
        }
    }
    let segments = WARM_SCREW_RUN.to_segment_toml() + WARM_UP_SEGMENT_TOML;
    simulate("screw", scenario_toml(&["dz"], 6, &segments)?, MEASUREMENT_SEEDS[4])?;
    let pitch = ["pitch", "--run", "z.csv", "--quantity", "dz"];
    let by_screw = ["--temperature", "temp_screw_c"];
    let thermal = ["thermal", "--run", "screw.csv", "--quantity", "dz"];
    // Each is measured with some of the other in it, so they are fitted in turn.
    for _ in 0..2 {
        fit(&pitch)?;
        fit(&[&thermal[..], &by_screw[..]].concat())?;
    }
    fit(&pitch)?;
    let reversal = |z_mm: f64| {
        let range_mm = [z_mm, z_mm + 20.0];
        PositionRun { axis: "z", range_mm, targets: 2, spread_mm: 0.0, cycles: 5, across: &[] }
    };
    let segments: String =
        Z_REVERSAL_POSITIONS_MM.map(|z_mm| reversal(z_mm).to_segment_toml()).concat();
    simulate("reversals", scenario_toml(&["dz"], 1, &segments)?, MEASUREMENT_SEEDS[5])?;
    fit(&["backlash", "--run", "reversals.csv", "--axis", "z"])?;
    let findings =
        run(&["diagnose", "--machine", "m.toml", "--run", "warm.csv", "--out", "diagnosis"])?;
    let text = fs::read_to_string(path("diagnosis/extended.toml"))
        .context("the diagnosis has written no machine file")?;
    let machine = MachineFile::parse(&text, Path::new("extended.toml"))?;
    Ok(MeasuredMachine { text, machine, findings })
}
