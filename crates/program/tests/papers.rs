//! The programs beside those of the papers, checked by hand.

mod support;

use support::{machine, parse};
use trueup_machine::file::LinearAxis;
use trueup_program::{Control, Gauge, Kind, Options, Plan, control, plan::Step, plans, template};

const KINDS: [Kind; 6] =
    [Kind::Backlash, Kind::Pitch, Kind::Straightness, Kind::Warmup, Kind::AxisHeat, Kind::Diagonal];

fn of(kind: Kind, options: &Options) -> Vec<Plan> {
    plans(kind, &machine(), options).expect("it fits").0
}

fn only_x() -> Options {
    Options { axes: vec![LinearAxis::X], ..Options::default() }
}

#[test]
fn fanuc_backlash_is_the_papers_own_program() {
    let text = control::program(&of(Kind::Backlash, &only_x())[0], Control::Fanuc).1;
    // Seed 004, N10 to N90, for X: 50 mm of over-travel, 5 s to read, Z out of the way and back.
    let paper = "\
O7101(BACKLASH-X)
N10 G91 G01 X50. F1000
N20 X-50.
N30 G04 X5.
N40 Z50.
N50 X-50.
N60 X50.
N70 Z-50.
N80 G04 X5.
N90 M99
";
    assert!(text.contains(paper), "{text}");
    // At the middle and near both ends, seven times each, by one subprogram.
    for place in ["X50.", "X500.", "X950."] {
        assert!(text.contains(&format!("G90 G53 G00 {place}\n")), "{place}: {text}");
    }
    assert_eq!(text.matches("M98 P7101 L7").count(), 3, "{text}");
    assert_eq!(text.matches("\nO").count(), 2, "{text}");
}

#[test]
fn the_other_controls_say_the_same() {
    let plan = &of(Kind::Backlash, &only_x())[0];
    let linuxcnc = "\
o101 repeat [7]
  G53 G1 X100 F1000
  G53 G1 X50 F1000
  G4 P5 (read)
  G91 G1 Z50 F1000
  G90
  G53 G1 X0 F1000
  G53 G1 X50 F1000
  G91 G1 Z-50 F1000
  G90
  G4 P5 (read)
o101 endrepeat
";
    let siemens = "\
FOR R1=1 TO 7
  SUPA G1 X100 F1000
  SUPA G1 X50 F1000
  G4 F5 ; read
  G1 Z=IC(50) F1000
  SUPA G1 X0 F1000
  SUPA G1 X50 F1000
  G1 Z=IC(-50) F1000
  G4 F5 ; read
ENDFOR
";
    let heidenhain = "\
8 LBL 1
9 L X+100 R0 F1000 M91
10 L X+50 R0 F1000 M91
11 ; read
12 CYCL DEF 9.0 DWELL TIME
13 CYCL DEF 9.1 DWELL 5
14 L IZ+50 R0 F1000
15 L X+0 R0 F1000 M91
16 L X+50 R0 F1000 M91
17 L IZ-50 R0 F1000
18 ; read
19 CYCL DEF 9.0 DWELL TIME
20 CYCL DEF 9.1 DWELL 5
21 CALL LBL 1 REP 6
";
    for (control, cycle) in [
        (Control::LinuxCnc, linuxcnc),
        (Control::Siemens, siemens),
        (Control::Heidenhain, heidenhain),
    ] {
        let text = control::program(plan, control).1;
        assert!(text.contains(cycle), "{control:?}: {text}");
    }
}

#[test]
fn backlash_has_seven_pairs_at_three_places() {
    let plan = &of(Kind::Backlash, &only_x())[0];
    let readings = plan.readings();
    assert_eq!(readings.len(), 3 * 7 * 2);
    for pair in readings.chunks(2) {
        assert_eq!(pair[0].position_mm[0], pair[1].position_mm[0]);
        assert_eq!([pair[0].direction[0], pair[1].direction[0]], [-1, 1]);
        assert_eq!(pair[0].run, pair[1].run);
    }
    let text = &template::templates(plan)[0].1;
    let rows: Vec<&str> = text.lines().skip(2).take(3).collect();
    assert_eq!(
        rows,
        ["run,x_mm,dir_x,feed_mm_per_min,measured_dx_um", "1,50,-1,1000,", "1,50,1,1000,"]
    );
}

#[test]
fn a_dial_asks_for_a_hand_and_a_laser_does_not() {
    let stops = |gauge| {
        let options = Options { gauge, ..only_x() };
        control::program(&of(Kind::Backlash, &options)[0], Control::LinuxCnc).1
    };
    assert_eq!(stops(Gauge::Dial).matches("\nM0\n").count(), 3);
    let laser = stops(Gauge::Laser);
    assert!(!laser.contains("\nM0\n") && !laser.contains('Z'), "{laser}");
}

