//! How far and how fast an offset may go, and how long silence is tolerated.

use trueup_core::{learned_changes::LearnedLimits, limits::CompensationLimits, units::Nanometres};
use trueup_store::calibration::{
    MAX_HOLD_MS, MAX_LEARNED_LIMITS, MAX_LINK_TIMEOUT_MS, MAX_OFFSET_NM, MAX_REJOIN_NM_PER_S,
    MAX_SLEW_NM_PER_S,
};

use crate::{
    location::InputFileError,
    machine_file::{self, Machine},
    sections::LinearAxis,
    unit_conversion::{NM_PER_UM, round_to_i32, round_to_u32},
};

/// Caps of what was learned have one decimal.
const LEARNED_LIMIT_STEPS_PER_UNIT: f64 = 10.0;

/// Returns the limits on the board.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "held to 0…255 first")]
pub(super) fn compile(machine: &Machine) -> Result<CompensationLimits, InputFileError> {
    let limits = &machine.limits;
    let mut max = [Nanometres::ZERO; 3];
    for ((stored, axis), max_um) in max.iter_mut().zip(LinearAxis::ALL).zip(limits.max_um) {
        let bad = |rule: String| {
            machine.places.key_error(&format!("limits.max_um.{}", axis.name()), rule)
        };
        let most_um = f64::from(MAX_OFFSET_NM) / NM_PER_UM;
        if !(0.0..=most_um).contains(&max_um) {
            return Err(bad(format!(
                "{max_um} is not within 0 to {most_um} µm, the most that the board allows"
            )));
        }
        *stored = Nanometres(round_to_i32(max_um * NM_PER_UM).expect("held to ±4 mm above"));
    }
    let rate = |key: &str, um_per_s: f64, most: u32| {
        let stored = round_to_u32(um_per_s * NM_PER_UM).filter(|nm| (1..=most).contains(nm));
        stored.ok_or_else(|| {
            let most_um = f64::from(most) / NM_PER_UM;
            let rule = format!(
                "{um_per_s} is not within 0.001 to {most_um} µm/s, the most that the board allows"
            );
            machine.places.key_error(&format!("limits.{key}"), rule)
        })
    };
    let slew_nm_per_s = rate("slew_um_per_s", limits.slew_um_per_s, MAX_SLEW_NM_PER_S)?;
    let rejoin_nm_per_s = rate("rejoin_um_per_s", limits.rejoin_um_per_s, MAX_REJOIN_NM_PER_S)?;
    if limits.link_timeout_ms == 0 {
        let rule = "must be at least 1: at 0 the CNC would always count as lost";
        return Err(machine.places.key_error("limits.link_timeout_ms", rule));
    }
    for (key, ms, most) in [
        ("link_timeout_ms", limits.link_timeout_ms, MAX_LINK_TIMEOUT_MS),
        ("hold_ms", limits.hold_ms, MAX_HOLD_MS),
    ] {
        if ms > most {
            let rule = format!("{ms} is above {most}, the most that the board allows");
            return Err(machine.places.key_error(&format!("limits.{key}"), rule));
        }
    }
    let cap = |key: &str, value: f64, most: u8| {
        let stored = (value * LEARNED_LIMIT_STEPS_PER_UNIT).round();
        let most_value = f64::from(most) / LEARNED_LIMIT_STEPS_PER_UNIT;
        if !(0.0..=f64::from(most)).contains(&stored)
            || (stored / LEARNED_LIMIT_STEPS_PER_UNIT - value).abs() > 1e-9
        {
            let rule = format!(
                "{value} is not one of 0, 0.1, … {most_value}, the most that the board allows"
            );
            return Err(machine.places.key_error(&format!("limits.learned.{key}"), rule));
        }
        Ok(stored as u8)
    };
    let learned = LearnedLimits {
        growth: cap("growth_percent", limits.learned.growth_percent, MAX_LEARNED_LIMITS.growth)?,
        axes: cap("axes_percent", limits.learned.axes_percent, MAX_LEARNED_LIMITS.axes)?,
        zero: cap("zero_um", limits.learned.zero_um, MAX_LEARNED_LIMITS.zero)?,
    };
    Ok(CompensationLimits {
        max,
        slew_nm_per_s,
        link_timeout_ms: limits.link_timeout_ms,
        hold_ms: limits.hold_ms,
        rejoin_nm_per_s,
        learned,
    })
}

/// Returns the limits as a user writes them.
pub(super) fn decompile(limits: &CompensationLimits) -> machine_file::Limits {
    machine_file::Limits {
        max_um: limits.max.map(|max| f64::from(max.0) / NM_PER_UM),
        slew_um_per_s: f64::from(limits.slew_nm_per_s) / NM_PER_UM,
        link_timeout_ms: limits.link_timeout_ms,
        hold_ms: limits.hold_ms,
        rejoin_um_per_s: f64::from(limits.rejoin_nm_per_s) / NM_PER_UM,
        learned: machine_file::LearnedChangeLimits {
            growth_percent: f64::from(limits.learned.growth) / LEARNED_LIMIT_STEPS_PER_UNIT,
            axes_percent: f64::from(limits.learned.axes) / LEARNED_LIMIT_STEPS_PER_UNIT,
            zero_um: f64::from(limits.learned.zero) / LEARNED_LIMIT_STEPS_PER_UNIT,
        },
    }
}
