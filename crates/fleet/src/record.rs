//! A result of one machine as the series takes it, and what is open about a constant of it.

use std::collections::BTreeSet;

use trueup_compare::dated::Day;

use crate::{
    constants::{Found, Identity},
    pool::Estimate,
};

/// A result of one machine.
#[derive(Clone, Debug)]
pub struct Record {
    /// The machine.
    pub machine: String,
    /// The day of the record.
    pub day: Option<Day>,
    /// The verdict.
    pub verdict: String,
    /// What was compared.
    pub quantity: String,
    /// What the machine file believes of what was measured: a constant is a deviation from that, and comparable only
    /// where it is the same.
    pub belief: String,
    /// The findings of the diagnosis.
    pub found: Vec<Found>,
    /// Causes of other machines, fitted to this record.
    pub fitted: Vec<Found>,
}

/// A constant on all machines, with what the next measurement would change.
pub(crate) struct Pooled<'r> {
    pub name: String,
    pub parameter: &'r str,
    pub open: Vec<Open<'r>>,
}

/// What is open about a constant of one machine.
pub(crate) struct Open<'r> {
    pub machine: &'r str,
    /// The value with the help of the others, and its error.
    pub now: Estimate,
    /// The error of one record.
    pub record_se: f64,
    /// What its cause explains, RMS in µm.
    pub explains_um: f64,
}

/// Returns, for each record, the causes that another machine claims on the same quantity and its own diagnosis has not
/// found.
#[must_use]
pub fn missing(records: &[Record]) -> Vec<Vec<Identity>> {
    let of_record = |record: &Record| {
        let others = records
            .iter()
            .filter(|other| other.machine != record.machine && other.quantity == record.quantity);
        let claimed = others.flat_map(|other| &other.found).filter(|it| it.claimed);
        let is_own = |name: &str| record.found.iter().any(|own| own.name == name);
        let wanted = claimed.filter(|it| !it.constants.is_empty() && !is_own(&it.name));
        let wanted: BTreeSet<&Identity> = wanted.filter_map(|it| it.identity.as_ref()).collect();
        wanted.into_iter().cloned().collect()
    };
    records.iter().map(of_record).collect()
}
