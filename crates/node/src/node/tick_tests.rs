//! What a CNC has of a node: offsets, and what becomes of its commands.

use super::*;
use std::vec::Vec;
use trueup_core::{
    cnc::Control,
    dimensions::CODES_PER_TICK,
    units::{Code, Nanometres},
};
use trueup_link::{
    frames::{HEARTBEAT_ID, OFFSET_XY_ID, OFFSET_Z_ID},
    receiver::OffsetReceiver,
};

const BLIND: Input<'static> = Input { codes: None, speed: None, temperatures: None };

#[test]
fn both_halves_of_a_cycle_share_a_counter_that_counts_the_cycles() {
    let mut node = Node::new(Some(tests_calibration()), false);
    for cycle in 0..600_u32 {
        let sent = node.tick(1, BLIND);
        let ids: Vec<u16> = sent.iter().map(Frame::id).collect();
        assert_eq!(ids, [OFFSET_XY_ID, OFFSET_Z_ID]);
        let counters: Vec<u32> = sent.iter().map(|frame| frames::counter(frame).into()).collect();
        assert_eq!(counters, [cycle % 256, cycle % 256]);
    }
}

#[test]
fn the_heartbeat_comes_at_once_and_then_every_100_ms_whatever_a_tick_lasts() {
    for tick_ms in [1, 10] {
        let mut node = Node::new(Some(tests_calibration()), false);
        let mut beats = Vec::new();
        while node.now().0 < 1_000 {
            node.tick(tick_ms, BLIND);
            let said = node.service();
            beats.extend(said.is_some_and(|f| f.id() == HEARTBEAT_ID).then(|| node.now().0));
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
    let said = (0..110).filter_map(|_| {
        node.tick(1, BLIND);
        node.service()
    });
    let beats = said.filter_map(|frame| frames::decode_heartbeat(&frame).ok());
    assert_eq!(beats.collect::<Vec<_>>(), [State::BootUp, State::Stopped]);
}

#[test]
fn a_board_on_a_fall_back_marks_every_frame() {
    for degraded in [false, true] {
        let mut node = Node::new(Some(tests_calibration()), degraded);
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
        let control = Control { zero, ..Control::ENGAGED };
        node.hear(&frames::control(control, counter)).expect("in order");
    };
    let live = |node: &mut Node<'_>, ms| {
        for _ in 0..ms {
            node.tick(1, Input { codes: Some(&alive(700)), ..Input::default() });
        }
    };
    let mut node = Node::new(Some(tests_calibration()), false);
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

    let mut again = Node::new(Some(tests_calibration()), false);
    again.set_reference(reference);
    live(&mut again, 400);
    send(&mut again, false, 0);
    live(&mut again, 10);
    assert_eq!(again.last().quality, Quality::Live);
    assert_eq!(again.last().offset, Some([Nanometres::ZERO; 3]));
}

#[test]
fn a_damaged_control_is_counted_and_engages_nothing() {
    let control = Control::ENGAGED;
    let good = frames::control(control, 0);
    let mut data = *good.data();
    data[3] ^= 1;
    let damaged = Frame::new(good.id(), &data).unwrap();
    for (frame, engages) in [(damaged, false), (good, true)] {
        let mut node = Node::new(Some(tests_calibration()), false);
        assert_eq!(node.hear(&frame).is_ok(), engages);
        assert_eq!(node.receiver().counters().crc_errors, u32::from(!engages));
        for _ in 0..450 {
            let codes = core::array::from_fn(|n| Code(if n % 2 == 0 { 700 } else { 701 }));
            node.tick(1, Input { codes: Some(&codes), ..Input::default() });
        }
        assert_eq!(node.last().quality == Quality::Live, engages);
    }
}
