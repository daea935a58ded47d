//! The verdict, and why.

use std::fmt;

use trueup_page::format_micrometres;

use crate::{
    diagnosis::{
        detection_power::{COVERAGE, DetectionPower},
        final_model::MAX_MACHINE_TIER,
        hold_out_evaluation::HoldOutEvaluation,
        report::Verdict,
        shortfall::Shortfall,
        slow_drift::SlowDrift,
        unexplained_residual::UnexplainedResidual,
    },
    judgement::TermJudgement,
    repeats::{MAX_REPEATABILITY_STD_UM, RepeatStatistics},
    search::{
        SearchOutcome,
        lack_of_fit::{CurveInputs, LackOfFit},
    },
};

/// Why a verdict is as it is.
#[derive(Clone, Debug)]
pub(crate) enum VerdictReason {
    LackOfFit(LackOfFit),
    /// A term stands for a law that no cause has.
    OtherLaw(CurveInputs),
    /// Scatter at equal positions, and what repeats.
    DoesNotRepeat(RepeatStatistics),
    /// A table holds at its points, and is doubted between them.
    BetweenPoints,
    /// A finding is not claimed.
    UnclaimedFinding,
    /// The terms were chosen for what they predict.
    Predicted,
    OnlyNoise,
    /// The residual is as small as the uncertainty of the instrument.
    WithinInstrumentUncertainty,
    /// A term that is periodic in time is driven by something that was not recorded.
    PeriodicInTime,
    /// No error of a size that matters could have been distinguished from noise.
    InsufficientPower(DetectionPower),
    SlowDriftRemains(SlowDrift),
    /// What is left may be the machine as well as the gauge.
    UnexplainedResidual(UnexplainedResidual),
    /// The CNC applies the offsets otherwise than once.
    OffsetApplication,
    /// It may do so: the bridge was engaged in all rows.
    Engaged,
    NoLackOfFitFound,
    /// The hold-out is worse with the model as it was found: RMS before and after, in µm.
    Harm {
        before_um: f64,
        after_um: f64,
    },
    /// Where it is worse.
    WorseAt(String),
    /// The hold-out gains less than was promised: the floor, and the most that it can have gained.
    FallsShort {
        floor: f64,
        came: f64,
        most: f64,
    },
    /// A difference of the hold-out from the runs.
    DiffersIn(String),
    /// The hold-out is a little worse.
    NoGainUnseen {
        before_um: f64,
        after_um: f64,
    },
}

impl fmt::Display for VerdictReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::LackOfFit(lack) => lack.fmt(f),
            Self::OtherLaw(inputs) => {
                write!(f, "the error depends on {inputs}, and no known cause does")
            }
            Self::DoesNotRepeat(repeats) => write!(
                f,
                "at equal positions the readings scatter by {}, more than the {} that repeat: what \
                 is corrected today is wrong tomorrow",
                format_micrometres(repeats.scatter_um),
                format_micrometres(repeats.systematic_um)
            ),
            Self::BetweenPoints => f.write_str(
                "a table holds at its points; what it is worth between them these points cannot show",
            ),
            Self::UnclaimedFinding => {
                f.write_str("two causes cannot be separated, or a parameter is not yet identified")
            }
            Self::Predicted => f.write_str(
                "the written terms were chosen for prediction: other causes may predict as well",
            ),
            Self::OnlyNoise => f.write_str("nothing is left but noise: the model stays"),
            Self::Harm { before_um, after_um } => write!(
                f,
                "what explains the runs makes the hold-out worse: {} RMS before, {} with all of it",
                format_micrometres(*before_um),
                format_micrometres(*after_um)
            ),
            Self::WorseAt(place) | Self::DiffersIn(place) => f.write_str(place),
            Self::FallsShort { floor, came, most } => write!(
                f,
                "at least {:.0} % less was promised; the hold-out has {:.0} % less, at most {:.0} %",
                100.0 * floor,
                100.0 * came,
                100.0 * most
            ),
            Self::NoGainUnseen { before_um, after_um } => write!(
                f,
                "the hold-out gains nothing: {} RMS before, {} after",
                format_micrometres(*before_um),
                format_micrometres(*after_um)
            ),
            Self::WithinInstrumentUncertainty => f.write_str(
                "what is left is as small as what the instrument is worth: the model stays",
            ),
            Self::InsufficientPower(DetectionPower { rows, matters_um, needed, .. }) => write!(
                f,
                "{rows} rows cannot separate an error of {} RMS from noise: {needed}",
                format_micrometres(*matters_um)
            ),
            Self::SlowDriftRemains(wandering) => wandering.fmt(f),
            Self::UnexplainedResidual(rest) => rest.fmt(f),
            Self::OffsetApplication => f.write_str(
                "the CNC applies the offset otherwise than once: the machine file stays until that is put right",
            ),
            Self::Engaged => f.write_str(
                "the bridge was engaged, and how the CNC applies the offset is not known. The \
                 error may be in the CNC or in the machine file, so nothing is written",
            ),
            Self::PeriodicInTime => f.write_str(
                "an error that is periodic in time has a cause that was not recorded; the next record has another phase",
            ),
            Self::NoLackOfFitFound => f.write_str("no test of structure fires on what is left"),
        }
    }
}

