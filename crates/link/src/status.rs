//! `Status`: what the bridge says of itself while it runs, one item a frame, ten frames a second, so
//! that each item comes every 0.8 s.
//!
//! | item | bits 32…47 | bits 48…63 |
//! |---|---|---|
//! | 0…3 | temperature of channel 0, 2, 4, 6 in 0.01 °C | of channel 1, 3, 5, 7 |
//! | 4 | elongation of the spindle, 32 bits, in 0.001 µm | |
//! | 5 | frames of the CNC that were damaged | that were repeated or out of sequence |
//! | 6 | frames of the CNC with a wrong length or value | that never came |
//! | 7 | RMS noise of the sensor in 0.001 codes | faults, a bit each: the numbers of `Fault` in the DBC |
//!
//! The most negative number of a temperature and of the elongation means "not available"; counts
//! stop at 65 535. Every frame says in bits 28…31 why a frame of the CNC was last refused, and is
//! protected as the offsets are.

use trueup_core::units::Nanometres;

use crate::{
    frame::Frame,
    frames::{self, DecodeError},
    layout::{
        COUNT_HIGH, COUNT_LOW, ELONGATION, ITEM, LAST_REFUSED, NO_ELONGATION_RAW,
        NO_TEMPERATURE_RAW, STATUS_ID, TEMPERATURE_HIGH, TEMPERATURE_LOW,
    },
};

/// The largest number of an item; their count is a power of two.
pub const LAST_ITEM: u8 = 7;

/// What a `Status` frame says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// Why a frame of the CNC was last refused.
    pub last_refused: Reason,
    /// What this frame is about.
    pub item: Item,
}

/// Why a frame of the CNC was refused. The numbers are those on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Reason {
    /// None was refused since the start.
    #[default]
    None = 0,
    /// Its length or a value in it is wrong.
    Malformed = 1,
    /// Its CRC is wrong: damaged, or sent under another identifier.
    Damaged = 2,
    /// It has the counter of the frame before.
    Repeated = 3,
    /// Its counter has moved too far.
    WrongSequence = 4,
}

impl Reason {
    /// The reason with this number on the wire.
    #[must_use]
    pub const fn from_wire(number: u8) -> Option<Self> {
        Some(match number {
            0 => Self::None,
            1 => Self::Malformed,
            2 => Self::Damaged,
            3 => Self::Repeated,
            4 => Self::WrongSequence,
            _ => return None,
        })
    }
}

/// What a `Status` frame is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Item {
    /// Two temperature channels.
    Temperatures {
        /// Which two, 0…3: channels 2·n and 2·n + 1. A larger number counts as 3.
        pair: u8,
        /// In 0.01 °C; `None`: not available.
        centi_c: [Option<i16>; 2],
    },
    /// The elongation of the spindle by its sensor; `None`: not available.
    Elongation(Option<Nanometres>),
    /// Frames of the CNC whose protection does not hold, since the start.
    Refused {
        /// Their CRC was wrong.
        damaged: u16,
        /// They were repeated or out of sequence.
        out_of_sequence: u16,
    },
    /// Other frames of the CNC, since the start.
    Received {
        /// Their length or a value in them was wrong.
        malformed: u16,
        /// They never came.
        lost: u16,
    },
    /// How the board is.
    Board {
        /// RMS noise of the raw codes in thousandths of a code.
        noise_thousandths: u16,
        /// What is wrong, bit n is fault n of the DBC's `Fault`.
        faults: u16,
    },
}

/// The frame that says this. `counter` counts the frames of this identifier.
///
/// ```
/// use trueup_link::status::{self, Item, Reason, Status};
/// let item = Item::Temperatures { pair: 1, centi_c: [Some(2_345), None] };
/// let frame = status::encode(&Status { last_refused: Reason::Damaged, item }, 7);
/// // Item 1, reason 2, 2345 = 0x0929, and 0x8000 for "not available".
/// assert_eq!(frame.data()[2..], [0x07, 0x21, 0x29, 0x09, 0x00, 0x80]);
/// assert_eq!(status::decode(&frame)?.item, item);
/// # Ok::<(), trueup_link::frames::DecodeError>(())
/// ```
#[must_use]
pub fn encode(status: &Status, counter: u8) -> Frame {
    let mut data = [0; 8];
    LAST_REFUSED.insert(&mut data, status.last_refused as i32);
    let number = match status.item {
        Item::Temperatures { pair, centi_c: [low, high] } => {
            TEMPERATURE_LOW.insert(&mut data, low.map_or(NO_TEMPERATURE_RAW, i32::from));
            TEMPERATURE_HIGH.insert(&mut data, high.map_or(NO_TEMPERATURE_RAW, i32::from));
            pair.min(3)
        }
        Item::Elongation(elongation) => {
            ELONGATION.insert(&mut data, elongation.map_or(NO_ELONGATION_RAW, |it| it.0));
            4
        }
        Item::Refused { damaged, out_of_sequence } => {
            counts(&mut data, 5, damaged, out_of_sequence)
        }
        Item::Received { malformed, lost } => counts(&mut data, 6, malformed, lost),
        Item::Board { noise_thousandths, faults } => {
            counts(&mut data, 7, noise_thousandths, faults)
        }
    };
    ITEM.insert(&mut data, number.into());
    frames::protected(STATUS_ID, counter, data)
}

