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
    effect::Stage,
    model::{shifted, shifted_at},
};

use crate::{
    columns::sum,
    data::{Data, DrawnFrom},
    kind::{Kind, Part},
    laws::Laws,
};

/// A law that settles this many times as fast, or as slowly, is another one.
pub(crate) const ANOTHER_LAW: f64 = 2.0;

/// Terms and a constant, on top of what the machine file says.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Model {
    pub parts: Vec<Part>,
    /// The zero of the measurement, where it is arbitrary.
    pub constant_um: Option<f64>,
}

impl Model {
    /// The parts in their fixed order.
    pub(crate) fn sort(&mut self) {
        // Corrections of constants are in no order among each other.
        self.parts.sort_by_key(|part| part.kind.stage().max(Stage::Falling));
    }

    pub(crate) fn has(&self, kind: &Kind) -> bool {
        self.parts.iter().any(|part| part.kind == *kind)
    }

    /// Returns the part that settles from the start on as fast as the law of another part does, and that part: the
    /// machine had not settled when the record began, and the lagged law cannot know where it stood.
    pub(crate) fn unsettled_start(&self) -> Option<[&Part; 2]> {
        let is_start = |part: &&Part| part.kind.is_from_the_start();
        let start = self.parts.iter().find(is_start)?;
        let late = |part: &&Part| {
            let is_alike = || (part.values[0] / start.values[0]).ln().abs() < ANOTHER_LAW.ln();
            part.kind.has_time_constant() && !is_start(part) && is_alike()
        };
        self.parts.iter().find(late).map(|late| [start, late])
    }

    /// Returns whether it, or the machine file, moves all of the model in time.
    pub(crate) fn has_shift(&self, data: &Data) -> bool {
        self.parts.iter().any(|part| part.kind.is_shift())
            || data.stated.iter().any(|stated| stated.effect.stage() == Stage::Shift)
    }

    /// Returns the model with the terms of the machine file that it does not have itself.
    pub(crate) fn with_stated(&self, data: &Data) -> Cow<'_, Self> {
        let parts = data.stated.iter().map(Part::stated);
        let held: Vec<Part> = parts.filter(|part| !self.has(&part.kind)).collect();
        if held.is_empty() {
            return Cow::Borrowed(self);
        }
        let mut with = self.clone();
        with.parts.extend(held);
        with.sort();
        Cow::Owned(with)
    }

    /// Returns the prediction of each row.
    pub(crate) fn predict(&self, data: &Data) -> Vec<f64> {
        let model = self.with_stated(data);
        match model.shift_s() {
            Some(shift_s) => shifted_rows(data, &model.unshifted(data.without_holes()), shift_s),
            None => model.unshifted(data),
        }
    }

    /// By how much all of it is late, by its own parts.
    pub(crate) fn shift_s(&self) -> Option<f64> {
        let shifts = self.parts.iter().filter(|part| part.kind.is_shift());
        shifts.map(|part| part.values[0]).reduce(|a, b| a + b)
    }

    /// Returns the prediction of each row by its own parts, as if nothing were late.
    pub(crate) fn unshifted(&self, data: &Data) -> Vec<f64> {
        let laws = Laws::corrected(data, &self.parts);
        let mut elongation = laws.elongation(data);
        let mut axis = laws.axis(data);
        for part in self.parts.iter().filter(|part| !part.kind.corrects() && !part.kind.is_shift())
        {
            let is_of_elongation = part.kind.is_of_elongation(data);
            let p = if is_of_elongation { &mut elongation } else { &mut axis };
            let added = sum(&part.kind, &part.values, data, p);
            p.to_mut().iter_mut().zip(&added).for_each(|(p, added)| *p += added);
        }
        let [of_elongation_um, of_axis_um] = data.constants_um;
        let constant_um = self.constant_um.unwrap_or(0.0) + of_axis_um;
        let mut predicted = axis.into_owned();
        let grown = elongation.iter().zip(data.along.iter());
        for (p, (e, along)) in predicted.iter_mut().zip(grown) {
            let grown_um = if *along == 0.0 { 0.0 } else { (e + of_elongation_um) * along };
            *p = grown_um + *p + constant_um;
        }
        predicted
    }
}

/// Returns the rows of `data` of a prediction for the whole that they were drawn from, `shift_s` late: what is
/// predicted at another time may be of a row that was not drawn.
pub(crate) fn shifted_rows(data: &Data, whole_um: &[f64], shift_s: f64) -> Vec<f64> {
    let whole = data.without_holes();
    let drawn = data.drawn().map(DrawnFrom::rows);
    let Some(time_s) = &whole.time_s else {
        return data.drawn().map_or_else(|| whole_um.to_vec(), |drawn| drawn.pick(whole_um));
    };
    // Files may overlap in time without running back; each is shifted for itself.
    let mut out = Vec::with_capacity(data.rows);
    let mut start = 0;
    for file in 0..whole.files {
        let end = whole.file.partition_point(|&there| there as usize <= file);
        let (time_s, um) = (&time_s[start..end], &whole_um[start..end]);
        out.extend(match &drawn {
            None => shifted(time_s, um, shift_s),
            Some(rows) => {
                let [from, to] = [start, end].map(|end| rows.partition_point(|&row| row < end));
                let rows: Vec<usize> = rows[from..to].iter().map(|row| row - start).collect();
                shifted_at(time_s, um, shift_s, &rows)
            }
        });
        start = end;
    }
    out
}
