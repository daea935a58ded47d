//! Record that a start which ends badly leaves to the next one: why, and where, in RAM that a reset leaves
//! unchanged and the start does not clear.
//!
//! A log is lost where no probe listens, and a watchdog's reset says nothing. So a panic, a hard fault,
//! a crystal that stops and a register that has changed write a record before they reset; the next start reads it once.
//! After power-on the RAM holds anything, so a record counts with its checksum only.

use core::{
    mem::MaybeUninit,
    sync::atomic::{AtomicU32, Ordering, fence},
};

use trueup_node::reset_info::{CrashInfo, MAX_FILE_NAME_BYTES};

use crate::liveness;

/// Words of a record: kind, four numbers, the place's line, its file in six words, the task, and the checksum.
const RECORD_WORDS: usize = 14;
/// The checksum of nothing but zeros: so that cleared RAM is no record.
const CHECKSUM_SEED: u32 = 0x7472_7565;

#[unsafe(link_section = ".uninit.crash_record")]
#[allow(unsafe_code, reason = "a place in RAM that the start leaves as it is")]
static CRASH_RECORD: MaybeUninit<[AtomicU32; RECORD_WORDS]> = MaybeUninit::uninit();

#[allow(unsafe_code, reason = "a place in RAM that the start leaves as it is")]
fn record_words() -> &'static [AtomicU32; RECORD_WORDS] {
    // SAFETY: any bits are a value of these.
    unsafe { CRASH_RECORD.assume_init_ref() }
}

/// Why the board stopped itself.
#[derive(Clone, Copy, PartialEq, Eq, defmt::Format)]
#[repr(u32)]
pub enum StopReason {
    /// A panic.
    Panic = 1,
    /// The core stopped it: a hard fault.
    HardFault = 2,
    /// The crystal stopped.
    Crystal = 3,
    /// The stack ran into its guard.
    StackOverflow = 4,
    /// A register was other than it was set up.
    Registers = 5,
}

/// Where the core was: program counter, link register, fault status and address.
#[derive(Clone, Copy, Default, defmt::Format)]
pub struct CoreRegisters {
    pub pc: u32,
    pub lr: u32,
    /// CFSR, as in the Armv7-M manual, B3.2.15.
    pub status: u32,
    /// The address at fault, where the status says that there is one.
    pub address: u32,
}

/// The record that was left.
pub struct CrashRecord {
    pub why: StopReason,
    pub stop: CrashInfo,
}

impl CrashRecord {
    /// Into the log.
    pub fn log(&self) {
        let CrashInfo { pc, lr, status, address, line, task, .. } = self.stop;
        let file = core::str::from_utf8(self.stop.file_name()).unwrap_or_default();
        defmt::error!(
            "the last start ended by {}: {=str}:{=u32}, pc {=u32:#x}, lr {=u32:#x}, CFSR {=u32:#x}, address {=u32:#x}, task {=u8}",
            self.why,
            file,
            line,
            pc,
            lr,
            status,
            address,
            task
        );
    }
}

fn checksum(words: &[u32]) -> u32 {
    words.iter().fold(CHECKSUM_SEED, |sum, word| sum.rotate_left(5) ^ word)
}

/// Leaves a record to the next start. The first of a start stays: what fails after it, fails because of it.
pub fn write(why: StopReason, core: CoreRegisters, place: Option<&core::panic::Location<'_>>) {
    if read().is_some() {
        return;
    }
    let mut words = [0; RECORD_WORDS];
    words[0] = why as u32;
    words[1..5].copy_from_slice(&[core.pc, core.lr, core.status, core.address]);
    if let Some(place) = place {
        words[5] = place.line();
        // Its end.
        let mut file = [0; MAX_FILE_NAME_BYTES];
        for (kept, byte) in file.iter_mut().rev().zip(place.file().bytes().rev()) {
            *kept = byte;
        }
        for (word, bytes) in words[6..].iter_mut().zip(file.as_chunks().0) {
            *word = u32::from_le_bytes(*bytes);
        }
    }
    words[RECORD_WORDS - 2] = liveness::last_running_task_number().into();
    words[RECORD_WORDS - 1] = checksum(&words[..RECORD_WORDS - 1]);
    for (place, word) in record_words().iter().zip(words) {
        place.store(word, Ordering::Relaxed);
    }
    fence(Ordering::SeqCst);
}

fn read() -> Option<CrashRecord> {
    let words: [u32; RECORD_WORDS] =
        core::array::from_fn(|n| record_words()[n].load(Ordering::Relaxed));
    if words[RECORD_WORDS - 1] != checksum(&words[..RECORD_WORDS - 1]) {
        return None;
    }
    let why = match words[0] {
        1 => StopReason::Panic,
        2 => StopReason::HardFault,
        3 => StopReason::Crystal,
        4 => StopReason::StackOverflow,
        5 => StopReason::Registers,
        _ => return None,
    };
    let mut file = [0; MAX_FILE_NAME_BYTES];
    for (bytes, word) in file.as_chunks_mut().0.iter_mut().zip(&words[6..]) {
        *bytes = word.to_le_bytes();
    }
    let [_, pc, lr, status, address, line, ..] = words;
    let [task, ..] = words[RECORD_WORDS - 2].to_le_bytes();
    Some(CrashRecord { why, stop: CrashInfo { pc, lr, status, address, line, file, task } })
}

/// Returns what the last start has left, once.
pub fn take() -> Option<CrashRecord> {
    let words = read();
    record_words().iter().for_each(|place| place.store(0, Ordering::Relaxed));
    words
}
