//! `[inputs]`: how the sensor and the thermometers are connected to the board.

use std::collections::BTreeMap;

use trueup_core::calibration::Mains;

use super::{
    read::Section,
    write::section::{NewSection, Value},
};
use crate::{
    inputs::{
        ConditionInput, CountScale, Inputs, LAST_CHANNEL, LinearInput, RATES_C_PER_MIN,
        REFERENCE_VOLTS, SensorInput, TemperatureInput, TemperatureKind, USUAL_FULL_SCALE_V,
        WIRED_DIVIDER,
    },
    location::{BadInput, shortened},
    run_file::is_known_column,
    tool::TOOL_COLUMN,
};

pub(super) fn read(section: &Section<'_>) -> Result<Inputs, BadInput> {
    let mut inputs = Inputs::default();
    let mut column_of_channel = BTreeMap::new();
    for key in section.keys() {
        if key == "sensor" {
            inputs.sensor =
                section.section(key)?.map(|sensor| read_sensor_input(&sensor)).transpose()?;
        } else if key == "service_switch" {
            inputs.service_switch = section.boolean(key)?.unwrap_or_default();
        } else if key == "mains_hz" {
            inputs.mains = match section.whole(key, 50, 60)? {
                None | Some(50) => Mains::Hz50,
                Some(60) => Mains::Hz60,
                Some(hz) => return Err(section.bad(key, format!("must be 50 or 60, not {hz}"))),
            };
        } else if let Some(condition) = section.section(key)?.filter(is_condition) {
            let input = read_condition(&condition, key)?;
            let is_taken = |(_, it): &(&String, &ConditionInput)| it.bit == input.bit;
            if let Some((other, _)) = inputs.conditions.iter().find(is_taken) {
                let rule = format!("{} is already that of {other}", input.bit);
                return Err(condition.bad("bit", rule));
            }
            inputs.conditions.insert(key.to_string(), input);
        } else if let Some(channel) = section.section(key)? {
            let input = read_temperature_input(&channel)?;
            if let Some(other) = column_of_channel.insert(input.channel, key) {
                let rule = format!("{} is already that of {other}", input.channel);
                return Err(channel.bad("channel", rule));
            }
            inputs.temperatures.insert(key.to_string(), input);
        }
    }
    Ok(inputs)
}

/// Returns whether an input says that it is a condition.
pub(super) fn is_condition(section: &Section<'_>) -> bool {
    section.text("kind").ok().flatten() == Some("condition")
}

fn read_condition(section: &Section<'_>, name: &str) -> Result<ConditionInput, BadInput> {
    if name == TOOL_COLUMN || is_known_column(name) {
        return Err(section
            .bad("kind", format!("cannot be \"condition\": a column {name} is something else")));
    }
    let bit = section.required("bit", section.whole("bit", 0, 15)?)?;
    let bit = u8::try_from(bit).expect("held to the range of u8 above");
    Ok(ConditionInput { bit, default: section.whole("default", 0, 1)?.unwrap_or(0) != 0 })
}

/// Returns the run-file column of a temperature, which `key` names.
pub(crate) fn read_temperature_column(
    section: &Section<'_>,
    key: &str,
) -> Result<Option<String>, BadInput> {
    match section.text(key)? {
        Some(column) if !is_temperature_column(column) => {
            let rule = format!("must name a column temp_<name>_c, not \"{}\"", shortened(column));
            Err(section.bad(key, rule))
        }
        column => Ok(column.map(str::to_string)),
    }
}

/// Returns whether a run-file column of this name is a temperature: `temp_<name>_c`.
#[must_use]
pub fn is_temperature_column(name: &str) -> bool {
    name.strip_prefix("temp_")
        .and_then(|rest| rest.strip_suffix("_c"))
        .is_some_and(|inner| !inner.is_empty())
}

