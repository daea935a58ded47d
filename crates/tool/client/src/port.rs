//! Where a bridge is, and both directions of the line to it.
//!
//! Whatever the port is, lines of SLCAN go through it; a CAN interface of Linux is given them by an
//! adapter in this process.

use std::{
    io,
    net::{TcpStream, ToSocketAddrs as _},
    time::Duration,
};

use socket2::SockRef;

use crate::{
    UnusableInputError,
    duplex_stream::{DuplexStream, READ_TIMEOUT},
};

/// The speed of the bridge's serial line.
pub(crate) const BRIDGE_BAUD_RATE: u32 = 921_600;
/// How long a bridge may take to be connected, or to take in a few bytes.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// Where a bridge is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortAddress {
    /// A TCP connection, written `tcp:HOST:PORT`.
    Tcp(String),
    /// A serial device.
    Serial(String),
    /// A CAN interface of Linux. Only a build that can open it has such a port.
    #[cfg(all(feature = "socketcan", target_os = "linux"))]
    Can(String),
}

impl PortAddress {
    /// Reads what the user wrote.
    ///
    /// # Errors
    /// It has none of the forms of a port, or is one that this build cannot open.
    pub fn parse(text: &str) -> Result<Self, UnusableInputError> {
        if let Some(address) = text.strip_prefix("tcp:") {
            let is_right = address.rsplit_once(':').is_some_and(|(host, number)| {
                !host.is_empty() && number.parse::<u16>().is_ok_and(|number| number != 0)
            });
            return if is_right {
                Ok(Self::Tcp(address.into()))
            } else {
                Err(UnusableInputError::NoAddress { text: text.into() })
            };
        }
        if is_numbered_device(text, &["can", "vcan", "slcan"]) {
            #[cfg(all(feature = "socketcan", target_os = "linux"))]
            return Ok(Self::Can(text.into()));
            #[cfg(not(all(feature = "socketcan", target_os = "linux")))]
            return Err(UnusableInputError::NoSocketCan { interface: text.into() });
        }
        if text.contains(['/', '\\']) || is_numbered_device(text, &["COM"]) {
            return Ok(Self::Serial(text.into()));
        }
        Err(UnusableInputError::NoPort { text: text.into() })
    }

    /// Returns what a log of frames calls it: a line of SLCAN as `slcand` would name its interface.
    #[must_use]
    pub fn interface_name(&self) -> &str {
        match self {
            Self::Tcp(_) | Self::Serial(_) => "can0",
            #[cfg(all(feature = "socketcan", target_os = "linux"))]
            Self::Can(interface) => interface,
        }
    }

    /// Returns whether an adapter of SLCAN answers behind it: the bridge itself, whose channel has to be
    /// opened and which says who it is. Behind a CAN interface nothing answers but frames.
    #[must_use]
    pub const fn uses_slcan(&self) -> bool {
        match self {
            Self::Tcp(_) | Self::Serial(_) => true,
            #[cfg(all(feature = "socketcan", target_os = "linux"))]
            Self::Can(_) => false,
        }
    }

    /// Connects to the bridge.
    ///
    /// # Errors
    /// Nothing listens there, there is no such device or interface, or it is another's.
    pub fn open(&self) -> io::Result<DuplexStream> {
        match self {
            Self::Tcp(address) => {
                let stream = connect(address)?;
                stream.set_nodelay(true)?;
                SockRef::from(&stream).set_send_buffer_size(MAX_SEND_BACKLOG_BYTES)?;
                stream.set_read_timeout(Some(READ_TIMEOUT))?;
                stream.set_write_timeout(Some(CONNECT_TIMEOUT))?;
                Ok((Box::new(stream.try_clone()?), Box::new(stream)))
            }
            Self::Serial(device) => {
                let serial =
                    serialport::new(device, BRIDGE_BAUD_RATE).timeout(READ_TIMEOUT).open()?;
                Ok((Box::new(serial.try_clone()?), Box::new(serial)))
            }
            #[cfg(all(feature = "socketcan", target_os = "linux"))]
            Self::Can(interface) => crate::socket_can::open(interface),
        }
    }
}

