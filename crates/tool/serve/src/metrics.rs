//! The names, units and values of what is published of a bridge: one list for Sparkplug and the recorded rows.
//!
//! The order is part of what is published: the alias of a metric is its place.

use trueup_client::state_text::quality_name;
use trueup_core::design_parameters::TEMPERATURE_CHANNEL_COUNT;

use crate::snapshot::BridgeSnapshot;

/// A value, and of which kind it is even where there is none.
#[derive(Clone, Debug, PartialEq)]
pub enum MetricValue {
    /// With a unit.
    Number(Option<f64>),
    /// A count that only rises, until the publisher ends.
    Count(u64),
    /// Words are separated by spaces.
    Text(Option<String>),
    /// Yes or no.
    Flag(bool),
}

/// A named value.
#[derive(Clone, Debug, PartialEq)]
pub struct Metric {
    /// Its name.
    pub name: &'static str,
    /// Its unit; empty where it has none.
    pub unit: &'static str,
    /// Its value.
    pub value: MetricValue,
}

/// Words that may change with every offset.
pub(crate) const FLAGS_METRIC: &str = "Bridge/Flags";
const OFFSET_METRICS: [&str; 3] = ["Offset/X", "Offset/Y", "Offset/Z"];
const POSITION_METRICS: [&str; 3] = ["Position/X", "Position/Y", "Position/Z"];
const TEMPERATURE_METRICS: [&str; TEMPERATURE_CHANNEL_COUNT] = [
    "Temperature/0",
    "Temperature/1",
    "Temperature/2",
    "Temperature/3",
    "Temperature/4",
    "Temperature/5",
    "Temperature/6",
    "Temperature/7",
];

/// Returns all metrics of a bridge.
#[must_use]
pub(crate) fn bridge_metrics(of: &BridgeSnapshot) -> Vec<Metric> {
    let text =
        |name, text: Option<String>| Metric { name, unit: "", value: MetricValue::Text(text) };
    let words =
        |name, is_known: bool, words: &[&str]| text(name, is_known.then(|| words.join(" ")));
    let numbers = |names: &'static [&'static str], unit, values: &[Option<f64>]| {
        let both = names.iter().zip(values);
        both.map(|(name, value)| Metric { name, unit, value: MetricValue::Number(*value) })
            .collect::<Vec<_>>()
    };
    let count =
        |name, count: u32| Metric { name, unit: "", value: MetricValue::Count(count.into()) };
    let mut all = vec![Metric { name: "Bridge/Up", unit: "", value: MetricValue::Flag(of.is_up) }];
    all.push(text("Bridge/Quality", of.quality.map(|quality| quality_name(quality).to_owned())));
    all.push(words(FLAGS_METRIC, of.is_up, &of.flags));
    all.push(words("Bridge/Faults", of.has_status, &of.faults));
    all.push(words("Bridge/State", of.has_status, &of.state));
    all.extend(numbers(&OFFSET_METRICS, "µm", &of.offset_um));
    all.extend(numbers(&["Elongation"], "µm", &[of.elongation_um]));
    all.extend(numbers(&TEMPERATURE_METRICS, "°C", &of.temperature_c));
    all.extend(numbers(&POSITION_METRICS, "mm", &of.position_mm));
    let crc = of.calibration.filter(|crc| *crc != 0);
    all.push(text("Calibration/CRC", crc.map(|crc| format!("{crc:08x}"))));
    all.push(text("Calibration/Machine", of.identity.machine.clone()));
    all.push(text("Properties/Firmware", of.identity.firmware.clone()));
    all.push(count("Bridge/Lost frames", of.lost_frames));
    all.push(count("Bridge/Starts", of.starts));
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use trueup_core::cnc::OffsetQuality;

    #[test]
    fn the_list_is_the_same_whatever_is_known() {
        let known = BridgeSnapshot {
            is_up: true,
            quality: Some(OffsetQuality::Live),
            offset_um: [Some(1.5), None, Some(-2.0)],
            calibration: Some(0xAB),
            has_status: true,
            ..BridgeSnapshot::default()
        };
        let silent = BridgeSnapshot { has_status: false, ..known.clone() };
        let (known, unknown) = (bridge_metrics(&known), bridge_metrics(&BridgeSnapshot::default()));
        let names = |all: &[Metric]| all.iter().map(|metric| metric.name).collect::<Vec<_>>();
        assert_eq!(names(&known), names(&unknown));
        let mut different = names(&known);
        different.sort_unstable();
        different.dedup();
        assert_eq!(different.len(), known.len(), "each name once");
        let of = |name| {
            known.iter().find(|metric| metric.name == name).map(|metric| metric.value.clone())
        };
        assert_eq!(of("Offset/X"), Some(MetricValue::Number(Some(1.5))));
        assert_eq!(of("Calibration/CRC"), Some(MetricValue::Text(Some("000000ab".into()))));
        assert_eq!(of("Bridge/Faults"), Some(MetricValue::Text(Some(String::new()))));
        let silent = bridge_metrics(&silent);
        let faults =
            silent.iter().find(|metric| metric.name == "Bridge/Faults").map(|metric| &metric.value);
        assert_eq!(
            faults,
            Some(&MetricValue::Text(None)),
            "without its status no fault is not claimed"
        );
    }
}
