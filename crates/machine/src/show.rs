//! From the integers of the board back to a machine file.
//!
//! The board's calibration knows readings, not the PLC's counts, and neither the machine's name nor
//! those of its columns. The machine file that is shown therefore takes ADC codes for counts, by
//! inputs whose scale is exactly one code a count, and calls the temperature of channel 3
//! `temp_ch3_c`. Numbers have the fewest decimals that the board stores as the same integer; most
//! are then what the user wrote. A straightness curve is shown segment by segment, each knot three
//! times: the Bézier points of a segment's cubic are the control points of such a B-spline. With
//! t₀ at its start and t₁ at its end, and ab + bc + ca the sum over its three arguments' pairs,
//!
//! ```text
//! f(a, b, c) = c₀ + c₁·(a + b + c)/3 + c₂/2·(ab + bc + ca)/3 + c₃/4·abc
//! points: f(t₀, t₀, t₀), f(t₀, t₀, t₁), f(t₀, t₁, t₁), f(t₁, t₁, t₁)
//! ```
//!
//! Two segments share the point at their knot, and get the mean of their two values.
//!
//! What is shown is compiled, and the result held against the calibration. Without curves and
//! tables over temperature it is the very same. Measured over random ones in
//! `tests/show_round_trip.rs`: curves within 0.031 nm, tables within 0.025 nm over 1 m. A
//! calibration that no machine file compiles to (one that was not written by
//! [`compile`](mod@crate::compile)) is shown as well, with the reason.

mod term;

use std::{
    f64::consts::E,
    fmt::{Result as Written, Write},
    path::Path,
};

use trueup_core::{
    calibration::{self, AXIS_PAIRS, AxisThermal, Calibration, Dual, SpindleTemperature},
    cnc::LinearAxis,
    curve::{Curve, Segment},
    dimensions::STEP_MS,
    gradient::Gradient,
    kinematics::{self, Kinematics},
    lag::SmoothingFactor,
    limits::Limits,
    pitch::Pitch,
    sensor::{SensorLaw, Slope},
    thermal::{Law, Piece, SLOPE_FRACTION_BITS, SLOPE_UNIT_BITS},
    thermometer::Thermometer,
    tool::Direction,
    travel::{self, Fraction},
    units::{Code, Fine, NANOMETRES_PER_MICROMETRE, Position, READINGS_PER_CODE, Temperature},
    warmup,
};

use crate::{
    compile::{compile, stored_law_nm},
    file::{self, MachineFile},
    inputs::{REFERENCE_VOLTS, SensorInput},
};

/// The inputs of a machine that is shown: one count is one ADC code, exactly.
pub const SHOWN_INPUT: SensorInput =
    SensorInput { volts_full_scale: 10.0, counts_full_scale: 4096.0, divider: 0.33 };

/// A slope that the board's integers hold as 0; a machine file must not state 0 itself.
const UM_PER_COUNT_OF_NO_SLOPE: f64 = 1e-12;

const NM_PER_UM: f64 = NANOMETRES_PER_MICROMETRE as f64;
const FINE_PER_NM: f64 = Fine::PER_NANOMETRE as f64;
const FINE_PER_UM: f64 = FINE_PER_NM * NM_PER_UM;
const UNITS_PER_MM: f64 = Position::PER_MILLIMETRE as f64;
const PER_KELVIN: f64 = Temperature::PER_KELVIN as f64;
/// Gradient units in 1 µm/m: nanometres for 10 nm of travel.
const GRADIENT_PER_UM_PER_M: f64 = 1e-5 * (1_u64 << Gradient::FRACTION_BITS) as f64;
/// What a slope of 1 a kelvin is in the board's integers.
const SLOPE_PER_KELVIN: f64 =
    (1_u64 << (SLOPE_UNIT_BITS + SLOPE_FRACTION_BITS)) as f64 / PER_KELVIN;
const SMOOTHING_ONE: f64 = (1_u64 << 32) as f64;
const FULL_ONE: f64 = (1_u64 << warmup::Warmup::FULL_FRACTION_BITS) as f64;
const DRIVE_ONE: f64 = warmup::Warmup::RATED as f64;
/// A linear chain delivers so many parts of a count.
const DELIVERED_PER_COUNT: f64 = 256.0;

/// A calibration as a machine file.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// The machine file.
    pub toml: String,
    /// How far the machine file's model and the calibration are apart, in nm: how far it is from
    /// its own compilation, and that from the calibration. Or, of a calibration that no machine
    /// file compiles to, the reason.
    pub largest_difference_nm: Result<f64, String>,
}

/// Turns `calibration` back into a machine file.
#[must_use]
pub fn show(calibration: &Calibration<'_>) -> Shown {
    let mut toml = String::new();
    write_machine_file(&mut toml, calibration).expect("a String can always be written");
    let (verdict, largest_difference_nm) = match compiled_back(&toml, calibration) {
        Ok(Back { is_same, from_calibration_nm, from_model_nm }) => {
            let nm = from_calibration_nm + from_model_nm;
            let back = if is_same {
                "the same calibration".to_string()
            } else {
                format!("within {from_calibration_nm:.3} nm of the board's calibration")
            };
            let verdict = format!(
                "Compiles back to {back}. Largest difference from the board's law: {nm:.3} nm"
            );
            (verdict, Ok(nm))
        }
        Err(reason) => {
            (format!("Does not compile back to this calibration: {reason}"), Err(reason))
        }
    };
    Shown { toml: format!("# {verdict}\n\n{toml}"), largest_difference_nm }
}

/// What became of a machine file that was shown.
struct Back {
    /// It compiles to the calibration, bit for bit.
    is_same: bool,
    /// From the calibration to what the file compiles to.
    from_calibration_nm: f64,
    /// From there to the file's model.
    from_model_nm: f64,
}

