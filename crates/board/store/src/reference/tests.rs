//! References stored, lost power over, and found again.

use super::*;
use crate::simulated_nor_flash::SimulatedNorFlash;

pub(super) const SLOTS: u32 = 8;
pub(super) const HALF: u32 = SLOTS * SLOT_SIZE;
const SIZE: usize = 2 * HALF as usize;
pub(super) type Flash = SimulatedNorFlash<{ HALF as usize }>;
pub(super) const OURS: u32 = 0xC0FF_EE01;
const OTHER: u32 = 0x0BAD_CAFE;

/// References that differ in every byte.
pub(super) fn reference(n: u32) -> ReferenceErrors {
    let value = |k: u32| (n * 0x0101_0101).wrapping_mul(2 * k + 1) as i32;
    ReferenceErrors {
        elongation: Nanometres(value(1)),
        axes: [FineNanometres(value(2)), FineNanometres(value(3)), FineNanometres(value(4))],
    }
}

/// Returns the same, in force.
pub(super) fn held(n: u32) -> ReferenceStatus {
    ReferenceStatus { reference: reference(n), ..ReferenceStatus::default() }
}

pub(super) fn open(flash: &Flash, calibration: u32) -> (ReferenceStore<Flash>, ScanResult) {
    ReferenceStore::open(flash.with_power_restored(), calibration)
}

fn loaded(flash: &Flash) -> Option<ReferenceErrors> {
    open(flash, OURS).1.standing.map(|(_, standing)| standing.reference)
}

#[test]
fn the_bytes_of_a_record_are_as_the_table_says() {
    let record = ReferenceRecord {
        sequence: 2,
        calibration: 0x1122_3344,
        standing: ReferenceStatus {
            reference: ReferenceErrors {
                elongation: Nanometres(62_805),
                axes: [FineNanometres(-1), FineNanometres(0), FineNanometres(256)],
            },
            is_offered: false,
            is_changed: true,
        },
        supply: InternalReferenceLevel(0x5DE0),
    };
    let bytes = record.encode();
    assert_eq!(
        bytes[..28],
        [
            2, 0, 0, 0, 0x44, 0x33, 0x22, 0x11, 0x55, 0xF5, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF, 0, 0, 0,
            0, 0, 1, 0, 0, 1, 2, 0xE0, 0x5D
        ]
    );
    assert_eq!(ReferenceRecord::decode(&bytes), Some(record));
    assert_eq!(
        (ReferenceRecord::decode(&[0xFF; RECORD_SIZE]), ReferenceRecord::decode(&[0; RECORD_SIZE])),
        (None, None)
    );
}

#[test]
fn the_level_of_the_supply_goes_with_the_reference_through_every_move() {
    let (mut log, found) = open(&Flash::erased(), OURS);
    assert_eq!(found.supply, InternalReferenceLevel(0));
    log.set_supply_baseline_level(InternalReferenceLevel(24_001));
    // More than the flash holds: records move, and after a start what was found goes on.
    for n in 1..=4 * SLOTS {
        log.append(held(n)).unwrap();
        log.erase_spare_half().unwrap();
        let (reopened, found) = open(&log.log.flash, OURS);
        assert_eq!(found.supply, InternalReferenceLevel(24_001), "{n}");
        log = reopened;
    }
}

#[test]
fn the_newest_counts_through_more_records_than_the_flash_holds() {
    let (mut log, found) = open(&Flash::erased(), OURS);
    assert_eq!(found, ScanResult::default());
    let mut erases = 0;
    for n in 1..=100 {
        assert_eq!(log.append(held(n)), Ok(n));
        assert_eq!(loaded(&log.log.flash), Some(reference(n)));
        erases += u32::from(log.erase_spare_half() == Ok(true));
        assert_eq!(loaded(&log.log.flash), Some(reference(n)));
    }
    std::println!("100 records in a flash of {} slots: {erases} erases", 2 * SLOTS);
    assert!((100 / SLOTS - 1..=100 / SLOTS + 1).contains(&erases));
}

#[test]
fn without_room_a_reference_is_refused_and_the_next_start_makes_room() {
    let (mut log, _) = open(&Flash::erased(), OURS);
    for n in 1..=2 * SLOTS {
        assert_eq!(log.append(held(n)), Ok(n));
    }
    assert_eq!(log.append(held(99)), Err(StoreError::Full));
    let (mut log, found) = open(&log.log.flash, OURS);
    assert_eq!(found.standing, Some((2 * SLOTS, held(2 * SLOTS))));
    assert_eq!((log.erase_spare_half(), log.erase_spare_half()), (Ok(true), Ok(false)));
    assert_eq!(log.append(held(99)), Ok(2 * SLOTS + 1));
    assert_eq!(loaded(&log.log.flash), Some(reference(99)));
}

