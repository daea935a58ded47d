//! Curves for the board: each polynomial piece of a curve as one cubic segment, its knots where the
//! user has them.
//!
//! A segment ends at the knot, rounded to the board's 10 nm, and carries the very polynomial of
//! the piece: a cubic through four points of a cubic is the cubic itself. The only differences are
//! the rounding of the coefficients, and the 5 nm by which a knot may lie next to its polynomial's
//! end, over which the polynomial is simply followed.
//!
//! On the way back each knot stands three times: the Bézier points of a segment's cubic are the
//! control points of such a B-spline. With t₀ at its start and t₁ at its end, and ab + bc + ca the
//! sum over its three arguments' pairs,
//!
//! ```text
//! f(a, b, c) = c₀ + c₁·(a + b + c)/3 + c₂/2·(ab + bc + ca)/3 + c₃/4·abc
//! points: f(t₀, t₀, t₀), f(t₀, t₀, t₁), f(t₀, t₁, t₁), f(t₁, t₁, t₁)
//! ```
//!
//! Two segments share the point at their knot, and get the mean of their two values.

use trueup_core::{
    curve::{Curve, CurveSegment, MAX_KNOTS_IN_BUCKET},
    units::{FineNanometres, Position},
};

use crate::{
    spline::BSpline,
    unit_conversion::{FINE_UNITS_PER_UM, POSITION_UNITS_PER_MM, round_to_i32, to_user_value},
};

/// A curve whose tables are owned.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct OwnedCurve {
    segments: Vec<[u8; trueup_core::curve::CURVE_SEGMENT_SIZE]>,
    index: Vec<[u8; 2]>,
    first: Position,
    bucket_shift: u8,
    /// Largest difference from what it was made of, in nm.
    pub(super) largest_difference_nm: f64,
}

impl OwnedCurve {
    /// No curve.
    pub(super) const EMPTY: Self = Self {
        segments: Vec::new(),
        index: Vec::new(),
        first: Position(0),
        bucket_shift: 32,
        largest_difference_nm: 0.0,
    };

    /// As the board sees it.
    pub(super) fn view(&self) -> Curve<'_> {
        Curve::new(self.first, &self.segments, &self.index, self.bucket_shift)
    }
}

/// One piece of a curve: from `start` to `end` in position units it is `value`, in fine units of a
/// place in position units, and a cubic at most.
pub(super) struct CurvePiece<'f> {
    pub(super) start: i32,
    pub(super) end: i32,
    pub(super) value: Box<dyn Fn(f64) -> f64 + 'f>,
}

/// Why a curve cannot be made: goes on after its name.
pub(super) type ErrorMessage = String;

/// Returns the pieces of a B-spline between its distinct knots.
///
/// # Errors
/// A knot is outside the board's positions, or two are not a position unit apart.
pub(super) fn spline_pieces(spline: &BSpline) -> Result<Vec<CurvePiece<'_>>, ErrorMessage> {
    let BSpline { order, knots_mm, .. } = spline;
    let mut pieces = Vec::new();
    for span in order - 1..knots_mm.len() - order {
        let (low, high) = (knots_mm[span], knots_mm[span + 1]);
        if low == high {
            continue;
        }
        let (start, end) = (mm_to_position_units(low)?, mm_to_position_units(high)?);
        if start >= end {
            return Err(format!("has knots at {low} and {high} mm, closer than the board's 10 nm"));
        }
        let value = move |place: f64| {
            evaluate_span(spline, span, place / POSITION_UNITS_PER_MM) * FINE_UNITS_PER_UM
        };
        pieces.push(CurvePiece { start, end, value: Box::new(value) });
    }
    Ok(pieces)
}

fn mm_to_position_units(mm: f64) -> Result<i32, ErrorMessage> {
    round_to_i32(mm * POSITION_UNITS_PER_MM)
        .ok_or_else(|| format!("reaches {mm} mm, beyond the board's ±21474 mm"))
}

/// Returns the polynomial of one knot span by de Boor's recurrence, also beyond the span's ends.
fn evaluate_span(spline: &BSpline, span: usize, x: f64) -> f64 {
    let degree = spline.order - 1;
    let knots = &spline.knots_mm;
    let mut points: Vec<f64> = spline.control_um[span - degree..=span].to_vec();
    for level in 1..=degree {
        for j in (level..=degree).rev() {
            let left = knots[span - degree + j];
            let right = knots[span + 1 + j - level];
            let share = (x - left) / (right - left);
            points[j] = (1.0 - share) * points[j - 1] + share * points[j];
        }
    }
    points[degree]
}

