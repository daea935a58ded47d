//! The flash controller and its array: one bank, sectors of 16, 64 and 128 KB.

pub(super) mod registers;

use super::{Chip, FLAG_PROGRAMMING_CHANGED, script_playback::GOLDEN_RATIO_MULTIPLIER};
use crate::{
    report::Severity,
    simulation_time::{NEVER, TICKS_PER_SECOND, ms_to_ticks, us_to_ticks},
};
use registers::*;
use std::sync::atomic::Ordering;

/// Counts of the operations on the flash; a reset keeps them.
#[derive(Clone, Copy, Default)]
pub struct FlashStats {
    /// Writes programmed.
    pub words: u64,
    /// Programmings of the option bytes.
    pub options: u32,
    /// Erases of each sector.
    pub erases: [u32; 12],
    /// The longest operation, in ticks.
    pub longest_stall: u64,
}

/// The registers of the flash interface and the operation under way.
#[derive(Default)]
pub struct FlashModel {
    /// FLASH_ACR, access control.
    pub acr: u32,
    pub(crate) sr: u32,
    pub(crate) cr: u32,
    /// FLASH_OPTCR, the option bytes.
    pub optcr: u32,
    pub(crate) key: u32,
    pub(crate) optkey: u32,
    pub(crate) dead: bool,
    /// When the operation under way ends.
    pub busy_until: u64,
    /// When the end of the operation is to be handled; NEVER: there is none.
    pub done_at: u64,
    /// 2: the data cache was on during an erase and has not been reset since.
    pub stale: u32,
    /// Counts of the operations so far.
    pub stats: FlashStats,
    /// The address of the operation in flight, and the bytes there before it.
    pub(crate) before: (u32, Vec<u8>),
}

/// (start, length) of a sector.
pub fn sector_start_and_length(n: u32) -> (u32, u32) {
    match n {
        0..=3 => (n * SMALL_SECTOR_BYTES, SMALL_SECTOR_BYTES),
        4 => (MIDDLE_SECTOR_BYTES, MIDDLE_SECTOR_BYTES),
        _ => ((n - 4) * LARGE_SECTOR_BYTES, LARGE_SECTOR_BYTES),
    }
}

impl FlashModel {
    pub(crate) fn after_reset(stats: FlashStats) -> FlashModel {
        FlashModel {
            cr: CR_RESET,
            optcr: OPTCR_RESET,
            done_at: NEVER,
            stats,
            ..FlashModel::default()
        }
    }
    pub(crate) fn unlock(&mut self) {
        self.cr &= !CR_LOCK;
    }

    pub(crate) fn is_programming(&self) -> bool {
        self.cr & CR_PG != 0 && self.cr >> CR_LOCK_BIT == 0
    }
    pub(crate) fn is_irq_asserted(&self) -> bool {
        (self.sr & SR_EOP != 0 && self.cr & CR_EOPIE != 0)
            || (self.sr & SR_OPERR != 0 && self.cr & CR_ERRIE != 0)
    }
}

impl Chip {
    pub(crate) fn check_flash_latency(&mut self) {
        let hz = TICKS_PER_SECOND / self.hclk;
        let need = (hz.div_ceil(30_000_000) - 1) as u32;
        if self.flash.acr & ACR_LATENCY_MASK < need {
            self.report_violation(format!(
                "flash: {} wait states at HCLK {hz} Hz, which needs {need} at 2.7 to 3.6 V",
                self.flash.acr & ACR_LATENCY_MASK
            ));
        }
    }

    /// Passes the setting of the flash to the accelerator; `written` may empty its cache.
    pub(crate) fn update_accelerator(&self, written: u32) {
        let acr = u64::from(self.flash.acr & ACR_SETTINGS_MASK | written & ACR_ICRST);
        let writes = self.shared.acr.load(Ordering::Relaxed) >> 32;
        self.shared.acr.store((writes + 1) << 32 | acr, Ordering::Relaxed);
    }

    pub(crate) fn read_flash_register(&mut self, off: u32) -> u32 {
        match off {
            ACR_OFFSET => self.flash.acr,
            SR_OFFSET => {
                self.flash.sr | u32::from(self.flash.busy_until > self.now) << SR_BSY_SHIFT
            }
            CR_OFFSET => self.flash.cr,
            OPTCR_OFFSET => self.flash.optcr,
            KEYR_OFFSET | OPTKEYR_OFFSET => {
                self.report_violation("FLASH: a key register read".into());
                0
            }
            _ => 0,
        }
    }

