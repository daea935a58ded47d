//! Sampling: TIM3 → ADC1 → DMA2, 20 000 codes a second, with no software in the instant.
//!
//! ```text
//! TIM3 update, 20 kHz ──► ADC1 channel 0 (PA0) ──► DMA2 stream 0 ──► buffer 0 │ buffer 1
//!   │    └──► TIM2 counts the triggers                                20 codes each, in turn
//!   └ compare 1 ──► ADC2, the linear inputs        (both when the sensor's conversion is over)
//!     compare 4 ──► ADC1 injected, VREFINT ──► JDR1
//! ```
//!
//! The other inputs are converted in the part of the 50 µs that the sensor leaves, so that neither
//! converter samples while the other one decides a bit of the sensor's code, and no conversion of the
//! sensor is ever broken off.
//!
//! | APB2 | converter clock | sensor | VREFINT, at least 10 µs of sampling | together, of 50 µs |
//! |---|---|---|---|---|
//! | 84 MHz | 21 MHz | 480 + 12 cycles, 23.4 µs | 480 + 12 cycles, 23.4 µs | 47.9 µs |
//! | 72 MHz, internal oscillator | 18 MHz | 144 + 12, 8.7 µs | 480 + 12, 27.3 µs | 37.0 µs |
//! | 16 MHz, no PLL | 8 MHz | 144 + 12, 19.5 µs | 112 + 12, 15.5 µs | 36.0 µs |
//!
//! The DMA fills one buffer while the task takes the other, and changes over by itself (double
//! buffer mode, section 10.3.9). The task has 1 ms. TIM2 shows whether it was in time: unlike the
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
    pac::{
        ADC_COMMON, ADC1, DMA2, TIM2, TIM3, adc_common::ccr::ADCPRE, adc1::smpr1::SMP10 as Cycles,
    },
    rcc::{Enable, Rcc, Reset},
    signature::VrefCal,
};
use trueup_core::units::AdcCode;

use super::{
    super::{Block, BlockCodes, CODES_PER_BLOCK},
    poll_until,
};

/// Conversions in one second.
const SAMPLES_PER_SECOND: u32 = 20_000;
/// [`CODES_PER_BLOCK`] as the DMA counts it.
const DMA_BLOCK_LENGTH: u16 = CODES_PER_BLOCK as u16;
/// The channel of the internal reference, VREFINT (section 13.3.3).
const VREFINT_CHANNEL: u8 = 17;
/// Between the end of the sensor's conversion and the next one, in microseconds.
const CONVERSION_GAP_US: u32 = 1;
/// The supply's share of 3.3 V, in thousandths, by which it may differ before the log remarks it.
const SUPPLY_TOLERANCE_PER_MILLE: u32 = 50;
/// A stream stops within one transfer, far less than a microsecond; this is some ten.
const MAX_STOP_POLLS: u32 = 200;

/// Buffers that the DMA writes. Atomic, so that the compiler expects the values to change by themselves;
/// in the SRAM of the bus matrix, because the DMA does not reach the core-coupled memory.
static DMA_BUFFERS: [[AtomicU16; CODES_PER_BLOCK]; 2] =
    [const { [const { AtomicU16::new(0) }; CODES_PER_BLOCK] }; 2];

/// The peripherals that make up the chain.
pub struct SamplingChain {
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
pub fn start(chain: SamplingChain, pin: PA0, common: &ADC_COMMON, rcc: &mut Rcc) -> Sampler {
    pin.into_analog();
    let timer_hz = rcc.clocks.timclk1().raw();
    let bus_hz = rcc.clocks.pclk2().raw();
    let plan = SamplingTiming::from_bus_clock(bus_hz);
    set_up_timers(&chain, timer_hz, plan.pause_start_count(bus_hz, timer_hz), rcc);
    set_up_converter(&chain.adc, common, &plan, rcc);
    let mut samples = Sampler { chain, taken: 0, lost: 0, restarts: 0, remarked: false };
    samples.arm();
    samples
}

/// How the 50 µs are shared.
pub struct SamplingTiming {
    divider: ADCPRE,
    /// The clock of APB2 by it.
    divided_by: u32,
    sensor: Cycles,
    sensor_cycles: u32,
    /// For VREFINT and the linear inputs.
    others: Cycles,
}

impl SamplingTiming {
    /// By the clock of APB2. A quarter of 84 MHz is below the limit of 36 MHz (data sheet, ADC
    /// characteristics), and lets the sensor's pin settle for as long as the converter offers.
    pub fn from_bus_clock(bus_hz: u32) -> Self {
        let (divider, divided_by, sensor, sensor_cycles, others) = match bus_hz {
            84_000_000.. => (ADCPRE::Div4, 4, Cycles::Cycles480, 480, Cycles::Cycles480),
            20_000_000.. => (ADCPRE::Div4, 4, Cycles::Cycles144, 144, Cycles::Cycles480),
            _ => (ADCPRE::Div2, 2, Cycles::Cycles144, 144, Cycles::Cycles112),
        };
        Self { divider, divided_by, sensor, sensor_cycles, others }
    }

