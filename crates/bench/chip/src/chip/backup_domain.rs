//! The backup domain (RM0090 section 5.1.2): what goes on from VBAT when the supply is gone. RCC_BDCR (7.3.20) with the
//! 32 kHz oscillator, the backup SRAM and its regulator (5.4.2), and the write protection of all of it (5.4.1, DBP).

pub(super) mod registers;

use super::{
    Chip,
    rcc::registers::{RCC_CSR_BORRSTF, RCC_CSR_LSIRDY, RCC_CSR_PINRSTF, RCC_CSR_PORRSTF},
    rtc::Rtc,
};
use crate::{
    report::Severity,
    simulation_time::{NEVER, TICKS_PER_SECOND, ms_to_ticks, us_to_ticks},
};
use registers::*;

/// DS8626, LSE oscillator characteristics: start-up time, typical.
const LSE_STARTUP_TICKS: u64 = ms_to_ticks(2_000);
/// The manuals give no time for the regulator: BRR just has to be waited for.
const BACKUP_REGULATOR_STARTUP_TICKS: u64 = us_to_ticks(40);
/// Words of the backup SRAM (2.3, table 1).
const BACKUP_SRAM_WORDS: usize = 1024;

/// Start value of the random numbers that the backup SRAM holds after the first power-on.
const BACKUP_SRAM_FILL_SEED: u32 = 0x9e37_79b9;

/// The backup domain, which VBAT supplies.
#[derive(Debug)]
pub struct BackupDomain {
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

impl Default for BackupDomain {
    /// As after the first power-on: the SRAM holds anything.
    fn default() -> BackupDomain {
        let mut seed = BACKUP_SRAM_FILL_SEED;
        let sram = (0..BACKUP_SRAM_WORDS).map(|_| next_random_word(&mut seed)).collect();
        let (lse_at, regulator_at) = (NEVER, NEVER);
        BackupDomain { bdcr: 0, lse_at, again_at: 0, regulator_at, sram, rtc: Rtc::default() }
    }
}

fn next_random_word(seed: &mut u32) -> u32 {
    *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    *seed ^ *seed >> 15
}

impl Chip {
    /// Returns whether writes reach the backup domain. The unit whose write is lost is named.
    pub(crate) fn check_backup_writable(&mut self, what: &str) -> bool {
        let open = self.pwr_cr & PWR_CR_DBP != 0;
        if !open {
            self.report_violation(format!("{what}: written without PWR_CR.DBP (5.4.1)"));
        }
        open
    }

    /// Returns whether the 32 kHz oscillator swings now.
    fn is_lse_running(&self) -> bool {
        !self.faults.lse_dead && self.backup.lse_at.max(self.backup.again_at) <= self.now
    }

    /// Ticks in a cycle of RTCCLK; `None`: it stands.
    pub(crate) fn rtcclk_period_ticks(&self) -> Option<u64> {
        let hz = match self.backup.bdcr & (BDCR_RTCSEL | BDCR_RTCEN) {
            n if n & BDCR_RTCEN == 0 => return None,
            n if n & BDCR_RTCSEL == BDCR_RTCSEL_LSE => {
                self.is_lse_running().then_some(self.world.lse_hz)?
            }
            n if n & BDCR_RTCSEL == BDCR_RTCSEL_LSI => {
                (self.rcc.csr & RCC_CSR_LSIRDY != 0).then_some(self.world.lsi_hz)?
            }
            _ => return None,
        };
        Some(TICKS_PER_SECOND / hz)
    }

    pub(crate) fn read_bdcr(&self) -> u32 {
        self.backup.bdcr | u32::from(self.backup.lse_at <= self.now) << BDCR_LSERDY_SHIFT
    }

