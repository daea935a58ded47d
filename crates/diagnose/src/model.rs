//! The model and its terms in columns: what `trueup predict` does row by row, fast enough to be tried
//! thousands of times.
//!
//! Each cause is a [`Kind`] with values: first those that enter nonlinearly (a time constant, a
//! period, a limit), then amplitudes, all of which are 0 where there is no effect. The order is
//! fixed: constants of the model, then gain, curvature and saturation of the source, then what is
//! added, then the shift in time. `trueup predict` gives the same figures from the terms in
//! `extended.toml` (tested).

use std::f64::consts::TAU;

use trueup_machine::{
    machine_file::{BSpline, LinearAxis, Quantity, Source, Thermal},
    model::{WarmupState, shifted, spline_um, thermal_um},
};

use crate::data::Data;

/// A cause with what is fixed about it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Kind {
    SensorOffset,
    SensorGain,
    SensorCurvature,
    SensorSaturation,
    SensorTemperatureDrift {
        column: String,
    },
    TimeShift,
    ThermalLag,
    /// In time.
    SlowMode,
    /// Of a column in use.
    SlowModeOf {
        column: String,
    },
    ExtraHeatPath {
        column: String,
        has_lag: bool,
    },
    GrowthAmplitude,
    GrowthRate,
    CoolingAsymmetry,
    ExpansionSlope,
    ReferenceTemperature,
    CentrifugalGrowth,
    CuttingLoad,
    PitchScale,
    PitchError {
        start_mm: f64,
        step_mm: f64,
        points: usize,
        both_ways: bool,
    },
    PitchPeriodic {
        harmonics: Vec<u32>,
    },
    Backlash,
    PositionDependentBacklash,
    Straightness {
        along: LinearAxis,
        knots_mm: Vec<f64>,
    },
    CrossAxis {
        axis: LinearAxis,
    },
    Step,
    Drift,
    /// Waves of C/(P + P₀); of an elongation, waves of the reading.
    ReferenceInstrument {
        is_angled: bool,
    },
    /// A test of structure and no cause: a curve over a column.
    Curve {
        column: String,
        knots: Vec<f64>,
        by_direction: bool,
    },
}

/// A cause and its values.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Part {
    pub kind: Kind,
    pub values: Vec<f64>,
}

/// Terms and a constant, on top of what the machine file says.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Model {
    pub parts: Vec<Part>,
    /// The zero of the measurement, where it is arbitrary.
    pub constant_um: Option<f64>,
}

/// How a value is varied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scale {
    Linear,
    Logarithmic,
}

