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
//! Between them lie the [writes](crate::write_log), with a layout of their own.
//!
//! A record is written from its first byte to its last, and its CRC comes last, as `log` demands.
//!
//! **In force or offered.** A reference is in force after a start if nothing newer says that its calibration was
//! loaded again, or that another one ran meanwhile. Otherwise the calibration starts without a reference, and the
//! older one is offered: tools may have been touched off with another one since. The first start after such a
//! change stores what it has found ([`ReferenceStore::erase_spare_half`]), so that later starts find it in one record.
//! Records of firmware before 0.3 have no marks: theirs are in force, or offered by the same rule.

use embedded_storage::nor_flash::NorFlash;
use trueup_core::{
    bridge::ReferenceErrors,
    supply_monitor::InternalReferenceLevel,
    units::{FineNanometres, Nanometres},
};

use crate::{
    crc,
    flash_log::{FlashLog, LogHalf, RecordCounts, StoreError, write_and_verify},
    write_log::{self, WriteKind, WriteLog, WriteRecord},
};

/// Bytes of a slot, which a record fills.
const SLOT_SIZE: u32 = 32;
/// Bytes of a record.
pub const RECORD_SIZE: usize = SLOT_SIZE as usize;
/// The layout described here.
const LAYOUT_VERSION: u8 = 1;
/// The marks.
const OFFERED_FLAG: u8 = 1 << 0;
const CHANGED_FLAG: u8 = 1 << 1;
/// How many slots are tried for one record.
const MAX_WRITE_ATTEMPTS: u32 = 3;

type RecordBytes = [u8; RECORD_SIZE];

/// The state of a calibration: its reference, and the operator's answers that are missing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReferenceStatus {
    /// The reference.
    pub reference: ReferenceErrors,
    /// It is not in force: it waits for the operator's answer.
    pub is_offered: bool,
    /// The calibration was changed while no CNC was received, and the operator has not confirmed it.
    pub is_changed: bool,
}

impl ReferenceStatus {
    /// Returns a reference that is in force, with nothing open.
    #[must_use]
    pub const fn in_force(reference: ReferenceErrors) -> Self {
        Self { reference, is_offered: false, is_changed: false }
    }
}

/// One record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ReferenceRecord {
    sequence: u32,
    calibration: u32,
    standing: ReferenceStatus,
    supply: InternalReferenceLevel,
}

impl ReferenceRecord {
    fn encode(&self) -> RecordBytes {
        let ReferenceStatus { reference, is_offered, is_changed } = self.standing;
        let ReferenceErrors { elongation, axes: [x, y, z] } = reference;
        let [elongation, x, y, z] = [elongation.0, x.0, y.0, z.0].map(i32::cast_unsigned);
        let mut marks = if is_offered { OFFERED_FLAG } else { 0 };
        if is_changed {
            marks |= CHANGED_FLAG;
        }
        let [low, high] = self.supply.0.to_le_bytes();
        let layout = u32::from_le_bytes([LAYOUT_VERSION, marks, low, high]);
        let words = [self.sequence, self.calibration, elongation, x, y, z, layout];
        let mut bytes = [0; RECORD_SIZE];
        for (place, word) in bytes.as_chunks_mut().0.iter_mut().zip(words) {
            *place = word.to_le_bytes();
        }
        crc::write_crc(&mut bytes);
        bytes
    }

    /// `None`: these bytes are no record.
    fn decode(bytes: &RecordBytes) -> Option<Self> {
        let &[sequence, calibration, elongation, x, y, z, layout] =
            crc::verify_and_strip_crc(bytes)?.as_chunks().0
        else {
            return None;
        };
        let [LAYOUT_VERSION, marks, supply_low, supply_high] = layout else { return None };
        let reference = ReferenceErrors {
            elongation: Nanometres(i32::from_le_bytes(elongation)),
            axes: [x, y, z].map(|axis| FineNanometres(i32::from_le_bytes(axis))),
        };
        let (is_offered, is_changed) = (marks & OFFERED_FLAG != 0, marks & CHANGED_FLAG != 0);
        (marks & !(OFFERED_FLAG | CHANGED_FLAG) == 0).then(|| Self {
            sequence: u32::from_le_bytes(sequence),
            calibration: u32::from_le_bytes(calibration),
            standing: ReferenceStatus { reference, is_offered, is_changed },
            supply: InternalReferenceLevel(u16::from_le_bytes([supply_low, supply_high])),
        })
    }
}

/// Returns the bytes of a write.
fn encode_write(write: &WriteRecord) -> RecordBytes {
    let mut bytes = [0; RECORD_SIZE];
    let words = write.to_bytes().into_iter().chain(write_log::LAYOUT_VERSION.to_le_bytes());
    bytes.iter_mut().zip(words).for_each(|(place, byte)| *place = byte);
    crc::write_crc(&mut bytes);
    bytes
}

