//! Every frame both ways, and what is refused.

use super::*;
use proptest::prelude::*;
use std::string::ToString;

fn output(offset_nm: Option<[i32; 3]>, quality: OffsetQuality, flags: u8, age_ms: u8) -> Output {
    Output {
        offset: offset_nm.map(|nm| nm.map(Nanometres)),
        quality,
        flags: OffsetFlags(flags),
        age_ms,
    }
}

fn hex(digits: u64) -> [u8; 8] {
    digits.to_be_bytes()
}

// The bytes of the `matches_other_tools` tests come from cantools (strict) for the signals
// and from autosar-e2e for the protection, each reading trueup.dbc.

#[test]
fn offset_frames_match_other_tools() {
    let nothing = output(Some([0; 3]), OffsetQuality::Off, 0, 0);
    assert_eq!(encode_offset_xy(&nothing, 0).data(), &hex(0xb609_0000_0000_0000));
    let some = output(Some([12_340, -56_780, -77_010]), OffsetQuality::Live, 0x22, 1);
    assert_eq!(encode_offset_xy(&some, 7).data(), &hex(0x7ce6_07d2_0420_9dfe));
    assert_eq!(encode_offset_z(&some, 7).data(), &hex(0x2cef_07eb_e11f_2201));
    let ends = output(Some([5_242_870, -5_242_870, 0]), OffsetQuality::Off, 0, 0);
    assert_eq!(encode_offset_xy(&ends, 255).data(), &hex(0xe334_ffff_ff17_0080));
    let missing = output(None, OffsetQuality::Fault, 0x88, 255);
    assert_eq!(encode_offset_xy(&missing, 1).data(), &hex(0x1277_0100_0008_0080));
    assert_eq!(encode_offset_z(&missing, 1).data(), &hex(0x6ff2_0100_0068_88ff));
}

#[test]
fn command_frames_match_other_tools() {
    let cutting = SpindleState { speed: Rpm(24_000), load_n: -1_500 };
    assert_eq!(encode_spindle(cutting, 3).data(), &hex(0xfd81_03c0_5d24_fa00));
    let ends = SpindleState { speed: Rpm(u16::MAX), load_n: i16::MAX };
    assert_eq!(encode_spindle(ends, 4).data(), &hex(0x8945_04ff_ffff_7f00));
    let run = Control::ENGAGED;
    assert_eq!(encode_control(run, 9).data(), &hex(0xb4e6_0903_0000_0000));
    let zero = Control { zero: true, ..Control::default() };
    assert_eq!(encode_control(zero, 10).data(), &hex(0x8537_0a04_0000_0000));
}

fn at(axis: LinearAxis, position: i32, direction: TravelDirection) -> AxisPosition {
    AxisPosition { axis, position: Position(position), direction }
}

fn angles(first: i32, second: i32) -> RotaryAxisAngles {
    RotaryAxisAngles { angles: [first, second].map(MicroDegrees) }
}

#[test]
fn position_frames_match_other_tools() {
    let x = at(LinearAxis::X, 123_456_789, TravelDirection::Positive);
    assert_eq!(encode_position(x, 5).data(), &hex(0x8c4b_0515_cd5b_0701));
    let y = at(LinearAxis::Y, -1_500_000_001, TravelDirection::Negative);
    assert_eq!(encode_position(y, 200).data(), &hex(0xc3f3_c8ff_d097_a603));
    let z = at(LinearAxis::Z, i32::MIN, TravelDirection::Standing);
    assert_eq!(encode_position(z, 0).data(), &hex(0xb39f_0000_0000_8000));
    let end = at(LinearAxis::Z, i32::MAX, TravelDirection::Positive);
    assert_eq!(encode_position(end, 255).data(), &hex(0x0edc_ffff_ffff_7f01));
    // 90° and -33.3335°; both ends.
    assert_eq!(
        encode_rotary(angles(90_000_000, -33_333_500), 17).data(),
        &hex(0x83a7_1120_bf52_b9ef)
    );
    let ends = angles(-262_144_000, 262_143_500);
    assert_eq!(encode_rotary(ends, 18).data(), &hex(0x5962_1200_00f8_ff7f));
}

