//! The thermometers and the sensor, as they are connected.

use std::collections::BTreeMap;

use trueup_core::{
    calibration::{InputSettings, MainsFrequency},
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    temperature_rate::MAX_RATE_DECIKELVIN_PER_MIN,
    term::{ConditionLevels, Effect, Term, Terms},
    thermometer::Thermometer,
};

use crate::{
    effect::BoardTerm,
    inputs::{
        BoardInputs, ConditionInput, CountScale, LinearInput, MAX_TEMPERATURE_CHANNEL, SensorInput,
        TemperatureInput, TemperatureInputKind,
    },
    keys::reader::is_temperature_column,
    location::InputFileError,
    machine_file::Machine,
    model::required_columns,
    unit_conversion::{
        TEMPERATURE_UNITS_PER_KELVIN, round_to_i32, shortest_decimal, to_user_value,
    },
};

/// The board stores a rate in tenths of a kelvin a minute.
const RATE_UNITS_PER_KELVIN_PER_MIN: f64 = 10.0;

/// A linear chain delivers this many parts of a count.
const SUBCOUNTS_PER_COUNT: f64 = 256.0;

/// The inputs of a machine that comes from a calibration: one count is one ADC code, exactly.
pub(crate) const DECOMPILED_SENSOR_INPUT: SensorInput =
    SensorInput { volts_full_scale: 10.0, counts_full_scale: 4096.0, divider: 0.33 };

/// Returns the channel of a temperature column that the section `key` uses.
pub(super) fn find_channel(
    machine: &Machine,
    key: &str,
    column: &str,
) -> Result<u8, InputFileError> {
    let input = machine.inputs.as_ref().and_then(|inputs| inputs.temperatures.get(column));
    input.map(|input| input.channel).ok_or_else(|| {
        let rule = format!(
            "is \"{column}\", which [inputs] does not describe: the board must know its channel"
        );
        machine.places.key_error(&format!("{key}.sensor"), rule)
    })
}

/// Returns the lines of `[inputs]` that a board needs next to those of `machine` for the temperatures of its laws and
/// terms; each gets the first channel that is free. Nothing where none is missing.
///
/// The kind of thermometer is not known here: a PT100 is written, the usual one.
#[must_use]
pub fn missing_input_lines(machine: &Machine) -> Vec<String> {
    let connected = machine.inputs.as_ref().map(|inputs| &inputs.temperatures);
    let is_missing = |name: &String| {
        is_temperature_column(name) && connected.is_none_or(|there| !there.contains_key(name))
    };
    let is_free = |channel: &u8| {
        connected.is_none_or(|there| there.values().all(|input| input.channel != *channel))
    };
    let mut free = (0..=MAX_TEMPERATURE_CHANNEL).filter(is_free);
    let line = |name: String| match free.next() {
        Some(channel) => format!("{name} = {{ channel = {channel}, kind = \"pt100\" }}"),
        None => format!("# {name}: no channel is free"),
    };
    let missing =
        required_columns(&machine.with_only_compensated_terms()).into_iter().filter(is_missing);
    let mut lines: Vec<String> = missing.map(line).collect();
    lines.extend(missing_condition_lines(machine));
    if !lines.is_empty() && machine.inputs.is_none() {
        lines.insert(0, "[inputs]".into());
    }
    lines
}

/// Returns the lines for the conditions of its terms, each with a bit of its own.
fn missing_condition_lines(machine: &Machine) -> Vec<String> {
    let mut inputs = machine.inputs.clone().unwrap_or_default();
    let mut lines = Vec::new();
    for column in board_condition_columns(machine) {
        if !inputs.conditions.contains_key(&column) {
            let line = condition_input_line(Some(&inputs), &column);
            lines.push(line);
            let bit = first_free_condition_bit(&inputs);
            inputs
                .conditions
                .extend(bit.map(|bit| (column, ConditionInput { bit, default: false })));
        }
    }
    lines
}

/// Returns the line of `[inputs]` for a condition, with the first bit that is free.
pub(super) fn condition_input_line(inputs: Option<&BoardInputs>, column: &str) -> String {
    match inputs.map_or(Some(0), first_free_condition_bit) {
        Some(bit) => format!("{column} = {{ kind = \"condition\", bit = {bit} }}"),
        None => format!("# {column}: no bit is free"),
    }
}

/// A calibration holds bits, not the names of columns.
pub(super) fn condition_column_name(bit: u8) -> String {
    format!("condition_{bit}")
}

/// Returns the first bit that no condition has.
pub(crate) fn first_free_condition_bit(inputs: &BoardInputs) -> Option<u8> {
    let taken = |bit: &u8| inputs.conditions.values().any(|condition| condition.bit == *bit);
    (0..trueup_core::design_parameters::CONDITION_COUNT).find(|bit| !taken(bit))
}

/// Returns the columns of the conditions that the board follows.
pub(crate) fn board_condition_columns(machine: &Machine) -> Vec<String> {
    let forms = machine.terms.iter().flat_map(|term| term.effect.board_terms());
    let mut columns: Vec<String> = forms
        .filter_map(|form| match form {
            BoardTerm::Condition { column, .. } => Some(column),
            _ => None,
        })
        .collect();
    columns.sort_unstable();
    columns.dedup();
    columns
}

