//! The CNC's part of an answer: a factor other than 1 by which it applied the offsets of a bridge, and causes that a
//! record of an engaged bridge cannot distinguish from such a factor.
//!
//! A reading with an engaged bridge is error + factor·offset. Where rows with and without the offset exist, the factor
//! is known ([`trueup_machine::applied_offsets`]) and is taken out before anything is searched. Where they do not, the answer
//! holds with a factor of 1 alone: each of its terms is tried against a factor that is free,
//!
//! ```text
//! measured − offset + (1 − factor)·offset = model without the term
//! ```
//!
//! and a term that this explains as well is an alternative to `applied-factor`. Neither is claimed then. In both cases
//! nothing is written: a correction that makes up for a CNC is wrong once the CNC is right.

use std::borrow::Cow;

use serde_json::{Map, json};
use trueup_machine::{
    InputFileError, Machine, RunFile,
    applied_offsets::{
        self, FactorEstimate, OffsetApplication, UncompensatedRun, repeat_run_instruction,
    },
    machine_file::Quantity,
};
use trueup_numerics::block_resampling::rms;

use crate::{
    data::DataTable,
    diagnosis::{
        report::{AlternativeCause, Finding, Verdict},
        residuals::remove_zero_offset,
        verdict::VerdictReason,
    },
    fit::{EQUIVALENCE_TOLERANCE, FitProblem, FittedModel, fit},
    judgement::TermJudgement,
    model::Model,
    search::{
        SearchOutcome,
        extension::without_term,
        model_comparison::{STRONG_EVIDENCE_BIC_DIFFERENCE, bic_gap},
    },
    term_gain::TermGain,
};

/// The name of the cause.
const APPLIED_FACTOR_CAUSE: &str = "applied-factor";

/// The offsets of a bridge in the runs, and how they were applied.
pub(crate) struct BridgeOffsets {
    applied: OffsetApplication,
    /// The offset of each row of the runs, in µm; 0 where it is not known.
    offset_um: Vec<f64>,
}

/// Doubts that the factor leaves.
pub(crate) enum AppliedFactorCaveat {
    Nothing,
    /// It is known, and not 1.
    NotOne(FactorEstimate),
    /// These terms, with how much worse a free factor explains them (a difference of BIC).
    ConfoundedTerms(Vec<(usize, f64)>),
}

impl BridgeOffsets {
    /// Of the runs and what is held out: the CNC is the same. `is_once`: the user has checked the factor.
    ///
    /// # Errors
    /// The columns of a bridge are not right.
    pub(crate) fn from_runs(
        machine: &Machine,
        [runs, holdout]: [&[RunFile]; 2],
        quantity: Quantity,
        is_once: bool,
    ) -> Result<Self, InputFileError> {
        let unaided = |run| {
            Ok(UncompensatedRun::from_run(Cow::Borrowed(run), Some(machine), Some(quantity))?.0)
        };
        let all: Vec<UncompensatedRun<'_>> =
            runs.iter().chain(holdout).map(unaided).collect::<Result<_, _>>()?;
        let offset_um = all.iter().take(runs.len()).flat_map(|run| {
            let none = || vec![0.0; run.row_count()];
            let known = run.applied_offset_um(quantity).map_or_else(none, <[f64]>::to_vec);
            known.into_iter().map(|um| if um.is_finite() { um } else { 0.0 })
        });
        let offset_um = offset_um.collect();
        let applied = match is_once {
            true => OffsetApplication::NoOffset,
            false => applied_offsets::estimate_offset_application(&all, Some(machine), quantity),
        };
        Ok(Self { applied, offset_um })
    }

    /// Returns the factor by which the offsets are taken out of what was measured.
    pub(crate) fn offset_factor(&self) -> f64 {
        match self.applied {
            OffsetApplication::OtherFactor(factor) => factor.fault_factor_or_estimate(),
            _ => 1.0,
        }
    }

