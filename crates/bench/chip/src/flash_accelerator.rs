//! The cost of the flash in processor time: wait states, less those that the accelerator's instruction cache saves.
//!
//! RM0090 3.5.1: a read of the flash takes LATENCY wait states and brings 128 bits. 3.5.2: of those the
//! cache keeps 64 lines, and the one that was least recently used goes; what it holds costs nothing; the
//! prefetch brings the next line while this one is executed. Data reads, by a cache of their own of 8
//! lines, are not seen here and cost nothing.

/// Bytes of a line as a shift: 128 bits.
const FLASH_LINE_SHIFT: u32 = 4;
const FLASH_CACHE_LINES: usize = 64;
/// Lines of the flash, 1 MB.
const FLASH_LINE_COUNT: usize = 0x10_0000 >> FLASH_LINE_SHIFT;
const NOT_CACHED: u8 = u8::MAX;

const ACR_LATENCY_MASK: u32 = 7;
const ACR_PRFTEN: u32 = 1 << 8;
const ACR_ICEN: u32 = 1 << 9;
const ACR_ICRST: u32 = 1 << 11;

/// The accelerator's memory.
pub struct FlashAccelerator {
    /// Where each line of the flash is kept.
    place: Vec<u8>,
    line: [u32; FLASH_CACHE_LINES],
    used: [u64; FLASH_CACHE_LINES],
    clock: u64,
    current: u32,
    /// Wait states so far.
    pub waited: u64,
}

impl Default for FlashAccelerator {
    fn default() -> FlashAccelerator {
        FlashAccelerator {
            place: vec![NOT_CACHED; FLASH_LINE_COUNT],
            line: [0; FLASH_CACHE_LINES],
            used: [0; FLASH_CACHE_LINES],
            clock: 0,
            current: u32::MAX,
            waited: 0,
        }
    }
}

impl FlashAccelerator {
    /// Cycles that the processor waits for the instruction at this offset of the flash, with this FLASH_ACR.
    pub fn fetch_wait_cycles(&mut self, offset: u32, acr: u32) -> u64 {
        let line = offset >> FLASH_LINE_SHIFT;
        if line == self.current {
            return 0;
        }
        let follows = line == self.current.wrapping_add(1);
        self.current = line;
        let is_brought = acr & ACR_PRFTEN != 0 && follows;
        let is_kept = acr & ACR_ICEN != 0 && self.look_up_or_fill(line);
        let waits = if is_brought || is_kept { 0 } else { u64::from(acr & ACR_LATENCY_MASK) };
        self.waited += waits;
        waits
    }

    /// A write of FLASH_ACR: ICRST empties the cache.
    pub fn write_acr(&mut self, acr: u32) {
        if acr & ACR_ICRST != 0 {
            let waited = self.waited;
            *self = FlashAccelerator { waited, ..FlashAccelerator::default() };
        }
    }

    /// Looks a line up, and puts it into the cache where it is missing. Returns whether it was there.
    fn look_up_or_fill(&mut self, line: u32) -> bool {
        self.clock += 1;
        let place = self.place[line as usize];
        if place != NOT_CACHED {
            self.used[place as usize] = self.clock;
            return true;
        }
        let oldest =
            (0..FLASH_CACHE_LINES).min_by_key(|slot| self.used[*slot]).expect("there are lines");
        if self.used[oldest] > 0 {
            self.place[self.line[oldest] as usize] = NOT_CACHED;
        }
        self.place[line as usize] = oldest as u8;
        self.line[oldest] = line;
        self.used[oldest] = self.clock;
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_the_cache_each_new_line_of_16_bytes_waits() {
        let mut it = FlashAccelerator::default();
        let waits = |accelerator: &mut FlashAccelerator, acr| {
            (0..32).map(|n| accelerator.fetch_wait_cycles(2 * n, acr)).sum::<u64>()
        };
        assert_eq!(waits(&mut it, 5), 4 * 5);
        assert_eq!(waits(&mut it, 5), 4 * 5, "and again");
        assert_eq!(waits(&mut it, 0), 0, "at 30 MHz there is none");
        assert_eq!(waits(&mut it, 5 | ACR_PRFTEN), 5, "only the first is not foreseen");
    }

    #[test]
    fn the_cache_holds_64_lines_and_drops_the_one_that_was_not_used_for_longest() {
        let mut it = FlashAccelerator::default();
        let acr = 5 | ACR_ICEN;
        let all = |accelerator: &mut FlashAccelerator, lines: u32| {
            (0..lines)
                .map(|n| accelerator.fetch_wait_cycles(n << FLASH_LINE_SHIFT, acr))
                .sum::<u64>()
        };
        assert_eq!(all(&mut it, 64), 64 * 5);
        assert_eq!(all(&mut it, 64), 0);
        // A loop of one line more than fits finds none of them.
        assert_eq!(all(&mut it, 65), 5);
        assert_eq!(all(&mut it, 65), 65 * 5);
        it.write_acr(acr | ACR_ICRST);
        assert_eq!(it.fetch_wait_cycles(64 << FLASH_LINE_SHIFT, acr), 5);
    }
}
