//! A machine with everything, row by row: the bridge's side is the model's to 10 nm, and both have
//! the signs that the hand finds.

use std::{fmt::Write as _, path::Path};

use trueup_machine::{
    MachineFile, RunFile,
    predict::{RowPrediction, RunPredictor},
};

const GANTRY: &str = include_str!("../../../../data/gantry.toml");

fn predictions(machine: &str, run: &str) -> Vec<RowPrediction> {
    let machine = MachineFile::parse(machine, Path::new("m.toml")).expect("the test's own machine");
    let run = RunFile::from_reader(run.as_bytes(), Path::new("r.csv")).expect("the test's own run");
    let predictor = RunPredictor::new(&machine, &run).expect("can be predicted");
    assert!(predictor.missing_columns().is_empty(), "{:?}", predictor.missing_columns());
    predictor.predictions().collect()
}

/// Both sides are within `nm` of each other and of what the hand finds.
fn assert_error(prediction: &RowPrediction, expected_um: [f64; 3], nm: f64) {
    let bridge = prediction.bridge.expect("there is a bridge");
    for (axis, expected) in expected_um.into_iter().enumerate() {
        let (model, board) = (prediction.model.error_um[axis], bridge.error_um[axis]);
        assert!((model - expected).abs() < 1e-3 * nm, "model {model} is not {expected}");
        assert!((board - expected).abs() < 1e-3 * nm, "board {board} is not {expected}");
    }
}

fn mill(sections: &str) -> String {
    format!("[machine]\nname = \"mill\"\nkind = \"3-axis\"\n{sections}")
}

#[test]
fn the_bridge_is_within_10_nm_of_the_model_on_a_day_of_the_gantry() {
    let mut run = String::from(
        "time_s,sensor_counts,spindle_rpm,temp_screw_c,temp_beam_c,temp_front_c,x_mm,y_mm,z_mm,\
         a_deg,c_deg,dir_x,dir_y,dir_z\n",
    );
    let mut seed = 1_u64;
    let mut random = |low: f64, high: f64| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * (seed >> 11) as f64 / (1_u64 << 53) as f64
    };
    for row in 0..20_000 {
        let mut number = |low, high| random(low, high);
        let sign = |value: f64| if value < 0.0 { -1 } else { 1 };
        writeln!(
            run,
            "{},{},24000,{},{},{},{},{},{},{},{},{},{},{}",
            f64::from(row) * 4.3,
            number(0.0, 32_768.0),
            number(15.0, 42.0),
            number(5.0, 45.0),
            number(15.0, 60.0),
            number(-100.0, 14_400.0),
            number(-100.0, 3_100.0),
            number(-100.0, 2_600.0),
            number(-110.0, 110.0),
            number(-260.0, 260.0),
            sign(number(-1.0, 1.0)),
            sign(number(-1.0, 1.0)),
            sign(number(-1.0, 1.0)),
        )
        .expect("a String can be written");
    }
    let worst = predictions(GANTRY, &run)
        .iter()
        .map(|prediction| prediction.arithmetic_error_nm().expect("there is a bridge"))
        .fold(0.0, f64::max);
    println!("largest difference of the bridge from the model: {worst:.3} nm");
    assert!(worst <= 10.0, "{worst} nm");
}

#[test]
fn the_worked_axis_of_the_paper() {
    let axis = mill(
        "[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_screw_c\"\nreference_c = 23\n\
         slope_um_per_m_per_c = 14.21\n",
    );
    // (42 − 23)·14.21 µm/m at 1 m, and at 5 m below the reference: the axis has shrunk.
    let rows = predictions(&axis, "temp_screw_c,x_mm\n42,1000\n22.9375,5000\n23,5000\n");
    assert_error(&rows[0], [269.99, 0.0, 0.0], 1.0);
    assert_error(&rows[1], [-14.21 / 16.0 * 5.0, 0.0, 0.0], 1.0);
    assert_error(&rows[2], [0.0; 3], 1.0);
}

#[test]
fn the_papers_three_kinds_are_a_constant_a_slope_and_both() {
    // 19 K: 2 µm/K make 38 µm; 10 µm/m·K make 190 µm/m, and 2.5 m are 2 m from the reference position.
    for (mode, um) in [("constant", 38.0), ("position", 380.0), ("both", 418.0)] {
        let axis = mill(&format!(
            "[axis.x.thermal]\nmode = \"{mode}\"\nsensor = \"temp_screw_c\"\nreference_c = 20\n\
             constant_um_per_c = 2\nslope_um_per_m_per_c = 10\norigin_mm = 500\n"
        ));
        let rows = predictions(&axis, "temp_screw_c,x_mm\n39,2500\n20,2500\n");
        assert_error(&rows[0], [um, 0.0, 0.0], 1.0);
        assert_error(&rows[1], [0.0; 3], 1.0);
    }
}

