//! An edge node with its devices: which messages are due, in the order and with the numbers that Sparkplug requires.
//!
//! | what happens | goes out |
//! |---|---|
//! | the broker has accepted the connection, a host requests it | NBIRTH (seq 0), DBIRTH of each device that is there |
//! | a bridge is found | DBIRTH |
//! | values have changed | DDATA of these; of the node NDATA |
//! | a bridge is lost, or exchanged | DDEATH |
//! | the connection breaks | NDEATH, by the broker: it is the will of the connection |
//!
//! `bdSeq` counts connections and ties an NDEATH to its NBIRTH. No I/O and no clock here: time is an argument.

use srad_types::payload::{self, DataType, metric};

use super::{
    REBIRTH_METRIC, build_birth_metric, build_named_metric, device_id, encode_payload,
    non_sparkplug_topic, topic,
};
use crate::{
    metrics::{FLAGS_METRIC, Metric, MetricValue, bridge_metrics},
    snapshot::BridgeSnapshot,
};

/// Number of aliases of each device; the node has the first of them.
const ALIASES_PER_DEVICE: u64 = 1_000;
/// The metric of the number of a connection.
const BD_SEQ_METRIC: &str = "bdSeq";
/// The metric by which a publisher knows its own births.
pub(crate) const PUBLISHER_METRIC: &str = "Properties/Publisher";

/// A message to be published.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MqttMessage {
    /// Where.
    pub topic: String,
    /// What.
    pub payload: Vec<u8>,
    /// The broker keeps it for those who subscribe later.
    pub is_retained: bool,
}

/// An edge node.
pub struct EdgeNode {
    name: String,
    publisher: String,
    version: &'static str,
    seq: u8,
    bd_seq: u8,
    /// The last published metrics of the node itself.
    own: Option<Vec<Metric>>,
    devices: Vec<SparkplugDevice>,
}

/// A device, once it was born.
#[derive(Default)]
struct SparkplugDevice {
    /// Its identifier; `None`: it is not there.
    id: Option<String>,
    /// Its last published metrics.
    metrics: Vec<Metric>,
}

/// The metrics of the node itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NodeStatistics {
    /// Records and events on the disk since the publisher began: it changes with each row, so that a host that comes
    /// late is sent something, and requests the births.
    pub recorded: u64,
    /// Records and events that the broker does not have.
    pub waiting: u64,
    /// Those that no broker will ever have.
    pub lost: u64,
}

impl EdgeNode {
    /// Returns the edge node of this name. `publisher` differs from that of any other publisher.
    #[must_use]
    pub fn new(name: &str, publisher: &str, version: &'static str, bd_seq: u8) -> Self {
        let (name, publisher) = (name.to_owned(), publisher.to_owned());
        Self { name, publisher, version, seq: 0, bd_seq, own: None, devices: Vec::new() }
    }

    /// Counts a new connection; returns its number.
    pub(crate) fn begin_connection(&mut self) -> u8 {
        self.bd_seq = self.bd_seq.wrapping_add(1);
        self.reset_births();
        self.bd_seq
    }

    /// Everything is to be born again.
    fn reset_births(&mut self) {
        self.own = None;
        self.devices.clear();
    }

    fn build_bd_seq_metric(&self, time_ms: u64) -> payload::Metric {
        let mut number = payload::Metric::new();
        number.set_name(BD_SEQ_METRIC.into()).set_datatype(DataType::Int64).set_timestamp(time_ms);
        number.set_value(metric::Value::LongValue(self.bd_seq.into()));
        number
    }

    /// Returns the will of the connection, and the message before it is ended on purpose.
    #[must_use]
    pub(crate) fn build_death_message(&self, time_ms: u64) -> MqttMessage {
        let metrics = vec![self.build_bd_seq_metric(time_ms)];
        self.message("NDEATH", None, encode_payload(metrics, time_ms, None, None))
    }

    fn message(&self, kind: &str, device: Option<&str>, payload: Vec<u8>) -> MqttMessage {
        MqttMessage { topic: topic(kind, &self.name, device), payload, is_retained: false }
    }

    fn build_sequenced_message(
        &mut self,
        kind: &str,
        device: Option<&str>,
        metrics: Vec<payload::Metric>,
        time_ms: u64,
    ) -> MqttMessage {
        let seq = self.seq;
        self.seq = self.seq.wrapping_add(1);
        self.message(kind, device, encode_payload(metrics, time_ms, Some(seq), None))
    }

    /// Returns all births: after the broker has accepted the connection, and when a host requests them.
    pub(crate) fn build_rebirth_messages(
        &mut self,
        own: NodeStatistics,
        bridges: &[BridgeSnapshot],
        time_ms: u64,
    ) -> Vec<MqttMessage> {
        self.reset_births();
        self.update(own, bridges, time_ms)
    }

