//! The score card: every cause of the twin at a ratio of effect to noise, drawn from seeds.
//!
//! `cargo run --release -p trueup-diagnose --example scorecard -- RATIO SEEDS [FIRST] [cause…|pairs|first+second]`

use std::{env, thread};

#[path = "../tests/score/mod.rs"]
mod score;

use score::{Row, answer, score};
use trueup_twin::hidden::{Hidden, PAIRS, draw, draw_pair};

fn main() {
    let words: Vec<String> = env::args().skip(1).collect();
    let number = |index: usize, default: f64| -> f64 {
        words.get(index).and_then(|word| word.parse().ok()).unwrap_or(default)
    };
    let (ratio, seeds, first) = (number(0, 3.0), number(1, 20.0) as u64, number(2, 0.0) as u64);
    let wanted: Vec<&str> = words.iter().skip(3).map(String::as_str).collect();
    let is_wanted = |name: &str| wanted.is_empty() || wanted.contains(&name);
    let cores = thread::available_parallelism().map_or(1, usize::from) as u64;
    let row = |of: &(dyn Fn(u64) -> score::Score + Sync)| -> Row {
        thread::scope(|scope| {
            let workers: Vec<_> = (0..cores)
                .map(|core| {
                    scope.spawn(move || {
                        (first..first + seeds)
                            .filter(|seed| seed % cores == core)
                            .map(of)
                            .collect::<Vec<_>>()
                    })
                })
                .collect();
            let scores = workers
                .into_iter()
                .flat_map(|worker| worker.join().expect("a diagnosis does not panic"))
                .collect();
            Row { scores }
        })
    };
    for &cause in Hidden::ALL {
        if is_wanted(cause.name()) {
            let all = row(&|seed| {
                let challenge = draw(cause, ratio, seed);
                score(&challenge, &answer(&challenge))
            });
            println!("{}", all.line(cause.name()));
            if env::var_os("TRUEUP_SEEDS").is_some() {
                for it in &all.scores {
                    println!("    {it:?}");
                }
            }
        }
    }
    for &(a, b) in PAIRS {
        let both = format!("{}+{}", a.name(), b.name());
        if is_wanted("pairs") || is_wanted(&both) {
            let all = row(&|seed| {
                let challenge =
                    draw_pair(a, b, ratio, seed).expect("the twin's own pairs can be drawn");
                score(&challenge, &answer(&challenge))
            });
            println!("{}", all.line(&format!("{} + {}", a.name(), b.name())));
        }
    }
}
