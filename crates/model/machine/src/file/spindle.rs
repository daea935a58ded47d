//! `[spindle]`: how the spindle grows, by up to three models, of which one is in use.
//!
//! A model that is not the source is kept: it is what the board falls back to.

use super::{
    inputs::read_temperature_column,
    read::Section,
    tools::{self, Tools},
    write::section::NewSection,
};
use crate::{inputs::SensorInput, location::BadInput};

/// How the spindle grows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Spindle {
    /// The model in use, which is always there below; `None`: no elongation.
    pub source: Option<ElongationSource>,
    /// The displacement sensor.
    pub sensor: Option<SensorModel>,
    /// The growth over the time that the spindle has run.
    pub warmup: Option<Warmup>,
    /// The growth over a temperature.
    pub temperature: Option<TemperatureModel>,
    /// How each tool grows with speed.
    pub tools: Option<Tools>,
}

/// Where the elongation comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ElongationSource {
    /// The displacement sensor, in counts.
    Sensor,
    /// The warm-up model, over the time in s that the spindle has run.
    Warmup,
    /// A temperature in °C, behind a first-order lag.
    Temperature,
}

impl ElongationSource {
    /// Its name in the machine file, which is also that of its section under `[spindle]`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Sensor => "sensor",
            Self::Warmup => "warmup",
            Self::Temperature => "temperature",
        }
    }
}

/// The displacement sensor's law: ΔK = K₀ + (V − V₀)·tanβ.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorModel {
    /// K₀: the elongation at the zero reading, in µm.
    pub k0_um: f64,
    /// V₀: the counts with the machine cold.
    pub zero_counts: f64,
    /// tanβ in µm for one count, not 0; negative where growth lowers the reading.
    pub um_per_count: f64,
    /// The run-file column of the sensor's own temperature, `temp_<name>_c`.
    pub temperature: Option<String>,
}

/// The warm-up model of a spindle without a sensor, identified from one run from cold.
#[derive(Clone, Debug, PartialEq)]
pub struct Warmup {
    /// t₁: so long after the start no heat has reached the spindle, in s; at least 0.
    pub lag_s: f64,
    /// t₂: the spindle is warm, in s after the start; above `lag_s`.
    pub warm_s: f64,
    /// Smax: the growth of the warm spindle, in µm.
    pub max_um: f64,
    /// k: the larger, the faster it rises at first; above 0.
    pub exponent: f64,
    /// The time constant with which it cools, in s, above 0; `None`: the one of heating,
    /// [`Self::time_constant_s`].
    pub cool_s: Option<f64>,
    /// The speed at which `max_um` was recorded, in r/min, above 0; always there if
    /// `speed_exponent` is not 0.
    pub rated_rpm: Option<f64>,
    /// p: the heat goes with (n/n_rated)^p; at 0 any speed heats fully. At least 0.
    pub speed_exponent: f64,
}

impl Warmup {
    /// Returns the time constant with which the spindle heats up, (t₂ − t₁)/k, in s.
    #[must_use]
    pub fn time_constant_s(&self) -> f64 {
        (self.warm_s - self.lag_s) / self.exponent
    }

    /// Returns the time constant with which the spindle cools, in s.
    #[must_use]
    pub fn cooling_time_constant_s(&self) -> f64 {
        self.cool_s.unwrap_or_else(|| self.time_constant_s())
    }
}

/// The growth over a temperature: k·(T − T₀), T behind its sensor by a lag.
#[derive(Clone, Debug, PartialEq)]
pub struct TemperatureModel {
    /// The run-file column of T, `temp_<name>_c`.
    pub sensor: String,
    /// T₀: the temperature at which the growth is 0, in °C.
    pub reference_c: f64,
    /// k in µm for one °C.
    pub k_um_per_c: f64,
    /// The time constant of the first-order lag, in s; 0: none.
    pub lag_s: f64,
}

/// Returns the section; `input` is what `[inputs]` says of the displacement sensor.
pub(super) fn read(section: &Section<'_>, input: Option<SensorInput>) -> Result<Spindle, BadInput> {
    let sources =
        [ElongationSource::Sensor, ElongationSource::Warmup, ElongationSource::Temperature]
            .map(|source| (source.name(), source));
    let spindle = Spindle {
        source: section.choice("source", &sources)?,
        sensor: section.section("sensor")?.map(|model| read_sensor(&model, input)).transpose()?,
        warmup: section.section("warmup")?.map(|model| read_warmup(&model)).transpose()?,
        temperature: section
            .section("temperature")?
            .map(|model| read_temperature(&model))
            .transpose()?,
        tools: section.section("tools")?.map(|list| tools::read(&list)).transpose()?,
    };
    let missing = spindle.source.filter(|source| match source {
        ElongationSource::Sensor => spindle.sensor.is_none(),
        ElongationSource::Warmup => spindle.warmup.is_none(),
        ElongationSource::Temperature => spindle.temperature.is_none(),
    });
    if let Some(name) = missing.map(ElongationSource::name) {
        let rule = format!("is \"{name}\", but [spindle.{name}] is missing");
        return Err(section.bad("source", rule));
    }
    Ok(spindle)
}

