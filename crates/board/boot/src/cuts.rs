//! Power cuts at every word of update, confirmation and going back, and a second one in what follows.
//!
//! The board runs version 1, confirmed, in slot A. Its application loads version 2 into slot B; the boot program
//! starts it on trial; it is confirmed, or it crashes and the board goes back. The power is cut twice, each time at
//! any word that is written or erased, in either flash; bits that were on their way are read differently from then
//! on. Then the board lives on undisturbed.
//!
//! | at every start | because |
//! |---|---|
//! | a slot starts | a board never stays silent |
//! | its bytes are those of a file, and none of them wavers | an image is never believed because it was read once |
//! | what was acknowledged holds: verified, confirmed, rejected, the floor | an answer is a promise |

use std::{println, vec::Vec};

use trueup_store::simulated_nor_flash::SimulatedNorFlash;

use crate::{
    boot_state::ImageStatus,
    flash_layout::Slot,
    image_check::Image,
    image_header::{FirmwareVersion, HEADER_SIZE},
    journal::Journal,
    start::{ClockSpeed, StartOutcome, StartReason, StartSelection, select_image},
    testing::{
        PowerSupply, PoweredFlash, TEST_JOURNAL_SECTOR_BYTES, TEST_KEY, TEST_SLOT_BYTES,
        flash_by_probe, signed_image, with_supply,
    },
    update::{ImageUpdate, confirm},
};

/// Fate of the new image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TrialOutcome {
    /// It is confirmed.
    Confirmed,
    /// It crashes in its first start.
    Crashes,
}

/// Statements and acts of the board that have to hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct ObservedEvents {
    /// The update was acknowledged.
    update: bool,
    /// The confirmation began; it was acknowledged.
    confirming: bool,
    confirmed: bool,
    /// The new image has crashed; the board has gone back.
    crashed: bool,
    rejected: bool,
}

/// The content of both flashes, and what was promised.
#[derive(Clone)]
struct PowerCutBoard {
    records: SimulatedNorFlash<TEST_JOURNAL_SECTOR_BYTES>,
    slots: SimulatedNorFlash<TEST_SLOT_BYTES>,
    promised: ObservedEvents,
    files: [Vec<u8>; 2],
    context: [usize; 3],
}

/// The power was cut.
struct PowerCut;

impl PowerCutBoard {
    /// Version 1 runs in slot A, confirmed; as many other states were stored before.
    fn new(seed: u32, before: u32) -> Self {
        let files = [signed_image(Slot::A, 1, 0), signed_image(Slot::B, 2, 2)];
        let mut slots = SimulatedNorFlash::with_unstable_bits(seed);
        flash_by_probe(&mut slots, Slot::A, &files[0]);
        let mut journal = Journal::open(SimulatedNorFlash::with_unstable_bits(seed ^ 0x5555));
        let running =
            crate::image_check::read_header(&mut slots, Slot::A, FirmwareVersion::default());
        let running = running.expect("it was just written");
        for number in 0..before {
            let state = journal.state().with_status(Slot::B, number, ImageStatus::Rejected);
            journal.commit(state).expect("powered");
        }
        confirm(&mut journal, &running).expect("powered");
        let records = journal.into_flash();
        let context = [seed as usize, 0, 0];
        Self { records, slots, promised: ObservedEvents::default(), files, context }
    }

    /// Runs work with both flashes at a supply.
    fn run_with_supply<T>(
        &mut self,
        supply: &PowerSupply,
        work: impl FnOnce(
            &mut Journal<PoweredFlash<TEST_JOURNAL_SECTOR_BYTES>>,
            &mut PoweredFlash<TEST_SLOT_BYTES>,
        ) -> T,
    ) -> T {
        with_supply(&mut self.records, &mut self.slots, supply, work)
    }

