//! Registers that do not change after the start are read again at every turn of the supervisor, and held against
//! what they were at its first: a bit that flips by itself, or by a stray write, is found within 10 ms.
//!
//! The parts of a register that the board does change are left out: what the DMA moves, what a restart of
//! the converter sets anew.

use core::ptr::read_volatile;

/// A register, and its bits that count.
type Watched = (u32, u32);

const ALL: u32 = u32::MAX;
const WATCHED: [Watched; 56] = [
    // Clocks: which run, PLL, dividers and what was switched to, and every unit's own (sections 7.3.1 to 7.3.14).
    (0x4002_3800, 0x010D_0001),
    (0x4002_3804, 0x0F43_7FFF),
    (0x4002_3808, 0x0000_FCFF),
    (0x4002_3830, ALL),
    (0x4002_3840, ALL),
    (0x4002_3844, ALL),
    // Wait states and caches (section 3.9.1).
    (0x4002_3C00, 0x0000_0707),
    // Pins of ports A, B, C: mode, pull, function (section 8.4).
    (0x4002_0000, ALL),
    (0x4002_000C, ALL),
    (0x4002_0024, ALL),
    (0x4002_0400, ALL),
    (0x4002_040C, ALL),
    (0x4002_0424, ALL),
    (0x4002_0800, ALL),
    // TIM3: trigger, divider, period; TIM2: its input (section 18.4).
    (0x4000_0404, ALL),
    (0x4000_0428, ALL),
    (0x4000_042C, ALL),
    (0x4000_0008, ALL),
    // ADC1: settings, sampling times, sequence; the common clock (section 13.13).
    (0x4001_2004, ALL),
    (0x4001_200C, ALL),
    (0x4001_2010, ALL),
    (0x4001_202C, ALL),
    (0x4001_2034, ALL),
    (0x4001_2304, 0x0003_FF1F),
    // DMA2 stream 0, without enable and buffer: settings and addresses (section 10.5).
    (0x4002_6410, 0x0FF7_FFFE),
    (0x4002_6418, ALL),
    (0x4002_641C, ALL),
    (0x4002_6420, ALL),
    // USART1: rate, frame (section 30.6).
    (0x4001_1008, ALL),
    (0x4001_100C, 0x0000_B40C),
    (0x4001_1010, ALL),
    // USART3: rate, frame; TIM5: its clock (sections 30.6 and 18.4).
    (0x4000_4808, ALL),
    (0x4000_480C, 0x0000_B62C),
    (0x4000_4810, ALL),
    (0x4000_0C0C, ALL),
    (0x4000_0C28, ALL),
    (0x4000_0C2C, ALL),
    // SPI2, without enable (section 28.5).
    (0x4000_3800, 0x0000_FFBF),
    // CAN1: mode, bit timing, interrupts, filters (section 32.9).
    (0x4000_6400, 0x0000_00FC),
    (0x4000_641C, ALL),
    (0x4000_6414, ALL),
    (0x4000_6604, ALL),
    (0x4000_660C, ALL),
    (0x4000_6614, ALL),
    (0x4000_661C, ALL),
    (0x4000_6640, ALL),
    (0x4000_6644, ALL),
    (0x4000_6648, ALL),
    (0x4000_664C, ALL),
    // Core: vectors, traps, priority of the supervisor, its clock, the protection (Armv7-M manual, B3.2).
    (0xE000_ED08, ALL),
    (0xE000_ED14, ALL),
    (0xE000_ED20, ALL),
    (0xE000_E014, ALL),
    (0xE000_ED94, ALL),
    // Which interrupts are let in (B3.4.4).
    (0xE000_E100, ALL),
    (0xE000_E104, ALL),
];

/// The values of the watched registers.
pub struct Registers([u32; WATCHED.len()]);

/// One that has changed.
#[derive(defmt::Format)]
pub struct Changed {
    pub address: u32,
    /// The bits that are not as they were.
    pub bits: u32,
}

impl Registers {
    /// Returns what they are now.
    pub fn read() -> Self {
        Self(WATCHED.map(value))
    }

    /// Returns the first that is not as it was.
    pub fn changed(&self) -> Option<Changed> {
        WATCHED.into_iter().zip(self.0).find_map(|(watched, before)| {
            let bits = value(watched) ^ before;
            (bits != 0).then_some(Changed { address: watched.0, bits })
        })
    }
}

#[allow(unsafe_code, reason = "registers by their addresses")]
fn value((address, bits): Watched) -> u32 {
    // SAFETY: a register of this chip that a read does not change, of a unit whose clock is on.
    unsafe { read_volatile(address as *const u32) & bits }
}