/// Compiles `toml` and holds the result against `calibration`.
fn compiled_back(toml: &str, calibration: &Calibration<'_>) -> Result<Back, String> {
    let compiled = MachineFile::parse(toml, Path::new("shown"))
        .and_then(|machine| compile(&machine))
        .map_err(|bad| bad.rule)?;
    let again = compiled.calibration();
    let from_model_nm = compiled.largest_difference_nm;
    if again == *calibration {
        return Ok(Back { is_same: true, from_calibration_nm: 0.0, from_model_nm });
    }
    let from_calibration_nm = difference_nm(calibration, &again)
        .ok_or("it holds values that no machine file is compiled to")?;
    Ok(Back { is_same: false, from_calibration_nm, from_model_nm })
}

fn write_machine_file(toml: &mut String, calibration: &Calibration<'_>) -> Written {
    let Calibration {
        thermometers,
        spindle,
        kinematics,
        axes,
        straightness,
        squareness,
        terms,
        limits,
    } = calibration;
    write_machine(toml, kinematics)?;
    let has_sensor = spindle.sensor != SensorLaw::default()
        || spindle.chain.contains(&Some(calibration::ElongationSource::Sensor));
    if has_sensor || thermometers.iter().any(Option::is_some) {
        write_inputs(toml, has_sensor, thermometers)?;
    }
    write_spindle(toml, has_sensor, spindle)?;
    for (axis, name) in axes.iter().zip(LinearAxis::ALL) {
        write_axis(toml, name_of(name), axis)?;
    }
    for (curve, pair) in straightness.iter().zip(AXIS_PAIRS) {
        if !curve.is_empty() {
            writeln!(toml, "\n[straightness.{}]", pair_name(pair))?;
            write_curve(toml, curve)?;
        }
    }
    if squareness.iter().any(|gradient| *gradient != Gradient::ZERO) {
        writeln!(toml, "\n[squareness]")?;
        for (gradient, pair) in squareness.iter().zip(AXIS_PAIRS) {
            if *gradient != Gradient::ZERO {
                let um_per_m = written(gradient.0, GRADIENT_PER_UM_PER_M);
                writeln!(toml, "{}_um_per_m = {um_per_m:?}", pair_name(pair))?;
            }
        }
    }
    write_limits(toml, limits)?;
    term::write_falling(toml, calibration)?;
    terms.iter().flatten().try_for_each(|term| term::write(toml, term))
}

/// The number with the fewest decimals near `exact` that is `same` for the board.
fn fewest_decimals(exact: f64, same: impl Fn(f64) -> bool) -> f64 {
    const MOST_DECIMALS: i32 = 15;
    let rounded = |decimals: i32| {
        let scale = 10_f64.powi(decimals);
        // + 0.0 turns −0 into 0.
        (exact * scale).round() / scale + 0.0
    };
    (0..=MOST_DECIMALS).map(rounded).find(|&number| same(number)).unwrap_or(exact)
}

/// What a user writes for `stored`, of which `per_unit` are one of the user's unit.
fn written(stored: impl Into<f64>, per_unit: f64) -> f64 {
    let stored = stored.into();
    fewest_decimals(stored / per_unit, |number| (number * per_unit - stored).abs() < 0.49)
}

/// An array, in lines of eight where it is long.
fn write_numbers(toml: &mut String, key: &str, numbers: &[f64]) -> Written {
    const PER_LINE: usize = 8;
    if numbers.len() <= 2 * PER_LINE {
        return writeln!(toml, "{key} = {numbers:?}");
    }
    writeln!(toml, "{key} = [")?;
    for line in numbers.chunks(PER_LINE) {
        let line: Vec<String> = line.iter().map(|number| format!("{number:?}")).collect();
        writeln!(toml, "    {},", line.join(", "))?;
    }
    writeln!(toml, "]")
}

fn name_of(axis: LinearAxis) -> &'static str {
    match axis {
        LinearAxis::X => "x",
        LinearAxis::Y => "y",
        LinearAxis::Z => "z",
    }
}

fn pair_name((error, along): (LinearAxis, LinearAxis)) -> String {
    format!("{}_of_{}", name_of(error), name_of(along))
}

fn write_machine(toml: &mut String, kinematics: &Kinematics) -> Written {
    let axes: Vec<&str> = kinematics
        .axes
        .iter()
        .flatten()
        .map(|axis| match axis {
            kinematics::RotaryAxis::A => "a",
            kinematics::RotaryAxis::B => "b",
            kinematics::RotaryAxis::C => "c",
        })
        .collect();
    writeln!(toml, "[machine]")?;
    writeln!(toml, "name = \"shown\" # a calibration holds no name")?;
    match axes.len() {
        // It may be "table-table" as well: the board runs both alike.
        0 => writeln!(toml, "kind = \"3-axis\"")?,
        1 => writeln!(toml, "kind = \"head-table\"\nhead_axes = {axes:?}")?,
        _ => writeln!(toml, "kind = \"head-head\"\nhead_axes = {axes:?}")?,
    }
    writeln!(toml, "tool_direction = {:?}", written_direction(kinematics.zero))
}

