//! The terms of a diagnosis, in `f64`: each a change of the prediction p of one quantity.
//!
//! Some correct a constant of the model. They are folded into the machine before it is stepped
//! ([`apply_constant_terms`]); the others take p and give a new one row by row, in the order of their stages, and
//! constants are added to what that gives. The formulas and the order stand on the pages of the
//! [causes](crate::effect). A value that a term needs and that is
//! missing (NaN) makes p NaN.

use std::borrow::Cow;

use super::{Lag, RowInputs, tool_growth::tool_growth_term};
use crate::{
    effect::{LawInput, ModelConstants, PredictionStage, Quantity, relative_heat_input},
    machine_file::{Machine, Term, sorted_by_stage},
    sections::LinearAxis,
};

/// The time constants of lags while what they follow falls; `None`: the same as while it rises.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FallingTimeConstants {
    /// Of `[spindle.temperature]`, in s.
    pub spindle_s: Option<f64>,
    /// Of `[axis.*.thermal]`, in s.
    pub axes_s: [Option<f64>; 3],
}

/// Returns the machine with the constants that its terms say are right.
///
/// A warm-up's `cool_s` that is not written follows its rate of heating, corrected or not.
#[must_use]
pub fn apply_constant_terms(machine: Cow<'_, Machine>) -> (Cow<'_, Machine>, FallingTimeConstants) {
    let mut corrected = machine;
    // How the tools grow is a term like any other; it is here already where this is called again.
    let by_tool = corrected.spindle.tools.as_ref().map(tool_growth_term);
    if let Some(term) = by_tool.filter(|term| corrected.terms.last() != Some(term)) {
        corrected.to_mut().terms.push(term);
    }
    let mut falling = FallingTimeConstants::default();
    let corrects = |term: &Term| {
        matches!(
            term.effect.stage(),
            PredictionStage::Constant | PredictionStage::FallingTimeConstants
        )
    };
    let ordered = sorted_by_stage(&corrected.terms).into_iter();
    let correcting: Vec<Term> =
        ordered.map(|(_, term)| term).filter(|term| corrects(term)).cloned().collect();
    for Term { quantity, effect, .. } in correcting {
        let Machine { spindle, axes, .. } = corrected.to_mut();
        let mut constants = match quantity.axis().map(LinearAxis::index) {
            None => ModelConstants {
                spindle: Some(spindle),
                thermal: None,
                falling_s: &mut falling.spindle_s,
            },
            Some(axis) => ModelConstants {
                spindle: None,
                thermal: axes[axis].thermal.as_mut(),
                falling_s: &mut falling.axes_s[axis],
            },
        };
        effect.correct_constants(&mut constants);
    }
    (corrected, falling)
}

/// The memory of a machine's terms from row to row: a lag for each input of a term.
#[derive(Clone, Debug, Default)]
pub(super) struct TermLags(Vec<Vec<Lag>>);

impl TermLags {
    /// Returns the prediction `p_um` of `quantity` with the terms that change it, but for a time shift; `terms`
    /// in the order in which they act.
    pub(super) fn apply(
        &mut self,
        terms: &[Term],
        quantity: Quantity,
        time_s: f64,
        situation: &RowInputs<'_>,
        mut p_um: f64,
    ) -> f64 {
        self.0.resize_with(terms.len(), Default::default);
        let law_um = p_um;
        let mut constant_um = 0.0;
        for (term, lags) in terms.iter().zip(&mut self.0) {
            lags.resize_with(term.effect.required_inputs().len(), Lag::default);
            if term.quantity == quantity {
                p_um = apply_term(term, lags, time_s, situation, [law_um, p_um]);
                constant_um += term.constant_um;
            }
        }
        p_um + constant_um
    }
}

/// Returns the prediction with `term`, from that of the law alone and that so far.
fn apply_term(
    term: &Term,
    lags: &mut [Lag],
    time_s: f64,
    situation: &RowInputs<'_>,
    [law_um, p_um]: [f64; 2],
) -> f64 {
    let Term { effect, quantity, .. } = term;
    if matches!(
        effect.stage(),
        PredictionStage::Constant | PredictionStage::FallingTimeConstants | PredictionStage::Shift
    ) {
        return p_um;
    }
    let of = |axis: LinearAxis| situation.position_mm[axis.index()];
    let values = effect.values();
    let read = |(input, lag): (&LawInput<'_>, &mut Lag)| match *input {
        LawInput::Predicted => p_um,
        LawInput::Law => law_um,
        LawInput::Time => time_s,
        LawInput::Run => situation.run.unwrap_or(f64::NAN),
        LawInput::Temperature { column, lag_s } => {
            lag.step(lag_s, time_s, situation.temperature_c(column))
        }
        LawInput::Speed => situation.spindle_rpm.unwrap_or(f64::NAN),
        LawInput::SpeedHeat { power, lag_s } => {
            let rpm = situation.spindle_rpm.unwrap_or(f64::NAN);
            lag.step_from_zero(lag_s, time_s, relative_heat_input(power, rpm))
        }
        LawInput::Load => situation.load_n.unwrap_or(f64::NAN),
        LawInput::Feed => situation.feed_mm_per_min,
        LawInput::OwnPosition => quantity.axis().map_or(f64::NAN, of),
        LawInput::OwnDirection => {
            quantity.axis().map_or(1.0, |axis| situation.direction[axis.index()])
        }
        LawInput::Position(axis) => of(axis),
        LawInput::Column(column) => situation.other_column_value(column),
        LawInput::Lagged { column, lag_s } => {
            lag.step(lag_s, time_s, situation.other_column_value(column))
        }
        // Only a diagnosis reads it, to find the error of an instrument.
        LawInput::Believed => f64::NAN,
    };
    let x: Vec<f64> = effect.required_inputs().iter().zip(lags).map(read).collect();
    p_um + effect.evaluate_at(&values, &x)
}

