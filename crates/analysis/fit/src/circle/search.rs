//! Searches what is not linear: the periods of cyclic errors, the shapes and widths of reversal spikes.
//!
//! One after the other the term is taken that removes most of what set-up, linear causes and those found before leave, each
//! candidate without its share in them. Periods lie between 2.5 steps of the readings and a fifth of the circle's double
//! diameter: a longer one is a form of straightness.

use trueup_numerics::least_squares::normal_equations::{dot, solve};

use super::{
    record::CircleRecord,
    term_selection::{TermColumn, TermGroup, linear_columns, setup_columns},
    terms::{CircleTerm, SpikeShape, WavePhase, angle_since_reversal_rad},
};

/// Minimum gain of a candidate, in variances of the residual: a wave by chance in 10⁻⁴ of circles.
const MIN_GAIN_RESIDUAL_VARIANCES: f64 = 30.0;
/// Rounds of a search, and of a look at each that was found.
const MAX_SEARCH_ROUNDS: usize = 3;
/// The most that is searched for.
const MAX_SELECTED_CANDIDATES: usize = 9;
/// Shapes whose sum is that of the spikes of an axis.
const MAX_SPIKE_SHAPES: usize = 3;
/// Periods in the diameter, at least.
const MIN_PERIODS_PER_DIAMETER: f64 = 2.5;
/// Steps of the frequency in one over the diameter.
const PERIODS_PER_DIAMETER_STEP: f64 = 0.3;
/// The most frequencies of an axis.
const MAX_FREQUENCIES: usize = 400;
/// Candidates that are looked at closely.
const MAX_REFINED_CANDIDATES: usize = 16;
/// Widths of spikes at half their height, in degrees.
const SPIKE_FWHMS_DEG: [f64; 9] = [0.8, 1.2, 1.8, 2.6, 3.6, 5.0, 7.0, 10.0, 14.0];

/// Terms that are searched for together.
#[derive(Clone, Debug)]
struct TermGroupCandidate {
    unit: TermGroup,
    terms: Vec<CircleTerm>,
}

/// A candidate with its columns.
type CandidateColumns = (TermGroupCandidate, Vec<Vec<f64>>);

/// Returns the columns of the cyclic errors and spikes that the record seems to have.
#[must_use]
pub(crate) fn search_nonlinear_terms(record: &CircleRecord) -> Vec<TermColumn> {
    let candidates = (0..2).flat_map(|axis| {
        [cyclic_candidates(record, axis), spike_candidates(record, axis)].concat()
    });
    let candidates: Vec<CandidateColumns> = candidates
        .map(|candidate| {
            let columns = candidate.term_columns(record);
            (candidate, columns)
        })
        .collect();
    let mut found: Vec<TermGroupCandidate> = Vec::new();
    for _ in 0..MAX_SEARCH_ROUNDS {
        let before = found.len();
        add_best_candidates(record, &candidates, &mut found);
        if found.len() == before {
            break;
        }
        // Each again, now that the others are known.
        for at in 0..found.len() {
            let others: Vec<&TermGroupCandidate> = found
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != at)
                .map(|entry| entry.1)
                .collect();
            let basis = OrthogonalBasis::from_candidates(record, &others);
            let again = refine_candidate(&basis, record, &found[at]);
            // The shape of a spike was chosen next to others that have changed.
            let is_own = |candidate: &TermGroupCandidate| {
                candidate.unit == again.unit && matches!(candidate.unit, TermGroup::Spikes(_))
            };
            let other = find_best_candidate(
                &basis,
                candidates.iter().filter(|(candidate, _)| is_own(candidate)),
            );
            let other = other.map(|(_, candidate)| refine_candidate(&basis, record, candidate));
            let gain = |candidate: &TermGroupCandidate| basis.gain(&candidate.term_columns(record));
            found[at] = match other {
                Some(other) if gain(&other) > gain(&again) => other,
                _ => again,
            };
        }
    }
    let mut numbered = Vec::new();
    for (number, candidate) in found.into_iter().enumerate() {
        let unit = match candidate.unit {
            TermGroup::Cyclic(axis, _) => TermGroup::Cyclic(axis, number),
            other => other,
        };
        let columns =
            candidate.terms.into_iter().map(|term| TermColumn { unit: unit.clone(), term });
        numbered.extend(columns);
    }
    numbered
}

/// Adds the candidate that removes most, until none removes enough.
fn add_best_candidates(
    record: &CircleRecord,
    candidates: &[CandidateColumns],
    found: &mut Vec<TermGroupCandidate>,
) {
    let mut basis = OrthogonalBasis::from_candidates(record, &found.iter().collect::<Vec<_>>());
    while found.len() < MAX_SELECTED_CANDIDATES {
        let free = candidates
            .iter()
            .filter(|(candidate, _)| !is_redundant_candidate(record, found, candidate));
        let Some((gain, candidate)) = find_best_candidate(&basis, free) else { return };
        let count = candidate.terms.len() as f64;
        if gain < (MIN_GAIN_RESIDUAL_VARIANCES + 2.0 * (count - 2.0)) * basis.residual_variance() {
            return;
        }
        let candidate = refine_candidate(&basis, record, candidate);
        candidate.term_columns(record).into_iter().for_each(|column| basis.add_column(column));
        found.push(candidate);
    }
}

