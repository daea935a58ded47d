//! The example of the format's description, whole: it is read as it stands, and the reference model
//! gives what the hand finds.

use std::path::Path;

use trueup_machine::{
    Machine, MachineFile,
    inputs::TemperatureInputKind,
    machine_file::{
        AxisModel, BSpline, Backlash, ElongationSource, Feedback, LinearAxis, MachineKind,
        PitchErrorTable, RotaryAxis, SecondDrive, SensorModel, Squareness, TemperatureModel,
        ThermalLaw, ThermalMode, ThermalRow, Warmup,
    },
    model::{ErrorComponents, ReferenceModel, RowInputs, required_columns, warmup_elongation_um},
};

const EXAMPLE: &str = r#"
[machine]
name = "gantry"
kind = "head-head"                    # or "3-axis", "table-table", "head-table"
head_axes = ["c", "a"]                # rotary axes that carry the spindle, from the frame to the tool; default []
tool_direction = [0.0, 0.0, -1.0]     # with all angles at zero; this is the default

[inputs]                              # needed to run on a board, not to predict
sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }
temp_screw_c = { channel = 0, kind = "pt100" }      # or kind = "linear", zero_counts = 4000, counts_per_c = 16

[spindle]
source = "sensor"                     # or "warmup", "temperature"; absent: no elongation
[spindle.sensor]
k0_um = 0.0
zero_counts = 5048.0
um_per_count = 0.0152587890625
temperature = "temp_coil_c"           # optional: the sensor's own temperature
[spindle.warmup]
lag_s = 60.0
warm_s = 5400.0
max_um = 80.0
exponent = 4.0
cool_s = 1335.0                       # optional, default (warm_s - lag_s)/exponent
rated_rpm = 24000.0                   # optional, with speed_exponent (default 0: any speed heats fully)
speed_exponent = 0.0
[spindle.temperature]                 # elongation = k_um_per_c * (T - reference_c)
sensor = "temp_front_c"
reference_c = 20.0
k_um_per_c = 2.0
lag_s = 0.0

[axis.x]
feedback = "screw"                    # or "scale"; backlash belongs to "screw" only
[axis.x.thermal]  # keys that the mode does not use are allowed
mode = "position"                     # or "constant", "both"
sensor = "temp_screw_c"
reference_c = 23.0
constant_um_per_c = 0.0
slope_um_per_m_per_c = 14.21
origin_mm = 0.0
lag_s = 0.0
table = [[23.0, 0.0, 0.0], [42.0, 0.0, 270.0]]   # optional: [T, K0 um, slope um/m], linear between, instead of the two constants
[axis.x.pitch]  # errors, actual minus commanded
start_mm = 0.0
step_mm = 100.0
forward_um = [0.0, 1.5, 2.0]
reverse_um = [0.5, 2.0, 2.5]          # absent: one table for both directions
[axis.y.backlash]                     # not together with a reverse table on the same axis
width_um = 4.0
ramp_mm = 0.05                        # optional
hysteresis_um = 1.0                   # optional
[axis.x.dual]                         # a gantry driven at both ends: the second drive's table, and where across the beam the two are
across = "y"
first_mm = 0.0
second_mm = 3000.0
pitch = { start_mm = 0.0, step_mm = 100.0, forward_um = [0.0, 1.0, 2.5] }

[straightness.z_of_x]  # y_of_x z_of_x z_of_y x_of_y x_of_z y_of_z
order = 4
knots_mm = [0.0, 0.0, 0.0, 0.0, 500.0, 1000.0, 1000.0, 1000.0, 1000.0]
control_um = [0.0, 3.0, -2.0, 4.0, 0.0]

[squareness]                          # optional, um per metre of the second axis: error of the first
x_of_y_um_per_m = 0.0

[limits]                              # the values are the defaults
max_um = { x = 200.0, y = 200.0, z = 500.0 }
slew_um_per_s = 20.0
link_timeout_ms = 500
hold_ms = 2000
"#;

fn parse(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).expect("the test's own machine file")
}

/// Returns a machine of `sections` and nothing else.
fn machine(sections: &str) -> Machine {
    parse(&format!("[machine]\nname = \"mill\"\nkind = \"3-axis\"\n{sections}"))
}

