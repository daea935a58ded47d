//! What outlasts a reset in RAM that is not cleared: the heat, and how the sources join.
//!
//! | offset | a copy, little-endian | unit |
//! |---|---|---|
//! | 0 | `u32` layout, 1; `u32` number of the copy, rising | |
//! | 8 | `u8` source of the elongation that was used last (0 none), 0, 0, 0; `i32` its shift | nm |
//! | 16 | 21 lags, 24 bytes each: `u8` input, `u8` 1 if there is one, 0, 0; 2 × `u32` smoothing factor; `i64` state; `u32` running time | ms |
//! | 520 | CRC-32/AUTOSAR of all before it | |
//!
//! There are two copies, written in turn: a reset while one is written leaves the other. After a
//! power cut neither has its CRC, but for one case in 2³².

use trueup_core::{
    bridge::KeptJoint,
    calibration::ElongationSource,
    heat_memory::{HeatMemory, KeptLag, Key, MOST_LAGS},
    lag::{Lag, SmoothingFactor},
    units::Nanometres,
};

use crate::crc;

const LAYOUT: u32 = 1;
const HEAD: usize = 16;
const LAG_SIZE: usize = 24;
/// Bytes of a copy.
pub const SIZE: usize = HEAD + MOST_LAGS * LAG_SIZE + 4;
const _: () = assert!(SIZE == 524);

/// The two copies.
pub type Copies = [[u8; SIZE]; 2];

/// What outlasts a reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Kept {
    /// What each lag has reached.
    pub heat: HeatMemory,
    /// The source of the elongation that was used last.
    pub joint: Option<KeptJoint>,
}

/// What the newer whole copy says; `None`: there is none, the power was gone.
#[must_use]
pub fn load(copies: &Copies) -> Option<Kept> {
    let [first, second] = copies.each_ref().map(decode);
    let newest = match (first, second) {
        (Some(first), Some(second)) if is_newer(first.0, second.0) => first,
        (Some(first), None) => first,
        (_, second) => second?,
    };
    Some(newest.1)
}

/// Writes it into the older copy.
pub fn save(copies: &mut Copies, kept: &Kept) {
    let [first, second] = copies.each_ref().map(|copy| decode(copy).map(|(number, _)| number));
    let (number, older) = match (first, second) {
        (Some(first), Some(second)) if is_newer(first, second) => (first, 1),
        (Some(first), None) => (first, 1),
        (_, second) => (second.unwrap_or(0), 0),
    };
    if let Some(copy) = copies.get_mut(older) {
        // Not whole from its first changed byte to its last.
        copy.fill(0);
        encode(kept, number.wrapping_add(1), copy);
    }
}

fn is_newer(number: u32, other: u32) -> bool {
    number.wrapping_sub(other).cast_signed() > 0
}

fn encode(kept: &Kept, number: u32, copy: &mut [u8; SIZE]) {
    let (source, shift) = match kept.joint {
        None => (0, 0),
        Some(KeptJoint { source, shift }) => (source_number(source), shift.0),
    };
    let head = [LAYOUT, number, source, shift.cast_unsigned()];
    let words = copy.as_chunks_mut::<4>().0;
    words.iter_mut().zip(head).for_each(|(place, word)| *place = word.to_le_bytes());
    let places = words.get_mut(HEAD / 4..).unwrap_or_default().chunks_mut(LAG_SIZE / 4);
    for (place, lag) in places.zip(kept.heat.lags.into_iter().flatten()) {
        let KeptLag { key: Key { input, rising, falling }, lag, running_ms } = lag;
        let [a, b, c, d, e, f, g, h] = lag.to_bits().to_le_bytes();
        let (low, high) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
        let here = u32::from(input) | 1 << 8;
        let fields = [here, rising.0, falling.0, low, high, running_ms];
        place.iter_mut().zip(fields).for_each(|(place, word)| *place = word.to_le_bytes());
    }
    crc::seal(copy);
}

