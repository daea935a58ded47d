//! A simulator by seed: node, wire, RAM that outlasts a reset, clock, spindle, thermometers, a CNC and
//! restarts. Every tick is checked against its conditions; a failure prints the seed that repeats it to
//! the bit.
//!
//! `cargo test -p trueup-node --test simulator` runs a million ticks, the long test ten million,
//! `cargo xtask soak` a thousand million.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]
// A test may count and round as it likes: what overflows panics.
#![allow(clippy::arithmetic_side_effects, clippy::cast_possible_truncation, clippy::cast_sign_loss)]

mod axis;
mod hostile;
mod machine;
#[path = "../spindle_model/mod.rs"]
mod spindle_model;
mod world;

use std::{
    env,
    sync::atomic::{AtomicU32, Ordering::Relaxed},
    thread,
    time::Instant,
};

use world::{Seen, World};

/// Ticks of one seed: ten minutes.
const TICKS: u64 = 600_000;

fn live(seed: u32, ticks: u64) -> Seen {
    let mut world = World::new(seed);
    for _ in 0..ticks {
        world.tick();
    }
    world.seen
}

fn soak(seeds: impl Iterator<Item = u32>, ticks: u64) -> Vec<Seen> {
    let started = Instant::now();
    let all: Vec<Seen> = seeds.map(|seed| live(seed, ticks)).collect();
    let sum = |of: fn(&Seen) -> u64| all.iter().map(of).sum::<u64>();
    let count = sum(|seen| seen.ticks);
    println!(
        "{} seeds, {count} ticks, {} restarts ({} power cuts, {} with another table), {} zeros, {:.0} times life; worst \
         live offset {} nm off",
        all.len(),
        sum(|seen| seen.restarts.into()),
        sum(|seen| seen.power_cuts.into()),
        sum(|seen| seen.tables.into()),
        sum(|seen| seen.zeros.into()),
        count as f64 / 1e3 / started.elapsed().as_secs_f64(),
        all.iter().map(|seen| seen.worst_live_nm).max().unwrap_or(0),
    );
    let qualities: Vec<u64> =
        (0..7).map(|n| all.iter().map(|seen| seen.qualities[n]).sum::<u64>()).collect();
    println!("ticks of each quality: {qualities:?}");
    all
}

#[test]
fn whatever_fails_the_offset_never_steps_and_is_what_it_says() {
    let all = soak(1..5, TICKS / 2);
    for quality in 0..7 {
        assert!(all.iter().any(|seen| seen.qualities[quality] > 0), "{quality} was never there");
    }
    assert!(all.iter().map(|seen| seen.restarts).sum::<u32>() > 10);
    assert!(all.iter().map(|seen| seen.zeros).sum::<u32>() > 10);
    assert!(all.iter().any(|seen| seen.worst_live_nm > 0), "something was compared");
}

#[test]
fn a_seed_repeats_itself_to_the_bit() {
    assert_eq!(live(9, 20_000), live(9, 20_000));
    assert_ne!(live(9, 20_000).checksum, live(10, 20_000).checksum);
}

#[test]
#[ignore = "long: ten million ticks"]
fn ten_million_ticks() {
    soak(100..117, TICKS);
}

#[test]
#[ignore = "campaign: cargo xtask soak"]
fn campaign_soak() {
    let requested = |name: &str, or: u64| {
        env::var(name).map_or(or, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text}")))
    };
    let ticks = requested("TRUEUP_SOAK_TICKS", 1_000_000_000);
    let first = u32::try_from(requested("TRUEUP_SOAK_SEED", 1_000)).expect("a seed has 32 bits");
    let seeds = first..first + u32::try_from(ticks.div_ceil(TICKS)).expect("in 32 bits");
    // So that a failure is seen when it comes, and not when all are through.
    const AT_ONCE: u32 = 50;
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let (next, started) = (AtomicU32::new(seeds.start), Instant::now());
    thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let from = next.fetch_add(AT_ONCE, Relaxed)
                    && from < seeds.end
                {
                    soak(from..seeds.end.min(from + AT_ONCE), TICKS);
                }
            });
        }
    });
    println!("{} seeds on {threads} cores, {:.0} s", seeds.len(), started.elapsed().as_secs_f64());
}
