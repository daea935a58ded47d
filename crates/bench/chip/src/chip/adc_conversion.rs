//! The operation of the converters: triggers, sampling times, regular and injected sequences, overrun, requests to
//! the DMA (RM0090 sections 13.3 to 13.8), and what the channels see.

use super::{
    Chip,
    adc::{Adc, registers::*},
    gpio::registers::MODE_ANALOG,
};
use crate::{
    report::Severity,
    simulation_time::{NEVER, TICKS_PER_SECOND, us_to_ticks},
};

/// A sequence that an external event starts, as bits of ADC_CR2.
#[derive(Clone, Copy)]
pub(crate) enum ConversionGroup {
    /// EXTEN, EXTSEL.
    Regular,
    /// JEXTEN, JEXTSEL.
    Injected,
}

/// A conversion: its channel, cycles of sampling, bits of its result and as many cycles.
struct Conversion {
    channel: u32,
    sampling: u64,
    bits: u64,
}

/// DS8626, embedded reference voltage: to sample it takes at least 10 µs (t_S_vrefint).
const MIN_VREFINT_SAMPLING_TICKS: u64 = us_to_ticks(10);
/// DS8626, temperature sensor and reference: start-up at most 10 µs.
const INTERNAL_CHANNEL_STARTUP_TICKS: u64 = us_to_ticks(10);

impl Adc {
    fn next_conversion(&self) -> Conversion {
        let channel = if self.injected {
            // 13.13.12: of fewer than four the sequence begins at JSQ4 less their number.
            let first = 3 - (self.jsqr >> SEQUENCE_LENGTH_SHIFT & JSQR_JL_MASK);
            self.jsqr >> (5 * (first + self.injected_rank)) & SQ_CHANNEL_MASK
        } else {
            self.sqr[2 - (self.rank / 6).min(2) as usize] >> (5 * (self.rank % 6)) & SQ_CHANNEL_MASK
        };
        let times = if channel >= 10 {
            self.smpr[0] >> (3 * (channel - 10))
        } else {
            self.smpr[1] >> (3 * channel)
        };
        let sampling = [3, 15, 28, 56, 84, 112, 144, 480][(times & SMP_MASK) as usize];
        let bits = [12, 10, 8, 6][(self.cr1 >> CR1_RES_SHIFT & CR1_RES_MASK) as usize];
        Conversion { channel, sampling, bits }
    }

    fn is_triggered_by(&self, sequence: ConversionGroup, source: u32) -> bool {
        let (enable, select) = match sequence {
            ConversionGroup::Regular => (CR2_EXTEN_SHIFT, CR2_EXTSEL_SHIFT),
            ConversionGroup::Injected => (CR2_JEXTEN_SHIFT, CR2_JEXTSEL_SHIFT),
        };
        self.cr2 >> enable & CR2_EXTEN_MASK != 0 && self.cr2 >> select & CR2_EXTSEL_MASK == source
    }
}

impl Chip {
    /// Ticks in a cycle of the converters' clock.
    pub(crate) fn adcclk_period_ticks(&self) -> u64 {
        self.pclk2 * u64::from(((self.adc.ccr >> CCR_ADCPRE_SHIFT & CCR_ADCPRE_MASK) + 1) * 2)
    }

    /// An event that may start a sequence.
    pub(crate) fn trigger_adc_sequences(&mut self, sequence: ConversionGroup, source: u32) {
        for n in 0..3 {
            if self.adc.unit[n].is_triggered_by(sequence, source) {
                match sequence {
                    ConversionGroup::Regular => self.start_adc_regular_sequence(n),
                    ConversionGroup::Injected => self.start_adc_injected_sequence(n),
                }
            }
        }
    }

    fn check_adc_ready(&mut self, n: usize) -> bool {
        let (on, since) = (self.adc.unit[n].cr2 & CR2_ADON != 0, self.adc.unit[n].on_at);
        if !on {
            self.report_violation(format!("ADC{}: triggered while it is off", n + 1));
        } else if self.now < since + us_to_ticks(3) {
            self.report_violation(format!("ADC{}: started within 3 µs of ADON (tSTAB)", n + 1));
        }
        on
    }

