//! Claimed causes of circles as sections of a machine file: errors, actual minus commanded, that the board takes off.
//!
//! A table that is there stays, and the error that the circle shows is added to it, since what the file predicts was taken
//! off the readings. Of a scale mismatch the circle shows the difference of the axes alone: their mean stays unchanged, and
//! of several planes the smallest correction is taken that gives all differences.

use trueup_machine::{
    Machine,
    machine_file::{
        BSpline, Backlash, Feedback, LinearAxis, PitchErrorTable, Squareness,
        writer::{MachineFileEdit, NewSection, round_to_decimals},
    },
    model::{pitch_error_um, spline_value_um},
};

use super::{
    CircleResult,
    findings::{CircleCause, CircleFinding, straightness_um},
    terms::{CircleTerm, WavePhase},
};
use crate::bspline;

/// Digits after the point, in µm: the board's step is 1 nm.
const MACHINE_FILE_DECIMALS: i32 = 3;
/// Points of a table in a period of a cyclic error: lines between them leave 5 % of it.
const TABLE_POINTS_PER_PERIOD: f64 = 10.0;
/// The most points of a table that this fit writes.
const MAX_WRITTEN_TABLE_POINTS: f64 = 2_000.0;
/// Turns of Kaczmarz's projections onto at most three differences.
const KACZMARZ_ITERATIONS: usize = 200;

/// Returns the sections, and which constants they have; marks the findings that are in them.
pub(crate) fn build_machine_file_edit(
    circles: &mut [CircleResult],
    machine: Option<&Machine>,
    warnings: &mut Vec<String>,
) -> (MachineFileEdit, Vec<String>) {
    let mut out =
        SectionBuilder { machine, edit: MachineFileEdit::default(), written: Vec::new(), warnings };
    out.add_squareness(circles);
    out.add_positioning(circles);
    out.add_straightness(circles);
    (out.edit, out.written)
}

struct SectionBuilder<'m> {
    machine: Option<&'m Machine>,
    edit: MachineFileEdit,
    written: Vec<String>,
    warnings: &'m mut Vec<String>,
}

/// Returns the claimed findings of a cause, each with the number of its circle.
fn claimed_finding_indices(circles: &[CircleResult], cause: CircleCause) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    for (circle, result) in circles.iter().enumerate() {
        let own = result.findings.iter().enumerate();
        // A slope of which is open whether it is a form's line is the slope of the plane all the same.
        let is_line = |finding: &CircleFinding| {
            finding.cause == CircleCause::Squareness
                && finding.alternatives == [CircleCause::Straightness.name()]
        };
        let own = own
            .filter(|(_, finding)| finding.cause == cause && (finding.claimed || is_line(finding)));
        found.extend(own.map(|(at, _)| (circle, at)));
    }
    found
}

fn parameter_value(finding: &CircleFinding, name: &str) -> f64 {
    finding
        .parameters
        .iter()
        .find(|parameter| parameter.name == name)
        .map_or(0.0, |parameter| parameter.value)
}

