//! Calibrations stored, lost power over, and found again.

use super::*;
use crate::strict_flash::StrictFlash;
use std::{vec, vec::Vec};

/// Two slots, and a rest that is too small for a third.
const SECTOR: usize = 2 * SLOT_SIZE as usize + 1_000;
type Flash = StrictFlash<SECTOR>;
const IMAGE: u32 = 0x0BAD_CAFE;

/// Calibrations that differ.
fn blob(number: u32) -> Vec<u8> {
    calibration::tests::with_sample(|mut calibration| {
        calibration.limits.hold_ms = number;
        calibration::encode(&calibration, &mut [0; MAX_SIZE]).expect("it is small").to_vec()
    })
}

fn open(flash: &Flash, base: u32) -> (Slots<Flash>, Found) {
    Slots::open(flash.powered(), Some(base), &mut vec![0; MAX_SIZE])
}

/// The bytes of the one that counts.
fn newest(flash: &Flash) -> Option<Vec<u8>> {
    let Stored { address, length, .. } = open(flash, IMAGE).1.newest?;
    Some(flash.bytes[address as usize..][..length].to_vec())
}

fn store(flash: Flash, number: u32) -> (Flash, Result<u32, StoreError>) {
    let fuel = flash.fuel;
    let (mut slots, _) = open(&flash, IMAGE);
    slots.log.flash.fuel = fuel;
    let result = slots.store(&blob(number), || ());
    (slots.log.flash, result)
}

#[test]
fn the_newest_counts_through_more_than_the_flash_holds() {
    assert_eq!(128 * 1024 / SLOT_SIZE, 7, "of the chip's sectors");
    let mut flash = Flash::erased();
    assert_eq!(open(&flash, IMAGE).1, Found::default());
    for number in 1..20 {
        let (mut slots, _) = open(&flash, IMAGE);
        slots.make_room().expect("a good flash");
        let mut turns = 0;
        assert_eq!(slots.store(&blob(number), || turns += 1), Ok(number));
        assert_eq!(turns, blob(number).len().div_ceil(PART_SIZE), "the watchdog was told");
        flash = slots.log.flash;
        assert_eq!(newest(&flash), Some(blob(number)), "number {number}");
    }
}

#[test]
fn without_an_erase_it_takes_what_there_is_room_for_and_then_says_full() {
    let (mut slots, _) = open(&Flash::erased(), IMAGE);
    for number in 1..=4 {
        assert_eq!(slots.store(&blob(number), || ()), Ok(number));
    }
    assert_eq!(slots.store(&blob(5), || ()), Err(StoreError::Full));
    assert_eq!(newest(&slots.log.flash), Some(blob(4)));
}

#[test]
fn wherever_the_power_is_cut_the_old_one_or_the_new_one_counts_whole() {
    for before in 0..4 {
        let mut flash = Flash::erased();
        for number in 1..=before {
            flash = store(flash, number).0;
        }
        let old = newest(&flash);
        let all = blob(9).len().next_multiple_of(4) + HEAD as usize;
        for fuel in 0..=all {
            let (cut, result) = store(Flash { fuel, ..flash.clone() }, 9);
            assert_eq!(result.is_ok(), fuel == all, "{before} stored, cut at {fuel} of {all}");
            let expected = if fuel == all { Some(blob(9)) } else { old.clone() };
            assert_eq!(newest(&cut), expected, "{before} stored, cut at {fuel}");
            // Only within the head the end of a load looks like damage.
            let is_told = open(&cut, IMAGE).1.newer_is_damaged;
            assert!(!is_told || (all - HEAD as usize..all).contains(&fuel), "cut at {fuel}");
            // And it goes on from there, with an erase at the start if one is needed.
            let (mut slots, _) = open(&cut, IMAGE);
            slots.make_room().expect("powered");
            assert!(slots.store(&blob(10), || ()).is_ok());
            assert_eq!(newest(&slots.log.flash), Some(blob(10)));
        }
    }
}

#[test]
fn an_erase_that_is_cut_loses_nothing_that_counts() {
    let mut flash = Flash::erased();
    for number in 1..=3 {
        flash = store(flash, number).0;
    }
    for fuel in (0..=SECTOR).step_by(501) {
        let (mut slots, _) = open(&flash, IMAGE);
        slots.log.flash.fuel = fuel;
        assert_eq!(slots.make_room().is_ok(), fuel >= SECTOR);
        assert_eq!(newest(&slots.log.flash), Some(blob(3)), "cut at {fuel}");
    }
}

