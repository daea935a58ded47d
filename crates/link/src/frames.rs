//! Every frame, both ways: what it says, to and from the bytes of `trueup.dbc`.
//!
//! The encoders protect the frame they build; the decoders read the layout alone. Whether a
//! received frame may be used at all is for [`crate::receiver`] to say, which checks the
//! protection first. Bits that no signal covers are sent as 0 and ignored.

use core::{error::Error, fmt};

use trueup_core::{
    cnc::{AxisPosition, Control, Flags, Heading, LinearAxis, Output, Quality, Rotary, Spindle},
    units::{MicroDegrees, Nanometres, Position, Rpm},
};

pub use crate::layout::{
    CONTROL_ID, CONTROL_PERIOD_MS, HEARTBEAT_ID, HEARTBEAT_PERIOD_MS, OFFSET_PERIOD_MS,
    OFFSET_XY_ID, OFFSET_Z_ID, POSITION_PERIOD_MS, POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID,
    ROTARY_ID, ROTARY_PERIOD_MS, SPINDLE_ID, SPINDLE_PERIOD_MS,
};
use crate::{
    bits::Signal,
    e2e,
    frame::Frame,
    layout::{
        AGE, ANGLE_1, ANGLE_2, DIRECTION, ENGAGE, FLAGS, LOAD, MICRO_DEGREES_PER_BIT,
        NANOMETRES_PER_BIT, NOT_AVAILABLE_RAW, OFFSET_MAX_RAW, OFFSET_X, OFFSET_Y, OFFSET_Z,
        POSITION, QUALITY, REFERENCED, SPEED, STATE, ZERO,
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

/// The identifier of `PositionX`, `PositionY` or `PositionZ`.
#[must_use]
pub const fn position_id(axis: LinearAxis) -> u16 {
    match axis {
        LinearAxis::X => POSITION_X_ID,
        LinearAxis::Y => POSITION_Y_ID,
        LinearAxis::Z => POSITION_Z_ID,
    }
}

/// `PositionX`, `PositionY` or `PositionZ`, from the CNC. `counter` counts the frames of this
/// identifier.
///
/// ```
/// use trueup_core::{cnc::{AxisPosition, Heading, LinearAxis}, units::Position};
/// use trueup_link::frames;
/// let sent = AxisPosition {
///     axis: LinearAxis::X,
///     position: Position(-Position::PER_MILLIMETRE), // -100 000 = 0xFFFE7960
///     direction: Heading::Negative,                  // -1 in two bits: 3
/// };
/// let frame = frames::position(sent, 7);
/// assert_eq!(frame.id(), 0x201);
/// assert_eq!(frame.data()[2..], [0x07, 0x60, 0x79, 0xFE, 0xFF, 0x03]);
/// assert_eq!(frames::decode_position(LinearAxis::X, &frame), Ok(sent));
/// ```
#[must_use]
pub fn position(position: AxisPosition, counter: u8) -> Frame {
    let mut data = [0; 8];
    POSITION.insert(&mut data, position.position.0);
    DIRECTION.insert(&mut data, position.direction as i32);
    protected(position_id(position.axis), counter, data)
}

/// `Rotary`, from the CNC: angles are rounded to 0.0005°, halves away from zero, and saturate at
/// −262.144° and +262.1435°. `counter` counts the frames of this identifier.
#[must_use]
pub fn rotary(rotary: Rotary, counter: u8) -> Frame {
    let mut data = [0; 8];
    let [first, second] = rotary.angles.map(|angle| nearest::<MICRO_DEGREES_PER_BIT>(angle.0));
    ANGLE_1.insert(&mut data, first);
    ANGLE_2.insert(&mut data, second);
    protected(ROTARY_ID, counter, data)
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
            .ok_or(DecodeError::Value { signal: "Quality", raw: quality.into() })?,
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
    State::from_wire(state).ok_or(DecodeError::Value { signal: "State", raw: state.into() })
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

/// What the position frame of this axis says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length, or a direction that has no meaning.
pub fn decode_position(axis: LinearAxis, frame: &Frame) -> Result<AxisPosition, DecodeError> {
    let data = data_of(frame, position_id(axis), 8)?;
    let raw = DIRECTION.extract(data);
    let direction = i8::try_from(raw).ok().and_then(Heading::from_wire);
    Ok(AxisPosition {
        axis,
        position: Position(POSITION.extract(data)),
        direction: direction.ok_or(DecodeError::Value { signal: "Direction", raw })?,
    })
}

/// What a `Rotary` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length.
pub fn decode_rotary(frame: &Frame) -> Result<Rotary, DecodeError> {
    let data = data_of(frame, ROTARY_ID, 8)?;
    let angle = |it: Signal| MicroDegrees(it.extract(data).saturating_mul(MICRO_DEGREES_PER_BIT));
    Ok(Rotary { angles: [angle(ANGLE_1), angle(ANGLE_2)] })
}

/// The E2E counter of a protected frame; 0 if the frame is too short to have one.
#[must_use]
pub fn counter(frame: &Frame) -> u8 {
    byte(crate::layout::COUNTER, frame.data())
}

pub(crate) fn protected(id: u16, counter: u8, mut data: [u8; 8]) -> Frame {
    e2e::protect(id, counter, &mut data);
    Frame::full(id, data)
}

/// The data of a frame that has this identifier and this length in bytes, 0…8.
///
/// # Errors
/// [`DecodeError`] for another identifier or length.
pub fn data_of(frame: &Frame, id: u16, len: u8) -> Result<&[u8; 8], DecodeError> {
    if frame.id() != id {
        return Err(DecodeError::Identifier { expected: id, found: frame.id() });
    }
    if frame.len() != len {
        return Err(DecodeError::Length { expected: len, found: frame.len() });
    }
    Ok(frame.data())
}

/// The raw value of an unsigned signal of at most 8 bits; of a longer one its lowest 8.
#[must_use]
pub fn byte(signal: Signal, data: &[u8; 8]) -> u8 {
    let [byte, ..] = signal.extract(data).to_le_bytes();
    byte
}

/// The nearest number of bits of `UNIT` each, halves away from zero.
fn nearest<const UNIT: i32>(value: i32) -> i32 {
    let half = const { UNIT / 2 };
    let half = if value < 0 { half.saturating_neg() } else { half };
    value.saturating_add(half).checked_div(UNIT).unwrap_or(value)
}

fn offset_to_raw(offset: Nanometres) -> i32 {
    const LARGEST: Nanometres = Nanometres(OFFSET_MAX_RAW.wrapping_mul(NANOMETRES_PER_BIT));
    let (held, _) = offset.clamped(LARGEST);
    nearest::<NANOMETRES_PER_BIT>(held.0)
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
        raw: i32,
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

    fn at(axis: LinearAxis, position: i32, direction: Heading) -> AxisPosition {
        AxisPosition { axis, position: Position(position), direction }
    }

    fn angles(first: i32, second: i32) -> Rotary {
        Rotary { angles: [first, second].map(MicroDegrees) }
    }

    #[test]
    fn position_frames_match_other_tools() {
        let x = at(LinearAxis::X, 123_456_789, Heading::Positive);
        assert_eq!(position(x, 5).data(), &hex(0x8c4b_0515_cd5b_0701));
        let y = at(LinearAxis::Y, -1_500_000_001, Heading::Negative);
        assert_eq!(position(y, 200).data(), &hex(0xc3f3_c8ff_d097_a603));
        let z = at(LinearAxis::Z, i32::MIN, Heading::Standing);
        assert_eq!(position(z, 0).data(), &hex(0xb39f_0000_0000_8000));
        let end = at(LinearAxis::Z, i32::MAX, Heading::Positive);
        assert_eq!(position(end, 255).data(), &hex(0x0edc_ffff_ffff_7f01));
        // 90° and -33.3335°; both ends.
        assert_eq!(rotary(angles(90_000_000, -33_333_500), 17).data(), &hex(0x83a7_1120_bf52_b9ef));
        let ends = angles(-262_144_000, 262_143_500);
        assert_eq!(rotary(ends, 18).data(), &hex(0x5962_1200_00f8_ff7f));
    }

    #[test]
    fn angles_round_half_away_from_zero_and_saturate_at_their_20_bits() {
        for (sent, came) in [
            (0, 0),
            (249, 0),
            (250, 500),
            (-249, 0),
            (-250, -500),
            (-749, -500),
            (-750, -1_000),
            (262_143_749, 262_143_500),
            (262_143_750, 262_143_500),
            (-262_144_250, -262_144_000),
            (i32::MAX, 262_143_500),
            (i32::MIN, -262_144_000),
        ] {
            let frame = rotary(angles(sent, 0), 0);
            assert_eq!(decode_rotary(&frame), Ok(angles(came, 0)), "{sent} micro-degrees");
        }
    }

    #[test]
    fn a_direction_that_is_none_is_refused() {
        let mut data = *position(at(LinearAxis::Y, 1, Heading::Standing), 0).data();
        DIRECTION.insert(&mut data, -2);
        let error = decode_position(LinearAxis::Y, &Frame::full(POSITION_Y_ID, data));
        assert_eq!(error, Err(DecodeError::Value { signal: "Direction", raw: -2 }));
    }

    #[test]
    fn the_position_of_one_axis_is_none_of_another() {
        for axis in LinearAxis::ALL {
            let frame = position(at(axis, -5, Heading::Positive), 3);
            for expected in LinearAxis::ALL {
                let is_same = expected == axis;
                assert_eq!(decode_position(expected, &frame).is_ok(), is_same, "{axis:?}");
            }
        }
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
        fn positions_come_back_whole_and_angles_to_the_nearest_half_millidegree(
            place: i32, heading in -1_i8..=1, axis in 0_usize..3, count: u8,
            sent in prop::array::uniform2(-262_144_249..=262_143_749),
        ) {
            let axis = LinearAxis::ALL[axis];
            let there = at(axis, place, Heading::from_wire(heading).unwrap());
            let frame = position(there, count);
            prop_assert_eq!(counter(&frame), count);
            prop_assert_eq!(decode_position(axis, &frame), Ok(there));
            let came = decode_rotary(&rotary(angles(sent[0], sent[1]), count)).unwrap();
            for (sent, MicroDegrees(came)) in sent.into_iter().zip(came.angles) {
                prop_assert!((sent - came).abs() <= MICRO_DEGREES_PER_BIT / 2);
                prop_assert_eq!(came % MICRO_DEGREES_PER_BIT, 0);
            }
        }

        #[test]
        fn no_frame_makes_a_decoder_panic(id in 0_u16..0x800, data: [u8; 8], len in 0_usize..=8) {
            let ours = [
                id, OFFSET_XY_ID, OFFSET_Z_ID, HEARTBEAT_ID, SPINDLE_ID, CONTROL_ID,
                POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID, ROTARY_ID,
            ];
            for id in ours {
                let frame = Frame::new(id, &data[..len]).unwrap();
                let _ = decode_offset_xy(&frame);
                let _ = decode_offset_z(&frame);
                let _ = decode_heartbeat(&frame);
                let _ = decode_spindle(&frame);
                let _ = decode_control(&frame);
                let _ = decode_rotary(&frame);
                for axis in LinearAxis::ALL {
                    let _ = decode_position(axis, &frame);
                }
            }
        }
    }
}
