use trueup_core::{
    calibration::ElongationSource,
    displacement_sensor::{SensorLaw, SensorSlope},
    units::{Nanometres, SensorReading},
};

use super::*;
use crate::compile::{CompiledCalibration, DECOMPILED_SENSOR_INPUT};

const PAPER: &str = include_str!("../../../../../data/paper_spindle.toml");

fn compiled(text: &str) -> CompiledCalibration {
    let machine = MachineFile::parse(text, Path::new("m.toml"));
    compile(&machine.expect("a right machine file")).expect("fits")
}

/// Behind a divider that takes the paper's 10 V to the converter's 3.3: a code is 8 counts there.
fn paper_but(from: &str, to: &str) -> CompiledCalibration {
    compiled(&PAPER.replace("divider = 0.328", "divider = 0.33").replace(from, to))
}

/// Returns a 3-axis machine of `sections`, as it is shown.
fn shown(sections: &str) -> DecompiledCalibration {
    let text = format!("[machine]\nname = \"mill\"\nkind = \"3-axis\"\n{sections}");
    decompile_to_toml(&compiled(&text).calibration())
}

fn assert_lines(shown: &DecompiledCalibration, lines: &[&str]) {
    for line in lines {
        assert!(shown.toml.lines().any(|shown| shown == *line), "{line}\n{}", shown.toml);
    }
}

#[test]
fn one_count_of_the_shown_input_is_one_code_exactly() {
    assert_eq!(DECOMPILED_SENSOR_INPUT.codes_from_counts(1.0), 1.0);
    assert_eq!(DECOMPILED_SENSOR_INPUT.exact_reading_from_counts(1.0), 1024.0);
}

#[test]
fn the_papers_calibration_is_shown_in_codes() {
    let shown = decompile_to_toml(&paper_but("", "").calibration());
    assert_eq!(shown.largest_difference_nm, Ok(0.0));
    assert_lines(
        &shown,
        &[
            "# Compiles back to the same calibration. Largest difference from the board's law: 0.000 nm",
            "tool_direction = [0.0, 0.0, -1.0]",
            "sensor = { volts_full_scale = 10.0, counts_full_scale = 4096.0, divider = 0.33 }",
            "source = \"sensor\"",
            "k0_um = 0.0",
            // 5048 counts of 1/8 code, 500 µm over 4096 codes.
            "zero_counts = 631.0",
            "um_per_count = 0.1220703125",
            "max_um = { x = 200.0, y = 200.0, z = 500.0 }",
            "slew_um_per_s = 20.0",
            "link_timeout_ms = 500",
            "hold_ms = 2000",
        ],
    );
}

#[test]
fn a_direction_is_shown_as_the_user_wrote_it() {
    let compiled =
        paper_but("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [0, 0.6, -0.8]");
    let shown = decompile_to_toml(&compiled.calibration()).toml;
    assert!(shown.contains("\ntool_direction = [0.0, 0.6, -0.8]\n"), "{shown}");
}

#[test]
fn a_laws_numbers_are_shown_as_the_user_wrote_them() {
    let shown = shown(
        r#"
        [inputs]
        temp_screw_c = { channel = 0, kind = "pt100" }
        temp_front_c = { channel = 5, kind = "linear", zero_counts = 4000, counts_per_c = 16.3 }
        [spindle]
        source = "warmup"
        [spindle.warmup]
        lag_s = 60
        warm_s = 5400
        max_um = 80
        exponent = 4
        cool_s = 2900
        rated_rpm = 24000
        speed_exponent = 2.0
        [spindle.temperature]
        sensor = "temp_front_c"
        reference_c = 20.3
        k_um_per_c = 2.1
        lag_s = 1630
        [axis.x.thermal]
        mode = "position"
        sensor = "temp_screw_c"
        reference_c = 23
        slope_um_per_m_per_c = 14.21
        origin_mm = 120.5
        lag_s = 0.5
        [axis.y]
        rapid_mm_per_min = 10000
        [axis.y.backlash]
        width_um = -4.3
        ramp_mm = 0.05
        hysteresis_um = 1.7
        [squareness]
        z_of_x_um_per_m = 12.7
        "#,
    );
    assert_lines(
        &shown,
        &[
            "temp_ch0_c = { channel = 0, kind = \"pt100\" }",
            "temp_ch5_c = { channel = 5, kind = \"linear\", zero_counts = 4000.0, counts_per_c = 16.3 }",
            "source = \"warmup\"",
            "lag_s = 60.0",
            "warm_s = 5400.0",
            "max_um = 80.0",
            "exponent = 4.0",
            "cool_s = 2900.0",
            "rated_rpm = 24000.0",
            "speed_exponent = 2.0",
            "sensor = \"temp_ch5_c\"",
            "reference_c = 20.3",
            "k_um_per_c = 2.1",
            "lag_s = 1630.0",
            "reference_c = 23.0",
            "slope_um_per_m_per_c = 14.21",
            "origin_mm = 120.5",
            "lag_s = 0.5",
            "rapid_mm_per_min = 10000.0",
            "width_um = -4.3",
            "ramp_mm = 0.05",
            "hysteresis_um = 1.7",
            "z_of_x_um_per_m = 12.7",
        ],
    );
    assert!(shown.toml.starts_with("# Compiles back to the same calibration."), "{}", shown.toml);
}

