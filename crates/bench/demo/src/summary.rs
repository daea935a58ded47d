//! `summary.json`: the figures of the demonstration (`docs/reference.md`).

use serde::Serialize;
use trueup_diagnose::report::Finding;

use crate::{
    hidden_fault_demo::HiddenFaultOutcome,
    measured_run_demo::{MeasuredRunResult, ReadingResult, ResidualStatistics},
};

/// The figures.
#[derive(Debug, Serialize)]
pub struct DemoSummary<'a> {
    /// `virtual`: the firmware ran on the emulated board.
    pub board: &'static str,
    /// Frames with offsets that the CNC received.
    pub frames: u32,
    /// Frames that were damaged, repeated, out of order or lost.
    pub e2e_errors: u32,
    /// One for each reading.
    pub rows: &'a [ReadingResult],
    /// Residual of the current machine file.
    pub paper: ResidualStatistics,
    /// Figures of the extended one, on readings that it has not seen.
    pub calibrated: HeldOutFigures,
    /// Counts of full scale in the machine file over those of an S7 input; null without a sensor.
    pub s7_full_scale_ratio: Option<f64>,
    /// Verdict of act one.
    pub verdict: &'static str,
    /// As in `diagnosis.json`.
    pub findings: &'a [Finding],
    /// As in `diagnosis.json`.
    pub hints: &'a [String],
    /// Act two; absent where the user's own data were played alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hidden: Option<&'a HiddenFaultOutcome>,
    /// How long it took, in s.
    pub wall_s: f64,
}

/// Figures of the extended machine file.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct HeldOutFigures {
    /// Measured over sent: µm for 1 µm; null where there is no line.
    pub gain: Option<f64>,
    /// Measured where the bridge says 0, in µm.
    pub offset_um: Option<f64>,
    /// RMS in µm of what is left of held-out readings.
    pub loo_rms_um: f64,
    /// The largest of these, in µm.
    pub loo_max_um: f64,
}

impl<'a> DemoSummary<'a> {
    /// Returns the figures of act one and of act two, played on a board of this name.
    #[must_use]
    pub fn new(
        one: &'a MeasuredRunResult,
        hidden: Option<&'a HiddenFaultOutcome>,
        board: &'static str,
        wall_s: f64,
    ) -> Self {
        let report = &one.diagnosis.report;
        Self {
            board,
            frames: one.frames[0],
            e2e_errors: one.frames[1],
            rows: &one.rows,
            paper: one.before,
            calibrated: HeldOutFigures {
                gain: one.line.map(|[gain, _]| gain),
                offset_um: one.line.map(|[_, offset]| offset),
                loo_rms_um: one.after.rms_um,
                loo_max_um: one.after.max_um,
            },
            s7_full_scale_ratio: one.s7_full_scale_ratio,
            verdict: report.verdict.name(),
            findings: &report.findings,
            hints: &report.hints,
            hidden,
            wall_s,
        }
    }
}
