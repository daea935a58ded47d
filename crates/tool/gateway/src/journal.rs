//! Which lines are written: at most a megabyte a day, and no change is lost.
//!
//! ```text
//! change ──► pending ──► a line, if the allowance has its bytes      allowance ≤ 250 kB, + 8.5 bytes/s
//!             by member: how often, which values                     any 24 h: ≤ 250 kB + 734 kB
//! ```
//!
//! Without changes a line comes each `JOURNAL_PERIOD`. A line that flaps uses up the allowance; its changes are then counted
//! and written with the next line, which comes as soon as it is allowed. Time is an argument.

use std::{collections::BTreeMap, time::Duration};

use serde_json::{Value, json};

use crate::gateway_status::IMMEDIATE_MEMBERS;

/// From one line to the next where nothing changes.
pub(crate) const JOURNAL_PERIOD: Duration = Duration::from_secs(300);
/// The same for a person who watches; then no line is withheld.
pub(crate) const INTERACTIVE_JOURNAL_PERIOD: Duration = Duration::from_secs(1);
/// The largest allowance, in bytes: two hundred changes at once.
const MAX_ALLOWANCE_BYTES: f64 = 250_000.0;
/// Rate at which the allowance grows: with the largest allowance 0.98 MB in 24 hours.
const REFILL_BYTES_PER_S: f64 = 8.5;
/// Different values of a member that are listed in one line; others are only counted.
const MAX_LISTED_VALUES: usize = 8;

/// The changes of a member since the last line.
#[derive(Debug, Default)]
struct MemberChanges {
    count: u64,
    values: Vec<Value>,
}

/// Decides which lines are written.
#[derive(Debug)]
pub struct JournalLimiter {
    period: Duration,
    is_limited: bool,
    due: Option<Duration>,
    allowance: f64,
    filled: Duration,
    seen: Option<Vec<Value>>,
    pending: BTreeMap<String, MemberChanges>,
}

impl JournalLimiter {
    /// Creates a journal; `is_watched`: a line each second without a limit.
    #[must_use]
    pub fn new(is_watched: bool) -> Self {
        Self {
            period: if is_watched { INTERACTIVE_JOURNAL_PERIOD } else { JOURNAL_PERIOD },
            is_limited: !is_watched,
            due: None,
            allowance: MAX_ALLOWANCE_BYTES,
            filled: Duration::ZERO,
            seen: None,
            pending: BTreeMap::new(),
        }
    }

    /// Returns true if a line is to be written at `now`, where the state is `line`; its changes are counted.
    pub fn is_due(&mut self, now: Duration, line: &Value) -> bool {
        self.refill_allowance(now);
        let values = IMMEDIATE_MEMBERS.map(|name| line.pointer(name).cloned().unwrap_or_default());
        if let Some(before) = self.seen.replace(values.to_vec()) {
            let all = IMMEDIATE_MEMBERS.into_iter().zip(values).zip(before);
            for ((name, value), _) in all.filter(|((_, value), before)| value != before) {
                self.record_change(name.trim_start_matches('/').replace('/', "."), value);
            }
        }
        let is_requested = !self.pending.is_empty() || self.due.is_none_or(|due| now >= due);
        is_requested && self.has_allowance(self.add_pending_changes(line.clone()).to_string().len())
    }

    /// Returns the line to write, with the changes since the last one.
    pub fn take_entry(&mut self, now: Duration, line: Value) -> String {
        let text = self.add_pending_changes(line).to_string();
        self.pending.clear();
        self.due = Some(now + self.period);
        self.consume_allowance(text.len());
        text
    }

    /// Returns true if the message is to be written at once; else the next line counts it.
    pub fn admit_message(&mut self, now: Duration, message: &str) -> bool {
        self.refill_allowance(now);
        let is_allowed = self.has_allowance(message.len());
        if is_allowed {
            self.consume_allowance(message.len());
        } else {
            self.record_change("message".into(), message.into());
        }
        is_allowed
    }

    fn record_change(&mut self, member: String, value: Value) {
        let changes = self.pending.entry(member).or_default();
        changes.count = changes.count.saturating_add(1);
        if changes.values.len() < MAX_LISTED_VALUES && !changes.values.contains(&value) {
            changes.values.push(value);
        }
    }

