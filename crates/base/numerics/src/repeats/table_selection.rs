//! Which table, if any, is worth its values.
//!
//! A law is admitted if
//!
//! ```text
//! F = (Σ(value − mean)² − Σ(value − law)²)/(k − 1)  :  Σ(value − law)²/(n − k)
//! ```
//!
//! is beyond its 99 % point (the places differ by more than their repeats), if it leaves less than the mean
//! on every cycle that was held out of the fit in turn, and in all less than nothing would. Of those that
//! are admitted and predict the held-out cycles equally well (the mean of the paired differences of the
//! squares is within one standard error) the one with the fewest values is taken: the rule of one
//! standard error of Breiman and others (Classification and Regression Trees, 1984).
//!
//! Where there is one cycle alone, its two sides take the part of two cycles: a table for both sides was
//! measured twice then, and one for each side once. A step between the sides was seen at every place of the
//! cycle: it is decided by an F test of its own.

use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::{
    reading::RepeatReading,
    table_fit::{TableFit, TableLaw},
};

/// A law that chance alone would make look as good more often than this is none. Source: the usual level
/// of a strict test; with three laws tried, 3 % is what one decision can be wrong by chance, and the
/// held-out cycles must agree besides.
pub const SIGNIFICANCE_LEVEL: f64 = 0.01;

/// More cycles than this are held out in blocks of neighbours.
const MAX_BLOCKS: usize = 20;

/// Two places always lie on a line with a constant: a table begins with three.
pub const MIN_TABLE_POSITIONS: usize = 3;

/// Squares below this share of the readings' own are rounding.
const ROUNDING_TOLERANCE: f64 = 1e-18;

/// A law on trial.
#[derive(Clone, Debug)]
pub struct LawTest {
    /// The law.
    pub law: TableLaw,
    /// How many values it has.
    pub constants: usize,
    /// F as above; infinite where nothing is left.
    pub f: f64,
    /// How likely chance alone makes F as large, 0…1.
    pub chance: f64,
    /// The mean square of each held-out block with the mean of the others alone.
    pub before: Vec<f64>,
    /// The same with the law.
    pub after: Vec<f64>,
    /// The law's residual at each reading where its block was held out; NaN where it is excluded.
    pub held_out: Vec<f64>,
    /// Whether all of it together leaves less than nothing at all would.
    pub is_below_nothing: bool,
}

impl LawTest {
    /// Returns whether the places differ by more than their repeats.
    #[must_use]
    pub fn is_significant(&self) -> bool {
        self.chance < SIGNIFICANCE_LEVEL
    }

    /// Returns whether every held-out block gains.
    #[must_use]
    pub fn has_gain_in_every_block(&self) -> bool {
        self.is_below_nothing
            && self.before.iter().zip(&self.after).all(|(before, after)| after < before)
    }

    /// Returns the root mean square on the held-out blocks.
    #[must_use]
    pub fn rms(&self) -> f64 {
        let squares = self.held_out.iter().filter(|left| !left.is_nan()).map(|left| left * left);
        let (sum, count) =
            squares.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
        (sum / count).sqrt()
    }
}

/// Why no table is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableRejection {
    /// Fewer than three places, or no place that came again.
    TooFew,
    /// Chance alone would make the places differ so.
    Chance,
    /// Places differ, but a held-out cycle is not predicted by the others.
    NoGain,
}

/// The law to use, and the trials behind it.
#[derive(Clone, Debug)]
pub struct TableSelection {
    /// The law to use, or why there is none.
    pub taken: Result<TableLaw, TableRejection>,
    /// All that were tried, in their order.
    pub trials: Vec<LawTest>,
    /// Held-out blocks: cycles, or the two sides of one.
    pub blocks: usize,
    /// Whether the sides took the part of cycles.
    pub by_side: bool,
    /// The standard deviation of repeats at one place from one side (of both sides, where each was
    /// there once); none without repeats.
    pub scatter: Option<f64>,
}

impl TableSelection {
    /// Returns the trial of a law; none where it was not tried.
    #[must_use]
    pub fn law_test(&self, law: TableLaw) -> Option<&LawTest> {
        self.trials.iter().find(|trial| trial.law == law)
    }
}

