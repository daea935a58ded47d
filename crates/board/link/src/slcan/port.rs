//! The adapter's end of the line: the board as `slcand`, python-can or a terminal see it.
//!
//! | line | does | answer |
//! |---|---|---|
//! | `O`, `L` | opens; after `L` the client may only listen | `\r` |
//! | `C` | closes | `\r` |
//! | `t`*iii n dd…* | a frame to the board; only after `O` | `\r` |
//! | `r` *iii n*, `T` *iiiiiiii n dd…*, `R` *iiiiiiii n* | nothing here; only after `O` | `\r` |
//! | `S0`…`S8`, `s` *x…*, `M` *xxxxxxxx*, `m` *xxxxxxxx*, `Z0` | nothing here | `\r` |
//! | `V`, `N`, `F` | version, serial number, status | `V1013\r`, `N`*xxxx*`\r`, `F00\r` |
//! | empty | nothing | `\r` |
//! | anything else | nothing, is counted | BELL |
//!
//! Clients set a bit rate, a filter or a repeated `O` whether or not that makes sense on a serial
//! line; refusing would stop them. `Z1` is refused: it would promise time stamps.

use heapless::Vec;

use super::{
    BELL, CR, LineParser, LineSplitter, SlcanError, encode_line_bytes, frame_line_length, hex_digit,
};
use crate::frame::Frame;

/// Bytes that wait to be transmitted. One cycle of offsets is 44, so this is 5 ms of traffic: older
/// offsets are worth less than the delay they would cause.
pub const TX_CAPACITY_BYTES: usize = 256;

/// Room that frames leave for answers, so that a client is answered while frames pile up.
const REPLY_RESERVE_BYTES: usize = 32;

/// The version of hardware and software in the answer to a client, two digits each.
const VERSION_REPLY: &[u8] = b"V1013\r";

/// Counts of errors since the start. Each stops at its largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortCounters {
    /// Lines that were refused with a BELL.
    pub malformed: u32,
    /// Frames and answers for which there was no room.
    pub dropped: u32,
}

/// Whether a client has opened the channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ChannelState {
    Closed,
    Listening,
    Open,
}

/// The adapter: bytes from the client in, bytes to the client out.
///
/// ```
/// use trueup_link::slcan::Port;
/// let mut port = Port::new(0x0001);
/// let frame = b"S8\rO\rt302403070100\r".iter().find_map(|byte| port.receive(*byte));
/// assert_eq!(frame.unwrap().payload(), [0x03, 0x07, 0x01, 0x00]);
/// let answers: Vec<u8> = core::iter::from_fn(|| port.pop()).collect();
/// assert_eq!(answers, b"\r\r\r");
/// ```
#[derive(Clone, Debug)]
pub struct Port {
    serial: u16,
    channel: ChannelState,
    lines: LineSplitter,
    /// The oldest first.
    tx: Vec<u8, TX_CAPACITY_BYTES>,
    counters: PortCounters,
    last_error: Option<SlcanError>,
}

impl Port {
    /// Returns a closed port; `serial` is the number that it gives clients, as 4 hexadecimal digits.
    #[must_use]
    pub const fn new(serial: u16) -> Self {
        Self {
            serial,
            channel: ChannelState::Closed,
            lines: LineSplitter::new(),
            tx: Vec::new(),
            counters: PortCounters { malformed: 0, dropped: 0 },
            last_error: None,
        }
    }

    /// Takes a byte from the client and answers the line that it ends; the frame, if that line
    /// was one for the board.
    pub fn receive(&mut self, byte: u8) -> Option<Frame> {
        // Taken out, because what answers the line is the rest of this port; a copy costs nothing here.
        let mut lines = core::mem::take(&mut self.lines);
        let frame = lines.push(byte).and_then(|line| self.receive_line(line));
        self.lines = lines;
        frame
    }

    /// Answers a line of the client, as a [`LineSplitter`] gives it; the frame, if it was one for the board.
    pub fn receive_line(&mut self, line: Result<&[u8], SlcanError>) -> Option<Frame> {
        match line.and_then(|line| Request::parse(line, self.channel)) {
            Ok(request) => {
                self.channel = request.channel;
                self.reply(request.command);
                request.frame
            }
            Err(error) => {
                self.counters.malformed = self.counters.malformed.saturating_add(1);
                self.last_error = Some(error);
                self.queue_reply(&[BELL]);
                None
            }
        }
    }

    /// Queues a frame for the client, its whole line or nothing; `false` if the channel is closed
    /// or there is no room. The latter is counted.
    pub fn send(&mut self, frame: &Frame) -> bool {
        self.send_all(core::slice::from_ref(frame))
    }

    /// Queues frames that belong together, all of them or none, as [`Self::send`]: half a cycle
    /// of offsets is of no use to the client.
    pub fn send_all(&mut self, frames: &[Frame]) -> bool {
        if !self.is_open() {
            return false;
        }
        let needed =
            frames.iter().map(frame_line_length).fold(REPLY_RESERVE_BYTES, usize::saturating_add);
        if needed > self.remaining_capacity() {
            let lost = u32::try_from(frames.len()).unwrap_or(u32::MAX);
            self.counters.dropped = self.counters.dropped.saturating_add(lost);
            return false;
        }
        for frame in frames {
            let (line, len) = encode_line_bytes(frame);
            self.queue_bytes(line.get(..len).unwrap_or_default());
        }
        true
    }

    /// Returns whether bytes wait to be transmitted.
    #[must_use]
    pub fn has_waiting_bytes(&self) -> bool {
        !self.tx.is_empty()
    }

    /// Takes the next byte to transmit.
    pub fn pop(&mut self) -> Option<u8> {
        let mut byte = [0];
        (self.drain_into(&mut byte) == 1).then_some(byte[0])
    }

