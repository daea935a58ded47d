//! Backlash that depends on the feed (paper 4): reported, and not averaged away.

use std::fmt::Write as _;

use crate::pitch_support::run_of;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal};
use trueup_fit::pitch::{BacklashFit, PitchFitOptions, fit_backlash};
use trueup_machine::machine_file::LinearAxis;

/// Three places, seven times, at each feed with its width; noise of 0.3 µm.
fn run(widths: &[(f64, f64)], seed: u64) -> String {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, 0.3).expect("a positive width");
    let mut text = String::from("run,x_mm,dir_x,feed_mm_per_min,measured_dx_um\n");
    for &(feed, width) in widths {
        for (place, run) in [50, 500, 950].into_iter().flat_map(|at| (1..=7).map(move |n| (at, n)))
        {
            for (dir, um) in [(-1, width), (1, 0.0)] {
                let um = um + normal.sample(&mut rng);
                writeln!(text, "{run},{place},{dir},{feed},{um}").expect("a string takes all");
            }
        }
    }
    text
}

fn fitted(text: &str, feed_mm_per_min: Option<f64>) -> BacklashFit {
    let options = PitchFitOptions { feed_mm_per_min, ..PitchFitOptions::default() };
    fit_backlash(&run_of(text), LinearAxis::X, &options).expect("it keeps the rules")
}

fn width(fit: &BacklashFit) -> f64 {
    fit.backlash.as_ref().expect("a width").width_um
}

#[test]
fn six_and_eleven_micrometres_do_not_become_eight_and_a_half() {
    let text = run(&[(1000.0, 6.0), (200.0, 11.0)], 1);
    let slow = fitted(&text, None);
    assert!((width(&slow) - 11.0).abs() < 0.5, "{:?}", slow.report);
    let warnings = slow.report.warnings.join(" ");
    for part in ["depends on the feed", "µm at 200 mm/min", "at 1000 mm/min -", "--feed"] {
        assert!(warnings.contains(part), "{part}: {warnings}");
    }
    let fast = fitted(&text, Some(1000.0));
    assert!((width(&fast) - 6.0).abs() < 0.5, "{:?}", fast.report);
    let warnings = fast.report.warnings.join(" ");
    assert!(
        warnings.contains("at 200 mm/min 5.") || warnings.contains("at 200 mm/min 4."),
        "{warnings}"
    );
    assert_eq!((slow.report.rows_used, fast.report.rows_used), (42, 42));
}

#[test]
fn feeds_that_do_not_differ_are_one_measurement_but_for_one_in_a_hundred() {
    let mut reported = 0;
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..200 {
        let fit = fitted(&run(&[(1000.0, 6.0), (200.0, 6.0)], rng.random()), None);
        let warned =
            fit.report.warnings.iter().any(|warning| warning.contains("depends on the feed"));
        reported += usize::from(warned);
        assert_eq!(fit.report.rows_used, if warned { 42 } else { 84 });
    }
    println!("reported {reported} of 200 without a difference");
    // The 99 % limit of a binomial with 1 %.
    assert!(reported <= 6, "{reported}");
}

#[test]
fn a_feed_that_was_not_measured_is_refused_with_those_that_were() {
    let options =
        |feed| PitchFitOptions { feed_mm_per_min: Some(feed), ..PitchFitOptions::default() };
    let text = run(&[(1000.0, 6.0), (200.0, 11.0)], 1);
    let message =
        fit_backlash(&run_of(&text), LinearAxis::X, &options(500.0)).expect_err("not there");
    assert!(message.rule.contains("but 200, 1000"), "{message}");
    let without = text.replace("feed_mm_per_min", "note");
    let one = without.lines().take(43).collect::<Vec<_>>().join("\n");
    let message =
        fit_backlash(&run_of(&one), LinearAxis::X, &options(500.0)).expect_err("no column");
    assert!(message.rule.contains("feed_mm_per_min"), "{message}");
}

#[test]
fn one_bad_reading_of_seven_is_excluded_by_its_line_and_the_width_stays() {
    let all = run(&[(1000.0, 6.0)], 5);
    let one_place: String = all
        .lines()
        .filter(|line| !line.contains(",50,") && !line.contains(",950,"))
        .fold(String::new(), |text, line| text + line + "\n");
    for (text, bad_row) in [(&all, 3), (&all, 22), (&all, 41), (&one_place, 4), (&one_place, 13)] {
        for off_um in [25.0, -60.0] {
            let spoiled = |(row, line): (usize, &str)| match line.rsplit_once(',') {
                Some((rest, um)) if row == bad_row => {
                    format!("{rest},{}\n", um.parse::<f64>().expect("a number") + off_um)
                }
                _ => format!("{line}\n"),
            };
            let text: String = text.lines().enumerate().map(spoiled).collect();
            let fit = fitted(&text, None);
            assert!((width(&fit) - 6.0).abs() < 0.5, "{:?}", fit.report);
            let [excluded] = &fit.report.excluded[..] else { panic!("{:?}", fit.report.excluded) };
            // The header is line 1.
            assert_eq!(excluded.place.line, bad_row + 1);
        }
    }
}
