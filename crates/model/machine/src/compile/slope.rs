//! How steep a correction may be over the way of an axis: the same rule for tables, curves, waves and
//! lines, whatever they come from.
//!
//! ```text
//! |slope|  ≤  slew_um_per_s / 0.5 mm/s
//! ```
//!
//! The offset changes by slope·feed, and the board lets it change by `limits.slew_um_per_s` at most. A
//! correction that falls behind at the slowest feed already is never where it should be while the axis
//! moves. With the slew of 20 µm/s that a machine file has if it says nothing that is 40 µm/mm: a
//! twenty-fifth of the way itself, of which no screw or scale is capable, but a table in another unit, a
//! broken instrument, and a wave between the targets are.

use std::f64::consts::TAU;

use super::curve::{spline_pieces, steepest_slope};
use crate::{
    effect::{BoardTerm, Effect, Multiplier},
    location::InputFileError,
    machine_file::Machine,
    sections::{AngleProfile, Limits, LinearAxis, PitchErrorTable},
    spline::BSpline,
};

/// The slowest feed at which a correction is followed, in mm/s: 30 mm/min, about the slowest that anything
/// is finished at (a cutter of 1 mm: 2 teeth of 3 µm at 5000 r/min).
pub(crate) const MIN_FEED_MM_PER_S: f64 = 0.5;

/// A slope over an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct SlopeAtPosition {
    /// In µm per mm; positive: the error rises with the position.
    pub um_per_mm: f64,
    /// Where, in mm; 0 for what is as steep everywhere.
    pub at_mm: f64,
}

impl SlopeAtPosition {
    /// Returns the steeper one, whatever their signs are.
    fn steeper(self, other: Self) -> Self {
        if other.um_per_mm.abs() > self.um_per_mm.abs() { other } else { self }
    }
}

/// Returns the steepest slope that a board with these limits follows, in µm per mm, above 0.
///
/// ```
/// use trueup_machine::{compile::max_slope_um_per_mm, machine_file::Limits};
/// assert_eq!(max_slope_um_per_mm(&Limits::default()), 40.0);
/// ```
#[must_use]
pub fn max_slope_um_per_mm(limits: &Limits) -> f64 {
    limits.slew_um_per_s / MIN_FEED_MM_PER_S
}

/// Returns the rule that a slope breaks on a board with these limits; none that it keeps.
#[must_use]
pub(crate) fn describe_slope_violation(slope: SlopeAtPosition, limits: &Limits) -> Option<String> {
    let SlopeAtPosition { um_per_mm, at_mm } = slope;
    let most = max_slope_um_per_mm(limits);
    (um_per_mm.abs() > most).then(|| {
        format!(
            "rises by {um_per_mm:.1} µm per mm at {at_mm} mm, more than {most}. At a slew of {} \
             µm/s the board falls behind at 30 mm/min already; are the units right?",
            limits.slew_um_per_s
        )
    })
}

/// Returns the steepest slope of a table.
#[must_use]
pub(crate) fn max_table_slope(pitch: &PitchErrorTable) -> SlopeAtPosition {
    let tables = [Some(&pitch.forward_um), pitch.reverse_um.as_ref()].into_iter().flatten();
    let slopes = tables.flat_map(|um| {
        um.windows(2).enumerate().map(|(number, pair)| SlopeAtPosition {
            um_per_mm: (pair[1] - pair[0]) / pitch.step_mm,
            at_mm: pitch.start_mm + pitch.step_mm * number as f64,
        })
    });
    slopes.fold(SlopeAtPosition::default(), SlopeAtPosition::steeper)
}

/// Returns the steepest slope of a curve; none of one that the board cannot have at all.
#[must_use]
pub(crate) fn max_curve_slope(spline: &BSpline) -> SlopeAtPosition {
    let (um_per_mm, at_mm) =
        spline_pieces(spline).map_or((0.0, 0.0), |pieces| steepest_slope(&pieces));
    SlopeAtPosition { um_per_mm, at_mm }
}

