//! Columns: those of the file by name, those that follow from them, and what a part adds to each row.

use std::{borrow::Cow, sync::Arc};

use trueup_machine::{
    effect::{Columns, Input},
    file::{LinearAxis, Quantity},
    model::Lag,
};

use crate::{
    data::{Data, Stated, filled},
    kind::{Curve, Kind},
};

/// Returns what a part with these nonlinear values adds at each amplitude of 1, to a prediction `p` so far: of
/// a cause by its page's law.
pub(crate) fn basis(kind: &Kind, nonlinear: &[f64], data: &Data, p: &[f64]) -> Vec<Vec<f64>> {
    match kind {
        Kind::Cause(effect) | Kind::Stated(Stated { effect, .. }) => {
            effect.columns(nonlinear, &Table { data, p })
        }
        Kind::Curve(curve) => over(curve, data),
    }
}

/// Returns what a part with these values adds to each row, to a prediction `p` so far.
pub(crate) fn sum(kind: &Kind, values: &[f64], data: &Data, p: &[f64]) -> Vec<f64> {
    match kind {
        Kind::Cause(effect) | Kind::Stated(Stated { effect, .. }) => {
            effect.sum(values, &Table { data, p })
        }
        Kind::Curve(curve) => {
            let mut sum = vec![0.0; data.rows];
            at_rows(curve, data, |row, knot, share| sum[row] += values[knot] * share);
            sum
        }
    }
}

/// The columns that a law reads: those of the table, without gaps.
struct Table<'a> {
    data: &'a Data,
    p: &'a [f64],
}

impl Columns for Table<'_> {
    fn rows(&self) -> usize {
        self.data.rows
    }

    fn column(&self, input: &Input<'_>) -> Cow<'_, [f64]> {
        let data = self.data;
        let whole = |values: Option<_>| {
            values.map_or_else(|| Cow::Owned(vec![0.0; data.rows]), without_gaps)
        };
        match *input {
            Input::Predicted => Cow::Borrowed(self.p),
            Input::Law => whole(Some(&data.law)),
            Input::Believed => whole(Some(&data.elongation)),
            Input::Time => whole(data.time_s.as_deref()),
            // What is of no run is no run's number either.
            Input::Run => {
                let run = data.run.as_deref();
                run.map_or_else(|| Cow::Owned(vec![f64::NAN; data.rows]), without_gaps)
            }
            Input::Temperature { column, lag_s: 0.0 } => whole(data.temperature(column)),
            Input::Temperature { column, lag_s } => {
                Cow::Owned(Arc::unwrap_or_clone(data.lagged(column, lag_s, lag_s)))
            }
            Input::Speed => whole(data.spindle_rpm.as_deref()),
            Input::SpeedHeat { power, lag_s } => {
                Cow::Owned(Arc::unwrap_or_clone(data.heated(power, lag_s)))
            }
            Input::Load => whole(data.load_n.as_deref()),
            // Where it is missing it is not that of the row before.
            Input::Feed => match named(data, "feed_mm_per_min") {
                Some(feeds) => Cow::Borrowed(feeds),
                None => Cow::Owned(vec![f64::NAN; data.rows]),
            },
            Input::OwnPosition => whole(data.own_position()),
            Input::OwnDirection => match data.own_direction() {
                Some(direction) => Cow::Borrowed(direction),
                None => whole(None),
            },
            Input::Position(axis) => whole(position(data, axis)),
            Input::Column(column) => whole(named(data, column).or_else(|| data.own_position())),
            Input::Lagged { column, lag_s } => {
                let (time_s, values) = (whole(data.time_s.as_deref()), whole(named(data, column)));
                let mut lag = Lag::default();
                let rows = time_s.iter().zip(values.iter());
                Cow::Owned(rows.map(|(time_s, value)| lag.step(lag_s, *time_s, *value)).collect())
            }
        }
    }
}

/// Returns the column itself, or filled where a value is missing.
fn without_gaps(values: &[f64]) -> Cow<'_, [f64]> {
    if values.iter().any(|value| value.is_nan()) {
        Cow::Owned(filled(values))
    } else {
        Cow::Borrowed(values)
    }
}

fn position(data: &Data, axis: LinearAxis) -> Option<&[f64]> {
    data.position_mm[axis.index()].as_deref()
}

/// Returns what a curve adds at each of its knots.
fn over(curve: &Curve, data: &Data) -> Vec<Vec<f64>> {
    let knots = curve.knots.len() * if curve.by_direction { 2 } else { 1 };
    let mut columns = vec![vec![0.0; data.rows]; knots];
    at_rows(curve, data, |row, knot, share| columns[knot][row] = share);
    columns
}

/// Calls `add` with each row, the two knots around it, and what a knot of 1 adds there.
fn at_rows(curve: &Curve, data: &Data, mut add: impl FnMut(usize, usize, f64)) {
    let Curve { column, knots, by_direction, times } = curve;
    let reverse = |row: usize| data.own_direction().is_some_and(|d| d[row] < 0.0);
    let values = without_gaps(named(data, column).unwrap_or(&[]));
    let factor = times.as_ref().and_then(|column| named(data, column)).map(without_gaps);
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
pub(crate) const SAID: &str = "what the model says";

/// Returns a column by its name in the file, or one of those that follow from others.
pub(crate) fn named<'d>(data: &'d Data, name: &str) -> Option<&'d [f64]> {
    let position = |n: usize| data.position_mm[n].as_deref();
    match name {
        "time_s" => data.time_s.as_deref(),
        "spindle_rpm" => data.spindle_rpm.as_deref(),
        "load_n" => data.load_n.as_deref(),
        "x_mm" => position(0),
        "y_mm" => position(1),
        "z_mm" => position(2),
        "run" => data.run.as_deref(),
        SAID => (data.quantity == Quantity::Elongation).then_some(data.elongation.as_slice()),
        _ => data.temperature(name).or_else(|| {
            let mut columns = data.others.iter().chain(&data.reversal_decay);
            columns.find(|(there, _)| there == name).map(|(_, values)| &values[..])
        }),
    }
}
