//! Who is the master, for how long, and which of his edges are believed.

use super::*;
use std::vec::Vec;

const TIMEOUT_MS: u32 = 500;
const ZERO: Control = Control { zero: true, ..Control::REFERENCED };
const CONFIRM: Control = Control { confirm: true, ..Control::REFERENCED };

/// Returns a master that has sent this many frames without a bit that means something.
fn steady() -> Master {
    let mut master = Master::default();
    for _ in 0..MIN_CONSECUTIVE_FRAMES {
        let received =
            master.accept_control(Interface::Can, Control::REFERENCED).expect("it is alone");
        assert!(!received.zero && !received.confirm);
    }
    master
}

/// Returns what comes of each of this many frames: `Zero` believed, `Zero` asked for, `Confirm`.
fn send_control(master: &mut Master, control: Control, count: usize) -> Vec<(bool, bool, bool)> {
    let mut one = || master.accept_control(Interface::Can, control).expect("it is alone");
    let three = |received: ControlEvent| (received.control.zero, received.zero, received.confirm);
    (0..count).map(|_| three(one())).collect()
}

const NO: (bool, bool, bool) = (false, false, false);
const TAKEN: (bool, bool, bool) = (true, true, false);
const TOO_SHORT: (bool, bool, bool) = (false, true, false);
const CONFIRMED: (bool, bool, bool) = (false, false, true);

#[test]
fn the_third_frame_of_a_bit_is_its_edge_and_there_is_none_while_it_stays() {
    assert_eq!(send_control(&mut steady(), ZERO, 6), [NO, NO, TAKEN, NO, NO, NO]);
    assert_eq!(send_control(&mut steady(), CONFIRM, 6), [NO, NO, CONFIRMED, NO, NO, NO]);
}

#[test]
fn a_bit_that_was_never_seen_as_0_by_a_steady_master_has_no_edge() {
    assert_eq!(send_control(&mut Master::default(), ZERO, 10), [NO; 10]);
    let mut unsteady = steady();
    unsteady.reject_control(false);
    assert_eq!(send_control(&mut unsteady, Control::REFERENCED, 1), [NO]);
    assert_eq!(send_control(&mut unsteady, CONFIRM, 10), [NO; 10], "0 in one frame alone");
}

#[test]
fn a_zero_that_a_refused_frame_cuts_short_is_reported_once_and_what_was_not_begun_is_not() {
    for (frames, reported) in [(0, NO), (1, TOO_SHORT), (2, TOO_SHORT), (3, NO)] {
        let mut master = steady();
        send_control(&mut master, ZERO, frames);
        master.reject_control(false);
        master.reject_control(false);
        assert_eq!(
            send_control(&mut master, Control::REFERENCED, 2),
            [reported, NO],
            "{frames} frames"
        );
    }
    let mut master = steady();
    send_control(&mut master, CONFIRM, 2);
    master.reject_control(false);
    assert_eq!(
        send_control(&mut master, CONFIRM, 5),
        [NO; 5],
        "its first two frames count no more"
    );
}

#[test]
fn confirm_answers_a_question_and_is_nothing_that_the_bridge_receives() {
    let mut master = steady();
    for _ in 0..5 {
        let received = master.accept_control(Interface::Can, CONFIRM).expect("it is alone");
        assert_eq!(received.control, Control::REFERENCED);
    }
}

#[test]
fn a_line_is_the_masters_up_to_the_timeout_of_the_link_and_anybodys_after_it() {
    for (step_ms, steps) in [(1, TIMEOUT_MS), (TIMEOUT_MS, 1)] {
        let mut master = steady();
        (0..steps).for_each(|_| master.tick(step_ms, TIMEOUT_MS));
        assert!(
            master.accepts_interface(Interface::Can)
                && !master.accepts_interface(Interface::Serial)
        );
        assert_eq!(master.write_authority(), WriteAuthority::NoService);
        master.tick(step_ms, TIMEOUT_MS);
        assert!(master.accepts_interface(Interface::Serial));
        assert_eq!(master.write_authority(), WriteAuthority::NoMaster);
    }
}

