//! From the search to the answer: intervals, rivals, the gain on data that nothing was fitted to, and
//! the verdict.

use serde_json::{Map, Value, json};
use statrs::distribution::{ContinuousCDF, StudentsT};
use trueup_machine::{BadInput, Machine, RunFile, machine_file::Quantity};

use crate::{
    blocks::{Folds, rms},
    data::{Data, Groups, quantity_of},
    fit::{Fitted, Problem, fit, spread},
    model::{Kind, Model, Part, Scale},
    noise::{Chance, Noise},
    outliers, repeats,
    report::{After, Before, Finding, Gain, Rejected, Report, Rival, Verdict},
    search::{self, AS_WELL, Added, Found, TIE, degrees, in_its_place, name},
    terms, words,
};

/// Groups that the search works on where there is time alone; rows beyond are averaged.
const MOST_GROUPS: usize = 1000;
/// Rows that the search works on where an axis moves: an average would blur its errors, so that of
/// more rows so many are drawn by chance. The last fit is to all of them.
const MOST_ROWS_MOVING: usize = 5000;

/// A machine whose readings at one position scatter by more (standard deviation, in µm) is no machine
/// to be corrected but one to be mended: its repeatability by ISO 230-2, 4·s, is beyond 20 µm, about
/// the most that ISO 10791-4 lets a machining centre of 2 m have. Less than that may be the noise of
/// the instrument.
const REPEATABLE_UM: f64 = 5.0;

/// What is being tried, and how far the search has come, 0…1 (NaN: as before).
pub type Progress<'p> = dyn FnMut(&str, f64) + 'p;

/// The answer, with all that is needed to write it down.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// The answer.
    pub report: Report,
    /// The terms of the extended machine file, in its order.
    pub terms: Vec<trueup_machine::machine_file::Term>,
    pub(crate) data: Data,
    pub(crate) before: Vec<f64>,
    pub(crate) after: Vec<f64>,
    pub(crate) aside: Vec<bool>,
}

/// Compares `machine` with what was measured in `runs`, names the causes of what it gets wrong, and
/// measures what their terms bring on `holdout` (which chooses nothing).
///
/// # Errors
/// There is no such quantity in a run, or several and none is asked for; a column is missing without
/// which nothing can be predicted; no row is both measured and predicted.
pub fn diagnose(
    machine: &Machine,
    runs: &[RunFile],
    holdout: &[RunFile],
    quantity: Option<Quantity>,
    progress: &mut Progress<'_>,
) -> Result<Diagnosis, BadInput> {
    let quantity = quantity_of(runs, quantity)?;
    quantity_of(if holdout.is_empty() { runs } else { holdout }, Some(quantity))?;
    let data = Data::new(machine, runs, quantity)?;
    let test = if holdout.is_empty() {
        None
    } else {
        let mut test = Data::new(machine, holdout, quantity)?;
        test.refer_to(&data);
        Some(test)
    };
    let none_aside = vec![false; data.rows];
    let mut aside = none_aside.clone();
    let (mut problem, mut found) = searched(&data, &aside, progress);
    // Gross errors are seen once the rest is explained; then the rest is searched without them.
    let gross = outliers::gross(&data, &found.fitted.model.predict(&data));
    if gross.contains(&true) {
        aside = gross;
        (problem, found) = searched(&data, &aside, progress);
        let again = outliers::gross(&data, &found.fitted.model.predict(&data));
        if again != aside && again.contains(&true) {
            aside = again;
            (problem, found) = searched(&data, &aside, progress);
        }
    }
    progress("comparing with rivals", 0.92);
    Ok(conclude(data, problem, found, &aside, test.as_ref()))
}

