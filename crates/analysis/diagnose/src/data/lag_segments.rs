//! Lags that are slow next to the rows of a long record, stepped from mean to mean.
//!
//! A lag need not be stepped through every row: over a stretch of length Δ that is short next to τ, the mean X of the
//! column does what its rows do one by one,
//!
//! ```text
//! s ← s + (X − s)·(1 − e^(−Δ/τ))
//! ```
//!
//! and a row within it lies on the line between the values at both ends. Of a column that rises steadily the lag is
//! wrong by (Δ/τ)²/12 of itself so, and after a jump by (Δ/τ)²/8 of the jump. It begins with the mean over the first
//! stretch, and not with one reading and its noise.

use trueup_machine::{effect::ThermometerDelay, model::part_temperature_from_means_c};

use super::{
    lag_filter::{LagInitialState, apply_lag},
    row_blocks::RowBlocks,
};

/// Stretches in all of a record, or a few more; of no more rows than twice as many each is stepped through.
const NOMINAL_LAG_SEGMENTS: usize = 50_000;
/// The longest stretch, in time constants, that resolves a lag: by what stands above it is wrong by 2 % of itself
/// then, and by 3 % of a jump. Faster lags are not looked for in so long a record.
const MAX_SEGMENT_TO_TIME_CONSTANT_RATIO: f64 = 0.5;

/// Stretches of rows that follow each other, and how the rows that are asked for lie among them.
#[derive(Debug)]
pub(super) struct LagSegments {
    /// Where each ends among the rows.
    ends: Vec<u32>,
    /// Where the lag begins anew.
    begins: Vec<bool>,
    /// The time of the last row of each, and of the mean over each.
    end_s: Vec<f64>,
    mean_s: Vec<f64>,
    /// How far the rows of each are from each other, in the mean.
    apart_s: Vec<f64>,
    /// The longest of those with several rows.
    longest_s: f64,
    /// Weights by which the rows asked for follow from the values at the ends, and from the means.
    of_ends: InterpolationWeights,
    of_means: InterpolationWeights,
}

impl LagSegments {
    /// None where a time is missing, or there are not many rows.
    pub(super) fn new(time_s: &[f64], restart: &[bool], blocks: &RowBlocks) -> Option<Self> {
        if time_s.len() < 2 * NOMINAL_LAG_SEGMENTS || time_s.iter().any(|time_s| time_s.is_nan()) {
            return None;
        }
        let rows = time_s.len();
        let record_s: f64 = (0..rows).map(|row| elapsed_s(time_s, restart, row)).sum();
        let mut it = Self {
            ends: Vec::new(),
            begins: Vec::new(),
            end_s: Vec::new(),
            mean_s: Vec::new(),
            apart_s: Vec::new(),
            longest_s: 0.0,
            of_ends: InterpolationWeights::default(),
            of_means: InterpolationWeights::default(),
        };
        let mut first = 0;
        while first < rows {
            let start_s = if restart[first] { time_s[first] } else { time_s[first - 1] };
            let belongs = |&row: &usize| {
                !restart[row] && time_s[row] - start_s <= record_s / NOMINAL_LAG_SEGMENTS as f64
            };
            // A row that is alone holds its value over any time.
            let end = (first + 1..rows).find(|row| !belongs(row)).unwrap_or(rows);
            let span_s = time_s[end - 1] - start_s;
            if end - first > 1 {
                it.longest_s = it.longest_s.max(span_s);
            }
            it.ends.push(end as u32);
            it.begins.push(restart[first]);
            it.end_s.push(time_s[end - 1]);
            it.apart_s.push(span_s.max(0.0) / (end - first) as f64);
            first = end;
        }
        if 2 * it.ends.len() > rows {
            return None;
        }
        it.mean_s = it.means(time_s, time_s, restart)?;
        it.of_ends = InterpolationWeights::new(blocks, it.end_interpolator(time_s));
        it.of_means = InterpolationWeights::new(blocks, it.mean_interpolator(time_s));
        Some(it)
    }