fn write_inputs(
    toml: &mut String,
    has_sensor: bool,
    thermometers: &[Option<Thermometer>],
) -> Written {
    let SensorInput { volts_full_scale, counts_full_scale, divider } = SHOWN_INPUT;
    writeln!(toml, "\n[inputs]")?;
    if has_sensor {
        let codes = Code::FULL_SCALE;
        writeln!(
            toml,
            "# Assumed: counts are ADC codes, {codes} for {REFERENCE_VOLTS} V at the ADC. A"
        )?;
        writeln!(
            toml,
            "# calibration does not hold the counts of the machine file that it came from."
        )?;
        writeln!(
            toml,
            "sensor = {{ volts_full_scale = {volts_full_scale:?}, counts_full_scale = \
             {counts_full_scale:?}, divider = {divider:?} }}"
        )?;
    }
    for (channel, thermometer) in thermometers.iter().enumerate() {
        let name = column(channel);
        match thermometer {
            None => {}
            Some(Thermometer::Pt100) => {
                writeln!(toml, "{name} = {{ channel = {channel}, kind = \"pt100\" }}")?;
            }
            Some(Thermometer::Linear { zero, slope, shift }) => {
                let zero_counts = written(*zero, DELIVERED_PER_COUNT);
                let counts_per_c = written_counts_per_c(*slope, *shift);
                writeln!(
                    toml,
                    "{name} = {{ channel = {channel}, kind = \"linear\", zero_counts = \
                     {zero_counts:?}, counts_per_c = {counts_per_c:?} }}"
                )?;
            }
        }
    }
    Ok(())
}

/// A calibration holds channels, not the names of columns.
fn column(channel: impl std::fmt::Display) -> String {
    format!("temp_ch{channel}_c")
}

fn written_counts_per_c(slope: i32, shift: u8) -> f64 {
    // slope = this / (counts per °C)
    let reciprocal = PER_KELVIN / DELIVERED_PER_COUNT * 2_f64.powi(shift.into());
    let slope = f64::from(slope);
    let same = |counts: f64| (reciprocal / counts - slope).abs() < 0.49;
    fewest_decimals(reciprocal / slope, same)
}

fn write_spindle(
    toml: &mut String,
    has_sensor: bool,
    spindle: &calibration::SpindleModel<'_>,
) -> Written {
    let calibration::SpindleModel { chain, sensor, temperature, warmup } = spindle;
    if let [Some(source), ..] = chain {
        let source = match source {
            calibration::ElongationSource::Sensor => "sensor",
            calibration::ElongationSource::Temperature => "temperature",
            calibration::ElongationSource::Warmup => "warmup",
        };
        writeln!(toml, "\n[spindle]\nsource = \"{source}\"")?;
    }
    if has_sensor {
        write_sensor(toml, sensor)?;
    }
    if let Some(SpindleTemperature { channel, smoothing, law, smoothing_falling: _ }) = temperature
    {
        let piece = law.pieces.first().map(Piece::from_bytes).unwrap_or_default();
        let k_um_per_c = written(piece.constant_slope, FINE_PER_UM * SLOPE_PER_KELVIN);
        writeln!(toml, "\n[spindle.temperature]")?;
        writeln!(toml, "sensor = \"{}\"", column(channel))?;
        writeln!(toml, "reference_c = {:?}", written(piece.start.0, PER_KELVIN))?;
        writeln!(toml, "k_um_per_c = {k_um_per_c:?}")?;
        writeln!(toml, "lag_s = {:?}", written_time_constant_s(*smoothing))?;
    }
    match warmup {
        Some(warmup) => write_warmup(toml, warmup),
        None => Ok(()),
    }
}

fn write_sensor(toml: &mut String, law: &SensorLaw) -> Written {
    let readings_per_count = f64::from(READINGS_PER_CODE);
    let slope_nm = f64::from(law.slope.0) / (1_u64 << Slope::FRACTION_BITS) as f64;
    let um_per_count = slope_nm * readings_per_count / NM_PER_UM;
    writeln!(toml, "\n[spindle.sensor]")?;
    writeln!(toml, "k0_um = {:?}", f64::from(law.k0.0) / NM_PER_UM)?;
    writeln!(toml, "zero_counts = {:?}", f64::from(law.zero.0) / readings_per_count)?;
    if law.slope.0 == 0 {
        writeln!(toml, "um_per_count = {UM_PER_COUNT_OF_NO_SLOPE:?} # on the board: 0")
    } else {
        writeln!(toml, "um_per_count = {um_per_count:?}")
    }
}

/// τ of 1 − e^(−Δt/τ), in s.
fn time_constant_s(smoothing: SmoothingFactor) -> f64 {
    let step_s = f64::from(STEP_MS) / 1_000.0;
    -step_s / (-f64::from(smoothing.0) / SMOOTHING_ONE).ln_1p()
}

/// Whether a lag of this time constant is stored as `smoothing`.
fn is_smoothing(time_constant_s: f64, smoothing: SmoothingFactor) -> bool {
    let step_s = f64::from(STEP_MS) / 1_000.0;
    let stored = -(-step_s / time_constant_s).exp_m1() * SMOOTHING_ONE;
    (stored - f64::from(smoothing.0)).abs() < 0.49
}

fn written_time_constant_s(smoothing: SmoothingFactor) -> f64 {
    if smoothing == SmoothingFactor::NO_LAG {
        return 0.0;
    }
    fewest_decimals(time_constant_s(smoothing), |time_s| is_smoothing(time_s, smoothing))
}

fn write_warmup(toml: &mut String, warmup: &calibration::SpindleWarmup<'_>) -> Written {
    /// An exponent that is as good as endless: its growth is full, to the last bit.
    const LARGEST_EXPONENT: f64 = 20.0;
    let law = &warmup.law;
    let full = f64::from(law.full);
    let exponent = if full > FULL_ONE {
        let same = |k: f64| (FULL_ONE / -(-k).exp_m1() - full).abs() < 0.49;
        fewest_decimals(-(-FULL_ONE / full).ln_1p(), same)
    } else {
        LARGEST_EXPONENT
    };
    let lag_s = f64::from(law.lag_ms) / 1_000.0;
    let warm_s =
        fewest_decimals(lag_s + exponent * time_constant_s(law.smoothing_heating), |warm_s| {
            is_smoothing((warm_s - lag_s) / exponent, law.smoothing_heating)
        });
    writeln!(toml, "\n[spindle.warmup]")?;
    writeln!(toml, "lag_s = {lag_s:?}")?;
    writeln!(toml, "warm_s = {warm_s:?}")?;
    writeln!(toml, "max_um = {:?}", written(law.max.0, FINE_PER_UM))?;
    writeln!(toml, "exponent = {exponent:?}")?;
    if law.smoothing_cooling != law.smoothing_heating {
        let cool_s = fewest_decimals(time_constant_s(law.smoothing_cooling), |time_s| {
            is_smoothing(time_s, law.smoothing_cooling)
        });
        writeln!(toml, "cool_s = {cool_s:?}")?;
    }
    if let Some((rated_rpm, speed_exponent)) = power_law(&warmup.power) {
        writeln!(toml, "rated_rpm = {rated_rpm:?}")?;
        writeln!(toml, "speed_exponent = {speed_exponent:?}")?;
    }
    Ok(())
}