fn read_sensor(section: &Section<'_>, input: Option<SensorInput>) -> Result<SensorModel, BadInput> {
    let k0_um = section.required("k0_um", section.number("k0_um")?)?;
    let counts_per_v = input.map(|input| input.counts_full_scale / input.volts_full_scale);
    let either =
        |counts: &str, volts: &str, in_counts: fn(f64, f64) -> f64| match (
            section.number(counts)?,
            section.number(volts)?,
        ) {
            (Some(_), Some(_)) => {
                Err(section.bad(volts, format!("stands beside {counts}: write one of the two")))
            }
            (None, Some(value)) => match counts_per_v {
                Some(counts_per_v) => Ok((in_counts(value, counts_per_v), volts.to_string())),
                None => Err(section
                    .bad(volts, "needs [inputs] sensor, which says how many counts a volt is")),
            },
            (value, None) => Ok((section.required(counts, value)?, counts.to_string())),
        };
    let (zero_counts, _) =
        either("zero_counts", "zero_v", |v, counts_per_v| rounded(v * counts_per_v))?;
    let (um_per_count, key) = either("um_per_count", "um_per_v", |um_per_v, counts_per_v| {
        rounded(um_per_v / counts_per_v)
    })?;
    if um_per_count == 0.0 {
        return Err(section.bad(&key, "must not be 0"));
    }
    let temperature = read_temperature_column(section, "temperature")?;
    Ok(SensorModel { k0_um, zero_counts, um_per_count, temperature })
}

fn read_warmup(section: &Section<'_>) -> Result<Warmup, BadInput> {
    let warmup = Warmup {
        lag_s: section.required("lag_s", section.not_negative("lag_s")?)?,
        warm_s: section.required("warm_s", section.positive("warm_s")?)?,
        max_um: section.required("max_um", section.number("max_um")?)?,
        exponent: section.required("exponent", section.positive("exponent")?)?,
        cool_s: section.positive("cool_s")?,
        rated_rpm: section.positive("rated_rpm")?,
        speed_exponent: section.not_negative("speed_exponent")?.unwrap_or(0.0),
    };
    if warmup.warm_s <= warmup.lag_s {
        let rule = format!(
            "must be above lag_s = {}, not {}: the spindle warms up in between",
            warmup.lag_s, warmup.warm_s
        );
        return Err(section.bad("warm_s", rule));
    }
    if warmup.speed_exponent != 0.0 && warmup.rated_rpm.is_none() {
        let rule = "needs rated_rpm: the heat goes with (n/rated_rpm)^speed_exponent";
        return Err(section.bad("speed_exponent", rule));
    }
    Ok(warmup)
}

fn read_temperature(section: &Section<'_>) -> Result<TemperatureModel, BadInput> {
    let number = |key| section.required(key, section.number(key)?);
    Ok(TemperatureModel {
        sensor: section.required("sensor", read_temperature_column(section, "sensor")?)?,
        reference_c: number("reference_c")?,
        k_um_per_c: number("k_um_per_c")?,
        lag_s: section.not_negative("lag_s")?.unwrap_or(0.0),
    })
}

pub(super) fn write(spindle: &Spindle) -> Vec<NewSection> {
    let mut sections = Vec::new();
    if let Some(source) = spindle.source {
        sections.push(NewSection::new("spindle").text("source", source.name()));
    }
    sections.extend(spindle.sensor.as_ref().map(write_sensor));
    sections.extend(spindle.temperature.as_ref().map(write_temperature));
    sections.extend(spindle.warmup.as_ref().map(write_warmup));
    sections.extend(spindle.tools.as_ref().map(tools::write));
    sections
}

fn write_sensor(model: &SensorModel) -> NewSection {
    let section = NewSection::new("spindle.sensor")
        .number("k0_um", model.k0_um)
        .number("zero_counts", model.zero_counts)
        .number("um_per_count", model.um_per_count);
    match &model.temperature {
        Some(column) => section.text("temperature", column),
        None => section,
    }
}

fn write_warmup(model: &Warmup) -> NewSection {
    let mut section = NewSection::new("spindle.warmup")
        .number("lag_s", model.lag_s)
        .number("warm_s", model.warm_s)
        .number("max_um", model.max_um)
        .number("exponent", model.exponent);
    if let Some(cool_s) = model.cool_s {
        section = section.number("cool_s", cool_s);
    }
    if let Some(rated_rpm) = model.rated_rpm {
        section =
            section.number("rated_rpm", rated_rpm).number("speed_exponent", model.speed_exponent);
    }
    section
}

fn write_temperature(model: &TemperatureModel) -> NewSection {
    NewSection::new("spindle.temperature")
        .text("sensor", &model.sensor)
        .number("reference_c", model.reference_c)
        .number("k_um_per_c", model.k_um_per_c)
        .number("lag_s", model.lag_s)
}
/// Returns a converted number without the rounding of `f64` in its last digits: 2.1 V of 3276.8 counts are 6881.28.
fn rounded(value: f64) -> f64 {
    format!("{value:.13e}").parse().unwrap_or(value)
}
