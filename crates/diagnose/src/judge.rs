//! What one term of the answer is worth: its rivals, whether its name is claimed, what it brings.
//!
//! A name is claimed where
//!
//! ```text
//! no other cause in its place scores within 6 (BIC)           else: the two cannot be told apart
//! whole records that were left out are foreseen as if fitted    else: not yet identified
//! to; or its time constant is known or short, what is left
//! out is foreseen, and a slow path was seen more than once
//! no curve in its place explains clearly more                 else: something goes with its inputs,
//!                                                             but by another law
//! it is still needed with a curve in the place of such a term else: it makes up for that term
//! ```
//!
//! A rival that can imitate the term and needs more values for it is no rival: it says the same and
//! more, and the search has found the rest of it to be noise. A curve (over a column, over a position
//! and growing with another one, over the way since a reversal) explains clearly more if its score is
//! better, the term explains less than nine tenths of the squares that it does (R² below 0.9), beside
//! it less than half of what the term explains is left to it, and it predicts left-out blocks better.
//!
//! Of causes that cannot be told apart a term is kept if all give the same correction, within the
//! error that remains anyway.

use serde_json::{Map, json};

use crate::{
    blocks::{Folds, rms},
    candidates::{Candidate, structure},
    choose::AS_WELL,
    columns::named,
    data::Data,
    diagnosis::errors,
    fit::{Fitted, Problem, fit},
    model::{Kind, Model, Scale},
    parameters::parameters,
    report::{Finding, Gain, Rival},
    search::{self, Added, Found, TIE, degrees, in_its_place, structure_in_place, with_structure},
    words,
};

/// What a law must explain of the squares that go with its inputs.
const EXPLAINS: f64 = 0.9;

/// A model that is identified leaves about as much where it was not fitted as where it was: twice as
/// much is four times the squares.
const FORESEES: f64 = 2.0;
/// What leaves at most a tenth more in whole records that it was not fitted to has been seen again
/// there, however wide the intervals of its constants are.
const FORESEEN: f64 = 1.1;

/// What was judged about one term.
pub(crate) struct Judged {
    pub finding: Finding,
    /// None for readings that were set aside.
    pub kind: Option<Kind>,
    /// Whether it goes into the extended machine file.
    pub is_kept: bool,
    /// What it goes with, where no cause explains it.
    pub other_law: Option<String>,
}

/// What is the same for all terms of a model.
pub(crate) struct Own {
    /// What it leaves in each group where that was left out, its RMS, and the fits without each fold.
    left_out: Vec<f64>,
    left_out_um: f64,
    folded: Vec<Model>,
}

impl Own {
    pub(crate) fn of(problem: &Problem, found: &Found) -> Self {
        let (left_out, folded) = found.folds.left_out_with_models(problem, &found.fitted.model);
        Self { left_out_um: rms(&left_out), left_out, folded }
    }
}

/// The model without a term, and each other cause that is no part of the same in its place.
fn rivals(
    problem: &Problem,
    found: &Found,
    own: &Own,
    kind: &Kind,
) -> (Option<Fitted>, Vec<(Rival, Fitted)>) {
    let mut all: Vec<(Rival, Kind, Fitted)> = Vec::new();
    let mut without = None;
    for (with, fitted) in in_its_place(problem, &found.fitted, kind, 8) {
        let Some(with) = with else {
            without = Some(fitted);
            continue;
        };
        if with.name() == kind.name() && with.column() == kind.column() {
            continue;
        }
        let mut gap = search::gap(problem, &found.fitted, &fitted);
        // What predicts left-out blocks clearly worse does not explain as well, whatever it fits.
        let left_out_um = || rms(&found.folds.left_out(problem, &fitted.model));
        if gap < TIE && left_out_um() > AS_WELL * own.left_out_um {
            gap = TIE;
        }
        let rival = Rival { cause: with.name().into(), column: with.column(), score_gap: gap };
        match all
            .iter_mut()
            .find(|(there, ..)| there.cause == rival.cause && there.column == rival.column)
        {
            Some(there) if there.0.score_gap > gap => *there = (rival, with, fitted),
            Some(_) => {}
            None => all.push((rival, with, fitted)),
        }
    }
    if let Some(without) = &without {
        all.retain(|(rival, _, fitted)| {
            rival.score_gap >= TIE || !imitates(problem, found, without, fitted)
        });
    }
    all.sort_by(|a, b| a.0.score_gap.total_cmp(&b.0.score_gap));
    all.truncate(6);
    (without, all.into_iter().map(|(rival, _, fitted)| (rival, fitted)).collect())
}