/// n_rated and p of a curve of (n/n_rated)^p, which its segments meet at their ends.
///
/// One segment is enough only where the power is a cubic itself, and is then met everywhere: its
/// thirds are asked too, because the value at its start, 1 r/min, is all rounding.
fn power_law(curve: &Curve<'_>) -> Option<(f64, f64)> {
    /// Rounding of a segment's coefficients, in units of its value.
    const ROUNDING: f64 = 8.0;
    /// The curve ends at so many times the rated heat, or at the fastest speed.
    const MOST: f64 = 4.0;
    let first = curve.first().0;
    let mut places: Vec<i32> = vec![first];
    places.extend(curve.segments().iter().map(|bytes| Segment::from_bytes(bytes).end.0));
    if let [_, end] = places[..] {
        let third = (end - first) / 3;
        places = vec![first, first + third, end - third, end];
    }
    let ends: Vec<(f64, f64)> = places
        .into_iter()
        .map(|place| (f64::from(place), f64::from(curve.at(Position(place)).0.0)))
        .filter(|&(_, value)| value > 0.0)
        .collect();
    let (&(last_rpm, last), lower) = ends.split_last()?;
    // Where the rounding of the value moves p least.
    let uncertainty = |&(rpm, value): &(f64, f64)| 1.0 / (value * (last_rpm / rpm).ln());
    let &(rpm, value) = lower.iter().min_by(|a, b| uncertainty(a).total_cmp(&uncertainty(b)))?;
    let exact = (last / value).ln() / (last_rpm / rpm).ln();
    let rated = |p: f64| last_rpm / (last / DRIVE_ONE).powf(1.0 / p);
    let meets_all = |rated: f64, p: f64| {
        let end = (rated * MOST.powf(1.0 / p)).clamp(2.0, u16::MAX.into()).floor();
        end == last_rpm
            && ends
                .iter()
                .all(|&(rpm, value)| ((rpm / rated).powf(p) * DRIVE_ONE - value).abs() <= ROUNDING)
    };
    let rounded = |number: f64, decimals: i32| {
        let scale = 10_f64.powi(decimals);
        (number * scale).round() / scale
    };
    let candidates = (0..=9)
        .map(|decimals| rounded(exact, decimals))
        .flat_map(|p| (-3..=6).map(move |decimals| (rounded(rated(p), decimals), p)));
    let mut fitting = candidates.filter(|&(rated, p)| meets_all(rated, p));
    Some(fitting.next().unwrap_or((rated(exact), exact)))
}

fn write_axis(toml: &mut String, name: &str, axis: &calibration::AxisModel<'_>) -> Written {
    let calibration::AxisModel { thermal, pitch, dual, backlash, travel } = axis;
    if let Some(thermal) = thermal {
        write_thermal(toml, name, thermal)?;
    }
    if let Some(pitch) = pitch {
        writeln!(toml, "\n[axis.{name}.pitch]")?;
        write_pitch(toml, pitch)?;
    }
    if let Some(Dual { across, beam, pitch }) = dual {
        let [first, second] = beam.drives().map(|drive| written(drive.0, UNITS_PER_MM));
        writeln!(toml, "\n[axis.{name}.dual]")?;
        writeln!(toml, "across = \"{}\"", name_of(*across))?;
        writeln!(toml, "first_mm = {first:?}\nsecond_mm = {second:?}")?;
        writeln!(toml, "\n[axis.{name}.dual.pitch]")?;
        write_pitch(toml, pitch)?;
    }
    if *backlash != Fine::ZERO || *travel != travel::Config::default() {
        let ramp_mm = written(travel.ramp.length(), UNITS_PER_MM);
        let hysteresis_um = written(travel.hysteresis, UNITS_PER_MM / 1_000.0);
        writeln!(toml, "\n[axis.{name}.backlash]")?;
        writeln!(toml, "width_um = {:?}", written(backlash.0, FINE_PER_UM))?;
        writeln!(toml, "ramp_mm = {ramp_mm:?}\nhysteresis_um = {hysteresis_um:?}")?;
    }
    Ok(())
}

