//! One thing that two entries correct: the offset would be twice as large as the error.

use super::warning::Warning;
use crate::{
    effect::BoardTerm,
    machine_file::{Machine, Term},
    sections::{ElongationSource, LinearAxis},
    spline::spline_value_um,
};

/// Two numbers for one thing, measured twice, differ by less than this share.
const MAX_RELATIVE_DIFFERENCE: f64 = 0.2;

pub(super) fn warnings(machine: &Machine) -> Vec<Warning> {
    let mut warnings = Vec::new();
    warnings.extend(duplicate_term_warnings(machine));
    warnings.extend(duplicate_backlash_warnings(machine));
    warnings.extend(duplicate_squareness_warnings(machine));
    warnings.extend(duplicate_thermal_growth_warning(machine));
    warnings.extend(duplicate_angle_warnings(machine));
    warnings
}

fn term_key(index: usize) -> String {
    format!("term[{index}]")
}

fn are_nearly_equal(a: f64, b: f64) -> bool {
    a * b > 0.0 && (a - b).abs() <= MAX_RELATIVE_DIFFERENCE * a.abs().max(b.abs())
}

/// Returns two terms with the same cause, quantity and numbers.
fn duplicate_term_warnings(machine: &Machine) -> Vec<Warning> {
    let terms = machine.terms.iter().enumerate();
    let repeats = terms.filter_map(|(index, term)| {
        let before: &[Term] = machine.terms.get(..index)?;
        let first = before.iter().position(|earlier| earlier == term)?;
        let line = machine.places.locate(&term_key(first)).line;
        let what =
            format!("is the same as the [[term]] on line {line}: its error is corrected twice");
        Some(Warning::for_key(machine, &term_key(index), &what, "take one of the two out"))
    });
    repeats.collect()
}

/// Returns a `backlash` term next to a section that has the width already.
fn duplicate_backlash_warnings(machine: &Machine) -> Vec<Warning> {
    let terms = machine.terms.iter().enumerate();
    let doubled = terms.filter_map(|(index, term)| {
        let axis = term.quantity.axis()?;
        let model = &machine.axes[axis.index()];
        let section =
            model.backlash.map(|backlash| ("backlash", backlash.width_um)).or_else(|| {
                let pitch = model.pitch.as_ref()?;
                let pairs = pitch.reverse_um.as_ref()?.iter().zip(&pitch.forward_um);
                let widths: Vec<f64> = pairs.map(|(reverse, forward)| reverse - forward).collect();
                Some(("pitch.reverse_um", widths.iter().sum::<f64>() / widths.len() as f64))
            });
        let (name, width_um) = section?;
        let forms = term.effect.board_terms();
        let added_um = forms.iter().find_map(|form| match form {
            BoardTerm::Reversed { width_um, .. } => Some(*width_um),
            _ => None,
        })?;
        are_nearly_equal(width_um, added_um).then(|| {
            let what = format!(
                "adds {added_um} µm of backlash to the {width_um:.1} µm of axis.{}.{name}",
                axis.name()
            );
            let help = "if both are the same backlash, take one of them out";
            Warning::for_key(machine, &term_key(index), &what, help)
        })
    });
    doubled.collect()
}

/// Returns a squareness next to a straightness curve of the same two axes that still contains it: its ends are as
/// far apart as the squareness makes them.
fn duplicate_squareness_warnings(machine: &Machine) -> Vec<Warning> {
    let lines = machine.squareness.iter();
    let doubled = lines.filter_map(|line| {
        let same = |curve: &&crate::sections::Straightness| {
            curve.error == line.error && curve.along == line.along
        };
        let curve = machine.straightness.iter().find(same)?;
        let [first, last] = curve.spline.range_mm()?;
        let rise_um = spline_value_um(&curve.spline, last) - spline_value_um(&curve.spline, first);
        let line_um = line.um_per_m * (last - first) / 1000.0;
        are_nearly_equal(rise_um, line_um).then(|| {
            let what = format!(
                "makes {line_um:.1} µm over the length of straightness.{}, which rises by {rise_um:.1} µm itself",
                curve.name()
            );
            let help = "if the curve contains the squareness, take one of the two out";
            Warning::for_key(machine, &format!("squareness.{}", line.name()), &what, help)
        })
    });
    doubled.collect()
}

/// Returns terms that have the error of a turn that stands under `[angular]` as well: the axis that turns, the one in error and
/// the lever are the same.
fn duplicate_angle_warnings(machine: &Machine) -> Vec<Warning> {
    let volume = &machine.volume;
    let terms = machine.terms.iter().enumerate();
    let doubled = terms.filter_map(|(index, term)| {
        let error = term.quantity.axis()?;
        let forms = term.effect.board_terms();
        let tilt = forms.iter().find_map(|form| match form {
            BoardTerm::Tilt(tilt) => Some(tilt.clone()),
            _ => None,
        })?;
        let along = tilt.along.unwrap_or(error);
        // A turn moves neither along its own axis nor along its lever.
        let same = |motion: &&crate::sections::AngularErrorMotion| {
            motion.along == along
                && ![error, tilt.lever].iter().any(|axis| axis.index() == motion.about.index())
        };
        let angular = volume.angular.iter().find(same)?;
        let chain = volume.chain.as_ref()?;
        chain.lever_axes(along).contains(&tilt.lever).then(|| {
            let what = format!(
                "is the turn of angular.{} with the lever along {}, which is corrected already",
                angular.name(),
                tilt.lever.name().to_uppercase()
            );
            let help = "if both are the same angle, take one of them out";
            Warning::for_key(machine, &term_key(index), &what, help)
        })
    });
    doubled.collect()
}

/// Returns the growth of the spindle and a constant of the axis along it by the same thermometer.
fn duplicate_thermal_growth_warning(machine: &Machine) -> Option<Warning> {
    let spindle = machine.spindle.temperature.as_ref();
    let spindle =
        spindle.filter(|_| machine.spindle.source == Some(ElongationSource::Temperature))?;
    let axes = LinearAxis::ALL.into_iter();
    let axis =
        axes.filter(|axis| machine.tool_direction[axis.index()].abs() > 0.5).find(|axis| {
            let thermal = machine.axes[axis.index()].thermal.as_ref();
            let constant = |law: &crate::sections::ThermalLaw| {
                law.mode.has_constant_term() && law.constant_um_per_c != 0.0
            };
            thermal.is_some_and(|thermal| thermal.sensor == spindle.sensor && constant(thermal))
        })?;
    let what = format!(
        "is {}, which [spindle.temperature] goes by as well: both move the tool along {}",
        spindle.sensor,
        axis.name().to_uppercase()
    );
    let help = "if both are the growth of the spindle, take one of them out";
    Some(Warning::for_key(machine, &format!("axis.{}.thermal.sensor", axis.name()), &what, help))
}
