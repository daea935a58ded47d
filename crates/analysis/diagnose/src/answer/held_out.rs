//! The promise of a reading on another day like these, and a floor of the gain there.
//!
//! Nothing of it is a residual of the fit: each part of the record (a file, a run, a sixth of one) is foreseen by a fit
//! to the others. With the mean
//! squares Aₚ (with the extended file) and Bₚ (as it is) of k parts:
//!
//! ```text
//! ρ  = ΣA/ΣB                           reduction = 1 − √ρ
//! s² = Σ(Aₚ − ρ·Bₚ)²/(k − 1)           the ratio estimator (Cochran, Sampling Techniques, 1977, 6.3)
//! ρ₉₅ = ρ + t₉₅(k−1)·(s/B̄)·√(1/k + 1)  a new day differs as a part does
//! floor = 1 − √ρ₉₅
//! ```
//!
//! A machine also changes with the days, which parts in the middle do not show: what is expected is the median of ρ and
//! of what a fit to the first half, and to the first two thirds, foresaw of the rest, where the inputs of the rest lie
//! within theirs. From the largest of the three on a new day may leave more of what is corrected, as
//! [`crate::answer::new_day`] says: its zero is its own, its readings are few, or alike. The floor allows for this as
//! well, and for the worst two parts.
//!
//! All are about the file's own zero; `zero_again` takes the mean of the first three readings of a part off both.

use std::collections::BTreeMap;

use trueup_numerics::{robust::median, t_quantile};

use crate::{
    answer::{
        new_day::LeftOfParts,
        range::extent,
        report::{Figures, HeldOut},
    },
    blocks::Folds,
    columns::{SAID, named},
    data::{Data, filled},
    fit::{LEVEL, Problem, fit},
    kind::Part,
    model::Model,
    predict::{Predicted, later_from},
};

/// A column leaves what the runs covered where it is beyond their ends by more than a tenth of their
/// range: so far a straight line that was fitted to it may be continued with a standard error that grows
/// by no more than a sixth (its variance is 4σ²/n at the end of n equal steps, 5.3σ²/n a tenth beyond).
pub(super) const BEYOND: f64 = 0.1;
/// Readings from which a day's zero is set.
const ZERO_READINGS: usize = 3;

/// A record that was foreseen part by part.
pub(super) struct LeftOutParts<'p> {
    pub problem: &'p Problem,
    pub folds: &'p Folds,
    /// The terms of the board, as they are fitted.
    pub model: &'p Model,
    /// Residuals of parts that took no part in the choice of the terms; none: the values alone are fitted again.
    pub foreseen: Option<&'p Predicted>,
    /// Mean square that the groups of the problem average away, in µm².
    pub within: f64,
}

