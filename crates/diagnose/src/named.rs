//! Causes of other machines of the same kind, fitted to the runs of this one: what a series asks of a machine whose own
//! diagnosis did not find them.
//!
//! Nothing is searched and nothing is claimed. The model has the causes that the machine's own diagnosis has found; each
//! further one is added alone, fitted with all others, and comes back with its intervals, which may include nothing.

use std::sync::Arc;

use serde_json::{Map, Value};
use trueup_machine::{BadInput, Machine, RunFile, effect::Effect};

use crate::{
    Options,
    answer::applied::Bridge,
    data::{Data, Groups, quantity_of},
    fit::{Fitted, Problem, fit},
    kind::Kind,
    model::Model,
    outliers,
    parameters::estimates,
    search::{
        criterion::noise_of,
        extend::{Extension, with_each_cause},
        start,
    },
};

/// Rows that are fitted to; beyond, neighbours are averaged.
const MAX_GROUPS: usize = 1000;
/// Hits of a scan that are fitted for one cause.
const MAX_HITS: usize = 4;

/// A cause, as a finding names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Named<'n> {
    /// Its name.
    pub cause: &'n str,
    /// Its column.
    pub column: Option<&'n str>,
    /// Its form, of a dependence.
    pub form: Option<&'n str>,
}

/// A cause that was fitted.
#[derive(Clone, Debug)]
pub struct NamedFit {
    /// Its values with their intervals, as in a finding.
    pub parameters: Map<String, Value>,
    /// RMS in µm that is left without it.
    pub rms_before_um: f64,
    /// RMS in µm that is left with it.
    pub rms_after_um: f64,
}

impl Named<'_> {
    fn is(&self, kind: &Kind) -> bool {
        let form = match kind.cause() {
            Some(Effect::Dependence(page)) => Some(page.form_name()),
            Some(Effect::Within(_)) | None => return false,
            _ => None,
        };
        kind.name() == self.cause && kind.column().as_deref() == self.column && form == self.form
    }
}

/// Fits each of the causes `wanted` to `runs`, next to those that the machine's own diagnosis has `found`; none for a cause
/// that these data do not allow.
///
/// # Errors
/// As those of [`crate::diagnose`].
pub fn fit_named(
    machine: &Machine,
    runs: &[RunFile],
    options: Options,
    found: &[Named<'_>],
    wanted: &[Named<'_>],
) -> Result<Vec<Option<NamedFit>>, BadInput> {
    let quantity = quantity_of(runs, options.quantity)?;
    let bridge = Bridge::of(machine, [runs, &[]], quantity, options.is_applied_once)?;
    let data = Arc::new(Data::applied(machine, runs, quantity, bridge.factor())?.trusted());
    let aside = outliers::among_repeats(&data, &Model::default().predict(&data));
    let (problem, base) = with_found(&data, &aside, found);
    let gross = outliers::gross(&data, &base.model.predict(&data));
    let aside: Vec<bool> = aside.iter().zip(gross).map(|(there, gross)| *there || gross).collect();
    let (problem, base) =
        if aside.contains(&true) { with_found(&data, &aside, found) } else { (problem, base) };
    Ok(wanted.iter().map(|named| fitted(&problem, &base, named)).collect())
}

/// Returns the model with the causes that were found, fitted without the rows `aside`.
fn with_found(data: &Arc<Data>, aside: &[bool], found: &[Named<'_>]) -> (Problem, Fitted) {
    let used: Vec<bool> =
        data.used.iter().zip(aside).map(|(used, aside)| *used && !aside).collect();
    let rows = used.iter().filter(|used| **used).count();
    let size = if data.quantity.axis().is_some() { 1 } else { rows.div_ceil(MAX_GROUPS).max(1) };
    let problem = Problem::new(data.clone(), Groups::new(data, &used, size));
    let mut base = fit(&problem, &start(data), None);
    for named in found {
        if let Some(extension) = extension(&problem, &base, named) {
            base = extension.fitted;
        }
    }
    (problem, base)
}

fn extension(problem: &Problem, base: &Fitted, named: &Named<'_>) -> Option<Extension> {
    Extension::best(with_each_cause(problem, base, MAX_HITS, |kind| named.is(kind)))
}

fn fitted(problem: &Problem, base: &Fitted, named: &Named<'_>) -> Option<NamedFit> {
    let Extension { cause, fitted, .. } = extension(problem, base, named)?;
    let part = fitted.model.parts.iter().find(|part| part.kind == cause)?;
    let noise = noise_of(problem, &fitted.residual, fitted.degrees);
    Some(NamedFit {
        parameters: estimates(problem, &fitted, part, noise).named,
        rms_before_um: base.rms(),
        rms_after_um: fitted.rms(),
    })
}
