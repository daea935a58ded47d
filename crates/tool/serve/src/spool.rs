//! The spool: records and events on disk from the moment at which they count as recorded until the broker has them.
//!
//! ```text
//!  append ─► file, synced ─► next_unsent_record ─► acknowledge ─► (RESEND passes) ─► settled, removed
//!                                 ▲                                │
//!                                 └── rewind: the connection broke ◄┘
//! ```
//!
//! A broker that is killed may lose what it acknowledged last, so a record stays for `RETENTION_TIME` after its
//! acknowledgement, and is sent again with the same identifier if the connection breaks meanwhile. The identifier
//! is that of its file, drawn at random, and its number: no clock and no restart makes two records the same.
//!
//! A file is never written again after a restart. Bytes that are no whole record are copied into the folder
//! `damaged`, reported with the numbers and times between which they lie, and passed over. A file that the system cannot
//! read is tried again for a minute before its records count as lost; it is moved into `damaged` in the place of being
//! removed.

mod report;
pub mod segment;

use std::{
    collections::{BTreeMap, VecDeque},
    fs::{self, File, OpenOptions},
    hash::{BuildHasher as _, RandomState},
    io::{self, Read as _, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};
use fs4::FileExt;

pub(crate) use self::report::SpoolReport;
use self::segment::{CRC, IndexEntry, SpoolRecord, decode, encode, scan};

/// A record is kept for this long after its acknowledgement.
pub(crate) const RETENTION_TIME: Duration = Duration::from_secs(60);
/// A file that cannot be read is tried again for this long.
const READ_RETRY_TIMEOUT: Duration = Duration::from_secs(60);
/// A file that has reached this length is followed by a new one.
const SEGMENT_ROLLOVER_BYTES: u64 = 1 << 20;
const SEGMENT_EXTENSION: &str = "spool";
/// The folder of bytes and files that could not be sent.
const DAMAGED_FOLDER_NAME: &str = "damaged";
const SETTLED_FILE_NAME: &str = "settled";

/// Makes the payload of the record with an identifier.
pub type PayloadBuilder = dyn Fn(&str) -> Vec<u8> + Send;

/// Something to be recorded.
pub struct NewRecord {
    /// When it was made, in ms since 1970 (UTC).
    pub time_ms: u64,
    /// Where it is published.
    pub topic: String,
    /// Makes the payload of the record with this identifier.
    pub payload: Box<PayloadBuilder>,
}

/// The files of a folder, of which this process alone takes care.
pub struct Spool {
    folder: PathBuf,
    limit: u64,
    segments: VecDeque<SpoolSegment>,
    /// The file that is written; `None`: the next record begins one.
    active: Option<File>,
    next: u64,
    /// Everything up to this number is done with.
    settled: u64,
    /// The last one that was handed out to be sent.
    sent: u64,
    /// Records that the broker has acknowledged and that are not settled, with the time of the acknowledgement.
    acknowledged: BTreeMap<u64, Instant>,
    /// Since when the next record cannot be read.
    unreadable_since: Option<Instant>,
    reports: Vec<SpoolReport>,
    _lock: File,
}

struct SpoolSegment {
    id: u64,
    path: PathBuf,
    entries: Vec<IndexEntry>,
    bytes: u64,
    /// Records of it were given up: they could not be read.
    has_lost: bool,
}

impl SpoolSegment {
    /// Removes the file, or moves it into [`DAMAGED_FOLDER_NAME`] if it has records that were never sent.
    fn remove(&self) {
        if self.has_lost
            && let Some((folder, name)) = self.path.parent().zip(self.path.file_name())
        {
            let copies = folder.join(DAMAGED_FOLDER_NAME);
            fs::create_dir_all(&copies).ok();
            fs::rename(&self.path, copies.join(name)).ok();
        } else {
            fs::remove_file(&self.path).ok();
        }
    }

    /// Returns the records with a higher number.
    fn entries_after(&self, number: u64) -> &[IndexEntry] {
        &self.entries[self.entries.partition_point(|entry| entry.number <= number)..]
    }
}

impl Spool {
    /// Opens the spool of a folder, which is made if need be. It has at most `limit` bytes of records.
    ///
    /// # Errors
    /// Another process has it, or the folder cannot be read or written.
    pub fn open(folder: &Path, limit: u64) -> Result<Self> {
        let place = || folder.display().to_string();
        fs::create_dir_all(folder).with_context(place)?;
        let path = folder.join("lock");
        let lock = File::create(&path).with_context(|| path.display().to_string())?;
        FileExt::try_lock(&lock).with_context(|| {
            format!(
                "{}: another process publishes from this spool; end it, or give each bridge a folder of its own",
                folder.display()
            )
        })?;
        let settled = read_settled_record_number(folder);
        let mut spool = Self {
            folder: folder.into(),
            limit,
            segments: VecDeque::new(),
            active: None,
            next: settled + 1,
            settled,
            sent: settled,
            acknowledged: BTreeMap::new(),
            unreadable_since: None,
            reports: Vec::new(),
            _lock: lock,
        };
        spool.load_segments().with_context(place)?;
        spool.remove_settled_segments();
        Ok(spool)
    }

    fn load_segments(&mut self) -> io::Result<()> {
        let mut names: Vec<PathBuf> =
            fs::read_dir(&self.folder)?.flatten().map(|entry| entry.path()).collect();
        names.retain(|path| {
            path.extension().is_some_and(|extension| extension == SEGMENT_EXTENSION)
        });
        names.sort();
        for path in names {
            let Some((first, id)) = parse_segment_file_name(&path) else { continue };
            let bytes = fs::read(&path)?;
            let (entries, gaps) = scan(id, &bytes);
            for gap in gaps.iter().filter(|gap| {
                // Damage among settled records needs no report.
                gap.after.is_none_or(|after| after.number > self.settled + 1)
            }) {
                let copy = self.folder.join(DAMAGED_FOLDER_NAME);
                fs::create_dir_all(&copy)?;
                let name = path.file_stem().unwrap_or_default().to_string_lossy();
                let copy = copy.join(format!("{name}-{}.bin", gap.at));
                if !copy.exists() {
                    fs::write(&copy, &bytes[gap.at..gap.at + gap.length])?;
                    self.reports.push(SpoolReport::damaged(&path, gap, first, copy));
                }
            }
            let last = entries.last().map_or(first.saturating_sub(1), |entry| entry.number);
            self.next = self.next.max(last + 1);
            let bytes = bytes.len() as u64;
            self.segments.push_back(SpoolSegment { id, path, entries, bytes, has_lost: false });
        }
        Ok(())
    }

    /// Records these. When this returns they are on the disk, all of them or none.
    ///
    /// # Errors
    /// The disk takes them not: it is full, or broken.
    pub fn append(&mut self, drafts: &[NewRecord]) -> io::Result<()> {
        if drafts.is_empty() {
            return Ok(());
        }
        if self.active.is_none()
            || self.segments.back().is_none_or(|segment| segment.bytes >= SEGMENT_ROLLOVER_BYTES)
        {
            self.create_segment()?;
        }
        let Some((segment, file)) = self.segments.back_mut().zip(self.active.as_mut()) else {
            return Err(io::ErrorKind::NotFound.into());
        };
        let (mut bytes, mut entries) = (Vec::new(), Vec::new());
        for (draft, number) in drafts.iter().zip(self.next..) {
            let payload = (draft.payload)(&format!("{:016x}-{number}", segment.id));
            let (time_ms, topic) = (draft.time_ms, draft.topic.clone());
            let record = SpoolRecord { number, time_ms, topic, payload };
            let encoded = encode(segment.id, &record)
                .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "a record too long"))?;
            let at = segment.bytes + bytes.len() as u64;
            entries.push(IndexEntry { number, time_ms, at, length: encoded.len() });
            bytes.extend(encoded);
        }
        if let Err(error) = file.write_all(&bytes).and_then(|()| file.sync_data()) {
            // Whatever of it is there must not be read as recorded; the next record begins a file.
            file.set_len(segment.bytes).ok();
            self.active = None;
            // If the file cannot be cut either, two records must not have one number: the second would count as sent.
            self.next += entries.len() as u64;
            return Err(error);
        }
        segment.bytes += bytes.len() as u64;
        self.next += entries.len() as u64;
        segment.entries.extend(entries);
        self.enforce_size_limit();
        Ok(())
    }

    fn create_segment(&mut self) -> io::Result<()> {
        self.active = None;
        if self.segments.back().is_some_and(|segment| segment.entries.is_empty()) {
            // It could not be written; it may hold half a record.
            self.segments.pop_back().map(|segment| fs::remove_file(segment.path));
        }
        let id = RandomState::new().hash_one(self.next);
        let path = self.folder.join(format!("{:020}-{id:016x}.{SEGMENT_EXTENSION}", self.next));
        let file = OpenOptions::new().create_new(true).append(true).open(&path)?;
        // Its name too must outlive the power.
        #[cfg(unix)]
        File::open(&self.folder)?.sync_all()?;
        self.active = Some(file);
        let entries = Vec::new();
        self.segments.push_back(SpoolSegment { id, path, entries, bytes: 0, has_lost: false });
        Ok(())
    }

    /// Removes the oldest files while there are more bytes than the limit.
    fn enforce_size_limit(&mut self) {
        let mut bytes: u64 = self.segments.iter().map(|segment| segment.bytes).sum();
        while bytes > self.limit && self.segments.len() > 1 {
            let Some(oldest) = self.segments.pop_front() else { return };
            bytes -= oldest.bytes;
            let lost = |entry: &&IndexEntry| {
                entry.number > self.settled && !self.acknowledged.contains_key(&entry.number)
            };
            let lost: Vec<IndexEntry> = oldest.entries.iter().filter(lost).copied().collect();
            if let (Some(first), Some(last)) = (lost.first(), lost.last()) {
                self.reports.push(SpoolReport::overrun(*first, *last, lost.len()));
            }
            let last = oldest.entries.last().map_or(0, |entry| entry.number);
            self.settled = self.settled.max(last);
            self.sent = self.sent.max(self.settled);
            oldest.remove();
        }
        self.prune_acknowledged_numbers();
    }

    /// Returns the next record that was not sent since the last [`Self::rewind`]; `None`: there is none, or its file cannot
    /// be read now.
    pub fn next_unsent_record(&mut self, now: Instant) -> Option<SpoolRecord> {
        loop {
            let sent = self.sent;
            let first = |segment: &SpoolSegment| segment.entries_after(sent).first().copied();
            let mut found = self
                .segments
                .iter_mut()
                .filter_map(|segment| first(segment).map(|of| (segment, of)));
            let (segment, entry) = found.next()?;
            let why = match read_record(segment, entry) {
                Ok(Some(record)) => {
                    self.sent = entry.number;
                    self.unreadable_since = None;
                    return Some(record);
                }
                // Damaged since it was written.
                Ok(None) => None,
                Err(error) => {
                    let is_first = self.unreadable_since.is_none();
                    let since = *self.unreadable_since.get_or_insert(now);
                    if is_first {
                        self.reports.push(SpoolReport::unreadable_file(&segment.path, &error));
                    }
                    if now.saturating_duration_since(since) < READ_RETRY_TIMEOUT {
                        return None;
                    }
                    Some(error)
                }
            };
            segment.has_lost = true;
            self.reports.push(SpoolReport::unreadable_record(&segment.path, entry, why.as_ref()));
            self.sent = entry.number;
            self.acknowledge(entry.number, now);
        }
    }

    /// Takes a record back that could not be sent: it is the next one.
    pub(crate) fn requeue(&mut self, number: u64) {
        self.sent = number.saturating_sub(1);
    }

    /// Takes note that the broker has a record.
    pub fn acknowledge(&mut self, number: u64, now: Instant) {
        if number > self.settled {
            self.acknowledged.entry(number).or_insert(now);
        }
    }

    /// Begins again with the first record that is not settled: the connection was lost.
    pub fn rewind(&mut self) {
        self.sent = self.settled;
        self.acknowledged.clear();
    }

    /// Settles what was acknowledged long enough ago, and removes files without any other record.
    pub(crate) fn settle(&mut self, now: Instant) {
        let before = self.settled;
        let old = |at: &Instant| now.saturating_duration_since(*at) >= RETENTION_TIME;
        // One that is open keeps all after it, in whatever order the acknowledgements came.
        let open = self.segments.iter().flat_map(|segment| segment.entries_after(before));
        let done = open.take_while(|entry| self.acknowledged.get(&entry.number).is_some_and(old));
        self.settled = done.last().map_or(before, |entry| entry.number);
        if self.settled != before {
            self.prune_acknowledged_numbers();
            self.remove_settled_segments();
        }
    }

    fn prune_acknowledged_numbers(&mut self) {
        self.acknowledged = self.acknowledged.split_off(&(self.settled + 1));
    }

    fn remove_settled_segments(&mut self) {
        let is_written = usize::from(self.active.is_some());
        while self.segments.len() > is_written
            && let Some(oldest) = self.segments.front()
            && oldest.entries.last().is_none_or(|entry| entry.number <= self.settled)
        {
            oldest.remove();
            self.segments.pop_front();
        }
        // If it is lost, some records are sent once more.
        let path = self.folder.join(SETTLED_FILE_NAME);
        let new = path.with_extension("new");
        let text = format_settled_record_number(self.settled);
        fs::write(&new, text).and_then(|()| fs::rename(&new, &path)).ok();
    }

    /// Returns how many records the broker has not acknowledged.
    #[must_use]
    pub fn unacknowledged_count(&self) -> usize {
        let open: usize =
            self.segments.iter().map(|segment| segment.entries_after(self.settled).len()).sum();
        open.saturating_sub(self.acknowledged.len())
    }

    /// Returns what was found damaged and what gave way since the last call.
    pub(crate) fn take_reports(&mut self) -> Vec<SpoolReport> {
        std::mem::take(&mut self.reports)
    }
}

