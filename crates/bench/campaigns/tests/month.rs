//! The months that the learner is judged by stay what they are, and are what they say.

use std::fmt::Write as _;

use trueup_campaigns::simulated_month::{EVALUATION_SEEDS, simulate_month};

/// FNV-1a over 64 bits.
fn hash(text: &str) -> u64 {
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

#[test]
fn every_month_is_what_it_was() {
    let mut now = String::new();
    for seed in EVALUATION_SEEDS {
        let [ages, healthy] = [true, false].map(|ages| {
            let days = simulate_month(seed, ages).days;
            hash(&days.iter().map(|day| day.csv.as_str()).collect::<String>())
        });
        writeln!(now, "{seed} {ages:016x} {healthy:016x}").expect("a String takes all text");
    }
    assert_eq!(now, include_str!("month.txt"), "not the months of month.txt:\n{now}");
}

#[test]
fn one_reading_in_twenty_is_bad_and_every_fourth_day_has_none() {
    let (mut bad, mut all) = (0, 0);
    for seed in EVALUATION_SEEDS {
        let days = simulate_month(seed, true).days;
        assert_eq!(days.len(), 22);
        for (number, day) in days.iter().enumerate() {
            let read = |line: &&str| !line.ends_with(',');
            let readings = day.csv.lines().skip(1).filter(read).count();
            assert_eq!(day.is_probed, number % 4 != 2);
            assert_eq!(readings > 0, day.is_probed);
            bad += day.bad;
            all += readings;
        }
    }
    let share = f64::from(bad as u32) / f64::from(all as u32);
    println!("{bad} of {all} readings are bad");
    assert!((0.04..0.06).contains(&share), "{share}");
}
