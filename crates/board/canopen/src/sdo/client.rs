//! The other end of the SDO server: how a tool reads and writes objects (CiA 301). Segments for
//! whatever is longer than 4 bytes, blocks of segments for long domains.
//!
//! A transfer is a value that takes the server's answers and gives the next request; it has no
//! clock and no line, so its caller decides how long to wait.

use trueup_link::{
    frame::Frame,
    layout::{SDO_REQUEST_ID, SDO_RESPONSE_ID},
};

use super::{AbortCode, SEGMENT_BYTES, encode_message, is_toggle_bit_set, saturate_to_u8};

mod block_download;
pub use block_download::BlockDownload;

pub use crate::dictionary::ObjectAddress;

/// Why a transfer has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SdoClientError {
    /// The server has ended it with this code.
    #[error("object {:04X}:{}: {} (abort code {code:08X})", .at.0, .at.1, text(*.code))]
    Aborted {
        /// Of this object.
        at: ObjectAddress,
        /// The code, as CiA 301 lists it.
        code: u32,
    },
    /// The answer is none to what was asked.
    #[error("object {:04X}:{}: {answer:02X?} does not answer this request", .at.0, .at.1)]
    Unexpected {
        /// Of this object.
        at: ObjectAddress,
        /// The eight bytes that came.
        answer: [u8; 8],
    },
    /// The server sends or announces more bytes than the object may have, or a segment without any.
    #[error("object {:04X}:{}: does not end within its {most} bytes", .at.0, .at.1)]
    TooLong {
        /// Of this object.
        at: ObjectAddress,
        /// It may have this many.
        most: u32,
    },
    /// The object ends before the length that the server has announced.
    #[error("object {:04X}:{}: ends before its announced length", .at.0, .at.1)]
    TooShort {
        /// Of this object.
        at: ObjectAddress,
    },
}

/// Returns what CiA 301 says of an abort code.
fn text(code: u32) -> &'static str {
    AbortCode::ALL
        .into_iter()
        .find(|abort| abort.code() == code)
        .map_or("refused", AbortCode::description)
}

impl SdoClientError {
    /// Returns whether the line may be to blame, and the same may be answered when it is requested again: a
    /// request was lost, or an answer.
    #[must_use]
    pub const fn is_transmission_error(&self) -> bool {
        match *self {
            Self::Aborted { code, .. } => code == AbortCode::Timeout.code(),
            Self::Unexpected { .. } | Self::TooShort { .. } => true,
            Self::TooLong { .. } => false,
        }
    }
}

/// An object that is being read.
#[derive(Clone, Copy, Debug)]
pub struct Upload {
    at: ObjectAddress,
    /// `None` before the answer to the start.
    toggle: Option<bool>,
    announced: Option<u32>,
    received: u32,
    most: u32,
}

/// The most bytes of an object for which nothing else is known: above any calibration.
pub const DEFAULT_MAX_UPLOAD_BYTES: u32 = 1 << 16;

impl Upload {
    /// Starts it, with the first request.
    #[must_use]
    pub fn start(at: ObjectAddress) -> (Self, Frame) {
        Self::start_with_size_limit(at, DEFAULT_MAX_UPLOAD_BYTES)
    }

    /// Returns the same of an object that has at most this many bytes.
    #[must_use]
    pub fn start_with_size_limit(at: ObjectAddress, most: u32) -> (Self, Frame) {
        let this = Self { at, toggle: None, announced: None, received: 0, most };
        (this, request_frame(encode_message(0x40, at, 0)))
    }

    /// Counts bytes that have come.
    fn count_received_bytes(&mut self, length: usize) -> Result<(), SdoClientError> {
        self.received = self.received.saturating_add(u32::try_from(length).unwrap_or(u32::MAX));
        let most = self.announced.unwrap_or(self.most).min(self.most);
        if self.received > most {
            return Err(SdoClientError::TooLong { at: self.at, most });
        }
        Ok(())
    }

    /// Bytes that the server has announced; `None` before it has.
    #[must_use]
    pub const fn indicated_size(&self) -> Option<u32> {
        self.announced
    }

