//! The numbers of `trueup.dbc` for the code: identifiers, places of signals, scales, cycles.
//!
//! The encoder and the decoder use these constants and no others, and a test holds them against
//! the DBC, so the contract that CAN tools read and the frames on the wire cannot drift apart.
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

use crate::bits::Signal;

/// Identifier of the offsets on X and Y.
pub const OFFSET_XY_ID: u16 = 0x181;
/// Identifier of the offset on Z, and how good all three are.
pub const OFFSET_Z_ID: u16 = 0x281;
/// Identifier of what the bridge says of itself: temperatures, counts, one item a frame.
pub const STATUS_ID: u16 = 0x381;
/// Identifier of what a CANopen master commands to all nodes or one: network management.
pub const NMT_ID: u16 = 0x000;
/// Identifier of the bridge's CANopen heartbeat.
pub const HEARTBEAT_ID: u16 = 0x701;
/// Identifier of the bridge's CANopen emergencies.
pub const EMERGENCY_ID: u16 = 0x081;
/// Identifier of what a CANopen master asks: an SDO, client to server.
pub const SDO_REQUEST_ID: u16 = 0x601;
/// Identifier of what the bridge answers: an SDO, server to client.
pub const SDO_ANSWER_ID: u16 = 0x581;
/// Identifier of where X is sent.
pub const POSITION_X_ID: u16 = 0x201;
/// Identifier of where Y is sent.
pub const POSITION_Y_ID: u16 = 0x301;
/// Identifier of where Z is sent.
pub const POSITION_Z_ID: u16 = 0x401;
/// Identifier of where the rotary axes are sent.
pub const ROTARY_ID: u16 = 0x501;
/// Identifier of what the spindle does.
pub const SPINDLE_ID: u16 = 0x202;
/// Identifier of the CNC's sign of life.
pub const CONTROL_ID: u16 = 0x302;
/// Identifier of the tool and the conditions of the machine.
pub const CONDITIONS_ID: u16 = 0x402;

/// Milliseconds from one pair of offset frames to the next.
pub const OFFSET_PERIOD_MS: u32 = 1;
/// Milliseconds from one heartbeat to the next.
pub const HEARTBEAT_PERIOD_MS: u32 = 100;
/// Milliseconds from one status frame to the next.
pub const STATUS_PERIOD_MS: u32 = 100;
/// Shortest time in milliseconds between two frames of the bridge other than offsets.
pub const SERVICE_PERIOD_MS: u32 = 2;
/// Shortest time in milliseconds between two emergencies, until a master sets another.
pub const EMERGENCY_INHIBIT_MS: u32 = 10;
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
pub const OFFSET_MAX_RAW: i32 = 524_287;
/// The raw offset that means "not available".
pub const NOT_AVAILABLE_RAW: i32 = -524_288;
/// Micro-degrees in one bit of an angle.
pub const MICRO_DEGREES_PER_BIT: i32 = 500;

