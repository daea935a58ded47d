//! Power cuts drawn over a whole update on the chip: in a flash word, in an erase, between.

use std::{
    env, fmt,
    str::FromStr,
    sync::atomic::{AtomicU32, AtomicU64, Ordering},
    thread,
    time::Instant,
};

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use trueup_boot::flash_layout::Slot;

use crate::board::{ANSWER_MS, Board, CONFIRMS, LOADS, RESETS, boot, file, longest_silence};

/// Runs at a time.
const THREADS: u64 = 2;

/// A run in which the board held.
struct Run {
    is_good: bool,
    /// Orders of the cuts, as the model has them.
    script: String,
    /// Cuts that took place: one ordered in a word that was never reached does not.
    cuts: u32,
    /// Longest silence after a reset, in ms.
    silence_ms: f64,
}

impl fmt::Display for Run {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fate = if self.is_good { "confirmed" } else { "rejected" };
        let Self { script, cuts, silence_ms, .. } = self;
        let orders = script.trim().replace('\n', ", ");
        write!(f, "{fate}; {orders}; {cuts} cuts; answers in {silence_ms:.0} ms")
    }
}

/// Lives with two cuts at places that the seed draws, then undisturbed; an error says what went wrong.
fn cut_twice(seed: u64) -> Result<Run, String> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let is_good = random.random_bool(0.6);
    let behaviour = if is_good { CONFIRMS } else { RESETS };
    let new = file(Slot::B, 2, 2, behaviour);
    let old = file(Slot::A, 1, 0, LOADS);
    let board = Board::with(&old, &[]).ok_or("no model")?.offering(&new);
    // A flash word of this life, or an instant: in an erase, most of all.
    let words = new.len() as u64 / 4 + 80;
    let mut cut = |from: u32| match random.random_range(0..3) {
        0 => format!("{from} cut {}\n", random.random_range(1..=words)),
        1 => format!("{from} cut {}\n", words - random.random_range(0..80)),
        _ => format!("{} reset power\n", from + random.random_range(20..2_200)),
    };
    let script = cut(0) + &cut(2_500);
    let mut lines = board.live(9_000, &script, &[]);
    let cuts = lines.iter().filter(|(_, line)| line.contains("power")).count();
    lines.retain(|(_, line)| line != "c" && line != "u");
    // After each reset an image speaks, in time.
    let silence_ms = longest_silence(&lines);
    if silence_ms > ANSWER_MS {
        return Err(format!("silent for {silence_ms} ms after a reset: {lines:?}"));
    }
    let last = lines.last().map(|(_, line)| line.as_str());
    let is_right = match is_good {
        true => last == Some("B") && board.slot(Slot::B)[..new.len()] == new,
        // One that resets is given up for the old one, which loads it again and again.
        false => {
            let events: Vec<&str> = lines.iter().map(|(_, line)| line.as_str()).collect();
            events.contains(&"B") && goes_back(&events) && board.slot(Slot::A)[..old.len()] == old
        }
    };
    let run = Run { is_good, script, cuts: cuts as u32, silence_ms };
    if is_right { Ok(run) } else { Err(format!("{run}: {lines:?}")) }
}

/// Returns whether the old image spoke between any two starts of the new one; a power cut alone keeps a trial.
fn goes_back(events: &[&str]) -> bool {
    let mut has_reset = false;
    events.iter().all(|line| {
        let is_second = has_reset && *line == "B";
        has_reset = *line == "B" || has_reset && *line != "A" && !line.contains("power");
        !is_second
    })
}

/// Draws runs from a seed on until there were this many cuts, or one fails; prints each as it ends.
fn draw(cuts: u32, first: u64) {
    let Some(_) = boot() else { return };
    let (next, done) = (AtomicU64::new(first), AtomicU32::new(0));
    let began = Instant::now();
    let run = || {
        let mut failures = Vec::new();
        while done.load(Ordering::Relaxed) < cuts {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            let start = Instant::now();
            let result = cut_twice(seed);
            let (run, took) = match result {
                Ok(run) => (run, start.elapsed().as_secs_f64()),
                Err(failure) => {
                    println!("seed {seed}: FAILED");
                    failures.push(format!("seed {seed}: {failure}"));
                    break;
                }
            };
            let sum = done.fetch_add(run.cuts, Ordering::Relaxed) + run.cuts;
            println!("seed {seed}: {run}; {took:.1} s; {sum} cuts so far");
        }
        failures
    };
    let failures: Vec<String> = thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS).map(|_| scope.spawn(run)).collect();
        threads.into_iter().flat_map(|thread| thread.join().expect("it does not panic")).collect()
    });
    let (runs, took) = (next.into_inner() - first, began.elapsed().as_secs());
    let cuts = done.into_inner();
    println!("{cuts} power cuts on the chip in {runs} runs, {} failed, {took} s", failures.len());
    assert!(failures.is_empty(), "{failures:#?}");
}

#[test]
#[ignore = "long: some power cuts on the model of the chip"]
fn power_cuts_drawn_over_an_update_leave_a_board_that_answers() {
    draw(4, 0);
}

/// Returns the number in a variable of the environment.
fn number<T: FromStr>(name: &str, default: T) -> T {
    let Ok(text) = env::var(name) else { return default };
    text.parse().unwrap_or_else(|_| panic!("{name}={text}: give a number"))
}

/// `TRUEUP_CUTS` is how many, `TRUEUP_CUTS_FROM` the seed to begin with: one that was stopped goes on with the first
/// seed that was not printed.
#[test]
#[ignore = "campaign: cargo test --features trueup-host-tests/emulator --test boot_program campaign_of_three -- --ignored --nocapture"]
fn campaign_of_three_hundred_power_cuts_over_an_update() {
    draw(number("TRUEUP_CUTS", 300), number("TRUEUP_CUTS_FROM", 1_000));
}
