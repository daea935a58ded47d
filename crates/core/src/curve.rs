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
//! its word; c₃ enters the arithmetic whole, and [`Segment::new`] rounds it to the nearest value
//! with those bits: at most 4 units of y, 0.016 nm.
//!
//! The segment is found in constant time: an index over equal buckets names the segment of the
//! bucket's first position, and at most [`MAX_KNOTS_IN_BUCKET`] steps forward follow. The end is
//! stored and not the start because then the comparison that ends the search is with the word
//! that t needs anyway.
//!
//! Range: any B-spline with control points within ±262 µm fits as it is ([`Segment::is_sound`]); a
//! larger one fits after its segments are halved. Sums wrap, because a sound segment cannot
//! overflow and an unsound one is refused when it is loaded. Worst error against `f64`, measured
//! by the test below over 600 curves of 1…512 segments, 0.1 mm to 20 m long, up to ±250 µm: 0.028 nm
//! (0.041 nm in the step across a knot).

use crate::units::{Fine, Position};

/// Bytes of a stored segment, five little-endian words: end, c₀, c₁, c₂, c₃.
pub const SEGMENT_SIZE: usize = 20;

/// How many segments may end inside a bucket, before its last position.
pub const MAX_KNOTS_IN_BUCKET: usize = 3;

/// The bits of c₃ that say the span.
const SPAN_BITS: i32 = 31;

/// One cubic piece of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segment {
    /// The knot at which it ends. The segment before it has the position of its own start.
    pub end: Position,
    /// Its span is 2^(32 − shift) positions, 0…31.
    pub shift: u8,
    /// c₀, c₁, c₂ and c₃ as stored; the five low bits of c₃ belong to the shift.
    pub coefficients: [i32; 4],
}

impl Segment {
    /// A segment with c₃ rounded to the nearest value that says `shift` in its five low bits.
    #[must_use]
    pub const fn new(end: Position, shift: u8, coefficients: [i32; 4]) -> Self {
        let shift = shift & 31;
        let [c0, c1, c2, c3] = coefficients;
        let bits = Self::rotation(shift);
        let nearest = (c3.saturating_sub(bits).saturating_add(16) & !SPAN_BITS) | bits;
        Self { end, shift, coefficients: [c0, c1, c2, nearest] }
    }

    /// The rotation to the right that equals a shift to the left, for a value below the span.
    const fn rotation(shift: u8) -> i32 {
        // Widening; `From` is not const.
        32_i32.wrapping_sub(shift as i32) & SPAN_BITS
    }

    /// The words as stored: c₃ with the shift in it.
    const fn words(&self) -> [i32; 5] {
        let [c0, c1, c2, c3] = self.coefficients;
        [self.end.0, c0, c1, c2, (c3 & !SPAN_BITS) | Self::rotation(self.shift)]
    }

    /// The largest shift whose span holds a position `reach` before the end: it loses least.
    ///
    /// ```
    /// use trueup_core::curve::Segment;
    /// // 1 mm is 100 000 positions: 2¹⁷ = 131 072 holds it, 2¹⁶ = 65 536 does not.
    /// assert_eq!(Segment::shift_for(100_000), 15);
    /// assert_eq!(Segment::shift_for(65_536), 15);
    /// assert_eq!(Segment::shift_for(65_535), 16);
    /// ```
    #[must_use]
    #[allow(clippy::cast_possible_truncation, reason = "at most 31")]
    pub const fn shift_for(reach: u32) -> u8 {
        if reach == 0 { 31 } else { reach.leading_zeros() as u8 }
    }

