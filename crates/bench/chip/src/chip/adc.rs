//! The three converters' registers (RM0090 section 13.13): `convert.rs` has what they do.

use super::Chip;
use crate::{
    report::Grade,
    time::{NEVER, TPS},
};

/// One converter.
pub struct Adc {
    pub sr: u32,
    pub(crate) cr1: u32,
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
    pub injections: u64,
    pub first_at: u64,
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
            htr: 0xfff,
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
    pub(crate) fn reset(&self) -> Adc {
        let Adc { conversions, injections, first_at, last_at, .. } = *self;
        Adc { conversions, injections, first_at, last_at, ..Adc::default() }
    }

    /// Its request for an interrupt (13.13.2: EOCIE, AWDIE, JEOCIE, OVRIE).
    pub(crate) fn line(&self) -> bool {
        [(1, 5), (0, 6), (2, 7), (5, 26)]
            .into_iter()
            .any(|(flag, enable)| self.sr >> flag & self.cr1 >> enable & 1 != 0)
    }
}

/// The three converters and their common state.
#[derive(Default)]
pub struct Adcs {
    pub unit: [Adc; 3],
    pub(crate) ccr: u32,
    /// Since when the channels of the temperature and of VREFINT are on.
    pub(crate) internal_at: u64,
}

impl Chip {
    pub(crate) fn adc_read(&mut self, off: u32) -> u32 {
        if off >= 0x300 {
            return match off {
                0x300 => (0..3).map(|n| (self.adc.unit[n].sr & 0x3f) << (8 * n)).sum(),
                0x304 => self.adc.ccr,
                0x308 => 0,
                _ => self.adc_no_such(off, "read"),
            };
        }
        let adc = &mut self.adc.unit[off as usize >> 8];
        match off & 0xff {
            0x00 => adc.sr,
            0x04 => adc.cr1,
            0x08 => adc.cr2,
            0x0c => adc.smpr[0],
            0x10 => adc.smpr[1],
            at @ 0x14..=0x20 => adc.jofr[(at as usize - 0x14) / 4],
            0x24 => adc.htr,
            0x28 => adc.ltr,
            at @ 0x2c..=0x34 => adc.sqr[(at as usize - 0x2c) / 4],
            0x38 => adc.jsqr,
            at @ 0x3c..=0x48 => adc.jdr[(at as usize - 0x3c) / 4],
            0x4c => {
                adc.sr &= !2;
                adc.unread = false;
                adc.dr
            }
            _ => self.adc_no_such(off, "read"),
        }
    }

    fn adc_no_such(&mut self, off: u32, what: &str) -> u32 {
        self.say(Grade::Unmodelled, format!("ADC {what} at {off:#x}"));
        0
    }

    pub(crate) fn adc_write(&mut self, off: u32, v: u32) {
        let n = off as usize >> 8;
        match off {
            0x304 => return self.adc_common(v),
            0x300 | 0x308 => {
                return self.violation(format!("ADC: read-only register at {off:#x} written"));
            }
            0x000..0x300 => {}
            _ => return self.violation(format!("ADC: write at {off:#x}")),
        }
        let name = format!("ADC{}", n + 1);
        let of = |register: &str| format!("{name}_{register}");
        match off & 0xff {
            0x00 => {
                let adc = &mut self.adc.unit[n];
                if adc.sr & 1 << 5 != 0 && v & 1 << 5 == 0 {
                    adc.dma_over = false;
                    adc.unread = false;
                }
                adc.sr &= v;
            }
            0x04 => {
                let old = self.adc.unit[n].cr1;
                self.adc.unit[n].cr1 = self.set(&of("CR1"), old, v, 0x07c0_ffff);
            }
            0x08 => self.adc_control(n, v),
            0x0c => {
                let old = self.adc.unit[n].smpr[0];
                self.adc.unit[n].smpr[0] = self.set(&of("SMPR1"), old, v, 0x07ff_ffff);
            }
            0x10 => {
                let old = self.adc.unit[n].smpr[1];
                self.adc.unit[n].smpr[1] = self.set(&of("SMPR2"), old, v, 0x3fff_ffff);
            }
            at @ 0x14..=0x20 => self.adc.unit[n].jofr[(at as usize - 0x14) / 4] = v & 0xfff,
            0x24 => self.adc.unit[n].htr = v & 0xfff,
            0x28 => self.adc.unit[n].ltr = v & 0xfff,
            at @ 0x2c..=0x34 => self.adc.unit[n].sqr[(at as usize - 0x2c) / 4] = v,
            0x38 => self.adc.unit[n].jsqr = v & 0x003f_ffff,
            0x3c..=0x4c => {
                self.violation(format!("{name}: read-only register at {off:#x} written"));
            }
            _ => self.violation(format!("{name}: write at {off:#x}")),
        }
    }

    fn adc_control(&mut self, n: usize, v: u32) {
        let name = format!("ADC{}_CR2", n + 1);
        let old = self.adc.unit[n].cr2;
        // SWSTART and JSWSTART are gone once the conversion begins.
        let starts = 1 << 30 | 1 << 22;
        self.adc.unit[n].cr2 = self.set(&name, old, v, 0x7f7f_0f03) & !starts;
        let adc = &mut self.adc.unit[n];
        if v & 1 == 0 {
            (adc.end_at, adc.stalled, adc.injected, adc.regular_waits) =
                (NEVER, false, false, false);
        }
        if v & !old & 1 << 8 != 0 {
            adc.dma_over = false;
        }
        if v & !old & 1 != 0 {
            adc.on_at = self.now;
            self.adc_clock();
        }
        if v & 1 << 30 != 0 {
            self.adc_start(n);
        }
        if v & 1 << 22 != 0 {
            self.adc_inject(n);
        }
    }

    fn adc_common(&mut self, v: u32) {
        let old = self.adc.ccr;
        self.adc.ccr = self.set("ADC_CCR", old, v, 0x00c3_ef1f);
        if v & !old & 1 << 23 != 0 {
            self.adc.internal_at = self.now;
        }
        if v & 0x1f != 0 {
            self.say(Grade::Unmodelled, format!("ADC: converters in common, mode {}", v & 0x1f));
        }
    }

    /// DS8626, ADC characteristics: 0.6 to 36 MHz with 2.4 to 3.6 V.
    fn adc_clock(&mut self) {
        let hz = TPS / self.adc_tick();
        if hz > 36_000_000 {
            self.violation(format!("ADC clock {hz} Hz, at most 36 MHz"));
        }
        if hz < 600_000 {
            self.violation(format!("ADC clock {hz} Hz, at least 0.6 MHz"));
        }
    }
}
