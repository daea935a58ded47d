//! The sizes and marks of a blob.

use trueup_core::{learned_changes::LearnedLimits, units::Temperature};
use trueup_link::layout::{MAX_OFFSET_RAW, NANOMETRES_PER_BIT};

/// Bytes of the fixed part.
pub(crate) const FIXED_PART_SIZE: usize = 604;
/// The largest blob in bytes: a slot of the board's flash.
pub const MAX_BLOB_SIZE: usize = 16_384;
/// The first four bytes.
pub(crate) const BLOB_MAGIC: [u8; 4] = *b"TRUP";
/// The layout described here.
pub(crate) const SCHEMA_VERSION: u16 = 4;
/// The largest offset of any calibration, in nanometres: 4 mm. An axis of steel of 14.3 m, the longest that
/// was measured, grows by it at 20 K and 14 µm/(m·K); more is no growth, and another calibration's.
pub const MAX_OFFSET_NM: i32 = 4_000_000;
const _: () = assert!(MAX_OFFSET_NM < MAX_OFFSET_RAW * NANOMETRES_PER_BIT, "the wire carries it");
/// The fastest slew limit, in nm/s: 10 mm/s, a hundredth of a millimetre in a tick. Siemens permits a
/// temperature compensation up to 10 % of an axis's speed (MD32760 ≤ 0.10), which this is of 6 m/min.
pub const MAX_SLEW_NM_PER_S: u32 = 10_000_000;
/// The longest link timeout, in ms: a minute. A CNC that is silent for longer is gone.
pub const MAX_LINK_TIMEOUT_MS: u32 = 60_000;
/// The longest hold, in ms: ten minutes, in which a spindle that is not watched takes on most of its
/// heat.
pub const MAX_HOLD_MS: u32 = 600_000;
/// The fastest way back from one source to another, in nm/s: 1 µm/s, as fast as controls follow heat
/// (Heidenhain).
pub const MAX_REJOIN_NM_PER_S: u32 = 1_000;
/// Within how much thermometers of a cold machine may agree at the most: 5 K, as the air of a hall differs
/// over 5 m of height (1 K/m).
pub const MAX_COLD_TOLERANCE: Temperature = Temperature(5 * Temperature::PER_KELVIN);
/// The most that any calibration lets what was learned change: a quarter of the growth and of an expansion, to which
/// a maker knows them, and 20 µm of the zero. A larger change means another machine, which is to be measured.
pub const MAX_LEARNED_LIMITS: LearnedLimits = LearnedLimits { growth: 250, axes: 250, zero: 200 };
/// Bytes of the mark, the schema and the length, at the start.
pub(super) const HEADER_SIZE: usize = 8;
/// Bytes of the CRC, at the end.
pub(super) const CRC_SIZE: usize = 4;
/// In place of the number of a channel or of an axis: there is none.
pub(super) const NO_INDEX: u32 = 255;
