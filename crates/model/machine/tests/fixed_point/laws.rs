//! Laws on their own: the paper's sensor, the warm-up, a lagging axis; and what cannot be run.

use std::path::Path;

use trueup_core::{
    machine_position::MachinePosition,
    thermal_state::MachineThermalState,
    units::{Position, Rpm, SensorReading, Temperature},
};
use trueup_machine::{
    RunFile, compile,
    model::{ReferenceModel, RowInputs},
};
use trueup_numerics::line::{ErrorStatistics, fit_line};

use crate::{gantry::*, rig::*};

#[test]
fn neither_32768_nor_27648_counts_explain_table_1_and_a_fitted_line_does() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../data");
    let run = RunFile::read(&data.join("spindle_paper_table1.csv")).expect("the project's own");
    let counts = run.require_column("sensor_counts").expect("a column of the file");
    let dial_um = run.require_column("measured_elongation_um").expect("a column of the file");
    let sensor = |k0: f64, um_per_count: f64| {
        let constants =
            format!("k0_um = {k0:?}\nzero_counts = 5048.0\num_per_count = {um_per_count:?}\n");
        let sections = format!("[spindle]\nsource = \"sensor\"\n[spindle.sensor]\n{constants}");
        let (machine, compiled) = compiled(&machine_of("\"3-axis\"", &sections));
        let law = compiled.calibration().spindle.sensor;
        let board_um: Vec<f64> = counts
            .iter()
            .map(|&counts| {
                let nm = f64::from(law.elongation(SensorReading((counts * 128.0) as i32)).0);
                assert!((nm - machine.elongation_um(counts) * 1_000.0).abs() <= 1.1, "{counts}");
                nm / 1_000.0
            })
            .collect();
        let left: Vec<f64> = dial_um.iter().zip(&board_um).map(|(dial, um)| dial - um).collect();
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let through_zero = product(&board_um, dial_um) / product(&board_um, &board_um);
        let line = fit_line(&board_um, dial_um).expect("15 rows with spread");
        (
            through_zero,
            line,
            ErrorStatistics::from_residuals(&left).expect("15 rows").rms,
            law.slope.0,
        )
    };
    let near = |value: f64, expected: f64, tolerance: f64| {
        assert!((value - expected).abs() <= tolerance, "{value} is not {expected}");
    };
    let (zero, line, rms, paper_slope) = sensor(0.0, 500.0 / 32_768.0);
    println!(
        "32768 counts: gain {zero:.4} through zero, {:.4} with an offset, rms {rms:.2}",
        line.gain
    );
    near(zero, 1.21, 0.01);
    near(line.gain, 1.2975, 0.001);
    near(rms, 9.38, 0.01);
    let (fitted_gain, fitted_offset) = (line.gain, line.offset);
    // An S7 input has 27648 counts at 10 V: 32768/27648 = 1.185 more for each.
    let (zero, line, rms, s7_slope) = sensor(0.0, 500.0 / 27_648.0);
    println!(
        "27648 counts: gain {zero:.4} through zero, {:.4} with an offset, rms {rms:.2}",
        line.gain
    );
    near(f64::from(s7_slope) / f64::from(paper_slope), 32_768.0 / 27_648.0, 1e-7);
    near(line.gain, 1.2975 * 27_648.0 / 32_768.0, 0.001);
    assert!(line.gain > 1.05 && rms > 2.0, "still not the dial's");
    // The linear law is right, its constants are not.
    let (_, line, rms, _) = sensor(fitted_offset, fitted_gain * 500.0 / 32_768.0);
    near(line.gain, 1.0, 1e-4);
    near(rms, 0.835, 0.01);
}

// What is refused.

#[test]
fn what_cannot_be_run_is_refused_with_its_place_and_the_rule() {
    const HEAD: &str = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n";
    let warmup = "[spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 60\nwarm_s = 5400\n\
                  max_um = 80\nexponent = 0.005\n";
    let curve = |knots: &str, control: &str| {
        format!("[straightness.z_of_x]\norder = 2\nknots_mm = {knots}\ncontrol_um = {control}\n")
    };
    let cases = [
        (
            "[axis.x.pitch]\nstart_mm = 5\nstep_mm = 10\nforward_um = [0, 0, 401]\n".to_string(),
            "4:9",
            "axis.x.pitch rises by 40.1 µm per mm at 15 mm, more than 40. At a slew of 20",
        ),
        (
            "[axis.x.pitch]\nstart_mm = 0\nstep_mm = 1\nforward_um = [0, 0]\n\
             reverse_um = [0, -40.5]\n"
                .to_string(),
            "4:9",
            "axis.x.pitch rises by -40.5 µm per mm at 0 mm, more than 40",
        ),
        (
            curve("[0, 0, 10, 10]", "[0, 401]"),
            "4:15",
            "straightness.z_of_x rises by 40.1 µm per mm at ",
        ),
        (
            "[[term]]\ncause = \"pitch-periodic\"\nquantity = \"dx\"\nperiod_mm = 5.94\namplitude_um = 38.45\n\
             phase_deg = 0.0\n"
                .to_string(),
            "4:1",
            "term[0] rises by 40.7 µm per mm at 0 mm, more than 40",
        ),
        (
            "[limits]\nslew_um_per_s = 5\n[axis.x.pitch]\nstart_mm = 0\nstep_mm = 1\nforward_um = \
             [0, 10.5]\n"
                .to_string(),
            "6:9",
            "axis.x.pitch rises by 10.5 µm per mm at 0 mm, more than 10. At a slew of 5",
        ),
        (
            curve("[0, 0, 5, 5.000001, 10, 10]", "[0, 1, 1, 0]"),
            "4:15",
            "straightness.z_of_x has knots at 5 and 5.000001 mm, closer than the board's 10 nm",
        ),
        (
            "[axis.x.thermal]\nmode = \"both\"\nsensor = \"temp_screw_c\"\nreference_c = 20\n"
                .to_string(),
            "6:10",
            "axis.x.thermal.sensor is \"temp_screw_c\", which [inputs] does not describe",
        ),
        (
            "[spindle]\nsource = \"temperature\"\n[spindle.temperature]\nsensor = \"temp_a_c\"\n\
             reference_c = 20\nk_um_per_c = 2\n"
                .to_string(),
            "7:10",
            "spindle.temperature.sensor is \"temp_a_c\", which [inputs] does not describe",
        ),
        (warmup.to_string(), "6:10", "spindle.warmup exponent 0.005 is below the board's 0.008"),
    ];
    for (sections, place, phrase) in cases {
        let error = compile(&parse(&format!("{HEAD}{sections}"))).expect_err(phrase).to_string();
        assert!(error.starts_with(&format!("m.toml:{place}: {phrase}")), "{error}");
    }
    // 3000 points of 4 bytes both ways are 24 kB.
    let points = list(vec![0.5; 3_000]);
    let large = format!(
        "{HEAD}[axis.x.pitch]\nstart_mm = 0\nstep_mm = 1\nforward_um = {points}\nreverse_um = {points}\n"
    );
    let error = compile(&parse(&large)).expect_err("too large").to_string();
    assert!(error.starts_with("m.toml:1:2: machine is too much for the board: "), "{error}");
    assert!(error.ends_with("the tables and curves have to be shorter"), "{error}");
}

