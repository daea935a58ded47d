//! Every servo cycle as LinuxCNC's own sampler writes it down, and the largest of each figure over some of them.

use std::{
    io::{BufRead as _, BufReader},
    sync::mpsc::{self, Receiver},
    thread,
};

use anyhow::Result;
use trueup_emulator::linuxcnc::headless_linuxcnc::{HeadlessLinuxCnc, SamplerGuard};

use super::CYCLE_S;

/// Pins of the sampler that `own.hal` loads; unconnected ones are 0.
pub(crate) const PINS: usize = 18;

/// One servo cycle, in mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cycle {
    /// Counts cycles; a gap is a cycle that was not recorded.
    pub number: u64,
    /// Command of the planner.
    pub planner: [f64; 3],
    /// Command to the drives.
    pub drive: [f64; 3],
    /// The offsets that act.
    pub offset: [f64; 3],
    /// Position of the drives as the planner sees it.
    pub feedback: [f64; 3],
    /// Offset of X from the bridge, as the component passes it on.
    pub goal: f64,
    /// LinuxCNC's motion is enabled.
    pub is_on: bool,
    /// LinuxCNC's references (`motor-offset`).
    pub reference: [f64; 3],
    /// The event that it belongs to.
    pub event: i32,
}

impl Cycle {
    /// Reads a line of `halsampler -t`.
    fn parse(line: &str) -> Option<Self> {
        let mut words = line.split_whitespace();
        let number = words.next()?.parse().ok()?;
        let words: Vec<f64> = words.filter_map(|word| word.parse().ok()).collect();
        if words.len() != PINS {
            return None;
        }
        let three = |from: usize| [words[from], words[from + 1], words[from + 2]];
        Some(Self {
            number,
            planner: three(0),
            drive: three(3),
            offset: three(6),
            feedback: three(9),
            goal: words[12],
            is_on: words[13] != 0.0,
            reference: three(14),
            event: words[17] as i32,
        })
    }
}

/// Connects the pins of the sampler to these signals, in the order of [`Cycle`], and records from now on. A signal that
/// is not there yet stands with its source: `SIGNAL PIN`. A line that is no cycle is `None`.
pub(crate) fn record(
    cnc: &mut HeadlessLinuxCnc,
    signals: &[impl AsRef<str>],
) -> Result<(SamplerGuard, Receiver<Option<Cycle>>)> {
    for (pin, signal) in signals.iter().enumerate() {
        cnc.run_halcmd(&format!("net {} => sampler.0.pin.{pin}", signal.as_ref()))?;
    }
    let (sampler, lines) = cnc.start_sampler()?;
    let (sender, cycles) = mpsc::channel();
    thread::spawn(move || {
        for line in BufReader::new(lines).lines().map_while(Result::ok) {
            if sender.send(Cycle::parse(&line)).is_err() {
                return;
            }
        }
    });
    Ok((sampler, cycles))
}

/// The largest of each over a stretch of cycles, in mm and seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Seen {
    pub cycles: usize,
    pub sum: f64,
    pub feedback: f64,
    pub offset_speed: f64,
    pub offset_acceleration: f64,
    pub drive_speed: f64,
    pub drive_acceleration: f64,
    pub planner_speed: f64,
    pub planner_acceleration: f64,
    pub offset: f64,
}

impl Seen {
    /// Returns the figures of these cycles.
    pub(crate) fn of(cycles: &[Option<Cycle>]) -> Self {
        let mut seen = Self::default();
        for three in cycles.windows(3) {
            if let [Some(first), Some(second), Some(third)] = three {
                seen.add([first, second, third]);
            }
        }
        seen.cycles = cycles.len();
        seen
    }

    /// Adds three cycles that follow each other.
    pub(crate) fn add(&mut self, [first, second, third]: [&Cycle; 3]) {
        let largest = |place: &mut f64, value: f64| *place = place.max(value.abs());
        let is_on = first.is_on && second.is_on && third.is_on;
        for axis in 0..3 {
            let speed =
                |of: fn(&Cycle) -> &[f64; 3]| (of(third)[axis] - of(second)[axis]) / CYCLE_S;
            let acceleration = |of: fn(&Cycle) -> &[f64; 3]| {
                (of(third)[axis] - 2.0 * of(second)[axis] + of(first)[axis]) / (CYCLE_S * CYCLE_S)
            };
            largest(&mut self.sum, third.drive[axis] - third.planner[axis] - third.offset[axis]);
            largest(
                &mut self.feedback,
                third.feedback[axis] - (second.drive[axis] - second.offset[axis]),
            );
            largest(&mut self.offset_speed, speed(|cycle| &cycle.offset));
            largest(&mut self.offset_acceleration, acceleration(|cycle| &cycle.offset));
            largest(&mut self.offset, third.offset[axis]);
            if is_on {
                largest(&mut self.drive_speed, speed(|cycle| &cycle.drive));
                largest(&mut self.drive_acceleration, acceleration(|cycle| &cycle.drive));
                largest(&mut self.planner_speed, speed(|cycle| &cycle.planner));
                largest(&mut self.planner_acceleration, acceleration(|cycle| &cycle.planner));
            }
        }
        self.cycles += 1;
    }

    /// Takes the larger of both figures each.
    pub(crate) fn take(&mut self, other: &Self) {
        self.cycles += other.cycles;
        for (place, value) in [
            (&mut self.sum, other.sum),
            (&mut self.feedback, other.feedback),
            (&mut self.offset_speed, other.offset_speed),
            (&mut self.offset_acceleration, other.offset_acceleration),
            (&mut self.drive_speed, other.drive_speed),
            (&mut self.drive_acceleration, other.drive_acceleration),
            (&mut self.planner_speed, other.planner_speed),
            (&mut self.planner_acceleration, other.planner_acceleration),
            (&mut self.offset, other.offset),
        ] {
            *place = place.max(value);
        }
    }
}

#[test]
fn a_line_of_the_sampler_is_a_cycle_and_an_overrun_is_none() {
    let line = "7 1 2 3 1.5 2 3 0.5 0 0 1 2 3 0.25 1 0 0 -0.5 12 \n";
    let cycle = Cycle::parse(line).expect("a cycle");
    assert_eq!((cycle.number, cycle.drive, cycle.offset[0]), (7, [1.5, 2.0, 3.0], 0.5));
    assert_eq!((cycle.goal, cycle.is_on, cycle.reference[2], cycle.event), (0.25, true, -0.5, 12));
    for line in ["overrun", "", "8 1 2 3", "x 1 2 3 1.5 2 3 0.5 0 0 1 2 3 0.25 1 0 0 -0.5 12"] {
        assert_eq!(Cycle::parse(line), None, "{line}");
    }
}
