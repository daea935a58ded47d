//! From the integers of the board back to a machine file: the [decompile] of compiling, written.
//!
//! The machine file shown is compiled, and the result held against the calibration. Without curves and
//! tables over temperature it is the very same. Measured over random ones in
//! `tests/show_round_trip.rs`: curves within 0.031 nm, tables within 0.025 nm over 1 m. A
//! calibration that no machine file compiles to (one that was not written by
//! [`compile`](mod@crate::compile)) is shown as well, with the reason.

pub mod calibration_changes;
mod calibration_difference;

use std::path::Path;

use trueup_core::{calibration::Calibration, units::AdcCode};

use crate::{
    compile::{NEAR_ZERO_SLOPE_UM_PER_COUNT, UNNAMED_MACHINE_NAME, compile, decompile},
    inputs::ADC_REFERENCE_VOLTS,
    keys::section::NewSection,
    machine_file::{Machine, MachineFile, Term, writer::MachineFileEdit},
};
use calibration_difference::calibration_difference_nm;

/// A calibration as a machine file.
#[derive(Clone, Debug, PartialEq)]
pub struct DecompiledCalibration {
    /// The machine file.
    pub toml: String,
    /// How far the machine file's model and the calibration are apart, in nm: how far it is from
    /// its own compilation, and that from the calibration. Or, of a calibration that no machine
    /// file compiles to, the reason.
    pub largest_difference_nm: Result<f64, String>,
}

/// Turns `calibration` back into a machine file.
#[must_use]
pub fn decompile_to_toml(calibration: &Calibration<'_>) -> DecompiledCalibration {
    let machine = decompile(calibration);
    let toml = MachineFileEdit {
        sections: machine
            .sections()
            .into_iter()
            .map(|section| add_comments(section, &machine))
            .collect(),
        appended: machine.terms.iter().map(Term::to_section).collect(),
        ..MachineFileEdit::default()
    }
    .to_toml();
    let (verdict, largest_difference_nm) = match verify_round_trip(&toml, calibration) {
        Ok(RoundTripResult { is_same, from_calibration_nm, from_model_nm }) => {
            let nm = from_calibration_nm + from_model_nm;
            let back = if is_same {
                "the same calibration".to_string()
            } else {
                format!("within {from_calibration_nm:.3} nm of the board's calibration")
            };
            let verdict = format!(
                "Compiles back to {back}. Largest difference from the board's law: {nm:.3} nm"
            );
            (verdict, Ok(nm))
        }
        Err(reason) => {
            (format!("Does not compile back to this calibration: {reason}"), Err(reason))
        }
    };
    DecompiledCalibration { toml: format!("# {verdict}\n\n{toml}"), largest_difference_nm }
}

/// Returns the section with what a reader must know of its values.
fn add_comments(section: NewSection, machine: &Machine) -> NewSection {
    let sensor = machine.inputs.as_ref().and_then(|inputs| inputs.sensor);
    match section.name() {
        "machine" if machine.name == UNNAMED_MACHINE_NAME => {
            section.with_key_comment("name", "the calibration has none")
        }
        "inputs" if sensor.is_some() => section
            .with_header_comment(format!(
                "Assumed: counts are ADC codes, {} for {ADC_REFERENCE_VOLTS} V at the ADC. A",
                AdcCode::FULL_SCALE
            ))
            .with_header_comment(
                "calibration does not hold the counts of the machine file that it came from.",
            ),
        "spindle.sensor"
            if section.number("um_per_count") == Some(NEAR_ZERO_SLOPE_UM_PER_COUNT) =>
        {
            section.with_key_comment("um_per_count", "on the board: 0")
        }
        _ => section,
    }
}

/// The result of compiling a machine file that was shown.
struct RoundTripResult {
    /// It compiles to the calibration, bit for bit.
    is_same: bool,
    /// From the calibration to what the file compiles to.
    from_calibration_nm: f64,
    /// From there to the file's model.
    from_model_nm: f64,
}

/// Compiles `toml` and holds the result against `calibration`.
fn verify_round_trip(toml: &str, calibration: &Calibration<'_>) -> Result<RoundTripResult, String> {
    let compiled = MachineFile::parse(toml, Path::new("shown"))
        .and_then(|machine| compile(&machine))
        .map_err(|bad| bad.rule)?;
    let again = compiled.calibration();
    let from_model_nm = compiled.largest_difference_nm;
    if again == *calibration {
        return Ok(RoundTripResult { is_same: true, from_calibration_nm: 0.0, from_model_nm });
    }
    let from_calibration_nm = calibration_difference_nm(calibration, &again)
        .ok_or("it holds values that no machine file is compiled to")?;
    Ok(RoundTripResult { is_same: false, from_calibration_nm, from_model_nm })
}

#[cfg(test)]
mod tests;