/// `None`: these bytes are no write.
fn decode_write(bytes: &RecordBytes) -> Option<WriteRecord> {
    let (write, layout) = crc::verify_and_strip_crc(bytes)?.split_first_chunk()?;
    (layout == write_log::LAYOUT_VERSION.to_le_bytes())
        .then(|| WriteRecord::from_bytes(write))
        .flatten()
}

/// The records found in the flash.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ScanResult {
    /// The newest record of this calibration: its sequence number, and what holds now by it and by what came
    /// after it.
    pub standing: Option<(u32, ReferenceStatus)>,
    /// Something holds that no record says yet.
    pub is_new: bool,
    /// The write that has taken or offered the reference.
    pub taken: Option<WriteRecord>,
    /// The machine and the board that the board belongs to: [`machine_identity_crc`](crate::write_log::machine_identity_crc) of their names.
    pub named: Option<u32>,
    /// The level of the supply that it counts from.
    pub supply: InternalReferenceLevel,
    /// Records of other calibrations.
    pub foreign: u32,
    /// Slots that hold something, but no record.
    pub damaged: u32,
}

/// The stored references, open for one calibration.
#[derive(Debug)]
pub struct ReferenceStore<F> {
    log: FlashLog<F>,
    calibration: u32,
    /// The state of this calibration, and the half that its record is in; `None`: it is not stored yet.
    current: Option<(ReferenceStatus, Option<LogHalf>)>,
    /// The write that has named the board's machine, and the half that it is in.
    named: Option<(WriteRecord, LogHalf)>,
    /// The same of the one that has taken or offered the reference.
    taken: Option<(WriteRecord, LogHalf)>,
    writes: WriteLog,
    /// Goes into every record.
    supply: InternalReferenceLevel,
    /// Of the records that were found at the start, and of both writes.
    only: RecordCounts,
    only_named: RecordCounts,
    only_taken: RecordCounts,
}

/// The events of a calibration, by the sequence numbers of the records that say so; 0: none does.
#[derive(Default)]
struct CalibrationEvents {
    /// The newest time at which another calibration ran.
    other: u32,
    /// The newest load of this one, unless it was dropped again, and whether it was unattended.
    loaded: (u32, bool),
}

impl CalibrationEvents {
    fn record_run(&mut self, calibration: u32, by: u32, sequence: u32) {
        if by != 0 && by != calibration {
            self.other = self.other.max(sequence);
        }
    }