#[test]
fn constant_and_slope_are_functions_of_the_temperature_each_by_a_table() {
    // The paper's T-TC curve as two points, with a constant that bends at 30 °C.
    let axis = mill(
        "[axis.x.thermal]\nmode = \"both\"\nsensor = \"temp_screw_c\"\norigin_mm = 500\n\
         table = [[23.0, 0.0, 0.0], [30.0, 7.0, 99.47], [42.0, 1.0, 270.0]]\n",
    );
    let rows = predictions(&axis, "temp_screw_c,x_mm\n26.5,1500\n36,2500\n42,500\n50,1500\n");
    assert_error(&rows[0], [3.5 + 49.735, 0.0, 0.0], 1.0);
    assert_error(&rows[1], [4.0 + 2.0 * (99.47 + 270.0) / 2.0, 0.0, 0.0], 1.0);
    assert_error(&rows[2], [1.0, 0.0, 0.0], 1.0);
    assert_error(&rows[3], [271.0, 0.0, 0.0], 1.0);
}

#[test]
fn the_more_points_a_table_has_the_less_it_leaves() {
    // A screw's error of two waves over 1 m, as tables of 5, 10, 20 and 40 sections.
    let error_um = |mm: f64| 10.0 * (mm / 80.0).sin() + 4.0 * (mm / 45.0).cos();
    let left_um = [5, 10, 20, 40].map(|sections: u32| {
        let step_mm = 1_000.0 / f64::from(sections);
        let points: Vec<f64> = (0..=sections).map(|n| error_um(f64::from(n) * step_mm)).collect();
        let axis = mill(&format!(
            "[axis.x.pitch]\nstart_mm = 0\nstep_mm = {step_mm:?}\nforward_um = {points:?}\n"
        ));
        let mut run = String::from("x_mm\n");
        (0..=500).for_each(|n| writeln!(run, "{}", 2 * n).expect("a String can be written"));
        let rows = predictions(&axis, &run);
        let each = rows
            .iter()
            .enumerate()
            .map(|(n, row)| (row.model.error_um[0] - error_um(2.0 * n as f64)).abs());
        each.fold(0.0, f64::max)
    });
    println!("left by 5, 10, 20 and 40 sections: {left_um:.2?} µm");
    assert!(left_um.windows(2).all(|pair| pair[1] < 0.7 * pair[0]), "{left_um:.2?}");

    assert!(left_um[3] < 0.3);
}

#[test]
fn five_metres_of_axis_grow_by_fifty_micrometres_a_kelvin() {
    let axis = mill(
        "[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_screw_c\"\nreference_c = 20\n\
         slope_um_per_m_per_c = 10\n",
    );
    let rows = predictions(&axis, "temp_screw_c,x_mm\n21,5000\n");
    assert_error(&rows[0], [50.0, 0.0, 0.0], 1.0);
}

#[test]
fn ten_volts_of_the_papers_sensor_are_500_micrometres() {
    let text = include_str!("../../../../data/paper_spindle.toml");
    let machine = MachineFile::parse(text, Path::new("m.toml")).expect("ours");
    let input = machine.inputs.and_then(|inputs| inputs.sensor).expect("a sensor");
    assert_eq!([0.0, 32_768.0].map(|counts| input.volts_from_counts(counts)), [0.0, 10.0]);
    // 5048 counts, 77.026 µm, are the zero; a tool that grows goes down.
    let rows = predictions(text, "sensor_counts\n0\n32768\n");
    assert_error(&rows[0], [0.0, 0.0, 77.026_367_187_5], 1.0);
    assert_error(&rows[1], [0.0, 0.0, 77.026_367_187_5 - 500.0], 1.0);
}

