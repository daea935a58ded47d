//! Gross errors: rows that do not belong to the rest, found, listed, and never dropped in silence.
//!
//! Two kinds of data, two ways to say what the rest is:
//!
//! - **A series** ([`in_series`]): what is warm moves slowly. Each row is compared with a line
//!   through its neighbours in time (the median of the slopes of all pairs, Theil and Sen, and the
//!   median height), without itself. A single row or a short burst that leaves and comes back is a
//!   gross error; a level that stays is a step of the machine, and no row of it is set aside. Which
//!   model explains the series does not matter.
//! - **A relation** ([`in_relation`]): y against columns x. First the fit of many small random
//!   samples (their seed is fixed: the same data gives the same rows) whose median residual is
//!   smallest, which up to half of the rows cannot spoil; from there least squares with Tukey's
//!   biweight at 4.685 scales, which comes near to plain least squares where nothing is wrong (an
//!   MM estimate).
//!
//! The scale is 1.4826 times the median of the magnitudes of the residuals, never below the step in
//! which the values were written or a series moves. A row is set aside beyond the quantile of Student's t at which
//! 1 of 100 clean runs would lose a row, but never within [`GROSS`] scales; the median knows the
//! scale as well as 0.37·n values would with squares, so short runs need more.

use std::collections::BTreeSet;

use crate::{least_squares::Triangle, random::Generator, t_quantile};

/// A row within so many scales is never set aside.
pub const GROSS: f64 = 5.0;
/// The median magnitude of a normal distribution is the standard deviation divided by this.
const NORMAL: f64 = 1.482_602_218_505_602;
/// Neighbours on each side of a row of a series.
const NEIGHBOURS: usize = 7;
/// A burst of more rows is not set aside: it has become the level.
const LONGEST_BURST: usize = 5;
/// Fewer rows than this have no neighbours to speak of.
pub const FEWEST_IN_SERIES: usize = 2 * NEIGHBOURS + 1;
/// Small samples that are tried.
const SAMPLES: usize = 500;
/// The rows that a sample is judged on, at most.
const JUDGES: usize = 2000;
/// Tukey's constant: 95 % of the efficiency of least squares.
const BIWEIGHT: f64 = 4.685;

/// A row that does not belong to the rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outlier {
    /// The row, from 0.
    pub row: usize,
    /// How far it is from the others, in y's unit.
    pub distance: f64,
    /// The same in scales.
    pub scales: f64,
}

impl Outlier {
    /// The reason for a list of rows that were set aside, y in µm.
    #[must_use]
    pub fn reason(&self) -> String {
        let Self { distance, scales, .. } = self;
        format!(
            "{distance:.3} um away from what the other rows say, {scales:.0} times their scatter"
        )
    }
}

/// How many scales away a row of `rows` is set aside.
#[must_use]
pub fn cutoff(rows: usize, fitted: usize) -> f64 {
    let known = 0.37 * rows.saturating_sub(fitted).max(1) as f64;
    t_quantile(1.0 - 0.005 / rows.max(1) as f64, known).max(GROSS)
}

/// The smallest difference of two of `values` that differ by more than rounding; 0 if none do.
fn finest(values: impl Iterator<Item = f64>) -> f64 {
    let mut rising: Vec<f64> = values.collect();
    rising.sort_unstable_by(f64::total_cmp);
    let least = rising.last().map_or(0.0, |last| last.abs().max(1.0) * 1e-12);
    let steps = rising.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > least);
    steps.min_by(f64::total_cmp).unwrap_or(0.0)
}

/// The step in which a series moves: the median difference of two values that follow each other
/// and differ; 0 if all are equal. Of values in fine steps it is about the scatter, or less.
fn resolution(values: impl Iterator<Item = f64>) -> f64 {
    let mut steps = Vec::new();
    let mut before = f64::NAN;
    for value in values {
        // Two ways to write one number differ by rounding, which is no step.
        if (value - before).abs() > value.abs().max(1.0) * 1e-12 {
            steps.push((value - before).abs());
        }
        before = value;
    }
    if steps.is_empty() { 0.0 } else { median(&mut steps) }
}

