//! From received frames to what they say: only whole, new frames in order get through, and
//! everything refused is counted.
//!
//! [`Receiver`] is the board's ear for the CNC; [`OffsetReceiver`] and [`StatusReceiver`] are the
//! CNC's, or a monitor's, ears for the board.

use core::{error::Error, fmt};

use trueup_core::cnc::{Command, LinearAxis, Output};

use crate::{
    e2e::{Checker, E2eError},
    frame::Frame,
    frames::{
        self, CONTROL_ID, DecodeError, OFFSET_XY_ID, OFFSET_Z_ID, OffsetXy, OffsetZ, POSITION_X_ID,
        POSITION_Y_ID, POSITION_Z_ID, ROTARY_ID, SPINDLE_ID,
    },
    layout::STATUS_ID,
    status::{self, Status},
};

/// What has arrived since the start, in frames. Each count stops at its largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames that were used.
    pub accepted: u32,
    /// Frames of a wrong length, or with a value that has no meaning.
    pub malformed: u32,
    /// Frames that were damaged or sent under another identifier.
    pub crc_errors: u32,
    /// Frames that were repeated or out of sequence.
    pub sequence_errors: u32,
    /// Frames that never came, from gaps in the counter of frames that were used.
    pub lost: u32,
}

impl Counters {
    const NOTHING: Self =
        Self { accepted: 0, malformed: 0, crc_errors: 0, sequence_errors: 0, lost: 0 };

    /// Checks the protection of a frame, reads it, and counts how that went.
    fn admit<T>(
        &mut self,
        checker: &mut Checker,
        frame: &Frame,
        decode: impl FnOnce(&Frame) -> Result<T, DecodeError>,
    ) -> Result<T, Refused> {
        // Read first: a frame of the wrong length has no protection to check. Its content is
        // not looked at before the protection has been found good.
        let content = decode(frame);
        if let Err(error @ DecodeError::Length { .. }) = content {
            count(&mut self.malformed);
            return Err(error.into());
        }
        match checker.accept(frame) {
            Ok(lost) => self.lost = self.lost.saturating_add(lost.into()),
            Err(error) => {
                count(match error {
                    E2eError::TooShort { .. } => &mut self.malformed,
                    E2eError::Crc { .. } => &mut self.crc_errors,
                    E2eError::Repeated { .. } | E2eError::WrongSequence { .. } => {
                        &mut self.sequence_errors
                    }
                });
                return Err(error.into());
            }
        }
        count(match content {
            Ok(_) => &mut self.accepted,
            Err(_) => &mut self.malformed,
        });
        Ok(content?)
    }
}

fn count(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}

/// The board's ear for the CNC: every frame that it sends, each identifier with its own sequence.
#[derive(Clone, Copy, Debug)]
pub struct Receiver {
    position_x: Checker,
    position_y: Checker,
    position_z: Checker,
    rotary: Checker,
    spindle: Checker,
    control: Checker,
    counters: Counters,
}

impl Receiver {
    /// A receiver that has heard nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            position_x: Checker::new(POSITION_X_ID),
            position_y: Checker::new(POSITION_Y_ID),
            position_z: Checker::new(POSITION_Z_ID),
            rotary: Checker::new(ROTARY_ID),
            spindle: Checker::new(SPINDLE_ID),
            control: Checker::new(CONTROL_ID),
            counters: Counters::NOTHING,
        }
    }

    /// What the CNC says in this frame; `None` for a frame that is not for the bridge.
    ///
    /// # Errors
    /// A frame for the bridge that must not be used. It is counted.
    pub fn accept(&mut self, frame: &Frame) -> Result<Option<Command>, Refused> {
        let counters = &mut self.counters;
        let mut position = |axis: LinearAxis, checker: &mut Checker| {
            counters
                .admit(checker, frame, |frame| frames::decode_position(axis, frame))
                .map(Command::Position)
        };
        Ok(Some(match frame.id() {
            POSITION_X_ID => position(LinearAxis::X, &mut self.position_x)?,
            POSITION_Y_ID => position(LinearAxis::Y, &mut self.position_y)?,
            POSITION_Z_ID => position(LinearAxis::Z, &mut self.position_z)?,
            ROTARY_ID => Command::Rotary(self.counters.admit(
                &mut self.rotary,
                frame,
                frames::decode_rotary,
            )?),
            SPINDLE_ID => Command::Spindle(self.counters.admit(
                &mut self.spindle,
                frame,
                frames::decode_spindle,
            )?),
            CONTROL_ID => Command::Control(self.counters.admit(
                &mut self.control,
                frame,
                frames::decode_control,
            )?),
            _ => return Ok(None),
        }))
    }

    /// What has arrived so far.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

