//! An append-only log in flash: slots of one size in two halves, each slot for one record.
//!
//! ```text
//!   half 0:  record 1 │ record 2 │ damaged  │ record 3      full
//!   half 1:  record 4 │ record 5 │ blank    │ blank         active: the next record goes here
//! ```
//!
//! Records are appended to the active half, so that storing one needs no erase, which stalls this
//! chip for 1 to 2 s. When that half is full they go on in the other, which [`FlashLog::erase_spare_half`] has
//! emptied before, at a moment when a stall does no harm. Sequence numbers rise from 1 over both
//! halves, so the largest shows which half is active.
//!
//! Its owner says which bytes are a record, and what it holds; the log finds the slots. A record
//! must end with what makes it valid, or have that written last: a power cut then leaves a slot
//! that holds no record, which is passed over from then on, and the record before it counts.
//!
//! A word that the power was cut in may be read differently each time, as whole now and as damaged later.
//! So a record that was found at a start is not relied on alone: before a half is emptied its owner
//! appends anew what would be left as the only one ([`RecordCounts`]), and numbers leave room for what was not
//! read.
//!
//! Not `sequential-storage`, whose pages and items could do this: it erases inside the call that
//! stores, when a page is full; and it passes over a damaged item without a word, where a machine's
//! log should report it.

use embedded_storage::nor_flash::NorFlash;

/// Bytes that are written or read at once.
const CHUNK_LEN: u32 = 256;
/// Bytes of a word, the least that is written.
pub(crate) const WORD_SIZE: usize = 4;

/// Bytes of a part.
pub(crate) const CHUNK_SIZE: usize = CHUNK_LEN as usize;

/// A place for one record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Slot {
    /// The half that it is in.
    pub half: LogHalf,
    number: u32,
    /// Offset of its first byte in the flash.
    pub address: u32,
}

/// One half of the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LogHalf {
    First,
    Second,
}

impl LogHalf {
    const fn other(self) -> Self {
        match self {
            Self::First => Self::Second,
            Self::Second => Self::First,
        }
    }
}

/// Where the records of an owner are, of which the newest counts.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RecordCounts {
    first: u32,
    second: u32,
}

impl RecordCounts {
    /// A record of the owner was found in this half.
    pub(crate) fn count_record(&mut self, half: LogHalf) {
        let count = match half {
            LogHalf::First => &mut self.first,
            LogHalf::Second => &mut self.second,
        };
        *count = count.saturating_add(1);
    }

    /// Returns whether there is one alone in this half, and in the other one what counted before it.
    pub(crate) const fn has_sole_record_in(self, half: LogHalf) -> bool {
        let (own, others) = match half {
            LogHalf::First => (self.first, self.second),
            LogHalf::Second => (self.second, self.first),
        };
        own == 1 && others > 0
    }
}

/// The content of a half.
#[derive(Clone, Copy, Debug, Default)]
struct HalfUsage {
    /// Slots up to the last one that is not blank.
    used: u32,
    /// The largest sequence number in it; 0: it has no record.
    newest: u32,
    /// Slots that hold something, but no record as they were read.
    unread: u32,
}

/// The log, open.
#[derive(Debug)]
pub(crate) struct FlashLog<F> {
    /// Read by its owner too, who must not write to it.
    pub flash: F,
    slot_size: u32,
    first: HalfUsage,
    second: HalfUsage,
    /// The half that is written to.
    active: LogHalf,
}

impl<F: NorFlash> FlashLog<F> {
    /// Looks at all of the flash. `read` is given each slot that is not blank, and says the sequence
    /// number of the record there, from 1, if there is one. A slot that cannot be read is not blank.
    pub fn open(
        flash: F,
        slot_size: u32,
        mut read: impl FnMut(&mut F, Slot) -> Option<u32>,
    ) -> Self {
        let empty = HalfUsage::default();
        let mut log =
            Self { flash, slot_size, first: empty, second: empty, active: LogHalf::First };
        let mut part = [0; CHUNK_SIZE];
        for half in [LogHalf::First, LogHalf::Second] {
            for number in 0..log.slots_per_half() {
                let slot = log.slot(half, number);
                if log.is_erased(slot, &mut part) {
                    continue;
                }
                log.mark_used(slot);
                match read(&mut log.flash, slot) {
                    Some(sequence) => log.update_newest(slot, sequence),
                    None => {
                        let content = log.half_usage_mut(half);
                        content.unread = content.unread.saturating_add(1);
                    }
                }
            }
        }
        let (first, second) = (log.first, log.second);
        // Without any record the first half is taken as long as it has room. Not the one with more room:
        // after a first record that a power cut has torn the other half would have to be emptied, for a
        // second in which the board is silent.
        let first_is_full = first.used >= log.slots_per_half();
        let second_is_ahead = second.newest > first.newest
            || (second.newest == first.newest && first_is_full && second.used < first.used);
        if second_is_ahead {
            log.active = LogHalf::Second;
        }
        log
    }

