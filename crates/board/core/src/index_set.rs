//! A set of small numbers: channels, axes, terms of a calibration.

use crate::design_parameters::{MAX_TERMS, TEMPERATURE_CHANNEL_COUNT};

/// A set of numbers from 0 to 15. That all of some are there is one comparison.
///
/// ```
/// use trueup_core::index_set::IndexSet;
/// let mut known = IndexSet::default();
/// known.insert(3);
/// let mut needed = IndexSet::default();
/// assert!(known.is_superset(needed) && !known.intersects(needed));
/// needed.insert(3);
/// needed.insert(5);
/// assert!(!known.is_superset(needed) && known.intersects(needed));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IndexSet(u16);

const _: () = assert!(TEMPERATURE_CHANNEL_COUNT <= u16::BITS as usize);
const _: () = assert!(MAX_TERMS <= u16::BITS as usize);

impl IndexSet {
    /// Takes a number in; one above 15 is in no set.
    pub fn insert(&mut self, number: usize) {
        self.0 |= Self::bit_mask(number);
    }

    /// Takes a number out.
    pub fn remove(&mut self, number: usize) {
        self.0 &= !Self::bit_mask(number);
    }

    /// Takes a number in, or out.
    pub fn set(&mut self, number: usize, is_in: bool) {
        let bit = Self::bit_mask(number);
        self.0 = self.0 & !bit | if is_in { bit } else { 0 };
    }

    /// Returns the numbers of both.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Returns the numbers that are in both.
    #[must_use]
    pub const fn intersection(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Returns whether a number is in it.
    #[must_use]
    pub fn contains(self, number: usize) -> bool {
        self.0 & Self::bit_mask(number) != 0
    }

    /// Returns whether every number of `others` is in it.
    #[must_use]
    pub const fn is_superset(self, others: Self) -> bool {
        others.0 & !self.0 == 0
    }

    /// Returns whether a number of `others` is in it.
    #[must_use]
    pub const fn intersects(self, others: Self) -> bool {
        others.0 & self.0 != 0
    }

    fn bit_mask(number: usize) -> u16 {
        u32::try_from(number).ok().and_then(|number| 1_u16.checked_shl(number)).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_beyond_the_set_is_in_none() {
        let mut set = IndexSet::default();
        for number in [16, 31, 32, usize::MAX] {
            set.insert(number);
            assert_eq!(set, IndexSet::default());
        }
        set.insert(15);
        set.insert(0);
        set.remove(0);
        let mut last = IndexSet::default();
        last.insert(15);
        assert_eq!(set, last);
    }

    #[test]
    fn what_is_in_both_sets_is_in_the_two_together() {
        let of = |numbers: &[usize]| {
            let mut set = IndexSet::default();
            numbers.iter().for_each(|number| set.insert(*number));
            set
        };
        assert_eq!(of(&[0, 3, 15]).union(of(&[3, 4])), of(&[0, 3, 4, 15]));
    }
}
