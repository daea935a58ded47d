//! Dates and times of day as people and loggers write them.

use time::{Date, Month};

/// The order of the numbers of a date.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DateOrder {
    /// 31.12.2026
    DayMonth,
    /// 12/31/2026
    MonthDay,
    /// 26-12-31
    Year,
}

/// A date, a time of day, or both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Timestamp {
    /// Days from an epoch, where there is a date.
    pub(crate) day: Option<i64>,
    /// Seconds of the day, where there is a time; in UTC where the zone is stated.
    pub(crate) seconds: Option<f64>,
    /// A zone is stated.
    pub(crate) has_zone: bool,
}

impl Timestamp {
    /// Returns the seconds from the epoch, or from midnight.
    pub(crate) fn seconds_since_epoch(&self) -> f64 {
        self.day.unwrap_or(0) as f64 * 86_400.0 + self.seconds.unwrap_or(0.0)
    }
}

/// How a time of two numbers is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TwoPartTimeFormat {
    HoursMinutes,
    MinutesSeconds,
}

/// Returns true for what is written as a date or a time, whatever the order of its numbers.
pub(crate) fn is_timestamp(text: &str) -> bool {
    use DateOrder::{DayMonth, MonthDay, Year};
    [DayMonth, MonthDay, Year].into_iter().any(|order| {
        parse(text, order, TwoPartTimeFormat::HoursMinutes).is_some()
            || parse(text, order, TwoPartTimeFormat::MinutesSeconds).is_some()
    })
}

/// Returns true if the order of the date's numbers is open.
pub(crate) fn has_ambiguous_order(text: &str) -> bool {
    let (date, _) = split_date_and_time(text);
    date.is_some_and(|date| split_date(date).is_some_and(|(numbers, _)| numbers[0].len() <= 2))
}

/// Returns true for a time of two whole numbers, `08:15`: of the day, or of a stopwatch.
pub(crate) fn is_two_part_time(text: &str) -> bool {
    let (_, time) = split_date_and_time(text);
    time.is_some_and(|time| time.matches(':').count() == 1 && !time.contains(['.', ',']))
}

/// Returns the date and the time of `text`, as they are written.
fn split_date_and_time(text: &str) -> (Option<&str>, Option<&str>) {
    let text = text.trim();
    let Some(colon) = text.find(':') else { return (Some(text), None) };
    let start = text[..colon]
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |at| at + text[at..].chars().next().map_or(1, char::len_utf8));
    let date = text[..start].trim().trim_end_matches(['T', ',']).trim();
    (Some(date).filter(|date| !date.is_empty()), Some(&text[start..]))
}

/// Returns the moment that `text` says; `None` if it is none in this order.
pub(crate) fn parse(text: &str, order: DateOrder, pair: TwoPartTimeFormat) -> Option<Timestamp> {
    let (date, time) = split_date_and_time(text);
    let day = match date {
        Some(date) => Some(parse_day(date, order)?),
        None => None,
    };
    let (seconds, zone_s) = match time {
        Some(time) => {
            let (seconds, zone_s) = parse_time_of_day(time, pair)?;
            (Some(seconds), zone_s)
        }
        None => (None, None),
    };
    let seconds = seconds.map(|seconds| seconds - zone_s.unwrap_or(0.0));
    Some(Timestamp { day, seconds, has_zone: zone_s.is_some() })
}

fn split_date(date: &str) -> Option<(Vec<&str>, char)> {
    // `Mo, 03.04.2026`
    let date =
        date.trim_start_matches(|c: char| c.is_alphabetic()).trim_start_matches([',', '.', ' ']);
    let separator = date.chars().find(|c| !c.is_ascii_digit())?;
    if !['.', '-', '/'].contains(&separator) {
        return None;
    }
    let mut numbers: Vec<&str> = date.split(separator).map(str::trim).collect();
    if separator == '.' && numbers.last() == Some(&"") {
        numbers.pop();
        // `03.04.`: without its year.
        if numbers.len() != 2 {
            return None;
        }
    } else if numbers.len() != 3 {
        return None;
    }
    let is_number = |text: &&str| {
        !text.is_empty() && text.len() <= 4 && text.chars().all(|c| c.is_ascii_digit())
    };
    numbers.iter().all(is_number).then_some((numbers, separator))
}

/// A year for dates without one: it has a 29 February.
const DEFAULT_YEAR: i32 = 2000;

