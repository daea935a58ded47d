//! Keeps the terms that a record shows.
//!
//! All terms are fitted together, in rows that the most likely noise with a memory makes independent. The term with the
//! smallest |t| goes, until each is beyond `TermGroup::min_t_value`. A cause whose share of the readings is below the floor goes too.
//! The causes left are tried on arcs that were held out in turn, each against the model without it, and against every
//! other cause in its place: one that predicts as well is an alternative.

use trueup_numerics::{
    block_resampling::rms,
    least_squares::normal_equations::{NormalSolution, dot, solve},
    noise::{self, NoiseModel, RowSpacings, Whitener},
};

use super::{
    record::CircleRecord,
    terms::{CircleTerm, DriftingParameter, WavePhase},
};

/// |t| of a term that a cause may rest on: one false claim in more than a thousand circles of thirty terms.
const MIN_TERM_T_VALUE: f64 = 4.8;
/// |t| of a further harmonic of a straightness that is certain.
const MIN_HARMONIC_T_VALUE: f64 = 3.0;
/// |t| of a pair of waves or of the heights of a spike, which were searched for.
const MIN_SEARCHED_TERM_T_VALUE: f64 = 5.5;
/// All these are that much larger where the noise has a memory: how long it is, is known from what the causes leave.
const AUTOCORRELATION_T_VALUE_FACTOR: f64 = 1.35;
/// The smallest share of a cause, RMS, in standard deviations of the noise.
const MIN_CONTRIBUTION_TO_NOISE_RATIO: f64 = 0.12;
/// The same in µm: no instrument resolves less.
const MIN_CONTRIBUTION_RMS_UM: f64 = 0.05;
/// The share of a spike's height that its tail may look like a step or an ellipse, RMS; a form.
const MIN_SINGLE_TERM_TO_SPIKE_RATIO: f64 = 0.05;
const MIN_FORM_TO_SPIKE_RATIO: f64 = 0.025;
/// Arcs of a pass that are held out in turn.
const MAX_ARCS_PER_PASS: usize = 12;
/// Differences of BIC below this are none.
const MIN_BIC_DIFFERENCE: f64 = 6.0;
/// The largest number of a harmonic.
pub(crate) const MAX_HARMONIC_ORDER: u8 = 7;

/// Terms that come and go together: one cause of one axis.
#[derive(Clone, Debug, PartialEq)]
pub enum TermGroup {
    /// Radius and centres: always there.
    Setup,
    /// A single term.
    Single(CircleTerm),
    /// The even forms of a straightness of the second axis along the first (sines), or of the first along the second.
    Even(WavePhase),
    /// The forms of which a circle does not show the axis: sin 4φ, sin 6φ.
    OddSines,
    /// The forms of the positions of both axes: cos 4φ, cos 6φ.
    EvenCosines,
    /// Drift.
    Drift,
    /// The spikes of an axis.
    Spikes(usize),
    /// A cyclic error of an axis, by its number among those found.
    Cyclic(usize, usize),
}

impl TermGroup {
    /// Returns |t| that its largest term must reach.
    fn min_t_value(&self) -> f64 {
        match self {
            Self::Spikes(_) | Self::Cyclic(..) => MIN_SEARCHED_TERM_T_VALUE,
            _ => MIN_TERM_T_VALUE,
        }
    }

    /// Returns whether terms leave it one by one.
    fn is_pruned_term_by_term(&self) -> bool {
        !matches!(self, Self::Cyclic(..) | Self::Spikes(_))
    }
}

/// A column of the fit.
#[derive(Clone, Debug)]
pub struct TermColumn {
    /// The cause that it is part of.
    pub unit: TermGroup,
    /// The term.
    pub term: CircleTerm,
}

/// A fitted term.
#[derive(Clone, Debug)]
pub struct FittedTerm {
    /// The cause that it is part of.
    pub unit: TermGroup,
    /// The term.
    pub term: CircleTerm,
    /// Its coefficient, in µm.
    pub um: f64,
    /// The standard error.
    pub standard_error_um: f64,
}

