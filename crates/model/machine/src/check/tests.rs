//! One wrong file a rule, and next to each the right one that must be silent.

use std::path::Path;

use super::*;
use crate::MachineFile;

const TILTS_X: &str =
    "cause = \"angular-error\"\nquantity = \"dx\"\nlever = \"z\"\nurad_per_m = 4.0\n";
const CARRIES_Z: &str = "kind = \"3-axis\"\nchain = \"w b X Y Z t\"\n";
const CARRIES_NONE: &str = "kind = \"3-axis\"\nchain = \"w b Y Z X t\"\n";

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

/// A rule, with a file that breaks it and one that comes as near as it may; each is [`RIGHT`] with some of
/// its text written otherwise.
struct Rule {
    name: &'static str,
    wrong: &'static [(&'static str, &'static str)],
    /// The beginning of the line that it points to.
    line: &'static str,
    /// A part of what it says.
    message: &'static str,
    near: &'static [(&'static str, &'static str)],
}

const ROOM: (&str, &str) = ("x = 200.0", "x = 4000.0");
const TERM: &str = "cause = \"backlash\"\nquantity = \"dx\"\nwidth_um = 1.0\n";
const HEAT_OF_X: &str =
    "reference_c = 20.0\nconstant_um_per_c = 1.0\nslope_um_per_m_per_c = 11.5\n";
const KNOTS: &str = "[0.0, 0.0, 500.0, 1000.0, 1000.0]";
const HEAT_OF_Z: &str = "sensor = \"temp_b_c\"\nreference_c = 20.0\nconstant_um_per_c = 1.5";
const SAME_HEAT: &str = "sensor = \"temp_a_c\"\nreference_c = 20.0\nconstant_um_per_c = 1.5";

