//! The table against the file, the code, and an independent reader of the file.

use std::{collections::BTreeMap, env, format, fs, path::Path, string::String, vec::Vec};

use can_dbc::{
    AttributeValue, ByteOrder, Dbc, MessageId, MultiplexIndicator, NumericValue, ValueType,
};

use super::{
    dbc::write_dbc,
    frame_table::{FRAMES, FrameSpec, Multiplexing},
    *,
};
use crate::{
    DBC, e2e,
    frames::NmtState,
    status::{FrameRejectReason, ResetReason},
};
use trueup_core::{
    cnc::{OffsetQuality, TravelDirection},
    units::Position,
};

/// With `TRUEUP_WRITE_DBC=1` it writes the file instead.
#[test]
fn the_dbc_file_is_what_the_table_prints() {
    let mut text = String::new();
    write_dbc(&mut text).expect("a string takes everything");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("trueup.dbc");
    if env::var_os("TRUEUP_WRITE_DBC").is_some() {
        fs::write(&path, &text).expect("the crate's folder");
    }
    let file = fs::read_to_string(&path).expect("the file");
    for (number, (file, printed)) in (1..).zip(file.lines().zip(text.lines())) {
        assert_eq!(file, printed, "line {number}");
    }
    assert!(file == text, "write it again: TRUEUP_WRITE_DBC=1 cargo test -p trueup-link dbc");
}

fn dbc() -> Dbc {
    Dbc::try_from(DBC).expect("trueup.dbc parses")
}

fn number(value: NumericValue) -> f64 {
    format!("{value}").parse().unwrap()
}

#[test]
fn an_independent_reader_finds_in_the_file_what_the_code_sends() {
    let dbc = dbc();
    assert_eq!(dbc.messages.len(), FRAMES.len());
    for (message, frame) in dbc.messages.iter().zip(FRAMES) {
        let id = MessageId::Standard(frame.id);
        assert_eq!((message.id, message.name.as_str()), (id, frame.name));
        assert_eq!(message.size, u64::from(frame.len));
        assert_eq!(message.transmitter.as_deref(), Some(frame.sender));
        let cycle = match dbc.message_attribute(id, "GenMsgCycleTime") {
            Some(AttributeValue::Int(ms)) => u32::try_from(*ms).unwrap(),
            Some(AttributeValue::Uint(ms)) => u32::try_from(*ms).unwrap(),
            other => panic!("{}: {other:?}", frame.name),
        };
        assert_eq!(cycle, frame.period_ms, "{}", frame.name);
        assert_eq!(message.signals.len(), frame.signals().count());
        for (signal, spec) in message.signals.iter().zip(frame.signals()) {
            let at = format!("{}.{}", frame.name, spec.name);
            assert_eq!(signal.name, spec.name, "{at}");
            assert_eq!(signal.start_bit, u64::from(spec.place.start), "{at}");
            assert_eq!(signal.size, u64::from(spec.place.length), "{at}");
            assert_eq!(signal.value_type == ValueType::Signed, spec.place.signed, "{at}");
            assert_eq!(signal.byte_order, ByteOrder::LittleEndian, "{at}");
            let factor = f64::from(spec.factor.0) / f64::from(spec.factor.1);
            assert_eq!((signal.factor, signal.offset), (factor, 0.0), "{at}");
            assert_eq!(signal.unit, spec.unit, "{at}");
            let item = match spec.multiplexing {
                Multiplexing::None => MultiplexIndicator::Plain,
                Multiplexing::Selector => MultiplexIndicator::Multiplexor,
                Multiplexing::Item(item) => MultiplexIndicator::MultiplexedSignal(item.into()),
            };
            assert_eq!(signal.multiplexer_indicator, item, "{at}");
            for (raw, bound) in [(spec.range.0, signal.min), (spec.range.1, signal.max)] {
                assert!((raw as f64 * factor - number(bound)).abs() < 1e-9, "{at}");
            }
        }
    }
}

