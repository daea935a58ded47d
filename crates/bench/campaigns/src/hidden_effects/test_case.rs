//! From a base and its hidden effects to a challenge: sizes, noise, rounding, and the files.

use super::{
    GroundTruth, HiddenEffect, TestCase,
    axis_bench::AxisBench,
    axis_effects,
    cause::{BaseModel, ExpectedDiagnosis, HiddenCause},
    effect_shape::{EffectShape, PredictedRun},
    growth_effects,
    model_equations::fit_line,
    spindle_bench::{ElongationSourceKind, SpindleBench},
};
use trueup_twin::noise::{CorrelatedNoise, RandomStream, rms};

/// Returns the challenge on `base` with `causes` in it.
pub(super) fn build_test_case(
    base: BaseModel,
    causes: &[HiddenCause],
    ratio: f64,
    seed: u64,
    mut stream: RandomStream,
) -> TestCase {
    let (quantity, machine, runs, shapes) = match base {
        BaseModel::Sensor | BaseModel::Temperature | BaseModel::Warmup => {
            let source_kind = match base {
                BaseModel::Sensor => ElongationSourceKind::Sensor,
                BaseModel::Temperature => ElongationSourceKind::Temperature,
                _ => ElongationSourceKind::Warmup,
            };
            let bench = SpindleBench::draw(source_kind, causes, &mut stream);
            let shapes: Vec<EffectShape> = causes
                .iter()
                .filter_map(|&cause| growth_effects::draw_effect_shape(cause, &bench, &mut stream))
                .collect();
            ("elongation", bench.machine_file_toml(), bench.runs, shapes)
        }
        BaseModel::AxisThermal | BaseModel::AxisGeometry => {
            let is_thermal = base == BaseModel::AxisThermal;
            let bench = AxisBench::draw(is_thermal, causes, &mut stream);
            let shapes: Vec<EffectShape> = causes
                .iter()
                .filter_map(|&cause| axis_effects::draw_effect_shape(cause, &bench, &mut stream))
                .collect();
            (bench.quantity, bench.machine_file_toml(), bench.runs, shapes)
        }
    };
    let has_true_zero = quantity == "elongation";
    let imitated: Vec<_> =
        shapes.iter().map(|shape| imitator_residual_ratios(shape, has_true_zero)).collect();
    let (sigma, mut effects, effect_um) = scale_effects(shapes, ratio, has_true_zero, &mut stream);
    // What comes early can only do so by another clock, and that is written down.
    let is_early =
        |effect: &HiddenEffect| effect.parameter("shift_s").is_some_and(|shift_s| shift_s < 0.0);
    let runs = if effects.iter().any(is_early) { add_gauge_clock_column(runs) } else { runs };
    let rho = match causes {
        [HiddenCause::CleanCorrelated] => stream.uniform(0.5, 0.97),
        [HiddenCause::CleanWhite] => 0.0,
        _ if stream.bernoulli(0.5) => 0.0,
        _ => stream.uniform(0.1, 0.7),
    };
    // What would be left of the effect if another cause stood in its place distinguishes the two, by the
    // likelihood of this many independent rows. Less than 6 is a tie by `docs/reference.md`.
    for (effect, (rows, others)) in effects.iter_mut().zip(imitated) {
        let independent = rows * (1.0 - rho) / (1.0 + rho);
        for (cause, share) in others {
            let left = share * effect.rms_um / sigma;
            if independent * (left * left).ln_1p() < 6.0 && !effect.rivals.contains(&cause) {
                effect.rivals.push(cause);
            }
        }
    }
    let expected = causes
        .iter()
        .map(|cause| cause.expected_diagnosis())
        .max_by_key(|diagnosis| *diagnosis as u8);
    let mut truth = GroundTruth {
        effects,
        expected: expected.unwrap_or(ExpectedDiagnosis::Clean),
        noise_rms_um: sigma,
        noise_rho: rho,
        quantum_um: draw_resolution_um(sigma, &mut stream),
        believed_um: Vec::new(),
        effect_um: Vec::new(),
        holdout_believed_um: Vec::new(),
        holdout_effect_um: Vec::new(),
        holdout_noise_um: Vec::new(),
    };
    let files = simulate_measurement(quantity, runs, effect_um, &mut truth, seed, &mut stream);
    let mut runs = files;
    let holdout = runs.pop().expect("every base has a hold-out run");
    TestCase { runs, holdout, machine, quantity, truth }
}

/// Returns the number of training rows, and what share of the effect's RMS each imitator leaves.
fn imitator_residual_ratios(
    shape: &EffectShape,
    has_true_zero: bool,
) -> (f64, Vec<(HiddenCause, f64)>) {
    let um: Vec<f64> = shape.um[..shape.um.len() - 1].concat();
    let left = |column: &Vec<f64>| {
        let (level, slope) = fit_line(column, &um);
        let rest = um.iter().zip(column).map(|(um, x)| um - level - slope * x);
        rms(&rest.collect::<Vec<f64>>()) / training_rms(&shape.um, has_true_zero)
    };
    (
        um.len() as f64,
        shape.imitators.iter().map(|(cause, column)| (*cause, left(column))).collect(),
    )
}

