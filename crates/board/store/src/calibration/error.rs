//! Why there is no blob, or no calibration in one.

use trueup_core::tool_direction::ToolDirection;

use super::blob_format::{
    BLOB_MAGIC, CRC_SIZE, FIXED_PART_SIZE, MAX_BLOB_SIZE, MAX_OFFSET_NM, SCHEMA_VERSION,
};

/// Why there is no blob: the calibration has more in it than a board can store.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{bytes} bytes do not fit the board's {MAX_BLOB_SIZE}")]
pub struct CalibrationTooLarge {
    /// Bytes that it would have.
    pub bytes: usize,
}

/// Why a blob is no calibration. Offsets count bytes from the start of the blob.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BlobError {
    /// Fewer bytes than the blob has.
    #[error("{len} bytes are too short for the calibration")]
    TooShort {
        /// Bytes given.
        len: usize,
    },
    /// No calibration at all, such as erased flash: the bytes at offset 0.
    #[error("bytes {found:02X?} at 0 are not the mark {BLOB_MAGIC:02X?} of a calibration")]
    Magic {
        /// The four bytes.
        found: [u8; 4],
    },
    /// Written by a host of another version: the number at offset 4.
    #[error("schema {found} at 4 is not {SCHEMA_VERSION}")]
    Schema {
        /// The schema of the blob.
        found: u16,
    },
    /// The stated length, at offset 6, is no length of a blob.
    #[error("length {found} at 6 is not within {least}…{MAX_BLOB_SIZE}", least = FIXED_PART_SIZE.saturating_add(CRC_SIZE))]
    Length {
        /// The stated length.
        found: u16,
    },
    /// Damaged: the CRC at the end does not fit.
    #[error("the CRC at the end is 0x{stored:08X}, should be 0x{computed:08X}")]
    Crc {
        /// The CRC in the blob.
        stored: u32,
        /// The CRC over the blob.
        computed: u32,
    },
    /// The tool direction is not a unit vector.
    #[error("tool direction {found:?} at {offset} has not the length 1 ({one})", one = ToolDirection::ONE)]
    NotUnit {
        /// Offset of its first component.
        offset: usize,
        /// The components, in 2⁻³⁰.
        found: [i32; 3],
    },
    /// A largest offset is negative, or more than the firmware allows any calibration.
    #[error("largest offset {found} nm at {offset} is not within 0…{MAX_OFFSET_NM} nm")]
    MaxOffset {
        /// Offset of the value.
        offset: usize,
        /// The value in nanometres.
        found: i32,
    },
    /// A slew limit, a link timeout, a hold, a way back or an agreement of a cold machine's thermometers is
    /// more than the firmware allows any calibration.
    #[error("the limit {found} at {offset} is above the firmware's own, {most}")]
    Limit {
        /// Offset of the value.
        offset: usize,
        /// The value, as it lies there.
        found: u32,
        /// The most.
        most: u32,
    },
    /// A number that stands for nothing: of a channel, an axis, a source.
    #[error("{found} at {offset} has no meaning")]
    Value {
        /// Offset of the value.
        offset: usize,
        /// The number that was found there.
        found: u32,
    },
    /// A table that is not in the blob, or that contradicts itself.
    #[error("the table named at {offset} is outside the blob or contradicts itself")]
    Table {
        /// Offset of its reference.
        offset: usize,
    },
}
