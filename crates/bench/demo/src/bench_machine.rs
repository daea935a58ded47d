//! A machine file as the bench needs it: an input for each thermometer, limits that do not bind, and,
//! where a shift of hours is played in minutes, time constants that are as much shorter.

use std::path::Path;

use anyhow::{Context as _, Result};
use toml_edit::{DocumentMut, InlineTable, Item, Table, TableLike, value};
use trueup_core::temperature_rate;
use trueup_machine::{Machine, MachineFile, RunFile, machine_file::is_temperature_column};

/// Rows follow each other on the bench much faster than a machine warms: the slew limit is
/// the largest that a board takes.
const MAX_SLEW_UM_PER_S: f64 = 10_000.0;
/// The largest that a board takes.
const MAX_OFFSET_UM: f64 = 4_000.0;
/// The rate of a thermometer that the board believes where the file states none, in K/min.
const DEFAULT_MAX_TEMPERATURE_RATE_C_PER_MIN: f64 =
    temperature_rate::DEFAULT_RATE_DECIKELVIN_PER_MIN as f64 / 10.0;
/// The largest rate that a file may state, in K/min.
const MAX_TEMPERATURE_RATE_C_PER_MIN: f64 =
    temperature_rate::MAX_RATE_DECIKELVIN_PER_MIN as f64 / 10.0;
/// The board has this many temperature channels.
const TEMPERATURE_CHANNEL_COUNT: i64 = 8;

/// Returns the machine file `source` with all inputs that the board needs to be played `run`: a sensor where
/// there is none, and a free channel for each thermometer that has none. With a sentence on each.
///
/// # Errors
/// `source` is no TOML.
pub fn add_missing_inputs(source: &str, run: &RunFile) -> Result<(String, Vec<String>)> {
    let mut document: DocumentMut = source.parse().context("the machine file is no TOML")?;
    let mut notes = Vec::new();
    let inputs = document.entry("inputs").or_insert(Item::Table(Table::new()));
    let inputs = inputs.as_table_like_mut().context("[inputs] is no table")?;
    if inputs.get("sensor").is_none() && run.column("sensor_counts").is_some() {
        let mut sensor = InlineTable::new();
        sensor.insert("volts_full_scale", 10.0.into());
        sensor.insert("counts_full_scale", 32768.into());
        sensor.insert("divider", 0.328.into());
        inputs.insert("sensor", value(sensor));
        notes.push("For the bench the sensor gives 10 V at 32768 counts.".into());
    }
    let used: Vec<i64> = inputs.iter().filter_map(|(_, item)| channel_number(item)).collect();
    let mut free = (0..TEMPERATURE_CHANNEL_COUNT).filter(|channel| !used.contains(channel));
    let names = run.columns().iter().map(|column| column.name.as_str());
    for name in names.filter(|name| is_temperature_column(name)) {
        if inputs.get(name).is_some() {
            continue;
        }
        let Some(channel) = free.next() else {
            notes.push(format!(
                "{name} is not connected: the board has {TEMPERATURE_CHANNEL_COUNT} channels."
            ));
            continue;
        };
        let mut input = InlineTable::new();
        input.insert("channel", channel.into());
        input.insert("kind", "pt100".into());
        inputs.insert(name, value(input));
        notes.push(format!("For the bench {name} is a PT100 on channel {channel}."));
    }
    Ok((document.to_string(), notes))
}

fn channel_number(item: &Item) -> Option<i64> {
    item.as_table_like()?.get("channel")?.as_integer()
}

/// Returns the machine of `source` on the bench, where time passes `faster` times as fast as on the board.
///
/// # Errors
/// `source` is no machine file.
pub fn build_bench_machine(source: &str, faster: f64) -> Result<Machine> {
    let mut document: DocumentMut = source.parse().context("the machine file is no TOML")?;
    shorten_times(document.as_table_mut(), faster);
    let mut machine = MachineFile::parse(&document.to_string(), Path::new("machine.toml"))?;
    machine.limits.slew_um_per_s = MAX_SLEW_UM_PER_S;
    machine.limits.max_um = [MAX_OFFSET_UM; 3];
    // What warms in an hour is played in seconds.
    let inputs = machine.inputs.iter_mut().flat_map(|inputs| inputs.temperatures.values_mut());
    for input in inputs {
        let c_per_min = input.max_c_per_min.unwrap_or(DEFAULT_MAX_TEMPERATURE_RATE_C_PER_MIN);
        input.max_c_per_min = Some(
            (faster * c_per_min)
                .clamp(DEFAULT_MAX_TEMPERATURE_RATE_C_PER_MIN, MAX_TEMPERATURE_RATE_C_PER_MIN),
        );
    }
    Ok(machine)
}

/// Divides every time in seconds (`…_s`, but no `…_per_s`) outside the limits, which are the board's own.
fn shorten_times(table: &mut dyn TableLike, faster: f64) {
    for (key, item) in table.iter_mut() {
        let is_time = key.ends_with("_s") && !key.ends_with("_per_s");
        let number = item.as_float().or_else(|| item.as_integer().map(|whole| whole as f64));
        if let (true, Some(seconds)) = (is_time, number) {
            *item = value(seconds / faster);
        } else if key != "limits" {
            if let Some(inner) = item.as_table_like_mut() {
                shorten_times(inner, faster);
            } else if let Some(all) = item.as_array_of_tables_mut() {
                all.iter_mut().for_each(|inner| shorten_times(inner, faster));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(header: &str) -> RunFile {
        let columns = header.split(',').count();
        let text = format!("{header}\n{}\n", vec!["1"; columns].join(","));
        RunFile::from_reader(text.as_bytes(), Path::new("run.csv")).expect("a run file")
    }

    const SOURCE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n\
        [inputs]\ntemp_bed_c = { channel = 0, kind = \"pt100\" }\n\
        [spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 60.0\nwarm_s = 4000\nmax_um = 80.0\n\
        exponent = 4.0\n[limits]\nslew_um_per_s = 20.0\n\
        [[term]]\ncause = \"slow-mode\"\nquantity = \"elongation\"\namplitude_um = 9.0\n\
        time_constant_s = 500.0\n";

    #[test]
    fn what_is_not_connected_gets_a_channel_that_is_free_and_it_is_told() {
        let (text, notes) = add_missing_inputs(SOURCE, &run("temp_bed_c,temp_air_c,sensor_counts"))
            .expect("a machine file");
        let machine = build_bench_machine(&text, 1.0).expect("a machine file");
        let inputs = machine.inputs.expect("connected");
        assert_eq!(inputs.temperatures["temp_bed_c"].channel, 0);
        assert_eq!(inputs.temperatures["temp_air_c"].channel, 1);
        assert!(inputs.sensor.is_some());
        assert_eq!(notes.len(), 2, "{notes:?}");
    }

    #[test]
    fn times_of_the_machine_are_shortened_and_nothing_else_is() {
        let machine = build_bench_machine(SOURCE, 100.0).expect("a machine file");
        let warmup = machine.spindle.warmup.expect("given");
        assert_eq!([warmup.lag_s, warmup.warm_s], [0.6, 40.0]);
        assert_eq!([warmup.max_um, warmup.exponent], [80.0, 4.0]);
        let term = machine.terms[0].effect.entries();
        let times: Vec<String> =
            term.iter().map(|(key, value)| format!("{key} {value:?}")).collect();
        assert!(
            times.iter().any(|text| text.contains("time_constant_s") && text.contains("5.0")),
            "{times:?}"
        );
        assert_eq!(machine.limits.link_timeout_ms, 500);
    }
}
