//! The results: the error of the tool tip before and after, in every servo cycle.
//!
//! The tool tip's error is the command of LinuxCNC's motors, plus the machine's response to it,
//! minus what the program commanded. "Before" is the pass of the path that was cut with the component
//! disabled; in the warm-up, where the machine only stands, and with the rotary axes it is the second
//! machine, which gets the same without the external offset.
//!
//! * Straightness: range (largest minus smallest) of the error across the path, as the paper states
//!   it; a constant is not a straightness error.
//! * Staircase: mean error over the last 50 ms of each dwell. Pitch is the range of the means
//!   approached from below, backlash the largest |from above − from below| at a height.
//! * Warm-up: the largest change of the error along the tool since its start.
//! * Five axes: the largest length of the whole error vector, against the growth.
//! * Lag τ: the delay at which the variance of offset(t) − asked(t − τ) is least along the diagonal,
//!   asked(t) being what the machine file asks for where the joint is commanded (`host_bridge`). It holds everything
//!   between that place and the offset that is applied there. It is taken on Y, which has no thermal law and no
//!   backlash that the offset could cross, and holds for all axes.

use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};
use serde::Serialize;
use trueup_machine::MachineFile;

mod cycle_statistics;

use cycle_statistics::{
    CycleMetric, arc_angle_deg, compare_staircases, compute_lag_statistics, cross_track_range_um,
    error_curve, five_axes_curve, max_offset_step_um, max_uncompensated_difference_um,
    peak_to_peak, radial_error_range_um, vector_norm, warm_up_curve,
};
pub use cycle_statistics::{ErrorCurve, LagStatistics, StaircaseStep};

use super::{
    BridgePlatform, CompensationRoute, OffsetEntryPoint, PASS_NUMBERS, TIME_COMPRESSION,
    WARM_UP_DURATION_S,
    config::{OFFSET_AV_RATIO, phase},
    host_bridge,
    plant::{LoopCounters, ServoCycle},
    slcan_adapter,
};

/// The record of the run.
pub struct RunRecord {
    /// The way from the machine to the drives.
    pub way: CompensationRoute,
    /// A second of the board in motion, in seconds of the wall.
    pub slower: u32,
    /// All servo cycles.
    pub cycles: Vec<ServoCycle>,
    /// The account of the loop.
    pub account: LoopCounters,
    /// How long the warm-up took on the wall's clock, in s.
    pub warm_up_wall_s: f64,
    /// The component's counters, by their pins.
    pub errors: Vec<(String, f64)>,
    /// The machine file.
    pub machine_file: String,
    /// The findings of the diagnosis.
    pub findings: String,
    /// The board's slew limit.
    pub slew_um_per_s: f64,
    /// How long the whole took.
    pub wall_s: f64,
    /// The log of the board.
    pub log: Vec<String>,
}

/// One claim and what came of it.
#[derive(Clone, Debug, Serialize)]
pub struct AcceptanceCheck {
    /// The claim, in words.
    pub name: &'static str,
    /// Without compensation, in µm, where there is such a thing.
    pub before_um: Option<f64>,
    /// With compensation, in µm.
    pub after_um: Option<f64>,
    /// The figure that counts: a reduction in percent, a lag in ms, a number of frames.
    pub value: f64,
    /// The unit of `value` and `limit`.
    pub unit: &'static str,
    /// The target.
    pub limit: f64,
    /// Whether the figure must not be below the limit, else not above.
    pub at_least: bool,
}

impl AcceptanceCheck {
    fn with_min_reduction(name: &'static str, before_um: f64, after_um: f64, limit: f64) -> Self {
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

    fn with_upper_limit(name: &'static str, value: f64, unit: &'static str, limit: f64) -> Self {
        Self { name, before_um: None, after_um: None, value, unit, limit, at_least: false }
    }

    /// Returns whether it is reached; a figure that is none is not.
    #[must_use]
    pub fn is_met(&self) -> bool {
        if self.at_least { self.value >= self.limit } else { self.value <= self.limit }
    }
}

/// The error across a path, axis by axis.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CrossTrackErrorRange {
    /// Range on X, Y and Z before, in µm.
    pub before_um: [f64; 3],
    /// Range on X, Y and Z after, in µm.
    pub after_um: [f64; 3],
}

