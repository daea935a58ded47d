//! The reference that `Zero` has taken, kept in flash: a log of records, the newest counts.
//!
//! | offset | a record, 32 bytes, little-endian | unit |
//! |---|---|---|
//! | 0 | `u32` sequence number, from 1 | |
//! | 4 | `u32` the calibration that it was taken with: the CRC of its blob | |
//! | 8 | `i32` elongation | nm |
//! | 12 | 3 × `i32` errors of X, Y, Z | 1/256 nm |
//! | 24 | `u32` layout, 1 | |
//! | 28 | CRC-32/AUTOSAR of the 28 bytes before it | |
//!
//! The flash has two halves. Records are appended to one of them, so that `Zero` needs no erase;
//! when it is full they go on in the other, which [`References::make_room`] has emptied before. A
//! record is written from its first byte to its last, and its CRC comes last: a power cut leaves a
//! record that is none, in a slot that is skipped from then on, and the one before it counts. A
//! reference belongs to the constants that it was computed with, so one of another calibration is
//! not taken up; it counts again when that calibration is back, until its half is emptied.
//!
//! Not `sequential-storage`, whose pages and items could do this: it erases inside the call that
//! stores, when a page is full, and an erase stalls this chip for 1 to 2 s while offsets are being
//! followed; and it passes over a damaged item without a word, where a machine's log should tell.

use core::{error::Error, fmt};

use embedded_storage::nor_flash::NorFlash;
use trueup_core::{
    bridge::Reference,
    units::{Fine, Nanometres},
};

use crate::calibration::CRC;

/// Bytes from one record to the next.
const STEP: u32 = 32;
/// Bytes of a record.
pub const RECORD_SIZE: usize = STEP as usize;
/// The layout described here.
const LAYOUT: u32 = 1;
/// How many slots are tried for one record: one that does not take it may be worn.
const ATTEMPTS: u32 = 3;

type Bytes = [u8; RECORD_SIZE];
/// A slot that was never written.
const BLANK: Bytes = [0xFF; RECORD_SIZE];

/// One record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Record {
    sequence: u32,
    calibration: u32,
    reference: Reference,
}

impl Record {
    fn encode(&self) -> Bytes {
        let Reference { elongation, axes: [x, y, z] } = self.reference;
        let signed = |value: i32| value.to_le_bytes();
        let mut bytes = BLANK;
        let words = [self.sequence.to_le_bytes(), self.calibration.to_le_bytes()]
            .into_iter()
            .chain([elongation.0, x.0, y.0, z.0].map(signed))
            .chain([LAYOUT.to_le_bytes()]);
        for (place, word) in bytes.as_chunks_mut().0.iter_mut().zip(words) {
            *place = word;
        }
        if let Some((content, crc)) = bytes.split_last_chunk_mut() {
            *crc = CRC.checksum(content).to_le_bytes();
        }
        bytes
    }

    /// `None`: these bytes are no record.
    fn decode(bytes: &Bytes) -> Option<Self> {
        let (content, crc) = bytes.split_last_chunk()?;
        let &[sequence, calibration, elongation, x, y, z, layout] = content.as_chunks().0 else {
            return None;
        };
        let is_whole = CRC.checksum(content) == u32::from_le_bytes(*crc);
        (is_whole && u32::from_le_bytes(layout) == LAYOUT).then(|| Self {
            sequence: u32::from_le_bytes(sequence),
            calibration: u32::from_le_bytes(calibration),
            reference: Reference {
                elongation: Nanometres(i32::from_le_bytes(elongation)),
                axes: [x, y, z].map(|axis| Fine(i32::from_le_bytes(axis))),
            },
        })
    }
}

/// What the flash was found to hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// The newest reference of this calibration, with its sequence number.
    pub reference: Option<(u32, Reference)>,
    /// Records of other calibrations.
    pub foreign: u32,
    /// Slots that hold something, but no record.
    pub damaged: u32,
}

/// One half of the flash.
#[derive(Clone, Copy, Debug, Default)]
struct Half {
    /// Slots up to the last one that is not blank.
    used: u32,
    /// The largest sequence number in it; 0: it has no record.
    newest: u32,
}

/// The log, open for one calibration.
#[derive(Debug)]
pub struct References<F> {
    flash: F,
    calibration: u32,
    halves: [Half; 2],
    /// The half that is written to, 0 or 1.
    active: u32,
    /// The record of this calibration that counts, and the half it is in.
    current: Option<(Record, u32)>,
}

