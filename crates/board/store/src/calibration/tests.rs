//! Blobs written, damaged, and read again.

mod category;
mod limits;

use super::*;
use proptest::prelude::*;
use std::vec::Vec;
use trueup_core::{
    calibration::{
        AxisModel, AxisThermalModel, DualDrive, ElongationSource, InputSettings, MachineIdentity,
        SpindleModel, SpindleTemperatureModel, SpindleWarmupModel,
    },
    cnc::LinearAxis,
    curve::{Curve, CurveSegment},
    design_parameters::MAX_TERMS,
    displacement_sensor::{SensorLaw, SensorSlope},
    fixed_point::ScaledCoefficient,
    gradient::Gradient,
    kinematics::{Kinematics, RotaryAxis},
    lag::SmoothingFactor,
    learned_changes::LearnedLimits,
    limits::CompensationLimits,
    pitch_table::{GantryBeam, PitchErrorTable},
    reversal::{self, Interval},
    term::{Effect, SpeedExponent, Target, Term, Tilt},
    thermal::{ThermalExpansionLaw, ThermalLawSegment},
    thermometer::Thermometer,
    tool_direction::ToolDirection,
    units::{FineNanometres, Nanometres, Position, SensorReading, Temperature},
    warmup,
};

const POINTS: [[u8; 4]; 3] = [[1, 0, 0, 0], [2, 0, 0, 0], [3, 0, 0, 0]];

/// Returns a term of each effect.
fn terms<'a>(pitch: PitchErrorTable<'a>, curve: Curve<'a>) -> [Option<Term<'a>>; MAX_TERMS] {
    let scaled = ScaledCoefficient { mantissa: -7, shift: 11 };
    let [x, y, z] = LinearAxis::ALL.map(Target::Axis);
    let heat = Effect::Heat {
        channel: 7,
        smoothing: SmoothingFactor(21),
        reference: Temperature(-22),
        per_temperature: scaled,
    };
    let wave =
        Effect::Wave { turns: 0x1234_5678_9ABC_DEF0, phase: 7, amplitude: FineNanometres(-8) };
    let all = [
        (Target::Elongation, Effect::Offset),
        (Target::Elongation, Effect::Gain(scaled)),
        (Target::Elongation, Effect::Curvature(scaled)),
        (Target::Elongation, Effect::Saturation(FineNanometres(9))),
        (y, heat),
        (Target::Elongation, Effect::Time { smoothing: SmoothingFactor(3), amplitude: scaled }),
        (Target::Elongation, Effect::Speed(scaled)),
        (Target::Elongation, Effect::Load(scaled)),
        (x, Effect::Position { axis: LinearAxis::Z, gradient: Gradient(-3) }),
        (x, Effect::Reversed { width: FineNanometres(4), gradient: Gradient(-5) }),
        (x, Effect::Table(pitch)),
        (x, Effect::Curve { axis: LinearAxis::Y, curve }),
        (z, wave),
    ];
    let mut terms = [None; MAX_TERMS];
    for (place, (target, effect)) in terms.iter_mut().zip(all) {
        *place = Some(Term { target, constant: FineNanometres(-6), effect });
    }
    terms
}

