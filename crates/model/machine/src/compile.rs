//! From what the user writes (µm, counts, seconds) to the integers that the board runs, and back.
//!
//! One page a section of the machine file, with both ways next to each other: what goes there and
//! what comes back is seen together. Each part is held against the model, and refused where it is
//! further from it than `LARGEST_DIFFERENCE_NM`; a page says how it is measured.
//!
//! The way back, [`inverse`], gives a machine that compiles to the calibration: the board knows
//! readings, not the PLC's counts, and neither the machine's name nor those of its columns.
#![warn(clippy::cast_possible_truncation, clippy::cast_sign_loss)]

mod account;
mod axis;
mod curve;
mod heat;
mod inputs;
mod kinematics;
mod lag;
mod limits;
mod names;
mod pitch;
mod sensor;
mod slope;
mod spindle;
mod squareness;
pub(crate) mod term;
mod volume;
mod warmup;

use trueup_core::{calibration::Calibration, gradient::Gradient};
use trueup_store::calibration::{MAX_SIZE, TooLarge, decode, encode, identity};

use crate::{
    envelope,
    file::{self, LinearAxis, Machine, Straightness},
    location::{BadInput, Locations},
    model,
};
use account::Account;
use curve::{OwnedCurve, compile_curve};
use inputs::thermometers;
use spindle::SpindleTables;
use squareness::{compile_squareness, crossed};
use volume::OwnedVolume;

pub(crate) use inputs::SHOWN_INPUT;
pub use inputs::missing_inputs;
pub(crate) use inputs::{conditions, free_bit};
pub(crate) use lag::time_constant_s;
pub(crate) use sensor::UM_PER_COUNT_OF_NO_SLOPE;
pub(crate) use sensor::stored_law_nm;
pub use slope::{Slope, check_slopes, of_curve, of_table, steepest_um_per_mm, too_steep};

/// A machine in the integers of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct Compiled {
    blob: Vec<u8>,
    /// Each part with its largest difference from the model, in nm.
    pub parts: Vec<(String, f64)>,
    /// The largest of these.
    pub largest_difference_nm: f64,
}

impl Compiled {
    /// Returns the bytes that the board stores.
    #[must_use]
    pub fn blob(&self) -> &[u8] {
        &self.blob
    }

