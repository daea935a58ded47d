//! Joins the results of all machines.
//!
//! ```text
//! results ─► constants by machine ─► over its days (drift) ─► compared with the others (odd)
//!                                                           ─► pooled over those that are not ─► next measurement
//! ```

use std::collections::{BTreeMap, BTreeSet};

use trueup_compare::dated_constants::{EpochDay, format_day};

use crate::{
    cause_summary,
    drift::{Drift, current_estimate, estimate_drift},
    findings::is_log_scaled,
    next_measurement,
    outliers::{self, compare_machines, holm_adjust},
    random_effects::{Estimate, NORMAL_QUANTILE_975, pool_estimates},
    record::{MachineRecord, PooledConstant, UncertainConstant},
    report::{
        DriftingConstant, IntervalEstimate, Machine, MachineComparison, MemberConstant,
        SeriesConstant, SeriesReport,
    },
};

/// A constant: what the machine file believes, the finding, and the parameter.
type ConstantKey<'r> = (&'r str, &'r str, &'r str);

/// A constant by one record.
#[derive(Clone, Copy, Debug)]
struct RecordEstimate {
    day: Option<EpochDay>,
    estimate: Estimate,
    claimed: bool,
    is_fitted: bool,
    explains_um: f64,
}

/// A constant on one machine, over its records.
struct MachineConstant<'r> {
    machine: &'r str,
    current_estimate: Estimate,
    drift: Option<(usize, Drift)>,
    last: RecordEstimate,
    claimed: bool,
    is_fitted: bool,
}

/// Returns what the records say together; `notes`: what is known of them already.
#[must_use]
pub fn evaluate_series(records: &[MachineRecord], notes: Vec<String>) -> SeriesReport {
    let constants = group_estimates_by_constant(records);
    let beliefs: BTreeSet<&str> = records.iter().map(|record| record.belief.as_str()).collect();
    let mut compared_on: BTreeMap<&str, usize> = BTreeMap::new();
    let mut known_on: BTreeMap<&str, usize> = BTreeMap::new();
    for machines in constants.values() {
        for machine in machines.keys() {
            *known_on.entry(machine).or_default() += 1;
            *compared_on.entry(machine).or_default() +=
                usize::from(machines.len() >= crate::random_effects::MIN_POOLED_MACHINES);
        }
    }
    let mut all = Vec::new();
    let mut drifts = Vec::new();
    let mut pooled = Vec::new();
    for ((belief, finding, parameter), machines) in &constants {
        let number = beliefs.iter().position(|candidate| candidate == belief).unwrap_or(0) + 1;
        let group =
            if beliefs.len() > 1 { format!(" (machine files {number})") } else { String::new() };
        let name = format!("{finding} {parameter}{group}");
        let members = machines.iter();
        let members: Vec<MachineConstant<'_>> = members
            .filter_map(|(machine, readings)| {
                evaluate_machine_constant(machine, readings, known_on[*machine])
            })
            .collect();
        drifts.extend(members.iter().filter_map(|member| {
            let (days, drift) = member.drift?;
            Some(DriftingConstant {
                machine: member.machine.into(),
                constant: name.clone(),
                days,
                drift,
            })
        }));
        let most = members.iter().filter_map(|member| compared_on.get(member.machine)).max();
        let (constant, open) =
            evaluate_constant(&name, parameter, &members, most.copied().unwrap_or(1));
        all.push(constant);
        pooled.push(PooledConstant { name, parameter, open });
    }
    correct_for_multiple_testing(&mut all);
    let mut series = SeriesReport {
        schema: 1,
        machines: summarise_machines(records, &all, &drifts),
        constants: all,
        causes: cause_summary::summarise_causes(records),
        drifts,
        next: next_measurement::suggest_measurements(&pooled, records),
        notes,
    };
    if beliefs.len() > 1 {
        series.notes.push(format!(
            "The machine files believe {} different things of what was measured. Constants are deviations from a \
             machine file: those of different files are not put together.",
            beliefs.len()
        ));
    }
    let undated = records.iter().filter(|record| record.day.is_none()).count();
    if undated > 0 {
        series.notes.push(format!(
            "{undated} of {} records have no date and do not show drift. Give --date, or a date like 2026-11-22 \
             in the name of the run file.",
            records.len()
        ));
    }
    series
}

