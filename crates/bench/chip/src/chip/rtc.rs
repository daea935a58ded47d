//! The real-time clock (RM0090 section 26): prescalers, calendar, shadow registers, initialisation, write protection and
//! the backup registers. No alarms, wake-up, time stamps, tampers, calibration or shifts.

mod registers;

use super::Chip;
use crate::report::Severity;
use registers::*;

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
    key: WriteProtectionState,
    backup: [u32; 20],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum WriteProtectionState {
    Locked,
    FirstKeyWritten,
    Unlocked,
}

impl Default for Rtc {
    fn default() -> Rtc {
        Rtc {
            time: 0,
            date: DR_RESET,
            counted: 0,
            since: 0,
            prescalers: PRER_RESET,
            control: 0,
            init: false,
            init_at: 0,
            shadow_at: 0,
            starts_at: 0,
            locked_time: None,
            locked_date: None,
            key: WriteProtectionState::Locked,
            backup: [0; 20],
        }
    }
}

/// A digit in BCD.
const BCD_DIGIT_MASK: u32 = 0xf;

/// Returns a number in BCD, of this many bits of tens.
fn decode_bcd(bcd: u32) -> u32 {
    (bcd >> 4) * 10 + (bcd & BCD_DIGIT_MASK)
}

fn encode_bcd(number: u32) -> u32 {
    ((number / 10) << 4) | (number % 10)
}

