//! From what the user writes (µm, counts, seconds) to the integers that the board runs, and back.
//!
//! One page a section of the machine file, with both ways next to each other: what goes there and
//! what comes back is seen together. Each part is held against the model, and refused where it is
//! further from it than `MAX_MODEL_DIFFERENCE_NM`; a page says how it is measured.
//!
//! The way back, [`decompile`], gives a machine that compiles to the calibration: the board knows
//! readings, not the PLC's counts, and neither the machine's name nor those of its columns.
#![warn(clippy::cast_possible_truncation, clippy::cast_sign_loss)]

mod axis;
mod curve;
mod inputs;
mod kinematics;
mod lag;
mod limits;
mod machine_identity;
mod part_differences;
mod pitch;
mod sensor;
mod slope;
mod spindle;
mod squareness;
pub(crate) mod term;
mod thermal;
mod volume;
mod warmup;

use trueup_core::{calibration::Calibration, gradient::Gradient};
use trueup_store::calibration::{
    CalibrationTooLarge, MAX_BLOB_SIZE, calibration_crc, decode, encode,
};

use crate::{
    envelope,
    location::{InputFileError, KeyLocations},
    machine_file::{self, Machine},
    model,
    sections::{LinearAxis, Straightness},
};
use curve::{OwnedCurve, compile_curve};
use inputs::compile_thermometers;
use part_differences::PartDifferences;
use spindle::OwnedSpindle;
use squareness::{axis_pair_index, compile_squareness};
use volume::OwnedVolume;

pub(crate) use inputs::DECOMPILED_SENSOR_INPUT;
pub use inputs::missing_input_lines;
pub(crate) use inputs::{board_condition_columns, first_free_condition_bit};
pub(crate) use lag::time_constant_s;
pub(crate) use sensor::NEAR_ZERO_SLOPE_UM_PER_COUNT;
pub(crate) use sensor::exact_elongation_nm;
pub use slope::{check_slopes, max_slope_um_per_mm};

/// A machine in the integers of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct CompiledCalibration {
    blob: Vec<u8>,
    /// Each part with its largest difference from the model, in nm.
    pub parts: Vec<(String, f64)>,
    /// The largest of these.
    pub largest_difference_nm: f64,
}

impl CompiledCalibration {
    /// Returns the bytes that the board stores.
    #[must_use]
    pub fn blob(&self) -> &[u8] {
        &self.blob
    }

    /// Returns the CRC by which a board names the calibration.
    #[must_use]
    pub fn crc(&self) -> u32 {
        calibration_crc(&self.blob)
    }

    /// Returns what the board reads in them.
    ///
    /// # Panics
    /// Never: [`compile`] has read the blob.
    #[must_use]
    pub fn calibration(&self) -> Calibration<'_> {
        decode(&self.blob).expect("read once when it was compiled")
    }
}

