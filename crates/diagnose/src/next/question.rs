//! An open question: two models that the runs cannot tell apart, and how far a further run would.
//!
//! The values of neither model are known exactly, and a rival would move its own as far as the runs let it before it
//! is given up. So what is expected of a run is held against the noise and that freedom together:
//!
//! ```text
//! gap = Δᵀ·V⁻¹·Δ        Δ  difference of the two predictions in each row
//!                       V = σ²·R + J·C·Jᵀ    R correlation of the noise; C covariance of the values of the model
//!                                            that is wrong, J what each changes in this run
//! ```
//!
//! which is the expected −2·ln of the likelihood ratio; the smaller of both cases counts.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use trueup_numerics::{
    least_squares::normal::dot,
    noise::{Noise, Whitener},
};

use super::Told;
use crate::{
    data::{Data, Groups},
    fit::{Fitted, Problem, Spread, jacobian, spread},
    judge::Judgement,
    kind::Kind,
    model::Model,
    parameters::step_s,
    search::Found,
};

/// Two models that the runs do not tell apart.
#[derive(Clone, Debug)]
pub(crate) struct Question {
    /// What each says, with its column.
    pub causes: [String; 2],
    sides: [Side; 2],
    /// Of one reading, in µm².
    variance: f64,
    /// Share of the variance that is white.
    white: f64,
    /// The noise's correlation time, in s or rows.
    memory_s: f64,
}

#[derive(Clone, Debug)]
struct Side {
    model: Model,
    spread: Spread,
}

/// How far a run sets two models apart.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Separation {
    /// Expected −2·ln of the likelihood ratio.
    pub gap: f64,
    /// The largest difference in µm.
    pub difference_um: f64,
}

/// The open questions of what was `judged`, in its order: each cause that is not claimed, and the best that cannot be
/// told from it.
pub(crate) fn questions(problem: &Problem, found: &Found, judged: &[Judgement]) -> Vec<Question> {
    let open = judged.iter().filter(|it| !it.doubts.is_empty()).filter_map(|it| {
        let rival = it.rivals.iter().find(|rival| rival.is_open(it.cause()))?;
        let causes = [said(it.cause()), said(&rival.cause)];
        Some(Question::new(problem, found, causes, rival.fitted.clone()))
    });
    open.collect()
}

fn said(cause: &Kind) -> String {
    match cause.column() {
        Some(column) => format!("{} of {column}", cause.name()),
        None => cause.name().into(),
    }
}

impl Question {
    fn new(problem: &Problem, found: &Found, causes: [String; 2], other: Fitted) -> Self {
        let own = found.fitted.clone();
        let rows = own.residual.len() as f64;
        let variance = own.sum / (rows - own.degrees as f64).max(1.0);
        let side = |fitted: Fitted| Side {
            spread: spread(problem, &fitted, found.noise),
            model: fitted.model,
        };
        Self {
            causes,
            sides: [side(own), side(other)],
            variance: variance.max(f64::MIN_POSITIVE),
            white: found.noise.white,
            memory_s: found.noise.memory * problem.groups.size as f64 * step_s(problem),
        }
    }

    /// What `run` will tell.
    pub(crate) fn told(&self, run: &Data) -> Told {
        let Separation { gap, difference_um } = self.separation(run);
        Told {
            causes: self.causes.clone(),
            difference_um,
            noise_um: self.variance.sqrt(),
            score_gap: gap,
        }
    }

    /// How far `run` sets the two apart, whatever it measures.
    pub(crate) fn separation(&self, run: &Data) -> Separation {
        let day = self.day(run);
        let [one, other] = [0, 1].map(|n| day.problem.predicted(&self.sides[n].model));
        let apart: Vec<f64> = one.iter().zip(&other).map(|(one, other)| one - other).collect();
        let difference_um = apart.iter().fold(0.0, |most: f64, um| most.max(um.abs()));
        let gaps = [0, 1].map(|n| self.squares(&self.sides[n], &day, &apart)[0]);
        Separation { gap: f64::min(gaps[0], gaps[1]), difference_um }
    }

    /// What `run` has measured for the first against the second: −2·ln of the likelihood ratio, above 0 for the first.
    pub(crate) fn score(&self, run: &Data) -> f64 {
        let day = self.day(run);
        let measured = day.problem.groups.means(&run.measured);
        let [one, other] = [0, 1].map(|n| {
            let predicted = day.problem.predicted(&self.sides[n].model);
            let left: Vec<f64> = measured.iter().zip(predicted).map(|(m, p)| m - p).collect();
            let [squares, spread] = self.squares(&self.sides[n], &day, &left);
            squares + spread
        });
        other - one
    }

    fn day(&self, run: &Data) -> Day {
        let data = Arc::new(run.clone());
        let groups = Groups::new(&data, &data.used, 1);
        let problem = Problem::new(data, groups);
        let memory = self.memory_s / step_s(&problem);
        let noise = if memory > 0.0 { Noise { memory, white: self.white } } else { Noise::WHITE };
        let whitener = Whitener::new(noise, &problem.groups.steps);
        Day { problem, whitener }
    }

    /// lᵀ·V⁻¹·l of a list, and ln det V but for what is the same for both sides.
    fn squares(&self, side: &Side, day: &Day, list: &[f64]) -> [f64; 2] {
        let list = day.whitener.apply(list);
        let (parameters, columns) = jacobian(&day.problem, &side.model);
        let known: Vec<(usize, Vec<f64>)> = parameters
            .iter()
            .zip(&columns)
            .filter_map(|(parameter, column)| {
                Some((side.spread.place_of(parameter)?, day.whitener.apply(column)))
            })
            .collect();
        let count = known.len();
        let plain = dot(&list, &list) / self.variance;
        if count == 0 {
            return [plain, 0.0];
        }
        let changes = DMatrix::from_fn(count, count, |i, j| dot(&known[i].1, &known[j].1));
        let covariance =
            DMatrix::from_fn(count, count, |i, j| side.spread.covariance(known[i].0, known[j].0));
        let b = DVector::from_fn(count, |i, _| dot(&known[i].1, &list));
        // Woodbury: only as many rows and columns as there are values.
        let middle = DMatrix::identity(count, count) + &covariance * &changes / self.variance;
        let determinant = middle.determinant();
        let Some(freed) = middle.lu().solve(&(&covariance * &b)) else { return [plain, 0.0] };
        let taken = b.dot(&freed) / (self.variance * self.variance);
        [(plain - taken).max(0.0), determinant.max(f64::MIN_POSITIVE).ln()]
    }
}

/// A run that is looked at.
struct Day {
    problem: Problem,
    whitener: Whitener,
}
