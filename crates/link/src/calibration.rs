//! The calibration as the host sends it and the board stores it: 60 bytes, little-endian.
//!
//! | offset | type | field | unit, range |
//! |---|---|---|---|
//! | 0 | 4 bytes | magic `TRUP` | |
//! | 4 | `u16` | schema | 1 |
//! | 6 | `u16` | length, all of the blob | 60 bytes |
//! | 8 | `i32` | sensor K₀ | nm |
//! | 12 | `i32` | sensor V₀ | 1/1024 ADC code |
//! | 16 | `i32` | sensor slope tanβ | 2⁻²⁸ nm per 1/1024 ADC code |
//! | 20, 24, 28 | 3 × `i32` | tool direction x, y, z | 2⁻³⁰, together a unit vector |
//! | 32, 36, 40 | 3 × `i32` | largest offset on X, Y, Z | nm, 0…5 242 870 |
//! | 44 | `u32` | slew limit | nm/s |
//! | 48 | `u32` | link timeout | ms |
//! | 52 | `u32` | hold | ms |
//! | 56 | `u32` | CRC-32/AUTOSAR over bytes 0…55 | |
//!
//! The checks go from the outside in: a blob of another schema is told apart from a damaged one
//! before the CRC is looked at, because its CRC may lie elsewhere.

use core::{error::Error, fmt};

use crc::{CRC_32_AUTOSAR, Crc};
use trueup_core::{
    calibration::Calibration,
    limits::Limits,
    sensor::{SensorLaw, Slope},
    tool::Direction,
    units::{Nanometres, Reading},
};

use crate::layout::{NANOMETRES_PER_BIT, OFFSET_MAX_RAW};

/// Bytes in a blob.
pub const SIZE: usize = 60;
/// The first four bytes.
pub const MAGIC: [u8; 4] = *b"TRUP";
/// The layout described here.
pub const SCHEMA: u16 = 1;
/// The largest offset that the frames to the CNC can carry, in nanometres.
pub const MAX_OFFSET_NM: i32 = OFFSET_MAX_RAW * NANOMETRES_PER_BIT;

/// Offset of the CRC in the blob.
const CRC_OFFSET: usize = 56;
const DIRECTION_OFFSET: usize = 20;
const MAX_OFFSETS: [usize; 3] = [32, 36, 40];

/// How far the square of the tool direction's length may be from 1, in 2⁻⁶⁰: 2⁻¹⁹. The length is
/// then right to 10⁻⁶, 1 nm of a millimetre; rounding to 2⁻³⁰ alone makes 2·10⁻⁹.
const UNIT_TOLERANCE: u64 = 1 << 41;

static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_AUTOSAR);

/// The blob of a calibration, also of one that [`decode`] would refuse.
#[must_use]
pub fn encode(calibration: &Calibration) -> [u8; SIZE] {
    let Calibration { sensor, tool_direction: Direction([vx, vy, vz]), limits } = calibration;
    let [max_x, max_y, max_z] = limits.max;
    let [schema_low, schema_high] = SCHEMA.to_le_bytes();
    let [len_low, len_high] = LEN.to_le_bytes();
    let fields = [
        MAGIC,
        [schema_low, schema_high, len_low, len_high],
        sensor.k0.0.to_le_bytes(),
        sensor.zero.0.to_le_bytes(),
        sensor.slope.0.to_le_bytes(),
        vx.to_le_bytes(),
        vy.to_le_bytes(),
        vz.to_le_bytes(),
        max_x.0.to_le_bytes(),
        max_y.0.to_le_bytes(),
        max_z.0.to_le_bytes(),
        limits.slew_nm_per_s.to_le_bytes(),
        limits.link_timeout_ms.to_le_bytes(),
        limits.hold_ms.to_le_bytes(),
    ];
    let crc = CRC.checksum(fields.as_flattened()).to_le_bytes();
    let mut blob = [0; SIZE];
    let (places, _) = blob.as_chunks_mut::<4>();
    for (place, field) in places.iter_mut().zip(fields.into_iter().chain([crc])) {
        *place = field;
    }
    blob
}

/// `SIZE` as the blob states it.
const LEN: u16 = 60;
const _: () = assert!(LEN as usize == SIZE);

