//! `[[term]]`: what a diagnosis has added to the model, one cause a table.
//!
//! A term changes the prediction p of one quantity. Most give it a new value row by row, in the
//! order of the file: y = f(p). Those that correct a constant of the model (a lag, a slope, a
//! reference) say the right one, and p itself is computed with it; `time-shift` comes last of all.
//! The formula of each is with its [`Effect`].
//!
//! `constant_um` is added by any of them: the reference of a measurement is arbitrary.

use super::{
    BSpline, LinearAxis, Machine, Pitch, Source,
    axis::{read_pitch, write_pitch},
    inputs::read_temperature_column,
    read::Section,
    straightness::{read_spline, write_spline},
    write::{NewSection, Value},
};
use crate::place::{BadInput, did_you_mean, shortened};

/// What a term, a prediction or a measurement is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Quantity {
    /// How far the tool has grown out of the spindle.
    Elongation,
    /// The error of the tool tip on X.
    Dx,
    /// On Y.
    Dy,
    /// On Z.
    Dz,
}

impl Quantity {
    /// All of them, in the order of [`Values::all`](crate::model::Values::all).
    pub const ALL: [Self; 4] = [Self::Elongation, Self::Dx, Self::Dy, Self::Dz];

    /// Its name: `elongation`, `dx`, `dy`, `dz`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Elongation => "elongation",
            Self::Dx => "dx",
            Self::Dy => "dy",
            Self::Dz => "dz",
        }
    }

    /// The axis whose error it is; `None` for the elongation.
    #[must_use]
    pub fn axis(self) -> Option<LinearAxis> {
        match self {
            Self::Elongation => None,
            Self::Dx => Some(LinearAxis::X),
            Self::Dy => Some(LinearAxis::Y),
            Self::Dz => Some(LinearAxis::Z),
        }
    }

    /// The error of this axis.
    #[must_use]
    pub fn of_axis(axis: LinearAxis) -> Self {
        [Self::Dx, Self::Dy, Self::Dz][axis.index()]
    }
}

macro_rules! causes {
    ($($variant:ident $name:literal $compensated:literal $text:literal,)*) => {
        /// Why a machine is not as its model says.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Cause {
            $(#[doc = $text] $variant,)*
        }

        impl Cause {
            /// All causes, in the order of the format's table.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// Its name in files: `thermal-lag`.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// Whether the board corrects it. What only happened once, or what is the error of the
            /// reference instrument, is explained and not corrected.
            #[must_use]
            pub fn is_compensated(self) -> bool {
                match self { $(Self::$variant => $compensated,)* }
            }
        }
    };
}

causes! {
    SensorOffset "sensor-offset" true "The zero of the sensor is elsewhere.",
    SensorGain "sensor-gain" true "The sensor gives more or less for a micrometre.",
    SensorCurvature "sensor-curvature" true "The sensor's characteristic is bent.",
    SensorSaturation "sensor-saturation" true "The sensor's range ends.",
    SensorTemperatureDrift "sensor-temperature-drift" true "The sensor follows its own temperature.",
    TimeShift "time-shift" false "Two clocks differ.",
    ThermalLag "thermal-lag" true "Growth follows its thermometer late.",
    SlowMode "slow-mode" true "A slow part of the growth.",
    ExtraHeatPath "extra-heat-path" true "Heat that the model does not know.",
    GrowthAmplitude "growth-amplitude" true "It grows more or less than believed.",
    GrowthRate "growth-rate" true "It grows faster or slower than believed.",
    CoolingAsymmetry "cooling-asymmetry" true "It cools at another rate than it heats.",
    ExpansionSlope "expansion-slope" true "The axis expands more or less than believed.",
    ReferenceTemperature "reference-temperature" true "The axis is right at another temperature.",
    CentrifugalGrowth "centrifugal-growth" true "Speed itself stretches the spindle.",
    CuttingLoad "cutting-load" true "The cut pushes the tool back.",
    PitchScale "pitch-scale" true "The scale or screw is long or short.",
    PitchError "pitch-error" true "The scale or screw is uneven.",
    PitchPeriodic "pitch-periodic" true "The error repeats with each turn or graduation.",
    Backlash "backlash" true "The axis is left behind on reversal.",
    PositionDependentBacklash "position-dependent-backlash" true "Backlash differs along the axis.",
    Straightness "straightness" true "The guide is not straight.",
    CrossAxis "cross-axis" true "Another axis, as it moves, tilts or shifts this one.",
    Step "step" false "Something has slipped, once.",
    Drift "drift" false "It wanders with time.",
    Outliers "outliers" false "Some readings are no readings.",
    ReferenceInstrument "reference-instrument" false "The reference instrument errs.",
}

