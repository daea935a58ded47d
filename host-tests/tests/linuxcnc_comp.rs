//! The exported compensation in the real LinuxCNC: Debian's `linuxcnc-uspace`, without a screen and
//! not as root, with three simulated joints. What it adds to a joint's command, read from its HAL
//! pins over the travel and in both directions, is the opposite of the model's error, within the
//! difference that the export states.

use std::{
    fs::{self, File},
    os::unix::{fs::PermissionsExt as _, process::CommandExt as _},
    path::Path,
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail, ensure};
use tempfile::TempDir;
use trueup_emulator::setup;
use trueup_export::{Approach, Export, Format, Options, export, linuxcnc};
use trueup_machine::{
    MachineFile,
    model::{backlash_um, pitch_um},
};

/// A run takes about a tenth of this on an idle computer.
const PATIENCE: Duration = Duration::from_secs(300);
/// The user and group that own nothing.
const NOBODY: u32 = 65_534;
/// At rest LinuxCNC keeps the compensation of the last cycle in which the joint still moved, a
/// fraction of a micrometre before the end; with the tables' slopes and the rest of the backlash
/// filter that is less than this, in µm.
const SETTLED_UM: f64 = 1e-3;
const JOINTS: [&str; 3] = ["x", "y", "z"];

const CONFIGURATION: &str = "\
[EMC]
VERSION = 1.1
MACHINE = trueup
DEBUG = 0
[DISPLAY]
DISPLAY = FOLDER/display.sh
[RS274NGC]
PARAMETER_FILE = FOLDER/sim.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 1.0
SERVO_PERIOD = 1000000
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[HAL]
HALFILE = FOLDER/sim.hal
[TRAJ]
COORDINATES = XYZ
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
DEFAULT_LINEAR_VELOCITY = 5000
MAX_LINEAR_VELOCITY = 5000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = FOLDER/sim.tbl
[KINS]
KINEMATICS = trivkins
JOINTS = 3
";
const OF_AXIS: &str = "\
MIN_LIMIT = -20000
MAX_LIMIT = 20000
MAX_VELOCITY = 5000
MAX_ACCELERATION = 100000
";
const OF_JOINT: &str = "\
TYPE = LINEAR
FERROR = 10
MIN_FERROR = 10
HOME = 0
HOME_OFFSET = 0
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_SEQUENCE = 0
COMP_FILE_TYPE = 1
";
const WIRES: &str = "\
loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net x joint.0.motor-pos-cmd => joint.0.motor-pos-fb
net y joint.1.motor-pos-cmd => joint.1.motor-pos-fb
net z joint.2.motor-pos-cmd => joint.2.motor-pos-fb
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
";

/// X: 400 points each way, more than LinuxCNC stores. Y: 12 points and a backlash. Z: a backlash.
fn machine_text() -> String {
    let wave = |k: u32, phase: f64| {
        let at = f64::from(k);
        let um = 14.0 * (at / 61.0 + phase).sin() + 5.0 * (at / 7.3).sin() + f64::from(k % 5) * 0.4;
        (um * 100.0).round() / 100.0
    };
    let forward: Vec<f64> = (0..400).map(|k| wave(k, 0.0)).collect();
    let reverse: Vec<f64> = (0..400).map(|k| wave(k, 0.3) + 6.0).collect();
    format!(
        "[machine]\nname = \"three joints\"\nkind = \"3-axis\"\n\
         [axis.x.pitch]\nstart_mm = -200.0\nstep_mm = 5.0\n\
         forward_um = {forward:?}\nreverse_um = {reverse:?}\n\
         [axis.y.pitch]\nstart_mm = -30.0\nstep_mm = 12.5\nforward_um = [4.0, -2.0, 0.0, 9.5, 9.5, \
         -12.25, 3.0, 1.0, 0.5, -0.5, 2.0, 7.75]\n[axis.y.backlash]\nwidth_um = 3.5\n\
         [axis.z.backlash]\nwidth_um = -6.25\n"
    )
}

