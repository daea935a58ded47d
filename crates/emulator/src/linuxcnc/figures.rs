//! What came of it: the error of the tool tip before and after, in every servo cycle.
//!
//! The tool tip's error is what LinuxCNC's motors were told, plus what the machine makes of that,
//! minus what the program wanted. "Before" is the pass of the path that was cut with the component
//! disabled; in the warm-up, where the machine only stands, and with the rotary axes it is the second
//! machine, which hears the same without the external offset.
//!
//! * Straightness: range (largest minus smallest) of the error across the path, as the paper states
//!   it; a constant is no crookedness.
//! * Staircase: mean error over the last 50 ms of each dwell. Pitch is the range of the means
//!   approached from below, backlash the largest |from above − from below| at a height.
//! * Warm-up: the largest change of the error along the tool since its start.
//! * Five axes: the largest length of the whole error vector, against the growth.
//! * Lag τ: the delay at which the variance of offset(t) + error(t − τ) is least along the diagonal,
//!   error(t) being the uncompensated one. It holds everything between the place where the joint is
//!   and the offset that is applied there. It is taken on Y, which has no backlash that the offset
//!   could cross, and holds for all axes.

use anyhow::{Context as _, Result, bail, ensure};
use serde::Serialize;

use super::{
    COMPRESSION, PASSES, WARM_UP_S, adapter,
    config::{self, OFFSET_AV_RATIO, STAIRS_MM, phase},
    plant::{Account, Cycle},
};

/// What the run has left.
pub struct Run {
    /// All servo cycles.
    pub cycles: Vec<Cycle>,
    /// What the loop has done.
    pub account: Account,
    /// How long the warm-up took on the wall's clock, in s.
    pub warm_up_wall_s: f64,
    /// The component's counters, by their pins.
    pub errors: Vec<(String, f64)>,
    /// The machine file.
    pub machine_file: String,
    /// What the diagnosis has found.
    pub findings: String,
    /// The board's slew limit.
    pub slew_um_per_s: f64,
    /// How long the whole took.
    pub wall_s: f64,
    /// What the board has logged.
    pub log: Vec<String>,
}

/// One claim and what came of it.
#[derive(Clone, Debug, Serialize)]
pub struct Check {
    /// What is claimed, in words.
    pub name: &'static str,
    /// Without compensation, in µm, where there is such a thing.
    pub before_um: Option<f64>,
    /// With it.
    pub after_um: Option<f64>,
    /// The figure that counts: a reduction in percent, a lag in ms, a number of frames.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// What is to be reached.
    pub limit: f64,
    /// Whether the figure must not be below the limit, else not above.
    pub at_least: bool,
}

impl Check {
    fn reduction(name: &'static str, before_um: f64, after_um: f64, limit: f64) -> Self {
        Self {
            name,
            before_um: Some(before_um),
            after_um: Some(after_um),
            value: 100.0 * (1.0 - after_um / before_um),
            unit: "%",
            limit,
            at_least: true,
        }
    }

    fn most(name: &'static str, value: f64, unit: &'static str, limit: f64) -> Self {
        Self { name, before_um: None, after_um: None, value, unit, limit, at_least: false }
    }

    /// Whether it is reached; a figure that is none is not.
    #[must_use]
    pub fn is_met(&self) -> bool {
        if self.at_least { self.value >= self.limit } else { self.value <= self.limit }
    }
}

/// The error across a path, axis by axis.
#[derive(Clone, Debug, Serialize)]
pub struct Across {
    /// Range on X, Y and Z before, in µm.
    pub before_um: [f64; 3],
    /// And after.
    pub after_um: [f64; 3],
}

/// A height of the staircase.
#[derive(Clone, Debug, Serialize)]
pub struct Stair {
    /// Where, in mm.
    pub z_mm: f64,
    /// Error on Z from below and from above, in µm, before.
    pub before_um: [f64; 2],
    /// And after.
    pub after_um: [f64; 2],
}

