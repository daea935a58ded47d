//! `scorecard scenarios`: the shipped scenarios over many seeds, each with the machine file of a user
//! who knows little; what is right of them stands in `docs/physical-faults.md`.

use std::process::ExitCode;

use trueup_campaigns::score::shipped_scenarios::SHIPPED_SCENARIOS;

use crate::{
    compare::{DrawScore, DrawScores},
    map_seeds_in_parallel,
    options::TierOptions,
};

/// The least share of right answers, of each.
const MIN_CORRECT_FRACTION: f64 = 0.98;

/// `scenarios [--seeds 50] [--first 0] [--each] [--tsv FILE] [name…]`.
pub fn run(words: &[String]) -> ExitCode {
    let asked = match TierOptions::parse(words, 50) {
        Ok(asked) => asked,
        Err(complaint) => return complaint,
    };
    let mut draws = DrawScores::default();
    let mut is_met = true;
    for shipped in SHIPPED_SCENARIOS.iter().filter(|scenario| asked.is_selected(scenario.name)) {
        let comparisons = map_seeds_in_parallel(asked.seeds(), &|seed| {
            (shipped.key)().compare(&shipped.run_diagnosis(seed).report)
        });
        let (mut right, mut false_names) = (0, 0);
        for (seed, comparison) in asked.seeds().zip(&comparisons) {
            if asked.each || !comparison.is_right() {
                println!("    seed {seed}: {comparison}");
            }
            let (is_right, is_wrong) = (comparison.is_right(), !comparison.wrong.is_empty());
            right += usize::from(is_right);
            false_names += usize::from(is_wrong);
            let draw = DrawScore::without_intervals(is_right, is_wrong, f64::NAN);
            draws.insert("shipped", shipped.name, seed, draw);
        }
        let share = right as f64 / comparisons.len().max(1) as f64;
        is_met &= share >= MIN_CORRECT_FRACTION;
        println!(
            "{:<20} n {:>3} right {:>5.1} % (target {:.0} %), a false claim in {false_names}",
            shipped.name,
            comparisons.len(),
            100.0 * share,
            100.0 * MIN_CORRECT_FRACTION,
        );
        asked.write_tsv(&draws);
    }
    ExitCode::from(u8::from(!is_met))
}
