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
use trueup_machine::file::LinearAxis;
use trueup_program::{
    Control, Kind, Plan, Stretch, Targets, control::program, plans, speeds, targets,
};
use walk::{Limits, walk};

const KINDS: [Kind; 7] = [
    Kind::Backlash,
    Kind::Pitch,
    Kind::Straightness,
    Kind::Warmup,
    Kind::AxisHeat,
    Kind::Diagonal,
    Kind::StepDiagonal,
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
fn check(plan: &Plan, axes: &[LinearAxis], draw: &Draw) {
    for control in [Control::LinuxCnc, Control::Fanuc, Control::Siemens, Control::Heidenhain] {
        let (name, text) = program(plan, control);
        let limits = Limits::of(draw, axes);
        let walked = read(control, &text).and_then(|events| walk(&events, &limits, plan));
        if let Err(danger) = walked {
            let head: Vec<&str> = text.lines().take(60).collect();
            panic!("{name}, draw {}: {danger}\n{draw:?}\n{}", draw.number, head.join("\n"));
        }
    }
}

/// Returns the axes that a plan's name names.
fn named(plan: &Plan) -> Vec<LinearAxis> {
    let last = plan.name.rsplit('-').next().unwrap_or_default();
    let is_axes = ["x", "y", "z", "xy", "xz", "yz", "xyz"].contains(&last);
    let all = LinearAxis::ALL.into_iter();
    all.filter(|axis| is_axes && last.contains(axis.name())).collect()
}

#[test]
fn no_program_of_any_control_and_kind_is_a_danger() {
    let mut written = 0;
    for draw in Draws::new(DRAWS) {
        for kind in KINDS {
            let mut options = draw.options.clone();
            options.spindle_rpm = Some(12_000.0);
            if kind == Kind::AxisHeat {
                options.heat_s = options.heat_s.map(|s| 0.1 * s);
            }
            match plans(kind, &draw.machine, &options) {
                Ok((plans, notes)) => {
                    for plan in &plans {
                        let mut axes = named(plan);
                        assert_eq!(axes.is_empty(), kind == Kind::Warmup, "{}", plan.name);
                        if kind == Kind::Backlash {
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
fn no_next_run_is_a_danger() {
    let mut written = 0;
    for draw in Draws::new(DRAWS) {
        let axis = draw.axis();
        let [low, high] = draw.seen_mm(axis);
        let run = Targets {
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
        match targets(&run, &draw.machine, &draw.options, &[], "To separate a from b.") {
            Ok(plan) => {
                assert!(!is_guarded || draw.options.range_mm[axis.index()].is_some());
                check(&plan, &[axis], &draw);
                written += 1;
            }
            Err(why) => assert!(why.0.contains(axis.name()), "{why}"),
        }
        let stretches = [6000.0, 0.0].map(|rpm| Stretch { rpm, minutes: 2.0, load_n: 0.0 });
        check(&speeds(&stretches, 20.0, &[], "To separate a from b."), &[], &draw);
    }
    assert!(written > DRAWS / 4, "{written}");
}

/// A danger of each sort is seen: the walk is not blind.
#[test]
fn the_walk_sees_each_danger() {
    let draw = Draw::plain();
    let options = trueup_program::Options { repeats: Some(1), ..draw.options.clone() };
    let plan = &plans(Kind::Pitch, &draw.machine, &options).expect("it fits").0[0];
    let limits = Limits::of(&draw, &[LinearAxis::X]);
    let right = |control| program(plan, control).1;
    for control in [Control::LinuxCnc, Control::Fanuc, Control::Siemens, Control::Heidenhain] {
        let events = read(control, &right(control)).expect("it is read");
        walk(&events, &limits, plan).expect("it is no danger");
    }
    let dangers: [(Control, &str, &str); 14] = [
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
    for (control, from, to) in dangers {
        let text = right(control);
        assert!(text.contains(from), "{from}: {text}");
        let wrong = text.replacen(from, to, 1);
        let walked = read(control, &wrong).and_then(|events| walk(&events, &limits, plan));
        assert!(walked.is_err(), "{control:?}: {from} became {to:?} and nothing was seen");
    }
}
