//! The path of the machine, piece by piece.
//!
//! | kind | does | a row |
//! |---|---|---|
//! | `spindle` | the axes stand, the spindle turns at its speed | every `interval_s` |
//! | `move` | all axes go to a point at a feed | every `interval_s` |
//! | `move` with `cycles` | there and back, so often: what runs a screw warm | at the end of a way, not before `interval_s` has passed |
//! | `positions` | one axis goes to equidistant targets, up and down, as ISO 230-2 has it | at each target, after the dwell |
//!
//! A `positions` piece comes to its first target from beyond it, by the overshoot, so that every target
//! has a direction of approach. Its targets may be put off even distances by chance (`spread_mm`),
//! because points on multiples of a pitch do not show a periodic error.

use schemars::JsonSchema;
use serde::Deserialize;

use crate::{
    axes::AxisName,
    noise::RandomStream,
    scenario_error::{RuleViolation, keys},
};

/// The kind of a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SegmentKind {
    /// The axes stand.
    Spindle,
    /// All axes go to a point.
    Move,
    /// One axis goes to targets.
    Positions,
}

/// A piece as a scenario describes it. Keys that another kind uses are refused.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Segment {
    /// The kind of piece.
    pub kind: SegmentKind,
    /// Speed of the spindle in r/min.
    #[serde(default)]
    pub spindle_rpm: f64,
    /// Axial cutting force in N; positive pushes the tool back.
    #[serde(default)]
    pub load_n: f64,
    /// Number of the tool that is taken at its begin, 0: none; without it the tool stays.
    pub tool: Option<u16>,
    /// `spindle`: for how long, in s.
    pub duration_s: Option<f64>,
    /// `move`: to where, X, Y and Z in mm.
    pub to_mm: Option<[f64; 3]>,
    /// `move` and `positions`: how fast, in mm/min.
    pub feed_mm_per_min: Option<f64>,
    /// `positions`: which axis.
    pub axis: Option<AxisName>,
    /// `positions`: the first and the last target, in mm, rising.
    pub range_mm: Option<[f64; 2]>,
    /// `positions`: how many targets, at least 2.
    pub targets: Option<u32>,
    /// `positions`: how often up and down; 1 by default. `move`: how often there and back; without it
    /// there once.
    pub cycles: Option<u32>,
    /// `positions`: how long it stands at a target before the row, in s; 2 by default.
    pub dwell_s: Option<f64>,
    /// `positions`: how far it goes beyond the ends, in mm; 1 by default.
    pub overshoot_mm: Option<f64>,
    /// `positions`: how far a target may be off its even place, in mm; 0 by default.
    pub spread_mm: Option<f64>,
}

impl Segment {
    /// Returns a piece without other statements: still, without load, every key at its default.
    #[must_use]
    pub fn from_kind(kind: SegmentKind) -> Self {
        Self {
            kind,
            spindle_rpm: 0.0,
            load_n: 0.0,
            tool: None,
            duration_s: None,
            to_mm: None,
            feed_mm_per_min: None,
            axis: None,
            range_mm: None,
            targets: None,
            cycles: None,
            dwell_s: None,
            overshoot_mm: None,
            spread_mm: None,
        }
    }

