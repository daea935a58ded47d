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
/// The fastest slew limit, in nm/s: 10 mm/s, a hundredth of a millimetre in a tick. Siemens permits a
/// temperature compensation up to 10 % of an axis's speed (MD32760 ≤ 0.10), which this is of 6 m/min.
pub const MAX_SLEW_NM_PER_S: u32 = 10_000_000;
/// The longest link timeout, in ms: a minute. Nobody who is silent for longer is there.
pub const MAX_LINK_TIMEOUT_MS: u32 = 60_000;
/// The longest hold, in ms: ten minutes, in which a spindle that is not watched takes on most of its
/// heat.
pub const MAX_HOLD_MS: u32 = 600_000;
/// Bytes of the mark, the schema and the length, at the start.
pub(super) const HEAD_SIZE: usize = 8;
/// Bytes of the CRC, at the end.
pub(super) const CRC_SIZE: usize = 4;
/// In place of the number of a channel or of an axis: there is none.
pub(super) const NONE: u32 = 255;
