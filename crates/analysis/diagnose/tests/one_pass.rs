//! Where the position only grows with the time, an error along the axis and one in time are one question; what comes
//! and goes with the clock alone is named, and never called explained.

use std::{f64::consts::TAU, path::Path};

use trueup_diagnose::{
    Diagnosis, diagnose,
    report::{Finding, Verdict},
};
use trueup_machine::{MachineFile, RunFile};
use trueup_numerics::random::RandomGenerator;

const HEAD: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";

fn diagnosed(run: &str) -> Diagnosis {
    let run = RunFile::from_reader(run.as_bytes(), Path::new("r.csv")).expect("the test's own run");
    diagnosed_runs(&[run], &[])
}

fn diagnosed_runs(runs: &[RunFile], held_out: &[RunFile]) -> Diagnosis {
    let machine = MachineFile::parse(HEAD, Path::new("m.toml")).expect("the test's own file");
    diagnose(&machine, runs, held_out, None, &mut |_, _| {}).expect("comparable")
}

fn finding<'d>(diagnosis: &'d Diagnosis, cause: &str) -> &'d Finding {
    let found = diagnosis.report.findings.iter().find(|finding| finding.cause == cause);
    found.unwrap_or_else(|| panic!("no {cause} in {:?}", diagnosis.report.findings))
}

fn number(finding: &Finding, name: &str) -> f64 {
    finding.parameters[name]["value"].as_f64().expect("a number")
}

/// Rows of a pass along x at 11 mm/min, or with `ways` 2 there and back, with an error over the position.
fn pass(has_clock: bool, ways: usize, error_um: impl Fn(f64) -> f64) -> String {
    let mut noise = RandomGenerator::new(21);
    let mut run = String::from(if has_clock { "time_s," } else { "" });
    run += "x_mm,measured_dx_um\n";
    for row in 0..400 * ways {
        let back = if row < 400 { row } else { 799 - row };
        let x_mm = 0.37 * back as f64;
        if has_clock {
            run += &format!("{},", 2 * row);
        }
        run += &format!("{x_mm:.3},{:.3}\n", error_um(x_mm) + 0.4 * noise.normal());
    }
    run
}

#[test]
fn a_wave_of_one_pass_is_compensated_and_not_claimed_with_a_clock_or_without() {
    let wave = |x_mm: f64| 4.0 * (TAU * x_mm / 25.0).sin();
    for has_clock in [true, false] {
        let diagnosis = diagnosed(&pass(has_clock, 1, wave));
        let found = finding(&diagnosis, "pitch-periodic");
        println!("clock {has_clock}: {:?}", found.evidence);
        assert!(!found.claimed && found.compensated, "{found:?}");
        assert!((number(found, "period_mm") - 25.0).abs() < 0.5, "{found:?}");
        assert_eq!(found.rivals[0].cause, "periodic-in-time", "{:?}", found.rivals);
        assert!(found.next_test.contains("there and back"), "{}", found.next_test);
        assert_eq!(diagnosis.report.verdict, Verdict::PartlyExplained);
    }
    // There and back: the place comes again at another time.
    let found = diagnosed(&pass(true, 2, wave));
    assert!(finding(&found, "pitch-periodic").claimed);
}

#[test]
fn a_scale_of_one_pass_may_be_a_drift_with_a_clock_or_without() {
    let line = |x_mm: f64| 0.05 * x_mm;
    for has_clock in [true, false] {
        let diagnosis = diagnosed(&pass(has_clock, 1, line));
        let found = finding(&diagnosis, "pitch-scale");
        assert!(!found.claimed && found.compensated, "{found:?}");
        assert!((number(found, "um_per_m") - 50.0).abs() < 1.0, "{found:?}");
        assert_eq!(found.rivals[0].cause, "drift", "{:?}", found.rivals);
        assert_eq!(diagnosis.report.verdict, Verdict::PartlyExplained);
    }
    assert!(finding(&diagnosed(&pass(true, 2, line)), "pitch-scale").claimed);
}

