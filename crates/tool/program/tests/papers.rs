//! The programs next to those of the papers, checked by hand.

mod support;

use support::{machine, parse, with_z};
use trueup_machine::machine_file::LinearAxis;
use trueup_program::{
    Control, MeasurementKind, MeasurementOptions, MeasurementPlan, MeasuringInstrument, control,
    create_plans, plan::Step, template,
};

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

fn of(kind: MeasurementKind, options: &MeasurementOptions) -> Vec<MeasurementPlan> {
    create_plans(kind, &machine(), options).expect("it fits").0
}

fn only_x() -> MeasurementOptions {
    MeasurementOptions { axes: vec![LinearAxis::X], ..MeasurementOptions::default() }
}

/// Z makes room for the dial, as in the paper.
fn x_with_room() -> MeasurementOptions {
    MeasurementOptions {
        axes: vec![LinearAxis::X],
        clearance_mm: Some((LinearAxis::Z, 50.0)),
        ..with_z()
    }
}

#[test]
fn fanuc_backlash_is_the_papers_own_program() {
    let text = control::generate_program(
        &of(MeasurementKind::Backlash, &x_with_room())[0],
        Control::Fanuc,
    )
    .expect("it is written")
    .1;
    // Paper 4, N10 to N90, for X: 50 mm of over-travel, 5 s to read, Z out of the way and back, at the feed of an
    // approach.
    let paper = "\
O7101(BACKLASH-X)
N10 G91 G01 X50. F1000
N20 X-50.
N30 G04 X5.
N40 Z50. F500
N50 X-50. F1000
N60 X50.
N70 Z-50. F500
N80 G04 X5.
N90 M99
";
    assert!(text.contains(paper), "{text}");
    // At the middle and near both ends, seven times each, by one subprogram.
    for place in ["X[50.-#5021]", "X[500.-#5021]", "X[950.-#5021]"] {
        assert!(text.contains(&format!("{place}\n")), "{place}: {text}");
    }
    assert_eq!(text.matches("M98 P7101 L7").count(), 3, "{text}");
    assert_eq!(text.matches("\nO").count(), 2, "{text}");
}

#[test]
fn the_other_controls_say_the_same() {
    let plan = &of(MeasurementKind::Backlash, &x_with_room())[0];
    let linuxcnc = "\
o101 repeat [7]
  G53 G1 X100 F1000
  G53 G1 X50 F1000
  G4 P5 (read)
  G53 G1 Z0 F500
  G53 G1 X0 F1000
  G53 G1 X50 F1000
  G53 G1 Z-50 F500
  G4 P5 (read)
o101 endrepeat
";
    let siemens = "\
FOR R1=1 TO 7
  SUPA G1 X100 F1000
  SUPA G1 X50 F1000
  G4 F5 ; read
  SUPA G1 Z0 F500
  SUPA G1 X0 F1000
  SUPA G1 X50 F1000
  SUPA G1 Z-50 F500
  G4 F5 ; read
ENDFOR
";
    let heidenhain = "\
LBL 1
L X+100 R0 F1000 M91
L X+50 R0 F1000 M91
; read
CYCL DEF 9.0 DWELL TIME
CYCL DEF 9.1 DWELL 5
L Z+0 R0 F500 M91
L X+0 R0 F1000 M91
L X+50 R0 F1000 M91
L Z-50 R0 F500 M91
; read
CYCL DEF 9.0 DWELL TIME
CYCL DEF 9.1 DWELL 5
CALL LBL 1 REP 6
";
    for (control, cycle) in [
        (Control::LinuxCnc, linuxcnc),
        (Control::Siemens, siemens),
        (Control::Heidenhain, heidenhain),
    ] {
        let mut text = control::generate_program(plan, control).expect("it is written").1;
        if control == Control::Heidenhain {
            let blocks = text.lines().filter_map(|line| line.split_once(' '));
            text = blocks.map(|(_, block)| block.to_string() + "\n").collect();
        }
        assert!(text.contains(cycle), "{control:?}: {text}");
    }
}

