//! The pins of a component that runs, in words: from the text of `halcmd` to a sentence.

use std::collections::BTreeMap;

use crate::hal::is_process_alive;

/// Returns the values of `halcmd -s show pin`: owner, type, direction, value, name.
#[must_use]
pub fn parse(shown: &str) -> BTreeMap<String, String> {
    let of_line = |line: &str| {
        let mut words = line.split_whitespace().skip(3);
        let (value, name) = (words.next()?, words.next()?);
        Some((name.strip_prefix("trueup.0.")?.to_owned(), value.to_owned()))
    };
    shown.lines().filter_map(of_line).collect()
}

/// Returns what the pins say, and whether offsets are live.
#[must_use]
pub fn describe_status(pins: &BTreeMap<String, String>) -> (String, bool) {
    if pins.is_empty() {
        return ("LinuxCNC runs without the component trueup".into(), false);
    }
    // A component that is killed leaves its pins with their last values.
    let pid = pins.get("pid").and_then(|text| parse_process_id(text));
    if !pid.is_some_and(is_process_alive) {
        return (
            "LinuxCNC runs, and the component trueup was killed: its pins keep their last values"
                .into(),
            false,
        );
    }
    let is = |name: &str| pins.get(name).is_some_and(|value| value == "TRUE");
    let value = |name: &str| pins.get(name).map_or("?", String::as_str);
    let mut text = String::from("LinuxCNC runs: ");
    text += if is("connected") { "the bridge is connected" } else { "the bridge does not answer" };
    if is("fault") {
        text += ", no offset can be trusted";
    }
    if is("limited") {
        text += ", an axis cannot follow its offset";
    }
    if is("other-calibration") {
        text += ", the bridge runs on another calibration";
    }
    text +=
        if is("applied") { ", the offsets are applied" } else { ", the offsets are not applied" };
    for axis in ["x", "y", "z"] {
        text += &format!("; {axis} {} um", value(&format!("{axis}-applied-um")));
    }
    let is_live = is("connected") && is("applied") && !is("fault") && !is("limited");
    (text, is_live)
}

/// Returns the number of a process; `halcmd` shows it decimal or hexadecimal.
fn parse_process_id(text: &str) -> Option<u32> {
    match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pins_are_read_from_what_halcmd_shows() {
        let shown = format!(
            "    12  bit   OUT         TRUE  trueup.0.applied ==> trueup-applied\n\
             12  bit   OUT         TRUE  trueup.0.connected\n12  bit   OUT        FALSE  trueup.0.fault\n\
             12  u32   OUT  {:>10}  trueup.0.pid\n\
             12  float OUT         -6.5  trueup.0.x-applied-um\n\n",
            std::process::id()
        );
        let pins = parse(&shown);
        assert_eq!((pins.len(), pins["x-applied-um"].as_str()), (5, "-6.5"));
        let (text, is_live) = describe_status(&pins);
        assert!(is_live && text.contains("x -6.5 um") && text.contains("y ? um"), "{text}");
        assert!(!describe_status(&BTreeMap::new()).1);
        assert!(!describe_status(&parse(&shown.replace("FALSE", "TRUE"))).1, "a fault is not live");
    }

    #[test]
    fn pins_that_a_killed_component_has_left_are_not_live() {
        let mut ended = std::process::Command::new("true").spawn().expect("starts");
        let dead = ended.id();
        ended.wait().expect("ends");
        let all = |pid: &str| {
            let mut pins: BTreeMap<String, String> =
                ["connected", "applied"].map(|pin| (pin.into(), "TRUE".into())).into();
            pins.insert("pid".into(), pid.into());
            describe_status(&pins)
        };
        let ours = std::process::id();
        assert!(all(&ours.to_string()).1 && all(&format!("0x{ours:08X}")).1);
        for pid in [dead.to_string(), "0".into(), "?".into()] {
            let (text, is_live) = all(&pid);
            assert!(!is_live && text.contains("killed"), "{pid}: {text}");
        }
    }
}
