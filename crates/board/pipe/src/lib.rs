//! The stream between the host and the emulated board: samples and frames down, frames up. The
//! chip never sees it.
//!
//! Down, 128 bytes for one millisecond, little-endian:
//!
//! | offset | type | field |
//! |---|---|---|
//! | 0 | 20 × `u16` | ADC codes, oldest first |
//! | 40 | `u16` | spindle speed in r/min, 0xFFFF: none |
//! | 42 | `u16` | switches: bit 0 the service switch is closed; the others 0 |
//! | 44 | 8 × `i32` | temperature channels, raw (below); −2³¹: none |
//! | 76, 86, 96, 106, 116 | `u16`, 8 bytes | CAN frame: identifier (0xFFFF: no frame), data |
//! | 126 | `u16` | 0 |
//!
//! A temperature comes as its channel delivers it: the resistance in micro-ohms of a PT100, 1/256
//! counts of a linear chain. Which of the two a channel is, the calibration says.
//!
//! Up, 16 bytes for one frame, and one such record to end what the board has to say on a block:
//!
//! | offset | type | field |
//! |---|---|---|
//! | 0 | `u32` | sample clock in ms |
//! | 4 | `u16` | identifier, 0xFFFF: end of batch, 0xFFFE: the same, and the board restarts |
//! | 6 | `u8` | number of data bytes, 0…8; 0 at the end of a batch |
//! | 7 | `u8` | 0 |
//! | 8 | 8 bytes | data, padded with zeros |
#![no_std]
#![forbid(unsafe_code)]
// A test that overflows fails, which is what a test is for.
#![cfg_attr(test, allow(clippy::arithmetic_side_effects))]

#[cfg(test)]
extern crate std;

use trueup_core::{
    thermometer::RawTemperatureReading,
    units::{AdcCode, Rpm, TimestampMs},
};
use trueup_link::frame::{Frame, FrameError};

/// ADC samples in one millisecond.
pub(crate) const SAMPLES_PER_BLOCK: usize = 20;
/// Temperature channels in a block.
pub(crate) const TEMPERATURES_PER_BLOCK: usize = 8;
/// CAN frames that fit a block.
pub const FRAMES_PER_BLOCK: usize = 5;
/// Bytes in a block.
pub const BLOCK_SIZE: usize = 128;
/// Bytes in a record.
pub const RECORD_SIZE: usize = 16;

/// In place of a speed or an identifier: there is none.
const NO_VALUE: u16 = 0xFFFF;
/// In place of an identifier: the board restarts.
const RESTART_ID: u16 = 0xFFFE;

/// Inputs of the board in one millisecond.
///
/// ```
/// use trueup_core::thermometer::RawTemperatureReading;
/// use trueup_pipe::Block;
/// let mut block = Block::default();
/// block.temperatures[1] = RawTemperatureReading(109_734_656); // a PT100 at 25 °C
/// let bytes = block.encode()?;
/// assert_eq!(bytes[44..52], [0x00, 0x00, 0x00, 0x80, 0x00, 0x6B, 0x8A, 0x06]);
/// assert_eq!(Block::decode(&bytes), Ok(block));
/// # Ok::<(), trueup_pipe::BlockError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// ADC codes, oldest first; 0…4095 on the chip, not checked here, so that a fault can be
    /// played.
    pub codes: [AdcCode; SAMPLES_PER_BLOCK],
    /// Spindle speed; 0xFFFF r/min is sent as 0xFFFE.
    pub speed: Option<Rpm>,
    /// The service switch is closed.
    pub service_switch: bool,
    /// Temperatures, as each channel delivers them.
    pub temperatures: [RawTemperatureReading; TEMPERATURES_PER_BLOCK],
    /// Frames from the CNC, of 8 bytes.
    pub frames: [Option<Frame>; FRAMES_PER_BLOCK],
}