fn days_in_month(month: u32, year: u32) -> u32 {
    match month {
        2 if year.is_multiple_of(4) => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}

impl Rtc {
    /// 26.3.7: what a reset of the system leaves, and what it does not.
    pub(crate) fn apply_system_reset(&mut self, now: u64) {
        self.init = false;
        (self.locked_time, self.locked_date) = (None, None);
        self.shadow_at = now;
    }

    /// Ticks of RTCCLK in a second of the calendar (26.3.1).
    fn cycles_per_second(&self) -> u64 {
        (u64::from(self.prescalers >> PRER_PREDIV_A_SHIFT & PRER_PREDIV_A_MASK) + 1)
            * (u64::from(self.prescalers & PRER_PREDIV_S_MASK) + 1)
    }

    /// Time and date, this many seconds after they stood.
    fn calendar_after(&self, seconds: u64) -> (u32, u32) {
        let of_day = decode_bcd(self.time >> TR_HOURS_SHIFT & TR_HOURS_MASK) * 3600
            + decode_bcd(self.time >> TR_MINUTES_SHIFT & TR_MINUTES_MASK) * 60
            + decode_bcd(self.time & TR_SECONDS_MASK);
        let seconds = seconds + u64::from(of_day);
        let (mut days, in_day) = (seconds / 86_400, (seconds % 86_400) as u32);
        let week_day = (u64::from(self.date >> DR_WDU_SHIFT & DR_WDU_MASK) + 6 + days) % 7 + 1;
        let mut day = decode_bcd(self.date & DR_DAY_MASK);
        let mut month = decode_bcd(self.date >> DR_MONTH_SHIFT & DR_MONTH_MASK);
        let mut year = decode_bcd(self.date >> DR_YEAR_SHIFT & DR_YEAR_MASK);
        while days > 0 {
            days -= 1;
            day += 1;
            if day > days_in_month(month, year) {
                (day, month) = (1, month + 1);
            }
            if month > 12 {
                (month, year) = (1, (year + 1) % 100);
            }
        }
        let time = encode_bcd(in_day / 3600) << TR_HOURS_SHIFT
            | encode_bcd(in_day / 60 % 60) << TR_MINUTES_SHIFT
            | encode_bcd(in_day % 60);
        (
            time,
            encode_bcd(year) << DR_YEAR_SHIFT
                | (week_day as u32) << DR_WDU_SHIFT
                | encode_bcd(month) << DR_MONTH_SHIFT
                | encode_bcd(day),
        )
    }
}

impl Chip {
    /// The calendar is set from outside.
    pub(crate) fn overwrite_rtc_calendar(&mut self, time: u32, date: u32) {
        self.update_rtc_calendar();
        (self.backup.rtc.time, self.backup.rtc.date, self.backup.rtc.counted) = (time, date, 0);
    }

    /// Counts what has passed until now.
    pub(crate) fn update_rtc_calendar(&mut self) {
        let now = self.now;
        let runs = self.rtcclk_period_ticks().is_some() && !self.backup.rtc.init;
        let rtc = &mut self.backup.rtc;
        let from = rtc.since.max(rtc.starts_at);
        if runs {
            rtc.counted += now.saturating_sub(from);
        }
        rtc.since = now;
    }

    /// Lets time pass that the chip does not live through.
    pub(crate) fn advance_rtc(&mut self, ticks: u64) {
        if !self.backup.rtc.init {
            self.backup.rtc.counted += ticks;
        }
    }

    /// Seconds of the calendar since it stood, and cycles of RTCCLK into the next.
    fn elapsed_rtc_time(&mut self) -> (u64, u64) {
        self.update_rtc_calendar();
        let division = self.backup.rtc.cycles_per_second();
        // A clock that stands still has counted, by the crystal's rate: no other has VBAT.
        let cycle = self
            .rtcclk_period_ticks()
            .unwrap_or(crate::simulation_time::TICKS_PER_SECOND / self.world.lse_hz);
        let cycles = self.backup.rtc.counted / cycle;
        (cycles / division, cycles % division)
    }

    /// A flag that comes this many cycles of RTCCLK after `at`; without a clock it never does.
    fn has_rtcclk_delay_elapsed(&self, at: u64, cycles: u64) -> bool {
        self.rtcclk_period_ticks()
            .is_some_and(|cycle| self.now >= at.saturating_add(cycles * cycle))
    }

    pub(crate) fn read_rtc_register(&mut self, off: u32) -> u32 {
        let (seconds, cycles) = self.elapsed_rtc_time();
        let (time, date) = self.backup.rtc.calendar_after(seconds);
        // 26.3.2: two cycles until the shadows are the calendar's.
        let is_in_step =
            self.has_rtcclk_delay_elapsed(self.backup.rtc.shadow_at, 2) && !self.backup.rtc.init;
        let rtc = &mut self.backup.rtc;
        let shadows = rtc.control & CR_BYPSHAD == 0;
        match off {
            TR_OFFSET | DR_OFFSET | SSR_OFFSET if shadows && !is_in_step => {
                self.record_finding(
                    Severity::Remark,
                    format!("RTC: {off:#x} read before RSF (26.3.6)"),
                );
                if off == DR_OFFSET { DR_RESET } else { 0 }
            }
            TR_OFFSET => {
                if shadows {
                    rtc.locked_date.get_or_insert(date);
                }
                rtc.locked_time.unwrap_or(time)
            }
            DR_OFFSET => {
                rtc.locked_time = None;
                rtc.locked_date.take().unwrap_or(date)
            }
            CR_OFFSET => rtc.control,
            ISR_OFFSET => {
                let init = rtc.init;
                let inits =
                    u32::from(rtc.date >> DR_YEAR_SHIFT & DR_YEAR_MASK != 0) << ISR_INITS_SHIFT;
                let at = rtc.init_at;
                let in_init = init && self.has_rtcclk_delay_elapsed(at, 2);
                let flag = |on: bool, bit: u32| if on { bit } else { 0 };
                ISR_WRITE_FLAGS
                    | inits
                    | flag(init, ISR_INIT)
                    | flag(in_init, ISR_INITF)
                    | flag(is_in_step, ISR_RSF)
            }
            PRER_OFFSET => rtc.prescalers,
            // 26.6.11: counts down, (PREDIV_S − SS)/(PREDIV_S + 1) of a second are over.
            SSR_OFFSET => {
                let slow =
                    u64::from(rtc.prescalers >> PRER_PREDIV_A_SHIFT & PRER_PREDIV_A_MASK) + 1;
                let predivider = u64::from(rtc.prescalers & PRER_PREDIV_S_MASK);
                if shadows {
                    rtc.locked_time.get_or_insert(time);
                    rtc.locked_date.get_or_insert(date);
                }
                (predivider - cycles / slow) as u32
            }
            BKP0R_OFFSET..=BKP19R_OFFSET => rtc.backup[(off as usize - BKP0R_OFFSET as usize) / 4],
            _ => {
                self.record_finding(Severity::Unmodelled, format!("RTC: read at {off:#x}"));
                0
            }
        }
    }

    pub(crate) fn write_rtc_register(&mut self, off: u32, v: u32) {
        if !self.check_backup_writable("RTC") {
            return;
        }
        self.update_rtc_calendar();
        let now = self.now;
        // 26.3.5: of ISR only bits 13:8 are not behind the keys, and they are not modelled; nor are the backup registers.
        let is_open = self.backup.rtc.key == WriteProtectionState::Unlocked;
        if !is_open && !matches!(off, ISR_OFFSET | WPR_OFFSET | BKP0R_OFFSET..=BKP19R_OFFSET) {
            return self.report_violation(format!(
                "RTC: {off:#x} written while the keys are not (26.3.5)"
            ));
        }
        let in_init =
            self.backup.rtc.init && self.has_rtcclk_delay_elapsed(self.backup.rtc.init_at, 2);
        if matches!(off, TR_OFFSET | DR_OFFSET | PRER_OFFSET) && !in_init {
            return self.report_violation(format!(
                "RTC: {off:#x} written outside initialisation (26.3.5)"
            ));
        }
        let (seconds, _) = self.elapsed_rtc_time();
        let rtc = &mut self.backup.rtc;
        match off {
            TR_OFFSET => (rtc.time, rtc.counted) = (v & TR_MASK, 0),
            DR_OFFSET => rtc.date = v & DR_MASK,
            CR_OFFSET => {
                rtc.control = v & CR_BYPSHAD;
                if v & !CR_BYPSHAD != 0 {
                    self.record_finding(Severity::Unmodelled, format!("RTC_CR: {v:#x}"));
                }
            }
            ISR_OFFSET => {
                if is_open && v & ISR_RSF == 0 {
                    rtc.shadow_at = now;
                }
                if is_open && v & ISR_INIT != 0 && !rtc.init {
                    // The counters stand as they are, and their prescaler begins anew.
                    (rtc.time, rtc.date) = rtc.calendar_after(seconds);
                    (rtc.init, rtc.init_at, rtc.counted) = (true, now, 0);
                }
                if is_open && v & ISR_INIT == 0 && rtc.init {
                    rtc.init = false;
                    (rtc.since, rtc.shadow_at) = (now, now);
                    let cycle = self.rtcclk_period_ticks().unwrap_or(0);
                    // 26.3.5: counting goes on after four cycles.
                    self.backup.rtc.starts_at = now + 4 * cycle;
                }
            }
            PRER_OFFSET => rtc.prescalers = v & PRER_MASK,
            WPR_OFFSET => {
                rtc.key = match (rtc.key, v & WPR_KEY_MASK) {
                    (WriteProtectionState::Locked, WPR_KEY1) => {
                        WriteProtectionState::FirstKeyWritten
                    }
                    (WriteProtectionState::FirstKeyWritten, WPR_KEY2) => {
                        WriteProtectionState::Unlocked
                    }
                    (WriteProtectionState::Unlocked, WPR_KEY1) => {
                        WriteProtectionState::FirstKeyWritten
                    }
                    _ => WriteProtectionState::Locked,
                }
            }
            BKP0R_OFFSET..=BKP19R_OFFSET => {
                rtc.backup[(off as usize - BKP0R_OFFSET as usize) / 4] = v
            }
            _ => self.record_finding(Severity::Unmodelled, format!("RTC: write at {off:#x}")),
        }
    }
}
