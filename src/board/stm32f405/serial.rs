//! The serial line: USART1, 921 600 Bd, 8N1, on PA9 and PA10 (section 30).
//!
//! USART1 sits on APB2: 84 MHz come to within 0.16 % of the rate, APB1's 42 MHz only to 0.93 %.
//! The DMA moves the bytes both ways ([`super::serial_dma`]): so none is lost while the flash is
//! programmed or interrupts are held off, and no task waits for a byte to leave. Where the DMA does not
//! move, as in an emulator, the board says so and falls back: bytes come in by interrupt and go out by
//! polling, in the lowest task.

use cortex_m::asm;
use embedded_hal_nb::serial::{Read, Write};
use stm32f4xx_hal::{
    gpio::{PA9, PA10, Pull},
    nb,
    pac::USART1,
    prelude::*,
    rcc::Rcc,
    serial::{Config, Error, Rx1, Serial, Tx1},
};

use super::{
    super::TransmitState,
    poll_until,
    serial_dma::{RxStream, TxStream},
};

/// Polls that a byte may take to leave: some 20 times what it needs at 921 600 Bd.
const MAX_SEND_POLLS: u32 = 4_096;
/// Milliseconds after which a DMA that has not moved is dead: a byte takes 11 µs.
const DMA_TIMEOUT_MS: u32 = 10;
/// Bytes that are polled out in one turn, 0.17 ms of the line: `transmit` and what it holds up wait for that.
const MAX_POLLED_BYTES: usize = 16;

/// Polls until what waits has left: 4.2 ms for all that a port and a piece of the DMA hold, less than the watchdog's
/// patience at 16 MHz.
const MAX_FLUSH_POLLS: u32 = 100_000;
/// Clocks that two bytes need, the one that leaves and the one behind it, at 168 MHz.
const TWO_BYTE_CYCLES: u32 = 4_000;

/// Waits until the DMA has no more bytes, from a task below those that give it some, and the last have left.
pub fn wait_until_sent() {
    let outgoing = TxStream::new();
    poll_until(MAX_FLUSH_POLLS, || !outgoing.is_busy());
    // Not by the flag that says so: it stays from an earlier piece (section 30.3.13).
    asm::delay(TWO_BYTE_CYCLES);
}

/// Sets up both directions. The clock of DMA2 is on.
pub fn start(usart: USART1, tx: PA9, rx: PA10, rcc: &mut Rcc) -> (SerialRx, SerialTx) {
    // Pulled up, so that an open line is quiet.
    let rx = rx.into_alternate().internal_resistor(Pull::Up);
    let config = Config::default().baudrate(921_600.bps());
    // Not by `expect`: the text of an error that is never printed takes 1 kB of the flash.
    let Ok(serial) = Serial::new(usart, (tx, rx), config, rcc) else {
        panic!("921 600 Bd is within reach of 84 MHz and of 16 MHz")
    };
    let (tx, rx) = serial.split();
    let mut serial_in = SerialRx { rx, incoming: RxStream::start(), errors: 0 };
    if serial_in.incoming.is_some() {
        serial_in.enable_dma_and_idle_interrupt();
    } else {
        defmt::error!("dead: DMA of the serial line, it is polled");
        serial_in.rx.listen();
    }
    let outgoing = serial_in.incoming.is_some().then(TxStream::new);
    (serial_in, SerialTx { tx, outgoing, moved_ms: 0 })
}

/// Bytes from the CNC.
pub struct SerialRx {
    rx: Rx1,
    /// `None`: the DMA is dead, and each byte has its interrupt.
    incoming: Option<RxStream>,
    errors: u32,
}

impl SerialRx {
    /// Hands over the bytes that came in. What came damaged or was lost is missing: the checksum of the frame shows it.
    pub fn read(&mut self, take: impl FnMut(u8)) {
        if self.incoming.is_some() {
            self.read_dma(take);
        } else {
            // Another one raises the interrupt again.
            self.read_polled().into_iter().for_each(take);
        }
    }

    /// An interrupt when the line pauses for a byte's time; the DMA raises its own, half-way and at the
    /// end of its ring.
    #[allow(unsafe_code, reason = "registers of the USART")]
    fn enable_dma_and_idle_interrupt(&mut self) {
        // SAFETY: the transmitter's bits of these registers are set in one step, before it runs.
        let usart = unsafe { USART1::steal() };
        usart.cr3().modify(|_, w| w.dmar().enabled().dmat().enabled());
        usart.cr1().modify(|_, w| w.idleie().enabled());
    }