#[test]
fn backlash_has_seven_pairs_at_three_places() {
    let plan = &of(MeasurementKind::Backlash, &only_x())[0];
    let readings = plan.readings();
    assert_eq!(readings.len(), 3 * 7 * 2);
    for pair in readings.chunks(2) {
        assert_eq!(pair[0].position_mm[0], pair[1].position_mm[0]);
        assert_eq!([pair[0].direction[0], pair[1].direction[0]], [-1, 1]);
        assert_eq!(pair[0].run, pair[1].run);
    }
    let text = &template::run_file_templates(plan)[0].1;
    let rows: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).take(3).collect();
    assert_eq!(
        rows,
        ["run,x_mm,dir_x,feed_mm_per_min,measured_dx_um", "1,50,-1,1000,", "1,50,1,1000,"]
    );
}

#[test]
fn a_dial_asks_for_a_hand_and_a_laser_does_not() {
    let stops = |gauge| {
        let options = MeasurementOptions { gauge: Some(gauge), ..only_x() };
        control::generate_program(&of(MeasurementKind::Backlash, &options)[0], Control::LinuxCnc)
            .expect("it is written")
            .1
    };
    // The first, one to set it at each place, and one to take it away before each way to the next.
    assert_eq!(stops(MeasuringInstrument::Dial).matches("\nM0\n").count(), 1 + 3 + 2);
    let laser = stops(MeasuringInstrument::Laser);
    assert_eq!(laser.matches("\nM0\n").count(), 1, "{laser}");
    let moves = laser.lines().filter(|line| line.contains("G53"));
    assert!(moves.clone().count() > 12, "{laser}");
    moves.for_each(|line| assert!(!line.contains(['Y', 'Z']), "{line}"));
}

#[test]
fn a_backlash_on_a_scale_is_not_measured() {
    let text = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x]\nfeedback = \"scale\"\n\
                travel_mm = [0.0, 1000.0]\n[axis.y]\ntravel_mm = [0.0, 500.0]\n";
    let (made, notes) =
        create_plans(MeasurementKind::Backlash, &parse(text), &MeasurementOptions::default())
            .expect("y is measured");
    assert_eq!(made.iter().map(|plan| plan.name.as_str()).collect::<Vec<_>>(), ["backlash-y"]);
    assert!(notes[0].contains("travel of z") && notes[1].contains("from a scale"), "{notes:?}");
    assert!(create_plans(MeasurementKind::Backlash, &parse(text), &only_x()).is_err());
}

#[test]
fn pitch_goes_there_and_back_five_times_over_uneven_targets() {
    let plan = &of(MeasurementKind::Pitch, &only_x())[0];
    let readings = plan.readings();
    let targets: Vec<f64> =
        readings[..21].iter().filter_map(|reading| reading.position_mm[0]).collect();
    assert_eq!(readings.len(), 5 * 2 * 21);
    let steps: Vec<f64> = targets.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(steps.iter().all(|step| *step > 20.0), "{steps:?}");
    // No period from 5 mm to 40 mm is met at one phase only: the phases' vectors nearly cancel.
    for period in 5..=40 {
        let angle = |mm: &f64| std::f64::consts::TAU * mm / f64::from(period);
        let sum = targets.iter().fold((0.0, 0.0), |sum: (f64, f64), mm| {
            (sum.0 + angle(mm).cos(), sum.1 + angle(mm).sin())
        });
        let share = sum.0.hypot(sum.1) / targets.len() as f64;
        assert!(share < 0.9, "a period of {period} mm is seen at one phase: {share}");
    }
    assert!(readings[..21].iter().all(|reading| reading.direction[0] == 1));
    assert!(readings[21..42].iter().all(|reading| reading.direction[0] == -1));
    assert_eq!((readings[41].run, readings[42].run), (1, 2));
}

#[test]
fn a_long_axis_has_targets_at_most_a_quarter_of_a_metre_apart() {
    let text = include_str!("../../../../data/gantry.toml");
    let (made, _) = create_plans(MeasurementKind::Pitch, &parse(text), &only_x()).expect("it fits");
    let readings = made[0].readings();
    let tenth = &readings[..readings.len() / 10];
    let targets: Vec<f64> = tenth.iter().filter_map(|reading| reading.position_mm[0]).collect();
    // 14 200 mm within the over-travel, in 57 steps; a target moves on by a quarter of one at most.
    assert_eq!(targets.len(), 58);
    assert!(targets.windows(2).all(|pair| pair[1] - pair[0] < 1.25 * 250.0));
}

