//! One client's time on the bridge's line: open, receive, request, close.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Error, Result, bail};
use trueup_core::cnc::Control;
use trueup_link::{
    frame::Frame,
    frames,
    slcan::{AdapterMessage, SlcanClient, client, encode_line},
};

use crate::{
    duplex_stream::{DuplexStream, is_busy, is_timeout},
    port::PortAddress,
    port_holder::port_holder,
};

/// How long a bridge may take to open its channel.
const OPEN_TIMEOUT: Duration = Duration::from_secs(3);
/// How long is waited for the last answer: what a leaving client does not read may be lost with
/// what it has written.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(300);
/// How long a bridge that restarts may take until it has opened its channel again, and for each
/// of the tries meanwhile.
const RESTART_TIMEOUT: Duration = Duration::from_secs(10);
const OPEN_ATTEMPT_TIMEOUT: Duration = Duration::from_millis(500);
/// From one `Control` with `Service` to the next: a fifth of the link timeout that is usual.
const SERVICE_PERIOD: Duration = Duration::from_millis(100);
/// The lines in [`client::OPEN_SEQUENCE`], each of which a bridge answers.
const OPEN_COMMAND_COUNT: usize = 5;
/// An adapter that answers in a way of its own has opened its channel if frames still come so long after it was asked:
/// what an earlier client was being sent has come by then.
const DRAIN_TIME: Duration = Duration::from_secs(1);
/// Between lines that are sent one by one, to an adapter that reads only the first line of a packet.
const INTER_COMMAND_DELAY: Duration = Duration::from_millis(30);

/// An open channel.
pub struct Session {
    ends: DuplexStream,
    has_adapter: bool,
    client: SlcanClient,
    pending_events: VecDeque<AdapterMessage>,
    /// The tool's own `Control` where there is no CNC, its counter, and when it is due.
    service: Option<(Control, u8, Instant)>,
}

impl Session {
    /// Connects to the bridge and opens its channel.
    ///
    /// # Errors
    /// The port cannot be opened, or what is behind it is silent or refuses.
    pub fn open(port: &PortAddress) -> Result<Self> {
        let ends = port.open().map_err(|error| match port {
            PortAddress::Tcp(address) => Error::from(error).context(format!(
                "no connection to tcp:{address}; is a bridge listening there (trueup virtual)?"
            )),
            PortAddress::Serial(device) if is_busy(&error) => Error::from(error).context(format!(
                "the serial device {device} is busy: {} talks to the bridge; end it first",
                port_holder(port)
                    .unwrap_or_else(|| "another program (a monitor, LinuxCNC, slcand)".into())
            )),
            PortAddress::Serial(device) => {
                Error::from(error).context(format!("the serial device {device} cannot be opened"))
            }
            // It has reported it itself.
            #[cfg(all(feature = "socketcan", target_os = "linux"))]
            PortAddress::Can(_) => error.into(),
        })?;
        let mut session = Self::from_stream(ends, port.uses_slcan());
        session.open_channel(OPEN_TIMEOUT).map_err(|error| match port_holder(port) {
            Some(other) => error.context(format!(
                "the bridge serves one program at a time, and {other} has it: end it first"
            )),
            None => error,
        })?;
        Ok(session)
    }

    /// Opens the channel of a bridge whose line is open already.
    ///
    /// # Errors
    /// The device behind it is silent or refuses.
    pub fn open_on_stream(ends: DuplexStream) -> Result<Self> {
        let mut session = Self::from_stream(ends, true);
        session.open_channel(OPEN_TIMEOUT)?;
        Ok(session)
    }

    fn from_stream(ends: DuplexStream, has_adapter: bool) -> Self {
        Self {
            ends,
            has_adapter,
            client: SlcanClient::new(),
            pending_events: VecDeque::new(),
            service: None,
        }
    }

    /// Opens the channel again of a bridge that restarts, and has not yet, or just now.
    ///
    /// # Errors
    /// Those of [`Self::open`], if they last for 10 s.
    pub(crate) fn reopen_channel(&mut self) -> Result<()> {
        let deadline = Instant::now() + RESTART_TIMEOUT;
        loop {
            match self.open_channel(OPEN_ATTEMPT_TIMEOUT) {
                Err(error) if Instant::now() > deadline => return Err(error),
                Err(_) => {}
                Ok(()) => return Ok(()),
            }
        }
    }

