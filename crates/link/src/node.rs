//! The bridge as it stands on the bus: frames in, samples in, frames out.
//!
//! This is the whole of what a board does between its converter and its wires, without any
//! hardware, so the host can run the same thing.

use heapless::Vec;
use trueup_core::{
    bridge::{self, Bridge, Input, Reference},
    calibration::Calibration,
    cnc::{Command, Flags, Output, Quality},
    health::Noise,
    units::Millis,
};

use crate::{
    frame::Frame,
    frames::{self, State},
    layout::HEARTBEAT_PERIOD_MS,
    receiver::{Receiver, Refused},
};

/// The frames of one tick: both offsets, and at times the heartbeat.
pub type Frames = Vec<Frame, 3>;

/// The bridge, its memory, and its end of the link.
#[derive(Debug)]
pub struct Node<'a> {
    /// `None` without a valid calibration: nothing can be computed then.
    bridge: Option<Bridge<'a>>,
    state: bridge::State,
    receiver: Receiver,
    now: Millis,
    blocks: u32,
    counter: u8,
    until_heartbeat_ms: u32,
    degraded: bool,
    last: Output,
    /// `Zero` in the last `Control`; at the start as if it had been set.
    zero_bit: bool,
    zero: Option<Zero>,
}

/// What came of a `Zero`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Zero {
    /// The reference is another one now.
    Taken(Reference),
    /// It is as it was: an input is missing, or the error is no other.
    Unchanged,
}

impl<'a> Node<'a> {
    /// A node that has just been switched on. `degraded` marks every frame of a board that runs on
    /// a fall-back.
    #[must_use]
    pub fn new(calibration: Option<Calibration<'a>>, degraded: bool) -> Self {
        Self {
            bridge: calibration.map(Bridge::new),
            state: bridge::State::default(),
            receiver: Receiver::default(),
            now: Millis::default(),
            blocks: 0,
            counter: 0,
            until_heartbeat_ms: 0,
            degraded,
            last: Output::default(),
            zero_bit: true,
            zero: None,
        }
    }

    /// Takes a frame from the bus. Gives the command it carried, `None` if it is nobody's here.
    ///
    /// # Errors
    /// A frame for this node that is damaged, repeated or out of order; it is counted and has no
    /// effect.
    pub fn hear(&mut self, frame: &Frame) -> Result<Option<Command>, Refused> {
        let command = self.receiver.accept(frame)?;
        if let (Some(bridge), Some(command)) = (&self.bridge, command) {
            let before = self.state.reference();
            bridge.hear(&mut self.state, command);
            self.note_zero(command, before);
        }
        Ok(command)
    }

    fn note_zero(&mut self, command: Command, before: Reference) {
        let Command::Control(control) = command else { return };
        let was_set = core::mem::replace(&mut self.zero_bit, control.zero);
        let now = self.state.reference();
        if now != before {
            self.zero = Some(Zero::Taken(now));
        } else if control.zero && !was_set && self.zero.is_none() {
            self.zero = Some(Zero::Unchanged);
        }
    }

    /// What came of the last `Zero`, once.
    pub fn take_zero(&mut self) -> Option<Zero> {
        self.zero.take()
    }

    /// Takes up a reference that was stored.
    pub fn set_reference(&mut self, reference: Reference) {
        self.state.set_reference(reference);
    }

    /// One tick that ends `elapsed_ms` after the last one. Gives the frames to send.
    pub fn tick(&mut self, elapsed_ms: u32, input: Input<'_>) -> Frames {
        self.now = self.now.after(elapsed_ms);
        if input.codes.is_some() {
            self.blocks = self.blocks.wrapping_add(1);
        }
        let mut output = match &self.bridge {
            Some(bridge) => bridge.tick(&mut self.state, self.now, input),
            None => Output { quality: Quality::Fault, age_ms: u8::MAX, ..Output::default() },
        };
        output.flags = output.flags.with_if(self.degraded, Flags::BOARD_DEGRADED);
        self.last = output;

        let mut frames = Frames::new();
        frames.extend([frames::offset_xy(&output, self.counter)]);
        frames.extend([frames::offset_z(&output, self.counter)]);
        self.counter = self.counter.wrapping_add(1);
        self.until_heartbeat_ms = self.until_heartbeat_ms.saturating_sub(elapsed_ms);
        if self.until_heartbeat_ms == 0 {
            self.until_heartbeat_ms = HEARTBEAT_PERIOD_MS;
            let state = match output.quality {
                Quality::Fault => State::Stopped,
                _ => State::Operational,
            };
            frames.extend([frames::heartbeat(state)]);
        }
        frames
    }

    /// The time of the last tick.
    #[must_use]
    pub fn now(&self) -> Millis {
        self.now
    }

    /// Blocks of samples taken so far; wraps.
    #[must_use]
    pub fn blocks(&self) -> u32 {
        self.blocks
    }

    /// What the last tick gave.
    #[must_use]
    pub fn last(&self) -> &Output {
        &self.last
    }

    /// What was received and refused so far.
    #[must_use]
    pub fn receiver(&self) -> &Receiver {
        &self.receiver
    }

    /// The noise of the raw codes since the last call.
    pub fn take_noise(&mut self) -> Noise {
        self.state.take_noise()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        frames::{HEARTBEAT_ID, OFFSET_XY_ID, OFFSET_Z_ID},
        receiver::OffsetReceiver,
    };
    use std::vec::Vec;
    use trueup_core::{
        calibration::{Source, Spindle},
        cnc::Control,
        filter::CODES_PER_TICK,
        kinematics::Kinematics,
        limits::Limits,
        sensor::{SensorLaw, Slope},
        tool::Direction,
        units::{Code, Nanometres, Reading},
    };

