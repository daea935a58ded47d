//! The table that rows were drawn from, or are means of: what has a memory is stepped through all of its rows, or
//! through means of them where that comes to the same.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
};

use trueup_machine::effect::Late;
use trueup_numerics::parallel::on_all_cores;

use super::{
    lag_series::{Clock, LagSeries},
    row_blocks::RowBlocks,
    stretches::Stretches,
    table::{Column, Data},
};

/// The table that rows were drawn from.
#[derive(Clone, Debug)]
pub(crate) struct DrawnFrom {
    pub data: Arc<Data>,
    /// Which of its rows each row is, or is the mean of.
    pub(super) blocks: RowBlocks,
    /// Where rows are means of a few rows: the temperatures that have no gap, for any lag.
    series: Vec<(String, Arc<LagSeries>)>,
    /// Where there are many rows: the stretches that they are cut into, and the means over them of the
    /// temperatures that have no gap.
    stretches: Option<(Arc<Stretches>, Vec<Column>)>,
    /// Columns behind a lag that were asked for, the newest last.
    known: Arc<Mutex<VecDeque<Known>>>,
}

/// A column, how late its thermometer is, and the time constants of its rise and fall, in s.
type Asked = (String, Option<Late>, [f64; 2]);
/// The drawn rows of what was asked for.
type Known = (Asked, Vec<f64>);

impl DrawnFrom {
    /// Numbers in the columns that are kept, 8 bytes each: of a few thousand rows enough for a grid of
    /// time constants on each thermometer.
    const MOST_NUMBERS: usize = 2_000_000;

    pub(super) fn new(data: Arc<Data>, blocks: RowBlocks) -> Self {
        let mut new =
            Self { blocks, series: Vec::new(), stretches: None, known: Arc::default(), data };
        if let Some(time_s) = new.data.time_s.as_deref() {
            let restart = &new.data.restart;
            let stretches = Stretches::new(time_s, restart, &new.blocks);
            new.stretches = stretches.map(|it| (Arc::new(it), Vec::new()));
            let columns = new.data.temperatures.clone();
            if new.stretches.is_none()
                && new.has_means()
                && let Some(clock) = Clock::new(time_s, restart, &new.blocks)
            {
                new.series = new.series_of(&Arc::new(clock), &columns);
            }
            new.learn(&columns);
        }
        new
    }

    /// The same rows of `data`: another table than before in the temperatures of `changed`.
    pub(super) fn of(&self, data: Arc<Data>, changed: &[Column]) -> Self {
        let mut of = Self { data, known: Arc::default(), ..self.clone() };
        let is_kept = |name: &str| !changed.iter().any(|(there, _)| there == name);
        of.series.retain(|(name, _)| is_kept(name));
        if let Some((_, means)) = &mut of.stretches {
            means.retain(|(name, _)| is_kept(name));
        }
        let clock = self.series.first().map(|(_, series)| series.clock());
        if let Some(clock) = clock {
            of.series.extend(of.series_of(clock, changed));
        }
        of.learn(changed);
        of
    }

    /// Of each of `columns` that has no gap.
    fn series_of(&self, clock: &Arc<Clock>, columns: &[Column]) -> Vec<(String, Arc<LagSeries>)> {
        let of = |(name, values): &Column| {
            Some((name.clone(), Arc::new(LagSeries::new(clock, values, &self.blocks)?)))
        };
        on_all_cores(columns, true, of).into_iter().flatten().collect()
    }

    /// Takes the means of `columns` over the stretches.
    fn learn(&mut self, columns: &[Column]) {
        let time_s = self.data.time_s.as_deref().unwrap_or_default();
        if let Some((stretches, means)) = &mut self.stretches {
            let of = |(name, values): &Column| {
                let means = stretches.means(values, time_s, &self.data.restart)?;
                Some((name.clone(), means.into()))
            };
            means.extend(columns.iter().filter_map(of));
        }
    }

