//! Sparkplug B 3.0: payloads and topics.
//!
//! The messages are those of `srad-types`; their order is kept by [`node`].
//!
//! Sparkplug has its data sent at most once (QoS 0). Records and events therefore go out on topics outside its name
//! space, at least once (QoS 1), with payloads of the same form and an identifier in `uuid`.

pub mod node;

use srad_types::payload::{
    self, DataType, Message as _, Payload, PropertySet, PropertyValue, metric, property_value,
};

use crate::{
    clock::format_utc,
    metrics::{Metric, MetricValue, bridge_metrics},
    snapshot::{BridgeEvent, BridgeSnapshot},
    spool::NewRecord,
};

/// The group of every edge node.
pub(crate) const SPARKPLUG_GROUP_ID: &str = "trueup";
/// The metric by which a host requests all births again.
pub(crate) const REBIRTH_METRIC: &str = "Node Control/Rebirth";
/// The unit of a metric, as hosts read it.
const UNIT_PROPERTY: &str = "engUnit";

/// Returns the topic of a message of this type of an edge node, or of a device of it.
#[must_use]
pub fn topic(kind: &str, node: &str, device: Option<&str>) -> String {
    let device = device.map(|device| format!("/{device}")).unwrap_or_default();
    format!("spBv1.0/{SPARKPLUG_GROUP_ID}/{kind}/{node}{device}")
}

/// Returns the topic of a host application's state.
#[must_use]
pub(crate) fn state_topic(host: &str) -> String {
    format!("spBv1.0/STATE/{host}")
}

/// Returns the topic outside Sparkplug's name space of what is recorded, or of the retained state.
#[must_use]
pub(crate) fn non_sparkplug_topic(node: &str, device: Option<&str>, kind: &str) -> String {
    let device = device.map(|device| format!("/{device}")).unwrap_or_default();
    format!("{SPARKPLUG_GROUP_ID}/{node}{device}/{kind}")
}

/// Returns the identifier of a device: the serial number of its board.
#[must_use]
pub(crate) fn device_id(serial: u32) -> String {
    format!("{serial:08x}")
}

/// Returns a metric with its name.
#[must_use]
pub(crate) fn build_named_metric(name: &str, value: &MetricValue, time_ms: u64) -> payload::Metric {
    let mut metric = payload::Metric::new();
    metric.set_name(name.to_owned()).set_timestamp(time_ms);
    let datatype = match value {
        MetricValue::Number(_) => DataType::Double,
        MetricValue::Count(_) => DataType::UInt64,
        MetricValue::Text(_) => DataType::String,
        MetricValue::Flag(_) => DataType::Boolean,
    };
    metric.set_datatype(datatype);
    match value {
        MetricValue::Number(Some(number)) => metric.set_value(metric::Value::DoubleValue(*number)),
        MetricValue::Count(count) => metric.set_value(metric::Value::LongValue(*count)),
        MetricValue::Text(Some(text)) => metric.set_value(metric::Value::StringValue(text.clone())),
        MetricValue::Flag(flag) => metric.set_value(metric::Value::BooleanValue(*flag)),
        MetricValue::Number(None) | MetricValue::Text(None) => metric.set_null(),
    };
    metric
}

/// Returns a metric of a birth: name, alias, unit.
#[must_use]
pub(crate) fn build_birth_metric(metric: &Metric, alias: u64, time_ms: u64) -> payload::Metric {
    let mut birth_metric = build_named_metric(metric.name, &metric.value, time_ms);
    birth_metric.set_alias(alias);
    if !metric.unit.is_empty() {
        let unit = PropertyValue {
            r#type: Some(DataType::String as u32),
            is_null: None,
            value: Some(property_value::Value::StringValue(metric.unit.to_owned())),
        };
        birth_metric.properties =
            Some(PropertySet { keys: vec![UNIT_PROPERTY.into()], values: vec![unit] });
    }
    birth_metric
}

