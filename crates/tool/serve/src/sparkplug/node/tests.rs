use super::*;
use crate::sparkplug::decode_metrics;
use srad_types::payload::{Message as _, Payload};

fn bridge(serial: u32, x_um: f64) -> BridgeSnapshot {
    let mut bridge = BridgeSnapshot {
        is_up: true,
        offset_um: [Some(x_um), None, None],
        ..BridgeSnapshot::default()
    };
    bridge.identity.serial = Some(serial);
    bridge
}

fn node() -> EdgeNode {
    EdgeNode::new("n", "me", "1.0", 254)
}

/// Returns the topics without those of the retained state, shortened, with their sequence numbers.
fn numbered(messages: &[MqttMessage]) -> Vec<(String, Option<u64>)> {
    let live = messages.iter().filter(|message| !message.is_retained);
    live.map(|message| {
        let topic = message.topic.replace("spBv1.0/trueup/", "");
        (topic, Payload::decode(&message.payload[..]).expect("a payload").seq)
    })
    .collect()
}

fn expected(all: &[(&str, u64)]) -> Vec<(String, Option<u64>)> {
    all.iter().map(|(topic, seq)| ((*topic).to_owned(), Some(*seq))).collect()
}

#[test]
fn births_come_in_order_and_then_only_what_has_changed() {
    let mut node = node();
    node.begin_connection();
    let own = NodeStatistics::default();
    let bridges = [bridge(0xAB, 1.0), BridgeSnapshot::default()];
    let births = node.update(own, &bridges, 1);
    assert_eq!(numbered(&births), expected(&[("NBIRTH/n", 0), ("DBIRTH/n/000000ab", 1)]));
    assert_eq!(node.update(own, &bridges, 2), []);

    let bridges = [bridge(0xAB, 2.0), bridge(0xCD, 0.0)];
    let messages = node.update(own, &bridges, 3);
    let all = [("DDATA/n/000000ab", 2), ("DBIRTH/n/000000cd", 3)];
    assert_eq!(numbered(&messages), expected(&all));
    let changed = decode_metrics(&messages[0].payload).expect("a payload");
    assert_eq!(changed.len(), 1);
    assert_eq!(changed[0].value, Some(metric::Value::DoubleValue(2.0)));
    let birth = decode_metrics(&births[1].payload).expect("a payload");
    let named = birth.iter().find(|metric| metric.alias == changed[0].alias).expect("its alias");
    assert_eq!(named.name.as_deref(), Some("Offset/X"));
    let node_birth = decode_metrics(&births[0].payload).expect("a payload");
    let rebirth = node_birth.iter().find(|metric| metric.name.as_deref() == Some(REBIRTH_METRIC));
    assert_eq!(rebirth.expect("it can be asked for").alias, None, "hosts name it");

    let waiting = NodeStatistics { waiting: 3, ..own };
    assert_eq!(numbered(&node.update(waiting, &bridges, 4)), expected(&[("NDATA/n", 4)]));
}

#[test]
fn a_bridge_that_is_lost_or_exchanged_dies() {
    let mut node = node();
    node.begin_connection();
    node.update(NodeStatistics::default(), &[bridge(1, 0.0)], 1);
    let exchanged = node.update(NodeStatistics::default(), &[bridge(2, 0.0)], 2);
    let all = [("DDEATH/n/00000001", 2), ("DBIRTH/n/00000002", 3)];
    assert_eq!(numbered(&exchanged), expected(&all));
    let lost = BridgeSnapshot { is_up: false, ..bridge(2, 0.0) };
    let messages = node.update(NodeStatistics::default(), std::slice::from_ref(&lost), 3);
    assert_eq!(numbered(&messages), expected(&[("DDEATH/n/00000002", 4)]));
    let retained = messages
        .iter()
        .find(|message| message.is_retained)
        .expect("the state of those that come later");
    assert_eq!(retained.topic, "trueup/n/00000002/state");
    let up = decode_metrics(&retained.payload).expect("a payload");
    assert_eq!(up[0].value, Some(metric::Value::BooleanValue(false)));
    assert_eq!(node.update(NodeStatistics::default(), &[lost], 4), []);
}

#[test]
fn the_number_of_the_connection_ties_a_death_to_its_birth_and_comes_round() {
    let mut node = node();
    let number = |message: &MqttMessage| {
        let metrics = decode_metrics(&message.payload).expect("a payload");
        metrics
            .iter()
            .find(|metric| metric.name.as_deref() == Some(BD_SEQ_METRIC))
            .and_then(|metric| metric.value.clone())
    };
    for expected in [255, 0, 1] {
        assert_eq!(node.begin_connection(), expected);
        let birth = node.update(NodeStatistics::default(), &[], 1);
        let value = Some(metric::Value::LongValue(expected.into()));
        assert_eq!(
            (number(&node.build_death_message(1)), number(&birth[0])),
            (value.clone(), value)
        );
    }
}

#[test]
fn a_rebirth_says_everything_again_from_sequence_0_and_sequences_come_round() {
    let mut node = node();
    node.begin_connection();
    node.update(NodeStatistics::default(), &[bridge(1, 0.0)], 1);
    for n in 0..300_u32 {
        let messages = node.update(NodeStatistics::default(), &[bridge(1, 1.0 + f64::from(n))], 2);
        let expected = u64::from((n + 2) % 256);
        assert_eq!(numbered(&messages)[0].1, Some(expected));
    }
    let births = node.build_rebirth_messages(NodeStatistics::default(), &[bridge(1, 5.0)], 3);
    assert_eq!(numbered(&births), expected(&[("NBIRTH/n", 0), ("DBIRTH/n/00000001", 1)]));
}