/// Returns the candidate that removes most, and how much.
fn find_best_candidate<'c>(
    basis: &OrthogonalBasis,
    candidates: impl Iterator<Item = &'c CandidateColumns>,
) -> Option<(f64, &'c TermGroupCandidate)> {
    let mut rough: Vec<_> =
        candidates.map(|candidate| (basis.approximate_gain(&candidate.1), candidate)).collect();
    rough.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
    let close = rough
        .iter()
        .take(MAX_REFINED_CANDIDATES)
        .map(|(_, candidate)| (basis.gain(&candidate.1), &candidate.0));
    close.max_by(|a, b| a.0.total_cmp(&b.0))
}

/// Returns whether a period next to this one is found already, or as many shapes of the spikes of this axis as may be: their
/// sum is the shape.
fn is_redundant_candidate(
    record: &CircleRecord,
    found: &[TermGroupCandidate],
    candidate: &TermGroupCandidate,
) -> bool {
    let of_unit = found.iter().filter(|other| other.unit == candidate.unit);
    if matches!(candidate.unit, TermGroup::Spikes(_)) && of_unit.count() >= MAX_SPIKE_SHAPES {
        return true;
    }
    found.iter().any(|other| match (&other.unit, &candidate.unit) {
        (TermGroup::Cyclic(a, _), TermGroup::Cyclic(b, _)) if a == b => {
            let [there, here] = [&other.terms[0], &candidate.terms[0]].map(cyclic_period_mm);
            // Less than a period more in the diameter.
            (1.0 / there - 1.0 / here).abs() * 2.0 * record.radius_mm < 1.0
        }
        _ => false,
    })
}

impl TermGroupCandidate {
    fn term_columns(&self, record: &CircleRecord) -> Vec<Vec<f64>> {
        self.terms.iter().map(|term| term.basis_column(record)).collect()
    }
}

fn cyclic_period_mm(term: &CircleTerm) -> f64 {
    if let CircleTerm::Cyclic { period_mm, .. } = term { *period_mm } else { f64::NAN }
}

fn cyclic_candidate(axis: usize, period_mm: f64) -> TermGroupCandidate {
    let terms = [WavePhase::Sine, WavePhase::Cosine].map(|wave| CircleTerm::Cyclic {
        axis,
        period_mm,
        wave,
    });
    TermGroupCandidate { unit: TermGroup::Cyclic(axis, 0), terms: terms.into() }
}

/// Returns the waves of an axis that the record can show.
fn cyclic_candidates(record: &CircleRecord, axis: usize) -> Vec<TermGroupCandidate> {
    let diameter = 2.0 * record.radius_mm;
    let steps = record.rows.windows(2).filter(|pair| pair[0].pass == pair[1].pass);
    let mut ways: Vec<f64> =
        steps.map(|pair| (pair[1].at_mm[axis] - pair[0].at_mm[axis]).abs()).collect();
    ways.sort_unstable_by(f64::total_cmp);
    // Nine tenths of the steps are shorter.
    let Some(step) = ways.get(ways.len() * 9 / 10) else { return Vec::new() };
    let shortest = (2.5 * step).max(0.5);
    let most = (diameter / shortest / PERIODS_PER_DIAMETER_STEP) as usize;
    let first = (MIN_PERIODS_PER_DIAMETER / PERIODS_PER_DIAMETER_STEP).ceil() as usize;
    let last = most.min(first + MAX_FREQUENCIES);
    (first..=last)
        .map(|n| cyclic_candidate(axis, diameter / (n as f64 * PERIODS_PER_DIAMETER_STEP)))
        .collect()
}

/// Returns the spikes of an axis, at both ends and in both directions.
fn spike_candidates(record: &CircleRecord, axis: usize) -> Vec<TermGroupCandidate> {
    let step = record.covered_arc_rad() / record.rows.len() as f64 * pass_count(record);
    let senses: Vec<f64> =
        [1.0, -1.0].into_iter().filter(|direction| record.has_direction(*direction)).collect();
    let of = |(shape, width): (SpikeShape, f64)| {
        let ends =
            [true, false].into_iter().flat_map(|end| senses.iter().map(move |sense| (end, *sense)));
        let terms = ends.map(|(is_positive, sense)| CircleTerm::Spike {
            axis,
            is_positive,
            sense,
            shape,
            width,
        });
        // A part of a circle does not have all reversals.
        let is_seen = |term: &CircleTerm| {
            let CircleTerm::Spike { is_positive, sense, .. } = *term else { return false };
            let near = |row: &&super::record::CircleReading| {
                let since = angle_since_reversal_rad(row, axis, is_positive);
                row.sense * sense > 0.0 && (-width..2.0 * width).contains(&since)
            };
            record.rows.iter().filter(near).count() >= 2
        };
        let terms = terms.filter(is_seen).collect();
        TermGroupCandidate { unit: TermGroup::Spikes(axis), terms }
    };
    let widths =
        SPIKE_FWHMS_DEG.into_iter().map(f64::to_radians).filter(|width| *width > 1.2 * step);
    let all = widths.flat_map(|width| SpikeShape::ALL.map(|shape| (shape, width)));
    all.map(of).filter(|candidate| !candidate.terms.is_empty()).collect()
}