fn searched(data: &Data, aside: &[bool], progress: &mut Progress<'_>) -> (Problem, Found) {
    let used: Vec<bool> =
        data.used.iter().zip(aside).map(|(used, aside)| *used && !aside).collect();
    let rows = used.iter().filter(|used| **used).count();
    let moves = data.quantity.axis().is_some()
        && data.position_mm.iter().flatten().any(|mm| {
            let first = Data::first_of(mm);
            mm.iter().any(|mm| !mm.is_nan() && *mm != first)
        });
    if !moves || rows <= MOST_ROWS_MOVING {
        let size = if moves { 1 } else { rows.div_ceil(MOST_GROUPS).max(1) };
        let groups = Groups::new(data, &used, size);
        let problem = Problem::new(data.clone(), groups);
        let found = search::search(&problem, search::start(data), progress);
        return (problem, found);
    }
    let mut chance = Chance::new(rows as u64);
    let drawn: Vec<bool> =
        used.iter().map(|used| *used && chance.below(rows) < MOST_ROWS_MOVING).collect();
    let problem = if data.has_memory() {
        Problem::new(data.clone(), Groups::new(data, &drawn, 1))
    } else {
        let few = data.subset(&drawn);
        let groups = Groups::new(&few, &few.used.clone(), 1);
        Problem::new(few, groups)
    };
    let mut found = search::search(&problem, search::start(data), progress);
    let whole = Problem::new(data.clone(), Groups::new(data, &used, 1));
    let model = fit(&whole, &found.fitted.model, None).model;
    let residual = problem.residual(&model);
    let sum = residual.iter().map(|r| r * r).sum();
    found.fitted = Fitted { model, residual, sum, degrees: found.fitted.degrees };
    (problem, found)
}

/// Errors of the rows that count.
fn errors(data: &Data, predicted: &[f64], aside: Option<&[bool]>) -> Vec<f64> {
    (0..data.rows)
        .filter(|&row| data.used[row] && aside.is_none_or(|aside| !aside[row]))
        .map(|row| data.measured[row] - predicted[row])
        .filter(|error| error.is_finite())
        .collect()
}

fn most(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most: f64, value| most.max(value.abs()))
}

/// What was judged about one term.
struct Judged {
    finding: Finding,
    kind: Kind,
    /// Whether it goes into the extended machine file.
    is_kept: bool,
}

fn conclude(
    data: Data,
    problem: Problem,
    found: Found,
    aside: &[bool],
    test: Option<&Data>,
) -> Diagnosis {
    let believed = Model::default().predict(&data);
    let mut judged: Vec<Judged> =
        found.added.iter().filter_map(|added| judge(&problem, &found, added)).collect();
    // Terms that are not kept leave, and the others are fitted again without them.
    let mut kept = found.fitted.clone();
    if judged.iter().any(|it| !it.is_kept) {
        let mut model = found.fitted.model.clone();
        model.parts.retain(|part| judged.iter().all(|it| it.is_kept || it.kind != part.kind));
        kept = fit(&problem, &model, None);
    }
    let has_terms = !kept.model.parts.is_empty();
    // Without a term the machine file stays, and with it its zero.
    let model = if has_terms { kept.model.clone() } else { Model::default() };
    let after = model.predict(&data);
    let compensated = compensated(&model);

    let before_rows = errors(&data, &believed, None);
    let after_rows = errors(&data, &after, Some(aside));
    let aside_count = aside.iter().filter(|aside| **aside).count();
    let folds = &found.folds;
    // Groups are means of rows: what they average away is in each row again.
    let within = within(&data, &problem, &after, aside);
    let by_row = |group_rms: f64| (group_rms * group_rms + within).sqrt();
    let left_out = |model: &Model, is_believed: bool| {
        if is_believed {
            by_row(rms(&problem.residual(model)))
        } else {
            by_row(rms(&folds.left_out(&problem, model)))
        }
    };
    let holdout = |model: &Model, is_believed: bool| match test {
        Some(test) => rms(&errors(test, &model.predict(test), None)),
        None => left_out(model, is_believed),
    };
    let before_holdout = holdout(&Model::default(), true);
    let after_holdout = if has_terms { holdout(&model, false) } else { before_holdout };
    let compensated_holdout = if compensated.parts.is_empty() {
        before_holdout
    } else if compensated == model {
        after_holdout
    } else {
        holdout(&compensated, false)
    };
    for it in &mut judged {
        it.finding.gain.by_row(within);
    }
    if aside_count > 0 {
        judged.push(outlier_finding(&data, &after, aside, aside_count));
    }

    let repeats = repeats::analyse(&data, &model.predict(&data));
    let noise_um = noise_um(&data, &problem, &found, &after, aside, repeats.as_ref());
    let (verdict, reasons) = verdict(&found, &judged, repeats.as_ref());
    let rejected = found
        .rejected
        .iter()
        .map(|tried| Rejected {
            cause: name(&tried.kind).into(),
            column: column(&tried.kind),
            reason: tried.why_not.clone(),
            rms_um: tried.rms_um,
            left_out_um: (tried.left_out_um > 0.0).then_some(tried.left_out_um),
        })
        .collect();
    let report = Report {
        schema: 1,
        rows: data.rows,
        rows_used: after_rows.len(),
        quantity: data.quantity.name().into(),
        noise_um,
        noise_memory: found.noise.memory * problem.groups.size as f64 * step_s(&data, &problem),
        before: Before {
            rms_um: rms(&before_rows),
            max_um: most(&before_rows),
            holdout_rms_um: before_holdout,
        },
        after: After {
            rms_um: rms(&after_rows),
            max_um: most(&after_rows),
            holdout_rms_um: after_holdout,
            compensated_holdout_rms_um: compensated_holdout,
        },
        verdict,
        reasons,
        findings: judged.into_iter().map(|it| it.finding).collect(),
        rejected,
    };
    let terms = terms::terms(&data, &model);
    Diagnosis { report, terms, data, before: believed, after, aside: aside.to_vec() }
}

