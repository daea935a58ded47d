//! The causes of circles: signs by hand, drawn machines, one direction, both harms.

#![allow(clippy::print_stdout)]

use std::{collections::BTreeSet, path::Path};

use trueup_fit::circle::{
    CircleCause, CircleFinding, CircleReport, CircleVerdict, analyse_circles,
};
use trueup_machine::{Machine, MachineFile, RunFile, machine_file::LinearAxis};

use crate::circle_drawn::{CircleFault, Drawn};

const HEAD: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";

fn run(csv: &str) -> RunFile {
    RunFile::from_reader(csv.as_bytes(), Path::new("circle.csv")).expect("a run file")
}

fn report(drawn: &Drawn) -> CircleReport {
    analyse_circles(&[run(&drawn.csv())], None).expect("a circle")
}

fn machine(report: &CircleReport) -> Machine {
    let text = format!("{HEAD}{}", report.edit.to_toml());
    MachineFile::parse(&text, Path::new("m.toml")).unwrap_or_else(|error| panic!("{error}: {text}"))
}

fn value(finding: &CircleFinding, name: &str) -> f64 {
    finding
        .parameters
        .iter()
        .find(|parameter| parameter.name == name)
        .map_or(f64::NAN, |parameter| parameter.value)
}

fn only(report: &CircleReport) -> &CircleFinding {
    let findings = &report.circles[0].findings;
    assert_eq!(findings.len(), 1, "{findings:?}");
    assert!(findings[0].claimed, "{findings:?}");
    &findings[0]
}

/// Returns the names of the causes that are claimed, with the axis in error.
fn named(report: &CircleReport) -> BTreeSet<String> {
    let name = |finding: &CircleFinding| {
        let axis = finding.axis.map_or(String::new(), |axis| format!(" {}", axis.name()));
        format!("{}{axis}", finding.cause.name())
    };
    report.circles[0].findings.iter().filter(|finding| finding.claimed).map(name).collect()
}

#[test]
fn a_table_that_leans_to_plus_x_is_x_of_y_above_zero() {
    // At y = +100 mm x is 10 µm too large: at 45° the radius is 10·sin 45°·cos 45° = 5 µm too large.
    let report = report(&Drawn::ideal(vec![CircleFault::Squareness(100.0)], 100.0));
    let found = only(&report);
    assert_eq!(found.cause, CircleCause::Squareness);
    assert!((value(found, "amplitude_um") - 5.0).abs() < 0.02, "{found:?}");
    let squareness = &machine(&report).squareness[0];
    assert_eq!((squareness.error, squareness.along), (LinearAxis::X, LinearAxis::Y));
    assert!((squareness.um_per_m - 100.0).abs() < 0.5, "{squareness:?}");
}

#[test]
fn a_table_that_is_left_behind_has_backlash_above_zero() {
    for width_um in [8.0, -8.0] {
        let report = report(&Drawn::ideal(vec![CircleFault::Play(1, width_um)], 100.0));
        let found = only(&report);
        assert_eq!((found.cause, found.axis), (CircleCause::Backlash, Some(LinearAxis::Y)));
        let backlash = machine(&report).axes[1].backlash.expect("a backlash");
        assert!((backlash.width_um - width_um).abs() < 0.05, "{backlash:?}");
    }
}

#[test]
fn an_x_axis_that_moves_too_far_gets_half_of_the_mismatch_above_zero() {
    // 60 µm/m at ±100 mm: ±6 µm; the circle shows the difference of the axes, half of it is written to each.
    let report = report(&Drawn::ideal(vec![CircleFault::Scale(60.0)], 100.0));
    assert!((value(only(&report), "um_per_m") - 60.0).abs() < 0.3);
    let axes = machine(&report).axes;
    let ends = [0, 1].map(|axis: usize| {
        let pitch = axes[axis].pitch.as_ref().expect("a table");
        assert_eq!(pitch.forward_um.len(), 2);
        pitch.forward_um[1]
    });
    assert!((ends[0] - 3.0).abs() < 0.05 && (ends[1] + 3.0).abs() < 0.05, "{ends:?}");
}

