//! Whether a hold-out gains less than the floor of the promise, and what is different there.

use trueup_numerics::blocks::{Blocks, rms};

use crate::{
    answer::{
        held_out::unseen_categories,
        hold_out::HoldOut,
        worse::{excess, where_it_is_worse},
    },
    data::Data,
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
}

/// The promise that a hold-out is compared with.
pub(super) struct Promised {
    /// The floor of the reduction.
    pub floor: f64,
    /// Less than this left, in µm, is no shortfall: a day that asks for little.
    pub most_left_um: f64,
}

impl Shortfall {
    /// Returns the shortfall of `model`, as the board runs it, on `hold_out` (`test`: its table as the board reads it)
    /// below what was `promised`; `memory`: of the noise, in rows. None where the floor may have been kept.
    pub(super) fn new(
        training: &Data,
        hold_out: &HoldOut<'_>,
        test: &Data,
        model: &Model,
        promised: Promised,
        memory: f64,
    ) -> Option<Self> {
        let Promised { floor, most_left_um } = promised;
        let predicted = [&Model::default(), model].map(|model| model.predict(test));
        let rows: Vec<[f64; 2]> = (0..test.rows)
            .filter(|&row| test.used[row])
            .map(|row| [0, 1].map(|n| test.measured[row] - predicted[n][row]))
            .filter(|left| left.iter().all(|um| um.is_finite()))
            .collect();
        let [before, after] = [0, 1].map(|n| rows.iter().map(|left| left[n]).collect::<Vec<f64>>());
        if rms(&before) <= 0.0 || rms(&after) <= most_left_um {
            return None;
        }
        let reduction = Blocks::new(rows.len(), memory).reduction(&before, &after);
        let (came, most) = (reduction.value, reduction.ci95[1]);
        if most >= floor {
            return None;
        }
        let [before, after] = [&predicted[0][..], &predicted[1][..]];
        let share = (1.0 - floor).powi(2);
        let mut places = unseen_categories(training, test);
        places.extend(where_it_is_worse(training, hold_out, &excess(test, [before, after], share)));
        Some(Self { floor, came, most, places })
    }
}
