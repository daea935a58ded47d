//! The NIST sets of certified nonlinear regression (StRD), each from its start 1, the hard one.
//!
//! `cargo test -p trueup-numerics --test nist -- --show-output` prints the digits that agree with the
//! certified values, −log₁₀ of the relative difference, for each parameter and its standard
//! deviation.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{fs, path::Path};

use trueup_numerics::least_squares::{GivensQr, Model, SolverOptions, fit, normal_equations};

/// A certified set.
struct Set {
    start: Vec<f64>,
    certified: Vec<f64>,
    deviations: Vec<f64>,
    y: Vec<f64>,
    x: Vec<f64>,
}

impl Set {
    fn read(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/nist");
        let path = folder.join(format!("{name}.dat"));
        let text = fs::read_to_string(&path).expect("the sets are part of the project");
        let mut set =
            Self { start: vec![], certified: vec![], deviations: vec![], y: vec![], x: vec![] };
        let mut is_data = false;
        for line in text.lines() {
            let numbers: Vec<f64> = line
                .rsplit('=')
                .next()
                .unwrap_or("")
                .split_whitespace()
                .map_while(|word| word.parse().ok())
                .collect();
            let is_parameter = line.trim_start().starts_with('b') && line.contains('=');
            if is_parameter && numbers.len() == 4 {
                set.start.push(numbers[0]);
                set.certified.push(numbers[2]);
                set.deviations.push(numbers[3]);
            }
            if is_data && numbers.len() == 2 {
                set.y.push(numbers[0]);
                set.x.push(numbers[1]);
            }
            is_data |= line.starts_with("Data:") && line.contains('y') && line.contains('x');
            is_data &= !line.starts_with("Data:           1");
        }
        assert!(!set.start.is_empty() && set.y.len() > set.start.len(), "{}", path.display());
        set
    }
}

/// A model by its value and its derivatives in one row, in the letters of the sets.
struct Formula<F>(usize, Vec<f64>, F);

impl<F: Fn(f64, &[f64], &mut [f64]) -> f64> Model for Formula<F> {
    fn parameter_count(&self) -> usize {
        self.0
    }

    fn evaluate(&self, b: &[f64], values: &mut [f64]) -> bool {
        let mut derivatives = vec![0.0; b.len()];
        values.iter_mut().zip(&self.1).for_each(|(y, &x)| *y = (self.2)(x, b, &mut derivatives));
        true
    }

    fn evaluate_derivatives(&self, b: &[f64], columns: &mut [Vec<f64>]) -> bool {
        let mut evaluate_derivatives = vec![0.0; b.len()];
        for (row, &x) in self.1.iter().enumerate() {
            (self.2)(x, b, &mut evaluate_derivatives);
            columns.iter_mut().zip(&evaluate_derivatives).for_each(|(column, d)| column[row] = *d);
        }
        true
    }
}

/// The same without analytic derivatives.
struct Numeric<M>(M);

impl<M: Model> Model for Numeric<M> {
    fn parameter_count(&self) -> usize {
        self.0.parameter_count()
    }

    fn evaluate(&self, b: &[f64], values: &mut [f64]) -> bool {
        self.0.evaluate(b, values)
    }
}

/// Digits that agree; at most the 11 that are certified.
fn digits(value: f64, certified: f64) -> f64 {
    (-((value - certified) / certified).abs().max(1e-11).log10()).max(0.0)
}

/// Fits the set with analytic and with numeric derivatives, prints the digits reached, and asserts
/// the least of the former.
fn prove(name: &str, formula: impl Fn(f64, &[f64], &mut [f64]) -> f64) {
    let set = Set::read(name);
    let model = Formula(set.start.len(), set.x.clone(), formula);
    let analytic = fit(&model, &set.y, &set.start, &SolverOptions::default()).expect(name);
    let shown = |parameters: &[f64]| -> (Vec<String>, f64) {
        let each = parameters.iter().zip(&set.certified).map(|(p, c)| digits(*p, *c));
        let least = each.clone().fold(f64::INFINITY, f64::min);
        (each.map(|digits| format!("{digits:.1}")).collect(), least)
    };
    let (each, least) = shown(&analytic.parameters);
    println!("{name} from start 1: digits {} (least {least:.1})", each.join(" "));
    let linear = analytic.linear.as_ref().expect("the sets decide their parameters");
    let deviations: Vec<f64> = set
        .deviations
        .iter()
        .enumerate()
        .map(|(at, certified)| digits(linear.standard_error(at), *certified))
        .collect();
    let least_deviation = deviations.iter().copied().fold(f64::INFINITY, f64::min);
    println!("{name} standard deviations: least {least_deviation:.1} digits");
    let engines: [(&str, Step); 2] = [("triangle", by_triangle), ("normal equations", by_normal)];
    for (engine, step) in engines {
        let (each, least) = shown(&gauss_newton(&model, &set, step));
        println!("{name}, plain steps by {engine}: digits {} (least {least:.1})", each.join(" "));
    }
    match fit(&Numeric(model), &set.y, &set.start, &SolverOptions::default()) {
        Ok(numeric) => {
            let (each, least) = shown(&numeric.parameters);
            println!("{name} by differences: digits {} (least {least:.1})", each.join(" "));
        }
        Err(error) => println!("{name} by differences: {error}"),
    }
    assert!(least >= 6.0, "{name}: {each:?}");
    assert!(least_deviation >= 5.0, "{name}: {deviations:?}");
}

