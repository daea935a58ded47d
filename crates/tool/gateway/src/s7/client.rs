//! The little of S7 communication that a data block needs: connect, write bytes, read bytes.
//!
//! ```text
//!  TPKT (RFC 1006)   03 00 length
//!  COTP (ISO 8073)   connect request, confirm; data: 02 F0 80
//!  S7                32 kind 00 00 reference  length of parameters, of data  [error]
//!                    F0 set up: jobs, jobs, PDU length     04 read   05 write: one item, area DB
//! ```
//!
//! A CPU answers within the timeout or the connection is given up: the caller makes a new one. An
//! answer is read to its length however the network cuts it, must bear the reference of its request,
//! and is believed only as far as it reaches.

use std::{
    io::{self, Read as _, Write as _},
    net::{TcpStream, ToSocketAddrs as _},
    time::Duration,
};

/// The port of ISO-on-TCP.
pub(crate) const ISO_ON_TCP_PORT: u16 = 102;
/// How long the CPU may take for anything.
const RESPONSE_TIMEOUT: Duration = Duration::from_millis(500);
/// How long it may take to connect.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);
/// The PDU that is requested; the smallest CPUs grant 240.
const REQUESTED_PDU_LENGTH: u16 = 480;
/// The bytes of a write next to its data: header, one item, head of the data.
const WRITE_OVERHEAD_BYTES: usize = 28;
const TPKT_HEADER_LEN: usize = 4;
const COTP_DATA_HEADER: [u8; 3] = [0x02, 0xF0, 0x80];
const ROSCTR_JOB: u8 = 1;
/// With data, or without: what is refused may have none.
const ROSCTR_ACK_DATA: u8 = 3;
const ROSCTR_ACK: u8 = 2;
const FUNCTION_SETUP_COMMUNICATION: u8 = 0xF0;
const FUNCTION_READ: u8 = 4;
const FUNCTION_WRITE: u8 = 5;
const RETURN_CODE_OK: u8 = 0xFF;
/// An S7 "basic" connection, next to those of programming devices and panels.
const CONNECTION_TYPE_BASIC: u8 = 3;

/// Where a CPU is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CpuAddress {
    /// HOST or HOST:PORT.
    pub address: String,
    /// Rack 0…7.
    pub rack: u8,
    /// Slot 0…31; 2 for the CPU of a 300 and of an 840D sl.
    pub slot: u8,
}

/// Why a CPU does not execute a request.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The network: no such host, no listener, a line that is cut, no answer in time.
    #[error("the PLC {}", network_error_text(.0))]
    Io(io::Error),
    /// It answers, but what is none of the protocol's answers.
    #[error("what answers is no S7: {0}")]
    Answer(&'static str),
    /// It refuses, with class and code of its error.
    #[error("the PLC refuses: error class 0x{0:02X}, code 0x{1:02X}; {advice}", advice = error_class_advice(*.0))]
    Refused(u8, u8),
    /// The data block is not there, too short, or closed to others; the item's code.
    #[error("{}", describe_item_error(*.0))]
    Item(u8),
    /// The bytes read back are not those written.
    #[error("what is read back is not what was written: does another write to this data block?")]
    NotStored,
}

fn network_error_text(error: &io::Error) -> String {
    match trueup_client::duplex_stream::is_timeout(error) {
        true => "does not answer in time".into(),
        false => format!("cannot be reached: {error}"),
    }
}

fn error_class_advice(class: u8) -> &'static str {
    match class {
        0x81 => {
            "permit access with PUT/GET (S7-1200, S7-1500: CPU properties, Protection) and switch off \
             \"Optimized block access\" of the data block"
        }
        // Servers on PCs say 0x84, 0x04 where a CPU has codes of an item.
        _ => {
            "check the number of the data block (--db), its length (trueup_db.awl of integrations/siemens-840d) and its attribute \"Optimized block access\"; check PUT/GET (CPU properties, Protection)"
        }
    }
}

fn describe_item_error(code: u8) -> String {
    let text = match code {
        0x0A => {
            "the PLC has no such data block, or it is stored as optimized: look at its number (--db) and at its \
             attribute \"Optimized block access\""
        }
        0x05 => {
            "the data block is too short, or stored as optimized: compare its length with trueup_db.awl of \
             integrations/siemens-840d, and look at its attribute \"Optimized block access\""
        }
        0x03 => {
            "the PLC does not let others at this data block: permit access with PUT/GET (CPU properties, \
             Protection) and switch off its know-how and write protection"
        }
        _ => return format!("the PLC does not do it: return code 0x{code:02X}"),
    };
    text.into()
}

