//! No program harms: readers of our own, one a control, walk every program of every kind over random machines,
//! ranges and options, from an unknown place and in unknown modes, and hold each block against the rules.
//!
//! ```text
//! draw ─► plans ─► text of a control ─► reader ─► events ─► Walk: stop first, no rapid, only named axes, in range …
//! ```
//!
//! The readers share no code with the writers, and take no block that they do not know.

mod draw;
mod event;
mod fanuc;
mod heidenhain;
mod linuxcnc;
mod siemens;
mod walk;

use draw::{Draw, Draws};
use event::Event;
use trueup_machine::machine_file::LinearAxis;
use trueup_program::{
    Control, MeasurementKind, MeasurementPlan, SpeedSegment, TargetRun, control::generate_program,
    create_plans, plan::Step, plan_speed_run, plan_target_run,
};
use walk::{Limits, walk};

const KINDS: [MeasurementKind; 8] = [
    MeasurementKind::Backlash,
    MeasurementKind::Pitch,
    MeasurementKind::Straightness,
    MeasurementKind::Warmup,
    MeasurementKind::AxisHeat,
    MeasurementKind::Diagonal,
    MeasurementKind::StepDiagonal,
    MeasurementKind::Circle,
];
/// How many machines, each with a range and options of its own.
const DRAWS: u64 = 240;

/// Reads a program as its control would.
fn read(control: Control, text: &str) -> Result<Vec<Event>, String> {
    match control {
        Control::LinuxCnc => linuxcnc::read(text),
        Control::Fanuc => fanuc::read(text),
        Control::Siemens => siemens::read(text),
        Control::Heidenhain => heidenhain::read(text),
    }
}

/// Walks the programs of a plan for all controls.
fn check(plan: &MeasurementPlan, axes: &[LinearAxis], draw: &Draw) {
    for control in [Control::LinuxCnc, Control::Fanuc, Control::Siemens, Control::Heidenhain] {
        let has = |is: fn(&Step) -> bool| plan.steps.iter().any(is);
        let has_no_words = match control {
            Control::LinuxCnc => false,
            Control::Heidenhain => has(|step| matches!(step, Step::Arc(_) | Step::Touch(_))),
            _ => has(|step| matches!(step, Step::Touch(_))),
        };
        if has_no_words {
            let why = generate_program(plan, control).expect_err("it has no words for it").0;
            assert!(why.contains("fill in its run file"), "{why}");
            continue;
        }
        let (name, text) = generate_program(plan, control).expect("it is written");
        let limits = Limits::of(draw, axes);
        let walked = read(control, &text).and_then(|events| walk(&events, &limits, plan));
        if let Err(danger) = walked {
            let head: Vec<&str> = text.lines().take(60).collect();
            panic!("{name}, draw {}: {danger}\n{draw:?}\n{}", draw.number, head.join("\n"));
        }
    }
}

/// Returns the axes that a plan's name names.
fn named(plan: &MeasurementPlan) -> Vec<LinearAxis> {
    let last = plan.name.rsplit('-').next().unwrap_or_default();
    let is_axes = ["x", "y", "z", "xy", "xz", "zx", "yz", "xyz"].contains(&last);
    let all = LinearAxis::ALL.into_iter();
    all.filter(|axis| is_axes && last.contains(axis.name())).collect()
}

#[test]
fn no_program_of_any_control_and_kind_is_a_danger() {
    let mut written = 0;
    for draw in Draws::new(DRAWS) {
        for kind in KINDS {
            // A circle is looked at degree by degree.
            if kind == MeasurementKind::Circle && draw.number % 3 != 0 {
                continue;
            }
            let mut options = draw.options.clone();
            options.spindle_rpm = Some(12_000.0);
            if kind == MeasurementKind::AxisHeat {
                options.heat_s = options.heat_s.map(|s| 0.1 * s);
            }
            match create_plans(kind, &draw.machine, &options) {
                Ok((plans, notes)) => {
                    for plan in &plans {
                        let mut axes = named(plan);
                        assert_eq!(
                            axes.is_empty(),
                            kind == MeasurementKind::Warmup,
                            "{}",
                            plan.name
                        );
                        if kind == MeasurementKind::Backlash {
                            axes.extend(options.clearance_mm.map(|(axis, _)| axis));
                        }
                        check(plan, &axes, &draw);
                        written += 1;
                    }
                    draw.is_named_what_is_not_written(kind, &plans, &notes.join("; "));
                }
                Err(why) => {
                    draw.is_right_to_refuse(kind, &why.to_string());
                }
            }
        }
    }
    assert!(written > 4 * DRAWS, "{written}");
}

