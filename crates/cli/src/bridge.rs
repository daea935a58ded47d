//! `trueup bridge`: what can be asked of a bridge. How it is spoken to is in `trueup-client`.

pub mod info;
pub mod load;
pub mod monitor;
mod plain;

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};

use crate::Outcome;

#[derive(Subcommand)]
pub enum Command {
    /// Asks the bridge who it is, what it runs on, and how it is.
    ///
    /// Exit 3: it answers, but no heartbeat or no offsets came.
    Info {
        #[command(flatten)]
        port: Port,
    },
    /// Loads a calibration, reads it back, and restarts the board with it.
    ///
    /// Nothing is loaded while offsets are being followed: let the CNC disengage first, and set
    /// Service there. Where no CNC is heard, this says so itself.
    /// Exit 3: it is stored, but the board does not run on it.
    Load {
        /// The calibration, as `compile` writes it.
        #[arg(value_name = "CAL.bin")]
        calibration: PathBuf,
        #[command(flatten)]
        port: Port,
        /// Leave the board running on the calibration it has; the new one is used from its next
        /// start.
        #[arg(long)]
        keep_running: bool,
    },
    /// Shows a bridge live: sensor, growth, offsets by cause, temperatures, faults with what to do.
    ///
    /// On a terminal it is a screen with keys (q quit, r record, g gauge reading, t trend, ? help).
    /// Otherwise it prints a line a second, until Ctrl-C. It only listens and asks: nothing is engaged by it.
    /// Exit 3: frames were damaged or out of order, or (lines) a second passed without offsets.
    Monitor(monitor::Monitor),
}

#[derive(Args)]
pub struct Port {
    /// Where the bridge is: tcp:HOST:PORT, a serial device, or a CAN interface (can0).
    #[arg(long, value_name = "PORT")]
    port: String,
}

/// Asks, loads or listens.
pub fn run(command: &Command, as_json: bool) -> Result<Outcome> {
    match command {
        Command::Info { port } => info::run(&port.port, as_json),
        Command::Load { calibration, port, keep_running } => {
            load::run(calibration, &port.port, *keep_running, as_json)
        }
        Command::Monitor(args) => monitor::run(args, as_json),
    }
}
