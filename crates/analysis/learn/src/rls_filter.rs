//! Recursive least squares with forgetting, one reading at a time, under an error with a memory.
//!
//! ```text
//! y = gᵀ·x + w + e                            x what lasts; w what wanders; e the probe's own, variance R
//! P ← P + prior·Δt/horizon, at most prior     it forgets: what was known long ago is known less well
//! w ← w·e^(−Δt/memory), to the variance R     what wanders is another after a while
//! S = g̃ᵀ·P·g̃ + R                              what a reading may differ by: what is not known, and the reading
//! ν = y − g̃ᵀ·(x, w)                           what it differs by; beyond 4·√S it is refused
//! K = P·g̃/S,  x ← x + K·ν,  P ← P − K·Kᵀ·S    ν held to ±2·√S, as Huber has it; g̃ = (g, 1)
//! ```
//!
//! x are shares of constants (and the zero, in µm). To forget by adding, and not by a factor, leaves what
//! no reading has looked at where it was; its interval grows with its age up to what was believed before
//! the first reading, and never beyond. R, the square of what a reading repeats to, is taken from the
//! readings themselves, where one in twenty is bad.
//!
//! Readings of one morning are off alike: the machine was homed a little elsewhere, it bends a little with the
//! hall. To whom that is a constant follows every morning, and is wrong on the next. So w is kept next to
//! the constants and never applied, and the intervals of these hold although the readings are not independent.
//!
//! One reading far from the rest is a chip or a drop of coolant. Four of six on the same side are a
//! machine that has changed: a new bearing, a thermometer that sits elsewhere. Then all is as uncertain
//! again as before the first reading, and these readings are taken after all.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};
use trueup_numerics::robust::median;

/// A reading farther off than this many standard deviations is refused: one good one in 16 000.
const REJECTION_THRESHOLD_SIGMAS: f64 = 4.0;
/// Beyond this many it does not count for more: Huber's bound at which squares of normal noise lose 1 %.
const HUBER_THRESHOLD_SIGMAS: f64 = 2.0;
/// This many of the last [`CHANGE_WINDOW_READINGS`] on one side, all refused, are a change: of 5 % bad readings on either side
/// by chance once in 80 000 readings.
const MIN_CHANGE_READINGS: usize = 4;
const CHANGE_WINDOW_READINGS: usize = 6;
/// The readings whose scatter is R: the median of this many is known to a seventh.
const NOISE_WINDOW_READINGS: usize = 64;
/// From this many readings on their own scatter is believed.
const MIN_SCATTER_READINGS: usize = 8;
/// Before that a reading may scatter by this many times what the instrument is stated to.
const INITIAL_NOISE_FACTOR: f64 = 3.0;
/// No probe repeats better, in µm.
pub(crate) const MIN_READING_NOISE_UM: f64 = 0.1;
/// This many readings in a hundred are bad, and may be off by anything up to this, in µm, either way: then no single
/// reading says much for or against anything.
const OUTLIER_FRACTION: f64 = 0.05;
const OUTLIER_HALF_RANGE_UM: f64 = 100.0;

/// The time in which a value that depends on the weather may be anywhere within its prior, in s: the seasons come back in a year.
const SEASONAL_PERIOD_S: f64 = 365.0 * 86_400.0;

/// The estimate from the readings so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct RlsFilter {
    /// The time in which it forgets all, in s.
    horizon_s: f64,
    /// For how long what wanders is remembered, in s.
    memory_s: f64,
    /// The zero in µm, then shares, then what wanders, in µm.
    x: Vec<f64>,
    /// The covariance of `x`, row by row.
    p: Vec<f64>,
    /// Variances of what lasts, before the first reading.
    prior: Vec<f64>,
    /// Places of values that were held until an event freed them: they follow the weather, at its pace.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    weather: Vec<usize>,
    /// Repeatability of one reading, in µm, as far as known.
    noise_um: f64,
    /// ν and gᵀ·P·g of readings that were taken.
    taken: Vec<[f64; 2]>,
    /// The last readings: which side they were refused on (0: taken), and they.
    last: Vec<(i8, Vec<f64>, f64)>,
}

