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
//! | `Status` | 10 | 1 350 | 0.14 % |
//! | `Heartbeat` | 10 | 650 | 0.07 % |
//! | all of these | | 555 500 | 55.55 % |
//! | emergencies and answers to SDO requests, with the two above | 500 | 67 500 | 6.75 % |
//! | SDO requests, each after the answer to the one before | 500 | 67 500 | 6.75 % |
//! | all, the two above counted once more | | 690 500 | 69.05 % |
//!
//! Without any stuffing the cyclic frames are 45.68 %. Whatever the bridge has to say besides waits
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
/// What a status frame is about: 0…7, see [`crate::status::Item`].
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

#[cfg(test)]
mod tests {
    use std::{collections::BTreeMap, format, string::String, vec::Vec};

    use can_dbc::{
        AttributeValue, ByteOrder, Dbc, MessageId, MultiplexIndicator, NumericValue, ValueType,
    };

    use super::*;
    use crate::{
        DBC, e2e,
        frames::State,
        status::{LAST_ITEM, Reason},
    };
    use trueup_core::{
        cnc::{Heading, Quality},
        units::{MicroDegrees, NANOMETRES_PER_MICROMETRE, Position},
    };

    /// What the DBC must say of one frame: its name, sender, length, cycle, and signals with
    /// their place, scale and unit.
    struct Expected {
        id: u16,
        name: &'static str,
        sender: &'static str,
        len: u64,
        period_ms: u32,
        signals: &'static [(&'static str, Signal, f64, &'static str)],
    }

    const UM_PER_BIT: f64 = NANOMETRES_PER_BIT as f64 / NANOMETRES_PER_MICROMETRE as f64;

    const MM_PER_BIT: f64 = 1.0 / Position::PER_MILLIMETRE as f64;
    const DEG_PER_BIT: f64 = MICRO_DEGREES_PER_BIT as f64 / MicroDegrees::PER_DEGREE as f64;

    const fn position(id: u16, name: &'static str) -> Expected {
        Expected {
            id,
            name,
            sender: "CNC",
            len: 8,
            period_ms: POSITION_PERIOD_MS,
            signals: &[
                ("Crc", CRC, 1.0, ""),
                ("Counter", COUNTER, 1.0, ""),
                ("Position", POSITION, MM_PER_BIT, "mm"),
                ("Direction", DIRECTION, 1.0, ""),
            ],
        }
    }

