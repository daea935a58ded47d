//! Whether hidden faults can be distinguished from rival laws, reckoned from what they really do to the record.
//!
//! An answer is a set of laws, fitted together with a constant to all that the hidden faults really do:
//!
//! ```text
//! BIC = n·ln((RSS + n·σ²)/n) + k·ln n        expected: RSS is what the laws leave of the true effect
//! gap = BIC of the best rival answer − BIC of the best right one
//! ```
//!
//! A right answer has a law of its own for every fault and none that belongs to no fault. Its rivals are the
//! sets of up to three laws (as many as faults are hidden at most) that stand in its place: one law in the
//! place of another, a pair in the place of a pair, one in the place of two. A surplus counts as
//! well: a law of no fault next to it, which makes up for what the physics does and the laws do not say.
//!
//! The laws are those of physics over the columns of the record; which belongs to which fault follows
//! from what the fault is. Nothing of a diagnosis is used.

use trueup_machine::{RunFile, machine_file::is_temperature_column};
use trueup_numerics::least_squares::normal_equations::dot;

use crate::physical_faults::PhysicalFault;

/// Time constants that a law may have: from the interval of rows to some hours, in s, half as long again
/// each. Two neighbours together cover the effect of one that lies between them.
const CANDIDATE_LAGS_S: [f64; 13] = [
    0.0, 120.0, 180.0, 270.0, 400.0, 600.0, 900.0, 1_350.0, 2_000.0, 3_000.0, 4_500.0, 6_800.0,
    10_000.0,
];
/// The most laws of a rival answer.
const MAX_LAWS_PER_ALTERNATIVE: usize = 3;

/// A record, and what the file says of it.
pub(crate) struct PredictedRecord<'r> {
    /// Its columns.
    pub run: &'r RunFile,
    /// Rows in which the gauge was read.
    pub is_read: &'r [bool],
    /// Prediction of the user's file, in µm.
    pub predicted_um: Vec<f64>,
    /// Whether an axis was measured.
    pub is_axis: bool,
}

/// A law with one value for each free constant of it.
struct CandidateLaw {
    /// The faults whose law it is.
    own: Vec<PhysicalFault>,
    columns: Vec<Vec<f64>>,
    /// Constants that are not linear: a time constant.
    more: usize,
}

/// How far the right answer is from others, as differences of BIC.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BicDifferences {
    /// By how much the best answer is worse that stands in its place: a fault is not named, or a law of no
    /// fault takes the place of one of its own, with no constant more.
    pub instead: f64,
    /// By how much the right answer becomes worse by a law of no fault next to it.
    pub beside: f64,
}

/// Of hidden faults, each with what it does to every row, under noise of this RMS in µm.
#[must_use]
pub(crate) fn compute_bic_differences(
    record: &PredictedRecord<'_>,
    faults: &[(PhysicalFault, &[f64])],
    noise_um: f64,
) -> BicDifferences {
    let laws =
        if record.is_axis { candidate_axis_laws(record) } else { candidate_spindle_laws(record) };
    let rows = record.run.row_count();
    let all: Vec<f64> =
        (0..rows).map(|row| faults.iter().map(|(_, um)| um[row]).sum::<f64>()).collect();
    let answers = NormalEquations::new(&laws, &all, record.is_read, noise_um);
    let names = |law: &CandidateLaw| -> u32 {
        let own = faults.iter().enumerate().filter(|(_, (fault, _))| law.own.contains(fault));
        own.map(|(number, _)| 1 << number).sum()
    };
    let named: Vec<u32> = laws.iter().map(names).collect();
    let everything = (1 << faults.len()) - 1;

    let (mut unnamed, mut right) = (f64::INFINITY, (f64::INFINITY, Vec::new()));
    // All named, and something more: the best of each number of constants.
    let largest = answers.laws.iter().map(|(_, constants)| *constants).max().unwrap_or(0);
    let mut mixed = vec![f64::INFINITY; largest * MAX_LAWS_PER_ALTERNATIVE + 1];
    let mut set = Vec::new();
    for_each_subset(laws.len(), MAX_LAWS_PER_ALTERNATIVE, &mut set, &mut |set| {
        let is_named = set.iter().fold(0, |all, law| all | named[*law]) == everything;
        let bic = answers.bic(set);
        if !is_named {
            unnamed = unnamed.min(bic);
        } else if set.iter().any(|law| named[*law] == 0) {
            let best = &mut mixed[answers.parameter_count(set)];
            *best = best.min(bic);
        } else if bic < right.0 {
            right = (bic, set.to_vec());
        }
    });
    let (mut best, mut set) = right;
    // What no single law of a fault does, two of its laws may: a path from the nose and one from the air.
    loop {
        let with = |law: usize| [set.as_slice(), &[law]].concat();
        let own = (0..laws.len()).filter(|law| named[*law] != 0 && !set.contains(law));
        let better = own.map(|law| (answers.bic(&with(law)), law));
        match better.min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((bic, law)) if bic < best => (best, set) = (bic, with(law)),
            _ => break,
        }
    }
    let (instead, beside) = mixed.split_at(mixed.len().min(answers.parameter_count(&set) + 1));
    let least = |bics: &[f64]| bics.iter().copied().fold(f64::INFINITY, f64::min);
    let foreign = (0..laws.len()).filter(|law| named[*law] == 0);
    let added = foreign.map(|law| answers.bic(&[set.as_slice(), &[law]].concat()));
    BicDifferences {
        instead: least(instead).min(unnamed) - best,
        beside: added.fold(least(beside), f64::min) - best,
    }
}