impl From<io::Error> for Error {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// A connection to a CPU.
#[derive(Debug)]
pub(crate) struct S7Client {
    stream: TcpStream,
    reference: u16,
    pdu_length: usize,
}

impl S7Client {
    /// Connects, and agrees on the length of a PDU.
    ///
    /// # Errors
    /// The CPU cannot be reached, or it is no CPU, or not in this slot.
    pub fn connect(place: &CpuAddress) -> Result<Self, Error> {
        let stream = connect_tcp(&place.address)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(RESPONSE_TIMEOUT))?;
        stream.set_write_timeout(Some(RESPONSE_TIMEOUT))?;
        let mut client =
            Self { stream, reference: 0, pdu_length: usize::from(REQUESTED_PDU_LENGTH) };
        let slot = (place.rack & 7) << 5 | (place.slot & 31);
        client.send(&[
            0x11,
            0xE0,
            0,
            0,
            0,
            1,
            0, // connect request, references, class 0
            0xC0,
            1,
            0x0A, // TPDU of 1024 bytes
            0xC1,
            2,
            1,
            0, // our TSAP
            0xC2,
            2,
            CONNECTION_TYPE_BASIC,
            slot, // the CPU's
        ])?;
        match client.receive()?[..] {
            [_, 0xD0, ..] => {}
            _ => return Err(Error::Answer("it does not confirm the connection (rack, slot?)")),
        }
        let [high, low] = REQUESTED_PDU_LENGTH.to_be_bytes();
        let (answer, _) =
            client.execute_job(&[FUNCTION_SETUP_COMMUNICATION, 0, 0, 1, 0, 1, high, low], &[])?;
        match answer[..] {
            [FUNCTION_SETUP_COMMUNICATION, _, _, _, _, _, high, low] => {
                client.pdu_length = usize::from(u16::from_be_bytes([high, low]));
            }
            _ => return Err(Error::Answer("it does not agree on a length")),
        }
        Ok(client)
    }

    /// Writes bytes into a data block, in one job, so that they arrive together.
    ///
    /// # Errors
    /// The CPU does not take them, or the line is broken. At most as many as fit a PDU.
    pub fn write(&mut self, db: u16, start: usize, bytes: &[u8]) -> Result<(), Error> {
        if bytes.len() + WRITE_OVERHEAD_BYTES > self.pdu_length {
            return Err(Error::Answer("its PDU is too short for the block"));
        }
        let bits = to_u16(8 * bytes.len())?.to_be_bytes();
        let data = [&[0, 4][..], &bits, bytes].concat();
        let (parameters, answer) = self
            .execute_job(&encode_job_parameters(FUNCTION_WRITE, db, start, bytes.len())?, &data)?;
        match (&parameters[..], &answer[..]) {
            ([FUNCTION_WRITE, 1], [RETURN_CODE_OK, ..]) => Ok(()),
            ([FUNCTION_WRITE, 1], &[code, ..]) => Err(Error::Item(code)),
            _ => Err(Error::Answer("to a write")),
        }
    }

    /// Reads bytes out of a data block, in one job.
    ///
    /// # Errors
    /// The CPU does not give them, or the line is broken.
    pub fn read(&mut self, db: u16, start: usize, bytes: &mut [u8]) -> Result<(), Error> {
        let (parameters, answer) =
            self.execute_job(&encode_job_parameters(FUNCTION_READ, db, start, bytes.len())?, &[])?;
        let bits = to_u16(8 * bytes.len())?.to_be_bytes();
        match (&parameters[..], &answer[..]) {
            ([FUNCTION_READ, 1], [RETURN_CODE_OK, 4, high, low, data @ ..])
                if [*high, *low] == bits && data.len() >= bytes.len() =>
            {
                bytes.copy_from_slice(&data[..bytes.len()]);
                Ok(())
            }
            ([FUNCTION_READ, 1], [code, ..]) if *code != RETURN_CODE_OK => Err(Error::Item(*code)),
            _ => Err(Error::Answer("to a read")),
        }
    }

