//! Which of several learners is believed: the one that has foreseen the last readings best, before it had
//! seen them; and the file as it is until one of them has done clearly better.
//!
//! How fast a machine ages nobody knows beforehand. So three filters forget at three paces, and the
//! readings choose.

use serde::{Deserialize, Serialize};
use trueup_numerics::t_quantile;

use crate::filter::{Fate, Filter};

const DAY_S: f64 = 86_400.0;
/// The times in which the filters forget: a constant may go anywhere within its bounds in four days, in a
/// month, in a year. Between neighbours lies a factor of about ten, within which a filter loses little.
const HORIZONS_S: [f64; 3] = [365.0 * DAY_S, 30.0 * DAY_S, 4.0 * DAY_S];
/// The readings by which they are compared: three days of work at one each half hour.
const COMPARED: usize = 48;
/// From so many on they are.
const FEWEST: usize = 12;
/// How sure it must be that another is better: one-sided. Neighbouring readings are not independent, so
/// that is asked for which a tenth as many independent ones would do.
const SURE: f64 = 0.995;
/// What leaves the file as it is must miss by a tenth less, and what misses by no twentieth less goes back to
/// it: as in the finder, 5 % are equal, and a term from farther away gains twice that.
const CLEARLY: f64 = 0.9;
const EQUALLY: f64 = 0.95;
/// Errors beyond so many standard deviations of a reading count alike: a bad one must not choose.
const ALIKE: f64 = 6.0;

/// The file as it is, and the filters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Bank {
    filters: Vec<Filter>,
    /// By reading: the magnitude of what each has missed it by, the file as it is first.
    missed_um: Vec<Vec<f64>>,
    /// 0: the file as it is.
    chosen: usize,
}

impl Bank {
    /// Filters whose values are 0 within `prior` (standard deviations); a reading repeats to `noise_um`.
    pub fn new(prior: &[f64], noise_um: f64) -> Self {
        let filters = HORIZONS_S.iter().map(|horizon_s| Filter::new(*horizon_s, prior, noise_um));
        Self { filters: filters.collect(), missed_um: Vec::new(), chosen: 0 }
    }

    /// The filter that is believed; `None`: the file as it is.
    pub fn chosen(&self) -> Option<&Filter> {
        self.chosen.checked_sub(1).map(|index| &self.filters[index])
    }

    /// The filter that is believed, or would be the first to be.
    pub fn best(&self) -> &Filter {
        self.chosen().unwrap_or(&self.filters[0])
    }

    /// How many readings they are compared by, and by how much the file as it is and the one that is
    /// believed have missed them, mean magnitude in µm.
    pub fn compared(&self) -> (usize, f64, f64) {
        (self.missed_um.len(), self.mean_missed(0), self.mean_missed(self.best_index()))
    }

    fn best_index(&self) -> usize {
        self.chosen.max(1)
    }

    /// Time has passed.
    pub fn age(&mut self, dt_s: f64) {
        self.filters.iter_mut().for_each(|filter| filter.age(dt_s));
    }

    /// A reading, where the file as it is misses by `y_um`. What became of it is said by the filter that is
    /// believed.
    pub fn take(&mut self, g: &[f64], y_um: f64) -> Fate {
        let noise_um = self.best().noise_um();
        let foreseen = self.filters.iter().map(|filter| filter.foresees(g));
        let missed = std::iter::once(0.0).chain(foreseen);
        let most_um = ALIKE * noise_um;
        self.missed_um.push(missed.map(|um| (y_um - um).abs().min(most_um)).collect());
        if self.missed_um.len() > COMPARED {
            self.missed_um.remove(0);
        }
        let best = self.best_index() - 1;
        let fates: Vec<Fate> = self.filters.iter_mut().map(|filter| filter.take(g, y_um)).collect();
        self.choose();
        fates[best]
    }

    fn choose(&mut self) {
        if self.missed_um.len() < FEWEST {
            return;
        }
        // Back to the file as it is as soon as it is no worse: what is learned has to be worth it.
        let file_um = self.mean_missed(0);
        if self.chosen != 0 && self.mean_missed(self.chosen) > EQUALLY * file_um {
            self.chosen = 0;
        }
        let surely_better = |other: &usize| {
            self.gain_over_chosen(*other) > 0.0 && self.mean_missed(*other) < CLEARLY * file_um
        };
        let better = (1..=self.filters.len()).filter(surely_better);
        let best = better.min_by(|a, b| self.mean_missed(*a).total_cmp(&self.mean_missed(*b)));
        self.chosen = best.unwrap_or(self.chosen);
    }

    fn mean_missed(&self, index: usize) -> f64 {
        let sum: f64 = self.missed_um.iter().map(|missed| missed[index]).sum();
        sum / self.missed_um.len().max(1) as f64
    }

    /// By how much `other` misses less than the chosen one at least, in µm: the lower end of the interval of
    /// the mean difference.
    fn gain_over_chosen(&self, other: usize) -> f64 {
        let gains: Vec<f64> =
            self.missed_um.iter().map(|missed| missed[self.chosen] - missed[other]).collect();
        let count = gains.len() as f64;
        let mean = gains.iter().sum::<f64>() / count;
        let variance =
            gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
        let t = t_quantile(SURE, (count / 10.0).max(3.0));
        mean - t * (variance / count).sqrt()
    }
}