/// Up over all three travels and a little beyond, and down again; not on the tables' points.
fn moves() -> Vec<[f64; 3]> {
    let at = |k: u32| {
        let share = f64::from(k) / 60.0;
        [-230.3 + 2_060.0 * share, -45.1 + 170.0 * share, -100.7 + 300.0 * share]
    };
    (0..=60).chain((0..60).rev()).map(at).collect()
}

/// Runs LinuxCNC with these compensation files; what it adds to each joint at each move, in mm.
fn run(linuxcnc: &Path, files: &[(String, String)], moves: &[[f64; 3]]) -> Result<Vec<[f64; 3]>> {
    let folder = TempDir::new()?;
    let path = |name: &str| folder.path().join(name);
    let here = folder.path().to_str().context("a temporary folder has a plain name")?;
    let mut configuration = CONFIGURATION.replace("FOLDER", here);
    for (joint, axis) in JOINTS.iter().enumerate() {
        configuration += &format!("[AXIS_{}]\n{OF_AXIS}", axis.to_uppercase());
        configuration += &format!("[JOINT_{joint}]\n{OF_JOINT}{OF_AXIS}");
        configuration += &format!("COMP_FILE = {here}/{axis}.comp\n");
    }
    let script = setup::root().join("host-tests/python/linuxcnc_comp.py");
    // Root's own folders may be closed to the user that LinuxCNC runs as.
    fs::copy(script, path("screen.py"))?;
    let display = format!("#!/bin/sh\nexec /usr/bin/python3 {here}/screen.py {here}\n");
    let moves_text = serde_json::to_string(moves)?;
    let texts = [
        ("sim.ini", configuration.as_str()),
        ("sim.hal", WIRES),
        ("sim.tbl", ""),
        ("display.sh", &display),
        ("moves.json", &moves_text),
    ];
    let files = files.iter().map(|(name, text)| (name.as_str(), text.as_str()));
    for (name, text) in texts.into_iter().chain(files) {
        fs::write(path(name), text)?;
    }
    fs::set_permissions(path("display.sh"), fs::Permissions::from_mode(0o755))?;

    let is_root = is_root()?;
    let mut command = if is_root {
        for entry in fs::read_dir(&folder)? {
            std::os::unix::fs::chown(entry?.path(), Some(NOBODY), Some(NOBODY))?;
        }
        std::os::unix::fs::chown(&folder, Some(NOBODY), Some(NOBODY))?;
        let mut command = Command::new("setpriv");
        command.args([&format!("--reuid={NOBODY}"), &format!("--regid={NOBODY}")]);
        command.arg("--clear-groups").arg(linuxcnc);
        command
    } else {
        Command::new(linuxcnc)
    };
    let log = File::create(path("log.txt"))?;
    let mut child = command
        .arg(path("sim.ini"))
        .env_clear()
        .env("PATH", "/usr/bin:/bin:/usr/sbin:/sbin")
        .env("HOME", folder.path())
        .env("LANG", "C")
        .current_dir(&folder)
        .stdin(Stdio::null())
        .stdout(log.try_clone()?)
        .stderr(log)
        // A group of its own, so that it can be ended with all that it started.
        .process_group(0)
        .spawn()
        .context("LinuxCNC cannot be started")?;
    let started = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break Some(status);
        }
        if started.elapsed() > PATIENCE {
            // It takes its realtime part down by itself if it is asked to.
            let group = format!("-{}", child.id());
            for signal in ["-TERM", "-KILL"] {
                Command::new("kill").args([signal, "--", &group]).status()?;
                thread::sleep(Duration::from_secs(3));
            }
            child.wait()?;
            break None;
        }
        thread::sleep(Duration::from_millis(20));
    };
    let said = |name: &str| fs::read_to_string(path(name)).unwrap_or_default();
    let all = ["failed.txt", "log.txt", "linuxcnc_print.txt", "linuxcnc_debug.txt"].map(said);
    ensure!(status.is_some(), "LinuxCNC was not done after {PATIENCE:?}: {}", all.join("\n"));
    let Ok(result) = fs::read_to_string(path("result.json")) else {
        bail!("LinuxCNC gave no result: {}", all.join("\n"));
    };
    println!("{} moves in {:.1} s", moves.len(), started.elapsed().as_secs_f64());
    Ok(serde_json::from_str(&result)?)
}

