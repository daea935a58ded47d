//! The score card: every effect of the twin at a ratio of effect to noise, drawn from seeds, and what
//! the diagnosis makes of it. The drawn truth is read only by the check.
//!
//! ```text
//! cargo run --release -p trueup-campaigns --example scorecard -- \
//!     [--ratios 3,1,10] [--seeds 20] [--few 20] [--clean 150] [--first 0] [--out docs/scorecard.md] \
//!     [--each] [--tsv FILE] [cause…|first+second]
//! … scorecard -- second [--seeds 10] [--first 0] [--each] [known+new…|known…]
//! … scorecard -- scenarios [--seeds 50] [--first 0] [--each] [--tsv FILE] [name…]
//! … scorecard -- physical [--seeds 300] [--first 0] [--each] [--tsv FILE] [faults|healthy]
//! … scorecard -- pairs [--seeds 1] [--first 0] [--each] [--tsv FILE] [a+b…]
//! … scorecard -- program TRUEUP [--ratios 3,1,10] [--seeds 20] [--first 0] [--tsv FILE] [cause…|first+second]
//! … scorecard -- compare BEFORE AFTER
//! ```
//!
//! `--seeds` counts at ratio 3, `--few` at the others, `--clean` for noise alone. `--each` prints every
//! answer, `--tsv` writes a line for each. The files are written anew after each row. `second` asks
//! what is named where the machine file has a cause already ([`second_cause`]), `scenarios` what is reported of
//! the shipped ones ([`scenarios`]), `physical` of machines with physical faults
//! ([`mod@physical`]), `pairs` of every two causes that one machine can have ([`mod@pairs`]), `program` what another
//! version's program makes of the same files ([`program`]), `compare` what has become better or worse between two
//! cards, draw by draw ([`compare`]).
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "an example prints its result")]

mod compare;
mod options;
mod pairs;
mod physical;
mod program;
mod scenarios;
mod score_card;
mod second_cause;

use std::{env, fs, path::PathBuf, process::ExitCode, thread};

use compare::DrawScores;
use score_card::ScoreCard;
use trueup_campaigns::{
    hidden_effects::{
        DISTINGUISHABLE_PAIRS, ExpectedDiagnosis, HiddenCause, draw_test_case,
        draw_test_case_with_cause_pair,
    },
    score::hidden_effect::{HiddenEffectScore, ScoreRow, run_diagnosis, score_diagnosis},
};

/// Arguments of the command.
pub(crate) struct Arguments {
    ratios: Vec<f64>,
    seeds: u64,
    few: u64,
    clean: u64,
    first: u64,
    out: Option<PathBuf>,
    each: bool,
    tsv: Option<PathBuf>,
    names: Vec<String>,
}

pub(crate) fn parse_arguments(words: &[String]) -> Option<Arguments> {
    let mut it = Arguments {
        ratios: vec![3.0, 1.0, 10.0],
        seeds: 20,
        few: 20,
        clean: 150,
        first: 0,
        out: None,
        each: false,
        tsv: None,
        names: Vec::new(),
    };
    let mut words = words.iter();
    while let Some(word) = words.next() {
        match word.as_str() {
            "--ratios" => {
                let list = words.next()?;
                it.ratios = list.split(',').map(|word| word.parse().ok()).collect::<Option<_>>()?;
            }
            "--seeds" => it.seeds = words.next()?.parse().ok()?,
            "--few" => it.few = words.next()?.parse().ok()?,
            "--clean" => it.clean = words.next()?.parse().ok()?,
            "--first" => it.first = words.next()?.parse().ok()?,
            "--out" => it.out = Some(words.next()?.into()),
            "--tsv" => it.tsv = Some(words.next()?.into()),
            "--each" => it.each = true,
            _ if word.starts_with('-') => return None,
            _ => it.names.push(word.clone()),
        }
    }
    Some(it)
}

