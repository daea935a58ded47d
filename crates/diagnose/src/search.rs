//! The search: a term is added as long as one explains more than noise would, and predicts what it
//! has not seen.
//!
//! ```text
//! scan all causes ─► significant? ─► fit with all terms ─► score ─► gain on left-out blocks ─► add
//!        ▲                                                                               │
//!        └────────── is another cause better in a term's place? is it still needed? ◄────┘
//! ```
//!
//! The score is the Bayesian information criterion, −2 ln(likelihood) + k·ln n, with the memory of the
//! noise estimated for each model from what it leaves. Scores that are less than [`TIE`] apart are
//! equal; then the simpler cause wins, among those the one that predicts left-out blocks better, and
//! the machine's own model and sensors come before others.

use crate::{
    blocks::{Folds, rms},
    candidates::{Candidate, possible, structure},
    data::Data,
    fit::{Fitted, Problem, fit},
    model::{Kind, Model, Part},
    noise::{self, Noise, Whitener},
    scan::{Hit, scan},
};

/// Scores nearer than that are equal.
pub(crate) const TIE: f64 = 6.0;
/// Most terms of one diagnosis.
const MOST_TERMS: usize = 8;
/// Candidates that are fitted with everything else, of those that a scan puts first.
const FITTED: usize = 10;
/// Those of them that are tried on left-out blocks.
const MOST_LEFT_OUT: usize = 8;
/// What takes away less of what the machine file gets wrong is not worth a term, nor a complaint.
const WORTH: f64 = 0.01;

/// What was tried in a place, and what it came to.
#[derive(Clone, Debug)]
pub(crate) struct Tried {
    pub kind: Kind,
    pub rms_um: f64,
    /// 0 where it was not worked out.
    pub left_out_um: f64,
    /// Empty: taken.
    pub why_not: String,
}

/// A term that was added, with what it brought.
#[derive(Clone, Debug)]
pub(crate) struct Added {
    pub kind: Kind,
    pub before: Gain,
    pub tried: Vec<Tried>,
}

/// What a term brought when it was added.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Gain {
    pub rms_before_um: f64,
    pub rms_after_um: f64,
    pub left_out_before_um: f64,
    pub left_out_after_um: f64,
    pub reduction: f64,
    pub ci95: [f64; 2],
}

/// The outcome.
pub(crate) struct Found {
    pub fitted: Fitted,
    /// In the order in which they were added.
    pub added: Vec<Added>,
    /// What was tried at the end and not taken.
    pub rejected: Vec<Tried>,
    /// Tests of structure that fire on what is left: a sentence each.
    pub structure: Vec<String>,
    pub noise: Noise,
    pub folds: Folds,
}

/// Independent rows of a residual, and its noise.
pub(crate) fn independent(problem: &Problem, residual: &[f64], degrees: usize) -> (Noise, f64) {
    let longest =
        noise::longest_memory(problem.groups.rows() as usize) / problem.groups.size as f64;
    let noise = noise::estimate(residual, &problem.groups.steps, longest.max(1.0), degrees);
    (noise, noise::effective_rows(noise, &problem.groups.steps).max(3.0))
}

/// What a model counts for where simplicity counts.
pub(crate) fn degrees(model: &Model) -> usize {
    let parts: usize = model.parts.iter().map(|part| part.kind.degrees()).sum();
    parts + usize::from(model.constant_um.is_some())
}

pub(crate) fn score(problem: &Problem, fitted: &Fitted) -> f64 {
    let steps = &problem.groups.steps;
    let rows = fitted.residual.len() as f64;
    let degrees = degrees(&fitted.model);
    let (noise, _) = independent(problem, &fitted.residual, 0);
    let memory = if noise == Noise::WHITE { 0.0 } else { 2.0 };
    noise::deviance(&Whitener::new(noise, steps), &fitted.residual)
        + (degrees as f64 + memory) * rows.ln()
}

