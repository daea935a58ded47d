//! Which slot starts, and why.

use super::*;
use crate::{
    image_header::FirmwareVersion,
    testing::{
        TEST_JOURNAL_SECTOR_BYTES, TEST_KEY, TEST_SLOT_BYTES, TestKey, flash_by_probe,
        image_signed_by, signed_image,
    },
};
use std::vec::Vec;
use trueup_store::simulated_nor_flash::SimulatedNorFlash;

type Records = SimulatedNorFlash<TEST_JOURNAL_SECTOR_BYTES>;
type Slots = SimulatedNorFlash<TEST_SLOT_BYTES>;

/// A board with what is in its flash.
struct Board {
    records: Records,
    slots: Slots,
}

impl Board {
    /// Both slots hold these files.
    fn with(a: &[u8], b: &[u8]) -> Self {
        let mut slots = Slots::erased();
        flash_by_probe(&mut slots, Slot::A, a);
        flash_by_probe(&mut slots, Slot::B, b);
        Self { records: Records::erased(), slots }
    }

    /// The same with this status of the images.
    fn with_status(files: [&[u8]; 2], statuses: [ImageStatus; 2], floor: u8) -> Self {
        let [a, b] = files;
        let mut board = Self::with(a, b);
        let tag = |file: &[u8]| {
            file.get(508..512).map_or(0, |tag| u32::from_le_bytes(tag.try_into().unwrap()))
        };
        let state =
            BootState { floor: FirmwareVersion::new(0, floor, 0, 0), ..BootState::default() }
                .with_status(Slot::A, tag(a), statuses[0])
                .with_status(Slot::B, tag(b), statuses[1]);
        board.change(|journal| journal.commit(state).unwrap());
        board
    }

    fn change<T>(&mut self, work: impl FnOnce(&mut Journal<Records>) -> T) -> T {
        let mut journal = Journal::open(self.records.clone());
        let result = work(&mut journal);
        self.records = journal.into_flash();
        result
    }

    fn start(&mut self, ending: StartOutcome, clock: ClockSpeed) -> Option<(Slot, StartReason)> {
        let mut slots = self.slots.clone();
        let start = self
            .change(|journal| select_image(journal, &mut slots, &TEST_KEY, ending, clock, || ()))?;
        Some((start.image.header.slot, start.reason))
    }

    fn power_on(&mut self) -> Option<(Slot, StartReason)> {
        self.start(StartOutcome::PowerCycle, ClockSpeed::Full)
    }

    fn reset(&mut self) -> Option<(Slot, StartReason)> {
        self.start(StartOutcome::Reset, ClockSpeed::Full)
    }
}

fn a(version: u8) -> Vec<u8> {
    signed_image(Slot::A, version, 0)
}

fn b(version: u8) -> Vec<u8> {
    signed_image(Slot::B, version, 0)
}

const CONFIRMED: [ImageStatus; 2] = [ImageStatus::Confirmed; 2];

#[test]
fn a_board_that_was_flashed_by_a_probe_starts_and_counts_nothing() {
    let mut board = Board::with(&a(1), &[]);
    let blank = board.records.bytes.clone();
    for _ in 0..10 {
        assert_eq!(board.power_on(), Some((Slot::A, StartReason::OnlyImage)));
        assert_eq!(board.reset(), Some((Slot::A, StartReason::OnlyImage)));
    }
    assert_eq!(board.records.bytes, blank);
    assert_eq!(Board::with(&[], &b(1)).power_on(), Some((Slot::B, StartReason::OnlyImage)));
    assert_eq!(Board::with(&[], &[]).power_on(), None);
}

#[test]
fn the_newest_confirmed_starts_whatever_its_slot() {
    for (in_a, in_b, expected) in [(1, 2, Slot::B), (2, 1, Slot::A), (2, 2, Slot::A)] {
        let mut board = Board::with_status([&a(in_a), &b(in_b)], CONFIRMED, 0);
        for _ in 0..3 {
            assert_eq!(
                board.power_on(),
                Some((expected, StartReason::Newest)),
                "{in_a} and {in_b}"
            );
            assert_eq!(board.reset(), Some((expected, StartReason::Newest)));
        }
    }
    // Of one version the confirmed.
    let mut board =
        Board::with_status([&a(2), &b(2)], [ImageStatus::New, ImageStatus::Confirmed], 0);
    assert_eq!(board.power_on(), Some((Slot::B, StartReason::Newest)));
}

#[test]
fn an_image_on_trial_has_five_power_cycles_and_one_reset() {
    let fresh =
        || Board::with_status([&a(1), &b(2)], [ImageStatus::Confirmed, ImageStatus::Verified], 0);
    let mut board = fresh();
    for number in 1..=MAX_TRIAL_STARTS {
        assert_eq!(board.power_on(), Some((Slot::B, StartReason::Trial(number))));
    }
    for _ in 0..3 {
        assert_eq!(
            board.power_on(),
            Some((Slot::A, StartReason::RolledBack)),
            "not confirmed in time"
        );
    }
    let mut board = fresh();
    assert_eq!(board.reset(), Some((Slot::B, StartReason::Trial(1))), "the update's own reset");
    assert_eq!(board.power_on(), Some((Slot::B, StartReason::Trial(2))));
    for _ in 0..3 {
        assert_eq!(board.reset(), Some((Slot::A, StartReason::RolledBack)));
    }
}

