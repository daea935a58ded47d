//! Offsets at the joint in the real LinuxCNC: a configuration as its own simulators have it, checked and set up by
//! `trueup linuxcnc`, every servo cycle recorded while things happen to it.
//!
//! The bridge is a program of the test, so that offsets jump when the test wants it.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

mod abuse;
mod circle;
mod events;
mod fake_bridge;
mod no_board;
mod record;
mod stock_files;

use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
    sync::mpsc::Receiver,
    thread,
    time::Duration,
};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::{
    host_programs,
    linuxcnc::headless_linuxcnc::{DISPLAY_PROGRAM, HeadlessLinuxCnc, SamplerGuard},
    setup::{self, LockedLinuxCnc},
};

use self::{
    fake_bridge::FakeBridge,
    record::{Cycle, Seen, record},
    stock_files::{INI, OWN, ini},
};

const MAX_VELOCITY: f64 = 30.0;
const MAX_ACCELERATION: f64 = 1_000.0;
/// The share of acceleration that is assumed where the INI file states none.
const HEADROOM: f64 = 0.2;
/// The slew limit of the machine file, in mm/s.
const SLEW: f64 = 1.2;
const CYCLE_S: f64 = 1e-3;
/// The recorder rounds to 1 nm, in mm; a sum has three numbers, an acceleration four.
const NOISE: f64 = 2e-6;
const NOISE_OF_ACCELERATION: f64 = 2.0;
/// Where the probe closes and the home switch of X is, by the drives, in mm.
const SURFACE: f64 = -5.0;
const SWITCH: f64 = -2.0;

/// LinuxCNC with the offsets at its joints.
struct Rig {
    cnc: HeadlessLinuxCnc,
    bridge: FakeBridge,
    cycles: Receiver<Option<Cycle>>,
    _sampler: SamplerGuard,
}

fn tool(words: &[&str], code: i32) -> Result<String> {
    let done =
        Command::new(host_programs::build_trueup()?).args(words).stdin(Stdio::null()).output()?;
    let error_text = format!(
        "{}{}",
        String::from_utf8_lossy(&done.stdout),
        String::from_utf8_lossy(&done.stderr)
    );
    ensure!(
        done.status.code() == Some(code),
        "trueup {words:?}: {:?}, not {code}\n{error_text}",
        done.status
    );
    Ok(error_text)
}

/// Returns the text of each file of a folder that has a name like these.
fn texts(folder: &Path) -> Result<Vec<(String, String)>> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.ends_with(".ini") || name.ends_with(".hal") {
            all.push((name, fs::read_to_string(entry.path())?));
        }
    }
    all.sort();
    Ok(all)
}

/// Returns the signals of offsets at the joint, as [`record`] wants them.
fn joint_signals() -> Vec<String> {
    let joints = |end: &'static str| (0..3).map(move |joint| format!("trueup-j{joint}-{end}"));
    let drives = ["Xpos", "Ypos", "Zpos"].map(String::from);
    let mut signals: Vec<String> = joints("cmd").chain(drives).collect();
    signals.extend(joints("now").chain(joints("fb")));
    signals.extend(["trueup-j0-offset", "trueup-on"].map(String::from));
    signals.extend(joints("reference-in"));
    signals.push("event screen.scenario".into());
    signals
}

/// Starts LinuxCNC with this configuration, which is checked, set up, taken out to the byte, and set up again. The
/// machine file has this slew limit, in mm/s.
fn stock(
    control: LockedLinuxCnc,
    ini: &str,
    by: &str,
    slew: f64,
    bridge: &FakeBridge,
) -> Result<HeadlessLinuxCnc> {
    let folder = HeadlessLinuxCnc::create_config_folder()?;
    let path = |name: &str| folder.path().join(name);
    let here = folder.path().to_str().context("a temporary folder has a plain name")?;
    fs::write(path("stock.ini"), ini.replace("FOLDER", here).replace("SCREEN", DISPLAY_PROGRAM))?;
    fs::write(path("own.hal"), OWN)?;
    fs::write(path("sim.tbl"), "")?;
    let gantry = setup::project_root().join("integrations/linuxcnc/trueup_gantry.toml");
    let slew = format!("slew_um_per_s = {:.1}", slew * 1e3);
    let machine = fs::read_to_string(gantry)?.replace("slew_um_per_s = 500.0", &slew);
    fs::write(path("machine.toml"), machine)?;
    fs::copy(host_programs::build_trueup()?, path("trueup"))?;
    for name in ["trueup_probe.ngc", "trueup_touch_off.ngc"] {
        fs::copy(setup::project_root().join("integrations/linuxcnc").join(name), path(name))?;
    }

    let (ini, machine) = (path("stock.ini"), path("machine.toml"));
    let (ini, machine) = (ini.to_string_lossy(), machine.to_string_lossy());
    let before = texts(folder.path())?;
    let text = tool(&["linuxcnc", "check", &ini, "--by", by, "--machine", &machine], 0)?;
    ensure!(by != "joint" || text.contains("a reversal of 6 um takes 11.0 ms"), "{text}");
    let port = bridge.address();
    let setup = ["linuxcnc", "setup", &ini, "--by", by, "--machine", &machine, "--port", &port];
    tool(&setup, 0)?;
    let once = texts(folder.path())?;
    let text = tool(&setup, 0)?;
    ensure!(text.contains("nothing was changed") && texts(folder.path())? == once, "{text}");
    tool(&["linuxcnc", "setup", &ini, "--remove"], 0)?;
    ensure!(texts(folder.path())? == before, "taken out, the files are the same to the byte");
    tool(&setup, 0)?;
    HeadlessLinuxCnc::start(folder, "stock.ini", control)
}