    /// Whether rows are means of several.
    pub(super) fn has_means(&self) -> bool {
        self.blocks.has_means()
    }

    /// A column of the whole behind a lag, in the drawn rows.
    pub(crate) fn lagged(&self, column: &str, rise_s: f64, fall_s: f64) -> Vec<f64> {
        let series = self.series.iter().find(|(name, _)| name == column && rise_s == fall_s);
        if let (Some((_, series)), Some(values)) = (series, self.data.temperature(column))
            && rise_s > 0.0
        {
            return series.means(values, &self.blocks, rise_s);
        }
        self.known((column.into(), None, [rise_s, fall_s]), || {
            let is_late = [rise_s, fall_s] != [0.0; 2];
            let by_means = if is_late { self.by_means(column, [rise_s, fall_s]) } else { None };
            let by_means = by_means.map(|(it, mean_c)| it.lagged(mean_c, [rise_s, fall_s]));
            by_means.unwrap_or_else(|| self.pick(&self.data.lagged(column, rise_s, fall_s)))
        })
    }

    /// The same for the temperature of the part whose thermometer is late.
    pub(crate) fn followed(&self, column: &str, late: Late, lags_s: [f64; 2]) -> Vec<f64> {
        self.known((column.into(), Some(late), lags_s), || {
            let is_told = |(it, _): &(&Stretches, _)| it.fastest_s() <= late.by_s;
            let by_means = self.by_means(column, lags_s).filter(is_told);
            let Some((stretches, mean_c)) = by_means else {
                return self.pick(&self.data.followed(column, Some(late), lags_s));
            };
            let [rise_s, fall_s] = lags_s;
            if rise_s != fall_s {
                return stretches.lagged(&stretches.part_c(late, mean_c), lags_s);
            }
            // By how much the part is warmer is told by the means; what a thermometer shows, by each row.
            let mut part_c = self.lagged(column, rise_s, fall_s);
            let mut ahead_c = stretches.part_c(late, mean_c);
            ahead_c.iter_mut().zip(mean_c).for_each(|(part_c, mean_c)| *part_c -= mean_c);
            let ahead_c = stretches.lagged(&ahead_c, lags_s);
            part_c.iter_mut().zip(ahead_c).for_each(|(part_c, ahead_c)| *part_c += ahead_c);
            part_c
        })
    }

    /// The fastest lag that is told of so many rows, in s; 0 where all are.
    pub(super) fn fastest_lag_s(&self) -> f64 {
        self.stretches.as_ref().map_or(0.0, |(stretches, _)| stretches.fastest_s())
    }

    /// The stretches, and the means of `column` over them, if they tell what is behind such lags, or behind none.
    fn by_means(&self, column: &str, lags_s: [f64; 2]) -> Option<(&Stretches, &[f64])> {
        let (stretches, means) = self.stretches.as_ref()?;
        let (_, mean_c) = means.iter().find(|(name, _)| name == column)?;
        let is_told = |lag_s: f64| lag_s == 0.0 || stretches.fastest_s() <= lag_s;
        let is_both = (lags_s[0] == 0.0) == (lags_s[1] == 0.0);
        (is_both && lags_s.into_iter().all(is_told)).then_some((stretches, mean_c))
    }

    /// The drawn rows of what may have been asked for before.
    fn known(&self, asked: Asked, make: impl FnOnce() -> Vec<f64>) -> Vec<f64> {
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, values)) = known().iter().find(|(there, _)| *there == asked) {
            return values.clone();
        }
        let values = make();
        let mut known = known();
        known.push_back((asked, values.clone()));
        if known.len() * self.blocks.len() > Self::MOST_NUMBERS {
            known.pop_front();
        }
        values
    }

    /// Of values for all rows, those of the drawn ones, or their means.
    pub(crate) fn pick(&self, all: &[f64]) -> Vec<f64> {
        self.blocks.means(all)
    }
}
