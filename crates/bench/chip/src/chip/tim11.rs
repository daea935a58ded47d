//! TIM11 as a meter of the crystal: its input is HSE_RTC, the crystal divided by RTCPRE (RM0090 7.2.11 and
//! 19.5.11, TI1_RMP). Only what that needs: up-counting over 16 bits, captures of channel 1 with its
//! prescaler, the flags. Captures are computed when a register is accessed, because nothing else sees them.

use super::Chip;
use crate::report::Grade;

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
    fn tim11_period(&self) -> Option<u64> {
        if self.faults.capture_dead {
            return None;
        }
        let t = &self.tim11;
        let division = u64::from(self.rcc.cfgr >> 16 & 31);
        let is_connected = t.option & 3 == 2 && t.ccmr1 & 3 == 1 && t.ccer & 1 != 0;
        if !is_connected || t.cr1 & 1 == 0 || self.rcc.cr & 1 << 17 == 0 || division < 2 {
            return None;
        }
        let prescaler = 1 << (t.ccmr1 >> 2 & 3);
        let cycles = u128::from(division * prescaler) * u128::from(crate::time::TPS);
        Some((cycles / u128::from(self.world.crystal_hz)) as u64)
    }

    fn tim11_count(&self, at: u64) -> u32 {
        let step = self.tclk2 * (u64::from(self.tim11.psc) + 1);
        ((at - self.tim11.counts_since) / step) as u32 & 0xffff
    }

    /// Computes the captures up to now.
    fn tim11_look(&mut self) {
        let Some(period) = self.tim11_period() else { return };
        let captures = (self.now - self.tim11.captures_since) / period;
        let fresh = captures - self.tim11.captured;
        if fresh == 0 {
            return;
        }
        self.tim11.captured = captures;
        let last = self.tim11.captures_since + captures * period;
        self.tim11.ccr1 = self.tim11_count(last);
        // 19.5.3: CC1OF if one comes while CC1IF is still set.
        if fresh > 1 || self.tim11.sr & 2 != 0 {
            self.tim11.sr |= 1 << 9;
        }
        self.tim11.sr |= 2;
    }

    pub(crate) fn tim11_read(&mut self, off: u32) -> u32 {
        self.tim11_look();
        match off {
            0x00 => self.tim11.cr1,
            0x0c => self.tim11.dier,
            0x10 => self.tim11.sr,
            0x18 => self.tim11.ccmr1,
            0x20 => self.tim11.ccer,
            0x24 if self.tim11.cr1 & 1 != 0 => self.tim11_count(self.now),
            0x24 => 0,
            0x28 => self.tim11.psc,
            0x2c => 0xffff,
            0x34 => {
                // 19.5.3: reading the capture clears its flag.
                self.tim11.sr &= !2;
                self.tim11.ccr1
            }
            0x50 => self.tim11.option,
            _ => 0,
        }
    }

    pub(crate) fn tim11_write(&mut self, off: u32, v: u32) {
        self.tim11_look();
        let now = self.now;
        let old = self.tim11;
        match off {
            0x00 => self.tim11.cr1 = self.set("TIM11_CR1", old.cr1, v, 0x387),
            0x0c => {
                self.tim11.dier = v;
                if v != 0 {
                    self.say(Grade::Unmodelled, "TIM11: interrupts".into());
                }
            }
            0x10 => self.tim11.sr &= v,
            0x14 => {}
            0x18 => {
                if old.ccer & 1 != 0 && (old.ccmr1 ^ v) & 3 != 0 {
                    self.violation("TIM11_CCMR1: CC1S changed while the channel is on".into());
                }
                self.tim11.ccmr1 = v & 0xff;
            }
            0x20 => self.tim11.ccer = self.set("TIM11_CCER", old.ccer, v, 0xb),
            0x28 => self.tim11.psc = v & 0xffff,
            0x50 => self.tim11.option = v & 3,
            _ => self.say(Grade::Unmodelled, format!("TIM11: write at {off:#x}")),
        }
        if self.tim11.cr1 & !old.cr1 & 1 != 0 {
            self.tim11.counts_since = now;
        }
        if self.tim11.ccer & !old.ccer & 1 != 0 || self.tim11.cr1 & !old.cr1 & 1 != 0 {
            self.tim11.captures_since = now;
            self.tim11.captured = 0;
        }
    }
}
