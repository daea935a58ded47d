//! Whether a list is anything, tried on a tilt that is fitted to a map.

use std::path::Path;

use trueup_machine::{
    MachineFile, RunFile,
    effect::{BoardTerm, Tilt},
    machine_file::{AngleProfile, BSpline, LinearAxis, Quantity},
};
use trueup_numerics::random::RandomGenerator;

use super::*;
use crate::{
    data::{DataTable, RowGroups},
    fit::fit,
    model::Model,
    term_kind::TermKind,
};

/// Z by X and Y at 9 × 9 places with noise of 0.3 µm, and what is known of a tilt of X at the lever Y there.
fn tilt_of(um: impl Fn(f64, f64) -> f64) -> (ParameterEstimates, f64) {
    let mut noise = RandomGenerator::new(5);
    let mut text = String::from("x_mm,y_mm,measured_dz_um\n");
    for place in 0..81 {
        let (x_mm, y_mm) = (30.0 * f64::from(place % 9), 25.0 * f64::from(place / 9));
        text += &format!("{x_mm},{y_mm},{:.3}\n", um(x_mm, y_mm) + 0.3 * noise.normal());
    }
    let file = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n";
    let machine = MachineFile::parse(file, Path::new("m.toml")).expect("a machine file");
    let run = RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("a run");
    let data = DataTable::new(&machine, &[run], Quantity::Dz).expect("comparable");
    let groups = RowGroups::new(&data, &data.used.clone(), 1);
    let problem = FitProblem::new(data, groups);
    let spline = BSpline {
        order: 4,
        knots_mm: vec![0.0, 0.0, 0.0, 0.0, 120.0, 240.0, 240.0, 240.0, 240.0],
        control_um: vec![0.0; 5],
    };
    let tilt = Tilt {
        along: Some(LinearAxis::X),
        lever: LinearAxis::Y,
        origin_mm: 0.0,
        angle: AngleProfile::Curve(spline),
    };
    let kind =
        TermKind::from_board_term(Some(LinearAxis::Z), &BoardTerm::Tilt(tilt)).expect("a tilt");
    // From where the lever is long: a search begins there too, where nothing goes with the lever.
    let values = vec![-1000.0, 10.0, 10.0, 10.0, 10.0, 10.0];
    let model = Model { parts: vec![ModelPart { kind, values }], constant_um: Some(0.0) };
    let fitted = fit(&problem, &model, None);
    let part = fitted.model.parts[0].clone();
    let origin_mm = part.values[0];
    (estimate_parameters(&problem, &fitted, &part, NoiseModel::WHITE), origin_mm)
}

#[test]
fn an_angle_whose_lever_ends_far_away_may_be_nothing() {
    let bend = |x_mm: f64| (x_mm / 80.0).sin();
    let (curve, origin_mm) = tilt_of(|x_mm, _| 12.0 * bend(x_mm));
    println!("a curve: {origin_mm} mm {:?}", curve.intervals);
    assert!(origin_mm.abs() > 3000.0 && curve.reaches_nothing);
    let (tilt, origin_mm) = tilt_of(|x_mm, y_mm| 0.12 * bend(x_mm) * (y_mm - 60.0));
    println!("a tilt: {origin_mm} mm {:?}", tilt.intervals);
    assert!((origin_mm - 60.0).abs() < 3.0 && !tilt.reaches_nothing);
}