/// Makes the board's curve of pieces that follow each other.
///
/// # Errors
/// A coefficient does not fit, or the knots lie too irregularly for the index.
pub(super) fn build_curve(pieces: &[CurvePiece<'_>]) -> Result<OwnedCurve, ErrorMessage> {
    let Some(first) = pieces.first() else {
        return Ok(OwnedCurve::EMPTY);
    };
    let mut segments = Vec::new();
    for piece in pieces {
        add_segments(&mut segments, piece, piece.start, piece.end)?;
    }
    let ends: Vec<i64> =
        segments.iter().map(|segment| i64::from(segment.end.0) - i64::from(first.start)).collect();
    let (bucket_shift, index) = build_bucket_index(&ends)?;
    let mut curve = OwnedCurve {
        segments: segments.iter().map(CurveSegment::to_bytes).collect(),
        index,
        first: Position(first.start),
        bucket_shift,
        largest_difference_nm: 0.0,
    };
    curve.largest_difference_nm = max_difference_nm(&curve.view(), pieces);
    Ok(curve)
}

/// The segment of a piece from `start` to `end`; where its coefficients do not fit, those of its
/// halves. The knots stay where they are.
fn add_segments(
    segments: &mut Vec<CurveSegment>,
    piece: &CurvePiece<'_>,
    start: i32,
    end: i32,
) -> Result<(), ErrorMessage> {
    let length = end.abs_diff(start);
    // The knot at its start belongs to the segment before, except at the first.
    let reach = if segments.is_empty() { length } else { length.saturating_sub(1) };
    let shift = CurveSegment::shift_for_reach(reach);
    let dyadic = 2_f64.powi(32 - i32::from(shift));
    // t runs backwards from the end.
    let place = |t: f64| f64::from(end) - (t + 1.0) / 2.0 * dyadic;
    // Four places inside the piece, in the segment's own variable.
    let width = 2.0 * f64::from(length) / dyadic;
    let t: [f64; 4] = std::array::from_fn(|n| -1.0 + width * n as f64 / 3.0);
    let c = interpolating_cubic(t, t.map(|t| (piece.value)(place(t))));
    // A high word halves: what meets it twice is stored twice as large, and so on.
    let stored = [c[0], c[1], c[2] * 2.0, c[3] * 4.0].map(round_to_i32);
    if let [Some(c0), Some(c1), Some(c2), Some(c3)] = stored {
        let segment = CurveSegment::new(Position(end), shift, [c0, c1, c2, c3]);
        if segment.is_valid_for_reach(reach) {
            segments.push(segment);
            return Ok(());
        }
    }
    if length < 2 {
        return Err(format!(
            "is {:.0} µm at {} mm, beyond the board's ±8388 µm",
            (piece.value)(f64::from(start)) / FINE_UNITS_PER_UM,
            f64::from(start) / POSITION_UNITS_PER_MM
        ));
    }
    let middle = start.midpoint(end);
    add_segments(segments, piece, start, middle)?;
    add_segments(segments, piece, middle, end)
}

/// Returns the coefficients, constant first, of the cubic through four points (Newton's divided
/// differences, multiplied out).
fn interpolating_cubic(x: [f64; 4], y: [f64; 4]) -> [f64; 4] {
    let mut d = y;
    for level in 1..4 {
        for n in (level..4).rev() {
            d[n] = (d[n] - d[n - 1]) / (x[n] - x[n - level]);
        }
    }
    let mut c = [d[3], 0.0, 0.0, 0.0];
    for n in (0..3).rev() {
        // c = c·(t − x[n]) + d[n]
        for power in (1..4).rev() {
            c[power] = c[power - 1] - x[n] * c[power];
        }
        c[0] = d[n] - x[n] * c[0];
    }
    c
}

/// Returns the bucket index over ends of segments, counted from the first knot: as few buckets as keep the
/// search short. A bucket names the segment of its first position.
fn build_bucket_index(ends: &[i64]) -> Result<(u8, Vec<[u8; 2]>), ErrorMessage> {
    /// Entries that every curve may have for a segment: 4 bytes.
    const INDEX_BUDGET_PER_SEGMENT: i64 = 2;
    const MAX_INDEX_ENTRIES: i64 = 4_096;
    let length = ends.last().copied().unwrap_or_default();
    let entries = |shift: u8| (length >> shift) + 1;
    let named = |place: i64| ends.partition_point(|&end| end < place);
    // The most steps from a bucket's segment to that of a place in the bucket.
    let steps = |shift: u8| {
        (0..entries(shift))
            .map(|bucket| {
                let last = (((bucket + 1) << shift) - 1).min(length);
                named(last) - named(bucket << shift)
            })
            .max()
            .unwrap_or(0)
    };
    let share = (INDEX_BUDGET_PER_SEGMENT * ends.len() as i64).max(4);
    let shifts = || (1..=32_u8).rev().filter(|&shift| entries(shift) <= MAX_INDEX_ENTRIES);
    let within_share = || shifts().filter(|&shift| entries(shift) <= share);
    let shift = within_share()
        .find(|&shift| steps(shift) <= 1)
        .or_else(|| within_share().next_back().filter(|&shift| steps(shift) <= MAX_KNOTS_IN_BUCKET))
        .or_else(|| shifts().find(|&shift| steps(shift) <= MAX_KNOTS_IN_BUCKET))
        .ok_or_else(|| {
            format!(
                "has more than {MAX_KNOTS_IN_BUCKET} knots within a {MAX_INDEX_ENTRIES}th of its length"
            )
        })?;
    let index = (0..entries(shift)).map(|bucket| {
        let number = u16::try_from(named(bucket << shift));
        number.expect("a curve of 65536 segments is larger than any blob").to_le_bytes()
    });
    Ok((shift, index.collect()))
}

/// At every end of a segment and at places between.
fn max_difference_nm(curve: &Curve<'_>, pieces: &[CurvePiece<'_>]) -> f64 {
    const INTERVALS_PER_PIECE: i64 = 48;
    let mut worst: f64 = 0.0;
    for (number, piece) in pieces.iter().enumerate() {
        let length = i64::from(piece.end) - i64::from(piece.start);
        for n in 0..=INTERVALS_PER_PIECE {
            let place = i64::from(piece.start) + length * n / INTERVALS_PER_PIECE;
            // The knot at a start belongs to the piece before.
            if n == 0 && number > 0 {
                continue;
            }
            let place = i32::try_from(place).expect("between two of i32");
            let board = f64::from(curve.evaluate(Position(place)).0.0);
            let difference = board - (piece.value)(f64::from(place));
            worst = worst.max(difference.abs() / f64::from(FineNanometres::PER_NANOMETRE));
        }
    }
    worst
}

