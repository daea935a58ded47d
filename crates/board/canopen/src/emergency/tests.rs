//! Each fault is reported once when it comes and once when it has gone.

use super::*;
use can_dbc::{Dbc, MessageId};
use std::{
    collections::{BTreeMap, BTreeSet},
    format,
    vec::Vec,
};
use trueup_link::status::StateBits;

/// Code, register and number of whatever is reported in this many milliseconds of these faults.
fn emergencies_after(all: &mut EmergencyProducer, now: Faults, ms: u32) -> Vec<(u16, u8, u8)> {
    let output = Output::default();
    let mut frames = Vec::new();
    for _ in 0..ms {
        all.update(1, now);
        frames.extend(all.next_frame(now, &output));
    }
    let fields = |frame: &Frame| {
        let data = frame.data();
        (u16::from_le_bytes([data[0], data[1]]), data[2], data[3])
    };
    frames.iter().map(fields).collect()
}

#[test]
fn every_fault_has_a_code_of_its_own_and_stands_at_its_number() {
    let codes: BTreeSet<u16> = Fault::ALL.map(Fault::code).into();
    assert_eq!(codes.len(), Fault::ALL.len());
    assert!(!codes.contains(&0));
    for (number, fault) in Fault::ALL.into_iter().enumerate() {
        assert_eq!(fault as usize, number);
    }
}

#[test]
fn the_dbc_names_every_fault_by_its_number() {
    let dbc = Dbc::try_from(trueup_link::DBC).expect("a DBC");
    let id = MessageId::Standard(EMERGENCY_ID);
    let names = dbc.value_descriptions_for_signal(id, "Fault").expect("names of faults");
    let named: BTreeMap<_, _> =
        names.iter().map(|value| (value.id, value.description.clone())).collect();
    let ours = Fault::ALL.map(|fault| (i64::from(fault as u8), format!("{fault:?}")));
    assert_eq!(named, ours.into());
}

#[test]
fn each_fault_is_reported_when_it_comes_and_when_it_has_gone() {
    for fault in Fault::ALL {
        let mut all = EmergencyProducer::default();
        let there = Faults::default().with_fault_if(true, fault);
        let (code, number) = (fault.code(), fault as u8);
        assert_eq!(
            emergencies_after(&mut all, there, 100),
            [(code, 1 | fault.error_register_bit(), number)]
        );
        assert_eq!(emergencies_after(&mut all, Faults::default(), 100), [(0, 0, number)]);
        assert_eq!(emergencies_after(&mut all, Faults::default(), 100), []);
        assert_eq!(all.history_entry(0), Some(u32::from(code) | u32::from(number) << 16));
    }
}

#[test]
fn a_fault_that_flickers_is_reported_no_more_often_than_the_inhibit_time_permits() {
    let mut all = EmergencyProducer::default();
    let there = Faults::default().with_fault_if(true, Fault::Sensor);
    let mut sent = 0;
    for _ in 0..500 {
        sent += emergencies_after(&mut all, there, 1).len()
            + emergencies_after(&mut all, Faults::default(), 1).len();
    }
    assert!((90..=100).contains(&sent), "{sent} in a second");
    all.set_inhibit_time_100us(1_000);
    let both = there.with_fault_if(true, Fault::Clamped);
    assert!(emergencies_after(&mut all, both, 300).len() <= 3);
}

#[test]
fn a_fault_of_one_tick_within_the_inhibit_time_is_reported_all_the_same() {
    let mut all = EmergencyProducer::default();
    let sensor = Faults::default().with_fault_if(true, Fault::Sensor);
    assert_eq!(emergencies_after(&mut all, sensor, 1).len(), 1);
    let both = sensor.with_fault_if(true, Fault::Clamped);
    assert_eq!(emergencies_after(&mut all, both, 1), []);
    assert_eq!(emergencies_after(&mut all, sensor, 50), [(0xFF02, 1, 7), (0, 1, 7)]);
}

#[test]
fn every_bit_of_the_state_is_an_emergency_too() {
    for (bit, word) in StateBits::NAMES {
        let sets_bit =
            |fault: &Fault| Faults::default().with_fault_if(true, *fault).state_bits() == bit;
        assert!(Fault::ALL.iter().any(sets_bit), "{word}");
    }
}

#[test]
fn a_second_source_that_is_lost_while_the_first_is_missing_is_reported() {
    let thermometers = Fault::THERMOMETER_FAULTS.into_iter().chain(Fault::TEMPERATURE_RATE_FAULTS);
    let sources: Vec<Fault> =
        thermometers.chain([Fault::Sensor, Fault::SamplesMissing, Fault::PlaceLost]).collect();
    let (mut all, mut now) = (EmergencyProducer::default(), Faults::default());
    for fault in sources {
        now = now.with_fault_if(true, fault);
        let codes: Vec<u16> =
            emergencies_after(&mut all, now, 100).into_iter().map(|(code, ..)| code).collect();
        assert_eq!(codes, [fault.code()], "{fault:?}");
    }
}

#[test]
fn both_words_of_the_objects_hold_every_fault_at_its_number() {
    for fault in Fault::ALL {
        let only = Faults::default().with_fault_if(true, fault);
        let (low, high) = (only.low_word(), only.high_word());
        assert_eq!(u64::from(high) << 32 | u64::from(low), 1 << fault as u8, "{fault:?}");
        assert_eq!(Faults::from_words(low, high), only);
    }
}

#[test]
fn the_history_keeps_the_newest() {
    let mut all = EmergencyProducer::default();
    for fault in Fault::ALL {
        emergencies_after(&mut all, Faults::default().with_fault_if(true, fault), 20);
    }
    assert_eq!(all.history_len(), ERROR_HISTORY_LEN);
    let newest = Fault::ALL[Fault::ALL.len() - 1];
    assert_eq!(all.history_entry(0), Some((newest as u32) << 16 | u32::from(newest.code())));
    assert_eq!(all.history_entry(8), None);
    all.clear_history();
    assert_eq!((all.history_len(), all.history_entry(0)), (0, None));
}

#[test]
fn what_is_encoded_is_decoded_and_what_has_no_meaning_is_named() {
    let emergency = Emergency {
        code: 0x8130,
        register: 0x11,
        fault: Fault::HeartbeatLost,
        flags: OffsetFlags(0xA5),
        quality: OffsetQuality::Hold,
    };
    let frame = encode(&emergency);
    assert_eq!(frame.data(), &[0x30, 0x81, 0x11, 4, 0xA5, 4, 0, 0]);
    assert_eq!(decode(&frame), Ok(emergency));
    for (byte, raw, signal) in [(3, 200, "Fault"), (5, 7, "Quality")] {
        let mut data = *frame.data();
        data[byte] = raw;
        let wrong = Frame::from_data(EMERGENCY_ID, data);
        assert_eq!(decode(&wrong), Err(DecodeError::Value { signal, raw: raw.into() }));
    }
}
