//! A campaign of laws of recorded inputs that are in no list of causes.
//!
//! ```text
//! cargo run --release -p trueup-campaigns --example inputs -- [DRAWS [FIRST SEED [CONTROLS]]]
//! ```
//!
//! For each kind of [`trueup_campaigns::input_dependence`]: in how many draws all columns are named and claimed, something foreign is
//! claimed, and 85 % of what can go is gone on another day; then how many days without an effect have a claim.
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use trueup_campaigns::{
    input_dependence::{DEPENDENCE_KINDS, DependenceKind},
    score::input_dependence::{DependenceScore, diagnose_and_score_dependence},
};
use trueup_numerics::parallel::parallel_map;

fn main() {
    let mut numbers =
        std::env::args().skip(1).map(|argument| argument.parse::<u64>().expect("whole numbers"));
    let (draws, first) = (numbers.next().unwrap_or(40), numbers.next().unwrap_or(1000));
    let controls = numbers.next().unwrap_or(300);
    let of = |kind: DependenceKind, count: u64| -> Vec<DependenceScore> {
        let seeds: Vec<u64> = (first..first + count).collect();
        parallel_map(&seeds, true, |seed| diagnose_and_score_dependence(kind, *seed))
    };
    println!("kind                      draws named foreign gone");
    let mut sums = [0; 4];
    for kind in &DEPENDENCE_KINDS[1..] {
        let all = of(*kind, draws);
        let count = |is: fn(&DependenceScore) -> bool| all.iter().filter(|score| is(score)).count();
        let counts = [
            all.len(),
            count(|score| score.is_named),
            count(|score| score.is_foreign),
            count(|score| score.gone >= 0.85),
        ];
        let [n, named, foreign, gone] = counts;
        println!("{:<25} {n:>5} {named:>5} {foreign:>7} {gone:>4}", kind.name);
        for (seed, score) in
            (first..).zip(&all).filter(|(_, score)| !score.is_named || score.is_foreign)
        {
            println!("    {seed}: {}", score.findings);
        }
        sums.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
    }
    let [n, named, foreign, gone] = sums;
    println!("{:<25} {n:>5} {named:>5} {foreign:>7} {gone:>4}", "all");
    let idle = of(DEPENDENCE_KINDS[0], controls).iter().filter(|score| score.is_foreign).count();
    println!("{:<25} {controls:>5}       {idle:>7}", DEPENDENCE_KINDS[0].name);
}
