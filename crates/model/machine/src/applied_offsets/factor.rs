//! The factor by which a machine applies the offsets of a bridge: 1 is right, −1 is the wrong sign, 0 is not engaged,
//! 0.5 and 2 are a radius for a diameter, an offset that is added twice, or a wrong unit.
//!
//! ```text
//! measured = error + factor·offset + noise
//! error    = c(run) + Σ gᵢ·pᵢ        pᵢ the parts of the model, gᵢ free: a wrong gain is not a wrong factor
//! ```
//!
//! While a bridge is engaged its offset is −Σpᵢ, so that only factor − g is seen. The two are separated by the
//! contrast of rows with and without the offset. The factor is therefore estimated by an instrument (two-stage least
//! squares): the part of the offset that follows from "engaged or not" and from the model, free of all that the model
//! explains. From an engaged record alone this part is nothing, and the factor stays unknown, whatever the noise of
//! a thermometer would pretend. Intervals hold the memory of the noise ([`trueup_numerics::noise`]).

use trueup_numerics::noise::RowSpacings;

use super::{
    UncompensatedRun,
    factor_estimate::{FactorEstimate, UNIT_FACTOR_TOLERANCE},
    troubleshooting::repeat_run_instruction,
    two_stage_least_squares::{TwoStageLeastSquares, compute_row_spacings},
};
use crate::{
    InputFileError, Location,
    effect::Quantity,
    keys::reader::is_temperature_column,
    machine_file::Machine,
    predict::{PREDICTION_COLUMNS, RunPredictor},
    run_file::RunFile,
    sections::{ElongationSource, Warmup},
};

/// A smaller offset is none, in µm: half a step of the wire.
const ZERO_OFFSET_TOLERANCE_UM: f64 = 0.005;
/// More rows than these make the estimate no better than the model is: of more, each n-th is used.
const MAX_ESTIMATION_ROWS: usize = 20_000;
/// Lags that the model may lack, as shares of the longest run.
const CANDIDATE_LAG_FRACTIONS: [f64; 3] = [0.01, 0.05, 0.2];
/// Thermometers that the error may depend on.
const MAX_TEMPERATURE_COVARIATES: usize = 8;

/// The verdict of some runs on the factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OffsetApplication {
    /// No offset was applied in any row.
    NoOffset,
    /// The CNC applies the offset once, as it should.
    Once(FactorEstimate),
    /// It applies it otherwise.
    OtherFactor(FactorEstimate),
    /// The runs do not decide it: too few rows with, or without, the offset.
    Unknown(Option<FactorEstimate>),
}

impl OffsetApplication {
    fn from_factor(factor: Option<FactorEstimate>) -> Self {
        match factor {
            Some(factor) if factor.excludes_one() => Self::OtherFactor(factor),
            Some(factor) if factor.confirms_one() => Self::Once(factor),
            unsure => Self::Unknown(unsure),
        }
    }

    /// Returns the factor, where there is one.
    #[must_use]
    pub fn factor(self) -> Option<FactorEstimate> {
        match self {
            Self::NoOffset => None,
            Self::Once(factor) | Self::OtherFactor(factor) => Some(factor),
            Self::Unknown(factor) => factor,
        }
    }
}

/// Estimates the factor from `runs` of one machine, all of them together. Without a machine file the error may be made of
/// what else was recorded.
#[must_use]
pub fn estimate_offset_application(
    runs: &[UncompensatedRun<'_>],
    machine: Option<&Machine>,
    quantity: Quantity,
) -> OffsetApplication {
    let is_applied = |run: &UncompensatedRun<'_>| {
        run.applied_offset_um(quantity)
            .is_some_and(|um| um.iter().any(|um| um.abs() > ZERO_OFFSET_TOLERANCE_UM))
    };
    if !runs.iter().any(is_applied) {
        return OffsetApplication::NoOffset;
    }
    let factor = CompleteRows::from_runs(runs, machine, quantity).and_then(|rows| {
        let is_on = |um: &f64| f64::from(u8::from(um.abs() > ZERO_OFFSET_TOLERANCE_UM));
        let on: Vec<f64> = rows.offset_um.iter().map(is_on).collect();
        let engaged = |column: &Vec<f64>| on.iter().zip(column).map(|(on, um)| on * um).collect();
        let mut instruments: Vec<Vec<f64>> = rows.of_offset.iter().map(engaged).collect();
        instruments.push(on);
        TwoStageLeastSquares {
            measured_um: &rows.measured_um,
            offset_um: &rows.offset_um,
            explained: &rows.explained,
            instruments: &instruments,
            steps: &rows.steps,
        }
        .estimate_factor()
    });
    OffsetApplication::from_factor(factor)
}

