//! `thermal-lag`: growth follows its thermometer late.
//!
//! ```text
//! p from the temperature behind a lag of τ
//! ```

use super::{
    cause_spec::{
        CauseSpec, Constants, Definition, Entry, Host, Nonlinear, Parameter, Stage, Target, Value,
        minutes, positive,
    },
    data_view::{DataView, FINE_TIME_CONSTANTS, StartValues, TIME_CONSTANTS},
};
use crate::{file::read::Section, location::BadInput};

/// Another lag.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ThermalLag {
    /// τ in place of the believed one, in s; above 0.
    pub time_constant_s: f64,
}

impl CauseSpec for ThermalLag {
    fn entries(&self) -> Vec<Entry> {
        vec![("time_constant_s", Value::Number(self.time_constant_s))]
    }

    fn home(&self) -> Target {
        Target::OwnThermometer
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
        (!host.has_thermometer()).then(|| {
            format!(
                "needs a temperature on which {} depends: [spindle] source = \"temperature\", or \
                 [axis.*.thermal]",
                host.quantity.name()
            )
        })
    }

    fn correct(&self, constants: &mut Constants<'_>) {
        let spindle = constants.spindle.as_mut().and_then(|it| it.temperature.as_mut());
        if let Some(model) = spindle {
            model.lag_s = self.time_constant_s;
        }
        if let Some(thermal) = &mut constants.thermal {
            thermal.lag_s = self.time_constant_s;
        }
    }

    fn values(&self) -> Vec<f64> {
        vec![self.time_constant_s]
    }

    fn set(&mut self, values: &[f64]) {
        self.time_constant_s = values[0];
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!(
            "The machine grows later than its thermometer warms, by a time constant of {}.",
            minutes(values[0])
        )
    }

    fn next_test(&self) -> &'static str {
        "Record a start from cold and a stop from warm, each until nothing moves any more."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("time_constant_s", 0, 0.0)]
    }
}

impl Definition for ThermalLag {
    const NAME: &'static str = "thermal-lag";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["time_constant_s"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { time_constant_s: positive(section, "time_constant_s")? })
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let Some(believed_s) = survey.believed_lag_s() else { return };
        // A thermometer that is late and a part that is late are one lateness, early or late.
        if survey.has("thermometer-lag") {
            return;
        }
        let count = if believed_s > 0.0 { FINE_TIME_CONSTANTS } else { TIME_CONSTANTS };
        with(Self::default(), survey.time_constants(count));
    }
}
