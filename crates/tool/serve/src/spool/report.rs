//! Damage and overrun of the spool as sentences: which records, of which time, and where they are now.

use std::{
    fmt, io,
    path::{Path, PathBuf},
};

use super::{
    DAMAGED_FOLDER_NAME,
    segment::{DamagedRange, IndexEntry},
};
use crate::clock::format_utc;

/// Records that are damaged, or gave way.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum SpoolReport {
    /// Bytes that are no whole record were found when the spool was opened.
    Damaged {
        /// The file.
        file: PathBuf,
        /// Their first byte.
        at: usize,
        /// How many there are.
        length: usize,
        /// The first number that is missing.
        first: u64,
        /// The last one; `None`: the file ends here.
        last: Option<u64>,
        /// The times of the whole records around them, in ms since 1970.
        between_ms: [Option<u64>; 2],
        /// Where the bytes were copied to.
        copy: PathBuf,
    },
    /// A record was whole when it was written, and cannot be had any more.
    Unreadable {
        /// The file.
        file: PathBuf,
        /// The number of the record.
        number: u64,
        /// When it was made, in ms since 1970.
        time_ms: u64,
        /// Why its file could not be read; `None`: its bytes are damaged.
        why: Option<String>,
    },
    /// A file cannot be read; it is tried again.
    Unread {
        /// The file.
        file: PathBuf,
        /// Why.
        why: String,
    },
    /// The oldest records gave way to new ones before the broker had them.
    Overrun {
        /// How many.
        count: usize,
        /// The first and the last number.
        numbers: [u64; 2],
        /// When these were made, in ms since 1970.
        times_ms: [u64; 2],
    },
}

impl SpoolReport {
    pub(super) fn damaged(
        file: &Path,
        gap: &DamagedRange,
        first_of_file: u64,
        copy: PathBuf,
    ) -> Self {
        Self::Damaged {
            file: file.into(),
            at: gap.at,
            length: gap.length,
            first: gap.before.map_or(first_of_file, |before| before.number + 1),
            last: gap.after.map(|after| after.number.saturating_sub(1)),
            between_ms: [gap.before, gap.after].map(|end| end.map(|entry| entry.time_ms)),
            copy,
        }
    }

    pub(super) fn unreadable_record(
        file: &Path,
        entry: IndexEntry,
        why: Option<&io::Error>,
    ) -> Self {
        let IndexEntry { number, time_ms, .. } = entry;
        Self::Unreadable { file: file.into(), number, time_ms, why: why.map(io::Error::to_string) }
    }

    pub(super) fn unreadable_file(file: &Path, why: &io::Error) -> Self {
        Self::Unread { file: file.into(), why: why.to_string() }
    }

    pub(super) fn overrun(first: IndexEntry, last: IndexEntry, count: usize) -> Self {
        let [numbers, times_ms] = [[first.number, last.number], [first.time_ms, last.time_ms]];
        Self::Overrun { count, numbers, times_ms }
    }

    /// Returns how many records are lost, as far as that is known.
    #[must_use]
    pub(crate) fn lost_record_count(&self) -> u64 {
        match self {
            Self::Damaged { first, last: Some(last), .. } => last.saturating_sub(*first) + 1,
            Self::Damaged { .. } | Self::Unreadable { .. } => 1,
            Self::Unread { .. } => 0,
            Self::Overrun { count, .. } => *count as u64,
        }
    }

    /// Returns the code of the event that is made of it.
    #[must_use]
    pub(crate) fn event_code(&self) -> &'static str {
        match self {
            Self::Damaged { .. } | Self::Unreadable { .. } => "spool-damaged",
            Self::Unread { .. } => "spool-unread",
            Self::Overrun { .. } => "spool-overrun",
        }
    }
}

impl fmt::Display for SpoolReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Damaged { file, at, length, first, last, between_ms, copy } => {
                write!(f, "{}, byte {at}: {length} bytes are no whole record: ", file.display())?;
                match last {
                    Some(last) if last > first => write!(f, "numbers {first} to {last}")?,
                    Some(_) => write!(f, "number {first}")?,
                    None => write!(f, "number {first}, where the file ends")?,
                }
                for (word, time_ms) in ["after", "before"].into_iter().zip(between_ms) {
                    if let Some(time_ms) = time_ms {
                        write!(f, ", {word} {}", format_utc(*time_ms))?;
                    }
                }
                write!(f, "; copied to {}, all others are sent", copy.display())
            }
            Self::Unreadable { file, number, time_ms, why } => {
                write!(f, "{}: record {number} of {} ", file.display(), format_utc(*time_ms))?;
                match why {
                    Some(why) => write!(f, "cannot be read: {why}")?,
                    None => write!(f, "was damaged after it was written")?,
                }
                write!(
                    f,
                    "; all others are sent, and its file is kept in {DAMAGED_FOLDER_NAME}; check the disk"
                )
            }
            Self::Unread { file, why } => write!(
                f,
                "{} cannot be read: {why}; it is tried again for a minute, and the records wait",
                file.display()
            ),
            Self::Overrun { count, numbers: [first, last], times_ms: [from, to] } => write!(
                f,
                "the spool is full: {count} records that the broker never had gave way to new \
                 ones, numbers {first} to {last}, {} to {}. Let it have more with --spool-mb, \
                 or bring the broker back",
                format_utc(*from),
                format_utc(*to)
            ),
        }
    }
}