#[test]
fn a_second_master_is_reported_for_two_to_four_seconds_after_the_last_frame_out_of_sequence() {
    // Three are one, however many follow; each of the sum goes in 200 ms.
    for (strange, is_doubtful, at_least_ms, at_most_ms) in
        [(2, false, 0, 0), (3, true, 2_200, 2_400), (100, true, 3_000, 3_200)]
    {
        let mut master = steady();
        (0..strange).for_each(|_| master.reject_control(true));
        assert_eq!(master.has_second_sender(), is_doubtful, "{strange} frames");
        let believed = master.accept_control(Interface::Can, Control::REFERENCED).is_some();
        assert_eq!(believed, !is_doubtful, "{strange} frames");
        // Nobody else sends: one frame follows from nothing.
        let reported_ms = (0..100_000).take_while(|_| {
            let is_reported = master.has_second_sender();
            master.tick(1, TIMEOUT_MS);
            is_reported
        });
        let reported_ms = reported_ms.count();
        assert!(
            (at_least_ms..=at_most_ms).contains(&reported_ms),
            "{strange} frames: {reported_ms} ms"
        );
    }
    // What came damaged is noise.
    let mut master = steady();
    (0..100).for_each(|_| master.reject_control(false));
    assert!(!master.has_second_sender());
}

/// Returns a CNC that sends every this many milliseconds from `phase_ms` on, and a stranger with counters of its own that
/// sends bursts. Returns in how many of `ms` milliseconds after the stranger's last frame the CNC is not believed, and
/// how many of the stranger's frames were.
fn contest(period_ms: u32, burst: u32, every_ms: u32, bursts: u32, ms: u32) -> (u32, usize) {
    let mut master = steady();
    let (mut last_is_cnc, mut waits_ms, mut strangers) = (true, 0, 0_usize);
    let mut believed = |master: &mut Master, is_cnc: bool| {
        let follows = is_cnc == core::mem::replace(&mut last_is_cnc, is_cnc);
        if !follows {
            master.reject_control(true);
        }
        follows && master.accept_control(Interface::Can, Control::REFERENCED).is_some()
    };
    let mut is_back = false;
    let last = every_ms * bursts;
    for now in 1..=last + ms {
        if now <= last && now.is_multiple_of(every_ms) {
            strangers += (0..burst).filter(|_| believed(&mut master, false)).count();
        }
        if now % period_ms == 7 {
            is_back = believed(&mut master, true);
        }
        waits_ms += u32::from(now > last && !is_back);
        master.tick(1, TIMEOUT_MS);
    }
    (waits_ms, strangers)
}

#[test]
fn after_a_strangers_frames_the_cnc_is_the_master_again_within_a_quarter_of_the_timeout() {
    // Ten frames, as fast as the CNC's; bursts of six; one.
    for (burst, every_ms, bursts) in [(1, 20, 10), (6, 30, 10), (1, 3, 200), (1, 20, 1)] {
        let (waits_ms, _) = contest(20, burst, every_ms, bursts, 1_000);
        assert!(waits_ms <= TIMEOUT_MS / 4 + 60, "{bursts} of {burst}: {waits_ms} ms");
    }
}

#[test]
fn a_stranger_does_not_become_the_master_of_a_cnc_that_sends_four_times_in_its_timeout() {
    for period_ms in [20, 50, 100, 124] {
        // Before it is noticed its bursts pass; for the next minute nothing of it does.
        let (_, few) = contest(period_ms, 4, 10, 20, 0);
        let (_, many) = contest(period_ms, 4, 10, 6_000, 0);
        assert_eq!(few, many, "{period_ms} ms");
    }
}

#[test]
fn another_line_is_reported_for_two_and_four_tenths_of_a_second_after_it_was_last_received() {
    let mut master = steady();
    master.record_frame_on_other_interface();
    (0..2_000).for_each(|_| master.tick(1, TIMEOUT_MS));
    master.record_frame_on_other_interface();
    for ms in 0..3_000 {
        assert_eq!(master.has_second_sender(), ms < 2_400, "after {ms} ms");
        master.tick(1, TIMEOUT_MS);
    }
}
