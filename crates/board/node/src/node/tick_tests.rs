//! Tests of a node as a CNC sees it: offsets, and the effects of its commands.

use super::*;
use std::{vec, vec::Vec};
use trueup_core::{
    bridge::ReferenceErrors,
    cnc::Control,
    design_parameters::CODES_PER_TICK,
    units::{AdcCode, Nanometres},
};
use trueup_link::{
    frames::{HEARTBEAT_ID, OFFSET_XY_ID, OFFSET_Z_ID},
    receiver::OffsetReceiver,
};
use trueup_store::reference::ReferenceStatus;

const NO_INPUT: TickInput<'static> = TickInput { codes: None, speed: None, temperatures: None };

#[test]
fn both_halves_of_a_cycle_share_a_counter_that_counts_the_cycles() {
    let mut node = Node::new(sensor_only_calibration().into());
    for cycle in 0..600_u32 {
        let sent = node.tick(1, NO_INPUT);
        let ids: Vec<u16> = sent.iter().map(Frame::id).collect();
        assert_eq!(ids, [OFFSET_XY_ID, OFFSET_Z_ID]);
        let counters: Vec<u32> =
            sent.iter().map(|frame| frames::e2e_counter(frame).into()).collect();
        assert_eq!(counters, [cycle % 256, cycle % 256]);
    }
}

#[test]
fn the_heartbeat_comes_at_once_and_then_every_100_ms_whatever_a_tick_lasts() {
    for tick_ms in [1, 10] {
        let mut node = Node::new(sensor_only_calibration().into());
        let mut beats = Vec::new();
        while node.now().0 < 1_000 {
            node.tick(tick_ms, NO_INPUT);
            let frames = node.next_service_frame();
            beats.extend(frames.is_some_and(|f| f.id() == HEARTBEAT_ID).then(|| node.now().0));
        }
        assert_eq!(beats.len(), 10, "{beats:?}");
        assert!(beats.windows(2).all(|pair| pair[1] - pair[0] == 100), "{beats:?}");
    }
}

#[test]
fn without_a_calibration_nothing_is_available_and_the_node_is_stopped() {
    let mut node = Node::new(NodeConfiguration::default());
    let codes = [AdcCode(700); CODES_PER_TICK];
    let sent = node.tick(1, TickInput { codes: Some(&codes), ..TickInput::default() });
    let mut receiver = OffsetReceiver::new();
    let output = sent.iter().filter_map(|f| receiver.accept(f).unwrap_or_default()).next();
    let output = output.expect("a whole cycle");
    assert_eq!((output.offset, output.quality, output.age_ms), (None, OffsetQuality::Fault, 255));
    let sent_frames = (0..110).filter_map(|_| {
        node.tick(1, NO_INPUT);
        node.next_service_frame()
    });
    let beats = sent_frames.filter_map(|frame| frames::decode_heartbeat(&frame).ok());
    assert_eq!(beats.collect::<Vec<_>>(), [NmtState::BootUp, NmtState::Stopped]);
}

#[test]
fn a_board_on_a_fall_back_marks_every_frame() {
    for is_degraded in [false, true] {
        let mut node =
            Node::new(NodeConfiguration { is_degraded, ..sensor_only_calibration().into() });
        node.tick(1, NO_INPUT);
        assert_eq!(node.last_output().flags.contains(OffsetFlags::BOARD_DEGRADED), is_degraded);
    }
}

/// Returns a node that has received the engage sequence but for its end; the next counter is 3.
fn disengaged_node() -> Node<'static> {
    let mut node = Node::new(sensor_only_calibration().into());
    for frame in frames::disengaged_control_frames() {
        node.receive(Interface::Can, &frame).expect("in order");
    }
    node
}

/// Codes that are alive, at a level and a half.
fn live_codes(level: u16) -> [AdcCode; CODES_PER_TICK] {
    core::array::from_fn(|n| AdcCode(level + u16::from(n % 2 == 1)))
}