fn parts(machine: &Machine, situation: &RowInputs<'_>) -> ErrorComponents {
    ReferenceModel::new(machine).step(situation)
}

fn assert_near(there: f64, expected: f64) {
    assert!((there - expected).abs() < 1e-9, "{there} is not {expected}");
}

#[test]
fn every_key_of_the_example_arrives_in_its_field() {
    let machine = parse(EXAMPLE);
    assert_eq!((machine.name.as_str(), machine.kind), ("gantry", MachineKind::HeadHead));
    assert_eq!(machine.head_axes, [RotaryAxis::C, RotaryAxis::A]);
    let inputs = machine.inputs.expect("written above");
    assert_eq!(inputs.temperatures["temp_screw_c"].kind, TemperatureInputKind::Pt100);

    let spindle = machine.spindle;
    assert_eq!(spindle.source, Some(ElongationSource::Sensor));
    let sensor = SensorModel {
        k0_um: 0.0,
        zero_counts: 5048.0,
        um_per_count: 500.0 / 32768.0,
        temperature: Some("temp_coil_c".into()),
    };
    assert_eq!(spindle.sensor, Some(sensor));
    let warmup = Warmup {
        lag_s: 60.0,
        warm_s: 5400.0,
        max_um: 80.0,
        exponent: 4.0,
        cool_s: Some(1335.0),
        rated_rpm: Some(24_000.0),
        speed_exponent: 0.0,
    };
    assert_eq!(warmup.time_constant_s(), 1335.0);
    assert_eq!(spindle.warmup, Some(warmup));
    let temperature = TemperatureModel {
        sensor: "temp_front_c".into(),
        reference_c: 20.0,
        k_um_per_c: 2.0,
        lag_s: 0.0,
    };
    assert_eq!(spindle.temperature, Some(temperature));

    let row = |temperature_c, slope_um_per_m| ThermalRow {
        temperature_c,
        constant_um: 0.0,
        slope_um_per_m,
    };
    let thermal = ThermalLaw {
        mode: ThermalMode::Position,
        sensor: "temp_screw_c".into(),
        reference_c: 23.0,
        constant_um_per_c: 0.0,
        slope_um_per_m_per_c: 14.21,
        origin_mm: 0.0,
        lag_s: 0.0,
        table: Some(vec![row(23.0, 0.0), row(42.0, 270.0)]),
    };
    let pitch = |forward_um: [f64; 3], reverse_um: Option<[f64; 3]>| PitchErrorTable {
        start_mm: 0.0,
        step_mm: 100.0,
        forward_um: forward_um.to_vec(),
        reverse_um: reverse_um.map(|table| table.to_vec()),
    };
    let dual = SecondDrive {
        across: LinearAxis::Y,
        first_mm: 0.0,
        second_mm: 3000.0,
        pitch: pitch([0.0, 1.0, 2.5], None),
    };
    let x = AxisModel {
        feedback: Feedback::Screw,
        travel_mm: None,
        rapid_mm_per_min: None,
        thermal: Some(thermal),
        pitch: Some(pitch([0.0, 1.5, 2.0], Some([0.5, 2.0, 2.5]))),
        backlash: None,
        dual: Some(dual),
    };
    let backlash = Backlash { width_um: 4.0, ramp_mm: 0.05, hysteresis_um: 1.0 };
    let y = AxisModel { backlash: Some(backlash), ..AxisModel::default() };
    assert_eq!(machine.axes, [x, y, AxisModel::default()]);

    let [curve] = &machine.straightness[..] else { panic!("there is one curve") };
    assert_eq!((curve.error, curve.along), (LinearAxis::Z, LinearAxis::X));
    let spline = BSpline {
        order: 4,
        knots_mm: vec![0.0, 0.0, 0.0, 0.0, 500.0, 1000.0, 1000.0, 1000.0, 1000.0],
        control_um: vec![0.0, 3.0, -2.0, 4.0, 0.0],
    };
    assert_eq!(curve.spline, spline);
    let angle = Squareness { error: LinearAxis::X, along: LinearAxis::Y, um_per_m: 0.0 };
    assert_eq!(machine.squareness, [angle]);
}