/// The median; NaN of nothing. Reorders `values`.
fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() {
        return f64::NAN;
    }
    let (below, &mut upper, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    if below.len() < middle || values.len() % 2 == 1 {
        return upper;
    }
    let lower = values[..middle].iter().copied().fold(f64::NEG_INFINITY, f64::max);
    lower + (upper - lower) / 2.0
}

/// The scale of residuals about their model: 1.4826 times the median magnitude.
fn scale(residuals: impl Iterator<Item = f64>) -> f64 {
    let mut magnitudes: Vec<f64> =
        residuals.filter(|residual| !residual.is_nan()).map(f64::abs).collect();
    NORMAL * median(&mut magnitudes)
}

/// Rows of a time series that leave it and come back. `time` does not run back; rows where either
/// is NaN take no part. Nothing is found in fewer than [`FEWEST_IN_SERIES`] rows.
#[must_use]
pub fn in_series(time: &[f64], y: &[f64]) -> Vec<Outlier> {
    let present = |row: &usize| !time[*row].is_nan() && !y[*row].is_nan();
    let rows: Vec<usize> = (0..y.len().min(time.len())).filter(present).collect();
    if rows.len() < FEWEST_IN_SERIES {
        return Vec::new();
    }
    let floor = resolution(rows.iter().map(|&row| y[row]));
    let most = cutoff(rows.len(), 2);
    let mut found: Vec<Outlier> = Vec::new();
    // A burst hides behind itself: without the rows found so far the others stand out.
    for _ in 0..LONGEST_BURST {
        let known: BTreeSet<usize> = found.iter().map(|outlier| outlier.row).collect();
        let clean: Vec<usize> = rows.iter().copied().filter(|row| !known.contains(row)).collect();
        if clean.len() < FEWEST_IN_SERIES {
            break;
        }
        let local: Vec<Local> = (0..clean.len()).map(|at| Local::at(&clean, at, time, y)).collect();
        let global = scale(local.iter().map(|local| local.distance / local.widening));
        let mut new: Vec<Outlier> = Vec::new();
        for (local, &row) in local.iter().zip(&clean) {
            let scale = local.widening * global.max(local.scale).max(floor);
            let scales = local.distance.abs() / scale;
            if scales > most {
                new.push(Outlier { row, distance: local.distance, scales });
            }
        }
        if new.is_empty() {
            break;
        }
        found.extend(new);
    }
    found.sort_unstable_by_key(|outlier| outlier.row);
    that_come_back(found, &rows, time, y)
}

/// Takes back what may be the machine: bursts so long that they are a level, and at either end of
/// the series, where nobody saw it come back, all but a single row that does not continue its
/// neighbours' curve either. A cold machine moves fastest in its first rows.
fn that_come_back(found: Vec<Outlier>, rows: &[usize], time: &[f64], y: &[f64]) -> Vec<Outlier> {
    let place = |outlier: &Outlier| rows.binary_search(&outlier.row).unwrap_or(usize::MAX);
    let follows = |a: &Outlier, b: &Outlier| {
        place(a) + 1 == place(b) && a.distance.signum() == b.distance.signum()
    };
    let last = rows.len() - 1;
    let is_kept = |burst: &&[Outlier]| {
        let (from, to) = (place(&burst[0]), place(&burst[burst.len() - 1]));
        match (from, to) {
            (0, 0) => leaves_its_curve(&burst[0], &rows[1..4], time, y),
            (from, to) if from == last && to == last => {
                leaves_its_curve(&burst[0], &rows[last - 3..last], time, y)
            }
            (from, to) => from != 0 && to != last && burst.len() <= LONGEST_BURST,
        }
    };
    found.chunk_by(follows).filter(is_kept).flatten().copied().collect()
}

