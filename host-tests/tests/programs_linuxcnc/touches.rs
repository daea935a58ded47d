//! A touch probe in the real LinuxCNC: the probe closes where the tip is as near to a ball as both are wide, and the run file that
//! LinuxCNC writes has where the ball is, whatever the work coordinates of the job are.

use std::{
    fs, thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::linuxcnc::headless_linuxcnc::HeadlessLinuxCnc;
use trueup_program::{Control, MeasurementKind, MeasurementOptions, control};

use crate::{Rig, TIMEOUT_S, made, options};

/// Where the ball is thought to be, and how far it is off, in mm.
const AT_MM: [f64; 3] = [1200.0, 600.0, 2200.0];
const OFF_MM: [f64; 3] = [0.11, -0.07, 0.05];
/// Ball and stylus, in mm.
const WIDE_MM: [f64; 2] = [20.0, 6.0];
const FEED_MM_PER_MIN: f64 = 120.0;
/// LinuxCNC sees the contact two servo periods late: 4 µm at this feed, of which the mean of two opposite ones sees none.
const LATE_UM: f64 = 4.1;

/// The distance of the tip to the ball closes the probe, once it knows how wide both are.
pub fn wires() -> String {
    let mut hal = String::from(
        "loadrt sum2 names=dx,dy,dz\nloadrt hypot names=ball\nloadrt comp names=touch\n",
    );
    for (name, (at, off)) in ["x", "y", "z"].into_iter().zip(AT_MM.into_iter().zip(OFF_MM)) {
        hal += &format!("addf d{name} servo-thread\nnet {name} => d{name}.in0\n");
        hal += &format!("setp d{name}.offset {}\n", -(at + off));
    }
    hal += "addf ball servo-thread\naddf touch servo-thread\n";
    for (n, name) in ["x", "y", "z"].into_iter().enumerate() {
        hal += &format!("net off-{name} d{name}.out => ball.in{n}\n");
    }
    hal += "net apart ball.out => touch.in0\nnet touched touch.out => motion.probe-input\n";
    hal + "setp touch.in1 -1\n"
}

/// Runs the program of a sphere on a rig that has [`wires`].
pub fn check_sphere(rig: &mut Rig) -> Result<()> {
    let cnc = &mut rig.cnc;
    let options = MeasurementOptions {
        at_mm: AT_MM.map(Some),
        ball_mm: Some(WIDE_MM[0]),
        stylus_mm: Some(WIDE_MM[1]),
        search_mm: Some(0.5),
        repeats: Some(1),
        feeds_mm_per_min: vec![FEED_MM_PER_MIN],
        range_mm: [None, None, Some([2100.0, 2300.0])],
        ..options(&[])
    };
    let plan = made(MeasurementKind::Sphere, &options)?.remove(0);
    let (name, text) = control::generate_program(&plan, Control::LinuxCnc)?;
    let log = cnc.folder().join("sphere-xyz.csv");
    let logged = text.replace("(LOGOPEN,", &format!("(LOGOPEN,{}/", cnc.folder().display()));
    fs::write(cnc.folder().join(&name), logged)?;
    cnc.run_halcmd(&format!("setp touch.in1 {}", (WIDE_MM[0] + WIDE_MM[1]) / 2.0))?;
    for job in ["G53 G0 Z2290", "G21 G90 G10 L2 P1 X7 Y-3 Z20", "G92 X5 Z-8"] {
        cnc.send_request_with_argument("mdi", "text", job)?;
    }
    run(cnc, &name)?;
    let text = fs::read_to_string(&log).with_context(|| cnc.recent_log())?;
    let row =
        text.lines().nth(1).with_context(|| format!("no row: {text}\n{}", cnc.recent_log()))?;
    let found = row.split(',').skip(5).map(str::parse).collect::<Result<Vec<f64>, _>>();
    println!("{row}");
    for (found, off) in found.with_context(|| row.to_string())?.iter().zip(OFF_MM) {
        ensure!((found + 1000.0 * off).abs() < LATE_UM, "{row}, and it is off by {OFF_MM:?} mm");
    }
    // Something in the way ends it, and no row is written.
    cnc.run_halcmd("setp dz.offset -2222")?;
    run(cnc, &name)?;
    let text = fs::read_to_string(&log)?;
    ensure!(text.lines().count() < 2, "it goes on: {text}");
    Ok(())
}

/// Runs a program with its stop.
fn run(cnc: &mut HeadlessLinuxCnc, name: &str) -> Result<()> {
    cnc.start_program(name)?;
    let begun = Instant::now();
    while !cnc.is_program_paused()? {
        ensure!(begun.elapsed().as_secs() < TIMEOUT_S, "it does not stop: {}", cnc.recent_log());
        thread::sleep(Duration::from_millis(5));
    }
    cnc.resume_program()?;
    while cnc.is_program_running()? {
        ensure!(begun.elapsed().as_secs() < 3 * TIMEOUT_S, "it does not end: {}", cnc.recent_log());
        thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}
