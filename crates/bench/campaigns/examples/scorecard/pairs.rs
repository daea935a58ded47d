//! `scorecard pairs`: every pair of causes that one machine can have ([`trueup_campaigns::score::cause_pairs`]), at ratio 3.

use std::process::ExitCode;

use trueup_campaigns::score::cause_pairs::{
    CausePair, MAX_INCORRECT_FRACTION, MIN_CORRECT_FRACTION, PairScore, find_value_errors,
};

use crate::{
    compare::{DrawScore, DrawScores},
    map_seeds_in_parallel,
    options::TierOptions,
};

/// `pairs [--seeds 1] [--first 0] [--each] [--tsv FILE] [a+b…]`.
pub fn run(words: &[String]) -> ExitCode {
    let asked = match TierOptions::parse(words, 1) {
        Ok(asked) => asked,
        Err(complaint) => return complaint,
    };
    let mut draws = DrawScores::default();
    // Draws that can be distinguished; of those: right, with a wrong name, with a value or a gain that is off.
    let mut sum = [0; 4];
    for pair in
        CausePair::all_compatible().into_iter().filter(|pair| asked.is_selected(&pair.name()))
    {
        let judged = map_seeds_in_parallel(asked.seeds(), &|seed| pair.diagnose_and_score(seed));
        let judged: Vec<(u64, PairScore)> =
            asked.seeds().zip(judged).filter_map(|(seed, judged)| Some((seed, judged?))).collect();
        let count =
            |of: &dyn Fn(&PairScore) -> bool| judged.iter().filter(|(_, draw)| of(draw)).count();
        let counts = [
            judged.len(),
            count(&|draw| draw.is_right),
            count(&|draw| draw.score.is_wrong),
            count(&|draw| !find_value_errors(&draw.score).is_empty()),
        ];
        let [n, right, wrong, off] = counts;
        println!("{:<52} n {n:>3} right {right:>3} wrong {wrong:>3} off {off:>3}", pair.name());
        for (seed, PairScore { score, is_right }) in &judged {
            let complaint = find_value_errors(score);
            if asked.each || !is_right || !complaint.is_empty() {
                println!("    seed {seed}: {score}; {}", complaint.join(", "));
            }
            let draw = DrawScore::without_intervals(*is_right, score.is_wrong, score.share_of_gain);
            draws.insert("pairs", &pair.name(), *seed, draw);
        }
        sum.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
        asked.write_tsv(&draws);
    }
    let percent = |count: usize| 100.0 * count as f64 / sum[0].max(1) as f64;
    let [n, right, wrong, off] = sum;
    println!(
        "{n} draws whose causes can be separated: both named and nothing else claimed in {:.1} % (target {:.0} %), a \
         wrong name in {:.1} % (target {:.0} %), an interval or a gain that is off in {:.1} %",
        percent(right),
        100.0 * MIN_CORRECT_FRACTION,
        percent(wrong),
        100.0 * MAX_INCORRECT_FRACTION,
        percent(off),
    );
    let is_met = right as f64 >= MIN_CORRECT_FRACTION * n as f64
        && wrong as f64 <= MAX_INCORRECT_FRACTION * n as f64;
    ExitCode::from(u8::from(!is_met))
}
