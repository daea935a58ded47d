//! A change of the key with a dead PLL, where a recorded signature and the CRC are enough: what starts is signed by the
//! board's key, whatever was loaded, and wherever the power was cut.
//!
//! The boot program and the image in slot A are new, flashed by a probe into an erased chip, as `docs/book/src/update.md`
//! says; then an update comes that is signed with the new key, or still with the old one.

use super::*;
use crate::{
    image_check::ImageDefect,
    image_header::{FirmwareVersion, HEADER_SIZE},
    testing::{
        PowerSupply, PoweredFlash, TEST_JOURNAL_SECTOR_BYTES, TEST_KEY, TEST_SLOT_BYTES, TestKey,
        flash_by_probe, image_signed_by, with_supply,
    },
    update::{ImageUpdate, UpdateError},
};
use std::{println, vec::Vec};
use trueup_store::simulated_nor_flash::SimulatedNorFlash;

const OLD_KEY: TestKey = TEST_KEY;
const NEW_KEY: TestKey = TestKey(8);
/// Far more bytes than an update takes.
const UNLIMITED_BYTES: usize = usize::MAX / 2;

#[derive(Clone)]
struct KeyChangeBoard {
    records: SimulatedNorFlash<TEST_JOURNAL_SECTOR_BYTES>,
    slots: SimulatedNorFlash<TEST_SLOT_BYTES>,
}

impl KeyChangeBoard {
    /// An erased chip with the files of a probe; its boot program has the new key.
    fn with_images(a: &[u8], b: &[u8], seed: u32) -> Self {
        let (records, mut slots) = (
            SimulatedNorFlash::with_unstable_bits(seed),
            SimulatedNorFlash::with_unstable_bits(!seed),
        );
        flash_by_probe(&mut slots, Slot::A, a);
        flash_by_probe(&mut slots, Slot::B, b);
        Self { records, slots }
    }

    fn with_supply<T>(
        &mut self,
        supply: &PowerSupply,
        work: impl FnOnce(
            &mut Journal<PoweredFlash<TEST_JOURNAL_SECTOR_BYTES>>,
            &mut PoweredFlash<TEST_SLOT_BYTES>,
        ) -> T,
    ) -> T {
        with_supply(&mut self.records, &mut self.slots, supply, work)
    }

    /// Returns what starts with a dead PLL.
    fn start(&mut self) -> Option<(Slot, StartReason)> {
        self.start_with_clock(ClockSpeed::Slow)
    }

    fn start_with_clock(&mut self, clock: ClockSpeed) -> Option<(Slot, StartReason)> {
        self.with_supply(&PowerSupply::with_byte_budget(UNLIMITED_BYTES), |journal, slots| {
            select_image(journal, slots, &NEW_KEY, StartOutcome::PowerCycle, clock, || ())
        })
        .map(|start| (start.image.header.slot, start.reason))
    }

    /// Loads a file into slot B, from the image in slot A.
    fn load_update(&mut self, supply: &PowerSupply, file: &[u8]) -> Result<(), UpdateError> {
        self.with_supply(supply, |journal, slots| {
            let running = read_header(slots, Slot::A, FirmwareVersion::default()).expect("it runs");
            let header = file.first_chunk::<HEADER_SIZE>().expect("a header");
            let mut update = ImageUpdate::begin(journal, slots, &running, header)?;
            for piece in file[HEADER_SIZE..].chunks(7) {
                update.append(slots, piece)?;
            }
            update.finish(journal, slots, &NEW_KEY, || ())
        })
    }

    /// Checks that this slot holds the whole file, and that its bytes are read the same each time.
    fn holds_image(&self, slot: Slot, file: &[u8]) -> bool {
        let from = usize::from(slot.number()) * TEST_SLOT_BYTES;
        let range = from..from + file.len();
        let wavers = self.slots.wavering.range(range.clone()).any(|(_, bits)| *bits != 0);
        !wavers && self.slots.bytes[range] == *file
    }
}

fn new_key_image_a() -> Vec<u8> {
    image_signed_by(NEW_KEY, Slot::A, 1, 0)
}

