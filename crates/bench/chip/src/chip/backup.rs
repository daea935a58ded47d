//! The backup domain (RM0090 section 5.1.2): what goes on from VBAT when the supply is gone. RCC_BDCR (7.3.20) with the
//! 32 kHz oscillator, the backup SRAM and its regulator (5.4.2), and the write protection of all of it (5.4.1, DBP).

use super::{Chip, rtc::Rtc};
use crate::{
    report::Grade,
    time::{NEVER, TPS, ms, us},
};

/// DS8626, LSE oscillator characteristics: start-up time, typical.
const LSE_START: u64 = ms(2_000);
/// The manuals give no time for the regulator: BRR just has to be waited for.
const REGULATOR_START: u64 = us(40);
/// Words of the backup SRAM (2.3, table 1).
const WORDS: usize = 1024;

const LSEON: u32 = 1;
const RTCSEL: u32 = 3 << 8;
const RTCEN: u32 = 1 << 15;
const BDRST: u32 = 1 << 16;
const DBP: u32 = 1 << 8;
const BRE: u32 = 1 << 9;

/// The backup domain, which VBAT supplies.
#[derive(Debug)]
pub struct Backup {
    pub(crate) bdcr: u32,
    /// When the 32 kHz oscillator says that it swings; NEVER: it is off, or dead.
    lse_at: u64,
    /// When a crystal that had stopped swings again.
    again_at: u64,
    /// Since when the regulator holds the SRAM; NEVER: it is off.
    regulator_at: u64,
    sram: Vec<u32>,
    pub(crate) rtc: Rtc,
}

impl Default for Backup {
    /// As after the first power-on: the SRAM holds anything.
    fn default() -> Backup {
        let mut seed = 0x9e37_79b9_u32;
        let sram = (0..WORDS).map(|_| noise(&mut seed)).collect();
        let (lse_at, regulator_at) = (NEVER, NEVER);
        Backup { bdcr: 0, lse_at, again_at: 0, regulator_at, sram, rtc: Rtc::default() }
    }
}

fn noise(seed: &mut u32) -> u32 {
    *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    *seed ^ *seed >> 15
}

impl Chip {
    /// Returns whether writes reach the backup domain. The unit whose write is lost is named.
    pub(crate) fn reaches_backup(&mut self, what: &str) -> bool {
        let open = self.pwr_cr & DBP != 0;
        if !open {
            self.violation(format!("{what}: written without PWR_CR.DBP (5.4.1)"));
        }
        open
    }

    /// Returns whether the 32 kHz oscillator swings now.
    fn lse_runs(&self) -> bool {
        !self.faults.lse_dead && self.backup.lse_at.max(self.backup.again_at) <= self.now
    }

    /// Ticks in a cycle of RTCCLK; `None`: it stands.
    pub(crate) fn rtc_cycle(&self) -> Option<u64> {
        let hz = match self.backup.bdcr & (RTCSEL | RTCEN) {
            n if n & RTCEN == 0 => return None,
            n if n & RTCSEL == 1 << 8 => self.lse_runs().then_some(self.world.lse_hz)?,
            n if n & RTCSEL == 2 << 8 => (self.rcc.csr & 2 != 0).then_some(self.world.lsi_hz)?,
            _ => return None,
        };
        Some(TPS / hz)
    }

    pub(crate) fn bdcr_read(&self) -> u32 {
        self.backup.bdcr | u32::from(self.backup.lse_at <= self.now) << 1
    }