/// Whether a row at an end is far from the parabola through its three neighbours as well.
fn leaves_its_curve(outlier: &Outlier, three: &[usize], time: &[f64], y: &[f64]) -> bool {
    let at = time[outlier.row];
    let (mut value, mut squares) = (0.0, 1.0);
    for &row in three {
        let others = three.iter().filter(|other| **other != row);
        let weight: f64 =
            others.map(|&other| (at - time[other]) / (time[row] - time[other])).product();
        value += weight * y[row];
        squares += weight * weight;
    }
    let scale = (outlier.distance / outlier.scales).abs();
    // Rows at one time have no parabola: then nothing speaks for the row.
    let away = (y[outlier.row] - value).abs();
    away.is_nan() || away > GROSS * scale * squares.sqrt()
}

/// A row of a series beside its neighbours.
struct Local {
    /// From the line through the neighbours.
    distance: f64,
    /// The neighbours' own scale about that line.
    scale: f64,
    /// How much wider than its own scatter the row lies about the line, because the line is not
    /// known exactly: more where the row is at an end.
    widening: f64,
}

impl Local {
    fn at(rows: &[usize], at: usize, time: &[f64], y: &[f64]) -> Self {
        let wanted = 2 * NEIGHBOURS;
        let first = at.saturating_sub(NEIGHBOURS).min(rows.len() - wanted - 1);
        let others = || rows[first..=first + wanted].iter().copied().filter(|&row| row != rows[at]);
        let own = time[rows[at]];
        // Slopes of all pairs of neighbours; two rows at one time have none.
        let mut slopes = Vec::with_capacity(wanted * (wanted - 1) / 2);
        for (index, a) in others().enumerate() {
            for b in others().skip(index + 1) {
                let elapsed = time[b] - time[a];
                if elapsed > 0.0 {
                    slopes.push((y[b] - y[a]) / elapsed);
                }
            }
        }
        let slope = if slopes.is_empty() { 0.0 } else { median(&mut slopes) };
        let mut heights: Vec<f64> =
            others().map(|row| y[row] - slope * (time[row] - own)).collect();
        let height = median(&mut heights);
        let scale = scale(heights.iter().map(|there| there - height));
        let count = wanted as f64;
        let mean = others().map(|row| time[row] - own).sum::<f64>() / count;
        let spread: f64 = others().map(|row| (time[row] - own - mean).powi(2)).sum();
        // Medians know a line about 1.57 times worse than least squares.
        let share = if spread > 0.0 { mean * mean / spread } else { 0.0 };
        let widening = (1.0 + 1.57 * (1.0 / count + share)).sqrt();
        Self { distance: y[rows[at]] - height, scale, widening }
    }
}

