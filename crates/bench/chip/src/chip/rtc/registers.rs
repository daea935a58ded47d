//! Registers of the real-time clock (RM0090 section 26.6).

/// Offset of RTC_TR, the time (26.6.1).
pub(super) const TR_OFFSET: u32 = 0x00;
/// Offset of RTC_DR, the date (26.6.2).
pub(super) const DR_OFFSET: u32 = 0x04;
/// Offset of RTC_CR, the control register (26.6.3).
pub(super) const CR_OFFSET: u32 = 0x08;
/// Offset of RTC_ISR, initialisation and status (26.6.4).
pub(super) const ISR_OFFSET: u32 = 0x0c;
/// Offset of RTC_PRER, the prescalers (26.6.5).
pub(super) const PRER_OFFSET: u32 = 0x10;
/// Offset of RTC_WPR, the keys (26.6.10).
pub(super) const WPR_OFFSET: u32 = 0x24;
/// Offset of RTC_SSR, the sub-seconds (26.6.11).
pub(super) const SSR_OFFSET: u32 = 0x28;
/// Offset of RTC_BKP0R, the first backup register (26.6.20).
pub(super) const BKP0R_OFFSET: u32 = 0x50;
/// Offset of RTC_BKP19R, the last backup register (26.6.20).
pub(super) const BKP19R_OFFSET: u32 = 0x9c;

/// The seconds of RTC_TR, in BCD.
pub(super) const TR_SECONDS_MASK: u32 = 0x7f;
/// RTC_TR: position of the minutes.
pub(super) const TR_MINUTES_SHIFT: u32 = 8;
/// The minutes of RTC_TR, in BCD, shifted down.
pub(super) const TR_MINUTES_MASK: u32 = 0x7f;
/// RTC_TR: position of the hours.
pub(super) const TR_HOURS_SHIFT: u32 = 16;
/// The hours of RTC_TR, in BCD, without PM, shifted down.
pub(super) const TR_HOURS_MASK: u32 = 0x3f;
/// The implemented bits of RTC_TR.
pub(super) const TR_MASK: u32 = 0x007f_7f7f;

/// The day of RTC_DR, in BCD.
pub(super) const DR_DAY_MASK: u32 = 0x3f;
/// RTC_DR: position of the month.
pub(super) const DR_MONTH_SHIFT: u32 = 8;
/// The month of RTC_DR, in BCD, shifted down.
pub(super) const DR_MONTH_MASK: u32 = 0x1f;
/// RTC_DR, WDU: position of the day of the week.
pub(super) const DR_WDU_SHIFT: u32 = 13;
/// RTC_DR, WDU: its three bits, shifted down.
pub(super) const DR_WDU_MASK: u32 = 0x7;
/// RTC_DR: position of the year.
pub(super) const DR_YEAR_SHIFT: u32 = 16;
/// The year of RTC_DR, in BCD, shifted down.
pub(super) const DR_YEAR_MASK: u32 = 0xff;
/// The implemented bits of RTC_DR.
pub(super) const DR_MASK: u32 = 0x00ff_ff3f;
/// Value of RTC_DR after a reset of the backup domain: Monday, 1 January of year 0.
pub(super) const DR_RESET: u32 = 0x2101;

/// RTC_CR, BYPSHAD: reads bypass the shadow registers.
pub(super) const CR_BYPSHAD: u32 = 1 << 5;

/// RTC_ISR, INIT: requests initialisation.
pub(super) const ISR_INIT: u32 = 1 << 7;
/// RTC_ISR, INITF: the clock is in initialisation.
pub(super) const ISR_INITF: u32 = 1 << 6;
/// RTC_ISR, RSF: the shadow registers are those of the calendar.
pub(super) const ISR_RSF: u32 = 1 << 5;
/// RTC_ISR, INITS: position of the flag that the year is not 0.
pub(super) const ISR_INITS_SHIFT: u32 = 4;
/// RTC_ISR, ALRAWF, ALRBWF and WUTWF: alarms and wake-up may be written.
pub(super) const ISR_WRITE_FLAGS: u32 = 0x7;

/// RTC_PRER, PREDIV_A: position of the asynchronous prescaler.
pub(super) const PRER_PREDIV_A_SHIFT: u32 = 16;
/// RTC_PRER, PREDIV_A: its seven bits, shifted down.
pub(super) const PRER_PREDIV_A_MASK: u32 = 0x7f;
/// RTC_PRER, PREDIV_S: the synchronous prescaler, 15 bits.
pub(super) const PRER_PREDIV_S_MASK: u32 = 0x7fff;
/// The implemented bits of RTC_PRER.
pub(super) const PRER_MASK: u32 = 0x007f_7fff;
/// Value of RTC_PRER after a reset of the backup domain.
pub(super) const PRER_RESET: u32 = 0x007f_00ff;

/// RTC_WPR, KEY: its eight bits.
pub(super) const WPR_KEY_MASK: u32 = 0xff;
/// RTC_WPR: the first key.
pub(super) const WPR_KEY1: u32 = 0xca;
/// RTC_WPR: the second key.
pub(super) const WPR_KEY2: u32 = 0x53;