/// The calibration in a blob. Bytes after the blob are not looked at, so that a whole slot of
/// flash can be given.
///
/// # Errors
/// [`BlobError`] with the place and the value at fault; nothing of such a blob must be used.
pub fn decode(bytes: &[u8]) -> Result<Calibration, BlobError> {
    let too_short = BlobError::TooShort { len: bytes.len() };
    let blob: &[u8; SIZE] = bytes.first_chunk().ok_or(too_short)?;
    let (
        &[magic, head, k0, zero, slope, vx, vy, vz, max_x, max_y, max_z, slew, timeout, hold, crc],
        _,
    ) = blob.as_chunks::<4>()
    else {
        return Err(too_short);
    };
    if magic != MAGIC {
        return Err(BlobError::Magic { found: magic });
    }
    let [schema_low, schema_high, len_low, len_high] = head;
    let schema = u16::from_le_bytes([schema_low, schema_high]);
    if schema != SCHEMA {
        return Err(BlobError::Schema { found: schema });
    }
    let len = u16::from_le_bytes([len_low, len_high]);
    if len != LEN {
        return Err(BlobError::Length { found: len });
    }
    let stored = u32::from_le_bytes(crc);
    let computed = CRC.checksum(blob.get(..CRC_OFFSET).ok_or(too_short)?);
    if stored != computed {
        return Err(BlobError::Crc { stored, computed });
    }
    Ok(Calibration {
        sensor: SensorLaw {
            k0: Nanometres(i32::from_le_bytes(k0)),
            zero: Reading(i32::from_le_bytes(zero)),
            slope: Slope(i32::from_le_bytes(slope)),
        },
        tool_direction: direction([vx, vy, vz].map(i32::from_le_bytes))?,
        limits: Limits {
            max: max_offsets([max_x, max_y, max_z].map(i32::from_le_bytes))?,
            slew_nm_per_s: u32::from_le_bytes(slew),
            link_timeout_ms: u32::from_le_bytes(timeout),
            hold_ms: u32::from_le_bytes(hold),
        },
    })
}

fn direction(components: [i32; 3]) -> Result<Direction, BlobError> {
    const ONE_SQUARED: u64 = 1 << (2 * Direction::FRACTION_BITS);
    let squares = components.map(|it| u64::from(it.unsigned_abs()).saturating_pow(2));
    let length_squared = squares.into_iter().fold(0, u64::saturating_add);
    if length_squared.abs_diff(ONE_SQUARED) > UNIT_TOLERANCE {
        return Err(BlobError::NotUnit { offset: DIRECTION_OFFSET, found: components });
    }
    Ok(Direction(components))
}

fn max_offsets(max: [i32; 3]) -> Result<[Nanometres; 3], BlobError> {
    for (offset, found) in MAX_OFFSETS.into_iter().zip(max) {
        if !(0..=MAX_OFFSET_NM).contains(&found) {
            return Err(BlobError::MaxOffset { offset, found });
        }
    }
    Ok(max.map(Nanometres))
}

/// Why a blob is no calibration. Offsets count bytes from the start of the blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlobError {
    /// Fewer than [`SIZE`] bytes.
    TooShort {
        /// Bytes given.
        len: usize,
    },
    /// No calibration at all, such as erased flash: the bytes at offset 0.
    Magic {
        /// The four bytes.
        found: [u8; 4],
    },
    /// Written by a host of another version: the number at offset 4.
    Schema {
        /// The schema of the blob.
        found: u16,
    },
    /// The stated length, at offset 6, is not that of the schema.
    Length {
        /// The stated length.
        found: u16,
    },
    /// Damaged: the CRC at offset 56 does not fit.
    Crc {
        /// The CRC in the blob.
        stored: u32,
        /// The CRC over the blob.
        computed: u32,
    },
    /// The tool direction is not a unit vector.
    NotUnit {
        /// Offset of its first component.
        offset: usize,
        /// The components, in 2⁻³⁰.
        found: [i32; 3],
    },
    /// A largest offset is negative, or more than the frames to the CNC can carry.
    MaxOffset {
        /// Offset of the value.
        offset: usize,
        /// The value in nanometres.
        found: i32,
    },
}

impl fmt::Display for BlobError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooShort { len } => write!(f, "{len} bytes are too short, {SIZE} are needed"),
            Self::Magic { found } => {
                write!(f, "bytes {found:02X?} at 0 are not the mark {MAGIC:02X?} of a calibration")
            }
            Self::Schema { found } => write!(f, "schema {found} at 4 is not {SCHEMA}"),
            Self::Length { found } => write!(f, "length {found} at 6 is not {LEN}"),
            Self::Crc { stored, computed } => {
                write!(f, "CRC at {CRC_OFFSET} is 0x{stored:08X}, should be 0x{computed:08X}")
            }
            Self::NotUnit { offset, found } => write!(
                f,
                "tool direction {found:?} at {offset} has not the length 1 ({})",
                Direction::ONE
            ),
            Self::MaxOffset { offset, found } => write!(
                f,
                "largest offset {found} nm at {offset} is not within 0…{MAX_OFFSET_NM} nm"
            ),
        }
    }
}

