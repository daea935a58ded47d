//! `outliers`: some readings are no readings. The prediction stays; such rows are excluded.

use super::cause_spec::{
    BoardRepresentation, Candidate, Explanation, FileRepresentation, FindingParameter, FitSpec,
    LawInput, PhysicalLaw, Target, TermEntry,
};
use crate::{
    keys::{
        reader::Section,
        table::{Table, entries, table},
        term::FRACTION,
    },
    location::InputFileError,
};

table! {
    /// Rows that were excluded as outliers.
    #[derive(Clone, Debug, Default, PartialEq)]
    pub struct Outliers {
        /// Their share of all rows; at least 0.
        fraction: f64 = FRACTION.required();
    }
}

impl FileRepresentation for Outliers {
    const NAME: &'static str = "outliers";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        Self::NAMES
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        Table::read(section)
    }

    fn entries(&self) -> Vec<TermEntry> {
        entries(self)
    }
}

impl PhysicalLaw for Outliers {
    fn target(&self) -> Target {
        Target::Any
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        Vec::new()
    }
}

impl BoardRepresentation for Outliers {
    fn is_compensable(&self) -> bool {
        false
    }
}

impl Candidate for Outliers {
    fn fit_spec(&self) -> FitSpec {
        FitSpec { tier: 2, amplitudes: 0, ..FitSpec::DEFAULT }
    }

    fn values(&self) -> Vec<f64> {
        Vec::new()
    }

    fn set_values(&mut self, _: &[f64]) {}
}

impl Explanation for Outliers {
    fn describe(&self, _: &[f64]) -> String {
        "Some readings are no readings: they stand alone, far from the rest.".into()
    }

    fn next_test(&self) -> &'static str {
        "Look at what happened at these readings, and measure them again."
    }

    fn parameters(&self, _: &[f64]) -> Vec<FindingParameter> {
        Vec::new()
    }
}
