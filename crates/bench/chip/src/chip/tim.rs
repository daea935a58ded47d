//! The timers, up-counting: update and compare events, preload, trigger output to the converter.

use super::{
    Chip,
    convert::Sequence::{Injected, Regular},
};
use crate::{
    report::Grade,
    time::{NEVER, TPS},
};

#[derive(Clone, Default)]
pub struct Tim {
    pub name: &'static str,
    pub base: u32,
    pub irq: usize,
    pub apb2: bool,
    pub(crate) wide: bool,
    /// Ticks of the simulation in a tick of the timer's clock.
    pub tick: u64,
    pub cr1: u32,
    pub cr2: u32,
    pub smcr: u32,
    pub dier: u32,
    pub sr: u32,
    pub ccmr: [u32; 2],
    pub ccer: u32,
    pub(crate) psc: u32,
    pub(crate) psc_next: u32,
    pub(crate) arr: u32,
    pub(crate) arr_next: u32,
    pub(crate) ccr: [u32; 4],
    pub(crate) ccr_next: [u32; 4],
    /// The count at `since`.
    pub(crate) count: u64,
    pub(crate) since: u64,
    pub update_at: u64,
    pub cc_at: [u64; 4],
    pub updates: u64,
}

impl Tim {
    pub(crate) fn all() -> Vec<Tim> {
        [
            ("TIM2", 0x4000_0000, 28, false, true),
            ("TIM3", 0x4000_0400, 29, false, false),
            ("TIM4", 0x4000_0800, 30, false, false),
            ("TIM5", 0x4000_0c00, 50, false, true),
            ("TIM6", 0x4000_1000, 54, false, false),
            ("TIM7", 0x4000_1400, 55, false, false),
            ("TIM1", 0x4001_0000, 25, true, false),
            ("TIM8", 0x4001_0400, 44, true, false),
        ]
        .into_iter()
        .map(|(name, base, irq, apb2, wide)| {
            let arr = if wide { u32::MAX } else { 0xffff };
            Tim {
                name,
                base,
                irq,
                apb2,
                wide,
                tick: 1,
                arr,
                arr_next: arr,
                update_at: NEVER,
                cc_at: [NEVER; 4],
                ..Tim::default()
            }
        })
        .collect()
    }
    /// Returns whether it counts its clock.
    pub(crate) fn running(&self) -> bool {
        self.cr1 & 1 != 0 && self.smcr & 7 != 7
    }
    pub(crate) fn step(&self) -> u64 {
        self.tick * (u64::from(self.psc) + 1)
    }
    pub(crate) fn count(&self, now: u64) -> u32 {
        if self.running() {
            (self.count + (now - self.since) / self.step()) as u32
        } else {
            self.count as u32
        }
    }
    /// Before its clock changes.
    pub(crate) fn freeze(&mut self, now: u64) {
        if self.running() {
            self.count = u64::from(self.count(now));
            self.since = now;
        }
    }
    /// Plans what comes, from the count at `since`.
    pub(crate) fn thaw(&mut self, now: u64) {
        if !self.running() {
            self.update_at = NEVER;
            self.cc_at = [NEVER; 4];
            return;
        }
        let step = self.step();
        let elapsed = (now - self.since) / step;
        let here = self.count + elapsed;
        self.update_at = if self.arr == 0 {
            NEVER
        } else {
            let top = if here > u64::from(self.arr) {
                if self.wide { 1 << 32 } else { 1 << 16 }
            } else {
                u64::from(self.arr) + 1
            };
            self.since + (top - self.count) * step
        };
        for (at, ccr) in self.cc_at.iter_mut().zip(self.ccr) {
            let ccr = u64::from(ccr);
            *at = if ccr > here && ccr <= u64::from(self.arr) {
                self.since + (ccr - self.count) * step
            } else {
                NEVER
            };
        }
    }
    pub(crate) fn output_mode(&self, ch: usize) -> u32 {
        self.ccmr[ch / 2] >> (8 * (ch % 2) + 4) & 7
    }
}

impl Chip {
    pub(crate) fn tim_update(&mut self, i: usize) {
        let now = self.now;
        let t = &mut self.tims[i];
        t.updates += 1;
        if t.cr1 & 2 == 0 {
            t.psc = t.psc_next;
            t.arr = t.arr_next;
            t.ccr = t.ccr_next;
            t.sr |= 1;
        }
        t.count = 0;
        t.since = now;
        if t.cr1 & 8 != 0 {
            t.cr1 &= !1;
        }
        t.thaw(now);
        for ch in 0..4 {
            if t.ccr[ch] == 0 && t.base != 0x4000_1000 && t.base != 0x4000_1400 {
                t.sr |= 2 << ch;
            }
        }
        let mms = t.cr2 >> 4 & 7;
        let pwm1 = mms >= 4 && t.output_mode(mms as usize - 4) == 6 && t.ccr[mms as usize - 4] > 0;
        if mms == 2 || pwm1 {
            self.trgo(i);
        }
        for ch in 0..4 {
            if self.tims[i].output_mode(ch) == 6 && self.tims[i].ccr[ch] > 0 {
                self.cc_out(i, ch);
            }
        }
    }

