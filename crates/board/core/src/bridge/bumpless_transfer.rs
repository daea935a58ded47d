//! Which source of the elongation is in use, and how it joins the one before: what `sources` decides,
//! remembered from tick to tick.

use super::source_agreement::{ElongationSample, SourceAgreementMonitor};
use crate::{calibration::ElongationSource, units::Nanometres};

/// The source of the elongation that is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum SelectedSource {
    /// The machine file requires some, but none is fresh.
    #[default]
    Missing,
    /// It requires none.
    Unneeded,
    /// This one.
    Source(ElongationSource),
}

impl SelectedSource {
    pub fn source(self) -> Option<ElongationSource> {
        match self {
            Self::Source(source) => Some(source),
            Self::Unneeded | Self::Missing => None,
        }
    }
}

/// Number of past heat steps kept, one report each: a sensor that freezes is found
/// after 200 ms, and the next source does not go on from its values meanwhile.
pub(super) const HISTORY_STEPS: usize = 4;

/// The source in use, and how it joins the one before.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BumplessTransfer {
    pub selected: SelectedSource,
    /// The last one that was used.
    pub last: Option<ElongationSource>,
    /// The shift added to the elongation by the selected source.
    pub shift: Nanometres,
    /// The part of the way back below a nanometre, in picometres: 0…999.
    pub rest: u32,
    /// An offset was followed, or the first source was there: from then on the elongation goes on.
    pub is_anchored: bool,
    /// The last steps of the heat, the oldest first; `None`: not by this source.
    pub before: [Option<ElongationSample>; HISTORY_STEPS],
    /// For how many steps of the heat the source has been in use.
    pub steps: u32,
    /// How long a better source has been fresh.
    pub returned_ms: u32,
    /// `last` was used before a reset, and nothing has been since.
    pub is_resumed: bool,
    /// Whether the sources grow alike.
    pub agreement: SourceAgreementMonitor,
}

/// The part of a joint that outlasts a reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RetainedTransfer {
    /// The source that was used last.
    pub source: ElongationSource,
    /// The shift added to its elongation.
    pub shift: Nanometres,
}