    /// Returns what has changed since the last call.
    pub fn update(
        &mut self,
        own: NodeStatistics,
        bridges: &[BridgeSnapshot],
        time_ms: u64,
    ) -> Vec<MqttMessage> {
        let mut messages = Vec::new();
        let metrics = self.node_metrics(own);
        match self.own.take() {
            None => messages.push(self.build_node_birth_message(&metrics, time_ms)),
            Some(previous) => {
                let changed = build_changed_metrics(&previous, &metrics, 1, time_ms);
                if !changed.is_empty() {
                    messages.push(self.build_sequenced_message("NDATA", None, changed, time_ms));
                }
            }
        }
        self.own = Some(metrics);
        self.devices.resize_with(bridges.len(), SparkplugDevice::default);
        for (place, bridge) in bridges.iter().enumerate() {
            self.append_device_messages(place, bridge, time_ms, &mut messages);
        }
        messages
    }

    /// Returns whether anything but numbers, counts and flags of offsets differs from what was last sent.
    #[must_use]
    pub(crate) fn has_state_change(&self, bridges: &[BridgeSnapshot]) -> bool {
        let known = self.devices.iter().map(|device| &device.metrics);
        bridges.len() != self.devices.len()
            || known.zip(bridges).any(|(previous, of)| {
                let is_word = |metric: &&Metric| {
                    matches!(metric.value, MetricValue::Text(_) | MetricValue::Flag(_))
                        && metric.name != FLAGS_METRIC
                };
                let now = bridge_metrics(of);
                !previous.iter().filter(is_word).eq(now.iter().filter(is_word))
            })
    }

    fn node_metrics(&self, own: NodeStatistics) -> Vec<Metric> {
        let text = |name, text: &str| Metric {
            name,
            unit: "",
            value: MetricValue::Text(Some(text.to_owned())),
        };
        let count = |name, count| Metric { name, unit: "", value: MetricValue::Count(count) };
        vec![
            Metric { name: REBIRTH_METRIC, unit: "", value: MetricValue::Flag(false) },
            text("Properties/Version", self.version),
            text(PUBLISHER_METRIC, &self.publisher),
            count("Spool/Recorded", own.recorded),
            count("Spool/Waiting", own.waiting),
            count("Spool/Lost", own.lost),
        ]
    }

    fn build_node_birth_message(&mut self, metrics: &[Metric], time_ms: u64) -> MqttMessage {
        self.seq = 0;
        let mut all = vec![self.build_bd_seq_metric(time_ms)];
        all.extend(metrics.iter().zip(1..).map(|(declared, alias)| {
            let mut metric = build_birth_metric(declared, alias, time_ms);
            // In Sparkplug a host requests it by its name.
            metric.alias = metric.alias.filter(|_| declared.name != REBIRTH_METRIC);
            metric
        }));
        self.build_sequenced_message("NBIRTH", None, all, time_ms)
    }

    fn append_device_messages(
        &mut self,
        place: usize,
        of: &BridgeSnapshot,
        time_ms: u64,
        messages: &mut Vec<MqttMessage>,
    ) {
        let Some(known) = self.devices.get_mut(place) else { return };
        let SparkplugDevice { id: old, metrics: reported } = std::mem::take(known);
        let id = of.identity.serial.filter(|_| of.is_up).map(device_id);
        let first = ALIASES_PER_DEVICE * (place as u64 + 1);
        let now = bridge_metrics(of);
        if old.is_some() && old != id {
            messages.push(self.build_sequenced_message(
                "DDEATH",
                old.as_deref(),
                Vec::new(),
                time_ms,
            ));
            messages.extend(
                old.as_deref()
                    .map(|before| self.build_retained_state_message(before, &now, time_ms)),
            );
        }
        if let Some(id) = &id {
            let (kind, metrics) = if old.as_ref() == Some(id) {
                ("DDATA", build_changed_metrics(&reported, &now, first, time_ms))
            } else {
                let all = now.iter().zip(first..);
                (
                    "DBIRTH",
                    all.map(|(metric, alias)| build_birth_metric(metric, alias, time_ms)).collect(),
                )
            };
            if !metrics.is_empty() {
                messages.push(self.build_sequenced_message(kind, Some(id), metrics, time_ms));
                messages.push(self.build_retained_state_message(id, &now, time_ms));
            }
        }
        if let Some(known) = self.devices.get_mut(place) {
            *known = SparkplugDevice { id, metrics: now };
        }
    }

    /// Returns the whole state of a device, for those who subscribe later and are no Sparkplug host.
    fn build_retained_state_message(
        &self,
        id: &str,
        metrics: &[Metric],
        time_ms: u64,
    ) -> MqttMessage {
        let metrics = metrics
            .iter()
            .map(|metric| build_named_metric(metric.name, &metric.value, time_ms))
            .collect();
        let topic = non_sparkplug_topic(&self.name, Some(id), "state");
        MqttMessage {
            topic,
            payload: encode_payload(metrics, time_ms, None, None),
            is_retained: true,
        }
    }
}

/// Returns the metrics that have another value now, by their aliases.
fn build_changed_metrics(
    previous: &[Metric],
    now: &[Metric],
    first: u64,
    time_ms: u64,
) -> Vec<payload::Metric> {
    let pairs = previous.iter().zip(now).zip(first..);
    pairs
        .filter(|((previous, now), _)| previous.value != now.value)
        .map(|((_, now), alias)| {
            let mut metric = build_named_metric(now.name, &now.value, time_ms);
            (metric.name, metric.datatype) = (None, None);
            metric.set_alias(alias);
            metric
        })
        .collect()
}

#[cfg(test)]
mod tests;
