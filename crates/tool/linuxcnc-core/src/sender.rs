//! The CNC's frames to the bridge, and when they are sent.
//!
//! | frame | from | when |
//! |---|---|---|
//! | `Control` | enable, machine on, homed, zero, service, confirm; in turn a part of what was learned | every 20 ms, and at once when it changes |
//! | `PositionX/Y/Z` | the commanded position without the external offset | every period while it changes, else every 50 ms |
//! | `Rotary` | the angles, where there are any | as the positions |
//! | `Spindle` | speed and load | every 20 ms while they change, else every 50 ms |
//! | `Conditions` | tool and conditions | every 50 ms, once the tool is known |
//!
//! A value that is not a number is not sent: the bridge then knows that it does not know.
//!
//! A direction is where the axis was last sent, +1 or −1, also while it stands. It turns when the
//! command has gone back by more than 1 µm: the last digits of a command that LinuxCNC computes as a
//! difference, or of an encoder while the machine is off, are not a reversal. Unlike the position it also
//! looks at command and external offset together: an axis that stands in the program, but is taken back
//! by its offset, crosses its backlash like any other. That is not to include what the reversal itself
//! does to the offset, or the two would chase each other: for it, 1 µm and the most by which the
//! machine's offset goes against a reversal; without a machine file only the command counts.

use core::time::Duration;

use crate::rounding::{floor, round};
use trueup_core::{
    cnc::{
        AxisPosition, Control, LinearAxis, MachineConditions, RotaryAxisAngles, SpindleState,
        TravelDirection,
    },
    learned_changes::{LEARNED_PART_COUNT, LearnedChangeRequest, calibration_id},
    units::{MicroDegrees, Position, Rpm},
};
use trueup_link::{
    frame::Frame,
    frames::{self, CONDITIONS_PERIOD_MS, CONTROL_PERIOD_MS, SPINDLE_PERIOD_MS},
};

/// The frames of one call: one of each kind at most.
pub type DueFrames = heapless::Vec<Frame, 7>;

/// Unchanged values are sent this often: a bridge that was away has to learn where it is.
const RESEND_PERIOD: Duration = Duration::from_millis(50);
/// A command that has gone back by this much is a reversal.
const REVERSAL_THRESHOLD: i32 = Position::PER_MILLIMETRE / 1_000;
/// The board sees the edge of `Zero` only if it holds for some frames of `Control`.
const ZERO_HOLD_TIME: Duration = Duration::from_millis(100);

/// Values to send.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct CommandValues {
    /// The CNC's permissions and requests, for `Control`.
    pub control: Control,
    /// Commanded positions of X, Y and Z in mm, without the external offset.
    pub position_mm: [f64; 3],
    /// The external offset that LinuxCNC adds to them, in mm.
    pub offset_mm: [f64; 3],
    /// Commanded angles of the head axes in degrees.
    pub angles_deg: [f64; 2],
    /// Spindle speed in r/min; the sign does not count.
    pub spindle_rpm: f64,
    /// Axial cutting force in N.
    pub load_n: f64,
    /// Tool and conditions; `None`: LinuxCNC does not say, and nothing is sent.
    pub conditions: Option<MachineConditions>,
}

/// A value that is sent while it changes.
#[derive(Debug)]
struct ValueTxState<T> {
    sent: Option<(Duration, T)>,
    counter: u8,
}

impl<T> Default for ValueTxState<T> {
    fn default() -> Self {
        Self { sent: None, counter: 0 }
    }
}

impl<T: PartialEq + Copy> ValueTxState<T> {
    /// Returns the counter of the frame if one is due.
    fn take_due_counter(
        &mut self,
        now: Duration,
        value: T,
        fastest: Duration,
        slowest: Duration,
    ) -> Option<u8> {
        let is_due = self.sent.is_none_or(|(at, last)| {
            let waited = now.saturating_sub(at);
            waited >= slowest || (value != last && waited >= fastest)
        });
        if !is_due {
            return None;
        }
        self.sent = Some((now, value));
        let counter = self.counter;
        self.counter = counter.wrapping_add(1);
        Some(counter)
    }
}

