//! A slave on a serial line: silence alone marks the end of a frame.
//!
//! ```text
//!  bytes  ▮▮▮▮▮▮▮▮▮▮▮▮            ≥ 3.5 characters: the frame is whole
//!  bytes  ▮▮▮▮▮▮   ▮▮▮▮▮▮         > 1.5 characters within it: the frame is thrown away
//! ```
//!
//! Modbus over serial line V1.02, 2.5.1.1: a character has 11 bits; above 19 200 Bd the two times are
//! 750 µs and 1.750 ms, whatever the speed.

use heapless::Vec;

use crate::server::{RegisterStore, ResponseBuffer, Transport, handle_request};

/// The largest serial frame.
const MAX_FRAME_BYTES: usize = 256;
/// Above it, the two times no longer follow the speed.
const FIXED_TIMING_THRESHOLD_BAUD: u32 = 19_200;
/// Bits in a character: start, eight, parity or a second stop, stop.
const BITS_PER_CHARACTER: u32 = 11;
/// Half of one, in µs at 1 Bd.
const HALF_CHARACTER_US_AT_1_BAUD: u32 = BITS_PER_CHARACTER * 1_000_000 / 2;

/// Silences in microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameTiming {
    /// The longest within a frame.
    pub within_us: u32,
    /// The shortest behind one.
    pub behind_us: u32,
}

impl FrameTiming {
    /// Those at this speed, in baud; at 0, over an hour.
    ///
    /// ```
    /// # use trueup_modbus::rtu::FrameTiming;
    /// // A character lasts 11/9600 s, 1.146 ms.
    /// assert_eq!(FrameTiming::from_baud(9_600), FrameTiming { within_us: 1_718, behind_us: 4_010 });
    /// assert_eq!(FrameTiming::from_baud(115_200), FrameTiming { within_us: 750, behind_us: 1_750 });
    /// ```
    #[must_use]
    pub const fn from_baud(baud: u32) -> Self {
        if baud > FIXED_TIMING_THRESHOLD_BAUD {
            return Self { within_us: 750, behind_us: 1_750 };
        }
        Self {
            within_us: half_character_times_us(3, baud),
            behind_us: half_character_times_us(7, baud),
        }
    }
}

/// This many halves of a character, in µs.
const fn half_character_times_us(count: u32, baud: u32) -> u32 {
    match HALF_CHARACTER_US_AT_1_BAUD.saturating_mul(count).checked_div(baud) {
        Some(us) => us,
        None => u32::MAX,
    }
}

/// A byte as it came.
#[derive(Clone, Copy, Debug)]
pub struct RxByte {
    /// When, in microseconds; may wrap.
    pub at_us: u32,
    /// `None`: its parity or its stop bit was wrong, or one was lost.
    pub byte: Option<u8>,
}

/// A slave: bytes in, with their time; whole frames answered.
#[derive(Clone, Debug)]
pub struct Slave {
    unit: u8,
    timing: FrameTiming,
    bytes: Vec<u8, MAX_FRAME_BYTES>,
    last_us: u32,
    is_broken: bool,
}

impl Slave {
    /// Returns a slave with this address, 1…247, that has received nothing.
    #[must_use]
    pub const fn new(unit: u8, timing: FrameTiming) -> Self {
        Self { unit, timing, bytes: Vec::new(), last_us: 0, is_broken: false }
    }

    /// Takes what has come.
    pub fn push(&mut self, received: RxByte) {
        match received.byte {
            Some(byte) => self.receive(received.at_us, byte),
            None => self.receive_damaged_byte(received.at_us),
        }
    }

    /// Takes a byte that has come at this time, in microseconds; the time may wrap.
    pub fn receive(&mut self, now_us: u32, byte: u8) {
        let silence = now_us.wrapping_sub(self.last_us);
        if !self.bytes.is_empty() {
            if silence >= self.timing.behind_us {
                // No poll came in between: what came before is over.
                self.discard_frame();
            } else if silence > self.timing.within_us {
                self.is_broken = true;
            }
        }
        self.last_us = now_us;
        self.is_broken |= self.bytes.push(byte).is_err();
    }

    /// Takes note of a byte that came damaged: its parity or its stop bit was wrong, or one was lost.
    pub(crate) fn receive_damaged_byte(&mut self, now_us: u32) {
        self.receive(now_us, 0);
        self.is_broken = true;
    }

