//! `fleet.json`: what a series says, in the form that scripts read (`docs/reference.md`, Fleet).

use serde::Serialize;

use crate::drift::Drift;

/// A number with its interval of 95 %.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct IntervalEstimate {
    /// The value.
    pub value: f64,
    /// The interval.
    pub ci95: [f64; 2],
}

/// The whole answer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SeriesReport {
    /// The version of this form.
    pub schema: u32,
    /// The machines, by name.
    pub machines: Vec<Machine>,
    /// The constants that more than one machine has, and those of single machines.
    pub constants: Vec<SeriesConstant>,
    /// The causes.
    pub causes: Vec<Cause>,
    /// Constants that were measured on several days.
    pub drifts: Vec<DriftingConstant>,
    /// Which machine to measure next, the best first.
    pub next: Vec<NextMeasurement>,
    /// Notes to the results, a sentence each.
    pub notes: Vec<String>,
}

/// A machine of the series.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Machine {
    /// Its serial number, or what the user calls it.
    pub machine: String,
    /// How many results it has.
    pub results: usize,
    /// The day of its newest record.
    pub newest: Option<String>,
    /// The verdict of its newest result.
    pub verdict: String,
    /// Constants in which it is unlike the others.
    pub odd: Vec<String>,
    /// Constants that change with time.
    pub drifting: Vec<String>,
}

/// A constant over the series.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SeriesConstant {
    /// Quantity, cause, column and parameter.
    pub name: String,
    /// The parameter, with its unit.
    pub parameter: String,
    /// True if it is known by ratios: then `spread` is a ratio too.
    pub by_ratios: bool,
    /// How many machines have it.
    pub machines: usize,
    /// The mean over the machines that are not odd.
    pub mean: IntervalEstimate,
    /// The standard deviation between machines, with its standard error as interval.
    pub spread: IntervalEstimate,
    /// Each machine.
    pub values: Vec<MemberConstant>,
}

/// A constant of a machine.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MemberConstant {
    /// The machine.
    pub machine: String,
    /// True if its diagnosis claims the cause.
    pub claimed: bool,
    /// True if its diagnosis did not find the cause, and it was fitted because others have it.
    pub fitted_for_series: bool,
    /// The value from its own records.
    pub own: IntervalEstimate,
    /// The value with the others' help.
    pub shrunk: IntervalEstimate,
    /// The weight of the mean in it, 0…1.
    pub weight: f64,
    /// The others' prediction for it, and its distance from that in predictive standard deviations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compared: Option<MachineComparison>,
}

/// A machine compared with the others.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MachineComparison {
    /// The others' prediction.
    pub predicted: f64,
    /// The deviation in predictive standard deviations.
    pub t: f64,
    /// How often a healthy machine deviates as far.
    pub p: f64,
    /// How often a series of healthy machines has one that deviates as far in one of the constants (Holm).
    pub p_series: f64,
    /// True if the machine is called odd.
    pub odd: bool,
}

/// A cause over the series.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cause {
    /// Quantity, cause and column.
    pub name: String,
    /// Machines whose diagnosis claims it.
    pub claimed_on: Vec<String>,
    /// Machines whose diagnosis found it and did not claim it.
    pub found_on: Vec<String>,
    /// Machines whose diagnosis could not separate it from another cause.
    pub alternative_on: Vec<String>,
    /// True if it is claimed on a machine, and other machines have it too.
    pub confirmed: bool,
    /// True if no machine claims it, and at least four that found it exclude together that it does nothing.
    pub supported: bool,
    /// Its meaning.
    pub sentence: String,
}

/// A constant of a machine over time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DriftingConstant {
    /// The machine.
    pub machine: String,
    /// The constant.
    pub constant: String,
    /// How many days.
    pub days: usize,
    /// The change; of a constant by ratios the change of its logarithm.
    #[serde(flatten)]
    pub drift: Drift,
}

/// A measurement that would say most.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NextMeasurement {
    /// The machine.
    pub machine: String,
    /// The constant that it would say most of.
    pub constant: String,
    /// The kind of motion program, as `trueup program` takes it.
    pub program: String,
    /// The error that is in doubt now, RMS in µm.
    pub doubt_um: f64,
    /// The same after one more record like the last.
    pub after_um: f64,
    /// Its meaning.
    pub sentence: String,
}
