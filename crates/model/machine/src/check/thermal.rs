//! The laws of heat: temperatures in °C, and expansions that a material has.

use super::{error_bounds::MAX_TEMPERATURE_DEVIATION_K, warning::Warning};
use crate::{
    keys::section::Value,
    machine_file::Machine,
    sections::{LinearAxis, ThermalLaw},
};

/// 0 °C in kelvin.
const ZERO_C_IN_K: f64 = 273.15;

/// Temperatures of a machine, in °C: EN 60204-1 requires of one that it works at 5 to 40 °C, and what runs in
/// it is warmer by 30 K at most. A number from 273.15 higher is such a temperature in kelvin.
pub(super) const MACHINE_TEMPERATURE_RANGE_C: [f64; 2] = [-5.0, 70.0];

/// A law that over [`MAX_TEMPERATURE_DEVIATION_K`] and a metre makes less than the smallest step of an offset on the wire, in µm,
/// corrects nothing: its number is in another unit.
const OFFSET_RESOLUTION_UM: f64 = 0.01;

pub(super) fn warnings(machine: &Machine) -> Vec<Warning> {
    let mut warnings = Vec::new();
    for (axis, name) in machine.axes.iter().zip(LinearAxis::ALL) {
        let key = format!("axis.{}.thermal", name.name());
        if let Some(thermal) = &axis.thermal {
            warnings.extend(thermal_law_kelvin_warnings(machine, thermal, &key));
            warnings.extend(slope_unit_warning(machine, thermal, &key));
            warnings.extend(constant_unit_warning(machine, thermal, &key));
        }
    }
    if let Some(model) = &machine.spindle.temperature {
        let key = "spindle.temperature";
        warnings.extend(kelvin_warning(machine, &format!("{key}.reference_c"), model.reference_c));
        warnings.extend(negligible_value_warning(
            machine,
            &format!("{key}.k_um_per_c"),
            model.k_um_per_c,
            "µm",
        ));
    }
    for (index, term) in machine.terms.iter().enumerate() {
        for (entry, value) in term.effect.entries() {
            if let ("reference_c", Value::Number(reference_c)) = (entry, value) {
                let key = format!("term[{index}].reference_c");
                warnings.extend(kelvin_warning(machine, &key, reference_c));
            }
        }
    }
    warnings
}

fn thermal_law_kelvin_warnings(machine: &Machine, thermal: &ThermalLaw, key: &str) -> Vec<Warning> {
    match &thermal.table {
        None => kelvin_warning(machine, &format!("{key}.reference_c"), thermal.reference_c)
            .into_iter()
            .collect(),
        Some(rows) => {
            let rows = rows.iter().enumerate();
            let warnings = rows.filter_map(|(row, thermal_row)| {
                kelvin_warning(
                    machine,
                    &format!("{key}.table[{row}][0]"),
                    thermal_row.temperature_c,
                )
            });
            warnings.take(1).collect()
        }
    }
}

/// Returns whether a temperature that stands for °C is one of a machine in kelvin.
pub(super) fn looks_like_kelvin(temperature: f64) -> bool {
    let [coldest, hottest] = MACHINE_TEMPERATURE_RANGE_C;
    (coldest..=hottest).contains(&(temperature - ZERO_C_IN_K))
}

fn kelvin_warning(machine: &Machine, key: &str, temperature_c: f64) -> Option<Warning> {
    looks_like_kelvin(temperature_c).then(|| {
        let celsius = temperature_c - ZERO_C_IN_K;
        let what = format!("{temperature_c} °C looks like kelvin: it would be {celsius:.2} °C");
        Warning::for_key(machine, key, &what, format!("temperatures are in °C: write {celsius:.2}"))
    })
}

fn slope_unit_warning(machine: &Machine, thermal: &ThermalLaw, key: &str) -> Option<Warning> {
    if thermal.table.is_some() || !thermal.mode.has_position_term() {
        return None;
    }
    let key = format!("{key}.slope_um_per_m_per_c");
    let slope = thermal.slope_um_per_m_per_c;
    negligible_value_warning(machine, &key, slope, "µm for each metre")
}

fn constant_unit_warning(machine: &Machine, thermal: &ThermalLaw, key: &str) -> Option<Warning> {
    let is_used = thermal.table.is_none() && thermal.mode.has_constant_term();
    let key = format!("{key}.constant_um_per_c");
    is_used
        .then(|| negligible_value_warning(machine, &key, thermal.constant_um_per_c, "µm"))
        .flatten()
}

/// Returns a value that is there and makes nothing: 11.5e-6 where 11.5 µm/(m·K) is meant.
fn negligible_value_warning(machine: &Machine, key: &str, value: f64, of: &str) -> Option<Warning> {
    let made_um = (value * MAX_TEMPERATURE_DEVIATION_K).abs();
    (value != 0.0 && made_um < OFFSET_RESOLUTION_UM).then(|| {
        let what = format!(
            "{value} makes {made_um:.2e} {of} over {MAX_TEMPERATURE_DEVIATION_K} K, less than an offset's step of \
             {OFFSET_RESOLUTION_UM} µm: the correction would do nothing"
        );
        let help = if key.ends_with("slope_um_per_m_per_c") {
            format!(
                "the unit is µm/(m·K): an expansion of {value} for one kelvin is {}",
                um_per_m_k_from_per_k(value)
            )
        } else {
            "the unit is µm for one kelvin".into()
        };
        Warning::for_key(machine, key, &what, help)
    })
}

/// Returns a coefficient in 1/K as µm/(m·K), in the digits that it has.
fn um_per_m_k_from_per_k(value: f64) -> f64 {
    format!("{:.6e}", value * 1e6).parse().unwrap_or(value * 1e6)
}
