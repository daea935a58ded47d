//! A result of one machine as the series takes it, and what is open about a constant of it.

use trueup_compare::dated_constants::EpochDay;

use crate::{findings::NamedFinding, random_effects::Estimate};

/// A result of one machine.
#[derive(Clone, Debug)]
pub struct MachineRecord {
    /// The machine.
    pub machine: String,
    /// The day of the record.
    pub day: Option<EpochDay>,
    /// The verdict.
    pub verdict: String,
    /// Quantity that was compared.
    pub quantity: String,
    /// What the machine file believes of what was measured: a constant is a deviation from that, and comparable only
    /// where it is the same.
    pub belief: String,
    /// The findings of the diagnosis.
    pub found: Vec<NamedFinding>,
    /// Causes of other machines, fitted to this record.
    pub fitted: Vec<NamedFinding>,
}

/// A constant on all machines, with what the next measurement would change.
pub(crate) struct PooledConstant<'r> {
    pub name: String,
    pub parameter: &'r str,
    pub open: Vec<UncertainConstant<'r>>,
}

/// Open question about a constant of one machine.
pub(crate) struct UncertainConstant<'r> {
    pub machine: &'r str,
    /// The value with the help of the others, and its error.
    pub now: Estimate,
    /// The error of one record.
    pub record_se: f64,
    /// RMS in µm that its cause explains.
    pub explains_um: f64,
}