/// Seconds from row to row, or 1 where there is no time.
fn step_s(data: &Data, problem: &Problem) -> f64 {
    if data.time_s.is_none() {
        return 1.0;
    }
    let [start, end] = problem.bounds.time_s;
    (end - start) / (data.rows as f64 / data.files as f64).max(1.0)
}

/// Mean square of what the groups average away.
fn within(data: &Data, problem: &Problem, predicted: &[f64], aside: &[bool]) -> f64 {
    if problem.groups.size == 1 {
        // Rows of their own, or a draw of them.
        return 0.0;
    }
    let rows = errors(data, predicted, Some(aside));
    let residual: Vec<f64> =
        (0..data.rows).map(|row| data.measured[row] - predicted[row]).collect();
    let groups = problem.groups.means(&residual);
    (rms(&rows).powi(2) - rms(&groups).powi(2)).max(0.0)
}

fn is_compensated(kind: &Kind) -> bool {
    !matches!(kind, Kind::Drift | Kind::Step | Kind::TimeShift | Kind::ReferenceInstrument { .. })
}

/// The model as the board runs it: without what only happened once, and what is not the machine's.
fn compensated(model: &Model) -> Model {
    let mut compensated = model.clone();
    compensated.parts.retain(|part| is_compensated(&part.kind));
    if compensated.parts.is_empty() { Model::default() } else { compensated }
}