/// Causes that the record shows.
#[derive(Clone, Debug)]
pub struct SelectedModel {
    /// The terms, those of the set-up first.
    pub terms: Vec<FittedTerm>,
    /// The residual by row, in µm.
    pub residual_um: Vec<f64>,
    /// The standard deviation of the noise, in µm.
    pub noise_um: f64,
    /// Of each cause: its name among the units, what it gains on held-out arcs, and the causes that do as well.
    pub tried: Vec<CrossValidatedTermGroup>,
}

/// A cause on held-out arcs.
#[derive(Clone, Debug)]
pub struct CrossValidatedTermGroup {
    /// The cause.
    pub unit: TermGroup,
    /// RMS of its share of the readings, in µm.
    pub rms_um: f64,
    /// RMS on held-out arcs without it and with it, in µm.
    pub held_out_um: [f64; 2],
    /// Whether held-out arcs gain by more than the standard error.
    pub is_gain: bool,
    /// Causes that do as well in its place.
    pub alternatives: Vec<TermGroup>,
}

/// Returns the columns of the set-up.
#[must_use]
pub(crate) fn setup_columns(record: &CircleRecord) -> Vec<TermColumn> {
    let of = |setup| {
        [CircleTerm::Radius(setup), CircleTerm::Centre(setup, 0), CircleTerm::Centre(setup, 1)]
    };
    (0..record.setups)
        .flat_map(of)
        .map(|term| TermColumn { unit: TermGroup::Setup, term })
        .collect()
}

/// Returns the columns of all causes that are linear: those of one direction alone are omitted where there is one only.
#[must_use]
pub(crate) fn linear_columns(record: &CircleRecord) -> Vec<TermColumn> {
    let single = |term| TermColumn { unit: TermGroup::Single(term), term };
    let mut columns: Vec<TermColumn> = [
        CircleTerm::Squareness,
        CircleTerm::Scale,
        CircleTerm::Backlash(0),
        CircleTerm::Backlash(1),
    ]
    .map(single)
    .into();
    if record.has_direction(1.0) && record.has_direction(-1.0) {
        columns.extend(
            [CircleTerm::Servo, CircleTerm::Lateral(0), CircleTerm::Lateral(1)].map(single),
        );
    }
    // A harmonic needs rows, and on a part of a circle the higher ones are combinations of the others.
    let most = match () {
        () if record.covered_arc_rad() < 5.5 => 4,
        () if record.rows.len() < 10 * usize::from(MAX_HARMONIC_ORDER) => 5,
        () => MAX_HARMONIC_ORDER,
    };
    for number in 3..=most {
        for wave in [WavePhase::Sine, WavePhase::Cosine] {
            let unit = match (number % 2, wave) {
                (1, wave) => TermGroup::Even(wave),
                (_, WavePhase::Sine) => TermGroup::OddSines,
                (_, WavePhase::Cosine) => TermGroup::EvenCosines,
            };
            columns.push(TermColumn { unit, term: CircleTerm::Form(number, wave) });
        }
    }
    let moving = DriftingParameter::ALL;
    columns.extend(
        moving.map(|drift| TermColumn { unit: TermGroup::Drift, term: CircleTerm::Drift(drift) }),
    );
    columns
}

/// The rows of a record as they are fitted: whitened.
struct WhitenedRegression<'r> {
    record: &'r CircleRecord,
    raw: Vec<Vec<f64>>,
    columns: Vec<TermColumn>,
    white: Vec<Vec<f64>>,
    y: Vec<f64>,
    steps: RowSpacings,
    /// The factor on limits of t.
    caution: f64,
}

impl<'r> WhitenedRegression<'r> {
    fn new(record: &'r CircleRecord, columns: Vec<TermColumn>) -> Self {
        let raw: Vec<Vec<f64>> =
            columns.iter().map(|column| column.term.basis_column(record)).collect();
        let y = record.rows.iter().map(|row| row.um).collect();
        let mut before = None;
        let steps = record.rows.iter().map(|row| {
            let is_same = before.replace(row.pass) == Some(row.pass);
            if is_same { 1.0 } else { f64::INFINITY }
        });
        let steps = RowSpacings(steps.collect());
        Self { record, white: raw.clone(), raw, columns, y, steps, caution: 1.0 }
    }

