//! How large each correction may become: the largest error that an entry of the file can make.

use crate::{
    effect::{BoardTerm, Multiplier, Quantity, SpeedExponent, relative_heat_input},
    machine_file::{Machine, Term},
    model::tool_growth_term,
    sections::{AngleProfile, LinearAxis, PitchErrorTable, ThermalLaw},
};

/// By how much a machine's temperature may differ from the one it is right at, in K: half of what lies
/// between the 20 °C of ISO 1 and the 40 °C at which EN 60204-1 lets a machine work.
pub(super) const MAX_TEMPERATURE_DEVIATION_K: f64 = 10.0;

/// The largest error that one entry can make on an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorBound {
    /// Its key in the machine file.
    pub key: String,
    /// In µm, either way; `None`: it grows with a travel that the file does not say.
    pub largest_um: Option<f64>,
}

/// Returns what the file can make on an axis by its position and its heat, and by the terms of the elongation; without
/// the elongation's source.
pub(super) fn axis_error_bounds(machine: &Machine, axis: LinearAxis) -> Vec<ErrorBound> {
    let model = &machine.axes[axis.index()];
    let key = |name: &str| format!("axis.{}.{name}", axis.name());
    let own_mm = machine.axis_range_mm(axis);
    let mut parts = Vec::new();
    let mut add = |key: String, largest_um: Option<f64>| parts.push(ErrorBound { key, largest_um });
    if let Some(thermal) = &model.thermal {
        add(key("thermal"), max_thermal_error_um(thermal, own_mm));
    }
    let drives = [model.pitch.as_ref(), model.dual.as_ref().map(|dual| &dual.pitch)];
    if let Some(um) = drives.into_iter().flatten().map(max_table_error_um).reduce(f64::max) {
        add(key("pitch"), Some(um));
    }
    if let Some(backlash) = &model.backlash {
        add(key("backlash"), Some(backlash.width_um.abs()));
    }
    for curve in machine.straightness.iter().filter(|curve| curve.error == axis) {
        add(format!("straightness.{}", curve.name()), Some(max_abs(&curve.spline.control_um)));
    }
    for line in machine.squareness.iter().filter(|line| line.error == axis) {
        let along_mm = machine.axis_range_mm(line.along);
        add(
            format!("squareness.{}", line.name()),
            along_mm.map(|mm| max_linear_error_um(line.um_per_m, mm)),
        );
    }
    for (key, largest_um) in max_volumetric_errors_um(machine, axis) {
        add(key, largest_um);
    }
    for (index, term) in machine.terms.iter().enumerate() {
        if term.quantity.axis() == Some(axis) && term.effect.is_compensable() {
            let forms = term.effect.board_terms();
            let um = forms
                .iter()
                .map(|form| max_term_error_um(machine, form, own_mm))
                .sum::<Option<f64>>();
            add(format!("term[{index}]"), um.map(|um| um + term.constant_um.abs()));
        }
    }
    let along = elongation_fraction(machine, axis);
    let of_growth = |term: &Term| {
        let is_of_growth = term.quantity == Quantity::Elongation && along > 0.0;
        is_of_growth && term.effect.is_compensable() && machine.has_elongation()
    };
    for (index, term) in machine.terms.iter().enumerate().filter(|(_, term)| of_growth(term)) {
        let forms = term.effect.board_terms();
        // What changes a law of the source is in that law's own part.
        if !forms.is_empty() {
            let um =
                forms.iter().map(|form| max_term_elongation_um(machine, form)).sum::<Option<f64>>();
            add(format!("term[{index}]"), um.map(|um| along * (um + term.constant_um.abs())));
        }
    }
    if let Some(tools) = machine.spindle.tools.as_ref().filter(|_| along > 0.0) {
        let forms = tool_growth_term(tools).effect.board_terms();
        let um =
            forms.iter().map(|form| max_term_elongation_um(machine, form)).sum::<Option<f64>>();
        add("spindle.tools".into(), um.map(|um| along * um));
    }
    parts
}

