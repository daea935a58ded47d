//! The effect of a reversal: the reading from the negative side minus that from the positive one.

use super::readings::{PitchReading, PitchReadings};

/// One difference: a position approached from both sides in one run.
#[derive(Clone, Copy)]
pub(super) struct ReversalDifference {
    pub target: usize,
    pub run: usize,
    pub feed: usize,
    pub um: f64,
}

/// Pairs the readings of a position in a run.
pub(super) fn compute_reversal_differences(readings: &PitchReadings) -> Vec<ReversalDifference> {
    let mut order: Vec<_> = readings.list.iter().collect();
    order.sort_by_key(|reading| (reading.target, reading.feed, reading.run, reading.way));
    // Of a record with several readings in a cell, the neighbours.
    let pair = |pair: &[&PitchReading]| match pair {
        [a, b] if (a.target, a.run, a.feed) == (b.target, b.run, b.feed) && a.way < b.way => {
            Some(ReversalDifference { target: a.target, run: a.run, feed: a.feed, um: b.um - a.um })
        }
        _ => None,
    };
    order.windows(2).filter_map(pair).collect()
}
