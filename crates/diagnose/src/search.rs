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

use trueup_numerics::{
    noise::{self, Noise, Whitener},
    parallel::on_all_cores,
};

use crate::{
    blocks::Folds,
    candidates::{Candidate, possible, structure},
    choose::{choose, pair_from_nothing},
    data::Data,
    fit::{Fitted, Problem, fit},
    mend::{
        drop_what_does_not_gain, improve, lag_in_place_of_a_term, laws_for_a_table, look_ahead,
        rename_paths, simplest_of_equals, table_for_both_ways,
    },
    model::{Kind, Model, Part},
    scan::{Draw, Hit, scan},
    words,
};

/// Scores nearer than that are equal.
pub(crate) const TIE: f64 = 6.0;
/// Most terms of one diagnosis.
const MOST_TERMS: usize = 8;
/// Candidates that are fitted with everything else, of those that a scan puts first.
const FITTED: usize = 10;
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
pub(crate) fn fitted_hits(
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
    on_all_cores(&chosen, problem.is_large(), |&hit| {
        let mut start = with(model, hit);
        begin(problem, residual, &mut start, &hit.part.kind);
        let mut fitted = fit(problem, &start, None);
        if hit.part.kind == Kind::Step {
            fitted = refine_step(problem, fitted);
        }
        (hit.clone(), fitted)
    })
}

/// Amplitudes to begin from, where 0 leaves no derivative for the nonlinear values.
fn begin(problem: &Problem, residual: &[f64], model: &mut Model, kind: &Kind) {
    let nonlinear = kind.nonlinear().len();
    if nonlinear == 0 || kind.amplitudes() == 0 {
        return;
    }
    let Some(index) = model.parts.iter().position(|part| part.kind == *kind) else { return };
    let values = model.parts[index].values[..nonlinear].to_vec();
    let mut columns = problem.columns(kind, &values, false).to_vec();
    if model.constant_um.is_some() {
        columns.push(vec![1.0; problem.groups.len()]);
    }
    let found =
        trueup_numerics::least_squares::normal::solve(&columns, residual, None, 0.0).coefficients;
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
    let mut draw = Draw::Robust;
    for round in 0..=MOST_TERMS + 6 {
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
        let scanned = scan(problem, &fitted.model, &fitted.residual, &candidates, draw);
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
            // Two causes may together look like slow noise. Before all is called noise, a sharper look.
            if added.is_empty() && draw == Draw::Robust {
                draw = Draw::Sharp;
                stage = 0;
                refused.clear();
                last_tried.clear();
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
                        tried.kind.name(),
                        Folds::new(problem, 1.0).what
                    ));
                }
            }
            add_insignificant(&fitted, &not_taken, &mut rejected);
            break;
        };
        refused.clear();
        last_tried.clear();
        draw = Draw::Robust;
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
    table_for_both_ways(problem, &mut fitted, &mut added);
    laws_for_a_table(problem, &mut fitted, &mut added);
    drop_what_does_not_gain(problem, &mut fitted, &mut added);
    simplest_of_equals(problem, &mut fitted, &mut added);
    rename_paths(problem, &mut fitted, &mut added);
    // Structure that no cause explains.
    let curves = structure(problem);
    let scanned = scan(problem, &fitted.model, &fitted.residual, &curves, draw);
    let share = |hit: &Hit| (hit.explained * fitted.rms().powi(2)).sqrt();
    let counts = |hit: &&Hit| hit.is_significant && share(hit) > 2.0 * worth_um;
    for hit in scanned.hits.iter().filter(counts) {
        structure_left.push(format!("what is left goes with {}", words::structure(&hit.part.kind)));
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
        if into.iter().any(|tried| tried.kind.name() == hit.part.kind.name()) {
            continue;
        }
        let best = hits
            .iter()
            .filter(|there| there.part.kind.name() == hit.part.kind.name())
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
    let scanned = scan(problem, &reduced.model, &reduced.residual, &candidates, Draw::Not);
    let mut all: Vec<(Option<Kind>, Fitted)> =
        fitted_hits(problem, &reduced.model, &reduced.residual, &scanned.hits, most)
            .into_iter()
            .map(|(hit, fitted)| (Some(hit.part.kind), fitted))
            .collect();
    all.push((None, reduced));
    all
}

/// The curves that do most beside what `reduced` has, with the fits of both.
pub(crate) fn structure_in_place(
    problem: &Problem,
    curves: &[Candidate],
    reduced: &Fitted,
) -> Vec<(Kind, Fitted)> {
    let scanned = scan(problem, &reduced.model, &reduced.residual, curves, Draw::Not);
    fitted_hits(problem, &reduced.model, &reduced.residual, &scanned.hits, 2)
        .into_iter()
        .map(|(hit, fitted)| (hit.part.kind, fitted))
        .collect()
}

/// `fitted` with up to two curves that explain more than they cost: what is left then is left by
/// whatever law there is.
pub(crate) fn with_structure(problem: &Problem, curves: &[Candidate], fitted: &Fitted) -> Fitted {
    let mut best = fitted.clone();
    for _ in 0..2 {
        let own = score(problem, &best);
        let with = structure_in_place(problem, curves, &best)
            .into_iter()
            .map(|(_, with)| (score(problem, &with), with))
            .filter(|(score, _)| *score < own - TIE)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, with)) = with else { break };
        best = with;
    }
    best
}

/// The model to begin with: an axis's measurement has an arbitrary zero.
pub(crate) fn start(data: &Data) -> Model {
    Model { parts: Vec::<Part>::new(), constant_um: data.quantity.axis().map(|_| 0.0) }
}
