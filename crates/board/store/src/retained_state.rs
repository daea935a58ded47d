//! Values that outlast a reset in RAM that is not cleared, and a power cut where a battery holds it: the heat, and
//! how the sources join.
//!
//! | offset | a copy, little-endian | unit |
//! |---|---|---|
//! | 0 | `u32` layout, 2; `u32` number of the copy, rising | |
//! | 8 | `u32` when it was written, by a clock that goes on without power; 0: there is none | s |
//! | 12 | `u8` source of the elongation that was used last (0 none), 0, 0, 0; `i32` its shift | nm |
//! | 20 | 21 lags, 28 bytes each: `u8` input, `u8` 1 if there is one, 0, 0; 2 × `u32` smoothing factor; `i64` state; `u32` running time; `u32` steps missed | ms; 100 ms |
//! | 608 | CRC-32/AUTOSAR of all before it | |
//!
//! There are two copies, written in turn: a reset while one is written leaves the other. After a power cut that
//! nothing has outlasted neither has its CRC, but for one case in 2³².

use trueup_core::{
    bridge::RetainedTransfer,
    calibration::ElongationSource,
    lag::{Lag, SmoothingFactor},
    retained_lags::{MAX_LAGS, RetainedLag, RetainedLagKey, RetainedLags},
    units::Nanometres,
};

use crate::{calendar::SECONDS_PER_DAY, crc};

const LAYOUT_VERSION: u32 = 2;
const HEADER_SIZE: usize = 20;
const LAG_SIZE: usize = 28;
/// Bytes of a copy.
pub const RETAINED_COPY_SIZE: usize = HEADER_SIZE + MAX_LAGS * LAG_SIZE + 4;
const _: () = assert!(RETAINED_COPY_SIZE == 612);
/// A machine that was off for longer has not stood there: its clock is wrong.
pub(crate) const MAX_OFF_TIME_S: u32 = 366 * SECONDS_PER_DAY;

/// The two copies.
pub type RetainedCopies = [[u8; RETAINED_COPY_SIZE]; 2];

/// The values that outlast a reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RetainedState {
    /// The state of each lag.
    pub heat: RetainedLags,
    /// The source of the elongation that was used last.
    pub joint: Option<RetainedTransfer>,
}

/// Returns what the newer whole copy says; `None`: there is none, the power was gone.
#[must_use]
pub fn load(copies: &RetainedCopies) -> Option<RetainedState> {
    find_newest_copy(copies).map(|(_, retained)| retained)
}

/// Returns the seconds without power, by the clock that now says `now_s`. `None`: not known, because there is no whole
/// copy, or no clock, or the clock was not there when it was written, has been set back, or says that it was longer
/// than `MAX_OFF_TIME_S`.
#[must_use]
pub fn off_time_s(copies: &RetainedCopies, now_s: Option<u32>) -> Option<u32> {
    let (written_s, _) = find_newest_copy(copies)?;
    let off_s = now_s?.checked_sub(written_s).filter(|_| written_s != 0)?;
    (off_s <= MAX_OFF_TIME_S).then_some(off_s)
}

/// When the newer whole copy was written, and what it says.
fn find_newest_copy(copies: &RetainedCopies) -> Option<(u32, RetainedState)> {
    let [first, second] = copies.each_ref().map(decode);
    let newest = match (first, second) {
        (Some(first), Some(second)) if is_newer(first.0, second.0) => first,
        (Some(first), None) => first,
        (_, second) => second?,
    };
    Some((newest.1, newest.2))
}

/// Writes it into the older copy, at this time of a clock that goes on without power, if there is one.
pub fn save_state(copies: &mut RetainedCopies, retained: &RetainedState, now_s: Option<u32>) {
    let [first, second] = copies.each_ref().map(|copy| decode(copy).map(|(number, ..)| number));
    let (number, older) = match (first, second) {
        (Some(first), Some(second)) if is_newer(first, second) => (first, 1),
        (Some(first), None) => (first, 1),
        (_, second) => (second.unwrap_or(0), 0),
    };
    if let Some(copy) = copies.get_mut(older) {
        // Not whole from its first changed byte to its last.
        copy.fill(0);
        encode(retained, number.wrapping_add(1), now_s.unwrap_or(0), copy);
    }
}

/// Writes it as the copy with this number, without a look at those that are there: for who counts the copies, and has
/// little time. Returns the next number.
pub fn write_copy(
    copies: &mut RetainedCopies,
    number: u32,
    retained: &RetainedState,
    now_s: Option<u32>,
) -> u32 {
    let [even, odd] = copies;
    let copy = if number & 1 == 0 { even } else { odd };
    copy.fill(0);
    encode(retained, number, now_s.unwrap_or(0), copy);
    number.wrapping_add(1)
}

fn is_newer(number: u32, other: u32) -> bool {
    number.wrapping_sub(other).cast_signed() > 0
}

