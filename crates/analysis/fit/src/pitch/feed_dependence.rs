//! Backlash by the feed of the approach: "at different speeds of the table the results differ" (paper 4).
//!
//! Each position has its differences at each feed. Whether the feeds differ is tested by analysis of
//! variance, the positions as blocks: the scatter of the feeds' means, each position's own mean taken
//! off, next to that of the repeats at one position and feed, F at 99 %. If they do, no mean of them is
//! right at any feed. One feed's width is fitted, and what it costs at the others is reported.

use super::{
    PitchFitOptions,
    pitch_report::confidence_half_width,
    readings::{FEED_COLUMN, FEED_RELATIVE_TOLERANCE, PitchReadings},
    reversal_difference::ReversalDifference,
};
use crate::pooled_rows::f_test_p_value;
use crate::report::{FitDetail, FitReport};

/// Below this probability a difference between feeds is not chance: the level of a claim.
const SIGNIFICANCE_LEVEL: f64 = 0.01;

/// Backlash that depends on the feed.
pub(super) struct BacklashByFeed {
    /// The feed that counts, by its place among the feeds.
    pub chosen: usize,
    is_requested: bool,
    /// Feed in mm/min, mean width in µm, and half its 95 % interval.
    widths: Vec<(f64, f64, Option<f64>)>,
}

/// `None` where there is but one feed, or the feeds do not differ.
///
/// # Errors
/// A required feed was not measured; with the rule.
pub(super) fn fit_backlash_by_feed(
    readings: &PitchReadings,
    differences: &[ReversalDifference],
    options: &PitchFitOptions,
) -> Result<Option<BacklashByFeed>, String> {
    let feeds = &readings.feeds_mm_per_min;
    let is_known = feeds.iter().any(|feed| *feed > 0.0);
    let requested = match options.feed_mm_per_min {
        None => None,
        Some(_) if !is_known => {
            return Err(format!(
                "the column {FEED_COLUMN} is missing: it states the feed at which each row was read"
            ));
        }
        Some(requested) => {
            let near = |feed: &f64| (feed / requested - 1.0).abs() <= FEED_RELATIVE_TOLERANCE;
            let there: Vec<String> = feeds.iter().map(f64::to_string).collect();
            let rule = format!(
                "was not {requested} mm/min in any row, but {}: measure at the feed that is used",
                there.join(", ")
            );
            Some(feeds.iter().position(near).ok_or(rule)?)
        }
    };
    if feeds.len() < 2
        || feed_dependence_p_value(differences, readings.targets_mm.len())
            .is_none_or(|p| p >= SIGNIFICANCE_LEVEL)
    {
        return Ok(None);
    }
    let widths = feeds.iter().enumerate().map(|(number, &feed)| {
        let um: Vec<f64> = differences
            .iter()
            .filter(|difference| difference.feed == number)
            .map(|difference| difference.um)
            .collect();
        (feed, um.iter().sum::<f64>() / um.len() as f64, confidence_half_width(&um))
    });
    let widths: Vec<_> = widths.collect();
    // A feed of which one side is missing has no width.
    let slowest = widths.iter().position(|(_, um, _)| !um.is_nan()).unwrap_or(0);
    let chosen = requested.unwrap_or(slowest);
    if widths[chosen].1.is_nan() {
        return Err("at this feed no position was approached from both sides".into());
    }
    Ok(Some(BacklashByFeed { chosen, is_requested: requested.is_some(), widths }))
}

impl BacklashByFeed {
    /// Adds the widths by feed to the report, next to the width `width_um` that was taken.
    pub(crate) fn add_to_report(&self, report: &mut FitReport, width_um: f64) {
        let chosen = self.widths[self.chosen].0;
        report.facts.push(FitDetail::number("at_feed_mm_per_min", chosen));
        let there = || self.widths.iter().filter(|(_, um, _)| !um.is_nan());
        report.facts.push(FitDetail::numbers(FEED_COLUMN, there().map(|point| point.0).collect()));
        report.facts.push(FitDetail::numbers(
            "reversal_at_feed_um",
            there().map(|point| point.1).collect(),
        ));
        let each: Vec<String> = there()
            .map(|(feed, um, half)| {
                let half = half.map_or(String::new(), |half| format!(" ± {half:.1}"));
                format!("{um:.1}{half} µm at {feed} mm/min")
            })
            .collect();
        let costs: Vec<String> = there()
            .filter(|(feed, ..)| *feed != chosen)
            .map(|(feed, um, _)| {
                format!("at {feed} mm/min {:.1} µm of it stay uncorrected", um - width_um)
            })
            .collect();
        let choose = if self.is_requested {
            ""
        } else {
            "; parts get their size at the slow feeds, so the slowest was taken: choose another with --feed"
        };
        report.warnings.push(format!(
            "backlash depends on the feed: {}. {width_um:.1} µm, of {chosen} mm/min, is taken; {}{choose}",
            each.join(", "),
            costs.join(", ")
        ));
    }
}

/// Returns how likely chance alone makes the feeds differ so; `None` without repeats.
fn feed_dependence_p_value(differences: &[ReversalDifference], targets: usize) -> Option<f64> {
    let mean = |of: &dyn Fn(&&ReversalDifference) -> bool| {
        let um: Vec<f64> = differences.iter().filter(of).map(|difference| difference.um).collect();
        (um.iter().sum::<f64>() / um.len() as f64, um.len() as f64)
    };
    let feeds = differences.iter().map(|difference| difference.feed).max()? + 1;
    let of_target: Vec<f64> =
        (0..targets).map(|t| mean(&|difference| difference.target == t).0).collect();
    let mut cells = 0;
    let (mut within, mut between, mut groups) = (0.0, 0.0, 0);
    for feed in 0..feeds {
        let own: Vec<&ReversalDifference> =
            differences.iter().filter(|difference| difference.feed == feed).collect();
        if own.is_empty() {
            continue;
        }
        groups += 1;
        let off =
            own.iter().map(|difference| difference.um - of_target[difference.target]).sum::<f64>()
                / own.len() as f64;
        between += own.len() as f64 * off * off;
        for target in 0..targets {
            let (cell, count) =
                mean(&|difference| difference.feed == feed && difference.target == target);
            if count > 0.0 {
                cells += 1;
                let here = own.iter().filter(|difference| difference.target == target);
                within += here.map(|difference| (difference.um - cell).powi(2)).sum::<f64>();
            }
        }
    }
    let freedom = (differences.len().checked_sub(cells)? as f64, (groups - 1) as f64);
    if freedom.0 == 0.0 || freedom.1 == 0.0 {
        return None;
    }
    f_test_p_value((between, freedom.1), (within, freedom.0))
}
