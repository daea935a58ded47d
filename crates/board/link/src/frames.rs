//! Every frame, both ways: what it says, to and from the bytes of `trueup.dbc`.
//!
//! The encoders protect the frame they build; the decoders read the layout alone. Whether a
//! received frame may be used at all is for [`crate::receiver`] to say, which checks the
//! protection first. Bits that no signal covers are sent as 0 and ignored.

use trueup_core::{
    cnc::{
        AxisPosition, Control, LinearAxis, MachineConditions, OffsetFlags, OffsetQuality, Output,
        RotaryAxisAngles, SpindleState, TravelDirection,
    },
    learned_changes::LearnedChangeRequest,
    units::{MicroDegrees, Nanometres, Position, Rpm},
};

pub use crate::layout::{
    CONDITIONS_ID, CONDITIONS_PERIOD_MS, CONTROL_ID, CONTROL_PERIOD_MS, HEARTBEAT_ID,
    HEARTBEAT_PERIOD_MS, OFFSET_PERIOD_MS, OFFSET_XY_ID, OFFSET_Z_ID, POSITION_PERIOD_MS,
    POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID, ROTARY_ID, ROTARY_PERIOD_MS, SPINDLE_ID,
    SPINDLE_PERIOD_MS,
};
use crate::{
    e2e,
    frame::Frame,
    layout::{
        ANGLE_1, ANGLE_2, CONDITIONS, CONFIRM, DIRECTION, ENGAGE, FLAGS, LEARNED, LEARNED_CRC,
        LEARNED_PART, LOAD, MAX_OFFSET_RAW, MICRO_DEGREES_PER_BIT, NANOMETRES_PER_BIT, NMT_STATE,
        NO_OFFSET_RAW, OFFSET_X, OFFSET_Y, OFFSET_Z, POSITION, QUALITY, REFERENCED, SAMPLE_AGE,
        SERVICE, SPEED, TOOL, ZERO,
    },
    signal::Signal,
};

/// Content of `OffsetXY`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OffsetXy {
    /// Offsets on X and Y; `None` if either is not available.
    pub offset: Option<[Nanometres; 2]>,
}

/// Content of `OffsetZ`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OffsetZ {
    /// Offset on Z; `None`: not available.
    pub offset: Option<Nanometres>,
    /// How good the offsets on all three axes are.
    pub quality: OffsetQuality,
    /// Why they are not simply the full correction.
    pub flags: OffsetFlags,
    /// Milliseconds since the newest sample; 255 stands for all beyond.
    pub age_ms: u8,
}

/// The bridge's state in its heartbeat. The numbers are those of CiA 301.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum NmtState {
    /// Just started; sent once.
    BootUp = 0,
    /// Silent but for the heartbeat.
    Stopped = 4,
    /// Sends offsets, each with its quality.
    Operational = 5,
    /// Ready, but sends no offsets.
    PreOperational = 127,
}

