//! A position that its axis cannot have reached: reported, not believed, and believed once others follow from it.

use super::*;
use crate::testing::next_random;

/// 30 m/min: half a millimetre in a millisecond.
const RAPID: u32 = 50_000;
const MM: i32 = Position::PER_MILLIMETRE;

/// Returns a machine whose X has a table, so that its position is needed, and this rapid traverse.
fn machine(rapid: u32) -> Calibration<'static> {
    /// 1 µm on 1 m.
    static POINTS: [[u8; 4]; 2] = [[0; 4], 256_000_i32.to_le_bytes()];
    let mut machine = minimal_calibration();
    machine.axes[0].rapid = rapid;
    machine.axes[0].pitch = Some(crate::pitch_table::PitchErrorTable {
        start: Position(0),
        step: crate::reversal::Interval::new(1_000 * MM.unsigned_abs()),
        forward: &POINTS,
        reverse: None,
    });
    machine
}

impl Rig {
    fn position(&mut self, at: i32) {
        let received = AxisPosition {
            axis: LinearAxis::X,
            position: Position(at),
            direction: TravelDirection::Positive,
        };
        self.bridge.receive(&mut self.state, CncMessage::Position(received));
    }

    /// This many milliseconds with a `Control` in each and no position.
    fn wait(&mut self, ms: u32) {
        for _ in 0..ms {
            self.control(ENGAGED);
            self.tick(None);
        }
    }

    /// Where it takes X to be.
    fn x(&self) -> i32 {
        self.state.place.position[0].0
    }
}

/// Returns whether a position so far away is believed after so long.
fn is_believed(rapid: u32, way: i32, after_ms: u32) -> bool {
    let mut rig = Rig::new(machine(rapid));
    rig.position(100 * MM);
    rig.wait(after_ms);
    rig.position(100 * MM + way);
    assert_eq!(rig.state.has_position_jumped(), rig.x() != 100 * MM + way);
    rig.x() == 100 * MM + way
}

#[test]
fn the_figures_are_those_of_the_manual() {
    assert_eq!((MAX_POSITION_JITTER_MS, JUMP_REPORT_DURATION_MS), (20, 100));
}

#[test]
fn an_axis_comes_as_far_as_its_rapid_traverse_takes_it_in_the_time_and_20_ms_and_no_further() {
    for after_ms in [0_u32, 1, 2, 10, 100, 400] {
        let reach = RAPID.cast_signed() * (after_ms.cast_signed() + 20);
        for sign in [1, -1] {
            assert!(is_believed(RAPID, sign * reach, after_ms), "after {after_ms} ms");
            assert!(!is_believed(RAPID, sign * (reach + 1), after_ms), "after {after_ms} ms");
        }
    }
}

#[test]
fn an_axis_without_a_stated_rapid_traverse_is_accepted_anywhere() {
    assert!(is_believed(0, 1_000 * MM, 1));
}

#[test]
fn the_first_position_is_believed_wherever_it_is() {
    for at in [i32::MIN, 0, i32::MAX] {
        let mut rig = Rig::new(machine(1));
        rig.position(at);
        assert_eq!((rig.x(), rig.state.has_position_jumped()), (at, false));
    }
}

#[test]
fn a_jump_moves_no_offset_is_reported_and_is_accepted_once_three_more_follow_from_it() {
    let mut rig = Rig::new(machine(RAPID));
    rig.position(100 * MM);
    rig.wait(1_000);
    rig.position(100 * MM);
    rig.wait(10);
    let before = rig.last.offset;
    // On its way at 30 m/min, 100 mm further; the last that is believed is 10 ms old.
    for n in 0..3 {
        rig.position(200 * MM + n * 4 * RAPID.cast_signed());
        assert!(rig.state.has_position_jumped() && rig.x() == 100 * MM, "message {n}");
        rig.wait(4);
        assert_eq!((rig.last.offset, rig.last.quality), (before, OffsetQuality::Live));
        // What it rests on is as old as that, standing or not.
        assert_eq!(i32::from(rig.last.age_ms), 14 + 4 * n);
    }
    rig.position(206 * MM);
    assert_eq!(rig.x(), 206 * MM);
    for ms in 5..=101 {
        assert!(rig.state.has_position_jumped(), "reported for {ms} ms");
        rig.position(206 * MM);
        rig.wait(1);
    }
    assert!(!rig.state.has_position_jumped());
    assert_eq!(rig.last.age_ms, 0);
}

#[test]
fn one_wild_position_among_good_ones_is_never_followed() {
    let mut rig = Rig::new(machine(RAPID));
    for n in 0..200 {
        let at = if n % 20 == 10 { -900 * MM } else { n * RAPID.cast_signed() };
        rig.position(at);
        rig.wait(1);
        let behind_ms = n - rig.x() / RAPID.cast_signed();
        // The wild one, the first after it, and the two that have to follow.
        assert!((0..=4).contains(&behind_ms), "{behind_ms} ms behind after {n}");
    }
    assert_eq!(rig.last.quality, OffsetQuality::Live);
}

#[test]
fn positions_that_never_follow_from_each_other_are_a_cnc_that_is_lost() {
    let mut rig = Rig::new(machine(RAPID));
    rig.position(0);
    rig.wait(100);
    for n in 0..600 {
        rig.position(if n % 2 == 0 { 900 * MM } else { -900 * MM });
        rig.wait(1);
        assert_eq!(rig.x(), 0);
    }
    assert_eq!(rig.last.quality, OffsetQuality::Hold);
    assert!(rig.last.flags.contains(OffsetFlags::CNC_LOST));
}

#[test]
fn three_thousand_jumps_are_found_by_their_first_message() {
    let mut seed = 3;
    let mut below = |end: i32| (next_random(&mut seed) % end.cast_unsigned()).cast_signed();
    for _ in 0..3_000 {
        // 1 to 120 m/min, a message every 1 to 100 ms; from just out of reach to 2 m.
        let rapid = 1_667 + below(200_000);
        let after_ms = 1 + below(100);
        let reach = rapid * (after_ms + 20);
        let way = reach + 1 + below((200 * MM).max(reach) - reach + MM);
        let way = if below(2) == 0 { way } else { -way };
        assert!(!is_believed(rapid.cast_unsigned(), way, after_ms.cast_unsigned()), "{way}");
    }
}

#[test]
fn an_axis_at_its_rapid_traverse_never_jumps_however_its_messages_are_lost_and_late() {
    let mut seed = 4;
    for draw in 0..100 {
        let period_ms = 2 + next_random(&mut seed) % 30;
        // A position is sent at a multiple of its period, and comes up to 20 ms late, but in order.
        let (mut rig, mut last) = (Rig::new(machine(RAPID)), 0);
        let at = |ms: u32| (ms.min(4_000) * RAPID).cast_signed();
        for ms in 1..4_100_u32 {
            rig.wait(1);
            let late_ms = next_random(&mut seed) % 21;
            let sent = ms.saturating_sub(late_ms) / period_ms * period_ms;
            // Half of them are lost, and now and then all for 300 ms.
            let is_lost = next_random(&mut seed).is_multiple_of(2) || ms / 300 % 5 == 4;
            if sent > last && ms - sent <= 20 && !is_lost {
                last = sent;
                rig.position(at(sent));
                assert!(!rig.state.has_position_jumped(), "draw {draw}, {ms} ms");
            }
        }
    }
}
