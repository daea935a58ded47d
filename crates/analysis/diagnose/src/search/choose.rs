//! Which of the extensions that a scan puts first is taken: judged on blocks that were left out.

use trueup_numerics::blocks::{Reduction, rms};

use crate::{
    blocks::Folds,
    fit::{Fitted, Problem},
    gain::Gain,
    kind::Kind,
    search::{
        criterion::{EQUAL_PREDICTION, STRONG_EVIDENCE, bic, degrees, noise_of},
        extend::{Extension, fit_hits, with_each_cause},
        scan::Hit,
        state::{RejectReason, Search, Tried},
    },
};

/// Those of the extensions that are tried on left-out blocks.
const MAX_LEFT_OUT: usize = 8;
/// Groups beyond which pairs are not tried from nothing: it would take too long.
const MAX_GROUPS_FOR_PAIRS: usize = 3000;

/// The outcome of a round.
pub(crate) enum Choice {
    Take(ChosenExtension),
    /// None of these.
    Reject(Vec<Tried>),
}

/// The extension that is taken.
pub(crate) struct ChosenExtension {
    pub fitted: Fitted,
    /// The causes that are new in it.
    pub causes: Vec<Kind>,
    pub gain: Gain,
    /// Other extensions that were tried.
    pub tried: Vec<Tried>,
}

/// An extension, with what it is worth on blocks that were left out.
struct Assessed {
    cause: Kind,
    fitted: Fitted,
    bic: f64,
    /// Its residual in each group where that was left out.
    left_out: Vec<f64>,
    left_out_um: f64,
    reduction: Reduction,
    /// Whether it predicts better than the model before, by an amount that matters.
    is_gain: bool,
}

/// The model before, on the same blocks.
struct Baseline<'s> {
    search: &'s Search<'s>,
    folds: Folds,
    left_out: Vec<f64>,
}

impl<'s> Baseline<'s> {
    /// On blocks for noise with the memory of what `best` leaves.
    fn new(search: &'s Search<'s>, best: &Fitted) -> Self {
        let noise = noise_of(search.problem, &best.residual, degrees(&best.model));
        let folds = Folds::new(search.problem, noise.memory);
        let left_out = folds.held_out(search.problem, &search.fitted.model);
        Self { search, folds, left_out }
    }

    fn assess(&self, extension: Extension) -> Assessed {
        let Extension { cause, fitted, bic } = extension;
        let left_out = self.folds.held_out(self.search.problem, &fitted.model);
        let left_out_um = rms(&left_out);
        let reduction = self.folds.reduction(&self.left_out, &left_out);
        let before_um = rms(&self.left_out);
        let is_relevant = before_um - left_out_um > self.search.relevant_um;
        // What is one of very many must foresee better by more than what counts as equal.
        let is_clear = !cause.is_composed()
            || EQUAL_PREDICTION * left_out_um < before_um
                && bic + self.search.price_of_composed() < self.search.bic();
        let is_gain = reduction.is_gain && is_relevant && is_clear;
        Assessed { cause, fitted, bic, left_out, left_out_um, reduction, is_gain }
    }

    fn gain(&self, after: &Fitted, left_out: &[f64], reduction: &Reduction) -> Gain {
        let rms_um = [self.search.fitted.rms(), after.rms()];
        Gain::new(rms_um, [&self.left_out, left_out], reduction)
    }

    /// Those of `all` that are not taken, and why not.
    fn not_taken(&self, all: &[Assessed], taken: Option<usize>) -> Vec<Tried> {
        let others = all.iter().enumerate().filter(|(index, _)| Some(*index) != taken);
        others
            .map(|(_, it)| Tried {
                cause: it.cause.clone(),
                rms_um: it.fitted.rms(),
                left_out_um: Some(it.left_out_um),
                why_not: if it.is_gain {
                    RejectReason::Outperformed
                } else {
                    RejectReason::NoGain {
                        left_out: self.folds.unit,
                        before_um: rms(&self.left_out),
                        after_um: it.left_out_um,
                    }
                },
            })
            .collect()
    }
}

/// Of those `options` that predict left-out blocks as well as the best, the one of the best BIC; of
/// equals the simplest, then the machine's own. No partner of one is farther away than `tier`.
pub(crate) fn choose(
    search: &Search<'_>,
    mut options: Vec<Extension>,
    tier: u8,
    progress: &mut dyn FnMut(&str, f64),
) -> Choice {
    let best_fit = options.iter().min_by(|a, b| a.fitted.sum.total_cmp(&b.fitted.sum));
    let Some(best_fit) = best_fit else { return Choice::Reject(Vec::new()) };
    let baseline = Baseline::new(search, &best_fit.fitted);
    options.sort_by(|a, b| a.bic.total_cmp(&b.bic));
    options.truncate(MAX_LEFT_OUT);
    let mut all: Vec<Assessed> = options
        .into_iter()
        .map(|extension| {
            progress(extension.cause.name(), f64::NAN);
            baseline.assess(extension)
        })
        .collect();
    let least_um =
        all.iter().filter(|it| it.is_gain).map(|it| it.left_out_um).fold(f64::INFINITY, f64::min);
    if let Some(pair) = pair_with_the_first(&baseline, &all, tier, least_um) {
        return Choice::Take(pair);
    }
    let Some(taken) = best_of(&all, least_um) else {
        return Choice::Reject(baseline.not_taken(&all, None));
    };
    let tried = baseline.not_taken(&all, Some(taken));
    let it = all.swap_remove(taken);
    let gain = baseline.gain(&it.fitted, &it.left_out, &it.reduction);
    Choice::Take(ChosenExtension { fitted: it.fitted, causes: vec![it.cause], gain, tried })
}

