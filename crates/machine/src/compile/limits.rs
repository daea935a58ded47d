//! How far and how fast an offset may go, and how long silence is tolerated.

use trueup_core::{limits::Limits, units::Nanometres};
use trueup_store::calibration::{MAX_HOLD_MS, MAX_LINK_TIMEOUT_MS, MAX_SLEW_NM_PER_S};

use crate::{
    file::{self, LinearAxis, Machine},
    location::BadInput,
    stored::{NM_PER_UM, rounded, rounded_unsigned},
};

/// The largest offset that the wire can carry, either way, in µm: a 20-bit signed number of 10 nm.
pub const WIRE_LIMIT_UM: f64 = 5242.87;

/// The limits on the board.
pub(super) fn compile(machine: &Machine) -> Result<Limits, BadInput> {
    let limits = &machine.limits;
    let mut max = [Nanometres::ZERO; 3];
    for ((stored, axis), max_um) in max.iter_mut().zip(LinearAxis::ALL).zip(limits.max_um) {
        let bad =
            |rule: String| machine.places.bad(&format!("limits.max_um.{}", axis.name()), rule);
        if !(0.0..=WIRE_LIMIT_UM).contains(&max_um) {
            return Err(bad(format!(
                "{max_um} is not within 0 to {WIRE_LIMIT_UM} µm, what the wire can carry"
            )));
        }
        *stored = Nanometres(rounded(max_um * NM_PER_UM).expect("held to ±5.3 mm above"));
    }
    let slew_nm_per_s = rounded_unsigned(limits.slew_um_per_s * NM_PER_UM)
        .filter(|nm| (1..=MAX_SLEW_NM_PER_S).contains(nm));
    let slew_nm_per_s = slew_nm_per_s.ok_or_else(|| {
        let rule = format!(
            "{} is not within 0.001 to {} µm/s, the most that the board allows",
            limits.slew_um_per_s,
            MAX_SLEW_NM_PER_S / 1_000
        );
        machine.places.bad("limits.slew_um_per_s", rule)
    })?;
    if limits.link_timeout_ms == 0 {
        let rule = "must be at least 1: at 0 the CNC would always count as lost";
        return Err(machine.places.bad("limits.link_timeout_ms", rule));
    }
    for (key, ms, most) in [
        ("link_timeout_ms", limits.link_timeout_ms, MAX_LINK_TIMEOUT_MS),
        ("hold_ms", limits.hold_ms, MAX_HOLD_MS),
    ] {
        if ms > most {
            let rule = format!("{ms} is above {most}, the most that the board allows");
            return Err(machine.places.bad(&format!("limits.{key}"), rule));
        }
    }
    Ok(Limits {
        max,
        slew_nm_per_s,
        link_timeout_ms: limits.link_timeout_ms,
        hold_ms: limits.hold_ms,
    })
}

/// The limits as a user writes them.
pub(super) fn inverse(limits: &Limits) -> file::Limits {
    file::Limits {
        max_um: limits.max.map(|max| f64::from(max.0) / NM_PER_UM),
        slew_um_per_s: f64::from(limits.slew_nm_per_s) / NM_PER_UM,
        link_timeout_ms: limits.link_timeout_ms,
        hold_ms: limits.hold_ms,
    }
}