/// Returns whether nothing that is correlated with the offset is left in what was measured while the bridge was engaged: what it
/// applies is right, whatever its constants and the CNC make of it.
#[must_use]
pub fn is_fully_compensated(runs: &[UncompensatedRun<'_>], quantity: Quantity) -> bool {
    let Some(rows) = CompleteRows::from_runs(runs, None, quantity) else { return false };
    let constants = &rows.explained[..rows.constants];
    let estimate = TwoStageLeastSquares {
        measured_um: &rows.measured_um,
        offset_um: &rows.offset_um,
        explained: constants,
        instruments: std::slice::from_ref(&rows.offset_um),
        steps: &rows.steps,
    };
    // What is measured contains (factor − g) times the offset.
    estimate.estimate_factor().is_some_and(|FactorEstimate { value, ci95: [low, high] }| {
        value.abs() < UNIT_FACTOR_TOLERANCE && high - low < 4.0 * UNIT_FACTOR_TOLERANCE
    })
}

/// Checks that constants of the machine may be made of `runs`, in which a factor of 1 is taken for granted.
///
/// # Errors
/// The CNC applies the offsets otherwise than once; or the bridge was engaged in all rows, and what is left is correlated with
/// its offset, so that a CNC that does so would become a constant. The rule says what to do.
pub fn require_unit_factor(
    runs: &[UncompensatedRun<'_>],
    machine: Option<&Machine>,
    quantity: Quantity,
) -> Result<(), InputFileError> {
    let rule = match estimate_offset_application(runs, machine, quantity) {
        OffsetApplication::NoOffset | OffsetApplication::Once(_) => return Ok(()),
        OffsetApplication::Unknown(_) if is_fully_compensated(runs, quantity) => return Ok(()),
        OffsetApplication::OtherFactor(factor) => {
            format!("{} {}", factor.describe(), FactorEstimate::troubleshooting_steps().join(" "))
        }
        OffsetApplication::Unknown(_) => format!(
            "measured_{}_um is correlated with the offset of the bridge. A constant of the \
             machine is wrong, or the CNC does not apply the offset exactly once. {}",
            quantity.name(),
            repeat_run_instruction()
        ),
    };
    let applies = |run: &&UncompensatedRun<'_>| run.applied_offset_um(quantity).is_some();
    let path = runs.iter().find(applies).map_or_else(|| "".as_ref(), |run| run.path());
    Err(InputFileError::new(Location::start_of_file(path), rule))
}

/// Readings of two runs of one program, the second with the bridge engaged.
#[derive(Clone, Copy, Debug)]
pub struct PairedRuns<'p> {
    /// When each was taken, in s, or its number: rising.
    pub at: &'p [f64],
    /// Measured with the bridge less measured without it, in µm.
    pub difference_um: &'p [f64],
    /// The offset of the second less that of the first, in µm; NaN where it is not known.
    pub offset_um: &'p [f64],
    /// The prediction of the machine file for the second less that for the first, in µm; NaN where there is none.
    pub predicted_um: &'p [f64],
}

impl PairedRuns<'_> {
    /// Estimates the factor: the first run says what the error of the second is.
    #[must_use]
    pub fn estimate_offset_application(&self) -> OffsetApplication {
        let is_known =
            |row: &usize| self.difference_um[*row].is_finite() && self.offset_um[*row].is_finite();
        let rows: Vec<usize> = (0..self.at.len()).filter(is_known).collect();
        let of = |all: &[f64]| rows.iter().map(|row| all[*row]).collect::<Vec<f64>>();
        let offset_um = of(self.offset_um);
        if offset_um.iter().all(|um| um.abs() <= ZERO_OFFSET_TOLERANCE_UM) {
            return OffsetApplication::NoOffset;
        }
        let predicted = of(self.predicted_um);
        let is_predicted = predicted.iter().all(|um| um.is_finite());
        let mut explained = vec![vec![1.0; rows.len()]];
        explained.extend(is_predicted.then_some(predicted));
        let starts: Vec<bool> = (0..rows.len()).map(|row| row == 0).collect();
        let steps = compute_row_spacings(&of(self.at), &starts);
        let estimate = TwoStageLeastSquares {
            measured_um: &of(self.difference_um),
            offset_um: &offset_um,
            explained: &explained,
            instruments: std::slice::from_ref(&offset_um),
            steps: &steps,
        };
        OffsetApplication::from_factor(estimate.estimate_factor())
    }
}

