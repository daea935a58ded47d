//! `[[term]]`: read, applied to the prediction, written back. Each cause's formula by hand.

#[path = "terms/by_speed.rs"]
mod by_speed;
#[path = "terms/dependence.rs"]
mod dependence;
#[path = "terms/feed.rs"]
mod feed;
#[path = "terms/late.rs"]
mod late;
#[path = "terms/lively.rs"]
mod lively;
#[path = "terms/refused.rs"]
mod refused;

use std::path::Path;

use trueup_machine::{
    Machine, MachineFile, RunFile,
    effect::{Cause, Effect, Outliers, Quantity},
    machine_file::{Term, writer::MachineFileEdit},
    predict::{RowPrediction, RunPredictor},
};

const HEAD: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
const SENSOR: &str = "[spindle]\nsource = \"sensor\"\n[spindle.sensor]\nk0_um = 0.0\n\
                      zero_counts = 0.0\num_per_count = 0.5\n";
const TEMPERATURE: &str = "[spindle]\nsource = \"temperature\"\n[spindle.temperature]\n\
                           sensor = \"temp_a_c\"\nreference_c = 20.0\nk_um_per_c = 2.0\n";
const WARMUP: &str = "[spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 0.0\n\
                      warm_s = 400.0\nmax_um = 80.0\nexponent = 4.0\n";
const AXIS: &str = "[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_a_c\"\n\
                    reference_c = 20.0\nslope_um_per_m_per_c = 10.0\n";

const SHIFTING: &str = "[axis.x.thermal]\nmode = \"both\"\nsensor = \"temp_a_c\"\n\
                        reference_c = 20.0\nconstant_um_per_c = 3.0\nslope_um_per_m_per_c = 10.0\n";

const EXPANSION: &str = "column = \"temp_b_c\"\num_per_m_per_c = 11.5\ntime_constant_s = 90.0\n\
                         reference_c = 20.5\norigin_mm = -100.0";

fn machine(sections: &str, terms: &str) -> Machine {
    let text = format!("{HEAD}{sections}{terms}");
    MachineFile::parse(&text, Path::new("m.toml")).unwrap_or_else(|error| panic!("{error}"))
}

/// Returns what the machine predicts for `quantity` in each row of `csv`.
fn predicted(sections: &str, terms: &str, quantity: Quantity, csv: &str) -> Vec<f64> {
    let machine = machine(sections, terms);
    let run = RunFile::from_reader(csv.as_bytes(), Path::new("r.csv")).expect("a run");
    let predictor = RunPredictor::new(&machine, &run).unwrap_or_else(|error| panic!("{error}"));
    let index = Quantity::ALL.iter().position(|other| *other == quantity).expect("one of all");
    predictor.predictions().map(|row| row.model.to_array()[index]).collect()
}

fn assert_near(got: &[f64], target: &[f64]) {
    assert_eq!(got.len(), target.len());
    for (got, target) in got.iter().zip(target) {
        assert!((got - target).abs() < 1e-9, "{got} is not {target}");
    }
}

fn term(quantity: &str, keys: &str) -> String {
    format!("[[term]]\nquantity = \"{quantity}\"\n{keys}\n")
}

#[test]
fn what_a_sensor_does_wrong() {
    // p is 0, 10 and 50 µm.
    let csv = "sensor_counts,temp_coil_c\n0,30\n20,25\n100,20\n";
    for (keys, expected) in [
        ("cause = \"sensor-offset\"\noffset_um = -4.0", [-4.0, 6.0, 46.0]),
        ("cause = \"sensor-gain\"\ngain = 1.3", [0.0, 13.0, 65.0]),
        ("cause = \"sensor-gain\"\ngain = 1.3\nconstant_um = -4.0", [-4.0, 9.0, 61.0]),
        ("cause = \"sensor-curvature\"\nper_um = 0.01", [0.0, 11.0, 75.0]),
        ("cause = \"sensor-saturation\"\nlimit_um = 40.0", [0.0, 10.0, 40.0]),
        (
            "cause = \"sensor-temperature-drift\"\ncolumn = \"temp_coil_c\"\num_per_c = 0.2\n\
             reference_c = 20.0",
            [2.0, 11.0, 50.0],
        ),
        ("cause = \"growth-amplitude\"\nscale = 0.5", [0.0, 5.0, 25.0]),
    ] {
        let got = predicted(SENSOR, &term("elongation", keys), Quantity::Elongation, csv);
        assert_near(&got, &expected);
        // Growth is an error of s·V, V pointing down: the tip is too low.
        let dz = predicted(SENSOR, &term("elongation", keys), Quantity::Dz, csv);
        assert_near(&dz, &expected.map(|um| -um));
    }
}

