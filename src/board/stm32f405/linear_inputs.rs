//! Temperature inputs of `kind = "linear"`: eight voltages by the second converter.
//!
//! ```text
//! TIM3 compare 1, 20 kHz ──► ADC2, one of channels 1 … 8 in turn ──► DMA2 stream 3 ──► a ring
//! ```
//!
//! | temperature channel | 0 … 6 | 7 |
//! |---|---|---|
//! | pin, channel of the converter | PA1 … PA7, 1 … 7 | PB0, 8 |
//!
//! Each trigger converts the next channel (discontinuous mode, section 13.3.10) in the pause that the
//! sensor leaves, so a channel has 50 codes in 20 ms, a period of mains of 50 Hz, and 125 in 50 ms, three
//! periods of 60 Hz. Their mean is what it delivers. No software is in it until the mean is taken, ten times a second.

use core::sync::atomic::{AtomicU16, Ordering, fence};

use stm32f4xx_hal::{
    gpio::{PA1, PA2, PA3, PA4, PA5, PA6, PA7, PB0},
    pac::{ADC2, DMA2, adc1::smpr1::SMP10 as Cycles},
    rcc::{Enable, Rcc},
};
use trueup_core::{calibration::MainsFrequency, thermometer::RawTemperatureReading};

use super::{super::TEMPERATURE_CHANNEL_COUNT, poll_until};

/// Codes of a channel in whole periods of the mains.
const fn codes_per_channel(mains: MainsFrequency) -> usize {
    match mains {
        MainsFrequency::Hz50 => 50,
        MainsFrequency::Hz60 => MAX_CODES_PER_CHANNEL,
    }
}
/// The most of them that the ring has room for.
const MAX_CODES_PER_CHANNEL: usize = 125;
/// A stream stops within one transfer, far less than a microsecond; this is some ten.
const MAX_STOP_POLLS: u32 = 200;

/// Buffer that the DMA writes: channel 0 to 7, and again. Atomic, so that the compiler expects the values to
/// change by themselves; in the SRAM of the bus matrix, which the DMA reaches.
static DMA_BUFFER: [AtomicU16; MAX_CODES_PER_CHANNEL * TEMPERATURE_CHANNEL_COUNT] =
    [const { AtomicU16::new(0) }; MAX_CODES_PER_CHANNEL * TEMPERATURE_CHANNEL_COUNT];

/// Where the channels come in.
pub type ChannelPins = (PA1, PA2, PA3, PA4, PA5, PA6, PA7, PB0);

/// The second converter and its stream.
pub struct LinearInputs {
    adc: ADC2,
    dma: DMA2,
    /// Codes of a channel in the part of the ring that is in use.
    codes: usize,
}

/// Sets it up and starts it; the clock of DMA2 is on, and what the converters share is set up.
#[allow(unsafe_code, reason = "registers of the DMA, channels of the converter")]
pub fn start(
    adc: ADC2,
    pins: ChannelPins,
    sampling: Cycles,
    mains: MainsFrequency,
    rcc: &mut Rcc,
) -> LinearInputs {
    pins.0.into_analog();
    pins.1.into_analog();
    pins.2.into_analog();
    pins.3.into_analog();
    pins.4.into_analog();
    pins.5.into_analog();
    pins.6.into_analog();
    pins.7.into_analog();
    // Its reset is the first converter's too, which has had it.
    ADC2::enable(rcc);
    adc.smpr2().write(|w| {
        w.smp1().variant(sampling).smp2().variant(sampling).smp3().variant(sampling);
        w.smp4().variant(sampling).smp5().variant(sampling).smp6().variant(sampling);
        w.smp7().variant(sampling).smp8().variant(sampling)
    });
    adc.sqr1().write(|w| w.l().set(TEMPERATURE_CHANNEL_COUNT as u8 - 1));
    // SAFETY: channels 1 to 8, in this order, five bits each.
    unsafe {
        adc.sqr2().write(|w| w.bits(7 | 8 << 5));
        adc.sqr3().write(|w| w.bits(1 | 2 << 5 | 3 << 10 | 4 << 15 | 5 << 20 | 6 << 25));
    }
    adc.cr1().write(|w| w.scan().enabled().discen().enabled());
    // SAFETY: of the registers that the streams share, only flags are written, each its own.
    let dma = unsafe { DMA2::steal() };
    let mut inputs = LinearInputs { adc, dma, codes: codes_per_channel(mains) };
    inputs.restart();
    inputs
}

impl LinearInputs {
    /// Returns what all channels deliver: the mean of the last 20 or 50 ms. [`RawTemperatureReading::NONE`] where the ring has not gone
    /// round since the last time; then it is started anew.
    pub fn read_means(&mut self) -> [RawTemperatureReading; TEMPERATURE_CHANNEL_COUNT] {
        let status = self.dma.lisr().read();
        let is_round = status.tcif3().is_complete();
        let failed = self.adc.sr().read().ovr().is_overrun()
            || status.teif3().is_error()
            || status.dmeif3().is_error();
        self.clear_flags();
        if failed || !is_round {
            self.restart();
            return [RawTemperatureReading::NONE; TEMPERATURE_CHANNEL_COUNT];
        }
        fence(Ordering::SeqCst);
        core::array::from_fn(|channel| {
            let codes =
                DMA_BUFFER.iter().skip(channel).step_by(TEMPERATURE_CHANNEL_COUNT).take(self.codes);
            let sum: u32 = codes.map(|code| u32::from(code.load(Ordering::Relaxed))).sum();
            // In 1/256 counts: at most 4095 · 256.
            let count = self.codes as u32;
            let mean = (sum * 256 + count / 2) / count;
            // 20 bits.
            RawTemperatureReading(mean.cast_signed())
        })
    }

    /// Stops converter and stream, and starts both at the first channel and the first place.
    #[allow(unsafe_code, reason = "addresses for the DMA")]
    fn restart(&mut self) {
        self.adc.cr2().reset();
        self.adc.sr().reset();
        let stream = self.dma.st(3);
        stream.cr().modify(|_, w| w.en().disabled());
        if !poll_until(MAX_STOP_POLLS, || stream.cr().read().en().is_disabled()) {
            return;
        }
        // SAFETY: the stream is off. It will read the data register of the converter and write as many
        // half-words as the ring has; it is static and atomic.
        unsafe {
            stream.par().write(|w| w.pa().bits(self.adc.dr().as_ptr() as u32));
            stream.m0ar().write(|w| w.m0a().bits(DMA_BUFFER.as_ptr() as u32));
        }
        stream.ndtr().write(|w| w.ndt().set((self.codes * TEMPERATURE_CHANNEL_COUNT) as u16));
        stream.fcr().reset();
        // DMA2 stream 3 channel 1 is ADC2 (section 10.3.3). It waits for the sensor's.
        stream.cr().write(|w| {
            w.chsel().set(1).pl().low().dir().peripheral_to_memory();
            w.psize().bits16().msize().bits16().minc().incremented().circ().enabled()
        });
        self.clear_flags();
        stream.cr().modify(|_, w| w.en().enabled());
        self.adc.cr2().write(|w| {
            w.exten().rising_edge().extsel().tim3cc1();
            w.dma().enabled().dds().continuous().adon().enabled()
        });
    }

    fn clear_flags(&self) {
        self.dma.lifcr().write(|w| {
            w.ctcif3().clear().chtif3().clear().cteif3().clear();
            w.cdmeif3().clear().cfeif3().clear()
        });
    }
}