    /// Appends a record: `write` is given the slot and the sequence number, and says whether the
    /// flash holds the record then. At most `attempts` slots are tried: one that does not take it
    /// may be worn, and is passed over until the next start.
    ///
    /// # Errors
    /// [`StoreError`]; what was stored before still counts.
    pub fn append(
        &mut self,
        attempts: u32,
        mut write: impl FnMut(&mut F, Slot, u32) -> bool,
    ) -> Result<(u32, Slot), StoreError> {
        // A slot that a power cut has torn may be read as a record the next time, with a number that is
        // at most this much larger: this one has to win over it.
        let newest = self.first.newest.max(self.second.newest);
        let unread = self.first.unread.saturating_add(self.second.unread);
        let step = unread.saturating_add(1);
        let sequence = newest.checked_add(step).ok_or(StoreError::Full)?;
        for _ in 0..attempts {
            let slot = self.next_slot()?;
            self.mark_used(slot);
            if write(&mut self.flash, slot, sequence) {
                self.active = slot.half;
                self.update_newest(slot, sequence);
                return Ok((sequence, slot));
            }
            // Only the reading of it may have been wrong.
            let content = self.half_usage_mut(slot.half);
            content.unread = content.unread.saturating_add(1);
        }
        Err(StoreError::WriteFailed)
    }

    /// Empties the half that is not active, if it is not empty. Gives whether it had to. The erase
    /// may stall the core for seconds: this is for a moment when nothing is followed.
    ///
    /// # Errors
    /// [`StoreError::NotErased`].
    pub fn erase_spare_half(&mut self) -> Result<bool, StoreError> {
        let spare = self.active.other();
        if !self.is_spare_half_used() {
            return Ok(false);
        }
        let slots = self.slots_per_half();
        let start = self.slot(spare, 0).address;
        let erased = self.flash.erase(start, start.saturating_add(self.half_size())).is_ok();
        let mut part = [0; CHUNK_SIZE];
        if !erased || (0..slots).any(|number| !self.is_erased(self.slot(spare, number), &mut part))
        {
            return Err(StoreError::NotErased);
        }
        *self.half_usage_mut(spare) = HalfUsage::default();
        Ok(true)
    }

    /// Makes this half the active one, so that [`Self::erase_spare_half`] leaves it alone.
    pub(crate) fn set_active_half(&mut self, half: LogHalf) {
        self.active = half;
    }

    /// Returns the half that is written to, which [`Self::erase_spare_half`] leaves alone.
    pub(crate) const fn active_half(&self) -> LogHalf {
        self.active
    }

    /// Returns whether there is anything in the half that is not active.
    pub(crate) fn is_spare_half_used(&mut self) -> bool {
        self.half_usage_mut(self.active.other()).used > 0
    }

    /// Returns whether the active half takes another record.
    pub(crate) fn has_free_slot(&mut self) -> bool {
        self.half_usage_mut(self.active).used < self.slots_per_half()
    }

    /// Where the next record goes.
    fn next_slot(&mut self) -> Result<Slot, StoreError> {
        let spare = self.active.other();
        if self.has_free_slot() {
            let number = self.half_usage_mut(self.active).used;
            Ok(self.slot(self.active, number))
        } else if self.half_usage_mut(spare).used == 0 && self.slots_per_half() > 0 {
            Ok(self.slot(spare, 0))
        } else {
            Err(StoreError::Full)
        }
    }

    const fn half_usage_mut(&mut self, half: LogHalf) -> &mut HalfUsage {
        match half {
            LogHalf::First => &mut self.first,
            LogHalf::Second => &mut self.second,
        }
    }

    fn mark_used(&mut self, slot: Slot) {
        let content = self.half_usage_mut(slot.half);
        content.used = content.used.max(slot.number.saturating_add(1));
    }

    fn update_newest(&mut self, slot: Slot, sequence: u32) {
        let content = self.half_usage_mut(slot.half);
        content.newest = content.newest.max(sequence);
    }

    /// Bytes of a half.
    fn half_size(&self) -> u32 {
        u32::try_from(self.flash.capacity() / 2).unwrap_or(u32::MAX)
    }

