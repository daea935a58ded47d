//! Tests of frames that get through, that are refused, and of the counts.

use super::*;
use crate::{
    e2e,
    frames::{
        NmtState, encode_control, encode_heartbeat, encode_offset_xy, encode_offset_z,
        encode_position, encode_rotary, encode_spindle,
    },
    layout::{DIRECTION, QUALITY},
};
use proptest::prelude::*;
use std::string::ToString;
use trueup_core::{
    cnc::{
        AxisPosition, Control, OffsetFlags, OffsetQuality, RotaryAxisAngles, SpindleState,
        TravelDirection,
    },
    units::{MicroDegrees, Nanometres, Position, Rpm},
};

const TURNING: SpindleState = SpindleState { speed: Rpm(18_000), load_n: 120 };
const ENGAGED: Control = Control::ENGAGED;
/// Identifiers that a CNC sends.
const CNC: [u16; 7] =
    [POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID, ROTARY_ID, SPINDLE_ID, CONTROL_ID, CONDITIONS_ID];

fn output(cycle: u8) -> Output {
    let nm = i32::from(cycle) * 10;
    Output {
        offset: Some([nm, -nm, nm].map(Nanometres)),
        quality: OffsetQuality::Live,
        flags: OffsetFlags::NONE,
        age_ms: 1,
    }
}

fn damaged(frame: Frame) -> Frame {
    let mut data = *frame.data();
    data[4] ^= 0x10;
    Frame::new(frame.id(), &data).unwrap()
}

#[test]
fn commands_are_distinguished_and_each_has_its_own_sequence() {
    let mut receiver = CncReceiver::new();
    for counter in 0..=u8::MAX {
        let frame = encode_control(ENGAGED, counter);
        assert_eq!(receiver.accept(&frame), Ok(Some(CncMessage::Control(ENGAGED))));
        let frame = encode_spindle(TURNING, counter.wrapping_mul(3));
        assert_eq!(receiver.accept(&frame), Ok(Some(CncMessage::Spindle(TURNING))));
    }
    let expected = FrameCounters { accepted: 512, lost: 255 * 2, ..FrameCounters::default() };
    assert_eq!(receiver.counters(), expected);
}

fn at(axis: LinearAxis, position: i32) -> AxisPosition {
    AxisPosition { axis, position: Position(position), direction: TravelDirection::Positive }
}

#[test]
fn each_axis_and_the_rotary_pair_has_its_own_sequence() {
    let mut receiver = CncReceiver::new();
    let turned = RotaryAxisAngles { angles: [90_000_000, -45_000_000].map(MicroDegrees) };
    for step in 0..=u8::MAX {
        for (axis, stride) in LinearAxis::ALL.into_iter().zip([1, 3, 5]) {
            let there = at(axis, i32::from(step) * 1_000 - 64_000);
            let frame = encode_position(there, step.wrapping_mul(stride));
            assert_eq!(receiver.accept(&frame), Ok(Some(CncMessage::Position(there))));
        }
        let frame = encode_rotary(turned, step.wrapping_mul(7));
        assert_eq!(receiver.accept(&frame), Ok(Some(CncMessage::Rotary(turned))));
    }
    let lost = 255 * (2 + 4 + 6);
    let expected = FrameCounters { accepted: 4 * 256, lost, ..FrameCounters::default() };
    assert_eq!(receiver.counters(), expected);
}

#[test]
fn the_frame_of_one_axis_under_the_identifier_of_another_is_refused() {
    let mut receiver = CncReceiver::new();
    let x = encode_position(at(LinearAxis::X, 5), 0);
    let moved = Frame::new(POSITION_Y_ID, x.data()).unwrap();
    let refused = receiver.accept(&moved).unwrap_err();
    assert!(matches!(refused, ReceiveError::E2e(E2eError::Crc { .. })));
    assert_eq!(receiver.counters().crc_errors, 1);
}

#[test]
fn a_direction_without_meaning_is_refused_although_its_protection_holds() {
    let mut receiver = CncReceiver::new();
    let mut data = *encode_position(at(LinearAxis::Z, 5), 0).data();
    DIRECTION.insert(&mut data, -2);
    e2e::protect(POSITION_Z_ID, 0, &mut data);
    let refused = receiver.accept(&Frame::new(POSITION_Z_ID, &data).unwrap());
    assert!(matches!(refused, Err(ReceiveError::Decode(DecodeError::Value { raw: -2, .. }))));
    assert_eq!(receiver.counters().malformed, 1);
}