#[test]
fn an_x_axis_that_lags_more_is_a_positive_lag_that_no_table_corrects() {
    let report = report(&Drawn::ideal(vec![CircleFault::Servo(0.5)], 100.0));
    let found = only(&report);
    assert_eq!((found.cause, found.compensated), (CircleCause::ServoMismatch, false));
    assert!((value(found, "lag_difference_ms") - 0.5).abs() < 0.01, "{found:?}");
    assert!(report.edit.is_empty() && report.verdict == CircleVerdict::Explained);
}

#[test]
fn a_cyclic_error_is_written_in_phase_with_the_machine_s_position() {
    let report = report(&Drawn::ideal(vec![CircleFault::Cyclic(0, 3.0, 10.0, 0.7)], 100.0));
    let found = only(&report);
    assert!((value(found, "period_mm") - 10.0).abs() < 0.01, "{found:?}");
    let axes = machine(&report).axes;
    let pitch = axes[0].pitch.as_ref().expect("a table");
    for mm in [-60.0_f64, -3.3, 41.7, 88.0] {
        let expected = 3.0 * (std::f64::consts::TAU * mm / 10.0 + 0.7).sin();
        let found = trueup_machine::model::pitch_error_um(pitch, mm, 1.0);
        assert!((found - expected).abs() < 0.25, "{mm}: {found} and {expected}");
    }
}

#[test]
fn a_straightness_is_written_by_its_form_for_either_axis() {
    for axis in [0, 1] {
        let drawn = Drawn::ideal(vec![CircleFault::Straightness(axis, [6.0, 4.0, 0.4])], 100.0);
        let report = report(&drawn);
        assert_eq!(named(&report).len(), 1, "{:?}", named(&report));
        let machine = machine(&report);
        let curve = &machine.straightness[0];
        assert_eq!((curve.error.index(), curve.along.index()), (1 - axis, axis));
        let angles: Vec<f64> = (0..=18).map(|n| f64::from(n) * 0.1745).collect();
        // Both as deviations from their straight lines: that line is the squareness.
        let errors = drawn.errors(&angles, 1.0);
        let mm = |angle: &f64| {
            let share = if axis == 0 { angle.cos() } else { angle.sin() };
            drawn.centre_mm[axis] + 100.0 * share
        };
        let left: Vec<f64> = angles
            .iter()
            .zip(errors)
            .map(|(angle, e)| {
                trueup_machine::model::spline_value_um(&curve.spline, mm(angle)) - e[1 - axis]
            })
            .collect();
        let x: Vec<f64> = angles.iter().map(mm).collect();
        let line = trueup_numerics::line::fit_line(&x, &left).expect("a line");
        let worst =
            line.residuals.iter().fold(0.0, |worst: f64, residual| worst.max(residual.abs()));
        assert!(worst < 0.15, "{worst} µm");
    }
}

#[test]
fn spikes_and_drift_are_reported_and_not_written() {
    let spikes = CircleFault::Spikes(0, [8.0, 6.0, 7.0, 9.0], 3.0);
    let drawn = Drawn {
        noise_um: 0.2,
        ..Drawn::ideal(vec![spikes, CircleFault::Drift([0.0, 6.0, -4.0])], 100.0)
    };
    let report = report(&drawn);
    let expected: BTreeSet<String> = drawn.faults.iter().map(CircleFault::name).collect();
    assert_eq!(named(&report), expected);
    assert!(report.edit.is_empty(), "{:?}", report.written);
    let is_spike = |finding: &&CircleFinding| finding.cause == CircleCause::ReversalSpike;
    let spike = report.circles[0].findings.iter().find(is_spike).expect("named");
    // The peak of the drawn shape is 0.72 of its height, 0.24 decays behind the reversal.
    let height = value(spike, "height_positive_end_ccw_um");
    assert!((height - 0.716 * 8.0).abs() < 0.7, "{spike:?}");
    assert!((1.5..4.0).contains(&value(spike, "width_deg")), "{spike:?}");
}

