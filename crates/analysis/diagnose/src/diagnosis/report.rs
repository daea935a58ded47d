//! The answer in the form that scripts read: `diagnosis.json` (`docs/reference.md`, Diagnosis).

use std::collections::BTreeMap;

use serde::Serialize;
use trueup_numerics::block_resampling::rms;

use super::residuals::max_abs_error;
use crate::fit::EQUIVALENCE_TOLERANCE;

pub use crate::term_gain::TermGain;

/// The whole answer.
#[derive(Clone, Debug, Serialize)]
pub struct DiagnosisReport {
    /// Of this form.
    pub schema: u32,
    /// Rows of all runs.
    pub rows: usize,
    /// Rows that were both measured and predicted, and not excluded as outliers.
    pub rows_used: usize,
    /// The compared quantity.
    pub quantity: String,
    /// The noise of one reading, in µm: what no model could explain.
    pub noise_um: f64,
    /// Correlation time of the noise in s, or in rows where there is no time; 0: none.
    pub noise_memory: f64,
    /// An error of this size that repeats would have been found with 95 %: RMS, in µm; null where there
    /// are too few rows for any.
    pub detectable_um: f64,
    /// The slow drift in the rest, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wandering: Option<SlowDriftReport>,
    /// Errors with the current machine file.
    pub before: ErrorsBeforeExtension,
    /// Errors with the extended one.
    pub after: ErrorsAfterExtension,
    /// The promised error at the tool on days like those of the runs.
    pub at_tool: ErrorAtTool,
    /// The promised error of a reading on such days; none where nothing is corrected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_out: Option<HeldOutErrors>,
    /// The overall result.
    pub verdict: Verdict,
    /// Why, a sentence each.
    pub reasons: Vec<String>,
    /// Notes on the files, and on what of them was excluded before anything was compared, a sentence each.
    pub notes: Vec<String>,
    /// Whether the hold-out has chosen what is handed out: then its figures are no longer those of data
    /// that nothing was chosen by.
    pub holdout_used: bool,
    /// Terms that are not handed out because the hold-out became worse by them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<OmittedCause>,
    /// In the order in which they were added.
    pub findings: Vec<Finding>,
    /// Possible origins of a figure, and how to check them, a sentence each; no result depends on them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub hints: Vec<String>,
    /// The lines that `[inputs]` of the extended machine file lacks for the board to correct by it; a machine file
    /// that does not describe its thermometers lacks all.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missing_inputs: Vec<String>,
    /// Causes that were tried and not taken.
    pub rejected: Vec<RejectedCause>,
}

/// A slow drift of the residual that is correlated with nothing recorded.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SlowDriftReport {
    /// Root mean square of its slow part, in µm.
    pub rms_um: f64,
    /// Its correlation time, in s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory_s: Option<f64>,
    /// The same in rows, of one pass along an axis: the position says there what the clock says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory_rows: Option<f64>,
}

/// A cause whose term is not in the extended machine file.
#[derive(Clone, Debug, Serialize)]
pub struct OmittedCause {
    /// Its name.
    pub cause: String,
    /// Its column.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<String>,
}

/// Errors without the extension, in µm. The arbitrary zero of an axis's measurement is no error of the
/// runs; a hold-out is compared as it stands.
#[derive(Clone, Debug, Serialize)]
pub struct ErrorsBeforeExtension {
    /// Root mean square.
    pub rms_um: f64,
    /// Largest.
    pub max_um: f64,
    /// On the hold-out; on held-out blocks where there is none.
    pub holdout_rms_um: f64,
}

impl ErrorsBeforeExtension {
    pub(super) fn from_residuals(rows: &[f64], holdout_rms_um: f64) -> Self {
        Self { rms_um: rms(rows), max_um: max_abs_error(rows), holdout_rms_um }
    }
}

/// Errors with the extension, in µm.
#[derive(Clone, Debug, Serialize)]
pub struct ErrorsAfterExtension {
    /// Root mean square.
    pub rms_um: f64,
    /// Largest.
    pub max_um: f64,
    /// On the hold-out; on held-out blocks where there is none.
    pub holdout_rms_um: f64,
    /// The same with only the terms that are written for the board.
    pub compensated_holdout_rms_um: f64,
    /// Errors of the board with the extended file on these rows, by its own arithmetic: root mean square. It is what is
    /// promised of a reading on a day like these.
    pub compensated_rms_um: f64,
    /// The largest of it.
    pub compensated_max_um: f64,
}

