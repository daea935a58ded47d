//! The state of the slots in flash: an append-only journal in two sectors.
//!
//! A change appends the whole state, twice, to the active sector; the last valid entry counts. When the sector
//! is full the other one is erased and the next generation begins there.
//!
//! # Power cuts
//! A word that the power was cut in may be read differently at each start, as written now and as erased later.
//! A state that is acted upon because it was read once, and is gone at the next start, would be worse than one
//! that was lost at once: the floor may have risen meanwhile. So:
//!
//! | rule | because |
//! |---|---|
//! | each entry begins with a word of zeros, written first | an entry that looks blank is blank, or holds a part of that word only: written again, it is whole |
//! | an entry is never written a second time behind that word | its ones could be read as zeros |
//! | a sector is erased right before its first entry is written, even if it looks blank | an erase that was cut looks like anything |
//! | a state counts as *settled* if the last two entries are whole and the same | the second was begun after the first was complete |
//! | [`Journal::settle`] appends the believed state again unless it is settled, before anything is done because of it | a torn entry behind it, or itself, is then superseded for good |
//! | [`Journal::commit`] is done when both entries were read back | what is acknowledged has two copies: one damaged later is no loss |

use core::{error::Error, fmt};

use embedded_storage::nor_flash::NorFlash;

use crate::boot_state::{BootState, JOURNAL_ENTRY_SIZE};

/// Bytes of an entry.
const JOURNAL_ENTRY_BYTES: u32 = 32;
const _: () = assert!(JOURNAL_ENTRY_BYTES as usize == JOURNAL_ENTRY_SIZE);
/// Bytes of the first word of an entry.
const CLAIM_WORD_BYTES: usize = 4;
/// Entries of a state.
const COPIES_PER_STATE: u32 = 2;
/// Entries that a start leaves free, so that an application never has to erase: it confirms, and announces a reset.
const RESERVED_ENTRIES: u32 = 2 * COPIES_PER_STATE;
/// Entries that are tried for one copy, before the flash counts as worn.
const MAX_WRITE_ATTEMPTS: u32 = 3;

/// The flash does not take a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JournalWriteError;

impl fmt::Display for JournalWriteError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the flash does not take the state of the firmware slots")
    }
}

impl Error for JournalWriteError {}

/// Content of a sector.
#[derive(Clone, Copy, Debug, Default)]
struct SectorContent {
    /// Entries up to the last one that is not blank.
    used: u32,
    /// The last valid entry: its generation and state.
    last: Option<(u32, BootState)>,
    /// The last two of the used entries are whole and the same.
    is_settled: bool,
}

/// The journal, open.
#[derive(Debug)]
pub struct Journal<F> {
    /// Two sectors.
    flash: F,
    state: BootState,
    generation: u32,
    /// The active sector, 0 or 1.
    active: u32,
    /// The next entry in it.
    next: u32,
    is_settled: bool,
}

impl<F: NorFlash> Journal<F> {
    /// Reads the journal. Nothing is written.
    pub fn open(flash: F) -> Self {
        let state = BootState::default();
        let mut journal =
            Self { flash, state, generation: 1, active: 0, next: 0, is_settled: false };
        let [first, second] = [journal.read_sector(0), journal.read_sector(1)];
        let generation =
            |content: &SectorContent| content.last.map_or(0, |(generation, _)| generation);
        let is_second = generation(&second) > generation(&first);
        let (active, spare) = if is_second { (second, first) } else { (first, second) };
        journal.active = u32::from(is_second);
        journal.next = active.used;
        match active.last {
            Some((generation, state)) => {
                journal.generation = generation;
                journal.state = state;
                // The next generation may have been begun, and be read at a later start: the spare sector is
                // blank or full unless it was cut in its first entries.
                let is_begun = spare.used > 0 && journal.has_room_for_state(spare.used);
                journal.is_settled =
                    active.is_settled && (journal.has_room_for_state(active.used) || !is_begun);
            }
            None => journal.is_settled = active.used == 0 && spare.used == 0,
        }
        journal
    }

    /// Returns the state that is believed. Call [`Self::settle`] before anything is done because of it.
    pub const fn state(&self) -> BootState {
        self.state
    }

    /// Writes the believed state again if it is not settled, and into the other sector if there is too little room
    /// for an application's own.
    ///
    /// # Errors
    /// [`JournalWriteError`].
    pub fn settle(&mut self) -> Result<(), JournalWriteError> {
        let has_room = self.next.saturating_add(RESERVED_ENTRIES) <= self.entries_per_sector();
        if self.is_settled && has_room {
            return Ok(());
        }
        if !has_room {
            self.is_settled = false;
            self.begin_generation()?;
        }
        self.write(self.state)
    }