/// The coefficients of a linear least squares fit.
type Step = fn(&[Vec<f64>], &[f64]) -> Vec<f64>;

fn by_normal(columns: &[Vec<f64>], residual: &[f64]) -> Vec<f64> {
    normal_equations::solve(columns, residual, None, 0.0).coefficients
}

fn by_triangle(columns: &[Vec<f64>], residual: &[f64]) -> Vec<f64> {
    let mut triangle = GivensQr::new(columns.len());
    for (row, &residual) in residual.iter().enumerate() {
        let x: Vec<f64> = columns.iter().map(|column| column[row]).collect();
        triangle.add_row(&x, residual);
    }
    triangle.solve().expect("the sets decide their parameters").coefficients
}

/// Thirty plain steps of Gauss and Newton from next to the certified values.
fn gauss_newton(model: &impl Model, set: &Set, step: Step) -> Vec<f64> {
    let mut b: Vec<f64> = set.certified.iter().map(|b| b * (1.0 + 1e-5)).collect();
    let mut values = vec![0.0; set.y.len()];
    let mut columns = vec![values.clone(); b.len()];
    for _ in 0..30 {
        assert!(model.evaluate(&b, &mut values) && model.evaluate_derivatives(&b, &mut columns));
        let residual: Vec<f64> = set.y.iter().zip(&values).map(|(y, value)| y - value).collect();
        b.iter_mut().zip(step(&columns, &residual)).for_each(|(b, step)| *b += step);
    }
    b
}

/// Returns a quotient of polynomials in x, `above` coefficients over 1 + the rest.
fn rational(above: usize) -> impl Fn(f64, &[f64], &mut [f64]) -> f64 {
    move |x, b, derivatives| {
        let (numerator, denominator) = b.split_at(above);
        let over: f64 = numerator.iter().rev().fold(0.0, |sum, b| sum * x + b);
        let under = 1.0 + x * denominator.iter().rev().fold(0.0, |sum, b| sum * x + b);
        let mut power = 1.0;
        for derivative in &mut derivatives[..above] {
            *derivative = power / under;
            power *= x;
        }
        power = x;
        for derivative in &mut derivatives[above..] {
            *derivative = -over * power / (under * under);
            power *= x;
        }
        over / under
    }
}

#[test]
fn misra1a_reaches_six_digits() {
    prove("Misra1a", |x, b, d| {
        let decay = (-b[1] * x).exp();
        d[0] = 1.0 - decay;
        d[1] = b[0] * x * decay;
        b[0] * (1.0 - decay)
    });
}

#[test]
fn chwirut2_reaches_six_digits() {
    prove("Chwirut2", |x, b, d| {
        let under = b[1] + b[2] * x;
        let y = (-b[0] * x).exp() / under;
        d.copy_from_slice(&[-x * y, -y / under, -x * y / under]);
        y
    });
}

#[test]
fn kirby2_reaches_six_digits() {
    prove("Kirby2", rational(3));
}

#[test]
fn hahn1_reaches_six_digits() {
    prove("Hahn1", rational(4));
}

#[test]
fn thurber_reaches_six_digits() {
    prove("Thurber", rational(4));
}

#[test]
fn mgh17_reaches_six_digits() {
    prove("MGH17", |x, b, d| {
        let (one, other) = ((-x * b[3]).exp(), (-x * b[4]).exp());
        d.copy_from_slice(&[1.0, one, other, -b[1] * x * one, -b[2] * x * other]);
        b[0] + b[1] * one + b[2] * other
    });
}

#[test]
fn enso_reaches_six_digits() {
    prove("ENSO", |x, b, d| {
        let turn = std::f64::consts::TAU * x;
        let (s12, c12) = (turn / 12.0).sin_cos();
        let (s4, c4) = (turn / b[3]).sin_cos();
        let (s7, c7) = (turn / b[6]).sin_cos();
        let in_4 = (b[4] * s4 - b[5] * c4) * turn / (b[3] * b[3]);
        let in_7 = (b[7] * s7 - b[8] * c7) * turn / (b[6] * b[6]);
        d.copy_from_slice(&[1.0, c12, s12, in_4, c4, s4, in_7, c7, s7]);
        b[0] + b[1] * c12 + b[2] * s12 + b[4] * c4 + b[5] * s4 + b[7] * c7 + b[8] * s7
    });
}
