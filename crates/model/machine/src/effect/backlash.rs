//! `backlash`: the axis is left behind on reversal.
//!
//! ```text
//! p + w where the axis was approached in the negative direction
//! ```

use super::{
    cause_spec::{CauseSpec, Definition, Entry, Input, OnBoard, Parameter, Target, Value, number},
    data_view::{DataView, StartValues},
};
use crate::{
    file::axis::LinearAxis, file::read::Section, location::BadInput, model::pitch::is_reverse,
};

/// A width.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Backlash {
    /// w, in µm.
    pub width_um: f64,
}

impl CauseSpec for Backlash {
    fn entries(&self) -> Vec<Entry> {
        vec![("width_um", Value::Number(self.width_um))]
    }

    fn home(&self) -> Target {
        Target::Axis
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        vec![Input::OwnDirection]
    }

    fn values(&self) -> Vec<f64> {
        vec![self.width_um]
    }

    fn set(&mut self, values: &[f64]) {
        self.width_um = values[0];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![OnBoard::Reversed { width_um: self.width_um, um_per_m: 0.0 }]
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!(
            "Approached in the negative direction the axis stands {:+.2} µm further.",
            values[0]
        )
    }

    fn next_test(&self) -> &'static str {
        "Approach one position seven times from each side, at mid-travel and near both ends."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("width_um", 0, 0.0)]
    }
}

impl Definition for Backlash {
    const NAME: &'static str = "backlash";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["width_um"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { width_um: number(section, "width_um")? })
    }

    fn law(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, if is_reverse(x[0]) { 1.0 } else { 0.0 });
    }

    fn from_board(
        _own: Option<LinearAxis>,
        form: &OnBoard,
        _constant_um: &mut f64,
    ) -> Option<Self> {
        match *form {
            OnBoard::Reversed { width_um, um_per_m: 0.0 } => Some(Self { width_um }),
            _ => None,
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if survey.moves() && survey.turns() && survey.has_screw() {
            with(Self::default(), StartValues::none());
        }
    }
}
