//! Readings at equal positions: what repeats, and what does not.
//!
//! Scatter is judged by what the model leaves: an axis that grows with its temperature as the model says
//! repeats. Repetition is looked for in the readings themselves: a machine that does what its model
//! says repeats, also where nothing else is left but noise.

use std::collections::HashMap;

use trueup_machine::{
    effect::BoardTerm,
    machine_file::{Feedback, LinearAxis, PitchErrorTable},
    model::is_negative_direction,
};
use trueup_numerics::{
    block_resampling::COVERAGE_FACTOR_95,
    repeats::{
        POSITION_TOLERANCE_PER_STEP, RepeatReading, TableLaw, cycle_numbers, find_gross_errors,
        group_positions, max_point_variance,
    },
    robust::median,
};

use crate::{
    data::DataTable,
    term_kind::{ModelPart, TermKind},
};

/// A machine whose readings at one position scatter by more (standard deviation, in µm) is no machine
/// to be corrected but one to be mended: its repeatability by ISO 230-2, 4·s, is beyond 20 µm, about
/// the most that ISO 10791-4 lets a machining centre of 2 m have. Less than that may be the noise of
/// the instrument.
pub(crate) const MAX_REPEATABILITY_STD_UM: f64 = 5.0;
/// A step of the positions below this, in mm, is none: machine positions are known to a micrometre.
pub(crate) const POSITION_TOLERANCE_MM: f64 = 1e-3;

/// The targets of an axis's own motion, and which row is a reading at which.
#[derive(Clone, Debug)]
pub(crate) struct TargetPositions {
    pub own: LinearAxis,
    /// Rising.
    pub at_mm: Vec<f64>,
    /// Readings in the order of the rows, their values still 0.
    readings: Vec<RepeatReading>,
    /// The row of each reading.
    rows: Vec<usize>,
}