fn encode(
    retained: &RetainedState,
    number: u32,
    written_s: u32,
    copy: &mut [u8; RETAINED_COPY_SIZE],
) {
    let (source, shift) = match retained.joint {
        None => (0, 0),
        Some(RetainedTransfer { source, shift }) => (encode_elongation_source(source), shift.0),
    };
    let head = [LAYOUT_VERSION, number, written_s, source, shift.cast_unsigned()];
    let words = copy.as_chunks_mut::<4>().0;
    words.iter_mut().zip(head).for_each(|(place, word)| *place = word.to_le_bytes());
    let places = words.get_mut(HEADER_SIZE / 4..).unwrap_or_default().chunks_mut(LAG_SIZE / 4);
    for (place, lag) in places.zip(retained.heat.lags.into_iter().flatten()) {
        let RetainedLag { key: RetainedLagKey { input, rising, falling }, lag, running_ms } = lag;
        let [a, b, c, d, e, f, g, h] = lag.to_bits().to_le_bytes();
        let (low, high) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
        let here = u32::from(input) | 1 << 8;
        let fields = [here, rising.0, falling.0, low, high, running_ms, lag.missed_steps()];
        place.iter_mut().zip(fields).for_each(|(place, word)| *place = word.to_le_bytes());
    }
    crc::write_crc(copy);
}

/// Returns the number of the copy, when it was written, and what it says; `None`: it is not whole.
fn decode(copy: &[u8; RETAINED_COPY_SIZE]) -> Option<(u32, u32, RetainedState)> {
    let words = crc::verify_and_strip_crc(copy)?.as_chunks::<4>().0;
    let &[layout, number, written_s, source, shift, ref lags @ ..] = words else { return None };
    if u32::from_le_bytes(layout) != LAYOUT_VERSION {
        return None;
    }
    let mut retained = RetainedState::default();
    for (place, lag) in retained.heat.lags.iter_mut().zip(lags.chunks(LAG_SIZE / 4)) {
        let &[here, rising, falling, low, high, running_ms, missed] = lag else { return None };
        let [input, 1, ..] = here else { continue };
        let [rising, falling, running_ms, missed] =
            [rising, falling, running_ms, missed].map(u32::from_le_bytes);
        let key = RetainedLagKey {
            input,
            rising: SmoothingFactor(rising),
            falling: SmoothingFactor(falling),
        };
        let ([a, b, c, d], [e, f, g, h]) = (low, high);
        let mut lag = Lag::from_bits(i64::from_le_bytes([a, b, c, d, e, f, g, h]));
        lag.record_missed_steps(missed);
        *place = Some(RetainedLag { key, lag, running_ms });
    }
    let shift = Nanometres(i32::from_le_bytes(shift));
    retained.joint = decode_elongation_source(u32::from_le_bytes(source))
        .map(|source| RetainedTransfer { source, shift });
    Some((u32::from_le_bytes(number), u32::from_le_bytes(written_s), retained))
}

/// As the calibration numbers them.
const fn encode_elongation_source(source: ElongationSource) -> u32 {
    match source {
        ElongationSource::Sensor => 1,
        ElongationSource::Temperature => 2,
        ElongationSource::Warmup => 3,
    }
}