fn judge(problem: &Problem, found: &Found, added: &Added) -> Option<Judged> {
    let data = &problem.data;
    let kind = &added.kind;
    let part = found.fitted.model.parts.iter().find(|part| part.kind == *kind)?;
    let (own_left, folded) = found.folds.left_out_with_models(problem, &found.fitted.model);
    let own_left = rms(&own_left);
    let mut rivals: Vec<(Rival, Fitted)> = Vec::new();
    let mut without = None;
    for (with, fitted) in in_its_place(problem, &found.fitted, kind, 8) {
        let Some(with) = with else {
            without = Some(fitted);
            continue;
        };
        if name(&with) == name(kind) && column(&with) == column(kind) {
            continue;
        }
        let mut gap = search::gap(problem, &found.fitted, &fitted);
        // What predicts left-out blocks clearly worse does not explain as well, whatever it fits.
        if gap < TIE && rms(&found.folds.left_out(problem, &fitted.model)) > AS_WELL * own_left {
            gap = TIE;
        }
        // What needs more values to say the same is no other explanation.
        let is_more = degrees(&fitted.model) > degrees(&found.fitted.model);
        let there = &fitted.residual;
        let apart: Vec<f64> =
            there.iter().zip(&found.fitted.residual).map(|(a, b)| a - b).collect();
        if gap > 0.0 && is_more && rms(&apart) < 0.15 * found.fitted.rms() {
            continue;
        }
        let rival = Rival { cause: name(&with).into(), column: column(&with), score_gap: gap };
        match rivals
            .iter_mut()
            .find(|(there, _)| there.cause == rival.cause && there.column == rival.column)
        {
            Some(there) if there.0.score_gap > gap => *there = (rival, fitted),
            Some(_) => {}
            None => rivals.push((rival, fitted)),
        }
    }
    rivals.sort_by(|a, b| a.0.score_gap.total_cmp(&b.0.score_gap));
    rivals.truncate(6);
    let (parameters, is_determined) = parameters(problem, &found.fitted, part, found.noise);
    let is_determined = is_determined && is_steady(kind, &folded);
    // The same cause by another column is a question of where, not of what.
    let open: Vec<&(Rival, Fitted)> = rivals
        .iter()
        .filter(|(rival, _)| rival.cause != name(kind) && rival.score_gap < TIE)
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
        rms(&apart) < 0.5 * left
    });
    let claimed = open.is_empty() && is_determined;
    // The machine's own constant comes before what is not in its model: it stays, though unsettled.
    let is_own = kind.tier() == 0 && open.iter().all(|(_, rival)| adds_farther(rival, found));
    let is_kept = open.is_empty() || alike || is_own;
    let gap = rivals
        .iter()
        .filter(|(rival, _)| rival.cause != name(kind))
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
        evidence.push("Its parameters are not yet identified by these data.".into());
    }
    let gain = final_gain(problem, found, without.as_ref(), added);
    let next_test = words::next_test(kind, best_other.as_deref());
    let finding = Finding {
        cause: name(kind).into(),
        column: column(kind),
        claimed,
        compensated: is_compensated(kind) && is_kept,
        confidence: (1.0 / (1.0 + (-0.5 * gap.min(40.0)).exp()) * 1e4).round() / 1e4,
        parameters,
        gain,
        sentence: words::sentence(part),
        evidence,
        rivals: rivals.into_iter().map(|(rival, _)| rival).collect(),
        next_test,
    };
    Some(Judged { finding, kind: kind.clone(), is_kept })
}

/// Whether a time constant is about the same whatever part of the record is left out: within a factor
/// of 2.5 from the least to the most.
fn is_steady(kind: &Kind, folded: &[Model]) -> bool {
    if kind.nonlinear().first() != Some(&Scale::Logarithmic) || kind.tier() > 1 {
        return true;
    }
    let values = folded
        .iter()
        .filter_map(|model| model.parts.iter().find(|part| part.kind == *kind))
        .map(|part| part.values[0]);
    let (low, high) =
        values.fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
    high <= 2.5 * low
}

/// Whether `rival` has a term in place of one of the model's that is farther from the machine's own
/// model than any constant of it.
fn adds_farther(rival: &Fitted, found: &Found) -> bool {
    let new = rival.model.parts.iter().filter(|part| !found.fitted.model.has(&part.kind));
    new.map(|part| part.kind.tier()).max().is_some_and(|tier| tier > 0)
}

/// What the term brings in the final model, beside all others.
fn final_gain(problem: &Problem, found: &Found, without: Option<&Fitted>, added: &Added) -> Gain {
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
    let after = folds.left_out(problem, &found.fitted.model);
    let (reduction, ci95, _) = folds.reduction(&before, &after);
    Gain {
        rms_before_um: without.rms(),
        rms_after_um: found.fitted.rms(),
        left_out_before_um: rms(&before),
        left_out_after_um: rms(&after),
        reduction,
        ci95,
    }
}

