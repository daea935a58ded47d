//! CAN frames as lines of text (LAWICEL ASCII), as `slcand`, python-can and a terminal speak it.
//!
//! ```text
//! t 1 8 1 8 8 B C B 0 0 1 1 2 2 3 3 4 4 5 5 \r
//! │ └─┬─┘ │ └──────────── data ───────────┘ └ every line ends with a carriage return
//! │ 3 hex └ number of bytes, 0…8
//! └ data frame with a standard identifier
//! ```
//!
//! This file is the lines themselves; [`port`] is the adapter's end (the board), [`client`] the
//! other (a host that listens to the board).

use core::char::EscapeDefault;

use heapless::{String, Vec};

use crate::frame::{Frame, FrameError};

pub mod client;
pub mod port;

pub use client::{AdapterMessage, SlcanClient};
pub use port::{Port, PortCounters};

/// The answer to a line that was understood, and the end of every line.
pub const CR: u8 = b'\r';
/// The answer to a line that was refused.
pub const BELL: u8 = 0x07;
/// The longest line without its end: a standard frame of 8 bytes that an adapter has stamped with 8 digits.
pub const MAX_LINE_LEN: usize = 30;
/// The longest line of a standard frame, with its end.
pub const MAX_FRAME_LINE_LEN: usize = 22;

/// A line without its end.
pub type LineBuffer = Vec<u8, MAX_LINE_LEN>;

/// Returns the line of a frame, with its end, in upper case.
///
/// ```
/// use trueup_link::{frame::Frame, slcan};
/// let frame = Frame::new(0x701, &[0x7F])?;
/// assert_eq!(slcan::encode_line(&frame), "t70117F\r");
/// assert_eq!(slcan::decode_line(b"t70117f"), Ok(frame));
/// # Ok::<(), trueup_link::frame::FrameError>(())
/// ```
#[must_use]
pub fn encode_line(frame: &Frame) -> String<MAX_FRAME_LINE_LEN> {
    let (line, len) = encode_line_bytes(frame);
    let text = line.get(..len).and_then(|line| str::from_utf8(line).ok());
    text.and_then(|text| String::try_from(text).ok()).unwrap_or_default()
}

/// Returns the bytes of [`encode_line`], and how many they are: as a board sends them, thousands of lines a second.
fn encode_line_bytes(frame: &Frame) -> ([u8; MAX_FRAME_LINE_LEN], usize) {
    let mut line = [CR; MAX_FRAME_LINE_LEN];
    let [high, low] = frame.id().to_be_bytes();
    let head = [b't', hex_digit(high), hex_digit(low >> 4), hex_digit(low), hex_digit(frame.len())];
    let (first, data) = line.split_at_mut(head.len());
    first.copy_from_slice(&head);
    for (place, byte) in data.as_chunks_mut::<2>().0.iter_mut().zip(frame.payload()) {
        *place = [hex_digit(byte >> 4), hex_digit(*byte)];
    }
    (line, frame_line_length(frame))
}

/// Characters of a frame's line: 5, two of each byte, and the end.
fn frame_line_length(frame: &Frame) -> usize {
    usize::from(frame.len()).saturating_mul(2).saturating_add(6)
}

/// Returns the frame of a line; its end may be left out, and digits may be in lower case.
///
/// # Errors
/// [`SlcanError`] with the character at fault; [`SlcanError::NotData`] for every line but `t`.
pub fn decode_line(line: &[u8]) -> Result<Frame, SlcanError> {
    let line = line.strip_suffix(&[CR]).unwrap_or(line);
    match LineParser::split_command(line)? {
        (b't', mut fields) => fields.parse_frame(),
        (command, _) => Err(SlcanError::NotData(command)),
    }
}

fn hex_digit(nibble: u8) -> u8 {
    const HEX_DIGITS: &[u8; 16] = b"0123456789ABCDEF";
    HEX_DIGITS.get(usize::from(nibble & 0xF)).copied().unwrap_or_default()
}

/// The rest of a line after its first character, read from left to right.
#[derive(Clone, Copy, Debug)]
struct LineParser<'a> {
    line: &'a [u8],
    at: usize,
}

impl<'a> LineParser<'a> {
    /// Returns the first character, and the rest.
    fn split_command(line: &'a [u8]) -> Result<(u8, Self), SlcanError> {
        if line.len() > MAX_LINE_LEN {
            return Err(SlcanError::TooLong);
        }
        let first = line.first().ok_or(SlcanError::Truncated { len: 0 })?;
        Ok((*first, Self { line, at: 1 }))
    }