/// Decides among `laws` over `places` places; `aside`: readings that do not count.
#[must_use]
pub fn select_table(
    readings: &[RepeatReading],
    aside: &[bool],
    places: usize,
    laws: &[TableLaw],
) -> TableSelection {
    let used: Vec<(usize, RepeatReading)> = readings
        .iter()
        .enumerate()
        .filter(|&(row, reading)| !aside[row] && reading.value.is_finite())
        .map(|(row, reading)| (row, *reading))
        .collect();
    let (block_of, blocks, by_side) = assign_blocks(&used);
    let scatter = pooled_std(&used, places);
    let mut seen = vec![false; places];
    used.iter().for_each(|(_, reading)| seen[reading.place] = true);
    let seen = seen.into_iter().filter(|seen| *seen).count();
    let mut decision = TableSelection {
        taken: Err(TableRejection::TooFew),
        trials: Vec::new(),
        blocks,
        by_side,
        scatter,
    };
    if seen < MIN_TABLE_POSITIONS || blocks < 2 || scatter.is_none() {
        return decision;
    }
    decision.trials = laws
        .iter()
        .filter_map(|&law| test_law(law, &used, places, &block_of, blocks, readings.len()))
        .collect();
    decision.taken = select_law(&decision.trials);
    if by_side && decision.taken == Ok(TableLaw::Table) && laws.contains(&TableLaw::TableAndStep) {
        let [table, step] = [TableLaw::Table, TableLaw::TableAndStep]
            .map(|law| residual_sum_of_squares(law, &used, places));
        if is_step_significant(table, step) {
            decision.taken = Ok(TableLaw::TableAndStep);
        }
    }
    decision
}

/// Returns what a law leaves of all readings: squares and degrees of freedom.
fn residual_sum_of_squares(
    law: TableLaw,
    used: &[(usize, RepeatReading)],
    places: usize,
) -> (f64, f64) {
    let table = TableFit::fit(law, places, used.iter().map(|(_, reading)| reading));
    let left = used
        .iter()
        .map(|(_, reading)| (reading.value - table.value_at(reading.place, reading.side)).powi(2))
        .sum();
    (left, used.len() as f64 - table.constants as f64)
}

/// Returns whether a step takes away more than chance would: F of one value more.
fn is_step_significant(table: (f64, f64), step: (f64, f64)) -> bool {
    let (more, freedom) = (table.0 - step.0, step.1);
    if freedom < 1.0 || more <= ROUNDING_TOLERANCE * table.0 {
        return false;
    }
    let f = more * freedom / step.0;
    step.0 <= ROUNDING_TOLERANCE * table.0
        || FisherSnedecor::new(1.0, freedom)
            .is_ok_and(|distribution| distribution.sf(f) < SIGNIFICANCE_LEVEL)
}

/// Returns the block of each reading, how many there are, and whether they are sides.
fn assign_blocks(used: &[(usize, RepeatReading)]) -> (Vec<usize>, usize, bool) {
    let mut cycles: Vec<usize> = used.iter().map(|(_, reading)| reading.cycle).collect();
    cycles.sort_unstable();
    cycles.dedup();
    if cycles.len() < 2 {
        let of: Vec<usize> = used.iter().map(|(_, reading)| reading.side).collect();
        let both = [0, 1].iter().all(|side| of.contains(side));
        return (of, 1 + usize::from(both), true);
    }
    let count = cycles.len().min(MAX_BLOCKS);
    let of = |reading: &RepeatReading| {
        cycles.partition_point(|&cycle| cycle < reading.cycle) * count / cycles.len()
    };
    (used.iter().map(|(_, reading)| of(reading)).collect(), count, false)
}

/// Returns the pooled standard deviation of repeats: at one place from one side, else at one place.
fn pooled_std(used: &[(usize, RepeatReading)], places: usize) -> Option<f64> {
    [TableLaw::EachSide, TableLaw::Table].into_iter().find_map(|law| {
        let table = TableFit::fit(law, places, used.iter().map(|(_, reading)| reading));
        let freedom = used.len().checked_sub(table.constants).filter(|freedom| *freedom > 0)?;
        let squares: f64 = used
            .iter()
            .map(|(_, reading)| {
                (reading.value - table.value_at(reading.place, reading.side)).powi(2)
            })
            .sum();
        Some((squares / freedom as f64).sqrt())
    })
}

