//! Keeps the terms that a record shows.
//!
//! All terms are fitted together, in rows that the most likely noise with a memory makes independent. The term with the
//! smallest |t| goes, until each is beyond `Unit::limit`. A cause whose share of the readings is below the floor goes too.
//! The causes left are tried on arcs that were left out in turn, each against the model without it, and against every
//! other cause in its place: one that predicts as well is an alternative.

use trueup_numerics::{
    blocks::rms,
    least_squares::normal::{NormalSolution, dot, solve},
    noise::{self, Noise, Steps, Whitener},
};

use super::{
    record::Record,
    terms::{Moving, Term, Wave},
};

/// |t| of a term that a cause may rest on: one false claim in more than a thousand circles of thirty terms.
const CERTAIN: f64 = 4.8;
/// |t| of a further harmonic of a straightness that is certain.
const FURTHER: f64 = 3.0;
/// |t| of a pair of waves or of the heights of a spike, which were searched for.
const SEARCHED: f64 = 5.5;
/// All these are that much larger where the noise has a memory: how long it is, is known from what the causes leave.
const OF_MEMORY: f64 = 1.35;
/// The smallest share of a cause, RMS, in standard deviations of the noise.
const FLOOR: f64 = 0.12;
/// The same in µm: no instrument resolves less.
const FLOOR_UM: f64 = 0.05;
/// The share of a spike's height that its tail may look like a step or an ellipse, RMS; a form.
const TAIL_AS_STEP: f64 = 0.05;
const TAIL_AS_FORM: f64 = 0.025;
/// Arcs of a pass that are left out in turn.
const ARCS: usize = 12;
/// Differences of BIC below this are none.
const SCORE_GAP: f64 = 6.0;
/// The largest number of a harmonic.
pub(crate) const MAX_HARMONIC: u8 = 7;

/// Terms that come and go together: one cause of one axis.
#[derive(Clone, Debug, PartialEq)]
pub enum Unit {
    /// Radius and centres: always there.
    Setup,
    /// A single term.
    Single(Term),
    /// The even forms of a straightness of the second axis along the first (sines), or of the first along the second.
    Even(Wave),
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

impl Unit {
    /// Returns |t| that its largest term must reach.
    fn limit(&self) -> f64 {
        match self {
            Self::Spikes(_) | Self::Cyclic(..) => SEARCHED,
            _ => CERTAIN,
        }
    }

    /// Returns whether terms leave it one by one.
    fn is_loose(&self) -> bool {
        !matches!(self, Self::Cyclic(..) | Self::Spikes(_))
    }
}

/// A column of the fit.
#[derive(Clone, Debug)]
pub struct Column {
    /// The cause that it is part of.
    pub unit: Unit,
    /// The term.
    pub term: Term,
}

/// A fitted term.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// The cause that it is part of.
    pub unit: Unit,
    /// The term.
    pub term: Term,
    /// Its coefficient, in µm.
    pub um: f64,
    /// The standard error.
    pub standard_error_um: f64,
}

/// Causes that the record shows.
#[derive(Clone, Debug)]
pub struct Chosen {
    /// The terms, those of the set-up first.
    pub terms: Vec<Fitted>,
    /// The residual by row, in µm.
    pub residual_um: Vec<f64>,
    /// The standard deviation of the noise, in µm.
    pub noise_um: f64,
    /// Of each cause: its name among the units, what it gains on left-out arcs, and the causes that do as well.
    pub tried: Vec<Tried>,
}

/// A cause on left-out arcs.
#[derive(Clone, Debug)]
pub struct Tried {
    /// The cause.
    pub unit: Unit,
    /// RMS of its share of the readings, in µm.
    pub rms_um: f64,
    /// RMS on left-out arcs without it and with it, in µm.
    pub left_out_um: [f64; 2],
    /// Whether left-out arcs gain by more than the standard error.
    pub is_gain: bool,
    /// Causes that do as well in its place.
    pub alternatives: Vec<Unit>,
}

/// Returns the columns of the set-up.
#[must_use]
pub fn setup(record: &Record) -> Vec<Column> {
    let of = |setup| [Term::Radius(setup), Term::Centre(setup, 0), Term::Centre(setup, 1)];
    (0..record.setups).flat_map(of).map(|term| Column { unit: Unit::Setup, term }).collect()
}

