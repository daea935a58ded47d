//! What a panic does: log, and reset.
//!
//! Nothing in the image is meant to panic. If it does, the state of the tasks is not to be
//! trusted, and starting anew is quicker and safer than any repair: the CNC sees a short silence
//! and "not available". The reset is asked for rather than left to the watchdog, because a panic
//! at start-up comes before the watchdog runs.

use core::{
    panic::PanicInfo,
    sync::atomic::{AtomicBool, Ordering},
};

use cortex_m::{asm, interrupt, peripheral::SCB};

/// 50 ms at the full clock: a probe gets the log out before the reset clears it. At 16 MHz the
/// watchdog cuts it short.
const TIME_TO_READ: u32 = 8_400_000;

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    static PANICKED: AtomicBool = AtomicBool::new(false);

    interrupt::disable();
    // A panic inside the logger would panic again here, for ever.
    if !PANICKED.swap(true, Ordering::Relaxed) {
        defmt::error!("{}", defmt::Display2Format(info));
        asm::delay(TIME_TO_READ);
    }
    SCB::sys_reset()
}