/// The outcome of a reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum FilterOutcome {
    /// Used.
    Accepted,
    /// Refused: this many µm off, and this many standard deviations.
    Rejected { off_um: f64, deviations: f64 },
    /// The machine has changed, and it and those before it are used.
    Changed,
}

impl RlsFilter {
    /// Nothing is known but that each value is 0 within `prior` (standard deviations). Where these are 0
    /// nothing lasts, and the readings only wander. It forgets all in the first time, and what wanders in the second.
    pub fn new([horizon_s, memory_s]: [f64; 2], prior: &[f64], noise_um: f64) -> Self {
        let prior: Vec<f64> = prior.iter().map(|deviation| deviation * deviation).collect();
        let mut it = Self {
            horizon_s,
            memory_s,
            x: vec![0.0; prior.len() + 1],
            p: Vec::new(),
            prior,
            weather: Vec::new(),
            noise_um,
            taken: Vec::new(),
            last: Vec::new(),
        };
        it.reset_covariance();
        it
    }

    /// Returns true if its parts fit together, for this many values that last.
    pub(crate) fn is_consistent(&self, values: usize) -> bool {
        let all = values + 1;
        self.prior.len() == values
            && self.x.len() == all
            && self.p.len() == all * all
            && self.weather.iter().all(|place| *place < values)
            && self.last.iter().all(|(_, g, _)| (values..=all).contains(&g.len()))
            && self.noise_um > 0.0
            && [self.horizon_s, self.memory_s].iter().all(|time_s| *time_s > 0.0)
    }

    /// Returns the zero in µm, then shares.
    pub(crate) fn persistent_values(&self) -> &[f64] {
        &self.x[..self.prior.len()]
    }

    /// Returns half the 95 % interval of each value that lasts.
    pub(crate) fn confidence_half_widths(&self) -> Vec<f64> {
        let n = self.x.len();
        (0..self.prior.len()).map(|i| 1.96 * self.p[i * n + i].max(0.0).sqrt()).collect()
    }

    /// Returns how likely it thought `y_um` to be where the sensitivities are `g`: the density, by the micrometre.
    pub fn likelihood(&self, g: &[f64], y_um: f64) -> f64 {
        let g = with_drift_regressor(g);
        let s = self.prediction_variance(&g) + self.noise_um.powi(2);
        let off_um = y_um - self.predict(&g);
        let good = (-0.5 * off_um * off_um / s).exp() / (TAU * s).sqrt();
        (1.0 - OUTLIER_FRACTION) * good + OUTLIER_FRACTION / (2.0 * OUTLIER_HALF_RANGE_UM)
    }

    /// Returns the scatter of a reading about its prediction, in µm: its own noise and what wanders; and the upper end of what
    /// the readings so far allow: a median of n magnitudes is known to 1/√n.
    pub(crate) fn scatter_um(&self) -> [f64; 2] {
        if self.taken.len() < MIN_SCATTER_READINGS {
            return [self.noise_um, INITIAL_NOISE_FACTOR * self.noise_um];
        }
        let upper = 1.0 + 1.0 / (self.taken.len() as f64).sqrt();
        let um = self.noise_std_um();
        [um, um * upper]
    }

    /// Returns the standard deviation of the good ones among the readings that were taken, in µm: of largest likelihood (EM) from
    /// the median on. It is known twice as well as the median.
    fn noise_std_um(&self) -> f64 {
        const EM_ITERATIONS: usize = 4;
        let off_um = || self.taken.iter().map(|reading| reading[0]);
        // The median of the magnitude of normal noise is 1/1.4826 of its standard deviation.
        let mut um = (1.4826 * median(&mut off_um().collect::<Vec<_>>())).max(MIN_READING_NOISE_UM);
        for _ in 0..EM_ITERATIONS {
            let (mut weights, mut squares) = (0.0, 0.0);
            for off_um in off_um() {
                let good = (-0.5 * (off_um / um).powi(2)).exp() / (TAU.sqrt() * um);
                let good = (1.0 - OUTLIER_FRACTION) * good;
                let weight = good / (good + OUTLIER_FRACTION / (2.0 * OUTLIER_HALF_RANGE_UM));
                weights += weight;
                squares += weight * off_um * off_um;
            }
            um = (squares / weights).sqrt().max(MIN_READING_NOISE_UM);
        }
        um
    }