/// Calls `work` with every set of up to `most` of `laws` laws, by their numbers.
fn for_each_subset(
    laws: usize,
    most: usize,
    set: &mut Vec<usize>,
    work: &mut impl FnMut(&[usize]),
) {
    let first = set.last().map_or(0, |last| last + 1);
    for law in first..laws {
        set.push(law);
        work(set);
        if set.len() < most {
            for_each_subset(laws, most, set, work);
        }
        set.pop();
    }
}

/// Sums over the rows that are read, so that a set of laws costs no more than its constants.
struct NormalEquations {
    rows: f64,
    /// n·σ².
    noise: f64,
    /// Σ of what is to be explained, squared, about its mean.
    total: f64,
    /// Of each law, where its columns are, and how many constants it has.
    laws: Vec<(std::ops::Range<usize>, usize)>,
    /// Products of all columns, each about its mean and of length 1; the last with what is explained.
    products: Vec<Vec<f64>>,
}

impl NormalEquations {
    fn new(laws: &[CandidateLaw], all: &[f64], is_read: &[bool], noise_um: f64) -> Self {
        let centred = |column: &[f64]| -> Vec<f64> {
            let rows = column.iter().zip(is_read).filter(|(_, read)| **read);
            let mut read: Vec<f64> = rows.map(|(value, _)| *value).collect();
            let mean = read.iter().sum::<f64>() / read.len().max(1) as f64;
            read.iter_mut().for_each(|value| *value -= mean);
            read
        };
        let target = centred(all);
        let (mut columns, mut places) = (Vec::new(), Vec::new());
        for law in laws {
            let from = columns.len();
            for column in &law.columns {
                let mut column = centred(column);
                let length = dot(&column, &column).sqrt();
                if length > 0.0 {
                    column.iter_mut().for_each(|value| *value /= length);
                }
                columns.push(column);
            }
            places.push((from..columns.len(), law.columns.len() + law.more));
        }
        let products = columns.iter().map(|one| {
            let others = columns.iter().chain([&target]);
            others.map(|other| dot(one, other)).collect()
        });
        let rows = target.len() as f64;
        Self {
            rows,
            noise: rows * noise_um * noise_um,
            total: dot(&target, &target),
            laws: places,
            products: products.collect(),
        }
    }

    /// Returns how many constants these laws have.
    fn parameter_count(&self, set: &[usize]) -> usize {
        set.iter().map(|law| self.laws[*law].1).sum()
    }

    /// BIC of these laws together: what they leave by elimination (Cholesky), a column that others make up
    /// omitted.
    fn bic(&self, set: &[usize]) -> f64 {
        /// A column of length 1 of which others leave so little (squared) is none of its own.
        const MIN_SQUARED_RESIDUAL_NORM: f64 = 1e-9;
        let columns = || set.iter().flat_map(|law| self.laws[*law].0.clone());
        let last = self.products.len();
        let mut lower: Vec<Vec<f64>> = Vec::with_capacity(2 * set.len());
        let mut used: Vec<usize> = Vec::with_capacity(2 * set.len());
        let mut solved: Vec<f64> = Vec::with_capacity(2 * set.len());
        for column in columns() {
            let mut row: Vec<f64> = Vec::with_capacity(used.len() + 1);
            for (n, other) in used.iter().enumerate() {
                let done: f64 = row.iter().zip(&lower[n]).map(|(a, b)| a * b).sum();
                row.push((self.products[column][*other] - done) / lower[n][n]);
            }
            let own =
                self.products[column][column] - row.iter().map(|value| value * value).sum::<f64>();
            if own < MIN_SQUARED_RESIDUAL_NORM {
                continue;
            }
            let done: f64 = row.iter().zip(&solved).map(|(a, b)| a * b).sum();
            solved.push((self.products[column][last] - done) / own.sqrt());
            row.push(own.sqrt());
            lower.push(row);
            used.push(column);
        }
        let left = (self.total - solved.iter().map(|value| value * value).sum::<f64>()).max(0.0);
        self.rows * ((left + self.noise) / self.rows).ln()
            + self.parameter_count(set) as f64 * self.rows.ln()
    }
}

