//! Every frame, both ways: what it says, to and from the bytes of `trueup.dbc`.
//!
//! The encoders protect the frame they build; the decoders read the layout alone. Whether a
//! received frame may be used at all is for [`crate::receiver`] to say, which checks the
//! protection first. Bits that no signal covers are sent as 0 and ignored.

use core::{error::Error, fmt};

use trueup_core::{
    cnc::{Control, Flags, Output, Quality, Spindle},
    units::{Nanometres, Rpm},
};

pub use crate::layout::{
    CONTROL_ID, CONTROL_PERIOD_MS, HEARTBEAT_ID, HEARTBEAT_PERIOD_MS, OFFSET_PERIOD_MS,
    OFFSET_XY_ID, OFFSET_Z_ID, SPINDLE_ID, SPINDLE_PERIOD_MS,
};
use crate::{
    bits::Signal,
    e2e,
    frame::Frame,
    layout::{
        AGE, ENGAGE, FLAGS, LOAD, NANOMETRES_PER_BIT, NOT_AVAILABLE_RAW, OFFSET_MAX_RAW, OFFSET_X,
        OFFSET_Y, OFFSET_Z, QUALITY, REFERENCED, SPEED, STATE, ZERO,
    },
};

/// What `OffsetXY` says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OffsetXy {
    /// Offsets on X and Y; `None` if either is not available.
    pub offset: Option<[Nanometres; 2]>,
}

/// What `OffsetZ` says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OffsetZ {
    /// Offset on Z; `None`: not available.
    pub offset: Option<Nanometres>,
    /// How good the offsets on all three axes are.
    pub quality: Quality,
    /// Why they are not simply the full correction.
    pub flags: Flags,
    /// Milliseconds since the newest sample; 255 stands for all beyond.
    pub age_ms: u8,
}

/// The bridge's state in its heartbeat. The numbers are those of CiA 301.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum State {
    /// Just started; sent once.
    BootUp = 0,
    /// Silent but for the heartbeat.
    Stopped = 4,
    /// Sends offsets.
    Operational = 5,
    /// Ready, but sends no offsets.
    PreOperational = 127,
}

impl State {
    /// The state with this number on the wire.
    #[must_use]
    pub fn from_wire(number: u8) -> Option<Self> {
        Some(match number {
            0 => Self::BootUp,
            4 => Self::Stopped,
            5 => Self::Operational,
            127 => Self::PreOperational,
            _ => return None,
        })
    }
}

/// `OffsetXY`: the first half of a cycle. Offsets are rounded to 10 nm, halves away from zero, and
/// saturate at ±5.242 87 mm. `counter` counts cycles and is the same in both halves.
///
/// ```
/// use trueup_core::{cnc::Output, units::Nanometres};
/// use trueup_link::frames;
/// let um = |value| Nanometres(value * 1_000);
/// let output = Output { offset: Some([um(1), um(-2), um(0)]), ..Output::default() };
/// let frame = frames::offset_xy(&output, 7);
/// // +100 and -200 bits of 10 nm: 0x00064 and 0xFFF38 from bit 24.
/// assert_eq!(frame.data()[2..], [0x07, 0x64, 0x00, 0x80, 0xF3, 0xFF]);
/// assert_eq!(frames::decode_offset_xy(&frame)?.offset, Some([um(1), um(-2)]));
/// # Ok::<(), trueup_link::frames::DecodeError>(())
/// ```
#[must_use]
pub fn offset_xy(output: &Output, counter: u8) -> Frame {
    let [x, y] = match output.offset {
        Some([x, y, _]) => [offset_to_raw(x), offset_to_raw(y)],
        None => [NOT_AVAILABLE_RAW; 2],
    };
    let mut data = [0; 8];
    OFFSET_X.insert(&mut data, x);
    OFFSET_Y.insert(&mut data, y);
    protected(OFFSET_XY_ID, counter, data)
}

/// `OffsetZ`: the second half of a cycle, as [`offset_xy`].
#[must_use]
pub fn offset_z(output: &Output, counter: u8) -> Frame {
    let z = match output.offset {
        Some([_, _, z]) => offset_to_raw(z),
        None => NOT_AVAILABLE_RAW,
    };
    let mut data = [0; 8];
    OFFSET_Z.insert(&mut data, z);
    QUALITY.insert(&mut data, output.quality as i32);
    FLAGS.insert(&mut data, output.flags.0.into());
    AGE.insert(&mut data, output.age_ms.into());
    protected(OFFSET_Z_ID, counter, data)
}

