//! Tests of the inputs: frames as often as the wire has them, each fault in its phase alone, and their checksum.

use super::*;
use crate::node::sensor_only_calibration;
use std::vec::Vec;
use trueup_link::{
    e2e,
    frames::{CONTROL_ID, POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID, ROTARY_ID, SPINDLE_ID},
};

const PHASE_MS: u32 = 1 << PHASE_MS_LOG2;

fn run(faults: bool) -> TestVectorRunner<'static> {
    TestVectorRunner::new(sensor_only_calibration(), 1, faults)
}

#[test]
fn the_numbers_are_marsaglias_and_the_checksum_is_that_of_fowler_noll_and_vo() {
    let mut random = XorShift32::new(0);
    let first = [(); 4].map(|()| random.next_u32());
    assert_eq!(first, [270_369, 67_634_689, 2_647_435_461, 307_599_695]);
    let mut run = run(false);
    assert_eq!(run.checksum(), 0xcbf2_9ce4_8422_2325);
    run.update_checksum(&[Frame::from_data(0x123, [1, 2, 3, 4, 5, 6, 7, 8])]);
    assert_eq!(run.checksum(), 0x0a0c_d3d1_1062_7a83);
    run.update_checksum(&[Frame::new(0x123, &[0xFF]).expect("a byte")]);
    assert_eq!(run.checksum(), 0xce99_20c0_5062_b9c9);
}

#[test]
fn each_fault_has_every_other_phase_of_four_seconds_in_turn() {
    assert_eq!(VECTORS_PER_FAULT_CYCLE, 6 * 2 * 4_096, "six, with a phase before each");
    for phase in 0..2 * INJECTED_FAULT_COUNT {
        let expected = if phase % 2 == 0 {
            InjectedFault::None
        } else {
            INJECTED_FAULT_SEQUENCE[phase as usize / 2]
        };
        for ms in [0, 1, PHASE_MS / 2, PHASE_MS - 1] {
            for round in [0, VECTORS_PER_FAULT_CYCLE] {
                assert_eq!(
                    InjectedFault::from_vector_index(round + phase * PHASE_MS + ms),
                    expected,
                    "{phase}, {ms} ms"
                );
            }
        }
    }
}

/// Returns the frames of a phase that have this identifier.
fn count(sent: &[Frame], id: u16) -> u32 {
    u32::try_from(sent.iter().filter(|frame| frame.id() == id).count()).expect("a few")
}

#[test]
fn each_frame_comes_as_often_as_the_wire_has_it_but_for_those_that_a_fault_leaves_out() {
    for faults in [false, true] {
        let mut run = run(faults);
        for phase in 0..2 * INJECTED_FAULT_COUNT {
            let mut sent = Vec::new();
            for _ in 0..PHASE_MS {
                run.draw_vector();
                sent.extend(run.sent.iter().copied());
            }
            let fault = if faults {
                InjectedFault::from_vector_index(phase * PHASE_MS)
            } else {
                InjectedFault::None
            };
            let mut kinds = [
                (ROTARY_ID, ROTARY_PERIOD_MS, InjectedFault::NoAngles),
                (SPINDLE_ID, CONTROL_PERIOD_MS, InjectedFault::SilentCnc),
                (CONTROL_ID, CONTROL_PERIOD_MS, InjectedFault::SilentCnc),
            ]
            .to_vec();
            kinds.extend(
                [POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID]
                    .map(|id| (id, POSITION_PERIOD_MS, InjectedFault::NoPositions)),
            );
            for (id, period_ms, held_out) in kinds {
                let expected = if fault == held_out { 0 } else { PHASE_MS / period_ms };
                // A phase begins and ends between two frames.
                let apart = count(&sent, id).abs_diff(expected);
                assert!(apart <= 1, "0x{id:03X} in {fault:?}: {apart} more or less");
            }
        }
    }
}

