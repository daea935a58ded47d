//! Lines of SHDR from snapshots: only what has changed, or all of it for an agent that has just come.

use std::fmt::Write as _;

use trueup_client::remedy::find_remedies;
use trueup_output::escape::escape_line;

use crate::{
    clock::format_utc,
    snapshot::{BridgeEvent, BridgeSnapshot, NO_OFFSETS_REASON},
};

/// Stands for a value that is not known.
const UNAVAILABLE: &str = "UNAVAILABLE";
/// The longest text of a line, in characters.
const MAX_TEXT_CHARS: usize = 200;

/// The knowledge of an agent about a bridge: the values of its data items, and the codes of its conditions.
#[derive(Clone, Debug, Default, PartialEq)]
struct PublishedState {
    values: Vec<(String, String)>,
    conditions: Vec<ShdrCondition>,
}

#[derive(Clone, Debug, PartialEq)]
struct ShdrCondition {
    key: String,
    level: &'static str,
    /// Active codes with their texts; `None`: not known.
    codes: Option<Vec<(String, String)>>,
}

/// The lines of some bridges.
#[derive(Debug, Default)]
pub(crate) struct ShdrEncoder {
    known: Vec<PublishedState>,
}

impl ShdrEncoder {
    /// Returns the lines of what has changed since the last call, and of what has happened.
    pub(crate) fn encode_changes(
        &mut self,
        bridges: &[BridgeSnapshot],
        events: &[(usize, BridgeEvent)],
        time_ms: u64,
    ) -> String {
        let stamp = format_utc(time_ms);
        let mut lines = String::new();
        let now: Vec<PublishedState> = bridges
            .iter()
            .zip(1..)
            .map(|(bridge, number)| build_published_state(bridge, number))
            .collect();
        self.known.resize_with(now.len(), PublishedState::default);
        for (before, now) in self.known.iter().zip(&now) {
            lines += &encode_values(
                &stamp,
                now.values.iter().filter(|value| !before.values.contains(value)),
            );
            for condition in &now.conditions {
                let old = before.conditions.iter().find(|other| other.key == condition.key);
                lines += &encode_condition_change(&stamp, old, condition);
            }
        }
        for (place, event) in events {
            let (code, about) = (event.code, sanitise_field(&event.about));
            let about = if about.is_empty() { code.to_owned() } else { about };
            writeln!(lines, "{stamp}|b{}_message|{code}|{about}", place + 1).ok();
        }
        self.known = now;
        lines
    }

    /// Returns the lines of all that is known.
    #[must_use]
    pub(crate) fn encode_all(&self, time_ms: u64) -> String {
        let stamp = format_utc(time_ms);
        let all = self.known.iter().map(|known| {
            let conditions = known
                .conditions
                .iter()
                .map(|condition| encode_condition_change(&stamp, None, condition));
            encode_values(&stamp, known.values.iter()) + &conditions.collect::<String>()
        });
        all.collect()
    }
}

/// Returns one line of these values; none has none.
fn encode_values<'a>(stamp: &str, values: impl Iterator<Item = &'a (String, String)>) -> String {
    let pairs: String = values.map(|(key, value)| format!("|{key}|{value}")).collect();
    if pairs.is_empty() { pairs } else { format!("{stamp}{pairs}\n") }
}

/// Returns the lines that bring a condition from `before` to `now`.
fn encode_condition_change(
    stamp: &str,
    before: Option<&ShdrCondition>,
    now: &ShdrCondition,
) -> String {
    if before == Some(now) {
        return String::new();
    }
    let ShdrCondition { key, level, codes } = now;
    let none = Vec::new();
    match codes {
        None => format!("{stamp}|{key}|{UNAVAILABLE}||||\n"),
        // Without a code it clears all of them.
        Some(codes) if codes.is_empty() => format!("{stamp}|{key}|NORMAL||||\n"),
        Some(codes) => {
            let old = before.and_then(|before| before.codes.as_ref()).unwrap_or(&none);
            let gone = old.iter().filter(|code| !codes.contains(code));
            let gone = gone.map(|(code, _)| format!("{stamp}|{key}|NORMAL|{code}|||\n"));
            let new = codes.iter().filter(|code| !old.contains(code));
            let new = new.map(|(code, text)| format!("{stamp}|{key}|{level}|{code}|||{text}\n"));
            gone.chain(new).collect()
        }
    }
}