fn parse_day(date: &str, order: DateOrder) -> Option<i64> {
    if let Some(day) = parse_named_month_date(date) {
        return Some(day);
    }
    if date.len() == 8 && date.chars().all(|c| c.is_ascii_digit()) && date.starts_with("20") {
        return julian_day(
            date[..4].parse().ok()?,
            date[4..6].parse().ok()?,
            date[6..].parse().ok()?,
        );
    }
    let (texts, _) = split_date(date)?;
    let numbers: Vec<i32> = texts.iter().map_while(|text| text.parse().ok()).collect();
    match (&numbers[..], texts[0].len()) {
        (&[day, month], 1 | 2) => match order {
            DateOrder::DayMonth => julian_day(DEFAULT_YEAR, month, day),
            DateOrder::MonthDay => julian_day(DEFAULT_YEAR, day, month),
            DateOrder::Year => None,
        },
        (&[year, month, day], 4) => julian_day(year, month, day),
        (&[first, second, third], 1 | 2) => {
            let is_long = texts[2].len() == 4;
            let full = |year: i32| if year < 100 { 2000 + year } else { year };
            match order {
                DateOrder::DayMonth => julian_day(full(third), second, first),
                DateOrder::MonthDay => julian_day(full(third), first, second),
                DateOrder::Year if !is_long => julian_day(full(first), second, third),
                DateOrder::Year => None,
            }
        }
        _ => None,
    }
}

fn julian_day(year: i32, month: i32, day: i32) -> Option<i64> {
    let month = Month::try_from(u8::try_from(month).ok()?).ok()?;
    let date = Date::from_calendar_date(year, month, u8::try_from(day).ok()?).ok()?;
    Some(i64::from(date.to_julian_day()))
}

/// `3 Apr 2026`, `03-Apr-26`, `Apr 3, 2026`, `3. April 2026`.
fn parse_named_month_date(date: &str) -> Option<i64> {
    const MONTH_NAMES: [&[&str]; 12] = [
        &["jan"],
        &["feb"],
        &["mar", "mär", "mrz"],
        &["apr", "avr"],
        &["may", "mai"],
        &["jun", "juin"],
        &["jul", "juil"],
        &["aug", "août"],
        &["sep"],
        &["oct", "okt"],
        &["nov"],
        &["dec", "dez", "déc"],
    ];
    let words: Vec<String> = date
        .split([' ', '-', '.', ',', '/'])
        .filter(|word| !word.is_empty())
        .map(str::to_lowercase)
        .collect();
    let [first, second, third] = &words[..] else { return None };
    let month = |word: &String| {
        let found =
            MONTH_NAMES.iter().position(|names| names.iter().any(|name| word.starts_with(name)));
        found.and_then(|at| i32::try_from(at + 1).ok())
    };
    let number = |word: &String| word.parse::<i32>().ok();
    let year = number(third).map(|year| if year < 100 { 2000 + year } else { year })?;
    match (month(first), month(second)) {
        (None, Some(month)) => julian_day(year, month, number(first)?),
        (Some(month), None) => julian_day(year, month, number(second)?),
        _ => None,
    }
}

/// Returns the seconds of a time of day, and the seconds of its zone east of UTC where it is stated.
fn parse_time_of_day(time: &str, pair: TwoPartTimeFormat) -> Option<(f64, Option<f64>)> {
    let lower = time.trim().to_lowercase();
    let lower = lower.trim_end_matches("uhr").trim_end();
    let (clock, zone_s) = split_time_zone(lower)?;
    let (clock, half) = match clock.trim_end_matches('.').trim_end() {
        text if text.ends_with("am") || text.ends_with("a.m") => (text, Some(0.0)),
        text if text.ends_with("pm") || text.ends_with("p.m") => (text, Some(12.0)),
        text => (text, None),
    };
    let clock = clock.trim_end_matches(|c: char| c.is_alphabetic() || c == '.').trim_end();
    let parts: Vec<&str> = clock.split(':').collect();
    let whole = |text: &str| {
        (1..=4).contains(&text.len()).then(|| text.parse::<u32>().ok()).flatten().map(f64::from)
    };
    let decimals = |text: &str| {
        let text = text.replace(',', ".");
        let is_number = text.starts_with(|c: char| c.is_ascii_digit())
            && text.chars().all(|c| c.is_ascii_digit() || c == '.');
        is_number.then(|| text.parse::<f64>().ok()).flatten()
    };
    let (hours, minutes, seconds) = match parts[..] {
        [minutes, seconds]
            if seconds.contains(['.', ',']) || pair == TwoPartTimeFormat::MinutesSeconds =>
        {
            (0.0, whole(minutes)?, decimals(seconds)?)
        }
        [hours, minutes] => (whole(hours)?, whole(minutes)?, 0.0),
        [hours, minutes, seconds] => (whole(hours)?, whole(minutes)?, decimals(seconds)?),
        // `08:15:30:250`
        [hours, minutes, seconds, millis] => {
            (whole(hours)?, whole(minutes)?, whole(seconds)? + whole(millis)? / 1000.0)
        }
        _ => return None,
    };
    let is_clock = pair == TwoPartTimeFormat::HoursMinutes || parts.len() > 2;
    if seconds >= 60.0 || (is_clock && parts.len() > 1 && minutes >= 60.0 && hours > 0.0) {
        return None;
    }
    if parts.len() == 2
        && pair == TwoPartTimeFormat::HoursMinutes
        && minutes >= 60.0
        && seconds == 0.0
    {
        return None;
    }
    let hours = match half {
        Some(more) if (1.0..=12.0).contains(&hours) => hours % 12.0 + more,
        Some(_) => return None,
        None => hours,
    };
    Some((hours * 3600.0 + minutes * 60.0 + seconds, zone_s))
}

