//! `sensor-gain`: the sensor gives more or less for a micrometre.
//!
//! ```text
//! g·p
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

/// A factor.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorGain {
    /// g; 1: no change.
    pub gain: f64,
}

impl Default for SensorGain {
    fn default() -> Self {
        Self { gain: 1.0 }
    }
}

impl CauseSpec for SensorGain {
    fn entries(&self) -> Vec<Entry> {
        vec![("gain", Value::Number(self.gain))]
    }

    fn home(&self) -> Target {
        Target::Elongation
    }

    fn stage(&self) -> Stage {
        Stage::Factor
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        vec![Input::Predicted]
    }

    /// Returns a gain that turns the sign, or is off by more than a factor of five, is another machine's.
    fn amplitude_limits(&self) -> Option<[f64; 2]> {
        Some([-0.8, 4.0])
    }

    fn values(&self) -> Vec<f64> {
        vec![self.gain - 1.0]
    }

    fn set(&mut self, values: &[f64]) {
        self.gain = 1.0 + values[0];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![OnBoard::Gain(self.gain)]
    }

    fn sentence(&self, values: &[f64]) -> String {
        let gain = 1.0 + values[0];
        format!("The tool moves {gain:.4} µm for each micrometre that the sensor shows.")
    }

    fn next_test(&self) -> &'static str {
        "Move the sensor's target by known gauge blocks over its whole range, up and down."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("gain", 0, 1.0)]
    }
}

impl Definition for SensorGain {
    const NAME: &'static str = "sensor-gain";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["gain"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { gain: number(section, "gain")? })
    }

    fn law(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, x[0]);
    }

    fn from_board(_: Option<LinearAxis>, form: &OnBoard, _: &mut f64) -> Option<Self> {
        match *form {
            OnBoard::Gain(gain) => Some(Self { gain }),
            _ => None,
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if survey.source() == Some(ElongationSource::Sensor) && spread(survey.law()) > 0.0 {
            with(Self::default(), StartValues::none());
        }
    }
}
