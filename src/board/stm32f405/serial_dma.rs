//! The DMA of the serial line (section 10.3.3): DMA2 stream 2 brings bytes in, stream 7 takes them out,
//! both on channel 4.
//!
//! Incoming bytes go round a ring; its two interrupts, half-way and at the end, and the pause of the line
//! say when to look. Outgoing bytes go in pieces of up to 128, with an interrupt at the end of each.
//! Stream 0 of the same controller is the converter's: each clears its own flags only.

use core::sync::atomic::{AtomicU8, AtomicU32, Ordering, fence};

use stm32f4xx_hal::pac::{DMA2, USART1, dma2::ST};

use super::within;

/// Half of it is 1.39 ms of the line, the time to look.
const RING: usize = 256;
/// Bytes that go out in one piece: 1.39 ms of the line.
const PIECE: usize = 128;
/// Channel of both streams.
const CHANNEL: u8 = 4;
/// A stream stops within one transfer, far less than a microsecond; this is some ten.
const STOP_POLLS: u32 = 200;

/// Memory that the DMA writes and reads. Atomic, so that the compiler expects the values to change by
/// themselves; in the SRAM of the bus matrix, which the DMA reaches.
static IN: [AtomicU8; RING] = [const { AtomicU8::new(0) }; RING];
/// Words, so that four bytes go in at once.
static OUT: [AtomicU32; PIECE / 4] = [const { AtomicU32::new(0) }; PIECE / 4];

#[allow(unsafe_code, reason = "registers of the DMA")]
fn controller() -> DMA2 {
    // SAFETY: of the registers that the streams share, only flags are written, each its own.
    unsafe { DMA2::steal() }
}

/// Where both streams read or write: the data register of the USART.
fn data_register() -> u32 {
    USART1::ptr() as u32 + 4
}

fn stop(stream: &ST) -> bool {
    stream.cr().modify(|_, w| w.en().disabled());
    within(STOP_POLLS, || stream.cr().read().en().is_disabled())
}

/// Bytes that come in.
pub struct Incoming {
    dma: DMA2,
    /// Place in the ring of the next byte to be read.
    read: usize,
    /// Whether a byte has come since the stream was started.
    has_moved: bool,
}

impl Incoming {
    /// Starts the stream; `None`: there is no DMA.
    pub fn start() -> Option<Self> {
        let mut incoming = Self { dma: controller(), read: 0, has_moved: true };
        incoming.restart().then_some(incoming)
    }

    /// Starts the stream anew; `false`: it does not run, or has not moved since the last start.
    #[allow(unsafe_code, reason = "addresses for the DMA")]
    pub fn restart(&mut self) -> bool {
        let stream = self.dma.st(2);
        if !self.has_moved || !stop(stream) {
            return false;
        }
        self.has_moved = false;
        self.read = 0;
        // SAFETY: the stream is off. It will read the data register of the USART and write `RING` bytes,
        // which are static and atomic.
        unsafe {
            stream.par().write(|w| w.pa().bits(data_register()));
            stream.m0ar().write(|w| w.m0a().bits(IN.as_ptr() as u32));
        }
        stream.ndtr().write(|w| w.ndt().set(RING as u16));
        stream.fcr().reset();
        stream.cr().write(|w| {
            w.chsel().set(CHANNEL).pl().high().dir().peripheral_to_memory();
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
        let written = (RING - left.min(RING)) % RING;
        if self.read == written {
            return;
        }
        fence(Ordering::SeqCst);
        self.has_moved = true;
        let mut read = self.read;
        while read != written {
            take(IN[read % RING].load(Ordering::Relaxed));
            read = (read + 1) % RING;
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
pub struct Outgoing {
    dma: DMA2,
    /// Bytes of the last piece.
    count: usize,
    /// Bytes left when they were last counted.
    left: u16,
}

impl Outgoing {
    pub fn new() -> Self {
        Self { dma: controller(), count: 0, left: 0 }
    }

    /// Returns whether a piece is still going out.
    pub fn is_busy(&self) -> bool {
        self.dma.st(7).cr().read().en().is_enabled()
    }

    /// Returns whether a piece is going out, and has moved since this was last asked.
    pub fn is_moving(&mut self) -> bool {
        // A flag that stays would raise its interrupt again at once.
        self.clear_flags();
        let left = self.dma.st(7).ndtr().read().ndt().bits();
        let has_moved = left != self.left;
        self.left = left;
        has_moved && self.is_busy()
    }

    /// Gives up, and gives the bytes that have not gone out.
    pub fn give_up(self) -> impl Iterator<Item = u8> {
        let left = usize::from(self.dma.st(7).ndtr().read().ndt().bits());
        stop(self.dma.st(7));
        // A stream that is switched off says that it is complete (section 10.3.14), and nobody is left who would clear
        // that: its interrupt would come for ever.
        self.dma.st(7).cr().reset();
        self.clear_flags();
        let bytes = OUT.iter().flat_map(|word| word.load(Ordering::Relaxed).to_le_bytes());
        bytes.take(self.count).skip(self.count.saturating_sub(left))
    }

    /// Sends what `fill` puts into the buffer, and gives how much that is. No piece is going out.
    #[allow(unsafe_code, reason = "addresses for the DMA")]
    pub fn send(&mut self, fill: impl FnOnce(&mut [u8]) -> usize) -> usize {
        let mut bytes = [0; PIECE];
        let count = fill(&mut bytes).min(PIECE);
        if count == 0 {
            return 0;
        }
        for (place, word) in OUT.iter().zip(bytes.as_chunks().0) {
            place.store(u32::from_le_bytes(*word), Ordering::Relaxed);
        }
        let stream = self.dma.st(7);
        // SAFETY: the stream is off. It will read `count` bytes, which are static and atomic, and write
        // the data register of the USART.
        unsafe {
            stream.par().write(|w| w.pa().bits(data_register()));
            stream.m0ar().write(|w| w.m0a().bits(OUT.as_ptr() as u32));
        }
        self.count = count;
        self.left = count as u16;
        stream.ndtr().write(|w| w.ndt().set(self.left));
        stream.fcr().reset();
        stream.cr().write(|w| {
            w.chsel().set(CHANNEL).pl().low().dir().memory_to_peripheral();
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
