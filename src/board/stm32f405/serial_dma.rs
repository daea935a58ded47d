//! The DMA of the serial line (section 10.3.3): DMA2 stream 2 brings bytes in, stream 7 takes them out,
//! both on channel 4.
//!
//! Incoming bytes go round a ring; its two interrupts, half-way and at the end, and the pause of the line
//! say when to look. Outgoing bytes go in pieces of up to 128, with an interrupt at the end of each.
//! Stream 0 of the same controller is the converter's: each clears its own flags only.

use core::sync::atomic::{AtomicU8, AtomicU32, Ordering, fence};

use stm32f4xx_hal::pac::{DMA2, USART1, dma2::ST};

use super::poll_until;

/// Half of it is 1.39 ms of the line, the time to look.
const RX_RING_LENGTH: usize = 256;
/// Bytes that go out in one piece: 1.39 ms of the line.
const TX_BUFFER_LENGTH: usize = 128;
/// Channel of both streams.
const DMA_CHANNEL: u8 = 4;
/// A stream stops within one transfer, far less than a microsecond; this is some ten.
const MAX_STOP_POLLS: u32 = 200;

/// Memory that the DMA writes and reads. Atomic, so that the compiler expects the values to change by
/// themselves; in the SRAM of the bus matrix, which the DMA reaches.
static RX_BUFFER: [AtomicU8; RX_RING_LENGTH] = [const { AtomicU8::new(0) }; RX_RING_LENGTH];
/// Words, so that four bytes go in at once.
static TX_BUFFER: [AtomicU32; TX_BUFFER_LENGTH / 4] =
    [const { AtomicU32::new(0) }; TX_BUFFER_LENGTH / 4];

#[allow(unsafe_code, reason = "registers of the DMA")]
fn steal_dma2() -> DMA2 {
    // SAFETY: of the registers that the streams share, only flags are written, each its own.
    unsafe { DMA2::steal() }
}

/// Where both streams read or write: the data register of the USART.
fn data_register_address() -> u32 {
    USART1::ptr() as u32 + 4
}

fn stop_stream(stream: &ST) -> bool {
    stream.cr().modify(|_, w| w.en().disabled());
    poll_until(MAX_STOP_POLLS, || stream.cr().read().en().is_disabled())
}

/// Bytes that come in.
pub struct RxStream {
    dma: DMA2,
    /// Place in the ring of the next byte to be read.
    read: usize,
    /// Whether a byte has come since the stream was started.
    has_moved: bool,
}

impl RxStream {
    /// Starts the stream; `None`: there is no DMA.
    pub fn start() -> Option<Self> {
        let mut incoming = Self { dma: steal_dma2(), read: 0, has_moved: true };
        incoming.restart().then_some(incoming)
    }

    /// Starts the stream anew; `false`: it does not run, or has not moved since the last start.
    #[allow(unsafe_code, reason = "addresses for the DMA")]
    pub fn restart(&mut self) -> bool {
        let stream = self.dma.st(2);
        if !self.has_moved || !stop_stream(stream) {
            return false;
        }
        self.has_moved = false;
        self.read = 0;
        // SAFETY: the stream is off. It will read the data register of the USART and write `RX_RING_LENGTH` bytes,
        // which are static and atomic.
        unsafe {
            stream.par().write(|w| w.pa().bits(data_register_address()));
            stream.m0ar().write(|w| w.m0a().bits(RX_BUFFER.as_ptr() as u32));
        }
        stream.ndtr().write(|w| w.ndt().set(RX_RING_LENGTH as u16));
        stream.fcr().reset();
        stream.cr().write(|w| {
            w.chsel().set(DMA_CHANNEL).pl().high().dir().peripheral_to_memory();
            w.psize().bits8().msize().bits8().minc().incremented();
            w.circ().enabled().htie().enabled().tcie().enabled()
        });
        self.clear_flags();
        stream.cr().modify(|_, w| w.en().enabled());
        stream.cr().read().en().is_enabled()
    }