    /// Returns the mean of a column over each; none where a value is missing.
    pub(super) fn means(
        &self,
        values: &[f64],
        time_s: &[f64],
        restart: &[bool],
    ) -> Option<Vec<f64>> {
        let mut first = 0;
        let means: Vec<f64> = self
            .ends
            .iter()
            .map(|&end| {
                let rows = std::mem::replace(&mut first, end as usize)..end as usize;
                // The first row of a series held for no time that is known.
                let alone = values[rows.start];
                let mut sums = [0.0; 2];
                for row in rows {
                    let held_s = elapsed_s(time_s, restart, row);
                    sums[0] += held_s * values[row];
                    sums[1] += held_s;
                }
                if sums[1] > 0.0 { sums[0] / sums[1] } else { alone }
            })
            .collect();
        (!means.iter().any(|mean| mean.is_nan())).then_some(means)
    }

    /// Returns the fastest lag that they resolve, in s.
    pub(super) fn min_resolved_lag_s(&self) -> f64 {
        self.longest_s / MAX_SEGMENT_TO_TIME_CONSTANT_RATIO
    }

    /// Returns the temperature of the part whose thermometer is late, from that in each stretch.
    pub(super) fn part_temperature_c(&self, late: ThermometerDelay, mean_c: &[f64]) -> Vec<f64> {
        let count = self.begins.len();
        let starts = (0..count).filter(|&n| self.begins[n]);
        let ends = (1..count).filter(|&n| self.begins[n]).chain([count]);
        let of = |(start, end): (usize, usize)| {
            let [times_s, apart_s, mean_c] =
                [&self.mean_s, &self.apart_s, mean_c].map(|list| &list[start..end]);
            part_temperature_from_means_c(late, times_s, apart_s, mean_c)
        };
        starts.zip(ends).flat_map(of).collect()
    }

    /// Returns the rows that are asked for of a column, given by its means, behind a lag.
    pub(super) fn lagged_column(
        &self,
        means: &[f64],
        lags_s: [f64; 2],
        start: LagInitialState,
    ) -> Vec<f64> {
        if lags_s == [0.0; 2] {
            return self.of_means.weighted_sums(means);
        }
        self.of_ends.weighted_sums(&apply_lag(means, &self.end_s, &self.begins, lags_s, start))
    }

    /// Where each row lies among what is known at the ends: after which, and how far on the way to the next.
    fn end_interpolator<'a>(&'a self, time_s: &'a [f64]) -> impl FnMut(usize) -> (usize, f64) + 'a {
        let mut at = 0;
        move |row| {
            while row >= self.ends[at] as usize {
                at += 1;
            }
            // The lag begins with what it is at the first end.
            if self.begins[at] {
                return (at, 0.0);
            }
            let [start_s, end_s] = [self.end_s[at - 1], self.end_s[at]];
            let share = (time_s[row] - start_s) / (end_s - start_s);
            (at - 1, if end_s > start_s { share.clamp(0.0, 1.0) } else { 1.0 })
        }
    }

    /// Returns the same among the means; beyond the first and the last of a series, theirs.
    fn mean_interpolator<'a>(
        &'a self,
        time_s: &'a [f64],
    ) -> impl FnMut(usize) -> (usize, f64) + 'a {
        let mut at = 0;
        move |row| {
            while row >= self.ends[at] as usize {
                at += 1;
            }
            let low = if time_s[row] >= self.mean_s[at] || self.begins[at] { at } else { at - 1 };
            if self.begins.get(low + 1).copied().unwrap_or(true) {
                return (low, 0.0);
            }
            let [start_s, end_s] = [self.mean_s[low], self.mean_s[low + 1]];
            let share = (time_s[row] - start_s) / (end_s - start_s);
            (low, if end_s > start_s { share.clamp(0.0, 1.0) } else { 0.0 })
        }
    }
}

/// From the row before to a row, in s; 0 where the lag begins anew.
fn elapsed_s(time_s: &[f64], restart: &[bool], row: usize) -> f64 {
    if restart[row] { 0.0 } else { (time_s[row] - time_s[row - 1]).max(0.0) }
}

/// Means of rows as sums over what is known elsewhere: of each, neighbours from a first one on.
#[derive(Debug, Default)]
struct InterpolationWeights {
    first: Vec<u32>,
    /// Where those of each end.
    ends: Vec<u32>,
    weights: Vec<f64>,
}

