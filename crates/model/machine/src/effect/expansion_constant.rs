//! `expansion-constant`: all of the axis shifts with its temperature by more or less than believed.
//!
//! ```text
//! c·(T − T_ref) with the correct c          mode "constant" or "both"
//! ```

use super::{
    cause_spec::{
        CauseSpec, Constants, Definition, Entry, Host, Parameter, Stage, Target, Value, number,
    },
    data_view::{DataView, StartValues},
};
use crate::{file::read::Section, location::BadInput};

/// Another constant.
#[derive(Clone, Debug, PartialEq)]
pub struct ExpansionConstant {
    /// c in place of the believed one, in µm/K; any sign: positive where the warm axis goes too far.
    pub um_per_c: f64,
}

impl CauseSpec for ExpansionConstant {
    fn entries(&self) -> Vec<Entry> {
        vec![("um_per_c", Value::Number(self.um_per_c))]
    }

    fn home(&self) -> Target {
        Target::Axis
    }

    fn stage(&self) -> Stage {
        Stage::Constant
    }

    // A table has no constant to correct, and the mode "position" does not use it.
    fn refusal(&self, host: &Host<'_>) -> Option<String> {
        let is_used = host.thermal.is_none_or(|thermal| thermal.mode.has_constant());
        host.refuses_thermal_constant().or_else(|| {
            (!is_used).then(|| "corrects a constant that the mode \"position\" does not use".into())
        })
    }

    fn correct(&self, constants: &mut Constants<'_>) {
        if let Some(thermal) = &mut constants.thermal {
            thermal.constant_um_per_c = self.um_per_c;
        }
    }

    /// Returns what is added to the constant, which is in its own.
    fn values(&self) -> Vec<f64> {
        vec![0.0]
    }

    fn set(&mut self, values: &[f64]) {
        self.um_per_c += values[0];
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!(
            "All of the axis shifts with its temperature, wherever it stands: by {:+.3} µm/K more than \
             believed.",
            values[0]
        )
    }

    fn next_test(&self) -> &'static str {
        "Measure one place of the axis over a warm-up of at least 5 K, until nothing moves any more, and \
         over the cool-down after it."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("um_per_c", 0, self.um_per_c)]
    }
}

impl Definition for ExpansionConstant {
    const NAME: &'static str = "expansion-constant";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["um_per_c"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { um_per_c: number(section, "um_per_c")? })
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let Some(thermal) = survey.thermal_in_use() else { return };
        if thermal.mode.has_constant() && thermal.table.is_none() {
            with(Self { um_per_c: thermal.constant_um_per_c }, StartValues::none());
        }
    }

    fn against(rival: &str) -> Option<&'static str> {
        (rival == "expansion-slope").then_some(
            "Measure the axis at both ends, cold and warm: a constant moves both ends alike, a slope \
             moves them apart.",
        )
    }
}