/// Where an axis heads: by its command, and by command and offset together.
#[derive(Clone, Copy, Debug, Default)]
struct DirectionTracker {
    heading: TravelDirection,
    /// The furthest of both since the last turn.
    furthest: Option<[Position; 2]>,
}

impl DirectionTracker {
    /// Takes the command, and the command with the offset, which turns the axis once it is back by
    /// more than `reversal`, in the units of a position.
    fn update(
        &mut self,
        command: Position,
        driven: Position,
        reversal: Option<i32>,
    ) -> TravelDirection {
        let at = [command, driven];
        let furthest = self.furthest.get_or_insert(at);
        let ways: [i32; 2] = [0, 1].map(|n| at[n].0.saturating_sub(furthest[n].0));
        let back_by = [REVERSAL_THRESHOLD, reversal.unwrap_or(i32::MAX)];
        let turn = [0, 1].into_iter().find(|&n| match self.heading {
            TravelDirection::Positive => ways[n] < -back_by[n],
            TravelDirection::Negative => ways[n] > back_by[n],
            TravelDirection::Standing => ways[n].unsigned_abs() > back_by[n].unsigned_abs(),
        });
        if let Some(n) = turn {
            self.heading =
                if ways[n] > 0 { TravelDirection::Positive } else { TravelDirection::Negative };
            *furthest = at;
        } else {
            for n in [0, 1] {
                let is_further = match self.heading {
                    TravelDirection::Positive => ways[n] > 0,
                    TravelDirection::Negative => ways[n] < 0,
                    TravelDirection::Standing => false,
                };
                if is_further {
                    furthest[n] = at[n];
                }
            }
        }
        self.heading
    }
}

/// The sender of the CNC's frames.
#[derive(Debug, Default)]
pub(crate) struct CncTransmitter {
    position_period: Duration,
    sends_rotary: bool,
    control: ValueTxState<Control>,
    positions: [ValueTxState<AxisPosition>; 3],
    courses: [DirectionTracker; 3],
    reversals: [Option<i32>; 3],
    rotary: ValueTxState<RotaryAxisAngles>,
    spindle: ValueTxState<SpindleState>,
    conditions: ValueTxState<MachineConditions>,
    zero_until: Option<Duration>,
    zero_was: bool,
    /// Learned values, and the calibration that they change; `None`: none are sent.
    learned: Option<([i16; LEARNED_PART_COUNT], u32)>,
}

impl CncTransmitter {
    /// Sends moving positions every `position_period`, and angles if requested. `against_um` is the
    /// most by which the offset of X, Y and Z goes against a reversal, where that is known.
    #[must_use]
    pub fn new(
        position_period: Duration,
        sends_rotary: bool,
        against_um: [Option<f64>; 3],
    ) -> Self {
        Self {
            position_period,
            sends_rotary,
            reversals: against_um.map(|um| {
                um.map(|um| to_position(um / 1_000.0).0.saturating_add(REVERSAL_THRESHOLD))
            }),
            ..Self::default()
        }
    }

    /// Sends the learned values from now on again and again, a part in each `Control`: a bridge that has
    /// restarted has forgotten them.
    pub fn set_learned_values(&mut self, learned: Option<([i16; LEARNED_PART_COUNT], u32)>) {
        self.learned = learned;
    }

    /// Returns the part of what was learned that this frame is to say.
    fn next_learned_change(&self, counter: u8) -> LearnedChangeRequest {
        let Some((amounts, calibration)) = self.learned else {
            return LearnedChangeRequest::default();
        };
        let part = counter % LEARNED_PART_COUNT as u8;
        LearnedChangeRequest {
            part: part + 1,
            amount: amounts[usize::from(part)],
            calibration: calibration_id(calibration),
        }
    }

