//! Temperatures behind lags, in drawn rows or in means of rows: what was requested before, what follows from means, and
//! else what all rows give.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
};

use trueup_machine::effect::ThermometerDelay;
use trueup_numerics::parallel::parallel_map;

use super::{
    lag_filter::LagInitialState,
    lag_power_series::{LagPowerSeries, PieceTimes},
    lag_segments::LagSegments,
    row_blocks::RowBlocks,
    table_columns::NamedColumn,
};

/// The rows for which lagged temperatures are requested, of all rows of a table.
#[derive(Clone, Copy)]
pub(super) struct LagRows<'t> {
    pub time_s: Option<&'t [f64]>,
    /// Where a lag begins anew.
    pub restart: &'t [bool],
    pub blocks: &'t RowBlocks,
}

/// Precomputed data for temperatures behind lags, and the columns known so far.
#[derive(Clone, Debug, Default)]
pub(super) struct LagCache {
    /// Where rows are means of a few rows: the temperatures that have no gap, for any lag.
    series: Vec<(String, Arc<LagPowerSeries>)>,
    /// Where there are many rows: the stretches that they are cut into, and the means over them of the
    /// temperatures that have no gap.
    stretches: Option<(Arc<LagSegments>, Vec<NamedColumn>)>,
    /// Columns behind a lag that were requested, the newest last.
    known: Arc<Mutex<VecDeque<LagEntry>>>,
}

/// A column, how late its thermometer is, and the time constants of its rise and fall, in s.
type LagKey = (String, Option<ThermometerDelay>, [f64; 2]);
/// The rows of what was requested.
type LagEntry = (LagKey, Arc<Vec<f64>>);

impl LagCache {
    /// Numbers in the columns that are kept, 8 bytes each: of a few thousand rows enough for a grid of
    /// time constants on each thermometer.
    const MAX_CACHED_VALUES: usize = 2_000_000;

    /// Of these columns.
    pub(super) fn new(rows: LagRows<'_>, columns: &[NamedColumn]) -> Self {
        let mut new = Self::default();
        let Some(time_s) = rows.time_s else { return new };
        let stretches = LagSegments::new(time_s, rows.restart, rows.blocks);
        new.stretches = stretches.map(|segments| (Arc::new(segments), Vec::new()));
        let of_means = new.stretches.is_none() && rows.blocks.has_multirow_blocks();
        let clock =
            if of_means { PieceTimes::new(time_s, rows.restart, rows.blocks) } else { None };
        new.add_gapless_columns(rows, clock.map(Arc::new).as_ref(), columns);
        new
    }

    /// Returns the same where these columns are others.
    pub(super) fn with_changed_columns(&self, rows: LagRows<'_>, columns: &[NamedColumn]) -> Self {
        let is_kept = |name: &str| !columns.iter().any(|(there, _)| there == name);
        let mut changed = Self { known: Arc::default(), ..self.clone() };
        changed.series.retain(|(name, _)| is_kept(name));
        if let Some((_, means)) = &mut changed.stretches {
            means.retain(|(name, _)| is_kept(name));
        }
        changed.add_gapless_columns(
            rows,
            self.series.first().map(|(_, series)| series.piece_times()),
            columns,
        );
        changed
    }

    /// Takes up those of `columns` that have no gap.
    fn add_gapless_columns(
        &mut self,
        rows: LagRows<'_>,
        clock: Option<&Arc<PieceTimes>>,
        columns: &[NamedColumn],
    ) {
        if let Some(clock) = clock {
            let of = |(name, values): &NamedColumn| {
                Some((name.clone(), Arc::new(LagPowerSeries::new(clock, values, rows.blocks)?)))
            };
            self.series.extend(parallel_map(columns, true, of).into_iter().flatten());
        }
        if let (Some((stretches, means)), Some(time_s)) = (&mut self.stretches, rows.time_s) {
            let of = |(name, values): &NamedColumn| {
                Some((name.clone(), stretches.means(values, time_s, rows.restart)?.into()))
            };
            means.extend(columns.iter().filter_map(of));
        }
    }

    /// Returns a column, given by its `values` in all rows, behind a lag from `start` on; `stepped` gives it stepped
    /// through all of them.
    pub(super) fn lagged_column(
        &self,
        blocks: &RowBlocks,
        (column, values, start): (&str, Option<&[f64]>, LagInitialState),
        lags_s @ [rise_s, fall_s]: [f64; 2],
        stepped: impl FnOnce() -> Arc<Vec<f64>>,
    ) -> Arc<Vec<f64>> {
        let series = self.series.iter().find(|(name, _)| name == column && rise_s == fall_s);
        if let (Some((_, series)), Some(values)) = (series, values)
            && rise_s > 0.0
        {
            return series.lagged_means(values, blocks, rise_s, start).into();
        }
        self.memoise(blocks, (column.into(), None, lags_s), || {
            let is_late = lags_s != [0.0; 2];
            let by_means = if is_late { self.segment_means(column, lags_s) } else { None };
            let by_means =
                by_means.map(|(segments, mean_c)| segments.lagged_column(mean_c, lags_s, start));
            by_means.unwrap_or_else(|| blocks.means(&stepped()))
        })
    }