/// Turns `machine` into what the board runs. A machine without a spindle source compiles to no
/// elongation, and needs no sensor.
///
/// # Errors
/// Something that is in use is not described in `[inputs]`, a value does not fit the board's integer
/// for it, a part would be further than `MAX_MODEL_DIFFERENCE_NM` from the model, a slope is beyond
/// what [`check_slopes`] lets pass, terms leave what is possible ([`envelope::reject_limit_violations`]), or all of it does not fit the board; with the key and, for a machine that
/// was read from a file, its place.
pub fn compile(machine: &Machine) -> Result<CompiledCalibration, InputFileError> {
    let whole = machine;
    term::category::reject_unnumbered_tools(machine)?;
    let (machine, falling) = model::apply_constant_terms(machine.with_only_compensated_terms());
    let machine = &*term::with_thermal_laws(machine)?;
    check_slopes(machine)?;
    let mut account = PartDifferences { machine, parts: Vec::new() };
    let limits = limits::compile(machine)?;
    let spindle = OwnedSpindle::compile(machine, falling.spindle_s, &mut account)?;
    let mut axes = Vec::new();
    for (axis, name) in machine.axes.iter().zip(LinearAxis::ALL) {
        let falling_s = falling.axes_s[name.index()];
        axes.push(axis::compile(axis, name, falling_s, &mut account)?);
    }
    let mut curves: [OwnedCurve; 6] = std::array::from_fn(|_| OwnedCurve::EMPTY);
    for straightness in &machine.straightness {
        let key = format!("straightness.{}", straightness.name());
        let made = compile_curve(&straightness.spline);
        curves[axis_pair_index(straightness.error, straightness.along)] =
            account.check_and_record_difference(&key, made)?;
    }
    let mut squareness = [Gradient::ZERO; 6];
    for entry in &machine.squareness {
        let key = format!("squareness.{}", entry.name());
        let made = compile_squareness(entry.um_per_m);
        squareness[axis_pair_index(entry.error, entry.along)] =
            account.check_and_record_difference(&key, made)?;
    }
    let volume = volume::compile(machine, &mut account)?;
    let terms = term::compile_terms(machine, &mut account)?;
    let [x, y, z] = [0, 1, 2].map(|number| axis::build_axis_model(machine, number, &axes[number]));
    let calibration = Calibration {
        thermometers: compile_thermometers(machine)?,
        spindle: spindle.view(machine)?,
        kinematics: kinematics::compile(machine.tool_direction, &machine.head_axes),
        axes: [x?, y?, z?],
        straightness: std::array::from_fn(|n| curves[n].view()),
        squareness,
        volume: volume.as_ref().map(OwnedVolume::view),
        terms: term::term_views(&terms),
        limits,
        cold_within: machine_identity::compile_cold_tolerance(machine)?,
        guards: inputs::compile_input_settings(machine)?,
        names: machine_identity::compile_identity(machine),
    };
    let mut room = vec![0; 4 * MAX_BLOB_SIZE];
    let blob = encode(&calibration, &mut room)
        .map_err(|CalibrationTooLarge { bytes }| {
            let rule = format!(
                "is too much for the board: {bytes} bytes, and it stores {MAX_BLOB_SIZE}; the tables \
                 and curves have to be shorter"
            );
            machine.places.key_error("machine", rule)
        })?
        .to_vec();
    match decode(&blob) {
        Ok(read) if read == calibration => {}
        Ok(_) => {
            return Err(machine
                .places
                .key_error("machine", "does not come back from its blob whole"));
        }
        Err(error) => {
            return Err(machine
                .places
                .key_error("machine", format!("the board would refuse: {error}")));
        }
    }
    // Last: other faults are reported first.
    envelope::reject_limit_violations(whole)?;
    let parts = account.parts;
    let largest_difference_nm = parts.iter().fold(0.0, |worst: f64, (_, nm)| worst.max(*nm));
    Ok(CompiledCalibration { blob, parts, largest_difference_nm })
}

/// The name of a shown machine whose calibration has none.
pub(crate) const UNNAMED_MACHINE_NAME: &str = "shown";

/// Returns a machine that compiles to `calibration`, or as nearly as the machine file can say it.
///
/// Counts are ADC codes (`DECOMPILED_SENSOR_INPUT`), the temperature of channel 3 is `temp_ch3_c`, a machine without
/// a name is called `shown`; its tool direction is written in few decimals and not of length 1.
#[must_use]
pub fn decompile(calibration: &Calibration<'_>) -> Machine {
    let has_sensor = spindle::has_sensor(&calibration.spindle);
    let volume = calibration.volume.as_ref();
    let mut rotary = volume.iter().flat_map(|volume| volume.rotary.iter().flatten());
    let turns_workpiece = rotary.any(|location| location.moves_workpiece);
    let (kind, head_axes, tool_direction) =
        kinematics::decompile(&calibration.kinematics, turns_workpiece);
    let curves = squareness::axis_pairs().into_iter().zip(&calibration.straightness);
    let curves = curves.filter(|(_, curve)| !curve.is_empty());
    let mut terms = term::decompile(calibration);
    let tools = terms.last().and_then(term::category::tool_growths_from_term);
    if tools.is_some() {
        terms.pop();
    }
    let spindle = machine_file::Spindle { tools, ..spindle::decompile(&calibration.spindle) };
    let guards = &calibration.guards;
    Machine {
        name: machine_identity::decode_name(calibration.names.machine)
            .unwrap_or_else(|| UNNAMED_MACHINE_NAME.into()),
        serial: machine_identity::decode_name(calibration.names.serial),
        board: Some(calibration.names.board).filter(|board| *board != [0; 3]),
        kind,
        head_axes,
        tool_direction,
        inputs: inputs::decompile(
            has_sensor,
            &calibration.thermometers,
            guards,
            &calibration.terms,
        ),
        spindle,
        axes: calibration.axes.each_ref().map(axis::decompile),
        straightness: curves
            .map(|((error, along), curve)| Straightness {
                error,
                along,
                spline: curve::decompile(curve),
            })
            .collect(),
        squareness: squareness::decompile(&calibration.squareness),
        volume: volume::decompile(calibration.volume.as_ref(), tool_direction),
        limits: limits::decompile(&calibration.limits),
        cold_within_c: machine_identity::decompile_cold_tolerance_c(calibration.cold_within),
        instrument_um: None,
        terms,
        places: KeyLocations::default(),
    }
}

#[cfg(test)]
#[expect(clippy::cast_possible_truncation, reason = "a test's own numbers fit")]
mod tests;
