//! The virtual bridge of `trueup virtual` and `cargo virtual`: a machine file and a run or a plant, made
//! into a bridge that any client can talk to.

use std::{
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
};

use anyhow::Result;
use trueup_machine::{Machine, RunFile, compile};

use crate::{
    front_end::FrontEnd,
    plant::Plant,
    replay::Replay,
    serve::{self, SampleSource},
};

/// Who plays the machine.
pub enum Played {
    /// A run file.
    Run {
        /// The run file.
        run: RunFile,
        /// Seconds that a row lasts where there is no `time_s`, above 0.
        row_s: f64,
        /// Board time in multiples of real time; `None`: as fast as it goes.
        speed: Option<f64>,
    },
    /// A plant, another program.
    Plant {
        /// Where it listens: `tcp:HOST:PORT`.
        address: String,
    },
}

/// What is asked for beside the machine.
pub struct Settings {
    /// Where the bridge listens for the CNC: `tcp:HOST:PORT`; port 0 is any free one.
    pub cnc: String,
    /// Who plays the machine.
    pub played: Played,
    /// Seed of the front end's noise.
    pub seed: u64,
}

/// Runs the bridge until `stop` is set or the plant leaves. `image` gives the firmware for QEMU; it is
/// asked for last, because it may have to be built.
///
/// # Errors
/// The machine file or the run cannot be used, the port is in use, nobody plays, or QEMU ends.
pub fn run(
    machine: &Machine,
    settings: Settings,
    image: impl FnOnce() -> Result<PathBuf>,
    stop: Arc<AtomicBool>,
) -> Result<()> {
    let compiled = compile(machine)?;
    let inputs = machine.inputs.as_ref();
    // A plant is connected to when all else is ready: it waits for its first answer from then on.
    let played = match settings.played {
        Played::Plant { address } => Err(address),
        Played::Run { run, row_s, speed } => {
            let names = run.columns().iter().map(|column| column.name.as_str());
            let unused: Vec<_> = names.filter(|name| !Replay::uses(machine, name)).collect();
            if !unused.is_empty() {
                let unused = unused.join(", ");
                eprintln!("not replayed, this machine has no input for them: {unused}");
            }
            Ok(SampleSource::Run { replay: Replay::new(&run, machine, row_s)?, speed })
        }
    };
    let listener = serve::listen(&settings.cnc)?;
    let image = image()?;
    let source = match played {
        Ok(run) => run,
        Err(address) => {
            let temperatures = inputs.map(|inputs| inputs.temperatures.clone());
            let address = serve::tcp_address(&address)?;
            SampleSource::Plant(Plant::connect(address, temperatures.unwrap_or_default())?)
        }
    };
    // Port 0 asks for any free one, so this is what was got, not what was asked for.
    eprintln!("the CNC's line is at tcp:{} (SLCAN)", listener.local_addr()?);
    let divider = inputs.and_then(|inputs| inputs.sensor.as_ref()).map_or(0.0, |it| it.divider);
    let front_end = FrontEnd::new(divider, settings.seed);
    serve::serve(&image, compiled.blob(), front_end, listener, source, stop)
}