    /// Starts once, and holds what starts against what was promised.
    fn start(
        &mut self,
        supply: &PowerSupply,
        ending: StartOutcome,
    ) -> Result<StartSelection, PowerCut> {
        let (start, state) = self.run_with_supply(supply, |journal, slots| {
            let start = select_image(journal, slots, &TEST_KEY, ending, ClockSpeed::Full, || ());
            (start, journal.state())
        });
        if supply.is_off() {
            return Err(PowerCut);
        }
        let context = self.context;
        let start = start.unwrap_or_else(|| panic!("no slot starts: {context:?}"));
        let slot = start.image.header.slot;
        let file = slot.element_of(&self.files);
        let from = usize::from(slot.number()) * TEST_SLOT_BYTES;
        assert_eq!(self.slots.bytes[from..from + file.len()], *file, "{context:?}");
        let wavers = self.slots.wavering.range(from..from + file.len()).any(|(_, bits)| *bits != 0);
        assert!(!wavers, "it starts an image that wavers: {context:?}");
        let ObservedEvents { update, confirming, confirmed, crashed, rejected } = self.promised;
        assert!(!confirmed || slot == Slot::B, "confirmed, and gone: {context:?}");
        assert!(!rejected || slot == Slot::A, "rejected, and back: {context:?}");
        assert!(!update || crashed || slot == Slot::B, "loaded, and not started: {context:?}");
        let floor = state.floor;
        let risen = floor == FirmwareVersion::new(0, 2, 0, 0);
        assert!(risen || floor == FirmwareVersion::default(), "floor {floor}: {context:?}");
        assert!(confirming || !risen, "the floor rose before a confirmation: {context:?}");
        assert!(!confirmed || risen, "the floor fell: {context:?}");
        let is_confirmed = Slot::B.element_of(&state.slots).status == ImageStatus::Confirmed;
        assert_eq!(risen, is_confirmed, "the floor rises with the confirmation: {context:?}");
        Ok(start)
    }

    /// Loads version 2 into slot B.
    fn load_update(&mut self, supply: &PowerSupply, running: &Image) -> Result<(), PowerCut> {
        let file = self.files[1].clone();
        let header: &[u8; HEADER_SIZE] = file.first_chunk().expect("a header");
        let result = self.run_with_supply(supply, |journal, slots| {
            let mut update = ImageUpdate::begin(journal, slots, running, header)?;
            for piece in file[HEADER_SIZE..].chunks(7) {
                update.append(slots, piece)?;
            }
            update.finish(journal, slots, &TEST_KEY, || ())
        });
        if supply.is_off() {
            return Err(PowerCut);
        }
        result.unwrap_or_else(|error| panic!("{error}: {:?}", self.context));
        self.promised.update = true;
        Ok(())
    }

    fn confirm(&mut self, supply: &PowerSupply, running: &Image) -> Result<(), PowerCut> {
        self.promised.confirming = true;
        let result = self.run_with_supply(supply, |journal, _| confirm(journal, running));
        if supply.is_off() {
            return Err(PowerCut);
        }
        result.unwrap_or_else(|error| panic!("{error}: {:?}", self.context));
        self.promised.confirmed = true;
        Ok(())
    }

    /// Lives with the power on until the story is over, or the supply is cut.
    fn run_scenario(&mut self, supply: &PowerSupply, story: TrialOutcome) -> Result<(), PowerCut> {
        let mut ending = StartOutcome::PowerCycle;
        for _ in 0..4 {
            let StartSelection { image, reason, .. } = self.start(supply, ending)?;
            ending = StartOutcome::Reset;
            match (image.header.slot, story) {
                (Slot::A, TrialOutcome::Crashes) if reason == StartReason::RolledBack => {
                    self.promised.rejected = true;
                    return Ok(());
                }
                (Slot::A, _) => self.load_update(supply, &image)?,
                (Slot::B, TrialOutcome::Confirmed) if self.promised.confirmed => return Ok(()),
                (Slot::B, TrialOutcome::Confirmed) => self.confirm(supply, &image)?,
                (Slot::B, TrialOutcome::Crashes) => self.promised.crashed = true,
            }
        }
        panic!("the story has no end: {:?}", self.context)
    }

