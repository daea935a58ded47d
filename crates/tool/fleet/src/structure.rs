//! One structure of the model for all machines of a series.
//!
//! Each diagnosis adds the causes that its own record shows. A cause that is too small to be found on one machine biases
//! the constants of its other causes, and is missing from the mean; so constants of different models are not those of one
//! population. Here every record is fitted with the causes that the series has in common.
//!
//! | a cause | is fitted |
//! |---|---|
//! | found on a quarter of the machines, and on three | together with all others of that kind, on every machine |
//! | claimed on one machine at least | alone next to that, on every other machine |
//! | found, not claimed, and not separated there from one that more machines have | not: the other one in its place |

use std::collections::{BTreeMap, BTreeSet};

use crate::{
    findings::{CauseIdentity, NamedFinding},
    record::MachineRecord,
};

/// The share of machines on which a common cause is found.
const MIN_COMMON_CAUSE_FRACTION: f64 = 0.25;
/// The fewest machines on which it is.
const MIN_COMMON_CAUSE_MACHINES: usize = 3;

/// The terms to be fitted to a record.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FitRequest {
    /// The causes of the model.
    pub together: Vec<CauseIdentity>,
    /// Causes that are fitted alone next to it.
    pub alone: Vec<CauseIdentity>,
}

/// The constants of each cause that was asked, in its order; none where the record does not allow it.
#[derive(Clone, Debug, Default)]
pub struct FittedConstants {
    /// Of the causes of the model.
    pub together: Vec<Option<NamedFinding>>,
    /// Of those next to it.
    pub alone: Vec<Option<NamedFinding>>,
}

/// Returns what is to be fitted to each record; none where its own diagnosis has all that the series has.
#[must_use]
pub fn select_causes_to_fit(records: &[MachineRecord]) -> Vec<Option<FitRequest>> {
    records.iter().map(|record| select_causes_for_record(record, records)).collect()
}

fn select_causes_for_record(
    record: &MachineRecord,
    records: &[MachineRecord],
) -> Option<FitRequest> {
    let alike = || records.iter().filter(|other| other.quantity == record.quantity);
    let machines: BTreeSet<&str> = alike().map(|record| record.machine.as_str()).collect();
    let mut found_on: BTreeMap<&CauseIdentity, BTreeSet<&str>> = BTreeMap::new();
    let mut claimed: BTreeSet<&CauseIdentity> = BTreeSet::new();
    for other in alike() {
        for found in other.found.iter().filter(|finding| !finding.constants.is_empty()) {
            let Some(identity) = &found.identity else { continue };
            found_on.entry(identity).or_default().insert(&other.machine);
            if found.claimed && other.machine != record.machine {
                claimed.insert(identity);
            }
        }
    }
    let count = |identity: &CauseIdentity| found_on.get(identity).map_or(0, BTreeSet::len);
    let least = ((MIN_COMMON_CAUSE_FRACTION * machines.len() as f64).ceil() as usize)
        .max(MIN_COMMON_CAUSE_MACHINES);
    let is_common = |identity: &CauseIdentity| count(identity) >= least;
    // Another name for what more machines call otherwise.
    let is_replaced = |own: &NamedFinding| {
        let common = found_on.keys().filter(|key| is_common(key));
        let mut names = common.filter(|key| own.alternatives.contains(&key.name(&record.quantity)));
        !own.claimed
            && own.identity.as_ref().is_some_and(|own| names.any(|name| count(name) > count(own)))
    };
    let own = record.found.iter().filter(|finding| !is_replaced(finding));
    let mut together: Vec<CauseIdentity> =
        own.filter_map(|finding| finding.identity.clone()).collect();
    let before = together.len();
    let missing = found_on.keys().filter(|key| is_common(key) && !together.contains(**key));
    let missing: Vec<CauseIdentity> = missing.map(|key| (*key).clone()).collect();
    together.extend(missing);
    let is_whole = together.len() == before && before == record.found.len();
    let alone = claimed.into_iter().filter(|key| !together.contains(*key));
    let alone: Vec<CauseIdentity> = alone.cloned().collect();
    (!is_whole || !alone.is_empty()).then_some(FitRequest { together, alone })
}

impl MachineRecord {
    /// Takes the constants of the model of the series in the place of its own.
    pub fn replace_constants(&mut self, answered: FittedConstants) {
        let fitted: Vec<NamedFinding> = answered.together.into_iter().flatten().collect();
        for own in &mut self.found {
            // What another cause stands for, and what is more than a name, says nothing to the series.
            own.constants = match fitted.iter().find(|other| other.name == own.name) {
                Some(fit) => fit.constants.clone(),
                None => Vec::new(),
            };
        }
        let is_new = |finding: &NamedFinding| self.found.iter().all(|own| own.name != finding.name);
        let new: Vec<NamedFinding> = fitted.into_iter().filter(is_new).collect();
        self.fitted = new;
        self.fitted.extend(answered.alone.into_iter().flatten());
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use crate::findings;

    fn record(machine: &str, causes: &[(&str, bool)]) -> MachineRecord {
        let finding = |(cause, claimed): &(&str, bool)| -> Value {
            json!({
                "cause": cause, "claimed": claimed,
                "parameters": {"um_per_c": {"value": 1.0, "ci95": [0.8, 1.2]}},
                "rivals": [{"cause": "heat", "score_gap": if *cause == "slow" { 1.0 } else { 9.0 }}],
            })
        };
        let findings: Vec<Value> = causes.iter().map(finding).collect();
        MachineRecord {
            machine: machine.into(),
            day: None,
            verdict: "explained".into(),
            quantity: "dz".into(),
            belief: String::new(),
            found: findings::parse_findings(&json!({"quantity": "dz", "findings": findings})),
            fitted: Vec::new(),
        }
    }

    fn names(of: &[CauseIdentity]) -> Vec<&str> {
        of.iter().map(|cause| cause.cause.as_str()).collect()
    }

    #[test]
    fn a_common_cause_is_fitted_everywhere_and_one_that_is_claimed_once_alone() {
        let heat = [("heat", false)];
        let records = [
            record("a", &heat),
            record("b", &heat),
            record("c", &[("heat", true), ("play", true)]),
            record("d", &[]),
        ];
        let requested = select_causes_to_fit(&records);
        let of = |n: usize| requested[n].clone().unwrap_or_default();
        assert_eq!((names(&of(0).together), names(&of(0).alone)), (vec!["heat"], vec!["play"]));
        assert_eq!((names(&of(3).together), names(&of(3).alone)), (vec!["heat"], vec!["play"]));
        assert_eq!(requested[2], None, "it has all of them");
    }

    #[test]
    fn another_name_for_a_common_cause_gives_way_to_it() {
        let heat = [("heat", true)];
        let mut records = vec![record("a", &heat), record("b", &heat), record("c", &heat)];
        records.push(record("d", &[("slow", false)]));
        let requested = select_causes_to_fit(&records)[3].clone().unwrap_or_default();
        assert_eq!(names(&requested.together), ["heat"]);
        let mut own = records.remove(3);
        let heat = records[0].found[0].clone();
        own.replace_constants(FittedConstants { together: vec![Some(heat)], alone: Vec::new() });
        assert!(own.found[0].constants.is_empty() && own.fitted[0].name == "dz heat");
    }
}
