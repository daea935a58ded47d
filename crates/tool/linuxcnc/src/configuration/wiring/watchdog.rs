//! Stops the feed and the offsets at the joints while the component is gone.
//!
//! ```text
//!  component.heartbeat ─► oneshot ─┬─► not ─► motion.feed-inhibit
//!                                  ├─► oneshot, where it falls ─► message
//!                                  └─► mux8: speed of the offset, or 0 ─► limit2 ─► moveoff.offset-vel
//! ```
//!
//! `moveoff` alone does not stay where it was left: from rest, with an input that stands above its output, it goes away from
//! its goal (`joint_offsets.rs`), and the component that keeps it from that is gone. A largest speed of 0 keeps it where it is,
//! whatever its input. `limit2` takes the speed to 0 by the acceleration of the offset, so that one on its way stops without a step.

use std::fmt::Write as _;

use super::{HalWriter, LIMITER_INSTANCE};
use crate::configuration::finding::{ConfigurationFinding, OffsetRequirements};

/// Falls when the heartbeat has stood for 0.3 s.
pub(super) const ALIVE_ONESHOT: &str = "trueup-alive";
/// The signal of it.
const ALIVE_SIGNAL: &str = "trueup-lives";
/// Rises when that falls; it is not there before the first heartbeat, and so is no message.
const ALIVE_LOST_ONESHOT: &str = "trueup-went";
/// Where a message of the program has more.
const LOG_HINT: &str = " (trueup.log)";
const OPERATOR_MESSAGES: [(&str, &str, &str); 4] = [
    (
        "trueup-no-offsets",
        "trueup-fault",
        "trueup: no offsets (bridge silent or its inputs failed or LinuxCNC does not take them)",
    ),
    (
        "trueup-not-followed",
        "trueup-limited",
        "trueup: an axis cannot follow its offset (soft limit or joint mode or no OFFSET_AV_RATIO)",
    ),
    (
        "trueup-other-cal",
        "trueup-other",
        "trueup: nothing is engaged because the bridge runs on another calibration (trueup.log)",
    ),
    (
        "trueup-gone",
        "trueup-went",
        "trueup: the feed is held because the component has stopped or a wire of it is cut (trueup.log)",
    ),
];

/// Returns the instances that switch the largest speed of these joints, and those that change it by a ramp.
fn speed_ramp_instances(names: &[String]) -> [Vec<String>; 2] {
    ["go", "speed"].map(|end| names.iter().map(|name| format!("{name}-{end}")).collect())
}

impl HalWriter<'_> {
    /// Loads what takes the speed of the offsets to 0, and returns its functions in their order.
    pub(super) fn write_speed_ramp_loads(
        &mut self,
        text: &mut String,
        names: &[String],
    ) -> Vec<String> {
        let [switches, ramps] = speed_ramp_instances(names);
        self.write_loadrt(text, "mux8", &switches);
        self.write_loadrt(text, "limit2", &ramps);
        [switches, ramps].concat()
    }

    /// Connects it for a joint; its speed and its acceleration come to `go.in1` and `speed.maxv`.
    pub(super) fn write_speed_ramp_nets(text: &mut String, name: &str, channel: usize) {
        let _ = write!(
            text,
            "net {ALIVE_SIGNAL} => {name}-go.sel0\n\
             setp {name}-go.in0 0\n\
             net {name}-go {name}-go.out => {name}-speed.in\n\
             net {name}-speed {name}-speed.out => {LIMITER_INSTANCE}.offset-vel-{channel}\n"
        );
    }

    /// Holds the feed while the component is gone.
    pub(super) fn write_watchdog(&mut self, text: &mut String, thread: &str) {
        text.push_str("\n# Holds the feed while the component is gone.\n");
        self.write_loadrt(text, "oneshot", &[ALIVE_ONESHOT.into(), ALIVE_LOST_ONESHOT.into()]);
        for (name, width, rising) in
            [(ALIVE_ONESHOT, "0.3", "TRUE"), (ALIVE_LOST_ONESHOT, "1", "FALSE")]
        {
            let _ = write!(
                text,
                "addf {name} {thread}\nsetp {name}.width {width}\nsetp {name}.rising {rising}\n\
                 setp {name}.falling TRUE\nsetp {name}.retriggerable TRUE\n"
            );
        }
        if let Some(link) = self.hal.find_final_link("motion.feed-inhibit") {
            self.findings.push(ConfigurationFinding::error(
                link.place,
                format!("motion.feed-inhibit is on the signal {} already", link.signal),
                format!(
                    "take it off, or join both by or2: setup needs the pin for {ALIVE_ONESHOT}.out-not"
                ),
            ));
        }
        let _ = writeln!(
            text,
            "net trueup-hold {ALIVE_ONESHOT}.out-not => motion.feed-inhibit\n\
             net {ALIVE_SIGNAL} {ALIVE_ONESHOT}.out => {ALIVE_LOST_ONESHOT}.in\nnet {ALIVE_LOST_ONESHOT} {ALIVE_LOST_ONESHOT}.out"
        );
    }

    /// Shows the operator a message, on whatever screen there is. A module that the user has loaded is left to the user.
    pub(super) fn write_operator_messages(
        &self,
        text: &mut String,
        thread: &str,
        demand: &OffsetRequirements,
    ) {
        if self.hal.find_loadrt("message").is_some() {
            return;
        }
        let list = |of: fn(&(&'static str, &'static str, &'static str)) -> &'static str| {
            OPERATOR_MESSAGES.iter().map(of).collect::<Vec<_>>().join(",")
        };
        let mut messages = list(|entry| entry.2);
        if demand.no_board.is_some() {
            // The realtime component has no log of its own.
            messages = messages.replace(LOG_HINT, "");
        }
        let _ = writeln!(
            text,
            "\nloadrt message names={} messages=\"{messages}\"",
            list(|entry| entry.0)
        );
        for (name, signal, _) in OPERATOR_MESSAGES {
            let _ = write!(
                text,
                "addf {name} {thread}\nsetp {name}.edge TRUE\nnet {signal} => {name}.trigger\n"
            );
        }
    }
}
