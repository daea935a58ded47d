//! The limits of every servo cycle, and who has broken them.
//!
//! | | at the joint | as external offset |
//! |---|---|---|
//! | drive's command | planner's limits and those of the offset | the axis' limits |
//! | offset | its own speed and acceleration, size; command and feedback differ by it alone | requests by the slew limit, size |
//! | machine off, and the step to on | the drive's command moves with the offset alone; the offset stands | the drive's command stands |
//!
//! A drive's command beyond its limits is ours, unless the planner alone is beyond its own in the same cycles; as external
//! offset unless we have asked for no more than the slew limit: LinuxCNC itself moves such an offset.

use std::collections::{BTreeMap, VecDeque};

use super::super::{
    CYCLE_S, NOISE, NOISE_OF_ACCELERATION,
    record::{Cycle, Seen},
};

/// A program has an acceleration if it lasts for this number of cycles: a single step is none.
const SUSTAINED: usize = 10;
/// Cycles after which an offset stands once the machine is off: the component runs apart from the servo thread, and the
/// offset brakes.
const STANDS_AFTER: u32 = 100;
/// An offset may be larger than permitted by this, in mm: the scatter of a home switch.
const SIZE_TOLERANCE: f64 = 1e-3;

/// Where offsets enter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Entry {
    Joint,
    Eoffset,
}

/// Limits, in mm and seconds; of two numbers the first is a speed, the second an acceleration.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    pub entry: Entry,
    /// Limits of the planner.
    pub planner: [f64; 2],
    /// Limits of an offset; as external offset the first is also that of requests.
    pub offset: [f64; 2],
    /// Limits of a drive's command.
    pub drive: [f64; 2],
    /// Largest offset of X, Y and Z.
    pub size: [f64; 3],
}

/// A rule that cycles keep or break.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Rule {
    DriveSpeed,
    DriveAcceleration,
    /// The drive's command is the planner's and the offset.
    Sum,
    /// The planner's feedback is the drive's without the offset.
    Feedback,
    OffsetSpeed,
    OffsetAcceleration,
    OffsetSize,
    /// Requests of an external offset are steps of the slew limit.
    Request,
    PlannerSpeed,
    PlannerAcceleration,
    /// A drive that is off, or has just been switched on, gets no step.
    OffStep,
    /// An offset stands while the machine is off.
    Held,
}

/// Whose fault it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum By {
    Trueup,
    LinuxCnc,
}

/// Cycles of an event that broke a rule.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Beyond {
    pub cycles: u64,
    pub largest: f64,
    pub limit: f64,
}

/// Takes cycles and remembers what they broke.
pub(crate) struct Judge {
    bounds: Bounds,
    last: Vec<Cycle>,
    /// Accelerations of the planner in the last cycles.
    accelerations: VecDeque<f64>,
    /// Cycles since the machine is off.
    off: u32,
    /// Number of the last cycle.
    number: Option<u64>,
    /// Cycles that were judged.
    pub cycles: u64,
    /// Cycles that were not recorded.
    pub missing: u64,
    /// The largest of each.
    pub seen: Seen,
    /// The largest offset beyond nothing, in mm.
    pub size: f64,
    /// The largest acceleration of the planner in each event that lasts for [`SUSTAINED`] cycles.
    pub acceleration: BTreeMap<i32, f64>,
    /// Broken rules, by whom, and in which event.
    pub beyond: BTreeMap<(By, Rule, i32), Beyond>,
}

impl Judge {
    pub(crate) fn new(bounds: Bounds) -> Self {
        Self {
            bounds,
            last: Vec::new(),
            accelerations: VecDeque::new(),
            off: 0,
            number: None,
            cycles: 0,
            missing: 0,
            seen: Seen::default(),
            size: 0.0,
            acceleration: BTreeMap::new(),
            beyond: BTreeMap::new(),
        }
    }

