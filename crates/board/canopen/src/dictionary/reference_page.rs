//! The tables of objects in `docs/reference.md`, printed from the dictionary. What the page says of an entry beyond
//! its address, type and access stands here.

use core::fmt::Write as _;
use std::{format, string::String, vec, vec::Vec};

use super::{
    AccessType, DataType, Entry, EntryContent, FIRMWARE_HEADER_BYTES, Object, ObjectAddress,
    find_address, find_object,
};

/// A row of the page: entries with one meaning, which stand one after the other in one object.
struct PageRow {
    contents: Vec<EntryContent>,
    meaning: String,
}

impl PageRow {
    fn new(content: EntryContent, meaning: impl Into<String>) -> Self {
        Self { contents: vec![content], meaning: meaning.into() }
    }

    /// `content` takes the numbers of the entries.
    fn from_entry_numbers<const N: usize>(
        content: fn(u8) -> EntryContent,
        numbers: [u8; N],
        meaning: &str,
    ) -> Self {
        Self { contents: numbers.map(content).into(), meaning: meaning.into() }
    }
}

/// Returns an address as the page writes it.
fn format_address(content: EntryContent) -> String {
    let (index, subindex) = find_address(content);
    format!("0x{index:04X}:{subindex:02X}")
}

/// Returns the rows of the reference.
fn stored_reference_rows() -> Vec<PageRow> {
    let key = format_address(EntryContent::Forget);
    let [first, last] = [EntryContent::ReferenceElongation, EntryContent::Reference(2)];
    let written = format!("{} to {:02X}", format_address(first), find_address(last).1);
    vec![
        PageRow::new(
            EntryContent::ReferenceElongation,
            format!(
                "elongation of the reference in force, in nm; written, it waits for `back` at {key}; one beyond `max_um` \
                 is refused (abort 0x06090030)"
            ),
        ),
        PageRow::from_entry_numbers(
            EntryContent::Reference,
            [0, 1, 2],
            "its errors of X, Y, Z in nm, the same way",
        ),
        PageRow::new(
            EntryContent::HasReference,
            "1: a reference is in force; 0: errors count from the calibration's own zero",
        ),
        PageRow::new(
            EntryContent::Forget,
            format!(
                "`back` offers the operator what was written to {written}. `zero` declines what is offered, or drops \
                 what is in force. Each is four bytes of text"
            ),
        ),
        PageRow::new(
            EntryContent::OfferedElongation,
            "elongation of the reference that is offered, in nm; −2³¹: none is",
        ),
        PageRow::from_entry_numbers(
            EntryContent::Offered,
            [0, 1, 2],
            "its errors of X, Y, Z in nm, the same way",
        ),
        PageRow::new(
            EntryContent::ReferenceUtc,
            "time of day at which the reference was taken, in s since 1970 (UTC); 0: not known",
        ),
        PageRow::new(
            EntryContent::ReferenceOrigin,
            "by which kind of write it was taken (lower byte) and over which line (upper byte), as the log has them",
        ),
        PageRow::new(EntryContent::ReferenceAge, "its age in s; 2³² − 1: not known"),
    ]
}

/// Returns the rows of the calibrations.
fn calibration_rows() -> Vec<PageRow> {
    let pending = format_address(EntryContent::NewCrc);
    vec![
        PageRow::new(EntryContent::Running, "the running calibration"),
        PageRow::new(EntryContent::New, "the calibration for the next start"),
        PageRow::new(
            EntryContent::RunningCrc,
            "CRC of the running calibration; 0: there is no valid one",
        ),
        PageRow::new(
            EntryContent::NewCrc,
            "CRC of the calibration for the next start; 0: none waits",
        ),
        PageRow::new(
            EntryContent::DropNew,
            format!(
                "`drop`, as four bytes of text, drops the calibration for the next start. The board stores its running \
                 calibration once more, and {pending} is 0 then"
            ),
        ),
    ]
}