#[test]
fn an_axis_is_heated_between_500_and_1500_mm_for_twenty_minutes() {
    let text = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x]\ntravel_mm = [-2.0, 2002.0]\n\
                [axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_nut_c\"\nreference_c = 22.0\n";
    let (made, _) =
        create_plans(MeasurementKind::AxisHeat, &parse(text), &only_x()).expect("it fits");
    let plan = &made[0];
    let at: Vec<f64> =
        plan.readings()[..11].iter().filter_map(|reading| reading.position_mm[0]).collect();
    let every_100: Vec<f64> = (5..=15).map(|n| 100.0 * f64::from(n)).collect();
    assert_eq!(at, every_100);
    assert_eq!(plan.readings().len(), 7 * 11);
    assert!(plan.readings().iter().all(|reading| reading.direction[0] == 1));
    let strokes = plan.steps.iter().find_map(|step| match step {
        Step::Repeat { steps, .. } => steps.iter().find_map(|step| match step {
            Step::Repeat { times, .. } => Some(*times),
            _ => None,
        }),
        _ => None,
    });
    // 2 m there and back at 10 m/min are 12 s: 100 in 20 minutes.
    assert_eq!(strokes, Some(100));
    let text = &template::run_file_templates(plan)[0].1;
    assert!(text.contains("\ntime_s,x_mm,dir_x,temp_nut_c,measured_dx_um\n"), "{text}");
}

#[test]
fn a_warm_up_is_read_once_a_minute_for_two_hours_off_and_on() {
    let plan = &of(MeasurementKind::Warmup, &MeasurementOptions::default())[0];
    let names: Vec<String> =
        template::run_file_templates(plan).into_iter().map(|template| template.0).collect();
    assert_eq!(names, ["warmup-off.csv", "warmup-on.csv"]);
    let readings = plan.readings();
    assert_eq!(readings.len(), 120);
    assert_eq!((readings[0].dwelt_s, readings[119].dwelt_s), (60.0, 7200.0));
    let text = control::generate_program(plan, Control::Fanuc).expect("it is written").1;
    for block in ["M00\n", "M03 S24000\n", "M98 P7101 L120\n", "M05\n"] {
        assert!(text.contains(block), "{block}: {text}");
    }
    assert!(text.contains("NON-CONTACT GAUGE ONLY") && !text.contains("#3000"), "{text}");
    assert!(text.contains("N10 G04 X55.\nN20 G04 X5.\nN30 M99"), "{text}");
}

#[test]
fn a_dial_touches_the_bar_only_while_the_spindle_stands() {
    let plan = &of(
        MeasurementKind::Warmup,
        &MeasurementOptions {
            gauge: Some(MeasuringInstrument::Dial),
            ..MeasurementOptions::default()
        },
    )[0];
    assert!(plan.readings().iter().all(|reading| reading.spindle_rpm == 0.0));
    // Two hours, every ten minutes.
    assert_eq!(plan.readings().len(), 12);
    let text = control::generate_program(plan, Control::LinuxCnc).expect("it is written").1;
    assert!(text.contains("M5\n  G4 P20 (read)\n  (MSG, Wait until the spindle stands."), "{text}");
    let text = &template::run_file_templates(plan)[0].1;
    // The speed of the time between the readings.
    assert!(text.contains("\ntime_s,spindle_rpm,measured_elongation_um\n,24000,\n"), "{text}");
}

#[test]
fn a_diagonal_ends_at_the_corners() {
    let made = of(MeasurementKind::Diagonal, &with_z());
    let names: Vec<&str> = made.iter().map(|plan| plan.name.as_str()).collect();
    assert_eq!(names, ["diagonal-xy", "diagonal-xz", "diagonal-yz"]);
    let readings = made[0].readings();
    let there = &readings[..readings.len() / 6];
    let ends = [there[0], there[there.len() - 1]].map(|reading| reading.position_mm);
    assert_eq!(ends, [[Some(50.0), Some(-270.0), None], [Some(950.0), Some(270.0), None]]);
    for reading in there {
        let [Some(x), Some(y), None] = reading.position_mm else { panic!("{reading:?}") };
        assert!(((x - 50.0) / 900.0 - (y + 270.0) / 540.0).abs() < 1e-5, "{reading:?}");
    }
}