/// How much worse the score of `other` is than that of `own`: by the likelihood, or by the squares
/// over the independent rows, whichever tells them better apart. The likelihood is right where the
/// noise is as it is modelled; where a model is not quite right its quick part weighs too much.
pub(crate) fn gap(problem: &Problem, own: &Fitted, other: &Fitted) -> f64 {
    let (_, m) = independent(problem, &own.residual, degrees(&own.model));
    let by_squares = |fitted: &Fitted| {
        m * fitted.sum.max(f64::MIN_POSITIVE).ln() + degrees(&fitted.model) as f64 * m.ln()
    };
    let likely = score(problem, other) - score(problem, own);
    likely.max(by_squares(other) - by_squares(own))
}

fn with(model: &Model, hit: &Hit) -> Model {
    let mut with = model.clone();
    with.parts.push(hit.part.clone());
    if hit.with_constant {
        with.constant_um = Some(0.0);
    }
    if with.constant_um.is_some() {
        // A zero of its own is in the constant now.
        with.parts.retain(|part| part.kind != Kind::SensorOffset);
    }
    with.sort();
    with
}

/// The candidates that a scan puts first, fitted with everything else. All where there is no need
/// to be significant.
fn fitted_hits(
    problem: &Problem,
    model: &Model,
    residual: &[f64],
    hits: &[Hit],
    most: usize,
) -> Vec<(Hit, Fitted)> {
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
    chosen
        .into_iter()
        .map(|hit| {
            let mut start = with(model, hit);
            begin(problem, residual, &mut start, &hit.part.kind);
            let mut fitted = fit(problem, &start, None);
            if hit.part.kind == Kind::Step {
                fitted = refine_step(problem, fitted);
            }
            (hit.clone(), fitted)
        })
        .collect()
}

/// Amplitudes to begin from, where 0 leaves no derivative for the nonlinear values.
fn begin(problem: &Problem, residual: &[f64], model: &mut Model, kind: &Kind) {
    let nonlinear = kind.nonlinear().len();
    if nonlinear == 0 || kind.amplitudes() == 0 {
        return;
    }
    let Some(index) = model.parts.iter().position(|part| part.kind == *kind) else { return };
    let values = model.parts[index].values[..nonlinear].to_vec();
    let mut columns = problem.columns(kind, &values, false);
    if model.constant_um.is_some() {
        columns.push(vec![1.0; problem.groups.len()]);
    }
    let found = crate::linear::solve(&columns, residual, None, 0.0).coefficients;
    for (number, amplitude) in found.iter().take(kind.amplitudes()).enumerate() {
        model.parts[index].values[nonlinear + number] = *amplitude;
    }
}