    const CONTRACT: [Expected; 11] = [
        Expected {
            id: OFFSET_XY_ID,
            name: "OffsetXY",
            sender: "Bridge",
            len: 8,
            period_ms: OFFSET_PERIOD_MS,
            signals: &[
                ("Crc", CRC, 1.0, ""),
                ("Counter", COUNTER, 1.0, ""),
                ("OffsetX", OFFSET_X, UM_PER_BIT, "um"),
                ("OffsetY", OFFSET_Y, UM_PER_BIT, "um"),
            ],
        },
        Expected {
            id: OFFSET_Z_ID,
            name: "OffsetZ",
            sender: "Bridge",
            len: 8,
            period_ms: OFFSET_PERIOD_MS,
            signals: &[
                ("Crc", CRC, 1.0, ""),
                ("Counter", COUNTER, 1.0, ""),
                ("OffsetZ", OFFSET_Z, UM_PER_BIT, "um"),
                ("Quality", QUALITY, 1.0, ""),
                ("Flags", FLAGS, 1.0, ""),
                ("Age", AGE, 1.0, "ms"),
            ],
        },
        Expected {
            id: STATUS_ID,
            name: "Status",
            sender: "Bridge",
            len: 8,
            period_ms: STATUS_PERIOD_MS,
            signals: &[
                ("Crc", CRC, 1.0, ""),
                ("Counter", COUNTER, 1.0, ""),
                ("Item", ITEM, 1.0, ""),
                ("LastRefused", LAST_REFUSED, 1.0, ""),
                ("Temperature0", TEMPERATURE_LOW, 0.01, "degC"),
                ("Temperature1", TEMPERATURE_HIGH, 0.01, "degC"),
                ("Temperature2", TEMPERATURE_LOW, 0.01, "degC"),
                ("Temperature3", TEMPERATURE_HIGH, 0.01, "degC"),
                ("Temperature4", TEMPERATURE_LOW, 0.01, "degC"),
                ("Temperature5", TEMPERATURE_HIGH, 0.01, "degC"),
                ("Temperature6", TEMPERATURE_LOW, 0.01, "degC"),
                ("Temperature7", TEMPERATURE_HIGH, 0.01, "degC"),
                ("Elongation", ELONGATION, 0.001, "um"),
                ("Damaged", COUNT_LOW, 1.0, ""),
                ("OutOfSequence", COUNT_HIGH, 1.0, ""),
                ("Malformed", COUNT_LOW, 1.0, ""),
                ("Lost", COUNT_HIGH, 1.0, ""),
                ("Noise", COUNT_LOW, 0.001, ""),
                ("Faults", COUNT_HIGH, 1.0, ""),
            ],
        },
        Expected {
            id: HEARTBEAT_ID,
            name: "Heartbeat",
            sender: "Bridge",
            len: 1,
            period_ms: HEARTBEAT_PERIOD_MS,
            signals: &[("State", STATE, 1.0, "")],
        },
        Expected {
            id: EMERGENCY_ID,
            name: "Emergency",
            sender: "Bridge",
            len: 8,
            // By the event alone.
            period_ms: 0,
            signals: &[
                ("ErrorCode", EMERGENCY_CODE, 1.0, ""),
                ("ErrorRegister", EMERGENCY_REGISTER, 1.0, ""),
                ("Fault", EMERGENCY_FAULT, 1.0, ""),
                ("Flags", EMERGENCY_FLAGS, 1.0, ""),
                ("Quality", EMERGENCY_QUALITY, 1.0, ""),
            ],
        },
        position(POSITION_X_ID, "PositionX"),
        position(POSITION_Y_ID, "PositionY"),
        position(POSITION_Z_ID, "PositionZ"),
        Expected {
            id: ROTARY_ID,
            name: "Rotary",
            sender: "CNC",
            len: 8,
            period_ms: ROTARY_PERIOD_MS,
            signals: &[
                ("Crc", CRC, 1.0, ""),
                ("Counter", COUNTER, 1.0, ""),
                ("Angle1", ANGLE_1, DEG_PER_BIT, "deg"),
                ("Angle2", ANGLE_2, DEG_PER_BIT, "deg"),
            ],
        },
        Expected {
            id: SPINDLE_ID,
            name: "Spindle",
            sender: "CNC",
            len: 8,
            period_ms: SPINDLE_PERIOD_MS,
            signals: &[
                ("Crc", CRC, 1.0, ""),
                ("Counter", COUNTER, 1.0, ""),
                ("Speed", SPEED, 1.0, "r/min"),
                ("Load", LOAD, 1.0, "N"),
            ],
        },
        Expected {
            id: CONTROL_ID,
            name: "Control",
            sender: "CNC",
            len: 8,
            period_ms: CONTROL_PERIOD_MS,
            signals: &[
                ("Crc", CRC, 1.0, ""),
                ("Counter", COUNTER, 1.0, ""),
                ("Engage", ENGAGE, 1.0, ""),
                ("Referenced", REFERENCED, 1.0, ""),
                ("Zero", ZERO, 1.0, ""),
            ],
        },
    ];

    fn dbc() -> Dbc {
        Dbc::try_from(DBC).expect("trueup.dbc parses")
    }

    fn number(value: NumericValue) -> f64 {
        format!("{value}").parse().unwrap()
    }

    #[test]
    fn the_dbc_has_exactly_the_frames_and_signals_of_the_code_in_the_same_places() {
        let dbc = dbc();
        assert_eq!(dbc.messages.len(), CONTRACT.len());
        for expected in &CONTRACT {
            let id = MessageId::Standard(expected.id);
            let message = dbc.messages.iter().find(|message| message.id == id);
            let message = message.unwrap_or_else(|| panic!("{} is missing", expected.name));
            assert_eq!(message.name, expected.name);
            assert_eq!(message.size, expected.len);
            assert_eq!(message.transmitter.as_deref(), Some(expected.sender));
            assert_eq!(message.signals.len(), expected.signals.len());
            for (name, place, factor, unit) in expected.signals {
                let at = format!("{}.{name}", expected.name);
                let signal = message.signals.iter().find(|signal| signal.name == *name);
                let signal = signal.unwrap_or_else(|| panic!("{at} is missing"));
                assert_eq!(signal.start_bit, u64::from(place.start), "{at}");
                assert_eq!(signal.size, u64::from(place.length), "{at}");
                assert_eq!(signal.value_type == ValueType::Signed, place.signed, "{at}");
                assert_eq!(signal.byte_order, ByteOrder::LittleEndian, "{at}");
                assert_eq!(signal.factor, *factor, "{at}");
                assert_eq!(signal.offset, 0.0, "{at}");
                assert_eq!(signal.unit, *unit, "{at}");
            }
        }
    }

