//! The terms of a diagnosis, in `f64`: each a change of the prediction p of one quantity.
//!
//! Some correct a constant of the model. They are folded into the machine before it is stepped
//! ([`corrected`]); the others take p and give a new one row by row, in the order of the file. The
//! formulas stand with [`Effect`]. A value that a term needs and that is missing (NaN) makes p NaN.

use std::{borrow::Cow, f64::consts::TAU};

use super::{Lag, Situation, is_reverse, pitch_um, spline_um};
use crate::file::{Effect, LinearAxis, Machine, Quantity, Term, Wave};

/// The time constants of lags while what they follow falls; `None`: the same as while it rises.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Falling {
    /// Of `[spindle.temperature]`, in s.
    pub spindle_s: Option<f64>,
    /// Of `[axis.*.thermal]`, in s.
    pub axes_s: [Option<f64>; 3],
}

/// So large an exponent makes the warm-up an exponential without an end: 1 − e^(−40) is 1.
const ENDLESS: f64 = 40.0;

/// The machine with the constants that its terms say are right.
///
/// A warm-up's `cool_s` that is not written follows its rate of heating, corrected or not.
#[must_use]
pub fn corrected(machine: Cow<'_, Machine>) -> (Cow<'_, Machine>, Falling) {
    let mut corrected = machine;
    let mut falling = Falling::default();
    for index in 0..corrected.terms.len() {
        let Term { quantity, effect, .. } = &corrected.terms[index];
        let axis = quantity.axis().map(LinearAxis::index);
        match *effect {
            Effect::ThermalLag { time_constant_s } => {
                let machine = corrected.to_mut();
                let spindle = machine.spindle.temperature.as_mut().map(|model| &mut model.lag_s);
                let lag_s = match axis {
                    None => spindle,
                    Some(axis) => machine.axes[axis].thermal.as_mut().map(|it| &mut it.lag_s),
                };
                if let Some(lag_s) = lag_s {
                    *lag_s = time_constant_s;
                }
            }
            Effect::GrowthRate { time_constant_s } => {
                if let Some(warmup) = &mut corrected.to_mut().spindle.warmup {
                    warmup.exponent = ENDLESS;
                    warmup.warm_s = warmup.lag_s + ENDLESS * time_constant_s;
                }
            }
            Effect::CoolingAsymmetry { time_constant_s } => match axis {
                Some(axis) => falling.axes_s[axis] = Some(time_constant_s),
                None => {
                    falling.spindle_s = Some(time_constant_s);
                    if let Some(warmup) = &mut corrected.to_mut().spindle.warmup {
                        warmup.cool_s = Some(time_constant_s);
                    }
                }
            },
            Effect::ExpansionSlope { um_per_m_per_c } => {
                let thermal = axis.and_then(|axis| corrected.to_mut().axes[axis].thermal.as_mut());
                if let Some(thermal) = thermal {
                    thermal.slope_um_per_m_per_c = um_per_m_per_c;
                }
            }
            Effect::ReferenceTemperature { shift_c } => {
                let thermal = axis.and_then(|axis| corrected.to_mut().axes[axis].thermal.as_mut());
                if let Some(thermal) = thermal {
                    thermal.shift_reference(shift_c);
                }
            }
            _ => {}
        }
    }
    (corrected, falling)
}

/// What the terms of a machine remember from row to row: one lag a term.
#[derive(Clone, Debug, Default)]
pub(super) struct TermLags(Vec<Lag>);

impl TermLags {
    /// The prediction `p_um` of `quantity` with the terms that change it, but for a time shift.
    pub(super) fn apply(
        &mut self,
        terms: &[Term],
        quantity: Quantity,
        time_s: f64,
        situation: &Situation<'_>,
        mut p_um: f64,
    ) -> f64 {
        self.0.resize_with(terms.len(), Lag::default);
        for (term, lag) in terms.iter().zip(&mut self.0) {
            if term.quantity == quantity {
                p_um = changed(term, lag, time_s, situation, p_um) + term.constant_um;
            }
        }
        p_um
    }
}