impl ErrorsAfterExtension {
    /// Returns the figures of the errors by row, of those of the board, and of both on the hold-out.
    pub(super) fn from_residuals(rows: &[f64], on_board: &[f64], holdout_um: [f64; 2]) -> Self {
        let [holdout_rms_um, compensated_holdout_rms_um] = holdout_um;
        Self {
            rms_um: rms(rows),
            max_um: max_abs_error(rows),
            holdout_rms_um,
            compensated_holdout_rms_um,
            compensated_rms_um: rms(on_board),
            compensated_max_um: max_abs_error(on_board),
        }
    }
}

/// The predicted error at the tool, RMS in µm: without the noise of the gauge, which the tool does not
/// have.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ErrorAtTool {
    /// With the current machine file.
    pub before_um: f64,
    /// With the extended one on the board.
    pub after_um: f64,
    /// 1 − after/before; 0 where there is nothing to be corrected.
    pub reduction: f64,
    /// The reduction that 95 % of such days reach ([`HeldOutErrors`]), at most `reduction`.
    pub reduction_floor95: f64,
}

impl ErrorAtTool {
    pub(super) fn new(before_um: f64, after_um: f64) -> Self {
        let reduction = if before_um > 0.0 { 1.0 - after_um / before_um } else { 0.0 };
        Self { before_um, after_um, reduction, reduction_floor95: reduction }
    }

    /// With what held-out parts of the record gave: they know more than the intervals of what was found.
    pub(super) fn apply_held_out_bounds(&mut self, held_out: ErrorReduction) {
        let after_um = held_out.after_um.max(self.after_um);
        let before_um = held_out.before_um.max(after_um);
        *self = Self::new(before_um, after_um);
        self.reduction_floor95 = held_out.reduction_floor95.min(self.reduction);
    }
}

/// Errors that a gauge would read on another day like these, RMS in µm: from parts of the record that took no part in
/// the fit. Present whenever the extended file corrects something.
#[derive(Clone, Debug, Serialize)]
pub struct HeldOutErrors {
    /// About the file's own zero.
    #[serde(flatten)]
    pub figures: ErrorReduction,
    /// With the mean of the first three readings of the day taken off both.
    pub zero_again: ErrorReduction,
    /// The range of each recorded input: the promise is for days within it.
    pub ranges: BTreeMap<String, [f64; 2]>,
}

impl HeldOutErrors {
    /// Returns the promise in words: the floor, what is expected, and both with the zero set again.
    #[must_use]
    pub fn sentence(&self) -> String {
        let ErrorReduction { reduction, reduction_floor95, .. } = self.figures;
        let again = &self.zero_again;
        format!(
            "{}; with the zero set again {}",
            format_expected_reduction(reduction_floor95, reduction),
            format_expected_reduction(again.reduction_floor95, again.reduction)
        )
    }
}

/// Returns whether a floor is one: below 5 % the file predicts no worse than the extended one.
pub(crate) fn is_meaningful_reduction_floor(floor: f64) -> bool {
    floor >= EQUIVALENCE_TOLERANCE
}

/// Returns a promise in words.
pub(crate) fn format_expected_reduction(floor: f64, expected: f64) -> String {
    if !is_meaningful_reduction_floor(floor) {
        format!(
            "{:.0} % less expected, and no floor: the parts of the record differ too much",
            100.0 * expected
        )
    } else {
        format!("at least {:.0} % less, {:.0} % expected", 100.0 * floor, 100.0 * expected)
    }
}

/// Errors before and after, and what is gained.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct ErrorReduction {
    /// With the current machine file.
    pub before_um: f64,
    /// With the extended one on the board.
    pub after_um: f64,
    /// 1 − after/before.
    pub reduction: f64,
    /// The reduction that 95 % of such days reach; negative where they may become worse, −1 where nothing is known.
    pub reduction_floor95: f64,
}