    /// The stored form.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; SEGMENT_SIZE] {
        let mut bytes = [0; SEGMENT_SIZE];
        for (place, word) in bytes.as_chunks_mut().0.iter_mut().zip(self.words()) {
            *place = word.to_le_bytes();
        }
        bytes
    }

    /// The segment stored in `bytes`; any bytes are one.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0…31")]
    pub fn from_bytes(bytes: &[u8; SEGMENT_SIZE]) -> Self {
        let [end, c0, c1, c2, c3] = words(bytes);
        let shift = (0_i32.wrapping_sub(c3) & SPAN_BITS) as u8;
        Self { end: Position(end), shift, coefficients: [c0, c1, c2, c3] }
    }

    /// The value at `p`, meant for positions from the end to less than one span before it.
    ///
    /// ```
    /// use trueup_core::{curve::Segment, units::{Fine, Position}};
    /// // 2¹⁷ positions up to 131 072: 100 nm in the middle, 50 nm more for t from 0 to 1.
    /// let line = Segment::new(Position(131_072), 15, [100 * 256, 50 * 256, 0, 0]);
    /// assert_eq!(line.at(Position(131_072)).rounded().0, 50); // the end, t = −1
    /// assert_eq!(line.at(Position(65_536)).rounded().0, 100); // t = 0
    /// assert_eq!(line.at(Position(32_768)).rounded().0, 125); // t = 1/2
    /// ```
    #[must_use]
    #[inline]
    pub fn at(&self, p: Position) -> Fine {
        horner(self.words(), p)
    }

    /// Whether every position up to `reach` before the end lies in the span, with no sum of the
    /// recurrence outside 32 bits.
    #[must_use]
    pub fn is_sound(&self, reach: u32) -> bool {
        const LIMIT: u64 = i32::MAX.unsigned_abs() as u64;
        let [_, c0, c1, c2, c3] = self.words();
        if reach.leading_zeros() < u32::from(self.shift & 31) {
            return false;
        }
        // a₂ is linear in t, so its two ends bound it; from there on magnitudes are enough.
        let [at_end, at_start] = [0, reach].map(|u| {
            let product = i64::from(c3).saturating_mul(i64::from(local(u, c3)));
            i64::from(c2).saturating_add(product >> 32).unsigned_abs()
        });
        let a2 = at_end.max(at_start);
        let a1 = (a2 >> 1).saturating_add(1).saturating_add(u64::from(c1.unsigned_abs()));
        let y = a1.saturating_add(2).saturating_add(u64::from(c0.unsigned_abs()));
        a2 <= LIMIT && a1 <= LIMIT && y <= LIMIT
    }
}

/// The five words of a stored segment.
#[inline]
fn words(bytes: &[u8; SEGMENT_SIZE]) -> [i32; 5] {
    let &[end, c0, c1, c2, c3] = bytes.as_chunks().0 else { return [0; 5] };
    [end, c0, c1, c2, c3].map(i32::from_le_bytes)
}

/// t of the position `u` before the end, by the span that `c3` says.
///
/// Above a position in the span there are only zero bits, so a rotation is the shift, and the
/// machine takes its amount from the low bits of c₃ as they are.
#[inline]
const fn local(u: u32, c3: i32) -> i32 {
    (u.rotate_right(c3.cast_unsigned()) ^ 0x8000_0000).cast_signed()
}

/// ⌊a·b/2³²⌋.
#[inline]
#[allow(clippy::cast_possible_truncation, reason = "the high word of a product of two words")]
fn high(a: i32, b: i32) -> i32 {
    (i64::from(a).wrapping_mul(i64::from(b)) >> 32) as i32
}

/// The value at `p` of the segment of these words.
#[inline]
fn horner([end, c0, c1, c2, c3]: [i32; 5], p: Position) -> Fine {
    let t = local(end.wrapping_sub(p.0).cast_unsigned(), c3);
    let a2 = c2.wrapping_add(high(c3, t));
    let a1 = c1.wrapping_add(high(a2, t));
    Fine(c0.wrapping_add(high(a1, t).wrapping_shl(1)))
}

/// Where a stored segment ends.
#[inline]
fn end_of(bytes: &[u8; SEGMENT_SIZE]) -> i32 {
    let [end, ..] = words(bytes);
    end
}

/// A curve in place: its segments in rising order, and the index that finds one of them.
///
/// `Default` is the empty curve, which is 0 everywhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Curve<'a> {
    segments: &'a [[u8; SEGMENT_SIZE]],
    index: &'a [[u8; 2]],
    /// The first knot.
    first: i32,
    /// Positions from the first knot to the last.
    length: u32,
    /// 2³² divided by the width of a bucket; 0 makes one bucket of everything.
    buckets: u32,
}

