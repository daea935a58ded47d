//! Quantities at the ends of their ranges, written and read again.

use super::*;
use crate::calibration::{MAX_BLOB_SIZE, decode, encode, tests::with_sample};
use trueup_core::calibration::InputSettings;

#[test]
fn thermometers_of_a_cold_machine_agree_within_5_kelvin_at_the_most() {
    let most = 5 * Temperature::PER_KELVIN;
    for (within, is_taken) in [(0, true), (most, true), (most + 1, false), (-1, false)] {
        with_sample(|mut calibration| {
            calibration.cold_within = Temperature(within);
            let mut bytes = [0; MAX_BLOB_SIZE];
            let blob = encode(&calibration, &mut bytes).expect("it is small");
            assert_eq!(decode(blob) == Ok(calibration), is_taken, "{within}");
        });
    }
}

#[test]
fn a_channel_changes_by_up_to_600_kelvin_a_minute_and_not_by_more() {
    for (tenths, is_taken) in [
        (0, true),
        (1, true),
        (MAX_RATE_DECIKELVIN_PER_MIN, true),
        (MAX_RATE_DECIKELVIN_PER_MIN + 1, false),
    ] {
        with_sample(|mut calibration| {
            calibration.guards.max_rates[3] = tenths;
            let mut bytes = [0; MAX_BLOB_SIZE];
            let blob = encode(&calibration, &mut bytes).expect("it is small");
            assert_eq!(decode(blob) == Ok(calibration), is_taken, "{tenths}");
        });
    }
}

#[test]
fn each_switch_is_one_bit_that_is_0_in_a_blob_without_it_and_no_other_is_taken() {
    type Set = fn(&mut InputSettings);
    let switches: [(Set, u8); 2] = [
        (|guards| guards.service_switch = true, 1),
        (|guards| guards.mains = MainsFrequency::Hz60, 2),
    ];
    for (set, bit) in switches {
        with_sample(|mut calibration| {
            let (mut before, mut after) = ([0; MAX_BLOB_SIZE], [0; MAX_BLOB_SIZE]);
            let without = encode(&calibration, &mut before).expect("it is small");
            set(&mut calibration.guards);
            let with = encode(&calibration, &mut after).expect("it is small");
            assert_eq!(decode(with), Ok(calibration));
            // All but the CRC at the end.
            let bytes = without.iter().zip(with).take(without.len() - 4);
            let mut changed = bytes.enumerate().filter(|(_, (a, b))| a != b);
            assert_eq!((changed.next(), changed.next()), (Some((578, (&0, &bit))), None));
        });
    }
    // Bit 2 of the switches.
    let field = (11_u32 | 4 << 16).to_le_bytes();
    let mut reader = Reader::new(&field, 0);
    let read = RejoinAndSwitches::read(&mut reader);
    assert!(matches!(reader.finish(read.0), Err(BlobError::Limit { .. })));
}

#[test]
fn a_direction_is_taken_whose_parts_are_rounded_and_not_one_that_is_longer() {
    // (0.48, 0.6, −0.64) has a length of 1, right to 10⁻⁶.
    for (off, is_taken) in [(0.0, true), (1e-7, true), (1e-2, false), (-1e-2, false)] {
        with_sample(|mut calibration| {
            let part = |part: f64| ((part + off) * f64::from(ToolDirection::ONE)) as i32;
            calibration.kinematics.zero = ToolDirection([0.48, 0.6, -0.64].map(part));
            let mut bytes = [0; MAX_BLOB_SIZE];
            let blob = encode(&calibration, &mut bytes).expect("it is small");
            assert_eq!(decode(blob) == Ok(calibration), is_taken, "{off}");
        });
    }
}
