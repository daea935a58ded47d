//! Readings of errors in the volume: where the tool was, in which direction the instrument reads, and which zero it has.

/// Where the axes stood, and with which tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Commanded positions of X, Y and Z.
    pub position_mm: [f64; 3],
    /// Commanded angles of A, B and C.
    pub angle_deg: [f64; 3],
    /// The length of the tool, in the tool direction.
    pub tool_mm: f64,
}

/// The kind of a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ReadingKind {
    /// Components of the error at a ball: two or three of them in a row.
    Ball,
    /// One component: a dial gauge on a straight edge, a laser along an axis.
    Edge,
    /// The error along a body diagonal.
    Diagonal,
    /// The radial error on a circle.
    Circle,
}

impl ReadingKind {
    /// All kinds, in the order of their numbers.
    pub const ALL: [Self; 4] = [Self::Ball, Self::Edge, Self::Diagonal, Self::Circle];

    /// Returns its number.
    #[must_use]
    pub fn index(self) -> usize {
        self as usize
    }

    /// Returns its name in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        ["balls", "one direction", "step diagonals", "circles"][self.index()]
    }
}

/// The place on a circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CirclePosition {
    /// The angle from the first axis of the plane to the second, in rad.
    pub angle: f64,
    /// +1 counter-clockwise, −1 clockwise.
    pub sense: f64,
}

/// The place on a straight edge whose form is not known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePosition {
    /// The number of the edge.
    pub edge: usize,
    /// From 0 at one end of what was read of it to 1 at the other.
    pub share: f64,
}

/// One number that an instrument has shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VolumeReading {
    /// Its kind.
    pub kind: ReadingKind,
    /// Where.
    pub pose: Pose,
    /// The direction of the reading, of length 1 along the machine's X, Y and Z.
    pub toward: [f64; 3],
    /// The reading without what the machine file predicts, in µm.
    pub um: f64,
    /// The reading without what a bridge had applied, in µm.
    pub measured_um: f64,
    /// The number of its zero, from 0, over all files.
    pub setup: usize,
    /// The number of its alignment: that of its zero, but both faces of a square have one alignment.
    pub aligned: usize,
    /// Where on a circle.
    pub on_circle: Option<CirclePosition>,
    /// Where on an edge without a certificate.
    pub on_edge: Option<EdgePosition>,
    /// The number of the point on the artefact, where it is stated.
    pub point: Option<i64>,
    /// The file and the row in it.
    pub source: [usize; 2],
    /// Its column.
    pub column: &'static str,
}

/// Returns the scalar product.
#[must_use]
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns the vector product.
#[must_use]
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