fn write_thermal(toml: &mut String, name: &str, thermal: &AxisThermal<'_>) -> Written {
    let pieces: Vec<Piece> = thermal.law.pieces.iter().map(Piece::from_bytes).collect();
    let has_constant = pieces.iter().any(|it| it.constant != Fine::ZERO || it.constant_slope != 0);
    let mode = match (has_constant, thermal.law.depends_on_position()) {
        (true, true) => "both",
        (true, false) => "constant",
        (false, _) => "position",
    };
    let first = pieces.first().copied().unwrap_or_default();
    writeln!(toml, "\n[axis.{name}.thermal]")?;
    writeln!(toml, "mode = \"{mode}\"\nsensor = \"{}\"", column(thermal.channel))?;
    let starts_at_zero = first.constant == Fine::ZERO && first.gradient == Gradient::ZERO;
    if pieces.len() > 1 || !starts_at_zero {
        // The first of several holds what is below the first row.
        let rows = pieces.get(1..).filter(|rows| !rows.is_empty()).unwrap_or(&pieces);
        writeln!(toml, "table = [ # T in °C, K0 in µm, slope in µm/m")?;
        for row in rows {
            let t = written(row.start.0, PER_KELVIN);
            let constant = written(row.constant.0, FINE_PER_UM);
            let gradient = written(row.gradient.0, GRADIENT_PER_UM_PER_M);
            writeln!(toml, "    [{t:?}, {constant:?}, {gradient:?}],")?;
        }
        writeln!(toml, "]")?;
    } else {
        let constant = written(first.constant_slope, FINE_PER_UM * SLOPE_PER_KELVIN);
        let gradient = written(first.gradient_slope, GRADIENT_PER_UM_PER_M * SLOPE_PER_KELVIN);
        writeln!(toml, "reference_c = {:?}", written(first.start.0, PER_KELVIN))?;
        writeln!(toml, "constant_um_per_c = {constant:?}\nslope_um_per_m_per_c = {gradient:?}")?;
    }
    writeln!(toml, "origin_mm = {:?}", written(thermal.origin.0, UNITS_PER_MM))?;
    writeln!(toml, "lag_s = {:?}", written_time_constant_s(thermal.smoothing))
}

fn write_pitch(toml: &mut String, pitch: &Pitch<'_>) -> Written {
    let file::Pitch { start_mm, step_mm, forward_um, reverse_um } = read_pitch(pitch);
    writeln!(toml, "start_mm = {start_mm:?}")?;
    writeln!(toml, "step_mm = {step_mm:?}")?;
    write_numbers(toml, "forward_um", &forward_um)?;
    reverse_um.iter().try_for_each(|um| write_numbers(toml, "reverse_um", um))
}

/// A table in the user's units.
fn read_pitch(pitch: &Pitch<'_>) -> file::Pitch {
    let errors = |points: &[[u8; 4]]| -> Vec<f64> {
        points.iter().map(|point| written(i32::from_le_bytes(*point), FINE_PER_UM)).collect()
    };
    file::Pitch {
        start_mm: written(pitch.start.0, UNITS_PER_MM),
        step_mm: written(pitch.step.length(), UNITS_PER_MM),
        forward_um: errors(pitch.forward),
        reverse_um: pitch.reverse.map(errors),
    }
}

fn write_curve(toml: &mut String, curve: &Curve<'_>) -> Written {
    let file::BSpline { order, knots_mm, control_um } = read_curve(curve);
    writeln!(toml, "order = {order}")?;
    write_numbers(toml, "knots_mm", &knots_mm)?;
    write_numbers(toml, "control_um", &control_um)
}

/// A curve in the user's units.
fn read_curve(curve: &Curve<'_>) -> file::BSpline {
    let mm = |place: i32| written(place, UNITS_PER_MM);
    let mut start = curve.first().0;
    let mut knots_mm = vec![mm(start); 4];
    let mut control: Vec<f64> = Vec::new();
    for bytes in curve.segments() {
        let segment = Segment::from_bytes(bytes);
        let [at_start, inner @ .., at_end] = bezier_points(&segment, start);
        match control.last_mut() {
            Some(shared) => *shared = (*shared + at_start) / 2.0,
            None => control.push(at_start),
        }
        control.extend(inner);
        control.push(at_end);
        start = segment.end.0;
        knots_mm.extend([mm(start); 3]);
    }
    knots_mm.push(mm(start));
    // 1e-8 µm is 1/390 of the board's unit.
    let um = control.iter().map(|fine| (fine / FINE_PER_UM * 1e8).round() / 1e8 + 0.0);
    file::BSpline { order: 4, knots_mm, control_um: um.collect() }
}

/// The Bézier points of a segment that begins at `start`, in [`Fine`] units.
fn bezier_points(segment: &Segment, start: i32) -> [f64; 4] {
    let [c0, c1, c2, c3] = segment.coefficients.map(f64::from);
    let span = 2_f64.powi(32 - i32::from(segment.shift));
    let at_start = 2.0 * f64::from(segment.end.0.abs_diff(start)) / span - 1.0;
    let at_end = -1.0;
    let polar = |a: f64, b: f64, c: f64| {
        c0 + c1 * (a + b + c) / 3.0
            + c2 / 2.0 * (a * b + b * c + c * a) / 3.0
            + c3 / 4.0 * a * b * c
    };
    [
        polar(at_start, at_start, at_start),
        polar(at_start, at_start, at_end),
        polar(at_start, at_end, at_end),
        polar(at_end, at_end, at_end),
    ]
}

fn write_limits(toml: &mut String, limits: &Limits) -> Written {
    let [x, y, z] = limits.max.map(|max| f64::from(max.0) / NM_PER_UM);
    writeln!(toml, "\n[limits]")?;
    writeln!(toml, "max_um = {{ x = {x:?}, y = {y:?}, z = {z:?} }}")?;
    writeln!(toml, "slew_um_per_s = {:?}", f64::from(limits.slew_nm_per_s) / NM_PER_UM)?;
    writeln!(toml, "link_timeout_ms = {}", limits.link_timeout_ms)?;
    writeln!(toml, "hold_ms = {}", limits.hold_ms)
}

/// The direction with the fewest decimals that is stored as `stored` again.
fn written_direction(stored: Direction) -> [f64; 3] {
    const MOST_DECIMALS: i32 = 12;
    let unit = unit_vector_near(stored);
    (0..=MOST_DECIMALS)
        .map(|decimals| {
            let scale = 10_f64.powi(decimals);
            // + 0.0 turns −0 into 0.
            unit.map(|component| (component * scale).round() / scale + 0.0)
        })
        .find(|&written| is_stored_as(written, stored))
        .unwrap_or(unit)
}