/// The column that a cause hangs on.
pub(crate) fn column(kind: &Kind) -> Option<String> {
    match kind {
        Kind::SensorTemperatureDrift { column }
        | Kind::SlowModeOf { column }
        | Kind::ExtraHeatPath { column, .. }
        | Kind::Curve { column, .. } => Some(column.clone()),
        Kind::CentrifugalGrowth => Some("spindle_rpm".into()),
        Kind::CuttingLoad => Some("load_n".into()),
        Kind::CrossAxis { axis } | Kind::Straightness { along: axis, .. } => {
            Some(format!("{}_mm", axis.name()))
        }
        _ => None,
    }
}

/// The values of a part with their 95 % intervals, by the names of the table of causes; whether they
/// are determined at all.
fn parameters(
    problem: &Problem,
    fitted: &Fitted,
    part: &Part,
    noise: Noise,
) -> (Map<String, Value>, bool) {
    let data = &problem.data;
    let spread = spread(problem, fitted, noise);
    let index = fitted.model.parts.iter().position(|there| there == part).unwrap_or(0);
    let quantile = StudentsT::new(0.0, 1.0, spread.freedom).map_or(1.96, |t| t.inverse_cdf(0.975));
    let place = |value: usize| spread.places.iter().position(|at| *at == Some((index, value)));
    let sd = |value: usize| {
        place(value).map_or(f64::NAN, |at| spread.covariance[at][at].max(0.0).sqrt())
    };
    let nonlinear = part.kind.nonlinear();
    // Of one value, as it is fitted.
    let interval = |value: usize| -> [f64; 2] {
        let (center, sd) = (part.values[value], quantile * sd(value));
        if nonlinear.get(value) == Some(&Scale::Logarithmic) {
            [center * (-sd).exp(), center * sd.exp()]
        } else {
            [center - sd, center + sd]
        }
    };
    let mut map = Map::new();
    let mut put = |name: &str, value: f64, ci95: [f64; 2]| {
        let mut ci95 = ci95;
        ci95.sort_by(f64::total_cmp);
        map.insert(name.into(), json!({"value": value, "ci95": ci95}));
    };
    let mut plain = |name: &str, value: usize, offset: f64| {
        let [low, high] = interval(value);
        put(name, part.values[value] + offset, [low + offset, high + offset]);
    };
    let mut is_determined = true;
    match &part.kind {
        Kind::SensorOffset => plain("offset_um", 0, 0.0),
        Kind::SensorGain => plain("gain", 0, 1.0),
        Kind::SensorCurvature => plain("per_um", 0, 0.0),
        Kind::SensorSaturation => plain("limit_um", 0, 0.0),
        Kind::SensorTemperatureDrift { .. } => plain("um_per_c", 0, 0.0),
        Kind::TimeShift => plain("shift_s", 0, 0.0),
        Kind::ThermalLag | Kind::GrowthRate | Kind::CoolingAsymmetry => {
            plain("time_constant_s", 0, 0.0);
        }
        Kind::SlowMode => {
            plain("amplitude_um", 1, 0.0);
            plain("time_constant_s", 0, 0.0);
        }
        Kind::SlowModeOf { .. } | Kind::ExtraHeatPath { has_lag: true, .. } => {
            plain("um_per_c", 1, 0.0);
            plain("time_constant_s", 0, 0.0);
        }
        Kind::ExtraHeatPath { has_lag: false, .. } => {
            plain("um_per_c", 0, 0.0);
            put("time_constant_s", 0.0, [0.0, 0.0]);
        }
        Kind::GrowthAmplitude => plain("scale", 0, 1.0),
        Kind::ExpansionSlope => {
            let believed =
                crate::model::own_thermal(data).map_or(0.0, |it| it.slope_um_per_m_per_c);
            plain("um_per_m_per_c", 0, believed);
        }
        Kind::ReferenceTemperature => plain("shift_c", 0, 0.0),
        Kind::CentrifugalGrowth => plain("um_per_krpm2", 0, 0.0),
        Kind::CuttingLoad => plain("um_per_n", 0, 0.0),
        Kind::PitchScale | Kind::PositionDependentBacklash | Kind::CrossAxis { .. } => {
            plain("um_per_m", 0, 0.0);
        }
        Kind::Backlash => plain("width_um", 0, 0.0),
        Kind::Drift => plain("um_per_h", 0, 0.0),
        Kind::Step => {
            plain("size_um", 1, 0.0);
            // A jump is as sharp as its neighbours in time.
            let at_s = part.values[0];
            let step_s = step_s(data, problem) * problem.groups.size as f64;
            put("at_s", at_s, [at_s - 2.0 * step_s, at_s + step_s]);
        }
        Kind::PitchPeriodic { .. } | Kind::ReferenceInstrument { .. } => {
            // Of several waves the largest is the one that is named.
            let waves = part.values[nonlinear.len()..].chunks(2);
            let sizes: Vec<f64> = waves.map(|pair| pair[0].hypot(pair[1])).collect();
            let largest = (0..sizes.len()).max_by(|a, b| sizes[*a].total_cmp(&sizes[*b]));
            let largest = largest.unwrap_or(0);
            let start = nonlinear.len() + 2 * largest;
            let harmonic = match &part.kind {
                Kind::PitchPeriodic { harmonics } => f64::from(harmonics[largest]),
                _ => 1.0,
            };
            let (a, b) = (part.values[start], part.values[start + 1]);
            let amplitude = a.hypot(b);
            let sd = match (place(start), place(start + 1)) {
                (Some(i), Some(j)) if amplitude > 0.0 => {
                    let c = &spread.covariance;
                    let square = a * a * c[i][i] + 2.0 * a * b * c[i][j] + b * b * c[j][j];
                    quantile * square.max(0.0).sqrt() / amplitude
                }
                _ => f64::NAN,
            };
            put("amplitude_um", amplitude, [(amplitude - sd).max(0.0), amplitude + sd]);
            let [low, high] = interval(0);
            put("period_mm", part.values[0] / harmonic, [low / harmonic, high / harmonic]);
        }
        Kind::PitchError { .. } | Kind::Straightness { .. } | Kind::Curve { .. } => {}
    }
    // A mean of readings that are rounded has less of an interval than its rounding.
    for (value, scale) in nonlinear.iter().enumerate() {
        let [low, high] = interval(value);
        let bound = problem.bounds.time_constant_s;
        let is_time = matches!(
            part.kind,
            Kind::ThermalLag
                | Kind::SlowMode
                | Kind::SlowModeOf { .. }
                | Kind::ExtraHeatPath { .. }
                | Kind::GrowthRate
                | Kind::CoolingAsymmetry
        );
        if is_time && *scale == Scale::Logarithmic {
            let at_bound = part.values[value] > 0.95 * bound[1];
            // Known within a factor of two either way, or not known.
            if at_bound || high.partial_cmp(&(4.0 * low)) != Some(std::cmp::Ordering::Less) {
                is_determined = false;
            }
        }
    }
    list_parameters(part, &interval, &mut map);
    // The reference and a zero that came with it.
    let terms = terms::terms(data, &fitted.model);
    if let Some(term) = terms.get(index) {
        use trueup_machine::machine_file::Effect;
        match &term.effect {
            Effect::SensorTemperatureDrift { reference_c, .. }
            | Effect::SlowModeOf { reference_c, .. }
            | Effect::ExtraHeatPath { reference_c, .. } => {
                map.insert("reference_c".into(), json!({"value": reference_c}));
            }
            Effect::ReferenceInstrument { description, .. } => {
                map.insert("description".into(), json!({"value": description}));
            }
            _ => {}
        }
        if term.constant_um != 0.0 {
            map.insert("constant_um".into(), json!({"value": term.constant_um}));
        }
    }
    (map, is_determined)
}

