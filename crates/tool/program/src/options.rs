//! Options of a measurement. The defaults are those of the papers or of ISO 230-2.

use trueup_machine::machine_file::LinearAxis;

use crate::program_error::ProgramError;

/// By what is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MeasuringInstrument {
    /// An indicator at one place: the program stops for it to be set up, and clears it on the way.
    #[default]
    Dial,
    /// A laser interferometer or another gauge along the whole way: no set-up in between.
    Laser,
}

/// How a measurement is to be made.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasurementOptions {
    /// These axes only; empty: all whose travel is known.
    pub axes: Vec<LinearAxis>,
    /// The range in mm in which an axis may move; `None`: its whole travel. A vertical or tool axis without a
    /// range does not move.
    pub range_mm: [Option<[f64; 2]>; 3],
    /// Another axis that makes room for an indicator, and by how far in mm, with its sign.
    pub clearance_mm: Option<(LinearAxis, f64)>,
    /// The feed of every move before the measurement, in mm/min.
    pub approach_mm_per_min: f64,
    /// How far each axis stays away from the ends of its travel, in mm.
    pub margin_mm: f64,
    /// Each feed is measured in turn, in mm/min; none: 1000, as in the paper.
    pub feeds_mm_per_min: Vec<f64>,
    /// How long the axes stand for a reading, in s.
    pub dwell_s: f64,
    /// The place of what is measured, in mm: the centre of a circle, and where the axis stands that a program does not
    /// move; `None`: a circle is in the middle of the ranges, and no place is stated.
    pub at_mm: [Option<f64>; 3],
    /// The radius of a circle in mm; `None`: the longest usual ball bar that has room.
    pub radius_mm: Option<f64>,
    /// The lengths of the tools or styli in mm, one after the other; none: that of the machine file counts.
    pub tool_lengths_mm: Vec<f64>,
    /// The diameter of the stylus ball of a touch probe, in mm.
    pub stylus_mm: Option<f64>,
    /// How far before a surface a touch begins and how far behind it ends, in mm; `None`: 3.
    pub search_mm: Option<f64>,
    /// The diameter of the balls of an artefact, in mm.
    pub ball_mm: Option<f64>,
    /// The balls of a plate along its first and second axis; `None`: 5 and 5.
    pub balls: Option<[u32; 2]>,
    /// The length of both faces of a square, in mm.
    pub size_mm: Option<f64>,
    /// The angles of A, B and C at which a sphere is touched; none: the axis is not turned.
    pub angles_deg: [Vec<f64>; 3],
    /// How often; `None`: 7 for backlash, 5 for pitch, 3 for straightness and the diagonal, 6 rounds
    /// of heat.
    pub repeats: Option<u32>,
    /// From target to target in mm; `None`: each kind has its own.
    pub step_mm: Option<f64>,
    /// The instrument; `None`: a dial for backlash, a gauge that does not touch for the warm-up.
    pub gauge: Option<MeasuringInstrument>,
    /// The spindle's speed in r/min; `None`: the machine file's `rated_rpm`.
    pub spindle_rpm: Option<f64>,
    /// From reading to reading of a warm-up, in s; `None`: 60, and 600 where the spindle stops for each.
    pub every_s: Option<f64>,
    /// How long the spindle warms up, or the axis in each round, in s; `None`: 2 h, and 20 minutes.
    pub heat_s: Option<f64>,
    /// How fast it is run warm, in mm/min.
    pub heat_feed_mm_per_min: f64,
}

impl Default for MeasurementOptions {
    fn default() -> Self {
        Self {
            axes: Vec::new(),
            range_mm: [None; 3],
            clearance_mm: None,
            approach_mm_per_min: DEFAULT_APPROACH_FEED_MM_PER_MIN,
            margin_mm: DEFAULT_TRAVEL_MARGIN_MM,
            feeds_mm_per_min: Vec::new(),
            dwell_s: 5.0,
            at_mm: [None; 3],
            radius_mm: None,
            tool_lengths_mm: Vec::new(),
            stylus_mm: None,
            search_mm: None,
            ball_mm: None,
            balls: None,
            size_mm: None,
            angles_deg: [const { Vec::new() }; 3],
            repeats: None,
            step_mm: None,
            gauge: None,
            spindle_rpm: None,
            every_s: None,
            heat_s: None,
            heat_feed_mm_per_min: 10_000.0,
        }
    }
}