#[test]
fn a_zero_is_reported_once_and_what_it_took_can_be_given_back_to_another_node() {
    let send = |node: &mut Node<'_>, zero, counter| {
        let control = Control { zero, ..Control::ENGAGED };
        node.receive(Interface::Can, &frames::encode_control(control, counter)).expect("in order");
    };
    let live = |node: &mut Node<'_>, ms| {
        for _ in 0..ms {
            node.tick(1, TickInput { codes: Some(&live_codes(400)), ..TickInput::default() });
        }
    };
    let mut node = disengaged_node();
    // Without samples it is refused, and so is one that is too short.
    (3..6).for_each(|counter| send(&mut node, true, counter));
    assert_eq!(
        (node.take_zero_outcome(), node.take_zero_outcome()),
        (Some(ZeroOutcome::Unchanged), None)
    );
    live(&mut node, 400);
    send(&mut node, false, 6);
    (7..9).for_each(|counter| send(&mut node, true, counter));
    assert_eq!(node.take_zero_outcome(), None);
    send(&mut node, false, 9);
    assert_eq!(node.take_zero_outcome(), Some(ZeroOutcome::Unchanged));
    (10..14).for_each(|counter| send(&mut node, true, counter));
    let Some(ZeroOutcome::Taken(reference)) = node.take_zero_outcome() else { panic!("not taken") };
    assert_ne!(reference, ReferenceErrors::default());
    assert_eq!(node.take_zero_outcome(), None);

    let mut again = disengaged_node();
    again.restore_reference_status(ReferenceStatus::in_force(reference), None);
    live(&mut again, 400);
    send(&mut again, false, 3);
    live(&mut again, 10);
    assert_eq!(again.last_output().quality, OffsetQuality::Live);
    assert_eq!(again.last_output().offset, Some([Nanometres::ZERO; 3]));
}

#[test]
fn a_damaged_control_is_counted_and_engages_nothing() {
    let control = Control::ENGAGED;
    let good = frames::encode_control(control, 3);
    let mut data = *good.data();
    data[3] ^= 1;
    let damaged = Frame::new(good.id(), &data).unwrap();
    for (frame, engages) in [(damaged, false), (good, true)] {
        let mut node = disengaged_node();
        assert_eq!(node.receive(Interface::Can, &frame).is_ok(), engages);
        assert_eq!(node.receiver().counters().crc_errors, u32::from(!engages));
        for _ in 0..450 {
            let codes = core::array::from_fn(|n| AdcCode(if n % 2 == 0 { 700 } else { 701 }));
            node.tick(1, TickInput { codes: Some(&codes), ..TickInput::default() });
        }
        assert_eq!(node.last_output().quality == OffsetQuality::Live, engages);
    }
}

/// Gives a board such a history of `Control`, each 20 ms after the one before.
fn send_control_sequence(
    controls: impl IntoIterator<Item = (Interface, Control)>,
    node: &mut Node<'_>,
) {
    let mut counters = [3_u8; 2];
    for (line, control) in controls {
        let counter = &mut counters[usize::from(line == Interface::Serial)];
        node.receive(line, &frames::encode_control(control, *counter)).ok();
        *counter = counter.wrapping_add(1);
        for _ in 0..20 {
            node.tick(1, TickInput { codes: Some(&live_codes(700)), ..TickInput::default() });
            node.next_service_frame();
        }
    }
}

fn state(node: &Node<'_>) -> trueup_link::status::StateBits {
    node.faults(node.last_output()).state_bits()
}

#[test]
fn after_a_start_nothing_is_available_until_engage_was_0_three_times_and_then_1() {
    use trueup_link::status::StateBits;
    let (on, off) = ((Interface::Can, Control::ENGAGED), (Interface::Can, Control::REFERENCED));
    for (received, is_available) in [
        (vec![], false),
        (vec![on; 50], false),
        (vec![off; 50], false),
        (vec![off, off, on, on, on], false),
        (vec![on, off, off, on, off, on], false),
        (vec![on, off, off, off, on], true),
    ] {
        let mut node = Node::new(sensor_only_calibration().into());
        send_control_sequence(std::iter::repeat_n(on, 20).chain(received.clone()), &mut node);
        assert_eq!(node.last_output().offset.is_some(), is_available, "{received:?}");
        assert_eq!(state(&node).contains(StateBits::RESTARTED), !is_available);
        let quality = if is_available { OffsetQuality::Live } else { OffsetQuality::Fault };
        assert_eq!(node.last_output().quality, quality);
    }
}

