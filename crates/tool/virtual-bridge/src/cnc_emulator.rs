//! Stands in for a CNC that does not say where its axes are: sends the positions, angles, tool and conditions
//! of the run on the bus, as often as a CNC would, each until the CNC sends that frame itself. Where a
//! hand plays the CNC, its `Control` as well.

use std::sync::atomic::{AtomicU8, Ordering};

use trueup_link::{
    frame::Frame,
    frames,
    layout::{
        CONDITIONS_ID, CONDITIONS_PERIOD_MS, CONTROL_PERIOD_MS, POSITION_PERIOD_MS, POSITION_X_ID,
        POSITION_Y_ID, POSITION_Z_ID, ROTARY_ID,
    },
};
use trueup_pipe::FRAMES_PER_BLOCK;

use crate::replay::MachineSnapshot;

/// The frames that a run can stand in for.
const CNC_FRAME_IDS: [u16; 5] =
    [POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID, ROTARY_ID, CONDITIONS_ID];
/// The place of `Conditions` among them, which goes out alone, between two cycles of the others.
const CONDITIONS_INDEX: usize = CNC_FRAME_IDS.len() - 1;
/// The place of `Control` in a cycle: a tool that writes sends one itself now and then, and is no CNC.
const CONTROL_SLOT: usize = CONDITIONS_INDEX;
const _: () = assert!(CONTROL_SLOT < FRAMES_PER_BLOCK);
/// When in its period `Conditions` goes out: in an odd millisecond.
const CONDITIONS_PHASE_MS: u32 = CONDITIONS_PERIOD_MS / 2;
const _: () = assert!(!CONDITIONS_PHASE_MS.is_multiple_of(POSITION_PERIOD_MS));

/// Which of these frames the CNC has sent itself: a bit each.
#[derive(Debug, Default)]
pub struct ReceivedFrames(AtomicU8);

impl ReceivedFrames {
    /// Takes a line of the CNC, without its end.
    pub(crate) fn record_line(&self, line: &[u8]) {
        let Some(id) = line.strip_prefix(b"t").and_then(|rest| rest.get(..3)) else { return };
        let id = str::from_utf8(id).ok().and_then(|id| u16::from_str_radix(id, 16).ok());
        if let Some(place) = CNC_FRAME_IDS.iter().position(|&known| Some(known) == id) {
            self.0.fetch_or(1 << place, Ordering::Relaxed);
        }
    }

    fn has_received(&self, place: usize) -> bool {
        self.0.load(Ordering::Relaxed) & (1 << place) != 0
    }
}

/// The run's end of the bus.
#[derive(Debug, Default)]
pub struct CncEmulator {
    ms: u32,
    /// Each identifier counts for itself.
    counters: [u8; CONTROL_SLOT + 1],
    conditions_counter: u8,
}

