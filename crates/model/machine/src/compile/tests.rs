use std::path::Path;

use trueup_core::{
    calibration::{self, STRAIGHTNESS_AXIS_PAIRS},
    displacement_sensor::{SensorLaw, SensorSlope},
    kinematics::RotaryAxis,
    learned_changes::LearnedLimits,
    tool_direction::ToolDirection,
    units::{Nanometres, Position, SensorReading, Temperature},
};

use super::{inputs::compile_linear_thermometer, *};
use crate::{MachineFile, inputs::SensorInput, sections::SensorModel, unit_conversion::NM_PER_UM};

/// Returns the paper's machine file with `from` replaced by `to`, behind a divider that takes its 10 V to the
/// converter's 3.3: a code is 8 counts there, and all numbers are whole.
fn paper_but(from: &str, to: &str) -> Machine {
    let text = include_str!("../../../../../data/paper_spindle.toml");
    let text = &text.replace("divider = 0.328", "divider = 0.33");
    assert!(text.contains(from), "{from} is not in the paper's machine file");
    MachineFile::parse(&text.replace(from, to), Path::new("paper.toml"))
        .expect("the changed file is right by itself")
}

fn paper() -> Machine {
    paper_but("", "")
}

#[test]
fn the_papers_constants_are_exact_in_the_boards_integers() {
    let compiled = compile(&paper()).expect("the paper's sensor fits");
    // 500 000 nm over 2²² reading units, times 2²⁸.
    assert_eq!(compiled.calibration().spindle.sensor.slope, SensorSlope(32_000_000));
    assert_eq!(compiled.calibration().spindle.sensor.zero, SensorReading(5048 * 128));
    assert_eq!(compiled.calibration().spindle.sensor.k0, Nanometres(0));
    assert_eq!(compiled.calibration().kinematics.zero, ToolDirection::DOWN);
    assert!(compiled.largest_difference_nm < 1e-9);
}

/// 10 V are 3.28 of 3.3 V, 0.99394 of 2²² reading units: 500 000 nm over this many, times 2²⁸, are
/// 32 195 121.95; 5048 of 32768 counts are 642 227.98 units.
#[test]
fn behind_the_divider_of_the_wiring_the_constants_are_the_nearest_integers() {
    let text = include_str!("../../../../../data/paper_spindle.toml");
    let machine =
        MachineFile::parse(text, Path::new("paper.toml")).expect("the project's own file");
    let compiled = compile(&machine).expect("the paper's sensor fits");
    let sensor = compiled.calibration().spindle.sensor;
    assert_eq!((sensor.slope, sensor.zero), (SensorSlope(32_195_122), SensorReading(642_228)));
    // 0.05 of the slope's unit over the whole range, 0.8 pm; 0.02 of the zero's, 2.4 pm.
    assert!(compiled.largest_difference_nm < 0.01, "{}", compiled.largest_difference_nm);
}

#[test]
fn the_board_is_within_half_a_nanometre_of_the_papers_model_at_every_count() {
    let machine = paper();
    let law = compile(&machine).expect("the paper's sensor fits").calibration().spindle.sensor;
    let input = machine.inputs.as_ref().and_then(|inputs| inputs.sensor).expect("the paper's");
    for counts in (0..=32_768).map(f64::from) {
        let board = f64::from(law.elongation(input.reading_from_counts(counts)).0);
        let difference = board - machine.elongation_um(counts) * NM_PER_UM;
        assert!(difference.abs() <= 0.5, "{counts} counts: {difference} nm");
    }
}

#[test]
fn the_limits_arrive_in_nanometres_and_milliseconds() {
    let limits = compile(&paper()).expect("the paper's sensor fits").calibration().limits;
    assert_eq!(limits.max, [200_000, 200_000, 500_000].map(Nanometres));
    assert_eq!(limits.slew_nm_per_s, 20_000);
    assert_eq!((limits.link_timeout_ms, limits.hold_ms), (500, 2000));
}

#[test]
fn a_direction_has_length_one_within_two_of_its_units() {
    let machine = paper_but("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [1, -2, 3]");
    let ToolDirection(v) =
        compile(&machine).expect("a direction always fits").calibration().kinematics.zero;
    let length = v.iter().map(|&c| f64::from(c) * f64::from(c)).sum::<f64>().sqrt();
    assert!((length - f64::from(ToolDirection::ONE)).abs() < 2.0);
    assert!(v[0] > 0 && v[1] < 0 && v[2] > 0);
}

