//! The reference that `Zero` has taken, kept in flash: a log of records, the newest counts.
//!
//! | offset | a record, 32 bytes, little-endian | unit |
//! |---|---|---|
//! | 0 | `u32` sequence number, from 1 | |
//! | 4 | `u32` the calibration that it was taken with: the CRC of its blob | |
//! | 8 | `i32` elongation | nm |
//! | 12 | 3 × `i32` errors of X, Y, Z | 1/256 nm |
//! | 24 | `u16` layout, 1 | |
//! | 26 | `u16` level of the converter's internal reference that it counts from; 0: not known | 1/16 code |
//! | 28 | CRC-32/AUTOSAR of the 28 bytes before it | |
//!
//! Between them lie the [writes], with a layout of their own.
//!
//! A record is written from its first byte to its last, and its CRC comes last, as `log` demands.
//! A reference belongs to the constants that it was computed with, so one of another calibration is
//! not taken up; it counts again when that calibration is back, until its half is emptied.

use embedded_storage::nor_flash::NorFlash;
use trueup_core::{
    bridge::Reference,
    supply::Level,
    units::{Fine, Nanometres},
};

use crate::{
    crc,
    log::{Half, Log, Only, StoreError, write_part},
    writes::{self, What, Write, Writes},
};

/// Bytes of a slot, which a record fills.
const SLOT_SIZE: u32 = 32;
/// Bytes of a record.
pub const RECORD_SIZE: usize = SLOT_SIZE as usize;
/// The layout described here.
const LAYOUT: u16 = 1;
/// How many slots are tried for one record.
const ATTEMPTS: u32 = 3;

type Bytes = [u8; RECORD_SIZE];

/// One record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Record {
    sequence: u32,
    calibration: u32,
    reference: Reference,
    supply: Level,
}

impl Record {
    fn encode(&self) -> Bytes {
        let Reference { elongation, axes: [x, y, z] } = self.reference;
        let [elongation, x, y, z] = [elongation.0, x.0, y.0, z.0].map(i32::cast_unsigned);
        let layout = u32::from(LAYOUT) | u32::from(self.supply.0) << 16;
        let words = [self.sequence, self.calibration, elongation, x, y, z, layout];
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
        let [low, high, supply_low, supply_high] = layout;
        (u16::from_le_bytes([low, high]) == LAYOUT).then(|| Self {
            sequence: u32::from_le_bytes(sequence),
            calibration: u32::from_le_bytes(calibration),
            reference: Reference {
                elongation: Nanometres(i32::from_le_bytes(elongation)),
                axes: [x, y, z].map(|axis| Fine(i32::from_le_bytes(axis))),
            },
            supply: Level(u16::from_le_bytes([supply_low, supply_high])),
        })
    }
}

/// The bytes of a write.
fn encode_write(write: &Write) -> Bytes {
    let mut bytes = [0; RECORD_SIZE];
    let words = write.to_bytes().into_iter().chain(writes::LAYOUT.to_le_bytes());
    bytes.iter_mut().zip(words).for_each(|(place, byte)| *place = byte);
    crc::seal(&mut bytes);
    bytes
}

/// `None`: these bytes are no write.
fn decode_write(bytes: &Bytes) -> Option<Write> {
    let (write, layout) = crc::unseal(bytes)?.split_first_chunk()?;
    (layout == writes::LAYOUT.to_le_bytes()).then(|| Write::from_bytes(write)).flatten()
}

/// What the flash was found to hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// The newest reference of this calibration, with its sequence number.
    pub reference: Option<(u32, Reference)>,
    /// The machine and the board that the board belongs to: [`writes::identity`] of their names.
    pub named: Option<u32>,
    /// The level of the supply that it counts from.
    pub supply: Level,
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
    /// The write that has named the board's machine, and the half that it is in.
    named: Option<(Write, Half)>,
    writes: Writes,
    /// Goes into every record.
    supply: Level,
    /// Of the references that were found at the start, and of the names.
    only: Only,
    only_named: Only,
}

