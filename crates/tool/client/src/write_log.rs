//! Who has written to the bridge: its log, in words and as JSON.

use serde_json::{Value, json};
use trueup_store::write_log::{RECORD_SIZE, WriteKind, WriteRecord};

/// Returns the writes of [`WRITE_LOG`](crate::sdo_object::WRITE_LOG), the oldest first; those of another version are omitted.
#[must_use]
pub fn decode_write_records(bytes: &[u8]) -> Vec<WriteRecord> {
    bytes.as_chunks::<RECORD_SIZE>().0.iter().filter_map(WriteRecord::from_bytes).collect()
}

/// Returns a write in words: what, when, and over which line.
#[must_use]
pub fn format_record(write: &WriteRecord) -> String {
    let about = match write.what {
        WriteKind::Loaded if write.is_unattended => {
            format!(" calibration {:08x}, while no CNC was sending", write.about)
        }
        WriteKind::Loaded | WriteKind::Cancelled => format!(" calibration {:08x}", write.about),
        WriteKind::Zeroed | WriteKind::Offered => {
            format!(" at {:+.2} µm", f64::from(write.about.cast_signed()) / 1_000.0)
        }
        WriteKind::Confirmed => format!(" fault {}", write.about),
        WriteKind::Named => format!(" as {:08x}", write.about),
        WriteKind::Forgotten => String::new(),
    };
    let after = f64::from(write.at_ms) / 1_000.0;
    let time = match write.utc_s {
        0 => format!("{after:.1} s after a start"),
        utc_s => format!("{}, {after:.1} s after a start", format_utc(utc_s)),
    };
    let number = match write.sequence {
        0 => "not stored".to_owned(),
        number => format!("#{number}"),
    };
    format!("{number} {}{about}, {time}, by {}", write.what.as_str(), write.origin.as_str())
}

/// Returns the same as JSON.
#[must_use]
pub fn record_to_json(write: &WriteRecord) -> Value {
    json!({
        "number": (write.sequence > 0).then_some(write.sequence),
        "what": write.what.as_str(),
        "about": write.about,
        "line": write.origin.as_str(),
        "unattended": write.is_unattended,
        "after_start_s": f64::from(write.at_ms) / 1_000.0,
        "utc": (write.utc_s > 0).then(|| format_utc(write.utc_s)),
        "calibration_crc":
            (write.calibration > 0).then(|| format!("{:08x}", write.calibration)),
    })
}

/// Seconds since 1970 as a date and a time (ISO 8601), by the Gregorian calendar.
#[must_use]
pub fn format_utc(utc_s: u32) -> String {
    const SECONDS_PER_DAY: u32 = 86_400;
    let is_leap = |year: u32| {
        year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400))
    };
    let (mut day, mut year) = (utc_s / SECONDS_PER_DAY, 1970);
    loop {
        let days = if is_leap(year) { 366 } else { 365 };
        if day < days {
            break;
        }
        day -= days;
        year += 1;
    }
    let february = if is_leap(year) { 29 } else { 28 };
    let mut month = 1;
    for days in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31] {
        if day < days {
            break;
        }
        day -= days;
        month += 1;
    }
    let second = utc_s % SECONDS_PER_DAY;
    let (hour, minute) = (second / 3_600, second / 60 % 60);
    format!("{year:04}-{month:02}-{:02}T{hour:02}:{minute:02}:{:02}Z", day + 1, second % 60)
}

#[cfg(test)]
mod tests {
    use super::*;
    use trueup_store::write_log::WriteOrigin;

    #[test]
    fn a_write_is_reported_with_what_when_and_over_which_line() {
        let mut write = WriteRecord {
            sequence: 5,
            calibration: 0xA5,
            about: 0x1234_ABCD,
            at_ms: 61_250,
            utc_s: 1_709_164_800,
            what: WriteKind::Loaded,
            origin: WriteOrigin::Can,
            is_unattended: false,
        };
        assert_eq!(
            format_record(&write),
            "#5 loaded calibration 1234abcd, 2024-02-29T00:00:00Z, 61.2 s after a start, by can"
        );
        assert_eq!(record_to_json(&write)["calibration_crc"], "000000a5");
        assert_eq!(
            decode_write_records(&[&write.to_bytes()[..], &[9; RECORD_SIZE]].concat()),
            [write]
        );
        (write.sequence, write.utc_s, write.what) = (0, 0, WriteKind::Zeroed);
        write.about = (-1_500_i32).cast_unsigned();
        assert_eq!(
            format_record(&write),
            "not stored zeroed at -1.50 µm, 61.2 s after a start, by can"
        );
    }

    #[test]
    fn the_time_of_day_is_that_of_the_calendar() {
        for (utc_s, expected) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_868_799, "2000-02-29T23:59:59Z"),
            (1_735_689_599, "2024-12-31T23:59:59Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
        ] {
            assert_eq!(format_utc(utc_s), expected);
        }
    }
}