fn build_published_state(of: &BridgeSnapshot, number: usize) -> PublishedState {
    let key = |name: &str| format!("b{number}_{name}");
    let shown = |value: Option<f64>, decimals: usize| {
        value.map_or(UNAVAILABLE.into(), |value| format!("{value:.decimals$}"))
    };
    let mm = |um: Option<f64>| shown(um.map(|um| um / 1_000.0), 6);
    let available = if of.is_up { "AVAILABLE" } else { UNAVAILABLE };
    let mut values = vec![(key("avail"), available.to_owned())];
    for (place, axis) in ["x", "y", "z"].into_iter().enumerate() {
        values.push((key(&format!("offset_{axis}")), mm(of.offset_um[place])));
        values.push((key(&format!("position_{axis}")), shown(of.position_mm[place], 5)));
    }
    values.push((key("elongation"), mm(of.elongation_um)));
    for (channel, celsius) in of.temperature_c.iter().enumerate() {
        values.push((key(&format!("temperature_{channel}")), shown(*celsius, 2)));
    }
    let words = |words: &[&'static str]| {
        let coded = |word: &&'static str| {
            let text = find_remedies(&[*word]).first().map_or(*word, |(_, text)| *text);
            ((*word).to_owned(), sanitise_field(text))
        };
        of.has_status.then(|| words.iter().map(coded).collect())
    };
    let why = of.why.as_deref().unwrap_or(NO_OFFSETS_REASON);
    let line =
        if of.is_up { Vec::new() } else { vec![("bridge-down".into(), sanitise_field(why))] };
    let condition = |name, level, codes| ShdrCondition { key: key(name), level, codes };
    let conditions = vec![
        condition("faults", "FAULT", words(&of.faults)),
        condition("state", "WARNING", words(&of.state)),
        condition("line", "FAULT", Some(line)),
    ];
    PublishedState { values, conditions }
}

/// Returns a text that cannot be taken for the next field or line.
fn sanitise_field(text: &str) -> String {
    let text = escape_line(text).replace('|', "/");
    text.chars().take(MAX_TEXT_CHARS).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn up() -> BridgeSnapshot {
        BridgeSnapshot {
            is_up: true,
            has_status: true,
            offset_um: [Some(1.25), Some(0.0), None],
            faults: vec!["store", "cnc-lost"],
            ..BridgeSnapshot::default()
        }
    }

    #[test]
    fn an_agent_that_comes_gets_all_and_then_only_changes() {
        let mut lines = ShdrEncoder::default();
        let first = lines.encode_changes(&[up()], &[], 0);
        assert_eq!(lines.encode_all(0), first);
        assert!(first.starts_with(
            "1970-01-01T00:00:00.000Z|b1_avail|AVAILABLE|b1_offset_x|0.001250|b1_position_x|UNAVAILABLE|"
        ));
        assert!(
            first.contains("|b1_faults|FAULT|store|||") && first.contains("|b1_state|NORMAL||||\n")
        );
        assert_eq!(lines.encode_changes(&[up()], &[], 1), "");
        let cleared = BridgeSnapshot { faults: vec!["cnc-lost"], ..up() };
        let line = "1970-01-01T00:00:00.002Z|b1_faults|NORMAL|store|||\n";
        assert_eq!(lines.encode_changes(&[cleared], &[], 2), line);
        let unknown = BridgeSnapshot { has_status: false, ..up() };
        let mut others = ShdrEncoder::default();
        let first = others.encode_changes(&[unknown], &[], 2);
        assert!(first.contains("|b1_faults|UNAVAILABLE||||\n"), "{first}");
        let none = BridgeSnapshot { faults: Vec::new(), ..up() };
        let line = "1970-01-01T00:00:00.003Z|b1_faults|NORMAL||||\n";
        assert_eq!(lines.encode_changes(&[none], &[], 3), line);
    }

    #[test]
    fn a_bridge_that_is_lost_is_unavailable_throughout_and_says_why_in_one_field() {
        let mut lines = ShdrEncoder::default();
        lines.encode_changes(&[up()], &[], 0);
        let down = BridgeSnapshot { why: Some("a|b\nc".into()), ..BridgeSnapshot::default() };
        let changes =
            lines.encode_changes(&[down], &[(0, BridgeEvent::new("bridge-down", "a|b\nc"))], 1);
        assert!(changes.contains("|b1_avail|UNAVAILABLE|b1_offset_x|UNAVAILABLE"), "{changes}");
        assert!(changes.contains("|b1_faults|UNAVAILABLE||||\n"), "{changes}");
        assert!(changes.contains("|b1_line|FAULT|bridge-down|||a/b"), "{changes}");
        assert!(changes.contains("|b1_message|bridge-down|a/b"), "{changes}");
        for line in changes.lines() {
            assert!(line.starts_with("1970-"), "{line}");
        }
    }
}
