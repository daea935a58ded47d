//! The timers, up-counting: update and compare events, preload, trigger output to the converter.

pub(super) mod registers;

use super::{
    Chip,
    adc_conversion::ConversionGroup::{Injected, Regular},
};
use crate::{
    memory_map::*,
    report::Severity,
    simulation_time::{NEVER, TICKS_PER_SECOND},
};
use registers::*;

/// A timer: its registers, and its next events.
#[derive(Clone, Default)]
pub struct Tim {
    /// Its name in the manual.
    pub name: &'static str,
    /// Base address of its registers.
    pub base: u32,
    /// Number of its interrupt.
    pub irq: usize,
    /// It is on APB2, not on APB1.
    pub apb2: bool,
    pub(crate) wide: bool,
    /// Ticks of the simulation in a tick of the timer's clock.
    pub tick: u64,
    /// TIMx_CR1, control register 1.
    pub cr1: u32,
    /// TIMx_CR2, control register 2.
    pub cr2: u32,
    /// TIMx_SMCR, the slave mode.
    pub smcr: u32,
    /// TIMx_DIER, the enable bits of interrupts and DMA requests.
    pub dier: u32,
    /// TIMx_SR, the status register.
    pub sr: u32,
    /// TIMx_CCMR1 and TIMx_CCMR2, the modes of the channels.
    pub ccmr: [u32; 2],
    /// TIMx_CCER, the enable bits of the channels.
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
    /// When the next update comes; NEVER: none is due.
    pub update_at: u64,
    /// When each channel's next match comes; NEVER: none is due.
    pub cc_at: [u64; 4],
    /// Updates so far.
    pub updates: u64,
}

