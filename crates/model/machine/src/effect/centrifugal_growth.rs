//! `centrifugal-growth`: speed itself stretches the spindle.
//!
//! ```text
//! p + c·(n/1000)²          n in r/min
//! ```

use super::{
    cause_spec::{CauseSpec, Definition, Entry, Input, OnBoard, Parameter, Target, Value, number},
    data_view::{DataView, StartValues},
};
use crate::{file::axis::LinearAxis, file::read::Section, location::BadInput};

/// A parabola of the speed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CentrifugalGrowth {
    /// c, in µm at 1000 r/min.
    pub um_per_krpm2: f64,
}

impl CauseSpec for CentrifugalGrowth {
    fn entries(&self) -> Vec<Entry> {
        vec![("um_per_krpm2", Value::Number(self.um_per_krpm2))]
    }

    fn home(&self) -> Target {
        Target::Elongation
    }

    fn tier(&self) -> u8 {
        1
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        vec![Input::Speed]
    }

    fn values(&self) -> Vec<f64> {
        vec![self.um_per_krpm2]
    }

    fn set(&mut self, values: &[f64]) {
        self.um_per_krpm2 = values[0];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![OnBoard::Speed(self.um_per_krpm2)]
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!("Speed itself stretches the spindle: {:+.3} µm at 10 000 r/min.", values[0] * 100.0)
    }

    fn next_test(&self) -> &'static str {
        "Change the speed quickly, up and down: what comes at once is not heat."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("um_per_krpm2", 0, 0.0)]
    }
}

impl Definition for CentrifugalGrowth {
    const NAME: &'static str = "centrifugal-growth";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["um_per_krpm2"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { um_per_krpm2: number(section, "um_per_krpm2")? })
    }

    fn law(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, (x[0] / 1000.0).powi(2));
    }

    fn from_board(
        _own: Option<LinearAxis>,
        form: &OnBoard,
        _constant_um: &mut f64,
    ) -> Option<Self> {
        match *form {
            OnBoard::Speed(um_per_krpm2) => Some(Self { um_per_krpm2 }),
            _ => None,
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if survey.grows() && survey.varies("spindle_rpm") {
            with(Self::default(), StartValues::none());
        }
    }
}