    /// Returns the frames that are due.
    pub(crate) fn take_due_frames(&mut self, now: Duration, command: &CommandValues) -> DueFrames {
        let mut due = DueFrames::new();
        let control =
            Control { zero: self.stretch_zero_pulse(now, command.control.zero), ..command.control };
        let often = Duration::from_millis(CONTROL_PERIOD_MS.into());
        if let Some(counter) = self.control.take_due_counter(now, control, Duration::ZERO, often) {
            let learned = self.next_learned_change(counter);
            push_frame(&mut due, frames::encode_control(Control { learned, ..control }, counter));
        }
        for (place, axis) in LinearAxis::ALL.into_iter().enumerate() {
            if !command.position_mm[place].is_finite() || !command.offset_mm[place].is_finite() {
                continue;
            }
            let position = to_position(command.position_mm[place]);
            let driven = self::to_position(command.position_mm[place] + command.offset_mm[place]);
            let reversal = self.reversals[place];
            let direction = self.courses[place].update(position, driven, reversal);
            let there = AxisPosition { axis, position, direction };
            let period = self.position_period;
            if let Some(counter) =
                self.positions[place].take_due_counter(now, there, period, RESEND_PERIOD)
            {
                push_frame(&mut due, frames::encode_position(there, counter));
            }
        }
        if self.sends_rotary && command.angles_deg.iter().all(|angle| angle.is_finite()) {
            let rotary = RotaryAxisAngles { angles: command.angles_deg.map(to_micro_degrees) };
            if let Some(counter) =
                self.rotary.take_due_counter(now, rotary, self.position_period, RESEND_PERIOD)
            {
                push_frame(&mut due, frames::encode_rotary(rotary, counter));
            }
        }
        let spindle = to_spindle_state(command.spindle_rpm, command.load_n);
        let often = Duration::from_millis(SPINDLE_PERIOD_MS.into());
        if command.spindle_rpm.is_finite()
            && command.load_n.is_finite()
            && let Some(counter) = self.spindle.take_due_counter(now, spindle, often, RESEND_PERIOD)
        {
            push_frame(&mut due, frames::encode_spindle(spindle, counter));
        }
        let often = Duration::from_millis(CONDITIONS_PERIOD_MS.into());
        if let Some(conditions) = command.conditions
            && let Some(counter) = self.conditions.take_due_counter(now, conditions, often, often)
        {
            push_frame(&mut due, frames::encode_conditions(conditions, counter));
        }
        due
    }

    /// `Zero` holds for a while after its edge, however short the pulse on the pin.
    fn stretch_zero_pulse(&mut self, now: Duration, pin: bool) -> bool {
        if pin && !self.zero_was {
            self.zero_until = Some(now.saturating_add(ZERO_HOLD_TIME));
        }
        self.zero_was = pin;
        pin || self.zero_until.is_some_and(|until| now < until)
    }
}

/// There is room for one of each kind.
fn push_frame(due: &mut DueFrames, frame: Frame) {
    due.push(frame).ok();
}

/// Conversions saturate; what is not a number is not sent.
#[allow(clippy::cast_possible_truncation, reason = "a cast of a float saturates")]
fn to_position(mm: f64) -> Position {
    Position(round(mm * f64::from(Position::PER_MILLIMETRE)) as i32)
}

