//! From what the user writes (µm, counts, seconds) to the integers that the board runs.
//!
//! The sensor's law in reading units, with Z, S and K what is stored:
//!
//! ```text
//! Z = round(reading of V₀)
//! S = round(2²⁸ · nm per reading unit)
//! K = round(K₀ + (Z − V₀)·S/2²⁸)       V₀ exact: K takes up what rounding Z has moved
//! elongation in nm = K + (reading − Z)·S/2²⁸
//! ```
//!
//! The stored law is linear, as the model is, so the largest difference between the two over the
//! input range is at one of its ends. It is measured at both for every calibration and refused
//! above [`LARGEST_DIFFERENCE_NM`]. Measured: 0 nm for the paper's sensor, whose constants are
//! exact here, and at most 0.506 nm over 200 000 random sensors with the zero reading in range, of
//! which 0.5 nm is K's rounding (`the_stored_law_is_within_0_51_nm_…` below). What the board adds
//! when it runs the law is the rounding of the reading (half a unit, 0.06 nm for the paper's
//! sensor) and of the result (half a nanometre).

mod curve;
mod heat;
pub(crate) mod term;

use trueup_core::{
    calibration::{self, AXIS_PAIRS, Calibration},
    cnc,
    dimensions::CHANNELS,
    gradient::Gradient,
    kinematics::{self, Kinematics},
    lag::SmoothingFactor,
    limits::Limits,
    pitch::{Beam, Pitch},
    sensor::{SensorLaw, Slope},
    thermal::Law,
    thermometer::Thermometer,
    tool::Direction,
    travel::{self, Fraction, Interval},
    units::{Fine, NANOMETRES_PER_MICROMETRE, Nanometres, Position, Reading},
};
use trueup_store::calibration::{MAX_SIZE, TooLarge, decode, encode};

use crate::{
    file::{self, LinearAxis, Machine, RotaryAxis, SensorModel, Source},
    inputs::{SensorInput, TemperatureKind},
    model,
    place::BadInput,
};
use curve::OwnedCurve;
use heat::Pieces;

/// The largest offset that the wire can carry, either way, in µm: a 20-bit signed number of 10 nm.
pub const WIRE_LIMIT_UM: f64 = 5242.87;

/// A part of a calibration further than this from the model, in nm anywhere in its range, is
/// refused.
pub const LARGEST_DIFFERENCE_NM: f64 = 2.0;

/// The steepest slope of a table or a curve in µm per mm. Beyond it is no machine but a mistake.
pub const STEEPEST_UM_PER_MM: f64 = 10.0;

const NM_PER_UM: f64 = NANOMETRES_PER_MICROMETRE as f64;
const FINE_PER_UM: f64 = NM_PER_UM * Fine::PER_NANOMETRE as f64;
const UNITS_PER_MM: f64 = Position::PER_MILLIMETRE as f64;
const SLOPE_ONE: f64 = (1_u64 << Slope::FRACTION_BITS) as f64;

/// A machine in the integers of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct Compiled {
    blob: Vec<u8>,
    /// Each part with its largest difference from the model, in nm.
    pub parts: Vec<(String, f64)>,
    /// The largest of these.
    pub largest_difference_nm: f64,
}

impl Compiled {
    /// The bytes that the board stores.
    #[must_use]
    pub fn blob(&self) -> &[u8] {
        &self.blob
    }

    /// What the board reads in them.
    ///
    /// # Panics
    /// Never: [`compile`] has read the blob.
    #[must_use]
    pub fn calibration(&self) -> Calibration<'_> {
        decode(&self.blob).expect("read once when it was compiled")
    }
}

/// The tables of one axis.
struct AxisTables {
    law: Pieces,
    /// Of the lag, rising and falling.
    smoothing: [SmoothingFactor; 2],
    pitch: Option<PitchTables>,
    dual: Option<PitchTables>,
}

/// The tables of one pitch section.
struct PitchTables {
    start: Position,
    step: Interval,
    forward: Vec<[u8; 4]>,
    reverse: Option<Vec<[u8; 4]>>,
}

impl PitchTables {
    fn view(&self) -> Pitch<'_> {
        Pitch {
            start: self.start,
            step: self.step,
            forward: &self.forward,
            reverse: self.reverse.as_deref(),
        }
    }
}

/// What was found out on the way: each part with its largest difference from the model.
struct Account<'m> {
    machine: &'m Machine,
    parts: Vec<(String, f64)>,
}

impl Account<'_> {
    /// Takes up what became of the section `key`, and refuses what is too far from the model.
    fn take<T>(&mut self, key: &str, made: Result<(T, f64), String>) -> Result<T, BadInput> {
        let bad = |rule: String| self.machine.places.bad(key, rule);
        let (table, difference_nm) = made.map_err(bad)?;
        if difference_nm > LARGEST_DIFFERENCE_NM {
            return Err(bad(format!(
                "would be {difference_nm:.1} nm off on the board, more than \
                 {LARGEST_DIFFERENCE_NM} nm"
            )));
        }
        self.parts.push((key.to_string(), difference_nm));
        Ok(table)
    }
}