#[test]
fn what_is_written_leaves_a_clean_circle() {
    let faults = vec![
        CircleFault::Squareness(-70.0),
        CircleFault::Play(0, 6.0),
        CircleFault::Cyclic(1, 2.0, 8.0, 1.0),
    ];
    let drawn = Drawn { noise_um: 0.3, setup_um: [5.0, -9.0, 3.0], ..Drawn::ideal(faults, 100.0) };
    let before = report(&drawn);
    let machine = machine(&before);
    let after = analyse_circles(&[run(&drawn.csv())], Some(&machine)).expect("a circle");
    assert_eq!(after.verdict, CircleVerdict::Clean, "{:?}", named(&after));
    assert!(after.circles[0].before.rms_um < 0.4, "{:?}", after.circles[0].before);
}

#[test]
fn one_direction_claims_neither_squareness_nor_servo_mismatch() {
    for fault in [CircleFault::Squareness(80.0), CircleFault::Servo(0.4)] {
        let drawn = Drawn { senses: vec![1.0], ..Drawn::ideal(vec![fault], 100.0) };
        let report = report(&drawn);
        let found = &report.circles[0].findings[0];
        assert!(!found.claimed && report.edit.is_empty(), "{found:?}");
        assert_eq!(found.alternatives, ["servo-mismatch"]);
        assert!(found.next_test.contains("other direction"), "{found:?}");
        assert_eq!(report.verdict, CircleVerdict::Unexplained);
    }
}

#[test]
fn the_figures_of_iso_230_4_are_those_by_hand() {
    // sin 2φ of 5 µm: G and G(b) 10 µm, no hysteresis; play of 8 µm in Y: a step of 8 µm between the directions.
    let square =
        report(&Drawn::ideal(vec![CircleFault::Squareness(100.0)], 100.0)).circles[0].figures;
    for um in [square.g_um[0], square.g_um[1], square.g_both_um] {
        assert!((um.expect("a whole circle") - 10.0).abs() < 0.2, "{square:?}");
    }
    assert!(square.h_um.expect("both directions") < 0.1, "{square:?}");
    let play = report(&Drawn::ideal(vec![CircleFault::Play(1, 8.0)], 100.0)).circles[0].figures;
    assert!((play.h_um.expect("both directions") - 8.0).abs() < 0.2, "{play:?}");
    let large = Drawn { setup_um: [4.0, 0.0, 0.0], ..Drawn::ideal(Vec::new(), 100.0) };
    let large = report(&large).circles[0].figures;
    assert!((large.d_um.expect("both directions") - 4.0).abs() < 0.02, "{large:?}");
    assert!(large.f_min_um[0].is_some_and(|um| um > 3.9), "{large:?}");
}

#[test]
fn a_bridge_that_was_on_is_taken_out_along_the_radius() {
    let drawn = Drawn::ideal(vec![CircleFault::Squareness(100.0)], 100.0);
    let mut with = String::new();
    for (number, line) in drawn.csv().lines().enumerate() {
        if number == 0 {
            with += &format!("{line},offset_x_um,offset_y_um,quality\n");
            continue;
        }
        let mut cells: Vec<f64> =
            line.split(',').map(|cell| cell.parse().expect("a number")).collect();
        // The bridge takes the whole error off: the ball bar sees a perfect circle.
        let [x, y] = [cells[1] - 20.0, cells[2] + 35.0];
        let offset = -100.0 * cells[2] / 1e3;
        cells[4] += offset * x / x.hypot(y);
        let cells: Vec<String> = cells.iter().map(f64::to_string).collect();
        with += &format!("{},{offset},0,1\n", cells.join(","));
    }
    let report = analyse_circles(&[run(&with)], None).expect("a circle");
    assert!((value(only(&report), "um_per_m") - 100.0).abs() < 0.5);
}