    /// Returns the CRC by which a board names the calibration.
    #[must_use]
    pub fn crc(&self) -> u32 {
        identity(&self.blob)
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
/// for it, a part would be further than `LARGEST_DIFFERENCE_NM` from the model, a slope is beyond
/// what [`check_slopes`] lets pass, terms leave what is possible ([`envelope::refuse`]), or all of it does not fit the board; with the key and, for a machine that
/// was read from a file, its place.
pub fn compile(machine: &Machine) -> Result<Compiled, BadInput> {
    let whole = machine;
    term::category::refuse_labels(machine)?;
    let (machine, falling) = model::corrected(machine.compensated());
    let machine = &*term::with_thermal_laws(machine)?;
    check_slopes(machine)?;
    let mut account = Account { machine, parts: Vec::new() };
    let limits = limits::compile(machine)?;
    let spindle = SpindleTables::of(machine, falling.spindle_s, &mut account)?;
    let mut axes = Vec::new();
    for (axis, name) in machine.axes.iter().zip(LinearAxis::ALL) {
        let falling_s = falling.axes_s[name.index()];
        axes.push(axis::compile(axis, name, falling_s, &mut account)?);
    }
    let mut curves: [OwnedCurve; 6] = std::array::from_fn(|_| OwnedCurve::NONE);
    for straightness in &machine.straightness {
        let key = format!("straightness.{}", straightness.name());
        let made = compile_curve(&straightness.spline);
        curves[crossed(straightness.error, straightness.along)] = account.take(&key, made)?;
    }
    let mut squareness = [Gradient::ZERO; 6];
    for entry in &machine.squareness {
        let key = format!("squareness.{}", entry.name());
        let made = compile_squareness(entry.um_per_m);
        squareness[crossed(entry.error, entry.along)] = account.take(&key, made)?;
    }
    let volume = volume::compile(machine, &mut account)?;
    let terms = term::terms(machine, &mut account)?;
    let [x, y, z] = [0, 1, 2].map(|number| axis::view(machine, number, &axes[number]));
    let calibration = Calibration {
        thermometers: thermometers(machine)?,
        spindle: spindle.view(machine)?,
        kinematics: kinematics::compile(machine.tool_direction, &machine.head_axes),
        axes: [x?, y?, z?],
        straightness: std::array::from_fn(|n| curves[n].view()),
        squareness,
        volume: volume.as_ref().map(OwnedVolume::view),
        terms: term::views(&terms),
        limits,
        cold_within: names::cold_within(machine)?,
        guards: inputs::guards(machine)?,
        names: names::names(machine),
    };
    let mut room = vec![0; 4 * MAX_SIZE];
    let blob = encode(&calibration, &mut room)
        .map_err(|TooLarge { bytes }| {
            let rule = format!(
                "is too much for the board: {bytes} bytes, and it stores {MAX_SIZE}; the tables \
                 and curves have to be shorter"
            );
            machine.places.bad("machine", rule)
        })?
        .to_vec();
    match decode(&blob) {
        Ok(read) if read == calibration => {}
        Ok(_) => {
            return Err(machine.places.bad("machine", "does not come back from its blob whole"));
        }
        Err(error) => {
            return Err(machine.places.bad("machine", format!("the board would refuse: {error}")));
        }
    }
    // Last: what else is wrong is said first.
    envelope::refuse(whole)?;
    let parts = account.parts;
    let largest_difference_nm = parts.iter().fold(0.0, |worst: f64, (_, nm)| worst.max(*nm));
    Ok(Compiled { blob, parts, largest_difference_nm })
}

/// The name of a shown machine whose calibration has none.
pub const UNNAMED: &str = "shown";

/// Returns a machine that compiles to `calibration`, or as nearly as the machine file can say it.
///
/// Counts are ADC codes (`SHOWN_INPUT`), the temperature of channel 3 is `temp_ch3_c`, a machine without
/// a name is called `shown`; its tool direction is written in few decimals and not of length 1.
#[must_use]
pub fn inverse(calibration: &Calibration<'_>) -> Machine {
    let has_sensor = spindle::has_sensor(&calibration.spindle);
    let volume = calibration.volume.as_ref();
    let mut rotary = volume.iter().flat_map(|it| it.rotary.iter().flatten());
    let turns_workpiece = rotary.any(|it| it.moves_workpiece);
    let (kind, head_axes, tool_direction) =
        kinematics::inverse(&calibration.kinematics, turns_workpiece);
    let curves = squareness::pairs().into_iter().zip(&calibration.straightness);
    let curves = curves.filter(|(_, curve)| !curve.is_empty());
    let mut terms = term::inverse(calibration);
    let tools = terms.last().and_then(term::category::list_of);
    if tools.is_some() {
        terms.pop();
    }
    let spindle = file::Spindle { tools, ..spindle::inverse(&calibration.spindle) };
    let guards = &calibration.guards;
    Machine {
        name: names::text(calibration.names.machine).unwrap_or_else(|| UNNAMED.into()),
        serial: names::text(calibration.names.serial),
        board: Some(calibration.names.board).filter(|board| *board != [0; 3]),
        kind,
        head_axes,
        tool_direction,
        inputs: inputs::inverse(has_sensor, &calibration.thermometers, guards, &calibration.terms),
        spindle,
        axes: calibration.axes.each_ref().map(axis::inverse),
        straightness: curves
            .map(|((error, along), curve)| Straightness {
                error,
                along,
                spline: curve::inverse(curve),
            })
            .collect(),
        squareness: squareness::inverse(&calibration.squareness),
        volume: volume::inverse(calibration.volume.as_ref(), tool_direction),
        limits: limits::inverse(&calibration.limits),
        cold_within_c: names::cold_within_c(calibration.cold_within),
        instrument_um: None,
        terms,
        places: Locations::default(),
    }
}

#[cfg(test)]
#[expect(clippy::cast_possible_truncation, reason = "a test's own numbers fit")]
mod tests;
