//! A machine that stands somewhere, in modes that an earlier program left, and the rules for each thing that it is
//! made to do.

use trueup_machine::file::LinearAxis;
use trueup_program::Plan;

use crate::{
    draw::Draw,
    event::{Event, To},
};

/// Limits that a program must keep.
#[derive(Debug)]
pub struct Limits {
    /// For each axis that may move: from where to where, in mm.
    allowed_mm: [Option<[f64; 2]>; 3],
    /// For each tool or vertical axis: which way retracts it.
    retract: [Option<f64>; 3],
    approach: f64,
}

/// Half a micrometre: positions are whole ones.
const ROUNDING_MM: f64 = 0.000_51;

impl Limits {
    /// Returns the rules of a draw, for a program that names these axes.
    pub fn of(draw: &Draw, axes: &[LinearAxis]) -> Self {
        let mut allowed_mm = [None; 3];
        for axis in axes {
            allowed_mm[axis.index()] = Some(draw.allowed_mm(*axis));
        }
        let retract = LinearAxis::ALL.map(|axis| draw.retract(axis));
        Self { allowed_mm, retract, approach: draw.options.approach_mm_per_min }
    }
}

/// The machine.
#[derive(Default)]
struct State {
    /// Where the program knows that an axis stands, in mm.
    at: [Option<f64>; 3],
    has_moved: [bool; 3],
    is_turning: bool,
    first_stop: Option<String>,
    spindle_was_stopped: bool,
    readings: Vec<[Option<f64>; 3]>,
    seen: [Option<[f64; 2]>; 3],
    first_mm: [Option<f64>; 3],
    is_ended: bool,
    /// The highest feed, in mm/min.
    fastest: f64,
}

/// Follows all events. Fails with the first danger.
pub fn walk(events: &[Event], limits: &Limits, plan: &Plan) -> Result<(), String> {
    let mut state = State::default();
    for (n, event) in events.iter().enumerate() {
        state.step(event, limits).map_err(|why| format!("event {n}, {event:?}: {why}"))?;
    }
    state.end(limits, plan)
}

impl State {
    fn step(&mut self, event: &Event, limits: &Limits) -> Result<(), String> {
        if self.is_ended {
            return Err("after the end".into());
        }
        match event {
            Event::Stop(text) if text.trim().is_empty() => return Err("a stop says nothing".into()),
            Event::Stop(text) => {
                self.first_stop.get_or_insert_with(|| text.to_lowercase());
                // The operator may have jogged. A position is only kept for what a message of two parts splits.
                self.at = [None; 3];
            }
            Event::Spindle(rpm) if *rpm == 0.0 => {
                self.spindle_was_stopped = true;
                self.is_turning = false;
            }
            Event::Spindle(rpm) if *rpm > 0.0 && self.first_stop.is_some() => {
                self.is_turning = true
            }
            Event::Spindle(rpm) => return Err(format!("it turns at {rpm} before a stop")),
            Event::Dwell(s) if *s > 0.0 => self.readings.push(self.at),
            Event::Dwell(s) => return Err(format!("a dwell of {s}")),
            Event::End(true) => self.is_ended = true,
            Event::End(false) => return Err("it leaves increments to the next program".into()),
            Event::Go { to, feed, has_modes } => {
                if !has_modes {
                    return Err("it moves in the modes of an earlier program".into());
                }
                self.go(to, *feed, limits)?;
            }
        }
        Ok(())
    }