impl Default for Block {
    /// Codes of 0, and nothing else: no speed, no temperature, no frame.
    fn default() -> Self {
        Self {
            codes: [AdcCode(0); SAMPLES_PER_BLOCK],
            speed: None,
            service_switch: false,
            temperatures: [RawTemperatureReading::NONE; TEMPERATURES_PER_BLOCK],
            frames: [None; FRAMES_PER_BLOCK],
        }
    }
}

impl Block {
    /// Returns the bytes of this block.
    ///
    /// # Errors
    /// [`BlockError::FrameLength`] for a frame that has not 8 bytes.
    pub fn encode(&self) -> Result<[u8; BLOCK_SIZE], BlockError> {
        let speed = self.speed.map_or(NO_VALUE, |Rpm(rpm)| rpm.min(NO_VALUE - 1));
        let words = self.codes.iter().map(|code| code.0).chain([speed, self.service_switch.into()]);
        let mut bytes = [0; BLOCK_SIZE];
        let (head, rest) = bytes.split_at_mut(HEADER_SIZE);
        let (temperatures, slots) = rest.split_at_mut(TEMPERATURES_SIZE);
        for (place, word) in head.as_chunks_mut().0.iter_mut().zip(words) {
            *place = word.to_le_bytes();
        }
        for (place, raw) in temperatures.as_chunks_mut().0.iter_mut().zip(self.temperatures) {
            *place = raw.0.to_le_bytes();
        }
        for (place, (slot, frame)) in
            slots.as_chunks_mut::<SLOT_SIZE>().0.iter_mut().zip(self.frames.iter().enumerate())
        {
            *place = encode_slot(slot, frame.as_ref())?;
        }
        Ok(bytes)
    }

    /// Returns the block of these bytes.
    ///
    /// # Errors
    /// [`BlockError`] for an identifier above 0x7FF, or reserved bytes that are not 0: the stream
    /// is out of step.
    pub fn decode(bytes: &[u8; BLOCK_SIZE]) -> Result<Self, BlockError> {
        let (head, rest) = bytes.split_at(HEADER_SIZE);
        let (temperatures, slots) = rest.split_at(TEMPERATURES_SIZE);
        let mut words = [0; HEADER_SIZE / 2];
        for (word, place) in words.iter_mut().zip(head.as_chunks().0) {
            *word = u16::from_le_bytes(*place);
        }
        let [codes @ .., speed, switches] = words;
        let (slots, end) = slots.as_chunks::<SLOT_SIZE>();
        let tail = end.first_chunk().map_or(0, |tail| u16::from_le_bytes(*tail));
        for (at, found) in [(SWITCHES_OFFSET, switches & !1), (RESERVED_OFFSET, tail)] {
            if found != 0 {
                return Err(BlockError::Reserved { at, found });
            }
        }
        let mut block = Self {
            codes: codes.map(AdcCode),
            speed: (speed != NO_VALUE).then_some(Rpm(speed)),
            service_switch: switches & 1 != 0,
            ..Self::default()
        };
        for (raw, place) in block.temperatures.iter_mut().zip(temperatures.as_chunks().0) {
            *raw = RawTemperatureReading(i32::from_le_bytes(*place));
        }
        for (frame, (slot, place)) in block.frames.iter_mut().zip(slots.iter().enumerate()) {
            *frame = decode_slot(slot, place)?;
        }
        Ok(block)
    }
}

/// Bytes of the codes, the speed, and the switches after them.
const HEADER_SIZE: usize = 2 * SAMPLES_PER_BLOCK + 4;
/// Offset of the switches after the speed.
const SWITCHES_OFFSET: usize = HEADER_SIZE - 2;
/// Bytes of the temperatures.
const TEMPERATURES_SIZE: usize = 4 * TEMPERATURES_PER_BLOCK;
/// Bytes of a frame in a block.
const SLOT_SIZE: usize = 10;
/// Offset of what is reserved after the frames.
const RESERVED_OFFSET: usize = HEADER_SIZE + TEMPERATURES_SIZE + FRAMES_PER_BLOCK * SLOT_SIZE;
const _: () = assert!(RESERVED_OFFSET + 2 == BLOCK_SIZE);