fn list_parameters(
    part: &Part,
    interval: &dyn Fn(usize) -> [f64; 2],
    map: &mut Map<String, Value>,
) {
    let intervals = || (0..part.values.len()).map(interval).collect::<Vec<_>>();
    match &part.kind {
        Kind::PitchError { start_mm, step_mm, points, both_ways } => {
            let value = json!({
                "start_mm": start_mm,
                "step_mm": step_mm,
                "forward_um": part.values[..*points],
                "reverse_um": both_ways.then(|| part.values[*points..].to_vec()),
            });
            map.insert("table".into(), json!({"value": value, "ci95": intervals()}));
        }
        Kind::Straightness { along, knots_mm } => {
            let value = json!({
                "along": along.name(),
                "order": 4,
                "knots_mm": knots_mm,
                "control_um": part.values,
            });
            map.insert("spline".into(), json!({"value": value, "ci95": intervals()}));
        }
        Kind::CrossAxis { axis } => {
            map.insert("axis".into(), json!({"value": axis.name()}));
        }
        Kind::PitchPeriodic { harmonics } if harmonics.len() > 1 => {
            let waves: Vec<Value> = harmonics
                .iter()
                .zip(part.values[1..].chunks(2))
                .map(|(harmonic, pair)| {
                    json!({
                        "harmonic": harmonic,
                        "amplitude_um": pair[0].hypot(pair[1]),
                        "phase_deg": pair[1].atan2(pair[0]).to_degrees(),
                    })
                })
                .collect();
            map.insert("harmonics".into(), json!({"value": waves}));
            map.insert("turn_mm".into(), json!({"value": part.values[0]}));
        }
        _ => {}
    }
}

