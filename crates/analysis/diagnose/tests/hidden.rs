//! A hidden effect is found: a fixed, smaller part of the score card (`examples/scorecard` of `trueup-campaigns` is the
//! whole). The drawn truth is read only by the check.

use trueup_campaigns::{
    hidden_effects::{
        DISTINGUISHABLE_PAIRS, ExpectedDiagnosis, HiddenCause, draw_test_case,
        draw_test_case_with_cause_pair,
    },
    score::hidden_effect::{ScoreRow, run_diagnosis, score_diagnosis},
};

fn row(causes: &[HiddenCause], ratio: f64, seeds: std::ops::Range<u64>) -> ScoreRow {
    let scores = causes.iter().flat_map(|&cause| {
        seeds.clone().map(move |seed| {
            let challenge = draw_test_case(cause, ratio, seed);
            score_diagnosis(&challenge, &run_diagnosis(&challenge))
        })
    });
    ScoreRow { scores: scores.collect() }
}

#[test]
fn a_cause_of_an_elongation_three_times_the_noise_is_named() {
    let causes = [
        HiddenCause::SensorGain,
        HiddenCause::SensorCurvature,
        HiddenCause::SensorSaturation,
        HiddenCause::SensorTemperatureDrift,
        HiddenCause::ThermalLag,
        HiddenCause::ThermometerLag,
        HiddenCause::GrowthAmplitude,
        HiddenCause::CoolingAsymmetry,
        HiddenCause::CentrifugalGrowth,
        HiddenCause::CuttingLoad,
        HiddenCause::Drift,
    ];
    let all = row(&causes, 3.0, 0..1);
    println!("{}", all.format_line("elongation"));
    // The drift of this draw is named, but not claimed: a thermometer that drifts explains it as well.
    assert!(
        all.correct_fraction() >= 0.9 && all.false_claim_fraction() == 0.0,
        "{}",
        all.format_line("elongation")
    );
    let (median, worst) = all.gain();
    assert!(median >= 0.98 && worst >= 0.85, "{median} {worst}");
}

#[test]
fn a_cause_of_an_axis_three_times_the_noise_is_named() {
    let causes = [
        HiddenCause::PitchPeriodic,
        HiddenCause::PositionDependentBacklash,
        HiddenCause::FeedDependentBacklash,
        HiddenCause::Straightness,
        HiddenCause::CrossAxis,
        HiddenCause::AngularError,
        HiddenCause::ExpansionSlope,
        HiddenCause::ExpansionConstant,
        HiddenCause::DriftByRun,
    ];
    let all = row(&causes, 3.0, 0..1);
    println!("{}", all.format_line("axis"));
    assert!(
        all.correct_fraction() == 1.0 && all.false_claim_fraction() == 0.0,
        "{}",
        all.format_line("axis")
    );
}

#[test]
fn what_has_no_name_is_reported_and_no_name_is_claimed_for_it() {
    let all = row(&[HiddenCause::CriticalSpeed, HiddenCause::PreloadChange], 3.0, 0..1);
    println!("{}", all.format_line("unnamed"));
    assert!(
        all.correct_fraction() == 1.0 && all.false_claim_fraction() == 0.0,
        "{}",
        all.format_line("unnamed")
    );
}

/// Ten times the noise, where what is nearly right leaves much: a growth that is another one above a speed is no
/// square of the speed, nor is a resonance.
#[test]
fn a_law_without_a_name_is_not_taken_for_the_square_of_the_speed() {
    for (cause, seeds) in
        [(HiddenCause::PreloadChange, [106, 107]), (HiddenCause::CriticalSpeed, [103, 109])]
    {
        for seed in seeds {
            let all = row(&[cause], 10.0, seed..seed + 1);
            assert!(
                all.correct_fraction() == 1.0 && all.false_claim_fraction() == 0.0,
                "{}",
                all.scores[0]
            );
        }
    }
    // As large as the noise both do as well, and neither is claimed.
    let as_well = row(&[HiddenCause::PreloadChange], 1.0, 103..104);
    assert!(as_well.false_claim_fraction() == 0.0, "{}", as_well.scores[0]);
}

/// A slope over a time would blur what happens in it, by more than the noise.
#[test]
fn a_late_thermometer_is_named_where_the_gauge_is_ten_times_as_good() {
    for seed in [100, 103] {
        let all = row(&[HiddenCause::ThermometerLag], 10.0, seed..seed + 1);
        assert!(
            all.correct_fraction() == 1.0 && all.false_claim_fraction() == 0.0,
            "{}",
            all.scores[0]
        );
    }
}

/// A table of each way follows both at once, before one of them alone is worth as much.
#[test]
fn a_wave_and_a_play_are_not_taken_for_a_table() {
    let challenge = draw_test_case_with_cause_pair(
        HiddenCause::PitchPeriodic,
        HiddenCause::Backlash,
        10.0,
        102,
    );
    let challenge = challenge.expect("one machine shows both");
    let score = score_diagnosis(&challenge, &run_diagnosis(&challenge));
    assert!(score.is_right && !score.is_wrong, "{score}");
}

#[test]
fn nothing_is_found_in_noise_with_and_without_a_memory() {
    let all = row(&[HiddenCause::CleanWhite, HiddenCause::CleanCorrelated], 3.0, 0..3);
    println!("{}", all.format_line("clean"));
    for score in &all.scores {
        assert!(score.is_right, "{score}");
    }
}

#[test]
fn two_causes_are_both_named() {
    for (first, second) in [
        (HiddenCause::CentrifugalGrowth, HiddenCause::CuttingLoad),
        (HiddenCause::ExpansionSlope, HiddenCause::ThermalLag),
    ] {
        let challenge =
            draw_test_case_with_cause_pair(first, second, 3.0, 0).expect("one machine shows both");
        let score = score_diagnosis(&challenge, &run_diagnosis(&challenge));
        assert!(score.is_right, "{score}");
    }
}

/// The score card in short; the whole is `cargo xtask scorecard`.
#[test]
#[ignore = "long: two draws of each effect, one of each pair"]
fn of_all_effects_three_times_the_noise_nearly_all_are_named() {
    let is_clean = |cause: &HiddenCause| cause.expected_diagnosis() == ExpectedDiagnosis::Clean;
    let effects: Vec<HiddenCause> =
        HiddenCause::ALL.iter().copied().filter(|cause| !is_clean(cause)).collect();
    let mut all = row(&effects, 3.0, 0..2);
    let pairs = DISTINGUISHABLE_PAIRS.iter().map(|&(a, b)| {
        let challenge = draw_test_case_with_cause_pair(a, b, 3.0, 0)
            .expect("the twin's own pairs can be drawn");
        score_diagnosis(&challenge, &run_diagnosis(&challenge))
    });
    all.scores.extend(pairs);
    println!("{}", all.format_line("effects and pairs"));
    assert!(
        all.correct_fraction() >= 0.95 && all.false_claim_fraction() <= 0.05,
        "{}",
        all.format_line("effects and pairs")
    );
    let clean: Vec<HiddenCause> = HiddenCause::ALL.iter().copied().filter(is_clean).collect();
    let alarms = row(&clean, 3.0, 0..10);
    println!("{}", alarms.format_line("noise alone"));
    assert_eq!(alarms.false_claim_fraction(), 0.0, "{}", alarms.format_line("noise alone"));
}
