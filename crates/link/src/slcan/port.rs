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

use heapless::Deque;

use super::{BELL, CR, Fields, LineSplitter, SlcanError, digit, encode_line};
use crate::frame::Frame;

/// Bytes that wait to be transmitted. One cycle of offsets is 44, so this is 5 ms of traffic: older
/// offsets are worth less than the delay they would cause.
pub const TX_CAPACITY: usize = 256;

/// Room that frames leave for answers, so that a client is answered while frames pile up.
const ANSWER_RESERVE: usize = 32;

/// The version of hardware and software that clients are told, two digits each.
const VERSION: &[u8] = b"V1013\r";

/// What went wrong since the start. Each count stops at its largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortCounters {
    /// Lines that were refused with a BELL.
    pub malformed: u32,
    /// Frames and answers for which there was no room.
    pub dropped: u32,
}

/// Whether a client has opened the channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channel {
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
    channel: Channel,
    lines: LineSplitter,
    tx: Deque<u8, TX_CAPACITY>,
    counters: PortCounters,
    last_error: Option<SlcanError>,
}

impl Port {
    /// A closed port; `serial` is the number that it tells clients, as 4 hexadecimal digits.
    #[must_use]
    pub const fn new(serial: u16) -> Self {
        Self {
            serial,
            channel: Channel::Closed,
            lines: LineSplitter::new(),
            tx: Deque::new(),
            counters: PortCounters { malformed: 0, dropped: 0 },
            last_error: None,
        }
    }

    /// Takes a byte from the client and answers the line that it ends; the frame, if that line
    /// was one for the board.
    pub fn receive(&mut self, byte: u8) -> Option<Frame> {
        let line = self.lines.push(byte)?;
        match line.and_then(|line| self.perform(&line)) {
            Ok(frame) => frame,
            Err(error) => {
                self.counters.malformed = self.counters.malformed.saturating_add(1);
                self.last_error = Some(error);
                self.answer(&[BELL]);
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
        let line_len = |frame| encode_line(frame).len();
        let needed = frames.iter().map(line_len).fold(ANSWER_RESERVE, usize::saturating_add);
        if needed > self.room() {
            let lost = u32::try_from(frames.len()).unwrap_or(u32::MAX);
            self.counters.dropped = self.counters.dropped.saturating_add(lost);
            return false;
        }
        for frame in frames {
            self.queue(encode_line(frame).as_bytes());
        }
        true
    }

    /// The next byte to transmit.
    pub fn pop(&mut self) -> Option<u8> {
        self.tx.pop_front()
    }

    /// Whether a client listens.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.channel != Channel::Closed
    }

    /// What went wrong so far.
    #[must_use]
    pub const fn counters(&self) -> PortCounters {
        self.counters
    }

    /// Why the newest refused line was refused.
    #[must_use]
    pub const fn last_error(&self) -> Option<SlcanError> {
        self.last_error
    }

    /// Does what a line asks for and answers it; an `Err` is not answered yet.
    fn perform(&mut self, line: &[u8]) -> Result<Option<Frame>, SlcanError> {
        if line.is_empty() {
            self.answer(&[CR]);
            return Ok(None);
        }
        let (command, mut fields) = Fields::of(line)?;
        let mut frame = None;
        let mut channel = self.channel;
        match command {
            b'O' => channel = Channel::Open,
            b'L' => channel = Channel::Listening,
            b'C' => channel = Channel::Closed,
            b't' => frame = Some(fields.frame()?),
            b'T' => {
                fields.extended_id()?;
                fields.data(&mut [0; Frame::MAX_LEN])?;
            }
            b'r' => {
                fields.standard_id()?;
                fields.len()?;
            }
            b'R' => {
                fields.extended_id()?;
                fields.len()?;
            }
            b'S' => fields.parameter(command, b'0'..=b'8')?,
            b'Z' => fields.parameter(command, b'0'..=b'0')?,
            b'M' | b'm' => {
                fields.hex(8)?;
            }
            b's' => fields.hex_to_end()?,
            b'V' | b'N' | b'F' => {}
            _ => return Err(SlcanError::Command(command)),
        }
        fields.end()?;
        if matches!(command, b't' | b'T' | b'r' | b'R') && channel != Channel::Open {
            return Err(SlcanError::NotOpen(command));
        }
        self.channel = channel;
        match command {
            b'V' => self.answer(VERSION),
            b'N' => {
                let [high, low] = self.serial.to_be_bytes();
                let [a, b] = [digit(high >> 4), digit(high)];
                let [c, d] = [digit(low >> 4), digit(low)];
                self.answer(&[b'N', a, b, c, d, CR]);
            }
            b'F' => self.answer(b"F00\r"),
            _ => self.answer(&[CR]),
        }
        Ok(frame)
    }

    /// Queues an answer whole, or counts it as dropped.
    fn answer(&mut self, bytes: &[u8]) {
        if bytes.len() > self.room() {
            self.counters.dropped = self.counters.dropped.saturating_add(1);
        } else {
            self.queue(bytes);
        }
    }

    fn room(&self) -> usize {
        TX_CAPACITY.saturating_sub(self.tx.len())
    }

    /// The caller has made sure of the room.
    fn queue(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let queued = self.tx.push_back(*byte);
            debug_assert!(queued.is_ok());
        }
    }
}

