//! The results: a table, LinuxCNC's own faults, and the requirements that are not reached.

use std::collections::BTreeMap;

use super::{
    events::Kind,
    judge::{Beyond, By, Judge, Rule},
    rig::Way,
};

/// The share of its acceleration that a program keeps.
const ACCELERATION_MET: f64 = 0.99;
/// A probed position is right within this, in µm.
const PROBED_UM: f64 = 0.1;
/// Share of the cycles that the recorder may miss: nothing is judged across them.
const MISSING: f64 = 0.001;
/// At the soft limit a drive at rest is beyond it by this at most, in µm.
const LIMIT_UM: f64 = 0.02;

/// Results of a way of entering.
pub(crate) struct Outcome {
    pub way: Way,
    /// Acceleration of the planner, in mm/s².
    pub full_acceleration: f64,
    pub judge: Judge,
    /// The events in their order; the first has number 1.
    pub events: Vec<Kind>,
    /// The largest by which a drive was off at rest after an event, in µm.
    pub off_um: [f64; 3],
    /// The largest error of a probed position, in µm.
    pub probed_um: Option<f64>,
    /// The most by which a drive was beyond the soft limit at rest, in µm.
    pub beyond_limit_um: Option<f64>,
    /// Losses after events.
    pub lost: Vec<String>,
    /// Reason of an early end.
    pub ended: Option<String>,
    pub seconds: f64,
}

impl Outcome {
    /// Returns the smallest share of its acceleration that a rapid move has reached.
    fn acceleration(&self) -> Option<f64> {
        let moves = (1..).zip(&self.events).filter(|(_, kind)| **kind == Kind::Program);
        let reached = moves.filter_map(|(number, _)| self.judge.acceleration.get(&number));
        reached.map(|reached| reached / self.full_acceleration).reduce(f64::min)
    }

    /// Returns in how many cycles these rules were broken by us.
    fn own(&self, rules: &[Rule]) -> u64 {
        let broken = self.judge.beyond.iter();
        let ours = broken.filter(|((by, rule, _), _)| *by == By::Trueup && rules.contains(rule));
        ours.map(|(_, beyond)| beyond.cycles).sum()
    }

    /// Returns what was broken by whom, together by the kinds of events: number of events and cycles.
    fn broken(&self, whose: By) -> BTreeMap<(Rule, &'static str), (u64, Beyond)> {
        let mut all: BTreeMap<_, (u64, Beyond)> = BTreeMap::new();
        for ((by, rule, number), beyond) in &self.judge.beyond {
            if *by != whose {
                continue;
            }
            let index = usize::try_from(number - 1).ok();
            let kind = index.and_then(|index| self.events.get(index));
            let name = kind.map_or("the start", |kind| kind.name());
            let (events, together) = all.entry((*rule, name)).or_default();
            *events += 1;
            together.cycles += beyond.cycles;
            together.largest = together.largest.max(beyond.largest);
            together.limit = beyond.limit;
        }
        all
    }

    /// Returns what was not reached.
    pub(crate) fn failures(&self) -> Vec<String> {
        let mut failures: Vec<String> = self.lost.clone();
        failures.extend(self.ended.clone());
        let drive = self.own(&DRIVE);
        if drive > 0 {
            failures.push(format!("the drive's command was beyond its limits in {drive} cycles"));
        }
        let offset = self.own(&OFFSET);
        if offset > 0 {
            failures.push(format!("the offset was beyond its limits in {offset} cycles"));
        }
        let Judge { cycles, missing, .. } = self.judge;
        if missing as f64 > MISSING * cycles as f64 {
            failures.push(format!("{missing} cycles are missing, {cycles} were judged"));
        }
        let reached = self.acceleration();
        if reached.is_none_or(|share| share < ACCELERATION_MET) {
            failures.push(format!("programs had {} of their acceleration", percent(reached)));
        }
        if self.probed_um.is_none_or(|off| off > PROBED_UM) {
            failures.push(format!("a probed position was off by {}", um(self.probed_um)));
        }
        if self.beyond_limit_um.is_some_and(|beyond| beyond > LIMIT_UM) {
            failures.push(format!("beyond the soft limit by {}", um(self.beyond_limit_um)));
        }
        failures.iter().map(|what| format!("{}: {what}", self.way.name())).collect()
    }
}