/// Turns `machine` into what the board runs. A machine without a spindle source compiles to no
/// elongation, and needs no sensor.
///
/// # Errors
/// Something that is in use is not described in `[inputs]`, a value does not fit the board's integer
/// for it, a part would be further than [`LARGEST_DIFFERENCE_NM`] from the model, a slope is beyond
/// [`STEEPEST_UM_PER_MM`], or all of it does not fit the board; with the key and, for a machine that
/// was read from a file, its place.
pub fn compile(machine: &Machine) -> Result<Compiled, BadInput> {
    let (machine, falling) = model::corrected(machine.compensated());
    let machine = &*machine;
    let mut account = Account { machine, parts: Vec::new() };
    let limits = compile_limits(machine)?;
    let spindle = SpindleTables::of(machine, falling.spindle_s, &mut account)?;
    let mut axes = Vec::new();
    for (axis, name) in machine.axes.iter().zip(LinearAxis::ALL) {
        let falling_s = falling.axes_s[name.index()];
        axes.push(compile_axis(axis, name, falling_s, &mut account)?);
    }
    let mut curves: [OwnedCurve; 6] = std::array::from_fn(|_| OwnedCurve::NONE);
    for straightness in &machine.straightness {
        let key = format!("straightness.{}", straightness.name());
        let made = compile_curve(&straightness.spline);
        curves[crossed(straightness.error, straightness.along)] = account.take(&key, made)?;
    }
    let mut squareness = [Gradient::ZERO; 6];
    for entry in &machine.squareness {
        let key = format!("squareness.{}", entry.name());
        let made = compile_squareness(entry.um_per_m);
        squareness[crossed(entry.error, entry.along)] = account.take(&key, made)?;
    }
    let terms = term::terms(machine, &mut account)?;
    let [x, y, z] = [0, 1, 2].map(|number| axis_view(machine, number, &axes[number]));
    let calibration = Calibration {
        thermometers: thermometers(machine)?,
        spindle: spindle.view(machine)?,
        kinematics: Kinematics {
            zero: compile_direction(machine.tool_direction),
            axes: std::array::from_fn(|n| machine.head_axes.get(n).map(|axis| rotary(*axis))),
        },
        axes: [x?, y?, z?],
        straightness: std::array::from_fn(|n| curves[n].view()),
        squareness,
        terms: term::views(&terms),
        limits,
    };
    let mut room = vec![0; 4 * MAX_SIZE];
    let blob = encode(&calibration, &mut room)
        .map_err(|TooLarge { bytes }| {
            let rule = format!(
                "is too much for the board: {bytes} bytes, and it stores {MAX_SIZE}; the tables \
                 and curves have to be shorter"
            );
            machine.places.bad("machine", rule)
        })?
        .to_vec();
    match decode(&blob) {
        Ok(read) if read == calibration => {}
        Ok(_) => {
            return Err(machine.places.bad("machine", "does not come back from its blob whole"));
        }
        Err(error) => {
            return Err(machine.places.bad("machine", format!("the board would refuse: {error}")));
        }
    }
    let parts = account.parts;
    let largest_difference_nm = parts.iter().fold(0.0, |worst: f64, (_, nm)| worst.max(*nm));
    Ok(Compiled { blob, parts, largest_difference_nm })
}

/// The place of a pair of axes in the board's order.
fn crossed(error: LinearAxis, along: LinearAxis) -> usize {
    let pair = (error.index(), along.index());
    AXIS_PAIRS
        .iter()
        .position(|(of, over)| (*of as usize, *over as usize) == pair)
        .expect("two different axes are one of the six pairs")
}

fn rotary(axis: RotaryAxis) -> kinematics::RotaryAxis {
    match axis {
        RotaryAxis::A => kinematics::RotaryAxis::A,
        RotaryAxis::B => kinematics::RotaryAxis::B,
        RotaryAxis::C => kinematics::RotaryAxis::C,
    }
}

fn linear(axis: LinearAxis) -> cnc::LinearAxis {
    cnc::LinearAxis::ALL[axis.index()]
}

/// The channel of a temperature column that the section `key` uses.
fn channel(machine: &Machine, key: &str, column: &str) -> Result<u8, BadInput> {
    let input = machine.inputs.as_ref().and_then(|inputs| inputs.temperatures.get(column));
    input.map(|input| input.channel).ok_or_else(|| {
        let rule = format!(
            "is \"{column}\", which [inputs] does not describe: the board must know its channel"
        );
        machine.places.bad(&format!("{key}.sensor"), rule)
    })
}

fn thermometers(machine: &Machine) -> Result<[Option<Thermometer>; CHANNELS], BadInput> {
    let mut thermometers = [None; CHANNELS];
    for (name, input) in machine.inputs.iter().flat_map(|inputs| &inputs.temperatures) {
        let key = format!("inputs.{name}");
        let thermometer = match input.kind {
            TemperatureKind::Pt100 => Some(Thermometer::Pt100),
            TemperatureKind::Linear { zero_counts, counts_per_c } => {
                linear_thermometer(zero_counts, counts_per_c)
            }
        };
        let Some(thermometer) = thermometer else {
            let rule = "has counts that the board cannot store: counts_per_c must be from 0.01 to \
                        10000 either way, zero_counts within ±8388607";
            return Err(machine.places.bad(&key, rule));
        };
        let place = thermometers.get_mut(usize::from(input.channel));
        *place.ok_or_else(|| {
            machine.places.bad(&format!("{key}.channel"), "must be from 0 to 7")
        })? = Some(thermometer);
    }
    Ok(thermometers)
}

