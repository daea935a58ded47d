//! The model of one linear axis along its own direction.

use trueup_core::{
    calibration,
    lag::SmoothingFactor,
    pitch_table::GantryBeam,
    reversal::{self, Interval},
    thermal::ThermalExpansionLaw,
    units::{FineNanometres, Position},
};

use super::{
    inputs::find_channel,
    lag,
    part_differences::PartDifferences,
    pitch::{self, OwnedPitchTable, compile_pitch},
    squareness::{linear_axis_from_board, linear_axis_to_board},
    thermal::{self, ThermalLawSegments},
};
use crate::{
    location::InputFileError,
    machine_file::{self, Machine},
    sections::{Backlash, Feedback, LinearAxis, SecondDrive},
    unit_conversion::{
        FINE_UNITS_PER_UM, POSITION_UNITS_PER_MM, round_to_i32, round_to_u32, to_user_value,
    },
};

/// The board's units of a speed (10 nm a millisecond) in one mm a minute.
const SPEED_UNITS_PER_MM_PER_MIN: f64 = POSITION_UNITS_PER_MM / 60_000.0;

/// The tables of one axis.
pub(super) struct OwnedAxis {
    law: ThermalLawSegments,
    /// Of the lag, rising and falling.
    smoothing: [SmoothingFactor; 2],
    pitch: Option<OwnedPitchTable>,
    dual: Option<OwnedPitchTable>,
}

pub(super) fn compile(
    axis: &machine_file::AxisModel,
    name: LinearAxis,
    falling_s: Option<f64>,
    account: &mut PartDifferences<'_>,
) -> Result<OwnedAxis, InputFileError> {
    let key = format!("axis.{}", name.name());
    let mut tables = OwnedAxis {
        law: ThermalLawSegments::new(),
        smoothing: [SmoothingFactor::NO_LAG; 2],
        pitch: None,
        dual: None,
    };
    if let Some(thermal) = &axis.thermal {
        tables.law = account.check_and_record_difference(
            &format!("{key}.thermal"),
            thermal::compile_axis_law(thermal),
        )?;
        let factors =
            lag::smoothing_factors(thermal.lag_s, falling_s).map(|factors| (factors, 0.0));
        tables.smoothing =
            account.check_and_record_difference(&format!("{key}.thermal.lag_s"), factors)?;
    }
    if let Some(pitch) = &axis.pitch {
        tables.pitch = Some(
            account.check_and_record_difference(&format!("{key}.pitch"), compile_pitch(pitch))?,
        );
    }
    if let Some(dual) = &axis.dual {
        tables.dual = Some(account.check_and_record_difference(
            &format!("{key}.dual.pitch"),
            compile_pitch(&dual.pitch),
        )?);
    }
    Ok(tables)
}

pub(super) fn build_axis_model<'t>(
    machine: &Machine,
    number: usize,
    tables: &'t OwnedAxis,
) -> Result<calibration::AxisModel<'t>, InputFileError> {
    let axis = &machine.axes[number];
    let key = format!("axis.{}", LinearAxis::ALL[number].name());
    let bad = |key: String, rule: String| machine.places.key_error(&key, rule);
    let position = |key: &str, mm: f64| {
        round_to_i32(mm * POSITION_UNITS_PER_MM)
            .map(Position)
            .ok_or_else(|| bad(key.into(), format!("{mm} is beyond the board's ±21474 mm")))
    };
    let length = |key: String, mm: f64| {
        round_to_u32(mm * POSITION_UNITS_PER_MM)
            .ok_or_else(|| bad(key, format!("{mm} mm is beyond the board's 42949 mm")))
    };
    let thermal = match &axis.thermal {
        None => None,
        Some(thermal) => {
            let key = format!("{key}.thermal");
            Some(calibration::AxisThermalModel {
                channel: find_channel(machine, &key, &thermal.sensor)?,
                smoothing: tables.smoothing[0],
                smoothing_falling: tables.smoothing[1],
                origin: position(&format!("{key}.origin_mm"), thermal.origin_mm)?,
                law: ThermalExpansionLaw { pieces: &tables.law },
            })
        }
    };
    let dual = match (&axis.dual, &tables.dual) {
        (Some(dual), Some(pitch)) => {
            let first = position(&format!("{key}.dual.first_mm"), dual.first_mm)?;
            let second = position(&format!("{key}.dual.second_mm"), dual.second_mm)?;
            let beam = GantryBeam::new(first, second);
            Some(calibration::DualDrive {
                across: linear_axis_to_board(dual.across),
                beam,
                pitch: pitch.view(),
            })
        }
        _ => None,
    };
    let (mut backlash, mut travel) = (FineNanometres::ZERO, reversal::ReversalConfig::default());
    if let Some(model) = &axis.backlash {
        let key = format!("{key}.backlash");
        backlash = round_to_i32(model.width_um * FINE_UNITS_PER_UM)
            .map(FineNanometres)
            .ok_or_else(|| {
                let rule = format!("{} is beyond the board's ±8388 µm", model.width_um);
                bad(format!("{key}.width_um"), rule)
            })?;
        travel = reversal::ReversalConfig {
            hysteresis: length(format!("{key}.hysteresis_um"), model.hysteresis_um / 1_000.0)?,
            ramp: Interval::new(length(format!("{key}.ramp_mm"), model.ramp_mm)?),
        };
    }
    let pitch = tables.pitch.as_ref().map(OwnedPitchTable::view);
    let mm_per_min = axis.rapid_mm_per_min.unwrap_or(0.0);
    let rapid = round_to_u32(mm_per_min * SPEED_UNITS_PER_MM_PER_MIN)
        .filter(|speed| (*speed > 0) == (mm_per_min > 0.0));
    let rapid = rapid.ok_or_else(|| {
        let rule = format!("{mm_per_min} mm/min is not within the board's 0.6 to 2·10⁹");
        bad(format!("{key}.rapid_mm_per_min"), rule)
    })?;
    Ok(calibration::AxisModel { thermal, pitch, dual, backlash, travel, rapid })
}

/// Returns the axis as a user writes it.
pub(super) fn decompile(axis: &calibration::AxisModel<'_>) -> machine_file::AxisModel {
    let calibration::AxisModel { thermal, pitch, dual, backlash, travel, rapid } = axis;
    let has_backlash =
        *backlash != FineNanometres::ZERO || *travel != reversal::ReversalConfig::default();
    machine_file::AxisModel {
        feedback: Feedback::Screw,
        travel_mm: None,
        rapid_mm_per_min: (*rapid != 0).then(|| to_user_value(*rapid, SPEED_UNITS_PER_MM_PER_MIN)),
        thermal: thermal.as_ref().map(thermal::decompile_axis_thermal),
        pitch: pitch.as_ref().map(pitch::decompile),
        backlash: has_backlash.then(|| Backlash {
            width_um: to_user_value(backlash.0, FINE_UNITS_PER_UM),
            ramp_mm: to_user_value(travel.ramp.length(), POSITION_UNITS_PER_MM),
            hysteresis_um: to_user_value(travel.hysteresis, POSITION_UNITS_PER_MM / 1_000.0),
        }),
        dual: dual.as_ref().map(|calibration::DualDrive { across, beam, pitch }| {
            let [first_mm, second_mm] =
                beam.drive_positions().map(|drive| to_user_value(drive.0, POSITION_UNITS_PER_MM));
            let across = linear_axis_from_board(*across);
            SecondDrive { across, first_mm, second_mm, pitch: pitch::decompile(pitch) }
        }),
    }
}
