//! The stored references and writes: opened at the start, added to by `Zero`, `Confirm` and every write, and
//! every step of it in the log.
//!
//! A store that fails costs the reference of the next start, never an offset of this one.

use embedded_storage::nor_flash::NorFlash;
use trueup_core::{bridge::ReferenceErrors, supply_monitor::InternalReferenceLevel};
use trueup_store::{
    reference::{ReferenceStatus, ReferenceStore, ScanResult},
    write_log::WriteRecord,
};

/// Opens the store, makes room in it, and gives what it holds for the start. An erase may be needed
/// for that, so this is for the time before samples are taken. `feed` is for the watchdog: at 16 MHz full
/// sectors take longer to read than the fastest one waits (host-tests, `boot_program` `the_longest_start`).
pub fn open<F: NorFlash>(
    flash: F,
    calibration: u32,
    mut feed: impl FnMut(),
) -> (ReferenceStore<F>, StoredReferenceState) {
    let (mut references, found) = ReferenceStore::open_with_progress(flash, calibration, &mut feed);
    feed();
    let ScanResult { standing, is_new, taken, supply, named, foreign, damaged } = found;
    match standing {
        Some((number, ReferenceStatus { reference, is_offered: true, .. })) => {
            log_reference(number, &reference, defmt::intern!("offered"));
        }
        Some((number, ReferenceStatus { reference, .. }))
            if reference != ReferenceErrors::default() =>
        {
            log_reference(number, &reference, defmt::intern!("taken up"));
        }
        _ => defmt::info!("no reference is stored for this calibration"),
    }
    if is_new {
        defmt::info!("this calibration is another one than ran before, or was loaded again");
    }
    if foreign > 0 {
        defmt::info!("stored references of other calibrations, not used: {}", foreign);
    }
    if damaged > 0 {
        defmt::warn!("stored references that are damaged, refused: {}", damaged);
    }
    match references.erase_spare_half() {
        Ok(false) => {}
        Ok(true) => defmt::info!("room made for references"),
        Err(error) => defmt::error!("dead: store of references, {}", error),
    }
    let standing = standing.map(|(_, standing)| (standing, supply));
    (references, StoredReferenceState { standing, taken, named })
}

/// Content of the store at the start.
#[derive(Clone, Copy, Default)]
pub struct StoredReferenceState {
    /// Standing of the calibration's reference, and the level of the supply that it counts from.
    pub standing: Option<(ReferenceStatus, InternalReferenceLevel)>,
    /// The write that has taken the reference.
    pub taken: Option<WriteRecord>,
    /// The machine that the board belongs to, as `trueup_store::writes::machine_identity_crc` has it.
    pub named: Option<u32>,
}

/// Stores what holds for the calibration from now on; `false`: it is not stored.
pub fn store_reference_status<F: NorFlash>(
    references: &mut ReferenceStore<F>,
    standing: ReferenceStatus,
    supply: InternalReferenceLevel,
) -> bool {
    references.set_supply_baseline_level(supply);
    match references.append(standing) {
        Ok(number) => {
            let (offered, stored) = (defmt::intern!("offered"), defmt::intern!("stored"));
            let what = if standing.is_offered { offered } else { stored };
            log_reference(number, &standing.reference, what);
            true
        }
        Err(error) => {
            log_reference(0, &standing.reference, defmt::intern!("NOT stored"));
            defmt::error!("the reference is lost with the power: {}", error);
            false
        }
    }
}

/// Stores who has written what; gives it with its number, or `None`: it is not stored.
pub fn store_write_record<F: NorFlash>(
    references: &mut ReferenceStore<F>,
    write: &WriteRecord,
) -> Option<WriteRecord> {
    let word = write.what.as_str();
    match references.append_write(write) {
        Ok(stored) => {
            defmt::info!("write {=u32}: {=str} {=u32:#x}", stored.sequence, word, write.about);
            Some(stored)
        }
        Err(error) => {
            defmt::error!("write NOT stored: {=str}, {}", word, error);
            None
        }
    }
}

/// `what` is a number in the image: a text would be sent letter by letter, with interrupts off.
fn log_reference(number: u32, reference: &ReferenceErrors, what: defmt::Str) {
    let [x, y, z] = reference.axes.map(|axis| axis.rounded().0);
    defmt::info!(
        "reference {=u32} {=istr}: elongation {=i32} nm, X {=i32}, Y {=i32}, Z {=i32} nm",
        number,
        what,
        reference.elongation.0,
        x,
        y,
        z,
    );
}