    pub(crate) fn tim_compare(&mut self, i: usize, ch: usize) {
        let t = &mut self.tims[i];
        t.cc_at[ch] = NEVER;
        if t.ccmr[ch / 2] >> (8 * (ch % 2)) & 3 != 0 {
            return;
        }
        t.sr |= 2 << ch;
        let mms = t.cr2 >> 4 & 7;
        let mode = t.output_mode(ch);
        if (mms == 3 && ch == 0) || (mms == 4 + ch as u32 && matches!(mode, 1 | 3 | 7)) {
            self.trgo(i);
        }
        if matches!(mode, 1 | 3 | 7) {
            self.cc_out(i, ch);
        }
    }

    /// RM0090 tables 69 and 70: what starts regular and injected sequences.
    pub(crate) fn trgo(&mut self, i: usize) {
        let name = self.tims[i].name;
        for j in 0..self.tims.len() {
            // RM0090 17.4.3 and 18.4.3, tables 94 and 98: who is behind the internal triggers.
            let from = match self.tims[j].name {
                "TIM1" => ["TIM5", "TIM2", "TIM3", "TIM4"],
                "TIM8" => ["TIM1", "TIM2", "TIM4", "TIM5"],
                "TIM2" => ["TIM1", "TIM8", "TIM3", "TIM4"],
                "TIM3" => ["TIM1", "TIM2", "TIM5", "TIM4"],
                "TIM4" => ["TIM1", "TIM2", "TIM3", "TIM8"],
                "TIM5" => ["TIM2", "TIM3", "TIM4", "TIM8"],
                _ => continue,
            };
            let smcr = self.tims[j].smcr;
            if smcr & 7 < 4 || smcr >> 4 & 7 > 3 || from[(smcr >> 4 & 3) as usize] != name {
                continue;
            }
            match smcr & 7 {
                7 if self.tims[j].cr1 & 1 != 0 => {
                    let t = &mut self.tims[j];
                    t.count += 1;
                    if t.count > u64::from(t.arr) {
                        self.tim_update(j);
                    } else {
                        for ch in 0..4 {
                            if u64::from(self.tims[j].ccr[ch]) == self.tims[j].count {
                                self.tim_compare(j, ch);
                            }
                        }
                    }
                }
                4 => self.tim_update(j),
                6 if self.tims[j].cr1 & 1 == 0 => {
                    let now = self.now;
                    let t = &mut self.tims[j];
                    t.cr1 |= 1;
                    t.since = now;
                    t.thaw(now);
                }
                _ => {}
            }
        }
        match self.tims[i].name {
            "TIM1" => self.adc_trigger(Injected, 1),
            "TIM2" => {
                self.adc_trigger(Regular, 6);
                self.adc_trigger(Injected, 3);
            }
            "TIM3" => self.adc_trigger(Regular, 8),
            "TIM4" => self.adc_trigger(Injected, 9),
            "TIM5" => self.adc_trigger(Injected, 11),
            "TIM8" => self.adc_trigger(Regular, 14),
            _ => {}
        }
    }

    pub(crate) fn cc_out(&mut self, i: usize, ch: usize) {
        if self.tims[i].ccer >> (4 * ch) & 1 == 0 {
            return;
        }
        let (sequence, source) = match (self.tims[i].name, ch) {
            ("TIM1", 0) => (Regular, 0),
            ("TIM1", 1) => (Regular, 1),
            ("TIM1", 2) => (Regular, 2),
            ("TIM1", 3) => (Injected, 0),
            ("TIM2", 0) => (Injected, 2),
            ("TIM2", 1) => (Regular, 3),
            ("TIM2", 2) => (Regular, 4),
            ("TIM2", 3) => (Regular, 5),
            ("TIM3", 0) => (Regular, 7),
            ("TIM3", 1) => (Injected, 4),
            ("TIM3", 3) => (Injected, 5),
            ("TIM4", 0) => (Injected, 6),
            ("TIM4", 1) => (Injected, 7),
            ("TIM4", 2) => (Injected, 8),
            ("TIM4", 3) => (Regular, 9),
            ("TIM5", 0) => (Regular, 10),
            ("TIM5", 1) => (Regular, 11),
            ("TIM5", 2) => (Regular, 12),
            ("TIM5", 3) => (Injected, 10),
            ("TIM8", 0) => (Regular, 13),
            ("TIM8", 1) => (Injected, 12),
            ("TIM8", 2) => (Injected, 13),
            ("TIM8", 3) => (Injected, 14),
            _ => return,
        };
        self.adc_trigger(sequence, source);
    }