/// Returns the bytes of a payload.
#[must_use]
pub fn encode_payload(
    metrics: Vec<payload::Metric>,
    time_ms: u64,
    seq: Option<u8>,
    id: Option<&str>,
) -> Vec<u8> {
    let whole = Payload {
        timestamp: Some(time_ms),
        metrics,
        seq: seq.map(u64::from),
        uuid: id.map(str::to_owned),
        body: None,
    };
    whole.encode_to_vec()
}

/// Returns the metrics of what came over a topic; `None`: it is no payload.
#[must_use]
pub(crate) fn decode_metrics(bytes: &[u8]) -> Option<Vec<payload::Metric>> {
    Payload::decode(bytes).ok().map(|payload| payload.metrics)
}

/// Returns a record or an event that was published as an object: its identifier, its time, its metrics by name; `None`: it
/// is no payload.
#[must_use]
pub fn payload_to_json(bytes: &[u8]) -> Option<serde_json::Value> {
    use serde_json::{Value as Json, json};
    let Payload { timestamp, metrics, uuid, .. } = Payload::decode(bytes).ok()?;
    let value = |value: metric::Value| match value {
        metric::Value::IntValue(value) => json!(value),
        metric::Value::LongValue(value) => json!(value),
        metric::Value::FloatValue(value) => json!(value),
        metric::Value::DoubleValue(value) => json!(value),
        metric::Value::BooleanValue(value) => json!(value),
        metric::Value::StringValue(value) => json!(value),
        // None of a bridge's.
        _ => Json::Null,
    };
    let named = metrics
        .into_iter()
        .filter_map(|metric| Some((metric.name?, metric.value.map_or(Json::Null, value))));
    let named: serde_json::Map<String, Json> = named.collect();
    Some(json!({ "id": uuid, "time": timestamp.map(format_utc), "metrics": named }))
}

/// Returns whether a command requests all births again; `None`: it is no payload.
#[must_use]
pub(crate) fn is_rebirth_command(bytes: &[u8]) -> Option<bool> {
    let is_rebirth = |command: &payload::Metric| {
        command.name.as_deref() == Some(REBIRTH_METRIC)
            && command.value == Some(metric::Value::BooleanValue(true))
    };
    Some(decode_metrics(bytes)?.iter().any(is_rebirth))
}

/// Returns an event to be recorded.
#[must_use]
pub(crate) fn build_event_record(
    node: &str,
    device: Option<&str>,
    event: BridgeEvent,
    time_ms: u64,
) -> NewRecord {
    let payload = move |id: &str| {
        let text = |name, text: &str| {
            build_named_metric(name, &MetricValue::Text(Some(text.to_owned())), time_ms)
        };
        let metrics = vec![text("Event/Code", event.code), text("Event/About", &event.about)];
        encode_payload(metrics, time_ms, None, Some(id))
    };
    let topic = non_sparkplug_topic(node, device, "event");
    NewRecord { time_ms, topic, payload: Box::new(payload) }
}

/// Returns a row of what a bridge does at a moment, to be recorded: all that is known.
#[must_use]
pub(crate) fn build_snapshot_record(
    node: &str,
    device: Option<&str>,
    of: &BridgeSnapshot,
    time_ms: u64,
) -> NewRecord {
    let mut known = bridge_metrics(of);
    known.retain(|metric| {
        !matches!(metric.value, MetricValue::Number(None) | MetricValue::Text(None))
    });
    let payload = move |id: &str| {
        let metrics = known
            .iter()
            .map(|metric| build_named_metric(metric.name, &metric.value, time_ms))
            .collect();
        encode_payload(metrics, time_ms, None, Some(id))
    };
    let topic = non_sparkplug_topic(node, device, "record");
    NewRecord { time_ms, topic, payload: Box::new(payload) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_read_as_it_was_made() {
        let made = build_event_record("n", None, BridgeEvent::new("quality", "live"), 1_000);
        let read = payload_to_json(&(made.payload)("00000000000000ff-7")).expect("a payload");
        let expected = serde_json::json!({
            "id": "00000000000000ff-7",
            "time": "1970-01-01T00:00:01.000Z",
            "metrics": {"Event/Code": "quality", "Event/About": "live"},
        });
        assert_eq!(read, expected);
        assert_eq!(payload_to_json(b"\xff"), None);
    }
}
