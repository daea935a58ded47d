//! `drift`: it wanders with time.
//!
//! ```text
//! p + c·t/3600          c·(run − reference) where there is no clock
//! ```
//!
//! The reference is the mean of the runs: what is handed out to a board, which has no runs, is right in the
//! middle of them and not before the first.

use super::{
    cause_spec::{
        BoardRepresentation, Candidate, Explanation, FileRepresentation, FindingParameter, FitSpec,
        LawInput, PhysicalLaw, Target, TermEntry, Value, required_number,
    },
    data_view::{DataView, StartValues, find_distinct_values},
};
use crate::{
    keys::{
        reader::Section,
        term::{REFERENCE_RUN, UM_PER_H, UM_PER_RUN},
    },
    location::InputFileError,
};

/// A slope of the time, or from run to run.
#[derive(Clone, Debug, PartialEq)]
pub enum Drift {
    /// By the clock.
    InTime {
        /// c, in µm/h; any sign.
        um_per_h: f64,
    },
    /// By the number of the run.
    ByRun {
        /// c, in µm from a run to the next; any sign.
        um_per_run: f64,
        /// The run at which it is 0; it need not be a whole number.
        reference_run: f64,
    },
}

/// Runs that show a slope: two differ by something, whatever it is.
const MIN_DRIFT_RUNS: usize = 3;

impl Drift {
    fn rate_entry(&self) -> (&'static str, f64) {
        match *self {
            Self::InTime { um_per_h } => (UM_PER_H.name, um_per_h),
            Self::ByRun { um_per_run, .. } => (UM_PER_RUN.name, um_per_run),
        }
    }
}

impl FileRepresentation for Drift {
    const NAME: &'static str = "drift";

    fn keys(section: &Section<'_>) -> &'static [&'static str] {
        if section.keys().contains(&UM_PER_RUN.name) {
            &[UM_PER_RUN.name, REFERENCE_RUN.name]
        } else {
            &[UM_PER_H.name]
        }
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        Ok(match section.number(UM_PER_RUN.name)? {
            Some(um_per_run) => {
                let reference_run = section.number(REFERENCE_RUN.name)?.unwrap_or(0.0);
                Self::ByRun { um_per_run, reference_run }
            }
            None => Self::InTime { um_per_h: required_number(section, UM_PER_H)? },
        })
    }

    fn entries(&self) -> Vec<TermEntry> {
        let (name, rate) = self.rate_entry();
        let mut entries = vec![(name, Value::Number(rate))];
        if let Self::ByRun { reference_run, .. } = *self
            && reference_run != 0.0
        {
            entries.push((REFERENCE_RUN.name, Value::Number(reference_run)));
        }
        entries
    }
}

impl PhysicalLaw for Drift {
    fn target(&self) -> Target {
        Target::Any
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        vec![match self {
            Self::InTime { .. } => LawInput::Time,
            Self::ByRun { .. } => LawInput::Run,
        }]
    }

    fn add_unit_effects(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        add(
            0,
            match self {
                Self::InTime { .. } => x[0] / 3600.0,
                // A record that is of no run is of the middle one.
                Self::ByRun { .. } if x[0].is_nan() => 0.0,
                Self::ByRun { reference_run, .. } => x[0] - reference_run,
            },
        );
    }
}

impl BoardRepresentation for Drift {
    fn is_compensable(&self) -> bool {
        false
    }
}

impl Candidate for Drift {
    fn fit_spec(&self) -> FitSpec {
        FitSpec { tier: 2, ..FitSpec::DEFAULT }
    }

    fn values(&self) -> Vec<f64> {
        vec![self.rate_entry().1]
    }

    fn set_values(&mut self, values: &[f64]) {
        match self {
            Self::InTime { um_per_h } => *um_per_h = values[0],
            Self::ByRun { um_per_run, .. } => *um_per_run = values[0],
        }
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        if survey.time_range_s().is_some() {
            with(Self::InTime { um_per_h: 0.0 }, StartValues::linear_only());
        } else if let Some(run) = survey
            .column("run")
            .filter(|run| find_distinct_values(run, 1e-3).len() >= MIN_DRIFT_RUNS)
        {
            let known = || run.iter().filter(|run| run.is_finite());
            let reference_run = known().sum::<f64>() / known().count() as f64;
            with(Self::ByRun { um_per_run: 0.0, reference_run }, StartValues::linear_only());
        }
    }
}

impl Explanation for Drift {
    fn describe(&self, values: &[f64]) -> String {
        match self {
            Self::InTime { .. } => format!("It wanders by {:+.3} µm an hour.", values[0]),
            Self::ByRun { .. } => {
                format!("It wanders by {:+.3} µm from each run to the next.", values[0])
            }
        }
    }

    fn next_test(&self) -> &'static str {
        match self {
            Self::InTime { .. } => {
                "Repeat the run on another day: a drift that repeats has a cause."
            }
            Self::ByRun { .. } => {
                "Write the time of each reading into the run (time_s), and the temperature of the \
                 machine: a drift has a cause."
            }
        }
    }

    fn distinguishing_test(_: &str) -> Option<&'static str> {
        Some(
            "Repeat the run on another day and in another order: a drift follows the clock, a cause \
             follows its input.",
        )
    }

    fn parameters(&self, _: &[f64]) -> Vec<FindingParameter> {
        vec![FindingParameter::Fitted(self.rate_entry().0, 0, 0.0)]
    }
}
