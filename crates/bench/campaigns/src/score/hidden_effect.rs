//! The score of an answer to a hidden effect ([`crate::hidden_effects`]).

use std::{collections::BTreeMap, fmt, path::Path};

use trueup_diagnose::{Diagnosis, Verdict, diagnose, report::Finding};
use trueup_machine::{MachineFile, RunFile};
use trueup_twin::noise::rms;

use crate::hidden_effects::{ExpectedDiagnosis, GroundTruth, HiddenCause, TestCase};

/// A parameter as it was hidden, and as it was found.
#[derive(Clone, Debug)]
pub struct ParameterEstimate {
    /// The cause and the parameter.
    pub name: String,
    /// The hidden value.
    pub hidden: f64,
    /// The estimate.
    pub found: f64,
    /// Its 95 % interval.
    pub ci95: [f64; 2],
}

impl ParameterEstimate {
    /// Returns whether what was hidden is inside, each end `times` as far from what was found.
    #[must_use]
    pub fn contains_true_value(&self, times: f64) -> bool {
        let [low, high] = self.ci95.map(|end| self.found + times * (end - self.found));
        (low..=high).contains(&self.hidden)
    }
}

/// The score of one answer.
#[derive(Clone, Debug)]
pub struct HiddenEffectScore {
    /// The causes that were hidden.
    pub hidden: Vec<&'static str>,
    /// The causes that were named and claimed.
    pub named: Vec<String>,
    /// Named, but not claimed.
    pub unclaimed: Vec<String>,
    /// Every hidden cause is claimed.
    pub is_right: bool,
    /// A cause is claimed that was not hidden.
    pub is_wrong: bool,
    /// The verdict of the report.
    pub verdict: Verdict,
    /// Rivals that were as good.
    pub open: Vec<String>,
    /// Why causes are not claimed, with their values.
    pub doubts: Vec<String>,
    /// The interval of each hidden parameter of a cause that is a finding.
    pub intervals: Vec<ParameterEstimate>,
    /// Gain on the hold-out over the possible gain; NaN where nothing is to be gained, or not every
    /// cause is claimed.
    pub share_of_gain: f64,
    /// RMS of all that is hidden over that of the noise.
    pub visible: f64,
    /// The compensation of the answer leaves the hold-out worse: above 1.05 times what the current machine file
    /// leaves (RMS).
    pub is_harmed: bool,
}

/// Harm on a hold-out: this many times what the current machine file leaves (RMS), by the fixed form of the answer.
const MIN_HARM_RMS_RATIO: f64 = 1.05;

impl fmt::Display for HiddenEffectScore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |names: &[String]| if names.is_empty() { "-".into() } else { names.join("+") };
        write!(
            f,
            "{} (effect {:.1} times the noise): {}{}, {}, claimed {}, named {}",
            self.hidden.join("+"),
            self.visible,
            if self.is_right { "right" } else { "not right" },
            if self.is_wrong { " and wrong" } else { "" },
            self.verdict.name(),
            list(&self.named),
            list(&self.unclaimed),
        )?;
        if !self.share_of_gain.is_nan() {
            write!(f, ", {:.3} of the possible gain", self.share_of_gain)?;
        }
        if self.is_harmed {
            write!(f, ", HARM")?;
        }
        for it in &self.intervals {
            let place = if it.contains_true_value(1.0) { "inside" } else { "OUTSIDE" };
            write!(f, ", {} {:.4} of {:.4} {place}", it.name, it.found, it.hidden)?;
        }
        for open in &self.open {
            write!(f, ", open: {open}")?;
        }
        for doubt in &self.doubts {
            write!(f, "; {doubt}")?;
        }
        Ok(())
    }
}