#[test]
fn angles_round_half_away_from_zero_and_saturate_at_their_20_bits() {
    for (sent, came) in [
        (0, 0),
        (249, 0),
        (250, 500),
        (-249, 0),
        (-250, -500),
        (-749, -500),
        (-750, -1_000),
        (262_143_749, 262_143_500),
        (262_143_750, 262_143_500),
        (-262_144_250, -262_144_000),
        (i32::MAX, 262_143_500),
        (i32::MIN, -262_144_000),
    ] {
        let frame = encode_rotary(angles(sent, 0), 0);
        assert_eq!(decode_rotary(&frame), Ok(angles(came, 0)), "{sent} micro-degrees");
    }
}

#[test]
fn a_direction_that_is_none_is_refused() {
    let mut data = *encode_position(at(LinearAxis::Y, 1, TravelDirection::Standing), 0).data();
    DIRECTION.insert(&mut data, -2);
    let error = decode_position(LinearAxis::Y, &Frame::from_data(POSITION_Y_ID, data));
    assert_eq!(error, Err(DecodeError::Value { signal: "Direction", raw: -2 }));
}

#[test]
fn the_position_of_one_axis_is_none_of_another() {
    for axis in LinearAxis::ALL {
        let frame = encode_position(at(axis, -5, TravelDirection::Positive), 3);
        for expected in LinearAxis::ALL {
            let is_same = expected == axis;
            assert_eq!(decode_position(expected, &frame).is_ok(), is_same, "{axis:?}");
        }
    }
}

#[test]
fn heartbeats_match_other_tools() {
    assert_eq!(encode_heartbeat(NmtState::BootUp).payload(), [0x00]);
    assert_eq!(encode_heartbeat(NmtState::Operational).payload(), [0x05]);
    assert_eq!(encode_heartbeat(NmtState::PreOperational).payload(), [0x7F]);
}

#[test]
fn offsets_round_half_away_from_zero_and_saturate_short_of_the_missing_value() {
    for (nm, raw) in [
        (0, 0),
        (4, 0),
        (5, 1),
        (14, 1),
        (15, 2),
        (-4, 0),
        (-5, -1),
        (-15, -2),
        (5_242_874, 524_287),
        (5_242_875, 524_287),
        (-5_242_875, -524_287),
        (-5_242_885, -524_287),
        (i32::MAX, 524_287),
        (i32::MIN, -524_287),
    ] {
        assert_eq!(offset_to_raw(Nanometres(nm)), raw, "{nm} nm");
    }
}

#[test]
fn one_missing_half_makes_x_and_y_missing() {
    for signal in [OFFSET_X, OFFSET_Y] {
        let mut data = [0; 8];
        signal.insert(&mut data, NO_OFFSET_RAW);
        let frame = Frame::from_data(OFFSET_XY_ID, data);
        assert_eq!(decode_offset_xy(&frame), Ok(OffsetXy { offset: None }));
    }
}

#[test]
fn the_reserved_bit_of_a_heartbeat_is_ignored() {
    let frame = Frame::from_byte(HEARTBEAT_ID, 0x85);
    assert_eq!(decode_heartbeat(&frame), Ok(NmtState::Operational));
}

#[test]
fn another_identifier_length_or_value_is_refused_with_what_was_found() {
    let frame = encode_control(Control::default(), 0);
    assert_eq!(
        decode_spindle(&frame),
        Err(DecodeError::Identifier { expected: SPINDLE_ID, found: CONTROL_ID })
    );
    let short = Frame::new(CONTROL_ID, &[0; 7]).unwrap();
    assert_eq!(decode_control(&short), Err(DecodeError::Length { expected: 8, found: 7 }));
    for raw in 7..16 {
        let mut data = [0; 8];
        QUALITY.insert(&mut data, raw);
        let error = decode_offset_z(&Frame::from_data(OFFSET_Z_ID, data)).unwrap_err();
        let signal = "Quality";
        assert_eq!(error, DecodeError::Value { signal, raw });
    }
    let error = decode_heartbeat(&Frame::from_byte(HEARTBEAT_ID, 1)).unwrap_err();
    let signal = "State";
    assert_eq!(error, DecodeError::Value { signal, raw: 1 });
}

