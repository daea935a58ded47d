//! A cause over the series: claimed on one machine, and what the others say of it.
//!
//! A machine confirms a cause whose diagnosis claims it, or whose fit of it excludes the value at which it does nothing,
//! on the same side as the claim. Of fits that were made because another machine has the cause, each may exclude
//! nothing by chance: together they are pooled first.

use std::collections::{BTreeMap, BTreeSet};

use crate::{
    findings::{NamedFinding, neutral_value},
    random_effects::{Estimate, MIN_POOLED_MACHINES, pool_estimates},
    record::MachineRecord,
    report::Cause,
};

/// A cause by all machines.
#[derive(Default)]
struct CauseOccurrences<'r> {
    claimed: BTreeSet<&'r str>,
    found: BTreeSet<&'r str>,
    alternative: BTreeSet<&'r str>,
    sizes: Vec<EffectSize<'r>>,
}

/// A deviation from nothing: the machine, the parameter, its size, and whether it is of a claim.
type EffectSize<'r> = (&'r str, &'r str, Estimate, bool);

/// Returns the causes of all records.
pub(crate) fn summarise_causes(records: &[MachineRecord]) -> Vec<Cause> {
    let mut all: BTreeMap<&str, CauseOccurrences<'_>> = BTreeMap::new();
    for record in records {
        let machine = record.machine.as_str();
        for found in &record.found {
            let of = all.entry(&found.name).or_default();
            let list = if found.claimed { &mut of.claimed } else { &mut of.found };
            list.insert(machine);
            add_effect_sizes(of, machine, found);
            for other in &found.alternatives {
                all.entry(other).or_default().alternative.insert(machine);
            }
        }
        for found in &record.fitted {
            add_effect_sizes(all.entry(&found.name).or_default(), machine, found);
        }
    }
    all.into_iter().map(|(name, of)| summarise_cause(name, &of)).collect()
}

fn add_effect_sizes<'r>(of: &mut CauseOccurrences<'r>, machine: &'r str, found: &'r NamedFinding) {
    of.sizes.extend(found.constants.iter().filter_map(|constant| {
        let value = constant.estimate.value - neutral_value(&constant.parameter)?;
        let size = Estimate { value, se: constant.estimate.se };
        Some((machine, constant.parameter.as_str(), size, found.claimed))
    }));
}

/// Returns the side on which machines together exclude that a parameter does nothing: −1 or 1; none where they do not.
fn significant_sign(sizes: &[&EffectSize<'_>], parameter: &str) -> Option<f64> {
    let of_parameter = sizes.iter().filter(|size| size.1 == parameter);
    let estimates: Vec<Estimate> = of_parameter.map(|size| size.2).collect();
    let mean = pool_estimates(&estimates)?.mean;
    let [low, high] = mean.ci95();
    (low > 0.0 || high < 0.0).then(|| mean.value.signum())
}

/// Returns whether other machines than the one that claims it have a cause too.
fn is_confirmed(of: &CauseOccurrences<'_>) -> bool {
    let is_claim = |size: &&EffectSize<'_>| of.claimed.contains(size.0);
    let (claims, others): (Vec<&EffectSize<'_>>, Vec<&EffectSize<'_>>) =
        of.sizes.iter().partition(is_claim);
    let is_same = |claim: &&EffectSize<'_>| {
        claim.3 && significant_sign(&others, claim.1).is_some_and(|side| side * claim.2.value > 0.0)
    };
    of.claimed.len() > 1 || claims.iter().any(is_same)
}

/// Returns whether machines of which none claims a cause exclude together that it does nothing.
fn is_supported(of: &CauseOccurrences<'_>) -> bool {
    let all: Vec<&EffectSize<'_>> = of.sizes.iter().collect();
    of.claimed.is_empty()
        && of.found.len() >= MIN_POOLED_MACHINES
        && all.iter().any(|size| significant_sign(&all, size.1).is_some())
}

fn summarise_cause(name: &str, of: &CauseOccurrences<'_>) -> Cause {
    let list = |names: &BTreeSet<&str>| names.iter().map(ToString::to_string).collect::<Vec<_>>();
    let confirmed = is_confirmed(of);
    let measured: BTreeSet<&str> = of.sizes.iter().map(|size| size.0).collect();
    let others = measured.iter().filter(|name| !of.claimed.contains(*name)).count();
    let machines =
        |count: usize| format!("{count} {}", if count == 1 { "machine" } else { "machines" });
    let sentence = match (of.claimed.len(), confirmed) {
        (0, _) if of.found.is_empty() => {
            format!("{} cannot exclude it.", capitalise(&machines(of.alternative.len())))
        }
        (0, _) if is_supported(of) => format!(
            "Found on {}, and claimed on none; together they exclude that it does nothing.",
            machines(of.found.len())
        ),
        (0, _) => format!("Found on {}, and claimed on none.", machines(of.found.len())),
        (1, true) => format!("Claimed on 1 machine, and confirmed by {others} of the others."),
        (1, false) if others == 0 => {
            "Claimed on 1 machine; no other one has been measured for it.".into()
        }
        (1, false) => {
            format!(
                "Claimed on 1 machine, and not confirmed by {} that were measured for it.",
                machines(others)
            )
        }
        (claims, _) => format!("Claimed on {}.", machines(claims)),
    };
    Cause {
        name: name.into(),
        claimed_on: list(&of.claimed),
        found_on: list(&of.found),
        alternative_on: list(&of.alternative),
        confirmed,
        supported: is_supported(of),
        sentence,
    }
}

fn capitalise(text: &str) -> String {
    let mut characters = text.chars();
    characters
        .next()
        .map_or(String::new(), |first| first.to_uppercase().chain(characters).collect())
}
