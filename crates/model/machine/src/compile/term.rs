//! The terms of a diagnosis for the board.
//!
//! Those that correct a constant of the model are in the machine already
//! ([`apply_constant_terms`](crate::model::apply_constant_terms)); those that only explain stay behind. The others become
//! one or two terms of the board each, in the order in which they act ([`sorted_by_stage`]), because p changes
//! from one to the next. A constant is among what is added: that of a factor, a bend or a limit goes to
//! the last of these.

pub(super) mod category;
mod decompile;

use std::borrow::Cow;

use trueup_core::{
    design_parameters::MAX_TERMS,
    fixed_point::ScaledCoefficient,
    gradient::Gradient,
    pitch_table::PitchErrorTable,
    term::{self, Effect, HEAT_SLOPE_BITS, Target, Term, UNIT_STEP},
    units::{FineNanometres, Position, Temperature},
};

use super::{
    curve::{OwnedCurve, compile_curve},
    inputs::find_channel,
    lag,
    part_differences::PartDifferences,
    pitch::{OwnedPitchTable, compile_pitch},
    squareness::{compile_squareness, linear_axis_to_board},
    thermal,
};
use crate::{
    effect::{
        BoardTerm, PredictionStage, SpeedHeatResponse, TemperatureResponse, Tilt, Wave,
        relative_heat_input,
    },
    location::InputFileError,
    machine_file::{self, Machine, sorted_by_stage},
    sections::AngleProfile,
    spline::BSpline,
    unit_conversion::{
        FINE_UNITS_PER_UM, NM_PER_UM, POSITION_UNITS_PER_MM, round_to_i32, round_to_u32,
    },
};

pub(super) use decompile::decompile;

/// Sensors and spindles are held against the model up to this elongation.
const MAX_CHECKED_ELONGATION_UM: f64 = 1_000.0;
/// And temperatures up to so far from the reference.
const MAX_CHECKED_DEVIATION_K: f64 = 60.0;
/// And speeds and loads up to these.
const MAX_CHECKED_SPEED_RPM: f64 = 60_000.0;
const MAX_CHECKED_LOAD_N: f64 = 32_767.0;
/// The board's loads are this many parts of a newton.
pub(crate) const LOAD_UNITS_PER_NEWTON: f64 = 256.0;

/// A term with tables of its own.
pub(super) struct OwnedTerm {
    target: Target,
    constant: FineNanometres,
    effect: OwnedEffect,
}

enum OwnedEffect {
    Plain(Effect<'static>),
    Table(OwnedPitchTable),
    Curve(machine_file::LinearAxis, OwnedCurve),
    Tilt(term::Tilt<OwnedCurve>),
    Tools(category::OwnedToolTable),
}

impl OwnedTerm {
    fn view(&self) -> Term<'_> {
        let effect = match &self.effect {
            OwnedEffect::Plain(effect) => *effect,
            OwnedEffect::Table(tables) => Effect::Table(PitchErrorTable { ..tables.view() }),
            OwnedEffect::Curve(axis, curve) => {
                Effect::Curve { axis: linear_axis_to_board(*axis), curve: curve.view() }
            }
            OwnedEffect::Tools(tools) => Effect::Tool(tools.view()),
            OwnedEffect::Tilt(tilt) => {
                let &term::Tilt { along, lever, origin, ref angle } = tilt;
                Effect::TiltCurve(term::Tilt { along, lever, origin, angle: angle.view() })
            }
        };
        Term { target: self.target, constant: self.constant, effect }
    }
}

/// Returns what the calibration holds.
pub(super) fn term_views(owned: &[OwnedTerm]) -> [Option<Term<'_>>; MAX_TERMS] {
    std::array::from_fn(|index| owned.get(index).map(OwnedTerm::view))
}

