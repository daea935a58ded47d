//! Challenges: what is asked for is what is drawn.

use std::time::Instant;

use trueup_campaigns::hidden_effects::{
    DISTINGUISHABLE_PAIRS, ExpectedDiagnosis, HiddenCause, TestCase, draw_test_case,
    draw_test_case_with_cause_pair,
};

/// Returns the named column of a run file of numbers; NaN where a cell is empty.
fn column(csv: &str, name: &str) -> Vec<f64> {
    let mut lines = csv.lines();
    let header = lines.next().expect("a header");
    let at = header.split(',').position(|there| there == name).expect(name);
    lines
        .map(|line| {
            let cell = line.split(',').nth(at).expect("a full row");
            if cell.is_empty() { f64::NAN } else { cell.parse().expect("a number") }
        })
        .collect()
}

fn measured(challenge: &TestCase) -> Vec<f64> {
    let name = format!("measured_{}_um", challenge.quantity);
    challenge.runs.iter().flat_map(|csv| column(csv, &name)).collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

fn about_mean(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|v| v - mean).collect()
}

#[test]
fn a_seed_repeats_to_the_byte_and_another_one_differs() {
    for &cause in HiddenCause::ALL {
        let first = draw_test_case(cause, 3.0, 11);
        let again = draw_test_case(cause, 3.0, 11);
        assert!(first.runs == again.runs && first.holdout == again.holdout, "{}", cause.name());
        assert!(first.machine == again.machine && first.truth.effects == again.truth.effects);
        assert!(first.runs != draw_test_case(cause, 3.0, 12).runs, "{}", cause.name());
    }
}

#[test]
fn the_effect_over_the_noise_is_the_ratio_that_was_asked_for() {
    let (mut worst, mut drawn) = (0.0_f64, 0);
    for &cause in HiddenCause::ALL {
        if cause.expected_diagnosis() == ExpectedDiagnosis::Clean {
            continue;
        }
        for (seed, ratio) in [(1, 0.5), (2, 1.0), (3, 3.0), (4, 10.0)] {
            let challenge = draw_test_case(cause, ratio, seed);
            let truth = &challenge.truth;
            // From the files, not from what the truth says of itself.
            let left: Vec<f64> = measured(&challenge)
                .iter()
                .zip(&truth.believed_um)
                .zip(&truth.effect_um)
                .map(|((measured, believed), effect)| measured - believed - effect)
                .filter(|left| !left.is_nan())
                .collect();
            let effect = if challenge.quantity == "elongation" {
                truth.effect_um.clone()
            } else {
                about_mean(&truth.effect_um)
            };
            let off = rms(&effect) / rms(&left) / ratio - 1.0;
            worst = worst.max(off.abs());
            drawn += 1;
            assert!(off.abs() < 0.02, "{} seed {seed}: {off}", cause.name());
            assert!((rms(&left) / truth.noise_rms_um - 1.0).abs() < 1e-9);
        }
    }
    println!("{drawn} challenges: ratio off by at most {:.2} %", worst * 100.0);
}

#[test]
fn runs_have_the_lengths_that_users_have() {
    let (mut least, mut most) = (usize::MAX, 0);
    for &cause in HiddenCause::ALL {
        for seed in 0..6 {
            let challenge = draw_test_case(cause, 3.0, seed);
            let rows = measured(&challenge).len();
            assert_eq!(rows, challenge.truth.effect_um.len().max(rows));
            (least, most) = (least.min(rows), most.max(rows));
            let held = challenge.holdout.lines().count() - 1;
            assert_eq!(held, challenge.truth.holdout_noise_um.len());
            assert_eq!(held, challenge.truth.holdout_believed_um.len());
            assert!(held >= 150, "{held}");
        }
    }
    println!("{least} to {most} training rows");
    assert!(least >= 290 && most <= 3000);
}

/// A hold-out on which the effect does not show measures nothing.
#[test]
fn what_can_be_compensated_can_be_gained_on_the_hold_out() {
    for &cause in HiddenCause::ALL {
        if cause.expected_diagnosis() != ExpectedDiagnosis::Compensated {
            continue;
        }
        let gains =
            (0..8).map(|seed| draw_test_case(cause, 5.0, seed).truth.max_holdout_rms_reduction());
        let least = gains.fold(f64::MAX, f64::min);
        println!("{:28} {least:.3}", cause.name());
        assert!(least > 0.3, "{}: {least}", cause.name());
    }
}

