//! The numbers of `trueup.dbc` for the code: identifiers, places of signals, scales, cycles.
//!
//! The encoder and the decoder use these constants and no others, and a test holds them against
//! the DBC, so the contract that CAN tools read and the frames on the wire cannot drift apart.

use crate::bits::Signal;

/// Identifier of the offsets on X and Y.
pub const OFFSET_XY_ID: u16 = 0x181;
/// Identifier of the offset on Z, and how good all three are.
pub const OFFSET_Z_ID: u16 = 0x281;
/// Identifier of the bridge's CANopen heartbeat.
pub const HEARTBEAT_ID: u16 = 0x701;
/// Identifier of what the spindle does.
pub const SPINDLE_ID: u16 = 0x202;
/// Identifier of the CNC's sign of life.
pub const CONTROL_ID: u16 = 0x302;

/// Milliseconds from one pair of offset frames to the next.
pub const OFFSET_PERIOD_MS: u32 = 1;
/// Milliseconds from one heartbeat to the next.
pub const HEARTBEAT_PERIOD_MS: u32 = 100;
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
/// CANopen state. Bit 7 of the byte is reserved.
pub const STATE: Signal = Signal::unsigned(0, 7);
/// Spindle speed in r/min.
pub const SPEED: Signal = Signal::unsigned(24, 16);
/// Axial cutting force in newtons.
pub const LOAD: Signal = Signal::signed(40, 16);
/// The operator wants offsets.
pub const ENGAGE: Signal = Signal::unsigned(24, 1);
/// The axes are referenced.
pub const REFERENCED: Signal = Signal::unsigned(25, 1);
/// Take the present error as the reference.
pub const ZERO: Signal = Signal::unsigned(26, 1);

#[cfg(test)]
mod tests {
    use std::{collections::BTreeMap, format, string::String, vec::Vec};

    use can_dbc::{AttributeValue, ByteOrder, Dbc, MessageId, NumericValue, ValueType};

    use super::*;
    use crate::{DBC, e2e, frames::State};
    use trueup_core::{cnc::Quality, units::NANOMETRES_PER_MICROMETRE};

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

    const CONTRACT: [Expected; 5] = [
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
            id: HEARTBEAT_ID,
            name: "Heartbeat",
            sender: "Bridge",
            len: 1,
            period_ms: HEARTBEAT_PERIOD_MS,
            signals: &[("State", STATE, 1.0, "")],
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
        let quality = quality.map(|it| (it as i32, format!("{it:?}"))).collect();
        assert_eq!(names(OFFSET_Z_ID, "Quality"), of(quality));
        let state = (0..=u8::MAX).filter_map(State::from_wire);
        let state = state.map(|it| (it as i32, format!("{it:?}"))).collect();
        assert_eq!(names(HEARTBEAT_ID, "State"), of(state));
        for (id, signal) in
            [(OFFSET_XY_ID, "OffsetX"), (OFFSET_XY_ID, "OffsetY"), (OFFSET_Z_ID, "OffsetZ")]
        {
            let missing = (NOT_AVAILABLE_RAW, String::from("NotAvailable"));
            assert_eq!(names(id, signal), of([missing].into()));
        }
    }

    #[test]
    fn every_protected_frame_states_its_data_id() {
        let dbc = dbc();
        for expected in CONTRACT.iter().filter(|it| it.len == 8) {
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

    #[test]
    fn no_two_signals_of_a_frame_overlap() {
        for expected in &CONTRACT {
            let mut taken = 0_u64;
            for (name, place, ..) in expected.signals {
                let bits = (u64::MAX >> (64 - place.length)) << place.start;
                assert_eq!(taken & bits, 0, "{}.{name}", expected.name);
                taken |= bits;
                let end = u64::from(place.start + place.length);
                assert!(end <= expected.len * 8, "{}.{name}", expected.name);
            }
        }
    }
}
