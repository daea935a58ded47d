//! The block download (CiA 301, 7.2.4.3.9 to 7.2.4.3.11): a domain comes in blocks of [`BLOCK`] segments, and only a whole
//! block is answered. A segment that is lost makes the rest of its block worthless: the answer names the last one that
//! came in order, and the master sends on from there.
//!
//! The bytes of the last segment count only once the end has said how many of them are meant; they are held until then.

use super::{Abort, BLOCK, ObjectKind, Objects, Phase, SEGMENT, Server, find, initiated};

type At = (u16, u8);

/// Of a segment's number: nothing follows it.
const IS_LAST: u8 = 1 << 7;

/// State of a block download.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Block {
    announced: Option<u32>,
    /// Bytes that were taken, without those of `last`.
    length: u32,
    /// The last segment that came in order in this block, 0…[`BLOCK`].
    sequence: u8,
    /// CRC of the bytes that were taken; `None`: the master does not use one.
    crc: Option<u16>,
    /// The segment that ends it.
    last: Option<[u8; SEGMENT]>,
    /// The block is whole, and its answer waits until there is room for the next one.
    is_answer_due: bool,
}

/// CRC-16 by 0x1021, start 0, highest bit first (CiA 301, 7.2.4.3.16).
pub(super) fn step(crc: u16, byte: u8) -> u16 {
    (0..8).fold(crc ^ u16::from(byte) << 8, |crc, _| {
        let shifted = crc << 1;
        if crc >> 15 == 0 { shifted } else { shifted ^ 0x1021 }
    })
}

impl Block {
    /// Returns whether a request of this command belongs to the transfer: a segment, or the end behind the last one.
    pub(super) const fn may_be(&self, command: u8) -> bool {
        self.is_end(command) || matches!(command & !IS_LAST, 1..=BLOCK)
    }

    /// Returns whether a command ends the transfer, after an answer to its last block.
    const fn is_end(&self, command: u8) -> bool {
        self.last.is_some() && !self.is_answer_due && command & 0xE3 == 0xC1
    }

    /// Takes bytes that count.
    fn take(
        &mut self,
        what: ObjectKind,
        bytes: &[u8],
        objects: &mut impl Objects,
    ) -> Result<(), Abort> {
        let count = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        self.length = self.length.saturating_add(count);
        if self.announced.is_some_and(|announced| self.length > announced) {
            return Err(Abort::Length);
        }
        self.crc = self.crc.map(|crc| bytes.iter().copied().fold(crc, step));
        objects.append(what, bytes)
    }
}

impl Server {
    pub(super) fn start_block(
        &mut self,
        at: At,
        command: u8,
        size: [u8; 4],
        objects: &mut impl Objects,
    ) -> Result<Option<[u8; 8]>, Abort> {
        const HAS_SIZE: u8 = 1 << 1;
        const HAS_CRC: u8 = 1 << 2;
        let was_waiting = matches!(self.phase, Phase::Waiting { .. });
        self.phase = Phase::Idle;
        let entry = find(at)?;
        if !entry.access.can_write() {
            return Err(Abort::ReadOnly);
        }
        if entry.kind.size().is_some() {
            return Err(Abort::Command);
        }
        // What is being looked at must not change.
        if was_waiting {
            return Err(Abort::DeviceState);
        }
        let announced = (command & HAS_SIZE != 0).then_some(u32::from_le_bytes(size));
        objects.open(entry.what, announced)?;
        let crc = (command & HAS_CRC != 0).then_some(0);
        self.phase = Phase::Block {
            at,
            what: entry.what,
            block: Block { announced, crc, ..Block::default() },
        };
        Ok(Some(initiated(0xA4, at, u32::from(BLOCK))))
    }

    /// Takes a segment of a block, or the end of all.
    pub(super) fn receive_block(
        &mut self,
        at: At,
        what: ObjectKind,
        mut block: Block,
        request: &[u8; 8],
        objects: &mut impl Objects,
    ) -> Result<Option<[u8; 8]>, Abort> {
        let &[head, ref data @ ..] = request;
        if let Some(last) = block.last
            && block.is_end(head)
        {
            let &[low, high, ..] = data;
            let count = SEGMENT.saturating_sub(usize::from(head >> 2 & 7));
            block.take(what, last.get(..count).unwrap_or_default(), objects)?;
            if block.announced.is_some_and(|announced| announced != block.length) {
                return Err(Abort::Length);
            }
            if block.crc.is_some_and(|crc| crc != u16::from_le_bytes([low, high])) {
                return Err(Abort::Crc);
            }
            objects.close(what)?;
            self.phase = Phase::Waiting { at, answer: [0xA1, 0, 0, 0, 0, 0, 0, 0] };
            return Ok(None);
        }
        let sequence = head & !IS_LAST;
        let is_next = sequence == block.sequence.saturating_add(1);
        if is_next && !block.is_answer_due && block.last.is_none() {
            block.sequence = sequence;
            if head & IS_LAST != 0 {
                block.last = Some(*data);
            } else {
                block.take(what, data, objects)?;
            }
        }
        // A lost segment is not waited for: the end of the block is answered.
        let is_end = sequence == BLOCK || head & IS_LAST != 0;
        block.is_answer_due |= is_end;
        self.phase = Phase::Block { at, what, block };
        Ok(if is_end { self.answer_block(objects) } else { None })
    }

    /// Returns the answer to a block, once there is room for the next one.
    pub(super) fn answer_block(&mut self, objects: &impl Objects) -> Option<[u8; 8]> {
        let Phase::Block { what, block, .. } = &mut self.phase else { return None };
        if !block.is_answer_due || !objects.is_ready(*what) {
            return None;
        }
        block.is_answer_due = false;
        let taken = core::mem::take(&mut block.sequence);
        Some([0xA2, taken, BLOCK, 0, 0, 0, 0, 0])
    }
}

#[cfg(test)]
mod tests;