    #[test]
    fn the_dbc_ranges_are_what_the_code_sends() {
        let dbc = dbc();
        for message in &dbc.messages {
            for signal in &message.signals {
                let at = format!("{}.{}", message.name, signal.name);
                let expected = CONTRACT.iter().find(|it| it.name == message.name).unwrap();
                let place = expected.signals.iter().find(|it| it.0 == signal.name).unwrap().1;
                let (min, max) = match signal.name.as_str() {
                    "OffsetX" | "OffsetY" | "OffsetZ" => (-OFFSET_MAX_RAW, OFFSET_MAX_RAW),
                    "Quality" => (0, Quality::Fault as i32),
                    "Item" => (0, LAST_ITEM.into()),
                    "LastRefused" => (0, Reason::WrongSequence as i32),
                    name if name.starts_with("Temperature") => {
                        (-i32::from(i16::MAX), i16::MAX.into())
                    }
                    "Elongation" => (-i32::MAX, i32::MAX),
                    "Direction" => (Heading::Negative as i32, Heading::Positive as i32),
                    _ => (place.min(), place.max()),
                };
                let near = |raw: i32, bound| (f64::from(raw) * signal.factor - number(bound)).abs();
                assert!(near(min, signal.min) < 1e-9, "{at}");
                assert!(near(max, signal.max) < 1e-9, "{at}");
            }
        }
    }

    #[test]
    fn the_dbc_cycle_times_are_those_of_the_code() {
        let dbc = dbc();
        for expected in &CONTRACT {
            let id = MessageId::Standard(expected.id);
            let cycle = match dbc.message_attribute(id, "GenMsgCycleTime") {
                Some(AttributeValue::Int(ms)) => u32::try_from(*ms).unwrap(),
                Some(AttributeValue::Uint(ms)) => u32::try_from(*ms).unwrap(),
                other => panic!("{}: {other:?}", expected.name),
            };
            assert_eq!(cycle, expected.period_ms, "{}", expected.name);
        }
    }

    #[test]
    fn the_dbc_names_every_value_as_the_code_does() {
        let dbc = dbc();
        let names = |id: u16, signal: &str| -> BTreeMap<i64, String> {
            dbc.value_descriptions_for_signal(MessageId::Standard(id), signal)
                .unwrap_or_else(|| panic!("{signal} has no names"))
                .iter()
                .map(|value| (value.id, value.description.clone()))
                .collect()
        };
        let of = |pairs: Vec<(i32, String)>| -> BTreeMap<i64, String> {
            pairs.into_iter().map(|(raw, name)| (raw.into(), name)).collect()
        };
        let quality = (0..=u8::MAX).filter_map(Quality::from_wire);
        let quality: Vec<_> = quality.map(|it| (it as i32, format!("{it:?}"))).collect();
        for id in [OFFSET_Z_ID, EMERGENCY_ID] {
            assert_eq!(names(id, "Quality"), of(quality.clone()));
        }
        let reasons = (0..=u8::MAX).filter_map(Reason::from_wire);
        let reasons = reasons.map(|it| (it as i32, format!("{it:?}"))).collect();
        assert_eq!(names(STATUS_ID, "LastRefused"), of(reasons));
        let state = (0..=u8::MAX).filter_map(State::from_wire);
        let state = state.map(|it| (it as i32, format!("{it:?}"))).collect();
        assert_eq!(names(HEARTBEAT_ID, "State"), of(state));
        let headings: BTreeMap<_, _> = (i8::MIN..=i8::MAX)
            .filter_map(Heading::from_wire)
            .map(|it| (it as i64, format!("{it:?}")))
            .collect();
        for id in [POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID] {
            assert_eq!(names(id, "Direction"), headings);
        }
        for (id, signal) in
            [(OFFSET_XY_ID, "OffsetX"), (OFFSET_XY_ID, "OffsetY"), (OFFSET_Z_ID, "OffsetZ")]
        {
            let missing = (NOT_AVAILABLE_RAW, String::from("NotAvailable"));
            assert_eq!(names(id, signal), of([missing].into()));
        }
        for channel in 0..8 {
            let missing = (NO_TEMPERATURE_RAW, String::from("NotAvailable"));
            let signal = format!("Temperature{channel}");
            assert_eq!(names(STATUS_ID, &signal), of([missing].into()));
        }
        let missing = (NO_ELONGATION_RAW, String::from("NotAvailable"));
        assert_eq!(names(STATUS_ID, "Elongation"), of([missing].into()));
    }

