//! `trueup bridge`: the requests to a bridge. The protocol is in `trueup-client`.

pub mod backup;
mod bridge_identity;
mod disengage;
mod forget_reference;
pub mod info;
pub mod load;
pub mod monitor;
mod operator_questions;
mod pending;
mod text_monitor;
mod update;

use anyhow::Result;
use clap::{Args, Subcommand};
use trueup_client::{port::PortAddress, session::Session};

use crate::CommandOutcome;

#[derive(Subcommand)]
pub enum Command {
    /// Reads the identity, firmware, calibration and state of the bridge.
    ///
    /// Exit 3: it answers, but no heartbeat or no offsets came, or it does not run what --machine makes.
    Info(info::InfoArgs),
    /// Lists the ports of this computer behind which a bridge may be; nothing is sent to them.
    List,
    /// Loads a calibration: prints what it changes, asks for confirmation, reads it back, and restarts the board with it.
    ///
    /// With --previous it loads the calibration that the last load from this computer has replaced.
    /// Nothing is loaded while offsets are being followed: let the CNC disengage first, and set
    /// Service there. Where no CNC sends, this sets Service itself.
    /// A calibration that is loaded starts without a reference. If the board has an older one for it, it offers
    /// that one. Each question of the bridge is answered at the CNC, by Confirm.
    /// Exit 3: it is stored, but the board does not run on it, or belongs to another machine.
    Load(load::LoadArgs),
    /// Updates the firmware of a board with two slots: shows what runs and what goes where, asks for confirmation, sends it, and restarts the board.
    ///
    /// The new firmware goes to the slot that does not run, and starts on trial: engage and let it give offsets for a
    /// minute. Until then a crash or a hang goes back to the old one. Nothing is sent while offsets are being followed:
    /// let the CNC disengage first, and set Service there. Where no CNC sends, this sets Service itself.
    /// If it is interrupted, the same command goes on behind the bytes that the board has.
    /// Exit 3: it is on the board, but the old firmware runs.
    Update(update::UpdateArgs),
    /// Takes the offsets back to 0 at the slew limit, where no CNC commands the bridge.
    ///
    /// Where a CNC does, nothing is sent: the offset is its own, and only it knows whether it cuts. Disengage there.
    /// Exit 3: a CNC commands the bridge, or the offset does not go to 0.
    Disengage(disengage::DisengageArgs),
    /// Shows the calibration that waits for the next start; puts it to use or drops it.
    ///
    /// Exit 3 (--use): the board does not run on it, or belongs to another machine.
    Pending(pending::PendingArgs),
    /// Declines the reference that is offered, or drops the one in force, and what was learned.
    ForgetReference(forget_reference::ForgetReferenceArgs),
    /// Writes all that a board holds to a file, so that a dead board is replaced by another one.
    ///
    /// It asks for confirmation before it replaces another machine's backup.
    Save(backup::SaveArgs),
    /// Loads what `save` has kept into a board, as `load` does, and offers it the reference that Zero took.
    ///
    /// The operator takes the reference by Confirm at the CNC.
    /// Exit 3: it is stored, but the board does not run on it, is another machine's, or was not offered the reference.
    Restore(backup::RestoreArgs),
    /// Shows a bridge live: sensor, growth, offsets by cause, temperatures, faults with what to do.
    ///
    /// On a terminal it is a screen with keys (q quit, r record, g gauge reading, t trend, ? help).
    /// Otherwise it prints a line a second, until Ctrl-C. It only reads; it engages nothing.
    /// Exit 3: frames were damaged or out of order, or (lines) a second passed without offsets.
    Monitor(monitor::MonitorArgs),
}

#[derive(Args)]
pub struct PortArgs {
    /// Where the bridge is: tcp:HOST:PORT, a serial device, or a CAN interface (can0).
    #[arg(long, value_name = "PORT")]
    port: String,
}

impl PortArgs {
    /// Returns the result of `work` on an open session, which is then closed.
    fn with_session<T>(&self, work: impl FnOnce(&mut Session) -> Result<T>) -> Result<T> {
        with_session(&PortAddress::parse(&self.port)?, work)
    }
}

/// Returns the result of `work` on a session at a port, which is then closed.
pub fn with_session<T>(
    port: &PortAddress,
    work: impl FnOnce(&mut Session) -> Result<T>,
) -> Result<T> {
    let mut session = Session::open(port)?;
    let result = work(&mut session);
    session.close();
    result
}

/// Reads, loads, stores or listens.
pub fn run(command: &Command, as_json: bool) -> Result<CommandOutcome> {
    match command {
        Command::Info(args) => info::run(args, as_json),
        Command::List => {
            let ports = trueup_client::port_discovery::list_ports();
            if as_json {
                crate::output::print(crate::doctor::ports_json(&ports))?;
            } else {
                crate::doctor::print_ports(&ports)?;
            }
            Ok(CommandOutcome::Done)
        }
        Command::Load(args) => load::run(args, as_json),
        Command::Update(args) => update::run(args, as_json),
        Command::Disengage(args) => disengage::run(args, as_json),
        Command::Pending(args) => pending::run(args, as_json),
        Command::ForgetReference(args) => forget_reference::run(args, as_json),
        Command::Save(args) => backup::run_save(args, as_json),
        Command::Restore(args) => backup::run_restore(args, as_json),
        Command::Monitor(args) => monitor::run(args, as_json),
    }
}
