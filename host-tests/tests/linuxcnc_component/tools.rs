//! Three tools in the real LinuxCNC: each grows with the speed in its own way, where the sensor in the nose does not
//! see it. The twin is the metal: it receives which tool LinuxCNC has in the spindle and how fast that turns, the
//! sensor's growth goes to the bridge, and what counts is where the tool tip is.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{
    path::Path,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Result, ensure};
use trueup_emulator::{linuxcnc::headless_linuxcnc::HeadlessLinuxCnc, setup};
use trueup_machine::MachineFile;
use trueup_twin::{
    Scenario,
    machine::{DriveCommand, SimulatedMachine as Twin},
    noise::rms,
};

use super::linuxcnc_rig::{bridge::RigBridge, control};

/// The user's machine file: the sensor, and each tool by its number.
const MACHINE: &str = "\
[machine]
name = \"three tools\"
kind = \"3-axis\"
[inputs]
sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }
[spindle]
source = \"sensor\"
[spindle.sensor]
k0_um = 0.0
zero_counts = 5048.0
um_per_count = 0.0152587890625
[spindle.tools]
1 = { um_per_krpm2 = 0.09 }
2 = { um_per_krpm2 = -0.045 }
3 = { um_per_krpm2 = 0.06 }
default = { um_per_krpm2 = 0.0 }
[limits]
slew_um_per_s = 500.0
";
/// The metal: a shaft that warms, tools that grow by their speed, and a holder of no length.
const METAL: &str = "\
name = \"three tools\"
measure = [\"elongation\"]
[ambient]
amplitude_c = 0.0
wander_c = 0.0
[spindle]
cells = 20
centrifugal_um_per_krpm2 = 0.0
stiffness_n_per_um = 0.0
housing_length_m = 0.0
holder_length_m = 0.0
[sensor]
[[tool]]
number = 1
centrifugal_um_per_krpm2 = 0.09
[[tool]]
number = 2
centrifugal_um_per_krpm2 = -0.045
[[tool]]
number = 3
centrifugal_um_per_krpm2 = 0.06
[[segment]]
kind = \"spindle\"
duration_s = 1
";
const TABLE: &str = "T1 P1 D10 Z50\nT2 P2 D6 Z40\nT3 P3 D6 Z60\n";
const RPM: f64 = 20_000.0;
/// A second of the wall is this many of the metal: it is to warm.
const HURRIED: f64 = 20.0;
/// For this long the growth counts, once the offset has come.
const COUNTS: Duration = Duration::from_millis(1_500);
/// A computer without a real-time kernel may be late for this long.
const COMES_WITHIN: Duration = Duration::from_secs(30);
/// Share of the growth that may be left, with tools and speeds.
const LEFT: f64 = 0.05;

/// Lets the metal live with what LinuxCNC does; gives growth and what the offset leaves of it, in µm. They count from
/// when the offset has come, and only while it is live: a computer that is late for a moment holds it for as long.
fn live(cnc: &mut HeadlessLinuxCnc, bridge: &RigBridge, metal: &mut Twin) -> Result<Vec<[f64; 2]>> {
    let names =
        ["iocontrol.0.tool-number", "spindle.0.speed-out", "axis.z.eoffset", "trueup.0.quality"];
    let (begun, mut before) = (Instant::now(), Instant::now());
    let (mut seen, mut counted) = (Vec::new(), Duration::ZERO);
    while counted < COUNTS {
        thread::sleep(Duration::from_millis(20));
        let pins = cnc.read_pins(&names)?;
        let passed = before.elapsed();
        before += passed;
        let command =
            DriveCommand { tool: pins[0] as u16, spindle_rpm: pins[1], ..DriveCommand::default() };
        metal.step(passed.as_secs_f64() * HURRIED, &command);
        let counts = metal.read_sensor_counts().unwrap_or(f64::NAN);
        bridge.grow_to((counts - 5_048.0) * 500.0 / 32_768.0);
        let grown_um = metal.elongation_um();
        // The tool points down: what it grows is taken back by an offset up.
        let left_um = grown_um - pins[2] * 1e3;
        let has_come = !seen.is_empty() || left_um.abs() < LEFT * grown_um.abs().max(10.0);
        if pins[3] == 1.0 && has_come {
            seen.push([grown_um, left_um]);
            counted += passed;
        }
        ensure!(
            begun.elapsed() < COMES_WITHIN,
            "after {COMES_WITHIN:?} {left_um:.3} um are left of {grown_um:.2}; {names:?} are {pins:?}"
        );
    }
    Ok(seen)
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn with_three_tools_95_percent_of_the_growth_are_gone() -> Result<()> {
    let Some(linuxcnc) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let machine = MachineFile::parse(MACHINE, Path::new("tools.toml"))?;
    let mut metal = Twin::new(&Scenario::parse(METAL, Path::new("metal.toml"))?, 5);
    let bridge = RigBridge::start(&machine)?;
    bridge.grow_to(0.0);
    let files = [("trueup_gantry.toml", MACHINE), ("trueup_sim.tbl", TABLE)];
    let mut cnc = control::start_with(linuxcnc, "trueup_sim.ini", &bridge.address(), &files)?;
    cnc.run_halcmd("net trueup-tool iocontrol.0.tool-number => trueup.0.tool")?;
    cnc.power_on_and_home()?;
    let mut seen: Vec<[f64; 2]> = Vec::new();
    for tool in [1, 2, 3, 1, 3, 2] {
        cnc.send_request_with_argument("mdi", "text", "M5")?;
        cnc.send_request_with_argument("mdi", "text", format!("T{tool} M6"))?;
        let is_there = |pins: &[f64]| pins[0] == f64::from(tool);
        cnc.wait_for_pins("the tool", 10, &["iocontrol.0.tool-number"], is_there)?;
        cnc.send_request_with_argument("mdi", "text", format!("S{RPM} M3"))?;
        let part = live(&mut cnc, &bridge, &mut metal)?;
        let of = |n: usize| rms(&part.iter().map(|sample| sample[n]).collect::<Vec<f64>>());
        println!("tool {tool}: grown {:.2} um, left {:.3} um", of(0), of(1));
        ensure!(
            of(1) < LEFT * of(0).max(10.0),
            "tool {tool}: {:.3} um are left of {:.2}",
            of(1),
            of(0)
        );
        seen.extend(part);
    }
    let of = |n: usize| rms(&seen.iter().map(|sample| sample[n]).collect::<Vec<f64>>());
    let (grown, left) = (of(0), of(1));
    println!(
        "RMS {grown:.2} um without, {left:.3} um with: {:.1} % gone",
        100.0 * (1.0 - left / grown)
    );
    ensure!(left <= LEFT * grown, "{left:.3} um are left of {grown:.2}");
    cnc.wait_for_pins("live at the end", 5, &["trueup.0.quality"], |pins| pins[0] == 1.0)?;
    Ok(())
}