fn read_sensor_input(section: &Section<'_>) -> Result<SensorInput, BadInput> {
    let positive = |key| section.required(key, section.positive(key)?);
    let sensor = SensorInput {
        volts_full_scale: positive("volts_full_scale")?,
        counts_full_scale: positive("counts_full_scale")?,
        divider: positive("divider")?,
    };
    refuse_above_reference(section, "divider", sensor.volts_full_scale, sensor.divider)?;
    Ok(sensor)
}

fn read_temperature_input(section: &Section<'_>) -> Result<TemperatureInput, BadInput> {
    let channel = section.required("channel", section.whole("channel", 0, LAST_CHANNEL.into())?)?;
    let channel = u8::try_from(channel).expect("held to the range of u8 above");
    let is_linear = [("pt100", false), ("linear", true)];
    let kind = if section.required("kind", section.choice("kind", &is_linear)?)? {
        TemperatureKind::Linear(read_linear(section)?)
    } else {
        for key in IN_VOLTS.iter().chain(&IN_COUNTS).chain(&OF_SCALE) {
            if section.number(key)?.is_some() {
                return Err(section.bad(key, "belongs to kind = \"linear\""));
            }
        }
        TemperatureKind::Pt100
    };
    let max_c_per_min = section.number("max_c_per_min")?;
    let [slowest, fastest] = RATES_C_PER_MIN;
    if let Some(rate) = max_c_per_min.filter(|rate| !(slowest..=fastest).contains(rate)) {
        let rule = format!(
            "must be from {slowest} to {fastest} K/min: the fastest change that the \
             thermometer's mass can make, not {rate}"
        );
        return Err(section.bad("max_c_per_min", rule));
    }
    Ok(TemperatureInput { channel, kind, max_c_per_min })
}

const IN_VOLTS: [&str; 2] = ["zero_v", "c_per_v"];
const IN_COUNTS: [&str; 3] = ["zero_counts", "counts_per_c", "counts_full_scale"];
const OF_SCALE: [&str; 2] = ["full_scale_v", "divider"];

