//! `expansion-slope`: the axis expands more or less than believed.
//!
//! ```text
//! c·(T − T_ref)·(P − P₀)/1000 with the correct c
//! ```

use super::{
    cause_spec::{
        CauseSpec, Constants, Definition, Entry, Host, Parameter, Stage, Target, Value, number,
    },
    data_view::{DataView, StartValues},
};
use crate::{file::read::Section, location::BadInput};

/// Another slope.
#[derive(Clone, Debug, PartialEq)]
pub struct ExpansionSlope {
    /// c in place of the believed one, in µm/(m·K).
    pub um_per_m_per_c: f64,
}

impl CauseSpec for ExpansionSlope {
    fn entries(&self) -> Vec<Entry> {
        vec![("um_per_m_per_c", Value::Number(self.um_per_m_per_c))]
    }

    fn home(&self) -> Target {
        Target::Axis
    }

    fn stage(&self) -> Stage {
        Stage::Constant
    }

    // Another reference moves a table along the temperature; another slope has no place in it.
    fn refusal(&self, host: &Host<'_>) -> Option<String> {
        host.refuses_thermal_constant()
    }

    fn correct(&self, constants: &mut Constants<'_>) {
        if let Some(thermal) = &mut constants.thermal {
            thermal.slope_um_per_m_per_c = self.um_per_m_per_c;
        }
    }

    /// Returns what is added to the slope, which is in its own.
    fn values(&self) -> Vec<f64> {
        vec![0.0]
    }

    fn set(&mut self, values: &[f64]) {
        self.um_per_m_per_c += values[0];
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!("The axis expands by {:+.3} µm/(m·K) more than believed.", values[0])
    }

    fn next_test(&self) -> &'static str {
        "Measure the axis at both ends at two temperatures that are at least 5 K apart."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("um_per_m_per_c", 0, self.um_per_m_per_c)]
    }
}

impl Definition for ExpansionSlope {
    const NAME: &'static str = "expansion-slope";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["um_per_m_per_c"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { um_per_m_per_c: number(section, "um_per_m_per_c")? })
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let Some(thermal) = survey.thermal_in_use().filter(|_| survey.moves()) else { return };
        if thermal.mode.has_position() && thermal.table.is_none() {
            with(Self { um_per_m_per_c: thermal.slope_um_per_m_per_c }, StartValues::none());
        }
    }
}