impl NmtState {
    /// Returns the state with this number on the wire.
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
/// let frame = frames::encode_offset_xy(&output, 7);
/// // +100 and -200 bits of 10 nm: 0x00064 and 0xFFF38 from bit 24.
/// assert_eq!(frame.data()[2..], [0x07, 0x64, 0x00, 0x80, 0xF3, 0xFF]);
/// assert_eq!(frames::decode_offset_xy(&frame)?.offset, Some([um(1), um(-2)]));
/// # Ok::<(), trueup_link::frames::DecodeError>(())
/// ```
#[must_use]
pub fn encode_offset_xy(output: &Output, counter: u8) -> Frame {
    let [x, y] = match output.offset {
        Some([x, y, _]) => [offset_to_raw(x), offset_to_raw(y)],
        None => [NO_OFFSET_RAW; 2],
    };
    let mut data = [0; 8];
    OFFSET_X.insert(&mut data, x);
    OFFSET_Y.insert(&mut data, y);
    build_protected_frame(OFFSET_XY_ID, counter, data)
}

/// `OffsetZ`: the second half of a cycle, as [`encode_offset_xy`].
#[must_use]
pub fn encode_offset_z(output: &Output, counter: u8) -> Frame {
    let z = match output.offset {
        Some([_, _, z]) => offset_to_raw(z),
        None => NO_OFFSET_RAW,
    };
    let mut data = [0; 8];
    OFFSET_Z.insert(&mut data, z);
    QUALITY.insert(&mut data, output.quality as i32);
    FLAGS.insert(&mut data, output.flags.0.into());
    SAMPLE_AGE.insert(&mut data, output.age_ms.into());
    build_protected_frame(OFFSET_Z_ID, counter, data)
}

/// `Heartbeat`: one byte, not protected, as CiA 301 has it.
#[must_use]
pub fn encode_heartbeat(state: NmtState) -> Frame {
    let mut data = [0; 8];
    NMT_STATE.insert(&mut data, state as i32);
    let [byte, ..] = data;
    Frame::from_byte(HEARTBEAT_ID, byte)
}

/// `Spindle`: speed and load, from the CNC. `counter` counts the frames of this identifier.
#[must_use]
pub fn encode_spindle(spindle: SpindleState, counter: u8) -> Frame {
    let mut data = [0; 8];
    SPEED.insert(&mut data, spindle.speed.0.into());
    LOAD.insert(&mut data, spindle.load_n.into());
    build_protected_frame(SPINDLE_ID, counter, data)
}

/// `Control`: the CNC's sign of life. `counter` counts the frames of this identifier.
#[must_use]
pub fn encode_control(control: Control, counter: u8) -> Frame {
    let mut data = [0; 8];
    ENGAGE.insert(&mut data, control.engage.into());
    REFERENCED.insert(&mut data, control.referenced.into());
    ZERO.insert(&mut data, control.zero.into());
    SERVICE.insert(&mut data, control.service.into());
    CONFIRM.insert(&mut data, control.confirm.into());
    let LearnedChangeRequest { part, amount, calibration } = control.learned;
    LEARNED_PART.insert(&mut data, part.into());
    LEARNED.insert(&mut data, amount.into());
    LEARNED_CRC.insert(&mut data, calibration.into());
    build_protected_frame(CONTROL_ID, counter, data)
}

/// `Conditions`: the tool and the conditions of the machine, from the CNC. `counter` counts the frames of this
/// identifier.
///
/// ```
/// use trueup_core::cnc::MachineConditions;
/// use trueup_link::frames;
/// let sent = MachineConditions { tool: 0x0107, bits: 0x8001 };
/// let frame = frames::encode_conditions(sent, 7);
/// assert_eq!(frame.id(), 0x402);
/// assert_eq!(frame.data()[2..], [0x07, 0x07, 0x01, 0x01, 0x80, 0x00]);
/// assert_eq!(frames::decode_conditions(&frame), Ok(sent));
/// ```
#[must_use]
pub fn encode_conditions(conditions: MachineConditions, counter: u8) -> Frame {
    let mut data = [0; 8];
    TOOL.insert(&mut data, conditions.tool.into());
    CONDITIONS.insert(&mut data, conditions.bits.into());
    build_protected_frame(CONDITIONS_ID, counter, data)
}

/// Returns how a CNC begins after every start of the bridge, before it raises `Engage`: three `Control`
/// frames without it, with the counters 0, 1 and 2.
#[must_use]
pub fn disengaged_control_frames() -> [Frame; 3] {
    [0, 1, 2].map(|counter| encode_control(Control::REFERENCED, counter))
}

/// Returns the identifier of `PositionX`, `PositionY` or `PositionZ`.
#[must_use]
pub const fn position_frame_id(axis: LinearAxis) -> u16 {
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
/// use trueup_core::{cnc::{AxisPosition, TravelDirection, LinearAxis}, units::Position};
/// use trueup_link::frames;
/// let sent = AxisPosition {
///     axis: LinearAxis::X,
///     position: Position(-Position::PER_MILLIMETRE), // -100 000 = 0xFFFE7960
///     direction: TravelDirection::Negative,                  // -1 in two bits: 3
/// };
/// let frame = frames::encode_position(sent, 7);
/// assert_eq!(frame.id(), 0x201);
/// assert_eq!(frame.data()[2..], [0x07, 0x60, 0x79, 0xFE, 0xFF, 0x03]);
/// assert_eq!(frames::decode_position(LinearAxis::X, &frame), Ok(sent));
/// ```
#[must_use]
pub fn encode_position(position: AxisPosition, counter: u8) -> Frame {
    let mut data = [0; 8];
    POSITION.insert(&mut data, position.position.0);
    DIRECTION.insert(&mut data, position.direction as i32);
    build_protected_frame(position_frame_id(position.axis), counter, data)
}

/// `Rotary`, from the CNC: angles are rounded to 0.0005°, halves away from zero, and saturate at
/// −262.144° and +262.1435°. `counter` counts the frames of this identifier.
#[must_use]
pub fn encode_rotary(rotary: RotaryAxisAngles, counter: u8) -> Frame {
    let mut data = [0; 8];
    let [first, second] =
        rotary.angles.map(|angle| divide_rounded::<MICRO_DEGREES_PER_BIT>(angle.0));
    ANGLE_1.insert(&mut data, first);
    ANGLE_2.insert(&mut data, second);
    build_protected_frame(ROTARY_ID, counter, data)
}

/// Returns what an `OffsetXY` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length.
pub fn decode_offset_xy(frame: &Frame) -> Result<OffsetXy, DecodeError> {
    let data = checked_frame_data(frame, OFFSET_XY_ID, 8)?;
    let x = offset_from_raw(OFFSET_X.extract(data));
    let y = offset_from_raw(OFFSET_Y.extract(data));
    Ok(OffsetXy { offset: x.zip(y).map(|(x, y)| [x, y]) })
}

/// Returns what an `OffsetZ` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length, or a quality that has no meaning.
pub fn decode_offset_z(frame: &Frame) -> Result<OffsetZ, DecodeError> {
    let data = checked_frame_data(frame, OFFSET_Z_ID, 8)?;
    let quality = extract_byte(QUALITY, data);
    Ok(OffsetZ {
        offset: offset_from_raw(OFFSET_Z.extract(data)),
        quality: OffsetQuality::from_wire(quality)
            .ok_or(DecodeError::Value { signal: "Quality", raw: quality.into() })?,
        flags: OffsetFlags(extract_byte(FLAGS, data)),
        age_ms: extract_byte(SAMPLE_AGE, data),
    })
}

/// Returns what a `Heartbeat` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length, or a state that CiA 301 does not define.
pub fn decode_heartbeat(frame: &Frame) -> Result<NmtState, DecodeError> {
    let state = extract_byte(NMT_STATE, checked_frame_data(frame, HEARTBEAT_ID, 1)?);
    NmtState::from_wire(state).ok_or(DecodeError::Value { signal: "State", raw: state.into() })
}

/// Returns what a `Spindle` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length.
pub fn decode_spindle(frame: &Frame) -> Result<SpindleState, DecodeError> {
    let data = checked_frame_data(frame, SPINDLE_ID, 8)?;
    let [speed_low, speed_high, ..] = SPEED.extract(data).to_le_bytes();
    let [load_low, load_high, ..] = LOAD.extract(data).to_le_bytes();
    Ok(SpindleState {
        speed: Rpm(u16::from_le_bytes([speed_low, speed_high])),
        load_n: i16::from_le_bytes([load_low, load_high]),
    })
}

/// Returns what a `Control` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length.
pub fn decode_control(frame: &Frame) -> Result<Control, DecodeError> {
    let data = checked_frame_data(frame, CONTROL_ID, 8)?;
    // Both lie in whole bytes.
    let [_, _, _, _, amount_low, amount_high, crc_low, crc_high] = *data;
    Ok(Control {
        engage: ENGAGE.extract(data) != 0,
        referenced: REFERENCED.extract(data) != 0,
        zero: ZERO.extract(data) != 0,
        service: SERVICE.extract(data) != 0,
        confirm: CONFIRM.extract(data) != 0,
        learned: LearnedChangeRequest {
            part: extract_byte(LEARNED_PART, data),
            amount: i16::from_le_bytes([amount_low, amount_high]),
            calibration: u16::from_le_bytes([crc_low, crc_high]),
        },
    })
}

/// Returns what a `Conditions` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length.
pub fn decode_conditions(frame: &Frame) -> Result<MachineConditions, DecodeError> {
    // Both lie in whole bytes.
    let [_, _, _, tool_low, tool_high, bits_low, bits_high, _] =
        *checked_frame_data(frame, CONDITIONS_ID, 8)?;
    Ok(MachineConditions {
        tool: u16::from_le_bytes([tool_low, tool_high]),
        bits: u16::from_le_bytes([bits_low, bits_high]),
    })
}

/// Returns what the position frame of this axis says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length, or a direction that has no meaning.
pub fn decode_position(axis: LinearAxis, frame: &Frame) -> Result<AxisPosition, DecodeError> {
    let data = checked_frame_data(frame, position_frame_id(axis), 8)?;
    let raw = DIRECTION.extract(data);
    let direction = i8::try_from(raw).ok().and_then(TravelDirection::from_wire);
    Ok(AxisPosition {
        axis,
        position: Position(POSITION.extract(data)),
        direction: direction.ok_or(DecodeError::Value { signal: "Direction", raw })?,
    })
}

/// Returns what a `Rotary` frame says.
///
/// # Errors
/// [`DecodeError`] for another identifier or length.
pub fn decode_rotary(frame: &Frame) -> Result<RotaryAxisAngles, DecodeError> {
    let data = checked_frame_data(frame, ROTARY_ID, 8)?;
    let angle =
        |signal: Signal| MicroDegrees(signal.extract(data).saturating_mul(MICRO_DEGREES_PER_BIT));
    Ok(RotaryAxisAngles { angles: [angle(ANGLE_1), angle(ANGLE_2)] })
}

/// Returns the E2E counter of a protected frame; 0 if the frame is too short to have one.
#[must_use]
pub fn e2e_counter(frame: &Frame) -> u8 {
    extract_byte(crate::layout::E2E_COUNTER, frame.data())
}

pub(crate) fn build_protected_frame(id: u16, counter: u8, mut data: [u8; 8]) -> Frame {
    e2e::protect(id, counter, &mut data);
    Frame::from_data(id, data)
}

/// Returns the data of a frame that has this identifier and this length in bytes, 0…8.
///
/// # Errors
/// [`DecodeError`] for another identifier or length.
pub fn checked_frame_data(frame: &Frame, id: u16, len: u8) -> Result<&[u8; 8], DecodeError> {
    if frame.id() != id {
        return Err(DecodeError::Identifier { expected: id, found: frame.id() });
    }
    if frame.len() != len {
        return Err(DecodeError::Length { expected: len, found: frame.len() });
    }
    Ok(frame.data())
}

/// Returns the raw value of an unsigned signal of at most 8 bits; of a longer one its lowest 8.
#[must_use]
pub fn extract_byte(signal: Signal, data: &[u8; 8]) -> u8 {
    let [byte, ..] = signal.extract(data).to_le_bytes();
    byte
}

/// Returns the nearest number of bits of `UNIT` each, halves away from zero.
fn divide_rounded<const UNIT: i32>(value: i32) -> i32 {
    let half = const { UNIT / 2 };
    let half = if value < 0 { half.saturating_neg() } else { half };
    value.saturating_add(half).checked_div(UNIT).unwrap_or(value)
}

fn offset_to_raw(offset: Nanometres) -> i32 {
    const MAX_OFFSET: Nanometres = Nanometres(MAX_OFFSET_RAW.wrapping_mul(NANOMETRES_PER_BIT));
    let (held, _) = offset.clamped(MAX_OFFSET);
    divide_rounded::<NANOMETRES_PER_BIT>(held.0)
}

fn offset_from_raw(raw: i32) -> Option<Nanometres> {
    (raw != NO_OFFSET_RAW).then(|| Nanometres(raw.saturating_mul(NANOMETRES_PER_BIT)))
}

/// Why a frame cannot be decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// This is another frame.
    #[error("identifier is 0x{found:03X}, should be 0x{expected:03X}")]
    Identifier {
        /// The requested identifier.
        expected: u16,
        /// The identifier of the frame.
        found: u16,
    },
    /// The frame has another length than the DBC says.
    #[error("frame has {found} bytes, should have {expected}")]
    Length {
        /// Bytes that the DBC says.
        expected: u8,
        /// Bytes in the frame.
        found: u8,
    },
    /// A number that means nothing.
    #[error("{signal} {raw} has no meaning")]
    Value {
        /// The signal, as the DBC names it.
        signal: &'static str,
        /// Its raw value.
        raw: i32,
    },
}

#[cfg(test)]
mod tests;