/// How late the offsets are.
#[derive(Clone, Debug, Serialize)]
pub struct Lag {
    /// Over the whole diagonal, in ms.
    pub mean_ms: f64,
    /// In the worst two seconds of it in which the error changes by more than 10 µm/s.
    pub worst_ms: f64,
    /// The steepest error on Z along the diagonal, in µm/mm.
    pub steepest_um_per_mm: f64,
    /// What the lag costs there at 10 m/min, in µm.
    pub costs_um_at_10_m_per_min: f64,
}

/// What was compressed, and what was not.
#[derive(Clone, Debug, Serialize)]
pub struct Time {
    /// Seconds of board and machine in the warm-up.
    pub warm_up_s: u32,
    /// Seconds of the wall that it took, in which LinuxCNC lived in real time.
    pub warm_up_wall_s: f64,
    /// The factor that was asked for.
    pub compression: u32,
    /// The board's `link_timeout_ms` and `hold_ms` were so many times longer in the warm-up and after
    /// it, because they count its own time.
    pub limits_longer_by: u32,
    /// In the warm-up LinuxCNC got every so manieth pair of offsets.
    pub pairs_passed_one_in: u32,
    /// Milliseconds that the boards lived through.
    pub board_ms: u64,
    /// Milliseconds by which their clock fell behind for good at real time: this computer was too
    /// slow.
    pub slipped_ms: u64,
    /// Seconds that everything took.
    pub wall_s: f64,
}

/// Places and errors for a picture.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Curve {
    /// Place along the path in mm, or time in s, or angle in degrees.
    pub at: Vec<f64>,
    /// The error before, in µm.
    pub before_um: Vec<f64>,
    /// And after.
    pub after_um: Vec<f64>,
}

/// All of it.
#[derive(Clone, Debug, Serialize)]
pub struct Figures {
    /// Always `virtual`: the firmware ran on the emulated board.
    pub board: &'static str,
    /// What is claimed.
    pub checks: Vec<Check>,
    /// Across the diagonal.
    pub diagonal: Across,
    /// Across the arc: radially, and on Z; before and after in µm.
    pub arc_radial_um: [f64; 2],
    /// On Z.
    pub arc_z_um: [f64; 2],
    /// The staircase.
    pub stairs: Vec<Stair>,
    /// How late.
    pub lag: Lag,
    /// Growth at the end of the warm-up, in µm.
    pub growth_um: f64,
    /// How far the second machine's error along the diagonal is from the pass that was really cut
    /// without compensation, at most, in µm.
    pub ignored_against_cut_um: f64,
    /// Time.
    pub time: Time,
    /// The slew limit of board and component, in µm/s.
    pub slew_um_per_s: f64,
    /// LinuxCNC's share for offsets.
    pub offset_av_ratio: f64,
    /// Largest change of an external offset in a servo cycle, in µm.
    pub largest_step_um: f64,
    /// Servo cycles that were looked at, and those that `sampler` lost.
    pub cycles: [u64; 2],
    /// Pairs that LinuxCNC got, frames that the board got.
    pub frames: [u64; 2],
    /// The component's counters at the end, by their pins.
    pub component: Vec<(String, f64)>,
    /// What the diagnosis has found in the measured run.
    pub findings: String,
    /// The machine file that the board ran.
    pub machine_file: String,
    /// For the pictures: along the diagonal on Y and Z, around the arc, over the warm-up, with five
    /// axes.
    #[serde(skip)]
    pub curves: Curves,
}

/// The pictures' data.
#[derive(Clone, Debug, Default)]
pub struct Curves {
    /// Y along the diagonal.
    pub diagonal_y: Curve,
    /// Z along the diagonal.
    pub diagonal_z: Curve,
    /// Z around the arc.
    pub arc_z: Curve,
    /// Z over the warm-up, in hours.
    pub warm_up: Curve,
    /// Length of the error vector with five axes, over seconds.
    pub five_axes: Curve,
}

type Of = fn(&Cycle) -> f64;

