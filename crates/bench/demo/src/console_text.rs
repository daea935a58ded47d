//! Text on the screen: every sentence comes from the findings.

use std::fmt::Write as _;

use trueup_diagnose::{Diagnosis, report::Finding};

use crate::{
    hidden_fault_demo::{HiddenFaultOutcome, HiddenFaultResult},
    measured_run_demo::MeasuredRunResult,
};

/// A table of more readings is left to the page.
const MAX_TABLE_ROWS: usize = 20;
/// Rivals that are named next to a finding.
const MAX_ALTERNATIVES: usize = 3;

/// Returns a finding's name, with the column that it depends on.
#[must_use]
pub(crate) fn format_finding_name(finding: &Finding) -> String {
    match &finding.column {
        Some(column) => format!("{} ({column})", finding.cause),
        None => finding.cause.clone(),
    }
}

/// Why not its rivals: how much worse each explains the same readings, as a difference of BIC.
#[must_use]
pub(crate) fn format_alternatives(finding: &Finding) -> Option<String> {
    let mut nearest: Vec<_> = finding.rivals.iter().collect();
    nearest.sort_by(|a, b| a.score_gap.total_cmp(&b.score_gap));
    let named = nearest.iter().take(MAX_ALTERNATIVES).map(|rival| {
        let column = rival.column.as_ref().map_or(String::new(), |column| format!(" of {column}"));
        format!("{}{column} ({:+.0})", rival.cause, rival.score_gap)
    });
    let named: Vec<String> = named.collect();
    (!named.is_empty()).then(|| named.join(", "))
}

/// Returns what is wrong, and why not something else: from the findings alone.
#[must_use]
pub(crate) fn format_findings(diagnosis: &Diagnosis) -> String {
    let report = &diagnosis.report;
    let mut text = format!("{}: {}\n", report.verdict.name(), diagnosis.sentence());
    for finding in &report.findings {
        let open = if finding.claimed { "" } else { ", not settled" };
        let _ = writeln!(text, "  {}{open}: {}", format_finding_name(finding), finding.sentence);
        if let Some(rivals) = format_alternatives(finding) {
            let _ = writeln!(text, "    worse in its place (BIC; 6 is clear): {rivals}");
        }
        let _ = writeln!(text, "    next: {}", finding.next_test);
    }
    if !report.verdict.is_resolved() {
        for reason in &report.reasons {
            let _ = writeln!(text, "  open: {reason}");
        }
    }
    for hint in &report.hints {
        let _ = writeln!(text, "  hint: {hint}");
    }
    text
}

impl MeasuredRunResult {
    /// Act one on the screen.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format_findings(&self.diagnosis) + "\n";
        for note in &self.notes {
            let _ = writeln!(text, "{note}");
        }
        text += &self.format_table();
        let gain = 100.0 * (1.0 - self.after.rms_um / self.before.rms_um);
        if self.diagnosis.report.findings.is_empty() {
            text += "\nThe machine file stays as it is: there is nothing to correct.\n";
        } else {
            let _ = writeln!(
                text,
                "\nIn the offsets that a CNC reads, on readings that nothing was fitted to: {:.2} µm RMS \
                 before, {:.2} after, {gain:.0} % less.",
                self.before.rms_um, self.after.rms_um
            );
        }
        text
    }

    fn format_table(&self) -> String {
        let mut text = String::new();
        if self.rows.len() <= MAX_TABLE_ROWS {
            text += "             the machine file as it is    extended from the other readings\n\
                     \x20measured     bridge    error left         bridge    error left\n";
            for row in &self.rows {
                let _ = writeln!(
                    text,
                    "{:6.1} µm   {:7.2} µm   {:+7.2} µm     {:7.2} µm   {:+7.2} µm",
                    row.dial_um,
                    row.bridge_um,
                    row.residual_um(),
                    row.calibrated_um,
                    row.extended_residual_um(),
                );
            }
        } else {
            let _ = writeln!(
                text,
                "{} readings       as it is                     extended",
                self.rows.len()
            );
        }
        for (what, of) in [
            ("RMS    ", [self.before.rms_um, self.after.rms_um]),
            ("largest", [self.before.max_um, self.after.max_um]),
        ] {
            let _ = writeln!(
                text,
                "{what}                  {:8.2} µm                    {:8.2} µm",
                of[0], of[1]
            );
        }
        text
    }
}

impl HiddenFaultResult {
    /// Act two on the screen.
    #[must_use]
    pub fn to_text(&self) -> String {
        let it = &self.outcome;
        let mut text = format!(
            "A hidden fault: seed {} (this repeats it: cargo demo -- --seed {}), a {}; the machine's clock runs \
             {:.0} times as fast as the board's.\n",
            it.seed, it.seed, it.machine, it.faster
        );
        text += &format_findings(&self.diagnosis);
        text.push_str("The envelope opened:\n");
        for fault in &it.faults {
            let is_found = !it.missed.contains(&fault.fault);
            let _ = writeln!(
                text,
                "  {} ({:.1} times the noise), which is {}: {}",
                fault.fault,
                fault.ratio,
                fault.causes.join(" or "),
                if is_found { "found" } else { "NOT FOUND" }
            );
        }
        let _ = writeln!(text, "{}", it.describe_outcome());
        for note in &self.notes {
            let _ = writeln!(text, "{note}");
        }
        text
    }
}

impl HiddenFaultOutcome {
    /// Returns whether it was right, and what it was worth, in sentences.
    #[must_use]
    pub(crate) fn describe_outcome(&self) -> String {
        let right = match (self.all_right, self.wrong.is_empty()) {
            (true, _) => "All that was hidden is named, and nothing else is claimed.".to_string(),
            (false, true) => format!("Not all was found: {} is missing.", self.missed.join(", ")),
            (false, false) => format!("A wrong name was claimed: {}.", self.wrong.join(", ")),
        };
        format!(
            "{right} On another day the error at the tool falls from {:.2} to {:.2} µm RMS, {:.0} % less; \
             the diagnosis had promised {:.0} %.",
            self.tool_rms_before_um,
            self.tool_rms_after_um,
            100.0 * self.reduction,
            100.0 * self.promised_reduction
        )
    }
}
