//! The block download (CiA 301, 7.2.4.3.9 to 7.2.4.3.11): a domain comes in blocks of [`SEGMENTS_PER_BLOCK`] segments, and only a whole
//! block is answered. A segment that is lost makes the rest of its block worthless: the answer names the last one that
//! came in order, and the master sends on from there.
//!
//! The bytes of the last segment count only once the end has stated how many of them are meant; they are held until then.

use trueup_link::e2e::continue_crc;

use super::{
    AbortCode, EntryContent, ObjectAccess, ObjectAddress, SEGMENT_BYTES, SEGMENTS_PER_BLOCK,
    SdoServer, TransferState, encode_message, find_entry,
};

/// Of a segment's number: nothing follows it.
const LAST_SEGMENT_FLAG: u8 = 1 << 7;

/// State of a block download.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BlockDownloadState {
    announced: Option<u32>,
    /// Bytes that were taken, without those of `last`.
    length: u32,
    /// The last segment that came in order in this block, 0…[`SEGMENTS_PER_BLOCK`].
    sequence: u8,
    /// CRC of the bytes that were taken; `None`: the master does not use one.
    crc: Option<u16>,
    /// The segment that ends it.
    last: Option<[u8; SEGMENT_BYTES]>,
    /// The block is whole, and its answer waits until there is room for the next one.
    is_answer_due: bool,
}

impl BlockDownloadState {
    /// Returns whether a request of this command belongs to the transfer: a segment, or the end behind the last one.
    pub(super) const fn is_part_of_transfer(&self, command: u8) -> bool {
        self.is_end_command(command)
            || matches!(command & !LAST_SEGMENT_FLAG, 1..=SEGMENTS_PER_BLOCK)
    }

    /// Returns whether a command ends the transfer, after an answer to its last block.
    const fn is_end_command(&self, command: u8) -> bool {
        self.last.is_some() && !self.is_answer_due && command & 0xE3 == 0xC1
    }

    /// Takes bytes that count.
    fn append_bytes(
        &mut self,
        what: EntryContent,
        bytes: &[u8],
        objects: &mut impl ObjectAccess,
    ) -> Result<(), AbortCode> {
        let count = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        self.length = self.length.saturating_add(count);
        if self.announced.is_some_and(|announced| self.length > announced) {
            return Err(AbortCode::Length);
        }
        self.crc = self.crc.map(|crc| continue_crc(crc, bytes));
        objects.append(what, bytes)
    }
}

impl SdoServer {
    pub(super) fn start_block_download(
        &mut self,
        at: ObjectAddress,
        command: u8,
        size: [u8; 4],
        objects: &mut impl ObjectAccess,
    ) -> Result<Option<[u8; 8]>, AbortCode> {
        const SIZE_INDICATED_FLAG: u8 = 1 << 1;
        const CRC_SUPPORTED_FLAG: u8 = 1 << 2;
        let was_waiting = matches!(self.phase, TransferState::Waiting { .. });
        self.phase = TransferState::Idle;
        let entry = find_entry(at)?;
        if !entry.access.is_writable() {
            return Err(AbortCode::ReadOnly);
        }
        if entry.kind.size().is_some() {
            return Err(AbortCode::Command);
        }
        // What is being looked at must not change.
        if was_waiting {
            return Err(AbortCode::DeviceState);
        }
        let announced = (command & SIZE_INDICATED_FLAG != 0).then_some(u32::from_le_bytes(size));
        objects.open(entry.what, announced)?;
        let crc = (command & CRC_SUPPORTED_FLAG != 0).then_some(0);
        self.phase = TransferState::Block {
            at,
            what: entry.what,
            block: BlockDownloadState { announced, crc, ..BlockDownloadState::default() },
        };
        Ok(Some(encode_message(0xA4, at, u32::from(SEGMENTS_PER_BLOCK))))
    }

    /// Takes a segment of a block, or the end of all.
    pub(super) fn receive_block_segment(
        &mut self,
        at: ObjectAddress,
        what: EntryContent,
        mut block: BlockDownloadState,
        request: &[u8; 8],
        objects: &mut impl ObjectAccess,
    ) -> Result<Option<[u8; 8]>, AbortCode> {
        let &[head, ref data @ ..] = request;
        if let Some(last) = block.last
            && block.is_end_command(head)
        {
            let &[low, high, ..] = data;
            let count = SEGMENT_BYTES.saturating_sub(usize::from(head >> 2 & 7));
            block.append_bytes(what, last.get(..count).unwrap_or_default(), objects)?;
            if block.announced.is_some_and(|announced| announced != block.length) {
                return Err(AbortCode::Length);
            }
            if block.crc.is_some_and(|crc| crc != u16::from_le_bytes([low, high])) {
                return Err(AbortCode::Crc);
            }
            objects.close(what)?;
            self.phase = TransferState::Waiting { at, answer: [0xA1, 0, 0, 0, 0, 0, 0, 0] };
            return Ok(None);
        }
        let sequence = head & !LAST_SEGMENT_FLAG;
        let is_next = sequence == block.sequence.saturating_add(1);
        if is_next && !block.is_answer_due && block.last.is_none() {
            block.sequence = sequence;
            if head & LAST_SEGMENT_FLAG != 0 {
                block.last = Some(*data);
            } else {
                block.append_bytes(what, data, objects)?;
            }
        }
        // A lost segment is not waited for: the end of the block is answered.
        let is_end = sequence == SEGMENTS_PER_BLOCK || head & LAST_SEGMENT_FLAG != 0;
        block.is_answer_due |= is_end;
        self.phase = TransferState::Block { at, what, block };
        Ok(if is_end { self.acknowledge_block(objects) } else { None })
    }

    /// Returns the answer to a block, once there is room for the next one.
    pub(super) fn acknowledge_block(&mut self, objects: &impl ObjectAccess) -> Option<[u8; 8]> {
        let TransferState::Block { what, block, .. } = &mut self.phase else { return None };
        if !block.is_answer_due || !objects.has_room_for_block(*what) {
            return None;
        }
        block.is_answer_due = false;
        let taken = core::mem::take(&mut block.sequence);
        Some([0xA2, taken, SEGMENTS_PER_BLOCK, 0, 0, 0, 0, 0])
    }
}

#[cfg(test)]
mod tests;