/// Returns the terms of `machine`, which has none that only explain.
pub(super) fn compile_terms(
    machine: &Machine,
    account: &mut PartDifferences<'_>,
) -> Result<Vec<OwnedTerm>, InputFileError> {
    let mut owned = Vec::new();
    let ordered = sorted_by_stage(&machine.terms);
    // Of a quantity's terms the last that is no summand, and with it the constants of all of them.
    let acts_before_sums = |term: &machine_file::Term| term.effect.stage() < PredictionStage::Sum;
    let last_before_sums = |quantity| {
        let mut latest = ordered.iter().rev();
        latest.find(|(_, term)| term.quantity == quantity && acts_before_sums(term))
    };
    let constant_um =
        |index: usize, term: &machine_file::Term| match last_before_sums(term.quantity) {
            Some((last, _)) if *last == index => {
                let before = ordered.iter().map(|(_, other)| other);
                let before = before
                    .filter(|other| other.quantity == term.quantity && acts_before_sums(other));
                before.map(|other| other.constant_um).sum()
            }
            _ if acts_before_sums(term) => 0.0,
            _ => term.constant_um,
        };
    for &(index, term) in &ordered {
        // The growth by tool is the last.
        let is_list = machine.spindle.tools.is_some() && index + 1 == machine.terms.len();
        let key = if is_list { "spindle.tools".into() } else { format!("term[{index}]") };
        let target = match term.quantity.axis() {
            None => Target::Elongation,
            Some(axis) => Target::Axis(linear_axis_to_board(axis)),
        };
        let forms = term.effect.board_terms();
        let offset_um: f64 =
            forms.iter().map(|form| if let BoardTerm::Offset(um) = form { *um } else { 0.0 }).sum();
        let constant = account.check_and_record_difference(
            &key,
            compile_length(constant_um(index, term) + offset_um),
        )?;
        let before = owned.len();
        for form in &forms {
            let Some(effect) = compile_effect(machine, &key, term, form, account)? else {
                continue;
            };
            // The constant comes once.
            let constant = if owned.len() == before { constant } else { FineNanometres::ZERO };
            owned.push(OwnedTerm { target, constant, effect });
        }
        if owned.len() == before && constant != FineNanometres::ZERO {
            let effect = OwnedEffect::Plain(Effect::Offset);
            owned.push(OwnedTerm { target, constant, effect });
        }
        if owned.len() > MAX_TERMS {
            let rule = format!("is too much: the board runs {} terms and waves", MAX_TERMS);
            return Err(machine.places.key_error(&key, rule));
        }
    }
    Ok(owned)
}

/// Number and largest difference from the model in nm, or why the board cannot.
type CompileResult<T> = Result<(T, f64), String>;

/// Returns the machine with the thermal laws that terms bring to axes that have none.
pub(super) fn with_thermal_laws(
    machine: Cow<'_, Machine>,
) -> Result<Cow<'_, Machine>, InputFileError> {
    let mut with = machine;
    for index in 0..with.terms.len() {
        let term = &with.terms[index];
        let Some(axis) = term.quantity.axis() else { continue };
        for form in term.effect.board_terms() {
            let BoardTerm::Thermal(thermal) = form else { continue };
            if with.axes[axis.index()].thermal.is_some() {
                let rule = "is too much: the board runs one thermal law for an axis";
                return Err(with.places.key_error(&format!("term[{index}]"), rule));
            }
            with.to_mut().axes[axis.index()].thermal = Some(thermal);
        }
    }
    Ok(with)
}

