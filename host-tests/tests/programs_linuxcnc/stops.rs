//! The stops of the programs on the real LinuxCNC: nothing moves before the first, and after it only the axes that the
//! program names, where it says.

use std::{
    fs, thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::{linuxcnc::headless::Headless, setup};
use trueup_program::{Control, Kind, Options, Plan, control};

use crate::{PATIENCE_S, Rig, Y, made, options, start};

/// What LinuxCNC commands of X, Y, Z and the spindle.
const COMMANDED: [&str; 4] = [
    "joint.0.motor-pos-cmd",
    "joint.1.motor-pos-cmd",
    "joint.2.motor-pos-cmd",
    "spindle.0.speed-out",
];

/// Begins a program, sees that nothing has moved when it stops, and goes on.
pub fn begin_and_pass_the_stop(cnc: &mut Headless, program: &str) -> Result<()> {
    let before = cnc.pins(&COMMANDED)?;
    cnc.begin(program)?;
    let begun = Instant::now();
    while !cnc.is_stopped()? {
        ensure!(begun.elapsed().as_secs() < PATIENCE_S, "{program} does not stop: {}", cnc.said());
        thread::sleep(Duration::from_millis(5));
    }
    thread::sleep(Duration::from_millis(200));
    let stood = cnc.pins(&COMMANDED)?;
    ensure!(stood == before && cnc.is_stopped()?, "{program} moved from {before:?} to {stood:?}");
    cnc.resume()
}

/// Where the programs of all kinds may move, in mm; Z is 2500 mm high.
const RANGES_MM: [[f64; 2]; 3] = [[1000.0, 1400.0], [500.0, 800.0], [2200.0, 2400.0]];

/// Runs a program with all its stops; returns from where to where each axis was sent after the first of them.
fn run_with_stops(rig: &mut Rig, plan: &Plan) -> Result<Vec<[f64; 2]>> {
    let Rig { cnc, cycles, .. } = rig;
    let (name, text) = control::program(plan, Control::LinuxCnc);
    fs::write(cnc.folder().join(&name), text)?;
    begin_and_pass_the_stop(cnc, &name)?;
    let mut seen: Option<Vec<[f64; 2]>> = None;
    let mut is_busy = true;
    for (n, line) in cycles.enumerate() {
        let line = line?;
        ensure!(!line.contains("overrun"), "the recorder was overrun");
        let at = line.split_whitespace().skip(1).take(3).map(str::parse::<f64>);
        let at: Vec<f64> = at.collect::<Result<_, _>>()?;
        let seen = seen.get_or_insert_with(|| at.iter().map(|mm| [*mm; 2]).collect());
        for ([low, high], mm) in seen.iter_mut().zip(at) {
            (*low, *high) = (low.min(mm), high.max(mm));
        }
        if n % 100 == 99 {
            if cnc.is_stopped()? {
                cnc.resume()?;
            } else if !is_busy {
                break;
            }
            is_busy = cnc.is_busy()?;
        }
    }
    seen.context("LinuxCNC commands nothing")
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