/// Laws of a spindle's growth.
fn candidate_spindle_laws(record: &PredictedRecord<'_>) -> Vec<CandidateLaw> {
    use PhysicalFault::{
        AxialStiffness, CoilTemperature, ColdTool, LostCooling, Room, SensorGain, SpeedGrowth,
        ToolGrowth, UnseenHolder,
    };
    let PredictedRecord { run, predicted_um, .. } = record;
    let time_s = run.column("time_s").unwrap_or_default();
    let law =
        |own: &[PhysicalFault], more, columns| CandidateLaw { own: own.to_vec(), columns, more };
    let mut laws = vec![
        law(&[SensorGain, LostCooling], 0, vec![predicted_um.clone()]),
        law(&[], 0, vec![predicted_um.iter().map(|um| um * um).collect()]),
        law(&[], 0, vec![time_s.to_vec()]),
    ];
    let tools = run.column("tool");
    if let Some(rpm) = run.column("spindle_rpm") {
        let square: Vec<f64> = rpm.iter().map(|rpm| (rpm / 1000.0).powi(2)).collect();
        if let Some(tools) = tools {
            laws.push(law(&[ToolGrowth], 0, columns_by_tool(tools, &square)));
            laws.push(law(&[], 0, columns_by_tool(tools, &vec![1.0; square.len()])));
        }
        laws.push(law(&[SpeedGrowth], 0, vec![square]));
    }
    laws.extend(run.column("load_n").map(|load| law(&[AxialStiffness], 0, vec![load.to_vec()])));
    for lag_s in &CANDIDATE_LAGS_S[1..] {
        // Over a smaller conductance heat ends higher and comes later: both at once, or the later alone.
        let late = apply_first_order_lag(time_s, predicted_um, *lag_s);
        laws.push(law(&[LostCooling], 1, vec![late.clone()]));
        laws.push(law(&[LostCooling], 0, vec![predicted_um.clone(), late]));
        let rises = time_s.iter().map(|time| 1.0 - (-(time - time_s[0]) / lag_s).exp()).collect();
        laws.push(law(&[UnseenHolder], 1, vec![rises]));
    }
    for (name, celsius) in temperature_columns(run) {
        for lag_s in CANDIDATE_LAGS_S {
            let mut own = vec![UnseenHolder, Room];
            if name == "temp_coil_c" && lag_s == 0.0 {
                own.push(CoilTemperature);
            }
            laws.push(law(
                &own,
                usize::from(lag_s > 0.0),
                vec![apply_first_order_lag(time_s, celsius, lag_s)],
            ));
            if let (Some(tools), Some(air)) = (tools, run.column("temp_ambient_c")) {
                let anew = apply_lag_with_tool_reset(time_s, celsius, lag_s, tools, air);
                laws.push(law(&[ColdTool], 1, vec![anew]));
            }
        }
    }
    laws
}

/// Laws of an axis's error.
fn candidate_axis_laws(record: &PredictedRecord<'_>) -> Vec<CandidateLaw> {
    use PhysicalFault::{MisplacedThermometer, Mounting, Room, ScrewHeating, Wear};
    let run = record.run;
    let column = |name: &str| run.column(name).unwrap_or_default().to_vec();
    let [time_s, x_mm, y_mm] = ["time_s", "x_mm", "y_mm"].map(column);
    let back: Vec<f64> =
        column("dir_x").iter().map(|dir| if *dir < 0.0 { 1.0 } else { 0.0 }).collect();
    let times =
        |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
    let law =
        |own: &[PhysicalFault], more, columns| CandidateLaw { own: own.to_vec(), columns, more };
    let mut laws = vec![
        law(&[], 0, vec![time_s.clone()]),
        law(&[], 0, vec![x_mm.clone()]),
        law(&[], 0, vec![times(&x_mm, &x_mm)]),
        law(&[Mounting], 0, vec![y_mm.clone()]),
        law(&[], 0, vec![times(&x_mm, &y_mm)]),
        law(&[Wear], 0, vec![back.clone()]),
        law(&[Wear], 0, vec![times(&back, &x_mm)]),
        law(&[Wear], 0, vec![back.clone(), times(&back, &x_mm)]),
    ];
    for (_, celsius) in temperature_columns(run) {
        for lag_s in CANDIDATE_LAGS_S {
            let late = apply_first_order_lag(&time_s, celsius, lag_s);
            let more = usize::from(lag_s > 0.0);
            let along = vec![times(&late, &x_mm), x_mm.clone()];
            laws.push(law(&[Room, ScrewHeating, MisplacedThermometer], more, along));
            laws.push(law(&[Room], more, vec![late]));
        }
    }
    laws
}

