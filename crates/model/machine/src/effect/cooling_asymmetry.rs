//! `cooling-asymmetry`: it cools at another rate than it heats.
//!
//! ```text
//! the lag, or the warm-up, with τ while it falls
//! ```

use super::{
    cause_spec::{
        CauseSpec, Constants, Definition, Entry, Host, Nonlinear, Parameter, Stage, Target, Value,
        minutes, positive,
    },
    data_view::{DataView, FINE_TIME_CONSTANTS, StartValues},
    thermal_lag::ThermalLag,
};
use crate::{file::read::Section, file::spindle::ElongationSource, location::BadInput};

/// Another lag while it falls.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CoolingAsymmetry {
    /// τ, in s; above 0.
    pub time_constant_s: f64,
}

impl CauseSpec for CoolingAsymmetry {
    fn entries(&self) -> Vec<Entry> {
        vec![("time_constant_s", Value::Number(self.time_constant_s))]
    }

    fn home(&self) -> Target {
        Target::OwnThermometer
    }

    fn stage(&self) -> Stage {
        Stage::Falling
    }

    fn tier(&self) -> u8 {
        1
    }

    fn nonlinear(&self) -> &'static [Nonlinear] {
        &[Nonlinear::FallingTimeConstant]
    }

    fn amplitudes(&self) -> usize {
        0
    }

    fn refusal(&self, host: &Host<'_>) -> Option<String> {
        let is_warmup =
            host.quantity.axis().is_none() && host.spindle.source == Some(ElongationSource::Warmup);
        (!host.has_thermometer() && !is_warmup).then(|| "needs a lag or a warm-up to change".into())
    }

    fn correct(&self, constants: &mut Constants<'_>) {
        *constants.falling_s = Some(self.time_constant_s);
        if let Some(warmup) = constants.spindle.as_mut().and_then(|it| it.warmup.as_mut()) {
            warmup.cool_s = Some(self.time_constant_s);
        }
    }

    fn values(&self) -> Vec<f64> {
        vec![self.time_constant_s]
    }

    fn set(&mut self, values: &[f64]) {
        self.time_constant_s = values[0];
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!("It cools down with a time constant of its own: {}.", minutes(values[0]))
    }

    fn next_test(&self) -> &'static str {
        "Record a start from cold and a stop from warm, each until nothing moves any more."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("time_constant_s", 0, 0.0)]
    }
}

impl Definition for CoolingAsymmetry {
    const NAME: &'static str = "cooling-asymmetry";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["time_constant_s"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { time_constant_s: positive(section, "time_constant_s")? })
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let is_warmup = survey.source() == Some(ElongationSource::Warmup);
        let stood = || survey.column("spindle_rpm").is_some_and(|rpm| rpm.contains(&0.0));
        let lags = |believed_s| believed_s > 0.0 || survey.has(ThermalLag::NAME);
        if survey.believed_lag_s().is_some_and(lags) || is_warmup && stood() {
            with(Self::default(), survey.time_constants(FINE_TIME_CONSTANTS));
        }
    }
}
