//! What is looked at again once other terms are there: whether a term is still needed, whether another
//! cause, or a simpler one, or two of them do better in its place.

use trueup_numerics::parallel::on_all_cores;

use crate::{
    blocks::{Folds, rms},
    candidates::possible,
    choose::AS_WELL,
    fit::{Fitted, Problem, fit},
    model::{Kind, Part},
    scan::{Draw, scan},
    search::{Added, Gain, TIE, degrees, fitted_hits, gap, in_its_place, independent, score},
    waves,
};

/// Tries, for each term, whether it is still needed, and whether another cause does better in its
/// place now that others are there.
pub(crate) fn improve(problem: &Problem, fitted: &mut Fitted, added: &mut Vec<Added>) {
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
pub(crate) fn lag_in_place_of_a_term(
    problem: &Problem,
    fitted: &mut Fitted,
    added: &mut Vec<Added>,
) {
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
        // As in the choice of a term, what predicts clearly better comes before the score.
        let folds = Folds::new(problem, independent(problem, &fitted.residual, 0).0.memory);
        let left_out = |fitted: &Fitted| rms(&folds.left_out(problem, &fitted.model));
        if let Some((there, other, with)) = best
            && (there < score(problem, fitted)
                && predicts_better(problem, fitted, &with, &kind, Some(&late))
                || AS_WELL * left_out(&with) < left_out(fitted))
        {
            *fitted = with;
            added[index].kind = late;
            added.retain(|it| it.kind != other);
            return;
        }
    }
}

/// A table for one way beside what goes with the direction may stand for one table each way. Tries
/// that in the place of all of them.
pub(crate) fn table_for_both_ways(problem: &Problem, fitted: &mut Fitted, added: &mut Vec<Added>) {
    let is_part = |kind: &Kind| {
        matches!(
            kind,
            Kind::PitchError { both_ways: false, .. }
                | Kind::Backlash
                | Kind::PositionDependentBacklash
        )
    };
    let table = fitted.model.parts.iter().find_map(|part| match part.kind {
        Kind::PitchError { start_mm, step_mm, points, both_ways: false } => {
            Some(Kind::PitchError { start_mm, step_mm, points, both_ways: true })
        }
        _ => None,
    });
    let Some(table) = table else { return };
    let mut model = fitted.model.clone();
    model.parts.retain(|part| !is_part(&part.kind));
    if model.parts.len() + 1 >= fitted.model.parts.len() {
        return;
    }
    model.parts.push(Part { values: vec![0.0; table.degrees()], kind: table.clone() });
    model.sort();
    let with = fit(problem, &model, None);
    let (noise, _) = independent(problem, &with.residual, 0);
    let folds = Folds::new(problem, noise.memory);
    let left_out = |fitted: &Fitted| rms(&folds.left_out(problem, &fitted.model));
    let (there, own) = (left_out(&with), left_out(fitted));
    if score(problem, &with) < score(problem, fitted) && there < own || AS_WELL * there < own {
        *fitted = with;
        let first = added.iter().position(|it| is_part(&it.kind)).unwrap_or(0);
        added[first].kind = table;
        added.retain(|it| !is_part(&it.kind));
    }
}