    /// Sampling of what is not the sensor.
    pub fn auxiliary_sampling_time(&self) -> Cycles {
        self.others
    }

    /// When the sensor's conversion is over, in counts of the timer. A conversion is 12 cycles of
    /// deciding after those of sampling (section 13.5).
    fn pause_start_count(&self, bus_hz: u32, timer_hz: u32) -> u16 {
        let counts_per_cycle = self.divided_by * (timer_hz / bus_hz);
        let count =
            (self.sensor_cycles + 12) * counts_per_cycle + timer_hz / 1_000_000 * CONVERSION_GAP_US;
        let Ok(count) = u16::try_from(count) else { panic!("less than a period of the timer") };
        count
    }
}

/// 84, 72 and 16 MHz are whole multiples of 20 kHz, so the rate is as exact as the clock.
fn set_up_timers(chain: &SamplingChain, timer_hz: u32, pause: u16, rcc: &mut Rcc) {
    TIM3::enable(rcc);
    TIM3::reset(rcc);
    let Ok(period) = u16::try_from(timer_hz / SAMPLES_PER_SECOND - 1) else {
        panic!("84 MHz / 20 kHz = 4200 fits 16 bits")
    };
    chain.tim3.arr().write(|w| w.arr().set(period));
    chain.tim3.cr2().write(|w| w.mms().update());
    // PWM mode 2: the output rises at the compare value, once in a period, and that is the event.
    chain.tim3.ccr1().write(|w| w.ccr().set(pause));
    chain.tim3.ccr4().write(|w| w.ccr().set(pause));
    chain.tim3.ccmr1_output().write(|w| w.oc1m().pwm_mode2());
    chain.tim3.ccmr2_output().write(|w| w.oc4m().pwm_mode2());
    chain.tim3.ccer().write(|w| w.cc1e().enabled().cc4e().enabled());

    TIM2::enable(rcc);
    TIM2::reset(rcc);
    // ITR2 of TIM2 is TIM3 (section 18.4.3, table "internal trigger connection").
    chain.tim2.smcr().write(|w| w.ts().itr2().sms().ext_clock_mode());
    chain.tim2.cr1().write(|w| w.cen().enabled());
}

/// One channel, 12 bits, right-aligned; and as injected one VREFINT, which needs its switch and 10 µs.
#[allow(unsafe_code, reason = "a channel of the converter")]
fn set_up_converter(adc: &ADC1, common: &ADC_COMMON, plan: &SamplingTiming, rcc: &mut Rcc) {
    ADC1::enable(rcc);
    // Resets all three converters.
    ADC1::reset(rcc);
    common.ccr().modify(|_, w| w.adcpre().variant(plan.divider).tsvrefe().enabled());
    adc.smpr2().write(|w| w.smp0().variant(plan.sensor));
    adc.smpr1().write(|w| w.smp17().variant(plan.others));
    // Of a sequence of one it is the fourth that counts (section 13.13.12).
    // SAFETY: a channel that the converter has, in the five bits of JSQ4.
    unsafe { adc.jsqr().write(|w| w.jsq4().bits(VREFINT_CHANNEL)) };
    // A regular sequence of one, channel 0, and no scan are what the reset left.
}

/// Blocks of conversions, one every millisecond.
pub struct Sampler {
    chain: SamplingChain,
    /// Triggers up to the end of the last block that was taken.
    taken: u32,
    lost: u32,
    restarts: u32,
    /// The supply was held against the factory's value.
    remarked: bool,
}

impl Sampler {
    /// Returns the block that is complete, its codes in `codes`. `None`: there is none, or one was lost; then the chain has
    /// been restarted, so that the next block is whole.
    pub fn take_block(&mut self, codes: &mut BlockCodes) -> Option<Block> {
        let status = self.chain.dma.lisr().read();
        self.clear_flags();
        let overrun = self.chain.adc.sr().read().ovr().is_overrun();
        let failed = overrun || status.teif0().is_error() || status.dmeif0().is_error();
        if !failed && status.tcif0().is_not_complete() {
            return None;
        }
        self.copy_complete_buffer(codes);
        if failed || self.is_late() {
            self.count_lost_block();
            self.arm();
            return None;
        }
        self.taken = self.taken.wrapping_add(u32::from(DMA_BLOCK_LENGTH));
        Some(Block { speed: None, temperatures: None })
    }