    /// A regular sequence begins, or the next part of a discontinuous one (13.3.10).
    pub(crate) fn start_adc_regular_sequence(&mut self, n: usize) {
        if !self.check_adc_ready(n) {
            return;
        }
        let adc = &mut self.adc.unit[n];
        if adc.end_at != NEVER && adc.injected {
            adc.regular_waits = true;
            return;
        }
        if adc.end_at != NEVER {
            if !adc.stalled {
                self.report_violation(format!("ADC{}: triggered while it converts", n + 1));
            }
            return;
        }
        if adc.sr & SR_OVR != 0 && adc.cr2 & CR2_DMA != 0 {
            return;
        }
        if adc.cr1 & CR1_DISCEN == 0 {
            adc.rank = 0;
        }
        adc.sr |= SR_STRT;
        self.start_adc_conversion(n);
    }

    /// An injected sequence begins. 13.3.9: it breaks off a regular conversion, which is then done again.
    pub(crate) fn start_adc_injected_sequence(&mut self, n: usize) {
        if !self.check_adc_ready(n) {
            return;
        }
        let adc = &mut self.adc.unit[n];
        if adc.stalled {
            return;
        }
        if adc.end_at != NEVER && adc.injected {
            return self.report_violation(format!("ADC{}: injected while it injects", n + 1));
        }
        if adc.end_at != NEVER {
            adc.regular_waits = true;
            let text = format!("ADC{}: an injected conversion breaks off a regular one", n + 1);
            self.record_finding(Severity::Remark, text);
        }
        let adc = &mut self.adc.unit[n];
        (adc.injected, adc.injected_rank) = (true, 0);
        adc.sr |= SR_JSTRT;
        self.start_adc_conversion(n);
    }

    fn start_adc_conversion(&mut self, n: usize) {
        let Conversion { channel, sampling, bits } = self.adc.unit[n].next_conversion();
        let tick = self.adcclk_period_ticks();
        self.adc.unit[n].end_at = self.now + (sampling + bits) * tick;
        self.check_adc_channel(n, channel, sampling * tick);
        if self.faults.adc_stalls > 0 && self.now >= self.faults.adc_stalls {
            self.faults.adc_stalls = 0;
            self.adc.unit[n].stalled = true;
        }
        self.record_finding(
            Severity::Fact,
            format!(
                "ADC{}: channel {channel}, {} Hz, {sampling} + {bits} cycles = {:.2} µs",
                n + 1,
                TICKS_PER_SECOND / tick,
                ((sampling + bits) * tick) as f64 / us_to_ticks(1) as f64
            ),
        );
    }

    /// Whether the channel has something to convert.
    fn check_adc_channel(&mut self, n: usize, channel: u32, sampling: u64) {
        // DS8626, pin table: ADC1 and ADC2 share these pins; ADC3 has others on F.
        let pin = match channel {
            0..=7 => Some((0, channel)),
            8..=9 => Some((1, channel - 8)),
            10..=15 => Some((2, channel - 10)),
            _ => None,
        };
        if let Some((port, pin)) = pin {
            if self.pin_mode(port, pin) != MODE_ANALOG {
                let text = format!("channel {channel} converted while its pin is not analog");
                self.report_violation(format!("ADC{}: {text}", n + 1));
            }
            return;
        }
        // 13.3.3 and 13.11: channels 16 to 18 are ADC1's alone.
        if n != 0 || channel > 18 {
            return self.report_violation(format!("ADC{}: nothing is at channel {channel}", n + 1));
        }
        let (enable, what) =
            if channel == 18 { (CCR_VBATE_BIT, "VBATE") } else { (CCR_TSVREFE_BIT, "TSVREFE") };
        if self.adc.ccr >> enable & 1 == 0 {
            self.report_violation(format!("ADC1: channel {channel} converted without {what}"));
        } else if channel != 18 && self.now < self.adc.internal_at + INTERNAL_CHANNEL_STARTUP_TICKS
        {
            self.report_violation(format!(
                "ADC1: channel {channel} converted within 10 µs of {what}"
            ));
        }
        if channel != 18 && sampling < MIN_VREFINT_SAMPLING_TICKS {
            self.report_violation(format!("ADC1: channel {channel} sampled for less than 10 µs"));
        }
    }

