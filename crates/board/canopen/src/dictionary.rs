//! The object dictionary: what a CANopen master can read and write, as one table.
//!
//! The server looks its objects up here, and `trueup.eds`, the file that CANopen tools read, is
//! printed from the same table by `eds`; a test holds the two against each other. The tables of objects in
//! `docs/reference.md` are printed by `reference_page`. A client finds an address by [`find_address`]. The objects
//! below 0x2000 are those of CiA 301. The analogue inputs (from 0x6131 on) are shaped after
//! CiA 404: eight temperatures, then the elongation. 0x9130 holds their process values as 32-bit
//! integers of `DECIMAL_DIGITS` decimals. Objects without a standard place are manufacturer-specific, from 0x2000 on.
//!
//! The offsets themselves and the frames of the CNC are not mapped PDOs: they are protected end to
//! end, and `trueup.dbc` describes them.

use trueup_core::design_parameters::TEMPERATURE_CHANNEL_COUNT;

use crate::emergency::ERROR_HISTORY_LEN;

mod address;
mod constructors;
#[cfg(test)]
pub(crate) mod eds;
mod object_table;
#[cfg(test)]
mod reference_page;

pub use address::{ObjectAddress, find_address, find_address_by_name};
pub use object_table::OBJECTS;

/// Decimals of the process values: thousandths of a degree, thousandths of a micrometre.
pub(crate) const DECIMAL_DIGITS: u8 = 3;
/// A process value or an offset that is not available.
pub const NOT_AVAILABLE: i32 = i32::MIN;
/// Number that drops the reference when it is written: the bytes `zero`, low byte first, so that no stray write does
/// it.
pub const CLEAR_REFERENCE_SIGNATURE: u32 = u32::from_le_bytes(*b"zero");
/// Number that, written to the same object, offers the operator the reference that was written to the sub-indices
/// before it, of a board that this one takes the place of: the bytes `back`.
pub const RESTORE_REFERENCE_SIGNATURE: u32 = u32::from_le_bytes(*b"back");
/// Number that, written to 0x2100:05, drops the calibration that was loaded for the next start: the bytes `drop`.
pub const DROP_CALIBRATION_SIGNATURE: u32 = u32::from_le_bytes(*b"drop");
/// Bytes of the header of a firmware file.
pub const FIRMWARE_HEADER_BYTES: usize = 512;
/// Sub-index of the elongation among the analogue inputs.
pub const ELONGATION_SUBINDEX: u8 = 9;
const _: () = assert!(
    TEMPERATURE_CHANNEL_COUNT == 8 && ERROR_HISTORY_LEN == 8,
    "the table has eight lines of each"
);

/// How an object is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectCode {
    /// One value, at sub-index 0.
    Var,
    /// Values of one type; sub-index 0 says how many.
    Array,
    /// Values of several types; sub-index 0 says how many.
    Record,
}

/// The type of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DataType {
    /// `UNSIGNED8`: 0…255.
    U8,
    /// `UNSIGNED16`: 0…65 535.
    U16,
    /// `UNSIGNED32`: 0…2³² − 1.
    U32,
    /// `INTEGER32`: −2³¹…2³¹ − 1.
    I32,
    /// `VISIBLE_STRING`: printable ASCII, of any length.
    Text,
    /// `DOMAIN`: bytes, as many as there are.
    Domain,
}

impl DataType {
    /// Bytes of a number; `None` for a type of no fixed length.
    #[must_use]
    pub const fn size(self) -> Option<usize> {
        match self {
            Self::U8 => Some(1),
            Self::U16 => Some(2),
            Self::U32 | Self::I32 => Some(4),
            Self::Text | Self::Domain => None,
        }
    }
}

/// Access of a master to a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AccessType {
    /// Read; it never changes.
    Constant,
    /// A master may read it; it changes while the bridge runs.
    Read,
    /// Read and write.
    ReadWrite,
    /// A master may write it; a read is refused.
    Write,
}

impl AccessType {
    /// Returns whether a master may write it.
    #[must_use]
    pub(crate) const fn is_writable(self) -> bool {
        matches!(self, Self::ReadWrite | Self::Write)
    }
}