/// Diagnoses the files of a challenge, and nothing else of it.
///
/// # Panics
/// The files of a challenge can be read and compared.
#[must_use]
pub fn run_diagnosis(challenge: &TestCase) -> Diagnosis {
    let machine = MachineFile::parse(&challenge.machine, Path::new("machine.toml"))
        .expect("the twin writes machine files");
    let read = |text: &str, name: &str| {
        RunFile::from_reader(text.as_bytes(), Path::new(name)).expect("the twin writes run files")
    };
    let runs: Vec<RunFile> = challenge.runs.iter().map(|text| read(text, "run.csv")).collect();
    let holdout = [read(&challenge.holdout, "holdout.csv")];
    diagnose(&machine, &runs, &holdout, None, &mut |_, _| {}).expect("the runs can be compared")
}

/// The verdict and the findings of an answer, by any version of the finder.
pub struct DiagnosisAnswer {
    /// By its name in the fixed form of the answer.
    pub verdict: String,
    /// The findings, claimed or not.
    pub findings: Vec<AnswerFinding>,
}

/// A finding of an [`DiagnosisAnswer`].
pub struct AnswerFinding {
    /// The name of the cause.
    pub cause: String,
    /// The columns that it depends on, where it has no physical name.
    pub columns: Vec<String>,
    /// Whether it is claimed.
    pub is_claimed: bool,
    /// Causes that are only certain together with it.
    pub partners: Vec<String>,
}

impl DiagnosisAnswer {
    fn from_diagnosis(diagnosis: &Diagnosis) -> Self {
        let findings = diagnosis.report.findings.iter().map(|finding| AnswerFinding {
            cause: finding.cause.clone(),
            columns: columns(finding),
            is_claimed: finding.claimed,
            partners: finding.together_with.iter().map(|partner| partner.cause.clone()).collect(),
        });
        Self { verdict: diagnosis.report.verdict.name().into(), findings: findings.collect() }
    }

    /// Returns whether a finding says without a physical name what a law without one depends on.
    fn is_dependence_on_true_inputs(it: &AnswerFinding, truth: &GroundTruth) -> bool {
        let inputs: Vec<&str> = truth
            .effects
            .iter()
            .flat_map(|effect| effect.cause.unnamed_effect_inputs())
            .copied()
            .collect();
        let is_input = |column: &String| inputs.contains(&column.as_str());
        it.cause == "dependence" && !it.columns.is_empty() && it.columns.iter().all(is_input)
    }

    /// Returns whether every hidden cause is named as it may be.
    #[must_use]
    pub fn names_all_causes(&self, truth: &GroundTruth) -> bool {
        let answers: Vec<&str> =
            truth.effects.iter().map(|effect| effect.cause.expected_name()).collect();
        let is_claimed = |name: &str| {
            self.findings.iter().any(|finding| finding.is_claimed && finding.cause == name)
        };
        // Causes that explain the same data are as right, if they are not claimed.
        let rivals = |name: &str| {
            let effect = truth.effects.iter().find(|effect| effect.cause.expected_name() == name);
            effect.is_some_and(|effect| {
                effect.rivals.iter().any(|rival| {
                    let mut open = self.findings.iter().filter(|finding| !finding.is_claimed);
                    open.any(|finding| finding.cause == rival.name() || finding.cause == name)
                })
            })
        };
        // Two that are only certain together are one finding, not claimed; both of them were hidden.
        let together = |name: &str| {
            self.findings.iter().any(|finding| {
                let partners = finding.partners.iter().map(String::as_str);
                let both: Vec<&str> = partners.chain([finding.cause.as_str()]).collect();
                both.len() > 1
                    && both.contains(&name)
                    && both.iter().all(|answer| answers.contains(answer))
            })
        };
        match truth.expected {
            // What has a memory is structure, where nobody says what the instrument is worth.
            ExpectedDiagnosis::Clean => {
                let wanders = truth.noise_rho > 0.0 && self.verdict == Verdict::Unexplained.name();
                self.verdict == Verdict::Clean.name() || wanders
            }
            ExpectedDiagnosis::Unnamed => {
                let is_of_it = |finding: &AnswerFinding| {
                    finding.is_claimed && Self::is_dependence_on_true_inputs(finding, truth)
                };
                let is_open = [Verdict::Unexplained, Verdict::PartlyExplained];
                is_open.iter().any(|cause| cause.name() == self.verdict)
                    || self.findings.iter().any(is_of_it)
            }
            ExpectedDiagnosis::Compensated | ExpectedDiagnosis::Reported => {
                answers.iter().all(|name| is_claimed(name) || rivals(name) || together(name))
            }
        }
    }