/// Within one turn, −180 to 180.
#[allow(clippy::cast_possible_truncation, reason = "a cast of a float saturates")]
fn to_micro_degrees(deg: f64) -> MicroDegrees {
    let within = deg - 360.0 * floor((deg + 180.0) / 360.0);
    MicroDegrees(round(within * f64::from(MicroDegrees::PER_DEGREE)) as i32)
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "they saturate")]
fn to_spindle_state(rpm: f64, load_n: f64) -> SpindleState {
    SpindleState { speed: Rpm(round(rpm.abs()) as u16), load_n: round(load_n) as i16 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;
    use trueup_core::cnc::CncMessage as Received;
    use trueup_link::receiver::CncReceiver;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn frames_at(
        sender: &mut CncTransmitter,
        now: Duration,
        command: &CommandValues,
    ) -> Vec<Received> {
        let mut receiver = CncReceiver::new();
        let frames = sender.take_due_frames(now, command);
        frames.iter().filter_map(|frame| receiver.accept(frame).expect("protected")).collect()
    }

    #[test]
    fn a_moving_axis_is_sent_every_period_and_a_standing_one_every_50_ms() {
        let mut sender = CncTransmitter::new(ms(2), false, [Some(0.0); 3]);
        let mut receiver = CncReceiver::new();
        let mut count = [0; 2];
        for now in 0..1_000 {
            let command =
                CommandValues { position_mm: [now as f64, 7.0, 0.0], ..CommandValues::default() };
            for frame in sender.take_due_frames(ms(now), &command) {
                match receiver.accept(&frame).expect("in order") {
                    Some(Received::Position(there)) if there.axis == LinearAxis::X => count[0] += 1,
                    Some(Received::Position(there)) if there.axis == LinearAxis::Y => count[1] += 1,
                    _ => {}
                }
            }
        }
        assert_eq!(count, [500, 20]);
        assert_eq!(receiver.counters().lost, 0);
    }

    #[test]
    fn a_direction_lasts_until_the_command_goes_back_by_more_than_a_micrometre() {
        let mut course = DirectionTracker::default();
        let mut at = |nm: i32| course.update(Position(nm / 10), Position(nm / 10), None);
        assert_eq!(at(0), TravelDirection::Standing);
        assert_eq!(at(900), TravelDirection::Standing);
        assert_eq!(at(2_000), TravelDirection::Positive);
        assert_eq!(at(1_010), TravelDirection::Positive, "not even a micrometre back");
        assert_eq!(at(2_500), TravelDirection::Positive);
        assert_eq!(at(1_490), TravelDirection::Negative, "just over a micrometre");
        assert_eq!(at(1_490), TravelDirection::Negative, "it stands");
        assert_eq!(at(10_000), TravelDirection::Positive);
    }

    #[test]
    fn an_offset_that_goes_back_turns_an_axis_that_stands() {
        let mut sender = CncTransmitter::new(ms(2), false, [Some(0.0); 3]);
        let mut z = |now, offset_mm| {
            let there = [0.0, 0.0, offset_mm];
            let command = CommandValues {
                position_mm: [0.0, 0.0, 7.0],
                offset_mm: there,
                ..CommandValues::default()
            };
            frames_at(&mut sender, ms(now), &command).into_iter().find_map(
                |received| match received {
                    Received::Position(at) if at.axis == LinearAxis::Z => {
                        Some((at.position.0, at.direction))
                    }
                    _ => None,
                },
            )
        };
        assert_eq!(z(0, 0.0), Some((700_000, TravelDirection::Standing)));
        assert_eq!(z(10, 0.020), Some((700_000, TravelDirection::Positive)));
        assert_eq!(z(20, 0.018), Some((700_000, TravelDirection::Negative)));
    }

    #[test]
    fn an_offset_that_goes_against_its_own_reversal_is_no_reversal() {
        // A CNC that over-compensates by 25 µm: as soon as the axis is sent back, its offset rises.
        let play = |against: Option<i32>| {
            let (mut course, mut offset, mut turns) = (DirectionTracker::default(), 0, 0);
            let mut heading = TravelDirection::Standing;
            for step in 0..400 {
                // Up by 1 mm, then back by a tenth, then it stands.
                let command = if step < 100 { step * 1_000 } else { (199 - step).max(90) * 1_000 };
                let driven = Position(command + offset);
                let now = course.update(Position(command), driven, against);
                turns += i32::from(now != heading);
                heading = now;
                // The bridge's answer, 0.5 µm a step.
                let target = if heading == TravelDirection::Negative { 2_500 } else { 0 };
                offset += (target - offset).clamp(-50, 50);
            }
            turns
        };
        assert_eq!(play(Some(2_600)), 2, "up, and back");
        assert_eq!(play(None), 2);
        assert!(play(Some(REVERSAL_THRESHOLD)) > 4, "they chase each other");
    }

    #[test]
    fn a_pulse_on_zero_is_stretched_and_control_says_it_at_once() {
        let mut sender = CncTransmitter::new(ms(2), false, [Some(0.0); 3]);
        let mut command = CommandValues::default();
        let zero = |reported: Vec<Received>| {
            reported.into_iter().find_map(|received| match received {
                Received::Control(control) => Some(control.zero),
                _ => None,
            })
        };
        assert_eq!(zero(frames_at(&mut sender, ms(0), &command)), Some(false));
        command.control.zero = true;
        assert_eq!(zero(frames_at(&mut sender, ms(1), &command)), Some(true));
        command.control.zero = false;
        assert_eq!(zero(frames_at(&mut sender, ms(2), &command)), None);
        assert_eq!(zero(frames_at(&mut sender, ms(50), &command)), Some(true));
        assert_eq!(zero(frames_at(&mut sender, ms(101), &command)), Some(false));
    }

    #[test]
    fn each_part_of_what_was_learned_comes_once_in_five_frames_and_nothing_while_there_is_none() {
        let mut sender = CncTransmitter::new(ms(2), false, [Some(0.0); 3]);
        let learned = |sender: &mut CncTransmitter, now| {
            let reported = frames_at(sender, ms(now), &CommandValues::default());
            reported.into_iter().find_map(|received| match received {
                Received::Control(control) => Some(control.learned),
                _ => None,
            })
        };
        assert_eq!(learned(&mut sender, 0), Some(LearnedChangeRequest::default()));
        sender.set_learned_values(Some(([10, 20, 30, 40, -50], 0x1234_ABCD)));
        assert_eq!(learned(&mut sender, 1), None, "no frame is sent for its sake");
        let all: Vec<LearnedChangeRequest> =
            (1..=5).map(|n| learned(&mut sender, 20 * n).expect("one every 20 ms")).collect();
        for (part, amount) in (1..).zip([10, 20, 30, 40, -50]) {
            assert!(
                all.contains(&LearnedChangeRequest { part, amount, calibration: 0xABCD }),
                "{all:?}"
            );
        }
        sender.set_learned_values(None);
        assert_eq!(learned(&mut sender, 200), Some(LearnedChangeRequest::default()));
    }

    #[test]
    fn what_is_not_a_number_is_not_sent() {
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut sender = CncTransmitter::new(ms(2), true, [Some(0.0); 3]);
            let command = CommandValues {
                position_mm: [wrong, 1.0, wrong],
                angles_deg: [0.0, wrong],
                load_n: wrong,
                ..CommandValues::default()
            };
            let received = frames_at(&mut sender, ms(0), &command);
            let is_y = |received: &Received| matches!(received, Received::Position(at) if at.axis == LinearAxis::Y);
            assert_eq!(received.len(), 2, "Control and Y alone: {received:?}");
            assert!(received.iter().any(is_y));
        }
    }

    #[test]
    fn angles_come_within_one_turn_and_nothing_wraps() {
        assert_eq!(to_micro_degrees(370.0), MicroDegrees(10_000_000));
        assert_eq!(to_micro_degrees(-190.5), MicroDegrees(169_500_000));
        assert_eq!(to_position(1e30), Position(i32::MAX));
        assert_eq!(
            to_spindle_state(-24_000.0, 1e9),
            SpindleState { speed: Rpm(24_000), load_n: i16::MAX }
        );
        let mut sender = CncTransmitter::new(ms(2), true, [Some(0.0); 3]);
        let command = CommandValues { angles_deg: [725.0, -30.0], ..CommandValues::default() };
        let received = frames_at(&mut sender, ms(0), &command);
        let angles = [5_000_000, -30_000_000].map(MicroDegrees);
        assert!(received.contains(&Received::Rotary(RotaryAxisAngles { angles })));
    }
}
