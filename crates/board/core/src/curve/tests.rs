//! Curves and their segments against `f64`, and what bad bytes do.

use super::{segment::SPAN_MASK, *};
use crate::testing::next_random;
extern crate std;
use std::vec::Vec;

const NM: f64 = FineNanometres::PER_NANOMETRE as f64;

/// From −1 to 1.
fn signed(seed: &mut u64) -> f64 {
    f64::from(next_random(seed)) / 2f64.powi(31) - 1.0
}

/// A B-spline of order 4 as Bézier pieces, in 1/256 nm.
struct Spline {
    knots: Vec<i32>,
    pieces: Vec<[f64; 4]>,
}

impl Spline {
    /// Random inner knots and control points up to `amplitude`.
    fn random(seed: &mut u64, first: i32, length: u32, count: usize, amplitude: f64) -> Self {
        let inner = |_| first.wrapping_add_unsigned(1 + next_random(seed) % (length - 1));
        let mut knots: Vec<i32> = (1..count).map(inner).collect();
        knots.extend([first, first.wrapping_add_unsigned(length)]);
        knots.sort_unstable();
        knots.dedup();
        let count = knots.len() - 1;
        // A jagged curve uses the whole amplitude either way in turn.
        let jagged = next_random(seed).is_multiple_of(4);
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

    /// Returns the value, held outside.
    fn at(&self, p: i32) -> f64 {
        let p = p.clamp(self.knots[0], self.knots[self.pieces.len()]);
        let n = self.knots.partition_point(|knot| *knot < p).clamp(1, self.pieces.len()) - 1;
        let (a, b) = (f64::from(self.knots[n]), f64::from(self.knots[n + 1]));
        let s = (f64::from(p) - a) / (b - a);
        let [b0, b1, b2, b3] = self.pieces[n];
        let r = 1.0 - s;
        r * r * r * b0 + 3.0 * r * r * s * b1 + 3.0 * r * s * s * b2 + s * s * s * b3
    }

    fn segments(&self) -> Vec<CurveSegment> {
        let all = self.knots.windows(2).zip(&self.pieces).enumerate();
        all.map(|(n, (knots, [b0, b1, b2, b3]))| {
            let length = knots[0].abs_diff(knots[1]);
            let reach = if n == 0 { length } else { length - 1 };
            let shift = CurveSegment::shift_for_reach(reach);
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
                CurveSegment::new(Position(knots[1]), shift, words.map(|word| word.round() as i32));
            assert!(segment.is_valid_for_reach(reach), "{segment:?} over {reach}");
            segment
        })
        .collect()
    }
}

/// Returns the index with the fewest buckets that will do.
fn index(first: i32, segments: &[CurveSegment]) -> (Vec<[u8; 2]>, u8) {
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

fn bytes(segments: &[CurveSegment]) -> Vec<[u8; CURVE_SEGMENT_SIZE]> {
    segments.iter().map(CurveSegment::to_bytes).collect()
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
        let first = (-1_500_000_000_i32).wrapping_add_unsigned(next_random(&mut seed) % room);
        let count = match round % 3 {
            0 => 1 + next_random(&mut seed) % 4,
            1 => 1 + next_random(&mut seed) % 64,
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
            let (value, outside) = curve.evaluate(Position(p));
            assert!(!outside, "{p}");
            worst = worst.max((f64::from(value.0) - spline.at(p)).abs() / NM);
            points += 1;
            value
        };
        for knot in &spline.knots[1..spline.knots.len() - 1] {
            let step = check(*knot + 1).0 - check(*knot).0;
            let expected = spline.at(*knot + 1) - spline.at(*knot);
            gap = gap.max((f64::from(step) - expected).abs() / NM);
            check(*knot - 1);
        }
        for _ in 0..3_000 {
            check(first.wrapping_add_unsigned(next_random(&mut seed) % (length + 1)));
        }
        let last = first.wrapping_add_unsigned(length);
        let ends = [first, last].map(&mut check);
        for (p, end) in [first - 1, last + 1, i32::MIN, i32::MAX].iter().zip([0, 1, 0, 1]) {
            assert_eq!(curve.evaluate(Position(*p)), (ends[end], true), "held, and says so");
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
        let length = 10_000 + next_random(&mut seed) % 1_000_000;
        // `segments` asserts that each is sound.
        Spline::random(&mut seed, 0, length, 5, 262_000.0 * NM).segments();
    }
}

#[test]
fn a_sound_segment_is_f64_and_so_never_overflows() {
    let (mut worst, mut sound, mut seed) = (0.0_f64, 0, 3);
    for _ in 0..1_000_000 {
        let coefficients =
            [(); 4].map(|()| (next_random(&mut seed) as i32) >> (next_random(&mut seed) % 4));
        let reach = next_random(&mut seed) >> (next_random(&mut seed) % 32);
        let end = next_random(&mut seed) as i32;
        let segment =
            CurveSegment::new(Position(end), CurveSegment::shift_for_reach(reach), coefficients);
        if !segment.is_valid_for_reach(reach) {
            continue;
        }
        sound += 1;
        for u in [0, 1, reach / 2, reach, next_random(&mut seed) % reach.max(1)] {
            let t = f64::from(u) * 2f64.powi(i32::from(segment.shift) - 31) - 1.0;
            let [c0, c1, c2, c3] = segment.coefficients.map(f64::from);
            let exact = c0 + t * (c1 + t * (c2 / 2.0 + t * c3 / 4.0));
            let value = segment.evaluate(Position(end.wrapping_sub_unsigned(u)));
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
        let coefficients = [(); 4].map(|()| next_random(&mut seed) as i32);
        let segment = CurveSegment::new(Position(-7), shift, coefficients);
        assert_eq!(CurveSegment::from_bytes(&segment.to_bytes()), segment);
        assert!(coefficients[3].abs_diff(segment.coefficients[3]) <= 16);
        assert_eq!(segment.coefficients[3] & SPAN_MASK, (32 - i32::from(shift)) % 32);
    }
    for c3 in [i32::MIN, i32::MAX] {
        let [.., retained] = CurveSegment::new(Position(0), 3, [0, 0, 0, c3]).coefficients;
        assert_eq!(retained.signum(), c3.signum(), "it does not wrap");
    }
}

#[test]
fn three_knots_in_a_bucket_are_passed_and_a_fourth_is_refused() {
    let line = |ends: &[i32]| {
        let segment = |(n, end): (i32, &i32)| {
            CurveSegment::new(Position(*end), 16, [n * 256, 0, 0, 0]).to_bytes()
        };
        (0..).zip(ends).map(segment).collect::<Vec<_>>()
    };
    let stored = line(&[10, 20, 30, 1_000]);
    let curve = Curve::new(Position(0), &stored, &[[0, 0]], 32);
    assert!(curve.is_consistent());
    let at = |p| curve.evaluate(Position(p)).0.rounded().0;
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
    let good = |segments: &[CurveSegment], index: &[[u8; 2]], shift| {
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
        assert_eq!(Curve::default().evaluate(Position(p)), (FineNanometres::ZERO, false));
        let none = Curve::new(Position(p), &[], &[[0, 0]], 7);
        assert_eq!(none.evaluate(Position(p)), (FineNanometres::ZERO, false));
    }
}

#[test]
fn an_entry_that_leads_nowhere_is_outside() {
    let stored = [CurveSegment::new(Position(1_000), 16, [256; 4]).to_bytes()];
    for index in [&[][..], &[[1, 0]], &[[0xff, 0xff]]] {
        let curve = Curve::new(Position(0), &stored, index, 32);
        assert_eq!(curve.evaluate(Position(5)), (FineNanometres::ZERO, true));
    }
}

#[test]
fn any_bytes_may_come() {
    let mut seed = 6;
    for _ in 0..20_000 {
        let stored: Vec<[u8; CURVE_SEGMENT_SIZE]> = (0..next_random(&mut seed) % 6)
            .map(|_| [(); CURVE_SEGMENT_SIZE].map(|()| next_random(&mut seed) as u8))
            .collect();
        let index: Vec<[u8; 2]> = (0..next_random(&mut seed) % 6)
            .map(|_| {
                [
                    next_random(&mut seed) as u8 % 8,
                    u8::from(next_random(&mut seed).is_multiple_of(8)),
                ]
            })
            .collect();
        let (first, shift) = (next_random(&mut seed) as i32, next_random(&mut seed) as u8);
        let curve = Curve::new(Position(first), &stored, &index, shift % 40);
        let _ = curve.is_consistent();
        for p in [i32::MIN, -1, 0, 1, i32::MAX, first, next_random(&mut seed) as i32] {
            let _ = curve.evaluate(Position(p));
        }
        for segment in stored.iter().map(CurveSegment::from_bytes) {
            let _ = (
                segment.evaluate(Position(i32::MIN)),
                segment.is_valid_for_reach(next_random(&mut seed)),
            );
        }
    }
}

#[test]
fn a_bucket_that_begins_at_a_knot_names_the_segment_that_ends_there() {
    // Buckets of 2¹⁵: the knot between the segments is the first position of the second.
    let segments =
        [32_768, 65_000].map(|end| CurveSegment::new(Position(end), 16, [0; 4]).to_bytes());
    for (index, is_right) in [([[0, 0], [0, 0]], true), ([[0, 0], [1, 0]], false)] {
        let curve = Curve::new(Position(0), &segments, &index, 15);
        assert_eq!(curve.is_consistent(), is_right, "{index:?}");
    }
}

#[test]
fn a_curve_reports_the_width_of_its_buckets_as_it_was_given() {
    let segments = [CurveSegment::new(Position(100), 16, [0; 4]).to_bytes()];
    for shift in 1..=32 {
        assert_eq!(Curve::new(Position(0), &segments, &[[0, 0]], shift).bucket_shift(), shift);
    }
    assert_eq!(Curve::default().bucket_shift(), 32);
}
