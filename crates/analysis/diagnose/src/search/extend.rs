//! A model with one cause more, fitted as a whole; and with another cause in a term's place.

use trueup_numerics::{blocks::rms, least_squares::normal::solve, parallel::on_all_cores};

use trueup_machine::effect::Effect;

use crate::{
    candidates::{Candidate, possible, with_composed},
    fit::{Fitted, Problem, fit},
    kind::{Kind, Part},
    model::Model,
    search::{
        bound::with_best_bound,
        criterion::{MAJORITY, bic},
        scan::{Draw, Hit, scan},
    },
};

/// A model that was extended by a cause, fitted with everything else.
#[derive(Clone)]
pub(crate) struct Extension {
    pub cause: Kind,
    pub fitted: Fitted,
    pub bic: f64,
}

impl Extension {
    pub(crate) fn new(problem: &Problem, cause: Kind, fitted: Fitted) -> Self {
        let bic = bic(problem, &fitted);
        Self { cause, fitted, bic }
    }

    /// Returns the one of the best BIC; of equals the first.
    pub(crate) fn best(all: impl IntoIterator<Item = Self>) -> Option<Self> {
        all.into_iter().min_by(|a, b| a.bic.total_cmp(&b.bic))
    }
}

/// A term's place: the model without the term, and with each other cause instead of it.
pub(crate) struct Replacements {
    pub without: Fitted,
    pub instead: Vec<Extension>,
}

/// `base` with each of the `candidates` that a scan puts first; whether noise would show as much is
/// not asked.
pub(crate) fn extensions(
    problem: &Problem,
    base: &Fitted,
    candidates: &[Candidate],
    most: usize,
) -> Vec<Extension> {
    // The names, the settings and the base are all that such a scan follows from.
    let what = format!("scan {candidates:?}");
    let scanned = problem.known(&what, &base.model, || scan(problem, base, candidates, Draw::Not));
    fit_hits(problem, base, &scanned.hits, most)
}

/// `base` with each of the causes that the data allow and that `admits` lets in, of those the ones that
/// a scan puts first.
pub(crate) fn with_each_cause(
    problem: &Problem,
    base: &Fitted,
    most: usize,
    admits: impl Fn(&Kind) -> bool,
) -> Vec<Extension> {
    let mut candidates = possible(problem, &base.model, &base.residual);
    candidates.retain(|candidate| admits(&candidate.kind));
    extensions(problem, base, &candidates, most)
}

/// `base` with each of the `most` best of `hits` by squares, and the better half as many by likelihood.
pub(crate) fn fit_hits(
    problem: &Problem,
    base: &Fitted,
    hits: &[Hit],
    most: usize,
) -> Vec<Extension> {
    let mut order: Vec<&Hit> = hits.iter().collect();
    order.sort_by(|a, b| b.by_squares.total_cmp(&a.by_squares));
    let mut chosen: Vec<&Hit> = order.iter().take(most).copied().collect();
    order.sort_by(|a, b| b.by_likelihood.total_cmp(&a.by_likelihood));
    for hit in order.iter().take(most / 2) {
        if !chosen.iter().any(|there| {
            there.candidate == hit.candidate && there.with_constant == hit.with_constant
        }) {
            chosen.push(hit);
        }
    }
    on_all_cores(&chosen, problem.is_large(), |&hit| {
        let mut start = with(&base.model, hit);
        begin(problem, &base.residual, &mut start, &hit.part.kind);
        let mut fitted = fit(problem, &start, None);
        if hit.part.kind.has_instant() {
            fitted = refine_step(problem, fitted);
        }
        let (fitted, kind) = with_best_bound(problem, &hit.part.kind, fitted);
        Extension::new(problem, kind, fitted)
    })
}

