//! Which task runs, and whether each has had its turn: the watchdog is fed by it, and the next start
//! finds here who held it up.
//!
//! A task that hangs above the supervisor's priority holds up the supervisor: the watchdog bites, and
//! the mark of the task that ran is still in RAM that a reset does not clear. One that hangs below it
//! takes no more turns, nor do those that it holds up: the supervisor sees that, leaves the mark of the one that it has
//! interrupted, and no longer feeds.

use core::{
    mem::MaybeUninit,
    sync::atomic::{AtomicBool, AtomicU16, AtomicU32, Ordering},
};

/// The tasks, by the numbers of `trueup_canopen::dictionary::TASK_NAMES`.
#[derive(Clone, Copy, PartialEq, Eq, defmt::Format)]
#[repr(u8)]
pub enum Task {
    /// From the reset to the first turn of any task.
    Start = 1,
    SerialReceive,
    Sample,
    CanReceive0,
    CanReceive1,
    Listen,
    Supervise,
    Service,
    Transmit,
    Thermometers,
    Idle,
    ModbusLine,
    Modbus,
}

/// The tasks that have a turn all the time, whatever comes over the wires, and do not hold up the
/// supervisor if they hang.
const MONITORED_TASKS: [Task; 4] = [Task::Service, Task::Transmit, Task::Thermometers, Task::Idle];
/// Milliseconds without a turn after which one of them counts as hanging: the longest deadline among
/// them, that of the thermometers (`main.rs`).
const TASK_TIMEOUT_MS: u32 = 1_000;
/// Above the number of a task in its mark: so that RAM after power-on is no mark.
const TASK_MARK_MAGIC: u32 = 0x7461_7300;

/// A bit for each task that has ended a turn since the last read.
static COMPLETED_TASKS: AtomicU16 = AtomicU16::new(0);

/// The mark of the task that runs.
#[unsafe(link_section = ".uninit.RUNNING")]
#[allow(unsafe_code, reason = "a place in RAM that the start leaves as it is")]
static RUNNING_TASK_MARK: MaybeUninit<AtomicU32> = MaybeUninit::uninit();

#[allow(unsafe_code, reason = "a place in RAM that the start leaves as it is")]
fn running_task_mark() -> &'static AtomicU32 {
    // SAFETY: any bits are a value of it.
    unsafe { RUNNING_TASK_MARK.assume_init_ref() }
}

/// The mark is that of a task that hangs.
static IS_HANG_ATTRIBUTED: AtomicBool = AtomicBool::new(false);

fn set_running_task_mark(mark: u32) {
    if !IS_HANG_ATTRIBUTED.load(Ordering::Relaxed) {
        running_task_mark().store(mark, Ordering::Relaxed);
    }
}

/// Returns the number of the task that ran; 0: none is known. For a board with a watchdog of its own.
#[cfg(feature = "stm32f405")]
pub fn last_running_task_number() -> u8 {
    let [number, ..] =
        (running_task_mark().load(Ordering::Relaxed) ^ TASK_MARK_MAGIC).to_le_bytes();
    let is_mark = running_task_mark().load(Ordering::Relaxed) & !0xFF == TASK_MARK_MAGIC;
    if is_mark { number } else { 0 }
}

/// A turn of a task, which ends when it is dropped.
pub struct TaskGuard {
    task: Task,
    /// The mark of the task that this one interrupts.
    before: u32,
}

impl TaskGuard {
    /// The task that this one has interrupted hangs: its mark stays, whatever still runs.
    pub fn blame_preempted(&self) {
        IS_HANG_ATTRIBUTED.store(true, Ordering::Relaxed);
        running_task_mark().store(self.before, Ordering::Relaxed);
    }
}

/// A task begins a turn.
pub fn begin_task(task: Task) -> TaskGuard {
    // Who interrupts between these two puts the mark back before this goes on.
    let before = running_task_mark().load(Ordering::Relaxed);
    set_running_task_mark(TASK_MARK_MAGIC | task as u32);
    #[cfg(feature = "faults")]
    crate::faults::hang_if_selected(task as u32);
    TaskGuard { task, before }
}

impl Drop for TaskGuard {
    fn drop(&mut self) {
        COMPLETED_TASKS.fetch_or(1 << self.task as u16, Ordering::Relaxed);
        set_running_task_mark(self.before);
    }
}

/// The task that nothing is below: its turns have no end, so it says when it is alive.
pub fn set_background_task(task: Task) {
    running_task_mark().store(TASK_MARK_MAGIC | task as u32, Ordering::Relaxed);
}

/// A task that stays is alive.
pub fn heartbeat(task: Task) {
    COMPLETED_TASKS.fetch_or(1 << task as u16, Ordering::Relaxed);
    #[cfg(feature = "faults")]
    crate::faults::hang_if_selected(task as u32);
}

/// For how long the steady tasks have had no turn.
#[derive(Default)]
pub struct LivenessMonitor {
    silent_ms: [u32; MONITORED_TASKS.len()],
}

impl LivenessMonitor {
    /// After each `elapsed_ms`: whether a task has had no turn for too long.
    pub fn check_for_hang(&mut self, elapsed_ms: u32) -> bool {
        let done = COMPLETED_TASKS.swap(0, Ordering::Relaxed);
        let mut hangs = false;
        for (task, silent) in MONITORED_TASKS.into_iter().zip(&mut self.silent_ms) {
            let was_there = done >> task as u16 & 1 != 0;
            *silent = if was_there { 0 } else { silent.saturating_add(elapsed_ms) };
            hangs |= *silent >= TASK_TIMEOUT_MS;
        }
        hangs
    }
}
