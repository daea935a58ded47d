//! The verdict, and why.

use std::fmt;

use trueup_page::micrometres;

use crate::{
    answer::{
        power::Power, report::Verdict, rest::OF_THE_MACHINE, shortfall::Shortfall,
        transfer::Transfer, unknown_rest::UnknownRest, wandering::Wandering,
    },
    judge::Judgement,
    repeats::{REPEATABLE_UM, Repeats},
    search::{
        Found,
        lack_of_fit::{Inputs, LackOfFit},
    },
};

/// A slow drift is structure where it is larger than what differs from reading to reading by more than this factor: it
/// remembers more than three readings.
const SLOWER: f64 = 2.0;

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
    /// The terms were chosen for what they foresee.
    Predicted,
    OnlyNoise,
    /// The residual is as small as the uncertainty of the instrument.
    OfInstrument,
    /// A term that comes and goes with the clock is driven by something that was not recorded.
    ByTheClock,
    /// No error of a size that matters could have been distinguished from noise.
    TooLittle(Power),
    Wanders(Wandering),
    /// What is left may be the machine as well as the gauge.
    UnknownRest(UnknownRest),
    /// The CNC applies the offsets otherwise than once.
    Applied,
    /// It may do so: the bridge was engaged in all rows.
    Engaged,
    NothingFires,
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

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::LackOfFit(lack) => lack.fmt(f),
            Self::OtherLaw(inputs) => {
                write!(f, "what is wrong goes with {inputs}, and no cause does so")
            }
            Self::DoesNotRepeat(repeats) => write!(
                f,
                "at equal positions the readings scatter by {}, more than the {} that repeat: what \
                 is corrected today is wrong tomorrow",
                micrometres(repeats.scatter_um),
                micrometres(repeats.systematic_um)
            ),
            Self::BetweenPoints => f.write_str(
                "a table holds at its points; what it is worth between them these points cannot show",
            ),
            Self::Open => {
                f.write_str("two causes cannot be told apart, or a parameter is not yet identified")
            }
            Self::Predicted => f.write_str(
                "the written terms were chosen for what they foresee: other names may foresee as well",
            ),
            Self::OnlyNoise => f.write_str("nothing is left but noise: the model stays"),
            Self::Harm { before_um, after_um } => write!(
                f,
                "what explains the runs makes the hold-out worse: {} RMS before, {} with all of it",
                micrometres(*before_um),
                micrometres(*after_um)
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
                micrometres(*before_um),
                micrometres(*after_um)
            ),
            Self::OfInstrument => f.write_str(
                "what is left is as small as what the instrument is worth: the model stays",
            ),
            Self::TooLittle(Power { rows, matters_um, needed, .. }) => write!(
                f,
                "{rows} rows cannot tell an error of {} RMS from noise: {needed}",
                micrometres(*matters_um)
            ),
            Self::Wanders(wandering) => wandering.fmt(f),
            Self::UnknownRest(rest) => rest.fmt(f),
            Self::Applied => f.write_str(
                "the CNC applies the offset otherwise than once: the machine file stays until that is put right",
            ),
            Self::Engaged => f.write_str(
                "the bridge was engaged, and how the CNC applies the offset is not known: what is wrong may be the \
                 CNC or the machine file, so nothing is written",
            ),
            Self::ByTheClock => f.write_str(
                "what comes and goes with the clock has a cause that was not recorded; the next record has \
                 another phase",
            ),
            Self::NothingFires => f.write_str("no test of structure fires on what is left"),
        }
    }
}

/// Evidence for a verdict.
pub(super) struct Grounds<'g> {
    pub found: &'g Found,
    pub judged: &'g [Judgement],
    /// Whether some readings were set aside.
    pub has_outliers: bool,
    pub repeats: Option<&'g Repeats>,
    pub power: &'g Power,
    pub wandering: Option<&'g Wandering>,
    /// What is left, where nothing shows that it is the gauge's.
    pub unknown_rest: Option<UnknownRest>,
    /// Scatter from one reading to the next, as a standard deviation of each, in µm.
    pub between_neighbours_um: f64,
    /// The expanded uncertainty of the instrument (95 %), in µm, where that is known.
    pub instrument_um: Option<f64>,
    /// The result of the answer on a hold-out.
    pub transfer: Option<&'g Transfer>,
    /// How the hold-out falls short of the promise, if it does.
    pub shortfall: Option<&'g Shortfall>,
    /// Whether the written terms were chosen for prediction.
    pub is_predicted: bool,
    /// Whether a term is not written because the record does not separate it from another one.
    pub is_withheld: bool,
}

