//! The sign of each kind of reading by errors that the hand writes: a reading that is taken the wrong way round doubles the error of the
//! machine that is corrected by it. Balls: `crates/tool/cli/tests/cli/fit.rs`.

use std::fmt::Write as _;

use trueup_fit::volume::{VolumeFitOptions, reading::Pose};

use crate::rules::{edge, file, fit, of};

const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\nchain = \"w b X Y Z t\"\n";
const STATED: VolumeFitOptions =
    VolumeFitOptions { instrument_um: Some(0.1), scale_um_per_m: Some(0.1), artefact_um: None };
/// Each axis goes too far by this.
const TOO_LONG_UM_PER_MM: f64 = 0.06;

/// Noise of 0.1 µm.
fn noise_um(of: f64) -> f64 {
    0.15 * ((of * 12.9898).sin() * 43758.5453).fract()
}

fn pose(position_mm: [f64; 3]) -> Pose {
    Pose { position_mm, angle_deg: [0.0; 3], tool_mm: 0.0 }
}

/// Measures X by a laser, with one more column that is 0, and returns by how much 400 mm are found too long.
fn by_laser_um(machine: &str, column: &str) -> f64 {
    let mut text = format!("x_mm,y_mm,z_mm,setup,{column},measured_dx_um\n");
    for n in 0..41_u8 {
        let x = 10.0 * f64::from(n);
        let um = TOO_LONG_UM_PER_MM * x + noise_um(x);
        writeln!(text, "{x},100,50,1,0,{um:.3}").expect("text");
    }
    let mut report = fit(&text, &file(machine), &STATED);
    let ends = [pose([0.0, 100.0, 50.0]), pose([400.0, 100.0, 50.0])];
    report.model.error_difference_with_std_um(&ends[0], &ends[1], [1.0, 0.0, 0.0])[0]
}

#[test]
fn an_axis_that_goes_too_far_is_positive_by_a_laser_along_it() {
    // 400 mm too long by 24 µm.
    let um = by_laser_um(MACHINE, "run");
    assert!((um - 24.0).abs() < 3.0, "{um}");
}

#[test]
fn a_term_that_the_file_has_is_not_found_again_where_another_term_lacks_its_column() {
    let known = format!(
        "{MACHINE}[inputs]\ndoor_open = {{ kind = \"condition\", bit = 0 }}\n\
         [[term]]\ncause = \"pitch-scale\"\nquantity = \"dx\"\num_per_m = 60.0\n\
         [[term]]\ncause = \"dependence\"\nquantity = \"dx\"\ncolumn = \"door_open\"\nform = \"level\"\n\
         levels = [0.0, 1.0]\nlevel_um = [0.0, 5.0]\n"
    );
    for column in ["run", "door_open"] {
        let um = by_laser_um(&known, column);
        assert!(um.abs() < 3.0, "{um} with {column}");
    }
}

#[test]
fn axes_that_go_too_far_are_positive_by_step_diagonals() {
    const TRAVEL_MM: [f64; 3] = [400.0, 300.0, 300.0];
    const STEPS: u8 = 8;
    let mut text = String::from("x_mm,y_mm,z_mm,setup,measured_diagonal_um\n");
    for setup in 0..4 {
        let mm = |n: usize, done: u8| {
            let share = f64::from(done) / f64::from(STEPS);
            TRAVEL_MM[n] * if n + 1 == setup { 1.0 - share } else { share }
        };
        let way = [0, 1, 2].map(|n| mm(n, STEPS) - mm(n, 0));
        let length = way.iter().map(|mm| mm * mm).sum::<f64>().sqrt();
        for row in 0..=3 * STEPS {
            let [x, y, z] = [0, 1, 2].map(|n| mm(n, (row + 2 - n as u8) / 3));
            let along = (x * way[0] + y * way[1] + z * way[2]) / length;
            let um = TOO_LONG_UM_PER_MM * along + noise_um(along + f64::from(row));
            writeln!(text, "{x},{y},{z},{setup},{um:.3}").expect("text");
        }
    }
    let mut report = fit(&text, &file(MACHINE), &STATED);
    let length = TRAVEL_MM.iter().map(|mm| mm * mm).sum::<f64>().sqrt();
    let toward = TRAVEL_MM.map(|mm| mm / length);
    let [um, _] =
        report.model.error_difference_with_std_um(&pose([0.0; 3]), &pose(TRAVEL_MM), toward);
    // 583 mm too long by 35 µm.
    assert!((um - TOO_LONG_UM_PER_MM * length).abs() < 5.0, "{um}");
}

#[test]
fn x_that_leans_with_y_is_a_positive_squareness_by_a_circle() {
    let mut text = String::from("x_mm,y_mm,z_mm,setup,run,dir,measured_dr_um\n");
    for sense in [1.0, -1.0] {
        for n in 0..180_u8 {
            let angle = sense * std::f64::consts::TAU * f64::from(n) / 180.0 + 0.01;
            let (sin, cos) = angle.sin_cos();
            let [x, y] = [300.0 + 200.0 * cos, 300.0 + 200.0 * sin];
            // 80 µm/m: X is off by 0.08 µm for 1 mm of Y.
            let um = 0.08 * y * cos + noise_um(angle);
            writeln!(text, "{x},{y},100,1,1,{sense},{um:.3}").expect("text");
        }
    }
    let report = fit(&text, &file(MACHINE), &STATED);
    let squareness = of(&report, "EC0Y");
    assert!((squareness.size - 80.0).abs() < 25.0, "{squareness:?}");
}

#[test]
fn a_roll_of_x_that_lifts_the_tip_on_the_side_of_plus_y_is_positive_by_a_gauge() {
    let options = VolumeFitOptions { scale_um_per_m: None, ..STATED };
    let report = fit(&edge(6.0, 40.0, true), &file(MACHINE), &options);
    let curve = &of(&report, "EAX").curve;
    let at = |place: usize| curve[place][1];
    // Of 40·(s³ − s) µrad, s from −1 to 1, this is 60 µrad; of a line, which is the alignment of the edge, 0.
    let urad = at(20) - at(0) - 2.0 * (at(15) - at(5));
    assert!((urad - 60.0).abs() < 20.0, "{urad}");
}
