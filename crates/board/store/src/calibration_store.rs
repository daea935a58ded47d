//! Calibrations that a master has loaded, kept in flash: a log of slots, the newest counts.
//!
//! | offset | a slot, little-endian |
//! |---|---|
//! | 0 | `u32` sequence number, from 1 |
//! | 4 | `u32` the calibration of the image that it was loaded over: the CRC of its blob |
//! | 8 | `u32` the calibration in this slot: the CRC of its blob |
//! | 12 | CRC-32/AUTOSAR of the 12 bytes before it |
//! | 16 | the blob, [`MAX_BLOB_SIZE`] bytes at most |
//!
//! The blob is written first, read back and compared, and the head comes last, as `log` demands:
//! a power cut leaves a slot without a head, and the calibration before it counts. Room is made at
//! the start, before anything runs that an erase would hold up. A sector of 128 KB takes seven, of which
//! one may be a copy of another.
//!
//! A calibration belongs to the image that it was loaded over: an image with another machine file
//! wins over what was loaded before it, or flashing would have no effect and say nothing. An image
//! with the example's constants wins over nothing: whatever was loaded counts.
//!
//! A newest one that is damaged makes an older one count, and that is reported: it is not what the
//! operator has loaded. A load that a power cut has ended is none: its head has no CRC. Only a cut within the
//! CRC itself looks like damage, and the operator must confirm.

use embedded_storage::nor_flash::NorFlash;

use crate::{
    calibration::{self, MAX_BLOB_SIZE},
    crc,
    flash_log::{
        CHUNK_SIZE, FlashLog, LogHalf, RecordCounts, Slot, StoreError, WORD_SIZE, write_and_verify,
    },
};

/// Bytes before the blob.
const HEADER_SIZE: u32 = 16;
/// Bytes of a slot.
#[allow(clippy::cast_possible_truncation, reason = "16 384")]
pub const SLOT_SIZE: u32 = HEADER_SIZE + MAX_BLOB_SIZE as u32;

/// The head of a slot, before the blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct SlotHeader {
    sequence: u32,
    /// The calibration of the image that it was loaded over.
    base: u32,
    /// The calibration in the slot.
    identity: u32,
}

impl SlotHeader {
    fn encode(&self) -> [u8; HEADER_SIZE as usize] {
        let mut bytes = [0; _];
        let words = [self.sequence, self.base, self.identity];
        for (place, word) in bytes.as_chunks_mut().0.iter_mut().zip(words) {
            *place = word.to_le_bytes();
        }
        crc::write_crc(&mut bytes);
        bytes
    }

    /// Returns the head of the slot there; `None`: there is none.
    fn read_at<F: NorFlash>(flash: &mut F, address: u32) -> Option<Self> {
        let mut bytes = [0; HEADER_SIZE as usize];
        flash.read(address, &mut bytes).ok()?;
        let &[sequence, base, identity] = crc::verify_and_strip_crc(&bytes)?.as_chunks().0 else {
            return None;
        };
        let number = u32::from_le_bytes;
        Some(Self { sequence: number(sequence), base: number(base), identity: number(identity) })
    }
}

/// A calibration that is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoredCalibration {
    /// Its sequence number, from 1.
    pub sequence: u32,
    /// Offset of its blob in the flash.
    pub address: u32,
    /// Bytes of its blob, at most [`MAX_BLOB_SIZE`].
    pub length: usize,
}

/// The calibrations found in the flash.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CalibrationScan {
    /// The newest calibration that was loaded over this image.
    pub newest: Option<StoredCalibration>,
    /// Calibrations that were loaded over other images.
    pub foreign: u32,
    /// Slots that hold something, but no calibration.
    pub damaged: u32,
    /// One of these was stored after `newest`, or there is no `newest`: what counts is older than
    /// what was loaded last.
    pub newer_is_damaged: bool,
}

/// The stored calibrations, open for one image.
#[derive(Debug)]
pub struct CalibrationStore<F> {
    log: FlashLog<F>,
    base: Option<u32>,
    /// The one that counts, if the start has found it alone in its half with an older one in the other.
    alone: Option<StoredCalibration>,
}

impl<F: NorFlash> CalibrationStore<F> {
    /// Looks at all of the flash. `base` is the calibration of the image, `None` for one with the
    /// example's constants; each stored calibration is read into `buffer` of [`MAX_BLOB_SIZE`] bytes and
    /// checked.
    pub fn open(flash: F, base: Option<u32>, buffer: &mut [u8]) -> (Self, CalibrationScan) {
        let mut found = CalibrationScan::default();
        let (mut half, mut only): (Option<LogHalf>, _) = (None, RecordCounts::default());
        // The largest number of a damaged one, and of any record before each head that is none.
        let (mut last, mut damaged) = (0, None);
        let mut log = FlashLog::open(flash, SLOT_SIZE, |flash, slot| {
            let Some(head) = SlotHeader::read_at(flash, slot.address) else {
                found.damaged = found.damaged.saturating_add(1);
                if !is_header_incomplete(flash, slot) {
                    // It came after the record before it, whatever number it had.
                    damaged = damaged.max(Some(last));
                }
                return None;
            };
            let sequence = head.sequence;
            last = sequence;
            let address = slot.address.saturating_add(HEADER_SIZE);
            if base.is_some_and(|base| head.base != base) {
                found.foreign = found.foreign.saturating_add(1);
            } else if let Some(length) = validate_stored_blob(flash, address, head.identity, buffer)
            {
                only.count_record(slot.half);
                if found.newest.is_none_or(|other| sequence > other.sequence) {
                    found.newest = Some(StoredCalibration { sequence, address, length });
                    half = Some(slot.half);
                }
            } else {
                found.damaged = found.damaged.saturating_add(1);
                damaged = damaged.max(Some(sequence));
            }
            Some(sequence)
        });
        let newest = found.newest.map_or(0, |newest| newest.sequence);
        found.newer_is_damaged = damaged.is_some_and(|number| number >= newest);
        // What counts must never be in the half that is emptied.
        if let Some(half) = half {
            log.set_active_half(half);
        }
        let alone = found.newest.filter(|_| half.is_some_and(|half| only.has_sole_record_in(half)));
        (Self { log, base, alone }, found)
    }