    /// Takes a frame from the bus. The bytes that it brings go into `bytes`. Gives the next request;
    /// `None`: all is there. A frame that is not an answer of an SDO server changes nothing, nor does,
    /// before the start is answered, an answer to a request of an earlier client.
    ///
    /// # Errors
    /// [`SdoClientError`]: the transfer is over.
    pub fn receive(
        &mut self,
        frame: &Frame,
        bytes: &mut impl Extend<u8>,
    ) -> Result<TransferProgress, SdoClientError> {
        let Some(answer) = response_bytes(frame) else { return Ok(TransferProgress::Unchanged) };
        let &[command, _, _, _, a, b, c, d] = answer;
        let unexpected = SdoClientError::Unexpected { at: self.at, answer: *answer };
        match (command >> 5, self.toggle) {
            (_, None) if !matches_object(answer, self.at) => Ok(TransferProgress::Unchanged),
            (4, _) => Err(abort_error(answer, self.at)),
            (2, None) => {
                if command & 2 == 0 {
                    self.announced = (command & 1 != 0).then(|| u32::from_le_bytes([a, b, c, d]));
                    self.toggle = Some(false);
                    if self.announced.is_some_and(|announced| announced > self.most) {
                        return Err(SdoClientError::TooLong { at: self.at, most: self.most });
                    }
                    return Ok(TransferProgress::Request(request_frame([
                        0x60, 0, 0, 0, 0, 0, 0, 0,
                    ])));
                }
                let unused = if command & 1 != 0 { usize::from(command >> 2 & 3) } else { 0 };
                let length = 4_usize.saturating_sub(unused);
                self.count_received_bytes(length)?;
                bytes.extend([a, b, c, d].into_iter().take(length));
                Ok(TransferProgress::Done)
            }
            // The answer to an earlier start of the same, which was given up.
            (2, Some(false)) if matches_object(answer, self.at) => Ok(TransferProgress::Unchanged),
            (0, Some(toggle)) if is_toggle_bit_set(command) == toggle => {
                let [_, data @ ..] = answer;
                let length = SEGMENT_BYTES.saturating_sub(usize::from(command >> 1 & 7));
                let is_last = command & 1 != 0;
                self.count_received_bytes(length)?;
                // Segments without a byte would have no end.
                if length == 0 && !is_last {
                    return Err(SdoClientError::TooLong { at: self.at, most: self.most });
                }
                bytes.extend(data.iter().copied().take(length));
                if is_last {
                    return match self.announced {
                        Some(announced) if announced > self.received => {
                            Err(SdoClientError::TooShort { at: self.at })
                        }
                        _ => Ok(TransferProgress::Done),
                    };
                }
                self.toggle = Some(!toggle);
                Ok(TransferProgress::Request(request_frame([
                    0x60 | u8::from(!toggle) << 4,
                    0,
                    0,
                    0,
                    0,
                    0,
                    0,
                    0,
                ])))
            }
            _ => Err(unexpected),
        }
    }
}

/// Progress of a transfer by a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TransferProgress {
    /// It was not an answer.
    Unchanged,
    /// This is to be asked next.
    Request(Frame),
    /// The transfer is done.
    Done,
}

/// An object that is being written.
#[derive(Clone, Copy, Debug)]
pub struct Download<'d> {
    at: ObjectAddress,
    data: &'d [u8],
    /// The start was answered.
    is_answered: bool,
    /// Where the next segment begins.
    next: usize,
    /// Of the segment that is being answered.
    toggle: bool,
    is_expedited: bool,
}

impl<'d> Download<'d> {
    /// Starts it, with the first request.
    #[must_use]
    pub fn start(at: ObjectAddress, data: &'d [u8]) -> (Self, Frame) {
        let is_expedited = (1..=4).contains(&data.len());
        let this = Self { at, data, is_answered: false, next: 0, toggle: true, is_expedited };
        let first = if is_expedited {
            let mut number = [0; 4];
            number.iter_mut().zip(data).for_each(|(place, byte)| *place = *byte);
            let unused = 4_u8.saturating_sub(saturate_to_u8(data.len()));
            encode_message(0x23 | unused << 2, at, u32::from_le_bytes(number))
        } else {
            encode_message(0x21, at, u32::try_from(data.len()).unwrap_or(u32::MAX))
        };
        (this, request_frame(first))
    }