fn outlier_finding(data: &Data, after: &[f64], aside: &[bool], count: usize) -> Judged {
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
    Judged {
        finding,
        kind: Kind::Curve { column: String::new(), knots: vec![0.0, 1.0], by_direction: false },
        is_kept: true,
    }
}

/// The noise of one reading: from repeats where there are any, else from what differs between
/// neighbours, with the memory of the noise taken into account.
fn noise_um(
    data: &Data,
    problem: &Problem,
    found: &Found,
    after: &[f64],
    aside: &[bool],
    repeats: Option<&repeats::Repeats>,
) -> f64 {
    if let Some(repeats) = repeats {
        return repeats.scatter_um;
    }
    let rows = errors(data, after, Some(aside));
    let differences: Vec<f64> = rows.windows(2).map(|pair| pair[1] - pair[0]).collect();
    if differences.is_empty() {
        return 0.0;
    }
    let memory = found.noise.memory * problem.groups.size as f64;
    let next = if memory > 0.0 { (1.0 - found.noise.white) * (-1.0 / memory).exp() } else { 0.0 };
    (rms(&differences) / (2.0 * (1.0 - next)).sqrt()).min(rms(&rows))
}

fn verdict(
    found: &Found,
    judged: &[Judged],
    repeats: Option<&repeats::Repeats>,
) -> (Verdict, Vec<String>) {
    let mut reasons = found.structure.clone();
    let causes = judged.iter().filter(|it| it.finding.cause != "outliers").count();
    let open = judged.iter().any(|it| !it.finding.claimed);
    if causes == 0 {
        let does_not_repeat = repeats
            .is_some_and(|it| it.scatter_um > it.systematic_um && it.scatter_um > REPEATABLE_UM);
        if let (Some(repeats), true) = (repeats, does_not_repeat) {
            reasons.push(format!(
                "at equal positions the readings scatter by {:.2} µm, more than the {:.2} µm that \
                 repeat: what is corrected today is wrong tomorrow",
                repeats.scatter_um, repeats.systematic_um
            ));
            return (Verdict::DoNotCompensate, reasons);
        }
        if !reasons.is_empty() {
            return (Verdict::Unexplained, reasons);
        }
        if judged.is_empty() {
            reasons.push("nothing is left but noise: the model stays".into());
            return (Verdict::Clean, reasons);
        }
        return (Verdict::Explained, reasons);
    }
    if open {
        reasons
            .push("two causes cannot be told apart, or a parameter is not yet identified".into());
    }
    if reasons.is_empty() {
        reasons.push("no test of structure fires on what is left".into());
        (Verdict::Explained, reasons)
    } else {
        (Verdict::PartlyExplained, reasons)
    }
}