    pub(crate) fn write_bdcr(&mut self, v: u32) {
        if !self.check_backup_writable("RCC_BDCR") {
            return;
        }
        self.update_rtc_calendar();
        let old = self.backup.bdcr;
        if v & BDCR_BDRST != 0 {
            // 7.1.3: the registers of the RTC, this one, and BRE of PWR_CSR; the SRAM stays.
            self.backup.rtc = Rtc::default();
            self.backup.regulator_at = NEVER;
            self.backup.lse_at = NEVER;
            self.backup.bdcr = BDCR_BDRST;
            return;
        }
        if old & BDCR_RTCSEL != 0 && (old ^ v) & BDCR_RTCSEL != 0 {
            self.report_violation(
                "RCC_BDCR: RTCSEL changed without a reset of the domain (7.3.20)".into(),
            );
            return;
        }
        if v & BDCR_RTCSEL == BDCR_RTCSEL {
            self.record_finding(
                Severity::Unmodelled,
                "RCC_BDCR: the RTC from the fast crystal".into(),
            );
        }
        let v = self.apply_write_mask(
            "RCC_BDCR",
            old & !BDCR_BDRST,
            v & !BDCR_LSERDY,
            BDCR_LSEON | BDCR_LSEBYP | BDCR_RTCSEL | BDCR_RTCEN,
        );
        if v & !old & BDCR_LSEON != 0 {
            self.backup.lse_at =
                if self.faults.lse_dead { NEVER } else { self.now + LSE_STARTUP_TICKS };
        }
        if v & BDCR_LSEON == 0 {
            self.backup.lse_at = NEVER;
        }
        self.backup.bdcr = v;
    }

    pub(crate) fn read_pwr_csr(&self) -> u32 {
        let on = self.backup.regulator_at != NEVER;
        let ready = self.backup.regulator_at <= self.now;
        self.pwr_cr & PWR_CSR_VOSRDY
            | u32::from(on) << PWR_CSR_BRE_SHIFT
            | u32::from(ready) << PWR_CSR_BRR_SHIFT
    }

    pub(crate) fn write_pwr_csr(&mut self, v: u32) {
        let on = self.backup.regulator_at != NEVER;
        if (v & PWR_CSR_BRE != 0) == on || !self.check_backup_writable("PWR_CSR.BRE") {
            return;
        }
        self.backup.regulator_at =
            if v & PWR_CSR_BRE != 0 { self.now + BACKUP_REGULATOR_STARTUP_TICKS } else { NEVER };
    }

    pub(crate) fn read_backup_sram(&self, address: u32) -> u32 {
        self.backup.sram[address as usize / 4 % BACKUP_SRAM_WORDS]
    }

    pub(crate) fn write_backup_sram(&mut self, address: u32, v: u32) {
        if self.check_backup_writable("backup SRAM") {
            self.backup.sram[address as usize / 4 % BACKUP_SRAM_WORDS] = v;
        }
    }

    /// The supply goes, and comes back after this many seconds.
    pub fn cycle_power(&mut self, seconds: u64) {
        self.simulate_power_loss(1, seconds);
        // 7.3.21: PORRSTF, PINRSTF, BORRSTF.
        self.reset(RCC_CSR_PORRSTF | RCC_CSR_PINRSTF | RCC_CSR_BORRSTF);
    }

    /// The supply is gone for this many seconds; what VBAT holds goes on (5.1.2).
    pub(crate) fn apply_power_loss_to_backup_domain(&mut self, seconds: u64) {
        self.update_rtc_calendar();
        let is_ready = self.backup.regulator_at <= self.now;
        if !is_ready || !self.world.battery {
            let mut seed = self.now as u32;
            self.backup.sram.fill_with(|| next_random_word(&mut seed));
        }
        if !self.world.battery {
            let sram = std::mem::take(&mut self.backup.sram);
            self.backup = BackupDomain { sram, ..BackupDomain::default() };
            return;
        }
        // The internal oscillator has no VBAT.
        if self.backup.bdcr & BDCR_RTCSEL == BDCR_RTCSEL_LSE && self.rtcclk_period_ticks().is_some()
        {
            self.advance_rtc(seconds * TICKS_PER_SECOND);
        }
    }

    /// Bits of a word of the backup SRAM flip.
    pub(crate) fn flip_backup_sram_bits(&mut self, address: u32, bits: u32) {
        self.backup.sram[address as usize / 4 % BACKUP_SRAM_WORDS] ^= bits;
    }

    /// The 32 kHz crystal stops, or is there again and has to start. Its flag stays: what would clear it needs its own
    /// cycles (7.3.20, LSERDY).
    pub fn set_lse_running(&mut self, runs: bool) {
        self.update_rtc_calendar();
        if runs && self.faults.lse_dead {
            self.backup.again_at = self.now + LSE_STARTUP_TICKS;
        }
        self.faults.lse_dead = !runs;
        if runs && self.backup.bdcr & BDCR_LSEON != 0 && self.backup.lse_at == NEVER {
            self.backup.lse_at = self.now + LSE_STARTUP_TICKS;
        }
        self.update_rtc_calendar();
    }
}