    /// Answers a frame, if one is whole now. Whether there is an answer to send.
    pub fn poll(
        &mut self,
        now_us: u32,
        bridge: &mut impl RegisterStore,
        response: &mut ResponseBuffer,
    ) -> bool {
        let silence = now_us.wrapping_sub(self.last_us);
        if self.bytes.is_empty() || silence < self.timing.behind_us {
            return false;
        }
        let has_answer = !self.is_broken
            && handle_request(Transport::Rtu, self.unit, &self.bytes, bridge, response);
        self.discard_frame();
        has_answer
    }

    fn discard_frame(&mut self) {
        self.bytes.clear();
        self.is_broken = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        holding_block::CncData,
        server::tests::{Mock, rtu, write},
    };
    use std::vec::Vec as List;

    const TIMING: FrameTiming = FrameTiming::from_baud(115_200);
    const CHARACTER_US: u32 = 96;

    /// Bytes one behind the other from this time on; when the last came.
    fn push(slave: &mut Slave, mut now: u32, bytes: &[u8]) -> u32 {
        for byte in bytes {
            now = now.wrapping_add(CHARACTER_US);
            slave.receive(now, *byte);
        }
        now
    }

    fn block() -> List<u8> {
        rtu(9, &write(&CncData::default().encode(1)))
    }

    #[test]
    fn a_frame_is_answered_after_three_and_a_half_characters_of_silence_and_once() {
        // Across the wrap of the clock as well.
        for start in [0, u32::MAX - 1_000] {
            let (mut slave, mut bridge) = (Slave::new(9, TIMING), Mock::new());
            let mut response = ResponseBuffer::new();
            let end = push(&mut slave, start, &block());
            for early in [0, 100, 1_749] {
                assert!(!slave.poll(end.wrapping_add(early), &mut bridge, &mut response));
            }
            assert!(slave.poll(end.wrapping_add(1_750), &mut bridge, &mut response));
            assert_eq!(bridge.taken.len(), 1);
            assert_eq!(response[..2], [9, 16]);
            assert!(!slave.poll(end.wrapping_add(9_000), &mut bridge, &mut response));
        }
    }

    #[test]
    fn a_gap_within_a_frame_throws_it_away_and_the_next_is_received() {
        let (mut slave, mut bridge) = (Slave::new(9, TIMING), Mock::new());
        let mut response = ResponseBuffer::new();
        let frame = block();
        let middle = push(&mut slave, 0, &frame[..20]);
        let end = push(&mut slave, middle + 800, &frame[20..]);
        assert!(!slave.poll(end + 2_000, &mut bridge, &mut response));
        assert!(bridge.taken.is_empty());
        let end = push(&mut slave, end + 3_000, &frame);
        assert!(slave.poll(end + 2_000, &mut bridge, &mut response));
        // One that was not polled in time is over when the next begins.
        let end = push(&mut slave, end + 10_000, &frame);
        let end = push(&mut slave, end + 5_000, &frame);
        assert!(slave.poll(end + 2_000, &mut bridge, &mut response));
        assert_eq!(bridge.taken.len(), 2);
    }

    #[test]
    fn noise_overlong_and_damaged_frames_move_nothing() {
        let (mut slave, mut bridge) = (Slave::new(9, TIMING), Mock::new());
        let mut response = ResponseBuffer::new();
        let mut now = 0;
        let mut random = 1_u32;
        for length in 0..600 {
            let noise: List<u8> = (0..length)
                .map(|_| {
                    random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    random.to_be_bytes()[0]
                })
                .collect();
            now = push(&mut slave, now, &noise) + 2_000;
            assert!(!slave.poll(now, &mut bridge, &mut response), "{length}");
        }
        let frame = block();
        now = push(&mut slave, now, &frame[..10]);
        slave.receive_damaged_byte(now + CHARACTER_US);
        now = push(&mut slave, now + CHARACTER_US, &frame[11..]) + 2_000;
        assert!(!slave.poll(now, &mut bridge, &mut response));
        assert!(bridge.taken.is_empty());
        now = push(&mut slave, now, &frame) + 2_000;
        assert!(slave.poll(now, &mut bridge, &mut response));
    }
}
