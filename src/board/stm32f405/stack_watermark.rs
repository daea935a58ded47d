//! How much of the stack was never used: the paint of the RAM test is still there.

use core::ptr::read_volatile;

use super::{mpu::STACK_RANGE, ram_test::STACK_PAINT_PATTERN};

/// Words that are looked at in a turn, so that a look at the whole stack takes 0.8 s.
const WORDS_PER_STEP: u32 = 256;

/// A look at the stack that goes on, from its end upwards.
pub struct StackWatermark {
    at: u32,
    /// The lowest address that was found used.
    lowest: u32,
}

impl StackWatermark {
    pub const fn new() -> Self {
        Self { at: STACK_RANGE.start, lowest: STACK_RANGE.end }
    }

    /// Looks at the next piece, and gives how many bytes were never used as far as it is known.
    #[allow(unsafe_code, reason = "words of the stack")]
    pub fn scan_next_words(&mut self) -> u16 {
        let stop = self.lowest.min(self.at + 4 * WORDS_PER_STEP);
        while self.at < stop {
            // SAFETY: a word of the stack's own memory, below what is in use now. Volatile, because it changes
            // without the compiler's knowledge.
            if unsafe { read_volatile(self.at as *const u32) } != STACK_PAINT_PATTERN {
                self.lowest = self.at;
            }
            self.at += 4;
            if self.lowest < self.at {
                break;
            }
        }
        if self.at >= self.lowest {
            self.at = STACK_RANGE.start;
        }
        u16::try_from(self.lowest - STACK_RANGE.start).unwrap_or(u16::MAX)
    }
}
