//! What is said on the screen: every sentence comes from the findings.

use std::fmt::Write as _;

use trueup_diagnose::{Diagnosis, report::Finding};

use crate::act_one::ActOne;

/// A table of more readings is left to the page.
const MOST_ROWS: usize = 20;
/// Rivals that are named beside a finding.
const RIVALS: usize = 3;

/// A finding's name, with the column that it hangs on.
#[must_use]
pub fn name(finding: &Finding) -> String {
    match &finding.column {
        Some(column) => format!("{} ({column})", finding.cause),
        None => finding.cause.clone(),
    }
}

/// Why not its rivals: how much worse each explains the same readings, as a difference of BIC.
#[must_use]
pub fn rivals(finding: &Finding) -> Option<String> {
    let mut nearest: Vec<_> = finding.rivals.iter().collect();
    nearest.sort_by(|a, b| a.score_gap.total_cmp(&b.score_gap));
    let named = nearest.iter().take(RIVALS).map(|rival| {
        let column = rival.column.as_ref().map_or(String::new(), |column| format!(" of {column}"));
        format!("{}{column} ({:+.0})", rival.cause, rival.score_gap)
    });
    let named: Vec<String> = named.collect();
    (!named.is_empty()).then(|| named.join(", "))
}

/// What is wrong, and why not something else: from the findings alone.
#[must_use]
pub fn findings(diagnosis: &Diagnosis) -> String {
    let report = &diagnosis.report;
    let mut text = format!("{}: {}\n", report.verdict.name(), diagnosis.sentence());
    for finding in &report.findings {
        let open = if finding.claimed { "" } else { ", not settled" };
        let _ = writeln!(text, "  {}{open}: {}", name(finding), finding.sentence);
        if let Some(rivals) = rivals(finding) {
            let _ = writeln!(text, "    worse in its place (BIC; 6 is clear): {rivals}");
        }
        let _ = writeln!(text, "    next: {}", finding.next_test);
    }
    if !report.verdict.is_met() {
        for reason in &report.reasons {
            let _ = writeln!(text, "  open: {reason}");
        }
    }
    for hint in &report.hints {
        let _ = writeln!(text, "  hint: {hint}");
    }
    text
}

impl ActOne {
    /// Act one on the screen.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = findings(&self.diagnosis) + "\n";
        for note in &self.notes {
            let _ = writeln!(text, "{note}");
        }
        text += &self.table();
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

    fn table(&self) -> String {
        let mut text = String::new();
        if self.rows.len() <= MOST_ROWS {
            text += "             the machine file as it is    extended from the other readings\n\
                     \x20measured     bridge        off by         bridge        off by\n";
            for row in &self.rows {
                let _ = writeln!(
                    text,
                    "{:6.1} µm   {:7.2} µm   {:+7.2} µm     {:7.2} µm   {:+7.2} µm",
                    row.dial_um,
                    row.bridge_um,
                    row.bridge_um - row.dial_um,
                    row.calibrated_um,
                    row.calibrated_um - row.dial_um,
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