    fn next_byte(&mut self) -> Result<u8, SlcanError> {
        let len = self.line.len();
        let byte = self.line.get(self.at).ok_or(SlcanError::Truncated { len })?;
        self.at = self.at.saturating_add(1);
        Ok(*byte)
    }

    /// Returns a number of 1…8 hexadecimal digits.
    fn parse_hex(&mut self, digits: u8) -> Result<u32, SlcanError> {
        let mut number = 0_u32;
        for _ in 0..digits {
            let at = self.at;
            let found = self.next_byte()?;
            let value = char::from(found).to_digit(16);
            number = number << 4 | value.ok_or(SlcanError::NotHex { at, found })?;
        }
        Ok(number)
    }

    fn expect_end(&self) -> Result<(), SlcanError> {
        match self.line.get(self.at) {
            None => Ok(()),
            Some(&found) => Err(SlcanError::Trailing { at: self.at, found }),
        }
    }

    /// Returns the number of data bytes.
    fn parse_length(&mut self) -> Result<u8, SlcanError> {
        let found = self.next_byte()?;
        match found {
            b'0'..=b'8' => Ok(found & 0xF),
            _ => Err(SlcanError::DataLength(found)),
        }
    }

    /// Identifier, length and data of a standard frame, up to the end of the line.
    fn parse_frame(&mut self) -> Result<Frame, SlcanError> {
        let id = self.parse_hex(3)?;
        let mut data = [0; Frame::MAX_LEN];
        let payload = self.parse_data(&mut data)?;
        // Three digits fit 16 bits.
        let id = u16::try_from(id).unwrap_or(u16::MAX);
        Frame::new(id, payload).map_err(|error| match error {
            FrameError::Identifier(id) => SlcanError::Identifier(id.into()),
            FrameError::Length(_) => SlcanError::TooLong,
        })
    }

    /// Returns the number of bytes, then the bytes, up to the end of the line.
    fn parse_data<'b>(
        &mut self,
        bytes: &'b mut [u8; Frame::MAX_LEN],
    ) -> Result<&'b [u8], SlcanError> {
        let len = usize::from(self.parse_length()?);
        let payload = bytes.get_mut(..len).unwrap_or_default();
        for byte in &mut *payload {
            let [low, ..] = self.parse_hex(2)?.to_le_bytes();
            *byte = low;
        }
        self.expect_end()?;
        Ok(payload)
    }
}

/// Cuts a stream of bytes into lines. Line feeds are passed over, as terminals send them.
#[derive(Clone, Debug, Default)]
pub struct LineSplitter {
    line: LineBuffer,
    too_long: bool,
    /// The line was given out: the next byte begins another one.
    is_whole: bool,
}

impl LineSplitter {
    /// At the start of a line.
    #[must_use]
    pub const fn new() -> Self {
        Self { line: LineBuffer::new(), too_long: false, is_whole: false }
    }

    /// Takes the next byte; the line, which may be empty, with the byte that ends it. It stays in its place: each copy of a
    /// line costs the board more than its byte does.
    ///
    /// # Errors
    /// [`SlcanError::TooLong`], once for a line of more than [`MAX_LINE_LEN`] characters, at its end.
    pub fn push(&mut self, byte: u8) -> Option<Result<&[u8], SlcanError>> {
        if byte == b'\n' {
            return None;
        }
        if core::mem::take(&mut self.is_whole) {
            self.line.clear();
            self.too_long = false;
        }
        if byte == CR {
            self.is_whole = true;
            return Some(if self.too_long { Err(SlcanError::TooLong) } else { Ok(&self.line) });
        }
        self.too_long |= self.line.push(byte).is_err();
        None
    }
}

