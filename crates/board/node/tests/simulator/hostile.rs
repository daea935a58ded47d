//! Blobs that are made to do harm: any bytes at all with a CRC that is right. They are refused
//! with the reason, or what they make the bridge do stays within the caps of the firmware.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{collections::BTreeMap, env};

use crc::{CRC_32_AUTOSAR, Crc};
use trueup_core::{
    bridge::TickInput,
    cnc::{
        AxisPosition, Control, LinearAxis, OffsetQuality, RotaryAxisAngles, SpindleState,
        TravelDirection,
    },
    design_parameters::CODES_PER_TICK,
    learned_changes::{LearnedChangeRequest, LearnedLimits, calibration_id},
    thermometer::RawTemperatureReading,
    units::{AdcCode, MicroDegrees, Position, Rpm},
};
use trueup_link::frames;
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface, Node},
    test_vectors::XorShift32,
};
use trueup_store::calibration::{
    MAX_BLOB_SIZE, MAX_HOLD_MS, MAX_LEARNED_LIMITS, MAX_LINK_TIMEOUT_MS, MAX_OFFSET_NM,
    MAX_SLEW_NM_PER_S, calibration_crc, decode, encode,
};

use crate::machine;

/// A slot of the board's flash.
type Slot = [u8; MAX_BLOB_SIZE];
/// How long a bridge lives on what was not refused, in ms: through the engage sequence and on its way.
const LIFE_MS: u8 = 130;

/// Makes the CRC right.
fn seal(blob: &mut [u8]) {
    let end = blob.len() - 4;
    let crc = Crc::<u32>::new(&CRC_32_AUTOSAR).checksum(&blob[..end]);
    blob[end..].copy_from_slice(&crc.to_le_bytes());
}

/// Returns a blob that is whole and has something wrong, or nothing.
fn hostile<'s>(random: &mut XorShift32, seeds: &[Vec<u8>], slot: &'s mut Slot) -> &'s mut [u8] {
    let seed = &seeds[random.next_below(seeds.len() as u32) as usize];
    slot[..seed.len()].copy_from_slice(seed);
    let blob = &mut slot[..seed.len()];
    for _ in 0..=random.next_below(4) {
        // The head of 8 bytes stays: what is wrong there is reported before anything is read.
        let at = 8 + random.next_below(blob.len() as u32 - 12) as usize;
        let word = 8 + (at - 8) / 4 * 4;
        match random.next_below(4) {
            0 => blob[at] ^= 1 << random.next_below(8),
            1 => blob[at] = random.next_u32() as u8,
            // Words at the ends of their range, and others.
            2 => {
                let ends = [0, 1, -1, i32::MAX, i32::MIN, 1 << 20, -(1 << 20), 255];
                let end = ends[random.next_below(8) as usize];
                blob[word..word + 4].copy_from_slice(&end.to_le_bytes());
            }
            _ => {
                let any = random.next_u32() >> random.next_below(32);
                blob[word..word + 4].copy_from_slice(&any.to_le_bytes());
            }
        }
    }
    seal(blob);
    blob
}

