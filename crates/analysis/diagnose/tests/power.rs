//! Too little data is an answer, and a clean one says what would have been seen: tried by hiding an error of
//! that size.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{fmt::Write as _, path::Path};

use trueup_diagnose::{Diagnosis, DiagnosisOptions, Verdict, diagnose, diagnose_with_options};
use trueup_machine::{MachineFile, RunFile};
use trueup_numerics::random::RandomGenerator;

const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";

fn read(text: &str) -> RunFile {
    RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run")
}

fn diagnosed(machine: &str, text: &str) -> Diagnosis {
    let machine = MachineFile::parse(machine, Path::new("m.toml")).expect("the test's own file");
    diagnose(&machine, &[read(text)], &[], None, &mut |_, _| {}).expect("comparable")
}

/// 300 rows of noise of 0.5 µm with a memory of this many rows, under a load that comes and goes and bends
/// the tool by an error of `hidden_um` RMS.
fn loaded(hidden_um: f64, memory_rows: f64, seed: u64) -> String {
    let mut noise = RandomGenerator::new(seed);
    let load: Vec<f64> = (0..300).map(|row| f64::from((row / 23 * 7) % 5) - 2.0).collect();
    let rms = (load.iter().map(|load| load * load).sum::<f64>() / 300.0).sqrt();
    let decay = if memory_rows > 0.0 { (-1.0 / memory_rows).exp() } else { 0.0 };
    let mut state = noise.normal();
    let mut text = String::from("time_s,load_n,temp_a_c,measured_elongation_um\n");
    for (row, load) in load.iter().enumerate() {
        state = decay * state + (1.0 - decay * decay).sqrt() * noise.normal();
        let warm_c = 20.0 + 5.0 * (1.0 - (-(row as f64) / 80.0).exp());
        let um = 0.5 * state - hidden_um / rms * load;
        let _ = writeln!(text, "{},{},{warm_c:.3},{um:.4}", 10 * row, 100.0 * load);
    }
    text
}

/// Of this many clean runs whose answer promises a size, how many show an error of `share` of it; clean runs are
/// at least nine of ten.
fn found(share: f64, memory_rows: f64, seeds: u64) -> (u64, u64) {
    let (mut found, mut promised, mut clean) = (0, 0, 0);
    for seed in 0..seeds {
        let without = diagnosed(MACHINE, &loaded(0.0, memory_rows, seed));
        if without.report.verdict != Verdict::Clean {
            continue;
        }
        clean += 1;
        let um = share * without.report.detectable_um;
        // Under a memory an error as large as all that is left could hide in some of them.
        if !um.is_finite() {
            continue;
        }
        promised += 1;
        let with = diagnosed(MACHINE, &loaded(um, memory_rows, seed));
        found += u64::from(with.report.verdict != Verdict::Clean);
        if seed == 0 {
            println!("memory {memory_rows}: {um:.3} µm RMS beside 0.5, {:?}", with.report.verdict);
        }
    }
    println!("memory {memory_rows}, {share} of the size: {found} of {promised}, {clean} clean");
    assert!(10 * clean >= 9 * seeds && promised > 0, "{promised} of {clean}");
    (found, promised)
}

#[test]
fn an_error_of_the_size_that_would_have_been_found_is_found() {
    let (found, promised) = found(1.0, 0.0, 8);
    // With 95 % each, all of eight or but one in 94 of 100 cases; the draws are fixed.
    assert!(found + 1 >= promised, "{found} of {promised}");
}

#[test]
#[ignore = "long: 200 diagnoses"]
fn the_power_that_is_told_is_the_one_that_there_is() {
    for memory_rows in [0.0, 1.0] {
        let (seen, promised) = found(1.0, memory_rows, 40);
        assert!(seen as f64 >= 0.9 * promised as f64, "{seen} of {promised}");
    }
    // It is no promise that would be kept anyway. Under a memory it is one for the errors that show worst:
    // this load changes faster.
    let (seen, promised) = found(0.25, 0.0, 20);
    assert!((seen as f64) < 0.5 * promised as f64, "{seen} of {promised}");
}