#[test]
fn without_a_source_the_law_is_zero_and_no_input_is_needed() {
    let machine =
        MachineFile::parse("[machine]\nname = \"mill\"\nkind = \"3-axis\"\n", Path::new("m.toml"))
            .expect("the shortest machine file");
    let compiled = compile(&machine).expect("nothing to fit");
    assert_eq!(compiled.calibration().spindle.sensor, SensorLaw::default());
}

#[test]
fn a_law_of_the_sensor_is_on_the_board_as_the_source_or_where_a_sensor_is_connected() {
    let warmup =
        "source = \"warmup\"\nwarmup = { lag_s = 0, warm_s = 9, max_um = 80, exponent = 4 }";
    let input = "sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }";
    let source = "source = \"sensor\"";
    let mut unconnected = paper_but(source, warmup);
    unconnected.inputs = None;
    for (machine, is_on_board) in [
        (paper(), true),
        (paper_but(source, warmup), true),
        (unconnected, false),
        (paper_but(&format!("[inputs]\n{input}"), ""), true),
        (paper_but(source, ""), false),
    ] {
        assert_eq!(machine.board_sensor_model().is_some(), is_on_board);
        // Without an input the board cannot run it as the source, and says so.
        let Ok(compiled) = compile(&machine) else { continue };
        let law = compiled.calibration().spindle.sensor;
        assert_eq!(law != SensorLaw::default(), is_on_board);
    }
}

#[test]
fn a_sensor_whose_growth_lowers_the_reading_has_a_negative_slope() {
    let machine = paper_but("um_per_count = 0.0152587890625", "um_per_count = -0.0152587890625");
    let law = compile(&machine).expect("fits").calibration().spindle.sensor;
    assert_eq!(law.slope, SensorSlope(-32_000_000));
    let reading = 128.0 * (5048.0 - 1000.0);
    assert!((exact_elongation_nm(&law, reading) - 15_258.789_062_5).abs() < 1e-9);
}