impl LeftOutParts<'_> {
    /// Returns what is promised of a reading.
    pub(super) fn held_out(&self) -> HeldOut {
        HeldOut {
            figures: self.figures(false, 0.0),
            zero_again: self.figures(true, 0.0),
            ranges: ranges(&self.problem.data),
        }
    }

    /// Returns what is promised at the tool, where the noise of the gauge, `noise_um`, does not count.
    pub(super) fn at_tool(&self, noise_um: f64) -> Figures {
        self.figures(false, noise_um * noise_um)
    }

    /// With the zero set `again` on each part or not; without `noise`, a mean square in µm² that before and after hold.
    fn figures(&self, again: bool, noise: f64) -> Figures {
        let parts = self.folds.parts();
        let before = self.problem.residual(&Model::default());
        let after = match self.foreseen {
            Some(foreseen) => foreseen.left.clone(),
            None => self.folds.left_out_signed(self.problem, self.model, as_run),
        };
        let within =
            if again { (1.0 + 1.0 / ZERO_READINGS as f64) * self.within } else { self.within };
        let sums = |um: [Vec<f64>; 2], parts: &[usize]| {
            let um = if again { um.map(|um| with_zero_again(um, parts)) } else { um };
            Sums::of([&um[0], &um[1]], parts, within)
        };
        let later: Vec<f64> = self
            .later()
            .iter()
            .filter_map(|(first, after)| {
                let one = vec![0; after.len()];
                sums([before[*first..].to_vec(), after.clone()], &one).ratio(noise)
            })
            .collect();
        sums([before, after], &parts).figures(noise, &later)
    }

    /// Returns the residuals that fits to the beginning leave of the rest: from which group on, and in each.
    fn later(&self) -> Vec<(usize, Vec<f64>)> {
        if self.model.parts.is_empty() {
            return Vec::new();
        }
        if let Some(foreseen) = self.foreseen {
            let later = foreseen.later.iter().filter(|(first, _)| self.is_within(*first));
            return later.cloned().collect();
        }
        let groups = self.problem.groups.len();
        let splits = later_from(groups).into_iter();
        let splits = splits.filter(|first| *first > 0 && self.is_within(*first));
        splits
            .map(|first| {
                let mask: Vec<bool> = (0..groups).map(|group| group < first).collect();
                let fitted = fit(self.problem, self.model, Some(&mask));
                let left = self.problem.residual(&as_run(&fitted.model));
                (first, left[first..].to_vec())
            })
            .collect()
    }

    /// Returns whether the inputs from a group on lie within those of the groups before.
    fn is_within(&self, first: usize) -> bool {
        inputs(&self.problem.data).chain([SAID.into()]).all(|name| {
            named(&self.problem.data, &name).is_none_or(|values| {
                let values = self.problem.groups.means(&filled(values));
                let [of, rest] = [&values[..first], &values[first..]];
                let [[low, high], [least, most]] = [of, rest].map(|it| extent(it.iter().copied()));
                let margin = BEYOND * (high - low);
                least >= low - margin && most <= high + margin
            })
        })
    }
}

/// Returns `model` as it is predicted without a feed.
fn as_run(model: &Model) -> Model {
    let mut run = model.clone();
    run.parts.iter_mut().for_each(Part::forget_feed);
    run
}

/// The mean squares of the parts, in µm², each as a part of mean size: with the file as it is, and extended.
struct Sums {
    before: Vec<f64>,
    after: Vec<f64>,
    /// The rest of a new day.
    left: LeftOfParts,
}

impl Sums {
    fn of(um: [&[f64]; 2], parts: &[usize], within: f64) -> Self {
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
        let left = LeftOfParts::new(um_left, parts, within);
        Self { before, after, left }
    }

    /// Returns the mean squares, without `noise` (of a mean square in µm² that both hold).
    fn means(&self, noise: f64) -> [f64; 2] {
        let count = self.before.len() as f64;
        [&self.before, &self.after]
            .map(|of| (of.iter().sum::<f64>() / count.max(1.0) - noise).max(0.0))
    }

    /// ρ; none where there is nothing before.
    fn ratio(&self, noise: f64) -> Option<f64> {
        let [before, after] = self.means(noise);
        (before > 0.0).then(|| after / before)
    }

    /// Returns the largest ρ of two parts.
    fn worst_pair(&self, noise: f64) -> f64 {
        let parts = self.before.iter().zip(&self.after).enumerate();
        let pairs = parts.flat_map(|(n, one)| {
            self.before.iter().zip(&self.after).skip(n + 1).map(move |other| [one, other])
        });
        let ratio = pairs.map(|[(b1, a1), (b2, a2)]| {
            ((a1 + a2) / 2.0 - noise).max(0.0) / ((b1 + b2) / 2.0 - noise).max(0.0)
        });
        ratio.filter(|ratio| ratio.is_finite()).fold(0.0, f64::max)
    }

