//! `sensor-curvature`: the sensor's characteristic is bent.
//!
//! ```text
//! p + c·p²
//! ```

use super::{
    cause_spec::{
        CauseSpec, Definition, Entry, Input, OnBoard, Parameter, Stage, Target, Value, number,
    },
    data_view::{DataView, StartValues, spread},
};
use crate::{
    file::read::Section,
    file::{axis::LinearAxis, spindle::ElongationSource},
    location::BadInput,
};

/// A parabola.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorCurvature {
    /// c, in 1/µm.
    pub per_um: f64,
}

impl CauseSpec for SensorCurvature {
    fn entries(&self) -> Vec<Entry> {
        vec![("per_um", Value::Number(self.per_um))]
    }

    fn home(&self) -> Target {
        Target::Elongation
    }

    fn stage(&self) -> Stage {
        Stage::Bend
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        vec![Input::Predicted]
    }

    fn values(&self) -> Vec<f64> {
        vec![self.per_um]
    }

    fn set(&mut self, values: &[f64]) {
        self.per_um = values[0];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![OnBoard::Curvature(self.per_um)]
    }

    fn sentence(&self, values: &[f64]) -> String {
        let um = values[0] * 2500.0;
        format!("The sensor's characteristic is bent: at 50 µm it is off by {um:+.2} µm.")
    }

    fn next_test(&self) -> &'static str {
        "Move the sensor's target by known gauge blocks over its whole range, up and down."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("per_um", 0, 0.0)]
    }
}

impl Definition for SensorCurvature {
    const NAME: &'static str = "sensor-curvature";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["per_um"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { per_um: number(section, "per_um")? })
    }

    fn law(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, x[0] * x[0]);
    }

    fn from_board(_: Option<LinearAxis>, form: &OnBoard, _: &mut f64) -> Option<Self> {
        match *form {
            OnBoard::Curvature(per_um) => Some(Self { per_um }),
            _ => None,
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if survey.source() == Some(ElongationSource::Sensor) && spread(survey.law()) > 0.0 {
            with(Self::default(), StartValues::none());
        }
    }
}