#[test]
fn frames_for_others_are_passed_over_and_not_counted() {
    let mut receiver = CncReceiver::new();
    for frame in [encode_offset_xy(&output(0), 0), encode_heartbeat(NmtState::Operational)] {
        assert_eq!(receiver.accept(&frame), Ok(None));
    }
    assert_eq!(receiver.counters(), FrameCounters::default());
}

#[test]
fn every_kind_of_fault_is_refused_and_counted_once() {
    let mut receiver = CncReceiver::new();
    let frame = encode_control(ENGAGED, 7);
    receiver.accept(&frame).unwrap();
    let refused = receiver.accept(&damaged(frame)).unwrap_err();
    assert!(matches!(refused, ReceiveError::E2e(E2eError::Crc { .. })));
    let refused = receiver.accept(&frame).unwrap_err();
    assert_eq!(refused, ReceiveError::E2e(E2eError::Repeated { counter: 7 }));
    let short = Frame::new(CONTROL_ID, &frame.payload()[..7]).unwrap();
    let refused = receiver.accept(&short).unwrap_err();
    assert!(matches!(refused, ReceiveError::Decode(DecodeError::Length { .. })));
    let expected =
        FrameCounters { accepted: 1, malformed: 1, crc_errors: 1, sequence_errors: 1, lost: 0 };
    assert_eq!(receiver.counters(), expected);
}

#[test]
fn only_a_frame_that_is_whole_and_out_of_sequence_speaks_of_a_second_sender() {
    let mut receiver = CncReceiver::new();
    let mut is_sound =
        |frame: Frame| receiver.accept(&frame).err().map(|refused| refused.is_sequence_error());
    let sent = encode_control(ENGAGED, 7);
    assert_eq!(is_sound(sent), None);
    assert_eq!(is_sound(sent), Some(true), "repeated");
    assert_eq!(is_sound(encode_control(ENGAGED, 207)), Some(true), "out of sequence");
    assert_eq!(is_sound(Frame::new(CONTROL_ID, &sent.payload()[..7]).unwrap()), Some(false));
    // Noise, until nothing is trusted: then a whole frame in order says no more than that it is late.
    for _ in 0..8 {
        assert_eq!(is_sound(damaged(sent)), Some(false), "damaged");
    }
    assert_eq!(is_sound(encode_control(ENGAGED, 208)), Some(false), "not trusted yet");
}

#[test]
fn a_restarted_cnc_is_received_again_with_its_second_frame() {
    let mut receiver = CncReceiver::new();
    receiver.accept(&encode_control(ENGAGED, 100)).unwrap();
    let (last, counter) = (100, 0);
    let refused = receiver.accept(&encode_control(ENGAGED, counter)).unwrap_err();
    assert_eq!(refused, ReceiveError::E2e(E2eError::WrongSequence { last, counter }));
    let received = receiver.accept(&encode_control(ENGAGED, 1));
    assert_eq!(received, Ok(Some(CncMessage::Control(ENGAGED))));
}

#[test]
fn a_cycle_comes_out_once_with_its_second_half_in_either_order() {
    let mut receiver = OffsetReceiver::new();
    for cycle in 0..=u8::MAX {
        let sent = output(cycle);
        let mut halves = [encode_offset_xy(&sent, cycle), encode_offset_z(&sent, cycle)];
        if cycle % 3 == 0 {
            halves.reverse();
        }
        assert_eq!(receiver.accept(&halves[0]), Ok(None));
        assert_eq!(receiver.accept(&halves[1]), Ok(Some(sent)));
    }
    assert_eq!(receiver.counters().accepted, 512);
    assert_eq!(receiver.unpaired_frame_count(), 0);
}

#[test]
fn halves_of_different_cycles_are_never_joined() {
    let mut receiver = OffsetReceiver::new();
    assert_eq!(receiver.accept(&encode_offset_xy(&output(1), 1)), Ok(None));
    assert_eq!(receiver.accept(&encode_offset_z(&output(2), 2)), Ok(None));
    assert_eq!(receiver.accept(&encode_offset_xy(&output(3), 3)), Ok(None));
    assert_eq!(receiver.accept(&encode_offset_z(&output(3), 3)), Ok(Some(output(3))));
    assert_eq!(receiver.unpaired_frame_count(), 2);
    assert_eq!(receiver.counters().lost, 1);
}

