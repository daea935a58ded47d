//! `reference-temperature`: the axis is right at another temperature.
//!
//! ```text
//! c·(T − T_ref − shift)·(P − P₀)/1000
//! ```

use super::{
    cause_spec::{
        CauseSpec, Constants, Definition, Entry, Host, Parameter, Stage, Target, Value, number,
    },
    data_view::{DataView, StartValues},
};
use crate::{file::read::Section, location::BadInput};

/// Another reference.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReferenceTemperature {
    /// Added to the believed T_ref, in K.
    pub shift_c: f64,
}

impl CauseSpec for ReferenceTemperature {
    fn entries(&self) -> Vec<Entry> {
        vec![("shift_c", Value::Number(self.shift_c))]
    }

    fn home(&self) -> Target {
        Target::Axis
    }

    fn stage(&self) -> Stage {
        Stage::Constant
    }

    fn refusal(&self, host: &Host<'_>) -> Option<String> {
        host.thermal.is_none().then(|| "needs [axis.*.thermal] of the quantity's axis".into())
    }

    fn correct(&self, constants: &mut Constants<'_>) {
        if let Some(thermal) = &mut constants.thermal {
            thermal.shift_reference(self.shift_c);
        }
    }

    fn values(&self) -> Vec<f64> {
        vec![self.shift_c]
    }

    fn set(&mut self, values: &[f64]) {
        self.shift_c = values[0];
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!(
            "The axis is right at another temperature, {:+.2} K from the believed one.",
            values[0]
        )
    }

    fn next_test(&self) -> &'static str {
        "Look where the reference temperature comes from: the gauge's own (20 °C by ISO 1), the scale's, the one at which the \
         axis was last set. While the expansion is linear no measurement of the axis distinguishes a wrong one from a wrong \
         scale: both are the same error for each metre at every temperature, and either correction removes it."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("shift_c", 0, 0.0)]
    }
}

impl Definition for ReferenceTemperature {
    const NAME: &'static str = "reference-temperature";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["shift_c"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { shift_c: number(section, "shift_c")? })
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let Some(thermal) = survey.thermal_in_use().filter(|_| survey.moves()) else { return };
        if thermal.mode.has_position() {
            with(Self::default(), StartValues::none());
        }
    }
}
