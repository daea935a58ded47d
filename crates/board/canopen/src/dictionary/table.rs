//! The table itself.

use trueup_link::layout::{
    EMERGENCY_ID, EMERGENCY_INHIBIT_MS, HEARTBEAT_PERIOD_MS, SDO_ANSWER_ID, SDO_REQUEST_ID,
};

use super::{
    Access, Counter, DIGITS, ELONGATION_INPUT, Entry, Object, ObjectKind, Shape, Stop, Type,
};

const fn constant(subindex: u8, name: &'static str, kind: Type, number: u32) -> Entry {
    let what = ObjectKind::Fixed(number);
    Entry { subindex, name, kind, access: Access::Constant, what, default: None }
}

const fn count(number: u8) -> Entry {
    constant(0, "Highest sub-index supported", Type::U8, number as u32)
}

const fn read(subindex: u8, name: &'static str, kind: Type, what: ObjectKind) -> Entry {
    Entry { subindex, name, kind, access: Access::Read, what, default: None }
}

const fn set(
    subindex: u8,
    name: &'static str,
    kind: Type,
    what: ObjectKind,
    default: u32,
) -> Entry {
    Entry { subindex, name, kind, access: Access::ReadWrite, what, default: Some(default) }
}

const fn var(index: u16, name: &'static str, entries: &'static [Entry]) -> Object {
    Object { index, name, shape: Shape::Var, entries }
}

const fn array(index: u16, name: &'static str, entries: &'static [Entry]) -> Object {
    Object { index, name, shape: Shape::Array, entries }
}

const fn record(index: u16, name: &'static str, entries: &'static [Entry]) -> Object {
    Object { index, name, shape: Shape::Record, entries }
}

const fn load(subindex: u8, name: &'static str, what: ObjectKind) -> Entry {
    Entry { subindex, name, kind: Type::Domain, access: Access::Write, what, default: None }
}

const fn text(name: &'static str, characters: &'static str) -> Entry {
    let (kind, access, what) = (Type::Text, Access::Constant, ObjectKind::Text(characters));
    Entry { subindex: 0, name, kind, access, what, default: None }
}

/// Degrees Celsius, as CiA 303-2 writes units.
const CELSIUS: u32 = 0x002D_0000;
/// Micrometres: the metre, with the prefix 10⁻⁶.
const MICROMETRES: u32 = 0xFA01_0000;

/// One line for each analogue input, whose name and content follow from its number.
macro_rules! inputs {
    ($temperature:expr, $elongation:expr) => {
        &[
            count(ELONGATION_INPUT),
            $temperature(1, "Temperature channel 0"),
            $temperature(2, "Temperature channel 1"),
            $temperature(3, "Temperature channel 2"),
            $temperature(4, "Temperature channel 3"),
            $temperature(5, "Temperature channel 4"),
            $temperature(6, "Temperature channel 5"),
            $temperature(7, "Temperature channel 6"),
            $temperature(8, "Temperature channel 7"),
            $elongation(ELONGATION_INPUT, "Elongation"),
        ]
    };
}

const fn celsius(subindex: u8, name: &'static str) -> Entry {
    constant(subindex, name, Type::U32, CELSIUS)
}
const fn micrometres(subindex: u8, name: &'static str) -> Entry {
    constant(subindex, name, Type::U32, MICROMETRES)
}
const fn digits(subindex: u8, name: &'static str) -> Entry {
    constant(subindex, name, Type::U8, DIGITS as u32)
}
const fn status(subindex: u8, name: &'static str) -> Entry {
    read(subindex, name, Type::U8, ObjectKind::InputStatus(subindex.saturating_sub(1)))
}
const fn value(subindex: u8, name: &'static str) -> Entry {
    read(subindex, name, Type::I32, ObjectKind::Input(subindex.saturating_sub(1)))
}
const fn resets(subindex: u8, name: &'static str) -> Entry {
    read(subindex, name, Type::U16, ObjectKind::Resets(subindex.saturating_sub(1)))
}
const fn error(subindex: u8, name: &'static str) -> Entry {
    read(subindex, name, Type::U32, ObjectKind::Error(subindex.saturating_sub(1)))
}

