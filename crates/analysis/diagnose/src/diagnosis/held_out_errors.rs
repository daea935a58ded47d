//! The promise of a reading on another day like these, and a floor of the gain there.
//!
//! Nothing of it is a residual of the fit: each part of the record (a file, a run, a sixth of one) is predicted by a fit
//! to the others. With the mean
//! squares Aₚ (with the extended file) and Bₚ (with the current one) of k parts:
//!
//! ```text
//! ρ  = ΣA/ΣB                           reduction = 1 − √ρ
//! s² = Σ(Aₚ − ρ·Bₚ)²/(k − 1)           the ratio estimator (Cochran, Sampling Techniques, 1977, 6.3)
//! ρ₉₅ = ρ + t₉₅(k−1)·(s/B̄)·√(1/k + 1)  a new day differs as a part does
//! floor = 1 − √ρ₉₅
//! ```
//!
//! A machine also changes with the days, which parts in the middle do not show: what is expected is the median of ρ and
//! of what a fit to the first half, and to the first two thirds, predicted of the rest, where the inputs of the rest lie
//! within theirs; never less than ρ with a zero that goes on as it went from part to part. From the largest of the three on
//! a new day may leave more of what is corrected, as [`FoldVarianceComponents::new_day_factor`] says: its zero is its own,
//! its readings are few, or alike. The floor allows for this as well, and for the worst two parts.
//!
//! All are about the file's own zero; `zero_again` takes the mean of the first three readings of a part off both.

use std::collections::BTreeMap;

use trueup_numerics::{robust::median, t_quantile};

use crate::{
    columns::{PREDICTED_ELONGATION_COLUMN, column_by_name},
    data::{DataTable, forward_fill},
    diagnosis::{
        report::{ErrorReduction, HeldOutErrors},
        value_range::min_max,
        variance_components::FoldVarianceComponents,
    },
    fit::{CONFIDENCE_LEVEL, FitProblem, fit},
    folds::Folds,
    model::Model,
    predict::{HeldOutResiduals, forecast_origins},
    term_kind::ModelPart,
};

/// A column leaves what the runs covered where it is beyond their ends by more than a tenth of their
/// range: so far a straight line that was fitted to it may be continued with a standard error that grows
/// by no more than a sixth (its variance is 4σ²/n at the end of n equal steps, 5.3σ²/n a tenth beyond).
pub(super) const EXTRAPOLATION_MARGIN_FRACTION: f64 = 0.1;
/// Readings from which a day's zero is set.
const ZEROING_READING_COUNT: usize = 3;

/// A record that was predicted part by part.
pub(super) struct CrossValidatedRecord<'p> {
    pub problem: &'p FitProblem,
    pub folds: &'p Folds,
    /// The terms of the board, as they are fitted.
    pub model: &'p Model,
    /// Residuals of parts that took no part in the choice of the terms; none: the values alone are fitted again.
    pub foreseen: Option<&'p HeldOutResiduals>,
    /// Mean square that the groups of the problem average away, in µm².
    pub within: f64,
}