impl CncEmulator {
    /// Returns the frames of the next millisecond.
    pub fn next_frames(
        &mut self,
        now: &MachineSnapshot,
        received: &ReceivedFrames,
    ) -> [Option<Frame>; FRAMES_PER_BLOCK] {
        let ms = self.ms;
        self.ms = self.ms.wrapping_add(1);
        let mut sent = [None; FRAMES_PER_BLOCK];
        if ms % CONDITIONS_PERIOD_MS == CONDITIONS_PHASE_MS
            && !received.has_received(CONDITIONS_INDEX)
        {
            let conditions = now.conditions;
            sent[0] = conditions
                .map(|conditions| frames::encode_conditions(conditions, self.conditions_counter));
            self.conditions_counter =
                self.conditions_counter.wrapping_add(conditions.is_some().into());
            return sent;
        }
        if !ms.is_multiple_of(POSITION_PERIOD_MS) {
            return sent;
        }
        let control = now.control.filter(|_| ms.is_multiple_of(CONTROL_PERIOD_MS));
        sent[CONTROL_SLOT] =
            control.map(|control| frames::encode_control(control, self.counters[CONTROL_SLOT]));
        let [x, y, z] = now.positions;
        for (place, position) in [x, y, z].into_iter().enumerate() {
            sent[place] =
                position.map(|there| frames::encode_position(there, self.counters[place]));
        }
        sent[3] = now.rotary.map(|there| frames::encode_rotary(there, self.counters[3]));
        for (place, counter) in self.counters.iter_mut().enumerate() {
            if place != CONTROL_SLOT && received.has_received(place) {
                sent[place] = None;
            } else if sent[place].is_some() {
                *counter = counter.wrapping_add(1);
            }
        }
        sent
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trueup_core::{
        cnc::{
            AxisPosition, CncMessage, Control, LinearAxis, MachineConditions, RotaryAxisAngles,
            TravelDirection,
        },
        units::Position,
    };
    use trueup_link::receiver::CncReceiver;

    #[test]
    fn the_run_is_received_in_order_until_the_cnc_speaks_for_itself() {
        let there = |axis| AxisPosition {
            axis,
            position: Position(5),
            direction: TravelDirection::Positive,
        };
        let now = MachineSnapshot {
            positions: [Some(there(LinearAxis::X)), None, Some(there(LinearAxis::Z))],
            rotary: Some(RotaryAxisAngles::default()),
            ..MachineSnapshot::default()
        };
        let (mut stand_in, received, mut receiver) =
            (CncEmulator::default(), ReceivedFrames::default(), CncReceiver::new());
        let mut ids = |ms| {
            let mut ids = Vec::new();
            for _ in 0..ms {
                for frame in stand_in.next_frames(&now, &received).into_iter().flatten() {
                    receiver.accept(&frame).expect("in order");
                    ids.push(frame.id());
                }
            }
            ids
        };
        assert_eq!(ids(2), [POSITION_X_ID, POSITION_Z_ID, ROTARY_ID]);
        assert_eq!(ids(600).len(), 900);
        for line in [&b"t30280000000000000000"[..], b"V", b"t20", b"txyz", b"O"] {
            received.record_line(line);
        }
        assert_eq!(ids(2).len(), 3, "none of these is a position");
        received.record_line(b"t20180000000000000000");
        assert_eq!(ids(2), [POSITION_Z_ID, ROTARY_ID]);
    }

    #[test]
    fn conditions_are_sent_every_50_ms_until_the_cnc_says_them() {
        let conditions = MachineConditions { tool: 7, bits: 5 };
        let now = MachineSnapshot { conditions: Some(conditions), ..MachineSnapshot::default() };
        let (mut stand_in, received, mut receiver) =
            (CncEmulator::default(), ReceivedFrames::default(), CncReceiver::new());
        let mut count = |received: &ReceivedFrames| {
            let frames = (0..1_000).flat_map(|_| stand_in.next_frames(&now, received)).flatten();
            let received = frames.map(|frame| receiver.accept(&frame).expect("in order"));
            received.filter(|command| *command == Some(CncMessage::Conditions(conditions))).count()
        };
        assert_eq!(count(&received), 20);
        received.record_line(b"t40280000000000000000");
        assert_eq!(count(&received), 0);
    }

    #[test]
    fn control_is_sent_every_20_ms_whatever_a_client_sends() {
        let now = MachineSnapshot { control: Some(Control::ENGAGED), ..MachineSnapshot::default() };
        let (mut stand_in, received, mut receiver) =
            (CncEmulator::default(), ReceivedFrames::default(), CncReceiver::new());
        let mut at_ms = Vec::new();
        for ms in 0..100 {
            received.record_line(b"t30280000000000000000");
            for frame in stand_in.next_frames(&now, &received).into_iter().flatten() {
                let control = receiver.accept(&frame).expect("in order");
                assert_eq!(control, Some(CncMessage::Control(Control::ENGAGED)), "{frame:?}");
                at_ms.push(ms);
            }
        }
        assert_eq!(at_ms, [0, 20, 40, 60, 80]);
        let silent = stand_in.next_frames(&MachineSnapshot::default(), &received);
        assert_eq!(silent, [None; FRAMES_PER_BLOCK], "another one is the CNC");
    }
}