#[test]
fn pitch_by_direction_and_backlash_where_it_is_approached_from_above() {
    let axes = mill(
        "[axis.x.pitch]\nstart_mm = 0\nstep_mm = 10\nforward_um = [0, -1, 1]\n\
         reverse_um = [2, 1, 3]\n[axis.y.backlash]\nwidth_um = 4\n",
    );
    let rows = predictions(
        &axes,
        "x_mm,y_mm,dir_x,dir_y\n10,0,1,1\n15,0,1,-1\n15,0,-1,1\n99,7,-1,-1\n-5,0,,\n",
    );
    // 10 mm commanded and 9.999 moved is −1 µm.
    assert_error(&rows[0], [-1.0, 0.0, 0.0], 1.0);
    assert_error(&rows[1], [0.0, 4.0, 0.0], 1.0);
    assert_error(&rows[2], [2.0, 0.0, 0.0], 1.0);
    assert_error(&rows[3], [3.0, 4.0, 0.0], 1.0);
    assert_error(&rows[4], [0.0; 3], 1.0);
}

#[test]
fn straightness_and_squareness_are_laid_across() {
    let guides = mill(
        "[straightness.x_of_y]\norder = 2\nknots_mm = [0, 0, 100, 100]\ncontrol_um = [0, 10]\n\
         [straightness.x_of_z]\norder = 2\nknots_mm = [0, 0, 100, 100]\ncontrol_um = [1, 3]\n\
         [straightness.z_of_x]\norder = 2\nknots_mm = [0, 0, 100, 100]\ncontrol_um = [0, -8]\n\
         [squareness]\nx_of_y_um_per_m = 20\n",
    );
    let rows = predictions(&guides, "x_mm,y_mm,z_mm\n50,50,50\n200,-50,50\n");
    // Δx = δx(y) + δx(z) + 20 µm/m·0.05 m, Δz = δz(x).
    assert_error(&rows[0], [5.0 + 2.0 + 1.0, 0.0, -4.0], 1.0);
    // The ends are held; squareness goes on.
    assert_error(&rows[1], [0.0 + 2.0 - 1.0, 0.0, -8.0], 1.0);
}

#[test]
fn a_tilted_head_lays_growth_along_the_tool() {
    let head = "[machine]\nname = \"five\"\nkind = \"head-table\"\nhead_axes = [\"a\"]\n[spindle]\n\
                source = \"temperature\"\n[spindle.temperature]\nsensor = \"temp_front_c\"\n\
                reference_c = 20\nk_um_per_c = 10\n";
    // 50 K are 0.5 mm; at A = +30° the error is (0, +0.250, −0.433) mm.
    let rows = predictions(head, "temp_front_c,a_deg\n70,30\n");
    assert_error(&rows[0], [0.0, 250.0, -433.012_701_892], 1.0);
}

#[test]
fn the_warm_up_is_the_closed_form_at_any_spacing_of_rows() {
    let spindle = mill(
        "[spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 60\nwarm_s = 5400\nmax_um = 80\n\
         exponent = 4\n",
    );
    let rows = predictions(&spindle, "time_s\n0\n60\n90\n2730\n5400\n9000\n");
    let closed = |t: f64| {
        let u = ((t - 60.0) / 5340.0).clamp(0.0, 1.0);
        80.0 * (1.0 - (-4.0 * u).exp()) / (1.0 - (-4.0_f64).exp())
    };
    for (prediction, t) in rows.iter().zip([0.0, 60.0, 90.0, 2730.0, 5400.0, 9000.0]) {
        assert_error(prediction, [0.0, 0.0, -closed(t)], 5.0);
    }
}

#[test]
fn what_a_run_does_not_have_leaves_only_its_own_quantities_empty() {
    let text = mill(
        "[spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 60\nwarm_s = 5400\nmax_um = 80\n\
         exponent = 4\n[axis.x.pitch]\nstart_mm = 0\nstep_mm = 10\nforward_um = [0, 1]\n",
    );
    let machine = MachineFile::parse(&text, Path::new("m.toml")).expect("right");
    let read = |run: &str| RunFile::from_reader(run.as_bytes(), Path::new("r.csv")).expect("right");
    let run = read("time_s,measured_elongation_um\n0,0\n5400,80\n");
    let predictor = RunPredictor::new(&machine, &run).expect("the elongation can be predicted");
    assert_eq!(predictor.missing_columns(), ["x_mm"]);
    let last = predictor.predictions().last().expect("two rows");
    assert!((last.model.elongation_um - 80.0).abs() < 1e-9 && last.model.error_um[0].is_nan());
    let bridge = last.bridge.expect("there is a bridge");
    assert!((bridge.elongation_um - 80.0).abs() < 1e-3 && bridge.error_um[0].is_nan());
    let run = read("load_n\n1\n");
    let error = RunPredictor::new(&machine, &run).expect_err("nothing can be predicted");
    assert_eq!(error.to_string(), "r.csv:1:1: column time_s is missing; there are load_n");
}