    /// Takes the next cycle; `None`: a line that is none.
    pub(crate) fn take(&mut self, cycle: Option<Cycle>) {
        // The next one says by its number how many are missing.
        let Some(mut cycle) = cycle else { return };
        if self.bounds.entry == Entry::Eoffset {
            // Homing gives the place where an axis stands another name; the drive's coordinates stay.
            (0..3).for_each(|axis| cycle.planner[axis] += cycle.reference[axis]);
        }
        let follows = self.number.map_or(cycle.number, |number| number + 1);
        self.missing += cycle.number.saturating_sub(follows);
        if cycle.number != follows {
            self.last.clear();
            self.accelerations.clear();
            self.off = 0;
        }
        self.number = Some(cycle.number);
        self.cycles += 1;
        self.last.push(cycle);
        if let [first, second, third] = self.last[..] {
            self.judge([&first, &second, &third]);
            self.last.remove(0);
        }
    }

    fn judge(&mut self, three: [&Cycle; 3]) {
        let mut now = Seen::default();
        now.add(three);
        let [_, second, third] = three;
        let is_on = three.iter().all(|cycle| cycle.is_on);
        let Bounds { entry, planner, offset, drive, size } = self.bounds;
        let [speed_noise, noise] = [NOISE / CYCLE_S, NOISE_OF_ACCELERATION];
        let planner_is_beyond = now.planner_speed > planner[0] + speed_noise
            || now.planner_acceleration > planner[1] + noise;
        let requested = if entry == Entry::Eoffset { requested_um(second, third) } else { 0.0 };
        let too_large = (0..3).map(|axis| acting(third, axis, entry) - size[axis]);
        let too_large = too_large.fold(f64::NEG_INFINITY, f64::max);
        let blamed = match entry {
            Entry::Joint if planner_is_beyond => By::LinuxCnc,
            Entry::Eoffset if requested <= offset[0] + speed_noise => By::LinuxCnc,
            _ => By::Trueup,
        };
        let mut rules = vec![
            (By::LinuxCnc, Rule::PlannerSpeed, now.planner_speed, planner[0] + speed_noise),
            (By::LinuxCnc, Rule::PlannerAcceleration, now.planner_acceleration, planner[1] + noise),
            (blamed, Rule::DriveSpeed, now.drive_speed, drive[0] + speed_noise),
            (blamed, Rule::DriveAcceleration, now.drive_acceleration, drive[1] + noise),
            (By::Trueup, Rule::OffsetSize, too_large, SIZE_TOLERANCE),
        ];
        match entry {
            Entry::Joint => rules.extend([
                (By::Trueup, Rule::Sum, now.sum, NOISE),
                (By::Trueup, Rule::Feedback, now.feedback, NOISE),
                (By::Trueup, Rule::OffsetSpeed, now.offset_speed, offset[0] + speed_noise),
                (By::Trueup, Rule::OffsetAcceleration, now.offset_acceleration, offset[1] + noise),
            ]),
            Entry::Eoffset => {
                rules.push((By::Trueup, Rule::Request, requested, offset[0] + speed_noise));
                // Machine on sets it to 0 and takes it into the position: the joint stays.
                if is_on {
                    rules.extend([
                        (
                            By::LinuxCnc,
                            Rule::OffsetSpeed,
                            now.offset_speed,
                            offset[0] + speed_noise,
                        ),
                        (
                            By::LinuxCnc,
                            Rule::OffsetAcceleration,
                            now.offset_acceleration,
                            offset[1] + noise,
                        ),
                    ]);
                }
            }
        }
        if !second.is_on {
            rules.push((By::LinuxCnc, Rule::OffStep, off_step(second, third, entry), NOISE));
        }
        self.off = if third.is_on { 0 } else { self.off.saturating_add(1) };
        if self.off > STANDS_AFTER {
            rules.push((By::Trueup, Rule::Held, now.offset_speed, speed_noise));
        }
        for (by, rule, value, limit) in rules {
            if value > limit {
                let beyond = self.beyond.entry((by, rule, third.event)).or_default();
                beyond.cycles += 1;
                beyond.largest = beyond.largest.max(value);
                beyond.limit = limit;
            }
        }
        if entry == Entry::Eoffset && !is_on {
            (now.offset_speed, now.offset_acceleration) = (0.0, 0.0);
        }
        self.seen.take(&now);
        self.size = (0..3).fold(self.size, |most, axis| most.max(acting(third, axis, entry)));
        self.accelerations.push_back(now.planner_acceleration);
        if self.accelerations.len() > SUSTAINED {
            self.accelerations.pop_front();
        }
        if self.accelerations.len() == SUSTAINED {
            let sustained = self.accelerations.iter().copied().fold(f64::INFINITY, f64::min);
            let largest = self.acceleration.entry(third.event).or_default();
            *largest = largest.max(sustained);
        }
    }
}