    /// The first rule that is broken.
    pub(crate) fn check(&self) -> Result<(), RuleViolation> {
        use SegmentKind::{Move, Positions, Spindle};
        // A key, whether it is there, whether its kinds need it, its kinds.
        macro_rules! of_kinds {
            ($($key:ident $is_needed:literal $kinds:expr;)*) => {
                [$((stringify!($key), self.$key.is_some(), $is_needed, $kinds)),*]
            };
        }
        let keys: [(&str, bool, bool, &[SegmentKind]); 10] = of_kinds! {
            duration_s true &[Spindle];
            to_mm true &[Move];
            feed_mm_per_min true &[Move, Positions];
            axis true &[Positions];
            range_mm true &[Positions];
            targets true &[Positions];
            cycles false &[Move, Positions];
            dwell_s false &[Positions];
            overshoot_mm false &[Positions];
            spread_mm false &[Positions];
        };
        for (key, is_there, is_needed, kinds) in keys {
            let belongs = kinds.contains(&self.kind);
            if is_there && !belongs {
                return Err(RuleViolation::new(
                    key,
                    format!("does not belong to kind {:?}", self.kind),
                ));
            }
            if !is_there && belongs && is_needed {
                return Err(RuleViolation::new(key, format!("is missing in kind {:?}", self.kind)));
            }
        }
        for (key, value) in keys!(self: duration_s, feed_mm_per_min) {
            if let Some(value) = value.filter(|value| *value <= 0.0) {
                return Err(RuleViolation::new(key, format!("must be above 0, not {value}")));
            }
        }
        for (key, value) in keys!(self: dwell_s, overshoot_mm, spread_mm) {
            RuleViolation::require_non_negative(&[(key, value.unwrap_or(0.0))])?;
        }
        if let Some([first, last]) = self.range_mm.filter(|[first, last]| last <= first) {
            return Err(RuleViolation::new(
                "range_mm",
                format!("must rise, not from {first} to {last}"),
            ));
        }
        if self.cycles == Some(0) {
            return Err(RuleViolation::new("cycles", "must be at least 1, not 0".into()));
        }
        if self.targets.is_some_and(|targets| targets < 2) {
            return Err(RuleViolation::new("targets", "must be at least 2".into()));
        }
        if let (Some([first, last]), Some(targets), Some(spread_mm)) =
            (self.range_mm, self.targets, self.spread_mm)
        {
            let most_mm = (last - first) / f64::from(targets - 1) / 2.0;
            if spread_mm >= most_mm {
                let rule = format!("must be below {most_mm}, else targets change places");
                return Err(RuleViolation::new("spread_mm", rule));
            }
        }
        Ok(())
    }
}

/// A way that is gone at constant speed, or a rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathLeg {
    /// How long it takes in s; may be 0.
    pub seconds: f64,
    /// Where it ends, X, Y and Z in mm.
    pub to_mm: [f64; 3],
    /// Speed of the spindle in r/min.
    pub spindle_rpm: f64,
    /// Axial cutting force in N.
    pub load_n: f64,
    /// Number of the tool in the spindle; 0: none.
    pub tool: u16,
    /// The number of the repeat, from 1, if it ends with a row.
    pub row_of_run: Option<u32>,
}

/// Returns the legs of all `segments`, `repeat` times over, from `start_mm` on.
#[must_use]
pub fn build_legs(
    segments: &[Segment],
    repeat: u32,
    start_mm: [f64; 3],
    interval_s: f64,
    seed: u64,
) -> Vec<PathLeg> {
    let mut path = PathBuilder { legs: Vec::new(), at_mm: start_mm, tool: 0, cycle: 0 };
    for number in 1..=repeat {
        for (index, segment) in segments.iter().enumerate() {
            // The same targets each time: they are what is compared.
            let chance = RandomStream::new(seed, &format!("targets {index}"));
            path.add_segment(segment, number, interval_s, chance);
        }
    }
    path.legs
}

/// From point to point, in mm.
pub(crate) fn distance_mm(from_mm: [f64; 3], to_mm: [f64; 3]) -> f64 {
    from_mm.iter().zip(to_mm).map(|(from, to)| (to - from).powi(2)).sum::<f64>().sqrt()
}

struct PathBuilder {
    legs: Vec<PathLeg>,
    at_mm: [f64; 3],
    tool: u16,
    cycle: u32,
}