impl<F: NorFlash> References<F> {
    /// Reads all of the flash. What cannot be read counts as damaged.
    pub fn open(flash: F, calibration: u32) -> (Self, Found) {
        let mut log =
            Self { flash, calibration, halves: [Half::default(); 2], active: 0, current: None };
        let mut found = Found::default();
        for half in 0..2 {
            for slot in 0..log.slots() {
                let bytes = log.read(half, slot);
                if bytes == Some(BLANK) {
                    continue;
                }
                log.note_used(half, slot);
                match bytes.as_ref().and_then(Record::decode) {
                    None => found.damaged = found.damaged.saturating_add(1),
                    Some(record) => {
                        if record.calibration != calibration {
                            found.foreign = found.foreign.saturating_add(1);
                        }
                        log.note(record, half);
                    }
                }
            }
        }
        let [first, second] = log.halves;
        // Without any record the half with more room is taken.
        let second_is_ahead = second.newest > first.newest
            || (second.newest == first.newest && second.used < first.used);
        log.active = u32::from(second_is_ahead);
        found.reference = log.current.map(|(record, _)| (record.sequence, record.reference));
        (log, found)
    }

    /// Appends a reference; gives the sequence number of its record.
    ///
    /// # Errors
    /// [`StoreError`]; what was stored before still counts.
    pub fn append(&mut self, reference: Reference) -> Result<u32, StoreError> {
        let newest = self.halves.iter().map(|half| half.newest).max().unwrap_or_default();
        let sequence = newest.checked_add(1).ok_or(StoreError::Full)?;
        let record = Record { sequence, calibration: self.calibration, reference };
        let bytes = record.encode();
        for _ in 0..ATTEMPTS {
            let (half, slot) = self.next_slot()?;
            let written = self.flash.write(self.address(half, slot), &bytes).is_ok();
            let read = self.read(half, slot);
            if read != Some(BLANK) {
                self.note_used(half, slot);
            }
            if written && read == Some(bytes) {
                self.active = half;
                self.note(record, half);
                return Ok(sequence);
            }
        }
        Err(StoreError::NotTaken)
    }

    /// Empties the half that is not written to, if it is not empty: records go on there when the
    /// other one is full. Gives whether it had to. The erase may stall the core for seconds: this
    /// is for a moment when nothing is followed.
    ///
    /// # Errors
    /// [`StoreError`]; what is stored still counts.
    pub fn make_room(&mut self) -> Result<bool, StoreError> {
        let old = 1_u32.saturating_sub(self.active);
        if self.half(old).used == 0 {
            return Ok(false);
        }
        // What still counts moves on before its half goes. Where there is no room for it, after.
        let moved = self.current.filter(|(_, half)| *half == old).map(|(record, _)| record);
        let has_room = self.half(self.active).used < self.slots();
        if let Some(record) = moved.filter(|_| has_room) {
            self.append(record.reference)?;
        }
        let (start, end) = (self.address(old, 0), self.address(old, self.slots()));
        let erased = self.flash.erase(start, end).is_ok();
        if !erased || (0..self.slots()).any(|slot| self.read(old, slot) != Some(BLANK)) {
            return Err(StoreError::NotErased);
        }
        if let Some(half) = self.halves.get_mut(old as usize) {
            *half = Half::default();
        }
        if let Some(record) = moved.filter(|_| !has_room) {
            self.append(record.reference)?;
        }
        Ok(true)
    }

    /// Where the next record goes.
    fn next_slot(&self) -> Result<(u32, u32), StoreError> {
        let other = 1_u32.saturating_sub(self.active);
        if self.slots() == 0 {
            Err(StoreError::Full)
        } else if self.half(self.active).used < self.slots() {
            Ok((self.active, self.half(self.active).used))
        } else if self.half(other).used == 0 {
            Ok((other, 0))
        } else {
            Err(StoreError::Full)
        }
    }

    fn half(&self, half: u32) -> Half {
        self.halves.get(half as usize).copied().unwrap_or_default()
    }

    fn note_used(&mut self, half: u32, slot: u32) {
        if let Some(half) = self.halves.get_mut(half as usize) {
            half.used = half.used.max(slot.saturating_add(1));
        }
    }

    fn note(&mut self, record: Record, half: u32) {
        if let Some(half) = self.halves.get_mut(half as usize) {
            half.newest = half.newest.max(record.sequence);
        }
        let is_newer = self.current.is_none_or(|(other, _)| record.sequence > other.sequence);
        if record.calibration == self.calibration && is_newer {
            self.current = Some((record, half));
        }
    }

    /// Slots in a half.
    fn slots(&self) -> u32 {
        u32::try_from(self.flash.capacity() / RECORD_SIZE / 2).unwrap_or(u32::MAX)
    }

