//! A file of the spool: records one after another. Each has its own checksum, so that a damaged one is found, named
//! by its neighbours, and costs no other.
//!
//! | bytes | are |
//! |---|---|
//! | 4 | `RECORD_MAGIC` |
//! | 4 | length of topic and payload with the 2 bytes before them, little-endian as all numbers |
//! | 8 | number, rising by 1 |
//! | 8 | time, ms since 1970 (UTC) |
//! | 2 | length of the topic |
//! | … | topic, payload |
//! | 4 | CRC-32 of the file's identifier and of all the bytes above |
//!
//! The identifier of the file is in its name only: a record that was copied into another file is damaged there.

use crc::{CRC_32_ISO_HDLC, Crc};

/// Begins a record: where one is damaged, the next one is searched for by it.
pub(crate) const RECORD_MAGIC: [u8; 4] = *b"tqR1";
/// Bytes before the topic's length.
const RECORD_HEADER_BYTES: usize = 24;
/// Bytes around topic and payload.
const RECORD_OVERHEAD_BYTES: usize = RECORD_HEADER_BYTES + 2 + 4;
/// Maximum bytes of topic and payload: a length above it is a damaged one.
const MAX_BODY_BYTES: usize = 1 << 20;
/// The checksum of all that a spool keeps.
pub(super) const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// A record that is sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpoolRecord {
    /// Its number, which orders all records of a spool.
    pub number: u64,
    /// When it was made, in ms since 1970 (UTC).
    pub time_ms: u64,
    /// Where it is published.
    pub topic: String,
    /// The bytes that are published.
    pub payload: Vec<u8>,
}

/// Where a whole record is in its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IndexEntry {
    /// Its number.
    pub number: u64,
    /// When it was made, in ms since 1970 (UTC).
    pub time_ms: u64,
    /// Its first byte.
    pub at: u64,
    /// Its bytes.
    pub length: usize,
}

/// Bytes of a file that are no whole record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DamagedRange {
    /// The first of them.
    pub at: usize,
    /// How many there are.
    pub length: usize,
    /// The whole record before them.
    pub before: Option<IndexEntry>,
    /// The whole record after them.
    pub after: Option<IndexEntry>,
}

/// Returns the bytes of a record in the file with this identifier; `None`: it is too long.
#[must_use]
pub fn encode(file: u64, record: &SpoolRecord) -> Option<Vec<u8>> {
    let body = record.topic.len() + record.payload.len();
    let topic = u16::try_from(record.topic.len()).ok()?;
    let length = u32::try_from(body + 2).ok().filter(|_| body <= MAX_BODY_BYTES)?;
    let mut bytes = Vec::with_capacity(RECORD_OVERHEAD_BYTES + body);
    bytes.extend(RECORD_MAGIC);
    bytes.extend(length.to_le_bytes());
    bytes.extend(record.number.to_le_bytes());
    bytes.extend(record.time_ms.to_le_bytes());
    bytes.extend(topic.to_le_bytes());
    bytes.extend(record.topic.as_bytes());
    bytes.extend(&record.payload);
    bytes.extend(checksum(file, &bytes).to_le_bytes());
    Some(bytes)
}

/// Returns the record that begins with the first of these bytes, and its length; `None`: no whole one does.
#[must_use]
pub fn decode(file: u64, bytes: &[u8]) -> Option<(SpoolRecord, usize)> {
    let rest = bytes.strip_prefix(&RECORD_MAGIC)?;
    let (length, rest) = rest.split_first_chunk()?;
    let length = usize::try_from(u32::from_le_bytes(*length)).ok()?;
    let whole = RECORD_HEADER_BYTES + length.checked_add(4)?;
    if !(2..=MAX_BODY_BYTES + 2).contains(&length) || bytes.len() < whole {
        return None;
    }
    let (number, rest) = rest.split_first_chunk()?;
    let (time_ms, rest) = rest.split_first_chunk()?;
    let (topic_length, rest) = rest.split_first_chunk()?;
    let (covered, found) = bytes[..whole].split_last_chunk()?;
    if checksum(file, covered) != u32::from_le_bytes(*found) {
        return None;
    }
    let body = rest.get(..length - 2)?;
    let (topic, payload) = body.split_at_checked(u16::from_le_bytes(*topic_length).into())?;
    let record = SpoolRecord {
        number: u64::from_le_bytes(*number),
        time_ms: u64::from_le_bytes(*time_ms),
        topic: String::from_utf8(topic.to_vec()).ok()?,
        payload: payload.to_vec(),
    };
    Some((record, whole))
}

