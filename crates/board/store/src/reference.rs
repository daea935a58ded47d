//! The reference of the running calibration, kept in flash: a log of records, the newest of a calibration counts.
//!
//! | offset | a record, 32 bytes, little-endian | unit |
//! |---|---|---|
//! | 0 | `u32` sequence number, from 1 | |
//! | 4 | `u32` the calibration that it was taken with: the CRC of its blob | |
//! | 8 | `i32` elongation | nm |
//! | 12 | 3 × `i32` errors of X, Y, Z | 1/256 nm |
//! | 24 | `u8` layout, 1; `u8` marks: bit 0 offered, bit 1 the calibration was changed unattended | |
//! | 26 | `u16` level of the converter's internal reference that it counts from; 0: not known | 1/16 code |
//! | 28 | CRC-32/AUTOSAR of the 28 bytes before it | |
//!
//! Between them lie the [writes], with a layout of their own.
//!
//! A record is written from its first byte to its last, and its CRC comes last, as `log` demands.
//!
//! **In force or offered.** A reference is in force after a start if nothing newer says that its calibration was
//! loaded again, or that another one ran meanwhile. Otherwise the calibration starts without a reference, and the
//! older one is offered: tools may have been touched off with another one since. The first start after such a
//! change stores what it has found ([`References::make_room`]), so that later starts find it in one record.
//! Records of firmware before 0.3 have no marks: theirs are in force, or offered by the same rule.

use embedded_storage::nor_flash::NorFlash;
use trueup_core::{
    bridge::Reference,
    supply::Level,
    units::{Fine, Nanometres},
};

use crate::{
    crc,
    log::{Half, Log, Only, StoreError, write_part},
    writes::{self, Write, WriteKind, Writes},
};

/// Bytes of a slot, which a record fills.
const SLOT_SIZE: u32 = 32;
/// Bytes of a record.
pub const RECORD_SIZE: usize = SLOT_SIZE as usize;
/// The layout described here.
const LAYOUT: u8 = 1;
/// The marks.
const OFFERED: u8 = 1 << 0;
const CHANGED: u8 = 1 << 1;
/// How many slots are tried for one record.
const ATTEMPTS: u32 = 3;

type Bytes = [u8; RECORD_SIZE];

/// The state of a calibration: its reference, and the operator's answers that are missing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Standing {
    /// The reference.
    pub reference: Reference,
    /// It is not in force: it waits for the operator's answer.
    pub is_offered: bool,
    /// The calibration was changed while no CNC was received, and the operator has not confirmed it.
    pub is_changed: bool,
}

impl Standing {
    /// Returns a reference that is in force, with nothing open.
    #[must_use]
    pub const fn in_force(reference: Reference) -> Self {
        Self { reference, is_offered: false, is_changed: false }
    }
}

/// One record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Record {
    sequence: u32,
    calibration: u32,
    standing: Standing,
    supply: Level,
}

impl Record {
    fn encode(&self) -> Bytes {
        let Standing { reference, is_offered, is_changed } = self.standing;
        let Reference { elongation, axes: [x, y, z] } = reference;
        let [elongation, x, y, z] = [elongation.0, x.0, y.0, z.0].map(i32::cast_unsigned);
        let mut marks = if is_offered { OFFERED } else { 0 };
        if is_changed {
            marks |= CHANGED;
        }
        let [low, high] = self.supply.0.to_le_bytes();
        let layout = u32::from_le_bytes([LAYOUT, marks, low, high]);
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
        let [LAYOUT, marks, supply_low, supply_high] = layout else { return None };
        let reference = Reference {
            elongation: Nanometres(i32::from_le_bytes(elongation)),
            axes: [x, y, z].map(|axis| Fine(i32::from_le_bytes(axis))),
        };
        let (is_offered, is_changed) = (marks & OFFERED != 0, marks & CHANGED != 0);
        (marks & !(OFFERED | CHANGED) == 0).then(|| Self {
            sequence: u32::from_le_bytes(sequence),
            calibration: u32::from_le_bytes(calibration),
            standing: Standing { reference, is_offered, is_changed },
            supply: Level(u16::from_le_bytes([supply_low, supply_high])),
        })
    }
}

/// Returns the bytes of a write.
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