#[rustfmt::skip]
const RULES: &[Rule] = &[
    // heat
    Rule {
        name: "an axis's reference in kelvin", line: "reference_c = 293.15", message: "it would be 20.00 °C",
        wrong: &[(HEAT_OF_X, "reference_c = 293.15\nconstant_um_per_c = 1.0\nslope_um_per_m_per_c = 11.5\n")],
        near: &[(HEAT_OF_X, "reference_c = 70.0\nconstant_um_per_c = 1.0\nslope_um_per_m_per_c = 11.5\n")],
    },
    Rule {
        name: "a table's temperature in kelvin", line: "table", message: "kelvin",
        wrong: &[(HEAT_OF_X, "table = [[293.15, 0.0, 0.0], [303.15, 10.0, 10.0]]\n")],
        near: &[(HEAT_OF_X, "table = [[20.0, 0.0, 0.0], [30.0, 10.0, 10.0]]\n")],
    },
    Rule {
        name: "the spindle's reference in kelvin", line: "reference_c = 293.15", message: "kelvin",
        wrong: &[("reference_c = 20.0\nk_um", "reference_c = 293.15\nk_um")],
        near: &[("reference_c = 20.0\nk_um", "reference_c = 70.0\nk_um")],
    },
    Rule {
        name: "a term's reference in kelvin", line: "reference_c = 295.0", message: "kelvin",
        wrong: &[(TERM, "cause = \"extra-heat-path\"\nquantity = \"dx\"\ncolumn = \"temp_a_c\"\num_per_c = 1.0\n\
                         time_constant_s = 0.0\nreference_c = 295.0\n")],
        near: &[(TERM, "cause = \"extra-heat-path\"\nquantity = \"dx\"\ncolumn = \"temp_a_c\"\num_per_c = 1.0\n\
                        time_constant_s = 0.0\nreference_c = 25.0\n")],
    },
    Rule {
        name: "a slope in 1/K", line: "slope_um_per_m_per_c", message: "would do nothing",
        wrong: &[("c = 11.5\n", "c = 11.5e-6\n")], near: &[("c = 11.5\n", "c = 0.001\n")],
    },
    Rule {
        name: "a slope of no metal", line: "slope_um_per_m_per_c", message: "more than any metal",
        wrong: &[("c = 11.5\n", "c = 101.0\n"), ROOM], near: &[("c = 11.5\n", "c = 100.0\n"), ROOM],
    },
    Rule {
        name: "an axis's constant in another unit", line: "constant_um_per_c", message: "would do nothing",
        wrong: &[("um_per_c = 1.5\n", "um_per_c = 1.5e-6\n")], near: &[("um_per_c = 1.5\n", "um_per_c = 0.001\n")],
    },
    Rule {
        name: "the spindle's constant in another unit", line: "k_um_per_c", message: "would do nothing",
        wrong: &[("k_um_per_c = 2.0", "k_um_per_c = 2e-6")], near: &[("k_um_per_c = 2.0", "k_um_per_c = 0.001")],
    },
    Rule {
        name: "a spindle that shrinks with its temperature", line: "k_um_per_c", message: "shrink",
        wrong: &[("k_um_per_c = 2.0", "k_um_per_c = -2.0")], near: &[("k_um_per_c = 2.0", "k_um_per_c = 8.0")],
    },
    Rule {
        name: "a spindle that shrinks as it runs", line: "max_um", message: "shrink",
        wrong: &[("max_um = 80.0", "max_um = -80.0")], near: &[("max_um = 80.0", "max_um = 500.0")],
    },
    // sensor
    Rule {
        name: "a zero beyond full scale", line: "zero_counts",
        message: "beyond full scale: the input gives 0 to 27648",
        wrong: &[("= 5048.0", "= 27649.0")], near: &[("= 5048.0", "= 27648.0")],
    },
    Rule {
        name: "a zero below nothing", line: "zero_counts", message: "beyond full scale",
        wrong: &[("= 5048.0", "= -1.0")], near: &[("= 5048.0", "= 0.0")],
    },
    Rule {
        name: "a negative gain", line: "um_per_count", message: "is negative",
        wrong: &[("um_per_count = 0", "um_per_count = -0")], near: &[],
    },
    Rule {
        name: "32768 where the input reaches 27648", line: "sensor = ", message: "does not go with um_per_count",
        wrong: &[("scale = 27648", "scale = 32768")],
        near: &[("scale = 27648", "scale = 32768"), ("0.018084490740740741", "0.0152587890625")],
    },
    Rule {
        name: "27648 where the input reaches 32768", line: "sensor = ", message: "does not go with um_per_count",
        wrong: &[("0.018084490740740741", "0.0152587890625")], near: &[("0.018084490740740741", "0.0180")],
    },
    Rule {
        name: "a sensor that nobody makes", line: "um_per_count", message: "makes a sensor of",
        wrong: &[("= 0.018084490740740741", "= 0.00036")], near: &[("= 0.018084490740740741", "= 0.00037")],
    },
    // place
    Rule {
        name: "a tool that points up", line: "tool_direction", message: "points up",
        wrong: &[("[0.0, 0.0, -1.0]", "[0.0, 0.0, 1.0]")], near: &[("[0.0, 0.0, -1.0]", "[1.0, 0.0, 0.0]")],
    },
    Rule {
        name: "a table outside the travel", line: "start_mm", message: "from -501 to 499 mm, outside",
        wrong: &[("start_mm = 0.0", "start_mm = -501.0")], near: &[("start_mm = 0.0", "start_mm = -500.0")],
    },
    Rule {
        name: "a second drive's table outside the travel", line: "pitch = {", message: "from 9000 to 9500 mm",
        wrong: &[("[axis.x.backlash]\n", "[axis.x.dual]\nacross = \"y\"\nfirst_mm = 0.0\nsecond_mm = 900.0\n\
                   pitch = { start_mm = 9000.0, step_mm = 500.0, forward_um = [0.0, 1.0] }\n[axis.x.backlash]\n")],
        near: &[("[axis.x.backlash]\n", "[axis.x.dual]\nacross = \"y\"\nfirst_mm = 0.0\nsecond_mm = 900.0\n\
                  pitch = { start_mm = 1000.0, step_mm = 500.0, forward_um = [0.0, 1.0] }\n[axis.x.backlash]\n")],
    },
    Rule {
        name: "a curve outside the travel", line: "knots_mm", message: "from 0 to 1011 mm, outside the travel of x",
        wrong: &[(KNOTS, "[0.0, 0.0, 500.0, 1011.0, 1011.0]")], near: &[(KNOTS, "[0.0, 0.0, 500.0, 1010.0, 1010.0]")],
    },
    // limits
    Rule {
        // 1 % of 12 m/min is 2 mm/s.
        name: "a slew that the axes notice", line: "slew", message: "1 % (2000 µm/s) of axis x",
        wrong: &[("s = 20.0\n", "s = 2001.0\n")], near: &[("s = 20.0\n", "s = 2000.0\n")],
    },
    Rule {
        name: "a slew that a slow axis notices", line: "slew", message: "a slow machine's",
        wrong: &[("s = 20.0\n", "s = 1667.0\n"), ("rapid_mm_per_min = 12000.0\n", "")],
        near: &[("s = 20.0\n", "s = 1666.0\n"), ("rapid_mm_per_min = 12000.0\n", "")],
    },
    Rule {
        name: "a limit below an axis's error", line: "max_um", message: "axis.x.thermal makes 125.0 µm within 10 K",
        wrong: &[("x = 200.0", "x = 124.0")], near: &[("x = 200.0", "x = 125.0")],
    },
    Rule {
        name: "a limit below the growth", line: "max_um", message: "spindle.warmup makes 80.0 µm",
        wrong: &[("z = 500.0", "z = 79.0")], near: &[("z = 500.0", "z = 80.0")],
    },
    // twice
    Rule {
        name: "backlash twice", line: "[[term]]", message: "adds 2.5 µm of backlash to the 3.0 µm",
        wrong: &[("width_um = 1.0", "width_um = 2.5")], near: &[("width_um = 1.0", "width_um = 2.3")],
    },
    Rule {
        name: "squareness twice", line: "z_of_x_um_per_m", message: "which rises by 5.2 µm itself",
        wrong: &[("control_um = [0.0, 5.0, 0.0]", "control_um = [0.0, 5.0, 5.2]")],
        near: &[("control_um = [0.0, 5.0, 0.0]", "control_um = [0.0, 5.0, -5.2]")],
    },
    Rule {
        name: "the heat of the tool twice", line: "sensor = \"temp_a_c\"", message: "both move the tool along Z",
        wrong: &[(HEAT_OF_Z, SAME_HEAT)],
        near: &[(HEAT_OF_Z, SAME_HEAT), ("source = \"temperature\"", "source = \"warmup\"")],
    },
    Rule {
        name: "an angle twice", line: "[[term]]", message: "is the turn of angular.ebx with the lever along Z",
        wrong: &[(TERM, TILTS_X), ("kind = \"3-axis\"\n", CARRIES_Z), ("[straightness", "[angular.ebx]\nurad_per_m = 4.0\n\n[straightness")],
        // In that chain Z is no lever of X.
        near: &[(TERM, TILTS_X), ("kind = \"3-axis\"\n", CARRIES_NONE), ("[straightness", "[angular.ebx]\nurad_per_m = 4.0\n\n[straightness")],
    },
    Rule {
        name: "a term twice", line: "[[term]]", message: "is the same as the [[term]]",
        wrong: &[(TERM, "cause = \"backlash\"\nquantity = \"dx\"\nwidth_um = 1.0\n\n[[term]]\ncause = \"backlash\"\n\
                         quantity = \"dx\"\nwidth_um = 1.0\n")],
        near: &[(TERM, "cause = \"backlash\"\nquantity = \"dx\"\nwidth_um = 1.0\n\n[[term]]\ncause = \"backlash\"\n\
                        quantity = \"dx\"\nwidth_um = 1.1\n")],
    },
];

