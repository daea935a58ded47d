//! The answer key of a record whose causes are known by physics: what may be claimed, and what must be named.

use std::fmt;

use trueup_diagnose::{DiagnosisReport, Verdict, report::Finding};

/// A cause that may be claimed.
#[derive(Clone, Copy, Debug)]
pub struct TrueCause {
    /// Its name.
    pub cause: &'static str,
    /// A parameter and its true value, where the name alone would not do: it has to be inside the
    /// interval.
    pub inside: Option<(&'static str, f64)>,
}

impl TrueCause {
    /// Returns a cause that is true by its name, whatever its parameters.
    #[must_use]
    pub const fn named(cause: &'static str) -> Self {
        Self { cause, inside: None }
    }

    fn matches(&self, finding: &Finding) -> bool {
        let holds = |(name, value): (&str, f64)| {
            let ci95 = finding.parameters.get(name).map(|parameter| &parameter["ci95"]);
            let bound = |index: usize| ci95.and_then(|ci95| ci95.get(index)?.as_f64());
            matches!((bound(0), bound(1)), (Some(low), Some(high)) if (low..=high).contains(&value))
        };
        self.cause == finding.cause && self.inside.is_none_or(holds)
    }
}

/// The right answer to a record.
#[derive(Clone, Debug, Default)]
pub struct AnswerKey {
    /// All that may be claimed.
    pub allowed: Vec<TrueCause>,
    /// Of each list one has to be named, claimed or not.
    pub needed: Vec<&'static [&'static str]>,
}

/// An answer compared with a [`AnswerKey`].
#[derive(Clone, Debug)]
pub struct AnswerComparison {
    /// The verdict of the report.
    pub verdict: Verdict,
    /// Causes that are claimed.
    pub claimed: Vec<String>,
    /// Causes that are named, but not claimed.
    pub open: Vec<String>,
    /// Claimed, and not true.
    pub wrong: Vec<String>,
    /// Lists of [`AnswerKey::needed`] of which nothing is named.
    pub missed: Vec<&'static str>,
    /// Of each list of [`AnswerKey::needed`]: whether one of it is named, and whether one is claimed.
    pub needed: Vec<(bool, bool)>,
}

impl AnswerKey {
    /// Compares `report` with the key.
    #[must_use]
    pub fn compare(&self, report: &DiagnosisReport) -> AnswerComparison {
        let names = |is_selected: &dyn Fn(&Finding) -> bool| {
            let findings = report.findings.iter().filter(|finding| is_selected(finding));
            findings.map(|finding| finding.cause.clone()).collect::<Vec<String>>()
        };
        let is_true = |finding: &Finding| self.allowed.iter().any(|truth| truth.matches(finding));
        let (claimed, mut open) =
            (names(&|comparison| comparison.claimed), names(&|comparison| !comparison.claimed));
        // Two that are only certain together are one finding, and both are named.
        let partners = report.findings.iter().flat_map(|finding| &finding.together_with);
        open.extend(partners.map(|partner| partner.cause.clone()));
        let is_in =
            |list: &[&str], names: &[String]| names.iter().any(|name| list.contains(&&**name));
        let needed: Vec<(bool, bool)> = self
            .needed
            .iter()
            .map(|list| (is_in(list, &claimed) || is_in(list, &open), is_in(list, &claimed)))
            .collect();
        let missed = self.needed.iter().zip(&needed).filter(|(_, (is_named, _))| !is_named);
        AnswerComparison {
            verdict: report.verdict,
            wrong: names(&|comparison| comparison.claimed && !is_true(comparison)),
            missed: missed.map(|(list, _)| list[0]).collect(),
            needed,
            claimed,
            open,
        }
    }
}

impl AnswerComparison {
    /// Returns true if all that is needed is named, and nothing false is claimed.
    #[must_use]
    pub fn is_right(&self) -> bool {
        self.needed.iter().all(|(is_named, _)| *is_named) && self.wrong.is_empty()
    }
}

impl fmt::Display for AnswerComparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |names: &[String]| if names.is_empty() { "-".into() } else { names.join("+") };
        write!(
            f,
            "{}, {}, claimed {}, open {}",
            if self.is_right() { "right" } else { "NOT RIGHT" },
            self.verdict.name(),
            list(&self.claimed),
            list(&self.open)
        )?;
        if !self.wrong.is_empty() {
            write!(f, ", wrong {}", list(&self.wrong))?;
        }
        if !self.missed.is_empty() {
            write!(f, ", missed {}", self.missed.join("+"))?;
        }
        Ok(())
    }
}