fn encode_slot(slot: usize, frame: Option<&Frame>) -> Result<[u8; SLOT_SIZE], BlockError> {
    let (id, [a, b, c, d, e, f, g, h]) = match frame {
        Some(frame) if usize::from(frame.len()) == Frame::MAX_LEN => (frame.id(), *frame.data()),
        Some(frame) => {
            return Err(BlockError::FrameLength { slot, len: frame.len() });
        }
        None => (NO_VALUE, [0; Frame::MAX_LEN]),
    };
    let [low, high] = id.to_le_bytes();
    Ok([low, high, a, b, c, d, e, f, g, h])
}

fn decode_slot(slot: usize, place: &[u8; SLOT_SIZE]) -> Result<Option<Frame>, BlockError> {
    let [low, high, data @ ..] = place;
    match u16::from_le_bytes([*low, *high]) {
        NO_VALUE => Ok(None),
        id => Frame::new(id, data).map(Some).map_err(|_| BlockError::Identifier { slot, id }),
    }
}

/// Why there is no such block.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BlockError {
    /// A frame of a block must have 8 bytes.
    #[error("frame {slot} has {len} bytes, not 8")]
    FrameLength {
        /// Which frame, from 0.
        slot: usize,
        /// Its length in bytes.
        len: u8,
    },
    /// An identifier is above 0x7FF, and not the one that stands for no frame.
    #[error("identifier 0x{id:X} of frame {slot} is above 0x{max:X}", max = Frame::MAX_ID)]
    Identifier {
        /// Which frame, from 0.
        slot: usize,
        /// The identifier, above 0x7FF.
        id: u16,
    },
    /// Reserved bytes are not 0.
    #[error("reserved bytes at {at} hold 0x{found:04X}, not 0")]
    Reserved {
        /// Their offset in the block, in bytes.
        at: usize,
        /// Their value.
        found: u16,
    },
}

/// A record that the board sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardRecord {
    /// It sends a frame to the CNC.
    Frame {
        /// When, on the sample clock.
        time: TimestampMs,
        /// The frame that it sends.
        frame: Frame,
    },
    /// It has nothing more to say and waits for the next samples.
    EndOfBatch {
        /// When, on the sample clock.
        time: TimestampMs,
    },
    /// It has nothing more to say and restarts; then it is up again, with its clock at 0.
    Restart {
        /// When, on the sample clock.
        time: TimestampMs,
    },
}

impl BoardRecord {
    /// Returns the bytes of this record.
    #[must_use]
    pub fn encode(&self) -> [u8; RECORD_SIZE] {
        let (time, id, len, [a, b, c, d, e, f, g, h]) = match self {
            Self::Frame { time, frame } => (time, frame.id(), frame.len(), *frame.data()),
            Self::EndOfBatch { time } => (time, NO_VALUE, 0, [0; Frame::MAX_LEN]),
            Self::Restart { time } => (time, RESTART_ID, 0, [0; Frame::MAX_LEN]),
        };
        let [t0, t1, t2, t3] = time.0.to_le_bytes();
        let [low, high] = id.to_le_bytes();
        [t0, t1, t2, t3, low, high, len, 0, a, b, c, d, e, f, g, h]
    }

    /// Returns the record of these bytes.
    ///
    /// # Errors
    /// [`RecordError`] for an identifier above 0x7FF, a length above 8, or padding that is not 0:
    /// the stream is out of step.
    pub fn decode(bytes: &[u8; RECORD_SIZE]) -> Result<Self, RecordError> {
        let &[t0, t1, t2, t3, low, high, len, padding, ref data @ ..] = bytes;
        let time = TimestampMs(u32::from_le_bytes([t0, t1, t2, t3]));
        let id = u16::from_le_bytes([low, high]);
        let too_long = RecordError::Length(len);
        let (payload, rest) = data.split_at_checked(len.into()).ok_or(too_long)?;
        if let Some(&found) = rest.iter().chain([&padding]).find(|byte| **byte != 0) {
            return Err(RecordError::Padding(found));
        }
        match (id, len) {
            (NO_VALUE, 0) => return Ok(Self::EndOfBatch { time }),
            (RESTART_ID, 0) => return Ok(Self::Restart { time }),
            (NO_VALUE | RESTART_ID, _) => return Err(too_long),
            _ => {}
        }
        let frame = Frame::new(id, payload).map_err(|error| match error {
            FrameError::Identifier(id) => RecordError::Identifier(id),
            FrameError::Length(_) => too_long,
        })?;
        Ok(Self::Frame { time, frame })
    }
}

