//! Causes that measured data asked for, on made data whose answer is known: a thermometer that is late, a
//! drift without a clock, two guides that are not straight. `predict` on the extended file gives what the
//! answer says is left.

use std::{fmt::Write as _, path::Path};

use trueup_diagnose::{Diagnosis, diagnose};
use trueup_machine::{MachineFile, RunFile, machine_file::Quantity, predict::RunPredictor};

const HEAD: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
const SPINDLE: &str = "[spindle]\nsource = \"temperature\"\n[spindle.temperature]\n\
                       sensor = \"temp_a_c\"\nreference_c = 20.0\nk_um_per_c = 2.0\n";

/// Noise of ±1 with no memory, the same each time.
fn noise(state: &mut u32) -> f64 {
    *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    f64::from(*state >> 16) / 32_768.0 - 1.0
}

/// Returns the answer, and the largest difference in µm between what it predicts of the rows and what `predict`
/// does with the file that it hands out.
fn answered(sections: &str, csv: &str, quantity: Quantity) -> (Diagnosis, f64) {
    let (text, path) = (format!("{HEAD}{sections}"), Path::new("m.toml"));
    let machine = MachineFile::parse(&text, path).expect("a machine file");
    let run = RunFile::from_reader(csv.as_bytes(), Path::new("r.csv")).expect("a run");
    let runs = std::slice::from_ref(&run);
    let diagnosis = diagnose(&machine, runs, &[], None, &mut |_, _| {}).expect("comparable");
    let mut residuals = Vec::new();
    diagnosis.write_residuals(&mut residuals).expect("memory");
    let residuals = String::from_utf8(residuals).expect("text");
    let after_um = residuals.lines().skip(1).map(|line| {
        let cell = line.split(',').nth(5).expect("predicted_after_um");
        cell.parse::<f64>().expect("every row is predicted")
    });
    let extended = diagnosis.render_extended_toml(&text, path).expect("a machine file");
    let extended = MachineFile::parse(&extended, path).expect("it can be loaded");
    let predictor = RunPredictor::new(&extended, &run).expect("it can be predicted");
    let index =
        Quantity::ALL.iter().position(|candidate| *candidate == quantity).expect("one of all");
    let predicted = predictor.predictions().map(|row| row.model.to_array()[index]);
    let apart = predicted.zip(after_um).map(|(p, after)| (p - after).abs()).fold(0.0, f64::max);
    (diagnosis, apart)
}

fn names(diagnosis: &Diagnosis) -> Vec<String> {
    diagnosis.report.findings.iter().map(|finding| finding.cause.clone()).collect()
}

/// Returns two hours of heating and cooling at 2 µm/K, the thermometer 120 s behind the part.
fn late_run() -> String {
    let mut csv = String::from("time_s,temp_a_c,measured_elongation_um\n");
    let (mut part_c, mut shown_c, mut state) = (20.0, 20.0, 1);
    for row in 0..720 {
        let to_c = if row % 240 < 140 { 45.0 } else { 20.0 };
        part_c += (to_c - part_c) * (1.0 - (-10.0_f64 / 600.0).exp());
        shown_c += (part_c - shown_c) * (1.0 - (-10.0_f64 / 120.0).exp());
        let (t_noise, noise_um) = (0.01 * noise(&mut state), 0.8 * noise(&mut state));
        let measured = 2.0 * (part_c - 20.0) + noise_um;
        writeln!(csv, "{},{:.3},{measured:.2}", row * 10, shown_c + t_noise).expect("memory");
    }
    csv
}

#[test]
fn a_thermometer_that_is_late_is_named_and_not_corrected() {
    let (diagnosis, apart_um) = answered(SPINDLE, &late_run(), Quantity::Elongation);
    assert_eq!(names(&diagnosis), ["thermometer-lag"]);
    let finding = &diagnosis.report.findings[0];
    assert!(finding.claimed && !finding.compensated);
    let tau_s = finding.parameters["time_constant_s"]["value"].as_f64().expect("a number");
    assert!((tau_s - 120.0).abs() < 6.0, "{tau_s}");
    assert!(apart_um < 1e-5, "{apart_um}");
}

/// Five runs of twenty places, each 3 µm above the one before; of two runs it may be anything.
#[test]
fn a_drift_from_run_to_run_needs_no_clock_but_three_runs() {
    let csv = |runs: u32| {
        let (mut csv, mut state) = (String::from("run,x_mm,measured_dx_um\n"), 7);
        for run in 1..=runs {
            for place in 0..20 {
                let um = 3.0 * f64::from(run) + 0.5 * noise(&mut state);
                writeln!(csv, "{run},{},{um:.3}", 25 * place).expect("memory");
            }
        }
        csv
    };
    let (diagnosis, apart_um) = answered("", &csv(5), Quantity::Dx);
    let found: Vec<_> =
        diagnosis.report.findings.iter().filter(|finding| finding.cause == "drift").collect();
    assert_eq!(found.len(), 1, "{:?}", names(&diagnosis));
    let um_per_run = found[0].parameters["um_per_run"]["value"].as_f64().expect("a number");
    assert!((um_per_run - 3.0).abs() < 0.15, "{um_per_run}");
    assert!(apart_um < 1e-5, "{apart_um}");
    let (of_two, _) = answered("", &csv(2), Quantity::Dx);
    assert!(!names(&of_two).contains(&"drift".to_string()));
}

/// A map of this many places each way, three times over: two curves, each of its own guide.
#[test]
fn two_guides_that_are_not_straight_are_both_found_on_a_map() {
    for places in [7, 9] {
        let (mut csv, mut state) = (String::from("run,x_mm,y_mm,measured_dz_um\n"), 3);
        for run in 1..=3 {
            for (y, x) in (0..places).flat_map(|y| (0..places).map(move |x| (y, x))) {
                let share = |n: i32| f64::from(n) / f64::from(places - 1);
                let over_x = 80.0 * (share(x) - 0.5).powi(2) + 15.0 * share(x);
                let over_y = 12.0 * (std::f64::consts::TAU * share(y)).sin();
                let um = over_x + over_y + 1.5 * noise(&mut state);
                let mm = |n: i32| 300.0 * share(n);
                writeln!(csv, "{run},{:.1},{:.1},{um:.2}", mm(x), mm(y)).expect("memory");
            }
        }
        let (diagnosis, apart_um) = answered("", &csv, Quantity::Dz);
        let findings = &diagnosis.report.findings;
        let mut along: Vec<_> = findings
            .iter()
            .filter(|finding| finding.cause == "straightness" && finding.claimed)
            .filter_map(|finding| finding.column.as_deref())
            .collect();
        along.sort_unstable();
        assert_eq!(along, ["x_mm", "y_mm"], "{places} places: {:?}", names(&diagnosis));
        assert!(diagnosis.report.after.rms_um < 1.0, "{}", diagnosis.report.after.rms_um);
        assert!(apart_um < 1e-5, "{apart_um}");
    }
}
