//! A straightness curve: cubic segments between arbitrary knots, read in place from bytes.
//!
//! A segment is stored with the knot at which it ends, and owns a local variable t that runs
//! backwards from there. With u = end − p and a span D = 2^(32 − shift) that holds the segment,
//!
//! ```text
//! t = 2·u/D − 1            −1 ≤ t < 1, Q31: (u << shift) − 2³¹
//! y = c₀ + t·(c₁ + t·(c₂/2 + t·c₃/4))
//! ```
//!
//! by Horner's rule with high words, hi(a·b) = ⌊a·b/2³²⌋, one `smmul` each:
//! a₂ = c₂ + hi(c₃·t), a₁ = c₁ + hi(a₂·t), y = c₀ + 2·hi(a₁·t). A high word halves, so c₂ is
//! stored twice and c₃ four times its value in 1/256 nm; c₀ and c₁ are stored as they are. As t
//! starts anew in every segment, a coefficient never has to carry the machine's 15 m.
//!
//! The five low bits of c₃ say the span, as the rotation to the right that brings u to the top of
//! its word; c₃ enters the arithmetic whole, and [`CurveSegment::new`] rounds it to the nearest value
//! with those bits: at most 4 units of y, 0.016 nm.
//!
//! The segment is found in constant time: an index over equal buckets names the segment of the
//! bucket's first position, and at most [`MAX_KNOTS_IN_BUCKET`] steps forward follow. The end is
//! stored and not the start because then the comparison that ends the search is with the word
//! that t needs anyway.
//!
//! Range: any B-spline with control points within ±262 µm fits unchanged ([`CurveSegment::is_valid_for_reach`]); a
//! larger one fits after its segments are halved. Sums wrap, because a sound segment cannot
//! overflow and an unsound one is refused when it is loaded. Worst error against `f64`, measured
//! by the test below over 600 curves of 1…512 segments, 0.1 mm to 20 m long, up to ±250 µm: 0.028 nm
//! (0.041 nm in the step across a knot).

mod segment;
#[cfg(test)]
mod tests;

pub use self::segment::{CURVE_SEGMENT_SIZE, CurveSegment};
use self::segment::{evaluate_horner, read_words, segment_end};
use crate::{
    fixed_point::mul_high_unsigned,
    units::{FineNanometres, Position},
};

/// How many segments may end inside a bucket, before its last position.
pub const MAX_KNOTS_IN_BUCKET: usize = 3;

/// A curve in place: its segments in rising order, and the index that finds one of them.
///
/// `Default` is the empty curve, which is 0 everywhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Curve<'a> {
    segments: &'a [[u8; CURVE_SEGMENT_SIZE]],
    index: &'a [[u8; 2]],
    /// The first knot.
    first: i32,
    /// Positions from the first knot to the last.
    length: u32,
    /// 2³² divided by the width of a bucket; 0 makes one bucket of everything.
    buckets: u32,
}

impl<'a> Curve<'a> {
    /// Returns the curve over `segments`, the first of which begins at `first`.
    ///
    /// `index` holds, for every bucket of 2^`bucket_shift` positions (1…32) from the first knot to
    /// the last, the number of the segment in which the bucket's first position lies, two bytes,
    /// little-endian. A knot belongs to the segment that it ends. Nothing is checked here: ask
    /// [`Self::is_consistent`] once.
    #[must_use]
    pub fn new(
        first: Position,
        segments: &'a [[u8; CURVE_SEGMENT_SIZE]],
        index: &'a [[u8; 2]],
        bucket_shift: u8,
    ) -> Self {
        let Some(last) = segments.last().map(segment_end) else {
            return Self { index, ..Self::default() };
        };
        let length = last.wrapping_sub(first.0).cast_unsigned();
        let places = 32_u32.saturating_sub(u32::from(bucket_shift));
        let buckets = if places == 0 { 0 } else { 1_u32.checked_shl(places).unwrap_or(1 << 31) };
        Self { segments, index, first: first.0, length, buckets }
    }