fn counts(data: &mut [u8; 8], item: u8, low: u16, high: u16) -> u8 {
    COUNT_LOW.insert(data, low.into());
    COUNT_HIGH.insert(data, high.into());
    item
}

/// What a `Status` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length, or an item or a reason that has no meaning.
pub fn decode(frame: &Frame) -> Result<Status, DecodeError> {
    let data = frames::data_of(frame, STATUS_ID, 8)?;
    let reason = frames::byte(LAST_REFUSED, data);
    let last_refused = Reason::from_wire(reason)
        .ok_or(DecodeError::Value { signal: "LastRefused", raw: reason.into() })?;
    let count = |signal: crate::bits::Signal| {
        let [low, high, ..] = signal.extract(data).to_le_bytes();
        u16::from_le_bytes([low, high])
    };
    let temperature = |signal: crate::bits::Signal| {
        let raw = signal.extract(data);
        i16::try_from(raw).ok().filter(|_| raw != NO_TEMPERATURE_RAW)
    };
    let item = match frames::byte(ITEM, data) {
        pair @ 0..=3 => {
            let centi_c = [TEMPERATURE_LOW, TEMPERATURE_HIGH].map(temperature);
            Item::Temperatures { pair, centi_c }
        }
        4 => {
            let raw = ELONGATION.extract(data);
            Item::Elongation((raw != NO_ELONGATION_RAW).then_some(Nanometres(raw)))
        }
        5 => Item::Refused { damaged: count(COUNT_LOW), out_of_sequence: count(COUNT_HIGH) },
        6 => Item::Received { malformed: count(COUNT_LOW), lost: count(COUNT_HIGH) },
        7 => Item::Board { noise_thousandths: count(COUNT_LOW), faults: count(COUNT_HIGH) },
        other => return Err(DecodeError::Value { signal: "Item", raw: other.into() }),
    };
    Ok(Status { last_refused, item })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{e2e::Checker, layout::COUNTER};
    use proptest::prelude::*;

    #[test]
    fn the_ends_and_what_is_missing_keep_apart() {
        for (item, tail) in [
            (
                Item::Temperatures { pair: 0, centi_c: [Some(i16::MAX), Some(-i16::MAX)] },
                [0x10, 0xFF, 0x7F, 0x01, 0x80],
            ),
            (Item::Temperatures { pair: 3, centi_c: [None; 2] }, [0x13, 0, 0x80, 0, 0x80]),
            (Item::Elongation(Some(Nanometres(-1))), [0x14, 0xFF, 0xFF, 0xFF, 0xFF]),
            (Item::Elongation(None), [0x14, 0, 0, 0, 0x80]),
            (Item::Refused { damaged: 1, out_of_sequence: 0xFFFF }, [0x15, 1, 0, 0xFF, 0xFF]),
            (Item::Received { malformed: 0x1234, lost: 2 }, [0x16, 0x34, 0x12, 2, 0]),
            (Item::Board { noise_thousandths: 1_041, faults: 1 << 13 }, [0x17, 0x11, 4, 0, 0x20]),
        ] {
            let status = Status { last_refused: Reason::Malformed, item };
            let frame = encode(&status, 9);
            assert_eq!(frame.data()[3..], tail, "{item:?}");
            assert_eq!(decode(&frame), Ok(status));
        }
    }

    #[test]
    fn an_item_or_a_reason_without_meaning_is_refused_by_name() {
        for (signal, at, from) in [("Item", ITEM, 8), ("LastRefused", LAST_REFUSED, 5)] {
            for raw in from..16 {
                let status = Status { last_refused: Reason::None, item: Item::Elongation(None) };
                let mut data = *encode(&status, 0).data();
                at.insert(&mut data, raw);
                let frame = Frame::new(STATUS_ID, &data).expect("8 bytes");
                assert_eq!(decode(&frame), Err(DecodeError::Value { signal, raw }));
            }
        }
    }

    proptest! {
        #[test]
        fn whatever_is_read_is_written_again_and_protected(data in any::<[u8; 8]>(), counter: u8) {
            let frame = Frame::new(STATUS_ID, &data).expect("8 bytes");
            if let Ok(status) = decode(&frame) {
                let again = encode(&status, counter);
                prop_assert_eq!(&again.data()[3..], &data[3..]);
                prop_assert_eq!(COUNTER.extract(again.data()), counter.into());
                prop_assert!(Checker::new(STATUS_ID).accept(&again).is_ok());
            }
        }
    }
}