impl<'a> Curve<'a> {
    /// The curve over `segments`, the first of which begins at `first`.
    ///
    /// `index` holds, for every bucket of 2^`bucket_shift` positions (1…32) from the first knot to
    /// the last, the number of the segment in which the bucket's first position lies, two bytes,
    /// little-endian. A knot belongs to the segment that it ends. Nothing is checked here: ask
    /// [`Self::is_consistent`] once.
    #[must_use]
    pub fn new(
        first: Position,
        segments: &'a [[u8; SEGMENT_SIZE]],
        index: &'a [[u8; 2]],
        bucket_shift: u8,
    ) -> Self {
        let Some(last) = segments.last().map(end_of) else {
            return Self { index, ..Self::default() };
        };
        let length = last.wrapping_sub(first.0).cast_unsigned();
        let places = 32_u32.saturating_sub(u32::from(bucket_shift));
        let buckets = if places == 0 { 0 } else { 1_u32.checked_shl(places).unwrap_or(1 << 31) };
        Self { segments, index, first: first.0, length, buckets }
    }

    /// Whether there is no segment: 0 everywhere.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.segments.is_empty()
    }

    /// The first knot.
    #[must_use]
    pub const fn first(&self) -> Position {
        Position(self.first)
    }

    /// The segments as they are stored.
    #[must_use]
    pub const fn segments(&self) -> &'a [[u8; SEGMENT_SIZE]] {
        self.segments
    }

    /// The index as it is stored.
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

    /// The value at `p`, and whether `p` lies outside: there the value at the nearer end is held.
    ///
    /// The empty curve is 0 everywhere, with nothing outside. Whatever the bytes, the search ends
    /// after at most [`MAX_KNOTS_IN_BUCKET`] steps; where it leads nowhere, this says 0 and
    /// outside.
    ///
    /// ```
    /// use trueup_core::{curve::{Curve, Segment}, units::{Fine, Position}};
    /// // From 0 to 0.4 mm 8 nm, from there to 1 mm 5 nm.
    /// let segments = [(40_000, 8), (100_000, 5)].map(|(end, nm)| {
    ///     Segment::new(Position(end), 16, [nm * 256, 0, 0, 0]).to_bytes()
    /// });
    /// // Two buckets of 2¹⁶ positions: from 0, in segment 0, and from 65 536, in segment 1.
    /// let curve = Curve::new(Position(0), &segments, &[[0, 0], [1, 0]], 16);
    /// assert!(curve.is_consistent());
    /// let at = |p| (curve.at(Position(p)).0.rounded().0, curve.at(Position(p)).1);
    /// assert_eq!([at(-1), at(0), at(40_000)], [(8, true), (8, false), (8, false)]);
    /// assert_eq!([at(40_001), at(100_000), at(100_001)], [(5, false), (5, false), (5, true)]);
    /// ```
    #[must_use]
    #[inline]
    pub fn at(&self, p: Position) -> (Fine, bool) {
        // One unsigned comparison asks for both ends.
        let from_first = p.0.wrapping_sub(self.first).cast_unsigned();
        if from_first > self.length {
            return self.held(p).map_or((Fine::ZERO, false), |value| (value, true));
        }
        let found = self.inside(p, from_first);
        found.map_or((Fine::ZERO, !self.segments.is_empty()), |value| (value, false))
    }

    /// The value at the end nearer to `p`, unless the curve is empty.
    #[cold]
    #[inline(never)]
    fn held(&self, p: Position) -> Option<Fine> {
        if p.0 < self.first {
            let segment = self.segments.first()?;
            Some(horner(words(segment), Position(self.first)))
        } else {
            let segment = self.segments.last()?;
            Some(horner(words(segment), Position(end_of(segment))))
        }
    }

    /// The value at `p`, which is `from_first` after the first knot.
    #[inline]
    fn inside(&self, p: Position, from_first: u32) -> Option<Fine> {
        let bucket = self.bucket(from_first);
        let mut number = usize::from(u16::from_le_bytes(*self.index.get(bucket)?));
        let mut segment = self.segments.get(number)?;
        for _ in 0..MAX_KNOTS_IN_BUCKET {
            if p.0 <= end_of(segment) {
                break;
            }
            number = number.wrapping_add(1);
            segment = self.segments.get(number)?;
        }
        Some(horner(words(segment), p))
    }

    /// The number of the bucket that a position lies in. A product with a power of two is the
    /// shift, in one instruction whatever the amount.
    #[inline]
    #[allow(clippy::cast_possible_truncation, reason = "the high word of a product of two words")]
    fn bucket(&self, from_first: u32) -> usize {
        (u64::from(from_first).wrapping_mul(u64::from(self.buckets)) >> 32) as usize
    }

    /// Whether the curve is what [`Self::new`] asks for: knots rising, every segment sound, every
    /// entry of the index right, no bucket with too many knots.
    ///
    /// Meant for loading, not for every tick.
    #[must_use]
    pub fn is_consistent(&self) -> bool {
        if self.segments.is_empty() {
            return self.index.is_empty();
        }
        if self.bucket(self.length).checked_add(1) != Some(self.index.len()) {
            return false;
        }
        let mut start = self.first;
        // The knot at its start belongs to the segment before, except at the first.
        let mut before = 0;
        let sound = self.segments.iter().map(Segment::from_bytes).all(|segment| {
            let length = segment.end.0.wrapping_sub(start).cast_unsigned();
            let rising = start < segment.end.0;
            start = segment.end.0;
            rising && segment.is_sound(length.saturating_sub(core::mem::replace(&mut before, 1)))
        });
        sound && self.index_is_right()
    }

    /// Whether every entry names the segment of its bucket's first position, and the steps allowed
    /// from there reach the bucket's last; for rising knots.
    fn index_is_right(&self) -> bool {
        // Whether segment `n` ends before a position, which is counted from the first knot.
        let ends_before = |n: usize, limit: u64| {
            self.segments.get(n).is_some_and(|segment| {
                let end = end_of(segment).wrapping_sub(self.first).cast_unsigned();
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

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;
    use std::vec::Vec;

    const NM: f64 = Fine::PER_NANOMETRE as f64;

    /// A linear congruential generator; its high half.
    fn random(seed: &mut u64) -> u32 {
        *seed =
            seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 32) as u32
    }

    /// From −1 to 1.
    fn signed(seed: &mut u64) -> f64 {
        f64::from(random(seed)) / 2f64.powi(31) - 1.0
    }

    /// A B-spline of order 4 as Bézier pieces, in 1/256 nm.
    struct Spline {
        knots: Vec<i32>,
        pieces: Vec<[f64; 4]>,
    }

    impl Spline {
        /// Random inner knots and control points up to `amplitude`.
        fn random(seed: &mut u64, first: i32, length: u32, count: usize, amplitude: f64) -> Self {
            let inner = |_| first.wrapping_add_unsigned(1 + random(seed) % (length - 1));
            let mut knots: Vec<i32> = (1..count).map(inner).collect();
            knots.extend([first, first.wrapping_add_unsigned(length)]);
            knots.sort_unstable();
            knots.dedup();
            let count = knots.len() - 1;
            // A jagged curve uses the whole amplitude either way in turn.
            let jagged = random(seed).is_multiple_of(4);
            let control: Vec<f64> = (0..count + 3)
                .map(|n| match jagged {
                    true => amplitude * if n % 2 == 0 { 1.0 } else { -1.0 },
                    false => amplitude * signed(seed),
                })
                .collect();
            // The end knots four times.
            let knot = |n: usize| f64::from(knots[n.saturating_sub(3).min(count)]);
            // The blossom of the piece, by de Boor's scheme with its own argument in each round.
            let blossom = |piece: usize, arguments: [f64; 3]| {
                let mut d = [0, 1, 2, 3].map(|j| control[piece + j]);
                for (round, x) in (1..4).zip(arguments) {
                    for j in (round..4).rev() {
                        let (low, high) = (knot(piece + j), knot(piece + j + 4 - round));
                        let w = (x - low) / (high - low);
                        d[j] = (1.0 - w) * d[j - 1] + w * d[j];
                    }
                }
                d[3]
            };
            let pieces = (0..count).map(|n| {
                let (a, b) = (f64::from(knots[n]), f64::from(knots[n + 1]));
                [[a, a, a], [a, a, b], [a, b, b], [b, b, b]].map(|at| blossom(n, at))
            });
            let pieces = pieces.collect();
            Self { knots, pieces }
        }

        /// The value, held outside.
        fn at(&self, p: i32) -> f64 {
            let p = p.clamp(self.knots[0], self.knots[self.pieces.len()]);
            let n = self.knots.partition_point(|knot| *knot < p).clamp(1, self.pieces.len()) - 1;
            let (a, b) = (f64::from(self.knots[n]), f64::from(self.knots[n + 1]));
            let s = (f64::from(p) - a) / (b - a);
            let [b0, b1, b2, b3] = self.pieces[n];
            let r = 1.0 - s;
            r * r * r * b0 + 3.0 * r * r * s * b1 + 3.0 * r * s * s * b2 + s * s * s * b3
        }

        fn segments(&self) -> Vec<Segment> {
            let all = self.knots.windows(2).zip(&self.pieces).enumerate();
            all.map(|(n, (knots, [b0, b1, b2, b3]))| {
                let length = knots[0].abs_diff(knots[1]);
                let reach = if n == 0 { length } else { length - 1 };
                let shift = Segment::shift_for(reach);
                // The place in the piece is s = 1 − r − r·t.
                let r = 2f64.powi(32 - i32::from(shift)) / 2.0 / f64::from(length);
                let (q1, q2) = (3.0 * (b1 - b0), 3.0 * (b2 - 2.0 * b1 + b0));
                let (q3, s) = (b3 - 3.0 * b2 + 3.0 * b1 - b0, 1.0 - r);
                let words = [
                    b0 + s * (q1 + s * (q2 + s * q3)),
                    -r * (q1 + s * (2.0 * q2 + s * 3.0 * q3)),
                    2.0 * r * r * (q2 + 3.0 * s * q3),
                    -4.0 * r * r * r * q3,
                ];
                assert!(words.iter().all(|word| word.abs() <= f64::from(i32::MAX)), "{words:?}");
                let segment =
                    Segment::new(Position(knots[1]), shift, words.map(|word| word.round() as i32));
                assert!(segment.is_sound(reach), "{segment:?} over {reach}");
                segment
            })
            .collect()
        }
    }

    /// The index with the fewest buckets that will do.
    fn index(first: i32, segments: &[Segment]) -> (Vec<[u8; 2]>, u8) {
        let ends: Vec<u32> = segments.iter().map(|s| s.end.0.abs_diff(first)).collect();
        let length = ends[ends.len() - 1];
        for shift in (1..=32_u8).rev() {
            let buckets = (u64::from(length) >> shift) + 1;
            let at = |p: u64| ends.partition_point(|end| u64::from(*end) < p);
            let index: Vec<usize> = (0..buckets).map(|n| at(n << shift)).collect();
            let few = (0..buckets).zip(&index).all(|(n, number)| {
                let last = (((n + 1) << shift) - 1).min(u64::from(length));
                at(last) - number <= MAX_KNOTS_IN_BUCKET
            });
            if few {
                return (index.iter().map(|n| (*n as u16).to_le_bytes()).collect(), shift);
            }
        }
        panic!("knots too close together");
    }

    fn bytes(segments: &[Segment]) -> Vec<[u8; SEGMENT_SIZE]> {
        segments.iter().map(Segment::to_bytes).collect()
    }

    #[test]
    fn every_curve_is_f64_at_its_knots_and_between() {
        let (mut worst, mut gap, mut points, mut entries) = (0.0_f64, 0.0_f64, 0_u64, 0);
        let mut seed = 1;
        for round in 0..600 {
            // 0.1 mm to 20 m, within ±15 m.
            let length = match round {
                0 => 10_000,
                1 => 2_000_000_000,
                _ => (10_000.0 * 200_000f64.powf(signed(&mut seed) / 2.0 + 0.5)) as u32,
            };
            let room = 3_000_000_000 - length;
            let first = (-1_500_000_000_i32).wrapping_add_unsigned(random(&mut seed) % room);
            let count = match round % 3 {
                0 => 1 + random(&mut seed) % 4,
                1 => 1 + random(&mut seed) % 64,
                _ => 512,
            };
            let amplitude = 250_000.0 * NM * if round % 2 == 0 { 1.0 } else { signed(&mut seed) };
            let spline = Spline::random(&mut seed, first, length, count as usize, amplitude);
            let segments = spline.segments();
            let (index, shift) = index(first, &segments);
            entries = entries.max(index.len());
            let stored = bytes(&segments);
            let curve = Curve::new(Position(first), &stored, &index, shift);
            assert!(curve.is_consistent());
            let mut check = |p: i32| {
                let (value, outside) = curve.at(Position(p));
                assert!(!outside, "{p}");
                worst = worst.max((f64::from(value.0) - spline.at(p)).abs() / NM);
                points += 1;
                value
            };
            for knot in &spline.knots[1..spline.knots.len() - 1] {
                let step = check(*knot + 1).0 - check(*knot).0;
                let wanted = spline.at(*knot + 1) - spline.at(*knot);
                gap = gap.max((f64::from(step) - wanted).abs() / NM);
                check(*knot - 1);
            }
            for _ in 0..3_000 {
                check(first.wrapping_add_unsigned(random(&mut seed) % (length + 1)));
            }
            let last = first.wrapping_add_unsigned(length);
            let ends = [first, last].map(&mut check);
            for (p, end) in [first - 1, last + 1, i32::MIN, i32::MAX].iter().zip([0, 1, 0, 1]) {
                assert_eq!(curve.at(Position(*p)), (ends[end], true), "held, and says so");
            }
        }
        std::println!(
            "largest error of a curve: {worst:.4} nm, gap at a knot {gap:.4} nm, {points} points, \
             {entries} buckets at most"
        );
        assert!(points >= 1_000_000 && worst <= 0.1 && gap <= 0.1);
    }

    #[test]
    fn every_spline_up_to_262_micrometres_fits() {
        let mut seed = 2;
        for _ in 0..20_000 {
            let length = 10_000 + random(&mut seed) % 1_000_000;
            // `segments` asserts that each is sound.
            Spline::random(&mut seed, 0, length, 5, 262_000.0 * NM).segments();
        }
    }

    #[test]
    fn a_sound_segment_is_f64_and_so_never_overflows() {
        let (mut worst, mut sound, mut seed) = (0.0_f64, 0, 3);
        for _ in 0..1_000_000 {
            let coefficients =
                [(); 4].map(|()| (random(&mut seed) as i32) >> (random(&mut seed) % 4));
            let reach = random(&mut seed) >> (random(&mut seed) % 32);
            let end = random(&mut seed) as i32;
            let segment = Segment::new(Position(end), Segment::shift_for(reach), coefficients);
            if !segment.is_sound(reach) {
                continue;
            }
            sound += 1;
            for u in [0, 1, reach / 2, reach, random(&mut seed) % reach.max(1)] {
                let t = f64::from(u) * 2f64.powi(i32::from(segment.shift) - 31) - 1.0;
                let [c0, c1, c2, c3] = segment.coefficients.map(f64::from);
                let exact = c0 + t * (c1 + t * (c2 / 2.0 + t * c3 / 4.0));
                let value = segment.at(Position(end.wrapping_sub_unsigned(u)));
                worst = worst.max((f64::from(value.0) - exact).abs());
            }
        }
        std::println!("largest error of {sound} sound segments: {worst:.2} of 1/256 nm");
        assert!(sound > 100_000 && worst <= 4.0);
    }

    #[test]
    fn a_segment_survives_its_bytes() {
        let mut seed = 4;
        for shift in 0..32 {
            let coefficients = [(); 4].map(|()| random(&mut seed) as i32);
            let segment = Segment::new(Position(-7), shift, coefficients);
            assert_eq!(Segment::from_bytes(&segment.to_bytes()), segment);
            assert!(coefficients[3].abs_diff(segment.coefficients[3]) <= 16);
            assert_eq!(segment.coefficients[3] & SPAN_BITS, (32 - i32::from(shift)) % 32);
        }
        for c3 in [i32::MIN, i32::MAX] {
            let [.., kept] = Segment::new(Position(0), 3, [0, 0, 0, c3]).coefficients;
            assert_eq!(kept.signum(), c3.signum(), "it does not wrap");
        }
    }

    #[test]
    fn three_knots_in_a_bucket_are_passed_and_a_fourth_is_refused() {
        let line = |ends: &[i32]| {
            let segment = |(n, end): (i32, &i32)| {
                Segment::new(Position(*end), 16, [n * 256, 0, 0, 0]).to_bytes()
            };
            (0..).zip(ends).map(segment).collect::<Vec<_>>()
        };
        let stored = line(&[10, 20, 30, 1_000]);
        let curve = Curve::new(Position(0), &stored, &[[0, 0]], 32);
        assert!(curve.is_consistent());
        let at = |p| curve.at(Position(p)).0.rounded().0;
        assert_eq!([0, 10, 11, 20, 21, 30, 31, 1_000].map(at), [0, 0, 1, 1, 2, 2, 3, 3]);
        let stored = line(&[10, 20, 30, 40, 1_000]);
        assert!(!Curve::new(Position(0), &stored, &[[0, 0]], 32).is_consistent());
    }

    #[test]
    fn what_is_not_right_is_refused() {
        let mut seed = 5;
        let spline = Spline::random(&mut seed, -50_000_000, 100_000_000, 40, 1e6);
        let segments = spline.segments();
        let first = spline.knots[0];
        let (index, shift) = index(first, &segments);
        let good = |segments: &[Segment], index: &[[u8; 2]], shift| {
            Curve::new(Position(first), &bytes(segments), index, shift).is_consistent()
        };
        assert!(good(&segments, &index, shift));
        assert!(!good(&segments, &index, shift - 1));
        assert!(!good(&segments, &index, 0));
        assert!(!good(&segments, &index[1..], shift));
        assert!(!good(&[], &index, shift));
        assert!(good(&[], &[], shift), "no curve at all");
        assert!(!Curve::new(Position(1 << 30), &bytes(&segments), &index, shift).is_consistent());
        for n in 0..index.len() {
            for change in [1, u16::MAX] {
                let mut wrong = index.clone();
                let number = u16::from_le_bytes(wrong[n]).wrapping_add(change);
                wrong[n] = number.to_le_bytes();
                assert!(!good(&segments, &wrong, shift), "entry {n}");
            }
        }
        for n in 0..segments.len() - 1 {
            let mut wrong = segments.clone();
            wrong[n].end = wrong[n + 1].end;
            assert!(!good(&wrong, &index, shift), "knot {n}");
            let mut wrong = segments.clone();
            wrong[n].shift += 1;
            assert!(!good(&wrong, &index, shift), "span {n}");
            let mut wrong = segments.clone();
            wrong[n].coefficients[0] = i32::MIN;
            assert!(!good(&wrong, &index, shift), "overflow {n}");
        }
    }

    #[test]
    fn no_curve_is_nought_and_nothing_is_outside() {
        for p in [i32::MIN, 0, i32::MAX] {
            assert_eq!(Curve::default().at(Position(p)), (Fine::ZERO, false));
            let none = Curve::new(Position(p), &[], &[[0, 0]], 7);
            assert_eq!(none.at(Position(p)), (Fine::ZERO, false));
        }
    }

    #[test]
    fn an_entry_that_leads_nowhere_is_outside() {
        let stored = [Segment::new(Position(1_000), 16, [256; 4]).to_bytes()];
        for index in [&[][..], &[[1, 0]], &[[0xff, 0xff]]] {
            let curve = Curve::new(Position(0), &stored, index, 32);
            assert_eq!(curve.at(Position(5)), (Fine::ZERO, true));
        }
    }

    #[test]
    fn any_bytes_may_come() {
        let mut seed = 6;
        for _ in 0..20_000 {
            let stored: Vec<[u8; SEGMENT_SIZE]> = (0..random(&mut seed) % 6)
                .map(|_| [(); SEGMENT_SIZE].map(|()| random(&mut seed) as u8))
                .collect();
            let index: Vec<[u8; 2]> = (0..random(&mut seed) % 6)
                .map(|_| {
                    [random(&mut seed) as u8 % 8, u8::from(random(&mut seed).is_multiple_of(8))]
                })
                .collect();
            let (first, shift) = (random(&mut seed) as i32, random(&mut seed) as u8);
            let curve = Curve::new(Position(first), &stored, &index, shift % 40);
            let _ = curve.is_consistent();
            for p in [i32::MIN, -1, 0, 1, i32::MAX, first, random(&mut seed) as i32] {
                let _ = curve.at(Position(p));
            }
            for segment in stored.iter().map(Segment::from_bytes) {
                let _ = (segment.at(Position(i32::MIN)), segment.is_sound(random(&mut seed)));
            }
        }
    }
}