#[test]
fn one_damaged_byte_anywhere_and_the_one_before_counts() {
    let (flash, _) = store(store(Flash::erased(), 1).0, 2);
    let start = SLOT_SIZE as usize;
    let length = HEAD as usize + blob(2).len();
    for at in start..start + length {
        let mut damaged = flash.clone();
        damaged.bytes[at] ^= 0x10;
        assert_eq!(newest(&damaged), Some(blob(1)), "byte {at}");
        let found = open(&damaged, IMAGE).1;
        assert_eq!(found.damaged + found.foreign, 1);
        assert!(found.newer_is_damaged, "byte {at}: told, for what counts is not what was loaded");
    }
}

#[test]
fn another_image_wins_over_what_was_loaded_before_it() {
    let (flash, _) = store(Flash::erased(), 1);
    let (mut slots, found) = open(&flash, IMAGE + 1);
    assert_eq!(found, Found { newest: None, foreign: 1, damaged: 0, newer_is_damaged: false });
    assert_eq!(slots.store(&blob(2), || ()), Ok(2));
    let found = open(&slots.log.flash, IMAGE + 1).1;
    assert_eq!(found.newest.map(|stored| stored.sequence), Some(2));
    // The first image again, and with it what was loaded over it.
    assert_eq!(newest(&slots.log.flash), Some(blob(1)));
}

#[test]
fn a_dead_flash_takes_nothing_and_says_so() {
    let dead = Flash { dead: true, ..Flash::erased() };
    let (mut slots, _) = open(&dead, IMAGE);
    slots.log.flash.dead = true;
    assert_eq!(slots.store(&blob(1), || ()), Err(StoreError::NotTaken));
    let zeros = Flash { bytes: vec![0; 2 * SECTOR], ..dead };
    let (mut slots, found) = open(&zeros, IMAGE);
    slots.log.flash.dead = true;
    assert_eq!(found.damaged, 4);
    assert_eq!(slots.make_room(), Err(StoreError::NotErased));
    assert_eq!(slots.store(&blob(1), || ()), Err(StoreError::Full));
}

#[test]
fn an_older_one_that_is_damaged_is_no_matter() {
    let flash = store(store(store(Flash::erased(), 1).0, 2).0, 3).0;
    for (slot, is_told) in [(0, false), (1, false), (2, true)] {
        let mut damaged = flash.clone();
        // The third is the first of the other half.
        let start = if slot < 2 { slot * SLOT_SIZE as usize } else { SECTOR };
        for at in [start + 1, start + HEAD as usize + 40] {
            let mut damaged = damaged.clone();
            damaged.bytes[at] ^= 4;
            assert_eq!(open(&damaged, IMAGE).1.newer_is_damaged, is_told, "slot {slot}, byte {at}");
        }
        damaged.bytes[start] ^= 4;
    }
}

#[test]
fn stored_again_the_older_one_is_the_newest_and_nothing_is_told() {
    let (mut flash, _) = store(store(Flash::erased(), 1).0, 2);
    flash.bytes[SLOT_SIZE as usize + 100] ^= 1;
    assert!(open(&flash, IMAGE).1.newer_is_damaged);
    let (flash, result) = store(flash, 1);
    assert!(result.is_ok());
    let found = open(&flash, IMAGE).1;
    assert_eq!((found.newer_is_damaged, newest(&flash)), (false, Some(blob(1))));
}

#[test]
fn an_image_with_the_examples_constants_wins_over_nothing() {
    let (flash, _) = store(Flash::erased(), 1);
    let example = |flash: &Flash| Slots::open(flash.powered(), None, &mut vec![0; MAX_SIZE]);
    let (mut slots, found) = example(&flash);
    assert_eq!((found.newest.map(|it| it.sequence), found.foreign), (Some(1), 0));
    // Loaded over the example: counts for every release of it, and for no machine's own image.
    assert_eq!(slots.store(&blob(2), || ()), Ok(2));
    let flash = slots.log.flash;
    assert_eq!(example(&flash).1.newest.map(|it| it.sequence), Some(2));
    assert_eq!(newest(&flash), Some(blob(1)));
}
