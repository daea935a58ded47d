//! The effects of a machine file or a run, and what in it is unlikely to be meant.
//!
//! The impossible is refused by the code that reads it. The unlikely (a temperature in
//! kelvin, a table beyond the travel) is a [`Warning`] with its line: the correction would run, and
//! cut with it. A rule is one small function; where it has a number, that stands with its source in
//! `docs/thresholds.md`. A rule that would fire on a right file is a fault: the shipped files and
//! every measured set that the project knows are silent.
//!
//! | module | checks |
//! |---|---|
//! | `sensor` | can the sensor read that, and in these units |
//! | `plausibility` | can a machine have that value, and which slip makes it; the table of all ranges |
//! | `thermal` | is that a temperature in °C, and does a constant do anything |
//! | `limits` | is the slew limit slow enough for the axes, does a limit leave room for what it limits |
//! | `geometry` | do the tool, the tables and the curves lie where the machine is |
//! | `thermometer_rate` | can a thermometer change faster than the board believes |
//! | `double_correction` | is one thing corrected by two entries |
//! | `no_correction` | does the file correct anything at all |
//! | `conditions` | columns of few values that a CNC could send to the board: what to declare so that it does |
//! | `error_bounds` | how large each correction may become |
//! | `run` | is what a run has what the machine file has: counts, travel, the size and the sign of an error |
//! | `clock` | does the clock of a run step by an hour, was it set, or has it a pause |
//! | `units` | are the columns of a run in the units of their names |
//! | `summary` | what the file will do |

mod clock;
mod conditions;
mod double_correction;
pub(crate) mod error_bounds;
mod geometry;
mod limits;
mod no_correction;
mod plausibility;
mod run;
mod sensor;
mod summary;
mod thermal;
mod thermometer_rate;
mod units;
mod warning;

use crate::{machine_file::Machine, run_file::RunFile};

pub use conditions::suggest_condition_columns;
pub use no_correction::no_correction_warning;
pub use plausibility::{ImplausibleValue, Plausibility, combine_rejected_findings};
pub use summary::{AxisSummary, MachineSummary};
pub use warning::Warning;

/// Returns the values of the machine file that are outside the ranges of machines, in the order of its lines.
#[must_use]
pub fn list_implausible_values(machine: &Machine) -> Vec<ImplausibleValue> {
    let mut findings = plausibility::find_implausible_values(machine);
    findings.sort_by_key(|finding| (finding.warning.place.line, finding.warning.place.column));
    findings
}

/// Everything in the machine file that is unlikely to be meant, in the order of its lines; what is
/// impossible as well.
#[must_use]
pub fn machine_warnings(machine: &Machine) -> Vec<Warning> {
    let rules: [fn(&Machine) -> Vec<Warning>; 6] = [
        sensor::warnings,
        thermal::warnings,
        limits::warnings,
        geometry::warnings,
        double_correction::warnings,
        thermometer_rate::warnings,
    ];
    let mut warnings: Vec<Warning> = rules.iter().flat_map(|rule| rule(machine)).collect();
    // A rule knows more of its key than the table does.
    let of_table =
        plausibility::find_implausible_values(machine).into_iter().map(|finding| finding.warning);
    let is_new = |warnings: &[Warning], warning: &Warning| {
        warnings.iter().all(|other| other.place != warning.place)
    };
    let new: Vec<Warning> = of_table.filter(|warning| is_new(&warnings, warning)).collect();
    warnings.extend(new);
    sort_warnings_by_location(warnings.into_iter())
}

/// Everything in the run that is unlikely to be meant, in the order of its places; held against the
/// machine's model where there is one.
#[must_use]
pub fn run_warnings(run: &RunFile, machine: Option<&Machine>) -> Vec<Warning> {
    let of_names = run.column_typos().map(|typo| Warning {
        place: typo.place,
        what: typo.rule,
        help: typo.help.unwrap_or_default(),
    });
    sort_warnings_by_location(of_names.chain(value_warnings(run, machine, &[])))
}

/// Returns the same without what the names of the columns say, for a command that says that itself.
#[must_use]
pub fn value_warnings(
    run: &RunFile,
    machine: Option<&Machine>,
    others: &[RunFile],
) -> Vec<Warning> {
    let mut warnings: Vec<Warning> = find_implausible_columns(run, machine, others)
        .into_iter()
        .map(|finding| finding.warning)
        .collect();
    warnings.extend(run::warnings(run, machine));
    warnings.extend(clock::check_clock(run).warnings);
    warnings
}

/// Returns the columns of the run that are unlikely or impossible in the units of their names, or compared with the
/// machine file, and a clock that was set: a constant that is found from them is wrong. `others` are the runs that the same
/// command reads; `run` may be among them.
#[must_use]
pub fn find_implausible_columns(
    run: &RunFile,
    machine: Option<&Machine>,
    others: &[RunFile],
) -> Vec<ImplausibleValue> {
    let mut slips = units::findings(run, machine, others);
    // Where both know something, the machine file says in which unit it would be right.
    for finding in run::find_implausible_columns(run, machine) {
        match slips.iter_mut().find(|slip| slip.key == finding.key) {
            Some(other) => other.warning = finding.warning,
            None => slips.push(finding),
        }
    }
    slips.extend(clock::check_clock(run).slips);
    slips
}

/// Returns what is worth a remark in the run and needs nothing done: pauses.
#[must_use]
pub fn run_remarks(run: &RunFile) -> Vec<Warning> {
    clock::check_clock(run).remarks
}

fn sort_warnings_by_location(warnings: impl Iterator<Item = Warning>) -> Vec<Warning> {
    let mut warnings: Vec<Warning> = warnings.collect();
    warnings.sort_by_key(|warning| (warning.place.line, warning.place.column));
    warnings
}

#[cfg(test)]
mod tests;
