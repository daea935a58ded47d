//! A judgement as a finding of the report: in sentences, with the measurement to make next.

use serde_json::{Map, Value, json};

use trueup_machine::effect::{BoundSide, Dependence, Effect, RangeLimited, Value as Entry};
use trueup_numerics::block_resampling::rms;
use trueup_page::format_micrometres;

use crate::{
    data::DataTable,
    diagnosis::{
        alias_discrimination::describe_alias_test,
        next_measurement::next_measurement,
        omission_reason::OmissionReason,
        report::{AlternativeCause, ColumnRange, CoupledCause, Finding},
        residuals::compute_residuals,
    },
    fit::FitProblem,
    folds::FoldUnit,
    judgement::{Caveat, TermJudgement, repeat_evidence::InterpolationAccuracy},
    outliers::OutlierJudgement,
    parameter_estimates::ParameterEstimates,
    term_gain::TermGain,
    term_kind::{ModelPart, TermKind},
};

/// Returns the finding of a term of what was found on `problem`; `left_out`: what was held out in turn.
pub(crate) fn build_finding(
    problem: &FitProblem,
    it: &TermJudgement,
    left_out: FoldUnit,
) -> Finding {
    let cause = it.cause();
    let sentence = it.part.sentence();
    let TermGain { rms_before_um, rms_after_um, .. } = it.gain;
    let first = &it.first_gain;
    let mut evidence = vec![
        sentence.clone(),
        format!(
            "Without it {} RMS are left, with it {}.",
            format_micrometres(rms_before_um),
            format_micrometres(rms_after_um)
        ),
        format!(
            "On held-out {left_out} the error falls from {} to {} RMS.",
            format_micrometres(first.left_out_before_um),
            format_micrometres(first.left_out_after_um)
        ),
    ];
    evidence.extend(describe_term_change(&it.part));
    evidence.extend(it.doubts.iter().map(|doubt| describe_caveat(doubt, &it.gain, left_out)));
    evidence.extend(it.between.as_ref().and_then(InterpolationAccuracy::sentence));
    let between = it.between.as_ref().and_then(InterpolationAccuracy::next_test);
    let next_test = match it.better_law_inputs() {
        _ if between.is_some() && it.doubts.is_empty() => between.unwrap_or_default(),
        Some(inputs) => format!(
            "Measure again, and vary only the inputs that are correlated with {inputs}, in many small steps, up \
             and down."
        ),
        None => {
            match it.doubts.iter().find_map(|doubt| describe_alias_test(problem, &it.part, doubt)) {
                Some(asked) => asked,
                None => next_measurement(
                    problem,
                    &it.part,
                    cause.next_test(indistinguishable_alternative(it)).to_string(),
                ),
            }
        }
    };
    let next_test = cause.append_repair_advice(next_test);
    let same = it.doubts.iter().filter_map(|doubt| match doubt {
        Caveat::SinglePass(other) => Some(AlternativeCause {
            cause: (*other).into(),
            column: None,
            form: None,
            score_gap: 0.0,
        }),
        _ => None,
    });
    let rivals = same.chain(it.rivals.iter().map(|rival| AlternativeCause {
        cause: rival.cause.name().into(),
        column: rival.cause.column(),
        form: as_dependence(&rival.cause).map(Dependence::form_name),
        score_gap: rival.bic_gap,
    }));
    Finding {
        cause: cause.name().into(),
        column: cause.column(),
        form: as_dependence(cause).map(Dependence::form_name),
        times: as_dependence(cause)
            .and_then(|dependence| dependence.times.name())
            .map(String::from),
        columns: as_dependence(cause).and_then(operand_columns),
        within: cause.cause().and_then(Effect::as_range_limited).zip(it.bound).map(column_range),
        claimed: it.doubts.is_empty(),
        compensated: cause.is_compensable() && it.is_kept,
        confidence: (it.confidence() * 1e4).round() / 1e4,
        parameters: it.parameters.clone(),
        gain: it.gain,
        sentence,
        evidence,
        together_with: Vec::new(),
        rivals: rivals.collect(),
        next_test,
    }
}

/// Returns the page of a dependence on a column, where the cause is one.
fn as_dependence(cause: &TermKind) -> Option<&Dependence> {
    let effect = cause.cause()?;
    match effect.as_range_limited().map_or(effect, |within| &within.effect) {
        Effect::Dependence(page) => Some(page),
        _ => None,
    }
}