/// Returns a record of a file; `None`: it is damaged.
///
/// # Errors
/// The file cannot be read.
fn read_record(segment: &SpoolSegment, entry: IndexEntry) -> io::Result<Option<SpoolRecord>> {
    let mut bytes = vec![0; entry.length];
    let mut file = File::open(&segment.path)?;
    file.seek(SeekFrom::Start(entry.at))?;
    match file.read_exact(&mut bytes) {
        // It was cut.
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        other => other?,
    }
    let record = decode(segment.id, &bytes).map(|(record, _)| record);
    Ok(record.filter(|record| record.number == entry.number))
}

/// Returns the first number and the identifier that a file's name has.
fn parse_segment_file_name(path: &Path) -> Option<(u64, u64)> {
    let (first, id) = path.file_stem()?.to_str()?.split_once('-')?;
    Some((first.parse().ok()?, u64::from_str_radix(id, 16).ok()?))
}

fn read_settled_record_number(folder: &Path) -> u64 {
    let text = fs::read_to_string(folder.join(SETTLED_FILE_NAME)).unwrap_or_default();
    let number = text.split(' ').next().and_then(|part| part.parse().ok());
    // A number that is too high by a flipped bit would remove records that were never sent.
    number.filter(|number| text == format_settled_record_number(*number)).unwrap_or(0)
}

/// Returns the text of the file [`SETTLED_FILE_NAME`]: the number and its checksum.
fn format_settled_record_number(number: u64) -> String {
    format!("{number} {:08x}\n", CRC.checksum(&number.to_le_bytes()))
}

#[cfg(test)]
mod tests;
