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
//! A record is written from its first byte to its last, and its CRC comes last, as `log` demands.
//! A reference belongs to the constants that it was computed with, so one of another calibration is
//! not taken up; it counts again when that calibration is back, until its half is emptied.

use embedded_storage::nor_flash::NorFlash;
use trueup_core::{
    bridge::Reference,
    units::{Fine, Nanometres},
};

use crate::{
    crc,
    log::{Half, Log, StoreError, write_part},
};

/// Bytes of a slot, which a record fills.
const SLOT_SIZE: u32 = 32;
/// Bytes of a record.
pub const RECORD_SIZE: usize = SLOT_SIZE as usize;
/// The layout described here.
const LAYOUT: u32 = 1;
/// How many slots are tried for one record.
const ATTEMPTS: u32 = 3;

type Bytes = [u8; RECORD_SIZE];

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
        let [elongation, x, y, z] = [elongation.0, x.0, y.0, z.0].map(i32::cast_unsigned);
        let words = [self.sequence, self.calibration, elongation, x, y, z, LAYOUT];
        let mut bytes = [0; RECORD_SIZE];
        for (place, word) in bytes.as_chunks_mut().0.iter_mut().zip(words) {
            *place = word.to_le_bytes();
        }
        crc::seal(&mut bytes);
        bytes
    }

    /// `None`: these bytes are no record.
    fn decode(bytes: &Bytes) -> Option<Self> {
        let &[sequence, calibration, elongation, x, y, z, layout] =
            crc::unseal(bytes)?.as_chunks().0
        else {
            return None;
        };
        (u32::from_le_bytes(layout) == LAYOUT).then(|| Self {
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

/// The stored references, open for one calibration.
#[derive(Debug)]
pub struct References<F> {
    log: Log<F>,
    calibration: u32,
    /// The reference of this calibration that counts, and the half that its record is in.
    current: Option<(Reference, Half)>,
}

impl<F: NorFlash> References<F> {
    /// Reads all of the flash. What cannot be read counts as damaged.
    pub fn open(flash: F, calibration: u32) -> (Self, Found) {
        let mut found = Found::default();
        let mut current = None;
        let log = Log::open(flash, SLOT_SIZE, |flash, slot| {
            let mut bytes = [0; RECORD_SIZE];
            let is_read = flash.read(slot.address, &mut bytes).is_ok();
            let Some(record) = is_read.then(|| Record::decode(&bytes)).flatten() else {
                found.damaged = found.damaged.saturating_add(1);
                return None;
            };
            if record.calibration != calibration {
                found.foreign = found.foreign.saturating_add(1);
            } else if found.reference.is_none_or(|(newest, _)| record.sequence > newest) {
                found.reference = Some((record.sequence, record.reference));
                current = Some((record.reference, slot.half));
            }
            Some(record.sequence)
        });
        (Self { log, calibration, current }, found)
    }

    /// Appends a reference; gives the sequence number of its record.
    ///
    /// # Errors
    /// [`StoreError`]; what was stored before still counts.
    pub fn append(&mut self, reference: Reference) -> Result<u32, StoreError> {
        let calibration = self.calibration;
        let (sequence, slot) = self.log.append(ATTEMPTS, |flash, slot, sequence| {
            write_part(flash, slot.address, &Record { sequence, calibration, reference }.encode())
        })?;
        self.current = Some((reference, slot.half));
        Ok(sequence)
    }

    /// Empties the half that is not written to, if it is not empty: records go on there when the
    /// other one is full. Gives whether it had to. The erase may stall the core for seconds: this
    /// is for a moment when nothing is followed.
    ///
    /// # Errors
    /// [`StoreError`]; what is stored still counts.
    pub fn make_room(&mut self) -> Result<bool, StoreError> {
        // What still counts moves on before its half goes. Where there is no room for it, after.
        let moved = self.current.filter(|(_, half)| *half != self.log.active());
        let has_room = self.log.has_room();
        if let (Some((reference, _)), true) = (moved, has_room) {
            self.append(reference)?;
        }
        let emptied = self.log.make_room()?;
        if let (Some((reference, _)), false) = (moved, has_room) {
            self.append(reference)?;
        }
        Ok(emptied)
    }
}

#[cfg(test)]
mod tests;
