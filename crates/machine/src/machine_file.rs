//! The machine file: what the user believes about the machine, in TOML.
//!
//! Each section is read by one function into one type, strictly: a misspelt key must not become a
//! silent default, because the machine would then cut with it. What the format knows but this
//! version does not run is refused by name, never skipped.

use std::{collections::BTreeMap, fs, path::Path};

use crate::{
    inputs::{Inputs, REFERENCE_VOLTS, SensorInput, TemperatureInput, TemperatureKind},
    place::{BadInput, Place, Places, without_byte_order_mark},
    section::{Document, Section},
};

/// Sections of the format that this version does not run yet.
const LATER_SECTIONS: [&str; 4] = ["axis", "straightness", "squareness", "term"];
/// Spindle models of the format that this version does not run yet.
const LATER_SPINDLE_SECTIONS: [&str; 2] = ["warmup", "temperature"];

/// What the user believes about the machine.
#[derive(Clone, Debug, PartialEq)]
pub struct Machine {
    /// The user's name for it.
    pub name: String,
    /// Which axes turn the tool or the table.
    pub kind: Kind,
    /// From the spindle nose to the tool tip with all angles at zero, of length 1.
    pub tool_direction: [f64; 3],
    /// What is connected to the board; absent where the machine is only used to predict.
    pub inputs: Option<Inputs>,
    /// How the spindle grows.
    pub spindle: Spindle,
    /// How far and how fast an offset may go, and how long silence is tolerated.
    pub limits: Limits,
    /// Where in the file each key stands, for rules that are found broken later.
    pub places: Places,
}

/// Which axes turn the tool or the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Kind {
    /// X, Y and Z only: the tool direction never changes.
    ThreeAxis,
}

/// How the spindle grows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Spindle {
    /// The model in use; `None`: no elongation.
    pub source: Option<Source>,
    /// The displacement sensor. Always there if it is the `source`.
    pub sensor: Option<SensorModel>,
}

/// Where the elongation comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Source {
    /// The displacement sensor.
    Sensor,
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

/// How far and how fast an offset may go, and how long silence is tolerated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// The largest offset on X, Y and Z in µm, either way; at least 0.
    pub max_um: [f64; 3],
    /// The fastest change of an offset in µm a second, above 0.
    pub slew_um_per_s: f64,
    /// Without the CNC's sign of life for so long it counts as lost; at least 1.
    pub link_timeout_ms: u32,
    /// How long the last offset is held before it is taken back to 0.
    pub hold_ms: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_um: [200.0, 200.0, 500.0],
            slew_um_per_s: 20.0,
            link_timeout_ms: 500,
            hold_ms: 2000,
        }
    }
}

/// The machine file's reader.
#[derive(Clone, Copy, Debug)]
pub struct MachineFile;

impl MachineFile {
    /// Reads the machine file at `path`.
    ///
    /// # Errors
    /// The file cannot be read, is not UTF-8, or breaks a rule of [`Self::parse`].
    pub fn read(path: &Path) -> Result<Machine, BadInput> {
        let bytes = fs::read(path).map_err(|error| {
            BadInput::new(Place::start_of(path), format!("cannot be read: {error}"))
        })?;
        let source = str::from_utf8(&bytes).map_err(|error| {
            let valid = String::from_utf8_lossy(&bytes[..error.valid_up_to()]);
            let place = Place::at_byte(path, &valid, valid.len());
            BadInput::new(place, "is not UTF-8 text")
        })?;
        Self::parse(source, path)
    }

    /// Reads `source`, the content of the file at `path` (which names it in errors and is not
    /// opened).
    ///
    /// # Errors
    /// Invalid TOML, an unknown, missing or repeated key, a value of the wrong type or outside its
    /// range, or something that this version does not run; with its place and the rule.
    pub fn parse(source: &str, path: &Path) -> Result<Machine, BadInput> {
        let document = Document::parse(without_byte_order_mark(source), path)?;
        let root = document.root();
        root.allow_only(&["machine", "inputs", "spindle", "limits"], &LATER_SECTIONS)?;

        let machine = root.required("machine", root.section("machine")?)?;
        let (name, kind, tool_direction) = read_machine(&machine)?;
        let inputs = root.section("inputs")?.map(|inputs| read_inputs(&inputs)).transpose()?;
        let spindle = match root.section("spindle")? {
            Some(spindle) => read_spindle(&spindle)?,
            None => Spindle::default(),
        };
        let limits = match root.section("limits")? {
            Some(limits) => read_limits(&limits)?,
            None => Limits::default(),
        };
        let places = document.into_places();
        Ok(Machine { name, kind, tool_direction, inputs, spindle, limits, places })
    }
}

