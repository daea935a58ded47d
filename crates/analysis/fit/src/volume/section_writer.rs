//! The constants as sections of a machine file. The part that the file has already was
//! taken off the readings, so the new part is added to it.
//!
//! All constants are written together: they are those that correct best within the measured volume. One that is not known by
//! itself shares its error with others in a way that only fits there; the remark says so.

use trueup_machine::{
    Machine,
    machine_file::{
        AngleProfile, BSpline, LinearAxis, PitchErrorTable, RotaryAxis, Squareness,
        writer::{MachineFileEdit, NewSection, round_to_decimals},
    },
    model::{pitch_error_um, spline_value_um},
};

use super::{
    error_parameters::{ErrorParameters, ErrorPart, GeometricError},
    identifiability::ErrorAssessment,
};
use crate::bspline;

/// Digits after the point: the board's step is 1 nm.
const MACHINE_FILE_DECIMALS: i32 = 3;
/// Steps of a table over the travel: lines between them leave nothing of a smooth form.
const TABLE_INTERVALS: usize = 64;
/// The most points of a table.
const MAX_TABLE_POINTS: usize = 2_000;
/// An error that is smaller, in µm, µm/m or µrad, is not written.
const MIN_WRITTEN_ERROR: f64 = 0.02;
/// Points of a spline that takes two together.
const SPLINE_SAMPLE_INTERVALS: u32 = 400;

/// Returns the sections, and which errors they have.
#[must_use]
pub(crate) fn build_machine_file_edit(
    machine: &Machine,
    constants: &ErrorParameters,
    mean: &[f64],
    known: &[ErrorAssessment],
    points_mm: Option<[[f64; 3]; 3]>,
    warnings: &mut Vec<String>,
) -> (MachineFileEdit, Vec<GeometricError>) {
    let mut out = SectionWriter {
        machine,
        constants,
        mean,
        known,
        sections: Vec::new(),
        written: Vec::new(),
    };
    out.write_positioning_errors(warnings);
    out.write_straightness();
    out.write_squareness();
    if let Some(points_mm) = points_mm {
        let section = NewSection::new("angular").with_header_comment(
            "Where the straightness below is stated: the middle of the measured volume.",
        );
        let section =
            LinearAxis::ALL.into_iter().zip(points_mm).fold(section, |section, (axis, mm)| {
                section.with_numbers(
                    format!("point_{}_mm", axis.name()),
                    mm.map(|mm| round_to_decimals(mm, MACHINE_FILE_DECIMALS)),
                )
            });
        out.sections.push(section);
    }
    out.write_angular_errors(warnings);
    out.write_rotary_axis_lines();
    let edit = MachineFileEdit { sections: out.sections, ..MachineFileEdit::default() };
    (edit, out.written)
}

struct SectionWriter<'a> {
    machine: &'a Machine,
    constants: &'a ErrorParameters,
    mean: &'a [f64],
    known: &'a [ErrorAssessment],
    sections: Vec<NewSection>,
    written: Vec<GeometricError>,
}