/// Returns a form as the board runs it; none: the constant alone.
fn compile_effect(
    machine: &Machine,
    key: &str,
    term: &machine_file::Term,
    form: &BoardTerm,
    account: &mut PartDifferences<'_>,
) -> Result<Option<OwnedEffect>, InputFileError> {
    let made: CompileResult<Effect<'static>> = match form {
        // The law is the axis's own by now.
        BoardTerm::Offset(_) | BoardTerm::Thermal(_) => return Ok(None),
        BoardTerm::Gain(gain) => {
            compile_coefficient(gain - 1.0, MAX_CHECKED_ELONGATION_UM * FINE_UNITS_PER_UM)
                .map(|(m, nm)| (Effect::Gain(m), nm))
        }
        BoardTerm::Curvature(per_um) => {
            let square = (MAX_CHECKED_ELONGATION_UM * FINE_UNITS_PER_UM).powi(2) / ONE_Q24;
            compile_coefficient(per_um / FINE_UNITS_PER_UM * ONE_Q24, square)
                .map(|(m, nm)| (Effect::Curvature(m), nm))
        }
        BoardTerm::Saturation(limit_um) => {
            compile_length(*limit_um).map(|(limit, nm)| (Effect::Saturation(limit), nm))
        }
        BoardTerm::Heat(it) => compile_heat_effect(find_channel(machine, key, &it.column)?, it),
        BoardTerm::HeatSlope(it) => compile_heat_slope(find_channel(machine, key, &it.column)?, it),
        BoardTerm::SpeedHeat(it) => compile_speed_heat(it),
        BoardTerm::Time { amplitude_um, time_constant_s, .. } => {
            let one = f64::from(UNIT_STEP);
            compile_coefficient(amplitude_um * FINE_UNITS_PER_UM / one, one).and_then(
                |(amplitude, nm)| {
                    Ok((
                        Effect::Time {
                            smoothing: lag::smoothing_factor(*time_constant_s)?,
                            amplitude,
                        },
                        nm,
                    ))
                },
            )
        }
        BoardTerm::Speed(um_per_krpm2) => compile_coefficient(
            um_per_krpm2 * FINE_UNITS_PER_UM / 1e6,
            MAX_CHECKED_SPEED_RPM * MAX_CHECKED_SPEED_RPM,
        )
        .map(|(m, nm)| (Effect::Speed(m), nm)),
        BoardTerm::Load(um_per_n) => compile_coefficient(
            um_per_n * FINE_UNITS_PER_UM / LOAD_UNITS_PER_NEWTON,
            MAX_CHECKED_LOAD_N * LOAD_UNITS_PER_NEWTON,
        )
        .map(|(m, nm)| (Effect::Load(m), nm)),
        BoardTerm::OwnPosition(um_per_m) => {
            let own = term.quantity.axis().ok_or("belongs to dx, dy or dz");
            own.map_err(String::from).and_then(|own| compile_position_effect(own, *um_per_m))
        }
        BoardTerm::Position { axis, um_per_m } => compile_position_effect(*axis, *um_per_m),
        BoardTerm::Reversed { width_um, um_per_m: 0.0 } => compile_length(*width_um)
            .map(|(width, nm)| (Effect::Reversed { width, gradient: Gradient::ZERO }, nm)),
        BoardTerm::Reversed { width_um, um_per_m } => {
            compile_length(*width_um).and_then(|(width, nm)| {
                let (gradient, more_nm) = compile_squareness(*um_per_m)?;
                Ok((Effect::Reversed { width, gradient }, nm + more_nm))
            })
        }
        BoardTerm::Table(pitch) => {
            return Ok(Some(OwnedEffect::Table(
                account.check_and_record_difference(key, compile_pitch(pitch))?,
            )));
        }
        BoardTerm::Curve(along, spline) => {
            let curve = account.check_and_record_difference(key, compile_curve(spline))?;
            return Ok(Some(OwnedEffect::Curve(*along, curve)));
        }
        BoardTerm::Tilt(it) => {
            let own = term.quantity.axis();
            return Ok(Some(account.check_and_record_difference(key, compile_tilt(own, it))?));
        }
        BoardTerm::Tool { tools, other, times } => {
            let made = category::compile_tool_table(tools, *other, times);
            return Ok(Some(account.check_and_record_difference(key, made)?));
        }
        BoardTerm::Condition { column, off, on, lag_s, times } => {
            let inputs = machine.inputs.as_ref();
            category::compile_condition(inputs, column, [*off, *on], *lag_s, times)
                .map(|(condition, nm)| (Effect::Condition(condition), nm))
        }
        &BoardTerm::Wave { period_mm, harmonic, amplitude_um, phase_deg } => {
            compile_wave(period_mm, Wave { harmonic, amplitude_um, phase_deg })
        }
    };
    Ok(Some(OwnedEffect::Plain(account.check_and_record_difference(key, made)?)))
}