/// [`RIGHT`], so written.
#[track_caller]
fn written(pairs: &[(&str, &str)]) -> String {
    pairs.iter().fold(RIGHT.to_owned(), |text, (right, other)| {
        assert_eq!(text.matches(right).count(), 1, "{right}");
        text.replace(right, other)
    })
}

#[test]
fn each_rule_has_a_file_that_breaks_it_and_one_next_to_it_that_does_not() {
    for Rule { name, wrong, line, message: sends, near } in RULES {
        let text = written(wrong);
        let warnings = super::machine_warnings(&parse(&text));
        assert_eq!(warnings.len(), 1, "{name}: {warnings:#?}");
        let there = text.lines().nth(warnings[0].place.line - 1).expect("a line of the file");
        assert!(there.starts_with(line), "{name}: {there}: {warnings:?}");
        assert!(warnings[0].what.contains(sends), "{name}: {warnings:?}");
        assert!(!warnings[0].help.is_empty(), "{name}: {warnings:?}");
        assert_eq!(
            super::machine_warnings(&parse(&written(near))),
            [],
            "{name}, as near as it may come"
        );
    }
}

#[test]
fn a_file_that_corrects_nothing() {
    let head = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
    let warning_of = |text: &str| {
        no_correction_warning(&parse(&format!("{head}{text}"))).map(|warning| warning.what)
    };
    assert!(warning_of("").expect("nothing").contains("every offset at 0"));
    let sensor = "[spindle.sensor]\nk0_um = 0.0\nzero_counts = 1.0\num_per_count = 0.1\n";
    assert!(warning_of(sensor).expect("nothing").contains("no source"));
    assert_eq!(warning_of(&format!("[spindle]\nsource = \"sensor\"\n{sensor}")), None);
    assert!(warning_of("[axis.x.backlash]\nwidth_um = 0.0\n").is_some());
    assert_eq!(warning_of("[axis.x.backlash]\nwidth_um = 1.0\n"), None);
    let term =
        "[[term]]\ncause = \"centrifugal-growth\"\nquantity = \"elongation\"\num_per_krpm2 = 0.1\n";
    assert_eq!(warning_of(term), None);
}