    #[test]
    fn every_protected_frame_states_its_data_id() {
        let dbc = dbc();
        let is_protected = |it: &&Expected| it.signals.iter().any(|signal| signal.0 == "Crc");
        for expected in CONTRACT.iter().filter(is_protected) {
            let comment = dbc.message_comment(MessageId::Standard(expected.id)).unwrap();
            let data_id = format!("E2E profile 5, data ID 0x{:04X}.", expected.id);
            assert!(comment.ends_with(&data_id), "{}: {comment}", expected.name);
        }
    }

    #[test]
    fn the_protection_lies_where_the_dbc_says() {
        let mut data = [0; 8];
        e2e::protect(0x0181, 0xA5, &mut data);
        assert_eq!(COUNTER.extract(&data), 0xA5);
        COUNTER.insert(&mut data, 0);
        CRC.insert(&mut data, 0);
        assert_eq!(data, [0; 8]);
    }

    #[test]
    fn the_offset_range_fills_its_bits_but_for_the_missing_value() {
        for offset in [OFFSET_X, OFFSET_Y, OFFSET_Z] {
            assert_eq!((offset.min(), offset.max()), (NOT_AVAILABLE_RAW, OFFSET_MAX_RAW));
        }
    }

    /// Bits of a frame with `len` data bytes, without stuffing and at worst stuffing.
    fn bits(len: u64) -> [u64; 2] {
        let stuffed = 34 + 8 * len;
        // Delimiters, acknowledge, end of frame, and the pause before the next.
        let plain = stuffed + 13;
        [plain, plain + (stuffed - 1) / 4]
    }

    #[test]
    fn every_frame_as_often_as_permitted_fills_56_percent_of_the_bus_at_worst_stuffing() {
        const BITS_PER_SECOND: u64 = 1_000_000;
        assert_eq!([bits(8), bits(1)], [[111, 135], [55, 65]]);
        let load = |stuffing: usize| -> u64 {
            let of = |it: &Expected| bits(it.len)[stuffing] * 1_000 / u64::from(it.period_ms);
            CONTRACT.iter().filter(|it| it.period_ms > 0).map(of).sum()
        };
        assert_eq!([load(0), load(1)], [456_760, 555_500]);
        assert!(load(1) * 100 < BITS_PER_SECOND * 60);
        let positions = bits(8)[1] * 1_000 / u64::from(POSITION_PERIOD_MS) * 3;
        let rotary = bits(8)[1] * 1_000 / u64::from(ROTARY_PERIOD_MS);
        assert_eq!([positions, rotary], [202_500, 67_500]);
        assert_eq!(load(1) + positions + rotary, 825_500, "positions every millisecond");
        let service = bits(8)[1] * 1_000 / u64::from(SERVICE_PERIOD_MS);
        assert_eq!(load(1) + 2 * service, 690_500, "with a bulk transfer");
        assert_eq!(load(1) + positions + rotary + 2 * service, 960_500, "with both");
    }

    #[test]
    fn positions_reach_15_m_in_steps_finer_than_1_um() {
        assert!(f64::from(POSITION.max()) * MM_PER_BIT > 15_000.0);
        assert!(f64::from(POSITION.min()) * MM_PER_BIT < -15_000.0);
        const { assert!(MM_PER_BIT < 0.001) };
    }

    #[test]
    fn signals_of_a_frame_overlap_only_between_its_items() {
        let dbc = dbc();
        for expected in &CONTRACT {
            let message = dbc.messages.iter().find(|it| it.name == expected.name).unwrap();
            // By item; what belongs to none is in all of them.
            let mut taken = BTreeMap::<Option<u64>, u64>::new();
            for (name, place, ..) in expected.signals {
                let bits = (u64::MAX >> (64 - place.length)) << place.start;
                let signal = message.signals.iter().find(|it| it.name == *name).unwrap();
                let item = match signal.multiplexer_indicator {
                    MultiplexIndicator::MultiplexedSignal(item) => Some(item),
                    _ => None,
                };
                let common = taken.get(&None).copied().unwrap_or(0);
                let own = taken.entry(item).or_default();
                assert_eq!((common | *own) & bits, 0, "{}.{name}", expected.name);
                *own |= bits;
                let end = u64::from(place.start + place.length);
                assert!(end <= expected.len * 8, "{}.{name}", expected.name);
            }
        }
    }
}
