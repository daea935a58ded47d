//! `[spindle]`: how the spindle grows, by up to three models, of which one is in use.
//!
//! A model that is not the source is kept: it is what the board falls back to.

use super::{ToolGrowthList, tools};
use crate::{
    inputs::SensorInput,
    keys::{
        key::{Key, ValueType, key, section},
        plausible_range::range,
        reader::Section,
        section::NewSection,
        table::{KeyValue, Table, add_key, choice, read_or_default, table},
    },
    location::InputFileError,
};

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
    pub tools: Option<ToolGrowthList>,
}

pub(crate) const SPINDLE_KEYS: &[Key] =
    &[SOURCE_KEY, SENSOR_KEY, WARMUP_KEY, TEMPERATURE_KEY, TOOLS_KEY];

const SOURCE_KEY: Key = key("source", ValueType::Choice(ElongationSource::NAMES), "", "the model of the growth in use; the others that are there are what the board falls back to. Without it nothing grows")
    .with_example_value("\"sensor\"");
const SENSOR_KEY: Key = section(
    ElongationSource::Sensor.name(),
    SensorKeys::KEYS,
    "growth by a displacement sensor: `k0_um` + (reading − zero) · slope",
)
.with_range(range(
    [-1e10, 1e10],
    [-1e9, 1e9],
    [-1e5, 1e5],
    "`check` holds it against [inputs] sensor",
));
const WARMUP_KEY: Key = section(
    ElongationSource::Warmup.name(),
    Warmup::KEYS,
    "growth over the time that the spindle has run",
);
const TEMPERATURE_KEY: Key = section(
    ElongationSource::Temperature.name(),
    TemperatureModel::KEYS,
    "growth by a temperature: `k_um_per_c` · (T − `reference_c`)",
);
const TOOLS_KEY: Key = section(
    "tools",
    tools::TOOL_LIST_KEYS,
    "growth with speed by tool, added to the model in use: `um_per_krpm2` · (n/1000)²",
);

choice! {
    /// Where the elongation comes from. Its name is also that of its section under `[spindle]`.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum ElongationSource {
        /// The displacement sensor, in counts.
        Sensor = "sensor",
        /// The warm-up model, over the time in s that the spindle has run.
        Warmup = "warmup",
        /// A temperature in °C, behind a first-order lag.
        Temperature = "temperature",
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

table! {
    /// The sensor's law as it is written: in counts, or in volts.
    struct SensorKeys {
        k0_um: f64 = key(Number, "µm", "the growth at the zero reading").required().with_example_value("0.0").with_range(range([-1e5, 1e5], [-5000.0, 5000.0], [-500.0, 500.0], "the range of a displacement sensor"));
        zero_counts: Option<f64> = key(Number, "counts", "the reading when the machine is cold; or `zero_v`").with_example_value("5048.0");
        um_per_count: Option<f64> = key(Number, "µm", "growth for one count, not 0; or `um_per_v`").with_example_value("0.0152587890625");
        zero_v: Option<f64> = key(Number, "V", "the reading when the machine is cold, as a voltmeter shows it, in the place of `zero_counts`; needs `[inputs] sensor`").with_example_value("1.54");
        um_per_v: Option<f64> = key(Number, "µm/V", "growth for one volt, from the sensor's data sheet, instead of `um_per_count`; needs `[inputs] sensor`").with_example_value("50.0");
        temperature: Option<String> = key(Column, "", "the column with the sensor's own temperature").with_example_value("\"temp_coil_c\"");
    }
}

table! {
    /// The warm-up model of a spindle without a sensor, identified from one run from cold.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Warmup {
        /// t₁.
        lag_s: f64 = key(NotNegative, "s", "from the start of the spindle until growth begins").required().with_example_value("60.0").with_range(range([0.0, 1e5], [0.0, 7200.0], [0.0, 600.0], TIME_CONSTANT_SOURCE).with_hint_above(MILLISECONDS_HINT));
        /// t₂.
        warm_s: f64 = key(Positive, "s", "from the start until it ends; above `lag_s`").required().with_example_value("5400.0").with_range(range([0.0, 5e5], [120.0, 1e5], [1200.0, 2e4], TIME_CONSTANT_SOURCE).with_hint_below(MINUTES_HINT).with_hint_above(MILLISECONDS_HINT));
        /// Smax.
        max_um: f64 = key(Number, "µm", "the growth in the end").required().with_example_value("80.0").with_range(range([-2000.0, 2000.0], [0.0, 500.0], [5.0, 200.0], GROWTH_SOURCE).with_hint_below(SPINDLE_SIGN_HINT).with_hint_above(NANOMETRES_HINT));
        /// k.
        exponent: f64 = key(Positive, "", "how fast it rises; larger is faster at first").required().with_example_value("4.0").with_range(range([0.0, 1e3], [0.01, 50.0], [0.5, 8.0], LAW_FORM_SOURCE));
        /// `None`: the time constant of heating, [`Self::time_constant_s`].
        cool_s: Option<f64> = key(Positive, "s", "time constant while the spindle stands; without it (`warm_s` − `lag_s`)/`exponent`").with_example_value("1335.0").with_range(range([0.0, 5e5], [10.0, 1e5], [300.0, 2e4], TIME_CONSTANT_SOURCE).with_hint_below(MINUTES_HINT).with_hint_above(MILLISECONDS_HINT));
        /// Always there if `speed_exponent` is not 0.
        rated_rpm: Option<f64> = key(Positive, "r/min", "the speed at which `max_um` was recorded").with_example_value("24000.0").with_range(range([0.0, 1e6], [100.0, 2e5], [3000.0, 6e4], "data sheets of spindles").with_hint_below("probably in 1000 r/min or r/s instead of r/min"));
        /// p: the heat is proportional to (n/n_rated)^p.
        speed_exponent: f64 = key(NotNegative, "", "growth is proportional to (n/`rated_rpm`) to this power; 0: any speed heats fully").with_default("0.0").with_range(range([0.0, 20.0], [0.0, 4.0], [0.0, 2.0], LAW_FORM_SOURCE));
    }
    checked by check_warmup_consistency
}

