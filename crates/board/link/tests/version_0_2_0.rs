//! The frames of version 0.2.0: a receiver that was written for them still finds every signal where it was.

use can_dbc::{AttributeValue, Dbc, Message, NumericValue, Signal, ValDescription};
use trueup_link::DBC;

const DBC_0_2_0: &str = include_str!("../../../../host-tests/corpus/0.2.0/frames.dbc");

fn read(text: &str) -> Dbc {
    Dbc::try_from(text).expect("a DBC file")
}

fn number(value: NumericValue) -> f64 {
    format!("{value}").parse().expect("a number")
}

/// Returns `signal` without its range, which may grow.
fn without_range(signal: &Signal) -> Signal {
    let none = NumericValue::Uint(0);
    Signal { min: none, max: none, ..signal.clone() }
}

fn cycle<'d>(dbc: &'d Dbc, message: &Message) -> Option<&'d AttributeValue> {
    dbc.message_attribute(message.id, "GenMsgCycleTime")
}

fn value_names<'d>(dbc: &'d Dbc, message: &Message, signal: &Signal) -> &'d [ValDescription] {
    dbc.value_descriptions_for_signal(message.id, &signal.name).unwrap_or_default()
}

#[test]
fn every_signal_of_0_2_0_is_where_it_was_with_its_scale() {
    let (then, now) = (read(DBC_0_2_0), read(DBC));
    let mut count = 0;
    for message in &then.messages {
        let found = now.messages.iter().find(|other| other.id == message.id);
        let today = found.unwrap_or_else(|| panic!("{} is gone", message.name));
        assert_eq!(today.name, message.name);
        assert_eq!(today.size, message.size, "{}", message.name);
        assert_eq!(today.transmitter, message.transmitter, "{}", message.name);
        assert_eq!(cycle(&now, today), cycle(&then, message), "{}", message.name);
        for signal in &message.signals {
            let at = format!("{}.{}", message.name, signal.name);
            let found = today.signals.iter().find(|other| other.name == signal.name);
            let same = found.unwrap_or_else(|| panic!("{at} is gone"));
            assert_eq!(without_range(same), without_range(signal), "{at}");
            // A range may grow by values that nothing sent.
            assert!(number(same.min) <= number(signal.min), "{at}");
            assert!(number(same.max) >= number(signal.max), "{at}");
            let names = value_names(&now, today, same);
            for name in value_names(&then, message, signal) {
                assert!(names.contains(name), "{at}: {name:?} is now among {names:?}");
            }
            count += 1;
        }
    }
    assert_eq!((then.messages.len(), count), (11, 66), "all were compared");
}