/// Returns a law on trial; none where it has as many values as there are readings.
fn test_law(
    law: TableLaw,
    used: &[(usize, RepeatReading)],
    places: usize,
    block_of: &[usize],
    blocks: usize,
    rows: usize,
) -> Option<LawTest> {
    let table = TableFit::fit(law, places, used.iter().map(|(_, reading)| reading));
    let freedom = used.len().checked_sub(table.constants).filter(|freedom| *freedom > 0)? as f64;
    let more = table.constants.checked_sub(1).filter(|more| *more > 0)? as f64;
    let mean = mean(used.iter().map(|(_, reading)| reading.value));
    let about = |of: &dyn Fn(&RepeatReading) -> f64| -> f64 {
        used.iter().map(|(_, reading)| (reading.value - of(reading)).powi(2)).sum()
    };
    let (all, left) =
        (about(&|_| mean), about(&|reading| table.value_at(reading.place, reading.side)));
    let size: f64 = used.iter().map(|(_, reading)| reading.value * reading.value).sum();
    // Rounding must not make a finding, nor an exact table a division by nothing.
    let (f, chance) = if all - left <= ROUNDING_TOLERANCE * size {
        (0.0, 1.0)
    } else if left <= ROUNDING_TOLERANCE * size {
        (f64::INFINITY, 0.0)
    } else {
        let f = ((all - left) / more) / (left / freedom);
        (f, FisherSnedecor::new(more, freedom).map_or(1.0, |distribution| distribution.sf(f)))
    };
    let mut held_out = vec![f64::NAN; rows];
    let (mut before, mut after) = (Vec::new(), Vec::new());
    for block in 0..blocks {
        let is_in = |n: &usize| block_of[*n] == block;
        let retained = || (0..used.len()).filter(|n| !is_in(n)).map(|n| &used[n].1);
        let table = TableFit::fit(law, places, retained());
        let mean = self::mean(retained().map(|reading| reading.value));
        let (mut squares, mut count) = ([0.0; 2], 0.0);
        for (row, it) in (0..used.len()).filter(is_in).map(|n| &used[n]) {
            let predicted = table.value_at(it.place, it.side);
            // Where the others say nothing of it, it is predicted as without the law.
            let left = it.value - if predicted.is_nan() { mean } else { predicted };
            held_out[*row] = left;
            squares[0] += (it.value - mean).powi(2);
            squares[1] += left * left;
            count += 1.0;
        }
        before.push(squares[0] / count);
        after.push(squares[1] / count);
    }
    let left: f64 = held_out.iter().filter(|left| !left.is_nan()).map(|left| left * left).sum();
    let is_below_nothing = left < size;
    Some(LawTest {
        law,
        constants: table.constants,
        f,
        chance,
        before,
        after,
        held_out,
        is_below_nothing,
    })
}

/// Returns the law to take.
fn select_law(trials: &[LawTest]) -> Result<TableLaw, TableRejection> {
    let admitted =
        || trials.iter().filter(|trial| trial.is_significant() && trial.has_gain_in_every_block());
    let best = admitted().min_by(|a, b| a.rms().total_cmp(&b.rms()));
    let Some(best) = best else {
        let is_any = trials.iter().any(LawTest::is_significant);
        return Err(if is_any { TableRejection::NoGain } else { TableRejection::Chance });
    };
    let equal = admitted().filter(|trial| !is_worse(&trial.held_out, &best.held_out));
    let simplest = equal.min_by_key(|trial| trial.constants);
    Ok(simplest.map_or(best.law, |trial| trial.law))
}

/// Returns whether `own` is larger than `other` by more than one standard error of their paired squares; what is
/// NaN in either does not count.
#[must_use]
pub fn is_worse(own: &[f64], other: &[f64]) -> bool {
    let more: Vec<f64> = own
        .iter()
        .zip(other)
        .map(|(own, other)| own * own - other * other)
        .filter(|more| !more.is_nan())
        .collect();
    let count = more.len() as f64;
    let mean = mean(more.iter().copied());
    let variance = more.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    mean > (variance / count).sqrt()
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}