impl SectionBuilder<'_> {
    fn add_squareness(&mut self, circles: &mut [CircleResult]) {
        let mut angles: Vec<Squareness> =
            self.machine.map(|machine| machine.squareness.clone()).unwrap_or_default();
        let mut is_changed = false;
        let found = claimed_finding_indices(circles, CircleCause::Squareness);
        let plane_of = |circle: usize| circles[circle].record.plane;
        // Several circles in a plane show one angle: each adds its share of the mean.
        let shares: Vec<f64> = found
            .iter()
            .map(|entry| {
                let same = found.iter().filter(|other| plane_of(other.0) == plane_of(entry.0));
                (same.count() as f64).recip()
            })
            .collect();
        for ((circle, at), share) in found.into_iter().zip(shares) {
            let [u, v] = circles[circle].record.plane.axes();
            // The axis that comes first in the alphabet is the one in error, unless the file has it the other way round.
            let (error, along) = if u < v { (u, v) } else { (v, u) };
            let is_own = |squareness: &Squareness, error, along| {
                (squareness.error, squareness.along) == (error, along)
            };
            let has_other = angles
                .iter()
                .any(|angle| is_own(angle, along, error) && angle.um_per_m != 0.0)
                && !angles.iter().any(|angle| is_own(angle, error, along) && angle.um_per_m != 0.0);
            let (error, along) = if has_other { (along, error) } else { (error, along) };
            let um_per_m = share * parameter_value(&circles[circle].findings[at], "um_per_m");
            match angles.iter_mut().find(|angle| is_own(angle, error, along)) {
                Some(angle) => {
                    angle.um_per_m =
                        round_to_decimals(angle.um_per_m + um_per_m, MACHINE_FILE_DECIMALS)
                }
                None => {
                    angles.push(Squareness {
                        error,
                        along,
                        um_per_m: round_to_decimals(um_per_m, MACHINE_FILE_DECIMALS),
                    });
                }
            }
            is_changed = true;
            circles[circle].findings[at].compensated = true;
            self.written.push(format!(
                "[squareness] {}_of_{}_um_per_m: {um_per_m:+.2} µm/m",
                error.name(),
                along.name()
            ));
        }
        if is_changed {
            let section = NewSection::new("squareness")
                .with_header_comment("From circles: trueup fit circle.");
            let section = angles
                .iter()
                .fold(section, |section, angle| section.with_number(angle.name(), angle.um_per_m));
            self.edit.sections.push(section);
        }
    }

    /// Writes scale, cyclic errors and backlash of each axis.
    fn add_positioning(&mut self, circles: &mut [CircleResult]) {
        let scales = solve_scales_um_per_m(circles);
        for axis in LinearAxis::ALL {
            let own = self.machine.map(|machine| &machine.axes[axis.index()]);
            let name = axis.name();
            let mut pitch = own.and_then(|own| own.pitch.clone());
            let scale = scales[axis.index()];
            let waves = mean_cyclic_errors(circles, axis);
            let width_um = self.average_backlash_um(circles, axis);
            if own.is_some_and(|own| own.dual.is_some()) && (scale != 0.0 || !waves.is_empty()) {
                self.warnings.push(format!(
                    "{name} has two drives: its scale and cyclic error are not written. `trueup fit pitch` fits both tables"
                ));
            } else if scale != 0.0 || !waves.is_empty() {
                pitch = Some(build_pitch_table(circles, axis, pitch.as_ref(), scale, &waves));
                for (circle, at) in claimed_finding_indices(circles, CircleCause::CyclicError) {
                    let it = &mut circles[circle].findings[at];
                    it.compensated |= it.axis == Some(axis);
                }
                for (circle, at) in claimed_finding_indices(circles, CircleCause::ScaleMismatch) {
                    let axes = circles[circle].record.plane.axes();
                    circles[circle].findings[at].compensated |= axes.contains(&axis);
                }
                self.written.push(format!(
                    "[axis.{name}.pitch]: scale {scale:+.2} µm/m, {} cyclic error{}",
                    waves.len(),
                    if waves.len() == 1 { "" } else { "s" }
                ));
            }
            let reverse = pitch.as_mut().and_then(|pitch| pitch.reverse_um.as_mut());
            match (width_um, reverse) {
                (Some(width_um), Some(reverse)) => {
                    reverse.iter_mut().for_each(|um| {
                        *um = round_to_decimals(*um + width_um, MACHINE_FILE_DECIMALS)
                    });
                }
                (Some(width_um), None) => {
                    let there =
                        own.and_then(|own| own.backlash).map_or(0.0, |backlash| backlash.width_um);
                    let section = Backlash::width_section(
                        axis,
                        round_to_decimals(there + width_um, MACHINE_FILE_DECIMALS),
                    )
                    .with_header_comment("From circles: trueup fit circle.");
                    self.edit.sections.push(section);
                }
                (None, _) => {}
            }
            if let Some(pitch) =
                pitch.filter(|pitch| own.and_then(|own| own.pitch.as_ref()) != Some(pitch))
            {
                self.edit.sections.push(pitch.to_section(axis).with_header_comment(
                    "From circles: trueup fit circle. Beyond their range the ends are held.",
                ));
            }
        }
    }

    /// Returns the backlash of an axis, the mean of its circles, and marks the findings; `None` where it is not written.
    fn average_backlash_um(
        &mut self,
        circles: &mut [CircleResult],
        axis: LinearAxis,
    ) -> Option<f64> {
        let own: Vec<(usize, usize)> = claimed_finding_indices(circles, CircleCause::Backlash)
            .into_iter()
            .filter(|(circle, at)| circles[*circle].findings[*at].axis == Some(axis))
            .collect();
        let name = axis.name();
        let widths: Vec<f64> = own
            .iter()
            .map(|(circle, at)| parameter_value(&circles[*circle].findings[*at], "width_um"))
            .collect();
        if widths.is_empty() {
            return None;
        }
        let feedback = self.machine.map(|machine| machine.axes[axis.index()].feedback);
        if feedback == Some(Feedback::Scale) {
            self.warnings.push(format!(
                "{name} has its feedback on a scale. A backlash of {:.2} µm lies behind the \
                 scale, as in the tool or a guide, and is not written",
                widths[0]
            ));
            return None;
        }
        let mean = widths.iter().sum::<f64>() / widths.len() as f64;
        let apart = widths.iter().map(|width| (width - mean).abs()).fold(0.0, f64::max);
        if apart > (0.25 * mean.abs()).max(1.0) {
            self.warnings.push(format!(
                "backlash of {name} differs from circle to circle by {:.2} µm: the mean is written. It depends on the position or \
                 the feed: `trueup fit backlash`",
                2.0 * apart
            ));
        }
        own.into_iter().for_each(|(circle, at)| circles[circle].findings[at].compensated = true);
        self.written.push(format!("[axis.{name}.backlash] width_um: {mean:+.2} µm"));
        Some(mean)
    }

    fn add_straightness(&mut self, circles: &mut [CircleResult]) {
        for (circle, at) in claimed_finding_indices(circles, CircleCause::Straightness) {
            let record = &circles[circle].record;
            let finding = &circles[circle].findings[at];
            let (Some(error), Some(along)) = (finding.axis, finding.along) else { continue };
            let name = format!("straightness.{}_of_{}", error.name(), along.name());
            if self.edit.sections.iter().any(|section| section.name() == name) {
                self.warnings.push(format!(
                    "[{name}] is written from the first circle that shows it: fit the others again with the file that is written"
                ));
                continue;
            }
            let index = usize::from(record.plane.axes()[1] == along);
            let [centre, radius] = [record.centre_mm[index], record.radius_mm];
            let there = self.machine.and_then(|machine| {
                machine
                    .straightness
                    .iter()
                    .find(|curve| (curve.error, curve.along) == (error, along))
            });
            let at_mm = |mm: f64| {
                let share = ((mm - centre) / radius).clamp(-1.0, 1.0);
                straightness_um(&finding.terms, share)
                    + there.map_or(0.0, |there| spline_value_um(&there.spline, mm))
            };
            let Some(spline) = fit_spline(centre, radius, there.map(|curve| &curve.spline), at_mm)
            else {
                continue;
            };
            self.written.push(format!(
                "[{name}]: {:.2} µm over {:.0} mm",
                parameter_value(finding, "range_um"),
                2.0 * radius
            ));
            let section = NewSection::new(name)
                .with_header_comment("From circles: trueup fit circle. It holds the form; the straight line is in [squareness].")
                .with_integer("order", 4)
                .with_numbers("knots_mm", spline.knots_mm)
                .with_numbers("control_um", spline.control_um);
            self.edit.sections.push(section);
            circles[circle].findings[at].compensated = true;
        }
    }
}

