use super::*;
use trueup_core::calibration::MainsFrequency;

use crate::inputs::{CountScale, LinearInput, TemperatureInput, TemperatureInputKind};

fn parse(source: &str) -> Machine {
    MachineFile::parse(source, Path::new("m.toml")).expect("the test's own text is right")
}

const SHORTEST: &str = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n";

#[test]
fn missing_keys_have_the_documented_defaults() {
    let machine = parse(SHORTEST);
    assert_eq!(machine.name, "mill");
    assert_eq!(machine.kind, MachineKind::ThreeAxis);
    assert_eq!(machine.tool_direction, [0.0, 0.0, -1.0]);
    assert_eq!(machine.inputs, None);
    assert_eq!(machine.spindle, Spindle::default());
    assert_eq!(machine.limits.max_um, [200.0, 200.0, 500.0]);
    assert_eq!(machine.limits.slew_um_per_s, 20.0);
    assert_eq!(machine.limits.link_timeout_ms, 500);
    assert_eq!(machine.limits.hold_ms, 2000);
}

#[test]
fn a_scenario_is_described_in_one_sentence() {
    let source = "name = \"warm-up\"\nmeasure = [\"dx\"]\ninterval_s = 20.0\n[sensor]\n";
    let error = MachineFile::parse(source, Path::new("s.toml")).expect_err("another kind of file");
    let message = error.to_string();
    assert_eq!(
        message,
        "s.toml:2:11: measure is a key of a scenario, and this is read as a machine file"
    );
    assert!(error.help.is_some_and(|help| help.contains("trueup simulate")));
}

#[test]
fn every_key_that_is_run_arrives_in_its_field() {
    let machine = parse(
        r#"
        [machine]
        name = "gantry"
        kind = "3-axis"
        head_axes = []
        tool_direction = [0, 3, -4]
        [inputs]
        sensor = { volts_full_scale = 5, counts_full_scale = 27_648, divider = 0.66 }
        temp_screw_c = { channel = 0, kind = "pt100" }
        temp_coil_c = { channel = 3, kind = "linear", zero_counts = 4000, counts_per_c = 16 }
        [spindle]
        source = "sensor"
        [spindle.sensor]
        k0_um = -1.5
        zero_counts = 5048.0
        um_per_count = -0.015
        temperature = "temp_coil_c"
        [limits]
        max_um = { z = 60 }
        slew_um_per_s = 5.5
        link_timeout_ms = 250
        hold_ms = 0
        "#,
    );
    assert_eq!(machine.tool_direction, [0.0, 0.6, -0.8]);
    let inputs = machine.inputs.expect("written above");
    let sensor = inputs.sensor.expect("written above");
    assert_eq!(sensor.volts_full_scale, 5.0);
    assert_eq!(sensor.counts_full_scale, 27648.0);
    assert_eq!(sensor.divider, 0.66);
    let pt100 =
        TemperatureInput { channel: 0, kind: TemperatureInputKind::Pt100, max_c_per_min: None };
    let kind = TemperatureInputKind::Linear(LinearInput {
        zero_counts: 4000.0,
        counts_per_c: 16.0,
        scale: CountScale::Code,
    });
    let linear = TemperatureInput { channel: 3, kind, max_c_per_min: None };
    assert_eq!(inputs.temperatures["temp_screw_c"], pt100);
    assert_eq!(inputs.temperatures["temp_coil_c"], linear);
    assert_eq!(machine.spindle.source, Some(ElongationSource::Sensor));
    let model = SensorModel {
        k0_um: -1.5,
        zero_counts: 5048.0,
        um_per_count: -0.015,
        temperature: Some("temp_coil_c".into()),
    };
    assert_eq!(machine.spindle.sensor, Some(model));
    let limits = Limits {
        max_um: [200.0, 200.0, 60.0],
        slew_um_per_s: 5.5,
        link_timeout_ms: 250,
        hold_ms: 0,
        rejoin_um_per_s: 0.01,
        learned: super::LearnedChangeLimits::default(),
    };
    assert_eq!(machine.limits, limits);
}

#[test]
fn a_sensor_that_is_not_the_source_is_kept_but_not_used() {
    let text =
        format!("{SHORTEST}[spindle.sensor]\nk0_um = 0\nzero_counts = 0\num_per_count = 1\n");
    let spindle = parse(&text).spindle;
    assert_eq!(spindle.source, None);
    assert!(spindle.sensor.is_some());
}

#[test]
fn a_byte_order_mark_and_windows_line_ends_change_nothing() {
    let windows = format!("\u{feff}{}", SHORTEST.replace('\n', "\r\n"));
    assert_eq!(parse(&windows), parse(SHORTEST));
}

#[test]
fn the_tool_direction_is_normalised_however_long_it_is_written() {
    for length in ["1e-300", "2.5", "1e300"] {
        let text = format!("{SHORTEST}tool_direction = [{length}, 0.0, 0.0]\n");
        assert_eq!(parse(&text).tool_direction, [1.0, 0.0, 0.0]);
    }
}

#[test]
fn a_key_keeps_its_place_for_rules_found_broken_later() {
    let text = format!("{SHORTEST}[limits]\nmax_um = {{ x = 1.0 }}\n");
    let machine = parse(&text);
    let place = machine.places.locate("limits.max_um.x");
    assert_eq!((place.line, place.column), (5, 16));
    let place = machine.places.locate("limits.hold_ms");
    assert_eq!((place.line, place.column), (4, 2));
}

