//! Calibrations stored, lost power over, and found again.

use super::*;
use crate::simulated_nor_flash::SimulatedNorFlash;
use std::{vec, vec::Vec};
use trueup_core::calibration::Calibration;

/// Two slots, and a rest that is too small for a third.
const SECTOR: usize = 2 * SLOT_SIZE as usize + 1_000;
type Flash = SimulatedNorFlash<SECTOR>;
const IMAGE: u32 = 0x0BAD_CAFE;

/// Calibrations that differ.
fn blob(number: u32) -> Vec<u8> {
    calibration::tests::with_sample(|mut calibration| {
        calibration.limits.hold_ms = number;
        calibration::encode(&calibration, &mut [0; MAX_BLOB_SIZE]).expect("it is small").to_vec()
    })
}

fn open(flash: &Flash, base: u32) -> (CalibrationStore<Flash>, CalibrationScan) {
    CalibrationStore::open(flash.with_power_restored(), Some(base), &mut vec![0; MAX_BLOB_SIZE])
}

/// Returns the bytes of the one that counts.
fn newest(flash: &Flash) -> Option<Vec<u8>> {
    let StoredCalibration { address, length, .. } = open(flash, IMAGE).1.newest?;
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
    assert_eq!(open(&flash, IMAGE).1, CalibrationScan::default());
    let mut last = 0;
    for number in 1..20 {
        let (mut slots, _) = open(&flash, IMAGE);
        slots.erase_spare_half(|| ()).expect("a good flash");
        let mut turns = 0;
        let sequence = slots.store(&blob(number), || turns += 1).expect("room was made");
        // Once in a half what would be left alone is copied, which takes a number too.
        assert!((last + 1..=last + 2).contains(&sequence), "{sequence} after {last}");
        last = sequence;
        assert_eq!(turns, blob(number).len().div_ceil(CHUNK_SIZE), "the watchdog was fed");
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
        let all = blob(9).len().next_multiple_of(4) + HEADER_SIZE as usize;
        for fuel in 0..=all {
            let (cut, result) = store(Flash { fuel, ..flash.clone() }, 9);
            assert_eq!(result.is_ok(), fuel == all, "{before} stored, cut at {fuel} of {all}");
            let expected = if fuel == all { Some(blob(9)) } else { old.clone() };
            assert_eq!(newest(&cut), expected, "{before} stored, cut at {fuel}");
            // Only within the CRC of its head the end of a load looks like damage.
            let is_reported = open(&cut, IMAGE).1.newer_is_damaged;
            assert!(!is_reported || (all - 4..all).contains(&fuel), "cut at {fuel}");
            // And it goes on from there, with an erase at the start if one is needed.
            let (mut slots, _) = open(&cut, IMAGE);
            slots.erase_spare_half(|| ()).expect("powered");
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
        assert_eq!(slots.erase_spare_half(|| ()).is_ok(), fuel >= SECTOR);
        assert_eq!(newest(&slots.log.flash), Some(blob(3)), "cut at {fuel}");
    }
}

#[test]
fn one_damaged_byte_anywhere_and_the_one_before_counts() {
    let (flash, _) = store(store(Flash::erased(), 1).0, 2);
    let start = SLOT_SIZE as usize;
    let length = HEADER_SIZE as usize + blob(2).len();
    for at in start..start + length {
        let mut damaged = flash.clone();
        damaged.bytes[at] ^= 0x10;
        assert_eq!(newest(&damaged), Some(blob(1)), "byte {at}");
        let found = open(&damaged, IMAGE).1;
        assert_eq!(found.damaged + found.foreign, 1);
        assert!(
            found.newer_is_damaged,
            "byte {at}: reported, for what counts is not what was loaded"
        );
    }
}

#[test]
fn another_image_wins_over_what_was_loaded_before_it() {
    let (flash, _) = store(Flash::erased(), 1);
    let (mut slots, found) = open(&flash, IMAGE + 1);
    assert_eq!(
        found,
        CalibrationScan { newest: None, foreign: 1, damaged: 0, newer_is_damaged: false }
    );
    assert_eq!(slots.store(&blob(2), || ()), Ok(2));
    let found = open(&slots.log.flash, IMAGE + 1).1;
    assert_eq!(found.newest.map(|stored| stored.sequence), Some(2));
    // The first image again, and with it what was loaded over it.
    assert_eq!(newest(&slots.log.flash), Some(blob(1)));
}

#[test]
fn a_dead_flash_takes_nothing_and_reports_it() {
    let dead = Flash { dead: true, ..Flash::erased() };
    let (mut slots, _) = open(&dead, IMAGE);
    slots.log.flash.dead = true;
    assert_eq!(slots.store(&blob(1), || ()), Err(StoreError::WriteFailed));
    let zeros = Flash { dead: true, ..Flash::from_bytes(vec![0; 2 * SECTOR]) };
    let (mut slots, found) = open(&zeros, IMAGE);
    slots.log.flash.dead = true;
    assert_eq!(found.damaged, 4);
    assert_eq!(slots.erase_spare_half(|| ()), Err(StoreError::NotErased));
    assert_eq!(slots.store(&blob(1), || ()), Err(StoreError::Full));
}

#[test]
fn an_older_one_that_is_damaged_is_no_matter() {
    let flash = store(store(store(Flash::erased(), 1).0, 2).0, 3).0;
    for (slot, is_reported) in [(0, false), (1, false), (2, true)] {
        let mut damaged = flash.clone();
        // The third is the first of the other half.
        let start = if slot < 2 { slot * SLOT_SIZE as usize } else { SECTOR };
        for at in [start + 1, start + HEADER_SIZE as usize + 40] {
            let mut damaged = damaged.clone();
            damaged.bytes[at] ^= 4;
            assert_eq!(
                open(&damaged, IMAGE).1.newer_is_damaged,
                is_reported,
                "slot {slot}, byte {at}"
            );
        }
        damaged.bytes[start] ^= 4;
    }
}

#[test]
fn stored_again_the_older_one_is_the_newest_and_nothing_is_reported() {
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
    let example = |flash: &Flash| {
        CalibrationStore::open(flash.with_power_restored(), None, &mut vec![0; MAX_BLOB_SIZE])
    };
    let (mut slots, found) = example(&flash);
    assert_eq!((found.newest.map(|newest| newest.sequence), found.foreign), (Some(1), 0));
    // Loaded over the example: counts for every release of it, and for no machine's own image.
    assert_eq!(slots.store(&blob(2), || ()), Ok(2));
    let flash = slots.log.flash;
    assert_eq!(example(&flash).1.newest.map(|newest| newest.sequence), Some(2));
    assert_eq!(newest(&flash), Some(blob(1)));
}

/// Returns a calibration of this many words at least, that no other number has.
fn blob_of(words: usize, number: u32) -> Vec<u8> {
    calibration::tests::with_smallest(|calibration| {
        let points: Vec<[u8; 4]> = (0..words as u32).map(|n| (n ^ number).to_le_bytes()).collect();
        let mut calibration: Calibration<'_> = calibration;
        calibration.limits.hold_ms = number;
        calibration.axes[0].pitch = (words > 0).then(|| calibration::tests::pitch_of(&points));
        calibration::encode(&calibration, &mut [0; MAX_BLOB_SIZE]).expect("it fits").to_vec()
    })
}

/// Returns a start, then a load, as a board does it.
fn live(flash: &Flash, fuel: usize, blob: &[u8]) -> (Flash, bool) {
    let (mut slots, _) = open(flash, IMAGE);
    slots.log.flash.fuel = fuel;
    let is_stored = slots.erase_spare_half(|| ()).is_ok() && slots.store(blob, || ()).is_ok();
    (slots.log.flash, is_stored)
}

/// Returns what a life burns: up to the end of making room, and in all.
fn burnt(flash: &Flash, blob: &[u8]) -> [usize; 2] {
    const FUEL: usize = usize::MAX / 2;
    let (mut slots, _) = open(flash, IMAGE);
    slots.log.flash.fuel = FUEL;
    slots.erase_spare_half(|| ()).expect("powered");
    let room = FUEL - slots.log.flash.fuel;
    slots.store(blob, || ()).expect("room was made");
    [room, FUEL - slots.log.flash.fuel]
}

/// Two lives end at these places; whichever way the wavering bits are read, what counts is the old one or
/// a new one, and the last if it was reported as stored.
fn judge(flash: &Flash, old: Option<&[u8]>, blobs: [&[u8]; 2], cuts: [usize; 2]) {
    let (once, was_stored) = live(flash, cuts[0], blobs[0]);
    let (twice, is_stored) = live(&once, cuts[1], blobs[1]);
    for _ in 0..2 {
        let found = newest(&twice);
        let found = found.as_deref();
        let is_one =
            found == Some(blobs[1]) || found == Some(blobs[0]) || (found == old && !was_stored);
        assert!(is_one, "neither, cut at {cuts:?}");
        assert!(!is_stored || found == Some(blobs[1]), "stored, cut at {cuts:?}");
    }
}

/// This many stored before, and then wavering.
fn filled(before: u32, words: usize, seed: u32) -> (Flash, Option<Vec<u8>>) {
    let mut flash = Flash::with_unstable_bits(seed);
    for number in 1..=before {
        flash = live(&flash, usize::MAX, &blob_of(words, number)).0;
    }
    let old = newest(&flash);
    (flash, old)
}

#[test]
#[ignore = "long: all pairs of words, twenty seconds"]
fn two_power_cuts_in_a_row_at_any_two_words_leave_the_old_or_a_new_one() {
    // The smallest blob there is. With two stored the next is the first of its half.
    let blobs = [blob_of(0, 77), blob_of(0, 88)];
    let blobs = blobs.each_ref().map(Vec::as_slice);
    let mut pairs = 0;
    for before in [1, 2] {
        let (flash, old) = filled(before, 0, before);
        let [_, all] = burnt(&flash, blobs[0]);
        for first in (0..=all).step_by(4) {
            let [room, all] = burnt(&live(&flash, first, blobs[0]).0, blobs[1]);
            // Within an erase every byte is like the one before it.
            let erase = room.saturating_sub(SECTOR)..room;
            let is_like =
                |at: usize| erase.contains(&at) && !(at - erase.start).is_multiple_of(2_004);
            for second in (0..=all).step_by(4).filter(|at| !is_like(*at)) {
                judge(&flash, old.as_deref(), blobs, [first, second]);
                pairs += 1;
            }
        }
    }
    std::println!("{pairs} pairs of {} words", blobs[0].len() / 4);
}

/// Cuts drawn on the largest blob.
fn drawn_pairs(pairs: u32) {
    let words = (MAX_BLOB_SIZE - blob_of(0, 1).len()) / 4;
    let blobs = [blob_of(words, 77), blob_of(words, 88)];
    let blobs = blobs.each_ref().map(Vec::as_slice);
    assert!(blobs[0].len() > MAX_BLOB_SIZE - 4, "{} bytes", blobs[0].len());
    let mut random = 1_u32;
    let mut draw = |end: usize| {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((u64::from(random) * end as u64) >> 32) as usize
    };
    let states: Vec<_> = (0..=4).map(|before| filled(before, words, before + 1)).collect();
    for _ in 0..pairs {
        let (flash, old) = &states[draw(states.len())];
        // Half of the cuts lie where it matters: in the last words of what is written.
        let near_end = |all: usize, draw: &mut dyn FnMut(usize) -> usize| {
            if draw(2) == 0 { all.saturating_sub(draw(64)) } else { draw(all + 1) }
        };
        let [_, all] = burnt(flash, blobs[0]);
        let first = near_end(all, &mut draw);
        let [_, all] = burnt(&live(flash, first, blobs[0]).0, blobs[1]);
        judge(flash, old.as_deref(), blobs, [first, near_end(all, &mut draw)]);
    }
}

#[test]
fn two_power_cuts_drawn_on_the_largest_leave_the_old_or_a_new_one() {
    drawn_pairs(300);
}

#[test]
#[ignore = "long: a hundred thousand pairs of cuts"]
fn two_power_cuts_drawn_a_hundred_thousand_times_leave_the_old_or_a_new_one() {
    drawn_pairs(100_000);
}

#[test]
fn a_slot_that_was_refused_and_is_read_later_does_not_win() {
    let (mut slots, _) = open(&Flash::erased(), IMAGE);
    let mut refused = 0;
    let is_refused = |_: &mut Flash, _, sequence| {
        refused = sequence;
        false
    };
    assert_eq!(slots.log.append(1, is_refused), Err(StoreError::WriteFailed));
    let (next, _) = slots.log.append(1, |_, _, _| true).expect("there is room");
    assert!(next > refused, "{next} after {refused}");
}

#[test]
fn what_a_start_has_found_alone_in_its_half_is_there_twice_before_the_other_half_goes() {
    let flash = store(store(store(Flash::erased(), 1).0, 2).0, 3).0;
    let (mut slots, found) = open(&flash, IMAGE);
    assert_eq!(
        found.newest.map(|newest| (newest.sequence, newest.address)),
        Some((3, SECTOR as u32 + HEADER_SIZE))
    );
    assert_eq!(slots.erase_spare_half(|| ()), Ok(true));
    // Its head may have been cut, and be read as none the next time; the copy is newer.
    let mut flash = slots.log.flash;
    assert_eq!(open(&flash, IMAGE).1.newest.map(|newest| newest.sequence), Some(4));
    flash.bytes[SECTOR] ^= 1;
    assert_eq!(newest(&flash), Some(blob(3)));
}

#[test]
fn loads_over_another_image_never_take_the_room_of_the_one_that_counts() {
    let mut flash = store(Flash::erased(), 1).0;
    let (mut others, _) = open(&flash, IMAGE + 1);
    for number in 2..4 {
        others.store(&blob(number), || ()).expect("there is room");
    }
    flash = others.log.flash;
    let (mut slots, _) = open(&flash, IMAGE);
    slots.erase_spare_half(|| ()).expect("powered");
    assert_eq!(newest(&slots.log.flash), Some(blob(1)));
}

#[test]
fn a_sound_blob_behind_the_head_of_another_is_damage() {
    let mut flash = store(Flash::erased(), 1).0;
    let other = blob(2);
    flash.bytes[HEADER_SIZE as usize..][..other.len()].copy_from_slice(&other);
    let found = open(&flash, IMAGE).1;
    assert_eq!((found.newest, found.damaged), (None, 1));
}
