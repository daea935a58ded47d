//! An open question: two models that the runs cannot distinguish, and how far a further run would.
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
    least_squares::normal_equations::dot,
    noise::{NoiseModel, Whitener},
};

use super::ExpectedSeparation;
use crate::{
    data::{DataTable, RowGroups},
    fit::{FitProblem, FittedModel, ParameterCovariance, estimate_parameter_covariance, jacobian},
    judgement::TermJudgement,
    model::Model,
    parameter_estimates::mean_row_interval_s,
    search::SearchOutcome,
    term_kind::TermKind,
};

/// Two models that the runs do not distinguish.
#[derive(Clone, Debug)]
pub(crate) struct ModelPair {
    /// The name of each cause, with its column.
    pub causes: [String; 2],
    sides: [Hypothesis; 2],
    /// Of one reading, in µm².
    variance: f64,
    /// Share of the variance that is white.
    white: f64,
    /// The noise's correlation time, in s or rows.
    memory_s: f64,
}

#[derive(Clone, Debug)]
struct Hypothesis {
    model: Model,
    spread: ParameterCovariance,
}

/// How far a run sets two models apart.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Separation {
    /// Expected −2·ln of the likelihood ratio.
    pub gap: f64,
    /// The largest difference in µm.
    pub difference_um: f64,
}

/// Returns the open questions of what was `judged`, in its order: each cause that is not claimed, and the best that
/// cannot be distinguished from it.
pub(crate) fn find_indistinguishable_pairs(
    problem: &FitProblem,
    found: &SearchOutcome,
    judged: &[TermJudgement],
) -> Vec<ModelPair> {
    let open =
        judged.iter().filter(|judgement| !judgement.doubts.is_empty()).filter_map(|judgement| {
            let rival = judgement
                .rivals
                .iter()
                .find(|rival| rival.is_indistinguishable_from(judgement.cause()))?;
            let causes = [describe_cause(judgement.cause()), describe_cause(&rival.cause)];
            Some(ModelPair::new(problem, found, causes, rival.fitted.clone()))
        });
    open.collect()
}

fn describe_cause(cause: &TermKind) -> String {
    match cause.column() {
        Some(column) => format!("{} of {column}", cause.name()),
        None => cause.name().into(),
    }
}

impl ModelPair {
    fn new(
        problem: &FitProblem,
        found: &SearchOutcome,
        causes: [String; 2],
        other: FittedModel,
    ) -> Self {
        let own = found.fitted.clone();
        let rows = own.residual.len() as f64;
        let variance = own.sum / (rows - own.degrees as f64).max(1.0);
        let side = |fitted: FittedModel| Hypothesis {
            spread: estimate_parameter_covariance(problem, &fitted, found.noise),
            model: fitted.model,
        };
        Self {
            causes,
            sides: [side(own), side(other)],
            variance: variance.max(f64::MIN_POSITIVE),
            white: found.noise.white,
            memory_s: found.noise.memory
                * problem.groups.size as f64
                * mean_row_interval_s(problem),
        }
    }

    /// Returns the expected separation of the two causes by `run`.
    pub(crate) fn expected_separation(&self, run: &DataTable) -> ExpectedSeparation {
        let Separation { gap, difference_um } = self.separation(run);
        ExpectedSeparation {
            causes: self.causes.clone(),
            difference_um,
            noise_um: self.variance.sqrt(),
            score_gap: gap,
        }
    }

    /// Returns how far `run` sets the two apart, whatever it measures.
    pub(crate) fn separation(&self, run: &DataTable) -> Separation {
        let day = self.prepare_run(run);
        let [one, other] = [0, 1].map(|n| day.problem.predict(&self.sides[n].model));
        let apart: Vec<f64> = one.iter().zip(&other).map(|(one, other)| one - other).collect();
        let difference_um = apart.iter().fold(0.0, |most: f64, um| most.max(um.abs()));
        let gaps = [0, 1].map(|n| self.quadratic_form_and_log_det(&self.sides[n], &day, &apart)[0]);
        Separation { gap: f64::min(gaps[0], gaps[1]), difference_um }
    }

    /// Returns what `run` has measured for the first against the second: −2·ln of the likelihood ratio, above 0 for the
    /// first.
    pub(crate) fn likelihood_ratio_statistic(&self, run: &DataTable) -> f64 {
        let day = self.prepare_run(run);
        let measured = day.problem.groups.means(&run.measured);
        let [one, other] = [0, 1].map(|n| {
            let predicted = day.problem.predict(&self.sides[n].model);
            let left: Vec<f64> = measured.iter().zip(predicted).map(|(m, p)| m - p).collect();
            let [squares, spread] = self.quadratic_form_and_log_det(&self.sides[n], &day, &left);
            squares + spread
        });
        other - one
    }