/// Returns a column for each tool: `values` while it is in the spindle, else 0.
fn columns_by_tool(tools: &[f64], values: &[f64]) -> Vec<Vec<f64>> {
    let mut numbers = tools.to_vec();
    numbers.sort_by(f64::total_cmp);
    numbers.dedup();
    let of = |number: f64| {
        let rows = tools.iter().zip(values);
        rows.map(|(tool, value)| if *tool == number { *value } else { 0.0 }).collect()
    };
    numbers.into_iter().map(of).collect()
}

/// As [`apply_first_order_lag`], but from the air's temperature on again at each change of the tool.
fn apply_lag_with_tool_reset(
    time_s: &[f64],
    x: &[f64],
    lag_s: f64,
    tools: &[f64],
    air: &[f64],
) -> Vec<f64> {
    let mut y = air.first().copied().unwrap_or(0.0);
    (0..x.len())
        .map(|row| {
            let before = row.saturating_sub(1);
            if tools[row] != tools[before] {
                y = air[row];
            }
            let step_s = time_s[row] - time_s[before];
            let share = if lag_s > 0.0 { -(-step_s / lag_s).exp_m1() } else { 1.0 };
            y += (x[row] - y) * share;
            y
        })
        .collect()
}

fn temperature_columns(run: &RunFile) -> impl Iterator<Item = (&str, &[f64])> {
    let columns = run.columns().iter().filter(|column| is_temperature_column(&column.name));
    columns.map(|column| (column.name.as_str(), &column.values[..]))
}

/// y += (x − y)·(1 − e^(−Δt/τ)), settled in the first row.
fn apply_first_order_lag(time_s: &[f64], x: &[f64], lag_s: f64) -> Vec<f64> {
    let mut y = x.first().copied().unwrap_or(0.0);
    let mut before_s = time_s.first().copied().unwrap_or(0.0);
    let step = |(time, x): (&f64, &f64)| {
        let share = if lag_s > 0.0 { -(-(time - before_s) / lag_s).exp_m1() } else { 1.0 };
        before_s = *time;
        y += (x - y) * share;
        y
    };
    time_s.iter().zip(x).map(step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run_file::parse_run;

    /// Returns a load next to a temperature that is correlated with it, or is not.
    fn gap(is_separable: bool, noise_um: f64) -> f64 {
        let mut csv = String::from("time_s,load_n,spindle_rpm,temp_nose_c\n");
        for row in 0..200 {
            let load = if row % 40 < 20 { 0.0 } else { 800.0 };
            let warm = if is_separable {
                f64::from(row % 7)
            } else {
                load / 100.0 + f64::from(row % 3) * 0.01
            };
            csv += &format!("{},{load},9000,{warm}\n", 60 * row);
        }
        let run = parse_run(&csv, "r.csv").expect("a run");
        let um: Vec<f64> = run.column("load_n").expect("there").iter().map(|n| n / 200.0).collect();
        let predicted_um = (0..200).map(|row| f64::from(row).sqrt()).collect();
        let record =
            PredictedRecord { run: &run, is_read: &[true; 200], predicted_um, is_axis: false };
        compute_bic_differences(&record, &[(PhysicalFault::AxialStiffness, &um)], noise_um).instead
    }

    #[test]
    fn a_law_that_does_the_same_is_no_gap_and_one_that_does_not_is() {
        assert!(gap(true, 0.5) > 100.0, "{}", gap(true, 0.5));
        assert!(gap(false, 0.5) < 1.0, "{}", gap(false, 0.5));
        assert!(
            gap(true, 50.0) < 6.0,
            "under such noise nothing is separated: {}",
            gap(true, 50.0)
        );
    }
}