fn changed(term: &Term, lag: &mut Lag, time_s: f64, situation: &Situation<'_>, p_um: f64) -> f64 {
    let of = |axis: LinearAxis| situation.position_mm[axis.index()];
    let position_mm = || term.quantity.axis().map_or(f64::NAN, of);
    let direction = || term.quantity.axis().map_or(1.0, |axis| situation.direction[axis.index()]);
    let reversed = |um: f64| if is_reverse(direction()) { um } else { 0.0 };
    p_um + match &term.effect {
        Effect::SensorOffset { offset_um } => *offset_um,
        Effect::SensorGain { gain } | Effect::GrowthAmplitude { scale: gain } => {
            (gain - 1.0) * p_um
        }
        Effect::SensorCurvature { per_um } => per_um * p_um * p_um,
        // Not min(): a missing p stays missing.
        Effect::SensorSaturation { limit_um } if p_um > *limit_um => limit_um - p_um,
        Effect::SensorTemperatureDrift { column, um_per_c, reference_c } => {
            um_per_c * (situation.temperature_c(column) - reference_c)
        }
        Effect::SlowMode { amplitude_um, time_constant_s, start_s } => {
            // NaN stays NaN, which max() would lose.
            let since_s = time_s - start_s;
            let since_s = if since_s < 0.0 { 0.0 } else { since_s };
            -amplitude_um * (-since_s / time_constant_s).exp_m1()
        }
        Effect::SlowModeOf { column, um_per_c, time_constant_s, reference_c }
        | Effect::ExtraHeatPath { column, um_per_c, time_constant_s, reference_c } => {
            let temperature_c = situation.temperature_c(column);
            um_per_c * (lag.step(*time_constant_s, time_s, temperature_c) - reference_c)
        }
        Effect::CentrifugalGrowth { um_per_krpm2 } => {
            um_per_krpm2 * (situation.spindle_rpm.unwrap_or(f64::NAN) / 1000.0).powi(2)
        }
        Effect::CuttingLoad { um_per_n } => -um_per_n * situation.load_n.unwrap_or(f64::NAN),
        Effect::PitchScale { um_per_m } => um_per_m * position_mm() / 1000.0,
        Effect::PitchError(pitch) => pitch_um(pitch, position_mm(), direction()),
        Effect::PitchPeriodic { period_mm, waves } => waves_um(waves, position_mm() / period_mm),
        Effect::Backlash { width_um } => reversed(*width_um),
        Effect::PositionDependentBacklash { um_per_m } => {
            reversed(um_per_m * position_mm() / 1000.0)
        }
        Effect::Straightness { along, spline } => spline_um(spline, of(*along)),
        Effect::CrossAxis { axis, um_per_m } => um_per_m * of(*axis) / 1000.0,
        Effect::Step { at_s, size_um } => {
            if time_s.is_nan() {
                f64::NAN
            } else if time_s >= *at_s {
                *size_um
            } else {
                0.0
            }
        }
        Effect::Drift { um_per_h } => um_per_h * time_s / 3600.0,
        Effect::ReferenceInstrument { period_mm, origin_mm, waves, .. } if !waves.is_empty() => {
            let turns = match origin_mm {
                None => position_mm() / period_mm,
                Some(origin_mm) => period_mm / (position_mm() + origin_mm),
            };
            waves_um(waves, turns)
        }
        // Folded into the machine, applied to the whole run, or without an effect.
        Effect::SensorSaturation { .. }
        | Effect::TimeShift { .. }
        | Effect::ThermalLag { .. }
        | Effect::GrowthRate { .. }
        | Effect::CoolingAsymmetry { .. }
        | Effect::ExpansionSlope { .. }
        | Effect::ReferenceTemperature { .. }
        | Effect::Outliers { .. }
        | Effect::ReferenceInstrument { .. } => 0.0,
    }
}