#[test]
fn the_examples_parts_are_what_the_hand_finds() {
    let machine = parse(EXAMPLE);
    let situation = RowInputs {
        sensor_counts: 9164.0,
        temperatures_c: &[("temp_coil_c", 99.0), ("temp_screw_c", 32.5)],
        position_mm: [500.0, 750.0, 0.0],
        angle_deg: [30.0, f64::NAN, 90.0],
        direction: [-1.0, -1.0, f64::NAN],
        ..RowInputs::UNKNOWN
    };
    let parts = parts(&machine, &situation);
    let s = 62.805_175_781_25;
    assert_eq!(parts.elongation_um, s);
    // A = 30° swings the tool towards +Y, C = 90° turns that to −X.
    let expected = [-0.5, 0.0, -0.75_f64.sqrt()];
    for (axis, v) in expected.into_iter().enumerate() {
        assert_near(parts.tool_direction[axis], v);
        assert_near(parts.tool_um[axis], s * v);
    }
    // Half of the way from 23 to 42 °C is 135 µm/m, at half a metre.
    assert_eq!(parts.thermal_um, [67.5, 0.0, 0.0]);
    // Beyond both tables, backwards: 2.5 at the first drive, 2.5 at the second.
    assert_eq!(parts.pitch_um, [2.5, 0.0, 0.0]);
    assert_eq!(parts.backlash_um, [0.0, 4.0, 0.0]);
    assert_near(parts.straightness_um[2], 0.75);
    assert_eq!(parts.squareness_um, [0.0; 3]);
    let [dx, dy, dz] = parts.to_error_values().error_um;
    assert_near(dx, 67.5 + 2.5 - s / 2.0);
    assert_near(dy, 4.0);
    assert_near(dz, 0.75 - s * 0.75_f64.sqrt());
}

#[test]
fn the_columns_that_are_required_are_those_that_count() {
    let columns = |machine: &Machine| required_columns(machine).join(" ");
    assert_eq!(
        columns(&parse(EXAMPLE)),
        "sensor_counts temp_screw_c x_mm y_mm c_deg a_deg",
        "the fall-backs need nothing, and squareness of 0 needs no position"
    );
    let example = |from: &str, to: &str| parse(&EXAMPLE.replacen(from, to, 1));
    let warmup = example("source = \"sensor\"", "source = \"warmup\"");
    assert_eq!(columns(&warmup), "time_s temp_screw_c x_mm y_mm c_deg a_deg");
    let temperature = example("source = \"sensor\"", "source = \"temperature\"");
    assert_eq!(columns(&temperature), "temp_front_c temp_screw_c x_mm y_mm c_deg a_deg");
    let none = example("source = \"sensor\"", "");
    assert_eq!(columns(&none), "temp_screw_c x_mm y_mm");
    let lagging = example("origin_mm = 0.0\nlag_s = 0.0", "lag_s = 5.0");
    assert_eq!(columns(&lagging), "time_s sensor_counts temp_screw_c x_mm y_mm c_deg a_deg");
    let square = example("x_of_y_um_per_m = 0.0", "y_of_z_um_per_m = 1.0");
    assert_eq!(columns(&square), "sensor_counts temp_screw_c x_mm y_mm z_mm c_deg a_deg");
    assert_eq!(columns(&machine("[axis.y.backlash]\nwidth_um = 1\n")), "");
    let constant =
        "[axis.y.thermal]\nmode = \"constant\"\nsensor = \"temp_a_c\"\nreference_c = 0\n";
    assert_eq!(columns(&machine(constant)), "temp_a_c");
}

