//! From received frames to what they say: only whole, new frames in order get through, and
//! everything refused is counted. Each identifier is a [`E2eStateMachine`] of its own, which is trusted or not.
//!
//! [`CncReceiver`] is the board's ear for the CNC; [`OffsetReceiver`] and [`StatusReceiver`] are the
//! CNC's, or a monitor's, ears for the board.

use trueup_core::cnc::{CncMessage, LinearAxis, Output};

use crate::{
    e2e::E2eError,
    e2e_state_machine::{E2eStateMachine, E2eStateMachineError},
    frame::Frame,
    frames::{
        self, CONDITIONS_ID, CONTROL_ID, DecodeError, OFFSET_XY_ID, OFFSET_Z_ID, OffsetXy, OffsetZ,
        POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID, ROTARY_ID, SPINDLE_ID,
    },
    layout::STATUS_ID,
    status::{self, FrameRejectReason, Status},
};

/// Counts of frames since the start. Each stops at its largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounters {
    /// Frames that were used.
    pub accepted: u32,
    /// Frames of a wrong length, or with a value that has no meaning.
    pub malformed: u32,
    /// Frames that were damaged or sent under another identifier.
    pub crc_errors: u32,
    /// Frames that were repeated or out of sequence, or came before their stream was trusted again.
    pub sequence_errors: u32,
    /// Frames that never came, from gaps in the counter of frames that were used.
    pub lost: u32,
}

impl FrameCounters {
    const ZERO: Self =
        Self { accepted: 0, malformed: 0, crc_errors: 0, sequence_errors: 0, lost: 0 };

    /// Checks the protection of a frame, reads it, and counts how that went.
    fn verify_and_decode<T>(
        &mut self,
        stream: &mut E2eStateMachine,
        frame: &Frame,
        decode: impl FnOnce(&Frame) -> Result<T, DecodeError>,
    ) -> Result<T, ReceiveError> {
        // Read first: a frame of the wrong length has no protection to check. Its content is
        // not looked at before the protection has been found good.
        let content = decode(frame);
        if let Err(error @ DecodeError::Length { .. }) = content {
            saturating_increment(&mut self.malformed);
            stream.record_damaged_frame(E2eError::TooShort { len: frame.len() });
            return Err(error.into());
        }
        match stream.accept(frame) {
            Ok(lost) => self.lost = self.lost.saturating_add(lost.into()),
            Err(error) => {
                saturating_increment(match error {
                    E2eStateMachineError::Frame(E2eError::TooShort { .. }) => &mut self.malformed,
                    E2eStateMachineError::Frame(E2eError::Crc { .. }) => &mut self.crc_errors,
                    E2eStateMachineError::Frame(
                        E2eError::Repeated { .. } | E2eError::WrongSequence { .. },
                    )
                    | E2eStateMachineError::Untrusted(_) => &mut self.sequence_errors,
                });
                return Err(error.into());
            }
        }
        saturating_increment(match content {
            Ok(_) => &mut self.accepted,
            Err(_) => &mut self.malformed,
        });
        Ok(content?)
    }
}

fn saturating_increment(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}

/// The board's ear for the CNC: every frame that it sends, each identifier with its own sequence.
#[derive(Clone, Copy, Debug)]
pub struct CncReceiver {
    position_x: E2eStateMachine,
    position_y: E2eStateMachine,
    position_z: E2eStateMachine,
    rotary: E2eStateMachine,
    spindle: E2eStateMachine,
    control: E2eStateMachine,
    conditions: E2eStateMachine,
    counters: FrameCounters,
}