/// Any calibration that the zero reading in range and a slope within the format allow.
#[test]
fn the_stored_law_is_within_0_51_nm_of_the_model_for_any_sensor_with_its_zero_in_range() {
    let mut machine = paper();
    let mut seed = 0x2545_f491_4f6c_dd1d_u64;
    let mut uniform = |from: f64, to: f64| {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        from + (to - from) * (seed >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut worst: f64 = 0.0;
    for _ in 0..200_000 {
        let counts_full_scale = uniform(1000.0, 70_000.0).round();
        let volts_full_scale = uniform(1.0, 20.0);
        let divider = uniform(0.3, 1.0) * 3.3 / volts_full_scale;
        let input = SensorInput { volts_full_scale, counts_full_scale, divider };
        let steepest = 7.99 * input.exact_reading_from_counts(1.0) / NM_PER_UM;
        machine.inputs.as_mut().expect("the paper's has inputs").sensor = Some(input);
        machine.spindle.sensor = Some(SensorModel {
            k0_um: uniform(-500.0, 500.0),
            zero_counts: uniform(0.0, counts_full_scale),
            um_per_count: uniform(-steepest, steepest),
            temperature: None,
        });
        let compiled = compile(&machine).expect("within every range");
        worst = worst.max(compiled.largest_difference_nm);
    }
    assert!((0.49..0.51).contains(&worst), "worst {worst} nm");
}

#[test]
fn the_difference_at_the_ends_is_the_largest_in_between() {
    let machine = paper_but("um_per_count = 0.0152587890625", "um_per_count = 0.0198");
    let compiled = compile(&machine).expect("fits");
    let input = machine.inputs.as_ref().and_then(|inputs| inputs.sensor).expect("the paper's");
    let law = &compiled.calibration().spindle.sensor;
    for counts in 0..=32_768 {
        let counts = f64::from(counts);
        let stored = exact_elongation_nm(law, input.exact_reading_from_counts(counts));
        let difference = (stored - machine.elongation_um(counts) * NM_PER_UM).abs();
        assert!(difference <= compiled.largest_difference_nm + 1e-9);
    }
}

#[test]
fn what_does_not_fit_is_refused_with_its_key_and_place() {
    let cases = [
        (
            "um_per_count = 0.0152587890625",
            "um_per_count = 1.1",
            "16:16: spindle.sensor.um_per_count 1.1 is 8.594 nm",
        ),
        (
            "zero_counts = 5048.0",
            "zero_counts = 2e7",
            "15:15: spindle.sensor.zero_counts 20000000 is outside what",
        ),
        (
            // The slope is 0.45 of its unit off; the distance makes that 3.4 nm.
            "zero_counts = 5048.0\num_per_count = 0.0152587890625",
            "zero_counts = 1.6e7\num_per_count = 0.0100000002146",
            "15:15: spindle.sensor.zero_counts 16000000 is so far outside",
        ),
        ("k0_um = 0.0", "k0_um = 3e6", "14:9: spindle.sensor.k0_um 3000000 is beyond"),
        (
            "k0_um = 0.0\nzero_counts = 5048.0\num_per_count = 0.0152587890625",
            "k0_um = 2147400\nzero_counts = 0.0\num_per_count = 0.0152587890625",
            "13:10: spindle.sensor gives 2147900 µm at 32768 counts",
        ),
        ("x = 200.0", "x = 4000.1", "limits.max_um.x 4000.1 is not within 0 to 4000 µm"),
        ("[limits]", "[limits]\nrejoin_um_per_s = 1.1", "limits.rejoin_um_per_s 1.1 is not within"),
        (
            "[limits]",
            "[limits]\nlearned = { growth_percent = 25.1 }",
            "limits.learned.growth_percent 25.1 is not one of 0, 0.1, … 25",
        ),
        (
            "[limits]",
            "[limits]\nlearned = { axes_percent = 0.25 }",
            "axes_percent 0.25 is not one of",
        ),
        (
            "[limits]",
            "[limits]\nlearned = { zero_um = 20.1 }",
            "zero_um 20.1 is not one of 0, 0.1, … 20",
        ),
        (
            "[limits]",
            "[thermal_state]\ncold_within_c = 5.1\n[limits]",
            "thermal_state.cold_within_c 5.1 is not within 0 to 5 °C",
        ),
        ("slew_um_per_s = 20.0", "slew_um_per_s = 0.0004", "limits.slew_um_per_s 0.0004 is not"),
        ("slew_um_per_s = 20.0", "slew_um_per_s = 5e6", "limits.slew_um_per_s 5000000 is not"),
        (
            "sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }",
            "",
            "inputs.sensor is missing",
        ),
    ];
    for (from, to, phrase) in cases {
        let error = compile(&paper_but(from, to)).expect_err(to).to_string();
        assert!(error.contains(phrase), "{to}: {error}");
    }
}

#[test]
fn every_section_reaches_the_board_and_is_accounted_for() {
    let added = "hold_ms = 2000\n\
        [axis.x]\nfeedback = \"scale\"\n\
        [axis.y]\nrapid_mm_per_min = 15000\n\
        [axis.y.backlash]\nwidth_um = 4\nramp_mm = 0.05\nhysteresis_um = 1\n\
        [axis.z.pitch]\nstart_mm = 0\nstep_mm = 100\nforward_um = [0, 1]\n\
        [squareness]\nx_of_y_um_per_m = 1\n\
        [straightness.z_of_x]\norder = 2\nknots_mm = [0, 0, 1, 1]\ncontrol_um = [0, 1]\n";
    let compiled = compile(&paper_but("hold_ms = 2000\n", added)).expect("all of it is run");
    let calibration = compiled.calibration();
    let [x, y, z] = calibration.axes;
    assert_eq!(x, calibration::AxisModel::default());
    assert_eq!(y.backlash, Nanometres(4_000).to_fine());
    assert_eq!((y.travel.hysteresis, y.travel.ramp.length()), (100, 5_000));
    // 250 µm in a millisecond.
    assert_eq!((y.rapid, z.rapid), (25_000, 0));
    let points = [0, 256_000].map(i32::to_le_bytes);
    assert_eq!(z.pitch.map(|pitch| (pitch.start, pitch.forward)), Some((Position(0), &points[..])));
    let places = STRAIGHTNESS_AXIS_PAIRS.map(|(error, along)| (error as usize, along as usize));
    for (place, pair) in places.into_iter().enumerate() {
        assert_eq!(calibration.straightness[place].is_empty(), pair != (2, 0), "{pair:?}");
        // 1 µm/m is 10⁻⁵ nm per position unit, Q36.
        let gradient = if pair == (0, 1) { 687_195 } else { 0 };
        assert_eq!(calibration.squareness[place], Gradient(gradient), "{pair:?}");
    }
    let parts: Vec<&str> = compiled.parts.iter().map(|(key, _)| key.as_str()).collect();
    let expected =
        ["spindle.sensor", "axis.z.pitch", "straightness.z_of_x", "squareness.x_of_y_um_per_m"];
    assert_eq!(parts, expected);
    let worst = compiled.parts.iter().fold(0.0, |worst: f64, (_, nm)| worst.max(*nm));
    assert_eq!(worst, compiled.largest_difference_nm);
    assert!(worst < 0.1, "{:?}", compiled.parts);
}

#[test]
fn the_axes_that_carry_the_spindle_arrive_from_the_frame_to_the_tool() {
    let head = "head-head\"\nhead_axes = [\"c\", \"a\"]\n#";
    let kinematics = compile(&paper_but("3-axis", head)).expect("fits").calibration().kinematics;
    assert_eq!(kinematics.axes, [Some(RotaryAxis::C), Some(RotaryAxis::A)]);
    let table = compile(&paper_but("3-axis", "table-table")).expect("fits");
    assert_eq!(table.calibration().kinematics.axes, [None; 2]);
}

#[test]
fn the_blob_is_what_the_board_reads() {
    let compiled = compile(&paper()).expect("the paper's sensor fits");
    assert_eq!(decode(compiled.blob()), Ok(compiled.calibration()));
}

#[test]
fn counts_of_a_linear_thermometer_are_read_to_a_tenth_of_a_millikelvin() {
    use trueup_core::thermometer::RawTemperatureReading;
    for (zero, per_c) in [(4000.0, 16.0), (-300.5, -27.3), (0.0, 0.011), (12.25, 9_999.0)] {
        let thermometer = compile_linear_thermometer(zero, per_c).expect("within the rule");
        for step in 0..=100 {
            let celsius = f64::from(step) - 20.0;
            let raw = ((zero + celsius * per_c) * 256.0).round();
            let exact_c = (raw / 256.0 - zero) / per_c;
            let Ok(read) = thermometer.convert(RawTemperatureReading(raw as i32)) else { continue };
            let off_mk = f64::from(read.0) / f64::from(4_096) - exact_c * 1_000.0;
            assert!(off_mk.abs() < 0.1, "{zero} {per_c}: {off_mk} mK at {celsius} °C");
        }
    }
    for (zero, per_c) in [(8_388_607.0, 0.01), (-8_388_607.0, -10_000.0)] {
        assert!(
            compile_linear_thermometer(zero, per_c).is_some(),
            "{zero} {per_c} is within the rule"
        );
    }
    for (zero, per_c) in [(0.0, 0.009), (0.0, -10_001.0), (0.0, 0.0), (8_388_608.0, 16.0)] {
        assert_eq!(compile_linear_thermometer(zero, per_c), None, "{zero} {per_c}");
    }
}

#[test]
fn the_widest_limits_of_the_board_fit() {
    let compiled = compile(&paper_but(
        "[limits]\nmax_um = { x = 200.0,",
        "[thermal_state]\ncold_within_c = 5\n[limits]\nrejoin_um_per_s = 1\n\
         learned = { growth_percent = 25, axes_percent = 7.3, zero_um = 20 }\nmax_um = { x = 4000.0,",
    ));
    let compiled = compiled.expect("fits");
    let calibration = compiled.calibration();
    assert_eq!(calibration.limits.max[0], Nanometres(4_000_000));
    assert_eq!(calibration.limits.rejoin_nm_per_s, 1_000);
    assert_eq!(calibration.limits.learned, LearnedLimits { growth: 250, axes: 73, zero: 200 });
    let without = compile(&paper_but("", "")).expect("fits").calibration().limits.learned;
    assert_eq!(without, LearnedLimits::default(), "who writes nothing lets nothing be changed");
    assert_eq!(calibration.cold_within, Temperature(5 * Temperature::PER_KELVIN));
}

#[test]
fn a_calibration_names_its_machine_and_its_board() {
    let board = "0123456789abcdef00ff0001";
    let named =
        paper_but("[machine]", &format!("[machine]\nserial = \"17 / 4\"\nboard = \"{board}\""));
    let compiled = compile(&named).expect("fits");
    let names = compiled.calibration().names;
    assert_eq!((names.machine, names.serial), (named.name.as_bytes(), &b"17 / 4"[..]));
    assert_eq!(names.board, [0x00FF_0001, 0x89AB_CDEF, 0x0123_4567]);
    let again = decompile(&compiled.calibration());
    assert_eq!(
        (&again.name, &again.serial, again.board),
        (&named.name, &named.serial, named.board)
    );
    assert!(again.to_toml().contains(&format!("board = \"{board}\"")));
}