/// A bridge lives on this calibration, with any inputs, and stays within the caps.
fn lives_within_the_caps(random: &mut XorShift32, blob: &[u8], number: u64) -> bool {
    let calibration = decode(blob).expect("it was not refused");
    let limits = calibration.limits;
    assert!(limits.slew_nm_per_s <= MAX_SLEW_NM_PER_S, "blob {number}: {limits:?}");
    assert!(limits.link_timeout_ms <= MAX_LINK_TIMEOUT_MS, "blob {number}: {limits:?}");
    assert!(limits.hold_ms <= MAX_HOLD_MS, "blob {number}: {limits:?}");
    let LearnedLimits { growth, axes, zero } = limits.learned;
    let within = growth <= MAX_LEARNED_LIMITS.growth && axes <= MAX_LEARNED_LIMITS.axes;
    assert!(within && zero <= MAX_LEARNED_LIMITS.zero, "blob {number}: {limits:?}");
    let mut node = Node::new(NodeConfiguration { blob, ..calibration.into() });
    let mut before = [0; 3];
    let mut was_on = false;
    let level = random.next_below(4_096) as i32;
    for ms in 0..LIFE_MS {
        if ms % 10 == 0 {
            let counter = ms / 10;
            let any = random.next_u32() as i32;
            let calibration = calibration_id(calibration_crc(blob));
            let learned = LearnedChangeRequest {
                part: any as u8 % 8,
                amount: (any >> 16) as i16,
                calibration,
            };
            let control = Control { engage: counter >= 4, learned, ..Control::REFERENCED };
            let _ = node.receive(Interface::Can, &frames::encode_control(control, counter));
            let spindle = SpindleState { speed: Rpm(any as u16), load_n: any as i16 };
            let _ = node.receive(Interface::Can, &frames::encode_spindle(spindle, counter));
            let angles = [any / 16, any / 32].map(MicroDegrees);
            let _ = node.receive(
                Interface::Can,
                &frames::encode_rotary(RotaryAxisAngles { angles }, counter),
            );
            for axis in LinearAxis::ALL {
                let position = Position(random.next_u32() as i32 / 2);
                let at = AxisPosition { axis, position, direction: TravelDirection::Positive };
                let _ = node.receive(Interface::Can, &frames::encode_position(at, counter));
            }
        }
        let codes: [AdcCode; CODES_PER_TICK] = core::array::from_fn(|_| {
            AdcCode((level + random.next_signed_within(3)).clamp(0, 4_095) as u16)
        });
        let raw = [RawTemperatureReading(random.next_u32() as i32 >> 16); 8];
        let temperatures = (ms % 10 == 5).then_some(&raw);
        node.tick(1, TickInput { codes: Some(&codes), speed: None, temperatures });
        let output = node.last_output();
        was_on |= output.quality == OffsetQuality::Live;
        let Some(offset) = output.offset else {
            before = [0; 3];
            continue;
        };
        for (axis, before) in offset.iter().zip(before) {
            assert!(axis.0.abs() <= MAX_OFFSET_NM, "blob {number}, {ms} ms: {output:?}");
            let step = (axis.0 - before).unsigned_abs();
            assert!(step <= MAX_SLEW_NM_PER_S / 1_000, "blob {number}, {ms} ms: {output:?}");
        }
        before = offset.map(|axis| axis.0);
    }
    was_on
}

fn attack(blobs: u64, seed: u32) {
    let mut slot = [0; MAX_BLOB_SIZE];
    let seeds: Vec<Vec<u8>> = [0, 1]
        .map(|table| encode(&machine::calibration(table), &mut slot).expect("it fits").to_vec())
        .into();
    let mut random = XorShift32::new(seed);
    let (mut refused, mut reasons, mut live) = (0_u64, BTreeMap::new(), 0_u64);
    for number in 0..blobs {
        let blob = hostile(&mut random, &seeds, &mut slot);
        match decode(blob) {
            Err(error) => {
                let message = format!("{error:?}");
                let kind = message.split([' ', '(', '{']).next().unwrap_or_default().to_string();
                assert_ne!(kind, "Crc", "blob {number}: its CRC is right");
                assert!(!error.to_string().is_empty());
                *reasons.entry(kind).or_insert(0_u64) += 1;
                refused += 1;
            }
            Ok(_) => live += u64::from(lives_within_the_caps(&mut random, blob, number)),
        }
    }
    println!("{blobs} blobs: {refused} refused, {reasons:?}; {live} of the others went live");
    assert!(refused > blobs / 10 && live > blobs / 100, "both happen");
}

#[test]
fn a_hostile_blob_with_a_right_crc_is_refused_or_stays_within_the_caps() {
    attack(20_000, 1);
}

#[test]
#[ignore = "long: a hundred thousand hostile blobs"]
fn a_hundred_thousand_hostile_blobs_are_refused_or_stay_within_the_caps() {
    attack(100_000, 2);
}

#[test]
#[ignore = "campaign: cargo xtask soak"]
fn campaign_hostile_blobs() {
    let blobs =
        env::var("TRUEUP_SOAK_BLOBS").map_or(10_000_000, |text| text.parse().expect("a count"));
    attack(blobs, 3);
}