/// Whether the machine file's reader and the compiler make `stored` of `written`.
fn is_stored_as(written: [f64; 3], stored: Direction) -> bool {
    let length = written.iter().map(|component| component * component).sum::<f64>().sqrt();
    let one = f64::from(Direction::ONE);
    // Without a length this is NaN, which is equal to nothing.
    written.map(|component| (component / length * one).round()) == stored.0.map(f64::from)
}

/// A vector of length 1 whose every component rounds to that of `stored`.
///
/// The stored vector is not of length 1, and to scale it can move a component by up to 0.68 of its
/// last place, into the next one. What rounding has added to the length is therefore taken back in
/// equal steps from all three components, which moves each by half a place at most if there is such
/// a vector at all.
fn unit_vector_near(stored: Direction) -> [f64; 3] {
    let one = f64::from(Direction::ONE);
    let components = stored.0.map(f64::from);
    let length = components.iter().map(|component| component * component).sum::<f64>().sqrt();
    let sum = components.iter().map(|component| component.abs()).sum::<f64>();
    let step = if sum == 0.0 { 0.0 } else { (length - one) * length / sum };
    components.map(|component| {
        let sign = if component == 0.0 { 0.0 } else { component.signum() };
        (component - sign * step) / one
    })
}

/// The largest difference in nm between what the board computes by `a` and by `b`; `None` where they
/// differ in more than numbers of nanometres.
fn difference_nm(a: &Calibration<'_>, b: &Calibration<'_>) -> Option<f64> {
    /// A tool direction is held against the other with this elongation.
    const ELONGATION_NM: f64 = 1e6;
    let is_alike = a.thermometers == b.thermometers
        && a.kinematics.axes == b.kinematics.axes
        && a.limits == b.limits;
    if !is_alike {
        return None;
    }
    let mut worst = spindle_difference_nm(&a.spindle, &b.spindle)?;
    for (a, b) in a.kinematics.zero.0.into_iter().zip(b.kinematics.zero.0) {
        let off = f64::from(a.abs_diff(b)) / f64::from(Direction::ONE);
        worst = worst.max(off * ELONGATION_NM);
    }
    for (a, b) in a.axes.iter().zip(&b.axes) {
        worst = worst.max(axis_difference_nm(a, b)?);
    }
    for (a, b) in a.straightness.iter().zip(&b.straightness) {
        worst = worst.max(curve_difference(a, b) / FINE_PER_NM);
    }
    for (a, b) in a.squareness.iter().zip(b.squareness) {
        worst = worst.max(metre_of(*a, b));
    }
    for (a, b) in a.terms.iter().zip(&b.terms) {
        worst = worst.max(both(a.as_ref(), b.as_ref(), term::difference_nm)?);
    }
    Some(worst)
}

/// Of two things that are both there, or both not.
fn both<T>(a: Option<T>, b: Option<T>, difference: impl Fn(T, T) -> Option<f64>) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => difference(a, b),
        (None, None) => Some(0.0),
        _ => None,
    }
}

/// The difference of two gradients over 1 m, in nm.
fn metre_of(a: Gradient, b: Gradient) -> f64 {
    f64::from(a.0.abs_diff(b.0)) / GRADIENT_PER_UM_PER_M * NM_PER_UM
}

fn spindle_difference_nm(
    a: &calibration::SpindleModel<'_>,
    b: &calibration::SpindleModel<'_>,
) -> Option<f64> {
    if a.chain != b.chain {
        return None;
    }
    let mut worst: f64 = 0.0;
    if a.chain.contains(&Some(calibration::ElongationSource::Sensor)) {
        let last = f64::from(Code::FULL_SCALE * READINGS_PER_CODE);
        for reading in [0.0, last] {
            let off = stored_law_nm(&a.sensor, reading) - stored_law_nm(&b.sensor, reading);
            worst = worst.max(off.abs());
        }
    }
    let temperature = both(a.temperature, b.temperature, |a, b| {
        let laws = law_difference_nm(a.law, b.law)
            + lag_difference_nm(a.smoothing, b.smoothing, largest_of_law_nm(a.law));
        (a.channel == b.channel).then_some(laws)
    })?;
    let warmup = both(a.warmup, b.warmup, |a, b| {
        let max_nm = f64::from(a.law.max.0).abs() / FINE_PER_NM;
        let max = f64::from(a.law.max.0.abs_diff(b.law.max.0)) / FINE_PER_NM;
        let full = f64::from(a.law.full.abs_diff(b.law.full)) / FULL_ONE * max_nm;
        let lags = lag_difference_nm(a.law.smoothing_heating, b.law.smoothing_heating, max_nm)
            + lag_difference_nm(a.law.smoothing_cooling, b.law.smoothing_cooling, max_nm);
        let power = curve_difference(&a.power, &b.power) / DRIVE_ONE * max_nm;
        (a.law.lag_ms == b.law.lag_ms).then_some(max + full + lags + power)
    })?;
    Some(worst.max(temperature).max(warmup))
}

/// How far two lags are apart after a step of this size: at most its e-th part for each part by
/// which their time constants differ.
fn lag_difference_nm(a: SmoothingFactor, b: SmoothingFactor, step_nm: f64) -> f64 {
    if a == b {
        return 0.0;
    }
    (time_constant_s(a) / time_constant_s(b) - 1.0).abs() * step_nm / E
}

/// Temperatures at which laws are held against each other: every quarter of a kelvin.
fn checked_temperatures() -> impl Iterator<Item = Temperature> {
    const FROM_TO_C: (i32, i32) = (-20, 100);
    let quarters = FROM_TO_C.0 * 4..=FROM_TO_C.1 * 4;
    quarters.map(|quarter| Temperature(quarter * (Temperature::PER_KELVIN / 4)))
}