/// Returns the shift in s of the predictions of `quantity`: the sum of its terms'.
#[must_use]
pub fn time_shift_s(terms: &[Term], quantity: Quantity) -> f64 {
    let of_quantity = terms.iter().filter(|term| term.quantity == quantity);
    of_quantity.map(|term| term.effect.time_shift_s()).sum()
}

/// Returns a series at t − shift for each of its own times: linear between the rows that have both, the
/// end values held. Where time runs back, a new run begins. NaN where the time is missing.
///
/// ```
/// use trueup_machine::model::shift_series;
/// let p = shift_series(&[0.0, 10.0, 20.0], &[1.0, 2.0, 4.0], 5.0);
/// assert_eq!(p, [1.0, 1.5, 3.0]);
/// ```
#[must_use]
pub fn shift_series(time_s: &[f64], values: &[f64], shift_s: f64) -> Vec<f64> {
    if shift_s == 0.0 {
        return values.to_vec();
    }
    let mut out = vec![f64::NAN; values.len()];
    let mut start = 0;
    while start < time_s.len() {
        let mut end = start;
        let mut last_s = f64::NEG_INFINITY;
        // A missing time belongs to the run around it; max() passes it over.
        while end < time_s.len() && (time_s[end].is_nan() || time_s[end] >= last_s) {
            last_s = last_s.max(time_s[end]);
            end += 1;
        }
        let known = |from: usize| (from..end).find(|&row| !(time_s[row] + values[row]).is_nan());
        let (mut before, mut after) = (None, known(start));
        for row in (start..end).filter(|&row| !time_s[row].is_nan()) {
            let at_s = time_s[row] - shift_s;
            while let Some(next) = after.filter(|&next| time_s[next] <= at_s) {
                (before, after) = (Some(next), known(next + 1));
            }
            out[row] = match (before, after) {
                (Some(a), Some(b)) => {
                    let share = (at_s - time_s[a]) / (time_s[b] - time_s[a]);
                    values[a] + share * (values[b] - values[a])
                }
                (Some(only), None) | (None, Some(only)) => values[only],
                (None, None) => f64::NAN,
            };
        }
        start = end;
    }
    out
}

/// Returns the same in these `rows` alone, which rise. Where times rise and nothing is missing only what is around them
/// is looked at.
///
/// ```
/// use trueup_machine::model::shift_series_at_rows;
/// assert_eq!(shift_series_at_rows(&[0.0, 10.0, 20.0], &[1.0, 2.0, 4.0], 5.0, &[0, 2]), [1.0, 3.0]);
/// ```
#[must_use]
pub fn shift_series_at_rows(
    time_s: &[f64],
    values: &[f64],
    shift_s: f64,
    rows: &[usize],
) -> Vec<f64> {
    let is_whole = !(time_s.iter().sum::<f64>() + values.iter().sum::<f64>()).is_nan();
    if shift_s == 0.0 || !is_whole || !time_s.is_sorted() {
        let all = shift_series(time_s, values, shift_s);
        return rows.iter().map(|&row| all[row]).collect();
    }
    let of = |&row: &usize| {
        let at_s = time_s[row] - shift_s;
        let after = time_s.partition_point(|time_s| *time_s <= at_s);
        if after == 0 || after == time_s.len() {
            return values[after.saturating_sub(1)];
        }
        let [(start_s, a), (end_s, b)] = [after - 1, after].map(|row| (time_s[row], values[row]));
        a + (at_s - start_s) / (end_s - start_s) * (b - a)
    };
    rows.iter().map(of).collect()
}

/// Returns the columns that the terms need and that may be missing in a run.
pub(super) fn required_term_columns(terms: &[Term]) -> Vec<String> {
    terms.iter().flat_map(|term| term.effect.required_columns(term.quantity)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn some_rows_are_shifted_as_all_rows_are() {
        let time_s: Vec<f64> = (0..200).map(|n| f64::from(n) + 0.4 * f64::from(n).sin()).collect();
        let values: Vec<f64> = time_s.iter().map(|t| (0.1 * t).sin()).collect();
        let mut late = time_s.clone();
        // Two rows at one time, and a time that runs back.
        late[50] = late[49];
        let mut twice = late.clone();
        twice[120..].iter_mut().for_each(|t| *t -= 300.0);
        let mut missing = values.clone();
        missing[70] = f64::NAN;
        let rows: Vec<usize> = (0..200).step_by(3).chain([199]).collect();
        // Shifts that end right at a row, and at two of one time.
        let pairs: Vec<f64> = (0..200).map(|n| f64::from(n / 2)).collect();
        for (time_s, values) in
            [(&late, &values), (&twice, &values), (&late, &missing), (&pairs, &values)]
        {
            for shift_s in [0.0, 0.3, 3.0, 17.0, -5.5, 1e4, -1e4] {
                let all = shift_series(time_s, values, shift_s);
                let some = shift_series_at_rows(time_s, values, shift_s, &rows);
                for (row, some) in rows.iter().zip(&some) {
                    let is_same =
                        (some - all[*row]).abs() < 1e-12 || some.is_nan() && all[*row].is_nan();
                    assert!(is_same, "{shift_s} s, row {row}: {some} {}", all[*row]);
                }
            }
        }
    }
}