/// Counts are delivered in 1/256; the slope has as many binary places as fit. `None` outside the
/// range that the rule names: what would still fit beyond it is a slip of the pen.
fn linear_thermometer(zero_counts: f64, counts_per_c: f64) -> Option<Thermometer> {
    const DELIVERED_PER_COUNT: f64 = 256.0;
    if !(0.01..=10_000.0).contains(&counts_per_c.abs()) {
        return None;
    }
    let units = f64::from(trueup_core::units::Temperature::PER_KELVIN)
        / (counts_per_c * DELIVERED_PER_COUNT);
    let slope_at = |shift: u8| rounded(units * 2_f64.powi(shift.into()));
    let shift = (0..=Thermometer::MAX_SHIFT).rev().find(|&shift| slope_at(shift).is_some())?;
    let slope = slope_at(shift)?;
    let zero = rounded(zero_counts * DELIVERED_PER_COUNT)?;
    Some(Thermometer::Linear { zero, slope, shift })
}

/// What the spindle's models have become.
struct SpindleTables {
    sensor: SensorLaw,
    /// With the smoothing factors of its lag, rising and falling.
    temperature: Option<(Pieces, [SmoothingFactor; 2])>,
    warmup: Option<(trueup_core::warmup::Warmup, OwnedCurve)>,
}

impl SpindleTables {
    fn of(
        machine: &Machine,
        falling_s: Option<f64>,
        account: &mut Account<'_>,
    ) -> Result<Self, BadInput> {
        let spindle = &machine.spindle;
        let mut sensor = SensorLaw::default();
        if let Some(model) = machine.sensor_on_board() {
            let difference_nm;
            (sensor, difference_nm) = compile_sensor(machine, model)?;
            account.parts.push(("spindle.sensor".into(), difference_nm));
        }
        let temperature = spindle.temperature.as_ref().map(|model| {
            let key = "spindle.temperature";
            let law = heat::spindle_law(model.k_um_per_c, model.reference_c);
            let law = account.take(key, law.map(|law| (law, 0.0)))?;
            let factors =
                heat::smoothing_factors(model.lag_s, falling_s).map(|factors| (factors, 0.0));
            Ok((law, account.take(&format!("{key}.lag_s"), factors)?))
        });
        let warmup = spindle.warmup.as_ref().map(|model| {
            let made = heat::warmup(model);
            account.take("spindle.warmup", made.map(|made| (made, 0.0)))
        });
        Ok(Self { sensor, temperature: temperature.transpose()?, warmup: warmup.transpose()? })
    }

    /// The source first, then what else is configured, the better first.
    fn view(&self, machine: &Machine) -> Result<calibration::SpindleModel<'_>, BadInput> {
        let spindle = &machine.spindle;
        let temperature = match (&self.temperature, &spindle.temperature) {
            (Some((law, [smoothing, smoothing_falling])), Some(model)) => {
                let law = Law { pieces: law };
                match channel(machine, "spindle.temperature", &model.sensor) {
                    Ok(channel) => Some(calibration::SpindleTemperature {
                        channel,
                        smoothing: *smoothing,
                        smoothing_falling: *smoothing_falling,
                        law,
                    }),
                    // A fall-back whose thermometer is not connected is none.
                    Err(_) if spindle.source != Some(Source::Temperature) => None,
                    Err(error) => return Err(error),
                }
            }
            _ => None,
        };
        let warmup = self
            .warmup
            .as_ref()
            .map(|(law, power)| calibration::SpindleWarmup { law: *law, power: power.view() });
        let board = |source| match source {
            Source::Sensor => calibration::ElongationSource::Sensor,
            Source::Temperature => calibration::ElongationSource::Temperature,
            Source::Warmup => calibration::ElongationSource::Warmup,
        };
        let mut chain = [None; 3];
        if let Some(first) = spindle.source {
            let there = |source: &Source| match source {
                Source::Sensor => self.sensor != SensorLaw::default(),
                Source::Temperature => temperature.is_some(),
                Source::Warmup => warmup.is_some(),
            };
            let others = [Source::Sensor, Source::Temperature, Source::Warmup].into_iter();
            let others = others.filter(|&source| source != first).filter(there);
            for (place, source) in chain.iter_mut().zip([first].into_iter().chain(others)) {
                *place = Some(board(source));
            }
        }
        Ok(calibration::SpindleModel { chain, sensor: self.sensor, temperature, warmup })
    }
}

fn compile_axis(
    axis: &file::Axis,
    name: LinearAxis,
    falling_s: Option<f64>,
    account: &mut Account<'_>,
) -> Result<AxisTables, BadInput> {
    let key = format!("axis.{}", name.name());
    let mut tables = AxisTables {
        law: Pieces::new(),
        smoothing: [SmoothingFactor::NO_LAG; 2],
        pitch: None,
        dual: None,
    };
    if let Some(thermal) = &axis.thermal {
        tables.law = account.take(&format!("{key}.thermal"), heat::axis_law(thermal))?;
        let factors =
            heat::smoothing_factors(thermal.lag_s, falling_s).map(|factors| (factors, 0.0));
        tables.smoothing = account.take(&format!("{key}.thermal.lag_s"), factors)?;
    }
    if let Some(pitch) = &axis.pitch {
        tables.pitch = Some(account.take(&format!("{key}.pitch"), compile_pitch(pitch))?);
    }
    if let Some(dual) = &axis.dual {
        tables.dual = Some(account.take(&format!("{key}.dual.pitch"), compile_pitch(&dual.pitch))?);
    }
    Ok(tables)
}

