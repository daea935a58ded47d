//! The stops of the programs on the real LinuxCNC: nothing moves before the first, and after it only the axes that the
//! program names, where it says.

use std::{
    fs, thread,
    time::{Duration, Instant},
};

use anyhow::{Result, ensure};
use trueup_emulator::{linuxcnc::headless::Headless, setup};
use trueup_program::{Control, Kind, Options, Plan, control};

use crate::{PATIENCE_S, Rig, Y, cycles::Cycles, made, options, start};

/// Pins with LinuxCNC's commands of X, Y, Z and the spindle.
const COMMANDED: [&str; 4] = [
    "joint.0.motor-pos-cmd",
    "joint.1.motor-pos-cmd",
    "joint.2.motor-pos-cmd",
    "spindle.0.speed-out",
];

/// Begins a program, sees that nothing has moved when it stops, and goes on.
pub fn begin_and_pass_the_stop(
    cnc: &mut Headless,
    cycles: &mut Cycles,
    program: &str,
) -> Result<()> {
    let before = cnc.pins(&COMMANDED)?;
    cycles.wait_for_stand(&before)?;
    cnc.begin(program)?;
    let begun = Instant::now();
    while !cnc.is_stopped()? {
        ensure!(begun.elapsed().as_secs() < PATIENCE_S, "{program} does not stop: {}", cnc.said());
        thread::sleep(Duration::from_millis(5));
    }
    thread::sleep(Duration::from_millis(200));
    let stood = cnc.pins(&COMMANDED)?;
    ensure!(stood == before && cnc.is_stopped()?, "{program} moved from {before:?} to {stood:?}");
    let moved = cycles.first_elsewhere(&before)?;
    ensure!(moved.is_none(), "{program} moved from {before:?} to {moved:?} before its stop");
    cnc.resume()
}

/// Where the programs of all kinds may move, in mm; Z is 2500 mm high.
const RANGES_MM: [[f64; 2]; 3] = [[1000.0, 1400.0], [500.0, 800.0], [2200.0, 2400.0]];

/// How many servo cycles are read before LinuxCNC is asked how it stands.
const EACH: u32 = 100;
/// How often [`EACH`] cycles are read after the end.
const LATE: u32 = 5;
/// A program of a few moves ends within so long on a busy computer.
const PROGRAM: Duration = Duration::from_secs(60);

/// Runs a program with all its stops; returns from where to where each axis was sent after the first of them.
fn run_with_stops(rig: &mut Rig, plan: &Plan) -> Result<[[f64; 2]; 3]> {
    let Rig { cnc, cycles, .. } = rig;
    let (name, text) = control::program(plan, Control::LinuxCnc);
    fs::write(cnc.folder().join(&name), text)?;
    begin_and_pass_the_stop(cnc, cycles, &name)?;
    let begun = Instant::now();
    let mut seen = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
    // The recorder is a little late: this many more cycles hold the end of the program.
    let mut more = LATE;
    while more > 0 {
        for _ in 0..EACH {
            for ([low, high], mm) in seen.iter_mut().zip(cycles.next()?) {
                (*low, *high) = (low.min(mm), high.max(mm));
            }
        }
        if cnc.is_stopped()? {
            cnc.resume()?;
        }
        more = if cnc.is_busy()? { LATE } else { more - 1 };
        ensure!(begun.elapsed() < PROGRAM, "{name} does not end: {}", cnc.said());
    }
    Ok(seen)
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn programs_move_nothing_before_their_stop_and_no_axis_that_they_do_not_name() -> Result<()> {
    let Some(control) = setup::linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let mut rig = start(control)?;
    let mut made_of = 0;
    for kind in [
        Kind::Backlash,
        Kind::Pitch,
        Kind::Straightness,
        Kind::Warmup,
        Kind::AxisHeat,
        Kind::Diagonal,
    ] {
        let wanted = Options {
            range_mm: RANGES_MM.map(Some),
            gauge: None,
            clearance_mm: Some((Y, 50.0)),
            dwell_s: 0.1,
            repeats: Some(1),
            step_mm: Some(100.0),
            every_s: Some(0.5),
            heat_s: Some(if kind == Kind::AxisHeat { 1.0 } else { 2.0 }),
            heat_feed_mm_per_min: 60_000.0,
            spindle_rpm: Some(1000.0),
            ..options(&[])
        };
        for plan in made(kind, &wanted)? {
            let places =
                ["joint.0.motor-pos-cmd", "joint.1.motor-pos-cmd", "joint.2.motor-pos-cmd"];
            let before = rig.cnc.pins(&places)?;
            let seen = run_with_stops(&mut rig, &plan)?;
            for (n, [low, high]) in seen.into_iter().enumerate() {
                let named = plan.extent_mm()[n];
                // The way to its first place may begin anywhere.
                let [from, to] = named
                    .map_or([before[n]; 2], |[from, to]| [from.min(before[n]), to.max(before[n])]);
                ensure!(
                    from - 1e-4 <= low && high <= to + 1e-4,
                    "{}: axis {n} was sent from {low} to {high} mm, said were {from} to {to}",
                    plan.name
                );
            }
            made_of += 1;
        }
    }
    assert_eq!(made_of, 3 + 3 + 3 + 1 + 3 + 3);
    rig.end()
}
