//! The real-time clock (RM0090 section 26): prescalers, calendar, shadow registers, initialisation, write protection and
//! the backup registers. No alarms, wake-up, time stamps, tampers, calibration or shifts.

use super::Chip;
use crate::report::Grade;

/// 26.6: values after a reset of the backup domain.
const DATE: u32 = 0x2101;
const PRESCALERS: u32 = 0x007f_00ff;

const INIT: u32 = 1 << 7;
const INITF: u32 = 1 << 6;
const RSF: u32 = 1 << 5;
const BYPSHAD: u32 = 1 << 5;

/// Registers and counters of the clock.
#[derive(Debug)]
pub struct Rtc {
    /// Time and date when the counters last stood, in BCD as written.
    time: u32,
    date: u32,
    /// Ticks counted since then, and up to when they were.
    counted: u64,
    since: u64,
    prescalers: u32,
    control: u32,
    init: bool,
    /// RTCCLK's edges that INITF, the shadows and the count wait for: when each comes.
    init_at: u64,
    shadow_at: u64,
    starts_at: u64,
    /// Shadow values that a read has locked until the date is read (26.3.6): the time by SSR, the date by SSR or TR.
    locked_time: Option<u32>,
    locked_date: Option<u32>,
    key: Key,
    backup: [u32; 20],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Key {
    Closed,
    Half,
    Open,
}

impl Default for Rtc {
    fn default() -> Rtc {
        Rtc {
            time: 0,
            date: DATE,
            counted: 0,
            since: 0,
            prescalers: PRESCALERS,
            control: 0,
            init: false,
            init_at: 0,
            shadow_at: 0,
            starts_at: 0,
            locked_time: None,
            locked_date: None,
            key: Key::Closed,
            backup: [0; 20],
        }
    }
}

/// Returns a number in BCD, of this many bits of tens.
fn of_bcd(bcd: u32) -> u32 {
    (bcd >> 4) * 10 + (bcd & 15)
}

fn to_bcd(number: u32) -> u32 {
    ((number / 10) << 4) | (number % 10)
}

fn days_of(month: u32, year: u32) -> u32 {
    match month {
        2 if year.is_multiple_of(4) => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}

impl Rtc {
    /// 26.3.7: what a reset of the system leaves, and what it does not.
    pub(crate) fn system_reset(&mut self, now: u64) {
        self.init = false;
        (self.locked_time, self.locked_date) = (None, None);
        self.shadow_at = now;
    }

    /// Ticks of RTCCLK in a second of the calendar (26.3.1).
    fn division(&self) -> u64 {
        (u64::from(self.prescalers >> 16 & 0x7f) + 1) * (u64::from(self.prescalers & 0x7fff) + 1)
    }

    /// Time and date, this many seconds after they stood.
    fn calendar(&self, seconds: u64) -> (u32, u32) {
        let of_day = of_bcd(self.time >> 16 & 0x3f) * 3600
            + of_bcd(self.time >> 8 & 0x7f) * 60
            + of_bcd(self.time & 0x7f);
        let seconds = seconds + u64::from(of_day);
        let (mut days, in_day) = (seconds / 86_400, (seconds % 86_400) as u32);
        let week_day = (u64::from(self.date >> 13 & 7) + 6 + days) % 7 + 1;
        let mut day = of_bcd(self.date & 0x3f);
        let mut month = of_bcd(self.date >> 8 & 0x1f);
        let mut year = of_bcd(self.date >> 16 & 0xff);
        while days > 0 {
            days -= 1;
            day += 1;
            if day > days_of(month, year) {
                (day, month) = (1, month + 1);
            }
            if month > 12 {
                (month, year) = (1, (year + 1) % 100);
            }
        }
        let time =
            to_bcd(in_day / 3600) << 16 | to_bcd(in_day / 60 % 60) << 8 | to_bcd(in_day % 60);
        (time, to_bcd(year) << 16 | (week_day as u32) << 13 | to_bcd(month) << 8 | to_bcd(day))
    }
}

impl Chip {
    /// The calendar is set from outside.
    pub(crate) fn rtc_upset(&mut self, time: u32, date: u32) {
        self.rtc_settle();
        (self.backup.rtc.time, self.backup.rtc.date, self.backup.rtc.counted) = (time, date, 0);
    }

    /// Counts what has passed until now.
    pub(crate) fn rtc_settle(&mut self) {
        let now = self.now;
        let runs = self.rtc_cycle().is_some() && !self.backup.rtc.init;
        let rtc = &mut self.backup.rtc;
        let from = rtc.since.max(rtc.starts_at);
        if runs {
            rtc.counted += now.saturating_sub(from);
        }
        rtc.since = now;
    }

    /// Lets time pass that the chip does not live through.
    pub(crate) fn rtc_pass(&mut self, ticks: u64) {
        if !self.backup.rtc.init {
            self.backup.rtc.counted += ticks;
        }
    }

    /// Seconds of the calendar since it stood, and cycles of RTCCLK into the next.
    fn rtc_count(&mut self) -> (u64, u64) {
        self.rtc_settle();
        let division = self.backup.rtc.division();
        // A clock that stands still has counted, by the crystal's rate: no other has VBAT.
        let cycle = self.rtc_cycle().unwrap_or(crate::time::TPS / self.world.lse_hz);
        let cycles = self.backup.rtc.counted / cycle;
        (cycles / division, cycles % division)
    }

    /// A flag that comes this many cycles of RTCCLK after `at`; without a clock it never does.
    fn after_cycles(&self, at: u64, cycles: u64) -> bool {
        self.rtc_cycle().is_some_and(|cycle| self.now >= at.saturating_add(cycles * cycle))
    }

    pub(crate) fn rtc_read(&mut self, off: u32) -> u32 {
        let (seconds, cycles) = self.rtc_count();
        let (time, date) = self.backup.rtc.calendar(seconds);
        // 26.3.2: two cycles until the shadows are the calendar's.
        let is_in_step = self.after_cycles(self.backup.rtc.shadow_at, 2) && !self.backup.rtc.init;
        let rtc = &mut self.backup.rtc;
        let shadows = rtc.control & BYPSHAD == 0;
        match off {
            0x00 | 0x04 | 0x28 if shadows && !is_in_step => {
                self.say(Grade::Remark, format!("RTC: {off:#x} read before RSF (26.3.6)"));
                if off == 0x04 { DATE } else { 0 }
            }
            0x00 => {
                if shadows {
                    rtc.locked_date.get_or_insert(date);
                }
                rtc.locked_time.unwrap_or(time)
            }
            0x04 => {
                rtc.locked_time = None;
                rtc.locked_date.take().unwrap_or(date)
            }
            0x08 => rtc.control,
            0x0c => {
                let init = rtc.init;
                let inits = u32::from(rtc.date >> 16 & 0xff != 0) << 4;
                let at = rtc.init_at;
                let in_init = init && self.after_cycles(at, 2);
                let flag = |on: bool, bit: u32| if on { bit } else { 0 };
                7 | inits | flag(init, INIT) | flag(in_init, INITF) | flag(is_in_step, RSF)
            }
            0x10 => rtc.prescalers,
            // 26.6.11: counts down, (PREDIV_S − SS)/(PREDIV_S + 1) of a second are over.
            0x28 => {
                let slow = u64::from(rtc.prescalers >> 16 & 0x7f) + 1;
                let predivider = u64::from(rtc.prescalers & 0x7fff);
                if shadows {
                    rtc.locked_time.get_or_insert(time);
                    rtc.locked_date.get_or_insert(date);
                }
                (predivider - cycles / slow) as u32
            }
            0x50..=0x9c => rtc.backup[(off as usize - 0x50) / 4],
            _ => {
                self.say(Grade::Unmodelled, format!("RTC: read at {off:#x}"));
                0
            }
        }
    }

    pub(crate) fn rtc_write(&mut self, off: u32, v: u32) {
        if !self.reaches_backup("RTC") {
            return;
        }
        self.rtc_settle();
        let now = self.now;
        // 26.3.5: of ISR only bits 13:8 are not behind the keys, and they are not modelled; nor are the backup registers.
        let is_open = self.backup.rtc.key == Key::Open;
        if !is_open && !matches!(off, 0x0c | 0x24 | 0x50..=0x9c) {
            return self
                .violation(format!("RTC: {off:#x} written while the keys are not (26.3.5)"));
        }
        let in_init = self.backup.rtc.init && self.after_cycles(self.backup.rtc.init_at, 2);
        if matches!(off, 0x00 | 0x04 | 0x10) && !in_init {
            return self
                .violation(format!("RTC: {off:#x} written outside initialisation (26.3.5)"));
        }
        let (seconds, _) = self.rtc_count();
        let rtc = &mut self.backup.rtc;
        match off {
            0x00 => (rtc.time, rtc.counted) = (v & 0x007f_7f7f, 0),
            0x04 => rtc.date = v & 0x00ff_ff3f,
            0x08 => {
                rtc.control = v & BYPSHAD;
                if v & !BYPSHAD != 0 {
                    self.say(Grade::Unmodelled, format!("RTC_CR: {v:#x}"));
                }
            }
            0x0c => {
                if is_open && v & RSF == 0 {
                    rtc.shadow_at = now;
                }
                if is_open && v & INIT != 0 && !rtc.init {
                    // The counters stand as they are, and their prescaler begins anew.
                    (rtc.time, rtc.date) = rtc.calendar(seconds);
                    (rtc.init, rtc.init_at, rtc.counted) = (true, now, 0);
                }
                if is_open && v & INIT == 0 && rtc.init {
                    rtc.init = false;
                    (rtc.since, rtc.shadow_at) = (now, now);
                    let cycle = self.rtc_cycle().unwrap_or(0);
                    // 26.3.5: counting goes on after four cycles.
                    self.backup.rtc.starts_at = now + 4 * cycle;
                }
            }
            0x10 => rtc.prescalers = v & 0x007f_7fff,
            0x24 => {
                rtc.key = match (rtc.key, v & 0xff) {
                    (Key::Closed, 0xca) => Key::Half,
                    (Key::Half, 0x53) => Key::Open,
                    (Key::Open, 0xca) => Key::Half,
                    _ => Key::Closed,
                }
            }
            0x50..=0x9c => rtc.backup[(off as usize - 0x50) / 4] = v,
            _ => self.say(Grade::Unmodelled, format!("RTC: write at {off:#x}")),
        }
    }
}
