//! The machine file: what the user believes about the machine, in TOML.
//!
//! Each section is read by one function into one type, strictly: a misspelt key must not become a
//! silent default, because the machine would then cut with it. What the format knows but this
//! version does not run is refused by name, never skipped. `[machine]`, `[inputs]` and `[limits]`
//! are read here, the rest by one module for each.

mod axis;
mod spindle;
mod straightness;
mod term;

use std::{collections::BTreeMap, path::Path};

pub use axis::{
    Axis, Backlash, Dual, Feedback, LinearAxis, Pitch, RotaryAxis, Thermal, ThermalMode, ThermalRow,
};
pub use spindle::{SensorModel, Source, Spindle, TemperatureModel, Warmup};
pub use straightness::{BSpline, SplineFault, Squareness, Straightness};
pub use term::{Cause, Effect, Quantity, Term, Wave};

use crate::{
    bounded,
    inputs::{
        Inputs, LAST_CHANNEL, REFERENCE_VOLTS, SensorInput, TemperatureInput, TemperatureKind,
    },
    place::{BadInput, Places, shortened, without_byte_order_mark},
    section::{Document, Section},
};

/// Sections of the format that this version reads.
const SECTIONS: [&str; 8] =
    ["machine", "inputs", "spindle", "axis", "straightness", "squareness", "limits", "term"];

/// The longest machine file that is read, in bytes: forty times what the board could store of it.
pub const MOST_BYTES: u64 = 4 << 20;

/// What the user believes about the machine.
#[derive(Clone, Debug, PartialEq)]
pub struct Machine {
    /// The user's name for it.
    pub name: String,
    /// Which axes turn the tool or the table.
    pub kind: Kind,
    /// The rotary axes that carry the spindle, from the frame to the tool; as many as
    /// [`Kind::head_axes`] says, and no axis twice.
    pub head_axes: Vec<RotaryAxis>,
    /// From the spindle nose to the tool tip with all angles at zero, of length 1.
    pub tool_direction: [f64; 3],
    /// What is connected to the board; absent where the machine is only used to predict.
    pub inputs: Option<Inputs>,
    /// How the spindle grows.
    pub spindle: Spindle,
    /// What is known of X, Y and Z, by [`LinearAxis::index`].
    pub axes: [Axis; 3],
    /// The straightness curves; no pair of axes twice.
    pub straightness: Vec<Straightness>,
    /// The angles between the axes as they are written; no pair of axes twice.
    pub squareness: Vec<Squareness>,
    /// How far and how fast an offset may go, and how long silence is tolerated.
    pub limits: Limits,
    /// What a diagnosis has added, in the order in which it applies.
    pub terms: Vec<Term>,
    /// Where in the file each key stands, for rules that are found broken later.
    pub places: Places,
}

/// Which axes turn the tool or the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// X, Y and Z only: the tool direction never changes.
    ThreeAxis,
    /// Two rotary axes carry the spindle.
    HeadHead,
    /// Two rotary axes carry the workpiece: the spindle does not turn in machine coordinates.
    TableTable,
    /// One rotary axis carries the spindle, the other the workpiece.
    HeadTable,
}

impl Kind {
    /// Its name in the machine file.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::ThreeAxis => "3-axis",
            Self::HeadHead => "head-head",
            Self::TableTable => "table-table",
            Self::HeadTable => "head-table",
        }
    }

    /// How many rotary axes carry the spindle.
    #[must_use]
    pub fn head_axes(self) -> usize {
        match self {
            Self::ThreeAxis | Self::TableTable => 0,
            Self::HeadTable => 1,
            Self::HeadHead => 2,
        }
    }
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
    /// As [`Self::read_text`] and [`Self::parse`].
    pub fn read(path: &Path) -> Result<Machine, BadInput> {
        Self::parse(&Self::read_text(path)?, path)
    }

    /// Reads the text of the machine file at `path`, as it is.
    ///
    /// # Errors
    /// The file cannot be read, is longer than [`MOST_BYTES`], or is not UTF-8.
    pub fn read_text(path: &Path) -> Result<String, BadInput> {
        bounded::read_text(path, MOST_BYTES)
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
        root.allow_only(&SECTIONS)?;

        let machine = root.required("machine", root.section("machine")?)?;
        let (name, kind, head_axes, tool_direction) = read_machine(&machine)?;
        let inputs = root.section("inputs")?.map(|inputs| read_inputs(&inputs)).transpose()?;
        let spindle = match root.section("spindle")? {
            Some(spindle) => spindle::read(&spindle)?,
            None => Spindle::default(),
        };
        let axes = match root.section("axis")? {
            Some(axes) => axis::read(&axes)?,
            None => Default::default(),
        };
        let straightness = match root.section("straightness")? {
            Some(curves) => straightness::read_straightness(&curves)?,
            None => Vec::new(),
        };
        let squareness = match root.section("squareness")? {
            Some(angles) => straightness::read_squareness(&angles)?,
            None => Vec::new(),
        };
        let limits = match root.section("limits")? {
            Some(limits) => read_limits(&limits)?,
            None => Limits::default(),
        };
        let mut machine = Machine {
            name,
            kind,
            head_axes,
            tool_direction,
            inputs,
            spindle,
            axes,
            straightness,
            squareness,
            limits,
            terms: Vec::new(),
            places: Places::default(),
        };
        for section in root.sections("term")? {
            let term = term::read(&section)?;
            term::check(&section, &term, &machine)?;
            machine.terms.push(term);
        }
        machine.places = document.into_places();
        Ok(machine)
    }
}

