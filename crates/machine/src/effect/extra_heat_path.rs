//! `extra-heat-path`: heat that the model does not know.
//!
//! ```text
//! p + c·(lag_τ(T) − T_ref)          T a column that the model does not use, τ may be 0
//! ```

use super::{
    heat,
    page::{
        Definition, Entry, Heat, HeatPath, Home, Input, Nonlinear, OnBoard, Page,
        Parameter, minutes, number,
    },
    survey::{Settings, Survey, TIME_CONSTANTS},
};
use crate::{
    file::axis::LinearAxis,
    location::BadInput,
    file::read::Section,
};

/// Heat by a path of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtraHeatPath(pub Heat);

impl ExtraHeatPath {
    fn has_lag(&self) -> bool {
        self.0.time_constant_s != 0.0
    }
}

impl Page for ExtraHeatPath {
    fn entries(&self) -> Vec<Entry> {
        heat::entries(&self.0)
    }

    fn home(&self) -> Home {
        Home::Heat
    }

    fn tier(&self) -> u8 {
        1
    }

    fn inputs(&self, nonlinear: &[f64]) -> Vec<Input<'_>> {
        heat::inputs(&self.0, nonlinear.first().copied().unwrap_or(0.0))
    }

    fn nonlinear(&self) -> &'static [Nonlinear] {
        if self.has_lag() { &[Nonlinear::TimeConstant] } else { &[] }
    }

    fn values(&self) -> Vec<f64> {
        let lag_s = self.has_lag().then_some(self.0.time_constant_s);
        lag_s.into_iter().chain([self.0.um_per_c]).collect()
    }

    fn set(&mut self, values: &[f64]) {
        if let [time_constant_s, _] = *values {
            self.0.time_constant_s = time_constant_s;
        }
        self.0.um_per_c = values[values.len() - 1];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        vec![OnBoard::Heat(self.0.clone())]
    }

    fn has_reference(&self) -> bool {
        true
    }

    fn heat_mut(&mut self) -> Option<&mut Heat> {
        Some(&mut self.0)
    }

    fn heat_path(&self) -> Option<HeatPath<'_>> {
        let (column, has_lag) = (self.0.column.as_str(), self.has_lag());
        Some(HeatPath { column, is_second: false, has_lag })
    }

    fn sentence(&self, values: &[f64]) -> String {
        let (um_per_c, column) = (values[values.len() - 1], &self.0.column);
        let behind = if self.has_lag() {
            format!(", behind a time constant of {}", minutes(values[0]))
        } else {
            String::new()
        };
        format!(
            "Heat that the model does not know moves the tool: {um_per_c:+.3} µm for each kelvin of \
             {column}{behind}."
        )
    }

    fn next_test(&self) -> &'static str {
        "Record a run at least three times as long as the slow time constant, with a cool-down, on \
         another day: it must be predicted without a new fit."
    }

    fn parameters(&self, values: &[f64]) -> Vec<Parameter> {
        let um_per_c = Parameter::Fitted("um_per_c", values.len() - 1, 0.0);
        let time_constant = if self.has_lag() {
            Parameter::Fitted("time_constant_s", 0, 0.0)
        } else {
            Parameter::Fixed("time_constant_s", 0.0)
        };
        vec![um_per_c, time_constant]
    }
}

impl Definition for ExtraHeatPath {
    const NAME: &'static str = "extra-heat-path";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["column", "um_per_c", "time_constant_s", "reference_c"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self(Heat {
            column: heat::column(section)?,
            um_per_c: number(section, "um_per_c")?,
            time_constant_s: section.not_negative("time_constant_s")?.unwrap_or(0.0),
            reference_c: number(section, "reference_c")?,
        }))
    }

    fn law(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, x[0] - self.0.reference_c);
    }

    fn from_board(_: Option<LinearAxis>, form: &OnBoard, _: &mut f64) -> Option<Self> {
        match form {
            OnBoard::Heat(heat) => Some(Self(heat.clone())),
            _ => None,
        }
    }

    fn propose(survey: &dyn Survey, with: &mut dyn FnMut(Self, Settings)) {
        for (column, _) in heat::columns(survey).into_iter().filter(|(_, is_in_use)| !is_in_use) {
            with(Self(heat::neutral(survey, column, false)), Settings::none());
            let time_constants = survey.time_constants(TIME_CONSTANTS);
            with(Self(heat::neutral(survey, column, true)), time_constants);
        }
    }

    fn against(rival: &str) -> Option<&'static str> {
        (rival == Self::NAME).then_some("Warm the two places one after the other, not together.")
    }
}
