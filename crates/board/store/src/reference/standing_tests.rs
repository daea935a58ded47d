//! In force or offered: calibrations that are loaded, come back, and are dropped, through starts and power cuts.

use super::{tests::*, *};
use crate::write_log::WriteOrigin;

const A: u32 = OURS;
const B: u32 = 0xBBBB_0001;

/// Starts on a calibration, as a board does. Returns what it has found.
fn start(
    log: &ReferenceStore<Flash>,
    calibration: u32,
) -> (ReferenceStore<Flash>, ReferenceStatus) {
    let (mut log, found) = open(&log.log.flash, calibration);
    log.erase_spare_half().unwrap();
    (log, found.standing.map(|standing| standing.1).unwrap_or_default())
}

fn write(log: &mut ReferenceStore<Flash>, what: WriteKind, about: u32, is_unattended: bool) {
    let (calibration, origin) = (log.calibration, WriteOrigin::Can);
    let (sequence, at_ms, utc_s) = (0, 5, 0);
    let write =
        WriteRecord { sequence, calibration, about, at_ms, utc_s, what, origin, is_unattended };
    log.append_write(&write).unwrap();
}

/// Loads another calibration and starts on it.
fn load_and_restart(
    mut log: ReferenceStore<Flash>,
    calibration: u32,
    is_unattended: bool,
) -> (ReferenceStore<Flash>, ReferenceStatus) {
    write(&mut log, WriteKind::Loaded, calibration, is_unattended);
    start(&log, calibration)
}

const fn mark_offered(n: ReferenceStatus) -> ReferenceStatus {
    ReferenceStatus { is_offered: true, ..n }
}

#[test]
fn a_reference_that_was_in_force_stays_so_through_every_start() {
    let mut log = open(&Flash::erased(), A).0;
    log.append(held(1)).unwrap();
    for _ in 0..3 * SLOTS {
        let standing;
        (log, standing) = start(&log, A);
        assert_eq!(standing, held(1));
        write(&mut log, WriteKind::Confirmed, 7, false);
    }
}

#[test]
fn an_old_zero_does_not_come_back_with_its_calibration_it_is_offered() {
    let mut log = open(&Flash::erased(), A).0;
    log.append(held(1)).unwrap();
    let (mut log, standing) = load_and_restart(log, B, false);
    assert_eq!(standing, ReferenceStatus::default());
    log.append(held(2)).unwrap();
    let (log, standing) = load_and_restart(log, A, false);
    assert_eq!(standing, mark_offered(held(1)));
    // And again, until it is answered: also where the log has moved on.
    let (mut log, standing) = start(&log, A);
    assert_eq!(standing, mark_offered(held(1)));
    for number in 0..3 * SLOTS {
        write(&mut log, WriteKind::Confirmed, number, false);
        let standing;
        (log, standing) = start(&log, A);
        assert_eq!(standing, mark_offered(held(1)), "{number}");
    }
    log.append(held(1)).unwrap();
    assert_eq!(start(&log, A).1, held(1));
}

#[test]
fn the_same_calibration_loaded_again_offers_its_own_reference() {
    let mut log = open(&Flash::erased(), A).0;
    log.append(held(1)).unwrap();
    let (mut log, standing) = load_and_restart(log, A, false);
    assert_eq!(standing, mark_offered(held(1)));
    // Declined: nothing is offered the next time.
    log.append(ReferenceStatus::default()).unwrap();
    assert_eq!(load_and_restart(log, A, false).1, ReferenceStatus::default());
}

#[test]
fn a_load_that_was_dropped_changes_nothing() {
    for calibration in [A, B] {
        let mut log = open(&Flash::erased(), A).0;
        log.append(held(1)).unwrap();
        write(&mut log, WriteKind::Loaded, calibration, true);
        write(&mut log, WriteKind::Cancelled, calibration, false);
        assert_eq!(start(&log, A).1, held(1));
    }
    // One that never came to run, because it was damaged.
    let mut log = open(&Flash::erased(), A).0;
    log.append(held(1)).unwrap();
    write(&mut log, WriteKind::Loaded, B, true);
    assert_eq!(start(&log, A).1, held(1));
}

