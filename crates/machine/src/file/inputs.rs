//! `[inputs]`: how the sensor and the thermometers are connected to the board.

use std::collections::BTreeMap;

use super::{
    read::Section,
    write::section::{NewSection, Value},
};
use crate::{
    inputs::{
        Inputs, LAST_CHANNEL, RATES_C_PER_MIN, REFERENCE_VOLTS, SensorInput, TemperatureInput,
        TemperatureKind,
    },
    location::{BadInput, shortened},
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

/// The run-file column of a temperature, which `key` names.
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

/// Whether a run-file column of this name is a temperature: `temp_<name>_c`.
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

pub(super) fn write(inputs: &Inputs) -> NewSection {
    let number = |key: &str, value| (key.to_string(), Value::Number(value));
    let mut section = NewSection::new("inputs");
    if inputs.service_switch {
        section = section.with("service_switch", Value::Boolean(true));
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
            TemperatureKind::Linear { .. } => "linear",
        };
        let mut entries = vec![
            ("channel".to_string(), Value::Whole((*channel).into())),
            ("kind".to_string(), Value::Text(kind_name.into())),
        ];
        if let TemperatureKind::Linear { zero_counts, counts_per_c } = *kind {
            entries.push(number("zero_counts", zero_counts));
            entries.push(number("counts_per_c", counts_per_c));
        }
        entries.extend(max_c_per_min.map(|rate| number("max_c_per_min", rate)));
        section = section.with(column, Value::Inline(entries));
    }
    section
}
