//! Other values of the same cause that the data cannot distinguish from its own.
//!
//! A wave that is looked at on a grid has the same values there as waves of other periods, one as good
//! as the other; a lag that a record does not show out may be short or long. Other values are tried over
//! all that the data could show, with everything else of the model fitted next to them.

use trueup_numerics::least_squares::normal_equations::{dot, solve};

use crate::{
    data::forward_fill,
    fit::{FittedModel, fit, jacobian},
    judgement::context::JudgementContext,
    parameter_estimates::ParameterEstimates,
    periodogram,
    search::model_comparison::STRONG_EVIDENCE_BIC_DIFFERENCE,
    term_kind::ModelPart,
};

/// Peaks of a spectrum that are tried.
const MAX_SPECTRUM_PEAKS: usize = 12;
/// Time constants that a fit begins from.
const INITIAL_TIME_CONSTANT_COUNT: i32 = 5;
/// Most that are reported.
const MAX_ALIASES: usize = 4;

/// First values of `part`, outside its own interval, that do as well; `without` lacks the part.
pub(crate) fn find_aliases(
    case: &JudgementContext<'_>,
    part: &ModelPart,
    without: &FittedModel,
    estimates: &ParameterEstimates,
) -> Vec<f64> {
    let mut found = if part.kind.has_spatial_period() {
        find_alias_periods(case, part, without)
    } else if part.kind.has_time_constant() && part.kind.is_log_scaled(0) {
        find_alias_time_constants(case, part, estimates)
    } else {
        Vec::new()
    };
    found.truncate(MAX_ALIASES);
    found
}

/// Periods whose waves do as well, the best first.
fn find_alias_periods(
    case: &JudgementContext<'_>,
    part: &ModelPart,
    without: &FittedModel,
) -> Vec<f64> {
    let problem = case.problem;
    let Some(position) = problem.data.own_position_mm() else { return Vec::new() };
    let at = problem.groups.means(&forward_fill(position));
    let travel_mm = problem.bounds.travel_mm;
    let (_, others) = jacobian(problem, &without.model);
    let left = |period_mm: f64| {
        let mut columns = others.clone();
        columns.extend(problem.basis_columns(&part.kind, &[period_mm], false).iter().cloned());
        let found = solve(&columns, &without.residual, None, 0.0).coefficients;
        let mut rest = without.residual.clone();
        for (column, value) in columns.iter().zip(&found) {
            rest.iter_mut().zip(column).for_each(|(rest, c)| *rest -= value * c);
        }
        let model = case.found.fitted.model.clone();
        FittedModel { model, sum: dot(&rest, &rest), residual: rest, degrees: 0 }
    };
    // Within this the peaks of two waves are one.
    let is_apart = |a: f64, b: f64| (1.0 / a - 1.0 / b).abs() > 1.0 / travel_mm;
    let own = left(part.values[0]);
    let mut found: Vec<(f64, f64)> = Vec::new();
    for frequency in
        periodogram::find_spectral_peak_frequencies(&at, &without.residual, MAX_SPECTRUM_PEAKS)
    {
        let period_mm = 1.0 / frequency;
        let is_new = found.iter().all(|(there, _)| is_apart(period_mm, *there));
        if is_new && is_apart(period_mm, part.values[0]) {
            let gap = case.bic_gap_between(&own, &left(period_mm));
            if gap < STRONG_EVIDENCE_BIC_DIFFERENCE {
                found.push((period_mm, gap));
            }
        }
    }
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    found.into_iter().map(|(period_mm, _)| period_mm).collect()
}

/// Time constants at which the model is at another best, as good as its own.
fn find_alias_time_constants(
    case: &JudgementContext<'_>,
    part: &ModelPart,
    estimates: &ParameterEstimates,
) -> Vec<f64> {
    let (problem, answer) = (case.problem, &case.found.fitted.model);
    let Some(index) = answer.parts.iter().position(|there| there == part) else {
        return Vec::new();
    };
    let [low, high] = problem.bounds.time_constant_s;
    let ratio = (high / low).powf(1.0 / f64::from(INITIAL_TIME_CONSTANT_COUNT + 1));
    let interval = estimates.intervals[0];
    // What is not finite says nothing about what is outside it.
    let is_outside = |s: f64| s < interval[0] || s > interval[1];
    let mut found: Vec<f64> = Vec::new();
    for n in 1..=INITIAL_TIME_CONSTANT_COUNT {
        let start_s = low * ratio.powi(n);
        if !is_outside(start_s) {
            continue;
        }
        let mut model = answer.clone();
        model.parts[index].values[0] = start_s;
        let there = fit(problem, &model, None);
        let s = there.model.parts[index].values[0];
        // Twice as long or half as long is another one, if it is outside.
        let is_apart = |other: f64| (s / other).ln().abs() > std::f64::consts::LN_2;
        if is_outside(s)
            && is_apart(part.values[0])
            && found.iter().all(|other| is_apart(*other))
            && case.bic_gap(&there) < STRONG_EVIDENCE_BIC_DIFFERENCE
        {
            found.push(s);
        }
    }
    found
}