/// Why a line is refused. Positions count from 0, the character of the command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SlcanError {
    /// The line has more than [`MAX_LINE_LEN`] characters.
    #[error("line has more than {MAX_LINE_LEN} characters")]
    TooLong,
    /// The line ends too early.
    #[error("line ends after {len} characters")]
    Truncated {
        /// Characters in the line.
        len: usize,
    },
    /// The line goes on where it should end.
    #[error("line goes on at {at} with '{}'", escape_byte(*.found))]
    Trailing {
        /// Position of the first character too many.
        at: usize,
        /// That character, in ASCII.
        found: u8,
    },
    /// There is no such command.
    #[error("no command '{}'", escape_byte(*.0))]
    Command(u8),
    /// The command is known, but not with this parameter.
    #[error("command '{}' does not take '{}'", escape_byte(*.command), escape_byte(*.found))]
    Parameter {
        /// The command's letter, in ASCII.
        command: u8,
        /// The parameter's character, in ASCII.
        found: u8,
    },
    /// Not a hexadecimal digit.
    #[error("'{}' at {at} is not a hexadecimal digit", escape_byte(*.found))]
    NotHex {
        /// Position of the character.
        at: usize,
        /// The character that is there, in ASCII.
        found: u8,
    },
    /// The identifier is too large: above 0x7FF, or 0x1FFF_FFFF if it is extended.
    #[error("identifier 0x{0:X} is too large")]
    Identifier(u32),
    /// The number of data bytes is not 0…8.
    #[error("number of bytes '{}' is not 0…8", escape_byte(*.0))]
    DataLength(u8),
    /// Not a data frame with a standard identifier, but a line that starts with this character.
    #[error("'{}' does not start a standard data frame", escape_byte(*.0))]
    NotData(u8),
    /// A frame to be sent while the channel is closed, or open to listen only.
    #[error("'{}' while the channel is not open to send", escape_byte(*.0))]
    NotOpen(u8),
}

fn escape_byte(byte: u8) -> EscapeDefault {
    char::from(byte).escape_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::string::ToString;

    fn frame(id: u16, payload: &[u8]) -> Frame {
        Frame::new(id, payload).unwrap()
    }

    #[test]
    fn lines_look_as_the_adapters_write_them() {
        let data = [0x8B, 0xCB, 0x00, 0x11, 0x22, 0x33, 0x44, 0x55];
        assert_eq!(encode_line(&frame(0x181, &data)), "t18188BCB001122334455\r");
        assert_eq!(encode_line(&frame(0x7FF, &[])), "t7FF0\r");
        assert_eq!(encode_line(&frame(0x00A, &[0xAF])), "t00A1AF\r");
    }

    #[test]
    fn the_character_at_fault_is_named() {
        for (line, error) in [
            (&b""[..], SlcanError::Truncated { len: 0 }),
            (b"t18", SlcanError::Truncated { len: 3 }),
            (b"t1812AA", SlcanError::Truncated { len: 7 }),
            (b"t1811xA", SlcanError::NotHex { at: 5, found: b'x' }),
            (b"t1811AAB", SlcanError::Trailing { at: 7, found: b'B' }),
            (b"t8000", SlcanError::Identifier(0x800)),
            (b"t1819", SlcanError::DataLength(b'9')),
            (b"t181F", SlcanError::DataLength(b'F')),
            (b"t+810", SlcanError::NotHex { at: 1, found: b'+' }),
            (b"T000001810", SlcanError::NotData(b'T')),
            (&[b't'; MAX_LINE_LEN + 1], SlcanError::TooLong),
        ] {
            assert_eq!(decode_line(line), Err(error), "{}", line.escape_ascii());
        }
    }

    #[test]
    fn messages_show_unprintable_characters() {
        let error = SlcanError::NotHex { at: 3, found: 0 };
        assert_eq!(error.to_string(), "'\\u{0}' at 3 is not a hexadecimal digit");
    }

    #[test]
    fn a_line_of_the_largest_length_passes_and_one_more_does_not() {
        let mut splitter = LineSplitter::new();
        for (len, passes) in
            [(MAX_LINE_LEN, true), (MAX_LINE_LEN + 1, false), (0, true), (500, false)]
        {
            for _ in 0..len {
                assert!(splitter.push(b'0').is_none());
            }
            assert!(splitter.push(b'\n').is_none());
            let line = splitter.push(CR).expect("a carriage return ends the line");
            assert_eq!(
                line.map(|line| line.len()),
                if passes { Ok(len) } else { Err(SlcanError::TooLong) }
            );
        }
    }

    proptest! {
        #[test]
        fn a_frame_comes_back_from_its_line_in_either_case(
            id in 0_u16..0x800, payload in prop::collection::vec(any::<u8>(), 0..=8),
        ) {
            let sent = frame(id, &payload);
            let line = encode_line(&sent);
            prop_assert_eq!(decode_line(line.as_bytes()), Ok(sent));
            let lower = line.trim_end().to_ascii_lowercase();
            prop_assert_eq!(decode_line(lower.as_bytes()), Ok(sent));
        }

        #[test]
        fn any_line_that_is_read_is_the_line_that_is_written(line in "t[0-9A-F]{4,21}") {
            if let Ok(frame) = decode_line(line.as_bytes()) {
                let written = encode_line(&frame);
                prop_assert_eq!(written.trim_end(), line);
            }
        }

        #[test]
        fn no_line_panics(line in prop::collection::vec(any::<u8>(), 0..40)) {
            let _ = decode_line(&line);
        }
    }
}
