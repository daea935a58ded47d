//! The bound of a range, where it leaves least.

use trueup_machine::effect::{Effect, RangeLimited};

use crate::{
    columns::column_by_name,
    fit::{FitProblem, FittedModel, fit},
    model::Model,
    term_kind::TermKind,
};

/// Bounds that are tried at once.
const BOUNDS_PER_PASS: usize = 9;
/// Steps in which an interval is looked through, of all that the column has.
const INTERVAL_SCAN_STEPS: usize = 60;
/// The share of the rows on either side of a bound in which a better one is looked for: as far as the next one that a
/// search tries.
const REFINEMENT_FRACTION: f64 = 0.1;

/// Returns `fitted` with the bound of its part `kind` where it leaves least, and that part.
pub(super) fn optimise_bound(
    problem: &FitProblem,
    kind: &TermKind,
    fitted: FittedModel,
) -> (FittedModel, TermKind) {
    let mut kind = kind.clone();
    let Some(within) = kind.cause().and_then(Effect::as_range_limited) else {
        return (fitted, kind);
    };
    let Some(values) = column_by_name(&problem.data, &within.column) else { return (fitted, kind) };
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let place = |bound: f64| sorted.partition_point(|value| *value <= bound);
    let around = (REFINEMENT_FRACTION * sorted.len() as f64) as usize;
    let (mut low, mut high) = {
        let here = place(within.bound);
        (here.saturating_sub(around).max(1), (here + around).min(sorted.len().saturating_sub(1)))
    };
    let mut best = fitted;
    while low < high {
        let step = ((high - low) / BOUNDS_PER_PASS).max(1);
        let mut at = None;
        for number in (low..=high).step_by(step) {
            // Between two values that differ.
            let bound = 0.5 * (sorted[number - 1] + sorted[number]);
            if sorted[number - 1] == sorted[number] {
                continue;
            }
            let Some(with) = refit_with_bound(problem, &best.model, &kind, bound) else { continue };
            if with.0.rms() < best.rms() {
                (best, kind) = with;
                at = Some(number);
            }
        }
        let Some(number) = at.filter(|_| step > 1) else { break };
        (low, high) = (number.saturating_sub(step).max(low), (number + step).min(high));
    }
    (best, kind)
}

/// Returns the least and the most that the bound of `kind` may be, in the column's unit: beyond them the fit is no longer
/// near `fitted`, by `is_near`. The ends are values of the record.
pub(crate) fn profile_interval(
    problem: &FitProblem,
    fitted: &FittedModel,
    kind: &TermKind,
    is_near: impl Fn(&FittedModel) -> bool,
) -> Option<[f64; 2]> {
    let within = kind.cause().and_then(Effect::as_range_limited)?;
    let mut values: Vec<f64> = column_by_name(&problem.data, &within.column)?.to_vec();
    values.retain(|value| value.is_finite());
    values.sort_unstable_by(f64::total_cmp);
    values.dedup();
    let here = values.partition_point(|value| *value <= within.bound);
    let step = (values.len() / INTERVAL_SCAN_STEPS).max(1);
    let is_open = |number: usize| {
        let bound = 0.5 * (values[number - 1] + values[number]);
        refit_with_bound(problem, &fitted.model, kind, bound)
            .is_some_and(|(with, _)| is_near(&with))
    };
    let below = (1..here).rev().step_by(step).take_while(|number| is_open(*number)).last();
    let above = (here + 1..values.len()).step_by(step).take_while(|number| is_open(*number)).last();
    Some([*values.get(below.unwrap_or(here).checked_sub(1)?)?, *values.get(above.unwrap_or(here))?])
}

/// Returns `model`, fitted, with another bound of its part `kind`, and that part.
fn refit_with_bound(
    problem: &FitProblem,
    model: &Model,
    kind: &TermKind,
    bound: f64,
) -> Option<(FittedModel, TermKind)> {
    let within = kind.cause().and_then(Effect::as_range_limited)?;
    let moved = TermKind::Cause(Effect::RangeLimited(RangeLimited { bound, ..within.clone() }));
    let mut model = model.clone();
    let part = model.parts.iter_mut().find(|part| part.kind == *kind)?;
    part.kind = moved.clone();
    Some((fit(problem, &model, None), moved))
}