    /// Bytes that were sent.
    #[must_use]
    pub fn bytes_sent(&self) -> usize {
        self.next.min(self.data.len())
    }

    /// Takes a frame from the bus, as [`Upload::receive`].
    ///
    /// # Errors
    /// [`SdoClientError`]: the transfer is over.
    pub fn receive(&mut self, frame: &Frame) -> Result<TransferProgress, SdoClientError> {
        let Some(answer) = response_bytes(frame) else { return Ok(TransferProgress::Unchanged) };
        let &[command, ..] = answer;
        match (command >> 5, self.is_answered) {
            (_, false) if !matches_object(answer, self.at) => Ok(TransferProgress::Unchanged),
            (4, _) => Err(abort_error(answer, self.at)),
            (3, false) => {
                if self.is_expedited {
                    return Ok(TransferProgress::Done);
                }
                self.is_answered = true;
                Ok(TransferProgress::Request(self.encode_segment()))
            }
            (1, true) if is_toggle_bit_set(command) == self.toggle => {
                if self.next >= self.data.len() {
                    return Ok(TransferProgress::Done);
                }
                Ok(TransferProgress::Request(self.encode_segment()))
            }
            _ => Err(SdoClientError::Unexpected { at: self.at, answer: *answer }),
        }
    }

    fn encode_segment(&mut self) -> Frame {
        let rest = self.data.get(self.next..).unwrap_or_default();
        let part = rest.get(..SEGMENT_BYTES).unwrap_or(rest);
        self.toggle = !self.toggle;
        self.next = self.next.saturating_add(SEGMENT_BYTES);
        let unused = saturate_to_u8(SEGMENT_BYTES).saturating_sub(saturate_to_u8(part.len()));
        let is_last = part.len() == rest.len();
        let mut data = [0; 8];
        let [head, places @ ..] = &mut data;
        *head = u8::from(self.toggle) << 4 | unused << 1 | u8::from(is_last);
        places.iter_mut().zip(part).for_each(|(place, byte)| *place = *byte);
        request_frame(data)
    }
}

fn request_frame(data: [u8; 8]) -> Frame {
    Frame::from_data(SDO_REQUEST_ID, data)
}

/// Ends a transfer whose answer has not come, so that it can be started again.
#[must_use]
pub fn timeout_abort_frame(at: ObjectAddress) -> Frame {
    request_frame(encode_message(0x80, at, AbortCode::Timeout.code()))
}

/// Returns the bytes of a frame that is an answer of the bridge.
fn response_bytes(frame: &Frame) -> Option<&[u8; 8]> {
    (frame.id() == SDO_RESPONSE_ID && usize::from(frame.len()) == Frame::MAX_LEN)
        .then(|| frame.data())
}

fn matches_object(answer: &[u8; 8], at: ObjectAddress) -> bool {
    let &[_, low, high, subindex, ..] = answer;
    (u16::from_le_bytes([low, high]), subindex) == at
}