    fn slots_per_half(&self) -> u32 {
        self.half_size().checked_div(self.slot_size).unwrap_or(0)
    }

    fn slot(&self, half: LogHalf, number: u32) -> Slot {
        let start = match half {
            LogHalf::First => 0,
            LogHalf::Second => self.half_size(),
        };
        let address = start.saturating_add(number.saturating_mul(self.slot_size));
        Slot { half, number, address }
    }

    /// Returns whether a slot is as erased flash is. `part` is room to read into: to clear it for each slot would take as
    /// long as to read the slot, and a start looks at all of them.
    #[inline(never)]
    fn is_erased(&mut self, slot: Slot, part: &mut [u8; CHUNK_SIZE]) -> bool {
        let mut at = 0;
        while at < self.slot_size {
            let length = self.slot_size.saturating_sub(at).min(CHUNK_LEN);
            let Some(bytes) = part.get_mut(..length as usize) else { return false };
            let is_read = self.flash.read(slot.address.saturating_add(at), bytes).is_ok();
            let (words, rest) = bytes.as_chunks();
            let is_erased = words.iter().all(|word| u32::from_ne_bytes(*word) == u32::MAX);
            if !is_read || !is_erased || rest.iter().any(|byte| *byte != 0xFF) {
                return false;
            }
            at = at.saturating_add(length);
        }
        true
    }
}

/// Writes at most [`CHUNK_SIZE`] bytes, filled up to whole words with 0xFF, and reads them back; gives
/// whether the flash holds them.
#[inline(never)]
pub(crate) fn write_and_verify<F: NorFlash>(flash: &mut F, address: u32, part: &[u8]) -> bool {
    let words = part.len().next_multiple_of(WORD_SIZE);
    let (mut padded, mut back) = ([0xFF; CHUNK_SIZE], [0; CHUNK_SIZE]);
    let (Some(bytes), Some(back)) = (padded.get_mut(..words), back.get_mut(..words)) else {
        return false;
    };
    bytes.iter_mut().zip(part).for_each(|(place, byte)| *place = *byte);
    let written = flash.write(address, bytes).is_ok();
    let read = flash.read(address, back).is_ok();
    written && read && back == bytes
}

/// Why a record is not stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum StoreError {
    /// Both halves are full.
    #[error("both halves are full until the next start")]
    Full,
    /// The flash did not take the record.
    #[error("the flash does not take it")]
    WriteFailed,
    /// The flash was not emptied.
    #[error("the flash is not emptied")]
    NotErased,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated_nor_flash::SimulatedNorFlash;
    use std::string::ToString;

    const SLOTS: u32 = 4;
    const SLOT_SIZE: u32 = 8;
    const HALF: usize = (SLOTS * SLOT_SIZE) as usize;
    type Flash = SimulatedNorFlash<HALF>;

    /// Slots that hold something, but no record: this many in each half.
    fn of_junk(first: u32, second: u32) -> FlashLog<Flash> {
        let mut flash = Flash::erased();
        for (half, slots) in [first, second].into_iter().enumerate() {
            flash.bytes[half * HALF..][..(slots * SLOT_SIZE) as usize].fill(0);
        }
        FlashLog::open(flash, SLOT_SIZE, |_, _| None)
    }

    #[test]
    fn without_a_record_the_first_half_is_taken_and_the_second_if_only_that_has_room() {
        for first in 0..=SLOTS {
            for second in 0..=SLOTS {
                let mut log = of_junk(first, second);
                let is_full = first == SLOTS && second == SLOTS;
                let taken = log.append(1, |_, _, _| true).map(|(_, slot)| slot.address);
                let expected = match (first, second) {
                    _ if is_full => Err(StoreError::Full),
                    (SLOTS, second) => Ok((SLOTS + second) * SLOT_SIZE),
                    (first, _) => Ok(first * SLOT_SIZE),
                };
                assert_eq!(taken, expected, "{first} and {second} of {SLOTS} hold junk");
            }
        }
    }

    #[test]
    fn a_flash_without_room_for_a_slot_is_full() {
        let mut log = FlashLog::open(Flash::erased(), HALF as u32 + 1, |_, _| None);
        assert_eq!(log.append(1, |_, _, _| true), Err(StoreError::Full));
        assert_eq!(log.erase_spare_half(), Ok(false));
    }

    #[test]
    fn each_reason_has_words_of_its_own() {
        for (error, words) in [
            (StoreError::Full, "full until the next start"),
            (StoreError::WriteFailed, "does not take it"),
            (StoreError::NotErased, "not emptied"),
        ] {
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