    /// A conversion ends.
    pub(crate) fn end_adc_conversion(&mut self, n: usize) {
        self.adc.unit[n].end_at = NEVER;
        let Conversion { channel, bits, .. } = self.adc.unit[n].next_conversion();
        let code = self.world.sample_adc_code(channel, self.now) >> (12 - bits);
        let adc = &mut self.adc.unit[n];
        let code = if adc.cr2 & CR2_ALIGN != 0 { code << (16 - bits) } else { code };
        if adc.injected {
            self.end_adc_injected_conversion(n, code)
        } else {
            self.end_adc_regular_conversion(n, code)
        }
    }

    fn end_adc_injected_conversion(&mut self, n: usize, code: u32) {
        let adc = &mut self.adc.unit[n];
        adc.jdr[adc.injected_rank as usize] = code;
        adc.injections += 1;
        if adc.injected_rank < adc.jsqr >> SEQUENCE_LENGTH_SHIFT & JSQR_JL_MASK {
            adc.injected_rank += 1;
            return self.start_adc_conversion(n);
        }
        adc.sr |= SR_JEOC;
        adc.injected = false;
        if std::mem::take(&mut adc.regular_waits) {
            self.start_adc_conversion(n);
        }
    }

    fn end_adc_regular_conversion(&mut self, n: usize, code: u32) {
        let adc = &mut self.adc.unit[n];
        if adc.conversions == 0 {
            adc.first_at = self.now;
        }
        adc.conversions += 1;
        adc.last_at = self.now;
        let scan = adc.cr1 & CR1_SCAN != 0;
        let last = !scan || adc.rank >= adc.sqr[0] >> SEQUENCE_LENGTH_SHIFT & SQR1_L_MASK;
        let dma = adc.cr2 & CR2_DMA != 0;
        if adc.unread && (dma || adc.cr2 & CR2_EOCS != 0) {
            adc.sr |= SR_OVR;
            return self.record_finding(Severity::Remark, format!("ADC{}: overrun", n + 1));
        }
        adc.dr = code;
        if dma || last || adc.cr2 & CR2_EOCS != 0 {
            adc.sr |= SR_EOC;
        }
        adc.unread = true;
        if dma && !adc.dma_over {
            // RM0090 10.3.3, table 44: who of DMA2 listens to which converter, as (stream, channel).
            let streams = [[(0, 0), (4, 0)], [(2, 1), (3, 1)], [(0, 2), (1, 2)]][n];
            let done = streams
                .into_iter()
                .find_map(|(stream, channel)| self.serve_dma_request(1, stream, channel));
            let adc = &mut self.adc.unit[n];
            if done == Some(true) && adc.cr2 & CR2_DDS == 0 {
                adc.dma_over = true;
            }
        }
        let adc = &mut self.adc.unit[n];
        adc.rank = if last { 0 } else { adc.rank + 1 };
        // 13.3.10: a discontinuous sequence waits for a trigger after each DISCNUM + 1.
        let discontinuous = adc.cr1 & CR1_DISCEN != 0;
        if discontinuous && adc.cr1 >> CR1_DISCNUM_SHIFT & CR1_DISCNUM_MASK != 0 {
            let text = format!("ADC{}: discontinuous by more than one", n + 1);
            return self.record_finding(Severity::Unmodelled, text);
        }
        if (!last && !discontinuous) || (last && adc.cr2 & CR2_CONT != 0) {
            self.start_adc_conversion(n);
        }
    }
}
