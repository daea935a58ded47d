//! The serial line: USART1, 921 600 Bd, 8N1, on PA9 and PA10 (section 30).
//!
//! USART1 sits on APB2: 84 MHz come to within 0.16 % of the rate, APB1's 42 MHz only to 0.93 %.
//! Bytes come in by interrupt and go out by polling: the task that sends is the lowest, so nobody
//! waits for it, and it needs neither the transmit interrupt nor a DMA stream.

use embedded_hal_nb::serial::{Read, Write};
use stm32f4xx_hal::{
    gpio::{PA9, PA10, Pull},
    nb,
    pac::USART1,
    prelude::*,
    rcc::Rcc,
    serial::{Config, Rx1, Serial, Tx1},
};

use super::within;

/// Polls that a byte may take to leave: some 20 times what it needs at 921 600 Bd.
const SEND_POLLS: u32 = 4_096;

/// Sets up both directions, with an interrupt for every byte that comes in.
pub fn start(usart: USART1, tx: PA9, rx: PA10, rcc: &mut Rcc) -> (SerialIn, SerialOut) {
    // Pulled up, so that an open line is quiet.
    let rx = rx.into_alternate().internal_resistor(Pull::Up);
    let config = Config::default().baudrate(921_600.bps());
    let (tx, mut rx) = Serial::new(usart, (tx, rx), config, rcc)
        .expect("921 600 Bd is within reach of 84 MHz and of 16 MHz")
        .split();
    rx.listen();
    (SerialIn { rx, errors: 0 }, SerialOut { tx })
}

/// Bytes from the CNC.
pub struct SerialIn {
    rx: Rx1,
    errors: u32,
}

impl SerialIn {
    /// The byte that came in. `None`: there is none, or it came damaged, or the one after it was
    /// lost; reading has cleared the error then, and the checksum of the frame tells the rest.
    pub fn read(&mut self) -> Option<u8> {
        match Read::read(&mut self.rx) {
            Ok(byte) => Some(byte),
            Err(nb::Error::WouldBlock) => None,
            Err(nb::Error::Other(error)) => {
                self.errors = self.errors.saturating_add(1);
                // A line full of noise must not fill the log as well.
                if self.errors.is_power_of_two() {
                    defmt::warn!(
                        "serial: {}, error number {}",
                        defmt::Debug2Format(&error),
                        self.errors
                    );
                }
                None
            }
        }
    }
}

/// Bytes to the CNC.
pub struct SerialOut {
    tx: Tx1,
}

impl SerialOut {
    /// Sends a byte, or drops it if the transmitter does not take it: a dead one must not hang us.
    pub fn write(&mut self, byte: u8) {
        let _sent = within(SEND_POLLS, || Write::write(&mut self.tx, byte).is_ok());
    }
}