impl Tim {
    pub(crate) fn timers_after_reset() -> Vec<Tim> {
        [
            ("TIM2", TIM2_BASE, 28, false, true),
            ("TIM3", TIM3_BASE, 29, false, false),
            ("TIM4", TIM4_BASE, 30, false, false),
            ("TIM5", TIM5_BASE, 50, false, true),
            ("TIM6", TIM6_BASE, 54, false, false),
            ("TIM7", TIM7_BASE, 55, false, false),
            ("TIM1", TIM1_BASE, 25, true, false),
            ("TIM8", TIM8_BASE, 44, true, false),
        ]
        .into_iter()
        .map(|(name, base, irq, apb2, wide)| {
            let arr = if wide { u32::MAX } else { ARR_RESET };
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
    pub(crate) fn is_running(&self) -> bool {
        self.cr1 & CR1_CEN != 0 && self.smcr & SMCR_SMS_MASK != SMS_EXTERNAL_CLOCK
    }
    pub(crate) fn ticks_per_count(&self) -> u64 {
        self.tick * (u64::from(self.psc) + 1)
    }
    pub(crate) fn count(&self, now: u64) -> u32 {
        if self.is_running() {
            (self.count + (now - self.since) / self.ticks_per_count()) as u32
        } else {
            self.count as u32
        }
    }
    /// Before its clock changes.
    pub(crate) fn rebase_count(&mut self, now: u64) {
        if self.is_running() {
            self.count = u64::from(self.count(now));
            self.since = now;
        }
    }
    /// Plans what comes, from the count at `since`.
    pub(crate) fn schedule_events(&mut self, now: u64) {
        if !self.is_running() {
            self.update_at = NEVER;
            self.cc_at = [NEVER; 4];
            return;
        }
        let step = self.ticks_per_count();
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
    pub(crate) fn output_compare_mode(&self, ch: usize) -> u32 {
        self.ccmr[ch / 2] >> (CCMR_CHANNEL_BITS * (ch % 2) + CCMR_OCM_SHIFT) & CCMR_OCM_MASK
    }
}

impl Chip {
    pub(crate) fn handle_tim_update_event(&mut self, i: usize) {
        let now = self.now;
        let t = &mut self.tims[i];
        t.updates += 1;
        if t.cr1 & CR1_UDIS == 0 {
            t.psc = t.psc_next;
            t.arr = t.arr_next;
            t.ccr = t.ccr_next;
            t.sr |= SR_UIF;
        }
        t.count = 0;
        t.since = now;
        if t.cr1 & CR1_OPM != 0 {
            t.cr1 &= !CR1_CEN;
        }
        t.schedule_events(now);
        for ch in 0..4 {
            if t.ccr[ch] == 0 && t.base != TIM6_BASE && t.base != TIM7_BASE {
                t.sr |= SR_CC1IF << ch;
            }
        }
        let mms = t.cr2 >> CR2_MMS_SHIFT & CR2_MMS_MASK;
        let pwm1 = mms >= MMS_OC1REF
            && t.output_compare_mode(mms as usize - MMS_OC1REF as usize) == OCM_PWM1
            && t.ccr[mms as usize - MMS_OC1REF as usize] > 0;
        if mms == MMS_UPDATE || pwm1 {
            self.emit_trigger_output(i);
        }
        for ch in 0..4 {
            if self.tims[i].output_compare_mode(ch) == OCM_PWM1 && self.tims[i].ccr[ch] > 0 {
                self.emit_compare_output(i, ch);
            }
        }
    }

    pub(crate) fn handle_tim_compare_match(&mut self, i: usize, ch: usize) {
        let t = &mut self.tims[i];
        t.cc_at[ch] = NEVER;
        if t.ccmr[ch / 2] >> (CCMR_CHANNEL_BITS * (ch % 2)) & CCMR_CCS_MASK != 0 {
            return;
        }
        t.sr |= SR_CC1IF << ch;
        let mms = t.cr2 >> CR2_MMS_SHIFT & CR2_MMS_MASK;
        let mode = t.output_compare_mode(ch);
        if (mms == MMS_COMPARE_PULSE && ch == 0)
            || (mms == MMS_OC1REF + ch as u32 && matches!(mode, OCM_ACTIVE | OCM_TOGGLE | OCM_PWM2))
        {
            self.emit_trigger_output(i);
        }
        if matches!(mode, OCM_ACTIVE | OCM_TOGGLE | OCM_PWM2) {
            self.emit_compare_output(i, ch);
        }
    }

    /// RM0090 tables 69 and 70: what starts regular and injected sequences.
    pub(crate) fn emit_trigger_output(&mut self, i: usize) {
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
            if smcr & SMCR_SMS_MASK < SMS_RESET
                || smcr >> SMCR_TS_SHIFT & SMCR_TS_MASK > TS_ITR3
                || from[(smcr >> SMCR_TS_SHIFT & TS_ITR_MASK) as usize] != name
            {
                continue;
            }
            match smcr & SMCR_SMS_MASK {
                SMS_EXTERNAL_CLOCK if self.tims[j].cr1 & CR1_CEN != 0 => {
                    let t = &mut self.tims[j];
                    t.count += 1;
                    if t.count > u64::from(t.arr) {
                        self.handle_tim_update_event(j);
                    } else {
                        for ch in 0..4 {
                            if u64::from(self.tims[j].ccr[ch]) == self.tims[j].count {
                                self.handle_tim_compare_match(j, ch);
                            }
                        }
                    }
                }
                SMS_RESET => self.handle_tim_update_event(j),
                SMS_TRIGGER if self.tims[j].cr1 & CR1_CEN == 0 => {
                    let now = self.now;
                    let t = &mut self.tims[j];
                    t.cr1 |= CR1_CEN;
                    t.since = now;
                    t.schedule_events(now);
                }
                _ => {}
            }
        }
        match self.tims[i].name {
            "TIM1" => self.trigger_adc_sequences(Injected, 1),
            "TIM2" => {
                self.trigger_adc_sequences(Regular, 6);
                self.trigger_adc_sequences(Injected, 3);
            }
            "TIM3" => self.trigger_adc_sequences(Regular, 8),
            "TIM4" => self.trigger_adc_sequences(Injected, 9),
            "TIM5" => self.trigger_adc_sequences(Injected, 11),
            "TIM8" => self.trigger_adc_sequences(Regular, 14),
            _ => {}
        }
    }

    pub(crate) fn emit_compare_output(&mut self, i: usize, ch: usize) {
        if self.tims[i].ccer >> (CCER_CHANNEL_BITS * ch) & CCER_CC1E == 0 {
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
        self.trigger_adc_sequences(sequence, source);
    }

    pub(crate) fn read_tim_register(&mut self, i: usize, off: u32) -> u32 {
        let now = self.now;
        let t = &self.tims[i];
        match off {
            CR1_OFFSET => t.cr1,
            CR2_OFFSET => t.cr2,
            SMCR_OFFSET => t.smcr,
            DIER_OFFSET => t.dier,
            SR_OFFSET => t.sr,
            EGR_OFFSET => 0,
            CCMR1_OFFSET => t.ccmr[0],
            CCMR2_OFFSET => t.ccmr[1],
            CCER_OFFSET => t.ccer,
            CNT_OFFSET => t.count(now),
            PSC_OFFSET => t.psc_next,
            ARR_OFFSET => t.arr_next,
            CCR1_OFFSET..=CCR4_OFFSET => t.ccr_next[(off as usize - CCR1_OFFSET as usize) / 4],
            _ => 0,
        }
    }

    pub(crate) fn write_tim_register(&mut self, i: usize, off: u32, v: u32) {
        let now = self.now;
        let name = self.tims[i].name;
        let masks = |r: &str, m: u32, c: &mut Chip, old: u32| {
            c.apply_write_mask(&format!("{name}_{r}"), old, v, m)
        };
        match off {
            CR1_OFFSET => self.write_tim_cr1(i, v),
            CR2_OFFSET => {
                let o = self.tims[i].cr2;
                self.tims[i].cr2 = masks("CR2", CR2_WRITE_MASK, self, o)
            }
            SMCR_OFFSET => {
                self.tims[i].smcr = v;
                match v & SMCR_SMS_MASK {
                    SMS_OFF => {}
                    SMS_RESET | SMS_TRIGGER | SMS_EXTERNAL_CLOCK
                        if v >> SMCR_TS_SHIFT & SMCR_TS_MASK <= TS_ITR3 =>
                    {
                        self.record_finding(
                            Severity::Fact,
                            format!(
                                "{name}: slave mode {} on trigger {} ({})",
                                v & SMCR_SMS_MASK,
                                v >> SMCR_TS_SHIFT & SMCR_TS_MASK,
                                if v & SMCR_SMS_MASK == SMS_EXTERNAL_CLOCK {
                                    "counts its pulses"
                                } else if v & SMCR_SMS_MASK == SMS_TRIGGER {
                                    "is started by it"
                                } else {
                                    "is cleared by it"
                                }
                            ),
                        )
                    }
                    _ => self.record_finding(
                        Severity::Unmodelled,
                        format!("{name}: slave register {v:#x}"),
                    ),
                }
                let t = &mut self.tims[i];
                t.rebase_count(now);
                t.schedule_events(now);
            }
            DIER_OFFSET => {
                let o = self.tims[i].dier;
                self.tims[i].dier = masks("DIER", DIER_WRITE_MASK, self, o)
            }
            SR_OFFSET => self.tims[i].sr &= v,
            EGR_OFFSET => {
                if v & EGR_UG != 0 {
                    let quiet = self.tims[i].cr1 & CR1_URS != 0;
                    let sr = self.tims[i].sr;
                    self.handle_tim_update_event(i);
                    if quiet {
                        self.tims[i].sr = sr;
                    }
                }
                self.tims[i].sr |= v & EGR_FLAGS_MASK;
            }
            CCMR1_OFFSET | CCMR2_OFFSET => {
                self.tims[i].ccmr[(off as usize - CCMR1_OFFSET as usize) / 4] = v & HALF_WORD_MASK
            }
            CCER_OFFSET => {
                let o = self.tims[i].ccer;
                self.tims[i].ccer = masks("CCER", CCER_WRITE_MASK, self, o)
            }
            CNT_OFFSET => {
                let t = &mut self.tims[i];
                t.count = u64::from(v);
                t.since = now;
                t.schedule_events(now);
            }
            PSC_OFFSET => self.tims[i].psc_next = v & HALF_WORD_MASK,
            ARR_OFFSET => {
                let t = &mut self.tims[i];
                t.arr_next = if t.wide { v } else { v & HALF_WORD_MASK };
                if t.cr1 & CR1_ARPE == 0 {
                    t.arr = t.arr_next;
                    t.schedule_events(now);
                }
            }
            CCR1_OFFSET..=CCR4_OFFSET => {
                let ch = (off as usize - CCR1_OFFSET as usize) / 4;
                let t = &mut self.tims[i];
                t.ccr_next[ch] = if t.wide { v } else { v & HALF_WORD_MASK };
                if t.ccmr[ch / 2] >> (CCMR_CHANNEL_BITS * (ch % 2) + CCMR_OCPE_BIT) & 1 == 0 {
                    t.ccr[ch] = t.ccr_next[ch];
                    t.schedule_events(now);
                }
            }
            _ => self.record_finding(Severity::Unmodelled, format!("{name}: write at {off:#x}")),
        }
    }

    /// Writes TIMx_CR1: switches the counter, and says at which rate it runs.
    fn write_tim_cr1(&mut self, i: usize, v: u32) {
        let now = self.now;
        let name = self.tims[i].name;
        let old = self.tims[i].cr1;
        let new = self.apply_write_mask(&format!("{name}_CR1"), old, v, CR1_WRITE_MASK);
        let t = &mut self.tims[i];
        t.rebase_count(now);
        t.cr1 = new;
        if new & !old & CR1_CEN != 0 {
            t.since = now;
        }
        t.schedule_events(now);
        if new & CR1_DIR_CMS_MASK != 0 {
            self.record_finding(
                Severity::Unmodelled,
                format!("{name} counts down or centre-aligned"),
            );
        }
        if new & !old & CR1_CEN != 0 {
            let t = &self.tims[i];
            let rate =
                TICKS_PER_SECOND as f64 / (t.ticks_per_count() as f64 * (f64::from(t.arr) + 1.0));
            self.record_finding(
                Severity::Fact,
                format!(
                    "{name} on: tick {:.3} MHz, period {rate:.4} Hz",
                    TICKS_PER_SECOND as f64 / t.ticks_per_count() as f64 / 1e6
                ),
            );
        }
    }
}