/// Of K₀, or of what tanβ makes of 1 m, in nm.
fn law_difference_nm(a: Law<'_>, b: Law<'_>) -> f64 {
    let at = |t| {
        let ((constant_a, gradient_a), (constant_b, gradient_b)) = (a.at(t), b.at(t));
        let constant = f64::from(constant_a.0.abs_diff(constant_b.0)) / FINE_PER_NM;
        constant.max(metre_of(gradient_a, gradient_b))
    };
    checked_temperatures().map(at).fold(0.0, f64::max)
}

fn largest_of_law_nm(law: Law<'_>) -> f64 {
    law_difference_nm(law, Law::default())
}

fn axis_difference_nm(
    a: &calibration::AxisModel<'_>,
    b: &calibration::AxisModel<'_>,
) -> Option<f64> {
    let thermal = both(a.thermal, b.thermal, |a, b| {
        let laws = law_difference_nm(a.law, b.law)
            + lag_difference_nm(a.smoothing, b.smoothing, largest_of_law_nm(a.law));
        (a.channel == b.channel && a.origin == b.origin).then_some(laws)
    })?;
    let pitch = both(a.pitch, b.pitch, |a, b| pitch_difference_nm(&a, &b))?;
    let dual = both(a.dual, b.dual, |a, b| {
        let off = pitch_difference_nm(&a.pitch, &b.pitch);
        off.filter(|_| a.across == b.across && a.beam == b.beam)
    })?;
    let backlash = f64::from(a.backlash.0.abs_diff(b.backlash.0)) / FINE_PER_NM;
    (a.travel == b.travel).then_some(thermal.max(pitch).max(dual).max(backlash))
}

/// At the points, half way to the next, and half way from one direction to the other.
fn pitch_difference_nm(a: &Pitch<'_>, b: &Pitch<'_>) -> Option<f64> {
    if (a.start, a.step, a.forward.len()) != (b.start, b.step, b.forward.len()) {
        return None;
    }
    let half = i64::from(a.step.length() / 2);
    let places = (0_i64..).take(a.forward.len() * 2).map(|n| {
        let place = i64::from(a.start.0) + n / 2 * i64::from(a.step.length()) + n % 2 * half;
        Position(i32::try_from(place).unwrap_or(i32::MAX))
    });
    let blends = [Fraction::ZERO, Fraction(Fraction::ONE.0 / 2), Fraction::ONE];
    let off = places.flat_map(|place| {
        blends.map(|blend| a.at(place, blend).0.0.abs_diff(b.at(place, blend).0.0))
    });
    Some(f64::from(off.max().unwrap_or(0)) / FINE_PER_NM)
}