/// Evidence for a verdict.
pub(super) struct VerdictEvidence<'g> {
    pub found: &'g SearchOutcome,
    pub judged: &'g [TermJudgement],
    /// Whether some readings were excluded as outliers.
    pub has_outliers: bool,
    pub repeats: Option<&'g RepeatStatistics>,
    pub power: &'g DetectionPower,
    pub wandering: Option<&'g SlowDrift>,
    /// What is left, where nothing shows that it is the gauge's.
    pub unknown_rest: Option<UnexplainedResidual>,
    /// Scatter from one reading to the next, as a standard deviation of each, in µm.
    pub between_neighbours_um: f64,
    /// The expanded uncertainty of the instrument (95 %), in µm, where that is known.
    pub instrument_um: Option<f64>,
    /// The result of the answer on a hold-out.
    pub transfer: Option<&'g HoldOutEvaluation>,
    /// How the hold-out falls short of the promise, if it does.
    pub shortfall: Option<&'g Shortfall>,
    /// Whether the written terms were chosen for prediction.
    pub is_predicted: bool,
    /// Whether a term is not written because the record does not separate it from another one.
    pub is_withheld: bool,
}

/// Returns the verdict on an answer, and why.
pub(super) fn decide_verdict(grounds: &VerdictEvidence<'_>) -> (Verdict, Vec<VerdictReason>) {
    let (verdict, mut reasons) = decide_run_verdict(grounds);
    reasons.extend(grounds.wandering.cloned().map(VerdictReason::SlowDriftRemains));
    let Some(transfer) = grounds.transfer else { return (verdict, reasons) };
    let (before_um, after_um) = (transfer.before_um, transfer.found_um);
    if !transfer.dropped.is_empty() {
        let mut harm = vec![VerdictReason::Harm { before_um, after_um }];
        harm.extend(transfer.places.iter().cloned().map(VerdictReason::WorseAt));
        harm.extend(
            reasons.into_iter().filter(|reason| !matches!(reason, VerdictReason::NoLackOfFitFound)),
        );
        return (Verdict::DoesNotTransfer, harm);
    }
    let comes_first = matches!(verdict, Verdict::TooLittleData | Verdict::DoNotCompensate);
    let shortfall =
        grounds.shortfall.filter(|shortfall| shortfall.is_significant() && !comes_first);
    if let Some(Shortfall { floor, came, most, places, .. }) = shortfall {
        let mut short = vec![VerdictReason::FallsShort { floor: *floor, came: *came, most: *most }];
        short.extend(places.iter().cloned().map(VerdictReason::DiffersIn));
        short.extend(
            reasons.into_iter().filter(|reason| !matches!(reason, VerdictReason::NoLackOfFitFound)),
        );
        return (Verdict::FallsShort, short);
    }
    if transfer.worsens_hold_out() && verdict.is_resolved() {
        return (
            Verdict::PartlyExplained,
            vec![VerdictReason::NoGainUnseen { before_um, after_um }],
        );
    }
    (verdict, reasons)
}

