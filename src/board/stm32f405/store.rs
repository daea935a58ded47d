//! Calibrations that a master has loaded: kept in flash, read where they lie, from the next start on.

use trueup_store::{
    StoreError,
    calibration_store::{CalibrationScan, CalibrationStore},
};

use super::Flash;

/// The store, open.
pub struct Store(CalibrationStore<Flash>);

impl Store {
    /// Opens it over the image's own calibration, `base`, or over an example, and gives the blob that
    /// was loaded over it, if there is one, and whether one that was loaded later is damaged. An erase may be needed to
    /// make room, so this is for the time before samples are taken. `buffer` takes one calibration at a time. `feed` is
    /// for the watchdog: all of them are read, and one may be written anew, 0.4 s at the most.
    #[allow(unsafe_code, reason = "a slice of the flash")]
    pub fn open(
        flash: Flash,
        base: Option<u32>,
        buffer: &mut [u8],
        mut feed: impl FnMut(),
    ) -> (Self, Option<&'static [u8]>, bool) {
        let (mut slots, found) = CalibrationStore::open(flash, base, buffer);
        let CalibrationScan { newest, foreign, damaged, newer_is_damaged } = found;
        if foreign > 0 {
            defmt::info!("stored calibrations of other images, not used: {}", foreign);
        }
        if damaged > 0 {
            defmt::warn!("stored calibrations that are damaged, refused: {}", damaged);
        }
        feed();
        match slots.erase_spare_half(feed) {
            Ok(false) => {}
            Ok(true) => defmt::info!("room made for calibrations"),
            Err(error) => defmt::error!("dead: store of calibrations, {}", error),
        }
        let loaded = newest.map(|stored| {
            defmt::info!("loaded calibration {} is used", stored.sequence);
            // SAFETY: a slot that holds something is never written again, and the next erase comes
            // before the next time this is called.
            unsafe { slots.flash().mapped_slice(stored.address, stored.length) }
        });
        (Self(slots), loaded, newer_is_damaged)
    }

    /// Stores a calibration for the next start; `false`: it is not stored. `feed` is for the
    /// watchdog, which waits less long than this may take: 16 KB at 16 µs a word are 65 ms, 0.4 s at
    /// the most.
    pub fn store(&mut self, blob: &[u8], feed: impl FnMut()) -> bool {
        match self.0.store(blob, feed) {
            Ok(number) => {
                defmt::info!("calibration {=u32} stored", number);
                true
            }
            Err(error @ StoreError::Full) => {
                defmt::error!("calibration NOT stored, restart the board: {}", error);
                false
            }
            Err(error) => {
                defmt::error!("calibration NOT stored: {}", error);
                false
            }
        }
    }
}