const DRIVE: [Rule; 2] = [Rule::DriveSpeed, Rule::DriveAcceleration];
const OFFSET: [Rule; 7] = [
    Rule::Sum,
    Rule::Feedback,
    Rule::OffsetSpeed,
    Rule::OffsetAcceleration,
    Rule::OffsetSize,
    Rule::Request,
    Rule::Held,
];

fn percent(share: Option<f64>) -> String {
    share.map_or("none".into(), |share| format!("{:.1} %", 100.0 * share))
}

fn um(value: Option<f64>) -> String {
    value.map_or("none".into(), |value| format!("{value:.3} um"))
}

/// Returns the table, what LinuxCNC of this version did itself, and what was lost.
pub(crate) fn text(outcomes: &[Outcome], version: &str) -> String {
    let mut text = String::new();
    let mut row = |name: &str, required: &str, value: &dyn Fn(&Outcome) -> String| {
        let values: Vec<String> = outcomes.iter().map(value).collect();
        text += &format!("| {name} | {required} | {} |\n", values.join(" | "));
    };
    row("", "required", &|outcome| outcome.way.name().into());
    row("---", "---", &|_| "---".into());
    row("servo cycles", "", &|outcome| outcome.judge.cycles.to_string());
    row("servo cycles that the recorder missed", "≤ 0.1 %", &|outcome| {
        outcome.judge.missing.to_string()
    });
    row("events", "", &|outcome| outcome.events.len().to_string());
    row("drive's command beyond its limits by trueup, cycles", "0", &|outcome| {
        outcome.own(&DRIVE).to_string()
    });
    row("largest speed and acceleration of a drive's command, mm/s, mm/s²", "", &|outcome| {
        format!(
            "{:.2}, {:.0}",
            outcome.judge.seen.drive_speed, outcome.judge.seen.drive_acceleration
        )
    });
    row("offset beyond its own limits, cycles", "0", &|outcome| outcome.own(&OFFSET).to_string());
    row("largest speed and acceleration of an offset, mm/s, mm/s²", "", &|outcome| {
        format!(
            "{:.3}, {:.1}",
            outcome.judge.seen.offset_speed, outcome.judge.seen.offset_acceleration
        )
    });
    row("largest offset, µm", "", &|outcome| format!("{:.1}", 1e3 * outcome.judge.size));
    row("acceleration of a program, least", "≥ 99 %", &|outcome| percent(outcome.acceleration()));
    row("probed position off, most", "≤ 0.1 µm", &|outcome| {
        um(outcome.probed_um).replace("um", "µm")
    });
    row("drive beyond the soft limit at rest, most", "≤ 0.02 µm", &|outcome| {
        um(outcome.beyond_limit_um).replace("um", "µm")
    });
    row("drive off at rest after an event, most, X, Y, Z, µm", "", &|outcome| {
        outcome.off_um.map(|off| format!("{off:.3}")).join(", ")
    });
    row("offset lost after an event", "0", &|outcome| outcome.lost.len().to_string());
    row("minutes", "", &|outcome| format!("{:.1}", outcome.seconds / 60.0));
    text += &kinds(outcomes);
    text += &broken(outcomes, By::LinuxCnc, &format!("By LinuxCNC {version} itself"));
    text += &broken(outcomes, By::Trueup, "By trueup");
    for failure in outcomes.iter().flat_map(Outcome::failures) {
        text += &format!("not reached: {failure}\n");
    }
    text
}

/// Returns how often each kind of event happened.
fn kinds(outcomes: &[Outcome]) -> String {
    let mut counts: BTreeMap<Kind, Vec<u32>> = BTreeMap::new();
    for (way, outcome) in outcomes.iter().enumerate() {
        for kind in &outcome.events {
            counts.entry(*kind).or_insert_with(|| vec![0; outcomes.len()])[way] += 1;
        }
    }
    let line = |(kind, counts): (Kind, Vec<u32>)| {
        let counts: Vec<String> = counts.iter().map(u32::to_string).collect();
        format!("{} {}", kind.name(), counts.join(" + "))
    };
    let lines: Vec<String> = counts.into_iter().map(line).collect();
    format!("\nEvents: {}.\n", lines.join("; "))
}

