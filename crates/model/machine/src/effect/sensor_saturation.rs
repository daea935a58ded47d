//! `sensor-saturation`: the sensor's range ends.
//!
//! ```text
//! min(p, limit)
//! ```

use super::{
    cause_spec::{
        CauseSpec, Definition, Entry, Input, Nonlinear, OnBoard, Parameter, Stage, Target, Value,
        number,
    },
    data_view::{DataView, StartValues, spread},
};
use crate::{
    file::read::Section,
    file::{axis::LinearAxis, spindle::ElongationSource},
    location::BadInput,
};

/// A limit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorSaturation {
    /// The largest elongation that it shows, in µm.
    pub limit_um: f64,
}

impl CauseSpec for SensorSaturation {
    fn entries(&self) -> Vec<Entry> {
        vec![("limit_um", Value::Number(self.limit_um))]
    }

    fn home(&self) -> Target {
        Target::Elongation
    }

    fn stage(&self) -> Stage {
        Stage::Limit
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        vec![Input::Predicted]
    }

    fn nonlinear(&self) -> &'static [Nonlinear] {
        &[Nonlinear::Limit]
    }

    fn amplitudes(&self) -> usize {
        0
    }

    fn values(&self) -> Vec<f64> {
        vec![self.limit_um]
    }

    fn set(&mut self, values: &[f64]) {
        self.limit_um = values[0];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![OnBoard::Saturation(self.limit_um)]
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!("The sensor shows nothing above {:.1} µm.", values[0])
    }

    fn next_test(&self) -> &'static str {
        "Stop the spindle, then read the sensor against a dial gauge just below and above the limit."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("limit_um", 0, 0.0)]
    }
}

impl Definition for SensorSaturation {
    const NAME: &'static str = "sensor-saturation";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["limit_um"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { limit_um: number(section, "limit_um")? })
    }

    fn law(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        // A missing p is not above the limit, and stays missing.
        add(0, if x[0] > nonlinear[0] { nonlinear[0] - x[0] } else { 0.0 });
    }

    fn from_board(_: Option<LinearAxis>, form: &OnBoard, _: &mut f64) -> Option<Self> {
        match *form {
            OnBoard::Saturation(limit_um) => Some(Self { limit_um }),
            _ => None,
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if survey.source() == Some(ElongationSource::Sensor) && spread(survey.law()) > 0.0 {
            with(Self::default(), StartValues::at(quantiles(survey.law())));
        }
    }
}

/// Limits to try: where a part of what is predicted is above.
fn quantiles(values: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share) as usize];
    if sorted.len() < 8 {
        return Vec::new();
    }
    [0.2, 0.35, 0.5, 0.6, 0.7, 0.78, 0.84, 0.9, 0.94, 0.97].map(at).to_vec()
}