/// Every object, by rising index.
pub const OBJECTS: &[Object] = &[
    var(0x1000, "Device type", &[constant(0, "Device type", Type::U32, 404)]),
    var(
        0x1001,
        "Error register",
        &[read(0, "Error register", Type::U8, ObjectKind::ErrorRegister)],
    ),
    array(
        0x1003,
        "Pre-defined error field",
        &[
            set(0, "Number of errors", Type::U8, ObjectKind::ErrorCount, 0),
            error(1, "Newest error"),
            error(2, "Error 2"),
            error(3, "Error 3"),
            error(4, "Error 4"),
            error(5, "Error 5"),
            error(6, "Error 6"),
            error(7, "Error 7"),
            error(8, "Error 8"),
        ],
    ),
    var(0x1008, "Manufacturer device name", &[text("Manufacturer device name", "trueup bridge")]),
    var(
        0x1009,
        "Manufacturer hardware version",
        &[text("Manufacturer hardware version", "STM32F405")],
    ),
    var(
        0x100A,
        "Manufacturer software version",
        &[text("Manufacturer software version", env!("CARGO_PKG_VERSION"))],
    ),
    var(0x1014, "COB-ID EMCY", &[constant(0, "COB-ID EMCY", Type::U32, EMERGENCY_ID as u32)]),
    var(
        0x1015,
        "Inhibit time EMCY",
        &[set(0, "Inhibit time EMCY", Type::U16, ObjectKind::Inhibit, 10 * EMERGENCY_INHIBIT_MS)],
    ),
    array(
        0x1016,
        "Consumer heartbeat time",
        &[count(1), set(1, "Consumer heartbeat time", Type::U32, ObjectKind::ConsumerHeartbeat, 0)],
    ),
    var(
        0x1017,
        "Producer heartbeat time",
        &[set(
            0,
            "Producer heartbeat time",
            Type::U16,
            ObjectKind::ProducerHeartbeat,
            HEARTBEAT_PERIOD_MS,
        )],
    ),
    record(
        0x1018,
        "Identity object",
        &[
            count(4),
            // No number was assigned by CiA.
            constant(1, "Vendor-ID", Type::U32, 0),
            constant(2, "Product code", Type::U32, 1),
            constant(3, "Revision number", Type::U32, 0x0001_0000),
            read(4, "Serial number", Type::U32, ObjectKind::SerialNumber),
        ],
    ),
    record(
        0x1200,
        "SDO server parameter",
        &[
            count(2),
            constant(1, "COB-ID client to server", Type::U32, SDO_REQUEST_ID as u32),
            constant(2, "COB-ID server to client", Type::U32, SDO_ANSWER_ID as u32),
        ],
    ),
    array(
        0x2000,
        "Offset in nm",
        &[
            count(3),
            read(1, "Offset X", Type::I32, ObjectKind::Offset(0)),
            read(2, "Offset Y", Type::I32, ObjectKind::Offset(1)),
            read(3, "Offset Z", Type::I32, ObjectKind::Offset(2)),
        ],
    ),
    record(
        0x2001,
        "State of the bridge",
        &[
            count(11),
            read(1, "Quality", Type::U8, ObjectKind::Quality),
            read(2, "Flags", Type::U8, ObjectKind::Flags),
            read(3, "Age of the newest sample in ms", Type::U8, ObjectKind::Age),
            read(4, "Faults 0 to 15", Type::U16, ObjectKind::Faults),
            read(5, "Sample clock in ms", Type::U32, ObjectKind::Clock),
            read(6, "State bits", Type::U32, ObjectKind::StateBits),
            read(7, "Reason of the last reset", Type::U8, ObjectKind::ResetReason),
            read(8, "Who may write", Type::U8, ObjectKind::Authority),
            read(9, "Faults 0 to 31", Type::U32, ObjectKind::AllFaults),
            read(10, "Faults from 32 on", Type::U32, ObjectKind::HighFaults),
            read(11, "Commit of the source of the image", Type::U32, ObjectKind::Commit),
        ],
    ),
    record(
        0x2002,
        "Where the last start stopped",
        &[
            count(7),
            read(1, "Program counter", Type::U32, ObjectKind::Stop(Stop::ProgramCounter)),
            read(2, "Link register", Type::U32, ObjectKind::Stop(Stop::LinkRegister)),
            read(3, "Fault status (CFSR)", Type::U32, ObjectKind::Stop(Stop::FaultStatus)),
            read(4, "Address", Type::U32, ObjectKind::Stop(Stop::Address)),
            read(5, "Line", Type::U32, ObjectKind::Stop(Stop::Line)),
            read(6, "File", Type::Text, ObjectKind::Stop(Stop::File)),
            read(7, "Task", Type::U8, ObjectKind::Stop(Stop::Task)),
        ],
    ),
    array(
        0x2003,
        "Starts since power-on",
        &[
            count(11),
            resets(1, "For an unknown reason"),
            resets(2, "By the supply"),
            resets(3, "By the reset pin"),
            resets(4, "By the watchdog"),
            resets(5, "As a master asked"),
            resets(6, "After a brown-out"),
            resets(7, "After a panic"),
            resets(8, "After a hard fault"),
            resets(9, "After the crystal stopped"),
            resets(10, "After a stack overflow"),
            resets(11, "After a register had changed"),
        ],
    ),
    record(
        0x2010,
        "Reference taken by Zero",
        &[
            count(13),
            set(1, "Elongation in nm", Type::I32, ObjectKind::ReferenceElongation, 0),
            set(2, "Error of X in nm", Type::I32, ObjectKind::Reference(0), 0),
            set(3, "Error of Y in nm", Type::I32, ObjectKind::Reference(1), 0),
            set(4, "Error of Z in nm", Type::I32, ObjectKind::Reference(2), 0),
            read(5, "A reference is in force", Type::U8, ObjectKind::HasReference),
            Entry {
                subindex: 6,
                name: "Forget the reference (write zero as text), offer what was written (back)",
                kind: Type::U32,
                access: Access::Write,
                what: ObjectKind::Forget,
                default: None,
            },
            read(7, "Offered: elongation in nm", Type::I32, ObjectKind::OfferedElongation),
            read(8, "Offered: error of X in nm", Type::I32, ObjectKind::Offered(0)),
            read(9, "Offered: error of Y in nm", Type::I32, ObjectKind::Offered(1)),
            read(10, "Offered: error of Z in nm", Type::I32, ObjectKind::Offered(2)),
            read(11, "Taken at, in s since 1970 (UTC)", Type::U32, ObjectKind::ReferenceUtc),
            read(
                12,
                "Taken by (kind and line of the write)",
                Type::U16,
                ObjectKind::ReferenceOrigin,
            ),
            read(13, "Age in s", Type::U32, ObjectKind::ReferenceAge),
        ],
    ),
    array(
        0x2011,
        "Learned, as it is applied",
        &[
            count(5),
            read(1, "Growth in 0.001 %", Type::I32, ObjectKind::Learned(0)),
            read(2, "X in 0.001 %", Type::I32, ObjectKind::Learned(1)),
            read(3, "Y in 0.001 %", Type::I32, ObjectKind::Learned(2)),
            read(4, "Z in 0.001 %", Type::I32, ObjectKind::Learned(3)),
            read(5, "Zero of the growth in nm", Type::I32, ObjectKind::Learned(4)),
        ],
    ),
    record(
        0x2012,
        "Tool and conditions",
        &[
            count(3),
            read(1, "Tool", Type::U16, ObjectKind::Tool),
            read(2, "Conditions", Type::U16, ObjectKind::Conditions),
            read(3, "0 unknown, 1 from the CNC, 2 lost", Type::U8, ObjectKind::ConditionsOrigin),
        ],
    ),
    var(
        0x2020,
        "RMS noise in thousandths of a code",
        &[read(0, "RMS noise in thousandths of a code", Type::U32, ObjectKind::Noise)],
    ),
    array(
        0x2030,
        "Frames from the CNC",
        &[
            count(5),
            read(1, "Accepted", Type::U32, ObjectKind::Counter(Counter::Accepted)),
            read(2, "Malformed", Type::U32, ObjectKind::Counter(Counter::Malformed)),
            read(3, "Damaged", Type::U32, ObjectKind::Counter(Counter::Crc)),
            read(4, "Out of sequence", Type::U32, ObjectKind::Counter(Counter::Sequence)),
            read(5, "Lost", Type::U32, ObjectKind::Counter(Counter::Lost)),
        ],
    ),
    record(
        0x2100,
        "Calibration",
        &[
            count(5),
            read(1, "Running calibration", Type::Domain, ObjectKind::Running),
            Entry {
                subindex: 2,
                name: "New calibration (used from the next start)",
                kind: Type::Domain,
                access: Access::ReadWrite,
                what: ObjectKind::New,
                default: None,
            },
            read(3, "CRC of the running calibration", Type::U32, ObjectKind::RunningCrc),
            read(4, "CRC of the new calibration", Type::U32, ObjectKind::NewCrc),
            Entry {
                subindex: 5,
                name: "Drop the new calibration (write drop as text)",
                kind: Type::U32,
                access: Access::Write,
                what: ObjectKind::DropNew,
                default: None,
            },
        ],
    ),
    record(
        0x2101,
        "Machine of the running calibration",
        &[
            count(5),
            read(1, "Name", Type::Text, ObjectKind::MachineName),
            read(2, "Serial number", Type::Text, ObjectKind::MachineSerial),
            read(3, "Board, low word of its chip's number", Type::U32, ObjectKind::MachineBoard(0)),
            read(4, "Board, middle word", Type::U32, ObjectKind::MachineBoard(1)),
            read(5, "Board, high word", Type::U32, ObjectKind::MachineBoard(2)),
        ],
    ),
    record(
        0x2110,
        "Writes to the board",
        &[
            count(2),
            read(1, "The last writes (24 bytes each)", Type::Domain, ObjectKind::WriteLog),
            set(2, "Time of day in s since 1970 (UTC)", Type::U32, ObjectKind::Utc, 0),
        ],
    ),
    record(
        0x2120,
        "New firmware",
        &[
            count(5),
            load(1, "Header (erases the other slot)", ObjectKind::FirmwareHeader),
            load(2, "Image, from the bytes that have come on", ObjectKind::FirmwareImage),
            read(3, "Bytes that have come", Type::U32, ObjectKind::FirmwareReceived),
            read(4, "Tag of the firmware under way", Type::U32, ObjectKind::FirmwareTag),
            read(5, "Why the last one was refused", Type::U8, ObjectKind::FirmwareRefused),
        ],
    ),
    record(
        0x2121,
        "Firmware slots",
        &[
            count(7),
            read(1, "Slot that runs (0 A, 1 B)", Type::U8, ObjectKind::RunningSlot),
            read(2, "Version in A", Type::U32, ObjectKind::SlotVersion(0)),
            read(3, "Version in B", Type::U32, ObjectKind::SlotVersion(1)),
            read(4, "Status of A, and its starts", Type::U16, ObjectKind::SlotStatus(0)),
            read(5, "Status of B, and its starts", Type::U16, ObjectKind::SlotStatus(1)),
            read(6, "Oldest version that may start", Type::U32, ObjectKind::FirmwareFloor),
            read(7, "Why the slot that runs was chosen", Type::U32, ObjectKind::SlotChoice),
        ],
    ),
    array(0x6131, "AI physical unit process value", inputs!(celsius, micrometres)),
    array(0x6132, "AI decimal digits process value", inputs!(digits, digits)),
    array(0x6150, "AI status", inputs!(status, status)),
    array(0x9130, "AI input process value", inputs!(value, value)),
];
