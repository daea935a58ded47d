//! Reduces many points to those that can be seen: a picture has this many places, however many rows a run has.
//!
//! A dot covers a cell. Dots in the same cell are one, and cells on top of each other are one stroke. A line goes
//! up and down within the width of a stroke: of the points in there the first, the lowest, the highest and the
//! last draw the same.

use std::{collections::BTreeMap, fmt::Write as _};

/// A cell that is covered by a dot in its middle, but for its corners.
const CELL_SIZE: f64 = 4.0;
/// So few are drawn where they are.
const MAX_UNREDUCED_POINTS: usize = 400;
/// The width of a stroke.
const STROKE_WIDTH: f64 = 2.0;

/// Returns the path of strokes with round ends of the width of a dot that shows `points`.
pub(crate) fn dots_path(points: &[[f64; 2]]) -> String {
    let mut path = String::new();
    if points.len() <= MAX_UNREDUCED_POINTS {
        for [x, y] in points {
            let _ = write!(path, "M{x:.1} {y:.1}h0");
        }
        return path;
    }
    let cell = |value: f64| (value / CELL_SIZE).floor() as i64;
    let mut columns: BTreeMap<i64, Vec<i64>> = BTreeMap::new();
    for [x, y] in points {
        columns.entry(cell(*x)).or_default().push(cell(*y));
    }
    let middle = |cell: i64| (cell as f64 + 0.5) * CELL_SIZE;
    for (column, mut cells) in columns {
        cells.sort_unstable();
        cells.dedup();
        for stack in cells.chunk_by(|a, b| a + 1 == *b) {
            let height = (stack.len() - 1) as f64 * CELL_SIZE;
            let _ = write!(path, "M{} {}v{height}", middle(column), middle(stack[0]));
        }
    }
    path
}

/// Returns the path of a closed or folded curve through `points`: of many, each that is farther than a stroke from the
/// one before.
pub(crate) fn curve_path(points: &[[f64; 2]]) -> String {
    let mut path = String::new();
    let mut last: Option<[f64; 2]> = None;
    for (at, [x, y]) in points.iter().enumerate() {
        let is_near = last.is_some_and(|[u, v]| (u - x).hypot(v - y) < STROKE_WIDTH);
        if is_near && points.len() > MAX_UNREDUCED_POINTS && at + 1 < points.len() {
            continue;
        }
        let _ = write!(path, "{}{x:.1} {y:.1}", if last.is_none() { 'M' } else { 'L' });
        last = Some([*x, *y]);
    }
    path
}

/// Returns the path of a line through `points`.
pub(crate) fn line_path(points: &[[f64; 2]]) -> String {
    let mut path = String::new();
    let mut add = |[x, y]: [f64; 2]| {
        let _ = write!(path, "{}{x:.1} {y:.1}", if path.is_empty() { 'M' } else { 'L' });
    };
    if points.len() <= MAX_UNREDUCED_POINTS {
        points.iter().copied().for_each(add);
        return path;
    }
    let column = |point: &[f64; 2]| (point[0] / STROKE_WIDTH).floor();
    for within in points.chunk_by(|a, b| column(a) == column(b)) {
        let by_height = |a: &usize, b: &usize| within[*a][1].total_cmp(&within[*b][1]);
        let all = 0..within.len();
        let mut shown = [
            Some(0),
            all.clone().min_by(by_height),
            all.max_by(by_height),
            within.len().checked_sub(1),
        ];
        shown.sort_unstable();
        let mut last = None;
        for place in shown.into_iter().flatten() {
            if last.replace(place) != Some(place) {
                add(within[place]);
            }
        }
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_million_dots_are_as_many_strokes_as_a_picture_has_places_and_the_farthest_is_among_them() {
        let mut points: Vec<[f64; 2]> =
            (0..1_000_000).map(|n| [f64::from(n % 4_000) * 0.1, f64::from(n % 97)]).collect();
        points.push([202.0, 230.0]);
        let path = dots_path(&points);
        assert!(path.len() < 3_000, "{} bytes", path.len());
        assert!(path.contains("M202 230v0"), "{path}");
        assert_eq!(dots_path(&points[..2]), "M0.0 0.0h0M0.1 1.0h0");
    }

    #[test]
    fn a_line_of_a_million_points_keeps_each_peak() {
        let mut points: Vec<[f64; 2]> =
            (0..1_000_000).map(|n| [f64::from(n) * 4e-4, 100.0]).collect();
        points[654_321][1] = 3.0;
        let path = line_path(&points);
        assert!(path.len() < 10_000, "{} bytes", path.len());
        assert!(path.contains("L261.7 3.0"), "{path}");
        assert!(path.starts_with("M0.0 100.0") && path.ends_with("L400.0 100.0"), "{path}");
        assert_eq!(line_path(&points[..2]), "M0.0 100.0L0.0 100.0");
    }
}
