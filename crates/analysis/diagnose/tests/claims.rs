//! A claim stands on its own feet: made records in which a name would be a guess, and next to each one in
//! which it is not.

use std::{f64::consts::TAU, path::Path};

use trueup_diagnose::{Diagnosis, diagnose, report::Finding};
use trueup_machine::{MachineFile, RunFile};

const HEAD: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";

fn diagnosed(machine: &str, run: &str) -> Diagnosis {
    let machine = MachineFile::parse(machine, Path::new("m.toml")).expect("the test's own file");
    let run = RunFile::from_reader(run.as_bytes(), Path::new("r.csv")).expect("the test's own run");
    diagnose(&machine, &[run], &[], None, &mut |_, _| {}).expect("comparable")
}

fn finding<'d>(diagnosis: &'d Diagnosis, cause: &str) -> Option<&'d Finding> {
    diagnosis.report.findings.iter().find(|finding| finding.cause == cause)
}

fn claimed(diagnosis: &Diagnosis) -> Vec<&str> {
    let all = diagnosis.report.findings.iter().filter(|finding| finding.claimed);
    all.map(|finding| finding.cause.as_str()).collect()
}

/// Numbers that look like noise of deviation 1: twelve of a linear congruence, less six.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut uniform = || {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }
}

/// Returns a wave of 8.9 mm and 5 µm at `places`, three cycles there and back.
fn wave(places: &[f64]) -> String {
    let mut noise = Noise(7);
    let mut run = String::from("run,x_mm,dir_x,measured_dx_um\n");
    for cycle in 1..=3 {
        for (way, mm) in
            places.iter().map(|mm| (1, mm)).chain(places.iter().rev().map(|mm| (-1, mm)))
        {
            let um = 5.0 * (TAU * mm / 8.9).sin() + 0.3 * noise.next();
            run += &format!("{cycle},{mm:.4},{way},{um:.4}\n");
        }
    }
    run
}

#[test]
fn a_wave_on_a_grid_is_one_of_many_and_one_on_uneven_places_is_claimed() {
    let grid: Vec<f64> = (0..27).map(|n| 37.3 * f64::from(n)).collect();
    let diagnosis = diagnosed(HEAD, &wave(&grid));
    let report = &diagnosis.report;
    println!("{}: {:?}", report.verdict.name(), report.findings);
    assert!(!claimed(&diagnosis).contains(&"pitch-periodic"));
    if let Some(wave) = finding(&diagnosis, "pitch-periodic") {
        assert!(
            !wave.compensated
                && wave.evidence.iter().any(|sentence| sentence.contains("does as well at"))
        );
        assert!(wave.next_test.starts_with("Measure at "), "{}", wave.next_test);
    }
    let mut noise = Noise(3);
    let uneven: Vec<f64> = (0..60).map(|n| 3.7 * f64::from(n) + 0.9 * noise.next()).collect();
    let diagnosis = diagnosed(HEAD, &wave(&uneven));
    let wave = finding(&diagnosis, "pitch-periodic").expect("there is one");
    let period = wave.parameters["period_mm"]["value"].as_f64().expect("a number");
    println!("{:?}", wave.evidence);
    assert!(wave.claimed && wave.compensated && (period - 8.9).abs() < 0.02, "{period}");
}

/// Six hours of a table that warms and cools each hour, with a second thermometer that follows it within
/// `apart` kelvin; the tool moves by 2 µm/K of the first, of the second half by `later` times as much.
fn heat(apart: f64, later: f64) -> String {
    let mut noise = Noise(11);
    let mut run = String::from("time_s,temp_bed_c,temp_nozzle_c,measured_elongation_um\n");
    for n in 0..720 {
        let time_s = 30.0 * f64::from(n);
        let bed = 25.0 - 4.0 * (TAU * time_s / 3600.0).cos();
        let nozzle = bed + apart * noise.next();
        let um_per_c = if n < 360 { 2.0 } else { 2.0 * later };
        let um = um_per_c * (bed - 21.0) + 0.5 * noise.next();
        run += &format!("{time_s},{bed:.3},{nozzle:.3},{um:.3}\n");
    }
    run
}

#[test]
fn of_two_columns_that_go_together_none_is_claimed() {
    let diagnosis = diagnosed(HEAD, &heat(0.02, 1.0));
    println!("{:?}", diagnosis.report.findings);
    let path = finding(&diagnosis, "extra-heat-path").expect("one of the two");
    assert!(!path.claimed && path.rivals.iter().any(|rival| rival.cause == "extra-heat-path"));
    // Whichever it is, the correction is the same.
    assert!(path.compensated);
    let diagnosis = diagnosed(HEAD, &heat(2.0, 1.0));
    let path = finding(&diagnosis, "extra-heat-path").expect("one of the two");
    assert!(path.claimed && path.column.as_deref() == Some("temp_bed_c"), "{path:?}");
}

