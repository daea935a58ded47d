//! A measurement as a control is to run it, in no control's words.
//!
//! Positions are machine coordinates in mm. Each measured move is straight or a circle, and at a stated feed; a
//! reading is taken while the axes stand, or where a circle passes.

use crate::{
    arc::ArcMove,
    probe::{ProbedPoint, Touch},
};

/// A step of a plan.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// A line for the reader.
    Note(String),
    /// The control waits for the operator, who reads and does this: a sentence each.
    Stop(Vec<String>),
    /// One axis to a position at the approach feed of the plan: nothing is measured on the way.
    Approach {
        /// X, Y or Z: 0, 1, 2.
        axis: usize,
        /// The end in mm.
        to_mm: f64,
    },
    /// In a straight line at the feed of the measurement.
    Move {
        /// The end in mm; `None`: that axis stays.
        to_mm: [Option<f64>; 3],
        /// Along the line, above 0.
        feed_mm_per_min: f64,
    },
    /// Around a centre at the feed of the measurement, from where the axes have been sent before.
    Arc(ArcMove),
    /// One axis to a position at the approach feed of the plan, with a touch probe: contact on the way ends the program.
    Guarded {
        /// X, Y or Z: 0, 1, 2.
        axis: usize,
        /// The end in mm.
        to_mm: f64,
    },
    /// A touch probe touches.
    Touch(Touch),
    /// A reading by the touches before it. Stands outside of every repeat.
    Found(ProbedPoint),
    /// The spindle turns to the right; 0: it stops. In r/min.
    Spindle(f64),
    /// All stand.
    Dwell(f64),
    /// All stand for this many seconds, and a reading is taken at the end.
    Read(f64),
    /// The steps this many times.
    Repeat {
        /// At least 1.
        times: u32,
        /// Of the outermost repeat: its turns are the numbers of the runs.
        steps: Vec<Step>,
    },
}

/// A reading as the plan takes it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlannedReading {
    /// The turn of the outermost repeat, from 1.
    pub run: u32,
    /// Where the axes stand, in mm; `None`: this program has not sent that axis anywhere.
    pub position_mm: [Option<f64>; 3],
    /// The direction of each axis's last move: 1, −1; 0: none yet.
    pub direction: [i8; 3],
    /// Where A, B and C stand, as the operator has stated; `None`: not stated.
    pub angle_deg: [Option<f64>; 3],
    /// The length of the stylus in mm.
    pub tool_length_mm: Option<f64>,
    /// The number of the ball or of the point that was touched.
    pub point: Option<u32>,
    /// On a circle: 1 counter-clockwise, −1 clockwise; else 0.
    pub sense: i8,
    /// The feed of the last measuring move in mm/min.
    pub feed_mm_per_min: Option<f64>,
    /// The spindle's speed in r/min.
    pub spindle_rpm: f64,
    /// Seconds that the dwells before it last, its own included.
    pub dwelt_s: f64,
}

impl PlannedReading {
    /// Returns the reading that touches have made.
    #[must_use]
    pub(crate) fn from_probed_point(found: &ProbedPoint) -> Self {
        Self {
            run: found.run,
            position_mm: found.at_mm.map(Some),
            angle_deg: found.angle_deg,
            tool_length_mm: found.tool_length_mm,
            point: found.point,
            ..Self::default()
        }
    }
}