/// On the cause's own law: what a user would compute by hand from the parameters is the effect.
#[test]
fn the_parameters_are_those_of_the_effect() {
    for seed in 0..5 {
        let challenge = draw_test_case(HiddenCause::SensorGain, 3.0, seed);
        let gain = challenge.truth.effects[0].parameter("gain").expect("a gain");
        for (p, effect) in challenge.truth.believed_um.iter().zip(&challenge.truth.effect_um) {
            assert!((gain * p - p - effect).abs() < 1e-9);
        }
        let challenge = draw_test_case(HiddenCause::CuttingLoad, 3.0, seed);
        let c = challenge.truth.effects[0].parameter("um_per_n").expect("a compliance");
        assert!(c > 0.0);
        let load: Vec<f64> = challenge.runs.iter().flat_map(|r| column(r, "load_n")).collect();
        for (load, effect) in load.iter().zip(&challenge.truth.effect_um) {
            assert!((-c * load - effect).abs() < 1e-9);
        }
        let challenge = draw_test_case(HiddenCause::Backlash, 3.0, seed);
        let width = challenge.truth.effects[0].parameter("width_um").expect("a width");
        let dir = format!("dir_{}", &challenge.quantity[1..]);
        let direction: Vec<f64> = challenge.runs.iter().flat_map(|r| column(r, &dir)).collect();
        for (direction, effect) in direction.iter().zip(&challenge.truth.effect_um) {
            assert_eq!(*effect, if *direction < 0.0 { width } else { 0.0 });
        }
        let challenge = draw_test_case(HiddenCause::SensorSaturation, 3.0, seed);
        let limit = challenge.truth.effects[0].parameter("limit_um").expect("a limit");
        for (p, effect) in challenge.truth.believed_um.iter().zip(&challenge.truth.effect_um) {
            assert!((p.min(limit) - p - effect).abs() < 1e-9);
        }
    }
}

#[test]
fn clean_challenges_have_no_effect_and_the_noise_that_they_say() {
    for seed in 0..6 {
        for cause in [HiddenCause::CleanWhite, HiddenCause::CleanCorrelated] {
            let challenge = draw_test_case(cause, 3.0, seed);
            let truth = &challenge.truth;
            assert!(truth.effects.is_empty() && truth.effect_um.iter().all(|um| *um == 0.0));
            assert_eq!(truth.expected, ExpectedDiagnosis::Clean);
            assert_eq!(truth.noise_rho > 0.0, cause == HiddenCause::CleanCorrelated);
        }
    }
}

#[test]
fn every_listed_pair_can_be_drawn_and_is_twice_as_strong_in_square() {
    for &(first, second) in DISTINGUISHABLE_PAIRS {
        let challenge =
            draw_test_case_with_cause_pair(first, second, 3.0, 5).expect("a shared base");
        let truth = &challenge.truth;
        assert_eq!(truth.effects.len(), 2, "{} {}", first.name(), second.name());
        for effect in &truth.effects {
            let off = effect.rms_um / truth.noise_rms_um / 3.0 - 1.0;
            assert!(off.abs() < 0.02, "{} in a pair: {off}", effect.cause.name());
        }
    }
    assert!(
        draw_test_case_with_cause_pair(HiddenCause::SensorGain, HiddenCause::Backlash, 3.0, 5)
            .is_none()
    );
}

#[test]
fn a_challenge_is_drawn_in_well_under_a_second() {
    let start = Instant::now();
    let mut drawn = 0;
    for &cause in HiddenCause::ALL {
        for seed in 20..22 {
            drawn += draw_test_case(cause, 2.0, seed).runs.len().min(1);
        }
    }
    let each = start.elapsed().as_secs_f64() / drawn as f64;
    println!("{:.1} ms a challenge", each * 1e3);
    assert!(each < 1.0);
}

/// Returns what is left of `effect` (RMS) after the best straight line over `rival`.
fn left_by(effect: &[f64], rival: &[f64]) -> f64 {
    let (effect, rival) = (about_mean(effect), about_mean(rival));
    let square: f64 = rival.iter().map(|r| r * r).sum();
    let both: f64 = effect.iter().zip(&rival).map(|(e, r)| e * r).sum();
    let slope = if square > 0.0 { both / square } else { 0.0 };
    rms(&effect.iter().zip(&rival).map(|(e, r)| e - slope * r).collect::<Vec<_>>())
}

/// The two laws of an axis by hand: c·(T − T_ref)·(P − P₀)/1000 where the part follows at once, and a
/// tilt that grows in proportion along the axis.
#[test]
fn an_axis_expands_and_tilts_as_its_parameters_say() {
    let (mut at_once, mut straight) = (0, 0);
    for seed in 0..12 {
        let all = |challenge: &TestCase, name: &str| -> Vec<f64> {
            challenge.runs.iter().flat_map(|run| column(run, name)).collect()
        };
        let challenge = draw_test_case(HiddenCause::AxisExpansion, 3.0, seed);
        assert!(!challenge.machine.contains(".thermal]"), "the file knows nothing of this heat");
        let effect = &challenge.truth.effects[0];
        let of = |name| effect.parameter(name).expect(name);
        assert!(of("um_per_m_per_c") > 0.0);
        if of("time_constant_s") == 0.0 {
            at_once += 1;
            let mm = all(&challenge, &format!("{}_mm", &challenge.quantity[1..]));
            let screw_c = all(&challenge, "temp_screw_c");
            for ((mm, c), um) in mm.iter().zip(&screw_c).zip(&challenge.truth.effect_um) {
                let from_m = (mm - of("origin_mm")) / 1000.0;
                let expected = of("um_per_m_per_c") * (c - of("reference_c")) * from_m;
                assert!((um - expected).abs() < 1e-9, "{um} is not {expected}");
            }
        }
        let challenge = draw_test_case(HiddenCause::AngularError, 3.0, seed);
        let effect = &challenge.truth.effects[0];
        let lever = effect.column.as_deref().expect("a lever");
        assert_ne!(lever, format!("{}_mm", &challenge.quantity[1..]));
        if let Some(urad_per_m) = effect.parameter("urad_per_m") {
            straight += 1;
            let origin_mm = effect.parameter("origin_mm").expect("a reference");
            let mm = all(&challenge, &format!("{}_mm", &challenge.quantity[1..]));
            let lever_mm = all(&challenge, lever);
            for ((mm, lever), um) in mm.iter().zip(&lever_mm).zip(&challenge.truth.effect_um) {
                let expected = urad_per_m * mm / 1000.0 * (lever - origin_mm) / 1000.0;
                assert!((um - expected).abs() < 1e-9, "{um} is not {expected}");
            }
        }
    }
    assert!(at_once > 0 && straight > 0 && straight < 12, "{at_once} {straight}");
}