/// The time of a step by trying every group around.
fn refine_step(problem: &Problem, fitted: Fitted) -> Fitted {
    let Some(index) = fitted.model.parts.iter().position(|part| part.kind == Kind::Step) else {
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

/// The search on `problem`, from the model as it is. `progress` hears what is being tried, and how
/// far the search has come (0…1).
pub(crate) fn search(
    problem: &Problem,
    start: Model,
    progress: &mut dyn FnMut(&str, f64),
) -> Found {
    let mut fitted = fit(problem, &start, None);
    let worth_um = WORTH * fitted.rms();
    let mut added: Vec<Added> = Vec::new();
    let mut rejected: Vec<Tried> = Vec::new();
    let mut structure_left = Vec::new();
    let mut looked_ahead = false;
    let mut refused: Vec<Kind> = Vec::new();
    let mut last_tried: Vec<Tried> = Vec::new();
    let mut stage = 0;
    let mut leaned: Vec<Kind> = Vec::new();
    for round in 0..=MOST_TERMS + 3 {
        progress("looking for a cause", (round as f64 / MOST_TERMS as f64).min(0.9));
        let mut candidates = possible(problem, &fitted.model, &fitted.residual);
        // What was refused beside this model is not tried beside it again.
        candidates.retain(|candidate| !refused.contains(&candidate.kind));
        // First what the machine's own model may have wrong, then what else was recorded and acts at
        // once, then time alone and what acts late.
        let is_late = |kind: &Kind| matches!(kind, Kind::ExtraHeatPath { has_lag: true, .. });
        candidates.retain(|candidate| match stage {
            0 => candidate.kind.tier() == 0,
            1 => candidate.kind.tier() <= 1 && !is_late(&candidate.kind),
            _ => true,
        });
        let scanned = scan(problem, &fitted.model, &fitted.residual, &candidates, true);
        let hits: Vec<Hit> =
            scanned.hits.iter().filter(|hit| is_let_in(hit, &leaned)).cloned().collect();
        let options = fitted_hits(problem, &fitted.model, &fitted.residual, &hits, FITTED);
        let chosen = choose(problem, &fitted, options, &candidates, worth_um, progress);
        let Some((taken, tried, gain)) = chosen.0 else {
            let pair = (stage == 2 && added.is_empty()).then(|| {
                let limit = scanned.limits.map_or(0.0, |limits| limits[0]);
                pair_from_nothing(problem, &fitted, &candidates, &scanned.hits, limit)
            });
            if let Some(Some((pair, kinds, gain))) = pair {
                fitted = pair;
                for kind in kinds {
                    added.push(Added { kind, before: gain, tried: Vec::new() });
                }
                refused.clear();
                last_tried.clear();
                stage = 0;
                continue;
            }
            refused.extend(chosen.1.iter().map(|tried| tried.kind.clone()));
            last_tried.extend(chosen.1);
            if stage < 2 {
                stage += 1;
                continue;
            }
            // Two terms ahead is many fits: only where each is quick.
            let work = problem.groups.len() * degrees(&fitted.model);
            if !looked_ahead && !added.is_empty() && work < 40_000 {
                looked_ahead = true;
                progress("looking two terms ahead", f64::NAN);
                if look_ahead(problem, &mut fitted, &mut added) {
                    improve(problem, &mut fitted, &mut added);
                    continue;
                }
            }
            rejected = std::mem::take(&mut last_tried);
            for added in &added {
                for tried in &added.tried {
                    let is_in = added.kind == tried.kind || fitted.model.has(&tried.kind);
                    if !is_in && !rejected.iter().any(|there| there.kind == tried.kind) {
                        rejected.push(tried.clone());
                    }
                }
            }
            let not_taken: Vec<Hit> = scanned.hits;
            for tried in &rejected {
                if tried.why_not.starts_with("no gain") && fitted.rms() - tried.rms_um > worth_um {
                    structure_left.push(format!(
                        "{} is more than noise, but has no gain on left-out {}",
                        name(&tried.kind),
                        Folds::new(problem, 1.0).what
                    ));
                }
            }
            add_insignificant(&fitted, &not_taken, &mut rejected);
            break;
        };
        refused.clear();
        last_tried.clear();
        fitted = taken.0;
        added.retain(|there| fitted.model.has(&there.kind));
        leaned.retain(|kind| fitted.model.has(kind));
        for kind in taken.1 {
            let is_likely = hits.iter().any(|hit| hit.part.kind == kind && hit.is_likely);
            if kind.tier() > 0 && !is_likely && hits.iter().any(|hit| hit.part.kind == kind) {
                leaned.push(kind.clone());
            }
            added.push(Added { kind, before: gain, tried: tried.clone() });
        }
        if added.len() >= MOST_TERMS {
            break;
        }
        if !added.is_empty() {
            progress("comparing with rivals", ((round as f64 + 0.7) / MOST_TERMS as f64).min(0.9));
            improve(problem, &mut fitted, &mut added);
        }
    }
    lag_in_place_of_a_term(problem, &mut fitted, &mut added);
    drop_what_does_not_gain(problem, &mut fitted, &mut added);
    rename_paths(problem, &mut fitted, &mut added);
    // Structure that no cause explains.
    let curves = structure(problem);
    let scanned = scan(problem, &fitted.model, &fitted.residual, &curves, true);
    let share = |hit: &Hit| (hit.explained * fitted.rms().powi(2)).sqrt();
    let counts = |hit: &&Hit| hit.is_significant && share(hit) > 2.0 * worth_um;
    for hit in scanned.hits.iter().filter(counts) {
        if let Kind::Curve { column, by_direction, .. } = &hit.part.kind {
            let ways = if *by_direction { ", differently in each direction" } else { "" };
            structure_left.push(format!("what is left goes with {column}{ways}"));
        }
    }
    let (noise, _) = independent(problem, &fitted.residual, degrees(&fitted.model));
    let folds = Folds::new(problem, noise.memory);
    Found { fitted, added, rejected, structure: structure_left, noise, folds }
}

/// Whether a hit may be taken. One slow misfit may be explained that the likelihood would leave to
/// the noise (only U sees it); with that the few independent rows that it rests on are used up, and
/// a second one would follow the wander of the first one's remainder.
fn is_let_in(hit: &Hit, leaned: &[Kind]) -> bool {
    hit.is_likely || hit.is_significant && (leaned.is_empty() || hit.part.kind.tier() == 0)
}

/// What was not even significant is in the report with its numbers.
fn add_insignificant(fitted: &Fitted, hits: &[Hit], into: &mut Vec<Tried>) {
    for hit in hits {
        if into.iter().any(|tried| name(&tried.kind) == name(&hit.part.kind)) {
            continue;
        }
        let best = hits
            .iter()
            .filter(|there| name(&there.part.kind) == name(&hit.part.kind))
            .max_by(|a, b| a.by_likelihood.total_cmp(&b.by_likelihood))
            .unwrap_or(hit);
        into.push(Tried {
            kind: best.part.kind.clone(),
            rms_um: fitted.rms(),
            left_out_um: 0.0,
            why_not: "not more than noise would show".into(),
        });
    }
}

/// The model that is taken, with the causes that are new in it; what was tried; the gain.
type Chosen = (Option<((Fitted, Vec<Kind>), Vec<Tried>, Gain)>, Vec<Tried>);

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
fn choose(
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
            progress(name(&hit.part.kind), f64::NAN);
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
    let scanned = scan(problem, &fitted.model, &fitted.residual, &others, false);
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
fn pair_from_nothing(
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

/// Tries, for each term, whether it is still needed, and whether another cause does better in its
/// place now that others are there.
fn improve(problem: &Problem, fitted: &mut Fitted, added: &mut Vec<Added>) {
    for _ in 0..2 {
        let mut changed = false;
        for index in (0..added.len()).rev() {
            let kind = added[index].kind.clone();
            if !fitted.model.has(&kind) {
                continue;
            }
            let others = in_its_place(problem, fitted, &kind, 6);
            let own = score(problem, fitted);
            let best = others
                .into_iter()
                .map(|(with, other)| (score(problem, &other), with, other))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((there, with, other)) = best
                && (with.is_none() && there <= own && is_not_missed(problem, fitted, &other)
                    || there < own - margin(fitted, &other, &kind, with.as_ref())
                        && predicts_better(problem, fitted, &other, &kind, with.as_ref()))
            {
                *fitted = other;
                match with {
                    Some(with) => added[index].kind = with,
                    None => {
                        added.remove(index);
                    }
                }
                changed = true;
            }
        }
        if !changed {
            break;
        }
    }
    rename_paths(problem, fitted, added);
}

/// A path without a lag may need another term to mend what its lag would do. Tries the lag, with each
/// other term left out in turn.
fn lag_in_place_of_a_term(problem: &Problem, fitted: &mut Fitted, added: &mut Vec<Added>) {
    if problem.data.time_s.is_none() {
        return;
    }
    let plain = |kind: &Kind| matches!(kind, Kind::ExtraHeatPath { has_lag: false, .. });
    for index in 0..added.len() {
        let kind = added[index].kind.clone();
        let Kind::ExtraHeatPath { column, .. } = &kind else { continue };
        if !plain(&kind) || !fitted.model.has(&kind) {
            continue;
        }
        let late = Kind::ExtraHeatPath { column: column.clone(), has_lag: true };
        let [low, high] = problem.bounds.time_constant_s;
        let mut best: Option<(f64, Kind, Fitted)> = None;
        for other in added.iter().map(|it| &it.kind).filter(|other| **other != kind) {
            for tau in [3.0 * low, (low * high).sqrt()] {
                let mut model = fitted.model.clone();
                model.parts.retain(|part| part.kind != *other);
                for part in model.parts.iter_mut().filter(|part| part.kind == kind) {
                    part.kind = late.clone();
                    part.values.insert(0, tau);
                }
                let with = fit(problem, &model, None);
                let score = score(problem, &with);
                if best.as_ref().is_none_or(|best| score < best.0) {
                    best = Some((score, other.clone(), with));
                }
            }
        }
        if let Some((there, other, with)) = best
            && there < score(problem, fitted)
            && predicts_better(problem, fitted, &with, &kind, Some(&late))
        {
            *fitted = with;
            added[index].kind = late;
            added.retain(|it| it.kind != other);
            return;
        }
    }
}

/// No gain, no term: what predicts left-out blocks no better in the end leaves again.
fn drop_what_does_not_gain(problem: &Problem, fitted: &mut Fitted, added: &mut Vec<Added>) {
    for index in (0..added.len()).rev() {
        let (noise, _) = independent(problem, &fitted.residual, 0);
        let folds = Folds::new(problem, noise.memory);
        let mut model = fitted.model.clone();
        model.parts.retain(|part| part.kind != added[index].kind);
        if problem.data.quantity.axis().is_none()
            && !model.parts.iter().any(|part| part.kind.has_reference())
        {
            model.constant_um = None;
        }
        let without = fit(problem, &model, None);
        let before = rms(&folds.left_out(problem, &without.model));
        if rms(&folds.left_out(problem, &fitted.model)) >= before {
            *fitted = without;
            added.remove(index);
        }
    }
}

/// By how much the score of another cause in a term's place must be better: what needs more values
/// must be much better, but for a lag on the same column; what needs fewer only as good.
fn margin(fitted: &Fitted, other: &Fitted, kind: &Kind, with: Option<&Kind>) -> f64 {
    let is_more = degrees(&other.model) > degrees(&fitted.model);
    let column = |kind: &Kind| match kind {
        Kind::ExtraHeatPath { column, .. } => Some(column.clone()),
        _ => None,
    };
    let is_same = column(kind).is_some() && with.and_then(column) == column(kind);
    if is_more && !is_same {
        3.0 * TIE
    } else if degrees(&other.model) < degrees(&fitted.model) {
        0.0
    } else {
        TIE
    }
}

/// A slow path of a column that the model does not go by otherwise is a path, not a second one.
fn rename_paths(problem: &Problem, fitted: &mut Fitted, added: &mut [Added]) {
    let used = crate::candidates::columns_in_use(&problem.data, &fitted.model);
    for part in &mut fitted.model.parts {
        if let Kind::SlowModeOf { column } = &part.kind
            && !used.contains(column)
        {
            let path = Kind::ExtraHeatPath { column: column.clone(), has_lag: true };
            for there in added.iter_mut().filter(|there| there.kind == part.kind) {
                there.kind = path.clone();
            }
            part.kind = path;
        }
    }
}

/// Whether `other`, which has a term less, predicts blocks that were left out as well.
fn is_not_missed(problem: &Problem, fitted: &Fitted, other: &Fitted) -> bool {
    let (noise, _) = independent(problem, &fitted.residual, 0);
    let folds = Folds::new(problem, noise.memory);
    rms(&folds.left_out(problem, &other.model))
        <= 1.01 * rms(&folds.left_out(problem, &fitted.model))
}

/// Whether `other`, with `with` in the place of `kind`, leaves less on blocks that were left out:
/// clearly less, where what the model has already gives way to something that it has not.
fn predicts_better(
    problem: &Problem,
    fitted: &Fitted,
    other: &Fitted,
    kind: &Kind,
    with: Option<&Kind>,
) -> bool {
    let (noise, _) = independent(problem, &fitted.residual, 0);
    let folds = Folds::new(problem, noise.memory);
    let is_farther = with.is_some_and(|with| with.tier() > kind.tier());
    let least = if degrees(&other.model) < degrees(&fitted.model) {
        1.01
    } else if is_farther {
        0.9
    } else {
        1.0
    };
    rms(&folds.left_out(problem, &other.model))
        < least * rms(&folds.left_out(problem, &fitted.model))
}

/// Two terms may do together what the one that is there does nearly as well alone. Tries, in the
/// place of each term, each good rival together with the best that can then be added.
fn look_ahead(problem: &Problem, fitted: &mut Fitted, added: &mut Vec<Added>) -> bool {
    let own = score(problem, fitted);
    let folds = Folds::new(problem, independent(problem, &fitted.residual, 0).0.memory);
    let left = rms(&folds.left_out(problem, &fitted.model));
    let mut best: Option<(f64, usize, Kind, Kind, Fitted)> = None;
    for (index, there) in added.iter().enumerate() {
        for (with, rival) in in_its_place(problem, fitted, &there.kind, 4) {
            // Two of what is farther away are no better than one of what is near.
            let Some(with) = with.filter(|with| with.tier() <= there.kind.tier()) else {
                continue;
            };
            let candidates = possible(problem, &rival.model, &rival.residual);
            let scanned = scan(problem, &rival.model, &rival.residual, &candidates, false);
            let pairs = fitted_hits(problem, &rival.model, &rival.residual, &scanned.hits, 3);
            for (hit, pair) in pairs {
                if hit.part.kind.tier() > there.kind.tier() {
                    continue;
                }
                let score = score(problem, &pair);
                if score < own - TIE && best.as_ref().is_none_or(|best| score < best.0) {
                    best = Some((score, index, with.clone(), hit.part.kind, pair));
                }
            }
        }
    }
    let Some((_, index, first, second, pair)) = best else { return false };
    let after = rms(&folds.left_out(problem, &pair.model));
    if after >= left {
        return false;
    }
    *fitted = pair;
    let gain = Gain { left_out_before_um: left, left_out_after_um: after, ..added[index].before };
    added[index].kind = first;
    added.push(Added { kind: second, before: gain, tried: Vec::new() });
    true
}

/// The model without `kind` (none), and with each other cause in its place.
pub(crate) fn in_its_place(
    problem: &Problem,
    fitted: &Fitted,
    kind: &Kind,
    most: usize,
) -> Vec<(Option<Kind>, Fitted)> {
    let mut without = fitted.model.clone();
    without.parts.retain(|part| part.kind != *kind);
    // A constant that only came with a reference goes with it.
    let needs_zero = problem.data.quantity.axis().is_some()
        || without.parts.iter().any(|part| part.kind.has_reference());
    if !needs_zero {
        without.constant_um = None;
    }
    let reduced = fit(problem, &without, None);
    let candidates: Vec<Candidate> = possible(problem, &reduced.model, &reduced.residual)
        .into_iter()
        .filter(|candidate| candidate.kind != *kind)
        .collect();
    let scanned = scan(problem, &reduced.model, &reduced.residual, &candidates, false);
    let mut all: Vec<(Option<Kind>, Fitted)> =
        fitted_hits(problem, &reduced.model, &reduced.residual, &scanned.hits, most)
            .into_iter()
            .map(|(hit, fitted)| (Some(hit.part.kind), fitted))
            .collect();
    all.push((None, reduced));
    all
}

/// The name of a cause.
pub(crate) fn name(kind: &Kind) -> &'static str {
    match kind {
        Kind::SensorOffset => "sensor-offset",
        Kind::SensorGain => "sensor-gain",
        Kind::SensorCurvature => "sensor-curvature",
        Kind::SensorSaturation => "sensor-saturation",
        Kind::SensorTemperatureDrift { .. } => "sensor-temperature-drift",
        Kind::TimeShift => "time-shift",
        Kind::ThermalLag => "thermal-lag",
        Kind::SlowMode | Kind::SlowModeOf { .. } => "slow-mode",
        Kind::ExtraHeatPath { .. } => "extra-heat-path",
        Kind::GrowthAmplitude => "growth-amplitude",
        Kind::GrowthRate => "growth-rate",
        Kind::CoolingAsymmetry => "cooling-asymmetry",
        Kind::ExpansionSlope => "expansion-slope",
        Kind::ReferenceTemperature => "reference-temperature",
        Kind::CentrifugalGrowth => "centrifugal-growth",
        Kind::CuttingLoad => "cutting-load",
        Kind::PitchScale => "pitch-scale",
        Kind::PitchError { .. } => "pitch-error",
        Kind::PitchPeriodic { .. } => "pitch-periodic",
        Kind::Backlash => "backlash",
        Kind::PositionDependentBacklash => "position-dependent-backlash",
        Kind::Straightness { .. } => "straightness",
        Kind::CrossAxis { .. } => "cross-axis",
        Kind::Step => "step",
        Kind::Drift => "drift",
        Kind::ReferenceInstrument { .. } => "reference-instrument",
        Kind::Curve { .. } => "structure",
    }
}

/// The model to begin with: an axis's measurement has an arbitrary zero.
pub(crate) fn start(data: &Data) -> Model {
    Model { parts: Vec::<Part>::new(), constant_um: data.quantity.axis().map(|_| 0.0) }
}