impl SectionWriter<'_> {
    /// Returns line and forms of an error; `None` where they are not worth a section.
    fn line_and_modes(&self, error: GeometricError) -> Option<(f64, Vec<f64>)> {
        let known = self.known.iter().find(|assessment| assessment.error == error)?;
        if !known.acts || known.size.abs() < MIN_WRITTEN_ERROR {
            return None;
        }
        let (mut line, mut forms) = (0.0, Vec::new());
        for at in self.constants.indices_of_error(error) {
            match self.constants.all[at].part {
                ErrorPart::Form(_) => forms.push(self.mean[at]),
                _ => line = self.mean[at],
            }
        }
        Some((line, forms))
    }

    fn error_spline(&self, error: GeometricError) -> Option<BSpline> {
        let (line, forms) = self.line_and_modes(error)?;
        let modes = self.constants.modes[error.motion_axis()?.index()].as_ref()?;
        Some(modes.to_spline(&forms, line))
    }

    fn section_comment(&self, error: GeometricError) -> String {
        let known =
            self.known.iter().find(|assessment| assessment.error == error && assessment.is_known);
        match known {
            Some(it) => {
                format!(
                    "{error}, from trueup fit volume: ±{:.2} {} (95 %).",
                    it.half_width,
                    error.unit()
                )
            }
            None => format!(
                "{error}, from trueup fit volume: not known by itself, right with the others where it was measured."
            ),
        }
    }

    fn write_positioning_errors(&mut self, warnings: &mut Vec<String>) {
        for axis in LinearAxis::ALL {
            let error = GeometricError::Position(axis);
            let Some(curve) = self.error_spline(error) else { continue };
            let own = &self.machine.axes[axis.index()];
            if own.dual.is_some() {
                warnings.push(format!(
                    "{} has two drives: its positions are not written. `trueup fit pitch` fits both tables",
                    axis.name()
                ));
                continue;
            }
            let pitch = sum_curve_and_table(&curve, own.pitch.as_ref());
            self.sections
                .push(pitch.to_section(axis).with_header_comment(self.section_comment(error)));
            self.written.push(error);
        }
    }

    fn write_straightness(&mut self) {
        for error in self.constants.distinct_errors() {
            let GeometricError::Straightness(axis, along) = error else { continue };
            let Some(curve) = self.error_spline(error) else { continue };
            let there = self.machine.straightness.iter();
            let mut there = there.filter(|curve| (curve.error, curve.along) == (axis, along));
            let sum = sum_splines(curve, there.next().map(|curve| &curve.spline), None);
            self.push_spline(NewSection::new(error.machine_file_key()), error, sum, "control_um");
        }
    }

    fn push_spline(
        &mut self,
        section: NewSection,
        error: GeometricError,
        spline: BSpline,
        control: &str,
    ) {
        let round = |values: Vec<f64>| -> Vec<f64> {
            values
                .into_iter()
                .map(|value| round_to_decimals(value, MACHINE_FILE_DECIMALS))
                .collect()
        };
        let section = section
            .with_header_comment(self.section_comment(error))
            .with_integer("order", 4)
            .with_numbers("knots_mm", round(spline.knots_mm))
            .with_numbers(control, round(spline.control_um));
        self.sections.push(section);
        self.written.push(error);
    }

    fn write_squareness(&mut self) {
        let mut angles = self.machine.squareness.clone();
        let mut remarks = Vec::new();
        for error in self.constants.distinct_errors() {
            let GeometricError::Squareness(axis, along) = error else { continue };
            let Some((um_per_m, _)) = self.line_and_modes(error) else { continue };
            match angles.iter_mut().find(|angle| (angle.error, angle.along) == (axis, along)) {
                Some(angle) => {
                    angle.um_per_m =
                        round_to_decimals(angle.um_per_m + um_per_m, MACHINE_FILE_DECIMALS)
                }
                None => {
                    let um_per_m = round_to_decimals(um_per_m, MACHINE_FILE_DECIMALS);
                    angles.push(Squareness { error: axis, along, um_per_m });
                }
            }
            remarks.push(self.section_comment(error));
            self.written.push(error);
        }
        if !remarks.is_empty() {
            let section = remarks
                .into_iter()
                .fold(NewSection::new("squareness"), NewSection::with_header_comment);
            let section = angles
                .iter()
                .fold(section, |section, angle| section.with_number(angle.name(), angle.um_per_m));
            self.sections.push(section);
        }
    }

    fn write_angular_errors(&mut self, warnings: &mut Vec<String>) {
        for error in self.constants.distinct_errors() {
            let GeometricError::Angle(about, along) = error else { continue };
            let Some(curve) = self.error_spline(error) else { continue };
            let there = self.machine.volume.angular.iter();
            let mut there = there.filter(|motion| (motion.about, motion.along) == (about, along));
            let sum = match there.next().map(|motion| &motion.angle) {
                None => curve,
                Some(AngleProfile::Curve(spline)) => sum_splines(curve, Some(spline), None),
                Some(&AngleProfile::Line(per_m)) => {
                    let travel_mm = self.machine.axes[along.index()].travel_mm;
                    if travel_mm.is_none() {
                        let [first, last] = ends_mm(&curve).map(|mm| round_to_decimals(mm, 1));
                        let (key, axis) = (error.machine_file_key(), along.name());
                        warnings.push(format!(
                            "{key} was a line and is a curve now: below {axis} {first} mm and above {last} mm its ends are held. \
                             With travel_mm under [axis.{axis}] it goes on over the whole travel"
                        ));
                    }
                    sum_splines(curve, None, Some(ExistingLine { per_m, travel_mm }))
                }
            };
            self.push_spline(NewSection::new(error.machine_file_key()), error, sum, "control_urad");
        }
    }

    fn write_rotary_axis_lines(&mut self) {
        for axis in RotaryAxis::ALL {
            let there = self.machine.volume.rotary.iter().find(|location| location.axis == axis);
            let (mut numbers, mut remarks) = (Vec::new(), Vec::new());
            for error in self.constants.distinct_errors() {
                let (of, before) = match error {
                    GeometricError::Shift(along, of) => {
                        (of, there.map_or(0.0, |location| location.shift_um[along.index()]))
                    }
                    GeometricError::Tilt(about, of) => {
                        (of, there.map_or(0.0, |location| location.tilt_urad[about.index()]))
                    }
                    _ => continue,
                };
                if of != axis {
                    continue;
                }
                let found = self.line_and_modes(error).map(|(value, _)| value);
                let value = round_to_decimals(before + found.unwrap_or(0.0), MACHINE_FILE_DECIMALS);
                if found.is_some() {
                    remarks.push(self.section_comment(error));
                    self.written.push(error);
                }
                if value != 0.0 {
                    let key = error.machine_file_key();
                    numbers.push((key.rsplit('.').next().unwrap_or_default().to_string(), value));
                }
            }
            if remarks.is_empty() {
                continue;
            }
            let section = NewSection::new(format!("rotary.{}", axis.name()))
                .with_preserved_keys(&["point_mm"]);
            let section = remarks.into_iter().fold(section, NewSection::with_header_comment);
            self.sections.push(
                numbers
                    .into_iter()
                    .fold(section, |section, (key, value)| section.with_number(key, value)),
            );
        }
    }
}