impl PathBuilder {
    fn add_segment(
        &mut self,
        segment: &Segment,
        number: u32,
        interval_s: f64,
        mut chance: RandomStream,
    ) {
        let feed_mm_per_s = segment.feed_mm_per_min.unwrap_or(f64::INFINITY) / 60.0;
        self.tool = segment.tool.unwrap_or(self.tool);
        match segment.kind {
            SegmentKind::Spindle => {
                let to_mm = self.at_mm;
                self.append_sampled_move(
                    segment,
                    to_mm,
                    segment.duration_s.unwrap_or(0.0),
                    number,
                    interval_s,
                );
            }
            SegmentKind::Move => {
                let to_mm = segment.to_mm.unwrap_or(self.at_mm);
                let from_mm = self.at_mm;
                let seconds = distance_mm(from_mm, to_mm) / feed_mm_per_s;
                let Some(cycles) = segment.cycles else {
                    self.append_sampled_move(segment, to_mm, seconds, number, interval_s);
                    return;
                };
                let mut since_row_s = 0.0;
                for end_mm in (0..cycles).flat_map(|_| [to_mm, from_mm]) {
                    since_row_s += seconds;
                    let has_row = since_row_s >= interval_s;
                    if has_row {
                        since_row_s = 0.0;
                    }
                    self.push_leg(segment, end_mm, seconds, has_row.then_some(number));
                }
            }
            SegmentKind::Positions => {
                let (Some(axis), Some([first, last]), Some(targets)) =
                    (segment.axis, segment.range_mm, segment.targets)
                else {
                    return;
                };
                let spread_mm = segment.spread_mm.unwrap_or(0.0);
                let step_mm = (last - first) / f64::from(targets - 1);
                let up: Vec<f64> = (0..targets)
                    .map(|i| first + f64::from(i) * step_mm + spread_mm * chance.uniform(-1.0, 1.0))
                    .collect();
                let down: Vec<f64> = up.iter().rev().copied().collect();
                let beyond_mm = spread_mm + segment.overshoot_mm.unwrap_or(1.0);
                for _ in 0..segment.cycles.unwrap_or(1) {
                    self.cycle += 1;
                    for (way, before_mm) in [(&up, first - beyond_mm), (&down, last + beyond_mm)] {
                        self.append_move(segment, axis.index(), before_mm, feed_mm_per_s);
                        for &target_mm in way {
                            self.append_move(segment, axis.index(), target_mm, feed_mm_per_s);
                            let dwell_s = segment.dwell_s.unwrap_or(2.0);
                            self.push_leg(segment, self.at_mm, dwell_s, Some(self.cycle));
                        }
                    }
                }
            }
        }
    }

    fn append_move(&mut self, segment: &Segment, axis: usize, to_mm: f64, feed_mm_per_s: f64) {
        let seconds = (to_mm - self.at_mm[axis]).abs() / feed_mm_per_s;
        let mut to = self.at_mm;
        to[axis] = to_mm;
        self.push_leg(segment, to, seconds, None);
    }

    /// To `to_mm` over `seconds`, with a row every interval; what is left at the end is a last one.
    fn append_sampled_move(
        &mut self,
        segment: &Segment,
        to_mm: [f64; 3],
        seconds: f64,
        number: u32,
        interval_s: f64,
    ) {
        if self.legs.is_empty() {
            self.push_leg(segment, self.at_mm, 0.0, Some(number));
        }
        let from_mm = self.at_mm;
        // A rest that is only rounding is not a row of its own.
        let rows = ((seconds / interval_s) - 1e-9).ceil().max(0.0);
        let mut row = 0.0;
        while row < rows {
            let (before_s, now_s) = (row * interval_s, ((row + 1.0) * interval_s).min(seconds));
            let share = now_s / seconds;
            let now_mm = [0, 1, 2].map(|i| from_mm[i] + (to_mm[i] - from_mm[i]) * share);
            self.push_leg(segment, now_mm, now_s - before_s, Some(number));
            row += 1.0;
        }
        self.at_mm = to_mm;
    }

    fn push_leg(
        &mut self,
        segment: &Segment,
        to_mm: [f64; 3],
        seconds: f64,
        row_of_run: Option<u32>,
    ) {
        let Segment { spindle_rpm, load_n, .. } = *segment;
        let tool = self.tool;
        self.legs.push(PathLeg { seconds, to_mm, spindle_rpm, load_n, tool, row_of_run });
        self.at_mm = to_mm;
    }
}