impl InterpolationWeights {
    /// `along`: after which of the known each row lies, and how far on the way to the next one, 0…1.
    fn new(blocks: &RowBlocks, mut along: impl FnMut(usize) -> (usize, f64)) -> Self {
        let mut it = Self::default();
        for rows in blocks.rows_by_block() {
            let start = it.weights.len();
            let mut first = None;
            for &row in rows {
                let (after, share) = along(row as usize);
                let place = start + after - *first.get_or_insert(after);
                for (place, share) in [(place, 1.0 - share), (place + 1, share)] {
                    if share > 0.0 {
                        it.weights.resize(it.weights.len().max(place + 1), 0.0);
                        it.weights[place] += share / rows.len() as f64;
                    }
                }
            }
            it.first.push(first.unwrap_or(0) as u32);
            it.ends.push(it.weights.len() as u32);
        }
        it
    }

    fn weighted_sums(&self, known: &[f64]) -> Vec<f64> {
        let mut start = 0;
        let each = self.first.iter().zip(&self.ends);
        each.map(|(&first, &end)| {
            let weights = &self.weights[std::mem::replace(&mut start, end as usize)..end as usize];
            weights.iter().zip(&known[first as usize..]).map(|(weight, value)| weight * value).sum()
        })
        .collect()
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use trueup_machine::{effect::DelayKind, model::part_temperature_c};

    use super::*;

    const ROWS: usize = 2 * NOMINAL_LAG_SEGMENTS + 20_000;

    /// Returns two series of uneven times, one right after the other, with a pause in the first.
    fn times() -> (Vec<f64>, Vec<bool>) {
        let mut now_s = 0.0;
        let time_s = (0..ROWS).map(|row| {
            now_s += 0.05 * (1.0 + 0.5 * ((row * row) as f64).sin());
            if row == 20_000 {
                now_s += 600.0;
            }
            now_s
        });
        (time_s.collect(), (0..ROWS).map(|row| row == 0 || row == ROWS / 2).collect())
    }

    /// Returns what changes by 5 K in minutes; in the second series 3 K more.
    fn smooth(time_s: &[f64]) -> Vec<f64> {
        let more_c = |row: usize| if row < ROWS / 2 { 0.0 } else { 3.0 };
        let shown = |(row, t): (usize, &f64)| 20.0 + 5.0 * (TAU * t / 900.0).sin() + more_c(row);
        time_s.iter().enumerate().map(shown).collect()
    }

    /// Returns the same, and trembles by a hundredth.
    fn column(time_s: &[f64]) -> Vec<f64> {
        let trembling = |(row, c): (usize, f64)| c + 0.01 * ((row * 37) as f64).sin();
        smooth(time_s).into_iter().enumerate().map(trembling).collect()
    }

    #[test]
    fn a_slow_lag_of_means_is_that_of_the_rows() {
        let (time_s, restart) = times();
        let values = column(&time_s);
        let single = RowBlocks::new((0..ROWS).filter(|row| row % 41 == 3), |_| true);
        let of_means = RowBlocks::new((0..ROWS).filter(|row| row % 17 != 3), |row| {
            row % 500 == 0 || row == ROWS / 2
        });
        for blocks in [single, of_means] {
            let it = LagSegments::new(&time_s, &restart, &blocks).expect("many rows");
            let means = it.means(&values, &time_s, &restart).expect("no gap");
            let fastest_s = it.min_resolved_lag_s();
            // At 0.035 K/s half of a stretch is 2 mK, which a series begins with. What trembles up and down, and is
            // followed faster one way, is a level of its own.
            for (lags_s, most_c) in [
                ([fastest_s; 2], 2.5e-3),
                ([1.5, 1.5], 4e-4),
                ([30.0, 30.0], 4e-5),
                ([300.0, 30.0], 2e-4),
                ([30.0, 300.0], 2e-4),
            ] {
                let stepped = blocks.means(&apply_lag(
                    &values,
                    &time_s,
                    &restart,
                    lags_s,
                    LagInitialState::Settled,
                ));
                let lagged = it.lagged_column(&means, lags_s, LagInitialState::Settled);
                assert_eq!(lagged.len(), stepped.len());
                let has_begun = |row: usize| {
                    let start = if row < ROWS / 2 { 0 } else { ROWS / 2 };
                    time_s[row] - time_s[start] > 6.0 * lags_s[0].max(lags_s[1])
                };
                let off = blocks.first_rows().into_iter().zip(lagged.iter().zip(&stepped));
                let off = off.filter(|(row, _)| has_begun(*row)).map(|(_, (a, b))| (a - b).abs());
                let off = off.fold(0.0, f64::max);
                println!("{lags_s:?} s: {off:.1e} K");
                assert!(off < most_c, "{lags_s:?} s: {off}");
            }
        }
    }

    #[test]
    fn what_a_part_is_warmer_than_a_late_thermometer_is_that_of_the_rows() {
        let (time_s, restart) = times();
        let smooth = smooth(&time_s);
        let blocks =
            RowBlocks::new((0..ROWS).filter(|row| row % 41 == 3 || row + 1 == ROWS / 2), |_| true);
        let it = LagSegments::new(&time_s, &restart, &blocks).expect("many rows");
        let means = it.means(&smooth, &time_s, &restart).expect("no gap");
        let half = ROWS / 2;
        for late in [
            ThermometerDelay { by_s: 20.0, form: DelayKind::Lag { slope_over: 1.0 } },
            ThermometerDelay { by_s: 60.0, form: DelayKind::Lag { slope_over: 0.5 } },
            ThermometerDelay { by_s: 60.0, form: DelayKind::Delay },
        ] {
            assert!(it.min_resolved_lag_s() <= late.by_s);
            let mut part_c = part_temperature_c(late, &time_s[..half], &smooth[..half]);
            part_c.extend(part_temperature_c(late, &time_s[half..], &smooth[half..]));
            let of_means = it.part_temperature_c(late, &means);
            for lags_s in [[0.0; 2], [100.0; 2]] {
                let stepped = blocks.means(&apply_lag(
                    &part_c,
                    &time_s,
                    &restart,
                    lags_s,
                    LagInitialState::Settled,
                ));
                let lagged = it.lagged_column(&of_means, lags_s, LagInitialState::Settled);
                assert_eq!(lagged.len(), stepped.len());
                // At an end and a pause a slope is over less; a row is not as far from the one before it as the
                // rows around it are. This record begins in motion: its first row counts as settled, the first
                // mean does not, and a lag forgets that by e⁻¹⁰.
                let [mut inside, mut all] = [0.0_f64; 2];
                for ((row, a), b) in blocks.first_rows().into_iter().zip(&lagged).zip(&stepped) {
                    let is_near = |edge: usize| row.abs_diff(edge) < 3000;
                    let off = (a - b).abs();
                    let from_start_s = time_s[row] - time_s[if row < half { 0 } else { half }];
                    if from_start_s <= 10.0 * lags_s[0] {
                        continue;
                    }
                    all = all.max(off);
                    if ![0, 20_000, half, ROWS].iter().any(|&edge| is_near(edge)) {
                        inside = inside.max(off);
                    }
                }
                println!("{late:?}, {lags_s:?} s: {inside:.1e} K inside, {all:.1e} K");
                assert!(inside < 7e-4 && all < 5e-3, "{late:?}, {lags_s:?} s: {inside} {all}");
            }
        }
    }

    #[test]
    fn few_rows_or_a_gap_have_none() {
        let (time_s, restart) = times();
        let blocks = RowBlocks::new(0..ROWS, |_| true);
        let it = LagSegments::new(&time_s, &restart, &blocks).expect("many rows");
        assert!(
            LagSegments::new(
                &time_s[..NOMINAL_LAG_SEGMENTS],
                &restart[..NOMINAL_LAG_SEGMENTS],
                &blocks
            )
            .is_none()
        );
        let mut missing = column(&time_s);
        missing[77] = f64::NAN;
        assert!(it.means(&missing, &time_s, &restart).is_none());
        missing[77] = 20.0;
        let mut no_time_s = time_s.clone();
        no_time_s[77] = f64::NAN;
        assert!(LagSegments::new(&no_time_s, &restart, &blocks).is_none());
        // A pause is a stretch of its own, and its row holds its value over it.
        assert!(it.longest_s < 0.2, "{} s", it.longest_s);
    }
}