/// Whether `rival` needs more values and can do, but for a twentieth, what the term does that
/// `without` lacks.
fn imitates(problem: &Problem, found: &Found, without: &Fitted, rival: &Fitted) -> bool {
    if degrees(&rival.model) <= degrees(&found.fitted.model) {
        return false;
    }
    let own = problem.predicted(&found.fitted.model);
    let effect: Vec<f64> = own
        .iter()
        .zip(problem.predicted(&without.model))
        .map(|(with, without)| with - without)
        .collect();
    let problem = problem.measuring(own);
    // A time constant may have to go far.
    let mut quick = rival.model.clone();
    let [low, _] = problem.bounds.time_constant_s;
    for part in quick.parts.iter_mut().filter(|part| part.kind.has_time_constant()) {
        if !found.fitted.model.has(&part.kind) {
            part.values[0] = 2.0 * low;
        }
    }
    let is_near = |model: &Model| fit(&problem, model, None).rms() < 0.05 * rms(&effect);
    is_near(&rival.model) || quick != rival.model && is_near(&quick)
}

/// The curves that would be another law than this term's. One over what an instrument reads is only a
/// finer description of the instrument's own error.
fn other_curves(problem: &Problem, kind: &Kind) -> Vec<Candidate> {
    let mut curves = structure(problem);
    if let Kind::ReferenceInstrument { .. } = kind {
        let data = &problem.data;
        let reading = data.own_position().unwrap_or(&data.elongation);
        let is_reading = |name: &str| {
            named(data, name).is_some_and(|column| correlation(column, reading).abs() > 0.999)
        };
        curves.retain(|curve| match &curve.kind {
            Kind::Curve { column, times: None, .. } => !is_reading(column),
            _ => true,
        });
    }
    curves
}

/// The correlation of two columns, over the rows that both have.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let pairs: Vec<(f64, f64)> = a
        .iter()
        .zip(b)
        .filter(|(a, b)| a.is_finite() && b.is_finite())
        .map(|(a, b)| (*a, *b))
        .collect();
    let count = pairs.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / count;
    let (mean_a, mean_b) = (mean(|pair| pair.0), mean(|pair| pair.1));
    let [mut aa, mut bb, mut ab] = [0.0; 3];
    for (a, b) in pairs {
        aa += (a - mean_a).powi(2);
        bb += (b - mean_b).powi(2);
        ab += (a - mean_a) * (b - mean_b);
    }
    ab / (aa * bb).sqrt()
}

/// The curve that explains clearly more in the place of the term, for people.
fn other_law(
    problem: &Problem,
    found: &Found,
    own: &Own,
    kind: &Kind,
    curves: &[Candidate],
    without: &Fitted,
) -> Option<String> {
    let score = search::score(problem, &found.fitted);
    let explained = without.sum - found.fitted.sum;
    for (curve, in_place) in structure_in_place(problem, curves, without) {
        let is_better = search::score(problem, &in_place) < score - TIE;
        if !is_better || explained > EXPLAINS * (without.sum - in_place.sum) {
            continue;
        }
        let mut beside = in_place.model.clone();
        beside
            .parts
            .extend(found.fitted.model.parts.iter().filter(|part| part.kind == *kind).cloned());
        beside.constant_um = beside.constant_um.or(found.fitted.model.constant_um);
        beside.sort();
        let is_left = in_place.sum - fit(problem, &beside, None).sum < 0.5 * explained;
        let left_out_um = || rms(&found.folds.left_out(problem, &in_place.model));
        if is_left && left_out_um() < own.left_out_um {
            return Some(words::structure(&curve));
        }
    }
    None
}

