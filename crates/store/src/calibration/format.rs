//! The sizes and marks of a blob.

use trueup_link::layout::{NANOMETRES_PER_BIT, OFFSET_MAX_RAW};

/// Bytes of the fixed part.
pub const FIXED_SIZE: usize = 576;
/// The largest blob in bytes: a slot of the board's flash.
pub const MAX_SIZE: usize = 16_384;
/// The first four bytes.
pub const MAGIC: [u8; 4] = *b"TRUP";
/// The layout described here.
pub const SCHEMA: u16 = 3;
/// The largest offset that the frames to the CNC can carry, in nanometres.
pub const MAX_OFFSET_NM: i32 = OFFSET_MAX_RAW * NANOMETRES_PER_BIT;
/// Bytes of the mark, the schema and the length, at the start.
pub(super) const HEAD_SIZE: usize = 8;
/// Bytes of the CRC, at the end.
pub(super) const CRC_SIZE: usize = 4;
/// In place of the number of a channel or of an axis: there is none.
pub(super) const NONE: u32 = 255;