#[test]
fn an_announced_reset_is_no_failure_but_counts_as_a_start() {
    let mut board =
        Board::with_status([&a(1), &b(2)], [ImageStatus::Confirmed, ImageStatus::Verified], 0);
    for number in 1..=MAX_TRIAL_STARTS {
        assert_eq!(board.reset(), Some((Slot::B, StartReason::Trial(number))));
        let mut slots = board.slots.clone();
        let running = read_header(&mut slots, Slot::B, FirmwareVersion::default()).unwrap();
        board.change(|journal| crate::update::announce_reset(journal, &running)).unwrap();
    }
    assert_eq!(board.reset(), Some((Slot::A, StartReason::RolledBack)));
}

#[test]
fn a_damaged_wrongly_signed_swapped_or_cut_image_is_passed_over() {
    let foreign = image_signed_by(TestKey(8), Slot::B, 2, 0);
    let mut damaged = b(2);
    damaged[540] ^= 1;
    let mut header = b(2);
    header[80] ^= 1;
    let mut cut = b(2);
    cut.truncate(560);
    let swapped = a(2);
    for (name, file) in [
        ("foreign", foreign),
        ("damaged", damaged),
        ("its header damaged", header),
        ("cut", cut),
        ("swapped", swapped),
    ] {
        for status in [ImageStatus::New, ImageStatus::Verified, ImageStatus::Confirmed] {
            let mut board = Board::with_status([&a(1), &file], [ImageStatus::Confirmed, status], 0);
            for _ in 0..2 {
                let (slot, _) = board.power_on().unwrap();
                assert_eq!(slot, Slot::A, "{name}, {status:?}");
            }
        }
    }
}

#[test]
fn below_the_floor_nothing_starts() {
    let mut board = Board::with_status([&a(1), &b(2)], CONFIRMED, 2);
    assert_eq!(board.power_on(), Some((Slot::B, StartReason::Newest)));
    // Not even where the newer one is damaged: the floor is there against this very swap.
    let mut damaged = b(2);
    damaged[540] ^= 1;
    let mut board = Board::with_status([&a(1), &damaged], CONFIRMED, 2);
    assert_eq!(board.power_on(), None);
    let mut board = Board::with_status([&a(1), &damaged], CONFIRMED, 1);
    assert_eq!(board.power_on(), Some((Slot::A, StartReason::RolledBack)));
}

#[test]
fn an_image_whose_floor_is_above_itself_never_starts() {
    let inhibited = signed_image(Slot::B, 2, 3);
    let mut board = Board::with_status([&a(1), &inhibited], CONFIRMED, 0);
    assert_eq!(board.power_on().unwrap().0, Slot::A);
}

#[test]
fn with_a_slow_clock_a_recorded_signature_is_enough_and_an_unknown_one_comes_last() {
    let foreign = image_signed_by(TestKey(8), Slot::B, 2, 0);
    let slow = |files: [&[u8]; 2], statuses| {
        Board::with_status(files, statuses, 0).start(StartOutcome::PowerCycle, ClockSpeed::Slow)
    };
    // What was verified when it was written is not verified again; here it is seen by one that does not hold.
    let verified = [ImageStatus::Confirmed, ImageStatus::Verified];
    assert_eq!(slow([&a(1), &foreign], verified), Some((Slot::B, StartReason::Trial(1))));
    let unknown = [ImageStatus::Confirmed, ImageStatus::New];
    assert_eq!(slow([&a(1), &b(2)], unknown), Some((Slot::A, StartReason::RolledBack)));
    // With nothing else it is verified after all.
    let unknown = [ImageStatus::New, ImageStatus::New];
    assert_eq!(slow([&a(1), &foreign], unknown).map(|started| started.0), Some(Slot::A));
    assert_eq!(slow([&[], &foreign], unknown), None);
    // The CRC is checked in any case.
    let mut damaged = b(2);
    damaged[540] ^= 1;
    assert_eq!(slow([&a(1), &damaged], CONFIRMED), Some((Slot::A, StartReason::RolledBack)));
}

#[test]
fn without_another_one_an_incomplete_or_failed_image_that_holds_starts() {
    for status in [ImageStatus::Loading, ImageStatus::Rejected] {
        let mut board = Board::with_status([&[], &b(2)], [ImageStatus::New, status], 0);
        assert_eq!(board.power_on(), Some((Slot::B, StartReason::LastResort)));
        let mut board = Board::with_status([&a(1), &b(2)], [ImageStatus::Confirmed, status], 0);
        assert_eq!(board.power_on(), Some((Slot::A, StartReason::RolledBack)));
        let mut damaged = a(1);
        damaged[540] ^= 1;
        let mut board = Board::with_status([&damaged, &b(2)], [ImageStatus::Confirmed, status], 0);
        assert_eq!(board.power_on(), Some((Slot::B, StartReason::LastResort)));
    }
}

#[test]
fn records_that_take_nothing_keep_no_board_from_starting_but_no_trial_begins() {
    let statuses = [ImageStatus::Confirmed, ImageStatus::Verified];
    let mut board = Board::with_status([&a(1), &b(2)], statuses, 0);
    board.records.dead = true;
    assert_eq!(board.power_on(), Some((Slot::A, StartReason::RolledBack)));
    let mut board = Board::with(&a(1), &[]);
    board.records.dead = true;
    assert_eq!(board.power_on(), Some((Slot::A, StartReason::OnlyImage)));
}

#[test]
fn parts_are_checked_with_a_watchdog_fed_between() {
    let mut board = Board::with_status([&a(1), &b(2)], CONFIRMED, 0);
    let mut slots = board.slots.clone();
    let mut fed = 0;
    board.change(|journal| {
        select_image(
            journal,
            &mut slots,
            &TEST_KEY,
            StartOutcome::PowerCycle,
            ClockSpeed::Full,
            || fed += 1,
        )
    });
    assert_eq!(fed, 2, "one signature, and 64 bytes");
}
