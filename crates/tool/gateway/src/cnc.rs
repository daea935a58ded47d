//! Frames for the bridge from what the PLC says: at most as often as the bus permits, a change of
//! `Control` at once.

use std::time::Duration;

use trueup_core::cnc::{Control, LinearAxis};
use trueup_link::{
    frame::Frame,
    frames::{
        self, CONDITIONS_PERIOD_MS, CONTROL_PERIOD_MS, POSITION_PERIOD_MS, SPINDLE_PERIOD_MS,
    },
};
use trueup_modbus::holding_block::CncData;

/// Frames of one identifier: their counter, and when the last was sent.
#[derive(Clone, Copy, Debug, Default)]
struct FrameTxState {
    counter: u8,
    sent: Option<Duration>,
}

impl FrameTxState {
    /// Returns the counter of the next frame, if it is due.
    fn take_due_counter(&mut self, now: Duration, period_ms: u32, at_once: bool) -> Option<u8> {
        let period = Duration::from_millis(period_ms.into());
        let waits = self.sent.is_some_and(|sent| now.saturating_sub(sent) < period);
        if waits && !at_once {
            return None;
        }
        self.sent = Some(now);
        let counter = self.counter;
        self.counter = counter.wrapping_add(1);
        Some(counter)
    }
}

/// Transmitter of the frames to the bridge.
#[derive(Debug, Default)]
pub(crate) struct CncTransmitter {
    control: FrameTxState,
    positions: [FrameTxState; 3],
    rotary: FrameTxState,
    spindle: FrameTxState,
    conditions: FrameTxState,
    last: Option<Control>,
    due: Vec<Frame>,
}

impl CncTransmitter {
    /// Takes what the PLC has just sent; nothing is repeated by itself.
    pub(crate) fn queue_frames(&mut self, now: Duration, cnc_data: &CncData) {
        let has_changed = self.last.replace(cnc_data.control) != Some(cnc_data.control);
        if let Some(counter) = self.control.take_due_counter(now, CONTROL_PERIOD_MS, has_changed) {
            self.due.push(frames::encode_control(cnc_data.control, counter));
        }
        for axis in LinearAxis::ALL {
            let place = axis as usize;
            if let Some(position) = cnc_data.positions[place]
                && let Some(counter) =
                    self.positions[place].take_due_counter(now, POSITION_PERIOD_MS, false)
            {
                self.due.push(frames::encode_position(position, counter));
            }
        }
        if let Some(rotary) = cnc_data.rotary
            && let Some(counter) = self.rotary.take_due_counter(now, POSITION_PERIOD_MS, false)
        {
            self.due.push(frames::encode_rotary(rotary, counter));
        }
        if let Some(spindle) = cnc_data.spindle
            && let Some(counter) = self.spindle.take_due_counter(now, SPINDLE_PERIOD_MS, false)
        {
            self.due.push(frames::encode_spindle(spindle, counter));
        }
        if let Some(conditions) = cnc_data.conditions
            && let Some(counter) =
                self.conditions.take_due_counter(now, CONDITIONS_PERIOD_MS, false)
        {
            self.due.push(frames::encode_conditions(conditions, counter));
        }
    }

    /// Returns the frames that are due.
    pub(crate) fn take_frames(&mut self) -> Vec<Frame> {
        std::mem::take(&mut self.due)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trueup_core::{
        cnc::{AxisPosition, CncMessage, MachineConditions, SpindleState, TravelDirection},
        units::{Position, Rpm},
    };
    use trueup_link::receiver::CncReceiver;

    #[test]
    fn a_plc_that_is_faster_than_the_bus_loses_nothing_but_repetitions() {
        let at = |axis| AxisPosition {
            axis,
            position: Position(7),
            direction: TravelDirection::Positive,
        };
        let mut cnc_data = CncData {
            control: Control::REFERENCED,
            positions: LinearAxis::ALL.map(|axis| Some(at(axis))),
            rotary: None,
            spindle: Some(SpindleState { speed: Rpm(9), load_n: -3 }),
            conditions: None,
        };
        let (mut transmitter, mut receiver) = (CncTransmitter::default(), CncReceiver::new());
        let (mut controls, mut tools, mut positions, mut others) = (vec![], vec![], 0, 0);
        for ms in 0..100 {
            cnc_data.control.engage = ms >= 33;
            cnc_data.conditions =
                Some(MachineConditions { tool: if ms < 10 { 3 } else { 4 }, bits: 1 });
            transmitter.queue_frames(Duration::from_millis(ms), &cnc_data);
            for frame in transmitter.take_frames() {
                match receiver.accept(&frame).expect("in order") {
                    Some(CncMessage::Control(control)) => controls.push((ms, control.engage)),
                    Some(CncMessage::Position(_)) => positions += 1,
                    Some(CncMessage::Conditions(it)) => tools.push((ms, it.tool, it.bits)),
                    _ => others += 1,
                }
            }
        }
        let expected = [(0, false), (20, false), (33, true), (53, true), (73, true), (93, true)];
        assert_eq!(controls, expected);
        assert_eq!((positions, others), (150, 5));
        assert_eq!(tools, [(0, 3, 1), (50, 4, 1)], "20 a second");
        assert_eq!(transmitter.take_frames(), []);
    }
}