/// By hand: the sensor's law is 10 µm; 2·10 = 20; 20 + 0.01·20² = 24; at most 23; then what is added:
/// 1, 0.5·(3/1)² = 4.5 of the speed, and the gain's constant of 7: 35.5 µm.
#[test]
fn a_sensors_causes_act_on_its_law_alone_whatever_the_order_in_the_file() {
    let terms = [
        "cause = \"sensor-gain\"\ngain = 2.0\nconstant_um = 7.0",
        "cause = \"sensor-curvature\"\nper_um = 0.01",
        "cause = \"sensor-saturation\"\nlimit_um = 23.0",
        "cause = \"sensor-offset\"\noffset_um = 1.0",
        "cause = \"centrifugal-growth\"\num_per_krpm2 = 0.5",
    ]
    .map(|keys| term("elongation", keys));
    let csv = "sensor_counts,spindle_rpm\n20,3000\n";
    for rotated in 0..terms.len() {
        let mut file = terms.clone();
        file.rotate_left(rotated);
        file[1..].reverse();
        assert_near(&predicted(SENSOR, &file.concat(), Quantity::Elongation, csv), &[35.5]);
        // And so on the board.
        let machine = machine(&format!("{SENSOR}{INPUTS}"), &file.concat());
        let run = RunFile::from_reader(csv.as_bytes(), Path::new("r.csv")).expect("a run");
        let predictor = RunPredictor::new(&machine, &run).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(predictor.bridge_error(), None);
        let row = predictor.predictions().next().expect("a row");
        assert!(row.arithmetic_error_nm().expect("a bridge") <= 1.0, "{row:?}");
    }
}

#[test]
fn a_lag_is_the_lag_of_the_temperature_and_may_differ_as_it_falls() {
    let csv = "time_s,temp_a_c\n0,20\n100,30\n200,20\n";
    let e = (-1.0_f64).exp();
    let lag = term("elongation", "cause = \"thermal-lag\"\ntime_constant_s = 100.0");
    let got = predicted(TEMPERATURE, &lag, Quantity::Elongation, csv);
    assert_near(&got, &[0.0, 20.0 * (1.0 - e), 20.0 * (1.0 - e) * e]);
    let slower =
        lag.clone() + &term("elongation", "cause = \"cooling-asymmetry\"\ntime_constant_s = 50.0");
    let got = predicted(TEMPERATURE, &slower, Quantity::Elongation, csv);
    assert_near(&got, &[0.0, 20.0 * (1.0 - e), 20.0 * (1.0 - e) * e * e]);
}

#[test]
fn heat_next_to_the_models_own() {
    let csv = "time_s,temp_a_c,temp_b_c\n0,20,25\n100,30,35\n";
    let e = (-1.0_f64).exp();
    let path = |cause: &str, column: &str, lag: &str| {
        let keys = format!(
            "cause = \"{cause}\"\ncolumn = \"{column}\"\num_per_c = -3.0\nreference_c = 25.0{lag}"
        );
        predicted(TEMPERATURE, &term("elongation", &keys), Quantity::Elongation, csv)
    };
    assert_near(&path("extra-heat-path", "temp_b_c", ""), &[0.0, 20.0 - 30.0]);
    let lagged = path("extra-heat-path", "temp_b_c", "\ntime_constant_s = 100.0");
    assert_near(&lagged, &[0.0, 20.0 - 30.0 * (1.0 - e)]);
    let own = path("slow-mode", "temp_a_c", "\ntime_constant_s = 100.0");
    assert_near(&own, &[15.0, 20.0 - 3.0 * (10.0 * (1.0 - e) - 5.0)]);
    let keys = "cause = \"slow-mode\"\namplitude_um = 8.0\ntime_constant_s = 50.0\nstart_s = 50.0";
    let timed = predicted(TEMPERATURE, &term("elongation", keys), Quantity::Elongation, csv);
    assert_near(&timed, &[0.0, 20.0 + 8.0 * (1.0 - e)]);
}

