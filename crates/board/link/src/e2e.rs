//! AUTOSAR E2E profile 5: shows a receiver that a frame is whole, meant for it, new and in order.
//!
//! ```text
//! byte   0      1      2        3 … 7
//!        CRC low, high  counter  data
//! CRC = CRC-16 (polynomial 0x1021, start 0xFFFF, not reflected, no final XOR)
//!       over byte 2 … last, then the data ID's low byte, then its high byte
//! ```
//!
//! The data ID is the CAN identifier: a frame that arrives under another identifier fails.

use crc::{CRC_16_IBM_3740, Crc};

use crate::frame::Frame;

/// CRC and counter, in bytes: what a protected frame has at least.
pub const HEADER_LEN: usize = 3;

/// The largest step of the counter that is still taken for lost frames.
///
/// 15 `Control` frames of 20 ms are 300 ms, most of the default silence after which the CNC counts
/// as lost (500 ms). 15 position or `Rotary` frames of 2 ms are 30 ms: after a longer gap one such
/// frame is refused, the one behind it is taken, and the position is 2 ms older once, of the 500 ms
/// that it may be old. A wider step would buy those 2 ms with more restarted senders that pass for
/// ones that lost frames: now 15 of 256, of the others one frame is refused.
pub const MAX_DELTA_COUNTER: u8 = 15;

static CRC: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_3740);

/// Puts the counter and the CRC into the first three bytes of a frame.
///
/// ```
/// let mut data = [0, 0, 0, 0x11, 0x22, 0x33, 0x44, 0x55];
/// trueup_link::e2e::protect(0x0181, 0x00, &mut data);
/// assert_eq!(data, [0x8B, 0xCB, 0x00, 0x11, 0x22, 0x33, 0x44, 0x55]);
/// ```
pub fn protect(data_id: u16, counter: u8, data: &mut [u8; 8]) {
    data[2] = counter;
    let [_, _, covered @ ..] = &*data;
    let [low, high] = compute_frame_crc(data_id, covered).to_le_bytes();
    data[0] = low;
    data[1] = high;
}

/// Returns the CRC over the bytes after the CRC field, and the data ID.
fn compute_frame_crc(data_id: u16, covered: &[u8]) -> u16 {
    compute_crc(data_id, [covered])
}

/// Returns the CRC of the profile over these parts, one behind the other, and the data ID.
pub fn compute_crc(data_id: u16, parts: impl IntoIterator<Item = impl AsRef<[u8]>>) -> u16 {
    let mut digest = CRC.digest();
    parts.into_iter().for_each(|part| digest.update(part.as_ref()));
    digest.update(&data_id.to_le_bytes());
    digest.finalize()
}

/// Returns the CRC over more bytes, by the polynomial of the profile: 0x1021, not reflected, no final XOR. From 0 it is the
/// one of block transfers (CiA 301, 7.2.4.3.16).
///
/// ```
/// assert_eq!(trueup_link::e2e::continue_crc(0, b"123456789"), 0x31C3);
/// ```
#[must_use]
pub fn continue_crc(crc: u16, bytes: &[u8]) -> u16 {
    let mut digest = CRC.digest_with_initial(crc);
    digest.update(bytes);
    digest.finalize()
}

/// Returns whether a frame is whole and was sent under its identifier, whatever its counter.
#[must_use]
pub fn has_valid_crc(frame: &Frame) -> bool {
    matches!(frame.payload(), &[low, high, ref covered @ ..]
        if u16::from_le_bytes([low, high]) == compute_frame_crc(frame.id(), covered))
}

/// Checks the frames of one identifier, one after the other.
#[derive(Clone, Copy, Debug)]
pub struct E2eChecker {
    data_id: u16,
    last: Option<u8>,
}

impl E2eChecker {
    /// Returns a checker that has seen no frame yet; `data_id` is the CAN identifier of its frames.
    #[must_use]
    pub const fn new(data_id: u16) -> Self {
        Self { data_id, last: None }
    }

    /// Returns how many frames were lost before this one, 0…[`MAX_DELTA_COUNTER`] − 1, if this one is to be used.
    ///
    /// The first whole frame sets the counter, whatever it is.
    ///
    /// # Errors
    /// The frame must not be used. After [`E2eError::WrongSequence`] the checker has moved to the
    /// counter of the refused frame, so the next in order is accepted: a restarted sender is back
    /// after one frame. After every other error the checker is as before.
    pub fn check(&mut self, frame: &Frame) -> Result<u8, E2eError> {
        let &[low, high, ref covered @ ..] = frame.payload() else {
            return Err(E2eError::TooShort { len: frame.len() });
        };
        let &[counter, ..] = covered else {
            return Err(E2eError::TooShort { len: frame.len() });
        };
        let received = u16::from_le_bytes([low, high]);
        let computed = compute_frame_crc(self.data_id, covered);
        if received != computed {
            return Err(E2eError::Crc { received, computed });
        }
        let Some(last) = self.last.replace(counter) else {
            return Ok(0);
        };
        match counter.wrapping_sub(last) {
            0 => Err(E2eError::Repeated { counter }),
            delta @ 1..=MAX_DELTA_COUNTER => Ok(delta.saturating_sub(1)),
            _ => Err(E2eError::WrongSequence { last, counter }),
        }
    }
}