/// RMS over the training rows by the convention of the ratio.
fn training_rms(um: &[Vec<f64>], has_true_zero: bool) -> f64 {
    let training: Vec<f64> = um[..um.len() - 1].concat();
    let mean = training.iter().sum::<f64>() / training.len() as f64;
    let zero = if has_true_zero { 0.0 } else { mean };
    rms(&training.iter().map(|um| um - zero).collect::<Vec<f64>>())
}

/// Returns the size of the noise, the effects at their sizes, and their sum on each row of each run.
fn scale_effects(
    shapes: Vec<EffectShape>,
    ratio: f64,
    has_true_zero: bool,
    stream: &mut RandomStream,
) -> (f64, Vec<HiddenEffect>, Vec<Vec<f64>>) {
    let size = |um: &[Vec<f64>]| training_rms(um, has_true_zero);
    let drawn = stream.log_uniform(0.1, 1.2);
    let fixed = shapes.iter().find(|shape| !shape.is_linear);
    let sigma = fixed.map_or(drawn, |shape| size(&shape.um) / ratio);
    let mut effects = Vec::new();
    let mut sum: Vec<Vec<f64>> = Vec::new();
    for mut shape in shapes {
        let unit = size(&shape.um);
        let sign = if shape.has_sign { stream.random_sign() } else { 1.0 };
        let factor = if shape.is_linear && unit > 0.0 { sign * ratio * sigma / unit } else { 1.0 };
        let named = (shape.at)(factor);
        if sum.is_empty() {
            sum = shape.um.iter().map(|run| vec![0.0; run.len()]).collect();
        }
        for (sum, um) in sum.iter_mut().flatten().zip(shape.um.iter().flatten()) {
            *sum += factor * um;
        }
        effects.push(HiddenEffect {
            cause: shape.cause,
            column: shape.column,
            parameters: named.parameters,
            tables: named.tables,
            rms_um: factor.abs() * unit,
            rivals: Vec::new(),
            holdout_um: shape.um.pop().unwrap_or_default().iter().map(|um| factor * um).collect(),
            um: shape.um.concat().iter().map(|um| factor * um).collect(),
        });
    }
    (sigma, effects, sum)
}

/// Returns the last digit of an instrument that is fit for noise of this size.
fn draw_resolution_um(sigma: f64, stream: &mut RandomStream) -> f64 {
    let digits = [0.0001, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2];
    let fit: Vec<f64> = digits.into_iter().filter(|digit| *digit <= sigma / 4.0).collect();
    let choice = &fit[fit.len().saturating_sub(3)..];
    if choice.is_empty() { 0.0001 } else { stream.choose(choice) }
}

/// Adds the clock of the logger that the gauge is on: it starts with the run, as the other does.
fn add_gauge_clock_column(mut runs: Vec<PredictedRun>) -> Vec<PredictedRun> {
    for run in &mut runs {
        let time_s = run.column("time_s").to_vec();
        run.table.set_column("gauge_time_s", 1, time_s);
    }
    runs
}

/// Measures: adds noise, rounds, leaves out a few cells, writes. Fills in the truth.
fn simulate_measurement(
    quantity: &str,
    runs: Vec<PredictedRun>,
    effect_um: Vec<Vec<f64>>,
    truth: &mut GroundTruth,
    seed: u64,
    stream: &mut RandomStream,
) -> Vec<String> {
    let column = format!("measured_{quantity}_um");
    let sigma = truth.noise_rms_um;
    let missing = if stream.bernoulli(0.3) { 0.006 } else { 0.0 };
    let training = runs.len() - 1;
    let noise: Vec<Vec<f64>> = runs
        .iter()
        .enumerate()
        .map(|(number, run)| {
            let stream = RandomStream::new(seed, &format!("measurement {number}"));
            let mut noise = CorrelatedNoise::new(stream, 1.0, truth.noise_rho);
            run.believed_um.iter().map(|_| noise.draw()).collect()
        })
        .collect();
    // What was asked for is the size of this noise, not that of its law.
    let scale = sigma / rms(&noise[..training].concat());
    let mut left = Vec::new();
    let mut files = Vec::new();
    for (number, (mut run, noise)) in runs.into_iter().zip(noise).enumerate() {
        let rows = run.believed_um.len();
        let effect = effect_um.get(number).cloned().unwrap_or_else(|| vec![0.0; rows]);
        let believed = run.believed_um;
        let values: Vec<f64> = (0..rows)
            .map(|row| {
                let value = believed[row] + effect[row] + scale * noise[row];
                if stream.bernoulli(missing) {
                    f64::NAN
                } else {
                    (value / truth.quantum_um).round() * truth.quantum_um
                }
            })
            .collect();
        run.table.set_column(&column, 4, values);
        let written = run.table.column(&column).unwrap_or_default();
        let rest = (0..rows).map(|row| written[row] - believed[row] - effect[row]);
        if number < training {
            left.extend(rest.filter(|left| !left.is_nan()));
            truth.believed_um.extend(believed);
            truth.effect_um.extend(effect);
        } else {
            truth.holdout_noise_um = rest.collect();
            truth.holdout_believed_um = believed;
            truth.holdout_effect_um = effect;
        }
        files.push(run.table.to_csv());
    }
    truth.noise_rms_um = rms(&left);
    files
}
