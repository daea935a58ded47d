//! Registers that do not change after the start are read again at every turn of the supervisor, and held against
//! what they were at its first: a bit that flips by itself, or by a stray write, is found within 10 ms.
//!
//! The parts of a register that the board does change are excluded: what the DMA moves, what a restart of
//! the converter sets anew.

use core::ptr::read_volatile;

/// A register, and its bits that count.
type WatchedRegister = (u32, u32);

const ALL_BITS_MASK: u32 = u32::MAX;
const WATCHED_REGISTERS: [WatchedRegister; 56] = [
    // Clocks: which run, PLL, dividers and what was switched to, and every unit's own (sections 7.3.1 to 7.3.14).
    (0x4002_3800, 0x010D_0001),
    (0x4002_3804, 0x0F43_7FFF),
    (0x4002_3808, 0x0000_FCFF),
    (0x4002_3830, ALL_BITS_MASK),
    (0x4002_3840, ALL_BITS_MASK),
    (0x4002_3844, ALL_BITS_MASK),
    // Wait states and caches (section 3.9.1).
    (0x4002_3C00, 0x0000_0707),
    // Pins of ports A, B, C: mode, pull, function (section 8.4).
    (0x4002_0000, ALL_BITS_MASK),
    (0x4002_000C, ALL_BITS_MASK),
    (0x4002_0024, ALL_BITS_MASK),
    (0x4002_0400, ALL_BITS_MASK),
    (0x4002_040C, ALL_BITS_MASK),
    (0x4002_0424, ALL_BITS_MASK),
    (0x4002_0800, ALL_BITS_MASK),
    // TIM3: trigger, divider, period; TIM2: its input (section 18.4).
    (0x4000_0404, ALL_BITS_MASK),
    (0x4000_0428, ALL_BITS_MASK),
    (0x4000_042C, ALL_BITS_MASK),
    (0x4000_0008, ALL_BITS_MASK),
    // ADC1: settings, sampling times, sequence; the common clock (section 13.13).
    (0x4001_2004, ALL_BITS_MASK),
    (0x4001_200C, ALL_BITS_MASK),
    (0x4001_2010, ALL_BITS_MASK),
    (0x4001_202C, ALL_BITS_MASK),
    (0x4001_2034, ALL_BITS_MASK),
    (0x4001_2304, 0x0003_FF1F),
    // DMA2 stream 0, without enable and buffer: settings and addresses (section 10.5).
    (0x4002_6410, 0x0FF7_FFFE),
    (0x4002_6418, ALL_BITS_MASK),
    (0x4002_641C, ALL_BITS_MASK),
    (0x4002_6420, ALL_BITS_MASK),
    // USART1: rate, frame (section 30.6).
    (0x4001_1008, ALL_BITS_MASK),
    (0x4001_100C, 0x0000_B40C),
    (0x4001_1010, ALL_BITS_MASK),
    // USART3: rate, frame; TIM5: its clock (sections 30.6 and 18.4).
    (0x4000_4808, ALL_BITS_MASK),
    (0x4000_480C, 0x0000_B62C),
    (0x4000_4810, ALL_BITS_MASK),
    (0x4000_0C0C, ALL_BITS_MASK),
    (0x4000_0C28, ALL_BITS_MASK),
    (0x4000_0C2C, ALL_BITS_MASK),
    // SPI2, without enable (section 28.5).
    (0x4000_3800, 0x0000_FFBF),
    // CAN1: mode, bit timing, interrupts, filters (section 32.9).
    (0x4000_6400, 0x0000_00FC),
    (0x4000_641C, ALL_BITS_MASK),
    (0x4000_6414, ALL_BITS_MASK),
    (0x4000_6604, ALL_BITS_MASK),
    (0x4000_660C, ALL_BITS_MASK),
    (0x4000_6614, ALL_BITS_MASK),
    (0x4000_661C, ALL_BITS_MASK),
    (0x4000_6640, ALL_BITS_MASK),
    (0x4000_6644, ALL_BITS_MASK),
    (0x4000_6648, ALL_BITS_MASK),
    (0x4000_664C, ALL_BITS_MASK),
    // Core: vectors, traps, priority of the supervisor, its clock, the protection (Armv7-M manual, B3.2).
    (0xE000_ED08, ALL_BITS_MASK),
    (0xE000_ED14, ALL_BITS_MASK),
    (0xE000_ED20, ALL_BITS_MASK),
    (0xE000_E014, ALL_BITS_MASK),
    (0xE000_ED94, ALL_BITS_MASK),
    // Which interrupts are let in (B3.4.4).
    (0xE000_E100, ALL_BITS_MASK),
    (0xE000_E104, ALL_BITS_MASK),
];

/// The values of the watched registers.
pub struct RegisterSnapshot([u32; WATCHED_REGISTERS.len()]);

/// One that has changed.
#[derive(defmt::Format)]
pub struct ChangedRegister {
    pub address: u32,
    /// The bits that are not as they were.
    pub bits: u32,
}

impl RegisterSnapshot {
    /// Returns what they are now.
    pub fn read() -> Self {
        Self(WATCHED_REGISTERS.map(read_masked))
    }

    /// Returns the first that is not as it was.
    pub fn find_changed(&self) -> Option<ChangedRegister> {
        WATCHED_REGISTERS.into_iter().zip(self.0).find_map(|(watched, before)| {
            let bits = read_masked(watched) ^ before;
            (bits != 0).then_some(ChangedRegister { address: watched.0, bits })
        })
    }
}

#[allow(unsafe_code, reason = "registers by their addresses")]
fn read_masked((address, bits): WatchedRegister) -> u32 {
    // SAFETY: a register of this chip that a read does not change, of a unit whose clock is on.
    unsafe { read_volatile(address as *const u32) & bits }
}
