//! `cutting-load`: the cut pushes the tool back.
//!
//! ```text
//! p − c·load          load in N, positive where it pushes the tool back
//! ```

use super::{
    cause_spec::{CauseSpec, Definition, Entry, Input, OnBoard, Parameter, Target, Value, number},
    data_view::{DataView, StartValues},
};
use crate::{file::axis::LinearAxis, file::read::Section, location::BadInput};

/// A compliance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CuttingLoad {
    /// c, in µm/N.
    pub um_per_n: f64,
}

impl CauseSpec for CuttingLoad {
    fn entries(&self) -> Vec<Entry> {
        vec![("um_per_n", Value::Number(self.um_per_n))]
    }

    fn home(&self) -> Target {
        Target::Elongation
    }

    fn tier(&self) -> u8 {
        1
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        vec![Input::Load]
    }

    fn values(&self) -> Vec<f64> {
        vec![self.um_per_n]
    }

    fn set(&mut self, values: &[f64]) {
        self.um_per_n = values[0];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![OnBoard::Load(-self.um_per_n)]
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!("The cut pushes the tool back by {:.2} µm for 1000 N.", values[0] * 1000.0)
    }

    fn next_test(&self) -> &'static str {
        "Press on the tool with a force gauge at standstill and read the dial."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("um_per_n", 0, 0.0)]
    }
}

impl Definition for CuttingLoad {
    const NAME: &'static str = "cutting-load";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["um_per_n"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { um_per_n: number(section, "um_per_n")? })
    }

    fn law(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, -x[0]);
    }

    fn from_board(
        _own: Option<LinearAxis>,
        form: &OnBoard,
        _constant_um: &mut f64,
    ) -> Option<Self> {
        match form {
            OnBoard::Load(um_per_n) => Some(Self { um_per_n: -um_per_n }),
            _ => None,
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if survey.grows() && survey.varies("load_n") {
            with(Self::default(), StartValues::none());
        }
    }
}