/// `fitted` without `cause`, and with each other cause in its place.
pub(crate) fn replacements(
    problem: &Problem,
    fitted: &Fitted,
    cause: &Kind,
    most: usize,
) -> Replacements {
    let reduced = fit(problem, &without(problem, &fitted.model, cause), None);
    // Of two that do as well the one that takes fewer inputs is the answer.
    let mut candidates = match cause.is_composed() {
        true => with_composed(problem, &reduced.model, &reduced.residual),
        false => possible(problem, &reduced.model, &reduced.residual),
    };
    candidates.retain(|candidate| candidate.kind != *cause);
    let instead = extensions(problem, &reduced, &candidates, most);
    Replacements { without: reduced, instead }
}

/// Returns the model without a term; a constant that only came with a reference goes with it.
pub(crate) fn without(problem: &Problem, model: &Model, cause: &Kind) -> Model {
    let mut without = model.clone();
    without.parts.retain(|part| part.kind != *cause);
    let needs_zero = problem.data.quantity.axis().is_some()
        || without.parts.iter().any(|part| part.kind.has_reference());
    if !needs_zero {
        without.constant_um = None;
    }
    without
}

/// Returns what a term of `fitted` adds to each group, less its mean, in µm: a constant is anybody's.
pub(crate) fn centred_effect(problem: &Problem, fitted: &Fitted, cause: &Kind) -> Vec<f64> {
    let model = &fitted.model;
    let parts = model.parts.iter().filter(|part| part.kind != *cause).cloned().collect();
    let without = Model { parts, ..model.clone() };
    let [with, without] = [model, &without].map(|model| problem.predicted(model));
    let effect: Vec<f64> = with.iter().zip(&without).map(|(a, b)| a - b).collect();
    let mean = effect.iter().sum::<f64>() / effect.len().max(1) as f64;
    effect.into_iter().map(|e| e - mean).collect()
}

/// Returns whether of two effects the one takes back more of the other than it leaves.
pub(crate) fn take_back(one: &[f64], other: &[f64]) -> bool {
    let sum: Vec<f64> = one.iter().zip(other).map(|(a, b)| a + b).collect();
    rms(&sum) < MAJORITY * rms(one).min(rms(other))
}

fn with(model: &Model, hit: &Hit) -> Model {
    let mut with = model.clone();
    with.parts.push(hit.part.clone());
    if hit.with_constant {
        with.constant_um = Some(0.0);
    }
    // The zero of what is read together with another input is arbitrary, and a parameter of it.
    let is_constant = |part: &Part| part.kind.cause().is_some_and(Effect::is_constant);
    if hit.part.kind.is_composed()
        && hit.part.kind.has_reference()
        && model.parts.iter().any(is_constant)
    {
        with.constant_um = with.constant_um.or(Some(0.0));
    }
    if with.constant_um.is_some() {
        // A zero of its own is in the constant now.
        with.parts.retain(|part| !is_constant(part));
    }
    with.sort();
    with
}

/// Amplitudes to begin from, where 0 leaves no derivative for the nonlinear values.
fn begin(problem: &Problem, residual: &[f64], model: &mut Model, kind: &Kind) {
    let nonlinear = kind.nonlinear().len();
    // What the machine file has begins with what the file says.
    if nonlinear == 0 || kind.amplitudes() == 0 || kind.stated().is_some() {
        return;
    }
    let Some(index) = model.parts.iter().position(|part| part.kind == *kind) else { return };
    let values = model.parts[index].values[..nonlinear].to_vec();
    let mut columns = problem.columns(kind, &values, false).to_vec();
    if model.constant_um.is_some() {
        columns.push(vec![1.0; problem.groups.len()]);
    }
    let found = solve(&columns, residual, None, 0.0).coefficients;
    for (number, amplitude) in found.iter().take(kind.amplitudes()).enumerate() {
        model.parts[index].values[nonlinear + number] = *amplitude;
    }
}

/// Returns the time of a step by trying every group around.
fn refine_step(problem: &Problem, fitted: Fitted) -> Fitted {
    let Some(index) = fitted.model.parts.iter().position(|part| part.kind.has_instant()) else {
        return fitted;
    };
    let Some(times) = problem.data.time_s.as_deref() else { return fitted };
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