/// LinuxCNC refuses to run as root.
fn is_root() -> Result<bool> {
    let id = Command::new("id").arg("-u").output()?;
    Ok(String::from_utf8_lossy(&id.stdout).trim() == "0")
}

fn files(export: &Export) -> Vec<(String, String)> {
    export.files.iter().map(|file| (file.name.clone(), file.text.clone())).collect()
}

#[test]
fn the_real_linuxcnc_corrects_the_model_within_the_stated_difference() -> Result<()> {
    let Some(control) = setup::linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let machine = MachineFile::parse(&machine_text(), Path::new("three-joints.toml"))?;
    let export = export(&machine, Format::LinuxCnc, &Options::default())?;
    println!("{}", export.report);
    assert_eq!(files(&export).len(), 3);
    let lines = |name: usize| export.files[name].text.lines().count();
    assert_eq!([lines(1), lines(2)], [12, 1]);
    assert!((200..=linuxcnc::MOST_LINES).contains(&lines(0)), "thinned from 400: {}", lines(0));

    let moves = moves();
    let added = run(control.program(), &files(&export), &moves)?;
    assert_eq!(added.len(), moves.len());
    // The first move comes from 0 and goes down in every joint, the last 60 too.
    let top = moves.len() / 2;
    for (joint, axis) in machine.axes.iter().enumerate() {
        let table = &export.report.tables[joint];
        let back = linuxcnc::read(&export.files[joint].text).map_err(anyhow::Error::msg)?;
        let (mut from_model, mut from_reader, mut largest) = (0.0_f64, 0.0_f64, 0.0_f64);
        for (index, (position, added)) in moves.iter().zip(&added).enumerate() {
            let is_up = (1..=top).contains(&index);
            let approach = if is_up { Approach::Positive } else { Approach::Negative };
            let (mm, added_um) = (position[joint], added[joint] * 1000.0);
            let error_um = axis.pitch.as_ref().map_or(0.0, |p| pitch_um(p, mm, approach.sign()))
                + axis.backlash.as_ref().map_or(0.0, |b| backlash_um(b, approach.sign()));
            from_model = from_model.max((added_um + error_um).abs());
            from_reader = from_reader.max((added_um - back.trim(mm, approach) * 1000.0).abs());
            largest = largest.max(added_um.abs());
        }
        println!(
            "{}: up to {largest:.2} um added; off the model by {from_model:.6} um ({:.6} stated), \
             off our reader by {from_reader:.7} um",
            JOINTS[joint], table.largest.um
        );
        assert!(largest > 6.0, "{} was hardly corrected", JOINTS[joint]);
        assert!(from_model <= table.largest.um + SETTLED_UM, "{} {table:?}", JOINTS[joint]);
        assert!(from_reader <= SETTLED_UM, "{}: we read otherwise than LinuxCNC", JOINTS[joint]);
    }
    Ok(())
}

#[test]
fn a_header_would_switch_the_real_linuxcncs_table_off_in_silence() -> Result<()> {
    let Some(control) = setup::linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let table = "0 0.005 0.005\n100 0.005 0.005\n";
    let named = |axis: &str, text: String| (format!("{axis}.comp"), text);
    let files = [
        named("x", table.to_string()),
        named("y", format!("# nominal forward reverse\n{table}")),
        named("z", format!("0 0.005 0.005\n\n{table}")),
    ];
    let added = run(control.program(), &files, &[[10.0; 3], [50.0; 3]])?;
    let um = added.last().context("two moves")?.map(|mm| (mm * 1000.0 * 1e4).round() / 1e4);
    // After an empty line the rest is lost, but a single line holds everywhere.
    assert_eq!(um, [5.0, 0.0, 5.0]);
    for (name, text) in &files[1..] {
        assert!(linuxcnc::read(text).is_err(), "our reader refuses {name}");
    }
    Ok(())
}
