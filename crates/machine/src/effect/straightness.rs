//! `straightness`: the guide of another axis is not straight.
//!
//! ```text
//! p + spline(P)          P of the axis that moves
//! ```

use super::{
    page::{
        Definition, Entry, Home, Host, Input, OnBoard, Page,
        Parameter, Value, axis,
    },
    survey::{Settings, Survey, even_knots, targets},
};
use crate::{
    file::{axis::LinearAxis, straightness::BSpline},
    file::straightness::read_spline,
    model::straightness::spline_weights,
    location::BadInput,
    file::read::Section,
};

/// A spline over another axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Straightness {
    /// The axis that moves.
    pub along: LinearAxis,
    /// The spline.
    pub spline: BSpline,
}

impl Page for Straightness {
    fn entries(&self) -> Vec<Entry> {
        vec![
            ("along", Value::Text(self.along.name().into())),
            // 2, 3 or 4.
            ("order", Value::Whole(self.spline.order as u32)),
            ("knots_mm", Value::Numbers(self.spline.knots_mm.clone())),
            ("control_um", Value::Numbers(self.spline.control_um.clone())),
        ]
    }

    fn home(&self) -> Home {
        Home::Axis
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
        vec![Parameter::Record(
            "spline",
            entries.map(|(key, value)| (key, Some(value))).collect(),
        )]
    }
}

impl Definition for Straightness {
    const NAME: &'static str = "straightness";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["along", "order", "knots_mm", "control_um"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { along: axis(section, "along")?, spline: read_spline(section, "control_um")? })
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

    fn propose(survey: &dyn Survey, with: &mut dyn FnMut(Self, Settings)) {
        for along in survey.other_axes() {
            let column = format!("{}_mm", along.name());
            let at = targets(survey.column(&column).unwrap_or(&[]), 1e-3);
            for controls in [5, 8, 12, 20] {
                if at.len() >= controls + 2 && survey.groups() >= 5 * controls {
                    let control_um = vec![0.0; controls];
                    let knots_mm = even_knots(&at, controls);
                    let spline = BSpline { order: 4, knots_mm, control_um };
                    with(Self { along, spline }, Settings::none());
                }
            }
        }
    }
}