/// Returns a chiller that was not recorded: 3 µm every 23 min; the clock counts from 1970.
fn chiller(bed_swings: bool) -> String {
    let mut noise = RandomGenerator::new(22);
    let mut run = String::from("time_s,temp_bed_c,measured_dz_um\n");
    for row in 0..500 {
        let time_s = 30.0 * f64::from(row);
        let swing = (TAU * time_s / 1380.0 + 1.0).sin();
        let bed = 22.0 + if bed_swings { 0.5 * swing } else { 0.0 } + 0.02 * noise.normal();
        let um = 3.0 * swing + 0.6 * noise.normal();
        run += &format!("{},{bed:.3},{um:.3}\n", 1.76e9 + time_s);
    }
    run
}

#[test]
fn what_comes_and_goes_with_the_clock_is_named_and_not_called_explained() {
    let diagnosis = diagnosed(&chiller(false));
    let found = finding(&diagnosis, "periodic-in-time");
    println!("{}", found.sentence);
    assert!(found.claimed && !found.compensated, "{found:?}");
    assert!((number(found, "period_s") - 1380.0).abs() < 10.0, "{found:?}");
    assert!((number(found, "amplitude_um") - 3.0).abs() < 0.2, "{found:?}");
    assert_eq!(diagnosis.report.verdict, Verdict::PartlyExplained);
    println!("written: {:?}", diagnosis.terms);
    // A thermometer that goes with it is what is named.
    let diagnosis = diagnosed(&chiller(true));
    assert!(diagnosis.report.findings.iter().all(|finding| finding.cause != "periodic-in-time"));
    assert_eq!(finding(&diagnosis, "extra-heat-path").column.as_deref(), Some("temp_bed_c"));
}

/// A slow drift along a pass is structure, with a clock or without: noise of 3 µm that remembers fifteen rows, and
/// 0.4 µm from reading to reading.
#[test]
fn what_wanders_along_a_pass_is_not_called_clean() {
    let mut noise = RandomGenerator::new(23);
    let (mut slow_um, mut run) = (0.0, [String::new(), String::from("time_s,")]);
    run.iter_mut().for_each(|run| *run += "x_mm,measured_dx_um\n");
    let kept = (-1.0_f64 / 15.0).exp();
    for row in 0..500 {
        slow_um = kept * slow_um + 3.0 * (1.0 - kept * kept).sqrt() * noise.normal();
        let cells = format!("{:.3},{:.3}\n", 0.4 * f64::from(row), slow_um + 0.4 * noise.normal());
        run[0] += &cells;
        run[1] += &format!("{},{cells}", 2 * row);
    }
    for run in run {
        let diagnosis = diagnosed(&run);
        let wandering = diagnosis.report.wandering.expect("it wanders");
        println!("{wandering:?}");
        assert_eq!(diagnosis.report.verdict, Verdict::Unexplained);
        assert!(wandering.memory_rows.is_some_and(|rows| (5.0..40.0).contains(&rows)));
        assert!(diagnosis.terms.is_empty(), "{:?}", diagnosis.terms);
    }
}

/// Eight passes of a screw: whatever the noise remembers, no table is written for it, and nothing is claimed.
#[test]
fn noise_that_wanders_along_a_screw_is_not_taken_for_a_table() {
    for (seed, memory_rows) in (80..88).zip([5.0, 15.0, 40.0, 100.0].into_iter().cycle()) {
        let mut noise = RandomGenerator::new(seed);
        let (mut slow_um, kept) = (0.0, (-1.0_f64 / memory_rows).exp());
        let mut run = String::from("x_mm,measured_dx_um\n");
        for row in 0..if seed < 84 { 80 } else { 300 } {
            slow_um = kept * slow_um + 3.0 * (1.0 - kept * kept).sqrt() * noise.normal();
            let um = slow_um + 0.4 * noise.normal();
            run += &format!("{:.2},{um:.3}\n", 2.0 * f64::from(row));
        }
        let findings = diagnosed(&run).report.findings;
        let is_table_or_claimed =
            |finding: &Finding| finding.claimed || finding.cause == "pitch-error";
        assert!(!findings.iter().any(is_table_or_claimed), "{seed}: {findings:?}");
    }
}