fn axis_view<'t>(
    machine: &Machine,
    number: usize,
    tables: &'t AxisTables,
) -> Result<calibration::AxisModel<'t>, BadInput> {
    let axis = &machine.axes[number];
    let key = format!("axis.{}", LinearAxis::ALL[number].name());
    let bad = |key: String, rule: String| machine.places.bad(&key, rule);
    let position = |key: &str, mm: f64| {
        rounded(mm * UNITS_PER_MM)
            .map(Position)
            .ok_or_else(|| bad(key.into(), format!("{mm} is beyond the board's ±21474 mm")))
    };
    let length = |key: String, mm: f64| {
        let units = (mm * UNITS_PER_MM).round();
        (0.0..=f64::from(u32::MAX))
            .contains(&units)
            .then_some(units as u32)
            .ok_or_else(|| bad(key, format!("{mm} mm is beyond the board's 42949 mm")))
    };
    let thermal = match &axis.thermal {
        None => None,
        Some(thermal) => {
            let key = format!("{key}.thermal");
            Some(calibration::AxisThermal {
                channel: channel(machine, &key, &thermal.sensor)?,
                smoothing: tables.smoothing[0],
                smoothing_falling: tables.smoothing[1],
                origin: position(&format!("{key}.origin_mm"), thermal.origin_mm)?,
                law: Law { pieces: &tables.law },
            })
        }
    };
    let dual = match (&axis.dual, &tables.dual) {
        (Some(dual), Some(pitch)) => {
            let first = position(&format!("{key}.dual.first_mm"), dual.first_mm)?;
            let second = position(&format!("{key}.dual.second_mm"), dual.second_mm)?;
            let beam = Beam::new(first, second);
            Some(calibration::Dual { across: linear(dual.across), beam, pitch: pitch.view() })
        }
        _ => None,
    };
    let (mut backlash, mut travel) = (Fine::ZERO, travel::Config::default());
    if let Some(model) = &axis.backlash {
        let key = format!("{key}.backlash");
        backlash = rounded(model.width_um * FINE_PER_UM).map(Fine).ok_or_else(|| {
            let rule = format!("{} is beyond the board's ±8388 µm", model.width_um);
            bad(format!("{key}.width_um"), rule)
        })?;
        travel = travel::Config {
            hysteresis: length(format!("{key}.hysteresis_um"), model.hysteresis_um / 1_000.0)?,
            ramp: Interval::new(length(format!("{key}.ramp_mm"), model.ramp_mm)?),
        };
    }
    let pitch = tables.pitch.as_ref().map(PitchTables::view);
    Ok(calibration::AxisModel { thermal, pitch, dual, backlash, travel })
}

/// A pitch table, and its largest difference from the model in nm.
fn compile_pitch(pitch: &file::Pitch) -> Result<(PitchTables, f64), String> {
    let start = rounded(pitch.start_mm * UNITS_PER_MM)
        .map(Position)
        .ok_or_else(|| format!("starts at {} mm, beyond the board's ±21474 mm", pitch.start_mm))?;
    let step = (pitch.step_mm * UNITS_PER_MM).round();
    if !(1.0..=f64::from(u32::MAX)).contains(&step) {
        return Err(format!(
            "has a step of {} mm; the board's are 10 nm to 42949 mm",
            pitch.step_mm
        ));
    }
    let points = |errors: &[f64]| {
        let stored = errors.iter().map(|&um| {
            let point = rounded(um * FINE_PER_UM).map(i32::to_le_bytes);
            point.ok_or_else(|| format!("has {um} µm, beyond the board's ±8388 µm"))
        });
        stored.collect::<Result<Vec<_>, _>>()
    };
    for errors in [Some(&pitch.forward_um), pitch.reverse_um.as_ref()].into_iter().flatten() {
        for (number, pair) in errors.windows(2).enumerate() {
            let slope = (pair[1] - pair[0]) / pitch.step_mm;
            if slope.abs() > STEEPEST_UM_PER_MM {
                let at = pitch.start_mm + pitch.step_mm * number as f64;
                return Err(too_steep(slope, at));
            }
        }
    }
    let tables = PitchTables {
        start,
        step: Interval::new(step as u32),
        forward: points(&pitch.forward_um)?,
        reverse: pitch.reverse_um.as_deref().map(points).transpose()?,
    };
    let difference_nm = pitch_difference_nm(pitch, &tables.view());
    Ok((tables, difference_nm))
}

