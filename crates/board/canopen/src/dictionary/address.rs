//! The address of an entry by its content or its name: an index and a sub-index stand in the table and nowhere else.

use super::{EntryContent, OBJECTS};

/// The address of an entry: index and sub-index.
pub type ObjectAddress = (u16, u8);

/// Returns the address of the entry with this content. Meant for constants: what the table does not have does not
/// compile then.
///
/// ```
/// use trueup_canopen::dictionary::{EntryContent, ObjectAddress, find_address};
///
/// const RUNNING_CRC: ObjectAddress = find_address(EntryContent::RunningCrc);
/// assert_eq!(RUNNING_CRC, (0x2100, 3));
/// ```
///
/// # Panics
/// No entry has this content, or more than one.
#[must_use]
pub const fn find_address(content: EntryContent) -> ObjectAddress {
    find_entry_address(&EntryKey::Content(content))
}

/// Returns the address of the entry with this name, for a constant, whose content is its value.
///
/// # Panics
/// No entry has this name, or more than one.
#[must_use]
pub const fn find_address_by_name(name: &'static str) -> ObjectAddress {
    find_entry_address(&EntryKey::Name(name))
}

enum EntryKey {
    Content(EntryContent),
    Name(&'static str),
}

const fn find_entry_address(key: &EntryKey) -> ObjectAddress {
    let mut found = None;
    let mut objects = OBJECTS;
    while let [object, other_objects @ ..] = objects {
        let mut entries = object.entries;
        while let [entry, other_entries @ ..] = entries {
            let is_match = match key {
                EntryKey::Content(content) => is_same_content(entry.what, *content),
                EntryKey::Name(name) => is_same_text(entry.name, name),
            };
            if is_match {
                assert!(found.is_none(), "more than one entry matches");
                found = Some((object.index, entry.subindex));
            }
            entries = other_entries;
        }
        objects = other_objects;
    }
    found.expect("no entry matches")
}

/// Defines the comparison of contents: `==` is not there in a constant. The match has every variant, so that a new one
/// cannot be forgotten.
macro_rules! define_is_same_content {
    (no_field: [$($plain:ident),* $(,)?], number: [$($numbered:ident),* $(,)?] $(,)?) => {
        const fn is_same_content(one: EntryContent, other: EntryContent) -> bool {
            match one {
                $(EntryContent::$plain => matches!(other, EntryContent::$plain),)*
                $(EntryContent::$numbered(one) => {
                    matches!(other, EntryContent::$numbered(other) if one == other)
                })*
                EntryContent::Text(one) => {
                    matches!(other, EntryContent::Text(other) if is_same_text(one, other))
                }
                EntryContent::CrashDetail(one) => {
                    matches!(other, EntryContent::CrashDetail(other) if one as u8 == other as u8)
                }
                EntryContent::ReceiverCounter(one) => {
                    matches!(other, EntryContent::ReceiverCounter(other) if one as u8 == other as u8)
                }
            }
        }
    };
}

define_is_same_content! {
    no_field: [
        SerialNumber,
        ErrorRegister,
        ErrorCount,
        Inhibit,
        ConsumerHeartbeat,
        ProducerHeartbeat,
        Quality,
        Flags,
        Age,
        Faults,
        StateBits,
        ResetReason,
        Authority,
        Commit,
        AllFaults,
        HighFaults,
        Clock,
        ReferenceElongation,
        HasReference,
        Forget,
        OfferedElongation,
        ReferenceUtc,
        ReferenceOrigin,
        ReferenceAge,
        Tool,
        Conditions,
        ConditionsOrigin,
        Noise,
        Running,
        New,
        RunningCrc,
        NewCrc,
        DropNew,
        FirmwareHeader,
        FirmwareImage,
        FirmwareReceived,
        FirmwareTag,
        FirmwareRefused,
        RunningSlot,
        FirmwareFloor,
        SlotChoice,
        WriteLog,
        Utc,
        MachineName,
        MachineSerial,
    ],
    number: [
        Fixed,
        Error,
        Offset,
        Resets,
        Reference,
        Offered,
        Learned,
        SlotVersion,
        SlotStatus,
        MachineBoard,
        Input,
        InputStatus,
    ],
}

const fn is_same_text(one: &str, other: &str) -> bool {
    let (mut one, mut other) = (one.as_bytes(), other.as_bytes());
    while let ([first, rest @ ..], [other_first, other_rest @ ..]) = (one, other) {
        if *first != *other_first {
            return false;
        }
        (one, other) = (rest, other_rest);
    }
    one.is_empty() && other.is_empty()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dictionary::{CrashDetail, DECIMAL_DIGITS, ReceiverCounter};

    #[test]
    fn contents_are_the_same_in_a_constant_as_by_the_operator() {
        let contents = || OBJECTS.iter().flat_map(|object| object.entries).map(|entry| entry.what);
        for one in contents() {
            for other in contents() {
                assert_eq!(is_same_content(one, other), one == other, "{one:?} {other:?}");
            }
        }
    }

    #[test]
    fn an_entry_is_found_by_its_content_and_by_its_name() {
        assert_eq!(find_address(EntryContent::SerialNumber), (0x1018, 4));
        assert_eq!(find_address(EntryContent::Offset(2)), (0x2000, 3));
        assert_eq!(find_address(EntryContent::CrashDetail(CrashDetail::File)), (0x2002, 6));
        let lost = EntryContent::ReceiverCounter(ReceiverCounter::Lost);
        assert_eq!(find_address(lost), (0x2030, 5));
        assert_eq!(find_address_by_name("Manufacturer software version"), (0x100A, 0));
    }

    #[test]
    #[should_panic(expected = "no entry matches")]
    fn a_content_that_is_not_there_is_no_address() {
        let _ = find_address(EntryContent::Offset(3));
    }

    #[test]
    #[should_panic(expected = "more than one entry matches")]
    fn a_content_that_is_there_twice_is_no_address() {
        let _ = find_address(EntryContent::Fixed(DECIMAL_DIGITS.into()));
    }

    #[test]
    #[should_panic(expected = "no entry matches")]
    fn a_part_of_a_name_is_no_name() {
        let _ = find_address_by_name("Manufacturer");
    }

    #[test]
    #[should_panic(expected = "more than one entry matches")]
    fn a_name_that_is_there_twice_is_no_address() {
        let _ = find_address_by_name("Serial number");
    }
}
