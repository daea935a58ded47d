//! The shortest run, of the spindle or of an axis, that distinguishes open causes: design of experiments by the models
//! that were fitted.
//!
//! ```text
//! open causes ─► Question    two fitted models, how far each may be off, the noise
//! runs        ─► Foresight   what thermometers and sensors will show in runs that are not made yet
//! candidates  ─► gap         expected −2·ln of the likelihood ratio on each; the shortest that suffices
//! ```
//!
//! Only speeds up to the fastest that the runs have, from cold, and positions between those of the runs are thought
//! of: there the fitted laws have been seen. A run that was not measured is no proof: the gap is expected under the
//! smaller of the two, and what the run then shows decides.

pub(crate) mod axis_run;
pub(crate) mod model_pair;
pub(crate) mod spindle_forecast;
pub(crate) mod spindle_run_candidates;

use std::fmt;

use serde::Serialize;
use trueup_machine::{InputFileError, RunFile};
use trueup_numerics::t_quantile;

use crate::{
    data::DataTable, fit::CONFIDENCE_LEVEL,
    search::model_comparison::STRONG_EVIDENCE_BIC_DIFFERENCE,
};
use axis_run::AxisForecaster;
pub use axis_run::AxisRun;
use model_pair::{ModelPair, Separation};
use spindle_forecast::SpindleForecaster;
use spindle_run_candidates::candidate_spindle_runs;

/// Returns the expected gap with which the measured one is strong evidence in 19 of 20 cases: a log likelihood ratio that
/// is expected to be G scatters by 2√G, so that G − 2·z·√G is that much, z the one-sided quantile.
fn sufficient_likelihood_ratio_statistic() -> f64 {
    let z = t_quantile(CONFIDENCE_LEVEL, f64::from(u16::MAX));
    (z + (z * z + STRONG_EVIDENCE_BIC_DIFFERENCE).sqrt()).powi(2)
}

/// A gap below this is nothing: what chance alone would make of one value.
const MIN_SEPARATION_SCORE_GAP: f64 = 1.0;

/// How a reading of a planned run gets into its row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReadingMethod {
    /// A person reads the gauge and the thermometers and writes them down.
    #[default]
    Hand,
    /// A program records them.
    Auto,
}

impl ReadingMethod {
    /// Returns the shortest time from reading to reading of a spindle, in s: a person takes half a minute for a row,
    /// and for a program three rows a minute are enough for what heats.
    fn min_reading_interval_s(self) -> f64 {
        match self {
            Self::Hand => 30.0,
            Self::Auto => 20.0,
        }
    }

    /// Returns how long an axis stands for a reading, in s; of a program as in `trueup program`.
    fn dwell_s(self) -> f64 {
        match self {
            Self::Hand => 30.0,
            Self::Auto => 5.0,
        }
    }
}

/// A part of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SpindleSegment {
    /// The spindle's speed in r/min; 0: it stands.
    pub rpm: f64,
    /// How long, in minutes, above 0.
    pub minutes: f64,
    /// The axial cutting force in N; 0: in the air.
    pub load_n: f64,
}

/// The expected separation of two causes by a run.
#[derive(Clone, Debug, Serialize)]
pub struct ExpectedSeparation {
    /// The cause that was named, and the one that cannot be distinguished from it.
    pub causes: [String; 2],
    /// How far their predictions come apart at most, in µm.
    pub difference_um: f64,
    /// The noise of one reading, in µm: a standard deviation.
    pub noise_um: f64,
    /// The expected difference of their scores (−2 ln likelihood), in the less certain of both cases.
    pub score_gap: f64,
}

/// The next run.
#[derive(Clone, Debug, Serialize)]
pub struct NextRun {
    /// The stretches of the spindle, from cold; none where an axis is measured.
    pub stretches: Vec<SpindleSegment>,
    /// The measurement of the axis, where one is measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis: Option<AxisRun>,
    /// How long all of it lasts.
    pub minutes: f64,
    /// From reading to reading of a spindle, in s; 0: an axis is read at its targets.
    pub every_s: f64,
    /// The inputs to record next to the measured quantity: columns of the runs.
    pub inputs: Vec<String>,
    /// The causes that it separates, the question first that it was chosen for.
    #[serde(rename = "told")]
    pub separations: Vec<ExpectedSeparation>,
}

