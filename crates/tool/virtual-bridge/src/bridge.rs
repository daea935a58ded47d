//! A machine file and a run or a plant, made into a bridge that any client can talk to.

use std::{
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
};

use anyhow::{Result, bail};
use clap::Args;
use trueup_machine::{Machine, RunFile, compile};

use crate::{
    analogue_front_end::AnalogueFrontEnd,
    gauge::SimulatedGauge,
    operator_controls::OperatorControls,
    plant::Plant,
    replay::{DEFAULT_ROW_DURATION_S, GAUGE_COLUMN, RunReplay},
    serve::{self, OperatorStation, SampleSource},
};

/// Options that both commands have next to the machine file.
#[derive(Args)]
pub struct BridgeOptions {
    /// Where the bridge listens for the CNC (SLCAN); port 0 is any free one.
    #[arg(long, value_name = "tcp:HOST:PORT", default_value = "tcp:127.0.0.1:3333")]
    cnc: String,
    /// The run file to replay, from the moment a client opens the channel; its last row is held.
    #[arg(long, value_name = "R.csv", conflicts_with = "plant", required_unless_present = "plant")]
    run: Option<PathBuf>,
    /// Board time in multiples of real time, or "max".
    #[arg(long, value_name = "N", default_value = "1", value_parser = parse_speed)]
    speed: PlaybackSpeed,
    /// Seconds that a row lasts in a run file without time_s.
    #[arg(long, value_name = "S", default_value_t = DEFAULT_ROW_DURATION_S)]
    row_s: f64,
    /// Where a plant listens that plays the machine, in JSON lines.
    #[arg(long, value_name = "tcp:HOST:PORT")]
    plant: Option<String>,
    /// With a gauge at the tool, a value a line in µm. It is measured_elongation_um of the run,
    /// less what the CNC has taken away by the offsets. `bridge monitor --indicator` reads it.
    #[arg(long, value_name = "tcp:HOST:PORT", conflicts_with = "plant")]
    gauge: Option<String>,
    /// Seed of the front end's noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Multiples of real time; `None`: as fast as it goes.
#[derive(Clone, Copy)]
struct PlaybackSpeed(Option<f64>);

fn parse_speed(text: &str) -> Result<PlaybackSpeed, String> {
    match (text, text.parse::<f64>()) {
        ("max", _) => Ok(PlaybackSpeed(None)),
        (_, Ok(speed)) if speed > 0.0 && speed.is_finite() => Ok(PlaybackSpeed(Some(speed))),
        _ => Err("a speed is a number above 0, or \"max\"".into()),
    }
}

/// Runs the bridge until `stop` is set or the plant leaves. `image` gives the firmware for QEMU; it is
/// asked for last, because it may have to be built.
///
/// # Errors
/// The machine file or the run cannot be used, the port is in use, no run or plant is given, the plant does not listen,
/// or QEMU ends.
pub fn run(
    machine: &Machine,
    options: &BridgeOptions,
    image: impl FnOnce() -> Result<PathBuf>,
    stop: Arc<AtomicBool>,
) -> Result<()> {
    let compiled = compile(machine)?;
    let inputs = machine.inputs.as_ref();
    // A plant is connected to when all else is ready: it waits for its first answer from then on.
    let played = match (&options.run, &options.plant) {
        (Some(path), _) => {
            let run = RunFile::read(path)?.with_tool_numbers(machine)?;
            let names = run.columns().iter().map(|column| column.name.as_str());
            let unused = names
                .filter(|name| !RunReplay::uses_column(machine, name) && *name != GAUGE_COLUMN);
            let unused: Vec<_> = unused.collect();
            if !unused.is_empty() {
                let unused = unused.join(", ");
                trueup_output::write_diagnostic(format_args!(
                    "not replayed, this machine has no input for them: {unused}"
                ));
            }
            if options.gauge.is_some() && run.column(GAUGE_COLUMN).is_none() {
                bail!("{}: has no {GAUGE_COLUMN} that a gauge could show", path.display());
            }
            let replay = RunReplay::new(&run, machine, options.row_s)?;
            Ok(SampleSource::Run { replay, speed: options.speed.0 })
        }
        (None, Some(address)) => Err(address),
        (None, None) => bail!("either --run or --plant"),
    };
    let listener = serve::listen(&options.cnc)?;
    let image = image()?;
    let source = match played {
        Ok(run) => run,
        Err(address) => {
            let temperatures = inputs.map(|inputs| inputs.temperatures.clone());
            let address = serve::parse_tcp_address(address)?;
            SampleSource::Plant(Plant::connect(address, temperatures.unwrap_or_default())?)
        }
    };
    // Port 0 asks for any free one, so this is what was got, not what was requested.
    trueup_output::write_diagnostic(format_args!(
        "the CNC's line is at tcp:{} (SLCAN)",
        listener.local_addr()?
    ));
    let divider =
        inputs.and_then(|inputs| inputs.sensor.as_ref()).map_or(0.0, |sensor| sensor.divider);
    let front_end = AnalogueFrontEnd::new(divider, options.seed);
    let gauge = SimulatedGauge::new(machine);
    if let Some(address) = &options.gauge {
        gauge.listen(serve::parse_tcp_address(address)?)?;
    }
    let hand = OperatorControls::from_stdin(gauge.clone());
    let at_machine = OperatorStation { hand, gauge };
    serve::serve(&image, compiled.blob(), front_end, listener, source, &at_machine, stop)
}