/// Rows whose y is far from what a linear relation of the columns of `x` gives for the others.
/// Rows where a value is NaN take no part. Nothing is found in fewer than 3 rows for each column.
#[must_use]
pub fn in_relation(x: &[&[f64]], y: &[f64]) -> Vec<Outlier> {
    let columns = x.len();
    let present = |row: &usize| !y[*row].is_nan() && x.iter().all(|column| !column[*row].is_nan());
    let rows: Vec<usize> = (0..y.len()).filter(present).collect();
    if columns == 0 || rows.len() < 3 * columns.max(2) {
        return Vec::new();
    }
    let Some(start) = best_sample(x, y, &rows) else { return Vec::new() };
    let at = |row: usize, coefficients: &[f64]| -> f64 {
        y[row] - x.iter().zip(coefficients).map(|(column, c)| c * column[row]).sum::<f64>()
    };
    let floor = finest(rows.iter().map(|&row| y[row]));
    let few = 1.0 + 5.0 / (rows.len() - columns) as f64;
    let mut coefficients = start;
    let mut spread = 0.0;
    let mut row_of = vec![0.0; columns];
    for round in 0..30 {
        // The scale settles with the first rounds, then stays, so that the weights can settle.
        if round < 10 {
            spread = (few * scale(rows.iter().map(|&row| at(row, &coefficients)))).max(floor);
        }
        if spread == 0.0 {
            // More than half of the rows lie on it exactly, and nothing was rounded: what is off
            // is off.
            spread = f64::MIN_POSITIVE;
        }
        let mut triangle = Triangle::new(columns);
        for &row in &rows {
            let share = at(row, &coefficients) / (BIWEIGHT * spread);
            let weight = (1.0 - share * share).max(0.0);
            if weight > 0.0 {
                row_of.iter_mut().zip(x).for_each(|(at, column)| *at = weight * column[row]);
                triangle.add(&row_of, weight * y[row]);
            }
        }
        let Ok(solution) = triangle.solve() else { break };
        let moved = solution.coefficients != coefficients;
        coefficients = solution.coefficients;
        if !moved {
            break;
        }
    }
    let magnitude = rows.iter().fold(0.0_f64, |most, &row| most.max(y[row].abs()));
    let spread = spread.max(magnitude * 1e-12);
    let most = cutoff(rows.len(), columns);
    let outlier = |&row: &usize| {
        let distance = at(row, &coefficients);
        Outlier { row, distance, scales: distance.abs() / spread }
    };
    rows.iter().map(outlier).filter(|outlier| outlier.scales > most).collect()
}

