//! The shipped scenarios, each with the machine file of a user who knows little: nothing false is
//! claimed. The whole is `scorecard scenarios`.

use trueup_campaigns::score::{
    answer_key::AnswerComparison,
    shipped_scenarios::{SHIPPED_SCENARIOS, ShippedScenario},
};

/// Compares the answer to the record of `seed` with its key.
fn compare_with_key(scenario: &ShippedScenario, seed: u64) -> AnswerComparison {
    (scenario.key)().compare(&scenario.run_diagnosis(seed).report)
}

#[test]
fn an_axis_that_warms_up_is_named_along_and_across() {
    let [along, across, _] = &SHIPPED_SCENARIOS;
    let comparison_along = compare_with_key(along, 10);
    assert!(comparison_along.is_right(), "{comparison_along}");
    let comparison_across = compare_with_key(across, 10);
    assert!(comparison_across.is_right(), "{comparison_across}");
}

#[test]
fn a_wave_beside_an_uneven_screw_is_not_the_instruments() {
    let [along, ..] = &SHIPPED_SCENARIOS;
    let comparison = compare_with_key(along, 41);
    assert!(comparison.is_right(), "{comparison}");
}
