//! The readings of a circle: their rows, in passes, and the plane.

use std::f64::consts::TAU;

use trueup_machine::machine_file::LinearAxis;
use trueup_numerics::robust;

use super::circular_path::angle_difference_rad;
use crate::report::ExcludedRow;

/// The column with the readings.
pub(crate) const RADIAL_DEVIATION_COLUMN: &str = "measured_dr_um";

/// The plane of a circle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum CirclePlane {
    /// X and Y (G17).
    Xy,
    /// Y and Z (G19).
    Yz,
    /// Z and X (G18).
    Zx,
}

impl CirclePlane {
    /// Returns its axes, the angle counted from the first to the second.
    #[must_use]
    pub fn axes(self) -> [LinearAxis; 2] {
        match self {
            Self::Xy => [LinearAxis::X, LinearAxis::Y],
            Self::Yz => [LinearAxis::Y, LinearAxis::Z],
            Self::Zx => [LinearAxis::Z, LinearAxis::X],
        }
    }

    /// Returns its name: `xy`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Xy => "xy",
            Self::Yz => "yz",
            Self::Zx => "zx",
        }
    }

    /// Returns the plane in which this axis stands still.
    pub(super) fn perpendicular_to(still: LinearAxis) -> Self {
        match still {
            LinearAxis::X => Self::Yz,
            LinearAxis::Y => Self::Zx,
            LinearAxis::Z => Self::Xy,
        }
    }
}

/// A reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircleReading {
    /// The angle of the commanded position, in rad.
    pub angle: f64,
    /// +1 counter-clockwise, −1 clockwise.
    pub sense: f64,
    /// Actual minus nominal radius, without what a bridge applied, in µm.
    pub measured_um: f64,
    /// The same without what the machine file predicts.
    pub um: f64,
    /// The commanded position along both axes.
    pub at_mm: [f64; 2],
    /// Time in s, else the number of the row.
    pub clock: f64,
    /// The feed; NaN where it is not known.
    pub feed_mm_per_min: f64,
    /// The zero of the instrument that it counts from.
    pub setup: usize,
    /// The pass.
    pub pass: usize,
    /// The file and the row in it.
    pub source: [usize; 2],
}

/// The readings of one circle.
#[derive(Clone, Debug)]
pub struct CircleRecord {
    /// The plane.
    pub plane: CirclePlane,
    /// The commanded centre.
    pub centre_mm: [f64; 2],
    /// The commanded radius.
    pub radius_mm: f64,
    /// The readings, in the order of the passes.
    pub rows: Vec<CircleReading>,
    /// Whether the clock is a time.
    pub has_time: bool,
    /// The first and the last clock.
    pub clock: [f64; 2],
    /// The backlash of both axes in the machine file, in µm.
    pub play_um: [f64; 2],
    /// Zeros of the instrument.
    pub setups: usize,
    /// Gross readings, which are not in `rows`.
    pub excluded: Vec<ExcludedRow>,
}

impl CircleRecord {
    /// Returns the share of the time at a row, −½…½.
    #[must_use]
    pub(crate) fn centred_time_fraction(&self, row: &CircleReading) -> f64 {
        let [first, last] = self.clock;
        if last > first { (row.clock - first) / (last - first) - 0.5 } else { 0.0 }
    }

    /// Returns whether there are rows of this direction.
    #[must_use]
    pub(crate) fn has_direction(&self, sense: f64) -> bool {
        self.rows.iter().any(|row| row.sense * sense > 0.0)
    }

    /// Returns the arc that is covered, in rad: the circle without its largest gap.
    #[must_use]
    pub(crate) fn covered_arc_rad(&self) -> f64 {
        let mut angles: Vec<f64> = self.rows.iter().map(|row| row.angle.rem_euclid(TAU)).collect();
        angles.sort_unstable_by(f64::total_cmp);
        let (Some(first), Some(last)) = (angles.first(), angles.last()) else { return 0.0 };
        let around = first + TAU - last;
        let gap = angles.windows(2).map(|pair| pair[1] - pair[0]).fold(around, f64::max);
        // Readings every 10° cover a whole circle.
        if gap < 15.0 / 360.0 * TAU { TAU } else { TAU - gap }
    }

    /// Returns the middle feed, in mm/min: that of the column, else of positions and time.
    #[must_use]
    pub fn median_feed_mm_per_min(&self) -> Option<f64> {
        let mut feeds: Vec<f64> = self
            .rows
            .iter()
            .map(|row| row.feed_mm_per_min)
            .filter(|feed_mm_per_min| *feed_mm_per_min > 0.0)
            .collect();
        if feeds.is_empty() && self.has_time {
            let steps = self.rows.windows(2).filter(|pair| pair[0].pass == pair[1].pass);
            feeds = steps
                .map(|pair| {
                    let way =
                        self.radius_mm * angle_difference_rad(pair[0].angle, pair[1].angle).abs();
                    60.0 * way / (pair[1].clock - pair[0].clock)
                })
                .filter(|feed_mm_per_min| feed_mm_per_min.is_finite() && *feed_mm_per_min > 0.0)
                .collect();
        }
        (!feeds.is_empty()).then(|| robust::median(&mut feeds))
    }

    /// Returns the record without the rows for which `is_out` holds.
    #[must_use]
    pub(crate) fn without_rows(&self, is_out: impl Fn(&CircleReading) -> bool) -> Self {
        let mut rest = self.clone();
        rest.rows.retain(|row| !is_out(row));
        rest
    }
}