    /// Returns the last code of the chip's internal reference; `None` before the first.
    pub fn read_internal_reference_code(&mut self) -> Option<AdcCode> {
        let code = self.chain.adc.jdr1().read().jdata().bits();
        let code = (code != 0).then_some(AdcCode(code))?;
        if !core::mem::replace(&mut self.remarked, true) {
            log_supply_deviation(code);
        }
        Some(code)
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

    /// Copies the buffer that the DMA is not filling.
    fn copy_complete_buffer(&self, codes: &mut BlockCodes) {
        let filling_first = self.chain.dma.st(0).cr().read().ct().is_memory0();
        let complete = &DMA_BUFFERS[usize::from(filling_first)];
        // The codes are read after the flag that says they are there, and before the count that
        // says they still were.
        fence(Ordering::SeqCst);
        for (place, code) in codes.iter_mut().zip(complete) {
            *place = AdcCode(code.load(Ordering::Relaxed));
        }
        fence(Ordering::SeqCst);
    }

    /// Returns whether the DMA may by now be writing into the buffer that was just copied: two blocks'
    /// worth of triggers have gone by since the last block was taken.
    fn is_late(&self) -> bool {
        let triggers = self.chain.tim2.cnt().read().cnt().bits();
        triggers.wrapping_sub(self.taken) >= 2 * u32::from(DMA_BLOCK_LENGTH)
    }

    fn count_lost_block(&mut self) {
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
            w.jexten().rising_edge().jextsel().tim3cc4();
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
        poll_until(MAX_STOP_POLLS, || stream.cr().read().en().is_disabled())
    }

    /// DMA2 stream 0 channel 0 is ADC1 (section 10.3.3). The order is that of section 10.3.17.
    #[allow(unsafe_code, reason = "addresses for the DMA")]
    fn start_stream(&mut self) {
        let source = self.chain.adc.dr().as_ptr() as u32;
        let [first, second] = DMA_BUFFERS.each_ref().map(|buffer| buffer.as_ptr() as u32);
        let stream = self.chain.dma.st(0);
        // SAFETY: the stream is off. It will read the data register of the ADC and write
        // `DMA_BLOCK_LENGTH` half-words to each buffer; both are static, of that size, and atomic.
        unsafe {
            stream.par().write(|w| w.pa().bits(source));
            stream.m0ar().write(|w| w.m0a().bits(first));
            stream.m1ar().write(|w| w.m1a().bits(second));
        }
        stream.ndtr().write(|w| w.ndt().set(DMA_BLOCK_LENGTH));
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

/// Logs the supply by the factory's value, which was taken at 3.3 V (data sheet, VREFINT_CAL): it is no
/// more than a remark, because a board may be made for another supply.
fn log_supply_deviation(code: AdcCode) {
    let factory = u32::from(VrefCal::get().read());
    let millivolts = 3_300 * factory / u32::from(code.0);
    if factory == 0 || factory >= u32::from(AdcCode::MAX.0) {
        defmt::info!("the chip has no factory value of its internal reference");
    } else if millivolts.abs_diff(3_300) > 3_300 * SUPPLY_TOLERANCE_PER_MILLE / 1_000 {
        defmt::warn!("supply: {=u32} mV by the factory's value, expected 3300", millivolts);
    } else {
        defmt::info!("supply: {=u32} mV by the factory's value", millivolts);
    }
}
