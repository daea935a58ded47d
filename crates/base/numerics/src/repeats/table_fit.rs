//! A value for each place, and for the second side a step or a value of its own: least squares.

use super::reading::RepeatReading;

/// The relation between the two sides of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TableLaw {
    /// The same: a value for each place.
    Table,
    /// The same, but for one step that the second side has everywhere.
    TableAndStep,
    /// A value for each place and side.
    EachSide,
}

/// A law with its values, NaN where none of the readings that it was fitted to was there.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TableFit {
    /// The law.
    pub law: TableLaw,
    /// By place, for each side; without the step.
    pub values: [Vec<f64>; 2],
    /// The excess of the second side over the first, where the law has a step; else 0.
    pub step: f64,
    /// How many values were fitted.
    pub constants: usize,
}

impl TableFit {
    /// `law` by least squares over `places` places.
    #[must_use]
    pub fn fit<'r>(
        law: TableLaw,
        places: usize,
        readings: impl Iterator<Item = &'r RepeatReading>,
    ) -> Self {
        let mut sum = [vec![0.0; places], vec![0.0; places]];
        let mut count = [vec![0.0; places], vec![0.0; places]];
        for it in readings {
            sum[it.side][it.place] += it.value;
            count[it.side][it.place] += 1.0;
        }
        let seen = |counts: &[f64]| counts.iter().filter(|count| **count > 0.5).count();
        if law == TableLaw::EachSide {
            let constants = seen(&count[0]) + seen(&count[1]);
            let mean = |side: usize| -> Vec<f64> {
                sum[side].iter().zip(&count[side]).map(|(sum, count)| sum / count).collect()
            };
            return Self { law, values: [mean(0), mean(1)], step: 0.0, constants };
        }
        let step =
            if law == TableLaw::TableAndStep { fit_reversal_step(&sum, &count) } else { None };
        let width = step.unwrap_or(0.0);
        let both: Vec<f64> = (0..places).map(|place| count[0][place] + count[1][place]).collect();
        let values: Vec<f64> = (0..places)
            .map(|place| (sum[0][place] + sum[1][place] - width * count[1][place]) / both[place])
            .collect();
        let constants = seen(&both) + usize::from(step.is_some());
        Self { law, values: [values.clone(), values], step: width, constants }
    }

    /// Returns what it says at a place from a side; NaN where it has no value.
    #[must_use]
    pub(crate) fn value_at(&self, place: usize, side: usize) -> f64 {
        self.values[side][place] + if side == 1 { self.step } else { 0.0 }
    }
}

/// Returns the step by least squares next to a value for each place: the places' own differences, each with the
/// weight n₀·n₁/(n₀ + n₁). None where no place has both sides.
fn fit_reversal_step(sum: &[Vec<f64>; 2], count: &[Vec<f64>; 2]) -> Option<f64> {
    let (mut total, mut weights) = (0.0, 0.0);
    for place in 0..sum[0].len() {
        let [n0, n1] = [count[0][place], count[1][place]];
        if n0 > 0.5 && n1 > 0.5 {
            let weight = n0 * n1 / (n0 + n1);
            total += weight * (sum[1][place] / n1 - sum[0][place] / n0);
            weights += weight;
        }
    }
    (weights > 0.0).then(|| total / weights)
}