/// Returns whether `text` is one of `names` with a number after it.
fn is_numbered_device(text: &str, names: &[&str]) -> bool {
    names.iter().any(|name| {
        text.strip_prefix(name)
            .is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|byte| byte.is_ascii_digit()))
    })
}

/// Bytes that may wait for a bridge which is slow to take them: positions that wait for longer are of
/// no use, and the sender would rather leave some out. The system takes it as a hint.
const MAX_SEND_BACKLOG_BYTES: usize = 4_096;

/// To the first of the name's addresses that answers.
fn connect(address: &str) -> io::Result<TcpStream> {
    let mut last = io::Error::from(io::ErrorKind::AddrNotAvailable);
    for resolved in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&resolved, CONNECT_TIMEOUT) {
            Ok(stream) => return Ok(stream),
            Err(error) => last = error,
        }
    }
    Err(last)
}

#[cfg(test)]
mod tests {
    use std::io::{Read as _, Write as _};

    use super::*;
    use crate::duplex_stream::is_timeout;
    use std::{
        net::TcpListener,
        time::{Duration, Instant},
    };

    #[test]
    fn ports_are_distinguished_by_their_form() {
        for (text, port) in [
            ("tcp:localhost:3333", PortAddress::Tcp("localhost:3333".into())),
            ("tcp:[::1]:3333", PortAddress::Tcp("[::1]:3333".into())),
            ("/dev/ttyACM0", PortAddress::Serial("/dev/ttyACM0".into())),
            ("COM3", PortAddress::Serial("COM3".into())),
            (r"\\.\COM12", PortAddress::Serial(r"\\.\COM12".into())),
        ] {
            assert_eq!(PortAddress::parse(text).expect(text), port);
            assert!(port.uses_slcan() && port.interface_name() == "can0", "{text}");
        }
    }

    #[cfg(all(feature = "socketcan", target_os = "linux"))]
    #[test]
    fn a_can_interface_goes_by_its_name_and_has_no_adapter() {
        for text in ["can0", "vcan1", "slcan0"] {
            let port = PortAddress::parse(text).expect(text);
            assert_eq!((&port, port.interface_name()), (&PortAddress::Can(text.into()), text));
            assert!(!port.uses_slcan(), "{text}");
        }
    }

    #[cfg(not(all(feature = "socketcan", target_os = "linux")))]
    #[test]
    fn a_can_interface_that_this_build_cannot_open_is_no_port_at_all() {
        for text in ["can0", "vcan1", "slcan0"] {
            let error = PortAddress::parse(text).expect_err(text).to_string();
            let phrase = format!("--port {text}: this tool was built without SocketCAN");
            assert!(
                error.starts_with(&phrase) && error.contains("without --no-default-features"),
                "{error}"
            );
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
            let error = PortAddress::parse(text).expect_err(text).to_string();
            assert!(error.contains(phrase), "{error}");
        }
    }

    #[test]
    fn an_open_line_goes_both_ways_and_a_read_without_bytes_is_timeout() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let number = listener.local_addr().expect("bound above").port();
        // The name may have an address of the other family too, where no server listens.
        let port = PortAddress::Tcp(format!("localhost:{number}"));
        let (mut reader, mut writer) = port.open().expect("it listens");
        let (mut bridge, _) = listener.accept().expect("it has connected");
        let mut bytes = [0; 4];
        writer.write_all(b"V\rN\r").expect("open");
        bridge.read_exact(&mut bytes).expect("written above");
        assert_eq!(&bytes, b"V\rN\r");

        let start = Instant::now();
        let late = reader.read(&mut bytes).expect_err("nothing was sent");
        assert!(is_timeout(&late) && start.elapsed() < Duration::from_secs(1), "{late}");
        bridge.write_all(b"\r").expect("open");
        reader.read_exact(&mut bytes[..1]).expect("written above");
        drop(bridge);
        assert_eq!(reader.read(&mut bytes).expect("an end is not an error"), 0);
        drop(listener);
        assert!(!is_timeout(&port.open().err().expect("nobody listens")));
    }
}