#[test]
fn growth_with_a_speed_that_the_file_does_not_say_is_not_called_0() {
    let z_um = |rated: &str, growth: &str| {
        let text = format!(
            "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"warmup\"\n\
             [spindle.warmup]\nlag_s = 60\nwarm_s = 5400\nmax_um = 30\nexponent = 4\n{rated}{growth}"
        );
        MachineSummary::from_machine(&parse(&text)).axes[2].max_total_error_um()
    };
    let rated = "rated_rpm = 10000\n";
    let tools = "[spindle.tools]\ndefault = { um_per_krpm2 = 0.02 }\n3 = { um_per_krpm2 = 0.1 }\n";
    let term = "[[term]]\nquantity = \"elongation\"\ncause = ";
    let centrifugal = format!("{term}\"centrifugal-growth\"\num_per_krpm2 = 0.1\n");
    for growth in [tools, &centrifugal] {
        assert_eq!(z_um("", growth), None, "{growth}");
        assert!((z_um(rated, growth).expect("known") - 40.0).abs() < 1e-9, "{growth}");
    }
    let load = format!("{term}\"cutting-load\"\num_per_n = 0.01\n");
    assert_eq!(z_um(rated, &load), None);
    assert_eq!(z_um(rated, &format!("{term}\"sensor-saturation\"\nlimit_um = 20\n")), Some(30.0));
}

fn run_warnings(text: &str, machine: Option<&Machine>) -> Vec<String> {
    let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
    super::run_warnings(&run, machine)
        .into_iter()
        .map(|warning| format!("{}: {}", warning.place, warning.what))
        .collect()
}

/// A warning of the run, and none of `right`.
#[track_caller]
fn run_doubted(wrong: &str, right: &str, machine: Option<&Machine>, phrase: &str) {
    let findings = run_warnings(wrong, machine);
    assert!(findings.len() == 1 && findings[0].contains(phrase), "{findings:?}");
    assert_eq!(run_warnings(right, machine), [""; 0]);
}

#[test]
fn a_run_in_kelvin() {
    let right = "time_s,temp_a_c,temp_he_c\n0,70,240\n1,69,250\n2,70,255\n";
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
    let wrong = "sensor_counts\n1.54\n1.60\n11\n";
    for right in ["sensor_counts\n1.54\n1.60\n11.1\n", "sensor_counts\n1\n2\n11\n"] {
        run_doubted(wrong, right, None, "looks like volts");
    }
}