/// Returns what `of` makes of each of `seeds`, in their order, on all cores.
pub(crate) fn map_seeds_in_parallel<T: Send>(
    seeds: std::ops::Range<u64>,
    of: &(dyn Fn(u64) -> T + Sync),
) -> Vec<T> {
    let cores = thread::available_parallelism().map_or(1, usize::from) as u64;
    let mut answers: Vec<(u64, T)> = thread::scope(|scope| {
        let workers: Vec<_> = (0..cores)
            .map(|core| {
                let own = seeds.clone().filter(move |seed| seed % cores == core);
                scope.spawn(move || own.map(|seed| (seed, of(seed))).collect::<Vec<_>>())
            })
            .collect();
        workers
            .into_iter()
            .flat_map(|worker| worker.join().expect("a diagnosis does not panic"))
            .collect()
    });
    answers.sort_by_key(|(seed, _)| *seed);
    answers.into_iter().map(|(_, answer)| answer).collect()
}

/// Returns the answers to `seeds`, in their order.
fn score_seeds(
    seeds: std::ops::Range<u64>,
    of: &(dyn Fn(u64) -> HiddenEffectScore + Sync),
) -> ScoreRow {
    ScoreRow { scores: map_seeds_in_parallel(seeds, of) }
}

fn main() -> ExitCode {
    let words: Vec<String> = env::args().skip(1).collect();
    match words.first().map(String::as_str) {
        Some("second") => return second_cause::run(&words[1..]),
        Some("physical") => return physical::run(&words[1..]),
        Some("scenarios") => return scenarios::run(&words[1..]),
        Some("pairs") => return pairs::run(&words[1..]),
        Some("program") => return program::run(&words[1..]),
        Some("compare") => return compare::run(&words[1..]),
        _ => {}
    }
    let Some(asked) = parse_arguments(&words) else {
        eprintln!("error: see the head of examples/scorecard/main.rs for what may be asked");
        return ExitCode::from(2);
    };
    let is_selected =
        |name: &str| asked.names.is_empty() || asked.names.iter().any(|there| there == name);
    let mut card = ScoreCard::default();
    let mut draws = DrawScores::default();
    let mut done = |ratio: f64, name: String, row: ScoreRow| {
        println!("ratio {ratio}: {}", row.format_line(&name));
        if asked.each {
            for (seed, score) in row.scores.iter().enumerate() {
                println!("    seed {}: {score}", asked.first + seed as u64);
            }
        }
        draws.add_row(ratio, &name, asked.first, &row);
        if let Some(path) = &asked.tsv
            && let Err(error) = fs::write(path, draws.to_tsv())
        {
            eprintln!("error: {}: {error}", path.display());
        }
        card.rows.push((ratio, name, row));
        if let Some(path) = &asked.out
            && let Err(error) = fs::write(path, card.to_markdown())
        {
            eprintln!("error: {}: {error}", path.display());
        }
    };
    let drawn = |cause: HiddenCause, ratio: f64, count: u64| {
        score_seeds(asked.first..asked.first + count, &|seed| {
            let challenge = draw_test_case(cause, ratio, seed);
            score_diagnosis(&challenge, &run_diagnosis(&challenge))
        })
    };
    for (number, &ratio) in asked.ratios.iter().enumerate() {
        let seeds = if ratio == 3.0 { asked.seeds } else { asked.few };
        for &cause in HiddenCause::ALL {
            if is_selected(cause.name()) && cause.expected_diagnosis() != ExpectedDiagnosis::Clean {
                done(ratio, cause.name().into(), drawn(cause, ratio, seeds));
            }
        }
        for &(a, b) in DISTINGUISHABLE_PAIRS {
            let both = format!("{}+{}", a.name(), b.name());
            if is_selected(&both) {
                let row = score_seeds(asked.first..asked.first + seeds, &|seed| {
                    let challenge = draw_test_case_with_cause_pair(a, b, ratio, seed)
                        .expect("the twin's own pairs can be drawn");
                    score_diagnosis(&challenge, &run_diagnosis(&challenge))
                });
                done(ratio, both, row);
            }
        }
        // Noise alone has no ratio.
        for &cause in HiddenCause::ALL.iter().filter(|_| number == 0) {
            if is_selected(cause.name()) && cause.expected_diagnosis() == ExpectedDiagnosis::Clean {
                done(ratio, cause.name().into(), drawn(cause, ratio, asked.clean));
            }
        }
    }
    println!("{}", card.format_totals());
    ExitCode::SUCCESS
}