/// Returns the size of the offset of an axis without the base that homing has left: LinuxCNC's reference contains it.
fn acting(cycle: &Cycle, axis: usize, entry: Entry) -> f64 {
    let base = if entry == Entry::Joint { cycle.reference[axis] } else { 0.0 };
    (cycle.offset[axis] + base).abs()
}

/// Returns by how much a drive's command moves in a cycle without the offset at the joint, in mm.
fn off_step(second: &Cycle, third: &Cycle, entry: Entry) -> f64 {
    let step = |axis: usize| {
        let offset = match entry {
            Entry::Joint => third.offset[axis] - second.offset[axis],
            Entry::Eoffset => 0.0,
        };
        (third.drive[axis] - second.drive[axis] - offset).abs()
    };
    (0..3).map(step).fold(0.0, f64::max)
}

/// Returns how fast a request of an external offset goes away from where the offset stands, in mm/s. LinuxCNC itself sets
/// it back at machine on and at a soft limit, towards the offset.
fn requested_um(second: &Cycle, third: &Cycle) -> f64 {
    let mut largest = 0.0_f64;
    for axis in 0..3 {
        // The request is recorded where the feedback is at the joint.
        let [before, after] = [second.feedback[axis], third.feedback[axis]];
        let stands = third.offset[axis];
        let goes_away = (after - stands).abs() > (before - stands).abs();
        if second.is_on && third.is_on && goes_away {
            largest = largest.max((after - before).abs() / CYCLE_S);
        }
    }
    largest
}