/// Why there is none.
#[derive(Clone, Debug, PartialEq)]
pub enum NoNextRunReason {
    /// Every name is claimed.
    NothingOpen,
    /// The runs lack what a run is described by: time and speed of a spindle, position and direction of an axis.
    NotPredictable(&'static str),
    /// None of the runs that were thought of distinguishes them: the causes, and the largest gap.
    NotDistinguishable([String; 2], f64),
}

impl fmt::Display for NoNextRunReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NothingOpen => f.write_str("no cause is open: there is nothing to separate"),
            Self::NotPredictable(why) => write!(
                f,
                "{why}: no run can be planned; the sentences after \"next:\" state what to measure, and trueup program writes it"
            ),
            Self::NotDistinguishable([one, other], gap) if *gap < MIN_SEPARATION_SCORE_GAP => {
                write!(
                    f,
                    "within the uncertainty of their values {one} and {other} predict the same in \
                 every planned run of up to 90 min. No measurement of this kind separates them. \
                 Whether their corrections agree elsewhere is not known"
                )
            }
            Self::NotDistinguishable([one, other], gap) => write!(
                f,
                "no run of up to 90 min separates {one} from {other}: the best would give a score gap of \
                 {gap:.1}, and {} is strong evidence",
                STRONG_EVIDENCE_BIC_DIFFERENCE
            ),
        }
    }
}

impl NextRun {
    /// Nothing yet, with these columns next to it.
    fn with_inputs(inputs: Vec<String>) -> Self {
        let (stretches, separations) = (Vec::new(), Vec::new());
        Self { stretches, axis: None, minutes: 0.0, every_s: 0.0, inputs, separations }
    }

    /// Returns the run and what it brings, in a machinist's words.
    #[must_use]
    pub fn sentence(&self) -> String {
        let mut text =
            self.axis.as_ref().map_or_else(|| self.describe_spindle_run(), AxisRun::sentence);
        for ExpectedSeparation { causes: [one, other], difference_um, noise_um, score_gap } in
            &self.separations
        {
            text += &format!(
                ". Then {one} and {other} differ by up to {difference_um:.1} µm, {:.0} times the noise of a reading \
                 (expected score gap {score_gap:.0}; {} is strong evidence)",
                difference_um / noise_um,
                STRONG_EVIDENCE_BIC_DIFFERENCE
            );
        }
        text
    }

    fn describe_spindle_run(&self) -> String {
        let stretch = |segment: &SpindleSegment| {
            let minutes = format!("{:.0} minutes", segment.minutes);
            match (segment.rpm > 0.0, segment.load_n > 0.0) {
                (false, _) => format!("stop for {minutes}"),
                (true, false) => format!("run at {:.0} r/min for {minutes}", segment.rpm),
                (true, true) => {
                    format!(
                        "cut with {:.0} N at {:.0} r/min for {minutes}",
                        segment.load_n, segment.rpm
                    )
                }
            }
        };
        let mut done: Vec<String> = Vec::new();
        let mut rest = self.stretches.as_slice();
        while !rest.is_empty() {
            // A pair that comes again and again is stated once.
            let times =
                rest.chunks(2).take_while(|pair| pair == &&rest[..2.min(rest.len())]).count();
            if times > 2 {
                let pair: Vec<String> = rest[..2].iter().map(stretch).collect();
                done.push(format!("{times} times: {}", pair.join(" and ")));
                rest = &rest[2 * times..];
            } else {
                done.push(stretch(&rest[0]));
                rest = &rest[1..];
            }
        }
        format!("from cold, {}. Read every {:.0} s", done.join(", then "), self.every_s)
    }
}

/// Returns the shortest run that answers the first of `questions` that any answers.
pub(crate) fn find_next_run(
    questions: &[ModelPair],
    data: &DataTable,
    runs: &[RunFile],
    gauge: ReadingMethod,
) -> Result<NextRun, NoNextRunReason> {
    if questions.is_empty() {
        return Err(NoNextRunReason::NothingOpen);
    }
    let foreseen = forecast_candidate_runs(data, runs, gauge)?;
    let mut refused = None;
    for (number, question) in questions.iter().enumerate() {
        let gaps: Vec<Separation> =
            foreseen.iter().map(|run| question.separation(&run.table)).collect();
        let shorter = |a: &usize, b: &usize| {
            let [one, other] = [a, b].map(|n| foreseen[*n].next.minutes);
            one.total_cmp(&other).then(gaps[*b].gap.total_cmp(&gaps[*a].gap))
        };
        let suffices = sufficient_likelihood_ratio_statistic();
        let enough = (0..gaps.len()).filter(|n| gaps[*n].gap >= suffices).min_by(shorter);
        let most = (0..gaps.len()).max_by(|a, b| gaps[*a].gap.total_cmp(&gaps[*b].gap));
        let Some(most) = most else { continue };
        if gaps[most].gap < STRONG_EVIDENCE_BIC_DIFFERENCE {
            refused.get_or_insert(NoNextRunReason::NotDistinguishable(
                question.causes.clone(),
                gaps[most].gap,
            ));
            continue;
        }
        let CandidateRun { next, table } = &foreseen[enough.unwrap_or(most)];
        let mut separations = vec![question.expected_separation(table)];
        let others = questions.iter().enumerate().filter(|(other, _)| *other != number);
        let others = others.map(|(_, question)| question.expected_separation(table));
        separations.extend(
            others.filter(|separation| separation.score_gap >= STRONG_EVIDENCE_BIC_DIFFERENCE),
        );
        return Ok(NextRun { separations, ..next.clone() });
    }
    Err(refused.unwrap_or(NoNextRunReason::NotPredictable(
        "the machine file needs a column that only positions have",
    )))
}

