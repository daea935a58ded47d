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
    constants::{Found, Identity},
    record::Record,
};

/// The share of machines on which a common cause is found.
const COMMON_SHARE: f64 = 0.25;
/// The fewest machines on which it is.
const MIN_COMMON: usize = 3;

/// The terms to be fitted to a record.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Asked {
    /// The causes of the model.
    pub together: Vec<Identity>,
    /// Causes that are fitted alone next to it.
    pub alone: Vec<Identity>,
}

/// The constants of each cause that was asked, in its order; none where the record does not allow it.
#[derive(Clone, Debug, Default)]
pub struct Answered {
    /// Of the causes of the model.
    pub together: Vec<Option<Found>>,
    /// Of those next to it.
    pub alone: Vec<Option<Found>>,
}

/// Returns what is to be fitted to each record; none where its own diagnosis has all that the series has.
#[must_use]
pub fn asked(records: &[Record]) -> Vec<Option<Asked>> {
    records.iter().map(|record| of_record(record, records)).collect()
}

fn of_record(record: &Record, records: &[Record]) -> Option<Asked> {
    let alike = || records.iter().filter(|it| it.quantity == record.quantity);
    let machines: BTreeSet<&str> = alike().map(|it| it.machine.as_str()).collect();
    let mut found_on: BTreeMap<&Identity, BTreeSet<&str>> = BTreeMap::new();
    let mut claimed: BTreeSet<&Identity> = BTreeSet::new();
    for other in alike() {
        for found in other.found.iter().filter(|it| !it.constants.is_empty()) {
            let Some(identity) = &found.identity else { continue };
            found_on.entry(identity).or_default().insert(&other.machine);
            if found.claimed && other.machine != record.machine {
                claimed.insert(identity);
            }
        }
    }
    let count = |identity: &Identity| found_on.get(identity).map_or(0, BTreeSet::len);
    let least = ((COMMON_SHARE * machines.len() as f64).ceil() as usize).max(MIN_COMMON);
    let is_common = |identity: &Identity| count(identity) >= least;
    // Another name for what more machines call otherwise.
    let is_replaced = |own: &Found| {
        let common = found_on.keys().filter(|it| is_common(it));
        let mut names = common.filter(|it| own.alternatives.contains(&it.name(&record.quantity)));
        !own.claimed
            && own.identity.as_ref().is_some_and(|own| names.any(|it| count(it) > count(own)))
    };
    let own = record.found.iter().filter(|it| !is_replaced(it));
    let mut together: Vec<Identity> = own.filter_map(|it| it.identity.clone()).collect();
    let before = together.len();
    let missing = found_on.keys().filter(|it| is_common(it) && !together.contains(**it));
    let missing: Vec<Identity> = missing.map(|it| (*it).clone()).collect();
    together.extend(missing);
    let is_whole = together.len() == before && before == record.found.len();
    let alone = claimed.into_iter().filter(|it| !together.contains(*it));
    let alone: Vec<Identity> = alone.cloned().collect();
    (!is_whole || !alone.is_empty()).then_some(Asked { together, alone })
}

impl Record {
    /// Takes the constants of the model of the series in the place of its own.
    pub fn take(&mut self, answered: Answered) {
        let fitted: Vec<Found> = answered.together.into_iter().flatten().collect();
        for own in &mut self.found {
            // What another cause stands for, and what is more than a name, says nothing to the series.
            own.constants = match fitted.iter().find(|it| it.name == own.name) {
                Some(fit) => fit.constants.clone(),
                None => Vec::new(),
            };
        }
        let is_new = |it: &Found| self.found.iter().all(|own| own.name != it.name);
        let new: Vec<Found> = fitted.into_iter().filter(is_new).collect();
        self.fitted = new;
        self.fitted.extend(answered.alone.into_iter().flatten());
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use crate::constants;

    fn record(machine: &str, causes: &[(&str, bool)]) -> Record {
        let finding = |(cause, claimed): &(&str, bool)| -> Value {
            json!({
                "cause": cause, "claimed": claimed,
                "parameters": {"um_per_c": {"value": 1.0, "ci95": [0.8, 1.2]}},
                "rivals": [{"cause": "heat", "score_gap": if *cause == "slow" { 1.0 } else { 9.0 }}],
            })
        };
        let findings: Vec<Value> = causes.iter().map(finding).collect();
        Record {
            machine: machine.into(),
            day: None,
            verdict: "explained".into(),
            quantity: "dz".into(),
            belief: String::new(),
            found: constants::found(&json!({"quantity": "dz", "findings": findings})),
            fitted: Vec::new(),
        }
    }

    fn names(of: &[Identity]) -> Vec<&str> {
        of.iter().map(|it| it.cause.as_str()).collect()
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
        let asked = asked(&records);
        let of = |n: usize| asked[n].clone().unwrap_or_default();
        assert_eq!((names(&of(0).together), names(&of(0).alone)), (vec!["heat"], vec!["play"]));
        assert_eq!((names(&of(3).together), names(&of(3).alone)), (vec!["heat"], vec!["play"]));
        assert_eq!(asked[2], None, "it has all of them");
    }

    #[test]
    fn another_name_for_a_common_cause_gives_way_to_it() {
        let heat = [("heat", true)];
        let mut records = vec![record("a", &heat), record("b", &heat), record("c", &heat)];
        records.push(record("d", &[("slow", false)]));
        let asked = asked(&records)[3].clone().unwrap_or_default();
        assert_eq!(names(&asked.together), ["heat"]);
        let mut own = records.remove(3);
        let heat = records[0].found[0].clone();
        own.take(Answered { together: vec![Some(heat)], alone: Vec::new() });
        assert!(own.found[0].constants.is_empty() && own.fitted[0].name == "dz heat");
    }
}