/// Returns a table of a curve and of the table that was there.
fn sum_curve_and_table(curve: &BSpline, there: Option<&PitchErrorTable>) -> PitchErrorTable {
    let ends = [curve.knots_mm[0], curve.knots_mm[curve.knots_mm.len() - 1]];
    let (mut first, mut last) = (ends[0], ends[1]);
    let mut step = (last - first) / TABLE_INTERVALS as f64;
    if let Some(there) = there {
        let end = there.start_mm + there.step_mm * (there.forward_um.len() as f64 - 1.0);
        (first, last) = (first.min(there.start_mm), last.max(end));
        step = step.min(there.step_mm);
    }
    first = round_to_decimals(first, MACHINE_FILE_DECIMALS);
    step = round_to_decimals(
        step.max((last - first) / MAX_TABLE_POINTS as f64),
        MACHINE_FILE_DECIMALS,
    );
    let points = ((last - first) / step).ceil() as usize + 1;
    let of = |direction: f64| -> Vec<f64> {
        let um = |n: usize| {
            let mm = first + step * n as f64;
            spline_value_um(curve, mm)
                + there.map_or(0.0, |there| pitch_error_um(there, mm, direction))
        };
        (0..points).map(|n| round_to_decimals(um(n), MACHINE_FILE_DECIMALS)).collect()
    };
    let reverse_um = there.and_then(|there| there.reverse_um.as_ref()).map(|_| of(-1.0));
    PitchErrorTable { start_mm: first, step_mm: step, forward_um: of(1.0), reverse_um }
}

/// A line through 0 that the file has, which ends nowhere.
#[derive(Clone, Copy)]
struct ExistingLine {
    per_m: f64,
    /// The travel of its axis, where the file states it.
    travel_mm: Option<[f64; 2]>,
}

fn ends_mm(spline: &BSpline) -> [f64; 2] {
    [spline.knots_mm[0], spline.knots_mm[spline.knots_mm.len() - 1]]
}

