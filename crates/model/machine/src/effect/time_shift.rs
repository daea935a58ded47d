//! `time-shift`: two clocks differ.
//!
//! ```text
//! p(t − shift), after all else; linear between rows, before the first its value
//! ```
//!
//! A measurement can come late for many reasons: a filter, a slow gauge. It cannot come early but
//! by another clock: a shift below 0 is looked for only where the run has the gauge's own clock next to
//! `time_s`, `gauge_time_s`.

use super::{
    cause_spec::{
        CauseSpec, Definition, Entry, Input, Nonlinear, Parameter, Stage, Target, Value, number,
    },
    data_view::{DataView, StartValues},
};
use crate::{file::read::Section, location::BadInput};

/// A shift in time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TimeShift {
    /// Positive: the measurement comes later than the prediction; in s.
    pub shift_s: f64,
}

impl CauseSpec for TimeShift {
    fn entries(&self) -> Vec<Entry> {
        vec![("shift_s", Value::Number(self.shift_s))]
    }

    fn home(&self) -> Target {
        Target::Any
    }

    fn stage(&self) -> Stage {
        Stage::Shift
    }

    fn tier(&self) -> u8 {
        2
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        vec![Input::Time]
    }

    fn is_compensated(&self) -> bool {
        false
    }

    fn nonlinear(&self) -> &'static [Nonlinear] {
        &[Nonlinear::Shift]
    }

    fn amplitudes(&self) -> usize {
        0
    }

    fn shift_s(&self) -> f64 {
        self.shift_s
    }

    fn values(&self) -> Vec<f64> {
        vec![self.shift_s]
    }

    fn set(&mut self, values: &[f64]) {
        self.shift_s = values[0];
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!(
            "The measurement and the model's inputs are {:.1} s apart: two clocks differ.",
            values[0]
        )
    }

    fn next_test(&self) -> &'static str {
        "Write the gauge's own clock into the run (gauge_time_s, beside time_s), and compare the two \
         clocks at the start and the end."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("shift_s", 0, 0.0)]
    }
}

impl Definition for TimeShift {
    const NAME: &'static str = "time-shift";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["shift_s"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { shift_s: number(section, "shift_s")? })
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if survey.predicted_spread() > 0.0 {
            with(Self::default(), survey.shifts());
        }
    }
}