/// Returns each constant with its readings on each machine. A fit for the series counts where the machine's own diagnoses
/// did not find the cause.
fn group_estimates_by_constant(
    records: &[MachineRecord],
) -> BTreeMap<ConstantKey<'_>, BTreeMap<&str, Vec<RecordEstimate>>> {
    let mut all: BTreeMap<ConstantKey<'_>, BTreeMap<&str, Vec<RecordEstimate>>> = BTreeMap::new();
    for record in records {
        let own = record.found.iter().map(|finding| (finding, false));
        let fitted = record.fitted.iter().map(|finding| (finding, true));
        for (found, is_fitted) in own.chain(fitted) {
            for constant in &found.constants {
                let key =
                    (record.belief.as_str(), found.name.as_str(), constant.parameter.as_str());
                let reading = RecordEstimate {
                    day: record.day,
                    estimate: constant.estimate,
                    claimed: found.claimed,
                    is_fitted,
                    explains_um: found.explains_um,
                };
                all.entry(key).or_default().entry(&record.machine).or_default().push(reading);
            }
        }
    }
    all
}

fn evaluate_machine_constant<'r>(
    machine: &'r str,
    readings: &[RecordEstimate],
    constants: usize,
) -> Option<MachineConstant<'r>> {
    let dated: Vec<(EpochDay, Estimate)> =
        readings.iter().filter_map(|reading| Some((reading.day?, reading.estimate))).collect();
    let days: BTreeSet<EpochDay> = dated.iter().map(|(day, _)| *day).collect();
    let drift = estimate_drift(&dated, constants);
    let all: Vec<(Option<EpochDay>, Estimate)> =
        readings.iter().map(|reading| (reading.day, reading.estimate)).collect();
    Some(MachineConstant {
        machine,
        current_estimate: current_estimate(&all, drift)?,
        drift: drift.map(|drift| (days.len(), drift)),
        last: *readings.iter().max_by_key(|reading| reading.day)?,
        claimed: readings.iter().any(|reading| reading.claimed),
        is_fitted: readings.iter().all(|reading| reading.is_fitted),
    })
}

/// Returns a constant over its machines, and what is open about it on each.
fn evaluate_constant<'r>(
    name: &str,
    parameter: &str,
    members: &[MachineConstant<'r>],
    constants: usize,
) -> (SeriesConstant, Vec<UncertainConstant<'r>>) {
    let values: Vec<Estimate> = members.iter().map(|member| member.current_estimate).collect();
    let compared = compare_machines(&values, constants);
    let is_odd = |index: usize| compared.as_ref().is_some_and(|all| all[index].is_odd);
    let healthy: Vec<usize> = (0..values.len()).filter(|index| !is_odd(*index)).collect();
    let of_healthy: Vec<Estimate> = healthy.iter().map(|index| values[*index]).collect();
    let together = pool_estimates(&of_healthy)
        .or_else(|| pool_estimates(&values))
        .expect("a constant has a machine");
    let by_ratios = is_log_scaled(parameter);
    let interval = |estimate: Estimate| {
        let [value, low, high] = [estimate.value, estimate.ci95()[0], estimate.ci95()[1]]
            .map(|value| if by_ratios { value.exp() } else { value });
        IntervalEstimate { value, ci95: [low, high] }
    };
    let mut list = Vec::new();
    let mut open = Vec::new();
    for (index, it) in members.iter().enumerate() {
        let place = healthy.iter().position(|there| *there == index);
        let (shrunk, weight) = match place {
            Some(place) if place < together.shrunk.len() => {
                (together.shrunk[place], together.weight[place])
            }
            _ => (it.current_estimate, 0.0),
        };
        open.push(UncertainConstant {
            machine: it.machine,
            now: shrunk,
            record_se: it.last.estimate.se,
            explains_um: it.last.explains_um,
        });
        list.push(MemberConstant {
            machine: it.machine.into(),
            claimed: it.claimed,
            fitted_for_series: it.is_fitted,
            own: interval(it.current_estimate),
            shrunk: interval(shrunk),
            weight,
            compared: compared.as_ref().map(|all| {
                let outliers::PredictiveTestResult { predicted, t, p, is_odd } = all[index];
                let predicted = if by_ratios { predicted.exp() } else { predicted };
                MachineComparison { predicted, t, p, p_series: p, odd: is_odd }
            }),
        });
    }
    let spread = together.spread;
    let ratio = |value: f64| if by_ratios { value.exp() } else { value };
    let ends = [
        (spread.value - NORMAL_QUANTILE_975 * spread.se).max(0.0),
        spread.value + NORMAL_QUANTILE_975 * spread.se,
    ];
    let constant = SeriesConstant {
        name: name.into(),
        parameter: parameter.into(),
        by_ratios,
        machines: members.len(),
        mean: interval(together.mean),
        spread: IntervalEstimate { value: ratio(spread.value), ci95: ends.map(ratio) },
        values: list,
    };
    (constant, open)
}