#[test]
fn a_warm_up_with_another_rate_has_no_end() {
    let csv = "time_s\n0\n100\n1000\n";
    let rate = term("elongation", "cause = \"growth-rate\"\ntime_constant_s = 100.0");
    let got = predicted(WARMUP, &rate, Quantity::Elongation, csv);
    assert_near(&got, &[0.0, 80.0 * (1.0 - (-1.0_f64).exp()), 80.0 * (1.0 - (-10.0_f64).exp())]);
}

#[test]
fn speed_stretches_and_the_cut_pushes_back() {
    let csv = "sensor_counts,spindle_rpm,load_n\n20,-12000,0\n20,0,500\n";
    for (keys, expected) in [
        ("cause = \"centrifugal-growth\"\num_per_krpm2 = 0.05", [17.2, 10.0]),
        ("cause = \"cutting-load\"\num_per_n = 0.01", [10.0, 5.0]),
    ] {
        let got = predicted(SENSOR, &term("elongation", keys), Quantity::Elongation, csv);
        assert_near(&got, &expected);
    }
}

#[test]
fn an_axis_expands_by_its_right_slope_from_its_right_temperature() {
    let csv = "x_mm,temp_a_c\n0,30\n500,30\n";
    for (keys, expected) in [
        ("cause = \"expansion-slope\"\num_per_m_per_c = 12.0", [0.0, 60.0]),
        ("cause = \"reference-temperature\"\nshift_c = 2.0", [0.0, 40.0]),
        ("cause = \"reference-temperature\"\nshift_c = 2.0\nconstant_um = 1.5", [1.5, 41.5]),
    ] {
        assert_near(&predicted(AXIS, &term("dx", keys), Quantity::Dx, csv), &expected);
    }
}

/// 10 K above its reference, at 0 and at half a metre: −1.5 µm/K everywhere, and 10 µm/(m·K).
#[test]
fn an_axis_shifts_by_its_right_constant_in_place_of_the_believed_one() {
    let csv = "x_mm,temp_a_c\n0,30\n500,30\n";
    let term = term("dx", "cause = \"expansion-constant\"\num_per_c = -1.5");
    assert_near(&predicted(SHIFTING, "", Quantity::Dx, csv), &[30.0, 80.0]);
    assert_near(&predicted(SHIFTING, &term, Quantity::Dx, csv), &[-15.0, 35.0]);
}

#[test]
fn what_an_axis_does_wrong() {
    let csv = "x_mm,y_mm,dir_x\n0,100,1\n250,100,1\n250,300,-1\n";
    for (keys, expected) in [
        ("cause = \"pitch-scale\"\num_per_m = 8.0", [0.0, 2.0, 2.0]),
        (
            "cause = \"pitch-error\"\nstart_mm = 0.0\nstep_mm = 500.0\nforward_um = [1.0, 5.0]\n\
             reverse_um = [2.0, 4.0]",
            [1.0, 3.0, 3.0],
        ),
        ("cause = \"backlash\"\nwidth_um = -25.0", [0.0, 0.0, -25.0]),
        ("cause = \"position-dependent-backlash\"\num_per_m = 8.0", [0.0, 0.0, 2.0]),
        ("cause = \"cross-axis\"\naxis = \"y\"\num_per_m = 10.0", [1.0, 1.0, 3.0]),
        (
            "cause = \"straightness\"\nalong = \"y\"\norder = 2\nknots_mm = [0.0, 0.0, 400.0, 400.0]\n\
             control_um = [0.0, 4.0]",
            [1.0, 1.0, 3.0],
        ),
        // µrad times mm are nm: 20 µrad/m at 250 mm are 5 µrad, which at levers of 100 − 50 and of
        // 300 − 50 mm are 0.25 and 1.25 µm.
        (
            "cause = \"angular-error\"\nlever = \"y\"\norigin_mm = 50.0\nurad_per_m = 20.0",
            [0.0, 0.25, 1.25],
        ),
        // 10 µrad at a lever of 100 mm are 1 µm.
        (
            "cause = \"angular-error\"\nlever = \"y\"\norder = 2\nknots_mm = [0.0, 0.0, 250.0, 250.0]\n\
             control_urad = [0.0, 10.0]",
            [0.0, 1.0, 3.0],
        ),
        // sin(2π·0 + 90°) = 1, and 250 of 1000 mm are another quarter.
        (
            "cause = \"pitch-periodic\"\nperiod_mm = 1000.0\namplitude_um = 3.0\nphase_deg = 90.0",
            [3.0, 0.0, 0.0],
        ),
        (
            "cause = \"pitch-periodic\"\nperiod_mm = 1000.0\nharmonic = [1, 2]\n\
             amplitude_um = [3.0, 1.0]\nphase_deg = [0.0, 90.0]",
            [1.0, 2.0, 2.0],
        ),
        // C/(P + P₀) = 250/500 and 250/750 of a turn.
        (
            "cause = \"reference-instrument\"\nperiod_mm = 250.0\norigin_mm = 500.0\n\
             amplitude_um = 2.0",
            [0.0, 3.0_f64.sqrt(), 3.0_f64.sqrt()],
        ),
    ] {
        assert_near(&predicted("", &term("dx", keys), Quantity::Dx, csv), &expected);
    }
}