/// `Heartbeat`: one byte, not protected, as CiA 301 has it.
#[must_use]
pub fn heartbeat(state: State) -> Frame {
    let mut data = [0; 8];
    STATE.insert(&mut data, state as i32);
    let [byte, ..] = data;
    Frame::single(HEARTBEAT_ID, byte)
}

/// `Spindle`: speed and load, from the CNC. `counter` counts the frames of this identifier.
#[must_use]
pub fn spindle(spindle: Spindle, counter: u8) -> Frame {
    let mut data = [0; 8];
    SPEED.insert(&mut data, spindle.speed.0.into());
    LOAD.insert(&mut data, spindle.load_n.into());
    protected(SPINDLE_ID, counter, data)
}

/// `Control`: the CNC's sign of life. `counter` counts the frames of this identifier.
#[must_use]
pub fn control(control: Control, counter: u8) -> Frame {
    let mut data = [0; 8];
    ENGAGE.insert(&mut data, control.engage.into());
    REFERENCED.insert(&mut data, control.referenced.into());
    ZERO.insert(&mut data, control.zero.into());
    protected(CONTROL_ID, counter, data)
}

/// What an `OffsetXY` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length.
pub fn decode_offset_xy(frame: &Frame) -> Result<OffsetXy, DecodeError> {
    let data = data_of(frame, OFFSET_XY_ID, 8)?;
    let x = offset_from_raw(OFFSET_X.extract(data));
    let y = offset_from_raw(OFFSET_Y.extract(data));
    Ok(OffsetXy { offset: x.zip(y).map(|(x, y)| [x, y]) })
}

/// What an `OffsetZ` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length, or a quality that has no meaning.
pub fn decode_offset_z(frame: &Frame) -> Result<OffsetZ, DecodeError> {
    let data = data_of(frame, OFFSET_Z_ID, 8)?;
    let quality = byte(QUALITY, data);
    Ok(OffsetZ {
        offset: offset_from_raw(OFFSET_Z.extract(data)),
        quality: Quality::from_wire(quality)
            .ok_or(DecodeError::Value { signal: "Quality", raw: quality })?,
        flags: Flags(byte(FLAGS, data)),
        age_ms: byte(AGE, data),
    })
}

/// What a `Heartbeat` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length, or a state that CiA 301 does not define.
pub fn decode_heartbeat(frame: &Frame) -> Result<State, DecodeError> {
    let state = byte(STATE, data_of(frame, HEARTBEAT_ID, 1)?);
    State::from_wire(state).ok_or(DecodeError::Value { signal: "State", raw: state })
}

/// What a `Spindle` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length.
pub fn decode_spindle(frame: &Frame) -> Result<Spindle, DecodeError> {
    let data = data_of(frame, SPINDLE_ID, 8)?;
    let [speed_low, speed_high, ..] = SPEED.extract(data).to_le_bytes();
    let [load_low, load_high, ..] = LOAD.extract(data).to_le_bytes();
    Ok(Spindle {
        speed: Rpm(u16::from_le_bytes([speed_low, speed_high])),
        load_n: i16::from_le_bytes([load_low, load_high]),
    })
}

/// What a `Control` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length.
pub fn decode_control(frame: &Frame) -> Result<Control, DecodeError> {
    let data = data_of(frame, CONTROL_ID, 8)?;
    Ok(Control {
        engage: ENGAGE.extract(data) != 0,
        referenced: REFERENCED.extract(data) != 0,
        zero: ZERO.extract(data) != 0,
    })
}

/// The E2E counter of a protected frame; 0 if the frame is too short to have one.
#[must_use]
pub fn counter(frame: &Frame) -> u8 {
    byte(crate::layout::COUNTER, frame.data())
}

fn protected(id: u16, counter: u8, mut data: [u8; 8]) -> Frame {
    e2e::protect(id, counter, &mut data);
    Frame::full(id, data)
}

fn data_of(frame: &Frame, id: u16, len: u8) -> Result<&[u8; 8], DecodeError> {
    if frame.id() != id {
        return Err(DecodeError::Identifier { expected: id, found: frame.id() });
    }
    if frame.len() != len {
        return Err(DecodeError::Length { expected: len, found: frame.len() });
    }
    Ok(frame.data())
}

/// A signal of at most 8 bits.
fn byte(signal: Signal, data: &[u8; 8]) -> u8 {
    let [byte, ..] = signal.extract(data).to_le_bytes();
    byte
}

