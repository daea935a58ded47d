//! A machine that stands somewhere, in modes that an earlier program left, and the rules for each thing that it is
//! made to do.

use trueup_machine::machine_file::LinearAxis;
use trueup_program::MeasurementPlan;

use crate::{
    draw::Draw,
    event::{Event, Sort, To},
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

/// An arc by ways from its start, in mm.
struct Turn {
    axes: [usize; 2],
    is_ccw: bool,
    end: [f64; 2],
    centre: [f64; 2],
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
    /// The axis and the place from which a probe has touched last.
    touched_from: Option<(usize, f64)>,
    is_probing: bool,
    rows: Vec<Vec<(String, String)>>,
}

/// Follows all events. Fails with the first danger.
pub fn walk(events: &[Event], limits: &Limits, plan: &MeasurementPlan) -> Result<(), String> {
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
                if self.is_probing {
                    self.is_clear(to, limits)?;
                }
                self.go(to, *feed, limits)?;
            }
            Event::Probe { axis, mm, feed, sort, has_modes } => {
                if !has_modes {
                    return Err("it probes in the modes of an earlier program".into());
                }
                self.probe(*axis, *mm, *feed, *sort, limits)?;
            }
            Event::Row(cells) => self.rows.push(cells.clone()),
            Event::Around { axes, is_ccw, end, centre, feed, has_modes } => {
                if !has_modes {
                    return Err("it turns in the modes of an earlier program".into());
                }
                let turn = Turn { axes: *axes, is_ccw: *is_ccw, end: *end, centre: *centre };
                self.around(&turn, *feed, limits)?;
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

    /// A probe goes unguarded where it is retracted, and to where it has begun to touch.
    fn is_clear(&self, to: &[Option<To>; 3], limits: &Limits) -> Result<(), String> {
        for (n, to) in to.iter().enumerate() {
            let Some(To::Machine(mm)) = to else { continue };
            let is_back = self.touched_from == Some((n, *mm));
            // The first place of such an axis is its retracted end.
            let end = self.first_mm[n].filter(|_| limits.retract[n].is_some());
            if !is_back && end.is_none_or(|end| (end - mm).abs() > 0.001) {
                return Err(format!(
                    "axis {n} goes to {mm} mm with a probe, and would not see a contact"
                ));
            }
        }
        Ok(())
    }

    fn probe(
        &mut self,
        axis: usize,
        mm: f64,
        feed: f64,
        sort: Sort,
        limits: &Limits,
    ) -> Result<(), String> {
        self.is_probing = true;
        let from = self.at[axis];
        if sort == Sort::Guarded && feed != limits.approach {
            return Err(format!("a guarded move at {feed}"));
        }
        if sort != Sort::Guarded && feed > 100.0 {
            return Err(format!("it touches at {feed}"));
        }
        if sort == Sort::Touch {
            self.touched_from = Some((axis, from.ok_or("it touches from where nobody knows")?));
        }
        if sort == Sort::Away && self.touched_from != Some((axis, mm)) {
            return Err("it leaves to where it did not come from".into());
        }
        let mut to = [None; 3];
        to[axis] = Some(To::Machine(mm));
        self.go(&to, Some(feed), limits)
    }

    /// Goes around degree by degree, and may be read at each.
    fn around(&mut self, turn: &Turn, feed: Option<f64>, limits: &Limits) -> Result<(), String> {
        let [Some(u), Some(v)] = turn.axes.map(|axis| self.at[axis]) else {
            return Err("a circle from where nobody knows".into());
        };
        let arm = turn.centre.map(|mm| -mm);
        let radius = arm[0].hypot(arm[1]);
        let last = [0, 1].map(|n| turn.end[n] - turn.centre[n]);
        if (last[0].hypot(last[1]) - radius).abs() > 0.002 || radius < 0.5 {
            return Err(format!("no circle: {radius} mm at the start, and at the end {last:?}"));
        }
        let sense = if turn.is_ccw { 1.0 } else { -1.0 };
        let way = sense * (last[1].atan2(last[0]) - arm[1].atan2(arm[0])).to_degrees();
        let way = if turn.end == [0.0; 2] { 360.0 } else { way.rem_euclid(360.0) };
        for degree in 1..=way.round() as u32 {
            let (sin, cos) = (sense * f64::from(degree)).to_radians().sin_cos();
            let off = [arm[0] * cos - arm[1] * sin, arm[0] * sin + arm[1] * cos];
            let mut to = [None; 3];
            for (n, start) in [u, v].into_iter().enumerate() {
                to[turn.axes[n]] = Some(To::Machine(start + turn.centre[n] + off[n]));
            }
            self.go(&to, feed, limits)?;
            self.readings.push(self.at);
        }
        let mut to = [None; 3];
        for (n, start) in [u, v].into_iter().enumerate() {
            to[turn.axes[n]] = Some(To::Machine(start + turn.end[n]));
        }
        self.go(&to, feed, limits)
    }

    fn end(&self, limits: &Limits, plan: &MeasurementPlan) -> Result<(), String> {
        if !self.is_ended || self.is_turning {
            return Err("it does not end, or the spindle turns on".into());
        }
        let stop = self.first_stop.as_ref().ok_or("no stop")?;
        if !stop.contains("must be clear") {
            return Err(format!("the first stop does not say what must be clear: {stop}"));
        }
        if self.fastest > 0.0 && !stop.contains(&format!("at up to {} mm/min", self.fastest)) {
            return Err(format!("the first stop does not say how fast: {stop}"));
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
                    um(um(most) - um(least)),
                    um(least),
                    um(most)
                ),
            ] {
                if !stop.contains(&words) {
                    return Err(format!("the first stop does not say \"{words}\": {stop}"));
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
        self.is_read_at_the_stated_place(plan)
    }

    /// The readings of the plan are among the dwells, in their order and at their places.
    fn is_read_at_the_stated_place(&self, plan: &MeasurementPlan) -> Result<(), String> {
        let mut dwells = self.readings.iter();
        let is_there = |stood: &[Option<f64>; 3], expected: &[Option<f64>; 3]| {
            let alike = |n: usize| match (stood[n], expected[n]) {
                (Some(at), Some(mm)) => (at - mm).abs() < 1e-6 * (1.0 + 1e-3),
                (_, None) => true,
                (None, Some(_)) => false,
            };
            (0..3).all(alike)
        };
        if self.is_probing {
            return self.are_rows_of(plan);
        }
        for reading in plan.readings() {
            if !dwells.any(|stood| is_there(stood, &reading.position_mm)) {
                return Err(format!("it does not stand at {reading:?}"));
            }
        }
        Ok(())
    }

    /// The rows that the control writes are those of the run file, with the measured ones in the empty cells.
    fn are_rows_of(&self, plan: &MeasurementPlan) -> Result<(), String> {
        let text = trueup_program::template::run_file_templates(plan).remove(0).1;
        let mut lines = text.lines().skip_while(|line| line.starts_with('#'));
        let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
        let rows: Vec<&str> = lines.collect();
        if rows.len() != self.rows.len() {
            return Err(format!("{} rows, and it writes {}", rows.len(), self.rows.len()));
        }
        for (row, written) in rows.iter().zip(&self.rows) {
            let mut measured = 0;
            for ((name, cell), (column, value)) in names.iter().zip(row.split(',')).zip(written) {
                let is_measured = cell.is_empty() && value.starts_with("#<cell_");
                measured += usize::from(is_measured);
                if name != column || (cell != value && !is_measured) {
                    return Err(format!("{column}: {value}, and the run file has {name}: {cell}"));
                }
            }
            if measured == 0 {
                return Err(format!("nothing is measured: {written:?}"));
            }
        }
        Ok(())
    }
}
