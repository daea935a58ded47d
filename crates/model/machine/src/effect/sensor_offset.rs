//! `sensor-offset`: the zero of the sensor is elsewhere.
//!
//! ```text
//! p + o
//! ```

use super::{
    cause_spec::{CauseSpec, Definition, Entry, Input, OnBoard, Parameter, Target, Value, number},
    data_view::{DataView, StartValues},
};
use crate::{file::axis::LinearAxis, file::read::Section, location::BadInput};

/// A shift of what is predicted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorOffset {
    /// o, in µm.
    pub offset_um: f64,
}

impl CauseSpec for SensorOffset {
    fn entries(&self) -> Vec<Entry> {
        vec![("offset_um", Value::Number(self.offset_um))]
    }

    fn home(&self) -> Target {
        Target::Elongation
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        Vec::new()
    }

    fn values(&self) -> Vec<f64> {
        vec![self.offset_um]
    }

    fn set(&mut self, values: &[f64]) {
        self.offset_um = values[0];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![OnBoard::Offset(self.offset_um)]
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!("The zero of the sensor is off by {:+.2} µm.", values[0])
    }

    fn next_test(&self) -> &'static str {
        "Move the sensor's target by known gauge blocks over its whole range, up and down."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("offset_um", 0, 0.0)]
    }
}

impl Definition for SensorOffset {
    const NAME: &'static str = "sensor-offset";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["offset_um"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { offset_um: number(section, "offset_um")? })
    }

    fn law(&self, _: &[f64], _: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, 1.0);
    }

    fn from_board(own: Option<LinearAxis>, form: &OnBoard, constant_um: &mut f64) -> Option<Self> {
        match form {
            OnBoard::Offset(um) if own.is_none() => {
                let offset_um = um + std::mem::take(constant_um);
                Some(Self { offset_um })
            }
            _ => None,
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if survey.quantity().axis().is_none() && !survey.has_constant() {
            with(Self::default(), StartValues::none());
        }
    }
}