/// The records found in the flash.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// The newest record of this calibration: its sequence number, and what holds now by it and by what came
    /// after it.
    pub standing: Option<(u32, Standing)>,
    /// Something holds that no record says yet.
    pub is_new: bool,
    /// The write that has taken or offered the reference.
    pub taken: Option<Write>,
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
    /// The state of this calibration, and the half that its record is in; `None`: it is not stored yet.
    current: Option<(Standing, Option<Half>)>,
    /// The write that has named the board's machine, and the half that it is in.
    named: Option<(Write, Half)>,
    /// The same of the one that has taken or offered the reference.
    taken: Option<(Write, Half)>,
    writes: Writes,
    /// Goes into every record.
    supply: Level,
    /// Of the records that were found at the start, and of both writes.
    only: Only,
    only_named: Only,
    only_taken: Only,
}

/// The events of a calibration, by the sequence numbers of the records that say so; 0: none does.
#[derive(Default)]
struct Events {
    /// The newest time at which another calibration ran.
    other: u32,
    /// The newest load of this one, unless it was dropped again, and whether it was unattended.
    loaded: (u32, bool),
}

impl Events {
    fn ran(&mut self, calibration: u32, by: u32, sequence: u32) {
        if by != 0 && by != calibration {
            self.other = self.other.max(sequence);
        }
    }

    fn note(&mut self, calibration: u32, write: &Write) {
        // The names move on under whichever calibration runs then.
        if write.what != WriteKind::Named {
            self.ran(calibration, write.calibration, write.sequence);
        }
        let is_newer = write.about == calibration && write.sequence > self.loaded.0;
        match write.what {
            WriteKind::Loaded if is_newer => self.loaded = (write.sequence, write.is_unattended),
            // A load that never came to run.
            WriteKind::Cancelled if is_newer => self.loaded = (0, false),
            _ => {}
        }
    }

    /// Returns what holds now, by the newest record of the calibration; `None`: nothing has changed since.
    fn change(&self, own: Option<(u32, Standing)>) -> Option<Standing> {
        let since = own.map_or(0, |(sequence, _)| sequence);
        let (loaded, is_unattended) = self.loaded;
        if self.other.max(loaded) <= since {
            return None;
        }
        let reference = own.map_or(Reference::default(), |(_, standing)| standing.reference);
        let is_offered = reference != Reference::default();
        // Without a record of its load it came with an image, or the power went at that moment.
        let is_changed = if loaded > since { is_unattended } else { true };
        Some(Standing { reference, is_offered, is_changed })
    }
}

impl<F: NorFlash> References<F> {
    /// Reads all of the flash. A slot that cannot be read counts as damaged.
    pub fn open(flash: F, calibration: u32) -> (Self, Found) {
        Self::open_in_parts(flash, calibration, || ())
    }

    /// Reads all of the flash, as [`Self::open`]. `between` is called at each record, because two full sectors may take
    /// longer than a watchdog waits.
    pub fn open_in_parts(flash: F, calibration: u32, mut between: impl FnMut()) -> (Self, Found) {
        let mut found = Found::default();
        let (mut half, mut named, mut taken) = (None, None, None);
        let mut oldest_first = [None; writes::KEPT];
        let (mut only, mut only_named) = (Only::default(), Only::default());
        let (mut only_taken, mut events) = (Only::default(), Events::default());
        let log = Log::open(flash, SLOT_SIZE, |flash, slot| {
            between();
            let mut bytes = [0; RECORD_SIZE];
            let is_read = flash.read(slot.address, &mut bytes).is_ok();
            if let Some(write) = is_read.then(|| decode_write(&bytes)).flatten() {
                if write.what == WriteKind::Named {
                    only_named.note(slot.half);
                    note_newest(&mut named, write, slot.half);
                } else if takes_reference(write.what) && write.calibration == calibration {
                    only_taken.note(slot.half);
                    note_newest(&mut taken, write, slot.half);
                }
                events.note(calibration, &write);
                insert(&mut oldest_first, write);
                return Some(write.sequence);
            }
            let Some(record) = is_read.then(|| Record::decode(&bytes)).flatten() else {
                found.damaged = found.damaged.saturating_add(1);
                return None;
            };
            events.ran(calibration, record.calibration, record.sequence);
            if record.calibration != calibration {
                found.foreign = found.foreign.saturating_add(1);
                return Some(record.sequence);
            }
            only.note(slot.half);
            if found.standing.is_none_or(|(newest, _)| record.sequence > newest) {
                found.standing = Some((record.sequence, record.standing));
                found.supply = record.supply;
                half = Some(slot.half);
            }
            Some(record.sequence)
        });
        let mut current = found.standing.map(|(_, standing)| (standing, half));
        // Without a calibration nothing holds.
        if calibration != 0
            && let Some(standing) = events.change(found.standing)
        {
            let sequence = found.standing.map_or(0, |(sequence, _)| sequence);
            found.standing = Some((sequence, standing));
            found.is_new = true;
            current = Some((standing, None));
        }
        found.named = named.map(|(write, _)| write.about);
        found.taken = taken.map(|(write, _)| write);
        let mut writes = Writes::default();
        oldest_first.iter().flatten().for_each(|write| writes.push(write));
        let supply = found.supply;
        let references = Self {
            log,
            calibration,
            current,
            named,
            taken,
            writes,
            supply,
            only,
            only_named,
            only_taken,
        };
        (references, found)
    }

