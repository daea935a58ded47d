//! `thermometer-lag`: the thermometer is warm later than the part whose growth it foretells.
//!
//! ```text
//! p from the part's temperature, where the column T is that temperature
//!   behind a first-order lag of τ    T + τ·dT/dt, the slope taken over w (the module model::late)
//!   as it was τ ago (form "delay")   T(t + τ)
//! ```
//!
//! Heat that has to pass a wall on its way to the thermometer comes as it was; a body that the part warms
//! follows it by a lag. A slope multiplies the thermometer's noise σ by about √2·τ/w, the more the shorter
//! the time w over which it is taken, and misses what is quicker than w. So several w are tried: the
//! measurement says which leaves least.
//!
//! It is explained and not corrected: both forms look ahead, which a recorded run can and a board cannot.
//! A board's slope, filtered by φ, multiplies the noise by τ/φ: where that is harmless it comes as late as the
//! thermometer does. The remedy is another place for the thermometer.

use super::{
    cause_spec::{
        CauseSpec, Definition, Entry, Host, Input, Late, LateForm, Nonlinear, Parameter, Stage,
        Target, Value, minutes, positive,
    },
    data_view::{DataView, StartValues},
};
use crate::file::keys::term::{FORM, SLOPE_OVER, TIME_CONSTANT_S};
use crate::{file::read::Section, location::BadInput};

/// A thermometer that is late.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermometerLag {
    /// τ in s; above 0.
    pub time_constant_s: f64,
    /// In which way it is late.
    pub form: LateForm,
}

/// The shares of τ that w is tried at: from row to row, which undoes a lag exactly; all of τ, over which the
/// noise counts √3 times; and three tenths, half way by ratio between that and a tenth.
const SLOPES_OVER: [f64; 3] = [0.0, 0.3, 1.0];

impl ThermometerLag {
    fn form_entries(&self) -> Vec<Entry> {
        let form = |name: &str| (FORM.name, Value::Text(name.into()));
        match self.form {
            LateForm::Delay => vec![form("delay")],
            LateForm::Lag { slope_over } => {
                vec![form("lag"), (SLOPE_OVER.name, Value::Number(slope_over))]
            }
        }
    }
}

impl CauseSpec for ThermometerLag {
    fn entries(&self) -> Vec<Entry> {
        let mut entries = vec![(TIME_CONSTANT_S.name, Value::Number(self.time_constant_s))];
        entries.extend(self.form_entries());
        entries
    }

    fn home(&self) -> Target {
        Target::OwnThermometer
    }

    fn stage(&self) -> Stage {
        Stage::Constant
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        vec![Input::Time]
    }

    fn is_compensated(&self) -> bool {
        false
    }

    fn nonlinear(&self) -> &'static [Nonlinear] {
        &[Nonlinear::Late]
    }

    fn amplitudes(&self) -> usize {
        0
    }

    fn refusal(&self, host: &Host<'_>) -> Option<String> {
        (!host.has_thermometer()).then(|| {
            format!(
                "needs a thermometer that {} follows: [spindle] source = \"temperature\", or \
                 [axis.*.thermal]",
                host.quantity.name()
            )
        })
    }

    fn late(&self) -> Option<Late> {
        Some(Late { by_s: self.time_constant_s, form: self.form })
    }

    fn values(&self) -> Vec<f64> {
        vec![self.time_constant_s]
    }

    fn set(&mut self, values: &[f64]) {
        self.time_constant_s = values[0];
    }

    // What is late is so at the first row too, whose reading people take for the part's.
    fn has_reference(&self) -> bool {
        true
    }

    fn sentence(&self, values: &[f64]) -> String {
        let late = minutes(values[0]);
        if self.form == LateForm::Delay {
            return format!("The thermometer shows how warm the part was {late} ago.");
        }
        format!("The thermometer warms later than the part does, by a time constant of {late}.")
    }

    fn next_test(&self) -> &'static str {
        "Put the thermometer where the heat comes in, or a thinner one with better contact, and repeat \
         the run: the growth must no longer begin before the temperature rises."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        let said =
            self.form_entries().into_iter().map(|(name, value)| Parameter::Said(name, value));
        [Parameter::Fitted("time_constant_s", 0, 0.0)].into_iter().chain(said).collect()
    }
}

impl Definition for ThermometerLag {
    const NAME: &'static str = "thermometer-lag";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &[TIME_CONSTANT_S.name, FORM.name, SLOPE_OVER.name]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        let slope_over = section.not_negative(SLOPE_OVER.name)?.unwrap_or(0.0).min(1.0);
        let lag = LateForm::Lag { slope_over };
        let form = section.choice(FORM.name, &[("lag", lag), ("delay", LateForm::Delay)])?;
        let time_constant_s = positive(section, TIME_CONSTANT_S)?;
        Ok(Self { time_constant_s, form: form.unwrap_or(lag) })
    }

    // Next to a lag of the law that is longer, a thermometer that lags is the same as a shorter law.
    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let Some(believed_s) = survey.believed_lag_s() else { return };
        if believed_s == 0.0 && !survey.has(Self::NAME) {
            let lags = SLOPES_OVER.map(|slope_over| LateForm::Lag { slope_over });
            for form in lags.into_iter().chain([LateForm::Delay]) {
                with(Self { time_constant_s: 0.0, form }, survey.lates());
            }
        }
    }
}