    /// Makes the rows independent, by the noise that all columns leave.
    fn whiten(&mut self) {
        let solution = solve(&self.raw, &self.unwhitened_readings_um(), None, 0.0);
        let residual = self.residual(&solution);
        let longest = noise::max_autocorrelation_time(residual.len());
        let noise = noise::estimate(&residual, &self.steps, longest, self.columns.len());
        if noise != NoiseModel::WHITE {
            self.caution = AUTOCORRELATION_T_VALUE_FACTOR;
            let whitener = Whitener::new(noise, &self.steps);
            self.white = whitener.whiten_columns(&self.raw);
            self.y = whitener.whiten(&self.unwhitened_readings_um());
        }
    }

    fn unwhitened_readings_um(&self) -> Vec<f64> {
        self.record.rows.iter().map(|row| row.um).collect()
    }

    fn residual(&self, solution: &NormalSolution) -> Vec<f64> {
        residual(&self.raw, &self.unwhitened_readings_um(), &solution.coefficients)
    }

    /// Returns the coefficients with their standard errors.
    fn solve_with_standard_errors(&self) -> (NormalSolution, Vec<f64>) {
        let solution = solve(&self.white, &self.y, None, 0.0);
        let left = residual(&self.white, &self.y, &solution.coefficients);
        let degrees = left.len().saturating_sub(self.columns.len()).max(1) as f64;
        let variance = dot(&left, &left) / degrees;
        let inverse = solution.unscaled_covariance();
        let errors =
            (0..self.columns.len()).map(|at| (variance * inverse[(at, at)]).max(0.0).sqrt());
        let errors = errors.collect();
        (solution, errors)
    }

    fn remove_columns(&mut self, is_out: impl Fn(&TermColumn) -> bool) {
        let keep: Vec<bool> = self.columns.iter().map(|column| !is_out(column)).collect();
        let mut flags = [keep.iter(), keep.iter(), keep.iter()];
        let [a, b, c] = &mut flags;
        self.columns.retain(|_| *a.next().unwrap_or(&true));
        self.raw.retain(|_| *b.next().unwrap_or(&true));
        self.white.retain(|_| *c.next().unwrap_or(&true));
    }

    /// Removes what is not certain, the least certain first.
    fn backward_elimination(&mut self) {
        loop {
            let (solution, errors) = self.solve_with_standard_errors();
            let t = |at: usize| {
                let (um, error) = (solution.coefficients[at], errors[at]);
                if error > 0.0 { (um / error).abs() } else { 0.0 }
            };
            // A cause is as certain as its most certain term; those that were searched count with all of theirs.
            let of_unit = |unit: &TermGroup| {
                let own = (0..self.columns.len()).filter(|at| self.columns[*at].unit == *unit);
                own.map(t).fold(0.0, f64::max)
            };
            let worst = (0..self.columns.len())
                .filter(|at| self.columns[*at].unit != TermGroup::Setup)
                .filter_map(|at| {
                    let unit = &self.columns[at].unit;
                    let needed = if of_unit(unit) < self.caution * unit.min_t_value() {
                        unit.min_t_value()
                    } else if unit.is_pruned_term_by_term() {
                        MIN_HARMONIC_T_VALUE
                    } else {
                        0.0
                    };
                    let needed = self.caution * needed;
                    (t(at) < needed).then(|| (at, t(at) / needed))
                })
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let Some((at, _)) = worst else { return };
            let column = self.columns[at].clone();
            self.remove_columns(|other| {
                other.unit == column.unit
                    && (!column.unit.is_pruned_term_by_term() || other.term == column.term)
            });
        }
    }

    /// Returns the share of some columns in each row.
    fn contribution_um(
        &self,
        is_one: impl Fn(&TermColumn) -> bool,
        coefficients: &[f64],
    ) -> Vec<f64> {
        let mut sum = vec![0.0; self.y.len()];
        for ((column, raw), um) in self.columns.iter().zip(&self.raw).zip(coefficients) {
            if is_one(column) {
                sum.iter_mut().zip(raw).for_each(|(sum, x)| *sum += um * x);
            }
        }
        sum
    }

    /// Returns RMS of the share of a cause.
    fn contribution_rms_um(&self, unit: &TermGroup, coefficients: &[f64]) -> f64 {
        rms(&self.contribution_um(|column| column.unit == *unit, coefficients))
    }

