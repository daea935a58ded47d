//! The state of the slots: what outlasts a start.
//!
//! | word | content, little-endian |
//! |---|---|
//! | 0 | 0: the entry is taken (see `journal`) |
//! | 1 | generation of the sector, from 1 |
//! | 2 | floor: the oldest version that may start |
//! | 3, 4 | tag of the image that the state of slot A, B is about |
//! | 5 | status and starts of slot A, then of slot B: a byte each |
//! | 6 | format, 1 |
//! | 7 | CRC-32/AUTOSAR of words 1 to 6 |

use crate::{crc, flash_layout::Slot, image_header::FirmwareVersion};

/// Bytes of an entry.
pub(crate) const JOURNAL_ENTRY_SIZE: usize = 32;
const BOOT_STATE_FORMAT_VERSION: u32 = 1;
/// Starts that an image on trial has to be confirmed in.
pub const MAX_TRIAL_STARTS: u8 = 5;

/// State of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImageStatus {
    /// Nothing is known of it: a probe or the ROM loader has written it.
    #[default]
    New,
    /// It is being written, or its download was not completed.
    Loading,
    /// Its CRC and its signature held when it was written.
    Verified,
    /// It has started this many times and is not confirmed.
    Trial(u8),
    /// The same; it is about to reset the board itself, which is no failure.
    Announced(u8),
    /// It ran well.
    Confirmed,
    /// It failed its trial.
    Rejected,
}

impl ImageStatus {
    /// Returns whether the signature held when the image was written, or at an earlier start.
    #[must_use]
    pub const fn is_verified(self) -> bool {
        match self {
            Self::Verified
            | Self::Trial(_)
            | Self::Announced(_)
            | Self::Confirmed
            | Self::Rejected => true,
            Self::New | Self::Loading => false,
        }
    }

    /// Returns whether the image starts before all that are not: neither incomplete nor failed.
    #[must_use]
    pub const fn is_preferred(self) -> bool {
        !matches!(self, Self::Loading | Self::Rejected)
    }

    /// Returns status and starts, as they are stored and as object 0x2121 has them.
    #[must_use]
    pub const fn encode(self) -> [u8; 2] {
        match self {
            Self::New => [0, 0],
            Self::Loading => [1, 0],
            Self::Verified => [2, 0],
            Self::Trial(starts) => [3, starts],
            Self::Announced(starts) => [4, starts],
            Self::Confirmed => [5, 0],
            Self::Rejected => [6, 0],
        }
    }

    /// Returns the status of these bytes; `None`: it is of a later version.
    #[must_use]
    pub const fn decode([status, starts]: [u8; 2]) -> Option<Self> {
        Some(match status {
            0 => Self::New,
            1 => Self::Loading,
            2 => Self::Verified,
            3 => Self::Trial(starts),
            4 => Self::Announced(starts),
            5 => Self::Confirmed,
            6 => Self::Rejected,
            _ => return None,
        })
    }
}

/// State of one slot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SlotState {
    /// Tag of the image that `status` is about.
    pub tag: u32,
    /// Status of that image.
    pub status: ImageStatus,
}

/// State of both slots.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BootState {
    /// The oldest version that may start.
    pub floor: FirmwareVersion,
    /// Slot A, slot B.
    pub slots: [SlotState; 2],
}

impl BootState {
    /// Returns the status of the image with this tag in that slot. An incomplete download is one whatever is read
    /// there.
    #[must_use]
    pub fn status(&self, slot: Slot, tag: u32) -> ImageStatus {
        match slot.element_of(&self.slots) {
            SlotState { status: ImageStatus::Loading, .. } => ImageStatus::Loading,
            state if state.tag == tag => state.status,
            _ => ImageStatus::New,
        }
    }

    /// Returns the state with another status of the image with this tag.
    #[must_use]
    pub fn with_status(mut self, slot: Slot, tag: u32, status: ImageStatus) -> Self {
        *slot.element_of_mut(&mut self.slots) = SlotState { tag, status };
        self
    }