#[test]
fn with_a_dead_pll_the_image_of_the_new_key_starts_and_one_of_the_old_key_does_not() {
    for b in [Vec::new(), image_signed_by(OLD_KEY, Slot::B, 2, 0)] {
        let mut board = KeyChangeBoard::with_images(&new_key_image_a(), &b, 1);
        for _ in 0..2 {
            assert_eq!(board.start().map(|started| started.0), Some(Slot::A));
        }
    }
    // The image was not signed anew: nothing may start.
    let mut board = KeyChangeBoard::with_images(&image_signed_by(OLD_KEY, Slot::A, 1, 0), &[], 1);
    assert_eq!(board.start(), None);
}

#[test]
fn with_a_dead_pll_an_update_of_the_new_key_starts_on_trial_and_one_of_the_old_key_is_refused() {
    let mut board = KeyChangeBoard::with_images(&new_key_image_a(), &[], 1);
    assert_eq!(
        board.load_update(
            &PowerSupply::with_byte_budget(UNLIMITED_BYTES),
            &image_signed_by(NEW_KEY, Slot::B, 2, 0)
        ),
        Ok(())
    );
    assert_eq!(board.start(), Some((Slot::B, StartReason::Trial(1))));
    let mut board = KeyChangeBoard::with_images(&new_key_image_a(), &[], 1);
    let refused = board.load_update(
        &PowerSupply::with_byte_budget(UNLIMITED_BYTES),
        &image_signed_by(OLD_KEY, Slot::B, 2, 0),
    );
    assert_eq!(refused, Err(UpdateError::Defect(ImageDefect::Signature)));
    for _ in 0..3 {
        assert_eq!(board.start().map(|started| started.0), Some(Slot::A));
    }
}

#[test]
fn a_cut_at_any_word_of_an_update_after_a_key_change_leaves_a_signed_image_that_starts() {
    let mut cuts = 0;
    for (key, seed) in [(NEW_KEY, 1), (OLD_KEY, 2), (NEW_KEY, 3), (OLD_KEY, 4)] {
        let (old, new) = (new_key_image_a(), image_signed_by(key, Slot::B, 2, 0));
        let whole = PowerSupply::with_byte_budget(UNLIMITED_BYTES);
        KeyChangeBoard::with_images(&old, &[], seed).load_update(&whole, &new).ok();
        let words = (UNLIMITED_BYTES - whole.remaining_bytes()) / 4;
        let mut started = [0_u32; 2];
        for word in 0..=words {
            let mut board = KeyChangeBoard::with_images(&old, &[], seed);
            board.load_update(&PowerSupply::with_byte_budget(4 * word), &new).ok();
            cuts += 1;
            for turn in 0..3_u32 {
                let (slot, _) = board.start().unwrap_or_else(|| panic!("silent: word {word}"));
                started[usize::from(slot.number())] += 1;
                let file = if slot == Slot::A { &old } else { &new };
                assert!(board.holds_image(slot, file), "word {word}, start {turn}: not whole");
                assert!(slot == Slot::A || key == NEW_KEY, "word {word}: the old key's");
                for random in [&board.records.random, &board.slots.random] {
                    random.set(random.get().wrapping_mul(0x9E37_79B9) | 1);
                }
            }
        }
        println!("{words} words, starts of A and B: {started:?}");
        assert!(started[0] > 0 && (key == OLD_KEY || started[1] > 0), "{started:?}");
    }
    println!("{cuts} cuts");
}

/// An image that was verified with the old key is recorded as verified: so the whole chip is erased when the key is changed.
#[test]
fn an_image_of_the_old_key_that_stays_starts_with_a_dead_pll_unless_the_records_are_erased() {
    let stays = image_signed_by(OLD_KEY, Slot::B, 2, 0);
    let tag = u32::from_le_bytes(*stays[..HEADER_SIZE].last_chunk().expect("a tag"));
    let mut board = KeyChangeBoard::with_images(&new_key_image_a(), &stays, 1);
    board.with_supply(&PowerSupply::with_byte_budget(UNLIMITED_BYTES), |journal, _| {
        let verified = journal.state().with_status(Slot::B, tag, ImageStatus::Verified);
        journal.commit(verified).expect("powered");
    });
    assert_eq!(
        board.clone().start_with_clock(ClockSpeed::Full).map(|started| started.0),
        Some(Slot::A)
    );
    assert_eq!(board.clone().start().map(|started| started.0), Some(Slot::B), "the record counts");
    board.records = SimulatedNorFlash::erased();
    assert_eq!(board.start().map(|start| start.0), Some(Slot::A));
}
