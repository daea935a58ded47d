//! The verdict, and why.

use std::fmt;

use crate::{
    answer::{report::Verdict, transfer::Transfer},
    judge::Judgement,
    repeats::Repeats,
    search::{
        Found,
        lack_of_fit::{Inputs, LackOfFit},
    },
};

/// A machine whose readings at one position scatter by more (standard deviation, in µm) is no machine
/// to be corrected but one to be mended: its repeatability by ISO 230-2, 4·s, is beyond 20 µm, about
/// the most that ISO 10791-4 lets a machining centre of 2 m have. Less than that may be the noise of
/// the instrument.
const REPEATABLE_UM: f64 = 5.0;

/// Why a verdict is as it is.
#[derive(Clone, Debug)]
pub(crate) enum Reason {
    LackOfFit(LackOfFit),
    /// A term stands for a law that no cause has.
    OtherLaw(Inputs),
    /// Scatter at equal positions, and what repeats.
    DoesNotRepeat(Repeats),
    /// A table holds at its points, and is doubted between them.
    BetweenPoints,
    /// A finding is not claimed.
    Open,
    OnlyNoise,
    NothingFires,
    /// The hold-out is worse with the model as it was found: RMS before and after, in µm.
    Harm {
        before_um: f64,
        after_um: f64,
    },
    /// Where it is worse.
    WorseAt(String),
    /// The hold-out is a little worse.
    NoGainUnseen {
        before_um: f64,
        after_um: f64,
    },
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::LackOfFit(lack) => lack.fmt(f),
            Self::OtherLaw(inputs) => {
                write!(f, "what is wrong goes with {inputs}, and no cause does so")
            }
            Self::DoesNotRepeat(repeats) => write!(
                f,
                "at equal positions the readings scatter by {:.2} µm, more than the {:.2} µm that \
                 repeat: what is corrected today is wrong tomorrow",
                repeats.scatter_um, repeats.systematic_um
            ),
            Self::BetweenPoints => f.write_str(
                "a table holds at its points; what it is worth between them these points cannot show",
            ),
            Self::Open => {
                f.write_str("two causes cannot be told apart, or a parameter is not yet identified")
            }
            Self::OnlyNoise => f.write_str("nothing is left but noise: the model stays"),
            Self::Harm { before_um, after_um } => write!(
                f,
                "what explains the runs makes the hold-out worse: {before_um:.2} µm RMS before, \
                 {after_um:.2} µm with all of it"
            ),
            Self::WorseAt(place) => f.write_str(place),
            Self::NoGainUnseen { before_um, after_um } => write!(
                f,
                "the hold-out gains nothing: {before_um:.4} µm RMS before, {after_um:.4} µm after"
            ),
            Self::NothingFires => f.write_str("no test of structure fires on what is left"),
        }
    }
}

/// The verdict on an answer; `has_outliers`: some readings were set aside; `transfer`: what became of it
/// on a hold-out.
pub(crate) fn verdict(
    found: &Found,
    judged: &[Judgement],
    has_outliers: bool,
    repeats: Option<&Repeats>,
    transfer: Option<&Transfer>,
) -> (Verdict, Vec<Reason>) {
    let (verdict, reasons) = of_runs(found, judged, has_outliers, repeats);
    let Some(transfer) = transfer else { return (verdict, reasons) };
    let (before_um, after_um) = (transfer.before_um, transfer.found_um);
    if !transfer.dropped.is_empty() {
        let mut harm = vec![Reason::Harm { before_um, after_um }];
        harm.extend(transfer.places.iter().cloned().map(Reason::WorseAt));
        harm.extend(reasons.into_iter().filter(|it| !matches!(it, Reason::NothingFires)));
        return (Verdict::DoesNotTransfer, harm);
    }
    if transfer.is_worse() && verdict.is_met() {
        return (Verdict::PartlyExplained, vec![Reason::NoGainUnseen { before_um, after_um }]);
    }
    (verdict, reasons)
}

/// The verdict by the runs alone.
fn of_runs(
    found: &Found,
    judged: &[Judgement],
    has_outliers: bool,
    repeats: Option<&Repeats>,
) -> (Verdict, Vec<Reason>) {
    let mut reasons: Vec<Reason> =
        found.lack_of_fit.iter().cloned().map(Reason::LackOfFit).collect();
    let mut laws: Vec<&Inputs> = Vec::new();
    for law in judged.iter().filter_map(Judgement::other_law) {
        if !laws.contains(&law) {
            laws.push(law);
        }
    }
    reasons.extend(laws.into_iter().cloned().map(Reason::OtherLaw));
    if judged.is_empty() {
        let does_not_repeat =
            |it: &&Repeats| it.scatter_um > it.systematic_um && it.scatter_um > REPEATABLE_UM;
        if let Some(repeats) = repeats.filter(does_not_repeat) {
            reasons.push(Reason::DoesNotRepeat(*repeats));
            return (Verdict::DoNotCompensate, reasons);
        }
        return match (reasons.is_empty(), has_outliers) {
            (false, _) => (Verdict::Unexplained, reasons),
            (true, true) => (Verdict::Explained, reasons),
            (true, false) => (Verdict::Clean, vec![Reason::OnlyNoise]),
        };
    }
    if judged.iter().any(|it| !it.doubts.is_empty() && it.other_law().is_none()) {
        reasons.push(Reason::Open);
    }
    if judged.iter().any(|it| it.between.as_ref().is_some_and(|it| it.found.is_doubted())) {
        reasons.push(Reason::BetweenPoints);
    }
    if reasons.is_empty() {
        (Verdict::Explained, vec![Reason::NothingFires])
    } else {
        (Verdict::PartlyExplained, reasons)
    }
}
