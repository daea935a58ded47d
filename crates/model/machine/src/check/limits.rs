//! The limits: a slew that no axis notices, and room for what they limit.

use super::{
    error_bounds::{self, ErrorBound, MAX_TEMPERATURE_DEVIATION_K},
    warning::Warning,
};
use crate::{envelope, location::InputFileError, machine_file::Machine, sections::LinearAxis};

/// The fastest change of an offset as a share of the axis's rapid traverse: the default of Siemens' MD32760
/// (field notes), at which a following error does not show.
const MAX_SLEW_TO_RAPID_RATIO: f64 = 0.01;

/// The rapid traverse of an axis that does not say its own, in mm/min: what a slow machine tool does.
pub(super) const DEFAULT_RAPID_MM_PER_MIN: f64 = 10_000.0;

pub(super) fn warnings(machine: &Machine) -> Vec<Warning> {
    let of_axes = LinearAxis::ALL.into_iter().flat_map(|axis| limit_warnings(machine, axis));
    let mut all: Vec<Warning> = slew_rate_warning(machine)
        .into_iter()
        .chain(of_axes)
        .chain(elongation_limit_warnings(machine))
        .collect();
    all.extend(cancelling_terms_warning(machine));
    all
}

/// Terms that leave what is possible, which `compile` refuses, or take each other back.
fn cancelling_terms_warning(machine: &Machine) -> Option<Warning> {
    match envelope::reject_limit_violations(machine) {
        // Of a machine with [inputs] it is reported that no board can run it.
        Err(_) if machine.inputs.is_some() => None,
        Err(InputFileError { place, rule, help, .. }) => {
            Some(Warning { place, what: rule, help: help.unwrap_or_default() })
        }
        Ok(()) => envelope::find_cancelling_terms(machine).map(|pair| {
            let [first, second] = pair.terms;
            let [one, other] = pair.um;
            let what = format!(
                "and term[{second}] take each other back on {}: {one:+.0} and {other:+.0} µm once settled",
                pair.axis.name()
            );
            let help = "right after a start, or with one of them a little off, what is left is anything: take \
                        both out, or diagnose anew";
            Warning::for_key(machine, &format!("term[{first}]"), &what, help)
        }),
    }
}

/// Returns the fastest slew that an axis of this rapid traverse does not notice, in µm/s.
pub(super) fn max_negligible_slew_um_per_s(rapid_mm_per_min: f64) -> f64 {
    const UM_PER_S_PER_MM_PER_MIN: f64 = 1000.0 / 60.0;
    rapid_mm_per_min * UM_PER_S_PER_MM_PER_MIN * MAX_SLEW_TO_RAPID_RATIO
}

fn slew_rate_warning(machine: &Machine) -> Option<Warning> {
    let rapids = LinearAxis::ALL.map(|axis| (axis, machine.axes[axis.index()].rapid_mm_per_min));
    let stated = rapids.into_iter().filter_map(|(axis, rapid)| Some((axis, rapid?)));
    let slowest = stated.min_by(|a, b| a.1.total_cmp(&b.1));
    let rapid = slowest.map_or(DEFAULT_RAPID_MM_PER_MIN, |(_, rapid)| rapid);
    let most = max_negligible_slew_um_per_s(rapid);
    let slew = machine.limits.slew_um_per_s;
    if slew <= most {
        return None;
    }
    let (whose, help) = match slowest {
        Some((axis, _)) => (
            format!("axis {}, whose rapid traverse is {rapid} mm/min", axis.name()),
            format!("write slew_um_per_s = {most:.0} or less"),
        ),
        None => (
            format!("an axis of {rapid} mm/min, a slow machine's"),
            "write rapid_mm_per_min into [axis.x], [axis.y] and [axis.z] if yours are faster, or a \
             smaller slew_um_per_s: heat needs 20"
                .into(),
        ),
    };
    let what = format!(
        "{slew} is more than 1 % ({most:.0} µm/s) of {whose}: the offset would jerk the axis"
    );
    Some(Warning::for_key(machine, "limits.slew_um_per_s", &what, help))
}

/// Parts that alone are larger than their axis's limit.
fn limit_warnings(machine: &Machine, axis: LinearAxis) -> Vec<Warning> {
    let limit_um = machine.limits.max_um[axis.index()];
    let parts = error_bounds::axis_error_bounds(machine, axis).into_iter();
    parts.filter_map(|part| limit_exceeded_warning(machine, &part, axis, limit_um)).collect()
}

/// Models of the growth that reach beyond the limit on the axis that the tool lies along. The sensor's
/// range is no growth: a sensor may well see more than the limit lets through.
fn elongation_limit_warnings(machine: &Machine) -> Vec<Warning> {
    let along = LinearAxis::ALL.into_iter().max_by(|a, b| {
        let share = |axis: &LinearAxis| machine.tool_direction[axis.index()].abs();
        share(a).total_cmp(&share(b))
    });
    let Some(axis) = along else { return Vec::new() };
    let share = machine.tool_direction[axis.index()].abs();
    let limit_um = machine.limits.max_um[axis.index()];
    let parts = error_bounds::elongation_bounds(machine)
        .into_iter()
        .filter(|part| part.key != "spindle.sensor");
    let parts =
        parts.map(|part| ErrorBound { largest_um: part.largest_um.map(|um| um * share), ..part });
    parts.filter_map(|part| limit_exceeded_warning(machine, &part, axis, limit_um)).collect()
}

fn limit_exceeded_warning(
    machine: &Machine,
    part: &ErrorBound,
    axis: LinearAxis,
    limit_um: f64,
) -> Option<Warning> {
    let um = part.largest_um.filter(|um| *um > limit_um)?;
    let heat = if part.key.ends_with("thermal") || part.key.ends_with("temperature") {
        format!(" within {MAX_TEMPERATURE_DEVIATION_K} K")
    } else {
        String::new()
    };
    let axis = axis.name();
    let what =
        format!("{limit_um} µm is below what it limits: {} makes {um:.1} µm{heat}", part.key);
    let help = format!(
        "a larger limits.max_um.{axis}, or a smaller correction; beyond the limit the offset stands still"
    );
    Some(Warning::for_key(machine, &format!("limits.max_um.{axis}"), &what, help))
}