/// The compression of time, part by part.
#[derive(Clone, Debug, Default, Serialize)]
pub struct TimeCompression {
    /// Wall seconds of a second of the board in motion, for LinuxCNC as well.
    pub slower: u32,
    /// Seconds of the machine in the warm-up.
    pub warm_up_s: u32,
    /// Seconds of the wall that it took, in which LinuxCNC lived in real time.
    pub warm_up_wall_s: f64,
    /// The factor that was requested: over the wall in QEMU, over the chip on its model.
    pub compression: u32,
    /// The board's `link_timeout_ms` and `hold_ms` were longer by this factor in the warm-up and after
    /// it, because they count its own time.
    pub limits_longer_by: u32,
    /// The time constants of the machine file were shorter by this factor there.
    pub constants_shorter_by: u32,
    /// In the warm-up LinuxCNC got one pair of offsets in this many.
    pub pairs_passed_one_in: u32,
    /// Milliseconds that the boards lived through.
    pub board_ms: u64,
    /// Milliseconds by which their clock fell behind for good while nothing was compressed: this computer
    /// was too slow.
    pub slipped_ms: u64,
    /// Seconds that everything took.
    pub wall_s: f64,
}

/// All of it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct LoopFigures {
    /// The way from the machine to the drives.
    pub way: CompensationRoute,
    /// The claim.
    pub checks: Vec<AcceptanceCheck>,
    /// Across the diagonal.
    pub diagonal: CrossTrackErrorRange,
    /// Range of the error across the arc, radially: before and after, in µm.
    pub arc_radial_um: [f64; 2],
    /// The same across the arc on Z: before and after, in µm.
    pub arc_z_um: [f64; 2],
    /// The errors at each height of the staircase.
    pub stairs: Vec<StaircaseStep>,
    /// How late the offsets act.
    pub lag: LagStatistics,
    /// Growth at the end of the warm-up, in µm.
    pub growth_um: f64,
    /// How far the second machine's error along the diagonal is from the pass that was really cut
    /// without compensation, at most, in µm.
    pub ignored_against_cut_um: f64,
    /// How long the run took, and what was compressed in it.
    pub time: TimeCompression,
    /// The slew limit of board and component, in µm/s.
    pub slew_um_per_s: f64,
    /// LinuxCNC's share for offsets.
    pub offset_av_ratio: f64,
    /// Largest change of an external offset in a servo cycle, in µm.
    pub largest_step_um: f64,
    /// Servo cycles that were looked at, and those that `sampler` lost.
    pub cycles: [u64; 2],
    /// Pairs that LinuxCNC got, frames that the board got; counted by the adapter, where there is one.
    pub frames: Option<[u64; 2]>,
    /// The component's counters at the end, by their pins.
    pub component: Vec<(String, f64)>,
    /// The findings of the diagnosis in the measured run.
    pub findings: String,
    /// The machine file that the board ran.
    pub machine_file: String,
    /// For the pictures: along the diagonal on Y and Z, around the arc, over the warm-up, with five
    /// axes.
    #[serde(skip)]
    pub curves: ErrorCurves,
}

/// The pictures' data.
#[derive(Clone, Debug, Default)]
pub struct ErrorCurves {
    /// Y along the diagonal.
    pub diagonal_y: ErrorCurve,
    /// Z along the diagonal.
    pub diagonal_z: ErrorCurve,
    /// Z around the arc.
    pub arc_z: ErrorCurve,
    /// Z over the warm-up, in hours.
    pub warm_up: ErrorCurve,
    /// Length of the error vector with five axes, over seconds.
    pub five_axes: ErrorCurve,
}

/// Computes the least growth while five axes move, in µm.
fn min_growth_um(five: &[&ServoCycle]) -> f64 {
    five.iter().map(|cycle| cycle.growth_um).fold(f64::INFINITY, f64::min)
}