/// Returns what angular errors and lines of rotary axes can make on an axis: the largest angle at the longest lever
/// over the travels. `None`: by a travel that the file does not say.
fn max_volumetric_errors_um(machine: &Machine, axis: LinearAxis) -> Vec<(String, Option<f64>)> {
    let volume = &machine.volume;
    let Some(chain) = &volume.chain else { return Vec::new() };
    let mut parts = Vec::new();
    let tip_mm = volume.tool.tip_offset_mm(machine.tool_direction);
    let length = |mm: [f64; 3]| mm.iter().map(|mm| mm * mm).sum::<f64>().sqrt();
    // However the head turns it: from the nose to the first line, from line to line, and to the tip.
    let mut from_mm = [0.0; 3];
    let mut reach = 0.0;
    for &axis in &chain.head {
        let point_mm = volume.axis_line_point_mm(axis);
        reach += length([0, 1, 2].map(|n| point_mm[n] - from_mm[n]));
        from_mm = point_mm;
    }
    reach += length([0, 1, 2].map(|n| tip_mm[n] - from_mm[n]));
    let reach_of_tool_mm = if chain.head.is_empty() { tip_mm.map(f64::abs) } else { [reach; 3] };
    let other = |about: usize| 3 - axis.index() - about;
    for it in &volume.angular {
        if it.about.index() == axis.index() {
            continue;
        }
        let lever = LinearAxis::ALL[other(it.about.index())];
        let angle_urad = match &it.angle {
            AngleProfile::Curve(spline) => Some(max_abs(&spline.control_um)),
            AngleProfile::Line(urad_per_m) => {
                machine.axis_range_mm(it.along).map(|mm| max_linear_error_um(*urad_per_m, mm))
            }
        };
        let point_mm = volume.point_mm[it.along.index()][lever.index()];
        let travel_mm = match chain.lever_axes(it.along).contains(&lever) {
            true => machine.axis_range_mm(lever),
            false => Some([0.0; 2]),
        };
        let lever_mm = travel_mm.map(|ends| {
            ends.map(|mm| (mm - point_mm).abs()).into_iter().fold(0.0, f64::max)
                + reach_of_tool_mm[lever.index()]
        });
        let um = angle_urad.zip(lever_mm).map(|(urad, mm)| urad * mm / 1000.0);
        parts.push((format!("angular.{}", it.name()), um));
    }
    for it in volume.rotary.iter().filter(|location| !location.is_error_free()) {
        let tilts = it.tilt_urad.iter().any(|urad| *urad != 0.0);
        let is_alone = chain.rotary_axes().len() == 1;
        let um = (!tilts && is_alone).then(|| it.shift_um[axis.index()].abs());
        parts.push((format!("rotary.{}", it.axis.name()), um));
    }
    parts
}

/// Returns the share of the growth that comes to lie along an axis: all of it where a head can turn the tool there.
pub(super) fn elongation_fraction(machine: &Machine, axis: LinearAxis) -> f64 {
    match machine.head_axes.is_empty() {
        true => machine.tool_direction[axis.index()].abs(),
        false => 1.0,
    }
}

/// Returns what a form can add to the elongation, in µm: by what its source can be, and the rated speed. `None`: by a
/// speed or a load that the file does not say.
fn max_term_elongation_um(machine: &Machine, form: &BoardTerm) -> Option<f64> {
    let source = machine.spindle.source.map(|source| format!("spindle.{}", source.name()));
    let grown = || {
        let parts = elongation_bounds(machine);
        let own = parts.into_iter().find(|part| Some(&part.key) == source.as_ref());
        own.and_then(|part| part.largest_um).unwrap_or(0.0)
    };
    Some(match *form {
        BoardTerm::Gain(gain) => (gain - 1.0).abs() * grown(),
        BoardTerm::Curvature(per_um) => per_um.abs() * grown().powi(2),
        BoardTerm::Speed(um_per_krpm2) => {
            um_per_krpm2.abs() * relative_heat_input(SpeedExponent::Second, rated_rpm(machine)?)
        }
        BoardTerm::Tool { ref times, .. } | BoardTerm::Condition { ref times, .. } => {
            form.max_category_amplitude()
                * match times {
                    Multiplier::Speed2 => {
                        relative_heat_input(SpeedExponent::Second, rated_rpm(machine)?)
                    }
                    Multiplier::Growth => grown(),
                    _ => 1.0,
                }
        }
        // It takes away.
        BoardTerm::Saturation(_) => 0.0,
        ref other => max_term_error_um(machine, other, None)?,
    })
}

fn rated_rpm(machine: &Machine) -> Option<f64> {
    machine.spindle.warmup.as_ref()?.rated_rpm
}

