//! Causes of other machines of the same kind, fitted to the runs of this one: what a series asks of a machine whose own
//! diagnosis did not find them.
//!
//! Nothing is searched and nothing is claimed. The causes of the model are fitted together; each further one is added
//! alone, fitted with all others. All come back with their intervals, which may include nothing.

use std::sync::Arc;

use serde_json::{Map, Value};
use trueup_machine::{BadInput, Machine, RunFile, effect::Effect};

use crate::{
    Options,
    answer::applied::Bridge,
    data::{Data, Groups, quantity_of},
    fit::{Fitted, Problem, fit},
    kind::{Kind, Part},
    model::Model,
    outliers,
    parameters::estimates,
    search::{
        criterion::noise_of,
        extend::{Extension, with_each_cause, without},
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

/// The fits of causes to the runs of a machine.
#[derive(Clone, Debug)]
pub struct NamedFits {
    /// The causes of the model, all fitted together.
    pub together: Vec<Option<NamedFit>>,
    /// Each further cause, alone next to that model.
    pub alone: Vec<Option<NamedFit>>,
}

/// Fits the causes `together` to `runs` as one model, and each of the causes `alone` next to it; none for a cause that
/// these data do not allow.
///
/// # Errors
/// As those of [`crate::diagnose`].
pub fn fit_named(
    machine: &Machine,
    runs: &[RunFile],
    options: Options,
    together: &[Named<'_>],
    alone: &[Named<'_>],
) -> Result<NamedFits, BadInput> {
    let quantity = quantity_of(runs, options.quantity)?;
    let bridge = Bridge::of(machine, [runs, &[]], quantity, options.is_applied_once)?;
    let data = Arc::new(Data::applied(machine, runs, quantity, bridge.factor())?.trusted());
    let aside = outliers::among_repeats(&data, &Model::default().predict(&data));
    let (problem, base) = with_all(&data, &aside, together);
    let gross = outliers::gross(&data, &base.model.predict(&data));
    let aside: Vec<bool> = aside.iter().zip(gross).map(|(there, gross)| *there || gross).collect();
    let (problem, base) =
        if aside.contains(&true) { with_all(&data, &aside, together) } else { (problem, base) };
    Ok(NamedFits {
        together: together.iter().map(|named| of_model(&problem, &base, named)).collect(),
        alone: alone.iter().map(|named| next_to(&problem, &base, named)).collect(),
    })
}

/// Returns the model with all these causes, fitted without the rows `aside`.
fn with_all(data: &Arc<Data>, aside: &[bool], causes: &[Named<'_>]) -> (Problem, Fitted) {
    let used: Vec<bool> =
        data.used.iter().zip(aside).map(|(used, aside)| *used && !aside).collect();
    let rows = used.iter().filter(|used| **used).count();
    let size = if data.quantity.axis().is_some() { 1 } else { rows.div_ceil(MAX_GROUPS).max(1) };
    let problem = Problem::new(data.clone(), Groups::new(data, &used, size));
    let mut base = fit(&problem, &start(data), None);
    for named in causes {
        if let Some(extension) = extension(&problem, &base, named) {
            base = extension.fitted;
        }
    }
    (problem, base)
}

fn extension(problem: &Problem, base: &Fitted, named: &Named<'_>) -> Option<Extension> {
    Extension::best(with_each_cause(problem, base, MAX_HITS, |kind| named.is(kind)))
}

/// Returns what a cause of the model is worth in it.
fn of_model(problem: &Problem, base: &Fitted, named: &Named<'_>) -> Option<NamedFit> {
    let part = base.model.parts.iter().find(|part| named.is(&part.kind))?;
    let without = fit(problem, &without(problem, &base.model, &part.kind), None);
    Some(named_fit(problem, [&without, base], part))
}

fn next_to(problem: &Problem, base: &Fitted, named: &Named<'_>) -> Option<NamedFit> {
    let Extension { cause, fitted, .. } = extension(problem, base, named)?;
    let part = fitted.model.parts.iter().find(|part| part.kind == cause)?;
    Some(named_fit(problem, [base, &fitted], part))
}

fn named_fit(problem: &Problem, [before, after]: [&Fitted; 2], part: &Part) -> NamedFit {
    let noise = noise_of(problem, &after.residual, after.degrees);
    NamedFit {
        parameters: estimates(problem, after, part, noise).named,
        rms_before_um: before.rms(),
        rms_after_um: after.rms(),
    }
}