    /// Returns the height of the highest spike.
    fn max_spike_height_um(&self, coefficients: &[f64]) -> f64 {
        let spikes = self
            .contribution_um(|column| matches!(column.unit, TermGroup::Spikes(_)), coefficients);
        spikes.into_iter().fold(0.0, |most, um| um.abs().max(most))
    }

    fn term_groups(&self) -> Vec<TermGroup> {
        let mut units = Vec::new();
        for column in self.columns.iter().filter(|column| column.unit != TermGroup::Setup) {
            if !units.contains(&column.unit) {
                units.push(column.unit.clone());
            }
        }
        units
    }
}

fn residual(columns: &[Vec<f64>], y: &[f64], coefficients: &[f64]) -> Vec<f64> {
    let mut left = y.to_vec();
    for (column, um) in columns.iter().zip(coefficients) {
        left.iter_mut().zip(column).for_each(|(left, x)| *left -= um * x);
    }
    left
}

/// Chooses among the set-up, the linear causes and `found`, which were searched for.
#[must_use]
pub fn select_terms(record: &CircleRecord, found: &[TermColumn]) -> SelectedModel {
    let all = [setup_columns(record), linear_columns(record), found.to_vec()].concat();
    let mut fit = WhitenedRegression::new(record, all);
    fit.whiten();
    fit.backward_elimination();
    let noise_um = loop {
        let (solution, _) = fit.solve_with_standard_errors();
        let noise_um = rms(&fit.residual(&solution));
        let floor = (MIN_CONTRIBUTION_TO_NOISE_RATIO * noise_um).max(MIN_CONTRIBUTION_RMS_UM);
        let share = |unit: &TermGroup| fit.contribution_rms_um(unit, &solution.coefficients);
        let peak = fit.max_spike_height_um(&solution.coefficients);
        let least = |unit: &TermGroup| match unit {
            // The peak of a spike is local.
            TermGroup::Spikes(_) => 0.3 * floor,
            TermGroup::Single(_) => floor.max(MIN_SINGLE_TERM_TO_SPIKE_RATIO * peak),
            TermGroup::Even(_) | TermGroup::OddSines | TermGroup::EvenCosines => {
                floor.max(MIN_FORM_TO_SPIKE_RATIO * peak)
            }
            _ => floor,
        };
        let Some(small) = fit.term_groups().into_iter().find(|unit| share(unit) < least(unit))
        else {
            break noise_um;
        };
        fit.remove_columns(|column| column.unit == small);
    };
    let (solution, errors) = fit.solve_with_standard_errors();
    let terms = fit.columns.iter().zip(&solution.coefficients).zip(errors).map(
        |((column, um), standard_error_um)| FittedTerm {
            unit: column.unit.clone(),
            term: column.term,
            um: *um,
            standard_error_um,
        },
    );
    let terms = terms.collect();
    let residual_um = fit.residual(&solution);
    let tried = fit
        .term_groups()
        .into_iter()
        .map(|unit| cross_validate(&fit, unit, &solution.coefficients));
    let tried = tried.collect();
    SelectedModel { terms, residual_um, noise_um, tried }
}

/// Tries a cause on held-out arcs, and others in its place.
fn cross_validate(
    fit: &WhitenedRegression<'_>,
    unit: TermGroup,
    coefficients: &[f64],
) -> CrossValidatedTermGroup {
    let without: Vec<Vec<f64>> = select_whitened_columns(fit, |column| column.unit != unit);
    let blocks = arc_indices(fit.record);
    // An arc that is held out takes its own spikes with it: no other arc predicts their heights.
    let is_local =
        |column: &TermColumn| matches!(column.unit, TermGroup::Spikes(_)) && column.unit != unit;
    let mut y = fit.y.clone();
    for ((column, white), um) in fit.columns.iter().zip(&fit.white).zip(coefficients) {
        if is_local(column) {
            y.iter_mut().zip(white).for_each(|(y, x)| *y -= um * x);
        }
    }
    let models = [
        select_whitened_columns(fit, |column| column.unit != unit && !is_local(column)),
        select_whitened_columns(fit, |column| !is_local(column)),
    ];
    let [before, after] = models.map(|columns| {
        if matches!(unit, TermGroup::Spikes(_)) {
            return residual(&columns, &y, &solve(&columns, &y, None, 0.0).coefficients);
        }
        held_out_residuals(&columns, &y, &blocks)
    });
    let count = blocks.iter().max().map_or(0, |last| last + 1);
    let mut gains = vec![0.0; count];
    for ((block, before), after) in blocks.iter().zip(&before).zip(&after) {
        gains[*block] += before * before - after * after;
    }
    let gain: f64 = gains.iter().sum();
    let mean = gain / count as f64;
    let scatter: f64 = gains.iter().map(|gain| (gain - mean).powi(2)).sum();
    let error = (count as f64 / (count as f64 - 1.0).max(1.0) * scatter).sqrt();
    let alternatives = find_alternatives(fit, &unit, &without);
    let rms_um = fit.contribution_rms_um(&unit, coefficients);
    CrossValidatedTermGroup {
        unit,
        rms_um,
        held_out_um: [rms(&before), rms(&after)],
        is_gain: gain > error,
        alternatives,
    }
}

