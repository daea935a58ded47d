//! Who writes to the board: each write is noted with its time and line, for the board to store, and reported by
//! object 0x2110. And whether the calibration is of this machine and this board.

use heapless::Deque;
use trueup_canopen::emergency::Fault;
use trueup_core::{calibration::Names, units::Millis};
use trueup_store::{
    calibration,
    writes::{self, Origin, Write, WriteKind, Writes},
};

use super::{Interface, Node};

/// Writes that the board has not stored yet: it stores one in 50 ms (`trueup_store::pace`), and each needs an operator or a tool.
const WAITING: usize = 4;

/// The writes of a node.
#[derive(Debug, Default)]
pub(super) struct Log {
    last: Writes,
    waiting: Deque<Write, WAITING>,
    /// Where the last SDO request came from, and that which has ended a load.
    speaker: Option<Interface>,
    loader: Option<Interface>,
    /// No CNC was received at the end of that load.
    is_unattended: bool,
    /// The time of day that was reported, and when.
    utc: Option<(u32, Millis)>,
}

impl Log {
    pub(crate) fn speaks(&mut self, line: Interface) {
        self.speaker = Some(line);
    }

    pub const fn speaker(&self) -> Option<Interface> {
        self.speaker
    }

    pub fn loads(&mut self, is_unattended: bool) {
        (self.loader, self.is_unattended) = (self.speaker, is_unattended);
    }

    pub fn bytes(&self) -> &[u8] {
        self.last.bytes()
    }
}

impl Node<'_> {
    /// Sets the writes that the board has stored before the start.
    pub fn set_writes(&mut self, writes: Writes) {
        self.log.last = writes;
    }

    /// Returns a write that is to be stored, once; [`Self::end_write`] is to follow.
    pub fn take_write(&mut self) -> Option<Write> {
        self.log.waiting.pop_front()
    }

    /// Logs a write as it is `stored`, with its number; `None`: it is not.
    pub fn end_write(&mut self, write: &Write, stored: Option<Write>) {
        if stored.is_none() {
            self.set_fault(Fault::Store);
        }
        self.log.last.push(&stored.unwrap_or(*write));
    }

    /// Compares the names in the calibration with those that the board belongs to, as
    /// [`writes::identity`] has them, and with the number of its chip. A board without names takes the
    /// first; for any other machine, or a calibration of another board, the operator is asked. To be
    /// called at the start, for a calibration that is not an example's.
    pub fn check_identity(&mut self, named: Option<u32>, chip: [u32; 3]) {
        let names = self.names();
        let identity = writes::identity(&names);
        let is_of_another_board = names.board != [0; 3] && names.board != chip;
        match named {
            _ if identity == 0 => {}
            Some(named) if named == identity => {}
            None if !is_of_another_board => self.name(None),
            _ => self.require_confirmation(Fault::ForeignMachine),
        }
    }

    /// The board belongs to the machine of its calibration from now on.
    pub(super) fn name(&mut self, line: Option<Interface>) {
        let identity = writes::identity(&self.names());
        self.log(WriteKind::Named, identity, line);
    }

    /// Returns the machine and the board that the running calibration is for.
    pub(super) fn names(&self) -> Names<'_> {
        self.bridge.as_ref().map(|it| it.calibration().names).unwrap_or_default()
    }

    /// Seconds since 1970; 0: the time was never set.
    pub(super) fn utc_s(&self) -> u32 {
        let Some((utc_s, at)) = self.log.utc else { return 0 };
        utc_s.saturating_add(self.now.since(at) / 1_000)
    }

    pub(super) fn set_utc_s(&mut self, utc_s: u32) {
        self.log.utc = (utc_s > 0).then_some((utc_s, self.now));
    }

    /// A calibration is stored for the next start. If it replaces one other than the example's while no CNC is
    /// received, the operator is asked then.
    pub(super) fn log_load(&mut self, crc: u32) {
        let running = self.running_crc();
        let replaces = running != 0 && running != crc && !self.is_example();
        let write = self.new_write(WriteKind::Loaded, crc, self.log.loader);
        self.push(Write { is_unattended: replaces && self.log.is_unattended, ..write });
    }

    /// Notes a write over a line, or of the board itself.
    pub(super) fn log(&mut self, what: WriteKind, about: u32, line: Option<Interface>) {
        self.push(self.new_write(what, about, line));
    }

    /// Returns a write of this moment.
    pub(super) fn new_write(&self, what: WriteKind, about: u32, line: Option<Interface>) -> Write {
        let origin = match line {
            None => Origin::Board,
            Some(Interface::Can) => Origin::Can,
            Some(Interface::Serial) => Origin::Serial,
            Some(Interface::Modbus) => Origin::Modbus,
        };
        let (calibration, at_ms, utc_s) = (self.running_crc(), self.now.0, self.utc_s());
        let (sequence, is_unattended) = (0, false);
        Write { sequence, calibration, about, at_ms, utc_s, what, origin, is_unattended }
    }

    /// Returns the calibration that runs, by the CRC of its blob; 0: none.
    pub(super) fn running_crc(&self) -> u32 {
        if self.blob.is_empty() { 0 } else { calibration::identity(self.blob) }
    }

    /// Hands a write to the board, which stores it.
    pub(super) fn push(&mut self, write: Write) {
        if self.log.waiting.push_back(write).is_err() {
            // The board does not store: it is reported all the same.
            self.log.last.push(&write);
        }
    }
}