impl Kind {
    /// Its nonlinear values.
    pub(crate) fn nonlinear(&self) -> &'static [Scale] {
        use Scale::{Linear, Logarithmic};
        match self {
            Self::SensorSaturation | Self::TimeShift | Self::Step => &[Linear],
            Self::ThermalLag
            | Self::SlowMode
            | Self::SlowModeOf { .. }
            | Self::ExtraHeatPath { has_lag: true, .. }
            | Self::GrowthRate
            | Self::CoolingAsymmetry
            | Self::PitchPeriodic { .. }
            | Self::ReferenceInstrument { is_angled: false } => &[Logarithmic],
            Self::ReferenceInstrument { is_angled: true } => &[Logarithmic, Linear],
            _ => &[],
        }
    }

    /// How many amplitudes it has.
    pub(crate) fn amplitudes(&self) -> usize {
        match self {
            Self::SensorSaturation
            | Self::TimeShift
            | Self::ThermalLag
            | Self::GrowthRate
            | Self::CoolingAsymmetry => 0,
            Self::PitchError { points, both_ways, .. } => {
                if *both_ways {
                    2 * points
                } else {
                    *points
                }
            }
            Self::PitchPeriodic { harmonics } => 2 * harmonics.len(),
            Self::ReferenceInstrument { .. } => 2,
            Self::Straightness { knots_mm, .. } => knots_mm.len() - 4,
            Self::Curve { knots, by_direction, .. } => {
                if *by_direction {
                    2 * knots.len()
                } else {
                    knots.len()
                }
            }
            _ => 1,
        }
    }

    /// What it counts for where simplicity counts.
    pub(crate) fn degrees(&self) -> usize {
        self.nonlinear().len() + self.amplitudes()
    }

    /// 0: a constant of the machine's own model, or of the axis's; 1: something else that was
    /// recorded; 2: time alone, or the instrument; 3: no cause.
    pub(crate) fn tier(&self) -> u8 {
        match self {
            Self::SlowMode
            | Self::SlowModeOf { .. }
            | Self::ExtraHeatPath { .. }
            | Self::CoolingAsymmetry
            | Self::CentrifugalGrowth
            | Self::CuttingLoad
            | Self::Straightness { .. }
            | Self::CrossAxis { .. } => 1,
            Self::TimeShift | Self::Step | Self::Drift | Self::ReferenceInstrument { .. } => 2,
            Self::Curve { .. } => 3,
            _ => 0,
        }
    }

    /// Whether its reference (a temperature, a start) is its own, and with it a constant.
    pub(crate) fn has_reference(&self) -> bool {
        matches!(
            self,
            Self::SensorTemperatureDrift { .. }
                | Self::SlowMode
                | Self::SlowModeOf { .. }
                | Self::ExtraHeatPath { .. }
        )
    }

    /// Whether it may change the constants of the machine's own model, or the source's law.
    fn replaces(&self) -> bool {
        matches!(
            self,
            Self::ThermalLag
                | Self::GrowthRate
                | Self::CoolingAsymmetry
                | Self::ExpansionSlope
                | Self::ReferenceTemperature
        )
    }

    /// Where in the fixed order it comes.
    pub(crate) fn rank(&self) -> u8 {
        match self {
            _ if self.replaces() => 0,
            Self::SensorGain | Self::GrowthAmplitude => 1,
            Self::SensorCurvature => 2,
            Self::SensorSaturation => 3,
            Self::TimeShift => 5,
            _ => 4,
        }
    }

    /// Whether it changes the elongation, which then goes along the tool; else the axis.
    pub(crate) fn is_of_elongation(&self, data: &Data) -> bool {
        if data.quantity == Quantity::Elongation {
            return true;
        }
        let axis_is_thermal = own_thermal(data).is_some();
        match self {
            Self::SensorOffset
            | Self::SensorGain
            | Self::SensorCurvature
            | Self::SensorSaturation
            | Self::SensorTemperatureDrift { .. }
            | Self::GrowthAmplitude
            | Self::GrowthRate
            | Self::CentrifugalGrowth
            | Self::CuttingLoad => true,
            Self::ThermalLag | Self::CoolingAsymmetry => !axis_is_thermal,
            Self::SlowMode | Self::SlowModeOf { .. } | Self::ExtraHeatPath { .. } => {
                data.has_elongation && data.along.iter().any(|along| *along != 0.0)
            }
            _ => false,
        }
    }
}

/// The thermal section of the quantity's own axis.
pub(crate) fn own_thermal(data: &Data) -> Option<&Thermal> {
    data.quantity.axis().and_then(|axis| data.machine.axes[axis.index()].thermal.as_ref())
}

/// Constants of the machine's model that are not as believed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Changed {
    lag_s: Option<f64>,
    fall_s: Option<f64>,
    rate_s: Option<f64>,
    slope: f64,
    shift_c: f64,
}

impl Model {
    /// The parts in their fixed order.
    pub(crate) fn sort(&mut self) {
        self.parts.sort_by_key(|part| part.kind.rank());
    }

    pub(crate) fn has(&self, kind: &Kind) -> bool {
        self.parts.iter().any(|part| part.kind == *kind)
    }