/// Why there is no such record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RecordError {
    /// The identifier is above 0x7FF, and not the one that ends a batch.
    #[error("identifier 0x{0:X} is above 0x{max:X}", max = Frame::MAX_ID)]
    Identifier(u16),
    /// More than 8 bytes of data, or data at the end of a batch.
    #[error("a record cannot hold {0} bytes of data")]
    Length(u8),
    /// A byte of the padding is not 0.
    #[error("padding holds 0x{0:02X}, not 0")]
    Padding(u8),
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame(id: u16, payload: &[u8]) -> Frame {
        Frame::new(id, payload).unwrap()
    }

    #[test]
    fn every_field_of_a_block_lies_where_the_table_says() {
        let mut block = Block { speed: Some(Rpm(0x1234)), ..Block::default() };
        block.frames[1] = Some(frame(0x302, &[1, 2, 3, 4, 5, 6, 7, 8]));
        block.frames[4] = Some(frame(0x501, &[9; 8]));
        block.temperatures[0] = RawTemperatureReading(0x0102_0304);
        block.temperatures[7] = RawTemperatureReading(-2);
        block.codes[0] = AdcCode(0x0ABC);
        block.codes[19] = AdcCode(0x0DEF);
        let bytes = block.encode().unwrap();
        assert_eq!(bytes[..2], [0xBC, 0x0A]);
        assert_eq!(bytes[38..44], [0xEF, 0x0D, 0x34, 0x12, 0, 0]);
        assert_eq!(bytes[44..52], [4, 3, 2, 1, 0, 0, 0, 0x80]);
        assert_eq!(bytes[72..76], [0xFE, 0xFF, 0xFF, 0xFF]);
        assert_eq!(bytes[76..86], [0xFF, 0xFF, 0, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(bytes[86..96], [0x02, 0x03, 1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(bytes[96..98], [0xFF, 0xFF]);
        assert_eq!(bytes[106..108], [0xFF, 0xFF]);
        assert_eq!(bytes[116..], [0x01, 0x05, 9, 9, 9, 9, 9, 9, 9, 9, 0, 0]);
    }

    #[test]
    fn a_block_that_says_nothing_brings_nothing() {
        let block = Block::default();
        assert_eq!(block.speed, None);
        assert_eq!(block.temperatures, [RawTemperatureReading(i32::MIN); TEMPERATURES_PER_BLOCK]);
        assert_eq!(block.frames, [None; FRAMES_PER_BLOCK]);
        assert_eq!(Block::decode(&block.encode().unwrap()), Ok(block));
    }

    #[test]
    fn every_field_of_a_record_lies_where_the_table_says() {
        let time = TimestampMs(0x0102_0304);
        let record = BoardRecord::Frame { time, frame: frame(0x701, &[5]) };
        let expected = [4, 3, 2, 1, 0x01, 0x07, 1, 0, 5, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(record.encode(), expected);
        let expected = [4, 3, 2, 1, 0xFF, 0xFF, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(BoardRecord::EndOfBatch { time }.encode(), expected);
    }

    #[test]
    fn no_speed_and_the_largest_speed_are_distinguished() {
        for (sent, came) in [
            (None, None),
            (Some(Rpm(0)), Some(Rpm(0))),
            (Some(Rpm(0xFFFE)), Some(Rpm(0xFFFE))),
            (Some(Rpm(0xFFFF)), Some(Rpm(0xFFFE))),
        ] {
            let block = Block { speed: sent, ..Block::default() };
            let bytes = block.encode().unwrap();
            assert_eq!(Block::decode(&bytes).map(|block| block.speed), Ok(came));
        }
    }

    #[test]
    fn a_block_that_is_out_of_step_is_refused_with_what_was_found() {
        let good = Block::default().encode().unwrap();
        for (byte, at, found) in [(43, 42, 0x100), (126, 126, 1), (127, 126, 0x100)] {
            let mut bad = good;
            bad[byte] = 1;
            assert_eq!(Block::decode(&bad), Err(BlockError::Reserved { at, found }));
        }
        for slot in 0..FRAMES_PER_BLOCK {
            let mut bad = good;
            bad[76 + 10 * slot..78 + 10 * slot].copy_from_slice(&[0x00, 0x08]);
            let id = 0x800;
            assert_eq!(Block::decode(&bad), Err(BlockError::Identifier { slot, id }));
            let mut short = Block::default();
            short.frames[slot] = Some(frame(0x701, &[5]));
            let len = 1;
            assert_eq!(short.encode(), Err(BlockError::FrameLength { slot, len }));
        }
    }

    #[test]
    fn a_record_that_is_out_of_step_is_refused_with_what_was_found() {
        let good = BoardRecord::EndOfBatch { time: TimestampMs(1) }.encode();
        for (at, value, error) in [
            (5, 0x08, RecordError::Identifier(0x8FF)),
            (6, 1, RecordError::Length(1)),
            (6, 9, RecordError::Length(9)),
            (7, 2, RecordError::Padding(2)),
            (15, 3, RecordError::Padding(3)),
        ] {
            let mut bad = good;
            bad[at] = value;
            assert_eq!(BoardRecord::decode(&bad), Err(error), "byte {at}");
        }
    }

    proptest! {
        #[test]
        fn a_block_comes_back_whole(
            codes in prop::array::uniform20(any::<u16>()), speed in prop::option::of(0_u16..0xFFFF),
            service_switch: bool, temperatures: [i32; TEMPERATURES_PER_BLOCK],
            frames in prop::array::uniform5(prop::option::of((0_u16..0x800, any::<[u8; 8]>()))),
        ) {
            let block = Block {
                codes: codes.map(AdcCode),
                speed: speed.map(Rpm),
                service_switch,
                temperatures: temperatures.map(RawTemperatureReading),
                frames: frames.map(|slot| slot.map(|(id, data)| frame(id, &data))),
            };
            prop_assert_eq!(Block::decode(&block.encode().unwrap()), Ok(block));
        }

        #[test]
        fn a_record_comes_back_whole(
            time: u32, id in 0_u16..0x800, payload in prop::collection::vec(any::<u8>(), 0..=8),
        ) {
            let time = TimestampMs(time);
            for record in [
                BoardRecord::Frame { time, frame: frame(id, &payload) },
                BoardRecord::EndOfBatch { time },
                BoardRecord::Restart { time },
            ] {
                prop_assert_eq!(BoardRecord::decode(&record.encode()), Ok(record));
            }
        }

        #[test]
        fn no_bytes_panic_and_what_is_read_is_what_is_written(
            parts in prop::array::uniform4(prop::array::uniform32(any::<u8>())),
            ids in prop::array::uniform5(0_u16..0x801),
            record in prop::array::uniform16(any::<u8>()),
        ) {
            let mut bytes: [u8; BLOCK_SIZE] = parts.concat().try_into().unwrap();
            let _ = Block::decode(&bytes);
            bytes[42..44].copy_from_slice(&[0; 2]);
            bytes[126..].copy_from_slice(&[0; 2]);
            for (slot, id) in ids.into_iter().enumerate() {
                bytes[76 + 10 * slot..78 + 10 * slot].copy_from_slice(&id.to_le_bytes());
            }
            if let Ok(read) = Block::decode(&bytes) {
                prop_assert_eq!(read.encode(), Ok(bytes));
            }
            if let Ok(read) = BoardRecord::decode(&record) {
                prop_assert_eq!(read.encode(), record);
            }
        }
    }
}