/// Returns the range in which a cause acts.
fn column_range((it, ci95): (&RangeLimited, [f64; 2])) -> ColumnRange {
    let bound = |side| (it.side == side).then_some(it.bound);
    let (above, below) = (bound(BoundSide::Above), bound(BoundSide::Below));
    ColumnRange { column: it.column.clone(), above, below, ci95 }
}

/// Returns the two columns of a difference or a product.
fn operand_columns(page: &Dependence) -> Option<[String; 2]> {
    let second = page.minus.as_deref().or(page.times.column());
    second.map(|second| [page.column.clone(), second.to_string()])
}

/// Findings of the terms `judged`, in their order, as one where two are only certain together: under the
/// name of the first.
pub(super) fn merge_coupled_findings(judged: &[TermJudgement], all: Vec<Finding>) -> Vec<Finding> {
    let mut findings: Vec<(&TermJudgement, Finding)> = Vec::new();
    for (it, finding) in judged.iter().zip(all) {
        let holds = |there: &&mut (&TermJudgement, Finding)| {
            it.doubts.iter().any(|doubt| *doubt == Caveat::OnlyTogether(there.0.cause().clone()))
        };
        match findings.iter_mut().find(holds) {
            Some((_, first)) => {
                let Finding { cause, column, parameters, sentence, .. } = finding;
                first.evidence.push(format!("With it: {sentence}"));
                first.together_with.push(CoupledCause { cause, column, parameters, sentence });
            }
            None => findings.push((it, finding)),
        }
    }
    findings.into_iter().map(|(_, finding)| finding).collect()
}

impl Finding {
    /// The hold-out becomes worse by it: its term is not handed out.
    pub(super) fn mark_excluded_by_hold_out(&mut self) {
        self.compensated = false;
        self.evidence
            .push("It makes the hold-out worse: extended.toml does not contain it.".into());
    }

    /// It was found next to what the hold-out has disproved, or is that.
    pub(super) fn withdraw_claim(&mut self) {
        self.claimed = false;
        self.evidence
            .push("It was found together with a term that the hold-out does not confirm.".into());
    }

    /// It may be a part of `open`, which is not settled.
    pub(super) fn mark_dependent_on(&mut self, open: &TermKind) {
        if self.claimed {
            self.claimed = false;
            self.evidence.push(describe_open_dependence(open));
        }
    }

    /// More is left than it explains, and that may be the machine.
    pub(super) fn mark_mostly_unexplained(&mut self) {
        if self.claimed {
            self.claimed = false;
            self.evidence.push(
                "More than half of the error is left, and may be the machine: this may stand for a part of another law."
                    .into(),
            );
        }
    }
}

impl Finding {
    /// Its term is not written for the board, and why.
    pub(super) fn mark_not_written(&mut self, why: &OmissionReason) {
        self.compensated = false;
        self.evidence.push(why.sentence());
        // What predicts less than other terms stands for one of them.
        self.claimed &= !matches!(why, OmissionReason::PredictsWorse);
        if why.is_inseparable() {
            self.claimed = false;
            self.next_test = OmissionReason::SEPARATION_TEST_INSTRUCTION.into();
        }
    }

    /// Its term is written with these values: where they differ from the joint fit by more than a standard error
    /// they stand next to it.
    pub(super) fn mark_written(&mut self, written: Option<ParameterEstimates>) {
        let Some(written) = written else { return };
        let mut differs = Vec::new();
        for (name, there) in written.named {
            let Some(own) = self.parameters.get_mut(&name).and_then(Value::as_object_mut) else {
                continue;
            };
            let value = &there["value"];
            if differs_by_standard_error(&own["value"], value, own.get("ci95")) {
                differs.push(match value.as_f64() {
                    Some(number) => format!("{name} {}", format_five_significant_digits(number)),
                    None => name,
                });
                own.insert("written".into(), value.clone());
            }
        }
        if !differs.is_empty() {
            self.evidence.push(format!(
                "In extended.toml, fitted without the terms that are not written: {}.",
                differs.join(", ")
            ));
        }
    }
}