type MachineSection = (String, Kind, Vec<RotaryAxis>, [f64; 3]);

fn read_machine(section: &Section<'_>) -> Result<MachineSection, BadInput> {
    section.allow_only(&["name", "kind", "head_axes", "tool_direction"])?;
    let name = section.required("name", section.text("name")?)?;
    if name.trim().is_empty() {
        return Err(section.bad("name", "must not be empty"));
    }
    let kinds = [Kind::ThreeAxis, Kind::HeadHead, Kind::TableTable, Kind::HeadTable]
        .map(|kind| (kind.name(), kind));
    let kind = section.required("kind", section.choice("kind", &kinds)?)?;
    let head_axes = read_head_axes(section, kind)?;
    let tool_direction = match section.vector("tool_direction")? {
        Some(written) => normalised(written).ok_or_else(|| {
            section.bad("tool_direction", "has no length: it must point from the nose to the tip")
        })?,
        None => [0.0, 0.0, -1.0],
    };
    Ok((name.to_string(), kind, head_axes, tool_direction))
}

fn read_head_axes(section: &Section<'_>, kind: Kind) -> Result<Vec<RotaryAxis>, BadInput> {
    let mut axes = Vec::new();
    for (index, name) in section.texts("head_axes")?.unwrap_or_default().into_iter().enumerate() {
        let axis =
            RotaryAxis::ALL.into_iter().find(|axis| axis.name() == name).ok_or_else(|| {
                let rule = format!("must be \"a\" or \"b\" or \"c\", not \"{}\"", shortened(name));
                section.bad(&format!("head_axes[{index}]"), rule)
            })?;
        axes.push(axis);
    }
    let wanted = match kind {
        Kind::ThreeAxis => "must be [], because no rotary axis carries the spindle",
        Kind::TableTable => "must be [], because both rotary axes carry the workpiece",
        Kind::HeadTable => "must name exactly one axis, the one that carries the spindle",
        Kind::HeadHead => "must name exactly two different axes, from the frame to the tool",
    };
    let repeated = axes.len() == 2 && axes.first() == axes.last();
    if axes.len() != kind.head_axes() || repeated {
        // At most four of what may be a very long list.
        let there = axes.iter().take(4).map(|axis| format!("\"{}\"", axis.name()));
        let there = there.collect::<Vec<_>>().join(", ");
        let rule = format!("{wanted} (kind = \"{}\"), not [{there}]", kind.name());
        return Err(section.bad("head_axes", rule));
    }
    Ok(axes)
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

/// The run-file column of a temperature, which `key` names.
fn read_temperature_column(section: &Section<'_>, key: &str) -> Result<Option<String>, BadInput> {
    match section.text(key)? {
        Some(column) if !is_temperature_column(column) => {
            let rule = format!("must name a column temp_<name>_c, not \"{}\"", shortened(column));
            Err(section.bad(key, rule))
        }
        column => Ok(column.map(str::to_string)),
    }
}

/// Whether a run-file column of this name is a temperature: `temp_<name>_c`.
#[must_use]
pub fn is_temperature_column(name: &str) -> bool {
    name.strip_prefix("temp_")
        .and_then(|rest| rest.strip_suffix("_c"))
        .is_some_and(|inner| !inner.is_empty())
}

fn read_sensor_input(section: &Section<'_>) -> Result<SensorInput, BadInput> {
    section.allow_only(&["volts_full_scale", "counts_full_scale", "divider"])?;
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
    section.allow_only(&["channel", "kind", "zero_counts", "counts_per_c"])?;
    let channel = section.required("channel", section.whole("channel", 0, LAST_CHANNEL.into())?)?;
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

fn read_limits(section: &Section<'_>) -> Result<Limits, BadInput> {
    section.allow_only(&["max_um", "slew_um_per_s", "link_timeout_ms", "hold_ms"])?;
    let mut limits = Limits::default();
    if let Some(max) = section.section("max_um")? {
        let axes = ["x", "y", "z"];
        max.allow_only(&axes)?;
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
