//! A new firmware on its way to the other slot of the flash (objects 0x2120 and 0x2121).
//!
//! A master writes the header, then the bytes behind it, in one transfer or, after a line that broke, in several: each goes on
//! with the byte after those that have come. Nothing is stored here. Bytes wait in the buffer that calibrations come through
//! until the board takes them ([`Node::take_firmware_step`]), and the last segment is answered once the board has looked at all of
//! it. So no flash is written where a frame is received, and an answer without an abort means: checked, and in the flash.

use heapless::Vec;
use trueup_canopen::{
    dictionary::{EntryContent, FIRMWARE_HEADER_BYTES},
    sdo::{self, AbortCode},
};

use super::{Node, object_access::load_abort_code};

/// Bytes that wait for the board at the most: at one segment in 2 ms 0.14 s of them, 14 turns of its supervisor.
const MAX_PENDING_FIRMWARE_BYTES: usize = 512;
const _: () = assert!(
    MAX_PENDING_FIRMWARE_BYTES >= FIRMWARE_HEADER_BYTES
        && MAX_PENDING_FIRMWARE_BYTES >= 2 * SDO_BLOCK_BYTES
);

/// Bytes of a block.
const SDO_BLOCK_BYTES: usize = 7 * sdo::SEGMENTS_PER_BLOCK as usize;

/// Bytes on their way to the board.
pub type FirmwareChunk = Vec<u8, MAX_PENDING_FIRMWARE_BYTES>;

/// State of both slots, as object 0x2121 has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlotStates {
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
pub enum UpdateStep {
    /// Check the header of the piece, and erase the other slot.
    Begin,
    /// Write the piece behind the bytes that are there.
    Write,
    /// All has come: verify it, and let it start next.
    Finish,
}

/// Which domain is being written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum TransferTarget {
    #[default]
    None,
    Header,
    Image,
}

/// A firmware under way.
#[derive(Debug, Default)]
pub(super) struct FirmwareUpdate {
    slots: Option<SlotStates>,
    /// Bytes that have come, the header included; 0: none is under way.
    received: u32,
    tag: u32,
    refused: u8,
    transfer: TransferTarget,
    /// All bytes of this transfer have come; its master waits for the outcome.
    is_closed: bool,
    /// The board is at a step.
    is_away: bool,
}

impl FirmwareUpdate {
    fn reset_transfer(&mut self) {
        (self.received, self.tag, self.transfer) = (0, 0, TransferTarget::None);
    }

    pub(crate) fn entry_value(&self, what: EntryContent) -> Result<u32, AbortCode> {
        let slots = self.slots.as_ref().ok_or(AbortCode::NoData);
        let of = |slot: u8| usize::from(slot);
        Ok(match what {
            EntryContent::FirmwareReceived => self.received,
            EntryContent::FirmwareTag => self.tag,
            EntryContent::FirmwareRefused => self.refused.into(),
            EntryContent::RunningSlot => slots?.running.into(),
            EntryContent::SlotVersion(slot) => {
                *slots?.versions.get(of(slot)).ok_or(AbortCode::NoSubindex)?
            }
            EntryContent::SlotStatus(slot) => {
                let status = slots?.status.get(of(slot)).ok_or(AbortCode::NoSubindex)?;
                u16::from_le_bytes(*status).into()
            }
            EntryContent::FirmwareFloor => slots?.floor,
            EntryContent::SlotChoice => slots?.choice,
            _ => return Err(AbortCode::WriteOnly),
        })
    }
}