impl Figures {
    /// The figures of a run.
    ///
    /// # Errors
    /// A part of the run is missing.
    pub fn of(run: &Run) -> Result<Self> {
        let part = |pass: usize, phase: u32| -> Result<Vec<&Cycle>> {
            let wanted = |cycle: &&Cycle| cycle.pass == PASSES[pass] && cycle.phase == phase;
            let cycles: Vec<&Cycle> = run.cycles.iter().filter(wanted).collect();
            ensure!(cycles.len() > 100, "pass {pass}, phase {phase}: {} cycles", cycles.len());
            Ok(cycles)
        };
        let [before, after] = [part(0, phase::DIAGONAL)?, part(1, phase::DIAGONAL)?];
        let diagonal = Across { before_um: across(&before), after_um: across(&after) };
        let whole = |across: &[f64; 3]| across.iter().map(|um| um * um).sum::<f64>().sqrt();
        let lag = lag(&after)?;
        let [arc_before, arc_after] = [part(0, phase::ARC)?, part(1, phase::ARC)?];
        let stairs = stairs(&part(0, phase::STAIRS)?, &part(1, phase::STAIRS)?)
            .with_context(|| format!("{} cycles are not recorded", run.account.lost_samples))?;
        let pitch = |of: fn(&Stair) -> f64| range(stairs.iter().map(of));
        let backlash = |of: fn(&Stair) -> [f64; 2]| {
            stairs.iter().map(|stair| (of(stair)[1] - of(stair)[0]).abs()).fold(0.0, f64::max)
        };
        let warm_up = part(2, phase::WARM_UP)?;
        let change = |of: Of| {
            let start = of(warm_up[0]);
            warm_up.iter().map(|cycle| (of(cycle) - start).abs()).fold(0.0, f64::max)
        };
        let five = part(2, phase::FIVE_AXES)?;
        let growth_um = five.iter().map(|cycle| cycle.growth_um).fold(f64::INFINITY, f64::min);
        let left_um = five.iter().map(|cycle| length(cycle.with_um)).fold(0.0, f64::max);
        let [on_z, on_z_now]: [Of; 2] = [|cycle| cycle.without_um[2], |cycle| cycle.with_um[2]];
        let damaged: f64 = run
            .errors
            .iter()
            .filter(|(name, _)| ["crc-errors", "malformed", "fault"].contains(&name.as_str()))
            .map(|(_, count)| count)
            .sum();
        let checks = vec![
            Check::reduction(
                "straightness along the diagonal, Z",
                diagonal.before_um[2],
                diagonal.after_um[2],
                95.0,
            ),
            Check::reduction(
                "straightness along the diagonal, X, Y and Z together",
                whole(&diagonal.before_um),
                whole(&diagonal.after_um),
                95.0,
            ),
            Check::reduction(
                "growth in two hours of warm-up",
                change(on_z),
                change(on_z_now),
                97.0,
            ),
            Check::reduction(
                "pitch on the staircase",
                pitch(|stair| stair.before_um[0]),
                pitch(|stair| stair.after_um[0]),
                90.0,
            ),
            Check::reduction(
                "backlash on the staircase",
                backlash(|stair| stair.before_um),
                backlash(|stair| stair.after_um),
                90.0,
            ),
            Check::reduction("growth with five axes in motion", growth_um, left_um, 95.0),
            Check::most("lag of the offsets at the CNC", lag.mean_ms, "ms", 20.0),
            Check::most("damaged frames and faults at the CNC", damaged, "", 0.0),
            Check::most(
                "largest change of an offset in a servo cycle",
                largest_step_um(&run.cycles),
                "um",
                // The slew limit's share of a millisecond, and the rounding of a count.
                run.slew_um_per_s * 1e-3 + 0.01,
            ),
        ];
        let Account { board_ms, slipped_ms, lost_samples, traffic } = run.account;
        Ok(Self {
            board: "virtual",
            checks,
            arc_radial_um: [radial(&arc_before), radial(&arc_after)],
            arc_z_um: [&arc_before, &arc_after]
                .map(|part| range(part.iter().map(|it| it.with_um[2]))),
            stairs,
            growth_um,
            ignored_against_cut_um: ignored_against_cut_um(&before, &after),
            time: Time {
                warm_up_s: WARM_UP_S,
                warm_up_wall_s: run.warm_up_wall_s,
                compression: COMPRESSION,
                limits_longer_by: COMPRESSION,
                pairs_passed_one_in: adapter::COMPRESSED_STRIDE,
                board_ms,
                slipped_ms,
                wall_s: run.wall_s,
            },
            slew_um_per_s: run.slew_um_per_s,
            offset_av_ratio: OFFSET_AV_RATIO,
            largest_step_um: largest_step_um(&run.cycles),
            cycles: [run.cycles.len() as u64, lost_samples],
            frames: [traffic.0, traffic.1],
            component: run.errors.clone(),
            findings: run.findings.clone(),
            machine_file: run.machine_file.clone(),
            curves: Curves {
                diagonal_y: along(&before, &after, |cycle| cycle.commanded_mm()[0], 1),
                diagonal_z: along(&before, &after, |cycle| cycle.commanded_mm()[0], 2),
                arc_z: along(&arc_before, &arc_after, angle_deg, 2),
                warm_up: warm_up_curve(&warm_up),
                five_axes: five_axes_curve(&five),
            },
            diagonal,
            lag,
        })
    }