fn max_thermal_error_um(thermal: &ThermalLaw, own_mm: Option<[f64; 2]>) -> Option<f64> {
    let arm_m = match thermal.mode.has_position_term() {
        false => 0.0,
        true => {
            let arm = |mm: f64| (mm - thermal.origin_mm).abs() / 1000.0;
            own_mm.map(|[low, high]| arm(low).max(arm(high)))?
        }
    };
    let constant = f64::from(u8::from(thermal.mode.has_constant_term()));
    let um = |constant_um: f64, slope_um_per_m: f64| {
        (constant * constant_um).abs() + (slope_um_per_m * arm_m).abs()
    };
    Some(match &thermal.table {
        Some(rows) => {
            rows.iter().map(|row| um(row.constant_um, row.slope_um_per_m)).fold(0.0, f64::max)
        }
        None => um(
            thermal.constant_um_per_c * MAX_TEMPERATURE_DEVIATION_K,
            thermal.slope_um_per_m_per_c * MAX_TEMPERATURE_DEVIATION_K,
        ),
    })
}

fn max_term_error_um(machine: &Machine, form: &BoardTerm, own_mm: Option<[f64; 2]>) -> Option<f64> {
    Some(match form {
        &BoardTerm::Offset(um) => um.abs(),
        BoardTerm::Heat(heat) => (heat.um_per_c * MAX_TEMPERATURE_DEVIATION_K).abs(),
        BoardTerm::HeatSlope(heat) => {
            max_linear_error_um(heat.um_per_c * MAX_TEMPERATURE_DEVIATION_K, own_mm?)
        }
        BoardTerm::SpeedHeat(it) => {
            it.um_per_unit.abs() * relative_heat_input(it.power, rated_rpm(machine)?)
        }
        &BoardTerm::OwnPosition(um_per_m) => max_linear_error_um(um_per_m, own_mm?),
        &BoardTerm::Position { axis, um_per_m } => {
            max_linear_error_um(um_per_m, machine.axis_range_mm(axis)?)
        }
        &BoardTerm::Reversed { width_um, um_per_m } => match um_per_m {
            0.0 => width_um.abs(),
            _ => width_um.abs() + max_linear_error_um(um_per_m, own_mm?),
        },
        BoardTerm::Table(pitch) => max_table_error_um(pitch),
        BoardTerm::Curve(_, spline) => max_abs(&spline.control_um),
        BoardTerm::Thermal(thermal) => max_thermal_error_um(thermal, own_mm)?,
        &BoardTerm::Wave { amplitude_um, .. } => amplitude_um.abs(),
        &BoardTerm::Time { amplitude_um, .. } => amplitude_um.abs(),
        BoardTerm::Tool { times, .. } | BoardTerm::Condition { times, .. } => match times {
            Multiplier::One => form.max_category_amplitude(),
            Multiplier::Position => max_linear_error_um(form.max_category_amplitude(), own_mm?),
            _ => return None,
        },
        BoardTerm::Gain(_)
        | BoardTerm::Curvature(_)
        | BoardTerm::Saturation(_)
        | BoardTerm::Speed(_)
        | BoardTerm::Load(_)
        | BoardTerm::Tilt(_) => return None,
    })
}

fn max_table_error_um(pitch: &PitchErrorTable) -> f64 {
    max_abs(&pitch.forward_um).max(pitch.reverse_um.as_deref().map_or(0.0, max_abs))
}

fn max_linear_error_um(um_per_m: f64, [low, high]: [f64; 2]) -> f64 {
    (um_per_m * low.abs().max(high.abs()) / 1000.0).abs()
}

/// Of a spline's control points: the curve lies within them.
fn max_abs(um: &[f64]) -> f64 {
    um.iter().fold(0.0, |largest, um| um.abs().max(largest))
}

/// Returns what the elongation can be, in µm either way, each source by its section; a sensor's is its range.
pub(super) fn elongation_bounds(machine: &Machine) -> Vec<ErrorBound> {
    let spindle = &machine.spindle;
    if spindle.source.is_none() {
        return Vec::new();
    }
    let part = |key: &str, um: f64| ErrorBound { key: key.into(), largest_um: Some(um.abs()) };
    let sensor = spindle.sensor.as_ref().map(|model| {
        let input = machine.inputs.as_ref().and_then(|inputs| inputs.sensor);
        let at = |counts: f64| crate::model::elongation_um(model, counts).abs();
        let largest_um = input.map(|input| at(0.0).max(at(input.counts_full_scale)));
        ErrorBound { key: "spindle.sensor".into(), largest_um }
    });
    let temperature = spindle.temperature.as_ref();
    let temperature = temperature.map(|temperature| {
        part("spindle.temperature", temperature.k_um_per_c * MAX_TEMPERATURE_DEVIATION_K)
    });
    let warmup = spindle.warmup.as_ref().map(|warmup| part("spindle.warmup", warmup.max_um));
    [sensor, temperature, warmup].into_iter().flatten().collect()
}