impl Warmup {
    /// Returns the time constant with which the spindle heats up, (t₂ − t₁)/k, in s.
    #[must_use]
    pub fn time_constant_s(&self) -> f64 {
        (self.warm_s - self.lag_s) / self.exponent
    }

    /// Returns the time constant with which the spindle cools, in s.
    #[must_use]
    pub(crate) fn cooling_time_constant_s(&self) -> f64 {
        self.cool_s.unwrap_or_else(|| self.time_constant_s())
    }
}

table! {
    /// The growth over a temperature: k·(T − T₀), T behind its sensor by a lag.
    #[derive(Clone, Debug, PartialEq)]
    pub struct TemperatureModel {
        /// The run-file column of T, `temp_<name>_c`.
        sensor: String = key(Column, "", "the column of the temperature").required().with_example_value("\"temp_front_c\"");
        /// T₀.
        reference_c: f64 = key(Number, "°C", "the temperature at which nothing has grown").required().with_example_value("20.0");
        /// k.
        k_um_per_c: f64 = key(Number, "µm/K", "growth for one kelvin").required().with_example_value("2.0").with_range(range([-200.0, 200.0], [0.0, 30.0], [0.1, 15.0], GROWTH_SOURCE).with_hint_below(SPINDLE_SIGN_HINT).with_hint_above(NANOMETRES_HINT));
        /// 0: no lag.
        lag_s: f64 = key(NotNegative, "s", "time constant by which growth follows the temperature").with_default("0.0").with_range(range([0.0, 5e5], [0.0, 1e5], [0.0, 2e4], TIME_CONSTANT_SOURCE).with_hint_above(MILLISECONDS_HINT));
    }
}

/// Returns the section; `input` is what `[inputs]` says of the displacement sensor.
pub(crate) fn read(
    section: &Section<'_>,
    input: Option<SensorInput>,
) -> Result<Spindle, InputFileError> {
    let spindle = Spindle {
        source: ElongationSource::read_value(section, &SOURCE_KEY)?,
        sensor: section
            .section(SENSOR_KEY.name)?
            .map(|model| read_sensor_model(&model, input))
            .transpose()?,
        warmup: read_or_default(section, &WARMUP_KEY)?,
        temperature: read_or_default(section, &TEMPERATURE_KEY)?,
        tools: section.section(TOOLS_KEY.name)?.map(|list| tools::read(&list)).transpose()?,
    };
    let missing = spindle.source.filter(|source| match source {
        ElongationSource::Sensor => spindle.sensor.is_none(),
        ElongationSource::Warmup => spindle.warmup.is_none(),
        ElongationSource::Temperature => spindle.temperature.is_none(),
    });
    if let Some(name) = missing.map(ElongationSource::name) {
        let rule = format!("is \"{name}\", but [spindle.{name}] is missing");
        return Err(section.key_error(SOURCE_KEY.name, rule));
    }
    Ok(spindle)
}

