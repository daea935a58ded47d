//! What is read off the recorded servo cycles: ranges, stairs, the lag, curves for the pictures.

use anyhow::{Context as _, Result};
use serde::Serialize;

use super::super::{
    config::{self, STAIRCASE_HEIGHTS_MM},
    plant::ServoCycle,
};

/// A figure of a servo cycle.
pub(super) type CycleMetric = fn(&ServoCycle) -> f64;

/// A height of the staircase.
#[derive(Clone, Debug, Serialize)]
pub struct StaircaseStep {
    /// Height in machine coordinates, in mm.
    pub z_mm: f64,
    /// Error on Z from below and from above, in µm, before.
    pub before_um: [f64; 2],
    /// The same after, in µm.
    pub after_um: [f64; 2],
}

/// How late the offsets are.
#[derive(Clone, Debug, Default, Serialize)]
pub struct LagStatistics {
    /// Over the whole diagonal, in ms.
    pub mean_ms: f64,
    /// In the worst two seconds of it in which the error changes by more than 10 µm/s.
    pub worst_ms: f64,
    /// The steepest error on Z along the diagonal, in µm/mm.
    pub steepest_um_per_mm: f64,
    /// Error by the lag there at 10 m/min, in µm.
    pub costs_um_at_10_m_per_min: f64,
}

/// Places and errors for a picture.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ErrorCurve {
    /// Place along the path in mm, or time in s, or angle in degrees.
    pub at: Vec<f64>,
    /// The error before, in µm.
    pub before_um: Vec<f64>,
    /// The error after, in µm.
    pub after_um: Vec<f64>,
}

pub(super) fn peak_to_peak(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    high - low
}

pub(super) fn vector_norm(v: [f64; 3]) -> f64 {
    v.iter().map(|um| um * um).sum::<f64>().sqrt()
}

/// Returns the range of the error across the diagonal, on X, Y and Z.
pub(super) fn cross_track_range_um(cycles: &[&ServoCycle]) -> [f64; 3] {
    let [x, y, _] = config::AXIS_TRAVEL_MM;
    let direction = [x / x.hypot(y), y / x.hypot(y), 0.0];
    let across = |cycle: &ServoCycle| {
        let along: f64 = cycle.with_um.iter().zip(direction).map(|(um, d)| um * d).sum();
        [0, 1, 2].map(|axis| cycle.with_um[axis] - along * direction[axis])
    };
    [0, 1, 2].map(|axis| peak_to_peak(cycles.iter().map(|cycle| across(cycle)[axis])))
}

/// Returns the range of the radial error on the arc.
pub(super) fn radial_error_range_um(cycles: &[&ServoCycle]) -> f64 {
    let ([cx, cy], ..) = config::ARC_CENTRE_RADIUS_FEED;
    peak_to_peak(cycles.iter().map(|cycle| {
        let [x, y, _] = cycle.commanded_mm();
        let (dx, dy) = (x - cx, y - cy);
        (cycle.with_um[0] * dx + cycle.with_um[1] * dy) / dx.hypot(dy)
    }))
}

pub(super) fn arc_angle_deg(cycle: &ServoCycle) -> f64 {
    let ([cx, cy], ..) = config::ARC_CENTRE_RADIUS_FEED;
    let [x, y, _] = cycle.commanded_mm();
    (y - cy).atan2(x - cx).to_degrees()
}

/// Where the program dwells: height, whether it came from below, mean error on Z.
///
/// The offset that the sampler reads may be a cycle older than the motor's position, so that a height
/// seems to move by what the offset changes in a cycle, 0.5 µm: that is the same dwell still. Two dwells
/// at one height would make one of them come from the other side.
fn find_dwells(cycles: &[&ServoCycle]) -> Vec<(f64, bool, f64)> {
    const STANDSTILL_TOLERANCE_MM: f64 = 1e-3;
    const MIN_DWELL_CYCLES: usize = 150;
    const AVERAGED_CYCLES: usize = 50;
    let height = |cycle: &ServoCycle| cycle.commanded_mm()[2];
    let mut dwells = Vec::new();
    let mut before_mm = f64::NEG_INFINITY;
    let mut rest = cycles;
    while let Some(first) = rest.first() {
        let moved =
            |cycle: &&ServoCycle| (height(cycle) - height(first)).abs() >= STANDSTILL_TOLERANCE_MM;
        let (part, next) = rest.split_at(rest.iter().position(moved).unwrap_or(rest.len()));
        rest = next;
        if part.len() < MIN_DWELL_CYCLES {
            continue;
        }
        let tail = &part[part.len() - AVERAGED_CYCLES..];
        let z_mm = height(part[part.len() - 1]);
        let mean_um =
            tail.iter().map(|cycle| cycle.with_um[2]).sum::<f64>() / AVERAGED_CYCLES as f64;
        dwells.push((z_mm, z_mm > before_mm, mean_um));
        before_mm = z_mm;
    }
    dwells
}