proptest! {
    #[test]
    fn offsets_come_back_to_the_nearest_10_nm(
        nm in prop::option::of(prop::array::uniform3(-5_242_870..=5_242_870)),
        quality in 0_u8..=6, flags: u8, age_ms: u8, count: u8,
    ) {
        let sent = output(nm, OffsetQuality::from_wire(quality).unwrap(), flags, age_ms);
        let (first, second) = (encode_offset_xy(&sent, count), encode_offset_z(&sent, count));
        prop_assert_eq!((e2e_counter(&first), e2e_counter(&second)), (count, count));
        let xy = decode_offset_xy(&first).unwrap();
        let z = decode_offset_z(&second).unwrap();
        prop_assert_eq!((z.quality, z.flags, z.age_ms), (sent.quality, sent.flags, age_ms));
        prop_assert_eq!(xy.offset.is_some(), nm.is_some());
        prop_assert_eq!(z.offset.is_some(), nm.is_some());
        if let (Some(nm), Some([x, y]), Some(z)) = (nm, xy.offset, z.offset) {
            for (sent, came) in nm.into_iter().zip([x, y, z]) {
                prop_assert!((sent - came.0).abs() <= 5);
                prop_assert_eq!(came.0 % 10, 0);
            }
        }
    }

    #[test]
    fn commands_come_back_whole(speed: u16, load_n: i16, bits in 0_u8..32, part in 0_u8..8, count: u8) {
        let sent = SpindleState { speed: Rpm(speed), load_n };
        prop_assert_eq!(decode_spindle(&encode_spindle(sent, count)), Ok(sent));
        let sent = MachineConditions { tool: speed, bits: load_n.cast_unsigned() };
        prop_assert_eq!(decode_conditions(&encode_conditions(sent, count)), Ok(sent));
        let sent = Control {
            engage: bits & 1 != 0,
            referenced: bits & 2 != 0,
            zero: bits & 4 != 0,
            service: bits & 8 != 0,
            confirm: bits & 16 != 0,
            learned: LearnedChangeRequest { part, amount: load_n, calibration: speed },
        };
        prop_assert_eq!(decode_control(&encode_control(sent, count)), Ok(sent));
    }

    #[test]
    fn positions_come_back_whole_and_angles_to_the_nearest_half_millidegree(
        place: i32, heading in -1_i8..=1, axis in 0_usize..3, count: u8,
        sent in prop::array::uniform2(-262_144_249..=262_143_749),
    ) {
        let axis = LinearAxis::ALL[axis];
        let there = at(axis, place, TravelDirection::from_wire(heading).unwrap());
        let frame = encode_position(there, count);
        prop_assert_eq!(e2e_counter(&frame), count);
        prop_assert_eq!(decode_position(axis, &frame), Ok(there));
        let came = decode_rotary(&encode_rotary(angles(sent[0], sent[1]), count)).unwrap();
        for (sent, MicroDegrees(came)) in sent.into_iter().zip(came.angles) {
            prop_assert!((sent - came).abs() <= MICRO_DEGREES_PER_BIT / 2);
            prop_assert_eq!(came % MICRO_DEGREES_PER_BIT, 0);
        }
    }

    #[test]
    fn no_frame_makes_a_decoder_panic(id in 0_u16..0x800, data: [u8; 8], len in 0_usize..=8) {
        let ours = [
            id, OFFSET_XY_ID, OFFSET_Z_ID, HEARTBEAT_ID, SPINDLE_ID, CONTROL_ID,
            POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID, ROTARY_ID,
            CONDITIONS_ID,
        ];
        for id in ours {
            let frame = Frame::new(id, &data[..len]).unwrap();
            let _ = decode_offset_xy(&frame);
            let _ = decode_offset_z(&frame);
            let _ = decode_heartbeat(&frame);
            let _ = decode_spindle(&frame);
            let _ = decode_control(&frame);
            let _ = decode_conditions(&frame);
            let _ = decode_rotary(&frame);
            for axis in LinearAxis::ALL {
                let _ = decode_position(axis, &frame);
            }
        }
    }
}

#[test]
fn why_a_frame_cannot_be_read_is_reported_with_what_was_found_and_what_should_be() {
    for (error, message) in [
        (
            DecodeError::Identifier { expected: 0x81, found: 0x302 },
            "identifier is 0x302, should be 0x081",
        ),
        (DecodeError::Length { expected: 8, found: 5 }, "frame has 5 bytes, should have 8"),
        (DecodeError::Value { signal: "Direction", raw: -2 }, "Direction -2 has no meaning"),
    ] {
        assert_eq!(error.to_string(), message);
    }
}