/// Returns the steepest slope of a curve in µm per mm, and where it is in mm.
pub(super) fn steepest_slope(pieces: &[CurvePiece<'_>]) -> (f64, f64) {
    let mut worst = (0.0, 0.0);
    for piece in pieces {
        let (start, end) = (f64::from(piece.start), f64::from(piece.end));
        // The slope of a cubic is a parabola; by differences it is right at the middle of each.
        const INTERVALS_PER_PIECE: u32 = 64;
        let step = (end - start) / f64::from(INTERVALS_PER_PIECE);
        for n in 0..INTERVALS_PER_PIECE {
            let low = start + step * f64::from(n);
            let rise = (piece.value)(low + step) - (piece.value)(low);
            let slope = rise / FINE_UNITS_PER_UM / (step / POSITION_UNITS_PER_MM);
            if slope.abs() > f64::abs(worst.0) {
                worst = (slope, low / POSITION_UNITS_PER_MM);
            }
        }
    }
    worst
}

/// Returns a spline, and its largest difference from the model in nm.
pub(super) fn compile_curve(spline: &BSpline) -> Result<(OwnedCurve, f64), String> {
    let pieces = spline_pieces(spline)?;
    let curve = build_curve(&pieces)?;
    let difference_nm = curve.largest_difference_nm;
    Ok((curve, difference_nm))
}

/// Returns the curve as a user writes it: each knot three times.
pub(super) fn decompile(curve: &Curve<'_>) -> BSpline {
    let mm = |place: i32| to_user_value(place, POSITION_UNITS_PER_MM);
    let mut start = curve.first_knot().0;
    let mut knots_mm = vec![mm(start); 4];
    let mut control: Vec<f64> = Vec::new();
    for bytes in curve.segments() {
        let segment = CurveSegment::from_bytes(bytes);
        let [at_start, inner @ .., at_end] = bezier_points(&segment, start);
        match control.last_mut() {
            Some(shared) => *shared = (*shared + at_start) / 2.0,
            None => control.push(at_start),
        }
        control.extend(inner);
        control.push(at_end);
        start = segment.end.0;
        knots_mm.extend([mm(start); 3]);
    }
    knots_mm.push(mm(start));
    // 1e-8 µm is 1/390 of the board's unit.
    let um = control.iter().map(|fine| (fine / FINE_UNITS_PER_UM * 1e8).round() / 1e8 + 0.0);
    BSpline { order: 4, knots_mm, control_um: um.collect() }
}

/// Returns an angle, stored as its error at the board's lever of `lever_m`, in µrad.
pub(super) fn decompile_angle(curve: &Curve<'_>, lever_m: f64) -> BSpline {
    let mut spline = decompile(curve);
    // As fine as the µm are there.
    let urad = |um: &mut f64| *um = (*um / lever_m * 1e8).round() / 1e8 + 0.0;
    spline.control_um.iter_mut().for_each(urad);
    spline
}

/// Returns the Bézier points of a segment that begins at `start`, in [`FineNanometres`] units.
fn bezier_points(segment: &CurveSegment, start: i32) -> [f64; 4] {
    let [c0, c1, c2, c3] = segment.coefficients.map(f64::from);
    let span = 2_f64.powi(32 - i32::from(segment.shift));
    let at_start = 2.0 * f64::from(segment.end.0.abs_diff(start)) / span - 1.0;
    let at_end = -1.0;
    let polar = |a: f64, b: f64, c: f64| {
        c0 + c1 * (a + b + c) / 3.0
            + c2 / 2.0 * (a * b + b * c + c * a) / 3.0
            + c3 / 4.0 * a * b * c
    };
    [
        polar(at_start, at_start, at_start),
        polar(at_start, at_start, at_end),
        polar(at_start, at_end, at_end),
        polar(at_end, at_end, at_end),
    ]
}
