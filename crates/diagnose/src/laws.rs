//! The machine's own laws with other constants, in columns: what `trueup predict` steps row by row.

use trueup_machine::{
    machine_file::{Quantity, Source},
    model::{WarmupState, thermal_um},
};

use crate::{
    data::{Data, filled},
    model::{Changed, own_thermal},
};

/// The elongation with the changed constants.
pub(crate) fn elongation(data: &Data, changed: Changed) -> Vec<f64> {
    let spindle = &data.machine.spindle;
    match (spindle.source, &spindle.temperature, &spindle.warmup) {
        (Some(Source::Temperature), Some(model), _)
            if is_elongation_lag(data) && (changed.lag_s.is_some() || changed.fall_s.is_some()) =>
        {
            if data.temperature(&model.sensor).is_none() {
                return data.elongation.clone();
            }
            let rise_s = changed.lag_s.unwrap_or(model.lag_s);
            let fall_s = changed.fall_s.unwrap_or(rise_s);
            let lagged = data.lagged(&model.sensor, rise_s, fall_s);
            lagged.iter().map(|c| model.k_um_per_c * (c - model.reference_c)).collect()
        }
        (Some(Source::Warmup), _, Some(model))
            if changed.rate_s.is_some() || changed.fall_s.is_some() =>
        {
            if let Some(whole) = &data.whole {
                return whole.pick(&elongation(&whole.data, changed));
            }
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
pub(crate) fn axis(data: &Data, changed: Changed) -> Vec<f64> {
    let unchanged = changed == Changed { rate_s: changed.rate_s, ..Changed::default() };
    let Some(thermal) = own_thermal(data).filter(|_| !unchanged) else { return data.axis.clone() };
    if data.temperature(&thermal.sensor).is_none() {
        return data.axis.clone();
    }
    let mut thermal = thermal.clone();
    thermal.slope_um_per_m_per_c += changed.slope;
    thermal.shift_reference(changed.shift_c);
    let rise_s = changed.lag_s.unwrap_or(thermal.lag_s);
    let fall_s = changed.fall_s.unwrap_or(rise_s);
    let lagged = data.lagged(&thermal.sensor, rise_s, fall_s);
    let position = data.own_position();
    (0..data.rows)
        .map(|row| {
            let mm = position.map_or(f64::NAN, |mm| mm[row]);
            data.axis[row] - data.thermal[row] + thermal_um(&thermal, lagged[row], mm)
        })
        .collect()
}