#[test]
fn no_program_of_a_probe_is_a_danger() {
    let mut written = 0;
    for draw in Draws::new(3 * DRAWS) {
        let ends = LinearAxis::ALL.map(|axis| draw.allowed_mm(axis));
        let middle = ends.map(|[low, high]| (low + high) / 2.0);
        let has_places = middle.iter().all(|mm| mm.is_finite());
        let options = trueup_program::MeasurementOptions {
            at_mm: if has_places { middle.map(Some) } else { [Some(0.0); 3] },
            feeds_mm_per_min: Vec::new(),
            ball_mm: Some(12.0),
            stylus_mm: Some(4.0),
            search_mm: Some(2.0),
            step_mm: Some(30.0),
            balls: Some([2, 3]),
            size_mm: Some(80.0),
            tool_lengths_mm: if draw.number % 2 == 0 { vec![50.0, 70.0] } else { Vec::new() },
            ..draw.options.clone()
        };
        for kind in [MeasurementKind::Square, MeasurementKind::Sphere, MeasurementKind::Plate] {
            match create_plans(kind, &draw.machine, &options) {
                Ok((plans, _)) => {
                    check(&plans[0], &LinearAxis::ALL, &draw);
                    written += 1;
                }
                Err(why) => {
                    let reasons =
                        ["would go to", "may move or is asked for", "along none", "--range"];
                    assert!(
                        reasons.iter().any(|reason| why.0.contains(reason)),
                        "{kind:?} {draw:?}: {why}"
                    );
                }
            }
        }
    }
    assert!(written > DRAWS / 4, "{written}");
}

#[test]
fn no_next_run_is_a_danger() {
    let mut written = 0;
    for draw in Draws::new(DRAWS) {
        let axis = draw.axis();
        let [low, high] = draw.seen_mm(axis);
        let run = TargetRun {
            axis,
            targets_mm: vec![low + 0.1 * (high - low), high - 0.1 * (high - low)],
            over_mm: 0.05 * (high - low),
            times: 2,
            feeds_mm_per_min: vec![1000.0, 300.0],
            dwell_s: 2.0,
            heat_min: 0.5,
            heat_feed_mm_per_min: 10_000.0,
            cold: true,
            warm: true,
        };
        let is_guarded = draw.is_guarded(axis);
        match plan_target_run(&run, &draw.machine, &draw.options, &[], "To separate a from b.") {
            Ok(plan) => {
                assert!(!is_guarded || draw.options.range_mm[axis.index()].is_some());
                check(&plan, &[axis], &draw);
                written += 1;
            }
            Err(why) => assert!(why.0.contains(axis.name()), "{why}"),
        }
        let stretches = [6000.0, 0.0].map(|rpm| SpeedSegment { rpm, minutes: 2.0, load_n: 0.0 });
        check(&plan_speed_run(&stretches, 20.0, &[], "To separate a from b."), &[], &draw);
    }
    assert!(written > DRAWS / 4, "{written}");
}

/// The programs of the controls are no danger, and each of these changes to one is seen.
fn assert_each_is_seen(plan: &MeasurementPlan, limits: &Limits, dangers: &[(Control, &str, &str)]) {
    let walked =
        |control, text: &str| read(control, text).and_then(|events| walk(&events, limits, plan));
    for (control, from, to) in dangers {
        let right = generate_program(plan, *control).expect("it is written").1;
        walked(*control, &right).expect("it is no danger");
        assert!(right.contains(from), "{from}: {right}");
        let wrong = right.replacen(from, to, 1);
        let walked = walked(*control, &wrong);
        assert!(walked.is_err(), "{control:?}: {from} became {to:?} and nothing was seen");
    }
}

/// A danger of each sort is seen: the walk is not blind.
#[test]
fn the_walk_sees_each_danger() {
    let draw = Draw::plain();
    let options = trueup_program::MeasurementOptions { repeats: Some(1), ..draw.options.clone() };
    let plan =
        &create_plans(MeasurementKind::Pitch, &draw.machine, &options).expect("it fits").0[0];
    let limits = Limits::of(&draw, &[LinearAxis::X]);
    let dangers = [
        (Control::LinuxCnc, "M0\n", ""),
        (Control::LinuxCnc, "G53 G1 X2 F500", "G53 G0 X2"),
        (Control::LinuxCnc, "G53 G1 X2 F500", "G1 X2 F500"),
        (Control::LinuxCnc, "G53 G1 X2 F500", "G53 G1 X0 F500"),
        (Control::LinuxCnc, "G53 G1 X2 F500", "G53 G1 X2 Z0 F500"),
        (Control::LinuxCnc, "G53 G1 X2 F500", "G53 G1 X2 F5000"),
        (Control::LinuxCnc, "G17 G21 G40", "G17 G40"),
        (Control::Fanuc, "G91 G01 X[2.-#5021] F500", "G90 G53 G00 X2."),
        (Control::Fanuc, "G91 G01 X[2.-#5021] F500", "G91 G01 X2. F500"),
        (Control::Fanuc, " G90\n", " G80\n"),
        (Control::Siemens, "SUPA G1 X2 F500", "G1 X2 F500"),
        (Control::Siemens, "SUPA G1 X2 F500", "SUPA G0 X2"),
        (Control::Heidenhain, "R0 F500 M91", "R0 FMAX M91"),
        (Control::Heidenhain, "R0 F500 M91", "R0 F500"),
    ];
    assert_each_is_seen(plan, &limits, &dangers);
}

