//! The reason of a start, as the boot program hands it to the image that it starts: three words at the end of the RAM.
//!
//! | word | content, little-endian |
//! |---|---|
//! | 0 | tag of the image that starts |
//! | 1 | [`StartInfo::encode`], the value of object 0x2121:07 |
//! | 2 | CRC-32/AUTOSAR of words 0 and 1 |
//!
//! Neither program has variables or stack there (`build.rs`), and the image's test of the RAM spares it. After power-on
//! the RAM holds anything, and an older boot program has its stack there: so the words count with their CRC only, for
//! the image that they name, and once, because the image clears them.

use crate::{
    boot_state::ImageStatus,
    crc,
    start::{StartReason, StartSelection},
};

/// Words that are handed over.
pub const HANDOVER_WORD_COUNT: usize = 3;

/// Bytes of the status of a slot without a valid header.
const NO_IMAGE_STATUS: [u8; 2] = [0xFF; 2];

/// The reason of a start, and the content of the slot that did not start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StartInfo {
    /// Why the slot starts.
    pub reason: StartReason,
    /// Status of the image in the other slot when the choice was made; `None`: it had no valid header.
    pub other: Option<ImageStatus>,
}

impl From<&StartSelection> for StartInfo {
    fn from(start: &StartSelection) -> Self {
        Self { reason: start.reason, other: start.other }
    }
}

impl StartInfo {
    /// Returns the word of this choice: number of the reason, start on trial, status of the other slot and its
    /// starts, a byte each from the lowest. It is never 0.
    #[must_use]
    pub fn encode(self) -> u32 {
        let (number, start) = match self.reason {
            StartReason::Newest => (1, 0),
            StartReason::Trial(start) => (2, start),
            StartReason::OnlyImage => (3, 0),
            StartReason::RolledBack => (4, 0),
            StartReason::LastResort => (5, 0),
        };
        let [status, starts] = self.other.map_or(NO_IMAGE_STATUS, ImageStatus::encode);
        u32::from_le_bytes([number, start, status, starts])
    }

    /// Returns the choice of a word; `None`: it is of a later version, or 0.
    #[must_use]
    pub fn decode(word: u32) -> Option<Self> {
        let [number, start, status, starts] = word.to_le_bytes();
        let reason = match (number, start) {
            (1, 0) => StartReason::Newest,
            (2, start) => StartReason::Trial(start),
            (3, 0) => StartReason::OnlyImage,
            (4, 0) => StartReason::RolledBack,
            (5, 0) => StartReason::LastResort,
            _ => return None,
        };
        let other = match [status, starts] {
            NO_IMAGE_STATUS => None,
            status => Some(ImageStatus::decode(status)?),
        };
        Some(Self { reason, other })
    }

    /// Returns the words that hand this choice to the image with that tag.
    #[must_use]
    pub fn to_words(self, tag: u32) -> [u32; HANDOVER_WORD_COUNT] {
        let word = self.encode();
        [tag, word, compute_crc(tag, word)]
    }

    /// Returns the choice that was handed to the image with that tag; `None`: none was, or it was for another image.
    #[must_use]
    pub fn from_words(words: [u32; HANDOVER_WORD_COUNT], tag: u32) -> Option<Self> {
        let [named, word, crc] = words;
        if named != tag || crc != compute_crc(named, word) {
            return None;
        }
        Self::decode(word)
    }
}

fn compute_crc(tag: u32, word: u32) -> u32 {
    let [a, b, c, d] = tag.to_le_bytes();
    let [e, f, g, h] = word.to_le_bytes();
    crc::checksum(&[a, b, c, d, e, f, g, h])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boot_state::MAX_TRIAL_STARTS;
    use std::{collections::BTreeSet, vec::Vec};

    fn all() -> Vec<StartInfo> {
        let trials = (1..=MAX_TRIAL_STARTS).map(StartReason::Trial);
        let others = [
            StartReason::Newest,
            StartReason::OnlyImage,
            StartReason::RolledBack,
            StartReason::LastResort,
        ]
        .into_iter();
        let statuses = [
            None,
            Some(ImageStatus::New),
            Some(ImageStatus::Loading),
            Some(ImageStatus::Verified),
            Some(ImageStatus::Trial(3)),
            Some(ImageStatus::Announced(4)),
            Some(ImageStatus::Confirmed),
            Some(ImageStatus::Rejected),
        ];
        let reasons: Vec<StartReason> = others.chain(trials).collect();
        reasons
            .iter()
            .flat_map(|reason| statuses.map(|other| StartInfo { reason: *reason, other }))
            .collect()
    }

    #[test]
    fn every_choice_is_read_back_and_none_is_zero() {
        let words: BTreeSet<u32> = all().into_iter().map(StartInfo::encode).collect();
        assert_eq!(words.len(), all().len(), "each has a word of its own");
        assert!(!words.contains(&0) && StartInfo::decode(0).is_none());
        for choice in all() {
            assert_eq!(StartInfo::decode(choice.encode()), Some(choice));
            assert_eq!(StartInfo::from_words(choice.to_words(77), 77), Some(choice));
        }
    }

    #[test]
    fn a_flipped_bit_a_torn_word_or_another_image_is_no_choice() {
        for choice in all() {
            let words = choice.to_words(77);
            assert_eq!(StartInfo::from_words(words, 78), None, "another image");
            for bit in 0..32 * HANDOVER_WORD_COUNT {
                let mut damaged = words;
                damaged[bit / 32] ^= 1 << (bit % 32);
                for tag in [77, damaged[0]] {
                    assert_eq!(StartInfo::from_words(damaged, tag), None, "bit {bit}");
                }
            }
            // Some words are of this start, the others of the one before.
            for before in all().into_iter().filter(|before| *before != choice) {
                let before = before.to_words(77);
                for mixed in [[words[0], words[1], before[2]], [before[0], before[1], words[2]]] {
                    assert_eq!(StartInfo::from_words(mixed, 77), None);
                }
            }
        }
        // Cleared, erased and painted RAM (`ram_test` of the application).
        for word in [0, u32::MAX, 0xCCCC_CCCC] {
            assert_eq!(StartInfo::from_words([word; HANDOVER_WORD_COUNT], word), None);
        }
    }
}
