//! LinuxCNC's own interpreter reads the programs: every dwell comes where the run file says that it
//! does, from the side and at the feed that it says.

mod support;

use std::{
    fs,
    path::Path,
    process::Command,
    sync::{Mutex, PoisonError},
};

use support::{machine, with_z};
use trueup_machine::MachineFile;
use trueup_program::{
    Control, MeasurementKind, MeasurementOptions, MeasurementPlan, MeasuringInstrument,
    SpeedSegment, control, create_plans, plan::PlannedReading, plan::Step, plan_speed_run,
};

/// Where the interpreter says that the machine stands, by axis.
#[derive(Clone, Copy, Default)]
struct Stand {
    mm: [f64; 3],
    direction: [i8; 3],
    feed: f64,
    is_to_be_read: bool,
}

/// Returns what `rs274` would let the machine do; `None` where it is not here.
fn calls(program: &str) -> Option<Vec<String>> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("program.ngc");
    fs::write(&path, program).expect("it is written");
    // Two of them at a time disturb each other.
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let done = Command::new("rs274").arg("-g").arg(&path).current_dir(&folder).output();
    let done = match done {
        Ok(done) => done,
        Err(_) => return None,
    };
    let stdout = String::from_utf8_lossy(&done.stdout);
    assert!(done.status.success(), "{program}\n{stdout}{}", String::from_utf8_lossy(&done.stderr));
    let calls = stdout.lines().filter_map(|line| Some(line.split_once("..... ")?.1.to_string()));
    Some(calls.collect())
}

/// Returns the numbers of a call.
fn numbers(call: &str) -> Vec<f64> {
    let inside = call.split_once('(').and_then(|parts| parts.1.split_once(')')).unwrap_or_default();
    inside.0.split(", ").map(|number| number.parse::<f64>().expect("a number")).collect()
}

/// Returns where it stands at each dwell with a reading.
fn stands(program: &str) -> Option<Vec<Stand>> {
    let (mut now, mut found) = (Stand::default(), Vec::new());
    for call in calls(program)? {
        let numbers = || numbers(&call).into_iter();
        if call.starts_with("STRAIGHT_") {
            for (axis, to) in numbers().take(3).enumerate() {
                if to != now.mm[axis] {
                    now.direction[axis] = if to > now.mm[axis] { 1 } else { -1 };
                }
                now.mm[axis] = to;
            }
        } else if call.starts_with("SET_FEED_RATE") {
            now.feed = numbers().next().expect("a feed");
        } else if call.starts_with("COMMENT(\"read\")") {
            now.is_to_be_read = true;
        } else if call.starts_with("DWELL") && now.is_to_be_read {
            found.push(now);
            now.is_to_be_read = false;
        }
    }
    Some(found)
}

fn check(plan: &MeasurementPlan) -> bool {
    let text = control::generate_program(plan, Control::LinuxCnc).expect("it is written").1;
    let Some(stands) = stands(&text) else { return false };
    let readings = plan.readings();
    assert_eq!(stands.len(), readings.len(), "{}", plan.name);
    for (n, (stand, reading)) in stands.iter().zip(&readings).enumerate() {
        let PlannedReading { position_mm, direction, feed_mm_per_min, .. } = *reading;
        for axis in 0..3 {
            let Some(mm) = position_mm[axis] else { continue };
            assert!((stand.mm[axis] - mm).abs() < 1e-4, "{} {n}: {reading:?}", plan.name);
            assert_eq!(stand.direction[axis], direction[axis], "{} {n}: {reading:?}", plan.name);
        }
        if let Some(feed) = feed_mm_per_min {
            assert_eq!(stand.feed, feed, "{} {n}", plan.name);
        }
    }
    true
}

#[test]
fn linuxcncs_interpreter_stands_where_the_run_file_says() {
    let kinds = [
        MeasurementKind::Backlash,
        MeasurementKind::Pitch,
        MeasurementKind::Straightness,
        MeasurementKind::Warmup,
        MeasurementKind::AxisHeat,
        MeasurementKind::Diagonal,
    ];
    let stretch = |rpm, load_n| SpeedSegment { rpm, minutes: 4.0, load_n };
    let stretches = [stretch(6000.0, 0.0), stretch(6000.0, 300.0), stretch(0.0, 0.0)];
    let planned =
        plan_speed_run(&stretches, 20.0, &["temp_front_c".into()], "to separate a from b");
    assert_eq!(planned.readings().len(), 37);
    check(&planned);
    // X words are diameters, the interpreter's positions are radii.
    let text = "[machine]\nname = \"l\"\nkind = \"lathe\"\n[axis.x]\ntravel_mm = [0.0, 140.0]\n[axis.z]\n\
                travel_mm = [-500.0, 0.0]\n";
    let lathe = MachineFile::parse(text, Path::new("l.toml")).expect("the test's own file");
    let ranges = MeasurementOptions {
        range_mm: [Some([60.0, 120.0]), None, Some([-300.0, -50.0])],
        ..MeasurementOptions::default()
    };
    for kind in [MeasurementKind::Backlash, MeasurementKind::Pitch] {
        create_plans(kind, &lathe, &ranges)
            .expect("it fits")
            .0
            .iter()
            .for_each(|plan| _ = check(plan));
    }
    for kind in kinds {
        for gauge in [None, Some(MeasuringInstrument::Dial), Some(MeasuringInstrument::Laser)] {
            let options =
                MeasurementOptions { gauge, feeds_mm_per_min: vec![1000.0, 200.0], ..with_z() };
            for plan in create_plans(kind, &machine(), &options).expect("it fits").0 {
                if !check(&plan) {
                    println!("skipped: LinuxCNC's interpreter (rs274) is not here");
                    return;
                }
            }
        }
    }
}

