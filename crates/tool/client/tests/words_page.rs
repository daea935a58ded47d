//! The book's page of words has every word that a bridge is described with, and no other.

use std::collections::BTreeSet;

use trueup_canopen::emergency::Faults;
use trueup_client::{
    remedy::REMEDIES,
    state_text::{fault_names, flag_names, quality_name, state_names},
};
use trueup_core::cnc::{OffsetFlags, OffsetQuality};
use trueup_link::status::{ResetReason, StateBits};

const PAGE: &str = include_str!("../../../../docs/book/src/words.md");

/// Returns the words in the first cells of a section's table.
fn words(section: &str) -> BTreeSet<&'static str> {
    let from = PAGE.split_once(section).unwrap_or_else(|| panic!("no section {section}")).1;
    let rows = from.lines().take_while(|line| !line.starts_with("## "));
    rows.filter(|row| row.starts_with("| `"))
        .flat_map(|row| {
            let cell = row.split(" | ").next().unwrap_or_default();
            cell.split(['|', ',', '`', ' ']).filter(|word| !word.is_empty())
        })
        .collect()
}

#[test]
fn every_word_on_the_screen_is_on_the_page_and_no_other() {
    use OffsetQuality::{Fault, Hold, Live, Off, RampingOut, TemperatureModel, WarmUpModel};
    let qualities = [Off, Live, TemperatureModel, WarmUpModel, Hold, RampingOut, Fault];
    assert_eq!(words("## Quality"), qualities.map(quality_name).into());
    assert_eq!(words("## Flags"), flag_names(OffsetFlags(u8::MAX)).into_iter().collect());
    let conditions = fault_names(Faults::from_words(u32::MAX, u32::MAX))
        .into_iter()
        .chain(state_names(StateBits(u32::MAX)));
    assert_eq!(words("## Faults and state"), conditions.collect());
    let reasons = (0..).map_while(ResetReason::from_wire).map(ResetReason::as_str);
    assert_eq!(words("## Why it last started"), reasons.collect());
    let all = ["## Flags", "## Faults and state", "## Frames of the CNC"].map(words);
    let remedies = REMEDIES.iter().map(|(word, _)| *word).collect();
    assert_eq!(all.into_iter().flatten().collect::<BTreeSet<_>>(), remedies);
}
