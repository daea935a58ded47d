//! Columns: those of the file by name, those that follow from them, and what a part adds to each row.

use std::f64::consts::TAU;

use trueup_machine::{
    machine_file::{BSpline, LinearAxis, Quantity},
    model::spline_um,
};

use crate::{
    data::{Data, filled},
    model::Kind,
};

/// What a part with these nonlinear values adds at each amplitude of 1, to a prediction `p` so far.
pub(crate) fn basis(kind: &Kind, nonlinear: &[f64], data: &Data, p: &[f64]) -> Vec<Vec<f64>> {
    let rows = data.rows;
    let own = || data.own_position().map_or_else(|| vec![0.0; rows], filled);
    let reverse = |row: usize| data.own_direction().is_some_and(|d| d[row] < 0.0);
    let time = || data.time_s.as_deref().map_or_else(|| vec![0.0; rows], filled);
    let temperature =
        |column: &str| data.temperature(column).map_or_else(|| vec![0.0; rows], <[f64]>::to_vec);
    match kind {
        Kind::SensorOffset => vec![vec![1.0; rows]],
        Kind::SensorGain | Kind::GrowthAmplitude => vec![p.to_vec()],
        Kind::SensorCurvature => vec![p.iter().map(|p| p * p).collect()],
        Kind::SensorTemperatureDrift { column } => {
            vec![above(data, column, filled(&temperature(column)))]
        }
        Kind::SlowMode => {
            let (start_s, tau) = (data.start_s, nonlinear[0]);
            let rise = |t: f64| -(-(t - start_s).max(0.0) / tau).exp_m1();
            vec![time().into_iter().map(rise).collect()]
        }
        Kind::SlowModeOf { column } | Kind::ExtraHeatPath { column, has_lag: true } => {
            let tau = nonlinear[0];
            vec![above(data, column, data.lagged(column, tau, tau))]
        }
        Kind::ExtraHeatPath { column, has_lag: false } => {
            vec![above(data, column, filled(&temperature(column)))]
        }
        Kind::CentrifugalGrowth => {
            let rpm = data.spindle_rpm.as_deref().map_or_else(|| vec![0.0; rows], filled);
            vec![rpm.iter().map(|n| (n / 1000.0).powi(2)).collect()]
        }
        Kind::CuttingLoad => {
            let load = data.load_n.as_deref().map_or_else(|| vec![0.0; rows], filled);
            vec![load.iter().map(|load| -load).collect()]
        }
        Kind::PitchScale => vec![own().iter().map(|mm| mm / 1000.0).collect()],
        Kind::PitchError { start_mm, step_mm, points, both_ways } => {
            let mut columns = vec![vec![0.0; rows]; kind.amplitudes()];
            for (row, mm) in own().into_iter().enumerate() {
                let at = ((mm - start_mm) / step_mm).clamp(0.0, (points - 1) as f64);
                let low = (at as usize).min(points.saturating_sub(2));
                let share = at - low as f64;
                let offset = if *both_ways && reverse(row) { *points } else { 0 };
                columns[offset + low][row] = 1.0 - share;
                if *points > 1 {
                    columns[offset + low + 1][row] = share;
                }
            }
            columns
        }
        Kind::PitchPeriodic { harmonics } => {
            let own = own();
            harmonics
                .iter()
                .flat_map(|&harmonic| {
                    let turn = TAU * f64::from(harmonic) / nonlinear[0];
                    let wave = |of: fn(f64) -> f64| own.iter().map(|mm| of(turn * mm)).collect();
                    [wave(f64::sin), wave(f64::cos)]
                })
                .collect()
        }
        Kind::Backlash => {
            vec![(0..rows).map(|row| if reverse(row) { 1.0 } else { 0.0 }).collect()]
        }
        Kind::PositionDependentBacklash => {
            let own = own();
            vec![(0..rows).map(|r| if reverse(r) { own[r] / 1000.0 } else { 0.0 }).collect()]
        }
        Kind::Straightness { along, knots_mm } => {
            let at = position(data, *along);
            let count = knots_mm.len() - 4;
            (0..count)
                .map(|control| {
                    let mut control_um = vec![0.0; count];
                    control_um[control] = 1.0;
                    let spline = BSpline { order: 4, knots_mm: knots_mm.clone(), control_um };
                    at.iter().map(|&mm| spline_um(&spline, mm)).collect()
                })
                .collect()
        }
        Kind::CrossAxis { axis } => {
            vec![position(data, *axis).iter().map(|mm| mm / 1000.0).collect()]
        }
        Kind::Step => {
            let after = |t: f64| if t >= nonlinear[0] { 1.0 } else { 0.0 };
            vec![time().into_iter().map(after).collect()]
        }
        Kind::Drift => vec![time().iter().map(|t| t / 3600.0).collect()],
        Kind::ReferenceInstrument { is_angled, reading } => {
            // What is read is about what is predicted; the reading itself has its own noise in it,
            // which a wave of the reading would follow.
            let reading = match reading.as_ref().and_then(|column| named(data, column)) {
                Some(reading) => filled(reading),
                None if data.quantity == Quantity::Elongation => filled(&data.elongation),
                None => own(),
            };
            let turns = |mm: &f64| {
                if *is_angled { nonlinear[0] / (mm + nonlinear[1]) } else { mm / nonlinear[0] }
            };
            let wave = |of: fn(f64) -> f64| reading.iter().map(|mm| of(TAU * turns(mm))).collect();
            vec![wave(f64::sin), wave(f64::cos)]
        }
        Kind::Curve { column, knots, by_direction, times } => {
            let values = filled(named(data, column).unwrap_or(&[]));
            let factor = times.as_ref().and_then(|column| named(data, column)).map(filled);
            let factor = |row: usize| factor.as_ref().map_or(1.0, |factor| factor[row]);
            let mut columns = vec![vec![0.0; rows]; kind.amplitudes()];
            for (row, &value) in values.iter().enumerate() {
                let above = knots.partition_point(|&knot| knot <= value).clamp(1, knots.len() - 1);
                let (low, high) = (knots[above - 1], knots[above]);
                let share = ((value - low) / (high - low)).clamp(0.0, 1.0);
                let offset = if *by_direction && reverse(row) { knots.len() } else { 0 };
                columns[offset + above - 1][row] = (1.0 - share) * factor(row);
                columns[offset + above][row] = share * factor(row);
            }
            columns
        }
        // These change the law itself.
        Kind::SensorSaturation
        | Kind::TimeShift
        | Kind::ThermalLag
        | Kind::GrowthRate
        | Kind::CoolingAsymmetry
        | Kind::ExpansionSlope
        | Kind::ReferenceTemperature => Vec::new(),
    }
}