    /// Fails with every figure that is not reached; else gives how many are.
    ///
    /// # Errors
    /// One is not reached.
    pub fn check(&self) -> Result<u32> {
        let missed: Vec<String> = self
            .checks
            .iter()
            .filter(|check| !check.is_met())
            .map(|check| {
                let than = if check.at_least { "at least" } else { "at most" };
                let Check { name, value, unit, limit, .. } = check;
                format!("{name}: {value:.2} {unit}, wanted {than} {limit} {unit}")
            })
            .collect();
        if !missed.is_empty() {
            bail!("not reached: {}", missed.join("; "));
        }
        u32::try_from(self.checks.len()).context("a handful")
    }

    /// The table for a machinist.
    #[must_use]
    pub fn table(&self) -> String {
        let mut text = String::from(
            "                                                        before      after\n",
        );
        for check in &self.checks {
            let um = |value: Option<f64>| value.map_or(String::new(), |um| format!("{um:.2} um"));
            let mark = if check.is_met() { "" } else { "   NOT REACHED" };
            text += &format!(
                "{:<52} {:>10} {:>10}   {:>7.2} {:<2} ({} {}){mark}\n",
                check.name,
                um(check.before_um),
                um(check.after_um),
                check.value,
                check.unit,
                if check.at_least { "at least" } else { "at most" },
                check.limit,
            );
        }
        let Lag { worst_ms, steepest_um_per_mm, costs_um_at_10_m_per_min, .. } = self.lag;
        text + &format!(
            "\nThe lag is {:.1} ms over the diagonal, {worst_ms:.1} ms in its worst two seconds. Where the \
             error is steepest\n({steepest_um_per_mm:.3} um/mm) it costs {costs_um_at_10_m_per_min:.2} um at \
             10 m/min.\nThe arc: {:.1} -> {:.1} um radially, {:.1} -> {:.1} um on Z.\n\
             Two hours of warm-up took {:.0} s, {:.0} times as fast; the whole took {:.0} s.",
            self.lag.mean_ms,
            self.arc_radial_um[0],
            self.arc_radial_um[1],
            self.arc_z_um[0],
            self.arc_z_um[1],
            self.time.warm_up_wall_s,
            f64::from(self.time.warm_up_s) / self.time.warm_up_wall_s,
            self.time.wall_s,
        )
    }
}

fn range(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    high - low
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|um| um * um).sum::<f64>().sqrt()
}