/// The feed of an approach, in mm/min: the operator has a second for each 8 mm.
pub(crate) const DEFAULT_APPROACH_FEED_MM_PER_MIN: f64 = 500.0;
/// The distance to the ends of travel, in mm: wider than a limit switch repeats.
pub(crate) const DEFAULT_TRAVEL_MARGIN_MM: f64 = 2.0;
/// No number of a measurement is larger; beyond it a control would not read it.
const MAX_OPTION_VALUE: f64 = 1e6;

/// The feed of the paper's own program (N10 … F1000), in mm/min.
const DEFAULT_FEED_MM_PER_MIN: f64 = 1000.0;

impl MeasurementOptions {
    /// Returns the feeds to measure at, at least one.
    #[must_use]
    pub(crate) fn feeds_mm_per_min(&self) -> Vec<f64> {
        if self.feeds_mm_per_min.is_empty() {
            vec![DEFAULT_FEED_MM_PER_MIN]
        } else {
            self.feeds_mm_per_min.clone()
        }
    }

    /// Returns the feed of what is measured at one alone.
    #[must_use]
    pub(crate) fn first_feed_mm_per_min(&self) -> f64 {
        self.feeds_mm_per_min()[0]
    }

    pub(crate) fn check(&self) -> Result<(), ProgramError> {
        let above_zero = [
            ("--dwell-s", Some(self.dwell_s)),
            ("--step-mm", self.step_mm),
            ("--radius", self.radius_mm),
            ("--stylus", self.stylus_mm),
            ("--search", self.search_mm),
            ("--ball", self.ball_mm),
            ("--size", self.size_mm),
            ("--rpm", self.spindle_rpm),
            ("--every-s", self.every_s),
            ("--approach", Some(self.approach_mm_per_min)),
            ("--heat-s", self.heat_s),
            ("--heat-feed", Some(self.heat_feed_mm_per_min)),
        ];
        let feeds = self.feeds_mm_per_min.iter().map(|feed| ("--feed", Some(*feed)));
        let lengths = self.tool_lengths_mm.iter().map(|mm| ("--tool-length", Some(*mm)));
        for (name, value) in above_zero.into_iter().chain(feeds).chain(lengths) {
            if let Some(value) = value
                && !(value > 0.0 && value <= MAX_OPTION_VALUE)
            {
                return Err(ProgramError(format!(
                    "{name} must be above 0 and at most {MAX_OPTION_VALUE}, not {value}"
                )));
            }
        }
        if self.repeats == Some(0) {
            return Err(ProgramError("--repeats must be at least 1".into()));
        }
        if !(0.0..=MAX_OPTION_VALUE).contains(&self.margin_mm) {
            return Err(ProgramError(format!(
                "--margin must be 0 or more, not {}",
                self.margin_mm
            )));
        }
        if let Some((axis, mm)) = self.clearance_mm
            && !(mm != 0.0 && mm.abs() <= MAX_OPTION_VALUE)
        {
            let name = axis.name();
            return Err(ProgramError(format!(
                "--clearance {name}={mm}: must be a way in mm, not 0"
            )));
        }
        if self.angles_deg.iter().flatten().any(|deg| deg.is_nan() || deg.abs() > 360.0) {
            return Err(ProgramError("--angle must be from -360 to 360 degrees".into()));
        }
        let places = self.at_mm.iter().zip(LinearAxis::ALL);
        let mut far = places.filter_map(|(mm, axis)| Some((axis, (*mm)?)));
        if let Some((axis, mm)) = far.find(|(_, mm)| mm.is_nan() || mm.abs() > MAX_OPTION_VALUE) {
            return Err(ProgramError(format!("--at {}={mm}: must be a place in mm", axis.name())));
        }
        self.range_mm.iter().zip(LinearAxis::ALL).try_for_each(|(range, axis)| match *range {
            Some([low, high])
                if !(-MAX_OPTION_VALUE <= low && low < high && high <= MAX_OPTION_VALUE) =>
            {
                Err(ProgramError(format!(
                    "--range {}={low}:{high}: must be like {0}=-120:-20, the smaller first",
                    axis.name()
                )))
            }
            _ => Ok(()),
        })
    }
}
