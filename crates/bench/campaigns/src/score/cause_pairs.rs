//! All pairs of causes that one machine can have, and the score of an answer to both.
//!
//! Two causes may do the same, or nearly take each other away: a pair has to be named where each does as
//! much as the noise that the other could not do.

use super::hidden_effect::{HiddenEffectScore, run_diagnosis, score_diagnosis};
use crate::{
    hidden_effects::{ExpectedDiagnosis, HiddenCause, TestCase, draw_test_case_with_cause_pair},
    orthogonal_component::orthogonal_component_rms,
};

/// The size of a cause, RMS over that of the noise.
pub const EFFECT_TO_NOISE_RATIO: f64 = 3.0;
/// The least share of distinguishable draws in which both are named and nothing else is claimed.
pub const MIN_CORRECT_FRACTION: f64 = 0.95;
/// The largest share of them in which another cause is claimed.
pub const MAX_INCORRECT_FRACTION: f64 = 0.01;
/// A 95 % interval leaves one honest value in twenty outside; at twice its width, 3.9 standard
/// deviations of a normal distribution, one in ten thousand.
const INTERVAL_WIDENING_FACTOR: f64 = 2.0;
/// Of the possible gain on the hold-out, what the worst answer that claims all must reach.
const MIN_FRACTION_OF_POSSIBLE_GAIN: f64 = 0.85;

/// A cause, and what is a part of it already: a table, each way one, has all that hangs on position and
/// direction alone; another reference of a temperature or of a lever is a slope over the axis.
const NESTED_CAUSES: [(HiddenCause, HiddenCause); 7] = [
    (HiddenCause::FeedDependentBacklash, HiddenCause::Backlash),
    (HiddenCause::PitchError, HiddenCause::PitchScale),
    (HiddenCause::PitchError, HiddenCause::PitchPeriodic),
    (HiddenCause::PitchError, HiddenCause::Backlash),
    (HiddenCause::PitchError, HiddenCause::PositionDependentBacklash),
    (HiddenCause::AxisExpansion, HiddenCause::PitchScale),
    (HiddenCause::AngularError, HiddenCause::PitchScale),
];

/// Returns the causes with a name of their own.
#[must_use]
pub fn named_causes() -> Vec<HiddenCause> {
    let is_named = |cause: &HiddenCause| {
        matches!(
            cause.expected_diagnosis(),
            ExpectedDiagnosis::Compensated | ExpectedDiagnosis::Reported
        ) && cause.name() == cause.expected_name()
    };
    HiddenCause::ALL.iter().copied().filter(is_named).collect()
}

/// Returns what is wrong with the values of an answer: an interval that is far off, a gain that is missing.
#[must_use]
pub fn find_value_errors(score: &HiddenEffectScore) -> Vec<String> {
    let far = score
        .intervals
        .iter()
        .filter(|interval| !interval.contains_true_value(INTERVAL_WIDENING_FACTOR));
    let mut faults: Vec<String> = far.map(|far| format!("{far:?}")).collect();
    if score.share_of_gain < MIN_FRACTION_OF_POSSIBLE_GAIN {
        faults.push(format!("{:.3} of the possible gain", score.share_of_gain));
    }
    faults
}

/// Two causes of one machine.
#[derive(Clone, Copy)]
pub struct CausePair(pub HiddenCause, pub HiddenCause);

/// The score of a pair.
pub struct PairScore {
    /// The score by the rules of the score card.
    pub score: HiddenEffectScore,
    /// Both are named, claimed or not, and nothing else is claimed.
    pub is_right: bool,
}

impl CausePair {
    /// Returns all whose causes stand next to each other.
    #[must_use]
    pub fn all_compatible() -> Vec<Self> {
        let all = named_causes();
        let of = |number: usize| all[number + 1..].iter().map(move |b| (number, *b));
        let both = (0..all.len()).flat_map(of).map(|(a, b)| Self(all[a], b));
        both.filter(|Self(a, b)| a.is_compatible_with(*b)).collect()
    }

    /// Returns both names, joined by `+`.
    #[must_use]
    pub fn name(self) -> String {
        format!("{}+{}", self.0.name(), self.1.name())
    }

    /// Diagnoses the machine of `seed` with both, and scores the answer; `None` where its record cannot distinguish them.
    ///
    /// # Panics
    /// A pair of [`Self::all_compatible`] can be drawn.
    #[must_use]
    pub fn diagnose_and_score(self, seed: u64) -> Option<PairScore> {
        let Self(a, b) = self;
        let challenge = draw_test_case_with_cause_pair(a, b, EFFECT_TO_NOISE_RATIO, seed)
            .expect("a record holds both");
        if !self.is_distinguishable(&challenge) {
            return None;
        }
        let score = score_diagnosis(&challenge, &run_diagnosis(&challenge));
        let is_named = |cause: HiddenCause| {
            score.named.iter().chain(&score.unclaimed).any(|name| name == cause.expected_name())
        };
        let is_right = is_named(a) && is_named(b) && !score.is_wrong;
        Some(PairScore { score, is_right })
    }

    /// Returns whether neither is a part of the other, and each does as much as the noise that the other could
    /// not do.
    fn is_distinguishable(self, challenge: &TestCase) -> bool {
        let [a, b] = &challenge.truth.effects[..] else { return false };
        let noise_um = challenge.truth.noise_rms_um;
        !NESTED_CAUSES.contains(&(self.0, self.1))
            && !NESTED_CAUSES.contains(&(self.1, self.0))
            && orthogonal_component_rms(&a.um, &[&b.um]) >= noise_um
            && orthogonal_component_rms(&b.um, &[&a.um]) >= noise_um
    }
}
