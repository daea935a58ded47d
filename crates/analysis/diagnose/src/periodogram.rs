//! Periodic errors: where in a spectrum of the residual over the position a peak stands.
//!
//! A least-squares periodogram (Lomb 1976) of the residual over the axis's position, any spacing, by a
//! [transform](trueup_numerics::fourier): a search looks at some thousand frequencies, and often.
//!
//! Frequencies go up to half of one over the typical spacing of neighbouring positions: a period
//! shorter than twice the spacing has aliases, one as good as the other.
//!
//! An instrument that looks at an angle (laser triangulation) sees its own fixed pattern at
//! C/(P + P₀): the period changes along the axis, which no screw does. It is looked for the same
//! way, over 1/(P + P₀) instead of P, with P₀ in equal ratios beyond both ends of the travel.

use std::f64::consts::TAU;

use trueup_numerics::{fourier, parallel::parallel_map, random::RandomGenerator};

/// Beyond this many the positions are as dense as those of a continuous record, and lie on no grid.
const MAX_FREQUENCIES: usize = 40_000;

/// Returns the frequency of the highest peak of `values` over `at`, with at least `least_turns` over the
/// whole length, and ln of the number of independent frequencies that were looked at.
pub(crate) fn find_spectrum_peak(
    at: &[f64],
    values: &[f64],
    least_turns: f64,
    most: usize,
) -> Option<(f64, f64)> {
    let (power, frequency, looked_at) = find_dominant_component(at, values, least_turns, most)?;
    (power > 0.0).then_some((frequency, looked_at.ln()))
}

/// Returns the frequencies of the highest peaks of `values` over `at`, at most `most`, the highest first: up to
/// twice one over the typical spacing, so that the aliases of a wave are among them.
pub(crate) fn find_spectral_peak_frequencies(at: &[f64], values: &[f64], most: usize) -> Vec<f64> {
    let Some(SamplingGrid { low, range, spacing }) = SamplingGrid::from_positions(at) else {
        return Vec::new();
    };
    let step = 0.25 / range;
    let count = (2.0 / spacing / step) as usize;
    if count > MAX_FREQUENCIES {
        return Vec::new();
    }
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    let sums = centred_fourier_sums(at, values, [low, mean], step, step, count);
    let power: Vec<f64> = sums.iter().map(|sum| sum[0] * sum[0] + sum[1] * sum[1]).collect();
    let mut tops: Vec<usize> = (1..count.saturating_sub(1))
        .filter(|&n| power[n] >= power[n - 1] && power[n] > power[n + 1])
        .collect();
    tops.sort_by(|&a, &b| power[b].total_cmp(&power[a]));
    tops.into_iter().take(most).map(|n| step * (n as f64 + 1.0)).collect()
}

/// How positions lie.
struct SamplingGrid {
    low: f64,
    range: f64,
    /// The typical distance of neighbours.
    spacing: f64,
}

impl SamplingGrid {
    /// None where nothing moves, or there are too few.
    fn from_positions(at: &[f64]) -> Option<Self> {
        let (low, high) = at
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)));
        let range = high - low;
        if range.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater) || at.len() < 12 {
            return None;
        }
        let mut sorted = at.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let least = 1e-4 * range;
        let mut gaps: Vec<f64> =
            sorted.windows(2).map(|pair| pair[1] - pair[0]).filter(|gap| *gap > least).collect();
        gaps.sort_unstable_by(f64::total_cmp);
        let spacing = gaps.get(gaps.len() / 2).copied()?;
        Some(Self { low, range, spacing })
    }
}

fn find_dominant_component(
    at: &[f64],
    values: &[f64],
    least_turns: f64,
    most: usize,
) -> Option<(f64, f64, f64)> {
    let SamplingGrid { low, range, spacing } = SamplingGrid::from_positions(at)?;
    let fastest = 0.5 / spacing;
    let step = 0.25 / range;
    let first = least_turns / range;
    if fastest <= first {
        return None;
    }
    let count = (((fastest - first) / step) as usize).min(most);
    if count < 2 {
        return None;
    }
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let sums = centred_fourier_sums(at, values, [low, mean], first, step, count);
    let power = |sum: &[f64; 2]| sum[0] * sum[0] + sum[1] * sum[1];
    let (best, sum) = sums.iter().enumerate().max_by(|a, b| power(a.1).total_cmp(&power(b.1)))?;
    // Between the grid's points the peak is where a parabola through three of them has its top.
    let around = |n: usize| sums.get(n).map_or(0.0, power).sqrt();
    let (before, here, after) =
        (if best > 0 { around(best - 1) } else { 0.0 }, around(best), around(best + 1));
    let bend = before - 2.0 * here + after;
    let offset = if bend < 0.0 { 0.5 * (before - after) / bend } else { 0.0 };
    let frequency = first + step * (best as f64 + offset.clamp(-0.5, 0.5));
    Some((power(sum), frequency, count as f64 / 4.0 + 1.0))
}

