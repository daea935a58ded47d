//! The numbers against the DBC.

use std::{collections::BTreeMap, format, string::String, vec::Vec};

use can_dbc::{
    AttributeValue, ByteOrder, Dbc, MessageId, MultiplexIndicator, NumericValue, ValueType,
};

use super::*;
use crate::{
    DBC, e2e,
    frames::State,
    status::{LAST_ITEM, Reason, ResetReason},
};
use trueup_core::{
    cnc::{Heading, Quality},
    units::{MicroDegrees, NANOMETRES_PER_MICROMETRE, Position},
};

/// Expected entry of one frame in the DBC: its name, sender, length, cycle, and signals with
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

const fn condition(bit: u8) -> Signal {
    Signal::unsigned(CONDITION_0.start + bit, CONDITION_0.length)
}

const CONTRACT: [Expected; 12] = [
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
            ("StateBits", STATE_BITS, 1.0, ""),
            ("ResetReason", COUNT_LOW, 1.0, ""),
            ("FreeStack", COUNT_HIGH, 1.0, "byte"),
            ("CalibrationCrc", CALIBRATION_CRC, 1.0, ""),
            ("OffsetConstantX", OFFSET_CONSTANT, 0.1, "um"),
            ("OffsetSlopeX", OFFSET_SLOPE, 0.1, "um/m"),
            ("OffsetConstantY", OFFSET_CONSTANT, 0.1, "um"),
            ("OffsetSlopeY", OFFSET_SLOPE, 0.1, "um/m"),
            ("OffsetConstantZ", OFFSET_CONSTANT, 0.1, "um"),
            ("OffsetSlopeZ", OFFSET_SLOPE, 0.1, "um/m"),
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
            ("Service", SERVICE, 1.0, ""),
            ("Confirm", CONFIRM, 1.0, ""),
            ("LearnedPart", LEARNED_PART, 1.0, ""),
            ("Learned", LEARNED, 0.001, ""),
            ("LearnedCrc", LEARNED_CRC, 1.0, ""),
        ],
    },
    Expected {
        id: CONDITIONS_ID,
        name: "Conditions",
        sender: "CNC",
        len: 8,
        period_ms: CONDITIONS_PERIOD_MS,
        signals: &[
            ("Crc", CRC, 1.0, ""),
            ("Counter", COUNTER, 1.0, ""),
            ("Tool", TOOL, 1.0, ""),
            ("Condition0", condition(0), 1.0, ""),
            ("Condition1", condition(1), 1.0, ""),
            ("Condition2", condition(2), 1.0, ""),
            ("Condition3", condition(3), 1.0, ""),
            ("Condition4", condition(4), 1.0, ""),
            ("Condition5", condition(5), 1.0, ""),
            ("Condition6", condition(6), 1.0, ""),
            ("Condition7", condition(7), 1.0, ""),
            ("Condition8", condition(8), 1.0, ""),
            ("Condition9", condition(9), 1.0, ""),
            ("Condition10", condition(10), 1.0, ""),
            ("Condition11", condition(11), 1.0, ""),
            ("Condition12", condition(12), 1.0, ""),
            ("Condition13", condition(13), 1.0, ""),
            ("Condition14", condition(14), 1.0, ""),
            ("Condition15", condition(15), 1.0, ""),
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
                // Patterns of 32 bits, which an `i32` cannot count.
                "StateBits" | "CalibrationCrc" => {
                    assert_eq!(number(signal.min), 0.0, "{at}");
                    assert_eq!(number(signal.max), f64::from(u32::MAX), "{at}");
                    continue;
                }
                "ResetReason" => (0, ResetReason::Crystal as i32),
                "OffsetX" | "OffsetY" | "OffsetZ" => (-OFFSET_MAX_RAW, OFFSET_MAX_RAW),
                "Quality" => (0, Quality::Fault as i32),
                "Item" => (0, LAST_ITEM.into()),
                "LastRefused" => (0, Reason::WrongSequence as i32),
                name if name.starts_with("Temperature") || name.starts_with("OffsetConstant") => {
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
    let resets = (0..=u16::MAX).filter_map(ResetReason::from_wire);
    let resets = resets.map(|it| (it as i32, format!("{it:?}"))).collect();
    assert_eq!(names(STATUS_ID, "ResetReason"), of(resets));
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
    assert_eq!([load(0), load(1)], [458_980, 558_200]);
    assert!(load(1) * 100 < BITS_PER_SECOND * 60);
    let positions = bits(8)[1] * 1_000 / u64::from(POSITION_PERIOD_MS) * 3;
    let rotary = bits(8)[1] * 1_000 / u64::from(ROTARY_PERIOD_MS);
    assert_eq!([positions, rotary], [202_500, 67_500]);
    assert_eq!(load(1) + positions + rotary, 828_200, "positions every millisecond");
    let service = bits(8)[1] * 1_000 / u64::from(SERVICE_PERIOD_MS);
    assert_eq!(load(1) + 2 * service, 693_200, "with a bulk transfer");
    assert_eq!(load(1) + positions + rotary + 2 * service, 963_200, "with both");
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
