//! Sampling: TIM3 → ADC1 → DMA2, 20 000 codes a second, with no software in the instant.
//!
//! ```text
//! TIM3 update, 20 kHz ──► ADC1 channel 0 (PA0) ──► DMA2 stream 0 ──► buffer 0 │ buffer 1
//!        └──► TIM2 counts the triggers                                20 codes each, in turn
//! ```
//!
//! The DMA fills one buffer while the task takes the other, and changes over by itself (double
//! buffer mode, section 10.3.9). The task has 1 ms. TIM2 tells whether it was in time: unlike the
//! flag of the DMA, which does not say how often it was set, its count also shows the blocks that
//! went by while the core was held up.
//!
//! An ADC overrun (section 13.8.1) or a DMA error stops the stream for good, and the HAL does not
//! handle it: then blocks are missing, and the supervisor restarts the chain. Only a full buffer
//! raises an interrupt, never an error, because one that comes back at once would starve the rest.
//! The FIFO error flag counts for nothing: in direct mode it may be set without cause, and a true
//! overrun of the DMA leaves a code unread, which the ADC reports as its own overrun.

use core::sync::atomic::{AtomicU16, Ordering, fence};

use stm32f4xx_hal::{
    gpio::PA0,
    pac::{ADC_COMMON, ADC1, DMA2, TIM2, TIM3},
    rcc::{Enable, Rcc, Reset},
};
use trueup_core::units::Code;

use super::{
    super::{BLOCK, Block},
    within,
};

/// Conversions in one second.
const SAMPLES_PER_SECOND: u32 = 20_000;
/// [`BLOCK`] as the DMA counts it.
const BLOCK_LENGTH: u16 = BLOCK as u16;
/// Clocks of the converter for 480 of sampling and 12 of conversion (section 13.5).
const LONGEST_CONVERSION: u32 = 480 + 12;
/// A stream stops within one transfer, far less than a microsecond; this is some ten.
const STOP_POLLS: u32 = 200;

/// What the DMA writes. Atomic, so that the compiler expects the values to change by themselves;
/// in the SRAM of the bus matrix, because the DMA does not reach the core-coupled memory.
static BUFFERS: [[AtomicU16; BLOCK]; 2] = [const { [const { AtomicU16::new(0) }; BLOCK] }; 2];

/// The peripherals that make up the chain.
pub struct Chain {
    /// Triggers the converter.
    pub tim3: TIM3,
    /// Counts the triggers.
    pub tim2: TIM2,
    /// Converts.
    pub adc: ADC1,
    /// Moves the codes to memory.
    pub dma: DMA2,
}

/// Sets the chain up, and starts it. The clock of DMA2 is on.
pub fn start(chain: Chain, pin: PA0, common: &ADC_COMMON, rcc: &mut Rcc) -> Samples {
    pin.into_analog();
    let timer_hz = rcc.clocks.timclk1().raw();
    let bus_hz = rcc.clocks.pclk2().raw();
    set_up_timers(&chain, timer_hz, rcc);
    set_up_converter(&chain.adc, common, bus_hz, rcc);
    let mut samples = Samples { chain, taken: 0, lost: 0, restarts: 0 };
    samples.arm();
    samples
}

/// Both 84 MHz and 16 MHz are whole multiples of 20 kHz, so the rate is as exact as the clock.
fn set_up_timers(chain: &Chain, timer_hz: u32, rcc: &mut Rcc) {
    TIM3::enable(rcc);
    TIM3::reset(rcc);
    let period = u16::try_from(timer_hz / SAMPLES_PER_SECOND - 1)
        .expect("84 MHz / 20 kHz = 4200 fits 16 bits");
    chain.tim3.arr().write(|w| w.arr().set(period));
    chain.tim3.cr2().write(|w| w.mms().update());

    TIM2::enable(rcc);
    TIM2::reset(rcc);
    // ITR2 of TIM2 is TIM3 (section 18.4.3, table "internal trigger connection").
    chain.tim2.smcr().write(|w| w.ts().itr2().sms().ext_clock_mode());
    chain.tim2.cr1().write(|w| w.cen().enabled());
}

/// One channel, 12 bits, right-aligned. A quarter of APB2 is 21 MHz, below the limit of 36 MHz
/// (data sheet, ADC characteristics), and lets the pin settle for as long as the converter offers:
/// 480 clocks, 22.9 µs. At 16 MHz that would outlast the period, and 144 clocks take 36 µs.
fn set_up_converter(adc: &ADC1, common: &ADC_COMMON, bus_hz: u32, rcc: &mut Rcc) {
    ADC1::enable(rcc);
    ADC1::reset(rcc);
    common.ccr().modify(|_, w| w.adcpre().div4());
    let longest_fits = bus_hz / 4 >= LONGEST_CONVERSION * SAMPLES_PER_SECOND;
    adc.smpr2().write(|w| if longest_fits { w.smp0().cycles480() } else { w.smp0().cycles144() });
    // A sequence of one, channel 0, and no scan are what the reset left.
}

/// Blocks of conversions, one every millisecond.
pub struct Samples {
    chain: Chain,
    /// Triggers up to the end of the last block that was taken.
    taken: u32,
    lost: u32,
    restarts: u32,
}