// Time.

#[test]
fn any_speed_heats_within_1_nm_of_80_um() {
    let mut worst = (0.0, String::new());
    for speed_exponent in ["0.5", "1", "2.3"] {
        for rated_rpm in [3_000.0, 12_000.0, 24_000.0, 40_000.0_f64] {
            let sections = format!(
                "[spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 60\nwarm_s = 5400\n\
                 max_um = 80\nexponent = 4\nrated_rpm = {rated_rpm}\nspeed_exponent = {speed_exponent}\n"
            );
            let (_, compiled) = compiled(&machine_of("\"3-axis\"", &sections));
            let warmup = compiled.calibration().spindle.warmup.expect("written above");
            let p: f64 = speed_exponent.parse().expect("a number");
            let mut here = (0.0, 0);
            for rpm in 1..=u16::MAX {
                let exact = (f64::from(rpm) / rated_rpm).powf(p);
                let drive =
                    f64::from(warmup.relative_heat_input(Some(Rpm(rpm)))) / f64::from(1 << 28);
                if exact > 4.0 {
                    // Held: far beyond full growth on both sides.
                    assert!((3.99..4.000_001).contains(&drive), "{rpm} r/min: {drive}");
                    continue;
                }
                let nm = (drive - exact).abs() * 80_000.0;
                if nm > here.0 {
                    here = (nm, rpm);
                }
            }
            let segments = (warmup.power.segments().len(), warmup.power.index().len());
            println!(
                "p = {speed_exponent}, rated {rated_rpm}: {:.3} nm at {} r/min; (segments, index) {segments:?}",
                here.0, here.1
            );
            if here.0 > worst.0 {
                worst =
                    (here.0, format!("p = {speed_exponent}, rated {rated_rpm}, {} r/min", here.1));
            }
        }
    }
    println!("drive: {:.3} nm of 80 µm at {}", worst.0, worst.1);
    assert!(worst.0 <= 1.0, "{worst:?}");
}

#[test]
fn a_lagging_axis_is_within_5_nm_over_a_two_hour_ramp() {
    const ROW_S: u32 = 60;
    let sections = "[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_x_c\"\n\
                    reference_c = 20\nslope_um_per_m_per_c = 14.21\nlag_s = 1630\n";
    let (machine, compiled) = compiled(&machine_of("\"3-axis\"", sections));
    let calibration = compiled.calibration();
    let (mut heat, mut reference) = (MachineThermalState::default(), ReferenceModel::new(&machine));
    let place = MachinePosition {
        position: [Position(500_000_000), Position(0), Position(0)],
        ..MachinePosition::default()
    };
    let mut worst = (0.0, 0);
    for row in 0..=120 {
        let temperature = Temperature(((20.0 + f64::from(row) / 6.0) * UNITS_PER_C).round() as i32);
        let temperatures = std::array::from_fn(|channel| (channel == 2).then_some(temperature));
        // A row's value holds over the interval that ends with it; the first settles.
        for _ in 0..if row == 0 { 1 } else { ROW_S * 10 } {
            heat.step(&calibration, &temperatures, None);
        }
        let celsius = [("temp_x_c", f64::from(temperature.0) / UNITS_PER_C)];
        let situation = RowInputs {
            time_s: Some(f64::from(row * ROW_S)),
            temperatures_c: &celsius,
            ..at([5_000.0, 0.0, 0.0])
        };
        let [model_um, ..] = reference.step(&situation).error_um();
        let board = calibration.compute_axis_errors(&heat, &place).axes[0].thermal;
        let nm = (f64::from(board.0) / 256.0 - model_um * 1_000.0).abs();
        if nm > worst.0 {
            worst = (nm, row);
        }
    }
    println!("lag: {:.3} nm on 5 m after {} min", worst.0, worst.1);
    assert!(worst.0 <= 5.0);
}