#[test]
fn a_step_diagonal_moves_one_axis_at_a_time_between_opposite_corners() {
    let made = of(MeasurementKind::StepDiagonal, &with_z());
    let names: Vec<&str> = made.iter().map(|plan| plan.name.as_str()).collect();
    assert_eq!(names.len(), 4, "{names:?}");
    let mut ways = std::collections::BTreeSet::new();
    for plan in &made {
        let readings = plan.readings();
        let there = &readings[..readings.len() / 2];
        let [first, last] = [there[0], there[there.len() - 1]]
            .map(|reading| reading.position_mm.map(Option::unwrap));
        // The tool comes in last, and goes out first.
        assert!(first[2] > last[2], "{}", plan.name);
        ways.insert([0, 1].map(|n| last[n] > first[n]));
        for pair in there.windows(2) {
            let moved = (0..3).filter(|n| pair[0].position_mm[*n] != pair[1].position_mm[*n]);
            assert_eq!(moved.count(), 1, "{pair:?}");
        }
    }
    assert_eq!(ways.len(), 4, "{ways:?}");
    // All four are measured before they are fitted.
    let then: Vec<&String> = made.iter().flat_map(|plan| &plan.then).collect();
    assert_eq!(then.len(), 1, "{then:?}");
    for number in 1..=4 {
        assert!(then[0].contains(&format!("--run step-diagonal-{number}-xyz.csv")), "{then:?}");
    }
}

#[test]
fn a_horizontal_spindle_has_two_step_diagonals_and_the_notes_say_so() {
    let machine = parse(
        "[machine]\nname = \"horizontal\"\nkind = \"3-axis\"\ntool_direction = [0.0, -1.0, 0.0]\n\
         [axis.x]\ntravel_mm = [0.0, 500.0]\n[axis.y]\ntravel_mm = [0.0, 400.0]\n[axis.z]\ntravel_mm = [0.0, 300.0]\n",
    );
    let range_mm = [None, Some([0.0, 400.0]), Some([0.0, 300.0])];
    let options = MeasurementOptions { range_mm, ..MeasurementOptions::default() };
    let (made, notes) =
        create_plans(MeasurementKind::StepDiagonal, &machine, &options).expect("it fits");
    // Y and Z both begin where they are retracted.
    let x_mm = |plan: &MeasurementPlan| plan.readings()[0].position_mm[0];
    assert_eq!(made.len(), 2);
    assert_ne!(x_mm(&made[0]), x_mm(&made[1]));
    assert!(made[1].then[0].ends_with("step-diagonal-2-xyz.csv"), "{:?}", made[1].then);
    assert!(notes.iter().any(|note| note.contains("2 of the four body diagonals")), "{notes:?}");
}

#[test]
fn a_circle_is_two_turns_each_way_by_ways_from_its_start_and_read_behind_the_run_in() {
    let options = MeasurementOptions { axes: vec![LinearAxis::X, LinearAxis::Y], ..with_z() };
    let made = of(MeasurementKind::Circle, &options);
    let [plan] = &made[..] else { panic!("{}", made.len()) };
    for (control, turns) in [
        (
            Control::LinuxCnc,
            "(MSG, If the circle is aborted, type G90 first: until its end places are increments.)\nG17 G91 G91.1 G64\nG3 X0 Y0 I-150 J0 F1000\nG3 X0 Y0 I-150 J0 F1000\nG17 G90 G61\nG4 P5\n",
        ),
        (
            Control::Siemens,
            "G17 G64\nG3 X=IC(0) Y=IC(0) I-150 J0 F1000\nG3 X=IC(0) Y=IC(0) I-150 J0 F1000\nG17 G60\nG4 F5\n",
        ),
    ] {
        let text = control::generate_program(plan, control).expect("it is written").1;
        assert!(text.contains(turns), "{control:?}: {text}");
        assert_eq!(text.matches("I-150").count(), 4, "{text}");
    }
    let readings = plan.readings();
    assert_eq!(readings.len(), 2 * 451);
    assert!(readings[..451].iter().all(|reading| reading.sense == 1));
    assert!(readings[451..].iter().all(|reading| reading.sense == -1));
    // 135° behind the start, to the left and up; the other way round down.
    let at = |n: usize| [0, 1].map(|axis| readings[n].position_mm[axis].map(f64::round));
    assert_eq!([at(0), at(451)], [[Some(394.0), Some(106.0)], [Some(394.0), Some(-106.0)]]);
    let text = &template::run_file_templates(plan)[0].1;
    assert!(
        text.contains("\nsetup,x_mm,y_mm,dir,feed_mm_per_min,measured_dr_um\n1,393."),
        "{text}"
    );
}

