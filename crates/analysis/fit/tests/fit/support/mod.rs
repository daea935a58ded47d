//! Shared parts of the tests of whole fits: runs from numbers, and the way through a machine file.

pub mod guideway;

use std::{borrow::Cow, fmt::Write as _, path::Path};

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use trueup_fit::FitReport;
use trueup_machine::{
    Machine, MachineFile, RunFile, applied_offsets::UncompensatedRun, predict::RunPredictor,
};

/// The shortest machine file.
pub const MACHINE: &str = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n";

/// Normal noise of standard deviation 1, from a seed.
pub struct Noise(ChaCha8Rng);

impl Noise {
    pub fn seeded(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub fn next(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
}

/// Returns a run of these columns, under the name `run.csv`.
pub fn run(columns: &[(&str, &[f64])]) -> UncompensatedRun<'static> {
    let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    let mut text = names.join(",");
    text.push('\n');
    for row in 0..columns[0].1.len() {
        for (index, (_, values)) in columns.iter().enumerate() {
            let comma = if index == 0 { "" } else { "," };
            if values[row].is_nan() {
                text.push_str(comma);
            } else {
                write!(text, "{comma}{}", values[row]).expect("writing to a string");
            }
        }
        text.push('\n');
    }
    parse(&text)
}

/// Returns a run that no bridge had a part in.
pub fn unaided(run: RunFile) -> UncompensatedRun<'static> {
    UncompensatedRun::from_run(Cow::Owned(run), None, None).expect("no bridge").0
}

pub fn parse(text: &str) -> UncompensatedRun<'static> {
    let run = RunFile::from_reader(text.as_bytes(), Path::new("run.csv"));
    unaided(run.expect("the test's own text"))
}

pub fn machine(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).expect("the test's own text")
}

/// Returns the machine file `text` with what was fitted.
pub fn applied(report: &FitReport, text: &str) -> Machine {
    let text = report.edit.apply(text, Path::new("m.toml")).expect("loads");
    machine(&text)
}

/// Root mean square of measured minus predicted, by quantity (elongation, dx, dy, dz), over the
/// rows for which `keep` holds.
pub fn predicted_rms(
    machine: &Machine,
    run: &RunFile,
    quantity: usize,
    keep: impl Fn(usize) -> bool,
) -> f64 {
    let column = ["measured_elongation_um", "measured_dx_um", "measured_dy_um", "measured_dz_um"];
    let measured = run.column(column[quantity]).expect("the run has it");
    let predictor = RunPredictor::new(machine, run).expect("it can be predicted");
    let (mut squares, mut rows) = (0.0, 0);
    for (row, prediction) in predictor.predictions().enumerate() {
        let left = measured[row] - prediction.model.to_array()[quantity];
        if !left.is_nan() && keep(row) {
            squares += left * left;
            rows += 1;
        }
    }
    (squares / f64::from(rows)).sqrt()
}

/// Asserts that the machine file with the fit predicts with the residual that the report claims.
pub fn assert_round_trip(report: &FitReport, text: &str, run: &RunFile, quantity: usize) {
    let aside: Vec<usize> = report.excluded.iter().map(|row| row.place.line).collect();
    let column = run.columns()[0].name.clone();
    let is_retained = |row: usize| !aside.contains(&run.value_location(row, &column).line);
    let rms = predicted_rms(&applied(report, text), run, quantity, is_retained);
    let claimed = report.in_sample.expect("a fit has residuals").rms_um;
    assert!((rms - claimed).abs() < 1e-9 * (1.0 + claimed), "predicted {rms}, claimed {claimed}");
}

/// Asserts that the parameter's interval holds the truth.
pub fn assert_holds(report: &FitReport, name: &str, truth: f64) {
    let parameter = report.parameter(name).unwrap_or_else(|| panic!("{name} of {report:?}"));
    let [low, high] = parameter.ci95.unwrap_or_else(|| panic!("{name} was fitted"));
    // A hair wider: one interval in twenty need not hold it, and the seeds are what they are.
    let slack = 0.5 * (high - low);
    assert!((low - slack..=high + slack).contains(&truth), "{parameter} should hold {truth}");
}