/// Compares each figure with the least or most that it has to reach.
fn evaluate_checks(
    run: &RunRecord,
    diagonal: &CrossTrackErrorRange,
    lag: &LagStatistics,
    stairs: &[StaircaseStep],
    warm_up: &[&ServoCycle],
    five: &[&ServoCycle],
) -> Vec<AcceptanceCheck> {
    let whole = |across: &[f64; 3]| across.iter().map(|um| um * um).sum::<f64>().sqrt();
    let pitch = |of: fn(&StaircaseStep) -> f64| peak_to_peak(stairs.iter().map(of));
    let backlash = |of: fn(&StaircaseStep) -> [f64; 2]| {
        stairs.iter().map(|stair| (of(stair)[1] - of(stair)[0]).abs()).fold(0.0, f64::max)
    };
    let change = |of: CycleMetric| {
        let start = of(warm_up[0]);
        warm_up.iter().map(|cycle| (of(cycle) - start).abs()).fold(0.0, f64::max)
    };
    let growth_um = min_growth_um(five);
    let left_um = five.iter().map(|cycle| vector_norm(cycle.with_um)).fold(0.0, f64::max);
    let [on_z, on_z_now]: [CycleMetric; 2] =
        [|cycle| cycle.without_um[2], |cycle| cycle.with_um[2]];
    let damaged: f64 = run
        .errors
        .iter()
        .filter(|(name, _)| ["crc-errors", "malformed", "fault"].contains(&name.as_str()))
        .map(|(_, count)| count)
        .sum();
    vec![
        AcceptanceCheck::with_min_reduction(
            "straightness along the diagonal, Z",
            diagonal.before_um[2],
            diagonal.after_um[2],
            95.0,
        ),
        AcceptanceCheck::with_min_reduction(
            "straightness along the diagonal, X, Y and Z together",
            whole(&diagonal.before_um),
            whole(&diagonal.after_um),
            95.0,
        ),
        AcceptanceCheck::with_min_reduction(
            "growth in two hours of warm-up",
            change(on_z),
            change(on_z_now),
            97.0,
        ),
        AcceptanceCheck::with_min_reduction(
            "pitch on the staircase",
            pitch(|stair| stair.before_um[0]),
            pitch(|stair| stair.after_um[0]),
            90.0,
        ),
        AcceptanceCheck::with_min_reduction(
            "backlash on the staircase",
            backlash(|stair| stair.before_um),
            backlash(|stair| stair.after_um),
            95.0,
        ),
        AcceptanceCheck::with_min_reduction(
            "growth with five axes in motion",
            growth_um,
            left_um,
            95.0,
        ),
        AcceptanceCheck::with_upper_limit("lag of the offsets at the CNC", lag.mean_ms, "ms", 20.0),
        AcceptanceCheck::with_upper_limit("damaged frames and faults at the CNC", damaged, "", 0.0),
        AcceptanceCheck::with_upper_limit(
            "largest change of an offset in a servo cycle",
            max_offset_step_um(&run.cycles),
            "um",
            // The slew limit's share of a millisecond, and the rounding of a count.
            run.slew_um_per_s * 1e-3 + 0.01,
        ),
    ]
}