impl Error for BlobError {}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn sample() -> Calibration {
        Calibration {
            sensor: SensorLaw {
                k0: Nanometres(-1_250),
                zero: Reading(645_120),
                slope: Slope(31_998_000),
            },
            tool_direction: Direction::DOWN,
            limits: Limits {
                max: [200_000, 200_000, 500_000].map(Nanometres),
                slew_nm_per_s: 20_000,
                link_timeout_ms: 500,
                hold_ms: 2_000,
            },
        }
    }

    #[test]
    fn every_field_lies_where_the_table_says() {
        let blob = encode(&sample());
        let i32_at = |at: usize| i32::from_le_bytes(*blob[at..].first_chunk().unwrap());
        assert_eq!(&blob[..8], b"TRUP\x01\x00\x3C\x00");
        let fields: Vec<i32> = (8..56).step_by(4).map(i32_at).collect();
        assert_eq!(
            fields,
            [
                -1_250,
                645_120,
                31_998_000,
                0,
                0,
                -1_073_741_824,
                200_000,
                200_000,
                500_000,
                20_000,
                500,
                2_000
            ]
        );
    }

    #[test]
    fn the_crc_is_that_of_autosar() {
        assert_eq!(CRC.checksum(b"123456789"), 0x1697_D06A);
        let blob = encode(&sample());
        assert_eq!(blob[CRC_OFFSET..], CRC.checksum(&blob[..CRC_OFFSET]).to_le_bytes());
    }

    #[test]
    fn every_single_bit_flip_is_refused() {
        let good = encode(&sample());
        for bit in 0..SIZE * 8 {
            let mut bad = good;
            bad[bit / 8] ^= 1 << (bit % 8);
            let error = decode(&bad).expect_err("a flipped bit");
            let right_kind = match bit / 8 {
                0..4 => matches!(error, BlobError::Magic { .. }),
                4..6 => matches!(error, BlobError::Schema { .. }),
                6..8 => matches!(error, BlobError::Length { .. }),
                _ => matches!(error, BlobError::Crc { .. }),
            };
            assert!(right_kind, "bit {bit}: {error}");
        }
    }

    #[test]
    fn every_cut_is_refused_and_what_follows_is_not_looked_at() {
        let slot = [&encode(&sample())[..], &[0xFF; 100]].concat();
        for len in 0..SIZE {
            assert_eq!(decode(&slot[..len]), Err(BlobError::TooShort { len }));
        }
        for len in SIZE..slot.len() {
            assert_eq!(decode(&slot[..len]), Ok(sample()));
        }
    }

    #[test]
    fn erased_flash_is_no_calibration() {
        let found = [0xFF; 4];
        assert_eq!(decode(&[0xFF; 64]), Err(BlobError::Magic { found }));
    }

    #[test]
    fn a_largest_offset_outside_the_frames_range_is_refused_with_its_place() {
        for (axis, offset) in MAX_OFFSETS.into_iter().enumerate() {
            for (found, allowed) in [
                (i32::MIN, false),
                (-1, false),
                (0, true),
                (5_242_870, true),
                (5_242_871, false),
                (i32::MAX, false),
            ] {
                let mut calibration = sample();
                calibration.limits.max[axis] = Nanometres(found);
                let expected = if allowed {
                    Ok(calibration)
                } else {
                    Err(BlobError::MaxOffset { offset, found })
                };
                assert_eq!(decode(&encode(&calibration)), expected);
            }
        }
    }

    #[test]
    fn a_direction_that_is_not_a_unit_vector_is_refused() {
        const ONE: i32 = Direction::ONE;
        let millionth = ONE / 1_000_000;
        for (found, allowed) in [
            ([0, 0, ONE], true),
            ([ONE / 2, ONE / 2, 759_250_125], true),
            ([0, 0, ONE + millionth / 2], true),
            ([0, 0, millionth / 2 - ONE], true),
            ([0, 0, ONE + 2 * millionth], false),
            ([0, 0, 2 * millionth - ONE], false),
            ([0, 0, 0], false),
            ([ONE, 0, ONE], false),
            ([i32::MIN; 3], false),
            ([i32::MAX; 3], false),
        ] {
            let mut calibration = sample();
            calibration.tool_direction = Direction(found);
            let expected = if allowed {
                Ok(calibration)
            } else {
                Err(BlobError::NotUnit { offset: 20, found })
            };
            assert_eq!(decode(&encode(&calibration)), expected, "{found:?}");
        }
    }

    proptest! {
        #[test]
        fn a_calibration_comes_back_whole(
            sensor: (i32, i32, i32), max in prop::array::uniform3(0..=MAX_OFFSET_NM),
            axis in 0_usize..3, up: bool, times: (u32, u32, u32),
        ) {
            let mut components = [0; 3];
            components[axis] = if up { Direction::ONE } else { -Direction::ONE };
            let calibration = Calibration {
                sensor: SensorLaw {
                    k0: Nanometres(sensor.0),
                    zero: Reading(sensor.1),
                    slope: Slope(sensor.2),
                },
                tool_direction: Direction(components),
                limits: Limits {
                    max: max.map(Nanometres),
                    slew_nm_per_s: times.0,
                    link_timeout_ms: times.1,
                    hold_ms: times.2,
                },
            };
            prop_assert_eq!(decode(&encode(&calibration)), Ok(calibration));
        }

        #[test]
        fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..100), fix: bool) {
            let mut bytes = bytes;
            if fix && bytes.len() >= SIZE {
                bytes[..8].copy_from_slice(&encode(&sample())[..8]);
                let crc = CRC.checksum(&bytes[..CRC_OFFSET]).to_le_bytes();
                bytes[CRC_OFFSET..SIZE].copy_from_slice(&crc);
            }
            let _ = decode(&bytes);
        }
    }
}
