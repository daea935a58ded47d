//! The host's end of the line: frames and answers out of what an adapter sends.

use super::{BELL, LineBuffer, LineSplitter, SlcanError, decode_line};
use crate::frame::Frame;

/// The lines with which a client starts over with an adapter in any state: ends a line that was left over, closes, sets
/// 1 Mbit/s, switches time stamps off, which an adapter keeps over a power cut, and opens.
pub const OPEN_SEQUENCE: &[u8] = b"\rC\rS8\rZ0\rO\r";
/// Line that a client sends to leave.
pub const CLOSE_COMMAND: &[u8] = b"C\r";

/// Message of an adapter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AdapterMessage {
    /// A frame from the bus.
    Frame(Frame),
    /// The oldest line that is not answered yet was accepted.
    Accepted,
    /// The oldest line that is not answered yet was refused.
    Rejected,
    /// Something else: version, serial number, status, or a frame that is not a standard data
    /// frame.
    Other(LineBuffer),
    /// A data frame that cannot be read, or a line that is too long.
    Malformed(SlcanError),
}

/// Reads what an adapter sends, byte by byte.
///
/// ```
/// use trueup_link::slcan::{SlcanClient, AdapterMessage};
/// let mut client = SlcanClient::new();
/// let mut heard = b"\r\x07t70117F\r".iter().filter_map(|byte| client.receive(*byte));
/// assert_eq!(heard.next(), Some(AdapterMessage::Accepted));
/// assert_eq!(heard.next(), Some(AdapterMessage::Rejected));
/// assert!(matches!(heard.next(), Some(AdapterMessage::Frame(frame)) if frame.payload() == [0x7F]));
/// ```
#[derive(Clone, Debug, Default)]
pub struct SlcanClient {
    lines: LineSplitter,
}

impl SlcanClient {
    /// At the start of a line.
    #[must_use]
    pub const fn new() -> Self {
        Self { lines: LineSplitter::new() }
    }

    /// Takes a byte from the adapter; returns its message, with the byte that ends it.
    pub fn receive(&mut self, byte: u8) -> Option<AdapterMessage> {
        if byte == BELL {
            // A refusal is a line of its own, without an end; what stood before it is cut off.
            self.lines = LineSplitter::new();
            return Some(AdapterMessage::Rejected);
        }
        Some(match self.lines.push(byte)? {
            Err(error) => AdapterMessage::Malformed(error),
            // `z` is how adapters with automatic polling accept a frame.
            Ok(line) if line.is_empty() || line == b"z" => AdapterMessage::Accepted,
            Ok(line) if line.first() == Some(&b't') => decode_line(strip_timestamp(line))
                .map_or_else(AdapterMessage::Malformed, AdapterMessage::Frame),
            Ok(line) => AdapterMessage::Other(LineBuffer::from_slice(line).unwrap_or_default()),
        })
    }
}

/// Returns a frame's line without the time that some adapters add to it (`Z1`): 4 digits of ms, or 8 of µs.
fn strip_timestamp(line: &[u8]) -> &[u8] {
    let Some(length) = line.get(4).and_then(|digit| char::from(*digit).to_digit(16)) else {
        return line;
    };
    let data = usize::try_from(length.min(8)).unwrap_or_default();
    let whole = data.saturating_mul(2).saturating_add(5);
    match line.get(whole..) {
        Some(stamp) if matches!(stamp.len(), 4 | 8) && stamp.iter().all(u8::is_ascii_hexdigit) => {
            line.get(..whole).unwrap_or(line)
        }
        _ => line,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slcan::{CR, Port};
    use proptest::prelude::*;
    use std::vec::Vec;

    #[test]
    fn a_stamped_frame_is_the_frame_and_other_digits_are_malformed() {
        let of = |line: &[u8]| {
            let mut client = SlcanClient::new();
            line.iter().chain(b"\r").find_map(|byte| client.receive(*byte))
        };
        let plain = of(b"t18121234");
        assert!(matches!(plain, Some(AdapterMessage::Frame(_))));
        for stamp in [&b"EA5F"[..], b"0012ab9F"] {
            assert_eq!(of(&[b"t18121234", stamp].concat()), plain);
        }
        for wrong in [&b"1"[..], b"12", b"123456", b"12G4"] {
            assert!(matches!(
                of(&[b"t18121234", wrong].concat()),
                Some(AdapterMessage::Malformed(_))
            ));
        }
    }

    fn received(client: &mut SlcanClient, port: &mut Port) -> Vec<AdapterMessage> {
        let bytes = core::iter::from_fn(|| port.pop());
        bytes.filter_map(|byte| client.receive(byte)).collect()
    }

    #[test]
    fn a_client_opens_a_port_in_any_state_and_receives_its_frames() {
        for left_over in [&b""[..], b"O\r", b"L\rt1", b"tttttttttttttttttttttttttttttttttttttt"] {
            let (mut client, mut port) = (SlcanClient::new(), Port::new(1));
            for byte in left_over {
                port.receive(*byte);
            }
            received(&mut client, &mut port);
            for byte in OPEN_SEQUENCE {
                port.receive(*byte);
            }
            let answers = received(&mut client, &mut port);
            assert_eq!(answers.len(), 5);
            assert!(answers[1..].iter().all(|answer| *answer == AdapterMessage::Accepted));
            let frame = Frame::new(0x281, &[1, 2, 3]).unwrap();
            assert!(port.send(&frame));
            assert_eq!(received(&mut client, &mut port), [AdapterMessage::Frame(frame)]);
            for byte in CLOSE_COMMAND {
                port.receive(*byte);
            }
            assert!(!port.is_open());
        }
    }

    #[test]
    fn a_client_that_joins_in_mid_line_loses_that_line_alone() {
        let mut client = SlcanClient::new();
        let text = b"AABB\rt181\rt70105\rt701105\rV1013\rz\r";
        let events: Vec<_> = text.iter().filter_map(|byte| client.receive(*byte)).collect();
        assert_eq!(events.len(), 6);
        assert!(matches!(events[0], AdapterMessage::Other(_)));
        assert_eq!(events[1], AdapterMessage::Malformed(SlcanError::Truncated { len: 4 }));
        assert_eq!(
            events[2],
            AdapterMessage::Malformed(SlcanError::Trailing { at: 5, found: b'5' })
        );
        assert_eq!(events[3], AdapterMessage::Frame(Frame::new(0x701, &[5]).unwrap()));
        assert!(matches!(&events[4], AdapterMessage::Other(line) if line == b"V1013"));
        assert_eq!(events[5], AdapterMessage::Accepted);
    }

    proptest! {
        #[test]
        fn no_bytes_panic_and_every_end_is_one_event(
            bytes in prop::collection::vec(
                prop_oneof![any::<u8>(), prop::sample::select(&b"\r\x07t0123478AF"[..])],
                0..400,
            ),
        ) {
            let mut client = SlcanClient::new();
            for byte in bytes {
                prop_assert_eq!(client.receive(byte).is_some(), [CR, BELL].contains(&byte));
            }
        }
    }
}