    /// Takes the next bytes to transmit into `piece`, as many as there are and it has room for. Returns how many.
    pub fn drain_into(&mut self, piece: &mut [u8]) -> usize {
        let count = self.tx.len().min(piece.len());
        let (oldest, rest) = self.tx.split_at(count);
        piece.iter_mut().zip(oldest).for_each(|(place, byte)| *place = *byte);
        if rest.is_empty() {
            self.tx.clear();
        } else {
            self.discard_front(count);
        }
        count
    }

    /// Moves what was not taken to the front.
    // A function of its own in the image: its time is bounded by how often a full piece leaves (`cargo xtask bounds`).
    #[inline(never)]
    fn discard_front(&mut self, count: usize) {
        let left = self.tx.len().saturating_sub(count);
        self.tx.copy_within(count.., 0);
        self.tx.truncate(left);
    }

    /// Closes the channel, as the client's `C` does: nothing is queued any more, what waits still goes out.
    pub fn close(&mut self) {
        self.channel = ChannelState::Closed;
    }

    /// Returns whether a client listens.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.channel != ChannelState::Closed
    }

    /// Returns what went wrong so far.
    #[must_use]
    pub const fn counters(&self) -> PortCounters {
        self.counters
    }

    /// Why the newest refused line was refused.
    #[must_use]
    pub const fn last_error(&self) -> Option<SlcanError> {
        self.last_error
    }

    /// Answers a request that was accepted.
    fn reply(&mut self, command: Option<u8>) {
        match command {
            Some(b'V') => self.queue_reply(VERSION_REPLY),
            Some(b'N') => {
                let [high, low] = self.serial.to_be_bytes();
                let [a, b] = [hex_digit(high >> 4), hex_digit(high)];
                let [c, d] = [hex_digit(low >> 4), hex_digit(low)];
                self.queue_reply(&[b'N', a, b, c, d, CR]);
            }
            Some(b'F') => self.queue_reply(b"F00\r"),
            _ => self.queue_reply(&[CR]),
        }
    }

    /// Queues an answer whole, or counts it as dropped.
    fn queue_reply(&mut self, bytes: &[u8]) {
        if bytes.len() > self.remaining_capacity() {
            self.counters.dropped = self.counters.dropped.saturating_add(1);
        } else {
            self.queue_bytes(bytes);
        }
    }

    fn remaining_capacity(&self) -> usize {
        TX_CAPACITY_BYTES.saturating_sub(self.tx.len())
    }

    /// The caller has made sure of the room.
    // Byte by byte: a copy of a length that is not known takes longer than the few bytes of a line.
    fn queue_bytes(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let queued = self.tx.push(*byte);
            debug_assert!(queued.is_ok());
        }
    }
}

/// The content of a line that is accepted.
struct Request {
    /// `None`: the line is empty.
    command: Option<u8>,
    /// The channel from now on.
    channel: ChannelState,
    /// A frame for the board.
    frame: Option<Frame>,
}

impl Request {
    /// Reads a line that has come on this channel.
    fn parse(line: &[u8], mut channel: ChannelState) -> Result<Self, SlcanError> {
        if line.is_empty() {
            return Ok(Self { command: None, channel, frame: None });
        }
        let (command, mut fields) = LineParser::split_command(line)?;
        let mut frame = None;
        match command {
            b'O' => channel = ChannelState::Open,
            b'L' => channel = ChannelState::Listening,
            b'C' => channel = ChannelState::Closed,
            b't' => frame = Some(fields.parse_frame()?),
            b'T' => {
                fields.expect_extended_id()?;
                fields.parse_data(&mut [0; Frame::MAX_LEN])?;
            }
            b'r' => {
                fields.expect_standard_id()?;
                fields.parse_length()?;
            }
            b'R' => {
                fields.expect_extended_id()?;
                fields.parse_length()?;
            }
            b'S' => fields.expect_parameter(command, b'0'..=b'8')?,
            b'Z' => fields.expect_parameter(command, b'0'..=b'0')?,
            b'M' | b'm' => {
                fields.parse_hex(8)?;
            }
            b's' => fields.expect_hex_to_end()?,
            b'V' | b'N' | b'F' => {}
            _ => return Err(SlcanError::Command(command)),
        }
        fields.expect_end()?;
        if matches!(command, b't' | b'T' | b'r' | b'R') && channel != ChannelState::Open {
            return Err(SlcanError::NotOpen(command));
        }
        Ok(Self { command: Some(command), channel, frame })
    }
}

impl LineParser<'_> {
    fn expect_standard_id(&mut self) -> Result<(), SlcanError> {
        self.expect_id(3, u32::from(Frame::MAX_ID))
    }

    fn expect_extended_id(&mut self) -> Result<(), SlcanError> {
        self.expect_id(8, 0x1FFF_FFFF)
    }

    fn expect_id(&mut self, digits: u8, max: u32) -> Result<(), SlcanError> {
        let id = self.parse_hex(digits)?;
        if id > max {
            return Err(SlcanError::Identifier(id));
        }
        Ok(())
    }

    /// One character out of `allowed`.
    fn expect_parameter(
        &mut self,
        command: u8,
        allowed: core::ops::RangeInclusive<u8>,
    ) -> Result<(), SlcanError> {
        let found = self.next_byte()?;
        if !allowed.contains(&found) {
            return Err(SlcanError::Parameter { command, found });
        }
        Ok(())
    }

    /// At least one hexadecimal digit, and nothing else: adapters differ in how many.
    fn expect_hex_to_end(&mut self) -> Result<(), SlcanError> {
        self.parse_hex(1)?;
        while self.expect_end().is_err() {
            self.parse_hex(1)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
