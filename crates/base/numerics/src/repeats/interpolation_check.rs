//! Whether a table may be trusted between its places: each inner place predicted by the line between its
//! two neighbours, at twice the distance that the table itself bridges.

use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::{
    reading::RepeatReading,
    table_fit::{TableFit, TableLaw},
    table_selection::SIGNIFICANCE_LEVEL,
};

/// A gain is judged on at least this many blocks (`docs/reference.md`, Diagnosis): here inner places.
const MIN_INTERIOR_POSITIONS: usize = 6;
/// The line must explain this much of the squares of what it predicts: the same R² that a law must have of
/// what depends on its inputs.
pub const MIN_R_SQUARED: f64 = 0.9;

/// Misses of neighbours share places. Of this many the sum of squares scatters like that of this share of
/// independent ones (Satterthwaite; even steps: covariances of 1.5, −1 and 0.25 give 1.5²/(1.5² + 2·1² +
/// 2·0.25²)).
const SATTERTHWAITE_DOF_FRACTION: f64 = 18.0 / 35.0;

/// The result of leaving out places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InterpolationCheck {
    /// Inner places that were predicted.
    pub inner: usize,
    /// Error of the line between the neighbours at them: root mean square, in the readings' unit.
    pub line: f64,
    /// Error of the mean of all other places at them, likewise.
    pub nothing: f64,
    /// Whether the line misses more than the scatter of the repeats would let it.
    pub is_beyond_scatter: bool,
}

impl InterpolationCheck {
    /// R² of the line; below 0 where it is worse than nothing.
    #[must_use]
    pub(crate) fn r_squared(&self) -> f64 {
        1.0 - (self.line / self.nothing).powi(2)
    }

    /// Returns whether there are enough inner places to judge by.
    #[must_use]
    pub fn has_enough_interior_positions(&self) -> bool {
        self.inner >= MIN_INTERIOR_POSITIONS
    }

    /// Returns whether use between the places is doubted: the line could have predicted them, and did not.
    #[must_use]
    pub fn is_interpolation_doubtful(&self) -> bool {
        self.has_enough_interior_positions()
            && self.is_beyond_scatter
            && self.r_squared() < MIN_R_SQUARED
    }
}

/// Predicts the inner of the places `at` (rising) by `law`; none without an inner place or repeats.
#[must_use]
pub fn check_interpolation(
    at: &[f64],
    readings: &[RepeatReading],
    aside: &[bool],
    law: TableLaw,
) -> Option<InterpolationCheck> {
    let used = || {
        let all = readings.iter().zip(aside);
        all.filter(|(reading, aside)| !**aside && reading.value.is_finite())
            .map(|(reading, _)| reading)
    };
    let table = TableFit::fit(law, at.len(), used());
    let mut counts = [vec![0.0; at.len()], vec![0.0; at.len()]];
    let mut squares = 0.0;
    for it in used() {
        counts[it.side][it.place] += 1.0;
        squares += (it.value - table.value_at(it.place, it.side)).powi(2);
    }
    let freedom =
        used().count().checked_sub(table.constants).filter(|freedom| *freedom > 0)? as f64;
    let variance = squares / freedom;
    let (mut line, mut nothing, mut by_scatter, mut count) = (0.0, 0.0, 0.0, 0.0);
    let mut inner = vec![false; at.len()];
    let sides: &[usize] = if law == TableLaw::EachSide { &[0, 1] } else { &[0] };
    for &side in sides {
        let number = |place: usize| match law {
            TableLaw::EachSide => counts[side][place],
            _ => counts[0][place] + counts[1][place],
        };
        let there: Vec<usize> =
            (0..at.len()).filter(|&place| !table.values[side][place].is_nan()).collect();
        let value = |place: usize| table.values[side][place];
        let sum: f64 = there.iter().map(|&place| value(place)).sum();
        for three in there.windows(3) {
            let &[low, here, high] = three else { continue };
            let share = (at[here] - at[low]) / (at[high] - at[low]);
            let predicted = (1.0 - share) * value(low) + share * value(high);
            let mean = (sum - value(here)) / (there.len() - 1) as f64;
            line += (value(here) - predicted).powi(2);
            nothing += (value(here) - mean).powi(2);
            by_scatter += variance
                * (1.0 / number(here)
                    + (1.0 - share).powi(2) / number(low)
                    + share.powi(2) / number(high));
            count += 1.0;
            inner[here] = true;
        }
    }
    if count < 1.0 {
        return None;
    }
    let chance = FisherSnedecor::new(SATTERTHWAITE_DOF_FRACTION * count, freedom)
        .map_or(1.0, |distribution| distribution.sf(line / by_scatter));
    Some(InterpolationCheck {
        inner: inner.iter().filter(|inner| **inner).count(),
        line: (line / count).sqrt(),
        nothing: (nothing / count).sqrt(),
        is_beyond_scatter: line > 0.0 && (by_scatter <= 0.0 || chance < SIGNIFICANCE_LEVEL),
    })
}