    fn changed(&self) -> Changed {
        let mut changed = Changed::default();
        for Part { kind, values } in &self.parts {
            match kind {
                Kind::ThermalLag => changed.lag_s = Some(values[0]),
                Kind::GrowthRate => changed.rate_s = Some(values[0]),
                Kind::CoolingAsymmetry => changed.fall_s = Some(values[0]),
                Kind::ExpansionSlope => changed.slope += values[0],
                Kind::ReferenceTemperature => changed.shift_c += values[0],
                _ => {}
            }
        }
        changed
    }

    /// The prediction of each row.
    pub(crate) fn predict(&self, data: &Data) -> Vec<f64> {
        let changed = self.changed();
        let mut elongation = elongation(data, changed);
        let mut axis = axis(data, changed);
        for part in &self.parts {
            let is_of_elongation = part.kind.is_of_elongation(data);
            let p = if is_of_elongation { &mut elongation } else { &mut axis };
            match part.kind {
                Kind::TimeShift => {}
                Kind::SensorSaturation => {
                    let limit = part.values[0];
                    p.iter_mut().for_each(|p| {
                        if *p > limit {
                            *p = limit;
                        }
                    });
                }
                _ if part.kind.replaces() => {}
                _ => {
                    let start = part.kind.nonlinear().len();
                    let columns = basis(&part.kind, &part.values[..start], data, p);
                    for (column, amplitude) in columns.iter().zip(&part.values[start..]) {
                        if *amplitude != 0.0 {
                            p.iter_mut().zip(column).for_each(|(p, c)| *p += amplitude * c);
                        }
                    }
                }
            }
        }
        let constant = self.constant_um.unwrap_or(0.0);
        let mut sum: Vec<f64> = elongation
            .iter()
            .zip(&data.along)
            .zip(&axis)
            .map(|((e, along), a)| if *along == 0.0 { *a } else { e * along + a } + constant)
            .collect();
        if let (Some(part), Some(time_s)) =
            (self.parts.iter().find(|part| part.kind == Kind::TimeShift), &data.time_s)
        {
            sum = shifted_all(data, time_s, &sum, part.values[0]);
        }
        sum
    }
}

fn shifted_all(data: &Data, time_s: &[f64], sum: &[f64], shift_s: f64) -> Vec<f64> {
    // Files may overlap in time without running back; each is shifted for itself.
    let mut out = Vec::with_capacity(sum.len());
    let mut start = 0;
    for file in 0..data.files {
        let end = data.file.partition_point(|&there| there <= file);
        out.extend(shifted(&time_s[start..end], &sum[start..end], shift_s));
        start = end;
    }
    out
}

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
            vec![above(data, column, lagged(data, &temperature(column), tau, tau))]
        }
        Kind::ExtraHeatPath { column, has_lag: false } => {
            vec![above(data, column, filled(&temperature(column)))]
        }
        Kind::ExpansionSlope => vec![thermal_slope(data)],
        Kind::ReferenceTemperature => vec![thermal_shift(data)],
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
        Kind::ReferenceInstrument { is_angled } => {
            // What is read is about what is predicted; the reading itself has its own noise in it,
            // which a wave of the reading would follow.
            let reading = if data.quantity == Quantity::Elongation {
                filled(&data.elongation)
            } else {
                own()
            };
            let turns = |mm: &f64| {
                if *is_angled { nonlinear[0] / (mm + nonlinear[1]) } else { mm / nonlinear[0] }
            };
            let wave = |of: fn(f64) -> f64| reading.iter().map(|mm| of(TAU * turns(mm))).collect();
            vec![wave(f64::sin), wave(f64::cos)]
        }
        Kind::Curve { column, knots, by_direction } => {
            let values = filled(named(data, column).unwrap_or(&[]));
            let mut columns = vec![vec![0.0; rows]; kind.amplitudes()];
            for (row, &value) in values.iter().enumerate() {
                let above = knots.partition_point(|&knot| knot <= value).clamp(1, knots.len() - 1);
                let (low, high) = (knots[above - 1], knots[above]);
                let share = ((value - low) / (high - low)).clamp(0.0, 1.0);
                let offset = if *by_direction && reverse(row) { knots.len() } else { 0 };
                columns[offset + above - 1][row] = 1.0 - share;
                columns[offset + above][row] = share;
            }
            columns
        }
        Kind::SensorSaturation
        | Kind::TimeShift
        | Kind::ThermalLag
        | Kind::GrowthRate
        | Kind::CoolingAsymmetry => Vec::new(),
    }
}

