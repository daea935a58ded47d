//! An image of the tests of the boot program: small, says on the serial line which it is, and does what its
//! behaviour says. It is linked for one slot like the application. Never for a machine.
//!
//! | behaviour | does |
//! |---|---|
//! | 0 | says its name every 50 ms and keeps the watchdog quiet |
//! | 1 | hangs at once, and says nothing |
//! | 2 | says its name once, then resets |
//! | 3 | says its name once, then hangs |
//! | 4 | is confirmed, then as 0 |
//! | 5 | loads the file at sector 8 into the other slot, resets; with nothing newer there as 4 |
//!
//! Its name is one byte, 16 bytes of it are written into the image by the test: `SLOT_TEST`.
#![no_std]
#![no_main]
#![allow(unsafe_code, reason = "registers, and words that the test has written")]

#[path = "../boot/flash.rs"]
mod flash;

use core::{
    panic::PanicInfo,
    ptr::{addr_of, read_volatile},
};

use cortex_m::peripheral::{SCB, syst::SystClkSource};
use cortex_m_rt::{entry, exception};
use stm32f4xx_hal::pac::{IWDG, Peripherals, USART1};
use trueup_boot::{
    image_check::{Image, read_header},
    image_header::{FirmwareVersion, HEADER_SIZE},
    journal::Journal,
    public_key::PublicKey,
    update::{ImageUpdate, confirm, slot_at},
};

static PUBLIC_KEY: &[u8; 32] = include_bytes!(concat!(env!("OUT_DIR"), "/key.bin"));
/// The file that is loaded: where the application has its store.
const UPDATE_FILE_ADDRESS: u32 = 0x0808_0000;

/// Behaviour and name, as the test writes them.
#[repr(C)]
struct TestSettings {
    behaviour: u8,
    name: u8,
}

#[used]
#[unsafe(export_name = "SLOT_TEST")]
static SETTINGS: TestSettings = TestSettings { behaviour: 0, name: b'?' };

#[entry]
fn main() -> ! {
    // SAFETY: the static is there; volatile, because the test has written its bytes after it was compiled.
    let TestSettings { behaviour, name } = unsafe { read_volatile(addr_of!(SETTINGS)) };
    if behaviour == 1 {
        hang();
    }
    let Some(device) = Peripherals::take() else { SCB::sys_reset() };
    // As the application, which clears them.
    device.RCC.csr().modify(|_, w| w.rmvf().set_bit());
    start_serial(&device);
    send_line(&device.USART1, name);
    match behaviour {
        2 => SCB::sys_reset(),
        3 => hang(),
        _ => {}
    }
    let (records, mut slots) = flash::split(device.FLASH);
    let mut journal = Journal::open(records);
    let slot = slot_at(load_image as *const () as u32);
    let Ok(running) = read_header(&mut slots, slot, FirmwareVersion::default()) else {
        SCB::sys_reset()
    };
    if behaviour == 4 || behaviour == 5 {
        let is_confirmed = confirm(&mut journal, &running).is_ok();
        send_line(&device.USART1, if is_confirmed { b'c' } else { b'!' });
    }
    extend_watchdog_timeout(behaviour, &device.IWDG);
    if behaviour == 5 && load_image(&mut journal, &mut slots, &running, &device.IWDG) {
        send_line(&device.USART1, b'u');
        SCB::sys_reset();
    }
    start_systick();
    loop {
        feed_watchdog(&device.IWDG);
        // Asleep: the model of the chip is fast then.
        (0..5).for_each(|_| cortex_m::asm::wfi());
        send_line(&device.USART1, name);
    }
}

/// Loads the file; `true`: the boot program is to start it.
fn load_image(
    journal: &mut Journal<flash::JournalRegion>,
    slots: &mut flash::SlotRegion,
    running: &Image,
    watchdog: &IWDG,
) -> bool {
    // SAFETY: flash that no code writes to.
    let file = unsafe { core::slice::from_raw_parts(UPDATE_FILE_ADDRESS as *const u8, 128 * 1024) };
    let (Some(header), Some(key)) = (file.first_chunk::<HEADER_SIZE>(), PublicKey::new(PUBLIC_KEY))
    else {
        return false;
    };
    let Ok(mut update) = ImageUpdate::begin(journal, slots, running, header) else { return false };
    feed_watchdog(watchdog);
    let length = update.image().header.length as usize;
    let Some(rest) = file.get(HEADER_SIZE..length) else { return false };
    for piece in rest.chunks(64) {
        if update.append(slots, piece).is_err() {
            return false;
        }
        feed_watchdog(watchdog);
    }
    update.finish(journal, slots, &key, || feed_watchdog(watchdog)).is_ok()
}

fn hang() -> ! {
    loop {
        cortex_m::asm::nop();
    }
}

/// Eight seconds, as an application that may erase: by 256, 1 000 periods.
fn extend_watchdog_timeout(behaviour: u8, watchdog: &IWDG) {
    if behaviour != 5 {
        return;
    }
    // SAFETY: the keys and values of RM0090, section 21.4.
    unsafe {
        watchdog.kr().write(|w| w.bits(0x5555));
        watchdog.pr().write(|w| w.bits(6));
        watchdog.rlr().write(|w| w.bits(1_000));
    }
    let _is_done = (0..8_000).any(|_| watchdog.sr().read().bits() == 0);
    feed_watchdog(watchdog);
}

fn feed_watchdog(watchdog: &IWDG) {
    // SAFETY: the key of RM0090, section 21.4.1.
    watchdog.kr().write(|w| unsafe { w.bits(0xAAAA) });
}

/// SysTick wakes the core every 10 ms, from 16 MHz.
fn start_systick() {
    // SAFETY: no other code has the peripherals of the core.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(160_000 - 1);
    core.SYST.clear_current();
    core.SYST.enable_counter();
    core.SYST.enable_interrupt();
}

#[exception]
fn SysTick() {}

/// PA9 as USART1's transmit, 921 600 Bd of 16 MHz (2.1 % fast).
fn start_serial(device: &Peripherals) {
    device.RCC.ahb1enr().modify(|_, w| w.gpioaen().set_bit());
    device.RCC.apb2enr().modify(|_, w| w.usart1en().set_bit());
    // A read of the register lets the clock come up (errata sheet, delay after an RCC clock enabling).
    let _clocked = device.RCC.apb2enr().read();
    // SAFETY: values of RM0090, sections 8.4 and 30.6.
    unsafe {
        device.GPIOA.afrh().modify(|r, w| w.bits(r.bits() & !0xF0 | 7 << 4));
        device.GPIOA.moder().modify(|r, w| w.bits(r.bits() & !(3 << 18) | 2 << 18));
        device.USART1.brr().write(|w| w.bits(0x11));
        device.USART1.cr1().write(|w| w.bits(1 << 13 | 1 << 3));
    }
}

/// One byte and the end of a line.
fn send_line(serial: &USART1, name: u8) {
    for byte in [name, b'\r'] {
        let _is_free = (0..10_000).any(|_| serial.sr().read().txe().bit_is_set());
        // SAFETY: any byte.
        serial.dr().write(|w| unsafe { w.bits(byte.into()) });
    }
    let _is_sent = (0..10_000).any(|_| serial.sr().read().tc().bit_is_set());
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    SCB::sys_reset()
}