fn read_machine(section: &Section<'_>) -> Result<(String, Kind, [f64; 3]), BadInput> {
    section.allow_only(&["name", "kind", "head_axes", "tool_direction"], &[])?;
    let name = section.required("name", section.text("name")?)?;
    if name.trim().is_empty() {
        return Err(section.bad("name", "must not be empty"));
    }
    let kinds = [
        ("3-axis", Some(Kind::ThreeAxis)),
        ("head-head", None),
        ("table-table", None),
        ("head-table", None),
    ];
    let Some(kind) = section.required("kind", section.choice("kind", &kinds)?)? else {
        return Err(section.bad("kind", "other than \"3-axis\" is not supported by this version"));
    };
    if section.texts("head_axes")?.is_some_and(|axes| !axes.is_empty()) {
        return Err(section.bad("head_axes", "other than [] is not supported by this version"));
    }
    let tool_direction = match section.vector("tool_direction")? {
        Some(written) => normalised(written).ok_or_else(|| {
            section.bad("tool_direction", "has no length: it must point from the nose to the tip")
        })?,
        None => [0.0, 0.0, -1.0],
    };
    Ok((name.to_string(), kind, tool_direction))
}

/// `vector` at length 1, or `None` if it has no direction.
fn normalised(vector: [f64; 3]) -> Option<[f64; 3]> {
    // By the largest component first: the squares of very long or short ones leave the range.
    let largest = vector.iter().fold(0.0_f64, |largest, component| largest.max(component.abs()));
    if largest == 0.0 {
        return None;
    }
    let scaled = vector.map(|component| component / largest);
    let length = scaled.iter().map(|component| component * component).sum::<f64>().sqrt();
    Some(scaled.map(|component| component / length))
}

fn read_inputs(section: &Section<'_>) -> Result<Inputs, BadInput> {
    let mut inputs = Inputs::default();
    let mut column_of_channel = BTreeMap::new();
    for key in section.keys() {
        if key == "sensor" {
            inputs.sensor =
                section.section(key)?.map(|sensor| read_sensor_input(&sensor)).transpose()?;
        } else if is_temperature_column(key) {
            let Some(channel) = section.section(key)? else { continue };
            let input = read_temperature_input(&channel)?;
            if let Some(other) = column_of_channel.insert(input.channel, key) {
                let rule = format!("{} is already that of {other}", input.channel);
                return Err(channel.bad("channel", rule));
            }
            inputs.temperatures.insert(key.to_string(), input);
        } else {
            let mut error = section.unknown(key, ["sensor"]);
            error.rule.push_str("; the inputs are sensor and temp_<name>_c");
            return Err(error);
        }
    }
    Ok(inputs)
}

/// Whether a run-file column of this name is a temperature: `temp_<name>_c`.
#[must_use]
pub fn is_temperature_column(name: &str) -> bool {
    name.strip_prefix("temp_")
        .and_then(|rest| rest.strip_suffix("_c"))
        .is_some_and(|inner| !inner.is_empty())
}

fn read_sensor_input(section: &Section<'_>) -> Result<SensorInput, BadInput> {
    section.allow_only(&["volts_full_scale", "counts_full_scale", "divider"], &[])?;
    let positive = |key| section.required(key, section.positive(key)?);
    let sensor = SensorInput {
        volts_full_scale: positive("volts_full_scale")?,
        counts_full_scale: positive("counts_full_scale")?,
        divider: positive("divider")?,
    };
    let volts_at_adc = sensor.volts_full_scale * sensor.divider;
    // 10 V · 0.33 is 4·10⁻¹⁶ above 3.3 V in f64 and is meant to be equal.
    if volts_at_adc > REFERENCE_VOLTS * (1.0 + 1e-9) {
        let rule = format!(
            "{} takes {} V to {volts_at_adc:.4} V at the ADC, above its reference of \
             {REFERENCE_VOLTS} V",
            sensor.divider, sensor.volts_full_scale
        );
        return Err(section.bad("divider", rule));
    }
    Ok(sensor)
}