/// A danger of a circle is seen as well.
#[test]
fn the_walk_sees_each_danger_of_a_circle() {
    let mut draw = Draw::plain();
    draw.options.range_mm = [None, Some([0.0, 800.0]), None];
    let plan =
        &create_plans(MeasurementKind::Circle, &draw.machine, &draw.options).expect("it fits").0[0];
    let limits = Limits::of(&draw, &[LinearAxis::X, LinearAxis::Y]);
    let dangers = [
        (Control::LinuxCnc, "G3 X0 Y0 I-300 J0", "G3 X0 Y0 I300 J0"),
        (Control::LinuxCnc, "G3 X0 Y0 I-300 J0", "G3 X0 Y0 I-150 J0"),
        (Control::LinuxCnc, "G3 X0 Y0", "G3 X10 Y0"),
        (Control::LinuxCnc, "G17 G91 G91.1 G64", "G18 G91 G91.1 G64"),
        (Control::LinuxCnc, "G17 G91 G91.1 G64", "G17 G91.1 G64"),
        (Control::LinuxCnc, "G17 G91 G91.1 G64", "G17 G91 G64"),
        (Control::LinuxCnc, "20 * #5220", "20 * 1"),
        (Control::Siemens, "X=IC(0)", "X=AC(0)"),
        (Control::Siemens, "[Y,RT]", "[Z,RT]"),
        (Control::Siemens, "G17 G64", "G19 G64"),
        (Control::Fanuc, "G91 G03 X0. Y0. I-300.", "G91 G03 X0. Y0. I300."),
        (Control::Fanuc, "G91 G03 X0.", "G90 G03 X0."),
        (Control::Fanuc, "I-300. J0.", "I-300 J0."),
    ];
    assert_each_is_seen(plan, &limits, &dangers);
}

/// A danger of a probe is seen as well.
#[test]
fn the_walk_sees_each_danger_of_a_probe() {
    let mut draw = Draw::plain();
    draw.options.range_mm = [None, Some([0.0, 800.0]), Some([-300.0, 0.0])];
    let options = trueup_program::MeasurementOptions {
        at_mm: [Some(400.0), Some(300.0), Some(-200.0)],
        ball_mm: Some(20.0),
        stylus_mm: Some(5.0),
        repeats: Some(1),
        ..draw.options.clone()
    };
    let plan =
        &create_plans(MeasurementKind::Sphere, &draw.machine, &options).expect("it fits").0[0];
    let limits = Limits::of(&draw, &LinearAxis::ALL);
    let dangers = [
        ("G38.3 X[400-#<shift_x>] F500", "G53 G1 X400 F500"),
        ("G38.3 X[400-#<shift_x>] F500", "G38.3 X[400] F500"),
        ("G38.3 X[400-#<shift_x>] F500", "G38.3 X[400-#<shift_y>] F500"),
        ("G38.3 X[400-#<shift_x>] F500", "G38.3 X[900-#<shift_x>] F500"),
        ("G38.3 X[400-#<shift_x>] F500", "G38.3 X[400-#<shift_x>] F900"),
        ("G38.2 Z[-190.5-#<shift_z>] F60", "G38.2 Z[-190.5-#<shift_z>] F600"),
        ("G38.5 Z[-184.5-#<shift_z>] F60", "G38.5 Z[-200-#<shift_z>] F60"),
        ("G53 G1 Z-184.5 F500", "G53 G1 Z-190 F500"),
        ("if [#5070 AND #<_task>]", "if [#<_task>]"),
        ("20 * #5220", "20 * 1"),
        ("M66 E0 L0\n", ""),
        ("#<shift_z> = [#<_abs_z> - #<_z>]", "#<shift_z> = [#<_abs_z> - #<_x>]"),
        (" G49 ", " "),
        ("(LOG,1,1,400,300,-200,", "(LOG,1,1,400,300,-210,"),
    ]
    .map(|(from, to)| (Control::LinuxCnc, from, to));
    assert_each_is_seen(plan, &limits, &dangers);
}