/// The same along a guide.
#[test]
fn what_wanders_along_a_guide_is_neither_clean_nor_claimed() {
    for seed in 30..36 {
        let mut noise = RandomGenerator::new(seed);
        let (mut slow_um, kept) = (0.0, (-1.0_f64 / 15.0).exp());
        let diagnosis = diagnosed(&guide_pass(300, |_| {
            slow_um = kept * slow_um + 3.0 * (1.0 - kept * kept).sqrt() * noise.normal();
            slow_um + 0.4 * noise.normal()
        }));
        let report = &diagnosis.report;
        println!(
            "{seed}: {:?}, {} terms, {:?}",
            report.verdict,
            diagnosis.terms.len(),
            report.after
        );
        assert!(!report.verdict.is_resolved(), "{:?}", report.reasons);
        assert!(report.findings.iter().all(|finding| !finding.claimed), "{:?}", report.findings);
    }
}

/// Rows along y at 3 mm, an error of the z axis over them.
fn guide_pass(rows: usize, mut error_um: impl FnMut(f64) -> f64) -> String {
    let mut run = String::from("y_mm,measured_dz_um\n");
    for row in 0..rows {
        let y_mm = 300.0 * row as f64 / (rows - 1) as f64;
        run += &format!("{y_mm:.2},{:.3}\n", error_um(y_mm));
    }
    run
}

/// However many rows there are: of a stretch that was never passed a curve says nothing, and none is asked of it.
#[test]
fn the_form_of_a_guide_is_found_with_few_rows_and_with_many() {
    for rows in [30, 50, 51, 60, 101, 400] {
        let mut noise = RandomGenerator::new(24);
        let bow = |y_mm: f64| 12.0 * (TAU * y_mm / 600.0).sin() + 4.0 * (TAU * y_mm / 300.0).sin();
        let diagnosis = diagnosed(&guide_pass(rows, |y_mm| bow(y_mm) + 0.4 * noise.normal()));
        let found = finding(&diagnosis, "straightness");
        let left_um = diagnosis.report.after.compensated_rms_um;
        println!("{rows} rows: {left_um:.2} µm left");
        assert!(!found.claimed && found.compensated, "{found:?}");
        assert_eq!(found.rivals[0].cause, "drift", "{:?}", found.rivals);
        assert!(found.evidence.join(" ").contains("only grew with the time"), "{found:?}");
        assert!(left_um < 1.6, "{rows}: {left_um}");
    }
}

/// A smooth error of a screw, 80 places passed once: of even places a short wave looks like a long one, and none is written
/// without a table fine enough.
#[test]
fn a_table_of_a_screw_is_found_in_one_pass() {
    let mut corrected = 0;
    for seed in 60..70 {
        let mut noise = RandomGenerator::new(seed);
        let mut run = String::from("x_mm,measured_dx_um\n");
        for row in 0..80 {
            let x_mm = 600.0 * f64::from(row) / 79.0;
            let bow_um = 10.0 * (TAU * x_mm / 480.0).sin() + 5.0 * (TAU * x_mm / 210.0 + 1.0).sin();
            run += &format!("{x_mm:.2},{:.3}\n", bow_um + 0.4 * noise.normal());
        }
        let report = diagnosed(&run).report;
        let left_um = report.after.compensated_rms_um;
        println!("{seed}: {:.2} -> {left_um:.2} µm", report.before.rms_um);
        assert!(report.findings.iter().all(|finding| !finding.claimed), "{:?}", report.findings);
        corrected += usize::from(left_um < 0.15 * report.before.rms_um);
    }
    assert!(corrected >= 9, "{corrected} of 10");
}

/// The columns that were recorded with the places of a map.
#[derive(Clone, Copy)]
struct Recorded {
    clock: bool,
    /// The bed's, in °C, at each share of the map.
    bed_c: Option<fn(f64) -> f64>,
}

const RECORDED: [Recorded; 4] = [
    Recorded { clock: true, bed_c: None },
    Recorded { clock: false, bed_c: None },
    Recorded { clock: true, bed_c: Some(|share| 21.0 + 2.0 * share) },
    Recorded { clock: false, bed_c: Some(|share| 21.0 + 2.0 * share) },
];