fn read_temperature_input(section: &Section<'_>) -> Result<TemperatureInput, BadInput> {
    section.allow_only(&["channel", "kind", "zero_counts", "counts_per_c"], &[])?;
    let channel = section.required("channel", section.whole("channel", 0, u8::MAX.into())?)?;
    let channel = u8::try_from(channel).expect("held to the range of u8 above");
    let zero_counts = section.number("zero_counts")?;
    let counts_per_c = section.number("counts_per_c")?;
    let is_linear = [("pt100", false), ("linear", true)];
    let kind = if section.required("kind", section.choice("kind", &is_linear)?)? {
        let zero_counts = section.required("zero_counts", zero_counts)?;
        let counts_per_c = section.required("counts_per_c", counts_per_c)?;
        if counts_per_c == 0.0 {
            return Err(section.bad("counts_per_c", "must not be 0"));
        }
        TemperatureKind::Linear { zero_counts, counts_per_c }
    } else {
        for (key, value) in [("zero_counts", zero_counts), ("counts_per_c", counts_per_c)] {
            if value.is_some() {
                return Err(section.bad(key, "belongs to kind = \"linear\""));
            }
        }
        TemperatureKind::Pt100
    };
    Ok(TemperatureInput { channel, kind })
}

fn read_spindle(section: &Section<'_>) -> Result<Spindle, BadInput> {
    section.allow_only(&["source", "sensor"], &LATER_SPINDLE_SECTIONS)?;
    let sources = [("sensor", Some(Source::Sensor)), ("warmup", None), ("temperature", None)];
    let source = match section.choice("source", &sources)? {
        Some(None) => {
            let rule = "other than \"sensor\" is not supported by this version";
            return Err(section.bad("source", rule));
        }
        Some(source) => source,
        None => None,
    };
    let sensor = section.section("sensor")?.map(|sensor| read_sensor_model(&sensor)).transpose()?;
    if source == Some(Source::Sensor) && sensor.is_none() {
        return Err(section.bad("source", "is \"sensor\", but [spindle.sensor] is missing"));
    }
    Ok(Spindle { source, sensor })
}

fn read_sensor_model(section: &Section<'_>) -> Result<SensorModel, BadInput> {
    section.allow_only(&["k0_um", "zero_counts", "um_per_count", "temperature"], &[])?;
    let number = |key| section.required(key, section.number(key)?);
    let k0_um = number("k0_um")?;
    let zero_counts = number("zero_counts")?;
    let um_per_count = number("um_per_count")?;
    if um_per_count == 0.0 {
        return Err(section.bad("um_per_count", "must not be 0"));
    }
    let temperature = section.text("temperature")?;
    if let Some(column) = temperature
        && !is_temperature_column(column)
    {
        return Err(section.bad("temperature", "must name a column temp_<name>_c"));
    }
    Ok(SensorModel {
        k0_um,
        zero_counts,
        um_per_count,
        temperature: temperature.map(str::to_string),
    })
}

