//! Seconds of a calendar in BCD, as the real-time clock of an STM32 counts (RM0090, sections 26.6.1 and 26.6.2).
//!
//! | bits | time | bits | date |
//! |---|---|---|---|
//! | 21:20, 19:16 | hour | 23:20, 19:16 | year, 2000 to 2099 |
//! | 14:12, 11:8 | minute | 12, 11:8 | month |
//! | 6:4, 3:0 | second | 5:4, 3:0 | day |

/// Days before each month of a year without a leap day.
const DAYS_BEFORE_MONTH: [u32; 12] = [0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334];
/// A day, in seconds.
pub const SECONDS_PER_DAY: u32 = 86_400;

/// Seconds from the beginning of 2000 to this time and date. `None`: no clock has such a time.
///
/// ```
/// use trueup_store::calendar::{SECONDS_PER_DAY, seconds_since_2000};
/// // 2001-03-01 00:00:07, a Thursday: a leap year, January and February.
/// assert_eq!(seconds_since_2000(0x00_0007, 0x01_8301), Some((366 + 31 + 28) * SECONDS_PER_DAY + 7));
/// assert_eq!(seconds_since_2000(0x00_000a, 0x01_8301), None);
/// ```
#[must_use]
pub fn seconds_since_2000(time: u32, date: u32) -> Option<u32> {
    // At most two digits: nothing here can wrap.
    let number = |bcd: u32, tens: u32| {
        let (high, low) = (bcd >> 4 & tens, bcd & 15);
        (low < 10 && high < 10).then_some(high.wrapping_mul(10).wrapping_add(low))
    };
    let (hour, minute, second) = (number(time >> 16, 3)?, number(time >> 8, 7)?, number(time, 7)?);
    let (year, month, day) = (number(date >> 16, 15)?, number(date >> 8, 1)?, number(date, 3)?);
    let before = DAYS_BEFORE_MONTH.get(usize::try_from(month.checked_sub(1)?).ok()?)?;
    let day = day.checked_sub(1)?;
    if hour > 23 || minute > 59 || second > 59 || day > 30 {
        return None;
    }
    // 2000 was a leap year.
    let leap_days = year.div_ceil(4).wrapping_add((year.is_multiple_of(4) && month > 2).into());
    let days = [year.wrapping_mul(365), leap_days, *before, day].into_iter().sum::<u32>();
    let minutes = hour.wrapping_mul(60).wrapping_add(minute);
    // A century has 3.2 of 4.3 billion seconds.
    Some(
        days.wrapping_mul(SECONDS_PER_DAY)
            .wrapping_add(minutes.wrapping_mul(60))
            .wrapping_add(second),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bcd(number: u32) -> u32 {
        ((number / 10) << 4) | (number % 10)
    }

    #[test]
    fn every_day_of_the_century_is_a_day_after_the_one_before() {
        let mut expected = 0;
        for year in 0..100 {
            let february = if year % 4 == 0 { 29 } else { 28 };
            let lengths = [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
            for (month, length) in (1..).zip(lengths) {
                for day in 1..=length {
                    // The day of the week, bits 15:13, does not count.
                    let date = bcd(year) << 16 | (day % 7 + 1) << 13 | bcd(month) << 8 | bcd(day);
                    assert_eq!(seconds_since_2000(0, date), Some(expected * SECONDS_PER_DAY));
                    assert_eq!(
                        seconds_since_2000(0x23_5959, date),
                        Some((expected + 1) * SECONDS_PER_DAY - 1)
                    );
                    expected += 1;
                }
            }
        }
        assert_eq!(expected, 36_525);
    }

    #[test]
    fn every_second_of_a_day_is_one_after_the_one_before_and_nothing_else_is_a_time() {
        for second in 0..SECONDS_PER_DAY {
            let (hour, minute) = (bcd(second / 3_600), bcd(second / 60 % 60));
            let time = hour << 16 | minute << 8 | bcd(second % 60);
            assert_eq!(seconds_since_2000(time, 0x01_2101), Some(366 * SECONDS_PER_DAY + second));
        }
        for time in [0x24_0000, 0x00_6000, 0x00_0060, 0x0a_0000, 0x00_0a00, 0x00_000a] {
            assert_eq!(seconds_since_2000(time, 0x01_2101), None, "{time:#x}");
        }
        for date in [0x01_2100, 0x01_2001, 0x01_2132, 0x01_3301, 0xa0_2101, 0x01_210a] {
            assert_eq!(seconds_since_2000(0, date), None, "{date:#x}");
        }
    }
}
