//! `growth-rate`: it grows faster or slower than believed.
//!
//! ```text
//! Smax·(1 − e^(−(t − t₁)/τ)) after t₁, in place of the warm-up with (t₂ − t₁)/k
//! ```

use super::{
    cause_spec::{
        CauseSpec, Constants, Definition, Entry, Host, Nonlinear, Parameter, Stage, Target, Value,
        minutes, positive,
    },
    data_view::{DataView, FINE_TIME_CONSTANTS, StartValues},
};
use crate::{file::read::Section, file::spindle::ElongationSource, location::BadInput};

/// A warm-up without an end.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GrowthRate {
    /// τ, in s; above 0.
    pub time_constant_s: f64,
}

impl CauseSpec for GrowthRate {
    fn entries(&self) -> Vec<Entry> {
        vec![("time_constant_s", Value::Number(self.time_constant_s))]
    }

    fn home(&self) -> Target {
        Target::Elongation
    }

    fn stage(&self) -> Stage {
        Stage::Constant
    }

    fn nonlinear(&self) -> &'static [Nonlinear] {
        &[Nonlinear::TimeConstant]
    }

    fn amplitudes(&self) -> usize {
        0
    }

    fn refusal(&self, host: &Host<'_>) -> Option<String> {
        let is_warmup = host.spindle.source == Some(ElongationSource::Warmup);
        (host.quantity.axis().is_some() || !is_warmup)
            .then(|| "needs [spindle] source = \"warmup\"".into())
    }

    fn correct(&self, constants: &mut Constants<'_>) {
        /// So large an exponent makes the warm-up an exponential without an end: 1 − e^(−40) is 1.
        const ENDLESS: f64 = 40.0;
        if let Some(warmup) = constants.spindle.as_mut().and_then(|it| it.warmup.as_mut()) {
            warmup.exponent = ENDLESS;
            warmup.warm_s = warmup.lag_s + ENDLESS * self.time_constant_s;
        }
    }

    fn values(&self) -> Vec<f64> {
        vec![self.time_constant_s]
    }

    fn set(&mut self, values: &[f64]) {
        self.time_constant_s = values[0];
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!("The spindle warms up with a time constant of {}.", minutes(values[0]))
    }

    fn next_test(&self) -> &'static str {
        "Record a start from cold and a stop from warm, each until nothing moves any more."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("time_constant_s", 0, 0.0)]
    }
}

impl Definition for GrowthRate {
    const NAME: &'static str = "growth-rate";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["time_constant_s"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { time_constant_s: positive(section, "time_constant_s")? })
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if survey.source() == Some(ElongationSource::Warmup) {
            with(Self::default(), survey.time_constants(FINE_TIME_CONSTANTS));
        }
    }
}