    fn address(&self, half: u32, slot: u32) -> u32 {
        half.saturating_mul(self.slots()).saturating_add(slot).saturating_mul(STEP)
    }

    fn read(&mut self, half: u32, slot: u32) -> Option<Bytes> {
        let mut bytes = [0; RECORD_SIZE];
        self.flash.read(self.address(half, slot), &mut bytes).ok().map(|()| bytes)
    }
}

/// Why a reference is not stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoreError {
    /// Both halves are full.
    Full,
    /// The flash did not take the record.
    NotTaken,
    /// The flash was not emptied.
    NotErased,
}

impl fmt::Display for StoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Full => "both halves are full until the next start",
            Self::NotTaken => "the flash does not take it",
            Self::NotErased => "the flash is not emptied",
        })
    }
}

impl Error for StoreError {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::strict_flash::StrictFlash;

    const SLOTS: u32 = 8;
    const HALF: u32 = SLOTS * STEP;
    const SIZE: usize = 2 * HALF as usize;
    type Flash = StrictFlash<{ HALF as usize }>;
    const OURS: u32 = 0xC0FF_EE01;
    const OTHER: u32 = 0x0BAD_CAFE;

    /// References that differ in every byte.
    fn reference(n: u32) -> Reference {
        let value = |k: u32| (n * 0x0101_0101).wrapping_mul(2 * k + 1) as i32;
        Reference {
            elongation: Nanometres(value(1)),
            axes: [Fine(value(2)), Fine(value(3)), Fine(value(4))],
        }
    }

    fn open(flash: &Flash, calibration: u32) -> (References<Flash>, Found) {
        References::open(flash.powered(), calibration)
    }

    fn loaded(flash: &Flash) -> Option<Reference> {
        open(flash, OURS).1.reference.map(|(_, reference)| reference)
    }

    #[test]
    fn the_bytes_of_a_record_are_as_the_table_says() {
        let record = Record {
            sequence: 2,
            calibration: 0x1122_3344,
            reference: Reference {
                elongation: Nanometres(62_805),
                axes: [Fine(-1), Fine(0), Fine(256)],
            },
        };
        let bytes = record.encode();
        assert_eq!(
            bytes[..28],
            [
                2, 0, 0, 0, 0x44, 0x33, 0x22, 0x11, 0x55, 0xF5, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF, 0, 0,
                0, 0, 0, 1, 0, 0, 1, 0, 0, 0
            ]
        );
        assert_eq!(Record::decode(&bytes), Some(record));
        assert_eq!((Record::decode(&BLANK), Record::decode(&[0; RECORD_SIZE])), (None, None));
    }

    #[test]
    fn the_newest_counts_through_more_records_than_the_flash_holds() {
        let (mut log, found) = open(&Flash::erased(), OURS);
        assert_eq!(found, Found::default());
        let mut erases = 0;
        for n in 1..=100 {
            assert_eq!(log.append(reference(n)), Ok(n));
            assert_eq!(loaded(&log.flash), Some(reference(n)));
            erases += u32::from(log.make_room() == Ok(true));
            assert_eq!(loaded(&log.flash), Some(reference(n)));
        }
        std::println!("100 records in a flash of {} slots: {erases} erases", 2 * SLOTS);
        assert!((100 / SLOTS - 1..=100 / SLOTS + 1).contains(&erases));
    }

    #[test]
    fn without_room_a_reference_is_refused_and_the_next_start_makes_room() {
        let (mut log, _) = open(&Flash::erased(), OURS);
        for n in 1..=2 * SLOTS {
            assert_eq!(log.append(reference(n)), Ok(n));
        }
        assert_eq!(log.append(reference(99)), Err(StoreError::Full));
        let (mut log, found) = open(&log.flash, OURS);
        assert_eq!(found.reference, Some((2 * SLOTS, reference(2 * SLOTS))));
        assert_eq!((log.make_room(), log.make_room()), (Ok(true), Ok(false)));
        assert_eq!(log.append(reference(99)), Ok(2 * SLOTS + 1));
        assert_eq!(loaded(&log.flash), Some(reference(99)));
    }

    #[test]
    fn a_reference_of_another_calibration_is_not_taken_up_and_not_lost() {
        let (mut log, _) = open(&Flash::erased(), OURS);
        log.append(reference(1)).unwrap();
        // Others fill both halves, and room is made again and again.
        let (mut others, found) = open(&log.flash, OTHER);
        assert_eq!(found, Found { reference: None, foreign: 1, damaged: 0 });
        for n in 2..SLOTS {
            others.append(reference(n)).unwrap();
        }
        let (mut log, found) = open(&others.flash, OURS);
        assert_eq!((found.reference, found.foreign), (Some((1, reference(1))), SLOTS - 2));
        // Ours moves on when its half goes.
        let (mut others, _) = open(&log.flash, OTHER);
        for n in 0..3 {
            others.append(reference(n)).unwrap();
        }
        log = open(&others.flash, OURS).0;
        assert_eq!(log.make_room(), Ok(true));
        assert_eq!(loaded(&log.flash), Some(reference(1)));
    }

