//! Who writes to the board: each write is noted with its time and line, for the board to store, and reported by
//! object 0x2110. And whether the calibration is of this machine and this board.

use heapless::Deque;
use trueup_canopen::emergency::Fault;
use trueup_core::{calibration::MachineIdentity, units::TimestampMs};
use trueup_store::{
    calibration,
    write_log::{WriteKind, WriteLog, WriteOrigin, WriteRecord},
};

use super::{Interface, Node};

/// Writes that the board has not stored yet: it stores one in 50 ms (`trueup_store::pace`), and each needs an operator or a tool.
const MAX_PENDING_WRITES: usize = 4;

/// The writes of a node.
#[derive(Debug, Default)]
pub(super) struct WriteJournal {
    last: WriteLog,
    waiting: Deque<WriteRecord, MAX_PENDING_WRITES>,
    /// Where the last SDO request came from, and that which has ended a load.
    sender: Option<Interface>,
    loader: Option<Interface>,
    /// No CNC was received at the end of that load.
    is_unattended: bool,
    /// The time of day that was reported, and when.
    utc: Option<(u32, TimestampMs)>,
}

impl WriteJournal {
    /// Those that the board has stored before the start.
    pub(crate) fn from_stored(stored: WriteLog) -> Self {
        Self { last: stored, ..Self::default() }
    }

    pub(crate) fn set_request_interface(&mut self, line: Interface) {
        self.sender = Some(line);
    }

    pub(crate) const fn request_interface(&self) -> Option<Interface> {
        self.sender
    }

    pub(crate) fn set_load_origin(&mut self, is_unattended: bool) {
        (self.loader, self.is_unattended) = (self.sender, is_unattended);
    }

    pub fn as_bytes(&self) -> &[u8] {
        self.last.as_bytes()
    }
}

impl Node<'_> {
    /// Returns a write that is to be stored, once; [`Self::finish_write`] is to follow.
    pub fn take_pending_write(&mut self) -> Option<WriteRecord> {
        self.log.waiting.pop_front()
    }

    /// Logs a write; `stored`: what was stored, with its number; `None`: it is not stored.
    pub fn finish_write(&mut self, write: &WriteRecord, stored: Option<WriteRecord>) {
        if stored.is_none() {
            self.set_fault(Fault::Store);
        }
        self.log.last.push(&stored.unwrap_or(*write));
    }

    /// Compares the names in the calibration with those that the board belongs to, as
    /// [`machine_identity_crc`](trueup_store::write_log::machine_identity_crc) has them, and with the number of its chip. A board without names takes the
    /// first; for any other machine, or a calibration of another board, the operator must confirm. To be
    /// called at the start, for a calibration that is not an example's.
    pub fn check_identity(&mut self, named: Option<u32>, chip: [u32; 3]) {
        let (names, identity) = (self.machine_identity(), self.identity);
        let is_of_another_board = names.board != [0; 3] && names.board != chip;
        match named {
            _ if identity == 0 => {}
            Some(named) if named == identity => {}
            None if !is_of_another_board => self.adopt_machine_identity(None),
            _ => self.require_confirmation(Fault::ForeignMachine),
        }
    }

    /// The board belongs to the machine of its calibration from now on.
    pub(super) fn adopt_machine_identity(&mut self, line: Option<Interface>) {
        self.log_write(WriteKind::Named, self.identity, line);
    }

    /// Returns the machine and the board that the running calibration is for.
    pub(super) fn machine_identity(&self) -> MachineIdentity<'_> {
        self.bridge.as_ref().map(|bridge| bridge.calibration().names).unwrap_or_default()
    }

    /// Seconds since 1970; 0: the time was never set.
    pub(super) fn utc_s(&self) -> u32 {
        let Some((utc_s, at)) = self.log.utc else { return 0 };
        utc_s.saturating_add(self.now.duration_ms_since(at) / 1_000)
    }

    pub(super) fn set_utc_s(&mut self, utc_s: u32) {
        self.log.utc = (utc_s > 0).then_some((utc_s, self.now));
    }

    /// A calibration is stored for the next start. If it replaces one other than the example's while no CNC is
    /// received, the operator must confirm then.
    pub(super) fn log_calibration_load(&mut self, crc: u32) {
        let running = self.running_calibration_crc();
        let replaces = running != 0 && running != crc && !self.has_example_constants();
        let write = self.new_write_record(WriteKind::Loaded, crc, self.log.loader);
        self.push_write(WriteRecord { is_unattended: replaces && self.log.is_unattended, ..write });
    }

    /// Notes a write over a line, or of the board itself.
    pub(super) fn log_write(&mut self, what: WriteKind, about: u32, line: Option<Interface>) {
        self.push_write(self.new_write_record(what, about, line));
    }

    /// Returns a write of this moment.
    pub(super) fn new_write_record(
        &self,
        what: WriteKind,
        about: u32,
        line: Option<Interface>,
    ) -> WriteRecord {
        let origin = match line {
            None => WriteOrigin::Board,
            Some(Interface::Can) => WriteOrigin::Can,
            Some(Interface::Serial) => WriteOrigin::Serial,
            Some(Interface::Modbus) => WriteOrigin::Modbus,
        };
        let (calibration, at_ms, utc_s) =
            (self.running_calibration_crc(), self.now.0, self.utc_s());
        let (sequence, is_unattended) = (0, false);
        WriteRecord { sequence, calibration, about, at_ms, utc_s, what, origin, is_unattended }
    }

    /// Returns the calibration that runs, by the CRC of its blob; 0: none.
    pub(super) fn running_calibration_crc(&self) -> u32 {
        if self.blob.is_empty() { 0 } else { calibration::calibration_crc(self.blob) }
    }

    /// Hands a write to the board, which stores it.
    pub(super) fn push_write(&mut self, write: WriteRecord) {
        if self.log.waiting.push_back(write).is_err() {
            // The board does not store: it is reported all the same.
            self.log.last.push(&write);
        }
    }
}
