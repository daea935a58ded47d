//! The application itself, linked for a slot and signed, started by the boot program.

use std::path::PathBuf;

use trueup_boot::flash_layout::Slot;
use trueup_emulator::{setup, slot_images};

use crate::board::{Board, GOOD, boot, file, has, version};

/// Returns the image of the application, linked for a slot.
pub fn linked(slot: Slot) -> PathBuf {
    let machine = setup::project_root().join("data/paper_spindle.toml");
    slot_images::build_application(slot, &machine).expect("it builds")
}

/// Returns the file of the application for a slot.
pub fn application(slot: Slot, minor: u8) -> Vec<u8> {
    let body = slot_images::read_image_body(&linked(slot), slot).expect("a body");
    println!("the application for slot {} has {} bytes", slot.name(), body.len());
    let key = slot_images::load_development_key().expect("the developers' key");
    slot_images::build_signed_update(&body, slot, version(minor), version(0), &key)
}

/// Lives for a while with the application in this slot; panics unless it is a whole board.
fn lives_in(slot: Slot) {
    let file = application(slot, 1);
    let (a, b) = if slot == Slot::A { (&file[..], &[][..]) } else { (&[][..], &file[..]) };
    let board = Board::with(a, b).expect("it is there");
    let report = board.report(1_200, "300 flags 3\n", &[]);
    assert!(report.clean, "a violation:\n{}", report.stdout);
    let sent = |id: &str| {
        let is_it = |event: &&String| event.contains(&format!(" can {id} "));
        report.events.iter().filter(is_it).collect::<Vec<_>>()
    };
    let first = sent("281").first().and_then(|event| event.split(' ').next()?.parse::<f64>().ok());
    let first = first.expect("an offset is sent");
    println!("the first offset after {first:.0} ms, {} of them", sent("281").len());
    assert!(first < 400.0 && sent("281").len() > 700, "{}", report.stdout);
    // It checks itself from its own start on: one that is damaged gives no offset.
    assert!(report.stdout.contains("quality 1"), "{}", report.stdout);
}

#[test]
#[ignore = "long: the application on the model of the chip"]
fn the_application_runs_from_slot_a() {
    let Some(_) = boot() else { return };
    lives_in(Slot::A);
}

#[test]
#[ignore = "long: the application on the model of the chip"]
fn the_application_runs_from_slot_b() {
    let Some(_) = boot() else { return };
    lives_in(Slot::B);
}

/// Returns whether the small image in slot A speaks after a watchdog's reset of the application in slot B at that time.
fn goes_back(engaged: bool, reset_ms: u32) -> bool {
    let board =
        Board::with(&file(Slot::A, 1, 0, GOOD), &application(Slot::B, 2)).expect("it is there");
    let engage = if engaged { "300 flags 3\n" } else { "" };
    let lines = board.live(reset_ms + 600, &format!("{engage}{reset_ms} reset watchdog\n"), &[]);
    has(&lines, "A")
}

#[test]
#[ignore = "long: the application on the model of the chip"]
fn an_application_on_trial_that_the_watchdog_resets_gives_way() {
    let Some(_) = boot() else { return };
    assert!(goes_back(true, 1_500));
}

#[test]
#[ignore = "campaign: cargo test --features trueup-host-tests/emulator --test boot_program campaign_of_a_minute -- --ignored"]
fn campaign_of_a_minute_of_offsets_that_confirms_an_application() {
    let Some(_) = boot() else { return };
    assert!(goes_back(true, 59_000), "less than a minute");
    assert!(goes_back(false, 62_000), "without an engage");
    assert!(!goes_back(true, 62_000), "confirmed");
}
