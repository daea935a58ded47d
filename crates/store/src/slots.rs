//! Calibrations that a master has loaded, kept in flash: slots of two sectors, the newest counts.
//!
//! | offset | a slot, little-endian |
//! |---|---|
//! | 0 | `u32` sequence number, from 1 |
//! | 4 | `u32` the calibration of the image that it was loaded over: the CRC of its blob |
//! | 8 | `u32` the calibration in this slot: the CRC of its blob |
//! | 12 | CRC-32/AUTOSAR of the 12 bytes before it |
//! | 16 | the blob, [`MAX_SIZE`] bytes at most |
//!
//! The blob is written first, read back and compared, and the head comes last: a power cut leaves
//! a slot without a head, which is skipped from then on, and the calibration before it counts. So
//! nothing is ever erased to take a new one: blobs are appended to one sector, and when that is full
//! they go on in the other, which [`Slots::make_room`] has emptied at the start, before anything
//! runs that an erase would hold up. A sector of 128 KB takes seven of them.
//!
//! A calibration belongs to the image that it was loaded over: an image with another machine file
//! wins over what was loaded before it, or flashing would have no effect and say nothing.

use embedded_storage::nor_flash::NorFlash;

use crate::{
    calibration::{self, CRC, MAX_SIZE},
    reference::StoreError,
};

/// Bytes before the blob.
const HEAD: u32 = 16;
/// Bytes of a slot.
#[allow(clippy::cast_possible_truncation, reason = "16 384")]
pub const SLOT_SIZE: u32 = HEAD + MAX_SIZE as u32;
/// Bytes that are written or read at once.
const STEP: u32 = 256;
const PART: usize = STEP as usize;
const WORD: usize = 4;

type Head = [u8; HEAD as usize];

/// A calibration that is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stored {
    /// Its number, from 1.
    pub sequence: u32,
    /// Offset of its blob in the flash.
    pub address: u32,
    /// Bytes of its blob.
    pub length: usize,
}

/// What the flash was found to hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// The newest calibration that was loaded over this image.
    pub newest: Option<Stored>,
    /// Calibrations that were loaded over other images.
    pub foreign: u32,
    /// Slots that hold something, but no calibration.
    pub damaged: u32,
}

/// One sector.
#[derive(Clone, Copy, Debug, Default)]
struct Sector {
    /// Slots up to the last one that is not blank.
    used: u32,
    /// The largest sequence number in it; 0: it has none.
    newest: u32,
}

/// The store, open for one image.
#[derive(Debug)]
pub struct Slots<F> {
    flash: F,
    base: u32,
    sectors: [Sector; 2],
    /// The sector that is written to, 0 or 1.
    active: u32,
}

impl<F: NorFlash> Slots<F> {
    /// Looks at all of the flash. `base` is the calibration of the image; each stored calibration is
    /// read into `buffer` of [`MAX_SIZE`] bytes and checked.
    pub fn open(flash: F, base: u32, buffer: &mut [u8]) -> (Self, Found) {
        let mut slots = Self { flash, base, sectors: [Sector::default(); 2], active: 0 };
        let mut found = Found::default();
        let mut counted = None;
        for sector in 0..2 {
            for slot in 0..slots.per_sector() {
                if slots.is_blank(sector, slot) {
                    continue;
                }
                slots.note_used(sector, slot);
                let Some((sequence, base, identity)) = slots.head(sector, slot) else {
                    found.damaged = found.damaged.saturating_add(1);
                    continue;
                };
                slots.note_newest(sector, sequence);
                if base != slots.base {
                    found.foreign = found.foreign.saturating_add(1);
                    continue;
                }
                let address = slots.address(sector, slot).saturating_add(HEAD);
                let Some(length) = slots.check(address, identity, buffer) else {
                    found.damaged = found.damaged.saturating_add(1);
                    continue;
                };
                let stored = Stored { sequence, address, length };
                if found.newest.is_none_or(|other| sequence > other.sequence) {
                    found.newest = Some(stored);
                    counted = Some(sector);
                }
            }
        }
        let [first, second] = slots.sectors;
        let ahead = second.newest > first.newest
            || (second.newest == first.newest && second.used < first.used);
        // What counts must never be in the sector that is emptied.
        slots.active = counted.unwrap_or(u32::from(ahead));
        (slots, found)
    }

    /// Stores a blob, as [`calibration::whole`] gives it; gives its number. `between` is called
    /// between parts of 256 bytes, because all of it may take longer than a watchdog waits.
    ///
    /// # Errors
    /// [`StoreError`]; what was stored before still counts.
    pub fn store(&mut self, blob: &[u8], mut between: impl FnMut()) -> Result<u32, StoreError> {
        let newest = self.sectors.iter().map(|sector| sector.newest).max().unwrap_or_default();
        let sequence = newest.checked_add(1).ok_or(StoreError::Full)?;
        if blob.len() > MAX_SIZE {
            return Err(StoreError::NotTaken);
        }
        let (sector, slot) = self.next_slot()?;
        let start = self.address(sector, slot);
        // Even one that takes nothing is not tried again.
        self.note_used(sector, slot);
        let mut at = start.saturating_add(HEAD);
        for part in blob.chunks(PART) {
            self.write(at, part)?;
            at = at.saturating_add(STEP);
            between();
        }
        let mut head: Head = [0; _];
        let words = [sequence, self.base, calibration::identity(blob)].map(u32::to_le_bytes);
        for (place, word) in head.as_chunks_mut().0.iter_mut().zip(words) {
            *place = word;
        }
        if let Some((content, crc)) = head.split_last_chunk_mut() {
            *crc = CRC.checksum(content).to_le_bytes();
        }
        self.write(start, &head)?;
        self.active = sector;
        self.note_newest(sector, sequence);
        Ok(sequence)
    }