    /// Writes the access control register: wait states, prefetch and the caches.
    fn write_flash_acr(&mut self, v: u32) {
        // RM0090 3.9.1: ICRST and DCRST only while their own cache is off.
        if (v & ACR_DCRST != 0 && self.flash.acr & ACR_DCEN != 0)
            || (v & ACR_ICRST != 0 && self.flash.acr & ACR_ICEN != 0)
        {
            self.report_violation("FLASH_ACR: a cache reset while it is on".into());
        }
        if v & ACR_DCRST != 0 && self.flash.acr & ACR_DCEN == 0 {
            self.flash.stale &= !ACR_DATA_CACHE;
        }
        self.flash.acr = self.apply_write_mask("FLASH_ACR", self.flash.acr, v, ACR_WRITE_MASK);
        self.update_accelerator(v);
        let on = self.flash.acr >> ACR_CACHES_SHIFT & ACR_CACHES_MASK;
        self.record_finding(
            Severity::Fact,
            format!(
                "flash: wait states {}, prefetch {}, instruction cache {}, data cache {}",
                self.flash.acr & ACR_LATENCY_MASK,
                self.flash.acr >> ACR_PRFTEN_SHIFT & 1,
                on & 1,
                on >> 1
            ),
        );
        if self.flash.stale & on != 0 && v & ACR_DCRST == 0 {
            self.record_finding(
                Severity::Remark,
                "flash: the data cache is on after an erase without having been reset".into(),
            );
        }
        self.check_flash_latency();
    }

    pub(crate) fn write_flash_register(&mut self, off: u32, v: u32) {
        match off {
            ACR_OFFSET => self.write_flash_acr(v),
            KEYR_OFFSET => {
                if self.flash.dead || self.flash.cr >> CR_LOCK_BIT == 0 {
                    self.report_violation("FLASH_KEYR written while unlocked or dead".into());
                } else if self.flash.key == 0 && v == KEY1 {
                    self.flash.key = 1;
                } else if self.flash.key == 1 && v == KEY2 {
                    self.flash.key = 0;
                    self.flash.cr &= !CR_LOCK;
                } else {
                    self.flash.dead = true;
                    self.report_violation(format!(
                        "FLASH_KEYR: {v:#x} is the wrong key; locked until the next reset"
                    ));
                }
            }
            OPTKEYR_OFFSET => {
                if self.flash.optkey == 0 && v == OPTKEY1 {
                    self.flash.optkey = 1;
                } else if self.flash.optkey == 1 && v == OPTKEY2 {
                    self.flash.optkey = 0;
                    self.flash.optcr &= !OPTCR_OPTLOCK;
                } else {
                    self.flash.optkey = 2;
                    self.report_violation(format!(
                        "FLASH_OPTKEYR: {v:#x} is the wrong key; locked until the next reset"
                    ));
                }
            }
            OPTCR_OFFSET => {
                if self.flash.optcr & OPTCR_OPTLOCK != 0 {
                    let rule = format!("FLASH_OPTCR: {v:#x} written while it is locked");
                    return self.report_violation(rule);
                }
                if self.flash.busy_until > self.now {
                    return self.report_violation("FLASH_OPTCR written while busy".into());
                }
                self.flash.optcr =
                    self.apply_write_mask("FLASH_OPTCR", self.flash.optcr, v, OPTCR_WRITE_MASK)
                        & !OPTCR_OPTSTRT;
                if v & OPTCR_OPTSTRT != 0 {
                    let o = self.flash.optcr;
                    self.record_finding(Severity::Fact, format!("option bytes programmed: brown-out level {}, watchdog by {}, read protection {:#04x}, write protection {:#05x}",
                        3 - (o >> OPTCR_BOR_LEV_SHIFT & OPTCR_BOR_LEV_MASK), if o & OPTCR_WDG_SW != 0 { "software" } else { "hardware" }, o >> OPTCR_RDP_SHIFT & OPTCR_RDP_MASK, !o >> OPTCR_NWRP_SHIFT & OPTCR_NWRP_MASK));
                    self.flash.stats.options += 1;
                    // Not in DS8626; an erase of a small sector is the nearest.
                    self.set_flash_busy(ms_to_ticks(250));
                }
            }
            SR_OFFSET => self.flash.sr &= !(v & SR_WRITE_ONE_CLEAR_MASK),
            CR_OFFSET => {
                if self.flash.busy_until > self.now {
                    let rule = "FLASH_CR written while busy: the bus stands still";
                    self.report_violation(rule.into());
                }
                if self.flash.cr >> CR_LOCK_BIT != 0 {
                    self.report_violation("FLASH_CR written while it is locked".into());
                    return;
                }
                self.flash.cr = self.apply_write_mask("FLASH_CR", self.flash.cr, v, CR_WRITE_MASK);
                self.shared.flag.fetch_or(FLAG_PROGRAMMING_CHANGED, Ordering::Relaxed);
                if v & CR_STRT != 0 {
                    self.flash.cr &= !CR_STRT;
                    self.start_flash_erase();
                }
            }
            _ => self.report_violation(format!("FLASH: write at {off:#x}")),
        }
    }

