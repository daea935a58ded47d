//! Why the name of a term is not claimed.

use crate::{search::lack_of_fit::CurveInputs, term_kind::TermKind};

/// A reason not to claim a term.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Caveat {
    /// Another cause, or the same by another column, explains the data as well.
    AlternativeCause(TermKind),
    /// Its values are not identified.
    NotIdentified,
    /// The 95 % interval of its size holds the size at which it does nothing.
    SizeMayBeZero,
    /// A value of it is where its search ends: the best may lie beyond.
    AtSearchBound,
    /// Its time constant is longer than the record: where it ends has not been seen.
    SlowerThanRecord,
    /// It settles from the start on as fast as this term's law: it may be where that law stood when the record
    /// began.
    InitialTransientOf(TermKind),
    /// It may make up for the form of this lagged law.
    ModelFormErrorOf(TermKind),
    /// It gains on one block of the record alone, and nothing on the others together.
    GainsInOneBlock,
    /// The 95 % interval of what it gains on held-out blocks includes zero.
    GainMayBeZero,
    /// A drift or a jump that does not predict the end of the record.
    DoesNotPersist,
    /// A lag that only averages the noise of its thermometer.
    OnlySmoothsNoise,
    /// It gains on held-out blocks only together with this one, or the two take each other's part back.
    OnlyTogether(TermKind),
    /// With one of the rivals of this term in that one's place it is not needed; or the search for this term
    /// ended before its best; or this one is open, and what it lacks may be that.
    DependsOnTerm(TermKind),
    /// This value differs between the halves of the record by more than its intervals: in each.
    HalvesDiffer([f64; 2]),
    /// The same cause with these first values (a period in mm, a time constant in s) does
    /// as well.
    Alias(Vec<f64>),
    /// A curve over these explains clearly more in its place.
    BetterLaw(CurveInputs),
    /// A curve of two values over these does as well.
    EquivalentLaw(CurveInputs),
    /// Curves explain its part as well, and there is something that only they explain.
    NotNeeded,
    /// It is only needed next to a term that stands for another law.
    OnlyNextToOtherLaw,
    /// A wave of what the instrument reads, next to this table over the same position: a table of more points would
    /// take it.
    AbsorbedByFinerTable(TermKind),
    /// The position only grew with the time: this cause of the time is the same.
    SinglePass(&'static str),
    /// A table that its own repeats do not bear out.
    NotRepeatable,
}

impl Caveat {
    /// Returns whether it is doubted how large the term is, if it is anything.
    pub(crate) fn is_size_caveat(&self) -> bool {
        matches!(self, Self::SizeMayBeZero | Self::AtSearchBound | Self::GainsInOneBlock)
    }

    /// Returns whether another record, which begins elsewhere, would show it otherwise.
    pub(crate) fn is_record_specific(&self) -> bool {
        matches!(self, Self::SlowerThanRecord | Self::InitialTransientOf(_))
    }
}