#[test]
fn a_plate_is_touched_ball_by_ball_with_each_stylus_at_its_height() {
    let options = MeasurementOptions {
        at_mm: [Some(100.0), Some(-100.0), Some(-300.0)],
        ball_mm: Some(20.0),
        stylus_mm: Some(6.0),
        step_mm: Some(90.0),
        balls: Some([2, 2]),
        repeats: Some(1),
        tool_lengths_mm: vec![100.0, 150.0],
        ..with_z()
    };
    let made = of(MeasurementKind::Plate, &options);
    let readings = made[0].readings();
    let points: Vec<Option<u32>> = readings.iter().map(|reading| reading.point).collect();
    // There and back; a ball keeps its number.
    assert_eq!(points, [1, 2, 4, 3, 1, 2, 4, 3].map(Some));
    let place = |n: usize| readings[n].position_mm.map(Option::unwrap);
    assert_eq!([place(2), place(6)], [[190.0, -10.0, -300.0], [190.0, -10.0, -250.0]]);
    let text = &template::run_file_templates(&made[0])[0].1;
    let header = "run,setup,point,x_mm,y_mm,z_mm,tool_length_mm,measured_dx_um,measured_dy_um,measured_dz_um\n";
    assert!(text.contains(&format!("\n{header}1,1,1,100,-100,-300,100,,,\n")), "{text}");
    // 24 readings can be fitted alone, and fewer cannot.
    assert_eq!(made[0].then.len(), 1);
    let one = MeasurementOptions { balls: Some([2, 1]), ..options };
    assert!(of(MeasurementKind::Plate, &one)[0].then.is_empty());
}

#[test]
fn no_program_leaves_the_travel_and_every_cycle_ends_where_it_began() {
    let gauges = [None, Some(MeasuringInstrument::Dial), Some(MeasuringInstrument::Laser)];
    for (kind, gauge) in KINDS.into_iter().flat_map(|kind| gauges.map(|gauge| (kind, gauge))) {
        for plan in of(kind, &MeasurementOptions { gauge, ..with_z() }) {
            let travel = [[0.0, 1000.0], [-300.0, 300.0], [-400.0, 0.0]]; // The margins are out of it.
            for (extent, [low, high]) in plan.extent_mm().into_iter().zip(travel) {
                if let Some([from, to]) = extent {
                    assert!(low <= from && to <= high, "{}: {from} to {to}", plan.name);
                }
            }
            closes(&plan.steps, &mut [None; 3], &plan.name);
        }
    }
}

/// Increments repeat only what ends where it began.
fn closes(steps: &[Step], at: &mut [Option<f64>; 3], name: &str) {
    for step in steps {
        match step {
            Step::Move { to_mm: to, .. } => {
                for (at, to) in at.iter_mut().zip(to) {
                    *at = to.or(*at);
                }
            }
            Step::Approach { axis, to_mm } => at[*axis] = Some(*to_mm),
            Step::Repeat { steps, .. } => {
                let before = *at;
                closes(steps, at, name);
                assert_eq!(before, *at, "{name}");
            }
            _ => {}
        }
    }
}

