//! Updates that are refused, and one that comes in any pieces.

use super::*;
use crate::{
    record::State,
    testing::{KEY, RECORDS, SLOT, TestKey, flash_by_probe, image, signed_by},
};
use std::vec::Vec;
use trueup_store::strict_flash::StrictFlash;

type Parts = (Journal<StrictFlash<RECORDS>>, StrictFlash<SLOT>, Image);

/// Version 2 runs in slot A, confirmed; the floor is 1.
fn running() -> Parts {
    let mut slots = StrictFlash::erased();
    flash_by_probe(&mut slots, Slot::A, &image(Slot::A, 2, 1));
    let mut journal = Journal::open(StrictFlash::erased());
    let running = read_header(&mut slots, Slot::A, Version::default()).unwrap();
    confirm(&mut journal, &running).unwrap();
    assert_eq!(journal.state().floor, Version::new(0, 1, 0, 0));
    (journal, slots, running)
}

fn header(file: &[u8]) -> [u8; HEADER_SIZE] {
    *file.first_chunk().unwrap()
}

#[test]
fn a_file_comes_in_pieces_of_any_size_and_is_verified() {
    for piece in [1, 3, 7, 64, 255, 256, 600] {
        let (mut journal, mut slots, running) = running();
        let file = image(Slot::B, 3, 2);
        let mut update = Update::begin(&mut journal, &mut slots, &running, &header(&file)).unwrap();
        let tag = update.image().tag;
        assert_eq!(journal.state().status(Slot::B, tag), Status::Loading);
        for bytes in file[HEADER_SIZE..].chunks(piece) {
            let early = update.finish(&mut journal, &mut slots, &KEY, || ());
            assert_eq!(early, Err(UpdateError::Length));
            update.append(&mut slots, bytes).unwrap();
        }
        assert_eq!(update.received() as usize, file.len());
        assert_eq!(update.append(&mut slots, &[0]), Err(UpdateError::Length));
        update.finish(&mut journal, &mut slots, &KEY, || ()).unwrap();
        assert_eq!(slots.bytes[SLOT..SLOT + file.len()], file, "pieces of {piece}");
        assert_eq!(journal.state().status(Slot::B, tag), Status::Verified);
        assert_eq!(
            journal.state().floor,
            Version::new(0, 1, 0, 0),
            "it rises when it is confirmed"
        );
    }
}

#[test]
fn what_must_not_run_here_is_refused_before_anything_is_erased() {
    let mut no_header = image(Slot::B, 3, 0);
    no_header[100] ^= 1;
    let defect = UpdateError::Defect;
    let version = |number| Version::new(0, number, 0, 0);
    for (file, error) in [
        (image(Slot::A, 3, 0), defect(Defect::OtherSlot)),
        (image(Slot::B, 0, 0), defect(Defect::BelowFloor { floor: version(1) })),
        (image(Slot::B, 3, 4), defect(Defect::OwnFloor)),
        (image(Slot::B, 2, 0), UpdateError::NotNewer { running: version(2) }),
        (no_header, defect(Defect::Header(crate::header::HeaderError::NoHeader))),
    ] {
        let (mut journal, mut slots, running) = running();
        let state = journal.state();
        let result = Update::begin(&mut journal, &mut slots, &running, &header(&file));
        assert_eq!(result.map(|_| ()), Err(error));
        assert_eq!(journal.state(), state);
    }
}

#[test]
fn a_foreign_or_damaged_file_is_never_verified() {
    let mut damaged = image(Slot::B, 3, 0);
    damaged[550] ^= 1;
    for (file, defect) in
        [(signed_by(TestKey(8), Slot::B, 3, 0), Defect::Signature), (damaged, Defect::Crc)]
    {
        let (mut journal, mut slots, running) = running();
        let mut update = Update::begin(&mut journal, &mut slots, &running, &header(&file)).unwrap();
        update.append(&mut slots, &file[HEADER_SIZE..]).unwrap();
        let result = update.finish(&mut journal, &mut slots, &KEY, || ());
        assert_eq!(result, Err(UpdateError::Defect(defect)));
        let status = journal.state().status(Slot::B, update.image().tag);
        assert_eq!(status, Status::Loading, "it does not start");
    }
}

#[test]
fn on_trial_the_image_to_go_back_to_is_not_overwritten() {
    let (mut journal, mut slots, old) = running();
    let file = image(Slot::B, 3, 0);
    flash_by_probe(&mut slots, Slot::B, &file);
    let trial = read_header(&mut slots, Slot::B, Version::default()).unwrap();
    let state: State = journal.state().with(Slot::B, trial.tag, Status::Trial(1));
    journal.commit(state).unwrap();
    let next = header(&image(Slot::A, 4, 0));
    let result = Update::begin(&mut journal, &mut slots, &trial, &next);
    assert_eq!(result.map(|_| ()), Err(UpdateError::Unconfirmed));
    confirm(&mut journal, &trial).unwrap();
    assert!(Update::begin(&mut journal, &mut slots, &trial, &next).is_ok());
    assert_eq!(journal.state().status(Slot::A, old.tag), Status::Loading);
}

#[test]
fn a_flash_that_does_not_take_a_word_is_reported() {
    let (mut journal, mut slots, running) = running();
    let file = image(Slot::B, 3, 0);
    let mut update = Update::begin(&mut journal, &mut slots, &running, &header(&file)).unwrap();
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
        let mut slots = StrictFlash::<SLOT>::erased();
        flash_by_probe(&mut slots, Slot::A, &image(Slot::A, 2, 1));
        let running = read_header(&mut slots, Slot::A, Version::default()).unwrap();
        let mut journal = Journal::open(StrictFlash::<RECORDS>::erased());
        for number in 0..changes {
            let state = journal.state().with(Slot::B, number.into(), Status::Loading);
            journal.commit(state).unwrap();
        }
        // As the boot program does at each start.
        journal.settle().unwrap();
        let file = image(Slot::B, 3, 2);
        let mut update = Update::begin(&mut journal, &mut slots, &running, &header(&file)).unwrap();
        journal.settle().unwrap();
        update.append(&mut slots, &file[HEADER_SIZE..]).unwrap();
        update.finish(&mut journal, &mut slots, &KEY, || ()).unwrap();
        journal.settle().unwrap();
        let flash = journal.into_flash();
        let before = flash.bytes.clone();
        let mut journal = Journal::open(flash);
        confirm(&mut journal, &running).unwrap();
        let after = journal.into_flash().bytes;
        assert!(before.iter().zip(&after).all(|(old, new)| new & !old == 0), "{changes} changes");
    }
}