    /// Opens the channel, whatever an earlier client has left behind.
    ///
    /// All lines are written at once, as `slcand` and python-can do: a virtual bridge may answer
    /// none of them before it has seen the last. A bridge answers each. Adapters of others may refuse some, or
    /// answer none: then the channel is open if frames come.
    fn open_channel(&mut self, timeout: Duration) -> Result<()> {
        if !self.has_adapter {
            return Ok(());
        }
        self.write(client::OPEN_SEQUENCE)?;
        let start = Instant::now();
        let mut answers = 0;
        let mut is_refused = false;
        let mut is_one_by_one = false;
        loop {
            if answers >= OPEN_COMMAND_COUNT && !is_refused {
                return Ok(());
            }
            let look = if is_one_by_one {
                start + timeout
            } else {
                start + (DRAIN_TIME + OPEN_ATTEMPT_TIMEOUT).min(timeout)
            };
            match self.next_event(look)? {
                Some(AdapterMessage::Accepted) => (answers, is_refused) = (answers + 1, false),
                Some(AdapterMessage::Rejected) => (answers, is_refused) = (answers + 1, true),
                Some(AdapterMessage::Frame(_)) if start.elapsed() >= DRAIN_TIME => return Ok(()),
                // What an earlier client was still being sent.
                Some(
                    AdapterMessage::Frame(_)
                    | AdapterMessage::Malformed(_)
                    | AdapterMessage::Other(_),
                ) => {}
                None if !is_one_by_one && timeout > DRAIN_TIME => {
                    is_one_by_one = true;
                    if answers < OPEN_COMMAND_COUNT {
                        self.send_open_commands()?;
                    }
                }
                None if is_refused && answers >= OPEN_COMMAND_COUNT => {
                    bail!("the bridge refuses to open its channel, and sends no frame")
                }
                None => bail!(
                    "the bridge has answered {answers} of {OPEN_COMMAND_COUNT} lines in {} s. \
                     Is it a bridge, is it powered, and does no other program talk to it? It \
                     serves one at a time",
                    timeout.as_secs_f64()
                ),
            }
        }
    }

    /// Opens the channel by one line after the other.
    fn send_open_commands(&mut self) -> Result<()> {
        for line in client::OPEN_SEQUENCE.split_inclusive(|byte| *byte == b'\r').skip(1) {
            std::thread::sleep(INTER_COMMAND_DELAY);
            self.write(line)?;
        }
        Ok(())
    }

    /// Sends `Control` with `Service` from now on, as long as events are waited for: for a bridge
    /// that receives no CNC.
    pub(crate) fn start_sending_service_frames(&mut self) {
        self.start_sending_control_frames(Control { service: true, ..Control::default() });
    }

    /// Sends this `Control` from now on, in the same way.
    pub(crate) fn start_sending_control_frames(&mut self, control: Control) {
        self.service = Some((control, 0, Instant::now()));
    }

    /// Returns whether it does.
    #[must_use]
    pub(crate) const fn is_sending_service_frames(&self) -> bool {
        self.service.is_some()
    }

    /// Ends that.
    pub(crate) fn stop_sending_service_frames(&mut self) {
        self.service = None;
    }

    /// Sends `Control`, if it is due.
    fn send_control(&mut self) -> Result<()> {
        let now = Instant::now();
        let Some((control, counter, due)) = self.service.filter(|(.., due)| now >= *due) else {
            return Ok(());
        };
        self.service = Some((control, counter.wrapping_add(1), due.max(now) + SERVICE_PERIOD));
        self.send(&frames::encode_control(control, counter))
    }

    /// Sends lines, whose answers come as events. Where the port has no adapter, only frames are
    /// received by anyone.
    ///
    /// # Errors
    /// The line is broken.
    pub fn write(&mut self, lines: &[u8]) -> Result<()> {
        let (_, writer) = &mut self.ends;
        let written = writer.write_all(lines).and_then(|()| writer.flush());
        written.context("the line to the bridge is broken")
    }

    /// Sends a frame.
    ///
    /// # Errors
    /// The line is broken.
    pub fn send(&mut self, frame: &Frame) -> Result<()> {
        self.write(encode_line(frame).as_bytes())
    }

    /// Returns the next thing that the bridge says; `None` if there is nothing until `deadline`.
    ///
    /// # Errors
    /// The line is broken, or closed at its other end.
    pub fn next_event(&mut self, deadline: Instant) -> Result<Option<AdapterMessage>> {
        let mut bytes = [0; 4096];
        loop {
            // Looked at first, so that a flood of frames does not postpone what is due.
            if Instant::now() >= deadline {
                return Ok(None);
            }
            self.send_control()?;
            if let Some(event) = self.pending_events.pop_front() {
                return Ok(Some(event));
            }
            let (reader, _) = &mut self.ends;
            let length = match reader.read(&mut bytes) {
                Ok(0) => bail!("the bridge has closed the line"),
                Ok(length) => length,
                Err(error) if is_timeout(&error) => continue,
                Err(error) => return Err(error).context("the line to the bridge is broken"),
            };
            let client = &mut self.client;
            self.pending_events
                .extend(bytes[..length].iter().filter_map(|&byte| client.receive(byte)));
        }
    }

