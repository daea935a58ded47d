//! Objects and entries of the table, each kind by a function of its own.

use super::{
    AccessType, CrashDetail, DECIMAL_DIGITS, DataType, Entry, EntryContent, Object, ObjectCode,
    ReceiverCounter,
};

/// Returns an entry with a number that never changes.
pub(super) const fn constant_entry(
    subindex: u8,
    name: &'static str,
    kind: DataType,
    number: u32,
) -> Entry {
    let what = EntryContent::Fixed(number);
    Entry { subindex, name, kind, access: AccessType::Constant, what, default: None }
}

/// Returns sub-index 0 of an array or a record.
pub(super) const fn highest_subindex_entry(number: u8) -> Entry {
    constant_entry(0, "Highest sub-index supported", DataType::U8, number as u32)
}

/// Returns an entry that a master may read.
pub(super) const fn read_only_entry(
    subindex: u8,
    name: &'static str,
    kind: DataType,
    what: EntryContent,
) -> Entry {
    Entry { subindex, name, kind, access: AccessType::Read, what, default: None }
}

/// Returns an entry that a master may read and write.
pub(super) const fn read_write_entry(
    subindex: u8,
    name: &'static str,
    kind: DataType,
    what: EntryContent,
    default: u32,
) -> Entry {
    Entry { subindex, name, kind, access: AccessType::ReadWrite, what, default: Some(default) }
}

/// Returns an object of one value.
pub(super) const fn var_object(
    index: u16,
    name: &'static str,
    entries: &'static [Entry],
) -> Object {
    Object { index, name, shape: ObjectCode::Var, entries }
}

/// Returns an object of values of one type.
pub(super) const fn array_object(
    index: u16,
    name: &'static str,
    entries: &'static [Entry],
) -> Object {
    Object { index, name, shape: ObjectCode::Array, entries }
}

/// Returns an object of values of several types.
pub(super) const fn record_object(
    index: u16,
    name: &'static str,
    entries: &'static [Entry],
) -> Object {
    Object { index, name, shape: ObjectCode::Record, entries }
}

/// Returns an entry of bytes that a master may write.
pub(super) const fn domain_entry(subindex: u8, name: &'static str, what: EntryContent) -> Entry {
    Entry { subindex, name, kind: DataType::Domain, access: AccessType::Write, what, default: None }
}

/// Returns an entry with a text that never changes.
pub(super) const fn text_entry(name: &'static str, characters: &'static str) -> Entry {
    let (kind, access, what) =
        (DataType::Text, AccessType::Constant, EntryContent::Text(characters));
    Entry { subindex: 0, name, kind, access, what, default: None }
}

/// Degrees Celsius, as CiA 303-2 writes units.
const CELSIUS_UNIT: u32 = 0x002D_0000;
/// Micrometres: the metre, with the prefix 10⁻⁶.
const MICROMETRES_UNIT: u32 = 0xFA01_0000;

/// Returns the unit of a temperature.
pub(super) const fn celsius_unit_entry(subindex: u8, name: &'static str) -> Entry {
    constant_entry(subindex, name, DataType::U32, CELSIUS_UNIT)
}

/// Returns the unit of the elongation.
pub(super) const fn micrometres_unit_entry(subindex: u8, name: &'static str) -> Entry {
    constant_entry(subindex, name, DataType::U32, MICROMETRES_UNIT)
}

/// Returns the decimals of a process value.
pub(super) const fn decimal_digits_entry(subindex: u8, name: &'static str) -> Entry {
    constant_entry(subindex, name, DataType::U8, DECIMAL_DIGITS as u32)
}

/// Returns the status of a process value.
pub(super) const fn status_entry(subindex: u8, name: &'static str) -> Entry {
    read_only_entry(
        subindex,
        name,
        DataType::U8,
        EntryContent::InputStatus(subindex.saturating_sub(1)),
    )
}

/// Returns a process value.
pub(super) const fn process_value_entry(subindex: u8, name: &'static str) -> Entry {
    read_only_entry(subindex, name, DataType::I32, EntryContent::Input(subindex.saturating_sub(1)))
}

/// Returns the number of starts for a reason.
pub(super) const fn reset_count_entry(subindex: u8, name: &'static str) -> Entry {
    read_only_entry(subindex, name, DataType::U16, EntryContent::Resets(subindex.saturating_sub(1)))
}

/// Returns an error of the history.
pub(super) const fn error_entry(subindex: u8, name: &'static str) -> Entry {
    read_only_entry(subindex, name, DataType::U32, EntryContent::Error(subindex.saturating_sub(1)))
}

/// Returns a detail of where the last start stopped.
pub(super) const fn crash_detail_entry(
    subindex: u8,
    name: &'static str,
    kind: DataType,
    detail: CrashDetail,
) -> Entry {
    read_only_entry(subindex, name, kind, EntryContent::CrashDetail(detail))
}

/// Returns a counter of the frames from the CNC.
pub(super) const fn receiver_counter_entry(
    subindex: u8,
    name: &'static str,
    counter: ReceiverCounter,
) -> Entry {
    read_only_entry(subindex, name, DataType::U32, EntryContent::ReceiverCounter(counter))
}