#[test]
fn counts_that_end_at_the_input_of_an_s7() {
    let machine = RIGHT
        .replace("scale = 27648", "scale = 32768")
        .replace("0.018084490740740741", "0.0152587890625");
    let machine = parse(&machine);
    let wrong = "sensor_counts\n27000\n27648\n27648\n27648\n";
    for right in [
        "sensor_counts\n27000\n27647\n27648\n27648\n",
        "sensor_counts\n27648\n27648\n27648\n27649\n",
    ] {
        run_doubted(wrong, right, Some(&machine), "ends at 27648 in 3 rows");
    }
    // Of an input that has 27648 it is the end of its range.
    assert_eq!(run_warnings(wrong, Some(&parse(RIGHT))), [""; 0]);
}

#[test]
fn measured_in_another_unit() {
    let machine = parse(RIGHT);
    // The prediction is 2 µm for each kelvin of temp_a_c.
    let run = |scale: f64| {
        let rows = (0..30).map(|row| {
            let celsius = 20.0 + f64::from(row) * 0.5;
            let um = scale * (2.0 * (celsius - 20.0) * 1.3 + 0.2 * f64::from(row % 3));
            format!("{},{celsius},20,{um}\n", 60 * row)
        });
        format!("time_s,temp_a_c,temp_b_c,measured_elongation_um\n{}", rows.collect::<String>())
    };
    run_doubted(&run(1e-3), &run(1.0), Some(&machine), "looks like mm, not µm");
    run_doubted(&run(1e-6), &run(0.1), Some(&machine), "looks like m, not µm");
    run_doubted(&run(1e3), &run(10.0), Some(&machine), "looks like nm, not µm");
    run_doubted(&run(1.0 / 25_400.0), &run(1.0), Some(&machine), "looks like inches, not µm");
    run_doubted(&run(-1.0), &run(1.0), Some(&machine), "measured the other way round");
}

#[test]
fn positions_outside_the_travel() {
    let machine = parse(RIGHT);
    let run = |scale: f64| format!("x_mm\n{}\n{}\n{}\n", 0.0, 500.0 * scale, 1000.0 * scale);
    run_doubted(&run(1000.0), &run(1.01), Some(&machine), "looks like µm, not mm");
    run_doubted(&run(0.001), &run(0.1), Some(&machine), "looks like m, not mm");
    run_doubted(&run(1.0 / 25.4), &run(0.1), Some(&machine), "looks like inches, not mm");
    run_doubted(&run(1.011), &run(1.0), Some(&machine), "outside the travel_mm");
}

#[test]
fn a_column_in_another_unit_is_reported_by_its_name() {
    run_doubted(
        "measured_dz_mm\n1\n2\n",
        "measured_dz_um\n1\n2\n",
        None,
        "did you mean measured_dz_um?",
    );
}

#[test]
fn a_summary_has_the_largest_of_each_part_and_the_room_on_the_board() {
    let summary = MachineSummary::from_machine(&parse(RIGHT));
    let [x, y, z] = &summary.axes;
    assert_eq!(y.max_total_error_um().map(f64::to_bits), Some(0), "not −0, which JSON would show");
    // 10 K at 1 m: 10 + 115; the table 4; backlash 3 and the term's 1.
    assert_eq!(x.max_total_error_um(), Some(125.0 + 4.0 + 3.0 + 1.0));
    // 20 of the growth, 15 of the axis, 5 of the curve, 5 of the squareness.
    assert_eq!(z.max_total_error_um(), Some(45.0));
    assert!(summary.bytes.is_ok_and(|bytes| bytes > 500 && bytes < summary.most_bytes));
    // 20 µm/s are 1 % of 2 mm/s.
    assert!((summary.slowest_rapid_mm_per_min - 120.0).abs() < 1e-9);
    let sensor = summary.sensor.expect("connected");
    assert!((sensor.range_um - 500.0).abs() < 1e-9);
    // 10 V at a divider of 0.328 are 4071 of 4096 codes.
    assert!((sensor.um_per_code - 500.0 / (4096.0 * 3.28 / 3.3)).abs() < 1e-9);
}