/// Content of an entry: a constant, or one of the node's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EntryContent {
    /// A constant number.
    Fixed(u32),
    /// A constant text, in ASCII.
    Text(&'static str),
    /// A hash of the number that the chip has from its factory, 0…2³² − 1.
    SerialNumber,
    /// CiA 301 error register.
    ErrorRegister,
    /// How many errors the history holds; writing 0 clears it.
    ErrorCount,
    /// An error of the history, the newest being 0.
    Error(u8),
    /// Shortest time between emergencies in 0.1 ms.
    Inhibit,
    /// Whose heartbeat is expected, and how often: node in bits 16…22, milliseconds below.
    ConsumerHeartbeat,
    /// Milliseconds from one heartbeat to the next; 0: none.
    ProducerHeartbeat,
    /// Offset on an axis, 0…2, in nanometres.
    Offset(u8),
    /// The quality, as in `OffsetZ`.
    Quality,
    /// The flags, as in `OffsetZ`.
    Flags,
    /// Age of the newest sample in milliseconds.
    Age,
    /// The faults 0…15 of now, one bit each.
    Faults,
    /// Conditions that a CNC must know in addition to the offsets, one bit each, as in `Status`.
    StateBits,
    /// Why the board last started, as in `Status`.
    ResetReason,
    /// Of where the last start stopped.
    CrashDetail(CrashDetail),
    /// How often the board has started for a reason, a number of `ResetReason`, since power-on.
    Resets(u8),
    /// Who may write: a number of [`WriteAuthority`].
    Authority,
    /// The first 32 bits of the hash of the commit that the image was built from; 0: it is not known.
    Commit,
    /// The faults 0 to 31, a bit each, as [`crate::emergency::Faults::low_word`] has them.
    AllFaults,
    /// The faults from 32 on, a bit each, as [`crate::emergency::Faults::high_word`] has them.
    HighFaults,
    /// Milliseconds of the sample clock.
    Clock,
    /// The elongation that counts as none, in nanometres.
    ReferenceElongation,
    /// The error of an axis that counts as none, in nanometres.
    Reference(u8),
    /// 1: a reference is in force; 0: errors count from the calibration's own zero.
    HasReference,
    /// Writing [`CLEAR_REFERENCE_SIGNATURE`] drops the reference, or declines the one that is offered.
    Forget,
    /// The elongation of the reference that is offered, in nanometres; [`NOT_AVAILABLE`]: none is.
    OfferedElongation,
    /// The error of an axis of that reference, the same way.
    Offered(u8),
    /// When the reference was taken, in force or offered: seconds since 1970 (UTC); 0: it is not known.
    ReferenceUtc,
    /// How it was taken: kind and line of the write, as the log of writes has them; 0: it is not known.
    ReferenceOrigin,
    /// Seconds since then; the largest number: it is not known.
    ReferenceAge,
    /// How far a part, 0…4, differs from what the calibration says.
    Learned(u8),
    /// Number of the tool that the terms go by; 0: none, or not known.
    Tool,
    /// A bit for each condition that the terms go by.
    Conditions,
    /// Whose tool and conditions these are: 0 not known, or no term needs them, 1 the CNC's, 2 the calibration's
    /// defaults in place of the CNC's, which are lost.
    ConditionsOrigin,
    /// RMS noise of the raw codes in thousandths of a code.
    Noise,
    /// Counters of the frames from the CNC.
    ReceiverCounter(ReceiverCounter),
    /// The blob that the bridge runs on.
    Running,
    /// The blob for the next start.
    New,
    /// CRC of the running blob; 0: there is none.
    RunningCrc,
    /// CRC of the blob for the next start, once it is stored; 0: none was loaded.
    NewCrc,
    /// Writing [`DROP_CALIBRATION_SIGNATURE`] drops the blob for the next start.
    DropNew,
    /// The header of a new firmware, [`FIRMWARE_HEADER_BYTES`] bytes: it is checked, and the other slot is erased.
    FirmwareHeader,
    /// The bytes behind those that have come; with the last one it is verified, and starts next.
    FirmwareImage,
    /// Bytes of a new firmware that have come, the header included; 0: none is under way.
    FirmwareReceived,
    /// The tag of the firmware under way, the last word of its header; 0: none is.
    FirmwareTag,
    /// Why the last one was refused, a number of the board's; 0: none was.
    FirmwareRefused,
    /// The firmware slot that runs: 0 A, 1 B.
    RunningSlot,
    /// The version in a slot, 0 A, 1 B: major, minor, patch, build, a byte each from the highest; 0: none.
    SlotVersion(u8),
    /// The state of a slot: status in the lower byte, starts on trial in the upper one.
    SlotStatus(u8),
    /// The oldest version that may start.
    FirmwareFloor,
    /// Why the boot program chose the slot that runs: its reason, start on trial, and the status of the other slot then, as
    /// [`Self::SlotStatus`] has it, from the lowest byte; 0: it has not handed it over.
    SlotChoice,
    /// The last writes to the board.
    WriteLog,
    /// Seconds since 1970 (UTC); 0: the time was never set.
    Utc,
    /// Name of the machine that the running calibration is for.
    MachineName,
    /// Serial number of that machine.
    MachineSerial,
    /// A word of the number of the chip that the running calibration is for, 0…2; all 0: any.
    MachineBoard(u8),
    /// A process value: a temperature, 0…7, or the elongation, 8.
    Input(u8),
    /// 0: the process value is valid; 1: it is not.
    InputStatus(u8),
}