fn broken(outcomes: &[Outcome], by: By, head: &str) -> String {
    let mut text = format!("\n{head}:\n");
    let mut is_empty = true;
    for outcome in outcomes {
        for ((rule, kind), (events, beyond)) in outcome.broken(by) {
            is_empty = false;
            text += &format!(
                "- {}, {kind}: {rule:?} in {} cycles of {events} events, up to {:.3}, limit {:.3}\n",
                outcome.way.name(),
                beyond.cycles,
                beyond.largest,
                beyond.limit
            );
        }
    }
    if is_empty {
        text += "- nothing\n";
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        abuse::judge::{Bounds, Entry},
        record::Cycle,
    };

    fn sound() -> Outcome {
        let bounds = Bounds {
            entry: Entry::Joint,
            planner: [30.0, 1_000.0],
            offset: [1.2, 200.0],
            drive: [31.2, 1_200.0],
            size: [0.2; 3],
        };
        let mut judge = Judge::new(bounds);
        judge.acceleration = [(1, 500.0), (2, 995.0), (3, 1_000.0)].into();
        Outcome {
            way: Way::Joint,
            full_acceleration: 1_000.0,
            judge,
            events: vec![Kind::Abort, Kind::Program, Kind::Program],
            off_um: [0.0; 3],
            probed_um: Some(0.05),
            beyond_limit_um: Some(-10.0),
            lost: Vec::new(),
            ended: None,
            seconds: 1.0,
        }
    }

    #[test]
    fn each_requirement_that_is_not_reached_is_named_and_nothing_else() {
        assert_eq!(sound().failures(), Vec::<String>::new());
        let outcome = |change: fn(&mut Outcome)| {
            let mut outcome = sound();
            change(&mut outcome);
            outcome.failures().join("\n")
        };
        for (change, named) in [
            (outcome(|outcome| outcome.judge.acceleration = [(2, 980.0)].into()), "98.0 %"),
            (outcome(|outcome| outcome.events = vec![Kind::Abort]), "none of their acceleration"),
            (outcome(|outcome| outcome.probed_um = Some(0.11)), "off by 0.110 um"),
            (outcome(|outcome| outcome.probed_um = None), "off by none"),
            (outcome(|outcome| outcome.beyond_limit_um = Some(1.0)), "beyond the soft limit"),
            (outcome(|outcome| outcome.judge.missing = 1), "1 cycles are missing"),
            (outcome(|outcome| outcome.lost.push("event 3, abort".into())), "event 3, abort"),
            (outcome(|outcome| outcome.ended = Some("the end".into())), "the end"),
        ] {
            assert!(change.contains(named) && change.lines().count() == 1, "{named}: {change}");
        }
    }

    #[test]
    fn a_step_of_linuxcncs_own_is_listed_with_its_event_and_fails_nothing() {
        let mut outcome = sound();
        for (number, x) in [(0, 0.0), (1, 0.0), (2, 0.01), (3, 0.02), (4, 0.03)] {
            let at = [x, 0.0, 0.0];
            let feedback = [if number == 0 { 0.0 } else { (x - 0.01_f64).max(0.0) }, 0.0, 0.0];
            let cycle = Cycle {
                number,
                planner: at,
                drive: at,
                feedback,
                is_on: true,
                event: 1,
                ..Cycle::default()
            };
            outcome.judge.take(Some(cycle));
        }
        outcome.judge.acceleration = [(2, 1_000.0)].into();
        assert_eq!(outcome.failures(), Vec::<String>::new());
        let text = text(&[outcome], "2.9");
        assert!(text.contains("By LinuxCNC 2.9 itself:\n- at the joint, abort: Drive"), "{text}");
        assert!(text.contains("By trueup:\n- nothing"), "{text}");
    }
}