/// What the model says of the elongation, as a column.
pub(crate) const SAID: &str = "what the model says";

/// A column by its name in the file, or one of those that follow from others.
pub(crate) fn named<'d>(data: &'d Data, name: &str) -> Option<&'d [f64]> {
    let position = |n: usize| data.position_mm[n].as_deref();
    match name {
        "time_s" => data.time_s.as_deref(),
        "spindle_rpm" => data.spindle_rpm.as_deref(),
        "load_n" => data.load_n.as_deref(),
        "x_mm" => position(0),
        "y_mm" => position(1),
        "z_mm" => position(2),
        "run" => data.run.as_deref(),
        SAID => (data.quantity == Quantity::Elongation).then_some(data.elongation.as_slice()),
        _ => data.temperature(name).or_else(|| {
            let mut columns = data.others.iter().chain(&data.reversal_decay);
            columns.find(|(there, _)| there == name).map(|(_, values)| values.as_slice())
        }),
    }
}

fn position(data: &Data, axis: LinearAxis) -> Vec<f64> {
    let column = data.position_mm[axis.index()].as_deref();
    column.map_or_else(|| vec![0.0; data.rows], filled)
}

/// Above what `column` was at the first row: until a reference is fitted, that is the zero.
fn above(data: &Data, column: &str, mut values: Vec<f64>) -> Vec<f64> {
    let reference_c = data.reference_c(column);
    values.iter_mut().for_each(|value| *value -= reference_c);
    values
}
