//! Two runs that differ by something known, and many that change.

use std::{fmt::Write as _, path::Path};

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal};
use trueup_compare::{
    dated_constants::{
        ConstantEstimate, RunConstantEstimates, estimate_run_constants, find_date_in_file_name,
    },
    run_comparison::{RunComparison, compare_runs},
    trend::fit_trends,
};
use trueup_machine::RunFile;

/// Three runs up and down over 21 places of X, with noise of 0.3 µm: `error` of position and direction.
fn run(quantity: &str, seed: u64, error: impl Fn(f64, f64) -> f64) -> RunFile {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, 0.3).expect("a positive width");
    let mut text = format!("run,x_mm,dir_x,measured_{quantity}_um\n");
    for run in 1..=3 {
        for (dir, k) in (0..=20).map(|k| (1, k)).chain((0..=20).rev().map(|k| (-1, k))) {
            let x = 50.0 * f64::from(k);
            let um = error(x, f64::from(dir)) + normal.sample(&mut rng);
            writeln!(text, "{run},{x},{dir},{um}").expect("a string takes all");
        }
    }
    RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file")
}

fn pitch(x: f64) -> f64 {
    8.0 * (x / 170.0).sin()
}

fn between(quantity: &str, seed: u64, change: impl Fn(f64, f64) -> f64) -> RunComparison {
    let a = run(quantity, seed, |x, _| pitch(x));
    let b = run(quantity, seed + 1000, |x, dir| pitch(x) + 3.0 + change(x, dir));
    compare_runs(&a, &b, None).expect("they have places in common")
}

#[test]
fn equal_runs_do_not_differ_but_for_chance() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let reported = (0..200).filter(|_| between("dx", rng.random(), |_, _| 0.0).differs).count();
    println!("{reported} of 200 equal pairs are reported as different");
    // By the difference of BIC one in a hundred or two; the 99 % limit of a binomial with 2 %.
    assert!(reported <= 10, "{reported}");
    let it = between("dx", 1, |_, _| 0.0);
    assert!((it.shift_um - 3.0).abs() < 0.2 && it.places.len() == 42, "{it:?}");
}

#[test]
fn bad_readings_are_excluded_by_their_lines_and_make_no_difference() {
    let text = |seed, spoiled: &[(usize, f64)]| {
        let run = run("dx", seed, |x, _| pitch(x));
        let columns =
            ["run", "x_mm", "dir_x", "measured_dx_um"].map(|name| run.column(name).expect("there"));
        let mut text = "run,x_mm,dir_x,measured_dx_um\n".to_string();
        for row in 0..run.row_count() {
            let off = spoiled.iter().find(|entry| entry.0 == row).map_or(0.0, |entry| entry.1);
            let [number, x, dir, um] = columns.map(|all| all[row]);
            writeln!(text, "{number},{x},{dir},{}", um + off).expect("a string takes all");
        }
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file")
    };
    let (a, b) = (text(1, &[(20, 40.0)]), text(2, &[(3, -60.0), (90, 25.0)]));
    let it = compare_runs(&a, &b, None).expect("they have places in common");
    let found: Vec<(usize, usize)> =
        it.outliers.iter().map(|outlier| (outlier.file, outlier.line)).collect();
    assert_eq!(found, [(0, 22), (1, 5), (1, 92)]);
    assert!(!it.differs && it.repeatability_um.is_some_and(|um| um < 0.4), "{it:?}");
    assert!(
        it.sentences.iter().any(|sentence| sentence.contains("r.csv:92 (+")),
        "{:?}",
        it.sentences
    );
}

#[test]
fn this_years_backlash_is_distinguished_from_last_years_with_its_interval() {
    let it = between("dx", 5, |_, dir| if dir < 0.0 { 2.0 } else { 0.0 });
    assert_eq!((it.differs, it.cause), (true, Some("backlash")), "{it:?}");
    assert!(it.sentences[0].starts_with("Backlash has changed by +"), "{:?}", it.sentences);
    // The interval holds the truth as often as it says; 89 is the 99 % limit of a binomial.
    let holds = |seed: &u64| {
        let it = between("dx", *seed, |_, dir| if dir < 0.0 { 2.0 } else { 0.0 });
        it.changes.first().is_some_and(|change| (change.value - 2.0).abs() <= change.half_width)
    };
    let held = (100..200).filter(holds).count();
    println!("the interval of the change holds the truth in {held} of 100");
    assert!(held >= 89, "{held}");
    // Each place has an interval, and 95 of 100 hold the truth.
    let truth = |dir: i8| if dir < 0 { 1.0 } else { -1.0 };
    let held = it.places.iter().filter(|place| {
        (place.difference_um - truth(place.direction)).abs()
            <= place.half_width_um.expect("repeats")
    });
    assert!(held.count() >= 36, "{it:?}");
}

#[test]
fn a_longer_screw_is_a_slope() {
    let it = between("dx", 7, |x, _| 5.0 * x / 1000.0);
    assert_eq!(it.cause, Some("pitch-scale"), "{it:?}");
}

#[test]
fn an_unloaded_and_a_cut_guideway_differ_by_a_curve() {
    let it = between("dz", 9, |x, _| 6.0 * (x / 120.0).cos());
    assert_eq!((it.differs, it.cause), (true, Some("straightness")), "{it:?}");
    assert!(it.sentences[0].contains("by a curve"), "{:?}", it.sentences);
}

#[test]
fn runs_without_places_in_common_are_refused() {
    let a = run("dx", 1, |x, _| pitch(x));
    let text = "x_mm,measured_dx_um\n7001,0\n7002,0\n7003,0\n7004,0\n";
    let b = RunFile::from_reader(text.as_bytes(), Path::new("b.csv")).expect("a run file");
    let message = compare_runs(&a, &b, None).expect_err("nothing in common").to_string();
    assert!(message.contains("0 places in common"), "{message}");
    let c = run("dz", 1, |_, _| 0.0);
    assert!(compare_runs(&a, &c, None).is_err());
}