/// Rows of all runs in which everything is known.
struct CompleteRows {
    measured_um: Vec<f64>,
    offset_um: Vec<f64>,
    /// Columns that the offset is made of while the bridge is engaged.
    of_offset: Vec<Vec<f64>>,
    /// Columns that the error may be made of: a constant for each run, the parts of the model, what else was recorded.
    explained: Vec<Vec<f64>>,
    /// How many of them are the constants, which stand first.
    constants: usize,
    steps: RowSpacings,
}

impl CompleteRows {
    fn from_runs(
        runs: &[UncompensatedRun<'_>],
        machine: Option<&Machine>,
        quantity: Quantity,
    ) -> Option<Self> {
        let name = format!("measured_{}_um", quantity.name());
        let runs: Vec<&UncompensatedRun<'_>> =
            runs.iter().filter(|run| run.column(&name).is_some()).collect();
        let [mut measured, mut offset, mut at] = [const { Vec::new() }; 3];
        let mut of_run: Vec<usize> = Vec::new();
        for (number, run) in runs.iter().enumerate() {
            let rows = run.row_count();
            let none = vec![0.0; rows];
            let applied = run.applied_offset_um(quantity).unwrap_or(&none);
            let error = run.column(&name).unwrap_or(&none);
            measured.extend(error.iter().zip(applied).map(|(error, offset)| error + offset));
            offset.extend_from_slice(applied);
            let numbers: Vec<f64> = (0..rows).map(|row| row as f64).collect();
            at.extend_from_slice(run.column("time_s").unwrap_or(&numbers));
            of_run.resize(of_run.len() + rows, number);
        }
        // A column that lacks a tenth of its values would cost as many rows.
        let is_whole = |column: &Vec<f64>| {
            column.iter().filter(|value| value.is_nan()).count() * 10 < column.len().max(1)
        };
        let mut columns = collect_covariates(&runs, quantity);
        columns.retain(is_whole);
        let of_offset = match machine {
            Some(machine) => vec![predict_all_runs(machine, &runs, quantity)?],
            None => columns.clone(),
        };
        let variants =
            machine.map(|machine| model_variants(machine, quantity, max_run_duration_s(&runs)));
        let variants = variants.iter().flatten();
        columns.extend(
            variants
                .filter_map(|variant| predict_all_runs(variant, &runs, quantity))
                .filter(is_whole),
        );
        columns.extend(of_offset.iter().cloned());
        let is_known = |row: &usize| {
            let all = [&measured, &offset, &at];
            all.into_iter().chain(&columns).all(|column| column[*row].is_finite())
        };
        let known: Vec<usize> = (0..measured.len()).filter(is_known).collect();
        let every = known.len().div_ceil(MAX_ESTIMATION_ROWS).max(1);
        let known: Vec<usize> = known.into_iter().step_by(every).collect();
        let pick = |all: &Vec<f64>| known.iter().map(|row| all[*row]).collect::<Vec<f64>>();
        let constant = |number: usize| {
            let is_of = known.iter().map(|row| f64::from(u8::from(of_run[*row] == number)));
            is_of.collect::<Vec<f64>>()
        };
        let mut explained: Vec<Vec<f64>> = (0..runs.len()).map(constant).collect();
        explained.extend(columns.iter().map(pick));
        let starts: Vec<bool> = (0..known.len())
            .map(|row| row == 0 || of_run[known[row]] != of_run[known[row - 1]])
            .collect();
        let steps = compute_row_spacings(&pick(&at), &starts);
        let [measured_um, offset_um] = [&measured, &offset].map(pick);
        let of_offset = of_offset.iter().map(pick).collect();
        let constants = runs.len();
        Some(Self { measured_um, offset_um, of_offset, explained, constants, steps })
    }
}

/// Returns the time that the longest run takes, in s; 0 where there is no time.
fn max_run_duration_s(runs: &[&UncompensatedRun<'_>]) -> f64 {
    let longest = runs.iter().filter_map(|run| {
        let times = run.column("time_s")?;
        let [low, high] =
            times.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| {
                [low.min(*at), high.max(*at)]
            });
        (high > low).then_some(high - low)
    });
    longest.fold(0.0, f64::max)
}

/// Returns the machine without each part whose size may be wrong by itself, and with other lags: a fault of the model
/// is not to be taken for one of the CNC.
fn model_variants(machine: &Machine, quantity: Quantity, longest_s: f64) -> Vec<Machine> {
    let mut all = Vec::new();
    if !machine.terms.is_empty() {
        all.push(Machine { terms: Vec::new(), ..machine.clone() });
    }
    let axis = quantity.axis().map(|axis| axis.index());
    if let Some(axis) = axis {
        let mut without = machine.clone();
        if without.axes[axis].thermal.take().is_some() {
            all.push(without);
        }
        let mut without = machine.clone();
        if without.spindle.source.take().is_some() {
            all.push(without);
        }
    }
    for share in CANDIDATE_LAG_FRACTIONS.into_iter().filter(|_| longest_s > 0.0) {
        let mut late = machine.clone();
        let grown = late.spindle.temperature.as_mut().map(|temperature| &mut temperature.lag_s);
        let expanded = axis.and_then(|axis| late.axes[axis].thermal.as_mut());
        let lags = grown.into_iter().chain(expanded.map(|expanded| &mut expanded.lag_s));
        if lags.map(|lag_s| *lag_s += share * longest_s).count() > 0 {
            all.push(late);
        }
        if let (Some(ElongationSource::Warmup), Some(warmup)) =
            (machine.spindle.source, &machine.spindle.warmup)
        {
            let mut slower = machine.clone();
            let warm_s = warmup.lag_s + (warmup.warm_s - warmup.lag_s) * (1.0 + share);
            slower.spindle.warmup = Some(Warmup { warm_s, ..warmup.clone() });
            all.push(slower);
        }
    }
    all
}

/// Returns what `machine` predicts of `quantity` in each row; `None` where a run lacks what that needs.
fn predict_all_runs(
    machine: &Machine,
    runs: &[&UncompensatedRun<'_>],
    quantity: Quantity,
) -> Option<Vec<f64>> {
    let all: Option<Vec<Vec<f64>>> =
        runs.iter().map(|run| predict_um(machine, run, quantity)).collect();
    all.map(|all| all.concat())
}

/// Returns what `machine` predicts of `quantity` in each row, in µm, NaN where a value is missing; `None` where the run
/// lacks a column that the prediction needs.
#[must_use]
pub fn predict_um(machine: &Machine, run: &RunFile, quantity: Quantity) -> Option<Vec<f64>> {
    let index = Quantity::ALL.iter().position(|candidate| *candidate == quantity)?;
    let mut run = run.clone();
    run.remove_columns(|name| PREDICTION_COLUMNS.contains(&name));
    let predictor = RunPredictor::new(machine, &run).ok()?;
    let um = predictor.model_values().map(|values| values.to_array()[index]).collect();
    Some(um)
}

/// Returns what else an error may depend on: temperatures, the speed, the load; for an axis its place and direction, and
/// temperatures along it.
fn collect_covariates(runs: &[&UncompensatedRun<'_>], quantity: Quantity) -> Vec<Vec<f64>> {
    let joined = |name: &str| -> Option<Vec<f64>> {
        let all: Option<Vec<&[f64]>> = runs.iter().map(|run| run.column(name)).collect();
        all.map(|all| all.concat())
    };
    let names = runs.iter().flat_map(|run| run.columns()).map(|column| column.name.as_str());
    let mut temperatures: Vec<&str> = names.filter(|name| is_temperature_column(name)).collect();
    temperatures.sort_unstable();
    temperatures.dedup();
    temperatures.truncate(MAX_TEMPERATURE_COVARIATES);
    let mut all: Vec<Vec<f64>> = temperatures.iter().filter_map(|name| joined(name)).collect();
    if let Some(axis) = quantity.axis().map(|axis| axis.name())
        && let Some(mm) = joined(&format!("{axis}_mm"))
    {
        let range = mm.iter().copied().filter(|mm| mm.is_finite());
        let range_mm = range.fold(1.0, |most: f64, mm| most.max(mm.abs()));
        let place: Vec<f64> = mm.iter().map(|mm| mm / range_mm).collect();
        let along = |c: &Vec<f64>| c.iter().zip(&place).map(|(c, at)| c * at).collect();
        let along: Vec<Vec<f64>> = all.iter().map(along).collect();
        all.extend(along);
        // The course of an error over its axis: a cubic takes most of it.
        all.extend([1, 2, 3].map(|power| place.iter().map(|at| at.powi(power)).collect()));
        all.extend(joined(&format!("dir_{axis}")));
    }
    all.extend(joined("spindle_rpm").map(|rpm| rpm.iter().map(|rpm| rpm * rpm).collect()));
    all.extend(["load_n", "sensor_counts"].into_iter().filter_map(joined));
    all
}
