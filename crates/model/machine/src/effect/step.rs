//! `step`: something has slipped, once.
//!
//! ```text
//! p + s from a time on
//! ```

use super::{
    cause_spec::{
        BoardRepresentation, Candidate, Explanation, FileRepresentation, FindingParameter, FitSpec,
        LawInput, NonlinearParameter, PhysicalLaw, Target, TermEntry,
    },
    data_view::{DataView, StartValues},
};
use crate::{
    keys::{
        reader::Section,
        table::{Table, entries, table},
        term::{AT_S, SIZE_UM},
    },
    location::InputFileError,
};

table! {
    /// A jump.
    #[derive(Clone, Debug, Default, PartialEq)]
    pub struct Step {
        /// The time, in the run's `time_s`.
        at_s: f64 = AT_S.required();
        /// s, in µm.
        size_um: f64 = SIZE_UM.required();
    }
}

impl FileRepresentation for Step {
    const NAME: &'static str = "step";

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

impl PhysicalLaw for Step {
    fn target(&self) -> Target {
        Target::Any
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        vec![LawInput::Time]
    }

    fn add_unit_effects(&self, nonlinear: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(
            0,
            match x[0] {
                missing if missing.is_nan() => f64::NAN,
                time_s if time_s >= nonlinear[0] => 1.0,
                _ => 0.0,
            },
        );
    }
}

impl BoardRepresentation for Step {
    fn is_compensable(&self) -> bool {
        false
    }
}

impl Candidate for Step {
    fn fit_spec(&self) -> FitSpec {
        FitSpec { tier: 2, nonlinear: &[NonlinearParameter::Instant], ..FitSpec::DEFAULT }
    }

    fn values(&self) -> Vec<f64> {
        vec![self.at_s, self.size_um]
    }

    fn set_values(&mut self, values: &[f64]) {
        (self.at_s, self.size_um) = (values[0], values[1]);
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        let Some([start_s, _]) = survey.time_range_s() else { return };
        if survey.file_count() == 1 && !survey.has_cause(Self::NAME) {
            let groups = survey.group_count();
            let every = (groups / 50).max(1);
            let at = (every..groups.saturating_sub(3))
                .step_by(every)
                .map(|group| survey.group_time_s(group))
                .filter(|at_s| *at_s > start_s);
            with(Self::default(), StartValues::from_values(at));
        }
    }
}

impl Explanation for Step {
    fn describe(&self, values: &[f64]) -> String {
        format!("At {:.0} s something slipped by {:+.2} µm, once.", values[0], values[1])
    }

    fn next_test(&self) -> &'static str {
        "Find what happened at that time, and repeat the run."
    }

    fn parameters(&self, _: &[f64]) -> Vec<FindingParameter> {
        vec![FindingParameter::Fitted("size_um", 1, 0.0), FindingParameter::Instant("at_s", 0)]
    }
}