/// Returns the whitened columns for which `is_kept` holds.
fn select_whitened_columns(
    fit: &WhitenedRegression<'_>,
    is_retained: impl Fn(&TermColumn) -> bool,
) -> Vec<Vec<f64>> {
    let both = fit.columns.iter().zip(&fit.white);
    both.filter(|(column, _)| is_retained(column)).map(|(_, white)| white.clone()).collect()
}

/// Returns the other linear causes that leave as little in the place of `unit`.
fn find_alternatives(
    fit: &WhitenedRegression<'_>,
    unit: &TermGroup,
    without: &[Vec<f64>],
) -> Vec<TermGroup> {
    let here = fit.term_groups();
    let own = fit.columns.iter().filter(|column| column.unit == *unit).count() as f64;
    let rows = fit.y.len() as f64;
    let squares = |columns: &[Vec<f64>]| {
        let left = residual(columns, &fit.y, &solve(columns, &fit.y, None, 0.0).coefficients);
        dot(&left, &left)
    };
    let with = squares(&fit.white);
    let others = linear_columns(fit.record);
    let mut units: Vec<TermGroup> = Vec::new();
    for column in &others {
        if !here.contains(&column.unit) && !units.contains(&column.unit) {
            units.push(column.unit.clone());
        }
    }
    let noise = noise::estimate(
        &fit.residual(&solve(&fit.raw, &fit.unwhitened_readings_um(), None, 0.0)),
        &fit.steps,
        noise::max_autocorrelation_time(fit.y.len()),
        fit.columns.len(),
    );
    let whitener = Whitener::new(noise, &fit.steps);
    units.retain(|other| {
        let own_terms = others.iter().filter(|column| column.unit == *other);
        let raw: Vec<Vec<f64>> =
            own_terms.map(|column| column.term.basis_column(fit.record)).collect();
        let count = raw.len() as f64;
        let white = if fit.white == fit.raw { raw } else { whitener.whiten_columns(&raw) };
        let swapped = squares(&[without, &white].concat());
        rows * (swapped / with).ln() + (count - own) * rows.ln() < MIN_BIC_DIFFERENCE
    });
    units
}

/// Returns the arc of each row: a part of a pass.
fn arc_indices(record: &CircleRecord) -> Vec<usize> {
    let mut first = 0;
    let mut arcs = Vec::with_capacity(record.rows.len());
    for pass in record.rows.chunk_by(|a, b| a.pass == b.pass) {
        let count = MAX_ARCS_PER_PASS.min(pass.len());
        arcs.extend((0..pass.len()).map(|at| first + at * count / pass.len()));
        first += count;
    }
    arcs
}

/// Returns the residual of each row from the fit to all other arcs.
fn held_out_residuals(columns: &[Vec<f64>], y: &[f64], blocks: &[usize]) -> Vec<f64> {
    let count = blocks.iter().max().map_or(0, |last| last + 1);
    let mut left = y.to_vec();
    for block in 0..count {
        let mask: Vec<bool> = blocks.iter().map(|other| *other != block).collect();
        let solution = solve(columns, y, Some(&mask), 0.0);
        for (row, left) in left.iter_mut().enumerate().filter(|(row, _)| !mask[*row]) {
            let parts = columns.iter().zip(&solution.coefficients);
            *left -= parts.map(|(column, um)| um * column[row]).sum::<f64>();
        }
    }
    left
}
