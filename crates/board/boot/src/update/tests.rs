//! Updates that are refused, and one that comes in any pieces.

use super::*;
use crate::{
    boot_state::BootState,
    testing::{
        TEST_JOURNAL_SECTOR_BYTES, TEST_KEY, TEST_SLOT_BYTES, TestKey, flash_by_probe,
        image_signed_by, signed_image,
    },
};
use std::vec::Vec;
use trueup_store::simulated_nor_flash::SimulatedNorFlash;

type Parts = (
    Journal<SimulatedNorFlash<TEST_JOURNAL_SECTOR_BYTES>>,
    SimulatedNorFlash<TEST_SLOT_BYTES>,
    Image,
);

/// Version 2 runs in slot A, confirmed; the floor is 1.
fn running() -> Parts {
    let mut slots = SimulatedNorFlash::erased();
    flash_by_probe(&mut slots, Slot::A, &signed_image(Slot::A, 2, 1));
    let mut journal = Journal::open(SimulatedNorFlash::erased());
    let running = read_header(&mut slots, Slot::A, FirmwareVersion::default()).unwrap();
    confirm(&mut journal, &running).unwrap();
    assert_eq!(journal.state().floor, FirmwareVersion::new(0, 1, 0, 0));
    (journal, slots, running)
}

fn header(file: &[u8]) -> [u8; HEADER_SIZE] {
    *file.first_chunk().unwrap()
}

#[test]
fn a_file_comes_in_pieces_of_any_size_and_is_verified() {
    for piece in [1, 3, 7, 64, 255, 256, 600] {
        let (mut journal, mut slots, running) = running();
        let file = signed_image(Slot::B, 3, 2);
        let mut update =
            ImageUpdate::begin(&mut journal, &mut slots, &running, &header(&file)).unwrap();
        let tag = update.image().tag;
        assert_eq!(journal.state().status(Slot::B, tag), ImageStatus::Loading);
        for bytes in file[HEADER_SIZE..].chunks(piece) {
            let early = update.finish(&mut journal, &mut slots, &TEST_KEY, || ());
            assert_eq!(early, Err(UpdateError::Length));
            update.append(&mut slots, bytes).unwrap();
        }
        assert_eq!(update.received as usize, file.len());
        assert_eq!(update.append(&mut slots, &[0]), Err(UpdateError::Length));
        update.finish(&mut journal, &mut slots, &TEST_KEY, || ()).unwrap();
        assert_eq!(
            slots.bytes[TEST_SLOT_BYTES..TEST_SLOT_BYTES + file.len()],
            file,
            "pieces of {piece}"
        );
        assert_eq!(journal.state().status(Slot::B, tag), ImageStatus::Verified);
        assert_eq!(
            journal.state().floor,
            FirmwareVersion::new(0, 1, 0, 0),
            "it rises when it is confirmed"
        );
    }
}

#[test]
fn what_must_not_run_here_is_refused_before_anything_is_erased() {
    let mut no_header = signed_image(Slot::B, 3, 0);
    no_header[100] ^= 1;
    let defect = UpdateError::Defect;
    let version = |number| FirmwareVersion::new(0, number, 0, 0);
    for (file, error) in [
        (signed_image(Slot::A, 3, 0), defect(ImageDefect::OtherSlot)),
        (signed_image(Slot::B, 0, 0), defect(ImageDefect::BelowFloor { floor: version(1) })),
        (signed_image(Slot::B, 3, 4), defect(ImageDefect::OwnFloor)),
        (signed_image(Slot::B, 2, 0), UpdateError::NotNewer { running: version(2) }),
        (no_header, defect(ImageDefect::Header(crate::image_header::HeaderError::NoHeader))),
    ] {
        let (mut journal, mut slots, running) = running();
        let state = journal.state();
        let result = ImageUpdate::begin(&mut journal, &mut slots, &running, &header(&file));
        assert_eq!(result.map(|_| ()), Err(error));
        assert_eq!(journal.state(), state);
    }
}

