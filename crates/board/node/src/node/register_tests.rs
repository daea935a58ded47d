//! A PLC on the RS-485 line: it engages by the rules of CAN, its faults move nothing, and no block is half old.

use std::{vec, vec::Vec};
use trueup_core::{
    bridge::TickInput,
    cnc::{
        AxisPosition, CncMessage, Control, LinearAxis, MachineConditions, OffsetFlags,
        OffsetQuality, RotaryAxisAngles, SpindleState, TravelDirection,
    },
    units::{AdcCode, MicroDegrees, Position, Rpm},
};
use trueup_link::{frames, status::StateBits};
use trueup_modbus::{
    holding_block::{self, CncData, HoldingBlock},
    input_block,
    rtu::{FrameTiming, Slave},
    server::{RegisterStore, RegistersBusy, ResponseBuffer},
};

use super::*;
use crate::node::sensor_only_calibration;

fn control_block(control: Control, counter: u16) -> holding_block::HoldingRegisters {
    CncData { control, ..CncData::default() }.encode(counter)
}

/// Lets this many milliseconds pass with a sensor at this code.
fn run_for_ms(node: &mut Node<'_>, ms: u32, code: u16) {
    for n in 0..ms {
        let noise = core::array::from_fn(|i| AdcCode(code + u16::from((n as usize + i) % 2 == 1)));
        node.tick(1, TickInput { codes: Some(&noise), ..TickInput::default() });
        node.next_service_frame();
    }
}

/// Returns a node whose PLC has sent this, a block each 20 ms; the counter of the next one.
fn send_control_blocks(node: &mut Node<'_>, controls: &[Control], first: u16) -> u16 {
    let mut counter = first;
    for control in controls {
        assert_eq!(node.receive_registers(&control_block(*control, counter)), Ok(()));
        counter = counter.wrapping_add(1);
        run_for_ms(node, 20, 700);
    }
    counter
}

fn engaged_node() -> (Node<'static>, u16) {
    let mut calibration = sensor_only_calibration();
    // 1 µm in a millisecond.
    calibration.limits.slew_nm_per_s = 1_000_000;
    let mut node = Node::new(calibration.into());
    let counter = send_control_blocks(&mut node, &[Control::REFERENCED; 4], 0xFFF8);
    let counter = send_control_blocks(&mut node, &[Control::ENGAGED; 60], counter);
    assert_eq!(node.last_output().quality, OffsetQuality::Live);
    (node, counter)
}

fn state(node: &Node<'_>) -> StateBits {
    StateBits(node.input_block().state)
}

#[test]
fn a_plc_engages_by_the_sequence_and_a_plc_that_falls_silent_is_a_lost_cnc() {
    let (on, off) = (Control::ENGAGED, Control::REFERENCED);
    for (received, is_available) in
        [(vec![on; 20], false), (vec![off, off, on, on], false), (vec![off, off, off, on], true)]
    {
        let mut node = Node::new(sensor_only_calibration().into());
        send_control_blocks(&mut node, &received, 7);
        assert_eq!(node.last_output().offset.is_some(), is_available, "{received:?}");
        assert_eq!(state(&node).contains(StateBits::RESTARTED), !is_available);
    }
    let (mut node, _) = engaged_node();
    let qualities: Vec<OffsetQuality> = (0..4_000)
        .map(|_| {
            run_for_ms(&mut node, 1, 700);
            node.last_output().quality
        })
        .collect();
    let mut course = qualities.clone();
    course.dedup();
    assert_eq!(course[..2], [OffsetQuality::Live, OffsetQuality::Hold], "{course:?}");
    // The link timeout of 500 ms, of which 20 had passed before.
    assert_eq!(qualities.iter().filter(|quality| **quality == OffsetQuality::Live).count(), 480);
    assert_eq!(course.last(), Some(&OffsetQuality::Off));
}