fn compile_heat_effect(channel: u8, it: &TemperatureResponse) -> CompileResult<Effect<'static>> {
    let (per_temperature, reference, nm) = compile_temperature_response(it, 1.0)?;
    let smoothing = lag::smoothing_factor(it.time_constant_s)?;
    Ok((Effect::Heat { channel, smoothing, reference, per_temperature }, nm))
}

/// Returns a slope by heat.
fn compile_heat_slope(channel: u8, it: &TemperatureResponse) -> CompileResult<Effect<'static>> {
    let most =
        f64::from(i32::MAX) / FINE_UNITS_PER_UM / HEAT_SLOPE_REFERENCE_M / MAX_CHECKED_DEVIATION_K;
    if it.um_per_c.abs() > most {
        return Err(format!("{} µm/(m·K) is beyond the board's ±{most:.0}", it.um_per_c));
    }
    let (per_temperature, reference, nm) =
        compile_temperature_response(it, HEAT_SLOPE_REFERENCE_M)?;
    let smoothing = lag::smoothing_factor(it.time_constant_s)?;
    Ok((Effect::HeatSlope { channel, smoothing, reference, per_temperature }, nm))
}

/// Returns coefficient and reference of heat, of which `units` act at once, and the largest difference in nm.
fn compile_temperature_response(
    it: &TemperatureResponse,
    units: f64,
) -> Result<(ScaledCoefficient, Temperature, f64), String> {
    let (per_temperature, nm) = compile_coefficient(
        it.um_per_c * units * FINE_UNITS_PER_UM / f64::from(Temperature::PER_KELVIN),
        MAX_CHECKED_DEVIATION_K * f64::from(Temperature::PER_KELVIN),
    )?;
    let reference_c = it.reference_c;
    let reference = thermal::temperature_from_celsius(reference_c)
        .ok_or_else(|| format!("{reference_c} °C is beyond the board's ±524 °C"))?;
    Ok((per_temperature, reference, nm))
}

fn compile_speed_heat(it: &SpeedHeatResponse) -> CompileResult<Effect<'static>> {
    let &SpeedHeatResponse { power, um_per_unit, time_constant_s } = it;
    let units_per_heating = power.input_units_per_speed_power() / relative_heat_input(power, 1.0);
    let largest = relative_heat_input(power, MAX_CHECKED_SPEED_RPM) * units_per_heating;
    let (per_unit, nm) =
        compile_coefficient(um_per_unit * FINE_UNITS_PER_UM / units_per_heating, largest)?;
    let smoothing = lag::smoothing_factor(time_constant_s)?;
    Ok((Effect::SpeedHeat { power, smoothing, per_unit }, nm))
}

/// The position in m at which a slope by heat is its coefficient.
const HEAT_SLOPE_REFERENCE_M: f64 =
    (1_u64 << HEAT_SLOPE_BITS) as f64 / POSITION_UNITS_PER_MM / 1_000.0;
pub(crate) const ONE_Q24: f64 = (1_u64 << 24) as f64;

/// Returns a length, and its rounding in nm.
pub(super) fn compile_length(um: f64) -> CompileResult<FineNanometres> {
    let exact = um * FINE_UNITS_PER_UM;
    let stored =
        round_to_i32(exact).ok_or_else(|| format!("{um} µm is beyond the board's ±8388 µm"))?;
    Ok((FineNanometres(stored), (f64::from(stored) - exact).abs() / FINE_UNITS_PER_UM * NM_PER_UM))
}

/// Returns a coefficient, and what its rounding makes in nm at `largest`, what it multiplies.
pub(crate) fn compile_coefficient(value: f64, largest: f64) -> CompileResult<ScaledCoefficient> {
    const MANTISSA_LIMIT: f64 = (1_u64 << 30) as f64;
    let mantissa = |shift: u8| (value * 2_f64.powi(shift.into())).round();
    let fits = |shift: &u8| mantissa(*shift).abs() < MANTISSA_LIMIT;
    let shift = (0..=62_u8)
        .rev()
        .find(fits)
        .ok_or_else(|| format!("has a coefficient of {value:e} units, beyond the board's 2³⁰"))?;
    let stored = ScaledCoefficient {
        mantissa: round_to_i32(mantissa(shift)).expect("held below 2³⁰"),
        shift,
    };
    let off = f64::from(stored.mantissa) / 2_f64.powi(shift.into()) - value;
    Ok((stored, off.abs() * largest / FINE_UNITS_PER_UM * NM_PER_UM))
}

