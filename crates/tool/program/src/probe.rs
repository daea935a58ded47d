//! The steps of a touch probe: each is towards one axis, and nothing is touched but where a touch is meant.

/// A touch: from where the axes stand towards a place behind the surface until the probe closes, and back to where it began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// X, Y or Z: 0, 1, 2.
    pub axis: usize,
    /// How far it looks for the surface, in mm.
    pub to_mm: f64,
    /// In mm/min.
    pub feed_mm_per_min: f64,
    /// Its number among the touches of a [`ProbedPoint`], from 1.
    pub number: usize,
}

/// What touches have found: a row of the run file.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbedPoint {
    /// The round, from 1.
    pub run: u32,
    /// Where X, Y and Z would stand at the place, by its certificate.
    pub at_mm: [f64; 3],
    /// Where A, B and C stand; `None`: not stated.
    pub angle_deg: [Option<f64>; 3],
    /// The length of the stylus.
    pub tool_length_mm: Option<f64>,
    /// The number of the ball or of the point.
    pub point: Option<u32>,
    /// For X, Y and Z: by which touches its place is found.
    pub by: [Option<TouchMean>; 3],
}

/// A place by the mean of one or two touches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchMean {
    /// Numbers of touches; the same twice: one touch.
    pub touches: [usize; 2],
    /// The mean if the machine were right, in mm.
    pub expected_mm: f64,
}