#[test]
fn what_names_a_machine_and_how_it_is_cold_is_read_and_written() {
    let text = SHORTEST
        .replace("[machine]", "[machine]\nserial = \"7\"\nboard = \"0000000000000000000000A5\"")
        + "[limits]\nrejoin_um_per_s = 0.5\n[thermal_state]\ncold_within_c = 0.25\n";
    let machine = parse(&text);
    assert_eq!((machine.serial.as_deref(), machine.board), (Some("7"), Some([0xA5, 0, 0])));
    assert_eq!((machine.limits.rejoin_um_per_s, machine.cold_within_c), (0.5, 0.25));
    let again = parse(&machine.to_toml());
    assert_eq!((&again.serial, again.board), (&machine.serial, machine.board));
    assert_eq!((again.limits, again.cold_within_c), (machine.limits, machine.cold_within_c));
    assert_eq!((parse(SHORTEST).serial, parse(SHORTEST).cold_within_c), (None, 0.5));
    for wrong in [
        "serial = \" \"",
        "board = \"00\"",
        "board = \"000000000000000000000000\"",
        "board = \"+123456789abcdef00ff0001\"",
    ] {
        let text = SHORTEST.replace("[machine]", &format!("[machine]\n{wrong}"));
        assert!(MachineFile::parse(&text, Path::new("m.toml")).is_err(), "{wrong}");
    }
    let text = format!("{SHORTEST}[thermal_state]\ncold_within_c = -0.1\n");
    assert!(MachineFile::parse(&text, Path::new("m.toml")).is_err());
}

#[test]
fn what_the_instrument_is_worth_is_read_written_and_above_zero() {
    let text = format!("{SHORTEST}[instrument]\nuncertainty_um = 0.5\n");
    let machine = parse(&text);
    assert_eq!(machine.instrument_um, Some(0.5));
    assert_eq!(parse(&machine.to_toml()).instrument_um, Some(0.5));
    assert_eq!(parse(SHORTEST).instrument_um, None);
    for wrong in ["uncertainty_um = 0.0", "uncertainty_um = -1.0", "", "uncertainty = 1.0"] {
        let text = format!("{SHORTEST}[instrument]\n{wrong}\n");
        assert!(MachineFile::parse(&text, Path::new("m.toml")).is_err(), "{wrong}");
    }
}

#[test]
fn mains_have_50_or_60_hz_and_nothing_between() {
    let inputs = |hz: &str| format!("{SHORTEST}[inputs]\nmains_hz = {hz}\n");
    for (hz, mains) in [("50", MainsFrequency::Hz50), ("60", MainsFrequency::Hz60)] {
        let machine = parse(&inputs(hz));
        assert_eq!(machine.inputs.as_ref().map(|inputs| inputs.mains), Some(mains));
        // It comes back from the file that is written.
        let again = parse(&machine.to_toml());
        assert_eq!(again.inputs.map(|inputs| inputs.mains).unwrap_or_default(), mains);
    }
    for hz in ["55", "0", "400", "\"60\""] {
        let error = MachineFile::parse(&inputs(hz), Path::new("m.toml")).expect_err(hz).to_string();
        assert!(error.contains("mains_hz"), "{error}");
    }
}

#[test]
fn the_keys_of_pairs_of_axes_stand_in_the_order_of_the_pairs() {
    for (error, along) in Straightness::AXIS_PAIRS {
        let pair = format!("{}_of_{}", error.name(), along.name());
        let spline = BSpline { order: 2, knots_mm: Vec::new(), control_um: Vec::new() };
        assert_eq!(Straightness { error, along, spline }.name(), pair);
        let squareness = Squareness { error, along, um_per_m: 0.0 };
        assert_eq!(squareness.name(), format!("{pair}_um_per_m"));
    }
    for (about, along) in AngularErrorMotion::all_axis_pairs() {
        let angular = AngularErrorMotion { about, along, angle: AngleProfile::Line(0.0) };
        assert_eq!(angular.name(), format!("e{}{}", about.name(), along.name()));
    }
}

#[test]
fn the_keys_of_a_rotary_axis_are_its_shifts_and_tilts_in_order() {
    let rotary = machine_file_keys::MACHINE_FILE_KEYS
        .iter()
        .find(|key| key.name == "rotary")
        .expect("it is there");
    let machine_file_keys::ValueType::Table(lines) = rotary.form else {
        panic!("{:?}", rotary.form)
    };
    for (axis, line) in RotaryAxis::ALL.into_iter().zip(lines) {
        let machine_file_keys::ValueType::Table(keys) = line.form else {
            panic!("{:?}", line.form)
        };
        let across = LinearAxis::ALL.into_iter().filter(|along| along.index() != axis.index());
        let shifts = across.map(|along| format!("e{}o{}_um", along.name(), axis.name()));
        let tilts = RotaryAxis::ALL.map(|about| format!("e{}o{}_urad", about.name(), axis.name()));
        let expected: Vec<_> =
            ["point_mm".to_string()].into_iter().chain(shifts).chain(tilts).collect();
        assert_eq!(keys.iter().map(|key| key.name).collect::<Vec<_>>(), expected);
    }
}