/// Returns the verdict on an answer, and why.
pub(super) fn verdict(grounds: &Grounds<'_>) -> (Verdict, Vec<Reason>) {
    let (verdict, mut reasons) = of_runs(grounds);
    reasons.extend(grounds.wandering.cloned().map(Reason::Wanders));
    let Some(transfer) = grounds.transfer else { return (verdict, reasons) };
    let (before_um, after_um) = (transfer.before_um, transfer.found_um);
    if !transfer.dropped.is_empty() {
        let mut harm = vec![Reason::Harm { before_um, after_um }];
        harm.extend(transfer.places.iter().cloned().map(Reason::WorseAt));
        harm.extend(reasons.into_iter().filter(|it| !matches!(it, Reason::NothingFires)));
        return (Verdict::DoesNotTransfer, harm);
    }
    let comes_first = matches!(verdict, Verdict::TooLittleData | Verdict::DoNotCompensate);
    if let Some(Shortfall { floor, came, most, places }) =
        grounds.shortfall.filter(|_| !comes_first)
    {
        let mut short = vec![Reason::FallsShort { floor: *floor, came: *came, most: *most }];
        short.extend(places.iter().cloned().map(Reason::DiffersIn));
        short.extend(reasons.into_iter().filter(|it| !matches!(it, Reason::NothingFires)));
        return (Verdict::FallsShort, short);
    }
    if transfer.is_worse() && verdict.is_met() {
        return (Verdict::PartlyExplained, vec![Reason::NoGainUnseen { before_um, after_um }]);
    }
    (verdict, reasons)
}

/// Returns the verdict by the runs alone.
fn of_runs(grounds: &Grounds<'_>) -> (Verdict, Vec<Reason>) {
    let Grounds { found, judged, .. } = *grounds;
    let mut reasons: Vec<Reason> =
        found.lack_of_fit.iter().cloned().map(Reason::LackOfFit).collect();
    let mut laws: Vec<&Inputs> = Vec::new();
    for law in judged.iter().filter_map(Judgement::other_law) {
        if !laws.contains(&law) {
            laws.push(law);
        }
    }
    reasons.extend(laws.into_iter().cloned().map(Reason::OtherLaw));
    if grounds.is_predicted {
        reasons.push(Reason::Predicted);
    }
    if judged.is_empty() && !grounds.is_predicted {
        return of_nothing_found(grounds, reasons);
    }
    let is_doubted = |it: &Judgement| !it.doubts.is_empty() && it.other_law().is_none();
    if grounds.is_withheld || judged.iter().any(is_doubted) {
        reasons.push(Reason::Open);
    }
    if judged.iter().any(|it| it.cause().is_by_the_clock()) {
        reasons.push(Reason::ByTheClock);
    }
    reasons.extend(grounds.unknown_rest.map(Reason::UnknownRest));
    if judged.iter().any(|it| it.between.as_ref().is_some_and(|it| it.found.is_doubted())) {
        reasons.push(Reason::BetweenPoints);
    }
    // A drift or a jump says of what wanders only that it does.
    let is_of_time = judged.iter().all(|it| it.cause().tier() > OF_THE_MACHINE);
    let wanders =
        grounds.wanders_beyond_instrument() || is_of_time && grounds.wanders_beyond_neighbours();
    if reasons.is_empty() && !wanders {
        (Verdict::Explained, vec![Reason::NothingFires])
    } else {
        (Verdict::PartlyExplained, reasons)
    }
}

/// Returns the verdict where no cause was found.
fn of_nothing_found(grounds: &Grounds<'_>, mut reasons: Vec<Reason>) -> (Verdict, Vec<Reason>) {
    let power = grounds.power;
    let does_not_repeat =
        |it: &&Repeats| it.scatter_um > it.systematic_um && it.scatter_um > REPEATABLE_UM;
    if let Some(repeats) = grounds.repeats.filter(does_not_repeat) {
        reasons.push(Reason::DoesNotRepeat(*repeats));
        return (Verdict::DoNotCompensate, reasons);
    }
    if !reasons.is_empty()
        || grounds.wanders_beyond_instrument()
        || grounds.wanders_beyond_neighbours()
    {
        return (Verdict::Unexplained, reasons);
    }
    if !power.is_enough {
        return (Verdict::TooLittleData, vec![Reason::TooLittle(power.clone())]);
    }
    let reason = if power.is_of_instrument { Reason::OfInstrument } else { Reason::OnlyNoise };
    (if grounds.has_outliers { Verdict::Explained } else { Verdict::Clean }, vec![reason])
}

impl Grounds<'_> {
    /// Returns whether what wanders is larger than what differs from reading to reading, where the instrument's
    /// uncertainty is not known: the noise of an instrument is that between neighbours, and what is slower is
    /// structure.
    fn wanders_beyond_neighbours(&self) -> bool {
        let wandering = self.wandering.map_or(0.0, |wandering| wandering.rms_um);
        self.instrument_um.is_none() && wandering > SLOWER * self.between_neighbours_um
    }

    /// Returns whether what wanders is larger than what the instrument is worth: then it is the machine that does.
    fn wanders_beyond_instrument(&self) -> bool {
        let wandering = self.wandering.map_or(0.0, |wandering| wandering.rms_um);
        self.instrument_um.is_some_and(|instrument_um| wandering > instrument_um)
    }
}