pub(super) fn compare_staircases(
    before: &[&ServoCycle],
    after: &[&ServoCycle],
) -> Result<Vec<StaircaseStep>> {
    let both = [find_dwells(before), find_dwells(after)];
    let found = |dwells: &[(f64, bool, f64)], z_mm: f64, up: bool| -> Result<f64> {
        let here = |entry: &&(f64, bool, f64)| (entry.0 - z_mm).abs() < 0.01 && entry.1 == up;
        dwells.iter().find(here).map(|dwell| dwell.2).with_context(|| {
            let way = if up { "up" } else { "down" };
            let all: Vec<f64> = dwells.iter().map(|dwell| dwell.0).collect();
            format!("no dwell at {z_mm} mm on the way {way}; there are dwells at {all:?}")
        })
    };
    let at = |z_mm: f64| -> Result<StaircaseStep> {
        let pair = |dwells: &[_]| Ok([found(dwells, z_mm, true)?, found(dwells, z_mm, false)?]);
        let (before_um, after_um): (Result<_>, Result<_>) = (pair(&both[0]), pair(&both[1]));
        Ok(StaircaseStep { z_mm, before_um: before_um?, after_um: after_um? })
    };
    STAIRCASE_HEIGHTS_MM.iter().map(|&z_mm| at(z_mm)).collect()
}

/// The axis on which the lag is taken: Y.
const LAG_AXIS_INDEX: usize = 1;

/// Returns the delay, in cycles, at which the offset is what the machine file asks for; and how many µm/s that changes by (RMS).
fn estimate_delay_and_rate(cycles: &[(&ServoCycle, f64)]) -> Option<(f64, f64)> {
    const MAX_DELAY_CYCLES: usize = 100;
    let left = |delay: usize| {
        let mut moments = (0.0, 0.0, 0.0);
        for n in MAX_DELAY_CYCLES..cycles.len() {
            let rest = cycles[n].0.eoffset_mm[LAG_AXIS_INDEX] * 1e3 - cycles[n - delay].1;
            moments = (moments.0 + 1.0, moments.1 + rest, moments.2 + rest * rest);
        }
        let (count, sum, squares) = moments;
        squares / count - (sum / count).powi(2)
    };
    if cycles.len() < 3 * MAX_DELAY_CYCLES {
        return None;
    }
    let all: Vec<f64> = (0..=MAX_DELAY_CYCLES).map(left).collect();
    let best = (0..=MAX_DELAY_CYCLES).min_by(|&one, &other| all[one].total_cmp(&all[other]))?;
    // A parabola through the least and its neighbours.
    let refined = match (best.checked_sub(1).map(|n| all[n]), all.get(best + 1)) {
        (Some(low), Some(&high)) if low + high > 2.0 * all[best] => {
            best as f64 + 0.5 * (low - high) / (low + high - 2.0 * all[best])
        }
        _ => best as f64,
    };
    let change = |w: &[(&ServoCycle, f64)]| w[20].1 - w[0].1;
    let speeds = cycles.windows(21).map(|w| change(w) / 0.02);
    let count = (cycles.len() - 20) as f64;
    let rms = (speeds.map(|speed| speed * speed).sum::<f64>() / count).sqrt();
    Some((refined, rms))
}

/// Returns the lag of the offsets behind those that are requested, in µm, at each of these cycles.
pub(super) fn compute_lag_statistics(
    cycles: &[&ServoCycle],
    requested_um: &[[f64; 3]],
) -> Result<LagStatistics> {
    const LAG_WINDOW_CYCLES: usize = 2_000;
    const MIN_OFFSET_RATE_UM_PER_S: f64 = 10.0;
    let requested_um = requested_um.iter().map(|um| um[LAG_AXIS_INDEX]);
    let both: Vec<(&ServoCycle, f64)> = cycles.iter().copied().zip(requested_um).collect();
    let (mean_ms, _) = estimate_delay_and_rate(&both).context("the diagonal is too short")?;
    let worst_ms = both
        .chunks(LAG_WINDOW_CYCLES)
        .filter_map(estimate_delay_and_rate)
        .filter(|(_, speed)| *speed > MIN_OFFSET_RATE_UM_PER_S)
        .map(|(ms, _)| ms)
        .fold(mean_ms, f64::max);
    let place = |cycle: &ServoCycle| cycle.commanded_mm();
    let steepest_um_per_mm = cycles
        .windows(101)
        .filter_map(|w| {
            let (from, to) = (place(w[0]), place(w[100]));
            let way_mm = (to[0] - from[0]).hypot(to[1] - from[1]);
            (way_mm > 1.0).then(|| (w[100].without_um[2] - w[0].without_um[2]).abs() / way_mm)
        })
        .fold(0.0, f64::max);
    let mm_per_ms = 10_000.0 / 60_000.0;
    Ok(LagStatistics {
        mean_ms,
        worst_ms,
        steepest_um_per_mm,
        costs_um_at_10_m_per_min: steepest_um_per_mm * mm_per_ms * mean_ms,
    })
}

/// Returns the largest change of an external offset from one servo cycle to the next.
pub(super) fn max_offset_step_um(cycles: &[ServoCycle]) -> f64 {
    cycles
        .windows(2)
        .filter(|pair| pair[1].number == pair[0].number + 1)
        .flat_map(|pair| {
            [0, 1, 2].map(|axis| (pair[1].eoffset_mm[axis] - pair[0].eoffset_mm[axis]).abs() * 1e3)
        })
        .fold(0.0, f64::max)
}

