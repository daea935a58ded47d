//! How often the board has started for which reason since power-on, in RAM that a reset leaves as it is.

use core::{
    mem::MaybeUninit,
    sync::atomic::{AtomicU32, Ordering},
};

use trueup_link::status::ResetReason;

const REASONS: usize = ResetReason::COUNT;
/// A counter for each reason, and their checksum.
const WORDS: usize = REASONS + 1;
/// The checksum of nothing but zeros: so that cleared RAM is no count.
const SEED: u32 = 0x7265_7365;

#[unsafe(link_section = ".uninit.resets")]
#[allow(unsafe_code, reason = "a place in RAM that the start leaves as it is")]
static COUNTS: MaybeUninit<[AtomicU32; WORDS]> = MaybeUninit::uninit();

fn checksum(counts: &[u32]) -> u32 {
    counts.iter().fold(SEED, |sum, count| sum.rotate_left(5) ^ count)
}

/// Counts this start, and gives how often it was each reason. The counts begin anew at power-on.
#[allow(unsafe_code, reason = "a place in RAM that the start leaves as it is")]
pub fn count(reason: ResetReason) -> [u16; REASONS] {
    // SAFETY: any bits are a value of these.
    let words = unsafe { COUNTS.assume_init_ref() };
    let mut counts: [u32; REASONS] = core::array::from_fn(|n| words[n].load(Ordering::Relaxed));
    let is_whole = words[REASONS].load(Ordering::Relaxed) == checksum(&counts);
    if reason == ResetReason::PowerOn || !is_whole {
        counts = [0; REASONS];
    }
    let count = &mut counts[reason as usize];
    *count = count.saturating_add(1);
    words.iter().zip(counts).for_each(|(word, count)| word.store(count, Ordering::Relaxed));
    words[REASONS].store(checksum(&counts), Ordering::Relaxed);
    counts.map(|count| u16::try_from(count).unwrap_or(u16::MAX))
}