impl Samples {
    /// The block that is complete. `None`: there is none, or one was lost; then the chain has
    /// been restarted, so that the next block is whole.
    pub fn take(&mut self) -> Option<Block> {
        let status = self.chain.dma.lisr().read();
        self.clear_flags();
        let overrun = self.chain.adc.sr().read().ovr().is_overrun();
        let failed = overrun || status.teif0().is_error() || status.dmeif0().is_error();
        if !failed && status.tcif0().is_not_complete() {
            return None;
        }
        let codes = self.copy_complete();
        if failed || self.is_late() {
            self.note_loss();
            self.arm();
            return None;
        }
        self.taken = self.taken.wrapping_add(u32::from(BLOCK_LENGTH));
        Some(Block { codes, speed: None, temperatures: None })
    }

    /// Starts the chain anew, whatever state it is in: called when blocks are missing.
    pub fn restart(&mut self) {
        self.restarts = self.restarts.saturating_add(1);
        // A converter that stays dead must not fill the log.
        if self.restarts.is_power_of_two() {
            defmt::warn!("sampling restarted, restart number {}", self.restarts);
        }
        self.arm();
    }

    /// The buffer that the DMA is not filling.
    fn copy_complete(&self) -> [Code; BLOCK] {
        let filling_first = self.chain.dma.st(0).cr().read().ct().is_memory0();
        let complete = &BUFFERS[usize::from(filling_first)];
        // The codes are read after the flag that says they are there, and before the count that
        // says they still were.
        fence(Ordering::SeqCst);
        let codes = core::array::from_fn(|n| Code(complete[n].load(Ordering::Relaxed)));
        fence(Ordering::SeqCst);
        codes
    }

    /// Whether the DMA may by now be writing into the buffer that was just copied: two blocks'
    /// worth of triggers have gone by since the last block was taken.
    fn is_late(&self) -> bool {
        let triggers = self.chain.tim2.cnt().read().cnt().bits();
        triggers.wrapping_sub(self.taken) >= 2 * u32::from(BLOCK_LENGTH)
    }

    fn note_loss(&mut self) {
        self.lost = self.lost.saturating_add(1);
        // One that comes back every millisecond must not fill the log.
        if self.lost.is_power_of_two() {
            defmt::warn!("samples lost, loss number {}", self.lost);
        }
    }

    /// Stops every link of the chain, and starts them from the far end, so that the first trigger
    /// finds the rest waiting.
    fn arm(&mut self) {
        self.chain.tim3.cr1().modify(|_, w| w.cen().disabled());
        // Off and on again: drops a conversion under way and a request that was not served.
        self.chain.adc.cr2().reset();
        self.chain.adc.sr().reset();
        if !self.stop_stream() {
            return;
        }
        self.start_stream();
        // Requests go on past the last transfer of a buffer (DDS), as circular mode needs.
        self.chain.adc.cr2().write(|w| {
            w.exten().rising_edge().extsel().tim3trgo();
            w.dma().enabled().dds().continuous().adon().enabled()
        });
        self.chain.tim2.cnt().write(|w| w.cnt().set(0));
        self.taken = 0;
        // The first trigger comes 50 µs from here; the converter is ready after 3 µs.
        self.chain.tim3.cnt().write(|w| w.cnt().set(0));
        self.chain.tim3.cr1().modify(|_, w| w.cen().enabled());
    }

    fn stop_stream(&mut self) -> bool {
        let stream = self.chain.dma.st(0);
        stream.cr().modify(|_, w| w.en().disabled());
        within(STOP_POLLS, || stream.cr().read().en().is_disabled())
    }

    /// DMA2 stream 0 channel 0 is ADC1 (section 10.3.3). The order is that of section 10.3.17.
    #[allow(unsafe_code, reason = "addresses for the DMA")]
    fn start_stream(&mut self) {
        let source = self.chain.adc.dr().as_ptr() as u32;
        let [first, second] = BUFFERS.each_ref().map(|buffer| buffer.as_ptr() as u32);
        let stream = self.chain.dma.st(0);
        // SAFETY: the stream is off. It will read the data register of the ADC and write
        // `BLOCK_LENGTH` half-words to each buffer; both are static, of that size, and atomic.
        unsafe {
            stream.par().write(|w| w.pa().bits(source));
            stream.m0ar().write(|w| w.m0a().bits(first));
            stream.m1ar().write(|w| w.m1a().bits(second));
        }
        stream.ndtr().write(|w| w.ndt().set(BLOCK_LENGTH));
        // Direct mode, no FIFO.
        stream.fcr().reset();
        stream.cr().write(|w| {
            w.chsel().set(0).pl().very_high().dir().peripheral_to_memory();
            w.psize().bits16().msize().bits16().minc().incremented();
            w.circ().enabled().dbm().enabled().ct().memory0().tcie().enabled()
        });
        self.clear_flags();
        stream.cr().modify(|_, w| w.en().enabled());
    }

    fn clear_flags(&self) {
        self.chain.dma.lifcr().write(|w| {
            w.ctcif0().clear().chtif0().clear().cteif0().clear();
            w.cdmeif0().clear().cfeif0().clear()
        });
    }
}