#[test]
fn one_row_two_rows_and_a_single_pass_are_too_little_and_it_is_said_what_would_do() {
    let one = "load_n,measured_elongation_um\n100,3.1\n";
    let two = "load_n,measured_elongation_um\n100,3.1\n200,2.7\n";
    let mut pass = String::from("x_mm,dir_x,measured_dx_um\n");
    for (place, um) in [3.0, -12.0, 22.0, 7.0, -31.0, 18.0, 2.0, -9.0, 14.0, -22.0, 30.0, -4.0]
        .into_iter()
        .enumerate()
    {
        let _ = writeln!(pass, "{},1,{um}", 5 * place);
    }
    for (text, what) in [
        (one, "record at least"),
        (two, "record at least"),
        ("x_mm,measured_dx_um\n10,3\n", "ISO 230-2"),
        (
            pass.as_str(),
            "cycles at the 12 positions from 0 to 55 mm, each approached from both sides",
        ),
    ] {
        let report = diagnosed(MACHINE, text).report;
        println!("{:?}", report.reasons);
        assert_eq!(report.verdict, Verdict::TooLittleData);
        assert!(!report.verdict.is_resolved());
        assert!(report.reasons.iter().any(|why| why.contains(what)), "{:?}", report.reasons);
    }
}

/// As `fit backlash` asks for it: one place, seven times from each side.
#[test]
fn a_backlash_at_one_place_is_found() {
    let mut noise = RandomGenerator::new(8);
    let mut text = String::from("x_mm,dir_x,measured_dx_um\n");
    for approach in 0..14 {
        let (way, um) = if approach % 2 == 0 { (1, 0.0) } else { (-1, 3.0) };
        let _ = writeln!(text, "100,{way},{:.3}", um + 0.4 * noise.normal());
    }
    let report = diagnosed(MACHINE, &text).report;
    assert_eq!(report.verdict, Verdict::Explained, "{:?}", report.reasons);
    assert_eq!((report.findings[0].cause.as_str(), report.findings[0].claimed), ("backlash", true));
    let width_um = report.findings[0].parameters["width_um"]["value"].as_f64().expect("a number");
    assert!((width_um - 3.0).abs() < 0.5, "{width_um}");
}

/// 80 positions 0.5 mm apart, each pass over them from the same side: 20 µm RMS that go on from one to the next,
/// e^(−1/13) of each, and 0.5 µm of noise.
fn passes(count: usize, seed: u64) -> String {
    let mut noise = RandomGenerator::new(seed);
    let decay = f64::exp(-1.0 / 13.0);
    let mut um = noise.normal();
    let error: Vec<f64> = (0..80)
        .map(|_| {
            um = decay * um + (1.0 - decay * decay).sqrt() * noise.normal();
            20.0 * um
        })
        .collect();
    let mut text = String::from("run,x_mm,dir_x,measured_dx_um\n");
    for run in 1..=count {
        for (place, um) in error.iter().enumerate() {
            let um = um + 0.5 * noise.normal();
            let _ = writeln!(text, "{run},{},1,{um:.3}", 0.5 * place as f64);
        }
    }
    text
}

#[test]
fn a_curve_that_was_measured_once_is_not_called_noise() {
    for seed in 0..6 {
        let report = diagnosed(MACHINE, &passes(1, seed)).report;
        println!("{:?} {:?}", report.verdict, report.reasons);
        assert!(!report.verdict.is_resolved() || report.after.rms_um < 0.5 * report.before.rms_um);
        assert_ne!(report.verdict, Verdict::Clean);
        // The second pass shows that it repeats.
        let report = diagnosed(MACHINE, &passes(2, seed)).report;
        assert!(
            report
                .findings
                .iter()
                .any(|finding| finding.cause == "pitch-error" && finding.compensated)
        );
    }
    // Noise that does not go on is noise after one pass as well.
    let mut noise = RandomGenerator::new(9);
    let mut text = String::from("x_mm,dir_x,measured_dx_um\n");
    for place in 0..80 {
        let _ = writeln!(text, "{},1,{:.3}", 0.5 * f64::from(place), 20.0 * noise.normal());
    }
    assert_eq!(diagnosed(MACHINE, &text).report.verdict, Verdict::Clean);
}