#[test]
fn a_coefficient_that_is_another_one_in_the_second_half_is_told() {
    let diagnosis = diagnosed(HEAD, &heat(2.0, 1.25));
    println!("{:?}", diagnosis.report.findings);
    let path = finding(&diagnosis, "extra-heat-path").expect("it is there");
    assert!(
        !path.claimed && path.evidence.iter().any(|sentence| sentence.contains("second")),
        "{path:?}"
    );
}

#[test]
fn what_was_seen_once_is_not_claimed() {
    // A load of 300 N, once for five minutes of six hours, or again and again.
    let record = |is_loaded: &dyn Fn(i32) -> bool| {
        let mut noise = Noise(5);
        let mut run = String::from("time_s,load_n,measured_elongation_um\n");
        for n in 0..720 {
            let load_n = if is_loaded(n) { 300.0 } else { 0.0 };
            let um = -0.02 * load_n + 0.5 * noise.next();
            run += &format!("{},{load_n},{um:.3}\n", 30 * n);
        }
        run
    };
    let machine = format!(
        "{HEAD}[spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 60.0\nwarm_s = 5400.0\nmax_um = 0.001\nexponent = 4.0\n"
    );
    let once = diagnosed(&machine, &record(&|n| (300..310).contains(&n)));
    println!("{:?} {:?}", once.report.findings, once.report.rejected);
    assert!(!claimed(&once).contains(&"cutting-load"));
    let often = diagnosed(&machine, &record(&|n| n % 40 < 10));
    assert!(claimed(&often).contains(&"cutting-load"), "{:?}", often.report.findings);
}

/// Returns one map of 9 × 9 places, Z by X and Y: what `um` says at each, and noise of 0.3 µm.
fn map(um: impl Fn(f64, f64) -> f64) -> String {
    let mut noise = Noise(5);
    let mut run = String::from("x_mm,y_mm,measured_dz_um\n");
    for y in 0..9 {
        for x in 0..9 {
            let (x_mm, y_mm) = (30.0 * f64::from(x), 25.0 * f64::from(y));
            run += &format!("{x_mm},{y_mm},{:.3}\n", um(x_mm, y_mm) + 0.3 * noise.next());
        }
    }
    run
}

#[test]
fn a_curve_that_is_the_same_at_every_lever_is_no_tilt_and_one_that_grows_with_it_is() {
    let bend = |x_mm: f64| (x_mm / 80.0).sin();
    let curve = diagnosed(HEAD, &map(|x_mm, _| 12.0 * bend(x_mm)));
    println!("{:?}", curve.report.findings);
    assert!(!claimed(&curve).contains(&"angular-error"));
    let tilt = diagnosed(HEAD, &map(|x_mm, y_mm| 120.0 * bend(x_mm) * (y_mm - 60.0) / 1000.0));
    println!("{:?}", tilt.report.findings);
    assert!(claimed(&tilt).contains(&"angular-error"), "{:?}", claimed(&tilt));
}

#[test]
fn one_gross_reading_is_told_of_as_one() {
    let mut run = String::from("time_s,measured_elongation_um\n");
    let mut noise = Noise(2);
    for row in 0..200 {
        let um = 0.3 * noise.next() + if row == 120 { 40.0 } else { 0.0 };
        run += &format!("{},{um:.3}\n", 10 * row);
    }
    let diagnosis = diagnosed(HEAD, &run);
    let gross = finding(&diagnosis, "outliers").expect("it stands alone");
    assert!(
        gross.sentence.starts_with("One reading is no reading: it stands"),
        "{}",
        gross.sentence
    );
    assert_eq!(gross.evidence[1], "Excluded as outliers: row 121.");
}

/// Returns an hour in which the tool moves by 2 µm at 2010 s, and is not read for `pause_s` before.
fn jump(pause_s: i32) -> String {
    let mut noise = Noise(9);
    let mut run = String::from("time_s,temp_a_c,measured_elongation_um\n");
    for time_s in
        (0..360).map(|row| 10 * row).filter(|time_s| !(2010 - pause_s..2010).contains(time_s))
    {
        let um = if time_s >= 2010 { 2.0 } else { 0.0 } + 0.3 * noise.next();
        run += &format!("{time_s},{:.2},{um:.3}\n", 20.0 + 0.05 * noise.next());
    }
    run
}