/// A run that is not made yet.
struct CandidateRun {
    /// The run; the causes that it separates are not known yet.
    next: NextRun,
    /// The table that it will read.
    table: DataTable,
}

/// Returns all that are thought of.
fn forecast_candidate_runs(
    data: &DataTable,
    runs: &[RunFile],
    gauge: ReadingMethod,
) -> Result<Vec<CandidateRun>, NoNextRunReason> {
    if let Some(axis) = data.setting.quantity.axis() {
        let foresight = AxisForecaster::from_runs(runs, &data.setting.machine, axis, gauge)
            .map_err(NoNextRunReason::NotPredictable)?;
        let inputs = foresight.input_columns();
        let all = foresight.candidate_runs().into_iter().filter_map(|run| {
            let table = foresight.forecast_table(&run, data)?;
            let minutes = run.duration_min();
            let next = NextRun { minutes, axis: Some(run), ..NextRun::with_inputs(inputs.clone()) };
            Some(CandidateRun { next, table })
        });
        return Ok(all.collect());
    }
    let foresight =
        SpindleForecaster::from_runs(runs, gauge).map_err(NoNextRunReason::NotPredictable)?;
    let inputs = foresight.input_columns();
    let all = candidate_spindle_runs(&foresight).into_iter().filter_map(|stretches| {
        let table = foresight.forecast_table(&stretches, data)?;
        let minutes = stretches.iter().map(|stretch| stretch.minutes).sum();
        let every_s = foresight.every_s;
        let next = NextRun { stretches, minutes, every_s, ..NextRun::with_inputs(inputs.clone()) };
        Some(CandidateRun { next, table })
    });
    Ok(all.collect())
}

/// Returns what `run` has measured for the first of `questions`.
pub(crate) fn likelihood_ratio_statistic(
    questions: &[ModelPair],
    data: &DataTable,
    run: &RunFile,
) -> Result<Option<f64>, InputFileError> {
    let Some(question) = questions.first() else { return Ok(None) };
    let mut table =
        DataTable::new(&data.setting.machine, std::slice::from_ref(run), data.setting.quantity)?;
    table.copy_origin_from(data);
    Ok(Some(question.likelihood_ratio_statistic(&table)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_described_in_words_and_what_alternates_is_stated_once() {
        let stretch = |rpm, minutes, load_n| SpindleSegment { rpm, minutes, load_n };
        let separation = ExpectedSeparation {
            causes: ["a".into(), "b".into()],
            difference_um: 7.0,
            noise_um: 0.35,
            score_gap: 41.2,
        };
        let mut next = NextRun {
            stretches: vec![stretch(6000.0, 12.0, 0.0), stretch(0.0, 8.0, 0.0)],
            axis: None,
            minutes: 20.0,
            every_s: 60.0,
            inputs: Vec::new(),
            separations: vec![separation],
        };
        assert_eq!(
            next.sentence(),
            "from cold, run at 6000 r/min for 12 minutes, then stop for 8 minutes. Read every 60 s. Then a and b differ \
             by up to 7.0 µm, 20 times the noise of a reading (expected score gap 41; 6 is strong evidence)"
        );
        next.separations.clear();
        next.stretches = [stretch(6000.0, 2.0, 0.0), stretch(6000.0, 2.0, 300.0)].repeat(4);
        assert_eq!(
            next.sentence(),
            "from cold, 4 times: run at 6000 r/min for 2 minutes and cut with 300 N at 6000 r/min for 2 minutes. Read \
             every 60 s"
        );
    }
}