impl CrossValidatedRecord<'_> {
    /// Returns what is promised of a reading.
    pub(super) fn held_out_errors(&self) -> HeldOutErrors {
        HeldOutErrors {
            figures: self.error_reduction(false, 0.0),
            zero_again: self.error_reduction(true, 0.0),
            ranges: input_ranges(&self.problem.data),
        }
    }

    /// Returns what is promised at the tool, where the noise of the gauge, `noise_um`, does not count.
    pub(super) fn error_reduction_at_tool(&self, noise_um: f64) -> ErrorReduction {
        self.error_reduction(false, noise_um * noise_um)
    }

    /// With the zero set `again` on each part or not; without `noise`, a mean square in µm² that before and after hold.
    fn error_reduction(&self, again: bool, noise: f64) -> ErrorReduction {
        let parts = self.folds.block_index_by_group();
        let before = self.problem.residual(&Model::default());
        let after = match self.foreseen {
            Some(foreseen) => foreseen.left.clone(),
            None => {
                self.folds.signed_fold_residuals(self.problem, self.model, without_feed_dependence)
            }
        };
        let within = if again {
            (1.0 + 1.0 / ZEROING_READING_COUNT as f64) * self.within
        } else {
            self.within
        };
        let sums = |um: [Vec<f64>; 2], parts: &[usize]| {
            let um = if again { um.map(|um| rezero_parts(um, parts)) } else { um };
            FoldMeanSquares::new([&um[0], &um[1]], parts, within)
        };
        let later: Vec<f64> = self
            .forecast_residuals()
            .iter()
            .filter_map(|(first, after)| {
                let one = vec![0; after.len()];
                sums([before[*first..].to_vec(), after.clone()], &one).mean_square_ratio(noise)
            })
            .collect();
        sums([before, after], &parts).error_reduction(noise, &later)
    }

    /// Returns the residuals that fits to the beginning leave of the rest: from which group on, and in each.
    fn forecast_residuals(&self) -> Vec<(usize, Vec<f64>)> {
        if self.model.parts.is_empty() {
            return Vec::new();
        }
        if let Some(foreseen) = self.foreseen {
            let later = foreseen.later.iter().filter(|(first, _)| self.has_inputs_in_range(*first));
            return later.cloned().collect();
        }
        let groups = self.problem.groups.len();
        let splits = forecast_origins(groups).into_iter();
        let splits = splits.filter(|first| *first > 0 && self.has_inputs_in_range(*first));
        splits
            .map(|first| {
                let mask: Vec<bool> = (0..groups).map(|group| group < first).collect();
                let fitted = fit(self.problem, self.model, Some(&mask));
                let left = self.problem.residual(&without_feed_dependence(&fitted.model));
                (first, left[first..].to_vec())
            })
            .collect()
    }

    /// Returns whether the inputs from a group on lie within those of the groups before.
    fn has_inputs_in_range(&self, first: usize) -> bool {
        input_columns(&self.problem.data).chain([PREDICTED_ELONGATION_COLUMN.into()]).all(|name| {
            column_by_name(&self.problem.data, &name).is_none_or(|values| {
                let values = self.problem.groups.means(&forward_fill(values));
                let [of, rest] = [&values[..first], &values[first..]];
                let [[low, high], [least, most]] =
                    [of, rest].map(|values| min_max(values.iter().copied()));
                let margin = EXTRAPOLATION_MARGIN_FRACTION * (high - low);
                least >= low - margin && most <= high + margin
            })
        })
    }
}

/// Returns `model` for a prediction without a feed.
fn without_feed_dependence(model: &Model) -> Model {
    let mut run = model.clone();
    run.parts.iter_mut().for_each(ModelPart::remove_feed_dependence);
    run
}

/// The mean squares of the parts, in µm², each as a part of mean size: with the current file, and extended.
struct FoldMeanSquares {
    before: Vec<f64>,
    after: Vec<f64>,
    /// The rest of a new day.
    left: FoldVarianceComponents,
}

impl FoldMeanSquares {
    fn new(um: [&[f64]; 2], parts: &[usize], within: f64) -> Self {
        let count = parts.iter().max().map_or(0, |last| last + 1);
        let scale = count as f64 / parts.len().max(1) as f64;
        let um_left = um[1];
        let [before, after] = um.map(|um| {
            let mut sums = vec![0.0; count];
            for (um, &part) in um.iter().zip(parts) {
                sums[part] += scale * (um * um + within);
            }
            sums
        });
        let left = FoldVarianceComponents::new(um_left, parts, within);
        Self { before, after, left }
    }

    /// Returns the mean squares, without `noise` (of a mean square in µm² that both hold).
    fn noise_corrected_mean_squares(&self, noise: f64) -> [f64; 2] {
        let count = self.before.len() as f64;
        [&self.before, &self.after]
            .map(|of| (of.iter().sum::<f64>() / count.max(1.0) - noise).max(0.0))
    }

    /// ρ; none where there is nothing before.
    fn mean_square_ratio(&self, noise: f64) -> Option<f64> {
        let [before, after] = self.noise_corrected_mean_squares(noise);
        (before > 0.0).then(|| after / before)
    }

    /// Returns the largest ρ of two parts.
    fn max_pair_ratio(&self, noise: f64) -> f64 {
        let parts = self.before.iter().zip(&self.after).enumerate();
        let pairs = parts.flat_map(|(n, one)| {
            self.before.iter().zip(&self.after).skip(n + 1).map(move |other| [one, other])
        });
        let ratio = pairs.map(|[(b1, a1), (b2, a2)]| {
            ((a1 + a2) / 2.0 - noise).max(0.0) / ((b1 + b2) / 2.0 - noise).max(0.0)
        });
        ratio.filter(|ratio| ratio.is_finite()).fold(0.0, f64::max)
    }