impl Rig {
    fn start() -> Result<Option<Self>> {
        let Some(control) = setup::install_and_lock_linuxcnc()? else {
            println!("skipped: this distribution has no package of LinuxCNC");
            return Ok(None);
        };
        let bridge = FakeBridge::start()?;
        let mut cnc = stock(control, &ini(), "joint", SLEW, &bridge)?;
        let (sampler, cycles) = record(&mut cnc, &joint_signals())?;
        cnc.power_on_and_home()?;
        Ok(Some(Self { cnc, bridge, cycles, _sampler: sampler }))
    }

    /// Says these offsets, and waits until they act.
    fn offsets(&mut self, um: [f64; 3]) -> Result<()> {
        self.bridge.set_offset(um);
        self.applied(um)
    }

    fn applied(&mut self, um: [f64; 3]) -> Result<()> {
        let names = [
            "trueup.0.x-applied-um",
            "trueup.0.y-applied-um",
            "trueup.0.z-applied-um",
            "trueup.0.applied",
        ];
        self.cnc.wait_for_pins(&format!("{um:?} act"), 20, &names, |seen| {
            (0..3).all(|axis| (seen[axis] - um[axis]).abs() < 0.02) && seen[3] == 1.0
        })
    }

    fn mdi(&mut self, text: &str) -> Result<()> {
        self.cnc.send_request_with_argument("mdi", "text", text).map(drop)
    }

    /// Returns the cycles since the last call.
    fn cycles(&mut self) -> Vec<Option<Cycle>> {
        // What the recorder holds back for a moment.
        thread::sleep(Duration::from_millis(300));
        self.cycles.try_iter().collect()
    }

