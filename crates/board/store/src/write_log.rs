//! The log of writes to the board, their time and line; it outlasts the power.
//!
//! A write is reported by the node (RAM, and object 0x2110) and kept in the flash, together with the references
//! ([`crate::reference`]), in a slot of the same 32 bytes:
//!
//! | offset | a record, little-endian | unit |
//! |---|---|---|
//! | 0 | `u32` sequence number, over references and writes | |
//! | 4 | `u32` the calibration that ran: the CRC of its blob; 0: none | |
//! | 8 | `u32` what it was about, see [`WriteKind`] | |
//! | 12 | `u32` time since the start of the board | ms |
//! | 16 | `u32` time of day; 0: not set | s since 1970, UTC |
//! | 20 | `u8` what, `u8` line (0 the board itself, 1 CAN, 2 serial, 3 Modbus), `u8` 1: no CNC was received, 0 | |
//! | 24 | `u32` layout, 2 | |
//! | 28 | CRC-32/AUTOSAR of the 28 bytes before it | |
//!
//! The object has the first 24 bytes of each, the oldest of the last `WRITE_LOG_CAPACITY` first.

use trueup_core::calibration::MachineIdentity;

use crate::crc;

/// Bytes of a write in the object.
pub const RECORD_SIZE: usize = 24;
/// Writes that the object holds.
pub(crate) const WRITE_LOG_CAPACITY: usize = 16;
/// The layout of a record of a write.
pub(crate) const LAYOUT_VERSION: u32 = 2;

/// The kind of a write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum WriteKind {
    /// A calibration; about: its CRC.
    Loaded = 1,
    /// `Zero` has taken a reference; about: its elongation in nm, as `i32`.
    Zeroed,
    /// The reference was forgotten.
    Forgotten,
    /// The operator has answered a question; about: the number of the fault that required confirmation.
    Confirmed,
    /// The board belongs to another machine from now on; about: [`machine_identity_crc`] of its names.
    Named,
    /// A reference from a saved file is offered to the operator; about: its elongation in nm, as `i32`.
    Offered,
    /// A calibration that was to be used from the next start is dropped; about: its CRC.
    Cancelled,
}

impl WriteKind {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Loaded,
        Self::Zeroed,
        Self::Forgotten,
        Self::Confirmed,
        Self::Named,
        Self::Offered,
        Self::Cancelled,
    ];

    /// In a word.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Loaded => "loaded",
            Self::Zeroed => "zeroed",
            Self::Forgotten => "forgotten",
            Self::Confirmed => "confirmed",
            Self::Named => "named",
            Self::Offered => "offered",
            Self::Cancelled => "cancelled",
        }
    }
}

/// Where a write came from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum WriteOrigin {
    /// The board itself.
    #[default]
    Board = 0,
    /// The CAN bus.
    Can,
    /// The serial line.
    Serial,
    /// Modbus on the RS-485 line.
    Modbus,
}

impl WriteOrigin {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Board, Self::Can, Self::Serial, Self::Modbus];

    /// In a word.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Board => "board",
            Self::Can => "can",
            Self::Serial => "serial",
            Self::Modbus => "modbus",
        }
    }
}

/// One write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriteRecord {
    /// Its number in the store; 0: it is not stored.
    pub sequence: u32,
    /// The calibration that ran, by the CRC of its blob; 0: none.
    pub calibration: u32,
    /// Its subject, see [`WriteKind`].
    pub about: u32,
    /// Milliseconds since the start of the board.
    pub at_ms: u32,
    /// Seconds since 1970 (UTC); 0: the time of the board was not set.
    pub utc_s: u32,
    /// Its kind.
    pub what: WriteKind,
    /// Where it came from.
    pub origin: WriteOrigin,
    /// It changes the calibration that will run, and no CNC was received meanwhile.
    pub is_unattended: bool,
}

impl WriteRecord {
    /// Returns the bytes of the object.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; RECORD_SIZE] {
        let mut bytes = [0; RECORD_SIZE];
        let kind = u32::from(self.what as u8)
            | u32::from(self.origin as u8) << 8
            | u32::from(self.is_unattended) << 16;
        let words = [self.sequence, self.calibration, self.about, self.at_ms, self.utc_s, kind];
        for (place, word) in bytes.as_chunks_mut().0.iter_mut().zip(words) {
            *place = word.to_le_bytes();
        }
        bytes
    }

    /// Returns the write in the bytes of the object; `None`: of another version.
    #[must_use]
    pub fn from_bytes(bytes: &[u8; RECORD_SIZE]) -> Option<Self> {
        let &[sequence, calibration, about, at_ms, utc_s, [what, origin, unattended, ..]] =
            bytes.as_chunks::<4>().0
        else {
            return None;
        };
        let [sequence, calibration, about, at_ms, utc_s] =
            [sequence, calibration, about, at_ms, utc_s].map(u32::from_le_bytes);
        let what = WriteKind::ALL.into_iter().find(|kind| *kind as u8 == what)?;
        let origin = WriteOrigin::ALL.into_iter().find(|candidate| *candidate as u8 == origin)?;
        let is_unattended = unattended & 1 != 0;
        Some(Self { sequence, calibration, about, at_ms, utc_s, what, origin, is_unattended })
    }
}

