//! A new image on its way into the spare slot, and the confirmation of the one that runs.
//!
//! Bytes come in any pieces, in order, the header first. They are written as they come; nothing is believed of
//! them before all were written within one life of the board and CRC and signature hold in the flash. A power
//! cut makes the download begin anew; a link that breaks does not, as long as the owner keeps the [`ImageUpdate`].

use core::fmt;

use embedded_storage::nor_flash::NorFlash;

use crate::{
    boot_state::ImageStatus,
    flash_layout::Slot,
    image_check::{
        Image, ImageDefect, VerifyingKey, check_header, check_image, read_header, slot_offset,
        slot_size,
    },
    image_header::{FirmwareVersion, HEADER_SIZE},
    journal::{Journal, JournalWriteError},
};

/// Bytes that are written at once: 1 ms of this chip's flash.
const WRITE_CHUNK_BYTES: usize = 256;

/// Why an update is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpdateError {
    /// The file must not run on this board.
    Defect(ImageDefect),
    /// It is not newer than the image that runs, so it would never start.
    NotNewer {
        /// The version that runs.
        running: FirmwareVersion,
    },
    /// The image that runs is not confirmed, and the spare slot holds the one to go back to.
    Unconfirmed,
    /// More bytes than the header says, or fewer.
    Length,
    /// The flash was not erased, or does not take the bytes.
    Flash,
    /// The state of the slots was not stored.
    NotStored,
}

impl From<JournalWriteError> for UpdateError {
    fn from(_: JournalWriteError) -> Self {
        Self::NotStored
    }
}

impl fmt::Display for UpdateError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Defect(defect) => write!(f, "the file {defect}"),
            Self::NotNewer { running } => {
                write!(f, "the file is not newer than {running}, which runs: it would never start")
            }
            Self::Unconfirmed => f.write_str(
                "the firmware that runs is on trial: engage, let it run for a minute, then update",
            ),
            Self::Length => f.write_str("the file does not have the length that its header says"),
            Self::Flash => f.write_str("the flash does not take the file"),
            Self::NotStored => JournalWriteError.fmt(f),
        }
    }
}

impl core::error::Error for UpdateError {}

/// A download that goes on.
#[derive(Debug)]
pub struct ImageUpdate {
    image: Image,
    /// Bytes that were received.
    received: u32,
    part: [u8; WRITE_CHUNK_BYTES],
}

impl ImageUpdate {
    /// Takes the header of a new image: checks it, and erases the spare slot. The erase stalls this chip for
    /// up to 4 s.
    ///
    /// # Errors
    /// [`UpdateError`]; without [`UpdateError::Flash`] or [`UpdateError::NotStored`] nothing was changed.
    pub fn begin<R: NorFlash, S: NorFlash>(
        journal: &mut Journal<R>,
        slots: &mut S,
        running: &Image,
        header: &[u8; HEADER_SIZE],
    ) -> Result<Self, UpdateError> {
        let spare = running.header.slot.other();
        let (state, size) = (journal.state(), slot_size(slots));
        let image = check_header(header, spare, size, state.floor).map_err(UpdateError::Defect)?;
        if image.header.version <= running.header.version {
            return Err(UpdateError::NotNewer { running: running.header.version });
        }
        let is_confirmed = state.status(running.header.slot, running.tag) == ImageStatus::Confirmed;
        let has_other = read_header(slots, spare, state.floor)
            .is_ok_and(|other| state.status(spare, other.tag).is_preferred());
        if has_other && !is_confirmed {
            return Err(UpdateError::Unconfirmed);
        }
        journal.commit(state.with_status(spare, image.tag, ImageStatus::Loading))?;
        let start = slot_offset(slots, spare);
        let end = start.saturating_add(size);
        slots.erase(start, end).map_err(|_| UpdateError::Flash)?;
        let mut update = Self { image, received: 0, part: [0xFF; WRITE_CHUNK_BYTES] };
        update.append(slots, header)?;
        Ok(update)
    }

