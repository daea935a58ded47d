//! Content of the flash at the start: the calibration in use, and the stores of calibrations and of references.

use stm32f4xx_hal::pac::FLASH;
use trueup_core::calibration::Calibration;
use trueup_store::{
    calibration::{self, BlobError},
    reference::ReferenceStore,
};

use super::{
    super::{
        CalibrationBuffer,
        reference_store::{self, StoredReferenceState},
    },
    Flash, Store, Watchdog,
};

/// Calibration that the host compiled from the machine file, linked into the image. One that was loaded over it
/// counts instead.
static BUILT_IN_CALIBRATION: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/calibration.bin"));

/// It is the example's, because the image was built without a machine file.
const IS_EXAMPLE_CALIBRATION: bool = matches!(env!("TRUEUP_EXAMPLE").as_bytes(), b"1");

/// Both stores, open, and what they hold.
pub struct StoredData {
    pub store: Store,
    pub calibration: Result<Calibration<'static>, BlobError>,
    /// The bytes of the calibration in use; empty without one.
    pub blob: &'static [u8],
    pub references: (ReferenceStore<Flash>, StoredReferenceState),
    /// The calibration that was loaded last is damaged, and this is an older one.
    pub is_older: bool,
    /// The calibration is the example's: another machine's spindle.
    pub is_example: bool,
    /// Nothing was loaded, referenced or named yet.
    pub is_new: bool,
}

impl StoredData {
    /// Opens both stores. An erase may be needed to make room, so this is for the time before anything runs that it would
    /// hold up. The watchdog is fed at each record.
    #[inline(always)]
    pub fn open(
        controller: FLASH,
        buffer: &mut CalibrationBuffer,
        watchdog: &mut Watchdog,
    ) -> Self {
        let [calibrations, flash] = Flash::split(controller);
        let own = calibration::validate_blob(BUILT_IN_CALIBRATION)
            .map_or(0, calibration::calibration_crc);
        let base = (!IS_EXAMPLE_CALIBRATION).then_some(own);
        let (store, loaded, is_older) = Store::open(calibrations, base, buffer, || watchdog.feed());
        watchdog.feed();
        let is_example = IS_EXAMPLE_CALIBRATION && loaded.is_none();
        let blob = calibration::validate_blob(loaded.unwrap_or(BUILT_IN_CALIBRATION));
        let calibration = blob
            .and_then(|blob| Ok((calibration::calibration_crc(blob), calibration::decode(blob)?)));
        let identity = calibration.as_ref().map_or(0, |(identity, _)| *identity);
        let references = reference_store::open(flash, identity, || watchdog.feed());
        watchdog.feed();
        let kept = &references.1;
        let is_new = loaded.is_none() && kept.standing.is_none() && kept.named.is_none();
        let calibration = calibration.map(|(_, calibration)| calibration);
        let blob = if calibration.is_ok() { blob.unwrap_or_default() } else { &[] };
        Self { store, calibration, blob, references, is_older, is_example, is_new }
    }
}