    /// Parameters and data of the answer to a job.
    fn execute_job(&mut self, parameters: &[u8], data: &[u8]) -> Result<(Vec<u8>, Vec<u8>), Error> {
        self.reference = self.reference.wrapping_add(1);
        let reference = self.reference.to_be_bytes();
        let lengths =
            [to_u16(parameters.len())?.to_be_bytes(), to_u16(data.len())?.to_be_bytes()].concat();
        let header = [&[0x32, ROSCTR_JOB, 0, 0][..], &reference, &lengths].concat();
        self.send(&[&COTP_DATA_HEADER, &header[..], parameters, data].concat())?;
        let answer = self.receive()?;
        let Some(answer) = answer.strip_prefix(&COTP_DATA_HEADER) else {
            return Err(Error::Answer("a telegram in parts"));
        };
        let &[
            0x32,
            ROSCTR_ACK_DATA | ROSCTR_ACK,
            _,
            _,
            r0,
            r1,
            p0,
            p1,
            d0,
            d1,
            class,
            code,
            ref rest @ ..,
        ] = answer
        else {
            return Err(Error::Answer("no answer to a job"));
        };
        if [r0, r1] != reference {
            return Err(Error::Answer("an answer to another job"));
        }
        if (class, code) != (0, 0) {
            return Err(Error::Refused(class, code));
        }
        let (parameters, data) =
            [[p0, p1], [d0, d1]].map(u16::from_be_bytes).map(usize::from).into();
        match rest.split_at_checked(parameters) {
            Some((parameters, rest)) if rest.len() >= data => {
                Ok((parameters.to_vec(), rest[..data].to_vec()))
            }
            _ => Err(Error::Answer("cut off")),
        }
    }

    fn send(&mut self, payload: &[u8]) -> Result<(), Error> {
        let [high, low] = to_u16(TPKT_HEADER_LEN + payload.len())?.to_be_bytes();
        Ok(self.stream.write_all(&[&[3, 0, high, low], payload].concat())?)
    }

    fn receive(&mut self) -> Result<Vec<u8>, Error> {
        let mut header = [0; TPKT_HEADER_LEN];
        self.stream.read_exact(&mut header)?;
        let [3, _, high, low] = header else { return Err(Error::Answer("no TPKT")) };
        let length = usize::from(u16::from_be_bytes([high, low]));
        let Some(length) = length.checked_sub(TPKT_HEADER_LEN) else {
            return Err(Error::Answer("a TPKT without a length"));
        };
        let mut payload = vec![0; length];
        self.stream.read_exact(&mut payload)?;
        Ok(payload)
    }
}

/// Parameters of a job on bytes of a data block.
fn encode_job_parameters(
    function: u8,
    db: u16,
    start: usize,
    length: usize,
) -> Result<[u8; 14], Error> {
    const TRANSPORT_SIZE_BYTE: u8 = 2;
    const AREA_DATA_BLOCK: u8 = 0x84;
    let [l0, l1] = to_u16(length)?.to_be_bytes();
    let [d0, d1] = db.to_be_bytes();
    // In bits; three bytes hold them.
    let [_, a0, a1, a2] = (u32::from(to_u16(start)?) << 3).to_be_bytes();
    Ok([
        function,
        1,
        0x12,
        0x0A,
        0x10,
        TRANSPORT_SIZE_BYTE,
        l0,
        l1,
        d0,
        d1,
        AREA_DATA_BLOCK,
        a0,
        a1,
        a2,
    ])
}

fn to_u16(length: usize) -> Result<u16, Error> {
    u16::try_from(length).map_err(|_| Error::Answer("too long for a telegram"))
}

/// To the first of the name's addresses that answers.
fn connect_tcp(address: &str) -> io::Result<TcpStream> {
    let has_port = address
        .rsplit_once(':')
        .is_some_and(|(host, port)| !host.contains(':') && port.parse::<u16>().is_ok());
    let addresses = if has_port {
        address.to_socket_addrs()?
    } else {
        (address, ISO_ON_TCP_PORT).to_socket_addrs()?
    };
    let mut last = io::Error::from(io::ErrorKind::AddrNotAvailable);
    for address in addresses {
        match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
            Ok(stream) => return Ok(stream),
            Err(error) => last = error,
        }
    }
    Err(last)
}

#[cfg(test)]
pub(super) mod tests;