/// Returns the rows of a new firmware.
fn firmware_rows() -> Vec<PageRow> {
    let received = format_address(EntryContent::FirmwareReceived);
    vec![
        PageRow::new(
            EntryContent::FirmwareHeader,
            format!(
                "header, {FIRMWARE_HEADER_BYTES} bytes: the board checks it and erases the other slot, before it answers; \
                 up to 5 s without a heartbeat"
            ),
        ),
        PageRow::new(
            EntryContent::FirmwareImage,
            format!(
                "image: the bytes behind {received}, in one transfer or several. The last segment of the last one is \
                 answered when CRC, SHA-256 and signature hold in the flash"
            ),
        ),
        PageRow::new(
            EntryContent::FirmwareReceived,
            "bytes that have come, header included; 0: none is under way",
        ),
        PageRow::new(
            EntryContent::FirmwareTag,
            "tag of the firmware under way: the last four bytes of its header",
        ),
        PageRow::new(
            EntryContent::FirmwareRefused,
            "why the last one was refused (abort 0x06090030). 1 no header, 2 later format, 3 other slot, 4 length, 5 \
             below the floor, 6 floor above its version. 7 damaged, 8 signature, 9 not newer, 10 on trial, 11 flash, \
             12 state not stored, 13 no slots",
        ),
        PageRow::new(
            EntryContent::RunningSlot,
            "slot that runs: 0 A, 1 B; abort 0x08000024 where there are no slots",
        ),
        PageRow::from_entry_numbers(
            EntryContent::SlotVersion,
            [0, 1],
            "version in A, B: major, minor, patch, build, a byte each from the highest; 0: none",
        ),
        PageRow::from_entry_numbers(
            EntryContent::SlotStatus,
            [0, 1],
            "status of A, B in the lower byte, starts on trial in the upper one. The status is 0 new, 1 loading, 2 \
             verified, 3 on trial, 4 on trial and about to reset itself, 5 confirmed, 6 rejected",
        ),
        PageRow::new(EntryContent::FirmwareFloor, "oldest version that may start"),
        PageRow::new(
            EntryContent::SlotChoice,
            "why the boot program chose the slot that runs, in its own words. Lowest byte, the reason: 1 newest, 2 \
             on trial, 3 alone, 4 went back, 5 last resort. Then start on trial, then status of the other slot at \
             that time and its starts on trial (0xFF 0xFF: no valid header). 0: the boot program is older than this \
             object",
        ),
    ]
}

fn find_entry(content: EntryContent) -> (&'static Object, &'static Entry) {
    let (index, subindex) = find_address(content);
    let object = find_object(index).expect("an address of the table");
    (object, object.entry(subindex).expect("an address of the table"))
}

/// Returns the table of these rows as the page has it.
fn format_table(rows: &[PageRow]) -> String {
    let mut text = String::from("| object | type | access | meaning |\n|---|---|---|---|\n");
    for row in rows {
        let entries: Vec<_> = row.contents.iter().map(|content| find_entry(*content)).collect();
        let (object, first) = entries[0];
        for (other_object, entry) in &entries {
            assert_eq!(other_object.index, object.index, "a row is of one object");
            assert_eq!((entry.kind, entry.access), (first.kind, first.access), "{}", entry.name);
        }
        let subindices: Vec<_> =
            entries.iter().map(|(_, entry)| format!("{:02X}", entry.subindex)).collect();
        let kind = match first.kind {
            DataType::U8 => "`u8`",
            DataType::U16 => "`u16`",
            DataType::U32 => "`u32`",
            DataType::I32 => "`i32`",
            DataType::Text => "text",
            DataType::Domain => "bytes",
        };
        let access = match first.access {
            AccessType::Constant => "constant",
            AccessType::Read => "read",
            AccessType::ReadWrite => "read, write",
            AccessType::Write => "write",
        };
        let (index, subindices) = (object.index, subindices.join(", "));
        writeln!(text, "| 0x{index:04X}:{subindices} | {kind} | {access} | {} |", row.meaning)
            .expect("a string takes everything");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{env, fs, path::Path};

    #[test]
    fn the_reference_page_prints_the_objects_of_the_table() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/reference.md");
        let page = fs::read_to_string(&path).expect("the page");
        let tables = [stored_reference_rows(), calibration_rows(), firmware_rows()]
            .map(|rows| format_table(&rows));
        let missing: Vec<_> =
            tables.iter().filter(|table| !page.contains(table.as_str())).cloned().collect();
        assert!(missing.is_empty(), "put this into docs/reference.md:\n{}", missing.join("\n"));
        let is_object = |line: &&str| line.starts_with("| 0x") && line.get(8..9) == Some(":");
        let printed: Vec<_> =
            tables.iter().flat_map(|table| table.lines()).filter(is_object).collect();
        let rows: Vec<_> = page.lines().filter(is_object).collect();
        assert_eq!(rows, printed, "the page has a row that is not printed");
    }

    #[test]
    fn every_entry_of_an_object_on_the_page_has_its_row() {
        for rows in [stored_reference_rows(), calibration_rows(), firmware_rows()] {
            let described: Vec<ObjectAddress> = rows
                .iter()
                .flat_map(|row| &row.contents)
                .map(|address| find_address(*address))
                .collect();
            let mut objects: Vec<_> = described.iter().map(|(index, _)| *index).collect();
            objects.dedup();
            let entries: Vec<_> = objects
                .into_iter()
                .filter_map(find_object)
                .flat_map(|object| {
                    object.entries.iter().map(move |entry| (object.index, entry.subindex))
                })
                .filter(|(_, subindex)| *subindex != 0)
                .collect();
            assert_eq!(described, entries);
        }
    }
}