    fn prepare_run(&self, run: &DataTable) -> PreparedRun {
        let data = Arc::new(run.clone());
        let groups = RowGroups::new(&data, &data.used, 1);
        let problem = FitProblem::new(data, groups);
        let memory = self.memory_s / mean_row_interval_s(&problem);
        let noise =
            if memory > 0.0 { NoiseModel { memory, white: self.white } } else { NoiseModel::WHITE };
        let whitener = Whitener::new(noise, &problem.groups.steps);
        PreparedRun { problem, whitener }
    }

    /// lᵀ·V⁻¹·l of a list, and ln det V but for what is the same for both sides.
    fn quadratic_form_and_log_det(
        &self,
        side: &Hypothesis,
        day: &PreparedRun,
        list: &[f64],
    ) -> [f64; 2] {
        let list = day.whitener.whiten(list);
        let (parameters, columns) = jacobian(&day.problem, &side.model);
        let known: Vec<(usize, Vec<f64>)> = parameters
            .iter()
            .zip(&columns)
            .filter_map(|(parameter, column)| {
                Some((side.spread.parameter_row(parameter)?, day.whitener.whiten(column)))
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
struct PreparedRun {
    problem: FitProblem,
    whitener: Whitener,
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use trueup_machine::{MachineFile, RunFile, effect::BoardTerm, machine_file::Quantity};

    use super::*;
    use crate::{fit::fit, term_kind::ModelPart};

    /// Twice each of 0, 1, 4 and 9 times (1000 r/min)², with a load of this many N for each, and these readings.
    fn table(load_n: f64, um: impl Fn(f64, f64) -> f64) -> DataTable {
        let mut text = String::from("spindle_rpm,load_n,measured_elongation_um\n");
        for off in [1.0, -1.0] {
            for krpm in [0.0, 1.0, 2.0, 3.0] {
                let squared: f64 = krpm * krpm;
                text += &format!("{},{},{}\n", 1e3 * krpm, load_n * squared, um(squared, off));
            }
        }
        let file = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
        let machine = MachineFile::parse(file, Path::new("m.toml")).expect("a machine file");
        let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
        DataTable::new(&machine, &[run], Quantity::Elongation).expect("comparable")
    }

    /// Speed or load: in the training both were always together. q = (n/1000)², the load 100·q N, 2 µm for each q,
    /// and ±0.5 µm that nothing explains.
    ///
    /// ```text
    /// training: Σq² = 2·(0 + 1 + 16 + 81) = 196, left: Σ = 8·0.25 = 2 over 8 − 1 degrees: σ² = 2/7
    /// the value of either side is known to σ²/196 (speed) and σ²/196/100² (load)
    /// a run of the same speeds without load: Δ = 2·q, J = q for speed and 0 for load
    /// gap by speed: 4/σ²·(Σq² − Σq²²/(196 + Σq²)) = 4·3.5·98 = 1372       by load: 4/σ²·196 = 2744
    /// ```
    #[test]
    fn what_is_not_known_of_a_value_halves_the_gap_of_a_run_as_long_as_the_training() {
        let data = table(100.0, |q, off| 2.0 * q + 0.5 * off);
        let groups = RowGroups::new(&data, &data.used.clone(), 1);
        let problem = FitProblem::new(data, groups);
        let side = |form: BoardTerm| {
            let kind = TermKind::from_board_term(None, &form).expect("a form of the board");
            let model =
                Model { parts: vec![ModelPart { values: vec![0.0], kind }], constant_um: None };
            let fitted = fit(&problem, &model, None);
            assert!((fitted.sum - 2.0).abs() < 1e-9, "{}", fitted.sum);
            Hypothesis {
                spread: estimate_parameter_covariance(&problem, &fitted, NoiseModel::WHITE),
                model: fitted.model,
            }
        };
        let question = ModelPair {
            causes: ["speed".into(), "load".into()],
            sides: [side(BoardTerm::Speed(0.0)), side(BoardTerm::Load(0.0))],
            variance: 2.0 / 7.0,
            white: 1.0,
            memory_s: 0.0,
        };
        let air = table(0.0, |q, _| 2.0 * q);
        let Separation { gap, difference_um } = question.separation(&air);
        assert!((gap - 1372.0).abs() < 1e-3 && (difference_um - 18.0).abs() < 1e-6, "{gap}");
        // It measures what speed predicts: the squares of load are 2744, and speed has paid ln(1 + 1) for its freedom.
        let score = question.likelihood_ratio_statistic(&air);
        assert!((score - (2744.0 - std::f64::consts::LN_2)).abs() < 1e-3, "{score}");
        // With load as in the training nothing is apart.
        assert!(question.separation(&table(100.0, |q, _| 2.0 * q)).gap < 1e-9);
    }
}