#[test]
fn what_only_explains_is_predicted_and_not_for_the_board() {
    let csv = "time_s,sensor_counts\n0,0\n1800,20\n3600,40\n";
    for (keys, expected) in [
        ("cause = \"step\"\nat_s = 1800.0\nsize_um = 3.0", [0.0, 13.0, 23.0]),
        ("cause = \"drift\"\num_per_h = 2.0", [0.0, 11.0, 22.0]),
        ("cause = \"time-shift\"\nshift_s = 900.0", [0.0, 5.0, 15.0]),
        ("cause = \"time-shift\"\nshift_s = -900.0", [5.0, 15.0, 20.0]),
        ("cause = \"outliers\"\nfraction = 0.02", [0.0, 10.0, 20.0]),
        ("cause = \"reference-instrument\"\ndescription = \"a \\\"laser\\\"\"", [0.0, 10.0, 20.0]),
    ] {
        let terms = term("elongation", keys);
        assert_near(&predicted(SENSOR, &terms, Quantity::Elongation, csv), &expected);
        let machine = machine(SENSOR, &terms);
        let run = RunFile::from_reader(csv.as_bytes(), Path::new("r.csv")).expect("a run");
        let predictor = RunPredictor::new(&machine, &run).expect("all columns are there");
        let board: Vec<f64> =
            predictor.predictions().map(|row| row.compensated.elongation_um).collect();
        assert_near(&board, &[0.0, 10.0, 20.0]);
    }
}

#[test]
fn a_missing_value_makes_what_needs_it_missing() {
    let csv = "time_s,sensor_counts,load_n\n0,20,\n1,20,100\n";
    let load = term("elongation", "cause = \"cutting-load\"\num_per_n = 0.01");
    let got = predicted(SENSOR, &load, Quantity::Elongation, csv);
    assert!(got[0].is_nan() && (got[1] - 9.0).abs() < 1e-12);
}

#[test]
fn an_axis_without_a_law_of_its_own_grows_by_its_term() {
    let csv = "time_s,temp_b_c,x_mm\n0,20,0\n10,30,0\n20,30,900\n";
    let of = |lag_s: f64| {
        let keys = EXPANSION.replace("90.0", &format!("{lag_s:?}"));
        let term = term("dx", &format!("cause = \"axis-expansion\"\n{keys}"));
        predicted("", &term, Quantity::Dx, csv)
    };
    assert_near(&of(0.0), &[11.5 * -0.5 * 0.1, 11.5 * 9.5 * 0.1, 11.5 * 9.5]);
    let lagged_c = |rows: i32| 30.0 - 10.0 * (-10.0 * f64::from(rows) / 90.0_f64).exp();
    assert_near(&of(90.0)[1..], &[11.5 * (lagged_c(1) - 20.5) * 0.1, 11.5 * (lagged_c(2) - 20.5)]);
}

