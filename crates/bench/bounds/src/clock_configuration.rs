//! The three clocks that the board may have to live with (`src/board/stm32f405/clocks.rs`), and what memory costs on each.

use crate::decode::{AddressingMode, MemoryAccess};

/// A clock of the core and its waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockConfiguration {
    /// Its name, as the command prints it.
    pub name: &'static str,
    /// Cycles in a microsecond.
    pub mhz: u32,
    /// Wait states of a read of the flash (RM0090, table 10: one for each 30 MHz that are begun, at 2.7 V and more).
    pub flash: u32,
    /// Cycles of the core in one of APB1.
    pub apb1: u32,
    /// The same of APB2.
    pub apb2: u32,
}

/// All of them.
pub const CLOCK_CONFIGURATIONS: [ClockConfiguration; 3] = [
    ClockConfiguration { name: "168 MHz", mhz: 168, flash: 5, apb1: 4, apb2: 2 },
    ClockConfiguration { name: "144 MHz", mhz: 144, flash: 4, apb1: 4, apb2: 2 },
    ClockConfiguration { name: "16 MHz", mhz: 16, flash: 0, apb1: 1, apb2: 1 },
];

/// Bytes of a line of the flash: one read brings 128 bits (RM0090 3.5.1).
pub(crate) const FLASH_LINE_BYTES: u32 = 16;
/// Lines that the cache of the flash holds (RM0090 3.5.2).
pub(crate) const FLASH_CACHE_LINES: usize = 64;
/// Cycles in which the pipeline is filled after a branch, at the longest (DDI 0439, table 3-1: 1 to 3).
pub(crate) const MAX_PIPELINE_REFILL_CYCLES: u64 = 3;
/// Bytes that the core may have asked for ahead of a branch: three words (DDI 0439, prefetch unit).
const MAX_PREFETCH_BYTES: u32 = 12;

impl ClockConfiguration {
    /// Returns the waits of an access, whose address is a number where `address` has one; `is_ram`: it is in the RAM.
    #[must_use]
    pub(crate) fn access_wait_cycles(
        &self,
        access: &MemoryAccess,
        address: Option<u32>,
        is_ram: bool,
    ) -> u32 {
        // Of the bridge to a slow bus the manual has no figure: two cycles of that bus, one to meet it, two of the core.
        let bridge = |ratio: u32| 3 * ratio + 2;
        let once = match (access.at, address) {
            (AddressingMode::Literal, _) => self.flash,
            (_, Some(at)) => match at >> 16 {
                0x0800..=0x080F | 0x1FFF => self.flash,
                0x4000 => bridge(self.apb1),
                0x4001 => bridge(self.apb2),
                0x4002..=0x5006 => 2,
                0xE000..=0xE00F => 1,
                _ => 0,
            },
            // The stack answers at once, other places of the RAM as well if they are aligned.
            (AddressingMode::ImmediateOffset(crate::decode::SP, _), None) => 0,
            (_, None) if is_ram => 1,
            // A constant or a variable: units of the chip are reached by numbers. One more where it is not aligned.
            (_, None) if access.is_load => self.flash + 1,
            (_, None) => 1,
        };
        once * access.words
    }

    /// Returns the waits for the lines of the flash within a stretch of code, the first of them not among them.
    #[must_use]
    pub(crate) fn flash_line_wait_cycles(&self, start: u32, end: u32) -> u32 {
        ((end - 1) / FLASH_LINE_BYTES - start / FLASH_LINE_BYTES) * self.flash
    }

    /// Returns the cycles from the end of a stretch of code to the first instruction of another one; `is_kept`: the
    /// cache has both.
    #[must_use]
    pub(crate) fn taken_branch_cycles(&self, end: u32, is_kept: bool) -> u64 {
        if is_kept {
            return MAX_PIPELINE_REFILL_CYCLES;
        }
        // A line that was requested ahead is waited for, though it is not needed any more.
        let ahead = ((end + MAX_PREFETCH_BYTES - 1) / FLASH_LINE_BYTES
            - (end - 1) / FLASH_LINE_BYTES)
            * self.flash;
        MAX_PIPELINE_REFILL_CYCLES + u64::from(self.flash + ahead)
    }

    /// Returns those to the instruction behind.
    #[must_use]
    pub(crate) fn fall_through_cycles(&self, end: u32) -> u64 {
        if end.is_multiple_of(FLASH_LINE_BYTES) { self.flash.into() } else { 0 }
    }
}
