//! A CAN interface of Linux, spoken to in the lines of SLCAN that every other port carries.
//!
//! The interface is the system's: its bit rate is set, and it is switched on, by `ip link` or
//! `slcand` before. So the lines that open an adapter's channel have nothing to open here, and are
//! answered by nothing.

use std::{
    io::{self, Read, Write},
    sync::Arc,
};

use socketcan::{CanFrame, CanSocket, EmbeddedFrame as _, Id, Socket as _, StandardId};
use trueup_link::{
    frame::Frame,
    slcan::{AdapterMessage, SlcanClient, encode_line},
};

use crate::duplex_stream::{DuplexStream, READ_TIMEOUT};

/// Opens an interface, which must be up.
pub fn open(interface: &str) -> io::Result<DuplexStream> {
    let socket = CanSocket::open(interface).map_err(|error| {
        let text = format!(
            "the CAN interface {interface} cannot be opened; is it up (ip link set {interface} up \
             type can bitrate 1000000)?: {error}"
        );
        io::Error::new(error.kind(), text)
    })?;
    Ok(create_slcan_stream(Arc::new(socket)))
}

/// The bus that frames go through.
trait CanBus: Send + Sync + 'static {
    fn send(&self, frame: &Frame) -> io::Result<()>;

    /// Returns the next standard data frame. Anything else, or nothing for [`READ_TIMEOUT`], fails as timed
    /// out.
    fn receive(&self) -> io::Result<Frame>;
}

impl CanBus for CanSocket {
    fn send(&self, frame: &Frame) -> io::Result<()> {
        let id = StandardId::new(frame.id());
        let frame = id.and_then(|id| CanFrame::new(id, frame.payload()));
        let frame = frame.ok_or(io::ErrorKind::InvalidInput)?;
        self.write_frame_insist(&frame).map_err(|error| {
            io::Error::new(error.kind(), format!("the CAN interface takes no frame: {error}"))
        })
    }

    fn receive(&self) -> io::Result<Frame> {
        use io::ErrorKind::{Interrupted, TimedOut};
        let frame = self.read_frame_timeout(READ_TIMEOUT).map_err(|error| match error.kind() {
            TimedOut | Interrupted => error,
            kind => io::Error::new(kind, format!("the CAN interface is gone: {error}")),
        })?;
        let frame = match (&frame, frame.id()) {
            (CanFrame::Data(data), Id::Standard(id)) => Frame::new(id.as_raw(), data.data()).ok(),
            _ => None,
        };
        frame.ok_or(TimedOut.into())
    }
}

fn create_slcan_stream<B: CanBus>(bus: Arc<B>) -> DuplexStream {
    let writer = SlcanWriter { bus: bus.clone(), lines: SlcanClient::new() };
    (Box::new(SlcanReader { bus, rest: Vec::new() }), Box::new(writer))
}

/// Frames come out as lines.
struct SlcanReader<B> {
    bus: Arc<B>,
    /// Of a line that was begun.
    rest: Vec<u8>,
}

impl<B: CanBus> Read for SlcanReader<B> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.rest.is_empty() {
            self.rest = encode_line(&self.bus.receive()?).into_bytes().to_vec();
        }
        let length = self.rest.len().min(buffer.len());
        buffer[..length].copy_from_slice(&self.rest[..length]);
        self.rest.drain(..length);
        Ok(length)
    }
}

/// Sends the frames of the lines that go in; other lines have no receiver.
struct SlcanWriter<B> {
    bus: Arc<B>,
    lines: SlcanClient,
}

impl<B: CanBus> Write for SlcanWriter<B> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        for &byte in bytes {
            if let Some(AdapterMessage::Frame(frame)) = self.lines.receive(byte) {
                self.bus.send(&frame)?;
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::duplex_stream::is_timeout;
    use std::sync::Mutex;
    use trueup_link::slcan::client;

    /// A bus on which each frame comes back once.
    #[derive(Default)]
    struct Echo(Mutex<Vec<Frame>>);

    impl CanBus for Echo {
        fn send(&self, frame: &Frame) -> io::Result<()> {
            self.0.lock().expect("nobody panics with it").push(*frame);
            Ok(())
        }

        fn receive(&self) -> io::Result<Frame> {
            let mut frames = self.0.lock().expect("nobody panics with it");
            if frames.is_empty() {
                Err(io::ErrorKind::TimedOut.into())
            } else {
                Ok(frames.remove(0))
            }
        }
    }

    #[test]
    fn lines_become_frames_and_frames_lines_in_pieces_of_any_size() {
        let frames =
            [Frame::new(0x181, &[1, 2, 0xAB]), Frame::new(0x000, &[]), Frame::new(0x7FF, &[9; 8])];
        let frames = frames.map(|frame| frame.expect("short"));
        let text: String = frames.iter().map(|frame| encode_line(frame).to_string()).collect();
        for piece in [1, 2, 7, 100] {
            let bus = Arc::new(Echo::default());
            let (mut reader, mut writer) = create_slcan_stream(bus.clone());
            writer.write_all(client::OPEN_SEQUENCE).expect("passed over");
            for part in text.as_bytes().chunks(piece) {
                writer.write_all(part).expect("the bus takes all");
            }
            writer.write_all(b"V\rt9").expect("passed over");
            assert_eq!(*bus.0.lock().expect("nobody panics with it"), frames);

            let (mut back, mut bytes) = (Vec::new(), vec![0; piece]);
            let late = loop {
                match reader.read(&mut bytes) {
                    Ok(length) => back.extend_from_slice(&bytes[..length]),
                    Err(error) => break error,
                }
            };
            assert_eq!(String::from_utf8_lossy(&back), text);
            assert!(is_timeout(&late));
        }
    }
}