#[test]
fn a_change_that_no_cnc_has_seen_is_asked_for_until_it_is_confirmed() {
    for has_reference in [false, true] {
        let mut log = open(&Flash::erased(), A).0;
        if has_reference {
            log.append(held(1)).unwrap();
        }
        let (mut log, standing) = load_and_restart(log, B, true);
        let requested = ReferenceStatus { is_changed: true, ..ReferenceStatus::default() };
        assert_eq!(standing, requested);
        for number in 0..3 * SLOTS {
            write(&mut log, WriteKind::Confirmed, number, false);
            let standing;
            (log, standing) = start(&log, B);
            assert_eq!(standing, requested, "{number}");
        }
        log.append(ReferenceStatus::default()).unwrap();
        assert_eq!(start(&log, B).1, ReferenceStatus::default());
        // With a CNC there nothing is asked.
        assert!(!load_and_restart(log, A, false).1.is_changed);
    }
}

#[test]
fn a_calibration_that_came_without_a_load_is_a_change_and_the_first_one_is_none() {
    assert_eq!(start(&open(&Flash::erased(), A).0, A).1, ReferenceStatus::default());
    // Another image, or a power cut between the calibration and its record.
    let mut log = open(&Flash::erased(), A).0;
    log.append(held(1)).unwrap();
    let (log, standing) = start(&log, B);
    assert_eq!(standing, ReferenceStatus { is_changed: true, ..ReferenceStatus::default() });
    let (_, standing) = start(&log, A);
    assert_eq!(standing, ReferenceStatus { is_changed: true, ..mark_offered(held(1)) });
}

#[test]
fn a_power_cut_at_any_byte_of_the_first_start_after_a_load_changes_no_answer() {
    for before in 0..2 * SLOTS {
        let mut log = open(&Flash::erased(), A).0;
        log.append(held(1)).unwrap();
        let mut log = load_and_restart(log, B, false).0;
        for number in 0..before {
            if log.append(held(2 + number)).is_err() {
                log = start(&log, B).0;
                log.append(held(2 + number)).unwrap();
            }
        }
        if log.log.has_free_slot() {
            write(&mut log, WriteKind::Loaded, A, true);
        } else {
            log.erase_spare_half().unwrap();
            write(&mut log, WriteKind::Loaded, A, true);
        }
        let expected =
            open(&log.log.flash, A).1.standing.map(|standing| standing.1).expect("a change");
        assert!(expected.is_changed);
        for fuel in (0..=3 * RECORD_SIZE + HALF as usize).step_by(4) {
            let mut cut = open(&log.log.flash, A).0;
            cut.log.flash.fuel = fuel;
            cut.erase_spare_half().ok();
            let found =
                open(&cut.log.flash, A).1.standing.map(|standing| standing.1).unwrap_or_default();
            // What is offered may be lost with a half that was full; it never comes into force.
            let is_retained = found == expected
                || found == ReferenceStatus { is_changed: true, ..ReferenceStatus::default() };
            assert!(is_retained, "{before} before, cut at {fuel}: {found:?}");
        }
    }
}

#[test]
fn the_write_that_has_taken_a_reference_is_reported_and_moves_with_it() {
    let mut log = open(&Flash::erased(), A).0;
    log.append(held(1)).unwrap();
    write(&mut log, WriteKind::Zeroed, 77, false);
    let mut log = load_and_restart(log, B, false).0;
    write(&mut log, WriteKind::Zeroed, 88, false);
    let mut log = load_and_restart(log, A, false).0;
    for number in 0..3 * SLOTS {
        write(&mut log, WriteKind::Confirmed, number, false);
        log = start(&log, A).0;
        let taken = open(&log.log.flash, A).1.taken;
        assert_eq!(
            taken.map(|write| (write.what, write.about)),
            Some((WriteKind::Zeroed, 77)),
            "{number}"
        );
    }
}