/// The coefficients through the small sample that leaves the smallest median residual.
fn best_sample(x: &[&[f64]], y: &[f64], rows: &[usize]) -> Option<Vec<f64>> {
    let columns = x.len();
    let every = rows.len().div_ceil(JUDGES);
    let mut random = Generator::new(0x7275_6575_7000);
    let mut best: Option<(f64, Vec<f64>)> = None;
    let mut magnitudes = Vec::with_capacity(JUDGES);
    let mut row_of = vec![0.0; columns];
    for _ in 0..SAMPLES {
        let mut triangle = Triangle::new(columns);
        for _ in 0..columns {
            let row = rows[random.below(rows.len())];
            row_of.iter_mut().zip(x).for_each(|(at, column)| *at = column[row]);
            triangle.add(&row_of, y[row]);
        }
        let Ok(solution) = triangle.solve() else { continue };
        magnitudes.clear();
        magnitudes.extend(rows.iter().step_by(every).map(|&row| {
            let value: f64 =
                x.iter().zip(&solution.coefficients).map(|(column, c)| c * column[row]).sum();
            (y[row] - value).abs()
        }));
        let middle = median(&mut magnitudes);
        if best.as_ref().is_none_or(|(least, _)| middle < *least) {
            best = Some((middle, solution.coefficients));
        }
    }
    best.map(|(_, coefficients)| coefficients)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(random: &mut Generator) -> f64 {
        random.normal()
    }

    /// Heavier tails than normal, of the same standard deviation.
    fn laplace(random: &mut Generator) -> f64 {
        let u = random.uniform() - 0.5;
        -u.signum() * (1.0 - 2.0 * u.abs()).ln() / 2.0_f64.sqrt()
    }

    fn warmup(row: usize) -> f64 {
        60.0 * (1.0 - (-(row as f64) / 40.0).exp())
    }

    fn rows_of(found: &[Outlier]) -> Vec<usize> {
        found.iter().map(|outlier| outlier.row).collect()
    }

    #[test]
    fn the_median_is_the_middle_or_between_the_two_middles() {
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), 2.5);
        assert!(median(&mut []).is_nan());
    }

    #[test]
    fn gross_errors_of_a_warm_up_are_found_alone_and_in_bursts_and_nothing_else() {
        let mut random = Generator::new(1);
        let time: Vec<f64> = (0..300).map(|row| row as f64 * 60.0).collect();
        let mut y: Vec<f64> = (0..300).map(|row| warmup(row) + 0.5 * noise(&mut random)).collect();
        let wrong = [0, 4, 90, 91, 92, 180, 299];
        for (index, &row) in wrong.iter().enumerate() {
            y[row] += if index % 2 == 0 { 40.0 } else { -25.0 };
        }
        y[50] = f64::NAN;
        assert_eq!(rows_of(&in_series(&time, &y)), wrong);
    }

    #[test]
    fn a_step_that_stays_is_no_gross_error() {
        let mut random = Generator::new(2);
        let time: Vec<f64> = (0..200).map(f64::from).collect();
        let step = |row: usize| if row >= 77 { 30.0 } else { 0.0 };
        let y: Vec<f64> = (0..200).map(|row| step(row) + 0.3 * noise(&mut random)).collect();
        assert_eq!(in_series(&time, &y), []);
    }

    #[test]
    fn the_quick_start_of_a_cold_machine_is_no_gross_error() {
        let time: Vec<f64> = (0..200)
            .map(|row| if row < 3 { 4.0 * f64::from(row) } else { 60.0 * f64::from(row) })
            .collect();
        let growth = |t: &f64| 90.0 * (1.0 - (-t / 35.0).exp()) - 0.01 * t;
        let y: Vec<f64> = time.iter().map(growth).collect();
        assert_eq!(in_series(&time, &y), []);
    }

    #[test]
    fn values_in_coarse_steps_are_not_taken_for_exact_ones() {
        let time: Vec<f64> = (0..200).map(f64::from).collect();
        let y: Vec<f64> = (0..200).map(|row| (warmup(row) / 2.5).round() * 2.5).collect();
        assert_eq!(in_series(&time, &y), []);
        let level = vec![7.5; 200];
        assert_eq!(in_series(&time, &level), []);
    }

    #[test]
    fn a_relation_is_found_though_a_third_of_the_rows_is_wrong() {
        let mut random = Generator::new(3);
        let ones = vec![1.0; 90];
        let x: Vec<f64> = (0..90).map(|row| f64::from(row) * 100.0).collect();
        let mut y: Vec<f64> = x.iter().map(|x| 0.02 * x - 4.0 + 0.4 * noise(&mut random)).collect();
        let wrong: Vec<usize> = (0..90).filter(|row| row % 3 == 0).collect();
        wrong.iter().for_each(|&row| y[row] += 15.0 + row as f64);
        assert_eq!(rows_of(&in_relation(&[&ones, &x], &y)), wrong);
    }

    /// The rate is measured, printed, and bounded.
    #[test]
    fn clean_data_seldom_loses_a_row() {
        let trials = 200;
        for (name, sample) in [("normal", noise as fn(&mut Generator) -> f64), ("Laplace", laplace)]
        {
            for rows in [15_usize, 60, 400] {
                let mut random = Generator::new(rows as u64);
                let time: Vec<f64> = (0..rows).map(|row| row as f64).collect();
                let ones = vec![1.0; rows];
                let (mut series, mut relation, mut lost) = (0, 0, 0);
                for _ in 0..trials {
                    let y: Vec<f64> =
                        (0..rows).map(|row| warmup(row) + sample(&mut random)).collect();
                    let found = in_series(&time, &y);
                    series += usize::from(!found.is_empty());
                    lost += found.len();
                    let y: Vec<f64> = time.iter().map(|x| 3.0 * x + sample(&mut random)).collect();
                    let found = in_relation(&[&ones, &time], &y);
                    relation += usize::from(!found.is_empty());
                    lost += found.len();
                }
                let rate = lost as f64 / (2 * trials * rows) as f64;
                println!(
                    "{name} noise, {rows} rows: of {trials} clean runs {series} series and \
                     {relation} relations lose a row; {:.4} % of the rows",
                    100.0 * rate
                );
                if name == "normal" {
                    assert!(series <= trials / 20 && relation <= trials / 20, "{rows} rows");
                }
                assert!(rate < 0.005, "{name}, {rows} rows: {rate}");
            }
        }
    }
}