    pub(crate) fn bdcr_write(&mut self, v: u32) {
        if !self.reaches_backup("RCC_BDCR") {
            return;
        }
        self.rtc_settle();
        let old = self.backup.bdcr;
        if v & BDRST != 0 {
            // 7.1.3: the registers of the RTC, this one, and BRE of PWR_CSR; the SRAM stays.
            self.backup.rtc = Rtc::default();
            self.backup.regulator_at = NEVER;
            self.backup.lse_at = NEVER;
            self.backup.bdcr = BDRST;
            return;
        }
        if old & RTCSEL != 0 && (old ^ v) & RTCSEL != 0 {
            self.violation(
                "RCC_BDCR: RTCSEL changed without a reset of the domain (7.3.20)".into(),
            );
            return;
        }
        if v & RTCSEL == RTCSEL {
            self.say(Grade::Unmodelled, "RCC_BDCR: the RTC from the fast crystal".into());
        }
        let v = self.set("RCC_BDCR", old & !BDRST, v & !2, LSEON | 4 | RTCSEL | RTCEN);
        if v & !old & LSEON != 0 {
            self.backup.lse_at = if self.faults.lse_dead { NEVER } else { self.now + LSE_START };
        }
        if v & LSEON == 0 {
            self.backup.lse_at = NEVER;
        }
        self.backup.bdcr = v;
    }

    pub(crate) fn pwr_csr_read(&self) -> u32 {
        let on = self.backup.regulator_at != NEVER;
        let ready = self.backup.regulator_at <= self.now;
        self.pwr_cr & 0x4000 | u32::from(on) << 9 | u32::from(ready) << 3
    }

    pub(crate) fn pwr_csr_write(&mut self, v: u32) {
        let on = self.backup.regulator_at != NEVER;
        if (v & BRE != 0) == on || !self.reaches_backup("PWR_CSR.BRE") {
            return;
        }
        self.backup.regulator_at = if v & BRE != 0 { self.now + REGULATOR_START } else { NEVER };
    }

    pub(crate) fn backup_sram_read(&self, address: u32) -> u32 {
        self.backup.sram[address as usize / 4 % WORDS]
    }

    pub(crate) fn backup_sram_write(&mut self, address: u32, v: u32) {
        if self.reaches_backup("backup SRAM") {
            self.backup.sram[address as usize / 4 % WORDS] = v;
        }
    }

    /// The supply goes, and comes back after this many seconds.
    pub fn power_cut(&mut self, seconds: u64) {
        self.lose_memory(1, seconds);
        // 7.3.21: PORRSTF, PINRSTF, BORRSTF.
        self.reset(1 << 27 | 1 << 26 | 1 << 25);
    }

    /// The supply is gone for this many seconds; what VBAT holds goes on (5.1.2).
    pub(crate) fn backup_outlasts(&mut self, seconds: u64) {
        self.rtc_settle();
        let is_ready = self.backup.regulator_at <= self.now;
        if !is_ready || !self.world.battery {
            let mut seed = self.now as u32;
            self.backup.sram.fill_with(|| noise(&mut seed));
        }
        if !self.world.battery {
            let sram = std::mem::take(&mut self.backup.sram);
            self.backup = Backup { sram, ..Backup::default() };
            return;
        }
        // The internal oscillator has no VBAT.
        if self.backup.bdcr & RTCSEL == 1 << 8 && self.rtc_cycle().is_some() {
            self.rtc_pass(seconds * TPS);
        }
    }

    /// Bits of a word of the backup SRAM flip.
    pub(crate) fn backup_sram_flip(&mut self, address: u32, bits: u32) {
        self.backup.sram[address as usize / 4 % WORDS] ^= bits;
    }

    /// The 32 kHz crystal stops, or is there again and has to start. Its flag stays: what would clear it needs its own
    /// cycles (7.3.20, LSERDY).
    pub fn lse(&mut self, runs: bool) {
        self.rtc_settle();
        if runs && self.faults.lse_dead {
            self.backup.again_at = self.now + LSE_START;
        }
        self.faults.lse_dead = !runs;
        if runs && self.backup.bdcr & LSEON != 0 && self.backup.lse_at == NEVER {
            self.backup.lse_at = self.now + LSE_START;
        }
        self.rtc_settle();
    }
}