/// The range of the error across the diagonal, on X, Y and Z.
fn across(cycles: &[&Cycle]) -> [f64; 3] {
    let [x, y, _] = config::TRAVEL_MM;
    let direction = [x / x.hypot(y), y / x.hypot(y), 0.0];
    let across = |cycle: &Cycle| {
        let along: f64 = cycle.with_um.iter().zip(direction).map(|(um, d)| um * d).sum();
        [0, 1, 2].map(|axis| cycle.with_um[axis] - along * direction[axis])
    };
    [0, 1, 2].map(|axis| range(cycles.iter().map(|cycle| across(cycle)[axis])))
}

/// The range of the radial error on the arc.
fn radial(cycles: &[&Cycle]) -> f64 {
    let ([cx, cy], ..) = config::ARC;
    range(cycles.iter().map(|cycle| {
        let [x, y, _] = cycle.commanded_mm();
        let (dx, dy) = (x - cx, y - cy);
        (cycle.with_um[0] * dx + cycle.with_um[1] * dy) / dx.hypot(dy)
    }))
}

fn angle_deg(cycle: &Cycle) -> f64 {
    let ([cx, cy], ..) = config::ARC;
    let [x, y, _] = cycle.commanded_mm();
    (y - cy).atan2(x - cx).to_degrees()
}

/// Where the program dwells: height, whether it came from below, mean error on Z.
fn dwells(cycles: &[&Cycle]) -> Vec<(f64, bool, f64)> {
    const STILL_MM: f64 = 1e-5;
    const DWELL: usize = 150;
    const MEAN: usize = 50;
    let mut dwells = Vec::new();
    let mut before_mm = f64::NEG_INFINITY;
    let height = |cycle: &Cycle| cycle.commanded_mm()[2];
    let same = |one: &&Cycle, other: &&Cycle| (height(one) - height(other)).abs() < STILL_MM;
    for part in cycles.chunk_by(same).filter(|part| part.len() >= DWELL) {
        let tail = &part[part.len() - MEAN..];
        let z_mm = height(part[part.len() - 1]);
        let mean_um = tail.iter().map(|cycle| cycle.with_um[2]).sum::<f64>() / MEAN as f64;
        dwells.push((z_mm, z_mm > before_mm, mean_um));
        before_mm = z_mm;
    }
    dwells
}

fn stairs(before: &[&Cycle], after: &[&Cycle]) -> Result<Vec<Stair>> {
    let both = [dwells(before), dwells(after)];
    let found = |dwells: &[(f64, bool, f64)], z_mm: f64, up: bool| -> Result<f64> {
        let here = |it: &&(f64, bool, f64)| (it.0 - z_mm).abs() < 0.01 && it.1 == up;
        dwells.iter().find(here).map(|it| it.2).with_context(|| format!("no dwell at {z_mm} mm"))
    };
    let at = |z_mm: f64| -> Result<Stair> {
        let pair = |dwells: &[_]| Ok([found(dwells, z_mm, true)?, found(dwells, z_mm, false)?]);
        let (before_um, after_um): (Result<_>, Result<_>) = (pair(&both[0]), pair(&both[1]));
        Ok(Stair { z_mm, before_um: before_um?, after_um: after_um? })
    };
    STAIRS_MM.iter().map(|&z_mm| at(z_mm)).collect()
}

/// The axis on which the lag is taken: Y.
const LAG_AXIS: usize = 1;

/// The delay, in cycles, at which offset and error cancel best; and how many µm/s the error changes
/// by (RMS).
fn delay(cycles: &[&Cycle]) -> Option<(f64, f64)> {
    const MOST: usize = 100;
    let left = |delay: usize| {
        let mut moments = (0.0, 0.0, 0.0);
        for n in MOST..cycles.len() {
            let error_um = cycles[n - delay].without_um[LAG_AXIS];
            let rest = cycles[n].eoffset_mm[LAG_AXIS] * 1e3 + error_um;
            moments = (moments.0 + 1.0, moments.1 + rest, moments.2 + rest * rest);
        }
        let (count, sum, squares) = moments;
        squares / count - (sum / count).powi(2)
    };
    if cycles.len() < 3 * MOST {
        return None;
    }
    let all: Vec<f64> = (0..=MOST).map(left).collect();
    let best = (0..=MOST).min_by(|&one, &other| all[one].total_cmp(&all[other]))?;
    // A parabola through the least and its neighbours.
    let refined = match (best.checked_sub(1).map(|n| all[n]), all.get(best + 1)) {
        (Some(low), Some(&high)) if low + high > 2.0 * all[best] => {
            best as f64 + 0.5 * (low - high) / (low + high - 2.0 * all[best])
        }
        _ => best as f64,
    };
    let change = |w: &[&Cycle]| w[20].without_um[LAG_AXIS] - w[0].without_um[LAG_AXIS];
    let speeds = cycles.windows(21).map(|w| change(w) / 0.02);
    let count = (cycles.len() - 20) as f64;
    let rms = (speeds.map(|speed| speed * speed).sum::<f64>() / count).sqrt();
    Some((refined, rms))
}

