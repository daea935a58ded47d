//! TIM11 as a meter of the crystal: its input is HSE_RTC, the crystal divided by RTCPRE (RM0090 7.2.11 and
//! 19.5.11, TI1_RMP). Only what that needs: up-counting over 16 bits, captures of channel 1 with its
//! prescaler, the flags. Captures are computed when a register is accessed, because nothing else sees them.

mod registers;

use super::{
    Chip,
    rcc::registers::{RCC_CFGR_RTCPRE_MASK, RCC_CFGR_RTCPRE_SHIFT, RCC_CR_HSERDY},
    tim::registers::{
        ARR_OFFSET, ARR_RESET, CCER_CC1E, CCER_OFFSET, CCMR_CCS_MASK, CCMR1_OFFSET, CCR1_OFFSET,
        CNT_OFFSET, CR1_CEN, CR1_OFFSET, DIER_OFFSET, EGR_OFFSET, HALF_WORD_MASK, PSC_OFFSET,
        SR_CC1IF, SR_CC1OF, SR_OFFSET,
    },
};
use crate::report::Severity;
use registers::*;

/// The registers of TIM11 and the captures that have been computed.
#[derive(Clone, Copy, Default, Debug)]
pub struct Tim11 {
    cr1: u32,
    dier: u32,
    sr: u32,
    ccmr1: u32,
    ccer: u32,
    psc: u32,
    option: u32,
    ccr1: u32,
    /// When it began to count, and to capture.
    counts_since: u64,
    captures_since: u64,
    /// Captures that have been worked out.
    captured: u64,
}

impl Chip {
    /// Ticks of the simulation between two captures; `None`: nothing is captured.
    fn tim11_capture_period_ticks(&self) -> Option<u64> {
        if self.faults.capture_dead {
            return None;
        }
        let t = &self.tim11;
        let division = u64::from(self.rcc.cfgr >> RCC_CFGR_RTCPRE_SHIFT & RCC_CFGR_RTCPRE_MASK);
        let is_connected = t.option & OR_TI1_RMP_MASK == TI1_RMP_HSE_RTC
            && t.ccmr1 & CCMR_CCS_MASK == CCMR1_CC1S_TI1
            && t.ccer & CCER_CC1E != 0;
        if !is_connected || t.cr1 & CR1_CEN == 0 || self.rcc.cr & RCC_CR_HSERDY == 0 || division < 2
        {
            return None;
        }
        let prescaler = 1 << (t.ccmr1 >> CCMR1_IC1PSC_SHIFT & CCMR1_IC1PSC_MASK);
        let cycles =
            u128::from(division * prescaler) * u128::from(crate::simulation_time::TICKS_PER_SECOND);
        Some((cycles / u128::from(self.world.crystal_hz)) as u64)
    }

    fn tim11_count(&self, at: u64) -> u32 {
        let step = self.tclk2 * (u64::from(self.tim11.psc) + 1);
        ((at - self.tim11.counts_since) / step) as u32 & HALF_WORD_MASK
    }

    /// Computes the captures up to now.
    fn update_tim11_captures(&mut self) {
        let Some(period) = self.tim11_capture_period_ticks() else { return };
        let captures = (self.now - self.tim11.captures_since) / period;
        let fresh = captures - self.tim11.captured;
        if fresh == 0 {
            return;
        }
        self.tim11.captured = captures;
        let last = self.tim11.captures_since + captures * period;
        self.tim11.ccr1 = self.tim11_count(last);
        // 19.5.3: CC1OF if one comes while CC1IF is still set.
        if fresh > 1 || self.tim11.sr & SR_CC1IF != 0 {
            self.tim11.sr |= SR_CC1OF;
        }
        self.tim11.sr |= SR_CC1IF;
    }

    pub(crate) fn read_tim11_register(&mut self, off: u32) -> u32 {
        self.update_tim11_captures();
        match off {
            CR1_OFFSET => self.tim11.cr1,
            DIER_OFFSET => self.tim11.dier,
            SR_OFFSET => self.tim11.sr,
            CCMR1_OFFSET => self.tim11.ccmr1,
            CCER_OFFSET => self.tim11.ccer,
            CNT_OFFSET if self.tim11.cr1 & CR1_CEN != 0 => self.tim11_count(self.now),
            CNT_OFFSET => 0,
            PSC_OFFSET => self.tim11.psc,
            ARR_OFFSET => ARR_RESET,
            CCR1_OFFSET => {
                // 19.5.3: reading the capture clears its flag.
                self.tim11.sr &= !SR_CC1IF;
                self.tim11.ccr1
            }
            OR_OFFSET => self.tim11.option,
            _ => 0,
        }
    }

    pub(crate) fn write_tim11_register(&mut self, off: u32, v: u32) {
        self.update_tim11_captures();
        let now = self.now;
        let old = self.tim11;
        match off {
            CR1_OFFSET => {
                self.tim11.cr1 = self.apply_write_mask("TIM11_CR1", old.cr1, v, CR1_WRITE_MASK)
            }
            DIER_OFFSET => {
                self.tim11.dier = v;
                if v != 0 {
                    self.record_finding(Severity::Unmodelled, "TIM11: interrupts".into());
                }
            }
            SR_OFFSET => self.tim11.sr &= v,
            EGR_OFFSET => {}
            CCMR1_OFFSET => {
                if old.ccer & CCER_CC1E != 0 && (old.ccmr1 ^ v) & CCMR_CCS_MASK != 0 {
                    self.report_violation(
                        "TIM11_CCMR1: CC1S changed while the channel is on".into(),
                    );
                }
                self.tim11.ccmr1 = v & CCMR1_MASK;
            }
            CCER_OFFSET => {
                self.tim11.ccer = self.apply_write_mask("TIM11_CCER", old.ccer, v, CCER_WRITE_MASK)
            }
            PSC_OFFSET => self.tim11.psc = v & HALF_WORD_MASK,
            OR_OFFSET => self.tim11.option = v & OR_TI1_RMP_MASK,
            _ => self.record_finding(Severity::Unmodelled, format!("TIM11: write at {off:#x}")),
        }
        if self.tim11.cr1 & !old.cr1 & CR1_CEN != 0 {
            self.tim11.counts_since = now;
        }
        if self.tim11.ccer & !old.ccer & CCER_CC1E != 0 || self.tim11.cr1 & !old.cr1 & CR1_CEN != 0
        {
            self.tim11.captures_since = now;
            self.tim11.captured = 0;
        }
    }
}