fn compile_position_effect(
    axis: machine_file::LinearAxis,
    um_per_m: f64,
) -> CompileResult<Effect<'static>> {
    compile_squareness(um_per_m)
        .map(|(gradient, nm)| (Effect::Position { axis: linear_axis_to_board(axis), gradient }, nm))
}

/// The board's lever in m: an angle of 1 µrad is this many µm there.
pub(crate) const REFERENCE_LEVER_M: f64 =
    term::REFERENCE_LEVER.0 as f64 / POSITION_UNITS_PER_MM / 1000.0;
/// Levers are held against the model up to 15 m: this many of the board's.
pub(crate) const MAX_LEVER_RATIO: f64 = 15.0 / REFERENCE_LEVER_M;

/// Returns a tilt of the own axis or another.
fn compile_tilt(own: Option<machine_file::LinearAxis>, it: &Tilt) -> CompileResult<OwnedEffect> {
    let Tilt { along, lever, origin_mm, ref angle } = *it;
    let along = linear_axis_to_board(along.or(own).ok_or("belongs to dx, dy or dz")?);
    let lever = linear_axis_to_board(lever);
    let origin = round_to_i32(origin_mm * POSITION_UNITS_PER_MM)
        .ok_or_else(|| format!("{origin_mm} mm is beyond the board's ±21474 mm"))?;
    let origin = Position(origin);
    let (effect, nm) = match angle {
        &AngleProfile::Line(urad_per_m) => {
            let (angle, nm) = compile_squareness(urad_per_m * REFERENCE_LEVER_M)
                .map_err(|_| format!("{urad_per_m} is beyond the board's ±2328 µrad/m"))?;
            let tilt = term::Tilt { along, lever, origin, angle };
            (OwnedEffect::Plain(Effect::TiltLine(tilt)), nm)
        }
        AngleProfile::Curve(spline) => {
            let control_um =
                spline.control_um.iter().map(|urad| urad * REFERENCE_LEVER_M).collect();
            let (angle, nm) = compile_curve(&BSpline { control_um, ..spline.clone() })?;
            (OwnedEffect::Tilt(term::Tilt { along, lever, origin, angle }), nm)
        }
    };
    Ok((effect, nm * MAX_LEVER_RATIO))
}

/// Returns one wave, and its largest difference from the model over the board's ±21 m, in nm.
fn compile_wave(period_mm: f64, wave: Wave) -> CompileResult<Effect<'static>> {
    let turns_per_unit = f64::from(wave.harmonic) / (period_mm * POSITION_UNITS_PER_MM);
    // f64 holds 53 bits of the 64: 21 m of 10 nm are 31, so that 2⁻²² turns are left.
    let turns = (turns_per_unit * 2_f64.powi(64)).round();
    if !(1.0..2_f64.powi(63)).contains(&turns) {
        return Err(format!("has a period of {period_mm} mm, which the board cannot run"));
    }
    let (amplitude, rounding_nm) = compile_length(wave.amplitude_um)?;
    let phase = (wave.phase_deg / 360.0).rem_euclid(1.0) * 2_f64.powi(32);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "held to 1…2⁶³")]
    let turns = turns as u64;
    // A whole turn, 2³², is none.
    let phase = round_to_u32(phase).unwrap_or(0);
    let effect = Effect::Wave { turns, phase, amplitude };
    let turn_error = 2_f64.powi(-52) * turns_per_unit * f64::from(i32::MAX) + 2_f64.powi(-32);
    let phase_nm = wave.amplitude_um.abs() * std::f64::consts::TAU * turn_error * NM_PER_UM;
    // And what the steps of an angle of 10⁻⁶ ° make.
    let step_nm = wave.amplitude_um.abs() * 1e-6_f64.to_radians() * NM_PER_UM;
    Ok((effect, rounding_nm + phase_nm + step_nm))
}