/// At every point and at places between, from both sides.
fn pitch_difference_nm(pitch: &file::Pitch, board: &Pitch<'_>) -> f64 {
    const PLACES: usize = 8;
    let mut worst: f64 = 0.0;
    for place in 0..=(pitch.forward_um.len() - 1) * PLACES {
        let mm = pitch.start_mm + pitch.step_mm * place as f64 / PLACES as f64;
        let Some(units) = rounded(mm * UNITS_PER_MM) else { continue };
        let mm = f64::from(units) / UNITS_PER_MM;
        for (direction, blend) in [(1.0, Fraction::ZERO), (-1.0, Fraction::ONE)] {
            let stored = f64::from(board.at(Position(units), blend).0.0) / FINE_PER_UM * NM_PER_UM;
            worst = worst.max((stored - model::pitch_um(pitch, mm, direction) * NM_PER_UM).abs());
        }
    }
    worst
}

fn compile_curve(spline: &file::BSpline) -> Result<(OwnedCurve, f64), String> {
    let pieces = curve::pieces_of(spline)?;
    let (slope, at) = curve::steepest(&pieces);
    if slope.abs() > STEEPEST_UM_PER_MM {
        return Err(too_steep(slope, at));
    }
    let curve = curve::build(&pieces)?;
    let difference_nm = curve.largest_difference_nm;
    Ok((curve, difference_nm))
}

fn too_steep(um_per_mm: f64, at_mm: f64) -> String {
    format!(
        "rises by {um_per_mm:.1} µm per mm at {at_mm} mm, more than {STEEPEST_UM_PER_MM}: are the \
         units right?"
    )
}

/// A squareness, and its largest difference from the model in nm over 15 m.
fn compile_squareness(um_per_m: f64) -> Result<(Gradient, f64), String> {
    const CHECKED_M: f64 = 15.0;
    let exact = um_per_m * heat::GRADIENT_PER_UM_PER_M;
    let gradient =
        rounded(exact).ok_or_else(|| format!("{um_per_m} is beyond the board's ±3125 µm/m"))?;
    let difference = (f64::from(gradient) - exact) / heat::GRADIENT_PER_UM_PER_M;
    Ok((Gradient(gradient), difference.abs() * CHECKED_M * NM_PER_UM))
}

/// The elongation in nm that `law` gives at full resolution: before the board rounds the reading
/// and the result.
#[must_use]
pub fn stored_law_nm(law: &SensorLaw, reading: f64) -> f64 {
    let slope_nm = f64::from(law.slope.0) / SLOPE_ONE;
    f64::from(law.k0.0) + (reading - f64::from(law.zero.0)) * slope_nm
}

fn compile_sensor(machine: &Machine, model: &SensorModel) -> Result<(SensorLaw, f64), BadInput> {
    let Some(input) = machine.inputs.as_ref().and_then(|inputs| inputs.sensor) else {
        let rule = "is missing: the board must know how the sensor's counts reach it";
        return Err(machine.places.bad("inputs.sensor", rule));
    };
    let readings_per_count = input.exact_reading_from_counts(1.0);
    let slope_nm = model.um_per_count * NM_PER_UM / readings_per_count;
    let zero_reading = input.exact_reading_from_counts(model.zero_counts);

    let slope = rounded(slope_nm * SLOPE_ONE).ok_or_else(|| {
        let rule = format!(
            "{} is {slope_nm:.3} nm for one of the board's reading units, which must be below 8: \
             at most {} µm a count with this input",
            model.um_per_count,
            8.0 * readings_per_count / NM_PER_UM
        );
        machine.places.bad("spindle.sensor.um_per_count", rule)
    })?;
    let zero = rounded(zero_reading).ok_or_else(|| {
        let rule = format!("{} is outside what the board can store", model.zero_counts);
        machine.places.bad("spindle.sensor.zero_counts", rule)
    })?;
    let moved_by_zero = (f64::from(zero) - zero_reading) * (f64::from(slope) / SLOPE_ONE);
    let k0 = rounded(model.k0_um * NM_PER_UM + moved_by_zero).ok_or_else(|| {
        let rule = format!("{} is beyond the board's ±2147483 µm", model.k0_um);
        machine.places.bad("spindle.sensor.k0_um", rule)
    })?;
    let law = SensorLaw { k0: Nanometres(k0), zero: Reading(zero), slope: Slope(slope) };

    let largest_difference_nm = largest_difference_nm(&law, model, &input);
    if largest_difference_nm > LARGEST_DIFFERENCE_NM {
        let rule = format!(
            "{} is so far outside the input range that the board's law would be \
             {largest_difference_nm:.1} nm off, more than {LARGEST_DIFFERENCE_NM} nm",
            model.zero_counts
        );
        return Err(machine.places.bad("spindle.sensor.zero_counts", rule));
    }
    for counts in [0.0, input.counts_full_scale] {
        let elongation_um = model::elongation_um(model, counts);
        if rounded(elongation_um * NM_PER_UM).is_none() {
            let rule = format!(
                "gives {elongation_um} µm at {counts} counts, beyond the board's ±2147483 µm"
            );
            return Err(machine.places.bad("spindle.sensor", rule));
        }
    }
    Ok((law, largest_difference_nm))
}

/// At the ends of the input range, where a linear function is largest.
fn largest_difference_nm(law: &SensorLaw, model: &SensorModel, input: &SensorInput) -> f64 {
    let difference = |counts: f64| {
        let stored = stored_law_nm(law, input.exact_reading_from_counts(counts));
        (stored - model::elongation_um(model, counts) * NM_PER_UM).abs()
    };
    difference(0.0).max(difference(input.counts_full_scale))
}