/// Returns the steepest slope of a cause with its values over any axis, at a lever of 1 m where it tilts.
#[must_use]
pub(crate) fn max_effect_slope(effect: &Effect) -> SlopeAtPosition {
    effect
        .board_terms()
        .iter()
        .map(max_term_slope)
        .fold(SlopeAtPosition::default(), SlopeAtPosition::steeper)
}

fn max_term_slope(form: &BoardTerm) -> SlopeAtPosition {
    let even = |um_per_mm| SlopeAtPosition { um_per_mm, at_mm: 0.0 };
    match form {
        BoardTerm::Table(pitch) => max_table_slope(pitch),
        BoardTerm::Curve(_, spline) => max_curve_slope(spline),
        BoardTerm::Tilt(tilt) => max_angle_slope(&tilt.angle),
        &BoardTerm::Wave { period_mm, harmonic, amplitude_um, .. } => {
            even(amplitude_um * TAU * f64::from(harmonic) / period_mm)
        }
        BoardTerm::OwnPosition(um_per_m)
        | BoardTerm::Position { um_per_m, .. }
        | BoardTerm::Reversed { um_per_m, .. } => even(um_per_m / 1000.0),
        BoardTerm::Tool { times, .. } | BoardTerm::Condition { times, .. } => match times {
            Multiplier::Position => even(form.max_category_amplitude() / 1000.0),
            _ => even(0.0),
        },
        BoardTerm::Offset(_)
        | BoardTerm::Gain(_)
        | BoardTerm::Curvature(_)
        | BoardTerm::Saturation(_)
        | BoardTerm::Heat(_)
        | BoardTerm::HeatSlope(_)
        | BoardTerm::SpeedHeat(_)
        | BoardTerm::Time { .. }
        | BoardTerm::Speed(_)
        | BoardTerm::Load(_)
        | BoardTerm::Thermal(_) => even(0.0),
    }
}

/// Returns the steepest slope of what an angle makes at a lever of 1 m.
fn max_angle_slope(angle: &AngleProfile) -> SlopeAtPosition {
    match angle {
        AngleProfile::Line(urad_per_m) => {
            SlopeAtPosition { um_per_mm: urad_per_m / 1000.0, at_mm: 0.0 }
        }
        // Of a curve in µrad the value there is the same number in µm.
        AngleProfile::Curve(spline) => max_curve_slope(spline),
    }
}

/// Refuses the first part of `machine` that is too steep for its limits: what [`compile`](super::compile)
/// does, also where the rest of the file is not yet complete.
///
/// # Errors
/// One is; with the key and its place.
pub fn check_slopes(machine: &Machine) -> Result<(), InputFileError> {
    let mut parts: Vec<(String, SlopeAtPosition)> = Vec::new();
    for (axis, name) in machine.axes.iter().zip(LinearAxis::ALL) {
        let tables = [
            (axis.pitch.as_ref(), "pitch"),
            (axis.dual.as_ref().map(|dual| &dual.pitch), "dual.pitch"),
        ];
        for (pitch, key) in tables {
            parts.extend(
                pitch.map(|pitch| (format!("axis.{}.{key}", name.name()), max_table_slope(pitch))),
            );
        }
    }
    let curves = machine.straightness.iter();
    parts.extend(
        curves.map(|curve| {
            (format!("straightness.{}", curve.name()), max_curve_slope(&curve.spline))
        }),
    );
    let lines = machine.squareness.iter();
    parts.extend(lines.map(|squareness| {
        let slope = SlopeAtPosition { um_per_mm: squareness.um_per_m / 1000.0, at_mm: 0.0 };
        (format!("squareness.{}", squareness.name()), slope)
    }));
    let angles = machine.volume.angular.iter();
    parts.extend(
        angles.map(|motion| (format!("angular.{}", motion.name()), max_angle_slope(&motion.angle))),
    );
    let terms = machine.terms.iter().enumerate();
    parts.extend(
        terms.map(|(index, term)| (format!("term[{index}]"), max_effect_slope(&term.effect))),
    );
    match parts
        .iter()
        .find_map(|(key, slope)| Some((key, describe_slope_violation(*slope, &machine.limits)?)))
    {
        Some((key, rule)) => Err(machine.places.key_error(key, rule)),
        None => Ok(()),
    }
}