    pub(crate) fn set_flash_busy(&mut self, ticks: u64) {
        self.flash.busy_until = self.now + ticks;
        self.flash.done_at = self.flash.busy_until;
        self.flash.stats.longest_stall = self.flash.stats.longest_stall.max(ticks);
        self.shared.stall.store(self.flash.busy_until, Ordering::Relaxed);
    }

    pub(crate) fn start_flash_erase(&mut self) {
        let cr = self.flash.cr;
        if self.flash.sr & SR_ERROR_MASK != 0 {
            return self.report_violation(format!(
                "flash: erase started with error flags set ({:#x})",
                self.flash.sr
            ));
        }
        let size = (cr >> CR_PSIZE_SHIFT & CR_PSIZE_MASK) as usize;
        match cr & CR_OPERATION_MASK {
            CR_SER => {
                let n = cr >> CR_SNB_SHIFT & CR_SNB_MASK;
                if n > 11 {
                    return self.report_violation(format!("flash: sector {n} does not exist"));
                }
                let (at, len) = sector_start_and_length(n);
                if self.is_write_protected(at) {
                    self.flash.sr |= SR_WRPERR;
                    return self
                        .record_finding(Severity::Fact, format!("flash: sector {n} is protected"));
                }
                let mut old = vec![0; len as usize];
                self.rom.read_at(u64::from(at), &mut old).expect("in the flash");
                self.flash.before = (at, old);
                self.rom.fill(u64::from(at), u64::from(len), ERASED_BYTE).expect("in the flash");
                self.flash.stats.erases[n as usize] += 1;
                // DS8626, flash memory programming, typical by width x8, x16, x32: 16, 64 and 128 KB.
                let (small, middle, large) = (
                    [400, 300, 250, 250][size],
                    [1200, 700, 550, 550][size],
                    [2000, 1300, 1000, 1000][size],
                );
                let typical: u64 = match len {
                    SMALL_SECTOR_BYTES => small,
                    MIDDLE_SECTOR_BYTES => middle,
                    _ => large,
                };
                let t = ms_to_ticks(typical) * if self.world.slow_flash { 2 } else { 1 };
                // RM0090 3.6.4: what a cache holds of an erased sector stays until the cache is reset.
                self.flash.stale |= self.flash.acr >> ACR_CACHES_SHIFT & ACR_DATA_CACHE;
                self.record_finding(
                    Severity::Fact,
                    format!(
                        "flash: sector {n} erased, the processor stands still for {:.0} ms",
                        t as f64 / ms_to_ticks(1) as f64
                    ),
                );
                self.set_flash_busy(t);
            }
            CR_MER => self.report_violation("flash: mass erase".into()),
            _ => self.report_violation(format!("flash: STRT with CR {cr:#x}")),
        }
    }

    /// RM0090 3.7.4: nWRP of its sector is 0.
    fn is_write_protected(&self, at: u32) -> bool {
        let is_in = |n: &u32| {
            (sector_start_and_length(*n).0
                ..sector_start_and_length(*n).0 + sector_start_and_length(*n).1)
                .contains(&at)
        };
        (0..12).find(is_in).is_some_and(|n| self.flash.optcr >> (OPTCR_NWRP_SHIFT + n) & 1 == 0)
    }