#[test]
fn what_does_not_fit_is_refused_with_its_reason() {
    let bare = parse("[machine]\nname = \"m\"\nkind = \"3-axis\"\n");
    let shows = |kind, machine, options: MeasurementOptions| {
        create_plans(kind, machine, &options).expect_err("it does not fit").to_string()
    };
    for kind in KINDS.into_iter().filter(|kind| *kind != MeasurementKind::Warmup) {
        let why = shows(kind, &bare, MeasurementOptions::default());
        assert!(why.contains("travel of x is not known"), "{why}");
    }
    let why = shows(MeasurementKind::Warmup, &bare, MeasurementOptions::default());
    assert!(why.contains("--rpm"), "{why}");
    let here = machine();
    let beyond = MeasurementOptions { range_mm: [Some([0.0, 1200.0]), None, None], ..only_x() };
    for kind in [MeasurementKind::Pitch, MeasurementKind::AxisHeat, MeasurementKind::Backlash] {
        let why = shows(kind, &here, beyond.clone());
        assert!(why.contains("--range x=0:1200") && why.contains("-2 to 1002 mm"), "{why}");
    }
    assert!(shows(MeasurementKind::Diagonal, &here, only_x()).contains("two axes"));
    let fine = MeasurementOptions { step_mm: Some(0.01), ..only_x() };
    assert!(shows(MeasurementKind::Pitch, &here, fine).contains("--step-mm"));
    for options in [
        MeasurementOptions { dwell_s: 0.0, ..only_x() },
        MeasurementOptions { feeds_mm_per_min: vec![1000.0, f64::NAN], ..only_x() },
        MeasurementOptions { repeats: Some(0), ..only_x() },
        MeasurementOptions { margin_mm: f64::NAN, ..only_x() },
        MeasurementOptions { margin_mm: -1.0, ..only_x() },
        MeasurementOptions { margin_mm: 501.5, ..only_x() },
        MeasurementOptions { approach_mm_per_min: 0.0, ..only_x() },
        MeasurementOptions { range_mm: [Some([9.0, 9.0]), None, None], ..only_x() },
        MeasurementOptions { range_mm: [Some([9.0, f64::NAN]), None, None], ..only_x() },
        MeasurementOptions { range_mm: [Some([9.0, 10.9]), None, None], ..only_x() },
        MeasurementOptions { clearance_mm: Some((LinearAxis::Y, f64::NAN)), ..only_x() },
        MeasurementOptions { clearance_mm: Some((LinearAxis::Y, 700.0)), ..only_x() },
        MeasurementOptions { clearance_mm: Some((LinearAxis::Z, 50.0)), ..only_x() },
        MeasurementOptions { clearance_mm: Some((LinearAxis::Z, -50.0)), ..x_with_room() },
    ] {
        shows(MeasurementKind::Backlash, &here, options);
    }
    let often = MeasurementOptions { every_s: Some(4.0), ..MeasurementOptions::default() };
    assert!(shows(MeasurementKind::Warmup, &here, often).contains("--every-s 4"));
}

#[test]
fn an_axis_with_two_drives_is_measured_at_both_ends_of_its_beam() {
    let machine = parse(
        "[machine]\nname = \"gantry\"\nkind = \"3-axis\"\n[axis.x]\ntravel_mm = [-2.0, 1002.0]\n\
         [axis.x.pitch]\nstart_mm = 0.0\nstep_mm = 1000.0\nforward_um = [0.0, 0.0]\n\
         [axis.x.dual]\nacross = \"y\"\nfirst_mm = 0.0\nsecond_mm = 3000.0\n\
         pitch = { start_mm = 0.0, step_mm = 1000.0, forward_um = [0.0, 0.0] }\n",
    );
    let plans = create_plans(MeasurementKind::Pitch, &machine, &only_x()).expect("it fits").0;
    let names: Vec<&str> = plans.iter().map(|plan| plan.name.as_str()).collect();
    assert_eq!(names, ["pitch-x-drive1", "pitch-x-drive2"]);
    for (plan, mm, which) in [(&plans[0], 0, "first"), (&plans[1], 3000, "second")] {
        let sentence = format!("Y stands at {mm} mm, at the {which} drive.");
        assert!(
            plan.first_stop_instructions().contains(&sentence),
            "{:?}",
            plan.first_stop_instructions()
        );
        // Y is where the operator has put it: no program that is named after X moves it.
        assert_eq!(plan.extent_mm()[1], None);
        let (_, text) = &template::run_file_templates(plan)[0];
        let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).collect();
        assert_eq!(lines[0], "run,x_mm,dir_x,y_mm,measured_dx_um");
        assert!(lines[1..].iter().all(|line| line.ends_with(&format!(",{mm},"))), "{text}");
        assert!(plan.then[0].contains("--run pitch-x-drive1.csv --run pitch-x-drive2.csv"));
    }
}