#[test]
fn a_segments_bezier_points_are_the_control_points_of_its_polynomial() {
    let shown = shown(
        "[straightness.z_of_x]\norder = 4\nknots_mm = [0, 0, 0, 0, 500, 500, 500, 500]\n\
         control_um = [0, 3, -2.5, 1]",
    );
    let line = shown.toml.lines().find_map(|line| line.strip_prefix("control_um = "));
    let points: Vec<f64> = line
        .expect("a curve is shown")
        .trim_matches(['[', ']'])
        .split(", ")
        .map(|number| number.parse().expect("a number"))
        .collect();
    for (point, expected) in points.iter().zip([0.0, 3.0, -2.5, 1.0]) {
        assert!((point - expected).abs() < 5e-5, "{points:?}");
    }
    assert_lines(&shown, &["knots_mm = [0.0, 0.0, 0.0, 0.0, 500.0, 500.0, 500.0, 500.0]"]);
    assert!(shown.largest_difference_nm.is_ok_and(|nm| nm < 0.1), "{}", shown.toml);
}

#[test]
fn without_a_source_no_input_is_shown() {
    let shown = shown("");
    assert_eq!(shown.largest_difference_nm, Ok(0.0));
    assert!(!shown.toml.contains("spindle") && !shown.toml.contains("inputs"));
}

#[test]
fn a_law_without_a_slope_is_shown_too() {
    let sensor =
        SensorLaw { k0: Nanometres(1234), zero: SensorReading(i32::MIN), slope: SensorSlope(0) };
    let paper = paper_but("", "");
    let mut calibration = paper.calibration();
    calibration.spindle.sensor = sensor;
    let shown = decompile_to_toml(&calibration);
    assert!(shown.largest_difference_nm.is_ok_and(|nm| nm < 0.01), "{}", shown.toml);
}

#[test]
fn what_no_machine_file_compiles_to_is_shown_with_the_reason() {
    let paper = paper_but("", "");
    let good = paper.calibration();
    let mut no_slew = good;
    no_slew.limits.slew_nm_per_s = 0;
    let mut no_timeout = good;
    no_timeout.limits.link_timeout_ms = 0;
    let mut other_chain = good;
    other_chain.spindle.chain[1] = Some(ElongationSource::Sensor);
    let mut too_far = good;
    too_far.spindle.sensor.k0 = Nanometres(i32::MAX);
    for (calibration, reason) in [
        (no_slew, "limits.slew_um_per_s must be above 0"),
        (no_timeout, "limits.link_timeout_ms must be from 1"),
        (other_chain, "no machine file"),
        (too_far, "beyond the board's"),
    ] {
        let shown = decompile_to_toml(&calibration);
        let error = shown.largest_difference_nm.expect_err(reason);
        assert!(error.contains(reason), "{error}");
        assert!(shown.toml.starts_with("# Does not compile back to this calibration: "));
        assert!(shown.toml.contains("[limits]"));
    }
}

#[test]
fn a_direction_that_is_too_long_comes_back_at_length_1() {
    let paper = paper_but("", "");
    let mut calibration = paper.calibration();
    calibration.kinematics.zero.0[2] -= 500;
    let shown = decompile_to_toml(&calibration);
    // 500 of 2³⁰, of a millimetre.
    let nm = shown.largest_difference_nm.expect("it compiles");
    assert!((nm - 0.4657).abs() < 1e-3, "{nm}");
    assert!(shown.toml.starts_with("# Compiles back to within 0.466 nm of the board's"));
}
