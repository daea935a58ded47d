//! The flash controller and its array: one bank, sectors of 16, 64 and 128 KB.

use super::Chip;
use crate::{
    report::Grade,
    time::{NEVER, TPS, ms, us},
};
use std::sync::atomic::Ordering;

#[derive(Clone, Copy, Default)]
pub struct Stats {
    pub words: u64,
    pub options: u32,
    pub erases: [u32; 12],
    pub longest_stall: u64,
}

pub struct Flash {
    pub acr: u32,
    pub(crate) sr: u32,
    pub(crate) cr: u32,
    pub optcr: u32,
    pub(crate) key: u32,
    pub(crate) optkey: u32,
    pub(crate) dead: bool,
    pub busy_until: u64,
    pub done_at: u64,
    /// 2: the data cache was on during an erase and has not been reset since.
    pub stale: u32,
    pub stats: Stats,
    /// The address of the operation in flight, and the bytes there before it.
    pub(crate) before: (u32, Vec<u8>),
}

impl Default for Flash {
    fn default() -> Flash {
        Flash::reset(Stats::default())
    }
}

/// (start, length) of a sector.
pub fn sector(n: u32) -> (u32, u32) {
    match n {
        0..=3 => (n * 0x4000, 0x4000),
        4 => (0x1_0000, 0x1_0000),
        _ => ((n - 4) * 0x2_0000, 0x2_0000),
    }
}

impl Flash {
    pub(crate) fn reset(stats: Stats) -> Flash {
        Flash {
            acr: 0,
            sr: 0,
            cr: 1 << 31,
            optcr: 0x0fff_aaed,
            key: 0,
            optkey: 0,
            dead: false,
            busy_until: 0,
            done_at: NEVER,
            stale: 0,
            stats,
            before: (0, Vec::new()),
        }
    }
    pub(crate) fn unlock(&mut self) {
        self.cr &= !(1 << 31);
    }

    pub(crate) fn programming(&self) -> bool {
        self.cr & 1 != 0 && self.cr >> 31 == 0
    }
    pub(crate) fn line(&self) -> bool {
        (self.sr & 1 != 0 && self.cr & 1 << 24 != 0) || (self.sr & 2 != 0 && self.cr & 1 << 25 != 0)
    }
}

impl Chip {
    pub(crate) fn flash_check(&mut self) {
        let hz = TPS / self.hclk;
        let need = (hz.div_ceil(30_000_000) - 1) as u32;
        if self.flash.acr & 7 < need {
            self.violation(format!(
                "flash: {} wait states at HCLK {hz} Hz, which needs {need} at 2.7 to 3.6 V",
                self.flash.acr & 7
            ));
        }
    }

    /// Passes the setting of the flash to the accelerator; `written` may empty its cache.
    pub(crate) fn tell_acr(&self, written: u32) {
        let acr = u64::from(self.flash.acr & 0x707 | written & 0x800);
        let writes = self.shared.acr.load(Ordering::Relaxed) >> 32;
        self.shared.acr.store((writes + 1) << 32 | acr, Ordering::Relaxed);
    }

    pub(crate) fn flash_read(&mut self, off: u32) -> u32 {
        match off {
            0 => self.flash.acr,
            0x0c => self.flash.sr | u32::from(self.flash.busy_until > self.now) << 16,
            0x10 => self.flash.cr,
            0x14 => self.flash.optcr,
            4 | 8 => {
                self.violation("FLASH: a key register read".into());
                0
            }
            _ => 0,
        }
    }