impl CncReceiver {
    /// Returns a receiver that has received nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            position_x: E2eStateMachine::new(POSITION_X_ID),
            position_y: E2eStateMachine::new(POSITION_Y_ID),
            position_z: E2eStateMachine::new(POSITION_Z_ID),
            rotary: E2eStateMachine::new(ROTARY_ID),
            spindle: E2eStateMachine::new(SPINDLE_ID),
            control: E2eStateMachine::new(CONTROL_ID),
            conditions: E2eStateMachine::new(CONDITIONS_ID),
            counters: FrameCounters::ZERO,
        }
    }

    /// Returns what the CNC says in this frame; `None` for a frame that is not for the bridge.
    ///
    /// # Errors
    /// A frame for the bridge that must not be used. It is counted.
    pub fn accept(&mut self, frame: &Frame) -> Result<Option<CncMessage>, ReceiveError> {
        let counters = &mut self.counters;
        let mut position = |axis: LinearAxis, stream: &mut E2eStateMachine| {
            counters
                .verify_and_decode(stream, frame, |frame| frames::decode_position(axis, frame))
                .map(CncMessage::Position)
        };
        Ok(Some(match frame.id() {
            POSITION_X_ID => position(LinearAxis::X, &mut self.position_x)?,
            POSITION_Y_ID => position(LinearAxis::Y, &mut self.position_y)?,
            POSITION_Z_ID => position(LinearAxis::Z, &mut self.position_z)?,
            ROTARY_ID => CncMessage::Rotary(self.counters.verify_and_decode(
                &mut self.rotary,
                frame,
                frames::decode_rotary,
            )?),
            SPINDLE_ID => CncMessage::Spindle(self.counters.verify_and_decode(
                &mut self.spindle,
                frame,
                frames::decode_spindle,
            )?),
            CONTROL_ID => CncMessage::Control(self.counters.verify_and_decode(
                &mut self.control,
                frame,
                frames::decode_control,
            )?),
            CONDITIONS_ID => CncMessage::Conditions(self.counters.verify_and_decode(
                &mut self.conditions,
                frame,
                frames::decode_conditions,
            )?),
            _ => return Ok(None),
        }))
    }

    /// Returns whether a frame with this identifier is one that a CNC sends.
    #[must_use]
    pub const fn is_cnc_frame_id(id: u16) -> bool {
        matches!(
            id,
            POSITION_X_ID
                | POSITION_Y_ID
                | POSITION_Z_ID
                | ROTARY_ID
                | SPINDLE_ID
                | CONTROL_ID
                | CONDITIONS_ID
        )
    }

    /// Returns what has arrived so far.
    #[must_use]
    pub const fn counters(&self) -> FrameCounters {
        self.counters
    }
}

impl Default for CncReceiver {
    fn default() -> Self {
        Self::new()
    }
}

/// Half a cycle's offsets, waiting for the other half.
#[derive(Clone, Copy, Debug)]
enum PendingOffsetHalf {
    Xy(OffsetXy),
    Z(OffsetZ),
}

/// The CNC's ear for the board: puts `OffsetXY` and `OffsetZ` of the same counter together, so
/// that the offsets of a cycle are applied on all axes or on none.
///
/// It has no clock: its user must take back the offsets when no cycle has come for a while,
/// and in less than 256 ms, after which a counter comes round again.
#[derive(Clone, Copy, Debug)]
pub struct OffsetReceiver {
    xy: E2eStateMachine,
    z: E2eStateMachine,
    waiting: Option<(u8, PendingOffsetHalf)>,
    counters: FrameCounters,
    unpaired: u32,
}

