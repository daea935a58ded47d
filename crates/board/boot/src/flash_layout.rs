//! The places in the flash: addresses and sectors of the STM32F405 (RM0090, section 3.4, table 5).

/// First address of the flash.
pub const FLASH_START: u32 = 0x0800_0000;
/// Bytes of the boot program at most: sectors 0 and 1.
pub const MAX_BOOT_PROGRAM_SIZE: u32 = 32 * 1024;
/// First address of the records: sectors 2 and 3.
pub const JOURNAL_START: u32 = 0x0800_8000;
/// The first of their two sectors.
pub const JOURNAL_FIRST_SECTOR: u8 = 2;
/// Bytes of each of their sectors.
pub const JOURNAL_SECTOR_SIZE: u32 = 16 * 1024;
/// First address of slot A; slot B follows it.
pub const SLOTS_START: u32 = 0x0801_0000;
/// Bytes of a slot. Slot B has 256 KB of sectors; an image must fit both.
pub const SLOT_SIZE: u32 = 192 * 1024;
/// The sectors of each slot: the first, and how many.
pub const SLOT_SECTORS: [(u8, u8); 2] = [(4, 2), (6, 2)];

/// First address of what the boot program hands to the image (`handover`): the end of the RAM, where neither has its
/// stack.
pub const HANDOVER_START: u32 = 0x2001_FFF0;
/// Bytes of it: a multiple of 16, which the image's test of the RAM takes at once.
pub const HANDOVER_SIZE: u32 = 16;

/// One of the two places for an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// Sectors 4 and 5.
    A,
    /// Sectors 6 and 7.
    B,
}

impl Slot {
    /// Both, A first.
    pub const ALL: [Self; 2] = [Self::A, Self::B];

    /// Returns the other one.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }

    /// Returns `A` or `B`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::A => "A",
            Self::B => "B",
        }
    }

    /// Returns its number: 0 or 1.
    #[must_use]
    pub const fn number(self) -> u8 {
        match self {
            Self::A => 0,
            Self::B => 1,
        }
    }

    /// Returns the first address of its bytes.
    #[must_use]
    pub const fn start(self) -> u32 {
        match self {
            Self::A => SLOTS_START,
            Self::B => SLOTS_START.saturating_add(SLOT_SIZE),
        }
    }

    /// Returns its element of a pair, A's first.
    pub const fn element_of<T>(self, pair: &[T; 2]) -> &T {
        let [a, b] = pair;
        match self {
            Self::A => a,
            Self::B => b,
        }
    }

    /// As [`Self::element_of`], to change it.
    pub(crate) const fn element_of_mut<T>(self, pair: &mut [T; 2]) -> &mut T {
        let [a, b] = pair;
        match self {
            Self::A => a,
            Self::B => b,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_places_follow_each_other_and_end_where_the_store_begins() {
        assert_eq!(FLASH_START + MAX_BOOT_PROGRAM_SIZE, JOURNAL_START);
        assert_eq!(JOURNAL_START + 2 * JOURNAL_SECTOR_SIZE, SLOTS_START);
        assert_eq!(Slot::B.start(), 0x0804_0000, "sector 6");
        assert!(Slot::B.start() + SLOT_SIZE <= 0x0808_0000, "sector 8 is the store's");
        assert_eq!(HANDOVER_START + HANDOVER_SIZE, 0x2002_0000, "the end of the RAM");
    }
}