/// Returns the place of the one to take, where `least_um` is the least that one of them leaves.
fn best_of(all: &[Assessed], least_um: f64) -> Option<usize> {
    let predicts = |it: &Assessed| it.is_gain && it.left_out_um <= EQUAL_PREDICTION * least_um;
    let best = all.iter().filter(|it| predicts(it)).map(|it| it.bic).fold(f64::INFINITY, f64::min);
    let simple = |it: &Assessed| (degrees(&it.fitted.model), it.cause.tier());
    all.iter()
        .enumerate()
        .filter(|(_, it)| predicts(it) && it.bic < best + STRONG_EVIDENCE)
        .min_by(|(_, a), (_, b)| {
            simple(a).cmp(&simple(b)).then(a.left_out_um.total_cmp(&b.left_out_um))
        })
        .map(|(index, _)| index)
}

/// Returns what is right may predict no better while something else is wrong next to it: the first of `all` with
/// a partner that lets it predict.
fn pair_with_the_first(
    baseline: &Baseline<'_>,
    all: &[Assessed],
    tier: u8,
    least_um: f64,
) -> Option<ChosenExtension> {
    let (search, first) = (baseline.search, &all[0]);
    let is_relevant = search.fitted.rms() - first.fitted.rms() > search.relevant_um;
    if first.is_gain
        || !is_relevant
        || first.cause.is_composed()
        || first.bic >= search.bic() - STRONG_EVIDENCE
    {
        return None;
    }
    partners(search.problem, &first.fitted, tier).into_iter().find_map(|partner| {
        let left_out = baseline.folds.held_out(search.problem, &partner.fitted.model);
        let reduction = baseline.folds.reduction(&baseline.left_out, &left_out);
        let predicts = reduction.is_gain && rms(&left_out) < EQUAL_PREDICTION * least_um;
        predicts.then(|| ChosenExtension {
            causes: vec![first.cause.clone(), partner.cause],
            gain: baseline.gain(&partner.fitted, &left_out, &reduction),
            fitted: partner.fitted,
            tried: baseline.not_taken(all, Some(0)),
        })
    })
}

/// Returns the causes of at most `tier` that do most next to what `base` has, the best first.
fn partners(problem: &Problem, base: &Fitted, tier: u8) -> Vec<Extension> {
    let own = bic(problem, base);
    let mut better = with_each_cause(problem, base, 4, |cause| cause.tier() <= tier);
    better.retain(|it| it.bic < own - STRONG_EVIDENCE);
    better.sort_by(|a, b| a.bic.total_cmp(&b.bic));
    better
}

/// Two causes may each be hidden by the other, so that neither alone is more than noise. Tries the
/// partners of the most likely of `hits`; a pair must be half as much again above `limit`, what noise
/// lets one candidate reach, and must predict left-out blocks better.
pub(crate) fn pair_from_nothing(
    search: &Search<'_>,
    hits: &[Hit],
    tier: u8,
    limit: f64,
) -> Option<ChosenExtension> {
    let problem = search.problem;
    if problem.groups.len() > MAX_GROUPS_FOR_PAIRS {
        return None;
    }
    let is_simple = |cause: &Kind| cause.tier() <= 1 && cause.amplitudes() <= 2;
    let simple: Vec<Hit> = hits.iter().filter(|hit| is_simple(&hit.part.kind)).cloned().collect();
    let mut best_bic = search.bic() - 1.5 * limit.max(0.0) - 2.0 * STRONG_EVIDENCE;
    let mut best: Option<(Kind, Extension)> = None;
    for first in fit_hits(problem, &search.fitted, &simple, 5) {
        let Some(partner) = partners(problem, &first.fitted, tier).into_iter().next() else {
            continue;
        };
        if partner.bic < best_bic {
            best_bic = partner.bic;
            best = Some((first.cause, partner));
        }
    }
    let (first, partner) = best?;
    let baseline = Baseline::new(search, &partner.fitted);
    let left_out = baseline.folds.held_out(problem, &partner.fitted.model);
    let reduction = baseline.folds.reduction(&baseline.left_out, &left_out);
    reduction.is_gain.then(|| ChosenExtension {
        causes: vec![first, partner.cause],
        gain: baseline.gain(&partner.fitted, &left_out, &reduction),
        fitted: partner.fitted,
        tried: Vec::new(),
    })
}