    #[test]
    fn a_power_cut_at_any_byte_of_a_record_loses_that_record_at_most() {
        for before in 0..2 * SLOTS {
            let (mut log, _) = open(&Flash::erased(), OURS);
            (1..=before).for_each(|n| assert_eq!(log.append(reference(n)), Ok(n)));
            let old = (before > 0).then(|| reference(before));
            for fuel in 0..=RECORD_SIZE {
                let mut cut = open(&log.flash, OURS).0;
                cut.flash.fuel = fuel;
                let stored = cut.append(reference(77)).is_ok();
                assert_eq!(stored, fuel == RECORD_SIZE);
                let expected = if stored { Some(reference(77)) } else { old };
                assert_eq!(loaded(&cut.flash), expected, "{before} records, cut at byte {fuel}");
                // Life goes on after it.
                let (mut log, found) = open(&cut.flash, OURS);
                assert!(found.damaged <= 1);
                log.make_room().unwrap();
                log.append(reference(88)).unwrap();
                assert_eq!(loaded(&log.flash), Some(reference(88)));
            }
        }
    }

    #[test]
    fn a_power_cut_at_any_byte_of_making_room_loses_nothing() {
        // Ours is in the old half, alone or not: it has to move before the erase.
        for others in 0..SLOTS {
            let (mut log, _) = open(&Flash::erased(), OURS);
            (1..=SLOTS).for_each(|n| assert_eq!(log.append(reference(n)), Ok(n)));
            let (mut log, _) = open(&log.flash, if others == 0 { OURS } else { OTHER });
            for _ in 0..others.max(1) {
                log.append(reference(9)).unwrap();
            }
            let expected = loaded(&log.flash);
            assert!(expected.is_some());
            for fuel in 0..=RECORD_SIZE + HALF as usize {
                let mut cut = open(&log.flash, OURS).0;
                cut.flash.fuel = fuel;
                let done = cut.make_room() == Ok(true);
                assert_eq!(loaded(&cut.flash), expected, "{others} others, cut at byte {fuel}");
                let mut log = open(&cut.flash, OURS).0;
                assert_eq!(log.make_room(), Ok(!done));
                log.append(reference(88)).unwrap();
                assert_eq!(loaded(&log.flash), Some(reference(88)));
            }
        }
    }

    #[test]
    fn every_flipped_bit_of_a_record_is_found() {
        let (mut log, _) = open(&Flash::erased(), OURS);
        (1..=2).for_each(|n| assert_eq!(log.append(reference(n)), Ok(n)));
        for bit in 0..RECORD_SIZE * 8 {
            let mut flash = log.flash.clone();
            flash.bytes[RECORD_SIZE + bit / 8] ^= 1 << (bit % 8);
            let (_, found) = open(&flash, OURS);
            let expected = Found { reference: Some((1, reference(1))), foreign: 0, damaged: 1 };
            assert_eq!(found, expected, "bit {bit}");
        }
    }

    #[test]
    fn a_dead_flash_is_said_and_nothing_else_happens() {
        // Nothing is taken; or all reads as 0, as where no flash answers.
        for fill in [0xFF, 0] {
            let flash = Flash { bytes: std::vec![fill; SIZE], fuel: usize::MAX, dead: true };
            let (mut log, found) = open(&flash, OURS);
            let is_blank = fill == 0xFF;
            assert_eq!(found.reference, None);
            assert_eq!(found.damaged, if is_blank { 0 } else { 2 * SLOTS });
            let room = if is_blank { Ok(false) } else { Err(StoreError::NotErased) };
            assert_eq!(log.make_room(), room);
            let refused = if is_blank { StoreError::NotTaken } else { StoreError::Full };
            assert_eq!(log.append(reference(1)), Err(refused));
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
            assert_eq!((found.reference, found.foreign), (None, 0));
            log.make_room().unwrap();
            let stored = log.append(reference(5)).or_else(|_| {
                // Both halves were full of nothing: the next start makes the other room.
                log = open(&log.flash, OURS).0;
                log.make_room().and_then(|_| log.append(reference(5)))
            });
            assert_eq!((stored, loaded(&log.flash)), (Ok(1), Some(reference(5))));
        }
    }
}
