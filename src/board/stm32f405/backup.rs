//! Memory that outlasts a power cut, where VBAT has a battery: the backup SRAM, and the clock that says how long the
//! cut was (sections 5.1.2, 5.4, 7.1.3, 7.3.20 and 26).
//!
//! | step | when |
//! |---|---|
//! | regulator of the SRAM and crystal of 32.768 kHz on | at every start |
//! | calendar set to 2001, and a mark that it is ours | once the crystal swings (some 2 s), once in a battery's life |
//! | the copies of [`retained`] written, with the clock's time in them | every second |
//! | the copies read, and the clock | at a start after a power cut |
//!
//! Whatever is missing, a battery, the crystal, a clock that runs at once, our mark, a whole copy, a time that can be,
//! the copies count for nothing, and are wiped: what was not believed once must not be believed at the next start.
//! Writes reach all of this only while one of these functions lets them.

use core::ptr;

use stm32f4xx_hal::{
    pac::{PWR, RCC, RTC, rcc::bdcr::RTCSEL},
    rcc::Rcc,
};
use trueup_store::{
    calendar,
    retained_state::{self, RETAINED_COPY_SIZE, RetainedCopies},
};

use super::{poll_until, watchdog::ResetCause};

/// The backup SRAM (section 2.3, table 1), taken in words.
const BACKUP_SRAM: *mut u32 = 0x4002_4000 as *mut u32;
const _: () = assert!(RETAINED_COPY_SIZE.is_multiple_of(4) && 2 * RETAINED_COPY_SIZE <= 4096);
/// In the first backup register: the clock has been set by this firmware, and counts in seconds.
const CLOCK_SET_MAGIC: u32 = u32::from_be_bytes(*b"heat");
/// The two keys that unlock the clock's registers (section 26.3.5), and what is none.
const UNLOCK_KEYS: [u8; 2] = [0xCA, 0x53];
const RTC_LOCK_KEY: u8 = 0xFF;
/// Monday, 2001-01-01.
const RTC_DEFAULT_DATE: u32 = 0x01_2101;
/// The clock stands for being set after two cycles of the crystal, 61 µs (section 26.3.5): this is some ten times that.
const MAX_INIT_POLLS: u32 = 10_000;

/// The SRAM and the clock.
pub struct BackupDomain {
    power: PWR,
    clock: RTC,
    /// This start comes after a power cut.
    was_cut: bool,
}

impl BackupDomain {
    /// Switches both on.
    pub fn start(power: PWR, clock: RTC, reset: ResetCause, rcc: &mut Rcc) -> Self {
        rcc.apb1enr().modify(|_, w| w.pwren().enabled());
        rcc.ahb1enr().modify(|_, w| w.bkpsramen().set_bit());
        // A read of the register lets the clock come up (errata sheet, delay after an RCC clock enabling).
        let _clocked = rcc.ahb1enr().read();
        let backup = Self { power, clock, was_cut: reset == ResetCause::PowerOn };
        backup.with_write_access(|| {
            if !backup.is_clock_set() {
                // What drives the clock can be chosen once after this. The SRAM stays, its regulator goes off
                // (section 7.1.3).
                rcc.bdcr().write(|w| w.bdrst().enabled());
                rcc.bdcr().write(|w| w.bdrst().disabled());
            }
            backup.power.csr().modify(|_, w| w.bre().set_bit());
            rcc.bdcr().modify(|_, w| w.lseon().on());
        });
        backup
    }

    /// After a power cut: fills the copies with what has outlasted it, and gives for how many seconds the power
    /// was gone. If that is not known, the copies are empty. After any other reset they stay as they are.
    pub fn restore(&mut self, copies: &mut RetainedCopies) -> u32 {
        if !self.was_cut {
            return 0;
        }
        copies.fill([0; RETAINED_COPY_SIZE]);
        self.with_write_access(|| {
            for (n, word) in words_mut(copies).enumerate() {
                // SAFETY: an aligned word of the SRAM, whose clock is on; any bits are a value of it.
                #[allow(unsafe_code, reason = "memory of the chip")]
                let value = unsafe { ptr::read_volatile(BACKUP_SRAM.add(n)) };
                *word = value.to_le_bytes();
            }
        });
        let off_s = retained_state::off_time_s(
            copies,
            self.is_clock_set().then(|| self.read_seconds_since_2000()).flatten(),
        );
        match off_s {
            Some(off_s) => defmt::info!("the power was gone for {=u32} s", off_s),
            None => {
                defmt::info!("nothing is known of before the power cut");
                copies.fill([0; RETAINED_COPY_SIZE]);
                self.store(copies);
            }
        }
        off_s.unwrap_or(0)
    }

