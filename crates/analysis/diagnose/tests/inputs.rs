//! Laws of recorded inputs that are in no list: the columns are named, the effect goes, and idle inputs are not named.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use trueup_campaigns::{
    input_dependence::DEPENDENCE_KINDS, score::input_dependence::diagnose_and_score_dependence,
};

/// The campaign in short; `cargo run -p trueup-campaigns --example inputs` is the whole.
#[test]
#[ignore = "long: four draws of each of 21 kinds, and forty without"]
fn laws_of_recorded_inputs_are_named_by_their_columns() {
    let (mut named, mut gone, mut foreign, mut all) = (0, 0, 0, 0);
    for kind in &DEPENDENCE_KINDS[1..] {
        for seed in 0..4 {
            let score = diagnose_and_score_dependence(*kind, seed);
            if !score.is_named || score.is_foreign || score.gone < 0.85 {
                println!("{} {seed}: {}", kind.name, score.findings);
            }
            named += usize::from(score.is_named);
            gone += usize::from(score.gone >= 0.85);
            foreign += usize::from(score.is_foreign);
            all += 1;
        }
    }
    let idle = (0..40)
        .filter(|seed| diagnose_and_score_dependence(DEPENDENCE_KINDS[0], *seed).is_foreign)
        .count();
    println!(
        "of {all}: {named} named, {gone} with 85 % gone, {foreign} foreign; of 40 without: {idle} claimed"
    );
    assert!(20 * named >= 19 * all, "{named} of {all} named");
    assert!(100 * gone >= 90 * all, "{gone} of {all} gone");
    assert!(25 * foreign <= all, "{foreign} of {all} foreign");
    assert!(idle <= 1, "{idle} of 40");
}
