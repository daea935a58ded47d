//! Whether something happened, and what: a generalised likelihood ratio over alternatives and instants.
//!
//! ```text
//! e   reading − prediction of what was believed before the instant τ     for the readings from τ on
//! H₀  e noise; one reading in twenty is bad: ℓ(e) = ln(0.95·N(e; 0, σ²) + 0.05/200 µm)
//! Hₐ  e = δ·h + noise       h  1                    a step of the zero
//!                              ∂/∂c                 a constant
//!                              share of T − Tₐᵢᵣ    a thermometer that shows another share of the heat
//!     e noise of s·σ                                scatter
//! G   max over τ, a, δ of Σ ℓ(e − δ·h) − ℓ(e) ≥ ln 10⁵
//! ```
//!
//! The likelihood of a bad reading bounds the evidence of any single one (6.6 of the 11.5 that are needed, at 2 µm), so
//! three that agree are the least. An event is reported from a size of [`MIN_EVENT_TO_SCATTER_RATIO`] times the scatter on, and of
//! [`MIN_EVENT_PREDICTION_SIGMAS`] times the uncertainty of the prediction: what was never known has not changed. σ is the scatter of the readings
//! about their predictions, which contains what these are usually uncertain by; only more than that is added.
//!
//! Two alternatives are distinguished by these readings where the best explanation by one differs from the best by
//! the other by four standard errors or more: √(Σ(δh − δ'h')²/σ²) ≥ 4. Else both are named.

use trueup_numerics::robust::median;

/// ln of the odds that make an event certain: one in a hundred thousand by chance for each reading, before the search over
/// instants and alternatives, of which the bounds on size take back more than the search gives.
const MIN_EVENT_LOG_ODDS: f64 = 11.5;
/// And below which an event that was certain is taken back: a thousand to one.
pub(crate) const RETRACTION_LOG_ODDS: f64 = 6.9;
/// Share of bad readings, and the range in µm over which they lie.
const OUTLIER_FRACTION: f64 = 0.05;
const OUTLIER_RANGE_UM: f64 = 200.0;
/// The smallest event, RMS over the readings after it, in scatters of a reading: what is smaller is followed as it ages.
const MIN_EVENT_TO_SCATTER_RATIO: f64 = 3.0;
/// The smallest event that acts on the estimate, in µm: any tool setter keeps 5 µm, and the estimate follows by itself what a
/// machine ages by over a weekend (with multiples of the scatter alone the worst of sixty months that age fast is followed worse
/// than to 3.5 µm). It is reported all the same.
const MIN_ACTIONABLE_EVENT_UM: f64 = 5.0;
/// The smallest step of the zero that readings count from, in scatters, and in µm: one and a half standard deviations of what is
/// believed of it before the first reading.
const MIN_ZERO_STEP_TO_SCATTER_RATIO: f64 = 3.0;
const MIN_ZERO_STEP_UM: f64 = 7.5;

/// Returns the smallest step of the zero that readings count from, in µm, for a scatter of a reading in µm.
pub(crate) fn min_zero_step_um(scatter_um: f64) -> f64 {
    (MIN_ZERO_STEP_TO_SCATTER_RATIO * scatter_um).max(MIN_ZERO_STEP_UM)
}

/// And in standard deviations of the prediction.
const MIN_EVENT_PREDICTION_SIGMAS: f64 = 4.0;
/// The prediction's usual uncertainty, as a share of the scatter that contains it: where a constant may go anywhere in a month,
/// two readings a day leave this much.
const UNCERTAINTY_TO_SCATTER_RATIO: f64 = 0.5;
/// Readings after an event: no fewer than three that agree can say anything; a scatter needs more.
const MIN_EVENT_READINGS: usize = 3;
/// A reading agrees with an event that makes it twice as likely, in ln: three that agree, of which two are bad, are too few.
const MIN_AGREEMENT_LOG_LIKELIHOOD_RATIO: f64 = 0.7;
const MIN_SCATTER_READINGS: usize = 12;
/// By how much readings may scatter more, and the least that is reported.
const SCATTER_INCREASE_FACTORS: [f64; 4] = [2.5, 3.2, 4.0, 6.0];
/// The least share of a scatter's evidence in each half of the readings: a half of the half that it has on average.
const MIN_EVIDENCE_FRACTION_PER_HALF: f64 = 0.25;
/// By this factor at most the scatter of most readings may be below that of all: of twelve it is known to a third.
const MAX_TOTAL_TO_CORE_SCATTER_RATIO: f64 = 1.5;
/// A thermometer that shows m of a rise misses 1/m − 1 of what it shows. Wherever it goes, it shows no more than twice the rise of its
/// part, and never the opposite.
const MIN_MISSED_RISE_FRACTION: f64 = -0.5;
/// Standard errors between alternatives that are distinguished.
const MIN_SEPARATION_SIGMAS: f64 = 4.0;