/// Returns the record of a map in lines along x, there and back, one after the other along y, 20 mm apart; the error at each
/// place and bed temperature.
fn map(
    recorded: Recorded,
    from_mm: f64,
    places: usize,
    mut error_um: impl FnMut([f64; 2], f64) -> f64,
) -> RunFile {
    let Recorded { clock, bed_c } = recorded;
    let mut resolution = RandomGenerator::new(28);
    let mut run = String::from(if clock { "time_s," } else { "" });
    run += if bed_c.is_some() {
        "temp_bed_c,x_mm,y_mm,measured_dz_um\n"
    } else {
        "x_mm,y_mm,measured_dz_um\n"
    };
    for place in 0..places * places {
        let (line, on_line) = (place / places, place % places);
        let on_line = if line % 2 == 0 { on_line } else { places - 1 - on_line };
        let at_mm = [on_line, line].map(|number| from_mm + 20.0 * number as f64);
        let share = place as f64 / (places * places) as f64;
        let bed_c = bed_c.map(|bed_c| bed_c(share) + 0.02 * resolution.normal());
        run += &if clock { format!("{},", 4 * place) } else { String::new() };
        run += &bed_c.map_or(String::new(), |bed_c| format!("{bed_c:.3},"));
        let um = error_um(at_mm, bed_c.unwrap_or_default());
        run += &format!("{},{},{um:.3}\n", at_mm[0], at_mm[1]);
    }
    RunFile::from_reader(run.as_bytes(), Path::new("map.csv")).expect("the test's own run")
}

/// A bed: two guides, and a tilt of the second one. A clock or a thermometer that was recorded too costs neither.
#[test]
fn a_map_of_a_bed_is_corrected_between_its_places() {
    for recorded in RECORDED {
        let mut noise = RandomGenerator::new(25);
        let mut bed = |from_mm: f64, places: usize| {
            map(recorded, from_mm, places, |[x_mm, y_mm], _| {
                let guides = 9.0 * (TAU * x_mm / 500.0).sin() + 14.0 * (TAU * y_mm / 150.0).cos();
                guides + 1e-4 * (x_mm - 140.0) * y_mm + 0.3 * noise.normal()
            })
        };
        let diagnosis = diagnosed_runs(&[bed(20.0, 15)], &[bed(30.0, 14)]);
        let (before, after) = (&diagnosis.report.before, &diagnosis.report.after);
        println!("{:.2} -> {:.2} µm", before.holdout_rms_um, after.compensated_holdout_rms_um);
        assert!(after.compensated_holdout_rms_um < 0.1 * before.holdout_rms_um, "{after:?}");
        // The lines are passed there and back, their order once.
        for finding in &diagnosis.report.findings {
            let is_along_x = finding.column.as_deref() == Some("x_mm");
            assert_eq!(finding.claimed, is_along_x || finding.cause != "straightness");
        }
    }
}

/// A bed that warms by 4 µm/°C, up and down, while the map is measured: of it and the guide neither hides the other.
#[test]
fn a_map_of_a_bed_that_warms_is_corrected_by_its_thermometer_too() {
    for clock in [true, false] {
        let recorded = Recorded { clock, bed_c: Some(|share| 22.0 + (TAU * 2.3 * share).sin()) };
        let mut noise = RandomGenerator::new(29);
        let mut bed = |from_mm: f64, places: usize| {
            map(recorded, from_mm, places, |[x_mm, _], bed_c| {
                9.0 * (TAU * x_mm / 250.0).sin() + 4.0 * (bed_c - 22.0) + 0.3 * noise.normal()
            })
        };
        let diagnosis = diagnosed_runs(&[bed(20.0, 15)], &[bed(30.0, 14)]);
        let after_um = diagnosis.report.after.compensated_holdout_rms_um;
        println!("{:.2} -> {after_um:.2} µm", diagnosis.report.before.holdout_rms_um);
        assert!(after_um < 1.0, "{clock}: {after_um}");
        let has = |column: &str| {
            let mut findings = diagnosis.report.findings.iter();
            findings.any(|finding| finding.column.as_deref() == Some(column) && finding.claimed)
        };
        assert!(has("temp_bed_c") && has("x_mm"), "{:?}", diagnosis.report.findings);
        let evidence = |cause: &str| finding(&diagnosis, cause).evidence.join(" ");
        assert!(evidence("straightness").contains("held-out readings"));
        assert!(evidence("extra-heat-path").contains("held-out stretches"));
    }
}