/// c·ΔT·ΔP + a·ΔP + b·ΔT about any references is c·(T − T_ref)·(P − P₀) and a constant.
#[test]
fn the_references_of_an_expansion_come_from_its_amplitudes() {
    let Effect::AxisExpansion(page) =
        machine("", &term("dx", &format!("cause = \"axis-expansion\"\n{EXPANSION}"))).terms[0]
            .effect
            .clone()
    else {
        panic!("it was read")
    };
    let neutral = Effect::AxisExpansion(page);
    for amplitudes in [[8.0, 30.0, -0.4], [-2.0, 0.0, 3.0], [5.0, 0.0, 0.0]] {
        let values = [&[60.0][..], &amplitudes].concat();
        let fitted = neutral.with_values(&values);
        let constant_um = neutral.constant_um(&values);
        for x in [[20.5, -100.0], [31.0, 700.0], [-4.0, 12.0]] {
            let apart_um = fitted.evaluate_at(&fitted.values(), &x) + constant_um
                - neutral.evaluate_at(&values, &x);
            assert!(apart_um.abs() < 1e-9, "{apart_um} {fitted:?}");
        }
    }
}

#[test]
fn the_board_runs_one_thermal_law_for_an_axis() {
    let expansion = term("dx", &format!("cause = \"axis-expansion\"\n{EXPANSION}"));
    let compiled =
        |terms: &str| trueup_machine::compile(&machine(&format!("{INPUTS}{SENSOR}"), terms));
    compiled(&expansion).expect("it takes the place of the law that the axis has not");
    let both = compiled(&expansion.repeat(2)).expect_err("two laws");
    assert!(both.to_string().contains("term[1] is too much: the board runs one"), "{both}");
}