/// Returns the number of passes.
fn pass_count(record: &CircleRecord) -> f64 {
    record.rows.chunk_by(|a, b| a.pass == b.pass).count() as f64
}

/// Returns the candidate with the period or the width that removes most.
fn refine_candidate(
    basis: &OrthogonalBasis,
    record: &CircleRecord,
    candidate: &TermGroupCandidate,
) -> TermGroupCandidate {
    let gain = |candidate: &TermGroupCandidate| basis.gain(&candidate.term_columns(record));
    let scaled = |candidate: &TermGroupCandidate, factor: f64| {
        let mut other = candidate.clone();
        for term in &mut other.terms {
            match term {
                CircleTerm::Cyclic { period_mm, .. } => *period_mm *= factor,
                CircleTerm::Spike { width, .. } => *width *= factor,
                _ => {}
            }
        }
        other
    };
    // To the middle between neighbours of the grid first.
    let mut step = match candidate.terms[0] {
        CircleTerm::Cyclic { period_mm, .. } => {
            0.5 * PERIODS_PER_DIAMETER_STEP * period_mm / (2.0 * record.radius_mm)
        }
        _ => 0.2,
    };
    let (mut best, mut most) = (candidate.clone(), gain(candidate));
    for _ in 0..9 {
        for factor in [1.0 + step, 1.0 / (1.0 + step)] {
            let other = scaled(&best, factor);
            let its = gain(&other);
            if its > most {
                (best, most) = (other, its);
            }
        }
        step *= 0.6;
    }
    best
}

/// Columns made orthogonal, and what they leave.
struct OrthogonalBasis {
    columns: Vec<Vec<f64>>,
    left: Vec<f64>,
}

impl OrthogonalBasis {
    /// Of the set-up, the linear causes and `found`.
    fn from_candidates(record: &CircleRecord, found: &[&TermGroupCandidate]) -> Self {
        let left = record.rows.iter().map(|row| row.um).collect();
        let mut basis = Self { columns: Vec::new(), left };
        for column in setup_columns(record).iter().chain(&linear_columns(record)) {
            basis.add_column(column.term.basis_column(record));
        }
        found
            .iter()
            .flat_map(|candidate| candidate.term_columns(record))
            .for_each(|column| basis.add_column(column));
        basis
    }

    /// Takes the share of the columns here off `column`; `None` where nothing of it is left.
    fn orthogonalise(&self, column: &[f64]) -> Option<Vec<f64>> {
        let length = dot(column, column);
        let mut rest = column.to_vec();
        // Twice: once leaves rounding.
        for _ in 0..2 {
            for own in &self.columns {
                let share = dot(own, &rest);
                rest.iter_mut().zip(own).for_each(|(rest, own)| *rest -= share * own);
            }
        }
        let left = dot(&rest, &rest);
        (left > 1e-6 * length && left > 0.0).then(|| {
            let scale = left.sqrt().recip();
            rest.iter_mut().for_each(|value| *value *= scale);
            rest
        })
    }

    fn add_column(&mut self, column: Vec<f64>) {
        let Some(own) = self.orthogonalise(&column) else { return };
        let share = dot(&own, &self.left);
        self.left.iter_mut().zip(&own).for_each(|(left, own)| *left -= share * own);
        self.columns.push(own);
    }

    fn residual_variance(&self) -> f64 {
        let degrees = self.left.len().saturating_sub(self.columns.len()).max(1) as f64;
        dot(&self.left, &self.left) / degrees
    }

    /// Returns at least roughly what the columns remove: of columns with a share in those here it is less than they do.
    fn approximate_gain(&self, columns: &[Vec<f64>]) -> f64 {
        let of = |column: &Vec<f64>| {
            let length = dot(column, column);
            if length > 0.0 { dot(column, &self.left).powi(2) / length } else { 0.0 }
        };
        columns.iter().map(of).sum()
    }

    /// Returns the squares that the columns remove.
    fn gain(&self, columns: &[Vec<f64>]) -> f64 {
        let apart: Vec<Vec<f64>> =
            columns.iter().filter_map(|column| self.orthogonalise(column)).collect();
        let solution = solve(&apart, &self.left, None, 0.0);
        apart
            .iter()
            .zip(&solution.coefficients)
            .map(|(column, um)| um * dot(column, &self.left))
            .sum()
    }
}