/// Returns where the whole records are in a file, by rising number, and what lies between them.
#[must_use]
pub fn scan(file: u64, bytes: &[u8]) -> (Vec<IndexEntry>, Vec<DamagedRange>) {
    let (mut entries, mut gaps) = (Vec::<IndexEntry>::new(), Vec::new());
    let (mut at, mut gap_at) = (0, 0);
    while at < bytes.len() {
        let last = entries.last().copied();
        let found = decode(file, &bytes[at..])
            .filter(|(record, _)| last.is_none_or(|last| record.number > last.number));
        let Some((record, length)) = found else {
            at += 1;
            continue;
        };
        let entry =
            IndexEntry { number: record.number, time_ms: record.time_ms, at: at as u64, length };
        if gap_at < at {
            gaps.push(DamagedRange {
                at: gap_at,
                length: at - gap_at,
                before: last,
                after: Some(entry),
            });
        }
        entries.push(entry);
        at += length;
        gap_at = at;
    }
    if gap_at < bytes.len() {
        let before = entries.last().copied();
        gaps.push(DamagedRange { at: gap_at, length: bytes.len() - gap_at, before, after: None });
    }
    (entries, gaps)
}

fn checksum(file: u64, bytes: &[u8]) -> u32 {
    let mut digest = CRC.digest();
    digest.update(&file.to_le_bytes());
    digest.update(bytes);
    digest.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: u64 = 0x0123_4567_89AB_CDEF;

    fn record(number: u64) -> SpoolRecord {
        let payload = (0..20 + number as u8).collect();
        SpoolRecord {
            number,
            time_ms: 1_000 * number,
            topic: format!("trueup/n/{number}"),
            payload,
        }
    }

    fn file(numbers: std::ops::Range<u64>) -> Vec<u8> {
        numbers.flat_map(|number| encode(FILE, &record(number)).expect("short")).collect()
    }

    #[test]
    fn records_come_back_as_they_were_written() {
        let bytes = file(5..9);
        let (entries, gaps) = scan(FILE, &bytes);
        assert_eq!(gaps, []);
        for (entry, number) in entries.iter().zip(5..9) {
            let (read, length) = decode(FILE, &bytes[entry.at as usize..]).expect("whole");
            assert_eq!((read, length), (record(number), entry.length));
        }
        assert_eq!(entries.len(), 4);
        assert_eq!(scan(FILE + 1, &bytes).0, [], "of another file");
        let long = SpoolRecord { payload: vec![0; MAX_BODY_BYTES + 1], ..record(1) };
        assert_eq!(encode(FILE, &long), None);
    }

    #[test]
    fn each_flipped_bit_costs_one_record_and_its_neighbours_name_it() {
        let bytes = file(0..3);
        let (entries, _) = scan(FILE, &bytes);
        for bit in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            let (left, gaps) = scan(FILE, &damaged);
            let hit = entries.iter().position(|entry| bit / 8 < entry.at as usize + entry.length);
            let hit = hit.expect("within the file");
            let expected: Vec<IndexEntry> = entries
                .iter()
                .enumerate()
                .filter(|(n, _)| *n != hit)
                .map(|(_, entry)| *entry)
                .collect();
            assert_eq!(left, expected, "bit {bit}");
            let before = hit.checked_sub(1).map(|n| entries[n]);
            let (at, length) = (entries[hit].at as usize, entries[hit].length);
            assert_eq!(
                gaps,
                [DamagedRange { at, length, before, after: entries.get(hit + 1).copied() }]
            );
        }
    }

    #[test]
    fn a_file_that_ends_anywhere_keeps_all_whole_records() {
        let bytes = file(0..3);
        let (entries, _) = scan(FILE, &bytes);
        for end in 0..bytes.len() {
            let (left, gaps) = scan(FILE, &bytes[..end]);
            let whole =
                entries.iter().filter(|entry| entry.at as usize + entry.length <= end).count();
            assert_eq!(left, entries[..whole]);
            let begun = entries.get(whole).is_some_and(|entry| (entry.at as usize) < end);
            assert_eq!(gaps.len(), usize::from(begun), "cut at {end}");
        }
    }
}
