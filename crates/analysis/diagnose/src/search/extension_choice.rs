//! Which of the extensions that a scan puts first is taken: judged on blocks that were held out.

use trueup_numerics::block_resampling::{RmsReduction, rms};

use crate::{
    fit::{FitProblem, FittedModel},
    folds::{FoldUnit, Folds},
    search::{
        extension::{ModelExtension, fit_scan_hits, fit_single_cause_extensions},
        model_comparison::{
            MAX_EQUIVALENT_RMS_RATIO, STRONG_EVIDENCE_BIC_DIFFERENCE, bic, degrees_of_freedom,
            estimate_noise,
        },
        scan::ScanHit,
        search_state::{RejectReason, RejectedCandidate, Search},
    },
    term_gain::TermGain,
    term_kind::TermKind,
};

/// Those of the extensions that are tried on held-out blocks.
const MAX_CROSS_VALIDATED_EXTENSIONS: usize = 8;
/// Groups beyond which pairs are not tried from nothing: it would take too long.
const MAX_GROUPS_FOR_PAIRS: usize = 3000;

/// The outcome of a round.
pub(crate) enum SelectionOutcome {
    Accept(ChosenExtension),
    /// None of these.
    Reject(Vec<RejectedCandidate>),
}

/// The extension that is taken.
pub(crate) struct ChosenExtension {
    pub fitted: FittedModel,
    /// The causes that are new in it.
    pub causes: Vec<TermKind>,
    pub gain: TermGain,
    /// Other extensions that were tried.
    pub tried: Vec<RejectedCandidate>,
}

/// An extension, with what it is worth on blocks that were held out.
struct AssessedExtension {
    cause: TermKind,
    fitted: FittedModel,
    bic: f64,
    /// Its residual in each group where that was held out.
    left_out: Vec<f64>,
    left_out_um: f64,
    reduction: RmsReduction,
    /// Whether it predicts better than the model before, by an amount that matters.
    is_gain: bool,
    /// What was held out for it.
    left_out_unit: FoldUnit,
}

/// The model before, on the same blocks.
struct BaselineModel<'s> {
    search: &'s Search<'s>,
    folds: Folds,
    left_out: Vec<f64>,
}

impl<'s> BaselineModel<'s> {
    /// On blocks for noise with the memory of what `best` leaves.
    fn new(search: &'s Search<'s>, best: &FittedModel) -> Self {
        let noise = estimate_noise(search.problem, &best.residual, degrees_of_freedom(&best.model));
        let folds = Folds::new(search.problem, noise.memory);
        let left_out = folds.held_out_residuals(search.problem, &search.fitted.model);
        Self { search, folds, left_out }
    }

    fn assess(&self, extension: ModelExtension) -> AssessedExtension {
        let ModelExtension { cause, fitted, bic } = extension;
        let left_out = self.folds.held_out_residuals(self.search.problem, &fitted.model);
        let left_out_um = rms(&left_out);
        let reduction = self.folds.rms_reduction(&self.left_out, &left_out);
        let before_um = rms(&self.left_out);
        let is_relevant = before_um - left_out_um > self.search.relevant_um;
        // What is one of very many must predict better by more than what counts as equal.
        let is_clear = !cause.is_flexible()
            || MAX_EQUIVALENT_RMS_RATIO * left_out_um < before_um
                && bic + self.search.interaction_penalty() < self.search.bic();
        let is_gain = reduction.is_gain && is_relevant && is_clear;
        let left_out_unit = self.folds.unit_for(&cause);
        AssessedExtension {
            cause,
            fitted,
            bic,
            left_out,
            left_out_um,
            reduction,
            is_gain,
            left_out_unit,
        }
    }

    fn term_gain(
        &self,
        after: &FittedModel,
        left_out: &[f64],
        reduction: &RmsReduction,
    ) -> TermGain {
        let rms_um = [self.search.fitted.rms(), after.rms()];
        TermGain::new(rms_um, [&self.left_out, left_out], reduction)
    }

