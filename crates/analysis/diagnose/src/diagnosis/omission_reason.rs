//! Why a term that the board could run is not written, and which measurement would settle it.

use trueup_page::format_micrometres;

/// Why a term that the board could run is not written.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum OmissionReason {
    /// Next to what the board does not run its size is not known, or it gains nothing.
    DependsOnUncompensatedTerm,
    /// It does this much, and what was measured is this much.
    TooLarge { um: f64, measured_um: f64 },
    /// The sum of the terms is this much in a state that was not measured; the measured range.
    LeavesRange { um: f64, range_um: [f64; 2], since_start_s: f64 },
    /// `compile` would refuse the file.
    Rejected(String),
    /// Other terms predict held-out parts better.
    PredictsWorse,
    /// Alone on the board the terms make the same readings worse, or predict held-out blocks no better.
    NoGain,
}

impl OmissionReason {
    /// Returns whether the record does not separate the term from what takes it back.
    pub(crate) fn is_inseparable(&self) -> bool {
        !matches!(self, Self::DependsOnUncompensatedTerm | Self::NoGain | Self::PredictsWorse)
    }

    /// In a sentence.
    pub(crate) fn sentence(&self) -> String {
        match self {
            Self::DependsOnUncompensatedTerm => {
                "Next to what the board does not run its size is not known: it is not compensated."
                    .into()
            }
            Self::TooLarge { um, measured_um } => format!(
                "It would do {}, and no more than {} were measured: another term takes it back, so that it is not \
                 compensated.",
                format_micrometres(*um),
                format_micrometres(*measured_um)
            ),
            Self::LeavesRange { um, range_um: [low, high], since_start_s } => format!(
                "With it the prediction would be {um:+.0} µm {:.0} min after a start at a corner of the recorded inputs. Measured were {low:+.0} to {high:+.0} µm: it is not compensated.",
                since_start_s / 60.0
            ),
            Self::Rejected(rule) => format!("It is not written: {rule}."),
            Self::PredictsWorse => {
                "Other terms predict held-out parts better and are written in its place: it is not compensated.".into()
            }
            Self::NoGain => {
                "Alone on the board these terms bring no significant gain: it is not compensated."
                    .into()
            }
        }
    }

    /// The measurement that separates what takes each other back.
    pub(crate) const SEPARATION_TEST_INSTRUCTION: &'static str = "Record the first hour after a \
        start from cold with a reading each minute, and once more on another day. Only that \
        separates a constant, a first rise and its time constant.";
}