    /// `later`: ρ of the rests that were foreseen from the beginning.
    fn figures(&self, noise: f64, later: &[f64]) -> Figures {
        let count = self.before.len() as f64;
        let Some(ratio) = self.ratio(noise) else { return Figures::default() };
        let [before, _] = self.means(noise);
        let expected = median(&mut [&[ratio], later].concat());
        let off = self.before.iter().zip(&self.after).map(|(b, a)| {
            let [b, a] = [b - noise, a - noise];
            (a - ratio * b).powi(2)
        });
        let scatter = (off.sum::<f64>() / (count - 1.0)).sqrt();
        let new_day = (1.0 / count + 1.0).sqrt();
        let highest = ratio + t_quantile(LEVEL, count - 1.0) * scatter / before * new_day;
        let worst = later.iter().copied().fold(ratio, f64::max);
        let another = of_new_day(worst, self.left.times_on_new_day(LEVEL, noise));
        let highest = highest.max(self.worst_pair(noise)).max(another);
        // Of one part nothing is known.
        let floor = if count > 1.0 && highest.is_finite() { 1.0 - highest.sqrt() } else { -1.0 };
        Figures {
            before_um: before.sqrt(),
            after_um: (expected * before).sqrt(),
            reduction: 1.0 - expected.sqrt(),
            reduction_floor95: floor.max(-1.0),
        }
    }
}

/// Returns the ratio of what is left to what was there on a day that leaves `times` as much of what is corrected as one
/// with this `ratio`.
fn of_new_day(ratio: f64, times: f64) -> f64 {
    if ratio >= 1.0 {
        return ratio;
    }
    // The odds of what is left to what is corrected.
    let odds = times * ratio / (1.0 - ratio);
    if odds.is_finite() { odds / (1.0 + odds) } else { 1.0 }
}

/// `um` less the mean of the first readings of each part.
fn with_zero_again(mut um: Vec<f64>, parts: &[usize]) -> Vec<f64> {
    let mut first = 0;
    while first < um.len() {
        let length = parts[first..].iter().take_while(|part| **part == parts[first]).count();
        let day = &mut um[first..first + length];
        let readings = day.len().min(ZERO_READINGS);
        let zero = day[..readings].iter().sum::<f64>() / readings as f64;
        day.iter_mut().for_each(|um| *um -= zero);
        first += length;
    }
    um
}

/// Returns the range of each recorded input.
pub(super) fn ranges(data: &Data) -> BTreeMap<String, [f64; 2]> {
    inputs(data)
        .filter_map(|name| {
            let values = named(data, &name)?;
            let range = extent(values.iter().copied());
            (range[0] <= range[1]).then_some((name, range))
        })
        .collect()
}

/// Everything that was recorded and is a state of the machine.
pub(super) fn inputs(data: &Data) -> impl Iterator<Item = String> + '_ {
    let known = ["spindle_rpm", "load_n", "x_mm", "y_mm", "z_mm"].map(String::from);
    let temperatures = data.temperatures.iter().map(|(name, _)| name.clone());
    let others = data.others.iter().map(|(name, _)| name.clone());
    known.into_iter().chain(temperatures).chain(others)
}

/// Largest number of values of a column that is a category.
const MAX_CATEGORIES: usize = 12;

/// Returns the categories of a hold-out that the runs did not have, a sentence each.
pub(super) fn unseen_categories(runs: &Data, here: &Data) -> Vec<String> {
    let sentence = |name: &String, values: &[f64]| {
        let seen = categories(values)?;
        let there = categories(&filled(named(here, name)?))?;
        let unseen: Vec<f64> = there.into_iter().filter(|it| !seen.contains(it)).collect();
        let is_whole = seen.iter().chain(&unseen).all(|it| it.fract() == 0.0);
        (is_whole && !unseen.is_empty()).then(|| {
            format!("{name} is {} in the hold-out; in the runs it was {}", or(&unseen), or(&seen))
        })
    };
    runs.others.iter().filter_map(|(name, values)| sentence(name, values)).collect()
}