    /// Returns what the factor leaves open of what was found.
    pub(crate) fn factor_caveat(
        &self,
        problem: &FitProblem,
        found: &SearchOutcome,
        judged: &[TermJudgement],
    ) -> AppliedFactorCaveat {
        match self.applied {
            OffsetApplication::OtherFactor(factor) => AppliedFactorCaveat::NotOne(factor),
            OffsetApplication::NoOffset | OffsetApplication::Once(_) => {
                AppliedFactorCaveat::Nothing
            }
            OffsetApplication::Unknown(_) => self.find_confounded_terms(problem, found, judged),
        }
    }

    fn find_confounded_terms(
        &self,
        problem: &FitProblem,
        found: &SearchOutcome,
        judged: &[TermJudgement],
    ) -> AppliedFactorCaveat {
        let own = problem.data.whole.as_ref().map(|whole| whole.aggregate_values(&self.offset_um));
        let offset = problem.groups.means(own.as_ref().unwrap_or(&self.offset_um));
        // How much worse a free factor is in the place of what `model` lacks, where the two cannot be distinguished.
        let open = |model: &Model| {
            let fitted = fit_with_free_factor(problem, model, &offset)?;
            let price = (problem.groups.len() as f64).ln();
            let gap = bic_gap(problem, &found.fitted, &fitted) + price;
            let without = fit(problem, model, None).sum - found.fitted.sum;
            let imitates = fitted.sum - found.fitted.sum < EQUIVALENCE_TOLERANCE.powi(2) * without;
            (gap < STRONG_EVIDENCE_BIC_DIFFERENCE || imitates).then_some(gap)
        };
        let model = &found.fitted.model;
        let one = |(index, judgement): (usize, &TermJudgement)| {
            let gap = open(&without_term(problem, model, judgement.cause()))?;
            Some((index, gap))
        };
        let mut terms: Vec<(usize, f64)> = judged.iter().enumerate().filter_map(one).collect();
        // Several terms may make up for one factor together.
        if terms.is_empty()
            && !judged.is_empty()
            && let Some(gap) = open(&Model { parts: Vec::new(), ..model.clone() })
        {
            terms = (0..judged.len()).map(|index| (index, gap)).collect();
        }
        if terms.is_empty() {
            AppliedFactorCaveat::Nothing
        } else {
            AppliedFactorCaveat::ConfoundedTerms(terms)
        }
    }
}

/// `model`, fitted with a factor that is free; none where no row has an offset.
fn fit_with_free_factor(
    problem: &FitProblem,
    model: &Model,
    offset: &[f64],
) -> Option<FittedModel> {
    let at = |share: f64| {
        let rows = problem.measured.iter().zip(offset);
        let measured = rows.map(|(um, offset)| um + share * offset).collect();
        fit(&problem.with_measured(measured), model, None)
    };
    // A model that is linear leaves a residual that is linear in the factor; else the second step comes near.
    let (mut share, mut width) = (0.0, 1.0);
    for _ in 0..2 {
        let [here, there] = [at(share), at(share + width)].map(|fitted| fitted.residual);
        let way: Vec<f64> = there.iter().zip(&here).map(|(there, here)| there - here).collect();
        let squares: f64 = way.iter().map(|um| um * um).sum();
        if squares == 0.0 {
            return None;
        }
        let along: f64 = way.iter().zip(&here).map(|(way, here)| way * here).sum();
        share -= width * along / squares;
        width = 0.1;
    }
    Some(at(share))
}

impl AppliedFactorCaveat {
    /// Returns whether the machine file is to stay unchanged.
    pub(crate) fn forbids_writing(&self) -> bool {
        !matches!(self, Self::Nothing)
    }

