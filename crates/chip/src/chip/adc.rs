//! ADC1: triggers, sampling times, overrun, requests to the DMA (RM0090 section 13).

use super::Chip;
use crate::{
    report::Grade,
    time::{NEVER, TPS, us},
};

#[derive(Default)]
pub struct Adc {
    pub sr: u32,
    pub(crate) cr1: u32,
    pub cr2: u32,
    pub(crate) smpr: [u32; 2],
    pub(crate) jofr: [u32; 4],
    pub(crate) htr: u32,
    pub(crate) ltr: u32,
    pub(crate) sqr: [u32; 3],
    pub(crate) jsqr: u32,
    pub(crate) dr: u32,
    pub(crate) ccr: u32,
    pub(crate) on_at: u64,
    pub end_at: u64,
    pub(crate) rank: u32,
    pub(crate) dma_over: bool,
    pub(crate) unread: bool,
    pub conversions: u64,
    pub first_at: u64,
    pub last_at: u64,
}

impl Chip {
    pub(crate) fn adc_read(&mut self, off: u32) -> u32 {
        match off {
            0x00 => self.adc.sr,
            0x04 => self.adc.cr1,
            0x08 => self.adc.cr2,
            0x0c => self.adc.smpr[0],
            0x10 => self.adc.smpr[1],
            0x14..=0x20 => self.adc.jofr[(off as usize - 0x14) / 4],
            0x24 => self.adc.htr,
            0x28 => self.adc.ltr,
            0x2c..=0x34 => self.adc.sqr[(off as usize - 0x2c) / 4],
            0x38 => self.adc.jsqr,
            0x3c..=0x48 => 0,
            0x4c => {
                self.adc.sr &= !2;
                self.adc.unread = false;
                self.adc.dr
            }
            0x300 => self.adc.sr & 0x3f,
            0x304 => self.adc.ccr,
            0x308 => 0,
            _ => {
                self.say(Grade::Unmodelled, format!("ADC read at {off:#x}"));
                0
            }
        }
    }

    pub(crate) fn adc_write(&mut self, off: u32, v: u32) {
        match off {
            0x00 => {
                if self.adc.sr & 1 << 5 != 0 && v & 1 << 5 == 0 {
                    self.adc.dma_over = false;
                    self.adc.unread = false;
                }
                self.adc.sr &= v;
            }
            0x04 => self.adc.cr1 = self.set("ADC_CR1", self.adc.cr1, v, 0x07c0_ffff),
            0x08 => {
                let old = self.adc.cr2;
                self.adc.cr2 = self.set("ADC_CR2", old, v, 0x7f7f_0f03) & !(1 << 30 | 1 << 22);
                if v & !old & 1 != 0 {
                    self.adc.on_at = self.now;
                    self.adc_facts();
                }
                if v & 1 == 0 {
                    self.adc.end_at = NEVER;
                }
                if v & !old & 1 << 8 != 0 {
                    self.adc.dma_over = false;
                }
                if v & 1 << 30 != 0 {
                    self.adc_start();
                }
            }
            0x0c => self.adc.smpr[0] = self.set("ADC_SMPR1", self.adc.smpr[0], v, 0x07ff_ffff),
            0x10 => self.adc.smpr[1] = self.set("ADC_SMPR2", self.adc.smpr[1], v, 0x3fff_ffff),
            0x14..=0x20 => self.adc.jofr[(off as usize - 0x14) / 4] = v & 0xfff,
            0x24 => self.adc.htr = v & 0xfff,
            0x28 => self.adc.ltr = v & 0xfff,
            0x2c..=0x34 => self.adc.sqr[(off as usize - 0x2c) / 4] = v,
            0x38 => self.adc.jsqr = v,
            0x3c..=0x4c | 0x300 | 0x308 => {
                self.violation(format!("ADC: read-only register at {off:#x} written"))
            }
            0x304 => self.adc.ccr = self.set("ADC_CCR", self.adc.ccr, v, 0x00c3_ef1f),
            _ => self.violation(format!("ADC: write at {off:#x}")),
        }
    }

    pub(crate) fn adc_tick(&self) -> u64 {
        self.pclk2 * u64::from(((self.adc.ccr >> 16 & 3) + 1) * 2)
    }