/// Returns by how much each axis is off where it has to be, in µm: the drive's command less the axis' and what the
/// bridge says. Positions are in mm.
pub(crate) fn off_um(drive: [f64; 3], axis: [f64; 3], sent_um: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|index| (drive[index] - axis[index]) * 1e3 - sent_um[index])
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Bounds = Bounds {
        entry: Entry::Joint,
        planner: [30.0, 1_000.0],
        offset: [1.2, 200.0],
        drive: [31.2, 1_200.0],
        size: [0.2, 0.2, 0.5],
    };

    /// Returns the position after each cycle of a move with a trapezoid of speed.
    fn trapezoid(speed: f64, acceleration: f64, cycles: usize) -> Vec<f64> {
        let (mut now, mut position) = (0.0, 0.0);
        let step = acceleration * CYCLE_S;
        let up = (speed / step).round() as usize;
        (0..cycles)
            .map(|cycle| {
                if cycle < up {
                    now += step;
                } else if cycle >= cycles - up {
                    now -= step;
                }
                position += now * CYCLE_S;
                position
            })
            .collect()
    }

    /// Returns a rapid move of X while its offset changes, at the joint; 40 cycles at rest before and after.
    fn series() -> Vec<Cycle> {
        let (planner, offset) = (trapezoid(30.0, 1_000.0, 160), trapezoid(1.2, 200.0, 160));
        let at = |way: &[f64], cycle: usize| match cycle.checked_sub(40) {
            None => 0.0,
            Some(after) => way[after.min(way.len() - 1)],
        };
        let cycles = (0..240).map(|cycle| {
            let [planner, offset] = [at(&planner, cycle), at(&offset, cycle)];
            Cycle {
                number: cycle as u64,
                planner: [planner, 1.0, 2.0],
                drive: [planner + offset, 1.0, 2.0],
                offset: [offset, 0.0, 0.0],
                is_on: true,
                event: 7,
                ..Cycle::default()
            }
        });
        let mut cycles: Vec<Cycle> = cycles.collect();
        for at in 1..cycles.len() {
            let before = cycles[at - 1];
            cycles[at].feedback =
                std::array::from_fn(|axis| before.drive[axis] - before.offset[axis]);
        }
        cycles[0].feedback = [0.0, 1.0, 2.0];
        cycles
    }

    fn judged(bounds: Bounds, cycles: Vec<Cycle>) -> Judge {
        let mut judge = Judge::new(bounds);
        cycles.into_iter().for_each(|cycle| judge.take(Some(cycle)));
        judge
    }

    fn broken(judge: &Judge) -> Vec<(By, Rule)> {
        judge.beyond.keys().map(|(by, rule, _)| (*by, *rule)).collect()
    }

    #[test]
    fn a_sound_move_with_an_offset_breaks_no_rule() {
        let judge = judged(BOUNDS, series());
        assert_eq!((broken(&judge), judge.cycles, judge.missing), (vec![], 240, 0));
        assert!((judge.acceleration[&7] - 1_000.0).abs() < 1e-6, "{:?}", judge.acceleration);
        assert!((judge.seen.drive_acceleration - 1_200.0).abs() < 1e-6, "{:?}", judge.seen);
        assert!(judge.size > 0.1 && judge.size < 0.2, "{}", judge.size);
    }

    #[test]
    fn a_planted_step_of_the_drive_is_found_in_its_event() {
        // 2 um in one cycle, of the drive alone and of the offset with it.
        let mut of_drive = series();
        of_drive[20..].iter_mut().for_each(|cycle| cycle.drive[0] += 2e-3);
        let judge = judged(BOUNDS, of_drive);
        let found = broken(&judge);
        for rule in [Rule::Sum, Rule::DriveAcceleration] {
            assert!(found.contains(&(By::Trueup, rule)), "{found:?}");
        }
        assert!(judge.beyond.keys().all(|(by, _, event)| (*by, *event) == (By::Trueup, 7)));
        let mut of_offset = series();
        for cycle in &mut of_offset[20..] {
            cycle.drive[0] += 2e-3;
            cycle.offset[0] += 2e-3;
        }
        let found = broken(&judged(BOUNDS, of_offset));
        let ours = [Rule::DriveAcceleration, Rule::OffsetSpeed, Rule::OffsetAcceleration];
        assert_eq!(found, ours.map(|rule| (By::Trueup, rule)));
    }

    #[test]
    fn what_the_planner_does_alone_is_linuxcncs_and_nothing_counts_while_it_is_off() {
        let mut jump = series();
        jump[20..].iter_mut().for_each(|cycle| cycle.planner[1] += 5e-3);
        jump[20..].iter_mut().for_each(|cycle| cycle.drive[1] += 5e-3);
        jump[21..].iter_mut().for_each(|cycle| cycle.feedback[1] += 5e-3);
        let found = broken(&judged(BOUNDS, jump.clone()));
        assert!(found.contains(&(By::LinuxCnc, Rule::DriveAcceleration)), "{found:?}");
        assert!(found.iter().all(|(by, _)| *by == By::LinuxCnc), "{found:?}");
        let judge = judged(BOUNDS, jump.clone());
        assert!(judge.seen.planner_acceleration > 4_000.0, "{:?}", judge.seen);
        assert!(judge.acceleration[&7] < 1_001.0, "a step does not last");
        // Off: a step is LinuxCNC's, and none of it counts as a speed.
        jump[18..24].iter_mut().for_each(|cycle| cycle.is_on = false);
        assert_eq!(broken(&judged(BOUNDS, jump)), [(By::LinuxCnc, Rule::OffStep)]);
    }

    #[test]
    fn a_drive_that_is_off_gets_no_step_and_its_offset_stands_soon() {
        // At rest with an offset that moves as slowly as you like, for 150 cycles; on again from cycle 200.
        let off = |moves_until: u64| -> Vec<Cycle> {
            (0..240)
                .map(|number| {
                    let x = 1e-5 * number.min(moves_until) as f64;
                    let (drive, offset) = ([x, 0.0, 0.0], [x, 0.0, 0.0]);
                    let is_on = !(40..200).contains(&number);
                    Cycle { number, drive, offset, is_on, ..Cycle::default() }
                })
                .collect()
        };
        assert_eq!(broken(&judged(BOUNDS, off(100))), Vec::new());
        assert_eq!(broken(&judged(BOUNDS, off(150))), [(By::Trueup, Rule::Held)]);
        let mut on = off(100);
        on[200..].iter_mut().for_each(|cycle| (cycle.drive[1], cycle.planner[1]) = (1e-5, 1e-5));
        on[201..].iter_mut().for_each(|cycle| cycle.feedback[1] = 1e-5);
        assert_eq!(broken(&judged(BOUNDS, on)), [(By::LinuxCnc, Rule::OffStep)]);
    }

    #[test]
    fn an_offset_is_bounded_without_the_base_of_homing() {
        let mut homed = series();
        for cycle in &mut homed {
            cycle.offset[2] += 10.0;
            cycle.drive[2] += 10.0;
            cycle.reference[2] = -9.6;
        }
        assert_eq!(broken(&judged(BOUNDS, homed.clone())), Vec::new());
        homed.iter_mut().for_each(|cycle| cycle.reference[2] = -9.4);
        assert_eq!(broken(&judged(BOUNDS, homed)), [(By::Trueup, Rule::OffsetSize)]);
    }

    #[test]
    fn a_request_of_an_external_offset_beyond_the_slew_limit_is_ours_and_towards_the_offset_linuxcncs()
     {
        let bounds = Bounds { entry: Entry::Eoffset, offset: [0.24, 8.0], ..BOUNDS };
        let steps = |step: f64| -> Vec<Cycle> {
            (0..40)
                .map(|cycle| Cycle {
                    number: cycle,
                    feedback: [0.0, if cycle < 20 { 0.0 } else { step }, 0.0],
                    is_on: true,
                    ..Cycle::default()
                })
                .collect()
        };
        assert_eq!(broken(&judged(bounds, steps(0.24e-3))), Vec::new());
        assert_eq!(broken(&judged(bounds, steps(0.30e-3))), [(By::Trueup, Rule::Request)]);
        let mut back = steps(0.0);
        back[..20].iter_mut().for_each(|cycle| cycle.feedback[1] = 0.1);
        assert_eq!(broken(&judged(bounds, back)), Vec::new());
        // The drive stops at once although nothing was asked for.
        let mut stop = steps(0.0);
        for (at, cycle) in stop.iter_mut().enumerate() {
            cycle.drive[0] = 0.02 * at.min(20) as f64;
        }
        assert_eq!(broken(&judged(bounds, stop)), [(By::LinuxCnc, Rule::DriveAcceleration)]);
    }

    #[test]
    fn homing_gives_the_place_of_an_axis_another_name_and_moves_nothing() {
        let bounds = Bounds { entry: Entry::Eoffset, offset: [0.24, 8.0], ..BOUNDS };
        let homed = |reference: f64| -> Vec<Cycle> {
            let at = |number: u64, x: f64| if number < 20 { [0.0; 3] } else { [x, 0.0, 0.0] };
            let cycle = |number: u64| Cycle {
                number,
                planner: at(number, -0.01),
                reference: at(number, reference),
                is_on: true,
                ..Cycle::default()
            };
            (0..40).map(cycle).collect()
        };
        assert_eq!(broken(&judged(bounds, homed(0.01))), Vec::new());
        let found = broken(&judged(bounds, homed(0.0)));
        assert!(found.contains(&(By::LinuxCnc, Rule::PlannerAcceleration)), "{found:?}");
    }

    #[test]
    fn cycles_that_are_missing_are_counted_and_nothing_is_judged_across_them() {
        let mut cycles = series();
        cycles.drain(60..80);
        let judge = judged(BOUNDS, cycles);
        assert_eq!((broken(&judge), judge.cycles, judge.missing), (vec![], 220, 20));
        let mut judge = Judge::new(BOUNDS);
        for cycle in [None, Some(series()[0]), None, Some(series()[9])] {
            judge.take(cycle);
        }
        assert_eq!((judge.cycles, judge.missing), (2, 8));
    }

    #[test]
    fn an_offset_that_was_lost_is_off() {
        let (axis, sent_um) = ([1.0, 2.0, 3.0], [10.0, -20.0, 40.0]);
        let drive = [1.01, 1.98, 3.04];
        assert!(off_um(drive, axis, sent_um).iter().all(|off| off.abs() < 1e-9));
        let off = off_um([1.01, 2.0, 3.04], axis, sent_um);
        assert!((off[1] - 20.0).abs() < 1e-9, "{off:?}");
    }
}
