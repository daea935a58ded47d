//! Which machine to measure next: where one more record takes most off the error that is in doubt.
//!
//! An amplitude that explains g µm RMS and is known to a share e of itself leaves e·g µm in doubt. A record like the
//! last one, of error s, brings the variance of the value from v to v·s²/(v + s²). The doubt that this takes off, as a
//! square, decides.

use trueup_page::format_micrometres;

use crate::{
    findings::is_log_scaled,
    random_effects::Estimate,
    record::{MachineRecord, PooledConstant, UncertainConstant},
    report::NextMeasurement,
};

/// Maximum number of machines in the list.
const MAX_LISTED_MACHINES: usize = 5;

/// Returns the measurements that would say most, the best first, one a machine.
pub(crate) fn suggest_measurements(
    constants: &[PooledConstant<'_>],
    records: &[MachineRecord],
) -> Vec<NextMeasurement> {
    let mut all: Vec<(f64, NextMeasurement)> = Vec::new();
    for constant in constants {
        for &UncertainConstant { machine, now: Estimate { value, se }, record_se, explains_um } in
            &constant.open
        {
            let share = if is_log_scaled(constant.parameter) { 1.0 } else { 1.0 / value.abs() };
            // The error is never larger than all of the term.
            let doubt_um = explains_um * (se * share).min(1.0);
            let after_um = doubt_um * (record_se / se.hypot(record_se));
            let gain = doubt_um.powi(2) - after_um.powi(2);
            if !(gain.is_finite() && gain > 0.0) {
                continue;
            }
            let quantity = constant.name.split(' ').next().unwrap_or_default();
            let program = measurement_program(quantity, constant.parameter);
            let sentence = format!(
                "{machine}: {} of {} is uncertain; one more record (trueup program {program}) leaves {}.",
                format_micrometres(doubt_um),
                constant.name,
                format_micrometres(after_um)
            );
            let next = NextMeasurement {
                machine: machine.into(),
                constant: constant.name.clone(),
                program: program.into(),
                doubt_um,
                after_um,
                sentence,
            };
            all.push((gain, next));
        }
    }
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut listed: Vec<NextMeasurement> = Vec::new();
    for (_, next) in all {
        if listed.len() < MAX_LISTED_MACHINES
            && listed.iter().all(|measurement| measurement.machine != next.machine)
        {
            listed.push(next);
        }
    }
    if listed.is_empty() {
        listed.extend(suggest_least_recently_measured_machine(records));
    }
    listed
}

/// Where no constant is in doubt, the machine whose newest record is the oldest.
fn suggest_least_recently_measured_machine(records: &[MachineRecord]) -> Option<NextMeasurement> {
    let newest_of = |machine: &str| {
        records
            .iter()
            .filter(|record| record.machine == machine)
            .filter_map(|record| record.day)
            .max()
    };
    let record = records.iter().min_by_key(|record| newest_of(&record.machine))?;
    Some(NextMeasurement {
        machine: record.machine.clone(),
        constant: String::new(),
        program: "diagonal".into(),
        doubt_um: 0.0,
        after_um: 0.0,
        sentence: format!(
            "{}: no constant is uncertain, and no machine was measured longer ago (trueup program diagonal).",
            record.machine
        ),
    })
}

/// Returns the motion program that measures a constant.
fn measurement_program(quantity: &str, parameter: &str) -> &'static str {
    let is_of_heat = parameter.contains("per_c")
        || parameter.contains("time_constant")
        || parameter.contains("rpm")
        || matches!(parameter, "scale" | "shift_c");
    match quantity {
        "elongation" => "warmup",
        _ if is_of_heat => "axis-heat",
        _ if parameter.contains("width") => "backlash",
        _ if parameter.contains("urad") || parameter.contains("spline") => "straightness",
        _ => "pitch",
    }
}