pub(super) fn compile_thermometers(
    machine: &Machine,
) -> Result<[Option<Thermometer>; TEMPERATURE_CHANNEL_COUNT], InputFileError> {
    let mut thermometers = [None; TEMPERATURE_CHANNEL_COUNT];
    for (name, input) in machine.inputs.iter().flat_map(|inputs| &inputs.temperatures) {
        let key = format!("inputs.{name}");
        let thermometer = match input.kind {
            TemperatureInputKind::Pt100 => Some(Thermometer::Pt100),
            TemperatureInputKind::Linear(line) => {
                let (zero_codes, codes_per_c) = line.linear_coefficients_in_codes();
                compile_linear_thermometer(zero_codes, codes_per_c)
            }
        };
        let Some(thermometer) = thermometer else {
            let rule = "exceeds the range of the board. One °C must be from 0.01 to 10000 codes \
                either way, 0 °C within ±8388607 codes. A code is 2.46 mV at an input with the \
                divider 0.328";
            return Err(machine.places.key_error(&key, rule));
        };
        let place = thermometers.get_mut(usize::from(input.channel));
        *place.ok_or_else(|| {
            machine.places.key_error(&format!("{key}.channel"), "must be from 0 to 7")
        })? = Some(thermometer);
    }
    Ok(thermometers)
}

/// Returns the fastest changes of the channels, in tenths of a kelvin a minute.
pub(super) fn compile_input_settings(machine: &Machine) -> Result<InputSettings, InputFileError> {
    let inputs = machine.inputs.as_ref();
    let service_switch = inputs.is_some_and(|inputs| inputs.service_switch);
    let mains = inputs.map(|inputs| inputs.mains).unwrap_or_default();
    let mut guards = InputSettings { service_switch, mains, ..InputSettings::default() };
    for (name, input) in machine.inputs.iter().flat_map(|inputs| &inputs.temperatures) {
        let Some(rate) = input.max_c_per_min else { continue };
        let tenths = round_to_i32(rate * RATE_UNITS_PER_KELVIN_PER_MIN)
            .and_then(|tenths| u16::try_from(tenths).ok());
        let tenths = tenths
            .filter(|tenths| (1..=MAX_RATE_DECIKELVIN_PER_MIN).contains(tenths))
            .ok_or_else(|| {
                let rule = format!("{rate} K/min is not within 0.1 to 600");
                machine.places.key_error(&format!("inputs.{name}.max_c_per_min"), rule)
            })?;
        if let Some(place) = guards.max_rates.get_mut(usize::from(input.channel)) {
            *place = tenths;
        }
    }
    Ok(guards)
}

/// Counts are delivered in 1/256; the slope has as many binary places as fit. `None` outside the
/// range that the rule names: what would still fit beyond it is a slip of the pen.
pub(super) fn compile_linear_thermometer(
    zero_counts: f64,
    counts_per_c: f64,
) -> Option<Thermometer> {
    if !(0.01..=10_000.0).contains(&counts_per_c.abs()) {
        return None;
    }
    let units = TEMPERATURE_UNITS_PER_KELVIN / (counts_per_c * SUBCOUNTS_PER_COUNT);
    let slope_at = |shift: u8| round_to_i32(units * 2_f64.powi(shift.into()));
    let shift =
        (0..=Thermometer::MAX_SLOPE_SHIFT).rev().find(|&shift| slope_at(shift).is_some())?;
    let slope = slope_at(shift)?;
    let zero = round_to_i32(zero_counts * SUBCOUNTS_PER_COUNT)?;
    Some(Thermometer::Linear { zero, slope, shift })
}

/// Returns the inputs that a calibration knows; `None` where nothing is connected.
pub(super) fn decompile(
    has_sensor: bool,
    thermometers: &[Option<Thermometer>; TEMPERATURE_CHANNEL_COUNT],
    guards: &InputSettings,
    terms: &Terms<'_>,
) -> Option<BoardInputs> {
    let of_term = |term: &Term<'_>| match term.effect {
        Effect::Condition(ConditionLevels { bit, default, .. }) => {
            Some((condition_column_name(bit), ConditionInput { bit, default }))
        }
        _ => None,
    };
    let conditions: BTreeMap<_, _> = terms.iter().flatten().filter_map(of_term).collect();
    let mut temperatures = BTreeMap::new();
    for ((channel, &thermometer), &tenths) in (0..).zip(thermometers).zip(&guards.max_rates) {
        let kind = match thermometer {
            None => continue,
            Some(Thermometer::Pt100) => TemperatureInputKind::Pt100,
            Some(Thermometer::Linear { zero, slope, shift }) => {
                TemperatureInputKind::Linear(LinearInput {
                    zero_counts: to_user_value(zero, SUBCOUNTS_PER_COUNT),
                    counts_per_c: decompile_counts_per_c(slope, shift),
                    scale: CountScale::Code,
                })
            }
        };
        let max_c_per_min = (tenths > 0).then(|| f64::from(tenths) / RATE_UNITS_PER_KELVIN_PER_MIN);
        temperatures.insert(
            temperature_column_name(channel),
            TemperatureInput { channel, kind, max_c_per_min },
        );
    }
    let sensor = has_sensor.then_some(DECOMPILED_SENSOR_INPUT);
    let (service_switch, mains) = (guards.service_switch, guards.mains);
    let is_connected = has_sensor || !temperatures.is_empty() || service_switch;
    let is_connected = is_connected || mains != MainsFrequency::default();
    let is_connected = is_connected || !conditions.is_empty();
    is_connected.then_some(BoardInputs { sensor, temperatures, conditions, service_switch, mains })
}

/// A calibration holds channels, not the names of columns.
pub(super) fn temperature_column_name(channel: u8) -> String {
    format!("temp_ch{channel}_c")
}

fn decompile_counts_per_c(slope: i32, shift: u8) -> f64 {
    // slope = this / (counts per °C)
    let reciprocal = TEMPERATURE_UNITS_PER_KELVIN / SUBCOUNTS_PER_COUNT * 2_f64.powi(shift.into());
    let slope = f64::from(slope);
    let same = |counts: f64| (reciprocal / counts - slope).abs() < 0.49;
    shortest_decimal(reciprocal / slope, same)
}
