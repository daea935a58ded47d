//! Whether hidden faults can be told from rival laws, reckoned from what they really do to the record.
//!
//! Each fault is explained by its own law, or by a rival's, beside what all other hidden faults really do
//! and a constant; the best law of each side counts:
//!
//! ```text
//! BIC = n·ln((RSS + n·σ²)/n) + k·ln n        expected: RSS is what the law leaves of the true effect
//! gap = BIC of the best rival − BIC of the best own law
//! ```
//!
//! The laws are those of physics over the columns of the record; which belongs to which fault follows
//! from what the fault is. Nothing of a diagnosis is used.

use trueup_machine::{RunFile, file::is_temperature_column};
use trueup_numerics::least_squares::normal::solve;
use trueup_twin::physical::Fault;

/// Time constants that a law may have: from the interval of rows to some hours, in s.
const LAGS_S: [f64; 8] = [0.0, 120.0, 300.0, 700.0, 1_500.0, 3_000.0, 6_000.0, 12_000.0];

/// A record, and what the file says of it.
pub struct Record<'r> {
    /// Its columns.
    pub run: &'r RunFile,
    /// What the user's file predicts, in µm.
    pub predicted_um: Vec<f64>,
    /// Whether an axis was measured.
    pub is_axis: bool,
}

/// A law with one value for each free constant of it.
struct Law {
    /// The faults whose law it is.
    own: Vec<Fault>,
    columns: Vec<Vec<f64>>,
    /// Constants that are not linear: a time constant.
    more: usize,
}

/// By how much the nearest rival of any fault is worse than its own law, as a difference of BIC under noise
/// of this RMS in µm; none without a fault.
#[must_use]
pub fn least_gap(record: &Record<'_>, faults: &[(Fault, &[f64])], noise_um: f64) -> Option<f64> {
    let laws = if record.is_axis { axis_laws(record) } else { spindle_laws(record) };
    let rows = record.run.rows();
    let all: Vec<f64> =
        (0..rows).map(|row| faults.iter().map(|(_, um)| um[row]).sum::<f64>()).collect();
    let gap = |number: usize| {
        let others = faults.iter().enumerate().filter(|(other, _)| *other != number);
        let mut base = vec![vec![1.0; rows]];
        base.extend(others.map(|(_, (_, um))| um.to_vec()));
        let bic = |law: &Law| {
            let columns = [base.clone(), law.columns.clone()].concat();
            let fitted = solve(&columns, &all, None, 0.0).coefficients;
            let left = |row: usize| {
                let sum: f64 = columns.iter().zip(&fitted).map(|(column, b)| column[row] * b).sum();
                all[row] - sum
            };
            let squares: f64 = (0..rows).map(|row| left(row).powi(2)).sum();
            let n = rows as f64;
            let constants = (law.columns.len() + law.more) as f64;
            n * ((squares + n * noise_um * noise_um) / n).ln() + constants * n.ln()
        };
        let best = |is_own: bool| {
            let of = laws.iter().filter(|law| law.own.contains(&faults[number].0) == is_own);
            of.map(bic).fold(f64::INFINITY, f64::min)
        };
        best(false) - best(true)
    };
    (0..faults.len()).map(gap).reduce(f64::min)
}

