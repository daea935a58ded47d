//! Where a bridge is, and the bytes or frames to and from it.

use std::{
    io::{self, Read, Write},
    net::{TcpStream, ToSocketAddrs as _},
    time::Duration,
};

use anyhow::{Context as _, Result};

use crate::Mend;

/// The speed of the bridge's serial line.
pub const BAUD: u32 = 921_600;
/// How long a bridge may take to be connected, or to take in a few bytes.
const PATIENCE: Duration = Duration::from_secs(3);
/// How long a read waits for bytes: short, so that a deadline is met without them too.
const READ_TIMEOUT: Duration = Duration::from_millis(20);

/// Bytes to and from a bridge. A read that finds none for a while fails as timed out.
pub trait Stream: Read + Write {}

impl<S: Read + Write> Stream for S {}

/// Where a bridge is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Port {
    /// `tcp:HOST:PORT`.
    Tcp(String),
    /// A serial device.
    Serial(String),
    /// A CAN interface of Linux.
    Can(String),
}

/// What an open port is.
pub enum Line {
    /// Lines of SLCAN.
    Slcan(Box<dyn Stream>),
    /// Frames.
    #[cfg(all(feature = "socketcan", target_os = "linux"))]
    Can(super::socket_can::Socket),
}

impl Port {
    /// Reads what the user wrote.
    pub fn parse(text: &str) -> Result<Self, Mend> {
        const FORMS: &str = "a port is tcp:HOST:PORT, a serial device, such as /dev/ttyACM0, or a CAN interface, can0";
        if let Some(address) = text.strip_prefix("tcp:") {
            let is_right = address.rsplit_once(':').is_some_and(|(host, number)| {
                !host.is_empty() && number.parse::<u16>().is_ok_and(|number| number != 0)
            });
            return if is_right {
                Ok(Self::Tcp(address.into()))
            } else {
                Err(Mend(format!("--port \"{text}\": after tcp: comes HOST:PORT; {FORMS}")))
            };
        }
        if is_numbered(text, &["can", "vcan", "slcan"]) {
            return Ok(Self::Can(text.into()));
        }
        if text.contains(['/', '\\']) || is_numbered(text, &["COM"]) {
            return Ok(Self::Serial(text.into()));
        }
        Err(Mend(format!("--port \"{text}\": {FORMS}")))
    }

    /// What a log of frames calls it: a line of SLCAN as `slcand` would name its interface.
    pub fn interface(&self) -> &str {
        match self {
            Self::Can(interface) => interface,
            Self::Tcp(_) | Self::Serial(_) => "can0",
        }
    }

    /// Connects to the bridge.
    pub fn open(&self) -> Result<Line> {
        match self {
            Self::Tcp(address) => Ok(Line::Slcan(Box::new(connect(address)?))),
            Self::Serial(device) => {
                let serial = serialport::new(device, BAUD)
                    .timeout(READ_TIMEOUT)
                    .open()
                    .with_context(|| format!("the serial device {device} cannot be opened"))?;
                Ok(Line::Slcan(Box::new(serial)))
            }
            #[cfg(all(feature = "socketcan", target_os = "linux"))]
            Self::Can(interface) => Ok(Line::Can(super::socket_can::Socket::open(interface)?)),
            #[cfg(not(all(feature = "socketcan", target_os = "linux")))]
            Self::Can(interface) => Err(Mend(format!(
                "--port {interface}: this tool was built without SocketCAN; build it on Linux by \
                 cargo build --release -p trueup-cli --features socketcan"
            ))
            .into()),
        }
    }
}

/// Whether `text` is one of `names` with a number after it.
fn is_numbered(text: &str, names: &[&str]) -> bool {
    names.iter().any(|name| {
        text.strip_prefix(name)
            .is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|byte| byte.is_ascii_digit()))
    })
}

fn connect(address: &str) -> Result<TcpStream> {
    let context =
        || format!("no connection to tcp:{address}; is a bridge listening there (cargo virtual)?");
    let mut last = io::Error::from(io::ErrorKind::AddrNotAvailable);
    for resolved in address.to_socket_addrs().with_context(context)? {
        match TcpStream::connect_timeout(&resolved, PATIENCE) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                stream.set_read_timeout(Some(READ_TIMEOUT))?;
                stream.set_write_timeout(Some(PATIENCE))?;
                return Ok(stream);
            }
            Err(error) => last = error,
        }
    }
    Err(last).with_context(context)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_are_told_apart_by_their_form() {
        for (text, port) in [
            ("tcp:localhost:3333", Port::Tcp("localhost:3333".into())),
            ("tcp:[::1]:3333", Port::Tcp("[::1]:3333".into())),
            ("/dev/ttyACM0", Port::Serial("/dev/ttyACM0".into())),
            ("COM3", Port::Serial("COM3".into())),
            ("can0", Port::Can("can0".into())),
            ("vcan1", Port::Can("vcan1".into())),
            ("slcan0", Port::Can("slcan0".into())),
            (r"\\.\COM12", Port::Serial(r"\\.\COM12".into())),
        ] {
            assert_eq!(Port::parse(text).expect(text), port);
        }
    }

    #[test]
    fn what_is_no_port_of_this_version_is_refused_by_name() {
        for (text, phrase) in [
            ("can", "a port is"),
            ("tcp:localhost", "after tcp: comes HOST:PORT"),
            ("tcp:localhost:x", "after tcp: comes HOST:PORT"),
            ("tcp::3333", "after tcp: comes HOST:PORT"),
            ("localhost:3333", "a port is tcp:HOST:PORT, a serial device"),
            ("", "a port is"),
        ] {
            let error = Port::parse(text).expect_err(text).to_string();
            assert!(error.contains(phrase), "{error}");
        }
    }
}