    /// `forecast_residuals`: ρ of the rests that were predicted from the beginning.
    fn error_reduction(&self, noise: f64, later: &[f64]) -> ErrorReduction {
        let count = self.before.len() as f64;
        let Some(ratio) = self.mean_square_ratio(noise) else { return ErrorReduction::default() };
        let [before, _] = self.noise_corrected_mean_squares(noise);
        // No more than the parts gave, however well the rests were predicted; and the zero goes on.
        let next = new_day_ratio(ratio, self.left.expected_new_day_factor(noise));
        let expected = median(&mut [&[ratio], later].concat()).max(next);
        let off = self.before.iter().zip(&self.after).map(|(b, a)| {
            let [b, a] = [b - noise, a - noise];
            (a - ratio * b).powi(2)
        });
        let scatter = (off.sum::<f64>() / (count - 1.0)).sqrt();
        let new_day = (1.0 / count + 1.0).sqrt();
        let highest =
            ratio + t_quantile(CONFIDENCE_LEVEL, count - 1.0) * scatter / before * new_day;
        let worst = later.iter().copied().fold(ratio, f64::max);
        let another = new_day_ratio(worst, self.left.new_day_factor(CONFIDENCE_LEVEL, noise));
        let highest = highest.max(self.max_pair_ratio(noise)).max(another);
        // Of one part nothing is known.
        let floor = if count > 1.0 && highest.is_finite() { 1.0 - highest.sqrt() } else { -1.0 };
        ErrorReduction {
            before_um: before.sqrt(),
            after_um: (expected * before).sqrt(),
            reduction: 1.0 - expected.sqrt(),
            reduction_floor95: floor.max(-1.0),
        }
    }
}

/// Returns the ratio of what is left to what was there on a day that leaves `times` as much of what is corrected as one
/// with this `ratio`.
fn new_day_ratio(ratio: f64, times: f64) -> f64 {
    if ratio >= 1.0 {
        return ratio;
    }
    // The odds of what is left to what is corrected.
    let odds = times * ratio / (1.0 - ratio);
    if odds.is_finite() { odds / (1.0 + odds) } else { 1.0 }
}

/// `um` less the mean of the first readings of each part.
fn rezero_parts(mut um: Vec<f64>, parts: &[usize]) -> Vec<f64> {
    let mut first = 0;
    while first < um.len() {
        let length = parts[first..].iter().take_while(|part| **part == parts[first]).count();
        let day = &mut um[first..first + length];
        let readings = day.len().min(ZEROING_READING_COUNT);
        let zero = day[..readings].iter().sum::<f64>() / readings as f64;
        day.iter_mut().for_each(|um| *um -= zero);
        first += length;
    }
    um
}

/// Returns the range of each recorded input.
pub(super) fn input_ranges(data: &DataTable) -> BTreeMap<String, [f64; 2]> {
    input_columns(data)
        .filter_map(|name| {
            let values = column_by_name(data, &name)?;
            let range = min_max(values.iter().copied());
            (range[0] <= range[1]).then_some((name, range))
        })
        .collect()
}

/// Everything that was recorded and is a state of the machine.
pub(super) fn input_columns(data: &DataTable) -> impl Iterator<Item = String> + '_ {
    let known = ["spindle_rpm", "load_n", "x_mm", "y_mm", "z_mm"].map(String::from);
    let temperatures = data.temperatures().iter().map(|(name, _)| name.clone());
    let others = data.unknown_columns().iter().map(|(name, _)| name.clone());
    known.into_iter().chain(temperatures).chain(others)
}

/// Largest number of values of a column that is a category.
const MAX_CATEGORIES: usize = 12;

/// Returns the categories of a hold-out that the runs did not have, a sentence each.
pub(super) fn describe_unseen_categories(runs: &DataTable, here: &DataTable) -> Vec<String> {
    let sentence = |name: &String, values: &[f64]| {
        let seen = find_categories(values)?;
        let there = find_categories(&forward_fill(column_by_name(here, name)?))?;
        let unseen: Vec<f64> = there.into_iter().filter(|value| !seen.contains(value)).collect();
        let is_whole = seen.iter().chain(&unseen).all(|value| value.fract() == 0.0);
        (is_whole && !unseen.is_empty()).then(|| {
            format!(
                "{name} is {} in the hold-out; in the runs it was {}",
                join_with_or(&unseen),
                join_with_or(&seen)
            )
        })
    };
    runs.unknown_columns().iter().filter_map(|(name, values)| sentence(name, values)).collect()
}

fn find_categories(values: &[f64]) -> Option<Vec<f64>> {
    let mut found: Vec<f64> = Vec::new();
    for value in values.iter().filter(|value| value.is_finite()) {
        if !found.contains(value) {
            found.push(*value);
        }
        if found.len() > MAX_CATEGORIES {
            return None;
        }
    }
    found.sort_by(f64::total_cmp);
    Some(found)
}

