//! The firmware slot that this image runs from: its confirmation, resets of its own, and a new image for the other slot
//! (`trueup_boot`).
//!
//! An image is confirmed by a minute of offsets in a row after an engage. The state goes into sectors 2 and 3, of
//! which the boot program has left room for: 16 words, 0.3 ms in which the core stands still, 1.6 ms at most; nothing
//! is erased.
//!
//! The boot program has handed over why it chose this image; the words are cleared as they are read, so that they are never
//! taken for those of another start.
//!
//! A new image is written at rest alone. The core stands still for up to 4 s while the other slot is erased: no sample, no
//! frame and no heartbeat meanwhile. Each part of 256 bytes takes 1 ms, 6.4 ms at most, in pieces of a word.

use core::ptr::{read_volatile, write_volatile};

use stm32f4xx_hal::pac::FLASH;
use trueup_boot::{
    boot_state::ImageStatus,
    flash_layout::{HANDOVER_START, Slot},
    handover::{HANDOVER_WORD_COUNT, StartInfo},
    image_check::{Image, ImageDefect, read_header},
    image_header::{FirmwareVersion, HEADER_SIZE},
    journal::Journal,
    public_key::PublicKey,
    reject_reason::FirmwareRejectReason,
    update::{ImageUpdate, UpdateError, announce_reset, confirm, slot_at},
};
use trueup_canopen::dictionary::FIRMWARE_HEADER_BYTES;
use trueup_core::cnc::OffsetQuality;
use trueup_node::node::firmware_update::{FirmwareChunk, SlotStates, UpdateStep};

use super::{mpu, slot_flash, watchdog::Watchdog};

/// The key of updates.
static PUBLIC_KEY: &[u8; 32] = include_bytes!(concat!(env!("OUT_DIR"), "/key.bin"));

const _: () = assert!(
    HEADER_SIZE == FIRMWARE_HEADER_BYTES,
    "one header, for the boot program and on the wire"
);

/// Milliseconds of offsets in a row that confirm an image.
const CONFIRMATION_TIME_MS: u32 = 60_000;

/// Bytes of the boot program, if this image is one whole to be flashed.
const BOOT_IMAGE: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/boot.bin"));

/// The boot program in front of the slots.
#[used]
#[unsafe(link_section = ".boot")]
#[allow(unsafe_code, reason = "a place of its own")]
static BOOT_PROGRAM: [u8; BOOT_IMAGE.len()] = {
    let mut bytes = [0; BOOT_IMAGE.len()];
    bytes.copy_from_slice(BOOT_IMAGE);
    bytes
};

/// The header of this image; it is written into it after it is linked, with the signature.
#[used]
#[unsafe(link_section = ".slot_header")]
#[unsafe(no_mangle)]
#[allow(unsafe_code, reason = "a place of its own")]
static TRUEUP_SLOT_HEADER: [u8; HEADER_SIZE] = [0xFF; HEADER_SIZE];

/// The slot of this image.
pub struct OwnSlot {
    journal: Journal<slot_flash::JournalRegion>,
    slots: slot_flash::SlotRegion,
    update: Option<ImageUpdate>,
    /// Bytes of it on their way from the node.
    pub piece: FirmwareChunk,
    /// `None`: it has no header, as after a probe without one.
    image: Option<Image>,
    healthy_ms: u32,
    /// Why the boot program chose this image; `None`: it has not handed it over.
    choice: Option<StartInfo>,
}

impl OwnSlot {
    /// Looks it up. The flash has other users, of which none runs at the same time: start and supervisor.
    #[allow(unsafe_code, reason = "the flash has several users")]
    pub fn locate() -> Self {
        // SAFETY: the start and the supervisor use it one after the other.
        let controller = unsafe { FLASH::steal() };
        let (records, mut slots) = slot_flash::split(controller);
        let slot = slot_at(Self::locate as *const () as u32);
        let image = read_header(&mut slots, slot, FirmwareVersion::default()).ok();
        let journal = Journal::open(records);
        let handed = take_handover();
        let choice = image.and_then(|image| StartInfo::from_words(handed, image.tag));
        match &image {
            Some(image) => {
                let status = journal.state().status(slot, image.tag);
                let is_confirmed = status == ImageStatus::Confirmed;
                defmt::info!("slot {=str}, confirmed: {=bool}", slot.name(), is_confirmed);
            }
            None => defmt::warn!("the slot of this image has no header"),
        }
        Self {
            journal,
            slots,
            update: None,
            piece: FirmwareChunk::new(),
            image,
            healthy_ms: 0,
            choice,
        }
    }

