//! A CAN interface of Linux: frames without a line of SLCAN between.
//!
//! The interface is the system's: its bit rate is set, and it is switched on, by `ip link` or
//! `slcand` before.

use std::{
    io,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail};
use socketcan::{CanFrame, CanSocket, EmbeddedFrame as _, Id, Socket as _, StandardId};
use trueup_link::frame::Frame;

/// An open interface.
pub struct Socket(CanSocket);

impl Socket {
    /// Opens an interface, which must be up.
    pub fn open(interface: &str) -> Result<Self> {
        let socket = CanSocket::open(interface).with_context(|| {
            format!(
                "the CAN interface {interface} cannot be opened; is it up (ip link set {interface} \
                 up type can bitrate 1000000)?"
            )
        })?;
        Ok(Self(socket))
    }

    /// Sends a frame.
    pub fn send(&self, frame: &Frame) -> Result<()> {
        let id = StandardId::new(frame.id()).context("11 bits")?;
        let frame = CanFrame::new(id, frame.payload()).context("8 bytes at most")?;
        self.0.write_frame_insist(&frame).context("the CAN interface takes no frame")
    }

    /// The next standard data frame; `None` if there is none until `deadline`.
    pub fn receive(&self, deadline: Instant) -> Result<Option<Frame>> {
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if left < Duration::from_millis(1) {
                return Ok(None);
            }
            match self.0.read_frame_timeout(left) {
                Ok(CanFrame::Data(frame)) => {
                    if let Id::Standard(id) = frame.id() {
                        return Ok(Frame::new(id.as_raw(), frame.data()).ok());
                    }
                }
                Ok(_) => {}
                Err(error) if error.kind() == io::ErrorKind::TimedOut => return Ok(None),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => bail!("the CAN interface is gone: {error}"),
            }
        }
    }
}
