//! The numbers of `trueup.dbc` for the code: identifiers, places of signals, scales, cycles.
//!
//! The encoder and the decoder use these constants and no others. Those of frames and signals follow
//! from `table`, and a test holds the DBC against what `dbc` prints from it, so the contract that
//! CAN tools read and the frames on the wire cannot drift apart.
//!
//! # Load of the bus
//!
//! A standard frame of `n` data bytes has 47 + 8·n bits, the pause of 3 bits after it included.
//! Of these, 34 + 8·n are stuffed: at worst one more bit after the first 4 of them and after every
//! further 4 but the last, ⌊(34 + 8·n − 1) / 4⌋ in all. So 8 bytes are 111 bits, 135 at worst, and
//! the heartbeat's single byte is 55 bits, 65 at worst. At 1 Mbit/s, with every frame as often as
//! its period permits:
//!
//! | frames | a second | bits a second at worst | share |
//! |---|---|---|---|
//! | `OffsetXY`, `OffsetZ` | 2 × 1000 | 270 000 | 27.00 % |
//! | `PositionX`, `PositionY`, `PositionZ` | 3 × 500 | 202 500 | 20.25 % |
//! | `Rotary` | 500 | 67 500 | 6.75 % |
//! | `Spindle`, `Control` | 2 × 50 | 13 500 | 1.35 % |
//! | `Conditions` | 20 | 2 700 | 0.27 % |
//! | `Status` | 10 | 1 350 | 0.14 % |
//! | `Heartbeat` | 10 | 650 | 0.07 % |
//! | all of these | | 558 200 | 55.82 % |
//! | emergencies and answers to SDO requests, with the two above | 500 | 67 500 | 6.75 % |
//! | SDO requests, each after the answer to the one before | 500 | 67 500 | 6.75 % |
//! | all, the two above counted once more | | 693 200 | 69.32 % |
//!
//! Without any stuffing the cyclic frames are 45.90 %. Whatever the bridge has to say besides waits
//! until its turn: one frame every 2 ms, so that a bulk transfer cannot delay an offset. A CNC that
//! sends its positions every millisecond would bring the worst case to 83 %, 96 % with a transfer.

#[cfg(test)]
mod dbc;
mod frame_table;

pub use frame_table::*;

/// Identifier of what a CANopen master commands to all nodes or one: network management.
pub const NMT_ID: u16 = 0x000;
/// Identifier of what a CANopen master asks: an SDO, client to server.
pub const SDO_REQUEST_ID: u16 = 0x601;
/// Identifier of what the bridge answers: an SDO, server to client.
pub const SDO_RESPONSE_ID: u16 = 0x581;

/// Milliseconds from one pair of offset frames to the next.
pub const OFFSET_PERIOD_MS: u32 = 1;
/// Milliseconds from one heartbeat to the next.
pub const HEARTBEAT_PERIOD_MS: u32 = 100;
/// Milliseconds from one status frame to the next.
pub const STATUS_PERIOD_MS: u32 = 100;
/// Shortest time in milliseconds between two frames of the bridge other than offsets.
pub const MIN_SERVICE_FRAME_INTERVAL_MS: u32 = 2;
/// Shortest time in milliseconds between two emergencies, until a master sets another.
pub const EMERGENCY_INHIBIT_TIME_MS: u32 = 10;
/// Shortest time in milliseconds between two position frames of one axis.
pub const POSITION_PERIOD_MS: u32 = 2;
/// Shortest time in milliseconds between two `Rotary` frames.
pub const ROTARY_PERIOD_MS: u32 = 2;
/// Shortest time in milliseconds between two `Spindle` frames.
pub const SPINDLE_PERIOD_MS: u32 = 20;
/// Shortest time in milliseconds between two `Control` frames.
pub const CONTROL_PERIOD_MS: u32 = 20;
/// Shortest time in milliseconds between two `Conditions` frames.
pub const CONDITIONS_PERIOD_MS: u32 = 50;

/// Nanometres in one bit of an offset.
pub const NANOMETRES_PER_BIT: i32 = 10;
/// The largest offset on the wire either way, in bits: ±5.242 87 mm.
pub const MAX_OFFSET_RAW: i32 = 524_287;
/// The raw offset that means "not available".
pub const NO_OFFSET_RAW: i32 = -524_288;
/// Micro-degrees in one bit of an angle.
pub const MICRO_DEGREES_PER_BIT: i32 = 500;

/// The raw temperature that means "not available".
pub const NO_TEMPERATURE_RAW: i32 = -32_768;
/// The raw elongation that means "not available".
pub const NO_ELONGATION_RAW: i32 = i32::MIN;
/// The raw constant that means "not available".
pub const NO_OFFSET_CONSTANT_RAW: i32 = -32_768;

#[cfg(test)]
mod tests;