    #[allow(unsafe_code, reason = "registers of the USART")]
    fn read_dma(&mut self, take: impl FnMut(u8)) {
        // SAFETY: this side alone reads the status for what came in.
        let usart = unsafe { USART1::steal() };
        let status = usart.sr().read();
        if status.idle().bit_is_set() || status.ore().bit_is_set() {
            // Reading the data register clears both. No byte is taken from the DMA by it: after a pause
            // the next one is 10 µs away, and one that was overrun has come while the DMA stood.
            let _cleared = usart.dr().read();
        }
        let Some(incoming) = &mut self.incoming else { return };
        if status.ore().bit_is_set() && !incoming.restart() {
            defmt::error!("dead: DMA of the serial line, bytes come in by interrupt");
            usart.cr3().modify(|_, w| w.dmar().disabled());
            usart.cr1().modify(|_, w| w.idleie().disabled());
            self.incoming = None;
            self.rx.listen();
            return;
        }
        incoming.read(take);
    }

    /// Returns the next byte. `None`: there is none, or it came damaged, or the one after it was lost; reading has cleared the
    /// error then.
    fn read_polled(&mut self) -> Option<u8> {
        match Read::read(&mut self.rx) {
            Ok(byte) => Some(byte),
            Err(nb::Error::WouldBlock) => None,
            Err(nb::Error::Other(error)) => {
                self.errors = self.errors.saturating_add(1);
                // A line full of noise must not fill the log as well.
                if self.errors.is_power_of_two() {
                    let what = match error {
                        Error::Overrun => defmt::intern!("overrun"),
                        Error::FrameFormat => defmt::intern!("framing"),
                        Error::Noise => defmt::intern!("noise"),
                        _ => defmt::intern!("parity, or none that is known"),
                    };
                    defmt::warn!("serial: {=istr}, error number {}", what, self.errors);
                }
                None
            }
        }
    }
}

/// Bytes to the CNC.
pub struct SerialTx {
    tx: Tx1,
    /// `None`: the DMA is dead, and bytes are polled out.
    outgoing: Option<TxStream>,
    /// When the DMA last moved, or had nothing to move.
    moved_ms: u32,
}

impl SerialTx {
    /// Hands over what waits, which `fill` gives a piece at a time; an interrupt comes when there is room
    /// for more. Where the DMA is dead nothing is taken: it is for [`Self::transmit_polled`].
    pub fn send(
        &mut self,
        now_ms: u32,
        is_waiting: bool,
        fill: impl FnMut(&mut [u8]) -> usize,
    ) -> TransmitState {
        let Some(outgoing) = &mut self.outgoing else { return TransmitState::MorePending };
        if outgoing.is_progressing() {
            self.moved_ms = now_ms;
            return TransmitState::Busy;
        }
        if outgoing.is_busy() {
            if now_ms.wrapping_sub(self.moved_ms) > DMA_TIMEOUT_MS {
                defmt::error!("dead: DMA of the serial line, bytes go out by polling");
                for byte in self.outgoing.take().into_iter().flat_map(TxStream::abort) {
                    self.write_byte(byte);
                }
            }
            return TransmitState::Busy;
        }
        self.moved_ms = now_ms;
        if !is_waiting {
            return TransmitState::Idle;
        }
        if outgoing.send(fill) == 0 { TransmitState::Idle } else { TransmitState::Busy }
    }

    /// A byte that the transmitter does not take is dropped: a dead one must not hang us.
    fn write_byte(&mut self, byte: u8) {
        let _sent = poll_until(MAX_SEND_POLLS, || Write::write(&mut self.tx, byte).is_ok());
    }

    /// Polls out a few of the bytes that wait, one by one, where the DMA is dead.
    pub fn transmit_polled(&mut self, mut fill: impl FnMut(&mut [u8]) -> usize) -> TransmitState {
        let mut piece = [0; MAX_POLLED_BYTES];
        let count = fill(&mut piece);
        piece[..count].iter().for_each(|byte| self.write_byte(*byte));
        if count < MAX_POLLED_BYTES { TransmitState::Idle } else { TransmitState::MorePending }
    }
}
