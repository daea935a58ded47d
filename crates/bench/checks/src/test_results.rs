//! Counts tests by the lines that they print, and keeps how long each took.
//!
//! Three things are not a pass: a test that failed; one that cannot run where it is, for want of data say,
//! and prints a line that starts with `skipped:`; and one that is ignored. The reason of an ignored
//! one says which tier runs it: `long: …` the long one; `campaign: …` no tier, it has a command of its
//! own. Any other reason is a failure, so that no test is skipped permanently without a notice.

use std::time::Duration;

/// Counts of test results.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TestResults {
    /// Tests and steps that passed.
    pub passed: u32,
    /// Tests and steps that failed.
    pub failed: u32,
    /// Tests skipped because something is missing here: data, a program, a device.
    pub lacking: u32,
    /// Tests left to the long tier.
    pub long: u32,
    /// Campaigns, which have a command of their own.
    pub campaigns: u32,
    /// The tests that failed, by program and name.
    pub failures: Vec<String>,
    /// How long each test took.
    pub times: Vec<(String, Duration)>,
    /// Tests that printed why they cannot run, of which the result line has not come yet.
    announced: u32,
}

impl TestResults {
    /// This many things that passed.
    pub(crate) fn with_passed(count: u32) -> Self {
        Self { passed: count, ..Self::default() }
    }

    /// Returns one thing that failed.
    pub(crate) fn with_one_failure() -> Self {
        Self { failed: 1, ..Self::default() }
    }

    /// Returns one thing that cannot be had here.
    pub(crate) fn report_unavailable(why: &str) -> Self {
        trueup_output::write_line_best_effort(format_args!("skipped: {why}"));
        Self { lacking: 1, ..Self::default() }
    }

    /// Returns all that did not run.
    pub(crate) fn skipped(&self) -> u32 {
        self.lacking + self.long + self.campaigns
    }

    /// Adds what came of others.
    pub(crate) fn merge(&mut self, other: Self) {
        self.passed += other.passed;
        self.failed += other.failed;
        self.lacking += other.lacking;
        self.long += other.long;
        self.campaigns += other.campaigns;
        self.failures.extend(other.failures);
        self.times.extend(other.times);
    }

    /// Takes a line that a test program printed; `took` is the time since its last result.
    ///
    /// Gives whether the line is the result of one test.
    pub(crate) fn count_result_line(&mut self, program: &str, line: &str, took: Duration) -> bool {
        if line.starts_with("skipped:") {
            self.lacking += 1;
            self.announced += 1;
            return false;
        }
        if let Some(result) = line.strip_prefix("test result: ") {
            let number = |word: &str| -> u32 {
                let before = result.split(word).next().unwrap_or_default();
                before.split_whitespace().last().and_then(|n| n.parse().ok()).unwrap_or(0)
            };
            // A test that printed why it cannot run has passed, for all that its program knows.
            self.passed += number(" passed").saturating_sub(std::mem::take(&mut self.announced));
            self.failed += number(" failed");
            return false;
        }
        let Some((test, result)) =
            line.strip_prefix("test ").and_then(|line| line.split_once(" ... "))
        else {
            return false;
        };
        match result.strip_prefix("ignored") {
            Some(reason) => match reason.trim_start_matches([',', ' ']) {
                reason if reason.starts_with("long:") => self.long += 1,
                reason if reason.starts_with("campaign:") => self.campaigns += 1,
                // A block of a documentation that is shown and not run.
                _ if test.contains(" (line ") => {}
                _ => {
                    self.failures.push(format!(
                        "{program}: {test} is ignored, but neither \"long: …\" nor \"campaign: …\""
                    ));
                    self.failed += 1;
                }
            },
            None => {
                if result == "FAILED" {
                    self.failures.push(format!("{program}: {test}"));
                }
                self.times.push((format!("{program}: {test}"), took));
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_did_not_run_is_not_counted_as_passed() {
        let mut tally = TestResults::default();
        let lines = [
            "running 4 tests",
            "test a::b ... ok",
            "test a::c ... ignored, long: a minute",
            "test a::d ... ignored, campaign: cargo test -- --ignored",
            "test src/x.rs - x (line 7) ... ignored",
            "skipped: no measured data",
            "test result: ok. 4 passed; 0 failed; 2 ignored; 0 measured; 0 filtered out",
        ];
        for line in lines {
            tally.count_result_line("x", line, Duration::from_secs(1));
        }
        let times = vec![("x: a::b".into(), Duration::from_secs(1))];
        let expected = TestResults {
            passed: 3,
            lacking: 1,
            long: 1,
            campaigns: 1,
            times,
            ..TestResults::default()
        };
        assert_eq!(tally, expected);
        assert_eq!(tally.skipped(), 3);
    }

    #[test]
    fn a_test_that_failed_is_named_with_its_program() {
        let mut tally = TestResults::default();
        for line in ["test a ... FAILED", "test result: FAILED. 0 passed; 1 failed; 0 ignored"] {
            tally.count_result_line("x", line, Duration::ZERO);
        }
        assert_eq!((tally.failed, tally.failures), (1, vec!["x: a".to_owned()]));
    }

    #[test]
    fn a_test_that_is_ignored_for_no_known_reason_fails() {
        let mut tally = TestResults::default();
        for line in ["test a ... ignored", "test b ... ignored, takes a while"] {
            tally.count_result_line("x", line, Duration::ZERO);
        }
        assert_eq!((tally.failed, tally.skipped()), (2, 0));
    }
}