impl LoopFigures {
    /// Returns the figures of a run.
    ///
    /// # Errors
    /// A part of the run is missing.
    pub fn from_run(run: &RunRecord) -> Result<Self> {
        let part = |pass: usize, phase: u32| -> Result<Vec<&ServoCycle>> {
            let requested =
                |cycle: &&ServoCycle| cycle.pass == PASS_NUMBERS[pass] && cycle.phase == phase;
            let cycles: Vec<&ServoCycle> = run.cycles.iter().filter(requested).collect();
            ensure!(cycles.len() > 100, "pass {pass}, phase {phase}: {} cycles", cycles.len());
            Ok(cycles)
        };
        let [before, after] = [part(0, phase::DIAGONAL)?, part(1, phase::DIAGONAL)?];
        let diagonal = CrossTrackErrorRange {
            before_um: cross_track_range_um(&before),
            after_um: cross_track_range_um(&after),
        };
        let file = MachineFile::parse(&run.machine_file, Path::new("extended.toml"))?;
        let lag =
            compute_lag_statistics(&after, &host_bridge::requested_offset_um(&file, &after)?)?;
        let [arc_before, arc_after] = [part(0, phase::ARC)?, part(1, phase::ARC)?];
        let stairs =
            compare_staircases(&part(0, phase::STAIRCASE)?, &part(1, phase::STAIRCASE)?)
                .with_context(|| format!("{} cycles are not recorded", run.account.lost_samples))?;
        let warm_up = part(2, phase::WARM_UP)?;
        let five = part(2, phase::FIVE_AXES)?;
        let growth_um = min_growth_um(&five);
        let checks = evaluate_checks(run, &diagonal, &lag, &stairs, &warm_up, &five);
        let [limits_longer_by, constants_shorter_by, pairs_passed_one_in] = match run.way.on {
            BridgePlatform::Qemu => {
                [TIME_COMPRESSION, 1, slcan_adapter::COMPRESSED_PAIR_INTERVAL_CYCLES]
            }
            BridgePlatform::Chip | BridgePlatform::Servo => [1, TIME_COMPRESSION, 1],
        };
        let LoopCounters { board_ms, slipped_ms, lost_samples, traffic } = run.account;
        Ok(Self {
            way: run.way,
            checks,
            arc_radial_um: [radial_error_range_um(&arc_before), radial_error_range_um(&arc_after)],
            arc_z_um: [&arc_before, &arc_after]
                .map(|part| peak_to_peak(part.iter().map(|cycle| cycle.with_um[2]))),
            stairs,
            growth_um,
            ignored_against_cut_um: max_uncompensated_difference_um(&before, &after),
            time: TimeCompression {
                slower: run.slower,
                warm_up_s: WARM_UP_DURATION_S,
                warm_up_wall_s: run.warm_up_wall_s,
                compression: TIME_COMPRESSION,
                limits_longer_by,
                constants_shorter_by,
                pairs_passed_one_in,
                board_ms,
                slipped_ms,
                wall_s: run.wall_s,
            },
            slew_um_per_s: run.slew_um_per_s,
            offset_av_ratio: match run.way.by {
                OffsetEntryPoint::Eoffset => OFFSET_AV_RATIO,
                OffsetEntryPoint::Joint => 0.0,
            },
            largest_step_um: max_offset_step_um(&run.cycles),
            cycles: [run.cycles.len() as u64, lost_samples],
            frames: traffic.map(|(pairs, frames)| [pairs, frames]),
            component: run.errors.clone(),
            findings: run.findings.clone(),
            machine_file: run.machine_file.clone(),
            curves: ErrorCurves {
                diagonal_y: error_curve(&before, &after, |cycle| cycle.commanded_mm()[0], 1),
                diagonal_z: error_curve(&before, &after, |cycle| cycle.commanded_mm()[0], 2),
                arc_z: error_curve(&arc_before, &arc_after, arc_angle_deg, 2),
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
    pub(crate) fn ensure_all_checks_passed(&self) -> Result<u32> {
        let missed: Vec<String> = self
            .checks
            .iter()
            .filter(|check| !check.is_met())
            .map(|check| {
                let than = if check.at_least { "at least" } else { "at most" };
                let AcceptanceCheck { name, value, unit, limit, .. } = check;
                format!("{name}: {value:.2} {unit}, target: {than} {limit} {unit}")
            })
            .collect();
        if !missed.is_empty() {
            bail!("not reached: {}", missed.join("; "));
        }
        u32::try_from(self.checks.len()).context("a handful")
    }

    /// Returns the table for a machinist.
    #[must_use]
    pub fn format_table(&self) -> String {
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
        let LagStatistics { worst_ms, steepest_um_per_mm, costs_um_at_10_m_per_min, .. } = self.lag;
        text + &format!(
            "\nThe lag is {:.1} ms over the diagonal, {worst_ms:.1} ms in its worst two seconds. Where the \
             error is steepest\n({steepest_um_per_mm:.3} um/mm) it costs {costs_um_at_10_m_per_min:.2} um at \
             10 m/min.\nThe arc: {:.1} -> {:.1} um radially, {:.1} -> {:.1} um on Z.\n\
             A second in motion took {} of the wall. Two hours of warm-up took {:.0} s, {:.0} times as fast;\n\
             {} ms of the board were lost by a slow computer. The whole took {:.0} s.",
            self.lag.mean_ms,
            self.arc_radial_um[0],
            self.arc_radial_um[1],
            self.arc_z_um[0],
            self.arc_z_um[1],
            self.time.slower,
            self.time.warm_up_wall_s,
            f64::from(self.time.warm_up_s) / self.time.warm_up_wall_s,
            self.time.slipped_ms,
            self.time.wall_s,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_that_is_missed_or_is_none_is_not_met() {
        let reduced = |after| AcceptanceCheck::with_min_reduction("it", 100.0, after, 95.0);
        assert!(reduced(5.0).is_met() && !reduced(5.1).is_met());
        assert!(!AcceptanceCheck::with_min_reduction("nothing to reduce", 0.0, 0.0, 95.0).is_met());
        assert!(AcceptanceCheck::with_upper_limit("late", 20.0, "ms", 20.0).is_met());
        assert!(!AcceptanceCheck::with_upper_limit("late", 20.1, "ms", 20.0).is_met());
        assert!(!AcceptanceCheck::with_upper_limit("late", f64::NAN, "ms", 20.0).is_met());
    }
}
