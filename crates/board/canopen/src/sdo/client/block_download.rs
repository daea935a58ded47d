//! The client of a block download: a domain goes out in blocks, of which each is answered as a whole.

use trueup_link::{e2e::continue_crc, frame::Frame};

use super::{
    ObjectAddress, SdoClientError, TransferProgress, abort_error, matches_object, request_frame,
    response_bytes,
};
use crate::sdo::{SEGMENT_BYTES, encode_message, saturate_to_u8};

/// Where a transfer is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DownloadPhase {
    Starting,
    Sending,
    Ending,
}

/// A domain that is being written in blocks.
#[derive(Clone, Copy, Debug)]
pub struct BlockDownload<'d> {
    at: ObjectAddress,
    data: &'d [u8],
    state: DownloadPhase,
    /// Bytes before the present block.
    from: usize,
    /// Segments of this block that were sent.
    sequence: u8,
    /// Segments of a block, as the server wants it.
    size: u8,
    /// The server checks the CRC.
    has_crc: bool,
}

impl<'d> BlockDownload<'d> {
    /// Starts it, with the first request.
    #[must_use]
    pub fn start(at: ObjectAddress, data: &'d [u8]) -> (Self, Frame) {
        let state = DownloadPhase::Starting;
        let this = Self { at, data, state, from: 0, sequence: 0, size: 0, has_crc: false };
        (
            this,
            request_frame(encode_message(0xC6, at, u32::try_from(data.len()).unwrap_or(u32::MAX))),
        )
    }

    /// Bytes that were sent.
    #[must_use]
    pub fn bytes_sent(&self) -> usize {
        self.next_offset().min(self.data.len())
    }

    /// Where the next segment begins.
    fn next_offset(&self) -> usize {
        self.from.saturating_add(SEGMENT_BYTES.saturating_mul(self.sequence.into()))
    }

    /// Takes a frame from the bus, as [`super::Upload::receive`]. With [`TransferProgress::Request`] the first frame of what is to be sent
    /// comes, and [`Self::next_segment`] has the others.
    ///
    /// # Errors
    /// [`SdoClientError`]: the transfer is over.
    pub fn receive(&mut self, frame: &Frame) -> Result<TransferProgress, SdoClientError> {
        let Some(answer) = response_bytes(frame) else { return Ok(TransferProgress::Unchanged) };
        let &[command, taken, requested, _, first, ..] = answer;
        let unexpected = Err(SdoClientError::Unexpected { at: self.at, answer: *answer });
        match (command, self.state) {
            (_, DownloadPhase::Starting) if !matches_object(answer, self.at) => {
                Ok(TransferProgress::Unchanged)
            }
            (0x80.., _) if command >> 5 == 4 => Err(abort_error(answer, self.at)),
            (0xA0 | 0xA4, DownloadPhase::Starting) => {
                self.has_crc = command & 4 != 0;
                self.state = DownloadPhase::Sending;
                self.begin_block(0, first)
                    .map_or(unexpected, |request| Ok(TransferProgress::Request(request)))
            }
            (0xA2, DownloadPhase::Sending) if taken <= self.sequence => self
                .begin_block(taken, requested)
                .map_or(unexpected, |request| Ok(TransferProgress::Request(request))),
            (0xA1, DownloadPhase::Ending) => Ok(TransferProgress::Done),
            // The answer to an earlier start of the same, which was given up.
            (0xA0 | 0xA4, DownloadPhase::Sending) if matches_object(answer, self.at) => {
                Ok(TransferProgress::Unchanged)
            }
            _ => unexpected,
        }
    }

    /// Returns the next frame of a block that [`Self::receive`] has begun; `None`: it is whole, and is to be answered.
    pub fn next_segment(&mut self) -> Option<Frame> {
        let is_whole = self.sequence >= self.size || self.next_offset() >= self.data.len();
        (self.state == DownloadPhase::Sending && !is_whole).then(|| self.encode_segment())
    }

    /// Begins the next block behind the segments that were taken, or ends the transfer behind the last; `None`: the server
    /// wants blocks of no size.
    fn begin_block(&mut self, taken: u8, size: u8) -> Option<Frame> {
        // An empty domain is one segment of no bytes.
        let is_all = taken > 0
            && self.from.saturating_add(SEGMENT_BYTES.saturating_mul(taken.into()))
                >= self.data.len();
        if is_all {
            self.state = DownloadPhase::Ending;
            return Some(self.encode_end_request());
        }
        self.from = self.from.saturating_add(SEGMENT_BYTES.saturating_mul(taken.into()));
        (self.sequence, self.size) = (0, size);
        (1..=127).contains(&size).then(|| self.encode_segment())
    }

    fn encode_segment(&mut self) -> Frame {
        let rest = self.data.get(self.next_offset()..).unwrap_or_default();
        let part = rest.get(..SEGMENT_BYTES).unwrap_or(rest);
        self.sequence = self.sequence.saturating_add(1);
        let is_last = part.len() == rest.len();
        let mut data = [0; 8];
        let [head, places @ ..] = &mut data;
        *head = u8::from(is_last) << 7 | self.sequence;
        places.iter_mut().zip(part).for_each(|(place, byte)| *place = *byte);
        request_frame(data)
    }

    fn encode_end_request(&self) -> Frame {
        let last = match self.data.len().checked_rem(SEGMENT_BYTES) {
            Some(0) if !self.data.is_empty() => SEGMENT_BYTES,
            rest => rest.unwrap_or(0),
        };
        let unused = saturate_to_u8(SEGMENT_BYTES).saturating_sub(saturate_to_u8(last));
        let crc = if self.has_crc { continue_crc(0, self.data) } else { 0 };
        let [low, high] = u16::to_le_bytes(crc);
        request_frame([0xC1 | unused << 2, low, high, 0, 0, 0, 0, 0])
    }
}