#[test]
fn the_six_straightness_curves_add_up_across_the_axes() {
    let curve = |name: &str, um: f64| {
        format!(
            "[straightness.{name}]\norder = 2\nknots_mm = [0, 0, 1, 1]\ncontrol_um = [0, {um}]\n"
        )
    };
    let names = ["y_of_x", "z_of_x", "z_of_y", "x_of_y", "x_of_z", "y_of_z"];
    let text: String = names
        .iter()
        .zip([1.0, 2.0, 4.0, 8.0, 16.0, 32.0])
        .map(|(name, um)| curve(name, um))
        .collect();
    let machine = machine(&text);
    assert_eq!(machine.straightness.iter().map(|curve| curve.name()).collect::<Vec<_>>(), names);
    let at = |position_mm| {
        parts(&machine, &RowInputs { position_mm, ..RowInputs::UNKNOWN }).straightness_um
    };
    // Each axis alone, then all three: Δx = δx(y) + δx(z), Δy = δy(x) + δy(z), Δz = δz(x) + δz(y).
    assert_eq!(at([1.0, 0.0, 0.0]), [0.0, 1.0, 2.0]);
    assert_eq!(at([0.0, 1.0, 0.0]), [8.0, 0.0, 4.0]);
    assert_eq!(at([0.0, 0.0, 1.0]), [16.0, 32.0, 0.0]);
    assert_eq!(at([1.0, 1.0, 1.0]), [24.0, 33.0, 6.0]);
    let [dx, dy, dz] = at([f64::NAN, 1.0, 1.0]);
    assert_eq!(dx, 24.0);
    assert!(dy.is_nan() && dz.is_nan());
}

#[test]
fn squareness_is_an_error_of_the_first_axis_along_the_second() {
    let machine = machine("[squareness]\nx_of_y_um_per_m = 12\nz_of_x_um_per_m = -5\n");
    let situation = RowInputs { position_mm: [2000.0, 500.0, f64::NAN], ..RowInputs::UNKNOWN };
    assert_eq!(parts(&machine, &situation).squareness_um, [6.0, 0.0, -10.0]);
}

#[test]
fn a_missing_input_is_missing_only_where_it_counts() {
    let machine = parse(EXAMPLE);
    let whole = RowInputs {
        sensor_counts: 5048.0,
        temperatures_c: &[("temp_screw_c", 23.0)],
        position_mm: [0.0; 3],
        angle_deg: [0.0; 3],
        ..RowInputs::UNKNOWN
    };
    let missing = |situation: RowInputs<'_>| {
        parts(&machine, &situation).to_error_values().to_array().map(|value| value.is_nan())
    };
    assert_eq!(missing(whole), [false; 4]);
    assert_eq!(missing(RowInputs { sensor_counts: f64::NAN, ..whole }), [true, false, false, true]);
    assert_eq!(missing(RowInputs { temperatures_c: &[], ..whole }), [false, true, false, false]);
    let no_x = RowInputs { position_mm: [f64::NAN, 0.0, 0.0], ..whole };
    assert_eq!(missing(no_x), [false, true, false, true]);
    let no_z = RowInputs { position_mm: [0.0, 0.0, f64::NAN], ..whole };
    assert_eq!(missing(no_z), [false; 4]);
    let no_b = RowInputs { angle_deg: [0.0, f64::NAN, 0.0], ..whole };
    assert_eq!(missing(no_b), [false; 4]);
    let no_a = RowInputs { angle_deg: [f64::NAN, 0.0, 0.0], ..whole };
    assert_eq!(missing(no_a), [false, true, true, true]);
}

#[test]
fn without_a_source_no_angle_counts() {
    let machine = parse(&EXAMPLE.replacen("source = \"sensor\"", "", 1));
    let parts = parts(&machine, &RowInputs::UNKNOWN);
    assert_eq!((parts.elongation_um, parts.tool_um), (0.0, [0.0; 3]));
}

#[test]
fn a_head_table_machine_swings_by_its_one_axis_and_a_table_table_by_none() {
    let text = |kind: &str, head_axes: &str| {
        format!(
            "[machine]\nname = \"m\"\nkind = \"{kind}\"\nhead_axes = [{head_axes}]\n[spindle]\n\
             source = \"sensor\"\n[spindle.sensor]\nk0_um = 500\nzero_counts = 0\num_per_count = 1\n"
        )
    };
    let situation =
        RowInputs { sensor_counts: 0.0, angle_deg: [30.0, 40.0, 50.0], ..RowInputs::UNKNOWN };
    let [dx, dy, dz] = parts(&parse(&text("head-table", "\"a\"")), &situation).error_um();
    assert_eq!(dx, 0.0);
    assert_near(dy, 250.0);
    assert_near(dz, -500.0 * 0.75_f64.sqrt());
    assert_eq!(parts(&parse(&text("table-table", "")), &situation).error_um(), [0.0, 0.0, -500.0]);
}