    /// Empties the sector that is not written to, if it is not empty. Gives whether it had to. The
    /// erase may stall the core for seconds: this is for the start.
    ///
    /// # Errors
    /// [`StoreError`]; what is stored still counts.
    pub fn make_room(&mut self) -> Result<bool, StoreError> {
        let other = 1_u32.saturating_sub(self.active);
        if self.sector(other).used == 0 {
            return Ok(false);
        }
        let half = self.sector_size();
        let start = half.saturating_mul(other);
        let erased = self.flash.erase(start, start.saturating_add(half)).is_ok();
        if !erased || (0..self.per_sector()).any(|slot| !self.is_blank(other, slot)) {
            return Err(StoreError::NotErased);
        }
        if let Some(sector) = self.sectors.get_mut(other as usize) {
            *sector = Sector::default();
        }
        Ok(true)
    }

    /// The flash, for one who reads it in place.
    pub const fn flash(&self) -> &F {
        &self.flash
    }

    /// Writes whole words and reads them back.
    fn write(&mut self, at: u32, part: &[u8]) -> Result<(), StoreError> {
        let mut padded = [0xFF; PART];
        let words = part.len().next_multiple_of(WORD);
        let bytes = padded.get_mut(..words).ok_or(StoreError::NotTaken)?;
        bytes.iter_mut().zip(part).for_each(|(place, byte)| *place = *byte);
        let written = self.flash.write(at, bytes).is_ok();
        let mut back = [0; PART];
        let back = back.get_mut(..words).ok_or(StoreError::NotTaken)?;
        let read = self.flash.read(at, back).is_ok();
        if written && read && back == bytes { Ok(()) } else { Err(StoreError::NotTaken) }
    }

    fn is_blank(&mut self, sector: u32, slot: u32) -> bool {
        let start = self.address(sector, slot);
        let mut part = [0; PART];
        let mut at = 0;
        while at < SLOT_SIZE {
            let length = SLOT_SIZE.saturating_sub(at).min(STEP);
            let Some(bytes) = part.get_mut(..length as usize) else { return false };
            let is_read = self.flash.read(start.saturating_add(at), bytes).is_ok();
            if !is_read || bytes.iter().any(|byte| *byte != 0xFF) {
                return false;
            }
            at = at.saturating_add(length);
        }
        true
    }

    /// Sequence number, base, identity.
    fn head(&mut self, sector: u32, slot: u32) -> Option<(u32, u32, u32)> {
        let mut head: Head = [0; _];
        self.flash.read(self.address(sector, slot), &mut head).ok()?;
        let (content, crc) = head.split_last_chunk()?;
        let &[sequence, base, identity] = content.as_chunks().0 else { return None };
        let is_whole = CRC.checksum(content) == u32::from_le_bytes(*crc);
        let number = u32::from_le_bytes;
        is_whole.then(|| (number(sequence), number(base), number(identity)))
    }

    /// The length of the blob there, if it is the expected one and a bridge can run on it.
    fn check(&mut self, address: u32, identity: u32, buffer: &mut [u8]) -> Option<usize> {
        let buffer = buffer.get_mut(..MAX_SIZE)?;
        self.flash.read(address, buffer).ok()?;
        let blob = calibration::whole(buffer).ok()?;
        let is_it = calibration::identity(blob) == identity && calibration::decode(blob).is_ok();
        is_it.then_some(blob.len())
    }

    /// Where the next one goes.
    fn next_slot(&self) -> Result<(u32, u32), StoreError> {
        let other = 1_u32.saturating_sub(self.active);
        if self.sector(self.active).used < self.per_sector() {
            Ok((self.active, self.sector(self.active).used))
        } else if self.sector(other).used == 0 && self.per_sector() > 0 {
            Ok((other, 0))
        } else {
            Err(StoreError::Full)
        }
    }

    fn sector(&self, number: u32) -> Sector {
        self.sectors.get(number as usize).copied().unwrap_or_default()
    }

    fn note_used(&mut self, sector: u32, slot: u32) {
        if let Some(sector) = self.sectors.get_mut(sector as usize) {
            sector.used = sector.used.max(slot.saturating_add(1));
        }
    }

    fn note_newest(&mut self, sector: u32, sequence: u32) {
        if let Some(sector) = self.sectors.get_mut(sector as usize) {
            sector.newest = sector.newest.max(sequence);
        }
    }

    fn sector_size(&self) -> u32 {
        u32::try_from(self.flash.capacity() / 2).unwrap_or(u32::MAX)
    }

    /// Slots in a sector.
    fn per_sector(&self) -> u32 {
        self.sector_size() / SLOT_SIZE
    }

    fn address(&self, sector: u32, slot: u32) -> u32 {
        let start = self.sector_size().saturating_mul(sector);
        start.saturating_add(SLOT_SIZE.saturating_mul(slot))
    }
}

#[cfg(test)]
mod tests;
