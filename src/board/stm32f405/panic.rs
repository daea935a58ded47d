//! Handlers of a panic and a hard fault: they leave a record for the next start, log, and reset.
//!
//! Nothing in the image is meant to end so. If it does, the state of the tasks is not to be
//! trusted, and starting anew is quicker and safer than any repair: the CNC sees a short silence
//! and "not available". The reset is requested rather than left to the watchdog, which would wait.

use core::{
    panic::PanicInfo,
    sync::atomic::{AtomicBool, Ordering},
};

use cortex_m::{asm, interrupt, peripheral::SCB};
use cortex_m_rt::ExceptionFrame;

use super::{
    crash_record::{self, CoreRegisters, StopReason},
    mpu,
};

/// About 20 ms at the full clock: a probe gets the log out before the reset clears it. Well below the
/// watchdog at either limit of its oscillator.
const LOG_FLUSH_CYCLES: u32 = 1_680_000;

/// MMARVALID, BFARVALID, and MSTKERR with STKERR (Armv7-M manual, B3.2.15).
const MMARVALID: u32 = 1 << 7;
const BFARVALID: u32 = 1 << 15;
const STACKING_ERROR_MASK: u32 = 1 << 4 | 1 << 12;

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    static HAS_PANICKED: AtomicBool = AtomicBool::new(false);

    interrupt::disable();
    // A panic inside the logger would panic again here, for ever.
    if !HAS_PANICKED.swap(true, Ordering::Relaxed) {
        crash_record::write(StopReason::Panic, CoreRegisters::default(), info.location());
        // The place and not the words: these would bring the formatting of `core` into the image.
        if let Some(place) = info.location() {
            defmt::error!("panic at {=str}:{=u32}", place.file(), place.line());
        }
        asm::delay(LOG_FLUSH_CYCLES);
    }
    SCB::sys_reset()
}

/// The core cannot go on: a bad address, an unknown instruction, a division by zero, what the memory protection
/// forbids. These come as hard faults, because no handler of their own is switched on.
/// Nothing is logged: the fault may have come in the midst of a log.
// SAFETY: "unsafe" is how cortex-m-rt marks a handler that critical sections do not hold off; this
// one writes a record that no other code writes any more.
#[cortex_m_rt::exception]
#[allow(unsafe_code, reason = "registers of the core")]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    // SAFETY: reading these has no effect.
    let (status, memory, bus) = unsafe {
        let scb = &*SCB::PTR;
        (scb.cfsr.read(), scb.mmfar.read(), scb.bfar.read())
    };
    let address = match status {
        _ if status & MMARVALID != 0 => memory,
        _ if status & BFARVALID != 0 => bus,
        _ => 0,
    };
    let why = if status & STACKING_ERROR_MASK != 0 || mpu::STACK_GUARD_RANGE.contains(&address) {
        StopReason::StackOverflow
    } else {
        StopReason::HardFault
    };
    // What was not stacked is not there.
    let (pc, lr) =
        if status & STACKING_ERROR_MASK == 0 { (frame.pc(), frame.lr()) } else { (0, 0) };
    crash_record::write(why, CoreRegisters { pc, lr, status, address }, None);
    SCB::sys_reset()
}