    fn calibration() -> Calibration<'static> {
        Calibration {
            thermometers: [None; 8],
            spindle: Spindle {
                chain: [Some(Source::Sensor), None, None],
                sensor: SensorLaw { k0: Nanometres(0), zero: Reading(0), slope: Slope(1 << 28) },
                ..Spindle::default()
            },
            kinematics: Kinematics { zero: Direction::DOWN, axes: [None; 2] },
            axes: Default::default(),
            straightness: Default::default(),
            squareness: Default::default(),
            terms: Default::default(),
            limits: Limits {
                max: [Nanometres(500_000); 3],
                slew_nm_per_s: 1_000,
                link_timeout_ms: 500,
                hold_ms: 2_000,
            },
        }
    }
    const BLIND: Input<'static> = Input { codes: None, speed: None, temperatures: None };

    #[test]
    fn both_halves_of_a_cycle_share_a_counter_that_counts_the_cycles() {
        let mut node = Node::new(Some(calibration()), false);
        for cycle in 0..600_u32 {
            let sent = node.tick(1, BLIND);
            let ids: Vec<u16> = sent.iter().take(2).map(Frame::id).collect();
            assert_eq!(ids, [OFFSET_XY_ID, OFFSET_Z_ID]);
            let counters: Vec<u32> =
                sent.iter().take(2).map(|frame| frames::counter(frame).into()).collect();
            assert_eq!(counters, [cycle % 256, cycle % 256]);
        }
    }

    #[test]
    fn the_heartbeat_comes_at_once_and_then_every_100_ms_whatever_a_tick_lasts() {
        for tick_ms in [1, 10] {
            let mut node = Node::new(Some(calibration()), false);
            let mut beats = Vec::new();
            while node.now().0 < 1_000 {
                let sent = node.tick(tick_ms, BLIND);
                beats.extend(sent.iter().any(|f| f.id() == HEARTBEAT_ID).then(|| node.now().0));
            }
            assert_eq!(beats.len(), 10, "{beats:?}");
            assert!(beats.windows(2).all(|pair| pair[1] - pair[0] == 100), "{beats:?}");
        }
    }

    #[test]
    fn without_a_calibration_nothing_is_available_and_the_node_is_stopped() {
        let mut node = Node::new(None, false);
        let codes = [Code(700); CODES_PER_TICK];
        let sent = node.tick(1, Input { codes: Some(&codes), ..Input::default() });
        let mut receiver = OffsetReceiver::new();
        let output = sent.iter().filter_map(|f| receiver.accept(f).unwrap_or_default()).next();
        let output = output.expect("a whole cycle");
        assert_eq!((output.offset, output.quality, output.age_ms), (None, Quality::Fault, 255));
        assert_eq!(frames::decode_heartbeat(&sent[2]), Ok(State::Stopped));
    }

    #[test]
    fn a_board_on_a_fall_back_marks_every_frame() {
        for degraded in [false, true] {
            let mut node = Node::new(Some(calibration()), degraded);
            node.tick(1, BLIND);
            assert_eq!(node.last().flags.contains(Flags::BOARD_DEGRADED), degraded);
        }
    }

    /// Codes that are alive, at a level and a half.
    fn alive(level: u16) -> [Code; CODES_PER_TICK] {
        core::array::from_fn(|n| Code(level + u16::from(n % 2 == 1)))
    }

    #[test]
    fn a_zero_is_told_once_and_what_it_took_can_be_given_back_to_another_node() {
        let send = |node: &mut Node<'_>, zero, counter| {
            let control = Control { engage: true, referenced: true, zero };
            node.hear(&frames::control(control, counter)).expect("in order");
        };
        let live = |node: &mut Node<'_>, ms| {
            for _ in 0..ms {
                node.tick(1, Input { codes: Some(&alive(700)), ..Input::default() });
            }
        };
        let mut node = Node::new(Some(calibration()), false);
        // A CNC that starts with the bit set has asked for nothing; without samples it is refused.
        send(&mut node, true, 0);
        assert_eq!(node.take_zero(), None);
        send(&mut node, false, 1);
        send(&mut node, true, 2);
        assert_eq!((node.take_zero(), node.take_zero()), (Some(Zero::Unchanged), None));
        live(&mut node, 400);
        send(&mut node, false, 3);
        send(&mut node, true, 4);
        send(&mut node, true, 5);
        let Some(Zero::Taken(reference)) = node.take_zero() else { panic!("not taken") };
        assert_ne!(reference, Reference::default());
        assert_eq!(node.take_zero(), None);

        let mut again = Node::new(Some(calibration()), false);
        again.set_reference(reference);
        live(&mut again, 400);
        send(&mut again, false, 0);
        live(&mut again, 10);
        assert_eq!(again.last().quality, Quality::Live);
        assert_eq!(again.last().offset, Some([Nanometres::ZERO; 3]));
    }

    #[test]
    fn a_damaged_control_is_counted_and_engages_nothing() {
        let control = Control { engage: true, referenced: true, zero: false };
        let good = frames::control(control, 0);
        let mut data = *good.data();
        data[3] ^= 1;
        let damaged = Frame::new(good.id(), &data).unwrap();
        for (frame, engages) in [(damaged, false), (good, true)] {
            let mut node = Node::new(Some(calibration()), false);
            assert_eq!(node.hear(&frame).is_ok(), engages);
            assert_eq!(node.receiver().counters().crc_errors, u32::from(!engages));
            for _ in 0..450 {
                let codes = core::array::from_fn(|n| Code(if n % 2 == 0 { 700 } else { 701 }));
                node.tick(1, Input { codes: Some(&codes), ..Input::default() });
            }
            assert_eq!(node.last().quality == Quality::Live, engages);
        }
    }
}
