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
use trueup_pipe::FRAMES;

use crate::replay::Situation;

/// The frames that a run can stand in for.
const IDS: [u16; 5] = [POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID, ROTARY_ID, CONDITIONS_ID];
/// The place of `Conditions` among them, which goes out alone, between two cycles of the others.
const CONDITIONS: usize = IDS.len() - 1;
/// The place of `Control` in a cycle: a tool that writes sends one itself now and then, and is no CNC.
const CONTROL: usize = CONDITIONS;
const _: () = assert!(CONTROL < FRAMES);
/// When in its period `Conditions` goes out: in an odd millisecond.
const BETWEEN_MS: u32 = CONDITIONS_PERIOD_MS / 2;
const _: () = assert!(!BETWEEN_MS.is_multiple_of(POSITION_PERIOD_MS));

/// Which of these frames the CNC has sent itself: a bit each.
#[derive(Debug, Default)]
pub struct ReceivedFrames(AtomicU8);

impl ReceivedFrames {
    /// Takes a line of the CNC, without its end.
    pub fn note(&self, line: &[u8]) {
        let Some(id) = line.strip_prefix(b"t").and_then(|rest| rest.get(..3)) else { return };
        let id = str::from_utf8(id).ok().and_then(|id| u16::from_str_radix(id, 16).ok());
        if let Some(place) = IDS.iter().position(|&known| Some(known) == id) {
            self.0.fetch_or(1 << place, Ordering::Relaxed);
        }
    }

    fn has(&self, place: usize) -> bool {
        self.0.load(Ordering::Relaxed) & (1 << place) != 0
    }
}

/// The run's end of the bus.
#[derive(Debug, Default)]
pub struct StandIn {
    ms: u32,
    /// Each identifier counts for itself.
    counters: [u8; CONTROL + 1],
    conditions_counter: u8,
}

impl StandIn {
    /// Returns the frames of the next millisecond.
    pub fn frames(
        &mut self,
        now: &Situation,
        received: &ReceivedFrames,
    ) -> [Option<Frame>; FRAMES] {
        let ms = self.ms;
        self.ms = self.ms.wrapping_add(1);
        let mut sent = [None; FRAMES];
        if ms % CONDITIONS_PERIOD_MS == BETWEEN_MS && !received.has(CONDITIONS) {
            let said = now.conditions;
            sent[0] = said.map(|said| frames::conditions(said, self.conditions_counter));
            self.conditions_counter = self.conditions_counter.wrapping_add(said.is_some().into());
            return sent;
        }
        if !ms.is_multiple_of(POSITION_PERIOD_MS) {
            return sent;
        }
        let control = now.control.filter(|_| ms.is_multiple_of(CONTROL_PERIOD_MS));
        sent[CONTROL] = control.map(|control| frames::control(control, self.counters[CONTROL]));
        let [x, y, z] = now.positions;
        for (place, position) in [x, y, z].into_iter().enumerate() {
            sent[place] = position.map(|there| frames::position(there, self.counters[place]));
        }
        sent[3] = now.rotary.map(|there| frames::rotary(there, self.counters[3]));
        for (place, counter) in self.counters.iter_mut().enumerate() {
            if place != CONTROL && received.has(place) {
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
        cnc::{AxisPosition, Command, Conditions, Control, Heading, LinearAxis, Rotary},
        units::Position,
    };
    use trueup_link::receiver::Receiver;

    #[test]
    fn the_run_is_heard_in_order_until_the_cnc_speaks_for_itself() {
        let there =
            |axis| AxisPosition { axis, position: Position(5), direction: Heading::Positive };
        let now = Situation {
            positions: [Some(there(LinearAxis::X)), None, Some(there(LinearAxis::Z))],
            rotary: Some(Rotary::default()),
            ..Situation::default()
        };
        let (mut stand_in, received, mut receiver) =
            (StandIn::default(), ReceivedFrames::default(), Receiver::new());
        let mut ids = |ms| {
            let mut ids = Vec::new();
            for _ in 0..ms {
                for frame in stand_in.frames(&now, &received).into_iter().flatten() {
                    receiver.accept(&frame).expect("in order");
                    ids.push(frame.id());
                }
            }
            ids
        };
        assert_eq!(ids(2), [POSITION_X_ID, POSITION_Z_ID, ROTARY_ID]);
        assert_eq!(ids(600).len(), 900);
        for line in [&b"t30280000000000000000"[..], b"V", b"t20", b"txyz", b"O"] {
            received.note(line);
        }
        assert_eq!(ids(2).len(), 3, "none of these is a position");
        received.note(b"t20180000000000000000");
        assert_eq!(ids(2), [POSITION_Z_ID, ROTARY_ID]);
    }

    #[test]
    fn conditions_are_sent_every_50_ms_until_the_cnc_says_them() {
        let said = Conditions { tool: 7, bits: 5 };
        let now = Situation { conditions: Some(said), ..Situation::default() };
        let (mut stand_in, received, mut receiver) =
            (StandIn::default(), ReceivedFrames::default(), Receiver::new());
        let mut count = |received: &ReceivedFrames| {
            let frames = (0..1_000).flat_map(|_| stand_in.frames(&now, received)).flatten();
            let received = frames.map(|frame| receiver.accept(&frame).expect("in order"));
            received.filter(|it| *it == Some(Command::Conditions(said))).count()
        };
        assert_eq!(count(&received), 20);
        received.note(b"t40280000000000000000");
        assert_eq!(count(&received), 0);
    }

    #[test]
    fn control_is_sent_every_20_ms_whatever_a_client_sends() {
        let now = Situation { control: Some(Control::ENGAGED), ..Situation::default() };
        let (mut stand_in, received, mut receiver) =
            (StandIn::default(), ReceivedFrames::default(), Receiver::new());
        let mut at_ms = Vec::new();
        for ms in 0..100 {
            received.note(b"t30280000000000000000");
            for frame in stand_in.frames(&now, &received).into_iter().flatten() {
                let told = receiver.accept(&frame).expect("in order");
                assert_eq!(told, Some(Command::Control(Control::ENGAGED)), "{frame:?}");
                at_ms.push(ms);
            }
        }
        assert_eq!(at_ms, [0, 20, 40, 60, 80]);
        let silent = stand_in.frames(&Situation::default(), &received);
        assert_eq!(silent, [None; FRAMES], "another one is the CNC");
    }
}
