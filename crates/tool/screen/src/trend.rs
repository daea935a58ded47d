//! The last minutes of what is watched.

use std::collections::VecDeque;

/// So far back, in s: what a finger, a spindle's start and the first of the heat take.
pub(crate) const TREND_WINDOW_S: f64 = 300.0;
/// The number of series: the growth, three offsets, eight temperatures, and the gauge minus the bridge.
pub(crate) const TREND_SERIES_COUNT: usize = 13;
/// The last of them.
pub(crate) const GAUGE_DIFFERENCE_INDEX: usize = 12;

/// A ring of samples.
#[derive(Clone, Debug, Default)]
pub(crate) struct TrendBuffer {
    samples: VecDeque<(f64, [f64; TREND_SERIES_COUNT])>,
    /// Readings of the gauge that were written down: when, and what, in µm.
    marks: VecDeque<(f64, f64)>,
}

impl TrendBuffer {
    /// Adds what is known at `time_s`; NaN: it is not. Drops what is older than `TREND_WINDOW_S`.
    pub fn push(&mut self, time_s: f64, values: [f64; TREND_SERIES_COUNT]) {
        self.samples.push_back((time_s, values));
        while self.samples.front().is_some_and(|(at, _)| *at < time_s - TREND_WINDOW_S) {
            self.samples.pop_front();
        }
        while self.marks.front().is_some_and(|(at, _)| *at < time_s - TREND_WINDOW_S) {
            self.marks.pop_front();
        }
    }

    /// Adds a reading of the gauge that was written down.
    pub(crate) fn record_gauge_reading(&mut self, time_s: f64, um: f64) {
        self.marks.push_back((time_s, um));
    }

    /// Takes the last one away.
    pub(crate) fn undo_gauge_reading(&mut self) {
        self.marks.pop_back();
    }

    /// Returns the readings as (seconds before the newest sample, µm).
    #[must_use]
    pub(crate) fn gauge_readings(&self) -> Vec<(f64, f64)> {
        let newest_s = self.samples.back().map_or(0.0, |(at, _)| *at);
        self.marks.iter().map(|(at, um)| ((at - newest_s).min(0.0), *um)).collect()
    }

    /// Returns one series as (seconds before the newest, value), without what is not known.
    #[must_use]
    pub fn series(&self, which: usize) -> Vec<(f64, f64)> {
        let newest_s = self.samples.back().map_or(0.0, |(at, _)| *at);
        let points = self.samples.iter().map(|(at, values)| (at - newest_s, values[which]));
        points.filter(|(_, value)| !value.is_nan()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_keeps_five_minutes_and_leaves_out_what_is_not_known() {
        let mut trend = TrendBuffer::default();
        for second in 0..=400_u16 {
            let mut values = [f64::from(second); TREND_SERIES_COUNT];
            values[1] = if second % 2 == 0 { f64::NAN } else { 1.0 };
            trend.push(second.into(), values);
        }
        let growth = trend.series(0);
        assert_eq!((growth.first(), growth.last()), (Some(&(-300.0, 100.0)), Some(&(0.0, 400.0))));
        assert_eq!(trend.series(1).len(), 150);
    }
}
