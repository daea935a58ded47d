//! Which of the candidates that a scan puts first is taken: judged on blocks that were left out.

use crate::{
    blocks::{Folds, rms},
    candidates::{Candidate, possible},
    fit::{Fitted, Problem},
    model::Kind,
    scan::{Draw, Hit, scan},
    search::{Gain, TIE, Tried, degrees, fitted_hits, independent, score},
};

/// Those of the fitted candidates that are tried on left-out blocks.
const MOST_LEFT_OUT: usize = 8;

/// The model that is taken, with the causes that are new in it; what was tried; the gain.
pub(crate) type Chosen = (Option<((Fitted, Vec<Kind>), Vec<Tried>, Gain)>, Vec<Tried>);

/// A choice, with what it is worth on blocks that were left out.
struct Choice {
    score: f64,
    hit: Hit,
    fitted: Fitted,
    left: Vec<f64>,
    reduction: (f64, [f64; 2], bool),
}

/// What leaves more than this times the least on left-out blocks does not predict as well.
pub(crate) const AS_WELL: f64 = 1.05;

/// The option to take, and the others: of those that predict left-out blocks as well as the best,
/// the one of the best score; of equal scores the simplest, then the machine's own.
pub(crate) fn choose(
    problem: &Problem,
    before: &Fitted,
    options: Vec<(Hit, Fitted)>,
    candidates: &[Candidate],
    worth_um: f64,
    progress: &mut dyn FnMut(&str, f64),
) -> Chosen {
    if options.is_empty() {
        return (None, Vec::new());
    }
    // The memory of the noise is that of what the best of them leaves.
    let best_fit = options
        .iter()
        .min_by(|a, b| a.1.sum.total_cmp(&b.1.sum))
        .map(|(_, fitted)| fitted)
        .unwrap_or(before);
    let (noise, _) = independent(problem, &best_fit.residual, degrees(&best_fit.model));
    let folds = Folds::new(problem, noise.memory);
    let left_before = folds.left_out(problem, &before.model);
    let mut options: Vec<(f64, Hit, Fitted)> =
        options.into_iter().map(|(hit, fitted)| (score(problem, &fitted), hit, fitted)).collect();
    options.sort_by(|a, b| a.0.total_cmp(&b.0));
    options.truncate(MOST_LEFT_OUT);
    let mut all: Vec<Choice> = options
        .into_iter()
        .map(|(score, hit, fitted)| {
            progress(hit.part.kind.name(), f64::NAN);
            let left = folds.left_out(problem, &fitted.model);
            let mut reduction = folds.reduction(&left_before, &left);
            reduction.2 &= rms(&left_before) - rms(&left) > worth_um;
            Choice { score, hit, fitted, left, reduction }
        })
        .collect();
    all.sort_by(|a, b| a.score.total_cmp(&b.score));
    let tier = |it: &Choice| it.hit.part.kind.tier();
    let least = all
        .iter()
        .filter(|it| it.reduction.2)
        .map(|it| rms(&it.left))
        .fold(f64::INFINITY, f64::min);
    let gain = |left: &[f64], reduction: (f64, [f64; 2], bool), fitted: &Fitted| Gain {
        rms_before_um: before.rms(),
        rms_after_um: fitted.rms(),
        left_out_before_um: rms(&left_before),
        left_out_after_um: rms(left),
        reduction: reduction.0,
        ci95: reduction.1,
    };
    let tried = |all: &[Choice], taken: Option<usize>| -> Vec<Tried> {
        all.iter()
            .enumerate()
            .filter(|(index, _)| Some(*index) != taken)
            .map(|(_, it)| Tried {
                kind: it.hit.part.kind.clone(),
                rms_um: it.fitted.rms(),
                left_out_um: rms(&it.left),
                why_not: if it.reduction.2 {
                    "another explains it as well and is simpler, or predicts better".into()
                } else {
                    format!(
                        "no gain on left-out {}: {:.3} µm before, {:.3} µm with it",
                        folds.what,
                        rms(&left_before),
                        rms(&it.left)
                    )
                },
            })
            .collect()
    };
    // What is right may predict no better while something else is wrong beside it.
    let first = &all[0];
    let is_worth = before.rms() - first.fitted.rms() > worth_um;
    if !first.reduction.2 && is_worth && first.score < score(problem, before) - TIE {
        for (partner, pair) in partners_of(problem, &first.fitted, candidates) {
            let left = folds.left_out(problem, &pair.model);
            let reduction = folds.reduction(&left_before, &left);
            if reduction.2 && rms(&left) < AS_WELL * least {
                let gain = gain(&left, reduction, &pair);
                let kinds = vec![first.hit.part.kind.clone(), partner];
                return (Some(((pair, kinds), tried(&all, Some(0)), gain)), Vec::new());
            }
        }
    }
    let as_well = |it: &Choice| it.reduction.2 && rms(&it.left) <= AS_WELL * least;
    let best = all.iter().filter(|it| as_well(it)).map(|it| it.score).fold(f64::INFINITY, f64::min);
    let taken = (0..all.len())
        .filter(|&index| as_well(&all[index]) && all[index].score < best + TIE)
        .min_by(|&a, &b| {
            let simple = |index: usize| (degrees(&all[index].fitted.model), tier(&all[index]));
            simple(a).cmp(&simple(b)).then(rms(&all[a].left).total_cmp(&rms(&all[b].left)))
        });
    let others = tried(&all, taken);
    let Some(taken) = taken else { return (None, others) };
    let it = all.swap_remove(taken);
    let gain = gain(&it.left, it.reduction, &it.fitted);
    (Some(((it.fitted, vec![it.hit.part.kind]), others, gain)), Vec::new())
}

