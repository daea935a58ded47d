//! One wrong file a rule, and next to each the right one that must be silent.

use std::path::Path;

use super::*;
use crate::MachineFile;

/// Every section once, and nothing doubtful in it.
const RIGHT: &str = "\
[machine]
name = \"m\"
kind = \"3-axis\"
tool_direction = [0.0, 0.0, -1.0]

[inputs]
sensor = { volts_full_scale = 10.0, counts_full_scale = 27648, divider = 0.328 }
temp_a_c = { channel = 0, kind = \"pt100\" }
temp_b_c = { channel = 1, kind = \"pt100\" }

[spindle]
source = \"temperature\"
[spindle.sensor]
k0_um = 0.0
zero_counts = 5048.0
um_per_count = 0.018084490740740741
[spindle.temperature]
sensor = \"temp_a_c\"
reference_c = 20.0
k_um_per_c = 2.0
[spindle.warmup]
lag_s = 60.0
warm_s = 5400.0
max_um = 80.0
exponent = 4.0

[axis.x]
travel_mm = [0.0, 1000.0]
rapid_mm_per_min = 12000.0
[axis.x.thermal]
mode = \"both\"
sensor = \"temp_b_c\"
reference_c = 20.0
constant_um_per_c = 1.0
slope_um_per_m_per_c = 11.5
[axis.x.pitch]
start_mm = 0.0
step_mm = 500.0
forward_um = [0.0, 4.0, 2.0]
[axis.x.backlash]
width_um = 3.0

[axis.z.thermal]
mode = \"constant\"
sensor = \"temp_b_c\"
reference_c = 20.0
constant_um_per_c = 1.5

[straightness.z_of_x]
order = 2
knots_mm = [0.0, 0.0, 500.0, 1000.0, 1000.0]
control_um = [0.0, 5.0, 0.0]

[squareness]
z_of_x_um_per_m = 5.0

[limits]
max_um = { x = 200.0, y = 200.0, z = 500.0 }
slew_um_per_s = 20.0

[[term]]
cause = \"backlash\"
quantity = \"dx\"
width_um = 1.0
";

fn parse(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).expect("a file that can be read")
}

/// With `right` written as `wrong` there is one warning: on the line of `line`, which says `phrase`.
#[track_caller]
fn doubted(right: &str, wrong: &str, line: &str, phrase: &str) {
    assert_eq!(RIGHT.matches(right).count(), 1, "{right}");
    let text = RIGHT.replace(right, wrong);
    let warnings = super::machine(&parse(&text));
    assert_eq!(warnings.len(), 1, "{warnings:#?}");
    let there = text.lines().nth(warnings[0].place.line - 1).expect("a line of the file");
    assert!(there.starts_with(line), "{there}: {warnings:?}");
    assert!(warnings[0].what.contains(phrase), "{warnings:?}");
    assert!(!warnings[0].help.is_empty(), "{warnings:?}");
}

#[test]
fn a_right_file_is_silent() {
    assert_eq!(super::machine(&parse(RIGHT)), []);
    assert_eq!(corrects_nothing(&parse(RIGHT)), None);
}

#[test]
fn a_reference_in_kelvin() {
    let wrong = "reference_c = 293.15\nk_um_per_c";
    doubted("reference_c = 20.0\nk_um_per_c", wrong, "reference_c", "would be 20.00 °C");
    let table = "reference_c = 20.0\ntable = [[293.15, 0.0, 0.0], [303.15, 10.0, 115.0]]\n\
                 constant_um_per_c = 1.0\nslope";
    doubted("reference_c = 20.0\nconstant_um_per_c = 1.0\nslope", table, "table", "kelvin");
    // A law without a table has the one reference.
    let law = "reference_c = 293.15\nconstant_um_per_c = 1.0\nslope";
    doubted("reference_c = 20.0\nconstant_um_per_c = 1.0\nslope", law, "reference_c", "kelvin");
}

#[test]
fn the_reference_of_a_term_in_kelvin() {
    let term = "cause = \"extra-heat-path\"\nquantity = \"dx\"\ncolumn = \"temp_a_c\"\num_per_c = 1.0\n\
                time_constant_s = 0.0\nreference_c = 295.0\n";
    let plain = "cause = \"backlash\"\nquantity = \"dx\"\nwidth_um = 1.0\n";
    doubted(plain, term, "reference_c = 295.0", "kelvin");
}

#[test]
fn a_slope_in_another_unit() {
    doubted("c = 11.5\n", "c = 11.5e-6\n", "slope_um_per_m_per_c", "would do nothing");
    let roomy = RIGHT.replace("x = 200.0", "x = 4000.0");
    let told = super::machine(&parse(&roomy.replace("c = 11.5\n", "c = 115.0\n")));
    assert!(told.len() == 1 && told[0].what.contains("more than any metal"), "{told:?}");
}

#[test]
fn a_constant_in_another_unit() {
    doubted("um_per_c = 1.5\n", "um_per_c = 1.5e-6\n", "constant_um_per_c", "would do nothing");
    doubted("k_um_per_c = 2.0", "k_um_per_c = 2e-6", "k_um_per_c", "would do nothing");
}

#[test]
fn a_zero_beyond_full_scale() {
    doubted(
        "= 5048.0",
        "= 30000.0",
        "zero_counts",
        "beyond full scale: the input gives 0 to 27648",
    );
    doubted("= 5048.0", "= -1.0", "zero_counts", "beyond full scale");
}

#[test]
fn a_negative_gain() {
    doubted("um_per_count = 0", "um_per_count = -0", "um_per_count", "is negative");
    doubted("k_um_per_c = 2.0", "k_um_per_c = -2.0", "k_um_per_c", "shrink");
    doubted("max_um = 80.0", "max_um = -80.0", "max_um", "shrink");
}

#[test]
fn counts_of_another_input() {
    let told = "does not go with um_per_count";
    doubted("scale = 27648", "scale = 32768", "sensor = ", told);
    // 500/32768 where the input ends at 27648.
    doubted("0.018084490740740741", "0.0152587890625", "sensor = ", told);
}

#[test]
fn a_sensor_that_nobody_makes() {
    doubted("= 0.018084490740740741", "= 0.018e-3", "um_per_count", "makes a sensor of");
}

#[test]
fn a_tool_that_points_up() {
    doubted("[0.0, 0.0, -1.0]", "[0.0, 0.0, 1.0]", "tool_direction", "points up");
}

#[test]
fn a_slew_that_the_axes_notice() {
    let slew = "slew_um_per_s = 20.0";
    // 1 % of 12 m/min is 2 mm/s.
    doubted(slew, "slew_um_per_s = 2001.0", "slew", "1 % (2000 µm/s) of axis x");
    let unknown = RIGHT.replace("rapid_mm_per_min = 12000.0\n", "");
    let silent = unknown.replace(slew, "slew_um_per_s = 1600.0");
    assert_eq!(super::machine(&parse(&silent)), []);
    let fast = super::machine(&parse(&unknown.replace(slew, "slew_um_per_s = 1700.0")));
    assert!(fast.len() == 1 && fast[0].help.contains("rapid_mm_per_min"), "{fast:?}");
}

#[test]
fn tables_and_curves_outside_the_travel() {
    doubted("start_mm = 0.0", "start_mm = -1600.0", "start_mm", "from -1600 to -600 mm, outside");
    let knots = "knots_mm = [0.0, 0.0, 500.0, 1000.0, 1000.0]";
    let in_metres = "knots_mm = [0.0, 0.0, 5000.0, 10000.0, 10000.0]";
    doubted(knots, in_metres, "knots_mm", "from 0 to 10000 mm, outside the travel of x");
    let second = "pitch = { start_mm = 9000.0, step_mm = 500.0, forward_um = [0.0, 1.0] }";
    let dual =
        format!("[axis.x.dual]\nacross = \"y\"\nfirst_mm = 0.0\nsecond_mm = 900.0\n{second}\n");
    doubted(
        "[axis.x.backlash]\n",
        &(dual + "[axis.x.backlash]\n"),
        "pitch = {",
        "from 9000 to 9500 mm",
    );
    // A table may end one step beyond.
    let longer = RIGHT.replace("forward_um = [0.0, 4.0, 2.0]", "forward_um = [0.0, 4.0, 2.0, 1.0]");
    assert_eq!(super::machine(&parse(&longer)), []);
}

#[test]
fn a_limit_below_what_it_limits() {
    doubted("x = 200.0", "x = 100.0", "max_um", "axis.x.thermal makes 125.0 µm within 10 K");
    doubted("z = 500.0", "z = 70.0", "max_um", "spindle.warmup makes 80.0 µm");
}

#[test]
fn one_thing_corrected_twice() {
    doubted(
        "width_um = 1.0",
        "width_um = 2.9",
        "[[term]]",
        "adds 2.9 µm of backlash to the 3.0 µm",
    );
    let curve = "control_um = [0.0, 5.0, 0.0]";
    doubted(
        curve,
        "control_um = [0.0, 5.0, 5.2]",
        "z_of_x_um_per_m",
        "which rises by 5.2 µm itself",
    );
    let other = "sensor = \"temp_b_c\"\nreference_c = 20.0\nconstant_um_per_c = 1.5";
    let same = other.replace("temp_b", "temp_a");
    doubted(other, &same, "sensor = \"temp_a_c\"", "both move the tool along Z");
    let term = &RIGHT[RIGHT.find("[[term]]").expect("there is one")..];
    doubted(term, &term.repeat(2), "[[term]]", "is the same as the [[term]]");
}

#[test]
fn a_file_that_corrects_nothing() {
    let head = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
    let told = |text: &str| corrects_nothing(&parse(&format!("{head}{text}"))).map(|it| it.what);
    assert!(told("").expect("nothing").contains("every offset at 0"));
    let sensor = "[spindle.sensor]\nk0_um = 0.0\nzero_counts = 1.0\num_per_count = 0.1\n";
    assert!(told(sensor).expect("nothing").contains("no source"));
    assert_eq!(told(&format!("[spindle]\nsource = \"sensor\"\n{sensor}")), None);
    assert!(told("[axis.x.backlash]\nwidth_um = 0.0\n").is_some());
    assert_eq!(told("[axis.x.backlash]\nwidth_um = 1.0\n"), None);
    let term =
        "[[term]]\ncause = \"centrifugal-growth\"\nquantity = \"elongation\"\num_per_krpm2 = 0.1\n";
    assert_eq!(told(term), None);
}

fn told_of_run(text: &str, machine: Option<&Machine>) -> Vec<String> {
    let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
    super::run(&run, machine).into_iter().map(|it| format!("{}: {}", it.place, it.what)).collect()
}

/// A warning of the run, and none of `right`.
#[track_caller]
fn run_doubted(wrong: &str, right: &str, machine: Option<&Machine>, phrase: &str) {
    let told = told_of_run(wrong, machine);
    assert!(told.len() == 1 && told[0].contains(phrase), "{told:?}");
    assert_eq!(told_of_run(right, machine), [""; 0]);
}

#[test]
fn a_run_in_kelvin() {
    let right = "time_s,temp_a_c,temp_he_c\n0,20.5,240\n1,21.5,250\n2,22.5,255\n";
    let wrong = "time_s,temp_a_c\n0,293.6\n1,294.6\n2,295.6\n";
    run_doubted(
        wrong,
        right,
        None,
        "r.csv:2:3: temp_a_c is from 293.6 to 295.6: that looks like kelvin",
    );
}

#[test]
fn volts_for_counts() {
    let (wrong, right) =
        ("sensor_counts\n1.54\n1.60\n2.1\n", "sensor_counts\n5048\n5244.5\n6881\n");
    run_doubted(wrong, right, None, "looks like volts");
}

#[test]
fn counts_that_end_at_the_input_of_an_s7() {
    let machine = RIGHT
        .replace("scale = 27648", "scale = 32768")
        .replace("0.018084490740740741", "0.0152587890625");
    let machine = parse(&machine);
    let wrong = "sensor_counts\n27000\n27648\n27648\n27648\n";
    let right = "sensor_counts\n27000\n27647\n27648\n27700\n";
    run_doubted(wrong, right, Some(&machine), "ends at 27648 in 3 rows");
}

#[test]
fn measured_in_another_unit() {
    let machine = parse(RIGHT);
    // The prediction is 2 µm for each kelvin of temp_a_c.
    let run = |scale: f64| {
        let rows = (0..30).map(|row| {
            let celsius = 20.0 + f64::from(row) * 0.5;
            let um = scale * (2.0 * (celsius - 20.0) * 1.3 + 0.2 * f64::from(row % 3));
            format!("{row},{celsius},20,{um}\n")
        });
        format!("time_s,temp_a_c,temp_b_c,measured_elongation_um\n{}", rows.collect::<String>())
    };
    run_doubted(&run(1e-3), &run(1.0), Some(&machine), "looks like mm, not µm");
    run_doubted(&run(1e-6), &run(0.1), Some(&machine), "looks like m, not µm");
    run_doubted(&run(1e3), &run(10.0), Some(&machine), "looks like nm, not µm");
}

#[test]
fn positions_outside_the_travel() {
    let machine = parse(RIGHT);
    let run = |scale: f64| format!("x_mm\n{}\n{}\n{}\n", 0.0, 500.0 * scale, 1000.0 * scale);
    run_doubted(&run(1000.0), &run(1.0), Some(&machine), "outside the travel_mm");
}

#[test]
fn a_column_in_another_unit_is_told_by_its_name() {
    run_doubted(
        "measured_dz_mm\n1\n2\n",
        "measured_dz_um\n1\n2\n",
        None,
        "did you mean measured_dz_um?",
    );
}

#[test]
fn a_summary_has_the_largest_of_each_part_and_the_room_on_the_board() {
    let summary = Summary::of(&parse(RIGHT));
    let [x, y, z] = &summary.axes;
    assert_eq!(y.largest_um(), Some(0.0));
    // 10 K at 1 m: 10 + 115; the table 4; backlash 3 and the term's 1.
    assert_eq!(x.largest_um(), Some(125.0 + 4.0 + 3.0 + 1.0));
    // 20 of the growth, 15 of the axis, 5 of the curve, 5 of the squareness.
    assert_eq!(z.largest_um(), Some(45.0));
    assert!(summary.bytes.is_ok_and(|bytes| bytes > 500 && bytes < summary.most_bytes));
    // 20 µm/s are 1 % of 2 mm/s.
    assert!((summary.slowest_rapid_mm_per_min - 120.0).abs() < 1e-9);
    let sensor = summary.sensor.expect("connected");
    assert!((sensor.range_um - 500.0).abs() < 1e-9);
    // 10 V at a divider of 0.328 are 4071 of 4096 codes.
    assert!((sensor.um_per_code - 500.0 / (4096.0 * 3.28 / 3.3)).abs() < 1e-9);
}
