//! Terms by tool and by condition in a blob, and a slope by heat.

use super::*;
use trueup_core::term::{CategoryFactor, ConditionLevels, ToolTable};

/// Tools 1 and 7.
static LEVELS: [[u8; 8]; 2] = [[1, 0, 0, 0, 9, 0, 0, 0], [7, 0, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF]];

fn blob_of(effects: [Effect<'static>; 2]) -> Vec<u8> {
    with_smallest(|mut calibration| {
        for (place, effect) in calibration.terms.iter_mut().zip(effects) {
            *place =
                Some(Term { target: Target::Elongation, constant: FineNanometres(-6), effect });
        }
        let mut bytes = [0; MAX_BLOB_SIZE];
        let blob = encode(&calibration, &mut bytes).expect("it is small").to_vec();
        assert_eq!(decode(&blob), Ok(calibration));
        blob
    })
}

#[test]
fn tools_and_conditions_come_back_and_one_without_a_meaning_is_refused() {
    let tools = ToolTable { levels: &LEVELS, other: -5, shift: 41, times: CategoryFactor::Speed2 };
    let condition = ConditionLevels {
        bit: 15,
        default: true,
        off: -3,
        on: 77,
        shift: 20,
        smoothing: SmoothingFactor(4),
        times: CategoryFactor::Growth,
    };
    let blob = blob_of([Effect::Tool(tools), Effect::Condition(condition)]);
    let terms = usize::from(u16::from_le_bytes([blob[572], blob[573]]));
    // Kind, target, bit, binary places.
    assert_eq!(blob[terms..terms + 4], [16, 0, 0, 41]);
    assert_eq!(blob[terms + 24..terms + 28], [17, 0, 15, 20]);
    assert_eq!(blob[terms + 24 + 20..terms + 48], [2, 1, 0, 0], "factor and default");
    let table = terms + 48;
    for (at, byte) in [
        (terms + 3, 63),
        (terms + 16, 4),
        (terms + 17, 1),
        (terms + 14, 0xFF),
        (terms + 24 + 2, 16),
        (terms + 24 + 20, 4),
        (terms + 24 + 21, 2),
        (terms + 24 + 22, 1),
        // No rising numbers, and no number of a tool.
        (table, 7),
        (table + 8 + 2, 1),
    ] {
        let mut bad = blob.clone();
        bad[at] = byte;
        assert!(decode(&mended(bad)).is_err(), "{byte:#x} at {at}");
    }
}

#[test]
fn as_many_tools_as_the_board_knows_come_back_and_one_more_is_refused() {
    let levels: Vec<[u8; 8]> = (0..33).map(|number| [number, 0, 0, 0, 1, 0, 0, 0]).collect();
    let levels: &'static [[u8; 8]] = levels.leak();
    for (count, is_taken) in [(0, true), (32, true), (33, false)] {
        with_smallest(|mut calibration| {
            let effect = Effect::Tool(ToolTable { levels: &levels[..count], ..Default::default() });
            let target = Target::Elongation;
            calibration.terms[0] = Some(Term { target, constant: FineNanometres::ZERO, effect });
            let mut bytes = [0; MAX_BLOB_SIZE];
            let read = decode(encode(&calibration, &mut bytes).expect("it is small"));
            assert_eq!(read == Ok(calibration), is_taken, "{count} tools");
        });
    }
}

#[test]
fn a_slope_by_heat_comes_back_and_one_of_a_ninth_channel_is_refused() {
    let slope = Effect::HeatSlope {
        channel: 6,
        smoothing: SmoothingFactor(23),
        reference: Temperature(-22),
        per_temperature: ScaledCoefficient { mantissa: -7, shift: 11 },
    };
    let blob = blob_of([slope, Effect::Offset]);
    let terms = usize::from(u16::from_le_bytes([blob[572], blob[573]]));
    assert_eq!(blob[terms..terms + 4], [19, 0, 6, 11]);
    let mut bad = blob;
    bad[terms + 2] = 8;
    assert!(decode(&mended(bad)).is_err());
}

/// Firmware without these kinds reads the number as one that stands for nothing, with its place.
#[test]
fn a_kind_that_the_firmware_does_not_know_is_refused_by_its_number_and_place() {
    let mut blob = blob_of([Effect::Offset, Effect::Offset]);
    let terms = usize::from(u16::from_le_bytes([blob[572], blob[573]]));
    blob[terms + 24] = 20;
    let refused = BlobError::Value { offset: terms + 24, found: 20 };
    assert_eq!(decode(&mended(blob)), Err(refused));
    assert_eq!(
        std::string::ToString::to_string(&refused),
        std::format!("20 at {} has no meaning", terms + 24)
    );
}
