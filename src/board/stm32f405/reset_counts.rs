//! How often the board has started for which reason since power-on, in RAM that a reset leaves unchanged.

use core::{
    mem::MaybeUninit,
    sync::atomic::{AtomicU32, Ordering},
};

use trueup_link::status::ResetReason;

const RESET_REASON_COUNT: usize = ResetReason::COUNT;
/// A counter for each reason, and their checksum.
const RESET_RECORD_WORDS: usize = RESET_REASON_COUNT + 1;
/// The checksum of nothing but zeros: so that cleared RAM is no count.
const CHECKSUM_SEED: u32 = 0x7265_7365;

#[unsafe(link_section = ".uninit.resets")]
#[allow(unsafe_code, reason = "a place in RAM that the start leaves as it is")]
static RESET_COUNTS: MaybeUninit<[AtomicU32; RESET_RECORD_WORDS]> = MaybeUninit::uninit();

fn checksum(counts: &[u32]) -> u32 {
    counts.iter().fold(CHECKSUM_SEED, |sum, count| sum.rotate_left(5) ^ count)
}

/// Counts this start, and gives how often it was each reason. The counts begin anew at power-on.
#[allow(unsafe_code, reason = "a place in RAM that the start leaves as it is")]
pub fn count_reset(reason: ResetReason) -> [u16; RESET_REASON_COUNT] {
    // SAFETY: any bits are a value of these.
    let words = unsafe { RESET_COUNTS.assume_init_ref() };
    let mut counts: [u32; RESET_REASON_COUNT] =
        core::array::from_fn(|n| words[n].load(Ordering::Relaxed));
    let is_whole = words[RESET_REASON_COUNT].load(Ordering::Relaxed) == checksum(&counts);
    if reason == ResetReason::PowerOn || !is_whole {
        counts = [0; RESET_REASON_COUNT];
    }
    let count = &mut counts[reason as usize];
    *count = count.saturating_add(1);
    words.iter().zip(counts).for_each(|(word, count)| word.store(count, Ordering::Relaxed));
    words[RESET_REASON_COUNT].store(checksum(&counts), Ordering::Relaxed);
    counts.map(|count| u16::try_from(count).unwrap_or(u16::MAX))
}
