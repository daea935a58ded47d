//! The exported compensation in the real LinuxCNC: Debian's `linuxcnc-uspace`, without a screen and
//! not as root, with three simulated joints. Its addition to a joint's command, read from its HAL
//! pins over the travel and in both directions, is the opposite of the model's error, within the
//! difference that the export states.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{
    path::Path,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::{
    linuxcnc::{
        headless_linuxcnc::HeadlessLinuxCnc,
        simulated_joints::{self, AxisIniLines},
    },
    setup::{self, LockedLinuxCnc},
};
use trueup_export::{
    ApproachDirection, ExportFormat, ExportOptions, ExportResult, export, linuxcnc,
};
use trueup_machine::{
    MachineFile,
    model::{backlash_um, pitch_error_um},
};

/// The backlash filter rests after a fraction of this: this many readings are the same.
const SETTLES: Duration = Duration::from_secs(10);
const RESTS: u32 = 5;
/// At rest LinuxCNC keeps the compensation of the last cycle in which the joint still moved, a
/// fraction of a micrometre before the end; with the tables' slopes and the rest of the backlash
/// filter that is less than this, in µm.
const SETTLED_UM: f64 = 1e-3;
const JOINTS: [&str; 3] = ["x", "y", "z"];

const OF_AXIS: &str = "\
MIN_LIMIT = -20000
MAX_LIMIT = 20000
MAX_VELOCITY = 5000
MAX_ACCELERATION = 100000
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
fn run(
    linuxcnc: LockedLinuxCnc,
    files: &[(String, String)],
    moves: &[[f64; 3]],
) -> Result<Vec<[f64; 3]>> {
    let axes = JOINTS.map(|axis| AxisIniLines {
        limits: OF_AXIS.into(),
        joint: format!("COMP_FILE_TYPE = 1\nCOMP_FILE = FOLDER/{axis}.comp\n"),
    });
    let mut cnc = simulated_joints::start(linuxcnc, &axes, "", files)?;
    let begun = Instant::now();
    let mut added = Vec::with_capacity(moves.len());
    for [x, y, z] in moves {
        cnc.send_request_with_argument("mdi", "text", format!("G53 G0 X{x:.6} Y{y:.6} Z{z:.6}"))?;
        added.push(settled(&mut cnc)?);
    }
    println!("{} moves in {:.1} s", moves.len(), begun.elapsed().as_secs_f64());
    cnc.close()?;
    Ok(added)
}

/// Returns what each motor's command is off its joint's, in mm. The backlash filter ends a few billionths
/// next to its goal, so it is watched until it rests.
fn settled(cnc: &mut HeadlessLinuxCnc) -> Result<[f64; 3]> {
    let pins: Vec<String> = ["backlash-filt", "motor-pos-cmd", "pos-cmd", "motor-offset"]
        .iter()
        .flat_map(|pin| (0..JOINTS.len()).map(move |joint| format!("joint.{joint}.{pin}")))
        .collect();
    let pins: Vec<&str> = pins.iter().map(String::as_str).collect();
    let (mut before, mut rests) = (Vec::new(), 0);
    let end = Instant::now() + SETTLES;
    loop {
        let now = cnc.read_pins(&pins)?;
        rests = if now == before { rests + 1 } else { 0 };
        if rests == RESTS {
            return Ok(std::array::from_fn(|joint| {
                now[3 + joint] - now[6 + joint] - now[9 + joint]
            }));
        }
        ensure!(Instant::now() < end, "the backlash filter does not come to rest: {now:?}");
        before = now;
        thread::sleep(Duration::from_millis(2));
    }
}

fn files(export: &ExportResult) -> Vec<(String, String)> {
    export.files.iter().map(|file| (file.name.clone(), file.text.clone())).collect()
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn the_real_linuxcnc_corrects_the_model_within_the_stated_difference() -> Result<()> {
    let Some(control) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let machine = MachineFile::parse(&machine_text(), Path::new("three-joints.toml"))?;
    let export = export(&machine, ExportFormat::LinuxCnc, &ExportOptions::default())?;
    println!("{}", export.report);
    assert_eq!(files(&export).len(), 3);
    let lines = |name: usize| export.files[name].text.lines().count();
    assert_eq!([lines(1), lines(2)], [12, 1]);
    assert!(
        (200..=linuxcnc::MAX_COMPENSATION_ENTRIES).contains(&lines(0)),
        "thinned from 400: {}",
        lines(0)
    );

    let moves = moves();
    let added = run(control, &files(&export), &moves)?;
    assert_eq!(added.len(), moves.len());
    // The first move comes from 0 and goes down in every joint, the last 60 too.
    let top = moves.len() / 2;
    for (joint, axis) in machine.axes.iter().enumerate() {
        let table = &export.report.tables[joint];
        let back = linuxcnc::parse(&export.files[joint].text).map_err(anyhow::Error::msg)?;
        let (mut from_model, mut from_reader, mut largest) = (0.0_f64, 0.0_f64, 0.0_f64);
        for (index, (position, added)) in moves.iter().zip(&added).enumerate() {
            let is_up = (1..=top).contains(&index);
            let approach =
                if is_up { ApproachDirection::Positive } else { ApproachDirection::Negative };
            let (mm, added_um) = (position[joint], added[joint] * 1000.0);
            let error_um =
                axis.pitch.as_ref().map_or(0.0, |p| pitch_error_um(p, mm, approach.sign()))
                    + axis.backlash.as_ref().map_or(0.0, |b| backlash_um(b, approach.sign()));
            from_model = from_model.max((added_um + error_um).abs());
            from_reader = from_reader.max((added_um - back.trim_at(mm, approach) * 1000.0).abs());
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
#[ignore = "long: the real LinuxCNC"]
fn a_header_would_switch_the_real_linuxcncs_table_off_in_silence() -> Result<()> {
    let Some(control) = setup::install_and_lock_linuxcnc()? else {
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
    let added = run(control, &files, &[[10.0; 3], [50.0; 3]])?;
    let um = added.last().context("two moves")?.map(|mm| (mm * 1000.0 * 1e4).round() / 1e4);
    // After an empty line the rest is lost, but a single line holds everywhere.
    assert_eq!(um, [5.0, 0.0, 5.0]);
    for (name, text) in &files[1..] {
        assert!(linuxcnc::parse(text).is_err(), "our reader refuses {name}");
    }
    Ok(())
}