    pub(crate) fn tim_read(&mut self, i: usize, off: u32) -> u32 {
        let now = self.now;
        let t = &self.tims[i];
        match off {
            0x00 => t.cr1,
            0x04 => t.cr2,
            0x08 => t.smcr,
            0x0c => t.dier,
            0x10 => t.sr,
            0x14 => 0,
            0x18 => t.ccmr[0],
            0x1c => t.ccmr[1],
            0x20 => t.ccer,
            0x24 => t.count(now),
            0x28 => t.psc_next,
            0x2c => t.arr_next,
            0x34..=0x40 => t.ccr_next[(off as usize - 0x34) / 4],
            _ => 0,
        }
    }

    pub(crate) fn tim_write(&mut self, i: usize, off: u32, v: u32) {
        let now = self.now;
        let name = self.tims[i].name;
        let masks =
            |r: &str, m: u32, c: &mut Chip, old: u32| c.set(&format!("{name}_{r}"), old, v, m);
        match off {
            0x00 => self.tim_control(i, v),
            0x04 => {
                let o = self.tims[i].cr2;
                self.tims[i].cr2 = masks("CR2", 0xf8, self, o)
            }
            0x08 => {
                self.tims[i].smcr = v;
                match v & 7 {
                    0 => {}
                    4 | 6 | 7 if v >> 4 & 7 < 4 => self.say(
                        Grade::Fact,
                        format!(
                            "{name}: slave mode {} on trigger {} ({})",
                            v & 7,
                            v >> 4 & 7,
                            if v & 7 == 7 {
                                "counts its pulses"
                            } else if v & 7 == 6 {
                                "is started by it"
                            } else {
                                "is cleared by it"
                            }
                        ),
                    ),
                    _ => self.say(Grade::Unmodelled, format!("{name}: slave register {v:#x}")),
                }
                let t = &mut self.tims[i];
                t.freeze(now);
                t.thaw(now);
            }
            0x0c => {
                let o = self.tims[i].dier;
                self.tims[i].dier = masks("DIER", 0x5f5f, self, o)
            }
            0x10 => self.tims[i].sr &= v,
            0x14 => {
                if v & 1 != 0 {
                    let quiet = self.tims[i].cr1 & 4 != 0;
                    let sr = self.tims[i].sr;
                    self.tim_update(i);
                    if quiet {
                        self.tims[i].sr = sr;
                    }
                }
                self.tims[i].sr |= v & 0x5e;
            }
            0x18 | 0x1c => self.tims[i].ccmr[(off as usize - 0x18) / 4] = v & 0xffff,
            0x20 => {
                let o = self.tims[i].ccer;
                self.tims[i].ccer = masks("CCER", 0xbbbb, self, o)
            }
            0x24 => {
                let t = &mut self.tims[i];
                t.count = u64::from(v);
                t.since = now;
                t.thaw(now);
            }
            0x28 => self.tims[i].psc_next = v & 0xffff,
            0x2c => {
                let t = &mut self.tims[i];
                t.arr_next = if t.wide { v } else { v & 0xffff };
                if t.cr1 & 0x80 == 0 {
                    t.arr = t.arr_next;
                    t.thaw(now);
                }
            }
            0x34..=0x40 => {
                let ch = (off as usize - 0x34) / 4;
                let t = &mut self.tims[i];
                t.ccr_next[ch] = if t.wide { v } else { v & 0xffff };
                if t.ccmr[ch / 2] >> (8 * (ch % 2) + 3) & 1 == 0 {
                    t.ccr[ch] = t.ccr_next[ch];
                    t.thaw(now);
                }
            }
            _ => self.say(Grade::Unmodelled, format!("{name}: write at {off:#x}")),
        }
    }

    /// Writes TIMx_CR1: switches the counter, and says at which rate it runs.
    fn tim_control(&mut self, i: usize, v: u32) {
        let now = self.now;
        let name = self.tims[i].name;
        let old = self.tims[i].cr1;
        let new = self.set(&format!("{name}_CR1"), old, v, 0x3ff);
        let t = &mut self.tims[i];
        t.freeze(now);
        t.cr1 = new;
        if new & !old & 1 != 0 {
            t.since = now;
        }
        t.thaw(now);
        if new & 0x70 != 0 {
            self.say(Grade::Unmodelled, format!("{name} counts down or centre-aligned"));
        }
        if new & !old & 1 != 0 {
            let t = &self.tims[i];
            let rate = TPS as f64 / (t.step() as f64 * (f64::from(t.arr) + 1.0));
            self.say(
                Grade::Fact,
                format!(
                    "{name} on: tick {:.3} MHz, period {rate:.4} Hz",
                    TPS as f64 / t.step() as f64 / 1e6
                ),
            );
        }
    }
}
