//! Whether a hold-out gains less than the floor of the promise, and what is different there.
//!
//! Of few rows a mean square is known badly: one gross reading makes it. Then the hold-out does not say that the promise fails, and
//! not that it holds either; the rows that leave the most are named.

use trueup_numerics::{
    block_resampling::{RowBlocks, rms},
    robust::MAX_OUTLIER_FRACTION,
};

use crate::{
    data::DataTable,
    diagnosis::{
        held_out_errors::describe_unseen_categories,
        hold_out::HoldOut,
        hold_out_degradation::{
            describe_inputs_outside_training, describe_worst_interval, excess_squared_errors,
            locate_row_in_file,
        },
        report::is_meaningful_reduction_floor,
    },
    model::Model,
};

/// How a hold-out falls short.
pub(super) struct Shortfall {
    /// The floor that was promised.
    pub floor: f64,
    /// The reduction on the hold-out.
    pub came: f64,
    /// The upper end of its 95 % interval.
    pub most: f64,
    /// Differences of the hold-out from the runs, a sentence each.
    pub places: Vec<String>,
    /// Where the hold-out does not say for certain that the promise fails, and without few of its rows keeps it: these.
    pub gross: Option<GrossErrorRows>,
}

/// Rows of a hold-out without which it keeps the promise.
pub(super) struct GrossErrorRows {
    /// Each as the user counts it, with its residual.
    pub rows: Vec<String>,
    /// The reduction without them.
    pub reduction: f64,
}

/// The promise that a hold-out is compared with.
pub(super) struct ReductionBounds {
    /// The floor of the reduction.
    pub floor: f64,
    /// Less than this left, in µm, is no shortfall: a day that needs little.
    pub most_left_um: f64,
}

impl Shortfall {
    /// Returns the shortfall of `model`, as the board runs it, on `hold_out` (`test`: its table as the board reads it)
    /// below what was `promised`; `memory`: of the noise, in rows. None where the floor was kept.
    pub(super) fn new(
        training: &DataTable,
        hold_out: &HoldOut<'_>,
        test: &DataTable,
        model: &Model,
        promised: ReductionBounds,
        memory: f64,
    ) -> Option<Self> {
        let ReductionBounds { floor, most_left_um } = promised;
        let predicted = [&Model::default(), model].map(|model| model.predict(test));
        let rows: Vec<(usize, [f64; 2])> = (0..test.rows)
            .filter(|&row| test.used[row])
            .map(|row| (row, [0, 1].map(|n| test.measured[row] - predicted[n][row])))
            .filter(|(_, left)| left.iter().all(|um| um.is_finite()))
            .collect();
        let [before, after] =
            [0, 1].map(|n| rows.iter().map(|(_, left)| left[n]).collect::<Vec<f64>>());
        if rms(&before) <= 0.0 || rms(&after) <= most_left_um {
            return None;
        }
        let reduction = RowBlocks::new(rows.len(), memory).rms_reduction(&before, &after);
        let (came, most) = (reduction.value, reduction.ci95[1]);
        if came >= floor {
            return None;
        }
        let [before, after] = [&predicted[0][..], &predicted[1][..]];
        let excess = excess_squared_errors(test, [before, after], (1.0 - floor).powi(2));
        let mut places = describe_unseen_categories(training, test);
        if most < floor {
            places.extend(describe_worst_interval(training, hold_out, &excess));
            return Some(Self { floor, came, most, places, gross: None });
        }
        places.extend(describe_inputs_outside_training(training, hold_out, &excess));
        let gross = GrossErrorRows::find_minimal_set(hold_out, test, rows, floor);
        Some(Self { floor, came, most, places, gross })
    }

    /// Returns whether the hold-out says that the promise fails.
    pub(super) fn is_significant(&self) -> bool {
        self.most < self.floor
    }

    /// Returns a sentence on a promise that was not kept, where the hold-out does not say that it fails.
    pub(super) fn warning(&self) -> Option<String> {
        let [floor, came, most] = [self.floor, self.came, self.most].map(|share| 100.0 * share);
        let why = match &self.gross {
            _ if self.is_significant() || !is_meaningful_reduction_floor(self.floor) => {
                return None;
            }
            // What the runs did not have is no wrong reading.
            _ if !self.places.is_empty() => {
                format!("But {}. Measure a run that covers this", self.places.join("; "))
            }
            Some(GrossErrorRows { rows, reduction }) => format!(
                "Without {} it falls by {:.0} %. Measure there again",
                rows.join(" and "),
                100.0 * reduction
            ),
            None => {
                format!(
                    "It is too short for a narrower bound (at most {most:.0} %). Measure a longer one"
                )
            }
        };
        let (verb, came) = (if came < 0.0 { "rises" } else { "falls" }, came.abs());
        Some(format!(
            "the error on the hold-out {verb} by {came:.0} %; at least {floor:.0} % less was promised. {why}."
        ))
    }
}

impl GrossErrorRows {
    /// Returns the fewest of `rows`, each with what is left of it before and after in µm, without which the rest keeps the
    /// `floor`; none where they are more than gross readings may be ([`MAX_OUTLIER_FRACTION`]).
    fn find_minimal_set(
        hold_out: &HoldOut<'_>,
        test: &DataTable,
        mut rows: Vec<(usize, [f64; 2])>,
        floor: f64,
    ) -> Option<Self> {
        rows.sort_by(|(_, [_, one]), (_, [_, other])| other.abs().total_cmp(&one.abs()));
        let reduction = |rows: &[(usize, [f64; 2])]| {
            let [before, after] =
                [0, 1].map(|n| rows.iter().map(|(_, left)| left[n].powi(2)).sum::<f64>());
            1.0 - (after / before).sqrt()
        };
        let most = (MAX_OUTLIER_FRACTION * rows.len() as f64) as usize;
        let count = (1..=most).find(|count| reduction(&rows[*count..]) >= floor)?;
        let (gross, rest) = rows.split_at(count);
        let mut gross = gross.to_vec();
        gross.sort_by_key(|(row, _)| *row);
        let describe = |(row, [_, um]): &(usize, [f64; 2])| {
            let (row, name) = locate_row_in_file(test, hold_out, *row);
            format!("row {row} of {name} ({um:+.1} µm)")
        };
        Some(Self { rows: gross.iter().map(describe).collect(), reduction: reduction(rest) })
    }
}
