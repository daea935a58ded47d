//! `[inputs]`: how the sensor and the thermometers are connected to the board.

use std::collections::BTreeMap;

use trueup_core::calibration::MainsFrequency;

use crate::{
    inputs::{
        ADC_REFERENCE_VOLTS, BoardInputs, ConditionInput, CountScale, LinearInput,
        MAX_TEMPERATURE_CHANNEL, RATE_LIMIT_RANGE_C_PER_MIN, SensorInput, TemperatureInput,
        TemperatureInputKind,
    },
    keys::{
        key::{
            Key,
            ValueType::{Boolean, Whole},
            key, section,
        },
        reader::Section,
        section::NewSection,
        table::{Table, add_key, choice, read_or_default, table, to_inline_table},
    },
    known_columns::is_known_column,
    location::InputFileError,
    tool_column::TOOL_COLUMN,
};

pub(crate) const INPUT_KEYS: &[Key] = &[
    SERVICE_SWITCH_KEY,
    MAINS_FREQUENCY_KEY,
    section("sensor", SensorInput::KEYS, "how the displacement sensor reaches the board"),
    section(
        "temp_<name>_c",
        ThermometerKeys::KEYS,
        "how the thermometer of that column reaches the board; at most eight",
    ),
    section(
        "<condition>",
        ConditionKeys::KEYS,
        "a column of a run with 0 and 1, as `coolant_on`, that the CNC sends; known by `kind`",
    ),
];

const SERVICE_SWITCH_KEY: Key = key("service_switch", Boolean, "", "nothing is written to the board (calibration, reference, settings) unless the switch on its pin PB7 is closed to ground. This holds from this calibration's first start on, also against the next one")
    .with_default("false")
    .omit_default();

const MAINS_FREQUENCY_KEY: Key = key(
    "mains_hz",
    Whole(50, 60),
    "Hz",
    "the mains, 50 or 60, whose hum the PT100 converters and the linear inputs suppress",
)
.with_default("50")
.omit_default();

table! {
    /// The keys of a thermometer.
    #[derive(Default)]
    struct ThermometerKeys {
        channel: u8 = key(Whole(0, MAX_TEMPERATURE_CHANNEL as u32), "", "the number of its converter on the board; no two share one").required().with_example_value("0");
        kind: ThermometerKind = key(Choice(ThermometerKind::NAMES), "", "a PT100 by IEC 60751, or a line").required().with_example_value("\"pt100\"");
        zero_v: Option<f64> = key(Number, "V", "of a line: the voltage at 0 °C, by the line's own slope, also where the transmitter does not reach it. With `c_per_v`, or `zero_counts` and `counts_per_c`").with_example_value("0.0");
        c_per_v: Option<f64> = key(Number, "K/V", "of a line: kelvin for one volt at the input; not 0").with_example_value("10.0");
        zero_counts: Option<f64> = key(Number, "counts", "of a line in counts: the counts at 0 °C, in the place of `zero_v`").with_example_value("4000");
        counts_per_c: Option<f64> = key(Number, "counts/K", "of a line in counts: counts for one kelvin, not 0; in the place of `c_per_v`").with_example_value("16");
        counts_full_scale: Option<f64> = key(Positive, "counts", "of a line in counts: what the other converter gives at `full_scale_v` (27648 for a SIMATIC S7 input, 32768 for the paper's). Without it a count is a code of the board: 4096 at 3.3 V on the pin").with_example_value("27648");
        full_scale_v: Option<f64> = key(Positive, "V", "of a line: the largest voltage of the input").with_default("10.0");
        divider: Option<f64> = key(Positive, "", "of a line: volts at the board's converter for one volt at the input; `full_scale_v` · `divider` must not be above 3.3 V").with_default("0.328");
        max_c_per_min: Option<f64> = key(Positive, "K/min", "the fastest change that the mass at the thermometer can make, from 0.1 to 600. A faster reading is not believed until it has stayed within it for 60 s. Without it 10 where a law uses the thermometer; coolant, oil and air need more").with_example_value("60.0").with_range(range([0.0, 1e4], [0.1, 600.0], [1.0, 60.0], USER_SETTING_SOURCE));
    }
}

choice! {
    /// The kind of a thermometer.
    #[derive(Clone, Copy, Default)]
    enum ThermometerKind {
        /// By IEC 60751.
        #[default]
        Pt100 = "pt100",
        /// A line.
        Linear = "linear",
    }
}

table! {
    /// A condition.
    struct ConditionKeys {
        kind: String = key(Choice(&[CONDITION_KIND]), "", "a condition of the machine that holds (1) or not (0), from the CNC").required().with_example_value("\"condition\"");
        bit: u8 = key(Whole(0, 15), "", "its bit in `Conditions`; no two share one").required().with_example_value("0");
        default: bool = key(Whole(0, 1), "", "what counts while the CNC does not send it").with_default("0").omit_default();
    }
}

const CONDITION_KIND: &str = "condition";

