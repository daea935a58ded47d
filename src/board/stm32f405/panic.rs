//! What a panic and a hard fault do: leave a record for the next start, log, and reset.
//!
//! Nothing in the image is meant to end so. If it does, the state of the tasks is not to be
//! trusted, and starting anew is quicker and safer than any repair: the CNC sees a short silence
//! and "not available". The reset is asked for rather than left to the watchdog, which would wait.

use core::{
    panic::PanicInfo,
    sync::atomic::{AtomicBool, Ordering},
};

use cortex_m::{asm, interrupt, peripheral::SCB};
use cortex_m_rt::ExceptionFrame;

use super::last_words::{self, Core, Why};

/// About 20 ms at the full clock: a probe gets the log out before the reset clears it. Well below the
/// watchdog at either limit of its oscillator.
const TIME_TO_READ: u32 = 1_680_000;

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    static PANICKED: AtomicBool = AtomicBool::new(false);

    interrupt::disable();
    // A panic inside the logger would panic again here, for ever.
    if !PANICKED.swap(true, Ordering::Relaxed) {
        last_words::leave(Why::Panic, Core::default(), info.location());
        defmt::error!("{}", defmt::Display2Format(info));
        asm::delay(TIME_TO_READ);
    }
    SCB::sys_reset()
}

/// The core cannot go on: a bad address, an unknown instruction, a division that it was told to refuse.
/// Nothing is logged: the fault may have come in the midst of a log.
// SAFETY: "unsafe" is how cortex-m-rt marks a handler that critical sections do not hold off; this
// one writes a record that nobody else writes any more.
#[cortex_m_rt::exception]
#[allow(unsafe_code, reason = "registers of the core")]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    // SAFETY: reading these has no effect.
    let (status, address) = unsafe {
        let scb = &*SCB::PTR;
        (scb.cfsr.read(), scb.bfar.read())
    };
    let core = Core { pc: frame.pc(), lr: frame.lr(), status, address };
    last_words::leave(Why::HardFault, core, None);
    SCB::sys_reset()
}