fn lag(cycles: &[&Cycle]) -> Result<Lag> {
    const WINDOW: usize = 2_000;
    const LEAST_UM_PER_S: f64 = 10.0;
    let (mean_ms, _) = delay(cycles).context("the diagonal is too short")?;
    let worst_ms = cycles
        .chunks(WINDOW)
        .filter_map(delay)
        .filter(|(_, speed)| *speed > LEAST_UM_PER_S)
        .map(|(ms, _)| ms)
        .fold(mean_ms, f64::max);
    let place = |cycle: &Cycle| cycle.commanded_mm();
    let steepest_um_per_mm = cycles
        .windows(101)
        .filter_map(|w| {
            let (from, to) = (place(w[0]), place(w[100]));
            let way_mm = (to[0] - from[0]).hypot(to[1] - from[1]);
            (way_mm > 1.0).then(|| (w[100].without_um[2] - w[0].without_um[2]).abs() / way_mm)
        })
        .fold(0.0, f64::max);
    let mm_per_ms = 10_000.0 / 60_000.0;
    Ok(Lag {
        mean_ms,
        worst_ms,
        steepest_um_per_mm,
        costs_um_at_10_m_per_min: steepest_um_per_mm * mm_per_ms * mean_ms,
    })
}

/// The largest change of an external offset from one servo cycle to the next.
fn largest_step_um(cycles: &[Cycle]) -> f64 {
    cycles
        .windows(2)
        .filter(|pair| pair[1].number == pair[0].number + 1)
        .flat_map(|pair| {
            [0, 1, 2].map(|axis| (pair[1].eoffset_mm[axis] - pair[0].eoffset_mm[axis]).abs() * 1e3)
        })
        .fold(0.0, f64::max)
}

/// How far the machine that only ignores the offsets is from the one that was cut without them, on
/// Z along the diagonal.
fn ignored_against_cut_um(cut: &[&Cycle], ignored: &[&Cycle]) -> f64 {
    let x = |cycle: &Cycle| cycle.commanded_mm()[0];
    let mut largest = 0.0_f64;
    let mut next = 0;
    for cycle in ignored {
        while next + 1 < cut.len() && x(cut[next + 1]) <= x(cycle) {
            next += 1;
        }
        if (x(cut[next]) - x(cycle)).abs() < 1.0 {
            largest = largest.max((cut[next].with_um[2] - cycle.without_um[2]).abs());
        }
    }
    largest
}

/// About so many points make a picture.
const POINTS: usize = 700;