/// Returns a calibration with something in every field.
pub(crate) fn with_sample<T>(check: impl FnOnce(Calibration<'_>) -> T) -> T {
    let piece = ThermalLawSegment {
        start: Temperature(94_208_000),
        constant: FineNanometres(1),
        constant_slope: 2,
        gradient: Gradient(3),
        gradient_slope: 4,
    };
    let pieces = [piece.to_bytes()];
    let segment = |end| CurveSegment::new(Position(end), 15, [256, 0, 0, 0]).to_bytes();
    let segments = [100_000, 131_071].map(segment);
    // The second segment begins after the start of the last of four buckets of 2¹⁵.
    let index = [[0, 0], [0, 0], [0, 0], [0, 0]];
    let curve = Curve::new(Position(0), &segments, &index, 15);
    let pitch = PitchErrorTable {
        start: Position(-5),
        step: Interval::new(1_000),
        forward: &POINTS,
        reverse: Some(&POINTS),
    };
    let axis = AxisModel {
        thermal: Some(AxisThermalModel {
            smoothing_falling: SmoothingFactor(8),
            channel: 2,
            smoothing: SmoothingFactor(7),
            origin: Position(-9),
            law: ThermalExpansionLaw { pieces: &pieces },
        }),
        pitch: Some(pitch),
        dual: Some(DualDrive {
            across: LinearAxis::Y,
            beam: GantryBeam::new(Position(1), Position(2)),
            pitch: PitchErrorTable { reverse: None, ..pitch },
        }),
        backlash: FineNanometres(-77),
        travel: reversal::ReversalConfig { hysteresis: 100, ramp: Interval::new(5_000) },
        rapid: 0,
    };
    let law = warmup::WarmupModel {
        lag_ms: 60_000,
        max: FineNanometres(80_000),
        smoothing_heating: SmoothingFactor(5),
        smoothing_cooling: SmoothingFactor(6),
        full: 8,
    };
    let terms = terms(pitch, curve);
    check(Calibration {
        thermometers: core::array::from_fn(|n| match n {
            2 => Some(Thermometer::Pt100),
            5 => Some(Thermometer::Linear { zero: -3, slope: 4, shift: 7 }),
            _ => None,
        }),
        spindle: SpindleModel {
            chain: [
                Some(ElongationSource::Sensor),
                Some(ElongationSource::Temperature),
                Some(ElongationSource::Warmup),
            ],
            sensor: SensorLaw {
                k0: Nanometres(-1_250),
                zero: SensorReading(645_120),
                slope: SensorSlope(31_998_000),
            },
            temperature: Some(SpindleTemperatureModel {
                channel: 5,
                smoothing: SmoothingFactor(u32::MAX),
                smoothing_falling: SmoothingFactor(9),
                law: ThermalExpansionLaw { pieces: &pieces },
            }),
            warmup: Some(SpindleWarmupModel { law, power: curve }),
        },
        kinematics: Kinematics {
            zero: ToolDirection::DOWN,
            axes: [Some(RotaryAxis::C), Some(RotaryAxis::A)],
        },
        axes: [
            axis,
            AxisModel::default(),
            AxisModel { backlash: FineNanometres(4), ..AxisModel::default() },
        ],
        straightness: [curve, Curve::default(), curve, Curve::default(), Curve::default(), curve],
        squareness: [-3, -2, -1, 0, 1, 2].map(Gradient),
        volume: None,
        terms,
        limits: CompensationLimits {
            max: [200_000, 200_000, 500_000].map(Nanometres),
            slew_nm_per_s: 20_000,
            link_timeout_ms: 500,
            hold_ms: 2_000,
            rejoin_nm_per_s: 11,
            learned: LearnedLimits::default(),
        },
        cold_within: Temperature(Temperature::PER_KELVIN / 2),
        guards: InputSettings::default(),
        names: MachineIdentity { machine: b"gantry", serial: b"17/4", board: [1, 2, 3] },
    })
}

/// Returns a calibration with limits and nothing else.
pub(crate) fn with_smallest<T>(check: impl FnOnce(Calibration<'_>) -> T) -> T {
    with_sample(|sample| {
        check(Calibration {
            thermometers: Default::default(),
            spindle: SpindleModel::default(),
            kinematics: Kinematics { axes: [None; 2], ..sample.kinematics },
            axes: Default::default(),
            straightness: Default::default(),
            squareness: Default::default(),
            terms: Default::default(),
            names: Default::default(),
            ..sample
        })
    })
}

/// Returns a table of these points, from 0 on.
pub(crate) fn pitch_of(points: &[[u8; 4]]) -> PitchErrorTable<'_> {
    PitchErrorTable {
        start: Position(0),
        step: Interval::new(1_000),
        forward: points,
        reverse: None,
    }
}

/// Returns its blob.
pub(crate) fn blob(calibration: &Calibration<'_>) -> Vec<u8> {
    encode(calibration, &mut [0; MAX_BLOB_SIZE]).expect("it is small").to_vec()
}

fn sample() -> Vec<u8> {
    with_sample(|calibration| blob(&calibration))
}

/// The blob with its CRC made right again.
pub(crate) fn mended(mut blob: Vec<u8>) -> Vec<u8> {
    let end = blob.len() - CRC_SIZE;
    let crc = crc::checksum(&blob[..end]).to_le_bytes();
    blob[end..].copy_from_slice(&crc);
    blob
}

#[test]
fn a_calibration_comes_back_whole_with_its_tables_in_place() {
    let blob = sample();
    with_sample(|calibration| assert_eq!(decode(&blob), Ok(calibration)));
    let decoded = decode(&blob).unwrap();
    let table = decoded.axes[0].pitch.unwrap().forward.as_ptr().cast::<u8>();
    assert!(blob.as_ptr_range().contains(&table), "read where it lies");
}

#[test]
fn a_tilt_and_heat_by_the_speed_come_back_and_what_is_without_a_meaning_is_refused() {
    let blob = with_sample(|mut calibration| {
        let curve = calibration.straightness[0];
        let (along, lever, origin) = (LinearAxis::X, LinearAxis::Z, Position(-77_777));
        let line = Effect::TiltLine(Tilt { along, lever, origin, angle: Gradient(-31) });
        let (along, lever) = (lever, along);
        let curve = Effect::TiltCurve(Tilt { along, lever, origin, angle: curve });
        let target = Target::Axis(LinearAxis::Y);
        let term = |effect| Some(Term { target, constant: FineNanometres(-6), effect });
        calibration.terms = Default::default();
        let (smoothing, per_unit) =
            (SmoothingFactor(23), ScaledCoefficient { mantissa: -7, shift: 11 });
        let power = SpeedExponent::Second;
        let heat = Effect::SpeedHeat { power, smoothing, per_unit };
        let terms = [line, curve, heat].map(term);
        calibration.terms.iter_mut().zip(terms).for_each(|(place, term)| *place = term);
        let blob = blob(&calibration);
        assert_eq!(decode(&blob), Ok(calibration));
        blob
    });
    let terms = usize::from(u16::from_le_bytes([blob[572], blob[573]]));
    // Kind, target, axes, and the bucket shift of the curve.
    assert_eq!(blob[terms..terms + 4], [13, 2, 0x20, 0]);
    assert_eq!(blob[terms + 24..terms + 28], [14, 2, 0x02, 15]);
    assert_eq!(blob[terms + 48..terms + 52], [15, 2, 2, 11]);
    let of_heat = [(48, 18), (48 + 2, 0), (48 + 2, 3), (48 + 3, 63)];
    let of_tilts = [(2, 0x30), (2, 0x03), (24 + 2, 0x03), (24 + 3, 1), (24 + 18, 99)];
    for (at, byte) in of_tilts.into_iter().chain(of_heat) {
        let mut bad = blob.clone();
        bad[terms + at] = byte;
        let bad = mended(bad);
        assert!(decode(&bad).is_err(), "{byte:#x} at {at} of the terms");
    }
}

#[test]
fn the_fields_lie_where_the_table_says() {
    let blob = sample();
    let word = |at: usize| i32::from_le_bytes(*blob[at..].first_chunk().unwrap());
    assert_eq!(&blob[..6], b"TRUP\x04\x00");
    assert_eq!(usize::from(u16::from_le_bytes([blob[6], blob[7]])), blob.len());
    for (at, value) in [
        (8, 200_000),
        (20, 20_000),
        (28, 2_000),
        (40, -ToolDirection::ONE),
        (44, 0x0103),
        (48, 0x0003_0201),
        (56, 645_120),
        (64, 5),
        (76, 60_000),
        (112 + 24, 1),
        (112 + 60, 0x0702),
        (208, 2),
        (216, -9),
        (208 + 60, -77),
        (288, 255),
        (368 + 60, 4),
        (544, -3),
        (568, 9),
        (576, 11),
        (580, Temperature::PER_KELVIN / 2),
        (592, 3),
    ] {
        assert_eq!(word(at), value, "at {at}");
    }
    let tables = usize::from(u16::from_le_bytes([blob[72], blob[73]]));
    assert_eq!(tables, FIXED_PART_SIZE, "the first table follows the fixed part");
    let terms = usize::from(u16::from_le_bytes([blob[572], blob[573]]));
    assert_eq!([blob[574], blob[575]], [13, 0]);
    // The fifth: heat of channel 7 on Y.
    assert_eq!(blob[terms + 4 * 24..][..4], [4, 2, 7, 11]);
    assert_eq!(word(terms + 4 * 24 + 12), 21);
}

#[test]
fn a_rapid_traverse_stands_where_older_blobs_have_an_unused_0() {
    let older = sample();
    let mut calibration = decode(&older).expect("of the first writer");
    assert_eq!(calibration.axes.map(|axis| axis.rapid), [0; 3]);
    calibration.axes[1].rapid = 25_000;
    let newer = &blob(&calibration)[..];
    assert_eq!(decode(newer), Ok(calibration));
    // 80 bytes an axis, its last word.
    let at = 208 + 2 * 80 - 4;
    let is_other = |n: &usize| older[*n] != newer[*n];
    assert!((0..older.len() - 4).filter(is_other).all(|n| (at..at + 4).contains(&n)));
    assert_eq!(newer[at..at + 4], 25_000_u32.to_le_bytes());
}

#[test]
fn the_bytes_with_something_in_every_field_are_those_of_the_first_writer() {
    let blob = sample();
    assert_eq!((blob.len(), calibration_crc(&blob)), (1_270, 0xA539_7E71));
}

#[test]
fn every_single_bit_flip_is_refused() {
    let good = sample();
    for bit in 0..good.len() * 8 {
        let mut bad = good.clone();
        bad[bit / 8] ^= 1 << (bit % 8);
        let error = decode(&bad).expect_err("a flipped bit");
        let right_kind = match bit / 8 {
            0..4 => matches!(error, BlobError::Magic { .. }),
            4..6 => matches!(error, BlobError::Schema { .. }),
            6..8 => !matches!(error, BlobError::Magic { .. } | BlobError::Schema { .. }),
            _ => matches!(error, BlobError::Crc { .. }),
        };
        assert!(right_kind, "bit {bit}: {error}");
    }
}

#[test]
fn every_cut_is_refused_and_what_follows_is_not_looked_at() {
    let good = sample();
    let slot = [&good[..], &[0xFF; 100]].concat();
    for len in 0..good.len() {
        assert_eq!(decode(&slot[..len]), Err(BlobError::TooShort { len }));
    }
    assert_eq!(decode(&slot), decode(&good));
}

#[test]
fn erased_flash_is_no_calibration() {
    let found = [0xFF; 4];
    assert_eq!(decode(&[0xFF; 1_000]), Err(BlobError::Magic { found }));
}

#[test]
fn values_without_a_meaning_are_refused_with_their_place() {
    for (at, bytes, error) in [
        (8, [0xFF; 4], BlobError::MaxOffset { offset: 8, found: -1 }),
        (16, 5_242_871_i32.to_le_bytes(), BlobError::MaxOffset { offset: 16, found: 5_242_871 }),
        (40, [0; 4], BlobError::NotUnit { offset: 32, found: [0; 3] }),
        (44, [4, 0, 0, 0], BlobError::Value { offset: 44, found: 4 }),
        (44, [0, 0, 251, 0], BlobError::Limit { offset: 44, found: 251, most: 250 }),
        (44, [0, 0, 0, 251], BlobError::Limit { offset: 44, found: 251, most: 250 }),
        (48, [0, 0, 0, 201], BlobError::Limit { offset: 48, found: 201, most: 200 }),
        (48, [0, 9, 0, 0], BlobError::Value { offset: 48, found: 9 }),
        (64, [8, 0, 0, 0], BlobError::Value { offset: 64, found: 8 }),
        (112, [3, 0, 0, 0], BlobError::Value { offset: 112, found: 3 }),
        (72, [0xFF, 0xFF, 1, 0], BlobError::Table { offset: 72 }),
        (72, [0, 0, 1, 0], BlobError::Table { offset: 72 }),
        (228, [0; 4], BlobError::Table { offset: 224 }),
        (240, [3, 0, 0, 0], BlobError::Value { offset: 240, found: 3 }),
    ] {
        let mut blob = sample();
        blob[at..at + 4].copy_from_slice(&bytes);
        assert_eq!(decode(&mended(blob)), Err(error), "at {at}");
    }
}

#[test]
fn of_two_faults_the_first_is_reported() {
    let mut blob = sample();
    blob[44] = 4;
    blob[240] = 3;
    assert_eq!(decode(&mended(blob)), Err(BlobError::Value { offset: 44, found: 4 }));
}

#[test]
fn what_does_not_fit_is_refused_with_its_size() {
    with_sample(|calibration| {
        let mut small = [0; 700];
        let error = encode(&calibration, &mut small).expect_err("it is larger");
        assert_eq!(error.bytes, sample().len());
        let message = std::format!("{error}");
        assert_eq!(
            message,
            std::format!("{} bytes do not fit the board's {MAX_BLOB_SIZE}", error.bytes)
        );
    });
}

#[test]
fn as_many_terms_as_the_board_has_come_back_and_one_more_is_refused() {
    let blob = with_sample(|mut calibration| {
        let [first, ..] = calibration.terms;
        calibration.terms = [first; MAX_TERMS];
        let blob = blob(&calibration);
        assert_eq!(decode(&blob), Ok(calibration));
        blob
    });
    assert_eq!(usize::from(blob[574]), MAX_TERMS);
    // The table begins earlier by a term, so that it lies within the blob.
    let mut more = blob;
    let start = u16::from_le_bytes([more[572], more[573]]) - 24;
    more[572..574].copy_from_slice(&start.to_le_bytes());
    more[574] += 1;
    assert_eq!(decode(&mended(more)), Err(BlobError::Table { offset: 572 }));
}

proptest! {
    #[test]
    fn no_bytes_panic(
        at in 8_usize..FIXED_PART_SIZE, bytes in prop::collection::vec(any::<u8>(), 1..40),
        cut in 0_usize..1_000,
    ) {
        let mut blob = sample();
        let end = (at + bytes.len()).min(blob.len() - CRC_SIZE);
        blob[at..end].copy_from_slice(&bytes[..end - at]);
        let blob = mended(blob);
        let _ = decode(&blob);
        let _ = decode(&blob[..cut.min(blob.len())]);
    }
}

#[test]
fn a_calibration_is_identified_by_its_last_four_bytes_and_none_by_0() {
    assert_eq!(calibration_crc(&[1, 2, 0x44, 0x33, 0x22, 0x11]), 0x1122_3344);
    assert_eq!(calibration_crc(&[]), 0);
}

#[test]
fn a_warm_up_is_there_where_it_grows_or_is_a_source_and_else_there_is_none() {
    with_sample(|sample| {
        let warmup = sample.spindle.warmup.expect("it has one");
        let law = warmup.law;
        let still = SpindleWarmupModel {
            law: warmup::WarmupModel { max: FineNanometres::ZERO, ..law },
            ..warmup
        };
        let sources = [Some(ElongationSource::Warmup), None, None];
        for (chain, stored, expected) in [
            ([None; 3], Some(warmup), Some(warmup)),
            ([None; 3], Some(still), None),
            ([None; 3], None, None),
            (sources, Some(warmup), Some(warmup)),
            (sources, Some(still), Some(still)),
        ] {
            let spindle = SpindleModel { chain, warmup: stored, ..sample.spindle };
            let mut bytes = [0; MAX_BLOB_SIZE];
            let blob = encode(&Calibration { spindle, ..sample }, &mut bytes).expect("small");
            assert_eq!(
                decode(blob).map(|calibration| calibration.spindle.warmup),
                Ok(expected),
                "{chain:?}"
            );
        }
    });
}

#[test]
fn a_coefficient_is_shifted_by_62_at_most() {
    let blob = sample();
    let terms = usize::from(u16::from_le_bytes([blob[572], blob[573]]));
    for shift in 0..=u8::MAX {
        let mut shifted = blob.clone();
        shifted[terms + 3] = shift;
        let refused = Err(BlobError::Value { offset: terms, found: shift.into() });
        assert_eq!(decode(&mended(shifted)) == refused, shift > 62, "{shift}");
    }
}