/// One `[[term]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Term {
    /// What it changes.
    pub quantity: Quantity,
    /// Added as well, in µm: the reference of the measurement is arbitrary.
    pub constant_um: f64,
    /// How it changes it.
    pub effect: Effect,
}

/// What the correction of a cause does to the prediction p, with n in r/min, T in °C, P in mm.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// p + o.
    SensorOffset {
        /// o.
        offset_um: f64,
    },
    /// g·p.
    SensorGain {
        /// g.
        gain: f64,
    },
    /// p + c·p².
    SensorCurvature {
        /// c, in 1/µm.
        per_um: f64,
    },
    /// min(p, limit).
    SensorSaturation {
        /// The limit.
        limit_um: f64,
    },
    /// p + c·(T − T_ref).
    SensorTemperatureDrift {
        /// T.
        column: String,
        /// c.
        um_per_c: f64,
        /// T_ref.
        reference_c: f64,
    },
    /// p(t − shift), after all other terms; between rows linear, before the first its value.
    TimeShift {
        /// Positive: the measurement comes later than the prediction.
        shift_s: f64,
    },
    /// p from the lagged temperature: of the spindle, or of the quantity's own axis.
    ThermalLag {
        /// In place of the believed one.
        time_constant_s: f64,
    },
    /// p + a·(1 − e^(−(t − start)/τ)); 0 before the start.
    SlowMode {
        /// a.
        amplitude_um: f64,
        /// τ.
        time_constant_s: f64,
        /// The time of the start, in the run's `time_s`.
        start_s: f64,
    },
    /// p + c·(lag_τ(T) − T_ref), of a column that the model uses.
    SlowModeOf {
        /// T.
        column: String,
        /// c.
        um_per_c: f64,
        /// τ.
        time_constant_s: f64,
        /// T_ref.
        reference_c: f64,
    },
    /// p + c·(lag_τ(T) − T_ref), of a column that the model does not use.
    ExtraHeatPath {
        /// T.
        column: String,
        /// c.
        um_per_c: f64,
        /// τ; 0: no lag.
        time_constant_s: f64,
        /// T_ref.
        reference_c: f64,
    },
    /// s·p.
    GrowthAmplitude {
        /// s.
        scale: f64,
    },
    /// The warm-up with (t₂ − t₁)/k replaced: Smax·(1 − e^(−(t − t₁)/τ)) after t₁, without an end.
    GrowthRate {
        /// τ.
        time_constant_s: f64,
    },
    /// The lag or the warm-up with another time constant while it falls.
    CoolingAsymmetry {
        /// It.
        time_constant_s: f64,
    },
    /// The axis's expansion with this slope.
    ExpansionSlope {
        /// In place of the believed one.
        um_per_m_per_c: f64,
    },
    /// The axis's expansion from another temperature.
    ReferenceTemperature {
        /// Added to the believed one.
        shift_c: f64,
    },
    /// p + c·(n/1000)².
    CentrifugalGrowth {
        /// c.
        um_per_krpm2: f64,
    },
    /// p − c·load.
    CuttingLoad {
        /// c.
        um_per_n: f64,
    },
    /// p + c·P/1000.
    PitchScale {
        /// c.
        um_per_m: f64,
    },
    /// p + a table of the position, one for each direction.
    PitchError(Pitch),
    /// p + Σ aᵢ·sin(2π·hᵢ·P/L + φᵢ).
    PitchPeriodic {
        /// L.
        period_mm: f64,
        /// The waves.
        waves: Vec<Wave>,
    },
    /// p + w where the axis was approached in the negative direction.
    Backlash {
        /// w.
        width_um: f64,
    },
    /// p + c·P/1000 where the axis was approached in the negative direction.
    PositionDependentBacklash {
        /// c.
        um_per_m: f64,
    },
    /// p + a spline over another axis.
    Straightness {
        /// The axis that moves.
        along: LinearAxis,
        /// The spline.
        spline: BSpline,
    },
    /// p + c·P/1000, P of another axis.
    CrossAxis {
        /// The axis that moves.
        axis: LinearAxis,
        /// c.
        um_per_m: f64,
    },
    /// p + s from a time on.
    Step {
        /// The time, in the run's `time_s`.
        at_s: f64,
        /// s.
        size_um: f64,
    },
    /// p + c·t/3600.
    Drift {
        /// c.
        um_per_h: f64,
    },
    /// Rows that were set aside; p stays.
    Outliers {
        /// Their share of all rows.
        fraction: f64,
    },
    /// The reference instrument's own error, for the comparison with what it reads:
    /// p + Σ aᵢ·sin(2π·hᵢ·C/(P + P₀) + φᵢ), or p + Σ aᵢ·sin(2π·hᵢ·P/C + φᵢ) without P₀.
    ReferenceInstrument {
        /// For people.
        description: String,
        /// C: the period; with P₀ the phase's constant, as of an instrument that looks at an
        /// angle. Not used without waves.
        period_mm: f64,
        /// P₀.
        origin_mm: Option<f64>,
        /// The waves; may be empty.
        waves: Vec<Wave>,
    },
}

