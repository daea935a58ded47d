//! The model and its terms in columns: what `trueup predict` does row by row, fast enough to be tried
//! thousands of times.
//!
//! The terms that the machine file has are parts of the model from the beginning, held at the values
//! that the file says, until the model has one of them itself: then its values are the model's.
//!
//! The order is that of [`trueup_machine::effect`]. `trueup predict` gives the same figures from the
//! terms in `extended.toml` (tested).

use std::borrow::Cow;

use trueup_machine::{
    effect::PredictionStage,
    model::{shift_series, shift_series_at_rows},
};

use crate::{
    columns::part_contribution,
    data::{DataTable, ParentTable},
    machine_laws::MachineLaws,
    term_kind::{ModelPart, TermKind},
};

/// A law that settles this many times as fast, or as slowly, is another one.
pub(crate) const MIN_DISTINCT_RATE_RATIO: f64 = 2.0;

/// Terms and a constant, on top of what the machine file says.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Model {
    pub parts: Vec<ModelPart>,
    /// The zero of the measurement, where it is arbitrary.
    pub constant_um: Option<f64>,
}

impl Model {
    /// The parts in their fixed order.
    pub(crate) fn sort_parts(&mut self) {
        // Corrections of constants are in no order among each other.
        self.parts.sort_by_key(|part| {
            part.kind.prediction_stage().max(PredictionStage::FallingTimeConstants)
        });
    }

    pub(crate) fn contains(&self, kind: &TermKind) -> bool {
        self.parts.iter().any(|part| part.kind == *kind)
    }

    /// Returns the part that settles from the start on as fast as the law of another part does, and that part: the
    /// machine had not settled when the record began, and the lagged law cannot know where it stood.
    pub(crate) fn find_initial_transient(&self) -> Option<[&ModelPart; 2]> {
        let is_start = |part: &&ModelPart| part.kind.is_settling_from_start();
        let start = self.parts.iter().find(is_start)?;
        let late = |part: &&ModelPart| {
            let is_alike =
                || (part.values[0] / start.values[0]).ln().abs() < MIN_DISTINCT_RATE_RATIO.ln();
            part.kind.has_time_constant() && !is_start(part) && is_alike()
        };
        self.parts.iter().find(late).map(|late| [start, late])
    }

    /// Returns whether it, or the machine file, moves all of the model in time.
    pub(crate) fn has_time_shift(&self, data: &DataTable) -> bool {
        self.parts.iter().any(|part| part.kind.is_time_shift())
            || data
                .setting
                .stated
                .iter()
                .any(|stated| stated.effect.stage() == PredictionStage::Shift)
    }

    /// Returns the model with the terms of the machine file that it does not have itself.
    pub(crate) fn with_machine_terms(&self, data: &DataTable) -> Cow<'_, Self> {
        let parts = data.setting.stated.iter().map(ModelPart::from_stated_term);
        let held: Vec<ModelPart> = parts.filter(|part| !self.contains(&part.kind)).collect();
        if held.is_empty() {
            return Cow::Borrowed(self);
        }
        let mut with = self.clone();
        with.parts.extend(held);
        with.sort_parts();
        Cow::Owned(with)
    }

    /// Returns the prediction of each row.
    pub(crate) fn predict(&self, data: &DataTable) -> Vec<f64> {
        let model = self.with_machine_terms(data);
        match model.time_shift_s() {
            Some(shift_s) => {
                shift_prediction(data, &model.predict_unshifted(data.full_table()), shift_s)
            }
            None => model.predict_unshifted(data),
        }
    }

    /// By how much all of it is late, by its own parts.
    pub(crate) fn time_shift_s(&self) -> Option<f64> {
        let shifts = self.parts.iter().filter(|part| part.kind.is_time_shift());
        shifts.map(|part| part.values[0]).reduce(|a, b| a + b)
    }

    /// Returns the prediction of each row by its own parts, as if nothing were late.
    pub(crate) fn predict_unshifted(&self, data: &DataTable) -> Vec<f64> {
        let laws = MachineLaws::with_corrections(data, &self.parts);
        let mut elongation = laws.elongation_um(data);
        let mut axis = laws.axis_error_um(data);
        for part in self
            .parts
            .iter()
            .filter(|part| !part.kind.is_constant_correction() && !part.kind.is_time_shift())
        {
            let is_of_elongation = part.kind.affects_elongation(data);
            let p = if is_of_elongation { &mut elongation } else { &mut axis };
            let added = part_contribution(&part.kind, &part.values, data, p);
            p.to_mut().iter_mut().zip(&added).for_each(|(p, added)| *p += added);
        }
        let [of_elongation_um, of_axis_um] = data.setting.constants_um;
        let constant_um = self.constant_um.unwrap_or(0.0) + of_axis_um;
        let mut predicted = axis.into_owned();
        let grown = elongation.iter().zip(data.predicted.along.iter());
        for (p, (e, along)) in predicted.iter_mut().zip(grown) {
            let grown_um = if *along == 0.0 { 0.0 } else { (e + of_elongation_um) * along };
            *p = grown_um + *p + constant_um;
        }
        predicted
    }
}

/// Returns the rows of `data` of a prediction for the whole that they were drawn from, `shift_s` late: what is
/// predicted at another time may be of a row that was not drawn.
pub(crate) fn shift_prediction(data: &DataTable, whole_um: &[f64], shift_s: f64) -> Vec<f64> {
    let whole = data.full_table();
    let drawn = data.sampling_parent().map(ParentTable::first_source_rows);
    let Some(time_s) = whole.time_s() else {
        return data
            .sampling_parent()
            .map_or_else(|| whole_um.to_vec(), |drawn| drawn.aggregate_values(whole_um));
    };
    // Files may overlap in time without running back; each is shifted for itself.
    let mut out = Vec::with_capacity(data.rows);
    let mut start = 0;
    for file in 0..whole.setting.files.len() {
        let end = whole.places.file.partition_point(|&there| there as usize <= file);
        let (time_s, um) = (&time_s[start..end], &whole_um[start..end]);
        out.extend(match &drawn {
            None => shift_series(time_s, um, shift_s),
            Some(rows) => {
                let [from, to] = [start, end].map(|end| rows.partition_point(|&row| row < end));
                let rows: Vec<usize> = rows[from..to].iter().map(|row| row - start).collect();
                shift_series_at_rows(time_s, um, shift_s, &rows)
            }
        });
        start = end;
    }
    out
}