/// Reads a line in one of its two forms: volts and °C, or counts with what a count is.
fn read_linear(section: &Section<'_>) -> Result<LinearInput, BadInput> {
    let not_zero = |key| match section.required(key, section.number(key)?)? {
        0.0 => Err(section.bad(key, "must not be 0")),
        value => Ok(value),
    };
    let stated = |keys: &[&'static str]| -> Result<Option<&'static str>, BadInput> {
        for key in keys {
            if section.number(key)?.is_some() {
                return Ok(Some(key));
            }
        }
        Ok(None)
    };
    let (volts, counts) = (stated(&IN_VOLTS)?, stated(&IN_COUNTS)?);
    if let (Some(volts), Some(counts)) = (volts, counts) {
        let rule = format!(
            "stands together with {counts}: state the line in volts (zero_v, c_per_v) or in counts (zero_counts, \
             counts_per_c, counts_full_scale), not in both"
        );
        return Err(section.bad(volts, rule));
    }
    if volts.is_none() && counts.is_none() {
        let rule = "is missing: a linear input needs zero_v and c_per_v, or zero_counts, counts_per_c and \
                    counts_full_scale";
        return Err(section.bad("zero_v", rule));
    }
    if volts.is_some() {
        let zero_counts = section.required("zero_v", section.number("zero_v")?)?;
        let counts_per_c = 1.0 / not_zero("c_per_v")?;
        let (full_scale_v, divider) = read_scale(section)?;
        let scale = CountScale::Volt { full_scale_v, divider };
        return Ok(LinearInput { zero_counts, counts_per_c, scale });
    }
    let zero_counts = section.required("zero_counts", section.number("zero_counts")?)?;
    let counts_per_c = not_zero("counts_per_c")?;
    let scale = if let Some(counts_full_scale) = section.positive("counts_full_scale")? {
        let (full_scale_v, divider) = read_scale(section)?;
        CountScale::Count { counts_full_scale, full_scale_v, divider }
    } else {
        if let Some(key) = stated(&OF_SCALE)? {
            let rule = "needs counts_full_scale: without it a count is a code of the board, 4096 at 3.3 V on the pin";
            return Err(section.bad(key, rule));
        }
        CountScale::Code
    };
    Ok(LinearInput { zero_counts, counts_per_c, scale })
}

/// Reads the full scale of a linear input in volts, and its divider.
fn read_scale(section: &Section<'_>) -> Result<(f64, f64), BadInput> {
    let full_scale_v = section.positive("full_scale_v")?.unwrap_or(USUAL_FULL_SCALE_V);
    let divider = section.positive("divider")?.unwrap_or(WIRED_DIVIDER);
    let key = if section.number("divider")?.is_some() { "divider" } else { "full_scale_v" };
    refuse_above_reference(section, key, full_scale_v, divider)?;
    Ok((full_scale_v, divider))
}

/// Refuses a divider that takes the full scale above the reference of the board's converter.
fn refuse_above_reference(
    section: &Section<'_>,
    key: &str,
    full_scale_v: f64,
    divider: f64,
) -> Result<(), BadInput> {
    let volts_at_adc = full_scale_v * divider;
    // 10 V · 0.33 is 4·10⁻¹⁶ above 3.3 V in f64 and is meant to be equal.
    if volts_at_adc > REFERENCE_VOLTS * (1.0 + 1e-9) {
        let rule = format!(
            "{divider} takes {full_scale_v} V to {volts_at_adc:.4} V at the ADC, above its reference of \
             {REFERENCE_VOLTS} V"
        );
        let rule = if key == "divider" {
            rule
        } else {
            format!("{full_scale_v} is too high: the divider {rule}")
        };
        return Err(section.bad(key, rule));
    }
    Ok(())
}

pub(super) fn write(inputs: &Inputs) -> NewSection {
    let number = |key: &str, value| (key.to_string(), Value::Number(value));
    let mut section = NewSection::new("inputs");
    if inputs.service_switch {
        section = section.with("service_switch", Value::Boolean(true));
    }
    if inputs.mains == Mains::Hz60 {
        section = section.with("mains_hz", Value::Whole(60));
    }
    if let Some(SensorInput { volts_full_scale, counts_full_scale, divider }) = inputs.sensor {
        let entries = vec![
            number("volts_full_scale", volts_full_scale),
            number("counts_full_scale", counts_full_scale),
            number("divider", divider),
        ];
        section = section.with("sensor", Value::Inline(entries));
    }
    for (column, TemperatureInput { channel, kind, max_c_per_min }) in &inputs.temperatures {
        let kind_name = match kind {
            TemperatureKind::Pt100 => "pt100",
            TemperatureKind::Linear(_) => "linear",
        };
        let mut entries = vec![
            ("channel".to_string(), Value::Whole((*channel).into())),
            ("kind".to_string(), Value::Text(kind_name.into())),
        ];
        if let TemperatureKind::Linear(LinearInput { zero_counts, counts_per_c, scale }) = *kind {
            if let CountScale::Volt { .. } = scale {
                entries.push(number("zero_v", zero_counts));
                entries.push(number("c_per_v", 1.0 / counts_per_c));
            } else {
                entries.push(number("zero_counts", zero_counts));
                entries.push(number("counts_per_c", counts_per_c));
            }
            if let CountScale::Count { counts_full_scale, .. } = scale {
                entries.push(number("counts_full_scale", counts_full_scale));
            }
            if let CountScale::Volt { full_scale_v, divider }
            | CountScale::Count { full_scale_v, divider, .. } = scale
            {
                entries.push(number("full_scale_v", full_scale_v));
                entries.push(number("divider", divider));
            }
        }
        entries.extend(max_c_per_min.map(|rate| number("max_c_per_min", rate)));
        section = section.with(column, Value::Inline(entries));
    }
    for (column, ConditionInput { bit, default }) in &inputs.conditions {
        let mut entries = vec![
            ("kind".to_string(), Value::Text("condition".into())),
            ("bit".to_string(), Value::Whole((*bit).into())),
        ];
        if *default {
            entries.push(("default".to_string(), Value::Whole(1)));
        }
        section = section.with(column, Value::Inline(entries));
    }
    section
}
