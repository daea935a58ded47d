//! The CNC's end of the link: SLCAN over any byte stream, as a CNC would use it.

use std::{
    collections::VecDeque,
    io::{Read, Write},
};

use anyhow::{Context as _, Result, bail};
use trueup_core::cnc::{CncMessage, Control, LinearAxis, Output};
use trueup_link::{
    frames,
    receiver::OffsetReceiver,
    slcan::{AdapterMessage, SlcanClient, encode_line},
};

/// A CNC on an SLCAN line.
pub struct CncClient<S> {
    stream: S,
    client: SlcanClient,
    waiting: VecDeque<AdapterMessage>,
    control_counter: u8,
    /// The bridge has received three times that nothing is engaged: it gives no offset before.
    has_begun: bool,
    spindle_counter: u8,
    position_counters: [u8; 3],
    rotary_counter: u8,
    conditions_counter: u8,
    /// The pairing and checking of the offsets.
    pub offsets: OffsetReceiver,
}

impl<S: Read + Write> CncClient<S> {
    /// Opens the channel as every SLCAN program does: close, 1 Mbit/s, open. The version is requested
    /// in between, because its answer can be distinguished from everything that an earlier client may
    /// have left: half a line either way, frames, answers.
    ///
    /// # Errors
    /// The line breaks, or the board refuses.
    pub fn open(stream: S) -> Result<Self> {
        let mut cnc = Self {
            stream,
            client: SlcanClient::new(),
            waiting: VecDeque::new(),
            control_counter: 0,
            has_begun: false,
            spindle_counter: 0,
            position_counters: [0; 3],
            rotary_counter: 0,
            conditions_counter: 0,
            offsets: OffsetReceiver::new(),
        };
        cnc.write(b"\rC\rV\r")?;
        while !matches!(cnc.next_event()?, AdapterMessage::Other(line) if line.starts_with(b"V")) {}
        for command in ["S8", "O"] {
            cnc.query(command)?;
        }
        Ok(cnc)
    }

    /// Sends a line and waits for its answer; frames that come meanwhile are kept.
    ///
    /// # Errors
    /// The line breaks, or the board refuses.
    pub fn query(&mut self, line: &str) -> Result<String> {
        self.write(format!("{line}\r").as_bytes())?;
        let mut retained = VecDeque::new();
        let answer = loop {
            match self.next_event()? {
                AdapterMessage::Accepted => break String::new(),
                AdapterMessage::Other(text) => break String::from_utf8_lossy(&text).into_owned(),
                AdapterMessage::Rejected => bail!("the board refuses the line {line:?}"),
                event @ (AdapterMessage::Frame(_) | AdapterMessage::Malformed(_)) => {
                    retained.push_back(event)
                }
            }
        };
        retained.append(&mut self.waiting);
        self.waiting = retained;
        Ok(answer)
    }