/// Returns one of each, so that a new cause without a line here is noticed.
fn one_of_each() -> Vec<(&'static str, String)> {
    let wave =
        "period_mm = 5.0\nharmonic = [1, 4]\namplitude_um = [1.0, 0.1]\nphase_deg = [0.1, 7.0]";
    let spline =
        "along = \"y\"\norder = 2\nknots_mm = [0.0, 0.0, 9.0, 9.0]\ncontrol_um = [0.0, 0.1]";
    let tilt = "along = \"z\"\nlever = \"y\"\norder = 2\nknots_mm = [-1000.0, -1000.0, 1000.0, 1000.0]\n\
                control_urad = [250.0, -250.0]";
    let table = "start_mm = 0.5\nstep_mm = 2.0\nforward_um = [1.0, 0.1]\nreverse_um = [0.3, 1e-7]";
    let path = "column = \"temp_b_c\"\num_per_c = 0.1\nreference_c = 20.0\ntime_constant_s = 7.0";
    [
        (SENSOR, "elongation", "sensor-offset", "offset_um = 0.1"),
        (SENSOR, "elongation", "sensor-gain", "gain = 1.1"),
        (SENSOR, "elongation", "sensor-curvature", "per_um = 1e-4"),
        (SENSOR, "elongation", "sensor-saturation", "limit_um = 50.0"),
        (
            SENSOR,
            "elongation",
            "sensor-temperature-drift",
            "column = \"temp_coil_c\"\num_per_c = 0.1\nreference_c = 20.0",
        ),
        (SENSOR, "elongation", "time-shift", "shift_s = 3.0"),
        (TEMPERATURE, "elongation", "thermal-lag", "time_constant_s = 1630.0"),
        (TEMPERATURE, "elongation", "thermometer-lag", "time_constant_s = 8.5\nform = \"delay\""),
        (AXIS, "dx", "thermometer-lag", "time_constant_s = 40.0\nform = \"lag\"\nslope_over = 0.3"),
        (SENSOR, "elongation", "slow-mode", "amplitude_um = 3.0\ntime_constant_s = 900.0"),
        (TEMPERATURE, "elongation", "slow-mode", path),
        (TEMPERATURE, "elongation", "extra-heat-path", path),
        (AXIS, "dx", "extra-heat-path", by_speed::LINEAR),
        (SENSOR, "elongation", "extra-heat-path", by_speed::SQUARE),
        (TEMPERATURE, "elongation", "growth-amplitude", "scale = 1.1"),
        (WARMUP, "elongation", "growth-rate", "time_constant_s = 90.0"),
        (WARMUP, "elongation", "cooling-asymmetry", "time_constant_s = 90.0"),
        (SENSOR, "dx", "axis-expansion", EXPANSION),
        (SHIFTING, "dx", "expansion-constant", "um_per_c = -1.5"),
        (AXIS, "dx", "expansion-slope", "um_per_m_per_c = 11.0"),
        (AXIS, "dx", "reference-temperature", "shift_c = 0.5"),
        (SENSOR, "elongation", "centrifugal-growth", "um_per_krpm2 = 0.1"),
        (SENSOR, "elongation", "cutting-load", "um_per_n = 0.1"),
        (AXIS, "dx", "pitch-scale", "um_per_m = 3.0"),
        (AXIS, "dx", "pitch-error", table),
        (AXIS, "dx", "pitch-periodic", wave),
        (AXIS, "dx", "backlash", "width_um = 3.0"),
        (AXIS, "dx", "position-dependent-backlash", "um_per_m = 3.0"),
        (
            AXIS,
            "dx",
            "feed-dependent-backlash",
            "feeds_mm_per_min = [100.0, 1000.0]\nwidth_um = [6.0, 11.0]\nat_feed_mm_per_min = 1000.0",
        ),
        (AXIS, "dx", "straightness", spline),
        (AXIS, "dx", "cross-axis", "axis = \"z\"\num_per_m = 3.0"),
        (AXIS, "dx", "angular-error", "lever = \"z\"\norigin_mm = -40.0\nurad_per_m = 30.0"),
        (AXIS, "dx", "angular-error", tilt),
        (SENSOR, "elongation", "dependence", dependence::HINGE),
        (SENSOR, "elongation", "dependence", dependence::LEVEL_BY_SPEED),
        (SENSOR, "elongation", "dependence", dependence::LEVEL_BY_GROWTH),
        (AXIS, "dx", "dependence", dependence::LINE_BY_POSITION),
        (AXIS, "dx", "dependence", dependence::HEAT_BY_POSITION),
        (AXIS, "dx", "dependence", dependence::RISE_BY_POSITION),
        (AXIS, "dx", "dependence", dependence::TOOL_BY_POSITION),
        (AXIS, "dx", "dependence", dependence::SWITCH),
        (SENSOR, "elongation", "dependence", dependence::SWITCH_BEHIND_A_LAG),
        (AXIS, "dx", "dependence", dependence::SWITCH_BY_SPEED),
        (SENSOR, "elongation", "dependence", dependence::SWITCH_BY_GROWTH),
        (SENSOR, "elongation", "dependence", dependence::LATE_LINE),
        (AXIS, "dx", "dependence", dependence::CURVE),
        (SENSOR, "elongation", "dependence", dependence::LATE_DIFFERENCE),
        (SENSOR, "elongation", "dependence", dependence::LEVEL_IN_A_RANGE),
        (SENSOR, "elongation", "centrifugal-growth", dependence::GROWTH_IN_A_RANGE),
        (AXIS, "dx", "step", "at_s = 4.0\nsize_um = 3.0"),
        (AXIS, "dx", "drift", "um_per_h = 3.0"),
        (AXIS, "dx", "drift", "um_per_run = -0.5"),
        (AXIS, "dx", "periodic-in-time", "period_s = 900.0\namplitude_um = 2.0\nphase_deg = 30.0\nstart_s = 60.0"),
        (AXIS, "dx", "outliers", "fraction = 0.01"),
        (AXIS, "dx", "reference-instrument", wave),
    ]
    .map(|(sections, quantity, cause, keys)| {
        (sections, term(quantity, &format!("cause = \"{cause}\"\nconstant_um = 0.25\n{keys}")))
    })
    .into()
}

/// Terms as they stand in a machine file.
fn written(terms: &[Term]) -> String {
    let appended = terms.iter().map(Term::to_section).collect();
    MachineFileEdit { appended, ..MachineFileEdit::default() }.to_toml()
}

#[test]
fn every_cause_is_read_and_written_back_to_the_same_numbers() {
    let mut seen = Vec::new();
    for (sections, text) in one_of_each() {
        let terms = machine(sections, &text).terms;
        let again = written(&terms);
        assert_eq!(machine(sections, &again).terms, terms, "{again}");
        seen.push(terms[0].effect.cause());
    }
    for cause in Cause::ALL {
        assert!(seen.contains(cause), "{} is not tried", cause.name());
    }
}