/// A round axis out of centre: one turn may be a drift, three are not, with a clock or without.
#[test]
fn an_error_over_a_rotary_axis_is_named_by_its_column() {
    for (turns, has_clock) in [(1, false), (3, false), (3, true)] {
        let mut noise = RandomGenerator::new(26);
        let mut run = String::from(if has_clock { "time_s," } else { "" });
        run += "c_deg,measured_dx_um\n";
        for row in 0..36 * turns {
            let um = 12.0 * (TAU * f64::from(row) / 36.0 + 0.3).sin() + 0.4 * noise.normal();
            run += &if has_clock { format!("{},", 5 * row) } else { String::new() };
            run += &format!("{},{um:.3}\n", 10 * (row % 36));
        }
        let diagnosis = diagnosed(&run);
        let found = finding(&diagnosis, "dependence");
        assert_eq!(found.column.as_deref(), Some("c_deg"), "{found:?}");
        assert_eq!(found.claimed, turns > 1, "{found:?}");
        assert!(diagnosis.report.after.rms_um < 1.0, "{:?}", diagnosis.report.after);
    }
}

/// Nothing else was recorded, and no clock: what goes on from row to row is no noise.
#[test]
fn readings_alone_that_follow_a_curve_are_not_clean() {
    let mut noise = RandomGenerator::new(27);
    let mut run = String::from("measured_dx_um\n");
    for row in 0..60 {
        let um = 8.0 * (TAU * f64::from(row) / 50.0).sin() + 0.4 * noise.normal();
        run += &format!("{um:.3}\n");
    }
    let diagnosis = diagnosed(&run);
    assert_eq!(diagnosis.report.verdict, Verdict::Unexplained, "{:?}", diagnosis.report.reasons);
    assert!(diagnosis.report.wandering.is_some_and(|rest| rest.memory_rows.is_some()));
}

/// A spindle that warms while a guide is passed: the curve of its heat over the place is no form of the guide.
#[test]
fn heat_that_a_thermometer_shows_is_not_taken_for_a_guide() {
    for (seed, has_clock) in (100..106).zip([true, false].into_iter().cycle()) {
        let mut noise = RandomGenerator::new(seed);
        let mut run = String::from(if has_clock { "time_s," } else { "" });
        run += "y_mm,temp_spindle_c,measured_dz_um\n";
        for row in 0..225 {
            let risen_c = 8.0 * (1.0 - (-f64::from(row) / 56.0).exp());
            run += &if has_clock { format!("{},", 32 * row) } else { String::new() };
            let um = 2.5 * risen_c + 0.4 * noise.normal();
            let spindle_c = 21.0 + risen_c + 0.03 * noise.normal();
            run += &format!("{:.2},{spindle_c:.3},{um:.3}\n", 400.0 * f64::from(row) / 224.0);
        }
        let diagnosis = diagnosed(&run);
        let found = finding(&diagnosis, "extra-heat-path");
        assert_eq!(found.column.as_deref(), Some("temp_spindle_c"), "{seed}");
        assert!(found.claimed && (number(found, "um_per_c") - 2.5).abs() < 0.1, "{found:?}");
        assert_eq!(diagnosis.report.findings.len(), 1, "{seed}: {:?}", diagnosis.report.findings);
    }
}

/// 15 lines of 15 places, with a clock or a thermometer and without: whatever the noise remembers, no guide is found in it.
#[test]
fn what_wanders_along_a_map_is_not_taken_for_a_guide() {
    for (seed, memory_rows) in (40..56).zip([5.0, 15.0, 40.0, 100.0].into_iter().cycle()) {
        let mut noise = RandomGenerator::new(seed);
        let (mut slow_um, kept) = (0.0, (-1.0_f64 / memory_rows).exp());
        let recorded = RECORDED[(seed as usize - 40) / 4];
        let diagnosis = diagnosed_runs(
            &[map(recorded, 0.0, 15, |_, _| {
                slow_um = kept * slow_um + 3.0 * (1.0 - kept * kept).sqrt() * noise.normal();
                slow_um + 0.4 * noise.normal()
            })],
            &[],
        );
        assert!(diagnosis.terms.is_empty(), "{seed}: {:?}", diagnosis.terms);
        assert!(diagnosis.report.findings.iter().all(|finding| !finding.claimed), "{seed}");
    }
}
