//! `thermometer-lag`: the thermometer is warm later than the part whose growth it predicts.
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
        BoardRepresentation, Candidate, DelayKind, Explanation, FileRepresentation,
        FindingParameter, FitSpec, LawInput, NonlinearParameter, PhysicalLaw, PredictionStage,
        Target, TermContext, TermEntry, ThermometerDelay, Value, format_duration,
        required_positive_number,
    },
    data_view::{DataView, StartValues},
};
use crate::{
    keys::{
        reader::Section,
        term::{FORM, SLOPE_OVER, TIME_CONSTANT_S},
    },
    location::InputFileError,
};

/// A thermometer that is late.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermometerLag {
    /// τ in s; above 0.
    pub time_constant_s: f64,
    /// In which way it is late.
    pub form: DelayKind,
}

/// The shares of τ that w is tried at: from row to row, which undoes a lag exactly; all of τ, over which the
/// noise counts √3 times; and three tenths, half way by ratio between that and a tenth.
const SLOPE_WIDTH_FRACTIONS: [f64; 3] = [0.0, 0.3, 1.0];

impl ThermometerLag {
    fn form_entries(&self) -> Vec<TermEntry> {
        let form = |name: &str| (FORM.name, Value::Text(name.into()));
        match self.form {
            DelayKind::Delay => vec![form("delay")],
            DelayKind::Lag { slope_over } => {
                vec![form("lag"), (SLOPE_OVER.name, Value::Number(slope_over))]
            }
        }
    }
}

impl FileRepresentation for ThermometerLag {
    const NAME: &'static str = "thermometer-lag";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &[TIME_CONSTANT_S.name, FORM.name, SLOPE_OVER.name]
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        let slope_over = section.non_negative_number(SLOPE_OVER.name)?.unwrap_or(0.0).min(1.0);
        let lag = DelayKind::Lag { slope_over };
        let form = section.choice(FORM.name, &[("lag", lag), ("delay", DelayKind::Delay)])?;
        let time_constant_s = required_positive_number(section, TIME_CONSTANT_S)?;
        Ok(Self { time_constant_s, form: form.unwrap_or(lag) })
    }

    fn entries(&self) -> Vec<TermEntry> {
        let mut entries = vec![(TIME_CONSTANT_S.name, Value::Number(self.time_constant_s))];
        entries.extend(self.form_entries());
        entries
    }
}

impl PhysicalLaw for ThermometerLag {
    fn target(&self) -> Target {
        Target::OwnThermometer
    }

    fn refusal(&self, host: &TermContext<'_>) -> Option<String> {
        (!host.has_thermometer()).then(|| {
            format!(
                "needs a thermometer that {} follows: [spindle] source = \"temperature\", or \
                 [axis.*.thermal]",
                host.quantity.name()
            )
        })
    }

    fn stage(&self) -> PredictionStage {
        PredictionStage::Constant
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        vec![LawInput::Time]
    }

    fn thermometer_delay(&self) -> Option<ThermometerDelay> {
        Some(ThermometerDelay { by_s: self.time_constant_s, form: self.form })
    }
}

impl BoardRepresentation for ThermometerLag {
    fn is_compensable(&self) -> bool {
        false
    }
}

impl Candidate for ThermometerLag {
    fn fit_spec(&self) -> FitSpec {
        FitSpec {
            nonlinear: &[NonlinearParameter::ThermometerDelay],
            amplitudes: 0,
            // What is late is so at the first row too, whose reading people take for the part's.
            has_reference: true,
            ..FitSpec::DEFAULT
        }
    }

    fn values(&self) -> Vec<f64> {
        vec![self.time_constant_s]
    }

    fn set_values(&mut self, values: &[f64]) {
        self.time_constant_s = values[0];
    }

    // Next to a lag of the law that is longer, a thermometer that lags is the same as a shorter law.
    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let Some(believed_s) = survey.modelled_lag_s() else { return };
        if believed_s == 0.0 && !survey.has_cause(Self::NAME) {
            let lags = SLOPE_WIDTH_FRACTIONS.map(|slope_over| DelayKind::Lag { slope_over });
            for form in lags.into_iter().chain([DelayKind::Delay]) {
                with(Self { time_constant_s: 0.0, form }, survey.thermometer_lag_start_values());
            }
        }
    }
}

impl Explanation for ThermometerLag {
    fn describe(&self, values: &[f64]) -> String {
        let late = format_duration(values[0]);
        if self.form == DelayKind::Delay {
            return format!("The thermometer shows how warm the part was {late} ago.");
        }
        format!("The thermometer warms later than the part does, by a time constant of {late}.")
    }

    fn next_test(&self) -> &'static str {
        "Put the thermometer where the heat comes in, or a thinner one with better contact, and \
         repeat the run. The growth must no longer begin before the temperature rises."
    }

    fn parameters(&self, _: &[f64]) -> Vec<FindingParameter> {
        let stated = self
            .form_entries()
            .into_iter()
            .map(|(name, value)| FindingParameter::Stated(name, value));
        [FindingParameter::Fitted("time_constant_s", 0, 0.0)].into_iter().chain(stated).collect()
    }
}