    /// Returns the standard deviation of what the values that last predict at `g`, in µm.
    pub(crate) fn persistent_prediction_std_um(&self, g: &[f64]) -> f64 {
        let mut all = g.to_vec();
        all.push(0.0);
        self.prediction_variance(&all).sqrt()
    }

    /// Changes a value (its place, by how much, known to a standard deviation, at most as before the first reading).
    pub(crate) fn shift_value(&mut self, (index, by, deviation): (usize, f64, f64)) {
        let n = self.x.len();
        for other in 0..n {
            self.p[index * n + other] = 0.0;
            self.p[other * n + index] = 0.0;
        }
        self.x[index] += by;
        let variance = deviation * deviation;
        if self.prior[index] == 0.0 {
            self.prior[index] = variance;
            self.weather.push(index);
        }
        self.p[index * n + index] = self.prior[index].min(variance);
        self.last.clear();
    }

    /// Readings scatter `times` as much from here on.
    pub(crate) fn scale_noise(&mut self, times: f64) {
        self.noise_um *= times;
        self.taken.clear();
        self.last.clear();
    }

    /// Keeps the values that `from` names by their old places, in the new order; a value without one begins at 0.
    /// `prior`: standard deviations of the new values.
    pub(crate) fn remap_values(&mut self, from: &[Option<usize>], prior: &[f64]) {
        let (old_n, old_p) = (self.x.len(), std::mem::take(&mut self.p));
        let mut places = from.to_vec();
        places.push(Some(old_n - 1));
        let x = places.iter().map(|place| place.map_or(0.0, |place| self.x[place])).collect();
        self.x = x;
        let is_fixed = self.prior.iter().all(|variance| *variance == 0.0);
        self.prior = prior.iter().map(|sd| if is_fixed { 0.0 } else { sd * sd }).collect();
        // A new value begins as it did before the first reading: one that was held is held again.
        let is_weather =
            |place: &Option<usize>| place.is_some_and(|place| self.weather.contains(&place));
        self.weather = (0..from.len()).filter(|place| is_weather(&from[*place])).collect();
        self.reset_covariance();
        let n = places.len();
        for (i, a) in places.iter().enumerate() {
            for (j, b) in places.iter().enumerate() {
                if let (Some(a), Some(b)) = (a, b) {
                    self.p[i * n + j] = old_p[a * old_n + b];
                }
            }
        }
        self.last.clear();
    }

    /// `dt_s` have passed without a reading.
    pub(crate) fn advance_time(&mut self, dt_s: f64) {
        let (n, wander) = (self.x.len(), self.prior.len());
        let share = |horizon_s: f64| (dt_s.max(0.0) / horizon_s).min(1.0);
        for i in 0..wander {
            let horizon_s =
                if self.weather.contains(&i) { SEASONAL_PERIOD_S } else { self.horizon_s };
            self.p[i * n + i] += self.prior[i] * share(horizon_s);
        }
        for i in 0..wander {
            let too_wide = self.p[i * n + i] / self.prior[i];
            // What is held (prior 0) does not widen.
            if self.prior[i] > 0.0 && too_wide > 1.0 {
                for j in 0..n {
                    self.p[i * n + j] /= too_wide.sqrt();
                    self.p[j * n + i] /= too_wide.sqrt();
                }
            }
        }
        let decay = (-dt_s.max(0.0) / self.memory_s).exp();
        self.x[wander] *= decay;
        for i in 0..n {
            self.p[i * n + wander] *= decay;
            self.p[wander * n + i] *= decay;
        }
        self.p[wander * n + wander] += self.noise_um.powi(2) * (1.0 - decay * decay);
    }