/// A column of the run file, by its content.
#[derive(Clone, Debug, PartialEq)]
pub enum Column {
    /// `run`.
    Run,
    /// `time_s`: the dwells so far; only where nothing moves.
    Time,
    /// `x_mm` of an axis.
    Position(usize),
    /// `y_mm` of an axis that the program does not move: where the operator has put it.
    Stands(usize, f64),
    /// `dir_x` of an axis.
    Direction(usize),
    /// `dir`: the direction of a circle.
    Sense,
    /// A column that has this value in each row.
    Constant(&'static str, f64),
    /// `c_deg` of a rotary axis.
    Angle(usize),
    /// `tool_length_mm`.
    ToolLength,
    /// `point`.
    Point,
    /// `feed_mm_per_min`.
    Feed,
    /// `spindle_rpm`.
    Speed,
    /// `spindle_rpm` of the time between the readings, where the spindle stands for each.
    SpeedBetween(f64),
    /// To be filled in.
    Empty(String),
}

/// A program and its run file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasurementPlan {
    /// The name of both files, without an ending: `backlash-x`.
    pub name: String,
    /// Notes for the operator before it runs, a sentence each.
    pub notes: Vec<String>,
    /// Precautions of this measurement, a sentence each: part of the first stop.
    pub precautions: Vec<String>,
    /// The feed of each approach, in mm/min.
    pub approach_mm_per_min: f64,
    /// The steps, in order.
    pub steps: Vec<Step>,
    /// The columns of the run file.
    pub columns: Vec<Column>,
    /// The commands that read the filled file, one each, without the machine file and where to write.
    pub then: Vec<String>,
    /// X of the program is written as a diameter; every length of the plan is a radius.
    pub is_lathe: bool,
    /// The parts that the run file is recorded in, where it is more than one: `off`, `on`.
    pub records: Vec<&'static str>,
}

impl MeasurementPlan {
    /// Returns the readings in their order.
    #[must_use]
    pub fn readings(&self) -> Vec<PlannedReading> {
        self.simulate().readings
    }

    /// Returns the seconds of moves at their feeds and of dwells, without the way to the first position,
    /// stops and accelerations.
    #[must_use]
    pub fn min_duration_s(&self) -> f64 {
        let walk = self.simulate();
        walk.dwelt_s + walk.moved_s
    }

    /// Returns the lowest and highest position of each axis in mm; `None` where it is not sent anywhere.
    #[must_use]
    pub fn extent_mm(&self) -> [Option<[f64; 2]>; 3] {
        self.simulate().extent_mm
    }

    /// Returns the highest speed of the spindle in r/min; 0 if it never turns.
    #[must_use]
    pub(crate) fn max_rpm(&self) -> f64 {
        self.simulate().max_rpm
    }

    /// Returns the highest feed of a move in mm/min.
    #[must_use]
    pub(crate) fn max_feed_mm_per_min(&self) -> f64 {
        self.simulate().highest_feed_mm_per_min
    }

    fn simulate(&self) -> PlanSimulation {
        let mut walk = PlanSimulation::new(self.approach_mm_per_min);
        walk.execute_steps(&self.steps);
        walk
    }
}

/// The machine on its way through the steps.
struct PlanSimulation {
    now: PlannedReading,
    dwelt_s: f64,
    moved_s: f64,
    is_in_repeat: bool,
    approach_mm_per_min: f64,
    max_rpm: f64,
    highest_feed_mm_per_min: f64,
    extent_mm: [Option<[f64; 2]>; 3],
    readings: Vec<PlannedReading>,
}

impl PlanSimulation {
    fn new(approach_mm_per_min: f64) -> Self {
        let (readings, extent_mm) = (Vec::new(), [None; 3]);
        Self {
            now: PlannedReading { run: 1, ..PlannedReading::default() },
            dwelt_s: 0.0,
            moved_s: 0.0,
            is_in_repeat: false,
            approach_mm_per_min,
            max_rpm: 0.0,
            highest_feed_mm_per_min: approach_mm_per_min,
            extent_mm,
            readings,
        }
    }

    fn execute_steps(&mut self, steps: &[Step]) {
        steps.iter().for_each(|step| self.execute_step(step));
    }

    fn execute_step(&mut self, step: &Step) {
        match step {
            Step::Note(_) | Step::Stop(_) => {}
            Step::Approach { axis, to_mm } | Step::Guarded { axis, to_mm } => {
                let mut to = [None; 3];
                to[*axis] = Some(*to_mm);
                self.moved_s += 60.0 * self.move_to(&to) / self.approach_mm_per_min;
            }
            Step::Move { to_mm, feed_mm_per_min } => {
                let way_mm = self.move_to(to_mm);
                self.now.feed_mm_per_min = Some(*feed_mm_per_min);
                self.highest_feed_mm_per_min = self.highest_feed_mm_per_min.max(*feed_mm_per_min);
                self.moved_s += 60.0 * way_mm / feed_mm_per_min;
            }
            Step::Arc(arc) => self.execute_arc(arc),
            Step::Touch(touch) => self.execute_touch(touch),
            Step::Found(found) => self.readings.push(PlannedReading::from_probed_point(found)),
            Step::Spindle(rpm) => {
                self.now.spindle_rpm = *rpm;
                self.max_rpm = self.max_rpm.max(*rpm);
            }
            Step::Dwell(s) => self.dwelt_s += s,
            Step::Read(s) => {
                self.dwelt_s += s;
                self.readings.push(PlannedReading { dwelt_s: self.dwelt_s, ..self.now });
            }
            Step::Repeat { times, steps } => {
                let is_outermost = !self.is_in_repeat;
                self.is_in_repeat = true;
                for turn in 1..=*times {
                    if is_outermost {
                        self.now.run = turn;
                    }
                    self.execute_steps(steps);
                }
                if is_outermost {
                    self.is_in_repeat = false;
                    self.now.run = 1;
                }
            }
        }
    }

