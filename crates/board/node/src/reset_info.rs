//! How the board came to run: why it last started, where it stood when the start before ended, and
//! how often it has started.
//!
//! The board finds all of it in RAM that a reset does not clear; the node only reports it.

use trueup_canopen::dictionary;
use trueup_link::status::ResetReason;

/// Bytes of a file's name that are kept, its end.
pub const MAX_FILE_NAME_BYTES: usize = 24;

/// How the board came to run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ResetInfo {
    /// Why it has started.
    pub reason: ResetReason,
    /// Where the start before stopped.
    pub stop: CrashInfo,
    /// How often it has started since power-on, by the number of the [`ResetReason`]; stops at 65 535.
    pub counts: [u16; ResetReason::COUNT],
}

/// Where a start stopped; all 0: it is not known, or it did not stop by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CrashInfo {
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
    pub file: [u8; MAX_FILE_NAME_BYTES],
    /// The task that ran, a number of [`dictionary::TASK_NAMES`]; 0: none is known.
    pub task: u8,
}

impl ResetInfo {
    /// Returns how often it was that reason, 0 for a number without one.
    #[must_use]
    pub(crate) fn reset_count(&self, reason: u8) -> u16 {
        self.counts.get(usize::from(reason)).copied().unwrap_or(0)
    }
}

impl CrashInfo {
    /// Returns the name of the file, without what fills it up; empty without a panic.
    #[must_use]
    pub fn file_name(&self) -> &[u8] {
        let start = self.file.iter().take_while(|byte| **byte == 0).count();
        self.file.get(start..).unwrap_or_default()
    }

    /// Returns what is asked, as a number; `None` for the file.
    #[must_use]
    pub(crate) const fn detail_value(&self, what: dictionary::CrashDetail) -> Option<u32> {
        Some(match what {
            dictionary::CrashDetail::ProgramCounter => self.pc,
            dictionary::CrashDetail::LinkRegister => self.lr,
            dictionary::CrashDetail::FaultStatus => self.status,
            dictionary::CrashDetail::Address => self.address,
            dictionary::CrashDetail::Line => self.line,
            dictionary::CrashDetail::Task => self.task as u32,
            dictionary::CrashDetail::File => return None,
        })
    }
}