/// Laws of a spindle's growth.
fn spindle_laws(record: &Record<'_>) -> Vec<Law> {
    use Fault::{
        AxialStiffness, CoilTemperature, LostCooling, Room, SensorGain, SpeedGrowth, UnseenHolder,
    };
    let Record { run, predicted_um, .. } = record;
    let time_s = run.column("time_s").unwrap_or_default();
    let law = |own: &[Fault], more, columns| Law { own: own.to_vec(), columns, more };
    let mut laws = vec![
        law(&[SensorGain, LostCooling], 0, vec![predicted_um.clone()]),
        law(&[], 0, vec![predicted_um.iter().map(|um| um * um).collect()]),
        law(&[], 0, vec![time_s.to_vec()]),
    ];
    if let Some(rpm) = run.column("spindle_rpm") {
        laws.push(law(
            &[SpeedGrowth],
            0,
            vec![rpm.iter().map(|rpm| (rpm / 1000.0).powi(2)).collect()],
        ));
    }
    laws.extend(run.column("load_n").map(|load| law(&[AxialStiffness], 0, vec![load.to_vec()])));
    for lag_s in &LAGS_S[1..] {
        laws.push(law(&[LostCooling], 1, vec![lagged(time_s, predicted_um, *lag_s)]));
        let rises = time_s.iter().map(|time| 1.0 - (-(time - time_s[0]) / lag_s).exp()).collect();
        laws.push(law(&[UnseenHolder], 1, vec![rises]));
    }
    for (name, celsius) in temperatures(run) {
        for lag_s in LAGS_S {
            let mut own = vec![UnseenHolder, Room];
            if name == "temp_coil_c" && lag_s == 0.0 {
                own.push(CoilTemperature);
            }
            laws.push(law(&own, usize::from(lag_s > 0.0), vec![lagged(time_s, celsius, lag_s)]));
        }
    }
    laws
}

/// Laws of an axis's error.
fn axis_laws(record: &Record<'_>) -> Vec<Law> {
    use Fault::{MisplacedThermometer, Mounting, Room, ScrewHeating, Wear};
    let run = record.run;
    let column = |name: &str| run.column(name).unwrap_or_default().to_vec();
    let [time_s, x_mm, y_mm] = ["time_s", "x_mm", "y_mm"].map(column);
    let back: Vec<f64> =
        column("dir_x").iter().map(|dir| if *dir < 0.0 { 1.0 } else { 0.0 }).collect();
    let times =
        |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
    let law = |own: &[Fault], more, columns| Law { own: own.to_vec(), columns, more };
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
    for (_, celsius) in temperatures(run) {
        for lag_s in LAGS_S {
            let late = lagged(&time_s, celsius, lag_s);
            let more = usize::from(lag_s > 0.0);
            let along = vec![times(&late, &x_mm), x_mm.clone()];
            laws.push(law(&[Room, ScrewHeating, MisplacedThermometer], more, along));
            laws.push(law(&[Room], more, vec![late]));
        }
    }
    laws
}

fn temperatures(run: &RunFile) -> impl Iterator<Item = (&str, &[f64])> {
    let columns = run.columns().iter().filter(|column| is_temperature_column(&column.name));
    columns.map(|column| (column.name.as_str(), column.values.as_slice()))
}

/// y += (x − y)·(1 − e^(−Δt/τ)), settled in the first row.
fn lagged(time_s: &[f64], x: &[f64], lag_s: f64) -> Vec<f64> {
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
    use crate::table::parsed;

    /// A load beside a temperature that goes with it, or does not.
    fn gap(is_told: bool, noise_um: f64) -> f64 {
        let mut csv = String::from("time_s,load_n,spindle_rpm,temp_nose_c\n");
        for row in 0..200 {
            let load = if row % 40 < 20 { 0.0 } else { 800.0 };
            let warm =
                if is_told { f64::from(row % 7) } else { load / 100.0 + f64::from(row % 3) * 0.01 };
            csv += &format!("{},{load},9000,{warm}\n", 60 * row);
        }
        let run = parsed(&csv, "r.csv").expect("a run");
        let um: Vec<f64> = run.column("load_n").expect("there").iter().map(|n| n / 200.0).collect();
        let predicted_um = (0..200).map(|row| f64::from(row).sqrt()).collect();
        let record = Record { run: &run, predicted_um, is_axis: false };
        least_gap(&record, &[(Fault::AxialStiffness, &um)], noise_um).expect("one fault")
    }

    #[test]
    fn a_law_that_does_the_same_is_no_gap_and_one_that_does_not_is() {
        assert!(gap(true, 0.5) > 100.0, "{}", gap(true, 0.5));
        assert!(gap(false, 0.5) < 1.0, "{}", gap(false, 0.5));
        assert!(gap(true, 50.0) < 6.0, "under such noise nothing is told: {}", gap(true, 50.0));
    }
}
