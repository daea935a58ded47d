//! `feed-dependent-backlash`: how far the axis is left behind on reversal depends on the feed.
//!
//! ```text
//! p + w(F) where the axis was approached in the negative direction
//! w linear between the widths w₁ … wₙ at the feeds F₁ < … < Fₙ, held outside
//! ```
//!
//! Friction, inertia and the loop's own following error take up a play otherwise when the axis comes
//! faster. No control and no bridge receives the feed while it corrects: they run the width of one feed,
//! that which the user says the parts get their size at, and where a run does not say its feed that one
//! is predicted as well.

use super::{
    cause_spec::{
        BoardRepresentation, BoardTerm, Candidate, Explanation, FileRepresentation,
        FindingParameter, FitSpec, LawInput, PhysicalLaw, Target, TermEntry, Value,
    },
    data_view::{DataView, StartValues},
};
use crate::{
    keys::{
        reader::Section,
        term::{AT_FEED_MM_PER_MIN, FEEDS_MM_PER_MIN, WIDTH_UM},
    },
    location::InputFileError,
    sections::axis::is_negative_direction,
};

/// The column of the feed, in mm/min.
pub(crate) const FEED_COLUMN: &str = "feed_mm_per_min";

/// Feeds that differ by less are one: the share by which an override knob steps.
const RELATIVE_FEED_TOLERANCE: f64 = 0.01;

/// More feeds than a person would set are a feed that varies; it is followed at this many.
const MAX_FEEDS: usize = 6;

/// A width for each of some feeds.
#[derive(Clone, Debug, PartialEq)]
pub struct FeedDependentBacklash {
    /// F₁ … Fₙ in mm/min, above 0, rising; at least two.
    pub feeds_mm_per_min: Vec<f64>,
    /// w₁ … wₙ in µm, positive where the table is left behind.
    pub width_um: Vec<f64>,
    /// The feed whose width a board or a control corrects, in mm/min, above 0.
    pub at_feed_mm_per_min: f64,
}

impl FeedDependentBacklash {
    fn neutral(feeds_mm_per_min: Vec<f64>) -> Self {
        // Parts get their size at the slow feeds.
        let at_feed_mm_per_min = feeds_mm_per_min[0];
        let width_um = vec![0.0; feeds_mm_per_min.len()];
        Self { feeds_mm_per_min, width_um, at_feed_mm_per_min }
    }

    /// Returns the two feeds around one, by their places, and how far it is from the first to the second.
    fn bracketing_feed_indices(&self, feed_mm_per_min: f64) -> (usize, usize, f64) {
        let feeds = &self.feeds_mm_per_min;
        let above = feeds.partition_point(|feed| *feed <= feed_mm_per_min);
        let above = above.clamp(1, feeds.len() - 1);
        let [low, high] = [feeds[above - 1], feeds[above]];
        (above - 1, above, ((feed_mm_per_min - low) / (high - low)).clamp(0.0, 1.0))
    }

    /// Returns the width of the one feed that is corrected, in µm.
    fn corrected_width_um(&self) -> f64 {
        let (low, high, share) = self.bracketing_feed_indices(self.at_feed_mm_per_min);
        (1.0 - share) * self.width_um[low] + share * self.width_um[high]
    }
}

impl FileRepresentation for FeedDependentBacklash {
    const NAME: &'static str = "feed-dependent-backlash";

    fn keys(_: &Section<'_>) -> &'static [&'static str] {
        &[FEEDS_MM_PER_MIN.name, WIDTH_UM.name, AT_FEED_MM_PER_MIN.name]
    }

    fn read(section: &Section<'_>) -> Result<Self, InputFileError> {
        let key = FEEDS_MM_PER_MIN.name;
        let feeds_mm_per_min = section.required(key, section.numbers(key)?)?;
        let is_rising = feeds_mm_per_min.windows(2).all(|pair| pair[0] < pair[1]);
        if feeds_mm_per_min.len() < 2 || !is_rising || feeds_mm_per_min[0] <= 0.0 {
            return Err(section.key_error(key, "takes at least two feeds above 0, rising"));
        }
        let width_um = section.required(WIDTH_UM.name, section.numbers(WIDTH_UM.name)?)?;
        if width_um.len() != feeds_mm_per_min.len() {
            return Err(
                section.key_error(WIDTH_UM.name, "takes a width for each of feeds_mm_per_min")
            );
        }
        let at_feed_mm_per_min = section.positive_number(AT_FEED_MM_PER_MIN.name)?;
        let at_feed_mm_per_min = at_feed_mm_per_min.unwrap_or(feeds_mm_per_min[0]);
        Ok(Self { feeds_mm_per_min, width_um, at_feed_mm_per_min })
    }

    fn entries(&self) -> Vec<TermEntry> {
        vec![
            (FEEDS_MM_PER_MIN.name, Value::Numbers(self.feeds_mm_per_min.clone())),
            (WIDTH_UM.name, Value::Numbers(self.width_um.clone())),
            (AT_FEED_MM_PER_MIN.name, Value::Number(self.at_feed_mm_per_min)),
        ]
    }
}

impl PhysicalLaw for FeedDependentBacklash {
    fn target(&self) -> Target {
        Target::Axis
    }

    fn inputs(&self, _: &[f64]) -> Vec<LawInput<'_>> {
        vec![LawInput::Feed, LawInput::OwnDirection]
    }

    fn add_unit_effects(&self, _: &[f64], x: &[f64], add: &mut impl FnMut(usize, f64)) {
        if is_negative_direction(x[1]) {
            let feed = if x[0].is_finite() { x[0] } else { self.at_feed_mm_per_min };
            let (low, high, share) = self.bracketing_feed_indices(feed);
            add(low, 1.0 - share);
            add(high, share);
        }
    }
}

