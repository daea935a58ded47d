//! A cubic segment of a curve: how it is stored, and its value.

use crate::{
    fixed_point::mul_high,
    units::{FineNanometres, Position},
};

/// Bytes of a stored segment, five little-endian words: end, c₀, c₁, c₂, c₃.
pub const CURVE_SEGMENT_SIZE: usize = 20;

/// The bits of c₃ that say the span.
pub(super) const SPAN_MASK: i32 = 31;

/// One cubic piece of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CurveSegment {
    /// The knot at which it ends. The segment before it has the position of its own start.
    pub end: Position,
    /// Its span is 2^(32 − shift) positions, 0…31.
    pub shift: u8,
    /// c₀, c₁, c₂ and c₃ as stored; the five low bits of c₃ belong to the shift.
    pub coefficients: [i32; 4],
}

impl CurveSegment {
    /// Returns a segment with c₃ rounded to the nearest value that says `shift` in its five low bits.
    #[must_use]
    pub const fn new(end: Position, shift: u8, coefficients: [i32; 4]) -> Self {
        let shift = shift & 31;
        let [c0, c1, c2, c3] = coefficients;
        let bits = Self::right_rotation_for_shift(shift);
        let nearest = (c3.saturating_sub(bits).saturating_add(16) & !SPAN_MASK) | bits;
        Self { end, shift, coefficients: [c0, c1, c2, nearest] }
    }

    /// Returns the rotation to the right that equals a shift to the left, for a value below the span.
    const fn right_rotation_for_shift(shift: u8) -> i32 {
        // Widening; `From` is not const.
        32_i32.wrapping_sub(shift as i32) & SPAN_MASK
    }

    /// Returns the words as stored: c₃ with the shift in it.
    const fn to_words(self) -> [i32; 5] {
        let [c0, c1, c2, c3] = self.coefficients;
        [self.end.0, c0, c1, c2, (c3 & !SPAN_MASK) | Self::right_rotation_for_shift(self.shift)]
    }

    /// Returns the largest shift whose span holds a position `reach` before the end: it loses least.
    ///
    /// ```
    /// use trueup_core::curve::CurveSegment;
    /// // 1 mm is 100 000 positions: 2¹⁷ = 131 072 holds it, 2¹⁶ = 65 536 does not.
    /// assert_eq!(CurveSegment::shift_for_reach(100_000), 15);
    /// assert_eq!(CurveSegment::shift_for_reach(65_536), 15);
    /// assert_eq!(CurveSegment::shift_for_reach(65_535), 16);
    /// ```
    #[must_use]
    #[allow(clippy::cast_possible_truncation, reason = "at most 31")]
    pub const fn shift_for_reach(reach: u32) -> u8 {
        if reach == 0 { 31 } else { reach.leading_zeros() as u8 }
    }

    /// Returns the stored form.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; CURVE_SEGMENT_SIZE] {
        let mut bytes = [0; CURVE_SEGMENT_SIZE];
        for (place, word) in bytes.as_chunks_mut().0.iter_mut().zip(self.to_words()) {
            *place = word.to_le_bytes();
        }
        bytes
    }

    /// Returns the segment stored in `bytes`; any bytes are one.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0…31")]
    pub fn from_bytes(bytes: &[u8; CURVE_SEGMENT_SIZE]) -> Self {
        let [end, c0, c1, c2, c3] = read_words(bytes);
        let shift = (0_i32.wrapping_sub(c3) & SPAN_MASK) as u8;
        Self { end: Position(end), shift, coefficients: [c0, c1, c2, c3] }
    }

    /// Returns the value at `p`, meant for positions from the end to less than one span before it.
    ///
    /// ```
    /// use trueup_core::{curve::CurveSegment, units::{FineNanometres, Position}};
    /// // 2¹⁷ positions up to 131 072: 100 nm in the middle, 50 nm more for t from 0 to 1.
    /// let line = CurveSegment::new(Position(131_072), 15, [100 * 256, 50 * 256, 0, 0]);
    /// assert_eq!(line.evaluate(Position(131_072)).rounded().0, 50); // the end, t = −1
    /// assert_eq!(line.evaluate(Position(65_536)).rounded().0, 100); // t = 0
    /// assert_eq!(line.evaluate(Position(32_768)).rounded().0, 125); // t = 1/2
    /// ```
    #[must_use]
    #[inline]
    pub fn evaluate(&self, p: Position) -> FineNanometres {
        evaluate_horner(self.to_words(), p)
    }

    /// Returns whether every position up to `reach` before the end lies in the span, with no sum of the
    /// recurrence outside 32 bits.
    #[must_use]
    pub fn is_valid_for_reach(&self, reach: u32) -> bool {
        const MAX_COEFFICIENT_MAGNITUDE: u64 = i32::MAX.unsigned_abs() as u64;
        let [_, c0, c1, c2, c3] = self.to_words();
        if reach.leading_zeros() < u32::from(self.shift & 31) {
            return false;
        }
        // a₂ is linear in t, so its two ends bound it; from there on magnitudes are enough.
        let [at_end, at_start] = [0, reach].map(|u| {
            let product = i64::from(c3).saturating_mul(i64::from(local_parameter(u, c3)));
            i64::from(c2).saturating_add(product >> 32).unsigned_abs()
        });
        let a2 = at_end.max(at_start);
        let a1 = (a2 >> 1).saturating_add(1).saturating_add(u64::from(c1.unsigned_abs()));
        let y = a1.saturating_add(2).saturating_add(u64::from(c0.unsigned_abs()));
        a2 <= MAX_COEFFICIENT_MAGNITUDE
            && a1 <= MAX_COEFFICIENT_MAGNITUDE
            && y <= MAX_COEFFICIENT_MAGNITUDE
    }
}

/// Returns the five words of a stored segment.
#[inline]
pub(super) fn read_words(bytes: &[u8; CURVE_SEGMENT_SIZE]) -> [i32; 5] {
    let &[end, c0, c1, c2, c3] = bytes.as_chunks().0 else { return [0; 5] };
    [end, c0, c1, c2, c3].map(i32::from_le_bytes)
}

/// t of the position `u` before the end, by the span that `c3` says.
///
/// Above a position in the span there are only zero bits, so a rotation is the shift, and the
/// machine takes its amount from the low bits of c₃ as they are.
#[inline]
pub(super) const fn local_parameter(u: u32, c3: i32) -> i32 {
    (u.rotate_right(c3.cast_unsigned()) ^ 0x8000_0000).cast_signed()
}

/// Returns the value at `p` of the segment of these words.
#[inline]
pub(super) fn evaluate_horner([end, c0, c1, c2, c3]: [i32; 5], p: Position) -> FineNanometres {
    let t = local_parameter(end.wrapping_sub(p.0).cast_unsigned(), c3);
    let a2 = c2.wrapping_add(mul_high(c3, t));
    let a1 = c1.wrapping_add(mul_high(a2, t));
    FineNanometres(c0.wrapping_add(mul_high(a1, t).wrapping_shl(1)))
}

/// Where a stored segment ends.
#[inline]
pub(super) fn segment_end(bytes: &[u8; CURVE_SEGMENT_SIZE]) -> i32 {
    let [end, ..] = read_words(bytes);
    end
}