const INPUTS: &str = "[inputs]\nsensor = { volts_full_scale = 10.0, counts_full_scale = 4096, \
                      divider = 0.33 }\ntemp_a_c = { channel = 3, kind = \"pt100\" }\n\
                      temp_b_c = { channel = 1, kind = \"pt100\" }\n\
                      temp_coil_c = { channel = 6, kind = \"pt100\" }\n\
                      coolant_on = { kind = \"condition\", bit = 15 }\n";

#[test]
fn the_board_runs_every_term_that_compensates_as_the_model_says() {
    let csv = lively::lively_run();
    let run = RunFile::from_reader(csv.as_bytes(), Path::new("r.csv")).expect("a run");
    let mut worst: f64 = 0.0;
    for (sections, text) in one_of_each() {
        let machine = machine(&format!("{INPUTS}{sections}"), &text);
        let predictor = RunPredictor::new(&machine, &run).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(predictor.bridge_error(), None, "{text}");
        let mut largest: f64 = 0.0;
        let mut moved: f64 = 0.0;
        let plain = Machine { terms: Vec::new(), ..machine.clone() };
        let plain = RunPredictor::new(&plain, &run).expect("it has the columns");
        for (row, plain) in predictor.predictions().zip(plain.predictions()) {
            largest = largest.max(row.arithmetic_error_nm().expect("a bridge"));
            let board = |of: &RowPrediction| of.bridge.expect("as above").to_array();
            for (with, without) in board(&row).into_iter().zip(board(&plain)) {
                moved = moved.max((with - without).abs());
            }
        }
        let effect = &machine.terms[0].effect;
        println!("{:28} {largest:7.3} nm of {moved:8.3} µm", effect.name());
        assert_eq!(moved > 0.01, effect.is_compensable(), "{text}: {moved} µm");
        // Half a nanometre is the reading's and the result's rounding; heat is stepped at 100 ms.
        assert!(largest < 6.0, "{text}: {largest} nm");
        worst = worst.max(largest);
    }
    println!("the board is within {worst:.3} nm of the model with every term");
}

#[test]
fn an_angle_at_a_long_lever_is_within_a_nanometre_of_the_model() {
    let spline = "order = 4\nknots_mm = [-20000.0, -20000.0, -20000.0, -20000.0, 100.0, 20000.0, 20000.0, \
                  20000.0, 20000.0]\ncontrol_urad = [0.0, 90.0, -150.0, 60.0, 1.0]";
    let mut csv = "x_mm,y_mm,z_mm\n".to_string();
    for (row, n) in (-79..=79).enumerate() {
        let lever = [-20_000, 20_000, 137, 15_000][row % 4];
        csv += &format!("{},{lever},0\n", n * 251);
    }
    let run = RunFile::from_reader(csv.as_bytes(), Path::new("r.csv")).expect("a run");
    for angle in ["urad_per_m = 3.3", spline] {
        let keys = format!("cause = \"angular-error\"\nlever = \"y\"\norigin_mm = 70.0\n{angle}");
        let machine = machine("", &term("dx", &keys));
        let predictor = RunPredictor::new(&machine, &run).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(predictor.bridge_error(), None, "{angle}");
        let apart = predictor.predictions().map(|row| row.arithmetic_error_nm().expect("a bridge"));
        let worst = apart.fold(0.0, f64::max);
        println!("an angle at levers of 20 m: {worst:.3} nm");
        assert!(worst < 1.0, "{worst} nm: {angle}");
    }
}

#[test]
fn a_calibration_with_terms_is_shown_and_compiles_back() {
    for (sections, text) in one_of_each() {
        let machine = machine(&format!("{INPUTS}{sections}"), &text);
        let compiled = trueup_machine::compile(&machine).unwrap_or_else(|error| panic!("{error}"));
        let shown = trueup_machine::decompile::decompile_to_toml(&compiled.calibration());
        let apart = shown.largest_difference_nm.unwrap_or_else(|why| panic!("{why}: {text}"));
        assert!(apart < 1.0, "{apart} nm: {text}");
    }
}

#[test]
fn a_constant_alone_shifts_the_prediction() {
    let term = Term {
        quantity: Quantity::Dy,
        constant_um: 2.5,
        effect: Effect::Outliers(Outliers { fraction: 0.0 }),
    };
    assert_near(&predicted("", &written(&[term]), Quantity::Dy, "y_mm\n1\n2\n"), &[2.5, 2.5]);
}
