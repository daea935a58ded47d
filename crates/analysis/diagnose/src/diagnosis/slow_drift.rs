//! A slow drift of the residual that is correlated with nothing recorded.

use std::fmt;

use trueup_numerics::noise;

use trueup_page::format_micrometres;

use super::report;
use crate::{
    data::DataTable,
    fit::FitProblem,
    parameter_estimates::mean_row_interval_s,
    search::{SearchOutcome, model_comparison::MAJORITY_FRACTION},
};

/// Slow wandering.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SlowDrift {
    /// RMS of its slow part, in µm.
    pub rms_um: f64,
    /// Its correlation time.
    pub memory: CorrelationTime,
    /// Inputs that were not recorded and may be behind it.
    to_record: Vec<&'static str>,
}

impl SlowDrift {
    /// Returns it as it is reported.
    pub(super) fn to_report(&self) -> report::SlowDriftReport {
        let (memory_s, memory_rows) = (self.memory.seconds(), self.memory.rows());
        report::SlowDriftReport { rms_um: self.rms_um, memory_s, memory_rows }
    }
}

/// How long what wanders remembers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum CorrelationTime {
    /// In s.
    Seconds(f64),
    /// In rows, where there is no clock.
    Rows(f64),
}

impl CorrelationTime {
    /// Returns it in s, where there is a clock.
    pub(super) fn seconds(self) -> Option<f64> {
        match self {
            Self::Seconds(seconds) => Some(seconds),
            Self::Rows(_) => None,
        }
    }

    /// Returns it in rows, where there is no clock.
    pub(super) fn rows(self) -> Option<f64> {
        match self {
            Self::Seconds(_) => None,
            Self::Rows(rows) => Some(rows),
        }
    }
}

impl SlowDrift {
    /// Of what `found` leaves, where nothing of it is correlated with what was recorded.
    pub(super) fn detect(problem: &FitProblem, found: &SearchOutcome) -> Option<Self> {
        if !found.lack_of_fit.is_empty() || !has_slow_drift(problem, found) {
            return None;
        }
        let data = &problem.data;
        let has_clock = data.time_s().is_some();
        let rows = found.noise.memory * problem.groups.size as f64;
        Some(Self {
            rms_um: (1.0 - found.noise.white).sqrt() * found.fitted.rms(),
            memory: match has_clock {
                true => CorrelationTime::Seconds(rows * mean_row_interval_s(problem)),
                false => CorrelationTime::Rows(rows),
            },
            to_record: find_unrecorded_inputs(data),
        })
    }
}

/// Returns whether what `found` leaves wanders: its memory leaves less than half of the rows independent, so that
/// neighbours say more about a row than its own reading does.
pub(super) fn has_slow_drift(problem: &FitProblem, found: &SearchOutcome) -> bool {
    let independent = noise::effective_sample_size(found.noise, &problem.groups.steps);
    independent <= MAJORITY_FRACTION * problem.groups.len() as f64
}

/// Returns what moves machines slowly and is no column of these runs.
fn find_unrecorded_inputs(data: &DataTable) -> Vec<&'static str> {
    let all = data.temperatures().iter().chain(data.unknown_columns());
    let names: Vec<String> = all.map(|(name, _)| name.to_lowercase()).collect();
    let has =
        |words: &[&str]| names.iter().any(|name| words.iter().any(|word| name.contains(word)));
    let mut missing = Vec::new();
    let mut lacks = |is_there: bool, what: &'static str| {
        if !is_there {
            missing.push(what);
        }
    };
    lacks(has(&["air", "room", "ambient", "hall"]), "the air's temperature");
    lacks(has(&["coolant", "cool", "water", "oil"]), "the coolant's temperature");
    lacks(has(&["door", "open"]), "whether a door or a gate is open");
    lacks(has(&["bed", "frame", "column", "table"]), "the temperature of the bed or frame");
    lacks(data.spindle_rpm().is_some(), "the spindle's speed");
    missing
}

impl fmt::Display for SlowDrift {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "what is left wanders slowly: {} RMS with a memory of ",
            format_micrometres(self.rms_um)
        )?;
        match self.memory {
            CorrelationTime::Seconds(seconds) if seconds < 120.0 => write!(f, "{seconds:.0} s")?,
            CorrelationTime::Seconds(seconds) => write!(f, "{:.0} minutes", seconds / 60.0)?,
            CorrelationTime::Rows(rows) if rows < 1.5 => f.write_str("one row")?,
            CorrelationTime::Rows(rows) => write!(f, "{rows:.0} rows")?,
        }
        f.write_str("; no recorded input explains it")?;
        if !self.to_record.is_empty() {
            write!(f, ". Record as well: {}", self.to_record.join(", "))?;
        }
        Ok(())
    }
}