fn decode_elongation_source(number: u32) -> Option<ElongationSource> {
    let all = [ElongationSource::Sensor, ElongationSource::Temperature, ElongationSource::Warmup];
    all.into_iter().find(|source| encode_elongation_source(*source) == number)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn retained_state(number: i32) -> RetainedState {
        let mut heat = RetainedLags::default();
        for input in [3, 7, RetainedLagKey::SPINDLE_RUNNING_INPUT] {
            heat.insert(RetainedLag {
                key: RetainedLagKey {
                    input,
                    rising: SmoothingFactor(9),
                    falling: SmoothingFactor(8),
                },
                lag: {
                    let mut lag = Lag::settled_at(number - i32::from(input));
                    lag.record_missed_steps(u32::from(input) + 500);
                    lag
                },
                running_ms: 77,
            });
        }
        let joint =
            RetainedTransfer { source: ElongationSource::Warmup, shift: Nanometres(-number) };
        RetainedState { heat, joint: Some(joint) }
    }

    #[test]
    fn the_newest_counts_and_the_numbers_may_wrap() {
        let mut copies = [[0; RETAINED_COPY_SIZE]; 2];
        assert_eq!(load(&copies), None);
        encode(&retained_state(1), u32::MAX - 2, 0, &mut copies[0]);
        for number in 2..20 {
            save_state(&mut copies, &retained_state(number), None);
            assert_eq!(load(&copies), Some(retained_state(number)));
        }
        save_state(&mut copies, &RetainedState::default(), None);
        assert_eq!(load(&copies), Some(RetainedState::default()));
    }

    #[test]
    fn a_reset_at_any_byte_leaves_the_one_before() {
        let mut copies = [[0; RETAINED_COPY_SIZE]; 2];
        save_state(&mut copies, &retained_state(1), Some(1));
        save_state(&mut copies, &retained_state(2), Some(2));
        let (before, mut after) = (copies, copies);
        save_state(&mut after, &retained_state(3), Some(3));
        let written = usize::from(after[0] == before[0]);
        for at in 0..RETAINED_COPY_SIZE {
            let mut torn = after;
            // What was not written yet is 0, as `save` leaves it, or as it was.
            torn[written][at..].fill(0);
            let found = find_newest_copy(&torn).expect("one is whole");
            assert!(
                found == (2, retained_state(2)) || found == (3, retained_state(3)),
                "cut at {at}"
            );
            torn[written][at..].copy_from_slice(&before[written][at..]);
            assert!(
                [Some(retained_state(2)), Some(retained_state(3))].contains(&load(&torn)),
                "cut at {at}"
            );
        }
    }

    #[test]
    fn ram_that_has_lost_its_power_says_nothing() {
        let mut random = 1_u32;
        for _ in 0..1_000 {
            let copies = [(); 2].map(|()| {
                core::array::from_fn(|_| {
                    random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    random.to_le_bytes()[3]
                })
            });
            assert_eq!(load(&copies), None);
        }
        let mut copies = [[0; RETAINED_COPY_SIZE]; 2];
        save_state(&mut copies, &retained_state(1), Some(7));
        let one = usize::from(copies[0][0] == 0);
        for bit in 0..RETAINED_COPY_SIZE * 8 {
            let mut flipped = copies;
            flipped[one][bit / 8] ^= 1 << (bit % 8);
            assert_eq!(load(&flipped), None, "bit {bit}");
            assert_eq!(off_time_s(&flipped, Some(8)), None, "bit {bit}");
        }
    }

    #[test]
    fn for_how_long_the_power_was_gone_is_known_by_a_clock_that_has_gone_on_and_by_no_other() {
        const WRITTEN_S: u32 = 40_000_000;
        let mut copies = [[0; RETAINED_COPY_SIZE]; 2];
        assert_eq!(off_time_s(&copies, Some(WRITTEN_S)), None, "nothing is kept");
        save_state(&mut copies, &retained_state(1), Some(WRITTEN_S));
        // Up to a year.
        for off in [0, 1, 3_600, 365 * 86_400, MAX_OFF_TIME_S] {
            assert_eq!(off_time_s(&copies, Some(WRITTEN_S + off)), Some(off));
        }
        assert_eq!(off_time_s(&copies, None), None, "no clock");
        assert_eq!(off_time_s(&copies, Some(WRITTEN_S - 1)), None, "set back");
        assert_eq!(off_time_s(&copies, Some(0)), None, "begun anew");
        assert_eq!(off_time_s(&copies, Some(WRITTEN_S + MAX_OFF_TIME_S + 1)), None, "absurd");
        assert_eq!(off_time_s(&copies, Some(u32::MAX)), None, "absurd");
        // The newest counts, whichever time it has.
        save_state(&mut copies, &retained_state(2), Some(WRITTEN_S - 500));
        assert_eq!(off_time_s(&copies, Some(WRITTEN_S)), Some(500));
        save_state(&mut copies, &retained_state(3), None);
        // Also soon after the clock was set for the first time.
        for now_s in [1, WRITTEN_S] {
            assert_eq!(off_time_s(&copies, Some(now_s)), None, "no clock when it was written");
        }
        assert_eq!(load(&copies), Some(retained_state(3)), "but for a reset it is whole");
    }

    #[test]
    fn copies_that_are_counted_are_read_as_those_that_are_looked_at() {
        let mut copies = [[0; RETAINED_COPY_SIZE]; 2];
        let mut number = u32::MAX - 3;
        for n in 0..9 {
            let before = load(&copies);
            number = write_copy(&mut copies, number, &retained_state(n), Some(7));
            assert_eq!(load(&copies), Some(retained_state(n)));
            // The one before is still there, should the next one be torn.
            copies[number as usize & 1 ^ 1][9] ^= 1;
            assert_eq!(load(&copies), before);
            copies[number as usize & 1 ^ 1][9] ^= 1;
        }
    }

    #[test]
    fn a_save_leaves_the_newest_copy_as_it_is() {
        let mut copies = [[0; RETAINED_COPY_SIZE]; 2];
        for number in 0..20 {
            let before = copies;
            save_state(&mut copies, &retained_state(number), None);
            let is_same = [0, 1].map(|n| copies[n] == before[n]);
            assert_eq!(is_same.iter().filter(|is_same| **is_same).count(), 1, "number {number}");
            if number > 0 {
                let left = [0, 1].into_iter().find(|n| is_same[*n]).expect("one is as it was");
                assert_eq!(
                    decode(&copies[left]).map(|decoded| decoded.2),
                    Some(retained_state(number - 1))
                );
            }
        }
    }
}
