//! Writes next to references: listed again after a power cut, and the names outlast every erase.

use super::{tests::*, *};
use crate::write_log::WriteOrigin;
use std::vec::Vec;

fn write(what: WriteKind, about: u32) -> WriteRecord {
    WriteRecord {
        sequence: 0,
        calibration: OURS,
        about,
        at_ms: 5,
        utc_s: 0,
        what,
        origin: WriteOrigin::Can,
        is_unattended: false,
    }
}

fn logged_writes(log: &ReferenceStore<Flash>) -> Vec<(u32, WriteKind, u32)> {
    let all = log.last_writes().as_bytes().as_chunks().0.iter().filter_map(WriteRecord::from_bytes);
    all.map(|write| (write.sequence, write.what, write.about)).collect()
}

#[test]
fn writes_are_reported_after_a_power_cut_in_their_order_and_references_stay() {
    let (mut log, _) = open(&Flash::erased(), OURS);
    assert_eq!(log.append_write(&write(WriteKind::Loaded, 1)).map(|record| record.sequence), Ok(1));
    log.append(held(1)).unwrap();
    log.append_write(&write(WriteKind::Zeroed, 2)).unwrap();
    log.append_write(&write(WriteKind::Confirmed, 3)).unwrap();
    let (log, found) = open(&log.log.flash, OURS);
    assert_eq!((found.standing, found.damaged), (Some((2, held(1))), 0));
    let expected =
        [(1, WriteKind::Loaded, 1), (3, WriteKind::Zeroed, 2), (4, WriteKind::Confirmed, 3)];
    assert_eq!(logged_writes(&log), expected);
}

#[test]
fn a_power_cut_at_any_byte_of_a_write_loses_that_write_at_most() {
    let (mut log, _) = open(&Flash::erased(), OURS);
    log.append(held(1)).unwrap();
    log.append_write(&write(WriteKind::Named, 77)).unwrap();
    for fuel in 0..=RECORD_SIZE {
        let mut cut = open(&log.log.flash, OURS).0;
        cut.log.flash.fuel = fuel;
        let stored = cut.append_write(&write(WriteKind::Named, 88)).is_ok();
        assert_eq!(stored, fuel == RECORD_SIZE);
        let (_, found) = open(&cut.log.flash, OURS);
        assert_eq!(found.standing, Some((1, held(1))));
        assert_eq!(found.named, Some(if stored { 88 } else { 77 }), "cut at byte {fuel}");
    }
}

#[test]
fn names_and_reference_outlast_erases_with_power_cuts_at_any_byte() {
    let (mut log, _) = open(&Flash::erased(), OURS);
    log.append_write(&write(WriteKind::Named, 77)).unwrap();
    log.append(held(1)).unwrap();
    for number in 0..8 * SLOTS {
        log.append_write(&write(WriteKind::Confirmed, number)).unwrap();
        let before = open(&log.log.flash, OURS).1;
        for fuel in 0..=2 * RECORD_SIZE + HALF as usize {
            let mut cut = open(&log.log.flash, OURS).0;
            cut.log.flash.fuel = fuel;
            cut.erase_spare_half().ok();
            let found = open(&cut.log.flash, OURS).1;
            assert_eq!(found.named, Some(77), "{number}, cut at byte {fuel}");
            let is_same = found.standing.map(|standing| standing.1)
                == before.standing.map(|standing| standing.1);
            assert!(is_same && found.standing.is_some(), "{number}, cut at byte {fuel}");
        }
        log = open(&log.log.flash, OURS).0;
        log.erase_spare_half().unwrap();
    }
}

#[test]
fn writes_are_reported_the_oldest_first_whichever_half_holds_them() {
    let mut log = open(&Flash::erased(), OURS).0;
    for number in 1..=5 * SLOTS {
        let entry = write(WriteKind::Confirmed, number);
        if log.append_write(&entry) == Err(StoreError::Full) {
            log.erase_spare_half().unwrap();
            log.append_write(&entry).unwrap();
        }
        log = open(&log.log.flash, OURS).0;
        // Once the first half was emptied, the newest lie before what the second still holds.
        let numbers: Vec<_> = logged_writes(&log).iter().map(|(_, _, about)| *about).collect();
        let first = number + 1 - numbers.len() as u32;
        assert_eq!(numbers, (first..=number).collect::<Vec<_>>());
        assert!(numbers.len() as u32 >= number.min(SLOTS));
    }
}

#[test]
fn a_name_that_a_start_has_found_alone_in_its_half_is_there_twice_before_the_other_half_goes() {
    let mut log = open(&Flash::erased(), OURS).0;
    log.append_write(&write(WriteKind::Named, 77)).unwrap();
    for number in 1..SLOTS {
        log.append_write(&write(WriteKind::Confirmed, number)).unwrap();
    }
    log.append_write(&write(WriteKind::Named, 88)).unwrap();
    log = open(&log.log.flash, OURS).0;
    assert_eq!(log.erase_spare_half(), Ok(true));
    let mut lost = log.log.flash.clone();
    lost.bytes[HALF as usize] = 0;
    assert_eq!(open(&lost, OURS).1.named, Some(88));
}

#[test]
fn a_name_outlasts_the_erase_of_its_half_without_a_start_between() {
    let mut log = open(&Flash::erased(), OURS).0;
    log.append_write(&write(WriteKind::Named, 77)).unwrap();
    for number in 0..5 * SLOTS {
        log.append_write(&write(WriteKind::Confirmed, number)).unwrap();
        log.erase_spare_half().unwrap();
        assert_eq!(open(&log.log.flash, OURS).1.named, Some(77), "after {number}");
    }
}
