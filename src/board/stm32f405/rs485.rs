//! The RS-485 line for a PLC: USART3 on PB10 and PB11 (section 30), PB12 high while the board sends.
//!
//! Switches to ground, as such devices have them, read at the start; all open is what the standard has as default.
//!
//! | pin | open | closed |
//! |---|---|---|
//! | PC8, PC9, PC10, PC11 | address 1 | 1, 2, 4 and 8 more: 1 to 16 |
//! | PB5 | 19 200 Bd | 115 200 Bd |
//! | PB6 | even parity | none, two stop bits |
//!
//! A byte comes by interrupt, with its time, because Modbus marks the end of a frame by silence alone: TIM5
//! counts microseconds and says when 3.5 characters have passed. A byte takes 573 µs, or 95; the interrupt must
//! come within that. One that is late costs a frame, which the master requests again.
//!
//! 42, 36 and 16 MHz reach both rates to within 0.16 %.

use stm32f4xx_hal::{
    gpio::{ErasedPin, Output, PB5, PB6, PB10, PB11, PB12, PC8, PC9, PC10, PC11, Pull},
    pac::{TIM5, USART3},
    rcc::{Enable, Rcc, Reset},
};
use trueup_modbus::rtu::{FrameTiming, RxByte};

use super::super::PlcInterface;

/// Core cycles after which a pull-up of 40 kΩ has lifted its pin and the wire to its switch, of some 50 pF.
const PULL_UP_SETTLE_CYCLES: u32 = 1_680;

/// CR2: STOP; CR1: UE, RXNEIE, TE, RE; M; PCE.
const CR2_STOP_2: u32 = 0b10 << 12;
const CR1_ENABLE_BITS: u32 = (1 << 13) | (1 << 5) | (1 << 3) | (1 << 2);
const CR1_M: u32 = 1 << 12;
const CR1_PCE: u32 = 1 << 10;

/// The pins.
pub struct Rs485Pins {
    pub transmit: PB10,
    pub receive: PB11,
    pub drive: PB12,
    pub rate: PB5,
    pub parity: PB6,
    /// Their weights in the address: 1, 2, 4, 8.
    pub address: (PC8, PC9, PC10, PC11),
}

/// Sets up the line and its clock.
pub fn start(usart: USART3, timer: TIM5, pins: Rs485Pins, rcc: &mut Rcc) -> PlcInterface {
    let rate = pins.rate.into_pull_up_input().erase();
    let parity = pins.parity.into_pull_up_input().erase();
    let address = [
        pins.address.0.into_pull_up_input().erase(),
        pins.address.1.into_pull_up_input().erase(),
        pins.address.2.into_pull_up_input().erase(),
        pins.address.3.into_pull_up_input().erase(),
    ];
    cortex_m::asm::delay(PULL_UP_SETTLE_CYCLES);
    let unit = 1 + address.iter().rev().fold(0, |sum, pin| sum << 1 | u8::from(pin.is_low()));
    let baud = if rate.is_low() { 115_200 } else { 19_200 };
    let has_parity = parity.is_high();

    let drive = pins.drive.into_push_pull_output().erase();
    pins.transmit.into_alternate::<7>();
    // Pulled up, so that it is quiet while the transceiver's receiver is off.
    pins.receive.into_alternate::<7>().internal_resistor(Pull::Up);
    USART3::enable(rcc);
    USART3::reset(rcc);
    // In sixteenths, of which the register has the whole ones above the rest (section 30.3.4).
    let divider = (rcc.clocks.pclk1().raw() + baud / 2) / baud;
    // In whole words: of half a one the bus makes two, and the other half is reserved (section 30.6).
    // SAFETY: registers of a line that is only being set up, as wide as a word.
    #[allow(unsafe_code, reason = "registers of the line")]
    let set =
        |register: *mut u16, bits: u32| unsafe { register.cast::<u32>().write_volatile(bits) };
    set(usart.brr().as_ptr(), divider);
    set(usart.cr2().as_ptr(), if has_parity { 0 } else { CR2_STOP_2 });
    // The parity is the ninth bit of the word.
    set(usart.cr1().as_ptr(), CR1_ENABLE_BITS | if has_parity { CR1_M | CR1_PCE } else { 0 });

    TIM5::enable(rcc);
    TIM5::reset(rcc);
    timer.psc().write(|w| w.psc().set((rcc.clocks.timclk1().raw() / 1_000_000 - 1) as u16));
    timer.egr().write(|w| w.ug().update());
    timer.sr().reset();
    timer.dier().write(|w| w.cc1ie().enabled());
    timer.cr1().write(|w| w.cen().enabled());

    let timing = FrameTiming::from_baud(baud);
    defmt::info!("Modbus: unit {=u8}, {=u32} Bd, parity {=bool}", unit, baud, has_parity);
    let line = Rs485 { usart, drive, is_sending: false, behind_us: timing.behind_us };
    PlcInterface { unit, timing, line, silence: SilenceTimer(timer) }
}

/// Microseconds since the start; wraps.
#[allow(unsafe_code, reason = "a register of the timer")]
fn now_us() -> u32 {
    // SAFETY: a read of a counter.
    unsafe { TIM5::steal() }.cnt().read().cnt().bits()
}

/// The bytes of the line, both ways.
pub struct Rs485 {
    usart: USART3,
    drive: ErasedPin<Output>,
    is_sending: bool,
    behind_us: u32,
}

impl Rs485 {
    /// Takes the byte that came in, with its time. While the board sends it ignores what comes in.
    #[allow(unsafe_code, reason = "a register of the timer")]
    pub fn receive_byte(&mut self) -> Option<RxByte> {
        // Read in this order, they clear what is set.
        let status = self.usart.sr().read();
        if status.rxne().bit_is_clear() && status.ore().bit_is_clear() {
            return None;
        }
        let byte = self.usart.dr().read().dr().bits() as u8;
        if self.is_sending {
            return None;
        }
        let at_us = now_us();
        // SAFETY: this side alone writes that register.
        let timer = unsafe { TIM5::steal() };
        timer.ccr1().write(|w| w.ccr().set(at_us.wrapping_add(self.behind_us + 1)));
        let is_damaged = status.pe().bit_is_set()
            || status.fe().bit_is_set()
            || status.nf().bit_is_set()
            || status.ore().bit_is_set();
        Some(RxByte { at_us, byte: (!is_damaged).then_some(byte) })
    }

    /// Sends what `next` gives, a byte at a time.
    pub fn send(&mut self, mut next: impl FnMut() -> Option<u8>) {
        let status = self.usart.sr().read();
        if status.txe().bit_is_clear() {
            return;
        }
        if let Some(byte) = next() {
            self.is_sending = true;
            self.drive.set_high();
            self.usart.dr().write(|w| w.dr().set(byte.into()));
            self.usart.cr1().modify(|_, w| w.txeie().enabled().tcie().disabled());
        } else if self.is_sending {
            // The last byte is on its way: the line is let go when its stop bit is out.
            self.usart.cr1().modify(|_, w| w.txeie().disabled().tcie().enabled());
            if status.tc().bit_is_set() {
                self.drive.set_low();
                self.usart.cr1().modify(|_, w| w.tcie().disabled());
                self.is_sending = false;
            }
        }
    }
}

/// When the line has been quiet for 3.5 characters, its interrupt comes.
pub struct SilenceTimer(TIM5);

impl SilenceTimer {
    /// Returns the time; what raised the interrupt is cleared.
    pub fn now_us(&mut self) -> u32 {
        self.0.sr().reset();
        now_us()
    }
}