/// Returns the scale of each axis in µm/m: the smallest that have the differences of all circles.
fn solve_scales_um_per_m(circles: &[CircleResult]) -> [f64; 3] {
    let mut scales = [0.0; 3];
    for _ in 0..KACZMARZ_ITERATIONS {
        for (circle, at) in claimed_finding_indices(circles, CircleCause::ScaleMismatch) {
            let [u, v] = circles[circle].record.plane.axes().map(LinearAxis::index);
            let found = parameter_value(&circles[circle].findings[at], "um_per_m");
            let missing = 0.5 * (found - (scales[u] - scales[v]));
            scales[u] += missing;
            scales[v] -= missing;
        }
    }
    scales
}

/// A wave: sine and cosine in µm, period in mm.
type CyclicErrorParameters = [f64; 3];

/// Returns the cyclic errors of an axis; one that several circles show is their mean.
fn mean_cyclic_errors(circles: &[CircleResult], axis: LinearAxis) -> Vec<CyclicErrorParameters> {
    let mut all: Vec<(CyclicErrorParameters, f64)> = Vec::new();
    for (circle, at) in claimed_finding_indices(circles, CircleCause::CyclicError) {
        let finding = &circles[circle].findings[at];
        if finding.axis != Some(axis) {
            continue;
        }
        let mut wave = [0.0; 3];
        for it in &finding.terms {
            if let CircleTerm::Cyclic { period_mm, wave: own, .. } = it.term {
                wave[usize::from(own == WavePhase::Cosine)] = it.um;
                wave[2] = period_mm;
            }
        }
        match all.iter_mut().find(|(known, _)| (known[2] / wave[2] - 1.0).abs() < 0.02) {
            Some((it, count)) => {
                *count += 1.0;
                it.iter_mut()
                    .zip(wave)
                    .for_each(|(value, wave)| *value += (wave - *value) / *count);
            }
            None => all.push((wave, 1.0)),
        }
    }
    all.into_iter().map(|(wave, _)| wave).collect()
}