/// The last writes, as the object has them.
#[derive(Clone, Debug)]
pub struct WriteLog {
    bytes: [u8; RECORD_SIZE * WRITE_LOG_CAPACITY],
    length: usize,
}

impl Default for WriteLog {
    fn default() -> Self {
        Self { bytes: [0; _], length: 0 }
    }
}

impl WriteLog {
    /// Adds one; the oldest gives way.
    pub fn push(&mut self, write: &WriteRecord) {
        if self.length == self.bytes.len() {
            self.bytes.copy_within(RECORD_SIZE.., 0);
            self.length = self.length.saturating_sub(RECORD_SIZE);
        }
        let end = self.length.saturating_add(RECORD_SIZE);
        if let Some(place) = self.bytes.get_mut(self.length..end) {
            place.iter_mut().zip(write.to_bytes()).for_each(|(place, byte)| *place = byte);
            self.length = end;
        }
    }

    /// Returns the bytes of the object, the oldest write first.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or_default()
    }
}

/// Returns the identity of the names of a machine and a board; 0: the calibration names neither.
#[must_use]
pub fn machine_identity_crc(names: &MachineIdentity<'_>) -> u32 {
    let MachineIdentity { machine, serial, board } = *names;
    if machine.is_empty() && serial.is_empty() && board == [0; 3] {
        return 0;
    }
    let mut digest = crc::digest();
    // Between them what is in no text, so that a name cannot run into a number.
    for part in [machine, &[0xFF], serial, &[0xFF]] {
        digest.update(part);
    }
    board.iter().for_each(|word| digest.update(&word.to_le_bytes()));
    digest.finalize().max(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn write(sequence: u32) -> WriteRecord {
        let what = WriteKind::ALL[sequence as usize % WriteKind::ALL.len()];
        let origin = WriteOrigin::ALL[sequence as usize % WriteOrigin::ALL.len()];
        let about = sequence.wrapping_mul(0x0101_0101);
        WriteRecord {
            sequence,
            calibration: 7,
            about,
            at_ms: 1_000,
            utc_s: 1_790_000_000,
            what,
            origin,
            is_unattended: sequence.is_multiple_of(3),
        }
    }

    #[test]
    fn the_last_writes_are_reported_the_oldest_first() {
        let mut writes = WriteLog::default();
        assert_eq!(writes.as_bytes(), [0; 0]);
        for sequence in 1..=40 {
            writes.push(&write(sequence));
            let records: Vec<_> = writes
                .as_bytes()
                .as_chunks()
                .0
                .iter()
                .filter_map(WriteRecord::from_bytes)
                .collect();
            let first = sequence.saturating_sub(WRITE_LOG_CAPACITY as u32) + 1;
            assert_eq!(records, (first..=sequence).map(write).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_write_of_another_version_is_none() {
        let mut bytes = write(3).to_bytes();
        assert_eq!(WriteRecord::from_bytes(&bytes), Some(write(3)));
        bytes[21] = 4;
        assert_eq!(WriteRecord::from_bytes(&bytes), None);
        bytes[21] = 0;
        bytes[20] = 8;
        assert_eq!(WriteRecord::from_bytes(&bytes), None);
    }

    #[test]
    fn names_that_differ_anywhere_have_another_identity_and_no_names_have_none() {
        let names = |machine: &'static str, serial: &'static str, board| MachineIdentity {
            machine: machine.as_bytes(),
            serial: serial.as_bytes(),
            board,
        };
        assert_eq!(machine_identity_crc(&MachineIdentity::default()), 0);
        let all = [
            names("gantry", "", [0; 3]),
            names("gantr", "y", [0; 3]),
            names("", "gantry", [0; 3]),
            names("gantry", "1", [0; 3]),
            names("gantry", "1", [1, 0, 0]),
            names("gantry", "1", [0, 0, 1]),
        ];
        let mut identities: Vec<_> = all.iter().map(machine_identity_crc).collect();
        identities.sort_unstable();
        identities.dedup();
        assert_eq!(identities.len(), all.len());
    }

    #[test]
    fn a_program_reads_what_was_written_and_over_which_line_by_these_words() {
        let words = ["loaded", "zeroed", "forgotten", "confirmed", "named", "offered", "cancelled"];
        assert_eq!(WriteKind::ALL.map(WriteKind::as_str), words);
        assert_eq!(WriteOrigin::ALL.map(WriteOrigin::as_str), ["board", "can", "serial", "modbus"]);
    }
}