    pub(crate) fn flash_write(&mut self, off: u32, v: u32) {
        match off {
            0 => {
                // RM0090 3.9.1: ICRST and DCRST only while their own cache is off.
                if (v & 0x1000 != 0 && self.flash.acr & 0x400 != 0)
                    || (v & 0x800 != 0 && self.flash.acr & 0x200 != 0)
                {
                    self.violation("FLASH_ACR: a cache reset while it is on".into());
                }
                if v & 0x1000 != 0 && self.flash.acr & 0x400 == 0 {
                    self.flash.stale &= !2;
                }
                self.flash.acr = self.set("FLASH_ACR", self.flash.acr, v, 0x1f07);
                self.tell_acr(v);
                let on = self.flash.acr >> 9 & 3;
                self.say(
                    Grade::Fact,
                    format!(
                        "flash: wait states {}, prefetch {}, instruction cache {}, data cache {}",
                        self.flash.acr & 7,
                        self.flash.acr >> 8 & 1,
                        on & 1,
                        on >> 1
                    ),
                );
                if self.flash.stale & on != 0 && v & 0x1000 == 0 {
                    self.say(
                        Grade::Remark,
                        "flash: the data cache is on after an erase without having been reset"
                            .into(),
                    );
                }
                self.flash_check();
            }
            4 => {
                if self.flash.dead || self.flash.cr >> 31 == 0 {
                    self.violation("FLASH_KEYR written while unlocked or dead".into());
                } else if self.flash.key == 0 && v == 0x4567_0123 {
                    self.flash.key = 1;
                } else if self.flash.key == 1 && v == 0xcdef_89ab {
                    self.flash.key = 0;
                    self.flash.cr &= !(1 << 31);
                } else {
                    self.flash.dead = true;
                    self.violation(format!(
                        "FLASH_KEYR: {v:#x} is the wrong key; locked until the next reset"
                    ));
                }
            }
            8 => {
                if self.flash.optkey == 0 && v == 0x0819_2a3b {
                    self.flash.optkey = 1;
                } else if self.flash.optkey == 1 && v == 0x4c5d_6e7f {
                    self.flash.optkey = 0;
                    self.flash.optcr &= !1;
                } else {
                    self.flash.optkey = 2;
                    self.violation(format!(
                        "FLASH_OPTKEYR: {v:#x} is the wrong key; locked until the next reset"
                    ));
                }
            }
            0x14 => {
                if self.flash.optcr & 1 != 0 {
                    return self
                        .violation(format!("FLASH_OPTCR: {v:#x} written while it is locked"));
                }
                if self.flash.busy_until > self.now {
                    return self.violation("FLASH_OPTCR written while busy".into());
                }
                self.flash.optcr = self.set("FLASH_OPTCR", self.flash.optcr, v, 0x0fff_ffef) & !2;
                if v & 2 != 0 {
                    let o = self.flash.optcr;
                    self.say(Grade::Fact, format!("option bytes programmed: brown-out level {}, watchdog by {}, read protection {:#04x}, write protection {:#05x}",
                        3 - (o >> 2 & 3), if o & 0x20 != 0 { "software" } else { "hardware" }, o >> 8 & 0xff, !o >> 16 & 0xfff));
                    self.flash.stats.options += 1;
                    // Not in DS8626; an erase of a small sector is the nearest.
                    self.flash_busy(ms(250));
                }
            }
            0x0c => self.flash.sr &= !(v & 0xf3),
            0x10 => {
                if self.flash.busy_until > self.now {
                    self.violation("FLASH_CR written while busy: the bus stands still".into());
                }
                if self.flash.cr >> 31 != 0 {
                    self.violation("FLASH_CR written while it is locked".into());
                    return;
                }
                self.flash.cr = self.set("FLASH_CR", self.flash.cr, v, 0x8301_037f);
                self.shared.flag.fetch_or(4, Ordering::Relaxed);
                if v & 1 << 16 != 0 {
                    self.flash.cr &= !(1 << 16);
                    self.flash_erase();
                }
            }
            _ => self.violation(format!("FLASH: write at {off:#x}")),
        }
    }

    pub(crate) fn flash_busy(&mut self, ticks: u64) {
        self.flash.busy_until = self.now + ticks;
        self.flash.done_at = self.flash.busy_until;
        self.flash.stats.longest_stall = self.flash.stats.longest_stall.max(ticks);
        self.shared.stall.store(self.flash.busy_until, Ordering::Relaxed);
    }

    pub(crate) fn flash_erase(&mut self) {
        let cr = self.flash.cr;
        if self.flash.sr & 0xf2 != 0 {
            return self.violation(format!(
                "flash: erase started with error flags set ({:#x})",
                self.flash.sr
            ));
        }
        let size = (cr >> 8 & 3) as usize;
        match cr & 7 {
            2 => {
                let n = cr >> 3 & 15;
                if n > 11 {
                    return self.violation(format!("flash: sector {n} does not exist"));
                }
                let (at, len) = sector(n);
                if self.is_write_protected(at) {
                    self.flash.sr |= 0x10;
                    return self.say(Grade::Fact, format!("flash: sector {n} is protected"));
                }
                let mut old = vec![0; len as usize];
                self.rom.read_at(u64::from(at), &mut old).expect("in the flash");
                self.flash.before = (at, old);
                self.rom.fill(u64::from(at), u64::from(len), 0xff).expect("in the flash");
                self.flash.stats.erases[n as usize] += 1;
                // DS8626, flash memory programming, typical by width x8, x16, x32: 16, 64 and 128 KB.
                let (small, middle, large) = (
                    [400, 300, 250, 250][size],
                    [1200, 700, 550, 550][size],
                    [2000, 1300, 1000, 1000][size],
                );
                let typical: u64 = match len {
                    0x4000 => small,
                    0x1_0000 => middle,
                    _ => large,
                };
                let t = ms(typical) * if self.world.slow_flash { 2 } else { 1 };
                // RM0090 3.6.4: what a cache holds of an erased sector stays until the cache is reset.
                self.flash.stale |= self.flash.acr >> 9 & 2;
                self.say(
                    Grade::Fact,
                    format!(
                        "flash: sector {n} erased, the processor stands still for {:.0} ms",
                        t as f64 / ms(1) as f64
                    ),
                );
                self.flash_busy(t);
            }
            4 => self.violation("flash: mass erase".into()),
            _ => self.violation(format!("flash: STRT with CR {cr:#x}")),
        }
    }