pub(crate) fn judge(problem: &Problem, found: &Found, own: &Own, added: &Added) -> Option<Judged> {
    let data = &problem.data;
    let kind = &added.kind;
    let part = found.fitted.model.parts.iter().find(|part| part.kind == *kind)?;
    let (without, rivals) = rivals(problem, found, own, kind);
    let curves = other_curves(problem, kind);
    let left_out = own.left_out_um;
    let (parameters, is_known) = parameters(problem, &found.fitted, part, found.noise);
    // What acts late is known if the model foresees what it was not fitted to. A growth from the start
    // alone is excepted: without the start it cannot be.
    let foresees = left_out <= FORESEES * found.fitted.rms();
    let is_late = kind.has_time_constant() && *kind != Kind::SlowMode;
    let is_foreseen = found.folds.are_records() && left_out <= FORESEEN * found.fitted.rms();
    let is_determined = is_foreseen
        || is_known
            && is_steady(problem, kind, &own.folded)
            && (foresees || !is_late)
            && is_seen_again(data, kind);
    let other_law =
        without.as_ref().and_then(|without| other_law(problem, found, own, kind, &curves, without));
    // The same cause by another column is a question of where, not of what.
    let open: Vec<&(Rival, Fitted)> = rivals
        .iter()
        .filter(|(rival, _)| rival.cause != kind.name() && rival.score_gap < TIE)
        .collect();
    let here = found.fitted.model.predict(data);
    let left = found.fitted.rms();
    let alike = open.iter().all(|(_, rival)| {
        let there = rival.model.predict(data);
        let apart: Vec<f64> = (0..data.rows)
            .filter(|&row| data.used[row])
            .map(|row| here[row] - there[row])
            .filter(|apart| apart.is_finite())
            .collect();
        rms(&apart) < left
    });
    // Where a law without a name is left, it may be what the term stands for.
    let is_needed = found.structure.is_empty()
        || without.as_ref().is_none_or(|without| {
            let [with, in_place] = [&found.fitted, without]
                .map(|it| search::score(problem, &with_structure(problem, &curves, it)));
            in_place > with + TIE
        });
    let claimed = open.is_empty() && is_determined && other_law.is_none() && is_needed;
    let is_kept = open.is_empty() || alike;
    let gap = rivals
        .iter()
        .filter(|(rival, _)| rival.cause != kind.name())
        .map(|(rival, _)| rival.score_gap)
        .fold(f64::INFINITY, f64::min);
    let best_other = open.first().map(|(rival, _)| rival.cause.clone());
    let mut evidence = vec![words::sentence(part)];
    if let Some(without) = &without {
        evidence.push(format!(
            "Without it {:.3} µm RMS are left, with it {:.3} µm.",
            without.rms(),
            left
        ));
    }
    evidence.push(format!(
        "On left-out {} the error falls from {:.3} to {:.3} µm RMS.",
        found.folds.what, added.before.left_out_before_um, added.before.left_out_after_um
    ));
    if let Some(rival) = &best_other {
        evidence.push(format!("{rival} explains these data as well."));
    }
    if !is_determined {
        evidence.push(format!(
            "It is not yet identified by these data: fitted to all {left:.3} µm RMS are left, on \
             left-out {} {left_out:.3} µm.",
            found.folds.what
        ));
    }
    if let Some(law) = &other_law {
        evidence.push(format!(
            "Something that goes with {law} explains clearly more in its place: the cause is near \
             it, but another one."
        ));
    }
    if !is_needed {
        evidence
            .push("What has no name yet, and is still left, explains this part as well.".into());
    }
    let gain = final_gain(problem, found, own, without.as_ref(), added);
    let next_test = match &other_law {
        Some(law) => format!(
            "Measure again with nothing varied but what goes with {law}, in many small steps, up and \
             down."
        ),
        None => words::next_test(kind, best_other.as_deref()),
    };
    let confidence = 1.0 / (1.0 + (-0.5 * gap.min(40.0)).exp());
    let confidence = if other_law.is_some() { confidence.min(0.5) } else { confidence };
    let finding = Finding {
        cause: kind.name().into(),
        column: kind.column(),
        claimed,
        compensated: kind.is_compensated() && is_kept,
        confidence: (confidence * 1e4).round() / 1e4,
        parameters,
        gain,
        sentence: words::sentence(part),
        evidence,
        rivals: rivals.into_iter().map(|(rival, _)| rival).collect(),
        next_test,
    };
    Some(Judged { finding, kind: Some(kind.clone()), is_kept, other_law })
}

/// Takes back the claims that only hold beside a term which stands for another law: what makes up for
/// the difference between the two is no cause either. Each must still be needed with whatever law there
/// is in the place of those terms.
pub(crate) fn doubt_what_stands_beside_another_law(
    problem: &Problem,
    found: &Found,
    judged: &mut [Judged],
) {
    let is_doubtful = |kind: &Kind| {
        judged.iter().any(|it| it.other_law.is_some() && it.kind.as_ref() == Some(kind))
    };
    let mut sound = found.fitted.model.clone();
    sound.parts.retain(|part| !is_doubtful(&part.kind));
    if sound.parts.len() == found.fitted.model.parts.len() {
        return;
    }
    for it in judged.iter_mut().filter(|it| it.finding.claimed) {
        let Some(kind) = &it.kind else { continue };
        let curves = other_curves(problem, kind);
        let score = |model: &Model| {
            search::score(problem, &with_structure(problem, &curves, &fit(problem, model, None)))
        };
        let mut without = sound.clone();
        without.parts.retain(|part| part.kind != *kind);
        if score(&without) <= score(&sound) + TIE {
            it.finding.claimed = false;
            it.finding.confidence = it.finding.confidence.min(0.5);
            it.finding
                .evidence
                .push("It is only needed beside a term that stands for another law.".into());
        }
    }
}