#[test]
fn a_question_bars_the_offset_until_confirm_has_answered_it_and_one_edge_answers_one() {
    use trueup_link::status::StateBits;
    let mut node = disengaged_node();
    node.require_confirmation(Fault::OlderCalibration);
    node.require_confirmation(Fault::ForeignMachine);
    let confirm = Control { confirm: true, ..Control::ENGAGED };
    let plain = Control::ENGAGED;
    send_control_sequence([plain; 30].map(|frame| (Interface::Can, frame)), &mut node);
    assert_eq!(
        (node.last_output().quality, node.last_output().offset),
        (OffsetQuality::Fault, None)
    );
    let both = StateBits::OLDER_CALIBRATION.0 | StateBits::FOREIGN_MACHINE.0;
    assert_eq!(state(&node).0, both);
    for (held, left, answered) in [
        (9, StateBits::OLDER_CALIBRATION, Fault::ForeignMachine),
        (3, StateBits::default(), Fault::OlderCalibration),
    ] {
        let received = std::iter::repeat_n(plain, 3).chain(std::iter::repeat_n(confirm, held));
        // The counters go on where they were.
        node.receiver = CncReceiver::new();
        send_control_sequence(received.map(|frame| (Interface::Can, frame)), &mut node);
        assert_eq!(state(&node), left);
        assert_eq!(
            (node.take_confirmed_fault(), node.take_confirmed_fault()),
            (Some(answered), None)
        );
    }
    assert_eq!(node.last_output().quality, OffsetQuality::Live);
}

#[test]
fn example_constants_are_never_live() {
    let mut node = disengaged_node();
    node.set_fault(Fault::ExampleConstants);
    node.update_inhibition();
    let confirm = |n: u32| Control { confirm: n % 10 < 5, ..Control::ENGAGED };
    send_control_sequence((0..200).map(|n| (Interface::Can, confirm(n))), &mut node);
    assert_eq!(
        (node.last_output().quality, node.last_output().offset),
        (OffsetQuality::Fault, None)
    );
    assert!(state(&node).contains(trueup_link::status::StateBits::EXAMPLE_CONSTANTS));
}

#[test]
fn a_damaged_board_is_never_live_and_reports_it() {
    let mut node = disengaged_node();
    node.set_self_test_failed();
    send_control_sequence((0..200).map(|_| (Interface::Can, Control::ENGAGED)), &mut node);
    assert_eq!(
        (node.last_output().quality, node.last_output().offset),
        (OffsetQuality::Fault, None)
    );
    assert!(state(&node).contains(trueup_link::status::StateBits::SELF_TEST_FAILED));
}

#[test]
fn a_master_on_another_line_is_reported_and_has_no_effect() {
    let mut node = disengaged_node();
    let zero = |n: u32| Control { zero: n % 14 < 7, ..Control::REFERENCED };
    let both =
        (0..100).flat_map(|n| [(Interface::Can, Control::ENGAGED), (Interface::Serial, zero(n))]);
    send_control_sequence(both, &mut node);
    assert_eq!(node.last_output().quality, OffsetQuality::Live);
    assert_eq!(node.take_zero_outcome(), None);
    assert!(state(&node).contains(trueup_link::status::StateBits::SECOND_MASTER));
    send_control_sequence((0..200).map(|_| (Interface::Can, Control::ENGAGED)), &mut node);
    assert_eq!(state(&node).0 & trueup_link::status::StateBits::SECOND_MASTER.0, 0);
}

#[test]
fn what_comes_damaged_over_another_line_is_noise_and_no_second_master() {
    let mut node = disengaged_node();
    for counter in 3..60_u8 {
        node.receive(Interface::Can, &frames::encode_control(Control::ENGAGED, counter))
            .expect("in order");
        let mut data = *frames::encode_control(Control::REFERENCED, counter).data();
        data[3 + usize::from(counter) % 5] ^= 1 << (counter % 8);
        let noise = Frame::new(CONTROL_ID, &data).expect("eight bytes");
        assert_eq!(node.receive(Interface::Serial, &noise), Ok(None));
        for _ in 0..20 {
            node.tick(1, TickInput { codes: Some(&live_codes(700)), ..TickInput::default() });
            node.next_service_frame();
        }
        assert_eq!(state(&node).0 & trueup_link::status::StateBits::SECOND_MASTER.0, 0);
    }
    assert_eq!(node.last_output().quality, OffsetQuality::Live);
}