    fn record_write(&mut self, calibration: u32, write: &WriteRecord) {
        // The names move on under whichever calibration runs then.
        if write.what != WriteKind::Named {
            self.record_run(calibration, write.calibration, write.sequence);
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
    fn status_if_changed(&self, own: Option<(u32, ReferenceStatus)>) -> Option<ReferenceStatus> {
        let since = own.map_or(0, |(sequence, _)| sequence);
        let (loaded, is_unattended) = self.loaded;
        if self.other.max(loaded) <= since {
            return None;
        }
        let reference = own.map_or(ReferenceErrors::default(), |(_, standing)| standing.reference);
        let is_offered = reference != ReferenceErrors::default();
        // Without a record of its load it came with an image, or the power went at that moment.
        let is_changed = if loaded > since { is_unattended } else { true };
        Some(ReferenceStatus { reference, is_offered, is_changed })
    }
}

impl<F: NorFlash> ReferenceStore<F> {
    /// Reads all of the flash. A slot that cannot be read counts as damaged.
    pub fn open(flash: F, calibration: u32) -> (Self, ScanResult) {
        Self::open_with_progress(flash, calibration, || ())
    }

    /// Reads all of the flash, as [`Self::open`]. `between` is called at each record, because two full sectors may take
    /// longer than a watchdog waits.
    pub fn open_with_progress(
        flash: F,
        calibration: u32,
        mut between: impl FnMut(),
    ) -> (Self, ScanResult) {
        let mut found = ScanResult::default();
        let (mut half, mut named, mut taken) = (None, None, None);
        let mut oldest_first = [None; write_log::WRITE_LOG_CAPACITY];
        let (mut only, mut only_named) = (RecordCounts::default(), RecordCounts::default());
        let (mut only_taken, mut events) = (RecordCounts::default(), CalibrationEvents::default());
        let log = FlashLog::open(flash, SLOT_SIZE, |flash, slot| {
            between();
            let mut bytes = [0; RECORD_SIZE];
            let is_read = flash.read(slot.address, &mut bytes).is_ok();
            if let Some(write) = is_read.then(|| decode_write(&bytes)).flatten() {
                if write.what == WriteKind::Named {
                    only_named.count_record(slot.half);
                    update_if_newer(&mut named, write, slot.half);
                } else if is_reference_write(write.what) && write.calibration == calibration {
                    only_taken.count_record(slot.half);
                    update_if_newer(&mut taken, write, slot.half);
                }
                events.record_write(calibration, &write);
                insert_record_by_sequence(&mut oldest_first, write);
                return Some(write.sequence);
            }
            let Some(record) = is_read.then(|| ReferenceRecord::decode(&bytes)).flatten() else {
                found.damaged = found.damaged.saturating_add(1);
                return None;
            };
            events.record_run(calibration, record.calibration, record.sequence);
            if record.calibration != calibration {
                found.foreign = found.foreign.saturating_add(1);
                return Some(record.sequence);
            }
            only.count_record(slot.half);
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
            && let Some(standing) = events.status_if_changed(found.standing)
        {
            let sequence = found.standing.map_or(0, |(sequence, _)| sequence);
            found.standing = Some((sequence, standing));
            found.is_new = true;
            current = Some((standing, None));
        }
        found.named = named.map(|(write, _)| write.about);
        found.taken = taken.map(|(write, _)| write);
        let mut writes = WriteLog::default();
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
    pub const fn last_writes(&self) -> &WriteLog {
        &self.writes
    }

    /// Appends a write; gives it with its sequence number.
    ///
    /// # Errors
    /// [`StoreError`]; what was stored before still counts.
    pub fn append_write(&mut self, write: &WriteRecord) -> Result<WriteRecord, StoreError> {
        let (sequence, slot) = self.log.append(MAX_WRITE_ATTEMPTS, |flash, slot, sequence| {
            write_and_verify(
                flash,
                slot.address,
                &encode_write(&WriteRecord { sequence, ..*write }),
            )
        })?;
        let stored = WriteRecord { sequence, ..*write };
        if stored.what == WriteKind::Named {
            self.named = Some((stored, slot.half));
            self.only_named = RecordCounts::default();
        } else if is_reference_write(stored.what) && stored.calibration == self.calibration {
            self.taken = Some((stored, slot.half));
            self.only_taken = RecordCounts::default();
        }
        Ok(stored)
    }

    /// Records from now on say that their references count from this level of the supply.
    pub fn set_supply_baseline_level(&mut self, supply: InternalReferenceLevel) {
        self.supply = supply;
    }

    /// Appends what holds for the calibration from now on; gives the sequence number of its record.
    ///
    /// # Errors
    /// [`StoreError`]; what was stored before still counts.
    pub fn append(&mut self, standing: ReferenceStatus) -> Result<u32, StoreError> {
        let (calibration, supply) = (self.calibration, self.supply);
        let (sequence, slot) = self.log.append(MAX_WRITE_ATTEMPTS, |flash, slot, sequence| {
            write_and_verify(
                flash,
                slot.address,
                &ReferenceRecord { sequence, calibration, standing, supply }.encode(),
            )
        })?;
        self.current = Some((standing, Some(slot.half)));
        self.only = RecordCounts::default();
        Ok(sequence)
    }

    /// Stores what the start has found and no record says yet, and empties the half that is not written to, if it
    /// is not empty: records go on there when the other one is full. Gives whether it had to. The erase may stall
    /// the core for seconds: this is for a moment when nothing is followed.
    ///
    /// # Errors
    /// [`StoreError`]; what is stored still counts.
    pub fn erase_spare_half(&mut self) -> Result<bool, StoreError> {
        // What still counts moves on before its half goes, and is written anew where it would be left
        // alone: a power cut may have torn it. Where there is no room for it, after.
        let (active, has_spare) = (self.log.active_half(), self.log.is_spare_half_used());
        let moves = |half: LogHalf, only: RecordCounts| {
            half != active || has_spare && only.has_sole_record_in(active)
        };
        let standing =
            self.current.filter(|(_, half)| half.is_none_or(|half| moves(half, self.only)));
        let mut standing = standing.map(|(standing, _)| standing);
        let named = self.named.filter(|(_, half)| moves(*half, self.only_named));
        let taken = self.taken.filter(|(_, half)| moves(*half, self.only_taken));
        let mut writes = [named, taken].map(|write| write.map(|(write, _)| write));
        if self.log.has_free_slot()
            && let Some(standing) = standing.take()
        {
            self.append(standing)?;
        }
        for write in &mut writes {
            if self.log.has_free_slot()
                && let Some(write) = write.take()
            {
                self.append_write(&write)?;
            }
        }
        let emptied = self.log.erase_spare_half()?;
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
const fn is_reference_write(what: WriteKind) -> bool {
    matches!(what, WriteKind::Zeroed | WriteKind::Offered)
}

/// Keeps the newer one.
fn update_if_newer(newest: &mut Option<(WriteRecord, LogHalf)>, write: WriteRecord, half: LogHalf) {
    if newest.is_none_or(|(other, _)| write.sequence > other.sequence) {
        *newest = Some((write, half));
    }
}

/// Keeps the newest, the oldest first, whatever order they come in.
fn insert_record_by_sequence(
    all: &mut [Option<WriteRecord>; write_log::WRITE_LOG_CAPACITY],
    mut write: WriteRecord,
) {
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
