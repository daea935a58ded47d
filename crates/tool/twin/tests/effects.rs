//! Each effect switched on alone: it changes what it should, by what a hand reckons, and nothing else.

use std::path::Path;

use trueup_twin::{Scenario, run_table::RunTable, simulate};

fn run(text: &str, seed: u64) -> RunTable {
    let scenario = Scenario::parse(text, Path::new("s.toml")).expect("the test's own scenario");
    simulate(&scenario, seed, || {})
}

fn column<'t>(table: &'t RunTable, name: &str) -> &'t [f64] {
    table.column(name).unwrap_or_else(|| panic!("no column {name}"))
}

/// Returns the columns that differ.
fn changed(before: &RunTable, after: &RunTable) -> Vec<String> {
    assert_eq!(before.column_names().collect::<Vec<_>>(), after.column_names().collect::<Vec<_>>());
    let same = |name: &&str| {
        let pairs = column(before, name).iter().zip(column(after, name));
        let mut all = pairs.map(|(a, b)| a == b || a.is_nan() && b.is_nan());
        all.all(|same| same)
    };
    before.column_names().filter(|name| !same(name)).map(str::to_string).collect()
}

/// A spindle that runs, cuts and stands.
const SPINDLE: &str = r#"
name = "spindle"
measure = ["elongation", "dz"]
interval_s = 30
[spindle]
[sensor]
[thermometer.front]
at = "front"
[thermometer.coil]
at = "coil"
[instrument]
quantum_um = 0.0001
[[segment]]
kind = "spindle"
duration_s = 3600
spindle_rpm = 18000
[[segment]]
kind = "spindle"
duration_s = 600
spindle_rpm = 18000
load_n = 500
[[segment]]
kind = "spindle"
duration_s = 1800
"#;

/// With `line` after the section's header.
fn with(base: &str, section: &str, line: &str) -> RunTable {
    let text = base.replacen(&format!("{section}\n"), &format!("{section}\n{line}\n"), 1);
    assert_ne!(text, base, "no {section}");
    run(&text, 5)
}

#[test]
fn a_seed_repeats_to_the_byte_and_another_one_differs() {
    let noisy = SPINDLE.replace("[instrument]", "[instrument]\nnoise_um = 0.3");
    assert_eq!(run(&noisy, 5).to_csv(), run(&noisy, 5).to_csv());
    assert_eq!(
        changed(&run(&noisy, 5), &run(&noisy, 6)),
        ["measured_elongation_um", "measured_dz_um"]
    );
}

#[test]
fn a_warm_spindle_grows_out_and_lowers_the_tip() {
    let table = run(SPINDLE, 5);
    let (grown, dz) = (column(&table, "measured_elongation_um"), column(&table, "measured_dz_um"));
    let rows = grown.len();
    assert_eq!(rows, 1 + 6000 / 30);
    assert!(grown[0].abs() < 1e-6, "cold: {}", grown[0]);
    println!(
        "after an hour at 18000 r/min: {:.1} µm, {:.1} °C",
        grown[120],
        column(&table, "temp_front_c")[120]
    );
    assert!((20.0..200.0).contains(&grown[120]));
    // Off: it shrinks at once by the speed's part, then as it cools.
    assert!(grown[rows - 1] < 0.7 * grown[140]);
    assert!(grown.iter().zip(dz).all(|(grown, dz)| (grown + dz).abs() < 1e-3));
    // The sensor's own law: 5048 counts cold, more as it grows.
    let counts = column(&table, "sensor_counts");
    assert_eq!(counts[0], 5048.0);
    assert!(counts[120] > 5048.0 + 20.0 / (500.0 / 32768.0));
}

#[test]
fn a_load_pushes_the_tool_back_by_load_over_stiffness_and_the_sensor_does_not_see_it() {
    let rigid = with(SPINDLE, "[spindle]", "loss_w_per_n = 0.0\nstiffness_n_per_um = 0.0");
    let soft = with(SPINDLE, "[spindle]", "loss_w_per_n = 0.0\nstiffness_n_per_um = 50.0");
    assert_eq!(changed(&rigid, &soft), ["measured_elongation_um", "measured_dz_um"]);
    let (rigid_um, soft_um) =
        (column(&rigid, "measured_elongation_um"), column(&soft, "measured_elongation_um"));
    for (row, load_n) in column(&rigid, "load_n").iter().enumerate() {
        // 500 N / (50 N/µm) = 10 µm, inwards.
        let expected = if *load_n == 500.0 { -10.0 } else { 0.0 };
        assert!((soft_um[row] - rigid_um[row] - expected).abs() < 2e-4);
    }
}