/// Returns the sum of a curve and of the spline or the line that was there, over all that they and the travel reach. The end of
/// each spline is held beyond it, so that the sum has a bend there.
fn sum_splines(curve: BSpline, there: Option<&BSpline>, line: Option<ExistingLine>) -> BSpline {
    let mut knots: Vec<f64> = curve.knots_mm.clone();
    knots.extend(there.iter().flat_map(|curve| curve.knots_mm.iter().copied()));
    knots.extend(line.and_then(|line| line.travel_mm).into_iter().flatten());
    knots.sort_unstable_by(f64::total_cmp);
    let (first, last) = (knots[0], knots[knots.len() - 1]);
    knots.dedup_by(|a, b| (*a - *b).abs() < 1e-3 * (last - first));
    // At a knot that stands there three times the slope may jump: at the end of a spline, and where a spline has such a knot.
    let times = |knot: f64| {
        let near = |value: &&f64| (**value - knot).abs() < 1e-3 * (last - first);
        let own = |spline: &BSpline| spline.knots_mm.iter().filter(near).count();
        [Some(&curve), there].into_iter().flatten().map(own).max().unwrap_or(0).clamp(1, 3)
    };
    let inner = knots[1..knots.len() - 1].iter();
    let inner: Vec<f64> = inner.flat_map(|&knot| vec![knot; times(knot)]).collect();
    let of_line = |mm: f64| line.map_or(0.0, |line| line.per_m * mm / 1000.0);
    let at_mm = |mm: f64| {
        spline_value_um(&curve, mm)
            + there.map_or(0.0, |spline| spline_value_um(spline, mm))
            + of_line(mm)
    };
    let mut at: Vec<f64> = (0..=SPLINE_SAMPLE_INTERVALS)
        .map(|n| first + (last - first) * f64::from(n) / f64::from(SPLINE_SAMPLE_INTERVALS))
        .collect();
    // Each piece has points of its own.
    let inside = |pair: &[f64]| [1.0, 2.0, 3.0].map(|n| pair[0] + (pair[1] - pair[0]) * n / 4.0);
    at.extend(knots.windows(2).flat_map(inside));
    at.sort_unstable_by(f64::total_cmp);
    let points = at.iter().map(|mm| (*mm, at_mm(*mm), 1.0));
    let fitted = bspline::fit_least_squares_spline(
        bspline::clamped_knots(4, first, &inner, last),
        4,
        points,
    );
    fitted.map_or(curve.clone(), |fitted| fitted.spline)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spline(knots_mm: &[f64], control_um: &[f64]) -> BSpline {
        BSpline { order: 4, knots_mm: knots_mm.to_vec(), control_um: control_um.to_vec() }
    }

    #[test]
    fn a_sum_is_right_to_the_ends_of_the_travel_and_of_both_curves() {
        let curve = spline(
            &[200.0, 200.0, 200.0, 200.0, 500.0, 600.0, 600.0, 600.0, 600.0],
            &[-8.0, 3.0, -6.0, 5.0, 12.0],
        );
        let wider =
            spline(&[0.0, 0.0, 0.0, 0.0, 900.0, 900.0, 900.0, 900.0], &[1.0, 4.0, -2.0, 7.0]);
        let within = spline(
            &[300.0, 300.0, 300.0, 300.0, 450.0, 450.0, 450.0, 450.0],
            &[2.0, 9.0, -9.0, 4.0],
        );
        let line = ExistingLine { per_m: 50.0, travel_mm: Some([-100.0, 1000.0]) };
        for (there, line) in [(None, Some(line)), (Some(&wider), None), (Some(&within), None)] {
            let sum = sum_splines(curve.clone(), there, line);
            sum.validate().expect("a spline of a machine file");
            let [first, last] = ends_mm(&sum);
            let reach_mm = match (line, there == Some(&wider)) {
                (Some(_), _) => [-100.0, 1000.0],
                (None, true) => [0.0, 900.0],
                (None, false) => [200.0, 600.0],
            };
            assert_eq!([first, last], reach_mm);
            for n in 0..=220 {
                let mm = first + (last - first) * f64::from(n) / 220.0;
                let whole = spline_value_um(&curve, mm)
                    + there.map_or(0.0, |spline| spline_value_um(spline, mm))
                    + line.map_or(0.0, |line| line.per_m * mm / 1000.0);
                let um = spline_value_um(&sum, mm);
                assert!((um - whole).abs() < 1e-6, "at {mm} mm: {um}, and it is {whole}");
            }
        }
    }
}
