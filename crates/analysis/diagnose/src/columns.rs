//! Columns: those of the file by name, those that follow from them, and what a part adds to each row.

use std::{borrow::Cow, sync::Arc};

use trueup_machine::{
    effect::{ColumnSource, LawInput},
    machine_file::Quantity,
    model::Lag,
};

use crate::{
    data::{ColumnGroup, DataTable, StatedTerm, forward_fill},
    term_kind::{LackOfFitCurve, TermKind},
};

/// Returns what a part with these nonlinear values adds at each amplitude of 1, to a prediction `p` so far: of
/// a cause by its page's law.
pub(crate) fn basis_columns(
    kind: &TermKind,
    nonlinear: &[f64],
    data: &DataTable,
    p: &[f64],
) -> Vec<Vec<f64>> {
    match kind {
        TermKind::Cause(effect) | TermKind::StatedTerm(StatedTerm { effect, .. }) => {
            effect.unit_effect_columns(nonlinear, &LawColumns { data, p })
        }
        TermKind::Curve(curve) => curve_basis_columns(curve, data),
    }
}

/// Returns what a part with these values adds to each row, to a prediction `p` so far.
pub(crate) fn part_contribution(
    kind: &TermKind,
    values: &[f64],
    data: &DataTable,
    p: &[f64],
) -> Vec<f64> {
    match kind {
        TermKind::Cause(effect) | TermKind::StatedTerm(StatedTerm { effect, .. }) => {
            effect.sum_effects(values, &LawColumns { data, p })
        }
        TermKind::Curve(curve) => {
            let mut sum = vec![0.0; data.rows];
            for_each_knot_weight(curve, data, |row, knot, share| sum[row] += values[knot] * share);
            sum
        }
    }
}

/// The columns that a law reads: those of the table, without gaps.
struct LawColumns<'a> {
    data: &'a DataTable,
    p: &'a [f64],
}

impl ColumnSource for LawColumns<'_> {
    fn row_count(&self) -> usize {
        self.data.rows
    }

    fn column(&self, input: &LawInput<'_>) -> Cow<'_, [f64]> {
        let data = self.data;
        let whole =
            |values: Option<_>| values.map_or_else(|| Cow::Owned(vec![0.0; data.rows]), fill_gaps);
        match *input {
            LawInput::Predicted => Cow::Borrowed(self.p),
            LawInput::Law => whole(Some(&data.predicted.law)),
            LawInput::Believed => whole(Some(&data.predicted.elongation)),
            LawInput::Time => whole(data.time_s()),
            // What is of no run is no run's number either.
            LawInput::Run => {
                let run = data.run_numbers();
                run.map_or_else(|| Cow::Owned(vec![f64::NAN; data.rows]), fill_gaps)
            }
            LawInput::Temperature { column, lag_s: 0.0 } => whole(data.temperature_c(column)),
            LawInput::Temperature { column, lag_s } => {
                Cow::Owned(Arc::unwrap_or_clone(data.lagged_column(column, lag_s, lag_s)))
            }
            LawInput::Speed => whole(data.spindle_rpm()),
            LawInput::SpeedHeat { power, lag_s } => {
                Cow::Owned(Arc::unwrap_or_clone(data.lagged_spindle_heat(power, lag_s)))
            }
            LawInput::Load => whole(data.load_n()),
            // Where it is missing it is not that of the row before.
            LawInput::Feed => match column_by_name(data, "feed_mm_per_min") {
                Some(feeds) => Cow::Borrowed(feeds),
                None => Cow::Owned(vec![f64::NAN; data.rows]),
            },
            LawInput::OwnPosition => whole(data.own_position_mm()),
            LawInput::OwnDirection => match data.own_approach_direction() {
                Some(direction) => Cow::Borrowed(direction),
                None => whole(None),
            },
            LawInput::Position(axis) => whole(data.position_mm(axis)),
            LawInput::Column(column) => {
                whole(column_by_name(data, column).or_else(|| data.own_position_mm()))
            }
            LawInput::Lagged { column, lag_s } => {
                let (time_s, values) = (whole(data.time_s()), whole(column_by_name(data, column)));
                let mut lag = Lag::default();
                let rows = time_s.iter().zip(values.iter());
                Cow::Owned(rows.map(|(time_s, value)| lag.step(lag_s, *time_s, *value)).collect())
            }
        }
    }
}

/// Returns the column itself, or filled where a value is missing.
fn fill_gaps(values: &[f64]) -> Cow<'_, [f64]> {
    if values.iter().any(|value| value.is_nan()) {
        Cow::Owned(forward_fill(values))
    } else {
        Cow::Borrowed(values)
    }
}

/// Returns what a curve adds at each of its knots.
fn curve_basis_columns(curve: &LackOfFitCurve, data: &DataTable) -> Vec<Vec<f64>> {
    let knots = curve.knots.len() * if curve.by_direction { 2 } else { 1 };
    let mut columns = vec![vec![0.0; data.rows]; knots];
    for_each_knot_weight(curve, data, |row, knot, share| columns[knot][row] = share);
    columns
}

/// Calls `add` with each row, the two knots around it, and what a knot of 1 adds there.
fn for_each_knot_weight(
    curve: &LackOfFitCurve,
    data: &DataTable,
    mut add: impl FnMut(usize, usize, f64),
) {
    let LackOfFitCurve { column, knots, by_direction, times } = curve;
    let reverse = |row: usize| data.own_approach_direction().is_some_and(|d| d[row] < 0.0);
    let values = fill_gaps(column_by_name(data, column).unwrap_or(&[]));
    let factor = times.as_ref().and_then(|column| column_by_name(data, column)).map(fill_gaps);
    let factor = |row: usize| factor.as_ref().map_or(1.0, |factor| factor[row]);
    for (row, &value) in values.iter().enumerate() {
        let above = knots.partition_point(|&knot| knot <= value).clamp(1, knots.len() - 1);
        let (low, high) = (knots[above - 1], knots[above]);
        let share = ((value - low) / (high - low)).clamp(0.0, 1.0);
        let offset = if *by_direction && reverse(row) { knots.len() } else { 0 };
        add(row, offset + above - 1, (1.0 - share) * factor(row));
        add(row, offset + above, share * factor(row));
    }
}

/// The name of the column of the elongation by the model.
pub(crate) const PREDICTED_ELONGATION_COLUMN: &str = "what the model says";

/// Returns a column by its name in the file, or one of those that follow from others.
pub(crate) fn column_by_name<'d>(data: &'d DataTable, name: &str) -> Option<&'d [f64]> {
    match name {
        PREDICTED_ELONGATION_COLUMN => (data.setting.quantity == Quantity::Elongation)
            .then_some(&data.predicted.elongation[..]),
        _ => data.columns.by_name(name).or_else(|| data.temperature_c(name)).or_else(|| {
            let mut columns =
                data.unknown_columns().iter().chain(&data.columns[ColumnGroup::Reversal]);
            columns.find(|(there, _)| there == name).map(|(_, values)| &values[..])
        }),
    }
}
