//! The content of a board before the sign test: saved to a file, and put back after it, whatever becomes of the test.
//!
//! The test's calibration gives 10 µm whatever the machine does. A board that corrects a machine must not be left with
//! it, so what it held is saved first; if it corrects something else than the machine file says, or has a reference,
//! the user is asked. A board of another machine is left alone.

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result, bail};
use trueup_client::{
    object, port::Port, reference::BridgeReference, saved::Owner, session::Session,
};
use trueup_link::status::StateBits;
use trueup_machine::compile;

use super::Work;
use crate::UserError;

/// The user wants it to end.
static IS_INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// The user has ended it.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

/// Ctrl-C ends a step where nothing is lost, and not the program.
pub fn catch_interrupts() -> Result<()> {
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
pub enum Held {
    /// The board has corrected nothing.
    Nothing,
    /// The content of this file.
    Saved(String),
}

/// The owner and the content of a board.
struct Now {
    /// The CRC of its calibration; 0: it has none, or an example's.
    crc: u32,
    owner: Owner,
    reference: BridgeReference,
    has_learned: bool,
}

impl Now {
    fn ask(port: &str) -> Result<Self> {
        let mut session = Session::open(&Port::parse(port)?)?;
        let now = Self::of(&mut session);
        session.close();
        now
    }

    fn of(session: &mut Session) -> Result<Self> {
        let state = StateBits(object::number(session, object::STATE_BITS)?);
        let crc = object::number(session, object::RUNNING_CRC)?;
        let is_example = state.contains(StateBits::EXAMPLE_CONSTANTS);
        let mut has_learned = false;
        for at in object::LEARNED {
            has_learned |= object::number(session, at).unwrap_or_default() != 0;
        }
        Ok(Self {
            crc: if is_example { 0 } else { crc },
            owner: Owner::ask(session)?,
            reference: BridgeReference::ask(session)?,
            has_learned,
        })
    }
}

impl Work<'_> {
    /// Fails if the board works for another machine than the machine file's.
    pub(super) fn check_board(&self) -> Result<()> {
        let Now { crc, owner, .. } = Now::ask(&self.args.port)?;
        let is_named = !owner.machine.is_empty() || !owner.serial.is_empty();
        let serial = self.machine.serial.as_deref().unwrap_or_default();
        if crc != 0
            && is_named
            && (&owner.machine[..], &owner.serial[..]) != (&self.machine.name[..], serial)
        {
            bail!(UserError(format!(
                "{}: is of \"{}\"{}, and this bridge works for {}: nothing is loaded. Connect the right bridge; or, if \
                 this one is to work here from now on, load a calibration of this machine first (trueup bridge load) \
                 and Confirm it at the CNC",
                self.args.machine.display(),
                self.machine.name,
                if serial.is_empty() { String::new() } else { format!(", serial {serial}") },
                owner.text()
            )));
        }
        Ok(())
    }

    /// Saves what the board holds, and asks whether it may be replaced by the calibration of this CRC for the sign
    /// test; `None`: it may not.
    pub(super) fn hold_board(&mut self, sign_crc: u32) -> Result<Option<Held>> {
        self.check_board()?;
        let now = Now::ask(&self.args.port)?;
        if now.crc == sign_crc {
            // An earlier sitting could not put it back.
            return Ok(Some(self.journal.before.clone().map_or(Held::Nothing, Held::Saved)));
        }
        if now.crc == 0 {
            return Ok(Some(Held::Nothing));
        }
        let file = self.path(&format!("before-{:08x}-{}.json", now.crc, now.owner.board));
        let port = self.args.port.clone();
        if !self.command(&["bridge", "save", &file, "--port", &port])? {
            return Ok(None);
        }
        let is_own = compile(&self.machine).is_ok_and(|own| own.crc() == now.crc);
        if !is_own || now.reference.value().is_some() || now.has_learned {
            let question = format!(
                "the bridge holds calibration {:08x} of {}; reference: {}. It is saved in {file}. May the sign test \
                 replace it, and put it back afterwards? [y/N]",
                now.crc,
                now.owner.text(),
                now.reference.text()
            );
            let answer = self.answers.ask(&question)?.unwrap_or_default();
            if !matches!(answer.to_ascii_lowercase().as_str(), "y" | "yes") {
                self.journal.log("  nothing is loaded: you have not said yes")?;
                return Ok(None);
            }
        }
        self.journal.before = Some(file.clone());
        self.journal.proceed(self.journal.next)?;
        Ok(Some(Held::Saved(file)))
    }

    /// Puts it back.
    pub(super) fn put_back(&mut self, held: &Held) -> Result<()> {
        let Held::Saved(file) = held else {
            return self.journal.log(
                "  the bridge held nothing before; it keeps the sign test's calibration until another is loaded: do not \
                 cut with it",
            );
        };
        // What has ended the test does not end this; a second Ctrl-C does.
        IS_INTERRUPTED.store(false, Ordering::Relaxed);
        self.journal.log("  what the bridge held before is put back")?;
        let port = self.args.port.clone();
        let done = self
            .disengaged()
            .and_then(|()| self.command(&["bridge", "restore", file, "--yes", "--port", &port]));
        match done {
            Ok(true) => {
                self.journal.before = None;
                self.journal.proceed(self.journal.next)
            }
            Ok(false) => bail!(left_behind(file, &port)),
            // Also of an interrupt this is to be seen.
            Err(error) => bail!("{}: {error:#}", left_behind(file, &port)),
        }
    }
}

fn left_behind(file: &str, port: &str) -> String {
    format!(
        "the bridge may still hold the sign test's calibration, which gives 10 µm: do not cut with it. What it held \
         before is put back by: trueup bridge restore {file} --port {port}"
    )
}