/// The number of the copy, and what it says; `None`: it is not whole.
fn decode(copy: &[u8; SIZE]) -> Option<(u32, Kept)> {
    let words = crc::unseal(copy)?.as_chunks::<4>().0;
    let &[layout, number, source, shift, ref lags @ ..] = words else { return None };
    if u32::from_le_bytes(layout) != LAYOUT {
        return None;
    }
    let mut kept = Kept::default();
    for (place, lag) in kept.heat.lags.iter_mut().zip(lags.chunks(LAG_SIZE / 4)) {
        let &[here, rising, falling, low, high, running_ms] = lag else { return None };
        let [input, 1, ..] = here else { continue };
        let [rising, falling, running_ms] = [rising, falling, running_ms].map(u32::from_le_bytes);
        let key = Key { input, rising: SmoothingFactor(rising), falling: SmoothingFactor(falling) };
        let ([a, b, c, d], [e, f, g, h]) = (low, high);
        let lag = Lag::from_bits(i64::from_le_bytes([a, b, c, d, e, f, g, h]));
        *place = Some(KeptLag { key, lag, running_ms });
    }
    let shift = Nanometres(i32::from_le_bytes(shift));
    kept.joint = source_of(u32::from_le_bytes(source)).map(|source| KeptJoint { source, shift });
    Some((u32::from_le_bytes(number), kept))
}

/// As the calibration numbers them.
const fn source_number(source: ElongationSource) -> u32 {
    match source {
        ElongationSource::Sensor => 1,
        ElongationSource::Temperature => 2,
        ElongationSource::Warmup => 3,
    }
}

fn source_of(number: u32) -> Option<ElongationSource> {
    let all = [ElongationSource::Sensor, ElongationSource::Temperature, ElongationSource::Warmup];
    all.into_iter().find(|source| source_number(*source) == number)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(number: i32) -> Kept {
        let mut heat = HeatMemory::default();
        for input in [3, 7, Key::RUNNING] {
            heat.keep(KeptLag {
                key: Key { input, rising: SmoothingFactor(9), falling: SmoothingFactor(8) },
                lag: Lag::settled(number - i32::from(input)),
                running_ms: 77,
            });
        }
        let joint = KeptJoint { source: ElongationSource::Warmup, shift: Nanometres(-number) };
        Kept { heat, joint: Some(joint) }
    }

    #[test]
    fn the_newest_counts_and_the_numbers_may_wrap() {
        let mut copies = [[0; SIZE]; 2];
        assert_eq!(load(&copies), None);
        encode(&kept(1), u32::MAX - 2, &mut copies[0]);
        for number in 2..20 {
            save(&mut copies, &kept(number));
            assert_eq!(load(&copies), Some(kept(number)));
        }
        save(&mut copies, &Kept::default());
        assert_eq!(load(&copies), Some(Kept::default()));
    }

    #[test]
    fn a_reset_at_any_byte_leaves_the_one_before() {
        let mut copies = [[0; SIZE]; 2];
        save(&mut copies, &kept(1));
        save(&mut copies, &kept(2));
        let (before, mut after) = (copies, copies);
        save(&mut after, &kept(3));
        let written = usize::from(after[0] == before[0]);
        for at in 0..SIZE {
            let mut torn = after;
            // What was not written yet is 0, as `save` leaves it, or as it was.
            torn[written][at..].fill(0);
            let found = load(&torn).expect("one is whole");
            assert!(found == kept(2) || found == kept(3), "cut at {at}");
            torn[written][at..].copy_from_slice(&before[written][at..]);
            assert!([Some(kept(2)), Some(kept(3))].contains(&load(&torn)), "cut at {at}");
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
        let mut copies = [[0; SIZE]; 2];
        save(&mut copies, &kept(1));
        let one = usize::from(copies[0][0] == 0);
        for bit in 0..SIZE * 8 {
            let mut flipped = copies;
            flipped[one][bit / 8] ^= 1 << (bit % 8);
            assert_eq!(load(&flipped), None, "bit {bit}");
        }
    }
}