/// A cause can be named only if no other straight law of anything in the file does as well: the
/// difference of BIC, N·ln(1 + (left/noise)²), must be well above the 6 that a diagnosis asks for.
#[test]
fn no_other_straight_law_explains_the_effect_as_well() {
    // The cause, and the rival that is its own law.
    for (cause, own) in [
        (HiddenCause::SensorGain, "p"),
        (HiddenCause::SensorCurvature, "p squared"),
        (HiddenCause::SensorTemperatureDrift, "temp_coil_c"),
        (HiddenCause::CentrifugalGrowth, "speed squared"),
        (HiddenCause::CuttingLoad, "load_n"),
        (HiddenCause::Backlash, "direction"),
        (HiddenCause::PositionDependentBacklash, "position where reverse"),
        (HiddenCause::PitchScale, "position"),
    ] {
        let (mut least, mut rival_of_least) = (f64::MAX, String::new());
        for seed in 0..6 {
            let challenge = draw_test_case(cause, 3.0, seed);
            let truth = &challenge.truth;
            let all = |name: &str| -> Vec<f64> {
                challenge.runs.iter().flat_map(|run| column(run, name)).collect()
            };
            let p = &truth.believed_um;
            let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect();
            let mut rivals: Vec<(String, Vec<f64>)> = vec![("p squared".into(), product(p, p))];
            if challenge.quantity == "elongation" {
                rivals.push(("p".into(), p.clone()));
                rivals.push((
                    "speed squared".into(),
                    product(&all("spindle_rpm"), &all("spindle_rpm")),
                ));
            } else {
                rivals.clear();
                let axis = &challenge.quantity[1..];
                let position = all(&format!("{axis}_mm"));
                let reverse: Vec<f64> =
                    all(&format!("dir_{axis}")).iter().map(|d| f64::from(*d < 0.0)).collect();
                rivals.push(("position where reverse".into(), product(&position, &reverse)));
                rivals.push(("position".into(), position));
                rivals.push(("direction".into(), reverse));
            }
            let header = challenge.runs[0].lines().next().expect("a header");
            for name in header.split(',') {
                if name == "time_s" || name == "load_n" || name.starts_with("temp_") {
                    rivals.push((name.to_string(), all(name)));
                }
            }
            for (name, rival) in rivals.iter().filter(|(name, _)| name != own) {
                let left = left_by(&truth.effect_um, rival) / truth.noise_rms_um;
                let gap = p.len() as f64 * (left * left).ln_1p();
                if gap < least {
                    (least, rival_of_least) = (gap, name.clone());
                }
            }
        }
        println!("{:28} nearest rival {rival_of_least}, {least:.0}", cause.name());
        assert!(least > 20.0, "{}: {rival_of_least} {least}", cause.name());
    }
}

#[test]
fn every_drawn_challenge_can_be_solved() {
    for &cause in HiddenCause::ALL {
        let challenge = draw_test_case(cause, 3.0, 0);
        let truth = &challenge.truth;
        let name = cause.name();
        assert!(!challenge.runs.is_empty() && !truth.believed_um.is_empty(), "{name}");
        assert_eq!(truth.believed_um.len(), truth.effect_um.len(), "{name}");
        let all = truth.believed_um.iter().chain(&truth.effect_um);
        assert!(all.copied().all(f64::is_finite), "{name}");
        // The noise is there, and its memory ends.
        assert!(truth.noise_rms_um > 0.0 && (0.0..1.0).contains(&truth.noise_rho), "{name}");
        let reduction = truth.max_holdout_rms_reduction();
        let least = if truth.effects.is_empty() { 0.0 } else { 0.3 };
        assert!((least..1.0).contains(&reduction), "{name}: {reduction}");
        for effect in &truth.effects {
            assert!(effect.rms_um > truth.noise_rms_um, "{name}: {} µm", effect.rms_um);
            let values = effect.parameters.iter().map(|(_, value)| *value);
            assert!(values.clone().all(f64::is_finite), "{name}");
        }
    }
}
