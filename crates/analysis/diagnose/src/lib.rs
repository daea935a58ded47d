//! The error of the simulation, its cause, the model extended by it, and the gain.
//!
//! [`diagnose()`] compares a machine file with measured runs. The residual is searched for physical causes, each a term
//! with parameters; a term is added if it explains more than noise with a memory would let any term explain, if it
//! predicts blocks that were held out, and as long as something is left. The form of the answer is fixed
//! (`docs/reference.md`, Diagnosis).
//!
//! # The flow
//! [`diagnose()`] calls each stage in turn, and each stage only what stands below it:
//!
//! ```text
//! [RunFile], Machine ─► Data         the runs as one table, with what the machine file predicts
//!          Data ─► Problem           its rows in groups, and the bounds of what may be fitted
//!       Problem ─► Found             the search: a Model, fitted, its terms in order
//!                   ├ Candidate      a cause that the data allow
//!                   ├ Hit            a candidate that explains more than noise would let it (scan)
//!                   ├ Extension      the model with a hit in it, fitted (extend)
//!                   ├ Choice         which extension is taken, or why none (choose)
//!                   └ LackOfFit      what is left and has no cause
//!         Found ─► [Judgement]       each term's values, its rivals, and why its name is doubted
//!    Judgements ─► Diagnosis         findings in sentences, the gain on unseen data, the verdict
//! ```
//!
//! | module | does |
//! |---|---|
//! | `diagnose` | the flow above |
//! | `data` | the runs as one table, with what the model says |
//! | `kind` | a cause by its page, or a curve |
//! | `model`, `columns`, `laws` | all terms in columns, fast |
//! | `fit` | all values at once by least squares, intervals under correlated noise |
//! | `blocks`, `gain` | held-out files, runs and stretches; what a term brings on them |
//! | `candidates`, `waves` | which causes the data allow, and where the search for each begins |
//! | `search` | term by term, rivals, exchange |
//! | `outliers`, `repeats` | gross errors; what does not come back |
//! | `judgement` | whether a term's name is claimed, and why not |
//! | `answer`, `parameters`, `terms` | the answer, for scripts and for people |
//! | `next` | the shortest run that distinguishes open causes |
//! | `named` | causes of other machines, fitted to the runs of this one |
#![forbid(unsafe_code)]

mod candidates;
mod columns;
mod data;
mod diagnose;
mod diagnosis;
mod extension_terms;
mod fit;
mod folds;
mod judgement;
mod machine_laws;
mod model;
mod named_causes;
mod next_run;
mod outliers;
mod parameter_estimates;
mod periodogram;
mod predict;
mod repeats;
mod search;
mod term_gain;
mod term_kind;

use std::{
    io::{self, Write},
    path::Path,
};

pub use diagnose::{DiagnosisOptions, ProgressCallback, diagnose, diagnose_with_options};
pub use diagnosis::{
    Diagnosis,
    report::{self, DiagnosisReport, ErrorAtTool, Verdict},
};
pub use named_causes::{NamedCause, NamedCauseFit, NamedCauseFits, fit_named_causes};
pub use next_run::{
    AxisRun, ExpectedSeparation, NextRun, NoNextRunReason, ReadingMethod, SpindleSegment,
};
use trueup_machine::{
    InputFileError, Machine, RunFile,
    tool_column::{TOOL_COLUMN, label_code},
};
pub use trueup_page::Provenance;

/// The instruction for [`DiagnosisReport::missing_inputs`].
pub const MISSING_INPUTS_INSTRUCTION: &str = "the board reads a thermometer, and receives a \
    condition, only where [inputs] states its channel or bit. Add these lines there, with your \
    channel, kind or bit";

impl Diagnosis {
    /// Calls a tool by its label where it has no number.
    fn apply_tool_labels(&mut self, machine: &Machine) {
        let tools = machine.spindle.tools.iter().flat_map(|tools| &tools.tools);
        for label in tools.filter_map(|tool| tool.label.as_deref()) {
            let code = format!("{TOOL_COLUMN} = {}", label_code(label));
            let named = format!("{TOOL_COLUMN} = {label}");
            for finding in &mut self.report.findings {
                let texts = finding.evidence.iter_mut().chain([&mut finding.sentence]);
                texts.for_each(|text| *text = text.replace(&code, &named));
            }
        }
    }