#[test]
fn a_reference_of_a_calibration_that_is_back_is_offered_and_not_lost() {
    let (mut log, _) = open(&Flash::erased(), OURS);
    log.append(held(1)).unwrap();
    // Others fill both halves, and room is made again and again.
    let (mut others, found) = open(&log.log.flash, OTHER);
    // It came with no load that a record tells of.
    let standing = Some((0, ReferenceStatus { is_changed: true, ..ReferenceStatus::default() }));
    assert_eq!(found, ScanResult { standing, is_new: true, foreign: 1, ..ScanResult::default() });
    for n in 2..SLOTS {
        others.append(held(n)).unwrap();
    }
    let offered = ReferenceStatus { is_offered: true, is_changed: true, ..held(1) };
    let (mut log, found) = open(&others.log.flash, OURS);
    assert_eq!((found.standing, found.foreign), (Some((1, offered)), SLOTS - 2));
    // Ours moves on when its half goes, as it stands.
    let (mut others, _) = open(&log.log.flash, OTHER);
    for n in 0..3 {
        others.append(held(n)).unwrap();
    }
    log = open(&others.log.flash, OURS).0;
    assert_eq!(log.erase_spare_half(), Ok(true));
    let found = open(&log.log.flash, OURS).1;
    assert_eq!((found.standing.map(|standing| standing.1), found.is_new), (Some(offered), false));
}

#[test]
fn a_power_cut_at_any_byte_of_a_record_loses_that_record_at_most() {
    for before in 0..2 * SLOTS {
        let (mut log, _) = open(&Flash::erased(), OURS);
        (1..=before).for_each(|n| assert_eq!(log.append(held(n)), Ok(n)));
        let old = (before > 0).then(|| reference(before));
        for fuel in 0..=RECORD_SIZE {
            let mut cut = open(&log.log.flash, OURS).0;
            cut.log.flash.fuel = fuel;
            let stored = cut.append(held(77)).is_ok();
            assert_eq!(stored, fuel == RECORD_SIZE);
            let expected = if stored { Some(reference(77)) } else { old };
            assert_eq!(loaded(&cut.log.flash), expected, "{before} records, cut at byte {fuel}");
            // Life goes on after it.
            let (mut log, found) = open(&cut.log.flash, OURS);
            assert!(found.damaged <= 1);
            log.erase_spare_half().unwrap();
            log.append(held(88)).unwrap();
            assert_eq!(loaded(&log.log.flash), Some(reference(88)));
        }
    }
}

#[test]
fn a_first_record_that_is_cut_needs_no_erase_at_the_next_start() {
    for fuel in 1..RECORD_SIZE {
        let mut cut = open(&Flash::erased(), OURS).0;
        cut.log.flash.fuel = fuel;
        assert!(cut.append(held(1)).is_err());
        let mut log = open(&cut.log.flash, OURS).0;
        assert_eq!(log.erase_spare_half(), Ok(false), "cut at byte {fuel}");
        log.append(held(2)).unwrap();
        assert_eq!(loaded(&log.log.flash), Some(reference(2)));
    }
}

#[test]
fn a_power_cut_at_any_byte_of_making_room_loses_nothing() {
    // Ours is in the old half, alone or not: it has to move before the erase.
    for others in 0..SLOTS {
        let (mut log, _) = open(&Flash::erased(), OURS);
        (1..=SLOTS).for_each(|n| assert_eq!(log.append(held(n)), Ok(n)));
        let (mut log, _) = open(&log.log.flash, if others == 0 { OURS } else { OTHER });
        for _ in 0..others.max(1) {
            log.append(held(9)).unwrap();
        }
        let expected = loaded(&log.log.flash);
        assert!(expected.is_some());
        for fuel in 0..=RECORD_SIZE + HALF as usize {
            let mut cut = open(&log.log.flash, OURS).0;
            cut.log.flash.fuel = fuel;
            let done = cut.erase_spare_half() == Ok(true);
            assert_eq!(loaded(&cut.log.flash), expected, "{others} others, cut at byte {fuel}");
            let mut log = open(&cut.log.flash, OURS).0;
            assert_eq!(log.erase_spare_half(), Ok(!done));
            log.append(held(88)).unwrap();
            assert_eq!(loaded(&log.log.flash), Some(reference(88)));
        }
    }
}

#[test]
fn every_flipped_bit_of_a_record_is_found() {
    let (mut log, _) = open(&Flash::erased(), OURS);
    (1..=2).for_each(|n| assert_eq!(log.append(held(n)), Ok(n)));
    for bit in 0..RECORD_SIZE * 8 {
        let mut flash = log.log.flash.clone();
        flash.bytes[RECORD_SIZE + bit / 8] ^= 1 << (bit % 8);
        let (_, found) = open(&flash, OURS);
        let expected =
            ScanResult { standing: Some((1, held(1))), damaged: 1, ..ScanResult::default() };
        assert_eq!(found, expected, "bit {bit}");
    }
}