    /// Returns whether there is no segment: 0 everywhere.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.segments.is_empty()
    }

    /// Returns the first knot.
    #[must_use]
    pub const fn first_knot(&self) -> Position {
        Position(self.first)
    }

    /// Returns the segments as they are stored.
    #[must_use]
    pub const fn segments(&self) -> &'a [[u8; CURVE_SEGMENT_SIZE]] {
        self.segments
    }

    /// Returns the stored index.
    #[must_use]
    pub const fn index(&self) -> &'a [[u8; 2]] {
        self.index
    }

    /// The width of a bucket is 2 to this power, 1…32; 32 for the empty curve.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, reason = "at most 32")]
    pub const fn bucket_shift(&self) -> u8 {
        if self.buckets == 0 {
            32
        } else {
            32_u32.saturating_sub(self.buckets.trailing_zeros()) as u8
        }
    }

    /// Returns the value at `p`, and whether `p` lies outside: there the value at the nearer end is held.
    ///
    /// The empty curve is 0 everywhere, with nothing outside. Whatever the bytes, the search ends
    /// after at most [`MAX_KNOTS_IN_BUCKET`] steps; where it leads nowhere, this says 0 and
    /// outside.
    ///
    /// ```
    /// use trueup_core::{curve::{Curve, CurveSegment}, units::{FineNanometres, Position}};
    /// // From 0 to 0.4 mm 8 nm, from there to 1 mm 5 nm.
    /// let segments = [(40_000, 8), (100_000, 5)].map(|(end, nm)| {
    ///     CurveSegment::new(Position(end), 16, [nm * 256, 0, 0, 0]).to_bytes()
    /// });
    /// // Two buckets of 2¹⁶ positions: from 0, in segment 0, and from 65 536, in segment 1.
    /// let curve = Curve::new(Position(0), &segments, &[[0, 0], [1, 0]], 16);
    /// assert!(curve.is_consistent());
    /// let at = |p| (curve.evaluate(Position(p)).0.rounded().0, curve.evaluate(Position(p)).1);
    /// assert_eq!([at(-1), at(0), at(40_000)], [(8, true), (8, false), (8, false)]);
    /// assert_eq!([at(40_001), at(100_000), at(100_001)], [(5, false), (5, false), (5, true)]);
    /// ```
    #[must_use]
    #[inline]
    pub fn evaluate(&self, p: Position) -> (FineNanometres, bool) {
        // One unsigned comparison tests both ends.
        let from_first = p.0.wrapping_sub(self.first).cast_unsigned();
        if from_first > self.length {
            return self
                .nearest_end_value(p)
                .map_or((FineNanometres::ZERO, false), |value| (value, true));
        }
        let found = self.value_at(p, from_first);
        found.map_or((FineNanometres::ZERO, !self.segments.is_empty()), |value| (value, false))
    }

    /// Returns the value at the end nearer to `p`, unless the curve is empty.
    #[cold]
    #[inline(never)]
    fn nearest_end_value(&self, p: Position) -> Option<FineNanometres> {
        if p.0 < self.first {
            let segment = self.segments.first()?;
            Some(evaluate_horner(read_words(segment), Position(self.first)))
        } else {
            let segment = self.segments.last()?;
            Some(evaluate_horner(read_words(segment), Position(segment_end(segment))))
        }
    }

    /// Returns the value at `p`, which is `from_first` after the first knot.
    #[inline]
    fn value_at(&self, p: Position, from_first: u32) -> Option<FineNanometres> {
        let bucket = self.bucket_index(from_first);
        let mut number = usize::from(u16::from_le_bytes(*self.index.get(bucket)?));
        let mut segment = self.segments.get(number)?;
        for _ in 0..MAX_KNOTS_IN_BUCKET {
            if p.0 <= segment_end(segment) {
                break;
            }
            number = number.wrapping_add(1);
            segment = self.segments.get(number)?;
        }
        Some(evaluate_horner(read_words(segment), p))
    }

    /// Returns the number of the bucket that a position lies in. A product with a power of two is the
    /// shift, in one instruction whatever the amount.
    #[inline]
    fn bucket_index(&self, from_first: u32) -> usize {
        mul_high_unsigned(from_first, self.buckets) as usize
    }

    /// Returns whether the curve is what [`Self::new`] requires: knots rising, every segment sound, every
    /// entry of the index right, no bucket with too many knots.
    ///
    /// Meant for loading, not for every tick.
    #[must_use]
    pub fn is_consistent(&self) -> bool {
        if self.segments.is_empty() {
            return self.index.is_empty();
        }
        if self.bucket_index(self.length).checked_add(1) != Some(self.index.len()) {
            return false;
        }
        let mut start = self.first;
        // The knot at its start belongs to the segment before, except at the first.
        let mut before = 0;
        let sound = self.segments.iter().map(CurveSegment::from_bytes).all(|segment| {
            let length = segment.end.0.wrapping_sub(start).cast_unsigned();
            let rising = start < segment.end.0;
            start = segment.end.0;
            rising
                && segment
                    .is_valid_for_reach(length.saturating_sub(core::mem::replace(&mut before, 1)))
        });
        sound && self.is_index_consistent()
    }

    /// Returns whether every entry names the segment of its bucket's first position, and the steps allowed
    /// from there reach the bucket's last; for rising knots.
    fn is_index_consistent(&self) -> bool {
        // Whether segment `n` ends before a position, which is counted from the first knot.
        let ends_before = |n: usize, limit: u64| {
            self.segments.get(n).is_some_and(|segment| {
                let end = segment_end(segment).wrapping_sub(self.first).cast_unsigned();
                u64::from(end) < limit
            })
        };
        let places = if self.buckets == 0 { 0 } else { self.buckets.trailing_zeros() };
        let width = (1_u64 << 32).wrapping_shr(places);
        let mut start = 0_u64;
        self.index.iter().all(|entry| {
            let number = usize::from(u16::from_le_bytes(*entry));
            let next = start.saturating_add(width);
            let last = next.saturating_sub(1).min(u64::from(self.length));
            let named = number < self.segments.len()
                && !ends_before(number, start)
                && number.checked_sub(1).is_none_or(|previous| ends_before(previous, start));
            start = next;
            named && !ends_before(number.saturating_add(MAX_KNOTS_IN_BUCKET), last)
        })
    }
}