#[test]
fn work_that_grows_out_of_the_chuck_by_s_is_dz_minus_s() {
    let text = "[machine]\nname = \"l\"\nkind = \"lathe\"\n[spindle]\nsource = \"sensor\"\n[spindle.sensor]\n\
                k0_um = 18\nzero_counts = 0\num_per_count = 1\n[axis.x.pitch]\nstart_mm = 0\nstep_mm = 50\n\
                forward_um = [0, 5]\n";
    // A radius of 25 mm: half of the table's step.
    let situation =
        RowInputs { sensor_counts: 0.0, position_mm: [25.0, 0.0, -80.0], ..RowInputs::UNKNOWN };
    let machine = parse(text);
    assert_eq!(machine.kind, MachineKind::Lathe);
    assert_eq!(parts(&machine, &situation).error_um(), [2.5, 0.0, -18.0]);
    // What the CNC adds: the turret follows the face of the work, away from the chuck.
    assert_eq!(
        trueup_machine::model::compensation_offset_um(18.0, machine.tool_direction),
        [0.0, 0.0, 18.0]
    );
}

#[test]
fn a_warm_up_without_speeds_runs_from_the_first_row_and_anew_where_time_runs_back() {
    let machine = parse(&EXAMPLE.replacen("source = \"sensor\"", "source = \"warmup\"", 1));
    let model = machine.spindle.warmup.clone().expect("written above");
    let mut reference = ReferenceModel::new(&machine);
    for start_s in [1e5, 0.0] {
        for minute in 0..120 {
            let since_start_s = 60.0 * f64::from(minute);
            let time_s = Some(start_s + since_start_s);
            let parts = reference.step(&RowInputs { time_s, ..RowInputs::UNKNOWN });
            assert_near(parts.elongation_um, warmup_elongation_um(&model, since_start_s));
        }
    }
    assert!(reference.step(&RowInputs::UNKNOWN).elongation_um.is_nan());
}

#[test]
fn an_axis_follows_its_sensor_by_its_lag_and_settles_where_time_runs_back() {
    let machine = machine(
        "[axis.z.thermal]\nmode = \"constant\"\nsensor = \"temp_a_c\"\nreference_c = 20\n\
         constant_um_per_c = 2\nlag_s = 100\n",
    );
    let mut reference = ReferenceModel::new(&machine);
    let mut at = |time_s, temperature_c| {
        let temperatures_c = &[("temp_a_c", temperature_c)];
        let situation = RowInputs { time_s: Some(time_s), temperatures_c, ..RowInputs::UNKNOWN };
        reference.step(&situation).thermal_um[2]
    };
    assert_near(at(50.0, 21.0), 2.0);
    assert_near(at(150.0, 31.0), 22.0 - 20.0 * (-1.0_f64).exp());
    assert_near(at(100.0, 31.0), 22.0);
}

#[test]
fn a_file_with_every_array_at_its_longest_is_read_in_a_moment() {
    let numbers = |count: usize| vec!["-1234.5678"; count].join(", ");
    let knots: Vec<String> =
        (0..4096_i32).map(|knot| (knot - 3).clamp(0, 4089).to_string()).collect();
    let mut text = String::from("[machine]\nname = \"m\"\nkind = \"3-axis\"\n");
    for axis in ["x", "y", "z"] {
        let table = numbers(4096);
        text += &format!(
            "[axis.{axis}.pitch]\nstart_mm = 0\nstep_mm = 1\nforward_um = [{table}]\n\
             reverse_um = [{table}]\n"
        );
    }
    for pair in ["y_of_x", "z_of_x", "z_of_y", "x_of_y", "x_of_z", "y_of_z"] {
        text += &format!(
            "[straightness.{pair}]\norder = 4\nknots_mm = [{}]\ncontrol_um = [{}]\n",
            knots.join(", "),
            numbers(4092)
        );
    }
    let started = std::time::Instant::now();
    let machine = parse(&text);
    let took = started.elapsed();
    println!("{} bytes in {took:?}", text.len());
    assert_eq!(machine.straightness[5].spline.control_um.len(), 4092);
    assert_eq!(machine.places.locate("axis.z.pitch.reverse_um[4095]").line, 18);
    assert!(took.as_secs() < 5, "{took:?}");
}