/// A table has room for a scale, a backlash and a wave. Where these alone say as much as it does, they
/// are the simpler names.
pub(crate) fn laws_for_a_table(problem: &Problem, fitted: &mut Fitted, added: &mut Vec<Added>) {
    let place = fitted.model.parts.iter().position(|part| {
        matches!(part.kind, Kind::PitchError { .. }) && added.iter().any(|it| it.kind == part.kind)
    });
    let Some(place) = place else { return };
    let table = fitted.model.parts[place].kind.clone();
    let has_ways = matches!(table, Kind::PitchError { both_ways: true, .. });
    let laws = [Kind::PitchScale, Kind::Backlash, Kind::PositionDependentBacklash];
    let mut best: Option<(f64, Vec<Kind>, Fitted)> = None;
    let mut note = |new: Vec<Kind>, with: Fitted| {
        let there = score(problem, &with);
        if best.as_ref().is_none_or(|best| there < best.0) {
            best = Some((there, new, with));
        }
    };
    for count in if has_ways { 2..=3 } else { 1..=1 } {
        let mut model = fitted.model.clone();
        model.parts.remove(place);
        let new: Vec<Kind> = laws[..count].iter().filter(|law| !model.has(law)).cloned().collect();
        model.parts.extend(new.iter().map(|law| Part { kind: law.clone(), values: vec![0.0] }));
        model.sort();
        let with = fit(problem, &model, None);
        // Waves that were found beside the table may be what it could not follow of another.
        let mut plain = with.model.clone();
        plain.parts.retain(|part| !matches!(part.kind, Kind::PitchPeriodic { .. }));
        let plain = fit(problem, &plain, None);
        let mut waves = waves::candidates(problem, &plain.model, &plain.residual);
        waves.retain(|candidate| matches!(candidate.kind, Kind::PitchPeriodic { .. }));
        let scanned = scan(problem, &plain.model, &plain.residual, &waves, Draw::Not);
        for (hit, with) in
            fitted_hits(problem, &plain.model, &plain.residual, &scanned.hits, waves.len())
        {
            note([&new[..], &[hit.part.kind]].concat(), with);
        }
        note(new, with);
    }
    let Some((there, new, with)) = best else { return };
    let folds = Folds::new(problem, independent(problem, &with.residual, 0).0.memory);
    let left_out = |fitted: &Fitted| rms(&folds.left_out(problem, &fitted.model));
    if there < score(problem, fitted) && left_out(&with) <= AS_WELL * left_out(fitted) {
        *fitted = with;
        let Some(index) = added.iter().position(|it| it.kind == table) else { return };
        let old = added.remove(index);
        for kind in new.into_iter().rev() {
            added.insert(index, Added { kind, before: old.before, tried: old.tried.clone() });
        }
        // A wave that gave way to another, or came back as it was.
        let mut seen: Vec<Kind> = Vec::new();
        added.retain(|it| {
            let is_new = fitted.model.has(&it.kind) && !seen.contains(&it.kind);
            seen.push(it.kind.clone());
            is_new
        });
    }
}

/// No gain, no term: what predicts left-out blocks no better in the end leaves again.
pub(crate) fn drop_what_does_not_gain(
    problem: &Problem,
    fitted: &mut Fitted,
    added: &mut Vec<Added>,
) {
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

/// Of causes that explain as well the one that needs the fewest values gives the name.
pub(crate) fn simplest_of_equals(problem: &Problem, fitted: &mut Fitted, added: &mut [Added]) {
    for there in added {
        let (noise, _) = independent(problem, &fitted.residual, 0);
        let folds = Folds::new(problem, noise.memory);
        let simpler = in_its_place(problem, fitted, &there.kind, 6)
            .into_iter()
            .filter_map(|(with, other)| Some((with?, other)))
            .filter(|(_, other)| degrees(&other.model) < degrees(&fitted.model))
            .map(|(with, other)| (gap(problem, fitted, &other), with, other))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((gap, with, other)) = simpler
            && gap < TIE
            && rms(&folds.left_out(problem, &other.model))
                <= AS_WELL * rms(&folds.left_out(problem, &fitted.model))
        {
            *fitted = other;
            there.kind = with;
        }
    }
}

/// A slow path of a column that the model does not go by otherwise is a path, not a second one.
pub(crate) fn rename_paths(problem: &Problem, fitted: &mut Fitted, added: &mut [Added]) {
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
pub(crate) fn look_ahead(problem: &Problem, fitted: &mut Fitted, added: &mut Vec<Added>) -> bool {
    let own = score(problem, fitted);
    let folds = Folds::new(problem, independent(problem, &fitted.residual, 0).0.memory);
    let left = rms(&folds.left_out(problem, &fitted.model));
    let terms: Vec<usize> = (0..added.len()).collect();
    let of = |&index: &usize| -> Option<(f64, usize, Kind, Kind, Fitted)> {
        let there = &added[index];
        let mut best: Option<(f64, usize, Kind, Kind, Fitted)> = None;
        for (with, rival) in in_its_place(problem, fitted, &there.kind, 4) {
            // Two of what is farther away are no better than one of what is near.
            let Some(with) = with.filter(|with| with.tier() <= there.kind.tier()) else {
                continue;
            };
            let candidates = possible(problem, &rival.model, &rival.residual);
            let scanned = scan(problem, &rival.model, &rival.residual, &candidates, Draw::Not);
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
        best
    };
    let best = on_all_cores(&terms, problem.is_large(), of)
        .into_iter()
        .flatten()
        .min_by(|a, b| a.0.total_cmp(&b.0));
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
