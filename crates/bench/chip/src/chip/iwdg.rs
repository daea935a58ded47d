//! The independent watchdog on any LSI between its limits (RM0090 section 21).

use super::Chip;
use crate::{
    report::Grade,
    time::{TPS, ms},
};

#[derive(Default)]
pub struct Iwdg {
    pub(crate) pr: u32,
    pub(crate) rlr: u32,
    /// Start value of the counter: its reset value, until a reload.
    pub(crate) count: u32,
    pub(crate) unlocked: bool,
    pub running: bool,
    pub expire: u64,
    pub(crate) pvu: u64,
    pub(crate) rvu: u64,
    pub longest: u64,
    pub(crate) fed_at: u64,
    pub feeds: u64,
}

impl Chip {
    pub(crate) fn iwdg_reload(&mut self) {
        let lsi = TPS / self.world.lsi_hz;
        let period = lsi * (4 << self.iwdg.pr.min(6)) * u64::from(self.iwdg.count + 1);
        self.iwdg.expire = self.now + period;
        if self.iwdg.feeds > 0 {
            self.iwdg.longest = self.iwdg.longest.max(self.now - self.iwdg.fed_at);
        }
        self.iwdg.fed_at = self.now;
        self.iwdg.feeds += 1;
        self.say(
            Grade::Fact,
            format!(
                "IWDG: resets after {:.0} ms at LSI {} Hz",
                period as f64 / ms(1) as f64,
                self.world.lsi_hz
            ),
        );
    }

    pub(crate) fn iwdg_write(&mut self, off: u32, v: u32) {
        let busy = 5 * TPS / self.world.lsi_hz;
        match (off, v) {
            (0, 0x5555) => self.iwdg.unlocked = true,
            (0, 0xcccc) => {
                self.iwdg.unlocked = false;
                if !self.iwdg.running {
                    self.iwdg.running = true;
                    self.rcc.csr |= 2;
                    self.iwdg_reload();
                }
            }
            (0, 0xaaaa) => {
                self.iwdg.unlocked = false;
                // 21.3: only this loads it; a start alone counts from 0xfff.
                self.iwdg.count = self.iwdg.rlr;
                if self.iwdg.running {
                    self.iwdg_reload();
                }
            }
            (0, _) => self.violation(format!("IWDG_KR: {v:#x} means nothing")),
            (4 | 8, _) => {
                let until = if off == 4 { self.iwdg.pvu } else { self.iwdg.rvu };
                if !self.iwdg.unlocked {
                    self.violation(format!("IWDG: register {off} written without 0x5555"));
                } else if until > self.now {
                    self.violation(format!(
                        "IWDG: register {off} written while its last update is under way"
                    ));
                } else if off == 4 {
                    self.iwdg.pr = v & 7;
                    self.iwdg.pvu = self.now + busy;
                } else {
                    self.iwdg.rlr = v & 0xfff;
                    self.iwdg.rvu = self.now + busy;
                }
            }
            _ => self.violation(format!("IWDG: write at {off:#x}")),
        }
    }
}