    /// Closes the channel. Whether the bridge learns of it does not matter to one who leaves.
    pub fn close(mut self) {
        if self.has_adapter && self.write(client::CLOSE_COMMAND).is_ok() {
            let deadline = Instant::now() + CLOSE_TIMEOUT;
            while let Ok(Some(event)) = self.next_event(deadline) {
                if event == AdapterMessage::Accepted {
                    break;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{self, Read};

    /// A bridge that says what the test says, a byte at a time, and then nothing.
    struct Script(VecDeque<u8>);

    impl Read for Script {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            match self.0.pop_front() {
                Some(byte) => buffer[0] = byte,
                None => {
                    std::thread::sleep(Duration::from_millis(5));
                    return Err(io::ErrorKind::TimedOut.into());
                }
            }
            Ok(1)
        }
    }

    fn open(answers: &[u8]) -> Result<Session> {
        let script = Script(answers.iter().copied().collect());
        let mut session = Session::from_stream((Box::new(script), Box::new(io::sink())), true);
        session.open_channel(OPEN_TIMEOUT)?;
        Ok(session)
    }

    #[test]
    fn a_channel_opens_whatever_was_left_on_the_line() {
        for before in [&b"\r"[..], b"\x07", b"\r\x07", b"AABB\rt701105\r\r", b"t7011\x07"] {
            let answers = [before, b"t701105\r\r\r\r\rt701105\rt701105\r"].concat();
            let mut session = open(&answers).expect("opens");
            let mut next = || session.next_event(Instant::now() + OPEN_TIMEOUT).expect("no fault");
            // Where the end of a frame has passed for an answer, one answer is left over.
            let events = [next(), next()];
            assert!(matches!(
                events,
                [Some(AdapterMessage::Frame(_)), _] | [_, Some(AdapterMessage::Frame(_))]
            ));
        }
    }

    #[test]
    fn a_refusal_or_silence_is_reported() {
        let refused = open(b"\r\r\r\r\x07").err().expect("refused").to_string();
        assert!(refused.contains("refuses"), "{refused}");
        let silent = open(b"\r\r").err().expect("silent").to_string();
        assert!(silent.contains("2 of 5 lines in 3 s"), "{silent}");
    }

    /// An adapter that answers in its own way: `answers` at once, and frames once it is open.
    struct Adapter {
        script: Script,
        lines: std::sync::mpsc::Receiver<Vec<u8>>,
        /// Writes that it reads, of which it takes the first line alone.
        first_lines: bool,
        is_open: bool,
    }

    impl Read for Adapter {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            while let Ok(written) = self.lines.try_recv() {
                let mut lines = written.split(|byte| *byte == b'\r');
                let takes = if self.first_lines { 1 } else { usize::MAX };
                self.is_open |= lines.by_ref().take(takes).any(|line| line == b"O");
            }
            if self.is_open && self.script.0.is_empty() {
                self.script.0.extend(b"t701105\r");
            }
            self.script.read(buffer)
        }
    }

    struct Lines(std::sync::mpsc::Sender<Vec<u8>>);

    impl io::Write for Lines {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.send(bytes.to_vec()).ok();
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn an_adapter_that_refuses_answers_nothing_or_reads_line_by_line_is_open_if_frames_come() {
        for (answers, first_lines) in [
            (&b"\x07\x07\x07\x07\x07"[..], false),
            (b"\r\r\r\x07\x07", false),
            (b"", false),
            (b"\r", true),
        ] {
            let (sender, lines) = std::sync::mpsc::channel();
            let script = Script(answers.iter().copied().collect());
            let adapter = Adapter { script, lines, first_lines, is_open: false };
            let mut session =
                Session::from_stream((Box::new(adapter), Box::new(Lines(sender))), true);
            session.open_channel(OPEN_TIMEOUT).expect("frames come");
        }
    }

    #[test]
    fn where_nothing_answers_no_channel_is_opened_or_closed_and_frames_pass() {
        let reader = Script(b"t701105\r".iter().copied().collect());
        let (mut bridge, ours) = io::pipe().expect("this machine has pipes");
        let mut session = Session::from_stream((Box::new(reader), Box::new(ours)), false);
        session.open_channel(OPEN_TIMEOUT).expect("there is nothing to open");
        let received = session.next_event(Instant::now() + OPEN_TIMEOUT).expect("no fault");
        let Some(AdapterMessage::Frame(frame)) = received else { panic!("{received:?}") };
        session.send(&frame).expect("the pipe takes it");
        session.reopen_channel().expect("there is nothing to open");
        session.close();
        let mut sent = String::new();
        bridge.read_to_string(&mut sent).expect("the other end is closed");
        assert_eq!(sent, "t701105\r");
    }
}