/// E2E CRC, in every protected frame.
pub const CRC: Signal = Signal::unsigned(0, 16);
/// E2E counter, in every protected frame.
pub const COUNTER: Signal = Signal::unsigned(16, 8);
/// Offset on X.
pub const OFFSET_X: Signal = Signal::signed(24, 20);
/// Offset on Y.
pub const OFFSET_Y: Signal = Signal::signed(44, 20);
/// Offset on Z.
pub const OFFSET_Z: Signal = Signal::signed(24, 20);
/// How good the offsets are.
pub const QUALITY: Signal = Signal::unsigned(44, 4);
/// Why the offsets are not simply the full correction.
pub const FLAGS: Signal = Signal::unsigned(48, 8);
/// Age of the newest sample in milliseconds.
pub const AGE: Signal = Signal::unsigned(56, 8);
/// Item of a status frame: 0…13, see [`crate::status::Item`].
pub const ITEM: Signal = Signal::unsigned(24, 4);
/// Why a frame of the CNC was last refused.
pub const LAST_REFUSED: Signal = Signal::unsigned(28, 4);
/// The first of a status frame's two temperatures, in 0.01 °C.
pub const TEMPERATURE_LOW: Signal = Signal::signed(32, 16);
/// The second one.
pub const TEMPERATURE_HIGH: Signal = Signal::signed(48, 16);
/// The raw temperature that means "not available".
pub const NO_TEMPERATURE_RAW: i32 = -32_768;
/// The elongation of the spindle in nanometres.
pub const ELONGATION: Signal = Signal::signed(32, 32);
/// The raw elongation that means "not available".
pub const NO_ELONGATION_RAW: i32 = i32::MIN;
/// The first of a status frame's two counts.
pub const COUNT_LOW: Signal = Signal::unsigned(32, 16);
/// The second one.
pub const COUNT_HIGH: Signal = Signal::unsigned(48, 16);
/// Conditions of the bridge that a CNC must know in addition to the offsets, a bit each.
pub const STATE_BITS: Signal = Signal::unsigned(32, 32);
/// CRC of the running calibration.
pub const CALIBRATION_CRC: Signal = Signal::unsigned(32, 32);
/// The constant of an axis's offset, in 0.1 µm.
pub const OFFSET_CONSTANT: Signal = Signal::signed(32, 16);
/// The raw constant that means "not available".
pub const NO_CONSTANT_RAW: i32 = -32_768;
/// The slope of an axis's offset, in 0.1 µm/m.
pub const OFFSET_SLOPE: Signal = Signal::signed(48, 16);
/// CANopen state. Bit 7 of the byte is reserved.
pub const STATE: Signal = Signal::unsigned(0, 7);
/// Error code of an emergency; 0: a fault has gone.
pub const EMERGENCY_CODE: Signal = Signal::unsigned(0, 16);
/// CANopen error register.
pub const EMERGENCY_REGISTER: Signal = Signal::unsigned(16, 8);
/// Which fault has come or gone.
pub const EMERGENCY_FAULT: Signal = Signal::unsigned(24, 8);
/// The flags of that moment.
pub const EMERGENCY_FLAGS: Signal = Signal::unsigned(32, 8);
/// The quality of that moment.
pub const EMERGENCY_QUALITY: Signal = Signal::unsigned(40, 8);
/// Spindle speed in r/min.
pub const SPEED: Signal = Signal::unsigned(24, 16);
/// Axial cutting force in newtons.
pub const LOAD: Signal = Signal::signed(40, 16);
/// Position of a linear axis: one bit is one unit of [`Position`](trueup_core::units::Position).
pub const POSITION: Signal = Signal::signed(24, 32);
/// Which way that axis travels.
pub const DIRECTION: Signal = Signal::signed(56, 2);
/// Angle of the first rotary axis, counted from the frame to the tool.
pub const ANGLE_1: Signal = Signal::signed(24, 20);
/// Angle of the second one.
pub const ANGLE_2: Signal = Signal::signed(44, 20);
/// The operator wants offsets.
pub const ENGAGE: Signal = Signal::unsigned(24, 1);
/// The axes are referenced.
pub const REFERENCED: Signal = Signal::unsigned(25, 1);
/// Take the present error as the reference.
pub const ZERO: Signal = Signal::unsigned(26, 1);
/// The operator is at the machine and allows what a master writes, while nothing is engaged.
pub const SERVICE: Signal = Signal::unsigned(27, 1);
/// The operator answers the question that the state bits ask.
pub const CONFIRM: Signal = Signal::unsigned(28, 1);
/// Which part of the correction what was learned is about, 1…5; 0: nothing was.
pub const LEARNED_PART: Signal = Signal::unsigned(29, 3);
/// By this much that part is more than the calibration says, in 10⁻⁵ of itself; its zero in nm.
pub const LEARNED: Signal = Signal::signed(32, 16);
/// The lower half of the CRC of that calibration.
pub const LEARNED_CRC: Signal = Signal::unsigned(48, 16);
/// The number of the tool in the spindle; 0: none.
pub const TOOL: Signal = Signal::unsigned(24, 16);
/// The first of the conditions; the others follow, a bit each.
pub const CONDITION_0: Signal = Signal::unsigned(40, 1);
/// All conditions.
pub const CONDITIONS: Signal = Signal::unsigned(CONDITION_0.start, 16);

#[cfg(test)]
mod tests;