#[test]
fn the_dbc_names_every_value_as_the_code_does() {
    macro_rules! names {
        ($numbers:expr, $enum:ident) => {
            $numbers
                .filter_map($enum::from_wire)
                .map(|value| (value as i64, format!("{value:?}")))
                .collect::<Vec<_>>()
        };
    }
    let dbc = dbc();
    let assert_names = |id: u16, signal: &str, expected: &[(i64, String)]| {
        let names = dbc.value_descriptions_for_signal(MessageId::Standard(id), signal);
        let names = names.unwrap_or_else(|| panic!("{signal} has no names")).iter();
        let names: Vec<_> = names.map(|value| (value.id, value.description.clone())).collect();
        assert_eq!(names, expected, "{signal}");
    };
    for id in [OFFSET_Z_ID, EMERGENCY_ID] {
        assert_names(id, "Quality", &names!(0..=u8::MAX, OffsetQuality));
    }
    assert_names(STATUS_ID, "LastRefused", &names!(0..=u8::MAX, FrameRejectReason));
    assert_names(STATUS_ID, "ResetReason", &names!(0..=u16::MAX, ResetReason));
    assert_names(HEARTBEAT_ID, "State", &names!(0..=u8::MAX, NmtState));
    for id in [POSITION_X_ID, POSITION_Y_ID, POSITION_Z_ID] {
        assert_names(id, "Direction", &names!(i8::MIN..=i8::MAX, TravelDirection));
    }
    let missing = |raw: i32| [(raw.into(), String::from("NotAvailable"))];
    assert_names(OFFSET_XY_ID, "OffsetX", &missing(NO_OFFSET_RAW));
    assert_names(OFFSET_XY_ID, "OffsetY", &missing(NO_OFFSET_RAW));
    assert_names(OFFSET_Z_ID, "OffsetZ", &missing(NO_OFFSET_RAW));
    for channel in 0..8 {
        let signal = format!("Temperature{channel}");
        assert_names(STATUS_ID, &signal, &missing(NO_TEMPERATURE_RAW));
    }
    assert_names(STATUS_ID, "Elongation", &missing(NO_ELONGATION_RAW));
}

#[test]
fn the_protection_lies_where_the_dbc_says() {
    let mut data = [0; 8];
    e2e::protect(0x0181, 0xA5, &mut data);
    assert_eq!(E2E_COUNTER.extract(&data), 0xA5);
    E2E_COUNTER.insert(&mut data, 0);
    CRC.insert(&mut data, 0);
    assert_eq!(data, [0; 8]);
}

#[test]
fn the_offset_range_fills_its_bits_but_for_the_missing_value() {
    for offset in [OFFSET_X, OFFSET_Y, OFFSET_Z] {
        assert_eq!((offset.min_raw(), offset.max_raw()), (NO_OFFSET_RAW, MAX_OFFSET_RAW));
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
        let of =
            |spec: &FrameSpec| bits(spec.len.into())[stuffing] * 1_000 / u64::from(spec.period_ms);
        FRAMES.iter().filter(|frame| frame.period_ms > 0).map(of).sum()
    };
    assert_eq!([load(0), load(1)], [458_980, 558_200]);
    assert!(load(1) * 100 < BITS_PER_SECOND * 60);
    let positions = bits(8)[1] * 1_000 / u64::from(POSITION_PERIOD_MS) * 3;
    let rotary = bits(8)[1] * 1_000 / u64::from(ROTARY_PERIOD_MS);
    assert_eq!([positions, rotary], [202_500, 67_500]);
    assert_eq!(load(1) + positions + rotary, 828_200, "positions every millisecond");
    let service = bits(8)[1] * 1_000 / u64::from(MIN_SERVICE_FRAME_INTERVAL_MS);
    assert_eq!(load(1) + 2 * service, 693_200, "with a bulk transfer");
    assert_eq!(load(1) + positions + rotary + 2 * service, 963_200, "with both");
}

#[test]
fn positions_reach_15_m_in_steps_finer_than_1_um() {
    const MM_PER_BIT: f64 = 1.0 / Position::PER_MILLIMETRE as f64;
    assert!(f64::from(POSITION.max_raw()) * MM_PER_BIT > 15_000.0);
    assert!(f64::from(POSITION.min_raw()) * MM_PER_BIT < -15_000.0);
    const { assert!(MM_PER_BIT < 0.001) };
}

#[test]
fn signals_of_a_frame_overlap_only_between_its_items() {
    for message in dbc().messages {
        // By item; what belongs to none is in all of them.
        let mut taken = BTreeMap::<Option<u64>, u64>::new();
        for signal in message.signals {
            let at = format!("{}.{}", message.name, signal.name);
            let bits = (u64::MAX >> (64 - signal.size)) << signal.start_bit;
            let item = match signal.multiplexer_indicator {
                MultiplexIndicator::MultiplexedSignal(item) => Some(item),
                _ => None,
            };
            let common = taken.get(&None).copied().unwrap_or(0);
            let own = taken.entry(item).or_default();
            assert_eq!((common | *own) & bits, 0, "{at}");
            *own |= bits;
            assert!(signal.start_bit + signal.size <= message.size * 8, "{at}");
        }
    }
}