fn read_limits(section: &Section<'_>) -> Result<Limits, BadInput> {
    section.allow_only(&["max_um", "slew_um_per_s", "link_timeout_ms", "hold_ms"], &[])?;
    let mut limits = Limits::default();
    if let Some(max) = section.section("max_um")? {
        let axes = ["x", "y", "z"];
        max.allow_only(&axes, &[])?;
        for (limit, axis) in limits.max_um.iter_mut().zip(axes) {
            *limit = max.not_negative(axis)?.unwrap_or(*limit);
        }
    }
    limits.slew_um_per_s = section.positive("slew_um_per_s")?.unwrap_or(limits.slew_um_per_s);
    limits.link_timeout_ms =
        section.whole("link_timeout_ms", 1, u32::MAX)?.unwrap_or(limits.link_timeout_ms);
    limits.hold_ms = section.whole("hold_ms", 0, u32::MAX)?.unwrap_or(limits.hold_ms);
    Ok(limits)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(source: &str) -> Machine {
        MachineFile::parse(source, Path::new("m.toml")).expect("the test's own text is right")
    }

    const SHORTEST: &str = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n";

    #[test]
    fn what_is_left_out_has_the_documented_defaults() {
        let machine = parse(SHORTEST);
        assert_eq!(machine.name, "mill");
        assert_eq!(machine.kind, Kind::ThreeAxis);
        assert_eq!(machine.tool_direction, [0.0, 0.0, -1.0]);
        assert_eq!(machine.inputs, None);
        assert_eq!(machine.spindle, Spindle::default());
        assert_eq!(machine.limits.max_um, [200.0, 200.0, 500.0]);
        assert_eq!(machine.limits.slew_um_per_s, 20.0);
        assert_eq!(machine.limits.link_timeout_ms, 500);
        assert_eq!(machine.limits.hold_ms, 2000);
    }

    #[test]
    fn every_key_that_is_run_arrives_in_its_field() {
        let machine = parse(
            r#"
            [machine]
            name = "gantry"
            kind = "3-axis"
            head_axes = []
            tool_direction = [0, 3, -4]
            [inputs]
            sensor = { volts_full_scale = 5, counts_full_scale = 27_648, divider = 0.66 }
            temp_screw_c = { channel = 0, kind = "pt100" }
            temp_coil_c = { channel = 3, kind = "linear", zero_counts = 4000, counts_per_c = 16 }
            [spindle]
            source = "sensor"
            [spindle.sensor]
            k0_um = -1.5
            zero_counts = 5048.0
            um_per_count = -0.015
            temperature = "temp_coil_c"
            [limits]
            max_um = { z = 60 }
            slew_um_per_s = 5.5
            link_timeout_ms = 250
            hold_ms = 0
            "#,
        );
        assert_eq!(machine.tool_direction, [0.0, 0.6, -0.8]);
        let inputs = machine.inputs.expect("written above");
        let sensor = inputs.sensor.expect("written above");
        assert_eq!(sensor.volts_full_scale, 5.0);
        assert_eq!(sensor.counts_full_scale, 27648.0);
        assert_eq!(sensor.divider, 0.66);
        let pt100 = TemperatureInput { channel: 0, kind: TemperatureKind::Pt100 };
        let kind = TemperatureKind::Linear { zero_counts: 4000.0, counts_per_c: 16.0 };
        let linear = TemperatureInput { channel: 3, kind };
        assert_eq!(inputs.temperatures["temp_screw_c"], pt100);
        assert_eq!(inputs.temperatures["temp_coil_c"], linear);
        assert_eq!(machine.spindle.source, Some(Source::Sensor));
        let model = SensorModel {
            k0_um: -1.5,
            zero_counts: 5048.0,
            um_per_count: -0.015,
            temperature: Some("temp_coil_c".into()),
        };
        assert_eq!(machine.spindle.sensor, Some(model));
        let limits = Limits {
            max_um: [200.0, 200.0, 60.0],
            slew_um_per_s: 5.5,
            link_timeout_ms: 250,
            hold_ms: 0,
        };
        assert_eq!(machine.limits, limits);
    }

    #[test]
    fn a_sensor_that_is_not_the_source_is_kept_but_not_used() {
        let text =
            format!("{SHORTEST}[spindle.sensor]\nk0_um = 0\nzero_counts = 0\num_per_count = 1\n");
        let spindle = parse(&text).spindle;
        assert_eq!(spindle.source, None);
        assert!(spindle.sensor.is_some());
    }

    #[test]
    fn a_byte_order_mark_and_windows_line_ends_change_nothing() {
        let windows = format!("\u{feff}{}", SHORTEST.replace('\n', "\r\n"));
        assert_eq!(parse(&windows), parse(SHORTEST));
    }

    #[test]
    fn the_tool_direction_is_normalised_however_long_it_is_written() {
        for length in ["1e-300", "2.5", "1e300"] {
            let text = format!("{SHORTEST}tool_direction = [{length}, 0.0, 0.0]\n");
            assert_eq!(parse(&text).tool_direction, [1.0, 0.0, 0.0]);
        }
    }

    #[test]
    fn a_key_keeps_its_place_for_rules_found_broken_later() {
        let text = format!("{SHORTEST}[limits]\nmax_um = {{ x = 1.0 }}\n");
        let machine = parse(&text);
        let place = machine.places.of("limits.max_um.x");
        assert_eq!((place.line, place.column), (5, 16));
        let place = machine.places.of("limits.hold_ms");
        assert_eq!((place.line, place.column), (4, 2));
    }
}