    /// A write of the processor into the array.
    pub fn program_flash(&mut self, at: u32, bytes: &[u8]) {
        let cr = self.flash.cr;
        if cr >> CR_LOCK_BIT != 0 || cr & CR_PG == 0 {
            self.flash.sr |= SR_PGSERR;
            return self.report_violation(format!(
                "flash: write at {at:#x} without {}",
                if cr >> CR_LOCK_BIT != 0 { "unlocking" } else { "PG" }
            ));
        }
        if self.flash.sr & SR_PROGRAM_ERROR_MASK != 0 {
            return self.report_violation(format!(
                "flash: write at {at:#x} with error flags set ({:#x})",
                self.flash.sr
            ));
        }
        if self.is_write_protected(at) {
            self.flash.sr |= SR_WRPERR;
            return self.record_finding(
                Severity::Fact,
                format!("flash: write at {at:#x}, which is protected"),
            );
        }
        if bytes.len() != 1 << (cr >> CR_PSIZE_SHIFT & CR_PSIZE_MASK) {
            self.flash.sr |= SR_PGPERR;
            return self.report_violation(format!(
                "flash: {} bytes written at {at:#x} with PSIZE {}",
                bytes.len(),
                cr >> CR_PSIZE_SHIFT & CR_PSIZE_MASK
            ));
        }
        if !(at as usize).is_multiple_of(bytes.len()) {
            self.flash.sr |= SR_PGAERR;
            return self.report_violation(format!("flash: unaligned write at {at:#x}"));
        }
        let mut old = [0; 8];
        self.rom.read_at(u64::from(at), &mut old[..bytes.len()]).expect("in the flash");
        self.flash.before = (at, old[..bytes.len()].to_vec());
        let mut new = [0; 8];
        for i in 0..bytes.len() {
            new[i] = old[i] & bytes[i];
            if new[i] != bytes[i] {
                self.report_violation(format!(
                    "flash: write at {at:#x} wants to turn a 0 into a 1"
                ));
            } else if old[i] != ERASED_BYTE && old[i] != bytes[i] {
                self.record_finding(
                    Severity::Remark,
                    format!(
                        "flash: a byte at {at:#x} programmed twice, {:#x} over {:#x}",
                        bytes[i], old[i]
                    ),
                );
            }
        }
        self.rom.write_at(u64::from(at), &new[..bytes.len()]).expect("in the flash");
        self.flash.stats.words += 1;
        // DS8626, flash memory programming, a word: 16 µs typical, 100 at most.
        self.set_flash_busy(us_to_ticks(if self.world.slow_flash { 100 } else { 16 }));
        self.handle_flash_word_write();
    }

    /// A write to the array that nothing was set up for: RM0090 3.9.5, PGSERR. The firmware did not ask for
    /// it, so it is no violation of its own.
    pub(crate) fn report_stray_flash_write(&mut self) {
        self.flash.sr |= SR_PGSERR;
        self.record_finding(
            Severity::Fact,
            "flash: a stray write from outside leaves PGSERR".into(),
        );
    }

    /// The supply goes: of a word in flight some bits are written, of a sector some words are erased.
    pub(crate) fn abort_flash_operation(&mut self, seed: u64) {
        if self.flash.busy_until > self.now && !self.flash.before.1.is_empty() {
            let (at, old) = std::mem::take(&mut self.flash.before);
            let mut new = vec![0; old.len()];
            self.rom.read_at(u64::from(at), &mut new).expect("in the flash");
            for (i, (n, o)) in new.iter_mut().zip(&old).enumerate() {
                let r = seed.wrapping_add(i as u64 / 4).wrapping_mul(GOLDEN_RATIO_MULTIPLIER)
                    >> (8 + 8 * (i % 4));
                *n = (*n & r as u8) | (*o & !(r as u8));
            }
            self.rom.write_at(u64::from(at), &new).expect("in the flash");
        }
        self.shared.stall.store(0, Ordering::Relaxed);
    }

    pub(crate) fn complete_flash_operation(&mut self) {
        self.flash.done_at = NEVER;
        if self.flash.cr & CR_EOPIE != 0 {
            self.flash.sr |= SR_EOP;
        }
    }
}
