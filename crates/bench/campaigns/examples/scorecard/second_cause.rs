//! `scorecard second`: what is named where the machine file has a cause already.
//!
//! For each pair (in the file, new in the data) of [`known_and_new_cause_pairs`] `--seeds` draws at ratio 3: *right*
//! is the new cause claimed and no other, *alone* is right without any other finding, claimed or not.
//! Then the aged files: a term with about half of its true size, and the same cause is the answer.

use std::{ops::Range, path::Path, process::ExitCode};

use trueup_campaigns::{
    hidden_effects::TestCase,
    known_term::{
        compensated_causes, draw_test_case_with_changed_term, draw_test_case_with_known_term,
        known_and_new_cause_pairs,
    },
    score::hidden_effect::{HiddenEffectScore, ScoreRow, run_diagnosis, score_diagnosis},
};
use trueup_machine::MachineFile;

use crate::score_seeds;

const EFFECT_TO_NOISE_RATIO: f64 = 3.0;
/// The least share of all draws, and of each pair's.
const MIN_RIGHT_SHARES: [f64; 2] = [0.95, 0.8];

fn is_right(score: &HiddenEffectScore) -> bool {
    score.is_right && !score.is_wrong
}

fn is_sole_finding(score: &HiddenEffectScore) -> bool {
    is_right(score) && score.named.len() + score.unclaimed.len() == 1
}

/// Counts over rows.
#[derive(Default)]
struct RowCounts {
    draws: usize,
    right: usize,
    alone: usize,
    /// Rows below the target of a row.
    below: Vec<String>,
}

impl RowCounts {
    fn add(&mut self, name: &str, row: &ScoreRow) {
        let count = |of: fn(&HiddenEffectScore) -> bool| {
            row.scores.iter().filter(|score| of(score)).count()
        };
        let (right, alone, draws) = (count(is_right), count(is_sole_finding), row.scores.len());
        self.draws += draws;
        self.right += right;
        self.alone += alone;
        let is_below = (right as f64) < MIN_RIGHT_SHARES[1] * draws as f64;
        if is_below {
            self.below.push(name.to_string());
        }
        println!(
            "{name:<60} n {draws:>3} right {right:>3} alone {alone:>3}{}  {}",
            if is_below { " BELOW" } else { "" },
            format_wrong_answers(row)
        );
    }

    fn print(&self, what: &str) {
        let percent = |count: usize| 100.0 * count as f64 / self.draws.max(1) as f64;
        println!(
            "\n{what}: {} draws, right {:.1} % (target {:.0} %), alone {:.1} %, rows below {:.0} %: {}\n",
            self.draws,
            percent(self.right),
            100.0 * MIN_RIGHT_SHARES[0],
            percent(self.alone),
            100.0 * MIN_RIGHT_SHARES[1],
            self.below.len()
        );
    }
}

/// Returns what was answered where the answer was not right.
fn format_wrong_answers(row: &ScoreRow) -> String {
    let wrong = row.scores.iter().enumerate().filter(|(_, score)| !is_right(score));
    let named = wrong.map(|(seed, score)| {
        let open = score.unclaimed.iter().map(|name| format!("?{name}"));
        let names: Vec<String> = score.named.iter().cloned().chain(open).collect();
        format!(
            "{seed}: {}",
            if names.is_empty() { score.verdict.name().into() } else { names.join("+") }
        )
    });
    named.collect::<Vec<String>>().join("; ")
}

/// Returns the answers to the draws of `seeds`; the reader's complaint where the file cannot have that term.
fn score_draws(
    seeds: Range<u64>,
    drawn: &(dyn Fn(u64) -> TestCase + Sync),
) -> Result<ScoreRow, String> {
    let first = drawn(seeds.start);
    MachineFile::parse(&first.machine, Path::new("machine.toml")).map_err(|bad| bad.to_string())?;
    Ok(score_seeds(seeds, &|seed| {
        let challenge = drawn(seed);
        score_diagnosis(&challenge, &run_diagnosis(&challenge))
    }))
}

/// `second [--seeds N] [--first N] [--each] [known+new…|known…]`.
pub fn run(words: &[String]) -> ExitCode {
    let (mut seeds, mut first, mut each, mut names) = (10, 0, false, Vec::new());
    let mut words = words.iter();
    while let Some(word) = words.next() {
        let number = |next: Option<&String>| next.and_then(|word| word.parse::<u64>().ok());
        match (word.as_str(), word.starts_with('-')) {
            ("--each", _) => each = true,
            ("--seeds" | "--first", _) => match number(words.next()) {
                Some(number) if word == "--seeds" => seeds = number,
                Some(number) => first = number,
                None => return reject_argument(word),
            },
            (_, true) => return reject_argument(word),
            (name, false) => names.push(name.to_string()),
        }
    }
    let is_selected = |known: &str, name: &str| {
        names.is_empty() || names.iter().any(|other| other == known || other == name)
    };
    let seeds = first..first + seeds;
    let count_row = |sum: &mut RowCounts, name: String, row: Result<ScoreRow, String>| match row {
        Ok(row) => {
            sum.add(&name, &row);
            for (seed, score) in seeds.clone().zip(&row.scores).filter(|_| each) {
                println!("    seed {seed}: {score}");
            }
        }
        Err(refused) => println!("{name:<60} cannot stand in a file: {refused}"),
    };
    let mut sum = RowCounts::default();
    for (a, b) in known_and_new_cause_pairs() {
        let name = format!("{}+{}", a.name(), b.name());
        if is_selected(a.name(), &name) {
            let drawn = |seed| {
                draw_test_case_with_known_term(a, b, EFFECT_TO_NOISE_RATIO, seed)
                    .expect("both can be drawn together")
            };
            count_row(&mut sum, name, score_draws(seeds.clone(), &drawn));
        }
    }
    sum.print("a cause in the file, another one new");
    let mut aged = RowCounts::default();
    for cause in compensated_causes() {
        let name = format!("{} aged", cause.name());
        if is_selected(cause.name(), &name) {
            let drawn = |seed| draw_test_case_with_changed_term(cause, EFFECT_TO_NOISE_RATIO, seed);
            count_row(&mut aged, name, score_draws(seeds.clone(), &drawn));
        }
    }
    aged.print("a cause in the file that has changed");
    let is_met = |sum: &RowCounts| {
        sum.below.is_empty() && sum.right as f64 >= MIN_RIGHT_SHARES[0] * sum.draws as f64
    };
    ExitCode::from(u8::from(!is_met(&sum) || !is_met(&aged)))
}

fn reject_argument(word: &str) -> ExitCode {
    eprintln!("error: {word}: second takes --seeds N, --first N, --each and names");
    ExitCode::from(2)
}
