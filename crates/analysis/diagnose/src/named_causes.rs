//! Causes of other machines of the same kind, fitted to the runs of this one: what a series asks of a machine whose own
//! diagnosis did not find them.
//!
//! Nothing is searched and nothing is claimed. The causes of the model are fitted together; each further one is added
//! alone, fitted with all others. All come back with their intervals, which may include nothing.

use std::sync::Arc;

use serde_json::{Map, Value};
use trueup_machine::{InputFileError, Machine, RunFile, effect::Effect};

use crate::{
    DiagnosisOptions,
    data::{DataTable, RowGroups, resolve_quantity},
    diagnosis::applied_factor::BridgeOffsets,
    fit::{FitProblem, FittedModel, fit},
    model::Model,
    outliers,
    parameter_estimates::estimate_parameters,
    search::{
        extension::{ModelExtension, fit_single_cause_extensions, without_term},
        initial_model,
        model_comparison::estimate_noise,
    },
    term_kind::{ModelPart, TermKind},
};

/// Rows that are fitted to; beyond, neighbours are averaged.
const MAX_ROW_GROUPS: usize = 1000;
/// Hits of a scan that are fitted for one cause.
const MAX_SCAN_HITS: usize = 4;

/// A cause, as a finding names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NamedCause<'n> {
    /// Its name.
    pub cause: &'n str,
    /// Its column.
    pub column: Option<&'n str>,
    /// Its form, of a dependence.
    pub form: Option<&'n str>,
}

/// A cause that was fitted.
#[derive(Clone, Debug)]
pub struct NamedCauseFit {
    /// Its values with their intervals, as in a finding.
    pub parameters: Map<String, Value>,
    /// RMS in µm that is left without it.
    pub rms_before_um: f64,
    /// RMS in µm that is left with it.
    pub rms_after_um: f64,
}

impl NamedCause<'_> {
    fn matches(&self, kind: &TermKind) -> bool {
        let form = match kind.cause() {
            Some(Effect::Dependence(page)) => Some(page.form_name()),
            Some(Effect::RangeLimited(_)) | None => return false,
            _ => None,
        };
        kind.name() == self.cause && kind.column().as_deref() == self.column && form == self.form
    }
}

/// The fits of causes to the runs of a machine.
#[derive(Clone, Debug)]
pub struct NamedCauseFits {
    /// The causes of the model, all fitted together.
    pub together: Vec<Option<NamedCauseFit>>,
    /// Each further cause, alone next to that model.
    pub alone: Vec<Option<NamedCauseFit>>,
}

/// Fits the causes `together` to `runs` as one model, and each of the causes `alone` next to it; none for a cause that
/// these data do not allow.
///
/// # Errors
/// As those of [`crate::diagnose()`].
pub fn fit_named_causes(
    machine: &Machine,
    runs: &[RunFile],
    options: DiagnosisOptions,
    together: &[NamedCause<'_>],
    alone: &[NamedCause<'_>],
) -> Result<NamedCauseFits, InputFileError> {
    let quantity = resolve_quantity(runs, options.quantity)?;
    let bridge = BridgeOffsets::from_runs(machine, [runs, &[]], quantity, options.is_applied_once)?;
    let data = Arc::new(
        DataTable::with_offset_factor(machine, runs, quantity, bridge.offset_factor())?
            .without_untrusted_columns(),
    );
    let aside = outliers::find_repeat_outliers(&data, &Model::default().predict(&data));
    let (problem, base) = fit_joint_model(&data, &aside, together);
    let gross = outliers::find_gross_errors(&data, &base.model.predict(&data));
    let aside: Vec<bool> = aside.iter().zip(gross).map(|(there, gross)| *there || gross).collect();
    let (problem, base) = if aside.contains(&true) {
        fit_joint_model(&data, &aside, together)
    } else {
        (problem, base)
    };
    Ok(NamedCauseFits {
        together: together
            .iter()
            .map(|named| evaluate_model_cause(&problem, &base, named))
            .collect(),
        alone: alone.iter().map(|named| fit_additional_cause(&problem, &base, named)).collect(),
    })
}

/// Returns the model with all these causes, fitted without the rows `aside`.
fn fit_joint_model(
    data: &Arc<DataTable>,
    aside: &[bool],
    causes: &[NamedCause<'_>],
) -> (FitProblem, FittedModel) {
    let used: Vec<bool> =
        data.used.iter().zip(aside).map(|(used, aside)| *used && !aside).collect();
    let rows = used.iter().filter(|used| **used).count();
    let size = if data.setting.quantity.axis().is_some() {
        1
    } else {
        rows.div_ceil(MAX_ROW_GROUPS).max(1)
    };
    let problem = FitProblem::new(data.clone(), RowGroups::new(data, &used, size));
    let mut base = fit(&problem, &initial_model(data), None);
    for named in causes {
        if let Some(extension) = find_best_extension(&problem, &base, named) {
            base = extension.fitted;
        }
    }
    (problem, base)
}

fn find_best_extension(
    problem: &FitProblem,
    base: &FittedModel,
    named: &NamedCause<'_>,
) -> Option<ModelExtension> {
    ModelExtension::best_by_bic(fit_single_cause_extensions(problem, base, MAX_SCAN_HITS, |kind| {
        named.matches(kind)
    }))
}

/// Returns what a cause of the model is worth in it.
fn evaluate_model_cause(
    problem: &FitProblem,
    base: &FittedModel,
    named: &NamedCause<'_>,
) -> Option<NamedCauseFit> {
    let part = base.model.parts.iter().find(|part| named.matches(&part.kind))?;
    let without = fit(problem, &without_term(problem, &base.model, &part.kind), None);
    Some(build_named_cause_fit(problem, [&without, base], part))
}

fn fit_additional_cause(
    problem: &FitProblem,
    base: &FittedModel,
    named: &NamedCause<'_>,
) -> Option<NamedCauseFit> {
    let ModelExtension { cause, fitted, .. } = find_best_extension(problem, base, named)?;
    let part = fitted.model.parts.iter().find(|part| part.kind == cause)?;
    Some(build_named_cause_fit(problem, [base, &fitted], part))
}

fn build_named_cause_fit(
    problem: &FitProblem,
    [before, after]: [&FittedModel; 2],
    part: &ModelPart,
) -> NamedCauseFit {
    let noise = estimate_noise(problem, &after.residual, after.degrees);
    NamedCauseFit {
        parameters: estimate_parameters(problem, after, part, noise).named,
        rms_before_um: before.rms(),
        rms_after_um: after.rms(),
    }
}
