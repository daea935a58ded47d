//! Where a signal lies in a frame, and how it gets in and out: Intel byte order, as in the DBC.
//!
//! The eight bytes are one little-endian number of 64 bits; a signal is `length` bits of it from
//! bit `start` upwards, two's complement if `signed`.

/// A signal's place in an 8-byte frame. The raw value always fits an `i32`.
///
/// ```
/// use trueup_link::layout::OFFSET_Y; // 20 bits from bit 44, signed
/// let mut data = [0; 8];
/// OFFSET_Y.insert(&mut data, -2);
/// assert_eq!(data, [0, 0, 0, 0, 0, 0xE0, 0xFF, 0xFF]);
/// assert_eq!(OFFSET_Y.extract(&data), -2);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Signal {
    /// Number of the lowest bit, 0…63: bit `n` is bit `n % 8` of byte `n / 8`.
    pub start: u8,
    /// Number of bits, 1…32. The raw value of 32 unsigned bits is their pattern.
    pub length: u8,
    /// Whether the raw value is two's complement.
    pub signed: bool,
}

impl Signal {
    /// Returns a signal of 0 and up. A place outside the frame does not compile: every use is a constant.
    pub const fn unsigned(start: u8, length: u8) -> Self {
        assert!(length <= 32 && Self::is_in_frame(start, length));
        Self { start, length, signed: false }
    }

    /// Returns a signal in two's complement, as `unsigned`.
    pub const fn signed(start: u8, length: u8) -> Self {
        assert!(length <= 32 && Self::is_in_frame(start, length));
        Self { start, length, signed: true }
    }

    const fn is_in_frame(start: u8, length: u8) -> bool {
        1 <= length && length <= 64_u8.saturating_sub(start)
    }

    /// Returns the smallest raw value.
    #[must_use]
    pub const fn min_raw(self) -> i32 {
        if self.signed || self.length == 32 { !self.max_raw() } else { 0 }
    }

    /// Returns the largest raw value.
    #[must_use]
    pub const fn max_raw(self) -> i32 {
        let is_pattern = self.signed || self.length == 32;
        let magnitude_bits = self.length.saturating_sub(is_pattern as u8);
        1_i32.wrapping_shl(magnitude_bits as u32).wrapping_sub(1)
    }

    /// Writes a raw value, saturated to [`Self::min_raw`]…[`Self::max_raw`]; all other bits stay.
    pub fn insert(self, data: &mut [u8; 8], raw: i32) {
        let start = u32::from(self.start);
        let mask = u64::MAX.wrapping_shr(64_u32.saturating_sub(self.length.into()));
        let held = raw.clamp(self.min_raw(), self.max_raw()).cast_unsigned();
        let others = u64::from_le_bytes(*data) & !mask.wrapping_shl(start);
        *data = (others | (u64::from(held) & mask).wrapping_shl(start)).to_le_bytes();
    }

    /// Reads the raw value.
    #[must_use]
    pub fn extract(self, data: &[u8; 8]) -> i32 {
        let from_start = u64::from_le_bytes(*data).wrapping_shr(self.start.into());
        let [b0, b1, b2, b3, ..] = from_start.to_le_bytes();
        let unused = 32_u32.saturating_sub(self.length.into());
        let at_top = u32::from_le_bytes([b0, b1, b2, b3]).wrapping_shl(unused);
        if self.signed {
            at_top.cast_signed().wrapping_shr(unused)
        } else {
            at_top.wrapping_shr(unused).cast_signed()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_range_follows_from_length_and_sign() {
        assert_eq!(Signal::signed(24, 20).min_raw(), -524_288);
        assert_eq!(Signal::signed(24, 20).max_raw(), 524_287);
        assert_eq!(Signal::unsigned(0, 31).max_raw(), i32::MAX);
        assert_eq!(Signal::unsigned(24, 1).max_raw(), 1);
        assert_eq!(
            (Signal::signed(24, 32).min_raw(), Signal::signed(24, 32).max_raw()),
            (i32::MIN, i32::MAX)
        );
        assert_eq!((Signal::signed(56, 2).min_raw(), Signal::signed(56, 2).max_raw()), (-2, 1));
        assert_eq!(Signal::signed(0, 1).min_raw(), -1);
        assert_eq!(Signal::signed(0, 1).max_raw(), 0);
    }

    prop_compose! {
        fn any_signal()(length in 1_u8..=32)
            (length in Just(length), start in 0..=(64 - length), signed in any::<bool>()) -> Signal {
            if signed || length == 32 { Signal::signed(start, length) } else { Signal::unsigned(start, length) }
        }
    }

    proptest! {
        #[test]
        fn a_value_comes_back_saturated_and_its_neighbours_stay(
            signal in any_signal(), before in any::<[u8; 8]>(), raw in any::<i32>(), shift in 0_u32..32,
        ) {
            let raw = raw >> shift;
            let mut data = before;
            signal.insert(&mut data, raw);
            prop_assert_eq!(signal.extract(&data), raw.clamp(signal.min_raw(), signal.max_raw()));
            // Writing back what was there before restores every bit only if no other bit moved.
            signal.insert(&mut data, signal.extract(&before));
            prop_assert_eq!(data, before);
        }
    }

    #[test]
    fn a_signal_without_bits_or_beyond_the_frame_is_no_signal() {
        for (start, length, is_one) in [
            (0, 1, true),
            (63, 1, true),
            (32, 32, true),
            (0, 0, false),
            (63, 2, false),
            (33, 32, false),
            (64, 1, false),
        ] {
            assert_eq!(Signal::is_in_frame(start, length), is_one, "{length} from {start}");
        }
    }
}