    /// Returns whether a cause is claimed that was not hidden.
    #[must_use]
    pub fn has_false_claim(&self, truth: &GroundTruth) -> bool {
        let is_hidden =
            |name: &str| truth.effects.iter().any(|effect| effect.cause.expected_name() == name);
        let is_true = |finding: &AnswerFinding| {
            is_hidden(&finding.cause) || Self::is_dependence_on_true_inputs(finding, truth)
        };
        self.findings.iter().any(|finding| finding.is_claimed && !is_true(finding))
    }
}

/// Returns the columns of a finding without a physical name.
fn columns(finding: &Finding) -> Vec<String> {
    let both = finding.columns.iter().flatten().chain(&finding.column);
    let range = finding.within.iter().map(|range| &range.column);
    both.chain(range).cloned().collect()
}

/// Scores `diagnosis` by the truth of `challenge`.
#[must_use]
pub fn score_diagnosis(challenge: &TestCase, diagnosis: &Diagnosis) -> HiddenEffectScore {
    let truth = &challenge.truth;
    let report = &diagnosis.report;
    let names = |of: fn(HiddenCause) -> &'static str| -> Vec<&'static str> {
        truth.effects.iter().map(|effect| of(effect.cause)).collect()
    };
    let (hidden, answers) = (names(HiddenCause::name), names(HiddenCause::expected_name));
    let of = |claimed: bool| -> Vec<String> {
        let findings = report.findings.iter().filter(|finding| finding.claimed == claimed);
        findings.map(|finding| finding.cause.clone()).collect()
    };
    let (named, unclaimed) = (of(true), of(false));
    let answer = DiagnosisAnswer::from_diagnosis(diagnosis);
    let (is_right, is_wrong) = (answer.names_all_causes(truth), answer.has_false_claim(truth));
    let open = report
        .findings
        .iter()
        .flat_map(|finding| finding.rivals.iter().map(move |rival| (finding, rival)))
        .filter(|(finding, rival)| rival.score_gap < 6.0 && rival.cause != finding.cause)
        .map(|(finding, rival)| {
            format!("{} {:.1} {} {:?}", finding.cause, rival.score_gap, rival.cause, rival.column)
        })
        .collect();
    let unclaimed_findings = report.findings.iter().filter(|finding| !finding.claimed);
    let doubts = unclaimed_findings
        .map(|finding| {
            let evidence = &finding.evidence;
            // Without what it leaves and gains.
            let sentences = evidence.iter().filter(|sentence| {
                !sentence.starts_with("Without") && !sentence.starts_with("On left")
            });
            format!("{}: {}", finding.cause, sentences.cloned().collect::<Vec<_>>().join(" "))
        })
        .collect();
    let mut intervals = Vec::new();
    for effect in &truth.effects {
        let finding =
            report.findings.iter().find(|finding| finding.cause == effect.cause.expected_name());
        let Some(finding) = finding else { continue };
        for &(name, hidden) in &effect.parameters {
            let Some(parameter) = finding.parameters.get(name) else { continue };
            let bound = |index: usize| parameter["ci95"].get(index)?.as_f64();
            if let (Some(found), Some(low), Some(high)) =
                (parameter["value"].as_f64(), bound(0), bound(1))
                && high > low
            {
                let name = format!("{} {name}", finding.cause);
                intervals.push(ParameterEstimate { name, hidden, found, ci95: [low, high] });
            }
        }
    }
    // What cannot be distinguished here may differ there.
    let is_claimed = answers.iter().all(|name| named.iter().any(|there| there == name));
    let possible = truth.max_holdout_rms_reduction();
    let reduction = 1.0 - report.after.holdout_rms_um / report.before.holdout_rms_um;
    let share_of_gain = match truth.expected {
        ExpectedDiagnosis::Compensated if possible > 0.0 && is_claimed => reduction / possible,
        _ => f64::NAN,
    };
    HiddenEffectScore {
        hidden,
        named,
        unclaimed,
        is_right,
        is_wrong,
        verdict: report.verdict,
        open,
        doubts,
        intervals,
        share_of_gain,
        visible: rms(&truth.effect_um) / truth.noise_rms_um,
        is_harmed: report.after.compensated_holdout_rms_um
            > MIN_HARM_RMS_RATIO * report.before.holdout_rms_um,
    }
}