    /// Those of `all` that are not taken, and why not.
    fn rejected_extensions(
        &self,
        all: &[AssessedExtension],
        taken: Option<usize>,
    ) -> Vec<RejectedCandidate> {
        let others = all.iter().enumerate().filter(|(index, _)| Some(*index) != taken);
        others
            .map(|(_, extension)| RejectedCandidate {
                cause: extension.cause.clone(),
                rms_um: extension.fitted.rms(),
                left_out_um: Some(extension.left_out_um),
                why_not: if extension.is_gain {
                    RejectReason::Outperformed
                } else {
                    RejectReason::NoGain {
                        left_out: extension.left_out_unit,
                        before_um: rms(&self.left_out),
                        after_um: extension.left_out_um,
                    }
                },
            })
            .collect()
    }
}

/// Of those `options` that predict held-out blocks as well as the best, the one of the best BIC; of
/// equals the simplest, then the machine's own. No partner of one is farther away than `tier`.
pub(crate) fn choose_extension(
    search: &Search<'_>,
    mut options: Vec<ModelExtension>,
    tier: u8,
    progress: &mut dyn FnMut(&str, f64),
) -> SelectionOutcome {
    let best_fit = options.iter().min_by(|a, b| a.fitted.sum.total_cmp(&b.fitted.sum));
    let Some(best_fit) = best_fit else { return SelectionOutcome::Reject(Vec::new()) };
    let baseline = BaselineModel::new(search, &best_fit.fitted);
    options.sort_by(|a, b| a.bic.total_cmp(&b.bic));
    options.truncate(MAX_CROSS_VALIDATED_EXTENSIONS);
    let mut all: Vec<AssessedExtension> = options
        .into_iter()
        .map(|extension| {
            progress(extension.cause.name(), f64::NAN);
            baseline.assess(extension)
        })
        .collect();
    let least_um = find_least_held_out_um(&all, |_| true);
    if let Some(pair) = find_first_predictive_pair(&baseline, &all, tier, least_um) {
        return SelectionOutcome::Accept(pair);
    }
    let Some(taken) = find_best_extension_index(&all) else {
        return SelectionOutcome::Reject(baseline.rejected_extensions(&all, None));
    };
    let tried = baseline.rejected_extensions(&all, Some(taken));
    let it = all.swap_remove(taken);
    let gain = baseline.term_gain(&it.fitted, &it.left_out, &it.reduction);
    SelectionOutcome::Accept(ChosenExtension {
        fitted: it.fitted,
        causes: vec![it.cause],
        gain,
        tried,
    })
}

/// Returns the least that one of the extensions which are a gain, and are `compared`, leaves on held-out blocks, in µm.
fn find_least_held_out_um(
    all: &[AssessedExtension],
    compared: impl Fn(&AssessedExtension) -> bool,
) -> f64 {
    all.iter()
        .filter(|extension| extension.is_gain && compared(extension))
        .map(|extension| extension.left_out_um)
        .fold(f64::INFINITY, f64::min)
}

/// Returns the place of the one to take.
fn find_best_extension_index(all: &[AssessedExtension]) -> Option<usize> {
    // A drawn row of a guide is predicted better than a stretch: the two are no measure of each other.
    let predicts = |extension: &AssessedExtension| {
        let unit = extension.left_out_unit;
        let least_um = find_least_held_out_um(all, |other| other.left_out_unit == unit);
        extension.is_gain && extension.left_out_um <= MAX_EQUIVALENT_RMS_RATIO * least_um
    };
    let best = all
        .iter()
        .filter(|extension| predicts(extension))
        .map(|extension| extension.bic)
        .fold(f64::INFINITY, f64::min);
    let simple = |extension: &AssessedExtension| {
        (degrees_of_freedom(&extension.fitted.model), extension.cause.tier())
    };
    all.iter()
        .enumerate()
        .filter(|(_, extension)| {
            predicts(extension) && extension.bic < best + STRONG_EVIDENCE_BIC_DIFFERENCE
        })
        .min_by(|(_, a), (_, b)| {
            simple(a).cmp(&simple(b)).then(a.left_out_um.total_cmp(&b.left_out_um))
        })
        .map(|(index, _)| index)
}

