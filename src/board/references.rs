//! The stored references: opened at the start, added to by `Zero`, and every step of it in the log.
//!
//! A store that fails costs the reference of the next start, never an offset of this one.

use embedded_storage::nor_flash::NorFlash;
use trueup_core::bridge::Reference;
use trueup_node::node::Zero;
use trueup_store::reference::{Found, References};

/// Opens the store, makes room in it, and gives the reference to start with. An erase may be needed
/// for that, so this is for the time before samples are taken and the watchdog runs.
pub fn open<F: NorFlash>(flash: F, calibration: u32) -> (References<F>, Option<Reference>) {
    let (mut references, found) = References::open(flash, calibration);
    let Found { reference, foreign, damaged } = found;
    match reference {
        Some((number, reference)) => say(number, &reference, "taken up"),
        None => defmt::info!("no reference is stored for this calibration"),
    }
    if foreign > 0 {
        defmt::info!("stored references of other calibrations, not used: {}", foreign);
    }
    if damaged > 0 {
        defmt::warn!("stored references that are damaged, refused: {}", damaged);
    }
    match references.make_room() {
        Ok(false) => {}
        Ok(true) => defmt::info!("room made for references"),
        Err(error) => defmt::error!("dead: store of references, {}", Text(&error)),
    }
    (references, reference.map(|(_, reference)| reference))
}

/// Stores what a `Zero` has taken; `false`: it is not stored.
pub fn keep<F: NorFlash>(references: &mut References<F>, zero: Zero) -> bool {
    match zero {
        Zero::Unchanged => {
            defmt::warn!("zero: the reference stays, an input is missing or the error is the same");
            true
        }
        Zero::Taken(reference) => match references.append(reference) {
            Ok(number) => {
                say(number, &reference, "stored");
                true
            }
            Err(error) => {
                say(0, &reference, "NOT stored");
                defmt::error!("the reference is lost with the power: {}", Text(&error));
                false
            }
        },
    }
}

use defmt::Display2Format as Text;

fn say(number: u32, reference: &Reference, what: &str) {
    let [x, y, z] = reference.axes.map(|axis| axis.rounded().0);
    defmt::info!(
        "reference {=u32} {=str}: elongation {=i32} nm, X {=i32}, Y {=i32}, Z {=i32} nm",
        number,
        what,
        reference.elongation.0,
        x,
        y,
        z,
    );
}
