//! `Devices.devices_xml`: what an agent must know of the data items of `shdr`.

use std::fmt::Write as _;

use trueup_core::design_parameters::TEMPERATURE_CHANNEL_COUNT;

use crate::snapshot::BridgeIdentity;

/// Returns the description of these bridges of an edge node.
#[must_use]
pub(crate) fn devices_xml(name: &str, bridges: &[BridgeIdentity], time: &str) -> String {
    let devices: String = bridges
        .iter()
        .zip(1..)
        .map(|(bridge, number)| device_xml(name, bridge, number, bridges.len()))
        .collect();
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<MTConnectDevices xmlns="urn:mtconnect.org:MTConnectDevices:1.7" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:schemaLocation="urn:mtconnect.org:MTConnectDevices:1.7 http://schemas.mtconnect.org/schemas/MTConnectDevices_1.7.xsd">
  <Header creationTime="{time}" sender="trueup" instanceId="1" version="1.7.0.0" bufferSize="1" assetBufferSize="1" assetCount="0"/>
  <Devices>
{devices}  </Devices>
</MTConnectDevices>
"#
    )
}

/// Returns a data item; `rest` are the attributes after its type.
fn data_item_xml(indent: usize, id: &str, category: &str, kind: &str, rest: &str) -> String {
    let space = " ".repeat(indent);
    format!(
        "{space}<DataItem id=\"{id}\" name=\"{id}\" category=\"{category}\" type=\"{kind}\"{rest}/>\n"
    )
}

fn device_xml(name: &str, bridge: &BridgeIdentity, number: usize, count: usize) -> String {
    let id = format!("b{number}");
    let uuid = bridge.serial.map_or_else(
        || format!("trueup-{}-{number}", escape_xml(name)),
        |serial| format!("trueup-{serial:08x}"),
    );
    let name = if count > 1 { format!("{name}-{number}") } else { name.to_owned() };
    let model = bridge.machine.as_deref().map(escape_xml).unwrap_or_default();
    let serial = bridge.serial.map(|serial| format!("{serial:08x}")).unwrap_or_default();
    let mut text = format!(
        "    <Device id=\"{id}\" name=\"{}\" uuid=\"{uuid}\">\n      \
         <Description manufacturer=\"trueup\" serialNumber=\"{serial}\">Bridge of {model}</Description>\n      \
         <DataItems>\n",
        escape_xml(&name)
    );
    text += &data_item_xml(8, &format!("{id}_avail"), "EVENT", "AVAILABILITY", "");
    text += &data_item_xml(8, &format!("{id}_message"), "EVENT", "MESSAGE", "");
    for (condition, kind) in [("faults", "SYSTEM"), ("state", "SYSTEM"), ("line", "COMMUNICATIONS")]
    {
        text += &data_item_xml(8, &format!("{id}_{condition}"), "CONDITION", kind, "");
    }
    write!(
        text,
        "      </DataItems>\n      <Components>\n        <Axes id=\"{id}_axes\" name=\"axes\">\n          <Components>\n"
    )
    .ok();
    let mm = " units=\"MILLIMETER\"";
    for axis in ["x", "y", "z"] {
        let commanded = format!(" subType=\"COMMANDED\"{mm}");
        let items = data_item_xml(16, &format!("{id}_offset_{axis}"), "SAMPLE", "DISPLACEMENT", mm)
            + &data_item_xml(
                16,
                &format!("{id}_position_{axis}"),
                "SAMPLE",
                "POSITION",
                &commanded,
            );
        text += &component_xml("Linear", 12, &format!("{id}_{axis}"), &axis.to_uppercase(), &items);
    }
    let items = data_item_xml(16, &format!("{id}_elongation"), "SAMPLE", "DISPLACEMENT", mm);
    text += &component_xml("Rotary", 12, &format!("{id}_s"), "S", &items);
    text += "          </Components>\n        </Axes>\n";
    let items: String = (0..TEMPERATURE_CHANNEL_COUNT)
        .map(|channel| {
            let id = format!("{id}_temperature_{channel}");
            data_item_xml(12, &id, "SAMPLE", "TEMPERATURE", " units=\"CELSIUS\"")
        })
        .collect();
    text += &component_xml("Sensor", 8, &format!("{id}_sensor"), "temperatures", &items);
    text + "      </Components>\n    </Device>\n"
}

fn component_xml(kind: &str, indent: usize, id: &str, name: &str, items: &str) -> String {
    let space = " ".repeat(indent);
    format!(
        "{space}<{kind} id=\"{id}\" name=\"{name}\">\n{space}  <DataItems>\n{items}{space}  </DataItems>\n{space}</{kind}>\n"
    )
}

fn escape_xml(text: &str) -> String {
    let mut escaped = String::new();
    for c in text.chars() {
        match c {
            '&' => escaped += "&amp;",
            '<' => escaped += "&lt;",
            '>' => escaped += "&gt;",
            '"' => escaped += "&quot;",
            c if c.is_control() => escaped.push(' '),
            c => escaped.push(c),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{mtconnect::shdr::ShdrEncoder, snapshot::BridgeSnapshot};

    #[test]
    fn each_key_of_a_line_is_a_data_item_and_each_data_item_is_sent() {
        let both = [BridgeSnapshot::default(), BridgeSnapshot::default()];
        let mut lines = ShdrEncoder::default();
        lines.encode_changes(&both, &[], 0);
        let text = lines.encode_all(0);
        let mut sent: Vec<&str> = text
            .split(['|', '\n'])
            .filter(|part| part.starts_with("b1_") || part.starts_with("b2_"))
            .collect();
        // Messages are sent when there is something to say.
        sent.extend(["b1_message", "b2_message"]);
        sent.sort_unstable();
        let xml = devices_xml(
            "n",
            &[BridgeIdentity::default(), BridgeIdentity::default()],
            "2026-01-01T00:00:00Z",
        );
        let mut described: Vec<&str> = xml
            .split("<DataItem id=\"")
            .skip(1)
            .filter_map(|rest| rest.split_once('"').map(|(id, _)| id))
            .collect();
        described.sort_unstable();
        assert_eq!(sent, described);
    }

    #[test]
    fn a_name_that_is_no_xml_is_escaped() {
        let machine = Some("<a> & \"b\"\u{1}".to_owned());
        let bridge = BridgeIdentity { serial: Some(0xAB), machine, firmware: None };
        let xml = devices_xml("n", &[bridge], "2026-01-01T00:00:00Z");
        assert!(xml.contains("Bridge of &lt;a&gt; &amp; &quot;b&quot; <"), "{xml}");
        assert!(xml.contains("uuid=\"trueup-000000ab\""), "{xml}");
    }
}