pub(crate) fn read(section: &Section<'_>) -> Result<BoardInputs, InputFileError> {
    let mut inputs = BoardInputs::default();
    let mut column_of_channel = BTreeMap::new();
    for key in section.keys() {
        if key == "sensor" {
            inputs.sensor =
                section.section(key)?.map(|sensor| read_sensor_input(&sensor)).transpose()?;
        } else if key == SERVICE_SWITCH_KEY.name {
            inputs.service_switch = read_or_default(section, &SERVICE_SWITCH_KEY)?;
        } else if key == MAINS_FREQUENCY_KEY.name {
            inputs.mains = match read_or_default::<u32>(section, &MAINS_FREQUENCY_KEY)? {
                50 => MainsFrequency::Hz50,
                60 => MainsFrequency::Hz60,
                hz => return Err(section.key_error(key, format!("must be 50 or 60, not {hz}"))),
            };
        } else if let Some(condition) = section.section(key)?.filter(is_condition) {
            let input = read_condition(&condition, key)?;
            let is_taken = |(_, other): &(&String, &ConditionInput)| other.bit == input.bit;
            if let Some((other, _)) = inputs.conditions.iter().find(is_taken) {
                let rule = format!("{} is already that of {other}", input.bit);
                return Err(condition.key_error("bit", rule));
            }
            inputs.conditions.insert(key.to_string(), input);
        } else if let Some(channel) = section.section(key)? {
            let input = read_temperature_input(&channel)?;
            if let Some(other) = column_of_channel.insert(input.channel, key) {
                let rule = format!("{} is already that of {other}", input.channel);
                return Err(channel.key_error("channel", rule));
            }
            inputs.temperatures.insert(key.to_string(), input);
        }
    }
    Ok(inputs)
}

/// Returns whether an input says that it is a condition.
pub(crate) fn is_condition(section: &Section<'_>) -> bool {
    section.text("kind").ok().flatten() == Some(CONDITION_KIND)
}

fn read_condition(section: &Section<'_>, name: &str) -> Result<ConditionInput, InputFileError> {
    if name == TOOL_COLUMN || is_known_column(name) {
        return Err(section.key_error(
            "kind",
            format!("cannot be \"condition\": a column {name} is something else"),
        ));
    }
    let ConditionKeys { bit, default, .. } = ConditionKeys::read(section)?;
    Ok(ConditionInput { bit, default })
}

fn read_sensor_input(section: &Section<'_>) -> Result<SensorInput, InputFileError> {
    let sensor = SensorInput::read(section)?;
    reject_full_scale_above_adc_reference(
        section,
        "divider",
        sensor.volts_full_scale,
        sensor.divider,
    )?;
    Ok(sensor)
}

fn read_temperature_input(section: &Section<'_>) -> Result<TemperatureInput, InputFileError> {
    let keys = ThermometerKeys::read(section)?;
    let kind = match keys.kind {
        ThermometerKind::Linear => TemperatureInputKind::Linear(read_linear_input(section, &keys)?),
        ThermometerKind::Pt100 => {
            let of_line = VOLTAGE_KEYS.iter().chain(&COUNT_KEYS).chain(&SCALE_KEYS);
            if let Some(key) = section.first_present_key(of_line) {
                return Err(section.key_error(key, "belongs to kind = \"linear\""));
            }
            TemperatureInputKind::Pt100
        }
    };
    let [slowest, fastest] = RATE_LIMIT_RANGE_C_PER_MIN;
    if let Some(rate) = keys.max_c_per_min.filter(|rate| !(slowest..=fastest).contains(rate)) {
        let rule = format!(
            "must be from {slowest} to {fastest} K/min: the fastest change that the \
             thermometer's mass can make, not {rate}"
        );
        return Err(section.key_error("max_c_per_min", rule));
    }
    Ok(TemperatureInput { channel: keys.channel, kind, max_c_per_min: keys.max_c_per_min })
}

const VOLTAGE_KEYS: [&str; 2] = ["zero_v", "c_per_v"];
const COUNT_KEYS: [&str; 3] = ["zero_counts", "counts_per_c", "counts_full_scale"];
const SCALE_KEYS: [&str; 2] = ["full_scale_v", "divider"];

