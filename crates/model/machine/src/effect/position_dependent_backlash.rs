//! `position-dependent-backlash`: backlash differs along the axis.
//!
//! ```text
//! p + c·P/1000 where the axis was approached in the negative direction
//! ```

use super::{
    cause_spec::{CauseSpec, Definition, Entry, Input, OnBoard, Parameter, Target, Value, number},
    data_view::{DataView, StartValues},
};
use crate::{
    file::axis::LinearAxis, file::read::Section, location::BadInput, model::pitch::is_reverse,
};

/// A backlash that grows along the axis.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PositionDependentBacklash {
    /// c, in µm/m.
    pub um_per_m: f64,
}

impl CauseSpec for PositionDependentBacklash {
    fn entries(&self) -> Vec<Entry> {
        vec![("um_per_m", Value::Number(self.um_per_m))]
    }

    fn home(&self) -> Target {
        Target::Axis
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        vec![Input::OwnPosition, Input::OwnDirection]
    }

    fn values(&self) -> Vec<f64> {
        vec![self.um_per_m]
    }

    fn set(&mut self, values: &[f64]) {
        self.um_per_m = values[0];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![OnBoard::Reversed { width_um: 0.0, um_per_m: self.um_per_m }]
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!("The backlash changes by {:+.2} µm over a metre of the axis.", values[0])
    }

    fn next_test(&self) -> &'static str {
        "Approach one position seven times from each side, at mid-travel and near both ends."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("um_per_m", 0, 0.0)]
    }
}

impl Definition for PositionDependentBacklash {
    const NAME: &'static str = "position-dependent-backlash";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["um_per_m"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { um_per_m: number(section, "um_per_m")? })
    }

    fn law(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, if is_reverse(x[1]) { x[0] / 1000.0 } else { 0.0 });
    }

    fn from_board(
        _own: Option<LinearAxis>,
        form: &OnBoard,
        _constant_um: &mut f64,
    ) -> Option<Self> {
        match *form {
            OnBoard::Reversed { um_per_m, .. } if um_per_m != 0.0 => Some(Self { um_per_m }),
            _ => None,
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if survey.moves() && survey.turns() && survey.has_screw() {
            with(Self::default(), StartValues::none());
        }
    }
}