/// The scores of the answers in a row of the score card.
#[derive(Clone, Debug, Default)]
pub struct ScoreRow {
    /// One for each draw.
    pub scores: Vec<HiddenEffectScore>,
}

impl ScoreRow {
    fn fraction_where(&self, of: impl Fn(&HiddenEffectScore) -> bool) -> f64 {
        self.scores.iter().filter(|score| of(score)).count() as f64
            / self.scores.len().max(1) as f64
    }

    /// Returns the share of right answers.
    #[must_use]
    pub fn correct_fraction(&self) -> f64 {
        self.fraction_where(|score| score.is_right)
    }

    /// Returns the share of answers that claim a cause that was not hidden.
    #[must_use]
    pub fn false_claim_fraction(&self) -> f64 {
        self.fraction_where(|score| score.is_wrong)
    }

    /// Counts the draws whose hold-out is left worse.
    #[must_use]
    pub fn count_degraded_hold_outs(&self) -> usize {
        self.scores.iter().filter(|score| score.is_harmed).count()
    }

    /// Returns the median and worst share of the possible gain, over the right answers.
    #[must_use]
    pub fn gain(&self) -> (f64, f64) {
        let mut gains: Vec<f64> = self
            .scores
            .iter()
            .filter(|score| score.is_right && !score.share_of_gain.is_nan())
            .map(|score| score.share_of_gain)
            .collect();
        gains.sort_by(f64::total_cmp);
        let median = gains.get(gains.len() / 2).copied().unwrap_or(f64::NAN);
        (median, gains.first().copied().unwrap_or(f64::NAN))
    }

    /// Returns the share of the true parameters that are within their intervals, and their count.
    #[must_use]
    pub fn interval_coverage(&self) -> (f64, usize) {
        let all: Vec<bool> = self
            .scores
            .iter()
            .flat_map(|score| &score.intervals)
            .map(|interval| interval.contains_true_value(1.0))
            .collect();
        let inside = all.iter().filter(|inside| **inside).count();
        (inside as f64 / all.len().max(1) as f64, all.len())
    }

    /// Returns one line of the card.
    #[must_use]
    pub fn format_line(&self, name: &str) -> String {
        let (median, worst) = self.gain();
        let (within, count) = self.interval_coverage();
        let mut confused: BTreeMap<String, usize> = BTreeMap::new();
        for score in self.scores.iter().filter(|score| !score.is_right || score.is_wrong) {
            let mut names: Vec<String> = score.named.clone();
            names.extend(score.unclaimed.iter().map(|name| format!("?{name}")));
            let key = format!("{} {}", score.verdict.name(), names.join("+"));
            *confused.entry(key).or_default() += 1;
        }
        let confused: Vec<String> =
            confused.into_iter().map(|(key, count)| format!("{count}x {key}")).collect();
        format!(
            "{name:<48} n {:>3} right {:>4.0} % wrong {:>4.0} % in {:>4.0} % of {count:<3} gain \
             {median:.3} worst {worst:.3} harm {}  {}",
            self.scores.len(),
            100.0 * self.correct_fraction(),
            100.0 * self.false_claim_fraction(),
            100.0 * within,
            self.count_degraded_hold_outs(),
            confused.join("; ")
        )
    }
}