/// Splits a zone, `z` or `+02:00`, from a time.
fn split_time_zone(time: &str) -> Option<(&str, Option<f64>)> {
    if let Some(clock) = time.strip_suffix('z').or_else(|| time.strip_suffix("utc")) {
        return Some((clock.trim_end(), Some(0.0)));
    }
    let Some(at) = time.rfind(['+', '-']) else { return Some((time, None)) };
    let (clock, zone) = time.split_at(at);
    let sign = if zone.starts_with('-') { -1.0 } else { 1.0 };
    let digits: String = zone[1..].chars().filter(|c| *c != ':').collect();
    if !(digits.len() == 2 || digits.len() == 4) {
        return None;
    }
    let number: f64 = digits.parse().ok()?;
    let (hours, minutes) =
        if digits.len() == 2 { (number, 0.0) } else { ((number / 100.0).floor(), number % 100.0) };
    Some((clock.trim_end(), Some(sign * (hours * 3600.0 + minutes * 60.0))))
}

/// Returns the moment of a workbook's serial number: days from 1899-12-30, below 1 a time of day.
pub(crate) fn from_serial_date(days: f64) -> Timestamp {
    // To the nearest 10 µs: a serial number has no more.
    let seconds = ((days - days.floor()) * 86_400.0 * 1e5).round() / 1e5;
    let has_date = days >= 1.0;
    Timestamp {
        day: has_date.then_some(days.floor() as i64),
        seconds: (!has_date || seconds != 0.0).then_some(seconds),
        has_zone: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use DateOrder::{DayMonth, MonthDay, Year};

    fn days(text: &str, order: DateOrder) -> Option<i64> {
        parse(text, order, TwoPartTimeFormat::HoursMinutes)?.day
    }

    #[test]
    fn a_date_is_read_in_its_order() {
        let third_of_april = julian_day(2026, 4, 3);
        for (text, order) in [
            ("03.04.2026", DayMonth),
            ("3.4.26", DayMonth),
            ("04/03/2026", MonthDay),
            ("26-04-03", Year),
            ("2026-04-03", DayMonth),
            ("2026/04/03", MonthDay),
            ("20260403", DayMonth),
            ("3 Apr 2026", MonthDay),
            ("03-Apr-26", DayMonth),
            ("Apr 3, 2026", DayMonth),
            ("3. April 2026", DayMonth),
            ("Fr, 03.04.2026", DayMonth),
        ] {
            assert_eq!(days(text, order), third_of_april, "{text}");
        }
        assert_eq!(days("03.04.", DayMonth), julian_day(2000, 4, 3));
        assert_eq!(days("31.04.2026", DayMonth), None);
        assert_eq!(days("13/13/2026", MonthDay), None);
        assert!(has_ambiguous_order("03.04.2026") && has_ambiguous_order("03.04."));
        assert!(
            !has_ambiguous_order("2026-04-03")
                && !has_ambiguous_order("08:15")
                && !has_ambiguous_order("3 Apr 2026")
        );
    }

    #[test]
    fn a_time_is_read_to_the_second() {
        let seconds =
            |text: &str, pair| parse(text, DayMonth, pair).map(|stamp| stamp.seconds_since_epoch());
        for (text, expected) in [
            ("08:15", 29_700.0),
            ("8:15 PM", 72_900.0),
            ("12:05 am", 300.0),
            ("08:15:30,5", 29_730.5),
            ("08:15:30.25", 29_730.25),
            ("08:15:30:250", 29_730.25),
            ("26:00:00", 93_600.0),
            ("08:15 Uhr", 29_700.0),
            ("01:23.5", 83.5),
        ] {
            assert_eq!(seconds(text, TwoPartTimeFormat::HoursMinutes), Some(expected), "{text}");
        }
        assert_eq!(seconds("01:23", TwoPartTimeFormat::MinutesSeconds), Some(83.0));
        assert_eq!(seconds("90:00", TwoPartTimeFormat::MinutesSeconds), Some(5400.0));
        assert_eq!(seconds("08:75", TwoPartTimeFormat::HoursMinutes), None);
        let both = |text| parse(text, DayMonth, TwoPartTimeFormat::HoursMinutes).expect("a moment");
        let utc = both("2026-04-03T08:15:00Z");
        assert_eq!(both("2026-04-03T10:15:00+02:00"), utc);
        assert_eq!(both("2026-04-03 08:15").seconds_since_epoch(), utc.seconds_since_epoch());
        assert_eq!(from_serial_date(46_115.343_75).seconds, Some(29_700.0));
        assert_eq!(from_serial_date(0.34375).day, None);
    }
}
