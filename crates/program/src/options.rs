//! How a measurement is wanted. What is left out is what the papers or ISO 230-2 say.

use trueup_machine::file::LinearAxis;

use crate::refused::Refused;

/// By what is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Gauge {
    /// An indicator at one place: the program stops for it to be set up, and clears it on the way.
    #[default]
    Dial,
    /// A laser interferometer or another gauge along the whole way: nobody sets anything up in between.
    Laser,
}

/// How a measurement is wanted.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// These axes only; empty: all whose travel is known.
    pub axes: Vec<LinearAxis>,
    /// The travel in mm where it is not the machine file's.
    pub travel_mm: [Option<[f64; 2]>; 3],
    /// Each feed is measured in turn, in mm/min; none: 1000, as in the paper.
    pub feeds_mm_per_min: Vec<f64>,
    /// How long the axes stand for a reading, in s.
    pub dwell_s: f64,
    /// How often; `None`: 7 for backlash, 5 for pitch, 3 for straightness and the diagonal, 6 rounds
    /// of heat.
    pub repeats: Option<u32>,
    /// From target to target in mm; `None`: each kind has its own.
    pub step_mm: Option<f64>,
    /// By what backlash is measured.
    pub gauge: Gauge,
    /// The spindle's speed in r/min; `None`: the machine file's `rated_rpm`.
    pub spindle_rpm: Option<f64>,
    /// From reading to reading of a warm-up, in s.
    pub every_s: f64,
    /// How long the spindle warms up, or the axis in each round, in s; `None`: 2 h, and 20 minutes.
    pub heat_s: Option<f64>,
    /// Where an axis is run warm, in mm; `None`: 500 to 1500, as far as the travel has it.
    pub heat_range_mm: Option<[f64; 2]>,
    /// How fast it is run warm, in mm/min.
    pub heat_feed_mm_per_min: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            axes: Vec::new(),
            travel_mm: [None; 3],
            feeds_mm_per_min: Vec::new(),
            dwell_s: 5.0,
            repeats: None,
            step_mm: None,
            gauge: Gauge::Dial,
            spindle_rpm: None,
            every_s: 60.0,
            heat_s: None,
            heat_range_mm: None,
            heat_feed_mm_per_min: 10_000.0,
        }
    }
}

/// The feed of the paper's own program (N10 … F1000), in mm/min.
const FEED_MM_PER_MIN: f64 = 1000.0;

impl Options {
    /// The feeds to measure at, at least one.
    #[must_use]
    pub fn feeds(&self) -> Vec<f64> {
        if self.feeds_mm_per_min.is_empty() {
            vec![FEED_MM_PER_MIN]
        } else {
            self.feeds_mm_per_min.clone()
        }
    }

    /// The feed of what is measured at one alone.
    #[must_use]
    pub fn feed(&self) -> f64 {
        self.feeds()[0]
    }

    pub(crate) fn check(&self) -> Result<(), Refused> {
        let above_zero = [
            ("--dwell-s", Some(self.dwell_s)),
            ("--step-mm", self.step_mm),
            ("--rpm", self.spindle_rpm),
            ("--every-s", Some(self.every_s)),
            ("--heat-s", self.heat_s),
            ("--heat-feed", Some(self.heat_feed_mm_per_min)),
        ];
        let feeds = self.feeds_mm_per_min.iter().map(|feed| ("--feed", Some(*feed)));
        for (name, value) in above_zero.into_iter().chain(feeds) {
            if let Some(value) = value
                && !(value > 0.0 && value.is_finite())
            {
                return Err(Refused(format!("{name} must be above 0, not {value}")));
            }
        }
        if self.repeats == Some(0) {
            return Err(Refused("--repeats must be at least 1".into()));
        }
        if self.every_s <= self.dwell_s {
            return Err(Refused(format!(
                "--every-s {} must be above --dwell-s {}: a reading lasts so long",
                self.every_s, self.dwell_s
            )));
        }
        Ok(())
    }
}