/// Returns the table of an axis with a scale about the middle of the circles, and cyclic errors.
fn build_pitch_table(
    circles: &[CircleResult],
    axis: LinearAxis,
    there: Option<&PitchErrorTable>,
    scale_um_per_m: f64,
    waves: &[CyclicErrorParameters],
) -> PitchErrorTable {
    let ends = circles.iter().filter_map(|circle| {
        let index = circle.record.plane.axes().iter().position(|candidate| *candidate == axis)?;
        let [centre, radius] = [circle.record.centre_mm[index], circle.record.radius_mm];
        Some([centre - radius, centre + radius])
    });
    let of_circles = ends
        .reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
        .unwrap_or_default()
        .map(|mm| round_to_decimals(mm, MACHINE_FILE_DECIMALS));
    let [mut first, mut last] = of_circles;
    let mut step = last - first;
    if let Some(there) = there {
        let end = there.start_mm + there.step_mm * (there.forward_um.len() as f64 - 1.0);
        (first, last) = (first.min(there.start_mm), last.max(end));
        step = step.min(there.step_mm);
    }
    for [.., period_mm] in waves {
        step = step.min(period_mm / TABLE_POINTS_PER_PERIOD);
    }
    step = round_to_decimals(
        step.max((last - first) / MAX_WRITTEN_TABLE_POINTS),
        MACHINE_FILE_DECIMALS,
    );
    let points = ((last - first) / step).ceil() as usize + 1;
    let middle = 0.5 * (of_circles[0] + of_circles[1]);
    let added = |mm: f64| {
        // Beyond the circles the ends are held.
        let mm = mm.clamp(of_circles[0], of_circles[1]);
        let of_wave = |[sine, cosine, period]: &CyclicErrorParameters| {
            let angle = std::f64::consts::TAU * mm / period;
            sine * angle.sin() + cosine * angle.cos()
        };
        scale_um_per_m * (mm - middle) / 1e3 + waves.iter().map(of_wave).sum::<f64>()
    };
    let of = |direction: f64| -> Vec<f64> {
        let um = |n: usize| {
            let mm = first + step * n as f64;
            added(mm) + there.map_or(0.0, |there| pitch_error_um(there, mm, direction))
        };
        (0..points).map(|n| round_to_decimals(um(n), MACHINE_FILE_DECIMALS)).collect()
    };
    let reverse_um = there.and_then(|there| there.reverse_um.as_ref()).map(|_| of(-1.0));
    PitchErrorTable { start_mm: first, step_mm: step, forward_um: of(1.0), reverse_um }
}

/// Returns a cubic spline through a curve over the circle and over the spline that was there, without its mean.
fn fit_spline(
    centre: f64,
    radius: f64,
    there: Option<&BSpline>,
    at_mm: impl Fn(f64) -> f64,
) -> Option<BSpline> {
    const SPLINE_SPAN_COUNT: u32 = 8;
    const SPLINE_SAMPLE_INTERVALS: u32 = 400;
    let part =
        |n: u32| centre - radius + 2.0 * radius * f64::from(n) / f64::from(SPLINE_SPAN_COUNT);
    let mut knots: Vec<f64> = (0..=SPLINE_SPAN_COUNT).map(part).collect();
    knots.extend(there.iter().flat_map(|curve| curve.knots_mm.iter().copied()));
    knots.iter_mut().for_each(|mm| *mm = round_to_decimals(*mm, MACHINE_FILE_DECIMALS));
    knots.sort_unstable_by(f64::total_cmp);
    knots.dedup_by(|a, b| (*a - *b).abs() < 1e-3 * radius);
    let (first, last) = (*knots.first()?, *knots.last()?);
    let inner = &knots[1..knots.len() - 1];
    let mut at: Vec<f64> = (0..=SPLINE_SAMPLE_INTERVALS)
        .map(|n| first + (last - first) * f64::from(n) / f64::from(SPLINE_SAMPLE_INTERVALS))
        .collect();
    // Each piece has points of its own.
    at.extend(
        knots
            .windows(2)
            .flat_map(|pair| (1..4).map(|n| pair[0] + (pair[1] - pair[0]) * f64::from(n) / 4.0)),
    );
    at.sort_unstable_by(f64::total_cmp);
    let um: Vec<f64> = at.iter().map(|mm| at_mm(*mm)).collect();
    // What was there keeps its zero; a new curve has none.
    let mean = if there.is_some() { 0.0 } else { um.iter().sum::<f64>() / um.len() as f64 };
    let points = at.iter().zip(&um).map(|(mm, um)| (*mm, um - mean, 1.0));
    let mut spline = bspline::fit_least_squares_spline(
        bspline::clamped_knots(4, first, inner, last),
        4,
        points,
    )?
    .spline;
    spline.control_um.iter_mut().for_each(|um| *um = round_to_decimals(*um, MACHINE_FILE_DECIMALS));
    Some(spline)
}