#[test]
fn a_foreign_or_damaged_file_is_never_verified() {
    let mut damaged = signed_image(Slot::B, 3, 0);
    damaged[550] ^= 1;
    for (file, defect) in [
        (image_signed_by(TestKey(8), Slot::B, 3, 0), ImageDefect::Signature),
        (damaged, ImageDefect::Crc),
    ] {
        let (mut journal, mut slots, running) = running();
        let mut update =
            ImageUpdate::begin(&mut journal, &mut slots, &running, &header(&file)).unwrap();
        update.append(&mut slots, &file[HEADER_SIZE..]).unwrap();
        let result = update.finish(&mut journal, &mut slots, &TEST_KEY, || ());
        assert_eq!(result, Err(UpdateError::Defect(defect)));
        let status = journal.state().status(Slot::B, update.image().tag);
        assert_eq!(status, ImageStatus::Loading, "it does not start");
    }
}

#[test]
fn on_trial_the_image_to_go_back_to_is_not_overwritten() {
    let (mut journal, mut slots, old) = running();
    let file = signed_image(Slot::B, 3, 0);
    flash_by_probe(&mut slots, Slot::B, &file);
    let trial = read_header(&mut slots, Slot::B, FirmwareVersion::default()).unwrap();
    let state: BootState = journal.state().with_status(Slot::B, trial.tag, ImageStatus::Trial(1));
    journal.commit(state).unwrap();
    let next = header(&signed_image(Slot::A, 4, 0));
    let result = ImageUpdate::begin(&mut journal, &mut slots, &trial, &next);
    assert_eq!(result.map(|_| ()), Err(UpdateError::Unconfirmed));
    confirm(&mut journal, &trial).unwrap();
    assert!(ImageUpdate::begin(&mut journal, &mut slots, &trial, &next).is_ok());
    assert_eq!(journal.state().status(Slot::A, old.tag), ImageStatus::Loading);
}

#[test]
fn a_flash_that_does_not_take_a_word_is_reported() {
    let (mut journal, mut slots, running) = running();
    let file = signed_image(Slot::B, 3, 0);
    let mut update =
        ImageUpdate::begin(&mut journal, &mut slots, &running, &header(&file)).unwrap();
    slots.dead = true;
    let rest: Vec<u8> = file[HEADER_SIZE..].to_vec();
    assert_eq!(update.append(&mut slots, &rest), Err(UpdateError::Flash));
}

#[test]
fn the_slot_is_known_by_where_the_image_runs() {
    assert_eq!(slot_at(Slot::A.start() + 0x200), Slot::A);
    assert_eq!(slot_at(Slot::B.start() - 4), Slot::A);
    assert_eq!(slot_at(Slot::B.start()), Slot::B);
}

#[test]
fn behind_a_step_that_makes_room_a_confirmation_erases_nothing() {
    // However full the records are when an image that is not confirmed is given another one.
    for changes in 0..40_u8 {
        let mut slots = SimulatedNorFlash::<TEST_SLOT_BYTES>::erased();
        flash_by_probe(&mut slots, Slot::A, &signed_image(Slot::A, 2, 1));
        let running = read_header(&mut slots, Slot::A, FirmwareVersion::default()).unwrap();
        let mut journal = Journal::open(SimulatedNorFlash::<TEST_JOURNAL_SECTOR_BYTES>::erased());
        for number in 0..changes {
            let state = journal.state().with_status(Slot::B, number.into(), ImageStatus::Loading);
            journal.commit(state).unwrap();
        }
        // As the boot program does at each start.
        journal.settle().unwrap();
        let file = signed_image(Slot::B, 3, 2);
        let mut update =
            ImageUpdate::begin(&mut journal, &mut slots, &running, &header(&file)).unwrap();
        journal.settle().unwrap();
        update.append(&mut slots, &file[HEADER_SIZE..]).unwrap();
        update.finish(&mut journal, &mut slots, &TEST_KEY, || ()).unwrap();
        journal.settle().unwrap();
        let flash = journal.into_flash();
        let before = flash.bytes.clone();
        let mut journal = Journal::open(flash);
        confirm(&mut journal, &running).unwrap();
        let after = journal.into_flash().bytes;
        assert!(before.iter().zip(&after).all(|(old, new)| new & !old == 0), "{changes} changes");
    }
}
