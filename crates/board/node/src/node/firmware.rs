//! A new firmware on its way to the other slot of the flash (objects 0x2120 and 0x2121).
//!
//! A master writes the header, then the bytes behind it, in one transfer or, after a line that broke, in several: each goes on
//! with the byte after those that have come. Nothing is stored here. Bytes wait in the buffer that calibrations come through
//! until the board takes them ([`Node::take_firmware`]), and the last segment is answered once the board has looked at all of
//! it. So no flash is written where a frame is received, and an answer without an abort means: checked, and in the flash.

use heapless::Vec;
use trueup_canopen::{
    dictionary::{FIRMWARE_HEADER, ObjectKind},
    sdo::{self, Abort},
};

use super::{Node, objects::abort};

/// Bytes that wait for the board at the most: at one segment in 2 ms 0.14 s of them, 14 turns of its supervisor.
const WAITING: usize = 512;
const _: () = assert!(WAITING >= FIRMWARE_HEADER && WAITING >= 2 * BLOCK_BYTES);

/// Bytes of a block.
const BLOCK_BYTES: usize = 7 * sdo::BLOCK as usize;

/// Bytes on their way to the board.
pub type Piece = Vec<u8, WAITING>;

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
    /// Why the boot program chose the one that runs, by its own encoding; 0: it has not handed it over.
    pub choice: u32,
}

/// The next step of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Check the header of the piece, and erase the other slot.
    Begin,
    /// Write the piece behind the bytes that are there.
    Write,
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
    /// All bytes of this transfer have come; its master waits for the outcome.
    is_closed: bool,
    /// The board is at a step.
    is_away: bool,
}

impl Firmware {
    fn drop_all(&mut self) {
        (self.received, self.tag, self.transfer) = (0, 0, Transfer::None);
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
            ObjectKind::SlotChoice => slots?.choice,
            _ => return Err(Abort::WriteOnly),
        })
    }
}

impl Node<'_> {
    /// Notes the state of the firmware slots; a board that has none does not call this.
    pub fn note_slots(&mut self, slots: Slots) {
        self.firmware.slots = Some(slots);
    }

    /// Returns the next step of a new firmware, once, and its bytes in `piece`; [`Self::end_firmware`] is to follow. None is
    /// due while an offset is followed: a step stops the core for as long as the flash takes.
    pub fn take_firmware(&mut self, piece: &mut Piece) -> Option<Step> {
        if !self.is_at_rest() || self.firmware.is_away {
            return None;
        }
        let step = match (self.firmware.transfer, self.firmware.is_closed) {
            (Transfer::Header, true) => Step::Begin,
            (Transfer::Image, _) if !self.slot.gathered().is_empty() => Step::Write,
            (Transfer::Image, true) => Step::Finish,
            _ => return None,
        };
        piece.clear();
        // It has room for all that may wait.
        for byte in self.slot.gathered() {
            piece.push(*byte).ok();
        }
        self.slot.clear();
        if step == Step::Begin {
            self.firmware.tag = piece.last_chunk().map_or(0, |it| u32::from_le_bytes(*it));
        }
        self.firmware.is_away = true;
        Some(step)
    }

    /// Takes what came of a step: an error is the number of the refusal.
    pub fn end_firmware(&mut self, step: Step, outcome: Result<(), u8>) {
        let firmware = &mut self.firmware;
        firmware.is_away = false;
        let outcome = match (outcome, step) {
            (Err(number), _) => {
                firmware.refused = number;
                firmware.drop_all();
                self.slot.clear();
                if !core::mem::take(&mut firmware.is_closed) {
                    return;
                }
                Err(Abort::Value)
            }
            (Ok(()), Step::Write) => return,
            (Ok(()), Step::Begin) => {
                firmware.received = u32::try_from(FIRMWARE_HEADER).unwrap_or(0);
                Ok(())
            }
            (Ok(()), Step::Finish) => Ok(()),
        };
        (firmware.transfer, firmware.is_closed) = (Transfer::None, false);
        self.answer = self.server.end(outcome).or(self.answer);
    }

    /// Returns whether bytes of a firmware wait in the buffer, which then takes no calibration.
    pub(super) fn firmware_waits(&self) -> bool {
        self.firmware.transfer != Transfer::None && !self.slot.gathered().is_empty()
    }

    pub(super) fn open_firmware(
        &mut self,
        what: ObjectKind,
        size: Option<u32>,
    ) -> Result<(), Abort> {
        if self.firmware.slots.is_none() {
            return Err(Abort::CannotStore);
        }
        // The board may still be at bytes of a transfer that broke off.
        if self.firmware.is_away || self.firmware.is_closed || self.firmware_waits() {
            return Err(Abort::DeviceState);
        }
        if what == ObjectKind::FirmwareHeader {
            if size.is_some_and(|size| usize::try_from(size) != Ok(FIRMWARE_HEADER)) {
                return Err(Abort::Length);
            }
            self.slot.open(None).map_err(abort)?;
            self.firmware.drop_all();
            (self.firmware.refused, self.firmware.transfer) = (0, Transfer::Header);
        } else {
            if self.firmware.received == 0 {
                return Err(Abort::DeviceState);
            }
            self.slot.open(None).map_err(abort)?;
            self.firmware.transfer = Transfer::Image;
        }
        Ok(())
    }

    pub(super) fn append_firmware(&mut self, bytes: &[u8]) -> Result<(), Abort> {
        // Nothing is written to the flash under a CNC that has engaged meanwhile.
        self.allow_change()?;
        let length = self.slot.gathered().len().saturating_add(bytes.len());
        match self.firmware.transfer {
            // The board has refused it meanwhile.
            Transfer::None => return Err(Abort::Value),
            Transfer::Header if length > FIRMWARE_HEADER => return Err(Abort::TooLong),
            _ if length > WAITING => return Err(Abort::CannotStore),
            Transfer::Header => {}
            Transfer::Image => {
                let count = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
                self.firmware.received = self.firmware.received.saturating_add(count);
            }
        }
        self.slot.append(bytes).map_err(abort)
    }

    /// Returns whether a whole block finds room.
    pub(super) fn is_firmware_ready(&self) -> bool {
        // The header is taken in one piece.
        self.firmware.transfer == Transfer::Header
            || self.slot.gathered().len().saturating_add(BLOCK_BYTES) <= WAITING
    }

    pub(super) fn close_firmware(&mut self) -> Result<(), Abort> {
        match self.firmware.transfer {
            Transfer::None => return Err(Abort::Value),
            Transfer::Header if self.slot.gathered().len() < FIRMWARE_HEADER => {
                self.firmware.drop_all();
                self.slot.clear();
                return Err(Abort::TooShort);
            }
            Transfer::Header | Transfer::Image => self.firmware.is_closed = true,
        }
        Ok(())
    }
}