/// Returns what is right may predict no better while something else is wrong next to it: the first of `all` with
/// a partner that lets it predict.
fn find_first_predictive_pair(
    baseline: &BaselineModel<'_>,
    all: &[AssessedExtension],
    tier: u8,
    least_um: f64,
) -> Option<ChosenExtension> {
    let (search, first) = (baseline.search, &all[0]);
    let is_relevant = search.fitted.rms() - first.fitted.rms() > search.relevant_um;
    if first.is_gain
        || !is_relevant
        || first.cause.is_flexible()
        || first.bic >= search.bic() - STRONG_EVIDENCE_BIC_DIFFERENCE
    {
        return None;
    }
    fit_partner_extensions(search.problem, &first.fitted, tier).into_iter().find_map(|partner| {
        let left_out = baseline.folds.held_out_residuals(search.problem, &partner.fitted.model);
        let reduction = baseline.folds.rms_reduction(&baseline.left_out, &left_out);
        let predicts = reduction.is_gain && rms(&left_out) < MAX_EQUIVALENT_RMS_RATIO * least_um;
        predicts.then(|| ChosenExtension {
            causes: vec![first.cause.clone(), partner.cause],
            gain: baseline.term_gain(&partner.fitted, &left_out, &reduction),
            fitted: partner.fitted,
            tried: baseline.rejected_extensions(all, Some(0)),
        })
    })
}

/// Returns the causes of at most `tier` that do most next to what `base` has, the best first.
fn fit_partner_extensions(
    problem: &FitProblem,
    base: &FittedModel,
    tier: u8,
) -> Vec<ModelExtension> {
    let own = bic(problem, base);
    let mut better = fit_single_cause_extensions(problem, base, 4, |cause| cause.tier() <= tier);
    better.retain(|extension| extension.bic < own - STRONG_EVIDENCE_BIC_DIFFERENCE);
    better.sort_by(|a, b| a.bic.total_cmp(&b.bic));
    better
}

/// Two causes may each be hidden by the other, so that neither alone is more than noise. Tries the
/// partners of the most likely of `hits`; a pair must reach twice `limit`, what noise lets one candidate reach, and must
/// predict held-out blocks better.
pub(crate) fn find_suppressor_pair(
    search: &Search<'_>,
    hits: &[ScanHit],
    tier: u8,
    limit: f64,
) -> Option<ChosenExtension> {
    let problem = search.problem;
    if problem.groups.len() > MAX_GROUPS_FOR_PAIRS {
        return None;
    }
    let is_simple = |cause: &TermKind| cause.tier() <= 1 && cause.amplitude_count() <= 2;
    let simple: Vec<ScanHit> =
        hits.iter().filter(|hit| is_simple(&hit.part.kind)).cloned().collect();
    let mut best_bic = search.bic() - 2.0 * limit.max(STRONG_EVIDENCE_BIC_DIFFERENCE);
    let mut best: Option<(TermKind, ModelExtension)> = None;
    for first in fit_scan_hits(problem, &search.fitted, &simple, 5) {
        let Some(partner) = fit_partner_extensions(problem, &first.fitted, tier).into_iter().next()
        else {
            continue;
        };
        if partner.bic < best_bic {
            best_bic = partner.bic;
            best = Some((first.cause, partner));
        }
    }
    let (first, partner) = best?;
    let baseline = BaselineModel::new(search, &partner.fitted);
    let left_out = baseline.folds.held_out_residuals(problem, &partner.fitted.model);
    let reduction = baseline.folds.rms_reduction(&baseline.left_out, &left_out);
    reduction.is_gain.then(|| ChosenExtension {
        causes: vec![first, partner.cause],
        gain: baseline.term_gain(&partner.fitted, &left_out, &reduction),
        fitted: partner.fitted,
        tried: Vec::new(),
    })
}