/// Returns how far the machine that only ignores the offsets is from the one that was cut without them, on
/// Z along the diagonal.
pub(super) fn max_uncompensated_difference_um(cut: &[&ServoCycle], ignored: &[&ServoCycle]) -> f64 {
    let x = |cycle: &ServoCycle| cycle.commanded_mm()[0];
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

/// About this many points make a picture.
const TARGET_PLOT_POINTS: usize = 700;

fn downsample<'c>(cycles: &'c [&'c ServoCycle]) -> impl Iterator<Item = &'c ServoCycle> {
    cycles.iter().step_by((cycles.len() / TARGET_PLOT_POINTS).max(1)).copied()
}

/// Returns the errors of two passes on one axis over a place; they are cut at the same speed, so that equal
/// places have nearly equal numbers.
pub(super) fn error_curve(
    before: &[&ServoCycle],
    after: &[&ServoCycle],
    place: CycleMetric,
    axis: usize,
) -> ErrorCurve {
    let mut curve = ErrorCurve::default();
    let mut next = 0;
    for cycle in downsample(after) {
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

pub(super) fn warm_up_curve(cycles: &[&ServoCycle]) -> ErrorCurve {
    let [start, with, without] = [cycles[0].time_s, cycles[0].with_um[2], cycles[0].without_um[2]];
    let mut curve = ErrorCurve::default();
    for cycle in downsample(cycles) {
        curve.at.push((cycle.time_s - start) / 3_600.0);
        curve.before_um.push(cycle.without_um[2] - without);
        curve.after_um.push(cycle.with_um[2] - with);
    }
    curve
}

pub(super) fn five_axes_curve(cycles: &[&ServoCycle]) -> ErrorCurve {
    let mut curve = ErrorCurve::default();
    for cycle in downsample(cycles) {
        curve.at.push((cycle.number - cycles[0].number) as f64 / 1e3);
        curve.before_um.push(cycle.growth_um);
        curve.after_um.push(vector_norm(cycle.with_um));
    }
    curve
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a diagonal at 1 mm a cycle over a wave of 100 µm, with offsets `late` cycles behind.
    fn diagonal(late: usize) -> Vec<ServoCycle> {
        let error = |n: f64| 100.0 * (n / 800.0).sin();
        let cycle = |n: usize| {
            let now = n as f64;
            let offset_um = -error(now - late as f64) + 3.0;
            ServoCycle {
                number: n as u64,
                motor_mm: [now, offset_um / 1e3, 0.0],
                eoffset_mm: [0.0, offset_um / 1e3, 0.0],
                without_um: [0.0, error(now), error(now)],
                ..ServoCycle::default()
            }
        };
        (0..6_000).map(cycle).collect()
    }

    #[test]
    fn a_lag_is_found_and_priced() {
        for late in [0, 7, 40] {
            let cycles = diagonal(late);
            let requested: Vec<_> =
                cycles.iter().map(|cycle| [0.0, -cycle.without_um[1], 0.0]).collect();
            let lag = compute_lag_statistics(&cycles.iter().collect::<Vec<_>>(), &requested)
                .expect("long enough");
            assert!((lag.mean_ms - late as f64).abs() < 0.05, "{lag:?}");
            assert!((lag.worst_ms - late as f64).abs() < 0.05, "{lag:?}");
            // 100 µm over 800 mm: 0.125 µm/mm at the steepest, 0.1667 mm/ms at 10 m/min.
            assert!((lag.steepest_um_per_mm - 0.125).abs() < 1e-3, "{lag:?}");
            let costs = 0.125 / 6.0 * late as f64;
            assert!((lag.costs_um_at_10_m_per_min - costs).abs() < 0.01, "{lag:?}");
        }
    }

    #[test]
    fn a_dwell_is_distinguished_from_a_move_and_knows_where_it_came_from() {
        let mut cycles = Vec::new();
        let mut go = |z_mm: f64, count: usize, um: f64| {
            cycles.extend((0..count).map(|_| ServoCycle {
                motor_mm: [0.0, 0.0, z_mm],
                with_um: [0.0, 0.0, um],
                ..ServoCycle::default()
            }));
        };
        go(10.0, 400, 1.0);
        (11..20).for_each(|z| go(f64::from(z), 5, 50.0));
        go(20.0, 200, 2.0);
        go(15.0, 100, 60.0);
        go(10.0, 200, 9.0);
        let found = find_dwells(&cycles.iter().collect::<Vec<_>>());
        assert_eq!(found, [(10.0, true, 1.0), (20.0, true, 2.0), (10.0, false, 9.0)]);
        // An offset of 0.5 µm that is read a cycle late, in the middle of the first dwell.
        cycles[200].eoffset_mm[2] = 5e-4;
        let found = find_dwells(&cycles.iter().collect::<Vec<_>>());
        assert_eq!(found, [(10.0, true, 1.0), (20.0, true, 2.0), (10.0, false, 9.0)]);
    }
}