    /// Returns the last writes that were found at the start.
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
        if stored.what == WriteKind::Named {
            self.named = Some((stored, slot.half));
            self.only_named = Only::default();
        } else if takes_reference(stored.what) && stored.calibration == self.calibration {
            self.taken = Some((stored, slot.half));
            self.only_taken = Only::default();
        }
        Ok(stored)
    }

    /// Records from now on say that their references count from this level of the supply.
    pub fn set_supply(&mut self, supply: Level) {
        self.supply = supply;
    }

    /// Appends what holds for the calibration from now on; gives the sequence number of its record.
    ///
    /// # Errors
    /// [`StoreError`]; what was stored before still counts.
    pub fn append(&mut self, standing: Standing) -> Result<u32, StoreError> {
        let (calibration, supply) = (self.calibration, self.supply);
        let (sequence, slot) = self.log.append(ATTEMPTS, |flash, slot, sequence| {
            write_part(
                flash,
                slot.address,
                &Record { sequence, calibration, standing, supply }.encode(),
            )
        })?;
        self.current = Some((standing, Some(slot.half)));
        self.only = Only::default();
        Ok(sequence)
    }

    /// Stores what the start has found and no record says yet, and empties the half that is not written to, if it
    /// is not empty: records go on there when the other one is full. Gives whether it had to. The erase may stall
    /// the core for seconds: this is for a moment when nothing is followed.
    ///
    /// # Errors
    /// [`StoreError`]; what is stored still counts.
    pub fn make_room(&mut self) -> Result<bool, StoreError> {
        // What still counts moves on before its half goes, and is written anew where it would be left
        // alone: a power cut may have torn it. Where there is no room for it, after.
        let (active, has_spare) = (self.log.active(), self.log.has_spare_content());
        let moves = |half: Half, only: Only| half != active || has_spare && only.is_in(active);
        let standing =
            self.current.filter(|(_, half)| half.is_none_or(|half| moves(half, self.only)));
        let mut standing = standing.map(|(standing, _)| standing);
        let named = self.named.filter(|(_, half)| moves(*half, self.only_named));
        let taken = self.taken.filter(|(_, half)| moves(*half, self.only_taken));
        let mut writes = [named, taken].map(|write| write.map(|(write, _)| write));
        if self.log.has_room()
            && let Some(standing) = standing.take()
        {
            self.append(standing)?;
        }
        for write in &mut writes {
            if self.log.has_room()
                && let Some(write) = write.take()
            {
                self.append_write(&write)?;
            }
        }
        let emptied = self.log.make_room()?;
        if let Some(standing) = standing {
            self.append(standing)?;
        }
        for write in writes.into_iter().flatten() {
            self.append_write(&write)?;
        }
        Ok(emptied)
    }
}

/// Returns whether a write says where the reference comes from.
const fn takes_reference(what: WriteKind) -> bool {
    matches!(what, WriteKind::Zeroed | WriteKind::Offered)
}

/// Keeps the newer one.
fn note_newest(newest: &mut Option<(Write, Half)>, write: Write, half: Half) {
    if newest.is_none_or(|(other, _)| write.sequence > other.sequence) {
        *newest = Some((write, half));
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
mod standing_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod write_tests;