/// The candidates that do most beside what `fitted` has, with the fits of both, the best first.
fn partners_of(
    problem: &Problem,
    fitted: &Fitted,
    candidates: &[Candidate],
) -> Vec<(Kind, Fitted)> {
    let most = candidates.iter().map(|candidate| candidate.kind.tier()).max().unwrap_or(0);
    let mut others = possible(problem, &fitted.model, &fitted.residual);
    others.retain(|candidate| candidate.kind.tier() <= most);
    let scanned = scan(problem, &fitted.model, &fitted.residual, &others, Draw::Not);
    let own = score(problem, fitted);
    let hits = fitted_hits(problem, &fitted.model, &fitted.residual, &scanned.hits, 4);
    let mut scored: Vec<(f64, Kind, Fitted)> = hits
        .into_iter()
        .map(|(hit, pair)| (score(problem, &pair), hit.part.kind, pair))
        .filter(|(score, ..)| *score < own - TIE)
        .collect();
    scored.sort_by(|a, b| a.0.total_cmp(&b.0));
    scored.into_iter().map(|(_, kind, pair)| (kind, pair)).collect()
}

/// Two causes may each be hidden by the other, so that neither alone is more than noise. Tries the
/// partners of the most likely candidates; a pair must be half as much again above the limit of what
/// noise lets one candidate reach, and must predict left-out blocks better.
pub(crate) fn pair_from_nothing(
    problem: &Problem,
    before: &Fitted,
    candidates: &[Candidate],
    hits: &[Hit],
    limit: f64,
) -> Option<(Fitted, Vec<Kind>, Gain)> {
    if problem.groups.len() > 3000 {
        return None;
    }
    let simple: Vec<Hit> = hits
        .iter()
        .filter(|hit| hit.part.kind.tier() <= 1 && hit.part.kind.amplitudes() <= 2)
        .cloned()
        .collect();
    let least = score(problem, before) - 1.5 * limit.max(0.0) - 2.0 * TIE;
    let mut best: Option<(f64, Fitted, Vec<Kind>)> = None;
    for (hit, fitted) in fitted_hits(problem, &before.model, &before.residual, &simple, 5) {
        for (partner, pair) in partners_of(problem, &fitted, candidates).into_iter().take(1) {
            let there = score(problem, &pair);
            if there < least && best.as_ref().is_none_or(|best| there < best.0) {
                best = Some((there, pair, vec![hit.part.kind.clone(), partner]));
            }
        }
    }
    let (_, pair, kinds) = best?;
    let (noise, _) = independent(problem, &pair.residual, degrees(&pair.model));
    let folds = Folds::new(problem, noise.memory);
    let (left_before, left) =
        (folds.left_out(problem, &before.model), folds.left_out(problem, &pair.model));
    let (reduction, ci95, gains) = folds.reduction(&left_before, &left);
    let gain = Gain {
        rms_before_um: before.rms(),
        rms_after_um: pair.rms(),
        left_out_before_um: rms(&left_before),
        left_out_after_um: rms(&left),
        reduction,
        ci95,
    };
    gains.then_some((pair, kinds, gain))
}
