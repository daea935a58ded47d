//! How both ends are, as a line of JSON. When it is written, [`crate::journal`] decides.

use std::sync::{Arc, Mutex, PoisonError};

use serde_json::{Value, json};
use trueup_client::words::{output_json, state_words};
use trueup_link::status::StateBits;
use trueup_modbus::cnc::Refused;

use crate::{
    bridge::Shared,
    hub::{MAY_BE_OLD, OTHER_CALIBRATION},
};

/// State of the PLC's end.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlcEnd {
    /// It is connected, or at least one master is.
    pub is_up: bool,
    /// Why it last was not.
    pub why: Option<String>,
    /// Blocks that it has been given.
    pub given: u64,
    /// The longest that one took since the last line, in milliseconds.
    pub longest_ms: f64,
}

/// State of the PLC's end, shared between threads.
#[derive(Clone, Debug, Default)]
pub struct End(Arc<Mutex<PlcEnd>>);

impl End {
    /// Returns how it is; the longest write is counted anew from here.
    #[must_use]
    pub fn take(&self) -> PlcEnd {
        let mut end = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let now = end.clone();
        end.longest_ms = 0.0;
        now
    }

    /// Returns how it is.
    #[must_use]
    pub fn look(&self) -> PlcEnd {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Changes it.
    pub fn change(&self, change: impl FnOnce(&mut PlcEnd)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

/// Returns what a line says.
#[must_use]
pub fn line(shared: &Shared, plc: &PlcEnd) -> Value {
    let now = shared.now();
    let bridge_line = shared.line();
    let hub = shared.hub();
    let (said, counters) = (hub.said(), hub.counters());
    let mut bridge = output_json(Some(&said.output));
    if let Some(bridge) = bridge.as_object_mut() {
        bridge.insert("line".into(), word(bridge_line.is_up).into());
        bridge.insert("why".into(), bridge_line.why.into());
        bridge.insert("heard".into(), hub.receives_bridge(now).into());
        bridge.insert("age_ms".into(), said.age_ms.into());
        bridge.insert("state".into(), state_words(StateBits(said.state)).into());
        let wrong = counters.crc_errors + counters.sequence_errors + counters.malformed;
        bridge.insert("refused_frames".into(), wrong.into());
        bridge.insert("lost_frames".into(), counters.lost.into());
        bridge.insert("stalls".into(), hub.stalls().into());
        let pinned = hub.pinned();
        let expected = pinned.expected().map(|crc| format!("{crc:08x}"));
        bridge.insert("pinned_calibration".into(), expected.into());
        bridge.insert("not_engaged".into(), pinned.refusal().into());
    }
    let control = hub.control(now);
    json!({
        "t_s": (now.as_secs_f64() * 1e3).round() / 1e3,
        "bridge": bridge,
        "plc": {
            "line": word(plc.is_up),
            "why": plc.why,
            "given": plc.given,
            "longest_ms": (plc.longest_ms * 1e3).round() / 1e3,
            "heard": control.is_some(),
            "engage": control.map(|control| control.engage),
            "refused": said.refused,
            "last_refused": refused_word(said.last_refused),
        },
    })
}

/// The members that are written at once when they change.
pub(crate) const NEWS: [&str; 7] = [
    "/bridge/line",
    "/bridge/heard",
    "/bridge/quality",
    "/bridge/state",
    "/plc/line",
    "/plc/heard",
    "/plc/engage",
];

fn word(is_up: bool) -> &'static str {
    if is_up { "up" } else { "down" }
}

fn refused_word(number: u16) -> Option<String> {
    match number {
        MAY_BE_OLD => return Some("it came after a silence and may be old".into()),
        OTHER_CALIBRATION => {
            return Some("Engage, but the bridge runs on another calibration".into());
        }
        _ => {}
    }
    [Refused::Malformed, Refused::Damaged, Refused::Repeated, Refused::WrongSequence]
        .into_iter()
        .find(|it| *it as u16 == number)
        .map(|it| it.to_string())
}