/// A column by its name in the file.
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
        _ => data.temperature(name).or_else(|| {
            let found = data.others.iter().find(|(there, _)| there == name);
            found.map(|(_, values)| values.as_slice())
        }),
    }
}

fn position(data: &Data, axis: LinearAxis) -> Vec<f64> {
    let column = data.position_mm[axis.index()].as_deref();
    column.map_or_else(|| vec![0.0; data.rows], filled)
}

/// With the value before in place of a missing one; at the start, the next one.
pub(crate) fn filled(values: &[f64]) -> Vec<f64> {
    let mut last = Data::first_of(values);
    values
        .iter()
        .map(|&value| {
            if !value.is_nan() {
                last = value;
            }
            last
        })
        .collect()
}

/// Above what `column` was at the first row: until a reference is fitted, that is the zero.
fn above(data: &Data, column: &str, mut values: Vec<f64>) -> Vec<f64> {
    let reference_c = data.reference_c(column);
    values.iter_mut().for_each(|value| *value -= reference_c);
    values
}

/// A column behind a first-order lag with one time constant while it rises and one while it falls,
/// as `trueup_machine::model::Lag` steps it; missing values hold.
pub(crate) fn lagged(data: &Data, values: &[f64], rise_s: f64, fall_s: f64) -> Vec<f64> {
    let Some(time_s) = data.time_s.as_deref() else { return filled(values) };
    let mut out = Vec::with_capacity(values.len());
    let mut settled: Option<f64> = None;
    let mut before_s = f64::NAN;
    // Most rows are as far apart as the rows before them.
    let (mut last_elapsed, mut last_shares) = (f64::NAN, [1.0; 2]);
    let share = |elapsed: f64, lag_s: f64| {
        if lag_s == 0.0 { 1.0 } else { -(-elapsed / lag_s).exp_m1() }
    };
    for row in 0..values.len() {
        if data.restart[row] {
            (settled, before_s) = (None, f64::NAN);
        }
        let (value, now_s) = (values[row], time_s[row]);
        if !value.is_nan() && !now_s.is_nan() {
            let before = settled.unwrap_or(value);
            let elapsed = if before_s.is_nan() { 0.0 } else { (now_s - before_s).max(0.0) };
            before_s = now_s;
            if elapsed != last_elapsed {
                last_elapsed = elapsed;
                last_shares = [share(elapsed, rise_s), share(elapsed, fall_s)];
            }
            let share = if value < before { last_shares[1] } else { last_shares[0] };
            settled = Some(before + (value - before) * share);
        }
        out.push(settled.unwrap_or(f64::NAN));
    }
    if out.iter().any(|value| value.is_nan()) { filled(&out) } else { out }
}