/// Why a frame must not be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum E2eError {
    /// Too short to hold CRC and counter.
    #[error("{len} bytes are too short for CRC and counter ({HEADER_LEN})")]
    TooShort {
        /// Bytes in the frame.
        len: u8,
    },
    /// Damaged, or sent under another identifier.
    #[error("CRC is 0x{received:04X}, should be 0x{computed:04X}")]
    Crc {
        /// The CRC in the frame.
        received: u16,
        /// The CRC over the frame as it arrived.
        computed: u16,
    },
    /// The same counter as the frame before: a copy, or a sender that stands still.
    #[error("counter {counter} is repeated")]
    Repeated {
        /// The counter in both frames.
        counter: u8,
    },
    /// The counter has moved by more than [`MAX_DELTA_COUNTER`].
    #[error("counter {counter} after {last} is out of sequence")]
    WrongSequence {
        /// The counter of the frame before.
        last: u8,
        /// The counter of this frame.
        counter: u8,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    const ID: u16 = 0x302;

    fn frame(counter: u8) -> Frame {
        let mut data = [0, 0, 0, 1, 2, 3, 4, 5];
        protect(ID, counter, &mut data);
        Frame::new(ID, &data).unwrap()
    }

    fn checker_after(counter: u8) -> E2eChecker {
        let mut checker = E2eChecker::new(ID);
        assert_eq!(checker.check(&frame(counter)), Ok(0));
        checker
    }

    #[test]
    fn the_golden_vector_is_met() {
        let mut data = [0xAA, 0xAA, 0xAA, 0x11, 0x22, 0x33, 0x44, 0x55];
        protect(0x0181, 0, &mut data);
        assert_eq!(data, [0x8B, 0xCB, 0x00, 0x11, 0x22, 0x33, 0x44, 0x55]);
    }

    #[test]
    fn any_first_counter_is_accepted() {
        for counter in 0..=u8::MAX {
            checker_after(counter);
        }
    }

    #[test]
    fn every_single_bit_error_is_found_and_changes_nothing() {
        let good = frame(7);
        for bit in 0..64 {
            let mut data = *good.data();
            data[bit / 8] ^= 1 << (bit % 8);
            let bad = Frame::new(ID, &data).unwrap();
            let mut checker = checker_after(6);
            assert!(matches!(checker.check(&bad), Err(E2eError::Crc { .. })), "bit {bit}");
            assert_eq!(checker.check(&good), Ok(0));
        }
    }

    #[test]
    fn a_frame_under_another_identifier_is_refused() {
        let mut checker = E2eChecker::new(0x202);
        assert!(matches!(checker.check(&frame(0)), Err(E2eError::Crc { .. })));
    }

    #[test]
    fn a_repeated_frame_is_refused_and_the_next_is_accepted() {
        let mut checker = checker_after(9);
        assert_eq!(checker.check(&frame(9)), Err(E2eError::Repeated { counter: 9 }));
        assert_eq!(checker.check(&frame(10)), Ok(0));
    }

    #[test]
    fn every_step_of_the_counter_is_judged_right_across_its_wrap() {
        for last in 0..=u8::MAX {
            for delta in 1..=u8::MAX {
                let counter = last.wrapping_add(delta);
                let mut checker = checker_after(last);
                let expected = if delta <= MAX_DELTA_COUNTER {
                    Ok(delta - 1)
                } else {
                    Err(E2eError::WrongSequence { last, counter })
                };
                assert_eq!(checker.check(&frame(counter)), expected);
                assert_eq!(checker.check(&frame(counter.wrapping_add(1))), Ok(0));
            }
        }
    }

    #[test]
    fn a_frame_without_room_for_the_header_is_refused() {
        for len in 0..3 {
            let short = Frame::new(ID, &[0; 8][..len]).unwrap();
            assert_eq!(
                E2eChecker::new(ID).check(&short),
                Err(E2eError::TooShort { len: short.len() })
            );
        }
    }

    #[test]
    fn a_frame_is_whole_under_its_own_identifier_alone_and_whatever_its_counter() {
        for counter in [0, 7, u8::MAX] {
            let good = frame(counter);
            assert!(has_valid_crc(&good));
            let elsewhere = Frame::new(ID + 1, good.data()).unwrap();
            let mut data = *good.data();
            data[7] ^= 1;
            let damaged = Frame::new(ID, &data).unwrap();
            let short = Frame::new(ID, &good.data()[..1]).unwrap();
            assert!([elsewhere, damaged, short].iter().all(|frame| !has_valid_crc(frame)));
        }
    }

    #[test]
    fn a_refused_frame_is_reported_by_what_was_found_in_it() {
        for (error, message) in [
            (E2eError::TooShort { len: 2 }, "2 bytes are too short for CRC and counter (3)"),
            (E2eError::Crc { received: 0xAB, computed: 0x1234 }, "CRC is 0x00AB, should be 0x1234"),
            (E2eError::Repeated { counter: 9 }, "counter 9 is repeated"),
            (
                E2eError::WrongSequence { last: 3, counter: 77 },
                "counter 77 after 3 is out of sequence",
            ),
        ] {
            assert_eq!(error.to_string(), message);
        }
    }
}
