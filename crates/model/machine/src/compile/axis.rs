//! The model of one linear axis along its own direction.

use trueup_core::{
    calibration,
    lag::SmoothingFactor,
    pitch::Beam,
    thermal::Law,
    travel::{self, Interval},
    units::{Fine, Position},
};

use super::{
    account::Account,
    heat::{self, Pieces},
    inputs::channel,
    lag,
    pitch::{self, PitchTables, compile_pitch},
    squareness::{linear, linear_inverse},
};
use crate::{
    file::{self, Backlash, Dual, Feedback, LinearAxis, Machine},
    location::BadInput,
    stored::{FINE_PER_UM, UNITS_PER_MM, rounded, rounded_unsigned, written},
};

/// The board's units of a speed (10 nm a millisecond) in one mm a minute.
const UNITS_PER_MS: f64 = UNITS_PER_MM / 60_000.0;

/// The tables of one axis.
pub(super) struct AxisTables {
    law: Pieces,
    /// Of the lag, rising and falling.
    smoothing: [SmoothingFactor; 2],
    pitch: Option<PitchTables>,
    dual: Option<PitchTables>,
}

pub(super) fn compile(
    axis: &file::AxisModel,
    name: LinearAxis,
    falling_s: Option<f64>,
    account: &mut Account<'_>,
) -> Result<AxisTables, BadInput> {
    let key = format!("axis.{}", name.name());
    let mut tables = AxisTables {
        law: Pieces::new(),
        smoothing: [SmoothingFactor::NO_LAG; 2],
        pitch: None,
        dual: None,
    };
    if let Some(thermal) = &axis.thermal {
        tables.law = account.take(&format!("{key}.thermal"), heat::axis_law(thermal))?;
        let factors =
            lag::smoothing_factors(thermal.lag_s, falling_s).map(|factors| (factors, 0.0));
        tables.smoothing = account.take(&format!("{key}.thermal.lag_s"), factors)?;
    }
    if let Some(pitch) = &axis.pitch {
        tables.pitch = Some(account.take(&format!("{key}.pitch"), compile_pitch(pitch))?);
    }
    if let Some(dual) = &axis.dual {
        tables.dual = Some(account.take(&format!("{key}.dual.pitch"), compile_pitch(&dual.pitch))?);
    }
    Ok(tables)
}

pub(super) fn view<'t>(
    machine: &Machine,
    number: usize,
    tables: &'t AxisTables,
) -> Result<calibration::AxisModel<'t>, BadInput> {
    let axis = &machine.axes[number];
    let key = format!("axis.{}", LinearAxis::ALL[number].name());
    let bad = |key: String, rule: String| machine.places.bad(&key, rule);
    let position = |key: &str, mm: f64| {
        rounded(mm * UNITS_PER_MM)
            .map(Position)
            .ok_or_else(|| bad(key.into(), format!("{mm} is beyond the board's ±21474 mm")))
    };
    let length = |key: String, mm: f64| {
        rounded_unsigned(mm * UNITS_PER_MM)
            .ok_or_else(|| bad(key, format!("{mm} mm is beyond the board's 42949 mm")))
    };
    let thermal = match &axis.thermal {
        None => None,
        Some(thermal) => {
            let key = format!("{key}.thermal");
            Some(calibration::AxisThermal {
                channel: channel(machine, &key, &thermal.sensor)?,
                smoothing: tables.smoothing[0],
                smoothing_falling: tables.smoothing[1],
                origin: position(&format!("{key}.origin_mm"), thermal.origin_mm)?,
                law: Law { pieces: &tables.law },
            })
        }
    };
    let dual = match (&axis.dual, &tables.dual) {
        (Some(dual), Some(pitch)) => {
            let first = position(&format!("{key}.dual.first_mm"), dual.first_mm)?;
            let second = position(&format!("{key}.dual.second_mm"), dual.second_mm)?;
            let beam = Beam::new(first, second);
            Some(calibration::Dual { across: linear(dual.across), beam, pitch: pitch.view() })
        }
        _ => None,
    };
    let (mut backlash, mut travel) = (Fine::ZERO, travel::Config::default());
    if let Some(model) = &axis.backlash {
        let key = format!("{key}.backlash");
        backlash = rounded(model.width_um * FINE_PER_UM).map(Fine).ok_or_else(|| {
            let rule = format!("{} is beyond the board's ±8388 µm", model.width_um);
            bad(format!("{key}.width_um"), rule)
        })?;
        travel = travel::Config {
            hysteresis: length(format!("{key}.hysteresis_um"), model.hysteresis_um / 1_000.0)?,
            ramp: Interval::new(length(format!("{key}.ramp_mm"), model.ramp_mm)?),
        };
    }
    let pitch = tables.pitch.as_ref().map(PitchTables::view);
    let mm_per_min = axis.rapid_mm_per_min.unwrap_or(0.0);
    let rapid =
        rounded_unsigned(mm_per_min * UNITS_PER_MS).filter(|it| (*it > 0) == (mm_per_min > 0.0));
    let rapid = rapid.ok_or_else(|| {
        let rule = format!("{mm_per_min} mm/min is not within the board's 0.6 to 2·10⁹");
        bad(format!("{key}.rapid_mm_per_min"), rule)
    })?;
    Ok(calibration::AxisModel { thermal, pitch, dual, backlash, travel, rapid })
}

/// Returns the axis as a user writes it.
pub(super) fn inverse(axis: &calibration::AxisModel<'_>) -> file::AxisModel {
    let calibration::AxisModel { thermal, pitch, dual, backlash, travel, rapid } = axis;
    let has_backlash = *backlash != Fine::ZERO || *travel != travel::Config::default();
    file::AxisModel {
        feedback: Feedback::Screw,
        travel_mm: None,
        rapid_mm_per_min: (*rapid != 0).then(|| written(*rapid, UNITS_PER_MS)),
        thermal: thermal.as_ref().map(heat::inverse_of_axis),
        pitch: pitch.as_ref().map(pitch::inverse),
        backlash: has_backlash.then(|| Backlash {
            width_um: written(backlash.0, FINE_PER_UM),
            ramp_mm: written(travel.ramp.length(), UNITS_PER_MM),
            hysteresis_um: written(travel.hysteresis, UNITS_PER_MM / 1_000.0),
        }),
        dual: dual.as_ref().map(|calibration::Dual { across, beam, pitch }| {
            let [first_mm, second_mm] = beam.drives().map(|drive| written(drive.0, UNITS_PER_MM));
            let across = linear_inverse(*across);
            Dual { across, first_mm, second_mm, pitch: pitch::inverse(pitch) }
        }),
    }
}