fn thin<'c>(cycles: &'c [&'c Cycle]) -> impl Iterator<Item = &'c Cycle> {
    cycles.iter().step_by((cycles.len() / POINTS).max(1)).copied()
}

/// The errors of two passes on one axis over a place; they are cut at the same speed, so that equal
/// places have nearly equal numbers.
fn along(before: &[&Cycle], after: &[&Cycle], place: Of, axis: usize) -> Curve {
    let mut curve = Curve::default();
    let mut next = 0;
    for cycle in thin(after) {
        let at = place(cycle);
        let off = |n: usize| (place(before[n]) - at).abs();
        while next + 1 < before.len() && off(next + 1) <= off(next) {
            next += 1;
        }
        curve.at.push(at);
        curve.before_um.push(before[next].with_um[axis]);
        curve.after_um.push(cycle.with_um[axis]);
    }
    curve
}

fn warm_up_curve(cycles: &[&Cycle]) -> Curve {
    let [start, with, without] = [cycles[0].time_s, cycles[0].with_um[2], cycles[0].without_um[2]];
    let mut curve = Curve::default();
    for cycle in thin(cycles) {
        curve.at.push((cycle.time_s - start) / 3_600.0);
        curve.before_um.push(cycle.without_um[2] - without);
        curve.after_um.push(cycle.with_um[2] - with);
    }
    curve
}

fn five_axes_curve(cycles: &[&Cycle]) -> Curve {
    let mut curve = Curve::default();
    for cycle in thin(cycles) {
        curve.at.push((cycle.number - cycles[0].number) as f64 / 1e3);
        curve.before_um.push(cycle.growth_um);
        curve.after_um.push(length(cycle.with_um));
    }
    curve
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A diagonal at 1 mm a cycle over a wave of 100 µm, with offsets `late` cycles behind.
    fn diagonal(late: usize) -> Vec<Cycle> {
        let error = |n: f64| 100.0 * (n / 800.0).sin();
        let cycle = |n: usize| {
            let now = n as f64;
            let offset_um = -error(now - late as f64) + 3.0;
            Cycle {
                number: n as u64,
                motor_mm: [now, offset_um / 1e3, 0.0],
                eoffset_mm: [0.0, offset_um / 1e3, 0.0],
                without_um: [0.0, error(now), error(now)],
                ..Cycle::default()
            }
        };
        (0..6_000).map(cycle).collect()
    }

    #[test]
    fn a_lag_is_found_and_priced() {
        for late in [0, 7, 40] {
            let cycles = diagonal(late);
            let lag = lag(&cycles.iter().collect::<Vec<_>>()).expect("long enough");
            assert!((lag.mean_ms - late as f64).abs() < 0.05, "{lag:?}");
            assert!((lag.worst_ms - late as f64).abs() < 0.05, "{lag:?}");
            // 100 µm over 800 mm: 0.125 µm/mm at the steepest, 0.1667 mm/ms at 10 m/min.
            assert!((lag.steepest_um_per_mm - 0.125).abs() < 1e-3, "{lag:?}");
            let costs = 0.125 / 6.0 * late as f64;
            assert!((lag.costs_um_at_10_m_per_min - costs).abs() < 0.01, "{lag:?}");
        }
    }

    #[test]
    fn a_dwell_is_told_from_a_move_and_knows_where_it_came_from() {
        let mut cycles = Vec::new();
        let mut go = |z_mm: f64, count: usize, um: f64| {
            cycles.extend((0..count).map(|_| Cycle {
                motor_mm: [0.0, 0.0, z_mm],
                with_um: [0.0, 0.0, um],
                ..Cycle::default()
            }));
        };
        go(10.0, 200, 1.0);
        (11..20).for_each(|z| go(f64::from(z), 5, 50.0));
        go(20.0, 200, 2.0);
        go(15.0, 100, 60.0);
        go(10.0, 200, 9.0);
        let found = dwells(&cycles.iter().collect::<Vec<_>>());
        assert_eq!(found, [(10.0, true, 1.0), (20.0, true, 2.0), (10.0, false, 9.0)]);
    }

    #[test]
    fn a_figure_that_is_missed_or_is_none_is_not_met() {
        let reduced = |after| Check::reduction("it", 100.0, after, 95.0);
        assert!(reduced(5.0).is_met() && !reduced(5.1).is_met());
        assert!(!Check::reduction("nothing to reduce", 0.0, 0.0, 95.0).is_met());
        assert!(Check::most("late", 20.0, "ms", 20.0).is_met());
        assert!(!Check::most("late", 20.1, "ms", 20.0).is_met());
        assert!(!Check::most("late", f64::NAN, "ms", 20.0).is_met());
    }
}