/// The overall result of a diagnosis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Nothing but noise.
    Clean,
    /// No test of structure fires on what is left.
    Explained,
    /// There is more, or two causes cannot be distinguished.
    PartlyExplained,
    /// Structure, but no cause fits.
    Unexplained,
    /// The machine does not repeat.
    DoNotCompensate,
    /// The model that explains the runs makes the hold-out worse.
    DoesNotTransfer,
    /// A hold-out gains less than the floor of what was promised.
    FallsShort,
    /// No error of a size that matters could have been distinguished from noise.
    TooLittleData,
}

impl Verdict {
    /// Its name in the report.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Explained => "explained",
            Self::PartlyExplained => "partly-explained",
            Self::Unexplained => "unexplained",
            Self::DoNotCompensate => "do-not-compensate",
            Self::DoesNotTransfer => "does-not-transfer",
            Self::FallsShort => "falls-short",
            Self::TooLittleData => "too-little-data",
        }
    }

    /// Returns whether all that was found is noise or explained.
    #[must_use]
    pub fn is_resolved(self) -> bool {
        matches!(self, Self::Clean | Self::Explained)
    }
}

/// A range of a column.
#[derive(Clone, Debug, Serialize)]
pub struct ColumnRange {
    /// The column.
    pub column: String,
    /// Above this value, in the column's unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub above: Option<f64>,
    /// Or below this one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub below: Option<f64>,
    /// 95 % interval of the bound: values of the record beyond which another bound fits worse.
    pub ci95: [f64; 2],
}

/// One cause.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// Its name.
    pub cause: String,
    /// The column that it depends on, where there is a choice.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<String>,
    /// Of a `dependence`: `level`, `line`, `hinge` or `curve`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub form: Option<&'static str>,
    /// Of a `dependence`: what it is multiplied by.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub times: Option<String>,
    /// Of a `dependence` on the difference or the product of two columns: both.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub columns: Option<[String; 2]>,
    /// The range in which alone it acts.
    #[serde(rename = "where", skip_serializing_if = "Option::is_none")]
    pub within: Option<ColumnRange>,
    /// Whether the data distinguish it from all other causes.
    pub claimed: bool,
    /// Whether the board corrects it.
    pub compensated: bool,
    /// Of the cause against the best rival, 0…1.
    pub confidence: f64,
    /// By name, with units in the names.
    pub parameters: serde_json::Map<String, serde_json::Value>,
    /// Errors without it and with it, and their reduction.
    pub gain: TermGain,
    /// The cause in a sentence.
    pub sentence: String,
    /// A sentence each.
    pub evidence: Vec<String>,
    /// Causes that are only certain together with it: one finding of two terms.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub together_with: Vec<CoupledCause>,
    /// Alternatives that were tried in its place.
    pub rivals: Vec<AlternativeCause>,
    /// The measurement that would settle what is still open.
    pub next_test: String,
}

/// The second of two causes that are only certain together.
#[derive(Clone, Debug, Serialize)]
pub struct CoupledCause {
    /// Its name.
    pub cause: String,
    /// The column that it depends on, where there is a choice.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<String>,
    /// By name, with units in the names.
    pub parameters: serde_json::Map<String, serde_json::Value>,
    /// The cause in a sentence.
    pub sentence: String,
}

/// Another cause in a finding's place.
#[derive(Clone, Debug, Serialize)]
pub struct AlternativeCause {
    /// Its name.
    pub cause: String,
    /// Its column.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<String>,
    /// Of a `dependence`: `level`, `line`, `hinge` or `curve`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub form: Option<&'static str>,
    /// How much worse its score is (a difference of BIC).
    pub score_gap: f64,
}

/// A cause that was tried and not taken.
#[derive(Clone, Debug, Serialize)]
pub struct RejectedCause {
    /// Its name.
    pub cause: String,
    /// Its column.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<String>,
    /// Why.
    pub reason: String,
    /// The error that would be left with it: RMS, in µm.
    pub rms_um: f64,
    /// The error that would be left on held-out blocks: RMS, in µm, where that was worked out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left_out_um: Option<f64>,
}