#[test]
fn blocks_that_are_damaged_repeated_or_jump_are_counted_and_move_nothing() {
    let (mut node, counter) = engaged_node();
    let before = *node.last_output();
    assert!(before.offset.is_some_and(|all| all[2].0.abs() > 1_000), "{before:?}");
    let mut damaged = control_block(Control::default(), counter);
    damaged[1] ^= 1;
    for (bad, reason) in [
        (damaged, 2),
        (control_block(Control::default(), counter.wrapping_sub(1)), 3),
        (control_block(Control::default(), counter.wrapping_add(900)), 4),
    ] {
        assert_eq!(node.receive_registers(&bad), Ok(()), "it is acknowledged");
        assert_eq!(node.input_block().last_refused, reason);
        run_for_ms(&mut node, 20, 700);
        let moved = [node.last_output(), &before].map(|output| output.offset.expect("live")[2].0);
        assert!(
            moved[0].abs_diff(moved[1]) < 100,
            "it is off by that if it is followed: {moved:?}"
        );
        assert_eq!(node.last_output().quality, OffsetQuality::Live);
    }
    assert_eq!(node.input_block().refused, 3);
    // As on CAN, three that are whole and out of order within 2.4 s are two masters.
    assert!(!state(&node).contains(StateBits::SECOND_MASTER));
    node.receive_registers(&control_block(Control::default(), counter)).expect("acknowledged");
    run_for_ms(&mut node, 2, 700);
    assert!(state(&node).contains(StateBits::SECOND_MASTER));
}

#[test]
fn a_plc_next_to_a_cnc_on_can_is_busy_and_reported_and_noise_is_not() {
    let mut node = Node::new(sensor_only_calibration().into());
    let can = |node: &mut Node<'_>, control, counter| {
        node.receive(Interface::Can, &frames::encode_control(control, counter)).expect("in order");
        run_for_ms(node, 20, 700);
    };
    (0..4).for_each(|n| can(&mut node, Control::REFERENCED, n));
    (4..30).for_each(|n| can(&mut node, Control::ENGAGED, n));
    for (damage, is_reported) in [(1, false), (0, true)] {
        for n in 30..40 {
            let mut theirs = control_block(Control::default(), n);
            theirs[5] ^= damage;
            assert_eq!(node.receive_registers(&theirs), Err(RegistersBusy));
            can(&mut node, Control::ENGAGED, n.to_le_bytes()[0] + if is_reported { 10 } else { 0 });
        }
        assert_eq!(state(&node).contains(StateBits::SECOND_MASTER), is_reported);
        assert_eq!(node.last_output().quality, OffsetQuality::Live);
    }
    assert_eq!(node.input_block().refused, 0);
}

/// Returns a block of a control that says all it can, at this place.
fn full_control_block(counter: u16, place: i32) -> holding_block::HoldingRegisters {
    let at = |axis| {
        let position = Position(100_000 * place);
        Some(AxisPosition { axis, position, direction: TravelDirection::Positive })
    };
    let cnc_data = CncData {
        control: Control::ENGAGED,
        positions: LinearAxis::ALL.map(at),
        rotary: Some(RotaryAxisAngles { angles: [MicroDegrees(1_000 * place); 2] }),
        spindle: Some(SpindleState { speed: Rpm(12_000), load_n: 7 }),
        conditions: Some(MachineConditions { tool: 3, bits: 1 }),
    };
    cnc_data.encode(counter)
}

#[test]
fn a_block_taken_in_steps_ends_where_one_taken_at_once_does() {
    let ((mut at_once, mut counter), (mut in_steps, _)) = (engaged_node(), engaged_node());
    for n in 0..40 {
        let registers = full_control_block(counter, n.min(10));
        assert_eq!(at_once.receive_registers(&registers), Ok(()));
        run_for_ms(&mut at_once, 10, 700);
        let block = HoldingBlock::from_registers(&registers);
        assert_eq!(in_steps.receive_block(&block), Ok(true));
        let values: Vec<CncMessage> = block.commands().collect();
        assert_eq!(values.len(), 6, "all are there: {values:?}");
        for value in values {
            // A tick of the offset comes in between.
            run_for_ms(&mut in_steps, 1, 700);
            in_steps.receive_command(value);
        }
        run_for_ms(&mut in_steps, 4, 700);
        counter = counter.wrapping_add(1);
        assert_eq!(in_steps.holding_registers(), registers, "read back as it was written");
        assert_eq!(in_steps.last_output().quality, OffsetQuality::Live);
    }
    assert_eq!(in_steps.input_block(), at_once.input_block());
    assert!(!in_steps.last_output().flags.contains(OffsetFlags::SPEED_UNKNOWN));
}

