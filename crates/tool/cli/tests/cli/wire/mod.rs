//! The wire between a tool and the bridge of a test: one tool after the other, and frames that were damaged on it.

use std::{
    io::{ErrorKind, Read, Write},
    net::{TcpListener, TcpStream},
    thread,
};

use trueup_link::frame::Frame;

/// One tool after the other on the same bridge.
pub struct Tools {
    pub listener: TcpListener,
    pub stream: Option<TcpStream>,
}

impl Read for Tools {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        if let Some(stream) = &mut self.stream {
            match stream.read(bytes) {
                Ok(0) => self.stream = None,
                read => return read,
            }
        }
        let (stream, _) = self.listener.accept()?;
        stream.set_nonblocking(true)?;
        stream.set_nodelay(true)?;
        self.stream = Some(stream);
        Err(ErrorKind::WouldBlock.into())
    }
}

impl Write for Tools {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        match &mut self.stream {
            Some(stream) => match stream.write(bytes) {
                Err(error) if error.kind() != ErrorKind::WouldBlock => Ok(bytes.len()),
                written => written,
            },
            None => Ok(bytes.len()),
        }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Writes all bytes: a socket that does not block may take them in parts.
pub fn write_all(stream: &mut impl Write, mut bytes: &[u8]) -> std::io::Result<()> {
    while !bytes.is_empty() {
        match stream.write(bytes) {
            Ok(taken) => bytes = &bytes[taken..],
            Err(error) if error.kind() == ErrorKind::WouldBlock => thread::yield_now(),
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Returns the frame with a bit flipped.
pub fn damaged(frame: &Frame) -> Frame {
    let mut data = *frame.data();
    data[5] ^= 0x04;
    Frame::new(frame.id(), &data[..frame.len().into()]).expect("the frame's own identifier")
}

/// Bytes and frames that the bridge has received from its client.
#[derive(Default)]
pub struct ReceivedBytes {
    pub bytes: Vec<u8>,
    pub frames: usize,
}