/// Returns the verdict by the runs alone.
fn decide_run_verdict(grounds: &VerdictEvidence<'_>) -> (Verdict, Vec<VerdictReason>) {
    let VerdictEvidence { found, judged, .. } = *grounds;
    let mut reasons: Vec<VerdictReason> =
        found.lack_of_fit.iter().cloned().map(VerdictReason::LackOfFit).collect();
    let mut laws: Vec<&CurveInputs> = Vec::new();
    for law in judged.iter().filter_map(TermJudgement::better_law_inputs) {
        if !laws.contains(&law) {
            laws.push(law);
        }
    }
    reasons.extend(laws.into_iter().cloned().map(VerdictReason::OtherLaw));
    if grounds.is_predicted {
        reasons.push(VerdictReason::Predicted);
    }
    if judged.is_empty() && !grounds.is_predicted {
        return decide_verdict_without_cause(grounds, reasons);
    }
    let is_doubted = |judgement: &TermJudgement| {
        !judgement.doubts.is_empty() && judgement.better_law_inputs().is_none()
    };
    if grounds.is_withheld || judged.iter().any(is_doubted) {
        reasons.push(VerdictReason::UnclaimedFinding);
    }
    if judged.iter().any(|judgement| judgement.cause().is_periodic_in_time()) {
        reasons.push(VerdictReason::PeriodicInTime);
    }
    reasons.extend(grounds.unknown_rest.map(VerdictReason::UnexplainedResidual));
    if judged.iter().any(|judgement| {
        judgement.between.as_ref().is_some_and(|between| between.found.is_interpolation_doubtful())
    }) {
        reasons.push(VerdictReason::BetweenPoints);
    }
    // A drift or a jump says of what wanders only that it does.
    let is_of_time = judged.iter().all(|judgement| judgement.cause().tier() > MAX_MACHINE_TIER);
    let wanders =
        grounds.has_drift_above_uncertainty() || is_of_time && grounds.has_drift_above_noise();
    if reasons.is_empty() && !wanders {
        (Verdict::Explained, vec![VerdictReason::NoLackOfFitFound])
    } else {
        (Verdict::PartlyExplained, reasons)
    }
}

/// Returns the verdict where no cause was found.
fn decide_verdict_without_cause(
    grounds: &VerdictEvidence<'_>,
    mut reasons: Vec<VerdictReason>,
) -> (Verdict, Vec<VerdictReason>) {
    let power = grounds.power;
    let does_not_repeat = |statistics: &&RepeatStatistics| {
        statistics.scatter_um > statistics.systematic_um
            && statistics.scatter_um > MAX_REPEATABILITY_STD_UM
    };
    if let Some(repeats) = grounds.repeats.filter(does_not_repeat) {
        reasons.push(VerdictReason::DoesNotRepeat(*repeats));
        return (Verdict::DoNotCompensate, reasons);
    }
    if !reasons.is_empty()
        || grounds.has_drift_above_uncertainty()
        || grounds.has_drift_above_noise()
    {
        return (Verdict::Unexplained, reasons);
    }
    if !power.is_enough {
        return (Verdict::TooLittleData, vec![VerdictReason::InsufficientPower(power.clone())]);
    }
    let reason = if power.is_of_instrument {
        VerdictReason::WithinInstrumentUncertainty
    } else {
        VerdictReason::OnlyNoise
    };
    (if grounds.has_outliers { Verdict::Explained } else { Verdict::Clean }, vec![reason])
}

impl VerdictEvidence<'_> {
    /// Returns whether what wanders is larger than the expanded uncertainty of a reading by what differs from neighbour
    /// to neighbour, where that of the instrument is not stated: what is slower than its noise is structure.
    fn has_drift_above_noise(&self) -> bool {
        let wandering = self.wandering.map_or(0.0, |wandering| wandering.rms_um);
        self.instrument_um.is_none() && wandering > COVERAGE * self.between_neighbours_um
    }

    /// Returns whether what wanders is larger than what the instrument is worth: then it is the machine that does.
    fn has_drift_above_uncertainty(&self) -> bool {
        let wandering = self.wandering.map_or(0.0, |wandering| wandering.rms_um);
        self.instrument_um.is_some_and(|instrument_um| wandering > instrument_um)
    }
}