fn offset_to_raw(offset: Nanometres) -> i32 {
    const HALF_BIT: i32 = NANOMETRES_PER_BIT / 2;
    let half = if offset.0 < 0 { -HALF_BIT } else { HALF_BIT };
    let bits = offset.0.saturating_add(half) / NANOMETRES_PER_BIT;
    bits.clamp(-OFFSET_MAX_RAW, OFFSET_MAX_RAW)
}

fn offset_from_raw(raw: i32) -> Option<Nanometres> {
    (raw != NOT_AVAILABLE_RAW).then(|| Nanometres(raw.saturating_mul(NANOMETRES_PER_BIT)))
}

/// Why a frame says nothing that can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecodeError {
    /// This is another frame.
    Identifier {
        /// The identifier asked for.
        expected: u16,
        /// The identifier of the frame.
        found: u16,
    },
    /// The frame has another length than the DBC says.
    Length {
        /// Bytes that the DBC says.
        expected: u8,
        /// Bytes in the frame.
        found: u8,
    },
    /// A number that means nothing.
    Value {
        /// The signal, as the DBC names it.
        signal: &'static str,
        /// Its raw value.
        raw: u8,
    },
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Identifier { expected, found } => {
                write!(f, "identifier is 0x{found:03X}, should be 0x{expected:03X}")
            }
            Self::Length { expected, found } => {
                write!(f, "frame has {found} bytes, should have {expected}")
            }
            Self::Value { signal, raw } => write!(f, "{signal} {raw} has no meaning"),
        }
    }
}