#[test]
fn engage_is_let_go_in_its_fault_alone_and_zero_is_asked_for_200_ms_at_the_begin_of_each_phase() {
    for faults in [false, true] {
        let mut run = run(faults);
        for number in 1..VECTORS_PER_FAULT_CYCLE {
            run.draw_vector();
            let control = run.sent.iter().find_map(|frame| frames::decode_control(frame).ok());
            let Some(control) = control else { continue };
            let lets_go =
                faults && InjectedFault::from_vector_index(number) == InjectedFault::Disengaged;
            let zero = faults && number % PHASE_MS < 200;
            // What is damaged is elsewhere in the frame.
            let flags = (control.engage, control.zero, control.referenced);
            assert_eq!(flags, (!lets_go, zero, true), "in vector {number}");
        }
    }
}

#[test]
fn of_a_hundred_and_twenty_eight_frames_one_is_damaged_in_one_bit_and_without_faults_none() {
    for faults in [false, true] {
        let mut run = run(faults);
        let (mut all, mut damaged) = (0_u32, 0_u32);
        for _ in 0..VECTORS_PER_FAULT_CYCLE {
            run.draw_vector();
            for frame in &run.sent {
                all += 1;
                if !e2e::has_valid_crc(frame) {
                    damaged += 1;
                    let mut data = *frame.data();
                    data[7] ^= 0x40;
                    assert!(e2e::has_valid_crc(&Frame::from_data(frame.id(), data)));
                }
            }
        }
        // ±4 σ of the 1,000 that are expected of 128,000 are 126.
        let expected = if faults { all / 128 } else { 0 };
        assert!(damaged.abs_diff(expected) <= expected / 8, "{damaged} of {all}");
    }
}

#[test]
fn an_axis_walks_the_way_that_it_says_and_jumps_now_and_then() {
    let mut run = run(false);
    let mut before = [None; 3];
    let (mut walks, mut jumps) = (0_u32, 0_u32);
    for _ in 0..VECTORS_PER_FAULT_CYCLE {
        run.draw_vector();
        for (number, axis) in LinearAxis::ALL.into_iter().enumerate() {
            let received =
                run.sent.iter().find_map(|frame| frames::decode_position(axis, frame).ok());
            let Some(received) = received else { continue };
            if let Some(before) = before[number].replace(received.position.0) {
                let way = received.position.0 - before;
                let is_walk = way.abs() <= 50_000;
                (walks, jumps) = (walks + u32::from(is_walk), jumps + u32::from(!is_walk));
                let heads = received.direction as i32;
                // At the end of its reach it is held.
                assert!(!is_walk || way == 0 || way.signum() == heads, "{way}, but {heads}");
            }
        }
    }
    let (all, share) = (walks + jumps, (walks + jumps) / 16);
    assert!(jumps.abs_diff(share) <= share / 8, "{jumps} jumps of {all}");
}

#[test]
fn thermometers_warm_by_a_tenth_of_a_kelvin_at_most_within_their_range() {
    let mut run = run(true);
    let mut before: Option<RawTemperatures> = None;
    for number in 1..VECTORS_PER_FAULT_CYCLE {
        run.draw_vector();
        let is_missing = InjectedFault::from_vector_index(number) == InjectedFault::NoTemperatures;
        if is_missing {
            assert_eq!(run.temperatures, [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT]);
            before = None;
            continue;
        }
        for (channel, raw) in run.temperatures.iter().enumerate() {
            // In a kelvin: 0.385 Ω, and 1.99 codes of 256.
            let [cold, per_kelvin] =
                if channel == 1 { [137_403, 509] } else { [107_793_500, 385_000] };
            assert!((cold..=cold + 40 * per_kelvin).contains(&raw.0), "{raw:?} on {channel}");
            if let Some(before) = before {
                let moved = raw.0.abs_diff(before[channel].0);
                assert!(moved <= per_kelvin.unsigned_abs() / 10 + 1, "{moved} on {channel}");
            }
        }
        before = Some(run.temperatures);
    }
}

#[test]
fn the_checksum_of_a_run_is_of_every_frame_that_the_node_sends_with_faults_among_its_inputs() {
    let mut run = TestVectorRunner::new(sensor_only_calibration(), 0x7275_6574, true);
    for number in 0..300 {
        assert_eq!(compute_checksum(sensor_only_calibration(), number), run.checksum(), "{number}");
        run.draw_vector();
        run.receive();
        let frames = run.tick();
        run.update_checksum(&frames);
    }
}