    /// Returns the state of both slots; `None`: this image has no header, so nothing can be loaded next to it.
    pub fn state(&mut self) -> Option<SlotStates> {
        let running = self.image?.header.slot.number();
        let state = self.journal.state();
        let [a, b] = Slot::ALL.map(|slot| {
            let image = read_header(&mut self.slots, slot, FirmwareVersion::default()).ok()?;
            Some((image.header.version.0, state.status(slot, image.tag).encode()))
        });
        let [(version_a, a), (version_b, b)] = [a, b].map(Option::unwrap_or_default);
        let floor = state.floor.0;
        let choice = self.choice.map_or(0, StartInfo::encode);
        Some(SlotStates {
            running,
            versions: [version_a, version_b],
            status: [a, b],
            floor,
            choice,
        })
    }

    /// Does a step of an update, with the bytes of [`Self::piece`]; an error is the number of the refusal.
    pub fn perform_update_step(
        &mut self,
        step: UpdateStep,
        watchdog: &mut Watchdog,
    ) -> Result<(), u8> {
        let Some(running) = self.image else { return Err(FirmwareRejectReason::NoSlots.number()) };
        let spare = running.header.slot.other();
        let done = mpu::with_slot_writable(spare, || match step {
            // An erase takes longer than the watchdog waits.
            UpdateStep::Begin => watchdog.with_extended_timeout(|| {
                let begun = self.begin(&running);
                self.ensure_journal_space();
                begun
            }),
            UpdateStep::Write => self.append_chunk(),
            UpdateStep::Finish => watchdog.with_extended_timeout(|| {
                let finished = self.finish();
                self.ensure_journal_space();
                finished
            }),
        });
        done.map_err(|error| {
            defmt::error!("update refused: {}", defmt::Display2Format(&error));
            self.update = None;
            FirmwareRejectReason::from(error).number()
        })
    }

    /// Erases a sector of the records now, at rest, where too little room is left for what comes while offsets are followed: a
    /// confirmation. That one must not erase, for it would stop the core for longer than the watchdog waits.
    fn ensure_journal_space(&mut self) {
        if self.journal.settle().is_err() {
            defmt::error!("the records of the firmware slots take nothing more");
        }
    }

    fn begin(&mut self, running: &Image) -> Result<(), UpdateError> {
        self.update = None;
        let header = self.piece.first_chunk().ok_or(UpdateError::Length)?;
        let update = ImageUpdate::begin(&mut self.journal, &mut self.slots, running, header)?;
        defmt::info!("update of {=u32} bytes begins", update.image().header.length);
        self.update = Some(update);
        Ok(())
    }

    fn append_chunk(&mut self) -> Result<(), UpdateError> {
        self.update.as_mut().ok_or(UpdateError::Length)?.append(&mut self.slots, &self.piece)
    }

    fn finish(&mut self) -> Result<(), UpdateError> {
        let update = self.update.take().ok_or(UpdateError::Length)?;
        let key = PublicKey::new(PUBLIC_KEY).ok_or(UpdateError::Defect(ImageDefect::Signature))?;
        update.finish(&mut self.journal, &mut self.slots, &key, || ())?;
        defmt::info!("update is whole and signed: it starts next");
        Ok(())
    }

    /// A turn of the supervisor.
    pub fn update_confirmation(&mut self, quality: OffsetQuality, elapsed_ms: u32) {
        let Some(image) = self.image else { return };
        let is_healthy = matches!(
            quality,
            OffsetQuality::Live | OffsetQuality::TemperatureModel | OffsetQuality::WarmUpModel
        );
        self.healthy_ms = if is_healthy { self.healthy_ms.saturating_add(elapsed_ms) } else { 0 };
        let status = self.journal.state().status(image.header.slot, image.tag);
        if self.healthy_ms < CONFIRMATION_TIME_MS || status == ImageStatus::Confirmed {
            return;
        }
        self.healthy_ms = 0;
        if mpu::with_slot_journal_writable(|| confirm(&mut self.journal, &image)).is_ok() {
            defmt::info!("this image is confirmed");
        } else {
            defmt::error!("the image is NOT confirmed: the flash does not take its state");
        }
    }

    /// A requested reset is no failure of the image.
    pub fn announce_reset(&mut self) {
        let Some(image) = self.image else { return };
        if mpu::with_slot_journal_writable(|| announce_reset(&mut self.journal, &image)).is_err() {
            defmt::error!("the reset is not announced: on trial it counts as a failure");
        }
    }
}

/// Returns the words that the boot program has handed over, and clears them.
#[allow(unsafe_code, reason = "words that both programs know by their address")]
fn take_handover() -> [u32; HANDOVER_WORD_COUNT] {
    let mut words = [0; HANDOVER_WORD_COUNT];
    for (at, word) in (HANDOVER_START..).step_by(4).zip(&mut words) {
        let place = at as *mut u32;
        // SAFETY: an aligned word of the RAM above the stack, which nothing else of this image uses.
        unsafe {
            *word = read_volatile(place);
            write_volatile(place, 0);
        }
    }
    words
}
