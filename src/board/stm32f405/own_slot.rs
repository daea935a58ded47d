//! The firmware slot that this image runs from: its confirmation, and resets of its own (`trueup_boot`).
//!
//! An image is confirmed by a minute of offsets in a row after an engage. The state goes into sectors 2 and 3, of
//! which the boot program has left room for: 16 words, 0.3 ms in which the core stands still, 1.6 ms at most; nothing
//! is erased.

use stm32f4xx_hal::pac::FLASH;
use trueup_boot::{
    header::Version,
    inspect::{Image, read_header},
    journal::Journal,
    record::Status,
    update::{announce, confirm, slot_at},
};
use trueup_core::cnc::Quality;

use super::{mpu, slot_flash};

/// Milliseconds of offsets in a row that confirm an image.
const HEALTHY_MS: u32 = 60_000;

/// The slot of this image.
pub struct OwnSlot {
    journal: Journal<slot_flash::Records>,
    /// `None`: it has no header, as after a probe without one.
    image: Option<Image>,
    healthy_ms: u32,
}

impl OwnSlot {
    /// Looks it up. The flash has other users, of which none runs at the same time: start and supervisor.
    #[allow(unsafe_code, reason = "the flash has several users")]
    pub fn look() -> Self {
        // SAFETY: the start and the supervisor use it one after the other.
        let controller = unsafe { FLASH::steal() };
        let (records, mut slots) = slot_flash::split(controller);
        let slot = slot_at(Self::look as *const () as u32);
        let image = read_header(&mut slots, slot, Version::default()).ok();
        let journal = Journal::open(records);
        match &image {
            Some(image) => {
                let status = journal.state().status(slot, image.tag);
                let is_confirmed = status == Status::Confirmed;
                defmt::info!("slot {=str}, confirmed: {=bool}", slot.name(), is_confirmed);
            }
            None => defmt::warn!("the slot of this image has no header"),
        }
        Self { journal, image, healthy_ms: 0 }
    }

    /// A turn of the supervisor.
    pub fn turn(&mut self, quality: Quality, elapsed_ms: u32) {
        let Some(image) = self.image else { return };
        let is_healthy =
            matches!(quality, Quality::Live | Quality::TemperatureModel | Quality::WarmUpModel);
        self.healthy_ms = if is_healthy { self.healthy_ms.saturating_add(elapsed_ms) } else { 0 };
        let status = self.journal.state().status(image.header.slot, image.tag);
        if self.healthy_ms < HEALTHY_MS || status == Status::Confirmed {
            return;
        }
        self.healthy_ms = 0;
        if mpu::with_records(|| confirm(&mut self.journal, &image)).is_ok() {
            defmt::info!("this image is confirmed");
        } else {
            defmt::error!("the image is NOT confirmed: the flash does not take its state");
        }
    }

    /// A reset that was asked for is no failure of the image.
    pub fn announce(&mut self) {
        let Some(image) = self.image else { return };
        if mpu::with_records(|| announce(&mut self.journal, &image)).is_err() {
            defmt::error!("the reset is not announced: on trial it counts as a failure");
        }
    }
}