    /// `diagnosis.json`.
    ///
    /// # Errors
    /// None that is known: all of it can be written as JSON.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(&self.report)
    }

    /// Returns `report.html`, of a machine of this name, made of what `origin` says. `next` are the lines to be typed
    /// next.
    #[must_use]
    pub fn render_html(&self, machine_name: &str, origin: &Provenance, next: &[String]) -> String {
        diagnosis::html_report::render_html(self, machine_name, origin, next)
    }

    /// Returns what an error is of, its RMS before and after in µm: with the current machine file, and with
    /// extended.toml on the board.
    #[must_use]
    pub fn rms_errors_before_and_after(&self) -> [(&'static str, f64, f64); 3] {
        let report = &self.report;
        let (before, after) = (&report.before, &report.after);
        let not_fitted = match report.holdout_used {
            true => "on the hold-out, which has chosen",
            false => "on rows not used for the fit",
        };
        [
            ("on these rows", before.rms_um, after.compensated_rms_um),
            (not_fitted, before.holdout_rms_um, after.compensated_holdout_rms_um),
            (
                "at the tool, promised for days like these",
                report.at_tool.before_um,
                report.at_tool.after_um,
            ),
        ]
    }

    /// Returns the verdict in a sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        diagnosis::html_report::verdict_sentence(self)
    }

    /// Returns what is promised of the error at the tool on another day, from its inputs: what it measures is not
    /// looked at, but where it measures is.
    ///
    /// # Errors
    /// A column is missing that the model or a term needs.
    pub fn predict_error_at_tool(&self, day: &RunFile) -> Result<ErrorAtTool, InputFileError> {
        self.promise.predict_error(&self.data, std::slice::from_ref(day))
    }

    /// Returns the shortest run, of the spindle or of the axis, that distinguishes the open causes.
    ///
    /// # Errors
    /// Nothing is open, or no run that was thought of answers it: why.
    pub fn next_run(&self, gauge: ReadingMethod) -> Result<NextRun, NoNextRunReason> {
        next_run::find_next_run(&self.questions, &self.data, &self.runs, gauge)
    }

    /// Returns what a further run has measured for the first open cause against its rival: the difference of −2·ln of
    /// their likelihoods, above 0 for the cause that was named; none where nothing is open.
    ///
    /// # Errors
    /// A column is missing that the model needs.
    pub fn likelihood_ratio_statistic(&self, run: &RunFile) -> Result<Option<f64>, InputFileError> {
        next_run::likelihood_ratio_statistic(&self.questions, &self.data, run)
    }

    /// Returns whether a board corrects anything by the extended machine file: not what only explains.
    #[must_use]
    pub fn has_corrections(&self) -> bool {
        self.terms.iter().any(|term| term.effect.is_compensable()) || !self.corrected.is_empty()
    }

    /// `extended.toml`: the machine file `source` (at `path`, for errors) with the terms.
    ///
    /// # Errors
    /// `source` is no machine file.
    pub fn render_extended_toml(
        &self,
        source: &str,
        path: &Path,
    ) -> Result<String, InputFileError> {
        diagnosis::extended_machine_file::render_extended_toml(
            source,
            path,
            &self.corrected,
            &self.terms,
        )
    }

    /// `residuals.csv`: each row with what was predicted and what is left.
    ///
    /// # Errors
    /// `out` cannot be written.
    pub fn write_residuals(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(
            out,
            "file,row,time_s,measured_um,predicted_before_um,predicted_after_um,\
             residual_before_um,residual_after_um,set_aside"
        )?;
        let data = &self.data;
        let (mut file, mut first) = (0, 0);
        for row in 0..data.rows {
            if data.places.file[row] != file {
                (file, first) = (data.places.file[row], row);
            }
            write!(out, "{},{},", file + 1, row - first + 1)?;
            let time_s = data.time_s().map_or(f64::NAN, |times| times[row]);
            let (measured, before, after) = (data.measured[row], self.before[row], self.after[row]);
            let cells = [time_s, measured, before, after, measured - before, measured - after];
            for value in cells {
                if value.is_finite() {
                    write!(out, "{value:.6},")?;
                } else {
                    out.write_all(b",")?;
                }
            }
            writeln!(out, "{}", u8::from(self.aside[row]))?;
        }
        Ok(())
    }
}