fn read_sensor_model(
    section: &Section<'_>,
    input: Option<SensorInput>,
) -> Result<SensorModel, InputFileError> {
    let keys = SensorKeys::read(section)?;
    let counts_per_v = input.map(|input| input.counts_full_scale / input.volts_full_scale);
    let either = |(counts, in_counts): (&str, Option<f64>),
                  (volts, in_volts): (&str, Option<f64>),
                  convert: fn(f64, f64) -> f64| match (in_counts, in_volts) {
        (Some(_), Some(_)) => Err(section
            .key_error(volts, format!("cannot be combined with {counts}: write one of the two"))),
        (None, Some(value)) => {
            match counts_per_v {
                Some(counts_per_v) => Ok(round_to_significant_digits(convert(value, counts_per_v))),
                None => Err(section
                    .key_error(volts, "needs [inputs] sensor, which states the counts per volt")),
            }
        }
        (value, None) => section.required(counts, value),
    };
    let zero = ("zero_counts", keys.zero_counts);
    let zero_counts = either(zero, ("zero_v", keys.zero_v), |v, counts_per_v| v * counts_per_v)?;
    let slope = ("um_per_count", keys.um_per_count);
    let um_per_count = either(slope, ("um_per_v", keys.um_per_v), |um_per_v, counts_per_v| {
        um_per_v / counts_per_v
    })?;
    if um_per_count == 0.0 {
        let key = if keys.um_per_v.is_some() { "um_per_v" } else { "um_per_count" };
        return Err(section.key_error(key, "must not be 0"));
    }
    Ok(SensorModel { k0_um: keys.k0_um, zero_counts, um_per_count, temperature: keys.temperature })
}

fn check_warmup_consistency(
    section: &Section<'_>,
    warmup: Warmup,
) -> Result<Warmup, InputFileError> {
    if warmup.warm_s <= warmup.lag_s {
        let rule = format!(
            "must be above lag_s = {}, not {}: the spindle warms up in between",
            warmup.lag_s, warmup.warm_s
        );
        return Err(section.key_error("warm_s", rule));
    }
    if warmup.speed_exponent != 0.0 && warmup.rated_rpm.is_none() {
        let rule = "needs rated_rpm: the heat is proportional to (n/rated_rpm)^speed_exponent";
        return Err(section.key_error("speed_exponent", rule));
    }
    Ok(warmup)
}

pub(crate) fn write(spindle: &Spindle) -> Vec<NewSection> {
    let inner = |key: Key| NewSection::new(format!("spindle.{}", key.name));
    let mut sections = Vec::new();
    if let Some(source) = spindle.source {
        sections.push(add_key(NewSection::new("spindle"), &SOURCE_KEY, &source));
    }
    sections.extend(spindle.sensor.clone().map(|sensor| {
        let SensorModel { k0_um, zero_counts, um_per_count, temperature } = sensor;
        let (zero_counts, um_per_count) = (Some(zero_counts), Some(um_per_count));
        let (zero_v, um_per_v) = (None, None);
        SensorKeys { k0_um, zero_counts, um_per_count, zero_v, um_per_v, temperature }
            .write(inner(SENSOR_KEY))
    }));
    sections.extend(
        spindle.temperature.as_ref().map(|temperature| temperature.write(inner(TEMPERATURE_KEY))),
    );
    sections.extend(spindle.warmup.as_ref().map(|warmup| {
        let section = warmup.write(inner(WARMUP_KEY));
        if warmup.rated_rpm.is_some() { section } else { section.without_keys(&["speed_exponent"]) }
    }));
    sections.extend(spindle.tools.as_ref().map(|table| tools::write(inner(TOOLS_KEY), table)));
    sections
}

/// Returns a converted number without the rounding of `f64` in its last digits: 2.1 V of 3276.8 counts are 6881.28.
fn round_to_significant_digits(value: f64) -> f64 {
    format!("{value:.13e}").parse().unwrap_or(value)
}
