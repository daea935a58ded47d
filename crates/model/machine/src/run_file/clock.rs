//! Times as loggers write them, ISO 8601, in seconds from the first one of the file.
//!
//! `2026-11-22T08:00:00Z`, with a fraction, with another zone, or without one; a blank may stand for the
//! `T`. Within a file all have a zone or none has: without one, it is not known how far they are apart.

use time::{OffsetDateTime, PrimitiveDateTime, UtcOffset, format_description::well_known::Iso8601};

/// Names, in small letters, under which loggers write such a time.
const LOGGER_TIME_COLUMN_NAMES: [&str; 4] = ["time", "timestamp", "datetime", "date_time"];

/// Returns whether a column of this name may hold times of day.
pub(super) fn can_hold_timestamps(name: &str) -> bool {
    is_logger_time_column(name) || name == "time_s" || name.ends_with("_time_s")
}

/// Returns whether loggers call their time so; its values are seconds only where it says so in its name.
pub(super) fn is_logger_time_column(name: &str) -> bool {
    LOGGER_TIME_COLUMN_NAMES.contains(&name.to_lowercase().as_str())
}

/// Returns whether these can only be seconds of Unix: of the years 2001 to 2096, and never running back.
pub(super) fn is_unix_time_series(values: &[f64]) -> bool {
    const UNIX_TIME_RANGE_S: std::ops::Range<f64> = 1e9..4e9;
    let mut there = values.iter().copied().filter(|value| !value.is_nan()).peekable();
    let mut before = f64::NEG_INFINITY;
    there.peek().is_some()
        && there.all(|value| {
            let is_next = value >= before;
            before = value;
            is_next && UNIX_TIME_RANGE_S.contains(&value)
        })
}

/// Returns whether `text` begins as a date does.
pub(super) fn looks_like_date(text: &str) -> bool {
    let bytes = text.as_bytes();
    bytes.len() >= 8 && bytes[..4].iter().all(u8::is_ascii_digit) && bytes[4] == b'-'
}

/// The first time of a file, from which all others are counted.
#[derive(Default)]
pub(super) struct TimeOrigin {
    first: Option<FirstTimestamp>,
}

/// In nanoseconds from 1970, and whether it has a zone.
struct FirstTimestamp {
    ns: i128,
    has_zone: bool,
}

impl TimeOrigin {
    /// `text` in seconds from the first time; else the rule it breaks.
    pub(super) fn parse_seconds_since_first(&mut self, text: &str) -> Result<f64, String> {
        let (ns, has_zone) = parse_timestamp(text).ok_or_else(|| {
            "is no time that is known: write seconds, or ISO 8601, 2026-11-22T08:00:00Z".to_string()
        })?;
        let first = self.first.get_or_insert(FirstTimestamp { ns, has_zone });
        if first.has_zone != has_zone {
            let [this, before] = if has_zone { ["a", "no"] } else { ["no", "a"] };
            return Err(format!(
                "has {this} time zone, the first time of the file has {before} one"
            ));
        }
        Ok((ns - first.ns) as f64 * 1e-9)
    }

    /// Returns the first time of the file in s from 1970; one without a zone counts as UTC.
    pub(super) fn first_timestamp_unix_s(&self) -> Option<f64> {
        self.first.as_ref().map(|first| first.ns as f64 * 1e-9)
    }
}

fn parse_timestamp(text: &str) -> Option<(i128, bool)> {
    let text = text.replacen(' ', "T", 1);
    if let Ok(time) = OffsetDateTime::parse(&text, &Iso8601::DEFAULT) {
        return Some((time.unix_timestamp_nanos(), true));
    }
    let time = PrimitiveDateTime::parse(&text, &Iso8601::DEFAULT).ok()?;
    Some((time.assume_offset(UtcOffset::UTC).unix_timestamp_nanos(), false))
}