fn join_with_or(values: &[f64]) -> String {
    values.iter().map(ToString::to_string).collect::<Vec<_>>().join(" or ")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parts of these mean squares, which leave a new day as much as themselves.
    fn still(before: &[f64], after: &[f64]) -> FoldMeanSquares {
        let left = FoldVarianceComponents::new(&[0.0; 10], &[0; 10], 0.0);
        FoldMeanSquares { before: before.to_vec(), after: after.to_vec(), left }
    }

    /// By hand: A = 1, 3, B = 8, 8 in µm²; ρ = ¼, s² = 2, t₉₅(1) = 6.314, √(1/2 + 1), so that ρ₉₅ = 0.25 +
    /// 6.314·√2/8·√1.5 = 1.617.
    #[test]
    fn a_floor_of_two_parts_is_that_of_the_hand() {
        let sums = still(&[8.0, 8.0], &[1.0, 3.0]);
        let figures = sums.error_reduction(0.0, &[]);
        assert!((figures.before_um - 8.0_f64.sqrt()).abs() < 1e-12);
        assert!((figures.after_um - 2.0_f64.sqrt()).abs() < 1e-12);
        assert!((figures.reduction - 0.5).abs() < 1e-12, "{figures:?}");
        let highest = 0.25 + 6.3138 * 2.0_f64.sqrt() / 8.0 * 1.5_f64.sqrt();
        let floor = 1.0 - highest.sqrt();
        assert!((figures.reduction_floor95 - floor).abs() < 1e-3, "{figures:?}");
        // Without 1 µm² of noise in both: A = 0, 2, B = 7, 7.
        let at_tool = sums.error_reduction(1.0, &[]);
        assert!((at_tool.reduction - (1.0 - (1.0_f64 / 7.0).sqrt())).abs() < 1e-12, "{at_tool:?}");
    }

    /// Zeros of +1 and −1 µm, of which nothing is noise: a new day leaves F₉₅(1, 1)·1.25 = 161.4·1.25 times as much, of
    /// odds of 1/99, thus ρ = 2.038/3.038.
    #[test]
    fn a_zero_that_shifts_from_part_to_part_lowers_the_floor() {
        let left = FoldVarianceComponents::new(&[1.0, -1.0], &[0, 1], 0.0);
        let sums = FoldMeanSquares { left, ..still(&[100.0; 2], &[1.0; 2]) };
        let figures = sums.error_reduction(0.0, &[]);
        let reduction = |odds: f64| 1.0 - (odds / (1.0 + odds)).sqrt();
        let floor = figures.reduction_floor95;
        assert!((floor - reduction(161.448 * 1.25 / 99.0)).abs() < 1e-3, "{floor}");
        assert!((figures.reduction - reduction(1.25 / 99.0)).abs() < 1e-9, "{figures:?}");
    }

    /// ρ = ¼ of the parts, ½ and 0.81 of the rests: the median is ½, and no floor is above what the worst rest gave.
    #[test]
    fn what_the_beginning_foresaw_of_the_rest_bounds_the_promise() {
        let sums = still(&[4.0; 3], &[1.0; 3]);
        let figures = sums.error_reduction(0.0, &[0.5, 0.81]);
        assert!((figures.reduction - (1.0 - 0.5_f64.sqrt())).abs() < 1e-12, "{figures:?}");
        assert!((figures.after_um - 2.0_f64.sqrt()).abs() < 1e-12, "{figures:?}");
        assert!((figures.reduction_floor95 - 0.1).abs() < 1e-12, "{figures:?}");
        // Rests that were predicted better than the parts promise no more.
        let better = sums.error_reduction(0.0, &[0.1, 0.2]);
        assert!((better.reduction - 0.5).abs() < 1e-12, "{better:?}");
    }

    /// ρ = ¼ is odds of ⅓ of what is left to what is corrected; of twice as much ⅔, ρ = 0.4.
    #[test]
    fn what_is_left_alike_in_all_parts_is_promised() {
        let alike = still(&[4.0, 9.0, 16.0], &[1.0, 2.25, 4.0]);
        let figures = alike.error_reduction(0.0, &[]);
        assert!((figures.reduction_floor95 - 0.5).abs() < 1e-9, "{figures:?}");
        assert!((new_day_ratio(0.25, 2.0) - 0.4).abs() < 1e-12);
        assert_eq!(new_day_ratio(0.25, f64::INFINITY), 1.0);
        assert_eq!(still(&[4.0], &[0.0]).error_reduction(0.0, &[]).reduction_floor95, -1.0);
    }

    #[test]
    fn a_zero_that_is_set_again_is_the_mean_of_three_readings_of_each_part() {
        let um = rezero_parts(vec![1.0, 2.0, 3.0, 7.0, 10.0, 10.0], &[0, 0, 0, 0, 1, 1]);
        assert_eq!(um, [-1.0, 0.0, 1.0, 5.0, 0.0, 0.0]);
    }
}