/// Returns the columns of all causes that are linear: those of one direction alone are left out where there is one only.
#[must_use]
pub fn linear(record: &Record) -> Vec<Column> {
    let single = |term| Column { unit: Unit::Single(term), term };
    let mut columns: Vec<Column> =
        [Term::Squareness, Term::Scale, Term::Backlash(0), Term::Backlash(1)].map(single).into();
    if record.has_sense(1.0) && record.has_sense(-1.0) {
        columns.extend([Term::Servo, Term::Lateral(0), Term::Lateral(1)].map(single));
    }
    // A harmonic needs rows, and on a part of a circle the higher ones are combinations of the others.
    let most = match () {
        () if record.arc() < 5.5 => 4,
        () if record.rows.len() < 10 * usize::from(MAX_HARMONIC) => 5,
        () => MAX_HARMONIC,
    };
    for number in 3..=most {
        for wave in [Wave::Sine, Wave::Cosine] {
            let unit = match (number % 2, wave) {
                (1, wave) => Unit::Even(wave),
                (_, Wave::Sine) => Unit::OddSines,
                (_, Wave::Cosine) => Unit::EvenCosines,
            };
            columns.push(Column { unit, term: Term::Form(number, wave) });
        }
    }
    let moving = [Moving::Radius, Moving::CentreU, Moving::CentreV];
    columns.extend(moving.map(|it| Column { unit: Unit::Drift, term: Term::Drift(it) }));
    columns
}

/// The rows of a record as they are fitted: whitened.
struct Fit<'r> {
    record: &'r Record,
    raw: Vec<Vec<f64>>,
    columns: Vec<Column>,
    white: Vec<Vec<f64>>,
    y: Vec<f64>,
    steps: Steps,
    /// The factor on limits of t.
    caution: f64,
}

impl<'r> Fit<'r> {
    fn new(record: &'r Record, columns: Vec<Column>) -> Self {
        let raw: Vec<Vec<f64>> = columns.iter().map(|it| it.term.column(record)).collect();
        let y = record.rows.iter().map(|row| row.um).collect();
        let mut before = None;
        let steps = record.rows.iter().map(|row| {
            let is_same = before.replace(row.pass) == Some(row.pass);
            if is_same { 1.0 } else { f64::INFINITY }
        });
        let steps = Steps(steps.collect());
        Self { record, white: raw.clone(), raw, columns, y, steps, caution: 1.0 }
    }

    /// Makes the rows independent, by the noise that all columns leave.
    fn whiten(&mut self) {
        let solution = solve(&self.raw, &self.raw_y(), None, 0.0);
        let residual = self.residual(&solution);
        let longest = noise::longest_memory(residual.len());
        let noise = noise::estimate(&residual, &self.steps, longest, self.columns.len());
        if noise != Noise::WHITE {
            self.caution = OF_MEMORY;
            let whitener = Whitener::new(noise, &self.steps);
            self.white = whitener.apply_all(&self.raw);
            self.y = whitener.apply(&self.raw_y());
        }
    }

    fn raw_y(&self) -> Vec<f64> {
        self.record.rows.iter().map(|row| row.um).collect()
    }

    fn residual(&self, solution: &NormalSolution) -> Vec<f64> {
        residual(&self.raw, &self.raw_y(), &solution.coefficients)
    }

    /// Returns the coefficients with their standard errors.
    fn solved(&self) -> (NormalSolution, Vec<f64>) {
        let solution = solve(&self.white, &self.y, None, 0.0);
        let left = residual(&self.white, &self.y, &solution.coefficients);
        let degrees = left.len().saturating_sub(self.columns.len()).max(1) as f64;
        let variance = dot(&left, &left) / degrees;
        let inverse = solution.inverse();
        let errors =
            (0..self.columns.len()).map(|at| (variance * inverse[(at, at)]).max(0.0).sqrt());
        let errors = errors.collect();
        (solution, errors)
    }

    fn remove(&mut self, is_out: impl Fn(&Column) -> bool) {
        let keep: Vec<bool> = self.columns.iter().map(|column| !is_out(column)).collect();
        let mut flags = [keep.iter(), keep.iter(), keep.iter()];
        let [a, b, c] = &mut flags;
        self.columns.retain(|_| *a.next().unwrap_or(&true));
        self.raw.retain(|_| *b.next().unwrap_or(&true));
        self.white.retain(|_| *c.next().unwrap_or(&true));
    }