#[test]
fn speed_adds_its_square_at_once_and_the_sensor_sees_it() {
    let still = with(SPINDLE, "[spindle]", "centrifugal_um_per_krpm2 = 0.0");
    let fast = with(SPINDLE, "[spindle]", "centrifugal_um_per_krpm2 = 0.02");
    assert_eq!(
        changed(&still, &fast),
        ["sensor_counts", "measured_elongation_um", "measured_dz_um"]
    );
    let (still_um, fast_um) =
        (column(&still, "measured_elongation_um"), column(&fast, "measured_elongation_um"));
    for (row, rpm) in column(&still, "spindle_rpm").iter().enumerate().skip(1) {
        // 0.02 · 18² = 6.48 µm
        let expected = if *rpm == 18_000.0 { 6.48 } else { 0.0 };
        assert!((fast_um[row] - still_um[row] - expected).abs() < 2e-4);
    }
}

#[test]
fn the_sensors_faults_are_in_its_counts_alone_and_of_their_size() {
    let right = run(SPINDLE, 5);
    let counts = column(&right, "sensor_counts");
    let um = |counts: f64| (counts - 5048.0) * 500.0 / 32768.0;
    let coil = column(&right, "temp_coil_c");
    type Law = fn(f64, f64) -> f64;
    let laws: [(&str, Law); 3] = [
        ("gain = 0.8", |u, _| 0.8 * u),
        ("curvature_per_um = 0.001", |u, _| u + 0.001 * u * u),
        ("coil_um_per_c = 0.5", |u, coil_c| u + 0.5 * (coil_c - 20.0)),
    ];
    for (line, law) in laws {
        let wrong = with(SPINDLE, "[sensor]", line);
        assert_eq!(changed(&right, &wrong), ["sensor_counts"], "{line}");
        for (row, counts) in counts.iter().enumerate() {
            let there = um(column(&wrong, "sensor_counts")[row]);
            // A count each way, and the coil's thermometer shows sixteenths.
            let expected = law(um(*counts), coil[row]);
            assert!((there - expected).abs() < 0.05, "{line}: {there} is not {expected}");
        }
    }
    let low = with(SPINDLE, "[sensor]", "full_scale_counts = 6000.0");
    assert_eq!(column(&low, "sensor_counts").iter().copied().fold(0.0, f64::max), 6000.0);
}

#[test]
fn a_late_sensor_shows_what_was() {
    let right = run(SPINDLE, 5);
    let late = with(SPINDLE, "[sensor]", "delay_s = 90.0");
    assert_eq!(changed(&right, &late), ["sensor_counts"]);
    let (right, late) = (column(&right, "sensor_counts"), column(&late, "sensor_counts"));
    for row in 3..right.len() {
        assert_eq!(late[row], right[row - 3], "row {row}");
    }
    assert_eq!(late[..3], [5048.0; 3]);
}

#[test]
fn what_drops_out_is_an_empty_cell() {
    let table = with(SPINDLE, "[sensor]", "dropout = 0.2");
    let missing = column(&table, "sensor_counts").iter().filter(|c| c.is_nan()).count();
    assert!((20..61).contains(&missing), "{missing} of 201");
    let csv = table.to_csv();
    let cell = |line: &str| line.split(',').nth(2).map(str::is_empty);
    assert_eq!(csv.lines().filter(|line| cell(line) == Some(true)).count(), missing);
    assert_eq!(changed(&run(SPINDLE, 5), &table), ["sensor_counts"]);
}

#[test]
fn the_instruments_faults_are_in_what_it_measures_alone() {
    let right = run(SPINDLE, 5);
    let measured = ["measured_elongation_um", "measured_dz_um"];
    for line in [
        "drift_um_per_h = 3.0",
        "periodic_um = 1.0",
        "noise_um = 0.1",
        "jumps_per_h = 4.0\njump_um = 3.0",
        "outliers = 0.1",
    ] {
        assert_eq!(changed(&right, &with(SPINDLE, "[instrument]", line)), measured, "{line}");
    }
    let drifting = with(SPINDLE, "[instrument]", "drift_um_per_h = 3.0");
    let at = |table: &RunTable, row: usize| column(table, measured[0])[row];
    assert!((at(&drifting, 120) - at(&right, 120) - 3.0).abs() < 2e-4);
}