#[test]
fn two_masters_on_one_line_take_no_zero_and_are_not_followed() {
    // One ahead of the other at equal rate: each second frame is accepted, always of the same one.
    for lead in [0_u8, 1, 5, 100] {
        let mut node = disengaged_node();
        for n in 0..100_u8 {
            let first = Control { zero: true, ..Control::ENGAGED };
            for (control, counter) in [(first, n + 3), (Control::REFERENCED, n + 3 + lead)] {
                node.receive(Interface::Can, &frames::encode_control(control, counter)).ok();
                for _ in 0..10 {
                    node.tick(
                        1,
                        TickInput {
                            codes: Some(&live_codes(700 + u16::from(n))),
                            ..TickInput::default()
                        },
                    );
                    node.next_service_frame();
                }
            }
        }
        assert!(state(&node).contains(trueup_link::status::StateBits::SECOND_MASTER), "{lead}");
        assert!(!matches!(node.take_zero_outcome(), Some(ZeroOutcome::Taken(_))), "{lead}");
        assert_ne!(node.last_output().quality, OffsetQuality::Live, "{lead}");
    }
}

#[test]
fn a_cnc_that_restarts_is_no_second_master() {
    let mut node = disengaged_node();
    send_control_sequence((0..50).map(|_| (Interface::Can, Control::ENGAGED)), &mut node);
    for _ in 0..2 {
        send_control_sequence((0..150).map(|_| (Interface::Can, Control::ENGAGED)), &mut node);
        assert_eq!(state(&node).0, 0);
        assert_eq!(node.last_output().quality, OffsetQuality::Live);
    }
}

#[test]
fn a_zero_that_is_refused_is_reported() {
    for control in [Control { referenced: false, ..Control::ENGAGED }, Control::default()] {
        let mut node = disengaged_node();
        send_control_sequence([(Interface::Can, control); 20], &mut node);
        node.receiver = CncReceiver::new();
        for counter in 0..3 {
            let zero = Control { zero: true, ..control };
            node.receive(Interface::Can, &frames::encode_control(zero, counter)).expect("whole");
        }
        assert_eq!(node.take_zero_outcome(), Some(ZeroOutcome::Unchanged));
        let sent_frames = (0..100).filter_map(|_| {
            node.tick(1, TickInput { codes: Some(&live_codes(700)), ..TickInput::default() });
            node.next_service_frame()
        });
        let codes: Vec<_> = sent_frames
            .filter(|frame| frame.id() == trueup_link::layout::EMERGENCY_ID)
            .map(|frame| u16::from_le_bytes([frame.data()[0], frame.data()[1]]))
            .collect();
        assert!(codes.contains(&Fault::ZeroRefused.code()), "{codes:04X?}");
    }
}

#[test]
fn a_supply_that_drifts_changes_no_offset_and_one_that_is_broken_is_reported_and_not_believed() {
    // The sensor stays where it is; the supply falls by 2 %, and by 5 %: codes rise by as much.
    let mut node = disengaged_node();
    let run = |node: &mut Node<'_>, percent: u16| {
        let code = |code: u16| AdcCode(code + code / 100 * percent);
        let mut counter = 3;
        for ms in 0..4_000 {
            let mean = code(700).0;
            let codes = core::array::from_fn(|n| AdcCode(mean + u16::from(n % 2 == 0)));
            if ms % 20 == 0 {
                node.receive(Interface::Can, &frames::encode_control(Control::ENGAGED, counter))
                    .ok();
                counter = counter.wrapping_add(1);
            }
            if ms % 10 == 0 {
                node.receive_supply_code(code(1_500));
            }
            node.tick(1, TickInput { codes: Some(&codes), ..TickInput::default() });
            node.next_service_frame();
        }
        (node.state.elongation(), node.board_faults.contains(Fault::SupplyOff))
    };
    let (Some(before), false) = run(&mut node, 0) else { panic!("the sensor is read") };
    let (Some(drifted), false) = run(&mut node, 2) else { panic!("2 % are corrected") };
    // 700 codes are 85 µm, of which 2 % would be 1.7 µm; half a code is 61 nm.
    assert!((drifted.0 - before.0).abs() < 70, "{before:?} {drifted:?}");
    assert_eq!(run(&mut node, 5), (None, true));
    assert!(node.last_output().flags.0 & OffsetFlags::SENSOR_FAULT.0 != 0);
    assert!(run(&mut node, 0).0.is_some(), "and it comes back");
}
