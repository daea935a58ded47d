//! The acceptance of a compensation (S5–S7 of the warm-up paper): a run recorded without it and one with
//! it are compared; if not enough of the error is gone, it says which constant to change by how much.
//!
//! ```text
//!  off.csv, on.csv ─► pair ─► how much is gone, by part of the run ─► passed or not
//!  off.csv, machine file ─► advice: each constant of the file against what the run without it shows
//! ```
#![forbid(unsafe_code)]

mod html_report;
mod paired_readings;
mod recommended_changes;

use serde::Serialize;
use trueup_machine::{
    InputFileError, Machine, RunFile,
    applied_offsets::{FactorEstimate, OffsetApplication},
    machine_file::Quantity,
};
use trueup_numerics::line::ErrorStatistics;

use paired_readings::{PairedReadings, RunSegment};
pub use recommended_changes::{ConstantChange, Recommendations};
pub use trueup_page::Provenance;

/// Requirements of an acceptance test.
#[derive(Clone, Copy, Debug)]
pub struct AcceptanceCriteria {
    /// This much of the RMS must be gone, in percent, 0…100.
    pub require_percent: f64,
    /// No error may be larger, in µm, above 0.
    pub limit_um: Option<f64>,
}

impl Default for AcceptanceCriteria {
    fn default() -> Self {
        Self { require_percent: 90.0, limit_um: None }
    }
}

/// Size of an error over a run, in µm.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ErrorSummary {
    /// Root mean square.
    pub rms_um: f64,
    /// Largest absolute value.
    pub max_um: f64,
}

impl ErrorSummary {
    fn from_errors(um: &[f64]) -> Self {
        ErrorStatistics::from_residuals(um).map_or(
            Self { rms_um: f64::NAN, max_um: f64::NAN },
            |statistics| Self { rms_um: statistics.rms, max_um: statistics.max_abs },
        )
    }
}

/// The machine's response to 1 µm of offset.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AppliedFactor {
    /// 1 is right, −1 the wrong sign, 0 not engaged.
    pub value: f64,
    /// Its 95 % interval.
    pub ci95: [f64; 2],
}

/// The result of an acceptance test: `acceptance.json`.
#[derive(Clone, Debug, Serialize)]
pub struct AcceptanceResult {
    /// Whether all requirements are met.
    pub passed: bool,
    /// The compared quantity: `elongation`, `dx`, `dy`, `dz`.
    pub quantity: &'static str,
    /// Readings that both runs have.
    pub rows: usize,
    /// Without the compensation.
    pub before: ErrorSummary,
    /// With it.
    pub after: ErrorSummary,
    /// 1 − RMS after over RMS before.
    pub reduction: f64,
    /// The required reduction, in the same terms.
    pub required_reduction: f64,
    /// The machine's response to 1 µm of offset: 1 is right; absent where the runs do not say what the bridge applied,
    /// or not well enough for any figure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub applied_factor: Option<AppliedFactor>,
    /// The largest error that is allowed, in µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit_um: Option<f64>,
    /// Part by part of the run.
    pub parts: Vec<RunSegment>,
    /// Why it has not passed, a sentence each.
    pub unmet: Vec<String>,
    /// Advice on the machine file and the CNC.
    pub advice: Recommendations,
    /// Notes on the runs, a sentence each.
    pub notes: Vec<String>,
    #[serde(skip)]
    pair: PairedReadings,
    #[serde(skip)]
    adjusted: Option<String>,
}

impl AcceptanceResult {
    /// Returns the machine file with the constants that the run without compensation shows; none without advice
    /// that changes a constant.
    #[must_use]
    pub fn adjusted_machine_file(&self) -> Option<&str> {
        self.adjusted.as_deref()
    }

    /// Returns the printable page, of this name, made of what `origin` says. `next` are the lines to be typed next.
    #[must_use]
    pub fn render_html(&self, name: &str, origin: &Provenance, next: &[String]) -> String {
        html_report::render_html(self, name, origin, next)
    }

    /// Returns the error in both runs as a picture that stands alone, SVG.
    #[must_use]
    pub fn render_chart_svg(&self) -> String {
        html_report::build_error_chart(self).to_standalone_svg()
    }
}

/// Compares the run `off`, recorded without compensation, with `on`, recorded with it. `believed`: the
/// machine file that the bridge ran, its text first.
///
/// # Errors
/// The runs do not measure the same, have no time or positions in common, or the machine file cannot be
/// compared with them.
pub fn evaluate_acceptance(
    off: &RunFile,
    on: &RunFile,
    quantity: Option<Quantity>,
    believed: Option<(&str, &Machine)>,
    limits: AcceptanceCriteria,
) -> Result<AcceptanceResult, InputFileError> {
    let mut pair =
        PairedReadings::from_runs(off, on, quantity, believed.map(|(_, machine)| machine))?;
    let (before, after) =
        (ErrorSummary::from_errors(&pair.off_um), ErrorSummary::from_errors(&pair.on_um));
    let reduction = 1.0 - after.rms_um / before.rms_um;
    let required_reduction = limits.require_percent / 100.0;
    let mut unmet = Vec::new();
    // What is not a number is not enough either.
    let is_enough = reduction >= required_reduction;
    if !is_enough {
        unmet.push(format!(
            "{:.1} % of the error is gone, {:.1} % is required.",
            100.0 * reduction,
            limits.require_percent
        ));
    }
    if let Some(limit_um) = limits.limit_um.filter(|limit_um| {
        let is_within = after.max_um <= *limit_um;
        !is_within
    }) {
        unmet.push(format!(
            "The largest error is {:.2} µm, {limit_um} µm are allowed.",
            after.max_um
        ));
    }
    let applied = pair.estimate_offset_application();
    let wrong = match applied {
        OffsetApplication::OtherFactor(factor) => Some(factor),
        _ => None,
    };
    unmet.extend(wrong.as_ref().map(FactorEstimate::describe));
    pair.notes.extend(unknown_offset_factor_note(applied));
    let passed = unmet.is_empty();
    let (advice, adjusted) = match wrong {
        Some(_) => (Recommendations::cnc_troubleshooting(), None),
        None if passed => (Recommendations::no_change(), None),
        None => recommended_changes::recommend_changes(&pair, off, believed)?,
    };
    Ok(AcceptanceResult {
        passed,
        quantity: pair.quantity.name(),
        rows: pair.at.len(),
        before,
        after,
        reduction,
        required_reduction,
        applied_factor: applied
            .factor()
            .map(|FactorEstimate { value, ci95 }| AppliedFactor { value, ci95 }),
        limit_um: limits.limit_um,
        parts: pair.split_into_segments(),
        unmet,
        advice,
        notes: pair.notes.clone(),
        pair,
        adjusted,
    })
}

/// Returns a note where the runs have offsets and do not show how the machine applies them.
fn unknown_offset_factor_note(applied: OffsetApplication) -> Option<String> {
    let OffsetApplication::Unknown(factor) = applied else { return None };
    let interval = factor.map_or(String::new(), |FactorEstimate { ci95: [low, high], .. }| {
        format!(" (95 %: {low:.2} … {high:.2})").replace('-', "−")
    });
    Some(format!(
        "These runs do not show how far the machine moves for 1 µm of offset{interval}. The \
         offset has to change by several times the noise of the gauge, as it does from cold to \
         warm."
    ))
}
