//! `outliers`: some readings are no readings. The prediction stays; such rows are set aside.

use super::cause_spec::{CauseSpec, Definition, Entry, Input, Parameter, Target};
use crate::file::keys::term::FRACTION;
use crate::file::table::{Table, entries, table};
use crate::{file::read::Section, location::BadInput};

table! {
    /// Rows that were set aside.
    #[derive(Clone, Debug, Default, PartialEq)]
    pub struct Outliers {
        /// Their share of all rows; at least 0.
        fraction: f64 = FRACTION.required();
    }
}

impl CauseSpec for Outliers {
    fn entries(&self) -> Vec<Entry> {
        entries(self)
    }

    fn home(&self) -> Target {
        Target::Any
    }

    fn is_compensated(&self) -> bool {
        false
    }

    fn tier(&self) -> u8 {
        2
    }

    fn inputs(&self, _: &[f64]) -> Vec<Input<'_>> {
        Vec::new()
    }

    fn amplitudes(&self) -> usize {
        0
    }

    fn values(&self) -> Vec<f64> {
        Vec::new()
    }

    fn set(&mut self, _: &[f64]) {}

    fn sentence(&self, _: &[f64]) -> String {
        "Some readings are no readings: they stand alone, far from the rest.".into()
    }

    fn next_test(&self) -> &'static str {
        "Look at what happened at these readings, and measure them again."
    }

    fn parameters(&self, _: &[f64]) -> Vec<Parameter> {
        Vec::new()
    }
}

impl Definition for Outliers {
    const NAME: &'static str = "outliers";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        Self::NAMES
    }

    fn read(section: &Section<'_>) -> Result<Self, BadInput> {
        Table::read(section)
    }
}