impl OffsetReceiver {
    /// Returns a receiver that has received nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            xy: E2eStateMachine::new(OFFSET_XY_ID),
            z: E2eStateMachine::new(OFFSET_Z_ID),
            waiting: None,
            counters: FrameCounters::ZERO,
            unpaired: 0,
        }
    }

    /// Returns the output of a cycle, with the frame that completes it; the halves may come in either
    /// order. `None` for the first half, and for a frame that carries no offset.
    ///
    /// The offset is `None` unless all three axes are available.
    ///
    /// # Errors
    /// A frame with offsets that must not be used. It is counted.
    pub fn accept(&mut self, frame: &Frame) -> Result<Option<Output>, ReceiveError> {
        let half = match frame.id() {
            OFFSET_XY_ID => PendingOffsetHalf::Xy(self.counters.verify_and_decode(
                &mut self.xy,
                frame,
                frames::decode_offset_xy,
            )?),
            OFFSET_Z_ID => PendingOffsetHalf::Z(self.counters.verify_and_decode(
                &mut self.z,
                frame,
                frames::decode_offset_z,
            )?),
            _ => return Ok(None),
        };
        let counter = frames::e2e_counter(frame);
        match (self.waiting.take(), half) {
            (Some((first, PendingOffsetHalf::Xy(xy))), PendingOffsetHalf::Z(z))
                if first == counter =>
            {
                Ok(Some(combine_offsets(xy, z)))
            }
            (Some((first, PendingOffsetHalf::Z(z))), PendingOffsetHalf::Xy(xy))
                if first == counter =>
            {
                Ok(Some(combine_offsets(xy, z)))
            }
            (left_alone, half) => {
                if left_alone.is_some() {
                    saturating_increment(&mut self.unpaired);
                }
                self.waiting = Some((counter, half));
                Ok(None)
            }
        }
    }

    /// Returns what has arrived so far, in frames.
    #[must_use]
    pub const fn counters(&self) -> FrameCounters {
        self.counters
    }

    /// Halves that were dropped because their other half never came.
    #[must_use]
    pub const fn unpaired_frame_count(&self) -> u32 {
        self.unpaired
    }
}

impl Default for OffsetReceiver {
    fn default() -> Self {
        Self::new()
    }
}

/// An ear for the bridge's `Status`.
#[derive(Clone, Copy, Debug)]
pub struct StatusReceiver {
    stream: E2eStateMachine,
    counters: FrameCounters,
}

impl StatusReceiver {
    /// Returns a receiver that has received nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { stream: E2eStateMachine::new(STATUS_ID), counters: FrameCounters::ZERO }
    }

    /// Returns what this frame says.
    ///
    /// # Errors
    /// Another frame, or one that must not be used. It is counted.
    pub fn accept(&mut self, frame: &Frame) -> Result<Status, ReceiveError> {
        self.counters.verify_and_decode(&mut self.stream, frame, status::decode)
    }

    /// Returns what has arrived so far, in frames.
    #[must_use]
    pub const fn counters(&self) -> FrameCounters {
        self.counters
    }
}

impl Default for StatusReceiver {
    fn default() -> Self {
        Self::new()
    }
}

fn combine_offsets(xy: OffsetXy, z: OffsetZ) -> Output {
    Output {
        offset: xy.offset.zip(z.offset).map(|([x, y], z)| [x, y, z]),
        quality: z.quality,
        flags: z.flags,
        age_ms: z.age_ms,
    }
}

/// Why a frame must not be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReceiveError {
    /// Its length or a value in it is wrong.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// Its protection does not hold.
    #[error(transparent)]
    E2e(E2eError),
    /// It is whole and in order, but too many before it were not, the last of them for this.
    #[error("not trusted yet: before it, {0}")]
    Untrusted(E2eError),
}

impl From<E2eStateMachineError> for ReceiveError {
    fn from(error: E2eStateMachineError) -> Self {
        match error {
            E2eStateMachineError::Frame(error) => Self::E2e(error),
            E2eStateMachineError::Untrusted(error) => Self::Untrusted(error),
        }
    }
}

impl ReceiveError {
    /// Returns whether the frame was whole, but not in sequence: what a second sender would do.
    #[must_use]
    pub const fn is_sequence_error(&self) -> bool {
        matches!(self, Self::E2e(E2eError::Repeated { .. } | E2eError::WrongSequence { .. }))
    }

    /// Returns the reason, as in a status frame: of a frame whose stream is not trusted, why that is.
    #[must_use]
    pub const fn reject_reason(&self) -> FrameRejectReason {
        match self {
            Self::Decode(_) => FrameRejectReason::Malformed,
            Self::E2e(error) | Self::Untrusted(error) => match error {
                E2eError::TooShort { .. } => FrameRejectReason::Malformed,
                E2eError::Crc { .. } => FrameRejectReason::Damaged,
                E2eError::Repeated { .. } => FrameRejectReason::Repeated,
                E2eError::WrongSequence { .. } => FrameRejectReason::WrongSequence,
            },
        }
    }
}

#[cfg(test)]
mod tests;
