//! Stops the feed and the offsets at the joints while the component is gone.
//!
//! ```text
//!  component.heartbeat ─► oneshot ─┬─► not ─► motion.feed-inhibit
//!                                  ├─► oneshot, where it falls ─► message
//!                                  └─► mux8: speed of the offset, or 0 ─► limit2 ─► moveoff.offset-vel
//! ```
//!
//! `moveoff` alone does not stay where it was left: from rest, with an input that stands above its output, it goes away from
//! its goal (`joint.rs`), and the component that keeps it from that is gone. A largest speed of 0 keeps it where it is,
//! whatever its input. `limit2` takes the speed to 0 by the acceleration of the offset, so that one on its way stops without a step.

use std::fmt::Write as _;

use super::{LIMITER, Writer};
use crate::configuration::finding::{Demand, Finding};

/// Falls when the heartbeat has stood for 0.3 s.
pub(super) const ALIVE: &str = "trueup-alive";
/// The signal of it.
const LIVES: &str = "trueup-lives";
/// Rises when that falls; it is not there before the first heartbeat, and so is no message.
const WENT: &str = "trueup-went";
/// Where a message of the program has more.
const LOG_HINT: &str = " (trueup.log)";
const MESSAGES: [(&str, &str, &str); 4] = [
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
fn instances(names: &[String]) -> [Vec<String>; 2] {
    ["go", "speed"].map(|end| names.iter().map(|name| format!("{name}-{end}")).collect())
}

impl Writer<'_> {
    /// Loads what takes the speed of the offsets to 0, and returns its functions in their order.
    pub(super) fn load_stops(&mut self, text: &mut String, names: &[String]) -> Vec<String> {
        let [switches, ramps] = instances(names);
        self.load(text, "mux8", &switches);
        self.load(text, "limit2", &ramps);
        [switches, ramps].concat()
    }

    /// Connects it for a joint; its speed and its acceleration come to `go.in1` and `speed.maxv`.
    pub(super) fn stop(text: &mut String, name: &str, channel: usize) {
        let _ = write!(
            text,
            "net {LIVES} => {name}-go.sel0\n\
             setp {name}-go.in0 0\n\
             net {name}-go {name}-go.out => {name}-speed.in\n\
             net {name}-speed {name}-speed.out => {LIMITER}.offset-vel-{channel}\n"
        );
    }

    /// Holds the feed while the component is gone.
    pub(super) fn watchdog(&mut self, text: &mut String, thread: &str) {
        text.push_str("\n# Holds the feed while the component is gone.\n");
        self.load(text, "oneshot", &[ALIVE.into(), WENT.into()]);
        for (name, width, rising) in [(ALIVE, "0.3", "TRUE"), (WENT, "1", "FALSE")] {
            let _ = write!(
                text,
                "addf {name} {thread}\nsetp {name}.width {width}\nsetp {name}.rising {rising}\n\
                 setp {name}.falling TRUE\nsetp {name}.retriggerable TRUE\n"
            );
        }
        if let Some(link) = self.hal.link_at_last("motion.feed-inhibit") {
            self.findings.push(Finding::error(
                link.place,
                format!("motion.feed-inhibit is on the signal {} already", link.signal),
                format!(
                    "take it off, or join both by or2: setup needs the pin for {ALIVE}.out-not"
                ),
            ));
        }
        let _ = writeln!(
            text,
            "net trueup-hold {ALIVE}.out-not => motion.feed-inhibit\n\
             net {LIVES} {ALIVE}.out => {WENT}.in\nnet {WENT} {WENT}.out"
        );
    }

    /// Tells the operator, on whatever screen there is. A module that the user has loaded is left to the user.
    pub(super) fn messages(&self, text: &mut String, thread: &str, demand: &Demand) {
        if self.hal.loads("message").is_some() {
            return;
        }
        let list = |of: fn(&(&'static str, &'static str, &'static str)) -> &'static str| {
            MESSAGES.iter().map(of).collect::<Vec<_>>().join(",")
        };
        let mut messages = list(|it| it.2);
        if demand.no_board.is_some() {
            // The realtime component has no log of its own.
            messages = messages.replace(LOG_HINT, "");
        }
        let _ =
            writeln!(text, "\nloadrt message names={} messages=\"{messages}\"", list(|it| it.0));
        for (name, signal, _) in MESSAGES {
            let _ = write!(
                text,
                "addf {name} {thread}\nsetp {name}.edge TRUE\nnet {signal} => {name}.trigger\n"
            );
        }
    }
}