    /// Checks all cycles since the last call.
    fn check(&mut self, what: &str) -> Result<Seen> {
        let seen = Seen::of(&self.cycles());
        println!("{what}: {seen:?}");
        ensure!(seen.cycles > 100 && seen.offset > 0.0, "{what}: hardly a cycle was recorded");
        // The drive's command is the planner's and the offset, and the planner's feedback lacks it.
        ensure!(seen.sum <= NOISE && seen.feedback <= NOISE, "{what}: {seen:?}");
        ensure!(seen.offset_speed <= SLEW + NOISE / CYCLE_S, "{what}: {seen:?}");
        ensure!(
            seen.offset_acceleration <= HEADROOM * MAX_ACCELERATION + NOISE_OF_ACCELERATION,
            "{what}: {seen:?}"
        );
        ensure!(seen.drive_speed <= MAX_VELOCITY + SLEW + NOISE / CYCLE_S, "{what}: {seen:?}");
        let drive = (1.0 + HEADROOM) * MAX_ACCELERATION + NOISE_OF_ACCELERATION;
        ensure!(seen.drive_acceleration <= drive, "{what}: {seen:?}");
        Ok(seen)
    }
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn offsets_at_the_joint_cost_nothing_and_survive_what_happens() -> Result<()> {
    let Some(mut rig) = Rig::start()? else { return Ok(()) };
    rig.offsets([10.0, -20.0, 40.0])?;
    no_board::silent(&mut rig.cnc)?;
    rig.check("start")?;
    use events::*;
    let all = [
        reversals,
        programs,
        aborts,
        power,
        homing,
        ended,
        homed_meanwhile,
        soft_limit,
        probing,
        silence,
    ];
    for event in all {
        event(&mut rig)?;
    }
    rig.cnc.close()
}

/// The recipes for touching off, on a machine in inches.
#[test]
#[ignore = "long: the real LinuxCNC"]
fn touching_off_at_the_joint_is_right_on_a_machine_in_inches() -> Result<()> {
    const MM: f64 = 25.4;
    let Some(control) = setup::install_and_lock_linuxcnc()? else { return Ok(()) };
    let mut text = INI.replace("UNITS = mm", "UNITS = inch");
    for (joint, axis) in ["X", "Y", "Z"].iter().enumerate() {
        let motion = in_inches(50.0);
        text += &format!("[AXIS_{axis}]\n{motion}{}", home_at_once(joint, &motion));
    }
    let bridge = FakeBridge::start()?;
    let mut cnc = stock(control, &text, "joint", SLEW, &bridge)?;
    cnc.power_on_and_home()?;
    cnc.run_halcmd(&format!("setp probe.in1 {}", SURFACE / MM))?;
    bridge.set_offset([50.0, -20.0, 70.0]);
    cnc.wait_for_pins(
        "the offset acts",
        20,
        &["trueup-mv.offset-current-2", "trueup.0.applied"],
        |seen| (seen[0] * MM * 1e3 - 70.0).abs() < 0.02 && seen[1] == 1.0,
    )?;
    events::macros(&mut cnc, MM)?;
    cnc.close()
}

/// Returns an axis's lines of motion within ± `mm`, in inches.
fn in_inches(mm: f64) -> String {
    const MM: f64 = 25.4;
    format!(
        "MIN_LIMIT = {}\nMAX_LIMIT = {}\nMAX_VELOCITY = {}\nMAX_ACCELERATION = {}\n",
        -mm / MM,
        mm / MM,
        MAX_VELOCITY / MM,
        MAX_ACCELERATION / MM
    )
}

/// Returns a joint that is at home where it is.
fn home_at_once(joint: usize, motion: &str) -> String {
    let home = "HOME_SEARCH_VEL = 0\nHOME_LATCH_VEL = 0\nHOME = 0\nHOME_SEQUENCE = 0\n";
    format!("[JOINT_{joint}]\nTYPE = LINEAR\nFERROR = 1\nMIN_FERROR = 1\n{motion}{home}")
}

/// In inches, with a second joint of Y.
#[test]
#[ignore = "long: the real LinuxCNC"]
fn both_joints_of_a_gantry_in_inches_get_the_offset_of_their_axis() -> Result<()> {
    const MM: f64 = 25.4;
    let Some(control) = setup::install_and_lock_linuxcnc()? else { return Ok(()) };
    let mut text = INI
        .replace("core_sim.hal\nHALFILE = own.hal", "gantrysim.hal")
        .replace("UNITS = mm", "UNITS = inch")
        .replace("X Y Z", "XYYZ")
        .replace("trivkins\nJOINTS = 3", "trivkins coordinates=XYYZ\nJOINTS = 4");
    let motion = in_inches(50.0);
    for axis in ["X", "Y", "Z"] {
        text += &format!("[AXIS_{axis}]\n{motion}");
    }
    for joint in 0..4 {
        text += &home_at_once(joint, &motion);
    }
    let bridge = FakeBridge::start()?;
    let mut cnc = stock(control, &text, "joint", SLEW, &bridge)?;
    cnc.power_on_and_home()?;
    bridge.set_offset([10.0, -20.0, 40.0]);
    let names = [0, 1, 2, 3].map(|joint| format!("trueup-mv.offset-current-{joint}"));
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    cnc.wait_for_pins("the offsets act", 20, &names, |seen| {
        let um = [10.0, -20.0, -20.0, 40.0];
        seen.iter().zip(um).all(|(now, um)| (now * MM * 1e3 - um).abs() < 0.02)
    })?;
    cnc.send_request_with_argument("mdi", "text", "G53 G0 X1 Y1 Z-1")?;
    let seen =
        cnc.read_pins(&["trueup-j1.out", "trueup-j2.out", "trueup-j3.out", "trueup.0.applied"])?;
    let expected = [1.0 - 0.02 / MM, 1.0 - 0.02 / MM, -1.0 + 0.04 / MM, 1.0];
    assert!(seen.iter().zip(expected).all(|(one, other)| (one - other).abs() < 1e-6), "{seen:?}");
    cnc.close()
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn external_offsets_that_setup_has_written_act() -> Result<()> {
    let Some(control) = setup::install_and_lock_linuxcnc()? else { return Ok(()) };
    let bridge = FakeBridge::start()?;
    let mut cnc = stock(control, &ini(), "eoffset", SLEW, &bridge)?;
    cnc.power_on_and_home()?;
    bridge.set_offset([10.0, -20.0, 40.0]);
    let names = ["axis.x.eoffset", "axis.y.eoffset", "axis.z.eoffset", "trueup.0.applied"];
    cnc.wait_for_pins("the offsets act", 20, &names, |seen| {
        let mm = [0.01, -0.02, 0.04];
        seen.iter().zip(mm).all(|(now, mm)| (now - mm).abs() < 2e-5) && seen[3] == 1.0
    })?;
    cnc.close()
}
