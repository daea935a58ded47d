//! `trueup bridge monitor`: the live screen on a terminal, lines everywhere else.

use std::{
    io::{IsTerminal as _, stdin},
    path::PathBuf,
    time::Duration,
};

use anyhow::Result;
use clap::Args;
use trueup_machine::machine_file::Quantity;
use trueup_screen::{
    event_loop,
    indicator::{IndicatorConfig, IndicatorUnit},
};

use super::{PortArgs, bridge_identity, text_monitor};
use crate::{
    CommandOutcome,
    choice::{by_name, named},
};

/// Seconds until a picture is drawn, without --count.
const DEFAULT_SNAPSHOT_DELAY_S: u64 = 5;

#[derive(Args)]
pub struct MonitorArgs {
    #[command(flatten)]
    port: PortArgs,
    /// The machine file: shares of the causes, volts, names of temperatures. Without it the screen reads
    /// the board's own calibration.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
    /// Write every frame down, as `candump -l` does, and a run file for `diagnose`: to `FILE.log` and
    /// `FILE.csv`, or to `bridge.log` and `bridge.csv` in a folder.
    #[arg(long, value_name = "DIR|FILE.log")]
    record: Option<PathBuf>,
    /// Record nothing of a bridge that runs on another calibration than the machine file makes: exit 2.
    #[arg(long, requires = "machine", requires = "record")]
    strict: bool,
    /// The quantity that the gauge measures: the growth of the tool, or the error of an axis.
    #[arg(long, value_name = "QUANTITY", default_value = "elongation", value_parser = by_name(Quantity::ALL, Quantity::name))]
    gauge: Quantity,
    /// A gauge that sends its readings: a serial device or tcp:HOST:PORT; Mitutoyo Digimatic
    /// (01A+00012.345) or a value a line.
    #[arg(long, value_name = "PORT", requires = "indicator_unit")]
    indicator: Option<String>,
    /// The unit of its values.
    #[arg(long, value_name = "UNIT", value_parser = named(INDICATOR_UNITS))]
    indicator_unit: Option<IndicatorUnit>,
    /// Its speed on a serial line, in Bd.
    #[arg(long, value_name = "BD", default_value_t = 9_600)]
    indicator_baud: u32,
    /// Watch for as many seconds as --count says (5), and write the screen as a picture (SVG).
    #[arg(long, value_name = "FILE.svg", conflicts_with_all = ["plain", "record"])]
    picture: Option<PathBuf>,
    /// Lines even on a terminal.
    #[arg(long)]
    plain: bool,
    /// Lines, and stop after this many.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
}

const INDICATOR_UNITS: [(IndicatorUnit, &str); 3] = [
    (IndicatorUnit::Millimetre, "mm"),
    (IndicatorUnit::Micrometre, "um"),
    (IndicatorUnit::Inch, "inch"),
];

/// Shows the bridge, or prints a line a second.
pub fn run(args: &MonitorArgs, as_json: bool) -> Result<CommandOutcome> {
    let is_screen = trueup_output::is_stdout_terminal() && stdin().is_terminal();
    let is_picture = args.picture.is_some();
    if !is_picture && (as_json || args.plain || args.count.is_some() || !is_screen) {
        let record = args.record.as_deref().map(|record| (record, args.machine.as_deref()));
        return text_monitor::run(&args.port.port, args.count, record, args.strict, as_json);
    }
    let unit = args.indicator_unit.unwrap_or(IndicatorUnit::Millimetre);
    let is_sound = event_loop::run(event_loop::ScreenOptions {
        port: args.port.port.clone(),
        tool: bridge_identity::tool_build_version(),
        machine: args.machine.clone(),
        record: args.record.clone(),
        is_strict: args.strict,
        quantity: args.gauge,
        indicator: args.indicator.clone().map(|port| IndicatorConfig {
            port,
            baud: args.indicator_baud,
            unit,
        }),
        picture: args.picture.clone().map(|path| {
            (path, Duration::from_secs(args.count.unwrap_or(DEFAULT_SNAPSHOT_DELAY_S)))
        }),
    })?;
    Ok(if is_sound { CommandOutcome::Done } else { CommandOutcome::NotMet })
}