    /// Removes what is not certain, the least certain first.
    fn eliminate(&mut self) {
        loop {
            let (solution, errors) = self.solved();
            let t = |at: usize| {
                let (um, error) = (solution.coefficients[at], errors[at]);
                if error > 0.0 { (um / error).abs() } else { 0.0 }
            };
            // A cause is as certain as its most certain term; those that were searched count with all of theirs.
            let of_unit = |unit: &Unit| {
                let own = (0..self.columns.len()).filter(|at| self.columns[*at].unit == *unit);
                own.map(t).fold(0.0, f64::max)
            };
            let worst = (0..self.columns.len())
                .filter(|at| self.columns[*at].unit != Unit::Setup)
                .filter_map(|at| {
                    let unit = &self.columns[at].unit;
                    let needed = if of_unit(unit) < self.caution * unit.limit() {
                        unit.limit()
                    } else if unit.is_loose() {
                        FURTHER
                    } else {
                        0.0
                    };
                    let needed = self.caution * needed;
                    (t(at) < needed).then(|| (at, t(at) / needed))
                })
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let Some((at, _)) = worst else { return };
            let column = self.columns[at].clone();
            self.remove(|it| {
                it.unit == column.unit && (!column.unit.is_loose() || it.term == column.term)
            });
        }
    }

    /// Returns the share of some columns in each row.
    fn sum_um(&self, is_one: impl Fn(&Column) -> bool, coefficients: &[f64]) -> Vec<f64> {
        let mut sum = vec![0.0; self.y.len()];
        for ((column, raw), um) in self.columns.iter().zip(&self.raw).zip(coefficients) {
            if is_one(column) {
                sum.iter_mut().zip(raw).for_each(|(sum, x)| *sum += um * x);
            }
        }
        sum
    }

    /// Returns RMS of the share of a cause.
    fn share_um(&self, unit: &Unit, coefficients: &[f64]) -> f64 {
        rms(&self.sum_um(|column| column.unit == *unit, coefficients))
    }

    /// Returns the height of the highest spike.
    fn peak_um(&self, coefficients: &[f64]) -> f64 {
        let spikes = self.sum_um(|column| matches!(column.unit, Unit::Spikes(_)), coefficients);
        spikes.into_iter().fold(0.0, |most, um| um.abs().max(most))
    }

