//! How both ends are, as a line of JSON. When it is written, [`crate::journal`] decides.

use std::sync::{Arc, Mutex, PoisonError};

use serde_json::{Value, json};
use trueup_client::state_text::{output_to_json, state_names};
use trueup_link::status::StateBits;
use trueup_modbus::holding_block::BlockRejectReason;

use crate::{
    bridge::SharedHub,
    hub::{REJECT_REASON_CALIBRATION, REJECT_REASON_STALE},
};

/// State of the PLC's end.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlcStatus {
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
pub struct SharedPlcStatus(Arc<Mutex<PlcStatus>>);

impl SharedPlcStatus {
    /// Returns how it is; the longest write is counted anew from here.
    #[must_use]
    pub fn snapshot_and_reset_longest_write(&self) -> PlcStatus {
        let mut end = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let now = end.clone();
        end.longest_ms = 0.0;
        now
    }

    /// Returns how it is.
    #[must_use]
    pub fn snapshot(&self) -> PlcStatus {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Changes it.
    pub fn update(&self, change: impl FnOnce(&mut PlcStatus)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

/// Returns what a line says.
#[must_use]
pub fn build_status_line(shared: &SharedHub, plc: &PlcStatus) -> Value {
    let now = shared.now();
    let bridge_line = shared.link_state();
    let hub = shared.lock_hub();
    let (input, counters) = (hub.current_input_block(), hub.counters());
    let mut bridge = output_to_json(Some(&input.output));
    if let Some(bridge) = bridge.as_object_mut() {
        bridge.insert("line".into(), link_state_name(bridge_line.is_up).into());
        bridge.insert("why".into(), bridge_line.why.into());
        bridge.insert("heard".into(), hub.has_fresh_output(now).into());
        bridge.insert("age_ms".into(), input.age_ms.into());
        bridge.insert("state".into(), state_names(StateBits(input.state)).into());
        let wrong = counters.crc_errors + counters.sequence_errors + counters.malformed;
        bridge.insert("refused_frames".into(), wrong.into());
        bridge.insert("lost_frames".into(), counters.lost.into());
        bridge.insert("stalls".into(), hub.stall_count().into());
        let pinned = hub.pinned_calibration();
        let expected = pinned.expected_crc().map(|crc| format!("{crc:08x}"));
        bridge.insert("pinned_calibration".into(), expected.into());
        bridge.insert("not_engaged".into(), pinned.refusal().into());
    }
    let control = hub.fresh_control(now);
    json!({
        "t_s": (now.as_secs_f64() * 1e3).round() / 1e3,
        "bridge": bridge,
        "plc": {
            "line": link_state_name(plc.is_up),
            "why": plc.why,
            "given": plc.given,
            "longest_ms": (plc.longest_ms * 1e3).round() / 1e3,
            "heard": control.is_some(),
            "engage": control.map(|control| control.engage),
            "refused": input.refused,
            "last_refused": reject_reason_text(input.last_refused),
        },
    })
}

/// The members that are written at once when they change.
pub(crate) const IMMEDIATE_MEMBERS: [&str; 7] = [
    "/bridge/line",
    "/bridge/heard",
    "/bridge/quality",
    "/bridge/state",
    "/plc/line",
    "/plc/heard",
    "/plc/engage",
];

fn link_state_name(is_up: bool) -> &'static str {
    if is_up { "up" } else { "down" }
}

fn reject_reason_text(number: u16) -> Option<String> {
    match number {
        REJECT_REASON_STALE => return Some("it came after a silence and may be old".into()),
        REJECT_REASON_CALIBRATION => {
            return Some("Engage, but the bridge runs on another calibration".into());
        }
        _ => {}
    }
    [
        BlockRejectReason::Malformed,
        BlockRejectReason::Damaged,
        BlockRejectReason::Repeated,
        BlockRejectReason::WrongSequence,
    ]
    .into_iter()
    .find(|reason| *reason as u16 == number)
    .map(|reason| reason.to_string())
}
