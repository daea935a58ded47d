//! The draws stay what they are: a seed of an older score card gives the same files today, byte for
//! byte, so that two versions of a diagnosis can be compared draw by draw.
//!
//! Each line of `golden.txt` is a challenge and the 64-bit FNV-1a of its files. A new cause adds
//! lines; a line that changes is a draw that no older score card can be compared with.

use std::{fmt::Write as _, fs, path::Path};

use trueup_campaigns::hidden_effects::{
    DISTINGUISHABLE_PAIRS, HiddenCause, TestCase, draw_test_case, draw_test_case_with_cause_pair,
};
use trueup_twin::{Scenario, simulate};

fn fnv_1a(texts: &[&str]) -> u64 {
    texts.iter().flat_map(|text| text.bytes()).fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

fn hash(challenge: &TestCase) -> u64 {
    let mut texts: Vec<&str> = challenge.runs.iter().map(String::as_str).collect();
    texts.extend([&*challenge.holdout, &*challenge.machine]);
    fnv_1a(&texts)
}

/// Returns one line for each: the name, and the hashes of seeds 0 to 3 at the ratios 1 and 3.
fn all() -> String {
    let mut text = String::new();
    let mut line = |name: &str, of: &dyn Fn(f64, u64) -> TestCase| {
        write!(text, "{name}").expect("a String takes all text");
        for (ratio, seed) in [(1.0, 0), (3.0, 1), (3.0, 2), (1.0, 3)] {
            write!(text, " {:016x}", hash(&of(ratio, seed))).expect("a String takes all text");
        }
        text.push('\n');
    };
    for &cause in HiddenCause::ALL {
        line(cause.name(), &|ratio, seed| draw_test_case(cause, ratio, seed));
    }
    for &(first, second) in DISTINGUISHABLE_PAIRS {
        let name = format!("{}+{}", first.name(), second.name());
        line(&name, &|ratio, seed| {
            draw_test_case_with_cause_pair(first, second, ratio, seed).expect("a listed pair")
        });
    }
    for name in ["scenario-axis.toml", "scenario-warmup.toml"] {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../data").join(name);
        let scenario = fs::read_to_string(&file).expect("a scenario is part of the repository");
        let scenario = Scenario::parse(&scenario, &file).expect("it is a scenario");
        let table = simulate(&scenario, 7, || ());
        writeln!(text, "{name} {:016x}", fnv_1a(&[&table.to_csv()])).expect("a String takes text");
    }
    text
}

#[test]
fn every_draw_is_what_it_was() {
    let kept = include_str!("golden.txt");
    let now = all();
    let changed: Vec<&str> = now.lines().filter(|line| !kept.contains(line)).collect();
    assert!(changed.is_empty(), "not the draws of golden.txt:\n{}", changed.join("\n"));
    assert_eq!(kept.lines().count(), now.lines().count(), "a draw is gone");
}
