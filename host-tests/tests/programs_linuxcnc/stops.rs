//! The stops of the programs on the real LinuxCNC: nothing moves before the first, and after it only the axes that the
//! program names, where it says; circles are round and have no stop, and a sphere is found where it is.

use std::{
    fs, thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::{linuxcnc::headless_linuxcnc::HeadlessLinuxCnc, setup};
use trueup_program::{
    Control, MeasurementKind, MeasurementOptions, MeasurementPlan, arc::ArcMove, control,
    plan::Step,
};

use crate::{RECORDER, Rig, TIMEOUT_S, X, Y, cycles::Cycles, made, options, start_with, touches};

/// Pins with LinuxCNC's commands of X, Y, Z and the spindle.
const COMMANDED: [&str; 4] = [
    "joint.0.motor-pos-cmd",
    "joint.1.motor-pos-cmd",
    "joint.2.motor-pos-cmd",
    "spindle.0.speed-out",
];

/// Begins a program, sees that nothing has moved when it stops, and goes on.
pub fn begin_and_pass_the_stop(
    cnc: &mut HeadlessLinuxCnc,
    cycles: &mut Cycles,
    program: &str,
) -> Result<()> {
    let before = cnc.read_pins(&COMMANDED)?;
    cycles.wait_for_stand(&before)?;
    cnc.start_program(program)?;
    let begun = Instant::now();
    while !cnc.is_program_paused()? {
        ensure!(
            begun.elapsed().as_secs() < TIMEOUT_S,
            "{program} does not stop: {}",
            cnc.recent_log()
        );
        thread::sleep(Duration::from_millis(5));
    }
    thread::sleep(Duration::from_millis(200));
    let stood = cnc.read_pins(&COMMANDED)?;
    ensure!(
        stood == before && cnc.is_program_paused()?,
        "{program} moved from {before:?} to {stood:?}"
    );
    let moved = cycles.first_elsewhere(&before)?;
    ensure!(moved.is_none(), "{program} moved from {before:?} to {moved:?} before its stop");
    cnc.resume_program()
}

/// Where the programs of all kinds may move, in mm; Z is 2500 mm high.
const RANGES_MM: [[f64; 2]; 3] = [[1000.0, 1400.0], [500.0, 800.0], [2200.0, 2400.0]];

/// How many servo cycles are read before LinuxCNC is asked how it stands.
const EACH: u32 = 100;
/// How often [`EACH`] cycles are read after the end.
const LATE: u32 = 5;
/// A program of a few moves ends within so long on a busy computer.
const PROGRAM: Duration = Duration::from_secs(60);

/// Runs a program with all its stops; returns where the axes were sent in each servo cycle after the first of them.
fn run_with_stops(rig: &mut Rig, plan: &MeasurementPlan) -> Result<Vec<[f64; 3]>> {
    let Rig { cnc, cycles, .. } = rig;
    let (name, text) = control::generate_program(plan, Control::LinuxCnc)?;
    fs::write(cnc.folder().join(&name), text)?;
    begin_and_pass_the_stop(cnc, cycles, &name)?;
    let begun = Instant::now();
    let mut seen = Vec::new();
    // The recorder is a little late: this many more cycles hold the end of the program.
    let mut more = LATE;
    while more > 0 {
        for _ in 0..EACH {
            let [x, y, z, _] = cycles.next()?;
            seen.push([x, y, z]);
        }
        if cnc.is_program_paused()? {
            cnc.resume_program()?;
        }
        more = if cnc.is_program_running()? { LATE } else { more - 1 };
        ensure!(begun.elapsed() < PROGRAM, "{name} does not end: {}", cnc.recent_log());
    }
    Ok(seen)
}

/// A place that is this near to the circle is on it, in mm: its ends are whole micrometres.
const ON_CIRCLE_MM: f64 = 1e-3;

/// LinuxCNC goes around the centre of each arc as far as the plan says, on the circle, and does not stop on the way.
fn check_arcs(plan: &MeasurementPlan, seen: &[[f64; 3]]) -> Result<()> {
    let mut at = 0;
    for step in &plan.steps {
        let Step::Arc(arc) = step else { continue };
        let off = |mm: &[f64; 3]| [0, 1].map(|n| mm[arc.axes[n]] - arc.centre_mm[n]);
        let start = plan_start(plan, arc);
        let radius = off(&start)[0].hypot(off(&start)[1]);
        // Its interpolator takes the mean of three points, 1 : 4 : 1, one servo period apart.
        let step_mm = arc.feed_mm_per_min / 60_000.0;
        let near_mm = ON_CIRCLE_MM + step_mm * step_mm / (6.0 * radius);
        let is_on = |mm: &[f64; 3]| (off(mm)[0].hypot(off(mm)[1]) - radius).abs() < near_mm;
        let angle = |mm: &[f64; 3]| off(mm)[1].atan2(off(mm)[0]).to_degrees();
        let turn = |pair: &[[f64; 3]]| {
            (angle(&pair[1]) - angle(&pair[0]) + 540.0).rem_euclid(360.0) - 180.0
        };
        // It stands at the start before it goes around.
        let begins = |pair: &[[f64; 3]]| {
            is_on(&pair[0]) && is_on(&pair[1]) && turn(pair) * arc.rotation_sign() > 0.0
        };
        let begin = seen[at..].windows(2).position(begins);
        at += begin.with_context(|| format!("{}: no arc of {}°", plan.name, arc.turn_deg))?;
        let mut turned = 0.0;
        while (arc.turn_deg.abs() - turned) > 0.01 {
            let pair =
                seen.get(at..at + 2).with_context(|| format!("{}: only {turned}°", plan.name))?;
            ensure!(
                is_on(&pair[1]),
                "{}: {:?} is not on the circle after {turned}°",
                plan.name,
                pair[1]
            );
            let step = turn(pair) * arc.rotation_sign();
            ensure!(step > 0.0, "{}: it stops or turns back after {turned}°", plan.name);
            turned += step;
            at += 1;
        }
        ensure!(turned < arc.turn_deg.abs() + 0.01, "{}: {turned}°", plan.name);
    }
    Ok(())
}

/// Returns where an arc begins: at the last places that its axes are sent to before.
fn plan_start(plan: &MeasurementPlan, arc: &ArcMove) -> [f64; 3] {
    let mut mm = [0.0; 3];
    for step in plan.steps.iter().take_while(|step| !matches!(step, Step::Arc(it) if it == arc)) {
        match step {
            Step::Approach { axis, to_mm } => mm[*axis] = *to_mm,
            Step::Arc(before) => {
                let end = before.end_mm(before.axes.map(|axis| mm[axis]));
                before.axes.into_iter().zip(end).for_each(|(axis, to)| mm[axis] = to);
            }
            _ => {}
        }
    }
    mm
}

#[test]
#[ignore = "long: the real LinuxCNC"]
fn programs_move_nothing_before_their_stop_and_no_axis_that_they_do_not_name() -> Result<()> {
    let Some(control) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let mut rig = start_with(control, &[RECORDER, &touches::wires()].concat())?;
    let mut made_of = 0;
    for kind in [
        MeasurementKind::Backlash,
        MeasurementKind::Pitch,
        MeasurementKind::Straightness,
        MeasurementKind::Warmup,
        MeasurementKind::AxisHeat,
        MeasurementKind::Diagonal,
        MeasurementKind::Circle,
    ] {
        let requested = MeasurementOptions {
            range_mm: RANGES_MM.map(Some),
            gauge: None,
            clearance_mm: Some((Y, 50.0)),
            dwell_s: 0.1,
            repeats: Some(1),
            step_mm: Some(100.0),
            every_s: Some(0.5),
            heat_s: Some(if kind == MeasurementKind::AxisHeat { 1.0 } else { 2.0 }),
            heat_feed_mm_per_min: 60_000.0,
            spindle_rpm: Some(1000.0),
            radius_mm: Some(50.0),
            // Of the circles the one of whole turns.
            ..options(if kind == MeasurementKind::Circle { &[X, Y] } else { &[] })
        };
        for plan in made(kind, &requested)? {
            let places =
                ["joint.0.motor-pos-cmd", "joint.1.motor-pos-cmd", "joint.2.motor-pos-cmd"];
            let before = rig.cnc.read_pins(&places)?;
            let seen = run_with_stops(&mut rig, &plan)?;
            check_arcs(&plan, &seen)?;
            for n in 0..3 {
                let of_axis = || seen.iter().map(|mm| mm[n]);
                let low = of_axis().fold(f64::INFINITY, f64::min);
                let high = of_axis().fold(f64::NEG_INFINITY, f64::max);
                let named = plan.extent_mm()[n];
                // The way to its first place may begin anywhere.
                let [from, to] = named
                    .map_or([before[n]; 2], |[from, to]| [from.min(before[n]), to.max(before[n])]);
                ensure!(
                    from - 1e-4 <= low && high <= to + 1e-4,
                    "{}: axis {n} was sent from {low} to {high} mm, stated were {from} to {to}",
                    plan.name
                );
            }
            made_of += 1;
        }
    }
    assert_eq!(made_of, 3 + 3 + 3 + 1 + 3 + 3 + 1);
    touches::check_sphere(&mut rig)?;
    rig.end()
}