    /// Checks that each promise of the board holds after three more power cycles.
    fn verify_after_power_cycles(&mut self) {
        for _ in 0..3 {
            let supply = PowerSupply::with_byte_budget(usize::MAX);
            for random in [&self.records.random, &self.slots.random] {
                random.set(random.get().wrapping_mul(0x9E37_79B9) | 1);
            }
            assert!(self.start(&supply, StartOutcome::PowerCycle).is_ok(), "the supply lasts");
        }
    }
}

/// Returns how many bytes a story burns from here.
fn count_written_bytes(board: &PowerCutBoard, story: TrialOutcome) -> usize {
    const UNLIMITED_BYTES: usize = usize::MAX / 2;
    let supply = PowerSupply::with_byte_budget(UNLIMITED_BYTES);
    assert!(board.clone().run_scenario(&supply, story).is_ok(), "the supply lasts");
    UNLIMITED_BYTES - supply.remaining_bytes()
}

/// Cuts at every word, and again at each `step`-th word of what follows; gives the number of pairs.
fn cut_power_twice(story: TrialOutcome, seed: u32, before: u32, step: usize) -> usize {
    let start = PowerCutBoard::new(seed, before);
    let all = count_written_bytes(&start, story);
    let mut pairs = 0;
    for first in (0..=all).step_by(4) {
        let mut once = start.clone();
        once.context = [seed as usize, first, usize::MAX];
        let is_over = once.run_scenario(&PowerSupply::with_byte_budget(first), story).is_ok();
        assert_eq!(is_over, first == all, "{first} of {all}");
        // The first of the second cuts moves on, so that over all of the first every word has its turn.
        let follows = count_written_bytes(&once, story);
        for second in (first % (4 * step)..=follows).step_by(4 * step) {
            let mut twice = once.clone();
            twice.context[2] = second;
            // Whether it was over is no matter: what was promised is.
            twice.run_scenario(&PowerSupply::with_byte_budget(second), story).ok();
            assert!(
                twice.run_scenario(&PowerSupply::with_byte_budget(usize::MAX), story).is_ok(),
                "the supply lasts"
            );
            twice.verify_after_power_cycles();
            pairs += 1;
        }
    }
    println!("{story:?}: {pairs} pairs, {} words in the first life", all / 4);
    pairs
}

/// The same with up to three other states stored before, so that sectors of the journal fill up at other words.
fn cut_power_twice_with_prior_states(story: TrialOutcome, step: usize) -> usize {
    let seed = |before: u32| 2 * before + u32::from(story == TrialOutcome::Crashes);
    (0..4).map(|before| cut_power_twice(story, seed(before) + 1, before, step)).sum()
}

#[test]
fn two_power_cuts_in_an_update_that_is_confirmed_leave_a_board_that_starts() {
    let pairs = cut_power_twice_with_prior_states(TrialOutcome::Confirmed, 11);
    assert!(pairs >= 50_000, "{pairs}");
}

#[test]
fn two_power_cuts_in_an_update_that_crashes_leave_a_board_that_starts() {
    let pairs = cut_power_twice_with_prior_states(TrialOutcome::Crashes, 11);
    assert!(pairs >= 50_000, "{pairs}");
}

#[test]
#[ignore = "long: every pair of words, eighty seconds"]
fn two_power_cuts_at_every_pair_of_words_leave_a_board_that_starts() {
    let pairs = [TrialOutcome::Confirmed, TrialOutcome::Crashes]
        .map(|story| cut_power_twice_with_prior_states(story, 1));
    println!("{} pairs", pairs[0] + pairs[1]);
    assert!(pairs[0] + pairs[1] >= 1_000_000, "{pairs:?}");
}