#[test]
fn what_matters_less_than_could_be_told_asks_for_more() {
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("the test's own file");
    let run = read(&loaded(0.0, 0.0, 3));
    let asked = |um| {
        let options = DiagnosisOptions { matters_um: Some(um), ..DiagnosisOptions::default() };
        let diagnosis = diagnose_with_options(
            &machine,
            std::slice::from_ref(&run),
            &[],
            options,
            &mut |_, _| {},
        );
        diagnosis.expect("comparable").report.verdict
    };
    // 0.5 µm of noise in 300 rows: 0.13 µm at the best.
    assert_eq!(asked(0.2), Verdict::Clean);
    assert_eq!(asked(0.05), Verdict::TooLittleData);
}

#[test]
fn nothing_is_promised_that_is_larger_than_all_that_is_left() {
    let mut unpromised = 0;
    for seed in 0..6 {
        let diagnosis = diagnosed(MACHINE, &loaded(0.0, 150.0, seed));
        let report = &diagnosis.report;
        println!("{:?} {} of {}", report.verdict, report.detectable_um, report.after.rms_um);
        if report.detectable_um.is_finite() {
            assert!(report.detectable_um <= report.after.rms_um);
        } else {
            // What wanders and could hide any error is not called clean.
            unpromised += 1;
            assert_ne!(report.verdict, Verdict::Clean, "{:?}", report.reasons);
        }
    }
    assert!(unpromised > 0);
}

#[test]
fn few_rows_are_enough_for_an_instrument_that_is_known_to_be_no_better() {
    let with =
        |uncertainty_um: f64| format!("{MACHINE}[instrument]\nuncertainty_um = {uncertainty_um}\n");
    let text = "x_mm,measured_dx_um\n0,0.1\n10,-0.2\n20,0.2\n30,0.1\n40,-0.1\n50,-0.2\n60,0.1\n";
    assert_eq!(diagnosed(MACHINE, text).report.verdict, Verdict::TooLittleData);
    let report = diagnosed(&with(0.5), text).report;
    assert_eq!(report.verdict, Verdict::Clean, "{:?}", report.reasons);
    assert_eq!(diagnosed(&with(0.05), text).report.verdict, Verdict::TooLittleData);
}

#[test]
fn a_door_that_nobody_recorded_is_told_as_slow_wandering() {
    let mut chance = RandomGenerator::new(4);
    let (step_s, memory_s) = (20.0, 1020.0);
    let mut text = String::from("time_s,temp_spindle_c,measured_elongation_um\n");
    let (mut air, mut cooled, mut spindle) = (0.0, 0.0, 0.0);
    for row in 0..2160 {
        // Every 15 minutes on average a worker opens it for a while; the machine follows the air.
        air *= f64::exp(-step_s / 300.0);
        if chance.uniform() < step_s / 900.0 {
            air += 9.0;
        }
        cooled += (air - cooled) * step_s / memory_s;
        spindle += 0.02 * chance.normal() - 0.002 * spindle;
        let um = 2.9 - cooled + 0.25 * chance.normal();
        let _ = writeln!(text, "{},{:.3},{um:.3}", step_s * f64::from(row), 25.0 + spindle);
    }
    let report = diagnosed(MACHINE, &text).report;
    println!("{:?} {:?}", report.verdict, report.reasons);
    let wandering = report.wandering.expect("it wanders");
    assert_eq!(report.verdict, Verdict::Unexplained);
    assert!((1.2..3.0).contains(&wandering.rms_um), "{wandering:?}");
    assert!(
        wandering.memory_s.is_some_and(|memory_s| (500.0..2000.0).contains(&memory_s)),
        "{wandering:?}"
    );
    let reasons = report.reasons.join(" ");
    assert!(
        reasons.contains("whether a door or a gate is open") && reasons.contains("minutes"),
        "{reasons}"
    );
    // An instrument that is worth half a micrometre does not wander by two.
    let machine = format!("{MACHINE}[instrument]\nuncertainty_um = 0.5\n");
    assert_eq!(diagnosed(&machine, &text).report.verdict, Verdict::Unexplained);
}
