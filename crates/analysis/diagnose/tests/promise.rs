//! The promised error at the tool on another day, against sums by hand; with thermometers
//! that are noisy.

use std::{fmt::Write as _, path::Path};

use trueup_diagnose::{Diagnosis, diagnose};
use trueup_machine::{MachineFile, RunFile};
use trueup_numerics::random::RandomGenerator;

/// Believed: 2 µm for each kelvin. The machine grows 3.
const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"temperature\"\n\
                       [spindle.temperature]\nsensor = \"temp_a_c\"\nreference_c = 20.0\nk_um_per_c = 2.0\n";

/// Returns a row each 10 s; `true_c` is what the part has, `noise_c` what the thermometer adds, `wandering_um` what
/// nothing records, with a memory of a quarter of an hour.
fn day(true_c: impl Fn(f64) -> f64, noise_c: f64, wandering_um: f64, seed: u64) -> RunFile {
    let mut noise = RandomGenerator::new(seed);
    let mut text = String::from("time_s,temp_a_c,measured_elongation_um\n");
    let mut wanders_um = 0.0;
    let kept = (-10.0_f64 / 900.0).exp();
    for row in 0..1000 {
        let time_s = 10.0 * f64::from(row);
        let c = true_c(time_s);
        wanders_um = kept * wanders_um + (1.0 - kept * kept).sqrt() * wandering_um * noise.normal();
        let um = 3.0 * (c - 20.0) + wanders_um + 0.2 * noise.normal();
        let _ = writeln!(text, "{time_s},{:.4},{um:.4}", c + noise_c * noise.normal());
    }
    RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run")
}

/// Warm and cold again, five times.
fn changing(time_s: f64) -> f64 {
    26.0 - 6.0 * (time_s / 2000.0 * std::f64::consts::TAU).cos()
}

fn diagnosed(run: RunFile) -> Diagnosis {
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("the test's own file");
    diagnose(&machine, &[run], &[], None, &mut |_, _| {}).expect("comparable")
}

/// A thermometer whose noise is more than the gauge's: lags that only average it are not named, for next to
/// them the growth would have another size.
#[test]
fn what_only_averages_noise_is_not_named() {
    let diagnosis = diagnosed(day(changing, 0.1, 0.0, 1));
    let [finding] = &diagnosis.report.findings[..] else {
        panic!("{:?}", diagnosis.report.findings);
    };
    assert!(finding.claimed && finding.cause == "growth-amplitude", "{finding:?}");
    assert!(finding.sentence.contains("1.500 times"), "{}", finding.sentence);
}

/// On a day at 30 °C the file is off by (3 − 2)·10 K = 10 µm, and what is left is what 0.1 K of noise make
/// of 3 µm/K: 0.3 µm. The gauge's 0.2 µm are not at the tool, and what it reads on that day does not matter.
#[test]
fn what_is_left_is_the_noise_of_the_inputs_through_the_law() {
    let diagnosis = diagnosed(day(changing, 0.1, 0.0, 1));
    let promised =
        diagnosis.predict_error_at_tool(&day(|_| 30.0, 0.1, 0.0, 2)).expect("the same columns");
    println!("{promised:?}");
    assert!((promised.before_um - 10.0).abs() < 0.1);
    assert!((promised.after_um - 0.3).abs() < 0.03);
    let misread =
        diagnosis.predict_error_at_tool(&day(|_| 30.0, 0.1, 50.0, 2)).expect("the same columns");
    assert!((misread.after_um - promised.after_um).abs() < 0.03);
}

/// At 21 °C, where the correction is a tenth, the same noise is left; without noise next to nothing is.
#[test]
fn a_day_that_asks_for_less_is_promised_less() {
    let diagnosis = diagnosed(day(changing, 0.1, 0.0, 1));
    let mild =
        diagnosis.predict_error_at_tool(&day(|_| 21.0, 0.1, 0.0, 2)).expect("the same columns");
    // 1 µm, and 0.1 K through the 2 µm/K that were believed.
    assert!((mild.before_um - (1.0_f64 + 0.04).sqrt()).abs() < 0.05, "{mild:?}");
    assert!((mild.after_um - 0.3).abs() < 0.03, "{mild:?}");
    let quiet = diagnosed(day(changing, 0.0, 0.0, 1));
    let quiet = quiet.predict_error_at_tool(&day(changing, 0.0, 0.0, 2)).expect("the same columns");
    assert!(quiet.after_um < 0.05, "{quiet:?}");
}

/// 1 µm that wanders on its own stays at the tool, whatever is corrected.
#[test]
fn what_wanders_is_left() {
    let diagnosis = diagnosed(day(changing, 0.0, 1.0, 3));
    let promised =
        diagnosis.predict_error_at_tool(&day(changing, 0.0, 1.0, 4)).expect("the same columns");
    println!("{promised:?}");
    assert!((0.7..1.5).contains(&promised.after_um));
}