fn categories(values: &[f64]) -> Option<Vec<f64>> {
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

fn or(values: &[f64]) -> String {
    values.iter().map(ToString::to_string).collect::<Vec<_>>().join(" or ")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parts of these mean squares, which leave a new day as much as themselves.
    fn still(before: &[f64], after: &[f64]) -> Sums {
        let left = LeftOfParts::new(&[0.0; 10], &[0; 10], 0.0);
        Sums { before: before.to_vec(), after: after.to_vec(), left }
    }

    /// By hand: A = 1, 3, B = 8, 8 in µm²; ρ = ¼, s² = 2, t₉₅(1) = 6.314, √(1/2 + 1), so that ρ₉₅ = 0.25 +
    /// 6.314·√2/8·√1.5 = 1.617.
    #[test]
    fn a_floor_of_two_parts_is_that_of_the_hand() {
        let sums = still(&[8.0, 8.0], &[1.0, 3.0]);
        let figures = sums.figures(0.0, &[]);
        assert!((figures.before_um - 8.0_f64.sqrt()).abs() < 1e-12);
        assert!((figures.after_um - 2.0_f64.sqrt()).abs() < 1e-12);
        assert!((figures.reduction - 0.5).abs() < 1e-12, "{figures:?}");
        let highest = 0.25 + 6.3138 * 2.0_f64.sqrt() / 8.0 * 1.5_f64.sqrt();
        let floor = 1.0 - highest.sqrt();
        assert!((figures.reduction_floor95 - floor).abs() < 1e-3, "{figures:?}");
        // Without 1 µm² of noise in both: A = 0, 2, B = 7, 7.
        let at_tool = sums.figures(1.0, &[]);
        assert!((at_tool.reduction - (1.0 - (1.0_f64 / 7.0).sqrt())).abs() < 1e-12, "{at_tool:?}");
    }

    /// Zeros of +1 and −1 µm, of which nothing is noise: a new day leaves F₉₅(1, 1)·1.25 = 161.4·1.25 times as much, of
    /// odds of 1/99, thus ρ = 2.038/3.038.
    #[test]
    fn a_zero_that_shifts_from_part_to_part_lowers_the_floor() {
        let left = LeftOfParts::new(&[1.0, -1.0], &[0, 1], 0.0);
        let sums = Sums { left, ..still(&[100.0; 2], &[1.0; 2]) };
        let floor = sums.figures(0.0, &[]).reduction_floor95;
        let odds: f64 = 161.448 * 1.25 / 99.0;
        assert!((floor - (1.0 - (odds / (1.0 + odds)).sqrt())).abs() < 1e-3, "{floor}");
    }

    /// ρ = ¼ of the parts, ½ and 0.81 of the rests: the median is ½, and no floor is above what the worst rest gave.
    #[test]
    fn what_the_beginning_foresaw_of_the_rest_bounds_the_promise() {
        let sums = still(&[4.0; 3], &[1.0; 3]);
        let figures = sums.figures(0.0, &[0.5, 0.81]);
        assert!((figures.reduction - (1.0 - 0.5_f64.sqrt())).abs() < 1e-12, "{figures:?}");
        assert!((figures.after_um - 2.0_f64.sqrt()).abs() < 1e-12, "{figures:?}");
        assert!((figures.reduction_floor95 - 0.1).abs() < 1e-12, "{figures:?}");
    }

    /// ρ = ¼ is odds of ⅓ of what is left to what is corrected; of twice as much ⅔, ρ = 0.4.
    #[test]
    fn what_is_left_alike_in_all_parts_is_promised() {
        let alike = still(&[4.0, 9.0, 16.0], &[1.0, 2.25, 4.0]);
        let figures = alike.figures(0.0, &[]);
        assert!((figures.reduction_floor95 - 0.5).abs() < 1e-9, "{figures:?}");
        assert!((of_new_day(0.25, 2.0) - 0.4).abs() < 1e-12);
        assert_eq!(of_new_day(0.25, f64::INFINITY), 1.0);
        assert_eq!(still(&[4.0], &[0.0]).figures(0.0, &[]).reduction_floor95, -1.0);
    }

    #[test]
    fn a_zero_that_is_set_again_is_the_mean_of_three_readings_of_each_part() {
        let um = with_zero_again(vec![1.0, 2.0, 3.0, 7.0, 10.0, 10.0], &[0, 0, 0, 0, 1, 1]);
        assert_eq!(um, [-1.0, 0.0, 1.0, 5.0, 0.0, 0.0]);
    }
}