    fn go(
        &mut self,
        to: &[Option<To>; 3],
        feed: Option<f64>,
        limits: &Limits,
    ) -> Result<(), String> {
        if self.first_stop.is_none() {
            return Err("it moves before a stop".into());
        }
        if !self.spindle_was_stopped || self.is_turning {
            return Err("it moves while the spindle may turn".into());
        }
        let feed = feed.ok_or("it moves at rapid")?;
        if feed.is_nan() || feed <= 0.0 {
            return Err("no feed".into());
        }
        self.fastest = self.fastest.max(feed);
        let is_unknown = |n: usize| to[n].is_some() && self.at[n].is_none();
        if (0..3).any(is_unknown) {
            if to.iter().flatten().count() > 1 {
                return Err("several axes from where nobody knows".into());
            }
            if feed != limits.approach {
                return Err(format!("an approach at {feed}"));
            }
        }
        for (n, to) in to.iter().enumerate() {
            let mm = match (to, self.at[n]) {
                (None, _) => continue,
                (Some(To::Machine(mm)), _) => *mm,
                (Some(To::By(by)), Some(at)) => at + by,
                (Some(To::By(_)), None) => {
                    return Err("an increment from where nobody knows".into());
                }
            };
            let Some([low, high]) = limits.allowed_mm[n] else {
                return Err(format!("axis {n} is not named"));
            };
            if !(low - ROUNDING_MM <= mm && mm <= high + ROUNDING_MM) {
                return Err(format!("axis {n} goes to {mm} mm, and may from {low} to {high}"));
            }
            if !self.has_moved[n] {
                // What retracts comes before what does not.
                let is_guarded = |n: usize| limits.retract[n].is_some();
                let is_late = is_guarded(n) && (0..3).any(|m| self.has_moved[m] && !is_guarded(m));
                if is_late {
                    return Err(format!("axis {n} is retracted after others have moved"));
                }
                self.first_mm[n] = Some(mm);
            }
            self.has_moved[n] = true;
            self.at[n] = Some(mm);
            let [least, most] = self.seen[n].unwrap_or([mm; 2]);
            self.seen[n] = Some([least.min(mm), most.max(mm)]);
        }
        Ok(())
    }

    fn end(&self, limits: &Limits, plan: &Plan) -> Result<(), String> {
        if !self.is_ended || self.is_turning {
            return Err("it does not end, or the spindle turns on".into());
        }
        let said = self.first_stop.as_ref().ok_or("no stop")?;
        if !said.contains("must be clear") {
            return Err(format!("the first stop does not say what must be clear: {said}"));
        }
        if self.fastest > 0.0 && !said.contains(&format!("at up to {} mm/min", self.fastest)) {
            return Err(format!("the first stop does not say how fast: {said}"));
        }
        for n in 0..3 {
            let (Some([least, most]), Some(first)) = (self.seen[n], self.first_mm[n]) else {
                continue;
            };
            let name = ["x", "y", "z"][n];
            let um = |mm: f64| (mm * 1000.0).round() / 1000.0;
            for words in [
                format!("{name} goes to {} mm", um(first)),
                format!(
                    "{name} moves {} mm, from {} to {} mm",
                    um(most - least),
                    um(least),
                    um(most)
                ),
            ] {
                if !said.contains(&words) {
                    return Err(format!("the first stop does not say \"{words}\": {said}"));
                }
            }
            let retracted = match limits.retract[n] {
                Some(way) if way > 0.0 => most,
                Some(_) => least,
                None => continue,
            };
            if (first - retracted).abs() > ROUNDING_MM {
                return Err(format!(
                    "axis {n} begins at {first} mm, retracted it is at {retracted}"
                ));
            }
        }
        self.is_read_where_the_run_file_says(plan)
    }

    /// The readings of the plan are among the dwells, in their order and at their places.
    fn is_read_where_the_run_file_says(&self, plan: &Plan) -> Result<(), String> {
        let mut dwells = self.readings.iter();
        let is_there = |stood: &[Option<f64>; 3], wanted: &[Option<f64>; 3]| {
            let alike = |n: usize| match (stood[n], wanted[n]) {
                (Some(at), Some(mm)) => (at - mm).abs() < 1e-6,
                (_, None) => true,
                (None, Some(_)) => false,
            };
            (0..3).all(alike)
        };
        for reading in plan.readings() {
            if !dwells.any(|stood| is_there(stood, &reading.position_mm)) {
                return Err(format!("it does not stand at {reading:?}"));
            }
        }
        Ok(())
    }
}