/// A reading, for the search.
pub(crate) struct DetectionRow<'a> {
    /// Sensitivities: of the zero, of each constant.
    pub g: &'a [f64],
    /// Effect of each thermometer per unit share, in µm.
    pub h: &'a [f64],
    /// The file's own error, in µm.
    pub y_um: f64,
}

/// The belief before an instant.
pub(crate) struct PriorBelief {
    /// The zero in µm, the shares.
    pub x: Vec<f64>,
    /// The constants that may change by themselves.
    pub constants: Vec<usize>,
    /// Scatter of a reading, in µm, and the upper end of what it may be.
    pub scatter_um: [f64; 2],
    /// Standard deviation of the prediction at a row of sensitivities, in µm, by row from the instant on.
    pub unknown_um: Vec<f64>,
}

/// An alternative to "nothing happened".
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AlternativeHypothesis {
    Zero,
    Constant(usize),
    Thermometer(usize),
    Scatter,
}

/// An alternative as fitted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FittedAlternative {
    pub alternative: AlternativeHypothesis,
    /// δ: µm, or a share; of scatter the factor.
    pub size: f64,
    /// Its standard error.
    pub error: f64,
    /// G.
    pub gain: f64,
    /// RMS of its effect on the readings, in µm; of scatter 0.
    pub effect_um: f64,
}

impl FittedAlternative {
    /// Returns true if it is large enough to act on the estimate.
    pub(crate) fn is_actionable(&self) -> bool {
        self.alternative == AlternativeHypothesis::Scatter
            || self.effect_um >= MIN_ACTIONABLE_EVENT_UM
    }
}

/// The best explanation of the readings from an instant on.
#[derive(Clone, Debug)]
pub(crate) struct DetectedChange {
    pub best: FittedAlternative,
    /// Others that these readings do not distinguish from it.
    pub others: Vec<FittedAlternative>,
    /// All that were fitted.
    pub all: Vec<FittedAlternative>,
    /// Scatter of a reading before it, in µm.
    pub scatter_um: f64,
}