/// Half a cycle's offsets, waiting for the other half.
#[derive(Clone, Copy, Debug)]
enum Half {
    Xy(OffsetXy),
    Z(OffsetZ),
}

/// The CNC's ear for the board: puts `OffsetXY` and `OffsetZ` of the same counter together, so
/// that the offsets of a cycle are applied on all axes or on none.
///
/// It has no clock: whoever uses it must take back the offsets when no cycle has come for a while,
/// and in less than 256 ms, after which a counter comes round again.
#[derive(Clone, Copy, Debug)]
pub struct OffsetReceiver {
    xy: Checker,
    z: Checker,
    waiting: Option<(u8, Half)>,
    counters: Counters,
    unpaired: u32,
}

impl OffsetReceiver {
    /// A receiver that has heard nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            xy: Checker::new(OFFSET_XY_ID),
            z: Checker::new(OFFSET_Z_ID),
            waiting: None,
            counters: Counters::NOTHING,
            unpaired: 0,
        }
    }

    /// The output of a cycle, with the frame that completes it; the halves may come in either
    /// order. `None` for the first half, and for a frame that carries no offset.
    ///
    /// The offset is `None` unless all three axes are available.
    ///
    /// # Errors
    /// A frame with offsets that must not be used. It is counted.
    pub fn accept(&mut self, frame: &Frame) -> Result<Option<Output>, Refused> {
        let half = match frame.id() {
            OFFSET_XY_ID => {
                Half::Xy(self.counters.admit(&mut self.xy, frame, frames::decode_offset_xy)?)
            }
            OFFSET_Z_ID => {
                Half::Z(self.counters.admit(&mut self.z, frame, frames::decode_offset_z)?)
            }
            _ => return Ok(None),
        };
        let counter = frames::counter(frame);
        match (self.waiting.take(), half) {
            (Some((first, Half::Xy(xy))), Half::Z(z)) if first == counter => Ok(Some(join(xy, z))),
            (Some((first, Half::Z(z))), Half::Xy(xy)) if first == counter => Ok(Some(join(xy, z))),
            (left_alone, half) => {
                if left_alone.is_some() {
                    count(&mut self.unpaired);
                }
                self.waiting = Some((counter, half));
                Ok(None)
            }
        }
    }

    /// What has arrived so far, in frames.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Halves that were dropped because their other half never came.
    #[must_use]
    pub const fn unpaired(&self) -> u32 {
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
    checker: Checker,
    counters: Counters,
}

impl StatusReceiver {
    /// A receiver that has heard nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { checker: Checker::new(STATUS_ID), counters: Counters::NOTHING }
    }

    /// What this frame says.
    ///
    /// # Errors
    /// Another frame, or one that must not be used. It is counted.
    pub fn accept(&mut self, frame: &Frame) -> Result<Status, Refused> {
        self.counters.admit(&mut self.checker, frame, status::decode)
    }

    /// What has arrived so far, in frames.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.counters
    }
}

impl Default for StatusReceiver {
    fn default() -> Self {
        Self::new()
    }
}

fn join(xy: OffsetXy, z: OffsetZ) -> Output {
    Output {
        offset: xy.offset.zip(z.offset).map(|([x, y], z)| [x, y, z]),
        quality: z.quality,
        flags: z.flags,
        age_ms: z.age_ms,
    }
}

/// Why a frame must not be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// Its length or a value in it is wrong.
    Decode(DecodeError),
    /// Its protection does not hold.
    E2e(E2eError),
}

impl From<DecodeError> for Refused {
    fn from(error: DecodeError) -> Self {
        Self::Decode(error)
    }
}

impl From<E2eError> for Refused {
    fn from(error: E2eError) -> Self {
        Self::E2e(error)
    }
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Decode(error) => error.fmt(f),
            Self::E2e(error) => error.fmt(f),
        }
    }
}