    pub(crate) fn adc_facts(&mut self) {
        let hz = TPS / self.adc_tick();
        if hz > 36_000_000 {
            self.violation(format!("ADC clock {hz} Hz, at most 36 MHz"));
        }
        if hz < 600_000 {
            self.violation(format!("ADC clock {hz} Hz, at least 0.6 MHz"));
        }
    }

    pub(crate) fn adc_conversion(&self) -> (u32, u64, u64) {
        let ch =
            self.adc.sqr[2 - (self.adc.rank / 6).min(2) as usize] >> (5 * (self.adc.rank % 6)) & 31;
        let sel = if ch >= 10 {
            self.adc.smpr[0] >> (3 * (ch - 10))
        } else {
            self.adc.smpr[1] >> (3 * ch)
        } & 7;
        let sample = [3, 15, 28, 56, 84, 112, 144, 480][sel as usize];
        let bits = [12, 10, 8, 6][(self.adc.cr1 >> 24 & 3) as usize];
        (ch, sample, bits)
    }

    pub(crate) fn adc_trigger(&mut self, source: u32) {
        let cr2 = self.adc.cr2;
        if cr2 >> 28 & 3 != 0 && cr2 >> 24 & 15 == source {
            self.adc_start();
        }
    }

    pub(crate) fn adc_start(&mut self) {
        if self.adc.cr2 & 1 == 0 {
            return self.violation("ADC: triggered while it is off".into());
        }
        if self.now < self.adc.on_at + us(3) {
            self.violation("ADC: started within 3 µs of ADON (tSTAB)".into());
        }
        if self.adc.end_at != NEVER {
            return self.violation("ADC: triggered while it converts".into());
        }
        if self.adc.sr & 1 << 5 != 0 && self.adc.cr2 & 1 << 8 != 0 {
            return;
        }
        self.adc.rank = 0;
        self.adc.sr |= 1 << 4;
        self.adc_next();
    }

    pub(crate) fn adc_next(&mut self) {
        let (ch, sample, bits) = self.adc_conversion();
        self.adc.end_at = self.now + (sample + bits) * self.adc_tick();
        let pin = match ch {
            0..=7 => Some((0, ch)),
            8..=9 => Some((1, ch - 8)),
            10..=15 => Some((2, ch - 10)),
            _ => None,
        };
        if let Some((p, n)) = pin
            && self.pin_mode(p, n) != 3
        {
            self.violation(format!("ADC: channel {ch} converted while its pin is not analog"));
        }
        self.say(
            Grade::Fact,
            format!(
                "ADC: channel {ch}, {} Hz, {sample} + {bits} cycles = {:.2} µs",
                TPS / self.adc_tick(),
                ((sample + bits) * self.adc_tick()) as f64 / us(1) as f64
            ),
        );
    }

    pub(crate) fn adc_end(&mut self) {
        let (ch, _, bits) = self.adc_conversion();
        self.adc.end_at = NEVER;
        let code = self.world.code(ch, self.now) >> (12 - bits);
        if self.adc.conversions == 0 {
            self.adc.first_at = self.now;
        }
        self.adc.conversions += 1;
        self.adc.last_at = self.now;
        let last = self.adc.rank >= self.adc.sqr[0] >> 20 & 15 || self.adc.cr1 & 1 << 8 == 0;
        let dma = self.adc.cr2 & 1 << 8 != 0;
        if self.adc.unread && (dma || self.adc.cr2 & 1 << 10 != 0) {
            self.adc.sr |= 1 << 5;
            self.say(Grade::Remark, "ADC: overrun".into());
            return;
        }
        self.adc.dr = if self.adc.cr2 & 1 << 11 != 0 { code << 4 } else { code };
        if dma || last || self.adc.cr2 & 1 << 10 != 0 {
            self.adc.sr |= 2;
        }
        self.adc.unread = true;
        if dma && !self.adc.dma_over {
            // RM0090 table 43: ADC1 is channel 0 of DMA2's streams 0 and 4.
            let done = self.dma_request(1, 0, 0).or_else(|| self.dma_request(1, 4, 0));
            if done == Some(true) && self.adc.cr2 & 1 << 9 == 0 {
                self.adc.dma_over = true;
            }
        }
        if !last {
            self.adc.rank += 1;
            self.adc_next();
        } else if self.adc.cr2 & 2 != 0 {
            self.adc.rank = 0;
            self.adc_next();
        }
    }
}
