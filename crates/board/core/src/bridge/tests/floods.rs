//! Positions that come faster than ticks: the errors of an axis are computed once when a position comes, and once in the tick.

use super::*;
use crate::{
    calibration::DualDrive,
    pitch_table::{GantryBeam, PitchErrorTable},
    reversal::Interval,
    testing::next_random,
};

const TRAVEL: i32 = 300;

/// Returns a machine with pitch tables and backlash on each axis, X on two drives across Y.
fn machine() -> Calibration<'static> {
    static TABLES: [[[u8; 4]; 4]; 4] = {
        let point = i32::to_le_bytes;
        [
            [point(0), point(9_000), point(-4_000), point(50_000)],
            [point(700), point(-30_000), point(2_000), point(0)],
            [point(5_000), point(5_000), point(-60_000), point(1_000)],
            [point(-8_000), point(20_000), point(0), point(-1_000)],
        ]
    };
    let pitch = |number: usize| PitchErrorTable {
        start: Position(0),
        step: Interval::new(100),
        forward: &TABLES[number],
        reverse: None,
    };
    let mut machine = minimal_calibration();
    for (number, axis) in machine.axes.iter_mut().enumerate() {
        axis.pitch = Some(pitch(number));
        axis.backlash = FineNanometres(-256);
    }
    machine.axes[0].dual = Some(DualDrive {
        across: LinearAxis::Y,
        beam: GantryBeam::new(Position(0), Position(TRAVEL)),
        pitch: pitch(3),
    });
    machine
}

impl Rig {
    fn receive_position_of(&mut self, axis: LinearAxis, at: i32, direction: TravelDirection) {
        let received = AxisPosition { axis, position: Position(at), direction };
        self.bridge.receive(&mut self.state, CncMessage::Position(received));
    }
}

#[test]
fn of_an_axis_that_moves_again_the_next_tick_computes_the_errors() {
    let mut rig = Rig::new(machine());
    let to =
        |rig: &mut Rig, at| rig.receive_position_of(LinearAxis::X, at, TravelDirection::Positive);
    for turn in 0..3 {
        for _ in 0..ERROR_UPDATE_PERIOD_MS {
            rig.control(ENGAGED);
            rig.tick(None);
        }
        rig.receive_position_of(LinearAxis::Y, 40 + turn, TravelDirection::Positive);
        to(&mut rig, 50 + turn);
        let first = *rig.state.errors.errors();
        assert!(rig.state.error_sums.is_some(), "computed at once");
        for at in [100, 150, 200] {
            to(&mut rig, at + turn);
            assert_eq!(*rig.state.errors.errors(), first, "not computed again");
            assert!(rig.state.error_sums.is_none());
        }
        // Another axis has its own.
        rig.receive_position_of(LinearAxis::Z, 110 + 20 * turn, TravelDirection::Positive);
        assert_ne!(rig.state.errors.errors().axes[2], first.axes[2]);
        rig.control(ENGAGED);
        rig.tick(None);
        let (heat, place) = (&rig.state.heat, &rig.state.place);
        assert_eq!(
            *rig.state.errors.errors(),
            rig.bridge.calibration.compute_axis_errors(heat, place)
        );
    }
}

#[test]
fn however_many_positions_come_in_a_tick_the_offset_is_that_of_the_last() {
    let (mut many, mut last_alone) = (Rig::new(machine()), Rig::new(machine()));
    let mut seed = 47;
    for tick in 0..3_000 {
        let mut last = [None; 3];
        for _ in 0..next_random(&mut seed) % 12 {
            let number = next_random(&mut seed) as usize % 3;
            let at = (next_random(&mut seed) % (TRAVEL as u32 + 40)) as i32 - 20;
            let direction = if next_random(&mut seed).is_multiple_of(2) {
                TravelDirection::Positive
            } else {
                TravelDirection::Negative
            };
            many.receive_position_of(LinearAxis::ALL[number], at, direction);
            last[number] = Some((at, direction));
        }
        // At most one an axis: mostly its errors are computed when it comes.
        for (axis, (at, direction)) in
            LinearAxis::ALL.into_iter().zip(last).filter_map(|(axis, last)| Some((axis, last?)))
        {
            last_alone.receive_position_of(axis, at, direction);
        }
        for rig in [&mut many, &mut last_alone] {
            // Now and then nothing is followed for some ticks.
            rig.control(Control { engage: tick % 50 > 5, ..ENGAGED });
            rig.tick(None);
        }
        assert_eq!(many.last.offset, last_alone.last.offset, "tick {tick}");
        assert_eq!(many.last.flags, last_alone.last.flags, "tick {tick}");
    }
}

#[test]
fn angles_that_come_again_within_two_ticks_are_for_the_next_tick() {
    let mut rig = Rig::new(machine());
    let turn = |rig: &mut Rig, angle| {
        let angles = [MicroDegrees(angle); 2];
        rig.bridge.receive(&mut rig.state, CncMessage::Rotary(RotaryAxisAngles { angles }));
        rig.state.deferred != IndexSet::default()
    };
    for _ in 0..ERROR_UPDATE_PERIOD_MS {
        rig.tick(None);
    }
    assert!(!turn(&mut rig, 1) && !turn(&mut rig, 1), "at once, and the same again is no change");
    assert!(turn(&mut rig, 2), "later");
    assert_eq!(rig.state.tool.latest().map(|(angles, _)| angles), Some([MicroDegrees(2); 2]));
}