/// At the ends of the segments of `a` and at places between, in the curves' units.
fn curve_difference(a: &Curve<'_>, b: &Curve<'_>) -> f64 {
    const PLACES: i64 = 17;
    let mut start = a.first().0;
    let mut worst = 0;
    for bytes in a.segments() {
        let end = Segment::from_bytes(bytes).end.0;
        for n in 0..=PLACES {
            let place = i64::from(start) + (i64::from(end) - i64::from(start)) * n / PLACES;
            let place = Position(i32::try_from(place).expect("between two of i32"));
            worst = worst.max(a.at(place).0.0.abs_diff(b.at(place).0.0));
        }
        start = end;
    }
    f64::from(worst)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compile::{Compiled, compile};
    use trueup_core::units::{Nanometres, Reading};

    const PAPER: &str = include_str!("../../../data/paper_spindle.toml");

    fn compiled(text: &str) -> Compiled {
        let machine = MachineFile::parse(text, Path::new("m.toml"));
        compile(&machine.expect("a right machine file")).expect("fits")
    }

    fn paper_but(from: &str, to: &str) -> Compiled {
        compiled(&PAPER.replace(from, to))
    }

    /// A 3-axis machine of `sections`, as it is shown.
    fn shown(sections: &str) -> Shown {
        let text = format!("[machine]\nname = \"mill\"\nkind = \"3-axis\"\n{sections}");
        show(&compiled(&text).calibration())
    }

    fn assert_lines(shown: &Shown, lines: &[&str]) {
        for line in lines {
            assert!(shown.toml.lines().any(|shown| shown == *line), "{line}\n{}", shown.toml);
        }
    }

    #[test]
    fn one_count_of_the_shown_input_is_one_code_exactly() {
        assert_eq!(SHOWN_INPUT.codes_from_counts(1.0), 1.0);
        assert_eq!(SHOWN_INPUT.exact_reading_from_counts(1.0), 1024.0);
    }

    #[test]
    fn the_papers_calibration_is_shown_in_codes() {
        let shown = show(&paper_but("", "").calibration());
        assert_eq!(shown.largest_difference_nm, Ok(0.0));
        assert_lines(
            &shown,
            &[
                "# Compiles back to the same calibration. Largest difference from the board's law: 0.000 nm",
                "tool_direction = [0.0, 0.0, -1.0]",
                "sensor = { volts_full_scale = 10.0, counts_full_scale = 4096.0, divider = 0.33 }",
                "source = \"sensor\"",
                "k0_um = 0.0",
                // 5048 counts of 1/8 code, 500 µm over 4096 codes.
                "zero_counts = 631.0",
                "um_per_count = 0.1220703125",
                "max_um = { x = 200.0, y = 200.0, z = 500.0 }",
                "slew_um_per_s = 20.0",
                "link_timeout_ms = 500",
                "hold_ms = 2000",
            ],
        );
    }

    #[test]
    fn a_direction_is_shown_as_the_user_wrote_it() {
        let compiled =
            paper_but("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [0, 0.6, -0.8]");
        let shown = show(&compiled.calibration()).toml;
        assert!(shown.contains("\ntool_direction = [0.0, 0.6, -0.8]\n"), "{shown}");
    }

    #[test]
    fn a_laws_numbers_are_shown_as_the_user_wrote_them() {
        let shown = shown(
            r#"
            [inputs]
            temp_screw_c = { channel = 0, kind = "pt100" }
            temp_front_c = { channel = 5, kind = "linear", zero_counts = 4000, counts_per_c = 16.3 }
            [spindle]
            source = "warmup"
            [spindle.warmup]
            lag_s = 60
            warm_s = 5400
            max_um = 80
            exponent = 4
            cool_s = 2900
            rated_rpm = 24000
            speed_exponent = 2.0
            [spindle.temperature]
            sensor = "temp_front_c"
            reference_c = 20.3
            k_um_per_c = 2.1
            lag_s = 1630
            [axis.x.thermal]
            mode = "position"
            sensor = "temp_screw_c"
            reference_c = 23
            slope_um_per_m_per_c = 14.21
            origin_mm = 120.5
            lag_s = 0.5
            [axis.y.backlash]
            width_um = -4.3
            ramp_mm = 0.05
            hysteresis_um = 1.7
            [squareness]
            z_of_x_um_per_m = 12.7
            "#,
        );
        assert_lines(
            &shown,
            &[
                "temp_ch0_c = { channel = 0, kind = \"pt100\" }",
                "temp_ch5_c = { channel = 5, kind = \"linear\", zero_counts = 4000.0, counts_per_c = 16.3 }",
                "source = \"warmup\"",
                "lag_s = 60.0",
                "warm_s = 5400.0",
                "max_um = 80.0",
                "exponent = 4.0",
                "cool_s = 2900.0",
                "rated_rpm = 24000.0",
                "speed_exponent = 2.0",
                "sensor = \"temp_ch5_c\"",
                "reference_c = 20.3",
                "k_um_per_c = 2.1",
                "lag_s = 1630.0",
                "reference_c = 23.0",
                "slope_um_per_m_per_c = 14.21",
                "origin_mm = 120.5",
                "lag_s = 0.5",
                "width_um = -4.3",
                "ramp_mm = 0.05",
                "hysteresis_um = 1.7",
                "z_of_x_um_per_m = 12.7",
            ],
        );
        assert!(
            shown.toml.starts_with("# Compiles back to the same calibration."),
            "{}",
            shown.toml
        );
    }

    #[test]
    fn a_segments_bezier_points_are_the_control_points_of_its_polynomial() {
        let shown = shown(
            "[straightness.z_of_x]\norder = 4\nknots_mm = [0, 0, 0, 0, 500, 500, 500, 500]\n\
             control_um = [0, 3, -2.5, 1]",
        );
        let line = shown.toml.lines().find_map(|line| line.strip_prefix("control_um = "));
        let points: Vec<f64> = line
            .expect("a curve is shown")
            .trim_matches(['[', ']'])
            .split(", ")
            .map(|number| number.parse().expect("a number"))
            .collect();
        for (point, expected) in points.iter().zip([0.0, 3.0, -2.5, 1.0]) {
            assert!((point - expected).abs() < 5e-5, "{points:?}");
        }
        assert_lines(&shown, &["knots_mm = [0.0, 0.0, 0.0, 0.0, 500.0, 500.0, 500.0, 500.0]"]);
        assert!(shown.largest_difference_nm.is_ok_and(|nm| nm < 0.1), "{}", shown.toml);
    }

    #[test]
    fn without_a_source_no_input_is_shown() {
        let shown = shown("");
        assert_eq!(shown.largest_difference_nm, Ok(0.0));
        assert!(!shown.toml.contains("spindle") && !shown.toml.contains("inputs"));
    }

    #[test]
    fn a_law_without_a_slope_is_shown_too() {
        let sensor = SensorLaw { k0: Nanometres(1234), zero: Reading(i32::MIN), slope: Slope(0) };
        let paper = paper_but("", "");
        let mut calibration = paper.calibration();
        calibration.spindle.sensor = sensor;
        let shown = show(&calibration);
        assert!(shown.largest_difference_nm.is_ok_and(|nm| nm < 0.01), "{}", shown.toml);
    }

    #[test]
    fn what_no_machine_file_compiles_to_is_shown_with_the_reason() {
        let paper = paper_but("", "");
        let good = paper.calibration();
        let mut no_slew = good;
        no_slew.limits.slew_nm_per_s = 0;
        let mut no_timeout = good;
        no_timeout.limits.link_timeout_ms = 0;
        let mut other_chain = good;
        other_chain.spindle.chain[1] = Some(calibration::ElongationSource::Sensor);
        let mut too_far = good;
        too_far.spindle.sensor.k0 = Nanometres(i32::MAX);
        for (calibration, reason) in [
            (no_slew, "limits.slew_um_per_s must be above 0"),
            (no_timeout, "limits.link_timeout_ms must be from 1"),
            (other_chain, "no machine file"),
            (too_far, "beyond the board's"),
        ] {
            let shown = show(&calibration);
            let error = shown.largest_difference_nm.expect_err(reason);
            assert!(error.contains(reason), "{error}");
            assert!(shown.toml.starts_with("# Does not compile back to this calibration: "));
            assert!(shown.toml.contains("[limits]"));
        }
    }

    #[test]
    fn a_direction_that_is_too_long_comes_back_at_length_1() {
        let paper = paper_but("", "");
        let mut calibration = paper.calibration();
        calibration.kinematics.zero.0[2] -= 500;
        let shown = show(&calibration);
        // 500 of 2³⁰, of a millimetre.
        let nm = shown.largest_difference_nm.expect("it compiles");
        assert!((nm - 0.4657).abs() < 1e-3, "{nm}");
        assert!(shown.toml.starts_with("# Compiles back to within 0.466 nm of the board's"));
    }
}