    /// Returns `line` with what is pending.
    fn add_pending_changes(&self, mut line: Value) -> Value {
        let all = self.pending.iter().map(|(member, changes)| {
            (member.clone(), json!({ "count": changes.count, "values": changes.values }))
        });
        let all: serde_json::Map<String, Value> = all.collect();
        if let Some(line) = line.as_object_mut().filter(|_| !all.is_empty()) {
            line.insert("changes".into(), all.into());
        }
        line
    }

    fn refill_allowance(&mut self, now: Duration) {
        let passed_s = now.saturating_sub(self.filled).as_secs_f64();
        self.allowance = (self.allowance + REFILL_BYTES_PER_S * passed_s).min(MAX_ALLOWANCE_BYTES);
        self.filled = now;
    }

    fn has_allowance(&self, bytes: usize) -> bool {
        !self.is_limited || self.allowance >= bytes_with_line_end(bytes)
    }

    fn consume_allowance(&mut self, bytes: usize) {
        self.allowance = (self.allowance - bytes_with_line_end(bytes)).max(0.0);
    }
}

/// Returns the bytes of a line with its end.
fn bytes_with_line_end(bytes: usize) -> f64 {
    bytes as f64 + 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: Duration = Duration::from_millis(500);
    const DAY: Duration = Duration::from_secs(86_400);
    /// As much as a line says with every member at its longest.
    const FILL: usize = 900;

    /// Writes a day in which the bridge is received as `is_heard` says; the entries.
    fn day(is_received: impl Fn(u32) -> bool) -> Vec<String> {
        let (mut journal, mut now, mut all) =
            (JournalLimiter::new(false), Duration::ZERO, Vec::new());
        let line = |is_received: bool| json!({ "bridge": { "heard": is_received, "state": "x".repeat(FILL) } });
        let lines = [line(false), line(true)];
        for step in 0.. {
            let line = &lines[usize::from(is_received(step))];
            if journal.is_due(now, line) {
                all.push(journal.take_entry(now, line.clone()));
            }
            now += STEP;
            if now >= DAY {
                return all;
            }
        }
        all
    }

    fn bytes(all: &[String]) -> usize {
        all.iter().map(|entry| entry.len() + 1).sum()
    }

    fn changes(all: &[String]) -> u64 {
        let of = |entry: &String| {
            let entry: Value = serde_json::from_str(entry).expect("JSON");
            entry["changes"]["bridge.heard"]["count"].as_u64().unwrap_or(0)
        };
        all.iter().map(of).sum()
    }

    #[test]
    fn a_quiet_day_has_a_line_each_five_minutes() {
        let all = day(|_| true);
        assert_eq!(all.len(), 288);
        assert!(bytes(&all) < 400_000);
    }

    #[test]
    fn each_change_of_a_usual_day_has_its_own_line_at_once() {
        // A hundred times it is gone for a second.
        let all = day(|step| step % 1_728 >= 2);
        assert_eq!(changes(&all), 199);
        assert!(all.len() >= 199 + 200 && bytes(&all) <= 1_000_000, "{}", bytes(&all));
    }

    #[test]
    fn a_line_that_flaps_all_day_fills_no_disk_and_each_change_is_counted() {
        let all = day(|step| step % 2 == 0);
        assert!(bytes(&all) <= 1_000_000, "{}", bytes(&all));
        // But for those after the last line.
        let flips = DAY.as_millis() / STEP.as_millis() - 1;
        assert!(u128::from(changes(&all)) + 1_000 > flips, "{}", changes(&all));
        assert!(
            all[all.len() - 1].contains("[false,true]")
                || all[all.len() - 1].contains("[true,false]")
        );
    }

    #[test]
    fn a_message_that_is_withheld_is_counted_and_one_who_watches_sees_all() {
        let mut journal = JournalLimiter::new(false);
        let message = "x".repeat(10_000);
        let written = (0..30).filter(|_| journal.admit_message(Duration::ZERO, &message)).count();
        assert_eq!(written, 24);
        let line = json!({ "bridge": {} });
        assert!(!journal.is_due(Duration::ZERO, &line), "there is no room");
        let later = Duration::from_secs(3_000);
        assert!(journal.is_due(later, &line));
        assert!(journal.take_entry(later, line.clone()).contains("\"count\":6"));
        let mut journal = JournalLimiter::new(true);
        let seconds = (0..3_600).map(Duration::from_secs);
        let lines = seconds.filter(|now| {
            let is_due = journal.is_due(*now, &line);
            is_due.then(|| journal.take_entry(*now, line.clone())).is_some()
        });
        assert_eq!(lines.count(), 3_600);
    }
}