/// One wave of a periodic error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wave {
    /// h: how often in a period; at least 1.
    pub harmonic: u32,
    /// a.
    pub amplitude_um: f64,
    /// φ.
    pub phase_deg: f64,
}

impl Effect {
    /// The cause that it belongs to.
    #[must_use]
    pub fn cause(&self) -> Cause {
        match self {
            Self::SensorOffset { .. } => Cause::SensorOffset,
            Self::SensorGain { .. } => Cause::SensorGain,
            Self::SensorCurvature { .. } => Cause::SensorCurvature,
            Self::SensorSaturation { .. } => Cause::SensorSaturation,
            Self::SensorTemperatureDrift { .. } => Cause::SensorTemperatureDrift,
            Self::TimeShift { .. } => Cause::TimeShift,
            Self::ThermalLag { .. } => Cause::ThermalLag,
            Self::SlowMode { .. } | Self::SlowModeOf { .. } => Cause::SlowMode,
            Self::ExtraHeatPath { .. } => Cause::ExtraHeatPath,
            Self::GrowthAmplitude { .. } => Cause::GrowthAmplitude,
            Self::GrowthRate { .. } => Cause::GrowthRate,
            Self::CoolingAsymmetry { .. } => Cause::CoolingAsymmetry,
            Self::ExpansionSlope { .. } => Cause::ExpansionSlope,
            Self::ReferenceTemperature { .. } => Cause::ReferenceTemperature,
            Self::CentrifugalGrowth { .. } => Cause::CentrifugalGrowth,
            Self::CuttingLoad { .. } => Cause::CuttingLoad,
            Self::PitchScale { .. } => Cause::PitchScale,
            Self::PitchError(_) => Cause::PitchError,
            Self::PitchPeriodic { .. } => Cause::PitchPeriodic,
            Self::Backlash { .. } => Cause::Backlash,
            Self::PositionDependentBacklash { .. } => Cause::PositionDependentBacklash,
            Self::Straightness { .. } => Cause::Straightness,
            Self::CrossAxis { .. } => Cause::CrossAxis,
            Self::Step { .. } => Cause::Step,
            Self::Drift { .. } => Cause::Drift,
            Self::Outliers { .. } => Cause::Outliers,
            Self::ReferenceInstrument { .. } => Cause::ReferenceInstrument,
        }
    }
}

impl Effect {
    /// The temperature that it follows, if it names one.
    #[must_use]
    pub fn column(&self) -> Option<&String> {
        match self {
            Self::SensorTemperatureDrift { column, .. }
            | Self::SlowModeOf { column, .. }
            | Self::ExtraHeatPath { column, .. } => Some(column),
            _ => None,
        }
    }
}

/// Keys that every term may have.
const COMMON: [&str; 3] = ["cause", "quantity", "constant_um"];

