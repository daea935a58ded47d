//! `drift`: it wanders with time.
//!
//! ```text
//! p + c·t/3600
//! ```

use super::{
    page::{
        Definition, Entry, Home, Input, OnBoard, Page,
        Parameter, Value, number,
    },
    survey::{Settings, Survey},
};
use crate::{
    location::BadInput,
    file::read::Section,
};

/// A slope of the time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drift {
    /// c, in µm/h.
    pub um_per_h: f64,
}

impl Page for Drift {
    fn entries(&self) -> Vec<Entry> {
        vec![("um_per_h", Value::Number(self.um_per_h))]
    }

    fn home(&self) -> Home {
        Home::Any
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

    fn values(&self) -> Vec<f64> {
        vec![self.um_per_h]
    }

    fn set(&mut self, values: &[f64]) {
        self.um_per_h = values[0];
    }

    fn on_board(&self) -> Vec<OnBoard> {
        Vec::new()
    }

    fn sentence(&self, values: &[f64]) -> String {
        format!("It wanders by {:+.3} µm an hour.", values[0])
    }

    fn next_test(&self) -> &'static str {
        "Repeat the run on another day: a drift that repeats has a cause."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        vec![Parameter::Fitted("um_per_h", 0, 0.0)]
    }
}

impl Definition for Drift {
    const NAME: &'static str = "drift";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &["um_per_h"]
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Ok(Self { um_per_h: number(section, "um_per_h")? })
    }

    fn law(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(0, x[0] / 3600.0);
    }

    fn propose(survey: &dyn Survey, with: &mut dyn FnMut(Self, Settings)) {
        if survey.time_s().is_some() {
            with(Self::default(), Settings::none());
        }
    }

    fn against(_: &str) -> Option<&'static str> {
        Some(
            "Repeat the run on another day and in another order: a drift follows the clock, a cause \
             follows its input.",
        )
    }
}
