//! The three converters' registers (RM0090 section 13.13): `adc_conversion.rs` has what they do.

pub(super) mod registers;

use super::Chip;
use crate::{
    memory_map::ADC_OFFSET_MASK,
    report::Severity,
    simulation_time::{NEVER, TICKS_PER_SECOND},
};
use registers::*;

/// One converter.
pub struct Adc {
    /// ADC_SR, the status register.
    pub sr: u32,
    pub(crate) cr1: u32,
    /// ADC_CR2, control register 2.
    pub cr2: u32,
    pub(crate) smpr: [u32; 2],
    jofr: [u32; 4],
    htr: u32,
    ltr: u32,
    pub(crate) sqr: [u32; 3],
    pub(crate) jsqr: u32,
    pub(crate) dr: u32,
    pub(crate) jdr: [u32; 4],
    pub(crate) on_at: u64,
    /// When the conversion under way ends; NEVER: there is none.
    pub end_at: u64,
    /// The conversion under way is an injected one.
    pub(crate) injected: bool,
    /// A regular conversion waits for the end of the injected ones.
    pub(crate) regular_waits: bool,
    /// The next of the regular and of the injected sequence.
    pub(crate) rank: u32,
    pub(crate) injected_rank: u32,
    pub(crate) dma_over: bool,
    pub(crate) unread: bool,
    /// A fault from outside: what it began it never ends, until it is switched off.
    pub(crate) stalled: bool,
    /// Regular conversions so far.
    pub conversions: u64,
    /// Injected conversions so far.
    pub injections: u64,
    /// When the first regular conversion ended.
    pub first_at: u64,
    /// When the last regular conversion ended.
    pub last_at: u64,
}

impl Default for Adc {
    fn default() -> Adc {
        Adc {
            sr: 0,
            cr1: 0,
            cr2: 0,
            smpr: [0; 2],
            jofr: [0; 4],
            htr: HTR_RESET,
            ltr: 0,
            sqr: [0; 3],
            jsqr: 0,
            dr: 0,
            jdr: [0; 4],
            on_at: 0,
            end_at: NEVER,
            injected: false,
            regular_waits: false,
            rank: 0,
            injected_rank: 0,
            dma_over: false,
            unread: false,
            stalled: false,
            conversions: 0,
            injections: 0,
            first_at: 0,
            last_at: 0,
        }
    }
}

impl Adc {
    /// After a reset: what was counted stays.
    pub(crate) fn to_reset_state(&self) -> Adc {
        let Adc { conversions, injections, first_at, last_at, .. } = *self;
        Adc { conversions, injections, first_at, last_at, ..Adc::default() }
    }

    /// Its request for an interrupt (13.13.2: EOCIE, AWDIE, JEOCIE, OVRIE).
    pub(crate) fn is_irq_asserted(&self) -> bool {
        [
            (SR_EOC_BIT, CR1_EOCIE_BIT),
            (SR_AWD_BIT, CR1_AWDIE_BIT),
            (SR_JEOC_BIT, CR1_JEOCIE_BIT),
            (SR_OVR_BIT, CR1_OVRIE_BIT),
        ]
        .into_iter()
        .any(|(flag, enable)| self.sr >> flag & self.cr1 >> enable & 1 != 0)
    }
}

/// The three converters and their common state.
#[derive(Default)]
pub struct Adcs {
    /// ADC1, ADC2 and ADC3.
    pub unit: [Adc; 3],
    pub(crate) ccr: u32,
    /// Since when the channels of the temperature and of VREFINT are on.
    pub(crate) internal_at: u64,
}

impl Chip {
    pub(crate) fn read_adc_register(&mut self, off: u32) -> u32 {
        if off >= COMMON_OFFSET {
            return match off {
                CSR_OFFSET => (0..3).map(|n| (self.adc.unit[n].sr & SR_MASK) << (8 * n)).sum(),
                CCR_OFFSET => self.adc.ccr,
                CDR_OFFSET => 0,
                _ => self.report_unknown_adc_register(off, "read"),
            };
        }
        let adc = &mut self.adc.unit[off as usize >> UNIT_SHIFT];
        match off & ADC_OFFSET_MASK {
            SR_OFFSET => adc.sr,
            CR1_OFFSET => adc.cr1,
            CR2_OFFSET => adc.cr2,
            SMPR1_OFFSET => adc.smpr[0],
            SMPR2_OFFSET => adc.smpr[1],
            at @ JOFR1_OFFSET..=JOFR4_OFFSET => adc.jofr[(at as usize - JOFR1_OFFSET as usize) / 4],
            HTR_OFFSET => adc.htr,
            LTR_OFFSET => adc.ltr,
            at @ SQR1_OFFSET..=SQR3_OFFSET => adc.sqr[(at as usize - SQR1_OFFSET as usize) / 4],
            JSQR_OFFSET => adc.jsqr,
            at @ JDR1_OFFSET..=JDR4_OFFSET => adc.jdr[(at as usize - JDR1_OFFSET as usize) / 4],
            DR_OFFSET => {
                adc.sr &= !SR_EOC;
                adc.unread = false;
                adc.dr
            }
            _ => self.report_unknown_adc_register(off, "read"),
        }
    }