/// Returns whether two values differ by more than the standard error of the first, of which `ci95` is the interval;
/// without one, whether they differ. Lists do where one of their values does.
fn differs_by_standard_error(own: &Value, written: &Value, ci95: Option<&Value>) -> bool {
    /// An interval of 95 % has this many standard errors (a normal distribution).
    const STANDARD_ERRORS_PER_CI95: f64 = 3.92;
    match (own, written) {
        (Value::Number(_), Value::Number(_)) => {
            let [one, other] = [own, written].map(|value| value.as_f64().unwrap_or(f64::NAN));
            let end = |n: usize| ci95.and_then(|interval| interval.get(n)).and_then(Value::as_f64);
            let rounding = 1e-9 * one.abs().max(1.0);
            let error = match (end(0), end(1)) {
                (Some(low), Some(high)) => (high - low) / STANDARD_ERRORS_PER_CI95,
                _ => 0.0,
            };
            (one - other).abs() > error.max(rounding)
        }
        (Value::Array(one), Value::Array(other)) => {
            one.len() != other.len()
                || one.iter().zip(other).enumerate().any(|(n, (one, other))| {
                    differs_by_standard_error(one, other, ci95.and_then(|interval| interval.get(n)))
                })
        }
        (Value::Object(one), Value::Object(other)) => one.iter().any(|(key, one)| {
            other.get(key).is_some_and(|other| differs_by_standard_error(one, other, None))
        }),
        _ => own != written,
    }
}

/// By how much a term of the machine file has changed, in a sentence; none of what the file has not.
fn describe_term_change(part: &ModelPart) -> Option<String> {
    let (before, after) = (&part.kind.as_stated_term()?.effect, part.cause()?);
    let (mut stated, mut fitted) = (Vec::new(), Vec::new());
    for ((key, before), (_, after)) in before.entries().into_iter().zip(after.entries()) {
        if let (Entry::Number(before), Entry::Number(after)) = (before, after)
            && before != after
        {
            stated.push(format!("{key} = {}", format_five_significant_digits(before)));
            fitted.push(format_five_significant_digits(after));
        }
    }
    Some(if stated.is_empty() {
        "The machine file has this already; these data give other values.".into()
    } else {
        format!(
            "The machine file has {}; these data give {}.",
            stated.join(", "),
            fitted.join(", ")
        )
    })
}

/// Returns a number in its first five digits.
fn format_five_significant_digits(number: f64) -> String {
    format!("{number:.4e}").parse::<f64>().unwrap_or(number).to_string()
}

/// Returns the name of the rival that cannot be distinguished from the cause.
fn indistinguishable_alternative(it: &TermJudgement) -> Option<&'static str> {
    it.doubts.iter().find_map(|doubt| match doubt {
        Caveat::AlternativeCause(rival) => Some(rival.name()),
        Caveat::SinglePass(other) => Some(other),
        _ => None,
    })
}

/// Returns why a term is doubted next to one that is not settled.
fn describe_open_dependence(open: &TermKind) -> String {
    format!(
        "It hangs on an open question: {} is not settled, and with another answer to it this may not be needed.",
        open.name_with_column()
    )
}

/// Returns a doubt in a sentence.
fn describe_caveat(doubt: &Caveat, gain: &TermGain, left_out: FoldUnit) -> String {
    match doubt {
        Caveat::AlternativeCause(rival) => format!("{} explains these data as well.", rival.name_with_column()),
        Caveat::NotIdentified => format!(
            "It is not yet identified by these data: fitted to all {} RMS are left, on \
             held-out {left_out} {}.",
            format_micrometres(gain.rms_after_um),
            format_micrometres(gain.left_out_after_um)
        ),
        Caveat::SizeMayBeZero => {
            "It may as well be nothing: the interval of its size holds that.".into()
        }
        Caveat::AtSearchBound => {
            "One of its values is where the search for it ends: the best may lie beyond.".into()
        }
        Caveat::SlowerThanRecord => {
            "It is slower than the record is long: where it ends has not been seen.".into()
        }
        Caveat::InitialTransientOf(late) => format!(
            "It settles as fast as {} does: the machine may not have been at rest when the record began.",
            late.name_with_column()
        ),
        Caveat::ModelFormErrorOf(law) => format!(
            "It may only make up for the form of {}. A part follows its thermometer by a lag of \
             the first order only approximately, and was not at rest when the record began.",
            law.name_with_column()
        ),
        Caveat::GainsInOneBlock => "It gains on one part of the record alone: it was seen once.".into(),
        Caveat::GainMayBeZero => format!(
            "It may as well gain nothing on held-out {left_out}: the interval of its gain holds that."
        ),
        Caveat::DoesNotPersist => {
            "It does not predict the end of the record: something else may drift."
                .into()
        }
        Caveat::OnlySmoothsNoise => {
            "Its thermometer smoothed as much, and not late, predicts as well: it may only smooth the \
             noise of the thermometer."
                .into()
        }
        Caveat::AbsorbedByFinerTable(table) => format!(
            "It depends on the position, as {} does: the machine may be as uneven between the points of that table.",
            table.name_with_column()
        ),
        Caveat::OnlyTogether(other) => format!(
            "It is only certain together with {}: neither of the two stands alone.",
            other.name_with_column()
        ),
        Caveat::DependsOnTerm(open) => describe_open_dependence(open),
        Caveat::HalvesDiffer([first, second]) => format!(
            "The first half of the record gives {}, the second {}: the difference exceeds their uncertainty.",
            format_five_significant_digits(*first),
            format_five_significant_digits(*second)
        ),
        Caveat::Alias(values) => {
            let values: Vec<String> = values.iter().map(|value| format_five_significant_digits(*value)).collect();
            format!("It does as well at {}: these data cannot separate the two.", values.join(", "))
        }
        Caveat::BetterLaw(inputs) => format!(
            "An effect that depends on {inputs} explains clearly more in its place: the cause is a similar one."
        ),
        Caveat::EquivalentLaw(inputs) => {
            format!("An effect that depends on {inputs} explains these data as well.")
        }
        Caveat::NotNeeded => {
            "What has no name yet, and is still left, explains this part as well.".into()
        }
        Caveat::SinglePass(other) => format!(
            "The position only grew with the time: {other} would look the same."
        ),
        Caveat::NotRepeatable => {
            "Its repeats do not bear it out: a cycle is not predicted by the others, or chance would make \
             the places differ as much."
                .into()
        }
        Caveat::OnlyNextToOtherLaw => {
            "It is only needed together with a term that approximates another law.".into()
        }
    }
}