/// Σ aᵢ·sin(2π·hᵢ·turns + φᵢ).
fn waves_um(waves: &[Wave], turns: f64) -> f64 {
    let wave = |wave: &Wave| {
        let phase = TAU * f64::from(wave.harmonic) * turns + wave.phase_deg.to_radians();
        wave.amplitude_um * phase.sin()
    };
    waves.iter().map(wave).sum()
}

/// The shift in s of the predictions of `quantity`: the sum of its `time-shift` terms.
#[must_use]
pub fn time_shift_s(terms: &[Term], quantity: Quantity) -> f64 {
    let shifts = terms.iter().filter(|term| term.quantity == quantity);
    shifts
        .filter_map(|term| match term.effect {
            Effect::TimeShift { shift_s } => Some(shift_s),
            _ => None,
        })
        .sum()
}

/// A series at t − shift for each of its own times: linear between the rows that have both, the
/// end values held. Where time runs back, a new run begins. NaN where the time is missing.
///
/// ```
/// use trueup_machine::model::shifted;
/// let p = shifted(&[0.0, 10.0, 20.0], &[1.0, 2.0, 4.0], 5.0);
/// assert_eq!(p, [1.0, 1.5, 3.0]);
/// ```
#[must_use]
pub fn shifted(time_s: &[f64], values: &[f64], shift_s: f64) -> Vec<f64> {
    if shift_s == 0.0 {
        return values.to_vec();
    }
    let mut out = vec![f64::NAN; values.len()];
    let mut start = 0;
    while start < time_s.len() {
        let mut end = start;
        let mut last_s = f64::NEG_INFINITY;
        // A missing time belongs to the run around it; max() passes it over.
        while end < time_s.len() && (time_s[end].is_nan() || time_s[end] >= last_s) {
            last_s = last_s.max(time_s[end]);
            end += 1;
        }
        let known: Vec<usize> =
            (start..end).filter(|&row| !(time_s[row] + values[row]).is_nan()).collect();
        let mut after = 0;
        for row in (start..end).filter(|&row| !time_s[row].is_nan()) {
            let at_s = time_s[row] - shift_s;
            while after < known.len() && time_s[known[after]] <= at_s {
                after += 1;
            }
            out[row] = match (after.checked_sub(1).map(|n| known[n]), known.get(after)) {
                (Some(a), Some(&b)) => {
                    let share = (at_s - time_s[a]) / (time_s[b] - time_s[a]);
                    values[a] + share * (values[b] - values[a])
                }
                (Some(only), None) | (None, Some(&only)) => values[only],
                (None, None) => f64::NAN,
            };
        }
        start = end;
    }
    out
}

/// The columns that the terms need and that may be missing in a run.
pub(super) fn columns(terms: &[Term]) -> Vec<String> {
    let mut columns = Vec::new();
    for term in terms {
        let own = || term.quantity.axis().map(|axis| format!("{}_mm", axis.name()));
        match &term.effect {
            Effect::SensorTemperatureDrift { column, .. } => columns.push(column.clone()),
            Effect::SlowModeOf { column, time_constant_s, .. }
            | Effect::ExtraHeatPath { column, time_constant_s, .. } => {
                columns.push(column.clone());
                columns.extend((*time_constant_s != 0.0).then(|| "time_s".to_string()));
            }
            Effect::TimeShift { .. }
            | Effect::SlowMode { .. }
            | Effect::Step { .. }
            | Effect::Drift { .. } => columns.push("time_s".to_string()),
            Effect::CentrifugalGrowth { .. } => columns.push("spindle_rpm".to_string()),
            Effect::CuttingLoad { .. } => columns.push("load_n".to_string()),
            Effect::PitchScale { .. }
            | Effect::PitchError(_)
            | Effect::PitchPeriodic { .. }
            | Effect::PositionDependentBacklash { .. } => columns.extend(own()),
            Effect::ReferenceInstrument { waves, .. } if !waves.is_empty() => columns.extend(own()),
            Effect::Straightness { along: axis, .. } | Effect::CrossAxis { axis, .. } => {
                columns.push(format!("{}_mm", axis.name()));
            }
            _ => {}
        }
    }
    columns
}