    /// Returns what the clock says, in seconds; sets it going where that has not been done. `None`: it does not run, or
    /// not yet.
    pub fn now_s(&mut self) -> Option<u32> {
        if !self.is_clock_set() {
            self.with_write_access(|| self.set_clock());
            return None;
        }
        self.read_seconds_since_2000()
    }

    /// Writes the copies where they outlast a power cut.
    pub fn store(&mut self, copies: &mut RetainedCopies) {
        self.with_write_access(|| {
            for (n, word) in words_mut(copies).enumerate() {
                // SAFETY: an aligned word of the SRAM, which no other code uses, and whose clock is on.
                #[allow(unsafe_code, reason = "memory of the chip")]
                unsafe {
                    ptr::write_volatile(BACKUP_SRAM.add(n), u32::from_le_bytes(*word));
                }
            }
        });
    }

    fn is_clock_set(&self) -> bool {
        self.clock.bkpr(0).read().bits() == CLOCK_SET_MAGIC
    }

    /// Time and date, twice the same: the errata sheet has a case where the date is that of the next time. They are
    /// there to be read once the clock has run for two cycles since the reset, 61 µs (section 26.3.6): if it does,
    /// it is long before this.
    fn read_seconds_since_2000(&self) -> Option<u32> {
        if self.clock.isr().read().rsf().bit_is_clear() {
            return None;
        }
        let now = || (self.clock.tr().read().bits(), self.clock.dr().read().bits());
        let mut last = now();
        let is_steady = poll_until(3, || {
            let before = last;
            last = now();
            last == before
        });
        let (time, date) = last;
        is_steady.then(|| calendar::seconds_since_2000(time, date)).flatten()
    }

    /// Lets the crystal drive the clock and sets it, once the crystal swings.
    #[allow(unsafe_code, reason = "registers of the clock")]
    fn set_clock(&self) {
        // SAFETY: after the start no other code touches this register.
        let bdcr = unsafe { &*RCC::ptr() }.bdcr();
        if bdcr.read().lserdy().is_not_ready() {
            return;
        }
        bdcr.modify(|_, w| w.rtcsel().variant(RTCSEL::Lse).rtcen().enabled());
        for key in UNLOCK_KEYS {
            self.clock.wpr().write(|w| w.key().set(key));
        }
        self.clock.isr().modify(|_, w| w.init().set_bit());
        let is_open = poll_until(MAX_INIT_POLLS, || self.clock.isr().read().initf().bit_is_set());
        if is_open {
            // SAFETY: a time and a date in BCD. The prescalers make seconds of this crystal as they are.
            unsafe {
                self.clock.tr().write(|w| w.bits(0));
                self.clock.dr().write(|w| w.bits(RTC_DEFAULT_DATE));
            }
        }
        self.clock.isr().modify(|_, w| w.init().clear_bit());
        self.clock.wpr().write(|w| w.key().set(RTC_LOCK_KEY));
        if is_open {
            self.clock.bkpr(0).write(|w| w.bkp().set(CLOCK_SET_MAGIC));
            defmt::info!("the clock that outlasts a power cut is set");
        }
    }

    /// Does `work`, whose writes get through. Not in an emulator that has none of this, nor the memory.
    fn with_write_access(&self, work: impl FnOnce()) {
        self.power.cr().modify(|_, w| w.dbp().set_bit());
        if self.power.cr().read().dbp().bit_is_set() {
            work();
        }
        // What is on its way arrives before the door is shut.
        cortex_m::asm::dsb();
        self.power.cr().modify(|_, w| w.dbp().clear_bit());
    }
}

/// Returns the copies, a word after the other.
fn words_mut(copies: &mut RetainedCopies) -> impl Iterator<Item = &mut [u8; 4]> {
    copies.as_flattened_mut().as_chunks_mut::<4>().0.iter_mut()
}