    /// Returns the image that comes.
    #[must_use]
    pub const fn image(&self) -> &Image {
        &self.image
    }

    /// Takes the next bytes.
    ///
    /// # Errors
    /// [`UpdateError::Length`] or [`UpdateError::Flash`]: it must begin anew.
    pub fn append<S: NorFlash>(&mut self, slots: &mut S, bytes: &[u8]) -> Result<(), UpdateError> {
        for byte in bytes {
            if self.received >= self.image.header.length {
                return Err(UpdateError::Length);
            }
            let place = self.part.get_mut(self.received as usize % WRITE_CHUNK_BYTES);
            *place.ok_or(UpdateError::Length)? = *byte;
            self.received = self.received.saturating_add(1);
            let is_full = (self.received as usize).is_multiple_of(WRITE_CHUNK_BYTES);
            if is_full || self.received == self.image.header.length {
                self.write_chunk(slots)?;
            }
        }
        Ok(())
    }

    /// Checks the whole image in the flash, and has the boot program start it next.
    ///
    /// # Errors
    /// [`UpdateError`]: it must begin anew.
    pub fn finish<R: NorFlash, S: NorFlash, K: VerifyingKey>(
        &self,
        journal: &mut Journal<R>,
        slots: &mut S,
        key: &K,
        between: impl FnMut(),
    ) -> Result<(), UpdateError> {
        if self.received != self.image.header.length {
            return Err(UpdateError::Length);
        }
        check_image(slots, &self.image, Some(key), between).map_err(UpdateError::Defect)?;
        let (slot, tag) = (self.image.header.slot, self.image.tag);
        journal.commit(journal.state().with_status(slot, tag, ImageStatus::Verified))?;
        Ok(())
    }

    /// Writes the words of the last part that has come, and reads them back.
    fn write_chunk<S: NorFlash>(&mut self, slots: &mut S) -> Result<(), UpdateError> {
        let size = self.received.checked_sub(1).map_or(0, |last| last as usize % WRITE_CHUNK_BYTES);
        let size = size.saturating_add(1);
        let bytes = self.part.get(..size).ok_or(UpdateError::Length)?;
        let at = self.received.saturating_sub(u32::try_from(size).unwrap_or(0));
        let address = slot_offset(slots, self.image.header.slot).saturating_add(at);
        slots.write(address, bytes).map_err(|_| UpdateError::Flash)?;
        let mut back = [0; WRITE_CHUNK_BYTES];
        let back = back.get_mut(..size).ok_or(UpdateError::Length)?;
        slots.read(address, back).map_err(|_| UpdateError::Flash)?;
        if back == bytes { Ok(()) } else { Err(UpdateError::Flash) }
    }
}

/// Confirms the image that runs: it ran well. The floor rises to what it requires.
///
/// # Errors
/// [`JournalWriteError`]: it is still on trial.
pub fn confirm<R: NorFlash>(
    journal: &mut Journal<R>,
    running: &Image,
) -> Result<(), JournalWriteError> {
    let slot = running.header.slot;
    let mut state = journal.state().with_status(slot, running.tag, ImageStatus::Confirmed);
    state.floor = state.floor.max(running.header.floor);
    journal.commit(state)
}

/// The image that runs is about to reset the board by itself: on trial, that is no failure.
///
/// # Errors
/// [`JournalWriteError`]: it will count as one.
pub fn announce_reset<R: NorFlash>(
    journal: &mut Journal<R>,
    running: &Image,
) -> Result<(), JournalWriteError> {
    let slot = running.header.slot;
    let state = journal.state();
    match state.status(slot, running.tag) {
        ImageStatus::Trial(starts) => {
            journal.commit(state.with_status(slot, running.tag, ImageStatus::Announced(starts)))
        }
        _ => Ok(()),
    }
}

/// Returns the slot whose image runs at this address.
#[must_use]
pub const fn slot_at(address: u32) -> Slot {
    if address < Slot::B.start() { Slot::A } else { Slot::B }
}

#[cfg(test)]
mod tests;