/// Returns the best explanation of `rows`, which begin at an instant; `None` where nothing is certain.
pub(crate) fn find_best_explanation(
    rows: &[DetectionRow<'_>],
    before: &PriorBelief,
    is_certain: bool,
) -> Option<DetectedChange> {
    if rows.len() < MIN_EVENT_READINGS {
        return None;
    }
    let PredictionResiduals { e, unknown_um, sigma } = compute_residuals(rows, before);
    if !is_certain && max_log_likelihood_gain(&e, sigma) < MIN_EVENT_LOG_ODDS {
        return None;
    }
    let thermometers = rows[0].h.len();
    let (mut all, mut fits) =
        (Vec::<(FittedAlternative, Vec<f64>)>::new(), Vec::<FittedAlternative>::new());
    let every = std::iter::once(AlternativeHypothesis::Zero)
        .chain(before.constants.iter().copied().map(AlternativeHypothesis::Constant))
        .chain((0..thermometers).map(AlternativeHypothesis::Thermometer));
    for alternative in every {
        let h: Vec<f64> = rows
            .iter()
            .map(|row| match alternative {
                AlternativeHypothesis::Constant(index) => row.g[index + 1],
                AlternativeHypothesis::Thermometer(index) => {
                    row.h.get(index).copied().unwrap_or(0.0)
                }
                _ => 1.0,
            })
            .collect();
        let is_moved = matches!(alternative, AlternativeHypothesis::Thermometer(_));
        let fitted = fit_alternative(alternative, &e, &h, sigma);
        let Some(fitted) =
            fitted.filter(|fitted| !is_moved || fitted.size > MIN_MISSED_RISE_FRACTION)
        else {
            continue;
        };
        fits.push(fitted);
        let least = (MIN_EVENT_TO_SCATTER_RATIO * before.scatter_um[0])
            .max(MIN_EVENT_PREDICTION_SIGMAS * unknown_um);
        if is_certain || fitted.effect_um >= least {
            all.push((fitted, h));
        }
    }
    // A change that a bad reading hides in looks like a scatter at first.
    let is_hidden =
        |by: &FittedAlternative| fits.iter().any(|fit| fit.gain > RETRACTION_LOG_ODDS.max(by.gain));
    if let Some(fitted) = fit_scatter_increase(&e, sigma).filter(|fitted| !is_hidden(fitted)) {
        all.push((fitted, Vec::new()));
    }
    let best = (0..all.len()).max_by(|a, b| all[*a].0.gain.total_cmp(&all[*b].0.gain))?;
    let (best_fit, best_h) = &all[best];
    if best_fit.gain < if is_certain { RETRACTION_LOG_ODDS } else { MIN_EVENT_LOG_ODDS } {
        return None;
    }
    let others = all.iter().enumerate().filter(|(index, (other, h))| {
        *index != best
            && !best_h.is_empty()
            && !h.is_empty()
            && separation_sigmas(best_fit, best_h, other, h, &e, before.scatter_um[0])
                < MIN_SEPARATION_SIGMAS
    });
    let others = others.map(|(_, (fitted, _))| *fitted).collect();
    Some(DetectedChange { best: *best_fit, others, all: fits, scatter_um: before.scatter_um[0] })
}

/// Returns true if nothing has happened since an earlier instant than that of `rows`, whose belief `before` is.
pub(crate) fn is_explained_by_prior(rows: &[DetectionRow<'_>], before: &PriorBelief) -> bool {
    let PredictionResiduals { e, sigma, .. } = compute_residuals(rows, before);
    max_log_likelihood_gain(&e, sigma) < MIN_EVENT_LOG_ODDS
}

/// The residuals of readings under a belief, and their expected scatter.
struct PredictionResiduals {
    /// Of each, in µm.
    e: Vec<f64>,
    /// Standard deviation of the prediction, RMS over the readings, in µm.
    unknown_um: f64,
    /// And with the scatter of a reading.
    sigma: f64,
}

/// Computes what `before` leaves of `rows`.
fn compute_residuals(rows: &[DetectionRow<'_>], before: &PriorBelief) -> PredictionResiduals {
    let squares: f64 = before.unknown_um.iter().map(|um| um * um).sum();
    let unknown_um = (squares / rows.len() as f64).sqrt();
    let predicted =
        |row: &DetectionRow<'_>| row.g.iter().zip(&before.x).map(|(g, x)| g * x).sum::<f64>();
    let e = rows.iter().map(|row| row.y_um - predicted(row)).collect();
    let scatter_um = before.scatter_um[0];
    let more = (unknown_um.powi(2) - (UNCERTAINTY_TO_SCATTER_RATIO * scatter_um).powi(2)).max(0.0);
    PredictionResiduals { e, unknown_um, sigma: scatter_um.hypot(more.sqrt()) }
}

/// Returns what explains all of `e`: no alternative gains more.
fn max_log_likelihood_gain(e: &[f64], sigma: f64) -> f64 {
    e.iter().map(|e| log_likelihood(0.0, sigma) - log_likelihood(*e, sigma)).sum()
}

/// Returns ln of the density of an error `e` in µm, for a scatter of `sigma`.
fn log_likelihood(e: f64, sigma: f64) -> f64 {
    let good = (-0.5 * (e / sigma).powi(2)).exp() / (std::f64::consts::TAU.sqrt() * sigma);
    ((1.0 - OUTLIER_FRACTION) * good + OUTLIER_FRACTION / OUTLIER_RANGE_UM).ln()
}

/// Returns the share of an error that is a good reading's.
fn inlier_probability(e: f64, sigma: f64) -> f64 {
    let good = (-0.5 * (e / sigma).powi(2)).exp() / (std::f64::consts::TAU.sqrt() * sigma);
    let good = (1.0 - OUTLIER_FRACTION) * good;
    good / (good + OUTLIER_FRACTION / OUTLIER_RANGE_UM)
}

/// Fits e = δ·h by maximum likelihood (EM from several starts); `None` where h says nothing.
fn fit_alternative(
    alternative: AlternativeHypothesis,
    e: &[f64],
    h: &[f64],
    sigma: f64,
) -> Option<FittedAlternative> {
    const EM_START_COUNT: usize = 6;
    const EM_ITERATIONS: usize = 12;
    let largest = h.iter().map(|h| h.abs()).fold(0.0, f64::max);
    if largest < 1e-9 {
        return None;
    }
    let gain = |size: f64| -> f64 {
        let each = e.iter().zip(h);
        each.map(|(e, h)| log_likelihood(e - size * h, sigma) - log_likelihood(*e, sigma)).sum()
    };
    let informative = (0..e.len()).rev().filter(|n| h[*n].abs() > 0.3 * largest);
    let mut best: Option<(f64, f64)> = None;
    for start in informative.take(EM_START_COUNT) {
        let mut size = e[start] / h[start];
        for _ in 0..EM_ITERATIONS {
            let (mut eh, mut hh) = (0.0, 0.0);
            for (e, h) in e.iter().zip(h) {
                let w = inlier_probability(e - size * h, sigma);
                eh += w * e * h;
                hh += w * h * h;
            }
            if hh <= 0.0 {
                break;
            }
            size = eh / hh;
        }
        let gain = gain(size);
        if best.is_none_or(|(_, most)| gain > most) {
            best = Some((size, gain));
        }
    }
    let (size, gain) = best?;
    let agrees = |(e, h): (&f64, &f64)| {
        let explained = log_likelihood(e - size * h, sigma) - log_likelihood(*e, sigma);
        explained > MIN_AGREEMENT_LOG_LIKELIHOOD_RATIO
            && inlier_probability(e - size * h, sigma) > 0.5
    };
    if e.iter().zip(h).filter(|pair| agrees(*pair)).count() < MIN_EVENT_READINGS {
        return None;
    }
    let known: f64 =
        e.iter().zip(h).map(|(e, h)| inlier_probability(e - size * h, sigma) * h * h).sum();
    let mean_square = h.iter().map(|h| h * h).sum::<f64>() / h.len() as f64;
    let effect_um = size.abs() * mean_square.sqrt();
    Some(FittedAlternative {
        alternative,
        size,
        error: sigma / known.max(1e-12).sqrt(),
        gain,
        effect_um,
    })
}

/// Fits a larger scatter about a level; `None` where it explains nothing. It must hold in each half of the readings about a level of
/// its own: a step, or a change whose effect comes and goes, is no scatter of the readings before it.
fn fit_scatter_increase(e: &[f64], sigma: f64) -> Option<FittedAlternative> {
    if e.len() < MIN_SCATTER_READINGS {
        return None;
    }
    let gain = |e: &[f64], s: f64| -> f64 {
        let level = median(&mut e.to_vec());
        let each = e.iter().map(|e| e - level);
        each.map(|e| log_likelihood(e, s * sigma) - log_likelihood(e, sigma)).sum()
    };
    let all = SCATTER_INCREASE_FACTORS.into_iter().map(|s| (s, gain(e, s)));
    let (size, all) = all.max_by(|a, b| a.1.total_cmp(&b.1))?;
    let (first, last) = e.split_at(e.len() / 2);
    if [first, last].iter().any(|half| gain(half, size) < MIN_EVIDENCE_FRACTION_PER_HALF * all) {
        return None;
    }
    // Some bad readings in a row are no scatter: the median of the magnitude says how the others scatter.
    let level = median(&mut e.to_vec());
    let mut off: Vec<f64> = e.iter().map(|e| (e - level).abs()).collect();
    if MAX_TOTAL_TO_CORE_SCATTER_RATIO * 1.4826 * median(&mut off) < size * sigma {
        return None;
    }
    let error = size / (2.0 * e.len() as f64).sqrt();
    let alternative = AlternativeHypothesis::Scatter;
    (all > 0.0).then_some(FittedAlternative { alternative, size, error, gain: all, effect_um: 0.0 })
}

/// Returns by how many standard errors the best explanation differs from the best by another.
fn separation_sigmas(
    best: &FittedAlternative,
    best_h: &[f64],
    other: &FittedAlternative,
    h: &[f64],
    e: &[f64],
    sigma: f64,
) -> f64 {
    if other.gain <= 0.0 {
        return f64::INFINITY;
    }
    let w: Vec<f64> =
        e.iter().zip(best_h).map(|(e, h)| inlier_probability(e - best.size * h, sigma)).collect();
    let sum = |of: &dyn Fn(usize) -> f64| (0..e.len()).map(|n| w[n] * of(n)).sum::<f64>();
    let hh = sum(&|n| h[n] * h[n]);
    let size = if hh > 0.0 { sum(&|n| best.size * best_h[n] * h[n]) / hh } else { 0.0 };
    (sum(&|n| (best.size * best_h[n] - size * h[n]).powi(2))).sqrt() / sigma
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(um: impl Fn(usize, f64) -> f64, levels: &[f64]) -> Option<DetectedChange> {
        let noise = [1.1, -0.7, 0.4, -1.3, 0.2, 0.9, -0.5];
        let g: Vec<[f64; 2]> = levels.iter().map(|growth| [1.0, *growth]).collect();
        let rows: Vec<DetectionRow<'_>> = g
            .iter()
            .enumerate()
            .map(|(n, g)| DetectionRow { g, h: &[], y_um: um(n, g[1]) + noise[n % 7] })
            .collect();
        let before = PriorBelief {
            x: vec![0.0; 2],
            constants: vec![0],
            scatter_um: [1.0; 2],
            unknown_um: vec![0.2; rows.len()],
        };
        find_best_explanation(&rows, &before, false)
    }

    #[test]
    fn a_step_and_a_constant_are_named_where_the_levels_differ() {
        let levels = [20.0, 50.0, 25.0, 60.0, 30.0];
        let step = found(|_, _| 12.0, &levels).expect("a step");
        assert_eq!(step.best.alternative, AlternativeHypothesis::Zero);
        assert!(step.others.is_empty() && (step.best.size - 12.0).abs() < 2.0 * step.best.error);
        let gain = found(|_, growth| 0.3 * growth, &levels).expect("a change");
        assert_eq!(gain.best.alternative, AlternativeHypothesis::Constant(0));
        assert!(gain.others.is_empty(), "{gain:?}");
        // At one level nothing distinguishes them, and both are named.
        let both = found(|_, _| 12.0, &[40.0; 5]).expect("something");
        assert_eq!(both.others.len(), 1, "{both:?}");
    }

    #[test]
    fn two_bad_readings_are_no_event_and_a_scatter_is_one() {
        let levels = [40.0; 12];
        assert!(found(|n, _| if n < 2 { 30.0 } else { 0.0 }, &levels).is_none());
        assert!(found(|n, _| if n > 9 { 30.0 } else { 0.0 }, &levels).is_none());
        let wide = [5.0, -6.0, 4.0, -5.0, 6.0, -5.0, 5.0, -4.0, 5.0, -6.0, 6.0, -5.0];
        let scatters = found(|n, _| wide[n], &levels).expect("it scatters");
        assert_eq!(scatters.best.alternative, AlternativeHypothesis::Scatter);
        // Not where some bad ones follow each other,
        let bad = |n: usize, _: f64| if n % 3 == 1 { [5.0, -5.0][n % 2] } else { 0.0 };
        let bad = found(bad, &[40.0; 15]);
        assert!(
            bad.is_none_or(|finding| finding.best.alternative != AlternativeHypothesis::Scatter)
        );
        // nor where the readings before the last ones did not.
        let last = found(|n, _| if n < 6 { 0.0 } else { 1.5 * wide[n] }, &levels);
        assert!(
            last.is_none_or(|finding| finding.best.alternative != AlternativeHypothesis::Scatter)
        );
    }

    #[test]
    fn no_thermometer_shows_the_opposite_of_its_rise() {
        let share = |size: f64| {
            let rises = [-20.0, 30.0, -25.0, 35.0, -30.0, 28.0];
            let h: Vec<[f64; 1]> = rises.map(|rise| [rise]).into();
            let rows: Vec<DetectionRow<'_>> =
                h.iter().map(|h| DetectionRow { g: &[1.0], h, y_um: size * h[0] }).collect();
            let before = PriorBelief {
                x: vec![0.0],
                constants: Vec::new(),
                scatter_um: [1.0; 2],
                unknown_um: vec![0.2; rows.len()],
            };
            let found = find_best_explanation(&rows, &before, false)?;
            Some(found.best.alternative)
                .filter(|alternative| *alternative == AlternativeHypothesis::Thermometer(0))
        };
        // It shows 1/1.4 of its rise; 1/(1 − 1.2) would be the opposite, five times.
        assert!(share(0.4).is_some() && share(-1.2).is_none());
    }
}
