//! A model with one cause more, fitted as a whole; and with another cause in a term's place.

use trueup_numerics::{
    block_resampling::rms, least_squares::normal_equations::solve, parallel::parallel_map,
};

use trueup_machine::effect::Effect;

use crate::{
    candidates::{CandidateTerm, all_candidates, single_input_candidates},
    fit::{FitProblem, FittedModel, fit},
    model::Model,
    search::{
        model_comparison::{MAJORITY_FRACTION, bic},
        range_bound::optimise_bound,
        scan::{NoiseSimulation, ScanHit, scan},
    },
    term_kind::{ModelPart, TermKind},
};

/// A model that was extended by a cause, fitted with everything else.
#[derive(Clone)]
pub(crate) struct ModelExtension {
    pub cause: TermKind,
    pub fitted: FittedModel,
    pub bic: f64,
}

impl ModelExtension {
    pub(crate) fn new(problem: &FitProblem, cause: TermKind, fitted: FittedModel) -> Self {
        let bic = bic(problem, &fitted);
        Self { cause, fitted, bic }
    }

    /// Returns the one of the best BIC; of equals the first.
    pub(crate) fn best_by_bic(all: impl IntoIterator<Item = Self>) -> Option<Self> {
        all.into_iter().min_by(|a, b| a.bic.total_cmp(&b.bic))
    }
}

/// A term's place: the model without the term, and with each other cause instead of it.
pub(crate) struct TermReplacements {
    pub without: FittedModel,
    pub instead: Vec<ModelExtension>,
}

/// `base` with each of the `candidates` that a scan puts first; whether noise would show as much is
/// not asked.
pub(crate) fn fit_extensions(
    problem: &FitProblem,
    base: &FittedModel,
    candidates: &[CandidateTerm],
    most: usize,
) -> Vec<ModelExtension> {
    // The names, the settings and the base are all that such a scan follows from.
    let what = format!("scan {candidates:?}");
    let scanned = problem
        .memoise(&what, &base.model, || scan(problem, base, candidates, NoiseSimulation::Skipped));
    fit_scan_hits(problem, base, &scanned.hits, most)
}

/// `base` with each of the causes that the data allow and that `admits` lets in, of those the ones that
/// a scan puts first.
pub(crate) fn fit_single_cause_extensions(
    problem: &FitProblem,
    base: &FittedModel,
    most: usize,
    admits: impl Fn(&TermKind) -> bool,
) -> Vec<ModelExtension> {
    let mut candidates = single_input_candidates(problem, &base.model, &base.residual);
    candidates.retain(|candidate| admits(&candidate.kind));
    fit_extensions(problem, base, &candidates, most)
}

/// `base` with each of the `most` best of `hits` by squares, and the better half as many by likelihood.
pub(crate) fn fit_scan_hits(
    problem: &FitProblem,
    base: &FittedModel,
    hits: &[ScanHit],
    most: usize,
) -> Vec<ModelExtension> {
    let mut order: Vec<&ScanHit> = hits.iter().collect();
    order.sort_by(|a, b| b.by_squares.total_cmp(&a.by_squares));
    let mut chosen: Vec<&ScanHit> = order.iter().take(most).copied().collect();
    order.sort_by(|a, b| b.by_likelihood.total_cmp(&a.by_likelihood));
    for hit in order.iter().take(most / 2) {
        if !chosen.iter().any(|there| {
            there.candidate == hit.candidate && there.with_constant == hit.with_constant
        }) {
            chosen.push(hit);
        }
    }
    parallel_map(&chosen, problem.is_parallel_worthwhile(), |&hit| {
        let mut start = with_hit(&base.model, hit);
        initialise_amplitudes(problem, &base.residual, &mut start, &hit.part.kind);
        let mut fitted = fit(problem, &start, None);
        if hit.part.kind.has_instant() {
            fitted = refine_step_time(problem, fitted);
        }
        let (fitted, kind) = optimise_bound(problem, &hit.part.kind, fitted);
        ModelExtension::new(problem, kind, fitted)
    })
}

/// `fitted` without `cause`, and with each other cause in its place.
pub(crate) fn fit_replacements(
    problem: &FitProblem,
    fitted: &FittedModel,
    cause: &TermKind,
    most: usize,
) -> TermReplacements {
    let reduced = fit(problem, &without_term(problem, &fitted.model, cause), None);
    // Of two that do as well the one that takes fewer inputs is the answer.
    let mut candidates = match cause.is_flexible() {
        true => all_candidates(problem, &reduced.model, &reduced.residual),
        false => single_input_candidates(problem, &reduced.model, &reduced.residual),
    };
    candidates.retain(|candidate| candidate.kind != *cause);
    let instead = fit_extensions(problem, &reduced, &candidates, most);
    TermReplacements { without: reduced, instead }
}