/// The elongation with the changed constants.
fn elongation(data: &Data, changed: Changed) -> Vec<f64> {
    let spindle = &data.machine.spindle;
    match (spindle.source, &spindle.temperature, &spindle.warmup) {
        (Some(Source::Temperature), Some(model), _)
            if is_elongation_lag(data) && (changed.lag_s.is_some() || changed.fall_s.is_some()) =>
        {
            let Some(column) = data.temperature(&model.sensor) else {
                return data.elongation.clone();
            };
            let rise_s = changed.lag_s.unwrap_or(model.lag_s);
            let lagged = lagged(data, column, rise_s, changed.fall_s.unwrap_or(rise_s));
            lagged.iter().map(|c| model.k_um_per_c * (c - model.reference_c)).collect()
        }
        (Some(Source::Warmup), _, Some(model))
            if changed.rate_s.is_some() || changed.fall_s.is_some() =>
        {
            let Some(time_s) = data.time_s.as_deref() else { return data.elongation.clone() };
            // So large an exponent makes it an exponential without an end, as in `predict`.
            const ENDLESS: f64 = 40.0;
            let mut model = model.clone();
            if let Some(rate_s) = changed.rate_s {
                model.exponent = ENDLESS;
                model.warm_s = model.lag_s + ENDLESS * rate_s;
            }
            if let Some(fall_s) = changed.fall_s {
                model.cool_s = Some(fall_s);
            }
            let rated_rpm = model.rated_rpm.unwrap_or(1.0);
            let mut state = WarmupState::default();
            let grown: Vec<f64> = (0..data.rows)
                .map(|row| {
                    if data.restart[row] {
                        state = WarmupState::default();
                    }
                    let rpm = data.spindle_rpm.as_ref().map_or(rated_rpm, |rpm| rpm[row]);
                    state.step(&model, time_s[row], rpm)
                })
                .collect();
            filled(&grown)
        }
        _ => data.elongation.clone(),
    }
}

/// Whether a lag of the model is the spindle's; else it is the axis's.
fn is_elongation_lag(data: &Data) -> bool {
    data.quantity == Quantity::Elongation || own_thermal(data).is_none()
}

/// The axis's error with the changed constants.
fn axis(data: &Data, changed: Changed) -> Vec<f64> {
    let unchanged = changed == Changed { rate_s: changed.rate_s, ..Changed::default() };
    let Some(thermal) = own_thermal(data).filter(|_| !unchanged) else { return data.axis.clone() };
    let Some(column) = data.temperature(&thermal.sensor) else { return data.axis.clone() };
    let mut thermal = thermal.clone();
    thermal.slope_um_per_m_per_c += changed.slope;
    thermal.reference_c += changed.shift_c;
    let rise_s = changed.lag_s.unwrap_or(thermal.lag_s);
    let lagged = lagged(data, column, rise_s, changed.fall_s.unwrap_or(rise_s));
    let position = data.own_position();
    (0..data.rows)
        .map(|row| {
            let mm = position.map_or(f64::NAN, |mm| mm[row]);
            data.axis[row] - data.thermal[row] + thermal_um(&thermal, lagged[row], mm)
        })
        .collect()
}

/// The axis's lagged temperature above its reference, times its position in metres.
fn thermal_slope(data: &Data) -> Vec<f64> {
    let Some(thermal) = own_thermal(data) else { return vec![0.0; data.rows] };
    let Some(column) = data.temperature(&thermal.sensor) else { return vec![0.0; data.rows] };
    let lagged = lagged(data, column, thermal.lag_s, thermal.lag_s);
    let position = data.own_position().map_or_else(|| vec![0.0; data.rows], filled);
    lagged
        .iter()
        .zip(position)
        .map(|(c, mm)| (c - thermal.reference_c) * (mm - thermal.origin_mm) / 1000.0)
        .collect()
}

/// What the axis's error loses for one kelvin more of its reference.
fn thermal_shift(data: &Data) -> Vec<f64> {
    let Some(thermal) = own_thermal(data) else { return vec![0.0; data.rows] };
    let position = data.own_position().map_or_else(|| vec![0.0; data.rows], filled);
    position
        .iter()
        .map(|mm| {
            let mut um = 0.0;
            if thermal.mode.has_constant() {
                um -= thermal.constant_um_per_c;
            }
            if thermal.mode.has_position() {
                um -= thermal.slope_um_per_m_per_c * (mm - thermal.origin_mm) / 1000.0;
            }
            um
        })
        .collect()
}