    /// Stores a state; it counts from now on, whatever happens.
    ///
    /// # Errors
    /// [`JournalWriteError`]; the state before it still counts, or this one; [`Self::settle`] decides it.
    pub fn commit(&mut self, state: BootState) -> Result<(), JournalWriteError> {
        if self.is_settled && self.state == state { Ok(()) } else { self.write(state) }
    }

    /// Returns the flash.
    pub fn into_flash(self) -> F {
        self.flash
    }

    fn write(&mut self, state: BootState) -> Result<(), JournalWriteError> {
        self.is_settled = false;
        if !self.has_room_for_state(self.next) {
            self.begin_generation()?;
        }
        for _ in 0..COPIES_PER_STATE {
            self.append_state_copy(&state)?;
        }
        self.state = state;
        self.is_settled = true;
        Ok(())
    }

    /// Erases the other sector and goes on there.
    fn begin_generation(&mut self) -> Result<(), JournalWriteError> {
        let spare = 1_u32.saturating_sub(self.active);
        let start = self.entry_address(spare, 0);
        let end = start.saturating_add(self.sector_size());
        self.flash.erase(start, end).map_err(|_| JournalWriteError)?;
        if self.read_sector(spare).used > 0 {
            return Err(JournalWriteError);
        }
        self.active = spare;
        self.next = 0;
        self.generation = self.generation.checked_add(1).ok_or(JournalWriteError)?;
        Ok(())
    }

    fn append_state_copy(&mut self, state: &BootState) -> Result<(), JournalWriteError> {
        let bytes = state.encode(self.generation);
        for _ in 0..MAX_WRITE_ATTEMPTS {
            if self.next >= self.entries_per_sector() {
                return Err(JournalWriteError);
            }
            let address = self.entry_address(self.active, self.next);
            self.next = self.next.saturating_add(1);
            if self.program_and_verify_entry(address, &bytes) {
                return Ok(());
            }
        }
        Err(JournalWriteError)
    }

    /// Writes an entry, its first word before the others; returns whether it is read back unchanged.
    fn program_and_verify_entry(&mut self, address: u32, bytes: &[u8; JOURNAL_ENTRY_SIZE]) -> bool {
        let (claim, content) = bytes.split_at(CLAIM_WORD_BYTES);
        let mut back = [0xFF; JOURNAL_ENTRY_SIZE];
        self.flash.write(address, claim).is_ok()
            && self.flash.write(address.saturating_add(4), content).is_ok()
            && self.flash.read(address, &mut back).is_ok()
            && back == *bytes
    }

    fn read_sector(&mut self, sector: u32) -> SectorContent {
        let mut content = SectorContent::default();
        let mut before = None;
        for number in 0..self.entries_per_sector() {
            let mut bytes = [0; JOURNAL_ENTRY_SIZE];
            let address = self.entry_address(sector, number);
            let is_read = self.flash.read(address, &mut bytes).is_ok();
            if is_read && bytes.iter().all(|byte| *byte == 0xFF) {
                continue;
            }
            let is_next = content.used == number;
            content.used = number.saturating_add(1);
            let entry = BootState::decode(&bytes).filter(|_| is_read);
            content.is_settled = is_next && entry.is_some() && entry == before;
            content.last = entry.or(content.last);
            before = entry;
        }
        content
    }

    /// Returns whether a state finds room behind this many entries.
    fn has_room_for_state(&self, used: u32) -> bool {
        used.saturating_add(COPIES_PER_STATE) <= self.entries_per_sector()
    }

    fn sector_size(&self) -> u32 {
        u32::try_from(self.flash.capacity() / 2).unwrap_or(u32::MAX)
    }

    fn entries_per_sector(&self) -> u32 {
        self.sector_size() / JOURNAL_ENTRY_BYTES
    }