    /// Returns the same for the temperature of the part whose thermometer is late; `lagged` gives what the thermometer
    /// shows behind the same lag.
    pub(super) fn lagged_part_temperature(
        &self,
        blocks: &RowBlocks,
        column: &str,
        late: ThermometerDelay,
        lags_s: [f64; 2],
        lagged: impl FnOnce() -> Arc<Vec<f64>>,
        stepped: impl FnOnce() -> Arc<Vec<f64>>,
    ) -> Arc<Vec<f64>> {
        self.memoise(blocks, (column.into(), Some(late), lags_s), || {
            let is_resolved =
                |(segments, _): &(&LagSegments, _)| segments.min_resolved_lag_s() <= late.by_s;
            let by_means = self.segment_means(column, lags_s).filter(is_resolved);
            let Some((stretches, mean_c)) = by_means else { return blocks.means(&stepped()) };
            let mut part_c = stretches.part_temperature_c(late, mean_c);
            if lags_s[0] != lags_s[1] {
                return stretches.lagged_column(&part_c, lags_s, LagInitialState::Settled);
            }
            // The means give by how much the part is warmer; each row gives what a thermometer shows.
            part_c.iter_mut().zip(mean_c).for_each(|(part_c, mean_c)| *part_c -= mean_c);
            let ahead_c = stretches.lagged_column(&part_c, lags_s, LagInitialState::Settled);
            lagged().iter().zip(ahead_c).map(|(shown_c, ahead_c)| shown_c + ahead_c).collect()
        })
    }

    /// Returns the fastest lag that is reported of this many rows, in s; 0 where all are.
    pub(super) fn min_resolved_lag_s(&self) -> f64 {
        self.stretches.as_ref().map_or(0.0, |(stretches, _)| stretches.min_resolved_lag_s())
    }

    /// Returns the stretches, and the means of `column` over them, if they resolve these lags, or both lags are 0.
    fn segment_means(&self, column: &str, lags_s: [f64; 2]) -> Option<(&LagSegments, &[f64])> {
        let (stretches, means) = self.stretches.as_ref()?;
        let (_, mean_c) = means.iter().find(|(name, _)| name == column)?;
        let is_resolved = |lag_s: f64| stretches.min_resolved_lag_s() <= lag_s;
        let are_resolved = lags_s == [0.0; 2] || lags_s.into_iter().all(is_resolved);
        are_resolved.then_some((stretches, mean_c))
    }

    /// Returns the rows of what may have been requested before.
    fn memoise(
        &self,
        blocks: &RowBlocks,
        asked: LagKey,
        make: impl FnOnce() -> Vec<f64>,
    ) -> Arc<Vec<f64>> {
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, values)) = known().iter().find(|(there, _)| *there == asked) {
            return values.clone();
        }
        let values = Arc::new(make());
        let mut known = known();
        known.push_back((asked, values.clone()));
        if known.len() * blocks.len() > Self::MAX_CACHED_VALUES {
            known.pop_front();
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use std::{cell::Cell, f64::consts::TAU};

    use trueup_machine::{effect::DelayKind, model::part_temperature_c};

    use super::{super::lag_filter::apply_lag, *};

    /// Ten hours.
    const ROWS: usize = 120_000;

    #[test]
    fn in_a_long_record_only_what_is_too_fast_for_its_means_is_stepped_through_its_rows() {
        let time_s: Vec<f64> = (0..ROWS).map(|row| 0.3 * row as f64).collect();
        let restart: Vec<bool> = (0..ROWS).map(|row| row == 0).collect();
        let shown = time_s.iter().map(|t| 20.0 + 5.0 * (TAU * t / 9000.0).sin());
        let values: Vec<f64> = shown.collect();
        // From where no slope is cut short, and the start has passed.
        let blocks = RowBlocks::new((60_000..110_000).filter(|row| row % 41 == 3), |_| true);
        let rows = LagRows { time_s: Some(&time_s), restart: &restart, blocks: &blocks };
        let lags = LagCache::new(rows, &[("t".into(), values.clone().into())]);
        let fastest_s = lags.min_resolved_lag_s();
        assert!((1.0..2.0).contains(&fastest_s), "{fastest_s} s");
        let stepped = Cell::new(0);
        let count = |all: Vec<f64>| {
            stepped.set(stepped.get() + 1);
            all
        };
        let late = |by_s| ThermometerDelay { by_s, form: DelayKind::Lag { slope_over: 1.0 } };
        let [fast_s, slow_s] = [0.5 * fastest_s, 2.0 * fastest_s];
        for (late, lags_s, is_stepped) in [
            (None, [slow_s; 2], false),
            (None, [600.0, 900.0], false),
            (None, [fast_s; 2], true),
            (None, [600.0, fast_s], true),
            (None, [600.0, 0.0], true),
            (Some(late(60.0)), [0.0; 2], false),
            (Some(late(60.0)), [600.0; 2], false),
            (Some(late(60.0)), [600.0, 900.0], false),
            (Some(late(fast_s)), [600.0; 2], true),
            (Some(late(60.0)), [fast_s; 2], true),
        ] {
            let behind = |late: Option<ThermometerDelay>| {
                let part_c = late.map(|late| part_temperature_c(late, &time_s, &values));
                let shown = part_c.as_ref().unwrap_or(&values);
                apply_lag(shown, &time_s, &restart, lags_s, LagInitialState::Settled)
            };
            stepped.set(0);
            let found = match late {
                None => lags.lagged_column(
                    &blocks,
                    ("t", Some(&values), LagInitialState::Settled),
                    lags_s,
                    || count(behind(None)).into(),
                ),
                Some(late) => {
                    let lagged = || blocks.means(&behind(None)).into();
                    let all = || count(behind(Some(late))).into();
                    lags.lagged_part_temperature(&blocks, "t", late, lags_s, lagged, all)
                }
            };
            assert_eq!(stepped.get(), i32::from(is_stepped), "{late:?} {lags_s:?}");
            let exact = blocks.means(&behind(late));
            let off = found.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 3e-4, "{late:?} {lags_s:?}: {off} K");
        }
    }
}