/// Whether a slow path of a column was seen more than once: over one heating and one cooling, whatever
/// rises late and falls late is a path. The column must have turned three times by a tenth of its
/// range, in all records together.
fn is_seen_again(data: &Data, kind: &Kind) -> bool {
    let (Kind::SlowModeOf { column } | Kind::ExtraHeatPath { column, has_lag: true }) = kind else {
        return true;
    };
    let Some(values) = data.temperature(column) else { return true };
    let (low, high) = values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &c| (low.min(c), high.max(c)));
    let least = 0.1 * (high - low);
    let (mut ways, mut lowest, mut highest, mut is_rising) = (0, f64::NAN, f64::NAN, None);
    for (row, &c) in values.iter().enumerate() {
        if data.restart[row] {
            (lowest, highest, is_rising) = (c, c, None);
        }
        (lowest, highest) = (lowest.min(c), highest.max(c));
        if is_rising != Some(true) && c - lowest > least {
            (ways, highest, is_rising) = (ways + 1, c, Some(true));
        } else if is_rising != Some(false) && highest - c > least {
            (ways, lowest, is_rising) = (ways + 1, c, Some(false));
        }
    }
    ways >= 3
}

/// Whether a time constant is about the same whatever part of the record is left out: within a factor
/// of 2.5 from the least to the most, or short beside the record.
fn is_steady(problem: &Problem, kind: &Kind, folded: &[Model]) -> bool {
    if kind.nonlinear().first() != Some(&Scale::Logarithmic) || kind.tier() > 1 {
        return true;
    }
    let values = folded
        .iter()
        .filter_map(|model| model.parts.iter().find(|part| part.kind == *kind))
        .map(|part| part.values[0]);
    let (low, high) =
        values.fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
    high <= 2.5 * low || problem.is_short(high)
}

/// What the term brings in the final model, beside all others.
fn final_gain(
    problem: &Problem,
    found: &Found,
    own: &Own,
    without: Option<&Fitted>,
    added: &Added,
) -> Gain {
    let folds: &Folds = &found.folds;
    let Some(without) = without else {
        let gain = added.before;
        return Gain {
            rms_before_um: gain.rms_before_um,
            rms_after_um: gain.rms_after_um,
            left_out_before_um: gain.left_out_before_um,
            left_out_after_um: gain.left_out_after_um,
            reduction: gain.reduction,
            ci95: gain.ci95,
        };
    };
    let before = folds.left_out(problem, &without.model);
    let (reduction, ci95, _) = folds.reduction(&before, &own.left_out);
    Gain {
        rms_before_um: without.rms(),
        rms_after_um: found.fitted.rms(),
        left_out_before_um: rms(&before),
        left_out_after_um: own.left_out_um,
        reduction,
        ci95,
    }
}

/// The finding of rows that were set aside.
pub(crate) fn outlier_finding(data: &Data, after: &[f64], aside: &[bool], count: usize) -> Judged {
    let with = errors(data, after, None);
    let without = errors(data, after, Some(aside));
    let share = count as f64 / with.len() as f64;
    let mut parameters = Map::new();
    // Of so many rows that are or are not, by Wilson's interval.
    let (n, z) = (with.len() as f64, 1.96_f64);
    let center = (share + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (share * (1.0 - share) / n + z * z / (4.0 * n * n)).sqrt();
    parameters
        .insert("fraction".into(), json!({"value": share, "ci95": [center - half, center + half]}));
    let rows: Vec<String> = (0..data.rows)
        .filter(|&row| aside[row])
        .take(12)
        .map(|row| (row + 1).to_string())
        .collect();
    let (before, after) = (rms(&with), rms(&without));
    let sentence =
        format!("{count} readings are no readings: they stand alone, far from the rest.");
    let finding = Finding {
        cause: "outliers".into(),
        column: None,
        claimed: true,
        compensated: false,
        confidence: 0.999,
        parameters,
        gain: Gain {
            rms_before_um: before,
            rms_after_um: after,
            left_out_before_um: before,
            left_out_after_um: after,
            reduction: 1.0 - after / before,
            ci95: [0.0, 1.0 - after / before],
        },
        evidence: vec![sentence.clone(), format!("Rows {} were set aside.", rows.join(", "))],
        sentence,
        rivals: Vec::new(),
        next_test: "Look at what happened at these readings, and measure them again.".into(),
    };
    Judged { finding, kind: None, is_kept: true, other_law: None }
}