fn abort_error(answer: &[u8; 8], at: ObjectAddress) -> SdoClientError {
    let &[_, _, _, _, a, b, c, d] = answer;
    SdoClientError::Aborted { at, code: u32::from_le_bytes([a, b, c, d]) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::{vec, vec::Vec};

    #[test]
    fn the_abort_codes_rise_so_each_is_there_once() {
        assert!(AbortCode::ALL.map(AbortCode::code).is_sorted_by(|a, b| a < b));
    }

    #[test]
    fn the_answer_to_an_earlier_request_is_no_answer_to_a_start() {
        let at = (0x2001, 1);
        let stale = [
            encode_message(0x80, (0x2100, 2), AbortCode::Toggle.code()),
            encode_message(0x80, (0, 0), AbortCode::Command.code()),
            encode_message(0x60, (0x2100, 2), 0),
            [0x20, 0, 0, 0, 0, 0, 0, 0],
            [0x01, 1, 2, 3, 4, 5, 6, 7],
        ];
        let (mut upload, _) = Upload::start(at);
        let (mut download, _) = Download::start(at, &[1]);
        let mut bytes = Vec::new();
        for answer in stale {
            let frame = Frame::from_data(SDO_RESPONSE_ID, answer);
            assert_eq!(upload.receive(&frame, &mut bytes), Ok(TransferProgress::Unchanged));
            assert_eq!(download.receive(&frame), Ok(TransferProgress::Unchanged));
        }
        let answer = Frame::from_data(SDO_RESPONSE_ID, encode_message(0x4F, at, 3));
        assert_eq!(upload.receive(&answer, &mut bytes), Ok(TransferProgress::Done));
        assert_eq!(bytes, [3]);
        let answer = Frame::from_data(SDO_RESPONSE_ID, encode_message(0x60, at, 0));
        assert_eq!(download.receive(&answer), Ok(TransferProgress::Done));
    }

    #[test]
    fn a_read_that_was_started_twice_takes_one_of_the_two_answers() {
        let at = (0x2100, 1);
        let frame = |data| Frame::from_data(SDO_RESPONSE_ID, data);
        let (mut upload, _) = Upload::start(at);
        let mut bytes = Vec::new();
        let started = frame(encode_message(0x41, at, 7));
        assert!(matches!(upload.receive(&started, &mut bytes), Ok(TransferProgress::Request(_))));
        assert_eq!(upload.receive(&started, &mut bytes), Ok(TransferProgress::Unchanged));
        let all = frame([0x01, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(upload.receive(&all, &mut bytes), Ok(TransferProgress::Done));
        assert_eq!(bytes, [1, 2, 3, 4, 5, 6, 7]);
    }

    #[test]
    fn an_object_that_has_no_end_or_another_length_than_announced_is_refused() {
        let at = (0x1008, 0);
        let frame = |data| Frame::from_data(SDO_RESPONSE_ID, data);
        // Announced and most bytes, how many of which length come in each segment, and how it ends.
        for (announced, most, length, segments, ends) in [
            (0, 21, 7, 3, "done"),
            (0, 20, 7, 3, "long"),
            (14, 100, 7, 2, "done"),
            (14, 100, 7, 3, "long"),
            (22, 100, 7, 3, "short"),
            (101, 100, 7, 1, "long"),
            (u32::MAX, DEFAULT_MAX_UPLOAD_BYTES, 7, 1, "long"),
            (0, 100, 0, 2, "long"),
            (0, 100, 0, 1, "done"),
        ] {
            let (mut upload, _) = Upload::start_with_size_limit(at, most);
            let mut bytes = Vec::new();
            let command = if announced == 0 { 0x40 } else { 0x41 };
            let mut last =
                upload.receive(&frame(encode_message(command, at, announced)), &mut bytes);
            for number in 0..segments {
                if last.is_err() {
                    break;
                }
                let is_last = number + 1 == segments;
                let toggle = u8::from(number % 2 == 1) << 4;
                let head = toggle | (7 - length) << 1 | u8::from(is_last);
                last = upload.receive(&frame([head, 1, 2, 3, 4, 5, 6, 7]), &mut bytes);
            }
            let what = match last {
                Ok(TransferProgress::Done) => "done",
                Err(SdoClientError::TooLong { .. }) => "long",
                Err(SdoClientError::TooShort { .. }) => "short",
                _ => "neither",
            };
            assert_eq!(what, ends, "{announced} {most} {length} {segments}: {last:?}");
            assert!(bytes.len() <= usize::try_from(most).expect("small"));
        }
    }

    proptest! {
        #[test]
        fn no_answer_panics_or_goes_on_for_ever(
            answers in prop::collection::vec(any::<[u8; 8]>(), 0..50), length in 0_usize..40,
        ) {
            let data = vec![7; length];
            let (mut up, _) = Upload::start((0x2100, 1));
            let (mut down, _) = Download::start((0x2100, 2), &data);
            let mut bytes = Vec::new();
            for answer in &answers {
                let frame = Frame::from_data(SDO_RESPONSE_ID, *answer);
                up.receive(&frame, &mut bytes).ok();
                down.receive(&frame).ok();
            }
            prop_assert!(bytes.len() <= 7 * answers.len());
            prop_assert!(down.bytes_sent() <= length);
        }
    }
}