    /// Goes there; the way in mm, as far as it is known.
    fn move_to(&mut self, to_mm: &[Option<f64>; 3]) -> f64 {
        let mut square = 0.0;
        for (axis, to) in to_mm.iter().enumerate() {
            let Some(to) = *to else { continue };
            if let Some(at) = self.now.position_mm[axis] {
                self.update_direction(axis, to - at);
                square += (to - at) * (to - at);
            }
            self.now.position_mm[axis] = Some(to);
            let [low, high] = self.extent_mm[axis].unwrap_or([to; 2]);
            self.extent_mm[axis] = Some([low.min(to), high.max(to)]);
        }
        square.sqrt()
    }

    /// Goes there and back. A plan has sent the axis before.
    fn execute_touch(&mut self, touch: &Touch) {
        let Some(start_mm) = self.now.position_mm[touch.axis] else { return };
        let feed = touch.feed_mm_per_min;
        for mm in [touch.to_mm, start_mm] {
            let mut to = [None; 3];
            to[touch.axis] = Some(mm);
            self.move_to(&to);
        }
        // The surface is half way.
        let way_mm = (touch.to_mm - start_mm).abs() / 2.0;
        self.moved_s += 60.0 * way_mm * (1.0 / feed + 1.0 / self.approach_mm_per_min);
        self.highest_feed_mm_per_min = self.highest_feed_mm_per_min.max(feed);
    }

    /// Goes around, and reads on the way. A plan has sent both axes before.
    fn execute_arc(&mut self, arc: &ArcMove) {
        let [Some(u), Some(v)] = arc.axes.map(|axis| self.now.position_mm[axis]) else { return };
        let start_mm = [u, v];
        let feed = arc.feed_mm_per_min;
        let put = |now: &mut PlannedReading, mm: [f64; 2], way: [i8; 2]| {
            for (n, axis) in arc.axes.into_iter().enumerate() {
                now.position_mm[axis] = Some(mm[n]);
                now.direction[axis] = way[n];
            }
        };
        self.now.feed_mm_per_min = Some(feed);
        self.highest_feed_mm_per_min = self.highest_feed_mm_per_min.max(feed);
        self.moved_s += 60.0 * arc.length_mm(start_mm) / feed;
        let [from, until] = arc.read_deg;
        for deg in from..=until {
            let deg = f64::from(deg);
            let mut reading = PlannedReading { sense: arc.rotation_sign() as i8, ..self.now };
            // Nanometres: more digits of a position are none.
            let at_mm = arc.position_mm(start_mm, deg).map(|mm| (mm * 1e6).round() / 1e6);
            put(&mut reading, at_mm, arc.direction(start_mm, deg));
            self.readings.push(reading);
        }
        let last = arc.turn_deg.abs();
        put(&mut self.now, arc.end_mm(start_mm), arc.direction(start_mm, last));
        for (axis, [low, high]) in arc.axes.into_iter().zip(arc.extent_mm(start_mm)) {
            let [least, most] = self.extent_mm[axis].unwrap_or([low, high]);
            self.extent_mm[axis] = Some([least.min(low), most.max(high)]);
        }
    }

    fn update_direction(&mut self, axis: usize, mm: f64) {
        if mm != 0.0 {
            self.now.direction[axis] = if mm > 0.0 { 1 } else { -1 };
        }
    }
}