fn compile_direction(tool_direction: [f64; 3]) -> Direction {
    // A component is at most 1 in magnitude, give or take the last bit of an f64: it always fits.
    Direction(
        tool_direction.map(|component| (component * f64::from(Direction::ONE)).round() as i32),
    )
}

fn compile_limits(machine: &Machine) -> Result<Limits, BadInput> {
    let limits = &machine.limits;
    let mut max = [Nanometres::ZERO; 3];
    for ((stored, axis), max_um) in max.iter_mut().zip(["x", "y", "z"]).zip(limits.max_um) {
        let bad = |rule: String| machine.places.bad(&format!("limits.max_um.{axis}"), rule);
        if !(0.0..=WIRE_LIMIT_UM).contains(&max_um) {
            return Err(bad(format!(
                "{max_um} is not within 0 to {WIRE_LIMIT_UM} µm, what the wire can carry"
            )));
        }
        *stored = Nanometres(rounded(max_um * NM_PER_UM).expect("held to ±5.3 mm above"));
    }
    let slew_nm_per_s = (limits.slew_um_per_s * NM_PER_UM).round();
    if !(1.0..=f64::from(u32::MAX)).contains(&slew_nm_per_s) {
        let rule = format!(
            "{} is not within 0.001 to 4294967 µm/s, what the board can store",
            limits.slew_um_per_s
        );
        return Err(machine.places.bad("limits.slew_um_per_s", rule));
    }
    if limits.link_timeout_ms == 0 {
        let rule = "must be at least 1: at 0 the CNC would always count as lost";
        return Err(machine.places.bad("limits.link_timeout_ms", rule));
    }
    Ok(Limits {
        max,
        // Held to the range of u32 above.
        slew_nm_per_s: slew_nm_per_s as u32,
        link_timeout_ms: limits.link_timeout_ms,
        hold_ms: limits.hold_ms,
    })
}