pub(super) fn read(section: &Section<'_>) -> Result<Term, BadInput> {
    let causes = Cause::ALL.iter().map(|&cause| (cause.name(), cause)).collect::<Vec<_>>();
    let name = section.required("cause", section.text("cause")?)?;
    let cause = causes.iter().find(|(known, _)| *known == name).map(|&(_, cause)| cause);
    let cause = cause.ok_or_else(|| {
        let near = did_you_mean(name, causes.iter().map(|(known, _)| *known));
        section.bad("cause", format!("\"{}\" is not known{near}", shortened(name)))
    })?;
    section.allow_only(&[&COMMON[..], keys(cause, section)].concat())?;
    let quantities = Quantity::ALL.map(|quantity| (quantity.name(), quantity));
    let quantity = section.required("quantity", section.choice("quantity", &quantities)?)?;
    let constant_um = section.number("constant_um")?.unwrap_or(0.0);
    Ok(Term { quantity, constant_um, effect: read_effect(section, cause)? })
}

/// The keys of a cause, besides those that all have.
fn keys(cause: Cause, section: &Section<'_>) -> &'static [&'static str] {
    match cause {
        Cause::SensorOffset => &["offset_um"],
        Cause::SensorGain => &["gain"],
        Cause::SensorCurvature => &["per_um"],
        Cause::SensorSaturation => &["limit_um"],
        Cause::SensorTemperatureDrift => &["column", "um_per_c", "reference_c"],
        Cause::TimeShift => &["shift_s"],
        Cause::ThermalLag | Cause::GrowthRate | Cause::CoolingAsymmetry => &["time_constant_s"],
        Cause::SlowMode if !section.keys().contains(&"column") => {
            &["amplitude_um", "time_constant_s", "start_s"]
        }
        Cause::SlowMode | Cause::ExtraHeatPath => {
            &["column", "um_per_c", "time_constant_s", "reference_c"]
        }
        Cause::GrowthAmplitude => &["scale"],
        Cause::ExpansionSlope => &["um_per_m_per_c"],
        Cause::ReferenceTemperature => &["shift_c"],
        Cause::CentrifugalGrowth => &["um_per_krpm2"],
        Cause::CuttingLoad => &["um_per_n"],
        Cause::PitchScale | Cause::PositionDependentBacklash => &["um_per_m"],
        Cause::PitchError => &["start_mm", "step_mm", "forward_um", "reverse_um"],
        Cause::PitchPeriodic => &["period_mm", "harmonic", "amplitude_um", "phase_deg"],
        Cause::Backlash => &["width_um"],
        Cause::Straightness => &["along", "order", "knots_mm", "control_um"],
        Cause::CrossAxis => &["um_per_m", "axis"],
        Cause::Step => &["at_s", "size_um"],
        Cause::Drift => &["um_per_h"],
        Cause::Outliers => &["fraction"],
        Cause::ReferenceInstrument => {
            &["description", "period_mm", "origin_mm", "harmonic", "amplitude_um", "phase_deg"]
        }
    }
}

fn read_effect(section: &Section<'_>, cause: Cause) -> Result<Effect, BadInput> {
    let number = |key| section.required(key, section.number(key)?);
    let time_constant =
        || section.required("time_constant_s", section.positive("time_constant_s")?);
    let column = || section.required("column", read_temperature_column(section, "column")?);
    let axes = LinearAxis::ALL.map(|axis| (axis.name(), axis));
    Ok(match cause {
        Cause::SensorOffset => Effect::SensorOffset { offset_um: number("offset_um")? },
        Cause::SensorGain => Effect::SensorGain { gain: number("gain")? },
        Cause::SensorCurvature => Effect::SensorCurvature { per_um: number("per_um")? },
        Cause::SensorSaturation => Effect::SensorSaturation { limit_um: number("limit_um")? },
        Cause::SensorTemperatureDrift => Effect::SensorTemperatureDrift {
            column: column()?,
            um_per_c: number("um_per_c")?,
            reference_c: number("reference_c")?,
        },
        Cause::TimeShift => Effect::TimeShift { shift_s: number("shift_s")? },
        Cause::ThermalLag => Effect::ThermalLag { time_constant_s: time_constant()? },
        Cause::SlowMode if section.text("column")?.is_none() => Effect::SlowMode {
            amplitude_um: number("amplitude_um")?,
            time_constant_s: time_constant()?,
            start_s: section.number("start_s")?.unwrap_or(0.0),
        },
        Cause::SlowMode => Effect::SlowModeOf {
            column: column()?,
            um_per_c: number("um_per_c")?,
            time_constant_s: time_constant()?,
            reference_c: number("reference_c")?,
        },
        Cause::ExtraHeatPath => Effect::ExtraHeatPath {
            column: column()?,
            um_per_c: number("um_per_c")?,
            time_constant_s: section.not_negative("time_constant_s")?.unwrap_or(0.0),
            reference_c: number("reference_c")?,
        },
        Cause::GrowthAmplitude => Effect::GrowthAmplitude { scale: number("scale")? },
        Cause::GrowthRate => Effect::GrowthRate { time_constant_s: time_constant()? },
        Cause::CoolingAsymmetry => Effect::CoolingAsymmetry { time_constant_s: time_constant()? },
        Cause::ExpansionSlope => {
            Effect::ExpansionSlope { um_per_m_per_c: number("um_per_m_per_c")? }
        }
        Cause::ReferenceTemperature => Effect::ReferenceTemperature { shift_c: number("shift_c")? },
        Cause::CentrifugalGrowth => {
            Effect::CentrifugalGrowth { um_per_krpm2: number("um_per_krpm2")? }
        }
        Cause::CuttingLoad => Effect::CuttingLoad { um_per_n: number("um_per_n")? },
        Cause::PitchScale => Effect::PitchScale { um_per_m: number("um_per_m")? },
        // The table's keys are those of [axis.x.pitch], beside the common ones.
        Cause::PitchError => Effect::PitchError(read_pitch(section)?),
        Cause::PitchPeriodic => Effect::PitchPeriodic {
            period_mm: section.required("period_mm", section.positive("period_mm")?)?,
            waves: section.required("amplitude_um", read_waves(section)?)?,
        },
        Cause::Backlash => Effect::Backlash { width_um: number("width_um")? },
        Cause::PositionDependentBacklash => {
            Effect::PositionDependentBacklash { um_per_m: number("um_per_m")? }
        }
        Cause::Straightness => Effect::Straightness {
            along: section.required("along", section.choice("along", &axes)?)?,
            spline: read_spline(section)?,
        },
        Cause::CrossAxis => Effect::CrossAxis {
            axis: section.required("axis", section.choice("axis", &axes)?)?,
            um_per_m: number("um_per_m")?,
        },
        Cause::Step => Effect::Step { at_s: number("at_s")?, size_um: number("size_um")? },
        Cause::Drift => Effect::Drift { um_per_h: number("um_per_h")? },
        Cause::Outliers => Effect::Outliers {
            fraction: section.required("fraction", section.not_negative("fraction")?)?,
        },
        Cause::ReferenceInstrument => {
            let waves = read_waves(section)?.unwrap_or_default();
            let period_mm = section.positive("period_mm")?;
            Effect::ReferenceInstrument {
                description: section.text("description")?.unwrap_or_default().to_string(),
                period_mm: if waves.is_empty() {
                    period_mm.unwrap_or(1.0)
                } else {
                    section.required("period_mm", period_mm)?
                },
                origin_mm: section.number("origin_mm")?,
                waves,
            }
        }
    })
}

/// `harmonic`, `amplitude_um` and `phase_deg`: three numbers of one wave, or three arrays.
fn read_waves(section: &Section<'_>) -> Result<Option<Vec<Wave>>, BadInput> {
    let Some(amplitudes) = section.number_or_numbers("amplitude_um")? else { return Ok(None) };
    let alike = |key, or: fn(usize) -> f64| {
        let values = section.number_or_numbers(key)?;
        let values = values.unwrap_or_else(|| (0..amplitudes.len()).map(or).collect());
        if values.len() == amplitudes.len() {
            return Ok(values);
        }
        let rule = format!(
            "has {} elements, but amplitude_um has {}: one of each for a wave",
            values.len(),
            amplitudes.len()
        );
        Err(section.bad(key, rule))
    };
    let harmonics = alike("harmonic", |index| (index + 1) as f64)?;
    let phases = alike("phase_deg", |_| 0.0)?;
    let mut waves = Vec::new();
    for ((&harmonic, &amplitude_um), &phase_deg) in harmonics.iter().zip(&amplitudes).zip(&phases) {
        if harmonic.fract() != 0.0 || !(1.0..=1000.0).contains(&harmonic) {
            let rule = format!("must be whole numbers from 1 to 1000, not {harmonic}");
            return Err(section.bad("harmonic", rule));
        }
        // Held to 1000 above.
        waves.push(Wave { harmonic: harmonic as u32, amplitude_um, phase_deg });
    }
    Ok(Some(waves))
}

/// Whether the term belongs to this machine: a lag needs a temperature that the quantity depends
/// on, a sensor's error a sensor.
pub(super) fn check(section: &Section<'_>, term: &Term, machine: &Machine) -> Result<(), BadInput> {
    let spindle = &machine.spindle;
    let thermal = term.quantity.axis().and_then(|axis| machine.axes[axis.index()].thermal.as_ref());
    let refuse = |rule: String| Err(section.bad("cause", rule));
    let cause = term.effect.cause();
    let name = cause.name();
    let of_axis = term.quantity.axis();
    let own_temperature = match of_axis {
        None => spindle.source == Some(Source::Temperature),
        Some(_) => thermal.is_some(),
    };
    match (&term.effect, of_axis) {
        (Effect::ThermalLag { .. }, _) if !own_temperature => refuse(format!(
            "\"{name}\" needs a temperature on which {} depends: [spindle] source = \
             \"temperature\", or [axis.*.thermal]",
            term.quantity.name()
        )),
        (Effect::CoolingAsymmetry { .. }, axis)
            if !(own_temperature || axis.is_none() && spindle.source == Some(Source::Warmup)) =>
        {
            refuse(format!("\"{name}\" needs a lag or a warm-up to change"))
        }
        (Effect::GrowthRate { .. }, axis)
            if axis.is_some() || spindle.source != Some(Source::Warmup) =>
        {
            refuse(format!("\"{name}\" needs [spindle] source = \"warmup\""))
        }
        (Effect::ExpansionSlope { .. } | Effect::ReferenceTemperature { .. }, _)
            if thermal.is_none() =>
        {
            refuse(format!("\"{name}\" needs [axis.*.thermal] of the quantity's axis"))
        }
        // Another reference moves a table along the temperature; another slope has no place in it.
        (Effect::ExpansionSlope { .. }, _) if thermal.is_some_and(|it| it.table.is_some()) => {
            refuse(format!("\"{name}\" corrects a constant, and there is a table"))
        }
        (
            Effect::PitchScale { .. }
            | Effect::PitchError(_)
            | Effect::PitchPeriodic { .. }
            | Effect::Backlash { .. }
            | Effect::PositionDependentBacklash { .. }
            | Effect::Straightness { .. }
            | Effect::CrossAxis { .. },
            None,
        ) => refuse(format!("\"{name}\" belongs to dx, dy or dz")),
        (
            Effect::SensorOffset { .. }
            | Effect::SensorGain { .. }
            | Effect::SensorCurvature { .. }
            | Effect::SensorSaturation { .. }
            | Effect::SensorTemperatureDrift { .. }
            | Effect::GrowthAmplitude { .. }
            | Effect::CentrifugalGrowth { .. }
            | Effect::CuttingLoad { .. },
            Some(_),
        ) => refuse(format!("\"{name}\" belongs to the elongation")),
        (Effect::Straightness { along, .. } | Effect::CrossAxis { axis: along, .. }, Some(own))
            if *along == own =>
        {
            refuse(format!("\"{name}\" is the error of another axis than the one that moves"))
        }
        _ => Ok(()),
    }
}

impl Term {
    /// The term as a table to be written; it reads back to the same numbers.
    ///
    /// ```
    /// use trueup_machine::file::{Effect, Quantity, Term, write::Edit};
    /// let term = Term {
    ///     quantity: Quantity::Elongation,
    ///     constant_um: 0.0,
    ///     effect: Effect::SensorGain { gain: 1.2975 },
    /// };
    /// let edit = Edit { appended: vec![term.section()], ..Edit::default() };
    /// let text = "[[term]]\ncause = \"sensor-gain\"\nquantity = \"elongation\"\ngain = 1.2975\n";
    /// assert_eq!(edit.to_toml(), text);
    /// ```
    #[must_use]
    pub fn section(&self) -> NewSection {
        let section = NewSection::new("term")
            .text("cause", self.effect.cause().name())
            .text("quantity", self.quantity.name());
        let section = write_effect(section, &self.effect);
        match self.constant_um {
            0.0 => section,
            constant_um => section.number("constant_um", constant_um),
        }
    }
}

fn write_effect(section: NewSection, effect: &Effect) -> NewSection {
    match effect {
        Effect::SensorOffset { offset_um } => section.number("offset_um", *offset_um),
        Effect::SensorGain { gain } => section.number("gain", *gain),
        Effect::SensorCurvature { per_um } => section.number("per_um", *per_um),
        Effect::SensorSaturation { limit_um } => section.number("limit_um", *limit_um),
        Effect::SensorTemperatureDrift { column, um_per_c, reference_c } => section
            .text("column", column)
            .number("um_per_c", *um_per_c)
            .number("reference_c", *reference_c),
        Effect::TimeShift { shift_s } => section.number("shift_s", *shift_s),
        Effect::ThermalLag { time_constant_s }
        | Effect::GrowthRate { time_constant_s }
        | Effect::CoolingAsymmetry { time_constant_s } => {
            section.number("time_constant_s", *time_constant_s)
        }
        Effect::SlowMode { amplitude_um, time_constant_s, start_s } => section
            .number("amplitude_um", *amplitude_um)
            .number("time_constant_s", *time_constant_s)
            .number("start_s", *start_s),
        Effect::SlowModeOf { column, um_per_c, time_constant_s, reference_c }
        | Effect::ExtraHeatPath { column, um_per_c, time_constant_s, reference_c } => section
            .text("column", column)
            .number("um_per_c", *um_per_c)
            .number("time_constant_s", *time_constant_s)
            .number("reference_c", *reference_c),
        Effect::GrowthAmplitude { scale } => section.number("scale", *scale),
        Effect::ExpansionSlope { um_per_m_per_c } => {
            section.number("um_per_m_per_c", *um_per_m_per_c)
        }
        Effect::ReferenceTemperature { shift_c } => section.number("shift_c", *shift_c),
        Effect::CentrifugalGrowth { um_per_krpm2 } => section.number("um_per_krpm2", *um_per_krpm2),
        Effect::CuttingLoad { um_per_n } => section.number("um_per_n", *um_per_n),
        Effect::PitchScale { um_per_m } | Effect::PositionDependentBacklash { um_per_m } => {
            section.number("um_per_m", *um_per_m)
        }
        Effect::PitchError(pitch) => write_pitch(section, pitch),
        Effect::PitchPeriodic { period_mm, waves } => {
            write_waves(section.number("period_mm", *period_mm), waves)
        }
        Effect::Backlash { width_um } => section.number("width_um", *width_um),
        Effect::Straightness { along, spline } => {
            write_spline(section.text("along", along.name()), spline)
        }
        Effect::CrossAxis { axis, um_per_m } => {
            section.text("axis", axis.name()).number("um_per_m", *um_per_m)
        }
        Effect::Step { at_s, size_um } => section.number("at_s", *at_s).number("size_um", *size_um),
        Effect::Drift { um_per_h } => section.number("um_per_h", *um_per_h),
        Effect::Outliers { fraction } => section.number("fraction", *fraction),
        Effect::ReferenceInstrument { description, period_mm, origin_mm, waves } => {
            let section = section.text("description", description);
            if waves.is_empty() {
                return section;
            }
            let section = section.number("period_mm", *period_mm);
            let section = match origin_mm {
                Some(origin_mm) => section.number("origin_mm", *origin_mm),
                None => section,
            };
            write_waves(section, waves)
        }
    }
}

fn write_waves(section: NewSection, waves: &[Wave]) -> NewSection {
    let list = |of: fn(&Wave) -> f64| waves.iter().map(of).collect::<Vec<_>>();
    section
        .with("harmonic", Value::Wholes(waves.iter().map(|wave| wave.harmonic).collect()))
        .numbers("amplitude_um", list(|wave| wave.amplitude_um))
        .numbers("phase_deg", list(|wave| wave.phase_deg))
}