#[test]
fn a_dead_flash_is_reported_and_nothing_else_happens() {
    // Nothing is taken; or all reads as 0, as where no flash answers.
    for fill in [0xFF, 0] {
        let flash = Flash { dead: true, ..Flash::from_bytes(std::vec![fill; SIZE]) };
        let (mut log, found) = open(&flash, OURS);
        let is_blank = fill == 0xFF;
        assert_eq!(found.standing, None);
        assert_eq!(found.damaged, if is_blank { 0 } else { 2 * SLOTS });
        let room = if is_blank { Ok(false) } else { Err(StoreError::NotErased) };
        assert_eq!(log.erase_spare_half(), room);
        let refused = if is_blank { StoreError::WriteFailed } else { StoreError::Full };
        assert_eq!(log.append(held(1)), Err(refused));
    }
}

#[test]
fn any_bytes_at_all_can_be_opened_and_written_on() {
    let mut random = 1_u32;
    for _ in 0..200 {
        let mut flash = Flash::erased();
        for byte in &mut flash.bytes {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *byte = (random >> 24) as u8 | if random & 0x300 == 0 { 0 } else { 0xFF };
        }
        let (mut log, found) = open(&flash, OURS);
        assert_eq!((found.standing, found.foreign), (None, 0));
        log.erase_spare_half().unwrap();
        let stored = log.append(held(5)).or_else(|_| {
            // Both halves were full of nothing: the next start makes the other room.
            log = open(&log.log.flash, OURS).0;
            log.erase_spare_half().and_then(|_| log.append(held(5)))
        });
        assert_eq!((stored.is_ok(), loaded(&log.log.flash)), (true, Some(reference(5))));
    }
}

/// Returns a start, then a `Zero`, as a board does it: room is made, a reference is appended.
fn live(flash: &Flash, fuel: usize, n: u32) -> (Flash, bool) {
    let mut log = open(flash, OURS).0;
    log.log.flash.fuel = fuel;
    let is_stored = log.erase_spare_half().is_ok() && log.append(held(n)).is_ok();
    (log.log.flash, is_stored)
}

#[test]
fn two_power_cuts_in_a_row_at_any_words_with_bits_that_waver_leave_an_old_or_a_new_one() {
    // Up to two halves full, so that what is torn is the first of its half at times.
    for before in 1..=2 * SLOTS {
        let mut flash = Flash::with_unstable_bits(before);
        for n in 1..=before {
            flash = live(&flash, usize::MAX, n).0;
        }
        let old = loaded(&flash).expect("it was stored");
        let burnt = |flash: &Flash| {
            let mut log = open(flash, OURS).0;
            log.log.flash.fuel = usize::MAX / 2;
            assert!(log.erase_spare_half().is_ok() && log.append(held(88)).is_ok());
            usize::MAX / 2 - log.log.flash.fuel
        };
        for first in (0..=burnt(&flash)).step_by(4) {
            let (once, was_stored) = live(&flash, first, 77);
            for second in (0..=burnt(&once)).step_by(4) {
                let (twice, is_stored) = live(&once, second, 88);
                for _ in 0..3 {
                    let found = loaded(&twice);
                    let place = std::format!("{before} stored, cut at {first} and {second}");
                    let expected =
                        [(old, !was_stored), (reference(77), true), (reference(88), true)];
                    let is_one = expected.iter().any(|(one, may)| *may && found == Some(*one));
                    assert!(is_one, "{found:?}: {place}");
                    assert!(!is_stored || found == Some(reference(88)), "{found:?}: {place}");
                }
            }
        }
    }
}

#[test]
fn what_a_start_has_found_alone_in_its_half_is_there_twice_before_the_other_half_goes() {
    // Its words may have been cut, and be read as none the next time.
    let mut log = open(&Flash::erased(), OURS).0;
    (1..=SLOTS + 1).for_each(|n| assert_eq!(log.append(held(n)), Ok(n)));
    log = open(&log.log.flash, OURS).0;
    assert_eq!(log.erase_spare_half(), Ok(true));
    let mut lost = log.log.flash.clone();
    lost.bytes[HALF as usize] = 0;
    assert_eq!(loaded(&lost), Some(reference(SLOTS + 1)));
    // Where there are two of them, or nothing goes with the other half, it is not written again.
    for (ours_before, ours) in [(1, 2), (0, 1)] {
        let mut log = open(&Flash::erased(), OTHER).0;
        (ours_before..SLOTS).for_each(|n| assert!(log.append(held(n)).is_ok()));
        log = open(&log.log.flash, OURS).0;
        (0..ours_before + ours).for_each(|n| assert!(log.append(held(n)).is_ok()));
        log = open(&log.log.flash, OURS).0;
        assert_eq!(log.erase_spare_half(), Ok(true));
        let used = log.log.flash.bytes.iter().filter(|byte| **byte != 0xFF).count();
        assert!(used <= ours as usize * RECORD_SIZE, "{used} bytes");
    }
}