#[test]
fn a_jump_in_a_pause_may_have_come_at_any_time_of_it() {
    for pause_s in [0, 300] {
        let diagnosis = diagnosed(HEAD, &jump(pause_s));
        let step = finding(&diagnosis, "step").expect("there is one");
        let end = |index: usize| step.parameters["at_s"]["ci95"][index].as_f64().expect("a number");
        println!("{} {}", end(0), end(1));
        let before_s = f64::from(2000 - pause_s);
        assert!(step.claimed && end(0) <= before_s && end(0) > before_s - 30.0);
        assert!((2010.0..2040.0).contains(&end(1)));
    }
}

/// Twenty hours of a spindle at six speeds with pauses, whose heat, by this power of the speed, moves `quantity` behind
/// 40 min from cold; and two thermometers: of the room, and of a bed that follows the room.
fn heated_by_speed(quantity: &str, power: i32, um_per_unit: f64) -> String {
    let mut noise = Noise(19);
    let mut run = format!("time_s,spindle_rpm,temp_room_c,temp_bed_c,measured_{quantity}_um\n");
    let (mut warm, mut bed_c) = (0.0, 20.0);
    for n in 0..600 {
        let time_s = 120.0 * f64::from(n);
        let speed = [2.0, 5.0, 1.0, 4.0, 3.0, 6.0][n as usize / 100];
        let krpm: f64 = if n % 100 < 70 { speed } else { 0.0 };
        if n > 0 {
            warm += (krpm.powi(power) - warm) * -(-120.0_f64 / 2400.0).exp_m1();
        }
        let room_c = 20.0 + 1.5 * (TAU * time_s / 50_000.0).sin() + 0.05 * noise.next();
        bed_c += (room_c - bed_c) * 0.05;
        let um = um_per_unit * warm + 0.3 * noise.next();
        run += &format!("{time_s},{},{room_c:.3},{bed_c:.3},{um:.3}\n", krpm * 1000.0);
    }
    run
}

#[test]
fn heat_by_the_speed_is_claimed_with_its_power_and_time_constant_on_an_axis_and_in_the_growth() {
    for (quantity, power, um_per_unit) in
        [("dx", 2, 0.6), ("dy", 1, -2.5), ("dz", 2, -0.5), ("elongation", 1, 3.0)]
    {
        let diagnosis = diagnosed(HEAD, &heated_by_speed(quantity, power, um_per_unit));
        let report = &diagnosis.report;
        assert_eq!(claimed(&diagnosis), ["extra-heat-path"], "{quantity}: {:?}", report.findings);
        let path = finding(&diagnosis, "extra-heat-path").expect("claimed");
        assert!(path.compensated && path.column.as_deref() == Some("spindle_rpm"), "{path:?}");
        let (input, key) =
            [("speed", "um_per_krpm"), ("speed2", "um_per_krpm2")][power as usize - 1];
        assert_eq!(path.parameters["input"]["value"], input);
        let value = |key: &str| path.parameters[key]["value"].as_f64().expect("a number");
        assert!((value(key) / um_per_unit - 1.0).abs() < 0.05, "{path:?}");
        assert!((value("time_constant_s") / 2400.0 - 1.0).abs() < 0.1, "{path:?}");
        assert_eq!(report.verdict.name(), "explained");
    }
}

/// Readings of `error` of X at uneven places, three cycles there and back.
fn along(error: impl Fn(f64) -> f64) -> String {
    let mut noise = Noise(11);
    let mut run = String::from("run,x_mm,dir_x,measured_dx_um\n");
    let places: Vec<f64> = (0..21).map(|n| 47.3 * f64::from(n) + 3.0 * noise.next()).collect();
    for cycle in 1..=3 {
        for (way, mm) in
            places.iter().map(|mm| (1, mm)).chain(places.iter().rev().map(|mm| (-1, mm)))
        {
            run += &format!("{cycle},{mm:.4},{way},{:.4}\n", error(*mm) + 0.3 * noise.next());
        }
    }
    run
}

/// A screw that is stretched evenly between its bearings, and one whose pretension ends in the middle of the way: both
/// say what can be repaired.
#[test]
fn a_long_screw_and_a_kink_name_the_pretension_as_what_can_be_repaired() {
    let machine = format!("{HEAD}[axis.x]\nfeedback = \"screw\"\n");
    let even = diagnosed(&machine, &along(|mm| 0.02 * mm));
    let kink = diagnosed(&machine, &along(|mm| 0.03 * (mm - 450.0).max(0.0)));
    for (diagnosis, cause) in [(even, "pitch-scale"), (kink, "pitch-error")] {
        let found = finding(&diagnosis, cause);
        let found = found.unwrap_or_else(|| panic!("{cause}: {:?}", diagnosis.report.findings));
        assert!(found.next_test.contains("pretension"), "{cause}: {}", found.next_test);
    }
}