    /// Marks the findings, one for each judgement, that are not written or not claimed.
    pub(crate) fn apply_to_findings(&self, findings: &mut [Finding]) {
        if self.forbids_writing() {
            for finding in findings.iter_mut().filter(|finding| finding.compensated) {
                finding.compensated = false;
                finding.evidence.push(
                    "It is not written: how the CNC applies the offset has to be settled first."
                        .into(),
                );
            }
        }
        let Self::ConfoundedTerms(terms) = self else { return };
        for (index, gap) in terms {
            let Some(finding) = findings.get_mut(*index) else { continue };
            finding.claimed = false;
            finding.evidence.push(
                "The bridge was engaged: a CNC that applies the offset otherwise than once explains these rows \
                 as well."
                    .into(),
            );
            finding.rivals.insert(
                0,
                AlternativeCause {
                    cause: APPLIED_FACTOR_CAUSE.into(),
                    column: None,
                    form: None,
                    score_gap: *gap,
                },
            );
            finding.confidence = finding.confidence.min(0.5);
            finding.next_test = repeat_run_instruction().into();
        }
    }

    /// Returns the finding of a factor that is known and wrong; `after`: what is predicted of each row.
    pub(crate) fn to_finding(
        &self,
        bridge: &BridgeOffsets,
        data: &DataTable,
        after: &[f64],
    ) -> Option<Finding> {
        let Self::NotOne(factor) = self else { return None };
        Some(build_factor_finding(*factor, data, after, &bridge.offset_um))
    }

    /// Returns the verdict with what is open.
    pub(crate) fn adjust_verdict(
        &self,
        verdict: Verdict,
        mut reasons: Vec<VerdictReason>,
    ) -> (Verdict, Vec<VerdictReason>) {
        let verdict = match (self, verdict) {
            (Self::Nothing, verdict) => return (verdict, reasons),
            (Self::NotOne(_), Verdict::Clean) => Verdict::Explained,
            (Self::NotOne(_), Verdict::Unexplained | Verdict::TooLittleData) => {
                Verdict::PartlyExplained
            }
            (Self::NotOne(_), verdict) => verdict,
            (
                Self::ConfoundedTerms(_),
                Verdict::Clean | Verdict::Explained | Verdict::Unexplained,
            ) => Verdict::PartlyExplained,
            (Self::ConfoundedTerms(_), verdict) => verdict,
        };
        reasons.retain(|reason| {
            !matches!(reason, VerdictReason::OnlyNoise | VerdictReason::NoLackOfFitFound)
        });
        reasons.insert(
            0,
            match self {
                Self::NotOne(_) => VerdictReason::OffsetApplication,
                _ => VerdictReason::Engaged,
            },
        );
        (verdict, reasons)
    }
}

/// Returns the finding of a factor that is known.
fn build_factor_finding(
    factor: FactorEstimate,
    data: &DataTable,
    after: &[f64],
    offset_um: &[f64],
) -> Finding {
    let rows = (0..data.rows).filter(|row| data.used[*row]);
    let [mut left, mut once] = [const { Vec::new() }; 2];
    for row in rows {
        let um = data.measured[row] - after[row];
        if um.is_finite() {
            left.push(um);
            once.push(um + (factor.fault_factor_or_estimate() - 1.0) * offset_um[row]);
        }
    }
    let [before_um, after_um] = [once, left].map(|um| rms(&remove_zero_offset(data, um)));
    let mut parameters = Map::new();
    parameters.insert("factor".into(), json!({"value": factor.value, "ci95": factor.ci95}));
    let sentence = factor.describe();
    let places = FactorEstimate::troubleshooting_steps();
    let mut evidence = vec![
        sentence.clone(),
        "It is known from rows with the offset and rows without it.".to_string(),
    ];
    evidence.extend(places.iter().cloned());
    let reduction = if before_um > 0.0 { 1.0 - after_um / before_um } else { 0.0 };
    Finding {
        cause: APPLIED_FACTOR_CAUSE.into(),
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
            rms_before_um: before_um,
            rms_after_um: after_um,
            left_out_before_um: before_um,
            left_out_after_um: after_um,
            reduction,
            ci95: [0.0, reduction],
        },
        sentence,
        evidence,
        together_with: Vec::new(),
        rivals: Vec::new(),
        next_test: places.join(" "),
    }
}
