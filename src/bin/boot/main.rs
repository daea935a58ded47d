//! The boot program: chooses one of two images and starts it. It lies in sectors 0 and 1 and is never written by
//! an update.
//!
//! ```text
//!  reset ─► watchdog ─► 144 MHz from the internal oscillator ─► choose (trueup_boot::start) ─► clocks as after a reset ─► image
//! ```
//!
//! | part | how |
//! |---|---|
//! | clock | the internal oscillator through the PLL: no crystal is needed; 144 MHz, because it may be 4 % fast |
//! | PLL dead | 16 MHz, and a signature that was verified at the download is not verified again |
//! | RAM | the upper 32 KB, where the application has its stack: what outlasts a reset there lies lower |
//! | watchdog | 0.5 to 1.5 s, by its oscillator; then 0.3 to 0.9 s, which the application keeps until its tasks run |
//! | reason | handed to the image in three words at the end of the RAM (`trueup_boot::handover`) |
//! | no image | the watchdog resets, and it looks again: a supply that dipped may have been the cause |
//!
//! It allocates nothing, and no panic can be reached (host-tests, `boot_program`). Section numbers are those of RM0090
//! (Rev 21).
#![no_std]
#![no_main]

mod clocks;
mod flash;
mod watchdog;

use core::{panic::PanicInfo, ptr::write_volatile};

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, entry, exception};
use stm32f4xx_hal::pac::{Peripherals, RCC};
use trueup_boot::{
    flash_layout::{HANDOVER_START, Slot},
    handover::StartInfo,
    image_header::HEADER_SIZE,
    journal::Journal,
    public_key::{PUBLIC_KEY_SIZE, PublicKey},
    start::{StartOutcome, StartSelection, select_image},
};

use watchdog::{BOOT_TIMEOUT, IMAGE_START_TIMEOUT};

/// The key that updates are signed with (`build.rs`).
static PUBLIC_KEY: &[u8; PUBLIC_KEY_SIZE] = include_bytes!(concat!(env!("OUT_DIR"), "/key.bin"));

#[entry]
fn main() -> ! {
    let Some(device) = Peripherals::take() else { SCB::sys_reset() };
    watchdog::start(&device.IWDG, &device.DBGMCU, BOOT_TIMEOUT);
    let feed = || watchdog::feed(&device.IWDG);
    let ending = last_start_outcome(&device.RCC);
    let clock = clocks::start(&device.RCC, &device.FLASH, &device.DBGMCU);
    let (records, mut slots) = flash::split(device.FLASH);
    let mut journal = Journal::open(records);
    let start = PublicKey::new(PUBLIC_KEY)
        .and_then(|key| select_image(&mut journal, &mut slots, &key, ending, clock, feed));
    clocks::restore_reset_state(&device.RCC, slots.controller());
    watchdog::set_timeout(&device.IWDG, IMAGE_START_TIMEOUT);
    if let Some(start) = start {
        write_handover(&start);
        start_image(start.image.header.slot);
    }
    loop {
        cortex_m::asm::wfi();
    }
}

/// Returns how the last start ended. The flags stay: the image reads them too, and clears them (section 7.3.21).
fn last_start_outcome(rcc: &RCC) -> StartOutcome {
    let flags = rcc.csr().read();
    let is_reset = flags.wdgrstf().bit_is_set()
        || flags.wwdgrstf().bit_is_set()
        || flags.sftrstf().bit_is_set();
    if is_reset { StartOutcome::Reset } else { StartOutcome::PowerCycle }
}

/// Writes why the image starts where it looks for it.
#[allow(unsafe_code, reason = "words that both programs know by their address")]
fn write_handover(start: &StartSelection) {
    let words = StartInfo::from(start).to_words(start.image.tag);
    for (at, word) in (HANDOVER_START..).step_by(4).zip(words) {
        // SAFETY: an aligned word of the RAM, above the stack, which nothing else of this program uses.
        unsafe { write_volatile(at as *mut u32, word) };
    }
}

/// Starts the image of a slot, whose vector table follows its header.
#[allow(unsafe_code, reason = "the end of this program")]
fn start_image(slot: Slot) -> ! {
    let vectors = slot.start() + HEADER_SIZE as u32;
    // SAFETY: nothing of this program is used any more: no interrupt is on, and the image sets up its own stack.
    unsafe {
        (*SCB::PTR).vtor.write(vectors);
        cortex_m::asm::bootload(vectors as *const u32)
    }
}

/// No panic can be reached; the compiler requires a handler all the same.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    SCB::sys_reset()
}

/// A fault of the core: the start is tried again.
// SAFETY: "unsafe" is how cortex-m-rt marks a handler that critical sections do not hold off.
#[exception]
#[allow(unsafe_code, reason = "how cortex-m-rt marks this handler")]
unsafe fn HardFault(_: &ExceptionFrame) -> ! {
    SCB::sys_reset()
}