/// Returns the rows that are `aside`, as users count them.
fn format_outlier_rows(aside: &[bool]) -> String {
    let rows = aside.iter().enumerate().filter(|(_, aside)| **aside);
    let rows: Vec<String> = rows.take(12).map(|(row, _)| (row + 1).to_string()).collect();
    format!("{} {}", if rows.len() == 1 { "row" } else { "rows" }, rows.join(", "))
}

/// Returns what is reported of rows that were excluded as outliers and are not claimed to be wrong; none where there are none.
pub(crate) fn describe_unclaimed_outliers(
    aside: &[bool],
    known: OutlierJudgement,
) -> Option<String> {
    let why = match known {
        OutlierJudgement::Wrong => return None,
        OutlierJudgement::AtChanges => {
            "at a start or a change of speed or load. What was read there may be of a moment before it."
        }
        OutlierJudgement::MayBeNoise => {
            "far from the rest. Noise as that of the others may have a reading as far away in so long a record."
        }
    };
    aside
        .contains(&true)
        .then(|| format!("Excluded as outliers: {}, {why}", format_outlier_rows(aside)))
}

/// Returns the finding of rows that were excluded as outliers.
pub(crate) fn build_outlier_finding(data: &DataTable, after: &[f64], aside: &[bool]) -> Finding {
    let with = compute_residuals(data, after, None);
    let without = compute_residuals(data, after, Some(aside));
    let count = aside.iter().filter(|aside| **aside).count();
    let share = count as f64 / with.len() as f64;
    let mut parameters = Map::new();
    // Of this many rows that are or are not, by Wilson's interval.
    let (n, z) = (with.len() as f64, 1.96_f64);
    let centre = (share + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (share * (1.0 - share) / n + z * z / (4.0 * n * n)).sqrt();
    parameters
        .insert("fraction".into(), json!({"value": share, "ci95": [centre - half, centre + half]}));
    let (before, after) = (rms(&with), rms(&without));
    let sentence = match count {
        1 => "One reading is no reading: it stands alone, far from the rest.".into(),
        _ => format!("{count} readings are no readings: they stand alone, far from the rest."),
    };
    Finding {
        cause: "outliers".into(),
        column: None,
        form: None,
        times: None,
        within: None,
        columns: None,
        claimed: true,
        compensated: false,
        confidence: 0.999,
        parameters,
        gain: TermGain {
            rms_before_um: before,
            rms_after_um: after,
            left_out_before_um: before,
            left_out_after_um: after,
            reduction: 1.0 - after / before,
            ci95: [0.0, 1.0 - after / before],
        },
        evidence: vec![
            sentence.clone(),
            format!("Excluded as outliers: {}.", format_outlier_rows(aside)),
        ],
        sentence,
        together_with: Vec::new(),
        rivals: Vec::new(),
        next_test: "Look at what happened at these readings, and measure them again.".into(),
    }
}