    /// RM0090 3.7.4: nWRP of its sector is 0.
    fn is_write_protected(&self, at: u32) -> bool {
        let is_in = |n: &u32| (sector(*n).0..sector(*n).0 + sector(*n).1).contains(&at);
        (0..12).find(is_in).is_some_and(|n| self.flash.optcr >> (16 + n) & 1 == 0)
    }

    /// A write of the processor into the array.
    pub fn flash_program(&mut self, at: u32, bytes: &[u8]) {
        let cr = self.flash.cr;
        if cr >> 31 != 0 || cr & 1 == 0 {
            self.flash.sr |= 0x80;
            return self.violation(format!(
                "flash: write at {at:#x} without {}",
                if cr >> 31 != 0 { "unlocking" } else { "PG" }
            ));
        }
        if self.flash.sr & 0xf0 != 0 {
            return self.violation(format!(
                "flash: write at {at:#x} with error flags set ({:#x})",
                self.flash.sr
            ));
        }
        if self.is_write_protected(at) {
            self.flash.sr |= 0x10;
            return self.say(Grade::Fact, format!("flash: write at {at:#x}, which is protected"));
        }
        if bytes.len() != 1 << (cr >> 8 & 3) {
            self.flash.sr |= 0x40;
            return self.violation(format!(
                "flash: {} bytes written at {at:#x} with PSIZE {}",
                bytes.len(),
                cr >> 8 & 3
            ));
        }
        if !(at as usize).is_multiple_of(bytes.len()) {
            self.flash.sr |= 0x20;
            return self.violation(format!("flash: unaligned write at {at:#x}"));
        }
        let mut old = [0; 8];
        self.rom.read_at(u64::from(at), &mut old[..bytes.len()]).expect("in the flash");
        self.flash.before = (at, old[..bytes.len()].to_vec());
        let mut new = [0; 8];
        for i in 0..bytes.len() {
            new[i] = old[i] & bytes[i];
            if new[i] != bytes[i] {
                self.violation(format!("flash: write at {at:#x} wants to turn a 0 into a 1"));
            } else if old[i] != 0xff && old[i] != bytes[i] {
                self.say(
                    Grade::Remark,
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
        self.flash_busy(us(if self.world.slow_flash { 100 } else { 16 }));
        self.script_word();
    }

    /// A write to the array that nothing was set up for: RM0090 3.9.5, PGSERR. The firmware did not ask for
    /// it, so it is no violation of its own.
    pub(crate) fn flash_stray_write(&mut self) {
        self.flash.sr |= 0x80;
        self.say(Grade::Fact, "flash: a stray write from outside leaves PGSERR".into());
    }

    /// The supply goes: of a word in flight some bits are written, of a sector some words are erased.
    pub(crate) fn cut(&mut self, seed: u64) {
        if self.flash.busy_until > self.now && !self.flash.before.1.is_empty() {
            let (at, old) = std::mem::take(&mut self.flash.before);
            let mut new = vec![0; old.len()];
            self.rom.read_at(u64::from(at), &mut new).expect("in the flash");
            for (i, (n, o)) in new.iter_mut().zip(&old).enumerate() {
                let r = seed.wrapping_add(i as u64 / 4).wrapping_mul(0x9e37_79b9_7f4a_7c15)
                    >> (8 + 8 * (i % 4));
                *n = (*n & r as u8) | (*o & !(r as u8));
            }
            self.rom.write_at(u64::from(at), &new).expect("in the flash");
        }
        self.shared.stall.store(0, Ordering::Relaxed);
    }

    pub(crate) fn flash_done(&mut self) {
        self.flash.done_at = NEVER;
        if self.flash.cr & 1 << 24 != 0 {
            self.flash.sr |= 1;
        }
    }
}
