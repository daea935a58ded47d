//! The application itself, which hangs in its own start: at a step of it a branch to itself is written into its image,
//! before it is signed. The application of the other slot comes back in time.

use std::{fs, path::Path, thread};

use object::{Object as _, ObjectSymbol as _};
use trueup_boot::{flash_layout::Slot, image_header::HEADER_SIZE};
use trueup_emulator::slot_images;

use crate::{
    application::{application, linked},
    board::{ANSWER_MS, Board, boot, version},
};

/// Limits of the watchdog's oscillator (data sheet, LSI oscillator characteristics), in Hz.
const LSI: [&str; 2] = ["17000", "47000"];
/// Steps of the start: a part of the name of a function that it calls, from the first to the last.
const STEPS: [&str; 4] = [
    "__rtic_init_resources",
    "crystal16wait_for_capture",
    "sampling7Sampler3arm",
    "OwnSlot6locate",
];
/// A read of the store: neither of its two parts has been opened yet. Its name is that of a trait.
const STORE: [&str; 3] = ["flash..Flash", "ReadNorFlash", "4read"];
/// `b .` (Armv7-M manual, A7.7.12).
const TO_ITSELF: [u8; 2] = [0xFE, 0xE7];

/// Returns the address of the function whose name has these parts.
fn address_of(image: &Path, parts: &[&str]) -> u32 {
    let bytes = fs::read(image).expect("it was just built");
    let file = object::File::parse(&*bytes).expect("an image");
    let has = |name: &str| parts.iter().all(|part| name.contains(part));
    let found = file.symbols().find(|symbol| symbol.name().is_ok_and(has));
    let found = found.unwrap_or_else(|| panic!("the image has no function {parts:?}"));
    u32::try_from(found.address()).expect("32 bits") & !1
}

/// Returns the file of an application that hangs at the beginning of that function.
fn hanging(slot: Slot, minor: u8, parts: &[&str]) -> Vec<u8> {
    let image = linked(slot);
    let mut body = slot_images::read_image_body(&image, slot).expect("a body");
    let at = (address_of(&image, parts) - slot.start()) as usize - HEADER_SIZE;
    body[at..at + TO_ITSELF.len()].copy_from_slice(&TO_ITSELF);
    let key = slot_images::load_development_key().expect("the developers' key");
    slot_images::build_signed_update(&body, slot, version(minor), version(0), &key)
}

#[test]
#[ignore = "long: ten boards of two seconds on the model of the chip"]
fn an_application_that_hangs_in_its_own_start_gives_way_within_two_seconds() {
    let Some(_) = boot() else { return };
    let old = application(Slot::A, 1);
    let steps = STEPS.iter().map(std::slice::from_ref).chain([&STORE[..]]);
    thread::scope(|scope| {
        for parts in steps {
            let new = hanging(Slot::B, 2, parts);
            for lsi in LSI {
                let board = Board::with(&old, &new).expect("it is there");
                scope.spawn(move || {
                    let report = board.report(2_100, "", &["--lsi", lsi]);
                    assert!(report.clean, "{parts:?}: a violation:\n{}", report.stdout);
                    let at = |what: &str| -> Vec<f64> {
                        let is_it = |event: &&String| event.contains(what);
                        let time = |event: &String| event.split(' ').next()?.parse().ok();
                        report.events.iter().filter(is_it).filter_map(time).collect()
                    };
                    let resets = at(" reset ");
                    let offset = at(" can 281 ").first().copied();
                    println!(
                        "{parts:?}, LSI {lsi} Hz: reset at {resets:.0?}, offset at {offset:.0?} ms"
                    );
                    assert_eq!(resets.len(), 1, "{parts:?}, LSI {lsi} Hz: {}", report.stdout);
                    let offset = offset.unwrap_or(f64::INFINITY);
                    assert!(offset > resets[0], "{parts:?}: the new one does not speak");
                    assert!(offset <= ANSWER_MS, "{parts:?}, LSI {lsi} Hz: {offset} ms");
                });
            }
        }
    });
}
