//! The component's pins in a LinuxCNC that runs, by `halcmd`.

use std::{collections::BTreeMap, fs, process::Command};

use anyhow::Result;

use crate::UserError;

/// Returns the component's pins; `None` if LinuxCNC does not run. `halcmd` alone would start a HAL of its own.
pub fn pins() -> Result<Option<BTreeMap<String, String>>> {
    if !is_running() {
        return Ok(None);
    }
    let shown = Command::new("halcmd").args(["-s", "show", "pin", "trueup.0."]).output();
    let shown = shown.map_err(|error| UserError(format!("halcmd cannot be started: {error}")))?;
    Ok(Some(parse(&String::from_utf8_lossy(&shown.stdout))))
}

fn is_running() -> bool {
    let names = fs::read_dir("/proc").into_iter().flatten().flatten();
    names.map(|entry| entry.path().join("comm")).any(|path| {
        fs::read_to_string(path)
            .is_ok_and(|name| name.trim() == "rtapi_app" || name.starts_with("rtapi:"))
    })
}

/// Returns the values of `halcmd -s show pin`: owner, type, direction, value, name.
fn parse(shown: &str) -> BTreeMap<String, String> {
    let of_line = |line: &str| {
        let mut words = line.split_whitespace().skip(3);
        let (value, name) = (words.next()?, words.next()?);
        Some((name.strip_prefix("trueup.0.")?.to_owned(), value.to_owned()))
    };
    shown.lines().filter_map(of_line).collect()
}

/// Returns what the pins say, and whether offsets are live.
pub fn in_words(pins: &BTreeMap<String, String>) -> (String, bool) {
    if pins.is_empty() {
        return ("LinuxCNC runs without the component trueup".into(), false);
    }
    let is = |name: &str| pins.get(name).is_some_and(|value| value == "TRUE");
    let value = |name: &str| pins.get(name).map_or("?", String::as_str);
    let mut text = String::from("LinuxCNC runs: ");
    text += if is("connected") { "the bridge is connected" } else { "the bridge is not heard" };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pins_are_read_from_what_halcmd_shows() {
        let shown = "    12  bit   OUT         TRUE  trueup.0.applied ==> trueup-applied\n\
                     12  bit   OUT         TRUE  trueup.0.connected\n12  bit   OUT        FALSE  trueup.0.fault\n\
                     12  float OUT         -6.5  trueup.0.x-applied-um\n\n";
        let pins = parse(shown);
        assert_eq!((pins.len(), pins["x-applied-um"].as_str()), (4, "-6.5"));
        let (text, is_live) = in_words(&pins);
        assert!(is_live && text.contains("x -6.5 um") && text.contains("y ? um"), "{text}");
        assert!(!in_words(&BTreeMap::new()).1);
        assert!(!in_words(&parse(&shown.replace("FALSE", "TRUE"))).1, "a fault is not live");
    }
}