#[test]
fn wear_is_a_line_with_an_interval_and_a_date() {
    // 4 µm of backlash, and 1.5 µm more each year, over two years.
    let dates = ["2024-01-10", "2024-07-10", "2025-01-10", "2025-07-10", "2026-01-10"];
    let day = |date: &str| find_date_in_file_name(date).expect("a date");
    let first = day(dates[0]);
    let days: Vec<(i64, Vec<ConstantEstimate>)> = dates
        .into_iter()
        .map(|date| {
            let years = (day(date) - first) as f64 / 365.25;
            let width = 4.0 + 1.5 * years;
            let run = run("dx", years.to_bits(), |_, dir| if dir < 0.0 { width } else { 0.0 });
            (day(date), estimate_run_constants(&run).constants)
        })
        .collect();
    let found = fit_trends(&days, Some(2.0), None);
    let wear = found
        .iter()
        .find(|constant| constant.name == "axis.x.backlash.width_um")
        .expect("it is there");
    let [rate, half] = wear.per_year.expect("five days");
    println!("{wear:?}");
    assert!(wear.changes && (rate - 1.5).abs() <= half && half < 0.5, "{wear:?}");
    // 2 µm at 1.5 µm a year are 16 months, less where the rate may be faster.
    let by = wear.measure_again_by.as_deref().expect("a day");
    assert!(("2026-10-01".."2027-05-12").contains(&by), "{by}");
    let slope = found.iter().find(|constant| constant.name.contains("slope")).expect("it is there");
    assert!(
        !slope.changes || slope.per_year.is_some_and(|[rate, _]| rate.abs() < 0.3),
        "{slope:?}"
    );
    // A step is none either.
    let value =
        |name: &str, value: f64| ConstantEstimate { name: name.into(), value, half_width: None };
    let levels = [4.0, 4.1, 3.9, 9.0, 9.1, 8.9];
    let steps: Vec<_> =
        (0..6).map(|n| (first + 90 * n, vec![value("k", levels[n as usize])])).collect();
    let stepped = &fit_trends(&steps, None, None)[0];
    let found = stepped.step.as_ref().expect("a step");
    assert!((found.size - 5.0).abs() < 0.3 && stepped.per_year.is_none(), "{stepped:?}");
    // Two days are no trend.
    let two = fit_trends(&days[..2], None, None);
    assert!(two[0].per_year.is_none() && two[0].sentence.contains("needs 3"), "{two:?}");
}

#[test]
fn a_warmer_run_is_no_difference_where_the_machine_file_knows_the_expansion() {
    let machine = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x]\nfeedback = \"screw\"\n[axis.x.thermal]\n\
                   mode = \"position\"\nsensor = \"temp_screw_c\"\nreference_c = 20.0\nslope_um_per_m_per_c = 11.5\n\
                   origin_mm = 0.0\n[axis.x.backlash]\nwidth_um = 3.0\n";
    let machine =
        trueup_machine::MachineFile::parse(machine, Path::new("m.toml")).expect("a machine file");
    let at = |celsius: f64, seed: usize| {
        let noise = [0.4, -0.3, 0.1, -0.5, 0.2, 0.3, -0.2];
        let mut text = "x_mm,dir_x,temp_screw_c,measured_dx_um\n".to_string();
        for n in 0..60 {
            let (x, dir) = (100.0 * (n % 10) as f64, if n / 10 % 2 == 0 { 1.0 } else { -1.0 });
            let um = 11.5 * (celsius - 20.0) * x / 1000.0 + if dir < 0.0 { 3.0 } else { 0.0 };
            text += &format!("{x},{dir},{celsius},{:.2}\n", um + noise[(n * 3 + seed) % 7]);
        }
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file")
    };
    let (cool, warm) = (at(20.0, 1), at(26.0, 4));
    let raw = compare_runs(&cool, &warm, None).expect("comparable");
    assert_eq!(raw.cause, Some("pitch-scale"), "{raw:?}");
    let [(cool, message), (warm, _)] = [cool, warm].map(|run| {
        trueup_compare::thermal_expansion::remove_thermal_expansion(&run, Some(&machine))
    });
    assert!(message.contains("taken off"), "{message}");
    let corrected = compare_runs(&cool, &warm, None).expect("comparable");
    assert!(!corrected.differs, "{corrected:?}");
    let slope = estimate_run_constants(&warm)
        .constants
        .into_iter()
        .find(|constant| constant.name.contains("slope"))
        .expect("a slope");
    assert!(slope.value.abs() < 1.0, "{slope:?}");
}

#[test]
fn one_bad_reading_moves_no_backlash_of_a_dated_run() {
    let mut text = "x_mm,dir_x,measured_dx_um\n".to_string();
    for n in 0..42 {
        let (x, dir) = (100.0 + 300.0 * (n % 3) as f64, if n / 3 % 2 == 0 { 1.0 } else { -1.0 });
        let bad = if n == 10 { 90.0 } else { 0.0 };
        let noise = [0.3, -0.2, 0.4, -0.4, 0.1][n % 5];
        text += &format!("{x},{dir},{:.2}\n", if dir < 0.0 { 6.0 } else { 0.0 } + noise + bad);
    }
    let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file");
    let RunConstantEstimates { constants, outliers } = estimate_run_constants(&run);
    let width = constants.iter().find(|constant| constant.name.contains("width")).expect("a width");
    assert!((width.value - 6.0).abs() < 0.3, "{width:?}");
    assert!(outliers.len() == 1 && outliers[0].1 > 10.0, "{outliers:?}");
}