impl Error for Refused {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        e2e,
        frames::{State, control, heartbeat, offset_xy, offset_z, position, rotary, spindle},
        layout::{DIRECTION, QUALITY},
    };
    use proptest::prelude::*;
    use trueup_core::{
        cnc::{AxisPosition, Control, Flags, Heading, Quality, Rotary, Spindle},
        units::{MicroDegrees, Nanometres, Position, Rpm},
    };

    const TURNING: Spindle = Spindle { speed: Rpm(18_000), load_n: 120 };
    const ENGAGED: Control = Control { engage: true, referenced: true, zero: false };

    fn output(cycle: u8) -> Output {
        let nm = i32::from(cycle) * 10;
        Output {
            offset: Some([nm, -nm, nm].map(Nanometres)),
            quality: Quality::Live,
            flags: Flags::NONE,
            age_ms: 1,
        }
    }

    fn damaged(frame: Frame) -> Frame {
        let mut data = *frame.data();
        data[4] ^= 0x10;
        Frame::new(frame.id(), &data).unwrap()
    }

    #[test]
    fn commands_are_told_apart_and_each_has_its_own_sequence() {
        let mut receiver = Receiver::new();
        for counter in 0..=u8::MAX {
            let frame = control(ENGAGED, counter);
            assert_eq!(receiver.accept(&frame), Ok(Some(Command::Control(ENGAGED))));
            let frame = spindle(TURNING, counter.wrapping_mul(3));
            assert_eq!(receiver.accept(&frame), Ok(Some(Command::Spindle(TURNING))));
        }
        let expected = Counters { accepted: 512, lost: 255 * 2, ..Counters::default() };
        assert_eq!(receiver.counters(), expected);
    }

    fn at(axis: LinearAxis, position: i32) -> AxisPosition {
        AxisPosition { axis, position: Position(position), direction: Heading::Positive }
    }

    #[test]
    fn each_axis_and_the_rotary_pair_has_its_own_sequence() {
        let mut receiver = Receiver::new();
        let turned = Rotary { angles: [90_000_000, -45_000_000].map(MicroDegrees) };
        for step in 0..=u8::MAX {
            for (axis, stride) in LinearAxis::ALL.into_iter().zip([1, 3, 5]) {
                let there = at(axis, i32::from(step) * 1_000 - 64_000);
                let frame = position(there, step.wrapping_mul(stride));
                assert_eq!(receiver.accept(&frame), Ok(Some(Command::Position(there))));
            }
            let frame = rotary(turned, step.wrapping_mul(7));
            assert_eq!(receiver.accept(&frame), Ok(Some(Command::Rotary(turned))));
        }
        let lost = 255 * (2 + 4 + 6);
        let expected = Counters { accepted: 4 * 256, lost, ..Counters::default() };
        assert_eq!(receiver.counters(), expected);
    }

    #[test]
    fn the_frame_of_one_axis_under_the_identifier_of_another_is_refused() {
        let mut receiver = Receiver::new();
        let x = position(at(LinearAxis::X, 5), 0);
        let moved = Frame::new(POSITION_Y_ID, x.data()).unwrap();
        let refused = receiver.accept(&moved).unwrap_err();
        assert!(matches!(refused, Refused::E2e(E2eError::Crc { .. })));
        assert_eq!(receiver.counters().crc_errors, 1);
    }

    #[test]
    fn a_direction_without_meaning_is_refused_although_its_protection_holds() {
        let mut receiver = Receiver::new();
        let mut data = *position(at(LinearAxis::Z, 5), 0).data();
        DIRECTION.insert(&mut data, -2);
        e2e::protect(POSITION_Z_ID, 0, &mut data);
        let refused = receiver.accept(&Frame::new(POSITION_Z_ID, &data).unwrap());
        assert!(matches!(refused, Err(Refused::Decode(DecodeError::Value { raw: -2, .. }))));
        assert_eq!(receiver.counters().malformed, 1);
    }

    #[test]
    fn frames_for_others_are_passed_over_and_not_counted() {
        let mut receiver = Receiver::new();
        for frame in [offset_xy(&output(0), 0), heartbeat(State::Operational)] {
            assert_eq!(receiver.accept(&frame), Ok(None));
        }
        assert_eq!(receiver.counters(), Counters::default());
    }

    #[test]
    fn every_kind_of_fault_is_refused_and_counted_once() {
        let mut receiver = Receiver::new();
        let frame = control(ENGAGED, 7);
        receiver.accept(&frame).unwrap();
        let refused = receiver.accept(&damaged(frame)).unwrap_err();
        assert!(matches!(refused, Refused::E2e(E2eError::Crc { .. })));
        let refused = receiver.accept(&frame).unwrap_err();
        assert_eq!(refused, Refused::E2e(E2eError::Repeated { counter: 7 }));
        let short = Frame::new(CONTROL_ID, &frame.payload()[..7]).unwrap();
        let refused = receiver.accept(&short).unwrap_err();
        assert!(matches!(refused, Refused::Decode(DecodeError::Length { .. })));
        let expected =
            Counters { accepted: 1, malformed: 1, crc_errors: 1, sequence_errors: 1, lost: 0 };
        assert_eq!(receiver.counters(), expected);
    }

    #[test]
    fn a_restarted_cnc_is_heard_again_with_its_second_frame() {
        let mut receiver = Receiver::new();
        receiver.accept(&control(ENGAGED, 100)).unwrap();
        let (last, counter) = (100, 0);
        let refused = receiver.accept(&control(ENGAGED, counter)).unwrap_err();
        assert_eq!(refused, Refused::E2e(E2eError::WrongSequence { last, counter }));
        let heard = receiver.accept(&control(ENGAGED, 1));
        assert_eq!(heard, Ok(Some(Command::Control(ENGAGED))));
    }

    #[test]
    fn a_cycle_comes_out_once_with_its_second_half_in_either_order() {
        let mut receiver = OffsetReceiver::new();
        for cycle in 0..=u8::MAX {
            let sent = output(cycle);
            let mut halves = [offset_xy(&sent, cycle), offset_z(&sent, cycle)];
            if cycle % 3 == 0 {
                halves.reverse();
            }
            assert_eq!(receiver.accept(&halves[0]), Ok(None));
            assert_eq!(receiver.accept(&halves[1]), Ok(Some(sent)));
        }
        assert_eq!(receiver.counters().accepted, 512);
        assert_eq!(receiver.unpaired(), 0);
    }

    #[test]
    fn halves_of_different_cycles_are_never_joined() {
        let mut receiver = OffsetReceiver::new();
        assert_eq!(receiver.accept(&offset_xy(&output(1), 1)), Ok(None));
        assert_eq!(receiver.accept(&offset_z(&output(2), 2)), Ok(None));
        assert_eq!(receiver.accept(&offset_xy(&output(3), 3)), Ok(None));
        assert_eq!(receiver.accept(&offset_z(&output(3), 3)), Ok(Some(output(3))));
        assert_eq!(receiver.unpaired(), 2);
        assert_eq!(receiver.counters().lost, 1);
    }

    #[test]
    fn a_damaged_half_drops_its_cycle_alone() {
        let mut receiver = OffsetReceiver::new();
        assert_eq!(receiver.accept(&offset_xy(&output(1), 1)), Ok(None));
        assert!(receiver.accept(&damaged(offset_z(&output(1), 1))).is_err());
        assert_eq!(receiver.accept(&offset_xy(&output(2), 2)), Ok(None));
        assert_eq!(receiver.accept(&offset_z(&output(2), 2)), Ok(Some(output(2))));
        assert_eq!((receiver.counters().crc_errors, receiver.unpaired()), (1, 1));
    }

    #[test]
    fn a_repeated_cycle_is_not_given_out_again() {
        let mut receiver = OffsetReceiver::new();
        let halves = [offset_xy(&output(1), 1), offset_z(&output(1), 1)];
        for half in &halves {
            receiver.accept(half).unwrap();
        }
        for half in &halves {
            let refused = receiver.accept(half).unwrap_err();
            assert_eq!(refused, Refused::E2e(E2eError::Repeated { counter: 1 }));
        }
    }

    #[test]
    fn a_missing_offset_is_given_out_as_missing() {
        let mut receiver = OffsetReceiver::new();
        let sent = Output { offset: None, quality: Quality::Fault, ..output(0) };
        assert_eq!(receiver.accept(&offset_xy(&sent, 0)), Ok(None));
        assert_eq!(receiver.accept(&offset_z(&sent, 0)), Ok(Some(sent)));
    }

    #[test]
    fn a_quality_without_meaning_is_refused_although_its_protection_holds() {
        let mut receiver = OffsetReceiver::new();
        let mut data = *offset_z(&output(0), 0).data();
        QUALITY.insert(&mut data, 9);
        e2e::protect(OFFSET_Z_ID, 0, &mut data);
        let refused = receiver.accept(&Frame::new(OFFSET_Z_ID, &data).unwrap());
        assert!(matches!(refused, Err(Refused::Decode(DecodeError::Value { raw: 9, .. }))));
        assert_eq!(receiver.counters().malformed, 1);
    }

    proptest! {
        #[test]
        fn whatever_is_lost_damaged_or_repeated_only_whole_new_cycles_come_out(
            fates in prop::collection::vec((0_u8..8, 0_u8..8), 1..300),
        ) {
            let mut receiver = OffsetReceiver::new();
            let mut newest = None;
            for (cycle, (xy, z)) in (0_u8..=255).cycle().zip(fates) {
                let sent = output(cycle);
                for (fate, frame) in [(xy, offset_xy(&sent, cycle)), (z, offset_z(&sent, cycle))] {
                    let arriving: &[Frame] = match fate {
                        0 => &[],
                        1 => &[damaged(frame)],
                        2 => &[frame, frame],
                        _ => &[frame],
                    };
                    for frame in arriving {
                        if let Ok(Some(got)) = receiver.accept(frame) {
                            prop_assert_eq!(got, sent);
                            prop_assert_ne!(newest, Some(cycle));
                            newest = Some(cycle);
                        }
                    }
                }
            }
        }
    }
}
