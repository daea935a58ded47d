//! The score of an answer to an effect of recorded inputs ([`crate::input_dependence`]): whether the columns of the hidden
//! law are named and claimed, and which share of the effect is gone on another day.

use std::{collections::BTreeSet, path::Path};

use trueup_diagnose::{diagnose, report::Finding};
use trueup_machine::{MachineFile, RunFile};

use crate::input_dependence::{DependenceKind, draw};

/// Noise of the gauge in µm, which nothing takes away.
const GAUGE_NOISE_UM: f64 = 0.4;

/// The score of an answer.
#[derive(Clone, Debug)]
pub struct DependenceScore {
    /// Whether all columns of the law are among those of claimed findings.
    pub is_named: bool,
    /// Whether something is claimed that depends on another column.
    pub is_foreign: bool,
    /// The share of what can go that is gone on the other day.
    pub gone: f64,
    /// The verdict and the findings, as text.
    pub findings: String,
}

/// Returns the columns that a finding is a law of.
fn columns(finding: &Finding) -> BTreeSet<&str> {
    let speeds = finding.times.as_deref().into_iter();
    let speeds = speeds.filter(|times| times.starts_with("speed")).map(|_| "spindle_rpm");
    let own = finding.column.iter().chain(finding.columns.iter().flatten());
    let range = finding.within.iter().map(|range| &range.column);
    own.chain(range).map(String::as_str).chain(speeds).collect()
}

/// Diagnoses the days of `kind` under `seed`, and scores the answer.
///
/// # Panics
/// The drawn days can be read and compared.
#[must_use]
pub fn diagnose_and_score_dependence(kind: DependenceKind, seed: u64) -> DependenceScore {
    let days = draw(kind, seed);
    let machine = MachineFile::parse(&days.machine, Path::new("m.toml")).expect("a machine file");
    let read =
        |text: &str| RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run file");
    let answer =
        diagnose(&machine, &[read(&days.first)], &[read(&days.second)], None, &mut |_, _| {});
    let report = answer.expect("the days can be compared").report;
    let hidden: BTreeSet<&str> = kind.columns.iter().copied().collect();
    let claimed: Vec<BTreeSet<&str>> =
        report.findings.iter().filter(|finding| finding.claimed).map(columns).collect();
    let named: BTreeSet<&str> = claimed.iter().flatten().copied().collect();
    let is_foreign = claimed.iter().any(|causes| causes.is_empty() || !causes.is_subset(&hidden));
    // Of the squares the noise stays.
    let effect_um =
        |rms_um: f64| (rms_um * rms_um - GAUGE_NOISE_UM * GAUGE_NOISE_UM).max(0.0).sqrt();
    let (before, after) = (report.before.holdout_rms_um, report.after.holdout_rms_um);
    let descriptions = report.findings.iter().map(|finding| {
        let mark = if finding.claimed { "" } else { "?" };
        format!("{mark}{} {:?} {:?}", finding.cause, columns(finding), finding.form)
    });
    DependenceScore {
        is_named: hidden.is_subset(&named),
        is_foreign,
        gone: 1.0 - effect_um(after) / effect_um(before).max(1e-9),
        findings: format!(
            "{}, {before:.2} -> {after:.2} µm: {}",
            report.verdict.name(),
            descriptions.collect::<Vec<_>>().join("; ")
        ),
    }
}