    fn report_unknown_adc_register(&mut self, off: u32, what: &str) -> u32 {
        self.record_finding(Severity::Unmodelled, format!("ADC {what} at {off:#x}"));
        0
    }

    pub(crate) fn write_adc_register(&mut self, off: u32, v: u32) {
        let n = off as usize >> UNIT_SHIFT;
        match off {
            CCR_OFFSET => return self.write_adc_ccr(v),
            CSR_OFFSET | CDR_OFFSET => {
                return self
                    .report_violation(format!("ADC: read-only register at {off:#x} written"));
            }
            0..COMMON_OFFSET => {}
            _ => return self.report_violation(format!("ADC: write at {off:#x}")),
        }
        let name = format!("ADC{}", n + 1);
        let of = |register: &str| format!("{name}_{register}");
        match off & ADC_OFFSET_MASK {
            SR_OFFSET => {
                let adc = &mut self.adc.unit[n];
                if adc.sr & SR_OVR != 0 && v & SR_OVR == 0 {
                    adc.dma_over = false;
                    adc.unread = false;
                }
                adc.sr &= v;
            }
            CR1_OFFSET => {
                let old = self.adc.unit[n].cr1;
                self.adc.unit[n].cr1 = self.apply_write_mask(&of("CR1"), old, v, CR1_WRITE_MASK);
            }
            CR2_OFFSET => self.write_adc_cr2(n, v),
            SMPR1_OFFSET => {
                let old = self.adc.unit[n].smpr[0];
                self.adc.unit[n].smpr[0] =
                    self.apply_write_mask(&of("SMPR1"), old, v, SMPR1_WRITE_MASK);
            }
            SMPR2_OFFSET => {
                let old = self.adc.unit[n].smpr[1];
                self.adc.unit[n].smpr[1] =
                    self.apply_write_mask(&of("SMPR2"), old, v, SMPR2_WRITE_MASK);
            }
            at @ JOFR1_OFFSET..=JOFR4_OFFSET => {
                self.adc.unit[n].jofr[(at as usize - JOFR1_OFFSET as usize) / 4] =
                    v & TWELVE_BITS_MASK
            }
            HTR_OFFSET => self.adc.unit[n].htr = v & TWELVE_BITS_MASK,
            LTR_OFFSET => self.adc.unit[n].ltr = v & TWELVE_BITS_MASK,
            at @ SQR1_OFFSET..=SQR3_OFFSET => {
                self.adc.unit[n].sqr[(at as usize - SQR1_OFFSET as usize) / 4] = v
            }
            JSQR_OFFSET => self.adc.unit[n].jsqr = v & JSQR_MASK,
            JDR1_OFFSET..=DR_OFFSET => {
                self.report_violation(format!("{name}: read-only register at {off:#x} written"));
            }
            _ => self.report_violation(format!("{name}: write at {off:#x}")),
        }
    }

    fn write_adc_cr2(&mut self, n: usize, v: u32) {
        let name = format!("ADC{}_CR2", n + 1);
        let old = self.adc.unit[n].cr2;
        // SWSTART and JSWSTART are gone once the conversion begins.
        let starts = CR2_SWSTART | CR2_JSWSTART;
        self.adc.unit[n].cr2 = self.apply_write_mask(&name, old, v, CR2_WRITE_MASK) & !starts;
        let adc = &mut self.adc.unit[n];
        if v & CR2_ADON == 0 {
            (adc.end_at, adc.stalled, adc.injected, adc.regular_waits) =
                (NEVER, false, false, false);
        }
        if v & !old & CR2_DMA != 0 {
            adc.dma_over = false;
        }
        if v & !old & CR2_ADON != 0 {
            adc.on_at = self.now;
            self.check_adc_clock();
        }
        if v & CR2_SWSTART != 0 {
            self.start_adc_regular_sequence(n);
        }
        if v & CR2_JSWSTART != 0 {
            self.start_adc_injected_sequence(n);
        }
    }

    fn write_adc_ccr(&mut self, v: u32) {
        let old = self.adc.ccr;
        self.adc.ccr = self.apply_write_mask("ADC_CCR", old, v, CCR_WRITE_MASK);
        if v & !old & CCR_TSVREFE != 0 {
            self.adc.internal_at = self.now;
        }
        if v & CCR_MULTI_MASK != 0 {
            self.record_finding(
                Severity::Unmodelled,
                format!("ADC: converters in common, mode {}", v & CCR_MULTI_MASK),
            );
        }
    }

    /// DS8626, ADC characteristics: 0.6 to 36 MHz with 2.4 to 3.6 V.
    fn check_adc_clock(&mut self) {
        let hz = TICKS_PER_SECOND / self.adcclk_period_ticks();
        if hz > 36_000_000 {
            self.report_violation(format!("ADC clock {hz} Hz, at most 36 MHz"));
        }
        if hz < 600_000 {
            self.report_violation(format!("ADC clock {hz} Hz, at least 0.6 MHz"));
        }
    }
}
