//! A new firmware on its way to the other slot of the flash (objects 0x2120 and 0x2121).
//!
//! A master writes the header, then the bytes behind it, in one transfer or, after a line that broke, in several: each goes on
//! with the byte after [`Firmware::received`]. Nothing is stored here. Bytes wait in a small buffer until the board takes
//! them ([`Node::take_firmware`]), and the last segment is answered once the board has looked at all of it. So no flash is
//! written where a frame is received, and an answer without an abort means: checked, and in the flash.

use heapless::Vec;
use trueup_canopen::{
    dictionary::{FIRMWARE_HEADER, ObjectKind},
    sdo::{self, Abort},
};

use super::Node;

/// Bytes that wait for the board at the most: at one segment in 2 ms 0.14 s of them, 14 turns of its supervisor.
const WAITING: usize = 512;
const _: () = assert!(WAITING >= FIRMWARE_HEADER && WAITING >= 7 * sdo::BLOCK as usize);

/// State of both slots, as object 0x2121 has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Slots {
    /// The one that runs: 0 A, 1 B.
    pub running: u8,
    /// The versions in A and B; 0: none.
    pub versions: [u32; 2],
    /// Their status and their starts on trial.
    pub status: [[u8; 2]; 2],
    /// The oldest version that may start.
    pub floor: u32,
}

/// The next step of the board.
#[derive(Debug, PartialEq, Eq)]
pub enum Step {
    /// Check this header, and erase the other slot.
    Begin([u8; FIRMWARE_HEADER]),
    /// Write these bytes behind those that are there.
    Write(Vec<u8, WAITING>),
    /// All has come: verify it, and let it start next.
    Finish,
}

/// Which domain is being written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Transfer {
    #[default]
    None,
    Header,
    Image,
}

/// A firmware under way.
#[derive(Debug, Default)]
pub(super) struct Firmware {
    slots: Option<Slots>,
    /// Bytes that have come, the header included; 0: none is under way.
    received: u32,
    tag: u32,
    refused: u8,
    transfer: Transfer,
    waiting: Vec<u8, WAITING>,
    /// All bytes of this transfer have come; its master waits for the outcome.
    is_closed: bool,
    /// The board is at a step.
    is_away: bool,
}

impl Firmware {
    fn open(&mut self, transfer: Transfer, size: Option<u32>) -> Result<(), Abort> {
        if self.slots.is_none() {
            return Err(Abort::CannotStore);
        }
        // The board may still have bytes of a transfer that broke off.
        if self.is_away || self.is_closed {
            return Err(Abort::DeviceState);
        }
        if transfer == Transfer::Header {
            if size.is_some_and(|size| usize::try_from(size) != Ok(FIRMWARE_HEADER)) {
                return Err(Abort::Length);
            }
            self.drop_all();
            self.refused = 0;
        } else if self.received == 0 {
            return Err(Abort::DeviceState);
        }
        self.transfer = transfer;
        Ok(())
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), Abort> {
        match self.transfer {
            // The board has refused it meanwhile.
            Transfer::None => Err(Abort::Value),
            Transfer::Header
                if self.waiting.len().saturating_add(bytes.len()) > FIRMWARE_HEADER =>
            {
                Err(Abort::TooLong)
            }
            Transfer::Header | Transfer::Image => {
                self.waiting.extend_from_slice(bytes).map_err(|_| Abort::CannotStore)?;
                if self.transfer == Transfer::Image {
                    let count = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
                    self.received = self.received.saturating_add(count);
                }
                Ok(())
            }
        }
    }

    fn close(&mut self) -> Result<(), Abort> {
        match self.transfer {
            Transfer::None => return Err(Abort::Value),
            Transfer::Header if self.waiting.len() < FIRMWARE_HEADER => {
                self.drop_all();
                return Err(Abort::TooShort);
            }
            Transfer::Header | Transfer::Image => self.is_closed = true,
        }
        Ok(())
    }

    fn drop_all(&mut self) {
        self.waiting.clear();
        (self.received, self.tag, self.transfer) = (0, 0, Transfer::None);
    }