    /// Returns the entry of this state in a sector of that generation.
    pub(crate) fn encode(&self, generation: u32) -> [u8; JOURNAL_ENTRY_SIZE] {
        let [a, b] = self.slots;
        let [[status_a, starts_a], [status_b, starts_b]] = [a.status.encode(), b.status.encode()];
        let statuses = u32::from_le_bytes([status_a, starts_a, status_b, starts_b]);
        let words =
            [0, generation, self.floor.0, a.tag, b.tag, statuses, BOOT_STATE_FORMAT_VERSION, 0];
        let mut bytes = [0; JOURNAL_ENTRY_SIZE];
        let all = words.iter().flat_map(|word| word.to_le_bytes());
        bytes.iter_mut().zip(all).for_each(|(place, byte)| *place = byte);
        if let Some((content, crc)) = bytes.split_last_chunk_mut() {
            *crc = crc::checksum(content.get(4..).unwrap_or_default()).to_le_bytes();
        }
        bytes
    }

    /// Returns the generation and the state of an entry; `None`: it holds none.
    pub(crate) fn decode(bytes: &[u8; JOURNAL_ENTRY_SIZE]) -> Option<(u32, Self)> {
        let (content, crc) = bytes.split_last_chunk()?;
        if crc::checksum(content.get(4..)?) != u32::from_le_bytes(*crc) {
            return None;
        }
        let &[_, generation, floor, tag_a, tag_b, statuses, format] = content.as_chunks().0 else {
            return None;
        };
        let [status_a, starts_a, status_b, starts_b] = statuses;
        let slot = |tag, status| {
            Some(SlotState { tag: u32::from_le_bytes(tag), status: ImageStatus::decode(status)? })
        };
        let generation = u32::from_le_bytes(generation);
        if u32::from_le_bytes(format) != BOOT_STATE_FORMAT_VERSION || generation == 0 {
            return None;
        }
        let slots = [slot(tag_a, [status_a, starts_a])?, slot(tag_b, [status_b, starts_b])?];
        Some((generation, Self { floor: FirmwareVersion(u32::from_le_bytes(floor)), slots }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [ImageStatus; 7] = [
        ImageStatus::New,
        ImageStatus::Loading,
        ImageStatus::Verified,
        ImageStatus::Trial(3),
        ImageStatus::Announced(4),
        ImageStatus::Confirmed,
        ImageStatus::Rejected,
    ];

    #[test]
    fn every_state_is_read_back_and_no_flipped_bit_is_a_state() {
        for status in ALL {
            for other in ALL {
                let slots = [SlotState { tag: 7, status }, SlotState { tag: 8, status: other }];
                let state = BootState { floor: FirmwareVersion::new(1, 2, 3, 4), slots };
                let bytes = state.encode(9);
                assert_eq!(BootState::decode(&bytes), Some((9, state)));
                for bit in 32..8 * JOURNAL_ENTRY_SIZE {
                    let mut damaged = bytes;
                    damaged[bit / 8] ^= 1 << (bit % 8);
                    assert_eq!(BootState::decode(&damaged), None, "bit {bit}");
                }
            }
        }
        assert_eq!(BootState::decode(&[0; JOURNAL_ENTRY_SIZE]), None);
        assert_eq!(BootState::decode(&[0xFF; JOURNAL_ENTRY_SIZE]), None);
    }

    #[test]
    fn a_status_is_of_one_image_and_an_incomplete_download_of_its_slot() {
        let state = BootState::default().with_status(Slot::A, 7, ImageStatus::Confirmed);
        assert_eq!(state.status(Slot::A, 7), ImageStatus::Confirmed);
        assert_eq!(state.status(Slot::A, 8), ImageStatus::New);
        assert_eq!(state.status(Slot::B, 7), ImageStatus::New);
        let state = state.with_status(Slot::B, 9, ImageStatus::Loading);
        assert_eq!(state.status(Slot::B, 1), ImageStatus::Loading);
    }
}