#[test]
fn linuxcncs_interpreter_goes_around_the_centre_that_the_plan_has() {
    let plans = create_plans(MeasurementKind::Circle, &machine(), &with_z()).expect("it fits").0;
    assert_eq!(plans.len(), 3);
    for plan in &plans {
        let text = control::generate_program(plan, Control::LinuxCnc).expect("it is written").1;
        let Some(made) = calls(&text) else {
            println!("skipped: LinuxCNC's interpreter (rs274) is not here");
            return;
        };
        let arcs: Vec<Vec<f64>> = made
            .iter()
            .filter(|call| call.starts_with("ARC_FEED"))
            .map(|call| numbers(call))
            .collect();
        let planned = plan.steps.iter().filter_map(|step| match step {
            Step::Arc(arc) => Some(arc.block_angles_deg().into_iter().map(|deg| (*arc, deg))),
            _ => None,
        });
        let planned: Vec<_> = planned.flatten().collect();
        assert_eq!(arcs.len(), planned.len(), "{}: {arcs:?}", plan.name);
        for (arc, (planned, deg)) in arcs.iter().zip(planned) {
            // Both ends, both centres, and the turns with their sign.
            let off = [0, 1].map(|n| (arc[2 + n] - planned.centre_mm[n]).abs());
            assert!(off.iter().all(|mm| *mm < 1e-4), "{}: {arc:?}", plan.name);
            assert_eq!(arc[4], deg.signum(), "{}: {arc:?}", plan.name);
        }
        // In coordinates that are turned it does nothing at all.
        let turned = calls(&format!("G10 L2 P1 R30\n{text}")).expect("it is here");
        let moves = |call: &&String| call.starts_with("ARC_") || call.starts_with("STRAIGHT_");
        assert_eq!(turned.iter().filter(moves).count(), 0, "{turned:?}");
    }
}

#[test]
fn linuxcncs_interpreter_touches_where_the_plan_says_whatever_the_work_coordinates_are() {
    let options = MeasurementOptions {
        at_mm: [Some(300.0), Some(-150.0), Some(-300.0)],
        ball_mm: Some(20.0),
        stylus_mm: Some(6.0),
        size_mm: Some(200.0),
        step_mm: Some(90.0),
        ..with_z()
    };
    for kind in [MeasurementKind::Square, MeasurementKind::Sphere, MeasurementKind::Plate] {
        let plan = &create_plans(kind, &machine(), &options).expect("it fits").0[0];
        let text = control::generate_program(plan, Control::LinuxCnc).expect("it is written").1;
        for (before, shift) in [("", [0.0; 3]), ("G10 L2 P1 X7 Y-3 Z20\nG92 X5", [2.0, -3.0, 20.0])]
        {
            // G92 X5 at X -7 of the work coordinates: 12 mm more.
            let shift = if before.is_empty() { shift } else { [-5.0, shift[1], shift[2]] };
            let Some(made) = calls(&format!("{before}\n{text}")) else {
                println!("skipped: LinuxCNC's interpreter (rs274) is not here");
                return;
            };
            let probes = made.iter().filter(|call| call.starts_with("STRAIGHT_PROBE"));
            let ends: Vec<Vec<f64>> = probes.map(|call| numbers(call)).collect();
            let planned = plan.steps.iter().flat_map(|step| match step {
                Step::Guarded { axis, to_mm } => vec![(*axis, *to_mm)],
                Step::Touch(touch) => vec![(touch.axis, touch.to_mm), (touch.axis, f64::NAN)],
                _ => Vec::new(),
            });
            let planned: Vec<(usize, f64)> = planned.collect();
            assert_eq!(ends.len(), planned.len(), "{}", plan.name);
            for (end, (axis, mm)) in ends.iter().zip(planned) {
                let is_there = mm.is_nan() || (end[axis] + shift[axis] - mm).abs() < 1e-3;
                assert!(is_there, "{} {before:?}: {end:?}, and it is {axis} {mm}", plan.name);
            }
        }
    }
}