    fn units(&self) -> Vec<Unit> {
        let mut units = Vec::new();
        for column in self.columns.iter().filter(|column| column.unit != Unit::Setup) {
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
pub fn choose(record: &Record, found: &[Column]) -> Chosen {
    let all = [setup(record), linear(record), found.to_vec()].concat();
    let mut fit = Fit::new(record, all);
    fit.whiten();
    fit.eliminate();
    let noise_um = loop {
        let (solution, _) = fit.solved();
        let noise_um = rms(&fit.residual(&solution));
        let floor = (FLOOR * noise_um).max(FLOOR_UM);
        let share = |unit: &Unit| fit.share_um(unit, &solution.coefficients);
        let peak = fit.peak_um(&solution.coefficients);
        let least = |unit: &Unit| match unit {
            // The peak of a spike is local.
            Unit::Spikes(_) => 0.3 * floor,
            Unit::Single(_) => floor.max(TAIL_AS_STEP * peak),
            Unit::Even(_) | Unit::OddSines | Unit::EvenCosines => floor.max(TAIL_AS_FORM * peak),
            _ => floor,
        };
        let Some(small) = fit.units().into_iter().find(|unit| share(unit) < least(unit)) else {
            break noise_um;
        };
        fit.remove(|column| column.unit == small);
    };
    let (solution, errors) = fit.solved();
    let terms = fit.columns.iter().zip(&solution.coefficients).zip(errors).map(
        |((column, um), standard_error_um)| Fitted {
            unit: column.unit.clone(),
            term: column.term,
            um: *um,
            standard_error_um,
        },
    );
    let terms = terms.collect();
    let residual_um = fit.residual(&solution);
    let tried = fit.units().into_iter().map(|unit| tried(&fit, unit, &solution.coefficients));
    let tried = tried.collect();
    Chosen { terms, residual_um, noise_um, tried }
}

/// Tries a cause on left-out arcs, and others in its place.
fn tried(fit: &Fit<'_>, unit: Unit, coefficients: &[f64]) -> Tried {
    let without: Vec<Vec<f64>> = kept(fit, |it| it.unit != unit);
    let blocks = arcs(fit.record);
    // An arc that is left out takes its own spikes with it: no other arc predicts their heights.
    let is_local = |it: &Column| matches!(it.unit, Unit::Spikes(_)) && it.unit != unit;
    let mut y = fit.y.clone();
    for ((column, white), um) in fit.columns.iter().zip(&fit.white).zip(coefficients) {
        if is_local(column) {
            y.iter_mut().zip(white).for_each(|(y, x)| *y -= um * x);
        }
    }
    let models = [kept(fit, |it| it.unit != unit && !is_local(it)), kept(fit, |it| !is_local(it))];
    let [before, after] = models.map(|columns| {
        if matches!(unit, Unit::Spikes(_)) {
            return residual(&columns, &y, &solve(&columns, &y, None, 0.0).coefficients);
        }
        held_out(&columns, &y, &blocks)
    });
    let count = blocks.iter().max().map_or(0, |last| last + 1);
    let mut gains = vec![0.0; count];
    for ((block, before), after) in blocks.iter().zip(&before).zip(&after) {
        gains[*block] += before * before - after * after;
    }
    let gain: f64 = gains.iter().sum();
    let mean = gain / count as f64;
    let scatter: f64 = gains.iter().map(|it| (it - mean).powi(2)).sum();
    let error = (count as f64 / (count as f64 - 1.0).max(1.0) * scatter).sqrt();
    let alternatives = alternatives(fit, &unit, &without);
    let rms_um = fit.share_um(&unit, coefficients);
    Tried {
        unit,
        rms_um,
        left_out_um: [rms(&before), rms(&after)],
        is_gain: gain > error,
        alternatives,
    }
}

/// Returns the whitened columns for which `is_kept` holds.
fn kept(fit: &Fit<'_>, is_kept: impl Fn(&Column) -> bool) -> Vec<Vec<f64>> {
    let both = fit.columns.iter().zip(&fit.white);
    both.filter(|(column, _)| is_kept(column)).map(|(_, white)| white.clone()).collect()
}

/// Returns the other linear causes that leave as little in the place of `unit`.
fn alternatives(fit: &Fit<'_>, unit: &Unit, without: &[Vec<f64>]) -> Vec<Unit> {
    let here = fit.units();
    let own = fit.columns.iter().filter(|it| it.unit == *unit).count() as f64;
    let rows = fit.y.len() as f64;
    let squares = |columns: &[Vec<f64>]| {
        let left = residual(columns, &fit.y, &solve(columns, &fit.y, None, 0.0).coefficients);
        dot(&left, &left)
    };
    let with = squares(&fit.white);
    let others = linear(fit.record);
    let mut units: Vec<Unit> = Vec::new();
    for column in &others {
        if !here.contains(&column.unit) && !units.contains(&column.unit) {
            units.push(column.unit.clone());
        }
    }
    let longest = noise::longest_memory(fit.y.len());
    let noise = noise::estimate(
        &fit.residual(&solve(&fit.raw, &fit.raw_y(), None, 0.0)),
        &fit.steps,
        longest,
        fit.columns.len(),
    );
    let whitener = Whitener::new(noise, &fit.steps);
    units.retain(|other| {
        let own_terms = others.iter().filter(|column| column.unit == *other);
        let raw: Vec<Vec<f64>> = own_terms.map(|column| column.term.column(fit.record)).collect();
        let count = raw.len() as f64;
        let white = if fit.white == fit.raw { raw } else { whitener.apply_all(&raw) };
        let swapped = squares(&[without, &white].concat());
        rows * (swapped / with).ln() + (count - own) * rows.ln() < SCORE_GAP
    });
    units
}

/// Returns the arc of each row: a part of a pass.
fn arcs(record: &Record) -> Vec<usize> {
    let mut first = 0;
    let mut arcs = Vec::with_capacity(record.rows.len());
    for pass in record.rows.chunk_by(|a, b| a.pass == b.pass) {
        let count = ARCS.min(pass.len());
        arcs.extend((0..pass.len()).map(|at| first + at * count / pass.len()));
        first += count;
    }
    arcs
}

/// Returns the residual of each row from the fit to all other arcs.
fn held_out(columns: &[Vec<f64>], y: &[f64], blocks: &[usize]) -> Vec<f64> {
    let count = blocks.iter().max().map_or(0, |last| last + 1);
    let mut left = y.to_vec();
    for block in 0..count {
        let mask: Vec<bool> = blocks.iter().map(|it| *it != block).collect();
        let solution = solve(columns, y, Some(&mask), 0.0);
        for (row, left) in left.iter_mut().enumerate().filter(|(row, _)| !mask[*row]) {
            let parts = columns.iter().zip(&solution.coefficients);
            *left -= parts.map(|(column, um)| um * column[row]).sum::<f64>();
        }
    }
    left
}