/// Corrects the probabilities for the number of machines and constants.
fn correct_for_multiple_testing(constants: &mut [SeriesConstant]) {
    let mut all: Vec<&mut MachineComparison> = constants
        .iter_mut()
        .flat_map(|constant| constant.values.iter_mut().filter_map(|value| value.compared.as_mut()))
        .collect();
    let p: Vec<f64> = all.iter().map(|comparison| comparison.p).collect();
    all.iter_mut().zip(holm_adjust(&p)).for_each(|(comparison, p)| comparison.p_series = p);
}

fn summarise_machines(
    records: &[MachineRecord],
    constants: &[SeriesConstant],
    drifts: &[DriftingConstant],
) -> Vec<Machine> {
    let names: BTreeSet<&str> = records.iter().map(|record| record.machine.as_str()).collect();
    let of = |name: &str| {
        let own: Vec<&MachineRecord> =
            records.iter().filter(|record| record.machine == name).collect();
        let newest = own.iter().max_by_key(|estimate| estimate.day);
        let is_odd = |constant: &&SeriesConstant| {
            let mut members = constant.values.iter().filter(|value| value.machine == name);
            members.any(|member| member.compared.is_some_and(|comparison| comparison.odd))
        };
        let changes = drifts.iter().filter(|drift| drift.machine == name && drift.drift.is_certain);
        Machine {
            machine: name.into(),
            results: own.len(),
            newest: newest.and_then(|newest| newest.day).map(format_day),
            verdict: newest.map(|newest| newest.verdict.clone()).unwrap_or_default(),
            odd: constants.iter().filter(is_odd).map(|constant| constant.name.clone()).collect(),
            drifting: changes.map(|change| change.constant.clone()).collect(),
        }
    };
    names.into_iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::findings;

    /// A record with one finding, a value with an error of 0.1.
    fn record(machine: &str, value: f64, claimed: bool) -> MachineRecord {
        let ends = [value - 0.196, value + 0.196];
        let diagnosis = json!({"quantity": "dz", "findings": [{
            "cause": "heat", "column": "temp_bed_c", "claimed": claimed,
            "parameters": {"um_per_c": {"value": value, "ci95": ends}},
            "gain": {"rms_before_um": 5.0, "rms_after_um": 3.0},
        }]});
        MachineRecord {
            machine: machine.into(),
            day: None,
            verdict: "explained".into(),
            quantity: "dz".into(),
            belief: "b".into(),
            found: findings::parse_findings(&diagnosis),
            fitted: Vec::new(),
        }
    }

    #[test]
    fn a_cause_claimed_once_is_confirmed_by_the_others_and_only_on_its_side() {
        let confirmed = |others: [f64; 3]| {
            let mut records = vec![record("a", 2.0, true)];
            records.extend(
                others.iter().zip(["b", "c", "d"]).map(|(v, name)| record(name, *v, false)),
            );
            evaluate_series(&records, Vec::new()).causes[0].confirmed
        };
        assert!(confirmed([1.9, 2.1, 2.0]));
        assert!(!confirmed([0.05, -0.1, 0.02]));
        assert!(!confirmed([-1.9, -2.1, -2.0]));
    }

    #[test]
    fn machines_whose_files_differ_are_not_put_together() {
        let mut records: Vec<MachineRecord> =
            (0..6).map(|n| record(&format!("m{n}"), 2.0, true)).collect();
        records[..3].iter_mut().for_each(|record| record.belief = "other".into());
        let series = evaluate_series(&records, Vec::new());
        assert_eq!(
            series.constants.iter().map(|constant| constant.machines).collect::<Vec<_>>(),
            [3, 3]
        );
        assert!(series.notes[0].contains("2 different things"), "{:?}", series.notes);
    }

    #[test]
    fn the_most_uncertain_machine_is_measured_next() {
        let mut records: Vec<MachineRecord> =
            (0..6).map(|n| record(&format!("m{n}"), 2.0 + 0.3 * f64::from(n), true)).collect();
        records[3].found[0].constants[0].estimate.se = 0.5;
        let series = evaluate_series(&records, Vec::new());
        assert_eq!(series.next[0].machine, "m3");
        assert!(series.next[0].after_um < series.next[0].doubt_um);
        assert_eq!(series.next[0].program, "axis-heat");
    }
}