/// Σ r·cos and Σ r·sin at `count` frequencies from `first` on, of values less `mean` over positions from
/// `low` on.
fn centred_fourier_sums(
    at: &[f64],
    values: &[f64],
    [low, mean]: [f64; 2],
    first: f64,
    step: f64,
    count: usize,
) -> Vec<[f64; 2]> {
    let at: Vec<f64> = at.iter().map(|x| x - low).collect();
    let values: Vec<f64> = values.iter().map(|value| value - mean).collect();
    fourier::fourier_sums(&at, &values, TAU * first, TAU * step, count)
}

/// C and P₀ of the best wave over 1/(P + P₀).
pub(crate) fn fit_reciprocal_wave(at: &[f64], values: &[f64]) -> Option<(Vec<f64>, f64)> {
    let (low, high) = at
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)));
    let range = high - low;
    // A dense record is needed: else everything is an alias of everything.
    if at.len() < 200 || range.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater) {
        return None;
    }
    // As many rows as show the periods that matter, and no more, drawn by chance: rows at equal steps
    // may all stand at one phase.
    const EXPECTED_SAMPLE_ROWS: usize = 1200;
    let mut generator = RandomGenerator::new(at.len() as u64);
    let drawn: Vec<usize> = (0..at.len())
        .filter(|_| generator.uniform_index(at.len()) < EXPECTED_SAMPLE_ROWS)
        .collect();
    let thin = |list: &[f64]| -> Vec<f64> { drawn.iter().map(|&row| list[row]).collect() };
    let (at, values) = (thin(at), thin(values));
    // P + P₀ is positive on one side of the travel, negative on the other.
    let origins: Vec<f64> = (0..28)
        .map(|beyond| range * 0.15 * 1.22_f64.powi(beyond))
        .flat_map(|distance| [distance - low, -high - distance])
        .collect();
    let of = |origin: f64| {
        let inverse: Vec<f64> = at.iter().map(|x| 1.0 / (x + origin)).collect();
        let (power, constant, count) = find_dominant_component(&inverse, &values, 4.0, 900)?;
        Some((power, count, vec![constant, origin]))
    };
    let all: Vec<_> =
        parallel_map(&origins, true, |&origin| of(origin)).into_iter().flatten().collect();
    let looked_at: f64 = all.iter().map(|(_, count, _)| count).sum();
    all.into_iter()
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, _, values)| (values, looked_at.max(2.0).ln()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transform_finds_the_power_that_plain_sines_find() {
        let mut generator = RandomGenerator::new(5);
        let mut uniform = || generator.uniform_index(1_000_000) as f64 / 1e6;
        let at: Vec<f64> = (0..3000).map(|_| 1000.0 * uniform()).collect();
        let noise: Vec<f64> = at.iter().map(|_| uniform() - 0.5).collect();
        // Near the first and near the last of the frequencies.
        for period in [300.0, 0.9] {
            let wave = at.iter().zip(&noise).map(|(x, e)| (TAU * x / period).sin() + e);
            let values: Vec<f64> = wave.collect();
            let (power, frequency, _) =
                find_dominant_component(&at, &values, 2.0, 8000).expect("long enough");
            assert!((frequency * period - 1.0).abs() < 2e-2, "{frequency}");
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let (low, high) =
                at.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), &x| (l.min(x), h.max(x)));
            // The grid's point that is nearest to the top.
            let range = high - low;
            let grid =
                2.0 / range + ((frequency - 2.0 / range) * range * 4.0).round() * 0.25 / range;
            let sums = at.iter().zip(&values).fold([0.0; 2], |[s, c], (x, v)| {
                let (sin, cos) = (TAU * grid * (x - low)).sin_cos();
                [s + (v - mean) * sin, c + (v - mean) * cos]
            });
            let plain = sums[0] * sums[0] + sums[1] * sums[1];
            let off = (power / plain - 1.0).abs();
            println!("period {period}: off by {off:.1e}");
            assert!(off < 1e-7, "{power} {plain}");
        }
    }
}