/// Whether a master may write now. Whatever changes the bridge needs the operator's `Service` in
/// the `Control` of the CNC, or of a tool where there is no CNC, and that nothing is engaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum WriteAuthority {
    /// No master sends `Control`: a tool may, with `Service`.
    NoMaster = 0,
    /// The one who sends `Control` has not set `Service`, or has engaged.
    NoService = 1,
    /// It has.
    Service = 2,
    /// The running calibration allows it with the service switch closed alone, and it is open.
    SwitchOpen = 3,
}

/// The tasks of the board, in the order of their numbers, which begin at 1.
pub const TASK_NAMES: [&str; 13] = [
    "start",
    "serial_receive",
    "sample",
    "can_receive_0",
    "can_receive_1",
    "listen",
    "supervise",
    "service",
    "transmit",
    "thermometers",
    "idle",
    "modbus_line",
    "modbus",
];

/// Details of the place where the last start stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CrashDetail {
    /// Program counter of a fault; 0: it was none.
    ProgramCounter,
    /// Link register of a fault.
    LinkRegister,
    /// CFSR, the status of a fault (Armv7-M manual, B3.2.15).
    FaultStatus,
    /// The address at fault, or that of the register that had changed.
    Address,
    /// The line of a panic; 0: it was none.
    Line,
    /// The end of the name of the file of a panic.
    File,
    /// The task that ran, a number of [`TASK_NAMES`]; 0: none is known.
    Task,
}

/// A counter of [`trueup_link::receiver::FrameCounters`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReceiverCounter {
    /// Valid frames, which were used.
    Accepted,
    /// Frames of a wrong length or content.
    Malformed,
    /// Frames whose CRC is wrong.
    Crc,
    /// Frames that came twice or out of order.
    Sequence,
    /// Frames that never came, by the gaps in their counters.
    Lost,
}

/// One value of an object, with its own sub-index.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Sub-index, 0…254.
    pub subindex: u8,
    /// Its name in the EDS.
    pub name: &'static str,
    /// The type of the value on the wire.
    pub kind: DataType,
    /// Access of a master.
    pub access: AccessType,
    /// The value behind it.
    pub what: EntryContent,
    /// Value of a writable entry at the start.
    pub default: Option<u32>,
}

/// One object of the dictionary, with all its values.
#[derive(Clone, Copy, Debug)]
pub struct Object {
    /// Its index, 0x1000…0xFFFF.
    pub index: u16,
    /// Name in the EDS.
    pub name: &'static str,
    /// How it is laid out.
    pub shape: ObjectCode,
    /// Its values, by rising sub-index.
    pub entries: &'static [Entry],
}

/// Returns the object with this index.
#[must_use]
pub fn find_object(index: u16) -> Option<&'static Object> {
    OBJECTS.iter().find(|object| object.index == index)
}

impl Object {
    /// Returns the value with this sub-index.
    #[must_use]
    pub fn entry(&self, subindex: u8) -> Option<&'static Entry> {
        self.entries.iter().find(|entry| entry.subindex == subindex)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_object_is_there_once_in_order_and_counts_its_entries() {
        assert!(OBJECTS.is_sorted_by(|a, b| a.index < b.index));
        for object in OBJECTS {
            let at = object.index;
            assert!(object.entries.is_sorted_by(|a, b| a.subindex < b.subindex), "{at:04X}");
            let first = object.entry(0).expect("sub-index 0");
            let last = object.entries.last().expect("at least one").subindex;
            match object.shape {
                ObjectCode::Var => assert_eq!(object.entries.len(), 1, "{at:04X}"),
                // Its count is that of the errors, which may be written.
                _ if at == 0x1003 => assert_eq!(usize::from(last), ERROR_HISTORY_LEN),
                _ => {
                    assert_eq!((first.kind, first.access), (DataType::U8, AccessType::Constant));
                    assert_eq!(first.what, EntryContent::Fixed(last.into()), "{at:04X}");
                }
            }
            for entry in object.entries {
                let is_number = entry.kind.size().is_some();
                assert_eq!(
                    entry.default.is_some(),
                    is_number && entry.access == AccessType::ReadWrite
                );
                if let EntryContent::Fixed(number) = entry.what {
                    let bits = entry.kind.size().map_or(0, |bytes| 8 * bytes);
                    assert!(u64::from(number) < 1 << bits, "{at:04X}:{}", entry.subindex);
                }
            }
        }
    }

    #[test]
    fn what_cia_301_demands_is_there() {
        for (index, subindex) in [(0x1000, 0), (0x1001, 0), (0x1017, 0), (0x1018, 1)] {
            assert!(find_object(index).and_then(|object| object.entry(subindex)).is_some());
        }
        let device = find_object(0x1000).and_then(|object| object.entry(0)).expect("mandatory");
        assert_eq!(device.what, EntryContent::Fixed(404), "the number of the profile");
    }
}