#[test]
fn a_damaged_half_drops_its_cycle_alone() {
    let mut receiver = OffsetReceiver::new();
    assert_eq!(receiver.accept(&encode_offset_xy(&output(1), 1)), Ok(None));
    assert!(receiver.accept(&damaged(encode_offset_z(&output(1), 1))).is_err());
    assert_eq!(receiver.accept(&encode_offset_xy(&output(2), 2)), Ok(None));
    assert_eq!(receiver.accept(&encode_offset_z(&output(2), 2)), Ok(Some(output(2))));
    assert_eq!((receiver.counters().crc_errors, receiver.unpaired_frame_count()), (1, 1));
}

#[test]
fn a_repeated_cycle_is_not_given_out_again() {
    let mut receiver = OffsetReceiver::new();
    let halves = [encode_offset_xy(&output(1), 1), encode_offset_z(&output(1), 1)];
    for half in &halves {
        receiver.accept(half).unwrap();
    }
    for half in &halves {
        let refused = receiver.accept(half).unwrap_err();
        assert_eq!(refused, ReceiveError::E2e(E2eError::Repeated { counter: 1 }));
    }
}

#[test]
fn a_missing_offset_is_given_out_as_missing() {
    let mut receiver = OffsetReceiver::new();
    let sent = Output { offset: None, quality: OffsetQuality::Fault, ..output(0) };
    assert_eq!(receiver.accept(&encode_offset_xy(&sent, 0)), Ok(None));
    assert_eq!(receiver.accept(&encode_offset_z(&sent, 0)), Ok(Some(sent)));
}

#[test]
fn a_quality_without_meaning_is_refused_although_its_protection_holds() {
    let mut receiver = OffsetReceiver::new();
    let mut data = *encode_offset_z(&output(0), 0).data();
    QUALITY.insert(&mut data, 9);
    e2e::protect(OFFSET_Z_ID, 0, &mut data);
    let refused = receiver.accept(&Frame::new(OFFSET_Z_ID, &data).unwrap());
    assert!(matches!(refused, Err(ReceiveError::Decode(DecodeError::Value { raw: 9, .. }))));
    assert_eq!(receiver.counters().malformed, 1);
}

proptest! {
    #[test]
    fn whatever_is_lost_damaged_or_repeated_only_whole_new_cycles_come_out(
        fates in prop::collection::vec((0_u8..8, 0_u8..8), 1..300),
    ) {
        let mut receiver = OffsetReceiver::new();
        let mut newest = None;
        for (cycle, (xy, z)) in (0_u8..=255).cycle().zip(fates) {
            let sent = output(cycle);
            for (fate, frame) in [(xy, encode_offset_xy(&sent, cycle)), (z, encode_offset_z(&sent, cycle))] {
                let arriving: &[Frame] = match fate {
                    0 => &[],
                    1 => &[damaged(frame)],
                    2 => &[frame, frame],
                    _ => &[frame],
                };
                for frame in arriving {
                    if let Ok(Some(got)) = receiver.accept(frame) {
                        prop_assert_eq!(got, sent);
                        prop_assert_ne!(newest, Some(cycle));
                        newest = Some(cycle);
                    }
                }
            }
        }
    }
}

#[test]
fn what_a_cnc_sends_is_what_the_bridge_takes_as_a_command() {
    for id in 0..=Frame::MAX_ID {
        let mut receiver = CncReceiver::new();
        let is_taken = receiver.accept(&Frame::new(id, &[0; 8]).unwrap()) != Ok(None);
        assert_eq!(CncReceiver::is_cnc_frame_id(id), is_taken, "0x{id:03X}");
        assert_eq!(is_taken, CNC.contains(&id), "0x{id:03X}");
    }
}

#[test]
fn a_frame_that_is_not_trusted_yet_is_distinguished_from_one_that_is_wrong() {
    let error = E2eError::Repeated { counter: 4 };
    let length = DecodeError::Length { expected: 8, found: 7 };
    assert_eq!(ReceiveError::E2e(error).to_string(), error.to_string());
    assert_eq!(ReceiveError::Decode(length).to_string(), length.to_string());
    let message = "not trusted yet: before it, counter 4 is repeated";
    assert_eq!(ReceiveError::Untrusted(error).to_string(), message);
}
