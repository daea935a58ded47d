//! Act two over many fixed seeds: how often all is right, how often a name is wrong, and how far the gain
//! at the tool is from what was promised.

use std::fmt::Write as _;

use anyhow::Result;
use trueup_campaigns::faulty_machine::SeparableFaultMachine;

use crate::{
    hidden_fault_demo::{HiddenFaultOutcome, run_hidden_fault_demo},
    stepped_board::BoardSource,
};

/// The reduction at the tool may be so far from what was promised.
const REDUCTION_TOLERANCE: f64 = 0.05;

/// Figures over seeds.
#[derive(Clone, Debug, Default)]
pub struct CampaignStatistics {
    /// Result of each seed.
    pub outcomes: Vec<HiddenFaultOutcome>,
}

impl CampaignStatistics {
    /// Plays this machine; returns its line.
    ///
    /// # Errors
    /// A board ends.
    pub fn run_and_record(
        &mut self,
        boards: &BoardSource,
        hidden: &SeparableFaultMachine,
    ) -> Result<String> {
        let outcome = run_hidden_fault_demo(boards, hidden, &mut |_, _| {})?.outcome;
        let line = outcome.format_row();
        self.outcomes.push(outcome);
        Ok(line)
    }

    /// Returns the figures.
    #[must_use]
    pub fn format_summary(&self) -> String {
        let count = |is: &dyn Fn(&HiddenFaultOutcome) -> bool| {
            self.outcomes.iter().filter(|outcome| is(outcome)).count()
        };
        let machines = self.outcomes.len();
        let percent = |part: usize, of: usize| 100.0 * part as f64 / of.max(1) as f64;
        let claimed: usize = self
            .outcomes
            .iter()
            .map(|outcome| outcome.findings.iter().filter(|finding| finding.claimed).count())
            .sum();
        let wrong: usize = self.outcomes.iter().map(|outcome| outcome.wrong.len()).sum();
        let (right, kept) = (
            count(&|outcome| outcome.all_right),
            count(&HiddenFaultOutcome::is_reduction_within_tolerance),
        );
        let harm = count(&|outcome| outcome.tool_rms_after_um > 1.05 * outcome.tool_rms_before_um);
        format!(
            "{machines} machines: all right in {right} ({:.1} %); {wrong} wrong names of {claimed} claimed \
             ({:.1} %); the reduction at the tool within {REDUCTION_TOLERANCE} of the promise in {kept} ({:.1} %); made \
             worse: {harm}",
            percent(right, machines),
            percent(wrong, claimed),
            percent(kept, machines),
        )
    }
}

impl HiddenFaultOutcome {
    /// Returns whether the tool has got what was promised.
    #[must_use]
    pub fn is_reduction_within_tolerance(&self) -> bool {
        (self.reduction - self.promised_reduction).abs() <= REDUCTION_TOLERANCE
    }

    /// Returns a line for a table of many.
    #[must_use]
    pub fn format_row(&self) -> String {
        let faults: Vec<String> =
            self.faults.iter().map(|fault| format!("{} {:.1}", fault.fault, fault.ratio)).collect();
        let found = self.findings.iter().map(|finding| {
            let open = if finding.claimed { "" } else { "?" };
            format!("{open}{}", finding.cause)
        });
        let mut line = format!(
            "seed {} {} [{}] gap {:.0}: {} {} [{}], tool {:.2} -> {:.2} um, reduction {:.3}, promised {:.3}",
            self.seed,
            self.machine,
            faults.join(", "),
            self.gap,
            if self.all_right { "right" } else { "NOT RIGHT" },
            self.verdict,
            found.collect::<Vec<String>>().join(", "),
            self.tool_rms_before_um,
            self.tool_rms_after_um,
            self.reduction,
            self.promised_reduction,
        );
        if !self.wrong.is_empty() {
            let _ = write!(line, ", WRONG {}", self.wrong.join(", "));
        }
        if !self.is_reduction_within_tolerance() {
            line.push_str(", not as promised");
        }
        line
    }
}