    /// Takes `y_um` where the sensitivities are `g`, or refuses it.
    pub(crate) fn process_reading(&mut self, g: &[f64], y_um: f64) -> FilterOutcome {
        let g = &with_drift_regressor(g);
        let off_um = y_um - self.predict(g);
        let deviations = off_um / (self.prediction_variance(g) + self.noise_um.powi(2)).sqrt();
        let is_refused = deviations.abs() > REJECTION_THRESHOLD_SIGMAS;
        let side = if is_refused { deviations.signum() as i8 } else { 0 };
        self.last.push((side, g.clone(), y_um));
        if self.last.len() > CHANGE_WINDOW_READINGS {
            self.last.remove(0);
        }
        if !is_refused {
            self.update(g, y_um);
            return FilterOutcome::Accepted;
        }
        let on_this_side = |entry: &&(i8, Vec<f64>, f64)| entry.0 == side;
        if self.last.iter().filter(on_this_side).count() < MIN_CHANGE_READINGS {
            return FilterOutcome::Rejected { off_um, deviations: deviations.abs() };
        }
        let again: Vec<_> = self.last.drain(..).filter(|entry| entry.0 == side).collect();
        self.reset_covariance();
        again.iter().for_each(|(_, g, y_um)| self.update(g, *y_um));
        FilterOutcome::Changed
    }

    /// Returns what it predicts, what wanders included.
    fn predict(&self, g: &[f64]) -> f64 {
        g.iter().zip(&self.x).map(|(g, x)| g * x).sum()
    }

    /// gᵀ·P·g.
    fn prediction_variance(&self, g: &[f64]) -> f64 {
        self.multiply_covariance(g).iter().zip(g).map(|(pg, g)| pg * g).sum::<f64>().max(0.0)
    }

    fn multiply_covariance(&self, g: &[f64]) -> Vec<f64> {
        let rows = self.p.chunks(g.len());
        rows.map(|row| row.iter().zip(g).map(|(p, g)| p * g).sum()).collect()
    }

    fn update(&mut self, g: &[f64], y_um: f64) {
        let unknown = self.prediction_variance(g);
        let s = unknown + self.noise_um.powi(2);
        let off_um = y_um - self.predict(g);
        let held_um =
            off_um.clamp(-HUBER_THRESHOLD_SIGMAS * s.sqrt(), HUBER_THRESHOLD_SIGMAS * s.sqrt());
        let pg = self.multiply_covariance(g);
        let n = g.len();
        for i in 0..n {
            self.x[i] += pg[i] / s * held_um;
            for j in 0..n {
                self.p[i * n + j] -= pg[i] * pg[j] / s;
            }
        }
        self.taken.push([off_um.abs(), unknown]);
        if self.taken.len() > NOISE_WINDOW_READINGS {
            self.taken.remove(0);
        }
        if self.taken.len() >= MIN_SCATTER_READINGS {
            let mut unknown: Vec<f64> = self.taken.iter().map(|reading| reading[1]).collect();
            let scatter = self.noise_std_um().powi(2);
            let own = scatter - median(&mut unknown);
            self.noise_um = own.max(scatter / 4.0).sqrt().max(MIN_READING_NOISE_UM);
        }
    }

    fn reset_covariance(&mut self) {
        let n = self.x.len();
        self.p = vec![0.0; n * n];
        let wander = self.noise_um.powi(2);
        for (i, variance) in self.prior.iter().chain([&wander]).enumerate() {
            self.p[i * n + i] = *variance;
        }
    }
}