/// Reads a line in one of its two forms: volts and °C, or counts with what a count is.
fn read_linear_input(
    section: &Section<'_>,
    keys: &ThermometerKeys,
) -> Result<LinearInput, InputFileError> {
    let not_zero = |key, value| match section.required(key, value)? {
        0.0 => Err(section.key_error(key, "must not be 0")),
        value => Ok(value),
    };
    let (volts, counts) =
        (section.first_present_key(&VOLTAGE_KEYS), section.first_present_key(&COUNT_KEYS));
    if let (Some(volts), Some(counts)) = (volts, counts) {
        let rule = format!(
            "stands together with {counts}: state the line in volts (zero_v, c_per_v) or in counts (zero_counts, \
             counts_per_c, counts_full_scale), not in both"
        );
        return Err(section.key_error(volts, rule));
    }
    if volts.is_none() && counts.is_none() {
        let rule = "is missing: a linear input needs zero_v and c_per_v, or zero_counts, counts_per_c and \
                    counts_full_scale";
        return Err(section.key_error("zero_v", rule));
    }
    if volts.is_some() {
        let zero_counts = section.required("zero_v", keys.zero_v)?;
        let counts_per_c = 1.0 / not_zero("c_per_v", keys.c_per_v)?;
        let (full_scale_v, divider) = read_full_scale_and_divider(section, keys)?;
        let scale = CountScale::Volt { full_scale_v, divider };
        return Ok(LinearInput { zero_counts, counts_per_c, scale });
    }
    let zero_counts = section.required("zero_counts", keys.zero_counts)?;
    let counts_per_c = not_zero("counts_per_c", keys.counts_per_c)?;
    let scale = if let Some(counts_full_scale) = keys.counts_full_scale {
        let (full_scale_v, divider) = read_full_scale_and_divider(section, keys)?;
        CountScale::Count { counts_full_scale, full_scale_v, divider }
    } else {
        if let Some(key) = section.first_present_key(&SCALE_KEYS) {
            let rule = "needs counts_full_scale: without it a count is a code of the board, 4096 at 3.3 V on the pin";
            return Err(section.key_error(key, rule));
        }
        CountScale::Code
    };
    Ok(LinearInput { zero_counts, counts_per_c, scale })
}

/// Returns the full scale of a linear input in volts, and its divider.
fn read_full_scale_and_divider(
    section: &Section<'_>,
    keys: &ThermometerKeys,
) -> Result<(f64, f64), InputFileError> {
    let full_scale_v = section.required("full_scale_v", keys.full_scale_v)?;
    let divider = section.required("divider", keys.divider)?;
    let key = section.first_present_key(&["divider"]).unwrap_or("full_scale_v");
    reject_full_scale_above_adc_reference(section, key, full_scale_v, divider)?;
    Ok((full_scale_v, divider))
}

/// Refuses a divider that takes the full scale above the reference of the board's converter.
fn reject_full_scale_above_adc_reference(
    section: &Section<'_>,
    key: &str,
    full_scale_v: f64,
    divider: f64,
) -> Result<(), InputFileError> {
    let volts_at_adc = full_scale_v * divider;
    // 10 V · 0.33 is 4·10⁻¹⁶ above 3.3 V in f64 and is meant to be equal.
    if volts_at_adc > ADC_REFERENCE_VOLTS * (1.0 + 1e-9) {
        let rule = format!(
            "{divider} takes {full_scale_v} V to {volts_at_adc:.4} V at the ADC, above its reference of \
             {ADC_REFERENCE_VOLTS} V"
        );
        let rule = if key == "divider" {
            rule
        } else {
            format!("{full_scale_v} is too high: the divider {rule}")
        };
        return Err(section.key_error(key, rule));
    }
    Ok(())
}

pub(crate) fn write(inputs: &BoardInputs) -> NewSection {
    let mut section = NewSection::new("inputs");
    section = add_key(section, &SERVICE_SWITCH_KEY, &inputs.service_switch);
    let mains_hz: u32 = if inputs.mains == MainsFrequency::Hz60 { 60 } else { 50 };
    section = add_key(section, &MAINS_FREQUENCY_KEY, &mains_hz);
    if let Some(sensor) = inputs.sensor {
        section = section.with_value("sensor", to_inline_table(&sensor));
    }
    for (column, input) in &inputs.temperatures {
        section = section.with_value(column, to_inline_table(&to_thermometer_keys(input)));
    }
    for (column, ConditionInput { bit, default }) in &inputs.conditions {
        let condition = ConditionKeys { kind: CONDITION_KIND.into(), bit: *bit, default: *default };
        section = section.with_value(column, to_inline_table(&condition));
    }
    section
}

/// Returns the keys of a temperature input.
fn to_thermometer_keys(input: &TemperatureInput) -> ThermometerKeys {
    let TemperatureInput { channel, kind, max_c_per_min } = *input;
    let pt100 = ThermometerKeys { channel, max_c_per_min, ..ThermometerKeys::default() };
    let TemperatureInputKind::Linear(LinearInput { zero_counts, counts_per_c, scale }) = kind
    else {
        return pt100;
    };
    let line = ThermometerKeys { kind: ThermometerKind::Linear, ..pt100 };
    let (zero, per_c) = (Some(zero_counts), Some(counts_per_c));
    match scale {
        CountScale::Volt { full_scale_v, divider } => ThermometerKeys {
            zero_v: zero,
            c_per_v: Some(1.0 / counts_per_c),
            full_scale_v: Some(full_scale_v),
            divider: Some(divider),
            ..line
        },
        CountScale::Count { counts_full_scale, full_scale_v, divider } => ThermometerKeys {
            zero_counts: zero,
            counts_per_c: per_c,
            counts_full_scale: Some(counts_full_scale),
            full_scale_v: Some(full_scale_v),
            divider: Some(divider),
            ..line
        },
        CountScale::Code => ThermometerKeys { zero_counts: zero, counts_per_c: per_c, ..line },
    }
}