impl BoardRepresentation for FeedDependentBacklash {
    fn board_terms(&self) -> Vec<BoardTerm> {
        vec![BoardTerm::Reversed { width_um: self.corrected_width_um(), um_per_m: 0.0 }]
    }
}

impl Candidate for FeedDependentBacklash {
    fn fit_spec(&self) -> FitSpec {
        FitSpec { amplitudes: self.feeds_mm_per_min.len(), ..FitSpec::DEFAULT }
    }

    fn values(&self) -> Vec<f64> {
        self.width_um.clone()
    }

    fn set_values(&mut self, values: &[f64]) {
        self.width_um = values.to_vec();
    }

    fn propose(survey: &dyn DataView, with: &mut dyn FnMut(Self, StartValues)) {
        // It has room for a backlash, so that the two are never both there.
        let is_open =
            survey.has_own_axis_moved() && survey.is_bidirectional() && survey.has_screw_feedback();
        if !is_open
            || survey.has_added_cause(super::Backlash::NAME)
            || survey.has_added_cause(Self::NAME)
        {
            return;
        }
        let feeds = survey.column(FEED_COLUMN).map(find_feeds).unwrap_or_default();
        if feeds.len() >= 2 {
            with(Self::neutral(feeds), StartValues::linear_only());
        }
    }
}

impl Explanation for FeedDependentBacklash {
    fn describe(&self, values: &[f64]) -> String {
        let mut found = self.clone();
        found.set_values(values);
        let at = found.at_feed_mm_per_min;
        let corrected_um = found.corrected_width_um();
        let pairs = || found.feeds_mm_per_min.iter().zip(values);
        let each: Vec<String> =
            pairs().map(|(feed, um)| format!("{um:+.2} µm at {feed:.0} mm/min")).collect();
        let cost: Vec<String> = pairs()
            .filter(|(feed, _)| **feed != at)
            .map(|(feed, um)| format!("{:+.2} µm at {feed:.0} mm/min", um - corrected_um))
            .collect();
        format!(
            "Backlash depends on the feed: {}. The bridge does not receive the feed and corrects \
             {corrected_um:+.2} µm, that of {at:.0} mm/min (at_feed_mm_per_min): {} stay.",
            each.join(", "),
            cost.join(", ")
        )
    }

    fn next_test(&self) -> &'static str {
        "Approach one position seven times from each side at each of two feeds, by turns, and write the \
         feed into feed_mm_per_min."
    }

    fn distinguishing_test(alternative: &str) -> Option<&'static str> {
        (alternative == super::Backlash::NAME).then_some(
            "Approach one position seven times from each side at a slow and at a fast feed, by turns.",
        )
    }

    fn parameters(&self, values: &[f64]) -> Vec<FindingParameter> {
        let mut found = self.clone();
        found.set_values(values);
        let record = found.entries().into_iter().map(|(key, value)| (key, Some(value)));
        vec![FindingParameter::Record("width_um", record.collect())]
    }
}

/// Returns the feeds of a run in mm/min, rising: each that was set, or some of a feed that varies.
fn find_feeds(column: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<f64> = column.iter().copied().filter(|feed| *feed > 0.0).collect();
    sorted.retain(|feed| feed.is_finite());
    sorted.sort_by(f64::total_cmp);
    let mut set: Vec<f64> = Vec::new();
    for &feed in &sorted {
        if set.last().is_none_or(|last| feed / last - 1.0 > RELATIVE_FEED_TOLERANCE) {
            set.push(feed);
        }
    }
    if set.len() <= MAX_FEEDS {
        return set;
    }
    let at = |n: usize| sorted[n * (sorted.len() - 1) / (MAX_FEEDS - 1)];
    let mut some: Vec<f64> = (0..MAX_FEEDS).map(at).collect();
    some.dedup_by(|b, a| *b / *a - 1.0 <= RELATIVE_FEED_TOLERANCE);
    some
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_feed_that_was_set_is_one_and_a_feed_that_varies_is_followed_at_some() {
        assert_eq!(find_feeds(&[1000.0, f64::NAN, 100.0, 1002.0, 0.0, 100.0]), [100.0, 1000.0]);
        let varying: Vec<f64> = (0..100).map(|n| 100.0 + 10.0 * f64::from(n)).collect();
        assert_eq!(find_feeds(&varying).len(), MAX_FEEDS);
    }

    #[test]
    fn a_width_between_two_feeds_is_between_their_widths_and_outside_it_is_held() {
        let page = FeedDependentBacklash {
            feeds_mm_per_min: vec![100.0, 1100.0],
            width_um: vec![6.0, 11.0],
            at_feed_mm_per_min: 100.0,
        };
        let um = |feed: f64, direction: f64| {
            let mut um = 0.0;
            let mut add = |number: usize, share: f64| um += page.width_um[number] * share;
            page.add_unit_effects(&[], &[feed, direction], &mut add);
            um
        };
        assert_eq!([um(100.0, -1.0), um(600.0, -1.0), um(1100.0, -1.0)], [6.0, 8.5, 11.0]);
        assert_eq!([um(10.0, -1.0), um(9000.0, -1.0), um(600.0, 1.0)], [6.0, 11.0, 0.0]);
        // A run that does not say its feed is taken at the feed that is corrected, as the board does.
        assert_eq!(um(f64::NAN, -1.0), 6.0);
        assert_eq!(page.board_terms(), [BoardTerm::Reversed { width_um: 6.0, um_per_m: 0.0 }]);
        let description = page.describe(&page.width_um);
        assert!(description.contains("corrects +6.00 µm, that of 100 mm/min"), "{description}");
        assert!(description.contains("+5.00 µm at 1100 mm/min stay"), "{description}");
    }
}