impl TargetPositions {
    /// Of these rows; none where the axis does not come back to the same places, or another axis moves
    /// as well.
    pub(crate) fn from_rows(data: &DataTable, rows: impl Iterator<Item = usize>) -> Option<Self> {
        let own = data.setting.quantity.axis()?;
        let position = data.own_position_mm()?;
        let rows: Vec<usize> = rows.filter(|&row| !position[row].is_nan()).collect();
        let others = LinearAxis::ALL.into_iter().filter(|axis| *axis != own);
        let stands = |mm: &[f64]| {
            let here = rows.iter().map(|&row| mm[row]).filter(|mm| !mm.is_nan());
            let (low, high) = here.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), mm| {
                (low.min(mm), high.max(mm))
            });
            // Of nothing that was recorded as well.
            high - low <= POSITION_TOLERANCE_MM
        };
        if !others.filter_map(|axis| data.position_mm(axis)).all(stands) {
            return None;
        }
        let direction = data.own_approach_direction();
        let side =
            |row: usize| usize::from(direction.is_some_and(|d| is_negative_direction(d[row])));
        let at: Vec<f64> = rows.iter().map(|&row| position[row]).collect();
        let steps = rows.windows(2).filter_map(|pair| {
            let &[before, after] = pair else { return None };
            let is_one =
                data.places.file[before] == data.places.file[after] && side(before) == side(after);
            let step = (position[after] - position[before]).abs();
            (is_one && step > POSITION_TOLERANCE_MM).then_some(step)
        });
        let step = steps.fold(f64::INFINITY, f64::min);
        let (at_mm, place_of) = group_positions(&at, if step.is_finite() { step } else { 0.0 });
        if 2 * rows.len() < 3 * at_mm.len() {
            return None;
        }
        let cycle_of = match data.run_numbers() {
            Some(run) => {
                encode_labels(rows.iter().map(|&row| (data.places.file[row], run[row].to_bits())))
            }
            None => {
                let stops: Vec<(usize, usize)> =
                    rows.iter().zip(&place_of).map(|(&row, &place)| (place, side(row))).collect();
                cycle_numbers(&stops)
            }
        };
        let readings = rows.iter().zip(&place_of).zip(cycle_of).map(|((&row, &place), cycle)| {
            RepeatReading { place, side: side(row), cycle, value: 0.0 }
        });
        Some(Self { own, readings: readings.collect(), at_mm, rows })
    }

    /// Returns the readings, each with the value `of` its number among the rows that this was made of and its
    /// row.
    pub(crate) fn to_repeat_readings(&self, of: impl Fn(usize) -> f64) -> Vec<RepeatReading> {
        let with = |(reading, &row): (&RepeatReading, &usize)| RepeatReading {
            value: of(row),
            ..*reading
        };
        self.readings.iter().zip(&self.rows).map(with).collect()
    }

    /// Returns the rows that stand alone among the repeats of what `residual` (by row) leaves.
    pub(crate) fn find_gross_errors(
        &self,
        data: &DataTable,
        residual: impl Fn(usize) -> f64,
    ) -> Vec<bool> {
        let mut aside = vec![false; data.rows];
        let found = find_gross_errors(&self.to_repeat_readings(residual));
        self.rows.iter().zip(found).for_each(|(&row, found)| aside[row] = found);
        aside
    }

    /// Returns how far what is `left_um` of each row is from the median of its place's others that are not excluded as
    /// outliers; NaN of rows that are at none.
    pub(crate) fn deviations_from_target_median(
        &self,
        left_um: &[f64],
        aside: &[bool],
    ) -> Vec<f64> {
        let mut at: HashMap<(usize, usize), Vec<usize>> = HashMap::new();
        for (reading, &row) in self.readings.iter().zip(&self.rows) {
            at.entry((reading.place, reading.side)).or_default().push(row);
        }
        let mut distance_um = vec![f64::NAN; left_um.len()];
        for rows in at.values() {
            for &row in rows {
                let others = rows.iter().filter(|other| **other != row && !aside[**other]);
                let mut others: Vec<f64> = others.map(|&other| left_um[other]).collect();
                distance_um[row] = left_um[row] - median(&mut others);
            }
        }
        distance_um
    }

    /// Returns the tables that may be tried, as [`TableLaw`]s: a step is the screw's, so that a scale has none.
    pub(crate) fn candidate_table_laws(&self, data: &DataTable) -> Vec<TableLaw> {
        let has = |side: usize| self.readings.iter().any(|reading| reading.side == side);
        let mut laws = vec![TableLaw::Table];
        if has(0) && has(1) {
            if data.setting.machine.axes[self.own.index()].feedback == Feedback::Screw {
                laws.push(TableLaw::TableAndStep);
            }
            laws.push(TableLaw::EachSide);
        }
        laws
    }

    /// Returns a law as terms, neutral; none where no table of equal steps is determined by these places.
    pub(crate) fn table_law_terms(&self, law: TableLaw) -> Option<Vec<ModelPart>> {
        let (start_mm, step_mm, points) = self.table_grid()?;
        let forward_um = vec![0.0; points];
        let reverse_um = (law == TableLaw::EachSide).then(|| forward_um.clone());
        let table = BoardTerm::Table(PitchErrorTable { start_mm, step_mm, forward_um, reverse_um });
        let step = BoardTerm::Reversed { width_um: 1.0, um_per_m: 0.0 };
        let forms = [Some(table), (law == TableLaw::TableAndStep).then_some(step)];
        let kinds =
            forms.iter().flatten().map(|form| TermKind::from_board_term(Some(self.own), form));
        let neutral = |kind: TermKind| match &kind {
            TermKind::Cause(effect) => {
                TermKind::Cause(effect.with_values(&vec![0.0; kind.degrees_of_freedom()]))
            }
            _ => kind,
        };
        let part =
            |kind: TermKind| ModelPart { values: vec![0.0; kind.degrees_of_freedom()], kind };
        kinds.map(|kind| kind.map(neutral).map(part)).collect()
    }

    /// Returns the points of a table: start, step and number. The places themselves where they are even, else as
    /// many points as each is known within twice the uncertainty of one reading at every place.
    fn table_grid(&self) -> Option<(f64, f64, usize)> {
        let (first, last) = (*self.at_mm.first()?, *self.at_mm.last()?);
        let with = |points: usize| (first, (last - first) / (points - 1) as f64, points);
        let even = with(self.at_mm.len());
        let mut steps = self.at_mm.windows(2).map(|pair| pair[1] - pair[0]);
        // Targets may have been written in few digits.
        if steps.all(|step| (step - even.1).abs() < POSITION_TOLERANCE_PER_STEP * even.1) {
            return Some(even);
        }
        let places = [0, 1].map(|side| self.positions_in_direction(side));
        (3..self.at_mm.len()).rev().map(with).find(|&(start_mm, step_mm, points)| {
            let is_known = |at: &Vec<f64>| {
                at.is_empty()
                    || max_point_variance(at, start_mm, step_mm, points)
                        <= COVERAGE_FACTOR_95.powi(2)
            };
            places.iter().all(is_known)
        })
    }

    /// Returns the places that were read on one side, in mm, rising.
    fn positions_in_direction(&self, side: usize) -> Vec<f64> {
        let is_read = |place: usize| {
            self.readings.iter().any(|reading| reading.place == place && reading.side == side)
        };
        (0..self.at_mm.len())
            .filter(|&place| is_read(place))
            .map(|place| self.at_mm[place])
            .collect()
    }
}