impl Fields<'_> {
    fn standard_id(&mut self) -> Result<(), SlcanError> {
        self.id_up_to(3, u32::from(Frame::MAX_ID))
    }

    fn extended_id(&mut self) -> Result<(), SlcanError> {
        self.id_up_to(8, 0x1FFF_FFFF)
    }

    fn id_up_to(&mut self, digits: u8, max: u32) -> Result<(), SlcanError> {
        let id = self.hex(digits)?;
        if id > max {
            return Err(SlcanError::Identifier(id));
        }
        Ok(())
    }

    /// One character out of `allowed`.
    fn parameter(
        &mut self,
        command: u8,
        allowed: core::ops::RangeInclusive<u8>,
    ) -> Result<(), SlcanError> {
        let found = self.next()?;
        if !allowed.contains(&found) {
            return Err(SlcanError::Parameter { command, found });
        }
        Ok(())
    }

    /// At least one hexadecimal digit, and nothing else: adapters differ in how many.
    fn hex_to_end(&mut self) -> Result<(), SlcanError> {
        self.hex(1)?;
        while self.end().is_err() {
            self.hex(1)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slcan::MAX_FRAME_LINE;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn drain(port: &mut Port) -> Vec<u8> {
        core::iter::from_fn(|| port.pop()).collect()
    }

    /// Sends text to the port; the frames for the board, and everything that the client reads.
    fn talk(port: &mut Port, text: &[u8]) -> (Vec<Frame>, Vec<u8>) {
        let frames = text.iter().filter_map(|byte| port.receive(*byte)).collect();
        (frames, drain(port))
    }

    fn opened() -> Port {
        let mut port = Port::new(0xA001);
        assert_eq!(talk(&mut port, b"O\r").1, b"\r");
        port
    }

    fn frame(len: usize) -> Frame {
        Frame::new(0x181, &[0xAB; 8][..len]).unwrap()
    }

    #[test]
    fn python_can_opens_sends_and_leaves() {
        let mut port = Port::new(1);
        // It sets the bit rate between a close and an open, sends an empty line for the data bit
        // rate that it has not, and opens once more.
        let (frames, answers) = talk(&mut port, b"C\rS8\r\rO\rO\r");
        assert_eq!((frames.len(), &answers[..]), (0, &b"\r\r\r\r\r"[..]));
        assert!(port.is_open());
        let (frames, answers) = talk(&mut port, b"t3028B4E6090300000000\rV\rN\r");
        assert_eq!(frames[0].id(), 0x302);
        assert_eq!(frames[0].payload(), [0xB4, 0xE6, 9, 3, 0, 0, 0, 0]);
        assert_eq!(answers, b"\rV1013\rN0001\r");
        talk(&mut port, b"C\r");
        assert!(!port.is_open());
        assert_eq!(port.counters(), PortCounters::default());
    }

    #[test]
    fn slcand_opens_after_a_line_left_over_by_another_client() {
        let mut port = Port::new(1);
        let (frames, answers) = talk(&mut port, b"t30C\rS6\rF\rO\r");
        assert_eq!((frames.len(), &answers[..]), (0, &b"\x07\rF00\r\r"[..]));
        assert!(port.is_open());
    }

    #[test]
    fn commands_without_effect_are_answered_and_change_nothing() {
        for line in [
            "",
            "S0",
            "S1",
            "S2",
            "S3",
            "S4",
            "S5",
            "S6",
            "S7",
            "S8",
            "Z0",
            "M00000000",
            "mFFFFFFFF",
            "s031C",
            "s0",
            "s00AB12",
            "O",
            "T000001818AABBCCDDEEFF0011",
            "T1FFFFFFF0",
            "r1810",
            "r7FF8",
            "R1FFFFFFF8",
        ] {
            let mut port = opened();
            let text = [line.as_bytes(), b"\r"].concat();
            assert_eq!(talk(&mut port, &text), (Vec::new(), b"\r".to_vec()), "{line}");
            assert!(port.is_open());
            assert_eq!(port.counters(), PortCounters::default());
        }
    }

    #[test]
    fn every_malformed_line_is_answered_by_one_bell_and_counted() {
        for line in [
            "t",
            "t1",
            "t181",
            "t1811",
            "t1811A",
            "t1811AABB",
            "t18119G",
            "t1819",
            "t8000",
            "tFFF0",
            "t18190011223344556677",
            "t 810",
            "O1",
            "C0",
            "L ",
            "V1",
            "N1",
            "F0",
            "S",
            "S9",
            "SA",
            "S88",
            "Z",
            "Z1",
            "Z00",
            "M",
            "M0000000",
            "M000000000",
            "m0000000G",
            "s",
            "sG",
            "s0G",
            "T1810",
            "T200000000",
            "T000001811",
            "r1819",
            "r18",
            "r18100",
            "r8000",
            "R1810",
            "R200000000",
            "x",
            "o",
            "0",
            "\u{7}",
            "X1",
            "oooooooooooooooooooooooooooooooooooooooo",
        ] {
            let mut port = opened();
            let text = [line.as_bytes(), b"\r"].concat();
            assert_eq!(talk(&mut port, &text), (Vec::new(), [BELL].to_vec()), "{line}");
            assert_eq!(port.counters().malformed, 1, "{line}");
            assert!(port.last_error().is_some() && port.is_open());
            assert_eq!(talk(&mut port, b"t7010\r").0.len(), 1, "the line after {line}");
        }
    }

    #[test]
    fn a_closed_channel_takes_and_gives_no_frame() {
        let mut port = Port::new(1);
        for line in [&b"t3020\r"[..], b"T000003020\r", b"r3020\r", b"R000003020\r"] {
            assert_eq!(talk(&mut port, line), (Vec::new(), [BELL].to_vec()));
            assert_eq!(port.last_error(), Some(SlcanError::NotOpen(line[0])));
        }
        assert!(!port.send(&frame(8)));
        assert_eq!(port.pop(), None);
        assert_eq!(port.counters().dropped, 0);
    }

    #[test]
    fn a_client_that_only_listens_hears_frames_but_sends_none() {
        let mut port = Port::new(1);
        talk(&mut port, b"L\r");
        assert!(port.is_open() && port.send(&frame(0)));
        assert_eq!(drain(&mut port), b"t1810\r");
        assert_eq!(talk(&mut port, b"t3020\r"), (Vec::new(), [BELL].to_vec()));
    }

    #[test]
    fn line_feeds_are_passed_over() {
        let mut port = Port::new(1);
        let (frames, answers) = talk(&mut port, b"O\r\n\nt30\n20\r\n");
        assert_eq!((frames.len(), &answers[..]), (1, &b"\r\r"[..]));
    }

    #[test]
    fn frames_that_find_no_room_are_dropped_whole_and_answers_still_fit() {
        let mut port = opened();
        let pair = [frame(8), frame(8)];
        let mut queued = 0;
        while port.send_all(&pair) {
            queued += 1;
        }
        assert_eq!(queued, 5, "milliseconds of traffic");
        assert_eq!(port.counters().dropped, 2);
        for byte in b"V\r" {
            port.receive(*byte);
        }
        let expected = [&b"t1818ABABABABABABABAB\r".repeat(10)[..], b"V1013\r"].concat();
        assert_eq!(drain(&mut port), expected);
        assert!(port.send(&frame(8)), "there is room again");
    }

    #[test]
    fn answers_that_find_no_room_are_dropped_whole_and_counted() {
        let mut port = opened();
        for _ in 0..100 {
            port.receive(b'V');
            port.receive(CR);
        }
        let fitting = TX_CAPACITY / VERSION.len();
        assert_eq!(drain(&mut port), VERSION.repeat(fitting));
        assert_eq!(port.counters().dropped, 100 - u32::try_from(fitting).unwrap());
    }

    #[test]
    fn the_longest_line_of_a_standard_frame_is_as_stated() {
        assert_eq!(encode_line(&frame(8)).len(), MAX_FRAME_LINE);
    }

    proptest! {
        #[test]
        fn no_bytes_panic_and_every_line_gets_exactly_one_answer(
            bytes in prop::collection::vec(
                prop_oneof![any::<u8>(), prop::sample::select(&b"\r\rtTrRSOCZMs0123478AF"[..])],
                0..400,
            ),
        ) {
            let mut port = Port::new(1);
            let mut refused = 0;
            for byte in bytes {
                let frame = port.receive(byte);
                let answer = drain(&mut port);
                let ends = answer.iter().filter(|byte| [CR, BELL].contains(byte)).count();
                prop_assert_eq!(ends, usize::from(byte == CR));
                refused += u32::from(answer == [BELL]);
                prop_assert_eq!(port.counters().malformed, refused);
                prop_assert!(frame.is_none() || answer == [CR]);
            }
            prop_assert_eq!(port.counters().dropped, 0);
        }

        #[test]
        fn a_frame_goes_through_the_port_both_ways(
            id in 0_u16..0x800, payload in prop::collection::vec(any::<u8>(), 0..=8),
        ) {
            let sent = Frame::new(id, &payload).unwrap();
            let mut port = opened();
            prop_assert!(port.send(&sent));
            let line = drain(&mut port);
            prop_assert_eq!(talk(&mut port, &line).0, [sent]);
        }
    }
}