    fn take(&mut self) -> Option<Step> {
        if self.is_away {
            return None;
        }
        let step = match (self.transfer, self.is_closed) {
            (Transfer::Header, true) => {
                let header = self.waiting.first_chunk().copied();
                self.waiting.clear();
                Step::Begin(header?)
            }
            (Transfer::Image, _) if !self.waiting.is_empty() => {
                Step::Write(core::mem::take(&mut self.waiting))
            }
            (Transfer::Image, true) => Step::Finish,
            _ => return None,
        };
        self.is_away = true;
        Some(step)
    }

    /// Takes the outcome of a step. Returns the one of the transfer, if this was its last.
    fn end(&mut self, step: &Step, outcome: Result<(), u8>) -> Option<Result<(), Abort>> {
        self.is_away = false;
        if let Err(number) = outcome {
            self.refused = number;
            self.drop_all();
            return core::mem::take(&mut self.is_closed).then_some(Err(Abort::Value));
        }
        match step {
            Step::Begin(header) => {
                self.received = u32::try_from(header.len()).unwrap_or(0);
                self.tag = header.last_chunk().map_or(0, |it| u32::from_le_bytes(*it));
            }
            Step::Write(_) => return None,
            Step::Finish => {}
        }
        (self.transfer, self.is_closed) = (Transfer::None, false);
        Some(Ok(()))
    }

    pub fn number(&self, what: ObjectKind) -> Result<u32, Abort> {
        let slots = self.slots.as_ref().ok_or(Abort::NoData);
        let of = |slot: u8| usize::from(slot);
        Ok(match what {
            ObjectKind::FirmwareReceived => self.received,
            ObjectKind::FirmwareTag => self.tag,
            ObjectKind::FirmwareRefused => self.refused.into(),
            ObjectKind::RunningSlot => slots?.running.into(),
            ObjectKind::SlotVersion(slot) => {
                *slots?.versions.get(of(slot)).ok_or(Abort::NoSubindex)?
            }
            ObjectKind::SlotStatus(slot) => {
                let status = slots?.status.get(of(slot)).ok_or(Abort::NoSubindex)?;
                u16::from_le_bytes(*status).into()
            }
            ObjectKind::FirmwareFloor => slots?.floor,
            _ => return Err(Abort::WriteOnly),
        })
    }
}

impl Node<'_> {
    /// Notes the state of the firmware slots; a board that has none does not call this.
    pub fn note_slots(&mut self, slots: Slots) {
        self.firmware.slots = Some(slots);
    }

    /// Returns the next step of a new firmware, once; [`Self::end_firmware`] is to follow. None is due while an offset is
    /// followed: a step stops the core for as long as the flash takes.
    pub fn take_firmware(&mut self) -> Option<Step> {
        if self.is_at_rest() { self.firmware.take() } else { None }
    }

    /// Takes what came of a step: an error is the number of the refusal.
    pub fn end_firmware(&mut self, step: &Step, outcome: Result<(), u8>) {
        if let Some(outcome) = self.firmware.end(step, outcome) {
            self.answer = self.server.end(outcome).or(self.answer);
        }
    }

    pub(super) fn open_firmware(
        &mut self,
        what: ObjectKind,
        size: Option<u32>,
    ) -> Result<(), Abort> {
        let is_header = what == ObjectKind::FirmwareHeader;
        self.firmware.open(if is_header { Transfer::Header } else { Transfer::Image }, size)
    }

    pub(super) fn append_firmware(&mut self, bytes: &[u8]) -> Result<(), Abort> {
        // Nothing is written to the flash under a CNC that has engaged meanwhile.
        self.allow_change()?;
        self.firmware.append(bytes)
    }

    /// Returns whether the board has taken what had come, so that a whole block finds room.
    pub(super) fn is_firmware_ready(&self) -> bool {
        // The header is taken in one piece.
        self.firmware.transfer == Transfer::Header
            || self.firmware.waiting.is_empty() && !self.firmware.is_away
    }

    pub(super) fn close_firmware(&mut self) -> Result<(), Abort> {
        self.firmware.close()
    }
}