#[test]
fn the_shafts_account_of_heat_is_closed_over_a_whole_run() {
    use trueup_twin::spindle::{OperatingConditions, SimulatedSpindle, SpindleConfig};
    let mut spindle = SimulatedSpindle::new(&SpindleConfig::default(), 20.0);
    let start_j = spindle.shaft().stored_heat_j();
    let (mut came_j, mut sources_j) = (0.0, 0.0);
    for step in 0..5000 {
        let spindle_rpm = if step % 1000 < 700 { 24_000.0 } else { 0.0 };
        let drive =
            OperatingConditions { spindle_rpm, load_n: 300.0, ambient_c: 21.0, coolant_c: 19.0 };
        let account = spindle.step(5.0, &drive);
        came_j += account.total_heat_input_j();
        sources_j += account.from_sources_j;
    }
    let left_over = (spindle.shaft().stored_heat_j() - start_j - came_j).abs() / sources_j;
    println!("energy of the shaft closed within {left_over:.1e} of {:.0} kJ", sources_j / 1e3);
    assert!(sources_j > 1e6 && left_over < 1e-10);
}

/// Half an hour with each of two tools at 20 000 r/min, of a machine that has been warm for long.
const TOOLS: &str = r#"
name = "tools"
measure = ["elongation"]
interval_s = 60
[ambient]
amplitude_c = 0.0
wander_c = 0.0
[spindle]
cells = 20
holder_lag_s = 600.0
[thermometer.holder]
at = "holder"
[[tool]]
number = 7
centrifugal_um_per_krpm2 = 0.02
[[tool]]
number = 9
centrifugal_um_per_krpm2 = -0.01
[instrument]
quantum_um = 0.0001
[[segment]]
kind = "spindle"
tool = 7
spindle_rpm = 20000
duration_s = 86400
[[segment]]
kind = "spindle"
tool = 9
spindle_rpm = 20000
duration_s = 3600
"#;

#[test]
fn a_tool_comes_cold_out_of_the_magazine_and_warms_with_the_holders_time_constant() {
    let table = run(TOOLS, 1);
    let (tools, holder_c) = (column(&table, "tool"), column(&table, "temp_holder_c"));
    let change = tools.iter().position(|tool| *tool == 9.0).expect("it is changed");
    assert_eq!((tools[0], change), (7.0, 1441));
    let (warm_c, air_c) = (holder_c[change - 1], 20.0);
    assert!(warm_c - air_c > 2.0, "{warm_c}");
    // A row is written a minute after the change; 600 s after it 1/e of the way is left.
    let left = (warm_c - holder_c[change + 9]) / (warm_c - air_c);
    assert!((left - (-1.0_f64).exp()).abs() < 0.01, "{left}");
    // What tool 9 grows less at once: 0.03 µm · 20², and what 120 mm of cold holder are short of.
    let um = column(&table, "measured_elongation_um");
    let cold_um = 0.12 * 11.5 * (warm_c - holder_c[change]);
    assert!((um[change - 1] - um[change] - 12.0 - cold_um).abs() < 0.1 * cold_um, "{um:?}");
}

#[test]
fn a_tool_that_no_magazine_has_is_refused_with_its_place_and_without_tools_no_column_is_written() {
    let bad = |text: &str| Scenario::parse(text, Path::new("s.toml")).expect_err(text).to_string();
    let message = bad(&TOOLS.replace("tool = 9", "tool = 8"));
    assert!(message.contains("segment[1].tool is 8, which no [[tool]] has"), "{message}");
    let message = bad(&TOOLS.replace("number = 9", "number = 7"));
    assert!(message.contains("tool[1].number is 7 a second time"), "{message}");
    assert!(run(SPINDLE, 1).column("tool").is_none());
}

/// Three targets, up and down, twice; no heat.
const AXIS: &str = r#"
name = "axis"
measure = ["dx", "dy"]
[axis.x]
screw_heating_c = 0.0
[instrument]
quantum_um = 0.0001
[[segment]]
kind = "positions"
axis = "x"
range_mm = [100.0, 500.0]
targets = 3
cycles = 2
feed_mm_per_min = 6000
"#;

/// `measured_dx_um` with a line in `[axis.x]`.
fn dx(line: &str) -> Vec<f64> {
    column(&with(AXIS, "[axis.x]", line), "measured_dx_um").to_vec()
}

