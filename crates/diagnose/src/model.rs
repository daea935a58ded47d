//! The model and its terms in columns: what `trueup predict` does row by row, fast enough to be tried
//! thousands of times.
//!
//! The order is fixed: constants of the model, then gain, curvature and saturation of the source, then
//! what is added, then the shift in time. `trueup predict` gives the same figures from the terms in
//! `extended.toml` (tested).

use trueup_machine::{effect::Stage, model::shifted};

use crate::{
    columns::basis,
    data::Data,
    kind::{Kind, Part},
    laws::Laws,
};

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

    /// The prediction of each row.
    pub(crate) fn predict(&self, data: &Data) -> Vec<f64> {
        match self.shift_s() {
            Some(shift_s) => shifted_rows(data, &self.unshifted(data.whole()), shift_s),
            None => self.unshifted(data),
        }
    }

    /// By how much all of it is late.
    pub(crate) fn shift_s(&self) -> Option<f64> {
        let part = self.parts.iter().find(|part| part.kind.is_shift())?;
        Some(part.values[0])
    }

    /// The prediction of each row, as if nothing were late.
    pub(crate) fn unshifted(&self, data: &Data) -> Vec<f64> {
        let laws = Laws::corrected(data, &self.parts);
        let mut elongation = laws.elongation(data);
        let mut axis = laws.axis(data);
        for part in self.parts.iter().filter(|part| !part.kind.corrects() && !part.kind.is_shift())
        {
            let is_of_elongation = part.kind.is_of_elongation(data);
            let p = if is_of_elongation { &mut elongation } else { &mut axis };
            let (nonlinear, amplitudes) = part.values.split_at(part.kind.nonlinear().len());
            let columns = basis(&part.kind, nonlinear, data, p);
            // What has no amplitude is added as it is.
            let amplitudes = if amplitudes.is_empty() { &[1.0] } else { amplitudes };
            for (column, amplitude) in columns.iter().zip(amplitudes) {
                if *amplitude != 0.0 {
                    p.iter_mut().zip(column).for_each(|(p, c)| *p += amplitude * c);
                }
            }
        }
        let constant = self.constant_um.unwrap_or(0.0);
        elongation
            .iter()
            .zip(&data.along)
            .zip(&axis)
            .map(|((e, along), a)| if *along == 0.0 { *a } else { e * along + a } + constant)
            .collect()
    }
}

/// The rows of `data` of a prediction for the whole that they were drawn from, `shift_s` late: what is
/// predicted at another time may be of a row that was not drawn.
pub(crate) fn shifted_rows(data: &Data, whole_um: &[f64], shift_s: f64) -> Vec<f64> {
    let whole = data.whole();
    let shifted = match &whole.time_s {
        Some(time_s) => shifted_all(whole, time_s, whole_um, shift_s),
        None => whole_um.to_vec(),
    };
    match &data.whole {
        Some(drawn) => drawn.pick(&shifted),
        None => shifted,
    }
}

fn shifted_all(data: &Data, time_s: &[f64], sum: &[f64], shift_s: f64) -> Vec<f64> {
    // Files may overlap in time without running back; each is shifted for itself.
    let mut out = Vec::with_capacity(sum.len());
    let mut start = 0;
    for file in 0..data.files {
        let end = data.file.partition_point(|&there| there <= file);
        out.extend(shifted(&time_s[start..end], &sum[start..end], shift_s));
        start = end;
    }
    out
}
