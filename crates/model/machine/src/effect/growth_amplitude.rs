//! `growth-amplitude`: it grows more or less than believed.
//!
//! ```text
//! s·p
//! ```

use super::{
    cause_spec::{
        CauseSpec, Definition, Entry, Input, OnBoard, Parameter, Stage, Target, Value, number,
    },
    data_view::{DataView, StartValues, spread},
};
use crate::{file::read::Section, file::spindle::ElongationSource, location::BadInput};

/// A factor of the growth.
#[derive(Clone, Debug, PartialEq)]
pub struct GrowthAmplitude {
    /// s; 1: no change.
    pub scale: f64,
}

impl Default for GrowthAmplitude {
    fn default() -> Self {
        Self { scale: 1.0 }
    }
}

impl CauseSpec for GrowthAmplitude {
    fn entries(&self) -> Vec<Entry> {
        vec![("scale", Value::Number(self.scale))]
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

    /// Returns a growth that is not within a factor of two of what is believed is not the same growth:
    /// another path carries it.
    fn amplitude_limits(&self) -> Option<[f64; 2]> {
        Some([-0.5, 1.0])
    }

    fn values(&self) -> Vec<f64> {
        vec![self.scale - 1.0]
    }

    fn set(&mut self, values: &[f64]) {
        self.scale = 1.0 + values[0];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![OnBoard::Gain(self.scale)]
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!("The growth is {:.3} times what the model says.", 1.0 + values[0])
    }

    fn next_test(&self) -> &'static str {
        "Repeat the run at another speed and compare the factor."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("scale", 0, 1.0)]
    }
}

impl Definition for GrowthAmplitude {
    const NAME: &'static str = "growth-amplitude";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["scale"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { scale: number(section, "scale")? })
    }

    fn law(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, x[0]);
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let grows = matches!(
            survey.source(),
            Some(ElongationSource::Temperature | ElongationSource::Warmup)
        );
        if grows && spread(survey.law()) > 0.0 {
            with(Self::default(), StartValues::none());
        }
    }
}