impl<F: NorFlash> References<F> {
    /// Reads all of the flash. What cannot be read counts as damaged.
    pub fn open(flash: F, calibration: u32) -> (Self, Found) {
        let mut found = Found::default();
        let (mut current, mut named, mut oldest_first) =
            (None, None::<(Write, Half)>, [None; writes::KEPT]);
        let (mut only, mut only_named) = (Only::default(), Only::default());
        let log = Log::open(flash, SLOT_SIZE, |flash, slot| {
            let mut bytes = [0; RECORD_SIZE];
            let is_read = flash.read(slot.address, &mut bytes).is_ok();
            if let Some(write) = is_read.then(|| decode_write(&bytes)).flatten() {
                let is_newer = named.is_none_or(|(other, _)| write.sequence > other.sequence);
                if write.what == What::Named {
                    only_named.note(slot.half);
                }
                if write.what == What::Named && is_newer {
                    named = Some((write, slot.half));
                }
                insert(&mut oldest_first, write);
                return Some(write.sequence);
            }
            let Some(record) = is_read.then(|| Record::decode(&bytes)).flatten() else {
                found.damaged = found.damaged.saturating_add(1);
                return None;
            };
            if record.calibration != calibration {
                found.foreign = found.foreign.saturating_add(1);
                return Some(record.sequence);
            }
            only.note(slot.half);
            if found.reference.is_none_or(|(newest, _)| record.sequence > newest) {
                found.reference = Some((record.sequence, record.reference));
                found.supply = record.supply;
                current = Some((record.reference, slot.half));
            }
            Some(record.sequence)
        });
        found.named = named.map(|(write, _)| write.about);
        let mut writes = Writes::default();
        oldest_first.iter().flatten().for_each(|write| writes.push(write));
        let supply = found.supply;
        (Self { log, calibration, current, named, only, only_named, writes, supply }, found)
    }

    /// The last writes that were found at the start.
    pub const fn writes(&self) -> &Writes {
        &self.writes
    }

    /// Appends a write; gives it with its sequence number.
    ///
    /// # Errors
    /// [`StoreError`]; what was stored before still counts.
    pub fn append_write(&mut self, write: &Write) -> Result<Write, StoreError> {
        let (sequence, slot) = self.log.append(ATTEMPTS, |flash, slot, sequence| {
            write_part(flash, slot.address, &encode_write(&Write { sequence, ..*write }))
        })?;
        let stored = Write { sequence, ..*write };
        if stored.what == What::Named {
            self.named = Some((stored, slot.half));
            self.only_named = Only::default();
        }
        Ok(stored)
    }

    /// Records from now on say that their references count from this level of the supply.
    pub fn set_supply(&mut self, supply: Level) {
        self.supply = supply;
    }

    /// Appends a reference; gives the sequence number of its record.
    ///
    /// # Errors
    /// [`StoreError`]; what was stored before still counts.
    pub fn append(&mut self, reference: Reference) -> Result<u32, StoreError> {
        let (calibration, supply) = (self.calibration, self.supply);
        let (sequence, slot) = self.log.append(ATTEMPTS, |flash, slot, sequence| {
            write_part(
                flash,
                slot.address,
                &Record { sequence, calibration, reference, supply }.encode(),
            )
        })?;
        self.current = Some((reference, slot.half));
        self.only = Only::default();
        Ok(sequence)
    }

    /// Empties the half that is not written to, if it is not empty: records go on there when the
    /// other one is full. Gives whether it had to. The erase may stall the core for seconds: this
    /// is for a moment when nothing is followed.
    ///
    /// # Errors
    /// [`StoreError`]; what is stored still counts.
    pub fn make_room(&mut self) -> Result<bool, StoreError> {
        // What still counts moves on before its half goes, and is written anew where it would be left
        // alone: a power cut may have torn it. Where there is no room for it, after.
        let (active, has_spare) = (self.log.active(), self.log.has_spare_content());
        let moves = |half: Half, only: Only| half != active || has_spare && only.is_in(active);
        let mut reference = self.current.filter(|(_, half)| moves(*half, self.only));
        let mut named = self.named.filter(|(_, half)| moves(*half, self.only_named));
        if self.log.has_room()
            && let Some((reference, _)) = reference.take()
        {
            self.append(reference)?;
        }
        if self.log.has_room()
            && let Some((named, _)) = named.take()
        {
            self.append_write(&named)?;
        }
        let emptied = self.log.make_room()?;
        if let Some((reference, _)) = reference {
            self.append(reference)?;
        }
        if let Some((named, _)) = named {
            self.append_write(&named)?;
        }
        Ok(emptied)
    }
}

/// Keeps the newest, the oldest first, whatever order they come in.
fn insert(all: &mut [Option<Write>; writes::KEPT], mut write: Write) {
    for place in all.iter_mut().rev() {
        match place {
            Some(other) if other.sequence < write.sequence => core::mem::swap(other, &mut write),
            Some(_) => {}
            None => {
                *place = Some(write);
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests;
#[cfg(test)]
mod write_tests;
