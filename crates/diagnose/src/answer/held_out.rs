//! What the gauge would read on another day like these, and a floor of what is gained there.
//!
//! Nothing of it is a residual of the fit: each part of the record is foreseen by a fit to the others. With the mean
//! squares Aₚ (with the extended file) and Bₚ (as it is) of k parts:
//!
//! ```text
//! ρ  = ΣA/ΣB                           reduction = 1 − √ρ
//! s² = Σ(Aₚ − ρ·Bₚ)²/(k − 1)           the ratio estimator (Cochran, Sampling Techniques, 1977, 6.3)
//! ρ₉₅ = ρ + t₉₅(k−1)·(s/B̄)·√(1/k + 1/m)  a new day of the size of m = k/3 parts
//! floor = 1 − √ρ₉₅
//! ```
//!
//! All are about the file's own zero; `zero_again` takes the mean of the first three readings of a part off both.

use std::collections::BTreeMap;

use trueup_numerics::t_quantile;

use crate::{
    answer::{
        range::extent,
        report::{Figures, HeldOut},
    },
    blocks::Folds,
    columns::named,
    data::{Data, filled},
    fit::Problem,
    model::Model,
};

/// One-sided: the share of days on which the floor is kept.
const KEPT: f64 = 0.95;
/// A new day is as long as this share of the record.
const NEW_DAY: f64 = 1.0 / 3.0;
/// Readings from which a day's zero is set.
const ZERO_READINGS: usize = 3;

/// What is known of a record that was foreseen part by part.
pub(super) struct LeftOutParts<'p> {
    pub problem: &'p Problem,
    pub folds: &'p Folds,
    /// As the board runs it.
    pub model: &'p Model,
    /// Mean square that the groups of the problem average away, in µm².
    pub within: f64,
}

impl LeftOutParts<'_> {
    /// Returns what is promised of a reading.
    pub(super) fn held_out(&self) -> HeldOut {
        let before = self.problem.residual(&Model::default());
        let after = self.folds.left_out_signed(self.problem, self.model);
        let parts = self.folds.parts();
        let own = Sums::of([&before, &after], &parts, self.within);
        let [before, after] = [before, after].map(|um| with_zero_again(um, &parts));
        let share = 1.0 + 1.0 / ZERO_READINGS as f64;
        let again = Sums::of([&before, &after], &parts, share * self.within);
        HeldOut {
            figures: own.figures(0.0),
            zero_again: again.figures(0.0),
            ranges: ranges(&self.problem.data),
        }
    }

    /// Returns what is promised at the tool, where the noise of the gauge, `noise_um`, does not count.
    pub(super) fn at_tool(&self, noise_um: f64) -> Figures {
        let before = self.problem.residual(&Model::default());
        let after = self.folds.left_out_signed(self.problem, self.model);
        let sums = Sums::of([&before, &after], &self.folds.parts(), self.within);
        sums.figures(noise_um * noise_um)
    }
}

/// The mean squares of the parts, in µm², each as a part of mean size: with the file as it is, and extended.
struct Sums {
    before: Vec<f64>,
    after: Vec<f64>,
}

impl Sums {
    fn of(um: [&[f64]; 2], parts: &[usize], within: f64) -> Self {
        let count = parts.iter().max().map_or(0, |last| last + 1);
        let scale = count as f64 / parts.len().max(1) as f64;
        let [before, after] = um.map(|um| {
            let mut sums = vec![0.0; count];
            for (um, &part) in um.iter().zip(parts) {
                sums[part] += scale * (um * um + within);
            }
            sums
        });
        Self { before, after }
    }

    /// Without `noise`, a mean square in µm² that both hold.
    fn figures(&self, noise: f64) -> Figures {
        let count = self.before.len() as f64;
        let mean = |of: &[f64]| (of.iter().sum::<f64>() / count.max(1.0) - noise).max(0.0);
        let [before, after] = [mean(&self.before), mean(&self.after)];
        if before <= 0.0 {
            return Figures::default();
        }
        let ratio = after / before;
        let off = self.before.iter().zip(&self.after).map(|(b, a)| {
            let [b, a] = [b - noise, a - noise];
            (a - ratio * b).powi(2)
        });
        let scatter = (off.sum::<f64>() / (count - 1.0)).sqrt();
        let new_day = (1.0 / count + 1.0 / (NEW_DAY * count)).sqrt();
        let highest = ratio + t_quantile(KEPT, count - 1.0) * scatter / before * new_day;
        // Of one part nothing is known.
        let floor = if highest.is_finite() { 1.0 - highest.sqrt() } else { -1.0 };
        Figures {
            before_um: before.sqrt(),
            after_um: after.sqrt(),
            reduction: 1.0 - ratio.sqrt(),
            reduction_floor95: floor.max(-1.0),
        }
    }
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

/// The range of each recorded input.
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

    /// By hand: A = 1, 3, B = 8, 8 in µm²; ρ = ¼, s² = 2, t₉₅(1) = 6.314, √(1/2 + 3/2) = √2, so that ρ₉₅ = 0.25 +
    /// 6.314·√2/8·√2 = 1.828.
    #[test]
    fn a_floor_of_two_parts_is_that_of_the_hand() {
        let sums = Sums { before: vec![8.0, 8.0], after: vec![1.0, 3.0] };
        let figures = sums.figures(0.0);
        assert!((figures.before_um - 8.0_f64.sqrt()).abs() < 1e-12);
        assert!((figures.after_um - 2.0_f64.sqrt()).abs() < 1e-12);
        assert!((figures.reduction - 0.5).abs() < 1e-12, "{figures:?}");
        assert!(
            (figures.reduction_floor95 - (1.0 - 1.828_4_f64.sqrt())).abs() < 1e-3,
            "{figures:?}"
        );
        // Without 1 µm² of noise in both: A = 0, 2, B = 7, 7.
        let at_tool = sums.figures(1.0);
        assert!((at_tool.reduction - (1.0 - (1.0_f64 / 7.0).sqrt())).abs() < 1e-12, "{at_tool:?}");
    }

    #[test]
    fn what_is_left_alike_in_all_parts_is_promised_whole_and_one_part_promises_nothing() {
        let alike = Sums { before: vec![4.0, 9.0, 16.0], after: vec![1.0, 2.25, 4.0] };
        let figures = alike.figures(0.0);
        assert!((figures.reduction_floor95 - 0.5).abs() < 1e-9, "{figures:?}");
        let one = Sums { before: vec![4.0], after: vec![0.0] };
        assert_eq!(one.figures(0.0).reduction_floor95, -1.0);
    }

    #[test]
    fn a_zero_that_is_set_again_is_the_mean_of_three_readings_of_each_part() {
        let um = with_zero_again(vec![1.0, 2.0, 3.0, 7.0, 10.0, 10.0], &[0, 0, 0, 0, 1, 1]);
        assert_eq!(um, [-1.0, 0.0, 1.0, 5.0, 0.0, 0.0]);
    }
}