fn assert_near(there: &[f64], expected: &[f64]) {
    assert_eq!(there.len(), expected.len());
    for (there, expected) in there.iter().zip(expected) {
        assert!((there - expected).abs() < 1e-4, "{there} is not {expected}");
    }
}

#[test]
fn a_run_after_iso_230_2_goes_up_and_down_and_knows_its_directions() {
    let table = run(AXIS, 1);
    assert_near(column(&table, "x_mm"), &[100.0, 300.0, 500.0, 500.0, 300.0, 100.0].repeat(2));
    assert_near(column(&table, "dir_x"), &[1.0, 1.0, 1.0, -1.0, -1.0, -1.0].repeat(2));
    assert_eq!(column(&table, "run"), [[1.0; 6], [2.0; 6]].concat());
    assert_near(column(&table, "measured_dx_um"), &[0.0; 12]);
}

#[test]
fn backlash_is_nothing_from_below_and_its_width_from_above() {
    assert_near(&dx("backlash_um = 6.0"), &[0.0, 0.0, 0.0, 6.0, 6.0, 6.0].repeat(2));
    // A scale on the axis sees it.
    assert_near(&dx("backlash_um = 6.0\nfeedback = \"scale\""), &[0.0; 12]);
    // 10 µm/m from the origin at 0.
    let growing = [0.0, 0.0, 0.0, 5.0, 3.0, 1.0].repeat(2);
    assert_near(&dx("backlash_um_per_m = 10.0"), &growing);
}

#[test]
fn pre_sliding_takes_the_backlash_up_over_its_way() {
    // The overshoot is 1 mm: from there back to the target is one s₀.
    let there = dx("backlash_um = 6.0\npre_sliding_mm = 1.0");
    assert!((there[3] - 6.0 * (1.0 - (-1.0_f64).exp())).abs() < 1e-4, "{}", there[3]);
    assert!((there[4] - 6.0).abs() < 1e-4 && there[0].abs() < 1e-9);
}

#[test]
fn pitch_is_a_slope_a_curve_and_a_wave() {
    assert_near(&dx("pitch_um_per_m = 10.0")[..3], &[1.0, 3.0, 5.0]);
    let curve = dx("pitch = [[100.0, 1.0], [300.0, -2.0], [500.0, 4.0]]");
    assert_near(&curve[..3], &[1.0, -2.0, 4.0]);
    // 100 mm of 400 mm a period: a quarter turn, three quarters, five quarters.
    assert_near(&dx("periodic_um = 2.0\nperiodic_mm = 400.0")[..3], &[2.0, -2.0, 2.0]);
}

#[test]
fn a_warm_screw_is_too_long_and_a_warm_scale_too() {
    // 5 K · 11.5 µm/(m·K) · 0.5 m
    let warm = AXIS.replace("measure", "start_c = 25.0\nmeasure");
    let settled = "[axis.x]\nscrew_lag_s = 1e9\nscale_lag_s = 1e9";
    let screw = run(&warm.replace("[axis.x]", settled), 1);
    assert_near(&column(&screw, "measured_dx_um")[..3], &[5.75, 17.25, 28.75]);
    let scale = run(&warm.replace("[axis.x]", &format!("{settled}\nfeedback = \"scale\"")), 1);
    assert_near(&column(&scale, "measured_dx_um")[..3], &[5.0, 15.0, 25.0]);
}

#[test]
fn one_axis_is_seen_on_another_by_straightness_squareness_and_abbe() {
    let bent = format!(
        "{AXIS}\n[[straightness]]\nerror = \"y\"\nalong = \"x\"\num_per_m = 2.0\npoints = [[100.0, \
         0.0], [300.0, 3.0], [500.0, 0.0]]\n"
    );
    let table = run(&bent, 1);
    assert_eq!(changed(&run(AXIS, 1), &table), ["measured_dy_um"]);
    assert_near(&column(&table, "measured_dy_um")[..3], &[0.2, 3.6, 1.0]);
    let abbe = format!(
        "{AXIS}\n[[abbe]]\nerror = \"x\"\nalong = \"x\"\narm = \"z\"\narm_zero_mm = -200.0\npoints = \
         [[100.0, 0.0], [500.0, 20.0]]\n"
    );
    let table = run(&abbe, 1);
    assert_eq!(changed(&run(AXIS, 1), &table), ["measured_dx_um"]);
    // 20 µm/m · 0.2 m at the end, half of it in the middle.
    assert_near(&column(&table, "measured_dx_um")[..3], &[0.0, 2.0, 4.0]);
}
