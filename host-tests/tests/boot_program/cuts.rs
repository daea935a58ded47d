//! Power cuts drawn over a whole update on the chip: in a flash word, in an erase, between.

use std::thread;

use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use trueup_boot::layout::Slot;

use crate::board::{Board, CONFIRMS, LOADS, RESETS, boot, file};

/// A board answers within this many ms after a reset: of which an erase of both sectors of a slot takes 1.6 s.
const ANSWER_MS: f64 = 2_000.0;
/// Runs at a time.
const THREADS: u64 = 2;

/// Lives with two cuts at places that the seed draws, then undisturbed; says what went wrong.
fn cut_twice(seed: u64) -> Result<u32, String> {
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
    let cuts = lines.iter().filter(|(_, it)| it.contains("power")).count();
    lines.retain(|(_, it)| it != "c" && it != "u");
    // After each reset somebody speaks, in time.
    let mut since = Some(0.0);
    for (at, said) in &lines {
        match since {
            Some(from) if at - from > ANSWER_MS => {
                return Err(format!("seed {seed}: silent from {from} to {at}: {lines:?}"));
            }
            _ => since = said.starts_with("reset").then_some(*at),
        }
    }
    let last = lines.last().map(|(_, it)| it.as_str());
    let is_right = match is_good {
        true => last == Some("B") && board.slot(Slot::B)[..new.len()] == new,
        // One that resets is given up for the old one, which loads it again and again.
        false => lines.iter().any(|(_, it)| it == "A") && board.slot(Slot::A)[..old.len()] == old,
    };
    if is_right { Ok(cuts as u32) } else { Err(format!("seed {seed}: {lines:?}")) }
}

/// Draws runs until there were this many cuts.
fn draw(cuts: u32, first: u64) {
    let Some(_) = boot() else { return };
    let results: Vec<Result<u32, String>> = thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS)
            .map(|number| {
                scope.spawn(move || {
                    let (mut seed, mut done) = (first + number, 0);
                    while done < cuts.div_ceil(THREADS as u32) {
                        done += cut_twice(seed)?;
                        seed += THREADS;
                    }
                    Ok(done)
                })
            })
            .collect();
        threads.into_iter().map(|it| it.join().expect("it does not panic")).collect()
    });
    let done: u32 =
        results.into_iter().map(|it| it.unwrap_or_else(|error| panic!("{error}"))).sum();
    println!("{done} power cuts on the chip");
}

#[test]
#[ignore = "long: some power cuts on the model of the chip"]
fn power_cuts_drawn_over_an_update_leave_a_board_that_answers() {
    draw(4, 0);
}

#[test]
#[ignore = "campaign: cargo test --features trueup-host-tests/emulator --test boot_program campaign -- --ignored --nocapture"]
fn campaign_of_three_hundred_power_cuts_over_an_update() {
    draw(300, 1_000);
}