impl Error for DecodeError {}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn output(offset_nm: Option<[i32; 3]>, quality: Quality, flags: u8, age_ms: u8) -> Output {
        Output {
            offset: offset_nm.map(|nm| nm.map(Nanometres)),
            quality,
            flags: Flags(flags),
            age_ms,
        }
    }

    fn hex(digits: u64) -> [u8; 8] {
        digits.to_be_bytes()
    }

    // The bytes of the `matches_other_tools` tests come from cantools (strict) for the signals
    // and from autosar-e2e for the protection, each reading trueup.dbc.

    #[test]
    fn offset_frames_match_other_tools() {
        let nothing = output(Some([0; 3]), Quality::Off, 0, 0);
        assert_eq!(offset_xy(&nothing, 0).data(), &hex(0xb609_0000_0000_0000));
        let some = output(Some([12_340, -56_780, -77_010]), Quality::Live, 0x22, 1);
        assert_eq!(offset_xy(&some, 7).data(), &hex(0x7ce6_07d2_0420_9dfe));
        assert_eq!(offset_z(&some, 7).data(), &hex(0x2cef_07eb_e11f_2201));
        let ends = output(Some([5_242_870, -5_242_870, 0]), Quality::Off, 0, 0);
        assert_eq!(offset_xy(&ends, 255).data(), &hex(0xe334_ffff_ff17_0080));
        let missing = output(None, Quality::Fault, 0x88, 255);
        assert_eq!(offset_xy(&missing, 1).data(), &hex(0x1277_0100_0008_0080));
        assert_eq!(offset_z(&missing, 1).data(), &hex(0x6ff2_0100_0068_88ff));
    }

    #[test]
    fn command_frames_match_other_tools() {
        let cutting = Spindle { speed: Rpm(24_000), load_n: -1_500 };
        assert_eq!(spindle(cutting, 3).data(), &hex(0xfd81_03c0_5d24_fa00));
        let ends = Spindle { speed: Rpm(u16::MAX), load_n: i16::MAX };
        assert_eq!(spindle(ends, 4).data(), &hex(0x8945_04ff_ffff_7f00));
        let run = Control { engage: true, referenced: true, zero: false };
        assert_eq!(control(run, 9).data(), &hex(0xb4e6_0903_0000_0000));
        let zero = Control { engage: false, referenced: false, zero: true };
        assert_eq!(control(zero, 10).data(), &hex(0x8537_0a04_0000_0000));
    }

    #[test]
    fn heartbeats_match_other_tools() {
        assert_eq!(heartbeat(State::BootUp).payload(), [0x00]);
        assert_eq!(heartbeat(State::Operational).payload(), [0x05]);
        assert_eq!(heartbeat(State::PreOperational).payload(), [0x7F]);
    }

    #[test]
    fn offsets_round_half_away_from_zero_and_saturate_short_of_the_missing_value() {
        for (nm, raw) in [
            (0, 0),
            (4, 0),
            (5, 1),
            (14, 1),
            (15, 2),
            (-4, 0),
            (-5, -1),
            (-15, -2),
            (5_242_874, 524_287),
            (5_242_875, 524_287),
            (-5_242_875, -524_287),
            (-5_242_885, -524_287),
            (i32::MAX, 524_287),
            (i32::MIN, -524_287),
        ] {
            assert_eq!(offset_to_raw(Nanometres(nm)), raw, "{nm} nm");
        }
    }

    #[test]
    fn one_missing_half_makes_x_and_y_missing() {
        for signal in [OFFSET_X, OFFSET_Y] {
            let mut data = [0; 8];
            signal.insert(&mut data, NOT_AVAILABLE_RAW);
            let frame = Frame::full(OFFSET_XY_ID, data);
            assert_eq!(decode_offset_xy(&frame), Ok(OffsetXy { offset: None }));
        }
    }

    #[test]
    fn the_reserved_bit_of_a_heartbeat_is_ignored() {
        let frame = Frame::single(HEARTBEAT_ID, 0x85);
        assert_eq!(decode_heartbeat(&frame), Ok(State::Operational));
    }

    #[test]
    fn another_identifier_length_or_value_is_refused_with_what_was_found() {
        let frame = control(Control::default(), 0);
        assert_eq!(
            decode_spindle(&frame),
            Err(DecodeError::Identifier { expected: SPINDLE_ID, found: CONTROL_ID })
        );
        let short = Frame::new(CONTROL_ID, &[0; 7]).unwrap();
        assert_eq!(decode_control(&short), Err(DecodeError::Length { expected: 8, found: 7 }));
        for raw in 7..16 {
            let mut data = [0; 8];
            QUALITY.insert(&mut data, raw);
            let error = decode_offset_z(&Frame::full(OFFSET_Z_ID, data)).unwrap_err();
            let raw = u8::try_from(raw).unwrap();
            let signal = "Quality";
            assert_eq!(error, DecodeError::Value { signal, raw });
        }
        let error = decode_heartbeat(&Frame::single(HEARTBEAT_ID, 1)).unwrap_err();
        let signal = "State";
        assert_eq!(error, DecodeError::Value { signal, raw: 1 });
    }

    proptest! {
        #[test]
        fn offsets_come_back_to_the_nearest_10_nm(
            nm in prop::option::of(prop::array::uniform3(-5_242_870..=5_242_870)),
            quality in 0_u8..=6, flags: u8, age_ms: u8, count: u8,
        ) {
            let sent = output(nm, Quality::from_wire(quality).unwrap(), flags, age_ms);
            let (first, second) = (offset_xy(&sent, count), offset_z(&sent, count));
            prop_assert_eq!((counter(&first), counter(&second)), (count, count));
            let xy = decode_offset_xy(&first).unwrap();
            let z = decode_offset_z(&second).unwrap();
            prop_assert_eq!((z.quality, z.flags, z.age_ms), (sent.quality, sent.flags, age_ms));
            prop_assert_eq!(xy.offset.is_some(), nm.is_some());
            prop_assert_eq!(z.offset.is_some(), nm.is_some());
            if let (Some(nm), Some([x, y]), Some(z)) = (nm, xy.offset, z.offset) {
                for (sent, came) in nm.into_iter().zip([x, y, z]) {
                    prop_assert!((sent - came.0).abs() <= 5);
                    prop_assert_eq!(came.0 % 10, 0);
                }
            }
        }

        #[test]
        fn commands_come_back_whole(speed: u16, load_n: i16, bits in 0_u8..8, count: u8) {
            let sent = Spindle { speed: Rpm(speed), load_n };
            prop_assert_eq!(decode_spindle(&spindle(sent, count)), Ok(sent));
            let sent = Control {
                engage: bits & 1 != 0,
                referenced: bits & 2 != 0,
                zero: bits & 4 != 0,
            };
            prop_assert_eq!(decode_control(&control(sent, count)), Ok(sent));
        }

        #[test]
        fn no_frame_makes_a_decoder_panic(id in 0_u16..0x800, data: [u8; 8], len in 0_usize..=8) {
            for id in [id, OFFSET_XY_ID, OFFSET_Z_ID, HEARTBEAT_ID, SPINDLE_ID, CONTROL_ID] {
                let frame = Frame::new(id, &data[..len]).unwrap();
                let _ = decode_offset_xy(&frame);
                let _ = decode_offset_z(&frame);
                let _ = decode_heartbeat(&frame);
                let _ = decode_spindle(&frame);
                let _ = decode_control(&frame);
            }
        }
    }
}