    /// Hands over the bytes of the ring.
    pub fn read(&mut self, mut take: impl FnMut(u8)) {
        // Before the count is read: an interrupt that comes after it asks again.
        self.clear_flags();
        let left = usize::from(self.dma.st(2).ndtr().read().ndt().bits());
        let written = (RX_RING_LENGTH - left.min(RX_RING_LENGTH)) % RX_RING_LENGTH;
        if self.read == written {
            return;
        }
        fence(Ordering::SeqCst);
        self.has_moved = true;
        let mut read = self.read;
        while read != written {
            take(RX_BUFFER[read % RX_RING_LENGTH].load(Ordering::Relaxed));
            read = (read + 1) % RX_RING_LENGTH;
        }
        self.read = read;
    }

    fn clear_flags(&self) {
        self.dma.lifcr().write(|w| {
            w.ctcif2().clear().chtif2().clear().cteif2().clear();
            w.cdmeif2().clear().cfeif2().clear()
        });
    }
}

/// Bytes that go out.
pub struct TxStream {
    dma: DMA2,
    /// Bytes of the last piece.
    count: usize,
    /// Bytes left when they were last counted.
    left: u16,
}

impl TxStream {
    pub fn new() -> Self {
        Self { dma: steal_dma2(), count: 0, left: 0 }
    }

    /// Returns whether a piece is still going out.
    pub fn is_busy(&self) -> bool {
        self.dma.st(7).cr().read().en().is_enabled()
    }

    /// Returns whether a piece is going out, and has moved since the last call.
    pub fn is_progressing(&mut self) -> bool {
        // A flag that stays would raise its interrupt again at once.
        self.clear_flags();
        let left = self.dma.st(7).ndtr().read().ndt().bits();
        let has_moved = left != self.left;
        self.left = left;
        has_moved && self.is_busy()
    }

    /// Gives up, and gives the bytes that have not gone out.
    pub fn abort(self) -> impl Iterator<Item = u8> {
        let left = usize::from(self.dma.st(7).ndtr().read().ndt().bits());
        stop_stream(self.dma.st(7));
        // A stream that is switched off says that it is complete (section 10.3.14), and no code is left that would clear
        // that: its interrupt would come for ever.
        self.dma.st(7).cr().reset();
        self.clear_flags();
        let bytes = TX_BUFFER.iter().flat_map(|word| word.load(Ordering::Relaxed).to_le_bytes());
        bytes.take(self.count).skip(self.count.saturating_sub(left))
    }

    /// Sends what `fill` puts into the buffer, and gives how much that is. No piece is going out.
    // A function of its own in the image: its time is bounded by how often a piece leaves (`cargo xtask bounds`).
    #[inline(never)]
    #[allow(unsafe_code, reason = "addresses for the DMA")]
    pub fn send(&mut self, fill: impl FnOnce(&mut [u8]) -> usize) -> usize {
        let mut bytes = [0; TX_BUFFER_LENGTH];
        let count = fill(&mut bytes).min(TX_BUFFER_LENGTH);
        if count == 0 {
            return 0;
        }
        for (place, word) in TX_BUFFER.iter().zip(bytes.as_chunks().0) {
            place.store(u32::from_le_bytes(*word), Ordering::Relaxed);
        }
        let stream = self.dma.st(7);
        // SAFETY: the stream is off. It will read `count` bytes, which are static and atomic, and write
        // the data register of the USART.
        unsafe {
            stream.par().write(|w| w.pa().bits(data_register_address()));
            stream.m0ar().write(|w| w.m0a().bits(TX_BUFFER.as_ptr() as u32));
        }
        self.count = count;
        self.left = count as u16;
        stream.ndtr().write(|w| w.ndt().set(self.left));
        stream.fcr().reset();
        stream.cr().write(|w| {
            w.chsel().set(DMA_CHANNEL).pl().low().dir().memory_to_peripheral();
            w.psize().bits8().msize().bits8().minc().incremented().tcie().enabled()
        });
        self.clear_flags();
        // The bytes are in memory before the DMA looks.
        fence(Ordering::SeqCst);
        stream.cr().modify(|_, w| w.en().enabled());
        count
    }

    fn clear_flags(&self) {
        self.dma.hifcr().write(|w| {
            w.ctcif7().clear().chtif7().clear().cteif7().clear();
            w.cdmeif7().clear().cfeif7().clear()
        });
    }
}