#[test]
fn values_of_a_block_have_no_effect_once_another_line_has_the_master() {
    for (is_lost, is_unknown) in [(false, false), (true, true)] {
        let (mut node, counter) = engaged_node();
        let block = HoldingBlock::from_registers(&full_control_block(counter, 0));
        assert_eq!(node.receive_block(&block), Ok(true));
        if is_lost {
            run_for_ms(&mut node, 600, 700);
            node.receive(Interface::Can, &frames::encode_control(Control::REFERENCED, 0))
                .expect("in order");
        }
        block.commands().for_each(|value| node.receive_command(value));
        run_for_ms(&mut node, 2, 700);
        assert_eq!(node.last_output().flags.contains(OffsetFlags::SPEED_UNKNOWN), is_unknown);
    }
}

/// The node, as its slave reaches it.
struct NodeRegisterStore<'n>(&'n mut Node<'static>);

impl RegisterStore for NodeRegisterStore<'_> {
    fn input_registers(&mut self) -> input_block::InputRegisters {
        self.0.input_block().encode()
    }

    fn holding_registers(&mut self) -> holding_block::HoldingRegisters {
        self.0.holding_registers()
    }

    fn write_holding_registers(
        &mut self,
        block: &holding_block::HoldingRegisters,
    ) -> Result<(), RegistersBusy> {
        self.0.receive_registers(block)
    }
}

#[test]
fn of_100_000_polls_of_values_that_change_every_millisecond_none_is_half_old() {
    // Read input registers 0 to 27 of unit 1.
    const READ_INPUT_REGISTERS_REQUEST: [u8; 8] = [1, 4, 0, 0, 0, 28, 0xF1, 0xC3];
    let (mut node, mut counter) = engaged_node();
    let mut slave = Slave::new(1, FrameTiming::from_baud(115_200));
    let (mut response, mut now_us) = (ResponseBuffer::new(), 0_u32);
    let mut last = None;
    let mut changed = 0;
    for n in 0..100_000_u32 {
        for byte in READ_INPUT_REGISTERS_REQUEST {
            now_us = now_us.wrapping_add(96);
            slave.receive(now_us, byte);
        }
        now_us = now_us.wrapping_add(1_750);
        assert!(slave.poll(now_us, &mut NodeRegisterStore(&mut node), &mut response));
        let mut words = [0; 28];
        for (word, pair) in words.iter_mut().zip(response[3..59].as_chunks::<2>().0) {
            *word = u16::from_be_bytes(*pair);
        }
        let input_block = input_block::InputBlock::decode(&words).expect("a whole block");
        let round = |nanometres: trueup_core::units::Nanometres| {
            (nanometres.0.abs() + 5) / 10 * 10 * nanometres.0.signum()
        };
        let expected = node.last_output().offset.map(|all| all.map(round));
        assert_eq!(
            input_block.output.offset.map(|all| all.map(|nanometres| nanometres.0)),
            expected,
            "poll {n}"
        );
        assert_eq!(input_block.counter, (node.now().0 & 0xFFFF) as u16);
        assert_eq!(
            (input_block.output.quality, input_block.state),
            (OffsetQuality::Live, 0),
            "poll {n}"
        );
        changed += u32::from(last.replace(input_block.elongation) != Some(input_block.elongation));
        // Up and down again, not from one end to the other: that would be a jump, and reported.
        let step = n / 8 % 2_000;
        run_for_ms(&mut node, 1, 700 + step.min(2_000 - step) as u16);
        if n % 20 == 0 {
            node.receive_registers(&control_block(Control::ENGAGED, counter))
                .expect("no other sender is there");
            counter = counter.wrapping_add(1);
        }
    }
    assert!(changed > 50_000, "they change: {changed}");
}