/// Numbers from 0 in the order in which keys come.
fn encode_labels<K: PartialEq>(keys: impl Iterator<Item = K>) -> Vec<usize> {
    let mut known: Vec<K> = Vec::new();
    keys.map(|key| {
        known.iter().position(|there| *there == key).unwrap_or_else(|| {
            known.push(key);
            known.len() - 1
        })
    })
    .collect()
}

/// Scatter and systematic part of what is left at equal positions, approached the same way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RepeatStatistics {
    /// Standard deviation of readings at one position and direction, pooled.
    pub scatter_um: f64,
    /// Standard deviation of the means, less what scatter makes of it.
    pub systematic_um: f64,
}

/// Without the rows that are set `aside`. None where there are too few repeats: less than three runs, or positions that
/// do not come back.
pub(crate) fn analyse_repeats(
    data: &DataTable,
    predicted: &[f64],
    aside: &[bool],
) -> Option<RepeatStatistics> {
    let run = data.run_numbers()?;
    let own = data.own_position_mm()?;
    let direction = data.own_approach_direction();
    let mut rows: Vec<(i64, i8, usize)> = (0..data.rows)
        .filter(|&row| data.used[row] && !aside[row] && !run[row].is_nan() && !own[row].is_nan())
        .map(|row| {
            // Positions to a micrometre.
            let at = (own[row] * 1000.0).round() as i64;
            let back = direction.is_some_and(|d| d[row] < 0.0);
            (at, i8::from(back), row)
        })
        .collect();
    rows.sort_unstable();
    let (mut within, mut freedom) = (0.0, 0.0);
    let mut means: Vec<(f64, f64)> = Vec::new();
    for group in rows.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        if group.len() < 2 {
            continue;
        }
        let count = group.len() as f64;
        let mean_of = |of: &dyn Fn(usize) -> f64| {
            group.iter().map(|&(_, _, row)| of(row)).sum::<f64>() / count
        };
        let left = |row: usize| data.measured[row] - predicted[row];
        let (mean, mean_left) = (mean_of(&|row| data.measured[row]), mean_of(&left));
        within += group.iter().map(|&(_, _, row)| (left(row) - mean_left).powi(2)).sum::<f64>();
        freedom += count - 1.0;
        means.push((mean, count));
    }
    if means.len() < 3 || freedom < 6.0 {
        return None;
    }
    let scatter = within / freedom;
    let count = means.len() as f64;
    let mean = means.iter().map(|(mean, _)| mean).sum::<f64>() / count;
    let between = means.iter().map(|(m, _)| (m - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let by_chance = means.iter().map(|(_, n)| scatter / n).sum::<f64>() / count;
    Some(RepeatStatistics {
        scatter_um: scatter.sqrt(),
        systematic_um: (between - by_chance).max(0.0).sqrt(),
    })
}