#[test]
fn a_backlash_on_a_scale_is_not_measured() {
    let text = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x]\nfeedback = \"scale\"\n\
                travel_mm = [0.0, 1000.0]\n[axis.y]\ntravel_mm = [0.0, 500.0]\n";
    let (made, notes) =
        plans(Kind::Backlash, &parse(text), &Options::default()).expect("y is measured");
    assert_eq!(made.iter().map(|plan| plan.name.as_str()).collect::<Vec<_>>(), ["backlash-y"]);
    assert!(notes[0].contains("travel of z") && notes[1].contains("from a scale"), "{notes:?}");
    assert!(plans(Kind::Backlash, &parse(text), &only_x()).is_err());
}

#[test]
fn pitch_goes_there_and_back_five_times_over_uneven_targets() {
    let plan = &of(Kind::Pitch, &only_x())[0];
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
    let text = include_str!("../../../data/gantry.toml");
    let (made, _) = plans(Kind::Pitch, &parse(text), &only_x()).expect("it fits");
    let readings = made[0].readings();
    let targets: Vec<f64> =
        readings.iter().take(readings.len() / 10).filter_map(|it| it.position_mm[0]).collect();
    // 14 200 mm within the over-travel, in 57 steps; a target moves on by a quarter of one at most.
    assert_eq!(targets.len(), 58);
    assert!(targets.windows(2).all(|pair| pair[1] - pair[0] < 1.25 * 250.0));
}

#[test]
fn an_axis_is_heated_between_500_and_1500_mm_for_twenty_minutes() {
    let text = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x]\ntravel_mm = [0.0, 2000.0]\n\
                [axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_nut_c\"\nreference_c = 22.0\n";
    let (made, _) = plans(Kind::AxisHeat, &parse(text), &only_x()).expect("it fits");
    let plan = &made[0];
    let at: Vec<f64> = plan.readings()[..11].iter().filter_map(|it| it.position_mm[0]).collect();
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
    let text = &template::templates(plan)[0].1;
    assert_eq!(text.lines().nth(2), Some("time_s,x_mm,dir_x,temp_nut_c,measured_dx_um"));
}

#[test]
fn a_warm_up_is_read_once_a_minute_for_two_hours_off_and_on() {
    let plan = &of(Kind::Warmup, &Options::default())[0];
    let names: Vec<String> = template::templates(plan).into_iter().map(|it| it.0).collect();
    assert_eq!(names, ["warmup-off.csv", "warmup-on.csv"]);
    let readings = plan.readings();
    assert_eq!(readings.len(), 120);
    assert_eq!((readings[0].dwelt_s, readings[119].dwelt_s), (60.0, 7200.0));
    let text = control::program(plan, Control::Fanuc).1;
    assert!(text.contains("M03 S24000\nN70 M98 P7101 L120\nN80 M05"), "{text}");
    assert!(text.contains("N10 G04 X55.\nN20 G04 X5.\nN30 M99"), "{text}");
}

#[test]
fn a_diagonal_ends_at_the_corners() {
    let made = of(Kind::Diagonal, &Options::default());
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
fn no_program_leaves_the_travel_and_every_cycle_ends_where_it_began() {
    for (kind, gauge) in KINDS.into_iter().flat_map(|it| [(it, Gauge::Dial), (it, Gauge::Laser)]) {
        for plan in of(kind, &Options { gauge, ..Options::default() }) {
            let travel = [[0.0, 1000.0], [-300.0, 300.0], [-400.0, 0.0]];
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
            Step::Rapid(to) | Step::Move { to_mm: to, .. } => {
                for (at, to) in at.iter_mut().zip(to) {
                    *at = to.or(*at);
                }
            }
            Step::By { axis, mm, .. } => at[*axis] = at[*axis].map(|at| at + mm),
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
    let says = |kind, machine, options: Options| {
        plans(kind, machine, &options).expect_err("it does not fit").to_string()
    };
    for kind in KINDS.into_iter().filter(|kind| *kind != Kind::Warmup) {
        let why = says(kind, &bare, Options::default());
        assert!(why.contains("travel of x is not known"), "{why}");
    }
    let why = says(Kind::Warmup, &bare, Options::default());
    assert!(why.contains("--rpm"), "{why}");
    let here = machine();
    let beyond = Options { travel_mm: [Some([0.0, 1200.0]), None, None], ..only_x() };
    assert!(says(Kind::Pitch, &here, beyond).contains("travel_mm of 0 to 1000 mm"));
    let heat = Options { heat_range_mm: Some([500.0, 1500.0]), ..only_x() };
    assert!(says(Kind::AxisHeat, &here, heat).contains("from 50 to 950 mm"));
    assert!(says(Kind::Diagonal, &here, only_x()).contains("two axes"));
    let fine = Options { step_mm: Some(0.01), ..only_x() };
    assert!(says(Kind::Pitch, &here, fine).contains("--step-mm"));
    for options in [
        Options { dwell_s: 0.0, ..only_x() },
        Options { feeds_mm_per_min: vec![1000.0, f64::NAN], ..only_x() },
        Options { repeats: Some(0), ..only_x() },
        Options { every_s: 4.0, ..only_x() },
    ] {
        says(Kind::Backlash, &here, options);
    }
}
