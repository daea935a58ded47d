//! The independent watchdog on any LSI between its limits (RM0090 section 21).

pub(super) mod registers;

use super::{Chip, rcc::registers::RCC_CSR_LSIRDY};
use crate::{
    report::Severity,
    simulation_time::{TICKS_PER_SECOND, ms_to_ticks},
};
use registers::*;

/// The registers of the watchdog and its counter.
#[derive(Default)]
pub struct Iwdg {
    pub(crate) pr: u32,
    pub(crate) rlr: u32,
    /// Start value of the counter: its reset value, until a reload.
    pub(crate) count: u32,
    pub(crate) unlocked: bool,
    /// It has been started.
    pub running: bool,
    /// When it resets the chip; NEVER: it does not run.
    pub expire: u64,
    pub(crate) pvu: u64,
    pub(crate) rvu: u64,
    /// The longest time between two reloads, in ticks.
    pub longest: u64,
    pub(crate) fed_at: u64,
    /// Reloads so far, the start included.
    pub feeds: u64,
}

impl Chip {
    pub(crate) fn reload_iwdg(&mut self) {
        let lsi = TICKS_PER_SECOND / self.world.lsi_hz;
        let period = lsi * (4 << self.iwdg.pr.min(6)) * u64::from(self.iwdg.count + 1);
        self.iwdg.expire = self.now + period;
        if self.iwdg.feeds > 0 {
            self.iwdg.longest = self.iwdg.longest.max(self.now - self.iwdg.fed_at);
        }
        self.iwdg.fed_at = self.now;
        self.iwdg.feeds += 1;
        self.record_finding(
            Severity::Fact,
            format!(
                "IWDG: resets after {:.0} ms at LSI {} Hz",
                period as f64 / ms_to_ticks(1) as f64,
                self.world.lsi_hz
            ),
        );
    }

    pub(crate) fn write_iwdg_register(&mut self, off: u32, v: u32) {
        let busy = 5 * TICKS_PER_SECOND / self.world.lsi_hz;
        match (off, v) {
            (KR_OFFSET, KR_UNLOCK) => self.iwdg.unlocked = true,
            (KR_OFFSET, KR_START) => {
                self.iwdg.unlocked = false;
                if !self.iwdg.running {
                    self.iwdg.running = true;
                    self.rcc.csr |= RCC_CSR_LSIRDY;
                    self.reload_iwdg();
                }
            }
            (KR_OFFSET, KR_RELOAD) => {
                self.iwdg.unlocked = false;
                // 21.3: only this loads it; a start alone counts from 0xfff.
                self.iwdg.count = self.iwdg.rlr;
                if self.iwdg.running {
                    self.reload_iwdg();
                }
            }
            (KR_OFFSET, _) => self.report_violation(format!("IWDG_KR: {v:#x} means nothing")),
            (PR_OFFSET | RLR_OFFSET, _) => {
                let until = if off == PR_OFFSET { self.iwdg.pvu } else { self.iwdg.rvu };
                if !self.iwdg.unlocked {
                    self.report_violation(format!("IWDG: register {off} written without 0x5555"));
                } else if until > self.now {
                    self.report_violation(format!(
                        "IWDG: register {off} written while its last update is under way"
                    ));
                } else if off == PR_OFFSET {
                    self.iwdg.pr = v & PR_MASK;
                    self.iwdg.pvu = self.now + busy;
                } else {
                    self.iwdg.rlr = v & RLR_MASK;
                    self.iwdg.rvu = self.now + busy;
                }
            }
            _ => self.report_violation(format!("IWDG: write at {off:#x}")),
        }
    }
}
