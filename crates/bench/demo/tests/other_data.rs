//! With other data the demonstration says other words, and the right ones: a gain, a curvature, nothing.
//!
//! On the board's application in this process; it sends what the board sends, to the bit.

use std::{fmt::Write as _, path::Path};

use trueup_campaigns::run_file::parse_run;
use trueup_demo::{
    html_report,
    measured_run_demo::{MeasuredRunInput, MeasuredRunResult, run_measured_run_demo},
    stepped_board::BoardSource,
};

const MACHINE: &str = include_str!("../../../../data/paper_spindle.toml");
/// Where the paper's sensor reads 0, and µm for a count.
const ZERO_COUNTS: f64 = 5048.0;
const UM_PER_COUNT: f64 = 500.0 / 32_768.0;

/// Readings of a dial that shows `dial` of what the sensor says, to 0.1 µm, with a scatter of 0.15 µm.
fn shown(dial: impl Fn(f64) -> f64) -> MeasuredRunResult {
    let mut csv = String::from("sensor_counts,spindle_rpm,measured_elongation_um\n");
    let mut state = 17_u64;
    for reading in 0..28 {
        let counts = ZERO_COUNTS + 160.0 * f64::from(reading) + f64::from(reading * reading % 7);
        // Twelve of them less six: nearly normal.
        let mut noise = -6.0;
        for _ in 0..12 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            noise += (state >> 33) as f64 / f64::from(1_u32 << 31);
        }
        let um = dial((counts - ZERO_COUNTS) * UM_PER_COUNT) + 0.15 * noise;
        writeln!(csv, "{counts},12000,{um:.1}").expect("a string grows");
    }
    let run = parse_run(&csv, "run.csv").expect("a run file");
    let asked =
        MeasuredRunInput { source: MACHINE, path: Path::new("m.toml"), run: &run, quantity: None };
    run_measured_run_demo(&BoardSource::InProcess, &asked, &mut |_, _| {}).expect("it runs through")
}

fn causes(one: &MeasuredRunResult) -> Vec<&str> {
    one.diagnosis.report.findings.iter().map(|finding| finding.cause.as_str()).collect()
}

#[test]
fn a_gain_is_called_a_gain() {
    let one = shown(|um| 1.12 * um);
    let text = one.to_text();
    println!("{text}");
    assert_eq!(causes(&one), ["sensor-gain"]);
    assert!(text.contains("1.1") && text.contains("for each micrometre"), "{text}");
    assert!(one.after.rms_um < 0.3 && one.before.rms_um > 2.0, "{:?} {:?}", one.before, one.after);
    assert!(!text.contains("27648"), "another full scale is not this gain: {text}");
    assert!(html_report::render_page(&one, None).contains("sensor-gain"));
}

#[test]
fn a_curvature_is_called_a_curvature() {
    let one = shown(|um| um + 0.002 * um * um);
    let text = one.to_text();
    println!("{text}");
    assert_eq!(causes(&one), ["sensor-curvature"]);
    assert!(!text.contains("sensor-gain:") && !text.contains("27648"), "{text}");
    assert!(one.after.rms_um < 0.3 && one.before.rms_um > 2.0, "{:?} {:?}", one.before, one.after);
}

#[test]
fn nothing_is_called_nothing() {
    let one = shown(|um| um);
    let text = one.to_text();
    println!("{text}");
    assert!(causes(&one).is_empty());
    assert!(text.starts_with("clean") && text.contains("nothing to correct"), "{text}");
    assert!((one.before.rms_um - one.after.rms_um).abs() < 1e-9);
}
