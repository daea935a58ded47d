//! The content of a board before the sign test: saved to a file, and put back after it, whatever becomes of the test.
//!
//! The test's calibration gives 10 µm whatever the machine does. A board that corrects a machine must not be left with
//! it, so what it held is saved first; if it corrects something else than the machine file says, or has a reference,
//! the user must confirm. A board of another machine is left alone.

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result, bail};
use trueup_client::{
    port::PortAddress, reference::BridgeReference, saved_board::BoardIdentity, sdo_object,
    session::Session,
};
use trueup_link::status::StateBits;
use trueup_machine::compile;

use super::CommissioningSession;
use crate::{UserError, bridge::with_session};

/// The user wants it to end.
static IS_INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// The user has ended it.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

/// Ctrl-C ends a step where nothing is lost, and not the program.
pub fn install_interrupt_handler() -> Result<()> {
    ctrlc::set_handler(|| IS_INTERRUPTED.store(true, Ordering::Relaxed))
        .context("Ctrl-C cannot be caught")
}

/// Fails once the user has pressed Ctrl-C.
pub fn check_interrupt() -> Result<()> {
    match IS_INTERRUPTED.load(Ordering::Relaxed) {
        true => Err(Interrupted.into()),
        false => Ok(()),
    }
}

/// The state to put back.
pub enum BoardBackup {
    /// The board has corrected nothing.
    Nothing,
    /// The content of this file.
    Saved(String),
}

/// The owner and the content of a board.
struct BoardContent {
    /// The CRC of its calibration; 0: it has none, or an example's.
    crc: u32,
    owner: BoardIdentity,
    reference: BridgeReference,
    has_learned: bool,
}

impl BoardContent {
    fn read_from_port(port: &str) -> Result<Self> {
        with_session(&PortAddress::parse(port)?, Self::read)
    }

    fn read(session: &mut Session) -> Result<Self> {
        let state = StateBits(sdo_object::read_number(session, sdo_object::STATE_BITS)?);
        let crc = sdo_object::read_number(session, sdo_object::RUNNING_CRC)?;
        let is_example = state.contains(StateBits::EXAMPLE_CONSTANTS);
        let mut has_learned = false;
        for at in sdo_object::LEARNED_VALUES {
            has_learned |= sdo_object::read_number(session, at).unwrap_or_default() != 0;
        }
        Ok(Self {
            crc: if is_example { 0 } else { crc },
            owner: BoardIdentity::read(session)?,
            reference: BridgeReference::read(session)?,
            has_learned,
        })
    }
}

impl CommissioningSession<'_> {
    /// Fails if the board works for another machine than the machine file's.
    pub(super) fn check_board_identity(&self) -> Result<()> {
        let BoardContent { crc, owner, .. } = BoardContent::read_from_port(&self.args.port)?;
        let is_named = !owner.machine.is_empty() || !owner.serial.is_empty();
        let serial = self.machine.serial.as_deref().unwrap_or_default();
        if crc != 0
            && is_named
            && (&owner.machine[..], &owner.serial[..]) != (&self.machine.name[..], serial)
        {
            bail!(UserError(format!(
                "{}: is of \"{}\"{}, and this bridge works for {}: nothing is loaded. Connect \
                 the right bridge. If this bridge is to work here from now on, first load a \
                 calibration of this machine (trueup bridge load). Then Confirm it at the CNC",
                self.args.machine.display(),
                self.machine.name,
                if serial.is_empty() { String::new() } else { format!(", serial {serial}") },
                owner.to_text()
            )));
        }
        Ok(())
    }

    /// Saves what the board holds, and requires confirmation that it may be replaced by the calibration of this CRC for the sign
    /// test; `None`: it may not.
    pub(super) fn back_up_board(&mut self, sign_crc: u32) -> Result<Option<BoardBackup>> {
        self.check_board_identity()?;
        let now = BoardContent::read_from_port(&self.args.port)?;
        if now.crc == sign_crc {
            // An earlier sitting could not put it back.
            return Ok(Some(
                self.journal.before.clone().map_or(BoardBackup::Nothing, BoardBackup::Saved),
            ));
        }
        if now.crc == 0 {
            return Ok(Some(BoardBackup::Nothing));
        }
        let file = self.path(&format!("before-{:08x}-{}.json", now.crc, now.owner.board));
        let port = self.args.port.clone();
        if !self.run_command(&["bridge", "save", &file, "--port", &port])? {
            return Ok(None);
        }
        let is_own = compile(&self.machine).is_ok_and(|own| own.crc() == now.crc);
        if !is_own || now.reference.effective_value().is_some() || now.has_learned {
            let question = format!(
                "the bridge holds calibration {:08x} of {}; reference: {}. It is saved in {file}. May the sign test \
                 replace it, and put it back afterwards? [y/N]",
                now.crc,
                now.owner.to_text(),
                now.reference.to_text()
            );
            let answer = self.answers.prompt(&question)?.unwrap_or_default();
            if !matches!(answer.to_ascii_lowercase().as_str(), "y" | "yes") {
                self.journal.log("  nothing is loaded: you did not confirm")?;
                return Ok(None);
            }
        }
        self.journal.before = Some(file.clone());
        self.journal.advance_to(self.journal.next)?;
        Ok(Some(BoardBackup::Saved(file)))
    }

    /// Puts it back.
    pub(super) fn restore_board(&mut self, held: &BoardBackup) -> Result<()> {
        let BoardBackup::Saved(file) = held else {
            return self.journal.log(
                "  the bridge held nothing before; it keeps the sign test's calibration until another is loaded: do not \
                 cut with it",
            );
        };
        // What has ended the test does not end this; a second Ctrl-C does.
        IS_INTERRUPTED.store(false, Ordering::Relaxed);
        self.journal.log("  the previous state of the bridge is restored")?;
        let port = self.args.port.clone();
        let done = self.wait_until_disengaged().and_then(|()| {
            self.run_command(&["bridge", "restore", file, "--yes", "--port", &port])
        });
        match done {
            Ok(true) => {
                self.journal.before = None;
                self.journal.advance_to(self.journal.next)
            }
            Ok(false) => bail!(leftover_calibration_warning(file, &port)),
            // Also of an interrupt this is to be seen.
            Err(error) => bail!("{}: {error:#}", leftover_calibration_warning(file, &port)),
        }
    }
}

fn leftover_calibration_warning(file: &str, port: &str) -> String {
    format!(
        "the bridge may still hold the sign test's calibration, which gives 10 µm: do not cut with it. Restore its previous state with: trueup bridge restore {file} --port {port}"
    )
}