impl Node<'_> {
    /// Notes the state of the firmware slots; a board that has none does not call this.
    pub fn set_slot_states(&mut self, slots: SlotStates) {
        self.firmware.slots = Some(slots);
    }

    /// Returns the next step of a new firmware, once, and its bytes in `piece`; [`Self::finish_firmware_step`] is to follow. None is
    /// due while an offset is followed: a step stops the core for as long as the flash takes.
    pub fn take_firmware_step(&mut self, piece: &mut FirmwareChunk) -> Option<UpdateStep> {
        if !self.is_offset_inactive() || self.firmware.is_away {
            return None;
        }
        let step = match (self.firmware.transfer, self.firmware.is_closed) {
            (TransferTarget::Header, true) => UpdateStep::Begin,
            (TransferTarget::Image, _) if !self.slot.received_bytes().is_empty() => {
                UpdateStep::Write
            }
            (TransferTarget::Image, true) => UpdateStep::Finish,
            _ => return None,
        };
        piece.clear();
        // It has room for all that may wait.
        for byte in self.slot.received_bytes() {
            piece.push(*byte).ok();
        }
        self.slot.clear();
        if step == UpdateStep::Begin {
            self.firmware.tag = piece.last_chunk().map_or(0, |bytes| u32::from_le_bytes(*bytes));
        }
        self.firmware.is_away = true;
        Some(step)
    }

    /// Takes what came of a step: an error is the number of the refusal.
    pub fn finish_firmware_step(&mut self, step: UpdateStep, outcome: Result<(), u8>) {
        let firmware = &mut self.firmware;
        firmware.is_away = false;
        let outcome = match (outcome, step) {
            (Err(number), _) => {
                firmware.refused = number;
                firmware.reset_transfer();
                self.slot.clear();
                if !core::mem::take(&mut firmware.is_closed) {
                    return;
                }
                Err(AbortCode::Value)
            }
            (Ok(()), UpdateStep::Write) => return,
            (Ok(()), UpdateStep::Begin) => {
                firmware.received = u32::try_from(FIRMWARE_HEADER_BYTES).unwrap_or(0);
                Ok(())
            }
            (Ok(()), UpdateStep::Finish) => Ok(()),
        };
        (firmware.transfer, firmware.is_closed) = (TransferTarget::None, false);
        self.answer = self.server.finish_download(outcome).or(self.answer);
    }

    /// Returns whether bytes of a firmware wait in the buffer, which then takes no calibration.
    pub(super) fn has_pending_firmware(&self) -> bool {
        self.firmware.transfer != TransferTarget::None && !self.slot.received_bytes().is_empty()
    }

    pub(super) fn open_firmware(
        &mut self,
        what: EntryContent,
        size: Option<u32>,
    ) -> Result<(), AbortCode> {
        if self.firmware.slots.is_none() {
            return Err(AbortCode::CannotStore);
        }
        // The board may still be at bytes of a transfer that broke off.
        if self.firmware.is_away || self.firmware.is_closed || self.has_pending_firmware() {
            return Err(AbortCode::DeviceState);
        }
        if what == EntryContent::FirmwareHeader {
            if size.is_some_and(|size| usize::try_from(size) != Ok(FIRMWARE_HEADER_BYTES)) {
                return Err(AbortCode::Length);
            }
            self.slot.open(None).map_err(load_abort_code)?;
            self.firmware.reset_transfer();
            (self.firmware.refused, self.firmware.transfer) = (0, TransferTarget::Header);
        } else {
            if self.firmware.received == 0 {
                return Err(AbortCode::DeviceState);
            }
            self.slot.open(None).map_err(load_abort_code)?;
            self.firmware.transfer = TransferTarget::Image;
        }
        Ok(())
    }

    pub(super) fn append_firmware(&mut self, bytes: &[u8]) -> Result<(), AbortCode> {
        // Nothing is written to the flash under a CNC that has engaged meanwhile.
        self.check_change_allowed()?;
        let length = self.slot.received_bytes().len().saturating_add(bytes.len());
        match self.firmware.transfer {
            // The board has refused it meanwhile.
            TransferTarget::None => return Err(AbortCode::Value),
            TransferTarget::Header if length > FIRMWARE_HEADER_BYTES => {
                return Err(AbortCode::TooLong);
            }
            _ if length > MAX_PENDING_FIRMWARE_BYTES => return Err(AbortCode::CannotStore),
            TransferTarget::Header => {}
            TransferTarget::Image => {
                let count = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
                self.firmware.received = self.firmware.received.saturating_add(count);
            }
        }
        self.slot.append(bytes).map_err(load_abort_code)
    }

    /// Returns whether a whole block finds room.
    pub(super) fn has_block_capacity(&self) -> bool {
        // The header is taken in one piece.
        self.firmware.transfer == TransferTarget::Header
            || self.slot.received_bytes().len().saturating_add(SDO_BLOCK_BYTES)
                <= MAX_PENDING_FIRMWARE_BYTES
    }

    pub(super) fn close_firmware(&mut self) -> Result<(), AbortCode> {
        match self.firmware.transfer {
            TransferTarget::None => return Err(AbortCode::Value),
            TransferTarget::Header if self.slot.received_bytes().len() < FIRMWARE_HEADER_BYTES => {
                self.firmware.reset_transfer();
                self.slot.clear();
                return Err(AbortCode::TooShort);
            }
            TransferTarget::Header | TransferTarget::Image => self.firmware.is_closed = true,
        }
        Ok(())
    }
}