    /// Stores a blob, as [`calibration::validate_blob`] gives it; gives its sequence number. `between` is
    /// called between parts of 256 bytes, because all of it may take longer than a watchdog waits.
    ///
    /// # Errors
    /// [`StoreError`]; what was stored before still counts.
    pub fn store(&mut self, blob: &[u8], mut between: impl FnMut()) -> Result<u32, StoreError> {
        if blob.len() > MAX_BLOB_SIZE {
            return Err(StoreError::WriteFailed);
        }
        let (base, identity) = (self.base.unwrap_or(0), calibration::calibration_crc(blob));
        self.alone = None;
        let stored = self.log.append(1, |flash, slot, sequence| {
            let mut at = slot.address.saturating_add(HEADER_SIZE);
            for part in blob.chunks(CHUNK_SIZE) {
                if !write_and_verify(flash, at, part) {
                    return false;
                }
                // No more than a slot, which ends within 32 bits.
                at = at.saturating_add(u32::try_from(part.len()).unwrap_or(u32::MAX));
                between();
            }
            write_and_verify(flash, slot.address, &SlotHeader { sequence, base, identity }.encode())
        });
        stored.map(|(sequence, _)| sequence)
    }

    /// Empties the half that is not written to, if it is not empty. Gives whether it had to. The
    /// erase may stall the core for seconds: this is for the start. `between` is called as by [`Self::store`].
    ///
    /// # Errors
    /// [`StoreError`]; what is stored still counts.
    pub fn erase_spare_half(&mut self, between: impl FnMut()) -> Result<bool, StoreError> {
        // What would be left alone is written anew first: a power cut may have torn its head, and the next
        // start may not find it. Where there is no room for that, what was found has to do.
        if let Some(stored) = self.alone
            && self.log.is_spare_half_used()
            && self.log.has_free_slot()
        {
            self.alone = None;
            self.append_copy(stored, between)?;
        }
        self.log.erase_spare_half()
    }

    /// Appends what is stored there once more.
    fn append_copy(
        &mut self,
        stored: StoredCalibration,
        mut between: impl FnMut(),
    ) -> Result<(), StoreError> {
        let head = stored.address.saturating_sub(HEADER_SIZE);
        self.log.append(1, |flash, slot, sequence| {
            let mut part = [0; CHUNK_SIZE];
            let mut done = 0;
            while done < stored.length {
                let length = stored.length.saturating_sub(done).min(CHUNK_SIZE);
                // Whole words, as the flash is read: behind the blob it is blank.
                let words = length.next_multiple_of(WORD_SIZE);
                let Some(bytes) = part.get_mut(..words) else { return false };
                // No more than a slot, which ends within 32 bits.
                let at = u32::try_from(done).unwrap_or(u32::MAX);
                let to = slot.address.saturating_add(HEADER_SIZE).saturating_add(at);
                let is_read = flash.read(stored.address.saturating_add(at), bytes).is_ok();
                if !is_read || !write_and_verify(flash, to, bytes) {
                    return false;
                }
                done = done.saturating_add(length);
                between();
            }
            let Some(head) = SlotHeader::read_at(flash, head) else { return false };
            write_and_verify(flash, slot.address, &SlotHeader { sequence, ..head }.encode())
        })?;
        Ok(())
    }

    /// Returns the flash, for one who reads it in place.
    pub const fn flash(&self) -> &F {
        &self.log.flash
    }
}

/// Returns whether the last word of the head, its CRC, was never written: the load before it was not finished.
fn is_header_incomplete<F: NorFlash>(flash: &mut F, slot: Slot) -> bool {
    let mut crc = [0; 4];
    let at = slot.address.saturating_add(HEADER_SIZE.saturating_sub(4));
    flash.read(at, &mut crc).is_ok() && crc == [0xFF; 4]
}

/// Returns the length of the blob there, if it is the expected one and a bridge can run on it.
fn validate_stored_blob<F: NorFlash>(
    flash: &mut F,
    address: u32,
    identity: u32,
    buffer: &mut [u8],
) -> Option<usize> {
    let buffer = buffer.get_mut(..MAX_BLOB_SIZE)?;
    flash.read(address, buffer).ok()?;
    let blob = calibration::validate_blob(buffer).ok()?;
    let is_it = calibration::calibration_crc(blob) == identity && calibration::decode(blob).is_ok();
    is_it.then_some(blob.len())
}

#[cfg(test)]
mod tests;