#[test]
fn two_files_in_two_planes_share_one_backlash_and_their_scales() {
    let drawn = Drawn::ideal(vec![CircleFault::Play(0, 6.0), CircleFault::Scale(80.0)], 100.0);
    let xy = drawn.csv();
    // The same circle with X as the second axis of ZX: Z is the first, and does not err.
    let zx = Drawn::ideal(vec![CircleFault::Play(1, 6.0), CircleFault::Scale(-80.0)], 100.0).csv();
    let zx = zx.replacen("x_mm,y_mm", "z_mm,x_mm", 1);
    let report = analyse_circles(&[run(&xy), run(&zx)], None).expect("circles");
    assert_eq!(report.circles.len(), 2);
    let axes = machine(&report).axes;
    assert!((axes[0].backlash.expect("of X").width_um - 6.0).abs() < 0.05, "{:?}", axes[0]);
    let end = |axis: usize| {
        axes[axis].pitch.as_ref().map(|pitch| *pitch.forward_um.last().expect("ends"))
    };
    // X is 80 µm/m longer than Y and than Z: their mean stays, X +53.3, Y and Z −26.7 µm/m.
    let [x, y, z] = [0, 1, 2].map(|axis| end(axis).expect("a table"));
    assert!((y + 2.67).abs() < 0.1 && (z + 2.67).abs() < 0.1 && x > 5.0, "{x} {y} {z}");
}

#[test]
fn two_circles_in_one_plane_write_their_squareness_once() {
    let at = |centre_mm| Drawn {
        centre_mm,
        ..Drawn::ideal(vec![CircleFault::Squareness(100.0)], 100.0)
    };
    let runs = [at([20.0, -35.0]), at([320.0, 65.0])].map(|drawn| run(&drawn.csv()));
    let report = analyse_circles(&runs, None).expect("circles");
    assert_eq!(report.circles.len(), 2);
    let squareness = &machine(&report).squareness;
    assert!((squareness[0].um_per_m - 100.0).abs() < 0.5, "{squareness:?}");
}

/// Returns how many of the drawn machines are wholly named, and how many have a wrong name; prints each that is not.
fn trial(seeds: std::ops::Range<u64>, is_sound: bool) -> [usize; 2] {
    let mut counts = [0, 0];
    for seed in seeds {
        let drawn = Drawn::new(seed, is_sound);
        let report = report(&drawn);
        let expected: BTreeSet<String> = drawn.faults.iter().map(CircleFault::name).collect();
        let named = named(&report);
        counts[0] += usize::from(named == expected);
        counts[1] += usize::from(!named.is_subset(&expected));
        if named != expected {
            println!("seed {seed}: {:?}, named {named:?}", drawn.faults);
        }
    }
    counts
}

#[test]
fn drawn_circles_are_wholly_named_and_sound_ones_have_no_name() {
    let [named, wrong] = trial(5_000..5_008, false);
    assert!(named >= 7 && wrong <= 1, "{named} of 8, {wrong} wrong");
    let [sound, wrong] = trial(6_000..6_003, true);
    assert_eq!([sound, wrong], [3, 0]);
}

#[test]
#[ignore = "campaign: cargo xtask circles"]
fn campaign_300_drawn_circles_and_100_sound_ones() {
    let count = std::env::var("TRUEUP_CIRCLES").ok().and_then(|text| text.parse().ok());
    let count: u64 = count.unwrap_or(300);
    let [named, wrong] = trial(0..count, false);
    let sound_count = count.div_ceil(3);
    let [sound, false_names] = trial(100_000..100_000 + sound_count, true);
    println!(
        "{named} of {count} drawn circles wholly named, {wrong} with a wrong name; {sound} of {sound_count} sound ones clean, \
         {false_names} with a wrong name"
    );
    assert!(named as f64 >= 0.95 * count as f64 && false_names == 0);
}
