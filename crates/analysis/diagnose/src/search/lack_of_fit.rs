//! Lack of fit: curves over the inputs, which are no causes, find what no cause explains.

use std::fmt;

use crate::{
    candidates::CandidateTerm,
    fit::{FitProblem, FittedModel},
    folds::FoldUnit,
    search::{
        extension::{ModelExtension, fit_extensions},
        model_comparison::{STRONG_EVIDENCE_BIC_DIFFERENCE, bic},
    },
    term_kind::{LackOfFitCurve, TermKind},
};

/// A sign that what is left is more than noise.
#[derive(Clone, Debug)]
pub(crate) enum LackOfFit {
    /// A cause explains more than noise would let it, but predicts no better what was held out.
    NoGain {
        /// The cause, with the column that it depends on.
        cause: TermKind,
        left_out: FoldUnit,
    },
    /// A curve over these explains more than noise would let it.
    CorrelatedWith(CurveInputs),
}

impl LackOfFit {
    /// Returns whether what is left depends on these.
    pub(crate) fn depends_on(&self, inputs: &CurveInputs) -> bool {
        matches!(self, Self::CorrelatedWith(left) if left == inputs)
    }
}

impl fmt::Display for LackOfFit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoGain { cause, left_out } => {
                write!(
                    f,
                    "{} is more than noise, but has no gain on held-out {left_out}",
                    cause.name_with_column()
                )
            }
            Self::CorrelatedWith(inputs) => write!(f, "the residual depends on {inputs}"),
        }
    }
}

/// The inputs of a curve.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct CurveInputs {
    column: String,
    /// The column that the curve is multiplied by.
    times: Option<String>,
    by_direction: bool,
}

impl CurveInputs {
    /// Those of a curve; none of a cause.
    pub(crate) fn from_kind(kind: &TermKind) -> Option<Self> {
        let TermKind::Curve(LackOfFitCurve { column, by_direction, times, .. }) = kind else {
            return None;
        };
        Some(Self { column: column.clone(), times: times.clone(), by_direction: *by_direction })
    }
}

impl fmt::Display for CurveInputs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.column)?;
        if let Some(times) = &self.times {
            write!(f, " times {times}")?;
        }
        f.write_str(if self.by_direction { ", differently in each direction" } else { "" })
    }
}

/// `base` with each of the curves that do most next to what it has.
pub(crate) fn fit_single_curve_extensions(
    problem: &FitProblem,
    base: &FittedModel,
    curves: &[CandidateTerm],
) -> Vec<ModelExtension> {
    fit_extensions(problem, base, curves, 2)
}

/// `base` with up to two curves that explain more than they cost: what is left then is left by
/// whatever law there is.
pub(crate) fn add_best_curves(
    problem: &FitProblem,
    base: &FittedModel,
    curves: &[CandidateTerm],
) -> FittedModel {
    let mut best = base.clone();
    for _ in 0..2 {
        let own = bic(problem, &best);
        let with = ModelExtension::best_by_bic(fit_single_curve_extensions(problem, &best, curves));
        let Some(with) = with.filter(|with| with.bic < own - STRONG_EVIDENCE_BIC_DIFFERENCE) else {
            break;
        };
        best = with.fitted;
    }
    best
}