    /// Sends bytes as they are.
    ///
    /// # Errors
    /// The line breaks.
    pub fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.stream.write_all(bytes).context("the line to the board is broken")
    }

    /// Sends a command in its frame, and waits until the board has taken it.
    ///
    /// # Errors
    /// The line breaks, or the board refuses.
    pub fn send_message(&mut self, command: CncMessage) -> Result<()> {
        if matches!(command, CncMessage::Control(control) if control.engage) && !self.has_begun {
            self.has_begun = true;
            for _ in frames::disengaged_control_frames() {
                self.send_message(CncMessage::Control(Control::REFERENCED))?;
            }
        }
        let (frame, counter) = match command {
            CncMessage::Control(control) => {
                (frames::encode_control(control, self.control_counter), &mut self.control_counter)
            }
            CncMessage::Spindle(spindle) => {
                (frames::encode_spindle(spindle, self.spindle_counter), &mut self.spindle_counter)
            }
            CncMessage::Position(position) => {
                let [x, y, z] = &mut self.position_counters;
                let counter = match position.axis {
                    LinearAxis::X => x,
                    LinearAxis::Y => y,
                    LinearAxis::Z => z,
                };
                (frames::encode_position(position, *counter), counter)
            }
            CncMessage::Rotary(rotary) => {
                (frames::encode_rotary(rotary, self.rotary_counter), &mut self.rotary_counter)
            }
            CncMessage::Conditions(conditions) => (
                frames::encode_conditions(conditions, self.conditions_counter),
                &mut self.conditions_counter,
            ),
        };
        *counter = counter.wrapping_add(1);
        self.query(encode_line(&frame).trim_end()).map(drop)
    }

    /// Confirms what the board requires first, by an edge of `Confirm`; without an open question it changes nothing.
    ///
    /// # Errors
    /// The line breaks, or the board refuses.
    pub fn send_confirmation(&mut self) -> Result<()> {
        for confirm in [false, true, false] {
            for _ in 0..frames::disengaged_control_frames().len() {
                self.send_message(CncMessage::Control(Control { confirm, ..Control::REFERENCED }))?;
            }
        }
        Ok(())
    }

    /// Returns the next offsets of which both frames have come and are valid.
    ///
    /// # Errors
    /// The line breaks.
    pub fn next_output(&mut self) -> Result<Output> {
        loop {
            if let AdapterMessage::Frame(frame) = self.next_event()? {
                // What is refused is counted in `offsets`.
                if let Ok(Some(output)) = self.offsets.accept(&frame) {
                    return Ok(output);
                }
            }
        }
    }

    /// Returns the next thing that comes over the line.
    ///
    /// # Errors
    /// The line breaks.
    pub fn next_event(&mut self) -> Result<AdapterMessage> {
        let mut bytes = [0; 4096];
        loop {
            if let Some(event) = self.waiting.pop_front() {
                return Ok(event);
            }
            let length = self.stream.read(&mut bytes).context("the line to the board is broken")?;
            if length == 0 {
                bail!("the board has closed the line");
            }
            let client = &mut self.client;
            self.waiting.extend(bytes[..length].iter().filter_map(|&byte| client.receive(byte)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io;
    use trueup_core::{
        cnc::{AxisPosition, RotaryAxisAngles, TravelDirection},
        units::Position,
    };
    use trueup_link::{frame::Frame, receiver::CncReceiver};

    /// A board that answers what the test says.
    struct Script {
        answers: io::Cursor<Vec<u8>>,
        requests: Vec<u8>,
    }

    impl Read for Script {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            // One byte at a time: lines are cut anywhere.
            self.answers.read(&mut buffer[..1])
        }
    }

    impl Write for Script {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.requests.write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn it_opens_as_every_slcan_program_does_and_keeps_frames_that_come_between() {
        // The end of a line, the answer to half a line, to C and to V, then to S8 and O.
        let answers = b"05\r\x07\rV1013\r\rt7011\x305\r\rV1013\r".to_vec();
        let script = Script { answers: io::Cursor::new(answers), requests: Vec::new() };
        let mut cnc = CncClient::open(script).expect("three answers");
        assert_eq!(cnc.stream.requests, b"\rC\rV\rS8\rO\r");
        assert_eq!(cnc.query("V").expect("an answer"), "V1013");
        let heartbeat = Frame::new(0x701, &[5]).expect("valid");
        assert_eq!(cnc.next_event().expect("kept"), AdapterMessage::Frame(heartbeat));
    }

    #[test]
    fn a_refusal_names_the_line() {
        let script =
            Script { answers: io::Cursor::new(b"\r\rV1013\r\x07".to_vec()), requests: Vec::new() };
        let error = CncClient::open(script).err().expect("refused");
        assert!(error.to_string().contains("\"S8\""), "{error}");
    }

    #[test]
    fn every_identifier_counts_for_itself() {
        let answers = [&b"\rV1013\r\r\r"[..], &b"z\r".repeat(12)].concat();
        let script = Script { answers: io::Cursor::new(answers), requests: Vec::new() };
        let mut cnc = CncClient::open(script).expect("three answers");
        for _ in 0..3 {
            for axis in LinearAxis::ALL {
                let direction = TravelDirection::Positive;
                let there = AxisPosition { axis, position: Position(5), direction };
                cnc.send_message(CncMessage::Position(there)).expect("accepted");
            }
            cnc.send_message(CncMessage::Rotary(RotaryAxisAngles::default())).expect("accepted");
        }
        let mut receiver = CncReceiver::new();
        let mut client = SlcanClient::new();
        for &byte in &cnc.stream.requests {
            if let Some(AdapterMessage::Frame(frame)) = client.receive(byte) {
                receiver.accept(&frame).expect("in order");
            }
        }
        let counters = receiver.counters();
        assert_eq!((counters.accepted, counters.lost), (12, 0));
    }
}