    fn entry_address(&self, sector: u32, entry: u32) -> u32 {
        sector
            .saturating_mul(self.sector_size())
            .saturating_add(entry.saturating_mul(JOURNAL_ENTRY_BYTES))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{boot_state::ImageStatus, flash_layout::Slot, image_header::FirmwareVersion};
    use trueup_store::simulated_nor_flash::SimulatedNorFlash;

    /// Room for four states.
    const SECTOR: usize = 8 * JOURNAL_ENTRY_SIZE;
    type Flash = SimulatedNorFlash<SECTOR>;

    fn state(number: u32) -> BootState {
        BootState { floor: FirmwareVersion(number), ..BootState::default() }.with_status(
            Slot::B,
            number,
            ImageStatus::Trial(1),
        )
    }

    fn reopened(journal: Journal<Flash>) -> Journal<Flash> {
        Journal::open(journal.into_flash().with_power_restored())
    }

    #[test]
    fn the_last_state_counts_through_more_than_the_flash_holds() {
        let mut journal = Journal::open(Flash::erased());
        assert!(journal.is_settled);
        assert_eq!(journal.state(), BootState::default());
        for number in 1..100 {
            journal.commit(state(number)).unwrap();
            journal = reopened(journal);
            assert_eq!((journal.state(), journal.is_settled), (state(number), true));
        }
    }

    #[test]
    fn the_same_state_again_is_not_written() {
        let mut journal = Journal::open(Flash::erased());
        journal.commit(state(1)).unwrap();
        let bytes = journal.flash.bytes.clone();
        journal.commit(state(1)).unwrap();
        journal.settle().unwrap();
        assert_eq!(journal.flash.bytes, bytes);
    }

    #[test]
    fn one_damaged_byte_anywhere_loses_no_state_that_was_acknowledged() {
        for states in 1..12 {
            let mut journal = Journal::open(Flash::erased());
            for number in 1..=states {
                journal.commit(state(number)).unwrap();
            }
            let flash = journal.into_flash();
            for at in 0..flash.bytes.len() {
                let mut damaged = flash.clone();
                damaged.bytes[at] ^= 0x40;
                let mut journal = Journal::open(damaged);
                assert_eq!(journal.state(), state(states), "{states} stored, byte {at}");
                journal.settle().unwrap();
                assert_eq!(reopened(journal).state(), state(states));
            }
        }
    }

    #[test]
    fn code_of_an_older_image_where_the_records_are_to_be_says_nothing_and_gives_way() {
        // A probe leaves the sectors alone that an image has nothing in.
        let mut random = 1_u32;
        let mut flash = Flash::erased();
        for byte in &mut flash.bytes {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *byte = (random >> 24) as u8;
        }
        let mut journal = Journal::open(flash);
        assert_eq!((journal.state(), journal.is_settled), (BootState::default(), false));
        journal.settle().unwrap();
        journal = reopened(journal);
        assert_eq!((journal.state(), journal.is_settled), (BootState::default(), true));
        journal.commit(state(1)).unwrap();
        assert_eq!(reopened(journal).state(), state(1));
    }

    #[test]
    fn a_dead_flash_takes_nothing_and_reports_it() {
        let mut journal = Journal::open(Flash { dead: true, ..Flash::erased() });
        assert_eq!(journal.commit(state(1)), Err(JournalWriteError));
        assert_eq!((journal.state(), journal.is_settled), (BootState::default(), false));
    }

    /// Ends three starts in a row at these places, with a new state each, and panics if a state that was read and
    /// settled, or acknowledged, is gone afterwards.
    fn cut_three_times(before: u32, seed: u32, cuts: [usize; 3]) {
        let mut flash = Flash::with_unstable_bits(seed);
        let mut journal = Journal::open(flash.clone());
        for number in 1..=before {
            journal.commit(state(number)).unwrap();
        }
        flash = journal.into_flash();
        // The number of the last state that a caller has relied on.
        let mut relied = before;
        for (number, cut) in (before + 1..).zip(cuts) {
            let mut journal = Journal::open(Flash { fuel: cut, ..flash.with_power_restored() });
            if journal.settle().is_ok() {
                let found = journal.state().floor.0;
                assert!(found >= relied, "{found} after {relied}, cuts {cuts:?}, seed {seed}");
                relied = found;
                if journal.commit(state(number)).is_ok() {
                    relied = number;
                }
            }
            flash = journal.into_flash();
        }
        for _ in 0..4 {
            let found = Journal::open(flash.with_power_restored()).state().floor.0;
            assert!(found >= relied, "{found} after {relied}, cuts {cuts:?}, seed {seed}");
            flash = flash.with_power_restored();
            flash.random.set(flash.random.get().wrapping_mul(0x9E37_79B9) | 1);
        }
    }

    /// Bytes of a state: two entries.
    const STATE: usize = 2 * JOURNAL_ENTRY_SIZE;

    #[test]
    fn three_cuts_in_a_row_lose_no_state_that_was_relied_on() {
        let mut triples = 0_u32;
        for before in 0..5 {
            // A start that settles and stores writes two states, and a sector may be erased before either.
            for first in (0..=2 * STATE + SECTOR).step_by(4) {
                for second in
                    (0..2 * STATE).step_by(4).chain((2 * STATE..=2 * STATE + SECTOR).step_by(28))
                {
                    for third in [1, 5, 28, 33, 60, 66, 97, 127, 130] {
                        triples += 1;
                        cut_three_times(before, triples, [first, second, third]);
                    }
                }
            }
        }
        assert!(triples > 100_000, "{triples}");
    }
}