/// The nearest integer, or `None` where `i32` does not reach.
fn rounded(value: f64) -> Option<i32> {
    let nearest = value.round();
    (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&nearest).then_some(nearest as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MachineFile;
    use std::path::Path;

    /// The paper's machine file with `from` replaced by `to`.
    fn paper_but(from: &str, to: &str) -> Machine {
        let text = include_str!("../../../data/paper_spindle.toml");
        assert!(text.contains(from), "{from} is not in the paper's machine file");
        MachineFile::parse(&text.replace(from, to), Path::new("paper.toml"))
            .expect("the changed file is right by itself")
    }

    fn paper() -> Machine {
        paper_but("", "")
    }

    #[test]
    fn the_papers_constants_are_exact_in_the_boards_integers() {
        let compiled = compile(&paper()).expect("the paper's sensor fits");
        // 500 000 nm over 2²² reading units, times 2²⁸.
        assert_eq!(compiled.calibration().spindle.sensor.slope, Slope(32_000_000));
        assert_eq!(compiled.calibration().spindle.sensor.zero, Reading(5048 * 128));
        assert_eq!(compiled.calibration().spindle.sensor.k0, Nanometres(0));
        assert_eq!(compiled.calibration().kinematics.zero, Direction::DOWN);
        assert!(compiled.largest_difference_nm < 1e-9);
    }

    #[test]
    fn the_board_is_within_half_a_nanometre_of_the_papers_model_at_every_count() {
        let machine = paper();
        let law = compile(&machine).expect("the paper's sensor fits").calibration().spindle.sensor;
        let input = machine.inputs.as_ref().and_then(|inputs| inputs.sensor).expect("the paper's");
        for counts in (0..=32_768).map(f64::from) {
            let board = f64::from(law.elongation(input.reading_from_counts(counts)).0);
            let difference = board - machine.elongation_um(counts) * NM_PER_UM;
            assert!(difference.abs() <= 0.5, "{counts} counts: {difference} nm");
        }
    }

    #[test]
    fn the_limits_arrive_in_nanometres_and_milliseconds() {
        let limits = compile(&paper()).expect("the paper's sensor fits").calibration().limits;
        assert_eq!(limits.max, [200_000, 200_000, 500_000].map(Nanometres));
        assert_eq!(limits.slew_nm_per_s, 20_000);
        assert_eq!((limits.link_timeout_ms, limits.hold_ms), (500, 2000));
    }

    #[test]
    fn a_direction_has_length_one_within_two_of_its_units() {
        let machine =
            paper_but("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [1, -2, 3]");
        let Direction(v) =
            compile(&machine).expect("a direction always fits").calibration().kinematics.zero;
        let length = v.iter().map(|&c| f64::from(c) * f64::from(c)).sum::<f64>().sqrt();
        assert!((length - f64::from(Direction::ONE)).abs() < 2.0);
        assert!(v[0] > 0 && v[1] < 0 && v[2] > 0);
    }

    #[test]
    fn without_a_source_the_law_is_zero_and_no_input_is_needed() {
        let machine = MachineFile::parse(
            "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n",
            Path::new("m.toml"),
        )
        .expect("the shortest machine file");
        let compiled = compile(&machine).expect("nothing to fit");
        assert_eq!(compiled.calibration().spindle.sensor, SensorLaw::default());
    }

    #[test]
    fn a_law_of_the_sensor_is_on_the_board_as_the_source_or_where_a_sensor_is_connected() {
        let warmup =
            "source = \"warmup\"\nwarmup = { lag_s = 0, warm_s = 9, max_um = 80, exponent = 4 }";
        let input =
            "sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }";
        let source = "source = \"sensor\"";
        let mut unconnected = paper_but(source, warmup);
        unconnected.inputs = None;
        for (machine, is_on_board) in [
            (paper(), true),
            (paper_but(source, warmup), true),
            (unconnected, false),
            (paper_but(&format!("[inputs]\n{input}"), ""), true),
            (paper_but(source, ""), false),
        ] {
            assert_eq!(machine.sensor_on_board().is_some(), is_on_board);
            // Without an input the board cannot run it as the source, and says so.
            let Ok(compiled) = compile(&machine) else { continue };
            let law = compiled.calibration().spindle.sensor;
            assert_eq!(law != SensorLaw::default(), is_on_board);
        }
    }

    #[test]
    fn a_sensor_whose_growth_lowers_the_reading_has_a_negative_slope() {
        let machine =
            paper_but("um_per_count = 0.0152587890625", "um_per_count = -0.0152587890625");
        let law = compile(&machine).expect("fits").calibration().spindle.sensor;
        assert_eq!(law.slope, Slope(-32_000_000));
        let reading = 128.0 * (5048.0 - 1000.0);
        assert!((stored_law_nm(&law, reading) - 15_258.789_062_5).abs() < 1e-9);
    }

    /// Any calibration that the zero reading in range and a slope within the format allow.
    #[test]
    fn the_stored_law_is_within_0_51_nm_of_the_model_for_any_sensor_with_its_zero_in_range() {
        let mut machine = paper();
        let mut seed = 0x2545_f491_4f6c_dd1d_u64;
        let mut uniform = |from: f64, to: f64| {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            from + (to - from) * (seed >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut worst: f64 = 0.0;
        for _ in 0..200_000 {
            let counts_full_scale = uniform(1000.0, 70_000.0).round();
            let volts_full_scale = uniform(1.0, 20.0);
            let divider = uniform(0.3, 1.0) * 3.3 / volts_full_scale;
            let input = SensorInput { volts_full_scale, counts_full_scale, divider };
            let steepest = 7.99 * input.exact_reading_from_counts(1.0) / NM_PER_UM;
            machine.inputs.as_mut().expect("the paper's has inputs").sensor = Some(input);
            machine.spindle.sensor = Some(SensorModel {
                k0_um: uniform(-500.0, 500.0),
                zero_counts: uniform(0.0, counts_full_scale),
                um_per_count: uniform(-steepest, steepest),
                temperature: None,
            });
            let compiled = compile(&machine).expect("within every range");
            worst = worst.max(compiled.largest_difference_nm);
        }
        assert!((0.49..0.51).contains(&worst), "worst {worst} nm");
    }

    #[test]
    fn the_difference_at_the_ends_is_the_largest_in_between() {
        let machine = paper_but("um_per_count = 0.0152587890625", "um_per_count = 0.0198");
        let compiled = compile(&machine).expect("fits");
        let input = machine.inputs.as_ref().and_then(|inputs| inputs.sensor).expect("the paper's");
        let law = &compiled.calibration().spindle.sensor;
        for counts in 0..=32_768 {
            let counts = f64::from(counts);
            let stored = stored_law_nm(law, input.exact_reading_from_counts(counts));
            let difference = (stored - machine.elongation_um(counts) * NM_PER_UM).abs();
            assert!(difference <= compiled.largest_difference_nm + 1e-9);
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_with_its_key_and_place() {
        let cases = [
            (
                "um_per_count = 0.0152587890625",
                "um_per_count = 1.1",
                "16:16: spindle.sensor.um_per_count 1.1 is 8.594 nm",
            ),
            (
                "zero_counts = 5048.0",
                "zero_counts = 2e7",
                "15:15: spindle.sensor.zero_counts 20000000 is outside what",
            ),
            (
                // The slope is 0.45 of its unit off; the distance makes that 3.4 nm.
                "zero_counts = 5048.0\num_per_count = 0.0152587890625",
                "zero_counts = 1.6e7\num_per_count = 0.0100000002146",
                "15:15: spindle.sensor.zero_counts 16000000 is so far outside",
            ),
            ("k0_um = 0.0", "k0_um = 3e6", "14:9: spindle.sensor.k0_um 3000000 is beyond"),
            (
                "k0_um = 0.0\nzero_counts = 5048.0\num_per_count = 0.0152587890625",
                "k0_um = 2147400\nzero_counts = 0.0\num_per_count = 0.0152587890625",
                "13:10: spindle.sensor gives 2147900 µm at 32768 counts",
            ),
            ("x = 200.0", "x = 5242.88", "limits.max_um.x 5242.88 is not within 0 to 5242.87"),
            (
                "slew_um_per_s = 20.0",
                "slew_um_per_s = 0.0004",
                "limits.slew_um_per_s 0.0004 is not",
            ),
            ("slew_um_per_s = 20.0", "slew_um_per_s = 5e6", "limits.slew_um_per_s 5000000 is not"),
            (
                "sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }",
                "",
                "inputs.sensor is missing",
            ),
        ];
        for (from, to, phrase) in cases {
            let error = compile(&paper_but(from, to)).expect_err(to).to_string();
            assert!(error.contains(phrase), "{to}: {error}");
        }
    }

    #[test]
    fn every_section_reaches_the_board_and_is_accounted_for() {
        let added = "hold_ms = 2000\n\
            [axis.x]\nfeedback = \"scale\"\n\
            [axis.y.backlash]\nwidth_um = 4\nramp_mm = 0.05\nhysteresis_um = 1\n\
            [axis.z.pitch]\nstart_mm = 0\nstep_mm = 100\nforward_um = [0, 1]\n\
            [squareness]\nx_of_y_um_per_m = 1\n\
            [straightness.z_of_x]\norder = 2\nknots_mm = [0, 0, 1, 1]\ncontrol_um = [0, 1]\n";
        let compiled = compile(&paper_but("hold_ms = 2000\n", added)).expect("all of it is run");
        let calibration = compiled.calibration();
        let [x, y, z] = calibration.axes;
        assert_eq!(x, calibration::AxisModel::default());
        assert_eq!(y.backlash, Nanometres(4_000).fine());
        assert_eq!((y.travel.hysteresis, y.travel.ramp.length()), (100, 5_000));
        let points = [0, 256_000].map(i32::to_le_bytes);
        assert_eq!(
            z.pitch.map(|pitch| (pitch.start, pitch.forward)),
            Some((Position(0), &points[..]))
        );
        let places = AXIS_PAIRS.map(|(error, along)| (error as usize, along as usize));
        for (place, pair) in places.into_iter().enumerate() {
            assert_eq!(calibration.straightness[place].is_empty(), pair != (2, 0), "{pair:?}");
            // 1 µm/m is 10⁻⁵ nm per position unit, Q36.
            let gradient = if pair == (0, 1) { 687_195 } else { 0 };
            assert_eq!(calibration.squareness[place], Gradient(gradient), "{pair:?}");
        }
        let parts: Vec<&str> = compiled.parts.iter().map(|(key, _)| key.as_str()).collect();
        let expected =
            ["spindle.sensor", "axis.z.pitch", "straightness.z_of_x", "squareness.x_of_y_um_per_m"];
        assert_eq!(parts, expected);
        let worst = compiled.parts.iter().fold(0.0, |worst: f64, (_, nm)| worst.max(*nm));
        assert_eq!(worst, compiled.largest_difference_nm);
        assert!(worst < 0.1, "{:?}", compiled.parts);
    }

    #[test]
    fn the_axes_that_carry_the_spindle_arrive_from_the_frame_to_the_tool() {
        let head = "head-head\"\nhead_axes = [\"c\", \"a\"]\n#";
        let kinematics =
            compile(&paper_but("3-axis", head)).expect("fits").calibration().kinematics;
        assert_eq!(
            kinematics.axes,
            [Some(kinematics::RotaryAxis::C), Some(kinematics::RotaryAxis::A)]
        );
        let table = compile(&paper_but("3-axis", "table-table")).expect("fits");
        assert_eq!(table.calibration().kinematics.axes, [None; 2]);
    }

    #[test]
    fn the_blob_is_what_the_board_reads() {
        let compiled = compile(&paper()).expect("the paper's sensor fits");
        assert_eq!(decode(compiled.blob()), Ok(compiled.calibration()));
    }

    #[test]
    fn counts_of_a_linear_thermometer_are_read_to_a_tenth_of_a_millikelvin() {
        use trueup_core::thermometer::Raw;
        for (zero, per_c) in [(4000.0, 16.0), (-300.5, -27.3), (0.0, 0.011), (12.25, 9_999.0)] {
            let thermometer = linear_thermometer(zero, per_c).expect("within the rule");
            for step in 0..=100 {
                let celsius = f64::from(step) - 20.0;
                let raw = ((zero + celsius * per_c) * 256.0).round();
                let exact_c = (raw / 256.0 - zero) / per_c;
                let Ok(read) = thermometer.read(Raw(raw as i32)) else { continue };
                let off_mk = f64::from(read.0) / f64::from(4_096) - exact_c * 1_000.0;
                assert!(off_mk.abs() < 0.1, "{zero} {per_c}: {off_mk} mK at {celsius} °C");
            }
        }
        for (zero, per_c) in [(8_388_607.0, 0.01), (-8_388_607.0, -10_000.0)] {
            assert!(linear_thermometer(zero, per_c).is_some(), "{zero} {per_c} is within the rule");
        }
        for (zero, per_c) in [(0.0, 0.009), (0.0, -10_001.0), (0.0, 0.0), (8_388_608.0, 16.0)] {
            assert_eq!(linear_thermometer(zero, per_c), None, "{zero} {per_c}");
        }
    }

    #[test]
    fn the_widest_limits_of_the_wire_fit() {
        let limits =
            compile(&paper_but("x = 200.0", "x = 5242.87")).expect("fits").calibration().limits;
        assert_eq!(limits.max[0], Nanometres(5_242_870));
    }
}