/// Returns `g` with a 1 for the part that wanders, which is in every reading with the factor 1.
fn with_drift_regressor(g: &[f64]) -> Vec<f64> {
    [g, &[1.0]].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: f64 = 3600.0;

    fn settled() -> RlsFilter {
        let mut filter = RlsFilter::new([1e7, 3e4], &[5.0, 0.25], 1.0);
        for n in 0..40 {
            filter.advance_time(HOUR);
            let g = [1.0, 20.0 + 10.0 * f64::from(n % 5)];
            // 10 % more than believed, and the zero 2 µm off; repeats to half a micrometre.
            let y = 2.0 + 0.1 * g[1] + 0.5 * if n % 2 == 0 { 1.0 } else { -1.0 };
            filter.process_reading(&g, y);
        }
        filter
    }

    #[test]
    fn a_constant_is_found_within_its_interval() {
        let filter = settled();
        let half = filter.confidence_half_widths();
        assert!((filter.x[1] - 0.1).abs() < half[1] && half[1] < 0.03, "{:?} {half:?}", filter.x);
        assert!((filter.x[0] - 2.0).abs() < half[0], "{:?} {half:?}", filter.x);
    }

    #[test]
    fn one_reading_that_stands_alone_is_refused_and_changes_nothing() {
        let mut filter = settled();
        let before = filter.x.clone();
        let fate = filter.process_reading(&[1.0, 40.0], 40.0);
        assert!(matches!(fate, FilterOutcome::Rejected { .. }), "{fate:?}");
        assert_eq!(filter.x, before);
    }

    #[test]
    fn four_of_six_on_one_side_are_a_machine_that_has_changed() {
        let mut filter = settled();
        let fates: Vec<FilterOutcome> =
            (0..4).map(|_| filter.process_reading(&[1.0, 40.0], 30.0)).collect();
        assert!(
            fates[..3].iter().all(|fate| matches!(fate, FilterOutcome::Rejected { .. })),
            "{fates:?}"
        );
        assert_eq!(fates[3], FilterOutcome::Changed);
        assert!((filter.predict(&[1.0, 40.0]) - 30.0).abs() < 12.0, "{:?}", filter.x);
        // Of two sides none is a change: bad readings come from both.
        let mut filter = settled();
        for n in 0..12 {
            let off = if n % 2 == 0 { 30.0 } else { -30.0 };
            assert!(matches!(
                filter.process_reading(&[1.0, 40.0], off),
                FilterOutcome::Rejected { .. }
            ));
        }
    }

    #[test]
    fn what_is_not_measured_is_known_less_well_with_age_but_never_less_than_before() {
        let mut filter = settled();
        let fresh = filter.confidence_half_widths();
        filter.advance_time(100.0 * HOUR);
        let old = filter.confidence_half_widths();
        assert!(old[1] > fresh[1], "{fresh:?} {old:?}");
        filter.advance_time(1e9);
        let oldest = filter.confidence_half_widths();
        assert!((oldest[1] - 1.96 * 0.25).abs() < 1e-9 && (oldest[0] - 1.96 * 5.0).abs() < 1e-9);
    }

    #[test]
    fn a_value_that_an_event_freed_goes_at_the_pace_of_the_seasons() {
        let widths = |horizon_s: f64| {
            let mut filter = RlsFilter::new([horizon_s, 3e4], &[0.0, 0.25], 1.0);
            filter.advance_time(100.0 * HOUR);
            assert_eq!(filter.confidence_half_widths()[0], 0.0, "it is held");
            filter.shift_value((0, 0.0, 3.0));
            for n in 0..200 {
                filter.advance_time(HOUR);
                filter.process_reading(&[1.0, 20.0 + 10.0 * f64::from(n % 5)], 0.0);
            }
            let before = filter.p[0];
            filter.advance_time(100.0 * HOUR);
            filter.p[0] - before
        };
        let expected = 9.0 * 100.0 * HOUR / SEASONAL_PERIOD_S;
        for horizon_s in [1e6, 1e9] {
            assert!((widths(horizon_s) - expected).abs() < 1e-9, "{horizon_s}");
        }
    }
}