/// Returns the model without a term; a constant that only came with a reference is removed too.
pub(crate) fn without_term(problem: &FitProblem, model: &Model, cause: &TermKind) -> Model {
    let mut without = model.clone();
    without.parts.retain(|part| part.kind != *cause);
    let needs_zero = problem.data.setting.quantity.axis().is_some()
        || without.parts.iter().any(|part| part.kind.has_reference());
    if !needs_zero {
        without.constant_um = None;
    }
    without
}

/// Returns what a term of `fitted` adds to each group, less its mean, in µm: a constant is anybody's.
pub(crate) fn centred_effect(
    problem: &FitProblem,
    fitted: &FittedModel,
    cause: &TermKind,
) -> Vec<f64> {
    let model = &fitted.model;
    let parts = model.parts.iter().filter(|part| part.kind != *cause).cloned().collect();
    let without = Model { parts, ..model.clone() };
    let [with, without] = [model, &without].map(|model| problem.predict(model));
    let effect: Vec<f64> = with.iter().zip(&without).map(|(a, b)| a - b).collect();
    let mean = effect.iter().sum::<f64>() / effect.len().max(1) as f64;
    effect.into_iter().map(|e| e - mean).collect()
}

/// Returns whether of two effects the one takes back more of the other than it leaves.
pub(crate) fn effects_cancel(one: &[f64], other: &[f64]) -> bool {
    let sum: Vec<f64> = one.iter().zip(other).map(|(a, b)| a + b).collect();
    rms(&sum) < MAJORITY_FRACTION * rms(one).min(rms(other))
}

fn with_hit(model: &Model, hit: &ScanHit) -> Model {
    let mut with = model.clone();
    with.parts.push(hit.part.clone());
    if hit.with_constant {
        with.constant_um = Some(0.0);
    }
    // The zero of what is read together with another input is arbitrary, and a parameter of it.
    let is_constant = |part: &ModelPart| part.kind.cause().is_some_and(Effect::is_constant);
    if hit.part.kind.is_flexible()
        && hit.part.kind.has_reference()
        && model.parts.iter().any(is_constant)
    {
        with.constant_um = with.constant_um.or(Some(0.0));
    }
    if with.constant_um.is_some() {
        // A zero of its own is in the constant now.
        with.parts.retain(|part| !is_constant(part));
    }
    with.sort_parts();
    with
}

/// Amplitudes to begin from, where 0 leaves no derivative for the nonlinear values.
fn initialise_amplitudes(
    problem: &FitProblem,
    residual: &[f64],
    model: &mut Model,
    kind: &TermKind,
) {
    let nonlinear = kind.nonlinear_parameters().len();
    // What the machine file has begins with what the file says.
    if nonlinear == 0 || kind.amplitude_count() == 0 || kind.as_stated_term().is_some() {
        return;
    }
    let Some(index) = model.parts.iter().position(|part| part.kind == *kind) else { return };
    let values = model.parts[index].values[..nonlinear].to_vec();
    let mut columns = problem.basis_columns(kind, &values, false).to_vec();
    if model.constant_um.is_some() {
        columns.push(vec![1.0; problem.groups.len()]);
    }
    let found = solve(&columns, residual, None, 0.0).coefficients;
    for (number, amplitude) in found.iter().take(kind.amplitude_count()).enumerate() {
        model.parts[index].values[nonlinear + number] = *amplitude;
    }
}

/// Returns the time of a step by trying every group around.
fn refine_step_time(problem: &FitProblem, fitted: FittedModel) -> FittedModel {
    let Some(index) = fitted.model.parts.iter().position(|part| part.kind.has_instant()) else {
        return fitted;
    };
    let Some(times) = problem.data.time_s() else { return fitted };
    let groups = &problem.groups;
    let at_s = fitted.model.parts[index].values[0];
    let size = fitted.model.parts[index].values[1];
    let count = groups.len();
    let here =
        (0..count).find(|&group| times[groups.first_row[group]] >= at_s).unwrap_or(count - 1);
    let around = (count / 40).max(3);
    // What would be left if the step came at another group: Σ of the change of the squares.
    let (low, high) = (here.saturating_sub(around).max(1), (here + around).min(count - 1));
    let mut best = (0.0, here);
    let mut change = 0.0;
    for group in (low..here).rev() {
        // This group gets the step as well.
        let r = fitted.residual[group];
        change += (r - size).powi(2) - r * r;
        if change < best.0 {
            best = (change, group);
        }
    }
    change = 0.0;
    for group in here..high {
        // This group loses it.
        let r = fitted.residual[group];
        change += (r + size).powi(2) - r * r;
        if change < best.0 {
            best = (change, group + 1);
        }
    }
    if best.1 == here {
        return fitted;
    }
    let mut model = fitted.model.clone();
    model.parts[index].values[0] = times[groups.first_row[best.1]];
    let moved = fit(problem, &model, None);
    if moved.sum < fitted.sum { moved } else { fitted }
}
