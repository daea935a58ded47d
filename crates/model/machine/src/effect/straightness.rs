//! `straightness`: the guide of another axis is not straight.
//!
//! ```text
//! p + spline(P)          P of the axis that moves
//! ```

use super::{
    cause_spec::{
        CauseSpec, Definition, Entry, Host, Input, OnBoard, Parameter, Target, Value, axis,
    },
    data_view::{DataView, StartValues, even_knots, targets},
};
use crate::file::keys::term::{ALONG, CONTROL_UM, KNOTS_MM, ORDER};
use crate::{
    file::read::Section,
    file::straightness::{SplineKeys, read_spline, spline_entries},
    file::{axis::LinearAxis, straightness::BSpline},
    location::BadInput,
    model::straightness::spline_weights,
};

/// A spline over another axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Straightness {
    /// The axis that moves.
    pub along: LinearAxis,
    /// The spline.
    pub spline: BSpline,
}

/// Control points of the curves that are tried.
const CONTROLS: [usize; 4] = [5, 8, 12, 20];

/// Returns the knots of the cubic spline that passes through a value at each of these places, at least 4, in
/// order: one at each but for the second and the last but one.
fn knots_through(at: &[f64]) -> Vec<f64> {
    let last = at.len() - 1;
    let mut knots = vec![at[0]; 4];
    knots.extend(&at[2..last - 1]);
    knots.extend([at[last]; 4]);
    knots
}

/// The keys of the spline.
const CURVE: SplineKeys = [ORDER, KNOTS_MM, CONTROL_UM];

impl CauseSpec for Straightness {
    fn entries(&self) -> Vec<Entry> {
        let along = (ALONG.name, Value::Text(self.along.name().into()));
        [along].into_iter().chain(spline_entries(&self.spline, &CURVE)).collect()
    }

    fn home(&self) -> Target {
        Target::Axis
    }

    fn refusal(&self, host: &Host<'_>) -> Option<String> {
        (host.quantity.axis() == Some(self.along))
            .then(|| "is the error of another axis than the one that moves".into())
    }

    fn tier(&self) -> u8 {
        1
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        vec![Input::Position(self.along)]
    }

    fn amplitudes(&self) -> usize {
        self.spline.control_um.len()
    }

    fn list_length(&self) -> Option<usize> {
        Some(self.amplitudes())
    }

    fn values(&self) -> Vec<f64> {
        self.spline.control_um.clone()
    }

    fn set(&mut self, values: &[f64]) {
        self.spline.control_um = values.to_vec();
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![OnBoard::Curve(self.along, self.spline.clone())]
    }

    fn sentence(&self, _: &[f64]) -> String {
        format!("The guide of the {} axis is not straight.", self.along.name().to_uppercase())
    }

    fn next_test(&self) -> &'static str {
        "Turn the straight edge by 180° and measure again: what turns with it is the edge's."
    }

    fn parameters(&self, values: &[f64]) -> Vec<Parameter> {
        let mut fitted = self.clone();
        fitted.set(values);
        let entries = fitted.entries().into_iter();
        vec![Parameter::Record("spline", entries.map(|(key, value)| (key, Some(value))).collect())]
    }
}

impl Definition for Straightness {
    const NAME: &'static str = "straightness";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &[ALONG.name, ORDER.name, KNOTS_MM.name, CONTROL_UM.name]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { along: axis(section, ALONG)?, spline: read_spline(section, &CURVE)? })
    }

    fn law(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        let (first, weights) = spline_weights(&self.spline, x[0]);
        for (number, weight) in weights.into_iter().take(self.spline.order).enumerate() {
            add(first + number, weight);
        }
    }

    fn from_board(_: Option<LinearAxis>, form: &OnBoard, _: &mut f64) -> Option<Self> {
        match form {
            OnBoard::Curve(along, spline) => Some(Self { along: *along, spline: spline.clone() }),
            _ => None,
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        for along in survey.other_axes() {
            let column = format!("{}_mm", along.name());
            let at = targets(survey.column(&column).unwrap_or(&[]), 1e-3);
            let mut try_knots = |knots_mm: Vec<f64>| {
                let controls = knots_mm.len() - 4;
                if survey.groups() >= 5 * controls {
                    let spline = BSpline { order: 4, knots_mm, control_um: vec![0.0; controls] };
                    with(Self { along, spline }, StartValues::none());
                }
            };
            for controls in CONTROLS.into_iter().filter(|controls| at.len() >= controls + 2) {
                try_knots(even_knots(&at, controls));
            }
            // Of few places a map has seen each often, whatever the other axis did.
            if (4..=CONTROLS[CONTROLS.len() - 1]).contains(&at.len()) {
                try_knots(knots_through(&at));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_through_all_places_has_a_control_point_for_each_and_takes_any_values() {
        for at in [&[0.0, 10.0, 25.0, 40.0][..], &[0.0, 1.0, 7.0, 8.0, 20.0, 30.0]] {
            let knots_mm = knots_through(at);
            assert_eq!(knots_mm.len() - 4, at.len());
            // Each control point weighs at its own place: the fit is determined.
            let spline = BSpline { order: 4, knots_mm, control_um: vec![0.0; at.len()] };
            for (place, &mm) in at.iter().enumerate() {
                let (first, weights) = spline_weights(&spline, mm);
                assert!((first..first + 4).contains(&place) && weights[place - first] > 0.01);
            }
        }
    }
}
