//! How the board came to run: why it last started, where it stood when the start before ended, and
//! how often it has started.
//!
//! The board finds all of it in RAM that a reset does not clear; the node only reports it.

use trueup_canopen::dictionary;
use trueup_link::status::ResetReason;

/// Bytes of a file's name that are kept, its end.
pub const FILE: usize = 24;

/// How the board came to run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Start {
    /// Why it has started.
    pub reason: ResetReason,
    /// Where the start before stopped.
    pub stop: Stop,
    /// How often it has started since power-on, by the number of the [`ResetReason`]; stops at 65 535.
    pub counts: [u16; ResetReason::COUNT],
}

/// Where a start stopped; all 0: it is not known, or it did not stop by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stop {
    /// Program counter of a fault.
    pub pc: u32,
    /// Link register of a fault.
    pub lr: u32,
    /// CFSR of a fault (Armv7-M manual, B3.2.15).
    pub status: u32,
    /// The address at fault, or that of the register that had changed.
    pub address: u32,
    /// The line of a panic.
    pub line: u32,
    /// The end of the name of its file, with zeros before a shorter one.
    pub file: [u8; FILE],
    /// The task that ran, a number of [`dictionary::TASKS`]; 0: none is known.
    pub task: u8,
}

impl Start {
    /// Returns how often it was that reason, 0 for a number without one.
    #[must_use]
    pub fn resets(&self, reason: u8) -> u16 {
        self.counts.get(usize::from(reason)).copied().unwrap_or(0)
    }
}

impl Stop {
    /// Returns the name of the file, without what fills it up; empty without a panic.
    #[must_use]
    pub fn file(&self) -> &[u8] {
        let start = self.file.iter().take_while(|byte| **byte == 0).count();
        self.file.get(start..).unwrap_or_default()
    }

    /// Returns what is asked, as a number; `None` for the file.
    #[must_use]
    pub const fn number(&self, what: dictionary::Stop) -> Option<u32> {
        Some(match what {
            dictionary::Stop::ProgramCounter => self.pc,
            dictionary::Stop::LinkRegister => self.lr,
            dictionary::Stop::FaultStatus => self.status,
            dictionary::Stop::Address => self.address,
            dictionary::Stop::Line => self.line,
            dictionary::Stop::Task => self.task as u32,
            dictionary::Stop::File => return None,
        })
    }
}
